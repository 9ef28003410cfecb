"""What stands around a law: a wrapper that passes on what the law inside logs, and the last finite measurement."""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Callable, MutableMapping
from typing import Any

import numpy as np
import numpy.typing as npt

from dpend.controller import Act, Controller, Law, as_controller, is_batched, name_of
from dpend.params import Array


def log_of(act: Act) -> MutableMapping[str, Any]:
    """Return the log of a law at work; an empty one where it keeps none."""
    return getattr(act, "log", {})


def with_logs(act: Act, *logs: MutableMapping[str, Any]) -> Act:
    """Return a law that shows several logs as one, the first of a name counting; they may still grow, in names too."""
    act.log = ChainMap(*logs)  # type: ignore[attr-defined]
    return act


class Wrapper:
    """A controller around another: batched if that is, with its log, under a name made from its name.

    A subclass says in ``_around`` what becomes of the wrapped law, which may be a plain function ``law(t, x)`` of one
    state; in ``name``, ``{}`` stands for its name.
    """

    def __init__(self, controller: Controller | Law, name: str) -> None:
        self.controller = as_controller(controller)
        self.batched = is_batched(self.controller)
        self.name = name.replace("{}", name_of(self.controller))

    def __repr__(self) -> str:
        return f"<{self.name}>"

    def start(self, n: int, rng: np.random.Generator) -> Act:
        """Return the law for ``n`` runs."""
        inner = self.controller.start(n, rng)
        return holding(n, with_logs(self._around(n, inner), log_of(inner)))

    def _around(self, n: int, inner: Act) -> Act:
        """Return the law for ``n`` runs around the wrapped law at work."""
        raise NotImplementedError


def holding(n: int, law: Act) -> Act:
    """Return a law for which the last finite measurement of a row counts where one is not finite.

    A row has no force before its first finite measurement.  From the first that is missing on, the log holds under
    ``held``, call by call, in which rows an older measurement counted.
    """
    last, seen = np.zeros((n, 6)), np.zeros(n, dtype=np.bool_)
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
