"""Laws at work: what they log, and the last finite measurement where one is missing."""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Callable, MutableMapping
from typing import Any

import numpy as np
import numpy.typing as npt

from .controller import Act
from .params import Array


def log_of(act: Act) -> MutableMapping[str, Any]:
    """Return the log of a law at work; an empty one where it keeps none."""
    return getattr(act, "log", {})


def with_logs(act: Act, *logs: MutableMapping[str, Any]) -> Act:
    """Return a law that shows several logs as one, the first of a name counting; they may still grow, in names too."""
    act.log = ChainMap(*logs)  # type: ignore[attr-defined]
    return act


def linear_law(K: Array, target: Array) -> Act:
    """Return the law :math:`u = -K(y - y^*)` of a gain ``(6,)`` and a target ``(6,)``, angles to the nearest turn."""
    from .kernels import linear_forces  # numba loads with the first law at work, not with `from controllers import LQR`

    def act(_: float, y: Array) -> Array:
        u = np.empty(len(y))
        linear_forces(y, target, K, u)
        return u

    return act


def holding(n: int, law: Act, before: float = 0.0) -> Act:
    """Return a law for which the last finite measurement of a row counts where one is not finite.

    A row has no force before its first finite measurement, which until then is six times ``before`` to the law.  From
    the first that is missing on, the log holds under ``held``, call by call, in which rows an older measurement
    counted.
    """
    last, seen = np.full((n, 6), before), np.zeros(n, dtype=np.bool_)
    log, missing_in = watch(n)

    def act(t: float, y: Array) -> Array:
        nonlocal last
        missing = missing_in(y)
        if missing is None:
            seen[:] = True
            last = y.copy()
            return law(t, last)
        seen[~missing] = True
        last = np.where(missing[:, None], last, y)
        return np.where(seen, law(t, last), 0.0)

    return with_logs(act, log, log_of(law))


def finite_rows(y: Array) -> npt.NDArray[np.bool_]:
    """Return in which rows ``(n,)`` all numbers are finite."""
    return np.asarray(np.isfinite(y).all(axis=1))


def watch(n: int) -> tuple[dict[str, list[Array]], Callable[[Array], npt.NDArray[np.bool_] | None]]:
    """Return a log, and what enters under ``held`` which rows of the measurements of a call are not finite.

    The log stays empty, and the answer is None, as long as all are finite.
    """
    log: dict[str, list[Array]] = {}
    calls = 0

    def missing_in(y: Array) -> npt.NDArray[np.bool_] | None:
        nonlocal calls
        calls += 1
        if np.isfinite(y).all() and not log:  # far faster than row by row
            return None
        missing = ~finite_rows(y)
        log.setdefault("held", [np.zeros(n)] * (calls - 1)).append(missing.astype(np.float64))
        return missing

    return log, missing_in
