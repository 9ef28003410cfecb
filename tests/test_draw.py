"""Pictures are to scale, figures show the run and nothing else, films last as long as they should."""

from __future__ import annotations

import base64
import importlib
import io
import math
import shutil
import subprocess
import sys
import types
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import matplotlib
import numpy as np
import pytest
from matplotlib.artist import Artist
from matplotlib.backend_bases import FigureManagerBase
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import FancyArrow, Rectangle
from PIL import Image, ImageSequence
from rigs import endless, random_states, whole

import dpend
from controllers import LQR, Constant, Zero
from dpend import Run
from dpend.draw import Picture, Scene, animate_run, animate_scenes, draw_strobe, plot_run

RIG = dpend.rig("gustafsson2016")
STATE = np.array([0.3, 0.4, -0.5, 0.0, 0.0, 0.0])
PRESETS = tuple(dpend.rigs())
POSIX = pytest.mark.skipif(sys.platform == "win32", reason="The program that stands in for ffmpeg is a shell script.")


@pytest.fixture(scope="module")
def run() -> Run:
    return dpend.simulate(RIG, LQR(RIG), [0, 0.2, -0.1, 0, 0, 0], 0.6)


def parts(picture: Picture, name: str) -> list[Any]:
    return picture.figure.findobj(lambda artist: artist.get_gid() == name)


def part(picture: Picture, name: str) -> Any:
    (artist,) = parts(picture, name)
    return artist


def view(picture: Picture) -> tuple[tuple[float, float], tuple[float, float]]:
    return picture.figure.axes[0].get_xlim(), picture.figure.axes[0].get_ylim()


# -------------------------------------------------------------------------------------------------------------- imports


@pytest.mark.parametrize(
    ("code", "absent"),
    [
        ("import dpend", "matplotlib"),
        (
            "import dpend, numpy as np\n"
            "from dpend.draw import Picture\n"
            "from dpend.run import Run\n"
            "rig = dpend.rig('gustafsson2016')\n"
            "Picture(rig).rgb([0] * 6)\n"
            "run = Run(t=np.arange(3.0), x=np.zeros((3, 6)), y=np.zeros((3, 6)), u=np.ones(2), step_time=np.ones(2),\n"
            "  status=dpend.Status.FULL_LENGTH, success=True, time_up=0.0, rig=rig, controller='', task='', seed=0)\n"
            "run.plot()",
            "matplotlib.pyplot",
        ),
    ],
    ids=["dpend without matplotlib", "pictures and figures without pyplot"],
)
def test_no_more_is_imported_than_is_used(code: str, absent: str) -> None:
    code += f"\nimport sys\nsys.exit({absent!r} in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


# ------------------------------------------------------------------------------------------------------------- pictures


@pytest.mark.parametrize("name", PRESETS)
def test_links_end_where_the_positions_say(name: str) -> None:
    rig = dpend.rig(name)
    picture = Picture(rig)
    for x in random_states(np.random.default_rng(0), 5):
        picture.rgb(x)
        place = dpend.positions(x, rig.params)
        joint, tip = (place.x_joint, place.y_joint), (place.x_tip, place.y_tip)
        np.testing.assert_array_equal(part(picture, "link 1").get_xydata(), [(x[0], 0.0), joint])
        np.testing.assert_array_equal(part(picture, "link 2").get_xydata(), [joint, tip])
        np.testing.assert_array_equal(part(picture, "tip").get_xydata(), [tip])
        for link, length in (("link 1", rig.params.length1), ("link 2", rig.params.length2)):
            assert math.dist(*part(picture, link).get_xydata()) == pytest.approx(length, rel=1e-12)


@pytest.mark.parametrize("changed", range(3))
def test_pixels_move_when_a_coordinate_moves(changed: int) -> None:
    picture = Picture(RIG)
    before, moved = picture.rgb(STATE), STATE.copy()
    moved[changed] += 0.05
    assert (picture.rgb(moved) != before).any()


def test_pixels_stay_when_only_rates_change() -> None:
    picture = Picture(RIG)
    np.testing.assert_array_equal(picture.rgb(STATE), picture.rgb([*STATE[:3], 1, 2, 3]))


