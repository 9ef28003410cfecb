"""Can the report's convergence of 70 %, and its Table 2, be reproduced, whatever it left unstated?

Method: Algorithm 1 with the report's α = 0.0001, ε = 0.01, γ = 0.99 and Table 1, λ = 0.1, on the plant that the report
intended and on that of its program (inertias 0.125 kg m²), with all 18 features and without the cart's six, θ2 starting
at random or at zero; and the program published with it: without the cart's six, ±40 N, no exploration, with its step
size and with one of an earlier version.  Each training ends at 50 successes in a row, when a weight overflows, or when
the episodes are spent.  The first time that it comes to 1, 3, 10, 20 and 50 successes in a row its weights are
evaluated: frozen, and going on learning from the same starts, 50 episodes at each λ of Table 2, beside LQR.  All that
the report leaves unstated is combined: criterion of falling, cost weights, cost of a failed episode, whether the failed
step still bootstraps (as Algorithm 1 is printed).

Finding: the 70 % depend on what is left open. Without the cart's six features a first full episode comes in 75 % [63,
84] of 60 trainings on the program's plant and in 62 % [49, 73] on the intended one, ten in a row in 3 % and 25 %; with
all 18 features none comes. From random starts no frozen weights come near Table 2 beyond λ = 0.1; from θ2 = 0, as in
the program, some do. On the program's plant, θ2 = 0, after ten in a row the same weights succeed in 80 % [73, 87] of
the next episodes going on learning and in 44 % [34, 54] frozen; on the intended plant, and with small steps, frozen
ones do as well or better. From the default options, kept in docs/results/published_q.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

import dpend
from controllers import LQR
from dpend.controller import Controller
from dpend.params import Array
from rl import LinearQLearning, Outcome, Training
from rl.policies import LinearQPolicy

from . import _runner
from ._estimates import Estimate, mean_share, number, share
from ._field import styles
from ._figures import (
    Style,
    facets,
    forest,
    intervals,
    legend_above,
    log_axis,
    palette,
    saved_by_angle,
    share_axis,
)
from ._runner import Plant, Positive, Report, Result, Table
from ._tables import sheet
from .lambda_sweep import TABLE2

MINUTES = 2

AS_CODED = "gustafsson2016_as_coded"
LAMS = tuple(TABLE2)
REPORT_SHARE = 0.7  # of trainings that converge, as the report says
STREAKS = (1, 3, 10, 20, 50)
NO_CART = {"cart_features": False}
PROGRAM = {"forces": (-40.0, 40.0), "epsilon": 0.0}
LEARNERS: Mapping[str, tuple[dict[str, Any], dict[str, Any]]] = MappingProxyType({
    "12 features": (NO_CART, {}),
    "18 features": ({}, {}),
    "program": (NO_CART, PROGRAM),
    "program, α = 1e-6": (NO_CART, PROGRAM | {"alpha": 1e-6}),
})  # fmt: skip
"""Learners without the cart's six features, to the letter, and as the program has it."""
STORED = (0.0, 0.0, 6.43126956e9, 1.05744777e8, -8.54103946e9, -5.98016330e8)
"""Weights of the action's features, in Table 1's order, that are written into the program: GitHub fregu856/CS-229."""
LAWS: Mapping[str, Callable[[dpend.Rig], Controller]] = MappingProxyType({
    "LQR": LQR,
    "stiff LQR": lambda rig: LQR(rig, (1, 10, 10, 1, 1, 1), 0.1),
    "the program's weights": lambda _: LinearQPolicy((*[0.0] * 12, *STORED), [1.0] * 18, PROGRAM["forces"]),
})  # fmt: skip
"""Laws that learn nothing here."""
CRITERIA = {"link 1 alone": "report", "both links": "strict"}
WEIGHTS = {"0:1:1": (0.0, 10.0, 10.0), "1:1:1": (10.0, 10.0, 10.0), "1:10:10": (1.0, 10.0, 10.0)}
FAILURE_COSTS = (0.0, 100.0)
BOOTSTRAPS = {"bootstraps": True, "ends": False}
THETA2 = {"random": None, "zero": 0.0}
DRAWN = 8  # trainings of each whose weights are drawn
DRAWN_LEARNERS = ("12 features, θ2 random", "12 features, θ2 zero", "18 features, θ2 random", "program, θ2 zero",
                  "program, α = 1e-6, θ2 zero")  # fmt: skip
