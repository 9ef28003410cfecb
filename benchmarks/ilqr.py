"""Time per step of the iLQR horizon by percentile: in the swing, upright, and for the first plan; and of a batch.

Run ``python -m benchmarks.ilqr`` on a machine that does nothing else.  A step shifts the plan, follows it from the
measured state, and does at most two iterations; while the plan is costly it does as much for a challenger.  The batch
balances from λ = .4, on all cores, in turns with as many runs one after the other.
"""

from __future__ import annotations

import numpy as np
from rich.console import Console
from rich.table import Table

import dpend
from benchmarks.race import Race, run, show
from controllers import ILQRMPC
from dpend.params import Array

RUNS = 20
STARTS = 100


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
        starts = task.starts(np.random.default_rng(0), RUNS, rig)
        each = [dpend.simulate_many(rig, controller, x0[None], task=task, first_row=k) for k, x0 in enumerate(starts)]
        runs = dpend.Runs.join(each, rig)
        steps = runs.step_time[:, 1:]
        swinging = runs.t[1:-1] < np.where(runs.success, runs.time_up, np.inf)[:, None]
        row(table, f"{start}: all steps but the first", steps[np.isfinite(steps)])
        row(table, f"{start}: until upright", steps[swinging & np.isfinite(steps)])
        row(table, f"{start}: first plan", runs.step_time[:, 0])
    console = Console()
    console.print(table)
    for race in races():
        show(console, run(race))


def races(quick: bool = False) -> list[Race]:
    """Return the race of a batch against the same runs one after the other; on one core where pinned to one."""
    rig = dpend.rig("gustafsson2016")
    law, task = ILQRMPC(rig, upright_only=True), dpend.Balance(lam=0.4)
    starts = task.starts(np.random.default_rng(1), 4 if quick else STARTS, rig)

    def side_by_side() -> float:
        return len(dpend.simulate_many(rig, law, starts, task=task))

    def one_by_one() -> float:
        for row, x0 in enumerate(starts):
            dpend.simulate_many(rig, law, x0[None], task=task, first_row=row)
        return len(starts)

    ours, peer = f"{len(starts)} side by side", "one by one"
    title, jobs = "iLQR MPC balancing from λ = 0.4, 300 samples", {ours: side_by_side, peer: one_by_one}
    return [Race(title=title, counts="runs", jobs=jobs, pairs=[(ours, peer, None)], turns=3, elsewhere=True)]


if __name__ == "__main__":
    main()
