"""The plant in Drake."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np

from benchmarks.peers.engines import Body, bodies, frictions
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

drake: Any = import_module("pydrake.all")  # its types are not for every release of Python

ACCURACY = 1e-9


class Drake:
    """The plant as a ``MultibodyPlant`` in continuous time; slopes by its automatic differentiation."""

    def __init__(self, params: Params) -> None:
        self.params = params
        self.plant = plant = drake.MultibodyPlant(0.0)
        cart, link1, link2 = map(self._body, ("cart", "link1", "link2"), bodies(params))
        across, along = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
        infinity, damping = np.inf, frictions(params)
        world, frame = plant.world_body().body_frame(), cart.body_frame()
        slider = drake.PrismaticJoint("slider", world, frame, along, -infinity, infinity, damping[0])
        plant.AddJoint(slider)
        plant.AddJoint(drake.RevoluteJoint("hinge1", frame, link1.body_frame(), across, damping[1]))
        above = drake.RigidTransform(np.array([0.0, 0.0, params.length1]))
        joint2 = plant.AddFrame(drake.FixedOffsetFrame("joint2", link1.body_frame(), above))
        plant.AddJoint(drake.RevoluteJoint("hinge2", joint2, link2.body_frame(), across, damping[2]))
        plant.AddJointActuator("motor", plant.GetJointByName("slider"))
        plant.mutable_gravity_field().set_gravity_vector(np.array([0.0, 0.0, -params.gravity]))
        plant.Finalize()
        self.context = plant.CreateDefaultContext()
        self.actuation, self.applied = (
            plant.get_actuation_input_port(),
            plant.get_applied_generalized_force_input_port(),
        )
        self._push(np.zeros(3))
        self.actuation.FixValue(self.context, np.zeros(1))

    def _body(self, name: str, body: Body) -> Any:
        lever = np.array([0.0, 0.0, body.centre])
        about_centre = drake.RotationalInertia(body.inertia, body.inertia, body.inertia)
        made = drake.SpatialInertia.MakeFromCentralInertia(body.mass, lever, about_centre)
        return self.plant.AddRigidBody(name, made)

    def _push(self, f: Array) -> None:
        self.applied.FixValue(self.context, f)

    def _at(self, x: Array) -> None:
        self.plant.SetPositionsAndVelocities(self.context, np.concatenate(to_relative(x)))

    def accelerations(self, x: Array, f: Array) -> Array:
        """See :class:`Engine`."""
        f = f.copy()
        f[:, 0] += coulomb(self.params, x[:, 3])
        found = np.empty((len(x), 3))
        for i, (state, forces) in enumerate(zip(x, forces_to_relative(f), strict=True)):
            self._at(state)
            self._push(forces)
            found[i] = self.plant.EvalTimeDerivatives(self.context).CopyToVector()[3:]
        self._push(np.zeros(3))
        return absolute(found)

    def mass_matrices(self, x: Array) -> Array:
        """See :class:`Engine`."""
        found = np.empty((len(x), 3, 3))
        for i, state in enumerate(x):
            self._at(state)
            found[i] = self.plant.CalcMassMatrix(self.context)
        return mass_matrices(found)

    def energies(self, x: Array) -> Array:
        """See :class:`Engine`."""
        found = np.empty((len(x), 2))
        for i, state in enumerate(x):
            self._at(state)
            found[i] = self.plant.EvalKineticEnergy(self.context), self.plant.EvalPotentialEnergy(self.context)
        return found

    def slopes(self, x: Array, u: float) -> tuple[Array, Array]:
        """See :class:`Engine`."""
        self._at(x)
        self._push(np.array([float(coulomb(self.params, x[3])), 0.0, 0.0]))
        self.actuation.FixValue(self.context, np.array([u]))
        port = self.actuation.get_index()
        linear = drake.FirstOrderTaylorApproximation(
            self.plant, self.context, port, drake.OutputPortSelection.kNoOutput
        )
        self._push(np.zeros(3))
        A, B = slopes(linear.A(), linear.B())
        A[:, 3] += B[:, 0] * coulomb_slope(self.params, x[3])
        return A, B

    def trajectory(self, x0: Array, u: Array, hold: float) -> Array:
        """See :class:`Engine`; by Drake's Runge-Kutta method of order 5 with error control.

        Coulomb friction, which would have to change with the state, is left out.
        """
        simulator = drake.Simulator(self.plant, self.context)
        drake.ResetIntegratorFromFlags(simulator, "runge_kutta5", hold)
        simulator.get_mutable_integrator().set_target_accuracy(ACCURACY)
        self.context.SetTime(0.0)
        states = [np.asarray(x0, dtype=np.float64)]
        self._at(states[0])
        for k, force in enumerate(u, start=1):
            self.actuation.FixValue(self.context, np.array([force]))
            simulator.AdvanceTo(k * hold)
            y = self.plant.GetPositionsAndVelocities(self.context)
            states.append(from_relative(y[:3], y[3:]))
        return np.stack(states)
