"""Who still balances, and who still swings up, when the rig is not what was promised?

Method: gustafsson2016 (±40 N, ±2.4 m, 0.02 s) is changed behind the back of controllers that believe in it, 10 s a
run: balance from λ = 0.1, swing-up from hanging with both angles moved by ±0.1 rad.  (a) RealAIGym's six axes: one
parameter of twelve wrong by up to 25 %, noise of the rates, noise of the force, a slow force, measurements late by 20
and 40 ms, pushes.  (b) All parameters wrong by up to 20 % at once, on the plants of a scrambled Sobol sequence.
(c) Sensors that give positions only, noisy, rounded or late, and a slow force, through first differences or an
estimator.  Everyone meets the same starts, noise, pushes and plants; those that take long meet the first of them, NMPC
none unless asked for.  The robustness score is the success in the settings of (a), the nominal one left out, the mean
over its six axes.

Finding: one wrong parameter and noise of the force hurt hardly anyone who balances.  Two samples of delay fell nearly
all but the linear laws and SDRE; pushes of a fifth of RealAIGym's largest fell nearly everyone.
Scores at balancing: LSPI 86.7, LQR 84.8, iLQR MPC 76 [72, 80], Q-learning tuned 72.9, PPO and DDPG trained to swing up
66.2 and 58.6 %.  At swinging up: iLQR MPC 83 [71, 96], TVLQR 65.1 %; wrong by 20 % in everything 56 [39, 72] and
10 [7, 14] %.  Behind EKF or UKF, LQR and TVLQR bear three samples of delay always; through differences LQR bears one,
TVLQR none.  From the default options, kept in docs/results/robustness.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, get_args

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, PercentFormatter
from rich.console import Group, RenderableType

from dpend.params import Array

from . import _entrants, _study
from ._entrants import ENTRANTS, RIG, Entrant, Style, Task, styles
from ._intervals import Crossing, Rate, Tail, crossing, wilson, worst_cases
from ._page import Cell, Column, markdown, terminal
from ._perturbations import (
    AXES,
    GROUPS,
    NOMINAL,
    PARAMETERS,
    SENSORS,
    VIEWS,
    Axis,
    mean_share,
    meet,
    meet_plants,
    meet_sensors,
    of_groups,
    realaigym,
    task_of,
    views,
)
from ._perturbations import score as score_of
from ._study import Job, Result, Traces

TASKS: tuple[Task, ...] = get_args(Task)


@dataclass(frozen=True, kw_only=True)
class Options(_entrants.Options):
    """What can be told on the command line."""

    starts: int = 100
    """Starts of each setting of the six axes, and a tenth of them of each setting of the sensors."""
    slow_starts: int = 5
    """Starts for those that take long."""
    plants: int = 256
    """Plants that are wrong in everything at once, a power of two; an eighth of them for those that take long."""
    all: bool = False
    """Let those that take long meet the sensors too, and NMPC, which takes hours, everything."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_least(2, "starts", "slow_starts")
        if self.plants < 16 or self.plants & (self.plants - 1):
            raise ValueError(f"--plants must be a power of two, at least 16; got {self.plants}.")

    def taking_part(self, task: Task) -> list[Entrant]:
        """Return those that do a task and are not too slow; where it must be quick, two of ours and the user's own."""
        return [
            entrant
            for entrant in self.entrants(task)
            if (entrant.part >= 0.1 or self.all or entrant.name in self.only)
            and (not self.quick or entrant.source or entrant.name in (*self.only, "LQR", "TVLQR"))
        ]

    def starts_of(self, entrant: Entrant) -> int:
        """Return the starts that somebody meets in each setting."""
        return 2 if self.quick else self.starts if _fast(entrant) else min(self.starts, self.slow_starts)

    def plants_of(self, entrant: Entrant) -> int:
        """Return the plants that somebody meets."""
        return 16 if self.quick else self.plants if _fast(entrant) else self.plants // 8


_STARTS_A_PLANT = 4


