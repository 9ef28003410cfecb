"""Crocoddyl's BoxFDDP solves the very problem that our iLQR does, where the benchmark compares their times."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import boxfddp
from controllers.ilqr_kernels import cost_of, problem_at
from dpend.params import Array

needs_crocoddyl = pytest.mark.skipif(
    not boxfddp.usable(),
    reason="crocoddyl, and the Pinocchio it was built for, are not installed; install the extra `peers`.",
)


def euler(x: Array, u: float) -> Array:
    """Return the state after one step, by the function that is compiled for the planner."""
    return np.array(boxfddp.MODEL.step(tuple(x), u, boxfddp.MODEL.parameters))


def test_the_slopes_of_a_step_are_those_of_small_differences() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        x, u, small = rng.normal(size=6) * [1, 3, 3, 2, 5, 5], rng.normal() * 20, 1e-6
        A, B = boxfddp.MODEL.slopes(x, u)
        by_state = [(euler(x + small * e, u) - euler(x - small * e, u)) / (2 * small) for e in np.eye(6)]
        by_force = (euler(x, u + small) - euler(x, u - small)) / (2 * small)
        np.testing.assert_allclose(A, np.transpose(by_state), atol=1e-7)
        np.testing.assert_allclose(B[:, 0], by_force, atol=1e-7)


@needs_crocoddyl
def test_both_solvers_put_the_same_price_on_the_same_forces() -> None:
    plan = boxfddp.on_euler_steps()
    for seed in range(5):
        u, x = boxfddp.guess(seed), [boxfddp.BEGIN]
        for force in u:
            x.append(euler(x[-1], force))
        price = cost_of(np.array(x), u, problem_at(tuple(boxfddp.BEGIN), plan.setting.problem), plan.P)
        assert boxfddp.theirs(plan, u)(0).cost == pytest.approx(price, rel=1e-10)


@needs_crocoddyl
@pytest.mark.slow
def test_both_solvers_find_the_plan_that_the_benchmark_takes_for_the_same() -> None:
    plan, u = boxfddp.on_euler_steps(), boxfddp.guess(0)
    mine, other = boxfddp.ours(plan, u)(boxfddp.MOST), boxfddp.theirs(plan, u)(boxfddp.MOST)
    assert mine.converged
    assert other.converged
    assert mine.cost == pytest.approx(other.cost, rel=boxfddp.SAME)
    np.testing.assert_allclose(mine.u, other.u, atol=0.5)
    assert np.abs(mine.u).max() <= boxfddp.RIG.force_limit
