"""The study of LSPI: the gain that it is compared with, and starts that all controllers have in common."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

import dpend
from rl import LSPI
from studies import lspi
from studies._field import RIG
from studies._runner import Table, plain_fields
from studies._tables import markdown
from studies.lspi import LAMS, REFERENCE, STYLES, Job


def test_the_riccati_gain_is_greedy_for_the_discounted_cost_that_it_has():
    learner = LSPI(RIG)
    A, B = dpend.discretize(*dpend.linearize(RIG.params), RIG.sample_time)
    K = lspi.reference(RIG)[None]
    Q, R, gamma = np.diag(learner.state_weights), learner.force_weight, learner.gamma
    P = np.zeros((6, 6))
    for _ in range(4000):
        P = Q + R * K.T @ K + gamma * (A - B @ K).T @ P @ (A - B @ K)
    greedy = gamma * B.T @ P @ A / (R + gamma * B.T @ P @ B)
    assert_allclose(greedy, K, rtol=1e-8)


def test_the_kth_training_of_each_has_the_kth_part_of_the_starts():
    whole, second = (lspi.run(Job(REFERENCE, k, n, 1)).arrays["saved"] for k, n in ((0, 40), (1, 20)))
    assert whole.shape == (40, len(LAMS))
    assert 0 < whole[20:].sum() < whole[20:].size
    assert (second == whole[20:]).all()


def test_quick_jobs_are_fewer_and_smaller():
    quick, full = lspi.jobs(lspi.Options(quick=True)), lspi.jobs(lspi.Options(trainings=2))
    assert [replace(job, episodes=300) for job in quick] == full
    assert {job.episodes for job in quick} == {20}
    with pytest.raises(ValueError, match=r"^--episodes must be at least 1; got 0\.$"):
        lspi.Options(episodes=0)


def test_the_report_says_how_many_gains_were_found_and_the_gaps_to_the_riccati_gain():
    rows, arrays = [], {}
    for name in STYLES:
        for k in range(2):
            job, error = Job(name, k, 10, 0), 0.01 + 0.1 * k
            arrays[len(arrays)] = {
                "force": np.zeros(4),
                "errors": np.array([1.0, error]),
                "experience": np.array([1, 9]),
            }
            saved = 8 if name == REFERENCE else 5 + k
            rows += [
                {"job": len(arrays) - 1, **plain_fields(job), "lam": lam, "successes": saved, "variation": 2.0,
                 "error": error, "experience": 9.0}
                for lam in LAMS
            ]  # fmt: skip
    found, success = lspi.report(Table(pd.DataFrame(rows), by_job=arrays)).tables
    assert "| LSPI, 60 s | 1 of 2 [9, 91] | 6.00 | 10.00 | 11.00 | 9 |" in markdown(found)
    assert "-30.0 to -20.0" in markdown(success)
    assert "+0.0 to +0.0" in markdown(success)
