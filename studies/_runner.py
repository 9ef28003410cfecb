"""The one runner of all studies: jobs to results, results to a table on disk, the table to a report.

A study is a module with a docstring that says question, method and finding, and with ``MINUTES``, ``Options``, ``Job``,
``jobs``, ``run`` and ``report`` (see :class:`Study`), and ``films`` where its options have such a flag.  Each finished
job is a file of its own, so that a study that was stopped in any way goes on where it was, and no row is lost or
doubled.  That file is named after a hash of everything the result depends on: the job, the code that ``run`` reaches
with the data shipped beside it, and the versions of the libraries.
"""

from __future__ import annotations

import hashlib
import importlib
import inspect
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from enum import Enum
from functools import partial
from multiprocessing import current_process, get_context, parent_process
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, Protocol, cast

import numpy as np
import pandas as pd
import tyro
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from dpend.provenance import versions

from ._closure import kept_table, source_hash
from ._figures import look
from ._table import AnyArray, Table, UnwritableError, load, read_rows, save, where, whole_file
from ._tables import Sheet, document, terminal

__all__ = [
    "Options", "Report", "Result", "Study", "Table", "kept_table", "main", "read_rows", "run_study", "studies", "where",
]  # fmt: skip

QUICK = "quick run: too few runs to mean much"
"""What stands on everything that a quick run makes."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of every study's command line."""

    out: Path | None = None
    """Folder for table, figures and unfinished work; left out, results/ and the study's name (and -quick)."""
    seed: int = 0
    """What all randomness is drawn from."""
    workers: int = field(default_factory=lambda: os.cpu_count() or 1)
    """Processes that share the work."""
    quick: bool = False
    """A small version that ends in seconds and shows that everything works; its figures mean little."""
    format: Literal["png", "pdf", "svg"] = "png"
    """File format of the figures."""

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


class Result(NamedTuple):
    """What a job returns: rows of the table, at least one, as dictionaries or dataclasses; and arrays by name."""

    rows: Sequence[Any]
    arrays: Mapping[str, AnyArray] = MappingProxyType({})


@dataclass(frozen=True, kw_only=True)
class Report:
    """What is drawn and written from a table.

    Attributes
    ----------
    figures : Figure or mapping of str to Figure
        One figure, or several by what is added to the study's name.
    tables : sequence of Sheet
        What the terminal shows, as far as there is room, and ``tables.md`` in full.
    pages : mapping of str to str
        Texts by their file names.
    """

    figures: Figure | Mapping[str, Figure]
    tables: Sequence[Sheet]
    pages: Mapping[str, str] = field(default_factory=dict)


class Study(Protocol):
    """What the module of a study holds."""

    MINUTES: float
    """How long the full study takes on two processors."""
    Options: type[Options]
    """The options, a subclass of :class:`Options`."""
    Job: type[Any]
    """A frozen dataclass of plain values: all that the result of one unit of work depends on besides the code."""

    def jobs(self, options: Any, /) -> Sequence[Any]:
        """List the work, what takes longest first."""
        ...

    def run(self, job: Any, /) -> Result:
        """Do one job; the same job gives the same result."""
        ...

    def report(self, table: Table, /) -> Report:
        """Draw figures, tables and pages from the saved table alone."""
        ...


def main(name: str, arguments: Sequence[str] | None = None) -> Table:
    """Run a study from its command line.

    Parameters
    ----------
    name : str
        The module's name, such as ``"studies.lambda_sweep"``.
    arguments : sequence of str, optional
        The command line; left out, the program's own, and all work is done in processes of its own, so that Ctrl-C
        finds this one free.

    Returns
    -------
    Table
    """
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.default_int_handler)  # shells let background jobs inherit "ignore"
    study = cast(Study, importlib.import_module(name))
    console = Console(stderr=True, highlight=False, emoji=False)
    try:
        options = tyro.cli(study.Options, args=arguments, description=inspect.getdoc(study), prog=f"python -m {name}")
        if arguments is not None and options.workers == 1:
            return run_study(name, options)
        with _processes(options.workers) as executor:
            return run_study(name, options, executor)
    except UnwritableError as error:
        console.print(f"[bold red]Error:[/] {escape(str(error))} Finished jobs are kept.", soft_wrap=True)
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        console.print("\nStopped. Finished jobs are kept: the same command goes on from here.")
        if arguments is None:
            os._exit(130)  # at once: what Python does at its end may take a second
        raise SystemExit(130) from None


