"""The plant in Pinocchio."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.peers.engines import bodies, frictions
from benchmarks.relative import (
    absolute,
    coulomb,
    coulomb_slope,
    forces_to_relative,
    from_relative,
    mass_matrices,
    slopes,
    to_relative,
)
from dpend import Params
from dpend.params import Array

TOLERANCE = 1e-11

pinocchio: Any = import_module("pinocchio")  # it has no types


class Pinocchio:
    """The plant joint by joint; accelerations by the articulated-body algorithm, slopes by its analytic derivatives.

    It has no viscous friction in these algorithms, so that is applied too.
    """

    def __init__(self, params: Params) -> None:
        self.params = params
        still = pinocchio.SE3.Identity()
        self.model = model = pinocchio.Model()
        model.gravity.linear = np.array([0.0, 0.0, -params.gravity])
        cart = model.addJoint(0, pinocchio.JointModelPX(), still, "slider")
        link1 = model.addJoint(cart, pinocchio.JointModelRY(), still, "hinge1")
        joint2 = pinocchio.SE3(np.eye(3), np.array([0.0, 0.0, params.length1]))
        link2 = model.addJoint(link1, pinocchio.JointModelRY(), joint2, "hinge2")
        for joint, body in zip((cart, link1, link2), bodies(params), strict=True):
            lever = np.array([0.0, 0.0, body.centre])
            inertia = pinocchio.Inertia(body.mass, lever, body.inertia * np.eye(3))
            model.appendBodyToJoint(joint, inertia, still)
        self.data = model.createData()
        self.damping = np.diag(frictions(params))

    def accelerations(self, x: Array, f: Array) -> Array:
        """See :class:`Engine`."""
        f = f.copy()
        f[:, 0] += coulomb(self.params, x[:, 3])
        q, v = to_relative(x)
        tau = forces_to_relative(f) - v @ self.damping
        found = [pinocchio.aba(self.model, self.data, *each) for each in zip(q, v, tau, strict=True)]
        return absolute(np.array(found))

    def mass_matrices(self, x: Array) -> Array:
        """See :class:`Engine`."""
        found = np.array([pinocchio.crba(self.model, self.data, q).copy() for q in to_relative(x)[0]])
        upper = np.triu(found)
        return mass_matrices(upper + np.swapaxes(np.triu(found, 1), -1, -2))

    def energies(self, x: Array) -> Array:
        """See :class:`Engine`."""
        found = [
            (
                pinocchio.computeKineticEnergy(self.model, self.data, q, v),
                pinocchio.computePotentialEnergy(self.model, self.data, q),
            )
            for q, v in zip(*to_relative(x), strict=True)
        ]
        return np.array(found)

    def slopes(self, x: Array, u: float) -> tuple[Array, Array]:
        """See :class:`Engine`."""
        q, v = to_relative(x)
        tau = np.array([u + float(coulomb(self.params, x[3])), 0.0, 0.0]) - self.damping @ v
        by_q, by_v, by_tau = pinocchio.computeABADerivatives(self.model, self.data, q, v, tau)
        inverse = np.triu(by_tau) + np.triu(by_tau, 1).T
        friction = self.damping.copy()
        friction[0, 0] -= coulomb_slope(self.params, x[3])
        A, B = np.zeros((6, 6)), np.zeros((6, 1))
        A[:3, 3:] = np.eye(3)
        A[3:, :3] = by_q
        A[3:, 3:] = by_v - inverse @ friction
        B[3:, 0] = inverse[:, 0]
        return slopes(A, B)

    def trajectory(self, x0: Array, u: Array, hold: float) -> Array:
        """See :class:`Engine`; it has no integrator, so DOP853 of scipy integrates."""
        states = [np.asarray(x0, dtype=np.float64)]
        now = np.concatenate(to_relative(x0))
        tau = np.zeros(3)
        no_coulomb = not self.params.cart_coulomb

        for force in u:

            def slope(_: float, y: Array, force: float = force) -> Array:
                v = y[3:]
                tau[:] = -(self.damping @ v)
                tau[0] += force + (0.0 if no_coulomb else float(coulomb(self.params, v[0])))
                return np.concatenate([v, pinocchio.aba(self.model, self.data, y[:3], v, tau)])

            now = solve_ivp(slope, (0.0, hold), now, method="DOP853", rtol=TOLERANCE, atol=TOLERANCE).y[:, -1]
            states.append(from_relative(now[:3], now[3:]))
        return np.stack(states)
