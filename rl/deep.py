r"""Deep reinforcement learning: PPO, DDPG, TD3 and SAC of Stable-Baselines3 and SBX on the native vector environment.

A :class:`DeepRecipe` says everything that a training depends on but its seed; :func:`train_deep` follows it.  What is
seen and rewarded is stated in :mod:`rl.shaping`.  ``docs/deep-rl.md`` lists settings, deviations and results.
"""

from __future__ import annotations

import csv
import io
import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from importlib import metadata
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

import dpend
from dpend.controller import Controller
from dpend.metrics import force_metrics
from dpend.params import Array
from dpend.provenance import versions
from dpend.rig import Rig, as_rig
from dpend.simulate import checked_seed, simulate_many
from dpend.suggest import suggestion, suggests
from dpend.tasks import Balance, SwingUp
from dpend.vector_env import CartDoublePendulumVectorEnv

from .policies import MLPPolicy, Network
from .shaping import Shaped, observation_scales

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
"""Length of a swing-up that is evaluated, and of an episode where a recipe is told nothing, s."""

_LONGEST_HOLD = 0.04  # s
_EVALUATION_STREAM = 7159  # sets the starts of evaluation apart from others drawn with the same seed
_OFF_POLICY: dict[str, Any] = {
    "steps": 300_000,
    "copies": 16,
    "batch": 256,
    "learning_rate": (1e-3, 1e-4),
    "updates": 0.5,
    "noise": 0.2,
    "evaluate_every": 10_000,
}
DEFAULTS: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "ppo": {
            "steps": 8_000_000,
            "copies": 512,
            "batch": 1024,
            "learning_rate": (1e-3, 5e-5),
            "updates": 4 / 1024,
            "noise": math.exp(-0.5),
            "evaluate_every": 262_144,
        },
        "ddpg": _OFF_POLICY,
        "td3": _OFF_POLICY,
        "sac": _OFF_POLICY,
    }
)
"""What a recipe takes where it is told nothing, by algorithm."""


