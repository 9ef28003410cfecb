"""How do LQR and the report's linear Q-learning compare as the starting spread λ grows?

Method: every controller balances gustafsson2016 from θ1, θ2 ~ U[-λ, λ] for 300 samples of 0.02 s, and saves a start if
neither link falls and the cart stays on its track.  The classical controllers meet all starts; the k-th trained
Q-controller meets the k-th part of them, 100 each by default as in the report, so that all face the same.  Intervals
are 95 %: Wilson's for one controller, Student's over trainings for learned ones.

Why Q-learning is bang-bang: each feature of the report's Table 1 is constant or linear in the action, so
q(s, a) = c(s) + a g(s) is a straight line over the actions.  Its greatest value is always at an end of the action set,
so the greedy force is always +40 or -40 N.  No training can make it smooth; features with a² could.

Finding: LQR saves 100/99.9/87.3/67.3 % at λ = .1/.2/.3/.4, Q-learning tuned 100/98.4/82.2/61.3 % (100 of 100 trainings
converge, by search and select), the report 94/92/78/49 %; as published no training converges (0 of 100).  From
``--controllers 100 --episodes 1000 --plain --seed 2``, kept in docs/results/lambda_sweep_100.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from rich.console import Group, RenderableType
from rich.table import Table

import dpend
from controllers import ILQRMPC, LQR, BangBang
from dpend.params import Array
from dpend.tasks import check_lam
from rl import LSPI, GaussianQAC, LinearQLearning

from . import _study
from ._intervals import Rate, over_seeds, wilson
from ._study import Job, Result, Traces

TABLE2 = {0.1: 0.94, 0.2: 0.92, 0.3: 0.78, 0.4: 0.49}
"""The report's Table 2: share of successful episodes by λ, ten trained controllers, 100 episodes each."""

CLASSICAL = {
    "LQR": lambda rig: LQR(rig),
    "sign of LQR": lambda rig: BangBang(LQR(rig), rig.force_limit),
    "sign of stiff LQR": lambda rig: BangBang(LQR(rig, Q=(1, 10, 10, 1, 1, 1), R=0.1), rig.force_limit),
    "iLQR MPC": lambda rig: ILQRMPC(rig, upright_only=True),
}
"""Controllers that are designed; the third shows what a force of ±40 N alone can save, the last what planning can."""

SLOW = ("iLQR MPC",)
"""Those that treat one run at a time; they meet the first of the starts only."""

LEARNED = {
    "Q published": lambda rig: LinearQLearning.published(rig),
    "Q tuned": lambda rig: LinearQLearning.tuned(rig),
    "Q tuned, plain rule": lambda rig: LinearQLearning.tuned(rig, select=False),
    "QAC tuned": lambda rig: GaussianQAC.tuned(rig),
    "LSPI": lambda rig: LSPI(rig),
}
"""Learners; the plain rule takes part on demand and shows what acceptance tests and restarts do for the one before."""

_WORDS = {
    "LQR": "LQR, Q = I, R = 1",
    "sign of LQR": "sign of that LQR",
    "sign of stiff LQR": "sign of a stiffer LQR (R = 0.1)",
    "iLQR MPC": "iLQR MPC",
    "Q published": "Q-learning as published",
    "Q tuned": "Q-learning tuned",
    "Q tuned, plain rule": "Q-learning tuned, plain rule",
    "QAC tuned": "Gaussian QAC tuned",
    "LSPI": "LSPI, quadratic features",
}

# Okabe and Ito's colours; markers and line styles tell the curves apart without them.
_STYLES = {
    "LQR": ("#0072B2", "o", "-"),
    "sign of LQR": ("#E69F00", "s", "--"),
    "sign of stiff LQR": ("#D55E00", "^", "--"),
    "iLQR MPC": ("#000000", "X", "-"),
    "Q published": ("#777777", "v", ":"),
    "Q tuned": ("#009E73", "D", "-."),
    "Q tuned, plain rule": ("#8C6D1F", "P", "-."),
    "QAC tuned": ("#CC79A7", "*", (0, (6, 1, 1, 1))),
    "LSPI": ("#56B4E9", "p", "-"),
}

_TRACE_LAM, _TRACE_SECONDS = 0.1, 2.0