@pytest.mark.parametrize("name", PRESETS)
def test_a_picture_does_not_remember_what_was_drawn_before(name: str) -> None:
    used, fresh = Picture(dpend.rig(name)), Picture(dpend.rig(name))
    first = used.rgb([-0.4, 2.0, 1.0, 0, 0, 0], -3.0, time=1.0)
    kept = first.copy()
    np.testing.assert_array_equal(used.rgb(STATE, 4.0, time=2.0), fresh.rgb(STATE, 4.0, time=2.0))
    np.testing.assert_array_equal(first, kept)


def test_the_right_colors_are_at_the_right_places() -> None:
    picture = Picture(RIG)
    pixels = picture.rgb(STATE)
    place = dpend.positions(STATE, RIG.params)
    middles = {
        "#0072B2": ((STATE[0] + place.x_joint) / 2, place.y_joint / 2),
        "#D55E00": ((place.x_joint + place.x_tip) / 2, (place.y_joint + place.y_tip) / 2),
    }
    for color, middle in middles.items():
        column, row = picture.figure.axes[0].transData.transform(middle)
        assert "#{:02X}{:02X}{:02X}".format(*pixels[len(pixels) - 1 - int(row), int(column)]) == color
    assert (pixels[100, 100] == 255).all()


def test_a_metre_is_as_high_as_it_is_wide_and_sides_are_even() -> None:
    for track in (0.01, 0.5, 1.7, 2.4, 5.0, 30.0, math.inf):
        picture = Picture(RIG.replace(track_limit=track))
        pixels = picture.rgb(STATE)
        assert pixels.dtype == np.uint8
        assert pixels.shape[0] % 2 == pixels.shape[1] % 2 == 0
        assert pixels.shape[2] == 3
        zero, ones = picture.figure.axes[0].transData.transform([(0, 0), (1, 1)])
        width, height = ones - zero
        assert height == pytest.approx(width, rel=1e-9)


@pytest.mark.parametrize("name", PRESETS)
def test_nothing_swings_out_of_the_picture(name: str) -> None:
    rig = dpend.rig(name)
    picture = Picture(rig)
    for side in (-1, 1):
        for angle in np.linspace(-np.pi, np.pi, 17):
            x = np.array([side * min(rig.track_limit, 30.0), angle, angle, 0, 0, 0])
            picture.rgb(x)
            place = dpend.positions(x, rig.params)
            (left, right), (low, high) = view(picture)
            assert left < place.x_tip < right
            assert low < place.y_tip < high


def test_a_track_has_ends_where_the_cart_stops() -> None:
    picture = Picture(RIG)
    picture.rgb([2.4, 0, 0, 0, 0, 0])
    left, right = sorted(parts(picture, "track end"), key=Rectangle.get_x)
    cart = part(picture, "cart")
    assert cart.get_x() + cart.get_width() == pytest.approx(right.get_x(), rel=1e-12)
    assert left.get_x() + left.get_width() == pytest.approx(-right.get_x(), rel=1e-12)


@pytest.mark.parametrize("track", [math.inf, 1000.0])
def test_the_view_follows_the_cart_on_a_long_track(track: float) -> None:
    picture = Picture(endless(track_limit=track))
    for pos in (0.0, 3.5, -250.25):
        picture.rgb([pos, 0.1, 0.2, 0, 0, 0])
        (left, right), _ = view(picture)
        assert (left + right) / 2 == pytest.approx(pos, abs=1e-9)
        assert list(part(picture, "track").get_xdata()) == [left, right]
    assert len(parts(picture, "track end")) == (0 if track == math.inf else 2)


def arrow(rig: dpend.Rig, force: float) -> float:
    picture = Picture(rig)
    picture.rgb(STATE, force)
    shape: FancyArrow = part(picture, "force")
    edge = part(picture, "cart").get_x() + (part(picture, "cart").get_width() if force > 0 else 0.0)
    far = shape.get_xy()[:, 0]
    return float((far.max() if force > 0 else far.min()) - edge) if shape.get_visible() else 0.0


def test_the_arrow_is_the_force() -> None:
    full = arrow(RIG, 40.0)
    assert full > 0.5
    assert [arrow(RIG, force) for force in (20.0, 1.0, 0.0, -10.0, -40.0, 1000.0)] == pytest.approx(
        [full / 2, full / 40, 0.0, -full / 4, -full, full]
    )
    assert arrow(endless(), 2.0 * 9.81) == pytest.approx(full), "the plant's weight where there is no limit"


