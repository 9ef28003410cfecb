"""How fast does each learner learn, in episodes, in seconds of experience and in seconds of computing?

Method: figures 3 to 5 of the report on gustafsson2016, next to ours: length of learning episodes (balancing) and
average reward (swing-up) against episodes, each with its median and quartiles over trainings; one that ended goes on at
the mean of its last ten episodes.  LSPI cuts its episodes after 100 samples or at 0.1 rad, QAC tuned at 0.254 rad.
Beside them, what the policy of the moment would do, exploration left out, on 100 fresh starts at λ = 0.1 and 0.3:
experience, acceptance tests included, and processor seconds until an evaluation first sees a start saved, and 95 %.
Deep learners were evaluated as they trained (``--deep``), balancing at λ = 0.3; those that are not there are named.

Finding: LSPI saves 95 % of the starts at λ = 0.1 after 98 s of experience (98 to 104), QAC tuned after 380 s (367 to
477), and both keep it, in 10 of 10 trainings each; Q-learning tuned keeps it after 6158 s (1301 to 13 650), and 8 of 10
had come to it before and lost it.  As published neither saves a start: all 30 trainings overflow, QAC with α = β = 1e-6
after 25 816 to 52 797 episodes that never grew longer.  Of 100 619 episodes of linear Q-learning of the swing-up none
succeeds; PPO first sees 95 % of starts swung up after 157 286 s (5 of 5 trainings), DDPG after 8400 s (5 of 5).
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, PercentFormatter
from rich.console import Group, RenderableType
from rich.table import Table

import dpend
from dpend.params import Array
from rl import LSPI, GainPolicy, GaussianQAC, LinearQLearning, LinearQPolicy, LSPITraining, QACTraining, Training
from rl.deep import read_curve
from rl.gaussian_qac import TableOneMean

from . import _study
from ._study import Figures, Job, Result, Traces

LAMS = (0.1, 0.3)
MOST = 0.95
"""The share of starts that counts as learned."""

AnyLearner = LinearQLearning | GaussianQAC | LSPI


class Learner(NamedTuple):
    """A learner, and how its curve is drawn."""

    make: Callable[[dpend.Rig], AnyLearner]
    words: str
    colour: str
    line: str


_SWING = dpend.SwingUp(start="side")


def _swing(rig: dpend.Rig, alpha: float = 1e-4, *, scaled: bool = False) -> LinearQLearning:
    scales = LinearQLearning.tuned(rig).scales if scaled else LinearQLearning.published(rig).scales
    return LinearQLearning(rig=rig, task=_SWING, alpha=alpha, scales=scales, max_episodes=5000)


BALANCING = {
    "Q published": Learner(lambda rig: LinearQLearning.published(rig), "Q-learning published", "#777777", ":"),
    "Q tuned": Learner(lambda rig: LinearQLearning.tuned(rig), "Q-learning tuned", "#009E73", "-."),
    "QAC published": Learner(lambda rig: GaussianQAC.published(rig), "QAC published, α = β = 1e-4", "#000000", ":"),
    "QAC small steps": Learner(  # with which Algorithm 2 lasts about as long as in the report's figure 4
        lambda rig: GaussianQAC.published(rig, alpha=1e-6, beta=1e-6, max_episodes=60_000),
        "QAC published, α = β = 1e-6", "#CC79A7", "-",
    ),
    "QAC tuned": Learner(lambda rig: GaussianQAC.tuned(rig), "QAC tuned", "#D55E00", "--"),
    "LSPI": Learner(lambda rig: LSPI(rig), "LSPI", "#0072B2", "-"),
}  # fmt: skip
"""Learners of balancing: the report's two, as published and tuned, and least-squares policy iteration."""

SWINGING = {
    "swing-up, α = 1e-4": Learner(lambda rig: _swing(rig), "Q-learning, α = 1e-4 as for balancing", "#777777", ":"),
    "swing-up, α = 1e-6": Learner(lambda rig: _swing(rig, 1e-6), "Q-learning, α = 1e-6", "#0072B2", "-"),
    "swing-up, scaled": Learner(
        lambda rig: _swing(rig, scaled=True), "Q-learning, features scaled as tuned", "#D55E00", "--"
    ),
}
"""Linear Q-learning of the swing-up, from the report's start."""