def run_study(name: str, options: Options, executor: Executor | None = None) -> Table:
    """Run a study, or what is left of it; write ``rows.csv``, ``arrays.npz``, ``meta.json``, figures and pages.

    Parameters
    ----------
    name : str
        The module's name.
    options : Options
        Its options.
    executor : Executor, optional
        What does the jobs, such as a pool of processes or the client of a cluster; left out, this process does them
        one after the other, or as many processes as ``options.workers`` says.

    Returns
    -------
    Table

    Raises
    ------
    UnwritableError
        If something cannot be written; before anything runs, if the folder cannot be.
    RuntimeError
        If processes cannot be started from where this is called.
    """
    if executor is None and options.workers > 1:
        with _processes(options.workers) as pool:
            return run_study(name, options, pool)
    began = time.perf_counter()
    study = cast(Study, importlib.import_module(name))
    short = name.removeprefix("studies.")
    out = _writable(options.out or Path("results") / (f"{short}-quick" if options.quick else short))
    jobs = study.jobs(options)
    files = {job: out / "jobs" / f"{key(name, job)}.npz" for job in jobs}
    if len(files) < len(jobs):
        raise ValueError(f"{name}: two of its jobs are the same.")
    missing = {job: file for job, file in files.items() if not file.exists()}
    _do(name, missing, len(files), executor)

    kept = [_read(file) for file in files.values()]
    rows = [
        {"job": number, **plain_fields(job), **row}
        for number, (job, (record, _)) in enumerate(zip(files, kept, strict=True))
        for row in record["rows"]
    ]
    by_job = {number: arrays for number, (_, arrays) in enumerate(kept) if arrays}
    meta = {
        "study": name,
        "options": asdict(options) | {"out": None},
        "jobs": len(files),
        "jobs_done_earlier": len(files) - len(missing),
        "source": source_hash(name),
        "versions": versions(),
        "job_seconds": sum(record["seconds"] for record, _ in kept),
        "wall_seconds": time.perf_counter() - began,
    }
    save(Table(pd.DataFrame(rows), options.quick, by_job), out, meta)
    table = load(out)
    _publish(study, table, options, out, short)
    return table


def _publish(study: Study, table: Table, options: Options, out: Path, short: str) -> None:
    """Draw and write a table's report, and show what belongs on the terminal."""
    with look():
        report = study.report(table)
        several = report.figures if isinstance(report.figures, Mapping) else {"": report.figures}
        for added, figure in several.items():
            if table.quick:
                _mark(figure)
            _write(out / f"{short}{added}.{options.format}", figure.savefig)
    tables = document(f"{short}: all tables", report.tables, f"A {QUICK}." if table.quick else "")
    for page, text in {"tables.md": tables, **report.pages}.items():
        _write(out / page, partial(_write_text, text=text))
    if getattr(options, "films", False):
        for film, write in cast(Any, study).films(table).items():
            _write(out / film, write)
    console = Console(highlight=False, emoji=False)
    for each in report.tables:
        console.print(terminal(each, console.width), "")
    if table.quick:
        console.print(f"[bold]{QUICK.capitalize()}.[/]")
    console.print(f"Figures, table and settings are in {escape(str(out))}/.", soft_wrap=True)


def _mark(figure: Figure) -> None:
    """Write below a figure that it comes from a quick run."""
    room = 0.16 / figure.get_figheight()
    if isinstance(engine := figure.get_layout_engine(), ConstrainedLayoutEngine):
        engine.set(rect=(0, room, 1, 1 - room))
    figure.text(0.995, 0.2 * room, QUICK, ha="right", va="bottom", fontsize=7, color="#B00020")


def _write(path: Path, write: Callable[[Path], object]) -> None:
    with whole_file(path) as part:
        write(part)


