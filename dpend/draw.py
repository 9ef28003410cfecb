"""Pictures of a rig, figures and animations of a run.  Nothing else in the package imports matplotlib."""

from __future__ import annotations

import base64
import contextlib
import importlib
import io
import math
import shutil
import subprocess
import sys
import textwrap
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import numpy.typing as npt
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import FancyArrow, Rectangle
from matplotlib.ticker import MaxNLocator
from PIL import Image

from . import archive
from .arguments import checked_path, checked_positive
from .params import Array
from .plant import PUSHES, positions
from .rig import Rig, single_rig
from .state import as_states
from .status import Status

Pixels = npt.NDArray[np.uint8]


if TYPE_CHECKING:
    from .run import Run

if sys.platform == "win32":  # a path's class cannot be subclassed as `Path` before Python 3.12
    from pathlib import WindowsPath as _Path
else:
    from pathlib import PosixPath as _Path

# Okabe and Ito's palette: distinct to colour-blind eyes, and of different lightness.
BLUE, VERMILLION, GREEN, DARK, GREY = "#0072B2", "#D55E00", "#009E73", "#333333", "#8C8C8C"
PUSH = "#B33951"

_DPI = 100
_WIDTH, _LEFT, _RIGHT, _BOTTOM, _TOP = 720, 58, 22, 48, 32  # of a picture and its margins, pixels
_STEPS = [1, 2, 5, 10]  # between the marks of an axis
_SCENE, _GAP, _HEAD, _MIDDLE, _TRACE = 800, 12, 54, 30, 84  # width of a scene, and what stands one below the other, px
_HIGHEST = 300  # room for the pendulums of a scene, px
_MOST_FRAMES = 100_000
_HOLD = 0.8  # s for which the last picture of a scene is held
_WEIGHT = 9.81  # N/kg: what the arrow is measured by where the force has no limit

_NO_WINDOW = (
    "matplotlib cannot open a window here with its backend {!r}. Where there is a display, install the extra `gui` "
    "(python -m pip install 'dpend[gui]'); where there is none, use render_mode=\"rgb_array\" or Run.animate."
)


