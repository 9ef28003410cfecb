"""Figures of merit of held force signals: effort, smoothness, saturation.

A held force is a function of time, a staircase, and all but two of these figures are functionals of that function:
recorded five times as often, the same staircase has the same figures.  The exceptions are the two that others publish,
``caps_sm`` and ``std_step``.  ``docs/metrics.md`` derives them all.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np
import numpy.typing as npt

from .arguments import checked_array, checked_positive
from .params import Array

UNITS: Mapping[str, str] = {
    "seconds": "s",
    "time_up": "s",
    "travel": "m",
    "peak_force": "N",
    "effort": "N^2 s",
    "variation": "u_max/s",
    "switches": "1/s",
    "saturated": "share",
    "slew": "u_max/s",
    "spectral_share": "share",
    "caps_sm": "u_max",
    "std_step": "N",
}
"""Unit of each metric; ``u_max`` is the rig's force limit, or one newton where it has none."""

RATE_DEPENDENT = ("caps_sm", "std_step")
"""The metrics that change with the rate at which the same force is recorded, kept to stand beside published ones."""

NOISE_WIDTH = 3.0
"""How many standard deviations below the limit a noisy force still counts as saturated."""

_OF_FORCE = ("seconds", "peak_force", "effort", "variation", "switches", "saturated")
_LINES = 10_000_000  # the most lines of a spectrum that are summed up to a cutoff
_OF_SMOOTHNESS = ("slew", "spectral_share", "caps_sm", "std_step")
_BLOCK = 512  # rows measured together, so that what is in work stays in the cache


def force_metrics(
    u: Array, sample_time: float, force_limit: float | Array, *, force_noise: float | Array = 0.0
) -> dict[str, Array]:
    r"""Measure force signals that are held over each sample.

    Parameters
    ----------
    u : ndarray (N, T)
        Applied forces, N; NaN after a run's end.
    sample_time : float
        s.
    force_limit : float or (N,)
        :math:`u_\max`, N; infinite for none.
    force_noise : float or (N,)
        Standard deviation :math:`\sigma` of the noise that the force has beyond the limiter, N.

    Returns
    -------
    dict of ndarray (N,)
        ``seconds`` the run lasted; ``peak_force`` :math:`\max|u|`; ``effort`` :math:`\int u^2 dt`; ``variation``, the
        total variation :math:`\sum|\Delta u|` per second in units of :math:`u_\max`; ``switches``, changes of sign
        per second, zeros skipped; ``saturated``, the share of the time with :math:`|u| \ge u_\max - 3\sigma`, which
        finds 99.9 % of the samples that the limiter held at the limit, and without noise all of them.

    Raises
    ------
    TypeError, ValueError
        If the signals are not of that shape, or another argument is no such number.
    """
    u, limit, scale = _checked(u, sample_time, force_limit)
    noise = _one_each("force_noise", force_noise, len(u))
    if not (noise >= 0).all():
        raise ValueError(f"force_noise must be at least 0 N; got {force_noise!r}.")
    least = limit * (1 - 1e-12) - NOISE_WIDTH * noise
    measured = {name: np.zeros(len(u)) for name in _OF_FORCE}
    for rows in _blocks(len(u)):
        running = np.isfinite(u[rows])
        held = np.where(running, u[rows], 0.0)
        size = np.abs(held)
        seconds = running.sum(axis=1) * sample_time
        per_second = np.divide(1.0, seconds, out=np.zeros(len(held)), where=seconds > 0)
        jumps = np.abs(np.diff(held, axis=1)) * running[:, 1:]
        at_limit = (size >= least[rows, None]) & running
        measured["seconds"][rows] = seconds
        measured["peak_force"][rows] = size.max(axis=1, initial=0.0)
        measured["effort"][rows] = (held**2).sum(axis=1) * sample_time
        measured["variation"][rows] = jumps.sum(axis=1) / scale[rows] * per_second
        measured["switches"][rows] = _sign_changes(held) * per_second
        measured["saturated"][rows] = at_limit.sum(axis=1) * sample_time * per_second
    return measured


