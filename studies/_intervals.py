"""Confidence intervals: of success rates, of medians, of the level where success falls, and of the worst cases."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import stats
from scipy.special import logit

from dpend.params import Array


class Rate(NamedTuple):
    """A share of successes with its 95 % confidence interval, all within 0 and 1."""

    share: float
    low: float
    high: float


def wilson(successes: int, n: int) -> Rate:
    r"""Return the Wilson score interval of :math:`s/n`.

    Parameters
    ----------
    successes, n : int
        Successes, and trials; at least one trial.

    Returns
    -------
    Rate
    """
    interval = stats.binomtest(successes, n).proportion_ci(method="wilson")
    return Rate(successes / n, float(interval.low), float(interval.high))


def over_seeds(successes: npt.ArrayLike, n: int) -> Rate:
    """Return the mean success of several trained controllers, the training being the unit of replication.

    The interval is Student's over trainings, cut off at 0 and 1, or the Wilson interval of all episodes taken together
    where that is wider, as when every controller has the same count.  The bootstrap is too narrow for ten trainings.

    Parameters
    ----------
    successes : array_like (k,)
        Successes of each controller.
    n : int
        Episodes of each.

    Returns
    -------
    Rate
    """
    counts = np.asarray(successes, dtype=np.int64)
    pooled = wilson(int(counts.sum()), n * len(counts))
    if len(counts) < 2:
        return pooled
    half = stats.t.ppf(0.975, len(counts) - 1) * np.std(counts / n, ddof=1) / np.sqrt(len(counts))
    low, high = max(0.0, pooled.share - half), min(1.0, pooled.share + half)
    return Rate(pooled.share, min(pooled.low, float(low)), max(pooled.high, float(high)))


class Median(NamedTuple):
    """A median with its 95 % confidence interval; not a number where there is nothing to take it of."""

    median: float
    low: float
    high: float


def median(values: npt.ArrayLike) -> Median:
    """Return median of values with the interval between two of them that holds the true one, whatever they are like.

    Parameters
    ----------
    values : array_like (n,)
        One number a run or training.

    Returns
    -------
    Median
        How many values lie below the true median is binomial, so order statistics enclose it with at least 95 %; the
        bootstrap of a median comes to the same and draws lots for it.  Of fewer than six values the interval is from
        the least to the greatest, which hold it with probability :math:`1 - 2^{1 - n}` only.
    """
    ordered = np.sort(np.asarray(values, dtype=np.float64))
    n = len(ordered)
    if n == 0:
        return Median(np.nan, np.nan, np.nan)
    outside = max(int(stats.binom.ppf(0.025, n, 0.5)) - 1, 0)  # the interval leaves out so many at each end
    return Median(float(np.median(ordered)), float(ordered[outside]), float(ordered[n - 1 - outside]))


class Crossing(NamedTuple):
    """A level with its 95 % confidence interval; minus or plus infinite where it lies outside the levels tried."""

    level: float
    low: float
    high: float


def crossing(
    levels: npt.ArrayLike, outcomes: npt.ArrayLike, share: float = 0.5, *, resamples: int = 1000, seed: int = 0
) -> Crossing:
    r"""Return the level at which success falls to a share, such as :math:`\lambda_{50}` or :math:`\lambda_{90}`.

    The curve is the best that never rises (isotonic), logistic between levels, so that it is exact where success is a
    logistic function of the level, and free to have a plateau where it is not.  The interval is the bootstrap's over
    rows, its percentiles expanded for few rows as Student's distribution expands the normal's.  Rows may differ by
    chance, or be the same starts at every level: their ties are kept, since a row is drawn whole.

    Parameters
    ----------
    levels : array_like (L,)
        Increasing.
    outcomes : array_like (n, L)
        A row for each unit of replication: a start's successes, or the shares of a trained controller.
    share : float
        Between 0 and 1.
    resamples : int
        Bootstrap samples.
    seed : int
        What they are drawn from.

    Returns
    -------
    Crossing

    Raises
    ------
    ValueError
        If the shapes do not fit, the levels do not increase, or the share is not between 0 and 1.

    Notes
    -----
    With starts as rows the interval covers as it should from some 200 on, with ten trainings as rows too.  What is
    assumed between levels shows in :math:`\lambda_{90}` where success falls by more than a third from one to the next.

    Source of the expansion: T. Hesterberg, *What Teachers Should Know About the Bootstrap*, 2015.
    """
    points = np.asarray(levels, dtype=np.float64)
    rows = np.asarray(outcomes, dtype=np.float64)
    if rows.ndim != 2 or points.shape != rows.shape[1:] or len(rows) < 2:
        raise ValueError(
            f"Expected levels (L,) and outcomes (n, L) with at least two rows; got {points.shape} and {rows.shape}."
        )
    if not (np.diff(points) > 0).all():
        raise ValueError(f"The levels must increase; got {points.tolist()}.")
    if not 0 < share < 1:
        raise ValueError(f"share must lie between 0 and 1; got {share!r}.")
    n = len(rows)
    distinct, counts = np.unique(rows, axis=0, return_counts=True)  # few, however many starts there are
    drawn = np.random.default_rng(seed).multinomial(n, counts / n, size=resamples) / n
    found = float(_crossed(points, rows.mean(axis=0, keepdims=True), share, n)[0])
    tail = stats.norm.cdf(stats.t.ppf(0.025, n - 1) * np.sqrt(n / (n - 1)))
    low, high = np.quantile(_crossed(points, drawn @ distinct, share, n), [tail, 1 - tail], method="inverted_cdf")
    return Crossing(found, min(float(low), found), max(float(high), found))


def _crossed(levels: Array, curves: Array, share: float, n: int) -> Array:
    """Return where curves, made to fall, cross a share; half a success and half a failure keep their logits finite."""
    falling = falling_fit(curves)
    below = falling < share - 1e-12  # a mean that should equal the share may miss it by rounding
    after = np.clip(np.argmax(below, axis=1), 1, None)
    if len(levels) == 1:
        return np.where(below[:, 0], -np.inf, np.inf)
    each = np.arange(len(curves))
    above, under = (logit((n * falling[each, at] + 0.5) / (n + 1)) for at in (after - 1, after))
    with np.errstate(invalid="ignore", divide="ignore"):  # where a curve does not cross
        part = (above - logit((n * share + 0.5) / (n + 1))) / (above - under)
        level = levels[after - 1] + part * (levels[after] - levels[after - 1])
    return np.where(below[:, 0], -np.inf, np.where(below[:, -1], level, np.inf))


def falling_fit(curves: Array) -> Array:
    r"""Return the curves that never rise and are nearest in least squares, a row each.

    It is :math:`\hat y_i = \min_{a \le i} \max_{b \ge i} \bar y_{a..b}`, for many short curves at once.

    Parameters
    ----------
    curves : ndarray (m, L)
        Curves.

    Returns
    -------
    ndarray (m, L)

    Notes
    -----
    Source: T. Robertson, F. T. Wright and R. L. Dykstra, *Order Restricted Statistical Inference*, 1988, section 1.4.
    """
    m, L = curves.shape
    sums = np.concatenate([np.zeros((m, 1)), np.cumsum(curves, axis=1)], axis=1)
    fitted = np.full((m, L), np.inf)
    for a in range(L):
        means = (sums[:, a + 1 :] - sums[:, a, None]) / np.arange(1, L - a + 1)
        greatest = np.maximum.accumulate(means[:, ::-1], axis=1)[:, ::-1]
        np.minimum(fitted[:, a:], greatest, out=fitted[:, a:])
    return fitted


class Tail(NamedTuple):
    """The mean of the worst cases with its 95 % confidence interval, and the worst case of all."""

    cvar: float
    low: float
    high: float
    worst: float


def worst_cases(
    values: npt.ArrayLike,
    share: float = 0.1,
    bad: Literal["low", "high"] = "low",
    *,
    resamples: int = 1000,
    seed: int = 0,
) -> Tail:
    r"""Return the conditional value at risk: the mean of the worst share of cases.

    Parameters
    ----------
    values : array_like (n,)
        One number a case, such as the share of starts that a controller saves on one plant out of many.
    share : float
        :math:`\alpha`, above 0, at most 1; where :math:`\alpha n` is no whole number, the last case counts in part.
    bad : {"low", "high"}
        Which end is the worst.
    resamples : int
        Bootstrap samples.
    seed : int
        What they are drawn from.

    Returns
    -------
    Tail
        The interval is the bootstrap's over cases, too narrow where fewer than some 25 are in the tail; the worst case
        has none, since it only grows worse with more cases.

    Raises
    ------
    ValueError
        If the values are not a row of finite numbers, or the share holds less than one of them.

    Notes
    -----
    Source: R. T. Rockafellar and S. Uryasev, *Optimization of Conditional Value-at-Risk*, 2000.
    """
    cases = np.asarray(values, dtype=np.float64)
    if cases.ndim != 1 or not np.isfinite(cases).all():
        raise ValueError(f"Expected one finite number a case, shape (n,); got shape {cases.shape}.")
    if bad not in ("low", "high"):
        raise ValueError(f'bad must be "low" or "high"; got {bad!r}.')
    if not (share <= 1 and share * len(cases) >= 1):
        raise ValueError(f"The worst {share!r} of {len(cases)} cases is less than one case, or more than all.")
    sign = 1.0 if bad == "low" else -1.0
    counted = np.clip(share * len(cases) - np.arange(len(cases)), 0.0, 1.0)  # the last in part

    def mean_of_worst(drawn: Array, axis: int = -1) -> Array:
        return sign * (np.sort(sign * drawn, axis=axis) * counted).sum(axis=axis) / counted.sum()

    found = float(mean_of_worst(cases))
    low = high = found
    if np.ptp(cases) > 0:
        interval = stats.bootstrap(
            (cases,), mean_of_worst, n_resamples=resamples, method="percentile", rng=np.random.default_rng(seed)
        ).confidence_interval
        low, high = min(float(interval.low), found), max(float(interval.high), found)
    return Tail(found, low, high, float((sign * cases).min() * sign))
