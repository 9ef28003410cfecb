"""Solvers of nonlinear programs: in C, compiled and kept, where there is a compiler; in CasADi's own machine elsewhere.

CasADi interprets a program's functions unless they are compiled, which takes several times as long.  Nothing asks
for a compiler when the package is installed: it is looked for when a solver is made, and doing without one is no error.

A solve can neither hang nor be deaf to Ctrl-C: it runs in a thread of its own, beside which the caller waits.
"""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from threading import Event, Thread
from typing import Any, Literal, NamedTuple

import casadi
import numpy as np

from dpend.cache import NotPrivate, private_folder
from dpend.params import Array

Plugin = Literal["auto", "fatrop", "ipopt"]

_FLAGS = ("-O1", "-fPIC", "-shared", "-fno-math-errno", "-w")
_PATIENCE = 300.0  # s, after which a compiler is abandoned
_GRACE = 0.5  # s, which a solver has to come to its end after Ctrl-C


class Solution(NamedTuple):
    r"""What one solve led to.

    Attributes
    ----------
    x : ndarray (n,)
        The variables, NaN where the solver returned nothing.
    cost : float
        :math:`f(x, p)`.
    violation : float
        :math:`\max_i |g_i(x, p)|`.
    success : bool
        Whether the solver says that it converged.
    status : str
        Why it stopped, in its own words.
    iterations : int
        How many it took.
    """

    x: Array
    cost: float
    violation: float
    success: bool
    status: str
    iterations: int


class NLPSolver:
    """A solver: a function of what ``casadi.nlpsol`` takes, ``x0``, ``p``, ``lbx``, ``ubx``, ``lbg`` and ``ubg``.

    CasADi's solver remembers: give every run a fresh one, so that runs neither meet in threads nor depend on earlier
    ones.  ``make`` returns a new one, given what IPOPT is to call after each iteration; ``sizes`` are those of the
    program's ``x``, ``g`` and ``p``; ``plugin`` is "fatrop" or "ipopt"; ``backend`` says in words what evaluates it.
    """

    def __init__(self, make: Callable[[_Stop], Any], sizes: Mapping[str, int], plugin: str, backend: str) -> None:
        self._make = make
        self._sizes = sizes
        self._solve: tuple[Any, _Stop] | None = None
        self.plugin = plugin
        self.backend = backend

    def fresh(self) -> NLPSolver:
        """Return one that remembers nothing and shares nothing; what is compiled is not compiled again."""
        return NLPSolver(self._make, self._sizes, self.plugin, self.backend)

    def __call__(self, *, patience: float | None = None, **arguments: Any) -> Solution:
        """Return what one solve leads to, given arguments of ``casadi.nlpsol``; an error is a failure that says so.

        A solve is abandoned after ``patience`` seconds, if given.  Fatrop corrects the inertia of what is not finite
        for ever, and cannot be ended: what is left of it goes on in its thread.
        """
        if self._solve is None:
            stop = _Stop(self._sizes)
            self._solve = self._make(stop), stop
        solve, stop = self._solve
        found: dict[str, Any] = {}
        done = Event()

        def work() -> None:
            try:
                found.update(solve.call(arguments))
            except Exception:  # what CasADi makes of whatever a solver stumbles over
                pass
            finally:
                done.set()

        Thread(target=work, daemon=True).start()
        try:
            in_time = done.wait(patience)
        except BaseException:
            stop.asked.set()
            done.wait(_GRACE)
            self._solve = None
            raise
        if not (in_time and found):
            stop.asked.set()
            self._solve = None
            status = "an error in the solver" if in_time else f"abandoned after {patience:g} s"
            return Solution(np.full(self._sizes["x"], np.nan), np.inf, np.inf, False, status, 0)
        stats = solve.stats()
        status = stats.get("return_status")
        if not isinstance(status, str):  # fatrop's is a number
            status = str(stats.get("unified_return_status", "failure")).removeprefix("SOLVER_RET_")
        return Solution(
            found["x"].full().ravel(),
            float(found["f"]),
            float(casadi.norm_inf(found["g"])),
            bool(stats["success"]),
            status.lower().replace("_", " "),
            int(stats["iter_count"]),
        )