_DEEP_STYLES = {
    "ppo": ("PPO", "#0072B2", "-"),
    "ddpg": ("DDPG", "#D55E00", "--"),
    "td3": ("TD3", "#009E73", "-."),
    "sac": ("SAC", "#CC79A7", ":"),
}
DEEP = tuple(f"{algo}-{task}" for task in ("balance", "swing-up") for algo in _DEEP_STYLES)
"""Deep learners by the names of their folders."""

_READ = ("steps", "success", "cpu_seconds")  # of a deep training's evaluations
_DEEP_LAM = 0.3  # the spread at which trainings of balancing are evaluated
_SMALL = "QAC small steps"
_ENDS = {"converged": "converged", "diverged": "diverged", "budget spent": "not converged"}
_BINS, _POINTS = 200, 60
_TAIL = 10  # episodes whose mean goes on after the end


@dataclass(frozen=True, kw_only=True)
class Options(_study.Options):
    """What can be told on the command line."""

    trainings: int = 10
    """Seeds of each learner that is trained here."""
    starts: int = 100
    """Fresh starts of an evaluation at each spread."""
    deep: Path = Path("docs/results/deep")
    """Folder of the deep trainings: of each learner a folder, such as ppo-swing-up, with a folder for each seed."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_least(1, "trainings")
        self.check_least(2, "starts")


@dataclass(frozen=True, kw_only=True)
class Row:
    """One training, judged on starts of one spread."""

    learner: str
    training: int
    """Number of the training, or the seed of a deep one."""
    lam: float
    """Spread of the starts; 0 for the swing-up, which starts hanging and level to the side, within 0.05 rad."""
    outcome: str
    """How the training ended; a dash for deep ones."""
    episodes: int
    """Learning episodes; -1 where they were not counted."""
    successes: int
    """Learning episodes that lasted to the task's end, or were up for a second; -1 where that cannot be."""
    experience: float
    """Of the whole training, acceptance tests included, s of the plant's time."""
    cpu: float
    """Processor time of the whole training, s."""
    first: float
    """Experience until an evaluation first saw a start saved, s; not a number where none did."""
    first_cpu: float
    """Processor time until then, s: its share of the whole by samples, or for deep ones as measured."""
    most: float
    """Experience until an evaluation first saw 95 % of the starts saved, s."""
    most_cpu: float
    kept: float
    """Experience until the first evaluation from which on all saw 95 % saved, s."""
    share: float
    """Share of the starts that the last policy saves."""


def deep_trainings(folder: Path) -> dict[str, list[Path]]:
    """Return the folders of the deep trainings that are there.

    Parameters
    ----------
    folder : Path
        Where they are kept.

    Returns
    -------
    dict
        By each name of ``DEEP``, one folder a seed; none where it is missing.
    """
    return {
        name: sorted(
            (file.parent for file in folder.glob(f"{name}/seed-*/curve.csv") if (file.parent / "recipe.json").exists()),
            key=_seed,
        )
        for name in DEEP
    }


def _seed(folder: Path) -> int:
    return int(folder.name.removeprefix("seed-"))


def jobs(options: Options) -> list[Job]:
    """List the work: one job a learner and training."""
    trainings = 1 if options.quick else options.trainings
    work = [Job(name, k) for name in (*BALANCING, *SWINGING) for k in range(trainings)]
    for name, folders in deep_trainings(options.deep).items():
        for folder in folders[: 1 if options.quick else None]:
            told = hashlib.sha256((folder / "curve.csv").read_bytes() + (folder / "recipe.json").read_bytes())
            work.append(Job(f"{name}@{told.hexdigest()[:8]}", _seed(folder)))  # another curve is another job
    return work


