r"""Deep reinforcement learning: PPO, DDPG, TD3 and SAC of Stable-Baselines3 and SBX on the native vector environment.

:func:`train_deep` follows a :class:`rl.recipes.DeepRecipe`; :class:`DeepLearner` is the same as a learner like others.
``docs/deep-rl.md`` lists settings, deviations and results.
"""

from __future__ import annotations

import csv
import json
import math
import time
from collections.abc import Callable, Sequence
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from dpend import archive
from dpend.archive import atomic
from dpend.arguments import checked_path
from dpend.controller import Controller
from dpend.metrics import force_metrics
from dpend.params import Array
from dpend.provenance import versions
from dpend.rig import Rig
from dpend.shaping import observation_scales
from dpend.simulate import checked_seed, simulate_many
from dpend.tasks import Balance, SwingUp

from .policies import MLPPolicy, Network, load_policy, made_policy
from .recipes import EPISODE, INSTALL, NEEDED, DeepRecipe
from .training import Cost, Outcome, Progress, Seed, Trail, Training, samples_within

_EVALUATION_STREAM = 7159  # sets the starts of evaluation apart from others drawn with the same seed
_PACKED = "dpend deep trainings 1"
_RETURNS = 20  # episodes of an evaluation in another environment


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


def swing_up_starts(rng: np.random.Generator, n: int, rig: Rig) -> Array:
    """Return the starts (n, 6) that swing-ups are evaluated from: half hang, half lie to the side, within 0.05 rad."""
    halves = ("hanging", n // 2), ("side", n - n // 2)
    return np.concatenate([SwingUp(start=start, angle_spread=0.05).starts(rng, size, rig) for start, size in halves])


def _evaluated(task: str, rig: Rig) -> Balance | SwingUp:
    """Return the task that evaluations are of."""
    return Balance(lam=0.3) if task == "balance" else SwingUp(steps=round(EPISODE / rig.sample_time))


def evaluate(policy: Controller, task: str, rig: Rig, n: int, seed: Seed) -> tuple[float, float]:
    """Return a policy's success, a share of ``n`` fresh starts, and the mean variation of its force.

    The task "swing-up" is ten seconds, the last of them upright, from :func:`swing_up_starts`, and "balance" 300
    samples from ``Balance(lam=0.3).starts``.  The total variation is that of the last four seconds of the runs that
    succeed, in force limits per second; NaN where none does.
    """
    rng, evaluated = np.random.default_rng(seed), _evaluated(task, rig)
    starts = evaluated.starts(rng, n, rig) if task == "balance" else swing_up_starts(rng, n, rig)
    runs = simulate_many(rig, policy, starts, task=evaluated)
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
    seconds: float | None = None,
    out: str | Path | None = None,
    command: str = "",
    progress: Callable[[Evaluation], None] | None = None,
) -> Training:
    """Follow a recipe, evaluate on the way, and keep the best policy.

    With a folder, the state of the training is kept there at every evaluation, to the end or not at all; a training
    that was stopped in any way goes on from the last when it is called again.  There are then ``recipe.json``,
    ``curve.csv``, ``policy.npz`` and ``checkpoint.pt``.

    Parameters
    ----------
    recipe : DeepRecipe
        What to do.
    seed : int
        What all randomness is drawn from.
    seconds : float, optional
        Greatest experience in learning, s of the plant's time; evaluations are apart.  All steps where left out.
    out : str or Path, optional
        Folder for the results, created where it is missing.
    command : str
        The command line that led here; saved with the policy.
    progress : callable, optional
        Called with each evaluation.

    Returns
    -------
    Training
        The policy is an :class:`rl.MLPPolicy`, the best by evaluation, the latest among equals; of another environment,
        its :class:`rl.Network`.  It has converged where an evaluation was good ``enough``.  ``curve`` has one entry an
        evaluation: the fields of :class:`rl.deep.Evaluation`, and ``experience``, s of the plant's time without
        evaluations; ``details`` has the place of the ``best``.

    Raises
    ------
    ImportError
        If torch or Stable-Baselines3 is missing; the message says what to install.
    ValueError
        If the folder holds another training, or the seconds do not allow one round of steps.

    See Also
    --------
    rl.DeepRecipe : What to do.
    rl.load_policy : Read what was kept.

    Examples
    --------
    >>> from rl import DeepRecipe, train_deep
    >>> train_deep(DeepRecipe(algo="ppo"), seed=0, out="results/ppo")  # doctest: +SKIP
    """
    seed = checked_seed("seed", seed)
    try:
        made_by = learner_class(recipe)
    except ModuleNotFoundError as error:
        raise ImportError(INSTALL[recipe.library]) from error
    steps = _steps_within(recipe, seconds)
    folder = None if out is None else _folder(checked_path("out", out), recipe, seed)
    learner = made_by(recipe, seed)
    curve: list[Evaluation] = []
    networks: list[Network] = []  # one an evaluation

    def best() -> MLPPolicy | Network:
        about = {
            "name": recipe.name,
            "recipe": recipe.to_dict(),
            "seed": seed,
            "command": command,
            "evaluation": curve[_best(curve)]._asdict(),
            "versions": _versions(recipe),
        }
        return _policy(recipe, networks[_best(curve)], about)

    if folder is not None and (folder / "checkpoint.pt").exists():
        kept = learner.restore(folder / "checkpoint.pt")
        curve = [Evaluation(*line) for line in kept["curve"]]
        networks = [
            Network.from_arrays(about={}, **{name: np.asarray(array) for name, array in layers.items()})
            for layers in kept["networks"]
        ]
        if progress is not None:
            progress(curve[-1])
    wall, cpu = (curve[-1].wall_seconds, curve[-1].cpu_seconds) if curve else (0.0, 0.0)
    wall_began, cpu_began = time.perf_counter() - wall, time.process_time() - cpu
    while learner.steps < steps and not (curve and _good(recipe, curve[-1])):
        learner.learn(min(recipe.evaluate_every, steps - learner.steps))
        networks.append(learner.network())
        success, score, variation = _evaluation(recipe, networks[-1], seed)
        spent = time.perf_counter() - wall_began, time.process_time() - cpu_began
        curve.append(Evaluation(learner.steps, success, score, variation, *spent))
        if folder is not None:
            kept = {"curve": curve, "networks": [network.arrays() for network in networks]}
            learner.save(folder / "checkpoint.pt", kept)
            best().save(folder / "policy.npz")
            _write_curve(folder / "curve.csv", curve)
        if progress is not None:
            progress(curve[-1])
    return _training(recipe, best(), curve, networks)


