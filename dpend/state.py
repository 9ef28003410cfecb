"""The state: order, names, units, the four equilibria, and angles brought back to one turn."""

from __future__ import annotations

from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from .arguments import checked_array
from .params import Array
from .suggest import suggestion

NAMES = ("pos", "th1", "th2", "vel", "om1", "om2")
UNITS = ("m", "rad", "rad", "m/s", "rad/s", "rad/s")

_TURN = 2 * np.pi


def _at_rest(th1: float, th2: float) -> Array:
    x = np.array([0.0, th1, th2, 0.0, 0.0, 0.0])
    x.setflags(write=False)
    return x


EQUILIBRIA = MappingProxyType(
    {
        "up-up": _at_rest(0.0, 0.0),
        "up-down": _at_rest(0.0, np.pi),
        "down-up": _at_rest(np.pi, 0.0),
        "down-down": _at_rest(np.pi, np.pi),
    }
)
"""The four equilibria by name, link 1 first: states ``(6,)`` with the cart in the middle."""


def wrap_angle(angle):
    r"""Return :math:`\theta - 2\pi\,\mathrm{round}(\theta/2\pi)` for a float, an array, or in compiled code."""
    return angle - _TURN * np.rint(angle / _TURN)


def wrap(angle: npt.ArrayLike) -> Array:
    r"""Return :math:`\theta - 2\pi\,\mathrm{round}(\theta/2\pi)`, the difference to the nearest whole turn.

    A half turn may come back with either sign.

    Parameters
    ----------
    angle : array_like
        Angles of any shape, rad.

    Returns
    -------
    ndarray
        The same shape, within :math:`[-\pi, \pi]`.

    See Also
    --------
    dpend.nearest_upright : The same of states.

    Examples
    --------
    >>> import numpy as np
    >>> import dpend
    >>> float(dpend.wrap(2 * np.pi + 0.5).round(3))
    0.5
    """
    with np.errstate(invalid="ignore"):  # an infinite angle has no nearest turn
        return wrap_angle(checked_array("angle", angle, "angles, rad", finite=False))


def nearest_upright(x: npt.ArrayLike) -> Array:
    """Return the states with both angles taken to the nearest whole turn, so that upright is zero.

    Rates and position stay.

    Parameters
    ----------
    x : array_like
        States ``(..., 6)``.

    Returns
    -------
    ndarray
        New states ``(..., 6)``, angles within one half turn of upright.

    See Also
    --------
    dpend.wrap : The same of an angle.

    Examples
    --------
    >>> import numpy as np
    >>> import dpend
    >>> dpend.nearest_upright([0, 6.3, 0, 0, 0, 0])[1].round(3)
    np.float64(0.017)
    """
    x = state_rows("x", x).copy()
    x[..., 1:3] = wrap_angle(x[..., 1:3])
    return x


def state_rows(name: str, x: npt.ArrayLike, *, complex_too: bool = False) -> npt.NDArray[Any]:
    """Return states of any shape ``(..., 6)`` as an array, finite or not; refuse what is none."""
    array = checked_array(name, x, "states (..., 6)", finite=False, complex_too=complex_too)
    if array.ndim == 0 or array.shape[-1] != 6:
        raise ValueError(f"A state has six numbers: expected an array of shape (..., 6); got shape {array.shape}.")
    return array


def deviation(x: npt.ArrayLike, target: npt.ArrayLike) -> Array:
    r"""Return :math:`x - x^*` with both angles taken to the nearest whole turn, within :math:`[-\pi, \pi]`.

    ``x`` are states ``(..., 6)``, ``target`` is one ``(6,)``, or states that broadcast against ``x``.
    """
    x, target = state_rows("x", x), state_rows("target", target)
    try:
        away = x - target
    except ValueError:
        raise ValueError(f"States of shape {x.shape} and targets of shape {target.shape} do not broadcast.") from None
    away[..., 1:3] = wrap_angle(away[..., 1:3])
    return away


def as_equilibrium(target: str | npt.ArrayLike) -> Array:
    """Return the equilibrium of that name, or check that a state is one, without a force and wherever the cart stands.

    Parameters
    ----------
    target : str or array_like (6,)
        One of :data:`EQUILIBRIA`, or a state at rest with each link straight up or down, by any number of turns.

    Raises
    ------
    TypeError, ValueError
        If there is no such equilibrium; the message suggests the nearest.
    """
    if isinstance(target, str):
        if target not in EQUILIBRIA:
            raise ValueError(f"There is no equilibrium {target!r}.{suggestion(target, EQUILIBRIA)}")
        return EQUILIBRIA[target]
    x = checked_array("target", target, "the name of an equilibrium, or a state (6,)", finite=False).copy()
    at_rest = x.shape == (6,) and np.isfinite(x).all() and not x[3:].any()
    if not at_rest or np.abs(np.sin(x[1:3])).max() > 1e-9:
        raise ValueError(
            f"An equilibrium is at rest with each link straight up or down: expected one of {', '.join(EQUILIBRIA)} or "
            f"a state (pos, k1 pi, k2 pi, 0, 0, 0); got {target!r}."
        )
    x.setflags(write=False)
    return x


def one_state(name: str, x: npt.ArrayLike) -> Array:
    """Return one finite state as a new array ``(6,)``; refuse what is none."""
    state = checked_array(name, x, "a state (6,)", finite=False)
    if state.shape != (6,):
        raise ValueError(f"{name} must be one state of shape (6,); got shape {state.shape}.")
    return as_states(state)[0]


def as_states(x: npt.ArrayLike, n: int | None = None) -> Array:
    """Return ``x``, states ``(n, 6)`` or one ``(6,)``, as a new float64 array ``(n, 6)``, C-contiguous.

    Parameters
    ----------
    x : array_like
        The states.
    n : int, optional
        How many rows there must be; one state is then repeated, otherwise it stands for one row.

    Raises
    ------
    TypeError, ValueError
        If it is not made of numbers, has another shape, or a number is not finite.
    """
    array = checked_array("x", x, "states (N, 6) or one state (6,)", finite=False)
    if array.shape == (6,):
        array = np.repeat(array[None], 1 if n is None else n, axis=0)
    if array.ndim != 2 or array.shape[1] != 6 or (n is not None and len(array) != n):
        rows = "N" if n is None else n
        raise ValueError(
            f"A state has six numbers ({', '.join(NAMES)}): expected an array of shape ({rows}, 6) or (6,); "
            f"got shape {array.shape}."
        )
    if not np.isfinite(array).all():
        row, column = np.argwhere(~np.isfinite(array))[0]
        raise ValueError(f"States must be finite; got {array[row, column]} for {NAMES[column]} in row {row}.")
    return np.array(array, order="C")
