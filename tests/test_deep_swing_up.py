"""The study of deep swing-ups: what a training left, and the least variation of force, a bound that no law passes."""

import numpy as np
import pandas as pd
import pytest

import dpend
from controllers import LQR
from rl.deep import read_trainings
from studies import deep_swing_up
from studies._table import Table
from studies.deep_swing_up import LEAST, LQR_BALANCE, Options, least_variation
from tests.rigs import whole

RIG = dpend.rig("gustafsson2016")
X0 = np.array([0.0, 0.05, -0.03, 0.0, 0.0, 0.0])


@pytest.mark.slow
def test_no_law_varies_its_force_less_than_the_least():
    least = least_variation(RIG, X0)
    for Q, R in (([1] * 6, 1.0), ([1e-3] * 6, 1.0), ([1, 10, 10, 1, 1, 1], 0.1)):
        run = dpend.simulate(RIG, LQR(RIG, Q=Q, R=R), X0, task=dpend.Balance(lam=0.1))
        assert run.success
        assert 0 < least < float(run.metrics()["variation"])


@pytest.mark.slow
def test_it_is_a_norm_cut_off_by_the_limits():
    least = least_variation(RIG, X0)
    assert least_variation(RIG, np.zeros(6)) == pytest.approx(0.0, abs=1e-9)
    assert least_variation(RIG, -X0) == pytest.approx(least, rel=1e-6)
    assert 0 < least_variation(RIG, 0.5 * X0) <= 0.5 * least * (1 + 1e-6)


def test_what_no_force_can_save_has_none():
    assert least_variation(RIG, 30 * X0) == np.inf


def test_every_training_of_our_plant_is_a_job_and_none_of_another_environment():
    jobs = deep_swing_up.jobs(Options())
    learners = [job.learner for job in jobs]
    assert {LEAST, LQR_BALANCE, "ppo-swing-up", "td3-swing-up"} <= set(learners)
    assert not any("inverted" in name for name in learners)
    assert [job.training for job in jobs if job.learner == "ppo-swing-up-near"] == [30, 31]


@pytest.mark.slow
def test_the_cost_in_the_table_is_that_of_the_training_and_the_bound_stands_beside():
    chosen = ("ppo-swing-up-near", LQR_BALANCE)
    jobs = [job for job in deep_swing_up.jobs(Options(quick=True, starts=20)) if job.learner in (LEAST, LQR_BALANCE)]
    jobs += [job for job in deep_swing_up.jobs(Options(starts=20)) if job.learner == chosen[0]]
    results = [deep_swing_up.run(job) for job in jobs]
    frame = pd.DataFrame(
        [
            {"job": k, "learner": job.learner, "training": job.training, "starts": job.starts} | vars(result.rows[0])
            for k, (job, result) in enumerate(zip(jobs, results, strict=True))
        ]
    )
    own = frame[frame["training"] == 30].iloc[0]
    training = read_trainings("docs/results/deep/ppo-swing-up-near.npz")[30]
    assert own["steps"] == training.curve["steps"][-1]
    assert own["steps_to_most"] == training.curve["steps"][np.argmax(training.curve["success"] >= 0.95)]
    assert own["successes"] >= 19
    report = deep_swing_up.report(Table(frame, False, {k: each.arrays for k, each in enumerate(results)}))
    (table,) = report.tables
    assert [line[0].text for line in table.lines] == [chosen[0], LQR_BALANCE, LEAST]
    assert table.lines[0][1].text == "2"
    assert {line[2].text for line in table.lines[2:]} == {"–"}


def test_a_folder_without_trainings_is_refused(tmp_path):
    message = f"--runs {tmp_path} holds no trainings; make some with python -m rl.train."
    with pytest.raises(ValueError, match=whole(message)):
        Options(runs=tmp_path)
