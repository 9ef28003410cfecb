"""MuJoCo, an independent simulator, agrees with places, steps and the presets made after its models."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dpend
from benchmarks import mujoco_plant
from benchmarks.peers.cases import any_params, any_states
from benchmarks.relative import absolute, forces_to_relative, from_relative, to_relative
from dpend.params import Array

mujoco: Any = pytest.importorskip(
    "mujoco",
    reason="MuJoCo is not installed, so nothing here is compared with it; install the extra `peers`.",
)


def accelerations(model: Any, x: Array, f: Array) -> Array:
    """Return MuJoCo's accelerations (n, 3), link 2's absolute, in our states under our generalised forces."""
    data = mujoco.MjData(model)
    found = np.empty((len(x), 3))
    for i, (state, forces) in enumerate(zip(x, forces_to_relative(f), strict=True)):
        data.qpos[:], data.qvel[:] = to_relative(state)
        data.qfrc_applied[:] = forces
        mujoco.mj_forward(model, data)
        found[i] = absolute(data.qacc)
    return found


def assert_close(ours: Array, theirs: Array, tolerance: float = 1e-9) -> None:
    error = np.abs(ours - theirs) / np.maximum(1, np.abs(theirs))
    assert error.max() < tolerance, f"largest relative difference {error.max():.1e}"


def test_places_agree_with_mujoco() -> None:
    rng = np.random.default_rng(0)
    for _ in range(60):
        params = any_params(rng)
        model = mujoco.MjModel.from_xml_string(mujoco_plant.mjcf(params))
        data = mujoco.MjData(model)
        x = any_states(rng, 1)
        data.qpos[:], data.qvel[:] = to_relative(x[0])
        mujoco.mj_kinematics(model, data)
        places = [*data.body("link2").xpos[[0, 2]], *data.site("tip").xpos[[0, 2]]]
        assert_close(np.stack(dpend.positions(x[0], params)), np.array(places))


def test_runge_kutta_steps_agree_with_mujocos() -> None:
    rng = np.random.default_rng(0)
    for name in dpend.rigs():
        rig = dpend.rig(name).replace(force_limit=np.inf, sensor_noise=0.0)
        model = mujoco_plant.build(rig)
        data = mujoco.MjData(model)
        start = [0, np.pi / 2, -3, 0, 4, -5]
        stepper = dpend.Stepper(rig, 1)
        stepper.reset(start)
        data.qpos[:], data.qvel[:] = to_relative(start)
        for force in rng.uniform(-10, 10, 20):
            stepper.step([force])
            data.ctrl[0] = force
            mujoco.mj_step(model, data, rig.substeps)
            assert_close(stepper.x[0], from_relative(data.qpos, data.qvel))


def assert_made_of(model: Any, params: dpend.Params, link1: str, link2: str) -> None:
    """Compare what MuJoCo made of the shapes with a preset: masses, centres, inertias, lengths, frictions."""
    first, second = model.body(link1), model.body(link2)
    theirs = dpend.Params(
        cart_mass=model.body("cart").mass[0],
        mass1=first.mass[0],
        mass2=second.mass[0],
        length1=second.pos[2],
        length2=params.length2,  # nothing hangs on the tip, so MuJoCo's bodies do not say where it is
        com1=first.ipos[2],
        com2=second.ipos[2],
        inertia1=first.inertia[0],  # about an axis across the link
        inertia2=second.inertia[0],
        cart_friction=model.dof_damping[0],
        joint1_friction=model.dof_damping[1],
        joint2_friction=model.dof_damping[2],
        gravity=-model.opt.gravity[2],
    )
    assert params.coefficients() == pytest.approx(theirs.coefficients(), rel=1e-12, abs=1e-12)


def test_gymnasium_preset_is_made_and_moves_as_gymnasiums_own_model() -> None:
    gymnasium = pytest.importorskip("gymnasium.envs.mujoco", reason="Gymnasium's MuJoCo models are not installed.")
    path = Path(gymnasium.__file__).parent / "assets" / "inverted_double_pendulum.xml"
    model = mujoco.MjModel.from_xml_path(str(path))
    rig = dpend.rig("gymnasium_idp")
    assert_made_of(model, rig.params, "pole", "pole2")
    assert model.site("tip").pos[2] == rig.params.length2
    assert model.actuator_gear[0, 0] == rig.force_limit
    assert model.jnt_range[0, 1] == rig.track_limit

    model.opt.gravity[0] = 0  # the file lets gravity pull sideways by 1e-5, to tip a pole that stands still
    rng = np.random.default_rng(0)
    x = any_states(rng, 200) * [0.4, 1, 1, 1, 1, 1]  # off the ends of the track, which push back
    f = rng.uniform(-1, 1, (200, 3)) * [500, 50, 50]
    assert_close(dpend.rates(x, f, rig.params)[:, 3:], accelerations(model, x, f))


# Shapes and frictions of cartpole.xml in the DeepMind Control Suite, with a second pole as its two_poles task adds it.
TWO_POLES = """
<mujoco>
  <option gravity="0 0 -9.81"/>
  <worldbody>
    <body name="cart">
      <joint type="slide" axis="1 0 0" damping="5e-4"/>
      <geom type="box" size=".2 .15 .1" mass="1"/>
      <body name="pole_1">
        <joint type="hinge" axis="0 1 0" damping="2e-6"/>
        <geom type="capsule" fromto="0 0 0 0 0 1" size=".045" mass=".1"/>
        <body name="pole_2" pos="0 0 1">
          <joint type="hinge" axis="0 1 0" damping="2e-6"/>
          <geom type="capsule" fromto="0 0 0 0 0 1" size=".045" mass=".1"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def test_control_suite_preset_has_the_masses_and_inertias_of_its_shapes() -> None:
    assert_made_of(
        mujoco.MjModel.from_xml_string(TWO_POLES), dpend.rig("dm_control_two_poles").params, "pole_1", "pole_2"
    )
