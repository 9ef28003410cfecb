"""Intervals hold what they promise on data of known probability."""

import numpy as np
import pytest

from studies._intervals import over_seeds, wilson


@pytest.mark.parametrize("p", [0.05, 0.5, 0.9, 0.99])
def test_wilson_intervals_cover_the_true_share(p):
    rng = np.random.default_rng(0)
    covered = [rate.low <= p <= rate.high for rate in (wilson(int(s), 200) for s in rng.binomial(200, p, 1500))]
    assert 0.93 <= np.mean(covered) <= 0.985


def test_wilson_matches_the_closed_form():
    s, n, z = 37, 50, 1.959963984540054
    centre = (s + z**2 / 2) / (n + z**2)
    half = z / (n + z**2) * np.sqrt(s * (n - s) / n + z**2 / 4)
    assert wilson(s, n) == pytest.approx((0.74, centre - half, centre + half))


@pytest.mark.parametrize("skills", [(8.0, 2.0), (2.0, 0.5)])
def test_intervals_over_ten_trainings_cover_the_mean_of_trainings_that_differ(skills):
    rng = np.random.default_rng(1)
    mean = skills[0] / sum(skills)
    covered = []
    for _ in range(1000):
        rate = over_seeds(rng.binomial(100, rng.beta(skills[0], skills[1], 10)), 100)
        covered.append(rate.low <= mean <= rate.high)
    assert 0.92 <= np.mean(covered) <= 0.98


def test_an_interval_over_trainings_is_never_narrower_than_that_of_all_episodes():
    for counts in ([100, 100, 100], [99, 100, 100], [10, 90, 50]):
        pooled, rate = wilson(sum(counts), 300), over_seeds(counts, 100)
        assert rate.low <= pooled.low
        assert rate.high >= pooled.high
        assert rate.share == pooled.share
