"""Settings of learners: each says its rule in its annotation, such as ``alpha: Positive``, and is checked by it.

Annotations are evaluated apart from their module, so that a lambda in one sees its argument and builtins alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

from dpend.arguments import checked_flag, checked_positive, checked_whole, is_finite
from dpend.suggest import suggestion

Rule = Callable[[str, Any], object]
"""Raises where the value of the setting of that name is not good."""


def must(be: str, good: Callable[[Any], bool]) -> Rule:
    """Return the rule that a setting must be something, which the good values are; those of a wrong type are not."""

    def checked(name: str, value: Any) -> None:
        try:
            passed = bool(good(value))
        except (TypeError, ValueError, OverflowError):
            passed = False
        if not passed:
            raise ValueError(f"{name} must be {be}; got {value!r}.")

    return checked


def at_least(least: float, why: str = "") -> Rule:
    """Return the rule that a setting must not be less, and why."""
    return must(f"at least {least:g}{why}", lambda value: value >= least)


def one_of(names: Iterable[str]) -> Rule:
    """Return the rule that a setting must be one of a few names."""
    return must(f"one of {', '.join(map(repr, names))}", list(names).__contains__)


def known(names: Iterable[str]) -> Rule:
    """Return the rule that a setting must name one of what there is; an error suggests the nearest."""

    def checked(name: str, value: Any) -> None:
        if not (isinstance(value, str) and value in names):
            raise ValueError(f"There is no {name} {value!r}.{suggestion(str(value), names)}")

    return checked


def numbers(be: str, n: int | None = None, good: Callable[[float], bool] = math.isfinite) -> Rule:
    """Return the rule that a setting must list finite numbers, ``n`` or at least one, each of them good."""

    def listed(values: Any) -> bool:
        long_enough = len(values) > 0 if n is None else len(values) == n
        ordered = not isinstance(values, Set | Mapping | bytes)
        return long_enough and ordered and all(is_finite(value) and good(value) for value in values)

    return must(be, listed)


def instance_of(kind: type) -> Rule:
    """Return the rule that a setting must be an object of some class."""
    return must(f"of class {kind.__name__}", lambda value: isinstance(value, kind))


Flag = Annotated[bool, checked_flag]
Whole = Annotated[int, checked_whole]
Positive = Annotated[float, checked_positive]
Nonnegative = Annotated[float, must("finite and at least 0", lambda value: is_finite(value) and value >= 0)]
Portion = Annotated[float, must("above 0 and at most 1", lambda value: is_finite(value) and 0 < value <= 1)]
Share = Annotated[float, must("within 0 and 1", lambda value: is_finite(value) and 0 <= value <= 1)]
Angle = Annotated[float, must("above 0 and at most pi/2", lambda value: is_finite(value) and 0 < value <= math.pi / 2)]
Diagonal = Annotated[Sequence[float], numbers("6 finite numbers, at least 0", 6, lambda each: each >= 0)]
Scales = Annotated[Sequence[float], numbers("7 finite numbers greater than 0", 7, lambda each: each > 0)]


def check_settings(settings: object) -> None:
    """Refuse the first setting that breaks the rule in its annotation; None is good where the annotation allows it."""
    for name, may_be_none, rule in _rules(type(settings)):
        value = getattr(settings, name)
        if not (may_be_none and value is None):
            rule(name, value)


@cache
def _rules(kind: type) -> list[tuple[str, bool, Rule]]:
    """Return the rules in a class's annotations, each with the setting's name and whether it may be None."""
    rules = []
    for name, hint in get_type_hints(kind, include_extras=True).items():
        choices = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
        rules += [
            (name, NoneType in choices, rule) for choice in choices for rule in getattr(choice, "__metadata__", ())
        ]
    return rules
