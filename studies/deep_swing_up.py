"""Which deep learners swing the double pendulum up, and after how much experience?

Method: every training under ``docs/results/deep`` (``--runs``) was made by ``python -m rl.train`` from zero knowledge
and kept its evaluation curve and its best policy, chosen on starts of its own.  Here each policy meets 1000 fresh
starts on gustafsson2016: for the swing-up half hanging and half level to the side, each angle within 0.05 rad, ten
seconds, the last of them with both links within 0.2 rad of upright; for balancing θ1, θ2 ~ U[-0.3, 0.3] for 300
samples.  Each also meets as many starts with θ1, θ2 ~ U[-0.1, 0.1], to be balanced for 300 samples with perfect sensors
and with noise of 0.002 (m, rad, m/s, rad/s) on every measured state.  Intervals are 95 % over trainings.  Variation is
the total variation of the force: over the last four seconds of the runs that succeed; while balancing from those
starts, with perfect sensors and with noise; and over the last four seconds of the latter, when the start is forgotten.
Beside stands the least that any force can have in such 300 samples, by linear programming on the linearised plant.

Finding: PPO swings up 99.4 % [98.6, 100.0] of the starts (five trainings of at most 8 million steps, two minutes of
processor time), and 100.0 % [99.9, 100.0] where its episodes began at rest alone (five of 2.6 to 3.9 million); DDPG
100 % in four of five trainings of 180 000 to 280 000 steps, 97 % in the fifth.  At most 100 000 steps suffice four of
five for 99.6 to 100 %, with mirrored transitions, short episodes and an update for every step.  TD3 and SAC, in JAX,
learn it in one and two of five trainings of at most 500 000.  A penalty on changes of force near upright, learned with
sensor noise and CAPS, keeps 99.7 % [99.0, 100.0] (four trainings) and has 0.25 of plain PPO's variation while it stands
under noise; catching the start included 0.40, and with perfect sensors 1.57, where a third would be less than the least
that any force can have.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, PercentFormatter
from rich.console import RenderableType
from rich.table import Table
from scipy import sparse
from scipy.optimize import linprog

import dpend
from controllers import LQR
from dpend.linear import discretize, linearize
from dpend.metrics import force_metrics
from dpend.params import Array
from rl import MLPPolicy, load_policy
from rl.deep import Evaluation, evaluate, read_curve

from . import _study
from ._intervals import over_seeds
from ._study import Job, Result, Traces

RUNS = Path("docs/results/deep")
"""Where the trainings are kept, seen from the repository, a folder each: what was learned by what, and the seed."""

_EVALUATED = {"swing-up": 10.0, "balance": 6.0}  # s, see rl.deep.evaluate
_FRESH = 1000  # starts
_NOISE = 0.002
_LQR = "LQR, Q = I, R = 1, balance"
_LEAST = "least variation"
_UNTRAINED = Evaluation(0, 0.0, 0.0, np.nan, 0.0, 0.0)
_STREAM = 9241  # sets these starts apart from those of training and evaluation
_VARIATIONS = ("variation", "balancing", "balancing_noisy", "standing_noisy")
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#000000", "#56B4E9", "#777777")
_LINES = ("-", "--", "-.", ":", (0, (6, 1, 1, 1)), (0, (1, 1)), (0, (8, 2)), (0, (4, 1, 1, 1, 1, 1)))


@dataclass(frozen=True, kw_only=True)
class Options(_study.Options):
    """What can be told on the command line."""

    runs: Path = RUNS
    """Folder of the trainings."""
    starts: int = _FRESH
    """Fresh starts that each policy meets."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.starts < 2:
            raise ValueError(f"--starts must be at least 2; got {self.starts}.")
        if not list(self.runs.glob("*/seed-*/policy.npz")):
            raise ValueError(f"--runs {self.runs} holds no trainings; make some with python -m rl.train.")


@dataclass(frozen=True, kw_only=True)
class Row:
    """One training."""

    learner: str
    training: int
    """Its seed."""
    starts: int
    successes: int = 0
    variation: float = math.nan
    """Of the force, over the last four seconds of the runs that succeed, in force limits per second."""
    balanced: int = 0
    """How many of as many starts at λ = 0.1 it balances."""
    balanced_noisy: int = 0
    """The same with sensor noise."""
    balancing: float = math.nan
    """The variation while balancing from λ = 0.1; NaN where no run succeeds."""
    balancing_noisy: float = math.nan
    """The same with sensor noise."""
    standing_noisy: float = math.nan
    """The same over the last four seconds."""
    steps: int = 0
    """Environment steps of the whole training."""
    steps_to_best: int = 0
    steps_to_half: int = -1
    """Steps until an evaluation first saw half of its starts succeed; -1 where none did."""
    steps_to_most: int = -1
    """The same for 95 %."""
    step_seconds: float = 0.0
    """Simulated time in a step, s."""
    test_seconds: float = 0.0
    """Simulated time of the evaluations that chose the policy, at most, s."""
    cpu_seconds: float = 0.0
    wall_seconds: float = 0.0


