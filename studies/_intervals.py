"""Confidence intervals of success rates."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import stats


class Rate(NamedTuple):
    """A share of successes with its 95 % confidence interval, all within 0 and 1."""

    share: float
    low: float
    high: float


def wilson(successes: int, n: int) -> Rate:
    r"""Give the Wilson score interval of :math:`s/n`.

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
    """Give the mean success of several trained controllers, the training being the unit of replication.

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
