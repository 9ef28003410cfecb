"""Names that have changed: the old ones work for one version and say what they are called now."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from functools import wraps
from typing import Any, TypeVar

Changed = TypeVar("Changed", bound=type)


def warn_renamed(old: str, new: str, stacklevel: int = 3) -> None:
    """Warn that a name has changed.

    Parameters
    ----------
    old, new : str
        What it was called, and what it is called now.
    stacklevel : int
        How many calls above this one the user's own line stands, counted as by ``warnings.warn``.
    """
    warnings.warn(f"{old} is now called {new}; the old name goes with version 0.3.", DeprecationWarning, stacklevel)


def renamed_exports(module: str, names: Mapping[str, str], values: Mapping[str, Any]) -> Callable[[str], Any]:
    """Return a module's ``__getattr__`` that still knows exports by the names that they had.

    Parameters
    ----------
    module : str
        The module's name.
    names : mapping of str to str
        New names by old ones.
    values : mapping of str to object
        What the new names stand for, such as the module's ``globals()``.

    Returns
    -------
    callable
    """

    def __getattr__(name: str) -> Any:
        if name not in names:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        warn_renamed(f"{module}.{name}", f"{module}.{names[name]}")
        return values[names[name]]

    return __getattr__


def renamed_arguments(**names: str) -> Callable[[Changed], Changed]:
    """Return a decorator by which a class still takes keywords, and shows attributes, by the names that they had.

    Parameters
    ----------
    **names : str
        New names by old ones.

    Returns
    -------
    callable
        Decorator of classes.
    """

    def decorate(changed: Changed) -> Changed:
        build = changed.__init__

        @wraps(build)
        def __init__(self: Any, *args: Any, **keywords: Any) -> None:
            for old, new in names.items():
                if old in keywords:
                    warn_renamed(f"{changed.__name__}({old}=...)", f"{changed.__name__}({new}=...)")
                    keywords[new] = keywords.pop(old)
            build(self, *args, **keywords)

        changed.__init__ = __init__  # type: ignore[misc]
        for old, new in names.items():
            setattr(changed, old, _renamed_attribute(changed.__name__, old, new))
        return changed

    return decorate


def _renamed_attribute(owner: str, old: str, new: str) -> property:
    def read(self: Any) -> Any:
        warn_renamed(f"{owner}.{old}", f"{owner}.{new}")
        return getattr(self, new)

    read.__doc__ = f"Return ``{new}``, by the name that it had."
    return property(read)
