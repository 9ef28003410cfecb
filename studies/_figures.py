"""What the figures of the studies are made of: curves with intervals, forests, maps, traces, labels and legends.

Colours are Okabe and Ito's, which the colour-blind can tell apart; markers and lines tell the same without colour.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from itertools import cycle
from pathlib import Path
from typing import Any, Literal

import matplotlib
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter, PercentFormatter

from dpend.params import Array

from ._estimates import Estimate, Tried
from ._labels import place_labels

Style = tuple[str, str, Any]  # colour, marker and line style, as those of studies._field.Contender
Curve = Mapping[float, Estimate]  # estimates by level, in order
BEST: Style = ("#666666", "|", "-")
"""What any controller can do at best, as far as is known."""

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#000000", "#56B4E9", "#777777")
"""Okabe and Ito's, without the yellow that is pale on white, and grey."""

_LINES = ("-", "--", "-.", ":", (0, (6, 1, 1, 1)), (0, (1, 1)), (0, (8, 2)), (0, (4, 1, 1, 1, 1, 1)))
_MARKERS = ("o", "s", "D", "^", "v", "P", "X", "p")
WIDTH = 6.8  # width of a figure, inches: that of a page's text
MOST = 6  # curves in a panel, so that a reader can distinguish them


def look() -> AbstractContextManager[None]:
    """Return the context in which figures are drawn and saved, whatever the user's own settings of matplotlib are."""
    return matplotlib.rc_context(fname=Path(__file__).with_name("figures.mplstyle"))


def palette(names: Iterable[str]) -> dict[str, Style]:
    """Return a style for each of some names that are no contenders, in their order."""
    return dict(zip(dict.fromkeys(names), cycle(zip(COLOURS, _MARKERS, _LINES, strict=True)), strict=False))


def parts(names: Sequence[str], most: int = MOST) -> list[list[str]]:
    """Return names in as few parts as possible of at most ``most``, each for the curves of one panel."""
    count = -(-len(names) // most)
    size = -(-len(names) // count) if count else 1
    return [list(names[k : k + size]) for k in range(0, len(names), size)]


def facets(
    rows: int, columns: int = 1, *, height: float, width: float = WIDTH, **how: Any
) -> tuple[Figure, npt.NDArray[Any]]:
    """Return a figure, inches wide and high, and its axes ``(rows, columns)``; ``how`` as of ``Figure.subplots``."""
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **how)


def mosaic(layout: Any, *, height: float, width: float = WIDTH, **how: Any) -> tuple[Figure, dict[str, Axes]]:
    """Return a figure and its axes by name, laid out as ``Figure.subplot_mosaic`` has it."""
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplot_mosaic(layout, **how)


def share_axis(axis: Axes, label: str | None = None, along: Literal["x", "y"] = "y") -> None:
    """Make an axis one of shares, in percent from 0 to 100 with some room at both ends."""
    (axis.yaxis if along == "y" else axis.xaxis).set_major_formatter(PercentFormatter(1.0))
    axis.set(**{f"{along}lim": (-0.03, 1.03)} | ({} if label is None else {f"{along}label": label}))


def log_axis(axis: Axes, along: Literal["x", "y"] = "x", ticks: Sequence[float] | None = None) -> None:
    """Make an axis logarithmic, with plain numbers, 0.1 and 1000, at its ticks; none beside those given."""
    axis.set(**{f"{along}scale": "log"})
    of = axis.xaxis if along == "x" else axis.yaxis
    if ticks is not None:
        of.set_ticks(ticks)
        of.set_ticks([], minor=True)
    of.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}" if value >= 1000 else f"{value:g}"))
    of.set_minor_formatter(NullFormatter())


def legend_above(of: Axes | Figure, columns: int, title: str | None = None) -> None:
    """Put the legend above axes, or above the whole figure one entry for each label, where it hides no curve."""
    axes = [of] if isinstance(of, Axes) else of.axes
    entries = {label: line for axis in axes for line, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    if entries:
        above = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0)}
        place: Any = above if isinstance(of, Axes) else {"loc": "outside upper center"}
        of.legend(list(entries.values()), list(entries), title=title, ncols=columns, **place)
    elif isinstance(of, Axes) and title:
        of.set_title(title, loc="center")


def note(axis: Axes, words: str) -> None:
    """Write words in the upper left corner, over what is drawn there."""
    box = {"facecolor": "white", "alpha": 0.8, "lw": 0, "pad": 1.0}
    axis.text(0.008, 0.965, words, transform=axis.transAxes, fontsize=7, va="top", style="italic", bbox=box)


