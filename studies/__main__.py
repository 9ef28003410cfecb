"""List the studies: ``python -m studies``."""

import ast
from pathlib import Path

from rich.console import Console
from rich.table import Table

from ._study import studies


def _flowing(paragraph: str) -> str:
    return " ".join(paragraph.split())


table = Table("command", "question and finding", show_lines=True)
for name in studies():
    source = Path(__file__).parent / f"{name.removeprefix('studies.')}.py"
    question, *_, finding = (ast.get_docstring(ast.parse(source.read_text())) or "").split("\n\n")
    table.add_row(f"python -m {name}", f"{_flowing(question)}\n{_flowing(finding)}")
Console().print(table)