class DeepLearner(DeepRecipe):
    """A recipe that trains itself: deep learning with the interface of all learners, :class:`rl.Learner`."""

    def train(self, seed: Seed, *, seconds: float | None = None, progress: Progress = None) -> Training:
        """Learn as :func:`train_deep` does, without a folder; ``progress`` is called at every evaluation."""
        steps = _steps_within(self, seconds)
        if not isinstance(seed, int):
            seed = int(np.random.SeedSequence(seed).generate_state(1)[0] >> 1)
        watch = None if progress is None else lambda seen: progress(min(seen.steps / steps, 1.0))
        training = train_deep(self, seed, seconds=seconds, progress=watch)
        if progress is not None:
            progress(1.0)
        return training


DeepLearner.__doc__ = f"{DeepLearner.__doc__}\n\n    {(DeepRecipe.__doc__ or '').partition('    ')[2]}"


def read_training(folder: Path) -> Training:
    """Return the training that :func:`train_deep` left in a folder, without the policies on the way."""
    return _training(read_recipe(folder), load_policy(folder / "policy.npz"), read_curve(folder / "curve.csv"))


def read_recipe(place: Path) -> DeepRecipe:
    """Return the recipe of a training in a folder, or of those in a place for :func:`read_trainings`."""
    if place.is_dir():
        file = place / "recipe.json"
        return DeepRecipe.from_dict(
            _record(file if file.exists() else next(iter(_folders(place).values())) / file.name)
        )
    with archive.opened(place, _PACKED) as (header, _):
        return DeepRecipe.from_dict(header["recipe"])


