"""How long a robustness study of a state-feedback controller takes: batches beside one run after the other.

``python -m benchmarks.robustness`` evaluates LQR on RealAIGym's six axes as the study does it, in at least as many
runs of 10 s as RealAIGym's 722, and beside it runs of the same kind one by one, in turns; ``--quick`` takes fewer.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = os.environ["MKL_NUM_THREADS"] = "1"

import numpy as np
import tyro
from rich.console import Console

import dpend
from benchmarks.race import Job, Race, pin_to_one_core, processor, run, show, versions
from controllers import LQR
from studies._field import RIG
from studies._perturbations import AXES, NOMINAL, SECONDS, measure, task_of

THEIRS = 722
"""Runs of RealAIGym's study of one controller, 10 s each."""


def batched(starts: int) -> Job:
    """Let LQR balance on all axes from some starts; counts runs."""

    def job() -> float:
        return sum(of.size for of in measure(LQR(RIG), "balance", starts).values())

    return job


def one_by_one(runs: int) -> Job:
    """Let LQR balance on rigs of one axis, one run after the other; counts runs."""
    (axis,) = (axis for axis in AXES if axis.name == "mass1")
    task = task_of("balance")
    starts = task.starts(np.random.default_rng([0, 1]), runs, RIG)

    def job() -> float:
        law = LQR(RIG)
        for k, start in enumerate(starts):
            rig = RIG.replace(**axis.changes(np.array(axis.levels[k % len(axis.levels)])))
            dpend.simulate(rig, law, start, task=task)
        return runs

    return job


def races(quick: bool = False) -> list[Race]:
    """Return the race of batches, of as many runs as RealAIGym's and of more, against one run after the other."""
    settings = sum(len(axis.levels) for axis in (NOMINAL, *AXES))
    starts = -(-THEIRS // settings)
    few, many, single = f"{starts * settings} runs, {starts} starts", f"{100 * settings} runs, 100 starts", "one by one"
    jobs = {few: batched(starts), single: one_by_one(10 if quick else 40)} | ({} if quick else {many: batched(100)})
    title = f"LQR balancing on RealAIGym's six axes, {settings} settings, {SECONDS:g} s a run"
    return [Race(title=title, counts="runs", jobs=jobs, pairs=[(few, single, None), (many, single, None)], turns=5)]


def main(quick: bool = False) -> None:
    """Measure the runs a second of a robustness study, on one core, in turns; ``--quick`` does two turns."""
    pin_to_one_core()
    console = Console()
    console.print(f"{processor()}; {versions('numpy', 'numba')}.\n", highlight=False)
    for race in races(quick):
        show(console, run(race, 2 if quick else None))


if __name__ == "__main__":
    tyro.cli(main, prog="python -m benchmarks.robustness")
