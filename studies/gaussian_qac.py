"""Does the report's Gaussian QAC learn anywhere in the ranges it tried, and what makes an actor-critic learn here?

Method: Algorithm 2 to the letter on gustafsson2016, λ = 0.1, over α and β from 1e-8 to 1e-1 and σ² from 0.001 to 10,
from zero and from drawn initial weights, with and without indicators of signs; long runs at the smallest steps, as the
report guesses that these converge after 40 000 episodes; then the tuned variant, and it without one of its numbered
deviations each.  A training has learned if the mean of its policy saves 99 % of its starts at λ = 0.1: the k-th has the
k-th part of the starts, LQR all.

Finding: none of 3200 short trainings and 32 long runs to the letter has one successful episode; 2639 overflow.  Tuned,
30 of 30 trainings save 99 % at λ = 0.1, and 100/100/87.4/68.5 % at λ = .1/.2/.3/.4, as LQR does (100/99.9/86.7/67.2);
without any one of six deviations none learns.  From ``--seed 1``, kept in docs/results/gaussian_qac.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import dpend
from controllers import LQR
from dpend.params import Array
from rl import GainPolicy, GaussianQAC, Training
from rl.natural_qac import ablations

from . import _runner
from ._estimates import QUARTILES, Estimate, mean_share, share
from ._field import styles
from ._figures import COLOURS, Curve, band, forest, heat_map, mosaic, saved_by_angle, share_axis
from ._plant import Plant, rig_of
from ._runner import Positive, Report, Result, Table
from ._tables import Value, at, cell, counted, sheet

MINUTES = 2

LAMS = (0.1, 0.2, 0.3, 0.4)
STEPS = tuple(float(f"{step:.3g}") for step in np.geomspace(1e-8, 1e-1, 8))
VARIANCES = tuple(float(f"{variance:.3g}") for variance in np.geomspace(1e-3, 10, 5))
VARIANTS: Mapping[str, Mapping[str, Any]] = {
    "zero weights": {}, "weights N(0, 0.1²)": {"init_std": 0.1}, "weights N(0, 10²)": {"init_std": 10.0},
    "signs": {"indicators": "signs"}, "cells of signs": {"indicators": "cells"},
}  # fmt: skip
LONG_STEPS = STEPS[:4]
LONG_VARIANCES = (1.0, 10.0)
TUNED, LONG, REGULATOR = "tuned", "long", "LQR"
LQR_NAME = "LQR, Q = I, R = 1"
LEARNED = 0.99
_BINS = 200
_EVERY = 4


@dataclass(frozen=True, kw_only=True)
class Options(_runner.Options):
    """Options of the command line."""

    needs = ("force_limit", "ideal")

    short: Positive = 2  # Seeds of each setting of the ranges.
    short_episodes: Positive = 2000  # Budget of each of these trainings.
    long_episodes: Positive = 200_000  # Budget of each long run.
    trainings: Positive = 30  # Seeds of the tuned learner.
    ablated: Positive = 12  # Seeds of each ablation, the first of those.
    episodes: Positive = 300  # Starts on which each learned policy is evaluated at each λ.


@dataclass(frozen=True, kw_only=True)
class Job:
    """Trainings of one learner, or LQR in their place, and the starts on which they are evaluated."""

    part: str  # ranges, long, tuned, or LQR
    setting: str  # one of VARIANTS; the tuned learner, or which ablation of it
    trainings: tuple[int, ...]  # numbers of the trainings, each with its part of the starts
    variance: float = 0.0  # of the report's learner, as what follows
    alphas: tuple[float, ...] = (0.0,)
    betas: tuple[float, ...] = (0.0,)
    max_episodes: int = 0
    episodes: int
    seed: int
    elsewhere: Plant | None = None


def jobs(options: Options) -> list[Job]:
    """List the work: the long runs, the tuned learner and its ablations, LQR, the report's ranges."""
    o = options
    if o.quick:
        o = replace(o, short=1, short_episodes=20, long_episodes=200, trainings=1, ablated=1, episodes=20)
    lqr = Job(part=REGULATOR, setting=LQR_NAME, trainings=tuple(range(o.trainings)), episodes=o.episodes, seed=o.seed,
              elsewhere=o.elsewhere)  # fmt: skip
    published = replace(lqr, part=LONG, setting=LONG, trainings=(0,), max_episodes=o.long_episodes)
    long = [
        replace(published, alphas=(alpha,), variance=variance, betas=(beta,))
        for alpha, variance, beta in itertools.product(LONG_STEPS, LONG_VARIANCES, LONG_STEPS)
    ]
    seeds = tuple(range(o.short))
    published = replace(lqr, part="ranges", trainings=seeds, alphas=STEPS, betas=STEPS, max_episodes=o.short_episodes)
    ranges = [replace(published, setting=each, variance=variance) for each in VARIANTS for variance in VARIANCES]
    names = list(ablations(o.plant.rig))
    if o.quick:
        long, ranges, names = long[: len(LONG_STEPS)], [ranges[0], ranges[-1]], [*names[:2], names[-1]]
    tuned = [
        replace(lqr, part=TUNED, setting=name, trainings=(k,))
        for name in names
        for k in range(o.trainings if name == TUNED else o.ablated)
    ]
    return [*long, *tuned, lqr, *ranges]