class _Body:
    """A rig in axes with equal scales: track, cart, both links, and arrows for the force and for pushes."""

    def __init__(self, axes: Axes, rig: Rig, lw: float = 7.0) -> None:
        self._axes, self._params = axes, rig.params
        reach, limit, track = _reach(rig), float(rig.force_limit), float(rig.track_limit)
        mass = float(rig.params.cart_mass + rig.params.mass1 + rig.params.mass2)
        self._metres_per_newton = 0.45 * reach / (limit if math.isfinite(limit) else _WEIGHT * mass)
        self._longest = 0.45 * reach
        self._cart_width, self._cart_height = 0.2 * reach, 0.1 * reach
        floor, self._end = -self._cart_height / 2, track + self._cart_width / 2
        self._rail = Line2D([], [], color=GREY, lw=2, solid_capstyle="butt", gid="track")
        stop = {"width": 0.03 * reach, "height": 0.2 * reach, "color": GREY, "gid": "track end"}
        right, left = Rectangle((self._end, floor), **stop), Rectangle((-self._end - stop["width"], floor), **stop)
        self._cart = Rectangle((0, floor), self._cart_width, self._cart_height, color=DARK, gid="cart")
        self._arrow = FancyArrow(0, 0, 0, 0, length_includes_head=True, color=GREEN, gid="force")
        self._pushes = [FancyArrow(0, 0, 0, 0, length_includes_head=True, color=PUSH, gid=name) for name in PUSHES]
        bar: dict[str, Any] = {"lw": lw, "solid_capstyle": "round"}
        self._links = (
            Line2D([], [], color=BLUE, gid="link 1", **bar),
            Line2D([], [], color=VERMILLION, gid="link 2", **bar),
        )
        dot: dict[str, Any] = {"ls": "", "marker": "o", "ms": lw, "mec": DARK, "mew": 1.5}
        self._joints, self._tip = Line2D([], [], mfc="white", **dot), Line2D([], [], mfc=DARK, gid="tip", **dot)
        ends = [left, right] if math.isfinite(track) else []
        self.artists: list[Artist] = [
            self._rail, *ends, self._cart, *self._links, self._joints, self._tip, self._arrow, *self._pushes
        ]  # fmt: skip
        for order, artist in enumerate(self.artists, start=1):
            artist.set_zorder(order)
            axes.add_artist(artist)

    def place(self, state: Array, force: float, pushes: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        """Move to a state ``(6,)``, under a force on the cart, N, and generalised forces that push cart and links.

        The arrow of a push has one length, and shows its direction.
        """
        place = positions(state, self._params)
        left, right = self._axes.get_xlim()
        self._rail.set_data([max(left, -self._end), min(right, self._end)], [-self._cart_height / 2] * 2)
        x, y = [state[0], place.x_joint, place.x_tip], [0.0, place.y_joint, place.y_tip]
        self._cart.set_x(state[0] - self._cart_width / 2)
        self._point(
            self._arrow, (state[0] + math.copysign(self._cart_width / 2, force), 0.0), (math.copysign(1.0, force), 0.0),
            min(abs(force) * self._metres_per_newton, self._longest),
        )  # fmt: skip
        along = [(1.0, 0.0), *((math.cos(angle), -math.sin(angle)) for angle in state[1:3])]
        for arrow, push, end, (dx, dy) in zip(
            self._pushes,
            pushes,
            ((x[0], -1.5 * self._cart_height), *zip(x[1:], y[1:], strict=True)),
            along,
            strict=True,
        ):
            length, sign = (0.5 * self._longest if push else 0.0), math.copysign(1.0, push)
            tail = (end[0] - sign * length * dx, end[1] - sign * length * dy)
            self._point(arrow, tail, (sign * dx, sign * dy), length)
        self._links[0].set_data(x[:2], y[:2])
        self._links[1].set_data(x[1:], y[1:])
        self._joints.set_data(x[:2], y[:2])
        self._tip.set_data(x[2:], y[2:])

    def _point(
        self, arrow: FancyArrow, tail: tuple[float, float], direction: tuple[float, float], length: float
    ) -> None:
        head = min(self._cart_height, length)
        arrow.set_visible(length > 0)
        arrow.set_data(
            x=tail[0], y=tail[1], dx=length * direction[0], dy=length * direction[1],
            width=0.25 * self._cart_height, head_width=0.75 * head, head_length=head,
        )  # fmt: skip


def _reach(rig: Rig) -> float:
    return float(rig.params.length1 + rig.params.length2)


class Picture:
    """One state of a rig, drawn to scale: track, cart, both links, and an arrow for the force.

    The whole track is in view; where it has no end, or is much longer than the links, the view follows the cart.  The
    arrow has its full length at the force limit, or at the plant's weight on Earth where there is none.

    Parameters
    ----------
    rig : Rig
        One rig.

    Attributes
    ----------
    figure : matplotlib.figure.Figure
        What was drawn last, to be saved or added to.

    Raises
    ------
    ValueError
        If the rig describes several rows.
    """

    def __init__(self, rig: Rig) -> None:
        single_rig(rig, "A picture")
        reach = _reach(rig)
        track = float(rig.track_limit)
        self._follows = track > 3 * reach
        self._half_width = 2.2 * reach if self._follows else max(track + 1.1 * reach, 1.6 * reach)
        half_height = 1.1 * reach

        across = _WIDTH - _LEFT - _RIGHT
        up = 2 * round(across * half_height / self._half_width / 2)  # even, as video codecs want
        height = up + _BOTTOM + _TOP
        self.figure = Figure(figsize=_inches(_WIDTH, height), dpi=_DPI)
        self._canvas = FigureCanvasAgg(self.figure)
        self._axes = axes = self.figure.add_axes((_LEFT / _WIDTH, _BOTTOM / height, across / _WIDTH, up / height))
        axes.set(xlim=(-self._half_width, self._half_width), ylim=(-half_height, half_height), aspect="equal")
        axes.set(xlabel="position [m]", ylabel="height [m]")
        axes.xaxis.set_major_locator(MaxNLocator(6, steps=_STEPS))
        axes.yaxis.set_major_locator(MaxNLocator(5, steps=_STEPS))
        axes.xaxis.set_label_coords(0.5, -26 / up)
        axes.yaxis.set_label_coords(-40 / across, 0.5)
        axes.spines[["top", "right"]].set_visible(False)

        self._body = _Body(axes, rig)
        above = 1 - 0.5 * _TOP / height
        self._time = self.figure.text(_LEFT / _WIDTH, above, "", ha="left", va="center")
        self._force = self.figure.text(1 - _RIGHT / _WIDTH, above, "", ha="right", va="center", color=GREEN)
        # What moves is drawn over a kept background, so that a picture takes a few milliseconds.
        self._moving: list[Artist] = [
            *self._body.artists, self._time, self._force, *([axes.xaxis] if self._follows else [])
        ]  # fmt: skip
        for artist in self._moving:
            artist.set_animated(True)
        self._canvas.draw()
        self._background: Any = self._canvas.copy_from_bbox(self.figure.bbox)
        self._window: tuple[Figure, Any] | None = None

    def rgb(self, x: npt.ArrayLike, force: float = 0.0, *, time: float | None = None) -> Pixels:
        """Return the picture of a state.

        Parameters
        ----------
        x : array_like (6,)
            The state.
        force : float
            Force on the cart, N.
        time : float, optional
            Time to write above the picture, s.

        Returns
        -------
        ndarray (H, W, 3)
            Red, green and blue, ``uint8``; always of the same size, both sides even.

        Raises
        ------
        ValueError
            If the state is not six finite numbers, or the force not a finite one.
        """
        state = as_states(x, 1)[0]
        if not math.isfinite(force):
            raise ValueError(f"force must be a finite number in N; got {force!r}.")
        self._place(state, float(force), time)
        self._canvas.restore_region(self._background)
        for artist in self._moving:
            self.figure.draw_artist(artist)
        return np.array(np.asarray(self._canvas.buffer_rgba())[..., :3])

    def _place(self, state: Array, force: float, time: float | None) -> None:
        if self._follows:
            self._axes.set_xlim(state[0] - self._half_width, state[0] + self._half_width)
        self._body.place(state, force)
        self._time.set_text("" if time is None else f"t = {time:.2f} s")
        self._force.set_text(f"force {round(force, 1) + 0.0:+.1f} N".replace("-", "\N{MINUS SIGN}"))

    def show(self, x: npt.ArrayLike, force: float = 0.0, *, time: float | None = None) -> None:
        """Show a state in a window, which opens where there is none and is otherwise updated; does not wait.

        Parameters
        ----------
        x, force, time
            See :meth:`rgb`.

        Raises
        ------
        RuntimeError
            If matplotlib can open no window.
        ValueError
            If the state is not six finite numbers, or the force not a finite one.
        """
        from matplotlib import pyplot

        pixels = self.rgb(x, force, time=time)
        if self._window is None or not pyplot.fignum_exists(cast(Any, self._window[0]).number):
            self._window = _open_window(pixels)
        figure, image = self._window
        image.set_data(pixels)
        figure.canvas.draw()
        cast(Any, figure.canvas).flush_events()

    def close(self) -> None:
        """Close the window, if one is open."""
        if self._window is not None:
            from matplotlib import pyplot

            pyplot.close(self._window[0])
            self._window = None


class Scene:
    """Runs at one time, side by side: each with its name above, drawn to scale, and its force until then below.

    All are drawn to one scale, which holds the track and whatever they reach.  A run that ends before the last stays
    as it ended, and its name says how.  Pushes are arrows while they last, and bands across the force.

    Parameters
    ----------
    runs : sequence of Run
        From one to four, of rigs whose track has an end.
    names : sequence of str
        What stands above each.
    colors : sequence of str, optional
        Of each force.
    caption : str
        What stands above all.
    room : int, optional
        Height left to the pendulums, px; left out, what they need.  The scenes of one film share one.

    Attributes
    ----------
    room : int
        That height.
    seconds : float
        How long the longest run lasts.

    Raises
    ------
    ValueError
        If there is no run, or more than four, or not a name and a colour for each; or a track has no end.
    """

    def __init__(
        self,
        runs: Sequence[Run],
        names: Sequence[str],
        colors: Sequence[str] | None = None,
        *,
        caption: str = "",
        room: int | None = None,
    ) -> None:
        colors = [GREEN] * len(runs) if colors is None else colors
        if not 1 <= len(runs) <= 4 or not len(runs) == len(names) == len(colors):
            raise ValueError(
                f"A scene takes one to four runs, and a name and a color for each; got {len(runs)} runs, "
                f"{len(names)} names and {len(colors)} colors."
            )
        if not all(math.isfinite(run.rig.track_limit) for run in runs):
            raise ValueError("A scene shows the whole track, and a rig's has no end: rig.replace(track_limit=5).")
        self._runs, self.seconds = list(runs), max(float(run.t[-1] - run.t[0]) for run in runs)
        half, low, high = _extent(runs)
        across = _SCENE / len(runs) - _GAP
        scale = min(across / (2 * half), _HIGHEST / (low + high))
        self.room = 2 * math.ceil(scale * (low + high) / 2) if room is None else room
        scale = min(across / (2 * half), self.room / (low + high))
        height = _HEAD + self.room + _MIDDLE + _TRACE + _BOTTOM
        self.figure = Figure(figsize=_inches(_SCENE, height), dpi=_DPI)
        self._canvas = FigureCanvasAgg(self.figure)
        above = 1 - 16 / height
        self.figure.text(_GAP / _SCENE, above, caption, va="center")
        self._time = self.figure.text(1 - _GAP / _SCENE, above, "", va="center", ha="right")
        self._bodies, self._traces, self._ends = [], [], []
        for place, (run, name, color) in enumerate(zip(runs, names, colors, strict=True)):
            left = place * _SCENE / len(runs) + _GAP / 2
            self.figure.text((left + _GAP / 2) / _SCENE, 1 - 42 / height, name, va="center", color=color, weight="bold")
            end = self.figure.text(
                (left + across - 4) / _SCENE, 1 - 42 / height, "", va="center", ha="right", fontsize=8
            )
            bottom = (_BOTTOM + _TRACE + _MIDDLE) / height
            axes = self.figure.add_axes((left / _SCENE, bottom, across / _SCENE, self.room / height))
            middle = (high - low) / 2
            axes.set(xlim=(-across / 2 / scale, across / 2 / scale))
            axes.set(ylim=(middle - self.room / 2 / scale, middle + self.room / 2 / scale))
            axes.axis("off")
            self._bodies.append(_Body(axes, run.rig, 5.0))
            box = ((left + 36) / _SCENE, _BOTTOM / height, (across - 40) / _SCENE, _TRACE / height)
            self._traces.append(self._trace(self.figure.add_axes(box), run, color, place == 0))
            self._ends.append(end)
        self._moving: list[Artist] = [
            *(artist for body in self._bodies for artist in body.artists), *self._traces, *self._ends, self._time
        ]  # fmt: skip
        for artist in self._moving:
            artist.set_animated(True)
        self._canvas.draw()
        self._background: Any = self._canvas.copy_from_bbox(self.figure.bbox)

    def _trace(self, axes: Axes, run: Run, color: str, first: bool) -> Line2D:
        """Prepare axes for the force, and return the line that will show it."""
        limit = float(run.rig.force_limit)
        most = limit if math.isfinite(limit) else float(np.abs(run.u).max(initial=1.0))
        axes.set(xlim=(0, self.seconds), ylim=(-1.12 * most, 1.12 * most), yticks=(-most, 0, most))
        axes.tick_params(labelsize=8)
        axes.set_xlabel("time [s]", fontsize=8, labelpad=1)
        axes.grid(color="0.92")
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
        if first:
            axes.set_title("force on the cart [N]", fontsize=8, loc="left", pad=3, color=DARK)
        pushed = np.any([np.nan_to_num(run.log.get(name, np.zeros(len(run.u)))) != 0 for name in PUSHES], axis=0)
        edges = np.flatnonzero(np.diff(np.r_[False, pushed, False]))
        for began, ended in edges.reshape(-1, 2):
            axes.axvspan(run.t[began] - run.t[0], run.t[ended] - run.t[0], color=PUSH, alpha=0.25, lw=0)
        line = Line2D([], [], color=color, lw=1.2, drawstyle="steps-post")
        axes.add_line(line)
        return line

    def rgb(self, time: float) -> Pixels:
        """Return the picture of a time after the runs began, s: red, green and blue ``(H, W, 3)``, both sides even."""
        for run, body, trace, end in zip(self._runs, self._bodies, self._traces, self._ends, strict=True):
            over = time >= run.t[-1] - run.t[0] and run.status is not Status.FULL_LENGTH
            sample = _sample_at(run, run.t[0] + time)
            held = min(sample, len(run.u) - 1)
            pushes = [0.0 if over else float(run.log[name][held]) if name in run.log else 0.0 for name in PUSHES]
            body.place(run.x[sample], 0.0 if over else float(np.nan_to_num(run.u[held])), pushes)
            trace.set_data(run.t[: held + 2] - run.t[0], np.r_[run.u[: held + 1], run.u[held]])
            end.set_text(run.status.value.split(":")[0].rstrip(".") if over else "")
        self._time.set_text(f"t = {time:.1f} s")
        self._canvas.restore_region(self._background)
        for artist in self._moving:
            self.figure.draw_artist(artist)
        return np.array(np.asarray(self._canvas.buffer_rgba())[..., :3])


def _extent(runs: Sequence[Run]) -> tuple[float, float, float]:
    """Return how far a picture must reach to either side of the middle, below and above the cart, m."""
    halves, lows, highs = [], [], []
    for run in runs:
        reach, place = _reach(run.rig), positions(run.x, run.rig.params)
        sides = [place.x_joint, place.x_tip, np.array([run.rig.track_limit + 0.1 * reach])]
        halves.append(max(float(np.nanmax(np.abs(side))) for side in sides) + 0.05 * reach)
        lows.append(max(0.12 * reach, 0.05 * reach - float(np.nanmin(np.minimum(place.y_joint, place.y_tip)))))
        highs.append(1.05 * reach)
    return max(halves), max(lows), max(highs)


def _inches(width: int, height: int) -> tuple[float, float]:
    """Return the size of a figure of so many pixels; matplotlib rounds down, so a hair is added."""
    return (width + 1e-6) / _DPI, (height + 1e-6) / _DPI


def _open_window(pixels: Pixels) -> tuple[Figure, Any]:
    """Return the figure and the image of a window opened on pixels."""
    from matplotlib import pyplot

    height, width, _ = pixels.shape
    try:
        figure = pyplot.figure(figsize=_inches(width, height), dpi=_DPI)
    except ImportError as error:  # the backend that was asked for does not run here
        raise RuntimeError(_NO_WINDOW.format(pyplot.get_backend())) from error
    if figure.canvas.required_interactive_framework is None:
        pyplot.close(figure)
        raise RuntimeError(_NO_WINDOW.format(pyplot.get_backend()))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.axis("off")
    image = axes.imshow(pixels)
    figure.show()
    return figure, image


class Plot(Figure):
    """A figure that notebooks show, and that :meth:`show` opens in a window; it belongs to the caller alone."""

    def savefig(self, fname: Any, **options: Any) -> None:  # type: ignore[override]
        """Write the figure as matplotlib does; a file to its end or not at all."""
        if not isinstance(fname, str | Path):
            super().savefig(fname, **options)
            return
        path = Path(fname)
        with archive.atomic(path if path.suffix else path.with_suffix(f".{options.get('format', 'png')}")) as part:
            super().savefig(part, **options)

    def _repr_png_(self) -> bytes:
        file = io.BytesIO()
        self.savefig(file, format="png")
        return file.getvalue()

    def show(self, warn: bool = True) -> None:
        """Show the figure: in the notebook, or in a window until that is closed.

        Parameters
        ----------
        warn : bool
            Whether to warn where there is neither.
        """
        ipython = sys.modules.get("IPython")
        if ipython is not None and hasattr(ipython.get_ipython(), "kernel"):
            importlib.import_module("IPython.display").display(self)
            return
        pixels = np.asarray(Image.open(io.BytesIO(self._repr_png_())).convert("RGB"))
        try:
            _open_window(pixels)
        except RuntimeError:
            if warn:
                warnings.warn(
                    "There is no window to show the figure in: figure.savefig(path) writes it. With a display,"
                    " install the extra `gui` (python -m pip install 'dpend[gui]').",
                    stacklevel=2,
                )
            return
        from matplotlib import pyplot

        pyplot.show()


class Film(_Path):
    """The path of a film, which notebooks play."""

    def _repr_html_(self) -> str:
        kind = "video/mp4" if self.suffix.lower() == ".mp4" else "image/gif"
        source = f"data:{kind};base64,{base64.b64encode(self.read_bytes()).decode()}"
        return f'<video controls loop src="{source}"></video>' if kind == "video/mp4" else f'<img src="{source}">'


def plot_run(run: Run) -> Plot:
    """Return a run drawn against time: position, angles, their rates, the force as it was held, and pushes if any.

    The ends of the track and the limit of the force are drawn where the signal comes near them, and named either way.
    The figure is 16 cm wide.
    """
    pushes = {label: run.log[name] for name, label in PUSHES.items() if np.any(np.nan_to_num(run.log.get(name, 0.0)))}
    figure = Plot(figsize=(6.3, 9.0 if pushes else 7.6), layout="constrained")
    panels = cast("list[Axes]", list(figure.subplots(6 if pushes else 5, 1, sharex=True)))
    labels = ("position [m]", "angles [rad]", "velocity [m/s]", "rates [rad/s]", "force [N]", "pushes")
    dot = "o" if len(run.t) == 1 else ""  # a line through one point cannot be seen
    for axes, label, columns in zip(panels, labels, ((0,), (1, 2), (3,), (4, 5), (), ()), strict=False):
        styles = [(DARK, "-", "cart")] if len(columns) == 1 else [(BLUE, "-", "link 1"), (VERMILLION, "--", "link 2")]
        for column, (color, style, name) in zip(columns, styles, strict=False):
            axes.plot(run.t, run.x[:, column], style, color=color, label=name, lw=1.4, marker=dot)
        axes.set_ylabel(label)
        axes.yaxis.set_major_locator(MaxNLocator(4, steps=_STEPS))
        axes.grid(color="0.9")
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    if len(run.u):
        panels[4].stairs(run.u, run.t, baseline=None, color=GREEN, lw=1.4, zorder=3, label="applied")
    for (label, push), color, style in zip(pushes.items(), (DARK, BLUE, VERMILLION), ("-", "-", "--"), strict=False):
        panels[5].stairs(push, run.t, baseline=None, color=color, ls=style, lw=1.4, label=label)
    _draw_limit(panels[0], run.x[:, 0], float(run.rig.track_limit), "track end ±{:g} m")
    _draw_limit(panels[4], run.u, float(run.rig.force_limit), "limit ±{:g} N")
    for axes in panels:
        if axes.get_legend_handles_labels()[0]:
            axes.legend(loc="lower right", bbox_to_anchor=(1, 0.97), ncols=2, frameon=False, fontsize="small")
    figure.align_ylabels(panels)
    panels[-1].set_xlabel("time [s]")
    figure.suptitle("\n".join(textwrap.fill(line, 60) for line in run.title.splitlines()), fontsize="medium")
    return figure


def _draw_limit(axes: Axes, signal: Array, limit: float, label: str) -> None:
    """Draw both limits; where the signal stays far from them they stay out of view, so as not to flatten it."""
    if not math.isfinite(limit):
        return
    near = np.abs(signal[np.isfinite(signal)]).max(initial=0.0) > limit / 4
    low, high = (-1.08 * limit, 1.08 * limit) if near else axes.get_ylim()
    for sign in (1, -1):
        axes.axhline(sign * limit, color=GREY, ls=":", lw=1.4, label=label.format(limit) if sign == 1 else None)
    axes.set_ylim(low, high)


def draw_strobe(axes: Axes, x: npt.ArrayLike, rig: Rig, *, pictures: int = 16) -> None:
    """Draw a motion as a strobe light shows it: cart and links at equal intervals, later ones darker; the tip's path.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        Where; it is given equal scales, and the track where that has an end.
    x : array_like (T + 1, 6)
        States at equal intervals of time.
    rig : Rig
        One rig.
    pictures : int
        How many states to show, the first and the last among them; at least 2.

    Raises
    ------
    ValueError
        If a state is not finite, the rig describes several rows, or fewer than 2 pictures are asked for.
    """
    single_rig(rig, "A picture")
    if pictures < 2:
        raise ValueError(f"pictures must be at least 2; got {pictures!r}.")
    states = as_states(x)
    place = positions(states, rig.params)
    reach = float(rig.params.length1 + rig.params.length2)
    track = float(rig.track_limit)
    if math.isfinite(track):
        axes.plot([-track, track], [0, 0], color=GREY, lw=1.5, zorder=1)
        axes.plot([-track, track], [0, 0], color=GREY, ls="", marker="|", ms=8, mew=2, zorder=1)
    across = np.stack([states[:, 0], place.x_joint, place.x_tip], axis=1)
    up = np.stack([np.zeros(len(states)), place.y_joint, place.y_tip], axis=1)
    axes.plot(across[:, 2], up[:, 2], color=GREY, lw=0.7, zorder=2)
    for order, k in enumerate(np.linspace(0, len(states) - 1, pictures).round().astype(int)):
        age = 0.15 + 0.85 * order / (pictures - 1)
        look: dict[str, Any] = {"alpha": age**1.5, "zorder": 3 + order}
        for link, color in ((slice(0, 2), BLUE), (slice(1, 3), VERMILLION)):
            axes.plot(across[k, link], up[k, link], color=color, lw=2.2, solid_capstyle="round", **look)
        axes.plot(across[k, 0], 0, color=DARK, marker="s", ms=4, mew=0, **look)
    axes.set(aspect="equal", ylim=(-1.1 * reach, 1.1 * reach))


def animate_run(run: Run, path: str | Path, *, fps: float = 25, speed: float = 1.0) -> Film:
    """Return the path of a film of a run, with time and force above the picture, as ``Run.animate`` says.

    Each picture shows the run's last sample before that moment.  A GIF counts in hundredths of a second and shows at
    most 50 pictures in one, so it takes the nearest that it can hold.
    """
    speed = checked_positive("speed", speed, "seconds of the run per second")

    def drawn(fps: float) -> tuple[Iterator[Pixels], Pixels]:
        picture = Picture(run.rig)
        return _frames(run, picture, speed / fps), picture.rgb([0.0, 0.5, -1.0, 0.0, 0.0, 0.0], force=1e6)

    return _film(path, fps, drawn)


def animate_scenes(scenes: Sequence[Scene], path: str | Path, *, fps: float = 25, speed: float = 1.0) -> Film:
    """Return the path of a film of scenes, one after the other, each held for a moment at its end.

    Parameters
    ----------
    scenes : sequence of Scene
        All of one size: as many pixels for the pendulums.
    path, fps, speed
        See :meth:`dpend.Run.animate`, also for what is raised.

    Raises
    ------
    ValueError
        Beside that, if there is no scene, or they differ in size.
    """
    rooms = sorted({scene.room for scene in scenes})
    if len(rooms) != 1:
        raise ValueError(
            "A film takes scenes of one size, at least one: give all the same room; "
            f"got {', '.join(map(str, rooms)) or 'none'}."
        )
    speed = checked_positive("speed", speed, "seconds of the run per second")

    def drawn(fps: float) -> tuple[Iterator[Pixels], Pixels]:
        some = [scene.rgb(part * scene.seconds) for scene in scenes for part in np.linspace(0, 1, 6)]
        return (picture for scene in scenes for picture in _scene_frames(scene, speed / fps, fps)), np.concatenate(some)

    return _film(path, fps, drawn)


def _scene_frames(scene: Scene, step: float, fps: float) -> Iterator[Pixels]:
    for time in np.arange(0, scene.seconds, step):
        yield scene.rgb(float(time))
    last = scene.rgb(scene.seconds)
    for _ in range(round(_HOLD * fps) + 1):
        yield last


def _film(path: str | Path, fps: float, drawn: Callable[[float], tuple[Iterator[Pixels], Pixels]]) -> Film:
    """Write what is drawn at so many pictures a second: frames, and a picture with all their colours."""
    path = checked_path("path", path)
    suffix = path.suffix.lower()
    if suffix not in (".gif", ".mp4"):
        raise ValueError(f"The suffix chooses the format: expected a path ending in .gif or .mp4; got {str(path)!r}.")
    fps = checked_positive("fps", fps, "pictures per second")
    ffmpeg = find_ffmpeg() if suffix == ".mp4" else ""
    if suffix == ".gif":
        centiseconds = min(max(round(100 / fps), 2), 65535)  # players slow down what is shorter, the format ends there
        fps = 100 / centiseconds
    if path.is_dir():
        raise IsADirectoryError(f"Cannot write the film: {path} is a folder.")
    with archive.atomic(path) as part:
        part.touch()
        frames, colorful = drawn(fps)
        if suffix == ".gif":
            _write_gif(part, frames, colorful, milliseconds=round(1000 / fps))
        else:
            _write_mp4(part, frames, fps, ffmpeg)
    return Film(path)


def _frames(run: Run, picture: Picture, step: float) -> Iterator[Pixels]:
    """Draw the run every ``step`` seconds, and at its end: each time the last sample that was not in the future."""
    duration = run.t[-1] - run.t[0]
    if duration / step > _MOST_FRAMES:
        raise ValueError(f"The film would have more than {_MOST_FRAMES} pictures: lower fps, or raise speed.")
    times = run.t[0] + np.minimum(step * np.arange(math.ceil(duration / step - 1e-6) + 1), duration)
    for sample in (_sample_at(run, float(time)) for time in times):
        force = float(run.u[min(sample, len(run.u) - 1)]) if len(run.u) else 0.0
        yield picture.rgb(run.x[sample], force if math.isfinite(force) else 0.0, time=float(run.t[sample]))


def _sample_at(run: Run, time: float) -> int:
    """Return the last sample that is not after a time."""
    sample = int(np.searchsorted(run.t, time + 1e-6 * run.rig.sample_time, side="right")) - 1
    return min(
        sample, int(np.flatnonzero(np.isfinite(run.x).all(axis=1))[-1])
    )  # without numbers there is no last state


def _write_gif(path: Path, frames: Iterable[Pixels], colorful: Pixels, milliseconds: int) -> None:
    """Write frames as a GIF that loops, all with the one palette of a picture that has every colour in it."""
    counted = cast("list[tuple[int, tuple[int, int, int]]]", Image.fromarray(colorful).getcolors(1 << 24))
    commonest: dict[tuple[int, int, int], tuple[int, int, int]] = {}  # of colours that hardly differ
    for _, (r, g, b) in sorted(counted, reverse=True):
        commonest.setdefault((r // 8, g // 8, b // 8), (r, g, b))
    palette = Image.new("P", (1, 1))
    palette.putpalette([channel for color in [*commonest.values()][:256] for channel in color])
    images = (Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames)
    with path.open("wb") as file:
        next(images).save(file, "GIF", save_all=True, append_images=images, duration=milliseconds, loop=0)


def find_ffmpeg() -> str:
    """Return ffmpeg's path, from the system or from the package imageio-ffmpeg; a RuntimeError if there is none."""
    system = shutil.which("ffmpeg")
    if system is not None:
        return system
    try:
        return importlib.import_module("imageio_ffmpeg").get_ffmpeg_exe()
    except (ImportError, RuntimeError) as error:
        raise RuntimeError(
            "Writing an MP4 needs ffmpeg, which was not found: install it, for instance with "
            "python -m pip install imageio-ffmpeg, or write a .gif."
        ) from error


def _write_mp4(path: Path, frames: Iterable[Pixels], fps: float, ffmpeg: str) -> None:
    """Pipe frames through ffmpeg, with its own choice of encoder and colours that every player knows."""
    frames = iter(frames)
    first = next(frames)
    height, width, _ = first.shape
    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-framerate", f"{fps:.9g}", "-i", "-"]
    mp4 = ["-pix_fmt", "yuv420p", "-movflags", "+faststart", "-f", "mp4", "-y", str(path.absolute())]
    command = [ffmpeg, "-loglevel", "error", *raw, *mp4]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    assert process.stdin is not None
    with process:
        with contextlib.suppress(BrokenPipeError):  # a pipe breaks when ffmpeg gives up; it says why
            process.stdin.write(first.tobytes())
            for frame in frames:
                process.stdin.write(frame.tobytes())
        _, message = process.communicate()
    if process.returncode:
        raise RuntimeError(f"ffmpeg could not write the film: {message.decode(errors='replace').strip()}")
