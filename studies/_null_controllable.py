"""From where bounded force can bring the linearized pendulum to rest: its two unstable modes, or all, on a track."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.optimize import linprog

import dpend
from dpend.params import Array, Params


class NullControllable(NamedTuple):
    r"""The set of :math:`z = W x` that bounded force can bring to rest, in the unstable modes of a linearisation.

    Attributes
    ----------
    rates : ndarray (2,)
        :math:`\lambda_1 > \lambda_2 > 0`, 1/s.
    W : ndarray (2, 6)
        Left eigenvectors: :math:`\dot z_i = \lambda_i z_i + b_i u`.
    boundary : ndarray (m, 2)
        Points of its boundary in order, once round.
    """

    rates: Array
    W: Array
    boundary: Array

    def share(self, x: npt.ArrayLike) -> Array:
        """Return by which factor ``(n,)`` the set must grow to reach states ``(n, 6)``: inside, below 1."""
        edge = np.roll(self.boundary, -1, axis=0) - self.boundary
        outward = np.stack([edge[:, 1], -edge[:, 0]], axis=1)
        height = np.einsum("mi,mi->m", outward, self.boundary)
        z = np.atleast_2d(np.asarray(x, dtype=np.float64)) @ self.W.T
        shares: Array = np.max((z @ outward.T) / height, axis=1)
        return shares


def null_controllable(params: Params, force: float, points: int = 400) -> NullControllable:
    r"""Return the null-controllable set of the upright linearisation's unstable modes under :math:`|u| \le F`.

    It is :math:`\{-\int_0^\infty e^{-\Lambda s} b\, u(s)\, ds\}`.  The extremes of an integral over :math:`|u| \le F`
    are attained by :math:`u = F\,\mathrm{sgn}(c^\top e^{-\Lambda s} b)`, which with two real rates changes sign once
    at most, at :math:`\tau` say, so the boundary is

    .. math:: z_i(\tau) = \pm \frac{b_i F}{\lambda_i} \bigl(1 - 2 e^{-\lambda_i \tau}\bigr), \quad \tau \ge 0.

    A force held for samples gives the polygon of the points with :math:`\tau = k T`.  The stable and the neutral modes
    (the cart) set no limit in the linear plant, the track's end and large angles do in the true one.

    Parameters
    ----------
    params : Params
        The plant.
    force : float
        :math:`F`, N.
    points : int
        Points on each of the two arcs.

    Returns
    -------
    NullControllable

    Notes
    -----
    Source: T. Hu, Z. Lin and L. Qiu, *An explicit description of null controllable regions of linear systems with
    saturating actuators*, Systems & Control Letters 47, 2002; T. Hu and Z. Lin, *Control Systems with Actuator
    Saturation*, 2001, chapter 2.
    """
    A, B = dpend.linearize(params)
    every_rate, left = np.linalg.eig(A.T)
    order = [i for i in np.argsort(-np.real(every_rate)) if np.real(every_rate[i]) > 1e-3]
    W: Array = np.real(left[:, order]).T
    rates: Array = np.real(every_rate[order])
    reach = (W @ B)[:, 0] * force / rates
    decay = np.linspace(0.0, 1.0, points + 1)[1:, None] ** (rates / rates.min())  # exp(-rate tau), slow mode evenly
    arc = reach * (1 - 2 * decay)
    ring = np.concatenate([arc, -arc])
    turn = np.sum(ring[:, 0] * np.roll(ring[:, 1], -1) - ring[:, 1] * np.roll(ring[:, 0], -1))
    return NullControllable(rates, W, ring if turn > 0 else ring[::-1])


def farthest_on_track(
    rig: dpend.Rig, direction: npt.ArrayLike, *, force: float, track: float, samples: int = 250
) -> float:
    r"""Return the greatest :math:`r` from which the linear plant comes to rest, the cart anywhere on its track.

    It is a linear program, exact but for the horizon of :math:`N` samples, at whose end all but the position is zero:

    .. math:: \max r \quad\text{s.t.}\quad x_0 = r d,\; x_{k+1} = A x_k + B u_k,\; |u_k| \le F,\; |p_k| \le p_\max

    for a direction :math:`d` ``(6,)``, a force :math:`F`, N, and a track of :math:`\pm p_\max`, m, infinity for none.
    """
    A, B = dpend.discretize(*dpend.linearize(rig.params), rig.sample_time)
    d, N = np.asarray(direction, dtype=np.float64), samples  # the variables are r, x_1 ... x_N, u_0 ... u_(N-1)
    first = np.concatenate([-A @ d, np.zeros(6 * (N - 1))])[:, None]
    motion = sparse.kron(sparse.eye(N), np.eye(6)) - sparse.kron(sparse.eye(N, k=-1), A)
    bound = np.tile([track, *5 * [np.inf]], (N, 1))
    bound[-1, 1:] = 0.0
    high = np.concatenate([[np.inf], bound.ravel(), np.full(N, force)])
    low = np.append(0.0, -high[1:])
    solved = linprog(
        np.append(-1.0, np.zeros(7 * N)),
        A_eq=sparse.hstack([first, motion, sparse.kron(sparse.eye(N), -B)]).tocsc(),
        b_eq=np.zeros(6 * N),
        bounds=np.column_stack([low, high]),
    )
    if not solved.success:
        raise RuntimeError(f"The linear program of {N} samples was not solved: {solved.message}")
    return float(solved.x[0])
