"""Which deep learners swing the double pendulum up, and after how much experience?

Method: the trainings in ``docs/results/deep`` (``--runs``, made by ``python -m rl.train``) on 1000 fresh starts on
gustafsson2016.  Swing-up: half hanging, half horizontal, ±0.05 rad, ten seconds, the last of them within 0.2 rad of
upright; balancing: λ = 0.3, 300 samples.  Each also balances from λ = 0.1, with perfect sensors and with noise of 0.002
on every state.  Intervals are 95 % over trainings; variation is that of the force, beside it the least that any force
can have on the linearized plant, by linear programming.

Finding: PPO swings up 99.4 % [98.6, 100.0] of the starts (five trainings, 8 million steps at most), 100.0 % [99.9,
100.0] where episodes began at rest alone; DDPG 100 % in four of five of 180 000 to 280 000 steps, 97 % in the fifth,
and after 100 000 four of five 99.6 to 100 %.  TD3 and SAC learn it in one and two of five.  A penalty on changes of
force with CAPS keeps 99.7 % [99.0, 100.0] and has 0.25 of plain PPO's variation while it stands under noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.ticker import EngFormatter
from scipy import sparse
from scipy.optimize import linprog

import dpend
from controllers import LQR
from dpend.linear import discretize, linearize
from dpend.metrics import force_metrics
from dpend.params import Array
from rl.deep import evaluate, read_recipe

from . import _runner
from ._estimates import mean_share
from ._field import styles_of_recipes
from ._figures import MOST, facets, legend_above, parts, share_axis
from ._plant import Plant, rig_of
from ._runner import AtLeastTwo, Report, Result, Table
from ._tables import Value, sheet
from ._trainings import RUNS, Kept, kept

MINUTES = 1

LQR_BALANCE = "LQR, Q = I, R = 1, balance"
LEAST = "least variation"

_NOISE = 0.002
_STREAM = 9241  # sets these starts apart from those of training and evaluation
_GENTLE = dpend.Balance(lam=0.1)
_LEVELS = {"steps_to_half": 0.5, "steps_to_most": 0.95}
_VARIATIONS = {
    "variation": "last 4 s", "balancing": "balancing", "balancing_noisy": "with noise", "standing_noisy": "standing"
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Options(_runner.Options):
    """Options of the command line."""

    needs = ("force_limit",)

    runs: Path = RUNS  # Folder of the trainings.
    starts: AtLeastTwo = 1000  # Fresh starts on which each policy is evaluated.

    def __post_init__(self) -> None:
        super().__post_init__()
        if not kept(self.runs):
            raise ValueError(f"--runs {self.runs} holds no trainings; make some with python -m rl.train.")
        if self.elsewhere and not self.trainings():
            raise ValueError(
                f"--runs {self.runs} holds no trainings on {self.elsewhere.name}, and what was trained on "
                f"another plant says nothing of this; make some with python -m rl.train --rig {self.rig}."
            )

    def trainings(self) -> dict[str, list[Kept]]:
        """Return the trainings in the simulator on the rig, by recipe."""
        recipes = {name: read_recipe(Path(found[0].place)) for name, found in kept(self.runs).items()}
        own = {name for name, recipe in recipes.items() if recipe.env is None and recipe.rig == self.plant.rig}
        return {name: found for name, found in kept(self.runs).items() if name in own}


@dataclass(frozen=True)
class Job:
    """One training, or what trainings are compared with."""

    learner: str
    training: int  # its seed
    starts: int
    seed: int
    kept: Kept | None = None
    elsewhere: Plant | None = None


@dataclass(frozen=True, kw_only=True)
class Row:
    """What a policy does, and what its training cost."""

    successes: int = 0
    variation: float = math.nan  # over the last four seconds of the runs that succeed, in force limits per second
    balanced: int = 0  # how many of as many starts at λ = 0.1 it balances
    balanced_noisy: int = 0
    balancing: float = math.nan  # the variation from λ = 0.1; NaN where no run succeeds
    balancing_noisy: float = math.nan
    standing_noisy: float = math.nan  # that of the last four seconds
    steps: int = 0  # environment steps of the whole training
    steps_to_best: int = 0
    steps_to_half: int = -1  # steps until an evaluation first saw half of its starts succeed; -1 where none did
    steps_to_most: int = -1  # the same for 95 %
    step_seconds: float = 0.0  # simulated time in a step, s
    test_seconds: float = 0.0  # simulated time of the evaluations that chose the policy, at most, s
    cpu_seconds: float = 0.0
    wall_seconds: float = 0.0


def jobs(options: Options) -> list[Job]:
    """List the work: the least variation, the trainings on the rig, and LQR."""
    n, few = (20, 2) if options.quick else (options.starts, 50)
    own, plant = options.trainings(), options.elsewhere
    if options.quick:
        own = {name: found[:1] for name, found in list(own.items())[:3]}
    trained = [Job(name, each.seed, n, options.seed, each, plant) for name, found in own.items() for each in found]
    beside = [Job(name, 0, min(n, most), options.seed, None, plant) for name, most in ((LEAST, few), (LQR_BALANCE, n))]
    return [beside[0], *trained, beside[1]]


def run(job: Job) -> Result:
    """Evaluate a policy on fresh starts, and read what its training left."""
    rig, task, arrays = rig_of(job.elsewhere), "balance", {}
    learned: dict[str, Any] = {"step_seconds": float(rig.sample_time)}
    controller: dpend.Controller = LQR(rig)
    if job.learner == LEAST:
        least = np.mean([least_variation(rig, x0) for x0 in _starts(rig, job.starts, job.seed)])
        return Result([Row(balancing=float(least))])
    if job.kept:
        training, recipe = job.kept.read(), read_recipe(Path(job.kept.place))
        rig, task, controller, curve = recipe.rig, recipe.task, training.policy, training.curve
        arrays = {name: curve[name] for name in ("steps", "success")}
        learned = {name: curve[name][-1].item() for name in ("steps", "cpu_seconds", "wall_seconds")} | {
            "steps_to_best": curve["steps"][training.details["best"]].item(),
            "step_seconds": recipe.period,
            "test_seconds": training.cost.test_steps * training.cost.sample_time,
        }
        for name, level in _LEVELS.items():
            learned[name] = next(iter(curve["steps"][curve["success"] >= level].tolist()), -1)
    success, variation = evaluate(controller, task, rig, job.starts, [_STREAM, job.seed])
    balanced, balancing, _ = _balance(rig, controller, job)
    balanced_noisy, balancing_noisy, standing_noisy = _balance(rig.replace(sensor_noise=_NOISE), controller, job)
    row = Row(
        successes=round(success * job.starts), variation=variation, balanced=balanced, balanced_noisy=balanced_noisy,
        balancing=balancing, balancing_noisy=balancing_noisy, standing_noisy=standing_noisy, **learned,
    )  # fmt: skip
    return Result([row], arrays)


def _starts(rig: dpend.Rig, n: int, seed: int) -> Array:
    return _GENTLE.starts(np.random.default_rng([_STREAM, seed, 1]), n, rig)


def _balance(rig: dpend.Rig, controller: dpend.Controller, job: Job) -> tuple[int, float, float]:
    """Return how many runs from λ = 0.1 succeed, and their mean variation, of all and of the last four seconds."""
    runs = dpend.simulate_many(rig, controller, _starts(rig, job.starts, job.seed), task=_GENTLE, seed=job.seed)
    if not runs.success.any():
        return 0, math.nan, math.nan
    last = runs.u[runs.success, -round(4.0 / rig.sample_time) :]
    of_last = force_metrics(last, rig.sample_time, rig.force_limit)["variation"]
    return int(runs.success.sum()), float(runs.metrics()["variation"][runs.success].mean()), float(of_last.mean())


def least_variation(rig: dpend.Rig, x0: Array) -> float:
    r"""Return the least variation of a force that balances the linearized plant, in force limits per second.

    .. math:: \min_u \frac{1}{T u_\max}\sum_{k=1}^{N-1} |u_k - u_{k-1}|
              \quad\text{with}\quad x_{k+1} = A x_k + B u_k,\ |u_k| \le u_\max,

    cart and links within the limits of :class:`dpend.Balance` for its :math:`N` samples; infinite where no force does.
    The force before the first sample is free, as it is in the metric, and nothing is asked of the end.
    """
    samples = _GENTLE.steps
    A, B = discretize(*linearize(rig.params), rig.sample_time)
    # Unknown are x_1 .. x_N, u_0 .. u_{N-1} and bounds on the N - 1 changes.
    changes = sparse.eye_array(samples - 1)
    over_time, each = sparse.eye_array(samples, k=-1), sparse.eye_array(samples)
    states = sparse.eye_array(6 * samples) - sparse.kron(over_time, A)
    dynamics = sparse.hstack([states, -sparse.kron(each, B), sparse.csr_array((6 * samples, samples - 1))])
    from_start = np.zeros(6 * samples)
    from_start[:6] = A @ x0
    differences = sparse.eye_array(samples - 1, samples, k=1) - sparse.eye_array(samples - 1, samples)
    no_states = sparse.csr_array((samples - 1, 6 * samples))
    sides = [sparse.hstack([no_states, sign * differences, -changes]) for sign in (1.0, -1.0)]
    limits = [float(rig.track_limit), *map(float, _GENTLE.angle_limits), math.inf, math.inf, math.inf] * samples
    limits += [float(rig.force_limit)] * samples
    found = linprog(
        np.concatenate([np.zeros(7 * samples), np.ones(samples - 1)]),
        A_ub=sparse.vstack(sides), b_ub=np.zeros(2 * (samples - 1)), A_eq=dynamics, b_eq=from_start,
        bounds=[*((-limit, limit) for limit in limits), *[(0.0, math.inf)] * (samples - 1)],
    )  # fmt: skip
    return found.fun / float(rig.force_limit) / (samples * rig.sample_time) if found.status == 0 else math.inf


def report(table: Table) -> Report:
    """Draw success against environment steps, a panel a kind of learner; tabulate success, and what learning cost."""
    names = dict.fromkeys(table.rows["learner"])
    longest = {name: int(table.where(learner=name)["steps"].to_numpy().max()) for name in names}
    order = [name for name in longest if name not in (LQR_BALANCE, LEAST)]
    kinds: dict[str, list[str]] = {}
    for name in order:
        kinds.setdefault(_kind(name), []).append(name)
    panels = [(kind, part) for kind, of in kinds.items() for part in parts(of, MOST)]
    figure, axes = facets(max(len(panels), 1), height=0.3 + 2.5 * max(len(panels), 1))
    for axis, (kind, panel) in zip(axes[:, 0], panels, strict=False):
        for name, (colour, _, line) in styles_of_recipes(panel).items():
            curves = list(zip(table.arrays("steps", learner=name), table.arrays("success", learner=name), strict=True))
            for curve in curves if len(curves) > 1 else ():
                axis.plot(*curve, color=colour, lw=0.5, alpha=0.4)
            axis.plot(*_median(curves), color=colour, ls=line, lw=1.8, label=f"{name} ({len(curves)})")
        share_axis(axis, "starts that succeed")
        axis.set_xlim(0, None)
        axis.xaxis.set_major_formatter(EngFormatter(sep=" "))
        legend_above(axis, 3, kind)
    axes[-1, 0].set_xlabel("environment steps")
    shown = [*order, *(name for name in (LQR_BALANCE, LEAST) if name in longest)]
    title = "Fresh starts that succeed, and what learning cost"
    note = (
        "medians over trainings, to 95 % of those (n) that come there; at λ = 0.1 balanced; variation, in force limits "
        "per second: last 4 s of runs that succeed, balancing from λ = 0.1, with noise, its last 4 s (standing)"
    )
    brief = ("learner", "trainings", "success, %", "to 95 %", "steps", "CPU s")
    return Report(figures=figure, tables=[sheet(title, [_line(table, name) for name in shown], note=note, brief=brief)])


def _kind(recipe: str) -> str:
    """Return the title of the panel in which a recipe's trainings are drawn."""
    algorithm = recipe.partition("-")[0]
    if algorithm in ("sac", "td3"):
        return "TD3 and SAC"
    return algorithm.upper() + (", changes of force penalised" if "smooth" in recipe else "")