def test_time_and_force_are_written_above_the_picture() -> None:
    picture = Picture(RIG)
    texts = [(5.678, -12.34), (None, 0.0), (0.0, -0.01)]
    written = []
    for time, force in texts:
        picture.rgb(STATE, force, time=time)
        written.append([text.get_text() for text in picture.figure.texts])
    assert written == [["t = 5.68 s", "force −12.3 N"], ["", "force +0.0 N"], ["t = 0.00 s", "force +0.0 N"]]


def test_a_picture_refuses_a_batch_of_rigs() -> None:
    message = "A picture takes one plant; got a rig of 3 rows. Take one of them with rig.rows(i)."
    with pytest.raises(ValueError, match=whole(message)):
        Picture(RIG.replace(mass1=[0.4, 0.5, 0.6]))


@pytest.mark.parametrize(
    ("x", "force", "message"),
    [
        (
            np.zeros(4),
            0.0,
            "A state has six numbers (pos, th1, th2, vel, om1, om2): expected an array of shape (1, 6) or (6,); "
            "got shape (4,).",
        ),
        ([0, np.nan, 0, 0, 0, 0], 0.0, "States must be finite; got nan for th1 in row 0."),
        (STATE, math.inf, "force must be a finite number in N; got inf."),
    ],
)
def test_a_picture_refuses_what_cannot_be_drawn(x: Any, force: float, message: str) -> None:
    with pytest.raises(ValueError, match=whole(message)):
        Picture(RIG).rgb(x, force)


# -------------------------------------------------------------------------------------------------------------- windows


class WindowlessManager(FigureManagerBase):
    def show(self) -> None:
        pass


class PretendedWindow(FigureCanvasAgg):
    """A canvas that takes itself for a window, on machines with and without a display."""

    required_interactive_framework = "headless"
    manager_class = WindowlessManager  # pyright: ignore[reportAssignmentType]

    def flush_events(self) -> None:
        pass