def intervals(
    axis: Axes, places: npt.ArrayLike, estimates: Iterable[Estimate], style: Style, *,
    along: Literal["x", "y"] = "y", hollow: bool = False, joined: bool = True, **how: Any,
) -> None:  # fmt: skip
    """Draw estimates with their intervals, where they have one, at ``places`` ``(n,)`` on the other axis.

    They are measured ``along`` x or y; ``how`` is as of ``Axes.errorbar``, such as ``label``.
    """
    colour, marker, line = style
    value, low, high = np.array(list(estimates), dtype=np.float64).reshape(-1, 3).T
    error = np.nan_to_num([value - low, high - value])
    axis.errorbar(
        *((places, value) if along == "y" else (value, places)), **{f"{along}err": error},
        **{"color": colour, "marker": marker, "ls": line if joined else "none", "elinewidth": 0.8,
           "mfc": "white" if hollow else colour} | how,
    )  # fmt: skip


def curves(
    axis: Axes, of: Mapping[str, Curve], styles: Mapping[str, Style] | Sequence[Style], *, aside: float = 0.005
) -> None:
    """Draw curves with their intervals, by label; styles are by label too, or in the order of the curves.

    Each is moved aside from the one before, by a share of the levels' range, so that no interval hides another.
    """
    looks = [styles[label] for label in of] if isinstance(styles, Mapping) else styles
    for place, ((label, curve), style) in enumerate(zip(of.items(), looks, strict=True)):
        levels = np.array(list(curve))
        moved = aside * np.ptp(levels) * (place - (len(of) - 1) / 2) if len(levels) else 0.0
        intervals(axis, levels + moved, curve.values(), style, label=label)


def saved_by_angle(axis: Axes, of: Mapping[str, Curve], styles: Mapping[str, Style] | Sequence[Style],
                   label: str = "starts saved", **how: Any) -> None:  # fmt: skip
    """Draw shares of starts saved against the greatest starting angle, as :func:`curves` does."""
    curves(axis, of, styles, **how)
    share_axis(axis, label)
    axis.set_xlabel("greatest starting angle λ (rad)")


def best_known(axis: Axes, curve: Curve, label: str) -> None:
    """Draw what can be done at best, as a line with a band for its interval; nothing of no curve."""
    if curve:
        value, low, high = np.transpose(list(curve.values()))
        axis.fill_between(list(curve), low, high, color="#bbbbbb", lw=0)
        axis.plot(list(curve), value, color=BEST[0], lw=2.2, label=label)


def band(axis: Axes, x: npt.ArrayLike, quantiles: npt.ArrayLike, style: Style, label: str | None = None) -> None:
    """Draw a line between two others, such as a median with its quartiles: ``quantiles`` is (3, m), the line second."""
    colour, _, line = style
    low, middle, high = np.asarray(quantiles)
    axis.plot(x, middle, color=colour, ls=line, lw=1.5, label=label)
    axis.fill_between(x, low, high, color=colour, alpha=0.2, lw=0)


def forest(
    axis: Axes, estimates: Mapping[str, Estimate], styles: Mapping[str, Style] | Style, *,
    hollow: bool = False, aside: float = 0.0, tried: Tried | None = None, label: str | None = None,
) -> None:  # fmt: skip
    """Draw estimates with their intervals, one a line, the first on top; a second call with the same names adds to it.

    NaN leaves its line empty; a name without a style has :data:`BEST`; ``aside`` moves down by a share of a line.  The
    axis ends a little beyond the least and the greatest level ``tried``, and what lies there is an arrow.
    """
    left, right = -np.inf, np.inf
    if tried is not None:
        beyond = 0.05 * (tried[1] - tried[0] or 1.0)
        left, right = tried[0] - beyond, tried[1] + beyond
        axis.set_xlim(left, right)
    for line, (name, each) in enumerate(estimates.items()):
        colour, marker, _ = styles.get(name, BEST) if isinstance(styles, Mapping) else styles
        value, low, high = np.clip(each, left, right)
        axis.plot([low, high], 2 * [line + aside], color=colour, lw=1.4, solid_capstyle="butt")
        if tried is not None:
            marker = ">" if each.value > tried[1] else "<" if each.value < tried[0] else marker
        axis.plot(
            value, line + aside, marker, color=colour, mfc="white" if hollow else colour, ms=4.5 if hollow else 5.0,
            mew=1.0, clip_on=False, label=None if line else label,
        )  # fmt: skip
    axis.set_yticks(range(len(estimates)), list(estimates))
    axis.set_ylim(len(estimates) - 0.3, -0.7)
    axis.tick_params(axis="y", length=0)


