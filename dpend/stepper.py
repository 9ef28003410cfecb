"""The sampled loop around the plant: sensors, actuator, limits, disturbances, one sample at a time."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from .arguments import checked_array, checked_seed, checked_whole
from .params import Array
from .rig import Rig, as_rig
from .state import as_states

Rows = npt.NDArray[Any] | slice

_ALL = slice(None)


def row_sequence(seed: int, row: int, stream: int) -> np.random.SeedSequence:
    """Return the seed of one stream of one row: the same whatever the batch, its order or the controller."""
    return np.random.SeedSequence(seed, spawn_key=(row, stream))


# What each stream of a row is for.
SENSOR_STREAM, FORCE_STREAM, CONTROLLER_STREAM = range(3)


def checked_push(push: npt.ArrayLike, n: int) -> Array:
    """Return pushes as an array ``(3,)`` or ``(n, 3)``; refuse other shapes."""
    array = checked_array("A push", push, "a force in N and torques in N m, (3,)", finite=False)
    if array.shape not in ((3,), (n, 3)):
        raise ValueError(
            "A push is a force on the cart in N and torques on link 1 and link 2 in N m: "
            f"expected shape (3,) or ({n}, 3); got shape {array.shape}."
        )
    return array


def checked_forces(u: npt.ArrayLike, n: int) -> Array:
    """Return commanded forces as a new array ``(n,)``; refuse what is not one number a row."""
    try:
        forces = np.asarray(u)
    except (TypeError, ValueError, OverflowError):
        forces = np.asarray(None)
    if forces.dtype.kind not in "biuf":
        raise ValueError(f"Expected one force per row, shape ({n},); got {u!r}.")
    if forces.shape != (n,):
        column = " A law written as y @ K.T returns a column: take [:, 0]." if forces.shape == (n, 1) else ""
        raise ValueError(f"Expected one force per row, shape ({n},); got shape {forces.shape}.{column}")
    return np.array(forces, dtype=np.float64)


class _RowNoise:
    """Standard normal numbers ``(n, width)``, one independent stream a row, drawn ahead in chunks."""

    CHUNK = 64

    def __init__(self, seed: int, rows: range, stream: int, width: int) -> None:
        self._generators = [np.random.default_rng(row_sequence(seed, row, stream)) for row in rows]
        self._ahead = np.empty((len(rows), self.CHUNK, width))
        self._used = np.full(len(rows), self.CHUNK)

    def draw(self, rows: Rows = _ALL) -> Array:
        chosen = np.arange(len(self._used))[rows]
        for row in chosen[self._used[chosen] == self.CHUNK]:
            self._generators[row].standard_normal(out=self._ahead[row])
            self._used[row] = 0
        numbers = self._ahead[chosen, self._used[chosen]]
        self._used[chosen] += 1
        return numbers


class _DelayLine:
    """Values ``(n, width)`` that come out a whole number of samples after they went in."""

    def __init__(self, delay: int | npt.NDArray[np.int64], n: int, width: int) -> None:
        self._delay = np.broadcast_to(delay, n)
        self._rows = np.arange(n)
        self._slots = np.zeros((int(np.max(delay)) + 1, n, width))
        self._now = 0

    def fill(self, value: npt.ArrayLike, rows: Rows = _ALL) -> None:
        self._slots[:, rows] = value

    def pass_on(self, value: Array) -> Array:
        self._now = (self._now + 1) % len(self._slots)
        self._slots[self._now] = value
        return self._slots[(self._now - self._delay) % len(self._slots), self._rows]


class Stepper:
    r"""``n`` copies of a rig, moved one sample at a time: the only place where the plant advances.

    One sample is, in this order: the state is sampled, rounded, given noise and delayed (:meth:`reset` and
    :meth:`step` return it); the caller acts; :meth:`step` delays the command, limits it, lags it, adds noise, and moves
    the plant under the force held.

    Parameters
    ----------
    rig : Rig
        The rig, with fields for ``n`` rows or shared by all.
    n : int
        Number of rows.
    seed : int
        Row ``i`` draws from ``SeedSequence(seed, spawn_key=(first_row + i, stream))``, whatever else runs beside it.
    first_row : int
        Number of the first row, where a batch is cut into parts.

    Attributes
    ----------
    x : ndarray (n, 6)
        The true states; overwritten by each step.
    force : ndarray (n,)
        The forces last applied, N.

    Raises
    ------
    TypeError, ValueError
        If the rig describes another number of rows, or a number is no whole one.

    See Also
    --------
    dpend.simulate_many : A loop over it.
    dpend.env.CartDoublePendulumEnv : Another.

    Examples
    --------
    >>> import dpend
    >>> rig = dpend.rig("gustafsson2016")
    >>> stepper = dpend.Stepper(rig, 2, seed=0)
    >>> y = stepper.reset([0, 0.1, 0, 0, 0, 0])
    >>> stepper.step([0.0, 10.0]).shape
    (2, 6)
    """

    def __init__(self, rig: Rig, n: int, seed: int = 0, first_row: int = 0) -> None:
        from .kernels import plant_step  # numba loads with the first stepper, not with `import dpend`

        rig = as_rig(rig)
        n, seed, first_row = checked_whole("n", n), checked_seed("seed", seed), checked_seed("first_row", first_row)
        if rig.n not in (None, n):
            raise ValueError(f"The rig describes {rig.n} rows; expected {n}, or single values shared by all rows.")
        self.rig = rig
        self.n = n
        self.x = np.zeros((n, 6))
        self.force = np.zeros(n)
        self._plant_step = plant_step
        self._substep = rig.sample_time / rig.substeps
        fields = np.broadcast_arrays(*(np.atleast_1d(field) for field in rig.params.coefficients()))
        self._coefficients = np.stack(fields).astype(np.float64)
        self._generalised = np.zeros((3, n))

        rows = range(first_row, first_row + n)
        self._limited = bool(np.any(np.isfinite(rig.force_limit)))
        self._most = np.full(n, rig.force_limit)  # one a row, which numpy compares faster than with a single number
        self._least = -self._most
        self._first_limit = float(self._most[0])
        self._lagged = bool(np.any(rig.actuator_lag))
        with np.errstate(divide="ignore"):
            self._remainder = np.exp(-rig.sample_time / np.asarray(rig.actuator_lag)) if self._lagged else 0.0
        self._drive = np.zeros(n)
        self._commands = _DelayLine(rig.actuator_delay, n, 1) if np.any(rig.actuator_delay) else None
        self._force_noise = _RowNoise(seed, rows, FORCE_STREAM, 1) if np.any(rig.force_noise) else None
        self._readings = _DelayLine(rig.sensor_delay, n, 6) if np.any(rig.sensor_delay) else None
        self._sensor_noise = _RowNoise(seed, rows, SENSOR_STREAM, 6) if np.any(rig.sensor_noise) else None
        self._sensor_std = np.broadcast_to(rig.sensor_noise, (n, 6))
        self._resolution = np.broadcast_to(rig.resolution, (n, 6)) if np.any(rig.resolution) else None

    def reset(self, x0: npt.ArrayLike, rows: Rows | None = None) -> Array:
        """Set all rows, or some, to new states with actuator and sensors at rest.

        Delays are filled with the first measurement and with no force.

        Parameters
        ----------
        x0 : array_like
            States ``(n, 6)``, or ``(len(rows), 6)``, or one state for all.
        rows : ndarray or slice, optional
            Which rows, as indices or a mask; left out, all.

        Returns
        -------
        ndarray
            Measurements of the rows that were reset, ``(n, 6)`` or ``(len(rows), 6)``.

        Raises
        ------
        ValueError
            If the states are not of that shape or not finite.

        See Also
        --------
        dpend.Stepper.step : Move on.

        Examples
        --------
        >>> import dpend
        >>> rig = dpend.rig("gustafsson2016")
        >>> stepper = dpend.Stepper(rig, 2, seed=0)
        >>> stepper.reset([0, 0.1, 0, 0, 0, 0])[:, 1]
        array([0.1, 0.1])
        """
        chosen = _ALL if rows is None else rows
        states = as_states(x0, len(self.force[chosen]))
        self.x[chosen] = states
        self.force = self.force.copy()  # what was handed out before stays as it was
        self.force[chosen] = 0.0
        self._drive[chosen] = 0.0
        if self._commands is not None:
            self._commands.fill(0.0, chosen)
        reading = self._measured(states, chosen)
        if self._readings is not None:
            self._readings.fill(reading, chosen)
        return reading

    def step(self, u: npt.ArrayLike, push: npt.ArrayLike | None = None) -> Array:
        """Move every row by one sample.

        It does not ask whether an episode has ended: that is the task's affair.

        Parameters
        ----------
        u : array_like (n,)
            Commanded forces, N.
        push : array_like, optional
            Generalised forces on cart (N), link 1 and link 2 (N m) that act beside the actuator's, ``(3,)`` or
            ``(n, 3)``.

        Returns
        -------
        ndarray (n, 6)
            Measurements at the end of the sample.

        Raises
        ------
        ValueError
            If the forces, or the pushes, are not of that shape.

        See Also
        --------
        dpend.Stepper.reset : Begin again.

        Examples
        --------
        >>> import dpend
        >>> rig = dpend.rig("gustafsson2016")
        >>> stepper = dpend.Stepper(rig, 2, seed=0)
        >>> y = stepper.reset([0, 0, 0, 0, 0, 0])
        >>> stepper.step([0.0, 10.0])[:, 3].round(2) > 0
        array([False,  True])
        """
        rig = self.rig
        command = checked_forces(u, self.n)
        if self._commands is not None:
            command = self._commands.pass_on(command[:, None])[:, 0]
        if self._limited:
            if self.n != 1:
                np.maximum(command, self._least, out=command)
                np.minimum(command, self._most, out=command)
            elif abs(command.item()) > self._first_limit:  # numpy takes far longer for one number
                command[0] = math.copysign(self._first_limit, command.item())
        if self._lagged:
            command = command + self._remainder * (self._drive - command)  # exact for a row without lag
            self._drive = command.copy()
        if self._force_noise is not None:
            command = command + rig.force_noise * self._force_noise.draw()[:, 0]
        self.force = command
        if push is None:
            self._generalised[0] = command
        else:
            self._generalised.T[:] = checked_push(push, self.n)
            self._generalised[0] += command
        self._plant_step(self.x, self._generalised, self._coefficients, self._substep, rig.substeps)
        if push is not None:
            self._generalised[1:] = 0.0
        reading = self._measured(self.x.copy(), _ALL)
        return reading if self._readings is None else self._readings.pass_on(reading)

    def _measured(self, y: Array, rows: Rows) -> Array:
        """Round the states of some rows, and add noise, in place."""
        if self._resolution is not None:
            step = self._resolution[rows]
            np.divide(y, step, out=y, where=step > 0)
            np.rint(y, out=y, where=step > 0)
            np.multiply(y, step, out=y, where=step > 0)
        if self._sensor_noise is not None:
            y += self._sensor_std[rows] * self._sensor_noise.draw(rows)
        return y