def jobs(options: Options) -> list[Job]:
    """List the work: the trainings of our own plant, LQR, and the least variation."""
    found = []
    for file in sorted(options.runs.glob("*/seed-*/policy.npz"), key=lambda file: (file.parts[-3], _seed(file))):
        if not json.loads((file.parent / "recipe.json").read_text(encoding="utf-8"))["recipe"]["env"]:
            found.append(Job(file.parts[-3], _seed(file)))
    if options.quick:
        first = {job.setting: job for job in reversed(found)}
        found = list(first.values())[:3]
    return [*found, Job(_LQR), Job(_LEAST)]


def _seed(file: Path) -> int:
    return int(file.parts[-2].removeprefix("seed-"))


def run(job: Job, options: Options) -> Result:
    """Meet fresh starts, and read what the training wrote."""
    n = 20 if options.quick else options.starts
    rig, task, curve, best, period = dpend.rig("gustafsson2016"), "balance", [_UNTRAINED], 0, 0.0
    tests = 0.0
    if job.setting == _LEAST:
        starts = _starts(rig, n, options.seed)[: 2 if options.quick else 50]
        least = float(np.mean([least_variation(rig, x0) for x0 in starts]))
        return Result([Row(learner=_LEAST, training=0, starts=len(starts), balancing=least)])
    if job.setting == _LQR:
        controller: dpend.Controller = LQR(rig)
        period = rig.sample_time
    else:
        folder = options.runs / job.setting / f"seed-{job.repetition}"
        policy = load_policy(folder / "policy.npz")
        assert isinstance(policy, MLPPolicy)
        controller = policy
        recipe = policy.about["recipe"]
        rig, task, period = dpend.Rig.from_dict(recipe["rig"]), recipe["task"], policy.period
        curve, best = read_curve(folder / "curve.csv"), policy.about["evaluation"]["steps"]
        tests = len(curve) * recipe["evaluation_starts"] * _EVALUATED[task]
    success, variation = evaluate(controller, task, rig, n, [_STREAM, options.seed])
    perfect = _balancing(rig, controller, n, options.seed)
    noisy = _balancing(rig.replace(sensor_noise=_NOISE), controller, n, options.seed)
    row = Row(
        learner=job.setting,
        training=job.repetition,
        starts=n,
        successes=round(success * n),
        variation=variation,
        balanced=perfect.successes,
        balanced_noisy=noisy.successes,
        balancing=perfect.variation,
        balancing_noisy=noisy.variation,
        standing_noisy=noisy.standing,
        steps=curve[-1].steps,
        steps_to_best=best,
        steps_to_half=next((seen.steps for seen in curve if seen.success >= 0.5), -1),
        steps_to_most=next((seen.steps for seen in curve if seen.success >= 0.95), -1),
        step_seconds=period,
        test_seconds=tests,
        cpu_seconds=curve[-1].cpu_seconds,
        wall_seconds=curve[-1].wall_seconds,
    )
    traces = {"steps": np.array([seen.steps for seen in curve]), "success": np.array([seen.success for seen in curve])}
    return Result([row], traces)


_GENTLE = dpend.Balance(lam=0.1)


class _Balanced(NamedTuple):
    """What balancing from λ = 0.1 took: runs that succeed, and their mean variation, of all and of the last four s."""

    successes: int
    variation: float
    standing: float


def _starts(rig: dpend.Rig, n: int, seed: int) -> Array:
    return _GENTLE.starts(np.random.default_rng([_STREAM, seed, 1]), n, rig)


def _balancing(rig: dpend.Rig, controller: dpend.Controller, n: int, seed: int) -> _Balanced:
    runs = dpend.simulate_many(rig, controller, _starts(rig, n, seed), task=_GENTLE, seed=seed)
    if not runs.success.any():
        return _Balanced(0, math.nan, math.nan)
    last = runs.u[runs.success, -round(4.0 / rig.sample_time) :]
    of_last = force_metrics(last, rig.sample_time, rig.force_limit)["variation"]
    variation = runs.metrics()["variation"][runs.success]
    return _Balanced(int(runs.success.sum()), float(variation.mean()), float(of_last.mean()))


