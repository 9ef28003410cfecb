"""Train a learner from the command line: ``python -m rl.train --algo ppo --task swing-up --rig gustafsson2016``.

Of deep learners each seed has a folder with its settings, its evaluation curve, its best policy and a checkpoint.  A
training that was stopped in any way goes on when the same command is given again; a finished one is left as it is.
The linear learners lspi, qac-tuned and q-tuned take seconds and have no settings but seed and rig.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_EXCEPTION, wait
from dataclasses import dataclass, field
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path
from queue import Empty
from types import MappingProxyType
from typing import Any, Literal

import tyro
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table
from tyro.conf import OmitArgPrefixes
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

import dpend
from dpend.rig import Rig
from dpend.workers import pool

from .deep import Evaluation, pack, train_deep
from .linear_q import LinearQLearning
from .lspi import LSPI
from .policies import Policy
from .qac import GaussianQAC
from .recipes import INSTALL, NEEDED, DeepRecipe
from .training import Learner, Training

LINEAR: Mapping[str, Callable[[Rig], Learner]] = MappingProxyType(
    {"lspi": LSPI, "qac-tuned": GaussianQAC.tuned, "q-tuned": LinearQLearning.tuned}
)
"""The linear learners, in their tuned form; with seed 0 each makes the policy shipped by its name."""


@dataclass(frozen=True, kw_only=True)
class Seeds:
    """Options of every learner."""

    seed: int = 0
    """The first seed."""
    seeds: int = 1
    """How many: the first seed and those that follow."""
    out: Path | None = None
    """Folder for the results; left out, one in results/ with the learner's name."""

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise ValueError(f"--seed must be at least 0; got {self.seed}.")
        if self.seeds < 1:
            raise ValueError(f"--seeds must be at least 1; got {self.seeds}.")

    @property
    def all(self) -> range:
        """The seeds."""
        return range(self.seed, self.seed + self.seeds)


