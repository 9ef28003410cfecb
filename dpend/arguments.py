"""Checks of the numbers that callers pass: finite ones, whole ones, seeds."""

from __future__ import annotations

from typing import TypeGuard

import numpy as np


def is_finite(value: object) -> TypeGuard[float]:
    """Return whether a value is one finite real number; strings, truth values and arrays of several are none."""
    return np.ndim(value) == 0 and np.asarray(value).dtype.kind in "iuf" and bool(np.isfinite(value))  # type: ignore[call-overload,arg-type]


def checked_whole(name: str, value: object, least: int = 1) -> int:
    """Return a whole number, Python's or numpy's, as an integer.

    Parameters
    ----------
    name : str
        What the caller calls it.
    value : int
        What came.
    least : int
        The least that makes sense.

    Returns
    -------
    int

    Raises
    ------
    ValueError
        If it is something else, or less.
    """
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise ValueError(f"{name} must be a whole number, at least {least}; got {value!r}.")
    return int(value)


def checked_seed(name: str, value: object) -> int:
    """Return a seed, or the number of a row, as an integer.

    Raises
    ------
    ValueError
        If it is not a whole number, at least zero.
    """
    return checked_whole(name, value, least=0)