def run(job: Job, options: Options) -> Result:
    """Train and evaluate the policies on the way, or read what a deep training wrote."""
    name = job.setting.partition("@")[0]
    if name in DEEP:
        return _read(name, options.deep / name / f"seed-{job.repetition}")
    rig = dpend.rig("gustafsson2016")
    learner = (BALANCING | SWINGING)[name].make(rig)
    small(learner).train(0)  # compiles
    if options.quick:
        learner = small(learner)
    began = time.process_time()
    training = learner.train([options.seed, 15, job.repetition])
    cpu = time.process_time() - began
    samples, policies = snapshots(training, 3 if options.quick else _POINTS)
    n, lams = (4 if options.quick else options.starts), LAMS if name in BALANCING else (0.0,)
    starts = _starts(rig, name in BALANCING, n, options.seed)
    task = dpend.Balance() if name in BALANCING else dpend.SwingUp(steps=500)
    shares = np.array(
        [
            dpend.simulate_many(rig, policy, starts, task=task).success.reshape(len(lams), -1).mean(axis=1)
            for policy in policies
        ]
    ).reshape(-1, len(lams))
    experience = samples * rig.sample_time
    whole = (training.steps + training.test_steps) * rig.sample_time
    rows = [
        Row(
            learner=name,
            training=job.repetition,
            lam=lam,
            outcome=training.outcome.name.lower().replace("_", " "),
            episodes=training.episodes,
            successes=_succeeded(training),
            experience=whole,
            cpu=cpu,
            first=first,
            first_cpu=cpu * first / whole if whole else np.nan,
            most=most,
            most_cpu=cpu * most / whole if whole else np.nan,
            kept=kept(experience, share),
            share=float(share[-1]) if len(share) else 0.0,
        )
        for lam, share in zip(lams, shares.T, strict=True)
        for first, most in [(reached(experience, share, 1 / n), reached(experience, share, MOST))]
    ]
    values = training.lengths.astype(np.float64)
    if isinstance(training, LSPITraining):
        values = values[:-1]  # the last was under way
    if isinstance(training, Training) and name in SWINGING:
        values = training.rewards / training.lengths
    edges = _edges(learner, linear=name == _SMALL)
    traces = {
        "episodes": edges[1:],
        "curve": thin(values, edges),
        "tail": np.array([values[-_TAIL:].mean() if len(values) else np.nan]),
        "experience": experience,
        **{f"share {lam:g}": share for lam, share in zip(lams, shares.T, strict=True)},
    }
    return Result(rows, traces)


def small(learner: AnyLearner) -> AnyLearner:
    """Return the same learner with a budget of moments, for compiling and for ``--quick``."""
    if isinstance(learner, LSPI):
        return replace(learner, iterations=2)
    if isinstance(learner, GaussianQAC):
        return replace(learner, max_episodes=8)
    return replace(learner, max_episodes=20, acceptance=(), restart_after=None)


