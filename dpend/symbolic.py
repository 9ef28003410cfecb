"""The CasADi instances of the equations, for optimal control and exact derivatives."""

from __future__ import annotations

from typing import Any

import casadi

from . import equations
from .params import Params
from .rig import Rig

_rates = equations.make_rates(casadi.sin, casadi.cos)
_rk4 = equations.make_rk4(_rates)
_energies = equations.make_energies(casadi.cos)


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


def sample_function(rig: Rig, *, free_step: bool = False) -> Any:
    r"""Give :math:`(x_k, u_k) \mapsto x_{k+1}`, one sample under a held force, as a CasADi function.

    Parameters
    ----------
    rig : Rig
        The plant and its clock; actuator and sensors are left out.
    free_step : bool
        Whether the length of the sample is a third argument rather than the rig's.

    Returns
    -------
    casadi.Function
        Of the state (6) and the force on the cart (1), and with ``free_step`` of the sample time in s (1).
    """
    start, u, h = casadi.SX.sym("x", 6), casadi.SX.sym("u"), casadi.SX.sym("h")
    time = [h] if free_step else []
    step = substep_function(rig, free_step=free_step)
    x = start
    for _ in range(rig.substeps):
        x = step(x, u, *time)
    return casadi.Function("sample", [start, u, *time], [x])


def substep_function(rig: Rig, *, free_step: bool = False) -> Any:
    r"""Give one of the equal Runge-Kutta steps that make a sample under a held force, as a CasADi function.

    Parameters
    ----------
    rig : Rig
        The plant and its clock; actuator and sensors are left out.
    free_step : bool
        Whether the length of the sample is a third argument rather than the rig's.

    Returns
    -------
    casadi.Function
        Of the state (6) and the force on the cart (1), and with ``free_step`` of the sample time in s (1).
    """
    x, u, h = casadi.SX.sym("x", 6), casadi.SX.sym("u"), casadi.SX.sym("h")
    time = [h] if free_step else []
    step = (h if free_step else rig.sample_time) / rig.substeps
    end = _rk4(_split(x), (u, 0.0, 0.0), rig.params.coefficients(), step)
    return casadi.Function("substep", [x, u, *time], [casadi.vertcat(*end)])


def energy_function(params: Params) -> Any:
    r"""Give :math:`x \mapsto T + V`, the energy in J, as a CasADi function.

    Parameters
    ----------
    params : Params
        The plant; one, not a batch.

    Returns
    -------
    casadi.Function
        Of the state (6).
    """
    x = casadi.SX.sym("x", 6)
    kinetic, potential = _energies(_split(x), params.coefficients())
    return casadi.Function("energy", [x], [kinetic + potential])


def _split(x: Any) -> tuple[Any, ...]:
    return tuple(casadi.vertsplit(x))
