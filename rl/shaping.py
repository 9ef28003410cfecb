r"""What deep learners see and are rewarded for: a map from states to observations, and a task with a shaped reward.

.. math::
    o(y) &= (p/s_p,\ \sin\theta_1,\ \cos\theta_1,\ \sin\theta_2,\ \cos\theta_2,\ v/s_v,\ \omega_1/s_\omega,\
            \omega_2/s_\omega) \\
    r(x) &= \bigl[\tfrac12\,h\,(\tfrac12 + \tfrac12\,k) + \tfrac12\,n\bigr]
            \bigl(1 - \tfrac{3}{10}\min((p/s_p)^2, 1)\bigr) - 5\,[\text{failed}]

with three terms: *height* of the tip, :math:`h = \tfrac12 + \tfrac12(L_1\cos\theta_1 + L_2\cos\theta_2)/(L_1 + L_2)`;
*settled*, :math:`k = e^{-2(\omega_1^2 + \omega_2^2)/s_\omega^2}`; and *upright*,
:math:`n = e^{-5(2 - \cos\theta_1 - \cos\theta_2)}`.  The scales follow from the rig: :math:`s_p` is the end of the
track, :math:`s_\omega = 2\sqrt{g/L}` with the mean length :math:`L`, and :math:`s_v = s_\omega L/2`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from dpend.params import Array
from dpend.rig import Rig
from dpend.tasks import Balance, Codes, SwingUp

_FAILURE_COST = 5.0


def observation_scales(rig: Rig) -> Array:
    r"""Return :math:`(s_p, s_v, s_\omega, s_\omega)` of a single rig, in m, m/s and rad/s.

    Parameters
    ----------
    rig : Rig
        The rig; where its track is unlimited, :math:`s_p` is the length of both links.

    Returns
    -------
    ndarray (4,)
    """
    length = (rig.params.length1 + rig.params.length2) / 2
    rate = 2 * np.sqrt(rig.params.gravity / length)
    reach = rig.track_limit if np.isfinite(rig.track_limit) else 2 * length
    return np.array([reach, rate * length / 2, rate, rate], dtype=np.float64)


def nearness(cos1: Array, cos2: Array) -> Array:
    r"""Return :math:`n`, the term *upright*: one where both links are up, nothing far from it."""
    return np.exp(-5.0 * (2.0 - cos1 - cos2))


def observe(y: Array, scales: Array, last: Array | None = None) -> Array:
    r"""Return :math:`o(y)`, followed by the last action where there is one.

    Parameters
    ----------
    y : ndarray (n, 6)
        Measured states.
    scales : ndarray (4,)
        What :func:`observation_scales` returns.
    last : ndarray (n,), optional
        Last actions, shares of the force limit.

    Returns
    -------
    ndarray (n, 8) or (n, 9)
    """
    o = np.empty((len(y), 8 if last is None else 9))
    o[:, 0] = y[:, 0] / scales[0]
    np.sin(y[:, 1:3], out=o[:, 1:4:2])
    np.cos(y[:, 1:3], out=o[:, 2:5:2])
    np.divide(y[:, 3:], scales[1:], out=o[:, 5:8])
    if last is not None:
        o[:, 8] = last
    return o


@dataclass(frozen=True, kw_only=True, eq=False)
class Shaped:
    r"""A task with the shaped reward :math:`r`, started from a mixture of other tasks' starts.

    Parameters
    ----------
    task : Balance or SwingUp
        Says when an episode fails.
    rig : Rig
        A single one, for the scales.
    mixture : sequence of Balance or SwingUp
        Tasks that starts are drawn from, each equally often.
    steps : int
        Samples in a full episode.
    """

    task: Balance | SwingUp
    rig: Rig
    mixture: Sequence[Balance | SwingUp]
    steps: int
    _scales: Array = field(init=False, repr=False)
    _shares: tuple[float, float] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_scales", observation_scales(self.rig))
        lengths = float(self.rig.params.length1), float(self.rig.params.length2)
        object.__setattr__(self, "_shares", tuple(length / sum(lengths) for length in lengths))

    @property
    def hold(self) -> float:
        """Learning does not ask whether an episode succeeded; evaluation does."""
        return 0.0

    def starts(self, rng: np.random.Generator, n: int, rig: Rig) -> Array:
        """Draw ``n`` initial states of the mixture."""
        drawn = np.stack([task.starts(rng, n, rig) for task in self.mixture])
        return drawn[rng.integers(len(drawn), size=n), np.arange(n)]

    def ended(self, x: Array, rig: Rig) -> Codes:
        """Return the status codes of the task."""
        return self.task.ended(x, rig)

    def upright(self, x: Array) -> npt.NDArray[np.bool_]:
        """Return which states have both links up, as the task does."""
        return self.task.upright(x)

    def cost(self, x: Array, codes: Codes) -> Array:
        """Return minus the reward of arriving in states ``(n, 6)`` with those status codes."""
        cos1, cos2 = np.cos(x[:, 1]), np.cos(x[:, 2])
        height = 0.5 + 0.5 * (self._shares[0] * cos1 + self._shares[1] * cos2)
        rates = x[:, 4:] / self._scales[2:]
        settled = np.exp(-2.0 * (rates**2).sum(axis=1))
        centered = 1.0 - 0.3 * np.minimum((x[:, 0] / self._scales[0]) ** 2, 1.0)
        reward = (0.5 * height * (0.5 + 0.5 * settled) + 0.5 * nearness(cos1, cos2)) * centered
        return _FAILURE_COST * (codes != 0) - reward
