"""How often does energy alone swing the double pendulum up, and what do hold and saturation do to its law?

Method: on gustafsson2016 from hanging, each angle moved by up to 0.1 rad, 30 s.  The passivity law is tried with its
force free and all but continuous (1 ms, no limit), then held for 20 ms, limited to 40 N, both, and with friction; then
it and energy pumping are followed by LQR, which takes over inside an ellipsoid of its cost-to-go (calibrated on the
simulated loop), or where a simulation ahead sees it come to rest.  Arrived is who was up for the last second.

Finding: alone, neither law ever arrives, though each comes near upright's energy from all 200 starts; hold and limit
keep the passivity law's V above half, where free it falls to 6 % of its start.  LQR in the calibrated ellipsoid catches
0 and 1 of 200; where it is seen to hold 57 (28.5 %) after the passivity law and 177 (88.5 %) after pumping.  From the
default options, kept in docs/results/energy_swing_up.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from rich.table import Table

import dpend
from controllers import LQR, Ellipsoid, EnergyPump, EnergySwingUp, SwitchingController
from dpend import Controller, Rig
from dpend.params import Array

from . import _study
from ._intervals import wilson
from ._study import Job, Result, Traces

SPREAD = 0.1
DURATION = 30.0
FINE: dict[str, Any] = {"sample_time": 0.001, "substeps": 1}
FREE: dict[str, Any] = {"force_limit": np.inf}
RUBBING: dict[str, Any] = {"cart_friction": 0.1, "joint1_friction": 0.01, "joint2_friction": 0.01}


class Setting(NamedTuple):
    """A law, made for the plain rig, and what is changed of the rig on which it runs."""

    build: Callable[[Rig], Controller]
    changes: dict[str, Any]


def _in_ellipsoid(law: type[EnergySwingUp] | type[EnergyPump], rig: Rig) -> SwitchingController:
    return SwitchingController(rig, law(rig), region=Ellipsoid.calibrated(LQR(rig)))


def _ahead(law: type[EnergySwingUp] | type[EnergyPump], rig: Rig) -> SwitchingController:
    return SwitchingController(rig, law(rig))


SETTINGS = {
    "passivity, 1 ms, no limit": Setting(EnergySwingUp, FINE | FREE),
    "passivity, 20 ms, no limit": Setting(EnergySwingUp, FREE),
    "passivity, 1 ms, 40 N": Setting(EnergySwingUp, FINE),
    "passivity, 20 ms, 40 N": Setting(EnergySwingUp, {}),
    "passivity, 1 ms, no limit, friction": Setting(EnergySwingUp, FINE | FREE | RUBBING),
    "pumping, 20 ms, 40 N": Setting(EnergyPump, {}),
    "passivity, LQR in ellipsoid": Setting(partial(_in_ellipsoid, EnergySwingUp), {}),
    "pumping, LQR in ellipsoid": Setting(partial(_in_ellipsoid, EnergyPump), {}),
    "passivity, LQR seen to hold": Setting(partial(_ahead, EnergySwingUp), {}),
    "pumping, LQR seen to hold": Setting(partial(_ahead, EnergyPump), {}),
}


@dataclass(frozen=True, kw_only=True)
class Options(_study.Options):
    """What can be told on the command line."""

    runs: int = 200
    """Starts of each law at 20 ms."""
    fine_runs: int = 20
    """Starts of each law at 1 ms."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_least(1, "runs", "fine_runs")


@dataclass(frozen=True, kw_only=True)
class Row:
    """One law under one set of circumstances."""

    setting: str
    runs: int
    arrived: int
    """Up for the last second."""
    off_track: int
    near: int
    """Within 10 % of upright's energy at some time, the cart on its track."""
    energy: float
    """Median over the runs of the mean energy of the last 5 s, as a share of upright's."""
    rise: float
    """Greatest rise of V in 20 ms in any run, as a share of V at the start."""
    time_up: float
    """Median time until up for good of those that arrived, s; NaN where none did."""


def jobs(options: Options) -> list[Job]:
    """List the work: one job a setting."""
    return [Job(setting) for setting in SETTINGS]


