"""Does the runner lose or double a row?  A study of slow jobs, for the tests."""

import time
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from rich.table import Table

from studies import _study
from studies._study import Job, Result


@dataclass(frozen=True, kw_only=True)
class Options(_study.Options):
    jobs: int = 12
    nap: float = 0.0
    """Seconds that a job takes."""


@dataclass(frozen=True, kw_only=True)
class Row:
    name: str
    repetition: int
    value: float
    even: bool


def jobs(options):
    return [Job("nap", k) for k in range(options.jobs)]


def run(job, options):
    time.sleep(options.nap)
    value = float(np.random.default_rng([options.seed, job.repetition]).normal())
    rows = [Row(name=name, repetition=job.repetition, value=value, even=job.repetition % 2 == 0) for name in "ab"]
    return Result(rows, {"value": np.array([value])})


def plot(rows, traces):
    figure = Figure()
    figure.subplots().plot([traces[f"nap-{row.repetition}"]["value"][0] for row in rows])
    return figure


def summary(rows, traces):
    return Table(str(len(rows)))


if __name__ == "__main__":
    _study.main("tests.study_example")
