"""One table for people: in Markdown, on a page of its own that sorts, and in a terminal."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from dataclasses import dataclass

from rich.markup import escape
from rich.table import Table


@dataclass(frozen=True)
class Column:
    """One column.

    Attributes
    ----------
    group : str
        What columns side by side belong to.
    heading : str
        What stands above it.
    meaning : str
        What it is, in a sentence, with its unit.
    words : bool
        Whether it holds words, not numbers.
    """

    group: str
    heading: str
    meaning: str
    words: bool = False


@dataclass(frozen=True)
class Cell:
    """One cell.

    Attributes
    ----------
    text : str
        What stands in it.
    under : str
        What stands smaller beside it, such as an interval.
    key : float, optional
        What it is sorted by, infinite where it lies beyond all; left out, its words.
    share : float, optional
        What a bar in it shows, 0 to 1.
    """

    text: str = "–"
    under: str = ""
    key: float | None = None
    share: float | None = None


Line = Sequence[Cell]
"""A cell for each column; the first is its name."""


def markdown(columns: Sequence[Column], lines: Sequence[Line]) -> str:
    """Return the table in Markdown.

    Parameters
    ----------
    columns : sequence of Column
        Its columns.
    lines : sequence of Line
        Its lines.

    Returns
    -------
    str
    """

    def row(cells: Sequence[str]) -> str:
        return "| " + " | ".join(cells) + " |"

    def written(cell: Cell) -> str:
        return _plain(f"{cell.text} {cell.under}".strip())

    return "\n".join(
        [
            row([_plain(column.heading) for column in columns]),
            row(["---" if column.words else "---:" for column in columns]),
            *(row([written(cell) for cell in line]) for line in lines),
        ]
    )


def _plain(text: str) -> str:
    """Escape what Markdown would take for its own."""
    for sign in "\\|*_<>[]`":
        text = text.replace(sign, f"\\{sign}") if sign not in "[]" else text
    return " ".join(text.split())


def terminal(title: str, columns: Sequence[Column], lines: Sequence[Line]) -> Table:
    """Return the table for a terminal.

    Parameters
    ----------
    title : str
        What stands above it.
    columns : sequence of Column
        Its columns.
    lines : sequence of Line
        Its lines.

    Returns
    -------
    Table
    """
    table = Table(title=title)
    for column in columns:
        table.add_column(column.heading, justify="left" if column.words else "right")
    for line in lines:
        table.add_row(*(escape(f"{cell.text}\n{cell.under}".strip()) for cell in line))
    return table


def page(title: str, before: Sequence[str], columns: Sequence[Column], lines: Sequence[Line]) -> str:
    """Return a page that stands alone: the table, sorted by a press on a heading, and what its columns mean.

    Nothing is fetched from anywhere; without JavaScript the table is there all the same, in the order given.

    Parameters
    ----------
    title : str
        Title of the page.
    before : sequence of str
        Paragraphs above the table.
    columns : sequence of Column
        Its columns.
    lines : sequence of Line
        Its lines.

    Returns
    -------
    str
        HTML.
    """
    e = html.escape
    edges = {i for i, column in enumerate(columns) if i and column.group != columns[i - 1].group}
    groups = "".join(
        f'<th scope="colgroup" colspan="{sum(column.group == group for column in columns)}" '
        f'class="{"edge" if group else ""}"><span>{e(group)}</span></th>'
        for group in dict.fromkeys(column.group for column in columns)
    )
    headings = "".join(
        f'<th scope="col" class="{_kind(column, i in edges)}"><button title="{e(column.meaning)}">{e(column.heading)}'
        "</button></th>"
        for i, column in enumerate(columns)
    )
    body = "\n".join(
        "<tr>" + "".join(_cell(cell, columns[i], i, i in edges) for i, cell in enumerate(line)) + "</tr>"
        for line in lines
    )
    meanings = "\n".join(
        f"<dt>{e(' '.join(filter(None, (column.group + ':' if column.group else '', column.heading))))}</dt>"
        f"<dd>{e(column.meaning)}</dd>"
        for column in columns
    )
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{e(title)}</title>
<style>{_STYLE}</style>
</head>
<body>
<h1>{e(title)}</h1>
{"".join(f"<p>{e(paragraph)}</p>" for paragraph in before)}
<div class="wide" tabindex="0" role="region" aria-label="the table">
<table>
<thead>
<tr>{groups}</tr>
<tr>{headings}</tr>
</thead>
<tbody>
{body}
</tbody>
</table>
</div>
<h2>What the columns mean</h2>
<dl>
{meanings}
</dl>
<script>{_SORT}</script>
</body>
</html>
"""


