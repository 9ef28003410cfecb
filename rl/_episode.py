"""An episode as compiled learners live it: its start, the plant's motion, and the rule of :mod:`dpend.episode`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from dpend.episode import Rule, rule_of
from dpend.kernels import compiled, inline, sample, status_code, wrap_angle
from dpend.params import Coefficients
from dpend.rig import Rig
from dpend.tasks import Balance, SwingUp

from . import features

value_features = inline(features.make_value_features(wrap_angle))
slope_features = inline(features.slope_features)


class Episode(NamedTuple):
    """What a compiled loop needs to know of a rig and a task."""

    center: tuple[float, float]
    """Angles about which an episode starts, at rest, rad."""
    angle_spreads: tuple[float, float]
    steps: int
    rule: Rule
    force_limit: float
    substep: float
    substeps: int
    coefficients: Coefficients


class Records(NamedTuple):
    """What a compiled loop records of its episodes, a row each."""

    length: npt.NDArray[Any]
    reward: npt.NDArray[Any]
    success: npt.NDArray[Any]
    upright: npt.NDArray[Any]
    """Longest time that both links were up, samples, where a learner records it."""
    angles: npt.NDArray[Any]
    """Those of the start, rad, likewise."""
    weights: npt.NDArray[Any]

    @classmethod
    def zeros(cls, n: int, weights: int) -> Records:
        """Return the records of ``n`` episodes that learn so many weights, before they begin."""
        length, upright = np.zeros((2, n), dtype=np.int64)
        return cls(length, np.zeros(n), np.zeros(n, dtype=np.bool_), upright, np.zeros((n, 2)), np.zeros((n, weights)))

    def rows(self, first: int, end: int) -> Records:
        """Return the records of the episodes from the first to before the end; writing to them writes to these."""
        return Records(*(column[first:end] for column in self))


def episode(rig: Rig, task: Balance | SwingUp, angle_cut: float | None = None) -> Episode:
    """Return the episodes of a task that starts at rest, cut where a link leans more than ``angle_cut``, if given."""
    if isinstance(task, Balance):
        center, spreads = (0.0, 0.0), task.angle_spreads
    else:
        start = replace(task, angle_spread=0.0).starts(np.random.default_rng(0), 1, rig)[0]
        center, spreads = (float(start[1]), float(start[2])), 2 * (task.angle_spread,)
    rule = rule_of(task, rig)
    if angle_cut is not None:
        rule = rule._replace(bounds=(rule.bounds[0], float(angle_cut), float(angle_cut)))
    return Episode(
        center=center,
        angle_spreads=(float(spreads[0]), float(spreads[1])),
        steps=int(task.steps),
        rule=rule,
        force_limit=float(rig.force_limit),
        substep=float(rig.sample_time / rig.substeps),
        substeps=rig.substeps,
        coefficients=Coefficients(*map(float, rig.params.coefficients())),
    )


@inline
def started(e, rng):
    """Draw the state in which an episode starts."""
    th1 = e.center[0] + e.angle_spreads[0] * rng.uniform(-1.0, 1.0)
    th2 = e.center[1] + e.angle_spreads[1] * rng.uniform(-1.0, 1.0)
    return 0.0, th1, th2, 0.0, 0.0, 0.0


@inline
def moved(e, x, force):
    """Return the state a sample later, under a force within the rig's limit."""
    force = min(max(force, -e.force_limit), e.force_limit)
    return sample(x, (force, 0.0, 0.0), e.coefficients, e.substep, e.substeps)


@inline
def ended(e, x):
    """Return whether a state is beyond the track's end or a bound on the angles; NaN is."""
    return status_code(x, e.rule.bounds) != 0


@compiled
def rollout(K, noise, limit, e, rng, x, fresh, z, following):
    """Fill in states, forces -Kx with noise within a limit, and the states that followed, until the episode ends.

    It goes on from the state ``x``, or begins afresh.  Returns the samples filled in, and whether the episode ended.
    """
    state = started(e, rng) if fresh else (x[0], x[1], x[2], x[3], x[4], x[5])
    for k in range(len(z)):
        a = noise * rng.standard_normal()
        for i in range(6):
            a -= K[i] * state[i]
        a = min(max(a, -limit), limit)
        z[k, :6] = state
        z[k, 6] = a
        state = moved(e, state, a)
        following[k] = state
        if ended(e, state):
            return k + 1, True
    return len(z), False
