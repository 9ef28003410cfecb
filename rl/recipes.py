r"""Recipes of deep reinforcement learning: everything that a training depends on but its seed, and its environments.

:mod:`rl.deep` follows them; what is seen and rewarded is stated in :mod:`dpend.shaping`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Literal, Optional, TypeVar

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

import dpend
from dpend.arguments import checked_positive
from dpend.rig import Rig, as_rig
from dpend.shaping import LONGEST_HOLD, Mixture
from dpend.suggest import suggests
from dpend.tasks import Balance, SwingUp
from dpend.vector_env import CartDoublePendulumVectorEnv

from .settings import (
    Angle,
    Flag,
    Nonnegative,
    Portion,
    Positive,
    Share,
    Whole,
    check_settings,
    instance_of,
    known,
    must,
    numbers,
)

Value = TypeVar("Value")
if TYPE_CHECKING:
    Filled = Annotated[Value, "None until the default is filled in"]
else:
    Filled = Optional  # where a recipe is built; where one is read there is a value
_DEFAULT: Any = None
Widths = Annotated[tuple[int, ...], must("one or more widths, at least 1", lambda net: len(net) > 0 and min(net) >= 1)]
Rates = Annotated[tuple[float, float], numbers("two numbers above 0", 2, lambda rate: rate > 0)]
Caps = Annotated[tuple[float, float, float], numbers("three numbers, at least 0", 3, lambda each: each >= 0)]

NEEDED: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"torch": ("torch", "stable_baselines3"), "jax": ("torch", "stable_baselines3", "jax", "sbx")}
)
"""What must be installed for a training, by ``DeepRecipe.library``."""

INSTALL: Mapping[str, str] = MappingProxyType(
    {
        "torch": "Deep learners need torch and Stable-Baselines3, the extra `deep`: pip install -e '.[deep]'",
        "jax": "Deep learners in JAX need SBX and Stable-Baselines3, the extra `jax`: pip install -e '.[jax]'",
    }
)
"""What to do where something of it is missing."""

EPISODE = 10.0
"""Length of a swing-up that is evaluated, and of an episode where a recipe leaves it out, s."""

ROLLOUT = 64
"""Steps that PPO takes in every copy between two rounds of updates."""


def _defaults(*values: Any) -> dict[str, Any]:
    names = "steps", "copies", "batch", "learning_rate", "updates", "noise", "evaluate_every"
    return dict(zip(names, values, strict=True))


_OFF_POLICY = _defaults(300_000, 16, 256, (1e-3, 1e-4), 0.5, 0.2, 10_000)
DEFAULTS: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {"ppo": _defaults(8_000_000, 512, 1024, (1e-3, 5e-5), 4 / 1024, math.exp(-0.5), 262_144)}
    | dict.fromkeys(("ddpg", "td3", "sac"), _OFF_POLICY)
)
"""What a recipe takes for settings that are left out, by algorithm."""


@suggests
@dataclass(frozen=True, kw_only=True)
class PPOSettings:
    """What only PPO knows."""

    target_kl: Positive | None = None
    """A round of updates ends early where they have moved the policy by 1.5 times this Kullback-Leibler divergence,
    nats; left out, never."""
    caps: Caps | None = None
    """Conditioning for action policy smoothness (Mysore et al. 2021) in the loss: weights of the temporal and of the
    spatial term, and the standard deviation of the spatial one."""

    def __post_init__(self) -> None:
        check_settings(self)


@suggests
@dataclass(frozen=True, kw_only=True)
class OffPolicySettings:
    """What only DDPG, TD3 and SAC know."""

    first_actions: Portion = 1.0
    """Factor on the last layer of the actor before anything is learned; a small one begins with hardly any force, as
    the DDPG paper does."""
    library: Annotated[Literal["torch", "jax"], known(NEEDED)] = "torch"
    """What computes: Stable-Baselines3 in torch, or its sibling SBX in JAX, the same algorithms compiled."""
    layer_norm: Flag = True
    """Whether the critics normalise their layers."""
    mirror: Flag = False
    """Whether to learn from transitions and their mirror images, each half the time; plant and reward know no side."""

    def __post_init__(self) -> None:
        check_settings(self)


@suggests
@dataclass(frozen=True, kw_only=True, eq=False)
class DeepRecipe:
    r"""All that a deep training depends on but its seed.

    What is left out, or None, is the algorithm's own, from ``rl.recipes.DEFAULTS``, or follows from the task; zero is
    zero.

    Parameters
    ----------
    rig : Rig or str
        A single one with a force limit, or the name of a preset.
    algo : {"ppo", "ddpg", "td3", "sac"}
        The algorithm.
    task : {"swing-up", "balance"}
        What to learn.
    env : str, optional
        A Gymnasium environment of another plant with continuous actions, such as ``"InvertedDoublePendulum-v5"``, in
        place of task and rig, with its own observation and reward.  What is learned is then a network
        from its observations to actions, -1 and 1 being the ends of their range.
    starts : {"mixed", "rest"}
        Where episodes of the swing-up begin: hanging, horizontal to the side, near upright or anywhere, each equally
        often; or at rest alone, hanging or horizontal to the side.
    near : float
        Greatest angle of those near upright, rad; for mixed starts of the swing-up alone.
    steps : int
        Environment steps in all copies together.
    copies : int
        Environments side by side.
    net : tuple of int
        Widths of the hidden layers, of actor and critic alike.
    batch : int
        Transitions in an update.
    learning_rate : (float, float)
        At the beginning and at the end, falling in a straight line.
    updates : float
        Updates for each environment step.
    gamma : float
        Discount factor.
    noise : float
        Standard deviation of the actions at first (PPO) or of what is added to them (DDPG, TD3), in shares of the force
        limit.
    period : float
        How long a force is held, s; a whole number of samples.  Left out, the greatest up to 0.04 s for the swing-up
        and one sample for balancing.
    episode : float
        How long an episode lasts at most while learning, s; left out, 10 s of the swing-up and the task's own of
        balancing.  Evaluations last as long as ever.
    action_rate : float
        Weight w of the penalty ``w |a_t - a_{t-1}|`` near upright, which grows from nothing to this in the first half
        of the steps, at each evaluation; the last action is then observed.
    sensor_noise : float, optional
        Standard deviation of noise on every measured state while learning (m, rad, m/s, rad/s), in place of the rig's
        own.  Evaluations are on the rig as it is.
    evaluate_every : int
        Environment steps between evaluations.
    evaluation_starts : int
        Starts of an evaluation, the same at each.
    enough : float, optional
        Share of success in an evaluation that ends the training; left out, all steps are taken.
    ppo : PPOSettings
        What PPO alone knows.
    off_policy : OffPolicySettings
        What DDPG, TD3 and SAC alone know.

    Raises
    ------
    TypeError, ValueError
        If a value is of the wrong kind or out of its range; the message says what was expected.

    See Also
    --------
    rl.train_deep : Follow it.

    Examples
    --------
    >>> from rl import DeepRecipe
    >>> DeepRecipe(rig="gustafsson2016", algo="ddpg").steps
    300000
    """

    rig: Rig = field(default_factory=lambda: dpend.rig("gustafsson2016"), kw_only=False)
    algo: Annotated[Literal["ppo", "ddpg", "td3", "sac"], known(DEFAULTS)] = "ppo"
    task: Annotated[Literal["swing-up", "balance"], known(("swing-up", "balance"))] = "swing-up"
    env: Annotated[str, instance_of(str)] | None = None
    starts: Annotated[Literal["mixed", "rest"], known(("mixed", "rest"))] = "mixed"
    near: Angle = 0.1
    steps: Filled[Whole] = _DEFAULT
    copies: Filled[Whole] = _DEFAULT
    net: Widths = (64, 64)
    batch: Filled[Whole] = _DEFAULT
    learning_rate: Filled[Rates] = _DEFAULT
    updates: Filled[Positive] = _DEFAULT
    gamma: Annotated[float, must("between 0 and 1", lambda gamma: 0 < gamma < 1)] = 0.99
    noise: Filled[Nonnegative] = _DEFAULT
    period: Filled[Positive] = _DEFAULT
    episode: Filled[Positive] = _DEFAULT
    action_rate: Nonnegative = 0.0
    sensor_noise: Nonnegative | None = None
    evaluate_every: Filled[Whole] = _DEFAULT
    evaluation_starts: Whole = 400
    enough: Share | None = None
    ppo: Annotated[PPOSettings, instance_of(PPOSettings)] = PPOSettings()
    off_policy: Annotated[OffPolicySettings, instance_of(OffPolicySettings)] = OffPolicySettings()

    def __post_init__(self) -> None:
        check_settings(self)
        object.__setattr__(self, "rig", as_rig(self.rig))
        self._fill(**DEFAULTS[self.algo])
        if self.algo == "ppo":
            checked_positive("noise", self.noise)
        if not self.env:
            self._check_plant()
        self._check_own()
        if self.near != type(self).near and (self.env or self.task != "swing-up" or self.starts != "mixed"):
            raise ValueError(
                f"near is for mixed starts of the swing-up; got {self.starts!r} of {self.env or self.task!r}."
            )

    def _fill(self, **defaults: Any) -> None:
        for name, value in defaults.items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, value)

    def _check_plant(self) -> None:
        """Refuse rigs, periods and episodes that do not go together."""
        rig = self.rig
        if rig.n is not None:
            raise ValueError(f"A recipe has one rig; this one describes {rig.n} rows.")
        if not np.isfinite(rig.force_limit):
            raise ValueError(
                "Actions are shares of the force limit: expected a finite one; got inf. "
                "Set it with rig.replace(force_limit=...), in N."
            )
        swing = self.task == "swing-up"
        longest = LONGEST_HOLD if swing and rig.ideal else rig.sample_time
        self._fill(
            period=max(int(longest / rig.sample_time + 1e-9), 1) * rig.sample_time,
            episode=EPISODE if swing else Balance().steps * rig.sample_time,
        )
        if abs(self.samples * rig.sample_time - self.period) > 1e-9 or self.samples < 1:
            raise ValueError(
                f"period must be a whole number of samples of {rig.sample_time:g} s; got {self.period:g} s."
            )
        if self.samples > 1 and not rig.ideal:
            raise ValueError(
                "Forces can be held for several samples on ideal rigs only; got one with lag, delay, noise or "
                f"rounding: expected period = {rig.sample_time:g} s, the sample time."
            )

    def _check_own(self) -> None:
        """Refuse settings that this algorithm, or another environment, does not know."""
        holder, whose = ("off_policy", "DDPG, TD3 and SAC") if self.algo == "ppo" else ("ppo", "PPO")
        strange = getattr(self, holder)
        for each in fields(strange):
            if getattr(strange, each.name) != each.default:
                remedy = {"caps": " Use action_rate.", "first_actions": " Use noise."}.get(each.name, "")
                raise ValueError(f"{each.name} is for {whose}; got algo {self.algo!r}.{remedy}")
        for name in ("episode", "action_rate", "sensor_noise"):
            if self.env and getattr(self, name):
                raise ValueError(f"{name} is for our own plant; got env {self.env!r}.")
        if self.env and self.off_policy.mirror:
            raise ValueError(f"mirror is for our own plant; got env {self.env!r}.")

    @property
    def library(self) -> Literal["torch", "jax"]:
        """What the training computes with."""
        return "torch" if self.algo == "ppo" else self.off_policy.library

    @property
    def samples(self) -> int:
        """Samples of the rig that a force is held for."""
        return round(self.period / self.rig.sample_time)

    @property
    def round(self) -> int:
        """Environment steps that are taken at once, in all copies together."""
        return self.copies * (ROLLOUT if self.algo == "ppo" else 1)

    @property
    def name(self) -> str:
        """What is learned by what, for folders and tables."""
        parts = [self.algo, self.env or self.task]
        parts += ["rest"] * (self.starts == "rest" and not self.env)
        parts += ["smooth"] * bool(self.action_rate or any(self.ppo.caps or ()))
        return "-".join(parts).lower()

    def to_dict(self) -> dict[str, Any]:
        """Return all settings that this algorithm knows as plain values, for records.

        Settings of other algorithms are left out.

        Returns
        -------
        dict
            By name, as JSON can hold them.

        See Also
        --------
        rl.DeepRecipe : The settings.

        Examples
        --------
        >>> from rl import DeepRecipe
        >>> DeepRecipe(algo="ppo").to_dict()["algo"]
        'ppo'
        """
        own = self.ppo if self.algo == "ppo" else self.off_policy
        plain = {each.name: getattr(self, each.name) for each in fields(DeepRecipe)} | vars(own)
        del plain["ppo"], plain["off_policy"]
        return plain | {"rig": self.rig.to_dict()}

    @classmethod
    def from_dict(cls, record: Mapping[str, Any]) -> DeepRecipe:
        """Build a recipe from what :meth:`to_dict` returned, whatever its age; lists stand for tuples.

        Records from before None meant default hold the settings of all algorithms, and zeros for what was left out.
        """
        settings: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value for name, value in record.items()
        }
        if {"caps", "layer_norm"} <= settings.keys():
            settings |= {name: settings.get(name) or None for name in _ZERO_WAS_NONE}
            if not any(settings["caps"] or ()):
                settings["caps"] = None
        for kind in (PPOSettings, OffPolicySettings):
            own = {each.name: settings.pop(each.name) for each in fields(kind) if each.name in settings}
            if (kind is PPOSettings) == (settings.get("algo", "ppo") == "ppo"):
                settings["ppo" if kind is PPOSettings else "off_policy"] = kind(**own)
        settings["rig"] = Rig.from_dict(record["rig"])
        return cls(**settings)


_ZERO_WAS_NONE = ("env", "period", "episode", "target_kl", "caps", "sensor_noise", "enough")


def training_envs(recipe: DeepRecipe) -> gym.vector.VectorEnv[Any, Any, Any]:
    """Return the environments that a recipe is trained in: copies that start again in the step that ends an episode."""
    if recipe.env:
        return gym.make_vec(
            recipe.env,
            num_envs=recipe.copies,
            vectorization_mode="sync",
            vector_kwargs={"autoreset_mode": AutoresetMode.SAME_STEP},
        )
    # Holding a force for k samples is sampling k times more slowly, with as many substeps.
    rig = recipe.rig
    slow = rig.replace(
        sample_time=recipe.period,
        substeps=rig.substeps * recipe.samples,
        sensor_noise=rig.sensor_noise if recipe.sensor_noise is None else recipe.sensor_noise,
    )
    if recipe.task == "balance":
        task: Balance | SwingUp = Balance(lam=0.4)
        mixture: Sequence[Balance | SwingUp] = [task]
    else:
        task = SwingUp()
        mixture = [SwingUp(start=start, angle_spread=0.1) for start in ("hanging", "side")]
        if recipe.starts == "mixed":
            mixture = [*mixture, Balance(lam=recipe.near), SwingUp(start="anywhere")]
    mixed = Mixture(task=task, mixture=mixture, steps=max(round(recipe.episode / recipe.period), 1))
    return CartDoublePendulumVectorEnv(
        mixed, slow, recipe.copies, reward="shaped", autoreset_mode=AutoresetMode.SAME_STEP
    )
