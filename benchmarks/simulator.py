"""How fast the simulator and the environments are beside MuJoCo's and Gymnasium's: one process, one core, one run.

``python -m benchmarks.simulator`` prints the table and the ratios; ``--quick`` does a little of everything.  Whatever
is compared takes turns with its peer, so a machine busy with other things slows both; the best turn and the median are
given.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = os.environ["MKL_NUM_THREADS"] = "1"

import platform
from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from statistics import median
from time import perf_counter
from typing import Any

import gymnasium
import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

import dpend
from benchmarks import mujoco_plant
from benchmarks.relative import from_relative, to_relative
from controllers import LQR
from dpend.params import Array

Job = Callable[[], int]
"""Does some work and tells how many steps it was."""

SAMPLES = 300
COPIES = 4096

TITLE: dict[str, Any] = {"title_justify": "left", "title_style": "bold"}

Comparison = tuple[str, str, float | None]
"""Which job stands against which, and the ratio of speeds that is asked for, if any."""


def pin_to_one_core() -> None:
    """Keep this process on one of the cores it may use, where the system allows that."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


def race(jobs: dict[str, Job], repetitions: int) -> dict[str, list[float]]:
    """Let jobs take turns, after a first turn in which code is compiled, and give the steps per second of each turn."""
    for job in jobs.values():
        job()
    speeds: dict[str, list[float]] = {name: [] for name in jobs}
    for _ in range(repetitions):
        for name, job in jobs.items():
            began = perf_counter()
            steps = job()
            speeds[name].append(steps / (perf_counter() - began))
    return speeds


def rollouts(rig: dpend.Rig, mujoco_rows: int) -> tuple[dict[str, Job], list[Comparison]]:
    """Closed-loop Runge-Kutta steps of ``simulate_many`` against open-loop ones of ``mujoco.rollout``."""
    theirs = f"mujoco.rollout, {mujoco_rows} rows, recording"
    lqr = LQR(rig)
    jobs: dict[str, Job] = {}

    def add(name: str, true_rig: dpend.Rig, rows: int, record: bool) -> None:
        x0 = dpend.Balance(lam=0.1).starts(np.random.default_rng(0), rows, rig)

        def job() -> int:
            dpend.simulate_many(true_rig, lqr, x0, SAMPLES * rig.sample_time, record=record)
            return rows * SAMPLES * rig.substeps

        jobs[name] = job

    for rows in (COPIES, 4 * COPIES):
        add(f"simulate_many, {rows} rows", rig, rows, False)
        add(f"simulate_many, {rows} rows, recording", rig, rows, True)
    masses = np.random.default_rng(1).uniform(0.9, 1.1, COPIES) * rig.params.mass1
    add(f"simulate_many, {COPIES} rows, a rig each", rig.replace(mass1=masses), COPIES, False)
    comparisons: list[Comparison] = [(name, theirs, 150.0 if name.endswith("rows") else None) for name in jobs]
    if find_spec("mujoco"):
        jobs[theirs] = mujoco_job(rig, lqr, mujoco_rows)
    return jobs, comparisons


def mujoco_job(rig: dpend.Rig, lqr: LQR, rows: int) -> Job:
    """Replay on the calling thread, in MuJoCo, the forces that LQR gave here, from the same starts."""
    mujoco: Any = import_module("mujoco")
    rollout: Any = import_module("mujoco.rollout")
    model = mujoco_plant.build(rig)
    data = mujoco.MjData(model)
    x0 = dpend.Balance(lam=0.1).starts(np.random.default_rng(0), rows, rig)
    ours = dpend.simulate_many(rig, lqr, x0, SAMPLES * rig.sample_time, task=None, record=True)
    start = np.concatenate([np.zeros((rows, 1)), *to_relative(x0)], axis=1)  # time comes first
    forces = np.repeat(np.nan_to_num(ours.u), rig.substeps, axis=1)[:, :, None]
    states = np.empty((*forces.shape[:2], start.shape[1]))

    def job() -> int:
        rollout.rollout(model, data, start, forces, state=states)
        return rows * forces.shape[1]

    job()
    second = round(1 / rig.sample_time)
    after = states[:, second * rig.substeps - 1, 1:]
    assert ours.x is not None
    apart = np.abs(from_relative(after[:, :3], after[:, 3:]) - ours.x[:, second]).max()
    if not apart < 1e-9:
        raise RuntimeError(f"MuJoCo's plant moves otherwise: after one second the states are {apart:.1e} apart.")
    return job


def vector_job(name: str, steps: int) -> Job:
    """Step a native vector environment with random actions; observation, reward and resets included."""
    envs = gymnasium.make_vec(name, num_envs=COPIES, vectorization_mode="vector_entry_point").unwrapped
    envs.action_space.seed(0)
    actions = [envs.action_space.sample() for _ in range(16)]
    envs.reset(seed=0)

    def job() -> int:
        for k in range(steps):
            envs.step(actions[k % len(actions)])
        return steps * COPIES

    return job


