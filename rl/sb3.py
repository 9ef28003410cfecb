# pyright: reportMissingImports=false
r"""Stable-Baselines3 at work: the adapter of vector environments, CAPS in PPO's loss, and a learner that can go on.

:mod:`rl.deep` imports it when a training begins.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import gymnasium as gym
import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import DDPG, PPO, SAC, TD3
from stable_baselines3.common.buffers import ReplayBuffer, RolloutBuffer
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy, ContinuousCritic
from stable_baselines3.common.torch_layers import create_mlp
from stable_baselines3.common.type_aliases import ReplayBufferSamples, RolloutBufferSamples
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.sac.policies import SACPolicy
from stable_baselines3.td3.policies import TD3Policy

from dpend.archive import atomic
from dpend.params import Array
from dpend.shaping import nearness, observation_scales, observe

from .policies import Network
from .recipes import ROLLOUT, DeepRecipe, training_envs

_WARM_UP = 5000  # steps of random actions before DDPG, TD3 and SAC learn


class Copies(VecEnv):
    r"""A Gymnasium vector environment as Stable-Baselines3 wants it.

    On our plant, observations are :func:`dpend.shaping.observe`'s, and
    :math:`w\,|a_t - a_{t-1}|\,e^{-5(2 - \cos\theta_1 - \cos\theta_2)}` is taken off the reward; an episode begins with
    :math:`a_{-1} = 0`.  The attribute ``grown`` says which share of the recipe's weight :math:`w` is now.
    """

    def __init__(self, envs: gym.vector.VectorEnv[Any, Any, Any], recipe: DeepRecipe) -> None:
        self._envs = envs  # which start again in the step that ends an episode
        self._own = not recipe.env
        self._scales = observation_scales(recipe.rig)
        self._action_rate = recipe.action_rate
        self.grown = 0.0
        self._last = np.zeros(envs.num_envs)
        box = cast(spaces.Box, envs.single_action_space)
        if not isinstance(box, spaces.Box) or box.shape is None or len(box.shape) != 1:
            raise ValueError(f"Deep learners here have continuous actions; got {envs.single_action_space}.")
        self._half_range, self._middle = (box.high - box.low) / 2, (box.high + box.low) / 2
        width = 8 + bool(recipe.action_rate) if self._own else int(np.prod(envs.single_observation_space.shape or ()))
        observed = spaces.Box(-np.inf, np.inf, (width,), dtype=np.float32)
        super().__init__(envs.num_envs, observed, spaces.Box(-1.0, 1.0, box.shape, dtype=np.float32))
        self._actions: Any = np.zeros((envs.num_envs, *box.shape), dtype=np.float32)
        self._nothing: list[dict[str, Any]] = [{} for _ in range(envs.num_envs)]

    def reset(self) -> Any:
        """Begin an episode in every copy."""
        seed, self._seeds[0] = self._seeds[0], None
        y, _ = self._envs.reset(seed=seed)
        self._last[:] = 0.0
        return self._observed(y, self._last)

    def step_async(self, actions: Any) -> None:
        """Keep the actions for the step."""
        self._actions = actions

    def step_wait(self) -> Any:
        """Take a step in every copy."""
        y, rewards, terminated, truncated, seen = self._envs.step(self._actions * self._half_range + self._middle)
        done = terminated | truncated
        arrived, rows = np.array(y), np.flatnonzero(done)
        if len(rows):
            arrived[rows] = np.stack(list(seen["final_obs"][rows]))
        if self._action_rate:
            a = np.clip(self._actions[:, 0].astype(np.float64), -1.0, 1.0)
            near = nearness(np.cos(arrived[:, 1]), np.cos(arrived[:, 2]))
            rewards = rewards - self.grown * self._action_rate * np.abs(a - self._last) * near
            self._last = a
        infos = self._nothing
        if len(rows):
            infos = self._nothing.copy()
            for row, final in zip(rows, self._observed(arrived[rows], self._last[rows]), strict=True):
                cut = bool(truncated[row] and not terminated[row])
                infos[row] = {"terminal_observation": final, "TimeLimit.truncated": cut}
            self._last[rows] = 0.0
        return self._observed(y, self._last), rewards.astype(np.float32), done, infos

    def _observed(self, y: Any, last: Array) -> Any:
        if not self._own:
            return np.asarray(y, dtype=np.float32)
        return observe(y, self._scales, last if self._action_rate else None).astype(np.float32)

    def close(self) -> None:
        """Close the environments."""
        self._envs.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of every copy; here, that there is nothing to render."""
        if attr_name == "render_mode":
            return [None] * self.num_envs
        raise AttributeError(attr_name)

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refuse: copies have no attributes of their own."""
        raise AttributeError(attr_name)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Refuse: copies have no methods of their own."""
        raise AttributeError(method_name)

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Return that no copy is wrapped."""
        return [False] * self.num_envs


class MirroredBuffer(ReplayBuffer):
    r"""A replay buffer that returns a transition or, as often, its mirror image: that of :math:`-x` and :math:`-a`."""

    def _get_samples(self, batch_inds: Any, env: Any = None) -> ReplayBufferSamples:
        samples = super()._get_samples(batch_inds, env)
        signs = torch.randint(2, (len(batch_inds), 1)) * 2.0 - 1.0
        even = torch.zeros(samples.observations.shape[1], dtype=torch.bool)
        even[[2, 4]] = True  # the cosines

        def mirrored(observations: torch.Tensor) -> torch.Tensor:
            return torch.where(even, observations, signs * observations)

        return samples._replace(
            observations=mirrored(samples.observations),
            actions=signs * samples.actions,
            next_observations=mirrored(samples.next_observations),
        )


class PairedBuffer(RolloutBuffer):
    """PPO's buffer, where each observation comes with the next of its episode, or with itself at the end."""

    def get(self, batch_size: int | None = None) -> Iterator[RolloutBufferSamples]:  # type: ignore[override]
        """Return shuffled batches."""
        if not self.generator_ready:
            following = np.roll(self.observations, -1, axis=0)
            over = np.roll(self.episode_starts, -1, axis=0) > 0
            over[-1] = True
            following[over] = self.observations[over]
            self._following = self.swap_and_flatten(following)
        yield from super().get(batch_size)

    def _get_samples(self, batch_inds: Any, env: Any = None) -> RolloutBufferSamples:
        samples = super()._get_samples(batch_inds, env)
        pairs = torch.cat((samples.observations, self.to_torch(self._following[batch_inds])), dim=1)
        return samples._replace(observations=pairs)


