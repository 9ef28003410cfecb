"""The CasADi instances of the equations, for optimal control and exact derivatives."""

from __future__ import annotations

from typing import Any

import casadi

from . import equations
from .params import Params
from .rig import Rig

_rates = equations.make_rates(casadi.sin, casadi.cos)
_rk4 = equations.make_rk4(_rates)


def rates_function(params: Params) -> Any:
    r"""Give :math:`(x, f) \mapsto \dot x` as a CasADi function.

    Parameters
    ----------
    params : Params
        The plant; one, not a batch.

    Returns
    -------
    casadi.Function
        Of the state (6) and the generalised forces (3).
    """
    x, f = casadi.SX.sym("x", 6), casadi.SX.sym("f", 3)
    return casadi.Function("rates", [x, f], [casadi.vertcat(*_rates(_split(x), f, params.coefficients()))])


def sample_function(rig: Rig) -> Any:
    r"""Give :math:`(x_k, u_k) \mapsto x_{k+1}`, one sample under a held force, as a CasADi function.

    Parameters
    ----------
    rig : Rig
        The plant and its clock; actuator and sensors are left out.

    Returns
    -------
    casadi.Function
        Of the state (6) and the force on the cart (1).
    """
    start, u = casadi.SX.sym("x", 6), casadi.SX.sym("u")
    step = substep_function(rig)
    x = start
    for _ in range(rig.substeps):
        x = step(x, u)
    return casadi.Function("sample", [start, u], [x])


def substep_function(rig: Rig) -> Any:
    r"""Give one of the equal Runge-Kutta steps that make a sample under a held force, as a CasADi function.

    Parameters
    ----------
    rig : Rig
        The plant and its clock; actuator and sensors are left out.

    Returns
    -------
    casadi.Function
        Of the state (6) and the force on the cart (1).
    """
    x, u = casadi.SX.sym("x", 6), casadi.SX.sym("u")
    end = _rk4(_split(x), (u, 0.0, 0.0), rig.params.coefficients(), rig.sample_time / rig.substeps)
    return casadi.Function("substep", [x, u], [casadi.vertcat(*end)])


def _split(x: Any) -> tuple[Any, ...]:
    return tuple(casadi.vertsplit(x))
