"""Estimates with 95 % intervals, how they are written, and what yields one: shares, means, medians, crossings, ranks.

The tests show what each covers, on data of known probability.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import stats
from scipy.interpolate import PchipInterpolator
from scipy.optimize import isotonic_regression
from scipy.special import expit, logit

from dpend.params import Array

QUARTILES = (0.25, 0.5, 0.75)
"""For ``np.quantile(curves, QUARTILES, axis=0)``, which :func:`studies._figures.band` draws."""

Tried = tuple[float, float]
"""The least and the greatest level tried: what lies beyond is written as more or less than these."""


class Estimate(NamedTuple):
    """A value with its 95 % interval, in the value's unit."""

    value: float = math.nan
    """NaN where there is nothing to take it of; a crossing beyond the levels tried is minus or plus infinite."""
    low: float = math.nan
    high: float = math.nan  # The interval's ends, which may be infinite likewise; NaN where there is none.

    def written(self, form: str = "", tried: Tried | None = None) -> tuple[str, str]:
        """Return value and interval in words, such as ``("84.5", "[82.1, 86.6]")``, as :func:`number` writes them.

        The interval is empty where it would say no more than the value.
        """
        value, low, high = (number(each, form, tried) for each in self)
        said = math.isnan(self.low) or value == low == high
        return value, "" if said else f"[{low}, {high}]"

    def __format__(self, form: str) -> str:
        """Return value and interval in one, as in ``f"{share(3, 4):.1%}"``."""
        return " ".join(self.written(form)).strip()


def number(value: float, form: str = "", tried: Tried | None = None) -> str:
    """Return a number in words, the one way in which figures stand in tables and legends; NaN is a dash.

    The form is that of ``format``, but of percentages the sign is left out, since the heading says it; without one,
    three digits that count, and thousands apart.  An infinite value is ``"< 0.05"`` or ``"> 0.6"``, the least or the
    greatest level tried.
    """
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        if tried is None:
            return "∞" if value > 0 else "−∞"
        scale = 100 if form.endswith("%") else 1
        return f"{'>' if value > 0 else '<'} {scale * tried[value > 0]:g}"
    if form:
        return format(value, form).removesuffix("%")
    return f"{float(f'{value:.3g}'):,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def share(successes: npt.ArrayLike, n: npt.ArrayLike) -> Estimate:
    r"""Return :math:`s/n` with Wilson's score interval, of whole numbers or columns, which are summed; NaN of none."""
    done, tried = int(np.sum(successes)), int(np.sum(n))
    if tried == 0:
        return Estimate()
    interval = stats.binomtest(done, tried).proportion_ci(method="wilson")
    return Estimate(done / tried, float(interval.low), float(interval.high))


def mean_share(shares: npt.ArrayLike, runs: npt.ArrayLike) -> Estimate:
    r"""Return the mean of shares of success, each that of a unit of replication: a training, a start or a plant.

    ``runs`` are those of all units together, or of each, which are summed.  The interval is Student's over the units,
    :math:`\bar s \pm t_{0.975,\,k-1}\, \sigma / \sqrt{k}`, cut off at 0 and 1, or Wilson's of all runs taken together
    where that is wider, as when all units have the same share.  The bootstrap is too narrow for ten trainings.
    """
    each, total = np.asarray(shares, dtype=np.float64), int(np.sum(runs))
    mean = float(each.mean())
    _, low, high = share(round(mean * total), total)
    half = float(stats.t.ppf(0.975, len(each) - 1) * each.std(ddof=1) / np.sqrt(len(each))) if len(each) > 1 else 0.0
    return Estimate(mean, min(low, mean, max(0.0, mean - half)), max(high, mean, min(1.0, mean + half)))


def difference(ours: npt.ArrayLike, theirs: npt.ArrayLike) -> Estimate:
    r"""Return by how much the share of successes of one exceeds another's on the same ``n`` starts, truth values each.

    Only the :math:`b` starts that the one alone saves and the :math:`c` that the other alone saves count.  The interval
    is Wald's with one start added to each of the two, which covers where few differ: D. G. Bonett and R. M. Price,
    *Adjusted Wald Confidence Interval for a Difference of Binomial Proportions Based on Paired Data*, 2012.
    """
    gained = np.asarray(ours, dtype=np.float64) - np.asarray(theirs, dtype=np.float64)
    n, b, c = len(gained), int((gained > 0).sum()), int((gained < 0).sum())
    middle = (b - c) / (n + 2)
    half = 1.96 * math.sqrt(b + c + 2 - (n + 2) * middle**2) / (n + 2)
    return Estimate((b - c) / n, middle - half, middle + half)


