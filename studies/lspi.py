"""Does Q-learning with quadratic features find the Riccati gain from data alone, and is its force smooth?

Method: on gustafsson2016, from K = 0 and without a model, least-squares policy iteration with 120 s and with 60 s of
experience, and one-step Q-learning on the same features with 120 s and with 12 000 s, 30 fresh seeds each.  The gain is
held against the one of the Riccati equation for the same cost and discount, with √γA and √γB.  The k-th training of
every learner, and that gain, meet the k-th part of the starts at every λ; Table 1 Q-learning (tuned) stands beside.
Variation is the total variation of the force per second, in units of the force limit, at λ = 0.1.

Finding: with 120 s LSPI comes within 5 % of the Riccati gain in 30 of 30 trainings (median error 0.13 %, at most
0.9 %), saves what that gain saves (100/99.5/85.2/69.0 %), and its force varies 1/814 as much as Table 1 Q-learning's;
with 60 s it is 27 of 30, and one-step Q-learning finds nothing in 12 000 s.  From ``--seed 1``, kept in
docs/results/lspi.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from rich.console import Group, RenderableType
from rich.table import Table
from scipy.linalg import solve_discrete_are

import dpend
from dpend.params import Array
from rl import LSPI, GainPolicy, LinearQLearning, LSPITraining, QuadraticQLearning

from . import _study
from ._intervals import over_seeds, wilson
from ._study import Job, Result, Traces

LAMS = (0.1, 0.2, 0.3, 0.4)
CLOSE = 0.05
"""A gain counts as found within this error, relative to the norm of the Riccati gain."""

LEARNERS: dict[str, Callable[[dpend.Rig], LSPI | QuadraticQLearning]] = {
    "LSPI, 120 s": lambda rig: LSPI(rig),
    "LSPI, 60 s": lambda rig: LSPI(rig, samples=60, iterations=50, anneal=42),
    "one-step Q, 120 s": lambda rig: QuadraticQLearning(rig),
    "one-step Q, 12 000 s": lambda rig: QuadraticQLearning(
        rig, samples=600_000, anneal=500_000, alpha=0.1, record_every=10_000
    ),
}
_REFERENCE, _TABLE1 = "Riccati gain", "Q-learning, Table 1"
_STYLES = {
    _REFERENCE: ("#0072B2", "o", "-"),
    "LSPI, 120 s": ("#009E73", "D", "-."),
    "LSPI, 60 s": ("#E69F00", "s", "--"),
    "one-step Q, 120 s": ("#777777", "v", ":"),
    "one-step Q, 12 000 s": ("#CC79A7", "P", ":"),
    _TABLE1: ("#D55E00", "^", "--"),
}
_TRACE_SECONDS = 2.0


@dataclass(frozen=True, kw_only=True)
class Options(_study.Options):
    """What can be told on the command line."""

    trainings: int = 30
    """Seeds of each learner."""
    episodes: int = 300
    """Starts that each trained controller meets at each spread."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_least(1, "trainings", "episodes")

    @property
    def sizes(self) -> tuple[int, int]:
        """Trainings of each learner, and starts of each; few where it must be quick."""
        return (min(self.trainings, 2), min(self.episodes, 20)) if self.quick else (self.trainings, self.episodes)


@dataclass(frozen=True, kw_only=True)
class Row:
    """One controller at one spread."""

    controller: str
    training: int
    lam: float
    episodes: int
    successes: int
    """Starts saved: neither link fell."""
    variation: float
    """Mean total variation of the force per second, in units of the force limit."""
    error: float
    """Distance of the gain from the Riccati gain, relative; not a number where there is no gain."""
    experience: float
    """Learning, tests included, s of the plant's time."""


def discounted_gain(rig: dpend.Rig, state_weights: Sequence[float], force_weight: float, gamma: float) -> Array:
    r"""Return the gain ``(6,)`` of least :math:`\\sum_k \\gamma^k (x_k^\top Q x_k + R u_k^2)` about upright.

    Parameters
    ----------
    rig : Rig
        Plant and sample time.
    state_weights : sequence of 6 floats
        Diagonal of :math:`Q`.
    force_weight : float
        :math:`R`.
    gamma : float
        Discount factor; the Riccati equation is that of :math:`\sqrt\gamma A, \sqrt\gamma B`.
    """
    A, B = (np.sqrt(gamma) * M for M in dpend.discretize(*dpend.linearize(rig.params), rig.sample_time))
    P = solve_discrete_are(A, B, np.diag(state_weights), np.array([[force_weight]]))
    return ((B.T @ P @ A) / (force_weight + B.T @ P @ B))[0]


