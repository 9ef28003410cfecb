"""How a rig is perturbed: RealAIGym's six axes of robustness, plants wrong in everything at once, real sensors.

The rig is changed without the knowledge of the contenders, which believe in it as it is, where nothing else is said in
:data:`~studies._field.RIG`; they have the same starts, noise and pushes; fewer starts or plants are the first of more.
Each change adds to what the rig has of its kind, or takes its place where it is worse.

Source of the axes: the robustness leaderboard (v2) of F. Wiebe et al., *Open Source Dual-Purpose Acrobot and Pendubot
Platform*, 2023, as its code has them (GitHub dfki-ric-underactuated-lab/double_pendulum).  Torques of its 6 N m motors
became forces of ours in the ratio of the limits, such as 40 N to 6 N m.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import stats

import dpend
from controllers import EKF, UKF, Differences, Predictor, WithEstimator
from dpend import Balance, Controller, Rig, SwingUp
from dpend.params import Array

from ._estimates import Estimate, mean_share
from ._field import RIG, TaskName

SECONDS = 10.0
"""How long each run lasts, s; RealAIGym's."""

Change = Callable[[Array], dict[str, Any]]
"""Fields of the rig for levels ``()``, or ``(N,)`` for a rig a row."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Axis:
    """One way in which a rig gets worse, level by level."""

    name: str
    group: str  # Which of RealAIGym's six it belongs to; "nominal" for none of them, "sensors" for those beyond.
    levels: tuple[float, ...]  # Increasing, the nominal one left out.
    changes: Change = lambda levels: {}
    words: str = ""  # What the levels are, with their unit.
    pulses: bool = False  # Whether pushes grow with the level.
    theirs: float = 0.0  # Least magnitude that is in RealAIGym's lists too.


_ERRORS = (-0.25, -0.17, -0.08, 0.08, 0.17, 0.25)


def _torque_to_force(rig: Rig) -> float:
    return float(rig.force_limit) / 6.0


def frictions(rig: Rig) -> dict[str, float]:
    """Return by name how much friction is added at most; RealAIGym's negative ones are left out."""
    return {
        "cart_friction": 0.1 * _torque_to_force(rig),  # N s/m
        "joint1_friction": 0.1,  # N m s
        "joint2_friction": 0.1,
        "cart_coulomb": 0.2 * _torque_to_force(rig),  # N
    }


FRICTIONS = frictions(RIG)
"""Those of the rig of the comparisons, which has none of its own."""


def _resolved(params: dpend.Params) -> dict[str, float]:
    """Return masses, lengths, centres and inertias, none left to its default."""
    (com1, com2), (inertia1, inertia2) = params.centers, params.inertias
    named = {name: getattr(params, name) for name in ("cart_mass", "mass1", "mass2", "length1")}
    named |= {"com1": com1, "com2": com2, "inertia1": inertia1, "inertia2": inertia2}
    return {name: float(value) for name, value in named.items()}


PARAMETERS = tuple(_resolved(RIG.params))
"""What is wrong one at a time, all else staying, centres and inertias too; link 2's length then moves nothing."""


def _wrong(rig: Rig, name: str) -> Change:
    believed = _resolved(rig.params)
    fixed = {key: believed[key] for key in ("com1", "com2", "inertia1", "inertia2")}
    return lambda levels: fixed | {name: believed[name] * (1 + levels)}


def _more(rig: Rig, name: str) -> Change:
    return lambda levels: {name: getattr(rig.params, name) + levels}


def lag(response: npt.ArrayLike, sample_time: float = RIG.sample_time) -> Array:
    r"""Return the time constant, s, with which a force moves by a share :math:`k` of what is missing in each sample.

    RealAIGym's :math:`u = u_- + k\,(u_\text{des} - u_-)`, with :math:`k` above 0 and at most 1, which is no lag, is
    :math:`k = 1 - e^{-T/\tau}`: :math:`\tau = -T/\ln(1 - k)`.
    """
    missing = 1 - np.asarray(response, dtype=np.float64)
    with np.errstate(divide="ignore"):
        return np.where(missing > 0, -sample_time / np.log(np.maximum(missing, 1e-300)), 0.0)


_POSITIONS, _RATES = np.array([1.0, 1, 1, 0, 0, 0]), np.array([0.0, 0, 0, 1, 1, 1])

NOMINAL = Axis(name="nominal", group="nominal", levels=(0.0,))
"""The rig as it is believed to be."""


