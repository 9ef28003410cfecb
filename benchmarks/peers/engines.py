"""What is asked of an independent engine of rigid bodies, and which engines there are."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from typing import NamedTuple, Protocol

import numpy as np

from dpend import Params
from dpend.params import Array

STEP = 0.005
"""Length of the Runge-Kutta steps of an engine that does not control its error, s."""


class Engine(Protocol):
    """One plant in an engine's own model, answering in our states, angles and generalised forces."""

    def accelerations(self, x: Array, f: Array) -> Array:
        """Return accelerations ``(n, 3)`` in states ``(n, 6)`` under generalised forces ``(n, 3)``."""
        ...

    def mass_matrices(self, x: Array) -> Array:
        """Return mass matrices ``(n, 3, 3)``."""
        ...

    def energies(self, x: Array) -> Array:
        """Return kinetic energies and potential ones, up to a constant, ``(n, 2)``, J."""
        ...

    def slopes(self, x: Array, u: float) -> tuple[Array, Array]:
        """Return A ``(6, 6)`` and B ``(6, 1)`` at a state ``(6,)`` under a force on the cart."""
        ...

    def trajectory(self, x0: Array, u: Array, hold: float) -> Array:
        """Return states ``(T + 1, 6)`` under forces ``(T,)`` on the cart, each held for so many seconds."""
        ...


class Body(NamedTuple):
    """Mass, kg, height of its centre above its joint, m, and moment of inertia about that centre, kg m^2, of a body."""

    mass: float
    centre: float
    inertia: float


def bodies(params: Params) -> tuple[Body, Body, Body]:
    """Return cart, link 1 and link 2; the cart does not turn, so its inertia may be any."""
    centres, inertias = params.centers, params.inertias
    links = zip((params.mass1, params.mass2), centres, inertias, strict=True)
    link1, link2 = (Body(*map(float, each)) for each in links)
    return Body(float(params.cart_mass), 0.0, 1.0), link1, link2


def frictions(params: Params) -> Array:
    """Return the viscous frictions of cart, N s/m, and joints, N m s, ``(3,)``."""
    return np.array([float(b) for b in (params.cart_friction, params.joint1_friction, params.joint2_friction)])


class Known(NamedTuple):
    """An engine that may be installed."""

    package: str
    module: str
    name: str


ENGINES = {
    "MuJoCo": Known("mujoco", "mujoco", "MuJoCo"),
    "Pinocchio": Known("pin", "pinocchio", "Pinocchio"),
    "Drake": Known("drake", "pydrake", "Drake"),
}


def installed(name: str) -> bool:
    """Return whether an engine can be imported."""
    return find_spec(ENGINES[name].module) is not None


def load(name: str) -> Callable[[Params], Engine]:
    """Return what builds a plant in an engine; an ImportError where that is not installed."""
    known = ENGINES[name]
    return getattr(import_module(f"benchmarks.peers.in_{known.module}"), known.name)