def median(values: npt.ArrayLike) -> Estimate:
    """Return the median of values ``(n,)``, NaN of none, with an interval that holds the true one, whatever their law.

    How many values lie below the true median is binomial, so order statistics enclose it with at least 95 %; the
    bootstrap of a median comes to the same and needs resamples for it.  Of fewer than six values, which cannot enclose
    it so surely, the interval is from the least to the greatest: :math:`1 - 2^{1 - n}`.
    """
    each = np.asarray(values, dtype=np.float64)
    if len(each) == 0:
        return Estimate()
    low, high = stats.quantile_test(each).confidence_interval(0.95) if len(each) > 5 else (each.min(), each.max())
    return Estimate(float(np.median(each)), float(low), float(high))


def worst_cases(
    values: npt.ArrayLike, tail: float = 0.1, *, resamples: int = 1000, seed: int | Sequence[int] = 0
) -> Estimate:
    r"""Return the conditional value at risk: the mean of the least share :math:`\alpha`, the tail, of values ``(n,)``.

    A value is that of a case, such as the share of starts that a controller saves on one plant out of many.  Where
    :math:`\alpha n` is no whole number, the last case counts in part; a tail of less than one, or values that are not
    finite, are a ValueError.  The bootstrap's interval over cases is too narrow where fewer than some 25 are in the
    tail.

    Source: R. T. Rockafellar and S. Uryasev, *Optimization of Conditional Value-at-Risk*, 2000.
    """
    cases = np.asarray(values, dtype=np.float64)
    if cases.ndim != 1 or not np.isfinite(cases).all():
        raise ValueError(f"Expected one finite number a case, shape (n,); got shape {cases.shape}.")
    if not (tail <= 1 and tail * len(cases) >= 1):
        raise ValueError(f"The worst {tail!r} of {len(cases)} cases is less than one case, or more than all.")
    counted = np.clip(tail * len(cases) - np.arange(len(cases)), 0.0, 1.0)  # the last in part

    def mean_of_worst(drawn: Array, axis: int = -1) -> Array:
        return (np.sort(drawn, axis=axis) * counted).sum(axis=axis) / counted.sum()

    found = float(mean_of_worst(cases))
    if np.ptp(cases) == 0:
        return Estimate(found, found, found)
    interval = stats.bootstrap(
        (cases,), mean_of_worst, n_resamples=resamples, method="percentile", rng=np.random.default_rng(seed)
    ).confidence_interval
    return Estimate(found, min(float(interval.low), found), max(float(interval.high), found))