def reference(rig: dpend.Rig) -> Array:
    """Return the Riccati gain of the cost and the discount that the learners have."""
    learner = LSPI(rig)
    return discounted_gain(rig, learner.state_weights, learner.force_weight, learner.gamma)


def jobs(options: Options) -> list[Job]:
    """List the work: each controller once for each part of the starts."""
    return [Job(name, k) for name in (_REFERENCE, *LEARNERS, _TABLE1) for k in range(options.sizes[0])]


def run(job: Job, options: Options) -> Result:
    """Train where there is something to train, then meet this training's starts of every spread."""
    rig = dpend.rig("gustafsson2016")
    trainings, episodes = options.sizes
    best = reference(rig)
    error, experience, seed = np.nan, 0.0, [options.seed, 6, job.repetition]
    traces: dict[str, Array] = {}
    if job.setting == _REFERENCE:
        controller: dpend.Controller = GainPolicy(best)
        error = 0.0
    elif job.setting == _TABLE1:
        tuned = LinearQLearning.tuned(rig).train(seed)
        controller, experience = tuned.policy, (tuned.steps + tuned.test_steps) * rig.sample_time
    else:
        learner = LEARNERS[job.setting](rig)
        training: LSPITraining = learner.train(seed)
        controller, experience = training.policy, training.experience
        seconds = (training.samples * rig.sample_time).astype(np.float64)
        traces = {"errors": training.errors(best), "experience": seconds}
        error = float(traces["errors"][-1])
    rows = []
    for lam in LAMS:
        task = dpend.Balance(lam=lam)
        starts = task.starts(np.random.default_rng([options.seed, 7]), trainings * episodes, rig)
        mine = starts[job.repetition * episodes : (job.repetition + 1) * episodes]
        runs = dpend.simulate_many(rig, controller, mine, task=task, seed=options.seed)
        rows.append(
            Row(
                controller=job.setting,
                training=job.repetition,
                lam=lam,
                episodes=len(mine),
                successes=int(runs.success.sum()),
                variation=float(np.mean(runs.metrics()["variation"])),
                error=error,
                experience=experience,
            )
        )
    if job.repetition == 0:
        start = dpend.Balance().starts(np.random.default_rng([options.seed, 7]), 1, rig)[0]
        traces["force"] = dpend.simulate(rig, controller, start, _TRACE_SECONDS, seed=options.seed).u
    return Result(rows, traces)


def _of(rows: list[Row], controller: str, lam: float) -> list[Row]:
    return [row for row in rows if (row.controller, row.lam) == (controller, lam)]


def plot(rows: list[Row], traces: Traces) -> Figure:
    """Draw the gain's error against experience, success against spread, and a force trace of each kind."""
    figure = Figure(figsize=(6.6, 8.2), layout="constrained")
    grid = figure.add_gridspec(4, 2, height_ratios=[4.2, 1, 1, 1])
    _plot_errors(figure.add_subplot(grid[0, 0]), traces)
    _plot_success(figure.add_subplot(grid[0, 1]), rows)
    sample_time = dpend.rig("gustafsson2016").sample_time
    for place, name in enumerate((_REFERENCE, "LSPI, 120 s", _TABLE1)):
        axis = figure.add_subplot(grid[1 + place, :])
        force = traces[_study.slug(Job(name))]["force"]
        axis.stairs(force, sample_time * np.arange(len(force) + 1), baseline=None, color=_STYLES[name][0], lw=1.1)
        axis.set(xlim=(0, _TRACE_SECONDS), ylim=(-46, 46), yticks=(-40, 0, 40))
        axis.set_title(f"{name}, one episode at λ = 0.1", fontsize=8, loc="left", pad=2)
        axis.tick_params(labelsize=8, labelbottom=place == 2)
        axis.grid(alpha=0.3)
        if place == 1:
            axis.set_ylabel("force on the cart (N)")
        if place == 2:
            axis.set_xlabel("time (s)")
    handles, labels = figure.axes[1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3, fontsize=8, frameon=False)
    return figure


