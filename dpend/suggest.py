"""Words that are not known, and the nearest that are."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import fields
from functools import wraps
from typing import Any, TypeVar

Described = TypeVar("Described")


def suggestion(word: str, known: Iterable[str]) -> str:
    """Return " Did you mean 'x'?" for the nearest known word, or the list of all where none is near."""
    words = sorted(known)
    near = difflib.get_close_matches(word, words, n=1)
    return f" Did you mean {near[0]!r}?" if near else f" Known: {', '.join(words)}."


def suggests(described: type[Described]) -> type[Described]:
    """Let a dataclass refuse an unknown keyword with the nearest that it knows."""
    known = [field.name for field in fields(described) if field.init]  # type: ignore[arg-type]  # a dataclass
    build = described.__init__

    @wraps(build)
    def __init__(self: Described, *args: Any, **keywords: Any) -> None:
        for name in keywords:
            if name not in known:
                raise TypeError(f"{described.__name__} has no field {name!r}.{suggestion(name, known)}")
        build(self, *args, **keywords)

    described.__init__ = __init__
    return described