def run(job: Job) -> Result:
    """Train, and count the starts that the mean policies save; the report's learner at λ = 0.1 alone."""
    rig, rows, arrays = rig_of(job.elsewhere), [], {}
    for alpha, beta, k in itertools.product(job.alphas, job.betas, job.trainings):
        training = None
        if job.part == TUNED:
            training = ablations(rig)[job.setting].train([job.seed, 8, k])
        elif job.part != REGULATOR:
            steps: dict[str, Any] = {"alpha": alpha, "beta": beta, "variance": job.variance}
            learner = GaussianQAC.published(
                rig, **steps, max_episodes=job.max_episodes, **VARIANTS.get(job.setting, {})
            )
            training = learner.train([job.seed, 9, k])
        if training is not None and job.setting == TUNED:
            arrays = _while_it_learns(training, rig, job.seed)
        if training is not None and job.part == LONG:
            arrays = _mean_lengths(training.curve["length"])
        learned = _learned(training, arrays.get("share", np.zeros(0)))
        for lam in LAMS if job.part in (TUNED, REGULATOR) else LAMS[:1]:
            task = dpend.Balance(lam=lam)
            starts = task.starts(np.random.default_rng([job.seed, 10, k]), job.episodes, rig)
            controller = LQR(rig) if training is None else training.policy
            saved = dpend.simulate_many(rig, controller, starts, task=task, seed=job.seed).success
            which = {"training": k, "alpha": alpha, "beta": beta}
            rows.append(which | learned | {"lam": lam, "successes": int(saved.sum())})
    return Result(rows, arrays)


def _learned(training: Training | None, share: Array) -> dict[str, Any]:
    """Return how a training went; of none, as LQR has none, zeros."""
    if training is None:
        return {"outcome": "-", "training_episodes": 0, "training_steps": 0, "training_successes": 0, "longest": 0.0,
                "learned_after": -1}  # fmt: skip
    lengths = training.curve["length"]
    window = min(100, len(lengths))
    means = np.convolve(lengths, np.ones(window) / window, mode="valid") if window else np.zeros(1)
    enough = np.flatnonzero(share >= LEARNED)
    return {
        "outcome": training.outcome.name.lower().replace("_", " "),
        "training_episodes": training.cost.episodes,
        "training_steps": training.cost.steps,
        "training_successes": int(training.curve["success"].sum()),
        "longest": round(float(means.max()), 2),  # mean length of 100 episodes in a row, samples
        "learned_after": int(training.details["updated"][_EVERY * enough[0]]) if len(enough) else -1,  # episodes
    }


def _mean_lengths(lengths: Array) -> dict[str, Array]:
    """Return the mean lengths of episodes in bins, and the last episode of each."""
    if not len(lengths):
        return {"lengths": np.zeros(1), "at_episode": np.ones(1)}
    edges = np.linspace(0, len(lengths), min(_BINS, len(lengths)) + 1).astype(int)
    return {"lengths": np.add.reduceat(lengths, edges[:-1]) / np.diff(edges), "at_episode": edges[1:]}


def _while_it_learns(training: Training, rig: dpend.Rig, seed: int) -> dict[str, Array]:
    """Return the share of 100 other starts at λ = 0.1 that the mean policy saves, every few updates."""
    task = dpend.Balance(lam=LAMS[0])
    starts = task.starts(np.random.default_rng([seed, 11]), 100, rig)
    gains = training.details["gains"][::_EVERY]
    share = [dpend.simulate_many(rig, GainPolicy(K), starts, task=task).success.mean() for K in gains]
    return {"share": np.array(share), "at_episode": training.details["updated"][::_EVERY]}


_AS = styles(("LQR", "QAC tuned"))
STYLES = {LQR_NAME: _AS["LQR"], TUNED: _AS["QAC tuned"], "13 cost and σ kept": ("#E69F00", "s", "--")}
_GREY = ("#555555", "s", "-")
_LONGEST, _BEST = "longest mean of 100 episodes, samples", "best mean policy, λ = 0.1, %"


