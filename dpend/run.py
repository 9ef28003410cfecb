"""Records of runs: what happened, how it ended, what it is worth; saved as plain arrays."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self, cast, overload

import numpy as np
import numpy.typing as npt

from . import archive
from .metrics import force_metrics, smoothness_metrics
from .params import Array
from .rig import Rig, as_rig
from .state import wrap
from .status import Status

if TYPE_CHECKING:
    from .draw import Film, Plot

Layout = dict[str, tuple[tuple[int, ...], type]]

_LOG = "log "  # before the names of a log in a file, which nothing else there has
_NO_STATES = "These runs hold no states; simulate them with record=True."


@dataclass(frozen=True, kw_only=True, eq=False)
class _Record:
    """What one run and many have in common, and the file that keeps either: plain arrays, so that none can run code."""

    _FORMAT: ClassVar[str]
    _OPTIONAL: ClassVar[tuple[str, ...]] = ()
    t: Array
    u: Array
    step_time: Array
    rig: Rig
    controller: str
    task: str
    seed: int
    log: Mapping[str, Array] = field(default_factory=dict)

    def save(self, path: str | Path) -> Path:
        """Write a compressed ``.npz`` and return its path; ``.npz`` is added where the name has no suffix."""
        layout = self._layout(*self.u.shape)
        about = {each.name: getattr(self, each.name) for each in fields(self) if each.name not in {"log", *layout}}
        about |= {"rig": self.rig.to_dict()} | ({"status": about["status"].name} if "status" in about else {})
        arrays = {name: vars(self)[name] for name in layout if vars(self)[name] is not None}
        return archive.write(path, self._FORMAT, about, arrays | {_LOG + name: each for name, each in self.log.items()})

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read what :meth:`save` wrote.

        Raises
        ------
        OSError
            If the file is not there or cannot be read.
        ValueError
            If it is something else, or is damaged.
        """
        with archive.opened(path, cls._FORMAT) as (about, arrays):
            forms = {name: (array.shape, array.dtype) for name, array in arrays.items()}
            log = {name.removeprefix(_LOG): arrays.pop(name) for name in forms if name.startswith(_LOG)}
            layout = cls._layout(*arrays["u"].shape)
            expected = {name: form for name, form in layout.items() if name in arrays or name not in cls._OPTIONAL}
            if forms != expected | {_LOG + name: layout["u"] for name in log}:
                raise ValueError("its arrays have other names, shapes or types")
            about |= {"rig": Rig.from_dict(about["rig"])} | (
                {"status": Status[about["status"]]} if "status" in about else {}
            )
            return cls(**arrays, **about, log=log)

    @classmethod
    def _layout(cls, *shape: int) -> Layout:
        """Return shape and type of each array, by those of the forces."""
        *n, samples = shape
        states = (*n, samples + 1, 6)
        shapes = {"t": (samples + 1,), "x": states, "y": states, "u": shape, "step_time": shape}
        return {name: (each, np.float64) for name, each in shapes.items()}


class _States:
    """Field of states ``(N, T + 1, 6)``, which says what to do where they were not recorded."""

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, runs: object, owner: type) -> Array:
        if runs is None:
            return cast(Array, None)  # the field's default
        states = vars(runs)[self._name]
        if states is None:
            raise AttributeError(_NO_STATES)
        return states

    def __set__(self, runs: object, states: Array | None) -> None:
        vars(runs)[self._name] = states


