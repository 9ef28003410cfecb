"""Does Q-learning with quadratic features find the Riccati gain from data alone, and is its force smooth?

Method: on gustafsson2016, from K = 0 and without a model, least-squares policy iteration with 120 s and with 60 s of
experience, and one-step Q-learning on the same features with 120 s and 12 000 s, 30 seeds each, beside Q-learning on
Table 1 (tuned).  The gain is compared with that of the Riccati equation for the same cost and discount; the k-th
training of each, and that gain, have the k-th part of the starts at every λ.  Variation is that of the force at λ =
0.1, in force limits per second.

Finding: with 120 s LSPI comes within 5 % of the Riccati gain in 30 of 30 trainings (median error 0.13 %, at most
0.9 %), saves what that gain saves (100/99.5/85.2/69.0 %), and its force varies 1/814 as much as Table 1 Q-learning's;
with 60 s it is 27 of 30, and one-step Q-learning finds nothing in 12 000 s.  From ``--seed 1``, kept in
docs/results/lspi.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.figure import Figure

import dpend
from controllers import LQR
from dpend.params import Array
from rl import LSPI, GainPolicy, Learner, LinearQLearning, QuadraticQLearning
from rl.lspi import gain_errors

from . import _runner
from ._estimates import QUARTILES, mean_share
from ._field import styles
from ._figures import Curve, band, force_traces, legend_above, log_axis, mosaic, saved_by_angle
from ._plant import Plant, rig_of
from ._runner import Positive, Report, Result, Table
from ._tables import at, cell, counted, sheet

MINUTES = 1

LAMS = (0.1, 0.2, 0.3, 0.4)
CLOSE = 0.05  # a gain counts as found within this error, relative to the norm of the Riccati gain
REFERENCE, TABLE1 = "Riccati gain", "Q-learning, Table 1"
LEARNERS: dict[str, Callable[[dpend.Rig], Learner]] = {
    "LSPI, 120 s": lambda rig: LSPI(rig),
    "LSPI, 60 s": lambda rig: LSPI(rig, samples=60, iterations=50, anneal=42),
    "one-step Q, 120 s": lambda rig: QuadraticQLearning(rig),
    "one-step Q, 12 000 s":
        lambda rig: QuadraticQLearning(rig, samples=600_000, anneal=500_000, alpha=0.1, record_every=10_000),
    TABLE1: lambda rig: LinearQLearning.tuned(rig),
}  # fmt: skip
_TRACE_SECONDS = 2.0


@dataclass(frozen=True, kw_only=True)
class Options(_runner.Options):
    """Options of the command line."""

    needs = ("force_limit", "ideal")

    trainings: Positive = 30  # Seeds of each learner.
    episodes: Positive = 300  # Starts on which each trained controller is evaluated at each λ.


@dataclass(frozen=True)
class Job:
    """One training, or the Riccati gain, on its part of the starts."""

    controller: str
    training: int
    episodes: int
    seed: int
    elsewhere: Plant | None = None


def reference(rig: dpend.Rig) -> Array:
    r"""Return the gain ``(6,)`` of the LQR with the learners' weights and discount."""
    learner = LSPI(rig)
    return LQR(rig, learner.state_weights, learner.force_weight, discount=learner.gamma).K[0]


def jobs(options: Options) -> list[Job]:
    """List the work: each controller once for each part of the starts."""
    most = (2, 20) if options.quick else (options.trainings, options.episodes)
    trainings, episodes = min(options.trainings, most[0]), min(options.episodes, most[1])
    return [
        Job(name, k, episodes, options.seed, options.elsewhere)
        for name in (*LEARNERS, REFERENCE)
        for k in range(trainings)
    ]


def run(job: Job) -> Result:
    """Train where there is something to train, then balance from this training's starts at every λ."""
    rig = rig_of(job.elsewhere)
    best, error, experience = reference(rig), 0.0, 0.0
    controller: dpend.Controller = GainPolicy(best)
    arrays: dict[str, Array] = {}
    if job.controller != REFERENCE:
        training = LEARNERS[job.controller](rig).train([job.seed, 6, job.training])
        controller, experience, error = training.policy, training.experience, np.nan
        if "gains" in training.details:
            errors = gain_errors(training.details["gains"], best)
            arrays = {"errors": errors, "experience": rig.sample_time * training.details["samples"]}
            error = float(errors[-1])
    rows, saved, first = [], [], job.training * job.episodes
    for lam in LAMS:
        task = dpend.Balance(lam=lam)
        starts = task.starts(np.random.default_rng([job.seed, 7]), first + job.episodes, rig)[first:]
        runs = dpend.simulate_many(rig, controller, starts, task=task, seed=job.seed)
        saved.append(runs.success)
        rows.append(
            {"lam": lam, "successes": int(runs.success.sum()), "variation": float(runs.metrics()["variation"].mean()),
             "error": error, "experience": experience}
        )  # fmt: skip
    arrays["saved"] = np.transpose(saved)
    if job.training == 0:
        start = dpend.Balance().starts(np.random.default_rng([job.seed, 7]), 1, rig)[0]
        arrays["force"] = dpend.simulate(rig, controller, start, _TRACE_SECONDS, seed=job.seed).u
    return Result(rows, arrays)


