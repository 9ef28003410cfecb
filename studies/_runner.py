"""The one runner of all studies: jobs to results, results to a table on disk, the table to a report.

A study is a module with a docstring that says question, method and finding, and with ``MINUTES``, ``Options``, ``Job``,
``jobs``, ``run`` and ``report`` (see :class:`Study`), and ``films`` where its options have such a flag.  Each finished
job is a file of its own, so that a study that was stopped in any way goes on where it was, and no row is lost or
doubled.  That file is named after a hash of everything the result depends on: the job, the code that ``run`` reaches
and the data shipped beside it, as far as the job names them, and the versions of the libraries.

A contender may refuse a rig.  Then the study goes on without it and says so in a sentence; see :func:`_group`.
"""

from __future__ import annotations

import hashlib
import importlib
import inspect
import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, as_completed
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from enum import Enum
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Protocol, cast, get_type_hints

import numpy as np
import pandas as pd
import tyro
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

import dpend
from dpend import archive
from dpend.provenance import versions
from dpend.workers import interruptible, pool

from ._closure import closure, covered, kept_folder, kept_table, source_hash
from ._cluster import cluster
from ._figures import look
from ._help import help_of
from ._own import tried_on
from ._plant import DEFAULT_RIG, Plant, rig_of
from ._table import AnyArray, Table, load, read_rows, save, where
from ._tables import Sheet, document, terminal

__all__ = [
    "DEFAULT_RIG", "AtLeastTwo", "NonNegative", "Options", "Plant", "Positive", "Report", "Result", "Study", "Table",
    "kept_table", "main", "read_rows", "run_study", "studies", "where",
]  # fmt: skip

QUICK = "quick run: too few runs to mean much"
"""What stands on everything that a quick run makes."""
_JOB = "dpend study job 1"


class Least(NamedTuple):
    """The least that an option may be."""

    value: int


NonNegative = Annotated[int, Least(0)]
Positive = Annotated[int, Least(1)]
AtLeastTwo = Annotated[int, Least(2)]


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of every study's command line; it is a ValueError if one is less than its type allows.

    It is one too if the rig is none, describes several plants, or lacks a limit that the study ``needs``.
    """

    needs: ClassVar[tuple[Literal["force_limit", "ideal"], ...]] = ()
    """What a rig must have for the study to make sense: a limit of the force; ideal actuator and sensors, to learn."""

    rig: str = DEFAULT_RIG  # A preset, or a TOML file.
    set: tyro.conf.UseAppendAction[tuple[str, ...]] = ()  # Change a number of it: mass1=.6; repeatable.
    out: Path | None = None  # Folder for all that is written; left out, in results/.
    seed: NonNegative = 0  # What all randomness is drawn from.
    workers: Positive = field(default_factory=lambda: os.cpu_count() or 1)  # Processes that share the work.
    scheduler: str | None = None  # Address of a Dask scheduler: its workers do it.
    quick: bool = False  # Few runs, to see in seconds that all works.
    format: Literal["png", "pdf", "svg"] = "png"  # File format of the figures.
    kept: bool = False  # Take jobs from docs/results that code, options and libraries like these have done.
    fresh: bool = False  # Take no results of others from docs/results beside your own.

    def __post_init__(self) -> None:
        for name, hint in get_type_hints(type(self), include_extras=True).items():
            for bound in getattr(hint, "__metadata__", ()):
                if isinstance(bound, Least) and getattr(self, name) < bound.value:
                    option = f"--{name.replace('_', '-')}"
                    raise ValueError(f"{option} must be at least {bound.value}; got {getattr(self, name)}.")
        if self.kept and self.fresh:
            raise ValueError("--kept takes results from docs/results and --fresh takes none: give one of them.")
        rig = self.plant.rig
        if rig.n is not None:
            raise ValueError(
                f"--rig {self.rig}: a study is of one plant; this describes {rig.n}. Keep one of each field."
            )
        if "force_limit" in self.needs and not np.isfinite(rig.force_limit):
            raise ValueError(f"--rig {self.rig} has no force limit, which this study needs; --set force_limit=40.")
        if "ideal" in self.needs and not rig.ideal:
            raise ValueError(
                f"--rig {self.rig} has lag, delay, noise or rounding, and what learns in this study learns on ideal "
                "rigs; set that to zero, as --set sensor_noise=0 does for noise."
            )

    @property
    def plant(self) -> Plant:
        """The rig with its changes, as a job holds it.

        Raises
        ------
        ValueError
            If there is no such rig, or a change is none.
        """
        changes: dict[str, float] = {}
        for change in self.set:
            name, _, value = change.partition("=")
            try:
                changes[name] = int(value) if value.isdigit() else float(value)  # delays are whole numbers
            except ValueError:
                raise ValueError(f"--set must be name=number, such as mass1=.6; got {change!r}.") from None
        try:
            rig = dpend.rig(self.rig).replace(**cast(Any, changes))
        except (OSError, TypeError) as error:
            raise ValueError(f"--rig {self.rig}: {error}") from error
        return Plant(", ".join([self.rig, *self.set]), json.dumps(rig.to_dict(), default=np.ndarray.tolist))

    @property
    def elsewhere(self) -> Plant | None:
        """The plant where it is another than that of the comparisons, for which policies and tables are shipped."""
        return None if self.plant.rig == rig_of(None) else self.plant

    @property
    def absent(self) -> Sequence[str]:
        """Who takes no part, and why, in sentences."""
        return ()

    @property
    def joining(self) -> bool:
        """Whether something of the user's own joins what comes with the project, so that results of that are reused."""
        return False


