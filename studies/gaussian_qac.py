"""Does the report's Gaussian QAC learn anywhere in the ranges it tried, and what makes an actor-critic learn here?

Method: Algorithm 2 to the letter on gustafsson2016, λ = 0.1, over α and β log-spaced from 1e-8 to 1e-1 and σ² from
0.001 to 10, from zero and from drawn initial weights, with and without indicators of signs; long runs at the smallest
steps, because the report guesses that a smaller step size might converge after 40 000 episodes; then the tuned variant
from fresh seeds, and the same without one of its numbered deviations each.  A training has learned if the mean of its
policy saves at least 99 % of its starts at λ = 0.1.  The k-th training of each meets the k-th part of the starts, LQR
meets all.

Finding: none of 3200 short trainings and 32 long runs to the letter has one successful episode; 2639 overflow.  Tuned,
30 of 30 trainings save 99 % at λ = 0.1, and 100/100/87.4/68.5 % at λ = .1/.2/.3/.4, as LQR does (100/99.9/86.7/67.2);
without any one of six deviations none learns.  From ``--seed 1``, kept in docs/results/gaussian_qac.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from rich.console import Group, RenderableType
from rich.table import Table

import dpend
from controllers import LQR
from dpend.params import Array
from rl import GainPolicy, GaussianQAC, QACTraining
from rl.gaussian_qac import ablations

from . import _study
from ._intervals import over_seeds, wilson
from ._study import Job, Result, Traces

LAMS = (0.1, 0.2, 0.3, 0.4)
STEPS = tuple(float(f"{step:.3g}") for step in np.geomspace(1e-8, 1e-1, 8))
VARIANCES = tuple(float(f"{variance:.3g}") for variance in np.geomspace(1e-3, 10, 5))
VARIANTS = {
    "zero weights": {},
    "weights N(0, 0.1²)": {"spread": 0.1},
    "weights N(0, 10²)": {"spread": 10.0},
    "signs": {"indicators": "signs"},
    "cells of signs": {"indicators": "cells"},
}
LONG_STEPS = STEPS[:4]
LONG_VARIANCES = (1.0, 10.0)
LEARNED = 0.99
_BINS = 200
_EVERY = 4


@dataclass(frozen=True, kw_only=True)
class Options(_study.Options):
    """What can be told on the command line."""

    short: int = 2
    """Seeds of each setting of the ranges."""
    short_episodes: int = 2000
    """Budget of each of these trainings."""
    long_episodes: int = 200_000
    """Budget of each long run."""
    trainings: int = 30
    """Seeds of the tuned learner."""
    ablated: int = 12
    """Seeds of each ablation, the first of those."""
    episodes: int = 300
    """Starts that each learned policy meets at each spread."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_least(1, "short", "short_episodes", "long_episodes", "trainings", "ablated", "episodes")

    @property
    def small(self) -> Options:
        """The options themselves, or what is left of them where it must be quick."""
        if not self.quick:
            return self
        return replace(self, short=1, short_episodes=20, long_episodes=200, trainings=1, ablated=1, episodes=20)


@dataclass(frozen=True, kw_only=True)
class Row:
    """One training at one spread; those of the report's ranges at λ = 0.1 alone."""

    part: str
    """ranges, long, tuned, or LQR."""
    setting: str
    training: int
    alpha: float
    beta: float
    variance: float
    outcome: str
    training_episodes: int
    training_steps: int
    training_successes: int
    """Learning episodes that lasted to the end of the task."""
    longest: float
    """Greatest mean length of 100 learning episodes in a row, or of all where there were fewer, samples."""
    learned_after: int
    """Episodes until the mean policy first saved 99 of 100 starts at λ = 0.1; -1 if it never did or was not asked."""
    lam: float
    episodes: int
    successes: int
    """Starts that the mean policy saved, neither link falling."""


def jobs(options: Options) -> list[Job]:
    """List the work: the ranges, the long runs, the tuned learner and its ablations, LQR."""
    small = options.small
    names = list(ablations(dpend.rig("gustafsson2016")))
    if options.quick:
        names = [names[0], names[1], names[-1]]
    ranges = [Job(f"ranges, {variant}, {variance:g}") for variant in VARIANTS for variance in VARIANCES]
    long = [Job(f"long, {alpha:g}, {variance:g}") for alpha in LONG_STEPS for variance in LONG_VARIANCES]
    tuned = [
        Job(f"tuned, {name}", k) for name in names for k in range(small.trainings if name == "tuned" else small.ablated)
    ]
    return [
        *ranges[:: len(ranges) - 1 if options.quick else 1],
        *(long[:1] if options.quick else long),
        *tuned,
        Job("LQR"),
    ]


