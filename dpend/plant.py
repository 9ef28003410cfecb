"""The numpy instances of the equations, on states of any shape ``(..., 6)``, real or complex."""

from __future__ import annotations

import itertools
import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from . import equations
from .arguments import checked_array, checked_positive
from .params import Array, Params, checked_params
from .state import one_state, state_rows

PUSHES = {"push_cart": "on cart [N]", "push_link1": "on link 1 [N m]", "push_link2": "on link 2 [N m]"}
"""What a run's log calls the generalised forces that acted beside the actuator, and what figures call them."""

_MOST_EVALUATIONS = 30_000  # of the rates, in an interval of the reference

_rates = equations.make_rates(np.sin, np.cos)
_scalar_rates = equations.make_rates(math.sin, math.cos)
_energies = equations.make_energies(np.cos)
_positions = equations.make_positions(np.sin, np.cos)


class Energies(NamedTuple):
    """Kinetic and potential energy, J."""

    kinetic: Array
    potential: Array

    @property
    def total(self) -> Array:
        """Kinetic plus potential energy, J."""
        return self.kinetic + self.potential


class Positions(NamedTuple):
    """Places of the second joint and of the tip, m; heights above the cart's joint."""

    x_joint: Array
    y_joint: Array
    x_tip: Array
    y_tip: Array


def rates(x: npt.ArrayLike, u: npt.ArrayLike, params: Params) -> npt.NDArray[Any]:
    r"""Return :math:`\dot x = (\dot q, D^{-1}(f - f_\text{friction} - C\dot q - G))`.

    These are the equations of motion, stated once for every kind of number.

    Parameters
    ----------
    x : array_like
        States ``(..., 6)``; complex numbers are taken too, for derivatives by the complex step.
    u : array_like
        Force on the cart, N, broadcast against ``x.shape[:-1]``; or, with as many axes as ``x`` and three entries in
        the last, the generalised forces on cart (N), link 1 and link 2 (N m).
    params : Params
        The plant, or one plant per row where its fields are arrays.

    Returns
    -------
    ndarray
        Time derivatives ``(..., 6)``.

    Raises
    ------
    TypeError
        If states or forces are not numbers, or ``params`` is something else, such as a rig.
    ValueError
        If a state does not have six numbers, or the forces or plants have another shape.

    See Also
    --------
    dpend.linearize : Their derivatives.
    dpend.reference : Their solution.

    Examples
    --------
    >>> import dpend
    >>> rig = dpend.rig("gustafsson2016")
    >>> dpend.rates([0, 0, 0, 0, 0, 0], 1.0, rig.params)[3:] > 0
    array([ True, False,  True])
    """
    x = state_rows("x", x, complex_too=True)
    u = checked_array("u", u, "forces on the cart, or generalised forces (..., 3)", finite=False, complex_too=True)
    c = checked_params("rates", params).coefficients()
    generalised = u.ndim == x.ndim and u.shape[-1] == 3
    if u.ndim == x.ndim > 1 and u.shape[-1] == 1:
        raise ValueError(
            f"Expected forces on the cart of shape {x.shape[:-1]}, or generalised forces of shape "
            f"{(*x.shape[:-1], 3)}; got shape {u.shape}."
        )
    f = (u[..., 0], u[..., 1], u[..., 2]) if generalised else (u, 0.0, 0.0)
    try:
        return np.stack(np.broadcast_arrays(*_rates(np.moveaxis(x, -1, 0), f, c)), axis=-1)
    except ValueError:
        raise _unfit(x, params, f" and forces of shape {u.shape}") from None


def _unfit(x: npt.NDArray[Any], params: Params, forces: str = "") -> ValueError:
    plants = "one plant" if params.n is None else f"{params.n} plants"
    return ValueError(f"States of shape {x.shape}{forces} do not broadcast for {plants}.")


def energies(x: npt.ArrayLike, params: Params) -> Energies:
    r"""Return :math:`T = \tfrac12\dot q^\top D\dot q` and :math:`V = f_1\cos\theta_1 + f_2\cos\theta_2` in J.

    The potential energy is zero where both centres of mass are at the height of the cart's joint.

    Parameters
    ----------
    x : array_like
        States ``(..., 6)``.
    params : Params
        The plant, or one plant per row where its fields are arrays.

    Returns
    -------
    Energies
        ``kinetic`` and ``potential``, each ``(...)``; ``total`` is their sum.

    See Also
    --------
    dpend.positions : Where joint and tip are.

    Examples
    --------
    >>> import dpend
    >>> rig = dpend.rig("gustafsson2016")
    >>> energy = dpend.energies([0, 0, 0, 0, 0, 0], rig.params)
    >>> float(energy.kinetic), round(float(energy.potential), 2)
    (0.0, 9.81)
    """
    x, c = state_rows("x", x, complex_too=True), checked_params("energies", params).coefficients()
    try:
        return Energies(*_energies(np.moveaxis(x, -1, 0), c))
    except ValueError:
        raise _unfit(x, params) from None