_LOOKS: dict[str, Style] = dict(zip(DRAWN_LEARNERS, (
    ("#D55E00", "o", "-"), ("#009E73", "s", "--"), ("#777777", "v", ":"), ("#CC79A7", "^", "-."),
    ("#E69F00", "P", (0, (6, 1, 1, 1))),
), strict=True)) | {"the report's Table 2": ("#000000", "P", ":")} | styles(("LQR", "stiff LQR"))  # fmt: skip
FROZEN, FEW = DRAWN_LEARNERS[0], 5  # whose frozen weights are drawn beside LQR, where at least so many converged
_FROZEN = {1: (_LOOKS[FROZEN][0], "o", ":"), 3: (_LOOKS[FROZEN][0], "D", "--"), 10: (_LOOKS[FROZEN][0], "s", "-")}


@dataclass(frozen=True, kw_only=True)
class Options(_runner.Options):
    """Options of the command line."""

    trainings: Positive = 60  # Seeds of each learner.
    reading_trainings: Positive = 10  # Seeds of each further combination of what the report leaves unstated.
    max_episodes: Positive = 2000  # Budget of each training.
    episodes: Positive = 50  # Episodes of each evaluation.


@dataclass(frozen=True, kw_only=True)
class Job:
    """The trainings of one learner by one reading of the report, or an LQR; the defaults are the program's reading."""

    plant: Plant
    learner: str
    theta2: str = "random"
    criterion: str = "link 1 alone"
    weights: str = "0:1:1"  # ratio of the cost's weights on position, angle 1 and angle 2
    failure_cost: float = 0.0
    failed_step: str = "bootstraps"
    trainings: int
    max_episodes: int
    episodes: int
    lams: tuple[float, ...]
    seed: int


@dataclass(frozen=True, kw_only=True)
class Row:
    """The trainings of a job by one meaning of convergence."""

    streak: int  # successes in a row that count as convergence; 0 of an LQR
    converged: int
    overflowed: int  # of the trainings, before they converged
    median_episode: float  # at which those that converged did; NaN where none did


def jobs(options: Options) -> list[Job]:
    """List the work: all learners and both LQRs on both plants, and the further readings of the report."""
    o = options
    many, few, max_episodes, episodes = (
        (2, 1, 400, 5) if o.quick else (o.trainings, o.reading_trainings, o.max_episodes, o.episodes)
    )
    work: list[Job] = []
    for plant in dict.fromkeys((replace(o, rig=AS_CODED, set=()).plant, o.plant)):
        main = Job(plant=plant, learner="LQR", trainings=min(o.trainings, many), lams=LAMS, seed=o.seed,
                   max_episodes=min(o.max_episodes, max_episodes), episodes=min(o.episodes, episodes))  # fmt: skip
        own = [replace(main, learner=learner, theta2=theta2) for learner in LEARNERS for theta2 in THETA2]
        fewer = replace(main, trainings=min(o.reading_trainings, few), lams=LAMS[:1])
        further = [
            replace(fewer, learner=learner, theta2=theta2, criterion=c, weights=w, failure_cost=f, failed_step=b)
            for learner, theta2 in itertools.product(list(LEARNERS)[:2], THETA2)
            for c, w, f, b in itertools.islice(_readings(), 1, None)
        ]
        work += own + further + [replace(main, learner=law) for law in LAWS]
    return work


def _readings() -> Iterator[tuple[str, str, float, str]]:
    """Return all combinations of what the report leaves unstated, that of the program first."""
    yield from itertools.product(CRITERIA, WEIGHTS, FAILURE_COSTS, BOOTSTRAPS)


