"""Tables hold anything, keep every number whole in a terminal, and sort on their page."""

import math
import re
import shutil
import subprocess
from html.parser import HTMLParser
from io import StringIO

import pandas as pd
import pytest
from rich.console import Console
from rigs import whole

from studies._estimates import Estimate
from studies._tables import Cell, Column, Sheet, cell, document, markdown, page, sheet

COLUMNS = (Column("who", "Which contender.", words=True), Column("x|y", 'A "number".', "A & B"))
NASTY = "<script>alert('x')</script> | *a_b* [x](y)"


def printed(table: Sheet, width: int = 80) -> str:
    stream = StringIO()
    Console(file=stream, width=width).print(table)
    return stream.getvalue()


# ------------------------------------------------------------------------------------------------------------- building


def test_values_are_written_by_their_kind_and_sorted_by_what_they_are():
    assert cell(Estimate(0.845, 0.821, 0.866), ".1%", bar=True) == Cell("84.5", "[82.1, 86.6]", 0.845, 0.845)
    assert cell(12345, ".1%") == Cell("12,345", key=12345.0)
    assert cell(0.5) == Cell("0.5", key=0.5)
    assert cell("words") == Cell("words")
    assert cell(Estimate(math.inf, 0.3, math.inf), tried=(0.1, 0.6)) == Cell("> 0.6", "[0.3, > 0.6]", math.inf)
    assert cell(None) == cell(math.nan) == cell(Estimate()) == Cell()


def test_a_sheet_is_made_of_mappings_or_of_a_frame_with_a_dash_for_what_is_missing():
    lines = [{"who": "LQR", "saved, %": Estimate(0.5, 0.4, 0.6)}, {"who": "SDRE", "time, s": 2.0}]
    made = sheet("Saved", lines, {"time, s": ".2f"})
    assert [(column.heading, column.words) for column in made.columns] == [
        ("who", True), ("saved, %", False), ("time, s", False),
    ]  # fmt: skip
    assert made.lines == [[Cell("LQR"), Cell("50.0", "[40.0, 60.0]", 0.5), Cell()],
                          [Cell("SDRE"), Cell(), Cell("2.00", key=2.0)]]  # fmt: skip
    framed = sheet("Saved", pd.DataFrame({"who": ["LQR"], "starts": [200], "saved, %": [Estimate(0.5)]}))
    assert framed.lines == [[Cell("LQR"), Cell("200", key=200.0), Cell("50.0", key=0.5)]]


def test_a_line_that_lacks_a_cell_is_refused():
    message = f"Expected a cell for each of 2 columns; got 1: {[Cell('a')]}."
    with pytest.raises(ValueError, match=whole(message)):
        Sheet("t", COLUMNS, [[Cell("a")]])


# ------------------------------------------------------------------------------------------------------------- terminal

WIDE = sheet(
    "Wide",
    [
        {"controller": "PPO swing-up, smooth as shipped, one training"}
        | {f"saved at λ = {lam:g}, %": Estimate(lam / 10, lam / 11, lam / 9) for lam in range(1, 9)}
    ],
)


@pytest.mark.parametrize("width", [60, 80, 100, 200])
def test_a_terminal_shows_whole_numbers_in_six_columns_at_most_and_says_what_it_leaves_out(width):
    text = printed(WIDE, width)
    assert max(map(len, text.splitlines())) <= width
    assert "…" not in text
    shown = [each for each in WIDE.lines[0][1:] if each.text in text.split()]
    assert 2 <= len(shown) <= 5
    assert all(each.under in text for each in shown)
    assert shown == list(WIDE.lines[0][1 : 1 + len(shown)])
    assert f"{8 - len(shown)} more columns in tables.md" in " ".join(text.split())


def test_where_there_is_no_room_for_all_a_terminal_shows_the_brief_columns():
    headings = [f"λ={lam:g}" for lam in range(1, 9)]
    table = sheet("t", [{"who": "LQR"} | dict.fromkeys(headings, Estimate(0.5, 0.4, 0.6))], brief=["who", headings[6]])
    assert re.findall("λ=.", printed(table)) == ["λ=7"]
    assert "7 more columns in tables.md" in printed(table)
    assert "tables.md" not in printed(
        Sheet("t", (*COLUMNS, Column("z", brief=False)), [[Cell("a"), Cell("1"), Cell()]])
    )


