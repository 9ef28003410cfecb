"""The plant in MuJoCo."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np

from benchmarks.mujoco_plant import mjcf
from benchmarks.peers.engines import STEP
from benchmarks.relative import (
    absolute,
    coulomb,
    coulomb_slope,
    forces_to_relative,
    from_relative,
    mass_matrices,
    to_relative,
)
from dpend import Params
from dpend.params import Array

mujoco: Any = import_module("mujoco")  # it has no types

_REACH = 3e-3
# Weights of central differences at 1, 2, 3 and 4 steps: the error is of the eighth order.
_WEIGHTS = (4 / 5, -1 / 5, 4 / 105, -1 / 280)


class MuJoCo:
    """The plant as MJCF; mass matrix and accelerations from its forward pass, slopes by differences of these."""

    def __init__(self, params: Params) -> None:
        self.params = params
        self.model = mujoco.MjModel.from_xml_string(mjcf(params, STEP))
        self.data = mujoco.MjData(self.model)

    def _at(self, x: Array) -> None:
        self.data.qpos[:], self.data.qvel[:] = to_relative(x)

    def accelerations(self, x: Array, f: Array) -> Array:
        """See :class:`Engine`."""
        f = f.copy()
        f[:, 0] += coulomb(self.params, x[:, 3])
        found = np.empty((len(x), 3))
        for i, (state, forces) in enumerate(zip(x, forces_to_relative(f), strict=True)):
            self._at(state)
            self.data.qfrc_applied[:] = forces
            mujoco.mj_forward(self.model, self.data)
            found[i] = self.data.qacc
        self.data.qfrc_applied[:] = 0
        return absolute(found)

    def mass_matrices(self, x: Array) -> Array:
        """See :class:`Engine`."""
        found = np.empty((len(x), 3, 3))
        for i, state in enumerate(x):
            self._at(state)
            mujoco.mj_forward(self.model, self.data)
            for j, unit in enumerate(np.eye(3)):
                mujoco.mj_mulM(self.model, self.data, found[i, j], unit)
        return mass_matrices(found)

    def energies(self, x: Array) -> Array:
        """See :class:`Engine`."""
        found = np.empty((len(x), 2))
        for i, state in enumerate(x):
            self._at(state)
            mujoco.mj_forward(self.model, self.data)
            mujoco.mj_energyPos(self.model, self.data)
            mujoco.mj_energyVel(self.model, self.data)
            found[i] = self.data.energy[::-1]
        return found

    def slopes(self, x: Array, u: float) -> tuple[Array, Array]:
        """See :class:`Engine`."""
        pulled = u + float(coulomb(self.params, x[3]))
        point = np.append(x, pulled)
        found = np.zeros((6, 7))
        for k, weight in enumerate(_WEIGHTS, start=1):
            for sign in (1, -1):
                moved = point + sign * k * _REACH * np.eye(7)
                f = np.zeros((7, 3))
                f[:, 0] = moved[:, 6] - coulomb(self.params, moved[:, 3])  # held, where accelerations would add it
                rates = np.concatenate([moved[:, 3:6], self.accelerations(moved[:, :6], f)], axis=-1)
                found += sign * weight / _REACH * rates.T
        A, B = found[:, :6], found[:, 6:]
        A[:, 3] += B[:, 0] * coulomb_slope(self.params, x[3])
        return A, B

    def trajectory(self, x0: Array, u: Array, hold: float) -> Array:
        """See :class:`Engine`; by MuJoCo's Runge-Kutta method of order 4."""
        states = [np.asarray(x0, dtype=np.float64)]
        self._at(states[0])
        for force in u:
            self.data.ctrl[0] = force
            mujoco.mj_step(self.model, self.data, round(hold / STEP))
            states.append(from_relative(self.data.qpos, self.data.qvel))
        return np.stack(states)
