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
    r"""Return :math:`(x, f) \mapsto \dot x`, the equations of motion, as a CasADi function.

    From the state ``(6,)`` and the generalised forces on cart (N) and links (N m), ``(3,)``, to the state's rate
    ``(6,)``; as :func:`dpend.rates`, of one plant.
    """
    x, f = casadi.SX.sym("x", 6), casadi.SX.sym("f", 3)
    return casadi.Function("rates", [x, f], [casadi.vertcat(*_rates(_split(x), f, params.coefficients()))])


def sample_function(rig: Rig, *, free_step: bool = False) -> Any:
    r"""Return :math:`(x_k, u_k) \mapsto x_{k+1} = \Phi^n(x_k, u_k)`, a sample of n substeps, as a CasADi function.

    From the state ``(6,)`` and the force on the cart in N, held, to the state ``(6,)`` afterwards; actuator and sensors
    are left out.  With ``free_step`` the length of the sample in s is a third argument rather than the rig's.
    """
    start, u, h = casadi.SX.sym("x", 6), casadi.SX.sym("u"), casadi.SX.sym("h")
    time = [h] if free_step else []
    step = substep_function(rig, free_step=free_step)
    x = start
    for _ in range(rig.substeps):
        x = step(x, u, *time)
    return casadi.Function("sample", [start, u, *time], [x])


def substep_function(rig: Rig, *, free_step: bool = False) -> Any:
    r"""Return :math:`\Phi(x, u)`, one Runge-Kutta step of length :math:`T/n`; :func:`sample_function` does n of them.

    Optimal control that is built of steps rather than samples has smaller derivatives.
    """
    x, u, h = casadi.SX.sym("x", 6), casadi.SX.sym("u"), casadi.SX.sym("h")
    time = [h] if free_step else []
    step = (h if free_step else rig.sample_time) / rig.substeps
    end = _rk4(_split(x), (u, 0.0, 0.0), rig.params.coefficients(), step)
    return casadi.Function("substep", [x, u, *time], [casadi.vertcat(*end)])


def energy_function(params: Params) -> Any:
    r"""Return :math:`x \mapsto E = E_\text{kin} + E_\text{pot}`, J, as a CasADi function, of one plant.

    Zero is rest with both centres of mass at the height of the cart's joint; as :func:`dpend.energies`.
    """
    x = casadi.SX.sym("x", 6)
    kinetic, potential = _energies(_split(x), params.coefficients())
    return casadi.Function("energy", [x], [kinetic + potential])


def _split(x: Any) -> tuple[Any, ...]:
    return tuple(casadi.vertsplit(x))
