"""Checks of what callers pass: numbers, flags, seeds, generators, arrays, mappings, paths, names out of a few."""

from __future__ import annotations

import os
import reprlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np
import numpy.typing as npt

_MOST = 2**31 - 1


def is_finite(value: object) -> TypeGuard[float]:
    """Return whether a value is one finite real number; strings, truth values and arrays of several are none."""
    array = _as_array(value)
    return array.ndim == 0 and array.dtype.kind in "iuf" and bool(np.isfinite(array))


def checked_positive(name: str, value: object, unit: str = "") -> float:
    """Return a finite number above zero as a float; refuse anything else by a ValueError with its name and unit."""
    if not (is_finite(value) and value > 0):
        raise ValueError(f"{name} must be finite and greater than 0{unit and ' ' + unit}; got {value!r}.")
    return float(value)


def checked_whole(name: str, value: object, least: int = 1) -> int:
    """Return a whole number, Python's or numpy's, as an integer.

    Anything else, less than ``least`` or of more than 31 bits is refused by a ValueError with its name.
    """
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise ValueError(f"{name} must be a whole number, at least {least}; got {value!r}.")
    if value > _MOST:
        raise ValueError(f"{name} must be at most {_MOST}; got {reprlib.repr(value)}.")
    return int(value)


def checked_seed(name: str, value: object) -> int:
    """Return a seed, or the number of a row, as an integer; refuse what is no whole number, at least zero."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 0:
        raise ValueError(f"{name} must be a whole number, at least 0; got {value!r}.")
    return int(value)


def checked_flag(name: str, value: object) -> bool:
    """Return a truth value, Python's or numpy's; refuse anything else, which may not mean what its truth says."""
    if not isinstance(value, bool | np.bool_):
        raise ValueError(f"{name} must be True or False; got {reprlib.repr(value)}.")
    return bool(value)


def checked_mapping(name: str, value: object, what: str) -> dict[Any, Any]:
    """Return a copy of a mapping, empty for None; refuse anything else by a TypeError that says what it should be."""
    if not (value is None or isinstance(value, Mapping)):
        raise TypeError(f"{name} must be {what}; got {reprlib.repr(value)}.")
    return dict(value or {})


def checked_generator(name: str, value: object) -> np.random.Generator:
    """Return a generator of random numbers; refuse anything else, a bare seed included, by a TypeError."""
    if not isinstance(value, np.random.Generator):
        raise TypeError(f"{name} must be a generator, such as numpy.random.default_rng(0); got {reprlib.repr(value)}.")
    return value


def checked_path(name: str, value: object) -> Path:
    """Return a path, given as text or as one; refuse anything else by a TypeError."""
    path = os.fspath(value) if isinstance(value, str | os.PathLike) else None
    if not isinstance(path, str):
        raise TypeError(f"{name} must be a str or a pathlib.Path; got {reprlib.repr(value)}.")
    return Path(path)


def checked_name(name: str, value: object, known: Iterable[str]) -> str:
    """Return a name, if it is one of a few; refuse anything else by a ValueError that lists them."""
    names = list(known)
    if not (isinstance(value, str) and value in names):
        listed = ", ".join(f'"{each}"' for each in names[:-1])
        raise ValueError(f'{name} must be {listed} or "{names[-1]}"; got {reprlib.repr(value)}.')
    return value


def checked_array(
    name: str, value: object, what: str, *, finite: bool = True, complex_too: bool = False
) -> npt.NDArray[Any]:
    """Return numbers as a float64 array of any shape, or a complex one where these are welcome and came.

    It is a copy only where the type differs.

    Parameters
    ----------
    name, what : str
        What the caller calls it, and what it should be, such as ``"a state (6,)"``.
    value : array_like
        What came.
    finite, complex_too : bool
        Whether infinities and NaN are refused, and whether complex numbers are taken.

    Raises
    ------
    TypeError
        If it is not made of numbers, such as words, dates, None or rows of different lengths.
    ValueError
        If a number is not finite.
    """
    array = _as_array(value)
    if array.dtype.kind not in ("iufc" if complex_too else "iuf"):
        raise TypeError(f"{name} must be numbers: {what}; got {reprlib.repr(value)}.")
    if finite and not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite: {what}; got {reprlib.repr(value)}.")
    return array.astype(np.complex128 if array.dtype.kind == "c" else np.float64, copy=False)


def _as_array(value: object) -> npt.NDArray[Any]:
    """Return an array, one of objects where rows have different lengths."""
    try:
        return np.asarray(value)
    except (ValueError, OverflowError):
        return np.asarray(None)
