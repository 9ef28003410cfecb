"""List the studies: ``python -m studies``."""

import ast
from pathlib import Path

from rich.console import Console
from rich.table import Table

from ._study import studies

table = Table("command", "question and finding", show_lines=True)
for name in studies():
    source = Path(__file__).parent / f"{name.removeprefix('studies.')}.py"
    table.add_row(f"python -m {name}", ast.get_docstring(ast.parse(source.read_text())))
Console().print(table)