def run(job: Job) -> Result:
    """Train from every seed, and evaluate the weights at each meaning of convergence.

    The arrays: ``frozen`` (trainings, streaks, starts with θ2 random and zero, λ) and ``learning`` (trainings, streaks,
    λ), which starts as in training, count successes, -1 where there are none; ``growth`` is log10 of the greatest
    weight of some trainings after some episodes.
    """
    rig = job.plant.rig
    tasks = {
        theta2: dpend.Balance(criterion=CRITERIA[job.criterion], state_weights=WEIGHTS[job.weights],
                              failure_cost=job.failure_cost, lam2=lam2)
        for theta2, lam2 in THETA2.items()
    }  # fmt: skip
    shape = job.trainings, len(STREAKS), len(THETA2), len(job.lams)
    frozen, learning = np.full(shape, -1, np.int16), np.full((*shape[:2], shape[3]), -1, np.int16)
    if job.learner in LAWS:
        law = LAWS[job.learner](rig)
        for k in range(job.trainings):
            for j, task in enumerate(tasks.values()):
                drawn = [replace(task, lam=lam).starts(np.random.default_rng([job.seed, 5, k]), job.episodes, rig)
                         for lam in job.lams]  # fmt: skip
                frozen[k, 0, j] = _saved(rig, law, drawn, task)
        return Result(
            [Row(streak=0, converged=job.trainings, overflowed=0, median_episode=0.0)], {"frozen": frozen[:, :1]}
        )
    kind, changes = LEARNERS[job.learner]
    learner = LinearQLearning.published(rig, task=tasks[job.theta2], **kind)
    learner = replace(learner, bootstrap_failure=BOOTSTRAPS[job.failed_step], max_episodes=job.max_episodes,
                      streak=STREAKS[-1], **changes)  # fmt: skip
    reached, ended = np.zeros(shape[:2], np.int32), np.zeros(job.trainings, bool)
    growth = np.full((DRAWN, len(_drawn(job.max_episodes))), np.nan, np.float32)
    for k in range(job.trainings):
        training = learner.train([job.seed, 3, k])
        history, ended[k] = training.details["weights"], training.outcome is Outcome.DIVERGED
        if k < DRAWN:
            at = _drawn(job.max_episodes)
            at = at[at <= len(history)]
            growth[k, : len(at)] = np.log10(np.abs(history[at - 1]).max(axis=1))
        reached[k] = [_first(training, streak) for streak in STREAKS]
        for i, episode in enumerate(reached[k]):
            if not episode:
                continue
            weights = history[episode - 1]
            starts: dict[str, list[Array]] = {theta2: [] for theta2 in THETA2}
            for j, lam in enumerate(job.lams):
                rng = np.random.default_rng([job.seed, 4, k, i, j])
                for theta2, task in tasks.items():
                    starts[theta2].append(replace(task, lam=lam).starts(rng, job.episodes, rig))
                on = replace(learner, task=replace(learner.task, lam=lam), initial=tuple(weights.tolist()),
                             max_episodes=job.episodes, streak=job.episodes + 1)  # fmt: skip
                going_on = on.train([job.seed, 6, k, i, j])
                learning[k, i, j] = going_on.curve["success"].sum()
                angles = going_on.details["angles"]  # fewer than asked for where a weight overflowed
                starts[job.theta2][-1][: len(angles), 1:3] = angles
            policy = LinearQPolicy(weights, learner.scales, learner.forces)
            frozen[k, i] = [_saved(rig, policy, starts[theta2], task) for theta2, task in tasks.items()]
    rows = [Row(streak=streak, converged=int((met > 0).sum()), overflowed=int((ended & (met == 0)).sum()),
                median_episode=float(np.median(met[met > 0])) if met.any() else math.nan)
            for streak, met in zip(STREAKS, reached.T, strict=True)]  # fmt: skip
    return Result(rows, {"frozen": frozen, "learning": learning} | ({"growth": growth} if len(job.lams) > 1 else {}))


def _first(training: Training, streak: int) -> int:
    """Return the episode at which a training first comes to so many successes in a row, 0 where it does not."""
    in_a_row = 0
    for episode, success in enumerate(training.curve["success"], start=1):
        in_a_row = in_a_row + 1 if success else 0
        if in_a_row == streak:
            return episode
    return 0


def _saved(rig: dpend.Rig, law: Any, starts: list[Array], task: dpend.Balance) -> Array:
    """Return the successes of a law from each of several sets of starts."""
    return dpend.simulate_many(rig, law, np.concatenate(starts), task=task).success.reshape(len(starts), -1).sum(axis=1)