def _plot_errors(axis: Axes, traces: Traces) -> None:
    for name in LEARNERS:
        own = [trace for job, trace in traces.items() if job.startswith(_study.slug(Job(name))[:-1])]
        errors = np.array([trace["errors"] for trace in own])
        low, middle, high = np.quantile(errors, (0.25, 0.5, 0.75), axis=0)
        colour, _, line = _STYLES[name]
        axis.plot(own[0]["experience"], middle, color=colour, ls=line, lw=1.5)
        axis.fill_between(own[0]["experience"], low, high, color=colour, alpha=0.2, lw=0)
    axis.axhline(CLOSE, color="k", lw=0.8, ls="--")
    axis.set(xscale="log", yscale="log", ylim=(4e-4, 4), xlabel="experience (s)", ylabel="error of the gain")
    axis.set_title("median and quartiles over trainings", fontsize=8)
    axis.grid(alpha=0.3)


def _plot_success(axis: Axes, rows: list[Row]) -> None:
    for place, (name, (colour, marker, line)) in enumerate(_STYLES.items()):
        rates = [over_seeds([row.successes for row in own], own[0].episodes) for own in _by_lam(rows, name)]
        error = np.array([[rate.share - rate.low, rate.high - rate.share] for rate in rates]).T
        aside = np.array(LAMS) + 0.005 * (place - (len(_STYLES) - 1) / 2)
        axis.errorbar(
            aside, [rate.share for rate in rates], error,
            color=colour, marker=marker, ls=line, ms=4, capsize=2, lw=1.3, label=name,
        )  # fmt: skip
    axis.set(xlabel="starting spread λ (rad)", ylabel="starts saved", ylim=(-0.03, 1.03), xticks=LAMS)
    axis.yaxis.set_major_formatter(PercentFormatter(1.0))
    axis.grid(alpha=0.3)


def _by_lam(rows: list[Row], controller: str) -> list[list[Row]]:
    return [_of(rows, controller, lam) for lam in LAMS]


def summary(rows: list[Row], traces: Traces) -> RenderableType:
    """Condense the table: gains found, their errors, success by λ beside the Riccati gain's, and variation."""
    found = Table(title=f"Gains within {CLOSE:.0%} of the Riccati gain, and their error")
    for heading in ("learner", "found", "median error", "90th percentile", "largest", "experience (s)"):
        found.add_column(heading, justify="left" if heading == "learner" else "right")
    for name in LEARNERS:
        own = _of(rows, name, LAMS[0])
        errors = np.array([row.error for row in own])
        close = int((errors <= CLOSE).sum())
        rate = wilson(close, len(own))
        found.add_row(
            name,
            f"{close} of {len(own)} \\[{rate.low:.0%}, {rate.high:.0%}]",
            *(f"{100 * value:.2f} %" for value in (*np.quantile(errors, (0.5, 0.9)), errors.max())),
            f"{np.median([row.experience for row in own]):,.0f}",
        )
    success = Table(title="Starts saved, %, and 95 % interval over trainings; below: widest gap of one to Riccati's")
    for heading in ("controller", *(f"λ = {lam:g}" for lam in LAMS), "variation at λ = 0.1"):
        success.add_column(heading, justify="left" if heading == "controller" else "right")
    for name in _STYLES:
        cells = []
        for own, ideal in zip(_by_lam(rows, name), _by_lam(rows, _REFERENCE), strict=True):
            rate = over_seeds([row.successes for row in own], own[0].episodes)
            gaps = [(mine.successes - best.successes) / mine.episodes for mine, best in zip(own, ideal, strict=True)]
            cells.append(
                f"{100 * rate.share:.1f} \\[{100 * rate.low:.1f}, {100 * rate.high:.1f}]\n"
                f"{100 * min(gaps):+.1f} to {100 * max(gaps):+.1f}"
            )
        success.add_row(name, *cells, f"{np.mean([row.variation for row in _of(rows, name, LAMS[0])]):.4g}")
    return Group(found, success)


if __name__ == "__main__":
    _study.main("studies.lspi")