def single_job(name: str, steps: int) -> Job:
    """Step one environment, rid of its wrappers, without force, and reset it when an episode ends."""
    env = gymnasium.make(name).unwrapped
    action = np.zeros(1, dtype=np.float32)
    env.reset(seed=0)

    def job() -> int:
        for _ in range(steps):
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()
        return steps

    return job


def errors(rig: dpend.Rig, x0: Array, u: Array, substeps: Sequence[int]) -> list[float]:
    """Largest error of any state over a motion under held forces, for each number of Runge-Kutta steps in a sample."""
    exact = dpend.reference(rig.params, x0, u, rig.sample_time * np.arange(len(u) + 1))
    found = []
    for count in substeps:
        stepper = dpend.Stepper(rig.replace(substeps=count), 1)
        states = [stepper.reset(x0)[0]] + [stepper.step([force])[0] for force in u]
        found.append(float(np.abs(np.stack(states) - exact).max()))
    return found


def report(console: Console, title: str, jobs: dict[str, Job], comparisons: list[Comparison], repetitions: int) -> None:
    """Race jobs, print their speeds, and print the ratios that were asked for."""
    speeds = race(jobs, repetitions)
    table = Table(title=title, **TITLE)
    table.add_column("")
    table.add_column("best, 1/s", justify="right")
    table.add_column("median, 1/s", justify="right")
    for name in [*jobs, *sorted({theirs for _, theirs, _ in comparisons} - set(jobs))]:
        if name in speeds:
            table.add_row(name, f"{max(speeds[name]):,.0f}", f"{median(speeds[name]):,.0f}")
        else:
            table.add_row(name, "not installed (extra peers)", "")
    console.print(table)
    for ours, theirs, target in comparisons:
        if theirs in speeds:
            best, middle = (f(speeds[ours]) / f(speeds[theirs]) for f in (max, median))
            wanted = "" if target is None else f"; asked for {target:g}: {'met' if best >= target else 'MISSED'}"
            line = f"{ours} / {theirs.split(',')[0]}: {best:.3g} (of the medians {middle:.3g}){wanted}"
            console.print(line, highlight=False, soft_wrap=True)
    console.print()


def version_of(package: str) -> str:
    try:
        return f"{package} {version(package)}"
    except PackageNotFoundError:
        return f"no {package}"


def main(quick: bool = False, repetitions: int = 10) -> None:
    """Measure speeds beside MuJoCo's and Gymnasium's, on one core, in turns.

    Parameters
    ----------
    quick
        A little of everything, to see that it runs; the figures mean little.
    repetitions
        Turns that each contestant gets, the environments five times as many; two at most with --quick.
    """
    if repetitions < 1:
        raise SystemExit(f"--repetitions must be at least 1; got {repetitions}.")
    pin_to_one_core()
    turns = min(repetitions, 2) if quick else repetitions
    console = Console()
    packages = ("numpy", "numba", "gymnasium", "mujoco")
    console.print(f"Python {platform.python_version()}, {', '.join(map(version_of, packages))}", highlight=False)
    console.print(
        f"One core; best and median of {turns} turns, of {5 * turns} for the environments.\n", highlight=False
    )

    rig = dpend.rig("gustafsson2016")
    jobs, comparisons = rollouts(rig, mujoco_rows=32 if quick else 256)
    title = "Runge-Kutta steps, LQR on gustafsson2016"
    report(console, title, jobs, comparisons, turns)

    ours, theirs = "dpend/Balance-v0", "CartPole-v1"
    steps = 20 if quick else 50
    jobs = {name: vector_job(name, steps) for name in (ours, theirs)}
    title = f"Steps of native vector environments, {COPIES} copies, random actions"
    report(console, title, jobs, [(ours, theirs, 1.0)], 5 * turns)

    theirs = "InvertedDoublePendulum-v5"
    jobs = {ours: single_job(ours, 1000 if quick else 5000)}
    if find_spec("mujoco"):
        jobs[theirs] = single_job(theirs, 100 if quick else 500)
    title = "Steps of single environments, no force, resets included"
    report(console, title, jobs, [(ours, theirs, 10.0)], 5 * turns)

    t = rig.sample_time * np.arange(round(2 / rig.sample_time))
    motions = {
        "hanging, then driven, 20 N at 1 Hz": (dpend.EQUILIBRIA["down-down"], 20 * np.sin(2 * np.pi * t)),
        "falling from (0.2, -0.1) rad": (np.array([0, 0.2, -0.1, 0, 0, 0]), np.zeros(len(t))),
    }
    table = Table(title="Largest error over 2 s, against dpend.reference", **TITLE)
    table.add_column("")
    counts = (1, 2, 4)
    for count in counts:
        table.add_column(f"{count} x {1000 * rig.sample_time / count:g} ms", justify="right")
    for name, (x0, u) in motions.items():
        table.add_row(name, *(f"{error:.1e}" for error in errors(rig, x0, u, counts)))
    console.print(table)


if __name__ == "__main__":
    tyro.cli(main, prog="python -m benchmarks.simulator")
