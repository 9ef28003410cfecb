"""Names that have changed: the old ones work for one version and say what they are called now."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from functools import wraps
from typing import Any, TypeVar

Changed = TypeVar("Changed", bound=type)


def warn_renamed(old: str, new: str, stacklevel: int = 3) -> None:
    """Warn that a name has changed; the user's own line stands ``stacklevel`` calls above, as warnings count."""
    warnings.warn(f"{old} is now called {new}; the old name goes with version 0.3.", DeprecationWarning, stacklevel)


def renamed_exports(module: str, names: Mapping[str, str], values: Mapping[str, Any]) -> Callable[[str], Any]:
    """Return a module's ``__getattr__`` that still knows exports by the names that they had.

    ``names`` are new names by old ones, ``values`` what the new ones stand for, such as the module's ``globals()``.
    """

    def __getattr__(name: str) -> Any:
        if name not in names:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        warn_renamed(f"{module}.{name}", f"{module}.{names[name]}")
        return values[names[name]]

    return __getattr__


def renamed_arguments(**names: str) -> Callable[[Changed], Changed]:
    """Return a decorator by which a class still takes keywords, and shows attributes, by their old names."""

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