def positions(x: npt.ArrayLike, params: Params) -> Positions:
    """Return where the second joint and the tip are, in m.

    Heights count from the cart's joint.

    Parameters
    ----------
    x : array_like
        States ``(..., 6)``.
    params : Params
        The plant, or one plant per row where its fields are arrays.

    Returns
    -------
    Positions
        ``x_joint``, ``y_joint``, ``x_tip``, ``y_tip``, each ``(...)``.

    See Also
    --------
    dpend.energies : How high, in J.

    Examples
    --------
    >>> import dpend
    >>> rig = dpend.rig("gustafsson2016")
    >>> float(dpend.positions([0, 0, 0, 0, 0, 0], rig.params).y_tip)
    2.0
    """
    x, c = state_rows("x", x, complex_too=True), checked_params("positions", params).coefficients()
    try:
        return Positions(*_positions(np.moveaxis(x, -1, 0), c))
    except ValueError:
        raise _unfit(x, params) from None


def reference(
    params: Params, x0: npt.ArrayLike, u: npt.ArrayLike, t: npt.ArrayLike, *, rtol: float = 1e-12, atol: float = 1e-12
) -> Array:
    r"""Return :math:`x(t)` of :math:`\dot x = \mathrm{rates}(x, u)` by DOP853, as a check on the fixed-step integrator.

    It takes milliseconds where the fixed step takes microseconds.

    Parameters
    ----------
    params : Params
        The plant.
    x0 : array_like
        The state ``(6,)`` at ``t[0]``.
    u : array_like
        Force ``(len(t) - 1,)``, or generalised forces ``(len(t) - 1, 3)``, held between the times.
    t : array_like
        Increasing times ``(T + 1,)``, s.
    rtol, atol : float
        Tolerances of the integrator.

    Returns
    -------
    ndarray
        States ``(T + 1, 6)`` at the times.

    Raises
    ------
    TypeError
        If an argument is not made of numbers, or ``params`` is something else, such as a rig.
    ValueError
        If a number is not finite, there are several plants, the state is not one, the times do not increase, or the
        forces do not match the intervals between them.
    RuntimeError
        If an interval takes more than 30 000 evaluations of the rates, as from rates beyond all reason.

    See Also
    --------
    dpend.simulate : With the fixed step.

    Examples
    --------
    >>> import dpend
    >>> rig = dpend.rig("gustafsson2016")
    >>> dpend.reference(rig.params, [0, 0, 0, 0, 0, 0], [1.0], [0.0, 0.1]).shape
    (2, 6)
    """
    if checked_params("reference", params).n is not None:
        raise ValueError(f"reference takes one plant; got Params with arrays of {params.n} rows.")
    state = one_state("x0", x0)
    times = checked_array("t", t, "increasing times (T + 1,), s")
    if times.ndim != 1 or not (len(times) and (np.diff(times) > 0).all()):
        raise ValueError(f"t must be increasing times of shape (T + 1,), s; got {t!r}.")
    forces = checked_array("u", u, "one force, or three, for each interval")
    if forces.shape not in ((len(times) - 1,), (len(times) - 1, 3)):
        raise ValueError(f"Expected one force, or three, for each of {len(times) - 1} intervals; got {forces.shape}.")
    for name, tolerance in (("rtol", rtol), ("atol", atol)):
        checked_positive(name, tolerance)
    states = [state]
    for force, start, end in zip(forces, times[:-1], times[1:], strict=True):
        states.append(_integrated(params, states[-1], force, start, end, rtol, atol))
    return np.stack(states)


def _integrated(params: Params, x0: Array, force: Array, start: float, end: float, rtol: float, atol: float) -> Array:
    from scipy.integrate import solve_ivp  # only checks need scipy's integrators

    spent = itertools.count(1)
    c = params.coefficients()
    f = force.tolist() if force.ndim else (float(force), 0.0, 0.0)

    def slope(_: float, x: Array) -> Array:
        numbers = x.tolist()
        if next(spent) > _MOST_EVALUATIONS or not all(map(math.isfinite, numbers)):
            raise failed
        return np.array(_scalar_rates(numbers, f, c))

    failed = RuntimeError(
        f"The reference cannot follow the motion from {start:g} s to {end:g} s, which starts at {x0}: are the units "
        "right (radians, metres, newtons)? Else make the interval shorter, or rtol and atol larger."
    )
    with np.errstate(over="ignore", invalid="ignore"):
        solution = solve_ivp(slope, (start, end), x0, method="DOP853", rtol=rtol, atol=atol)
    if not solution.success:
        raise failed
    return solution.y[:, -1]
