"""Does the state-dependent Riccati equation save starts that LQR loses?

Method: SDRE and LQR with the same weights, Q = I, R = 1 and stiffer ones, on gustafsson2016 (40 N, 2.4 m) and on
bogdanov2004 (no limits), from the same starts, both angles within λ, 300 samples; neither link may fall.

Finding: on bogdanov2004, which has no limits, yes: with Q = I at λ = 0.6 SDRE saves 462 of 500, LQR 243.  On
gustafsson2016 it depends on the weights: at λ = 0.4 SDRE saves 267 and LQR 354 of 500 with Q = I, 380 and 348 with the
stiffer ones.  From the default options, kept in docs/results/sdre.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import dpend
from controllers import LQR, SDRE

from . import _runner
from ._estimates import share
from ._field import styles
from ._figures import curves, facets, share_axis
from ._plant import Plant, rig_of
from ._runner import Positive, Report, Result, Table
from ._tables import sheet

MINUTES = 2

PLANTS = {
    "gustafsson2016, Q = I": ("gustafsson2016", (1.0, 1.0, 1.0, 1.0, 1.0, 1.0), 1.0),
    "gustafsson2016, stiffer": ("gustafsson2016", (1.0, 10.0, 10.0, 1.0, 1.0, 1.0), 0.1),
    "bogdanov2004, Q = I": ("bogdanov2004", (1.0, 1.0, 1.0, 1.0, 1.0, 1.0), 1.0),
    "bogdanov2004, his weights": ("bogdanov2004", (5.0, 50.0, 50.0, 20.0, 700.0, 700.0), 1.0),
}
ELSEWHERE = {"Q = I": PLANTS["gustafsson2016, Q = I"], "stiffer": PLANTS["gustafsson2016, stiffer"]}
"""What is tried on another rig in the place of these."""
LAWS = {"LQR": LQR, "SDRE": SDRE}


@dataclass(frozen=True, kw_only=True)
class Options(_runner.Options):
    """Options of the command line."""

    lam: tuple[float, ...] = (0.1, 0.2, 0.3, 0.4, 0.6, 0.8)  # Greatest starting angles, rad.
    episodes: Positive = 500  # Starts at each of them.

    def __post_init__(self) -> None:
        super().__post_init__()
        for lam in self.lam:
            dpend.Balance(lam=lam)


@dataclass(frozen=True)
class Job:
    """Both laws on one plant from the same starts."""

    plant: str
    lam: float
    episodes: int
    seed: int
    elsewhere: Plant | None = None


def jobs(options: Options) -> list[Job]:
    """List the work: one job for each plant and λ."""
    lams, episodes = (options.lam[len(options.lam) // 2 :][:2], 5) if options.quick else (options.lam, options.episodes)
    return [
        Job(plant, lam, min(options.episodes, episodes), options.seed, options.elsewhere)
        for plant in (ELSEWHERE if options.elsewhere else PLANTS)
        for lam in lams
    ]


def run(job: Job) -> Result:
    """Let both laws balance the same starts."""
    name, Q, R = (PLANTS | ELSEWHERE)[job.plant]
    rig = rig_of(job.elsewhere) if job.elsewhere else dpend.rig(name)
    task = dpend.Balance(lam=job.lam)
    starts = task.starts(np.random.default_rng([job.seed, 7]), job.episodes, rig)
    rows = []
    for law, build in LAWS.items():
        runs = dpend.simulate_many(rig, build(rig, Q, R), starts, task=task)
        kept = float(np.nanmean(runs.log["kept"])) if "kept" in runs.log else 0.0  # samples without a gain of their own
        rows.append({"law": law, "successes": int(runs.success.sum()), "kept": kept})
    return Result(rows)


def report(table: Table) -> Report:
    """Draw the share saved against λ, with 95 % intervals."""
    saved = {(row.plant, row.law, row.lam): share(row.successes, row.episodes) for row in table.lines()}
    lams = sorted(set(table.rows["lam"]))
    plants = dict.fromkeys(table.rows["plant"])
    figure, axes = facets(-(-len(plants) // 2), 2, height=0.2 + 2.4 * -(-len(plants) // 2), sharex=True, sharey=True)
    for axis, plant in zip(axes.flat, plants, strict=True):
        curves(axis, {law: {lam: saved[plant, law, lam] for lam in lams} for law in LAWS}, styles(LAWS))
        axis.set_title(plant)
    for axis in axes[-1]:
        axis.set_xlabel("greatest starting angle λ (rad)")
    for axis in axes[:, 0]:
        share_axis(axis, "starts saved")
    axes[0, 0].legend()
    lines = [
        {"plant": plant, "law": law} | {f"λ = {lam:g}, %": saved[plant, law, lam] for lam in lams}
        for plant in plants
        for law in LAWS
    ]
    return Report(figures=figure, tables=[sheet("Starts saved, with 95 % intervals", lines)])


if __name__ == "__main__":
    _runner.main("studies.sdre")
