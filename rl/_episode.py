"""An episode as compiled learners live it: its start, the plant's motion, and the rule of :mod:`dpend.episode`."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from dpend.episode import Rule, rule_of
from dpend.kernels import inline, sample, status_code
from dpend.params import Coefficients
from dpend.rig import Rig
from dpend.tasks import Balance, SwingUp


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
