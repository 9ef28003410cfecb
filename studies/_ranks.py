"""Who does better than whom, and how sure that is: ranks on the runs that two have both met, and under resampling."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from dpend.params import Array

Quotient = tuple[npt.ArrayLike, npt.ArrayLike]
"""Two numbers a run; sum of the first by sum of the second is compared, and more is better."""


class Ranking(NamedTuple):
    """Ranks of ``k`` with their 95 % intervals.

    Attributes
    ----------
    order : ndarray (k,)
        The best first; equals in the order in which they came.
    rank, low, high : ndarray (k,)
        One more than the number of those that do better; equals share it.
    first : ndarray (k,)
        Share of the resamples in which nobody does better.
    better : ndarray (k, k)
        Share of the resamples in which the row's does better than the column's.
    """

    order: npt.NDArray[np.int64]
    rank: npt.NDArray[np.int64]
    low: npt.NDArray[np.int64]
    high: npt.NDArray[np.int64]
    first: Array
    better: Array


def ranking(criteria: Sequence[Sequence[Quotient]], *, resamples: int = 2000, seed: int = 0) -> Ranking:
    r"""Rank by one criterion after the other, and draw the runs anew to see how stable that is.

    Of two, the one with the greater :math:`\sum_i a_i / \sum_i b_i` over the runs that both have met does better; where
    these are equal, the next criterion decides.  Run ``i`` is the same start for everyone, and is drawn for everyone
    at once.  So those that have met fewer runs are compared on these, whether they were hard or easy.

    Parameters
    ----------
    criteria : sequence of sequence of Quotient
        Of each that is ranked, its criteria, the most important first; arrays ``(n,)``, ``n`` may differ.
    resamples : int
        Bootstrap samples.
    seed : int
        What they are drawn from.

    Returns
    -------
    Ranking

    Raises
    ------
    ValueError
        If nobody is ranked, or the arrays of one have different lengths.

    Notes
    -----
    Where some have met fewer runs, three may beat each other in a circle; then they share a rank.  The bootstrap
    cannot know what no run has shown: two that never failed are equal in every resample.
    """
    arrays = np.array([len(np.asarray(own[0][0])) for own in criteria], dtype=np.int64)
    if not len(arrays) or any(np.shape(part) != (n,) for own, n in zip(criteria, arrays, strict=True)
                              for quotient in own for part in quotient):  # fmt: skip
        raise ValueError("Expected, of at least one, criteria of two arrays (n,) each, all of the same n.")
    k, n = len(criteria), int(arrays.max())
    drawn = np.random.default_rng(seed).multinomial(n, np.full(n, 1 / n), size=resamples)
    weights = np.vstack([np.ones(n), drawn]).astype(np.float64)  # the first sample is what was seen
    better = np.zeros((resamples + 1, k, k), dtype=np.bool_)
    common = np.minimum(arrays[:, None], arrays)
    for m in np.unique(common):
        values = np.stack([_values(own, weights[:, :m]) if len_ >= m else np.full((resamples + 1, len(own)), np.nan)
                           for own, len_ in zip(criteria, arrays, strict=True)], axis=1)  # fmt: skip
        better |= _precedes(values) & (common == m)
    ranks = 1 + better.sum(axis=1)  # those that do better than the column's
    seen, resampled = ranks[0], ranks[1:]
    low, high = np.quantile(resampled, [0.025, 0.975], axis=0, method="inverted_cdf").astype(np.int64)
    return Ranking(
        order=np.argsort(seen, kind="stable"),
        rank=seen,
        low=np.minimum(low, seen),
        high=np.maximum(high, seen),
        first=(resampled == 1).mean(axis=0),
        better=better[1:].mean(axis=0),
    )


def _values(criteria: Sequence[Quotient], weights: Array) -> Array:
    """Return the quotients ``(samples, criteria)``; minus infinite where there is nothing to divide by."""
    m = weights.shape[1]
    values = np.empty((len(weights), len(criteria)))
    for column, parts in enumerate(criteria):
        above, below = (weights @ np.asarray(part, dtype=np.float64)[:m] for part in parts)
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
