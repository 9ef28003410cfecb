"""The one runner of all studies: jobs to rows, rows to a table on disk, the table to figures.

A study is a module with a docstring that says question, method and finding, and with ``Options``, ``Row``, ``jobs``,
``run``, ``plot`` and ``summary`` (see :class:`Study`), ``films`` where its options have such a flag, and ``pages``
where it writes texts: their file names and what stands in them, from rows and traces.  Each finished
job is a small file of its own, written at once or not at all, so a study that was stopped in any way goes on where it
was, and no row is lost or doubled.  That file is named after everything the result depends on: job, options and source
code.
"""

from __future__ import annotations

import csv
import hashlib
import importlib
import inspect
import json
import os
import re
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, field, fields
from multiprocessing import get_context, parent_process
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol, cast, get_type_hints

import numpy as np
import tyro
from matplotlib.figure import Figure
from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from dpend.params import Array
from dpend.provenance import fingerprint, versions

Traces = dict[str, dict[str, Array]]
"""Arrays for the figure, by job and by name."""

Figures = Figure | Mapping[str, Figure]
"""One figure, or several by what is added to the study's name."""

_ROOT = Path(__file__).parent.parent


@dataclass(frozen=True, kw_only=True)
class Options:
    """What every study can be told on the command line."""

    out: Path | None = None
    """Folder for table, figure and unfinished work; left out, results/ and the study's name (and -quick)."""
    seed: int = 0
    """What all randomness is drawn from."""
    workers: int = field(default_factory=lambda: os.cpu_count() or 1)
    """Processes that share the work."""
    quick: bool = False
    """A small version that ends in seconds and shows that everything works; its figures mean little."""

    def __post_init__(self) -> None:
        self.check_least(1, "workers")
        self.check_least(0, "seed")

    def check_least(self, least: int, *names: str) -> None:
        """Refuse numbers that are too small.

        Raises
        ------
        ValueError
            If an option of one of these names is less.
        """
        for name in names:
            if getattr(self, name) < least:
                raise ValueError(f"--{name.replace('_', '-')} must be at least {least}; got {getattr(self, name)}.")


class UnwritableError(Exception):
    """The folder of a study's results cannot be written; the message says which, and why."""


class Job(NamedTuple):
    """One unit of work: a setting of the study, and the number of its repetition."""

    setting: str
    repetition: int = 0
    source: str = ""
    """What code from outside the package it depends on: a place and a fingerprint."""


class Result(NamedTuple):
    """What a job gave: rows of the table, and arrays for the figure by name."""

    rows: Sequence[Any]
    traces: Mapping[str, Array] = MappingProxyType({})


class Study(Protocol):
    """What the module of a study holds."""

    Options: type[Options]
    """The options, a subclass of :class:`Options`."""
    Row: type[Any]
    """A dataclass of numbers and words: one line of the table."""

    def jobs(self, options: Any, /) -> list[Job]:
        """List the work."""
        ...

    def run(self, job: Job, options: Any, /) -> Result:
        """Do one job; the same job and options give the same result."""
        ...

    def plot(self, rows: list[Any], traces: Traces, /) -> Figures:
        """Draw the figure, or several by name, from the saved table."""
        ...

    def summary(self, rows: list[Any], traces: Traces, /) -> RenderableType:
        """Condense the table for the terminal."""
        ...


def main(name: str, arguments: Sequence[str] | None = None) -> list[Any]:
    """Run a study from its command line.

    Parameters
    ----------
    name : str
        The module's name, such as ``"studies.lambda_sweep"``.
    arguments : sequence of str, optional
        The command line; left out, the program's own.

    Returns
    -------
    list
        The rows of the table.
    """
    study = cast(Study, importlib.import_module(name))
    console = Console(stderr=True, highlight=False)
    try:
        options = tyro.cli(study.Options, args=arguments, description=inspect.getdoc(study), prog=f"python -m {name}")
        return run_study(name, options)
    except UnwritableError as error:
        console.print(f"[bold red]Error:[/] {error}", soft_wrap=True)
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        console.print("\nStopped. Finished jobs are kept: the same command goes on from here.")
        raise SystemExit(130) from None