def _starts(rig: dpend.Rig, balancing: bool, n: int, seed: int) -> Array:
    """Return the starts of an evaluation: ``n`` at each spread, or half hanging and half to the side."""
    streams = [np.random.default_rng([seed, 16]) for _ in LAMS]
    if balancing:
        tasks = [dpend.Balance(lam=lam) for lam in LAMS]
        return np.concatenate([task.starts(rng, n, rig) for task, rng in zip(tasks, streams, strict=True)])
    tasks = [dpend.SwingUp(start=start, angle_spread=0.05) for start in ("hanging", "side")]
    return np.concatenate([task.starts(rng, n // 2, rig) for task, rng in zip(tasks, streams, strict=True)])


def _succeeded(training: Training | QACTraining | LSPITraining) -> int:
    if isinstance(training, LSPITraining):
        return -1
    if isinstance(training, QACTraining):
        return int(training.succeeded.sum())
    if "SwingUp" in training.policy.about["learner"]:
        return int((training.upright >= round(_SWING.hold / dpend.rig("gustafsson2016").sample_time)).sum())
    return int((training.lengths == dpend.Balance().steps).sum())


def snapshots(
    training: Training | QACTraining | LSPITraining, points: int
) -> tuple[Array, list[LinearQPolicy | GainPolicy | TableOneMean]]:
    """Return policies on the way of a training, without their exploration.

    Parameters
    ----------
    training : Training, QACTraining or LSPITraining
        What a learner gave.
    points : int
        At most so many, spread geometrically over its episodes or updates, the first and the last among them.

    Returns
    -------
    samples : ndarray (m,)
        Experience up to each, acceptance tests included.
    policies : list of m
        The policies.
    """
    policy = training.policy
    if isinstance(training, LSPITraining):
        chosen = _spread(len(training.gains), points)
        return training.samples[chosen].astype(np.float64), [GainPolicy(training.gains[k]) for k in chosen]
    spent = np.cumsum(training.lengths + (training.tested if isinstance(training, Training) else 0)).astype(np.float64)
    if isinstance(training, QACTraining) and len(training.gains):
        chosen = _spread(len(training.gains), points)
        after = np.minimum(training.updated[chosen], training.episodes) - 1
        return spent[after], [GainPolicy(training.gains[k]) for k in chosen]
    chosen = _spread(training.episodes, points)
    weights = training.weights[chosen]
    if isinstance(policy, LinearQPolicy):
        return spent[chosen], [LinearQPolicy(w, policy.scales, policy.forces) for w in weights]
    assert isinstance(policy, TableOneMean)
    return spent[chosen], [TableOneMean(v, policy.indicators) for v in weights]


def _spread(n: int, points: int) -> np.ndarray:
    """Return at most ``points`` of the first ``n`` whole numbers, geometrically spread."""
    return np.unique(np.geomspace(1, n, min(points, n)).round().astype(int)) - 1 if n else np.zeros(0, dtype=int)


def _edges(learner: AnyLearner, *, linear: bool) -> Array:
    """Return the episodes between which a curve is averaged, as far as the learner's budget goes."""
    budget = learner.iterations * learner.samples // 10 if isinstance(learner, LSPI) else learner.max_episodes
    space = np.linspace if linear else np.geomspace
    return np.append(0, np.unique(space(1, budget, _BINS).round())).astype(np.float64)


def thin(values: Array, edges: Array) -> Array:
    """Average a curve between edges; not a number from where it ended.

    Parameters
    ----------
    values : ndarray (n,)
        One number an episode.
    edges : ndarray (m + 1,)
        Episodes, growing, the first of them zero.

    Returns
    -------
    ndarray (m,)
    """
    sums = np.append(0.0, np.cumsum(values, dtype=np.float64))
    reach = np.minimum(edges, len(values)).astype(int)
    counts = np.diff(reach)
    return np.where(counts > 0, np.diff(sums[reach]) / np.maximum(counts, 1), np.nan)


def reached(costs: Array, shares: Array, level: float) -> float:
    """Return the cost at which a share first comes to a level; not a number where it never does.

    Parameters
    ----------
    costs, shares : ndarray (m,)
        What was spent until each evaluation, and what it saw.
    level : float
        The share wanted.
    """
    there = np.flatnonzero(shares >= level - 1e-9)
    return float(costs[there[0]]) if len(there) else np.nan


def kept(costs: Array, shares: Array) -> float:
    """Return the cost of the first evaluation from which on all saw ``MOST``; not a number where the last did not.

    Parameters
    ----------
    costs, shares : ndarray (m,)
        What was spent until each evaluation, and what it saw.
    """
    below = np.flatnonzero(shares < MOST - 1e-9)
    first = below[-1] + 1 if len(below) else 0
    return float(costs[first]) if first < len(costs) else np.nan


def _read(learner: str, folder: Path) -> Result:
    """Read a deep training's evaluation curve."""
    seen = read_curve(folder / "curve.csv")
    steps, success, cpu = (np.array([float(getattr(each, name)) for each in seen]) for name in _READ)
    recipe = json.loads((folder / "recipe.json").read_text(encoding="utf-8"))["recipe"]
    experience = steps * recipe["period"]
    one = 1 / recipe["evaluation_starts"]
    row = Row(
        learner=learner,
        training=_seed(folder),
        lam=_DEEP_LAM if recipe["task"] == "balance" else 0.0,
        outcome="-",
        episodes=-1,
        successes=-1,
        experience=float(experience[-1]),
        cpu=float(cpu[-1]),
        first=reached(experience, success, one),
        first_cpu=reached(cpu, success, one),
        most=reached(experience, success, MOST),
        most_cpu=reached(cpu, success, MOST),
        kept=kept(experience, success),
        share=float(success[-1]),
    )
    return Result([row], {"steps": steps, "share": success})


def quartiles(curves: Sequence[Array], tails: Sequence[float]) -> Array:
    """Return quartiles ``(3, m)`` over curves of which some end before others.

    Parameters
    ----------
    curves : sequence of ndarray (m,)
        Not a number from where one ended.
    tails : sequence of float
        The value at which each goes on.
    """
    stacked = np.array(curves)
    held = np.where(np.isnan(stacked), np.array(tails)[:, None], stacked)
    return np.quantile(held, (0.25, 0.5, 0.75), axis=0)


def quartiles_between(x: Sequence[Array], y: Sequence[Array], grid: Array) -> Array:
    """Return quartiles ``(3, m)`` on a grid over curves that have points of their own.

    Each is straight between its points, and goes on at its last value.

    Parameters
    ----------
    x, y : sequence of ndarray
        The points of each, x growing.
    grid : ndarray (m,)
        Where quartiles are wanted.
    """
    return np.quantile([np.interp(grid, *curve) for curve in zip(x, y, strict=True)], (0.25, 0.5, 0.75), axis=0)


def _traces(traces: Traces, name: str) -> list[dict[str, Array]]:
    """Return the traces of all trainings of a learner."""
    start = _study.slug(Job(f"{name}@")).removesuffix("-0") if name in DEEP else _study.slug(Job(name))[:-1]
    return [trace for job, trace in traces.items() if job.startswith(start)]


def _band(axis: Axes, x: Array, quantiles: Array, style: tuple[str, str, str]) -> None:
    words, colour, line = style
    low, middle, high = quantiles
    axis.plot(x, middle, color=colour, ls=line, lw=1.5, label=words)
    axis.fill_between(x, low, high, color=colour, alpha=0.2, lw=0)


def _outcomes(learner: Learner, rows: list[Row], name: str) -> tuple[str, str, str]:
    """Return the style of a learner's curve, with how its trainings ended in the words."""
    own = list({row.training: row.outcome for row in rows if row.learner == name}.values())
    counts = {words: own.count(outcome) for outcome, words in _ENDS.items() if outcome in own}
    return f"{learner.words} ({_told(counts)})", learner.colour, learner.line


def _told(counts: dict[str, int]) -> str:
    return ", ".join(f"{count} {words}" for words, count in counts.items())


def _quote(axis: Axes, words: str) -> None:
    axis.text(
        0.008, 0.965, words, transform=axis.transAxes, fontsize=7, va="top", style="italic",
        bbox={"facecolor": "white", "alpha": 0.8, "lw": 0, "pad": 1.0},
    )  # fmt: skip


def _finish(axis: Axes, title: str, columns: int) -> None:
    """Put the title and the legend above the axes, where they hide no curve."""
    axis.tick_params(labelsize=8)
    axis.grid(alpha=0.3)
    axis.xaxis.label.set_fontsize(9)
    axis.yaxis.label.set_fontsize(9)
    handles, labels = axis.get_legend_handles_labels()
    legend = axis.legend(
        handles,
        labels,
        title=title, loc="lower left", bbox_to_anchor=(-0.01, 1.0), ncols=columns, frameon=False,
        fontsize=7.5, title_fontsize=9, alignment="left", borderaxespad=0.1, handlelength=3,
    )  # fmt: skip
    legend.get_title().set_fontweight("bold")


def plot(rows: list[Row], traces: Traces) -> Figures:
    """Draw figures 3 and 4 of the report and success against experience; and figure 5 with the deep learners'."""
    balance = Figure(figsize=(6.3, 9.6), layout="constrained")
    third, fourth, shares, deep = balance.subplots(4, 1)
    _episodes(third, rows, traces, {name: BALANCING[name] for name in BALANCING if name != _SMALL})
    third.set(xscale="log", ylabel="episode length (samples)", ylim=(0, 350))
    third.axhline(dpend.Balance().steps, color="k", lw=0.6, ls=(0, (1, 3)))
    _quote(third, "report: “relatively quick convergence”, in 70 % of training attempts")
    _finish(third, "As the report's figure 3: learning to balance", 2)
    _episodes(fourth, rows, traces, {_SMALL: BALANCING[_SMALL]})
    fourth.axvspan(30_000, 40_000, color="0.88", lw=0, zorder=0)
    ends = [row.episodes for row in rows if (row.learner, row.lam, row.outcome) == (_SMALL, LAMS[0], "diverged")]
    if ends:
        fourth.plot(ends, np.full(len(ends), 4.0), "kx", ms=5, label="a training overflows")
    fourth.set(ylabel="episode length (samples)", xlim=(0, None), ylim=(0, 85))
    _quote(
        fourth, "report: “something clearly happened between episode 30000 and 40000” (shaded); no episode succeeded"
    )
    _finish(fourth, "As the report's figure 4: Gaussian QAC to the letter", 2)
    for name, learner in BALANCING.items():
        own = [trace for trace in _traces(traces, name) if len(trace["experience"])]
        if own:
            x, y = [trace["experience"] for trace in own], [trace[f"share {LAMS[0]:g}"] for trace in own]
            grid = np.geomspace(min(each[0] for each in x), max(each[-1] for each in x), _BINS)
            _band(shares, grid, quartiles_between(x, y, grid), (learner.words, learner.colour, learner.line))
    shares.set(xscale="log", xlabel="experience, tests included (s)", ylabel=f"starts saved, λ = {LAMS[0]:g}")
    _finish(shares, "The policies on the way, exploration left out", 3)
    _deep(deep, rows, traces, "balance", f"starts saved, λ = {_DEEP_LAM:g}")
    swing = Figure(figsize=(6.3, 5.4), layout="constrained")
    fifth, deep_swing = swing.subplots(2, 1)
    _episodes(fifth, rows, traces, SWINGING)
    low, high = fifth.get_ylim()
    fifth.set(xscale="log", ylabel="average reward (upright: 0)", ylim=(low, high + 0.15 * (high - low)))
    _quote(
        fifth,
        "report: not “a single episode where the control task was even close to being completed”",
    )
    _finish(fifth, "As the report's figure 5: linear Q-learning of the swing-up", 1)
    _deep(deep_swing, rows, traces, "swing-up", "starts that end upright")
    for axis in (shares, deep, deep_swing):
        axis.set_ylim(-0.03, 1.03)
        axis.yaxis.set_major_formatter(PercentFormatter(1.0))
    return {"": balance, "_swing_up": swing}


def _episodes(axis: Axes, rows: list[Row], traces: Traces, learners: dict[str, Learner]) -> None:
    """Draw curves against episodes, as far as the longest training went."""
    for name, learner in learners.items():
        own = [trace for trace in _traces(traces, name) if np.isfinite(trace["tail"]).all()]
        if own:
            curves = [trace["curve"] for trace in own]
            until = max(int(np.isfinite(curve).sum()) for curve in curves)
            band = quartiles(curves, [float(trace["tail"][0]) for trace in own])[:, :until]
            _band(axis, own[0]["episodes"][:until], band, _outcomes(learner, rows, name))
    axis.set_xlabel("learning episodes")


def _deep(axis: Axes, rows: list[Row], traces: Traces, task: str, words: str) -> None:
    for algo, (title, colour, line) in _DEEP_STYLES.items():
        own = _traces(traces, f"{algo}-{task}")
        if own:
            grid = np.unique(np.concatenate([trace["steps"] for trace in own]))
            band = quartiles_between([trace["steps"] for trace in own], [trace["share"] for trace in own], grid)
            _band(axis, grid, band, (f"{title} ({len(own)} training{'s' * (len(own) > 1)})", colour, line))
    axis.set(xlabel="environment steps", ylabel=words)
    if axis.lines:
        axis.set_xscale("log")
        axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.xaxis.set_major_formatter(FuncFormatter(lambda steps, _: f"{steps:,.0f}"))
    else:
        axis.set_xticks([])
    lacking = [_DEEP_STYLES[name.partition("-")[0]][0] for name in missing(rows) if name.endswith(task)]
    if lacking:
        _quote(axis, f"not there: trainings of {', '.join(lacking)}")
    _finish(axis, f"Deep learners, {task}: evaluations while they train", 2)


def missing(rows: list[Row]) -> list[str]:
    """Name the deep learners of which no training was there."""
    found = {row.learner for row in rows}
    return [name for name in DEEP if name not in found]


def typical(values: Sequence[float]) -> str:
    """Tell the median of costs, the least and the greatest of those that got there, and how many never did.

    Parameters
    ----------
    values : sequence of float
        One a training; not a number for never.  For the median these count as more than all others.
    """
    there = [value for value in values if np.isfinite(value)]
    never = len(values) - len(there)
    if not there:
        return f"{never} never"
    middle = float(np.median(np.where(np.isnan(values), np.inf, values)))
    told = f"{_short(middle)}\n{_short(min(there))}\n{_short(max(there))}"
    return f"{told}\n{never} never" if never else told


def _short(value: float) -> str:
    if not np.isfinite(value):
        return "never"
    if value < 0.001:
        return "<.001"
    return f"{value:,.0f}" if value >= 100 else f"{value:.2g}"


def summary(rows: list[Row], traces: Traces) -> RenderableType:
    """Condense the table: how trainings ended, and what it takes until a start is saved, and 95 % of them."""
    ends = Table(title="Trainings and their learning episodes")
    for heading in ("learner", "trainings", "converged", "diverged", "episodes", "of them successful"):
        ends.add_column(heading, justify="left" if heading == "learner" else "right")
    for name in (*BALANCING, *SWINGING, *DEEP):
        own = list({row.training: row for row in rows if row.learner == name}.values())
        if own:
            outcomes = [row.outcome for row in own]
            ends.add_row(
                name,
                str(len(own)),
                *("-" if outcomes[0] == "-" else str(outcomes.count(outcome)) for outcome in ("converged", "diverged")),
                "-" if own[0].episodes < 0 else f"{sum(row.episodes for row in own):,}",
                "-" if own[0].successes < 0 else f"{sum(row.successes for row in own):,}",
            )
    tables: list[RenderableType] = [ends]
    places = [(lam, f"Balancing from λ = {lam:g}") for lam in LAMS] + [(0.0, "Swing-up")]
    for lam, title in places:
        table = Table(title=f"{title}: experience and CPU time until then, s; median, least, greatest")
        for heading in ("learner", "first", "CPU", f"{MOST:.0%}", "CPU", f"{MOST:.0%} kept", "end, %"):
            table.add_column(heading, justify="left" if heading == "learner" else "right")
        for name in (*BALANCING, *SWINGING, *DEEP):
            own = [row for row in rows if (row.learner, row.lam) == (name, lam)]
            if own:
                costs = ("first", "first_cpu", "most", "most_cpu", "kept")
                table.add_row(
                    name,
                    *(typical([getattr(row, cost) for row in own]) for cost in costs),
                    f"{100 * np.median([row.share for row in own]):.0f}",
                )
        tables.append(table)
    lacking = missing(rows)
    if lacking:
        tables.append(f"No trainings there of {', '.join(lacking)}: left out.")
    return Group(*tables)


if __name__ == "__main__":
    _study.main("studies.learning_curves")
