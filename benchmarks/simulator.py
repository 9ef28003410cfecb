"""How fast the simulator and the environments are beside MuJoCo's and Gymnasium's: one process, one core, one run.

``python -m benchmarks.simulator`` prints the ratios and the accuracy; ``--quick`` does a little of everything.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = os.environ["MKL_NUM_THREADS"] = "1"

from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import gymnasium
import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

import dpend
from benchmarks import mujoco_plant
from benchmarks.race import TITLE, Job, Race, pin_to_one_core, processor, run, show, versions
from benchmarks.relative import from_relative, to_relative
from controllers import LQR
from dpend.params import Array

RIG = dpend.rig("gustafsson2016")
SAMPLES = 300
COPIES = 4096
BARE = f"plant alone, {COPIES} rows"


def races(quick: bool = False) -> list[Race]:
    """Return the races of closed loops, of vector environments and of single ones."""
    ours, theirs = "dpend/Balance-v0", "CartPole-v1"
    steps = 20 if quick else 50
    single: dict[str, Job] = {ours: single_job(ours, 1000 if quick else 5000)}
    peer = "InvertedDoublePendulum-v5"
    if find_spec("mujoco"):
        single[peer] = single_job(peer, 100 if quick else 500)
    return [
        rollouts(RIG, mujoco_rows=32 if quick else 256),
        Race(
            title=f"Native vector environments, {COPIES} copies, random actions",
            counts="steps",
            jobs={name: vector_job(name, steps) for name in (ours, theirs)},
            pairs=[(ours, theirs, 1.0)],
            turns=50,
        ),
        Race(
            title="Single environments, no force, resets included",
            counts="steps",
            jobs=single,
            pairs=[(ours, peer, 10.0)],
            turns=50,
        ),
    ]


def rollouts(rig: dpend.Rig, mujoco_rows: int) -> Race:
    """Closed-loop Runge-Kutta steps of ``simulate_many`` against open-loop ones of the plant and of MuJoCo."""
    theirs = f"mujoco.rollout, {mujoco_rows} rows"
    lqr = LQR(rig)
    jobs: dict[str, Job] = {}

    def add(name: str, true_rig: dpend.Rig, rows: int, record: bool) -> None:
        x0 = dpend.Balance(lam=0.1).starts(np.random.default_rng(0), rows, rig)

        def job() -> float:
            dpend.simulate_many(true_rig, lqr, x0, SAMPLES * rig.sample_time, record=record)
            return rows * SAMPLES * rig.substeps

        jobs[name] = job

    for rows in (COPIES, 4 * COPIES):
        add(f"closed loop, {rows} rows", rig, rows, False)
        add(f"closed loop, {rows} rows, recording", rig, rows, True)
    masses = np.random.default_rng(1).uniform(0.9, 1.1, COPIES) * rig.params.mass1
    add(f"closed loop, {COPIES} rows, a rig each", rig.replace(mass1=masses), COPIES, False)
    pairs: list[tuple[str, str, float | None]]
    pairs = [(name, theirs, 200.0 if name.endswith("rows") else None) for name in jobs]
    pairs += [(BARE, theirs, None), (f"closed loop, {COPIES} rows", BARE, 0.7)]
    jobs[BARE] = bare_job(rig)
    if find_spec("mujoco"):
        jobs[theirs] = mujoco_job(rig, lqr, mujoco_rows)
    return Race(title="LQR on gustafsson2016", counts="Runge-Kutta steps", jobs=jobs, pairs=pairs)


def bare_job(rig: dpend.Rig) -> Job:
    """Step the plant under a constant force, without a law, a task or a record."""
    stepper = dpend.Stepper(rig, COPIES)
    x0 = dpend.Balance(lam=0.1).starts(np.random.default_rng(0), COPIES, rig)
    force = np.zeros(COPIES)

    def job() -> float:
        stepper.reset(x0)
        for _ in range(SAMPLES):
            stepper.step(force)
        return COPIES * SAMPLES * rig.substeps

    return job


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

    def job() -> float:
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

    def job() -> float:
        for k in range(steps):
            envs.step(actions[k % len(actions)])
        return steps * COPIES

    return job


def single_job(name: str, steps: int) -> Job:
    """Step one environment, rid of its wrappers, without force, and reset it when an episode ends."""
    env = gymnasium.make(name).unwrapped
    action = np.zeros(1, dtype=np.float32)
    env.reset(seed=0)

    def job() -> float:
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


def main(quick: bool = False) -> None:
    """Measure speeds beside MuJoCo's and Gymnasium's, on one core, in turns, and the accuracy.

    Parameters
    ----------
    quick
        A little of everything, to see that it runs; the figures mean little.
    """
    pin_to_one_core()
    console = Console()
    console.print(f"{processor()}; {versions('numpy', 'numba', 'gymnasium', 'mujoco')}.\n", highlight=False)
    for race in races(quick):
        show(console, run(race, 2 if quick else None))

    t = RIG.sample_time * np.arange(round(2 / RIG.sample_time))
    motions = {
        "hanging, then driven, 20 N at 1 Hz": (dpend.EQUILIBRIA["down-down"], 20 * np.sin(2 * np.pi * t)),
        "falling from (0.2, -0.1) rad": (np.array([0, 0.2, -0.1, 0, 0, 0]), np.zeros(len(t))),
    }
    table = Table(title="Largest error over 2 s, against dpend.reference", **TITLE)
    table.add_column("")
    counts = (1, 2, 4)
    for count in counts:
        table.add_column(f"{count} x {1000 * RIG.sample_time / count:g} ms", justify="right")
    for name, (x0, u) in motions.items():
        table.add_row(name, *(f"{error:.1e}" for error in errors(RIG, x0, u, counts)))
    console.print(table)


if __name__ == "__main__":
    tyro.cli(main, prog="python -m benchmarks.simulator")
