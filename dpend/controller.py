"""What a controller is: a description that makes fresh working memory for each run."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, runtime_checkable

import numpy as np

from .params import Array

Act = Callable[[float, Array], Array]
r"""The law at work, :math:`u = \mathrm{act}(t, y)`: time in s and measurements ``(n, 6)`` to forces ``(n,)`` in N.

A law that has more to tell carries an attribute ``log``, a mapping from names to lists that grow by one entry at each
call: a number, or an array ``(n,)`` of one a row.  The records of runs keep it.
"""


@runtime_checkable
class Controller(Protocol):
    """A description of a control law, the same before, during and after every run.

    A class with this one method is a controller; nothing need be inherited or registered.  A law that can treat only
    one run at a time says so with a class attribute ``batched = False`` and is then started once for each row.
    """

    def start(self, n: int, rng: np.random.Generator) -> Act:
        """Return the law for ``n`` runs side by side, with memory of its own.

        Parameters
        ----------
        n : int
            Number of runs.
        rng : numpy.random.Generator
            The source of whatever the law draws at random; one for the whole batch, so a batched law that draws gives a
            row other numbers in another batch.

        Returns
        -------
        callable
            ``act(t, y)``: time in s and measurements ``(n, 6)`` to forces ``(n,)`` in N.
        """
        ...


def is_batched(controller: Controller) -> bool:
    """Return whether the controller treats many runs at once, as it does unless it says otherwise."""
    return bool(getattr(controller, "batched", True))


def check_controller(controller: object) -> None:
    """Refuse what is not a controller.

    Raises
    ------
    TypeError
        If it is a class rather than an object, or has no ``start``.
    """
    if isinstance(controller, type):
        raise TypeError(f"Expected a controller object; got the class {controller.__name__}. Call it first.")
    if not isinstance(controller, Controller):
        raise TypeError(
            f"A controller has a method start(n, rng) that returns act(t, y); {type(controller).__name__} has none."
        )
