"""Who is best, at what, how surely, at what cost, and what had each been told?

Method: all of studies/_entrants.py, as designed or as shipped, meet the same starts on gustafsson2016.  Balancing:
θ1, θ2 ~ U[-λ, λ], 300 samples, neither link falls; λ = .05 to .6.  Swing-up: from hanging and from the side, angles
moved by ±0.1 rad, and from anywhere; 10 s, the last of them upright.  Force: while balancing from λ = .1 with noise of
0.002 on every measured state, and while swinging up from hanging.  Robustness: studies.robustness's score.  Steps are
timed in one process, run by run in turn with LQR's.  Learners of seconds are trained anew, the cost of deep ones is
that of the trainings in docs/results/deep.  Balancing is ranked by success, mean over λ = .1 to .6; swing-up by
success, mean over the three starts, then by time up.  Of two, the starts that both met count; ranks are drawn anew
2000 times.  Slow ones meet the first of the starts only.

Finding: of what balances, iLQR MPC saves most, 88.2 % [85.7, 90.8] in the mean over λ = .1 to .6 (200 starts), then PPO
with 80.6 % [79.3, 81.9]; LQR has 72.5, LSPI 74.0 and tuned Q-learning 69.4 % of 1000.  NMPC and iLQR MPC swing up from
every start (50 and 200 of each kind), DDPG from 100, 100 and 98.1 % (hanging, side, anywhere), PPO from 93.8, 100 and
90.3 %.  LSPI learned in 0.04 s from two minutes of experience, and failed in 1 of 10 trainings; PPO's swing-up took two
minutes and 89 hours.  From the default options, kept in docs/results/leaderboard.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Group, RenderableType

import dpend
from dpend import Balance, SwingUp
from dpend.controller import is_batched
from dpend.params import Array
from dpend.provenance import fingerprint
from rl.linear_q import Outcome

from . import _entrants, _study, deep_swing_up, recoverable
from ._entrants import ENTRANTS, RIG, YOURS, Entrant, Task
from ._intervals import crossing, over_seeds, wilson
from ._page import Cell, Column, Line, markdown, page, terminal
from ._perturbations import AXES, mean_share, measure, score
from ._ranks import Ranking, ranking
from ._step_times import undisturbed
from ._study import Job, Result, Traces
from .learning_curves import small

LAMS = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
"""Spreads of the starting angles, rad; all but the first count in the score."""
SHOWN = (0.1, 0.2, 0.3, 0.4)
STARTS = ("hanging", "side", "anywhere")
TASKS: tuple[Task, ...] = ("balance", "swing-up")
GOOD = 0.95
"""A training failed if its policy succeeds from less than this share of fresh starts."""

REFERENCE = "recoverable"

_NOISE, _NOISY = 0.002, 200
_STREAM = 4127  # sets these starts apart from those of every training, tuning and other study
_CHUNK = 25  # runs of one that takes long, in a job
_TURNS = 3  # runs in which steps are timed, each in turn with one of LQR's


@dataclass(frozen=True, kw_only=True)
class Options(_entrants.Options):
    """What can be told on the command line."""

    starts: int = 1000
    """Starts at each λ and of each kind of swing-up; those that take long meet a share of them."""
    trainings: int = 10
    """New trainings of each learner that learns in seconds."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_least(2, "starts")
        self.check_least(1, "trainings")

    def taking_part(self, task: Task) -> list[Entrant]:
        """Return those that do a task; where it must be quick, none that takes long but those that are named."""
        named = self.only if self.quick else [entrant.name for entrant in ENTRANTS]
        return [each for each in self.entrants(task) if each.part == 1 or each.source or each.name in named]

    def runs(self, entrant: Entrant) -> int:
        """Return how many starts somebody meets; few where it must be quick."""
        return entrant.runs(self.starts) if not self.quick else min(self.starts, 20 if entrant.part == 1 else 2)

    def part(self, entrant: Entrant, chunk: int) -> tuple[int, int]:
        """Return the first start of a job, and how many there are in it."""
        first = chunk * _CHUNK if entrant.part < 1 else 0
        return first, min(self.runs(entrant) - first, _CHUNK if entrant.part < 1 else self.starts)

    @property
    def lams(self) -> tuple[float, ...]:
        """The spreads; two where it must be quick."""
        return (0.1, 0.4) if self.quick else LAMS

    def balance(self, lam: float = 0.1) -> Balance:
        """Return the task of balancing; one second of it where it must be quick."""
        return Balance(lam=lam, steps=50 if self.quick else 300)

    def swing_up(self, start: str = "hanging") -> SwingUp:
        """Return the task of swinging up; one second of it where it must be quick."""
        return SwingUp(start=start, angle_spread=0.0 if start == "anywhere" else 0.1, steps=50 if self.quick else 500)

    def task(self, task: Task) -> Balance | SwingUp:
        """Return a task from where its force is measured."""
        return self.balance() if task == "balance" else self.swing_up()


