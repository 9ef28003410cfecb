"""Read the tables that studies wrote to ``docs/results/<study>/tables.md``: a heading, a table and a note each."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

RESULTS = Path(__file__).parent / "results"


@dataclass(frozen=True)
class Shown:
    """A table as text: headings, lines of as many cells, what stands below, and which columns hold words."""

    title: str
    headings: Sequence[str]
    lines: Sequence[Sequence[str]]
    note: str
    words: Sequence[bool]

    def line(self, *names: str) -> dict[str, str]:
        """Return the one line whose first cells are ``names``, by heading."""
        found = [line for line in self.lines if tuple(line[: len(names)]) == names]
        if len(found) != 1:
            raise LookupError(f"{self.title}: {len(found)} lines begin with {names}, not one.")
        return dict(zip(self.headings, found[0], strict=True))

    def part(
        self, columns: Sequence[str] = (), rows: Sequence[str] = (), where: Mapping[str, str] | None = None
    ) -> Shown:
        """Return the columns and rows that are named, in that order; left out, all; ``where`` columns hold a value."""
        for heading in (*columns, *(where or ())):
            if heading not in self.headings:
                raise LookupError(f"{self.title}: no column {heading!r}; there are: {'; '.join(self.headings)}.")
        lines = [
            line
            for line in self.lines
            if all(line[self.headings.index(heading)] == value for heading, value in (where or {}).items())
        ]
        for row in rows:
            if not any(_bare(line[0]) == row for line in lines):
                raise LookupError(f"{self.title}: no row {row!r}; there are: {'; '.join(_bare(e[0]) for e in lines)}.")
        if rows:
            lines = sorted((e for e in lines if _bare(e[0]) in rows), key=lambda e: rows.index(_bare(e[0])))
        kept = [self.headings.index(each) for each in columns or [h for h in self.headings if h not in (where or {})]]
        return Shown(
            self.title,
            [self.headings[i] for i in kept],
            [[line[i] for i in kept] for line in lines],
            self.note,
            [self.words[i] for i in kept],
        )


@cache
def tables(study: str) -> Sequence[Shown]:
    """Return all tables of a study, in order."""
    parts = re.split(r"^## ", (RESULTS / study / "tables.md").read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]
    return [each for each in map(_table, parts) if each is not None]


def table(study: str, title: str) -> Shown:
    """Return the table of a study whose title begins with ``title``; there must be one."""
    found = [each for each in tables(study) if each.title == title] or [
        each for each in tables(study) if each.title.startswith(title)
    ]
    if len(found) != 1:
        titles = "; ".join(each.title for each in tables(study))
        raise LookupError(f"{study}: {len(found)} tables begin with {title!r}, not one; there are: {titles}.")
    return found[0]


def _table(part: str) -> Shown | None:
    title, _, body = part.partition("\n")
    rows = [_cells(line) for line in body.splitlines() if line.startswith("|")]
    if len(rows) < 2:
        return None
    note = " ".join(line for line in body.splitlines() if line and not line.startswith("|"))
    return Shown(_unescaped(title.strip()), rows[0], rows[2:], _unescaped(note), [not c.endswith(":") for c in rows[1]])


def _cells(line: str) -> list[str]:
    return [_unescaped(each.strip()) for each in re.split(r"(?<!\\)\|", line.strip()[1:-1])]


def _unescaped(text: str) -> str:
    return re.sub(r"\\([\\|*_<>`(\[])", r"\1", text)


def _bare(name: str) -> str:
    """Return a row's name without what is said of it in brackets or by a dagger."""
    return re.sub(r" (\(.*\)|†)$", "", name)
