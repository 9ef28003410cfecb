"""A plan is what the plant does, costs less by every iteration, and keeps to the force; the horizon gets links up."""

from __future__ import annotations

import math
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rigs import endless, random_params, random_states, whole

import dpend
from controllers import ILQRMPC, LQR, Model, Trajectory, ilqr, ilqr_kernels
from controllers.ilqr_kernels import Guess, Plans
from dpend import SwingUp, equations, kernels
from dpend.params import Array
from dpend.rig import Rig

inside: Any = sys.modules["controllers.ilqr"]  # the function of that name hides the module
RIG = dpend.rig("gustafsson2016")
HANGING = dpend.EQUILIBRIA["down-down"]
STEP = 1e-30


def drive(law: Any, y: Array, t: float = 0.0) -> float:
    """Return the force for one measurement."""
    return float(law(t, y[None])[0])


def begin(controller: ILQRMPC, seed: int = 0, n: int = 1) -> Any:
    return controller.start(n, np.random.default_rng(seed))


def planner(rig: Rig, **changes: Any) -> Any:
    settings = {"target": "up-up", "horizon": None, "Q": None, "R": None, "upright_only": False} | changes
    return inside._Planner(rig, **settings)


def straight(mpc: Any, x0: Array) -> tuple[Array, Array]:
    """Return a straight line of states, which is no motion, and no forces."""
    return (1 - mpc.setting.line[:, None]) * x0, np.zeros(mpc.N)


def driven(mpc: Any, seed: int) -> Any:
    """Return the motion from hanging at rest under random forces."""
    plans = Plans.blank(1, mpc.N)
    noise = mpc.draw(np.random.default_rng(seed), 1)
    mpc.improve(plans, Guess.DRIVEN, HANGING[None], 0, 0.0, noise=noise)
    return plans


# ---------------------------------------------------------------------------------------------------------- derivatives