def _drawn(max_episodes: int) -> Any:
    """Return the episodes after which the weights are drawn."""
    return np.unique(np.geomspace(1, max_episodes, 80).round().astype(int))


def _shares(counts: Array, episodes: int) -> list[Estimate]:
    """Return mean shares over the trainings that converged, of counts ``(trainings, m)``."""
    done = counts[counts[:, 0] >= 0]
    return [mean_share(each / episodes, len(each) * episodes) if len(each) else Estimate() for each in done.T]


def report(table: Table) -> Report:
    """Draw convergence, growth of the weights, and what the weights save, frozen and learning on; tabulate all."""
    plants, episodes = list(dict.fromkeys(table.rows["plant"])), max(table.rows["episodes"])
    letter = dict(zip(("criterion", "weights", "failure_cost", "failed_step"), next(_readings()), strict=True))
    figure, axes = facets(4, len(plants), height=9.6, sharex="row", sharey="row")
    beside, below = facets(2, len(plants), height=5.6, sharex=True, sharey=True)
    converged, saved = [], []
    for (converging, growing, *ways_on), by_angle, plant in zip(axes.T, below.T, plants, strict=True):
        table2 = [Estimate(value) for value in TABLE2.values()]
        laws = {"the report's Table 2": [table2, table2]}
        for law in LAWS:
            (frozen,) = table.arrays("frozen", plant=plant, learner=law)
            laws[law] = [_shares(frozen[:, 0, j], episodes) for j in range(2)]
        saved += [_line(plant, law, of[: 1 if of[0] is table2 else 2]) for law, of in laws.items()]
        for learner, theta2 in itertools.product(LEARNERS, THETA2):
            own, name = {"plant": plant, "learner": learner, "theta2": theta2, **letter}, f"{learner}, θ2 {theta2}"
            frozen, learning = table.array("frozen", **own), table.array("learning", **own)
            rows = list(table.lines(**own))
            rates = [share(row.converged, row.trainings) for row in rows]
            converged.append({"plant": plant, "learner": name, "trainings": rows[0].trainings}
                             | {f"{row.streak} in a row, %": rate for row, rate in zip(rows, rates, strict=True)}
                             | {"overflow before 50": rows[-1].overflowed,
                                "median episode, 1 / 10 in a row": " / ".join(
                                    number(rows[i].median_episode) for i in (0, 2))})  # fmt: skip
            ways: list[tuple[Estimate, Estimate]] = []
            for i, row in enumerate(rows):
                on, of = _shares(learning[:, i], episodes), [_shares(frozen[:, i, j], episodes) for j in range(2)]
                ways.append((on[0], of[list(THETA2).index(theta2)][0]))
                if row.converged:
                    saved.append(_line(plant, name, of, row, ways[-1]))
                if name == FROZEN and row.converged >= FEW and row.streak in _FROZEN:
                    laws[f"frozen after {row.streak} in a row"] = of
            if name not in _LOOKS:
                continue
            look = _LOOKS[name]
            place = np.array(STREAKS) * 1.05 ** (list(_LOOKS).index(name) - 2)
            intervals(converging, place, rates, look, label=name)
            for each in table.array("growth", **own):
                growing.plot(_drawn(rows[0].max_episodes)[: len(each)], each, color=look[0], ls=look[2], lw=0.7)
            for axis, each in zip(ways_on, zip(*ways, strict=True), strict=True):
                intervals(axis, place, each, look)
        converging.axhline(REPORT_SHARE, color="k", ls="--", lw=1, label="the report")
        converging.set(title=plant, xlabel="successes in a row that are convergence")
        growing.axhline(np.log10(np.finfo(float).max), color="k", lw=1)
        growing.yaxis.set_major_formatter(lambda value, _: f"1e{value:.0f}")
        growing.set_xlabel("episode")
        for axis in ways_on:
            axis.set_xlabel("successes in a row before")
        for axis in (converging, *ways_on):
            log_axis(axis, ticks=STREAKS)
        looks = _LOOKS | {f"frozen after {streak} in a row": look for streak, look in _FROZEN.items()}
        for j, (axis, theta2) in enumerate(zip(by_angle, THETA2, strict=True)):
            drawn = {law: dict(zip(LAMS, of[j], strict=True)) for law, of in laws.items() if law in looks}
            saved_by_angle(axis, drawn, looks, f"starts saved, θ2 {theta2}" if plant == plants[0] else "")
        by_angle[0].set(title=plant, xlabel="")
    share_axis(axes[0, 0], "trainings that converge")
    axes[1, 0].set_ylabel("greatest weight, up to overflow")
    for axis, way in zip(axes[2:, 0], ("going on learning", "with frozen weights"), strict=True):
        share_axis(axis, f"next {episodes} episodes that\nsucceed, {way}")
    for each in (figure, beside):
        legend_above(each, 3)
    tables = [
        sheet("Trainings that converge, by the successes in a row that are convergence", converged),
        sheet(f"What the weights save at that moment: learning on over {episodes} episodes and frozen from the "
              "same starts, λ = 0.1; and frozen from others, whose θ2 is random or zero", saved),
        sheet("All readings of the report", _by_criterion(table, plants)),
    ]  # fmt: skip
    return Report(figures={"": figure, "_table2": beside, "_readings": _forests(table, plants)}, tables=tables)