def read_trainings(place: str | Path) -> dict[int, Training]:
    """Return the trainings of one recipe by their seeds, without the policies on the way.

    They are in a file that :func:`pack` wrote, or in folders ``seed-10``, ``seed-11`` of one folder, as
    ``python -m rl.train`` leaves; those without a policy yet are left out.

    Raises
    ------
    OSError
        If the file is not there.
    ValueError
        If it holds something else, or is damaged.
    """
    place = checked_path("place", place)
    if place.is_dir():
        return {seed: read_training(folder) for seed, folder in _folders(place).items()}
    with archive.opened(place, _PACKED) as (header, arrays):
        return {
            int(seed): _unpacked(header["recipe"], policy, {
                name.removeprefix(f"{seed}/"): array for name, array in arrays.items() if name.startswith(f"{seed}/")
            })
            for seed, policy in header["policies"].items()
        }  # fmt: skip


def pack(folder: Path, file: Path) -> Path:
    """Write the trainings in a folder to one file, which :func:`read_trainings` reads, and return its path.

    It holds the recipe, and of each seed the evaluation curve and the policy with its provenance.

    Raises
    ------
    ValueError
        If the folder holds no training, or trainings of several recipes.
    """
    folders = _folders(folder)
    if len({json.dumps(read_recipe(each).to_dict()) for each in folders.values()}) != 1:
        raise ValueError(f"{folder} must hold trainings of one recipe, in folders such as seed-10.")
    recipe = _record(next(iter(folders.values())) / "recipe.json")
    policies, arrays = {}, {}
    for seed, training in read_trainings(folder).items():
        about = {name: value for name, value in training.policy.about.items() if name != "recipe"}
        policies[seed] = {"kind": training.policy.kind, "about": about}
        arrays |= {f"{seed}/{name}": training.curve[name] for name in Evaluation._fields}
        arrays |= {f"{seed}/policy/{name}": array for name, array in training.policy.arrays().items()}
    return archive.write(file, _PACKED, {"recipe": recipe, "policies": policies}, arrays)


def kept_trainings(folder: Path) -> dict[str, Path]:
    """Return where :func:`read_trainings` finds the trainings of each recipe, in the order of their names.

    They are files ``NAME.npz`` that :func:`pack` wrote and folders ``NAME`` of trainings; of both the latter count.
    """
    places = {file.stem: file for file in folder.glob("*.npz")}
    return dict(sorted((places | {place.name: place for place in folder.glob("*/") if _folders(place)}).items()))


def _folders(place: Path) -> dict[int, Path]:
    """Return the folders of trainings in a folder, by seed."""
    found = [file.parent for file in place.glob("seed-*/policy.npz")]
    return dict(sorted((int(folder.name.removeprefix("seed-")), folder) for folder in found))


def _record(file: Path) -> dict[str, Any]:
    return json.loads(file.read_text(encoding="utf-8"))["recipe"]


def _unpacked(recipe: dict[str, Any], saved: dict[str, Any], arrays: archive.Arrays) -> Training:
    columns = [arrays.pop(name).tolist() for name in Evaluation._fields]
    weights = {name.removeprefix("policy/"): array for name, array in arrays.items()}
    policy = made_policy(saved["kind"], saved["about"] | {"recipe": recipe}, weights)
    return _training(DeepRecipe.from_dict(recipe), policy, [Evaluation(*line) for line in zip(*columns, strict=True)])


def _training(
    recipe: DeepRecipe, policy: Any, curve: Sequence[Evaluation], networks: Sequence[Network] = ()
) -> Training:
    columns = {
        name: np.array(column) for name, column in zip(Evaluation._fields, zip(*curve, strict=True), strict=True)
    }
    last, sample_time = curve[-1], math.nan if recipe.env else recipe.rig.sample_time
    samples = 1 if recipe.env else recipe.samples
    experience = columns["steps"] * samples * sample_time
    tests = 0 if recipe.env else len(curve) * recipe.evaluation_starts * _evaluated(recipe.task, recipe.rig).steps
    return Training(
        policy=policy,
        outcome=Outcome.CONVERGED if _good(recipe, last) else Outcome.BUDGET_SPENT,
        cost=Cost(
            episodes=-1,
            steps=last.steps * samples,
            test_steps=tests,
            sample_time=sample_time,
            cpu_seconds=last.cpu_seconds,
        ),
        curve=columns | {"experience": experience},
        details={"best": np.array(_best(curve))},
        trail=Trail(experience, networks, partial(_policy, recipe)),
    )


