"""What can be saved, as an area: the boundary that studies.recoverable found, about upright, of starts at rest."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from typing import Any, NamedTuple, cast

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq

from dpend.params import Array

from ._closure import kept_table
from ._estimates import Estimate
from ._table import read_rows, where

OWN = 1e-3
"""What the motions keep from the track's end, m, and from right angles, rad: enough to replay them."""

_FINE = np.linspace(-math.pi, math.pi, 7201)[:-1]


class Boundary(NamedTuple):
    """A region about upright, given by the boundary's distance from it along rays in the plane of both angles."""

    degrees: Array  # Directions of the rays ``(n,)``, atan2(θ2, θ1), once round.
    low: Array  # The farthest start on each that is saved ``(n,)``, rad.
    high: Array  # The nearest beyond it that is not ``(n,)``, rad.

    def radius(self, direction: npt.ArrayLike) -> Array:
        """Return the boundary's distance, rad, in directions given as angles, rad: between two rays, cubic."""
        return self._between(0.5 * (self.low + self.high), direction)

    def savable(self, x: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Return which states at rest ``(n, 6)`` lie inside."""
        th1, th2 = np.asarray(x, dtype=np.float64)[:, 1:3].T
        return np.hypot(th1, th2) <= self.radius(np.arctan2(th2, th1))

    def share(self, lam: float) -> Estimate:
        r"""Return the share of the square :math:`|\theta_i| \le \lambda` that lies inside, with its numerical error.

        The interval is between the areas by ``low`` and by ``high``, and wider by what every other ray would change.
        """
        square = lam / np.maximum(np.abs(np.cos(_FINE)), np.abs(np.sin(_FINE)))
        every_other = Boundary(*(each[::2] for each in self))
        value, low, high, fewer = (
            float(np.sum(np.minimum(of._between(radii, _FINE), square) ** 2) / np.sum(square**2))
            for of, radii in ((self, 0.5 * (self.low + self.high)), (self, self.low), (self, self.high),
                              (every_other, 0.5 * (every_other.low + every_other.high)))
        )  # fmt: skip
        error = abs(fewer - value)
        return Estimate(value, max(low - error, 0.0), min(high + error, 1.0))

    def lam(self, share: float) -> float:
        r"""Return the :math:`\lambda` at which a share is saved, such as 0.9; infinite beyond a right angle."""

        def more(lam: float) -> float:
            return self.share(lam).value - share

        return float(cast(float, brentq(more, 0.01, math.pi / 2))) if more(math.pi / 2) < 0 else math.inf

    def ring(self) -> Array:
        """Return points of the boundary in order ``(m, 2)``: θ1 and θ2, rad."""
        return self.radius(_FINE)[:, None] * np.column_stack([np.cos(_FINE), np.sin(_FINE)])

    def _between(self, radii: Array, direction: npt.ArrayLike) -> Array:
        more = slice(-3, None), slice(None), slice(None, 3)  # so that the curve closes smoothly
        at = np.concatenate([self.degrees[part] + turn for part, turn in zip(more, (-360, 0, 360), strict=True)])
        curve = PchipInterpolator(at, np.concatenate([radii[part] for part in more]))
        return curve(np.degrees(direction) % 360)


def boundary(rows: pd.DataFrame) -> Boundary:
    """Return the boundary at the rig's force limit, about which the starts were solved, each ray and its mirror image.

    What lies beyond the first start of a ray that is lost does not count.
    """
    found = []
    for degrees, radii, least in _rays(rows):
        beyond = np.append(least > rows["limit"].to_numpy()[0], True)
        n = int(np.argmax(beyond))
        low = radii[n - 1] if n else 0.0
        found.append((degrees, low, radii[n] if n < len(radii) else low))
    return _mirrored(found)


def boundary_by_force(rows: pd.DataFrame) -> Callable[[float], Boundary]:
    """Return the boundary as a function of the force limit, N: between the starts of a ray, and no farther, cubic."""
    curves: list[tuple[float, float, Any]] = []
    for degrees, radii, least in _rays(rows):
        found = np.isfinite(least)
        rising, places = np.maximum.accumulate(np.append(0.0, least[found])), np.append(0.0, radii[found])
        kept = np.append(True, np.diff(rising) > 0)
        curves.append((degrees, float(rising[-1]), PchipInterpolator(rising[kept], places[kept])))

    def at(force: float) -> Boundary:
        radii = [(degrees, float(curve(min(force, most)))) for degrees, most, curve in curves]
        return _mirrored([(degrees, radius, radius) for degrees, radius in radii])

    return at


def _rays(rows: pd.DataFrame) -> Iterator[tuple[float, Array, Array]]:
    """Return directions, distances and least forces of the starts on each ray, from the middle outwards."""
    for degrees, own in rows.groupby("degrees"):
        radii, least = np.hypot(*own[["th1", "th2"]].to_numpy().T), own["force"].to_numpy(dtype=np.float64)
        order = np.argsort(radii)
        yield float(str(degrees)), radii[order], least[order]


def _mirrored(half: Sequence[tuple[float, float, float]]) -> Boundary:
    rays = np.array(half)
    return Boundary(*np.vstack([rays, rays + np.array([180.0, 0.0, 0.0])]).T)


@cache
def kept_boundary() -> Boundary:
    """Return the boundary on the rig of the comparisons, from the table that is shipped."""
    rows = read_rows(kept_table("recoverable"))  # the first are of the rig's own track
    return boundary(where(rows, model="nonlinear", margin=OWN, track=rows["track"].to_numpy()[0], starts=0))
