r"""The time-varying linear-quadratic regulator along a trajectory, then the regulator about where it ends."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Literal

import casadi
import numpy as np
import numpy.typing as npt

from dpend.arguments import checked_name
from dpend.controller import Act
from dpend.laws import holding, with_logs
from dpend.params import Array
from dpend.rig import Rig, as_rig
from dpend.state import deviation
from dpend.symbolic import sample_function

from .data import shipped
from .lqr import LQR
from .trajectory import Trajectory
from .trajopt import optimize

_REACH = 5  # samples by which a run may move on along the trajectory in one, and for which it may wait


def sensitivities(trajectory: Trajectory) -> tuple[Array, Array]:
    r"""Return :math:`A_k = \partial F/\partial x` and :math:`B_k = \partial F/\partial u` at every sample, exactly.

    :math:`F` is the plant over one sample under a held force, differentiated by CasADi.

    Parameters
    ----------
    trajectory : Trajectory
        Where to differentiate.

    Returns
    -------
    A : ndarray (N, 6, 6)
    B : ndarray (N, 6)
    """
    x, u = casadi.SX.sym("x", 6), casadi.SX.sym("u")
    after = sample_function(trajectory.rig)(x, u)
    derivative = casadi.Function("derivative", [x, u], [casadi.densify(casadi.jacobian(after, casadi.vertcat(x, u)))])
    N = len(trajectory.u)
    both = np.array(derivative.map(N)(trajectory.x[:-1].T, trajectory.u[None])).reshape(6, N, 7).transpose(1, 0, 2)
    return both[..., :6].copy(), both[..., 6].copy()


class TVLQR:
    r"""Law :math:`u = \bar u_k - K_k (x - \bar x_k)` along a trajectory :math:`\bar x, \bar u`, then LQR about its end.

    The gains minimise :math:`\sum_k \delta_k^\top Q \delta_k + R\,(u_k - \bar u_k)^2` for small
    :math:`\delta = x - \bar x`, by the Riccati recursion

    .. math:: K_k = \frac{B_k^\top P_{k+1} A_k}{R + B_k^\top P_{k+1} B_k},\qquad
       P_k = Q + R K_k^\top K_k + (A_k - B_k K_k)^\top P_{k+1} (A_k - B_k K_k)

    backwards from the regulator about the end, which takes over there.  Angles are taken to the turn nearest to the
    trajectory.

    Parameters
    ----------
    rig : Rig or str
        What the designer believes: plant and sample time; limits where a trajectory has to be found.
    trajectory : Trajectory, optional
        What to follow, on this plant and clock; left out, from hanging to both links up: the one that comes with the
        package if there is one for this rig, else one found when the controller is first started, in some seconds.
    Q : array_like
        State weights, a diagonal ``(6,)`` or a matrix ``(6, 6)``, positive semidefinite.
    R : float
        Weight of the force, greater than zero.
    index : {"nearest", "time"}
        Which sample of the trajectory a run is at.  ``"time"``: as many as have passed.  ``"nearest"``: the one to
        which the deviation costs least, :math:`\min_k \delta_k^\top P_k\,\delta_k`: any at first, so that a run may
        begin anywhere along the trajectory; then up to five ahead of the last, or the same for up to five samples.

    Attributes
    ----------
    trajectory : Trajectory
        What is followed.
    K : ndarray (N + 1, 6)
        Gains; the last is the end's.
    P : ndarray (N + 1, 6, 6)
        :math:`\delta^\top P_k\,\delta` is the cost from :math:`\bar x_k + \delta`.

    Raises
    ------
    ValueError
        If the rig describes several plants, a weight has the wrong shape or sign, or the trajectory was planned for
        another plant or clock, or stops short of its target.

    See Also
    --------
    controllers.optimize : Find a trajectory.
    controllers.shipped : Those that come with the package.

    Notes
    -----
    Source: B. Anderson and J. Moore, *Optimal Control: Linear Quadratic Methods*, 1990.

    Examples
    --------
    >>> import dpend
    >>> from controllers import TVLQR
    >>> rig = dpend.rig("gustafsson2016")
    >>> task = dpend.SwingUp(steps=300)
    >>> dpend.simulate(rig, TVLQR(rig), dpend.EQUILIBRIA["down-down"], task=task).success
    True
    """

    name = "TVLQR"

    def __init__(
        self,
        rig: Rig | str,
        trajectory: Trajectory | None = None,
        *,
        Q: npt.ArrayLike = (10.0, 100.0, 100.0, 1.0, 10.0, 10.0),
        R: float = 0.02,
        index: Literal["nearest", "time"] = "nearest",
    ) -> None:
        rig = as_rig(rig)
        checked_name("index", index, ("nearest", "time"))
        if trajectory is None:
            trajectory = shipped(rig)
        else:
            _check(rig, trajectory)
        self.rig = rig
        self.index = index
        self._end = LQR(rig, Q, R, target="up-up" if trajectory is None else trajectory.target)
        if trajectory is not None:
            self.trajectory = trajectory

    def __repr__(self) -> str:
        return f"<TVLQR along {self.trajectory!r}>" if "trajectory" in vars(self) else "<TVLQR, not yet planned>"

    @cached_property
    def trajectory(self) -> Trajectory:
        """What is followed; found now if it was neither given nor shipped."""
        T = self.rig.sample_time
        return optimize(self.rig, duration=T * math.ceil(2.5 / T - 1e-9), starts=8)

    @cached_property
    def _design(self) -> tuple[Array, Array]:
        trajectory, end = self.trajectory, self._end
        A, B = sensitivities(trajectory)
        N, Q, R = len(B), end.Q, end.R
        K, P = np.empty((N + 1, 6)), np.empty((N + 1, 6, 6))
        K[N], P[N] = end.K[0], end.P
        for k in reversed(range(N)):
            ahead = P[k + 1] @ B[k]
            K[k] = ahead @ A[k] / (R + B[k] @ ahead)
            closed = A[k] - np.outer(B[k], K[k])
            P[k] = Q + R * np.outer(K[k], K[k]) + closed.T @ P[k + 1] @ closed
            P[k] = 0.5 * (P[k] + P[k].T)
        for array in (K, P):
            array.setflags(write=False)
        return K, P

    @property
    def K(self) -> Array:
        """Gains ``(N + 1, 6)``; the last is the end's."""
        return self._design[0]

    @property
    def P(self) -> Array:
        """Matrices ``(N + 1, 6, 6)`` of the cost to go."""
        return self._design[1]

    def start(self, n: int, rng: np.random.Generator) -> Act:
        """Return the law for ``n`` runs; ``log["sample"]`` tells which sample of the trajectory each was at."""
        K, P = self._design
        N, T = len(K) - 1, self.rig.sample_time
        along = np.vstack([self.trajectory.x[:-1], self.trajectory.target])
        forces = np.append(self.trajectory.u, 0.0)
        at: npt.NDArray[np.intp] | None = None
        waited = np.zeros(n, dtype=np.intp)
        log: dict[str, list[Array]] = {"sample": []}

        def nearest(y: Array) -> npt.NDArray[np.intp]:
            nonlocal at, waited
            if at is None:
                candidates = np.broadcast_to(np.arange(N + 1), (n, N + 1))
            else:
                candidates = np.minimum(at[:, None] + np.arange(_REACH + 1), N)
            away = deviation(y[:, None], along[candidates])
            costs = np.einsum("nki,nkij,nkj->nk", away, P[candidates], away)
            if at is not None:
                costs[waited >= _REACH, 0] = np.inf
            chosen = candidates[np.arange(n), np.argmin(costs, axis=1)]
            waited = np.where(chosen == at, waited + 1, 0)
            at = chosen
            return chosen

        def by_time(t: float) -> npt.NDArray[np.intp]:
            return np.full(n, min(math.floor(t / T + 1e-6), N), dtype=np.intp)

        def act(t: float, y: Array) -> Array:
            k = by_time(t) if self.index == "time" else nearest(y)
            log["sample"].append(k.astype(np.float64))
            return forces[k] - np.einsum("ij,ij->i", K[k], deviation(y, along[k]))

        return holding(n, with_logs(act, log))


