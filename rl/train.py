"""Train a learner from the command line: ``python -m rl.train --algo ppo --task swing-up --rig gustafsson2016``.

Each seed has a folder with its policy; of deep learners also with its settings, its evaluation curve and a checkpoint,
so that a training that was stopped in any way goes on when the same command is given again.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_EXCEPTION, wait
from dataclasses import dataclass, field
from functools import partial
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.table import Table
from tyro.conf import OmitArgPrefixes, UseAppendAction, arg
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from dpend.arguments import checked_seed, checked_whole
from dpend.rig import Rig, rig
from dpend.workers import interruptible, pool

from .deep import Evaluation, pack, train_deep
from .identify_plan import IdentifyAndPlan
from .linear_q import LinearQLearning
from .lspi import LSPI
from .model_based import ModelBased
from .policies import Policy
from .qac import GaussianQAC
from .recipes import DEFAULTS, INSTALL, NEEDED, DeepRecipe
from .settings import known
from .training import Learner, Training

LINEAR: Mapping[str, Callable[[Rig], Learner]] = MappingProxyType(
    {
        "lspi": LSPI,
        "qac-tuned": GaussianQAC.tuned,
        "q-tuned": LinearQLearning.tuned,
        "model-based": ModelBased,
        "identify-and-plan": IdentifyAndPlan,
    }
)
"""What builds each learner without settings, in its tuned form; with seed 0 those shipped learn the policy so named."""

_RIG = "gustafsson2016"
_PROGRAM = "python -m rl.train"
_ALGORITHMS = f"""Algorithms without settings are {", ".join(LINEAR)}; they take seconds or minutes.
Deep ones are {", ".join(DEFAULTS)}; {_PROGRAM} --algo ppo --help lists their settings, such as --task and --steps."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of every learner."""

    set: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="NAME=NUMBER")] = ()
    """Change a number of the rig, such as mass1=.6; may be repeated."""
    seed: int = 0
    """The first seed."""
    seeds: int = 1
    """How many: the first seed and those that follow."""
    workers: int = 1
    """Processes that share the seeds."""
    out: Path | None = None
    """Folder for the results; left out, one in results/ with the learner's name."""


@dataclass(frozen=True, kw_only=True)
class DeepOptions(Options):
    """Options of deep learners."""

    recipe: OmitArgPrefixes[DeepRecipe]
    pack: Path | None = None
    """File to which all trainings in the folder are written in the end, such as NAME.npz; left out, none."""


@dataclass(frozen=True, kw_only=True)
class LinearOptions(Options):
    """Options of linear learners; their settings are their own."""

    algo: str
    """The learner."""
    rig: Rig = field(default_factory=lambda: rig(_RIG))
    """A preset, or a file.toml."""


@dataclass(frozen=True, kw_only=True)
class _Which:
    """What must be known before the other options can be."""

    algo: str = "ppo"
    rig: str = ""
    set: UseAppendAction[tuple[str, ...]] = ()

    def plant(self) -> Rig:
        """Return the rig, with its numbers changed."""
        changes: dict[str, float] = {}
        for change in self.set:
            name, _, number = change.partition("=")
            try:
                changes[name] = int(number) if number.strip("+-").isdecimal() else float(number)
            except ValueError:
                raise ValueError(f"--set takes NAME=NUMBER, such as mass1=.6; got {change!r}.") from None
        return rig(self.rig or _RIG).replace(**changes)


def main(arguments: Sequence[str] | None = None) -> list[Policy]:
    """Train from a command line, the program's own where it is left out, and return the policies, one a seed."""
    console = Console(stderr=True, highlight=False)
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    which, _ = tyro.cli(_Which, args=arguments, return_unknown_args=True, add_help=False)
    linear = which.algo in LINEAR
    brief = not any(each.startswith("--algo") for each in arguments) and not {"-h", "--help"}.isdisjoint(arguments)
    try:
        known([*LINEAR, *DEFAULTS])("--algo", which.algo)
        registry = ConstructorRegistry()
        registry.primitive_rule(partial(_built, which.plant()))
        options: Any = tyro.cli(
            LinearOptions if linear or brief else DeepOptions,
            args=arguments if which.rig else [*arguments, "--rig", _RIG],
            description=f"{__doc__}\n{_ALGORITHMS}",
            prog=_PROGRAM,
            registry=registry,
        )
        checked_seed("--seed", options.seed)
        checked_whole("--seeds", options.seeds)
        checked_whole("--workers", options.workers)
        learner: Any = LINEAR[options.algo](options.rig) if linear else options.recipe
        if not linear and not all(find_spec(name) for name in NEEDED[learner.library]):
            raise ImportError(INSTALL[learner.library])
        out = options.out or Path("results", *(("linear", options.algo) if linear else ("deep", learner.name)))
        with interruptible():
            return _train(options, learner, out, " ".join([_PROGRAM, *arguments]), console)
    except KeyboardInterrupt:
        kept = "Seeds that were finished are kept." if linear else "The same command goes on from the last evaluation."
        console.print(f"\nStopped. {kept}")
        raise SystemExit(130) from None
    except (ImportError, OSError, RuntimeError, TypeError, ValueError) as error:
        console.print(f"[bold red]Error:[/] {escape(str(error))}", soft_wrap=True)
        raise SystemExit(2) from None


