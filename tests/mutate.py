"""How many small errors would the tests see?  ``python -m tests.mutate --sample 100`` makes some, and counts.

Cosmic Ray lists every single change of an operator, a number or a keyword in the modules named; a sample of them is
made one at a time in a copy of the project.  A mutant is first tried on all tests of its own module, and where it
survives those on the others that are not slow.  Changes inside annotations are left out: they do nothing.
"""

from __future__ import annotations

import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
import tyro
from rich.console import Console
from scipy.stats import binomtest

ROOT = Path(__file__).parent.parent

OWN_TESTS = {"ilqr_kernels": "ilqr", "kernels": "equations", "plant": "equations", "symbolic": "equations"}
"""Whose tests try a module first, where it has no file of tests by its own name."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """What to change, and how often."""

    modules: tuple[str, ...] = ("dpend/*.py", "controllers/ilqr*.py", "studies/_estimates.py")
    """Patterns of the files to change."""
    sample: int = 100
    """How many mutants."""
    seed: int = 0
    """What they are drawn with."""
    timeout: int = 600
    """Seconds after which the tests count as failed."""


def annotated(source: str) -> set[tuple[int, int]]:
    """Return the places (line, column) that lie in annotations of a source file."""
    places: set[tuple[int, int]] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            notes = [node.returns, *(each.annotation for each in ast.walk(node.args) if isinstance(each, ast.arg))]
        else:
            notes = [node.annotation] if isinstance(node, ast.AnnAssign) else []
        for note in filter(None, notes):
            places |= {(each.lineno, each.col_offset) for each in ast.walk(note) if isinstance(each, ast.expr)}
            places |= {(line, column) for line in [note.lineno] for column in range(note.col_offset, _end(note))}
    return places


def _end(note: ast.expr) -> int:
    return note.end_col_offset or 0 if note.end_lineno == note.lineno else 1000


def mutants(files: list[Path]) -> Iterator[tuple[Path, str, dict[str, object], int]]:
    """Return file, operator, its arguments and occurrence of every mutant outside annotations."""
    from cosmic_ray.commands.init import _all_work_items

    for file in files:
        noted = annotated(file.read_text(encoding="utf-8"))
        for item in _all_work_items([file], {}):
            (mutation,) = item.mutations
            if tuple(mutation.start_pos) not in noted:
                yield file, mutation.operator_name, mutation.operator_args, mutation.occurrence


def survives(copy: Path, module: str, timeout: int) -> bool:
    """Return whether the tests of a copy pass: its module's own, then the fast ones of all."""
    own = copy / "tests" / f"test_{OWN_TESTS.get(module, module.strip('_'))}.py"
    tries = [[str(own), "-n", "0", "-m", kind] for kind in ("not slow", "slow and not nightly") if own.exists()]
    for tests in [*tries, ["-n", "2", "-m", "not slow"]]:
        try:
            run = subprocess.run(
                [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests],
                cwd=copy, env=os.environ | {"PYTHONPATH": str(copy)}, capture_output=True, timeout=timeout, check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return False
        if run.returncode not in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED):
            return False
    return True


def main() -> None:
    """Make mutants and print those that survive, and the share that does not."""
    from cosmic_ray.mutating import use_mutation
    from cosmic_ray.plugins import get_operator

    options = tyro.cli(Options, description=__doc__)
    console = Console(highlight=False, soft_wrap=True)
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "copy"
        ignored = shutil.ignore_patterns(".git", ".venv", "results", "__pycache__")
        shutil.copytree(ROOT, copy, ignore=lambda at, names: ignored(at, names) if Path(at) == ROOT else set())
        files = sorted({file for pattern in options.modules for file in copy.glob(pattern)})
        every = list(mutants(files))
        chosen = random.Random(options.seed).sample(every, min(options.sample, len(every)))
        if not survives(copy, "", options.timeout):
            raise SystemExit("The tests must pass before anything is changed; run them, and mend what fails.")
        killed = 0
        for count, (file, operator, arguments, occurrence) in enumerate(chosen, 1):
            with use_mutation(file, get_operator(operator)(**arguments), occurrence) as (before, after):
                alive = survives(copy, file.stem, options.timeout)
            killed += not alive
            if alive:
                assert before is not None
                assert after is not None
                line = next(
                    i for i, (a, b) in enumerate(zip(before.splitlines(), after.splitlines(), strict=False)) if a != b
                )
                console.print(
                    f"survives: {file.relative_to(copy)}:{line + 1}  {after.splitlines()[line].strip()}", markup=False
                )
            console.print(f"{count} of {len(chosen)}, {killed} killed", end="\r")
        interval = binomtest(killed, len(chosen)).proportion_ci(method="wilson")
        console.print(
            f"{killed} of {len(chosen)} mutants killed ({100 * killed / len(chosen):.0f} % "
            f"[{100 * interval.low:.0f}, {100 * interval.high:.0f}]), drawn from {len(every)}."
        )


if __name__ == "__main__":
    main()
