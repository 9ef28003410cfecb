"""The study of Gaussian QAC: its jobs cover the report's ranges, and what is kept of a training."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from rl import GaussianQAC
from rl.natural_qac import ablations
from studies import gaussian_qac
from studies._field import RIG
from studies.gaussian_qac import LONG, REGULATOR, STEPS, TUNED, VARIANCES, VARIANTS, Options


def test_the_jobs_try_every_setting_of_the_ranges_and_every_deviation():
    jobs = gaussian_qac.jobs(Options(short=3, trainings=4, ablated=2))
    tried = {(job.setting, job.variance, job.alphas, job.betas) for job in jobs if job.part == "ranges"}
    assert tried == {(variant, variance, STEPS, STEPS) for variant in VARIANTS for variance in VARIANCES}
    assert {job.trainings for job in jobs if job.part == "ranges"} == {(0, 1, 2)}
    tuned = [(job.setting, *job.trainings) for job in jobs if job.part == TUNED]
    assert tuned == [(name, k) for name in ablations(RIG) for k in range(4 if name == TUNED else 2)]
    assert [job.trainings for job in jobs if job.part == REGULATOR] == [(0, 1, 2, 3)]
    assert len({(job.alphas, job.betas, job.variance) for job in jobs if job.part == LONG}) == 32


def test_a_job_trains_the_reports_learner_with_each_of_its_steps_and_seeds():
    (job, *_) = (job for job in gaussian_qac.jobs(Options(short=2, short_episodes=5)) if job.setting == "signs")
    rows = gaussian_qac.run(replace(job, alphas=STEPS[:2], betas=STEPS[1:3], episodes=4)).rows
    assert [(row["alpha"], row["beta"], row["training"]) for row in rows] == [
        (alpha, beta, k) for alpha in STEPS[:2] for beta in STEPS[1:3] for k in (0, 1)
    ]
    learner = GaussianQAC.published(
        RIG, alpha=STEPS[1], beta=STEPS[2], variance=job.variance, indicators="signs", max_episodes=5
    )
    training = learner.train([0, 9, 1])
    assert (rows[-1]["training_episodes"], rows[-1]["training_steps"]) == (5, training.cost.steps)
    assert rows[-1]["longest"] == round(training.curve["length"].mean(), 2)


@pytest.mark.slow
def test_the_tuned_learner_is_followed_while_it_learns_and_lqr_has_its_starts():
    tuned, lqr = (
        replace(job, episodes=40)
        for job in gaussian_qac.jobs(Options(quick=True))
        if job.setting == TUNED or job.part == REGULATOR
    )
    rows, arrays = gaussian_qac.run(tuned)
    saves = {row["lam"]: row["successes"] for row in rows}
    assert saves[0.1] == 40
    first = np.flatnonzero(arrays["share"] >= 0.99)[0]
    assert 0 < rows[0]["learned_after"] == arrays["at_episode"][first]
    for row in gaussian_qac.run(lqr).rows:
        assert abs(row["successes"] - saves[row["lam"]]) <= 6


def test_mean_lengths_are_those_of_all_episodes_in_bins():
    lengths = np.floor(np.random.default_rng(0).uniform(20, 300, 1234))
    kept = gaussian_qac._mean_lengths(lengths)
    n = np.diff(kept["at_episode"], prepend=0)
    assert (n > 0).all()
    assert_allclose(np.sum(n * kept["lengths"]), lengths.sum())
    assert len(gaussian_qac._mean_lengths(lengths[:0])["lengths"]) == 1
