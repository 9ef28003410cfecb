"""How fast does each learner learn, in episodes, in seconds of experience and in seconds of computing?

Method: figures 3 to 5 of the report on gustafsson2016 next to ours, with medians and quartiles over trainings; one that
ended goes on at the mean of its last ten episodes.  Beside them, what the policy of the moment would do without
exploration on 100 fresh starts at λ = 0.1 and 0.3: seconds of experience, acceptance tests included, and of processor
time until a start is first saved, and 95 %.  Deep learners (``--deep``) were evaluated as they trained.

Finding: LSPI saves 95 % of the starts at λ = 0.1 after 98 s of experience (98 to 104), QAC tuned after 380 s (367 to
477), and both keep it, in 10 of 10 trainings; Q-learning tuned keeps it after 6158 s (1301 to 13 650), 8 of 10 lost it
before.  As published neither saves a start: all 30 trainings overflow.  Of 100 619 episodes of linear Q-learning of the
swing-up none succeeds; PPO first sees 95 % of starts swung up after 157 286 s, DDPG after 8400 s (5 of 5 each).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, LogLocator, NullFormatter

import dpend
from dpend.params import Array
from dpend.suggest import suggestion
from rl import GaussianQAC, Learner, LinearQLearning
from rl.deep import read_recipe
from rl.training import task_name

from . import _field, _runner
from ._estimates import QUARTILES, number
from ._field import Contender, Cost, find, styles, styles_of_recipes
from ._figures import Style, band, facets, legend_above, note, share_axis
from ._plant import Plant, rig_of
from ._runner import AtLeastTwo, Positive, Report, Result, Table
from ._tables import Cell, Sheet, Value, sheet
from ._trainings import RUNS, Kept, kept

MINUTES = 1

LAMS = (0.1, 0.3)
MOST = 0.95  # the share of starts that counts as learned
SMALL_STEPS = "QAC published, α = β = 1e-6"  # with it Algorithm 2 lasts about as long as in the report's figure 4

DEEP = {task: [f"{algo}-{task}" for algo in ("ppo", "ddpg", "td3", "sac")] for task in ("balance", "swing-up")}
"""Recipes of deep learners by task."""

_DEEP_LAM = 0.3  # at which trainings of balancing are evaluated
_OUTCOMES = {"converged": "converged", "diverged": "diverged", "budget spent": "not converged"}
_COMPILING, _QUICK = 5.0, 60.0  # s of experience
_POINTS, _GRID = 60, 200
_TAIL = 10  # episodes whose mean goes on after the end


def _only_here(name: str, learner: Callable[[dpend.Rig], Learner], style: Style) -> Contender:
    return Contender(name=name, make=lambda rig, task: learner(rig).train(0).policy, learner=learner, style=style)


def _swing_up(rig: dpend.Rig, alpha: float, like: Callable[[dpend.Rig], LinearQLearning]) -> LinearQLearning:
    task = dpend.SwingUp(start="side")
    return LinearQLearning(rig, task=task, alpha=alpha, scales=like(rig).scales, max_episodes=5000)


ONLY_HERE = (
    _only_here("Q published", LinearQLearning.published, style=("#777777", "v", ":")),
    _only_here("QAC published, α = β = 1e-4", GaussianQAC.published, style=("#000000", "v", ":")),
    _only_here(SMALL_STEPS, lambda rig: GaussianQAC.published(rig, alpha=1e-6, beta=1e-6, max_episodes=60_000),
               style=("#E69F00", "v", "-")),
    _only_here("Q swing-up, α = 1e-4 as for balancing", lambda rig: _swing_up(rig, 1e-4, LinearQLearning.published),
               style=("#777777", "v", ":")),
    _only_here("Q swing-up, α = 1e-6", lambda rig: _swing_up(rig, 1e-6, LinearQLearning.published),
               style=("#0072B2", "v", "-")),
    _only_here("Q swing-up, features scaled as tuned", lambda rig: _swing_up(rig, 1e-4, LinearQLearning.tuned),
               style=("#D55E00", "v", "--")),
)  # fmt: skip
"""The report's learners as published, and linear Q-learning of the swing-up, from the report's start."""


def learners() -> dict[str, Contender]:
    """Return the contenders that are trained here, by name: the field's, and those of this study alone."""
    known = (*ONLY_HERE, *_field.CONTENDERS)
    return {contender.name: contender for contender in known if contender.learner is not None}


