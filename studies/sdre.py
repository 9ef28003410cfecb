"""Does the state-dependent Riccati equation save starts that LQR loses?

Method: SDRE and LQR with the same weights, Q = I, R = 1 and stiffer ones, on gustafsson2016 (40 N, 2.4 m) and on
bogdanov2004 (no limits), from the same starts, both angles within λ, 300 samples; neither link may fall.

Finding: on bogdanov2004, which has no limits, yes: with Q = I at λ = 0.6 SDRE saves 187 of 200, LQR 98.  On
gustafsson2016 it depends on the weights: at λ = 0.4 SDRE saves 104 and LQR 146 of 200 with Q = I, 157 and 142 with the
stiffer ones.  From `--episodes 200`, kept in docs/results/sdre.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from rich.table import Table

import dpend
from controllers import LQR, SDRE

from . import _study
from ._intervals import wilson
from ._study import Job, Result, Traces

PLANTS = {
    "gustafsson2016, Q = I": ("gustafsson2016", (1.0, 1.0, 1.0, 1.0, 1.0, 1.0), 1.0),
    "gustafsson2016, stiffer": ("gustafsson2016", (1.0, 10.0, 10.0, 1.0, 1.0, 1.0), 0.1),
    "bogdanov2004, Q = I": ("bogdanov2004", (1.0, 1.0, 1.0, 1.0, 1.0, 1.0), 1.0),
    "bogdanov2004, his weights": ("bogdanov2004", (5.0, 50.0, 50.0, 20.0, 700.0, 700.0), 1.0),
}
LAWS = {"LQR": LQR, "SDRE": SDRE}


@dataclass(frozen=True, kw_only=True)
class Options(_study.Options):
    """What can be told on the command line."""

    lam: tuple[float, ...] = (0.1, 0.2, 0.3, 0.4, 0.6, 0.8)
    """Spreads of the starting angles, rad."""
    episodes: int = 500
    """Starts at each spread."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for lam in self.lam:
            dpend.Balance(lam=lam)
        self.check_least(1, "episodes")


@dataclass(frozen=True, kw_only=True)
class Row:
    """One law at one spread."""

    plant: str
    law: str
    lam: float
    episodes: int
    successes: int
    kept: float
    """Share of the samples in which no gain was found and the last kept."""


def jobs(options: Options) -> list[Job]:
    """List the work: one job for each plant and spread."""
    lams = options.lam[:1] if options.quick else options.lam
    return [Job(plant, k) for plant in PLANTS for k in range(len(lams))]


def run(job: Job, options: Options) -> Result:
    """Let both laws balance the same starts."""
    name, Q, R = PLANTS[job.setting]
    rig = dpend.rig(name)
    episodes = min(options.episodes, 5) if options.quick else options.episodes
    task = dpend.Balance(lam=options.lam[job.repetition], steps=30 if options.quick else 300)
    starts = task.starts(np.random.default_rng([options.seed, 7]), episodes, rig)
    rows = []
    for law, build in LAWS.items():
        runs = dpend.simulate_many(rig, build(rig, Q, R), starts, task=task)
        rows.append(
            Row(
                plant=job.setting,
                law=law,
                lam=task.lam,
                episodes=episodes,
                successes=int(runs.success.sum()),
                kept=float(np.nanmean(runs.log["kept"])) if "kept" in runs.log else 0.0,
            )
        )
    return Result(rows)


def plot(rows: list[Row], traces: Traces) -> Figure:
    """Draw the share saved against the spread, with 95 % intervals."""
    figure = Figure(figsize=(9.0, 2.8), layout="constrained")
    axes = figure.subplots(1, len(PLANTS), sharey=True)
    for axis, plant in zip(axes, PLANTS, strict=True):
        for law, colour, marker in zip(LAWS, ("#0072B2", "#D55E00"), ("o", "s"), strict=True):
            own = [row for row in rows if (row.plant, row.law) == (plant, law)]
            rates = [wilson(row.successes, row.episodes) for row in own]
            errors = [[rate.share - rate.low for rate in rates], [rate.high - rate.share for rate in rates]]
            shares = [rate.share for rate in rates]
            axis.errorbar([row.lam for row in own], shares, errors, color=colour, marker=marker, ms=4, lw=1, label=law)
        axis.set_title(plant, fontsize=8)
        axis.set_xlabel("λ, rad")
        axis.grid(alpha=0.3)
    axes[0].yaxis.set_major_formatter(PercentFormatter(1.0))
    axes[0].set(ylim=(-0.02, 1.02), ylabel="starts saved")
    axes[0].legend(fontsize=8)
    return figure


def summary(rows: list[Row], traces: Traces) -> Table:
    """Condense the table."""
    table = Table(title="Starts saved, with 95 % intervals")
    lams = sorted({row.lam for row in rows})
    for heading in ("plant", "law", *(f"λ = {lam:g}" for lam in lams)):
        table.add_column(heading)
    for plant in PLANTS:
        for law in LAWS:
            rates = {
                row.lam: wilson(row.successes, row.episodes) for row in rows if (row.plant, row.law) == (plant, law)
            }
            shown = (
                f"{100 * r.share:.1f} [{100 * r.low:.1f}, {100 * r.high:.1f}]" for r in (rates[lam] for lam in lams)
            )
            table.add_row(plant, law, *shown)
    return table


if __name__ == "__main__":
    _study.main("studies.sdre")
