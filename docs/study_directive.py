"""The directive ``study``: a study's question, method, figure and finding, as its docstring states them."""

from __future__ import annotations

import ast
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from sphinx.util.typing import ExtensionMetadata, OptionSpec

STUDIES = Path(__file__).parent.parent / "studies"


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


def setup(app: Sphinx) -> ExtensionMetadata:
    """Register the directive."""
    app.add_directive("study", Study)
    return {"parallel_read_safe": True}
