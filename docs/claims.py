"""What the pages claim: every estimate with its interval on the pages, and the row of a table that it rests on."""

from __future__ import annotations

import ast
import itertools
import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parent.parent
ELSEWHERE: Mapping[tuple[str, str], str] = {
    ("docs/trajectory-optimisation.md", "start"): "python -m benchmarks.tvlqr",
    ("docs/trajectory-optimisation.md", "rig"): "python -m benchmarks.tvlqr",
    ("docs/trajectory-optimisation.md", "The swing-up study"): "python -m benchmarks.tvlqr",
}
"""Estimates that stand in no table of ``docs/results``, by their page and how their paragraph or table begins, and what
they rest on."""
_NUMBER = r"(?:[<>] )?[+−-]?(?:\d[\d,]*(?:\.\d+)?|\.\d+)"
_ESTIMATE = re.compile(rf"({_NUMBER})\s*(?:%|s|rad|points)?\s*\[({_NUMBER}),\s*({_NUMBER})\](?!\()")


class Estimate(NamedTuple):
    """A value with its interval, as it is written."""

    words: str
    numbers: tuple[float, ...]
    digits: tuple[int, ...]  # of each after the point

    def is_rounded(self, other: Estimate) -> bool:
        """Return whether it is another, or that rounded to fewer digits."""
        each = zip(self.numbers, self.digits, other.numbers, strict=True)
        return all(abs(own - its) <= 0.500001 * 10.0**-digits for own, digits, its in each)


class Block(NamedTuple):
    """A paragraph, an item of a list or a line of a table, with its estimates."""

    title: str  # how the paragraph begins, or the first heading of the table
    words: str
    estimates: tuple[Estimate, ...]


class Claim(NamedTuple):
    """A block of a page, and what it rests on: rows of tables, or what :data:`ELSEWHERE` says."""

    page: str
    words: str
    rests_on: tuple[str, ...]
    lacking: tuple[str, ...]  # estimates that rest on nothing


def _estimates(text: str) -> Iterator[Estimate]:
    for match in _ESTIMATE.finditer(text):
        plain = [re.sub(r"[<> ,+]", "", match[k]).replace("−", "-") for k in (1, 2, 3)]
        yield Estimate(
            " ".join(match[0].split()), tuple(map(float, plain)), tuple(len(p.partition(".")[2]) for p in plain)
        )


def _plain(text: str) -> str:
    """Return Markdown without emphasis and without where links lead."""
    return re.sub(r"[*`]|\]\([^)]*\)|(?<!\w)\[(?=[A-Za-z])", "", text)


def blocks(text: str) -> Iterator[Block]:
    """Return the blocks of a page in Markdown that hold estimates."""
    for part in re.split(r"\n\s*\n|\n(?=\s*- )", re.sub(r"```.*?```", "", text, flags=re.DOTALL)):
        lines = part.strip().splitlines()
        table = [line for line in lines if line.startswith("|")]
        if table:
            heading = next(filter(None, (each.strip() for each in table[0].split("|"))), "")
            inside = [(heading, _plain(line.strip("| "))) for line in table[2:]]
        else:
            words = _plain(" ".join(part.split())).removeprefix("- ")
            inside = [(words, words)]
        for title, words in inside:
            if found := tuple(_estimates(words)):
                yield Block(title, words, found)


Row = tuple[str, str]
"""The study, and title and first cells of the row."""


@cache
def _rows() -> Mapping[int, Sequence[tuple[Row, Estimate]]]:
    """Return the estimates in the tables of the studies with their rows, by the whole part of the value."""
    found: dict[int, list[tuple[Row, Estimate]]] = {}
    for file in sorted((ROOT / "docs" / "results").glob("*/tables.md")):
        title = ""
        for line in file.read_text(encoding="utf-8").splitlines():
            line = re.sub(r"\\(.)", r"\1", line)
            title = line.removeprefix("## ") if line.startswith("## ") else title
            cells = [cell.strip() for cell in line.strip("| ").split(" | ")]
            name = ", ".join(cell for cell in cells[:2] if cell and not re.match(r"[–\d<>]", cell))
            for estimate in _estimates(line):
                row = file.parent.name, f"{title}: {name}"
                found.setdefault(math.floor(estimate.numbers[0]), []).append((row, estimate))
    return found


def _rows_with(estimate: Estimate) -> set[Row]:
    """Return the rows that hold an estimate."""
    whole = math.floor(estimate.numbers[0])
    near = itertools.chain.from_iterable(_rows().get(whole + k, ()) for k in (-1, 0, 1))
    return {row for row, each in near if estimate.is_rounded(each)}


def claims(page: Path) -> Iterator[Claim]:
    """Return the blocks of a page that hold estimates, each with as few rows of tables as hold these.

    Of rows that hold as many those of a study that the page names come first.
    """
    text, name = page.read_text(encoding="utf-8"), page.relative_to(ROOT).as_posix()
    if page.suffix == ".py":
        text = f"studies.{page.stem}\n\n{ast.get_docstring(ast.parse(text)) or ''}"
    named = set(re.findall(r"(?:studies\.|results/)(\w+)", text))
    for block in blocks(text):
        open_ = {estimate: _rows_with(estimate) for estimate in block.estimates}
        said = [said for (of, start), said in ELSEWHERE.items() if of == name and block.title.startswith(start)]
        lacking = tuple(estimate.words for estimate, rows in open_.items() if not rows and not said)
        rests_on = said if not all(open_.values()) else []
        while held := Counter(row for rows in open_.values() for row in rows):
            row = max(sorted(held), key=lambda row: (held[row], row[0] in named))
            rests_on.append(", ".join(row))
            open_ = {estimate: rows for estimate, rows in open_.items() if row not in rows}
        yield Claim(name, block.words, tuple(rests_on), lacking)


def pages() -> list[Path]:
    """Return the pages that say what was found, and the studies, whose docstrings do."""
    of = ("docs/*.md", "docs/learn/*.md", "studies/[a-z]*.py")
    return [ROOT / "README.md", *(page for pattern in of for page in sorted(ROOT.glob(pattern)))]