class _Stop(casadi.Callback):
    """What IPOPT calls after each iteration: it goes on unless it has been asked to stop."""

    def __init__(self, sizes: Mapping[str, int]) -> None:
        casadi.Callback.__init__(self)
        self.asked = Event()
        x, g, p = (sizes[name] for name in "xgp")
        self._sizes = {"x": x, "f": 1, "g": g, "lam_x": x, "lam_g": g, "lam_p": p}
        self.construct("stop", {})

    def get_n_in(self) -> int:
        return casadi.nlpsol_n_out()

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> Any:
        return casadi.Sparsity.dense(self._sizes[casadi.nlpsol_out(i)], 1)

    def eval(self, arguments: Any) -> list[float]:
        return [float(self.asked.is_set())]


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
    sizes = {name: nlp[name].numel() if name in nlp else 0 for name in "xgp"}

    def made(plugin: str, problem: Any, where: str) -> NLPSolver:
        def make(stop: _Stop) -> Any:
            extra = {"iteration_callback": stop} if plugin == "ipopt" else {}
            return casadi.nlpsol("solver", plugin, problem, options[plugin] | extra)

        return NLPSolver(make, sizes, plugin, f"{_TITLES[plugin]}, {where}")

    wanted = "fatrop" if solver == "auto" else solver
    compiler = find_compiler() if compiled else None
    why = "" if not compiled else " (no C compiler)" if compiler is None else f" ({Path(compiler).name} failed)"
    if compiler is not None:
        functions = list((ours if wanted == "fatrop" else for_ipopt).values())
        if not functions:
            virtual = casadi.nlpsol("solver", wanted, dict(nlp), options[wanted])
            functions = [virtual.oracle(), *map(virtual.get_function, virtual.get_function())]
        try:
            library = _compiled(functions, compiler)
        except NotPrivate as reason:
            library, why = None, f" ({reason})"
        if library is not None:
            try:
                casadi.nlpsol("solver", wanted, str(library), options[wanted])
                return made(wanted, str(library), "compiled C")
            except RuntimeError:  # it cannot be loaded, as where no code may lie
                library.unlink(missing_ok=True)
    wanted = "ipopt" if solver == "auto" else solver
    if ours and wanted == "ipopt":
        options["ipopt"] |= {"jac_g": ours["nlp_jac_g"], "hess_lag": for_ipopt["nlp_hess_l"]}
    return made(wanted, dict(nlp), f"CasADi's virtual machine{why}")


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

    Its name is a hash of all that it depends on and one of what it holds, so that a damaged one is found out before
    it is loaded; and it is moved to its place, so that processes that compile the same do not see each other's halves.
    """
    generator = casadi.CodeGenerator("nlp.c")
    for function in functions:
        generator.add(function)
    code = generator.dump()
    machine = sys.platform, platform.machine()
    stamp = (compiler, str(os.stat(compiler).st_mtime_ns), *_FLAGS, casadi.CasadiMeta.version(), *machine, code)
    digest = _digest("\0".join(stamp).encode())
    try:
        folder = private_folder(cache_folder() / "c")
        for library in folder.glob(f"{digest}-*.so"):
            if library.stem == f"{digest}-{_digest(library.read_bytes())}":
                return library
            library.unlink(missing_ok=True)
        with tempfile.TemporaryDirectory(dir=folder) as work:
            source, made = Path(work) / "nlp.c", Path(work) / "nlp.so"
            source.write_text(code)
            command = [compiler, *_FLAGS, "-o", str(made), str(source), "-lm"]
            subprocess.run(command, check=True, capture_output=True, timeout=_PATIENCE)
            return made.replace(folder / f"{digest}-{_digest(made.read_bytes())}.so")
    except NotPrivate:
        raise
    except (OSError, RuntimeError, subprocess.SubprocessError):  # no folder, no home, no success
        return None


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:32]