@dataclass(frozen=True, kw_only=True)
class Row:
    """What one of those that take part gave in some runs."""

    entrant: str
    quantity: str
    """What was measured, with its unit where it has one; see :data:`QUANTITIES`."""
    first: int
    """Number of the first run, or of the training."""
    values: str
    """A number for each run, 1 for a success and 0 for a failure, nan where there is none; of the robustness, the score
    and its interval."""


QUANTITIES = {
    "saved, λ = ...": "balancing from that spread: success",
    "effort balancing, N² s": "∫u² dt while balancing from λ = 0.1 with noise, of the runs that succeed",
    "variation balancing, 1/s": "total variation of the force there, in force limits per second",
    "up from ..., s": "swing-up: when both links were up for good",
    "effort from hanging, N² s": "∫u² dt over the ten seconds, of the runs that succeed",
    "variation from hanging, 1/s": "total variation of the force there",
    "robustness balance, robustness swing-up": "score of studies.robustness, and its interval",
    "step balance, s": "time of a step, one run at a time: mean over ten steps, of which the median; one number a run",
    "step of LQR balance, s": "the same of LQR's, run by run in turn",
    "step of 1000 balance, s": "time of a step of 1000 rows side by side, by 1000",
    "ready, s": "processor time from nothing to the first force, the second time",
    "training, s": "processor time of a training",
    "learning, s": "experience of a training, s of the plant's time",
    "tests, s": "the same of its acceptance tests or evaluations; of deep learners, at most",
    "failed": "whether a training failed",
    "training saves": "success of a new training's policy, mean over λ = .1 to .6",
}
"""What is in the table's rows.  ``swing-up`` stands for ``balance`` where that task was timed."""


def _row(entrant: Entrant, quantity: str, first: int, values: npt.ArrayLike) -> Row:
    numbers = np.atleast_1d(np.asarray(values, dtype=np.float64))
    return Row(entrant=entrant.name, quantity=quantity, first=first, values=" ".join(f"{n:.4g}" for n in numbers))


# ------------------------------------------------------------------------------------------------------------ the work