_AS = styles(("LQR", "LSPI", "Q tuned"))
STYLES = {
    REFERENCE: _AS["LQR"], "LSPI, 120 s": _AS["LSPI"], "LSPI, 60 s": ("#E69F00", "s", "--"),
    "one-step Q, 120 s": ("#777777", "v", ":"), "one-step Q, 12 000 s": ("#CC79A7", "P", ":"), TABLE1: _AS["Q tuned"],
}  # fmt: skip


def report(table: Table) -> Report:
    """Draw errors, success and forces; tabulate gains found, success by λ beside the Riccati gain's, and variation."""
    own = {(name, lam): table.where(controller=name, lam=lam) for name in STYLES for lam in LAMS}
    shares = {which: (rows["successes"] / rows["episodes"]).to_numpy() for which, rows in own.items()}
    saved = {which: mean_share(shares[which], rows["episodes"]) for which, rows in own.items()}
    found, success = [], []
    for name in STYLES:
        mine = own[name, LAMS[0]]
        if name not in (REFERENCE, TABLE1):
            error = mine["error"].to_numpy()
            of = {"median": 0.5, "90th percentile": 0.9, "largest": 1.0}
            found.append(
                {"learner": name, "found": counted((error <= CLOSE).sum(), len(error))}
                | {f"{each} error, %": cell(np.quantile(error, q), ".2%") for each, q in of.items()}
                | {"experience, s": float(np.median(mine["experience"]))}
            )
        cells = {}
        for lam in LAMS:
            gaps, said = 100 * (shares[name, lam] - shares[REFERENCE, lam]), cell(saved[name, lam], ".1%")
            cells[lam] = replace(said, under=f"{said.under}\n{min(gaps):+.1f} to {max(gaps):+.1f}".strip())
        success.append({"controller": name} | at(cells) | {"variation at λ = 0.1": float(np.mean(mine["variation"]))})
    brief = ("controller", "λ = 0.1", "λ = 0.3", "variation at λ = 0.1")
    title = "Starts saved, %, and 95 % interval over trainings; below: widest gap of one to Riccati's"
    gains = f"Gains within {CLOSE:.0%} of the Riccati gain, with intervals in %, and their error"
    tables = [sheet(gains, found, {"experience, s": ",.0f"})]
    tables += [sheet(title, success, {"variation at λ = 0.1": ".4g"}, brief=brief)]
    by_lam = {name: {lam: saved[name, lam] for lam in LAMS} for name in STYLES}
    return Report(figures=_overview(table, by_lam), tables=tables)


def _overview(table: Table, saved: Mapping[str, Curve]) -> Figure:
    """Draw the gain's error against experience, success against λ, and a force trace of each kind."""
    traces = {
        f"{name}, one episode at λ = 0.1": (table.array("force", controller=name, training=0), STYLES[name])
        for name in (REFERENCE, "LSPI, 120 s", TABLE1)
    }
    layout = [[[["errors", "success"]]], *([title] for title in traces)]
    figure, axes = mosaic(layout, height=8.2, height_ratios=[4.2, 1, 1, 1])
    for name, style in STYLES.items():
        if errors := table.arrays("errors", controller=name):
            experience = table.arrays("experience", controller=name)[0]
            band(axes["errors"], experience, np.quantile(errors, QUARTILES, axis=0), style)
    axes["errors"].axhline(CLOSE, color="k", lw=0.8, ls="--")
    axes["errors"].set(ylim=(4e-4, 4), xlabel="experience (s)", ylabel="error of the gain", yscale="log")
    log_axis(axes["errors"])
    log_axis(axes["errors"], "y", (0.001, 0.01, 0.1, 1))
    axes["errors"].set_title("median and quartiles over trainings")
    saved_by_angle(axes["success"], saved, STYLES, aside=0.016)
    axes["success"].set_xticks(LAMS)
    force_traces(axes, traces, table.rig.sample_time, _TRACE_SECONDS)
    legend_above(figure, 3)
    return figure


if __name__ == "__main__":
    _runner.main("studies.lspi")