def run_study(name: str, options: Options) -> list[Any]:
    """Run a study, or what is left of it; write ``rows.csv``, ``traces.npz``, ``meta.json`` and the figure.

    Parameters
    ----------
    name : str
        The module's name.
    options : Options
        Its options.

    Returns
    -------
    list
        The rows of the table.

    Raises
    ------
    UnwritableError
        Before anything runs, if the folder cannot be written.
    """
    began = time.perf_counter()
    study = cast(Study, importlib.import_module(name))
    short = name.removeprefix("studies.")
    out = _writable(options.out or Path("results") / (f"{short}-quick" if options.quick else short))
    all_jobs = study.jobs(options)
    files = {job: out / "jobs" / f"{slug(job)}-{_key(name, job, options)}.json" for job in all_jobs}
    missing = [(job, options, file) for job, file in files.items() if not file.exists()]
    _do(name, missing, len(files), options.workers)

    results = {job: json.loads(file.read_text()) for job, file in files.items()}
    _write_rows(out / "rows.csv", study.Row, [row for result in results.values() for row in result["rows"]])
    _write_traces(out / "traces.npz", {slug(job): result["traces"] for job, result in results.items()})
    meta = {
        "study": name,
        "options": asdict(options) | {"out": None},
        "jobs": len(files),
        "jobs_done_earlier": len(files) - len(missing),
        "source": _source(name),
        "versions": versions(),
        "job_seconds": sum(result["seconds"] for result in results.values()),
        "wall_seconds": time.perf_counter() - began,
    }
    _write(out / "meta.json", json.dumps(meta, indent=2, default=str) + "\n")

    rows = read_rows(out / "rows.csv", study.Row)
    traces = read_traces(out / "traces.npz")
    figures = study.plot(rows, traces)
    for added, figure in (figures if isinstance(figures, Mapping) else {"": figures}).items():
        figure.savefig(out / f"{short}{added}.png", dpi=200)
    if getattr(options, "films", False):
        cast(Any, study).films(rows, traces, out)
    if hasattr(study, "pages"):
        for page, text in cast(Any, study).pages(rows, traces).items():
            _write(out / page, text)
    console = Console()
    console.print(study.summary(rows, traces))
    console.print(f"Figure, table and settings are in {out}/.", soft_wrap=True, highlight=False)
    return rows


def _do(name: str, work: list[tuple[Job, Options, Path]], total: int, workers: int) -> None:
    """Do jobs, in this process or in several, with a progress bar."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True)) as progress:
        bar = progress.add_task(name, total=total, completed=total - len(work))
        if min(workers, len(work)) <= 1:
            for job, options, file in work:
                _do_one(name, job, options, file)
                progress.advance(bar)
            return
        pool = ProcessPoolExecutor(min(workers, len(work)), mp_context=get_context("spawn"), initializer=_follow_parent)
        try:
            for done in as_completed([pool.submit(_do_one, name, *item) for item in work]):
                done.result()
                progress.advance(bar)
        except BaseException:
            processes = list(pool._processes.values())
            pool.shutdown(wait=False, cancel_futures=True)
            for process in processes:
                process.terminate()
            raise
        pool.shutdown()


def _follow_parent() -> None:
    """Leave Ctrl-C to the parent, and end with it even where it is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()

    def end_with_parent() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()


def _do_one(name: str, job: Job, options: Options, file: Path) -> None:
    study = cast(Study, importlib.import_module(name))
    began = time.perf_counter()
    result = study.run(job, options)
    record = {
        "job": job,
        "rows": [asdict(row) for row in result.rows],
        "traces": {key: np.asarray(trace).tolist() for key, trace in result.traces.items()},
        "seconds": time.perf_counter() - began,
    }
    _write(file, json.dumps(record))


