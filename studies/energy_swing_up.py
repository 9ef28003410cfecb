"""How often does energy alone swing the double pendulum up, and what do hold and saturation do to its law?

Method: on gustafsson2016 from hanging, each angle moved by up to 0.1 rad, 30 s.  The passivity law is tried with its
force free and all but continuous (1 ms, no limit), then held for 20 ms, limited to 40 N, both, and with friction; then
it and energy pumping are followed by LQR, which takes over inside an ellipsoid of its cost-to-go (calibrated on the
simulated loop), or where a rollout shows that it comes to rest.  Arrived is a run that was up for the last second.

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

import dpend
from controllers import LQR, Ellipsoid, EnergyPump, EnergySwingUp, SwitchingController
from dpend import Controller, Rig
from dpend.params import Array

from . import _runner
from ._estimates import share
from ._figures import forest, log_axis, mosaic, share_axis
from ._runner import Plant, Positive, Report, Result, Table
from ._tables import sheet

MINUTES = 1

ANGLE_SPREAD = 0.1
DURATION = 30.0
FINE: dict[str, Any] = {"sample_time": 0.001, "substeps": 1}
FREE: dict[str, Any] = {"force_limit": np.inf}
FRICTION: dict[str, Any] = {"cart_friction": 0.1, "joint1_friction": 0.01, "joint2_friction": 0.01}


class Setting(NamedTuple):
    """A law, designed for the plain rig, and what is changed of the rig on which it runs."""

    build: Callable[[Rig], Controller]
    changes: dict[str, Any]


def _in_ellipsoid(law: type[EnergySwingUp] | type[EnergyPump], rig: Rig) -> SwitchingController:
    return SwitchingController(rig, law(rig), region=Ellipsoid.calibrated(LQR(rig)))


def _by_rollout(law: type[EnergySwingUp] | type[EnergyPump], rig: Rig) -> SwitchingController:
    return SwitchingController(rig, law(rig))


SETTINGS = {
    "passivity, 1 ms, no limit": Setting(EnergySwingUp, FINE | FREE),
    "passivity, 20 ms, no limit": Setting(EnergySwingUp, FREE),
    "passivity, 1 ms, 40 N": Setting(EnergySwingUp, FINE),
    "passivity, 20 ms, 40 N": Setting(EnergySwingUp, {}),
    "passivity, 1 ms, no limit, friction": Setting(EnergySwingUp, FINE | FREE | FRICTION),
    "pumping, 20 ms, 40 N": Setting(EnergyPump, {}),
    "passivity, LQR in ellipsoid": Setting(partial(_in_ellipsoid, EnergySwingUp), {}),
    "pumping, LQR in ellipsoid": Setting(partial(_in_ellipsoid, EnergyPump), {}),
    "passivity, LQR seen to hold": Setting(partial(_by_rollout, EnergySwingUp), {}),
    "pumping, LQR seen to hold": Setting(partial(_by_rollout, EnergyPump), {}),
}


@dataclass(frozen=True, kw_only=True)
class Options(_runner.Options):
    """Options of the command line."""

    runs: Positive = 200  # Starts of each law at 20 ms.
    fine_runs: Positive = 20  # Starts of each law at 1 ms.


@dataclass(frozen=True)
class Job:
    """All starts of one law under one set of circumstances."""

    plant: Plant
    setting: str
    runs: int
    duration: float  # s
    seed: int


@dataclass(frozen=True, kw_only=True)
class Row:
    """One law under one set of circumstances."""

    arrived: int  # up for the last second
    off_track: int
    near: int  # within 10 % of upright's energy at some time, the cart on its track
    energy: float  # median over the runs of the mean energy of the last 5 s, as a share of upright's
    rise: float  # greatest rise of V in 20 ms in any run, as a share of V at the start
    time_up: float  # median time until up for good of those that arrived, s; NaN where none did


def jobs(options: Options) -> list[Job]:
    """List the work: one job a setting."""
    quick = 3 if options.quick else max(options.runs, options.fine_runs)
    return [
        Job(options.plant, name, min(options.fine_runs if changes.keys() & FINE.keys() else options.runs, quick),
            DURATION, options.seed)
        for name, (_, changes) in SETTINGS.items()
    ]  # fmt: skip


def run(job: Job) -> Result:
    """Let every start swing."""
    plain = job.plant.rig
    build, changes = SETTINGS[job.setting]
    rig = plain.replace(**changes)
    each = round(plain.sample_time / rig.sample_time)
    task = dpend.SwingUp(angle_spread=ANGLE_SPREAD)
    starts = task.starts(np.random.default_rng([job.seed, 6]), job.runs, rig)
    done = dpend.simulate_many(rig, build(plain), starts, job.duration, task=task, seed=job.seed, record=True)
    assert done.x is not None  # it was asked for
    x = done.x[:, ::each]
    law = EnergySwingUp(plain)
    energy = dpend.energies(x, plain.params).total / law.energy
    v = law.lyapunov(x) / law.lyapunov(x[:, :1])
    near = (np.abs(energy - 1) <= 0.1).any(axis=1)
    off = done.steps < round(job.duration / rig.sample_time)
    last = round(5 / plain.sample_time)
    row = Row(
        arrived=int(done.success.sum()), off_track=int(off.sum()), near=int(near.sum()),
        energy=float(np.median(energy[~off, -last:].mean(axis=1))) if not off.all() else float("nan"),
        rise=float(np.nanmax(np.diff(v, axis=1))),
        time_up=float(np.median(done.time_up[done.success])) if done.success.any() else float("nan"),
    )  # fmt: skip
    return Result([row], {"t": done.t[::each], "v": _median(v), "energy": _median(energy)})


def _median(values: Array) -> Array:
    """Return the median of the runs that still go on; NaN where none does."""
    some = ~np.isnan(values).all(axis=0)
    median = np.full(values.shape[1], np.nan)
    median[some] = np.nanmedian(values[:, some], axis=0)
    return median


def report(table: Table) -> Report:
    """Draw V and the energy of the passivity law under its circumstances, and how often each law arrives."""
    figure, axes = mosaic([["left", "middle"], ["below", "below"]], height=4.6, height_ratios=(2.2, 1))
    left, middle, below = (axes[name] for name in ("left", "middle", "below"))
    colours = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7")
    alone = [name for name in SETTINGS if name.startswith("passivity") and "LQR" not in name]
    for name, colour in zip(alone, colours, strict=True):
        t, v, energy = (table.array(each, setting=name) for each in ("t", "v", "energy"))
        left.semilogy(t, v, color=colour, lw=1, label=name.removeprefix("passivity, "))
        middle.plot(t, energy, color=colour, lw=1)
    left.set(xlabel="time (s)", ylabel="V / V(0), median", title="passivity law alone")
    log_axis(left, "y", (0.1, 0.2, 0.5, 1))
    left.legend()
    middle.axhline(1.0, color="k", ls="--", lw=0.8)
    middle.set(xlabel="time (s)", ylabel="E / Er, median", title="its energy (1: upright)")
    arrived = {row.setting: share(row.arrived, row.runs) for row in table.lines()}
    duration = table.rows["duration"].to_numpy().max()
    caught = {name: each for name, each in arrived.items() if "LQR" in name}
    forest(below, caught, ("#0072B2", "o", "-"))
    share_axis(below, f"runs that arrive within {duration:g} s", "x")
    below.set_title("either law, then caught")
    lines = [
        {"": row.setting, "arrived, %": arrived[row.setting], "median time, s": row.time_up, "near Er": row.near,
         "E/Er at the end": row.energy, "rise of V in 20 ms": row.rise, "off track": row.off_track, "runs": row.runs}
        for row in table.lines()
    ]  # fmt: skip
    forms = {"arrived, %": ".0%", "median time, s": ".1f", "E/Er at the end": ".2f", "rise of V in 20 ms": ".1e"}
    title = f"From hanging ± {ANGLE_SPREAD} rad, {duration:g} s; with 95 % intervals"
    return Report(figures=figure, tables=[sheet(title, lines, forms)])


if __name__ == "__main__":
    _runner.main("studies.energy_swing_up")
