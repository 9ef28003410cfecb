"""Figures show what they are given, where it is, and hide nothing."""

import importlib
import json
import math
from pathlib import Path

import numpy as np
import pytest
from matplotlib import rcParams
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.text import Text

from studies import _figures
from studies._estimates import Estimate
from studies._labels import place_labels
from studies._table import load

RESULTS = Path(__file__).parent.parent / "docs/results"
KEPT = {path.parent.name: json.loads(path.read_text())["study"] for path in sorted(RESULTS.glob("*/meta.json"))}
"""Studies by the folders of their tables."""

STYLE = ("#0072B2", "o", "-")


@pytest.fixture
def axis():
    with _figures.look():
        _, axes = _figures.facets(1, height=3.0)
        yield axes[0, 0]


def drawn(axis):
    return [(line.get_marker(), np.ravel(line.get_xdata()).tolist()) for line in axis.lines]


def test_figures_look_alike_whatever_the_users_own_settings():
    before = rcParams["font.size"]
    rcParams["font.size"] = 30
    try:
        with _figures.look():
            assert rcParams["font.size"] == 8
        assert rcParams["font.size"] == 30
    finally:
        rcParams["font.size"] = before


def test_no_letter_of_a_figure_is_smaller_than_seven_points(axis):
    _figures.curves(axis, {"LQR": {0.1: Estimate(0.9, 0.8, 1.0), 0.2: Estimate(0.5, 0.4, 0.6)}}, {"LQR": STYLE})
    _figures.share_axis(axis, "starts saved")
    _figures.legend_above(axis, 2, "designed")
    _figures.note(axis, "words")
    axis.set(xlabel="λ (rad)", title="title")
    axis.figure.draw_without_rendering()
    texts = [text for text in axis.figure.findobj(lambda each: hasattr(each, "get_fontsize")) if text.get_text()]
    assert len(texts) > 12
    assert min(text.get_fontsize() for text in texts) >= 7


def test_neighbouring_colours_differ_for_every_kind_of_eye():
    def seen(colour, kind):  # Viénot, Brettel and Mollon, 1999, on linear light
        light = np.array([c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(colour)])
        protan = np.array([[0.11238, 0.88762, 0.0], [0.11238, 0.88762, 0.0], [0.00401, -0.00401, 1.0]])
        deutan = np.array([[0.29275, 0.70725, 0.0], [0.29275, 0.70725, 0.0], [-0.02234, 0.02234, 1.0]])
        return {"normal": np.eye(3), "protan": protan, "deutan": deutan}[kind] @ light

    for kind in ("normal", "protan", "deutan"):
        colours = [seen(colour, kind) for colour in _figures.COLOURS]
        least = min(np.abs(a - b).max() for i, a in enumerate(colours) for b in colours[:i])
        assert least > 0.03, kind
    styles = list(_figures.palette("abcdefgh").values())
    assert len({style[1] for style in styles}) == len({str(style[2]) for style in styles}) == 8


def test_intervals_reach_from_their_lower_to_their_upper_end_and_are_left_out_where_there_are_none(axis):
    _figures.intervals(axis, [1, 2], [Estimate(0.5, 0.3, 0.6), Estimate(0.7)], STYLE)
    (container,) = axis.containers
    (bars,) = container.lines[2]
    assert np.allclose([segment[:, 1] for segment in bars.get_segments()], [[0.3, 0.6], [0.7, 0.7]])


def test_curves_are_moved_aside_by_so_little_that_their_levels_stay_clear(axis):
    curve = {0.1: Estimate(0.9, 0.8, 1.0), 0.6: Estimate(0.5, 0.4, 0.6)}
    _figures.curves(axis, {"a": curve, "b": curve, "c": curve}, [STYLE] * 3)
    places = np.array([container.lines[0].get_xdata() for container in axis.containers])
    assert np.allclose(places - [0.1, 0.6], [[-0.0025] * 2, [0.0] * 2, [0.0025] * 2])


def test_a_forest_shows_each_estimate_on_its_line_with_its_interval_and_an_arrow_beyond(axis):
    half = {"LQR": Estimate(0.48, 0.46, 0.51), "best": Estimate(math.inf, math.inf, math.inf)}
    most = {"LQR": Estimate(0.3, -math.inf, 0.4), "best": Estimate(0.39)}
    _figures.forest(axis, half, {"LQR": STYLE}, tried=(0.1, 0.6))
    _figures.forest(axis, most, {"LQR": STYLE}, tried=(0.1, 0.6), hollow=True)
    left, right = axis.get_xlim()
    assert drawn(axis)[:4] == [("None", [0.46, 0.51]), ("o", [0.48]), ("None", [right] * 2), (">", [right])]
    assert drawn(axis)[4:6] == [("None", [left, 0.4]), ("o", [0.3])]
    assert [label.get_text() for label in axis.get_yticklabels()] == ["LQR", "best"]
    assert axis.lines[5].get_markerfacecolor() == "white"
    assert axis.yaxis_inverted()


