"""List the studies, one line each: ``python -m studies``."""

import ast
import shutil
from pathlib import Path

from ._runner import studies

width = shutil.get_terminal_size().columns
print(f"{'python -m':<26} min  question")
for name in studies():
    source = ast.parse((Path(__file__).parent / f"{name.removeprefix('studies.')}.py").read_text(encoding="utf-8"))
    question = " ".join((ast.get_docstring(source) or "").split("\n\n")[0].split())
    assigned = {ast.unparse(each.targets[0]): each.value for each in source.body if isinstance(each, ast.Assign)}
    minutes = ast.literal_eval(assigned["MINUTES"]) if "MINUTES" in assigned else float("nan")
    line = f"{name:<26}{minutes:>4g}  {question}"
    print(line if len(line) <= width else f"{line[: width - 1]}…")
print("Minutes are those of the full study on two cores; --quick ends in seconds.")
