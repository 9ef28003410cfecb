# pyright: reportMissingImports=false
"""Proximal policy optimization by hand: plain PyTorch on a vector environment, in one file.

Run ``python -m examples.ppo --steps 300000 --seed 0``; it needs the extra ``deep``.  The settings are the defaults of
Stable-Baselines3's PPO, over 16 copies of 128 steps in place of one of 2048.  The algorithm is that of Schulman et al.,
arXiv:1707.06347, with advantages as in arXiv:1506.02438.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

import gymnasium as gym
import numpy as np
import torch
import tyro
from scipy.stats import binomtest
from torch import nn
from torch.distributions import Normal

import dpend  # noqa: F401  (registers the environments)

Environment = Literal["dpend/Balance-v0", "dpend/SwingUp-v0", "dpend/BalanceShaped-v0", "dpend/SwingUpShaped-v0"]


@dataclass(frozen=True)
class Options:
    """What is trained on what, and how."""

    env: Environment = "dpend/Balance-v0"  # the environment's id
    steps: int = 300_000  # samples of experience, over all copies; whole rollouts are taken
    seed: int = 0  # of the networks, the exploration and the starts
    report_every: int = 10  # rollouts between two lines of progress
    copies: int = 16  # environments side by side
    rollout: int = 128  # steps of each copy between two updates
    batch: int = 64  # samples in a gradient step
    epochs: int = 10  # passes over a rollout
    learning_rate: float = 3e-4
    gamma: float = 0.99  # discount of rewards
    gae_lambda: float = 0.95  # decay of the temporal differences that make up an advantage
    clip: float = 0.2  # greatest change of an action's probability that still pays

    def __post_init__(self) -> None:
        for field in fields(self):
            value, option = getattr(self, field.name), f"--{field.name.replace('_', '-')}"
            if isinstance(value, int) and value < (least := 0 if field.name == "seed" else 1):
                raise ValueError(f"{option} must be at least {least}; got {value}.")
            if isinstance(value, float) and not 0 < value <= 1:
                raise ValueError(f"{option} must be above 0 and at most 1; got {value}.")
        samples = self.rollout * self.copies
        if self.steps < samples:
            raise ValueError(f"--steps must be at least a rollout, {samples}; got {self.steps}.")
        if self.batch < 2 or samples % self.batch:  # advantages are normalized within a batch
            raise ValueError(f"--batch must be at least 2 and divide a rollout, {samples}; got {self.batch}.")


class Agent(nn.Module):
    """A Gaussian policy and the value of its states."""

    def __init__(self, observations: int, actions: int) -> None:
        super().__init__()
        self.mean = mlp(observations, actions, gain=0.01)  # small at first, so that exploration is unbiased
        self.log_std = nn.Parameter(torch.zeros(actions))
        self.value = mlp(observations, 1, gain=1.0)

    def policy(self, observations: torch.Tensor) -> Normal:
        """Return the distribution of the action."""
        return Normal(self.mean(observations), self.log_std.exp())


def mlp(inputs: int, outputs: int, gain: float) -> nn.Sequential:
    """Return a network of two hidden layers with orthogonal weights, those of the last layer scaled by a gain."""
    layers = [nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, outputs)]
    for layer, scale in zip(layers[::2], (2**0.5, 2**0.5, gain), strict=True):
        nn.init.orthogonal_(layer.weight, scale)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(*layers)


def tensor(array: np.ndarray) -> torch.Tensor:
    """Return an array as networks take it."""
    return torch.as_tensor(array, dtype=torch.float32)


def make(env: str, copies: int) -> gym.vector.VectorEnv:
    """Return copies of an environment that begin again in the step which ends an episode."""
    same_step = gym.vector.AutoresetMode.SAME_STEP
    return gym.make_vec(env, copies, vectorization_mode="vector_entry_point", autoreset_mode=same_step)


@torch.no_grad()
def successes(agent: Agent, env: str, starts: int, seed: int) -> int:
    """Return how many of some starts the mean action brings to a successful end."""
    envs = make(env, starts)
    observations, _ = envs.reset(seed=seed)
    success, over = np.zeros(starts, bool), np.zeros(starts, bool)
    while not over.all():
        observations, _, terminated, truncated, infos = envs.step(agent.mean(tensor(observations)).numpy())
        ended = (terminated | truncated) & ~over  # a copy's first episode counts
        if ended.any():
            success[ended] = infos["final_info"]["success"][ended]
        over |= ended
    return int(success.sum())


def train(options: Options) -> Agent:
    """Return a trained agent; print its success on the way."""
    torch.set_num_threads(1)  # networks this small are fastest on one
    torch.manual_seed(options.seed)
    envs = make(options.env, options.copies)
    width, actions = (gym.spaces.flatdim(space) for space in (envs.single_observation_space, envs.single_action_space))
    agent = Agent(width, actions)
    optimizer = torch.optim.Adam(agent.parameters(), lr=options.learning_rate, eps=1e-5, fused=True)
    shape = options.rollout, options.copies
    obs, acts = torch.zeros(*shape, width), torch.zeros(*shape, actions)
    log_probs, rewards, values, ends = (torch.zeros(shape) for _ in range(4))
    now = tensor(envs.reset(seed=options.seed)[0])

    for iteration in range(1, options.steps // (options.rollout * options.copies) + 1):
        with torch.no_grad():
            for t in range(options.rollout):
                policy = agent.policy(now)
                obs[t], acts[t], values[t] = now, policy.sample(), agent.value(now).squeeze(-1)
                log_probs[t] = policy.log_prob(acts[t]).sum(-1)
                after, reward, terminated, truncated, infos = envs.step(acts[t].numpy())
                rewards[t], ends[t], now = tensor(reward), tensor(terminated | truncated), tensor(after)
                for i in np.flatnonzero(truncated & ~terminated):  # cut off by the clock: more would have come
                    rewards[t, i] += options.gamma * agent.value(tensor(infos["final_obs"][i])).item()

            advantages, advantage, value = torch.zeros(shape), torch.zeros(options.copies), agent.value(now).squeeze(-1)
            for t in reversed(range(options.rollout)):
                surprise = rewards[t] + options.gamma * (1 - ends[t]) * value - values[t]
                advantage = surprise + options.gamma * options.gae_lambda * (1 - ends[t]) * advantage
                advantages[t], value = advantage, values[t]
        flat = [x.flatten(0, 1) for x in (obs, acts, log_probs, advantages, advantages + values)]

        for _ in range(options.epochs):
            for rows in torch.randperm(options.rollout * options.copies).split(options.batch):
                seen, done, before, gain, target = (x[rows] for x in flat)
                gain = (gain - gain.mean()) / (gain.std() + 1e-8)
                ratio = (agent.policy(seen).log_prob(done).sum(-1) - before).exp()
                clipped = ratio.clamp(1 - options.clip, 1 + options.clip)
                policy_loss = -torch.minimum(gain * ratio, gain * clipped).mean()
                value_loss = (agent.value(seen).squeeze(-1) - target).square().mean()
                optimizer.zero_grad()
                (policy_loss + 0.5 * value_loss).backward()
                nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
                optimizer.step()

        if iteration % options.report_every == 0:
            steps = iteration * options.rollout * options.copies
            print(f"{steps:>9,} steps: {successes(agent, options.env, 50, seed=options.seed + 1)} of 50 starts")
    return agent


def main(arguments: list[str] | None = None) -> None:
    """Train as the command line says, and print the success over 200 fresh starts."""
    options = tyro.cli(Options, args=arguments, description=__doc__, prog="python -m examples.ppo")
    good = successes(train(options), options.env, 200, seed=options.seed + 2)
    interval = binomtest(good, 200).proportion_ci(method="wilson")
    print(f"Success {good / 200:.1%} [{interval.low:.1%}, {interval.high:.1%}]: {good} of 200 fresh starts.")


if __name__ == "__main__":
    main()