def _steps_within(recipe: DeepRecipe, seconds: float | None) -> int:
    """Return the environment steps that a budget of experience allows, in whole rounds; refuse less than one."""
    if seconds is None:
        return recipe.steps
    if recipe.env:
        raise ValueError(f"seconds is for our own plant; got env {recipe.env!r}.")
    steps = samples_within(seconds, recipe.period) // recipe.round * recipe.round
    if not steps:
        raise ValueError(
            f"seconds must allow one round of {recipe.round} environment steps, {recipe.round * recipe.period:g} s; "
            f"got {seconds!r}."
        )
    return min(steps, recipe.steps)


def _best(curve: Sequence[Evaluation]) -> int:
    """Return the place of the highest score, the latest among equals."""
    return max(range(len(curve)), key=lambda place: (curve[place].score, place))


def _good(recipe: DeepRecipe, seen: Evaluation) -> bool:
    return recipe.enough is not None and seen.success >= recipe.enough


def _evaluation(recipe: DeepRecipe, network: Network, seed: int) -> tuple[float, float, float]:
    """Return success, score and variation of the policy that a network is."""
    policy = _policy(recipe, network)
    if not isinstance(policy, MLPPolicy):
        assert recipe.env
        return (*_returns(network, recipe.env, _RETURNS), math.nan)
    success, variation = evaluate(policy, recipe.task, recipe.rig, recipe.evaluation_starts, [_EVALUATION_STREAM, seed])
    return success, success, variation


def learner_class(recipe: DeepRecipe) -> Callable[[DeepRecipe, int], Any]:
    """Return what trains a recipe; importing it takes torch or JAX."""
    if recipe.library == "jax":
        from .sb3_jax import Learner
    else:
        from .sb3 import Learner
    return Learner


def _policy(recipe: DeepRecipe, network: Network, about: dict[str, Any] | None = None) -> MLPPolicy | Network:
    """Return the controller that a network is; of another environment, the network alone."""
    about = {"name": recipe.name} if about is None else about
    if recipe.env:
        return Network.from_arrays(about=about, **network.arrays())
    return MLPPolicy(
        network,
        scales=observation_scales(recipe.rig),
        force_limit=float(recipe.rig.force_limit),
        period=recipe.period,
        about=about,
    )


def _versions(recipe: DeepRecipe) -> dict[str, str]:
    return versions() | {
        library: metadata.version("sbx-rl" if library == "sbx" else library) for library in NEEDED[recipe.library]
    }


def _folder(out: Path, recipe: DeepRecipe, seed: int) -> Path:
    """Create a folder for one training, or find that it was begun there."""
    file, record = out / "recipe.json", {"seed": seed, "recipe": recipe.to_dict(), "versions": _versions(recipe)}
    if file.exists():
        before = json.loads(file.read_text(encoding="utf-8"))
        if before.get("seed") != seed or read_recipe(out).to_dict() != recipe.to_dict():
            raise ValueError(f"{out} holds another training: {file.name} has other settings. Choose another folder.")
        return out
    out.mkdir(parents=True, exist_ok=True)
    with atomic(file) as part:
        part.write_text(json.dumps(record, indent=2, default=str) + "\n", encoding="utf-8")
    return out


def _write_curve(file: Path, curve: Sequence[Evaluation]) -> None:
    with atomic(file) as part, part.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(Evaluation._fields)
        writer.writerows([*line[:2], *(f"{number:.6g}" for number in line[2:])] for line in curve)


def read_curve(file: Path) -> list[Evaluation]:
    """Return the evaluations in a ``curve.csv`` that :func:`train_deep` wrote."""
    with file.open(newline="", encoding="utf-8") as stream:
        lines = list(csv.reader(stream))[1:]
    return [Evaluation(int(line[0]), *map(float, line[1:])) for line in lines]
