r"""The numba instances of the equations, one batched plant step and one scalar step; and loops that judge states.

What makes the batch fast (``benchmarks/simulator.py`` measures the whole): the loop over rows is innermost and runs
over a small local block, so LLVM turns it into vector instructions; everything it calls is inlined by force; division
does not check for zero; and sine and cosine are polynomials, because the library's do not vectorise.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core.caching import FunctionCache
from numba.np.unsafe.ndarray import to_fixed_tuple

from . import episode, equations, state
from .cache import NotPrivate, private_folder
from .params import Coefficients
from .provenance import fingerprint
from .trigonometry import make_sines

OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}}
"""How numba compiles, everywhere."""

inline = numba.njit(forceinline=True, **OPTIONS)
"""Compile a function that others inline.  ``contract`` fuses multiply-adds and leaves NaN as it is."""


class _Cache(FunctionCache):
    """Numba's cache, in which what cannot be read is compiled anew, and a full disk is no error.

    What a function closes over is named by a key: numba's own hash of compiled functions differs in each process.
    """

    def __init__(self, function: Callable[..., Any], key: str) -> None:
        super().__init__(function)
        self._key = key

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        return (sig, codegen.magic_tuple(), self._key) if self._key else super()._index_key(sig, codegen)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # whatever pickle makes of a damaged file
            self._saved(self.flush)
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        self._saved(super().save_overload, sig, data)

    def _saved(self, save: Callable[..., None], *args: Any) -> None:
        try:
            save(*args)
        except OSError:
            self.disable()


def compiled(function: Callable[..., Any], sources: Iterable[Path] = (), key: str = "") -> Any:
    """Compile an entry point and keep the machine code on disk.

    Numba notices edits in the function's own file only, so the folder is named after a hash of all the sources it may
    use: what this file is made of, the function's own package where that is another, and those given.  A function that
    closes over others has a key, which names them.  Where no folder can be
    written, it is compiled anew each time; so it is, with a warning, where others may write to the folder, because
    what numba reads from it is a pickle.
    """
    here = Path(__file__).parent
    package = Path(function.__code__.co_filename).parent
    own = ("equations.py", "trigonometry.py", "episode.py", "params.py", "state.py", "status.py", "kernels.py")
    every = {*(here / name for name in own), *([package] if package != here else []), *sources}
    before = numba.config.CACHE_DIR  # type: ignore[attr-defined]
    dispatcher = numba.njit(**OPTIONS)(function)
    try:
        root = Path(os.environ.get("NUMBA_CACHE_DIR") or Path.home() / ".cache" / "dpend")
        numba.config.CACHE_DIR = str(private_folder(root / fingerprint(*sorted(every))))  # type: ignore[attr-defined]
        dispatcher._cache = _Cache(function, key)  # type: ignore[attr-defined]
    except NotPrivate as reason:
        warnings.warn(str(reason), RuntimeWarning, stacklevel=2)
    except (OSError, RuntimeError):  # there is no home, or no folder that may be written to
        pass
    finally:
        numba.config.CACHE_DIR = before  # type: ignore[attr-defined]
    return dispatcher


sin, cos = make_sines(np.rint, inline)
rates = inline(equations.make_rates(sin, cos, inline(equations.coulomb)))
rates_without_coulomb = inline(equations.make_rates(sin, cos, inline(equations.no_coulomb)))
"""The same bits where there is no Coulomb friction, without its root and division."""
axpy = inline(equations.axpy)
acceleration_slopes = inline(equations.make_acceleration_slopes(sin, cos))


def make_sample(rates: Any) -> Any:
    """Build a sample: the state tuple after ``substeps`` Runge-Kutta steps of ``h`` seconds under held forces."""
    rk4 = inline(equations.make_rk4(rates, axpy))

    @inline
    def sample(x, f, c, h, substeps):
        for _ in range(substeps):
            x = rk4(x, f, c, h)
        return x

    return sample


rk4 = inline(equations.make_rk4(rates, axpy))
_rk4_without_coulomb = inline(equations.make_rk4(rates_without_coulomb, axpy))
sample = make_sample(rates)
"""The scalar step of the plant."""


_BLOCK = 64
_FIELDS = len(Coefficients._fields)
_WIDTH = 9 + _FIELDS


@inline
def _state_at(block, j):
    return (
        block[j],
        block[_BLOCK + j],
        block[2 * _BLOCK + j],
        block[3 * _BLOCK + j],
        block[4 * _BLOCK + j],
        block[5 * _BLOCK + j],
    )


@inline
def _set_state(block, j, x):
    block[j] = x[0]
    block[_BLOCK + j] = x[1]
    block[2 * _BLOCK + j] = x[2]
    block[3 * _BLOCK + j] = x[3]
    block[4 * _BLOCK + j] = x[4]
    block[5 * _BLOCK + j] = x[5]


@inline
def _forces_at(block, j):
    return block[6 * _BLOCK + j], block[7 * _BLOCK + j], block[8 * _BLOCK + j]


# Rows of states end to end, ``(6 n,)``: so written, LLVM moves them between rows and columns by whole vectors.
@inline
def _flat_row(flat, i):
    return flat[6 * i], flat[6 * i + 1], flat[6 * i + 2], flat[6 * i + 3], flat[6 * i + 4], flat[6 * i + 5]


@inline
def _set_flat_row(flat, i, x):
    flat[6 * i] = x[0]
    flat[6 * i + 1] = x[1]
    flat[6 * i + 2] = x[2]
    flat[6 * i + 3] = x[3]
    flat[6 * i + 4] = x[4]
    flat[6 * i + 5] = x[5]


@compiled
def plant_step(x, f, coefficients, h, substeps):
    r"""Advance states in place by ``substeps`` Runge-Kutta steps of :math:`\dot x = \mathrm{rates}(x, f, c)`.

    ``x`` are states ``(n, 6)``, C-contiguous; ``f`` the generalised forces ``(3, n)``, held; ``coefficients`` columns
    of :class:`~dpend.params.Coefficients`, ``(15, 1)`` for all or ``(15, n)``, one each; ``h`` the length of a step, s.
    """
    n = x.shape[0]
    flat = x.reshape(-1)
    shared = coefficients.shape[1] == 1
    c = Coefficients(*to_fixed_tuple(coefficients[:, 0], _FIELDS))  # pyright: ignore[reportCallIssue]
    block = np.empty(_WIDTH * _BLOCK)
    for start in range(0, n, _BLOCK):
        m = min(_BLOCK, n - start)
        rows = flat[6 * start : 6 * (start + m)]
        for j in range(m):
            _set_state(block, j, _flat_row(rows, j))
        for j in range(m):
            block[6 * _BLOCK + j] = f[0, start + j]
            block[7 * _BLOCK + j] = f[1, start + j]
            block[8 * _BLOCK + j] = f[2, start + j]
        if shared and c.coulomb == 0.0:
            for _ in range(substeps):
                for j in range(m):
                    _set_state(block, j, _rk4_without_coulomb(_state_at(block, j), _forces_at(block, j), c, h))
        elif shared:
            for _ in range(substeps):
                for j in range(m):
                    _set_state(block, j, rk4(_state_at(block, j), _forces_at(block, j), c, h))
        else:
            for k in range(_FIELDS):
                for j in range(m):
                    block[(9 + k) * _BLOCK + j] = coefficients[k, start + j]
            for _ in range(substeps):
                for j in range(m):
                    own = Coefficients(
                        block[9 * _BLOCK + j],
                        block[10 * _BLOCK + j],
                        block[11 * _BLOCK + j],
                        block[12 * _BLOCK + j],
                        block[13 * _BLOCK + j],
                        block[14 * _BLOCK + j],
                        block[15 * _BLOCK + j],
                        block[16 * _BLOCK + j],
                        block[17 * _BLOCK + j],
                        block[18 * _BLOCK + j],
                        block[19 * _BLOCK + j],
                        block[20 * _BLOCK + j],
                        block[21 * _BLOCK + j],
                        block[22 * _BLOCK + j],
                        block[23 * _BLOCK + j],
                    )
                    _set_state(block, j, rk4(_state_at(block, j), _forces_at(block, j), own, h))
        for j in range(m):
            _set_flat_row(rows, j, _state_at(block, j))


wrap_angle = inline(state.wrap_angle)
status_code = inline(episode.status_code)
report_cost = inline(episode.make_report_cost(wrap_angle))
upright_reward = inline(episode.make_upright_reward(cos, math.exp))
links_upright = inline(episode.make_links_upright(wrap_angle))
counted = inline(episode.counted)
succeeded = inline(episode.succeeded)


@inline
def _row(x, i):
    return x[i, 0], x[i, 1], x[i, 2], x[i, 3], x[i, 4], x[i, 5]


@compiled
def linear_forces(y, target, K, u):
    r"""Fill in :math:`u = -K(y - y^*)` for states ``(n, 6)``, with both angles taken to the nearest whole turn.

    The terms are added up in order, so that a row has the same force in every batch.
    """
    flat = y.ravel()
    for i in range(len(u)):
        pos, th1, th2, vel, om1, om2 = _flat_row(flat, i)
        total = K[0] * (pos - target[0])
        total += K[1] * wrap_angle(th1 - target[1])
        total += K[2] * wrap_angle(th2 - target[2])
        total += K[3] * (vel - target[3])
        total += K[4] * (om1 - target[4])
        total += K[5] * (om2 - target[5])
        u[i] = -total


@compiled
def status_codes(x, track_limit, limit1, limit2, codes):
    """Fill in the status codes of states ``(n, 6)`` for bounds on position, one or one a row, and angles.

    This and the next two fill an array, the last argument, because to return one takes numba longer than to judge a
    row.
    """
    limits = np.broadcast_to(track_limit, codes.shape)
    for i in range(len(codes)):
        codes[i] = status_code(_row(x, i), (limits[i], limit1, limit2))


@compiled
def report_costs(x, codes, target, weights, failure_cost, costs):
    """Fill in the report's cost of arriving in states ``(n, 6)`` with those status codes."""
    for i in range(len(costs)):
        costs[i] = report_cost(_row(x, i), codes[i], target, weights, failure_cost)


@compiled
def rows_upright(x, target, angle, upright):
    """Fill in which states ``(n, 6)`` have both links within an angle of where they are to be."""
    for i in range(len(upright)):
        upright[i] = links_upright(_row(x, i), target, angle)


@compiled
def upright_rewards(x, codes, target, slowness, rewards):
    """Fill in the default reward of a swing-up for states ``(n, 6)``; ``slowness`` is ``(1,)`` or ``(n,)``."""
    slow = np.broadcast_to(slowness, rewards.shape)
    for i in range(len(rewards)):
        rewards[i] = upright_reward(_row(x, i), codes[i], target, slow[i])