def _writable(out: Path) -> Path:
    """Make the folder and show that files can be written there."""
    try:
        (out / "jobs").mkdir(parents=True, exist_ok=True)
        probe = out / "jobs" / f".probe-{os.getpid()}"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise UnwritableError(
            f"Cannot write to --out {out} ({error.strerror}); choose a folder that you may write to."
        ) from error
    return out


def _write(file: Path, text: str) -> None:
    """Write a file at once or not at all."""
    part = file.with_name(f".{file.name}.{os.getpid()}")
    part.write_text(text, encoding="utf-8")
    part.replace(file)


def _source(name: str) -> str:
    """Hash all code that a result may depend on, and what is shipped beside it: trajectories and trained policies."""
    packages = [_ROOT / package for package in ("dpend", "controllers", "controllers/data", "rl")]
    shipped = [*(_ROOT / "controllers" / "data").glob("*.npz"), *(_ROOT / "rl" / "trained").glob("*.npz")]
    study = (*Path(__file__).parent.glob("_*.py"), _ROOT / (name.replace(".", "/") + ".py"))
    return fingerprint(*packages, *shipped, *study)


def _key(name: str, job: Job, options: Options) -> str:
    """Hash everything a job's result depends on."""
    # Who takes part stands in the jobs, so that one who joins leaves the others' results as they are.
    aside = ("out", "workers", "controller", "only")
    told = {key: value for key, value in asdict(options).items() if key not in aside}
    text = json.dumps([_source(name), versions(), job, told], sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def slug(job: Job) -> str:
    """Return the name under which a job's file and traces are kept."""
    return re.sub(r"[\s/\\|:]", "_", f"{job.setting}-{job.repetition}")


def _write_rows(file: Path, row_type: type[Any], rows: list[dict[str, Any]]) -> None:
    part = file.with_name(f".{file.name}.{os.getpid()}")
    with part.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, [column.name for column in fields(row_type)])
        writer.writeheader()
        writer.writerows(rows)
    part.replace(file)


def read_rows(file: Path, row_type: type[Any]) -> list[Any]:
    """Read a study's table.

    Parameters
    ----------
    file : Path
        Its ``rows.csv``.
    row_type : type
        The study's ``Row``; its annotations say what each column is.

    Returns
    -------
    list
        One ``Row`` a line.
    """
    hints = get_type_hints(row_type)
    convert: dict[str, Callable[[str], Any]] = {
        name: (lambda text: text == "True") if hint is bool else hint for name, hint in hints.items()
    }
    with file.open(newline="", encoding="utf-8") as stream:
        return [
            row_type(**{name: convert[name](text) for name, text in line.items()}) for line in csv.DictReader(stream)
        ]


def kept_table(name: str) -> Path:
    """Return the ``rows.csv`` of a study that is shipped: in the package where it is installed, else in docs/results.

    Parameters
    ----------
    name : str
        The study, such as ``"recoverable"``.

    Returns
    -------
    Path
    """
    installed = Path(__file__).parent / "data" / f"{name}.csv"
    return installed if installed.exists() else _ROOT / "docs" / "results" / name / "rows.csv"


def _write_traces(file: Path, traces: dict[str, dict[str, list[float]]]) -> None:
    part = file.with_name(f".{file.name}.{os.getpid()}")
    flat = {f"{job}|{name}": np.asarray(trace) for job, named in traces.items() for name, trace in named.items()}
    with part.open("wb") as stream:
        np.savez_compressed(stream, **cast(Any, flat))
    part.replace(file)


def read_traces(file: Path) -> Traces:
    """Read the arrays that a study saved for its figure: by job (``setting-repetition``), by name."""
    traces: Traces = {}
    with np.load(file, allow_pickle=False) as stored:
        for key in stored.files:
            job, name = key.split("|")
            traces.setdefault(job, {})[name] = stored[key]
    return traces


def studies() -> Iterator[str]:
    """Return the names of the modules in this folder that are studies."""
    for file in sorted(Path(__file__).parent.glob("*.py")):
        if not file.stem.startswith("_"):
            yield f"studies.{file.stem}"
