"""One table model for people: in a terminal, in Markdown, and on a page of its own that sorts."""

from __future__ import annotations

import html
import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from itertools import accumulate
from numbers import Integral
from string import Template
from typing import Any

import pandas as pd
from rich.box import SIMPLE_HEAD
from rich.console import Console, ConsoleOptions, Group, RenderResult
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from ._estimates import Estimate, Tried, share

_FEW = 6  # columns in a terminal, at most
_NAME = 20  # letters of a column of words there, before they wrap
_AIR = 2  # letters between columns there


@dataclass(frozen=True)
class Column:
    """One column."""

    heading: str  # What stands above it, with its unit.
    meaning: str = ""  # What it is, in a sentence.
    group: str = ""  # What columns side by side belong to.
    words: bool = False  # Whether it holds words, not numbers.
    brief: bool = True  # Whether it is among those shown in a terminal, where there is no room for all.


@dataclass(frozen=True)
class Cell:
    """One cell."""

    text: str = "–"
    under: str = ""  # What stands smaller beside it, such as an interval.
    key: float | None = None  # What it is sorted by, infinite where it lies beyond all; left out, its words.
    share: float | None = None  # What a bar in it shows, 0 to 1.


Value = Cell | Estimate | float | int | str | None
"""What may be written in a table; NaN and None are a dash."""


@dataclass(frozen=True)
class Sheet:
    """A table: its lines have a cell for each column; printed on a rich console, it is that of :func:`terminal`."""

    title: str
    columns: Sequence[Column]
    lines: Sequence[Sequence[Cell]]
    note: str = ""  # What stands below it.

    def __post_init__(self) -> None:
        for line in self.lines:
            if len(line) != len(self.columns):
                raise ValueError(f"Expected a cell for each of {len(self.columns)} columns; got {len(line)}: {line}.")

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        yield terminal(self, options.max_width)


def cell(value: Value, form: str = "", *, tried: Tried | None = None, bar: bool = False) -> Cell:
    """Return the cell of a value, with its interval below it where it has one, sorted by the value.

    ``form`` and ``tried`` are as of :func:`studies._estimates.number`; a whole number is a count, which is written
    whole.  With ``bar``, a bar shows the value, which must be a share.
    """
    if isinstance(value, Cell):
        return value
    if value is None or isinstance(value, str):
        return Cell(value or "–")
    if isinstance(value, Integral):  # a count
        return Cell(f"{value:,}", key=float(value))
    estimate = value if isinstance(value, Estimate) else Estimate(float(value))
    text, under = estimate.written(form, tried)
    key = None if math.isnan(estimate.value) else float(estimate.value)
    return Cell(text, under, key, key if bar else None)


def sheet(
    title: str,
    lines: pd.DataFrame | Iterable[Mapping[str, Value]],
    form: str | Mapping[str, str] = "",
    *,
    note: str = "",
    tried: Tried | None = None,
    brief: Collection[str] | None = None,
) -> Sheet:
    """Return the table of lines that are mappings from headings to values, or of a frame.

    Headings come in the order in which they are met first; where a line lacks one, there is a dash; a column in which
    all are words is one of words.  One form for all numbers, or forms by heading, and the levels tried are as of
    :func:`studies._estimates.number`; without a form, shares below headings that end in "%" are percentages with one
    decimal.  A terminal shows the brief headings where there is no room for all; left out, the first.
    """
    records: Any = lines.to_dict("records") if isinstance(lines, pd.DataFrame) else list(lines)
    headings = list(dict.fromkeys(heading for record in records for heading in record))
    chosen = dict.fromkeys(headings, form) if isinstance(form, str) else form
    forms = {each: chosen.get(each) or (".1%" if each.endswith("%") else "") for each in headings}

    def words(heading: str) -> bool:
        values = [record[heading] for record in records if record.get(heading) is not None]
        return all(isinstance(value, str) or (isinstance(value, Cell) and value.key is None) for value in values)

    columns = [Column(heading, words=words(heading), brief=brief is None or heading in brief) for heading in headings]
    body = [[cell(record.get(each), forms[each], tried=tried) for each in headings] for record in records]
    return Sheet(title, columns, body, note)


def counted(successes: int, n: int) -> Cell:
    """Return the cell of ``successes`` of ``n``, with the interval of their share in percent."""
    return replace(cell(share(successes, n), ".0%"), text=f"{successes} of {n}")


def at(lams: Mapping[float, Value]) -> dict[str, Value]:
    """Return what was found at greatest starting angles λ, rad, by heading."""
    return {f"λ = {lam:g}": value for lam, value in lams.items()}


def markdown(table: Sheet) -> str:
    """Return a table in Markdown, below its title and above its note."""
    body = [[_plain(column.heading) for column in table.columns]]
    body += [["---" if column.words else "---:" for column in table.columns]]
    body += [[_plain(f"{each.text} {each.under}".strip()) for each in line] for line in table.lines]
    rows = "\n".join("| " + " | ".join(cells) + " |" for cells in body)
    parts = [f"## {_plain(table.title)}", rows, *([_plain(table.note)] if table.note else [])]
    return "\n\n".join(parts) + "\n"