@dataclass(frozen=True, kw_only=True)
class Options(_study.Options):
    """What can be told on the command line."""

    lam: tuple[float, ...] = (0.1, 0.2, 0.3, 0.4)
    """Spreads of the starting angles, rad."""
    controllers: int = 10
    """Trainings of each learner."""
    episodes: int = 100
    """Starts that each trained controller meets at each spread."""
    slow_starts: int = 200
    """Starts that a controller which treats one run at a time meets at each spread."""
    plain: bool = False
    """Add the tuned learner with the plain rule of convergence: 20 successes in a row, no tests, no restarts."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.lam:
            raise ValueError("--lam needs at least one spread.")
        for lam in self.lam:
            check_lam(lam)
        if len(set(self.lam)) < len(self.lam):
            raise ValueError(f"--lam names a spread twice; got {self.lam}.")
        for name in ("controllers", "episodes", "slow_starts"):
            if getattr(self, name) < 1:
                raise ValueError(f"--{name.replace('_', '-')} must be at least 1; got {getattr(self, name)}.")

    @property
    def sizes(self) -> tuple[int, int]:
        """Trainings of each learner, and starts of each; few where it must be quick."""
        return (min(self.controllers, 2), min(self.episodes, 20)) if self.quick else (self.controllers, self.episodes)


@dataclass(frozen=True, kw_only=True)
class Row:
    """One controller at one spread."""

    controller: str
    training: int
    lam: float
    episodes: int
    successes: int
    """Starts saved: neither link fell."""
    successes_report: int
    """Starts saved by the report's criterion, which looks at link 1 alone."""
    outcome: str
    """How the training ended; a dash where there was none."""
    training_episodes: int
    training_steps: int
    test_steps: int


def jobs(options: Options) -> list[Job]:
    """List the work: each classical controller once, each learner once a training."""
    learners = [name for name in LEARNED if options.plain or name != "Q tuned, plain rule"]
    return [Job(name) for name in CLASSICAL] + [Job(name, k) for name in learners for k in range(options.sizes[0])]


def run(job: Job, options: Options) -> Result:
    """Train where there is something to train, then meet the starts of every spread."""
    rig = dpend.rig("gustafsson2016")
    trainings, episodes = options.sizes
    outcome, training_cost = "-", (0, 0, 0)
    if job.setting in LEARNED:
        training = LEARNED[job.setting](rig).train([options.seed, 2, job.repetition])
        controller: dpend.Controller = training.policy
        outcome = training.outcome.name.lower().replace("_", " ")
        training_cost = training.episodes, training.steps, training.test_steps
        mine = slice(job.repetition * episodes, (job.repetition + 1) * episodes)
    else:
        controller = CLASSICAL[job.setting](rig)
        mine = slice((2 if options.quick else options.slow_starts) if job.setting in SLOW else None)
    rows = []
    for lam in options.lam:
        task = dpend.Balance(lam=lam)
        starts = task.starts(np.random.default_rng([options.seed, 1]), trainings * episodes, rig)[mine]
        strict = dpend.simulate_many(rig, controller, starts, task=task, seed=options.seed).success
        report = strict.copy()  # who stands by the strict criterion stands by the report's too
        if not strict.all():
            lenient = replace(task, criterion="report")
            report[~strict] = dpend.simulate_many(
                rig, controller, starts[~strict], task=lenient, seed=options.seed
            ).success
        rows.append(
            Row(
                controller=job.setting,
                training=job.repetition,
                lam=lam,
                episodes=len(starts),
                successes=int(strict.sum()),
                successes_report=int(report.sum()),
                outcome=outcome,
                training_episodes=training_cost[0],
                training_steps=training_cost[1],
                test_steps=training_cost[2],
            )
        )
    return Result(rows, {} if job.repetition else {"force": _trace(rig, controller, options.seed)})


def _trace(rig: dpend.Rig, controller: dpend.Controller, seed: int) -> Array:
    """Give the force over the first seconds of one episode, the same for every controller, until it falls."""
    task = dpend.Balance(lam=_TRACE_LAM)
    start = task.starts(np.random.default_rng([seed, 1]), 1, rig)[0]
    return dpend.simulate(rig, controller, start, _TRACE_SECONDS, task=task, seed=seed).u


def rate(rows: list[Row], controller: str, lam: float, *, report: bool = False) -> Rate:
    """Give the success of a controller at one spread, with its interval.

    Parameters
    ----------
    rows : list of Row
        The table.
    controller : str
        One of ``CLASSICAL`` or ``LEARNED``.
    lam : float
        The spread.
    report : bool
        By the report's own criterion, which looks at link 1 alone.

    Returns
    -------
    Rate
    """
    chosen = [row for row in rows if row.controller == controller and row.lam == lam]
    counts = [row.successes_report if report else row.successes for row in chosen]
    if controller in LEARNED:
        return over_seeds(counts, chosen[0].episodes)
    return wilson(sum(counts), sum(row.episodes for row in chosen))


def _present(rows: list[Row]) -> list[str]:
    found = {row.controller for row in rows}
    return [name for name in _WORDS if name in found]


def _converged(rows: list[Row], controller: str) -> str:
    outcomes = {row.training: row.outcome for row in rows if row.controller == controller}
    return f"{sum(outcome == 'converged' for outcome in outcomes.values())} of {len(outcomes)}"


