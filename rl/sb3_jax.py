# pyright: reportMissingImports=false
r"""SBX at work: DDPG, TD3 and SAC in JAX, on the environments and with the replay of :mod:`rl.sb3`.

SBX has the algorithms of Stable-Baselines3 with compiled updates.  :mod:`rl.deep` imports this file when a recipe's
library is ``"jax"``.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false")  # matrices so small gain nothing from threads

import jax
import numpy as np
import optax
import sbx
from flax import serialization
from flax.training.train_state import TrainState
from sbx.common.off_policy_algorithm import OffPolicyAlgorithmJax

from . import sb3
from .policies import Network

_adam = optax.inject_hyperparams(optax.adam)  # whose rate can be set at any time


def _states(model: Any) -> dict[str, Any]:
    """Return all of a model that learns, by the names of its attributes."""
    states = {"actor_state": model.policy.actor_state, "qf_state": model.policy.qf_state}
    if hasattr(model, "ent_coef_state"):
        states["ent_coef_state"] = model.ent_coef_state
    return states


class _Falling(OffPolicyAlgorithmJax):
    """Sets the current rate of everything that learns; else DDPG, TD3 and SAC's entropy weight keep the first."""

    def train(self, gradient_steps: int, batch_size: int) -> None:
        rate = self.lr_schedule(self._current_progress_remaining)
        self._update_learning_rate([state.opt_state for state in _states(self).values()], rate)
        super().train(gradient_steps, batch_size)


class _DDPG(_Falling, sbx.DDPG): ...


class _TD3(_Falling, sbx.TD3): ...


class _SAC(_Falling, sbx.SAC):
    def _setup_model(self) -> None:
        super()._setup_model()
        self.ent_coef_state = TrainState.create(
            apply_fn=self.ent_coef.apply, params=self.ent_coef_state.params, tx=_adam(self.lr_schedule(1))
        )


class Learner(sb3.Learner):
    """A model of SBX in its environments; what is public is that of :class:`rl.sb3.Learner`."""

    def _built(self) -> Any:
        recipe, shared = self._recipe, self._shared()
        own: dict[str, Any] = {"net_arch": list(recipe.net), "layer_norm": recipe.off_policy.layer_norm}
        if recipe.algo != "sac":
            own["optimizer_class"] = _adam  # SAC makes its Adam so itself
        algorithm: Any = {"ddpg": _DDPG, "td3": _TD3, "sac": _SAC}[recipe.algo]
        model = algorithm(
            "MlpPolicy", self._env, qf_learning_rate=None, policy_kwargs=own, **shared, **self._off_policy()
        )
        state, last = model.policy.actor_state, f"Dense_{len(recipe.net)}"

        def first(parameters: Any) -> Any:
            layers = parameters["params"]
            layer = layers[last] | {"kernel": recipe.off_policy.first_actions * layers[last]["kernel"]}
            return parameters | {"params": layers | {last: layer}}

        model.policy.actor_state = state.replace(params=first(state.params))
        if recipe.algo != "sac":
            model.policy.actor_state = model.policy.actor_state.replace(target_params=first(state.target_params))
        return model

    def network(self) -> Network:
        """Return the actor as plain arrays."""
        layers = self._model.policy.actor_state.params["params"]
        dense = [
            layers[f"Dense_{i}"] for i in range(len(self._recipe.net) + 1)
        ]  # SAC's standard deviation has one more
        return Network(
            [np.transpose(layer["kernel"]) for layer in dense],
            [np.asarray(layer["bias"]) for layer in dense],
            activation="relu",
            squash="tanh",
        )

    def restore(self, path: Path) -> dict[str, Any]:
        """Go on from what :meth:`rl.sb3.Learner.save` wrote, in new episodes; return what was saved beside it."""
        beside = super().restore(path)
        self._model.policy.key = jax.random.fold_in(self._model.key, 0)  # which SAC explores with
        return beside

    def _learned(self) -> dict[str, Any]:
        states = {name: serialization.to_state_dict(state) for name, state in _states(self._model).items()}
        return sb3.plain(jax.tree.map(np.asarray, states))

    def _learn_again(self, learned: dict[str, Any]) -> None:
        for name, state in _states(self._model).items():
            owner = self._model if name == "ent_coef_state" else self._model.policy
            setattr(owner, name, serialization.from_state_dict(state, sb3.arrays(learned[name])))
