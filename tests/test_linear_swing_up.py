"""The search among linear laws for a swing-up: its roll-outs, its evolution strategy, its laws."""

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

import dpend
from studies import linear_swing_up
from studies._runner import Table, plain_fields
from studies._tables import markdown
from studies.linear_swing_up import (
    FEATURES,
    FORCES,
    LAWS,
    STARTS,
    STATES,
    Job,
    LinearLaw,
    Options,
    Score,
    _evolve,
    _holding,
    _scores,
    _task,
)

RIG = dpend.rig("gustafsson2016")


@pytest.mark.parametrize("law", LAWS)
def test_a_roll_out_counts_as_the_simulation_does(law):
    rng = np.random.default_rng(0)
    K = np.vstack([_holding(RIG, 8, rng), 30 * rng.normal(size=(20, 6))])
    task = dpend.SwingUp(start="up-up", angle_spread=0.02, steps=100)
    starts = task.starts(rng, len(K), RIG)
    scores, longest, up = _scores(RIG, K, starts, law, "nearest turn", 100)
    runs = dpend.simulate_many(RIG, LinearLaw(K, law, "nearest turn", 40.0), starts, task=task, record=True)
    assert (up == runs.success).all()
    assert up.any()
    assert not up.all()
    held = np.array([task.upright(x[: n + 1]).sum() for x, n in zip(runs.x, runs.steps, strict=True)])
    assert (longest <= 0.02 * held + 1e-9).all()
    assert (scores[up] > np.delete(scores, np.flatnonzero(up)).max(initial=0.0)).all()


def test_the_evolution_strategy_finds_the_top_of_a_hill():
    top = np.array([3.0, -2.0, 1.0, 0.5, -4.0, 8.0])

    def hill(gains):
        height = -np.square((gains - top) * np.array([1, 10, 1, 0.1, 1, 3])).sum(axis=1)
        return Score(height, np.zeros(len(gains)), height > -1e-3)

    best, curve, successes = _evolve(hill, np.ones(6), 128, 80, np.random.default_rng(1))
    assert_allclose(best[0], top, atol=0.02)
    assert (np.diff([hill(K[None]).value[0] for K in best]) <= 0).all()
    assert (np.diff(curve) >= 0).all()
    assert successes > 0


def test_the_law_is_linear_or_its_sign_and_one_gain_serves_all_rows_or_one():
    rng = np.random.default_rng(2)
    K, y = 20 * rng.normal(size=(5, 6)), 3 * rng.normal(size=(5, 6))
    linear, sign = LAWS
    as_they_are, nearest = STATES
    u = LinearLaw(K, linear, as_they_are, 40.0).start(5, rng)(0.0, y)
    assert_allclose(u, np.clip((K * y).sum(axis=1), -40, 40))
    u = LinearLaw(K[0], sign, nearest, 40.0).start(5, rng)(0.0, y)
    assert_allclose(u, 40 * np.sign(dpend.nearest_upright(y) @ K[0]))


def test_drawn_gains_hold_upright():
    A, B = dpend.discretize(*dpend.linearize(RIG.params), RIG.sample_time)
    gains = _holding(RIG, 50, np.random.default_rng(3))
    assert gains.shape == (50, 6)
    for K in gains:
        assert np.abs(np.linalg.eigvals(A + B @ K[None])).max() < 1


@pytest.mark.parametrize(("start", "angle"), [("side", np.pi / 2), ("hanging", np.pi)])
def test_swing_ups_start_at_rest(start, angle):
    assert_allclose(_task(start).starts(np.random.default_rng(0), 1, RIG), [[0, angle, angle, 0, 0, 0]])


def test_sizes_in_the_table_are_those_that_were_run():
    rows = [
        {"job": 0, **plain_fields(Job(part="search", seed=0, law="K·s", state="nearest turn", starts_near=20)),
         "outcome": "not up", "episodes": 64, "successes": 0, "longest": 0.5, "near": 5},
        {"job": 1, **plain_fields(Job(part="learning", seed=0, features="scaled", trainings=1)),
         "outcome": "diverged", "episodes": 7, "successes": 0, "longest": 0.25, "near": 0},
    ]  # fmt: skip
    arrays = {"scores": np.ones(3), "angles": np.zeros((5, 2))}
    learned, searched = linear_swing_up.report(Table(pd.DataFrame(rows), by_job={0: arrays})).tables
    assert "| scaled | 1 | 1 | 7 | 0 | 0.25 |" in markdown(learned)
    line = "| side | K·s, nearest turn | 64 | 0 | not up | 0.50 | 20 | 25.0 [11.2, 46.9] |"
    assert line in markdown(searched)


def test_a_quick_search_is_smaller_but_its_runs_are_as_long():
    quick, full = linear_swing_up.jobs(Options(quick=True)), linear_swing_up.jobs(Options())
    assert {job.part for job in quick} == {"learning", "search"}
    assert len(full) == len(STARTS) * len(LAWS) * len(STATES) + len(FEATURES) * len(FORCES)
    assert {job.starts_near for job in full if job.part == "search"} == {1000}
    (search,) = (job for job in quick if job.part == "search")
    assert search.candidates == 64
    (row,), arrays = linear_swing_up.run(search)
    assert row["episodes"] == 64 + 256 * search.generations
    assert (arrays["saved"].sum(), len(arrays["saved"])) == (row["near"], search.starts_near)