@dataclass(frozen=True, kw_only=True)
class Options(_runner.Options):
    """Options of the command line."""

    needs = ("force_limit", "ideal")

    trainings: Positive = 10  # Seeds of each learner that is trained here.
    starts: AtLeastTwo = 100  # Fresh starts of an evaluation at each λ.
    only: tuple[str, ...] = ()  # Names of the learners that take part, or of recipes of deep ones; left out, all.
    deep: Path = RUNS
    """Folder of the deep trainings, such as ppo-swing-up.npz, or ppo-swing-up with a folder for each seed."""

    def __post_init__(self) -> None:
        super().__post_init__()
        names = (*learners(), *DEEP["balance"], *DEEP["swing-up"])
        for name in self.only:
            if name not in names:
                raise ValueError(f"--only {name}: no learner is called so.{suggestion(name, names)}")


@dataclass(frozen=True, kw_only=True)
class Job:
    """One training, to be made here, or kept."""

    learner: str
    training: int  # its number, or the seed of a deep one
    starts: int = 0
    points: int = 0  # at most so many policies on the way
    seconds: float = math.inf  # greatest experience, s; infinite for the learner's own budget
    seed: int = 0
    kept: Kept | None = None
    elsewhere: Plant | None = None


def jobs(options: Options) -> list[Job]:
    """List the work: one job for each learner and training, and one for each deep training that is there."""
    trainings, starts, points = (1, 4, 3) if options.quick else (options.trainings, options.starts, _POINTS)
    seconds, plant = _QUICK if options.quick else math.inf, options.elsewhere

    def asked(name: str) -> bool:
        return not options.only or name in options.only

    work = [
        Job(learner=name, training=k, starts=contender.cost.runs(starts), points=points, seconds=seconds,
            seed=options.seed, elsewhere=plant)
        for name, contender in learners().items()
        if asked(name) and not (options.quick and contender.cost is Cost.EXPENSIVE and name not in options.only)
        for k in range(trainings)
    ]  # fmt: skip
    there = kept(options.deep)
    if plant:
        there = {name: each for name, each in there.items() if read_recipe(Path(each[0].place)).rig == plant.rig}
    few = slice(1 if options.quick else None)
    deep = [
        (name, each) for names in DEEP.values() for name in filter(asked, names) for each in there.get(name, [])[few]
    ]
    return work + [Job(learner=name, training=each.seed, kept=each, elsewhere=plant) for name, each in deep]


def run(job: Job) -> Result:
    """Train and evaluate the policies on the way, or read what a deep training left; a row for each λ.

    Its columns: λ, 0 for the swing-up; how the training ended; learning episodes and those that succeeded, -1 where
    they were not counted; experience (s of the plant's time, tests included) and processor time (s) of the whole, until
    an evaluation first saw a start saved, and until it first saw 95 %; experience until the first evaluation from which
    on all saw 95 %; all NaN for never; and the share of starts that the last policy saves.
    """
    return _read(job.kept) if job.kept else _train(job)


def _train(job: Job) -> Result:
    make = find(job.learner, known=learners().values()).learner
    assert make is not None
    rig = rig_of(job.elsewhere)
    learner = make(rig)
    learner.train(0, seconds=_COMPILING)
    training = learner.train([job.seed, 15, job.training], seconds=None if math.isinf(job.seconds) else job.seconds)
    balancing, curve = task_name(learner) == "balance", training.curve
    lams, task = (LAMS, dpend.Balance()) if balancing else ((0.0,), dpend.SwingUp(steps=round(10 / rig.sample_time)))
    starts, ways = _starts(rig, balancing, job.starts, job.seed), training.snapshots(job.points)
    saved = [dpend.simulate_many(rig, way.policy, starts, task=task).success.reshape(len(lams), -1) for way in ways]
    shares = dict(zip(lams, np.mean(saved, axis=2).T, strict=True))
    experience = np.array([way.experience for way in ways])
    cpu = training.cost.cpu_seconds * experience / max(training.experience, rig.sample_time)
    whole = {
        "outcome": training.outcome.name.lower().replace("_", " "), "episodes": training.cost.episodes,
        "successes": int(curve["success"].sum()) if "success" in curve else -1,
        "experience": training.experience, "cpu": training.cost.cpu_seconds,
    }  # fmt: skip
    lengths = curve.get("length", np.zeros(0)).astype(np.float64)
    values = lengths if balancing else curve.get("reward", np.array(np.nan)) / lengths
    arrays = {
        "curve": thin(values),
        "tail": np.array([values[-_TAIL:].mean() if len(values) else np.nan]),
        "experience": experience,
        **{f"share {lam:g}": share for lam, share in shares.items()},
    }
    return Result([whole | _costs(lam, experience, cpu, each, 1 / job.starts) for lam, each in shares.items()], arrays)