def _check(rig: Rig, trajectory: Trajectory) -> None:
    """Refuse a trajectory that is no motion of this plant on this clock, or that the regulator cannot finish."""
    if not isinstance(trajectory, Trajectory):
        raise TypeError(f"trajectory must be a controllers.Trajectory; got {type(trajectory).__name__}.")
    T, own = rig.sample_time, trajectory.rig.sample_time
    if not math.isclose(T, own, rel_tol=1e-9):
        samples = math.ceil(trajectory.duration / T - 1e-9)
        raise ValueError(
            f"The trajectory's samples last {own:.6g} s, the rig's {T:.6g} s; a force is held for the time it was "
            f"planned for. Plan it on the rig's clock: "
            f"optimize(rig, ..., duration={samples * T:.6g}, guess=trajectory)."
        )
    if trajectory.rig.params != rig.params:
        raise ValueError(
            "The trajectory was planned for a plant with other parameters than the rig's; plan it for this one: "
            "optimize(rig, ..., guess=trajectory)."
        )
    short = float(np.abs(deviation(trajectory.x[-1], trajectory.target)).max())
    if short > 0.1:
        raise ValueError(
            f"The trajectory stops {short:.3g} short of its target, and the regulator there works near it only; "
            "expected at most 0.1 in every state."
        )
