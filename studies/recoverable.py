"""From which starts can the double pendulum be saved at all?

Method: gustafsson2016 (40 N, 2.4 m), starts at rest, 300 samples, neither link beyond a right angle.  A start is
recoverable if any controller of a list, or one of yours (``--controller``), saves it in the simulator, or the motion of
least force does (controllers/least_force.py), its forces replayed from the exact start, then LQR.  What is left is "not
found", which is no proof.  Beside it stands an indicator, the null-controllable set of the linearisation's two unstable
modes.  Random starts are those of studies.lambda_sweep; a grid of (θ1, θ2) gives the map.

Finding: at λ = .1/.2/.3/.4/.5/.6 100/100/98.7/86.5/73.8/60.1 % of 1000 starts each (95 %: ±1 to ±3), where LQR saves
100/99.8/84.5/64.5/47.2/35.2 %.  What is found needs at most 39.99 N, what is not at least 40.04 N.  Of the recoverable
among the first 200, iLQR MPC saves 99.5 % at λ = .3 and 97.6 % at .4.  By the report's criterion, which lets link 2
swing round, all but 18 of 7000 starts are recoverable.  From the default options, kept in docs/results/recoverable.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

import dpend
from dpend.params import Array
from dpend.tasks import check_lam

from . import _field, _runner
from ._closure import kept_table
from ._estimates import share
from ._figures import Style, facets, saved_by_angle
from ._null_controllable import null_controllable
from ._own import Own
from ._rescue import FORCE, LAWS, MPC, NONE, OPTIMAL, RIG, Verdict, judge
from ._runner import NonNegative, Positive, Report, Result, Table
from ._table import read_rows, where
from ._tables import Value, sheet

MINUTES = 111

_CHUNK = 50  # starts a job


def check_spreads(lam: tuple[float, ...]) -> None:
    """Refuse what is no list of greatest starting angles, each named once."""
    if not lam:
        raise ValueError("--lam needs at least one angle.")
    for each in lam:
        check_lam(each)
    if len(set(lam)) < len(lam):
        raise ValueError(f"--lam names an angle twice; got {lam}.")


@dataclass(frozen=True, kw_only=True)
class Options(_field.Options):
    """Options of the command line."""

    lam: tuple[float, ...] = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)  # Greatest starting angles, rad.
    starts: Positive = 1000  # Starts at each λ.
    grid: NonNegative = 41
    """Points on each side of the map; none for no map.  One half is computed, the other is its mirror image."""
    extent: float = 0.8  # Greatest angle on the map, rad.
    planned: NonNegative = 200
    """iLQR MPC is tried on the first so many starts of planned_lam, whatever else saves them."""
    planned_lam: tuple[float, ...] = (0.3, 0.4)  # Each λ at which iLQR MPC is compared with what can be saved.
    guesses: NonNegative = 0
    """Random guesses of optimal control beside the first one: a check that the least force is no mere local minimum."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.only:
            raise ValueError("--only leaves out no contender here: every start is tried by all that may save it.")
        check_spreads(self.lam)
        if not 0 < self.extent < math.pi / 2:
            raise ValueError(f"--extent must be between 0 and pi/2 rad; got {self.extent}.")


@dataclass(frozen=True)
class Job:
    """Fifty starts, or what is left of them, at one λ or on the map."""

    lam: float | None  # None on the map
    first: int
    starts: int
    planned: int  # of these iLQR MPC is tried on the first, whatever else saves them
    side: int  # points on a side of the map
    extent: float  # greatest angle on it, rad
    guesses: int
    seed: int
    yours: tuple[Own, ...]


def map_starts(side: int, extent: float) -> Array:
    """Return the starts of the computed half of the map ``(n, 6)``, row by row: θ1 > 0, or θ1 = 0 and θ2 >= 0."""
    angles = np.linspace(-extent, extent, side) if side > 1 else np.zeros(side)
    angles[np.abs(angles) < 1e-12] = 0.0
    th1, th2 = np.meshgrid(angles, angles, indexing="ij")
    half = (th1 > 0) | ((th1 == 0) & (th2 >= 0))
    x = np.zeros((int(half.sum()), 6))
    x[:, 1], x[:, 2] = th1[half], th2[half]
    return x