def _median(curves: list[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Return the median over trainings; one that was good enough and ended counts on with its last evaluation."""
    longest = max((steps for steps, _ in curves), key=len)
    columns = [np.pad(success, (0, len(longest) - len(success)), mode="edge") for _, success in curves]
    return longest, np.median(columns, axis=0)


def _line(table: Table, learner: str) -> dict[str, Value]:
    own = table.where(learner=learner)
    middle: Any = own.median(numeric_only=True)
    variations: dict[str, Value] = {heading: middle[column] for column, heading in _VARIATIONS.items()}
    if learner == LEAST:
        return {"learner": learner} | variations
    shares, to_most = own["successes"] / own["starts"], own["steps_to_most"].to_numpy()
    there = to_most[to_most > 0]
    return {
        "learner": learner, "trainings": len(own), "success, %": mean_share(shares, own["starts"]),
        "each, %": " ".join(f"{100 * each:.1f}" for each in shares),
        "λ = 0.1, %": middle["balanced"] / middle["starts"],
        "λ = 0.1, noise, %": middle["balanced_noisy"] / middle["starts"], **variations,
        "to 95 %": f"{np.median(there):,.0f} ({len(there)})" if len(there) else None,
        "steps": round(middle["steps"]) or None, "CPU s": round(middle["cpu_seconds"]) or None,
    }  # fmt: skip


if __name__ == "__main__":
    _runner.main("studies.deep_swing_up")
