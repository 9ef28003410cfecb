"""Time per step of the iLQR horizon by percentile: in the swing, upright, and for the first plan.

Run ``python -m benchmarks.ilqr`` on a machine that does nothing else.  A step shifts the plan, follows it from the
measured state, and does at most two iterations; while the plan is dear it does as much for a challenger.
"""

from __future__ import annotations

import numpy as np
from rich.console import Console
from rich.table import Table

import dpend
from controllers import ILQRMPC
from dpend.params import Array

RUNS = 20


def row(table: Table, name: str, seconds: Array) -> None:
    """Add one line of percentiles."""
    table.add_row(name, *(f"{1e3 * value:.2f}" for value in (*np.percentile(seconds, (50, 99)), seconds.max())))


def main() -> None:
    rig = dpend.rig("gustafsson2016")
    controller = ILQRMPC(rig)
    dpend.simulate(rig, controller, dpend.EQUILIBRIA["down-down"], 1.0, task=None)  # compiles
    table = Table(
        "", "median ms", "p99 ms", "max ms", title=f"N = {controller.horizon_steps}, {RUNS} runs of 6 s a start"
    )
    for start in ("hanging", "side"):
        task = dpend.SwingUp(start=start, angle_spread=0.1, steps=300)
        runs = dpend.simulate_many(rig, controller, task.starts(np.random.default_rng(0), RUNS, rig), task=task)
        steps = runs.step_time[:, 1:]
        swinging = runs.t[1:-1] < np.where(runs.success, runs.time_up, np.inf)[:, None]
        row(table, f"{start}: all steps but the first", steps[np.isfinite(steps)])
        row(table, f"{start}: until upright", steps[swinging & np.isfinite(steps)])
        row(table, f"{start}: first plan", runs.step_time[:, 0])
    Console().print(table)


if __name__ == "__main__":
    main()
