"""What counts as a refusal: an error of this project's own, raised by a line of its own, for what is wrong."""

from __future__ import annotations

import linecache
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

ROOMS = [Path(package.__path__[0]) for package in map(__import__, ("dpend", "controllers", "rl", "studies"))]


def refusal(call: Callable[[Any], object], value: Any) -> Exception | None:
    """Return the error by which a call refuses a value, or None if it takes it.

    An AssertionError says so where the error is another's: not of a kind that is meant for users, or raised in a
    library that was called.
    """
    refused: Exception | None = None
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            call(value)
        except Exception as error:
            refused = error
    if refused is not None:
        frame = traceback.extract_tb(refused.__traceback__)[-1]
        assert isinstance(refused, ValueError | TypeError), f"{type(refused).__name__}: {refused}"
        assert any(Path(frame.filename).is_relative_to(room) for room in ROOMS), f"{frame}: {refused}"
        assert linecache.getline(frame.filename, frame.lineno or 0).strip().startswith("raise"), f"{frame}: {refused}"
    return refused
