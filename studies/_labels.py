"""Labels beside the points of a picture, none over another, each with a line to its point."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from dpend.params import Array

_HALO = withStroke(linewidth=2, foreground="white")
_STEP = 5.0  # pixels between the places that are tried
_ALONG = np.linspace(0, 1, 21)[:, None]  # places on a line that are looked at
_AIR = 2.0  # pixels around a label
_POINT = 7.0  # pixels that a marker takes to each side
_LIKELY = 800  # of those places, the cheapest, whose lines are looked at
_CROSSED, _COVERED = 300.0, 1e6  # pixels that a line over a line or marker counts as, and anything over a label
_SIDES = np.array([-1.0, -1.0, 1.0, 1.0])  # a box is (x0, y0, x1, y1)


def place_labels(
    axis: Axes, x: npt.ArrayLike, y: npt.ArrayLike, labels: list[str], *, avoid: Array | None = None, size: float = 7
) -> None:
    """Write each label as near to its point as there is room, and draw a thin line between the two.

    Parameters
    ----------
    axis : Axes
        The picture, with its scales and limits set; its figure's layout is done, and stays as it is from here.
    x, y : array_like (n,)
        The points, in the picture's units.
    labels : list of n str
        What stands beside them.
    avoid : ndarray (m, 4), optional
        Boxes that labels leave free beside the points, such as intervals: least and greatest x, least and greatest y.
    size : float
        Of the letters, points.
    """
    if not labels:
        return
    figure = axis.figure
    assert isinstance(figure, Figure)
    renderer = FigureCanvasAgg(figure).get_renderer()
    if figure.get_layout_engine() is not None:
        figure.draw_without_rendering()
        figure.set_layout_engine("none")
    points = axis.transData.transform(np.column_stack([x, y]))
    corners = np.zeros((0, 2)) if avoid is None else np.asarray(avoid)[:, [0, 2, 1, 3]].reshape(-1, 2)
    boxes = axis.transData.transform(corners).reshape(-1, 4)
    words = {"fontsize": size, "ha": "center", "va": "center", "zorder": 5, "path_effects": [_HALO]}
    texts = [axis.text(0, 0, label, **words) for label in labels]
    for text in texts:
        text.set_in_layout(False)
    extents = [text.get_window_extent(renderer) for text in texts]
    halves = np.array([[extent.width, extent.height] for extent in extents]) / 2 + _AIR
    frame = np.array(axis.get_window_extent(renderer).extents)
    order = np.argsort(points[:, 0], kind="stable")
    tries = [_placed(points, halves, boxes, frame, way) for way in (order, order[::-1])]
    centres, ends, _ = min(tries, key=lambda tried: tried[2])
    to_data = axis.transData.inverted().transform
    for text, point, centre, end in zip(texts, points, centres, ends, strict=True):
        place = to_data(centre)
        text.set_position((float(place[0]), float(place[1])))
        if np.hypot(*(end - point)) > _POINT:
            axis.plot(*to_data([point, end]).T, color="#555555", lw=0.5, zorder=1, scalex=False, scaley=False)


def _placed(
    points: Array, halves: Array, boxes: Array, frame: Array, order: npt.NDArray[np.int64]
) -> tuple[Array, Array, float]:
    """Place labels in some order, each where it costs least: their centres, the ends of their lines, and the cost."""
    markers = np.tile(points, 2) + _POINT * _SIDES
    middles, ends, total = np.zeros_like(points), np.zeros_like(points), 0.0
    placed: list[Array] = []
    lines: list[Array] = []
    for k in order:
        point, half = points[k], halves[k]
        across, up = (np.arange(frame[i] + half[i], frame[i + 2] - half[i], _STEP) for i in (0, 1))
        centres = np.stack(np.meshgrid(across, up), axis=-1).reshape(-1, 2)
        tips = np.clip(point, centres - half, centres + half)
        cost = np.hypot(*(tips - point).T)
        for box in (*markers, *boxes, *placed):
            cost += _COVERED * _inside(centres, box + np.tile(half, 2) * _SIDES)
        likely = np.argsort(cost, kind="stable")[:_LIKELY]
        centres, tips, cost = centres[likely], tips[likely], cost[likely]
        along = point + (tips - point)[:, None] * _ALONG
        for box in (*markers[:k], *markers[k + 1 :]):
            cost += _CROSSED * _inside(along, box).any(axis=1)
        for box in placed:
            cost += _COVERED * _inside(along, box).any(axis=1)
        for first, second in lines:
            cost += _CROSSED * _cross(point, tips, first, second)
            others = first + (second - first) * _ALONG
            cost += _COVERED * (np.abs(others[:, None] - centres) < half).all(axis=-1).any(axis=0)
        best = int(np.argmin(cost))
        total += float(cost[best])
        middles[k], ends[k] = centres[best], tips[best]
        placed.append(np.tile(centres[best], 2) + np.tile(half, 2) * _SIDES)
        lines.append(np.array([point, tips[best]]))
    return middles, ends, total


def _inside(places: Array, box: Array) -> npt.NDArray[np.bool_]:
    """Return which places ``(..., 2)`` lie in a box."""
    return np.asarray(((places > box[:2]) & (places < box[2:])).all(axis=-1))


def _cross(start: Array, ends: Array, first: Array, second: Array) -> npt.NDArray[np.bool_]:
    """Return which lines from one start to ends ``(n, 2)`` cross the line between two places."""

    def side(a: Array, b: Array, c: Array) -> Array:
        u, v = b - a, c - a
        return np.sign(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])

    apart = side(start, ends, first) * side(start, ends, second) < 0
    return apart & (side(first, second, start) * side(first, second, ends) < 0)
