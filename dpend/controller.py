"""What a controller is: a description that makes fresh working memory for each run, or a function of one state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, cast, runtime_checkable

import numpy as np
import numpy.typing as npt

from .params import Array

Act = Callable[[float, Array], Array]
r"""The law at work, :math:`u = \mathrm{act}(t, y)`: time in s and measurements ``(n, 6)`` to forces ``(n,)`` in N.

A law may carry an attribute ``log``, a mapping from names to lists that grow by one entry at each call: a number, or an
array ``(n,)`` of one a row.  The records of runs keep it.
"""

Law = Callable[[float, Array], npt.ArrayLike]
r"""A plain function :math:`u = \mathrm{law}(t, x)`: time in s and one state ``(6,)`` to a force in N."""


@runtime_checkable
class Controller(Protocol):
    """A description of a control law, the same before, during and after every run.

    A class with this one method is a controller; nothing need be inherited or registered.  A law that can treat only
    one run at a time says so with a class attribute ``batched = False`` and is then started once for each row.  It is
    still given rows, ``(1, 6)``, the state being ``y[0]``: all laws are called alike, so that wrappers, estimators and
    switches serve each.  Only a plain function is given a state ``(6,)``.

    ``mirrored = True`` claims that mirrored measurements have mirrored forces, :math:`u(-y) = -u(y)`.
    ``dpend.check_controller`` holds a controller to this, and to what all of them keep to.

    Parameters
    ----------
    *args, **kwargs : Any
        A controller is built as its class says; the protocol asks for nothing.

    See Also
    --------
    dpend.check_controller : Hold a controller to the contract.
    dpend.simulate : Run one.

    Examples
    --------
    >>> import dpend
    >>> rig = dpend.rig("gustafsson2016")
    >>> class ByHand:
    ...     def start(self, n, rng):
    ...         return lambda t, y: y @ [-1, 150, -165, -2.5, 7, -29]
    >>> dpend.simulate(rig, ByHand(), [0, 0.1, -0.1, 0, 0, 0], duration=1.0).success
    True
    """

    def start(self, n: int, rng: np.random.Generator) -> Act:
        """Return the law for ``n`` runs side by side, with memory of its own.

        What a run remembers lives in the closure, so that one controller serves many runs at once.

        Parameters
        ----------
        n : int
            Number of runs.
        rng : numpy.random.Generator
            The source of whatever the law draws at random, one for the whole batch.  A batched law that draws numbers
            for a row takes them from that row's own of ``dpend.rows.row_generators(rng, n)``, so that the row draws in
            any batch what it draws alone.

        Returns
        -------
        callable
            ``act(t, y)``: time in s and measurements ``(n, 6)`` to forces ``(n,)`` in N.

        See Also
        --------
        dpend.simulate_many : Start a law and run it.

        Examples
        --------
        >>> import numpy as np
        >>> from controllers import LQR
        >>> act = LQR("gustafsson2016").start(2, np.random.default_rng(0))
        >>> act(0.0, np.zeros((2, 6))).shape
        (2,)
        """
        ...


class LawError(ValueError):
    """A law, or a push, that failed while it ran: the message says whose, when and for which rows.

    The law's own exception is its cause.

    Parameters
    ----------
    message : str
        What happened.
    runs : Runs
        The runs up to then.

    Attributes
    ----------
    runs : Runs
        The runs up to then; those that were going on end as ``Status.CONTROLLER_FAILED``.

    See Also
    --------
    dpend.simulate_many : Raise it.

    Examples
    --------
    >>> import dpend
    >>> rig = dpend.rig("gustafsson2016")
    >>> def broken(t, x):
    ...     raise ZeroDivisionError
    >>> try:
    ...     dpend.simulate(rig, broken, [0, 0.1, 0, 0, 0, 0], duration=1.0)
    ... except dpend.LawError as error:
    ...     print(type(error.__cause__).__name__)
    ZeroDivisionError
    """

    def __init__(self, message: str, runs: Any = None) -> None:
        super().__init__(message)
        self.runs = runs


@dataclass(frozen=True)
class FunctionController:
    """A plain function of one state as a controller; what it remembers is its own affair.

    Parameters
    ----------
    law : callable
        ``law(t, x)``: time in s and a state ``(6,)`` to a force in N.
    """

    law: Law
    batched = False

    @property
    def name(self) -> str:
        """The function's name."""
        return str(getattr(self.law, "__name__", type(self.law).__name__))

    def start(self, n: int, rng: np.random.Generator) -> Act:
        """Return the law for ``n`` runs, called row by row."""

        def act(t: float, y: Array) -> Array:
            forces = [np.asarray(self.law(t, x.copy()), dtype=np.float64) for x in y]
            if any(force.size != 1 for force in forces):
                raise ValueError(f"expected one force; got shape {next(f.shape for f in forces if f.size != 1)}.")
            return np.array([force.item() for force in forces])

        return act


def as_controller(controller: Controller | Law) -> Controller:
    """Return the controller, or a plain function ``law(t, x)`` of one state as one; refuse anything else."""
    if callable(controller) and not isinstance(controller, type) and not hasattr(controller, "start"):
        return FunctionController(controller)
    check_controller(controller)
    return cast(Controller, controller)


def name_of(controller: Controller) -> str:
    """Return what a controller is called: its ``name``, or its class's."""
    return str(getattr(controller, "name", type(controller).__name__))


def is_batched(controller: Controller) -> bool:
    """Return whether the controller treats many runs at once, as it does unless it says otherwise."""
    return bool(getattr(controller, "batched", True))


def check_controller(controller: object) -> None:
    """Refuse what is not a controller: a class rather than an object, or what has no ``start``."""
    if isinstance(controller, type):
        raise TypeError(f"Expected a controller object; got the class {controller.__name__}. Call it first.")
    if not callable(getattr(controller, "start", None)):
        raise TypeError(
            f"A controller has a method start(n, rng) that returns act(t, y); {type(controller).__name__} has none."
        )