def _fast(entrant: Entrant) -> bool:
    return entrant.part >= 1.0


@dataclass(frozen=True, kw_only=True)
class Row:
    """One controller in one setting."""

    controller: str
    task: str
    part: str
    """axes, plants or sensors."""
    axis: str
    view: str
    """What stands between sensors and controller; a dash where the state is measured."""
    level: float
    """Level of the axis, or number of the plant."""
    runs: int
    successes: int
    outcomes: str
    """An x and hexadecimal digits whose bits, the first start first, say which starts succeeded."""


def _packed(outcomes: Array) -> str:
    """Write outcomes, one a start, as an x and hexadecimal digits."""
    return f"x{np.packbits(outcomes.astype(bool)).tobytes().hex()}"


def _unpacked(row: Row) -> Array:
    bits = np.frombuffer(bytes.fromhex(row.outcomes[1:]), dtype=np.uint8)
    return np.unpackbits(bits, count=row.runs).astype(np.float64)


class Case(NamedTuple):
    """What a job is about."""

    controller: str
    task: Task
    part: str
    axis: str = "-"
    view: str = "-"

    @property
    def setting(self) -> str:
        """One string for all."""
        return " + ".join(self)


def cases(options: Options) -> Iterator[tuple[Case, Entrant]]:
    """List what is tried."""
    for task in TASKS:
        for entrant in options.taking_part(task):
            for axis in (NOMINAL, *AXES):
                yield Case(entrant.name, task, "axes", axis.name), entrant
            yield Case(entrant.name, task, "plants"), entrant
            if _fast(entrant) or entrant.source or options.all:
                for axis in SENSORS:
                    for view in views(axis):
                        yield Case(entrant.name, task, "sensors", axis.name, view), entrant


def jobs(options: Options) -> list[Job]:
    """List the work: each controller on each axis, on all plants, and on each sensor axis through each view."""
    return [Job(case.setting, 0, entrant.source) for case, entrant in cases(options)]


