"""The numpy instances of the equations, on states of any shape ``(..., 6)``, real or complex."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from . import equations
from .params import Array, Params

_rates = equations.make_rates(np.sin, np.cos)
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


def _numbers(x: npt.ArrayLike) -> npt.NDArray[Any]:
    x = np.asarray(x)
    x = x.astype(np.complex128 if np.iscomplexobj(x) else np.float64, copy=False)
    if x.ndim == 0 or x.shape[-1] != 6:
        raise ValueError(f"A state has six numbers: expected an array of shape (..., 6); got shape {x.shape}.")
    return x


def rates(x: npt.ArrayLike, u: npt.ArrayLike, params: Params) -> npt.NDArray[Any]:
    r"""Return :math:`\dot x = (\dot q, D^{-1}(f - f_\text{friction} - C\dot q - G))`.

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
    ValueError
        If a state does not have six numbers, or the forces have another shape.
    """
    x = _numbers(x)
    u = np.asarray(u)
    generalised = u.ndim == x.ndim and u.shape[-1] == 3
    if u.ndim == x.ndim > 1 and u.shape[-1] == 1:
        raise ValueError(
            f"Expected forces on the cart of shape {x.shape[:-1]}, or generalised forces of shape "
            f"{(*x.shape[:-1], 3)}; got shape {u.shape}."
        )
    f = (u[..., 0], u[..., 1], u[..., 2]) if generalised else (u, 0.0, 0.0)
    columns = _rates(np.moveaxis(x, -1, 0), f, params.coefficients())
    return np.stack(np.broadcast_arrays(*columns), axis=-1)


def energies(x: npt.ArrayLike, params: Params) -> Energies:
    r"""Return :math:`T = \tfrac12\dot q^\top D\dot q` and :math:`V = f_1\cos\theta_1 + f_2\cos\theta_2` in J.

    Parameters
    ----------
    x : array_like
        States ``(..., 6)``.
    params : Params
        The plant.

    Returns
    -------
    Energies
        ``kinetic`` and ``potential``, each ``(...)``; ``total`` is their sum.
    """
    return Energies(*_energies(np.moveaxis(_numbers(x), -1, 0), params.coefficients()))


def positions(x: npt.ArrayLike, params: Params) -> Positions:
    """Return where the second joint and the tip are, in m.

    Parameters
    ----------
    x : array_like
        States ``(..., 6)``.
    params : Params
        The plant.

    Returns
    -------
    Positions
        ``x_joint``, ``y_joint``, ``x_tip``, ``y_tip``, each ``(...)``.
    """
    return Positions(*_positions(np.moveaxis(_numbers(x), -1, 0), params.coefficients()))


def reference(
    params: Params, x0: npt.ArrayLike, u: npt.ArrayLike, t: npt.ArrayLike, *, rtol: float = 1e-12, atol: float = 1e-12
) -> Array:
    r"""Integrate :math:`\dot x = \mathrm{rates}(x, u)` by DOP853, as a check on the fixed-step integrator.

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
    ValueError
        If the forces do not match the intervals between the times.
    """
    from scipy.integrate import solve_ivp  # only checks need scipy's integrators

    times = np.asarray(t, dtype=np.float64)
    forces = np.asarray(u, dtype=np.float64)
    if len(forces) != len(times) - 1:
        raise ValueError(f"Expected one force for each of the {len(times) - 1} intervals; got {len(forces)}.")
    states = [np.asarray(x0, dtype=np.float64)]
    for force, start, end in zip(forces, times[:-1], times[1:], strict=True):
        solution = solve_ivp(
            lambda _, x, held=force: rates(x, held, params),
            (start, end),
            states[-1],
            method="DOP853",
            rtol=rtol,
            atol=atol,
        )
        states.append(solution.y[:, -1])
    return np.stack(states)