def test_a_terminal_shows_brackets_and_markup_as_they_are():
    text = printed(Sheet("[red]t[/red]", COLUMNS, [[Cell(NASTY), Cell("7")]])).replace("7", "")
    assert "".join(NASTY.split()) in "".join(text.split())
    assert "[red]t[/red]" in text


# ------------------------------------------------------------------------------------------------------------- Markdown


def test_the_markdown_table_has_a_cell_for_each_column_whatever_stands_in_it():
    text = markdown(Sheet("a*b", COLUMNS, [[Cell(NASTY), Cell("1", "[0, 2]")], [Cell("line\nbreak"), Cell()]], "n|"))
    title, lines, note = text.strip().split("\n\n")
    lines = lines.splitlines()
    assert (title, note) == (r"## a\*b", r"n\|")
    assert [len(re.findall(r"(?<!\\)\|", line)) for line in lines] == [3, 3, 3, 3]
    assert lines[1] == "| --- | ---: |"
    assert lines[2] == r"| \<script\>alert('x')\</script\> \| \*a\_b\* [x]\(y) | 1 [0, 2] |"
    assert lines[3] == "| line break | – |"


def test_a_document_says_once_what_its_columns_mean():
    table = Sheet("t", COLUMNS, [[Cell("a"), Cell("1")]])
    text = document("All", [table, table], "Before.")
    assert text.startswith("# All\n\nBefore.\n\n## t\n")
    assert text.count('- **A & B: x\\|y**: A "number".') == 1


# ----------------------------------------------------------------------------------------------------------------- HTML


class Cells(HTMLParser):
    """What a page shows, and its tags that were opened and closed."""

    def __init__(self, text):
        super().__init__()
        self.seen, self.open, self.outside = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        if tag not in ("meta", "link", "img"):
            self.open.append(tag)
        self.outside += [value for name, value in attrs if name in ("src", "href")]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("script", "style"):
            self.seen.append(data.strip())


def test_the_page_shows_names_as_they_are_and_runs_none_of_them():
    table = Sheet("t", COLUMNS, [[Cell(NASTY), Cell("1.5", "[1, 2]", 1.5, 0.5)]], "a note")
    text = page("Board", ["a < b"], table)
    shown = Cells(text)
    assert {NASTY, "a < b", "x|y", "A & B", "[1, 2]", "a note"} <= set(shown.seen)
    assert not shown.open
    assert shown.outside == []
    assert text.count("<script>") == 1  # its own
    assert "http" not in text
    assert "url(" not in text


@pytest.mark.skipif(shutil.which("node") is None, reason="no JavaScript here")
def test_the_page_sorts_by_numbers_where_there_are_any_and_puts_what_has_none_last():
    cells = {"b": cell(10), "c": cell(None), "a": cell(9), "d": cell(Estimate(math.inf), tried=(0, 1))}
    text = page("Board", [], Sheet("t", COLUMNS, [[Cell(name), each] for name, each in cells.items()]))
    script = text.split("<script>")[1].split("</script>")[0]
    keys = re.findall(r'data-key="([^"]*)"', text)
    program = f"""
const keys = {keys};
const rows = [0, 1, 2, 3].map(i => ({{cells: [0, 1].map(j => ({{dataset: {{key: keys[2 * i + j]}}}}))}}));
const body = {{rows, append: row => {{ shown.push(row.cells[0].dataset.key); }}}};
let shown = [];
const presses = [];
const heading = () => {{ const a = {{}}; return {{
  getAttribute: n => a[n], setAttribute: (n, v) => {{ a[n] = v; }}, removeAttribute: n => {{ delete a[n]; }},
  querySelector: () => ({{addEventListener: (_, f) => presses.push(f)}})}}; }};
const heads = [heading(), heading()];
globalThis.document = {{querySelector: () => body, querySelectorAll: () => heads}};
{{
{script}
}}
for (const press of [1, 1, 0]) {{ shown = []; presses[press](); console.log(shown.join("")); }}
"""
    done = subprocess.run(["node", "-e", program], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["abdc", "dbac", "abcd"]
