"""Learning steps per second of the compiled linear Q-learning, beside the plant's own scalar steps on one core.

Run ``python -m benchmarks.learners``.  A learning step is one sample of the plant (two Runge-Kutta steps), two
evaluations of Table 1's features, one greedy choice over nine forces for acting and one for the target, and one update
of eighteen weights.  The peer is the same rig stepped one sample at a time through ``Stepper``, without any learning:
what a loop written in Python could reach at best.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import tyro
from rich.console import Console

import dpend
from benchmarks.race import Race, pin_to_one_core, run, show
from rl import LinearQLearning


def races(quick: bool = False) -> list[Race]:
    """Return the race of learning, compiled, against a loop in Python that does not learn."""
    episodes, steps = (20, 1000) if quick else (2000, 20_000)
    rig = dpend.rig("gustafsson2016")
    learner = replace(LinearQLearning.tuned(rig, select=False), max_episodes=episodes, streak=episodes + 1)

    def learn() -> float:
        return learner.train(0).cost.steps

    def step_in_python() -> float:
        stepper = dpend.Stepper(rig, 1)
        stepper.reset(np.zeros(6))
        force = np.zeros(1)
        for _ in range(steps):
            stepper.step(force)
        return steps

    ours, peer = "linear Q-learning, compiled", "Stepper called from Python"
    return [
        Race(title="Learning", counts="samples", jobs={ours: learn, peer: step_in_python}, pairs=[(ours, peer, None)])
    ]


def main(quick: bool = False) -> None:
    """Measure samples a second; ``--quick`` does a little of everything."""
    pin_to_one_core()
    for race in races(quick):
        show(Console(), run(race, 2 if quick else None))


if __name__ == "__main__":
    tyro.cli(main, prog="python -m benchmarks.learners")
