"""Who swings the double pendulum up, how fast, how smoothly, how robustly; and who moves it between its equilibria?

Method: every controller starts gustafsson2016 (±40 N, ±2.4 m, 0.02 s) from hanging and from the report's side start
(π/2, π/2), both angles moved by U[-0.1, 0.1] rad, and succeeds if both links are up for the last second of 10 s; all
meet the same starts.  Then the same with starts moved by ±0.2 rad; with masses and lengths each wrong by up to 5, 10
and 20 % at random; and with encoders of 2048 counts a turn (0.1 mm for the cart), no measured rates and one sample of
delay, read through an extended Kalman filter.  Then the twelve transfers between the four equilibria, 6 s each, and
hanging to upright on every preset.  Intervals are Wilson's, 95 %.  Steps are timed one run at a time, also of laws that
could treat many at once; a step is late if it takes longer than the sample time; the first step of a run, in which
planners plan from nothing, is reported apart.  A controller of yours takes part: ``--controller path.py:factory``.

Finding: iLQR MPC, NMPC and TVLQR swing up from all 400 starts.  iLQR MPC takes 0.1 ms a step (median) and succeeds in
99.5 % with plants 10 % off, 98 % at 20 %, 100 % behind encoders and delay.  Passivity and LQR arrive in 0 and 9.5 %,
pumping and LQR in 40.5 and 51.5 %, with a planned last swing always.  All 12 transfers: iLQR MPC and TVLQR, 50 of 50
each.  From the default options, kept in docs/results/swing_up.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from rich.console import Group, RenderableType
from rich.table import Table

import dpend
from controllers import EKF, NMPC, WithEstimator
from dpend.controller import is_batched
from dpend.draw import draw_strobe

from . import _entrants, _study
from ._entrants import Entrant
from ._intervals import Rate, wilson
from ._step_times import StepTimes, undisturbed
from ._study import Job, Result, Traces


def _energy_nmpc(rig: dpend.Rig, task: dpend.Balance | dpend.SwingUp) -> NMPC:
    assert isinstance(task, dpend.SwingUp)
    return NMPC(rig, target=task.target, cost="energy")


KNOWN = (
    *_entrants.ENTRANTS,
    Entrant(name="energy NMPC", make=_energy_nmpc, tasks=("swing-up",), style=("#56B4E9", "p", "-")),
)
"""Who can take part; the last in this study only."""

NOMINAL_ONLY = ("NMPC", "energy NMPC", "passivity, LQR", "pumping, LQR", "pumping, iLQR, LQR")
"""Those that take milliseconds a step, or do not claim to be robust; they meet every condition if all is asked for."""

STARTS = ("hanging", "side")
CONDITIONS = ("nominal", "starts ±0.2", "plant ±5 %", "plant ±10 %", "plant ±20 %", "encoders, delay")
TRANSFERS = tuple(itertools.permutations(dpend.EQUILIBRIA, 2))
MOVERS = ("iLQR MPC", "TVLQR")
"""Those that take any equilibrium as their target and make the transfers; NMPC too, if all is asked for."""


_CHUNK = 50  # runs in a job
_ENCODERS = {"resolution": (1e-4, 2 * np.pi / 2048, 2 * np.pi / 2048, 0.0, 0.0, 0.0), "sensor_delay": 1}


@dataclass(frozen=True, kw_only=True)
class Options(_entrants.Options):
    """What can be told on the command line."""

    known: ClassVar[tuple[Entrant, ...]] = KNOWN

    runs: int = 200
    """Starts of each controller under each condition."""
    transfer_runs: int = 50
    """Starts of each transfer."""
    preset_runs: int = 20
    """Starts on each preset."""
    all: bool = False
    """Let every controller meet every condition, and NMPC make every transfer too."""
    films: bool = False
    """Write an animation of each controller's first run from hanging."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_least(1, "runs", "transfer_runs", "preset_runs")

    def count(self, case: Case) -> int:
        """Return the number of runs of a case; one where it must be quick."""
        if self.quick:
            return 1
        if case.rig != _RIG:
            return self.preset_runs
        return self.transfer_runs if case.start in dpend.EQUILIBRIA else self.runs

    @property
    def contestants(self) -> dict[str, Entrant]:
        """Those that take part, by name."""
        return {entrant.name: entrant for entrant in self.entrants("swing-up")}


_RIG = "gustafsson2016"
_PRESETS = [name for name in dpend.rigs() if name != _RIG]