class NobodyTakesPart(ValueError):
    """A study that has nothing to do: its options leave nobody in, or all refuse the rig."""


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
        What the terminal shows, as far as there is room, and ``tables.md`` in full; those without lines are left out.
    pages : mapping of str to str
        Texts by their file names.
    """

    figures: Figure | Mapping[str, Figure]
    tables: Sequence[Sheet]
    pages: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "tables", [each for each in self.tables if each.lines])


class Study(Protocol):
    """What the module of a study holds."""

    MINUTES: float  # How long the full study takes on two processors.
    Options: type[Options]  # The options, a subclass of :class:`Options`.
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
    """
    study = cast(Study, importlib.import_module(name))
    console = Console(stderr=True, highlight=False, emoji=False)
    program, given = f"python -m {name}", sys.argv[1:] if arguments is None else arguments
    if {"-h", "--help"} & {*given}:
        print(help_of(study.Options, program, (inspect.getdoc(study) or "").partition("\n\n")[0]))
        raise SystemExit(0)
    try:
        options = tyro.cli(study.Options, args=arguments, prog=program)
        with interruptible():
            if arguments is not None and options.workers == 1 and not options.scheduler:
                return run_study(name, options)
            with cluster(options.scheduler, key) if options.scheduler else pool(options.workers) as executor:
                return run_study(name, options, executor)
    except NobodyTakesPart as error:
        console.print(f"[bold red]Error:[/] {escape(str(error))}", soft_wrap=True)
        raise SystemExit(2) from None
    except OSError as error:
        reason = error if error.filename else error.strerror or error
        console.print(f"[bold red]Error:[/] {escape(str(reason))}. Finished jobs are kept.", soft_wrap=True)
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

    Raises
    ------
    OSError
        If something cannot be written; before anything runs, if the folder cannot be.
    NobodyTakesPart
        If there is no job, or of every one the contender refuses the rig.
    RuntimeError
        If processes cannot be started from where this is called.
    """
    if executor is None and options.workers > 1:
        with pool(options.workers) as processes:
            return run_study(name, options, processes)
    began = time.perf_counter()
    study = cast(Study, importlib.import_module(name))
    short = name.removeprefix("studies.")
    out = _writable(options.out or Path("results") / (f"{short}-quick" if options.quick else short))
    for sentence in options.absent:
        print(sentence)
    jobs = study.jobs(options)
    if not jobs:
        raise NobodyTakesPart(f"Of those that were asked for nobody takes part{_on(options)}.")
    keys = {job: key(name, job) for job in jobs}
    if len(keys) < len(jobs):
        raise ValueError(f"{name}: two of its jobs are the same.")
    files = {job: out / "jobs" / f"{digits}.npz" for job, digits in keys.items()}
    done = {job: work for job, file in files.items() if (work := _finished(file))}
    reusing = options.kept or (options.joining and not options.fresh)
    kept = _kept(short) if reusing and not options.elsewhere else {}
    shipped = {job: kept[digits] for job, digits in keys.items() if job not in done and digits in kept}
    if shipped:
        otherwise = "without --kept all are computed here" if options.kept else "--fresh computes them here"
        print(f"{len(shipped)} of {len(keys)} jobs come from {kept_folder(short)}; {otherwise}.")
    elif kept and kept.keys().isdisjoint(keys.values()):
        print(f"None of {len(keys)} jobs comes from {kept_folder(short)}, {_differs(name)}; all are computed here.")
    done |= shipped
    earlier = len(done)
    did, refusals = _do(name, {job: file for job, file in files.items() if job not in done}, len(files), executor)
    done |= did
    keys = {job: digits for job, digits in keys.items() if _group(job) not in refusals}
    if not keys:
        raise NobodyTakesPart(f"Nobody takes part{_on(options)}: {' '.join(dict.fromkeys(refusals.values()))}")
    for (contender, *details), why in refusals.items():
        print(" ".join([contender, *(f"({each})" for each in details), f"takes no part: {why}"]))

    works = [done[job] for job in keys]
    rows = [
        {"job": number, **plain_fields(job), **row}
        for number, (job, work) in enumerate(zip(keys, works, strict=True))
        for row in work.record["rows"]
    ]
    by_job = {number: work.arrays for number, work in enumerate(works) if work.arrays}
    meta = {
        "study": name,
        "options": asdict(options) | {"out": None},
        "jobs": len(keys),
        "jobs_done_earlier": earlier,
        "source": source_hash(name),
        "versions": versions(),
        "job_seconds": sum(work.record["seconds"] for work in works),
        "wall_seconds": time.perf_counter() - began,
        "row_columns": list(works[0].record["rows"][0]),
        "keys": {digits: work.record["seconds"] for digits, work in zip(keys.values(), works, strict=True)},
    }
    save(Table(pd.DataFrame(rows), options.quick, by_job, options.elsewhere), out, meta)
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
        _write(out / page, partial(Path.write_text, data=text, encoding="utf-8"))
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
    with archive.atomic(path) as part:
        write(part)


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
    plain = _plain(job)
    text = json.dumps([source_hash(name, _words(plain)), _libraries(), plain], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:20]


def _libraries() -> dict[str, str]:
    return {library: version for library, version in versions().items() if library != "matplotlib"}


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


def _words(plain: Any) -> frozenset[str]:
    """Return the words in a job as JSON has it."""
    if isinstance(plain, str):
        return frozenset({plain})
    held = plain.values() if isinstance(plain, dict) else plain if isinstance(plain, list) else ()
    return frozenset().union(*map(_words, held))


def plain_fields(job: Any) -> dict[str, Any]:
    """Return the fields of a job that become columns of the table: numbers, words, truth values, a plant's name."""
    values = {each.name: getattr(job, each.name) for each in fields(job)}
    named = {name: value.name if isinstance(value, Plant) else value for name, value in values.items()}
    return {name: value for name, value in named.items() if isinstance(value, str | bool | int | float)}


