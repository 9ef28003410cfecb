"""What implements a protocol's method is documented where the protocol is: here the two are put together."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from typing import Any

import dpend
import rl

PROTOCOLS: Mapping[str, Callable[..., Any]] = {
    "start": dpend.Controller.start,
    "train": rl.Learner.train,
    **{name: getattr(dpend.Task, name) for name in ("starts", "ended", "upright", "cost")},
}
"""The methods by name."""
_ORDER = "Parameters", "Returns", "Raises", "See Also", "Notes", "Examples"


def completed(method: Callable[..., Any]) -> str:
    """Return the docstring of a method, with what it lacks taken from the protocol that it implements, if any.

    It keeps its own first line, paragraphs and sections, and implements a protocol if its parameters are the same.
    """
    own, whole = inspect.cleandoc(method.__doc__ or ""), PROTOCOLS.get(method.__name__)
    if whole is None or method is whole or list(inspect.signature(method).parameters) != _parameters(whole):
        return own
    mine, theirs = _sections(own), _sections(inspect.cleandoc(whole.__doc__ or ""))
    first, _, further = mine[""].partition("\n\n")
    further = further or theirs[""].partition("\n\n")[2]
    sections = theirs | mine
    return "\n\n".join([first, further, *(sections[title] for title in _ORDER if title in sections)])


def _parameters(method: Callable[..., Any]) -> list[str]:
    return list(inspect.signature(method).parameters)


def _sections(text: str) -> dict[str, str]:
    """Return a docstring's sections by title, the beginning by none."""
    parts = re.split(r"\n\n(?=[A-Z][A-Za-z ]+\n-{3,}\n)", text)
    return {"": parts[0]} | {part.partition("\n")[0]: part for part in parts[1:]}
