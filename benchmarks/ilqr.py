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
from benchmarks.simulator import race
from controllers import ILQRMPC
from dpend.params import Array

RUNS = 20
STARTS, TURNS = 100, 3


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
    Console().print(table)
    batch(rig)


def batch(rig: dpend.Rig) -> None:
    """Print how many times as fast a batch is as the same runs one after the other."""
    law, task = ILQRMPC(rig, upright_only=True), dpend.Balance(lam=0.4)
    starts = task.starts(np.random.default_rng(1), STARTS, rig)

    def side_by_side() -> int:
        return len(dpend.simulate_many(rig, law, starts, task=task))

    def one_by_one() -> int:
        for row, x0 in enumerate(starts):
            dpend.simulate_many(rig, law, x0[None], task=task, first_row=row)
        return STARTS

    speeds = race({"batch": side_by_side, "one": one_by_one}, TURNS)
    best = {name: max(found) for name, found in speeds.items()}
    faster, thousand = best["batch"] / best["one"], 1000 / best["batch"]
    print(f"{STARTS} runs of {task.steps} samples at λ = 0.4, side by side: {faster:.2g} times as fast as one by one;")
    print(f"a thousand take {thousand:.0f} s.")


if __name__ == "__main__":
    main()