def run(job: Job, options: Options) -> Result:
    """Let one controller meet one axis, or the plants."""
    name, task, *rest = job.setting.split(" + ")
    assert task in TASKS
    case = Case(name, task, *rest)
    entrant = options.entrant(name)
    what = task_of(task, 2.0) if options.quick else task_of(task)
    controller = entrant.make(RIG, what)
    starts = options.starts_of(entrant)
    if case.part == "plants":
        met = meet_plants(controller, what, options.plants_of(entrant), _STARTS_A_PLANT, options.seed)
        return Result(_rows(case, range(len(met)), met))
    (axis,) = (each for each in (SENSORS if case.part == "sensors" else (NOMINAL, *AXES)) if each.name == case.axis)
    if case.part == "axes":
        met = meet(controller, what, axis, starts, options.seed)
    else:
        starts = -(-starts // 10) if _fast(entrant) else starts
        met = meet_sensors(controller, what, axis, case.view, starts, options.seed)
    return Result(_rows(case, axis.levels, met.T))


def _rows(case: Case, levels: Sequence[float], outcomes: Array) -> list[Row]:
    """Return a row a level; outcomes ``(levels, starts)``."""
    return [
        Row(
            **case._asdict(),
            level=float(f"{level:.6g}"),
            runs=len(met),
            successes=int(met.sum()),
            outcomes=_packed(met),
        )
        for level, met in zip(levels, outcomes, strict=True)
    ]


# ------------------------------------------------------------------------------------------------- what the table says


def _chosen(rows: list[Row], **wanted: str) -> list[Row]:
    return [row for row in rows if all(getattr(row, name) == value for name, value in wanted.items())]


def outcomes_of(rows: list[Row], controller: str, task: Task) -> dict[str, Array]:
    """Return the outcomes ``(starts, levels)`` of a controller by the name of the axis.

    Parameters
    ----------
    rows : list of Row
        The table.
    controller : str
        Its name.
    task : {"balance", "swing-up"}
        The task.

    Returns
    -------
    dict

    Raises
    ------
    KeyError
        If the table has nothing of it.
    """
    own: dict[str, list[Row]] = {}
    for row in _chosen(rows, controller=controller, task=task, part="axes"):
        own.setdefault(row.axis, []).append(row)
    if not own:
        raise KeyError(f"The table says nothing of {controller!r} at the task {task!r}.")
    return {
        name: np.stack([_unpacked(row) for row in sorted(of, key=lambda row: row.level)], axis=1)
        for name, of in own.items()
    }


def score(rows: list[Row], controller: str, task: Task) -> Rate:
    """Return the robustness score: success in perturbed settings, the mean over RealAIGym's six axes.

    Parameters
    ----------
    rows : list of Row
        The table.
    controller : str
        Its name.
    task : {"balance", "swing-up"}
        The task.

    Returns
    -------
    Rate
        The nominal level is not counted; 95 % over starts.

    Raises
    ------
    KeyError
        If the table has nothing of it.
    """
    return score_of(outcomes_of(rows, controller, task))


def rate(rows: list[Row]) -> Rate:
    """Return the share of runs that succeeded, with Wilson's interval."""
    return wilson(sum(row.successes for row in rows), sum(row.runs for row in rows))


def breaking(outcomes: dict[str, Array], axis: Axis, sign: int = 1) -> Crossing:
    """Return the level of an axis at which success falls to 50 %, to either side of nominal.

    Parameters
    ----------
    outcomes : dict
        Outcomes ``(starts, levels)`` by the name of the axis.
    axis : Axis
        The axis.
    sign : {1, -1}
        To which side.

    Returns
    -------
    Crossing
        The magnitude; infinite where success stays, minus infinite where half of the nominal runs fail already.
    """
    levels = sign * np.array(sorted(axis.levels))
    side = np.flatnonzero(levels > 0)
    side = side[np.argsort(levels[side])]
    met = np.concatenate([outcomes[NOMINAL.name], outcomes[axis.name][:, side]], axis=1)
    return crossing(np.concatenate([[0.0], levels[side]]), met)


def weakest(outcomes: dict[str, Array]) -> tuple[str, int, Crossing]:
    """Return the parameter, the sign and the size of the least error of one parameter that halves success."""
    sides = [(axis, sign) for axis in AXES if axis.name in PARAMETERS for sign in (-1, 1)]
    least, axis, sign = min(
        ((breaking(outcomes, axis, sign), axis, sign) for axis, sign in sides),
        key=lambda found: (found[0].level, outcomes[found[1].name][:, 0 if found[2] < 0 else -1].mean()),
    )
    return axis.name, sign, least


def on_plants(rows: list[Row], controller: str, task: Task) -> tuple[Rate, Tail]:
    """Return the mean success over plants, and the worst tenth of them with the worst of all."""
    own = _chosen(rows, controller=controller, task=task, part="plants")
    shares = [row.successes / row.runs for row in own]
    return mean_share(shares, sum(row.runs for row in own)), worst_cases(shares, 0.1)


# ------------------------------------------------------------------------------------------------------------- figures


_LEARNED = {entrant.name for entrant in ENTRANTS if entrant.policy}
_VIEW_STYLES = {
    "rates measured": ("#000000", "X", ":"),
    "differences": ("#D55E00", "s", "--"),
    "differences, Predictor": ("#CC79A7", "v", "-."),
    "EKF": ("#0072B2", "o", "-"),
    "UKF": ("#009E73", "^", (0, (6, 1, 1, 1))),
}


def _present(rows: list[Row], task: Task, part: str = "axes") -> dict[str, Style]:
    """Return who took part, in the order in which they are always named, and how each is drawn."""
    return styles(row.controller for row in _chosen(rows, task=task, part=part))


def plot(rows: list[Row], traces: Traces) -> dict[str, Figure]:
    """Draw the overview, success against level for both tasks, single parameters, plants, and sensors."""
    tasks: list[Task] = [task for task in TASKS if _present(rows, task)]
    curves = {f"_{task.replace('-', '_')}": _plot_axes(rows, task) for task in tasks}
    figures = {"": _plot_overview(rows, tasks), "_parameters": _plot_parameters(rows, tasks), **curves}
    figures["_plants"] = _plot_plants(rows, tasks)
    if any(row.part == "sensors" for row in rows):
        figures["_sensors"] = _plot_sensors(rows)
    return figures


def _heat_maps(
    tasks: list[Task],
    names: dict[Task, list[str]],
    columns: list[str],
    values: dict[Task, Array],
    lines: Sequence[float],
) -> Figure:
    """Draw shares as numbers on colours: a panel a task, a row a controller."""
    heights = [len(names[task]) for task in tasks]
    figure = Figure(figsize=(7.0, 1.3 + 0.24 * sum(heights) + 0.35 * len(tasks)), layout="constrained")
    axes = np.atleast_1d(figure.subplots(len(tasks), 1, sharex=True, height_ratios=heights))
    for axis, task in zip(axes, tasks, strict=True):
        axis.imshow(values[task], vmin=0, vmax=1, cmap="cividis", aspect="auto")
        for (i, j), value in np.ndenumerate(values[task]):
            if np.isfinite(value):
                colour = "k" if value > 0.45 else "w"
                axis.text(j, i, f"{100 * value:.0f}", ha="center", va="center", fontsize=7.5, color=colour)
        for line in lines:
            axis.axvline(line, color="w", lw=3)
        axis.set_yticks(range(len(names[task])), names[task], fontsize=8)
        axis.set_title({"balance": "balance", "swing-up": "swing-up from hanging"}[task], fontsize=9, loc="left")
        axis.tick_params(length=0)
    axes[-1].set_xticks(range(len(columns)), columns, fontsize=8, rotation=35, ha="right", rotation_mode="anchor")
    return figure


def _plot_overview(rows: list[Row], tasks: list[Task]) -> Figure:
    """Draw who succeeds on the nominal rig, along each axis, and on plants wrong in everything, %."""
    names: dict[Task, list[str]] = {task: list(_present(rows, task)) for task in tasks}
    columns = ["nominal", *GROUPS, "score", "all wrong, mean", "all wrong, worst tenth"]
    values: dict[Task, Array] = {}
    for task in tasks:
        lines = []
        for name in names[task]:
            outcomes = outcomes_of(rows, name, task)
            mean, tail = on_plants(rows, name, task)
            shares = [of.mean() for of in of_groups(outcomes).values()]
            lines.append([outcomes[NOMINAL.name].mean(), *shares, np.mean(shares), mean.share, tail.cvar])
        values[task] = np.array(lines)
    return _heat_maps(tasks, names, columns, values, (0.5, len(GROUPS) + 0.5, len(GROUPS) + 1.5))


def _plot_parameters(rows: list[Row], tasks: list[Task]) -> Figure:
    """Draw the least success over the errors of each single parameter, %."""
    names: dict[Task, list[str]] = {task: list(_present(rows, task)) for task in tasks}
    single = [axis.name for axis in AXES if axis.group == "model"]
    values: dict[Task, Array] = {}
    for task in tasks:
        met = [outcomes_of(rows, name, task) for name in names[task]]
        values[task] = np.array([[outcomes[name].mean(axis=0).min() for name in single] for outcomes in met])
    return _heat_maps(tasks, names, [name.replace("_", " ") for name in single], values, ())


def _curves(rows: list[Row], name: str, task: Task, group: str) -> tuple[Array, list[Rate]]:
    """Return levels and success of a controller along one of the six axes; errors are pooled over parameters."""
    own = _chosen(rows, controller=name, task=task, part="axes")
    of = [row for row in own if row.axis in (PARAMETERS if group == "model" else (group,))]
    at: dict[float, list[Row]] = {0.0: [row for row in own if row.axis == NOMINAL.name]}
    for row in of:
        at.setdefault(row.level, []).append(row)
    levels = sorted(at)
    return np.array(levels), [rate(at[level]) for level in levels]


def _draw(axis: Axes, levels: Array, rates: list[Rate], style: Style, label: str) -> None:
    colour, marker, line = style
    error = np.array([[of.share - of.low, of.high - of.share] for of in rates]).T
    _, _, bars = axis.errorbar(
        levels, [of.share for of in rates], error,
        color=colour, marker=marker, ls=line, ms=3.5, lw=1.1, elinewidth=0.7, label=label,
    )  # fmt: skip
    for bar in bars:
        bar.set_alpha(0.45)


def _shares_up(axis: Axes) -> None:
    axis.yaxis.set_major_formatter(PercentFormatter(1.0))
    axis.set(ylim=(-0.04, 1.04), yticks=(0, 0.5, 1))
    axis.tick_params(labelsize=7)
    axis.grid(alpha=0.3)


def _plot_axes(rows: list[Row], task: Task) -> Figure:
    """Draw success against level: a row an axis, designed controllers on the left, learned ones on the right."""
    names = _present(rows, task)
    sides = [[name for name in names if name not in _LEARNED], [name for name in names if name in _LEARNED]]
    sides = [side for side in sides if side]
    figure = Figure(figsize=(7.0, 9.2), layout="constrained")
    axes = figure.subplots(len(GROUPS), len(sides), sharey=True, sharex="row", squeeze=False)
    words = {axis.group: axis.words for axis in AXES} | {"model": "error of one parameter, eight pooled"}
    for group, row_of_axes in zip(GROUPS, axes, strict=True):
        for side, axis in zip(sides, row_of_axes, strict=True):
            for name in side:
                _draw(axis, *_curves(rows, name, task, group), names[name], name)
            axis.set_xlabel(words[group], fontsize=8)
            _shares_up(axis)
        if group == "model":
            row_of_axes[0].xaxis.set_major_formatter(PercentFormatter(1.0))
        if group == "pulses":
            row_of_axes[0].set_xscale("symlog", linthresh=0.02, linscale=0.4)
            row_of_axes[0].set_xlim(-0.003, 1.15)
            row_of_axes[0].set_xticks((0, 0.02, 0.05, 0.1, 0.2, 0.5, 1))
            row_of_axes[0].xaxis.set_major_formatter(FuncFormatter(lambda level, _: f"{level:g}"))
            row_of_axes[0].minorticks_off()
        if group == "delay":
            row_of_axes[0].set_xticks((0, 1, 2))
    for axis in axes[0]:
        columns = 2 if len(sides) > 1 else 4
        axis.legend(fontsize=7, ncols=columns, loc="lower center", bbox_to_anchor=(0.5, 1.02), frameon=False)
    figure.supylabel("runs that succeed", fontsize=9)
    return figure


def _plot_plants(rows: list[Row], tasks: list[Task]) -> Figure:
    """Draw plants in the order of success on them; and the mean, the worst tenth and the worst."""
    heights = [len(_present(rows, task, "plants")) + 3 for task in tasks]
    figure = Figure(figsize=(7.0, 1.0 + 0.19 * sum(heights)), layout="constrained")
    axes = figure.subplots(len(tasks), 2, width_ratios=(1.0, 1.0), height_ratios=heights, squeeze=False)
    for (left, right), task in zip(axes, tasks, strict=True):
        names = _present(rows, task, "plants")
        for place, name in enumerate(names):
            colour, marker, line = names[name]
            own = _chosen(rows, controller=name, task=task, part="plants")
            shares = np.sort([row.successes / row.runs for row in own])
            left.plot((np.arange(len(shares)) + 0.5) / len(shares), shares, color=colour, ls=line, lw=1.2, ds="steps")
            mean, tail = on_plants(rows, name, task)
            for value, filled in ((mean, True), (Rate(*tail[:3]), False)):
                right.errorbar(
                    value.share, place + (0.16 if not filled else -0.16),
                    xerr=[[value.share - value.low], [value.high - value.share]],
                    color=colour, marker=marker, ms=5, lw=1, mfc=colour if filled else "w",
                )  # fmt: skip
            right.plot(tail.worst, place, "k|", ms=9)
        left.set_ylabel("starts that succeed", fontsize=8)
        left.set_title(task, fontsize=9, loc="left")
        _shares_up(left)
        left.xaxis.set_major_formatter(PercentFormatter(1.0))
        right.set_yticks(range(len(names)), names, fontsize=7)
        right.set(xlim=(-0.04, 1.04), ylim=(len(names) - 0.4, -0.6))
        right.xaxis.set_major_formatter(PercentFormatter(1.0))
        right.tick_params(labelsize=7)
        right.grid(alpha=0.3)
    axes[-1, 0].set_xlabel("plants, the worst first", fontsize=8)
    axes[-1, 1].set_xlabel("mean (filled), worst tenth (open), worst (|)", fontsize=8)
    return figure


def _plot_sensors(rows: list[Row]) -> Figure:
    """Draw success against what is wrong with the sensors, for the first controllers of each kind: a column an axis."""
    shown = []
    for task in TASKS:
        names = list(_present(rows, task, "sensors"))
        kinds = [[name for name in names if (name in _LEARNED) == learned] for learned in (False, True)]
        shown += [(kind[0], task) for kind in kinds if kind]
    figure = Figure(figsize=(7.0, 0.9 + 1.45 * len(shown)), layout="constrained")
    axes = figure.subplots(len(shown), len(SENSORS), sharey=True, sharex="col", squeeze=False)
    for (name, task), row_of_axes in zip(shown, axes, strict=True):
        for of, axis in zip(SENSORS, row_of_axes, strict=True):
            for view in views(of):
                own = _chosen(rows, controller=name, task=task, part="sensors", axis=of.name, view=view)
                own.sort(key=lambda row: row.level)
                aside = 0.05 * (list(VIEWS).index(view) - 2) * (0.2 if of.name == "lag" else 1)
                places = aside + (
                    np.arange(len(own), dtype=np.float64)
                    if of.name in ("noise", "encoders")
                    else np.array([row.level for row in own])
                )
                _draw(axis, places, [rate([row]) for row in own], _VIEW_STYLES[view], view)
            if of.name in ("noise", "encoders"):
                said = [f"{level:g}" if of.name == "noise" else f"{1 / level:.0f}" for level in of.levels]
                axis.set_xticks(range(len(said)), said, rotation=45)
            _shares_up(axis)
        row_of_axes[0].set_ylabel(f"{name},\n{task}", fontsize=8)
    for of, axis in zip(SENSORS, axes[-1], strict=True):
        axis.set_xlabel(of.words.replace(" (", "\n("), fontsize=8)
    delay = axes[0][[of.name for of in SENSORS].index("delay")]
    figure.legend(*delay.get_legend_handles_labels(), loc="outside upper center", ncols=5, fontsize=8, frameon=False)
    return figure


# -------------------------------------------------------------------------------------------------------------- tables


class Sheet(NamedTuple):
    """One table."""

    title: str
    columns: list[Column]
    lines: list[list[Cell]]


def summary(rows: list[Row], traces: Traces) -> RenderableType:
    """Condense the table: scores, break points, plants, sensors."""
    return Group(*(terminal(*sheet) for sheet in sheets(rows)))


def pages(rows: list[Row], traces: Traces) -> dict[str, str]:
    """Write the tables as Markdown."""
    tables = [f"## {title}\n\n{markdown(columns, lines)}\n" for title, columns, lines in sheets(rows)]
    return {"tables.md": "\n".join(["# Robustness: all tables\n", *tables])}


def sheets(rows: list[Row]) -> list[Sheet]:
    """Return the tables that have something in them."""
    return [sheet for sheet in (_scores(rows), _breaks(rows), _plants(rows), _sensors(rows)) if sheet.lines]


def _columns(words: Sequence[str], numbers: Sequence[str]) -> list[Column]:
    return [Column("", heading, "", words=True) for heading in words] + [Column("", heading, "") for heading in numbers]


def _percent(of: Rate | Tail) -> Cell:
    share, low, high = (100 * value for value in of[:3])
    return Cell(f"{share:.1f}", f"[{low:.1f}, {high:.1f}]")


def _scores(rows: list[Row]) -> Sheet:
    lines = []
    for task in TASKS:
        for name in _present(rows, task):
            outcomes = outcomes_of(rows, name, task)
            runs = sum(of.size for of in outcomes.values())
            shares = [outcomes[NOMINAL.name], *of_groups(outcomes).values()]
            cells = [Cell(name), Cell(task), Cell(str(runs)), *(Cell(f"{100 * of.mean():.1f}") for of in shares)]
            lines.append([*cells, _percent(score_of(outcomes)), Cell(f"{realaigym(outcomes):.3f}")])
    return Sheet(
        "(a) Success, %, on each of the six axes, nominal left out; score: their mean",
        _columns(("controller", "task"), ("runs", "nominal", *GROUPS, "score", "RealAIGym's way")),
        lines,
    )


def _level(found: Crossing, most: float, form: str, before: str = "") -> Cell:
    """Say where success halves: beyond the greatest level where it never does."""

    def bound(value: float) -> str:
        return f"above {most:{form}}" if value == np.inf else "0" if value == -np.inf else f"{value:{form}}"

    if not np.isfinite(found.level):
        return Cell(bound(found.level)) if found.level > 0 else Cell()
    return Cell(f"{before}{bound(found.level)}", f"[{bound(found.low)}, {bound(found.high)}]")


def _breaks(rows: list[Row]) -> Sheet:
    single = [axis for axis in AXES if axis.group != "model"]
    lines = []
    for task in TASKS:
        for name in _present(rows, task):
            outcomes = outcomes_of(rows, name, task)
            parameter, sign, least = weakest(outcomes)
            before = f"{parameter.replace('_', ' ')} {'−' if sign < 0 else '+'}"
            percent = _level(Crossing(*(100 * value for value in least)), 25, ".0f", before)
            others = [_level(breaking(outcomes, axis), axis.levels[-1], ".2g") for axis in single]
            lines.append([Cell(name), Cell(task), percent, *others])
    return Sheet(
        "(a) Level at which success falls to 50 %; a dash where it is below that already",
        _columns(("controller", "task"), ("one parameter, % wrong", *(axis.name for axis in single))),
        lines,
    )


def _plants(rows: list[Row]) -> Sheet:
    lines = []
    for task in TASKS:
        for name in _present(rows, task, "plants"):
            mean, tail = on_plants(rows, name, task)
            count = len(_chosen(rows, controller=name, task=task, part="plants"))
            cells = [Cell(name), Cell(task), Cell(str(count)), _percent(mean), _percent(tail)]
            lines.append([*cells, Cell(f"{100 * tail.worst:.0f}")])
    return Sheet(
        "(b) Success, %, on plants wrong in everything at once",
        _columns(("controller", "task"), ("plants", "mean", "worst tenth (CVaR)", "worst plant")),
        lines,
    )


def _sensors(rows: list[Row]) -> Sheet:
    lines = []
    for task in TASKS:
        for name in _present(rows, task, "sensors"):
            for of in SENSORS:
                cells = [Cell(name), Cell(task), Cell(of.name)]
                for view in VIEWS:
                    own = _chosen(rows, controller=name, task=task, part="sensors", axis=of.name, view=view)
                    met = np.stack([_unpacked(row) for row in own], axis=1) if own else None
                    cells.append(Cell() if met is None else _percent(mean_share(met.mean(axis=1), met.size)))
                lines.append(cells)
    return Sheet(
        "(c) Success, %, the mean over the levels of an axis, by what stands between sensors and controller",
        _columns(("controller", "task", "axis"), tuple(VIEWS)),
        lines,
    )


if __name__ == "__main__":
    _study.main("studies.robustness")