def report(table: Table) -> Report:
    """Draw where the report's ranges diverge, the long runs, the tuned learner, and what each deviation is worth."""
    published: list[dict[str, Value]] = [
        {"setting": name, "trainings": len(rows),
         **{outcome: int(np.sum(rows["outcome"] == outcome)) for outcome in ("diverged", "converged")},
         "learning episodes": int(np.sum(rows["training_episodes"])),
         "of them successful": int(np.sum(rows["training_successes"])),
         "trainings with one": int(np.sum(rows["training_successes"] > 0)),
         _LONGEST: float(np.max(rows["longest"])), _BEST: float(np.max(rows["successes"] / rows["episodes"]))}
        for name in (*VARIANTS, LONG) if len(rows := table.where(setting=name))
    ]  # fmt: skip
    saved, worth, evaluated = {}, {}, []
    for name in (*ablations(table.rig), LQR_NAME):
        rows = {lam: table.where(setting=name, lam=lam) for lam in LAMS}
        if not (n := len(first := rows[LAMS[0]])):
            continue
        saved[name] = {lam: mean_share(of["successes"] / of["episodes"], of["episodes"]) for lam, of in rows.items()}
        line: dict[str, Value] = {"learner": name}
        if name != LQR_NAME:
            done = int(np.sum(first["successes"] >= LEARNED * first["episodes"]))
            worth[name] = share(done, n)
            line["99 % at λ = 0.1"] = counted(done, n)
        line |= at({lam: cell(each, ".1%") for lam, each in saved[name].items()})
        evaluated.append(line | {"median steps": float(np.median(first["training_steps"]))})
    after = table.where(setting=TUNED, lam=LAMS[0]).query("learned_after >= 0")["learned_after"]
    note = "None learned"
    if len(after):
        low, middle, high = np.quantile(after, QUARTILES)
        note = f"Tuned: 99 of 100 starts at λ = 0.1 first saved after {middle:.0f} episodes ({low:.0f} to {high:.0f})"
    title = "Saved by the mean policy, %, and 95 % interval over trainings"
    letter = sheet("Algorithm 2 to the letter", published, {_LONGEST: ".0f", _BEST: ".0%"})
    tuned = sheet(title, evaluated, {"median steps": ",.0f"}, note=note)
    return Report(figures=_overview(table, saved, worth), tables=[letter, tuned])


def _overview(table: Table, saved: Mapping[str, Curve], worth: Mapping[str, Estimate]) -> Figure:
    layout = [[[["ranges", "long"]]], [[["while", "end"]]], ["worth"]]
    figure, axes = mosaic(layout, height=9.4, height_ratios=[1, 1, 1.25])
    ranges = table.where(part="ranges")
    diverged = ranges.assign(diverged=ranges["outcome"] == "diverged").pivot_table("diverged", "beta", "alpha")
    powers = [f"{np.log10(step):.0f}" for step in STEPS]
    heat_map(axes["ranges"], diverged.to_numpy()[::-1], powers[::-1], powers)
    axes["ranges"].set(xlabel="log10 α", ylabel="log10 β", title="as published: trainings that diverge, %")

    for alpha, colour in zip(LONG_STEPS, COLOURS, strict=False):
        own = (table.arrays(name, part=LONG, alpha=alpha) for name in ("at_episode", "lengths"))
        for k, (episodes, lengths) in enumerate(zip(*own, strict=True)):
            label = f"α = {alpha:g}" if k == 0 else None
            axes["long"].plot(episodes / 1000, lengths, color=colour, lw=0.7, label=label)
    axes["long"].axhline(300, color="k", lw=0.8, ls="--")
    axes["long"].set(xlabel="thousands of episodes", ylabel="mean length (samples)", ylim=(0, 315))
    axes["long"].set_title("as published: long runs")

    shares, (episodes, *_) = (table.arrays(name, setting=TUNED) for name in ("share", "at_episode"))
    band(axes["while"], episodes, np.quantile(shares, QUARTILES, axis=0), STYLES[TUNED], "median and quartiles")
    share_axis(axes["while"], "starts saved, λ = 0.1")
    axes["while"].set(xlabel="episodes", title="tuned: mean policy while it learns")

    of = {"without deviation 13" if name.startswith("13") else name: saved[name] for name in STYLES}
    saved_by_angle(axes["end"], of, list(STYLES.values()), aside=0.02)
    axes["end"].set(xticks=LAMS, title="mean policy at the end")
    for name in ("long", "while", "end"):
        axes[name].legend(loc="lower left" if name == "end" else "best")

    forest(axes["worth"], worth, dict.fromkeys(worth, _GREY) | {TUNED: STYLES[TUNED]})
    share_axis(axes["worth"], "trainings that save 99 % at λ = 0.1", "x")
    axes["worth"].set_title("tuned, and with one deviation taken back")
    return figure


if __name__ == "__main__":
    _runner.main("studies.gaussian_qac")
