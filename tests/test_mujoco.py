"""MuJoCo, an independent simulator, built from the same ``Params``, agrees with the equations and the presets."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dpend
from benchmarks import mujoco_plant
from dpend.params import Array

mujoco: Any = pytest.importorskip(
    "mujoco",
    reason="MuJoCo is not installed, so nothing here is compared with it; install the extra `peers`.",
)

RIGS, STATES = 60, 20


def random_params(rng: np.random.Generator) -> dpend.Params:
    """Draw a plant of any proportions, with centres and inertias that are no rod's and every kind of friction."""
    length1, length2 = np.exp(rng.uniform(np.log(0.1), np.log(3), 2))
    mass1, mass2 = np.exp(rng.uniform(np.log(0.05), np.log(5), 2))
    return dpend.Params(
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


def random_states(rng: np.random.Generator, n: int) -> Array:
    """Draw states with the links at any angle, turns and all, and moving fast."""
    return rng.uniform(-1, 1, (n, 6)) * [2, 7, 7, 5, 15, 15]


def accelerations(model: Any, x: Array, f: Array) -> Array:
    """Return MuJoCo's accelerations (n, 3), link 2's absolute, in our states under our generalised forces."""
    data = mujoco.MjData(model)
    found = np.empty((len(x), 3))
    for i, (state, forces) in enumerate(zip(x, f, strict=True)):
        data.qpos[:], data.qvel[:] = mujoco_plant.to_mujoco(state)
        data.qfrc_applied[:] = mujoco_plant.forces_to_mujoco(forces)
        mujoco.mj_forward(model, data)
        found[i] = mujoco_plant.absolute(data.qacc)
    return found


def assert_close(ours: Array, theirs: Array, tolerance: float = 1e-9) -> None:
    error = np.abs(ours - theirs) / np.maximum(1, np.abs(theirs))
    assert error.max() < tolerance, f"largest relative difference {error.max():.1e}"


@pytest.mark.parametrize("seed", range(RIGS))
def test_accelerations_agree_with_mujoco_under_pushes_and_all_frictions(seed: int) -> None:
    rng = np.random.default_rng(seed)
    params = random_params(rng)
    x = random_states(rng, STATES)
    f = rng.uniform(-1, 1, (STATES, 3)) * [50, 20, 20]
    pushed = f.copy()
    pushed[:, 0] += mujoco_plant.coulomb(params, x[:, 3])
    theirs = accelerations(mujoco.MjModel.from_xml_string(mujoco_plant.mjcf(params)), x, pushed)
    assert_close(dpend.rates(x, f, params)[:, 3:], theirs)


@pytest.mark.parametrize("seed", range(RIGS))
def test_energies_and_places_agree_with_mujoco(seed: int) -> None:
    rng = np.random.default_rng(seed)
    params = random_params(rng)
    model = mujoco.MjModel.from_xml_string(mujoco_plant.mjcf(params))
    data = mujoco.MjData(model)
    x = random_states(rng, STATES)
    kinetic, potential, places = np.empty(STATES), np.empty(STATES), np.empty((STATES, 4))
    for i, state in enumerate(x):
        data.qpos[:], data.qvel[:] = mujoco_plant.to_mujoco(state)
        mujoco.mj_forward(model, data)
        mujoco.mj_energyPos(model, data)
        mujoco.mj_energyVel(model, data)
        potential[i], kinetic[i] = data.energy
        places[i] = *data.body("link2").xpos[[0, 2]], *data.site("tip").xpos[[0, 2]]
    energies = dpend.energies(x, params)
    assert_close(energies.kinetic, kinetic)
    assert_close(energies.potential - energies.potential[0], potential - potential[0])
    assert_close(np.stack(dpend.positions(x, params), axis=-1), places)


def test_runge_kutta_steps_agree_with_mujocos() -> None:
    rng = np.random.default_rng(0)
    for name in dpend.rigs():
        rig = dpend.rig(name).replace(force_limit=np.inf, sensor_noise=0.0)
        model = mujoco_plant.build(rig)
        data = mujoco.MjData(model)
        start = [0, np.pi / 2, -3, 0, 4, -5]
        stepper = dpend.Stepper(rig, 1)
        stepper.reset(start)
        data.qpos[:], data.qvel[:] = mujoco_plant.to_mujoco(start)
        for force in rng.uniform(-10, 10, 20):
            stepper.step([force])
            data.ctrl[0] = force
            mujoco.mj_step(model, data, rig.substeps)
            assert_close(stepper.x[0], mujoco_plant.from_mujoco(data.qpos, data.qvel))


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
    x = random_states(rng, 200) * [0.4, 1, 1, 1, 1, 1]  # off the ends of the track, which push back
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
