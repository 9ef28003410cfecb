"""Does a discount make a regulator more robust?

Method: on gustafsson2016, the LQR of LSPI's weights, Q = (1, 10, 10, 1, 1, 1), R = 0.1, and LSPI itself, ten trainings,
each with discounts from 0.95 to 0.999.  λ50 is where half of the starts are saved; success is from λ = 0.3 as the plant
is believed to be, with masses and lengths each wrong by up to 15 %, and with one or two samples of delay; 3000 starts
of LQR, the k-th training has the k-th tenth of them.  Intervals are 95 %, of LSPI over trainings.

Finding: a little.  LQR's λ50 rises from 0.478 at γ = 0.999 to 0.507 [0.495, 0.519] at 0.99; at 0.98 it saves 78.8 %
with one sample of delay and 47.7 % with two, at 0.999 69.5 and 32.7 %.  Wrong plants cost a point or two with any of
these.  From 0.97 on down the gain hardly restores, and at 0.94 it no longer stabilises.  LSPI has what LQR has.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

import dpend
from controllers import LQR
from rl import LSPI

from . import _runner
from ._estimates import Estimate, crossing, mean_share
from ._field import styles
from ._figures import facets, intervals, legend_above, share_axis
from ._plant import Plant, rig_of
from ._runner import AtLeastTwo, Report, Result, Table
from ._tables import sheet

MINUTES = 1

DISCOUNTS = (0.95, 0.96, 0.97, 0.98, 0.99, 0.995, 0.999)
LAMS = (0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
LAWS = ("LQR", "LSPI")
_LAM, _ERROR = 0.3, 0.15
_WRONG = ("cart_mass", "mass1", "mass2", "length1", "length2")
CONDITIONS = ("nominal", "plants ±15 %", "1 sample of delay", "2 samples of delay")
"""Under which success from λ = 0.3 is counted."""


@dataclass(frozen=True, kw_only=True)
class Options(_runner.Options):
    """Options of the command line."""

    needs = ("force_limit", "ideal")

    trainings: AtLeastTwo = 10  # Trainings of LSPI with each discount.
    episodes: AtLeastTwo = 300  # Starts of each training; LQR has those of all.


@dataclass(frozen=True)
class Job:
    """LQR, or one training of LSPI, with one discount."""

    law: str
    discount: float
    training: int
    starts: int
    seed: int
    elsewhere: Plant | None = None


def jobs(options: Options) -> list[Job]:
    """List the work."""
    trainings, episodes = (2, 10) if options.quick else (options.trainings, options.episodes)
    discounts = DISCOUNTS[::3] if options.quick else DISCOUNTS
    plant = options.elsewhere
    designed = [Job("LQR", each, 0, trainings * episodes, options.seed, plant) for each in discounts]
    return designed + [
        Job("LSPI", each, k, episodes, options.seed, plant) for each in discounts for k in range(trainings)
    ]


def run(job: Job) -> Result:
    """Design or train; count what is saved at every λ, and from λ = 0.3 under every condition."""
    plain = rig_of(job.elsewhere)
    learner = LSPI(plain, gamma=job.discount)
    if job.law == "LSPI":
        controller: dpend.Controller = learner.train([job.seed, 31, job.training]).policy
    else:
        controller = LQR(plain, learner.state_weights, learner.force_weight, discount=job.discount)
    mine = slice(job.training * job.starts, (job.training + 1) * job.starts)

    def saved(rig: dpend.Rig, lam: float) -> np.ndarray:
        task = dpend.Balance(lam=lam)
        starts = task.starts(np.random.default_rng([job.seed, 32]), mine.stop, plain)[mine]
        return dpend.simulate_many(rig, controller, starts, task=task, seed=job.seed).success

    factors = 1 + _ERROR * np.random.default_rng([job.seed, 33]).uniform(-1, 1, (mine.stop, len(_WRONG)))[mine].T
    wrong = {name: getattr(plain.params, name) * factor for name, factor in zip(_WRONG, factors, strict=True)}
    rigs = (plain, plain.replace(**wrong), plain.replace(actuator_delay=1), plain.replace(actuator_delay=2))
    shares = [float(saved(rig, _LAM).mean()) for rig in rigs]
    by_lam = np.stack([saved(plain, lam) for lam in LAMS], axis=1)
    return Result([dict(zip(CONDITIONS, shares, strict=True)) | {"runs": job.starts}], {"saved": by_lam})


def found(table: Table, law: str, discount: float) -> dict[str, Estimate]:
    """Return λ50 of a law with a discount, and its success under every condition."""
    own = table.where(law=law, discount=discount)
    each = table.arrays("saved", law=law, discount=discount)
    outcomes = each[0] if len(each) == 1 else np.stack([of.mean(axis=0) for of in each])
    half = crossing(LAMS, outcomes, square=True)
    return {"λ50, rad": half} | {name: mean_share(own[name], own["runs"]) for name in CONDITIONS}


def report(table: Table) -> Report:
    """Draw λ50 and success against the discount, and tabulate them."""
    discounts = sorted(set(table.rows["discount"]))
    values = {(law, each): found(table, law, each) for law, each in itertools.product(LAWS, discounts)}
    lines = [{"law": law, "discount": f"{each:g}"} | own for (law, each), own in values.items()]
    forms = {"λ50, rad": ".3f"} | dict.fromkeys(CONDITIONS, ".1%")
    title = f"λ50, and starts saved from λ = {_LAM:g}, %, by discount"
    of = sheet(title, lines, forms, tried=(LAMS[0], LAMS[-1]))
    return Report(figures=_draw(values, discounts), tables=[of])


def _draw(values: dict[tuple[str, float], dict[str, Estimate]], discounts: list[float]) -> Figure:
    figure, axes = facets(2, 2, height=4.6, sharex=True)
    places = np.arange(len(discounts))
    for axis, name in zip(axes.flat, ("λ50, rad", *CONDITIONS[1:]), strict=True):
        for aside, (law, style) in zip((-0.08, 0.08), styles(LAWS).items(), strict=True):
            shown = np.clip([values[law, each][name] for each in discounts], 0.0, 1.0)  # no infinity
            intervals(axis, places + aside, map(Estimate._make, shown), style, label=law)
        if name in CONDITIONS:
            share_axis(axis, "starts saved")
        axis.set_title(name if name in CONDITIONS else "half of the starts saved")
        if name not in CONDITIONS:
            axis.set_ylabel("λ50 (rad)")
        axis.set_xticks(places, [f"{each:g}" for each in discounts])
    figure.supxlabel("discount γ")
    legend_above(figure, len(LAWS))
    return figure


if __name__ == "__main__":
    _runner.main("studies.discount")
