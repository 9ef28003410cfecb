"""Train deep learners from the command line: ``python -m rl.train --algo ppo --task swing-up --rig gustafsson2016``.

Each seed has a folder with its settings, its evaluation curve, its best policy and a checkpoint.  A training that was
stopped in any way goes on when the same command is given again; a finished one is left as it is.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Sequence
from concurrent.futures import FIRST_EXCEPTION, ProcessPoolExecutor, wait
from dataclasses import dataclass
from importlib.util import find_spec
from multiprocessing import get_context, parent_process
from pathlib import Path
from queue import Empty
from typing import Any, Literal

import tyro
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table

import dpend

from .deep import INSTALL, DeepRecipe, DeepTraining, Evaluation, train_deep


@dataclass(frozen=True, kw_only=True)
class Options:
    """What can be told on the command line; a number left at zero is the algorithm's own."""

    algo: Literal["ppo", "ddpg", "td3", "sac"] = "ppo"
    """The algorithm."""
    task: Literal["swing-up", "balance"] = "swing-up"
    """What to learn."""
    rig: str = "gustafsson2016"
    """The preset."""
    env: str = ""
    """A Gymnasium environment in place of task and rig, such as InvertedDoublePendulum-v5."""
    seed: int = 0
    """The first seed."""
    seeds: int = 1
    """How many: the first seed and those that follow."""
    workers: int = 1
    """Processes that share the seeds."""
    out: Path | None = None
    """Folder for the results; left out, results/deep/ and what is learned by what."""
    starts: Literal["mixed", "rest"] = "mixed"
    """Where episodes of the swing-up begin: anywhere between hanging and upright, or at rest alone."""
    steps: int = 0
    """Environment steps."""
    copies: int = 0
    """Environments side by side."""
    net: tuple[int, ...] = (64, 64)
    """Widths of the hidden layers."""
    batch: int = 0
    """Transitions in an update."""
    learning_rate: tuple[float, float] = (0.0, 0.0)
    """At the beginning and at the end."""
    updates: float = 0.0
    """Updates for each environment step."""
    gamma: float = 0.99
    """Discount factor."""
    noise: float = 0.0
    """Standard deviation of exploration, in shares of the force limit."""
    period: float = 0.0
    """How long a force is held, s."""
    action_rate: float = 0.0
    """Weight of the penalty on changes of the action."""
    caps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """CAPS in PPO's loss: temporal weight, spatial weight, spatial deviation."""
    layer_norm: bool = True
    """Whether the critics of DDPG, TD3 and SAC normalise their layers."""
    evaluate_every: int = 0
    """Environment steps between evaluations."""
    evaluation_starts: int = 400
    """Starts of an evaluation."""
    enough: float = 0.0
    """Share of success in an evaluation that ends a training; at zero, all steps are taken."""

    def __post_init__(self) -> None:
        for name, least in (("seed", 0), ("seeds", 1), ("workers", 1)):
            if getattr(self, name) < least:
                raise ValueError(f"--{name} must be at least {least}; got {getattr(self, name)}.")

    @property
    def recipe(self) -> DeepRecipe:
        """What a training depends on but its seed."""
        return DeepRecipe(
            algo=self.algo,
            task=self.task,
            rig=dpend.rig(self.rig),
            env=self.env,
            starts=self.starts,
            steps=self.steps,
            copies=self.copies,
            net=self.net,
            batch=self.batch,
            learning_rate=self.learning_rate,
            updates=self.updates,
            gamma=self.gamma,
            noise=self.noise,
            period=self.period,
            action_rate=self.action_rate,
            caps=self.caps,
            layer_norm=self.layer_norm,
            evaluate_every=self.evaluate_every,
            evaluation_starts=self.evaluation_starts,
            enough=self.enough,
        )


