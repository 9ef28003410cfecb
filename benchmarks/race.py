"""Jobs that take turns on one core, and how many times as fast one is as another: the ratio of each turn.

What counts is processor time, where a job runs in this process: it hardly changes when the machine is busy with other
things, and where it does, both of a turn bear it.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

Job = Callable[[], float]
"""Does some work and tells how much of it was done, such as steps."""

TITLE: dict[str, Any] = {"title_justify": "left", "title_style": "bold"}
BUSY = 1.3  # wall clock by processor time above which turns were shared with something else


@dataclass(frozen=True, kw_only=True)
class Race:
    """What takes turns."""

    title: str
    counts: str  # What jobs count, such as "Runge-Kutta steps".
    jobs: Mapping[str, Job]
    pairs: Sequence[tuple[str, str, float | None]]
    """Which job stands against which peer, and the ratio of speeds that is asked for, if any."""
    turns: int = 10
    elsewhere: bool = False  # Whether jobs run in other processes or threads, so that only the wall clock counts.


class Ratio(NamedTuple):
    """How many times as fast a job is as its peer: the median over turns, with quartiles."""

    title: str
    counts: str
    ours: str
    peer: str
    speed: float  # Median of what ours does in a second.
    ratio: float
    low: float
    high: float
    asked: float  # NaN where nothing is.
    busy: float  # Wall clock by processor time; 1 on a quiet machine.

    @property
    def per_second(self) -> str:
        """The speed in words, to three digits."""
        return f"{float(f'{self.speed:.3g}'):,g}" if self.speed < 1e3 else f"{float(f'{self.speed:.3g}'):,.0f}"

    @property
    def spread(self) -> str:
        """The ratio with its quartiles."""
        return f"{self.ratio:.3g} [{self.low:.3g}, {self.high:.3g}]"

    @property
    def asked_for(self) -> str:
        """What was asked for and the verdict; nothing where nothing was."""
        return f"{self.asked:g}: {self.verdict}" if self.verdict else ""

    @property
    def verdict(self) -> str:
        """What may be said of what was asked for: met or missed, or that the turns do not tell."""
        if np.isnan(self.asked):
            return ""
        if self.low < self.asked < self.high:
            return "cannot tell"
        return "met" if self.ratio >= self.asked else "missed"


def run(race: Race, turns: int | None = None) -> list[Ratio]:
    """Let jobs take turns, after a first turn in which code is compiled, and return the ratios of each pair."""
    for job in race.jobs.values():
        job()
    speeds: dict[str, list[float]] = {name: [] for name in race.jobs}
    processor = wall = 0.0
    for _ in range(turns or race.turns):
        for name, job in race.jobs.items():
            began, own = perf_counter(), process_time()
            done = job()
            spent, elapsed = process_time() - own, perf_counter() - began
            speeds[name].append(done / (elapsed if race.elsewhere else spent))
            processor, wall = processor + spent, wall + elapsed
    busy = 1.0 if race.elsewhere else wall / processor
    found = []
    for ours, peer, asked in race.pairs:
        if ours in speeds and peer in speeds:
            low, middle, high = np.quantile(np.array(speeds[ours]) / speeds[peer], (0.25, 0.5, 0.75))
            wish = np.nan if asked is None else asked
            speed = float(np.median(speeds[ours]))
            found.append(
                Ratio(race.title, race.counts, ours, peer, speed, float(middle), float(low), float(high), wish, busy)
            )
    return found


def show(console: Console, ratios: Sequence[Ratio]) -> None:
    """Print ratios, a table a race."""
    for title in dict.fromkeys(each.title for each in ratios):
        own = [each for each in ratios if each.title == title]
        table = Table("", "peer", "1/s", "ratio [quartiles]", "asked", title=f"{title}: {own[0].counts}", **TITLE)
        for each in own:
            table.add_row(each.ours, each.peer, each.per_second, each.spread, each.asked_for)
        console.print(table)
        if own[0].busy > BUSY:
            console.print(f"Something else ran beside: a turn took {own[0].busy:.1f} times its processor time.")
        console.print()


def pin_to_one_core() -> None:
    """Keep this process on one of the cores it may use, where the system allows that."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


def processor() -> str:
    """Return the name of the processor and the width of its vectors, as far as the system tells.

    Where numba compiles for another, which its ``NUMBA_CPU_NAME`` says, that one is named too.
    """
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    entries = {name.strip(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
    flags = entries.get("flags", "").split()
    width = 512 if "avx512f" in flags else 256 if "avx2" in flags else 128
    code = f", code for {other}" if (other := os.environ.get("NUMBA_CPU_NAME")) else ""
    return f"{entries.get('model name', platform.machine())}, {width}-bit vectors{code}"


def versions(*packages: str) -> str:
    """Return Python's version and those of packages."""
    return ", ".join([f"Python {platform.python_version()}", *map(_version, packages)])


def _version(package: str) -> str:
    try:
        return f"{package} {version(package)}"
    except PackageNotFoundError:
        return f"no {package}"