def test_words_on_a_map_are_readable_on_both_ends_of_its_colours(axis):
    _figures.heat_map(axis, np.array([[0.0, 1.0, np.nan]]), ["LQR"], ["a", "b", "c"])
    assert [(text.get_text(), text.get_color()) for text in axis.texts] == [("0", "w"), ("100", "k")]


def test_a_force_is_drawn_as_it_is_held_and_marked_where_it_ended(axis):
    _figures.force_trace(axis, [40.0, -40.0, np.nan, np.nan], 0.1, 0.4, "k", "LQR")
    (steps,) = axis.patches
    assert steps.get_data().values.tolist() == [40.0, -40.0]
    assert drawn(axis) == [("x", [0.2])]
    _figures.force_trace(axis, [1.0] * 4, 0.1, 0.4, "k", "LQR")
    assert len(axis.lines) == 1


def test_a_legend_above_a_figure_has_one_entry_for_each_label():
    figure, axes = _figures.facets(1, 2, height=3.0)
    for each in axes.flat:
        each.plot([0, 1], label="LQR")
    axes[0, 1].plot([0, 1], label="SDRE")
    _figures.legend_above(figure, 2)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["LQR", "SDRE"]


def test_a_logarithmic_axis_has_plain_numbers_at_its_ticks(axis):
    _figures.log_axis(axis, "x", (0.02, 0.1, 1, 1000))
    assert [axis.xaxis.get_major_formatter()(tick, 0) for tick in axis.get_xticks()] == ["0.02", "0.1", "1", "1,000"]
    assert len(axis.get_xticks(minor=True)) == 0


def test_points_stand_where_their_values_are_with_both_intervals_and_their_names(axis):
    axis.set(xlim=(0, 1), ylim=(0, 1))
    _figures.scatter(axis, {"LQR": (Estimate(0.3, 0.2, 0.5), Estimate(0.6, 0.5, 0.8))}, {"LQR": STYLE})
    bars = [container.lines[2][0].get_segments()[0].tolist() for container in axis.containers]
    assert np.allclose(bars, [[[0.3, 0.5], [0.3, 0.8]], [[0.2, 0.6], [0.5, 0.6]]])
    assert [text.get_text() for text in axis.texts] == ["LQR"]


def test_each_training_of_a_group_has_a_point_of_its_own_beside_the_others(axis):
    _figures.strip(axis, {"Q tuned": [Estimate(0.8), Estimate(0.9)], "LSPI": [Estimate(0.7)]}, STYLE)
    assert [container.lines[0].get_xdata().tolist() for container in axis.containers] == [[-0.025, 0.025], [1.0]]
    assert [label.get_text() for label in axis.get_xticklabels()] == ["Q tuned", "LSPI"]


def test_no_label_covers_another_or_a_point():
    rng = np.random.default_rng(0)
    figure = Figure(figsize=(6, 3), layout="constrained")
    axis = figure.subplots()
    axis.set(xscale="log", xlim=(0.1, 100), ylim=(0, 1.3))
    x, y = 10 ** rng.uniform(-0.6, 0.0, 12), np.append(np.ones(8), rng.uniform(0.5, 1, 4))
    place_labels(axis, x, y, [f"controller {k}" for k in range(12)])
    renderer = FigureCanvasAgg(figure).get_renderer()
    boxes = [text.get_window_extent(renderer) for text in axis.texts]
    assert not any(box.overlaps(other) for k, box in enumerate(boxes) for other in boxes[:k])
    points = axis.transData.transform(np.column_stack([x, y]))
    assert not any(box.contains(*point) for box in boxes for point in points)
    frame = axis.get_window_extent(renderer)
    assert all(frame.contains(box.x0, box.y0) and frame.contains(box.x1, box.y1) for box in boxes)


def curves(axis):
    """Return the looks of a panel's curves, but for single trainings behind a median and the best that is known."""
    return {
        (line.get_color(), line.get_linestyle(), line.get_marker())
        for line in axis.lines
        if len(np.ravel(line.get_xdata())) > 2 and line.get_linestyle() != "None"
        if line.get_alpha() is None and line.get_color() != _figures.BEST[0]
    }


@pytest.mark.nightly
@pytest.mark.parametrize("folder", KEPT)
def test_a_kept_figure_fits_a_page_with_seven_points_and_at_most_six_curves_a_panel(folder):
    with _figures.look():
        drawn = importlib.import_module(KEPT[folder]).report(load(RESULTS / folder)).figures
        for figure in [drawn] if isinstance(drawn, Figure) else drawn.values():
            figure.draw_without_rendering()
            texts = [text for text in figure.findobj(Text) if text.get_text()]
            assert figure.get_figwidth() <= _figures.WIDTH
            assert min(float(text.get_fontsize()) for text in texts) >= 7
            assert max(len(curves(axis)) for axis in figure.axes) <= _figures.MOST
