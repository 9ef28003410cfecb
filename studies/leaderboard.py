"""Which controller is best, at what, how surely, at what cost, and with what prior knowledge?

Method: all contenders of studies/_field.py, as designed or as shipped, on the same starts on gustafsson2016, are ranked
while balancing (θ1, θ2 ~ U[-λ, λ], 300 samples) by success, mean over λ = .1 to .6, and swinging up (from hanging, the
side and anywhere, 10 s, the last of them upright) by success, then by time up.  Of two, the starts that both had count;
NMPC and the learned model have the first ones only; intervals of ranks are from 2000 resamples.  Beside it stand force,
robustness, time of a step in turn with LQR's, and what training cost and how often it failed.

Finding: of what balances, iLQR MPC saves most, 86.8 % [85.6, 88.0] in the mean over λ = .1 to .6, where 87.5 % are
known to be savable, then a linear law tuned for it, 81.0 % [79.7, 82.3], and PPO, 80.6 % [79.3, 81.9]; LQR has 72.5,
LSPI 74.0 and tuned Q-learning 69.4 %, of 1000 starts.  NMPC and iLQR MPC swing up from every start, the learned model
from 149 of 150, DDPG from 98.1 % or more, PPO from 90.3 % or more.  Such a model is learned in 8.9 s from 25 s of
experience, LSPI in 0.02 s from two minutes, PPO's swing-up in two minutes from 89 hours.  From the default options,
kept in docs/results/leaderboard.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import dpend
import rl
from controllers import TunedLaw
from dpend import Balance, Rig, SwingUp
from dpend.controller import is_batched
from dpend.params import Array
from rl.deep import read_recipe, read_trainings
from rl.training import task_name

from . import _field, _runner
from ._board import SAVED, SHOWN, TASKS, UP, Places, board, mean_known, outcomes_of, ranked
from ._boundary import kept_boundary
from ._closure import ROOT, file_hash
from ._estimates import Estimate
from ._field import CONTENDERS, LONG, Contender, Cost, TaskName, find, longest_first, made, styles
from ._figures import facets, forest
from ._own import Own
from ._perturbations import measure
from ._plant import Plant, rig_of
from ._runner import AtLeastTwo, Positive, Report, Result, Table, kept_table, read_rows, where
from ._step_times import undisturbed

MINUTES = 15
GOOD = 0.95  # a training failed if its policy succeeds from less than this share of fresh starts
_NOISE, _NOISY = 0.002, 200
_STREAM = 4127  # sets these starts apart from those of every training, tuning and other study
_CHUNK = 25  # runs in a job of one that has a share of them
_PART = 200  # runs in a job of one that takes minutes for thousands
_TURNS = 3  # runs in which steps are timed, each in turn with one of LQR's
_COMPILING = 5.0  # s of experience
Values = Mapping[str, npt.ArrayLike]  # numbers by quantity, one a run or training


@dataclass(frozen=True, kw_only=True)
class Options(_field.Options):
    """Options of the command line."""

    starts: AtLeastTwo = 1000  # Starts at each λ and of each kind of swing-up; what takes long has the first twentieth.
    trainings: Positive = 10  # Trainings of each learner that learns in seconds.

    def taking_part(self) -> list[Contender]:
        """Return those that take part; where it must be quick, of those that take long only what is asked for."""
        found = {contender.name: contender for task in TASKS for contender in self.contenders(task)}
        slow = [each for each in found.values() if self.quick and (each.cost is not Cost.CHEAP or each.name in LONG)]
        return [each for each in found.values() if each not in slow or each.own or each.name in self.only]

    def runs(self, contender: Contender) -> int:
        """Return on how many starts of each kind a contender is evaluated."""
        few = 20 if contender.cost is Cost.CHEAP else 2
        return min(self.starts, few) if self.quick else contender.cost.runs(self.starts)

    def settings_starts(self, contender: Contender) -> int:
        """Return the starts in each of some hundred settings; none for what would take an hour, or must be quick."""
        if self.quick:
            return 2 if contender.own or contender.name in ("LQR", *self.only) else 0
        return {Cost.CHEAP: 20, Cost.MODERATE: 5, Cost.EXPENSIVE: 0}[contender.cost]


@dataclass(frozen=True, kw_only=True)
class Job:
    """What is measured of one contender, by one of :data:`WORK`."""

    work: str
    contender: str
    task: TaskName
    first: int = 0  # the first run, or the number of the training
    runs: int = 0
    drawn: int = 0  # how many starts are drawn, of which the runs are a part
    lams: tuple[float, ...] = ()
    file: str = ""  # hash of the file of deep trainings
    seed: int
    own: Own | None = None
    elsewhere: Plant | None = None

    @property
    def rig(self) -> Rig:
        """The rig as contenders believe it to be."""
        return rig_of(self.elsewhere)


def jobs(options: Options) -> list[Job]:
    """List the work, what takes longest first; runs that take long are in parts."""
    lams = (0.1, 0.4) if options.quick else tuple(SAVED)
    found = []
    for contender in longest_first(options.taking_part()):
        job = partial(Job, contender=contender.name, seed=options.seed, own=contender.own, elsewhere=options.elsewhere)
        some = partial(job, drawn=options.starts)
        n, several = options.runs(contender), options.settings_starts(contender)
        part = _CHUNK if contender.cost is not Cost.CHEAP else _PART if contender.name in LONG else n
        for task in contender.tasks:
            of = partial(some, task=task, lams=lams if task == "balance" else ())
            found += [of(work="runs", first=first, runs=min(part, n - first)) for first in range(0, n, part)]
            found += [job(work="robustness", task=task, runs=several)] if several else []
            found += [job(work="steps", task=task)]
        if contender.learner:
            task = task_name(contender.learner(options.plant.rig))
            train = partial(some, work="training", task=task, lams=lams, runs=contender.cost.runs(n))
            found += [train(first=k) for k in range(1 if options.quick else options.trainings)]
        elif not contender.policy:
            found += [job(work="ready", task=contender.tasks[0])]
        if contender.trainings and (file := _file(contender)).exists():
            found += [job(work="deep", task=read_recipe(file).task, file=file_hash(file))]
    return found


def run(job: Job) -> Result:
    """Measure; the rows are means of the arrays."""
    found = WORK[job.work](job, find(job.contender, job.own, CONTENDERS))
    arrays = {quantity: np.asarray(values, dtype=np.float64) for quantity, values in found.items()}
    rows = [
        {"quantity": quantity, "n": int(np.isfinite(values).sum()), "mean": mean_known(values)}
        for quantity, values in arrays.items()
    ]
    return Result(rows, arrays)


def _kinds(task: TaskName, lams: Iterable[float], rig: Rig) -> dict[str, Balance | SwingUp]:
    """Return the kinds of starts of a task on a rig, by the name of what is measured on each."""
    if task == "balance":
        return {SAVED[lam]: Balance(lam=lam, steps=300) for lam in lams}
    spreads = {start: 0.0 if start == "anywhere" else 0.1 for start in UP}
    steps = round(10 / rig.sample_time)
    return {UP[start]: SwingUp(start=start, angle_spread=spread, steps=steps) for start, spread in spreads.items()}


def _usual(task: TaskName, rig: Rig) -> Balance | SwingUp:
    """Return the task on which force and time are measured."""
    return next(iter(_kinds(task, SHOWN, rig).values()))


def _starts(task: Balance | SwingUp, n: int, seed: int, rig: Rig) -> Array:
    return task.starts(np.random.default_rng([seed, _STREAM]), n, rig)


def _simulate(job: Job, controller: dpend.Controller, task: Balance | SwingUp, rig: Rig | None = None) -> dpend.Runs:
    """Return the runs of a job on its rig, or on another that its controller knows nothing of."""
    starts = _starts(task, job.drawn, job.seed, job.rig)[job.first : job.first + job.runs]
    return dpend.simulate_many(rig or job.rig, controller, starts, task=task, seed=job.seed, first_row=job.first)


def _runs(job: Job, contender: Contender) -> Values:
    """Return success while balancing, or the time when both links were up for good; and what the force was like."""
    kinds = _kinds(job.task, job.lams, job.rig)
    runs = {what: _simulate(job, made(contender, job.elsewhere, task), task) for what, task in kinds.items()}
    if job.task == "swing-up":
        return {what: each.time_up for what, each in runs.items()} | _forces(next(iter(runs.values())))
    noisy, task = replace(job, runs=min(job.runs, _NOISY - job.first)), _usual("balance", job.rig)
    saved: dict[str, npt.NDArray[Any]] = {what: each.success for what, each in runs.items()}
    if noisy.runs <= 0:
        return saved
    controller = made(contender, job.elsewhere, task)
    return saved | _forces(_simulate(noisy, controller, task, job.rig.replace(sensor_noise=_NOISE)))


def _forces(runs: dpend.Runs) -> dict[str, npt.NDArray[Any]]:
    """Return effort and total variation of the force, NaN of the runs that failed."""
    metrics, units = runs.metrics(), {"effort": "N² s", "variation": "1/s"}
    return {f"{name}, {unit}": np.where(runs.success, metrics[name], np.nan) for name, unit in units.items()}


def _robustness(job: Job, contender: Contender) -> Values:
    controller = made(contender, job.elsewhere, _usual(job.task, job.rig))
    return measure(controller, job.task, job.runs, seed=job.seed, rig=job.rig)


def _steps(job: Job, contender: Contender) -> Values:
    """Time the steps of single runs, in turn with LQR's so that both have the same load, and of 1000 side by side."""
    rig, task, of_lqr = job.rig, _usual(job.task, job.rig), _usual("balance", job.rig)
    controller, lqr = made(contender, job.elsewhere, task), find("LQR").make(rig, of_lqr)
    starts, beside = (_starts(each, _TURNS, job.seed, rig)[:, None] for each in (task, of_lqr))
    with undisturbed():
        _step(rig, lqr, beside[0], of_lqr)  # warms up
        turns = [(_step(rig, lqr, beside[k], of_lqr), _step(rig, controller, starts[k], task)) for k in range(_TURNS)]
        many = [_step(rig, controller, _starts(task, 1000, job.seed, rig), task)] if is_batched(controller) else []
    its, own = zip(*turns, strict=True)
    return {"step, s": own, "step of LQR, s": its} | ({"step of 1000, s": many} if many else {})


