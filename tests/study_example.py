"""Does the runner lose or double a row?  A study of slow jobs, for the tests."""

import time
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from studies import _runner
from studies._runner import Report, Result, Table
from studies._tables import sheet

MINUTES = 0.1


@dataclass(frozen=True, kw_only=True)
class Options(_runner.Options):
    jobs: int = 12
    nap: float = 0.0
    """Seconds that a job takes."""
    join: bool = False
    """Whether finished jobs of a kept table are reused."""

    @property
    def joining(self) -> bool:
        return self.join


@dataclass(frozen=True)
class Job:
    seed: int
    repetition: int
    nap: float


def jobs(options: Options) -> list[Job]:
    return [Job(options.seed, k, options.nap) for k in range(options.jobs)]


def run(job: Job) -> Result:
    time.sleep(job.nap)
    value = float(np.random.default_rng([job.seed, job.repetition]).normal())
    rows = [{"name": name, "value": value, "even": job.repetition % 2 == 0} for name in "ab"]
    return Result(rows, {"value": np.array([value])})


def report(table: Table) -> Report:
    figure = Figure()
    figure.subplots().plot([value[0] for value in table.arrays("value")])
    return Report(figures=figure, tables=[sheet("Rows", table.rows)])


if __name__ == "__main__":
    _runner.main("tests.study_example")
