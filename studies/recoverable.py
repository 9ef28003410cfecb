"""From which angles at rest can the double pendulum be saved at all, and which limit decides?

Method: a start is recoverable if some motion within force, track and right angles brings it upright and to rest.  Along
each ray of the plane (θ1, θ2) the motion of least force (controllers/least_force.py) is sought until the start is found
from which that is the rig's limit; half of the rays are mirror images.  All within the boundary is savable, so shares
are areas.  Motions within the limit are replayed in the simulator.  Beside it: wider margins, no track, other tracks,
and the linearised plant.  ``--check`` solves random starts one by one.

Finding: on gustafsson2016 98.9/88.7/76.6/62.3 % of the starts can be saved at λ = .3/.4/.5/.6; without its track it is
100/98.5/90.0/80.1 %, for the linearised plant on its track 99.7/90.9/79.0/66.0 %: the track decides.  To save 90 % at
λ = .4 takes 2.11 times the weight on the track, 1.61 times without.  3995 of 4000 random starts, solved one by one,
lie on their side of the boundary; from the others the search finds nothing, and the tuned linear law saves them.  From
``--check 4000``, kept in docs/results/recoverable.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, cast

import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.optimize import brentq

import dpend
from controllers import TVLQR, NoTrajectory, Trajectory
from controllers.least_force import LeastForce
from dpend.params import Array
from dpend.rig import ideal_rig

from . import _runner
from ._boundary import OWN, Boundary, boundary, boundary_by_force
from ._figures import Curve, facets, legend_above, log_axis, palette, share_axis
from ._null_controllable import farthest_on_track, null_controllable
from ._runner import NonNegative, Plant, Report, Result, Table, where
from ._tables import Value, at, cell, sheet

MINUTES = 3

LAMS = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
HORIZONS = (150, 250)
"""Samples in which a motion must come to rest, of the task's 300: on tracks up to the rig's own, on longer ones."""
WIDE = 0.02
"""What motions keep from the limits, m and rad, to see what that costs; otherwise ``OWN``, what a replay needs."""
LEVELS = (0.5, 1.0, 1.5)
"""Forces, by the rig's limit, at which a ray is solved; what lies between is interpolated."""
SAVED = 0.9
"""Share of the starts for which least force is weighed against track."""
_NEAREST = 0.1  # rad, the first start on a ray
_TOLERANCE = 4e-4  # share of the radius within which the boundary is known
_ENDLESS = 4.0  # where no track is drawn
_CLOSE = 0.95  # motions whose force is within this share of the limit are replayed in the simulator
_CHUNK, _CHECKED = 50, 0.6  # random starts a job, and their λ


@dataclass(frozen=True, kw_only=True)
class Options(_runner.Options):
    """Options of the command line."""

    rays: int = 72  # Rays once round, a multiple of 12.  Half are solved, of what is beside it fewer.
    tracks: tuple[float, ...] = (0.15, 0.3, 0.6, 2.4)
    """Other tracks, from the middle to the end, by the length of both links."""
    check: NonNegative = 100  # Random starts that are solved one by one, θ1 and θ2 within 0.6 rad.

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.rays < 12 or self.rays % 12:
            raise ValueError(f"--rays must be a multiple of 12; got {self.rays}.")
        if not all(track > 0 for track in self.tracks):
            raise ValueError(f"--tracks must be greater than 0; got {self.tracks}.")
        if not math.isfinite(self.plant.rig.force_limit):
            raise ValueError(f"On {self.rig} every start can be saved: it has no force limit; --set force_limit=40.")


@dataclass(frozen=True)
class Job:
    """One ray on one track, or some random starts."""

    plant: Plant
    model: str  # nonlinear or linear
    track: float  # m, from the middle to the end
    margin: float  # what is kept from the track's end, m, and from right angles, rad
    limit: float  # force, N
    degrees: float  # the ray's direction, atan2(θ2, θ1); 0 of random starts
    first: int  # of the random starts
    starts: int  # how many; none on a ray
    seed: int


