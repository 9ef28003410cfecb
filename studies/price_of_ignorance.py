"""What is knowledge of the plant worth, in seconds of experience until the swing-up is learned?

Method: learners that know more or less of the plant beforehand, on pilco2011 (20 N, held for .05 s, noise of .01 on all
measurements) and on gustafsson2016 held for .05 s, exact; ten seeds, episodes of five seconds from hanging, ±0.1 rad,
the first of random forces.  A swing-up succeeds if over its last second cart and tip are within .5 m and .1 m of their
places upright.  Recorded are the experience and processor time until the first episode that succeeds, and until the
second of two policies in a row that each swing up at least 90 % of 50 fresh starts; one that failed in its own episode
counts as one that does not, and is not evaluated.  A training ends after four successes in a row if two such policies
are among its own by then, or when the experience is spent.
PPO and DDPG are those of ``docs/results/deep_swing_up``; PILCO's mark is the experience of 20 to 30 trials of 5 s, as
published in 2011.

Finding: on pilco2011 ten of ten seeds swing up, after 7 s of experience (median) knowing the equations but not their
parameters, 15 s [10, 15] knowing their structure, their mirror symmetry and what gravity does when all is turned round,
22.5 s [20, 25] without the latter, 35 s [30, 35] with the structure alone and 32.5 s [25, 35] with the mirror but no
structure; 90 % of fresh starts in ten, ten, nine, seven and eight of ten seeds.  PILCO took 100 to 150 s.  On
gustafsson2016 the first success comes after 7, 10, 20, 29 and 30 s, and 90 % in ten, ten, nine, six and eight.
Knowing nothing, none of twenty trainings succeeds, in 150 s on pilco2011 and in 31 episodes, 101 to 129 s, on
gustafsson2016.  From ``--workers 2 --only "the equations" "structure, mirror, gravity" "structure, mirror" "structure"
"mirror" "nothing"``, kept in docs/results/price_of_ignorance; "second order" has not been run.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

import dpend
from rl import IdentifyAndPlan, Learner, ModelBased, Training
from rl.model_based import settled

from . import _runner
from ._closure import kept_table
from ._estimates import Estimate, median
from ._figures import COLOURS, facets, legend_above, log_axis
from ._runner import Plant, Positive, Report, Result, Table, read_rows, where
from ._tables import Value, sheet

MINUTES = 300

RIGS: Mapping[str, dpend.Rig] = {
    "pilco2011": dpend.rig("pilco2011"),
    "gustafsson2016, 0.05 s": dpend.rig("gustafsson2016").replace(sample_time=0.05, substeps=5),
}
_PLAIN: Callable[..., ModelBased] = partial(ModelBased, structure=False, gravity=False)
PRIORS: Mapping[str, tuple[Callable[..., Learner], float]] = {
    "the equations": (IdentifyAndPlan, 32.0),
    "structure, mirror, gravity": (ModelBased, 60.0),
    "structure, mirror": (partial(ModelBased, gravity=False), 60.0),
    "structure": (partial(ModelBased, mirror=False, gravity=False), 70.0),
    "mirror": (_PLAIN, 120.0),
    "second order": (partial(_PLAIN, mirror=False), 150.0),
    "nothing": (partial(_PLAIN, angles=False, second_order=False, cart_invariance=False, mirror=False), 150.0),
}
"""What builds each learner, by its prior knowledge of the plant, and the greatest experience, s."""
_PILCO = (100.0, 150.0)  # s: 20 to 30 trials of 5 s
_WIDTH = 0.5  # m: of its cost
_ENOUGH = 0.9
_STREAK = 4
_WHITE = {"facecolor": "w", "edgecolor": "none", "pad": 1.0}
_STREAM = 1014  # sets these starts apart from those of learning


@dataclass(frozen=True, kw_only=True)
class Options(_runner.Options):
    """Options of the command line."""

    trainings: Positive = 10  # Seeds of each learner.
    starts: Positive = 50  # Fresh starts on which a policy is evaluated.
    only: tuple[
        str, ...
    ] = ()  # Prior knowledge of the learners that take part, such as "structure, mirror"; left out, all.

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in self.only:
            if name not in PRIORS:
                raise ValueError(
                    f"--only: no learner has the prior knowledge {name!r}; there are: {'; '.join(PRIORS)}."
                )


@dataclass(frozen=True, kw_only=True)
class Job:
    """One training, and the evaluation of its policies."""

    prior: str
    plant: Plant
    training: int
    seconds: float
    starts: int
    seed: int


@dataclass(frozen=True, kw_only=True)
class Row:
    """What a training took; NaN for never, within the experience it had."""

    first: float = math.nan  # experience until the first episode that succeeds, s
    first_cpu: float = math.nan  # processor time of learning and acting until then, s
    failed: int = 0  # episodes that failed after it
    stable: float = math.nan  # experience until the second policy in a row that swings up 90 %
    stable_cpu: float = math.nan
    experience: float  # of the whole training, s
    tried: int = 0  # fresh starts of the last policy evaluated, which end where 90 % are certain or impossible
    succeeded: int = 0
    track_ends: int = 0  # of the last policy's runs on fresh starts, those that ended at the track
    pilco_cost: float = math.nan  # their mean cost by PILCO's measure, a sample, from 0 to 1
    step_p99: float = math.nan  # of its steps, without the first of a run, s
    first_step: float = math.nan  # median of those, which plan from nothing, s


def jobs(options: Options) -> list[Job]:
    """List the work: each learner on each rig, or on the one that was asked for."""
    plants = [Plant(name, json.dumps(rig.to_dict())) for name, rig in RIGS.items()]
    if options.elsewhere:
        plants = [options.elsewhere]
    chosen = options.only or (("the equations",) if options.quick else tuple(PRIORS))
    trainings, starts = (1, 2) if options.quick else (options.trainings, options.starts)
    return [
        Job(prior=prior, plant=plant, training=k, starts=starts, seed=options.seed, seconds=PRIORS[prior][1])
        for prior in chosen for plant in plants for k in range(trainings)
    ]  # fmt: skip


def run(job: Job) -> Result:
    """Train until some episodes in a row succeed; if policies do not swing up 90 % by then, train on and look again."""
    rig, episodes = job.plant.rig, round(job.seconds / 5.0) + 1
    row: dict[str, float] = {}
    arrays: dict[str, np.ndarray] = {}
    for streak in (_STREAK, episodes):
        learner = PRIORS[job.prior][0](rig, episodes=episodes, streak=streak)
        training = learner.train([job.seed, job.training], seconds=job.seconds)
        row = _judged(training, rig, learner, job)
        arrays = {name: training.curve[name].astype(np.float64) for name in ("experience", "success")}
        if "stable" in row or not training.converged:
            break
    return Result([Row(**row)], arrays)  # pyright: ignore[reportArgumentType]


def _judged(training: Training, rig: dpend.Rig, learner: Learner, job: Job) -> dict[str, float]:
    """Return what a row says: policies that succeeded in their own episode are judged until two in a row are good."""
    experience, success = training.curve["experience"], training.curve["success"]
    row: dict[str, float] = {"experience": training.experience}
    rate = training.cost.cpu_seconds / training.experience
    last: dict[str, float] = {}
    if success.any():
        first = int(np.argmax(success))
        row |= {"first": float(experience[first]), "first_cpu": rate * float(experience[first])}
        row["failed"] = int(np.sum(~success[first:].astype(bool)))
        assert training.trail is not None
        own = dict(zip(np.round(experience[:-1], 6).tolist(), success[1:].tolist(), strict=True))
        spent = np.round(training.trail.experience, 6).tolist()
        passed = [bool(own.get(seconds)) for seconds in spent]
        good = False
        for k, policy in enumerate(training.trail.weights):
            if not passed[k] or not (good or any(passed[k + 1 : k + 2])):
                good = False
                continue
            last = _evaluated(rig, policy, learner, job)
            before, good = good, last["succeeded"] >= _ENOUGH * job.starts
            if before and good:
                row |= {"stable": spent[k], "stable_cpu": rate * spent[k]}
                break
    return row | last


def _evaluated(rig: dpend.Rig, policy: dpend.Controller, learner: Learner, job: Job) -> dict[str, float]:
    """Return what a row says of a policy on fresh starts, tried until 90 % of all are certain or impossible."""
    starts = learner.task.starts(np.random.default_rng([_STREAM, job.seed, job.training]), job.starts, rig)
    successes, runs = 0, list[dpend.Run]()
    for tried, x0 in enumerate(starts):
        if successes >= _ENOUGH * job.starts or tried - successes > (1 - _ENOUGH) * job.starts:
            break
        runs.append(dpend.simulate(rig, policy, x0, task=learner.task, seed=job.seed + tried))
        successes += settled(runs[-1])
    return {
        "tried": len(runs),
        "succeeded": successes,
        "track_ends": sum(run.status is dpend.Status.TRACK_END for run in runs),
        "pilco_cost": float(np.mean([pilco_cost(run, learner.task.steps) for run in runs])),
        "step_p99": float(np.quantile(np.concatenate([run.step_time[1:] for run in runs]), 0.99)),
        "first_step": float(np.median([run.step_time[0] for run in runs])),
    }


def pilco_cost(run: dpend.Run, steps: int) -> float:
    """Return the mean of 1 - exp(-d^2 / 2 w^2) over the states after each of so many samples, w = .5 m.

    The true state's tip is d from its place upright above the middle of the track; samples after an early end count 1.
    The measure is that of Deisenroth and Rasmussen, 2011, with the links' true lengths.
    """
    params, place = run.rig.params, dpend.positions(run.x[1:], run.rig.params)
    below = float(params.length1 + params.length2) - place.y_tip
    near = np.exp(-(place.x_tip**2 + below**2) / (2 * _WIDTH**2))
    return float(1 - np.nansum(near) / steps)


_MILESTONES = {
    "first": (COLOURS[0], "o", -0.15, "first success"),
    "stable": (COLOURS[1], "D", 0.15, "stable: 90 % of fresh starts, twice"),
}
"""Colour, marker, place on a line, and words."""
_BALANCED = {
    "most": (COLOURS[0], "o", -0.15, "balancing: 95 % of starts, once"),
    "kept": (COLOURS[2], "s", 0.15, "balancing: 95 % of starts from then on"),
}
_BALANCERS = ("LSPI", "QAC tuned", "Q tuned")


def report(table: Table) -> Report:
    """Draw experience to success against prior knowledge, and tabulate it with processor time."""
    names = [*dict.fromkeys(table.rows["plant"])]
    there = [prior for prior in PRIORS if len(where(table.rows, prior=prior))]
    ratios = [len(there) + 1] * len(names) + [len(_BALANCERS)]
    figure, axes = facets(len(ratios), height=1.6 + 0.38 * sum(ratios), sharex=True, height_ratios=ratios)
    lines: list[dict[str, Value]] = []
    for axis, name in zip(axes[:, 0], names, strict=False):
        for k, prior in enumerate(there):
            own = where(table.rows, plant=name, prior=prior)
            line: dict[str, Value] = {"plant": name, "prior": prior, "trainings": len(own)}
            for kind, middle in _drawn(axis, k, own, _MILESTONES).items():
                line |= {f"{kind}, s": middle, f"{kind}: trainings": int(np.sum(own[kind].notna())),
                         f"{kind}, CPU s": median(own[f"{kind}_cpu"].dropna())}  # fmt: skip
            whole = own["experience"] * own["first_cpu"] / own["first"]
            line |= {"whole training, CPU s, at most": float(np.max(whole)),
                     "failed after the first": int(np.sum(own["failed"])), "fresh starts": int(np.sum(own["tried"])),
                     "ended at the track": int(np.sum(own["track_ends"])),
                     "PILCO's cost": median(own["pilco_cost"].dropna())}  # fmt: skip
            line |= {"p99 of a step, ms": median(1e3 * own["step_p99"].dropna()),
                     "first step, ms": median(1e3 * own["first_step"].dropna())}  # fmt: skip
            lines.append(line)
        words = {"PILCO, 2011": math.sqrt(math.prod(_PILCO))} if name == "pilco2011" else {}
        if name in RIGS and not words:
            words = _deep()
        for said, seconds in words.items():
            axis.annotate(said, (seconds, len(there) - 0.4), ha="center", fontsize=8, bbox=_WHITE)
            if name == "pilco2011":
                axis.axvspan(*_PILCO, color="0.88", lw=0)
            else:
                axis.axvline(seconds, color="0.5", lw=0.8, ls=":")
        axis.set(ylim=(len(there) - 0.1, -0.6), yticks=range(len(there)), yticklabels=there, title=f"Swing-up, {name}")
    balancing = _balancing(axes[-1, 0])
    log_axis(axes[-1, 0], ticks=(2, 5, 10, 20, 50, 100, 200, 1000, 10000, 100000))
    axes[-1, 0].set_xlabel("experience (s)")
    legend_above(figure, 2, "Prior knowledge of the plant, and what it saves")
    tables = [sheet("Experience and processor time to success", lines),
              sheet("Balancing without the equations, from λ = 0.1 as LQR does", balancing)]  # fmt: skip
    return Report(figures=figure, tables=tables)


def _drawn(axis: Axes, k: int, own: pd.DataFrame, milestones: Mapping[str, Any]) -> dict[str, Estimate]:
    """Draw the experience of trainings to milestones on line ``k``, and return the medians."""
    found = {}
    for kind, (colour, mark, lift, label) in milestones.items():
        each, height = own[kind], np.full(len(own), k + lift)
        axis.plot(each, height, mark, color=colour, ms=4, alpha=0.5, mew=0, label=label)
        never = own["experience"].where(each.isna())
        axis.plot(never, height, ">", color="0.4", ms=5, mfc="none", label="not reached by then")
        found[kind] = median(each.fillna(math.inf))
        if math.isfinite(found[kind].value):
            axis.plot([found[kind].value] * 2, [k + lift - 0.12, k + lift + 0.12], color=colour, lw=2.2)
    return found


def _balancing(axis: Axes) -> list[dict[str, Value]]:
    """Draw the experience to balancing on the report's plant, from the trainings of the study of learning curves."""
    rows, lines = where(read_rows(kept_table("learning_curves")), lam=0.1), list[dict[str, Value]]()
    for k, learner in enumerate(_BALANCERS):
        own = where(rows, learner=learner)
        middles = _drawn(axis, k, own, _BALANCED)
        lines.append({"learner": learner, "trainings": len(own), "95 % first, s": middles["most"],
                      "95 % from then on, s": middles["kept"], "CPU s": median(own["most_cpu"].dropna())})  # fmt: skip
    last = len(_BALANCERS)
    axis.set(ylim=(last - 0.5, -0.5), yticks=range(last), yticklabels=_BALANCERS, title="Balancing, gustafsson2016")
    return lines


def _deep() -> dict[str, float]:
    """Return the median experience after which deep learners, on the same plant at .02 s, first swung up 95 %."""
    rows = read_rows(kept_table("deep_swing_up"))
    found = {}
    for label, learner in (("DDPG", "ddpg-swing-up"), ("PPO", "ppo-swing-up")):
        own = where(rows, learner=learner)
        found[label] = float(np.median(own["steps_to_most"] * own["step_seconds"]))
    return found


if __name__ == "__main__":
    _runner.main("studies.price_of_ignorance")