def least_variation(rig: dpend.Rig, x0: Array) -> float:
    r"""Return the least variation of a force that balances the linearised plant, in force limits per second.

    .. math:: \min_u \frac{1}{T u_\max}\sum_{k=1}^{N-1} |u_k - u_{k-1}|
              \quad\text{with}\quad x_{k+1} = A x_k + B u_k,\ |u_k| \le u_\max,

    cart and links within the limits of :class:`dpend.Balance` for its :math:`N` samples.  The force before the first
    sample is free, as it is in the metric, and nothing is asked of the end.

    Parameters
    ----------
    rig : Rig
        The rig.
    x0 : ndarray (6,)
        The start.

    Returns
    -------
    float
        Infinite where no force balances it.
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
        A_ub=sparse.vstack(sides),
        b_ub=np.zeros(2 * (samples - 1)),
        A_eq=dynamics,
        b_eq=from_start,
        bounds=[*((-limit, limit) for limit in limits), *[(0.0, math.inf)] * (samples - 1)],
    )
    return found.fun / float(rig.force_limit) / (samples * rig.sample_time) if found.status == 0 else math.inf


def shipped() -> list[Row]:
    """Return the table of trainings that is shipped."""
    rows: list[Row] = _study.read_rows(_study.kept_table("deep_swing_up"), Row)
    return rows


def plot(rows: list[Row], traces: Traces) -> Figure:
    """Draw success against environment steps: medians over trainings, each training thin; PPO below the others."""
    names = [name for name in dict.fromkeys(row.learner for row in rows) if name not in (_LQR, _LEAST)]
    panels = [[name for name in names if name.startswith("ppo") == of_ppo] for of_ppo in (False, True)]
    panels = [panel for panel in panels if panel]
    figure = Figure(figsize=(6.3, 3.4 * len(panels)), layout="constrained")
    axes: list[Axes] = list(figure.subplots(len(panels), 1, squeeze=False)[:, 0])
    for axis, panel in zip(axes, panels, strict=True):
        for name, colour, line in zip(panel, _COLOURS, _LINES, strict=False):
            own = [traces[_study.slug(Job(name, row.training))] for row in rows if row.learner == name]
            for trace in own if len(own) > 1 else ():
                axis.plot(trace["steps"], trace["success"], color=colour, lw=0.5, alpha=0.4)
            steps, median = _median(own)
            axis.plot(steps, median, color=colour, ls=line, lw=1.8, label=f"{name} ({len(own)})")
        axis.set(ylabel="starts that succeed", xlim=(0, None), ylim=(-0.03, 1.03))
        axis.xaxis.set_major_formatter(
            FuncFormatter(lambda steps, _: f"{steps / 1e6:g} M" if steps >= 1e6 else f"{steps / 1e3:g} k")
        )
        axis.yaxis.set_major_formatter(PercentFormatter(1.0))
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
    axes[-1].set_xlabel("environment steps")
    return figure


def _median(traces: list[dict[str, Array]]) -> tuple[Array, Array]:
    """Return the median over trainings; one that was good enough and ended counts on with its last evaluation."""
    longest = max((trace["steps"] for trace in traces), key=len)
    columns = [np.pad(trace["success"], (0, len(longest) - len(trace["success"])), mode="edge") for trace in traces]
    return longest, np.median(columns, axis=0)


def summary(rows: list[Row], traces: Traces) -> RenderableType:
    """Condense the table: success with its interval, by learner, and what learning cost."""
    table = Table(
        title="Fresh starts that succeed, %, and 95 % interval over trainings; medians over trainings of: balanced "
        "starts at λ = 0.1, %, with perfect sensors and with noise; variation of the force in force limits per second "
        "(last 4 s of swing-ups, balancing, balancing with noise, standing with noise); "
        "steps to 95 % (of how many), steps, processor time"
    )
    for heading in (
        "learner",
        "trainings",
        "success",
        "each",
        "λ = .1",
        "variation",
        "to 95 %",
        "steps",
        "CPU s",
    ):
        table.add_column(heading, justify="left" if heading == "learner" else "right")
    for learner in dict.fromkeys(row.learner for row in rows):
        own = [row for row in rows if row.learner == learner]
        rate = over_seeds([row.successes for row in own], own[0].starts)
        reached = [row.steps_to_most for row in own if row.steps_to_most > 0]
        table.add_row(
            learner,
            str(len(own)),
            *(
                (
                    f"{100 * rate.share:.1f}\n\\[{100 * rate.low:.1f}, {100 * rate.high:.1f}]",
                    " ".join(f"{100 * row.successes / row.starts:.1f}" for row in own),
                    "\n".join(
                        f"{100 * np.median([getattr(row, name) for row in own]) / own[0].starts:.1f}"
                        for name in ("balanced", "balanced_noisy")
                    ),
                )
                if learner != _LEAST
                else ("-", "-", "-")
            ),
            "\n".join(_middle([getattr(row, name) for row in own]) for name in _VARIATIONS),
            f"{np.median(reached):,.0f} ({len(reached)})" if reached else "-",
            f"{np.median([row.steps for row in own]):,.0f}",
            f"{np.median([row.cpu_seconds for row in own]):.0f}",
        )
    return table


def _middle(values: list[float]) -> str:
    """Return the median of what is known."""
    known = [value for value in values if np.isfinite(value)]
    return f"{np.median(known):.3g}" if known else "-"


if __name__ == "__main__":
    _study.main("studies.deep_swing_up")