def _kind(column: Column, edge: bool) -> str:
    return " ".join(filter(None, ("words" if column.words else "number", "edge" if edge else "")))


def _cell(cell: Cell, column: Column, place: int, edge: bool) -> str:
    tag, scope = ("th", ' scope="row"') if place == 0 else ("td", "")
    key = cell.text if cell.key is None else "" if math.isnan(cell.key) else repr(max(-1e308, min(cell.key, 1e308)))
    bar = "" if not cell.share else f' style="--share:{100 * cell.share:.1f}%"'
    under = f"<small>{html.escape(cell.under)}</small>" if cell.under else ""
    kind = _kind(column, edge) + (" bar" if bar else "")
    return f'<{tag}{scope} class="{kind}" data-key="{html.escape(key)}"{bar}>{html.escape(cell.text)}{under}</{tag}>'


_STYLE = """
:root { color-scheme: light dark; --ink: #1b1b1b; --paper: #fff; --line: #ccc; --bar: #cfe3f1; --head: #f2f2f2; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e8e8e8; --paper: #161616; --line: #444; --bar: #1d4460; --head: #262626; }
}
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1rem; max-width: 120rem; color: var(--ink); background: var(--paper);
  font: 16px/1.5 system-ui, sans-serif; }
p, dl { max-width: 46rem; }
.wide { overflow: auto; max-height: 90vh; border: 1px solid var(--line); }
table { border-collapse: separate; border-spacing: 0; font-size: 0.82rem; font-variant-numeric: tabular-nums; }
th, td { padding: 0.3rem 0.5rem; border-bottom: 1px solid var(--line); text-align: right; white-space: nowrap;
  vertical-align: top; }
td.words, th.words { text-align: left; }
td.words { white-space: normal; min-width: 9rem; }
.edge { border-left: 2px solid var(--ink); }
thead th { position: sticky; top: 0; background: var(--head); z-index: 1; vertical-align: bottom; white-space: normal; }
thead tr:first-child th { text-align: left; }
th[colspan] span { position: sticky; left: 8rem; white-space: nowrap; }
thead tr + tr th { top: 1.9rem; }
tbody th, thead tr > th:first-child { position: sticky; left: 0; z-index: 2; background: var(--head); text-align: left;
  white-space: normal; min-width: 7rem; }
thead tr > th:first-child { z-index: 3; }
small { display: block; opacity: 0.75; }
.bar { background: linear-gradient(var(--bar), var(--bar)) no-repeat; background-size: var(--share) 100%; }
button { all: unset; cursor: pointer; font-weight: 600; }
button:focus-visible { outline: 2px solid #0072b2; }
[aria-sort=ascending] button::after { content: " ▲"; }
[aria-sort=descending] button::after { content: " ▼"; }
dt { font-weight: 600; }
dd { margin: 0 0 0.4rem 1rem; }
@media print {
  @page { size: A3 landscape; margin: 1cm; }
  body { padding: 0; max-width: none; }
  .wide { overflow: visible; max-height: none; border: 0; }
  table { font-size: 6pt; }
  th, td { padding: 1pt 2pt; position: static !important; }
  td.words { min-width: 0; }
  .bar { print-color-adjust: exact; -webkit-print-color-adjust: exact; }
  tr { break-inside: avoid; }
}
"""

# What has no number goes last, whichever way it is sorted.
_SORT = """
const body = document.querySelector("tbody");
const headings = [...document.querySelectorAll("thead tr:last-child th")];
headings.forEach((heading, column) => heading.querySelector("button").addEventListener("click", () => {
  const up = heading.getAttribute("aria-sort") !== "ascending";
  headings.forEach(each => each.removeAttribute("aria-sort"));
  heading.setAttribute("aria-sort", up ? "ascending" : "descending");
  const key = row => row.cells[column].dataset.key;
  const compare = (a, b) => isNaN(a) || isNaN(b) ? a.localeCompare(b) : a - b;
  const none = row => ["", "–"].includes(key(row));
  [...body.rows]
    .sort((a, b) => none(a) - none(b) || (none(a) ? 0 : (up ? 1 : -1) * compare(key(a), key(b))))
    .forEach(row => body.append(row));
}));
"""
