"""How long a robustness study of a state-feedback controller takes: batches beside one run after the other.

``python -m benchmarks.robustness`` evaluates LQR on RealAIGym's six axes as the study does it, in at least as many
runs of 10 s as RealAIGym's 722, and beside it runs of the same kind one by one, in turns; ``--quick`` takes fewer.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = os.environ["MKL_NUM_THREADS"] = "1"

import platform

import numpy as np
import tyro
from rich.console import Console

import dpend
from benchmarks.simulator import Job, pin_to_one_core, race, report, version_of
from controllers import LQR
from studies._field import RIG
from studies._perturbations import AXES, NOMINAL, SECONDS, measure, task_of

THEIRS = 722
"""Runs of RealAIGym's study of one controller, 10 s each."""


def batched(starts: int) -> Job:
    """Let LQR balance on all axes from some starts; counts runs."""

    def job() -> int:
        return sum(of.size for of in measure(LQR(RIG), "balance", starts).values())

    return job


def one_by_one(runs: int) -> Job:
    """Let LQR balance on rigs of one axis, one run after the other; counts runs."""
    (axis,) = (axis for axis in AXES if axis.name == "mass1")
    task = task_of("balance")
    starts = task.starts(np.random.default_rng([0, 1]), runs, RIG)

    def job() -> int:
        law = LQR(RIG)
        for k, start in enumerate(starts):
            rig = RIG.replace(**axis.changes(np.array(axis.levels[k % len(axis.levels)])))
            dpend.simulate(rig, law, start, task=task)
        return runs

    return job


def main(quick: bool = False, repetitions: int = 5) -> None:
    """Measure the runs a second of a robustness study, on one core, in turns.

    Parameters
    ----------
    quick
        Two turns, to see that it runs.
    repetitions
        Turns that each way gets; two at most with --quick.
    """
    if repetitions < 1:
        raise SystemExit(f"--repetitions must be at least 1; got {repetitions}.")
    pin_to_one_core()
    turns = min(repetitions, 2) if quick else repetitions
    settings = sum(len(axis.levels) for axis in (NOMINAL, *AXES))
    starts = -(-THEIRS // settings)
    console = Console()
    console.print(f"Python {platform.python_version()}, {version_of('numpy')}, {version_of('numba')}", highlight=False)
    console.print(f"One core; best and median of {turns} turns.\n", highlight=False)
    few, many, single = f"{starts * settings} runs, {starts} starts", f"{100 * settings} runs, 100 starts", "one by one"
    jobs = {few: batched(starts), many: batched(100), single: one_by_one(10 if quick else 40)}
    title = f"Runs of {SECONDS:g} s of LQR balancing on RealAIGym's six axes, {settings} settings"
    report(console, title, jobs, [(few, single, None), (many, single, None)], turns)
    speed = max(race({few: jobs[few]}, turns)[few])
    seconds = starts * settings / speed
    console.print(
        f"{few}: {seconds:.2f} s on one core, {speed * SECONDS:,.0f} times real time; "
        f"asked for 20 s: {'met' if seconds <= 20 else 'MISSED'}",
        highlight=False,
        soft_wrap=True,
    )


if __name__ == "__main__":
    tyro.cli(main, prog="python -m benchmarks.robustness")