def run(job: Job, options: Options) -> Result:
    """Train what the job names, and meet the starts."""
    rig, small = dpend.rig("gustafsson2016"), options.small
    part, _, setting = job.setting.partition(", ")
    if part == "LQR":
        lqr = LQR(rig)
        return Result(
            [
                _row("LQR", "LQR, Q = I, R = 1", k, None, None, lam, _saved(rig, lqr, lam, k, small), small)
                for k in range(small.trainings)
                for lam in LAMS
            ]
        )
    if part == "tuned":
        learner = ablations(rig)[setting]
        training = learner.train([options.seed, 8, job.repetition])
        curve = _curve(rig, training, options.seed) if setting == "tuned" else {}
        rows = []
        for lam in LAMS:
            saved = _saved(rig, training.policy, lam, job.repetition, small)
            rows.append(
                _row("tuned", setting, job.repetition, learner, training, lam, saved, small, curve.get("share"))
            )
        return Result(rows, curve)
    if part == "ranges":
        variant, _, variance = setting.rpartition(", ")
        settings = [(alpha, beta, k) for alpha in STEPS for beta in STEPS for k in range(small.short)]
        choice, budget = VARIANTS[variant], small.short_episodes
    else:
        variant = "long"
        alpha, _, variance = setting.partition(", ")
        settings = [(float(alpha), beta, 0) for beta in LONG_STEPS]
        choice, budget = {}, small.long_episodes
    rows, traces = [], {}
    for alpha, beta, k in settings:
        learner = GaussianQAC.published(
            rig, alpha=alpha, beta=beta, variance=float(variance), max_episodes=budget, **choice
        )
        training = learner.train([options.seed, 9, k])
        saved = _saved(rig, training.policy, LAMS[0], k, small)
        rows.append(_row(part, variant, k, learner, training, LAMS[0], saved, small))
        if part == "long":
            edges = np.linspace(0, training.episodes, min(_BINS, training.episodes) + 1).astype(int)
            lengths = (
                np.add.reduceat(training.lengths, edges[:-1]) / np.diff(edges) if training.episodes else np.zeros(1)
            )
            traces |= {
                f"{beta:g} lengths": lengths,
                f"{beta:g} episodes": edges[1:] if training.episodes else np.ones(1),
            }
    return Result(rows, traces)


def _saved(rig: dpend.Rig, controller: dpend.Controller, lam: float, part: int, options: Options) -> int:
    """Count the starts of one part that a controller saves."""
    task = dpend.Balance(lam=lam)
    starts = task.starts(np.random.default_rng([options.seed, 10, part]), options.episodes, rig)
    return int(dpend.simulate_many(rig, controller, starts, task=task, seed=options.seed).success.sum())


def _curve(rig: dpend.Rig, training: QACTraining, seed: int) -> dict[str, Array]:
    """Return the share of 100 other starts at λ = 0.1 that the mean policy saves, every few updates."""
    task = dpend.Balance(lam=LAMS[0])
    starts = task.starts(np.random.default_rng([seed, 11]), 100, rig)
    updates = range(0, len(training.gains), _EVERY)
    share = [dpend.simulate_many(rig, GainPolicy(training.gains[k]), starts, task=task).success.mean() for k in updates]
    return {"share": np.array(share), "episodes": training.updated[list(updates)].astype(np.float64)}


def _row(
    part: str,
    setting: str,
    repetition: int,
    learner: GaussianQAC | None,
    training: QACTraining | None,
    lam: float,
    saved: int,
    options: Options,
    share: Array | None = None,
) -> Row:
    lengths = np.zeros(0) if training is None else training.lengths
    window = min(100, len(lengths))
    means = np.convolve(lengths, np.ones(window) / window, mode="valid") if window else np.zeros(1)
    learned = np.zeros(0, dtype=int) if share is None or training is None else np.flatnonzero(share >= LEARNED)
    return Row(
        part=part,
        setting=setting,
        training=repetition,
        alpha=0.0 if learner is None else learner.alpha,
        beta=0.0 if learner is None else learner.beta,
        variance=0.0 if learner is None else float(f"{learner.sigma**2:.6g}"),
        outcome="-" if training is None else training.outcome.name.lower().replace("_", " "),
        training_episodes=0 if training is None else training.episodes,
        training_steps=0 if training is None else training.steps,
        training_successes=0 if training is None else int(training.succeeded.sum()),
        longest=round(float(means.max()), 2),
        learned_after=int(training.updated[_EVERY * learned[0]]) if training is not None and len(learned) else -1,
        lam=lam,
        episodes=options.episodes,
        successes=saved,
    )