def smoothness_metrics(
    u: Array, sample_time: float, force_limit: float | Array, *, lag: float = 0.01, cutoff: float = 5.0
) -> dict[str, Array]:
    r"""Measure how smooth held force signals are, by a filter and by a spectrum.

    Parameters
    ----------
    u : ndarray (N, T)
        Applied forces, N; NaN after a run's end.
    sample_time : float
        :math:`h`, s.
    force_limit : float or (N,)
        :math:`u_\max`, N; infinite for none.
    lag : float
        Time constant :math:`\tau` of the first-order lag after which ``slew`` is measured, s.
    cutoff : float
        Frequency above which ``spectral_share`` is measured, Hz.

    Returns
    -------
    dict of ndarray (N,)
        ``slew``, the root mean square of :math:`\dot v/u_\max`, where :math:`\tau\dot v = u - v` begins at
        :math:`v = u_0`; ``spectral_share``, the share of :math:`\int u^2 dt` above the cutoff; ``caps_sm``,
        :math:`\frac{2}{n f_s}\sum_i M_i f_i` over the amplitude spectrum of :math:`u/u_\max`; ``std_step``, the
        standard deviation of :math:`\Delta u` in N.  The last two depend on the rate of recording.  All are zero where
        a run has no sample.

    Raises
    ------
    TypeError, ValueError
        If the signals are not of that shape, or another argument is no such number.

    Notes
    -----
    With :math:`q = e^{-h/\tau}` the lag's error :math:`e_k = q\,e_{k-1} + u_k - u_{k-1}`, :math:`e_0 = 0`, decays
    within a sample, so :math:`\int\dot v^2 dt = \frac{1 - q^2}{2\tau}\sum_k e_k^2` exactly.

    The spectrum is that of :func:`dpend.metrics.power_spectrum`.

    Sources: ``caps_sm``: S. Mysore et al., *Regularizing Action Policies for Smooth Control with Reinforcement
    Learning*, 2021, with amplitudes and frequencies as their program spaces them (:math:`2 f_i/f_s` from 0 to 1 in
    equal steps) and the whole run as one window; ``std_step``: the smoothness of RealAIGym's double pendulum.
    """
    checked_positive("lag", lag, "s")
    u, _, scale = _checked(u, sample_time, force_limit)
    _check_frequency("cutoff", cutoff, u, sample_time)
    steps = np.isfinite(u).sum(axis=1)
    measured = {name: np.zeros(len(u)) for name in _OF_SMOOTHNESS}
    for n in np.unique(steps[steps > 0]):  # rows of one length share their lines
        equal = np.flatnonzero(steps == n)
        for block in (equal[rows] for rows in _blocks(len(equal))):
            held = u[block, :n]
            measured["slew"][block] = _slew(held, sample_time, lag) / scale[block]
            measured["spectral_share"][block] = _spectral_share(held, sample_time, cutoff)
            measured["caps_sm"][block] = _caps_sm(held) / scale[block]
            if n > 1:
                measured["std_step"][block] = np.diff(held, axis=1).std(axis=1)
    return measured


def power_spectrum(
    u: Array, sample_time: float, force_limit: float | Array, *, highest: float | None = None
) -> tuple[Array, Array]:
    r"""Return the one-sided power spectral density of held force signals in units of :math:`u_\max`.

    Parameters
    ----------
    u : ndarray (N, T)
        Applied forces, N, of runs of one length.
    sample_time : float
        s.
    force_limit : float or (N,)
        :math:`u_\max`, N; infinite for none.
    highest : float, optional
        Highest frequency, Hz; left out, half the sampling rate.  A staircase has power above it too.

    Returns
    -------
    frequency : ndarray (K,)
        :math:`k/2T` for :math:`k \ge 1`, Hz.
    density : ndarray (N, K)
        :math:`4T c_k^2/u_\max^2`, 1/Hz: summed over all :math:`k`, times :math:`1/2T`, the variance of
        :math:`u/u_\max` over the run.

    Raises
    ------
    TypeError, ValueError
        If the signals are not of that shape or not of one length, or another argument is no such number.

    Notes
    -----
    It is the spectrum of the signal followed by its own reflection, which has no jump where it closes:
    :math:`u(t) = c_0 + 2\sum_k c_k\cos(\pi k t/T)` with
    :math:`c_k = \frac1n\,\mathrm{sinc}\frac{k}{2n}\,\sum_j u_j\cos\frac{\pi k(2j + 1)}{2n}` for the staircase, and
    :math:`\frac1T\int u^2 dt = c_0^2 + 2\sum_k c_k^2`; line :math:`k` lies at :math:`k/2T`.
    """
    u, _, scale = _checked(u, sample_time, force_limit)
    if not (u.shape[1] and np.isfinite(u).all()):
        raise ValueError(
            "Expected force signals of one length, at least a sample, without NaN; take runs that lasted equally long."
        )
    if highest is not None:
        _check_frequency("highest", highest, u, sample_time)
    seconds = u.shape[1] * sample_time
    lines = np.arange(1, _lines_up_to(0.5 / sample_time if highest is None else highest, seconds) + 1)
    amplitudes = _amplitudes(u, lines) / scale[:, None]
    return lines / (2 * seconds), 4 * seconds * amplitudes**2


