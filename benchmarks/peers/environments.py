"""Other people's environments stepped beside the presets that are made after them, from the same states and forces."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import gymnasium
import numpy as np

import dpend
from benchmarks.peers.cases import Row, error, row
from benchmarks.relative import from_relative, to_relative
from dpend.params import Array

_SAMPLES = 20  # of each motion


def _start(rng: np.random.Generator) -> Array:
    return rng.uniform(-1, 1, 6) * [0.2, np.pi, np.pi, 0.5, 3, 3]


def gymnasium_idp(n: int, seed: int, *, sideways: bool) -> list[Row]:
    """Step ``InvertedDoublePendulum-v5`` with random actions; ``sideways`` keeps the gravity that its file has.

    That pulls sideways by 1e-5 m/s^2, to tip a pole that stands still.  Motions begin anywhere and are compared sample
    by sample up to 0.1 m before the end of the track, which pushes back.
    """
    rng = np.random.default_rng(seed)
    env: Any = gymnasium.make("InvertedDoublePendulum-v5").unwrapped
    env.reset(seed=seed)
    if not sideways:
        env.model.opt.gravity[0] = 0.0
    rig = dpend.rig("gymnasium_idp")
    stepper = dpend.Stepper(rig, 1)
    errors: list[Array] = []
    while len(errors) < n:
        x0 = _start(rng)
        stepper.reset(x0)
        env.set_state(*to_relative(x0))
        for action in rng.uniform(-0.5, 0.5, _SAMPLES).astype(np.float32):
            env.step(np.array([action]))
            stepper.step([float(rig.force_limit) * float(action)])
            if abs(stepper.x[0, 0]) > rig.track_limit - 0.1:
                break
            errors.append(error(stepper.x, from_relative(env.data.qpos, env.data.qvel)[None]))
    env.close()
    kind = "states, gravity sideways as in its file" if sideways else "states, gravity straight down"
    engine = "Gymnasium InvertedDoublePendulum-v5"
    return [row(f"{kind}, up to 20 samples on", engine, errors, 1e-2 if sideways else 1e-9)]


def two_poles(n: int, seed: int) -> list[Row]:
    """Step the model of the DeepMind Control Suite's ``two_poles``, as its own file makes it, with random controls.

    The model is run by MuJoCo itself, one step a control as that task does; up to 0.1 m before the end of the track.
    """
    mujoco: Any = import_module("mujoco")
    cartpole: Any = import_module("dm_control.suite.cartpole")
    text, assets = cartpole.get_model_and_assets(num_poles=2)
    model = mujoco.MjModel.from_xml_string(text.decode() if isinstance(text, bytes) else text, assets)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(seed)
    rig = dpend.rig("dm_control_two_poles")
    stepper = dpend.Stepper(rig, 1)
    errors: list[Array] = []
    while len(errors) < n:
        x0 = _start(rng)
        stepper.reset(x0)
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = to_relative(x0)
        for control in rng.uniform(-1, 1, _SAMPLES):
            data.ctrl[0] = control
            mujoco.mj_step(model, data, round(rig.sample_time / model.opt.timestep))
            stepper.step([float(rig.force_limit) * control])
            if abs(stepper.x[0, 0]) > rig.track_limit - 0.1:
                break
            errors.append(error(stepper.x, from_relative(data.qpos, data.qvel)[None]))
    return [row("states, up to 20 samples on", "dm_control cartpole two_poles", errors, 1e-9)]
