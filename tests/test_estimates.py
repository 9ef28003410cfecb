"""Intervals hold what they promise on data of known probability, and are written in one way."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rigs import whole
from scipy import stats

import dpend
from controllers import LQR
from studies import lambda_sweep
from studies._estimates import Estimate, crossing, difference, mean_share, median, number, ranking, share, worst_cases
from studies._table import load


@cache
def of_two_hundred():
    return [share(successes, 200) for successes in range(201)]


@pytest.mark.parametrize("p", [0.05, 0.5, 0.9, 0.99])
def test_wilson_intervals_cover_the_true_share(p):
    covered = [successes for successes, rate in enumerate(of_two_hundred()) if rate.low <= p <= rate.high]
    assert 0.93 <= stats.binom.pmf(covered, 200, p).sum() <= 0.985


def test_wilson_matches_the_closed_form():
    s, n, z = 37, 50, 1.959963984540054
    centre = (s + z**2 / 2) / (n + z**2)
    half = z / (n + z**2) * np.sqrt(s * (n - s) / n + z**2 / 4)
    assert share(s, n) == pytest.approx((0.74, centre - half, centre + half))


@pytest.mark.parametrize(("gained", "lost"), [(0.05, 0.05), (0.02, 0.0), (0.3, 0.1)])
def test_intervals_of_a_difference_on_the_same_starts_cover_the_true_one(gained, lost):
    counts = np.random.default_rng(0).multinomial(100, (gained, lost, 1 - gained - lost), size=1000)
    found = [difference(np.repeat((1, 0, 1), n), np.repeat((0, 1, 1), n)) for n in counts]
    assert found[0].value == (counts[0, 0] - counts[0, 1]) / 100
    covered = np.mean([each.low <= gained - lost <= each.high for each in found])
    assert 0.93 <= covered <= (0.975 if lost else 1.0)  # conservative where hardly any differ


@pytest.mark.slow
@pytest.mark.parametrize("skills", [(8.0, 2.0), (2.0, 0.5)])
def test_intervals_over_ten_trainings_cover_the_mean_of_trainings_that_differ(skills):
    rng = np.random.default_rng(1)
    mean = skills[0] / sum(skills)
    covered = []
    for _ in range(1000):
        rate = mean_share(rng.binomial(100, rng.beta(skills[0], skills[1], 10)) / 100, 1000)
        covered.append(rate.low <= mean <= rate.high)
    assert 0.92 <= np.mean(covered) <= 0.98


def test_an_interval_over_trainings_is_never_narrower_than_that_of_all_episodes():
    for counts in ([100, 100, 100], [99, 100, 100], [10, 90, 50]):
        pooled, rate = share(sum(counts), 300), mean_share(np.array(counts) / 100, 300)
        assert rate.low <= pooled.low
        assert rate.high >= pooled.high
        assert rate.value == pooled.value


def test_the_interval_over_units_is_students():
    shares = np.random.default_rng(5).uniform(0.3, 0.7, 7)
    student = stats.ttest_1samp(shares, 0.0).confidence_interval(0.95)
    assert mean_share(shares, 700_000) == pytest.approx((shares.mean(), student.low, student.high))


def test_of_one_unit_the_interval_is_that_of_its_runs_and_of_no_trials_there_is_no_share():
    assert mean_share([0.4], 50) == share(20, 50)
    assert np.isnan(share(0, 0)).all()


# ---------------------------------------------------------------------------------------------------------- medians


@pytest.mark.nightly
@pytest.mark.parametrize("n", [6, 20, 25, 400])
def test_intervals_of_a_median_cover_it_whatever_the_values_are_like(n):
    rng = np.random.default_rng(3)
    found = [median(rng.lognormal(1.0, 2.0, n)) for _ in range(1500)]
    assert 0.94 <= np.mean([one.low <= np.e <= one.high for one in found]) <= 0.985


def test_the_interval_of_a_median_is_that_of_the_quantile_test():
    values = np.random.default_rng(4).normal(size=31)
    interval = stats.quantile_test(values, p=0.5).confidence_interval(0.95)
    assert median(values) == (np.median(values), interval.low, interval.high)


def test_few_values_are_their_own_interval_and_none_has_no_median():
    assert median([3.0, 1.0, 2.0]) == (2.0, 1.0, 3.0)
    assert median([5.0, 4.0, 1.0, 2.0, 3.0]) == (3.0, 1.0, 5.0)
    assert median([5.0]) == (5.0, 5.0, 5.0)
    assert np.isnan(median([])).all()


# -------------------------------------------------------------------------------------------------------- crossings

LEVELS = 0.05 * np.arange(1, 13)
MIDDLE, WIDTH = 0.35, 0.04


def where(share: float) -> float:
    """Return the level at which the logistic falls to a share."""
    return MIDDLE - WIDTH * np.log(share / (1 - share))


def fresh_starts(rng: np.random.Generator, n: int = 200) -> Any:
    """Draw other starts at each level."""
    return rng.random((n, len(LEVELS))) < 1 / (1 + np.exp((LEVELS - MIDDLE) / WIDTH))


def same_starts(rng: np.random.Generator, n: int = 200) -> Any:
    """Draw starts that are scaled by the level, each saved up to a level of its own."""
    return rng.logistic(MIDDLE, WIDTH, (n, 1)) > LEVELS


def trainings(rng: np.random.Generator, k: int = 10, middles: Any = None) -> Any:
    """Draw controllers of differing skill, tested on 100 starts a level."""
    middles = rng.normal(MIDDLE, 0.03, k) if middles is None else middles
    return rng.binomial(100, 1 / (1 + np.exp((LEVELS - middles[:, None]) / WIDTH))) / 100


def coverage(draw: Callable[[np.random.Generator], Any], share: float, truth: float, times: int) -> float:
    rng = np.random.default_rng(7)
    found = [crossing(LEVELS, draw(rng), share) for _ in range(times)]
    return float(np.mean([each.low <= truth <= each.high for each in found]))


@pytest.mark.parametrize("draw", [fresh_starts, same_starts])
@pytest.mark.parametrize("share", [0.5, 0.9])
def test_the_interval_of_a_crossing_covers_that_of_a_logistic(draw: Callable[..., Any], share: float) -> None:
    assert 0.905 <= coverage(draw, share, where(share), 200) <= 0.99


@pytest.mark.nightly
@pytest.mark.parametrize("draw", [fresh_starts, same_starts])
@pytest.mark.parametrize("share", [0.5, 0.9])
def test_the_interval_of_a_crossing_covers_that_of_a_logistic_many_times(
    draw: Callable[..., Any], share: float
) -> None:
    assert 0.93 <= coverage(draw, share, where(share), 1500) <= 0.97


LAMS = lambda_sweep.Options().lam
COMMITTED = Path(__file__).parent.parent / "docs/results/lambda_sweep_100"


@cache
def committed(name: str) -> Any:
    """Return which of its committed starts a contender saves, a hundred thousand of LQR at each λ."""
    return load(COMMITTED).array("saved", contender=name)


@pytest.mark.slow
def test_where_lqrs_committed_starts_fall_to_a_share_that_share_is_saved() -> None:
    rig, lqr = dpend.rig("gustafsson2016"), LQR(dpend.rig("gustafsson2016"))
    assert committed("LQR").shape == (100_000, len(LAMS))
    for part in (0.5, 0.9):
        task = dpend.Balance(lam=crossing(LAMS, committed("LQR"), part, square=True).value)
        starts = task.starts(np.random.default_rng([2, 1]), 20_000, rig)
        saved = dpend.simulate_many(rig, lqr, starts, task=task).success
        assert saved.mean() == pytest.approx(part, abs=0.008)  # 2.5 standard deviations


def covered(shared: bool, part: float, times: int) -> float:
    """Return how often the interval from a thousand of the committed starts holds where all of them fall to a share."""
    every, rng = committed("LQR"), np.random.default_rng(8)
    truth, columns = crossing(LAMS, every, part, square=True).value, np.arange(len(LAMS))
    held = []
    for _ in range(times):
        drawn = rng.integers(0, len(every), (1000, 1 if shared else len(LAMS)))
        found = crossing(LAMS, every[drawn, columns], part, square=True)
        held.append(found.low <= truth <= found.high)
    return float(np.mean(held))


@pytest.mark.slow
@pytest.mark.parametrize("part", [0.5, 0.9])
@pytest.mark.parametrize("shared", [True, False])
def test_the_interval_of_a_crossing_covers_that_of_lqrs_committed_starts(shared: bool, part: float) -> None:
    assert 0.90 <= covered(shared, part, 150) <= 0.99


@pytest.mark.nightly
@pytest.mark.parametrize("part", [0.5, 0.9])
@pytest.mark.parametrize("shared", [True, False])
def test_its_coverage_is_94_to_96_percent(shared: bool, part: float) -> None:
    assert 0.94 <= covered(shared, part, 4000) <= 0.96


@pytest.mark.slow
@pytest.mark.parametrize("n", [100, 1000])
@pytest.mark.parametrize("lam", [0.25, 0.3, 0.4, 0.6])
def test_wilsons_intervals_cover_the_share_of_lqrs_committed_starts(lam: float, n: int) -> None:
    saved = committed("LQR")[:, LAMS.index(lam)]
    truth, whole_blocks = saved.mean(), saved[: len(saved) // n * n].reshape(-1, n)
    found = [share(each.sum(), n) for each in whole_blocks]
    held = np.mean([each.low <= truth <= each.high for each in found])
    assert abs(held - 0.95) < 0.01 + 2.6 * (0.95 * 0.05 / len(found)) ** 0.5


@pytest.mark.slow
@pytest.mark.parametrize("lam", [0.3, 0.4, 0.6])
def test_intervals_of_a_difference_cover_that_of_two_laws_on_the_committed_starts(lam: float) -> None:
    ours, theirs = (committed(name)[:, LAMS.index(lam)] for name in ("tuned linear", "LQR"))
    truth = ours.mean() - theirs.mean()
    found = [difference(*each) for each in zip(ours.reshape(-1, 200), theirs.reshape(-1, 200), strict=True)]
    assert truth > 0.05
    assert abs(np.mean([each.low <= truth <= each.high for each in found]) - 0.95) < 0.03


@pytest.mark.slow
def test_the_interval_of_a_crossing_covers_the_mean_of_trainings_that_differ() -> None:
    nodes, weights = np.polynomial.hermite_e.hermegauss(40)
    mean = weights @ (1 / (1 + np.exp((LEVELS - MIDDLE - 0.03 * nodes[:, None]) / WIDTH))) / weights.sum()
    truth = crossing(LEVELS, np.tile(mean, (20_000, 1)), 0.5).value
    assert truth == pytest.approx(MIDDLE, abs=1e-3)
    assert 0.925 <= coverage(trainings, 0.5, truth, 400) <= 0.975


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
def test_the_crossing_of_an_exact_logistic_is_exact_between_levels(share: float) -> None:
    rows = np.tile(1 / (1 + np.exp((LEVELS - MIDDLE) / WIDTH)), (20_000, 1))
    found = crossing(LEVELS, rows, share)
    assert found.value == pytest.approx(where(share), abs=2e-4)
    assert found.low == pytest.approx(found.high, abs=1e-9)


def test_a_curve_that_is_symmetric_about_a_half_crosses_it_in_the_middle_however_few_its_rows() -> None:
    outcomes = np.ones((10, 2))
    outcomes[0, 0] = outcomes[1:, 1] = 0
    assert crossing([0.0, 1.0], outcomes).value == pytest.approx(0.5, abs=1e-12)


def test_a_curve_that_rises_by_chance_is_levelled() -> None:
    outcomes = np.repeat([[1.0, 0.4, 0.6, 0.0]], 50, axis=0)
    assert crossing([1, 2, 3, 4], outcomes, 0.6).value == pytest.approx(
        crossing([1, 2, 3, 4], np.repeat([[1.0, 0.5, 0.5, 0.0]], 50, axis=0), 0.6).value
    )


def test_a_crossing_beyond_the_levels_is_infinite_and_one_near_the_end_may_be() -> None:
    assert crossing([0.1, 0.2], np.ones((20, 2))) == (np.inf, np.inf, np.inf)
    assert crossing([0.1, 0.2], np.zeros((20, 2))) == (-np.inf, -np.inf, -np.inf)
    outcomes = np.ones((20, 2))
    outcomes[:11, 1] = 0
    found = crossing([0.1, 0.2], outcomes)
    assert 0.1 < found.low < found.value < 0.2
    assert found.high == np.inf


def test_the_order_of_the_rows_does_not_matter() -> None:
    outcomes = fresh_starts(np.random.default_rng(0))
    assert crossing(LEVELS, outcomes) == crossing(LEVELS, outcomes[::-1])


@pytest.mark.parametrize(
    ("levels", "outcomes", "share", "message"),
    [
        (
            [1, 2],
            np.ones((5, 3)),
            0.5,
            "Expected levels (L,) and outcomes (n, L) with at least two rows; got (2,) and (5, 3).",
        ),
        ([2, 1], np.ones((5, 2)), 0.5, "The levels must increase; got [2.0, 1.0]."),
        ([1, 2], np.ones((5, 2)), 1.0, "share must lie between 0 and 1; got 1.0."),
    ],
)
def test_crossings_of_nonsense_are_refused(levels: Any, outcomes: Any, share: float, message: str) -> None:
    with pytest.raises(ValueError, match=whole(message)):
        crossing(levels, outcomes, share)


@pytest.mark.parametrize("n", [6, 10])
def test_the_interval_of_a_crossing_of_few_rows_is_as_wide_as_students(n: int) -> None:
    scores = stats.norm.ppf((np.arange(n) + 0.5) / n)
    rows = np.array([0.6, 0.4]) + 0.004 * scores[:, None]  # so close that the crossing is linear in their mean
    found = crossing([0.0, 1.0], rows)
    student = stats.t.ppf(0.975, n - 1) * 0.004 * scores.std(ddof=1) / np.sqrt(n) / 0.2
    assert (found.high - found.low) / 2 == pytest.approx(student, rel=0.04)


# ------------------------------------------------------------------------------------------------------- worst cases


def test_the_worst_share_is_the_mean_of_the_worst_the_last_in_part() -> None:
    values = np.random.default_rng(0).permutation(np.arange(1.0, 11.0))
    assert worst_cases(values, 0.2).value == 1.5
    assert worst_cases(values, 0.25).value == pytest.approx((1 + 2 + 0.5 * 3) / 2.5)
    assert worst_cases(values, 1.0).value == pytest.approx(5.5)


def test_the_interval_of_the_worst_cases_covers_that_of_a_normal() -> None:
    rng = np.random.default_rng(1)
    truth = -stats.norm.pdf(stats.norm.ppf(0.1)) / 0.1
    found = [worst_cases(rng.standard_normal(256), 0.1, resamples=200, seed=i) for i in range(100)]
    assert 0.84 <= np.mean([each.low <= truth <= each.high for each in found]) <= 0.99


def test_worst_cases_that_are_all_alike_have_no_width() -> None:
    assert worst_cases(np.full(20, 0.7)) == pytest.approx((0.7, 0.7, 0.7))


@pytest.mark.parametrize(
    ("values", "tail", "message"),
    [
        (np.ones((3, 3)), 0.5, "Expected one finite number a case, shape (n,); got shape (3, 3)."),
        (np.ones(5), 0.1, "The worst 0.1 of 5 cases is less than one case, or more than all."),
    ],
)
def test_worst_cases_of_nonsense_are_refused(values: Any, tail: float, message: str) -> None:
    with pytest.raises(ValueError, match=whole(message)):
        worst_cases(values, tail)


# --------------------------------------------------------------------------------------------------------------- ranks


def outcome(outcomes: Any) -> list[Any]:
    return [(outcomes, np.ones(len(outcomes)))]


def test_what_is_better_on_every_start_is_first_in_every_resample():
    easy, hard = np.random.default_rng(0).random((2, 300)) < np.array([[0.9], [0.4]])
    found = ranking([outcome(easy & hard), outcome(easy | hard), outcome(np.zeros(300))])
    assert found.order.tolist() == [1, 0, 2]
    assert found.ranks == ((2, 2, 2), (1, 1, 1), (3, 3, 3))
    assert found.first.tolist() == [0, 1, 0]
    assert found.better[1].tolist() == [1, 0, 1]


def test_ranks_of_equals_are_as_unsure_as_chance_and_those_of_unequals_become_sure_with_more_starts():
    rng = np.random.default_rng(1)
    few, many = (ranking([outcome(rng.random(n) < p) for p in (0.4, 0.6)], resamples=400) for n in (20, 1000))
    assert few.ranks[0][1:] == (1, 2)
    assert (*many.ranks[1][1:], many.first[1]) == (1, 1, 1.0)
    halves = np.arange(200) % 2
    assert ranking([outcome(halves), outcome(1 - halves)]).better[0, 1] == pytest.approx(0.47, abs=0.06)


def test_intervals_of_ranks_hold_the_true_rank_as_often_as_they_say():
    rng = np.random.default_rng(2)
    held = []
    for repetition in range(40):
        outcomes = rng.random((3, 200)) < np.array([[0.8], [0.75], [0.7]])
        found = ranking([outcome(own) for own in outcomes], resamples=100, seed=repetition)
        held.append([rank.low <= true <= rank.high for true, rank in enumerate(found.ranks, 1)])
    assert np.mean(held) > 0.9


def test_pairs_count_not_the_luck_of_the_starts():
    level = np.random.default_rng(3).random(500)
    found = ranking([outcome(level < 0.5), outcome(level < 0.51)])
    assert found.better[1, 0] > 0.97  # independent samples with these shares would say 0.6


def test_a_contender_with_the_first_starts_only_is_compared_on_these():
    hard_first = np.concatenate([np.zeros(50), np.ones(950)])
    found = ranking([outcome(hard_first), outcome(np.concatenate([np.ones(25), np.zeros(25)]))])
    assert [rank.value for rank in found.ranks] == [2, 1]
    assert found.better[1, 0] == 1


def test_the_next_criterion_decides_between_equals_and_only_between_them():
    success, quick, slow = np.ones(20), np.full(20, -1.0), np.full(20, -2.0)
    found = ranking([[(success, success), (slow, success)], [(success, success), (quick, success)],
                     [(np.zeros(20), success), (np.zeros(20), np.zeros(20))]])  # fmt: skip
    assert [rank.value for rank in found.ranks] == [2, 1, 3]


def test_equals_share_a_rank():
    found = ranking([outcome(np.ones(5)), outcome(np.ones(5)), outcome(np.zeros(5))])
    assert [rank.value for rank in found.ranks] == [1, 1, 3]
    assert found.first.tolist() == [1, 1, 0]


@pytest.mark.parametrize(
    "criteria", [[], [[(np.ones(3), np.ones(2))]], [[(np.ones(3), np.ones(3)), (np.ones(2),) * 2]]]
)
def test_a_ranking_of_no_contender_or_of_ragged_runs_is_refused(criteria):
    message = "Expected, of at least one contender, criteria of two arrays (n,) each, all of the same n."
    with pytest.raises(ValueError, match=whole(message)):
        ranking(criteria)


# ------------------------------------------------------------------------------------------------------- how it is said


@pytest.mark.parametrize(
    ("value", "form", "written"),
    [
        (0.12345, "", "0.123"),
        (98765.4, "", "98,800"),
        (0.845, ".1%", "84.5"),
        (3.14159, ".2f", "3.14"),
        (np.nan, ".1%", "–"),
        (np.inf, "", "∞"),
    ],
)
def test_a_number_is_written_with_the_digits_that_count_and_without_the_sign_that_its_heading_has(value, form, written):
    assert number(value, form) == written


def test_an_estimate_is_written_with_its_interval_where_that_says_more():
    assert Estimate(0.845, 0.821, 0.866).written(".1%") == ("84.5", "[82.1, 86.6]")
    assert Estimate(1.0, 0.9996, 1.0).written(".1%") == ("100.0", "")
    assert Estimate(0.5).written(".1%") == ("50.0", "")
    assert Estimate().written() == ("–", "")
    assert f"{Estimate(2, 1, 3):.1f}" == "2.0 [1.0, 3.0]"


def test_a_crossing_beyond_the_levels_tried_is_more_or_less_than_these():
    tried = (0.05, 0.6)
    assert Estimate(0.25, -np.inf, np.inf).written(".3f", tried) == ("0.250", "[< 0.05, > 0.6]")
    assert Estimate(np.inf, np.inf, np.inf).written(".3f", tried) == ("> 0.6", "")
    assert Estimate(np.inf, 0.2, np.inf).written(".0%", (0.0, 0.25)) == ("> 25", "[20, > 25]")