class Case(NamedTuple):
    """What a job is about."""

    controller: str
    start: str
    target: str = "up-up"
    condition: str = "nominal"
    rig: str = _RIG

    @property
    def setting(self) -> str:
        """One string for all."""
        return " + ".join(self)

    @property
    def task(self) -> dpend.SwingUp:
        """The task: 10 s, 6 s for a transfer, 20 s on other presets."""
        spread = 0.2 if self.condition == "starts ±0.2" else 0.1
        seconds = 6.0 if self.start in dpend.EQUILIBRIA else 10.0 if self.rig == _RIG else 20.0
        steps = round(seconds / dpend.rig(self.rig).sample_time)
        return dpend.SwingUp(start=self.start, target=self.target, angle_spread=spread, steps=steps)

    @property
    def timed(self) -> bool:
        """Whether it is run one start after the other, to time the steps."""
        return self.condition == "nominal" and self.rig == _RIG and self.start in STARTS


@dataclass(frozen=True, kw_only=True)
class Row:
    """One run."""

    controller: str
    start: str
    target: str
    condition: str
    rig: str
    run: int
    success: bool
    time_up: float
    """When both links were where they are to be, for good, s."""
    seconds: float
    peak_force: float
    travel: float
    effort: float
    variation: float
    saturated: float


def cases(options: Options) -> Iterator[Case]:
    """List what is tried, refusals left in: a controller may refuse a preset, with the reason."""
    for name in options.contestants:
        for start in STARTS:
            for condition in CONDITIONS if options.all or name not in NOMINAL_ONLY else CONDITIONS[:1]:
                yield Case(name, start, condition=condition)
    for name, entrant in options.contestants.items():
        moves = name in MOVERS or (options.all and name == "NMPC")
        if moves:
            yield from (Case(name, start, target) for start, target in TRANSFERS)
        if moves or entrant.source:
            yield from (Case(name, "hanging", rig=rig) for rig in _PRESETS)