def _checked(u: npt.ArrayLike, sample_time: float, force_limit: float | Array) -> tuple[Array, Array, Array]:
    """Return signals, limits and units of force, one a row; refuse what is none, or no time of a sample."""
    checked_positive("sample_time", sample_time, "s")
    u = checked_array("u", u, "force signals (N, T), N", finite=False)
    if u.ndim != 2:
        raise ValueError(f"Expected force signals of shape (N, T); got shape {u.shape}.")
    limit = _one_each("force_limit", force_limit, len(u))
    if not (limit > 0).all():
        raise ValueError(f"force_limit must be greater than 0 N, infinite for none; got {force_limit!r}.")
    return u, limit, np.where(np.isfinite(limit), limit, 1.0)


def _one_each(name: str, value: npt.ArrayLike, n: int) -> Array:
    """Return a number, or one a signal, as an array ``(n,)``."""
    array = checked_array(name, value, "a number, or one a signal, N", finite=False)
    if array.shape not in ((), (1,), (n,)):
        raise ValueError(f"{name} must be a number, or one a signal, ({n},); got shape {array.shape}.")
    return np.broadcast_to(array, n)


def _check_frequency(name: str, frequency: float, u: Array, sample_time: float) -> None:
    """Refuse what is no frequency, or so high that its lines are too many."""
    highest = _LINES / (max(u.shape[1], 1) * sample_time)
    if checked_positive(name, frequency, "Hz") > highest:
        raise ValueError(f"{name} must be at most {highest:g} Hz for {u.shape[1]} samples; got {frequency:g} Hz.")


def _blocks(n: int) -> Iterator[slice]:
    """Cut ``n`` rows into blocks."""
    return (slice(start, start + _BLOCK) for start in range(0, n, _BLOCK))


def _sign_changes(u: Array) -> Array:
    """Count changes of sign along the last axis; zeros take the sign of what came before."""
    sign = np.sign(u)
    last = np.maximum.accumulate(np.where(sign != 0, np.arange(u.shape[1]), -1), axis=1)
    carried = np.where(last >= 0, np.take_along_axis(sign, np.maximum(last, 0), axis=1), 0.0)
    return (carried[:, 1:] * carried[:, :-1] < 0).sum(axis=1).astype(np.float64)


def _slew(u: Array, sample_time: float, lag: float) -> Array:
    """Return the root mean square of the rate of staircases ``(n, T)`` that went through a first-order lag, N/s."""
    decay = math.exp(-sample_time / lag)
    error = np.zeros(len(u))
    squares = np.zeros(len(u))
    for jump in np.diff(u, axis=1).T:
        error = decay * error + jump
        squares += error * error
    return np.sqrt(squares * (1 - decay * decay) / (2 * lag) / (u.shape[1] * sample_time))


def _lines_up_to(frequency: float, seconds: float) -> int:
    """Count the lines of a spectrum up to a frequency in Hz; 1e-9 of a line keeps one that lies there."""
    return math.floor(2 * seconds * frequency + 1e-9)


def _amplitudes(u: Array, lines: npt.NDArray[np.int64]) -> Array:
    """Return the size of the cosine coefficients of staircases ``(n, T)`` at some lines; line 0 is the mean."""
    n = u.shape[1]
    spectrum = np.abs(np.fft.rfft(np.hstack([u, u[:, ::-1]]), axis=1)) / (2 * n)
    place = lines % (2 * n)
    return spectrum[:, np.minimum(place, 2 * n - place)] * np.sinc(lines / (2 * n))


def _spectral_share(u: Array, sample_time: float, cutoff: float) -> Array:
    """Return the share of the power of staircases ``(n, T)`` above a frequency in Hz."""
    slow = _amplitudes(u, np.arange(_lines_up_to(cutoff, u.shape[1] * sample_time) + 1))
    power = (u * u).mean(axis=1)
    below = slow[:, 0] ** 2 + 2 * (slow[:, 1:] ** 2).sum(axis=1)
    share = 1 - np.divide(below, power, out=np.ones(len(u)), where=power > 0)
    return np.clip(share, 0.0, 1.0)


def _caps_sm(u: Array) -> Array:
    r"""Return the mean of :math:`M_i f_i` over the lines below half the sampling rate, there 1 in frequency, in N."""
    samples = u.shape[1]
    n = samples // 2
    if n == 0:
        return np.zeros(len(u))
    amplitudes = np.abs(np.fft.rfft(u, axis=1)[:, :n]) * (2 / samples)
    return (amplitudes * np.linspace(0.0, 1.0, n)).mean(axis=1)
