"""How long the steps of a controller take: counted by length, so that quantiles are over all steps of many runs."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

import dpend
from dpend.params import Array

from ._table import Table

EDGES = np.geomspace(1e-8, 1e2, 1001)
"""Limits of the bins, s: a hundred to a decade, so a quantile is known within 2.4 %."""


class StepTimes(NamedTuple):
    """The times of all steps of some runs."""

    counts: npt.NDArray[np.int64]  # Steps in each of the 1000 bins, without the first of a run.
    longest: float  # The longest of them, s.
    late: int  # Those that took longer than the sample time.
    first: Array  # The first step of each run, in which planners plan from nothing, s.

    @classmethod
    def of(cls, runs: dpend.Runs, sample_time: float) -> StepTimes:
        """Return the counts of the steps of runs."""
        lasted = np.arange(1, runs.step_time.shape[1]) < runs.steps[:, None]
        steps = runs.step_time[:, 1:][lasted]
        counts, _ = np.histogram(np.clip(steps, EDGES[0], EDGES[-1]), EDGES)
        late = int((steps > sample_time).sum())
        return cls(counts, float(steps.max(initial=0.0)), late, runs.step_time[:, 0].copy())

    @classmethod
    def joined(cls, table: Table, /, **fields: Any) -> StepTimes:
        """Return the times of all jobs of a table with given values of columns that saved some; none has no steps."""
        counts, longest, late, first = (table.arrays(name, **fields) for name in _NAMES)
        none = np.zeros(len(EDGES) - 1, dtype=np.int64)
        return cls(
            np.sum([none, *counts], axis=0),
            max(map(float, longest), default=0.0),
            sum(map(int, late)),
            np.concatenate([np.empty(0), *first]),
        )

    def arrays(self) -> dict[str, Array]:
        """Return what a job saves."""
        return {name: np.asarray(value) for name, value in zip(_NAMES, self, strict=True)}

    @property
    def steps(self) -> int:
        """Their number."""
        return int(self.counts.sum())

    def quantile(self, share: float) -> float:
        """Return the time within which a share of all steps ends, s: the upper limit of its bin."""
        within = np.cumsum(self.counts) >= share * self.steps
        return min(float(EDGES[1 + int(np.argmax(within))]), self.longest)


_NAMES = tuple(f"step_{name}" for name in StepTimes._fields)


@contextmanager
def undisturbed() -> Iterator[None]:
    """Spare timed steps the passes of Python's collector over all that was there before: they take milliseconds."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
