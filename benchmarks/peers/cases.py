"""Random plants, states and forces to compare engines on, and how far apart two answers are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dpend import Params
from dpend.params import Array


@dataclass(frozen=True)
class Row:
    """One line of the table: how far this package and an engine are apart at most, over so many cases.

    ``unanswered`` counts the cases besides in which the engine gave up.
    """

    quantity: str
    engine: str
    cases: int
    unanswered: int
    median: float
    worst: float
    tolerance: float


def row(quantity: str, engine: str, errors: npt.ArrayLike, tolerance: float, unanswered: int = 0) -> Row:
    """Return the line for the errors of all cases; an error that is no number counts as infinite."""
    found = np.nan_to_num(np.ravel(np.asarray(errors, dtype=np.float64)), nan=np.inf)
    return Row(quantity, engine, found.size, unanswered, float(np.median(found)), float(found.max()), tolerance)


def error(ours: npt.ArrayLike, theirs: npt.ArrayLike) -> Array:
    r"""Return :math:`\max_i |a_i - b_i| / \max(1, |b_i|)` of each case, the first axis counting cases."""
    ours, theirs = np.asarray(ours, dtype=np.float64), np.asarray(theirs, dtype=np.float64)
    apart = np.abs(ours - theirs) / np.maximum(1.0, np.abs(theirs))
    return apart.reshape(len(apart), -1).max(axis=1)


def matrix_error(ours: npt.ArrayLike, theirs: npt.ArrayLike) -> float:
    r"""Return :math:`\max_{ij} |A_{ij} - B_{ij}| / \max_{ij} |B_{ij}|` of two matrices."""
    ours, theirs = np.asarray(ours, dtype=np.float64), np.asarray(theirs, dtype=np.float64)
    return float(np.abs(ours - theirs).max() / np.abs(theirs).max())


def any_params(rng: np.random.Generator) -> Params:
    """Draw a plant of any proportions, with centres and inertias that are no rod's and every kind of friction."""
    length1, length2 = np.exp(rng.uniform(np.log(0.1), np.log(3), 2))
    mass1, mass2 = np.exp(rng.uniform(np.log(0.05), np.log(5), 2))
    return Params(
        cart_mass=float(np.exp(rng.uniform(np.log(0.05), np.log(10)))),
        mass1=mass1,
        mass2=mass2,
        length1=length1,
        length2=length2,
        com1=length1 * rng.uniform(0, 1.2),
        com2=length2 * rng.uniform(0, 1.2),
        inertia1=mass1 * length1**2 * rng.uniform(0.02, 0.5),
        inertia2=mass2 * length2**2 * rng.uniform(0.02, 0.5),
        cart_friction=rng.uniform(0, 2),
        joint1_friction=rng.uniform(0, 0.5),
        joint2_friction=rng.uniform(0, 0.5),
        cart_coulomb=rng.uniform(0, 3),
        coulomb_speed=rng.uniform(0.001, 0.1),
        gravity=rng.uniform(1, 25),
    )


def rods(rng: np.random.Generator, *, friction: bool = True) -> Params:
    """Draw two rods on a cart as a laboratory might have them, with viscous frictions or none."""
    return Params(
        cart_mass=rng.uniform(0.3, 3),
        mass1=rng.uniform(0.1, 1.5),
        mass2=rng.uniform(0.1, 1.5),
        length1=rng.uniform(0.3, 1.5),
        length2=rng.uniform(0.3, 1.5),
        cart_friction=friction * rng.uniform(0, 2),
        joint1_friction=friction * rng.uniform(0, 0.1),
        joint2_friction=friction * rng.uniform(0, 0.1),
        gravity=rng.uniform(5, 15),
    )


def any_states(rng: np.random.Generator, n: int) -> Array:
    """Draw states ``(n, 6)`` with the links at any angle, turns and all, and moving fast."""
    return rng.uniform(-1, 1, (n, 6)) * [2, 7, 7, 5, 15, 15]


def any_forces(rng: np.random.Generator, n: int) -> Array:
    """Draw generalised forces ``(n, 3)`` on cart, N, and links, N m."""
    return rng.uniform(-1, 1, (n, 3)) * [50, 20, 20]