def _step(rig: Rig, controller: dpend.Controller, x0: Array, task: Balance | SwingUp) -> float:
    """Return the time of a step by the number of rows: the median of means over ten steps, the first ten left out.

    Some hold their force for several steps, and planners begin from nothing.  Of a run that soon ends, all steps count.
    """
    steps = dpend.simulate_many(rig, controller, x0, task=task).step_time[0]
    steps = steps[np.isfinite(steps)]
    if len(steps) < 20:
        return float(np.median(steps))
    return float(np.median(steps[10 : len(steps) // 10 * 10].reshape(-1, 10).mean(axis=1)))


def _ready(job: Job, contender: Contender) -> Values:
    """Return the processor time from nothing to the first force, and the time simulated where a law was tuned."""
    task = _usual(job.task, job.rig)
    x0 = _starts(task, 1, job.seed, job.rig)

    def seconds() -> float:
        began = time.process_time()
        contender.make(job.rig, task).start(1, np.random.default_rng(job.seed))(0.0, x0)
        return time.process_time() - began

    seconds()  # compiles
    controller = contender.make(job.rig, task)
    if not isinstance(controller, TunedLaw):
        return {"ready, s": [seconds()]}
    return {"ready, s": [seconds() + controller.cost.cpu_seconds], "tests, s": [controller.cost.experience]}


def _training(job: Job, contender: Contender) -> Values:
    """Train, and try the policy on the starts that count in the rank."""
    assert contender.learner is not None
    learner = contender.learner(job.rig)
    learner.train(0, seconds=_COMPILING)
    training = learner.train([job.seed, _STREAM, job.first])
    tried, kinds = replace(job, first=0), _kinds(job.task, [lam for lam in job.lams if lam >= SHOWN[0]], job.rig)
    success = [float(_simulate(tried, training.policy, task).success.mean()) for task in kinds.values()]
    return _costs(training) | {"failed, %": [success[0] < GOOD], "they save, %": [np.mean(success)]}


def _deep(job: Job, contender: Contender) -> Values:
    """Return what kept trainings cost, and which failed on the fresh starts of studies.deep_swing_up."""
    kept = where(read_rows(kept_table("deep_swing_up")), learner=contender.trainings)
    successes = kept["balanced" if job.task == "balance" else "successes"]
    return _costs(*read_trainings(_file(contender)).values()) | {"failed, %": successes < GOOD * kept["starts"]}


def _costs(*trainings: rl.Training) -> dict[str, npt.ArrayLike]:
    costs = [training.cost for training in trainings]
    return {"training, s": [cost.cpu_seconds for cost in costs],
            "learning, s": [cost.steps * cost.sample_time for cost in costs],
            "tests, s": [cost.test_steps * cost.sample_time for cost in costs]}  # fmt: skip


def _file(contender: Contender) -> Path:
    """Return where the trainings of a deep learner are kept."""
    return ROOT / "docs" / "results" / "deep" / f"{contender.trainings}.npz"


WORK: Mapping[str, Callable[[Job, Contender], Values]] = {
    "runs": _runs, "robustness": _robustness, "steps": _steps, "ready": _ready, "training": _training, "deep": _deep,
}  # fmt: skip


def best_known(table: Table) -> dict[float, npt.NDArray[np.bool_]]:
    """Return which of the table's own starts can be saved ``(n,)``, by λ: by studies.recoverable or any contender.

    On another rig than that of the comparisons studies.recoverable has not said, and nothing is returned.
    """
    if table.plant:
        return {}
    runs = table.where(work="runs", task="balance")
    known: dict[float, npt.NDArray[np.bool_]] = {}
    for name in runs["contender"].unique():
        for lam, saved in outcomes_of(table, name, "balance").items():
            if lam not in known:
                n, seed = int(np.max(runs["first"] + runs["runs"])), int(runs["seed"].to_numpy()[0])
                starts = _starts(Balance(lam=lam), n, seed, table.rig)
                known[lam] = kept_boundary().savable(starts)
            known[lam][: len(saved)] |= saved > 0
    return known


def report(table: Table) -> Report:
    """Draw ranks, the best on top, and how often each is first; tabulate all measured, also on a page that sorts."""
    places: dict[TaskName, Places] = {task: found for task in TASKS if (found := ranked(table, task))}
    lines = [len(of) for of in places.values()]
    figure, axes = facets(len(places), height=1.2 + 0.24 * sum(lines), width=6.3, height_ratios=lines)
    for axis, (task, of) in zip(axes[:, 0], places.items(), strict=True):
        forest(axis, {name: place.rank if place else Estimate() for name, place in of.items()}, styles(of, CONTENDERS))
        beside = {"transform": axis.get_yaxis_transform(), "va": "center"}
        for line, (name, place) in enumerate([("first", None), *of.items()], start=-1):
            axis.text(1.02, line, name if line < 0 else f"{place.first:.0%}" if place else "no success", **beside)
        axis.set(xlim=(0.5, len(of) + 0.5), xticks=range(1, len(of) + 1), xlabel=f"rank, {task}, with 95 % interval")
        axis.grid(visible=False, axis="y")
    tables, html = board(table, places, best_known(table))
    return Report(figures=figure, tables=tables, pages={"leaderboard.html": html})


if __name__ == "__main__":
    _runner.main("studies.leaderboard")
