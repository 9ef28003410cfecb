"""Random plants, states and forces: batches from a seeded generator, and hypothesis strategies."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy

from dpend import Params, equations, rig
from dpend.params import Array
from dpend.rig import Rig

# field: (least, greatest); wide enough to tell every term apart, narrow enough that 1e-12 is a fair tolerance
_RANGES = {
    "cart_mass": (0.3, 3.0),
    "mass1": (0.1, 1.5),
    "mass2": (0.1, 1.5),
    "length1": (0.3, 1.5),
    "length2": (0.3, 1.5),
    "gravity": (1.0, 15.0),
}
_CENTERS = {"com1": (0.05, 1.0), "com2": (0.05, 1.0), "inertia1": (0.01, 0.5), "inertia2": (0.01, 0.5)}
_FRICTIONS = {
    "cart_friction": (0.0, 2.0),
    "joint1_friction": (0.0, 0.5),
    "joint2_friction": (0.0, 0.5),
    "cart_coulomb": (0.0, 3.0),
    "coulomb_speed": (0.05, 0.5),
}
_STATES = ((-2.0, 2.0), (-6.5, 6.5), (-6.5, 6.5), (-3.0, 3.0), (-8.0, 8.0), (-8.0, 8.0))
_FORCES = ((-40.0, 40.0), (-5.0, 5.0), (-5.0, 5.0))


def _ranges(friction: bool, rods: bool) -> dict[str, tuple[float, float]]:
    return _RANGES | ({} if rods else _CENTERS) | (_FRICTIONS if friction else {})


def random_params(
    rng: np.random.Generator, n: int | None = None, *, friction: bool = True, rods: bool = False
) -> Params:
    """Draw a plant, or ``n`` plants in one batch, with any centres and inertias unless they are to be rods."""
    return Params(**{name: rng.uniform(*bounds, n) for name, bounds in _ranges(friction, rods).items()})


def random_states(rng: np.random.Generator, n: int, *, scale: float = 1.0) -> Array:
    """Draw states ``(n, 6)``."""
    low, high = scale * np.array(_STATES).T
    return rng.uniform(low, high, (n, 6))


def random_forces(rng: np.random.Generator, n: int) -> Array:
    """Draw generalised forces ``(n, 3)``."""
    low, high = np.array(_FORCES).T
    return rng.uniform(low, high, (n, 3))


def whole(message: str) -> str:
    """Return the pattern that only this whole message matches."""
    return f"^{re.escape(message)}$"


def row(params: Params, i: int) -> Params:
    """Return one plant of a batch."""
    return Params(**{name: v[i] if isinstance(v, np.ndarray) else v for name, v in params.to_dict().items()})


def endless(name: str = "gustafsson2016", **changes: Any) -> Rig:
    """Return a preset without limits, so that nothing but the plant decides."""
    return rig(name).replace(**({"force_limit": np.inf, "track_limit": np.inf} | changes))


def _within(bounds: tuple[float, float]) -> SearchStrategy[float]:
    return st.floats(*bounds, allow_subnormal=False)


def _arrays(ranges: tuple[tuple[float, float], ...]) -> SearchStrategy[Array]:
    return st.tuples(*map(_within, ranges)).map(np.array)


def plants(*, friction: bool = True, rods: bool = False) -> SearchStrategy[Params]:
    """Draw plants for hypothesis; frictions may vanish, centres and inertias may be left out."""
    fields: dict[str, SearchStrategy[Any]] = {name: _within(b) for name, b in _RANGES.items()}
    if not rods:
        fields |= {name: st.none() | _within(bounds) for name, bounds in _CENTERS.items()}
    if friction:
        fields |= {name: _within(bounds) for name, bounds in _FRICTIONS.items()}
    return st.builds(Params, **fields)


def states() -> SearchStrategy[Array]:
    """Draw states ``(6,)`` for hypothesis."""
    return _arrays(_STATES)


def forces() -> SearchStrategy[Array]:
    """Draw generalised forces ``(3,)`` for hypothesis."""
    return _arrays(_FORCES)


def mutated(old: str, new: str) -> Callable[..., object]:
    """Return ``make_rates`` with one sign wrong."""
    source = Path(equations.__file__).read_text()
    assert source.count(old) == 2  # in the rates and in their slopes, whichever comes first
    module: dict[str, Callable[..., object]] = {}
    exec(source.replace(old, new, 1), module)
    return module["make_rates"]