def _starts(rig: dpend.Rig, balancing: bool, n: int, seed: int) -> Array:
    """Return the starts of an evaluation: ``n`` at each λ, or half hanging and half to the side."""
    streams = [np.random.default_rng([seed, 16]) for _ in LAMS]
    if balancing:
        tasks = [dpend.Balance(lam=lam) for lam in LAMS]
        return np.concatenate([task.starts(rng, n, rig) for task, rng in zip(tasks, streams, strict=True)])
    tasks = [dpend.SwingUp(start=start, angle_spread=0.05) for start in ("hanging", "side")]
    return np.concatenate([task.starts(rng, n // 2, rig) for task, rng in zip(tasks, streams, strict=True)])


def _read(kept: Kept) -> Result:
    recipe, training = read_recipe(Path(kept.place)), kept.read()
    experience, cpu, share = (training.curve[name] for name in ("experience", "cpu_seconds", "success"))
    whole = {"outcome": "-", "episodes": -1, "successes": -1, "experience": experience[-1], "cpu": cpu[-1]}
    lam = _DEEP_LAM if recipe.task == "balance" else 0.0
    row = whole | _costs(lam, experience, cpu, share, 1 / recipe.evaluation_starts)
    return Result([row], {"steps": training.curve["steps"], "share": share})


def _costs(lam: float, experience: Array, cpu: Array, shares: Array, one: float) -> dict[str, float]:
    first, most = reached(shares, one), reached(shares, MOST)
    return {
        "lam": lam, "first": _at(experience, first), "first_cpu": _at(cpu, first), "most": _at(experience, most),
        "most_cpu": _at(cpu, most), "kept": _at(experience, kept_from(shares)), "share": float(shares[-1]),
    }  # fmt: skip


def reached(shares: Array, level: float) -> int:
    """Return the evaluation that first saw a share of a level; their number where none did."""
    return int(np.argmax(np.append(shares >= level - 1e-9, True)))


def kept_from(shares: Array) -> int:
    """Return the evaluation from which on all saw ``MOST``; their number where the last did not."""
    below = np.flatnonzero(shares < MOST - 1e-9)
    return int(below[-1]) + 1 if len(below) else 0


def _at(costs: Array, evaluation: int) -> float:
    return float(costs[evaluation]) if evaluation < len(costs) else math.nan


def edges(episodes: int) -> npt.NDArray[np.int64]:
    """Return the episodes, 0 first, between which curves are averaged, the same for all as far as they go.

    Each stretch is a twentieth of what was before, at least 1 and at most 300 long.
    """
    found = [0]
    while found[-1] < episodes:
        found.append(found[-1] + min(max(found[-1] // 20, 1), 300))
    return np.array(found)


def thin(values: Array) -> Array:
    """Return the means of a curve ``(n,)``, one number an episode, between :func:`edges`."""
    return np.array([values[start:end].mean() for start, end in pairwise(edges(len(values)))])


def quartiles(curves: Sequence[Array], tails: Sequence[float]) -> Array:
    """Return quartiles ``(3, m)`` over curves, the longest of m values, of which others go on at their tails."""
    longest = max(map(len, curves))
    held = [np.append(c, np.full(longest - len(c), tail)) for c, tail in zip(curves, tails, strict=True)]
    return np.quantile(held, QUARTILES, axis=0)


def quartiles_between(x: Sequence[Array], y: Sequence[Array], grid: Array) -> Array:
    """Return quartiles on a grid over curves straight between points of their own, and then at their last values."""
    return np.quantile([np.interp(grid, *curve) for curve in zip(x, y, strict=True)], QUARTILES, axis=0)


def report(table: Table) -> Report:
    """Draw figures 3 to 5 of the report beside ours, and success against experience; tabulate what it took."""
    deep = [name for names in DEEP.values() for name in names]
    trained = table.rows[~table.rows["learner"].isin(deep)]
    balancing = styles(trained["learner"][trained["lam"] > 0], learners().values())
    swinging = styles(trained["learner"][trained["lam"] == 0], learners().values())
    there = [name for name in (*balancing, *swinging, *deep) if name in set(table.rows["learner"])]
    titles = {lam: f"Balancing from λ = {lam:g}" for lam in LAMS} | {0.0: "Swing-up"}
    tables = [_endings_table(table, there), *(_costs_table(table, there, *each) for each in titles.items())]
    figures = {"": _balancing(table, balancing), "_swing_up": _swinging(table, swinging)}
    return Report(figures=figures, tables=tables)


def _balancing(table: Table, looks: Mapping[str, Style]) -> Figure:
    figure, axes = facets(4, height=9.6)
    third, fourth, shares, deep = axes[:, 0]
    _episodes(third, table, {name: style for name, style in looks.items() if name != SMALL_STEPS})
    third.set(xscale="log", ylabel="episode length (samples)", ylim=(0, 350))
    third.axhline(dpend.Balance().steps, color="k", lw=0.6, ls=(0, (1, 3)))
    note(third, "report: “relatively quick convergence”, in 70 % of training attempts")
    legend_above(third, 3, "As the report's figure 3: learning to balance")
    _episodes(fourth, table, {name: looks[name] for name in looks if name == SMALL_STEPS})
    fourth.axvspan(30_000, 40_000, color="0.88", lw=0, zorder=0)
    ends = table.where(learner=SMALL_STEPS, lam=LAMS[0], outcome="diverged")["episodes"]
    if len(ends):
        fourth.plot(ends, np.full(len(ends), 4.0), "kx", ms=5, label="a training overflows")
    fourth.set(ylabel="episode length (samples)", xlim=(0, None), ylim=(0, 85))
    note(fourth, "report: “something clearly happened between episode 30000 and 40000” (shaded); no episode succeeded")
    legend_above(fourth, 2, "As the report's figure 4: Gaussian QAC to the letter")
    for name, style in looks.items():
        x, y = (table.arrays(each, learner=name) for each in ("experience", f"share {LAMS[0]:g}"))
        spent = np.concatenate(x)
        if not spent.max(initial=0.0) > 0:
            continue  # it learns in rounds longer than what it was given
        grid = np.geomspace(spent[spent > 0].min(), spent.max(), _GRID)
        band(shares, grid, quartiles_between(x, y, grid), style, name)
    shares.set(xscale="log", xlabel="experience, tests included (s)")
    share_axis(shares, f"starts saved, λ = {LAMS[0]:g}")
    legend_above(shares, 3, "The policies on the way, exploration left out")
    _deep(deep, table, "balance", f"starts saved, λ = {_DEEP_LAM:g}")
    return figure


def _swinging(table: Table, looks: Mapping[str, Style]) -> Figure:
    figure, ((fifth,), (deep,)) = facets(2, height=5.4)
    _episodes(fifth, table, looks)
    low, high = fifth.get_ylim()
    fifth.set(xscale="log", ylabel="average reward (upright: 0)", ylim=(low, high + 0.15 * (high - low)))
    note(fifth, "report: not “a single episode where the control task was even close to being completed”")
    legend_above(fifth, 2, "As the report's figure 5: linear Q-learning of the swing-up")
    for name, style in looks.items():
        if not _counts_reward(table, name):
            steps = [x / table.rig.sample_time for x in table.arrays("experience", learner=name)]
            grid = np.unique(np.concatenate(steps))
            band(deep, grid, quartiles_between(steps, table.arrays("share 0", learner=name), grid), style, name)
    _deep(deep, table, "swing-up", "starts that end upright")
    return figure


def _counts_reward(table: Table, name: str) -> bool:
    return bool(np.isfinite(np.concatenate(table.arrays("tail", learner=name))).all())


def _episodes(axis: Axes, table: Table, looks: Mapping[str, Style]) -> None:
    """Draw curves against episodes, as far as the longest training went, with how trainings ended in the legend."""
    for name, style in looks.items():
        if _counts_reward(table, name):
            tails = [tail.item() for tail in table.arrays("tail", learner=name)]
            middle = quartiles(table.arrays("curve", learner=name), tails)
            counts = table.where(learner=name).drop_duplicates("training")["outcome"].value_counts()
            ended = ", ".join(f"{counts[outcome]} {words}" for outcome, words in _OUTCOMES.items() if outcome in counts)
            band(axis, edges(10**6)[1 : middle.shape[1] + 1], middle, style, f"{name} ({ended})")
    axis.set_xlabel("learning episodes")


def _deep(axis: Axes, table: Table, task: str, words: str) -> None:
    """Draw the evaluations of deep learners against environment steps, and name those that are not there."""
    for name, style in styles_of_recipes(DEEP[task]).items():
        if x := table.arrays("steps", learner=name):
            grid = np.unique(np.concatenate(x))
            curve = quartiles_between(x, table.arrays("share", learner=name), grid)
            band(axis, grid, curve, style, f"{name} ({len(x)} training{'s' * (len(x) > 1)})")
    share_axis(axis, words)
    axis.set_xlabel("environment steps")
    if axis.lines:
        axis.set_xscale("log")
        axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.xaxis.set_major_formatter(EngFormatter(sep=" "))
    if lacking := [name for name in DEEP[task] if name not in set(table.rows["learner"])]:
        note(axis, f"not there: trainings of {', '.join(lacking)}")
    legend_above(axis, 2, f"Evaluations while they train, {task}")


def _endings_table(table: Table, learners: Sequence[str]) -> Sheet:
    lines: list[dict[str, Value]] = []
    for name in learners:
        own = table.where(learner=name).drop_duplicates("training")
        ends, sums = own["outcome"].tolist(), own[["episodes", "successes"]].sum().tolist()
        counts = [ends.count(outcome) if ends[0] != "-" else None for outcome in ("converged", "diverged")]
        counts += [total if total >= 0 else None for total in sums]
        headings = ("converged", "diverged", "episodes", "successful")
        lines.append({"learner": name, "trainings": len(own), **dict(zip(headings, counts, strict=True))})
    lacking = ", ".join(name for names in DEEP.values() for name in names if name not in learners)
    note = f"No trainings there of {lacking}: left out." if lacking else ""
    return sheet("Trainings and their learning episodes", lines, note=note)


def _costs_table(table: Table, learners: Sequence[str], lam: float, title: str) -> Sheet:
    headings = {"first": "first start", "first_cpu": "CPU to it", "most": "95 %", "most_cpu": "CPU to 95 %",
                "kept": "kept"}  # fmt: skip
    lines = [
        {"learner": name} | {heading: typical(own[column].to_numpy()) for column, heading in headings.items()}
        | {"end, %": float(np.median(own["share"]))}
        for name in learners if len(own := table.where(learner=name, lam=lam))
    ]  # fmt: skip
    note = (
        "until an evaluation first sees a start saved, first sees 95 %, and until all that follow do; s; median, range"
    )
    return sheet(f"{title}: experience and processor time to success, s", lines, note=note)


def typical(values: Array) -> Cell:
    """Return the median of costs, in which NaN, never, is more than all others; the range, and how many never did."""
    there = values[np.isfinite(values)]
    never = [f"{len(values) - len(there)} never"] if len(there) < len(values) else []
    if not len(there):
        return Cell("never")
    middle, least, greatest = float(np.median(np.nan_to_num(values, nan=np.inf))), there.min(), there.max()
    under = ([f"{_number(least)} to {_number(greatest)}"] if len(values) > 1 else []) + never
    return Cell(_number(middle), ", ".join(under), key=middle)


def _number(value: float) -> str:
    if value < 0.001:
        return "< 0.001"
    return "never" if math.isinf(value) else number(value, ",.0f" if value >= 100 else "")


if __name__ == "__main__":
    _runner.main("studies.learning_curves")