def _line(plant: str, law: str, of: list[list[Estimate]], row: Any = None,
          ways: tuple[Estimate | None, Estimate | None] = (None, None)) -> dict[str, Any]:  # fmt: skip
    """Return what a law, or the weights at one meaning of convergence, saves, as a line of the table."""
    streak, converged = (None, None) if row is None else (row.streak, row.converged)
    return {"plant": plant, "law": law, "in a row": streak, "converged": converged,
            "learning on, %": ways[0], "frozen, %": ways[1]} | {
        f"θ2 {theta2}, λ = {lam:g}, %": each
        for theta2, own in zip(THETA2, of, strict=False) for lam, each in zip(LAMS, own, strict=True)
    }  # fmt: skip


def _forests(table: Table, plants: list[str]) -> Any:
    """Draw the share of trainings without the cart's six features that converge by each reading of the report."""
    figure, axes = facets(len(plants), 4, height=1.2 + 2.9 * len(plants), sharex=True, sharey=True)
    looks = dict(zip((1, 10, 50), palette("abc").values(), strict=True))
    for line, plant in zip(axes, plants, strict=True):
        for axis, (criterion, theta2) in zip(line, itertools.product(CRITERIA, THETA2), strict=True):
            for (streak, look), aside in zip(looks.items(), (-0.25, 0.0, 0.25), strict=True):
                rates = {f"{each.weights}, {each.failure_cost:g}, {each.failed_step}":
                         share(each.converged, each.trainings)
                         for each in table.lines(plant=plant, learner="12 features", criterion=criterion,
                                                 theta2=theta2, streak=streak)}  # fmt: skip
                forest(axis, rates, look, aside=aside, label=f"{streak} in a row")
            axis.axvline(REPORT_SHARE, color="k", ls="--", lw=1, label="the report")
            axis.set_title(f"{criterion},\nθ2 {theta2}", fontsize=7.5)
            share_axis(axis, along="x")
        line[0].set_ylabel(plant, fontsize=7.5)
    figure.supxlabel("trainings that converge, without the cart's six features")
    figure.supylabel("cost weights p:θ1:θ2, failure cost, failed step")
    legend_above(figure, 4)
    return figure


def _by_criterion(table: Table, plants: list[str]) -> list[dict[str, str]]:
    """Return a line for each criterion of falling; of its combinations the best is shown, since they share seeds."""
    lines = []
    for plant, learner, theta2, criterion in itertools.product(plants, list(LEARNERS)[:2], THETA2, CRITERIA):
        own = {"plant": plant, "learner": learner, "theta2": theta2, "criterion": criterion}
        lines.append({"plant": plant, "learner": f"{learner}, θ2 {theta2}", "falling is": criterion})
        for streak in STREAKS:
            rows = table.where(**own, streak=streak)
            done, n = rows["converged"], rows["trainings"]
            lines[-1][f"{streak} in a row"] = f"{done.sum()} of {n.sum()}, at best {(done / n).max():.0%}"
    return lines


if __name__ == "__main__":
    _runner.main("studies.published_q")