def jobs(options: Options) -> list[Job]:
    """List the work: fifty starts a job."""
    lams, starts, side, planned = options.lam, options.starts, options.grid, options.planned
    if options.quick:
        lams, starts, side, planned = lams[-2:], min(starts, 4), min(side, 3), min(planned, 1)
    of = dict.fromkeys(lams, starts) | {None: len(map_starts(side, options.extent))}
    yours = tuple(contender.own for contender in options.contenders("balance") if contender.own)
    return [
        Job(
            lam, first, min(_CHUNK, n - first),
            planned=max(planned - first, 0) if lam in options.planned_lam else 0,
            side=side if lam is None else 0, extent=options.extent if lam is None else 0.0,
            guesses=options.guesses, seed=options.seed, yours=yours,
        )
        for lam, n in of.items()
        for first in range(0, n, _CHUNK)
    ]  # fmt: skip


def run(job: Job) -> Result:
    """Judge fifty starts."""
    if job.lam is None:
        task, x0 = dpend.Balance(), map_starts(job.side, job.extent)
    else:
        task = dpend.Balance(lam=job.lam)
        x0 = task.starts(np.random.default_rng([job.seed, 1]), job.first + job.starts, RIG)
    x0 = x0[job.first : job.first + job.starts]
    yours = [_field.unchanged(own) for own in job.yours]
    verdicts = judge(x0, task, everywhere=job.lam is None, planned=job.planned, guesses=job.guesses, yours=yours)
    return Result([
        {"index": job.first + i, "th1": round(float(start[1]), 5), "th2": round(float(start[2]), 5)}
        | rounded(verdict)._asdict()
        for i, (start, verdict) in enumerate(zip(x0, verdicts, strict=True))
    ])  # fmt: skip


def rounded(verdict: Verdict) -> Verdict:
    """Return a verdict with its force to a hundredth of a newton, as the table has it."""
    return verdict._replace(least_force=round(verdict.least_force, 2))


@cache
def shipped_rows() -> pd.DataFrame:
    """Return the rows of the table that is shipped."""
    return read_rows(kept_table("recoverable"))


def shipped() -> dict[float, npt.NDArray[np.bool_]]:
    """Return which starts ``Balance(lam).starts(default_rng([0, 1]), n, rig)`` are recoverable, ``(n,)`` by λ."""
    return {lam: own["recoverable"].to_numpy() for lam, own in _by_lam(shipped_rows()).items()}


def shipped_map() -> tuple[Array, Array]:
    """Return angles of either link ``(m,)``, rad, and the least force ``(m, m)`` from there at rest, by θ2 and θ1.

    N, from the table that is shipped; NaN where no motion was found.
    """
    on_map = _on_map(shipped_rows())
    return _mirrored(on_map, on_map["least_force"])


def _on_map(rows: pd.DataFrame) -> pd.DataFrame:
    return rows.loc[rows["lam"].isna()]


def _by_lam(rows: pd.DataFrame) -> dict[float, pd.DataFrame]:
    """Return the random starts by λ, each in the order in which they were drawn."""
    return {float(str(lam)): own.sort_values("index") for lam, own in rows.groupby("lam")}


def _mirrored(on_map: pd.DataFrame, values: npt.ArrayLike) -> tuple[Array, Array]:
    """Return the angles of a map, and what is known of its computed half over the whole of it, by θ2 and θ1."""
    half = on_map[["th1", "th2"]].to_numpy()
    both = np.concatenate([half, -half]) + 0.0  # no minus zero
    angles, places = np.unique(both, return_inverse=True)
    across, upwards = places.reshape(both.shape).T
    whole = np.full((len(angles), len(angles)), np.nan)
    whole[upwards, across] = np.tile(np.asarray(values, dtype=np.float64), 2)
    return angles, whole


_CURVES: dict[str, tuple[Style, str]] = {
    "recoverable by the report's criterion (link 1 alone)": (("#777777", "v", ":"), "report"),
    "recoverable": (("k", "o", "-"), "recoverable"),
    "sign of stiff LQR": (("#D55E00", "^", "--"), "stiff_sign"),
    "LQR": (("#0072B2", "s", "-."), "lqr"),
}


