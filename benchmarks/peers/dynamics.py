"""Accelerations, mass matrices, energies, linearisations and motions beside engines of rigid bodies."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import casadi
import numpy as np

import dpend
from benchmarks.dompc_plant import rods as dompc_rods
from benchmarks.peers.cases import Row, any_forces, any_params, any_states, error, matrix_error, rods, row
from benchmarks.peers.engines import STEP, Engine, load
from dpend import Params
from dpend.params import Array

SECONDS, HOLD = 10.0, 1.0
_REFERENCE = 1e-11  # tolerance of our own integration
_NEAR, _APART = 1e-8, 1e-2  # how far neighbours start from a motion, and how far away they no longer tell how it grows


def mass_matrices(x: Array, params: Params) -> Array:
    r"""Return :math:`D` ``(n, 3, 3)`` of the kinetic energy :math:`\tfrac12\dot q^\top D\dot q` of this package."""

    def kinetic(*moving: int) -> Array:
        still = x.copy()
        still[:, 3:] = np.eye(3)[list(moving)].sum(axis=0)
        return dpend.energies(still, params).kinetic

    found = np.empty((len(x), 3, 3))
    for i in range(3):
        found[:, i, i] = 2 * kinetic(i)
        for j in range(i):
            found[:, i, j] = found[:, j, i] = kinetic(i, j) - kinetic(i) - kinetic(j)
    return found


def plants(seed: int, n: int) -> Iterator[tuple[Params, np.random.Generator]]:
    """Yield ``n`` random plants, then every preset's, with a generator for what is asked of them."""
    rng = np.random.default_rng(seed)
    for _ in range(n):
        yield any_params(rng), rng
    for name in dpend.rigs():
        yield dpend.rig(name).params, rng


def still(name: str, n: int, states: int, seed: int) -> list[Row]:
    """Compare what an engine makes of single states: ``n`` random plants and the presets, ``states`` of each."""
    build = load(name)
    found: dict[str, list[Array]] = {key: [] for key in ("accelerations", "mass", "energies", "slopes")}
    for params, rng in plants(seed, n):
        x, f = any_states(rng, states), any_forces(rng, states)
        engine = build(params)
        found["accelerations"].append(error(dpend.rates(x, f, params)[:, 3:], engine.accelerations(x, f)))
        found["mass"].append(error(mass_matrices(x, params), engine.mass_matrices(x)))
        ours, theirs = np.stack(dpend.energies(x, params), axis=-1), engine.energies(x)
        theirs[:, 1] += ours[0, 1] - theirs[0, 1]  # which height counts as zero is each one's own choice
        found["energies"].append(error(ours, theirs))
        pairs = zip(dpend.linearize(params, x[0], f[0, 0]), engine.slopes(x[0], f[0, 0]), strict=True)
        found["slopes"].append(np.array([max(matrix_error(*pair) for pair in pairs)]))
    quantities = {
        "accelerations": "accelerations under pushes and all frictions",
        "mass": "mass matrix",
        "energies": "kinetic and potential energy",
        "slopes": "linearisation at any state",
    }
    if name == "MuJoCo":
        quantities["slopes"] += ", by differences"
    tolerances = dict.fromkeys(found, 1e-9) | ({"slopes": 1e-7} if name == "MuJoCo" else {})
    return [row(quantities[key], name, np.concatenate(each), tolerances[key]) for key, each in found.items()]


def motions(names: Sequence[str], n: int, seed: int, report: Callable[[int], None]) -> list[Row]:
    r"""Compare ``n`` motions of 10 s from any state under random held forces, every second one without friction.

    The plant is chaotic: a difference grows whoever integrates.  So each error is divided by the factor by which six
    neighbours, one moved in each state, have parted from the motion until then; and a motion is compared until they are
    so far apart that they no longer tell how a small difference grows.  Ours is ``dpend.reference`` for
    engines that control their error, and the :class:`dpend.Stepper` for those that take our steps.
    """
    rng = np.random.default_rng(seed)
    found: dict[str, list[float]] = {name: [] for name in names}
    intervals = round(SECONDS / HOLD)
    for k in range(n):
        params = rods(rng, friction=k % 2 == 0)
        x0 = rng.uniform(-1, 1, 6) * [1, math.pi, math.pi, 1, 3, 3]
        u = rng.uniform(-5, 5, intervals)
        stepper = dpend.Stepper(dpend.Rig(params=params, sample_time=HOLD, substeps=round(HOLD / STEP)), 7)
        near = [stepper.reset(np.vstack([x0, x0 + _NEAR * np.eye(6)])).copy()]
        near += [stepper.step(np.full(7, force)).copy() for force in u]
        together = np.stack(near)
        parted = np.abs(together[:, 1:] - together[:, :1]).max(axis=(1, 2)) / _NEAR
        growth = np.maximum.accumulate(np.maximum(parted, 1.0))
        growth[growth * _NEAR > _APART] = np.inf
        exact = dpend.reference(params, x0, u, HOLD * np.arange(intervals + 1), rtol=_REFERENCE, atol=_REFERENCE)
        for name in names:
            ours = together[:, 0] if name == "MuJoCo" else exact
            engine: Engine = load(name)(params)
            found[name].append(float((error(ours, engine.trajectory(x0, u, HOLD)) / growth).max()))
        report(k + 1)
    how = {
        "MuJoCo": (f"both by Runge-Kutta steps of {1000 * STEP:g} ms", 1e-12),
        "Pinocchio": ("both by DOP853 to 1e-11", 1e-6),
        "Drake": ("DOP853 to 1e-11, Runge-Kutta of order 5 to 1e-9", 1e-3),
    }
    return [
        row(f"motion of up to 10 s over its growth, {how[name][0]}", name, found[name], how[name][1]) for name in names
    ]


def dompc(n: int, states: int, seed: int) -> list[Row]:
    """Compare accelerations with those that do-mpc's equations imply, on random rods without friction."""
    rng = np.random.default_rng(seed)
    found = []
    presets = [dpend.rig("dompc_dip").params, dpend.rig("gustafsson2016").params]
    for params in [*presets, *(rods(rng, friction=False) for _ in range(n))]:
        model = dompc_rods(params)
        model.setup()
        motion = model._alg_fun  # of states, inputs, algebraic states, time-varying and constant parameters, noise
        z = casadi.SX.sym("z", 3)
        x_sym, u_sym = casadi.SX.sym("x", 6), casadi.SX.sym("u")
        fixed = casadi.DM([float(params.mass1), float(params.mass2)])
        left = motion(x_sym, u_sym, z, casadi.DM(), fixed, casadi.DM())
        slope = casadi.jacobian(left, z)
        at_rest = casadi.substitute(left, z, casadi.DM.zeros(3))
        solved = casadi.Function("accelerations", [x_sym, u_sym], [casadi.solve(slope, -at_rest)])
        x, u = any_states(rng, states), rng.uniform(-50, 50, states)
        theirs = np.asarray(solved(x.T, u[None])).T
        found.append(error(dpend.rates(x, u, params)[:, 3:], theirs))
    return [row("accelerations of rods without friction", "do-mpc", np.concatenate(found), 1e-9)]