class _Work(NamedTuple):
    """What is kept of a finished job: its rows and the seconds it took, and its arrays."""

    record: dict[str, Any]
    arrays: dict[str, AnyArray]


def _finished(file: Path) -> _Work | None:
    """Return a job that was finished earlier; none where there is no file or a damaged one."""
    try:
        return _Work(*archive.read(file, _JOB))
    except (FileNotFoundError, ValueError):
        return None


def _kept(short: str) -> dict[str, _Work]:
    """Return the jobs of the table that comes with the project, by key."""
    folder = kept_folder(short)
    meta = json.loads((folder / "meta.json").read_text(encoding="utf-8")) if folder else {}
    if folder is None or "keys" not in meta:
        return {}
    table = load(folder)
    rows: dict[int, list[dict[str, Any]]] = {}
    records = cast(Any, table.rows[meta["row_columns"]]).to_dict("records")
    for number, record in zip(table.rows["job"], records, strict=True):
        rows.setdefault(number, []).append(record)
    return {
        digits: _Work({"rows": rows[number], "seconds": seconds}, dict(table.by_job.get(number, {})))
        for number, (digits, seconds) in enumerate(meta["keys"].items())
    }


def _differs(name: str) -> str:
    """Return why no job of a study is in the table that comes with the project."""
    folder, here = kept_folder(name.removeprefix("studies.")), _libraries()
    assert folder is not None
    meta = json.loads((folder / "meta.json").read_text(encoding="utf-8"))
    there = meta["versions"]
    others = [f"{each} {there.get(each, 'none')} (here {here.get(each, 'none')})"
              for each in sorted({*there, *here} - {"matplotlib"}) if there.get(each) != here.get(each)]  # fmt: skip
    if others:
        return f"which was computed with {', '.join(others)}"
    return "which has other sources" if meta["source"] != source_hash(name) else "which has other options"


class _Refused(NamedTuple):
    """Why a job is not done: what its contender says of the rig, or how a user's own fails on it."""

    why: str