class CAPSPolicy(ActorCriticPolicy):
    r"""PPO's actor and critic, with minus the loss of CAPS in the place of the entropy, whose weight must be one.

    .. math:: L = \lambda_T\,|\pi(o_t) - \pi(o_{t+1})| + \lambda_S\,|\pi(o_t) - \pi(o_t + \epsilon)|

    Source: S. Mysore et al., *Regularizing action policies for smooth control with reinforcement learning*, ICRA 2021.
    """

    def __init__(self, *args: Any, caps: tuple[float, float, float], **kwargs: Any) -> None:
        self._caps = caps
        super().__init__(*args, **kwargs)

    def evaluate_actions(self, obs: Any, actions: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return values, log-probabilities, and minus the loss of CAPS, for pairs of observations."""
        now, following = obs.chunk(2, dim=1)
        values, log_prob, _ = super().evaluate_actions(now, actions)
        temporal, spatial, deviation = self._caps
        near = now + deviation * torch.randn_like(now)
        here, there, then = self._mean(torch.cat((now, near, following))).chunk(3)
        loss = spatial * (here - there).abs() + temporal * (here - then).abs()
        return values, log_prob, -loss.sum(dim=1)

    def _mean(self, observations: torch.Tensor) -> torch.Tensor:
        return self.action_net(self.mlp_extractor.forward_actor(observations)).clamp(-1.0, 1.0)


class _Normalised:
    """Critics whose hidden layers are normalised before they are activated."""

    def make_critic(self: Any, features_extractor: Any = None) -> ContinuousCritic:
        """Return a critic."""
        critic = super().make_critic(features_extractor)  # type: ignore[misc]  # of the policy that it is mixed into
        width = int(np.prod(self.observation_space.shape)) + int(np.prod(self.action_space.shape))
        for i in range(len(critic.q_networks)):
            layers = create_mlp(width, 1, list(self.net_arch), torch.nn.ReLU, post_linear_modules=[torch.nn.LayerNorm])
            critic.q_networks[i] = torch.nn.Sequential(*layers)
            critic.add_module(f"qf{i}", critic.q_networks[i])
        return critic


class NormalisedTD3Policy(_Normalised, TD3Policy):
    """Actor and critics of DDPG and TD3, with layer normalisation in the critics."""


class NormalisedSACPolicy(_Normalised, SACPolicy):
    """Actor and critics of SAC, with layer normalisation in the critics."""


class Learner:
    """A model of Stable-Baselines3 in the environments of a recipe."""

    def __init__(self, recipe: DeepRecipe, seed: int) -> None:
        torch.set_num_threads(1)
        self._recipe = recipe
        self._seed = seed
        self._env = Copies(training_envs(recipe), recipe)
        self._model = self._built()

    def _built(self) -> Any:
        recipe = self._recipe
        net: dict[str, Any] = {"net_arch": list(recipe.net)}
        if recipe.algo == "ppo":
            caps = recipe.ppo.caps if any(recipe.ppo.caps or ()) else None
            return PPO(
                CAPSPolicy if caps else "MlpPolicy",
                self._env,
                n_steps=ROLLOUT,
                n_epochs=max(round(recipe.updates * recipe.batch), 1),
                gae_lambda=0.95,
                target_kl=recipe.ppo.target_kl,
                ent_coef=1.0 if caps else 0.0,
                rollout_buffer_class=PairedBuffer if caps else None,
                policy_kwargs=net | {"log_std_init": float(np.log(recipe.noise))} | ({"caps": caps} if caps else {}),
                **self._shared(),
            )
        normalised: Any = NormalisedSACPolicy if recipe.algo == "sac" else NormalisedTD3Policy
        model = {"ddpg": DDPG, "td3": TD3, "sac": SAC}[recipe.algo](
            normalised if recipe.off_policy.layer_norm else "MlpPolicy",
            self._env,
            policy_kwargs=net | {"optimizer_kwargs": {"fused": True}},  # the same steps, an eighth sooner
            **self._shared(),
            **self._off_policy(),
        )
        actor = model.policy.actor
        with torch.no_grad():
            if isinstance(model, SAC):
                actor.mu.weight *= recipe.off_policy.first_actions
            else:
                for one in (actor, model.policy.actor_target):
                    one.mu[-2].weight *= recipe.off_policy.first_actions
        return model

    def _shared(self) -> dict[str, Any]:
        """Return the options of all algorithms."""
        recipe = self._recipe
        first, last = recipe.learning_rate

        def learning_rate(_: float) -> float:
            done = min(self._model.num_timesteps / recipe.steps, 1.0) if hasattr(self, "_model") else 0.0
            return first + (last - first) * done

        return {
            "learning_rate": learning_rate,
            "batch_size": recipe.batch,
            "gamma": recipe.gamma,
            "seed": self._seed,
            "device": "cpu",
        }

    def _off_policy(self) -> dict[str, Any]:
        """Return the options of DDPG, TD3 and SAC."""
        recipe = self._recipe
        size = int(np.prod(self._env.action_space.shape or ()))
        return {
            "buffer_size": recipe.steps,
            "learning_starts": min(_WARM_UP, recipe.steps // 10),
            "train_freq": 1,
            "gradient_steps": max(round(recipe.updates * recipe.copies), 1),
            "action_noise": None
            if recipe.algo == "sac"
            else NormalActionNoise(np.zeros(size), np.full(size, recipe.noise)),
            "replay_buffer_class": MirroredBuffer if recipe.off_policy.mirror else None,
        }

    @property
    def steps(self) -> int:
        """Environment steps so far."""
        return self._model.num_timesteps

    def learn(self, steps: int) -> None:
        """Take so many environment steps, or the next number that fills a round, and learn from them."""
        self._env.grown = min(2 * (self.steps + steps) / self._recipe.steps, 1.0)
        self._model.learn(steps, reset_num_timesteps=False)

    def act(self, observations: Any) -> Any:
        """Return the model's own deterministic actions, within -1 and 1."""
        return self._model.predict(observations, deterministic=True)[0]

    def network(self) -> Network:
        """Return the actor as plain arrays."""
        policy = self._model.policy
        if self._recipe.algo == "ppo":
            layers, activation, squash = [*policy.mlp_extractor.policy_net, policy.action_net], "tanh", "clip"
        else:
            mean = policy.actor.mu
            layers = [*policy.actor.latent_pi, mean] if self._recipe.algo == "sac" else [*mean]
            activation, squash = "relu", "tanh"
        linear = [layer for layer in layers if isinstance(layer, torch.nn.Linear)]
        weights, biases = ([getattr(layer, name).detach().numpy() for layer in linear] for name in ("weight", "bias"))
        return Network(weights, biases, activation=activation, squash=squash)

    def save(self, path: Path, beside: dict[str, Any]) -> None:
        """Write all that is needed to go on, to the end or not at all; ``beside`` holds arrays, numbers and words."""
        model = self._model
        state: dict[str, Any] = {
            "steps": model.num_timesteps,
            "updates": model._n_updates,
            "learned": self._learned(),
            "beside": plain(beside),
        }
        if isinstance(model, OffPolicyAlgorithm):
            buffer = cast(Any, model.replay_buffer)
            filled = buffer.buffer_size if buffer.full else buffer.pos
            state["replay"] = {name: torch.from_numpy(getattr(buffer, name)[:filled]) for name in _REPLAY}
            state["place"] = (buffer.pos, buffer.full)
        with atomic(path) as part:
            torch.save(state, part)

    def restore(self, path: Path) -> dict[str, Any]:
        """Go on from what :meth:`save` wrote, in new episodes; return what was saved beside it."""
        state = torch.load(path, weights_only=True)
        model = self._model
        model.num_timesteps = state["steps"]
        model._n_updates = state["updates"]
        self._learn_again(state["learned"])
        if isinstance(model, OffPolicyAlgorithm):
            buffer = cast(Any, model.replay_buffer)
            for name in _REPLAY:
                getattr(buffer, name)[: len(state["replay"][name])] = state["replay"][name].numpy()
            buffer.pos, buffer.full = state["place"]
        # Not the random numbers of the first time once more.
        model.set_random_seed((self._seed + 7919 * state["steps"]) % 2**31)
        return arrays(state["beside"])

    def _learned(self) -> dict[str, Any]:
        """Return all that updates have changed."""
        model = self._model
        learned = model.get_parameters()
        if isinstance(model, SAC) and model.log_ent_coef is not None:
            learned["entropy"] = model.log_ent_coef.detach()
        return learned

    def _learn_again(self, learned: dict[str, Any]) -> None:
        """Load what :meth:`_learned` returned."""
        entropy = learned.pop("entropy", None)
        self._model.set_parameters(learned, device="cpu")
        if entropy is not None:
            self._model.log_ent_coef.data.copy_(entropy)


_REPLAY = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


def plain(thing: Any) -> Any:
    """Return what torch reads back without running code: tensors, numbers, words, and lists and dicts of them."""
    if isinstance(thing, dict):
        return {key: plain(value) for key, value in thing.items()}
    if isinstance(thing, list | tuple):
        return [plain(value) for value in thing]
    if isinstance(thing, np.ndarray):
        return torch.from_numpy(thing.copy()) if thing.dtype.kind in "fi" else str(thing)
    return thing


def arrays(thing: Any) -> Any:
    """Return the same with arrays in place of tensors."""
    if isinstance(thing, dict):
        return {key: arrays(value) for key, value in thing.items()}
    if isinstance(thing, list):
        return [arrays(value) for value in thing]
    return thing.numpy() if isinstance(thing, torch.Tensor) else thing