def jobs(options: Options) -> list[Job]:
    """List the work, in chunks of runs; where it must be quick, some of it."""
    return [
        Job(case.setting, chunk, options.contestants[case.controller].source)
        for case in cases(options)
        if not options.quick or _shows_it_works(case)
        for chunk in range(-(-options.count(case) // _CHUNK))
    ]


def _shows_it_works(case: Case) -> bool:
    return case.condition == "nominal" and case.rig == _RIG and (case.start, case.target) not in TRANSFERS[1:]


def run(job: Job, options: Options) -> Result:
    """Run one controller from some starts of one case."""
    case = Case(*job.setting.split(" + "))
    rig = dpend.rig(case.rig)
    task = replace(case.task, steps=150) if options.quick else case.task
    first = job.repetition * _CHUNK
    n = min(options.count(case) - first, _CHUNK)
    mine = slice(first, first + n)
    starts = task.starts(np.random.default_rng([options.seed, 1]), first + n, rig)[mine]
    try:
        controller = options.contestants[case.controller].make(rig, task)
    except ValueError:
        if case.rig == _RIG:
            raise
        return Result([])  # refused
    true = rig
    if case.condition == "encoders, delay":
        true = rig.replace(**_ENCODERS)
        controller = WithEstimator(EKF(true), controller)
    elif case.condition.startswith("plant"):
        share = float(case.condition.split("±")[1].split()[0]) / 100
        true = _wrong(rig, share, np.random.default_rng([options.seed, 2]), first + n, mine)
    shown = job.repetition == 0 and case == Case(case.controller, "hanging")
    size = 1 if case.timed else n
    with undisturbed():
        parts = [
            dpend.simulate_many(
                true, controller, starts[k : k + size],
                task=task, seed=options.seed, first_row=first + k, record=shown,
            )
            for k in range(0, n, size)
        ]  # fmt: skip
    runs = dpend.Runs.join(parts, true)
    metrics = runs.metrics()
    rows = [
        Row(
            controller=case.controller,
            start=case.start,
            target=case.target,
            condition=case.condition,
            rig=case.rig,
            run=first + k,
            success=bool(runs.success[k]),
            **{name: _short(metrics[name][k]) for name in _METRICS},
        )
        for k in range(n)
    ]
    traces = {"x": runs[0].x, "u": runs[0].u} if shown else {}
    if case.timed or not is_batched(controller):
        traces |= StepTimes.of(runs, rig.sample_time).traces()
    return Result(rows, traces)


_METRICS = ("time_up", "seconds", "peak_force", "travel", "effort", "variation", "saturated")


def _short(value: float | np.floating) -> float:
    """Return four digits: the table has thousands of rows, and no figure needs more."""
    return float(f"{value:.4g}")


def _wrong(rig: dpend.Rig, share: float, rng: np.random.Generator, n: int, mine: slice) -> dpend.Rig:
    """Return rigs whose masses and lengths each differ from the believed by up to a share, one a run."""
    names = ("cart_mass", "mass1", "mass2", "length1", "length2")
    factors = 1 + share * rng.uniform(-1, 1, (n, len(names)))[mine]
    return rig.replace(**{name: getattr(rig.params, name) * factors[:, i] for i, name in enumerate(names)})


# ------------------------------------------------------------------------------------------------------------- figures


def _case(row: Row) -> Case:
    return Case(row.controller, row.start, row.target, row.condition, row.rig)


def _present(rows: list[Row]) -> list[str]:
    return list(dict.fromkeys(row.controller for row in rows))


def _chosen(rows: list[Row], **wanted: str) -> list[Row]:
    wanted = {"target": "up-up", "condition": "nominal", "rig": _RIG} | wanted
    return [row for row in rows if all(getattr(row, name) == value for name, value in wanted.items())]


def rate(rows: list[Row]) -> Rate:
    """Return the share of runs that succeeded, with its interval."""
    return wilson(sum(row.success for row in rows), len(rows))


def plot(rows: list[Row], traces: Traces) -> dict[str, Figure]:
    """Draw the swings, the success under every condition, and the transfers."""
    figures = {"": _plot_swings(rows, traces), "_success": _plot_success(rows)}
    if any(row.start in dpend.EQUILIBRIA for row in rows):
        figures["_transfers"] = _plot_transfers(rows)
    return figures


def _plot_swings(rows: list[Row], traces: Traces) -> Figure:
    """Draw for every controller its first swing from hanging: as strobe pictures, angles, and force."""
    names = _present(rows)
    rig = dpend.rig(_RIG)
    figure = Figure(figsize=(7.0, 1.55 * len(names) + 0.5), layout="constrained")
    axes = np.atleast_2d(figure.subplots(len(names), 3, width_ratios=(1.0, 1.15, 1.15), sharex="col"))
    for name, (strobe, angles, force) in zip(names, axes, strict=True):
        trace = traces[_study.slug(Job(Case(name, "hanging").setting))]
        x, u = trace["x"], trace["u"]
        lasted = int(np.isfinite(u).sum())
        x, u = x[: lasted + 1], u[:lasted]
        t = rig.sample_time * np.arange(lasted + 1)
        (first,) = [row for row in _chosen(rows, controller=name, start="hanging") if row.run == 0]
        shown = min(lasted, round((first.time_up + 0.6 if first.success else 5.0) / rig.sample_time))
        draw_strobe(strobe, x[: shown + 1], rig)
        strobe.set_xlim(-3.6, 3.6)
        for column, colour, line, label in ((1, "#0072B2", "-", "link 1"), (2, "#D55E00", "--", "link 2")):
            angles.plot(t, x[:, column] / np.pi, color=colour, ls=line, lw=1.2, label=label)
        force.stairs(u, t, baseline=None, color="#009E73", lw=0.9)
        if not first.success:
            force.text(0.97, 0.9, "not up", transform=force.transAxes, ha="right", va="top", fontsize=8)
        for axis in (angles, force):
            axis.grid(alpha=0.3)
        angles.set_xlim(0, 6)
        force.set(xlim=(0, 6), ylim=(-44, 44), yticks=(-40, 0, 40))
        strobe.set_title(name, fontsize=9, loc="left", pad=2)
        for axis in (strobe, angles, force):
            axis.tick_params(labelsize=7)
    axes[0, 1].set_title("angles (half turns)", fontsize=8, loc="left", pad=2)
    axes[0, 2].set_title("force on the cart (N)", fontsize=8, loc="left", pad=2)
    axes[0, 1].legend(fontsize=7, loc="upper right", frameon=False)
    axes[-1, 0].set_xlabel("position (m)", fontsize=8)
    for axis in axes[-1, 1:]:
        axis.set_xlabel("time (s)", fontsize=8)
    return figure


def _plot_success(rows: list[Row]) -> Figure:
    """Draw the share of successes under every condition, with its interval, one panel a start."""
    names = _present(rows)
    styles = _entrants.styles(names, KNOWN)
    figure = Figure(figsize=(6.3, 1.2 + 0.5 * len(CONDITIONS)), layout="constrained")
    axes = figure.subplots(1, len(STARTS), sharex=True, sharey=True)
    for axis, start in zip(axes, STARTS, strict=True):
        for order, name in enumerate(names):
            for place, condition in enumerate(CONDITIONS):
                own = _chosen(rows, controller=name, start=start, condition=condition)
                if not own:
                    continue
                share = rate(own)
                axis.errorbar(
                    share.share, place + 0.09 * (order - (len(names) - 1) / 2),
                    xerr=[[share.share - share.low], [share.high - share.share]],
                    color=styles[name][0], marker=styles[name][1], ms=4, lw=0.9, ls="none",
                    label=name if place == 0 else None,
                )  # fmt: skip
        axis.set_title({"hanging": "from hanging", "side": "from (π/2, π/2)"}[start], fontsize=9)
        axis.xaxis.set_major_formatter(PercentFormatter(1.0))
        axis.set(xlim=(-0.03, 1.03), ylim=(len(CONDITIONS) - 0.4, -0.6), yticks=range(len(CONDITIONS)))
        axis.set_yticklabels(CONDITIONS)
        axis.tick_params(labelsize=8)
        axis.grid(alpha=0.3)
    figure.supxlabel("runs that end upright", fontsize=9)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=4, fontsize=8, frameon=False)
    return figure


def _plot_transfers(rows: list[Row]) -> Figure:
    """Draw a square for every mover: successes from each equilibrium to each other, and the median time they take."""
    movers = [
        name
        for name in (*MOVERS, "NMPC")
        if any(row.start in dpend.EQUILIBRIA and row.controller == name for row in rows)
    ]
    figure = Figure(figsize=(6.3, 3.6), layout="constrained")
    axes = np.atleast_1d(figure.subplots(1, len(movers), sharey=True))
    places = list(dpend.EQUILIBRIA)
    for axis, name in zip(axes, movers, strict=True):
        share = np.full((4, 4), np.nan)
        for (i, start), (j, target) in itertools.product(enumerate(places), enumerate(places)):
            own = _chosen(rows, controller=name, start=start, target=target)
            if start == target or not own:
                continue
            done = [row.time_up for row in own if row.success]
            share[i, j] = len(done) / len(own)
            words = f"{len(done)}/{len(own)}" + (f"\n{np.median(done):.2f} s" if done else "")
            axis.text(j, i, words, ha="center", va="center", fontsize=7.5, color="k" if share[i, j] > 0.4 else "w")
        axis.imshow(share, vmin=0, vmax=1, cmap="cividis")
        axis.set_title(name, fontsize=9)
        axis.set(xticks=range(4), yticks=range(4), xlabel="to")
        axis.set_xticklabels(places, fontsize=7.5)
        axis.set_yticklabels(places, fontsize=7.5)
    axes[0].set_ylabel("from (link 1 - link 2)")
    return figure


def films(rows: list[Row], traces: Traces, out: Path) -> None:
    """Write an animation of each controller's first swing from hanging, up to a second after it is up.

    Parameters
    ----------
    rows : list of Row
        The table.
    traces : dict
        The states and forces of those swings.
    out : Path
        The study's folder.
    """
    rig = dpend.rig(_RIG)
    for name in _present(rows):
        trace = traces[_study.slug(Job(Case(name, "hanging").setting))]
        (first,) = [row for row in _chosen(rows, controller=name, start="hanging") if row.run == 0]
        seconds = first.time_up + 1.0 if first.success else 6.0
        samples = min(int(np.isfinite(trace["u"]).sum()), round(seconds / rig.sample_time))
        x, u = trace["x"][: samples + 1], trace["u"][:samples]
        run = dpend.Run(
            t=rig.sample_time * np.arange(samples + 1, dtype=np.float64),
            x=x,
            y=x,
            u=u,
            step_time=np.full(samples, np.nan),
            status=dpend.Status.FULL_LENGTH,
            success=first.success,
            time_up=first.time_up,
            rig=rig,
            controller=name,
            task=repr(Case(name, "hanging").task),
            seed=0,
        )
        run.animate(out / f"{name.replace(', ', '_').replace(' ', '_')}.gif")


# ------------------------------------------------------------------------------------------------------------ summary


def summary(rows: list[Row], traces: Traces) -> RenderableType:
    """Condense the table."""
    tables = (
        _swings(rows), _conditions(rows), _steps(rows, traces), _late(rows, traces), _transfers(rows), _presets(rows),
    )  # fmt: skip
    return Group(*(table for table in tables if table.row_count))


def _said(own: list[Row]) -> str:
    if not own:
        return "-"
    share = rate(own)
    return f"{100 * share.share:.1f} \\[{100 * share.low:.1f}, {100 * share.high:.1f}]"


def _median(own: list[Row], column: str, form: str) -> str:
    values = [getattr(row, column) for row in own if row.success]
    return format(float(np.median(values)), form) if values else "-"


def _counted(own: list[Row]) -> str:
    done = sum(row.success for row in own)
    return f"{done} of {len(own)}" + (f", {_median(own, 'time_up', '.2f')} s" if done else "")


def _swings(rows: list[Row]) -> Table:
    table = Table(title="Swing-up on the plant as it is believed to be; medians over the runs that succeed")
    table.add_column("controller")
    table.add_column("from")
    for heading in ("success, %", *(words for _, words, _ in _SHOWN)):
        table.add_column(heading, justify="right")
    for name in _present(rows):
        for start in STARTS:
            own = _chosen(rows, controller=name, start=start)
            table.add_row(name, start, _said(own), *(_median(own, column, form) for column, _, form in _SHOWN))
    return table


_SHOWN = (
    ("time_up", "time up, s", ".2f"),
    ("peak_force", "peak, N", ".1f"),
    ("travel", "track, m", ".2f"),
    ("effort", "effort, N² s", ".0f"),
    ("variation", "variation, 1/s", ".2f"),
    ("saturated", "saturated", ".0%"),
)


def _conditions(rows: list[Row]) -> Table:
    table = Table(title="Success, %, and 95 % interval under every condition")
    table.add_column("controller")
    table.add_column("from")
    for condition in CONDITIONS:
        table.add_column(condition, justify="right")
    for name in _present(rows):
        for start in STARTS:
            table.add_row(
                name, start,
                *(_said(_chosen(rows, controller=name, start=start, condition=each)) for each in CONDITIONS),
            )  # fmt: skip
    return table


def _steps(rows: list[Row], traces: Traces) -> Table:
    table = Table(title="Time per step, ms, one run at a time, nominal, both starts; the first step of a run apart")
    for heading in ("controller", "median", "p99", "longest", "late", "of", "first step, median", "longest"):
        table.add_column(heading, justify="left" if heading == "controller" else "right")
    for name in _present(rows):
        times = _times([row for start in STARTS for row in _chosen(rows, controller=name, start=start)], traces)
        first = np.median(times.first), times.first.max()
        table.add_row(
            name,
            *(f"{1e3 * value:.3g}" for value in (times.quantile(0.5), times.quantile(0.99), times.longest)),
            str(times.late),
            str(times.steps),
            *(f"{1e3 * value:.3g}" for value in first),
        )
    return table


def _late(rows: list[Row], traces: Traces) -> Table:
    table = Table(title="Late steps under all conditions, transfers and presets, of those that treat one run at a time")
    for heading in ("controller", "late", "of", "longest, ms"):
        table.add_column(heading, justify="left" if heading == "controller" else "right")
    for name in _present(rows):
        own = [row for row in rows if row.controller == name]
        if any("step_counts" in traces.get(_slug(row), {}) for row in own if not _case(row).timed):
            times = _times(own, traces)
            table.add_row(name, str(times.late), str(times.steps), f"{1e3 * times.longest:.3g}")
    return table


def _slug(row: Row) -> str:
    """Return the name of the job that gave a row."""
    return _study.slug(Job(_case(row).setting, row.run // _CHUNK))


def _times(rows: list[Row], traces: Traces) -> StepTimes:
    """Return the times of all steps of the jobs that gave these rows, as far as their steps were timed."""
    saved = (traces.get(slug, {}) for slug in dict.fromkeys(map(_slug, rows)))
    return StepTimes.joined(trace for trace in saved if "step_counts" in trace)


def _transfers(rows: list[Row]) -> Table:
    table = Table(title="Transfers between equilibria: successes of runs, median time to arrive")
    table.add_column("from, to")
    movers = [
        name for name in _present(rows) if any(_chosen(rows, controller=name, start=s, target=t) for s, t in TRANSFERS)
    ]
    for name in movers:
        table.add_column(name, justify="right")
    for start, target in TRANSFERS:
        cells = []
        for name in movers:
            own = _chosen(rows, controller=name, start=start, target=target)
            cells.append(_counted(own) if own else "-")
        table.add_row(f"{start}, {target}", *cells)
    return table


def _presets(rows: list[Row]) -> Table:
    table = Table(title="Hanging to upright on the other presets: successes of runs, median time up")
    table.add_column("preset")
    names = [name for name in _present(rows) if any(row.rig != _RIG and row.controller == name for row in rows)]
    for name in names:
        table.add_column(name, justify="right")
    for rig in _PRESETS if names else ():
        cells = []
        for name in names:
            own = _chosen(rows, controller=name, start="hanging", rig=rig)
            cells.append(_counted(own) if own else "refused")
        table.add_row(rig, *cells)
    return table


if __name__ == "__main__":
    _study.main("studies.swing_up")
