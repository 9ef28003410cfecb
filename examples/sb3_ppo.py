# pyright: reportMissingImports=false
"""Stable-Baselines3's PPO with its defaults on ``dpend/Balance-v0``, judged as any other controller.

Run ``python -m examples.sb3_ppo --steps 300000 --seed 0``; it needs the extra ``deep``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
import tyro
from scipy.stats import binomtest
from stable_baselines3 import PPO

import dpend

RIG = dpend.rig("gustafsson2016")
TASK = dpend.Balance()


@dataclass(frozen=True)
class Options:
    """How long to train, and from which seed."""

    steps: int = 300_000  # samples of experience
    seed: int = 0  # of the networks, the exploration and the starts
    report_every: int = 20_480  # samples between two lines of progress

    def __post_init__(self) -> None:
        for name, least in (("steps", 1), ("seed", 0), ("report_every", 1)):
            if (value := getattr(self, name)) < least:
                raise ValueError(f"--{name.replace('_', '-')} must be at least {least}; got {value}.")


@dataclass(frozen=True)
class Trained:
    """A model of Stable-Baselines3 as a controller: the mean action is the share of the force limit."""

    model: PPO

    def start(self, n: int, rng: np.random.Generator) -> dpend.Act:
        """Return the law for ``n`` runs side by side."""
        return lambda t, y: RIG.force_limit * self.model.predict(y, deterministic=True)[0][:, 0]


def successes(model: PPO, starts: int, seed: int) -> int:
    """Return how many of some starts a model balances from."""
    x0 = TASK.starts(np.random.default_rng(seed), starts, RIG)
    return int(dpend.simulate_many(RIG, Trained(model), x0, task=TASK).success.sum())


def train(options: Options) -> PPO:
    """Return a trained model; print its success on the way."""
    torch.set_num_threads(1)  # networks this small are fastest on one
    model = PPO("MlpPolicy", "dpend/Balance-v0", seed=options.seed, device="cpu")
    while model.num_timesteps < options.steps:
        left = options.steps - model.num_timesteps
        model.learn(min(left, options.report_every), reset_num_timesteps=False)
        print(f"{model.num_timesteps:>9,} steps: {successes(model, 50, seed=options.seed + 1)} of 50 starts")
    return model


def main(arguments: list[str] | None = None) -> None:
    """Train as the command line says, and print the success over 200 fresh starts."""
    options = tyro.cli(Options, args=arguments, description=__doc__, prog="python -m examples.sb3_ppo")
    good = successes(train(options), 200, seed=options.seed + 2)
    interval = binomtest(good, 200).proportion_ci(method="wilson")
    print(f"Success {good / 200:.1%} [{interval.low:.1%}, {interval.high:.1%}]: {good} of 200 fresh starts.")


if __name__ == "__main__":
    main()