@pytest.fixture
def pyplot(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    module: Any = types.ModuleType("pretended_windows")
    module.FigureCanvas = PretendedWindow
    monkeypatch.setitem(sys.modules, "pretended_windows", module)
    matplotlib.use("agg")
    from matplotlib import cbook, pyplot

    monkeypatch.setattr(cbook, "_get_running_interactive_framework", lambda: None)
    yield pyplot
    pyplot.close("all")
    matplotlib.use("agg")


def shown(pyplot: Any) -> Any:
    (number,) = pyplot.get_fignums()
    return pyplot.figure(number).axes[0].images[0].get_array()


def test_a_window_opens_follows_and_closes(pyplot: Any) -> None:
    matplotlib.use("module://pretended_windows")
    picture, other = Picture(RIG), Picture(RIG)
    picture.close()
    for force in (3.0, -5.0):
        picture.show(STATE, force, time=1.0)
        np.testing.assert_array_equal(shown(pyplot), other.rgb(STATE, force, time=1.0))
    pyplot.close("all")
    picture.show(STATE)
    np.testing.assert_array_equal(shown(pyplot), other.rgb(STATE))
    picture.close()
    picture.close()
    assert pyplot.get_fignums() == []


def test_without_a_display_the_error_names_the_remedy(pyplot: Any) -> None:
    message = (
        "matplotlib cannot open a window here with its backend 'agg'. Where there is a display, install the "
        "extra `gui` (python -m pip install 'dpend[gui]'); where there is none, use render_mode=\"rgb_array\" or "
        "Run.animate."
    )
    with pytest.raises(RuntimeError, match=whole(message)):
        Picture(RIG).show(STATE)
    assert pyplot.get_fignums() == []


# -------------------------------------------------------------------------------------------------------------- figures


def labelled(axes: Any) -> dict[str, Artist]:
    handles, labels = axes.get_legend_handles_labels()
    return dict(zip(labels, handles, strict=True))


def test_a_figure_shows_every_state_and_the_held_force(run: Run) -> None:
    figure = plot_run(run)
    assert [axes.get_ylabel() for axes in figure.axes] == [
        "position [m]",
        "angles [rad]",
        "velocity [m/s]",
        "rates [rad/s]",
        "force [N]",
    ]
    assert figure.axes[-1].get_xlabel() == "time [s]"
    columns = {0: ["cart"], 1: ["link 1", "link 2"], 2: ["cart"], 3: ["link 1", "link 2"]}
    drawn = []
    for panel, names in columns.items():
        for name in names:
            line = labelled(figure.axes[panel])[name]
            assert isinstance(line, Line2D)
            np.testing.assert_array_equal(line.get_xdata(), run.t)
            drawn.append(line.get_ydata())
    np.testing.assert_array_equal(np.array(drawn), run.x.T)
    values, edges, _ = figure.axes[4].patches[0].get_data()  # pyright: ignore[reportAttributeAccessIssue]
    np.testing.assert_array_equal(values, run.u)
    np.testing.assert_array_equal(edges, run.t)


def test_a_figure_says_who_ran_and_how_it_ended(run: Run) -> None:
    assert run.plot().get_suptitle() == "LQR\nThe run reached its full length."


@pytest.mark.parametrize(
    ("changes", "title"),
    [
        ({}, "LQR\nThe run reached its full length."),
        ({"time_up": 0.345}, "LQR\nThe run reached its full length.\nSuccess: both links up after 0.34 s."),
        ({"success": False}, "LQR\nThe run reached its full length.\nNo success."),
        ({"success": False, "task": "None"}, "LQR\nThe run reached its full length."),
    ],
)
def test_a_title_says_whether_a_task_was_done_and_since_when_both_links_were_up(
    run: Run, changes: dict[str, Any], title: str
) -> None:
    assert plot_run(replace(run, **changes)).get_suptitle() == title


def test_pushes_are_drawn_where_there_were_any(run: Run) -> None:
    shoved = replace(run, log={"push_cart": np.zeros(30), "push_link2": np.linspace(0.0, 1.0, 30)})
    axes = plot_run(shoved).axes
    assert len(axes) == 6
    assert axes[5].get_ylabel() == "pushes"
    assert list(labelled(axes[5])) == ["on link 2 [N m]"]
    np.testing.assert_array_equal(axes[5].patches[0].get_data()[0], shoved.log["push_link2"])  # pyright: ignore[reportAttributeAccessIssue]
    assert len(plot_run(replace(run, log={"push_cart": np.zeros(30)})).axes) == 5


def test_notebooks_show_figures_runs_rigs_and_films(run: Run, tmp_path: Path) -> None:
    picture = run.plot()._repr_png_()
    assert Image.open(io.BytesIO(picture)).format == "PNG"
    named = replace(run, controller="a < b")._repr_html_()
    assert "<p>a &lt; b<br>The run reached its full length.<br>0.6 s on" in named
    assert "data:image/png;base64," in named
    assert "<tr><th>mass1</th><td>0.5</td><td>kg</td></tr>" in RIG._repr_html_()
    film = run.animate(tmp_path / "run.gif", fps=5)
    assert base64.b64encode(film.read_bytes()).decode() in film._repr_html_()
    assert film._repr_html_().startswith('<img src="data:image/gif;base64,')
    assert film == tmp_path / "run.gif"


def test_show_opens_a_window_and_closes_with_it(pyplot: Any, run: Run) -> None:
    matplotlib.use("module://pretended_windows")
    run.show()
    np.testing.assert_array_equal(shown(pyplot), np.asarray(Image.open(io.BytesIO(run.plot()._repr_png_())))[..., :3])


def test_show_without_a_window_says_how_to_keep_the_figure(pyplot: Any, run: Run) -> None:
    message = (
        "There is no window to show the figure in: figure.savefig(path) writes it. With a display,"
        " install the extra `gui` (python -m pip install 'dpend[gui]')."
    )
    with pytest.warns(UserWarning, match=whole(message)):
        run.show()
    run.plot().show(warn=False)
    assert pyplot.get_fignums() == []


def test_show_displays_in_a_notebook(monkeypatch: pytest.MonkeyPatch, run: Run) -> None:
    displayed: list[object] = []
    kernel = types.SimpleNamespace(kernel=None)
    monkeypatch.setitem(sys.modules, "IPython", types.SimpleNamespace(get_ipython=lambda: kernel))  # pyright: ignore
    monkeypatch.setitem(sys.modules, "IPython.display", types.SimpleNamespace(display=displayed.append))  # pyright: ignore
    figure = run.plot()
    figure.show()
    assert displayed == [figure]


def test_lines_are_told_apart_without_color(run: Run) -> None:
    for panel in (1, 3):
        lines = [line for line in plot_run(run).axes[panel].lines if line.get_label() in ("link 1", "link 2")]
        assert [line.get_linestyle() for line in lines] == ["-", "--"]


@pytest.mark.parametrize(("force", "in_view"), [(0.5, False), (39.0, True)])
def test_the_force_limit_is_named_and_in_view_when_the_force_comes_near(force: float, in_view: bool) -> None:
    axes = plot_run(dpend.simulate(RIG, Constant(force), np.zeros(6), 0.2)).axes[4]
    (line,) = [line for line in axes.lines if line.get_label() == "limit ±40 N"]
    assert isinstance(line, Line2D)
    assert [*np.unique(line.get_ydata())] == [40.0]
    low, high = axes.get_ylim()
    assert (low < -40.0 and high > 40.0) == in_view


@pytest.mark.parametrize("pictures", [2, 7])
def test_a_strobe_picture_shows_links_where_the_positions_say_the_first_and_the_last_among_them(
    run: Run, pictures: int
) -> None:
    axes = Figure().subplots()
    draw_strobe(axes, run.x, RIG, pictures=pictures)
    place = dpend.positions(run.x, RIG.params)
    ends = np.array([np.asarray(line.get_xydata())[1] for line in axes.lines if line.get_color() == "#D55E00"])
    assert len(ends) == pictures
    tips = np.column_stack([place.x_tip, place.y_tip])
    assert np.array_equal(ends[[0, -1]], tips[[0, -1]])
    assert set(map(tuple, ends.tolist())) <= set(map(tuple, tips.tolist()))
    assert axes.get_aspect() == 1.0


def test_a_strobe_picture_refuses_a_single_picture_and_a_batch_of_rigs(run: Run) -> None:
    axes = Figure().subplots()
    with pytest.raises(ValueError, match=whole("pictures must be at least 2; got 1.")):
        draw_strobe(axes, run.x, RIG, pictures=1)
    message = "A picture takes one plant; got a rig of 2 rows. Take one of them with rig.rows(i)."
    with pytest.raises(ValueError, match=whole(message)):
        draw_strobe(axes, run.x, RIG.replace(mass1=np.ones(2)))


def test_a_rig_without_limits_has_none_drawn() -> None:
    figure = plot_run(dpend.simulate(endless(), Zero(), STATE, 0.2))
    assert [*labelled(figure.axes[0])] == ["cart"]
    assert [*labelled(figure.axes[4])] == ["applied"]


class Broken:
    name = "a controller whose name is longer than any figure is wide, and which after a while has no force to give"

    def start(self, n: int, rng: np.random.Generator) -> dpend.Act:
        return lambda t, y: np.full(n, np.nan if t > 0.05 else 1.0)


SHORT = {
    "ended at once": lambda: dpend.simulate_many(RIG, Zero(), [3.0, 0, 0, 0, 0, 0], 1.0, record=True)[0],
    "one sample": lambda: dpend.simulate(RIG, Zero(), STATE, 0.02),
    "not finite": lambda: dpend.simulate(RIG, Broken(), STATE, 1.0),
}


@pytest.mark.parametrize("make", SHORT.values(), ids=SHORT)
def test_runs_that_hardly_began_can_be_drawn_and_filmed(make: Any, tmp_path: Path) -> None:
    run = make()
    plot_run(run).savefig(tmp_path / "run.png", dpi=50)
    with Image.open(tmp_path / "run.png") as image:
        assert image.size == (315, 380)
    with Image.open(animate_run(run, tmp_path / "run.gif", fps=50)) as film:
        assert getattr(film, "n_frames", 1) == len(run.t) - (run.status is dpend.Status.NOT_FINITE)


# ---------------------------------------------------------------------------------------------------------------- films


def durations(path: Path) -> list[float]:
    with Image.open(path) as film:
        return [frame.info["duration"] / 1000 for frame in ImageSequence.Iterator(film)]


@pytest.mark.parametrize(
    ("fps", "speed", "frames", "seconds"),
    [
        (25, 1.0, 16, 0.04),  # 0.6 s, and the end
        (36, 1.0, 21, 0.03),  # a thirty-sixth of a second cannot be held
        (60, 1.0, 31, 0.02),  # what is shorter is slowed down by players
        (12.5, 2.0, 5, 0.08),
    ],
)
def test_a_gif_has_its_frames_and_lasts_as_long_as_the_run(
    fps: float, speed: float, frames: int, seconds: float, run: Run, tmp_path: Path
) -> None:
    path = run.animate(tmp_path / "run.gif", fps=fps, speed=speed)
    assert path == tmp_path / "run.gif"
    assert durations(path) == pytest.approx([seconds] * frames)
    assert sum(durations(path)) == pytest.approx(0.6 / speed, abs=2 * seconds)


def test_a_gif_in_slow_motion_lasts_longer(run: Run, tmp_path: Path) -> None:
    path = animate_run(run, tmp_path / "run.gif", fps=10, speed=0.2)
    assert sum(durations(path)) == pytest.approx(3.0 + 0.1)  # frames that are alike may be one


def test_a_gif_repeats_and_shows_what_the_picture_shows(run: Run, tmp_path: Path) -> None:
    path = animate_run(run, tmp_path / "run.gif", fps=10)
    with Image.open(path) as film:
        assert film.info["loop"] == 0
        film.seek(5)
        pixels = np.asarray(film.convert("RGB")).astype(int)
    wanted = Picture(RIG).rgb(run.x[25], run.u[25], time=run.t[25]).astype(int)
    assert (pixels[wanted.min(axis=2) == 255] == 255).all(), "white stays white"
    assert np.abs(pixels - wanted).max() < 64, "256 colours do for the edges"
    assert np.abs(pixels - wanted).mean() < 0.1


@pytest.mark.parametrize(("fps", "speed"), [(25, 1.0), (33, 0.7), (7, 3.0)])
def test_a_frame_shows_the_last_sample_before_it(
    fps: float, speed: float, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown: list[tuple[Any, float, float]] = []
    rgb = Picture.rgb

    def watched(picture: Picture, x: Any, force: float = 0.0, *, time: float | None = None) -> Any:
        if time is not None:
            shown.append((x, force, time))
        return rgb(picture, x, force, time=time)

    monkeypatch.setattr(Picture, "rgb", watched)
    frame = durations(animate_run(run, tmp_path / "run.gif", fps=fps, speed=speed))[0]
    for number, (x, force, time) in enumerate(shown):
        now = min(number * frame * speed, run.t[-1]) + 1e-9
        sample = np.flatnonzero(run.t <= now)[-1]
        assert time == run.t[sample]
        np.testing.assert_array_equal(x, run.x[sample])
        assert force == run.u[min(sample, len(run.u) - 1)]
    assert shown[-1][2] == run.t[-1]


@pytest.mark.slow
def test_an_mp4_has_its_frames_and_lasts_as_long_as_the_run(run: Run, tmp_path: Path) -> None:
    imageio_ffmpeg: Any = pytest.importorskip(
        "imageio_ffmpeg", reason="MP4 is not checked here: python -m pip install imageio-ffmpeg brings an ffmpeg."
    )
    path = run.animate(tmp_path / "run.MP4", fps=30, speed=0.5)
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(path)
    assert frames == 37
    assert seconds == pytest.approx(37 / 30, abs=0.02)
    reader = imageio_ffmpeg.read_frames(path)
    size = next(reader)["size"]
    first = np.frombuffer(next(reader), dtype=np.uint8).reshape(size[1], size[0], 3).astype(int)
    reader.close()
    wanted = Picture(RIG).rgb(run.x[0], run.u[0], time=0.0).astype(int)
    assert np.abs(first - wanted).mean() < 3.0


def test_an_mp4_without_ffmpeg_is_refused_with_the_remedy(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    message = (
        "Writing an MP4 needs ffmpeg, which was not found: install it, for instance with "
        "python -m pip install imageio-ffmpeg, or write a .gif."
    )
    with pytest.raises(RuntimeError, match=whole(message)):
        run.animate(tmp_path / "run.mp4")
    assert [*tmp_path.iterdir()] == []


def stand_in(program: Path, script: str) -> str:
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)
    return str(program)


@POSIX
@pytest.mark.parametrize("reads", ["", "cat > /dev/null; "], ids=["at once", "at the end"])
def test_the_words_of_an_ffmpeg_that_fails_are_passed_on(
    reads: str, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = stand_in(tmp_path / "ffmpeg", f"{reads}echo Unknown encoder >&2; exit 1")
    monkeypatch.setattr(shutil, "which", lambda name: program)
    with pytest.raises(RuntimeError, match=whole("ffmpeg could not write the film: Unknown encoder")):
        run.animate(tmp_path / "run.mp4")
    assert [*tmp_path.iterdir()] == [Path(program)]


@pytest.mark.parametrize(
    ("name", "settings", "message"),
    [
        ("run.avi", {}, "The suffix chooses the format: expected a path ending in .gif or .mp4; got {path!r}."),
        ("run", {}, "The suffix chooses the format: expected a path ending in .gif or .mp4; got {path!r}."),
        ("run.gif", {"fps": 0}, "fps must be finite and greater than 0 pictures per second; got 0."),
        ("run.gif", {"fps": math.nan}, "fps must be finite and greater than 0 pictures per second; got nan."),
        (
            "run.gif",
            {"speed": -1.0},
            "speed must be finite and greater than 0 seconds of the run per second; got -1.0.",
        ),
        (
            "run.mp4",
            {"speed": math.inf},
            "speed must be finite and greater than 0 seconds of the run per second; got inf.",
        ),
    ],
)
def test_a_film_refuses_what_it_cannot_be(
    name: str, settings: dict[str, float], message: str, run: Run, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match=whole(message.format(path=str(tmp_path / name)))):
        run.animate(tmp_path / name, **settings)
    assert [*tmp_path.iterdir()] == []


def test_a_place_that_cannot_be_written_to_is_refused_before_anything_is_drawn(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def drawn(rig: dpend.Rig) -> None:
        raise AssertionError("drawn too early")

    monkeypatch.setattr(importlib.import_module("dpend.draw"), "Picture", drawn)
    missing, folder, file = tmp_path / "no", tmp_path / "folder.gif", tmp_path / "file"
    folder.mkdir()
    file.touch()
    for place, kind, reason in (
        (missing / "run.gif", FileNotFoundError, "No such file or directory"),
        (file / "run.gif", NotADirectoryError, "Not a directory"),
    ):
        with pytest.raises(kind) as caught:
            run.animate(place)
        assert caught.value.strerror == f"{place} could not be written: {reason}"
    with pytest.raises(IsADirectoryError, match=whole(f"Cannot write the film: {folder} is a folder.")):
        run.animate(folder)
    assert sorted(tmp_path.iterdir()) == [file, folder]


def test_a_figure_that_cannot_be_finished_leaves_what_was_there(run: Run, tmp_path: Path) -> None:
    figure, there = run.plot(), tmp_path / "run.png"
    figure.savefig(tmp_path / "run")
    whole_one = there.read_bytes()
    with pytest.raises(ValueError, match="not supported"):
        figure.savefig(there, format="gif87")
    assert there.read_bytes() == whole_one
    assert [*tmp_path.iterdir()] == [there]


@pytest.mark.parametrize("suffix", [".gif", pytest.param(".mp4", marks=POSIX)])
def test_a_film_that_breaks_off_leaves_what_was_there(
    suffix: str, run: Run, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = stand_in(tmp_path_factory.mktemp("program") / "ffmpeg", "cat > /dev/null")
    monkeypatch.setattr(shutil, "which", lambda name: program)
    path = tmp_path / f"run{suffix}"
    path.write_text("what was there")
    rgb = Picture.rgb

    def breaking(picture: Picture, x: Any, force: float = 0.0, *, time: float | None = None) -> Any:
        if time is not None and time > 0.3:
            raise KeyboardInterrupt
        return rgb(picture, x, force, time=time)

    monkeypatch.setattr(Picture, "rgb", breaking)
    with pytest.raises(KeyboardInterrupt):
        animate_run(run, path)
    assert [*tmp_path.iterdir()] == [path]
    assert path.read_text() == "what was there"


# --------------------------------------------------------------------------------------------------------------- scenes


@pytest.fixture(scope="module")
def pushed() -> list[Run]:
    """Return a run under a push on the cart and one on the upper link, and one that falls."""
    start = [0, 0.2, -0.1, 0, 0, 0]

    def push(t: float) -> tuple[float, float, float]:
        return (5.0 * (0.1 <= t < 0.2), 0.0, -0.3 * (0.3 <= t < 0.4))

    return [
        dpend.simulate(RIG, LQR(RIG), start, 0.8, push=push),
        dpend.simulate(RIG, Zero(), [0, 1.3, 1.3, 0, 0, 0], 0.8),
    ]


def test_a_scene_shows_every_run_at_one_time_and_its_force_until_then(pushed: list[Run]) -> None:
    scene = Scene(pushed, ["LQR", "no force"])
    scene.rgb(0.1)
    links = scene.figure.findobj(lambda artist: artist.get_gid() == "link 2")
    for run, link in zip(pushed, links, strict=True):
        place = dpend.positions(run.x[5], RIG.params)
        joint, tip = (place.x_joint, place.y_joint), (place.x_tip, place.y_tip)
        np.testing.assert_array_equal(cast(Line2D, link).get_xydata(), [joint, tip])
    (trace,) = scene.figure.axes[1].lines[-1:]
    np.testing.assert_array_equal(np.asarray(trace.get_ydata())[:-1], pushed[0].u[:6])
    assert np.asarray(trace.get_xdata())[-1] == pytest.approx(0.12), "what is held now is drawn to its end"


def test_the_arrow_of_a_push_is_there_while_it_lasts_and_points_its_way(pushed: list[Run]) -> None:
    scene = Scene(pushed[:1], ["LQR"])
    seen = {}
    for name in ("push_cart", "push_link2"):
        (arrow,) = scene.figure.findobj(lambda artist, name=name: artist.get_gid() == name)
        lasting = []
        for time in np.arange(0.01, 0.8, 0.02):
            scene.rgb(float(time))
            lasting.append(arrow.get_visible())
            if arrow.get_visible():
                # An arrow ends in one point, and begins with two.
                across = np.unique(cast(FancyArrow, arrow).get_xy(), axis=0)[:, 0]
                ends = [np.sum(np.abs(across - end) < 0.02) for end in (across.min(), across.max())]
                seen[name] = "right" if ends == [2, 1] else "left" if ends == [1, 2] else "nowhere"
        np.testing.assert_array_equal(lasting, pushed[0].log[name] != 0)
    assert seen == {"push_cart": "right", "push_link2": "left"}


def test_a_run_that_ended_stays_as_it_ended_and_the_scene_says_how(pushed: list[Run]) -> None:
    scene = Scene(pushed, ["LQR", "no force"])
    over = pushed[1].t[-1]
    assert over < 0.7
    for time, words in ((over - 0.03, ""), (over, "Link 1 fell"), (0.8, "Link 1 fell")):
        scene.rgb(float(time))
        assert ("Link 1 fell" in [text.get_text() for text in scene.figure.texts]) == bool(words)
    link = scene.figure.findobj(lambda artist: artist.get_gid() == "link 1")[1]
    assert np.asarray(cast(Line2D, link).get_xdata())[0] == pushed[1].x[-1, 0]


def test_a_film_of_scenes_shows_one_after_the_other(pushed: list[Run], tmp_path: Path) -> None:
    room = max(Scene([run], ["one"]).room for run in pushed)
    scenes = [Scene([run], ["one"], room=room) for run in pushed]
    path = animate_scenes(scenes, tmp_path / "scenes.gif", fps=10)
    held = 2 * 0.9  # the last picture of each is shown once, and once more eight times
    lasting = sum(0.1 * len(np.arange(0, scene.seconds, 0.1)) for scene in scenes)
    assert sum(durations(path)) == pytest.approx(lasting + held)
    other = Scene(pushed[:1], ["one"], room=room + 10)
    message = f"A film takes scenes of one size, at least one: give all the same room; got {room}, {room + 10}."
    with pytest.raises(ValueError, match=whole(message)):
        animate_scenes([*scenes, other], tmp_path / "none.gif")
    assert not (tmp_path / "none.gif").exists()


def test_a_scene_refuses_what_it_cannot_show(run: Run) -> None:
    message = "A scene takes one to four runs, and a name and a color for each; got 1 runs, 2 names and 1 colors."
    with pytest.raises(ValueError, match=whole(message)):
        Scene([run], ["one", "two"])
    message = "A scene shows the whole track, and a rig's has no end: rig.replace(track_limit=5)."
    with pytest.raises(ValueError, match=whole(message)):
        Scene([replace(run, rig=endless())], ["one"])