def jobs(options: Options) -> list[Job]:
    """List the work: a ray a job, those on the rig's own track first."""
    rig, rays, check, tracks = options.plant.rig, options.rays, options.check, options.tracks
    own, limit = float(rig.track_limit), float(rig.force_limit)
    beside = [("linear", own, 0.0)]
    if options.quick:
        rays, check, tracks = 12, min(check, 2), ()
    else:
        beside += [("nonlinear", math.inf, OWN), ("nonlinear", own, WIDE), ("linear", math.inf, 0.0)]
    kinds = {("nonlinear", own, OWN): rays}
    for kind in beside:
        kinds.setdefault(kind, rays // 2)
    for track in tracks:
        kinds.setdefault(("nonlinear", track * _length(rig), OWN), rays // 6)
    along = [
        Job(options.plant, *kind, limit, 360.0 * k / n, 0, 0, options.seed)
        for kind, n in kinds.items()
        for k in range(n // 2)
    ]
    return along + [
        Job(options.plant, "nonlinear", own, OWN, limit, 0.0, first, min(_CHUNK, check - first), options.seed)
        for first in range(0, check, _CHUNK)
    ]


def _length(rig: dpend.Rig) -> float:
    return float(rig.params.length1 + rig.params.length2)


def run(job: Job) -> Result:
    """Solve starts along a ray until the boundary is known, or random starts one by one."""
    rig = job.plant.rig
    if job.starts:
        rng, n = np.random.default_rng([job.seed, 2]), job.first + job.starts
        starts = dpend.Balance(lam=_CHECKED).starts(rng, n, rig)[job.first :]
        rows = [_row(job, start, _solve(job, start)) for start in starts]
    else:
        angle = math.radians(job.degrees)
        ray = np.array([0.0, math.cos(angle), math.sin(angle), 0.0, 0.0, 0.0])
        if job.model == "nonlinear":
            rows = [_row(job, radius * ray, plan) for radius, plan in sorted(_along(job, ray).items())]
        else:
            if math.isfinite(job.track):
                radius = farthest_on_track(rig, ray, force=job.limit, track=job.track)
            else:
                radius = 1 / float(null_controllable(rig.params, job.limit).share(ray)[0])
            rows = [_row(job, radius * ray, None) | {"force": job.limit}]
    scales = {"weight": float(rig.params.coefficients().d1 * rig.params.gravity), "length": _length(rig)}
    return Result([row | scales for row in rows])


def _row(job: Job, start: Array, plan: Trajectory | None) -> dict[str, Any]:
    """Return what is known of a start: the least force, N, and, near the limit, whether its motion saves it."""
    force, saves = _force(plan), "-"
    if plan is not None and _CLOSE * job.limit < force <= job.limit:
        law = TVLQR(plan.rig, plan, index="time")
        success = dpend.simulate_many(plan.rig, law, start[None], task=dpend.Balance()).success[0]
        saves = "yes" if success else "no"
    return {
        "th1": round(float(start[1]), 6),
        "th2": round(float(start[2]), 6),
        "force": round(force, 4),
        "saves": saves,
    }


@cache
def _search(plant: Plant, track: float, margin: float) -> LeastForce:
    rig = replace(ideal_rig(plant.rig), track_limit=track)
    samples = HORIZONS[1 if track > float(plant.rig.track_limit) or math.isinf(track) else 0]
    limits = 2 * (math.pi / 2 - margin,)
    return LeastForce(rig, horizon=samples * rig.sample_time, angle_limits=limits, track_margin=margin)


def _solve(job: Job, start: Array, guess: Trajectory | None = None, expected: float = math.inf) -> Trajectory | None:
    """Return the motion of least force from a guess; from none too, and the better, if that is far from expected."""
    search, best = _search(job.plant, job.track, job.margin), None
    for first in (guess, None) if guess else (None,):
        try:
            plan = search(start, guess=first)
        except NoTrajectory:
            continue
        best = min(best or plan, plan, key=_force)
        if _force(best) <= 1.3 * expected:
            break
    return best


def _force(plan: Trajectory | None) -> float:
    return math.inf if plan is None else float(plan.about["force"])


def _along(job: Job, ray: Array) -> dict[float, Trajectory | None]:
    """Return the motions from starts on a ray by their distance from upright: up to some forces, then at the limit."""
    found: dict[float, Trajectory | None] = {}

    def solve(radius: float, expected: float) -> float:
        near = min(found, key=lambda each: (found[each] is None, abs(each - radius)), default=0.0)
        found[radius] = _solve(job, radius * ray, found.get(near), expected)
        return _force(found[radius])

    edge = (math.pi / 2 - job.margin) / float(np.abs(ray).max())
    before, last = (0.0, 0.0), (_NEAREST, solve(_NEAREST, math.inf))
    for force in np.multiply(LEVELS, job.limit):
        while last[1] < 0.99 * force and last[0] < edge:
            slope = (last[1] - before[1]) / (last[0] - before[0])
            radius = min(last[0] + (force - last[1]) / slope, 2 * last[0], edge)
            before, last = last, (radius, solve(radius, last[1] + slope * (radius - last[0])))
    forces = {0.0: 0.0} | {radius: _force(plan) for radius, plan in found.items()}
    high = min((radius for radius, force in forces.items() if force > job.limit), default=edge)
    low, aside = max(radius for radius, force in forces.items() if radius <= high and force <= job.limit), 0.45
    while high - low > _TOLERANCE * high:
        part = (job.limit - forces[low]) / (forces[high] - forces[low]) if math.isfinite(forces[high]) else 0.5
        some = _TOLERANCE * high
        radius = min(max(low + part * (high - low) + aside * some, low + 0.2 * some), high - 0.2 * some)
        forces[radius] = solve(radius, job.limit)
        if forces[radius] > job.limit:
            high, aside = radius, -0.45
        else:
            low, aside = radius, 0.45
    return found


_SETS = {
    "recoverable": ("nonlinear", OWN, False),
    f"2 cm and {WIDE:g} rad from the limits": ("nonlinear", WIDE, False),
    "without a track": ("nonlinear", OWN, True),
    "linear plant, on the track": ("linear", 0.0, False),
    "linear plant, without a track": ("linear", 0.0, True),
}


def report(table: Table) -> Report:
    """Draw the boundaries, the shares by λ, the least force over the plane and over the track; tabulate them."""
    rows = where(table.rows, starts=0)
    first = rows.iloc[0]  # on the rig's own track
    own, length, weight = (float(first[name]) for name in ("track", "length", "weight"))
    sets = {
        name: boundary(found)
        for name, (model, margin, free) in _SETS.items()
        if len(found := where(rows, model=model, margin=margin, track=math.inf if free else own))
    }
    shares = {name: {lam: of.share(lam) for lam in LAMS} for name, of in sets.items()}
    solved = where(rows, model="nonlinear", margin=OWN)
    by_force = {track: boundary_by_force(where(solved, track=track)) for track in sorted(set(solved["track"]))}
    most = LEVELS[-1] * float(first["limit"])
    needed = {track / length: {lam: _least(of, lam, most) / weight for lam in LAMS[1:]}
              for track, of in by_force.items()}  # fmt: skip
    lines = [
        {"": name} | at({lam: cell(each, ".2%") for lam, each in shares[name].items()})
        | {f"λ{part}, rad": cell(of.lam(part / 100), ".3f") for part in (90, 50)}
        for name, of in sets.items()
    ]  # fmt: skip
    radii = [
        {"towards, °": f"{degrees:g}"} | {name: float(of.radius(math.radians(degrees))) for name, of in sets.items()}
        for degrees in range(0, 180, 15)
    ]
    least = [{"track": f"{track:g}"} | at(of) for track, of in needed.items()]
    tables = [
        sheet("Starts inside, %, and the numerical error", lines, brief={"", *at(dict.fromkeys(LAMS[3:]))}),
        sheet("Distance of the boundary, rad", radii, ".4f", note="towards: atan2(θ2, θ1)"),
        sheet(f"Least force that saves {SAVED:.0%} of the starts, by the weight Mg", least, ".3f",
              note="track: from the middle to the end, by the length of both links"),
        sheet("Checks", _checks(table.rows, sets["recoverable"])),
    ]  # fmt: skip
    map_ = _plot_resources(by_force[own], float(first["limit"]), weight, needed, own / length)
    return Report(figures={"": _plot_sets(sets, shares), "_map": map_}, tables=tables)


def _plot_sets(sets: Mapping[str, Boundary], shares: Mapping[str, Curve]) -> Figure:
    figure, ((plane, by_lam),) = facets(1, 2, height=3.6)
    for (name, of), (colour, _, line) in zip(sets.items(), palette(sets).values(), strict=True):
        plane.plot(*of.ring().T, color=colour, ls=line, lw=1.4)
        by_lam.plot(LAMS, [each.value for each in shares[name].values()], color=colour, ls=line, lw=1.4, label=name)
    _angles(plane)
    share_axis(by_lam, "starts inside")
    by_lam.set_xlabel("greatest starting angle λ (rad)")
    by_lam.legend(loc="lower left")
    return figure


def _plot_resources(
    bounded: Callable[[float], Boundary], limit: float, weight: float, needed: Mapping[float, Mapping[float, float]],
    own: float,
) -> Figure:  # fmt: skip
    """Draw the least force over the plane, and over the track the force under which most starts are saved."""
    figure, ((plane, tracks),) = facets(1, 2, height=3.6)
    for part in (0.25, 0.5, 0.75, 1.0, 1.25, 1.5):
        (line,) = plane.plot(*bounded(part * limit).ring().T, color=colormaps["viridis"](1.0 - 0.62 * part))
        line.set(lw=2.6 if part == 1 else 1.3, label=f"{part * limit:g} N, {part * limit / weight:.2g} $Mg$")
    _angles(plane)
    legend_above(plane, 3, "least force")
    places = {track: min(track, _ENDLESS) for track in needed}
    for lam, (colour, marker, line) in zip(LAMS[1:], palette(map(str, LAMS[1:])).values(), strict=True):
        force = [needed[track][lam] for track in places]
        tracks.plot(list(places.values()), force, color=colour, marker=marker, ls=line, label=f"λ = {lam:g}")
    tracks.plot(min(own, _ENDLESS), limit / weight, "k*", ms=11, zorder=5, label="the rig")
    log_axis(tracks, "x", list(places.values()))
    tracks.set_xticks(list(places.values()), [f"{track:g}" if track < _ENDLESS else "∞" for track in places])
    tracks.set(ylim=(0, None), xlabel="track, middle to end, by the length of both links")
    tracks.set_ylabel(f"least force that saves {SAVED:.0%} of the starts ($Mg$)")
    legend_above(tracks, 4)
    return figure


def _angles(axis: Axes) -> None:
    axis.set(xlabel="θ1 (rad)", ylabel="θ2 (rad)", xlim=(-1.02, 1.02), ylim=(-1.02, 1.02), aspect="equal")


def _least(bounded: Callable[[float], Boundary], lam: float, most: float) -> float:
    """Return the force, N, under which a share of :data:`SAVED` is saved; NaN where the most there is does not."""

    def more(force: float) -> float:
        return bounded(force).share(lam).value - SAVED

    return float(cast(float, brentq(more, 1e-3, most, xtol=1e-3))) if more(most) > 0 else math.nan


def _checks(rows: pd.DataFrame, of: Boundary) -> list[dict[str, Value]]:
    """Return in how many cases what the areas rest on holds."""
    random, saves = rows.loc[rows["starts"] > 0], rows["saves"].to_numpy()
    replayed = f"replayed motions, of {_CLOSE:.0%} of the limit and more, that save their start"
    checks = {replayed: saves[saves != "-"] == "yes"}
    if len(random):
        x = np.zeros((len(random), 6))
        x[:, 1:3] = random[["th1", "th2"]]
        inside, solved = of.savable(x), np.asarray(random["force"] <= random["limit"])
        checks |= {
            "random starts inside the boundary": inside,
            "random starts that are solved within the limit": solved,
            "random starts for which both agree": inside == solved,
        }
    return [{"": what, "number": int(np.sum(each)), "of": len(each)} for what, each in checks.items()]


if __name__ == "__main__":
    _runner.main("studies.recoverable")
