"""What the time-varying regulator forgives: starts and plants other than planned, by time and by nearest sample.

Run ``python -m benchmarks.tvlqr``, about a minute.  ``gustafsson2016``, weights as they come, seed 100: each angle of
the start moved by U[-s, s], each mass and length changed by a share U[-p, p] of its own (a plant each, the controller
believing the nominal one).  Success: both links within 0.2 rad of the target for the last second of the run.  Share
that succeeds in percent, with 95 % Wilson intervals; both indices meet the same starts and plants.
"""

from __future__ import annotations

import itertools

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.stats import binomtest

import dpend
from controllers import TVLQR, Trajectory, shipped
from dpend import EQUILIBRIA, Rig, SwingUp

SEED = 100
RUNS = 1000
FIELDS = ("cart_mass", "mass1", "mass2", "length1", "length2")
TROUBLES = ((0.1, 0.0), (0.2, 0.0), (0.3, 0.0), (0.5, 0.0), (0.1, 0.05), (0.1, 0.1))  # s, p


def stored(rig: Rig, start: str, target: str) -> Trajectory:
    found = shipped(rig, start, target)
    if found is None:
        raise RuntimeError("The stored trajectories are missing; make them with python -m controllers.data.")
    return found


def rate(rig: Rig, controller: TVLQR, start: str, target: str, s: float, p: float, runs: int = RUNS) -> str:
    """Return the share of runs that succeed, with its interval, in percent."""
    rng = np.random.default_rng(SEED)
    steps = len(controller.trajectory.u) + round(3.0 / rig.sample_time)
    task = SwingUp(start=start, target=target, angle_spread=s, steps=steps)
    starts = task.starts(rng, runs, rig)
    shares = 1 + p * rng.uniform(-1, 1, (len(FIELDS), runs))
    true = rig.replace(**{name: getattr(rig.params, name) * share for name, share in zip(FIELDS, shares, strict=True)})
    good = int(dpend.simulate_many(true, controller, starts, task=task, seed=SEED).success.sum())
    low, high = binomtest(good, runs).proportion_ci(method="wilson")
    return f"{100 * good / runs:.1f} [{100 * low:.1f}, {100 * high:.1f}]"


def swing_ups(rig: Rig) -> Table:
    table = Table("start", "index", *(f"s = {s}, p = {p}" for s, p in TROUBLES), title=f"To up-up, {RUNS} runs a cell")
    for start, index in itertools.product(("hanging", "side"), ("time", "nearest")):
        controller = TVLQR(rig, stored(rig, start, "up-up"), index=index)  # type: ignore[arg-type]
        table.add_row(start, index, *(rate(rig, controller, start, "up-up", s, p) for s, p in TROUBLES))
    return table


def transfers(rig: Rig, runs: int = 200) -> Table:
    troubles = ((0.1, 0.0), (0.2, 0.0), (0.1, 0.05))
    table = Table("from", "to", *(f"s = {s}, p = {p}" for s, p in troubles), title=f"Between equilibria, {runs} runs")
    for start, target in itertools.permutations(EQUILIBRIA, 2):
        controller = TVLQR(rig, stored(rig, start, target))
        table.add_row(start, target, *(rate(rig, controller, start, target, s, p, runs) for s, p in troubles))
    return table


def presets(runs: int = 200) -> Table:
    troubles = ((0.0, 0.0), (0.1, 0.0), (0.2, 0.0), (0.1, 0.05))
    table = Table("rig", *(f"s = {s}, p = {p}" for s, p in troubles), title=f"From hanging to up-up, {runs} runs")
    for name in dpend.rigs():
        rig = dpend.rig(name)
        controller = TVLQR(rig)
        table.add_row(name, *(rate(rig, controller, "hanging", "up-up", s, p, runs) for s, p in troubles))
    return table


def main() -> None:
    console = Console(width=160)
    rig = dpend.rig("gustafsson2016")
    for table in (swing_ups(rig), transfers(rig), presets()):
        console.print(table)


if __name__ == "__main__":
    main()
