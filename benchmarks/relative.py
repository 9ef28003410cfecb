r"""States, forces and matrices in the coordinates of rigid-body engines: link 2's angle *relative to link 1*.

With :math:`q = (p, \theta_1, \theta_2)` absolute and :math:`\varphi` relative, :math:`q = S\varphi`; forces do the same
work in both, so :math:`f_\varphi = S^\top f_q`.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dpend import Params
from dpend.params import Array

S = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 1.0]])
_S_INVERSE = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 1.0]])
_T = np.kron(np.eye(2), S)
_T_INVERSE = np.kron(np.eye(2), _S_INVERSE)


def to_relative(x: npt.ArrayLike) -> tuple[Array, Array]:
    """Return positions and rates, each ``(..., 3)``, in relative angles, for our states ``(..., 6)``."""
    x = np.asarray(x, dtype=np.float64)
    return x[..., :3] @ _S_INVERSE.T, x[..., 3:] @ _S_INVERSE.T


def from_relative(q: npt.ArrayLike, v: npt.ArrayLike) -> Array:
    """Return our states ``(..., 6)`` for positions and rates, each ``(..., 3)``, in relative angles."""
    return np.concatenate([absolute(q), absolute(v)], axis=-1)


def absolute(q: npt.ArrayLike) -> Array:
    """Return positions, rates or accelerations ``(..., 3)`` with link 2's angle absolute, for relative ones."""
    return np.asarray(q, dtype=np.float64) @ S.T


def forces_to_relative(f: npt.ArrayLike) -> Array:
    r"""Return :math:`S^\top f` ``(..., 3)``, which does the work of our forces on cart (N) and links (N m)."""
    return np.asarray(f, dtype=np.float64) @ S


def mass_matrices(relative: npt.ArrayLike) -> Array:
    r"""Return :math:`D = S^{-\top} D_\varphi S^{-1}` ``(..., 3, 3)`` in absolute angles, for relative ones."""
    return _S_INVERSE.T @ np.asarray(relative, dtype=np.float64) @ _S_INVERSE


def slopes(A: npt.ArrayLike, B: npt.ArrayLike) -> tuple[Array, Array]:
    r"""Return :math:`T A_\varphi T^{-1}` and :math:`T B_\varphi` in our states, T being S for positions and rates."""
    return _T @ np.asarray(A, dtype=np.float64) @ _T_INVERSE, _T @ np.asarray(B, dtype=np.float64)


def coulomb(params: Params, vel: npt.ArrayLike) -> Array:
    r"""Return the smooth Coulomb friction on the cart, :math:`-F_c v/\sqrt{v^2 + v_s^2}`, in N.

    No engine has it, so each gets it as an applied force.
    """
    vel = np.asarray(vel, dtype=np.float64)
    return -params.cart_coulomb * vel / np.hypot(vel, params.coulomb_speed)


def coulomb_slope(params: Params, vel: float) -> float:
    r"""Return :math:`-F_c v_s^2/(v^2 + v_s^2)^{3/2}`, the slope of :func:`coulomb`, N s/m."""
    return float(-params.cart_coulomb * params.coulomb_speed**2 / np.hypot(vel, params.coulomb_speed) ** 3)
