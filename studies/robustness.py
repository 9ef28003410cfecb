"""Which controllers still balance, and still swing up, when the rig is not what was promised?

Method: gustafsson2016 (±40 N, ±2.4 m, 0.02 s) is changed behind the back of controllers that believe in it, 10 s a
run: balance from λ = 0.1, swing-up from hanging.  (a) RealAIGym's six axes: one parameter of twelve wrong by up to a
quarter, noise of rates and of the force, a slow force, late measurements, pushes; the score is the mean success over
the axes.  (b) All parameters wrong by up to 20 % at once.  (c) Real sensors, through first differences or an estimator.

Finding: one wrong parameter and noise of the force hurt hardly any that balances.  With two samples of delay nearly all
fail but LQR, LSPI and SDRE; with pushes of a fifth of RealAIGym's largest nearly all fail.  Scores at balancing:
LSPI 86.7, LQR 84.8, SDRE 84.0, iLQR MPC 76.9, Q-learning tuned 73.0, PPO and DDPG trained to swing up 66.2 and 58.6 %;
at swinging up: iLQR MPC 77.4, TVLQR 65.1 %; wrong by 20 % in everything 55 [50, 60] and 10 [7, 14] %.
Behind EKF or UKF, LQR and TVLQR bear three samples of delay always; through differences LQR one, TVLQR none.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from textwrap import fill
from typing import get_args

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, PercentFormatter

from dpend.params import Array

from . import _field, _perturbations, _runner
from ._estimates import Estimate, crossing, mean_share, share, worst_cases
from ._field import Contender, Cost, TaskName, designed_and_learned, find, longest_first, made, styles
from ._figures import (
    MOST,
    Curve,
    Style,
    curves,
    facets,
    forest,
    heat_map,
    intervals,
    legend_above,
    parts,
    share_axis,
)
from ._own import Own
from ._perturbations import (
    AXES,
    GROUPS,
    NOMINAL,
    PARAMETERS,
    SENSORS,
    VIEWS,
    Axis,
    axes_of,
    of_groups,
    realaigym,
    sensors_of,
    views,
)
from ._plant import Plant, rig_of
from ._runner import AtLeastTwo, Report, Result, Table, where
from ._tables import Cell, Sheet, cell, sheet

MINUTES = 8

TASKS: tuple[TaskName, ...] = get_args(TaskName)
_STARTS_A_PLANT = 4


@dataclass(frozen=True, kw_only=True)
class Options(_field.Options):
    """Options of the command line."""

    starts: AtLeastTwo = 100
    """Starts of each setting of the six axes, and a tenth of them of each setting of the sensors."""
    slow_starts: AtLeastTwo = 5  # Starts of NMPC, and of a controller of your own that treats one run at a time.
    plants: int = 256
    """Plants that are wrong in everything at once, a power of two; an eighth of them for what has slow starts."""
    all: bool = False  # Evaluate NMPC too, which takes hours.

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.plants < 16 or self.plants & (self.plants - 1):
            raise ValueError(f"--plants must be a power of two, at least 16; got {self.plants}.")

    def contenders(self, task: TaskName) -> list[Contender]:
        """Return those that do a task and are not too slow; where it must be quick, two of ours and the user's own."""
        kept = (*self.only, "LQR", "TVLQR")
        quick = [each for each in super().contenders(task) if not self.quick or each.own or each.name in kept]
        return [each for each in quick if each.cost is not Cost.EXPENSIVE or self.all or each.name in self.only]

    def starts_of(self, contender: Contender) -> int:
        """Return the starts of a contender in each setting."""
        cheap = contender.cost is Cost.CHEAP
        return 2 if self.quick else self.starts if cheap else min(self.starts, self.slow_starts)

    def plants_of(self, contender: Contender) -> int:
        """Return the plants of a contender."""
        return 16 if self.quick else self.plants if contender.cost is Cost.CHEAP else self.plants // 8


@dataclass(frozen=True, kw_only=True)
class Job:
    """One contender at one task along one axis, or on all plants."""

    contender: str
    task: TaskName
    part: str  # axes, plants or sensors.
    axis: str = "-"
    view: str = "-"  # What stands between sensors and controller; a dash where the state is measured.
    starts: int  # At each level, or on each plant.
    plants: int = 0
    seed: int
    own: Own | None
    elsewhere: Plant | None = None


