r"""What deep learners see and are rewarded for: scaled observations, a shaped reward, a mixture of starts.

.. math::
    o(y) &= (p/s_p,\ \sin\theta_1,\ \cos\theta_1,\ \sin\theta_2,\ \cos\theta_2,\ v/s_v,\ \omega_1/s_\omega,\
            \omega_2/s_\omega) \\
    r(x, a) &= \bigl[\tfrac12\,h\,(\tfrac12 + \tfrac12\,k) + \tfrac12\,e^{-5(2 - \cos\theta_1 - \cos\theta_2)}\bigr]
            \bigl(1 - \tfrac{3}{10}\min\{(p/s_p)^2, 1\}\bigr) - 5\,[\text{failed}] - \tfrac{1}{200} a^2

with the height :math:`h = \tfrac12 + \tfrac12(L_1\cos\theta_1 + L_2\cos\theta_2)/(L_1 + L_2)` of the tip, the factor
:math:`k = e^{-2(\omega_1^2 + \omega_2^2)/s_\omega^2}` of slow links, and the share :math:`a` of the force limit.  The
scales follow from the rig: :math:`s_p` is the end of the track, :math:`s_\omega = 2\sqrt{g/L}` with the mean length
:math:`L`, and :math:`s_v = s_\omega L/2`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .params import Array
from .rig import Rig
from .tasks import Balance, Codes, SwingUp

_FAILURE_COST = 5.0
_EFFORT_COST = 0.005
LONGEST_HOLD = 0.04
"""How long a force is held on an ideal rig at most, s."""
_EPISODE = 10.0


def observation_scales(rig: Rig) -> Array:
    r"""Return :math:`(s_p, s_v, s_\omega, s_\omega)` of a single rig ``(4,)``, in m, m/s and rad/s.

    Where its track is unlimited, :math:`s_p` is the length of both links.
    """
    length = (rig.params.length1 + rig.params.length2) / 2
    rate = 2 * np.sqrt(rig.params.gravity / length)
    reach = rig.track_limit if np.isfinite(rig.track_limit) else 2 * length
    return np.array([reach, rate * length / 2, rate, rate], dtype=np.float64)


def nearness(cos1: Array, cos2: Array) -> Array:
    r"""Return :math:`e^{-5(2 - \cos\theta_1 - \cos\theta_2)}`: one upright, nothing far from it."""
    return np.exp(-5.0 * (2.0 - cos1 - cos2))


def observe(y: Array, scales: Array, last: Array | None = None) -> Array:
    """Return :math:`o(y)` of measured states, ``(n, 8)``, or ``(n, 9)`` with the last actions ``(n,)`` behind it.

    Actions are shares of the force limit; :func:`observation_scales` makes the scales.
    """
    o = np.empty((len(y), 8 if last is None else 9))
    o[:, 0] = y[:, 0] / scales[0]
    with np.errstate(invalid="ignore"):  # an infinite angle ends the episode as it is
        np.sin(y[:, 1:3], out=o[:, 1:4:2])
        np.cos(y[:, 1:3], out=o[:, 2:5:2])
    np.divide(y[:, 3:], scales[1:], out=o[:, 5:8])
    if last is not None:
        o[:, 8] = last
    return o


def shaped_reward(rig: Rig, x: Array, u: Array, codes: Codes) -> Array:
    """Return :math:`r(x, a)` of states ``(n, 6)`` after a sample, of one rig with a force limit.

    The forces ``u`` ``(n,)`` in N were applied over the sample, and the states have those status codes.
    """
    scales = observation_scales(rig)
    share1 = float(rig.params.length1) / float(rig.params.length1 + rig.params.length2)
    with np.errstate(invalid="ignore"):  # an infinite angle ends the episode as it is
        cos1, cos2 = np.cos(x[:, 1]), np.cos(x[:, 2])
    height = 0.5 + 0.5 * (share1 * cos1 + (1 - share1) * cos2)
    slow = np.exp(-2.0 * ((x[:, 4:] / scales[2:]) ** 2).sum(axis=1))
    central = 1.0 - 0.3 * np.minimum((x[:, 0] / scales[0]) ** 2, 1.0)
    reward = (0.5 * height * (0.5 + 0.5 * slow) + 0.5 * nearness(cos1, cos2)) * central
    return reward - _FAILURE_COST * (codes != 0) - _EFFORT_COST * (u / rig.force_limit) ** 2


@dataclass(frozen=True, kw_only=True, eq=False)
class Mixture:
    """A task whose episodes begin where those of several tasks do, each equally often.

    Parameters
    ----------
    task : Balance or SwingUp
        What an episode costs, when it fails and what succeeds.
    mixture : sequence of Balance or SwingUp
        Tasks that starts are drawn from.
    steps : int
        Samples in a full episode.
    """

    task: Balance | SwingUp
    mixture: Sequence[Balance | SwingUp]
    steps: int

    @property
    def hold(self) -> float:
        """Seconds that both links must have been upright at the end of a successful run, as the task asks."""
        return self.task.hold

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
        """Return the task's cost."""
        return self.task.cost(x, codes)


def shaped_balance(rig: Rig) -> tuple[Mixture, Rig]:
    """Return task and rig that the shipped policies learned to balance on: starts within 0.4 rad, 300 samples."""
    task = Balance(lam=0.4)
    return Mixture(task=task, mixture=[task], steps=task.steps), rig


def shaped_swing_up(rig: Rig) -> tuple[Mixture, Rig]:
    """Return the task and the rig that the shipped policies learned to swing up on.

    Episodes of 10 s start hanging, to the side, near upright or anywhere, each equally often, and a force is held for
    0.04 s, or for as many samples of an ideal rig as that has.
    """
    samples = max(math.floor(LONGEST_HOLD / rig.sample_time + 1e-9), 1) if rig.ideal else 1
    # Holding a force for k samples is sampling k times more slowly, with as many substeps.
    slow = rig.replace(sample_time=samples * rig.sample_time, substeps=samples * rig.substeps)
    starts = [SwingUp(start=start, angle_spread=0.1) for start in ("hanging", "side")]
    mixture = [*starts, Balance(lam=0.1), SwingUp(start="anywhere")]
    return Mixture(task=SwingUp(), mixture=mixture, steps=max(round(_EPISODE / slow.sample_time), 1)), slow
