"""What pages take from studies: directives and a role.

``study`` shows what a study's docstring says, ``results`` one of its tables, ``claims`` what the numbers of all pages
rest on; the role ``cell`` writes a number of a table into a sentence.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Mapping, Sequence
from typing import ClassVar

from claims import ROOT, claims, pages
from docutils import nodes
from docutils.parsers.rst import directives
from result_tables import RESULTS, Shown, table
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective, SphinxRole
from sphinx.util.typing import ExtensionMetadata, OptionSpec

STUDIES = ROOT / "studies"
_OPTIONS = "table", "columns", "rows", "where", "names"


class Study(SphinxDirective):
    """Write what the docstring of ``studies/<argument>.py`` says; the study itself is not imported.

    It stands on pages of reStructuredText, which docstrings are in.  ``page`` is the page with the whole report,
    ``figure`` a picture under ``docs/results`` and ``alt`` what it shows.
    """

    required_arguments = 1
    option_spec: ClassVar[OptionSpec] = dict.fromkeys(("page", "figure", "alt"), directives.unchanged_required)  # pyright: ignore[reportIncompatibleVariableOverride]

    def run(self) -> Sequence[nodes.Node]:
        """Return the nodes of the paragraphs."""
        name = self.arguments[0]
        path = STUDIES / f"{name}.py"
        self.env.note_dependency(str(path))
        module = ast.parse(path.read_text(encoding="utf-8"))
        question, method, finding = _parts(ast.get_docstring(module) or "")
        minutes = next(
            ast.literal_eval(each.value)
            for each in module.body
            if isinstance(each, ast.Assign) and ast.unparse(each.targets[0]) == "MINUTES"
        )
        paragraphs = [f"**{question}**", f"*Method.* {method}"]
        if "figure" in self.options:
            paragraphs.append(f".. image:: /results/{self.options['figure']}\n   :alt: {self.options['alt']}")
        whole = f":doc:`The whole study </{self.options['page']}>`. " if "page" in self.options else ""
        paragraphs += [
            f"*Finding.* {finding}",
            f"{whole}``python -m studies.{name}``, {minutes:g} minutes on two cores.",
        ]
        return self.parse_text_to_nodes("\n\n".join(paragraphs))


def _parts(docstring: str) -> list[str]:
    """Return question, method and finding, each on one line."""
    question, _, rest = docstring.partition("Method:")
    method, _, finding = rest.partition("Finding:")
    return [" ".join(part.split()) for part in (question, method, finding)]


class Results(SphinxDirective):
    """Show a table, or part of it, that a study wrote to ``docs/results/<argument>/tables.md``.

    ``table`` is its title, or how it begins; ``columns`` and ``rows`` name what is shown, in that order, apart by
    semicolons, left out all; ``where`` keeps the rows whose column holds a value: ``from = hanging; plant = ±10 %``;
    ``names`` are rows under other names: ``ppo-balance -> PPO, balancing``.
    """

    required_arguments = 1
    option_spec: ClassVar[OptionSpec] = dict.fromkeys(_OPTIONS, directives.unchanged)  # pyright: ignore[reportIncompatibleVariableOverride]

    def run(self) -> Sequence[nodes.Node]:
        """Return the table, and below it its note and the way to all others."""
        study = self.arguments[0]
        self.env.note_dependency(str(RESULTS / study / "tables.md"))
        columns, rows = (_listed(self.options.get(each, "")) for each in ("columns", "rows"))
        where = _pairs(self.options.get("where", ""), " = ")
        names = _pairs(self.options.get("names", ""), " -> ")
        try:
            shown = table(study, self.options.get("table", "")).part(columns, rows or list(names), where)
        except LookupError as wrong:
            raise self.error(str(wrong)) from wrong
        caption = nodes.paragraph("", f"{shown.note.removesuffix('.')}. " if shown.note else "", classes=["source"])
        link = pending_xref("", refdomain="std", reftype="doc", reftarget=f"/results/{study}/tables", refexplicit=True)
        link += nodes.inline("", "All tables")
        caption += [link, nodes.Text(": "), nodes.literal("", f"docs/results/{study}"), nodes.Text(".")]
        return [nodes.container("", _drawn(shown, names), classes=["pst-scrollable-table-container"]), caption]


class CellRole(SphinxRole):
    """Write a cell of a table: ``study; title; row; column``, and with ``; value`` after it without its interval."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        """Return the text of the cell, without the interval if so asked."""
        study, title, *names = (each.strip() for each in self.text.split(";"))
        alone = names[-1] == "value"
        *row, column = names[:-1] if alone else names
        self.env.note_dependency(str(RESULTS / study / "tables.md"))
        try:
            text = table(study, title).line(*row)[column]
        except LookupError as wrong:
            message = self.inliner.reporter.error(f"{self.text}: {wrong}", line=self.lineno)
            return [self.inliner.problematic(self.rawtext, self.rawtext, message)], [message]
        return [nodes.Text(_INTERVAL.sub(r"\g<value>", text) if alone else text)], []


_NUMBER = r"(?:[<>] )?[-+]?\d[\d.,e-]*"
_INTERVAL = re.compile(rf"(?P<value>.*?) ?(?P<interval>\[[^\]]*\].*|{_NUMBER} to {_NUMBER}|\([^)]*\))")
"""A value and what stands smaller below it: an interval, a range, or what is said of it in brackets."""


def _listed(text: str) -> list[str]:
    return [each.strip() for each in text.split(";") if each.strip()]


def _pairs(text: str, sign: str) -> dict[str, str]:
    """Return what stands left and right of a sign in each."""
    return {key.strip(): value.strip() for key, _, value in (each.partition(sign) for each in _listed(text))}


def _drawn(shown: Shown, names: Mapping[str, str]) -> nodes.table:
    """Return a table whose intervals stand small below their values."""
    lines = [[names.get(line[0], line[0]), *line[1:]] for line in shown.lines]
    group = nodes.tgroup("", cols=len(shown.headings))
    group += [nodes.colspec("", colwidth=1) for _ in shown.headings]
    group += nodes.thead("", _row(shown.headings, shown.words))
    group += nodes.tbody("", *(_row(line, shown.words) for line in lines))
    return nodes.table("", group, classes=["colwidths-auto", "results"])


def _row(cells: Sequence[str], words: Sequence[bool]) -> nodes.row:
    row = nodes.row()
    for text, word in zip(cells, words, strict=True):
        found = _INTERVAL.fullmatch(text)
        parts: list[nodes.Node] = [nodes.Text(found["value"] if found else text)]
        if found:
            parts += [nodes.Text(" "), nodes.inline("", found["interval"], classes=["interval"])]
        row += nodes.entry("", nodes.paragraph("", "", *parts), classes=[] if word else ["text-right"])
    return row


class Claims(SphinxDirective):
    """List the blocks of all pages that hold estimates, and what they rest on; on a page of reStructuredText."""

    def run(self) -> Sequence[nodes.Node]:
        """Return a list for each page."""
        lines: list[str] = []
        for page in pages():
            self.env.note_dependency(str(page))
            found = list(claims(page))
            lines += [f"**{page.relative_to(ROOT)}**", ""] if found else []
            for claim in found:
                words = claim.words if len(claim.words) < 90 else f"{claim.words[:88].rpartition(' ')[0]} …"
                lines += [f"- {_escaped(words)}", "", *(f"  - {_escaped(row)}" for row in claim.rests_on), ""]
        return self.parse_text_to_nodes("\n".join(lines))


def _escaped(text: str) -> str:
    return re.sub(r"([\\*`_|])", r"\\\1", text)


def setup(app: Sphinx) -> ExtensionMetadata:
    """Register directives and role."""
    app.add_directive("study", Study)
    app.add_directive("results", Results)
    app.add_directive("claims", Claims)
    app.add_role("cell", CellRole())
    return {"parallel_read_safe": True}