def axes_of(rig: Rig) -> tuple[Axis, ...]:
    """Return RealAIGym's axes on a rig, its nominal level left out.

    They are one parameter wrong at a time, noise of measured rates, noise of the force, slow force, late measurements
    and pushes.
    """
    to_force, clock = _torque_to_force(rig), f"samples of {1e3 * rig.sample_time:g} ms"
    noise, force_noise, slow = rig.sensor_noise, rig.force_noise, rig.actuator_lag
    return (
        *(
            Axis(name=name, group="model", levels=_ERRORS, changes=_wrong(rig, name), words="error")
            for name in PARAMETERS
        ),
        *(
            Axis(name=name, group="model", levels=tuple(most * np.arange(1, 7) / 6), changes=_more(rig, name),
                 words=words)
            for (name, most), words in zip(frictions(rig).items(), ("N s/m", "N m s", "N m s", "N"), strict=True)
        ),
        Axis(name="velocity noise", group="velocity noise", levels=(0.1, 0.2, 0.3, 0.4, 0.5),
             changes=lambda levels: {"sensor_noise": np.maximum(noise, levels[..., None] * _RATES)},
             words="noise of rates, σ (m/s, rad/s)"),
        Axis(name="force noise", group="force noise", levels=tuple(1.1 * to_force * np.arange(1, 6) / 5),
             changes=lambda levels: {"force_noise": np.maximum(force_noise, levels)},
             words="noise of the force, σ (N)"),
        Axis(name="response", group="response", levels=(0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9),
             changes=lambda levels: {"actuator_lag": np.maximum(slow, lag(1 - levels, rig.sample_time))},
             words="force missing after a sample, 1 − k"),
        Axis(name="delay", group="delay", levels=(1.0, 2.0),
             changes=lambda levels: {"sensor_delay": rig.sensor_delay + np.rint(levels).astype(np.int64)},
             words=f"delay ({clock})"),
        Axis(name="pulses", group="pulses", levels=(0.02, 0.05, 0.1, 0.2, 0.5, 1.0),
             words=f"pulses, share of {5 * to_force:.0f} N and 5 N m", pulses=True, theirs=0.1),
    )  # fmt: skip


AXES = axes_of(RIG)
"""Those of the rig of the comparisons; names, groups and numbers of levels are the same on every rig."""

GROUPS = tuple(dict.fromkeys(axis.group for axis in AXES))
"""The six."""


def largest_pulse(rig: Rig) -> Array:
    """Return the largest push on the cart, N, and on each link, N m.

    They are RealAIGym's on a link, and its share of the limit on the cart.
    """
    return np.array([5.0 * _torque_to_force(rig), 5.0, 5.0])


class Pulses:
    r"""Six Gaussian pushes a run, :math:`\pm A e^{-(t-\mu)^2/2\sigma^2}`, two each on cart, link 1 and link 2.

    Of one start the moments, at least 1 s apart within 1 and 9 s, the widths, :math:`\sigma \sim U[0.05, 0.1]` s, and
    the signs are the same at every level and for every contender; the seed is what they are drawn from, start by start.
    """

    def __init__(self, starts: int, seed: int) -> None:
        drawn = [self._draw(np.random.default_rng([seed, 2, start])) for start in range(starts)]
        self.moments, self.widths, self.signs = (np.stack(each) for each in zip(*drawn, strict=True))

    @staticmethod
    def _draw(rng: np.random.Generator) -> tuple[Array, Array, Array]:
        gaps = 1.0 + (SECONDS - 7.0) / 6 * rng.random(6)
        return (
            rng.permutation(np.cumsum(gaps)).reshape(3, 2),
            rng.uniform(0.05, 0.1, (3, 2)),
            rng.choice([-1.0, 1.0], (3, 2)),
        )

    def pushing(self, levels: Array, rig: Rig = RIG) -> Callable[[float], Array]:
        """Return the pushes ``(starts * L, 3)`` over time at ``L`` levels, start by start."""
        largest = levels[:, None, None] * largest_pulse(rig)[:, None] * self.signs[:, None]

        def push(t: float) -> Array:
            shapes = np.exp(-0.5 * ((t - self.moments) / self.widths) ** 2)
            return (largest * shapes[:, None]).sum(axis=-1).reshape(-1, 3)

        return push


def task_of(task: TaskName, seconds: float = SECONDS, rig: Rig = RIG) -> Balance | SwingUp:
    """Return a task: balance from λ = 0.1, or swing up from hanging, both angles moved by up to 0.1 rad."""
    steps = round(seconds / rig.sample_time)
    return (
        Balance(lam=0.1, steps=steps) if task == "balance" else SwingUp(start="hanging", angle_spread=0.1, steps=steps)
    )