@pytest.mark.parametrize("seed", range(5))
def test_the_slopes_of_the_accelerations_are_those_of_the_complex_step(seed: int) -> None:
    rng = np.random.default_rng(seed)
    params, x, u = random_params(rng), random_states(rng, 1)[0], float(rng.uniform(-40, 40))
    slopes = equations.make_acceleration_slopes(np.sin, np.cos)
    found = np.array(slopes(x, dpend.rates(x, u, params)[3:], params.coefficients())).T
    A, B = dpend.linearize(params, x, u)
    assert_allclose(found[:, :5], A[3:, 1:], rtol=1e-9, atol=1e-9)
    assert_allclose(found[:, 5:], B[3:], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("substeps", [1, 3])
def test_the_slopes_of_a_sample_are_those_of_the_complex_step(substeps: int) -> None:
    rng = np.random.default_rng(substeps)
    rig = endless(params=random_params(rng), substeps=substeps)
    N = 40  # more than a block
    x, u = random_states(rng, N + 1), rng.uniform(-40, 40, N)
    D = np.empty((N, 6, 8))
    ilqr_kernels.PLANT.linearize(x, u, planner(rig).setting.parameters, D)
    rk4 = equations.make_rk4(equations.make_rates(np.sin, np.cos))
    for column in range(7):
        moved, force = x[:-1].T.astype(complex), u.astype(complex)
        if column < 6:
            moved[column] += 1j * STEP
        else:
            force += 1j * STEP
        after: Any = tuple(moved)
        for _ in range(substeps):
            after = rk4(after, (force, 0.0, 0.0), rig.params.coefficients(), rig.sample_time / substeps)
        assert_allclose(D[:, :, column], np.imag(after).T / STEP, rtol=1e-9, atol=1e-9)
        assert_allclose(D[:, :, 7], np.real(after).T - x[1:], rtol=0, atol=1e-9)


def test_on_a_linear_quadratic_problem_the_backward_pass_gives_the_riccati_gain() -> None:
    mpc = planner(endless(), horizon=0.4)
    x, u = np.zeros((21, 6)), np.zeros(20)
    D, du, K = np.empty((20, 6, 8)), np.empty(20), np.empty((20, 6))
    A, B = (np.asarray(part) for part in dpend.discretize(*dpend.linearize(mpc.rig.params), mpc.rig.sample_time))
    D[:, :, :6], D[:, :, 6:7], D[:, :, 7] = A, B, 0.0
    ilqr_kernels.backward(x, u, mpc.setting.problem, mpc.P, D, 0.0, du, K)
    assert_allclose(K, np.tile(-mpc.lqr.K, (20, 1)), rtol=1e-7)
    assert_array_equal(du, 0.0)


def test_a_clamped_force_has_no_feedback_and_stays_in_the_box() -> None:
    mpc = planner(RIG, horizon=0.4)
    x, u = straight(mpc, np.array([0.0, 1.0, -1.0, 0.0, 0.0, 0.0]))
    D, du, K = np.empty((20, 6, 8)), np.empty(20), np.empty((20, 6))
    ilqr_kernels.PLANT.linearize(x, u, mpc.setting.parameters, D)
    ilqr_kernels.backward(x, u, mpc.setting.problem, mpc.P, D, 0.0, du, K)
    clamped = np.abs(u + du) == RIG.force_limit
    assert clamped.any()
    assert not clamped.all()
    assert (np.abs(u + du) <= RIG.force_limit).all()
    assert not K[clamped].any()
    assert K[~clamped].any(axis=1).all()


def quadratic_model(mpc: Any, k: int, x: Array, problem: Any, direction: Array) -> tuple[float, float]:
    """Return the halved slope and curvature of the cost by the state after sample k of two, by the backward pass."""
    D, du, K = np.zeros((2, 6, 8)), np.empty(2), np.empty((2, 6))
    D[k, :, 6] = direction  # the force moves the next state along the direction, and no state moves another
    states = np.zeros((3, 6))
    states[k + 1] = x
    first, second, _ = ilqr_kernels.backward(states, np.zeros(2), problem, mpc.P, D, 0.0, du, K)
    return first / du[k], second / du[k] ** 2 - problem.R


@pytest.mark.parametrize("k", [0, 1], ids=["stage", "end"])
@pytest.mark.parametrize("place", [(2.3, 0, 0), (-2.39995, 0, 0), (0, 1.5, -1.6), (2.3, -1.5, 1.45)])
def test_walls_have_the_slope_and_the_curvature_of_their_cost(place: tuple[float, float, float], k: int) -> None:
    mpc = planner(endless(track_limit=2.4), horizon=0.04, upright_only=True)
    x = np.array([*place, 0.1, -0.2, 0.3])
    walls = ilqr_kernels.problem_at(tuple(x), mpc.setting.problem)
    none = walls._replace(track_weight=0.0, hard_weight=0.0, angle_weight=0.0)
    direction = np.array([1.0, -0.7, 0.4, 0.2, 0.1, -0.3])
    with_them, without_them = (quadratic_model(mpc, k, x, problem, direction) for problem in (walls, none))
    found = np.subtract(with_them, without_them)

    def cost(way: float) -> float:
        states = np.zeros((3, 6))
        states[k + 1] = x + way * direction
        with_walls, without = (ilqr_kernels.cost_of(states, np.zeros(2), each, mpc.P) for each in (walls, none))
        return 0.5 * (with_walls - without)

    h = 1e-5  # within the walls the cost is quadratic, so differences are exact to rounding
    before, here, after = (cost(way) for way in (-h, 0.0, h))
    assert_allclose(found, [(after - before) / (2 * h), (after - 2 * here + before) / h**2], rtol=1e-4)
    assert found[0] != 0.0


@pytest.mark.parametrize("damping", [0.0, 0.3, 10.0])
def test_a_backward_pass_predicts_the_cost_of_the_step_it_proposes(damping: float) -> None:
    """On a linear plant, near the target, where nothing is clamped: to rounding, damped or not."""
    mpc = planner(endless(), horizon=0.4)
    N, rng = 20, np.random.default_rng(0)
    x, u = 1e-5 * rng.standard_normal((N + 1, 6)), 1e-5 * rng.standard_normal(N)
    D, du, K = np.empty((N, 6, 8)), np.empty(N), np.empty((N, 6))
    A, B = (np.asarray(part) for part in dpend.discretize(*dpend.linearize(mpc.rig.params), mpc.rig.sample_time))
    D[:, :, :6], D[:, :, 6:7], D[:, :, 7] = A, B, 0.0
    first, second, _ = ilqr_kernels.backward(x, u, mpc.setting.problem, mpc.P, D, damping, du, K)

    def cost(x: Array, u: Array) -> float:
        return float((x[:-1] ** 2 * mpc.Q).sum() + mpc.R * (u**2).sum() + x[-1] @ mpc.P @ x[-1])

    away, change = np.zeros((N + 1, 6)), np.zeros(N)
    for k in range(N):
        change[k] = du[k] + K[k] @ away[k]
        away[k + 1] = A @ away[k] + B[:, 0] * change[k]
    assert_allclose(2 * first + second, cost(x + away, u + change) - cost(x, u), rtol=1e-6)


def test_damping_shortens_a_step_and_its_feedback_in_proportion() -> None:
    mpc = planner(endless(), horizon=0.4)
    x, u = straight(mpc, np.array([0.0, 0.3, -0.2, 0.0, 0.0, 0.0]))
    D = np.empty((20, 6, 8))
    ilqr_kernels.PLANT.linearize(x, u, mpc.setting.parameters, D)
    (du, K), (damped, its_K) = [(np.empty(20), np.empty((20, 6))) for _ in range(2)]
    ilqr_kernels.backward(x, u, mpc.setting.problem, mpc.P, D, 0.0, du, K)
    ilqr_kernels.backward(x, u, mpc.setting.problem, mpc.P, D, 3.0, damped, its_K)
    # At the last sample, where both know the same cost to go.
    assert_allclose(damped[-1], du[-1] / 4, rtol=1e-12)
    assert_allclose(its_K[-1], K[-1] / 4, rtol=1e-12)


def test_damping_grows_while_plans_get_no_better_and_soon_vanishes_when_they_do() -> None:
    rising, falling = [0.0], [1.0]
    for _ in range(10):
        rising.append(ilqr_kernels.next_damping(rising[-1], False))
    for _ in range(6):
        falling.append(ilqr_kernels.next_damping(falling[-1], True))
    assert (np.diff(rising) > 0).all()
    assert rising[-2] < 1e6 * (1 + 1e-9) < rising[-1]  # where improvement ends
    assert (np.diff(falling) < 0).all()
    assert falling[-1] == ilqr_kernels.next_damping(0.0, True) == 0.0


def test_where_a_full_step_is_too_long_a_damped_one_is_taken_in_its_place() -> None:
    mpc = planner(RIG)
    plan, setting = driven(mpc, 0), mpc.setting
    row, noise, limits = np.zeros(1, dtype=np.intp), np.zeros((1, 1)), np.full(1, math.inf)
    guess = int(Guess.AS_IT_IS), HANGING[None], noise, limits
    ilqr_kernels.PLANT.improve(0, 1, row, *guess, plan, setting, 300, 1e-6, 1)
    assert plan.converged[0]
    assert plan.accepted[0] < plan.tried[0] < 300


# -------------------------------------------------------------------------------------------------------------- offline


def test_cost_never_rises_over_iterations() -> None:
    mpc = planner(RIG)
    plan = driven(mpc, 1)
    costs = [plan.cost[0]]
    for _ in range(30):
        mpc.improve(plan, Guess.AS_IT_IS, HANGING[None], 1, 0.0)
        costs.append(plan.cost[0])
    assert (np.diff(costs) <= 0).all()
    assert costs[-1] < 0.2 * costs[0]


def test_the_cost_in_the_record_is_that_of_the_motion() -> None:
    rig = RIG
    plan = ilqr(rig, HANGING, horizon=1.2, starts=0, iterations=5)
    mpc = planner(rig, horizon=1.2)
    e = np.stack([_residuals(x, ilqr_kernels.nearest_target(tuple(x), mpc.setting.problem)) for x in plan.x])
    over = np.maximum(np.abs(plan.x[:, 0]) - 2.25, 0)
    stages = (e[:-1] ** 2 * mpc.Q).sum() + 0.1 * (plan.u**2).sum() + 1e4 * (over**2).sum()
    assert_allclose(plan.about["cost"], stages + e[-1] @ LQR(rig, mpc.Q, 0.1).P @ e[-1], rtol=1e-9)


def _residuals(x: Array, target: Any) -> Array:
    e = x - np.asarray(target)
    e[1:3] = 2 * np.sin(e[1:3] / 2)
    return e


def test_a_swing_up_is_planned_from_hanging_at_rest() -> None:
    plan = ilqr(RIG, HANGING, horizon=2.5, iterations=400)
    assert isinstance(plan, Trajectory)
    assert plan.about["converged"]
    assert plan.about["starts_tried"] == 10
    assert_array_equal(plan.x[0], HANGING)
    assert np.abs(plan.x[-1] - plan.target)[1:3].max() < 0.1
    assert plan.defect() < 1e-9
    assert np.abs(plan.u).max() <= RIG.force_limit
    assert np.abs(plan.x[:, 0]).max() < RIG.track_limit
    again = ilqr(RIG, HANGING, horizon=2.5, iterations=400)
    assert_array_equal(again.u, plan.u)


def test_gaps_between_guessed_states_are_closed() -> None:
    x0 = np.array([0.0, 0.3, -0.1, 0.0, 0.0, 0.0])
    guess = np.linspace(1, 0, 51)[:, None] * x0
    plan = ilqr(RIG, x0, horizon=1, x_guess=guess)
    assert plan.about["converged"]
    assert plan.about["starts_tried"] == 1
    assert plan.defect() < 1e-9
    unfinished = ilqr(RIG, x0, horizon=1, x_guess=guess, iterations=0)
    assert not unfinished.about["converged"]
    assert unfinished.defect() < 1e-9


def test_a_guess_of_forces_is_followed_and_clipped() -> None:
    guess = np.linspace(-100, 100, 30)
    plan = ilqr(RIG, HANGING, horizon=0.6, u_guess=guess, iterations=0)
    assert_array_equal(plan.u, np.clip(guess, -40, 40))


def test_near_the_target_the_plan_is_the_regulators() -> None:
    x0 = np.array([0.0, 1e-3, -1e-3, 0.0, 0.0, 0.0])
    plan = ilqr(RIG, x0)
    Q, R = (10.0, 50.0, 50.0, 1.0, 1.0, 1.0), 0.1
    lqr = LQR(RIG, Q, R)
    assert_allclose(plan.u[0], -lqr.K[0] @ x0, rtol=1e-3)
    assert_allclose(plan.about["cost"], x0 @ lqr.P @ x0, rtol=1e-3)
    assert plan.about["starts_tried"] == 2


def test_walls_hold_the_links_to_a_quarter_turn() -> None:
    x0 = np.array([0.0, 0.32, 0.32, 0.0, 0.0, 0.0]) + 2 * np.pi * np.array([0, 1, -1, 0, 0, 0])
    plan = ilqr(RIG, x0, upright_only=True)
    assert np.abs(plan.x[:, 1:3] - plan.target[1:3]).max() < np.pi / 2
    assert_allclose(plan.target[1:3], [2 * np.pi, -2 * np.pi])


# -------------------------------------------------------------------------------------------------------------- horizon


@pytest.mark.parametrize("start", ["hanging", "side"])
def test_an_unperturbed_swing_up_succeeds_within_the_force(start: str) -> None:
    task = SwingUp(start=start, steps=300)
    run = dpend.simulate(RIG, ILQRMPC(RIG), task.starts(np.random.default_rng(0), 1, RIG)[0], task=task)
    assert run.success
    assert np.abs(run.u).max() <= RIG.force_limit
    assert np.isfinite(run.log["cost"]).all()
    assert run.log["status"][0] == inside.Step.PLANNED
    assert run.log["iterations"][1:].max() <= 2
    assert inside.Step.FELL_BACK not in run.log["status"]
    assert run.log["cost"][-1] < 1e-3 * run.log["cost"][0]


def test_without_iterations_the_first_plan_is_followed_by_its_gains() -> None:
    task = SwingUp(steps=400)
    run = dpend.simulate(RIG, ILQRMPC(RIG, iterations=0), HANGING + np.array([0, 0.01, 0, 0, 0, 0]), task=task)
    assert run.success
    assert set(run.log["status"][1:]) == {inside.Step.FELL_BACK}
    assert not run.log["iterations"][1:].any()


def test_the_cart_goes_to_its_set_point() -> None:
    target = np.array([0.8, 0.0, 0.0, 0.0, 0.0, 0.0])
    run = dpend.simulate(RIG, ILQRMPC(RIG, target=target), np.zeros(6), 6.0)
    assert np.abs(run.x[-1] - target).max() < 0.02


def test_a_mirrored_start_gives_mirrored_forces() -> None:
    x0 = np.array([0.1, 3.0, 3.3, 0.2, -0.1, 0.3])
    there, mirrored = (dpend.simulate(RIG, ILQRMPC(RIG), sign * x0, 0.6, task=None, seed=4).u for sign in (1.0, -1.0))
    assert_allclose(there, -mirrored, rtol=0, atol=1e-6)


def test_a_challenger_of_a_mirrored_run_is_mirrored() -> None:
    x = np.array([0.1, 3.0, 3.3, 0.2, -0.1, 0.3])
    laws = begin(ILQRMPC(RIG), seed=4), begin(ILQRMPC(RIG), seed=4)
    for _ in range(2):
        for law, sign in zip(laws, (1, -1), strict=True):
            drive(law, sign * x)
    one, two = (law.challengers.u for law in laws)
    assert one.any()
    assert_allclose(one, -two, rtol=0, atol=1e-6)


def test_random_starts_come_in_mirrored_pairs() -> None:
    x = np.array([0.1, 3.0, 3.3, 0.2, -0.1, 0.3])
    several, alone = begin(ILQRMPC(RIG, starts=2), seed=1), begin(ILQRMPC(RIG, starts=0), seed=1)
    mirrored = begin(ILQRMPC(RIG, starts=2), seed=1)
    for law, sign in ((several, 1), (mirrored, -1), (alone, 1)):
        drive(law, sign * x)
    assert several.log["cost"][0] < alone.log["cost"][0]  # a random start won
    assert_allclose(several.plans.u, -mirrored.plans.u, rtol=0, atol=1e-6)


@pytest.mark.parametrize("lean", [0.05, 0.9], ids=["small", "saturated"])
def test_what_a_shift_appends_to_a_plan_is_the_saturated_regulators(lean: float) -> None:
    controller = ILQRMPC(RIG, horizon=0.2, iterations=0)
    law = begin(controller)
    drive(law, np.array([0.0, lean, lean, 0.0, 0.0, 0.0]))
    x, u = law.plans.x[0].copy(), law.plans.u[0].copy()
    drive(law, x[1])
    assert_allclose(law.plans.u[0, :-1], u[1:], rtol=1e-9)
    assert_allclose(law.plans.u[0, -1], np.clip(-controller.K[0] @ x[-1], -40, 40), rtol=1e-9)


def test_beyond_its_first_plan_a_plan_that_is_only_shifted_is_the_regulator() -> None:
    controller = ILQRMPC(RIG, horizon=0.2, iterations=0)
    law = begin(controller)
    for _ in range(controller.horizon_steps + 1):
        assert drive(law, np.zeros(6)) == 0.0
    y = 1e-2 * np.random.default_rng(0).standard_normal(6)
    assert_allclose(drive(law, y), -controller.lqr.K[0] @ y, rtol=1e-12)


class Wrapped:
    """A controller that sees angles as absolute encoders give them, within half a turn of up."""

    batched = False

    def __init__(self, controller: ILQRMPC) -> None:
        self.controller = controller

    def start(self, n: int, rng: np.random.Generator) -> dpend.Act:
        act = self.controller.start(n, rng)
        return lambda t, y: act(t, dpend.nearest_upright(y))


def test_from_absolute_encoders_it_swings_up_as_well() -> None:
    task = SwingUp(angle_spread=0.2, steps=300)
    x0 = task.starts(np.random.default_rng(3), 4, RIG)
    assert dpend.simulate_many(RIG, Wrapped(ILQRMPC(RIG)), x0, task=task).success.all()


def as_alone(law: Any, rig: Rig, x0: Array, task: Any, samples: int) -> None:
    """Hold rows of a batch to runs of one, to the bit, forces and logs."""
    settings: dict[str, Any] = {"duration": samples * rig.sample_time, "task": task, "seed": 5}
    together = dpend.simulate_many(rig, law, x0, **settings)
    for row in range(len(x0)):
        alone = dpend.simulate_many(rig, law, x0[row : row + 1], first_row=row, **settings)
        assert_array_equal(together.u[row], alone.u[0])
        for name, log in together.log.items():
            assert_array_equal(log[row], alone.log[name][0])


def test_a_row_of_a_batch_is_the_run_that_it_would_be_alone_also_where_others_have_ended() -> None:
    task = dpend.Balance(lam=0.8)
    x0 = task.starts(np.random.default_rng(2), 9, RIG)
    as_alone(ILQRMPC(RIG, upright_only=True, starts=2), RIG, x0, task, 40)
    assert 0 < dpend.simulate_many(RIG, ILQRMPC(RIG, upright_only=True, starts=2), x0, 0.8).success.sum() < 9


def test_each_row_of_a_batch_that_swings_up_draws_its_own_plans_and_challengers() -> None:
    rig = RIG.replace(sensor_noise=0.02)
    task = SwingUp(angle_spread=0.3)
    x0 = task.starts(np.random.default_rng(2), 5, rig)
    as_alone(ILQRMPC(rig, starts=4), rig, x0, task, 30)
    act: Any = ILQRMPC(rig, starts=4).start(2, np.random.default_rng(0))
    for _ in range(2):
        act(0.0, np.tile(x0[0], (2, 1)))
    assert np.abs(np.subtract(*act.challengers.u)).max() > 1.0  # not one and the same


def test_in_a_batch_missing_measurements_and_whole_turns_are_each_rows_own() -> None:
    y = np.tile([0.0, 0.2, -0.1, 0.0, 0.0, 0.0], (4, 3, 1))
    y[:, 1] *= -1
    y[2, 0, 1] = np.nan
    y[1:, 2, 2] += 2 * np.pi
    law = ILQRMPC(RIG, horizon=0.4)
    together, alone = begin(law, n=3), [begin(law) for _ in range(3)]
    for k, row in enumerate(y):
        forces = together(0.02 * k, row)
        assert_array_equal(forces, [drive(one, row[i]) for i, one in enumerate(alone)])
    assert_array_equal(np.array(together.log["held"])[:, 0], [0, 0, 1, 0])
    assert not np.any(np.array(together.log["held"])[:, 1:])


@pytest.mark.slow
def test_next_to_the_tracks_end_it_saves_what_the_regulator_saves() -> None:
    rng = np.random.default_rng(0)
    x0 = np.zeros((12, 6))
    x0[:, 0] = rng.uniform(2.381, 2.398, 12)
    x0[:, 1] = x0[:, 2] = -rng.uniform(0.05, 0.25, 12)
    x0[::2] *= -1
    planned, regulated = (
        dpend.simulate_many(RIG, law, x0).success for law in (ILQRMPC(RIG, upright_only=True), LQR(RIG))
    )
    assert regulated.sum() >= 8
    assert (planned >= regulated).all()


def test_a_start_that_nothing_keeps_on_the_track_is_still_driven_back() -> None:
    lost = np.array([2.399, 0.0, 0.0, 3.0, 0.0, 0.0])
    assert drive(begin(ILQRMPC(RIG, upright_only=True)), lost) == -RIG.force_limit


def test_what_is_not_finite_is_never_answered_by_what_is_not() -> None:
    broken = np.full(6, np.nan)
    assert drive(begin(ILQRMPC(RIG)), broken) == 0.0
    law = begin(ILQRMPC(RIG))
    drive(law, np.array([0.0, 0.3, 0.1, 0.0, 0.0, 0.0]))
    for y in (broken, np.full(6, np.inf), np.full(6, 1e200), np.array([0, 0, 0, 0, 1e6, -1e6]), np.zeros(6)):
        assert abs(drive(law, y)) <= RIG.force_limit
    assert abs(drive(law, np.zeros(6))) < 1e-6


def test_a_plan_that_cannot_be_bettered_counts_as_converged() -> None:
    law = begin(ILQRMPC(RIG))
    for _ in range(3):
        assert drive(law, np.zeros(6)) == 0.0
    assert law.log == {"status": [3.0, 1.0, 1.0], "iterations": [0.0, 0.0, 0.0], "cost": [0.0, 0.0, 0.0]}


@pytest.mark.slow
@pytest.mark.parametrize("preset", dpend.rigs())
def test_every_preset_is_swung_up(preset: str) -> None:
    rig = dpend.rig(preset)
    task = SwingUp(angle_spread=0.1, steps=round(8 / rig.sample_time))
    x0 = task.starts(np.random.default_rng(1), 3, rig)
    assert dpend.simulate_many(rig, ILQRMPC(rig), x0, task=task).success.all()


@pytest.mark.slow
@pytest.mark.parametrize("goal", dpend.EQUILIBRIA)
@pytest.mark.parametrize("start", dpend.EQUILIBRIA)
def test_every_equilibrium_is_reached_from_every_other(start: str, goal: str) -> None:
    task = SwingUp(start=start, target=goal, angle_spread=0.1, steps=300)
    x0 = task.starts(np.random.default_rng(1), 2, RIG)
    assert dpend.simulate_many(RIG, ILQRMPC(RIG, target=goal), x0, task=task).success.all()


@pytest.mark.slow
def test_balancing_saves_all_that_lean_by_a_fifth_of_a_radian() -> None:
    task = dpend.Balance(lam=0.2)
    x0 = task.starts(np.random.default_rng(1), 20, RIG)
    assert dpend.simulate_many(RIG, ILQRMPC(RIG, upright_only=True), x0, task=task).success.all()


# -------------------------------------------------------------------------------------------------- models of one's own


def the_same(x, u, parameters):
    coefficients, h = parameters
    return kernels.sample(x, (u, 0.0, 0.0), coefficients, h, 2)


def model_of(rig: Rig) -> Model:
    return Model(step=the_same, parameters=(rig.params.coefficients(), rig.sample_time / 2))


@pytest.mark.slow
def test_a_model_that_states_no_slopes_gets_those_of_the_plant_it_copies() -> None:
    x, u = random_states(np.random.default_rng(0), 1)[0], 7.0
    for name in ("gustafsson2016", "dompc_dip"):  # one compilation serves both
        rig = dpend.rig(name).replace(substeps=2)
        planned = planner(rig)
        D = np.empty((1, 6, 8))
        ilqr_kernels.PLANT.linearize(np.tile(x, (2, 1)), np.array([u]), planned.setting.parameters, D)
        A, B = model_of(rig).slopes(x, u)
        assert_allclose(np.hstack([A, B]), D[0, :, :7], rtol=0, atol=1e-7)
    with pytest.raises(ValueError, match="x must be one state"):
        model_of(RIG).slopes(np.zeros(5))


@pytest.mark.slow
def test_on_a_model_equal_to_the_plant_plans_and_regulator_are_the_plants() -> None:
    x0 = np.array([0.0, 0.3, -0.1, 0.0, 0.0, 0.0])
    settings: dict[str, Any] = {"horizon": 0.6, "Q": (10, 50, 50, 1, 1, 1), "R": 0.1}
    one, other = (ilqr(RIG, x0, model=model, **settings) for model in (None, model_of(RIG)))
    assert_allclose(other.u, one.u, rtol=0, atol=1e-4)
    planned = ILQRMPC(RIG, model=model_of(RIG), **settings)
    regulator = ILQRMPC(RIG, **settings)
    assert planned.lqr is None
    assert_allclose(planned.K, regulator.K, rtol=1e-5)
    assert_allclose(planned.P, regulator.P, rtol=1e-4)


@pytest.mark.parametrize("preset", ["gustafsson2016", "bogdanov2004", "pilco2011", "dompc_dip"])
def test_a_models_linearisation_gives_the_horizon_that_lengths_would_within_a_fifth(preset: str) -> None:
    rig = dpend.rig(preset)
    A, B = (np.asarray(part) for part in dpend.discretize(*dpend.linearize(rig.params), rig.sample_time))
    g, length, mass = inside._scales(A, B, rig.sample_time)
    links = float(rig.params.length1 + rig.params.length2) / 2
    assert abs(math.sqrt(length / g / (links / rig.params.gravity)) - 1) < 0.2
    assert 0.6 < mass / float(rig.params.coefficients().d1) < 1.5


@pytest.mark.slow
def test_the_page_plans_on_a_network() -> None:
    blocks = re.findall(r"```python\n(.*?)```", Path("docs/ilqr.md").read_text(), flags=re.DOTALL)
    (example,) = (block for block in blocks if "Model" in block)
    found: dict[str, Any] = {"np": np, "dpend": dpend, "rig": RIG}
    exec(example, found)
    assert found["run"].success


def test_a_model_without_a_regulator_still_has_finite_weights() -> None:
    A, B = 1.5 * np.eye(6), np.zeros((6, 1))
    K, P = inside.regulator(A, B, np.ones(6), 0.1)
    assert np.isfinite(P).all()
    assert not K.any()
    _, length, mass = inside._scales(np.eye(6), B, 0.02)
    assert 0.1 <= length <= 4.0
    assert math.isfinite(mass)


# ---------------------------------------------------------------------------------------------------------------- scale


def test_a_rig_twice_as_long_with_time_scaled_alike_moves_alike() -> None:
    twice = RIG.replace(length1=2.0, length2=2.0, track_limit=4.8, sample_time=0.02 * math.sqrt(2))
    x0 = np.array([0.0, 3.0, 3.3, 0.0, 0.0, 0.0])
    one, two = (ilqr(rig, x0, starts=2, iterations=20) for rig in (RIG, twice))
    assert_allclose(two.u, one.u, rtol=0, atol=1e-3)
    assert_allclose(two.x[:, 0], 2 * one.x[:, 0], rtol=0, atol=1e-3)


# ------------------------------------------------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"horizon": 0.02}, "horizon must be from 0.04 to 20 s, 2 to 1000 samples; got 0.02."),
        (
            {"horizon": 40},
            "horizon must be from 0.04 to 20 s, 2 to 1000 samples; got 40. If samples are meant, that is horizon=0.8.",
        ),
        ({"horizon": "long"}, "horizon must be from 0.04 to 20 s, 2 to 1000 samples; got 'long'."),
        ({"iterations": -1}, "iterations must be a whole number, at least 0; got -1."),
        ({"starts": 1.5}, "starts must be a whole number, at least 0; got 1.5."),
        (
            {"Q": (1, 2, 3)},
            "Q must be six finite weights, at least 0, of pos, th1, th2, vel, om1, om2; got (1, 2, 3).",
        ),
        ({"R": 0.0}, "R must be finite and greater than 0; got 0.0."),
        (
            {"target": (2.3, 0, 0, 0, 0, 0)},
            "The target must be clear of the track's end: expected |pos| < 2.25 m; got 2.3 m.",
        ),
    ],
)
def test_settings_out_of_range_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=whole(message)):
        ILQRMPC(RIG, **changes)


def test_several_plants_and_no_gravity_are_refused() -> None:
    with pytest.raises(
        ValueError, match=whole("iLQR takes one plant; got a rig of 2 rows. Take one of them with rig.rows(i).")
    ):
        ILQRMPC(RIG.replace(mass1=np.array([0.4, 0.5])))
    message = "Without gravity there is no scale of time and force: give horizon, Q and R."
    with pytest.raises(ValueError, match=whole(message)):
        ILQRMPC(RIG.replace(gravity=0.0))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"x0": np.zeros(5)}, "x0 must be one state of shape (6,); got shape (5,)."),
        ({"tolerance": -1.0}, "tolerance must be finite and at least 0; got -1.0."),
        ({"u_guess": np.zeros(9)}, "u_guess must be finite forces of shape (10,), one a sample; got shape (9,)."),
        ({"x_guess": np.zeros((9, 6))}, "x_guess must be states of shape (11, 6); got shape (9, 6)."),
    ],
)
def test_wrong_guesses_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=whole(message)):
        ilqr(**({"rig": RIG, "x0": np.zeros(6), "horizon": 0.2} | changes))
