"""Environment steps per second of DDPG, TD3 and SAC in JAX, beside the same in torch, on one core each.

Run ``python -m benchmarks.deep``; it needs the extra ``jax``.  The setting is that of ``docs/deep-rl.md``: sixteen
copies of the swing-up, eight updates for sixteen steps, layers of 64 and 64 and batches of 256.  Compiling and the
random steps at the beginning are left out, evaluations too.
"""

from __future__ import annotations

import time
from importlib.util import find_spec

import numpy as np
from rich.console import Console
from rich.table import Table

from rl.deep import learner_class
from rl.recipes import INSTALL, NEEDED, DeepRecipe, OffPolicySettings

REPETITIONS = 5
ROUNDS = 100
COPIES = 16


def main() -> None:
    if not all(find_spec(name) for name in NEEDED["jax"]):
        raise SystemExit(INSTALL["jax"])
    headings = "", "torch, steps/s", "JAX, steps/s", "ratio", "of the medians"
    table = Table(*headings, title=f"Best of {REPETITIONS} interleaved repetitions")
    for algo in ("ddpg", "td3", "sac"):
        learners = []
        for library in ("torch", "jax"):
            own = OffPolicySettings(library=library)
            recipe = DeepRecipe(algo=algo, off_policy=own, steps=10_000, copies=COPIES)
            learner = learner_class(recipe)(recipe, 0)
            learner.learn(recipe.steps // 5)  # a tenth at random, then updates, which compile
            learners.append(learner)
        speeds = np.zeros((REPETITIONS, 2))
        for i in range(REPETITIONS):
            for j, learner in enumerate(learners):
                began = time.perf_counter()
                learner.learn(ROUNDS * COPIES)
                speeds[i, j] = ROUNDS * COPIES / (time.perf_counter() - began)
        torch, jax = speeds.max(axis=0)
        usual_torch, usual_jax = np.median(speeds, axis=0)
        table.add_row(
            algo.upper(), f"{torch:.0f}", f"{jax:.0f}", f"{jax / torch:.1f}", f"{usual_jax / usual_torch:.1f}"
        )
    Console().print(table)


if __name__ == "__main__":
    main()
