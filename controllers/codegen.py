"""Solvers of nonlinear programs: in C, compiled and kept, where there is a compiler; in CasADi's own machine elsewhere.

CasADi interprets a program's functions unless they are compiled, which takes ten to twenty times as long.  Nothing asks
for a compiler when the package is installed: it is looked for when a solver is made, and doing without one is no error.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import casadi

Plugin = Literal["auto", "fatrop", "ipopt"]

_FLAGS = ("-O1", "-fPIC", "-shared", "-fno-math-errno", "-w")
_PATIENCE = 300.0  # s, after which a compiler is given up


class NLPSolver(NamedTuple):
    """A solver, and what runs in it.

    Attributes
    ----------
    solve : casadi.Function
        What ``casadi.nlpsol`` gives.
    plugin : str
        ``"fatrop"`` or ``"ipopt"``.
    backend : str
        The solver and what evaluates the problem's functions, in words.
    """

    solve: Any
    plugin: str
    backend: str


def find_compiler() -> str | None:
    """Give the path of a C compiler, ``$CC`` or else ``cc``, ``gcc`` or ``clang``; None where there is none."""
    if sys.platform == "win32":  # what is found there takes other flags
        return None
    for name in (os.environ.get("CC"), "cc", "gcc", "clang"):
        if name and (path := shutil.which(name)):
            return path
    return None


def cache_folder() -> Path:
    """Give the user's own folder for compiled code: ``$DPEND_CACHE``, or ``dpend`` in the system's usual place."""
    if own := os.environ.get("DPEND_CACHE"):
        return Path(own)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "dpend"


def nlp_solver(
    nlp: Mapping[str, Any],
    *,
    solver: Plugin = "auto",
    fatrop: Mapping[str, Any] | None = None,
    ipopt: Mapping[str, Any] | None = None,
    compiled: bool = True,
    derivatives: Sequence[Any] = (),
) -> NLPSolver:
    r"""Give a solver of :math:`\min_x f(x, p)` subject to bounds on :math:`x` and on :math:`g(x, p)`.

    Parameters
    ----------
    nlp : mapping
        Expressions ``x``, ``p`` (may be left out), ``f`` and ``g``, as ``casadi.nlpsol`` takes them.
    solver : {"auto", "fatrop", "ipopt"}
        ``"auto"`` is fatrop with compiled functions where they can be compiled, else IPOPT in CasADi's machine.
    fatrop, ipopt : mapping, optional
        Options of ``casadi.nlpsol`` for either solver.  Fatrop looks for an optimal control problem's stages: order
        variables ``x0, u0, x1, u1, ...``, constraints ``x1 - F(x0, u0), further ones of stage 0, ...``.
    compiled : bool
        Whether to look for a compiler at all.
    derivatives : sequence of casadi.Function, optional
        The problem's functions for fatrop, named as its solver asks for them, where they are known in a better form;
        left out, CasADi derives them.

    Returns
    -------
    NLPSolver

    Raises
    ------
    ValueError
        If there is no solver of that name.
    """
    if solver not in ("auto", "fatrop", "ipopt"):
        raise ValueError(f'solver must be "auto", "fatrop" or "ipopt"; got {solver!r}.')
    options = {"fatrop": dict(fatrop or {}), "ipopt": dict(ipopt or {})}
    wanted = "fatrop" if solver == "auto" else solver
    compiler = find_compiler() if compiled else None
    if compiler is not None:
        with tempfile.TemporaryDirectory() as folder:
            source = Path(folder) / "nlp.c"
            if not (derivatives and wanted == "fatrop"):
                virtual = casadi.nlpsol("solver", wanted, dict(nlp), options[wanted])
                derivatives = [virtual.oracle(), *map(virtual.get_function, virtual.get_function())]
            _generate(source, derivatives)
            library = _compile(source, compiler)
        if library is not None:
            solve = casadi.nlpsol("solver", wanted, str(library), options[wanted])
            return NLPSolver(solve, wanted, f"{_TITLES[wanted]}, compiled C")
    wanted = "ipopt" if solver == "auto" else solver
    solve = casadi.nlpsol("solver", wanted, dict(nlp), options[wanted])
    why = "" if not compiled else " (no C compiler)" if compiler is None else f" ({Path(compiler).name} failed)"
    return NLPSolver(solve, wanted, f"{_TITLES[wanted]}, CasADi's virtual machine{why}")


_TITLES = {"fatrop": "fatrop", "ipopt": "IPOPT"}


def _generate(source: Path, functions: Sequence[Any]) -> None:
    generator = casadi.CodeGenerator(source.name)
    for function in functions:
        generator.add(function)
    generator.generate(f"{source.parent}{os.sep}")


def _compile(source: Path, compiler: str) -> Path | None:
    """Give the shared library of a C source, from the cache if it is there; None if it cannot be made.

    Its name is a hash of all that it depends on, and it is put in its place in one move, so that processes that make
    the same one at once do not see each other's halves.
    """
    stamp = (compiler, str(os.stat(compiler).st_mtime_ns), *_FLAGS, casadi.CasadiMeta.version(), sys.platform)
    digest = hashlib.sha256("\0".join(stamp).encode() + source.read_bytes()).hexdigest()[:32]
    try:
        folder = cache_folder() / "c"
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        library = folder / f"{digest}.so"
        if not library.exists():
            handle, made = tempfile.mkstemp(dir=folder, suffix=".part")
            os.close(handle)
            try:
                command = [compiler, *_FLAGS, "-o", made, str(source), "-lm"]
                subprocess.run(command, check=True, capture_output=True, timeout=_PATIENCE)
                os.replace(made, library)
            finally:
                with contextlib.suppress(FileNotFoundError):
                    os.unlink(made)
    except (OSError, subprocess.SubprocessError):
        return None
    return library