def plot(rows: list[Row], traces: Traces) -> Figure:
    """Draw success against spread, and below it a force trace of each controller."""
    names = _present(rows)
    figure = Figure(figsize=(6.3, 5.2 + 0.8 * len(names)), layout="constrained")
    grid = figure.add_gridspec(1 + len(names), 1, height_ratios=[5.0] + [1.0] * len(names))
    _plot_success(figure.add_subplot(grid[0]), rows, names)
    sample_time = dpend.rig("gustafsson2016").sample_time
    axes = [figure.add_subplot(grid[1 + i]) for i in range(len(names))]
    for axis, name in zip(axes, names, strict=True):
        _plot_trace(axis, traces[_study.slug(Job(name))]["force"], sample_time, name)
        axis.tick_params(labelbottom=axis is axes[-1])
    axes[-1].set_xlabel("time (s)")
    axes[len(axes) // 2].set_ylabel("force on the cart (N)")
    return figure


def _plot_success(axis: Axes, rows: list[Row], names: list[str]) -> None:
    lams = sorted({row.lam for row in rows})
    spacing = min(np.diff(lams), default=0.1)
    for place, name in enumerate(names):
        colour, marker, line = _STYLES[name]
        aside = np.array(lams) + 0.035 * spacing * (place - (len(names) - 1) / 2)  # so that no interval hides another
        if name == "Q published":
            for training in sorted({row.training for row in rows if row.controller == name}):
                own = [row for row in rows if row.controller == name and row.training == training]
                shares = [row.successes / row.episodes for row in sorted(own, key=lambda row: row.lam)]
                axis.plot(aside, shares, color=colour, lw=0.6, alpha=0.6)
        rates = [rate(rows, name, lam) for lam in lams]
        error = np.array([[r.share - r.low, r.high - r.share] for r in rates]).T
        words = f"{_WORDS[name]} ({_converged(rows, name)} converged)" if name in LEARNED else _WORDS[name]
        axis.errorbar(
            aside, [r.share for r in rates], error,
            color=colour, marker=marker, ls=line, ms=5, capsize=3, lw=1.5, label=words,
        )  # fmt: skip
    shown = {lam: share for lam, share in TABLE2.items() if lams[0] <= lam <= lams[-1]}
    if shown:
        axis.plot(list(shown), list(shown.values()), "k*", ms=10, label="the report's Table 2")
    limits = lams[0] - 0.35 * spacing, lams[-1] + 0.35 * spacing
    axis.set(xlabel="starting spread λ (rad)", ylabel="starts saved", xlim=limits, ylim=(-0.03, 1.03), xticks=lams)
    axis.yaxis.set_major_formatter(PercentFormatter(1.0))
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8, ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)


def _plot_trace(axis: Axes, force: Array, sample_time: float, name: str) -> None:
    end = sample_time * len(force)
    axis.stairs(force, sample_time * np.arange(len(force) + 1), baseline=None, color=_STYLES[name][0], lw=1.1)
    if end < _TRACE_SECONDS - 0.5 * sample_time:
        axis.plot(end, force[-1], "kx", ms=6, clip_on=False)
        axis.text(end + 0.03, 0, "fell", va="center", fontsize=8)
    axis.set(xlim=(0, _TRACE_SECONDS), ylim=(-46, 46), yticks=(-40, 0, 40))
    axis.set_title(f"{_WORDS[name]}, one episode at λ = {_TRACE_LAM:g}", fontsize=8, loc="left", pad=2)
    axis.tick_params(labelsize=8)
    axis.grid(alpha=0.3)


def summary(rows: list[Row], traces: Traces) -> RenderableType:
    """Condense the table: success with interval by controller and spread, and what learning cost."""
    names = _present(rows)
    lams = list(dict.fromkeys(row.lam for row in rows))
    success = Table(title="Starts saved, %, and 95 % interval; (...) by the report's criterion, link 1 alone")
    success.add_column("controller")
    for lam in lams:
        success.add_column(f"λ = {lam:g}", justify="right")
    for name in names:
        cells = []
        for lam in lams:
            strict, report = rate(rows, name, lam), rate(rows, name, lam, report=True)
            interval = f"\\[{100 * strict.low:.1f}, {100 * strict.high:.1f}]"
            cells.append(f"{100 * strict.share:.1f} ({100 * report.share:.1f})\n{interval}")
        success.add_row(_WORDS[name], *cells)
    success.add_row("the report's Table 2", *(f"{100 * TABLE2[lam]:.0f}" if lam in TABLE2 else "" for lam in lams))

    learning = Table(title="What learning cost, medians over trainings, and what the converged ones save")
    for heading in ("learner", "converged", "episodes", "learning steps", "test steps", "converged save, %"):
        learning.add_column(heading, justify="left" if heading == "learner" else "right")
    for name in (name for name in names if name in LEARNED):
        own = [row for row in rows if row.controller == name and row.lam == lams[0]]
        costs = np.median([(row.training_episodes, row.training_steps, row.test_steps) for row in own], axis=0)
        done = [row for row in rows if row.controller == name and row.outcome == "converged"]
        shares = [
            f"{100 * np.mean([row.successes / row.episodes for row in done if row.lam == lam]):.1f}"
            for lam in lams
            if done
        ]
        learning.add_row(
            _WORDS[name], _converged(rows, name), *(f"{cost:,.0f}" for cost in costs), "\n".join(shares) or "-"
        )
    return Group(success, learning)


if __name__ == "__main__":
    _study.main("studies.lambda_sweep")
