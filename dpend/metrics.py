"""Figures of merit of held force signals: effort, smoothness, saturation."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

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
}
"""Unit of each metric; ``u_max`` is the rig's force limit, or one newton where it has none."""


def force_metrics(u: Array, sample_time: float, force_limit: float | Array) -> dict[str, Array]:
    r"""Measure force signals that are held over each sample.

    Parameters
    ----------
    u : ndarray (N, T)
        Applied forces, N; NaN after a run's end.
    sample_time : float
        s.
    force_limit : float or (N,)
        :math:`u_\max`, N; infinite for none.

    Returns
    -------
    dict of ndarray (N,)
        ``seconds`` the run lasted; ``peak_force`` :math:`\max|u|`; ``effort`` :math:`\int u^2 dt`; ``variation``, the
        total variation :math:`\sum|\Delta u|` per second in units of :math:`u_\max`; ``switches``, changes of sign
        per second, zeros skipped; ``saturated``, the share of the time
        at the limit or beyond (force noise, which acts after the limit, moves the force off it).
    """
    u = np.asarray(u, dtype=np.float64)
    if u.ndim != 2:
        raise ValueError(f"Expected force signals of shape (N, T); got shape {u.shape}.")
    limit = np.broadcast_to(force_limit, len(u))
    scale = np.where(np.isfinite(limit), limit, 1.0)
    running = np.isfinite(u)
    seconds = running.sum(axis=1) * sample_time
    held = np.where(running, u, 0.0)
    jumps = np.abs(np.diff(held, axis=1)) * running[:, 1:]
    per_second = np.divide(1.0, seconds, out=np.zeros(len(u)), where=seconds > 0)
    at_limit = (np.abs(held) >= limit[:, None] * (1 - 1e-12)) & running
    return {
        "seconds": seconds,
        "peak_force": np.abs(held).max(axis=1, initial=0.0),
        "effort": (held**2).sum(axis=1) * sample_time,
        "variation": jumps.sum(axis=1) / scale * per_second,
        "switches": _sign_changes(held) * per_second,
        "saturated": at_limit.sum(axis=1) * sample_time * per_second,
    }


def _sign_changes(u: Array) -> Array:
    """Count changes of sign along the last axis; zeros take the sign of what came before."""
    sign = np.sign(u)
    last = np.maximum.accumulate(np.where(sign != 0, np.arange(u.shape[1]), -1), axis=1)
    carried = np.where(last >= 0, np.take_along_axis(sign, np.maximum(last, 0), axis=1), 0.0)
    return (carried[:, 1:] * carried[:, :-1] < 0).sum(axis=1).astype(np.float64)
