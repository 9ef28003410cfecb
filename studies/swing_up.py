"""Which controllers swing the double pendulum up, how smoothly and robustly, and between equilibria?

Method: every controller starts gustafsson2016 (±40 N, ±2.4 m, 0.02 s) from hanging and from the report's side start
(π/2, π/2), angles moved by up to 0.1 rad, and succeeds if both links are up for the last second of 10 s; then with
starts moved by ±0.2 rad, with masses and lengths wrong by up to 7, 10 and 15 %, and with encoders and a sample of
delay behind an extended Kalman filter.  Runs on wrong plants last 30 s (10 s those of NMPC and the learned model):
within a horizon a run succeeds if its links were up a second before, for good; failures are off the track, late or
never.  These two have a part of the runs.  Then the twelve transfers between equilibria, and hanging to upright on
every preset.  Intervals are Wilson's, 95 %.  Steps are timed one run at a time; late ones take longer than the sample
time.

Finding: iLQR MPC and TVLQR swing up from all 400 starts, NMPC from 80 of 80, the learned model from 79.  iLQR MPC takes
0.1 ms a step (median) and succeeds in 99.5/99.5 % of 200 starts (hanging/side) with plants 10 % off, 99/99.5 at 15 %,
always behind encoders; the learned model on 119 of 120 plants that are off.  Passivity and LQR arrive in 0 and 9.5 %,
pumping and LQR in 40.5 and 51.5 %, with a planned last swing always.  All 12 transfers: iLQR MPC and TVLQR, 50 of 50.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from matplotlib.figure import Figure

import dpend
from controllers import EKF, NMPC, WithEstimator
from dpend.controller import is_batched
from dpend.draw import draw_strobe
from dpend.params import Array

from . import _field, _runner
from ._estimates import Estimate, share
from ._field import CONTENDERS, Contender, Cost, designed_and_learned, find, longest_first, made, styles
from ._figures import Style, curves, facets, force_trace, forest, heat_map, legend_above, note, share_axis
from ._own import Own
from ._plant import DEFAULT_RIG, Plant, rig_of
from ._runner import Positive, Report, Result, Table
from ._step_times import StepTimes, undisturbed
from ._tables import Cell, Sheet, sheet

MINUTES = 8


def _energy_nmpc(rig: dpend.Rig, task: dpend.Balance | dpend.SwingUp) -> NMPC:
    assert isinstance(task, dpend.SwingUp)
    return NMPC(rig, target=task.target, cost="energy")


KNOWN = (
    *CONTENDERS,
    Contender(name="energy NMPC", make=_energy_nmpc, tasks=("swing-up",), cost=Cost.EXPENSIVE,
              style=("#56B4E9", "p", "-")),
)  # fmt: skip
"""Those that can take part; the last in this study only."""

PRESETS = tuple(name for name in dpend.rigs() if name != DEFAULT_RIG)
STARTS = {"hanging": "from hanging", "side": "from (π/2, π/2)"}
ERRORS = (0.07, 0.1, 0.15)
HORIZON, HORIZONS = 10.0, (5.0, 10.0, 15.0, 20.0, 30.0)
"""Seconds within which runs are to succeed: that of all tables, and those of the runs on wrong plants."""
CONDITIONS: Mapping[str, Mapping[str, Any]] = {
    "nominal": {},
    "starts ±0.2": {"angle_spread": 0.2},
    **{f"plant ±{100 * error:g} %": {"plant_error": error} for error in ERRORS},
    "encoders, delay": {"encoders": True},
}
"""What differs from the fields of a nominal job."""

TRANSFERS = tuple(itertools.permutations(dpend.EQUILIBRIA, 2))
MOVERS = ("iLQR MPC", "TVLQR")
"""Those that take any equilibrium as their target and make the transfers; NMPC too, if all is asked for."""

NOMINAL_ONLY = ("energy NMPC",)
"""Those of this study alone; under every condition if all is asked for."""

METRICS = ("time_up", "seconds", "peak_force", "travel", "effort", "variation", "saturated")
"""What is kept of each run beside its success."""

_CHUNK = 50  # runs in a job
_HOLD = dpend.SwingUp().hold
_ENCODERS = {"resolution": (1e-4, 2 * np.pi / 2048, 2 * np.pi / 2048, 0.0, 0.0, 0.0), "sensor_delay": 1}


@dataclass(frozen=True, kw_only=True)
class Options(_field.Options):
    """Options of the command line."""

    known: ClassVar[tuple[Contender, ...]] = KNOWN
    tasks = ("swing-up",)

    runs: Positive = 200  # Starts of each controller under each condition; NMPC has a part of them.
    transfer_runs: Positive = 50  # Starts of each transfer.
    preset_runs: Positive = 20  # Starts on each preset.
    all: bool = False  # Try every controller under every condition, and NMPC's transfers too.
    films: bool = False  # Write an animation of each controller's first run from hanging.


@dataclass(frozen=True, kw_only=True)
class Job:
    """Some runs of one controller, as one case has them; nominal where nothing else is said."""

    contender: str
    own: Own | None = None
    start: str = "hanging"
    target: str = "up-up"
    rig: str = DEFAULT_RIG  # A preset, where there is no plant elsewhere.
    seconds: float = 10.0
    angle_spread: float = 0.1  # Each angle of a start is moved by as much, rad.
    plant_error: float = 0.0  # Masses and lengths are wrong by up to this share.
    encoders: bool = False  # Whether encoders with delay are read through an extended Kalman filter.
    first: int = 0  # The first of the case's runs.
    runs: int
    seed: int
    elsewhere: Plant | None = None


NOMINAL = {name: getattr(Job, name) for name in ("target", "angle_spread", "plant_error", "encoders")}
"""The condition of the first comparison, in which steps are timed one run after the other."""


def jobs(options: Options) -> list[Job]:
    """List the work, in chunks of runs, what takes longest first; where it must be quick one run of each kind."""
    cases, quick, each = [], options.quick, (options.runs, options.transfer_runs, options.preset_runs)
    runs, transfer_runs, preset_runs = (1, 1, 1) if quick else each
    for contender in longest_first(options.contenders("swing-up")):
        name = contender.name
        plant = options.elsewhere
        nominal = Job(contender=name, own=contender.own, runs=runs, seed=options.seed, elsewhere=plant,
                      rig=plant.name if plant else DEFAULT_RIG)  # fmt: skip
        slow, few = contender.cost is Cost.EXPENSIVE, contender.cost.runs(runs)
        for start, changes in itertools.product(STARTS, CONDITIONS.values()):
            wrong = "plant_error" in changes
            if not changes:
                cases.append(replace(nominal, start=start, runs=Cost.MODERATE.runs(runs) if slow else runs))
            elif quick:
                if contender.cost is Cost.CHEAP and changes == {"plant_error": ERRORS[-1]}:
                    cases.append(replace(nominal, start=start, seconds=HORIZONS[-1], **changes))
            elif options.all or (name not in NOMINAL_ONLY and (wrong or not slow)):
                seconds = HORIZON if slow or not wrong else HORIZONS[-1]
                cases.append(replace(nominal, start=start, seconds=seconds, runs=few, **changes))
        moves = name in MOVERS or (options.all and name == "NMPC")
        moves &= not (plant and name == "TVLQR")  # whose trajectories of transfers are shipped
        for start, target in TRANSFERS[: 1 if quick else None] if moves else ():
            cases.append(replace(nominal, start=start, target=target, seconds=6.0, runs=transfer_runs))
        if (moves or contender.own) and not quick and not plant:
            cases += [replace(nominal, rig=rig, seconds=20.0, runs=preset_runs) for rig in PRESETS]
    chunks = [(case, first) for case in cases for first in range(0, case.runs, _CHUNK)]
    return [replace(case, first=first, runs=min(_CHUNK, case.runs - first)) for case, first in chunks]


def task_of(case: Any, rig: dpend.Rig) -> dpend.SwingUp:
    """Return the task of a job, or of a line of the table, on its rig."""
    steps = round(case.seconds / rig.sample_time)
    return dpend.SwingUp(start=case.start, target=case.target, angle_spread=case.angle_spread, steps=steps)


def run(job: Job) -> Result:
    """Run one controller from some starts of one case; it may refuse a preset."""
    own = job.elsewhere is not None or job.rig == DEFAULT_RIG  # else it is on another preset
    rig = rig_of(job.elsewhere) if own else dpend.rig(job.rig)
    task = task_of(job, rig)
    mine = slice(job.first, job.first + job.runs)
    starts = task.starts(np.random.default_rng([job.seed, 1]), mine.stop, rig)[mine]
    timed = own and job.start in STARTS and all(getattr(job, name) == value for name, value in NOMINAL.items())
    try:
        contender = find(job.contender, job.own, KNOWN)
        controller = made(contender, job.elsewhere, task) if own else contender.make(rig, task)
    except ValueError:
        if own:
            raise
        return Result([{"refused": True, "timed": timed, "successes": 0}])
    true = rig
    if job.encoders:
        true = rig.replace(**_ENCODERS)
        controller = WithEstimator(EKF(true), controller)
    elif job.plant_error:
        true = _wrong(rig, job.plant_error, np.random.default_rng([job.seed, 2]), mine)
    shown = timed and job.start == "hanging" and job.first == 0
    size = 1 if timed else job.runs
    if timed:  # once before, for what is compiled then
        dpend.simulate_many(rig, controller, starts[:1], rig.sample_time, task=task)
    with undisturbed():
        parts = [
            dpend.simulate_many(
                true, controller, starts[k : k + size],
                task=task, seed=job.seed, first_row=job.first + k, record=shown,
            )
            for k in range(0, job.runs, size)
        ]  # fmt: skip
    runs = dpend.Runs.join(parts, true)
    metrics = runs.metrics()
    arrays = {"success": runs.success, "left": runs.codes > 0, "given": np.full(job.runs, job.seconds)}
    arrays |= {name: metrics[name] for name in METRICS}
    if shown:
        arrays |= {"x": runs[0].x, "u": runs[0].u}
    if timed or not is_batched(controller):
        arrays |= StepTimes.of(runs, rig.sample_time).arrays()
    return Result([{"refused": False, "timed": timed, "successes": int(runs.success.sum())}], arrays)


def _wrong(rig: dpend.Rig, error: float, rng: np.random.Generator, mine: slice) -> dpend.Rig:
    """Return rigs whose masses and lengths each differ from the believed by up to a share, one a run."""
    names = ("cart_mass", "mass1", "mass2", "length1", "length2")
    factors = 1 + error * rng.uniform(-1, 1, (mine.stop, len(names)))[mine]
    return rig.replace(**{name: getattr(rig.params, name) * factors[:, i] for i, name in enumerate(names)})


Runs = Mapping[str, Array]
"""Success and metrics by name, one a run."""

_MEDIANS = {
    "time up, s": ("time_up", ".2f"), "peak, N": ("peak_force", ".1f"), "track, m": ("travel", ".2f"),
    "effort, N² s": ("effort", ".0f"), "variation, 1/s": ("variation", ".2f"), "saturated, %": ("saturated", ".0%"),
}  # fmt: skip
_FORMS = {heading: form for heading, (_, form) in _MEDIANS.items()}


def runs_of(table: Table, contender: str, **fields: Any) -> Runs:
    """Return the runs of one case, nominal in what is not given."""
    chosen = NOMINAL | {"contender": contender, "rig": _own_rig(table)} | fields
    kept = {name: table.arrays(name, **chosen) for name in ("success", "left", "given", *METRICS)}
    return {name: np.concatenate([np.empty(0), *parts]) for name, parts in kept.items()}


def _own_rig(table: Table) -> str:
    """Return the name of the rig on which all but the runs on presets are."""
    return table.plant.name if table.plant else DEFAULT_RIG


def up(runs: Runs, horizon: float | None = None) -> Estimate:
    """Return the share of runs that succeeded, within a horizon where one is given; NaN of none that lasted so long."""
    if horizon is None:
        return share(runs["success"], len(runs["success"]))
    asked = runs["given"] >= horizon
    return share(runs["time_up"][asked] <= horizon - _HOLD + 1e-9, asked.sum())


def failures(runs: Runs) -> str:
    """Return how many runs left the track, were up after :data:`HORIZON` alone, and never; nothing of no runs."""
    time_up, left = runs["time_up"], runs["left"] == 1
    late = int((time_up > HORIZON - _HOLD + 1e-9).sum())
    never = int((np.isnan(time_up) & ~left).sum())
    return f"{int(left.sum())}, {late}, {never} of {len(left)}" * bool(len(left))


def _rates(table: Table, contender: str, start: str) -> dict[str, Estimate]:
    """Return the share of runs that succeeded under every condition."""
    return {
        each: up(runs_of(table, contender, start=start, **changes), HORIZON) for each, changes in CONDITIONS.items()
    }


def _median(runs: Runs, metric: str) -> float:
    """Return the median over the runs that succeeded."""
    values = runs[metric][runs["success"] == 1]
    return float(np.median(values)) if len(values) else np.nan


def _counted(runs: Runs) -> str:
    """Return successes of runs and the median time up in words; nothing of no runs."""
    done, n = int(runs["success"].sum()), len(runs["success"])
    return f"{done} of {n}" * bool(n) + f", {_median(runs, 'time_up'):.2f} s" * bool(done)


def report(table: Table) -> Report:
    """Draw the swings, the success under every condition, and the transfers; tabulate them and how long steps take."""
    looks, rows = styles(table.rows["contender"], KNOWN), table.rows
    movers, elsewhere = (
        [name for name in looks if name in set(rows["contender"][of.to_numpy()])]
        for of in (rows["start"].isin(dpend.EQUILIBRIA), rows["rig"] != _own_rig(table))
    )
    swings, conditions, horizons, failed = [], [], [], []
    for name, start in itertools.product(looks, STARTS):
        line, runs = {"controller": name, "from": start}, runs_of(table, name, start=start)
        medians: dict[str, Any] = {heading: _median(runs, metric) for heading, (metric, _) in _MEDIANS.items()}
        if np.isfinite(middle := medians["time up, s"]):
            low, high = np.nanquantile(runs["time_up"], (0.25, 0.75))
            medians["time up, s"] = Cell(f"{middle:.2f}", f"{low:.2f} to {high:.2f}", middle)
        swings.append(line | {"up, %": up(runs)} | medians)
        conditions.append(line | _rates(table, name, start))
        wrong = {f"±{100 * error:g} %": runs_of(table, name, start=start, plant_error=error) for error in ERRORS}
        failed.append(line | {f"plant {each}": failures(runs) or None for each, runs in wrong.items()})
        horizons += [line | {"plant": each} | {f"{T:g} s": up(runs, T) for T in HORIZONS}
                     for each, runs in wrong.items() if len(runs["success"])]  # fmt: skip
    transfers = [
        {"from, to": f"{start}, {target}"}
        | {name: _counted(runs_of(table, name, start=start, target=target)) for name in movers}
        for start, target in TRANSFERS if movers
    ]  # fmt: skip
    presets = [
        {"preset": rig} | {name: _counted(runs_of(table, name, rig=rig)) or "refused" for name in elsewhere}
        for rig in PRESETS if elsewhere
    ]  # fmt: skip
    medians_of = "medians over runs that succeed, of times up with quartiles"
    tables = [
        sheet(f"Swing-up on the plant as it is believed to be; {medians_of}", swings, _FORMS),
        sheet(f"Runs that are up for good within {HORIZON:g} s, %, under every condition", conditions, ".1%"),
        sheet("Runs that are up for good within a horizon, %, plants wrong by up to ±", horizons, ".1%"),
        sheet(f"Runs that fail: off the track, late (up after {HORIZON:g} s), never up", failed),
        *_step_tables(table, looks),
        sheet("Transfers between equilibria: successes of runs, median time to arrive", transfers),
        sheet("Hanging to upright on the other presets: successes of runs, median time up", presets),
    ]
    figures = {"": _swings(table, looks), "_success": _success(table, looks)}
    if horizons:
        figures["_horizon"] = _horizons(table, looks)
    if movers:
        figures["_transfers"] = _transfers(table, movers)
    return Report(figures=figures, tables=tables)


def _step_tables(table: Table, names: Iterable[str]) -> tuple[Sheet, Sheet]:
    """Tabulate the times of nominal steps, and late steps of those whose other runs are timed too."""
    steps, late = [], []
    for name in names:
        line, times = {"controller": name}, StepTimes.joined(table, contender=name, timed=True)
        known = {"median": 1e3 * times.quantile(0.5), "p99": 1e3 * times.quantile(0.99), "longest": 1e3 * times.longest}
        first = {"first step, median": 1e3 * np.median(times.first), "first step, longest": 1e3 * times.first.max()}
        steps.append(line | known | {"late": times.late, "of": times.steps} | first)
        if table.arrays("step_counts", contender=name, timed=False):
            times = StepTimes.joined(table, contender=name)
            late.append(line | {"late": times.late, "of": times.steps, "longest, ms": 1e3 * times.longest})
    return (
        sheet("Time per step, ms, one run at a time, nominal, both starts; the first step of a run apart", steps),
        sheet("Late steps under all conditions, transfers and presets, of those that treat one run at a time", late),
    )


def _first_swing(table: Table, line: Any, after: float = np.inf, otherwise: float = np.inf) -> dpend.Run:
    """Return a first nominal run from hanging: until some seconds after it was up, or the first where it never was."""
    rig, runs = table.rig, runs_of(table, line.contender, start="hanging")
    x, u = (table.array(each, contender=line.contender) for each in ("x", "u"))
    success, time_up = bool(runs["success"][0]), float(runs["time_up"][0])
    lasted = rig.sample_time * np.isfinite(u).sum()
    n = round(min(lasted, time_up + after if success else otherwise) / rig.sample_time)
    return dpend.Run(
        t=rig.sample_time * np.arange(n + 1, dtype=np.float64), x=x[: n + 1], y=x[: n + 1], u=u[:n],
        step_time=np.full(n, np.nan), status=dpend.Status.FULL_LENGTH, success=success, time_up=time_up,
        rig=rig, controller=line.contender, task=repr(task_of(line, rig)), seed=line.seed,
    )  # fmt: skip


def _swings(table: Table, looks: Mapping[str, Style]) -> Figure:
    """Draw for every controller its first swing from hanging: as strobe pictures, angles, and force."""
    first = {line.contender: line for line in table.lines(timed=True, start="hanging", first=0)}
    height = 1.55 * len(looks) + 0.5
    figure, axes = facets(len(looks), 3, height=height, width_ratios=(1.0, 1.15, 1.15), sharex="col")
    for (name, style), (strobe, angles, force) in zip(looks.items(), axes, strict=True):
        run = _first_swing(table, first[name])
        draw_strobe(strobe, _first_swing(table, first[name], 0.6, 5.0).x, run.rig)
        strobe.set(xlim=(-3.6, 3.6), title=name)
        for column, colour, line in ((1, "#0072B2", "-"), (2, "#D55E00", "--")):
            angles.plot(run.t, run.x[:, column] / np.pi, color=colour, ls=line, label=f"link {column}")
        angles.set_xlim(0, 6)
        force_trace(force, run.u, run.rig.sample_time, 6.0, style[0], "")
        if not run.success:
            note(force, "not up")
    axes[0, 1].set_title("angles (half turns)")
    axes[0, 2].set_title("force on the cart (N)")
    axes[0, 1].legend(loc="upper right")
    for axis, label in zip(axes[-1], ("position (m)", "time (s)", "time (s)"), strict=True):
        axis.set_xlabel(label)
    return figure


def _success(table: Table, looks: Mapping[str, Style]) -> Figure:
    """Draw the share of successes under every condition, with its interval, one panel a start."""
    figure, axes = facets(1, len(STARTS), height=1.2 + 0.5 * len(CONDITIONS), sharex=True, sharey=True)
    for axis, (start, title) in zip(axes[0], STARTS.items(), strict=True):
        for order, (name, style) in enumerate(looks.items()):
            forest(axis, _rates(table, name, start), style, aside=0.09 * (order - (len(looks) - 1) / 2), label=name)
        axis.set_title(title)
        share_axis(axis, along="x")
    figure.supxlabel("runs that end upright")
    legend_above(figure, 4)
    return figure


def _horizons(table: Table, looks: Mapping[str, Style]) -> Figure:
    """Draw success from hanging against the horizon on wrong plants: a column an error, learned ones below."""
    sides = designed_and_learned(looks)
    figure, axes = facets(len(sides), len(ERRORS), height=0.8 + 2.3 * len(sides), sharex=True, sharey=True)
    for axis, (side, error) in zip(axes.flat, itertools.product(sides, ERRORS), strict=True):
        of = {name: runs_of(table, name, start="hanging", plant_error=error) for name in side}
        drawn = {name: {T: up(runs, T) for T in HORIZONS if (runs["given"] >= T).any()} for name, runs in of.items()}
        curves(axis, {name: curve for name, curve in drawn.items() if curve}, looks, aside=0.012)
        share_axis(axis)
        axis.set_xticks(HORIZONS)
    for axis, error in zip(axes[0], ERRORS, strict=True):
        axis.set_title(f"plants ±{100 * error:g} %")
    figure.supxlabel("horizon (s)")
    figure.supylabel("runs from hanging that are up for good")
    legend_above(figure, 4)
    return figure


def _transfers(table: Table, movers: Sequence[str]) -> Figure:
    """Draw a square for every mover: successes from each equilibrium to each other, and the median time they take."""
    figure, axes = facets(1, len(movers), height=3.6, sharey=True)
    places = list(dpend.EQUILIBRIA)
    for axis, name in zip(axes[0], movers, strict=True):
        cells = [[runs_of(table, name, start=start, target=target) for target in places] for start in places]
        words = [[_counted(each).replace(" of ", "/").replace(", ", "\n") for each in row] for row in cells]
        heat_map(axis, np.array([[up(each).value for each in row] for row in cells]), places, places, words=words)
        axis.set(title=name, xlabel="to")
    axes[0, 0].set_ylabel("from (link 1 - link 2)")
    return figure


def films(table: Table) -> dict[str, Callable[[Path], object]]:
    """Return what writes an animation of each controller's first swing from hanging, by file name.

    It shows a second more than until it is up.  Where two names differ in signs only, a job's number tells them apart.
    """
    found = {}
    for line in table.lines(timed=True, start="hanging", first=0):
        stem = re.sub(r"[^\w-]+", "_", line.contender)
        name = f"{stem}_{line.job}.gif" if f"{stem}.gif" in found else f"{stem}.gif"
        found[name] = _first_swing(table, line, 1.0, 6.0).animate
    return found


if __name__ == "__main__":
    _runner.main("studies.swing_up")