def report(table: Table) -> Report:
    """Draw the share that can be saved against λ, and the map; tabulate what saves it."""
    by_lam, on_map = _by_lam(table.rows), _on_map(table.rows)
    shares = {
        name: {lam: share(own[column], len(own)) for lam, own in by_lam.items()}
        for name, (_, column) in _CURVES.items()
    }  # fmt: skip
    figure, ((axis,),) = facets(1, height=3.8)
    saved_by_angle(axis, shares, [style for style, _ in _CURVES.values()])
    axis.legend(loc="lower left")
    figures = {"": figure} | ({"_map": _plot_map(on_map)} if len(on_map) else {})
    heading = "λ = {:g}".format
    counts: dict[str, Value] = {"": "starts", **{heading(lam): len(own) for lam, own in by_lam.items()}}
    saved = [{"": name} | {heading(lam): each for lam, each in of.items()} for name, of in reversed(shares.items())]
    ways = dict.fromkeys((*LAWS, OPTIMAL, MPC, *(by for own in by_lam.values() for by in own["by"] if by != NONE)))
    first = [
        {"": "not found" if way == NONE else way}
        | {heading(lam): int(np.sum(own["by"] == way)) for lam, own in by_lam.items()}
        for way in (*ways, NONE)
    ]
    tables = [
        sheet("Starts that are saved, %", [counts, *saved], ".1%", brief={"", *list(counts)[-4:]}),
        sheet("What saved a start first, in this order", first),
        sheet("Of the recoverable among the first starts: saved, %", _planned(by_lam)),
    ]
    return Report(figures=figures, tables=[each for each in tables if each.lines])


def _plot_map(rows: pd.DataFrame) -> Figure:
    """Draw what saves each start, the least force as contours, and the indicator's boundary."""
    figure, ((axis,),) = facets(1, height=6.0)
    feedback = np.where(rows["lqr"], 3, np.where(rows["by"].isin(list(LAWS)), 2, 1))
    angles, kind = _mirrored(rows, np.where(rows["recoverable"], feedback, 0))
    force = _mirrored(rows, rows["least_force"])[1]
    words = {"not found": "#f0f0f0", "only optimal control or others": "#b8b8b8", "another LQR or its sign": "#8ab6dc",
             "LQR, Q = I, R = 1": "#2d6da8"}  # fmt: skip
    colours = ListedColormap(list(words.values()))
    axis.pcolormesh(angles, angles, kind, cmap=colours, vmin=-0.5, vmax=3.5, shading="nearest")
    if len(angles) > 4:
        levels = axis.contour(angles, angles, force, [10, 20, 40, 80], colors="k", linewidths=[0.6, 0.6, 1.6, 0.6])
        axis.clabel(levels, fmt="%g N", fontsize=7)
    ring, of = null_controllable(RIG.params, FORCE).at_rest(), "null-controllable set of the linearization, 40 N"
    (line,) = axis.plot(*np.vstack([ring, ring[:1]]).T, "--", color="#D55E00", lw=1.6, label=of)
    patches = [Patch(facecolor=colour, edgecolor="k", lw=0.4, label=name) for name, colour in words.items()]
    axis.legend(handles=[*reversed(patches), line], ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    limits = 1.02 * angles[0] - 0.02, 1.02 * angles[-1] + 0.02
    axis.set(xlabel="θ1 (rad)", ylabel="θ2 (rad)", xlim=limits, ylim=limits, aspect="equal")
    return figure


def _planned(by_lam: Mapping[float, pd.DataFrame]) -> Iterator[dict[str, Value]]:
    """Return what is saved of the first starts, on which iLQR MPC was tried without a gap whatever else saves them."""
    for lam, own in by_lam.items():
        tried = (own["mpc"] != "-").to_numpy()
        n = len(tried) if tried.all() else int(np.argmin(tried))
        can = where(own.head(n), recoverable=True)
        if len(can) and own["lqr"].to_numpy()[:n].any():  # else it was only tried where all else fails
            saved = {"LQR": can["lqr"], "sign of stiff LQR": can["stiff_sign"], "iLQR MPC": can["mpc"] == "yes"}
            shares = {f"{name}, %": share(each, len(can)) for name, each in saved.items()}
            yield {"λ": f"{lam:g}", "first": n, "recoverable": len(can), **shares}


if __name__ == "__main__":
    _runner.main("studies.recoverable")
