"""Curves of success against a level, such as the starting spread λ: drawn, and where they fall, drawn and said."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import PercentFormatter

from ._entrants import Style
from ._intervals import Crossing, Rate

Curve = Mapping[float, Rate]
"""Success by level, in order."""

Falls = tuple[Crossing, Crossing]
"""The levels at which success falls to a half and to nine tenths."""

BEST: Style = ("#666666", "|", "-")
"""What any controller can do at best, as far as is known."""


def plot_best(axis: Axes, curve: Curve, label: str) -> None:
    """Draw what can be done at best, as a line with a band for its interval."""
    if curve:
        shares, low, high = np.transpose(list(curve.values()))
        axis.fill_between(list(curve), low, high, color="#bbbbbb", lw=0)
        axis.plot(list(curve), shares, color=BEST[0], lw=2.2, label=label)


def plot_curves(axis: Axes, curves: Mapping[str, Curve], looks: Sequence[Style]) -> None:
    """Draw curves with their intervals, by label, set aside a little so that no interval hides another."""
    for place, ((label, curve), (colour, marker, line)) in enumerate(zip(curves.items(), looks, strict=True)):
        levels = np.array(list(curve))
        aside = 0.005 * np.ptp(levels) * (place - (len(curves) - 1) / 2)
        shares, low, high = np.transpose(list(curve.values()))
        axis.errorbar(
            levels + aside, shares, [shares - low, high - shares],
            color=colour, marker=marker, ls=line, ms=4, capsize=2, lw=1.2, elinewidth=0.8, label=label,
        )  # fmt: skip
    axis.set_ylim(-0.03, 1.03)
    axis.yaxis.set_major_formatter(PercentFormatter(1.0))
    axis.tick_params(labelsize=8)
    axis.grid(alpha=0.3)


def plot_falls(axis: Axes, falls: Mapping[str, Falls], looks: Mapping[str, Style], levels: Sequence[float]) -> None:
    """Draw where curves fall to a half (filled) and to nine tenths (open), a line each, the first below.

    What lies beyond the levels tried is an arrow at the edge.
    """
    beyond = 0.05 * (levels[-1] - levels[0] or 1.0)
    left, right = levels[0] - beyond, levels[-1] + beyond
    for place, (name, found) in enumerate(falls.items()):
        colour, marker, _ = looks.get(name, BEST)
        for each, face, size in zip(found, (colour, "white"), (5.0, 4.5), strict=True):
            level, low, high = np.clip(each, left, right)
            axis.plot([low, high], [place, place], color=colour, lw=1.4, solid_capstyle="butt")
            shown = ">" if each.level > levels[-1] else "<" if each.level < levels[0] else marker
            axis.plot(level, place, shown, color=colour, mfc=face, ms=size, mew=1.0, clip_on=False)
    axis.set(xlim=(left, right), ylim=(-0.7, len(falls) - 0.3))
    axis.set_yticks(range(len(falls)), list(falls))
    axis.tick_params(axis="x", labelsize=8)
    axis.tick_params(axis="y", labelsize=7.5, length=0)
    axis.grid(alpha=0.3)


def percent(rate: Rate) -> str:
    """Say a rate in percent, and below it the interval, with decimals where it is narrow."""
    digits = 0 if rate.high - rate.low > 0.02 else 1
    low, high = (f"{100 * bound:.{digits}f}".removesuffix(".0") for bound in (rate.low, rate.high))
    return f"{100 * rate.share:.1f}\n{low}–{high}"


def spread(found: Crossing, levels: Sequence[float]) -> str:
    """Say a crossing, and below it the interval; what lies outside the levels tried as more or less than the last."""

    def say(level: float) -> str:
        if math.isfinite(level):
            return f"{level:.3f}"
        return f">{levels[-1]:g}" if level > 0 else f"<{levels[0]:g}"

    return say(found.level) if found.low == found.high else f"{say(found.level)}\n{say(found.low)}–{say(found.high)}"