def _write_text(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")


# --------------------------------------------------------------------------------------------------------------- jobs


def key(name: str, job: Any) -> str:
    """Return a hash of everything a job's result depends on.

    Parameters
    ----------
    name : str
        The study's module.
    job : dataclass
        The job.

    Returns
    -------
    str
        Twenty hexadecimal digits.

    Raises
    ------
    TypeError
        If the job holds something else than plain values.
    """
    libraries = {library: version for library, version in versions().items() if library != "matplotlib"}
    text = json.dumps([source_hash(name), libraries, _plain(job)], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:20]


def _plain(value: Any) -> Any:
    """Return a value as JSON has it, types of dataclasses named."""
    if value is None or isinstance(value, str | bool | int | float):
        return value
    if is_dataclass(value) and not isinstance(value, type):
        return [type(value).__name__, {each.name: _plain(getattr(value, each.name)) for each in fields(value)}]
    if isinstance(value, Enum):
        return [type(value).__name__, value.name]
    if isinstance(value, tuple):
        return [_plain(each) for each in value]
    raise TypeError(
        "A job is a frozen dataclass of numbers, words, None, enums, tuples and such dataclasses; "
        f"got {type(value).__name__} {value!r}."
    )


def plain_fields(job: Any) -> dict[str, Any]:
    """Return the fields of a job that become columns of the table: numbers, words and truth values."""
    return {
        each.name: value
        for each in fields(job)
        if isinstance(value := getattr(job, each.name), str | bool | int | float)
    }


def _do(name: str, work: Mapping[Any, Path], total: int, executor: Executor | None) -> None:
    """Do jobs, here or by an executor, and keep each when it is done, with a progress bar."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True)) as progress:
        bar = progress.add_task(name, total=total, completed=total - len(work))
        for job, content in _done(name, work, executor):
            _write(work[job], partial(_savez, content=content))
            progress.advance(bar)


def _done(
    name: str, work: Mapping[Any, Path], executor: Executor | None
) -> Iterator[tuple[Hashable, dict[str, AnyArray]]]:
    """Return jobs with what is to be kept of them, in the order in which they end."""
    if executor is None:
        yield from ((job, _do_one(name, job)) for job in work)
        return
    waiting: dict[Future[dict[str, AnyArray]], Any] = {executor.submit(_do_one, name, job): job for job in work}
    try:
        for future in as_completed(waiting):
            yield waiting[future], future.result()
    except BrokenProcessPool as error:
        raise RuntimeError(
            "The worker processes ended before their work did.  A script that starts some needs its calls below "
            "'if __name__ == \"__main__\":' in a file; else use workers=1.  If it has that, memory may have run out."
        ) from error


def _do_one(name: str, job: Any) -> dict[str, AnyArray]:
    """Return what is kept of a job: its arrays, and a record as JSON."""
    began = time.perf_counter()
    result = cast(Study, importlib.import_module(name)).run(job)
    rows = [row if isinstance(row, dict) else asdict(row) for row in result.rows]
    names = {tuple(row) for row in rows}
    if len(names) != 1:
        raise ValueError(f"{name}: a job returns rows, at least one, all with the same fields; got {sorted(names)}.")
    if twice := rows[0].keys() & {"job", *plain_fields(job)}:
        raise ValueError(f"{name}: {', '.join(sorted(twice))} is a field of the job and of the row; one is enough.")
    record = {"rows": rows, "seconds": time.perf_counter() - began}
    text = json.dumps(record, default=lambda value: value.item())  # numpy's numbers
    return {"record": np.array(text)} | {f"|{name}": np.asarray(array) for name, array in result.arrays.items()}


def _savez(path: Path, content: dict[str, AnyArray]) -> None:
    np.savez_compressed(path, allow_pickle=False, **cast(Any, content))


def _read(file: Path) -> tuple[dict[str, Any], dict[str, AnyArray]]:
    with np.load(file, allow_pickle=False) as stored:
        arrays = {name.removeprefix("|"): stored[name] for name in stored.files if name.startswith("|")}
        return json.loads(str(stored["record"])), arrays


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


# ---------------------------------------------------------------------------------------------------------- processes


@contextmanager
def _processes(workers: int) -> Iterator[Executor]:
    """Return a pool of processes that end with this one, at once where the block is left by an exception."""
    main_module = sys.modules["__main__"]
    if getattr(current_process(), "_inheriting", False) or str(getattr(main_module, "__file__", "")) == "<stdin>":
        raise RuntimeError(
            "Worker processes import the script that started them.  Put its calls below "
            "'if __name__ == \"__main__\":' in a file, or use workers=1."
        )
    pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_follow_parent)
    try:
        yield pool
    except BaseException:
        processes = list((pool._processes or {}).values())
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


def studies() -> Iterator[str]:
    """Return the names of the modules in this folder that are studies."""
    for file in sorted(Path(__file__).parent.glob("*.py")):
        if not file.stem.startswith("_"):
            yield f"studies.{file.stem}"