def jobs(options: Options) -> list[Job]:
    """List the work: who does what, in parts where it takes long."""
    found = []
    for task in TASKS:
        for entrant in options.taking_part(task):
            chunks = -(-options.runs(entrant) // _CHUNK) if entrant.part < 1 else 1
            found += [Job(f"{task} + {entrant.name}", chunk, entrant.source) for chunk in range(chunks)]
            if _robustness_starts(entrant, options):
                found.append(Job(f"robustness {task} + {entrant.name}", 0, entrant.source))
            found.append(Job(f"steps {task} + {entrant.name}", 0, entrant.source))
    for entrant in _all(options):
        if not entrant.policy:
            found.append(Job(f"ready + {entrant.name}", 0, entrant.source))
        if entrant.learner is not None:
            trainings = 1 if options.quick else options.trainings
            found += [Job(f"training + {entrant.name}", k) for k in range(trainings)]
        if entrant.trainings:
            table = fingerprint(_study.kept_table("deep_swing_up"))
            found.append(Job(f"deep + {entrant.name}", 0, table))
    return found


def _all(options: Options) -> list[Entrant]:
    return list({entrant.name: entrant for task in TASKS for entrant in options.taking_part(task)}.values())


def _robustness_starts(entrant: Entrant, options: Options) -> int:
    """Return starts in each of some hundred settings; none for what would take an hour, or where it must be quick."""
    if options.quick:
        return 2 if entrant.source or entrant.name == "LQR" else 0
    return 0 if entrant.part < 0.1 else 20 if entrant.part == 1 else 5


def run(job: Job, options: Options) -> Result:
    """Do one piece of work."""
    kind, name = job.setting.split(" + ", 1)
    entrant = options.entrant(name)
    what, _, of = kind.partition(" ")
    task: Task = "balance" if of == "balance" else "swing-up"
    work = {
        "balance": lambda: _balance(entrant, job.repetition, options),
        "swing-up": lambda: _swing_up(entrant, job.repetition, options),
        "robustness": lambda: _robustness(entrant, task, options),
        "steps": lambda: _steps(entrant, task, options),
        "ready": lambda: _ready(entrant, options),
        "training": lambda: _training(entrant, job.repetition, options),
        "deep": lambda: _deep(entrant),
    }
    return Result(work[what]())


def _starts(task: Balance | SwingUp, n: int, options: Options) -> Array:
    return task.starts(np.random.default_rng([options.seed, _STREAM]), n, RIG)


def _balance(entrant: Entrant, chunk: int, options: Options) -> list[Row]:
    first, n = options.part(entrant, chunk)
    rows = []
    for lam in options.lams:
        task = options.balance(lam)
        x0 = _starts(task, first + n, options)[first:]
        runs = dpend.simulate_many(RIG, entrant.make(RIG, task), x0, task=task, seed=options.seed, first_row=first)
        rows.append(_row(entrant, f"saved, λ = {lam:g}", first, runs.success))
    m = min(n, _NOISY - first)
    if m > 0:
        task, noisy = options.balance(), RIG.replace(sensor_noise=_NOISE)
        x0 = _starts(task, first + m, options)[first:]
        runs = dpend.simulate_many(noisy, entrant.make(RIG, task), x0, task=task, seed=options.seed, first_row=first)
        rows += _forces(entrant, "balancing", first, runs)
    return rows


def _swing_up(entrant: Entrant, chunk: int, options: Options) -> list[Row]:
    first, n = options.part(entrant, chunk)
    rows = []
    for start in STARTS:
        task = options.swing_up(start)
        x0 = _starts(task, first + n, options)[first:]
        runs = dpend.simulate_many(RIG, entrant.make(RIG, task), x0, task=task, seed=options.seed, first_row=first)
        rows.append(_row(entrant, f"up from {start}, s", first, runs.time_up))
        if start == "hanging":
            rows += _forces(entrant, "from hanging", first, runs)
    return rows


def _forces(entrant: Entrant, what: str, first: int, runs: dpend.Runs) -> list[Row]:
    metrics = runs.metrics()
    return [
        _row(entrant, f"{name} {what}, {unit}", first, np.where(runs.success, metrics[name], np.nan))
        for name, unit in (("effort", "N² s"), ("variation", "1/s"))
    ]


def _robustness(entrant: Entrant, task: Task, options: Options) -> list[Row]:
    controller = entrant.make(RIG, options.task(task))
    outcomes = measure(controller, task, _robustness_starts(entrant, options), seed=options.seed)
    return [_row(entrant, f"robustness {task}", 0, score(outcomes))]


def _steps(entrant: Entrant, task: Task, options: Options) -> list[Row]:
    """Time the steps of single runs, in turn with LQR's so that both meet the same load, and of 1000 side by side."""
    the_task = options.task(task)
    yardstick = options.balance()
    lqr, controller = options.entrant("LQR").make(RIG, yardstick), entrant.make(RIG, the_task)
    own, its = [], []
    with undisturbed():
        for start, beside in zip(
            *(_starts(each, _TURNS, options)[:, None] for each in (the_task, yardstick)), strict=True
        ):
            its.append(_step(lqr, beside, yardstick))
            own.append(_step(controller, start, the_task))
        rows = [_row(entrant, f"step {task}, s", 0, own), _row(entrant, f"step of LQR {task}, s", 0, its)]
        if is_batched(controller):
            many = _starts(the_task, 1000, options)
            rows.append(_row(entrant, f"step of 1000 {task}, s", 0, _step(controller, many, the_task)))
    return rows


def _step(controller: dpend.Controller, x0: Array, task: Balance | SwingUp) -> float:
    """Return the time of a step by the number of rows: the mean over ten steps, of which the median.

    Some hold their force for several steps, so a step alone says little; the first ten, in which planners begin from
    nothing, do not count.
    """
    steps = dpend.simulate_many(RIG, controller, x0, task=task).step_time[0]
    return float(np.nanmedian(steps[10 : len(steps) // 10 * 10].reshape(-1, 10).mean(axis=1)))


def _ready(entrant: Entrant, options: Options) -> list[Row]:
    task = options.task(entrant.tasks[0])
    x0 = _starts(task, 1, options)

    def seconds() -> float:
        began = time.process_time()
        entrant.make(RIG, task).start(1, np.random.default_rng(options.seed))(0.0, x0)
        return time.process_time() - began

    seconds()  # compiles
    return [_row(entrant, "ready, s", 0, seconds())]


def _training(entrant: Entrant, k: int, options: Options) -> list[Row]:
    assert entrant.learner is not None
    learner = entrant.learner(RIG)
    small(learner).train(0)  # compiles
    if options.quick:
        learner = small(learner)
    began = time.process_time()
    training = learner.train([options.seed, _STREAM, k])
    seconds = time.process_time() - began
    saved = {}
    for lam in options.lams:
        task = options.balance(lam)
        x0 = _starts(task, min(options.starts, 20 if options.quick else 1000), options)
        saved[lam] = float(dpend.simulate_many(RIG, training.policy, x0, task=task).success.mean())
    found = {
        "training, s": seconds,
        "learning, s": training.steps * RIG.sample_time,
        "tests, s": training.test_steps * RIG.sample_time,
        "failed": training.outcome is not Outcome.CONVERGED or saved[0.1] < GOOD,
        "training saves": np.mean([saved[lam] for lam in options.lams if lam >= SHOWN[0]]),
    }
    return [_row(entrant, quantity, k, value) for quantity, value in found.items()]


def _deep(entrant: Entrant) -> list[Row]:
    """Read what the trainings cost; their seeds are theirs."""
    rows = []
    for kept in deep_swing_up.shipped():
        if kept.learner == entrant.trainings:
            found = {
                "training, s": kept.cpu_seconds,
                "learning, s": kept.steps * kept.step_seconds,
                "tests, s": kept.test_seconds,
                "failed": kept.successes < GOOD * kept.starts,
            }
            rows += [_row(entrant, quantity, kept.training, value) for quantity, value in found.items()]
    return rows


# ------------------------------------------------------------------------------------------------------------ the table


class Found:
    """The rows by who takes part and quantity.

    Parameters
    ----------
    rows : iterable of Row
        The table.
    """

    def __init__(self, rows: Iterable[Row]) -> None:
        self._of: dict[str, dict[str, Array]] = {}
        for row in sorted(rows, key=lambda row: row.first):
            own = self._of.setdefault(row.entrant, {})
            values = np.array(row.values.split(), dtype=np.float64)
            own[row.quantity] = np.concatenate([own.get(row.quantity, np.empty(0)), values])
        known = [entrant.name for entrant in ENTRANTS]
        self.names = sorted(self._of, key=lambda name: known.index(name) if name in known else len(known))
        """All that take part, the user's own last."""
        quantities = {quantity for own in self._of.values() for quantity in own}
        self.lams = sorted(float(each.removeprefix("saved, λ = ")) for each in quantities if each.startswith("saved"))

    def of(self, name: str, quantity: str) -> Array:
        """Return the numbers of somebody, none where there are none."""
        return self._of[name].get(quantity, np.empty(0))

    def saved(self, name: str) -> Array:
        """Return successes ``(n, L)`` of balancing, a row a start."""
        return np.stack([self.of(name, f"saved, λ = {lam:g}") for lam in self.lams], axis=1)

    def doing(self, task: Task) -> list[str]:
        """Return the names of those that do a task."""
        first = {"balance": [f"saved, λ = {lam:g}" for lam in self.lams], "swing-up": ["up from hanging, s"]}[task]
        return [name for name in self.names if first and len(self.of(name, first[0]))]


class Ranked(NamedTuple):
    """Who does a task, and their ranks."""

    names: list[str]
    ranking: Ranking


def scored(lams: Iterable[float]) -> npt.NDArray[np.bool_]:
    """Return which spreads count in the score of balancing: from λ = .1 on."""
    return np.array([lam >= SHOWN[0] for lam in lams])


def ranked(found: Found) -> dict[Task, Ranked]:
    """Rank those that balance and those that swing up, by what the study's docstring says.

    Parameters
    ----------
    found : Found
        The table.

    Returns
    -------
    dict
        By task; a task that nobody does is left out.
    """
    ranks: dict[Task, Ranked] = {}
    balancing = found.doing("balance")
    if balancing:
        shares = [found.saved(name)[:, scored(found.lams)].mean(axis=1) for name in balancing]
        ranks["balance"] = Ranked(balancing, ranking([[(share, np.ones(len(share)))] for share in shares]))
    swinging = found.doing("swing-up")
    if swinging:
        criteria = []
        for name in swinging:
            times = np.stack([found.of(name, f"up from {start}, s") for start in STARTS], axis=1)
            up = np.isfinite(times)
            lost = -np.where(up, times, 0.0).sum(axis=1)
            criteria.append([(up.mean(axis=1), np.ones(len(up))), (lost, up.sum(axis=1))])
        ranks["swing-up"] = Ranked(swinging, ranking(criteria))
    return ranks


_NAME = Column("", "controller", "Who takes part.", words=True)

_RANK = "{}: one more than the number of those that do better on the starts that both met, and its 95 % interval."

BALANCE = (
    Column("Balance", "rank", _RANK.format("Rank by success, mean over λ = 0.1 to 0.6")),
    Column("Balance", "first, %", "In how many of 2000 resamples of the starts nobody does better."),
    Column("Balance", "next is better, %", "In how many of them the next in this ranking does better."),
    *(
        Column("Balance", f"λ = {lam:g}", f"Starts saved, %, θ1, θ2 within {lam:g} rad, and Wilson's 95 % interval.")
        for lam in SHOWN
    ),
    Column("Balance", "mean", "Starts saved, %, mean over λ = 0.1 to 0.6, which the rank goes by; 95 % interval."),
    Column("Balance", "λ90, rad", "The spread at which 90 % are saved, and its 95 % interval."),
    Column(
        "Balance", "robust, %",
        f"Success in {sum(len(axis.levels) for axis in AXES)} settings of a rig that is not what was promised, from "
        "λ = 0.1, mean over six axes, and its 95 % interval (studies.robustness).",
    ),
    Column(
        "Balance", "variation, 1/s",
        "Total variation of the force in force limits per second, from λ = 0.1 with noise of 0.002 on every measured "
        "state: mean over 200 runs, or those there are, that succeed.",
    ),
    Column("Balance", "effort, N² s", "∫u² dt of the same runs, over 6 s."),
    Column("Balance", "step, ms", "Time of a step, one run at a time; beside it, by LQR's in turn with it."),
    Column("Balance", "of 1000, µs", "Time of a step of 1000 runs side by side, by 1000."),
    Column("Balance", "starts", "Starts met at each λ: the first of all where one takes long."),
)  # fmt: skip

SWING_UP = (
    Column("Swing-up", "rank", _RANK.format("Rank by success, mean over the three starts, then by mean time up")),
    Column("Swing-up", "first, %", "In how many of 2000 resamples of the starts nobody does better."),
    Column("Swing-up", "next is better, %", "In how many of them the next in this ranking does better."),
    Column(
        "Swing-up", "hanging", "Success, %, from hanging, angles moved by up to 0.1 rad, and Wilson's 95 % interval."
    ),
    Column("Swing-up", "side", "The same from level to the side, (π/2, π/2)."),
    Column("Swing-up", "anywhere", "The same from any angles, within half the track, rates N(0, 1)."),
    Column("Swing-up", "up, s", "When both links are up for good: mean over the successes from hanging."),
    Column("Swing-up", "side, s", "The same from the side."),
    Column("Swing-up", "anywhere, s", "The same from anywhere."),
    Column("Swing-up", "robust, %", "As for balancing, from hanging."),
    Column("Swing-up", "variation, 1/s", "Total variation of the force from hanging, over 10 s, with perfect sensors."),
    Column("Swing-up", "effort, N² s", "∫u² dt of the same runs."),
    Column("Swing-up", "step, ms", "As for balancing; LQR's is of balancing."),
    Column("Swing-up", "of 1000, µs", "As for balancing."),
    Column("Swing-up", "starts", "Starts met of each kind."),
)

COST = (
    Column(
        "What it cost", "ready, s",
        "Processor time from nothing to the first force, for what is designed; compiling not counted.",
    ),
    Column("What it cost", "trainings", "How many trainings the next columns are of."),
    Column("What it cost", "training, s", "Processor time of a training: median."),
    Column("What it cost", "learning, s", "Experience while it learned, s of the plant's time: median."),
    Column("What it cost", "tests, s", "Experience of the tests by which a policy was chosen: median."),
    Column(
        "What it cost", "failed, %",
        "Trainings that did not converge, or whose policy succeeds from less than 95 % of fresh starts, and Wilson's "
        "95 % interval; balancing at λ = 0.1, deep learners at λ = 0.3, which is harder.",
    ),
    Column(
        "What it cost", "they save, %",
        "Starts that the policies of new trainings save, mean over λ = 0.1 to 0.6, and their 95 % interval.",
    ),
    Column("What it was told", "model", "Whether it was given the equations and their parameters.", words=True),
    Column("What it was told", "state", "What it sees of the state when it acts.", words=True),
    Column("What it was told", "goal", "What it was to make large or small.", words=True),
    Column("What it was told", "starts to learn from", "Where it could begin while it learned.", words=True),
)  # fmt: skip

COLUMNS = (_NAME, *BALANCE, *SWING_UP, *COST)


def _short(value: float) -> str:
    """Write a number with three digits that count, thousands apart."""
    return f"{float(f'{value:.3g}'):,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def _number(value: float, form: str = "", under: str = "") -> Cell:
    return Cell(format(value, form) if form else _short(value), under, float(value)) if np.isfinite(value) else Cell()


def _percent(share: float, low: float = np.nan, high: float = np.nan) -> Cell:
    """Write a share in per cent; an interval within a tenth of it on both sides says nothing more."""
    interval = (
        f"[{100 * low:.1f}, {100 * high:.1f}]" if np.isfinite(low) and max(high - share, share - low) > 1e-3 else ""
    )
    return Cell(f"{100 * share:.1f}", interval, 100 * share, share)


def _share(successes: npt.NDArray[Any]) -> Cell:
    """Write a share of successes with its interval."""
    return _percent(*wilson(int(successes.sum()), len(successes))) if len(successes) else Cell()


def _mean(values: Array, form: str = "") -> Cell:
    known = values[np.isfinite(values)]
    return _number(float(known.mean()), form) if len(known) else Cell()


def _median(values: Array, form: str = "") -> Cell:
    return _number(float(np.median(values)), form) if len(values) else Cell()


def _crossing(found: Array, lams: npt.ArrayLike) -> Cell:
    level, low, high = crossing(lams, found, 0.9)
    words = [f"{each:.3f}" if np.isfinite(each) else "<" if each < 0 else ">" for each in (level, low, high)]
    edges = {"<": f"< {np.min(lams):g}", ">": f"> {np.max(lams):g}"}
    said = [edges.get(word, word) for word in words]
    return Cell(said[0], f"[{said[1]}, {said[2]}]" if said[1] != said[2] else "", level)


def _standing(ranks: Ranked, name: str) -> list[Cell]:
    """Return rank, share of resamples in which it is first, and in which the next is better."""
    found = ranks.ranking
    i = ranks.names.index(name)
    place = int(np.flatnonzero(found.order == i)[0])
    after = found.order[place + 1] if place + 1 < len(found.order) else None
    interval = f"[{found.low[i]}, {found.high[i]}]"
    return [
        Cell(str(found.rank[i]), interval, float(found.rank[i])),
        _number(100 * found.first[i], ".0f"),
        Cell() if after is None else _number(100 * found.better[after, i], ".0f"),
    ]


def _seconds(found: Found, name: str, task: Task) -> list[Cell]:
    own, lqr, many = (found.of(name, f"{what} {task}, s") for what in ("step", "step of LQR", "step of 1000"))
    if not len(own):
        return [Cell(), Cell()]
    step = float(np.median(own))
    return [_number(1e3 * step, under=f"({_short(step / np.median(lqr))} × LQR)"), _median(1e6 * many)]


def _robust(found: Found, name: str, task: Task) -> Cell:
    values = found.of(name, f"robustness {task}")
    return _percent(*values) if len(values) else Cell()


def _of_balance(found: Found, name: str, ranks: Ranked) -> list[Cell]:
    saved = found.saved(name)
    counted = saved[:, scored(found.lams)].mean(axis=1)
    return [
        *_standing(ranks, name),
        *(_share(saved[:, found.lams.index(lam)]) if lam in found.lams else Cell() for lam in SHOWN),
        _percent(*mean_share(counted, saved[:, scored(found.lams)].size)),
        _crossing(saved, found.lams),
        _robust(found, name, "balance"),
        _mean(found.of(name, "variation balancing, 1/s")),
        _mean(found.of(name, "effort balancing, N² s"), ".0f"),
        *_seconds(found, name, "balance"),
        _number(len(saved), "d"),
    ]


def _of_swing_up(found: Found, name: str, ranks: Ranked) -> list[Cell]:
    times = {start: found.of(name, f"up from {start}, s") for start in STARTS}
    return [
        *_standing(ranks, name),
        *(_share(np.isfinite(times[start])) for start in STARTS),
        *(_mean(times[start], ".2f") for start in STARTS),
        _robust(found, name, "swing-up"),
        _mean(found.of(name, "variation from hanging, 1/s")),
        _mean(found.of(name, "effort from hanging, N² s"), ".0f"),
        *_seconds(found, name, "swing-up"),
        _number(len(times["hanging"]), "d"),
    ]


def _of_cost(found: Found, name: str) -> list[Cell]:
    told = {entrant.name: entrant.told for entrant in ENTRANTS}.get(name, YOURS)
    failed, saves = found.of(name, "failed"), found.of(name, "training saves")
    return [
        _median(found.of(name, "ready, s"), ".2g"),
        _number(len(failed), "d") if len(failed) else Cell(),
        *(_median(found.of(name, f"{what}, s")) for what in ("training", "learning", "tests")),
        replace(_share(failed), share=None),
        _percent(*over_seeds(np.round(1e4 * saves), 10_000)) if len(saves) else Cell(),
        Cell(told.model),
        Cell(told.state),
        Cell(told.reward),
        Cell() if told.starts == "-" else Cell(told.starts),
    ]


def _reference(found: Found) -> list[Cell]:
    """Return what can be saved at all, on 1000 starts of its own."""
    kept = recoverable.shipped()
    saved = np.stack(list(kept.values()), axis=1).astype(np.float64)
    cells = {column.heading: Cell() for column in BALANCE}
    cells |= {f"λ = {lam:g}": _share(kept[lam]) for lam in SHOWN if lam in kept}
    if all(lam in kept for lam in LAMS):
        counted = saved[:, scored(kept)]
        cells["mean"] = _percent(*mean_share(counted.mean(axis=1), counted.size))
    cells |= {"λ90, rad": _crossing(saved, list(kept)), "starts": _number(len(saved), "d")}
    return list(cells.values())


class Board(NamedTuple):
    """The leaderboard: lines of balancing, of swing-up and of costs, each with its columns, and all in one."""

    parts: Mapping[str, tuple[tuple[Column, ...], list[Line]]]
    whole: list[Line]


def board(rows: list[Row]) -> Board:
    """Make the leaderboard out of the table.

    Parameters
    ----------
    rows : list of Row
        The table.

    Returns
    -------
    Board
    """
    found = Found(rows)
    ranks = ranked(found)
    cells: dict[str, dict[str, list[Cell]]] = {"Balance": {}, "Swing-up": {}, "Cost": {}}
    for task, title, of in (("balance", "Balance", _of_balance), ("swing-up", "Swing-up", _of_swing_up)):
        if task in ranks:
            names = [ranks[task].names[i] for i in ranks[task].ranking.order]
            cells[title] = {name: of(found, name, ranks[task]) for name in names}
    if cells["Balance"]:
        cells["Balance"][REFERENCE] = _reference(found)
    cells["Cost"] = {name: _of_cost(found, name) for name in found.names}
    columns = {"Balance": BALANCE, "Swing-up": SWING_UP, "Cost": COST}
    parts: dict[str, tuple[tuple[Column, ...], list[Line]]] = {
        title: ((_NAME, *columns[title]), [[Cell(name), *line] for name, line in lines.items()])
        for title, lines in cells.items()
    }
    order = dict.fromkeys([*cells["Balance"], *cells["Swing-up"], *cells["Cost"]])
    whole: list[Line] = [
        [Cell(name), *(cell for title in cells for cell in cells[title].get(name, [Cell()] * len(columns[title])))]
        for name in order
    ]
    return Board(parts, whole)


_TITLES = {
    "Balance": "Balance, the best first",
    "Swing-up": "Swing-up, the best first",
    "Cost": "What it cost to get, and what it was told",
}

_BEFORE = (
    "Controllers and learners of dpend on the report's cart with a double pendulum (gustafsson2016: 40 N, 2.4 m, "
    "0.02 s), on the same starts. There is one ranking for balancing and one for the swing-up, and none of both. "
    "Intervals are 95 %; those of ranks are over resampled starts, with the policies as they are.",
    "A dash: it does not do this, or it was not measured. Press a heading to sort.",
)


def pages(rows: list[Row], traces: Traces) -> dict[str, str]:
    """Write the leaderboard as Markdown, in three parts, and as one table on a page of its own."""
    found = board(rows)
    parts = [f"## {_TITLES[title]}\n\n{markdown(*part)}\n" for title, part in found.parts.items() if part[1]]
    meanings = "\n".join(
        f"- **{f'{column.group}, ' if column.group else ''}{column.heading}**: {column.meaning}" for column in COLUMNS
    )
    head = "# Leaderboard\n\nWritten by `python -m studies.leaderboard`; how it was done and what to read from it is in"
    about = " `docs/leaderboard.md`. [The same as one table that sorts](leaderboard.html).\n"
    return {
        "leaderboard.md": "\n".join([head + about, *parts, "## What the columns mean", "", meanings, ""]),
        "leaderboard.html": page("Leaderboard", _BEFORE, COLUMNS, found.whole),
    }


_BRIEF = (
    "controller", "rank", *(f"λ = {lam:g}" for lam in SHOWN), "mean", *STARTS, "up, s", "robust, %", "step, ms",
    "ready, s", "trainings", "training, s", "learning, s", "failed, %",
)  # fmt: skip


def summary(rows: list[Row], traces: Traces) -> RenderableType:
    """Condense the table: some columns of the leaderboard, in three parts."""
    tables = []
    for title, (columns, lines) in board(rows).parts.items():
        brief = [i for i, column in enumerate(columns) if column.heading in _BRIEF]
        if lines:
            chosen = [[line[i] for i in brief] for line in lines]
            tables.append(terminal(_TITLES[title], [columns[i] for i in brief], chosen))
    return Group(*tables, "All columns are in leaderboard.md, and in leaderboard.html as one table that sorts.")


# ------------------------------------------------------------------------------------------------------------- figures


def plot(rows: list[Row], traces: Traces) -> Figure:
    """Draw the ranks with their intervals."""
    ranks = ranked(Found(rows))
    lines = [len(each.names) for each in ranks.values()]
    figure = Figure(figsize=(6.3, 1.2 + 0.24 * sum(lines)), layout="constrained")
    axes = np.atleast_1d(figure.subplots(len(ranks), 1, height_ratios=lines, squeeze=False)[:, 0])
    for axis, (task, each) in zip(axes, ranks.items(), strict=True):
        _plot_ranks(axis, task, each)
    return figure


def _plot_ranks(axis: Axes, task: Task, ranks: Ranked) -> None:
    """Draw the ranks of one task, the best on top; on the right, how often each is first."""
    found = ranks.ranking
    names = [ranks.names[i] for i in found.order]
    styles = _entrants.styles(names)
    for place, (i, name) in enumerate(zip(found.order, names, strict=True)):
        colour, marker, _ = styles[name]
        axis.plot([found.low[i], found.high[i]], [place, place], color=colour, lw=2.5, solid_capstyle="butt")
        axis.plot(found.rank[i], place, color=colour, marker=marker, ms=6, mec="k", mew=0.5)
        axis.text(1.02, place, f"{found.first[i]:.0%}", transform=axis.get_yaxis_transform(), va="center", fontsize=8)
    axis.text(1.02, -0.9, "first", transform=axis.get_yaxis_transform(), va="center", fontsize=8)
    axis.set(
        xlim=(0.5, len(names) + 0.5), ylim=(len(names) - 0.4, -0.6), xticks=range(1, len(names) + 1),
        yticks=range(len(names)), yticklabels=names, xlabel=f"rank, {task}, with 95 % interval",
    )  # fmt: skip
    axis.tick_params(labelsize=8)
    axis.grid(alpha=0.3, axis="x")


if __name__ == "__main__":
    _study.main("studies.leaderboard")