def _starts(task: Balance | SwingUp, n: int, seed: int, rig: Rig) -> Array:
    return task.starts(np.random.default_rng([seed, 1]), n, rig)


def evaluate(
    controller: Controller, task: Balance | SwingUp, axis: Axis, starts: int, seed: int, rig: Rig = RIG
) -> Array:
    """Return where a controller made for the nominal rig succeeds, ``(starts, levels)``, at every level of its axis.

    Starts, noise and pushes are drawn from the seed; fewer starts are the first of more.
    """
    levels = np.array(axis.levels)
    rows = np.tile(levels, starts)  # all levels of the first start come first
    push = Pulses(starts, seed).pushing(levels, rig) if axis.pulses else None
    runs = dpend.simulate_many(
        rig.replace(**axis.changes(rows)), controller, np.repeat(_starts(task, starts, seed, rig), len(levels), axis=0),
        task=task, push=push, seed=seed,
    )  # fmt: skip
    return runs.success.reshape(starts, len(levels)).astype(np.float64)


def measure(
    controller: Controller, task: TaskName, starts: int = 20, seed: int = 0, rig: Rig = RIG
) -> dict[str, Array]:
    """Return outcomes ``(starts, levels)`` on the nominal rig and along RealAIGym's six axes, by the axis' name."""
    of = task_of(task, rig=rig)
    return {axis.name: evaluate(controller, of, axis, starts, seed, rig) for axis in (NOMINAL, *axes_of(rig))}


def of_groups(outcomes: Mapping[str, Array]) -> dict[str, Array]:
    """Return the outcomes of each of the six side by side: ``(starts, settings)`` by group."""
    axes = {group: [outcomes[axis.name] for axis in AXES if axis.group == group] for group in GROUPS}
    return {group: np.concatenate(arrays, axis=1) for group, arrays in axes.items()}


def score(outcomes: Mapping[str, Array]) -> Estimate:
    """Return one number for robustness: success in perturbed settings, the mean over the six axes; nominal left out.

    It takes what :func:`measure` returns; a KeyError if an axis is missing.  The interval is Student's over starts, or
    Wilson's of all runs where that is wider.
    """
    groups = of_groups(outcomes).values()
    return mean_share(np.mean([of.mean(axis=1) for of in groups], axis=0), sum(of.size for of in groups))


def realaigym(outcomes: Mapping[str, Array]) -> float:
    """Return the score as RealAIGym counts it, to be read beside its leaderboard with care.

    A setting counts whole if more than half of its runs succeed, and the mean is over the six axes.  The nominal level
    counts as one setting of 21 where RealAIGym has it in its lists, which is in all but the response and the pulses.
    """
    won = float(outcomes[NOMINAL.name].mean() > 0.5)
    theirs = {axis.name: outcomes[axis.name][:, np.abs(axis.levels) >= axis.theirs - 1e-12] for axis in AXES}
    shares = {group: float((of.mean(axis=0) > 0.5).mean()) for group, of in of_groups(theirs).items()}
    plain = ("response", "pulses")
    return float(np.mean([share if of in plain else (20 * share + won) / 21 for of, share in shares.items()]))


WITHIN = 0.2
"""By how much everything may be wrong at once, as a share."""

_FACTORS = ("cart_mass", "mass1", "mass2", "length1", "length2", "com1", "com2", "force_limit")
UNCERTAIN = (*_FACTORS, *FRICTIONS)
"""What is drawn of each plant: factors within 1 ± :data:`WITHIN`, and frictions from zero to their greatest."""


def plants(n: int, seed: int, rig: Rig = RIG) -> dict[str, Array]:
    r"""Return plants that are wrong in everything at once, arrays ``(n,)`` by the names of :data:`UNCERTAIN`.

    Masses, lengths and the force limit are within a fifth of what is believed; the centres within a fifth of their
    place along the link; the inertias, where none are given, those of the links as rods, :math:`m L^2/12`; and to
    frictions anything from zero up is added.  It is a scrambled Sobol sequence, which covers evenly where ``n`` is a
    power of two.
    """
    points = stats.qmc.Sobol(len(UNCERTAIN), rng=np.random.default_rng([seed, 3])).random(n)
    drawn = dict(zip(UNCERTAIN, points.T, strict=True))
    known = {name: float(getattr(rig.params, name)) for name in _FACTORS[:5]} | {"force_limit": float(rig.force_limit)}
    found = {name: value * (1 + WITHIN * (2 * drawn[name] - 1)) for name, value in known.items()}
    for k, centre in zip("12", rig.params.centers, strict=True):
        place = float(centre) / known[f"length{k}"]
        found[f"com{k}"] = found[f"length{k}"] * place * (1 + WITHIN * (2 * drawn[f"com{k}"] - 1))
    return found | {name: getattr(rig.params, name) + most * drawn[name] for name, most in frictions(rig).items()}


