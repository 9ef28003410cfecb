"""Solvers of nonlinear programs: in C, compiled and kept, where there is a compiler; in CasADi's own machine elsewhere.

CasADi interprets a program's functions unless they are compiled, which takes several times as long.  Nothing asks
for a compiler when the package is installed: it is looked for when a solver is made, and doing without one is no error.
"""

from __future__ import annotations

import hashlib
import os
import platform
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
    """Return the path of a C compiler, ``$CC`` or else ``cc``, ``gcc`` or ``clang``; None where there is none."""
    if sys.platform == "win32":  # what is found there takes other flags
        return None
    for name in (os.environ.get("CC"), "cc", "gcc", "clang"):
        if name and (path := shutil.which(name)):
            return path
    return None


def cache_folder() -> Path:
    """Return the user's own folder for compiled code: ``$DPEND_CACHE``, or ``dpend`` in the system's usual place."""
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
    r"""Return a solver of :math:`\min_x f(x, p)` subject to bounds on :math:`x` and on :math:`g(x, p)`.

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
        The problem's functions, named as ``casadi.nlpsol`` asks for them with fatrop (``nlp``, ``nlp_f``, ``nlp_g``,
        ``nlp_grad``, ``nlp_grad_f``, ``nlp_jac_g``, ``nlp_hess_l``), where they are known in a better form; left out,
        CasADi derives them.

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
    ours = {function.name(): function for function in derivatives}
    for_ipopt = ours | _for_ipopt(ours) if ours else {}
    wanted = "fatrop" if solver == "auto" else solver
    compiler = find_compiler() if compiled else None
    if compiler is not None:
        functions = list((ours if wanted == "fatrop" else for_ipopt).values())
        if not functions:
            virtual = casadi.nlpsol("solver", wanted, dict(nlp), options[wanted])
            functions = [virtual.oracle(), *map(virtual.get_function, virtual.get_function())]
        library = _compiled(functions, compiler)
        if library is not None:
            try:
                solve = casadi.nlpsol("solver", wanted, str(library), options[wanted])
                return NLPSolver(solve, wanted, f"{_TITLES[wanted]}, compiled C")
            except RuntimeError:  # it cannot be loaded: cut short, or where no code may lie
                library.unlink(missing_ok=True)
    wanted = "ipopt" if solver == "auto" else solver
    if ours and wanted == "ipopt":
        options["ipopt"] |= {"jac_g": ours["nlp_jac_g"], "hess_lag": for_ipopt["nlp_hess_l"]}
    solve = casadi.nlpsol("solver", wanted, dict(nlp), options[wanted])
    why = "" if not compiled else " (no C compiler)" if compiler is None else f" ({Path(compiler).name} failed)"
    return NLPSolver(solve, wanted, f"{_TITLES[wanted]}, CasADi's virtual machine{why}")


_TITLES = {"fatrop": "fatrop", "ipopt": "IPOPT"}


def _for_ipopt(ours: Mapping[str, Any]) -> dict[str, Any]:
    """Return functions that IPOPT wants otherwise than fatrop: the gradient with f, the Hessian's upper triangle."""
    hessian = ours["nlp_hess_l"]
    x, p, lam_f, lam_g = (casadi.MX.sym(hessian.name_in(i), hessian.sparsity_in(i)) for i in range(4))
    upper = casadi.triu(hessian(x, p, lam_f, lam_g)[1])
    ins, outs = ["x", "p"], ["f", "grad_f_x"]
    return {
        "nlp_grad_f": casadi.Function("nlp_grad_f", [x, p], [ours["nlp_f"](x, p), ours["nlp_grad_f"](x, p)], ins, outs),
        "nlp_hess_l": casadi.Function(
            "nlp_hess_l", [x, p, lam_f, lam_g], [upper], [*ins, "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]
        ),
    }


def _compiled(functions: Sequence[Any], compiler: str) -> Path | None:
    """Return the shared library of some functions, from the cache if it is there; None if it cannot be made.

    Its name is a hash of all that it depends on, and it is put in its place in one move, so that processes that make
    the same one at once do not see each other's halves.
    """
    generator = casadi.CodeGenerator("nlp.c")
    for function in functions:
        generator.add(function)
    code = generator.dump()
    machine = sys.platform, platform.machine()
    stamp = (compiler, str(os.stat(compiler).st_mtime_ns), *_FLAGS, casadi.CasadiMeta.version(), *machine, code)
    digest = hashlib.sha256("\0".join(stamp).encode()).hexdigest()[:32]
    try:
        folder = cache_folder() / "c"
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        kept = folder.stat()
        if kept.st_uid != os.getuid() or kept.st_mode & 0o022:  # others could put code there
            return None
        library = folder / f"{digest}.so"
        if not library.exists():
            with tempfile.TemporaryDirectory(dir=folder) as work:
                source, made = Path(work) / "nlp.c", Path(work) / "nlp.so"
                source.write_text(code)
                command = [compiler, *_FLAGS, "-o", str(made), str(source), "-lm"]
                subprocess.run(command, check=True, capture_output=True, timeout=_PATIENCE)
                made.replace(library)
    except (OSError, RuntimeError, subprocess.SubprocessError):  # no folder, no home, no success
        return None
    return library