@dataclass(frozen=True, kw_only=True)
class DeepOptions(Seeds):
    """Options of deep learners."""

    recipe: OmitArgPrefixes[DeepRecipe]
    workers: int = 1
    """Processes that share the seeds."""
    pack: Path | None = None
    """File to which all trainings in the folder are written in the end, such as NAME.npz; left out, none."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.workers < 1:
            raise ValueError(f"--workers must be at least 1; got {self.workers}.")


@dataclass(frozen=True, kw_only=True)
class LinearOptions(Seeds):
    """Options of linear learners; their settings are their own."""

    algo: Literal["lspi", "qac-tuned", "q-tuned"]
    """The learner."""
    rig: Rig = field(default_factory=lambda: dpend.rig("gustafsson2016"))
    """A preset."""


@dataclass(frozen=True, kw_only=True)
class _Which:
    algo: str = "ppo"


_REGISTRY = ConstructorRegistry()


@_REGISTRY.primitive_rule
def _preset(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Rig] | None:
    """Let the command line name a rig."""
    if info.type is not Rig:
        return None
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar="PRESET",
        instance_from_str=lambda words: dpend.rig(words[0]),
        is_instance=lambda rig: isinstance(rig, Rig),
        str_from_instance=lambda rig: [next(name for name in dpend.rigs() if dpend.rig(name) == rig)],
    )


def main(arguments: Sequence[str] | None = None) -> list[Policy]:
    """Train from a command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        The command line; left out, the program's own.

    Returns
    -------
    list of LinearQPolicy, GainPolicy, MLPPolicy or Network
        One a seed.
    """
    console = Console(stderr=True, highlight=False)
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    which, _ = tyro.cli(_Which, args=arguments, return_unknown_args=True, add_help=False)
    kind = LinearOptions if which.algo in LINEAR else DeepOptions
    options = tyro.cli(kind, args=arguments, description=__doc__, prog="python -m rl.train", registry=_REGISTRY)
    command = " ".join(["python -m rl.train", *arguments])
    try:
        if isinstance(options, LinearOptions):
            return _train_linear(options, command, console)
        if not all(find_spec(name) for name in NEEDED[options.recipe.library]):
            raise ImportError(INSTALL[options.recipe.library])
        out = options.out or Path("results") / "deep" / options.recipe.name
        return _train(options, options.recipe, out, command, console)
    except KeyboardInterrupt:
        console.print(
            "\nStopped. What was learned up to the last evaluation is kept: the same command goes on from there."
        )
        raise SystemExit(130) from None
    except (ImportError, OSError, TypeError, ValueError) as error:
        console.print(f"[bold red]Error:[/] {escape(str(error))}", soft_wrap=True)
        raise SystemExit(2) from None


def _train_linear(options: LinearOptions, command: str, console: Console) -> list[Policy]:
    """Train a linear learner with all seeds."""
    learner = LINEAR[options.algo](options.rig)
    policies: list[Policy] = []
    for seed in options.all:
        policy = learner.train(seed).policy
        policy.about["command"] = command
        folder = (options.out or Path("results") / "linear" / options.algo) / f"seed-{seed}"
        folder.mkdir(parents=True, exist_ok=True)
        console.print(f"{policy!r} is in {policy.save(folder / 'policy.npz')}.", soft_wrap=True)
        policies.append(policy)
    return policies


def _train(options: DeepOptions, recipe: DeepRecipe, out: Path, command: str, console: Console) -> list[Policy]:
    """Train all seeds, in this process or in several, with a progress bar for each."""
    folders = {seed: out / f"seed-{seed}" for seed in options.all}
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    done: dict[int, Training] = {}
    with Progress(*columns, console=console) as progress:
        bars = {seed: progress.add_task(f"{recipe.name}, seed {seed}", total=recipe.steps) for seed in folders}

        def show(seed: int, seen: Evaluation) -> None:
            shown = f"{recipe.name}, seed {seed}, {_score(recipe, seen)}"
            progress.update(TaskID(bars[seed]), completed=min(seen.steps, recipe.steps), description=shown)

        if min(options.workers, options.seeds) == 1:
            for seed, folder in folders.items():
                done[seed] = train_deep(
                    recipe, seed, out=folder, command=command, progress=lambda seen, seed=seed: show(seed, seen)
                )
        else:
            with get_context("spawn").Manager() as manager, pool(options.workers, recipe=recipe) as executor:
                news: Any = manager.Queue()
                jobs = {
                    seed: executor.submit(_train_one, recipe, seed, folder, command, news)
                    for seed, folder in folders.items()
                }
                going = set(jobs.values())
                while going:
                    finished, going = wait(going, timeout=0.5, return_when=FIRST_EXCEPTION)
                    _show(news, show)
                    for job in finished:
                        job.result()
                done = {seed: job.result() for seed, job in jobs.items()}
    table = Table(
        "seed", "best after", "success" if not recipe.env else "mean return", "environment steps", "CPU s", "s"
    )
    for seed, training in done.items():
        curve, best = training.curve, training.details["best"]
        score = f"{curve['score'][best]:.1%}" if not recipe.env else f"{curve['score'][best]:.0f}"
        spent = f"{curve['steps'][-1]:,}", f"{curve['cpu_seconds'][-1]:.0f}", f"{curve['wall_seconds'][-1]:.0f}"
        table.add_row(str(seed), f"{curve['steps'][best]:,}", score, *spent)
    Console().print(table)
    if options.pack is not None:
        pack(out, options.pack)
    Console().print(
        f"Policies, curves and settings are in {options.pack or f'{out}/'}.", soft_wrap=True, highlight=False
    )
    return [training.policy for training in done.values()]


def _score(recipe: DeepRecipe, seen: Evaluation) -> str:
    return f"return {seen.score:.0f}" if recipe.env else f"{seen.success:.0%} succeed"


def _show(news: Any, show: Any) -> None:
    while True:
        try:
            show(*news.get_nowait())
        except Empty:
            return


def _train_one(recipe: DeepRecipe, seed: int, folder: Path, command: str, news: Any) -> Training:
    return train_deep(recipe, seed, out=folder, command=command, progress=lambda seen: news.put((seed, seen)))


if __name__ == "__main__":
    main()