def _names(rows: list[Row]) -> list[str]:
    return list(dict.fromkeys(row.setting for row in rows if row.part == "tuned"))


def _of(rows: list[Row], setting: str, lam: float) -> list[Row]:
    return [row for row in rows if row.part in ("tuned", "LQR") and (row.setting, row.lam) == (setting, lam)]


def plot(rows: list[Row], traces: Traces) -> Figure:
    """Draw where the report's ranges diverge, the long runs, the tuned learner, and what each deviation is worth."""
    figure = Figure(figsize=(6.8, 9.4), layout="constrained")
    parts: Any = figure.subfigures(2, 1, height_ratios=[2, 1.25])
    above, below = parts
    axes = above.subplots(2, 2)
    _plot_ranges(axes[0, 0], [row for row in rows if row.part == "ranges"])
    _plot_long(axes[0, 1], traces)
    _plot_curve(axes[1, 0], traces)
    _plot_success(axes[1, 1], rows)
    _plot_ablation(below.subplots(), rows)
    return figure


def _plot_ranges(axis: Axes, rows: list[Row]) -> None:
    share = np.full((len(STEPS), len(STEPS)), np.nan)
    for i, beta in enumerate(STEPS):
        for j, alpha in enumerate(STEPS):
            own = [row.outcome == "diverged" for row in rows if (row.alpha, row.beta) == (alpha, beta)]
            share[i, j] = np.mean(own) if own else np.nan
    image = axis.imshow(share, origin="lower", vmin=0, vmax=1, cmap="cividis_r")
    ticks = range(len(STEPS))
    axis.set(xticks=ticks, yticks=ticks, xlabel="log10 α", ylabel="log10 β")
    axis.set_xticklabels([f"{np.log10(step):.0f}" for step in STEPS])
    axis.set_yticklabels([f"{np.log10(step):.0f}" for step in STEPS])
    axis.figure.colorbar(image, ax=axis, format=PercentFormatter(1.0), shrink=0.8)
    axis.set_title("as published: trainings that diverge", fontsize=9)


def _plot_long(axis: Axes, traces: Traces) -> None:
    colours = dict(zip(LONG_STEPS, ("#0072B2", "#009E73", "#E69F00", "#D55E00"), strict=True))
    for alpha in LONG_STEPS:
        for variance in LONG_VARIANCES:
            own = traces.get(_study.slug(Job(f"long, {alpha:g}, {variance:g}")), {})
            for beta in LONG_STEPS:
                if f"{beta:g} lengths" in own:
                    axis.plot(own[f"{beta:g} episodes"] / 1000, own[f"{beta:g} lengths"], color=colours[alpha], lw=0.7)
        axis.plot([], [], color=colours[alpha], label=f"α = {alpha:g}")
    axis.axhline(300, color="k", lw=0.8, ls="--")
    axis.set(xlabel="thousands of episodes", ylabel="mean length (samples)", ylim=(0, 315))
    axis.set_title("as published: long runs", fontsize=9)
    axis.legend(fontsize=7)
    axis.grid(alpha=0.3)


def _plot_curve(axis: Axes, traces: Traces) -> None:
    own = [trace for job, trace in traces.items() if job.startswith("tuned,_tuned-")]
    shares = np.array([trace["share"] for trace in own])
    low, middle, high = np.quantile(shares, (0.25, 0.5, 0.75), axis=0)
    axis.plot(own[0]["episodes"], middle, color="#009E73", lw=1.5, label="median")
    axis.fill_between(own[0]["episodes"], low, high, color="#009E73", alpha=0.25, lw=0, label="quartiles")
    axis.set(xlabel="episodes", ylabel="starts saved, λ = 0.1", ylim=(-0.03, 1.03))
    axis.yaxis.set_major_formatter(PercentFormatter(1.0))
    axis.set_title("tuned: mean policy while it learns", fontsize=9)
    axis.legend(fontsize=8)
    axis.grid(alpha=0.3)


