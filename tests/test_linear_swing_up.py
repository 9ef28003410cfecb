"""The search among linear laws for a swing-up: its roll-outs, its evolution strategy, its laws."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import dpend
from studies.linear_swing_up import LinearLaw, _evolve, _regulators, _scores, _task

RIG = dpend.rig("gustafsson2016")


def test_a_roll_out_counts_as_the_simulation_does():
    rng = np.random.default_rng(0)
    K = np.vstack([_regulators(3, rng), 30 * rng.normal(size=(20, 6))])
    for sign in (False, True):
        scores, longest, up = _scores(K, "up-up", sign, True, 100)
        task = dpend.SwingUp(start="up-up", steps=100)
        starts = task.starts(rng, len(K), RIG)
        runs = dpend.simulate_many(RIG, LinearLaw(K, 40.0, sign=sign, nearest=True), starts, task=task, record=True)
        assert (up == runs.success).all()
        assert up.any()
        assert runs.x is not None
        held = np.array([task.upright(x[: n + 1]).sum() for x, n in zip(runs.x, runs.steps, strict=True)])
        assert (longest <= 0.02 * held + 1e-9).all()
        assert (scores[up] > np.delete(scores, np.flatnonzero(up)).max(initial=0.0)).all()


def test_the_evolution_strategy_finds_the_top_of_a_hill():
    top = np.array([3.0, -2.0, 1.0, 0.5, -4.0, 8.0])

    def hill(points):
        height = -np.square((points - top) * np.array([1, 10, 1, 0.1, 1, 3])).sum(axis=1)
        return height, np.zeros(len(points)), height > -1e-3

    (best, score, _), curve, successes = _evolve(hill, np.zeros(6), 1.0, 60, np.random.default_rng(1))
    assert_allclose(best, top, atol=1e-2)
    assert score == curve[-1]
    assert (np.diff(curve) >= 0).all()
    assert successes > 0


def test_the_law_is_linear_or_its_sign_and_one_gain_serves_all_rows_or_one():
    rng = np.random.default_rng(2)
    K, y = rng.normal(size=(5, 6)), 3 * rng.normal(size=(5, 6))
    u = LinearLaw(K, 4.0, sign=False, nearest=False).start(5, rng)(0.0, y)
    assert_allclose(u, np.clip((K * y).sum(axis=1), -4, 4))
    u = LinearLaw(K[0], 4.0, sign=True, nearest=True).start(5, rng)(0.0, y)
    assert_allclose(u, 4 * np.sign(dpend.nearest_upright(y) @ K[0]))


def test_drawn_regulators_hold_upright():
    A, B = dpend.discretize(*dpend.linearize(RIG.params), RIG.sample_time)
    for K in _regulators(5, np.random.default_rng(3)):
        assert np.abs(np.linalg.eigvals(A + B @ K[None])).max() < 1


@pytest.mark.parametrize(("start", "angle"), [("side", np.pi / 2), ("hanging", np.pi)])
def test_swing_ups_start_at_rest(start, angle):
    assert_allclose(_task(start).starts(np.random.default_rng(0), 1, RIG), [[0, angle, angle, 0, 0, 0]])