def jobs(options: Options) -> list[Job]:
    """List the work, what takes longest first."""
    found, viewed = [], [(axis.name, view) for axis in SENSORS for view in views(axis)]
    for task in TASKS:
        for contender in options.contenders(task):
            starts = options.starts_of(contender)
            job = partial(Job, contender=contender.name, task=task, seed=options.seed, own=contender.own,
                          elsewhere=options.elsewhere)  # fmt: skip
            found += [job(part="axes", axis=axis.name, starts=starts) for axis in (NOMINAL, *AXES)]
            found += [job(part="plants", starts=_STARTS_A_PLANT, plants=options.plants_of(contender))]
            if contender.cost is Cost.CHEAP or contender.own or options.all:
                few = -(-starts // 10) if contender.cost is Cost.CHEAP else starts
                found += [job(part="sensors", axis=axis, view=view, starts=few) for axis, view in viewed]
    order = {each.name: k for k, each in enumerate(longest_first(options.known))}
    return sorted(found, key=lambda job: order.get(job.contender, 0))


def run(job: Job) -> Result:
    """Evaluate; a row a level or plant, and which starts succeeded at each, ``(starts, levels)``."""
    rig = rig_of(job.elsewhere)
    task = _perturbations.task_of(job.task, rig=rig)
    controller = made(find(job.contender, job.own), job.elsewhere, task)
    if job.part == "plants":
        levels: Sequence[float] = range(job.plants)
        outcomes = _perturbations.evaluate_on_plants(controller, task, job.plants, job.starts, job.seed, rig).T
    elif job.part == "axes":
        axis = next(axis for axis in (NOMINAL, *axes_of(rig)) if axis.name == job.axis)
        levels, outcomes = axis.levels, _perturbations.evaluate(controller, task, axis, job.starts, job.seed, rig)
    else:
        axis = next(axis for axis in sensors_of(rig) if axis.name == job.axis)
        levels = axis.levels
        outcomes = _perturbations.evaluate_with_sensors(controller, task, axis, job.view, job.starts, job.seed, rig)
    rows = [
        {"level": float(f"{level:.6g}"), "runs": len(of), "successes": int(of.sum())}
        for level, of in zip(levels, outcomes.T, strict=True)
    ]
    return Result(rows, {"outcomes": outcomes.astype(np.bool_)})


def outcomes_of(table: Table, contender: str, task: TaskName) -> dict[str, Array]:
    """Return a contender's outcomes ``(starts, levels)`` by name of the axis; a KeyError if the table has none."""
    own = {"contender": contender, "task": task, "part": "axes"}
    axes = table.where(**own)["axis"].unique()
    if not len(axes):
        raise KeyError(f"The table says nothing of {contender!r} at the task {task!r}.")
    return {axis: table.array("outcomes", **own, axis=axis).astype(np.float64) for axis in axes}


def score(table: Table, contender: str, task: TaskName) -> Estimate:
    """Return the robustness score, see :func:`studies._perturbations.score`; a KeyError if the table has none."""
    return _perturbations.score(outcomes_of(table, contender, task))


def breaking(outcomes: Mapping[str, Array], axis: Axis, sign: int = 1) -> Estimate:
    """Return the level, without its sign, at which success falls to 50 % on one side of nominal; infinite if it stays.

    It is minus infinite where half of the nominal runs fail already.
    """
    levels = sign * np.array(axis.levels)
    side = [i for i in np.argsort(levels) if levels[i] > 0]
    found = np.concatenate([outcomes[NOMINAL.name], outcomes[axis.name][:, side]], axis=1)
    return crossing([0.0, *levels[side]], found)


def weakest(outcomes: Mapping[str, Array]) -> tuple[str, int, Estimate]:
    """Return the parameter, the sign and the size of the least error of one parameter that halves success."""
    sides = [(axis, sign) for axis in AXES if axis.name in PARAMETERS for sign in (-1, 1)]
    found = {(axis.name, sign): breaking(outcomes, axis, sign) for axis, sign in sides}
    name, sign = min(found, key=lambda at: (found[at].value, outcomes[at[0]][:, 0 if at[1] < 0 else -1].mean()))
    return name, sign, found[name, sign]


def on_plants(table: Table, contender: str, task: TaskName) -> tuple[Array, Estimate, Estimate]:
    """Return the shares of success, plant by plant, their mean, and that of the worst tenth."""
    outcomes = table.array("outcomes", contender=contender, task=task, part="plants")
    shares = outcomes.mean(axis=0)
    return shares, mean_share(shares, outcomes.size), worst_cases(shares)


_VIEW_STYLES: Mapping[str, Style] = dict(zip(VIEWS, (
    ("#000000", "X", ":"), ("#D55E00", "s", "--"), ("#CC79A7", "v", "-."), ("#0072B2", "o", "-"),
    ("#009E73", "^", (0, (6, 1, 1, 1))),
), strict=True))  # fmt: skip
_TITLES = {"balance": "balance", "swing-up": "swing-up from hanging"}


def _present(table: Table, task: TaskName, part: str = "axes") -> dict[str, Style]:
    """Return those that took part, in the order in which they are always named, and how each is drawn."""
    return styles(table.where(task=task, part=part)["contender"])


def _each(table: Table, part: str = "axes") -> Iterator[tuple[str, TaskName]]:
    """Return those that took part, task by task."""
    return ((name, task) for task in TASKS for name in _present(table, task, part))


def report(table: Table) -> Report:
    """Draw the overview, single parameters, success against level for both tasks, plants and sensors; tabulate them."""
    tasks: list[TaskName] = [task for task in TASKS if _present(table, task)]
    figures = {"": _heat_maps(table, _overview), "_parameters": _heat_maps(table, _least)}
    for axis in figures[""].axes:
        for line in (0.5, len(GROUPS) + 0.5, len(GROUPS) + 1.5):  # between the nominal rig, the axes, and their sums
            axis.axvline(line, color="w", lw=3)
    figures |= {f"_{task.replace('-', '_')}": _plot_axes(table, task) for task in tasks}
    figures["_plants"] = _plot_plants(table, tasks)
    if "sensors" in set(table.rows["part"]):
        figures["_sensors"] = _plot_sensors(table)
    tables = (_scores(table), _breaks(table), _plants(table), _sensors(table))
    return Report(figures=figures, tables=tables)


def _heat_maps(table: Table, line: Callable[[Table, str, TaskName], Mapping[str, Estimate]]) -> Figure:
    """Draw shares as numbers on colours: a panel a task, a row a contender."""
    values = {task: {name: line(table, name, task) for name in of} for task in TASKS if (of := _present(table, task))}
    sizes = [*map(len, values.values())]
    height = 1.3 + 0.24 * sum(sizes) + 0.35 * len(sizes)
    figure, axes = facets(len(sizes), height=height, sharex=True, height_ratios=sizes)
    for axis, (task, of) in zip(axes[:, 0], values.items(), strict=True):
        columns = [column.replace("_", " ") for column in next(iter(of.values()))]
        heat_map(axis, np.array([[each.value for each in row.values()] for row in of.values()]), list(of), columns)
        axis.set_title(_TITLES[task])
    return figure


def _by_axis(outcomes: Mapping[str, Array]) -> dict[str, Estimate]:
    """Return success on the nominal rig and along each of the six axes, and the mean over these."""
    shares = {"nominal": outcomes[NOMINAL.name], **of_groups(outcomes)}
    return {group: Estimate(of.mean()) for group, of in shares.items()} | {"score": _perturbations.score(outcomes)}


def _overview(table: Table, name: str, task: TaskName) -> dict[str, Estimate]:
    """Return success on the nominal rig, along each axis, and on plants wrong in everything."""
    _, mean, tail = on_plants(table, name, task)
    return _by_axis(outcomes_of(table, name, task)) | {"all wrong, mean": mean, "all wrong, worst tenth": tail}


def _least(table: Table, name: str, task: TaskName) -> dict[str, Estimate]:
    """Return the least success over the errors of each single parameter."""
    outcomes = outcomes_of(table, name, task)
    return {axis.name: Estimate(outcomes[axis.name].mean(axis=0).min()) for axis in AXES if axis.group == "model"}


def _shares(table: Table, axes: Sequence[str], **fields: str) -> Curve:
    """Return success by level, along one axis or along several together."""
    rows = table.where(**fields).query("axis in @axes")
    at = {level: where(rows, level=level) for level in sorted(set(rows["level"]))}
    return {level: share(of["successes"], of["runs"]) for level, of in at.items()}


def _plot_axes(table: Table, task: TaskName) -> Figure:
    """Draw success against level: a row an axis, designed controllers on the left, learned ones on the right."""
    looks = _present(table, task)
    sides = [part for side in designed_and_learned(looks) for part in parts(side)]
    figure, axes = facets(len(GROUPS), len(sides), height=9.2 if len(sides) < 3 else 10.4, sharey=True, sharex="row")
    words = {axis.group: axis.words for axis in axes_of(table.rig)} | {"model": "error of one parameter, eight pooled"}
    for group, row in zip(GROUPS, axes, strict=True):
        of_group = (NOMINAL.name, *(PARAMETERS if group == "model" else (group,)))
        for side, axis in zip(sides, row, strict=True):
            drawn = {name: _shares(table, of_group, contender=name, task=task, part="axes") for name in side}
            curves(axis, drawn, looks, aside=0.0)
            share_axis(axis)
            axis.set(xlabel=fill(words[group], 23 if len(sides) > 2 else 60), yticks=(0, 0.5, 1))
        if group == "model":
            row[0].xaxis.set_major_formatter(PercentFormatter(1.0))
        if group == "pulses":
            row[0].set_xscale("symlog", linthresh=0.02, linscale=0.4)
            row[0].set(xlim=(-0.003, 1.15), xticks=(0, 0.05, 0.2, 1))
            row[0].xaxis.set_major_formatter(FuncFormatter(lambda level, _: f"{level:g}"))
            row[0].minorticks_off()
        if group == "delay":
            row[0].set_xticks((0, 1, 2))
    for axis in axes[0]:
        legend_above(axis, 1 if len(sides) > 2 else 2 if len(sides) > 1 else 4)
    figure.supylabel("runs that succeed", fontsize=8.5)
    return figure


def _plot_plants(table: Table, tasks: Sequence[TaskName]) -> Figure:
    """Draw plants in the order of success, for six contenders from best to worst; and everyone's mean and worst."""
    looks = {task: _present(table, task, "plants") for task in tasks}
    heights = [max(len(of), 6) + 3 for of in looks.values()]
    figure, axes = facets(len(tasks), 2, height=1.0 + 0.19 * sum(heights), height_ratios=heights)
    for (left, right), task in zip(axes, tasks, strict=True):
        found = {name: on_plants(table, name, task) for name in looks[task]}
        ranked = sorted(found, key=lambda name: -found[name][1].value)
        for place in sorted({round(each) for each in np.linspace(0, len(ranked) - 1, MOST)}):
            name = ranked[place]
            shares = found[name][0]
            places = (np.arange(len(shares)) + 0.5) / len(shares)
            colour, _, line = looks[task][name]
            left.plot(places, np.sort(shares), color=colour, ls=line, ds="steps", label=name)
        forest(right, {name: mean for name, (_, mean, _) in found.items()}, looks[task], aside=-0.16)
        forest(right, {name: tail for name, (_, _, tail) in found.items()}, looks[task], aside=0.16, hollow=True)
        right.plot([shares.min() for shares, _, _ in found.values()], range(len(found)), "k|", ms=9)
        legend_above(left, 2, _TITLES[task])
        share_axis(left, "starts that succeed")
        left.set_yticks((0, 0.5, 1))
        for axis in (left, right):
            share_axis(axis, along="x")
    axes[-1, 0].set_xlabel("plants, the worst first")
    axes[-1, 1].set_xlabel("mean (filled), worst tenth (open), worst (|)")
    return figure


def _plot_sensors(table: Table) -> Figure:
    """Draw success against what is wrong with the sensors, for the first contender of each kind: a column an axis.

    The levels of noise and of encoders stand side by side.
    """
    shown = [(part[0], task) for task in TASKS for part in designed_and_learned(_present(table, task, "sensors"))]
    sensors = sensors_of(table.rig)
    noise, encoders, *_ = sensors
    named = {noise: [f"{each:g}" for each in noise.levels], encoders: [f"{1 / each:.0f}" for each in encoders.levels]}
    rows = len(shown)
    figure, axes = facets(rows, len(sensors), height=0.9 + 1.45 * rows, sharey=True, sharex="col")
    for (name, task), row in zip(shown, axes, strict=True):
        for of, axis in zip(sensors, row, strict=True):
            for view in views(of):
                curve = _shares(table, (of.name,), contender=name, task=task, part="sensors", view=view)
                aside = 0.05 * (list(VIEWS).index(view) - 2) * (0.2 if of.name == "lag" else 1)
                places = np.arange(len(curve)) if of in named else np.array(list(curve))
                intervals(axis, places + aside, curve.values(), _VIEW_STYLES[view], label=view)
            if of in named:
                axis.set_xticks(range(len(of.levels)), named[of], rotation=45)
            share_axis(axis)
            axis.set_yticks((0, 0.5, 1))
        row[0].set_ylabel(f"{name},\n{task}")
    for of, axis in zip(sensors, axes[-1], strict=True):
        axis.set_xlabel(of.words.replace(" (", "\n("))
    legend_above(figure, len(VIEWS))
    return figure


def _scores(table: Table) -> Sheet:
    lines = []
    for name, task in _each(table):
        outcomes = outcomes_of(table, name, task)
        one = {"controller": name, "task": task, "runs": sum(of.size for of in outcomes.values())}
        lines.append({**one, **_by_axis(outcomes), "RealAIGym's way": cell(realaigym(outcomes), ".3f")})
    title = "(a) Success, %, on each of the six axes, nominal left out; score: their mean"
    return sheet(title, lines, ".1%", brief=("controller", "task", "nominal", "score", "RealAIGym's way"))


def _level(found: Estimate, form: str, most: float, before: str = "") -> Cell:
    """Return where success halves: beyond the greatest level where it never does; a dash where it is below already."""
    if found.value == -math.inf:
        return Cell()
    within = cell(Estimate(*np.maximum(found, 0.0).tolist()), form, tried=(0.0, float(f"{most:.2g}")))
    return Cell(within.text if math.isinf(found.value) else before + within.text, within.under, within.key)


def _breaks(table: Table) -> Sheet:
    lines, others = [], [axis for axis in axes_of(table.rig) if axis.group != "model"]
    for name, task in _each(table):
        outcomes = outcomes_of(table, name, task)
        parameter, sign, least = weakest(outcomes)
        before = f"{parameter.replace('_', ' ')} {'−' if sign < 0 else '+'}"
        one = {"controller": name, "task": task, "one parameter, % wrong": _level(least, ".0%", 0.25, before)}
        lines.append(one | {axis.name: _level(breaking(outcomes, axis), ".2g", axis.levels[-1]) for axis in others})
    return sheet("(a) Level at which success falls to 50 %; a dash where it is below that already", lines)


def _plants(table: Table) -> Sheet:
    lines = []
    for name, task in _each(table, "plants"):
        shares, mean, tail = on_plants(table, name, task)
        own = {"mean": mean, "worst tenth (CVaR)": tail, "worst plant": float(shares.min())}
        lines.append({"controller": name, "task": task, "plants": len(shares), **own})
    return sheet("(b) Success, %, on plants wrong in everything at once", lines, ".1%")


def _sensors(table: Table) -> Sheet:
    lines = []
    for (name, task), axis in product(_each(table, "sensors"), SENSORS):
        own = {"contender": name, "task": task, "part": "sensors", "axis": axis.name}
        found = {view: table.array("outcomes", **own, view=view) for view in views(axis)}
        shares = {view: mean_share(of.mean(axis=1), of.size) for view, of in found.items()}
        lines.append({"controller": name, "task": task, "axis": axis.name, **dict.fromkeys(VIEWS), **shares})
    title = "(c) Success, %, the mean over the levels of an axis, by what stands between sensors and controller"
    return sheet(title, lines, ".1%", brief=("controller", "task", "axis", "rates measured", "differences", "EKF"))


if __name__ == "__main__":
    _runner.main("studies.robustness")