def _built(plant: Rig, info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Rig] | None:
    """Let the command line name a rig, which has been built from its name already."""
    if info.type is not Rig:
        return None
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar="PRESET|FILE.toml",
        instance_from_str=lambda words: plant,
        is_instance=lambda value: isinstance(value, Rig),
        str_from_instance=lambda value: [_RIG],
    )


def _train(options: Options, learner: Learner, out: Path, command: str, console: Console) -> list[Policy]:
    """Train all seeds, in this process or in several, with a progress bar for each."""
    seeds = range(options.seed, options.seed + options.seeds)
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as progress:
        bars = {seed: progress.add_task(f"seed {seed}", total=1.0) for seed in seeds}

        def show(news: tuple[int, float, str]) -> None:
            seed, share, score = news
            progress.update(bars[seed], completed=share, description=", ".join(filter(None, (f"seed {seed}", score))))

        if min(options.workers, options.seeds) == 1:
            done = {seed: _train_one(learner, seed, out, command, show) for seed in seeds}
        else:
            with pool(options.workers, learner=learner) as executor:
                executor.submit(int).result()  # fails first, and says why, where workers cannot import the program
                with get_context("spawn").Manager() as manager:
                    news: Any = manager.Queue()
                    jobs = {seed: executor.submit(_train_one, learner, seed, out, command, news.put) for seed in seeds}
                    going = set(jobs.values())
                    while going:
                        finished, going = wait(going, timeout=0.5, return_when=FIRST_EXCEPTION)
                        while not news.empty():
                            show(news.get())
                        for job in finished:
                            job.result()
                    done = {seed: job.result() for seed, job in jobs.items()}
    rows = [{"seed": str(seed)} | _row(learner, training) for seed, training in done.items()]
    table = Table(*rows[0])
    for row in rows:
        table.add_row(*row.values())
    Console().print(table)
    file = options.pack if isinstance(options, DeepOptions) else None
    if file is not None:
        pack(out, file)
    Console().print(f"What was learned is in {file or f'{out}/'}.", soft_wrap=True, highlight=False)
    return [training.policy for training in done.values()]


def _train_one(learner: Learner, seed: int, out: Path, command: str, report: Callable[..., None]) -> Training:
    """Train with a seed, and leave the policy in a folder of its own."""
    folder = out / f"seed-{seed}"
    if isinstance(learner, DeepRecipe):
        recipe = learner

        def watch(seen: Evaluation) -> None:
            score = f"return {seen.score:.0f}" if recipe.env else f"{seen.success:.0%} succeed"
            report((seed, min(seen.steps / recipe.steps, 1.0), score))

        return train_deep(recipe, seed, out=folder, command=command, progress=watch)
    training = learner.train(seed, progress=lambda share: report((seed, share, "")))
    training.policy.about["command"] = command
    folder.mkdir(parents=True, exist_ok=True)
    training.policy.save(folder / "policy.npz")
    return training


def _row(learner: Learner, training: Training) -> dict[str, str]:
    """Return what a table says of a training, by its headings."""
    curve, seconds = training.curve, training.cost.cpu_seconds
    cost = {"CPU s": f"{seconds:.0f}" if seconds >= 10 else f"{seconds:.2g}"}
    if not isinstance(learner, DeepRecipe):
        return {"outcome": training.outcome.name.lower(), "experience, s": f"{training.experience:,.0f}"} | cost
    best = training.details["best"]
    score = (
        {"mean return": f"{curve['score'][best]:.0f}"} if learner.env else {"success": f"{curve['score'][best]:.1%}"}
    )
    spent = {"environment steps": f"{curve['steps'][-1]:,}"} | cost | {"s": f"{curve['wall_seconds'][-1]:.0f}"}
    return {"best after": f"{curve['steps'][best]:,}"} | score | spent


if __name__ == "__main__":
    main()