@dataclass(frozen=True, kw_only=True, eq=False)
class Run(_Record):
    """One run, cut at its end; ``T`` samples.

    Arrays are read-only views of what was recorded; nothing is computed anew but what the methods return.

    Parameters
    ----------
    t : ndarray (T + 1,)
        Times of the samples, s.
    u : ndarray (T,)
        Forces applied over each sample, N.
    step_time : ndarray (T,)
        Seconds that the controller took for each.
    rig : Rig
        The true rig.
    controller, task : str
        What ran, in words.
    seed : int
        What its disturbances were drawn from, with ``row``.
    log : mapping of str to ndarray (T,)
        What the controller logged of each of its steps, such as a solver's iterations.
    x, y : ndarray (T + 1, 6)
        True and measured states.
    status : Status
        How the run ended.
    success : bool
        Whether it did what its task asks.
    time_up : float
        When both links were up for good, s; NaN where they never were, or the task does not ask.
    row : int
        Its number in the batch.

    See Also
    --------
    dpend.simulate : Make one.
    dpend.Runs : Many side by side.

    Examples
    --------
    >>> import dpend
    >>> rig = dpend.rig("gustafsson2016")
    >>> run = dpend.simulate(rig, lambda t, x: 0.0, [0, 0.1, 0.1, 0, 0, 0])
    >>> run.status.value
    'Link 1 fell: it leans by more than a quarter turn.'
    """

    _FORMAT = "dpend run 1"
    x: Array
    y: Array
    status: Status
    success: bool
    time_up: float
    row: int = 0

    def __repr__(self) -> str:
        return f"<run of {self.controller}, {self.t[-1]:g} s: {self.status.value}>"

    def metrics(self) -> dict[str, float]:
        """Return the run's figures of merit; their units are in ``dpend.metrics.UNITS``.

        They do not depend on the rate of recording.

        Returns
        -------
        dict of str to float
            ``success``, ``time_up``, ``travel`` and those of the force.

        See Also
        --------
        dpend.Run.smoothness : What asks for two numbers.
        dpend.metrics.UNITS : The units.

        Examples
        --------
        >>> import dpend
        >>> rig = dpend.rig("gustafsson2016")
        >>> run = dpend.simulate(rig, lambda t, x: 0.0, [0, 0.1, 0.1, 0, 0, 0])
        >>> run.metrics()["effort"]
        0.0
        """
        of_force = force_metrics(
            self.u[None], self.rig.sample_time, self.rig.force_limit, force_noise=self.rig.force_noise
        )
        return {
            "success": float(self.success),
            "time_up": self.time_up,
            "travel": float(np.fmax.reduce(np.abs(self.x[:, 0]))),
        } | {name: float(value[0]) for name, value in of_force.items()}

    def smoothness(self, *, lag: float = 0.01, cutoff: float = 5.0) -> dict[str, float]:
        """Return ``slew``, ``spectral_share``, ``caps_sm`` and ``std_step`` of the force.

        They tell a quiet force from a restless one of the same effort.

        Parameters
        ----------
        lag : float
            Time constant of the lag after which the force's rate of change is measured, s.
        cutoff : float
            Frequency above which the share of the force's power is measured, Hz.

        Returns
        -------
        dict of float
            What :func:`dpend.metrics.smoothness_metrics` says of each; units are in ``dpend.metrics.UNITS``.

        Raises
        ------
        ValueError
            If ``lag`` or ``cutoff`` is not a finite number greater than zero.

        See Also
        --------
        dpend.Run.metrics : Success, effort, variation.

        Examples
        --------
        >>> import dpend
        >>> rig = dpend.rig("gustafsson2016")
        >>> run = dpend.simulate(rig, lambda t, x: 0.0, [0, 0.1, 0.1, 0, 0, 0])
        >>> run.smoothness()["slew"]
        0.0
        """
        measured = smoothness_metrics(self.u[None], self.rig.sample_time, self.rig.force_limit, lag=lag, cutoff=cutoff)
        return {name: float(value[0]) for name, value in measured.items()}

    @property
    def title(self) -> str:
        """What ran and how it ended; where there was a task, whether it was done, and since when both links were up."""
        since = f": both links up after {self.time_up:.2f} s" if np.isfinite(self.time_up) else ""
        judged = np.isfinite(self.time_up) or (self.task != "None" and not self.success)
        verdict = f"\n{'Success' if self.success else 'No success'}{since}." if judged else ""
        return f"{self.controller}\n{self.status.value}{verdict}"

    def _repr_html_(self) -> str:
        picture = base64.b64encode(self.plot()._repr_png_()).decode()
        words = html.escape(f"{self.title}\n{self.t[-1]:g} s on {self.task}").replace("\n", "<br>")
        return f'<p>{words}</p><img width="480" src="data:image/png;base64,{picture}">'

    def show(self) -> None:
        """Show :meth:`plot`: in the notebook, or in a window until that is closed.

        Without a display it draws nothing.

        See Also
        --------
        dpend.Run.plot : The figure itself.

        Examples
        --------
        >>> import dpend
        >>> rig = dpend.rig("gustafsson2016")
        >>> run = dpend.simulate(rig, lambda t, x: 0.0, [0, 0.1, 0.1, 0, 0, 0])
        >>> run.show()  # doctest: +SKIP
        """
        self.plot().show()

    def plot(self) -> Plot:
        """Return position, angles, rates and force drawn against time, and pushes where there were any.

        It is drawn without a global figure, so that nothing has to be closed.

        Returns
        -------
        matplotlib.figure.Figure
            Notebooks show it; ``figure.savefig(path)`` writes it, ``figure.show()`` opens a window.

        See Also
        --------
        dpend.Run.animate : A film.

        Examples
        --------
        >>> import dpend
        >>> rig = dpend.rig("gustafsson2016")
        >>> run = dpend.simulate(rig, lambda t, x: 0.0, [0, 0.1, 0.1, 0, 0, 0])
        >>> figure = run.plot()
        >>> len(figure.axes) >= 3
        True
        """
        from .draw import plot_run

        return plot_run(self)

    def animate(self, path: str | Path, *, fps: float = 25, speed: float = 1.0) -> Film:
        """Return the path of an animation, written there: a GIF, or an MP4 where ffmpeg is there.

        Time and force stand above the picture.

        Parameters
        ----------
        path : str or Path
            Where to; the suffix, ``.gif`` or ``.mp4``, chooses the format.
        fps : float
            Pictures per second; a GIF takes the nearest that it can hold, at most 50, and plays at the right speed all
            the same.
        speed : float
            Seconds of the run in a second of film.

        Returns
        -------
        Film
            The path, which notebooks play; the file appears under its name only when it is complete.

        Raises
        ------
        ValueError
            If the suffix is another, or a number is not greater than zero.
        RuntimeError
            If an MP4 is asked for and there is no ffmpeg, or ffmpeg fails.
        OSError
            If the folder cannot be written to; before anything is drawn.

        See Also
        --------
        dpend.draw.animate_scenes : Several runs side by side.

        Examples
        --------
        >>> import dpend
        >>> rig = dpend.rig("gustafsson2016")
        >>> run = dpend.simulate(rig, lambda t, x: 0.0, [0, 0.1, 0.1, 0, 0, 0])
        >>> run.animate("run.gif")  # doctest: +SKIP
        """
        from .draw import animate_run

        return animate_run(self, path, fps=fps, speed=speed)

    @classmethod
    def from_csv(
        cls,
        path: str | Path,
        rig: Rig | str,
        columns: Mapping[str, str | None] | None = None,
        *,
        angle_unit: str | float | Sequence[float] = "rad",
        position_unit: float = 1.0,
        force_unit: float = 1.0,
        time_unit: str | float = "s",
        zero: str = "up",
        relative: bool = False,
        clamped: bool = False,
        tolerance: float = 0.01,
        resample: bool = False,
        any_size: bool = False,
    ) -> Run:
        r"""Return what a laboratory recorded: a table with a line of column names, then one line a sample.

        A line holds the time, what was measured then, and the force from then on; commas, semicolons, tabs, bars or
        blanks separate its cells.  Decimal signs are points or commas, the text is Unicode or of a Windows code page.
        What is measured stands in ``y``, and in ``x`` too, for want of anything better.  ``success`` says whether
        neither link ever leaned by more than a quarter turn.

        Parameters
        ----------
        path : str or Path
            The file.
        rig : Rig or str
            The rig as it is known so far; its sample time is that of the table.
        columns : mapping of str to str, optional
            Headings of ``"t"``, ``"pos"``, ``"th1"``, ``"th2"`` and of ``"u"``, the force on the cart, or
            ``"command"``, the force asked for, of which the rig's actuator (delay, limit, lag) makes the force; where
            the file calls them so, leave them out.  ``{"u": None}`` says that no force acted.
            ``"vel"``, ``"om1"``, ``"om2"`` are taken where they are there; else they are slopes of parabolas through
            seven samples.
        angle_unit : {"rad", "deg"}, float, or two floats
            Radians in a unit of the angles, such as ``2 * pi / 4096`` for encoder counts; negative where the encoder
            counts the other way, a pair where the two differ.  Jumps of a whole turn are undone.
        position_unit, force_unit : float
            Metres and newtons in a unit of position and force; negative where the direction is the other.
        time_unit : {"s", "ms", "us"} or float
            Seconds in a unit of the times.
        zero : {"up", "down"}
            Where the angles are zero.
        relative : bool
            Whether the second angle is that of link 2 against link 1, and its rate too.
        clamped : bool
            Whether the cart was held fast: it stands at 0, and neither its position nor a force is read.
        tolerance : float
            Share of the sample time by which the times may depart from a uniform clock.
        resample : bool
            Take any increasing times, and return the motion on the rig's clock: states by cubic splines, forces by
            their mean over each sample.
        any_size : bool
            Accept numbers that look like those of another unit.

        Raises
        ------
        OSError
            If the file cannot be read.
        TypeError
            If ``rig`` is no rig.
        ValueError
            If a column is missing, a cell holds no number, the clock is not uniform or not the rig's, an argument is
            none of those above, or the numbers look like another unit's: whole-numbered radians, or angles, rates,
            positions or forces beyond what such a rig is likely to see.
        """
        from .recording import read_recording

        rig = as_rig(rig)
        t, x, u = read_recording(
            path,
            rig,
            columns,
            angle_unit,
            position_unit,
            force_unit,
            time_unit,
            zero,
            relative,
            clamped,
            tolerance,
            resample,
            any_size,
        )
        return cls(
            t=t,
            x=x,
            y=x.copy(),
            u=u,
            step_time=np.full(len(u), np.nan),
            status=Status.FULL_LENGTH,
            success=bool((np.abs(wrap(x[:, 1:3])) <= np.pi / 2).all()),
            time_up=float("nan"),
            rig=rig,
            controller="a recording",
            task="None",
            seed=0,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Runs(_Record):
    """``N`` runs side by side; NaN after the end of each.

    ``runs[i]`` is one of them as a :class:`Run`, where states were recorded.

    Parameters
    ----------
    t : ndarray (T + 1,)
        Times of the samples, s.
    u : ndarray (N, T)
        Forces applied over each sample, N.
    step_time : ndarray (N, T)
        Seconds that the controller took for each; a batched law's time is shared equally
        among all rows, and counts on until the last of its batch has ended.
    rig : Rig
        The true rig or rigs.
    controller, task : str
        What ran, in words.
    seed : int
        What the disturbances were drawn from, with ``first_row``.
    log : mapping of str to ndarray (N, T)
        What the controller logged of each of its steps, such as a solver's iterations.
    steps : ndarray (N,)
        Samples that each run lasted.
    codes : ndarray (N,)
        How each ended, as ``Status.code``; ``status`` gives the members themselves.
    success : ndarray (N,)
        Whether each did what its task asks.
    final : ndarray (N, 6)
        The true state at each end.
    travel : ndarray (N,)
        Greatest distance of the cart from the middle, m.
    time_up : ndarray (N,)
        When both links were up for good, s; NaN where they never were, or the task does not ask.
    first_row : int
        Number of the first row.
    x, y : ndarray (N, T + 1, 6)
        True and measured states, where they were recorded; AttributeError elsewhere.

    See Also
    --------
    dpend.simulate_many : Make them.
    dpend.Run : One.

    Examples
    --------
    >>> import numpy as np
    >>> import dpend
    >>> rig = dpend.rig("gustafsson2016")
    >>> runs = dpend.simulate_many(rig, lambda t, x: 0.0, np.zeros((3, 6)), duration=0.1, record=True)
    >>> len(runs), runs[0].success
    (3, True)
    """

    _FORMAT = "dpend runs 1"
    _OPTIONAL = ("x", "y")
    steps: npt.NDArray[np.int64]
    codes: npt.NDArray[np.uint8]
    success: npt.NDArray[np.bool_]
    final: Array
    travel: Array
    time_up: Array
    first_row: int = 0
    x: _States = _States()
    y: _States = _States()

    def __len__(self) -> int:
        return len(self.u)

    def __iter__(self) -> Iterator[Run]:
        return (self[row] for row in range(len(self)))

    @property
    def status(self) -> list[Status]:
        """How each run ended."""
        members = list(Status)
        return [members[code] for code in self.codes]

    def metrics(self) -> dict[str, Array]:
        """Return every run's figures of merit, each ``(N,)``; their units are in ``dpend.metrics.UNITS``.

        They are there whether or not states were recorded.

        Returns
        -------
        dict of str to ndarray (N,)
            The same names as of one run.

        See Also
        --------
        dpend.Run.metrics : Of one run.

        Examples
        --------
        >>> import numpy as np
        >>> import dpend
        >>> rig = dpend.rig("gustafsson2016")
        >>> runs = dpend.simulate_many(rig, lambda t, x: 0.0, np.zeros((3, 6)), duration=0.1)
        >>> runs.metrics()["effort"]
        array([0., 0., 0.])
        """
        return {
            "success": self.success.astype(np.float64),
            "time_up": self.time_up,
            "travel": self.travel,
        } | force_metrics(self.u, self.rig.sample_time, self.rig.force_limit, force_noise=self.rig.force_noise)

    def smoothness(self, *, lag: float = 0.01, cutoff: float = 5.0) -> dict[str, Array]:
        """Return ``slew``, ``spectral_share``, ``caps_sm`` and ``std_step`` of every run's force, each ``(N,)``.

        They stand apart from :meth:`metrics` because they ask for two numbers and take as long as all the others.

        Parameters
        ----------
        lag : float
            Time constant of the lag after which the force's rate of change is measured, s.
        cutoff : float
            Frequency above which the share of the force's power is measured, Hz.

        Returns
        -------
        dict of str to ndarray (N,)
            The same names as of one run.

        See Also
        --------
        dpend.Run.smoothness : Of one run.

        Examples
        --------
        >>> import numpy as np
        >>> import dpend
        >>> rig = dpend.rig("gustafsson2016")
        >>> runs = dpend.simulate_many(rig, lambda t, x: 0.0, np.zeros((3, 6)), duration=0.1)
        >>> runs.smoothness()["slew"]
        array([0., 0., 0.])
        """
        return smoothness_metrics(self.u, self.rig.sample_time, self.rig.force_limit, lag=lag, cutoff=cutoff)

    @overload
    def __getitem__(self, row: int) -> Run: ...
    @overload
    def __getitem__(self, row: slice) -> Runs: ...
    def __getitem__(self, row: int | slice) -> Run | Runs:
        """Return one recorded run, cut at its end; or, of a slice such as ``[1:3]``, some runs side by side.

        Raises
        ------
        TypeError
            If the row is no whole number.
        IndexError
            If there is no such row.
        ValueError
            If the states were not recorded, or a slice is empty or leaves rows out in between.
        """
        if isinstance(row, slice):
            return self._part(range(len(self))[row])
        if isinstance(row, bool) or not isinstance(row, int | np.integer):
            raise TypeError(
                f"A run is taken out by a whole number, several by a slice: runs[0], runs[1:3]; got {row!r}."
            )
        if not hasattr(self, "x"):
            raise ValueError(_NO_STATES)
        row = range(len(self))[row]
        steps = int(self.steps[row])
        return Run(
            t=self.t[: steps + 1],
            x=self.x[row, : steps + 1],
            y=self.y[row, : steps + 1],
            u=self.u[row, :steps],
            step_time=self.step_time[row, :steps],
            status=list(Status)[self.codes[row]],
            success=bool(self.success[row]),
            time_up=float(self.time_up[row]),
            rig=self.rig.rows(row),
            controller=self.controller,
            task=self.task,
            seed=self.seed,
            row=self.first_row + row,
            log={name: values[row, :steps] for name, values in self.log.items()},
        )

    def _part(self, rows: range) -> Runs:
        if rows.step != 1 or not rows:
            raise ValueError(
                f"A slice of runs must hold at least one, and neighbours only; got rows {list(rows)} of {len(self)}. "
                "Take others one by one: [runs[i] for i in ...]."
            )
        cut = slice(rows.start, rows.stop)
        arrays = {name: vars(self)[name] for name in self._layout(1, 1) if name != "t"}
        return replace(
            self,
            rig=self.rig.rows(cut),
            first_row=self.first_row + rows.start,
            log={name: values[cut] for name, values in self.log.items()},
            **{name: None if array is None else array[cut] for name, array in arrays.items()},
        )

    @classmethod
    def _layout(cls, *shape: int) -> Layout:
        n = shape[:1]
        return super()._layout(*shape) | {
            "steps": (n, np.int64),
            "codes": (n, np.uint8),
            "success": (n, np.bool_),
            "final": ((*n, 6), np.float64),
            "travel": (n, np.float64),
            "time_up": (n, np.float64),
        }

    def __repr__(self) -> str:
        saved = int(self.success.sum())
        return f"<{len(self)} runs of {self.controller}, {saved} successful, up to {self.t[-1]:g} s>"

    @classmethod
    def join(cls, parts: list[Runs], rig: Rig) -> Runs:
        """Return the parts of a batch joined, in their order."""
        stacked: dict[str, Any] = {}
        for name in cls._layout(1, 1).keys() - {"t"}:
            arrays = [vars(part)[name] for part in parts]
            stacked[name] = None if arrays[0] is None else np.concatenate(arrays)
        names = dict.fromkeys(name for part in parts for name in part.log)
        log = {
            name: np.concatenate([part.log.get(name, np.full(part.u.shape, np.nan)) for part in parts])
            for name in names
        }
        return replace(parts[0], rig=rig, log=log, **stacked)
