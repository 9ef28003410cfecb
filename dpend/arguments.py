"""Checks of the numbers that callers pass: finite ones, whole ones, seeds."""

from __future__ import annotations

import reprlib
from typing import Any, TypeGuard

import numpy as np
import numpy.typing as npt


def is_finite(value: object) -> TypeGuard[float]:
    """Return whether a value is one finite real number; strings, truth values and arrays of several are none."""
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths
        return False
    return array.ndim == 0 and array.dtype.kind in "iuf" and bool(np.isfinite(array))


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


def checked_array(
    name: str, value: object, what: str, *, finite: bool = True, complex_too: bool = False
) -> npt.NDArray[Any]:
    """Return numbers as a float64 array, or a complex one where these are welcome and came.

    Parameters
    ----------
    name : str
        What the caller calls it.
    value : array_like
        What came.
    what : str
        What it should be, such as ``"a state (6,)"``.
    finite : bool
        Whether infinities and NaN are refused.
    complex_too : bool
        Whether complex numbers are taken.

    Returns
    -------
    ndarray
        Of any shape; a copy only where the type differs.

    Raises
    ------
    TypeError
        If it is not made of numbers, such as words, dates, None or rows of different lengths.
    ValueError
        If a number is not finite.
    """
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths
        array = np.asarray(None)
    if array.dtype.kind not in ("iufc" if complex_too else "iuf"):
        raise TypeError(f"{name} must be numbers: {what}; got {reprlib.repr(value)}.")
    if finite and not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite: {what}; got {reprlib.repr(value)}.")
    return array.astype(np.complex128 if array.dtype.kind == "c" else np.float64, copy=False)