def run(job: Job, options: Options) -> Result:
    """Let every start swing."""
    plain = dpend.rig("gustafsson2016")
    build, changes = SETTINGS[job.setting]
    rig = plain.replace(**changes)
    runs = options.fine_runs if changes.keys() & FINE.keys() else options.runs
    duration = DURATION
    if options.quick:
        runs, duration = min(runs, 2), 2.0
    each = round(plain.sample_time / rig.sample_time)
    task = dpend.SwingUp(angle_spread=SPREAD)
    starts = task.starts(np.random.default_rng([options.seed, 6]), runs, rig)
    done = dpend.simulate_many(rig, build(plain), starts, duration, task=task, seed=options.seed, record=True)
    assert done.x is not None  # it was asked for
    x = done.x[:, ::each]
    law = EnergySwingUp(plain)
    energy = dpend.energies(x, plain.params).total / law.energy
    v = law.lyapunov(x) / law.lyapunov(x[:, :1])
    near = (np.abs(energy - 1) <= 0.1).any(axis=1)
    off = done.steps < round(duration / rig.sample_time)
    last = round(5 / plain.sample_time)
    row = Row(
        setting=job.setting,
        runs=runs,
        arrived=int(done.success.sum()),
        off_track=int(off.sum()),
        near=int(near.sum()),
        energy=float(np.median(energy[~off, -last:].mean(axis=1))) if not off.all() else float("nan"),
        rise=float(np.nanmax(np.diff(v, axis=1))),
        time_up=float(np.median(done.time_up[done.success])) if done.success.any() else float("nan"),
    )
    return Result([row], {"t": done.t[::each], "v": _median(v), "energy": _median(energy)})


def _median(values: Array) -> Array:
    """Return the median of the runs that still go on; NaN where none does."""
    some = ~np.isnan(values).all(axis=0)
    median = np.full(values.shape[1], np.nan)
    median[some] = np.nanmedian(values[:, some], axis=0)
    return median


def plot(rows: list[Row], traces: Traces) -> Figure:
    """Draw V and the energy of the passivity law under its circumstances, and how often each law arrives."""
    figure = Figure(figsize=(9.0, 3.4), layout="constrained")
    axes = figure.subplots(1, 3, width_ratios=(1, 1, 0.9))
    colours = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7")
    alone = [name for name in SETTINGS if name.startswith("passivity") and "LQR" not in name]
    for name, colour in zip(alone, colours, strict=True):
        trace = traces[_study.slug(Job(name))]
        axes[0].semilogy(trace["t"], trace["v"], color=colour, lw=1, label=name.removeprefix("passivity, "))
        axes[1].plot(trace["t"], trace["energy"], color=colour, lw=1)
    axes[0].set(xlabel="time, s", ylabel="V / V(0), median", title="passivity law alone")
    axes[0].legend(fontsize=7)
    axes[1].axhline(1.0, color="k", ls="--", lw=0.8)
    axes[1].set(xlabel="time, s", ylabel="E / Er, median", title="its energy")
    caught = [row for row in rows if "LQR" in row.setting]
    for place, row in enumerate(caught):
        rate = wilson(row.arrived, row.runs)
        axes[2].barh(place, rate.share, color="#0072B2", height=0.6)
        axes[2].plot([rate.low, rate.high], [place, place], color="k", lw=1.2)
    axes[2].set(xlim=(0, 1), xlabel="arrived within 30 s", yticks=range(len(caught)), title="then caught")
    axes[2].set_yticklabels([row.setting.replace(", ", ",\n") for row in caught], fontsize=7)
    axes[2].invert_yaxis()
    for axis in axes:
        axis.grid(alpha=0.3)
    return figure


def summary(rows: list[Row], traces: Traces) -> Table:
    """Condense the table."""
    table = Table(title=f"From hanging ± {SPREAD} rad, {DURATION:g} s; with 95 % intervals")
    for heading in (
        "",
        "runs",
        "arrived",
        "median\ntime",
        "off\ntrack",
        "near Er",
        "E/Er\nat the end",
        "rise of V\nin 20 ms",
    ):
        table.add_column(heading, justify="right" if heading else "left")
    for row in rows:
        rate = wilson(row.arrived, row.runs)
        table.add_row(
            row.setting,
            str(row.runs),
            f"{100 * rate.share:.0f} % [{100 * rate.low:.0f}, {100 * rate.high:.0f}]",
            f"{row.time_up:.1f} s" if row.arrived else "-",
            str(row.off_track),
            str(row.near),
            f"{row.energy:.2f}",
            f"{row.rise:.1e}",
        )
    return table


if __name__ == "__main__":
    _study.main("studies.energy_swing_up")