def strip(
    axis: Axes, groups: Mapping[str, Sequence[Estimate]], style: Style, *, aside: float = 0.0, hollow: bool = False
) -> None:
    """Draw groups side by side, such as learners, each of their values, such as a training's, a point of its own.

    A second call with the same groups, moved ``aside`` by a share of a group to the right, adds to the picture.
    """
    for place, own in enumerate(groups.values()):
        x = place + aside + 0.05 * (np.arange(len(own)) - (len(own) - 1) / 2)
        intervals(axis, x, own, style, hollow=hollow, joined=False, ms=3.5, capsize=1.5)
    axis.set_xticks(range(len(groups)), list(groups))
    axis.set_xlim(-0.5, len(groups) - 0.5)


def scatter(axis: Axes, points: Mapping[str, tuple[Estimate, Estimate]], styles: Mapping[str, Style]) -> None:
    """Draw points with intervals along x and y, each with its name beside it, no name over another or a point.

    The axes' scales and limits must be set, and nothing else that takes room be put on the figure afterwards.
    """
    boxes = []
    for name, (x, y) in points.items():
        intervals(axis, [x.value], [y], styles[name], ms=5, zorder=3)
        intervals(axis, [y.value], [x], styles[name], along="x", ms=5, zorder=3)
        boxes += [(*np.nan_to_num(x[1:], nan=x.value), y.value, y.value)]
        boxes += [(x.value, x.value, *np.nan_to_num(y[1:], nan=y.value))]
    if points:
        x, y = np.array([(x.value, y.value) for x, y in points.values()]).T
        place_labels(axis, x, y, list(points), avoid=np.array(boxes))


def heat_map(
    axis: Axes, values: Array, rows: Sequence[str], columns: Sequence[str], *, words: npt.ArrayLike | None = None
) -> None:
    """Draw shares ``(n, m)`` on colours, such as by contender and condition, where they are not NaN.

    Cells show ``words`` ``(n, m)``, left out the values in percent; long names of columns stand aslant.
    """
    axis.imshow(values, vmin=0.0, vmax=1.0, cmap="cividis", aspect="auto")
    for (i, j), value in np.ndenumerate(values):
        if np.isfinite(value):
            text = f"{100 * value:.0f}" if words is None else str(np.asarray(words)[i, j])
            axis.text(j, i, text, ha="center", va="center", fontsize=7.5, color="k" if value > 0.45 else "w")
    aslant: dict[str, Any] = {"rotation": 35, "ha": "right", "rotation_mode": "anchor"}
    axis.set_xticks(range(len(columns)), list(columns), **aslant if max(map(len, columns), default=0) > 6 else {})
    axis.set_yticks(range(len(rows)), list(rows))
    axis.tick_params(length=0)
    axis.grid(visible=False)


def force_trace(
    axis: Axes, force: npt.ArrayLike, sample_time: float, seconds: float, colour: str, title: str, limit: float = 40.0
) -> None:
    """Draw a force over time as the steps it is held for, and where it ended if that is before the picture does.

    The force ``(T,)`` is NaN, or nothing, after the end of the run; ``limit`` is the greatest, N.
    """
    u = np.asarray(force, dtype=np.float64)
    u = u[np.isfinite(u)]
    time = sample_time * np.arange(len(u) + 1)
    axis.stairs(u, time, baseline=None, color=colour, lw=1.0)
    if len(u) and time[-1] < seconds - 0.5 * sample_time:
        axis.plot(time[-1], u[-1], "kx", ms=5, clip_on=False)
        axis.text(time[-1] + 0.02 * seconds, 0, "ended", va="center", fontsize=7.5)
    axis.set(xlim=(0, seconds), ylim=(-1.15 * limit, 1.15 * limit), yticks=(-limit, 0, limit))
    axis.set_title(title, fontsize=7.5, loc="left", pad=2)


def force_traces(
    axes: Mapping[str, Axes], traces: Mapping[str, tuple[Array, Style]], sample_time: float, seconds: float
) -> None:
    """Draw forces one below the other by title, with labels at the lowest and at the middle one alone."""
    titles = list(traces)
    for title, (force, (colour, _, _)) in traces.items():
        force_trace(axes[title], force, sample_time, seconds, colour, title)
        axes[title].tick_params(labelbottom=title == titles[-1])
    if titles:
        axes[titles[-1]].set_xlabel("time (s)")
        axes[titles[len(titles) // 2]].set_ylabel("force on the cart (N)")