def document(title: str, tables: Iterable[Sheet], before: str = "") -> str:
    """Return a page of Markdown: words in Markdown, tables one below the other, then what their columns mean."""
    shown = list(tables)
    columns = dict.fromkeys(column for table in shown for column in table.columns if column.meaning)
    meanings = "\n".join(f"- **{_plain(_named(column))}**: {_plain(column.meaning)}" for column in columns)
    after = [f"## What the columns mean\n\n{meanings}\n"] if meanings else []
    return "\n".join([f"# {_plain(title)}\n", *([before + "\n"] if before else []), *map(markdown, shown), *after])


def _plain(text: str) -> str:
    """Escape what Markdown would take for its own; brackets only where they would make a link of what follows."""
    for sign in "\\|*_<>`":
        text = text.replace(sign, f"\\{sign}")
    return " ".join(text.replace("](", "]\\(").split())


def _named(column: Column) -> str:
    return f"{column.group}: {column.heading}" if column.group else column.heading


def terminal(table: Sheet, width: int = 80) -> Group:
    """Return a table for a terminal of a width in letters: the columns that fit with every number whole, six at most.

    What is left out is said below it.
    """
    letters = [_letters(table, i) for i in range(len(table.columns))]
    every, room = list(range(len(letters))), width + _AIR
    if len(every) > _FEW or sum(letters) + _AIR * len(every) > room:
        every = [i for i in every if table.columns[i].brief][:_FEW]
    ends = accumulate(letters[i] + _AIR for i in every)
    chosen = [i for i, end in zip(every, ends, strict=True) if i == every[0] or end <= room]
    left_out = len(letters) - len(chosen)
    said = f"{left_out} more column{'s' * (left_out > 1)} in tables.md" if left_out else ""
    drawn = Table(box=SIMPLE_HEAD, padding=(0, 1), collapse_padding=True, pad_edge=False, show_edge=False)
    for i in chosen:
        whole: Any = {"min_width": letters[i], "max_width": letters[i], "overflow": "fold"}
        column = table.columns[i]
        drawn.add_column(escape(column.heading), justify="left" if column.words else "right", **whole)
    for cells in ([line[i] for i in chosen] for line in table.lines):
        drawn.add_row(*(Text.assemble(each.text, (f"\n{each.under}" * bool(each.under), "dim")) for each in cells))
    below = "; ".join(filter(None, (table.note, said)))
    return Group(Text(f"\n{table.title}", style="bold"), drawn, *([Text(below, style="italic")] if below else []))


def _letters(table: Sheet, i: int) -> int:
    """Return the width of a column in which no number and no word is cut."""
    column, texts = table.columns[i], [text for line in table.lines for text in (line[i].text, line[i].under)]
    whole = max((len(line) for text in texts for line in text.split("\n")), default=0)
    if not column.words:
        return max(whole, *(len(word) for word in column.heading.split()))
    word = max((len(word) for text in (*texts, column.heading) for word in text.split()), default=1)
    return max(word, min(whole, _NAME))


def page(title: str, before: Sequence[str], table: Sheet) -> str:
    """Return a page that stands alone: a table, sorted by a press on a heading, and what its columns mean.

    Nothing is fetched from anywhere; without JavaScript the table is there all the same, in the order given.
    ``before`` are paragraphs above it.
    """
    e, columns = html.escape, table.columns
    edges = {i for i, column in enumerate(columns) if i and column.group != columns[i - 1].group}
    groups = "".join(
        f'<th scope="colgroup" colspan="{n}" class="{"edge" if group else ""}"><span>{e(group)}</span></th>'
        for group, n in Counter(column.group for column in columns).items()
    )
    headings = "".join(
        f'<th scope="col" class="{_kind(column, i in edges)}"><button title="{e(column.meaning)}">{e(column.heading)}'
        "</button></th>"
        for i, column in enumerate(columns)
    )
    body = "\n".join(
        "<tr>" + "".join(_html(each, columns[i], i, i in edges) for i, each in enumerate(line)) + "</tr>"
        for line in table.lines
    )
    meanings = "\n".join(f"<dt>{e(_named(column))}</dt><dd>{e(column.meaning)}</dd>" for column in columns)
    web = files("studies") / "web"
    template, style, script = ((web / f"table.{kind}").read_text(encoding="utf-8") for kind in ("html", "css", "js"))
    paragraphs = "".join(f"<p>{e(paragraph)}</p>" for paragraph in (*before, *filter(None, [table.note])))
    return Template(template).substitute(
        title=e(title), label=e(table.title), style=style, script=script, paragraphs=paragraphs,
        groups=groups, headings=headings, body=body, meanings=meanings,
    )  # fmt: skip


def _kind(column: Column, edge: bool) -> str:
    return " ".join(filter(None, ("words" if column.words else "number", "edge" if edge else "")))


def _html(each: Cell, column: Column, place: int, edge: bool) -> str:
    tag, scope = ("th", ' scope="row"') if place == 0 else ("td", "")
    key = each.text if each.key is None else "" if math.isnan(each.key) else repr(max(-1e308, min(each.key, 1e308)))
    bar = f' style="--share:{100 * each.share:.1f}%"' if each.share else ""
    under = f"<small>{html.escape(each.under)}</small>" if each.under else ""
    kind = _kind(column, edge) + (" bar" if bar else "")
    return f'<{tag}{scope} class="{kind}" data-key="{html.escape(key)}"{bar}>{html.escape(each.text)}{under}</{tag}>'
