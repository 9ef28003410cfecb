"""The equations of motion as do-mpc's example of a double inverted pendulum states them: implicit, for rods."""

from __future__ import annotations

from typing import Any

import casadi

from dpend import Params


def rods(params: Params) -> Any:
    """Return a ``do_mpc.model.Model`` of two rods without friction, not set up yet, for more to be added.

    States ``pos, theta, dpos, dtheta``, algebraic states ``ddpos, ddtheta``, input ``force``; the masses of the links
    are parameters ``m1, m2`` that the inertias do not follow.  Source: do-mpc, examples/double_inverted_pendulum.
    """
    import do_mpc

    gravity = params.gravity
    model = do_mpc.model.Model("continuous", "SX")
    mass1, mass2 = model.set_variable("_p", "m1"), model.set_variable("_p", "m2")
    model.set_variable("_x", "pos")
    theta = model.set_variable("_x", "theta", (2, 1))
    dpos = model.set_variable("_x", "dpos")
    dtheta = model.set_variable("_x", "dtheta", (2, 1))
    ddpos = model.set_variable("_z", "ddpos")
    ddtheta = model.set_variable("_z", "ddtheta", (2, 1))
    force = model.set_variable("_u", "force")

    half1, half2 = params.length1 / 2, params.length2 / 2
    inertia1, inertia2 = params.mass1 * half1**2 / 3, params.mass2 * half2**2 / 3
    first = mass1 * half1 + mass2 * params.length1
    second = mass2 * half2
    both = mass2 * half2 * params.length1
    s, c = [casadi.sin(theta[i]) for i in (0, 1)], [casadi.cos(theta[i]) for i in (0, 1)]
    between = theta[0] - theta[1]
    on_cart = (params.cart_mass + mass1 + mass2) * ddpos + first * c[0] * ddtheta[0] + second * c[1] * ddtheta[1]
    on_first = first * c[0] * ddpos + (mass1 * half1**2 + mass2 * params.length1**2 + inertia1) * ddtheta[0]
    on_second = second * c[1] * ddpos + both * casadi.cos(between) * ddtheta[0]
    motion = casadi.vertcat(
        on_cart - first * s[0] * dtheta[0] ** 2 - second * s[1] * dtheta[1] ** 2 - force,
        on_first
        + both * casadi.cos(between) * ddtheta[1]
        - first * gravity * s[0]
        + both * casadi.sin(between) * dtheta[1] ** 2,
        on_second
        + (mass2 * half2**2 + inertia2) * ddtheta[1]
        - both * casadi.sin(between) * dtheta[0] ** 2
        - second * gravity * s[1],
    )
    for name, rate in (("pos", dpos), ("theta", dtheta), ("dpos", ddpos), ("dtheta", ddtheta)):
        model.set_rhs(name, rate)
    model.set_alg("motion", motion)
    return model
