"""The same double pendulum on a cart for MuJoCo: the model as MJCF.

MuJoCo's coordinates are those of :mod:`benchmarks.relative`.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from dpend import Params, Rig

CART_JOINT = "slider"


def mjcf(params: Params, timestep: float = 0.01) -> str:
    """Return MJCF text of the plant: a slider, two hinges, inertias as numbers, RK4, nothing to collide with.

    Parameters
    ----------
    params : Params
        One plant, its links' inertias greater than zero as MuJoCo asks.  Its Coulomb friction is left out: MuJoCo has
        no smooth one; :func:`benchmarks.relative.coulomb` gives it as a force to apply.
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