def _group(job: Any) -> tuple[str, ...]:
    """Return with which others a job stands and falls: those of its contender or learner at a task, on a preset.

    The table lacks all of a group if one of its jobs is refused, since half of a comparison is none.
    """
    values = [getattr(job, name, None) for name in ("contender", "learner", "task", "rig")]
    return tuple(value for value in values if isinstance(value, str))


def _elsewhere(job: Any) -> Plant | None:
    """Return the plant of a job where it is another than that of the comparisons."""
    plant = getattr(job, "elsewhere", None) or getattr(job, "plant", None)
    return plant if isinstance(plant, Plant) and plant.rig != rig_of(None) else None


def _on(options: Options) -> str:
    return f" on {plant.name}" if (plant := options.elsewhere) else ""


def _do(
    name: str, work: Mapping[Any, Path], total: int, executor: Executor | None
) -> tuple[dict[Any, _Work], dict[tuple[str, ...], str]]:
    """Do jobs, here or by an executor, and keep each when it is done, with a progress bar; return refusals by group."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    done: dict[Any, _Work] = {}
    refusals: dict[tuple[str, ...], str] = {}
    with Progress(*columns, console=Console(stderr=True)) as progress:
        bar = progress.add_task(name, total=total, completed=total - len(work))
        for job, each in _done(name, work, executor):
            if isinstance(each, _Refused):
                refusals.setdefault(_group(job), each.why)
            else:
                archive.write(work[job], _JOB, each.record, each.arrays)
                done[job] = each
            progress.advance(bar)
    return done, refusals


def _done(name: str, work: Mapping[Any, Path], executor: Executor | None) -> Iterator[tuple[Any, _Work | _Refused]]:
    """Return jobs with what is to be kept of them, in the order in which they end; of a group one refusal is enough."""
    names = {job: closure(name, ("run", "Job"), _words(_plain(job)))[1] for job in work}
    refused: dict[tuple[str, ...], _Refused] = {}
    if executor is None:
        for job in work:
            each = refused.get(_group(job)) or _do_one(name, job, names[job])
            if isinstance(each, _Refused):
                refused[_group(job)] = each
            yield job, each
        return
    waiting = {executor.submit(_do_one, name, job, names[job]): job for job in work}
    for future in as_completed(waiting):
        job = waiting[future]
        each = refused[_group(job)] if future.cancelled() else future.result()
        if isinstance(each, _Refused) and _group(job) not in refused:
            refused[_group(job)] = each
            for other in (other for other, its in waiting.items() if _group(its) == _group(job)):
                other.cancel()
        yield job, each


def _do_one(name: str, job: Any, contenders: frozenset[str] | None) -> _Work | _Refused:
    """Do a job, which may look up the contenders of these names alone, those that its key covers.

    Another rig than that of the comparisons may be refused, and a user's own controller may fail anywhere; what comes
    with the project does neither on the rig of the comparisons, so that an error there is one.
    """
    began = time.perf_counter()
    elsewhere, own = _elsewhere(job), getattr(job, "own", None)
    tokens = covered.set(contenders), tried_on.set(elsewhere.rig if elsewhere else None)
    try:
        result = cast(Study, importlib.import_module(name)).run(job)
    except (ValueError, RuntimeError) as error:
        from controllers import NoTrajectory

        if not (elsewhere or own) or not isinstance(error, ValueError | NoTrajectory):
            raise
        return _Refused(" ".join(str(error).split()))
    finally:
        covered.reset(tokens[0])
        tried_on.reset(tokens[1])
    rows = [row if isinstance(row, dict) else asdict(row) for row in result.rows]
    names = {tuple(row) for row in rows}
    if len(names) != 1:
        raise ValueError(f"{name}: a job returns rows, at least one, all with the same fields; got {sorted(names)}.")
    if twice := rows[0].keys() & {"job", *plain_fields(job)}:
        raise ValueError(f"{name}: {', '.join(sorted(twice))} is a field of the job and of the row; one is enough.")
    return _Work({"rows": rows, "seconds": time.perf_counter() - began}, dict(result.arrays))


def _writable(out: Path) -> Path:
    """Make the folder and show that files can be written there."""
    try:
        (out / "jobs").mkdir(parents=True, exist_ok=True)
        probe = out / "jobs" / f".probe-{os.getpid()}"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise OSError(
            f"Cannot write to --out {out} ({error.strerror}); choose a folder that you may write to"
        ) from error
    return out


def studies() -> Iterator[str]:
    """Return the names of the modules in this folder that are studies."""
    for file in sorted(Path(__file__).parent.glob("*.py")):
        if not file.stem.startswith("_"):
            yield f"studies.{file.stem}"