@suggests
@dataclass(frozen=True, kw_only=True, eq=False)
class DeepRecipe:
    r"""All that a deep training depends on but its seed.

    A number left at zero is the algorithm's own, from ``rl.deep.DEFAULTS``.

    Parameters
    ----------
    algo : {"ppo", "ddpg", "td3", "sac"}
        The algorithm.
    task : {"swing-up", "balance"}
        What to learn.
    rig : Rig
        A single one with a force limit; left out, the preset ``gustafsson2016``.
    env : str
        A Gymnasium environment of another plant with continuous actions, such as ``"InvertedDoublePendulum-v5"``, in
        place of task and rig, with its own observation and reward; none where empty.  What is learned is then a network
        from its observations to actions, -1 and 1 being the ends of their range.
    starts : {"mixed", "rest"}
        Where episodes of the swing-up begin: hanging, level to the side, near upright or anywhere, each equally often;
        or at rest alone, hanging or level to the side.
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
    target_kl : float
        PPO ends a round of updates early where they have moved it by 1.5 times this Kullback-Leibler divergence, nats;
        at zero, never.
    period : float
        How long a force is held, s; a whole number of samples.  At zero, the greatest up to 0.04 s for the swing-up and
        one sample for balancing.
    episode : float
        How long an episode lasts at most while learning, s; at zero, 10 s of the swing-up and the task's own of
        balancing.  Evaluations last as long as ever.
    first_actions : float
        Factor on the last layer of the actor of DDPG, TD3 and SAC before anything is learned; a small one begins with
        hardly any force, as the DDPG paper does.
    action_rate : float
        Weight w of the penalty w |a_t - a_{t-1}| near upright, which grows from nothing to this in the first half of
        the steps, at each evaluation; the last action is then observed.
    sensor_noise : float
        Standard deviation of noise on every measured state while learning (m, rad, m/s, rad/s), in place of the rig's
        own; at zero, the rig's own.  Evaluations are on the rig as it is.
    caps : (float, float, float)
        Conditioning for action policy smoothness (Mysore et al. 2021) in PPO's loss: weights of the temporal and of
        the spatial term, and the standard deviation of the spatial one.
    library : {"torch", "jax"}
        What DDPG, TD3 and SAC compute with: Stable-Baselines3 in torch, or its sibling SBX in JAX, the same algorithms
        compiled.
    layer_norm : bool
        Whether the critics of DDPG, TD3 and SAC normalise their layers; PPO's never does.
    mirror : bool
        Whether DDPG, TD3 and SAC learn from transitions and their mirror images, each half the time; the plant and the
        reward know no left and right.
    evaluate_every : int
        Environment steps between evaluations.
    evaluation_starts : int
        Starts of an evaluation, the same at each.
    enough : float
        Share of success in an evaluation that ends the training; at zero, all steps are taken.

    Raises
    ------
    TypeError, ValueError
        If a value is of the wrong kind or out of its range; the message says what was expected.
    """

    algo: Literal["ppo", "ddpg", "td3", "sac"] = "ppo"
    task: Literal["swing-up", "balance"] = "swing-up"
    rig: Rig = field(default_factory=lambda: dpend.rig("gustafsson2016"))
    env: str = ""
    starts: Literal["mixed", "rest"] = "mixed"
    near: float = 0.1
    steps: int = 0
    copies: int = 0
    net: tuple[int, ...] = (64, 64)
    batch: int = 0
    learning_rate: tuple[float, float] = (0.0, 0.0)
    updates: float = 0.0
    gamma: float = 0.99
    noise: float = 0.0
    target_kl: float = 0.0
    period: float = 0.0
    episode: float = 0.0
    first_actions: float = 1.0
    action_rate: float = 0.0
    sensor_noise: float = 0.0
    caps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    library: Literal["torch", "jax"] = "torch"
    layer_norm: bool = True
    mirror: bool = False
    evaluate_every: int = 0
    evaluation_starts: int = 400
    enough: float = 0.0

    def __post_init__(self) -> None:
        for name, known in (
            ("algo", DEFAULTS),
            ("task", ("swing-up", "balance")),
            ("starts", ("mixed", "rest")),
            ("library", NEEDED),
        ):
            value = getattr(self, name)
            if value not in known:
                raise ValueError(f"There is no {name} {value!r}.{suggestion(str(value), known)}")
        for name, value in DEFAULTS[self.algo].items():
            if not np.any(getattr(self, name)):
                object.__setattr__(self, name, value)
        object.__setattr__(self, "layer_norm", bool(self.layer_norm) and self.algo != "ppo")
        rig = as_rig(self.rig)
        object.__setattr__(self, "rig", rig)
        if not self.env:
            if rig.n is not None:
                raise ValueError(f"A recipe has one rig; this one describes {rig.n} rows.")
            if not np.isfinite(rig.force_limit):
                raise ValueError(
                    "Actions are shares of the force limit: expected a finite one; got inf. "
                    "Set it with rig.replace(force_limit=...), in N."
                )
            if not self.period:
                longest = _LONGEST_HOLD if self.task == "swing-up" and rig.ideal else rig.sample_time
                object.__setattr__(self, "period", max(int(longest / rig.sample_time + 1e-9), 1) * rig.sample_time)
            if abs(self.samples * rig.sample_time - self.period) > 1e-9 or self.samples < 1:
                raise ValueError(
                    f"period must be a whole number of samples of {rig.sample_time:g} s; got {self.period:g} s."
                )
            if self.samples > 1 and not rig.ideal:
                raise ValueError(
                    "Forces can be held for several samples on ideal rigs only; got one with lag, delay, noise or "
                    f"rounding: expected period = {rig.sample_time:g} s, the sample time."
                )
            if not self.episode:
                seconds = EPISODE if self.task == "swing-up" else Balance().steps * rig.sample_time
                object.__setattr__(self, "episode", seconds)
        for name in ("steps", "copies", "batch", "evaluate_every", "evaluation_starts"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < 1:
                raise ValueError(f"{name} must be a whole number, at least 1; got {value!r}.")
        for name, good, wanted in (
            ("learning_rate", min(self.learning_rate) > 0 and len(self.learning_rate) == 2, "two numbers above 0"),
            ("updates", 0 < self.updates < math.inf, "greater than 0"),
            ("gamma", 0 < self.gamma < 1, "between 0 and 1"),
            ("noise", 0 < self.noise < math.inf, "greater than 0"),
            ("target_kl", 0 <= self.target_kl < math.inf, "at least 0"),
            ("near", 0 < self.near <= math.pi / 2, "above 0, at most π/2"),
            ("episode", 0 <= self.episode < math.inf, "at least 0"),
            ("first_actions", 0 < self.first_actions <= 1, "above 0, at most 1"),
            ("action_rate", 0 <= self.action_rate < math.inf, "at least 0"),
            ("sensor_noise", 0 <= self.sensor_noise < math.inf, "at least 0"),
            ("enough", 0 <= self.enough <= 1, "within 0 and 1"),
            ("caps", len(self.caps) == 3 and min(self.caps) >= 0, "three numbers, at least 0"),
            ("net", len(self.net) > 0 and min(self.net) >= 1, "one or more widths, at least 1"),
        ):
            if not good:
                raise ValueError(f"{name} must be {wanted}; got {getattr(self, name)!r}.")
        if any(self.caps) and self.algo != "ppo":
            raise ValueError(f"caps is for PPO; got algo {self.algo!r}. Use action_rate.")
        if self.target_kl and self.algo != "ppo":
            raise ValueError(f"target_kl is for PPO; got algo {self.algo!r}.")
        if self.library == "jax" and self.algo == "ppo":
            raise ValueError("library 'jax' is for DDPG, TD3 and SAC; got algo 'ppo'. Use library 'torch'.")
        if self.first_actions != 1.0 and self.algo == "ppo":
            raise ValueError("first_actions is for DDPG, TD3 and SAC; got algo 'ppo'. Use noise.")
        if self.mirror and self.algo == "ppo":
            raise ValueError("mirror is for DDPG, TD3 and SAC, which learn from what they keep; got algo 'ppo'.")
        if self.near != type(self).near and (self.env or self.task != "swing-up" or self.starts != "mixed"):
            raise ValueError(
                f"near is for mixed starts of the swing-up; got {self.starts!r} of {self.env or self.task!r}."
            )
        for name in ("episode", "action_rate", "sensor_noise", "mirror"):
            if self.env and getattr(self, name):
                raise ValueError(f"{name} is for our own plant; got env {self.env!r}.")

    @property
    def samples(self) -> int:
        """Samples of the rig that a force is held for."""
        return round(self.period / self.rig.sample_time)

    @property
    def name(self) -> str:
        """What is learned by what, in a word."""
        parts = [self.algo, self.env or self.task]
        parts += ["rest"] * (self.starts == "rest" and not self.env)
        parts += ["smooth"] * bool(self.action_rate or any(self.caps))
        return "-".join(parts).lower()

    def to_dict(self) -> dict[str, Any]:
        """Return all fields as plain values, for records."""
        return {each.name: getattr(self, each.name) for each in fields(self)} | {"rig": self.rig.to_dict()}


class Evaluation(NamedTuple):
    """One line of an evaluation curve."""

    steps: int
    """Environment steps so far."""
    success: float
    """Share of starts that succeed: in time, both links up at the end; of another environment, episodes that last."""
    score: float
    """The share again; of another environment, the mean return."""
    variation: float
    """Mean total variation of the force over the last four seconds, in force limits per second."""
    wall_seconds: float
    """Wall time so far, evaluations included."""
    cpu_seconds: float
    """Processor time of this process so far, evaluations included."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DeepTraining:
    """What a deep training gave.

    Attributes
    ----------
    policy : MLPPolicy or Network
        The best by evaluation, the latest among equals; of another environment, its network.
    curve : list of Evaluation
        What was seen of it while it learned.
    best : Evaluation
        That of the policy.
    """

    policy: MLPPolicy | Network
    curve: list[Evaluation]
    best: Evaluation


def training_envs(recipe: DeepRecipe) -> gym.vector.VectorEnv[Any, Any, Any]:
    """Return the environments that a recipe is trained in: copies that begin anew in the step that ends an episode.

    Parameters
    ----------
    recipe : DeepRecipe
        The recipe.

    Returns
    -------
    gymnasium.vector.VectorEnv
    """
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
        sensor_noise=recipe.sensor_noise or rig.sensor_noise,
    )
    if recipe.task == "balance":
        task: Balance | SwingUp = Balance(lam=0.4)
        mixture: Sequence[Balance | SwingUp] = [task]
    else:
        task = SwingUp()
        mixture = [SwingUp(start=start, angle_spread=0.1) for start in ("hanging", "side")]
        if recipe.starts == "mixed":
            mixture = [*mixture, Balance(lam=recipe.near), SwingUp(start="anywhere")]
    shaped = Shaped(task=task, rig=rig, mixture=mixture, steps=max(round(recipe.episode / recipe.period), 1))
    return CartDoublePendulumVectorEnv(shaped, slow, recipe.copies, autoreset_mode=AutoresetMode.SAME_STEP)


def swing_up_starts(rng: np.random.Generator, n: int, rig: Rig) -> Array:
    """Draw the starts that swing-ups are judged by: half hanging, half level to the side, each angle within 0.05 rad.

    Parameters
    ----------
    rng : numpy.random.Generator
        What they are drawn from.
    n : int
        How many; the first half hangs.
    rig : Rig
        The rig.

    Returns
    -------
    ndarray (n, 6)
    """
    halves = [SwingUp(start=start, angle_spread=0.05).starts(rng, size, rig) for start, size in _halves(n)]
    return np.concatenate(halves)


def _halves(n: int) -> list[tuple[str, int]]:
    return [("hanging", n // 2), ("side", n - n // 2)]


def evaluate(policy: Controller, task: str, rig: Rig, n: int, seed: int | Sequence[int]) -> tuple[float, float]:
    """Return success and mean variation of a policy from fresh starts.

    Parameters
    ----------
    policy : Controller
        The policy.
    task : {"swing-up", "balance"}
        Ten seconds, the last of them upright, from :func:`swing_up_starts`; or 300 samples from
        ``Balance(lam=0.3).starts``.
    rig : Rig
        The rig.
    n : int
        How many starts.
    seed : int or sequence of int
        What they are drawn from.

    Returns
    -------
    success : float
        Share of starts.
    variation : float
        Mean total variation of the force over the last four seconds of the runs that succeed, in force limits per
        second; NaN where none does.
    """
    rng = np.random.default_rng(seed)
    if task == "balance":
        judge: Balance | SwingUp = Balance(lam=0.3)
        starts = judge.starts(rng, n, rig)
    else:
        judge = SwingUp(steps=round(EPISODE / rig.sample_time))
        starts = swing_up_starts(rng, n, rig)
    runs = simulate_many(rig, policy, starts, task=judge)
    last = runs.u[runs.success, -round(4.0 / rig.sample_time) :]
    variation = force_metrics(last, rig.sample_time, rig.force_limit)["variation"] if len(last) else np.array([np.nan])
    return float(runs.success.mean()), float(variation.mean())


def _returns(network: Network, env: str, episodes: int) -> tuple[float, float]:
    """Return the share of episodes that last, and the mean return, in another environment."""
    single = gym.make(env)
    box = single.action_space
    assert isinstance(box, gym.spaces.Box)
    half_range, middle = (box.high - box.low) / 2, (box.high + box.low) / 2
    lasted, returns = 0, []
    for episode in range(episodes):
        o, _ = single.reset(seed=_EVALUATION_STREAM + episode)
        total, terminated, truncated = 0.0, False, False
        while not (terminated or truncated):
            o, reward, terminated, truncated, _ = single.step(network(np.asarray(o)[None])[0] * half_range + middle)
            total += float(reward)
        lasted += not terminated
        returns.append(total)
    single.close()
    return lasted / episodes, float(np.mean(returns))


def train_deep(
    recipe: DeepRecipe,
    seed: int = 0,
    *,
    out: str | Path | None = None,
    command: str = "",
    progress: Callable[[Evaluation], None] | None = None,
) -> DeepTraining:
    """Follow a recipe, evaluate on the way, and keep the best policy.

    With a folder, the state of the training is kept there at every evaluation, all at once or not at all; a training
    that was stopped in any way goes on from the last when it is called again.  There are then ``recipe.json``,
    ``curve.csv``, ``policy.npz`` and ``checkpoint.pt``.

    Parameters
    ----------
    recipe : DeepRecipe
        What to do.
    seed : int
        What all randomness is drawn from.
    out : str or Path, optional
        Folder for the results, made where it is missing.
    command : str
        What was typed to come here; kept with the policy.
    progress : callable, optional
        Called with each evaluation.

    Returns
    -------
    DeepTraining

    Raises
    ------
    ImportError
        If torch or Stable-Baselines3 is missing; the message says what to install.
    ValueError
        If the folder holds another training.
    """
    seed = checked_seed("seed", seed)
    try:
        made_by = learner_class(recipe)
    except ModuleNotFoundError as error:
        raise ImportError(INSTALL[recipe.library]) from error
    folder = None if out is None else _folder(Path(out), recipe, seed)
    learner = made_by(recipe, seed)
    curve: list[Evaluation] = []
    best, best_policy = None, None
    checkpoint = None if folder is None else folder / "checkpoint.pt"
    if checkpoint is not None and checkpoint.exists():
        kept = learner.restore(checkpoint)
        curve = [Evaluation(*line) for line in kept["curve"]]
        best = Evaluation(*kept["best"])
        best_policy = _policy(recipe, seed, command, Network.from_arrays(about={}, **kept["network"]), best)
        if progress is not None:
            progress(curve[-1])
    wall, cpu = (curve[-1].wall_seconds, curve[-1].cpu_seconds) if curve else (0.0, 0.0)
    wall_began, cpu_began = time.perf_counter() - wall, time.process_time() - cpu
    while learner.steps < recipe.steps and not (recipe.enough and curve and curve[-1].success >= recipe.enough):
        learner.learn(min(recipe.evaluate_every, recipe.steps - learner.steps))
        network = learner.network()
        policy = _policy(recipe, seed, command, network, None)
        if isinstance(policy, MLPPolicy):
            success, variation = evaluate(
                policy, recipe.task, recipe.rig, recipe.evaluation_starts, [_EVALUATION_STREAM, seed]
            )
            score = success
        else:
            success, score = _returns(network, recipe.env, 20)
            variation = math.nan
        seconds = time.perf_counter() - wall_began, time.process_time() - cpu_began
        curve.append(Evaluation(learner.steps, success, score, variation, *seconds))
        if best is None or curve[-1].score >= best.score:
            best = curve[-1]
            best_policy = _policy(recipe, seed, command, network, best)
        if folder is not None and checkpoint is not None:
            assert best_policy is not None
            best_network = best_policy.network if isinstance(best_policy, MLPPolicy) else best_policy
            learner.save(checkpoint, {"curve": curve, "best": best, "network": best_network.arrays()})
            best_policy.save(folder / "policy.npz")
            _write_curve(folder / "curve.csv", curve)
        if progress is not None:
            progress(curve[-1])
    assert best is not None
    assert best_policy is not None
    return DeepTraining(policy=best_policy, curve=curve, best=best)


def learner_class(recipe: DeepRecipe) -> Callable[[DeepRecipe, int], Any]:
    """Return what trains a recipe; importing it takes torch or JAX."""
    if recipe.library == "jax":
        from .sb3_jax import Learner
    else:
        from .sb3 import Learner
    return Learner


def _policy(
    recipe: DeepRecipe, seed: int, command: str, network: Network, evaluation: Evaluation | None
) -> MLPPolicy | Network:
    """Return the controller that a network is, with its provenance; of another environment, the network alone."""
    about = {
        "name": recipe.name,
        "recipe": recipe.to_dict(),
        "seed": seed,
        "command": command,
        "evaluation": None if evaluation is None else evaluation._asdict(),
        "versions": _versions(recipe),
    }
    if recipe.env:
        return Network(
            network.weights, network.biases, activation=network.activation, squash=network.squash, about=about
        )
    return MLPPolicy(
        network,
        scales=observation_scales(recipe.rig),
        force_limit=float(recipe.rig.force_limit),
        period=recipe.period,
        about=about,
    )


def _versions(recipe: DeepRecipe) -> dict[str, str]:
    packages = {"sbx": "sbx-rl"}
    return versions() | {
        library: metadata.version(packages.get(library, library)) for library in NEEDED[recipe.library]
    }


def _folder(out: Path, recipe: DeepRecipe, seed: int) -> Path:
    """Make a folder for one training, or find that it was begun there."""
    told = (
        json.dumps({"seed": seed, "recipe": recipe.to_dict(), "versions": _versions(recipe)}, indent=2, default=str)
        + "\n"
    )
    file = out / "recipe.json"
    if file.exists():
        before = json.loads(file.read_text(encoding="utf-8"))
        now = json.loads(told)
        if any(before.get(key) != now[key] for key in ("seed", "recipe")):
            raise ValueError(f"{out} holds another training: {file.name} has other settings. Choose another folder.")
        return out
    out.mkdir(parents=True, exist_ok=True)
    file.write_text(told, encoding="utf-8")
    return out


def _write_curve(file: Path, curve: Sequence[Evaluation]) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(Evaluation._fields)
    writer.writerows([*line[:2], *(f"{number:.6g}" for number in line[2:])] for line in curve)
    part = file.with_name(f".{file.name}.part")
    part.write_text(text.getvalue(), encoding="utf-8")
    part.replace(file)


def read_curve(file: Path) -> list[Evaluation]:
    """Read what :func:`train_deep` wrote.

    Parameters
    ----------
    file : Path
        A ``curve.csv``.

    Returns
    -------
    list of Evaluation
    """
    with file.open(newline="", encoding="utf-8") as stream:
        lines = list(csv.reader(stream))[1:]
    return [Evaluation(int(line[0]), *map(float, line[1:])) for line in lines]
