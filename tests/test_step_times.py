"""Step times are counted so that those of many jobs come to what they would be if all steps had been kept."""

import numpy as np
import pandas as pd
import pytest

from studies._step_times import EDGES, StepTimes
from studies._table import Table


def of(steps, first, sample_time=0.02):
    counts, _ = np.histogram(steps, EDGES)
    late = int((np.asarray(steps) > sample_time).sum())
    return StepTimes(counts, float(np.max(steps)), late, np.array(first))


def test_times_of_several_jobs_together_are_those_of_all_their_steps():
    steps = np.random.default_rng(0).lognormal(-7, 1.5, (2, 5000))
    kept = [of(own, [0.5]) for own in steps]
    rows = pd.DataFrame({"job": [0, 1, 2], "contender": ["NMPC", "NMPC", "LQR"]})
    table = Table(rows, by_job={k: each.arrays() for k, each in enumerate(kept)})
    found = StepTimes.joined(table, contender="NMPC")
    assert (found.steps, found.late, found.longest) == (10_000, (steps > 0.02).sum(), steps.max())
    assert found.first.tolist() == [0.5, 0.5]
    for share in (0.5, 0.99):
        assert found.quantile(share) == pytest.approx(np.quantile(steps, share), rel=0.025)


def test_jobs_that_saved_no_times_have_no_steps():
    table = Table(pd.DataFrame({"job": [0], "contender": ["LQR"]}))
    assert StepTimes.joined(table, contender="LQR").steps == 0