def evaluate_on_plants(
    controller: Controller, task: Balance | SwingUp, n: int, starts: int, seed: int, rig: Rig = RIG
) -> Array:
    """Return where a controller made for the nominal rig succeeds on plants, ``(n, starts)``.

    ``n`` is a power of two, and fewer are the first of more; the starts on each plant are others.
    """
    true = rig.replace(**{name: np.repeat(values, starts) for name, values in plants(n, seed, rig).items()})
    x0 = _starts(task, n * starts, seed, rig)  # those of the first plant come first
    return dpend.simulate_many(true, controller, x0, task=task, seed=seed).success.reshape(n, starts).astype(np.float64)


def encoders(counts: npt.ArrayLike) -> Array:
    """Return the steps of encoders, m and rad, of so many counts a turn: infinite for no rounding, as rates have none.

    The cart's sits on a pulley of 0.2 m a turn.
    """
    return np.array([0.2, 2 * np.pi, 2 * np.pi, 0, 0, 0]) / np.asarray(counts, dtype=np.float64)


_FINE = {"resolution": encoders(2048)}


def sensors_of(rig: Rig) -> tuple[Axis, ...]:
    """Return the axes of sensors on a rig.

    They are noise of the measured positions; rounding by encoders; and, with encoders of 2048 counts, delay and a slow
    force.
    """
    noise, slow = rig.sensor_noise, rig.actuator_lag
    return (
        Axis(name="noise", group="sensors", levels=(0.002, 0.005, 0.01, 0.02, 0.05),
             changes=lambda levels: {"sensor_noise": np.maximum(noise, levels * _POSITIONS)},
             words="noise of positions, σ (m, rad)"),
        Axis(name="encoders", group="sensors", levels=tuple(1 / counts for counts in (1024, 256, 128, 64, 32)),
             changes=lambda levels: {"resolution": encoders(1 / levels)}, words="counts a turn"),
        Axis(name="delay", group="sensors", levels=(1.0, 2.0, 3.0),
             changes=lambda levels: _FINE | {"sensor_delay": int(rig.sensor_delay) + round(float(levels))},
             words=f"delay (samples of {1e3 * rig.sample_time:g} ms)"),
        Axis(name="lag", group="sensors", levels=(0.4, 0.6, 0.7, 0.8),
             changes=lambda levels: _FINE | {"actuator_lag": max(float(slow), float(lag(1 - levels, rig.sample_time)))},
             words="force missing (1 − k)"),
    )  # fmt: skip


SENSORS = sensors_of(RIG)
"""Those of the rig of the comparisons; names and levels are the same on every rig."""

View = Callable[[Rig, Controller], Controller]

VIEWS: dict[str, View] = {
    "rates measured": lambda rig, controller: controller,
    "differences": lambda rig, controller: WithEstimator(Differences(rig), controller),
    "differences, Predictor": lambda rig, controller: WithEstimator(
        Differences(rig), WithEstimator(Predictor(rig), controller)
    ),
    "EKF": lambda rig, controller: WithEstimator(EKF(rig), controller),
    "UKF": lambda rig, controller: WithEstimator(UKF(rig), controller),
}
"""What stands between sensors and controller.  The first has rates measured without error beside the positions; the
others have positions only, and know plant, noise, rounding, delay and lag."""


def views(axis: Axis) -> tuple[str, ...]:
    """Return the names of the views that differ on an axis: prediction does something only about delay."""
    return tuple(name for name in VIEWS if "Predictor" not in name or axis.name == "delay")


def evaluate_with_sensors(
    controller: Controller, task: Balance | SwingUp, axis: Axis, view: str, starts: int, seed: int, rig: Rig = RIG
) -> Array:
    """Return where a controller succeeds, ``(starts, levels)``, at every level of a sensor axis through one view.

    Starts and noise are drawn from the seed: the same at every level and for every view.
    """
    x0 = _starts(task, starts, seed, rig)
    columns = []
    for level in axis.levels:
        true = rig.replace(**axis.changes(np.array(level)))
        columns.append(dpend.simulate_many(true, VIEWS[view](true, controller), x0, task=task, seed=seed).success)
    return np.stack(columns, axis=1).astype(np.float64)
