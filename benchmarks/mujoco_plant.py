"""The same double pendulum on a cart for MuJoCo: the model as MJCF, and states and forces in both languages.

MuJoCo's coordinates are the cart's position, link 1's angle and link 2's angle *relative to link 1*.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np
import numpy.typing as npt

from dpend import Params, Rig
from dpend.params import Array

CART_JOINT = "slider"


def mjcf(params: Params, timestep: float = 0.01) -> str:
    """Return MJCF text of the plant: a slider, two hinges, inertias as numbers, RK4, nothing to collide with.

    Parameters
    ----------
    params : Params
        One plant, its links' inertias greater than zero as MuJoCo asks.  Its Coulomb friction is left out: MuJoCo has
        no smooth one.  :func:`coulomb` gives it as a force to apply.
    timestep : float
        Length of a Runge-Kutta step, s.

    Returns
    -------
    str
        What ``mujoco.MjModel.from_xml_string`` reads.  The motor's control is the force on the cart in N.

    Raises
    ------
    ValueError
        If ``params`` describes several plants, or a link has no inertia about its centre of mass.
    """
    if params.n is not None:
        raise ValueError(f"One MJCF text describes one plant; got {params.n}.")
    (com1, com2), (inertia1, inertia2) = params.centers, params.inertias
    if not (inertia1 and inertia2):
        raise ValueError(f"MuJoCo needs inertias greater than zero; got {inertia1} and {inertia2} kg m^2.")
    return f"""
<mujoco>
  <option timestep="{timestep!r}" integrator="RK4" gravity="0 0 {-params.gravity!r}">
    <flag contact="disable" constraint="disable" sensor="disable"/>
  </option>
  <worldbody>
    <body name="cart">
      <joint name="{CART_JOINT}" type="slide" axis="1 0 0" damping="{params.cart_friction!r}"/>
      <inertial pos="0 0 0" mass="{params.cart_mass!r}" diaginertia="1 1 1"/>
      <body name="link1">
        <joint name="hinge1" type="hinge" axis="0 1 0" damping="{params.joint1_friction!r}"/>
        <inertial pos="0 0 {com1!r}" mass="{params.mass1!r}" diaginertia="{inertia1!r} {inertia1!r} {inertia1!r}"/>
        <body name="link2" pos="0 0 {params.length1!r}">
          <joint name="hinge2" type="hinge" axis="0 1 0" damping="{params.joint2_friction!r}"/>
          <inertial pos="0 0 {com2!r}" mass="{params.mass2!r}" diaginertia="{inertia2!r} {inertia2!r} {inertia2!r}"/>
          <site name="tip" pos="0 0 {params.length2!r}"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="{CART_JOINT}"/>
  </actuator>
</mujoco>
"""


def build(rig: Rig) -> Any:
    """Return the ``mujoco.MjModel`` of a rig's plant; its timestep is the rig's substep."""
    mujoco: Any = import_module("mujoco")  # it has no types, and only those who compare need the extra `peers`
    return mujoco.MjModel.from_xml_string(mjcf(rig.params, rig.sample_time / rig.substeps))


def to_mujoco(x: npt.ArrayLike) -> tuple[Array, Array]:
    """Return MuJoCo's ``qpos`` and ``qvel``, each ``(..., 3)``, for our states ``(..., 6)``."""
    x = np.asarray(x, dtype=np.float64)
    return _relative(x[..., :3]), _relative(x[..., 3:])


def from_mujoco(qpos: npt.ArrayLike, qvel: npt.ArrayLike) -> Array:
    """Return our states ``(..., 6)`` for MuJoCo's ``qpos`` and ``qvel``, each ``(..., 3)``."""
    return np.concatenate([absolute(qpos), absolute(qvel)], axis=-1)


def absolute(q: npt.ArrayLike) -> Array:
    """Return positions, rates or accelerations ``(..., 3)`` with link 2's angle absolute, for MuJoCo's relative one."""
    q = np.array(q, dtype=np.float64)
    q[..., 2] += q[..., 1]
    return q


def forces_to_mujoco(f: npt.ArrayLike) -> Array:
    r"""Return ``qfrc_applied`` ``(..., 3)`` that does the work of our forces ``(..., 3)`` on cart (N) and links (N m).

    :math:`f_1\,d\theta_1 + f_2\,d\theta_2 = (f_1 + f_2)\,d\varphi_1 + f_2\,d\varphi_2`, with MuJoCo's angles
    :math:`\varphi_1 = \theta_1` and :math:`\varphi_2 = \theta_2 - \theta_1`.
    """
    f = np.array(f, dtype=np.float64)
    f[..., 1] += f[..., 2]
    return f


def coulomb(params: Params, vel: npt.ArrayLike) -> Array:
    r"""Return the smooth Coulomb friction on the cart, :math:`-F_c v/\sqrt{v^2 + v_s^2}`, in N."""
    vel = np.asarray(vel, dtype=np.float64)
    return -params.cart_coulomb * vel / np.hypot(vel, params.coulomb_speed)


def _relative(q: Array) -> Array:
    q = q.copy()
    q[..., 2] -= q[..., 1]
    return q
