"""Learning steps per second of the compiled linear Q-learning, beside the plant's own scalar steps on one core.

Run ``python -m benchmarks.learners``.  A learning step is one sample of the plant (two Runge-Kutta steps), two
evaluations of Table 1's features, one greedy choice over nine forces for acting and one for the target, and one update
of eighteen weights.  The peer is the same rig stepped one sample at a time through ``Stepper``, without any learning:
what a loop written in Python could reach at best.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from rich.console import Console
from rich.table import Table

import dpend
from rl import LinearQLearning

REPETITIONS = 5


def learn() -> int:
    """Train without acceptance tests until the budget ends; return the steps learned from."""
    learner = replace(LinearQLearning.tuned(dpend.rig("gustafsson2016"), select=False), max_episodes=2000, streak=2001)
    return learner.train(0).cost.steps


def step_in_python() -> int:
    """Step one rig from Python; return the steps."""
    stepper = dpend.Stepper(dpend.rig("gustafsson2016"), 1)
    stepper.reset(np.zeros(6))
    force = np.zeros(1)
    for _ in range(20_000):
        stepper.step(force)
    return 20_000


def best(work: Callable[[], int]) -> float:
    """Return the steps per second of one call."""
    began = time.perf_counter()
    steps = work()
    return steps / (time.perf_counter() - began)


def main() -> None:
    learn()  # compiles
    step_in_python()
    speeds = [(best(learn), best(step_in_python)) for _ in range(REPETITIONS)]
    learning, stepping = np.max(speeds, axis=0)
    table = Table("one core", "M steps/s", title=f"Best of {REPETITIONS} interleaved repetitions")
    table.add_row("linear Q-learning, compiled", f"{learning / 1e6:.2f}")
    table.add_row("Stepper called from Python, no learning", f"{stepping / 1e6:.3f}")
    table.add_row("ratio", f"{learning / stepping:.0f}")
    Console().print(table)


if __name__ == "__main__":
    main()
