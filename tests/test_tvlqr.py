"""Along a trajectory the regulator's cost to go is what a run costs; it brings up what starts and weighs otherwise."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rigs import endless, random_params, random_states, whole

import dpend
from controllers import LQR, TVLQR, Trajectory, shipped
from controllers.tvlqr import sensitivities
from dpend import EQUILIBRIA, Stepper, SwingUp, equations
from dpend.params import Array
from dpend.rig import Rig

RIG = dpend.rig("gustafsson2016")
RNG = np.random.default_rng(0)


@cache
def stored(start: str = "hanging", target: str = "up-up") -> Trajectory:
    found = shipped(RIG, start, target)
    assert found is not None
    return found


def resting(rig: Rig, about: str, samples: int) -> Trajectory:
    """Return the trajectory that stays at an equilibrium."""
    target = EQUILIBRIA[about]
    return Trajectory(rig=rig, x=np.tile(target, (samples + 1, 1)), u=np.zeros(samples), target=target)


def rolled_out(rig: Rig, x0: Array, u: Array) -> Array:
    """Return the states ``(N + 1, 6)`` that forces lead through."""
    stepper = Stepper(rig, 1)
    stepper.reset(x0)
    states = [x0]
    for force in u:
        stepper.step(np.array([force]))
        states.append(stepper.x[0].copy())
    return np.array(states)


def success(controller: TVLQR, task: SwingUp, n: int, *, model_error: float = 0.0, seed: int = 0) -> int:
    """Count the runs that succeed, on rigs whose masses and lengths are off by up to a share."""
    rng = np.random.default_rng(seed)
    names = ("cart_mass", "mass1", "mass2", "length1", "length2")
    true = RIG.replace(
        **{name: getattr(RIG.params, name) * (1 + model_error * rng.uniform(-1, 1, n)) for name in names}
    )
    return int(dpend.simulate_many(true, controller, task.starts(rng, n, RIG), task=task, seed=seed).success.sum())


# --------------------------------------------------------------------------------------------------------------- design


def test_the_sensitivities_are_those_of_the_complex_step() -> None:
    rig = endless(params=random_params(RNG))
    u = RNG.uniform(-20, 20, 10)
    trajectory = Trajectory(rig=rig, x=random_states(RNG, 11), u=u, target=EQUILIBRIA["up-up"])
    A, B = sensitivities(trajectory)
    rk4 = equations.make_rk4(equations.make_rates(np.sin, np.cos))
    step = 1e-30
    for k in range(10):
        x = trajectory.x[k][:, None] + 1j * step * np.eye(6, 7)  # a column a direction, the last for the force
        force = u[k] + 1j * step * np.eye(7)[6]
        state: Any = tuple(x)
        for _ in range(rig.substeps):
            state = rk4(state, (force, 0.0, 0.0), rig.params.coefficients(), rig.sample_time / rig.substeps)
        exact = np.imag(np.stack(state)) / step
        assert_allclose(A[k], exact[:, :6], rtol=1e-10, atol=1e-10)
        assert_allclose(B[k], exact[:, 6], rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("about", tuple(EQUILIBRIA))
def test_along_a_trajectory_that_rests_the_gain_is_the_regulators(about: str) -> None:
    trajectory = resting(RIG, about, 40)
    controller, regulator = TVLQR(RIG, trajectory), LQR(RIG, (10, 100, 100, 1, 10, 10), 0.02, target=about)
    assert_array_equal(controller.K[-1], regulator.K[0])
    # Runge-Kutta steps and the exponential differ in the fifth order of the sample time.
    assert_allclose(controller.K, np.tile(regulator.K, (41, 1)), rtol=2e-3)
    assert_allclose(controller.P, np.tile(regulator.P, (41, 1, 1)), rtol=2e-3, atol=1e-3)


def test_the_cost_to_go_is_what_a_run_from_a_small_deviation_costs_and_never_grows_on_the_way() -> None:
    trajectory = stored()
    controller = TVLQR(RIG, trajectory, index="time")
    away = 1e-6 * RNG.standard_normal(6)
    act = controller.start(1, RNG)
    stepper = Stepper(RIG, 1)
    stepper.reset(trajectory.x[0] + away)
    cost, to_go = 0.0, []
    Q, R = np.array([10, 100, 100, 1, 10, 10]), 0.02
    for k, u in enumerate(trajectory.u):
        # The shipped states are a motion to the solver's tolerance only: compare with the motion itself.
        off = stepper.x[0] - trajectory.x[k]
        to_go.append(off @ controller.P[k] @ off)
        force = act(k * RIG.sample_time, stepper.x)
        cost += Q @ off**2 + R * (force[0] - u) ** 2
        stepper.step(force)
    off = stepper.x[0] - trajectory.target
    cost += off @ controller.P[-1] @ off
    assert_allclose(cost, to_go[0], rtol=1e-3)
    assert (np.diff(to_go) < 0).all()


def test_the_cost_to_go_is_positive_everywhere() -> None:
    P = TVLQR(RIG).P
    assert_array_equal(P, P.transpose(0, 2, 1))
    assert np.linalg.eigvalsh(P).min() > 0


# ------------------------------------------------------------------------------------------------------------- the law


def test_undisturbed_it_plays_the_trajectory_and_then_regulates() -> None:
    trajectory = stored()
    for index in ("time", "nearest"):
        run = dpend.simulate(RIG, TVLQR(RIG, trajectory, index=index), trajectory.x[0], task=SwingUp(steps=225))
        assert run.success
        assert_allclose(run.u[: len(trajectory.u)], trajectory.u, atol=1e-3)
        assert_allclose(run.x[-1], trajectory.target, atol=1e-3)
        assert_array_equal(run.log["sample"], np.minimum(np.arange(225), 125))


def test_by_nearest_a_run_may_begin_anywhere_along_the_trajectory_and_the_end_is_part_of_it() -> None:
    trajectory = stored()
    controller = TVLQR(RIG, trajectory)
    begins = np.vstack([trajectory.x[[0, 30, 60, 110]], trajectory.target])
    runs = dpend.simulate_many(RIG, controller, begins, task=SwingUp(steps=200))
    assert_array_equal(runs.log["sample"][:, 0], [0, 30, 60, 110, 125])
    assert runs.success.all()


def test_after_the_trajectory_it_is_the_regulator_about_its_end() -> None:
    y = stored().target + 0.1 * RNG.standard_normal((3, 6))
    law = TVLQR(RIG, index="time").start(3, RNG)
    regulator = LQR(RIG, (10, 100, 100, 1, 10, 10), 0.02).start(3, RNG)
    for t in (2.5, 2.52, 10.0):
        assert_allclose(law(t, y), regulator(t, y), atol=1e-9)
    assert np.abs(law(2.48, y) - regulator(2.48, y)).min() > 1e-3


def test_a_run_waits_at_a_sample_no_longer_than_five() -> None:
    act: Any = TVLQR(RIG).start(1, RNG)
    for k in range(40):
        act(0.02 * k, stored().x[:1])
    at = np.concatenate(act.log["sample"])
    assert at[0] == 0
    assert (np.diff(at) >= 0).all()
    assert at[-1] >= 5


def test_whole_turns_do_not_matter() -> None:
    y = stored().x[[20, 60, 100]] + 0.01 * RNG.standard_normal((3, 6))
    turned = y + 2 * np.pi * np.array([0, 1, -2, 0, 0, 0])
    for index in ("time", "nearest"):
        plain, other = (TVLQR(RIG, index=index).start(3, RNG)(0.4, states) for states in (y, turned))
        assert_allclose(plain, other, atol=1e-8)


# ------------------------------------------------------------------------------------------------------------ swing-ups


@pytest.mark.parametrize("start", ["hanging", "side"])
def test_it_brings_up_what_starts_up_to_a_fifth_of_a_radian_off(start: str) -> None:
    controller = TVLQR(RIG, stored(start))
    assert success(controller, SwingUp(start=start, angle_spread=0.2, steps=250), 200) >= 198


@pytest.mark.parametrize(("index", "least"), [("time", 180), ("nearest", 192)])
def test_it_brings_up_plants_whose_masses_and_lengths_are_five_percent_off(index: Any, least: int) -> None:
    assert success(TVLQR(RIG, index=index), SwingUp(steps=250), 200, model_error=0.05) >= least


@pytest.mark.slow
@pytest.mark.parametrize(("start", "target"), list(itertools.permutations(EQUILIBRIA, 2)))
def test_it_moves_between_any_two_equilibria(start: str, target: str) -> None:
    task = SwingUp(start=start, target=target, angle_spread=0.1, steps=275)
    assert success(TVLQR(RIG, stored(start, target)), task, 50) >= 49


@pytest.mark.nightly
def test_for_a_rig_without_a_stored_trajectory_one_is_found_when_it_starts() -> None:
    rig = RIG.replace(force_limit=38.0)
    assert shipped(rig) is None
    controller = TVLQR(rig)
    assert repr(controller) == "<TVLQR, not yet planned>"
    assert dpend.simulate(rig, controller, EQUILIBRIA["down-down"], task=SwingUp(steps=225)).success
    assert repr(controller).startswith("<TVLQR along <trajectory of 2.5 s in 125 samples")


# ------------------------------------------------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: TVLQR(RIG, index="space"), 'index must be "nearest" or "time"; got \'space\'.'),  # type: ignore[arg-type]
        (
            lambda: TVLQR(RIG.replace(sample_time=0.03), stored()),
            "The trajectory's samples last 0.02 s, the rig's 0.03 s; a force is held for the time it was planned for. "
            "Plan it on the rig's clock: optimize(rig, ..., duration=2.52, guess=trajectory).",
        ),
        (
            lambda: TVLQR(RIG.replace(mass1=0.6), stored()),
            "The trajectory was planned for a plant with other parameters than the rig's; plan it for this one: "
            "optimize(rig, ..., guess=trajectory).",
        ),
        (
            lambda: TVLQR(RIG, replace(stored(), x=stored().x[:101], u=stored().u[:100])),
            "The trajectory stops SHORT short of its target, and the regulator there works near it only; "
            "expected at most 0.1 in every state.",
        ),
        (lambda: TVLQR(RIG, R=0.0), "R, the weight of the force, must be finite and greater than 0; got 0.0."),
        (
            lambda: TVLQR(RIG.replace(mass1=np.array([0.5, 0.6]))),
            "LQR takes one plant; got a rig of 2 rows. Take one of them with rig.rows(i).",
        ),
    ],
)
def test_wrong_use_is_refused_before_anything_runs(call: Callable[[], Any], message: str) -> None:
    if "SHORT" in message:
        short = np.abs(stored().x[100] - stored().target).max()
        message = message.replace("SHORT", f"{short:.3g}")
    with pytest.raises(ValueError, match=whole(message)):
        call()


def test_what_is_no_trajectory_is_refused() -> None:
    message = "trajectory must be a controllers.Trajectory; got ndarray."
    with pytest.raises(TypeError, match=whole(message)):
        TVLQR(RIG, np.zeros((3, 6)))  # type: ignore[arg-type]