def crossing(levels: npt.ArrayLike, outcomes: npt.ArrayLike, share: float = 0.5, *, square: bool = False) -> Estimate:
    r"""Return the level at which success falls to a share, such as :math:`\lambda_{50}` or :math:`\lambda_{90}`.

    The curve is the best that never rises (isotonic).  Between levels it is logistic; or, where the starts of a level
    :math:`\lambda` fill a ``square`` :math:`[-\lambda, \lambda]^2`, the area :math:`\lambda^2 (1 - p)` that is lost
    is a monotone cubic of the square's: success stays at one until the square meets what cannot be saved, which no
    logistic does.  The interval holds the levels at which Student's test does not tell the curve from the share
    (Fieller).  The curve's variance is that of the rows' means with their covariance, so that rows may be other starts
    at each level, or the same ones scaled; of outcomes 0 and 1 it is the share's under test, as in Wilson's interval.

    The rows ``(n, L)`` are units of replication: a start's successes, or the shares of a trained controller, at levels
    ``(L,)`` that increase; a crossing beyond them is minus or plus infinite.  Shapes that do not fit, levels that do
    not increase, and a share that is not between 0 and 1 are a ValueError.

    Sources: E. Fieller, *Some Problems in Interval Estimation*, 1954; F. Fritsch and J. Butland, *A Method for
    Constructing Local Monotone Piecewise Cubic Interpolants*, 1984.
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
    n, L = rows.shape
    mean, wanted = ((n * each + 0.5) / (n + 1) for each in (rows.mean(axis=0), share))
    at = np.interp(np.arange(_BETWEEN * (L - 1) + 1) / _BETWEEN, np.arange(L), points)
    fitted = isotonic_regression(mean, increasing=False).x
    curve = _curve(at, points, fitted, square)
    slopes = np.stack([(curve - _curve(at, points, fitted - 1e-6 * one, square)) / 1e-6 for one in np.eye(L)], axis=1)
    second = np.cov(rows.T).reshape(L, L) * n / (n + 1) ** 2
    if binary := np.isin(rows, (0, 1)).all():
        second = ((rows.T @ rows + 0.5) / (n + 1) - np.outer(mean, mean)) / (n + 1)
    variance = np.maximum(np.einsum("ij,jk,ik->i", slopes, second, slopes), 0.0)
    if binary:  # that of the share under test, as Wilson's
        variance *= wanted * (1 - wanted) / (curve * (1 - curve))
    above, half = curve - wanted, stats.t.ppf(0.975, n - 1) * np.sqrt(variance)
    value = _reached(at, np.minimum.accumulate(above))
    low = _reached(at, np.minimum.accumulate(above - half))
    high = _reached(at, np.maximum.accumulate((above + half)[::-1])[::-1])
    return Estimate(value, min(low, value), max(high, value))


_BETWEEN = 200  # points from one level to the next


def _curve(at: Array, levels: Array, shares: Array, square: bool) -> Array:
    """Return the curve through shares of success at its levels."""
    if not square or len(levels) == 1:
        return expit(np.interp(at, levels, logit(shares)))
    lost = PchipInterpolator(levels**2, levels**2 * (1 - shares))(at**2) / at**2
    return 1 - np.clip(lost, 1e-12, 1 - 1e-12)


def _reached(at: Array, falling: Array) -> float:
    """Return where values that never rise fall below zero; infinite where they all do, or none does."""
    k = int((falling > -1e-9).sum())  # a mean that should equal the share may miss it by rounding
    if k in (0, len(at)):
        return math.inf if k else -math.inf
    return float(at[k - 1] + (at[k] - at[k - 1]) * max(falling[k - 1], 0.0) / (max(falling[k - 1], 0.0) - falling[k]))


Quotient = tuple[npt.ArrayLike, npt.ArrayLike]
"""Two numbers a run; sum of the first by sum of the second is compared, and more is better."""


class Ranking(NamedTuple):
    """Ranks of ``k`` contenders."""

    order: npt.NDArray[np.int64]  # The best first; equals in the order in which they came.
    ranks: tuple[Estimate, ...]  # One more than the number of those that do better; equals share it.
    first: Array  # Share of the resamples in which none does better, ``(k,)``.
    better: Array  # Share of the resamples in which the row's does better than the column's, ``(k, k)``.


def ranking(criteria: Sequence[Sequence[Quotient]], *, resamples: int = 2000, seed: int = 0) -> Ranking:
    r"""Return ranks by one criterion after the other, and how stable they are when the runs are resampled.

    Each contender has criteria, the most important first.  Of two, the one with the greater
    :math:`\sum_i a_i / \sum_i b_i` over the runs that both have does better; where these are equal, the next criterion
    decides.  Run ``i`` of the arrays ``(n,)`` is the same start for every contender, and is drawn for all at once; so
    those that have fewer runs are compared on these, whether they were hard or easy; three may then beat each other in
    a circle, and share a rank.  The bootstrap cannot know what no run has shown: two that never failed are equal in
    every resample.  No contender, or arrays of different lengths for one, are a ValueError.
    """
    lengths = np.array([len(np.asarray(own[0][0])) for own in criteria], dtype=np.int64)
    if not len(lengths) or any(np.shape(each) != (n,) for own, n in zip(criteria, lengths, strict=True)
                               for quotient in own for each in quotient):  # fmt: skip
        raise ValueError("Expected, of at least one contender, criteria of two arrays (n,) each, all of the same n.")
    k, n = len(criteria), int(lengths.max())
    drawn = np.random.default_rng(seed).multinomial(n, np.full(n, 1 / n), size=resamples)
    weights = np.vstack([np.ones(n), drawn]).astype(np.float64)  # the first sample is what was seen
    better = np.zeros((resamples + 1, k, k), dtype=np.bool_)
    common = np.minimum(lengths[:, None], lengths)
    for m in np.unique(common):
        values = np.stack([_quotients(own, weights[:, :m]) if length >= m else
                           np.full((resamples + 1, len(own)), np.nan)
                           for own, length in zip(criteria, lengths, strict=True)], axis=1)  # fmt: skip
        better |= _precedes(values) & (common == m)
    ranks = 1 + better.sum(axis=1)  # those that do better than the column's
    seen, resampled = ranks[0], ranks[1:]
    low, high = np.quantile(resampled, [0.025, 0.975], axis=0, method="inverted_cdf")
    return Ranking(
        order=np.argsort(seen, kind="stable"),
        ranks=tuple(Estimate(*map(int, each)) for each in zip(
            seen, np.minimum(low, seen), np.maximum(high, seen), strict=True)),
        first=(resampled == 1).mean(axis=0),
        better=better[1:].mean(axis=0),
    )  # fmt: skip


def _quotients(criteria: Sequence[Quotient], weights: Array) -> Array:
    """Return the quotients ``(samples, criteria)``; minus infinite where there is nothing to divide by."""
    m = weights.shape[1]
    values = np.empty((len(weights), len(criteria)))
    for column, quotient in enumerate(criteria):
        above, below = (weights @ np.asarray(each, dtype=np.float64)[:m] for each in quotient)
        values[:, column] = np.divide(above, below, out=np.full(len(weights), -np.inf), where=below > 0)
    return np.round(values, 12)  # so that the order of a sum makes no difference


def _precedes(values: Array) -> npt.NDArray[np.bool_]:
    """Return which of values ``(samples, k, criteria)`` come before which, ``(samples, k, k)``."""
    better = np.zeros((*values.shape[:2], values.shape[1]), dtype=np.bool_)
    equal = np.ones_like(better)
    for criterion in np.moveaxis(values, 2, 0):
        mine, other = criterion[:, :, None], criterion[:, None]
        better |= equal & (mine > other)
        equal &= mine == other
    return better