def main(arguments: Sequence[str] | None = None) -> list[DeepTraining]:
    """Train from a command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        The command line; left out, the program's own.

    Returns
    -------
    list of DeepTraining
        One a seed.
    """
    console = Console(stderr=True, highlight=False)
    options = tyro.cli(Options, args=arguments, description=__doc__, prog="python -m rl.train")
    try:
        recipe = options.recipe
    except (TypeError, ValueError) as error:
        return _refuse(console, str(error))
    if not all(find_spec(name) for name in ("torch", "stable_baselines3")):
        return _refuse(console, INSTALL)
    out = options.out or Path("results") / "deep" / recipe.name
    command = "python -m rl.train " + " ".join(sys.argv[1:] if arguments is None else arguments)
    try:
        return _train(options, recipe, out, command.strip(), console)
    except KeyboardInterrupt:
        console.print(
            "\nStopped. What was learned up to the last evaluation is kept: the same command goes on from there."
        )
        raise SystemExit(130) from None
    except (ImportError, OSError, ValueError) as error:
        return _refuse(console, str(error))


def _refuse(console: Console, why: str) -> Any:
    console.print(f"[bold red]Error:[/] {escape(why)}", soft_wrap=True)
    raise SystemExit(2)


def _train(options: Options, recipe: DeepRecipe, out: Path, command: str, console: Console) -> list[DeepTraining]:
    """Train all seeds, in this process or in several, with a progress bar for each."""
    seeds = range(options.seed, options.seed + options.seeds)
    folders = {seed: out / f"seed-{seed}" for seed in seeds}
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    done: dict[int, DeepTraining] = {}
    with Progress(*columns, console=console) as progress:
        bars = {seed: progress.add_task(f"{recipe.name}, seed {seed}", total=recipe.steps) for seed in seeds}

        def show(seed: int, seen: Evaluation) -> None:
            words = f"{recipe.name}, seed {seed}, {_score(recipe, seen)}"
            progress.update(TaskID(bars[seed]), completed=min(seen.steps, recipe.steps), description=words)

        if min(options.workers, options.seeds) == 1:
            for seed, folder in folders.items():
                done[seed] = train_deep(
                    recipe, seed, out=folder, command=command, progress=lambda seen, seed=seed: show(seed, seen)
                )
        else:
            context = get_context("spawn")
            with context.Manager() as manager:
                news: Any = manager.Queue()
                pool = ProcessPoolExecutor(options.workers, mp_context=context, initializer=_follow_parent)
                try:
                    jobs = {
                        seed: pool.submit(_train_one, recipe, seed, folder, command, news)
                        for seed, folder in folders.items()
                    }
                    while True:
                        finished, going = wait(jobs.values(), timeout=0.5, return_when=FIRST_EXCEPTION)
                        _tell(news, show)
                        if not going or any(job.exception() for job in finished):
                            break
                    done = {seed: job.result() for seed, job in jobs.items()}
                except BaseException:
                    processes = list(pool._processes.values())
                    pool.shutdown(wait=False, cancel_futures=True)
                    for process in processes:
                        process.terminate()
                    raise
                pool.shutdown()
    table = Table(
        "seed", "best after", "success" if not recipe.env else "mean return", "environment steps", "CPU s", "s"
    )
    for seed, training in done.items():
        best, last = training.best, training.curve[-1]
        score = f"{best.score:.1%}" if not recipe.env else f"{best.score:.0f}"
        table.add_row(
            str(seed),
            f"{best.steps:,}",
            score,
            f"{last.steps:,}",
            f"{last.cpu_seconds:.0f}",
            f"{last.wall_seconds:.0f}",
        )
    Console().print(table)
    Console().print(f"Policies, curves and settings are in {out}/.", soft_wrap=True, highlight=False)
    return list(done.values())


def _score(recipe: DeepRecipe, seen: Evaluation) -> str:
    return f"return {seen.score:.0f}" if recipe.env else f"{seen.success:.0%} succeed"


def _tell(news: Any, show: Any) -> None:
    while True:
        try:
            show(*news.get_nowait())
        except Empty:
            return


def _train_one(recipe: DeepRecipe, seed: int, folder: Path, command: str, news: Any) -> DeepTraining:
    return train_deep(recipe, seed, out=folder, command=command, progress=lambda seen: news.put((seed, seen)))


def _follow_parent() -> None:
    """Leave Ctrl-C to the parent, and end with it even where it is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()

    def end_with_parent() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()


if __name__ == "__main__":
    main()
