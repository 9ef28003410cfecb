r"""The state-dependent Riccati equation: LQR designed again in every state, for the plant factorised there."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dpend.controller import Act
from dpend.laws import holding, with_logs
from dpend.params import Array, Params
from dpend.plant import rates
from dpend.rig import Rig, single_rig
from dpend.rows import in_parts
from dpend.state import nearest_upright

from .lqr import LQR
from .sdre_kernels import sampled, solved

_STEP = 1e-30  # of the complex step, which has no cancellation
_ROWS = 100  # for which a thread pays


def factorize(params: Params, x: npt.ArrayLike) -> tuple[Array, Array]:
    r"""Return :math:`A(x)` and :math:`B(x)` with :math:`\dot x = A(x)\,x + B(x)\,u`, exactly.

    Of the many such factorisations this is the usual one of mechanics, from
    :math:`D\ddot q + C\dot q + G = f`: the gravity torque of each link is a number times its own angle, as in
    :math:`G_i = (G_i/\theta_i)\,\theta_i`, and what depends on the rates is :math:`C(q, \dot q)\,\dot q`.  Nothing of
    the equations is stated again: the columns of :math:`D^{-1}` are the accelerations that unit forces add, :math:`G`
    is what they must make up for at rest, and as :math:`C\dot q` is quadratic in the rates and friction linear, the
    derivative at half the rates is the factor.  What smooth Coulomb friction leaves over is
    attributed to the cart's speed.

    Parameters
    ----------
    params : Params
        The plant; one, not a batch.
    x : array_like (..., 6)
        States.

    Returns
    -------
    A : ndarray (..., 6, 6)
        The derivative of the rates where x = 0.
    B : ndarray (..., 6, 1)

    Raises
    ------
    ValueError
        If a state does not have six numbers.

    Notes
    -----
    Source: A. Bogdanov, *Optimal Control of a Double Inverted Pendulum on a Cart*, CSE-04-006, 2004, section 4.
    """
    x = np.asarray(x, dtype=np.float64)
    moving = rates(x, np.zeros(x.shape[:-1]), params)
    # No angle is exactly zero, so that G_i / theta_i is its limit there; the error is of the order of theta^2.
    still = x.copy()
    still[..., 1:3] = np.where(np.abs(x[..., 1:3]) < 1e-9, 1e-9, x[..., 1:3])
    still[..., 3:] = 0.0
    forces = np.concatenate([np.zeros((1, 3)), np.eye(3)])
    unmoved = np.repeat(still[..., None, :], 4, axis=-2)
    pulled = rates(unmoved, np.broadcast_to(forces, (*unmoved.shape[:-1], 3)), params)[..., 3:]
    fallen = pulled[..., 0, :]
    inverse = np.swapaxes(pulled[..., 1:, :] - fallen[..., None, :], -1, -2)  # D^-1, column by column
    gravity = np.linalg.solve(inverse, fallen[..., None])[..., 0]

    A = np.zeros((*x.shape, 6))
    A[..., :3, 3:] = np.eye(3)
    A[..., 3:, 1:3] = inverse[..., :, 1:] * (gravity[..., 1:] / still[..., 1:3])[..., None, :]
    half = np.repeat(x[..., None, :], 3, axis=-2).astype(np.complex128)
    half[..., 3:] *= 0.5
    half[..., 3:] += 1j * _STEP * np.eye(3)
    A[..., 3:, 3:] = np.swapaxes(np.imag(rates(half, np.zeros(half.shape[:-1]), params))[..., 3:] / _STEP, -1, -2)
    left = moving[..., 3:] - np.einsum("...ij,...j->...i", A, x)[..., 3:]
    speed = x[..., 3, None]
    A[..., 3:, 3] += left * speed / (speed**2 + 1e-12)
    B = np.concatenate([np.zeros_like(inverse[..., :1]), inverse[..., :1]], axis=-2)
    return A, B


def solve_riccati(
    A: Array, B: Array, Q: Array, R: float, *, doublings: int = 40
) -> tuple[Array, npt.NDArray[np.bool_]]:
    r"""Solve :math:`P = A^\top P A - A^\top P B(R + B^\top P B)^{-1}B^\top P A + Q` for many plants at once.

    Structure-preserving doubling: from :math:`A_0 = A`, :math:`G_0 = BR^{-1}B^\top`, :math:`H_0 = Q`,

    .. math::
        W_k = (I + G_k H_k)^{-1},\quad A_{k+1} = A_k W_k A_k,\quad
        G_{k+1} = G_k + A_k W_k G_k A_k^\top,\quad H_{k+1} = H_k + A_k^\top H_k W_k A_k .

    :math:`H_k` is the solution over :math:`2^k` samples and tends to :math:`P`; :math:`A_k` tends to zero just where
    the loop that :math:`P` closes is stable.

    Parameters
    ----------
    A : ndarray (n, 6, 6)
    B : ndarray (n, 6, 1)
        Sampled plants.
    Q : ndarray (6, 6)
        Weight of the state, positive semidefinite.
    R : float
        Weight of the force, greater than zero.
    doublings : int
        At most so many.

    Returns
    -------
    P : ndarray (n, 6, 6)
    found : ndarray (n,)
        Where a stabilising solution was found; elsewhere P means nothing.

    Notes
    -----
    Source: E. Chu, H. Fan, W. Lin and C. Wang, *Structure-preserving algorithms for periodic discrete-time algebraic
    Riccati equations*, 2004.
    """
    A, B, Q = (np.ascontiguousarray(each, dtype=np.float64) for each in (A, B, Q))
    P, found = np.empty_like(A), np.zeros(len(A), dtype=np.bool_)
    in_parts(lambda first, last: solved(first, last, A, B, Q, float(R), doublings, P, found), len(A), _ROWS)
    return P, found


class SDRE:
    r"""Law :math:`u = -K(x)\,x` with the gain of :math:`\dot x = A(x)x + B(x)u`, sampled, taken as if it were linear.

    In every sample the plant is factorised where it is (:func:`controllers.sdre.factorize`), sampled with its force
    held, and the discrete Riccati equation solved, for all rows at once.  Upright that is LQR; away from upright it is
    no optimum, as the factorisation is not the only one, but it knows the plant's nonlinearity where LQR knows its
    tangent.  Where no stabilising solution is found a row keeps its last gain, at first LQR's.

    Parameters
    ----------
    rig : Rig or str
        What the designer believes: plant and sample time.
    Q : array_like, optional
        State weights, a diagonal ``(6,)`` or a matrix ``(6, 6)``, positive semidefinite; left out, the identity.
    R : float
        Weight of the force, greater than zero.

    Attributes
    ----------
    lqr : LQR
        The regulator with the same weights.

    Raises
    ------
    ValueError
        If the rig describes several plants, a weight has the wrong shape or sign, or there is no gain upright.

    See Also
    --------
    controllers.LQR : The same upright.

    Notes
    -----
    ``act.log["kept"]`` says for each call which rows kept their last gain.

    Source: A. Bogdanov, CSE-04-006, 2004, section 4; T. Çimen, *State-dependent Riccati equation (SDRE) control: a
    survey*, 2008.

    Examples
    --------
    >>> import dpend
    >>> from controllers import SDRE
    >>> rig = dpend.rig("gustafsson2016")
    >>> dpend.simulate(rig, SDRE(rig), [0, 0.1, -0.1, 0, 0, 0], duration=2.0).success
    True
    """

    name = "SDRE"

    def __init__(self, rig: Rig | str, Q: npt.ArrayLike | None = None, R: float = 1.0) -> None:
        self.rig = single_rig(rig, "SDRE")
        self.lqr = LQR(self.rig, Q, R)

    def __repr__(self) -> str:
        return f"<SDRE, upright K = {np.array2string(self.lqr.K[0], precision=4, separator=', ')}>"

    def gains(self, x: npt.ArrayLike) -> tuple[Array, npt.NDArray[np.bool_]]:
        """Return the gains ``(n, 6)`` in states ``(n, 6)``, and where one was found.

        All rows are solved for at once, by doubling.

        Parameters
        ----------
        x : array_like (n, 6)
            States.

        Returns
        -------
        K : ndarray (n, 6)
            Gains, N per unit of each state.
        found : ndarray (n,) of bool
            Where there is a stabilising solution.

        See Also
        --------
        controllers.LQR : Whose gain it is upright.

        Examples
        --------
        >>> import numpy as np
        >>> import dpend
        >>> from controllers import LQR, SDRE
        >>> rig = dpend.rig("gustafsson2016")
        >>> K, found = SDRE(rig).gains(np.zeros((1, 6)))
        >>> bool(np.allclose(K, LQR(rig).K))
        True
        """
        x = nearest_upright(x)
        if x.ndim != 2:
            raise ValueError(f"Expected states of shape (n, 6); got shape {x.shape}.")
        with np.errstate(all="ignore"):  # where rates are beyond any plant's, there is no gain
            A, B = factorize(self.rig.params, x)
            A, B = _held(A, B, self.rig.sample_time)
            P, found = solve_riccati(A, B, self.lqr.Q, self.lqr.R)
            PB = P @ B
            K = np.einsum("nij,nik->nk", PB, A) / (self.lqr.R + np.einsum("nij,nij->n", B, PB))[:, None]
        found &= np.isfinite(K).all(axis=1)
        return K, found

    def start(self, n: int, rng: np.random.Generator) -> Act:
        """Return the law for ``n`` runs."""
        gains = np.tile(self.lqr.K[0], (n, 1))
        log: dict[str, list[Array]] = {"kept": []}

        def act(_: float, y: Array) -> Array:
            K, found = self.gains(y)
            gains[found] = K[found]
            log["kept"].append((~found).astype(np.float64))
            return -np.einsum("ij,ij->i", gains, nearest_upright(y))

        return holding(n, with_logs(act, log))


def _held(A: Array, B: Array, sample_time: float) -> tuple[Array, Array]:
    """Sample many plants with their forces held, as :func:`dpend.discretize` does one.

    scipy's exponential of one such matrix takes longer than all else in a step; here a series is summed for a 16th of
    the sample and squared four times.
    """
    A, B = np.ascontiguousarray(A), np.ascontiguousarray(B)
    held_A, held_B = np.empty_like(A), np.empty_like(B)
    in_parts(lambda first, last: sampled(first, last, A, B, float(sample_time), held_A, held_B), len(A), _ROWS)
    return held_A, held_B
