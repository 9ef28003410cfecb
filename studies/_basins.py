"""Basins: from which angles at rest a controller saves the double pendulum, over what can be saved at all."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib import colormaps
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

import dpend
from dpend.params import Array

from ._boundary import kept_boundary
from ._figures import facets

EXTENT = 0.8
"""Greatest angle on a map, rad."""

_RIM, _SHADES = "#d0d0d0", colormaps["Blues"]


def starts(side: int) -> Array:
    """Return the states at rest of a map, ``(side * side, 6)``, row by row: θ2 first, then θ1."""
    th2, th1 = np.meshgrid(*2 * [np.linspace(-EXTENT, EXTENT, side)], indexing="ij")
    x = np.zeros((side * side, 6))
    x[:, 1], x[:, 2] = th1.ravel(), th2.ravel()
    return x


def basin(rig: dpend.Rig, controller: dpend.Controller, side: int, seed: int) -> npt.NDArray[np.bool_]:
    """Return where a controller balances a rig: a map ``(side, side)`` of truth values, by θ2 and θ1."""
    runs = dpend.simulate_many(rig, controller, starts(side), task=dpend.Balance(), seed=seed)
    return runs.success.reshape(side, side)


def part_saved(saved: npt.NDArray[Any]) -> float:
    """Return the share of what can be saved that a basin ``(side, side)`` holds, by area; of trainings, the mean."""
    return float(saved.ravel()[kept_boundary().savable(starts(len(saved)))].mean())


def plot_basins(basins: Mapping[str, Array], columns: int = 4, known: bool = True) -> Figure:
    """Return maps of basins side by side, each over what can be saved at all where that is known (``gustafsson2016``).

    ``basins`` are, by name, maps ``(side, side)`` by θ2 and θ1: the share of trainings whose controller saves a start.
    """
    ring = kept_boundary().ring() if known else np.empty((0, 2))
    rows, limits = -(-len(basins) // columns), (-EXTENT - 0.03, EXTENT + 0.03)
    figure, axes = facets(rows, columns, height=1.65 * rows + 0.75, sharex=True, sharey=True)
    for axis, (name, saved) in zip(axes.flat, basins.items(), strict=False):
        axis.fill(*ring.T, color=_RIM, lw=0)
        axis.plot(*ring.T, color="k", lw=1.0, zorder=3)
        outer = EXTENT + EXTENT / max(len(saved) - 1, 1)
        axis.imshow(
            np.ma.masked_where(saved == 0, _shade(saved)),
            cmap=_SHADES, vmin=0, vmax=1, origin="lower", extent=(-outer, outer, -outer, outer), zorder=2,
        )  # fmt: skip
        axis.set(xlim=limits, ylim=limits, xticks=(-0.5, 0, 0.5), yticks=(-0.5, 0, 0.5), aspect="equal")
        axis.set_title(f"{name}: {100 * part_saved(saved):.0f} %" if known else name, fontsize=7.5, loc="center")
    for place, axis in enumerate(axes.flat):
        axis.tick_params(labelbottom=place + columns >= len(basins))  # nothing below it
        axis.set_visible(place < len(basins))
    figure.supxlabel("θ1 (rad)", fontsize=8.5)
    figure.supylabel("θ2 (rad)", fontsize=8.5)
    handles = [
        Patch(facecolor=_SHADES(_shade(1.0)), label="saved"),
        Patch(facecolor=_SHADES(_shade(0.5)), label="by half of the trainings"),
        Patch(facecolor=_RIM, label="could be saved"),
        Line2D([], [], color="k", lw=1.2, label="boundary of that"),
    ]
    figure.legend(handles=handles if known else handles[:2], loc="outside upper center", ncols=4)
    return figure


def _shade(share: Any) -> Any:
    """Return the place of a share in the colours, of which the palest are left out."""
    return 0.2 + 0.7 * share