def _plot_success(axis: Axes, rows: list[Row]) -> None:
    styles = {
        "LQR, Q = I, R = 1": ("#0072B2", "o", "-"),
        "tuned": ("#009E73", "D", "-."),
        "13 cost and σ kept": ("#E69F00", "s", "--"),
    }
    for place, (name, (colour, marker, line)) in enumerate(styles.items()):
        rates = [_rate(_of(rows, name, lam)) for lam in LAMS]
        error = np.array([[rate.share - rate.low, rate.high - rate.share] for rate in rates]).T
        words = "without deviation 13" if name.startswith("13") else name
        axis.errorbar(
            np.array(LAMS) + 0.006 * (place - 1), [rate.share for rate in rates], error,
            color=colour, marker=marker, ls=line, ms=4, capsize=2, lw=1.3, label=words,
        )  # fmt: skip
    axis.set(xlabel="starting spread λ (rad)", ylabel="starts saved", ylim=(-0.03, 1.03), xticks=LAMS)
    axis.yaxis.set_major_formatter(PercentFormatter(1.0))
    axis.set_title("mean policy at the end", fontsize=9)
    axis.legend(fontsize=7, loc="lower left")
    axis.grid(alpha=0.3)


def _rate(own: list[Row]):
    return over_seeds([row.successes for row in own], own[0].episodes)


def _learned(own: list[Row]) -> tuple[int, int]:
    return sum(row.successes >= LEARNED * row.episodes for row in own), len(own)


def _plot_ablation(axis: Axes, rows: list[Row]) -> None:
    names = _names(rows)
    for place, name in enumerate(names):
        rate = wilson(*_learned(_of(rows, name, LAMS[0])))
        colour = "#009E73" if name == "tuned" else "#555555"
        axis.barh(place, rate.share, color=colour, height=0.6, alpha=0.8)
        axis.errorbar(
            rate.share, place, xerr=[[rate.share - rate.low], [rate.high - rate.share]], color="k", lw=1, capsize=2
        )
    axis.set(yticks=range(len(names)), xlim=(0, 1.02), xlabel="trainings that save 99 % at λ = 0.1")
    axis.set_yticklabels(names, fontsize=8)
    axis.invert_yaxis()
    axis.xaxis.set_major_formatter(PercentFormatter(1.0))
    axis.set_title("tuned, and with one deviation taken back", fontsize=9)
    axis.grid(alpha=0.3, axis="x")


def summary(rows: list[Row], traces: Traces) -> RenderableType:
    """Condense the table: how published trainings end, and what tuned ones and ablations save."""
    published = Table(title="Algorithm 2 to the letter")
    headings = (
        "trainings",
        "diverged",
        "converged",
        "learning\nepisodes",
        "of them\nsuccessful",
        "trainings\nwith one",
    )
    published.add_column("setting")
    for heading in (*headings, "longest mean of 100\nepisodes (samples)", "best mean policy,\nλ = 0.1"):
        published.add_column(heading, justify="right")
    for name in dict.fromkeys(row.setting for row in rows if row.part in ("ranges", "long")):
        own = [row for row in rows if row.part in ("ranges", "long") and row.setting == name]
        published.add_row(
            name,
            str(len(own)),
            *(str(sum(row.outcome == outcome for row in own)) for outcome in ("diverged", "converged")),
            f"{sum(row.training_episodes for row in own):,}",
            f"{sum(row.training_successes for row in own):,}",
            str(sum(row.training_successes > 0 for row in own)),
            f"{max(row.longest for row in own):.0f}",
            f"{100 * max(row.successes / row.episodes for row in own):.0f} %",
        )
    tuned = Table(title="Saved by the mean policy, %, and 95 % interval over trainings")
    for heading in ("learner", "99 % at λ = 0.1", *(f"λ = {lam:g}" for lam in LAMS), "median steps"):
        tuned.add_column(heading, justify="left" if heading == "learner" else "right")
    for name in (*_names(rows), "LQR, Q = I, R = 1"):
        own = _of(rows, name, LAMS[0])
        learned, n = _learned(own)
        low, high = wilson(learned, n)[1:]
        rates = [_rate(_of(rows, name, lam)) for lam in LAMS]
        tuned.add_row(
            name,
            f"{learned} of {n} \\[{low:.0%}, {high:.0%}]" if name in _names(rows) else "-",
            *(f"{100 * rate.share:.1f} \\[{100 * rate.low:.1f}, {100 * rate.high:.1f}]" for rate in rates),
            f"{np.median([row.training_steps for row in own]):,.0f}",
        )
    after = [row.learned_after for row in _of(rows, "tuned", LAMS[0]) if row.learned_after >= 0]
    words = "None learned."
    if after:
        low, middle, high = np.quantile(after, (0.25, 0.5, 0.75))
        words = f"Tuned: 99 of 100 starts at λ = 0.1 first saved after {middle:.0f} episodes ({low:.0f} to {high:.0f})."
    return Group(published, tuned, words)


if __name__ == "__main__":
    _study.main("studies.gaussian_qac")
