"""How do controllers and learners compare as the starting angles grow, and with what can be saved at all?

Method: every contender that balances does so on gustafsson2016, or another ``--rig``, from θ1, θ2 ~ U[-λ, λ] for 300
samples; neither link may fall. All λ share their directions. The k-th training of a learner has the k-th part of the
starts, 100 each as in the report; deep learners come as shipped, one training; iLQR MPC and SDRE get the first tenth of
the starts, with ``--all`` every one, and NMPC some. Intervals are 95 %: Wilson's, of learners Student's over trainings.
λ50 and λ90 are where the curve falls to a half and to nine tenths, best known are the starts that studies.recoverable
or any contender saves; maps show from which angles at rest each saves it.

Finding: of 100 000 starts LQR saves 100/99.9/87.3/67.3 % at λ = .1/.2/.3/.4, Q-learning tuned 100/98.4/82.2/61.3 % (100
of 100 trainings converge, by search and select); as published 0 of 100 converge.  The report's 94/92/78/49 % are of
another plant.  From ``--trainings 100 --episodes 1000 --part-of 1000 --plain --seed 2``, kept in
docs/results/lambda_sweep_100.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

import dpend
from dpend.tasks import check_lam
from rl import LinearQLearning

from . import _field, _figures, _runner
from ._basins import basin, plot_basins
from ._boundary import kept_boundary
from ._estimates import Estimate, crossing, difference, mean_share, share
from ._field import CONTENDERS, LONG, Contender, Cost, PriorKnowledge, find, longest_first, styles
from ._figures import Curve, Style, best_known, curves, facets, forest, legend_above, mosaic, saved_by_angle
from ._own import Own
from ._runner import DEFAULT_RIG, AtLeastTwo, NonNegative, Plant, Positive, Report, Result, Table, where
from ._tables import Sheet, Value, at, cell, sheet

MINUTES = 1

TABLE2 = {0.1: 0.94, 0.2: 0.92, 0.3: 0.78, 0.4: 0.49}
"""The report's Table 2: share of successful episodes by λ, ten trained controllers, 100 episodes each."""

PLAIN = "Q tuned, plain rule"

ONLY_HERE = (
    Contender(name="Q published", make=lambda rig, task: LinearQLearning.published(rig).train(0).policy,
              prior_knowledge=PriorKnowledge("none", "report's cost", "λ = .1 about upright"),
              style=("#777777", "v", ":"), learner=lambda rig: LinearQLearning.published(rig)),
    Contender(name=PLAIN, make=lambda rig, task: LinearQLearning.tuned(rig, select=False).train(0).policy,
              prior_knowledge=PriorKnowledge("none", "report's cost, weights tuned", "λ = .08 about upright"),
              style=("#8C6D1F", "P", "-."), learner=lambda rig: LinearQLearning.tuned(rig, select=False)),
)  # fmt: skip
"""Learners that no other study needs: the report's, and the tuned one without acceptance tests and restarts."""

KNOWN = (*(contender for contender in CONTENDERS if not contender.policy), *ONLY_HERE,
         *(contender for contender in CONTENDERS if contender.policy))  # fmt: skip
"""Those that can take part, what is designed first."""

OTHERS = "nonlinear († one training)"
KINDS = {
    "linear": ("LQR", "stiff LQR", "LQR, best weights", "tuned linear", "LSPI", "QAC tuned"),
    "sign of a linear law": (
        "sign of LQR", "sign of stiff LQR", "sign of tuned linear", "Q published", PLAIN, "Q tuned",
    ),
    OTHERS: (),
    "learned to swing up": ("PPO swing-up", "PPO swing-up, smooth", "DDPG swing-up"),
}  # fmt: skip
"""Laws that are linear up to the limit, the sign of a linear one, all others, and those learned for another task."""
FIRST = ("LQR", "tuned linear", "iLQR MPC", "Q published", "Q tuned", "PPO balance")
"""Those that the first figure shows, as many as one can tell apart; where some are missing, others in their place."""
BASELINE = "tuned linear"
LADDER = ("LQR", "LQR, best weights", "sign of tuned linear", BASELINE, "DDPG balance", "PPO balance", "iLQR MPC")
"""Those that are compared with the best linear law known, start by start."""

DESIGNED, SHIPPED = "-", "shipped"  # how a "training" ended: a design, or a policy trained elsewhere, once
BEST_KNOWN = "best known"  # what any force can save, from studies.recoverable, or any contender saves
TRACED = ("LQR", "Q published", "Q tuned", "LSPI", "PPO balance")  # whose force is drawn: smooth beside bang-bang
Falls = tuple[Estimate, Estimate]  # λ50 and λ90, at which a half and nine tenths of the starts are saved
_TRACE_LAM, _TRACE_SECONDS = 0.1, 1.0
_ENOUGH = 10_000  # starts of what is shipped, and of planners: a network takes ten times as long as a gain


@dataclass(frozen=True, kw_only=True)
class Options(_field.Options):
    """Options of the command line."""

    known: ClassVar[tuple[Contender, ...]] = KNOWN
    tasks = ("balance",)

    lam: tuple[float, ...] = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6)  # Greatest starting angles, rad.
    trainings: Positive = 10  # Trainings of each learner that learns in seconds.
    episodes: AtLeastTwo = 100  # Starts of each training at each λ.
    part_of: AtLeastTwo = 250
    """Starts of which NMPC, and your own that treats one run at a time, get the first part."""
    basins: NonNegative = 41  # Points on a side of the maps of what is saved from rest.
    plain: bool = False  # Add tuned Q-learning that ends at 20 successes in a row.
    all: bool = False  # Add what takes long: NMPC, every start of iLQR MPC and SDRE, maps.

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.lam:
            raise ValueError("--lam needs at least one angle.")
        for lam in self.lam:
            check_lam(lam)
        if len(set(self.lam)) < len(self.lam):
            raise ValueError(f"--lam names an angle twice; got {self.lam}.")

    @property
    def sizes(self) -> tuple[int, int]:
        """Trainings of each learner, and starts of each; few where it must be quick."""
        return (min(self.trainings, 2), min(self.episodes, 20)) if self.quick else (self.trainings, self.episodes)

    def contenders(self, task: _field.TaskName) -> list[Contender]:
        """Return those that take part: what takes minutes, and the plain rule, only where they are asked for."""
        asked = {*self.only, *([PLAIN] if self.plain else [])}
        return [
            each
            for each in super().contenders(task)
            if self.all or each.name in asked or (each.cost is not Cost.EXPENSIVE and each.name != PLAIN)
        ]

    def starts(self, contender: Contender) -> int:
        """Return on how many starts one that is not trained here is evaluated at each λ."""
        whole = math.prod(self.sizes)
        if contender.cost is not Cost.CHEAP:
            return min(whole, 2 if self.quick else contender.cost.runs(self.part_of))
        if contender.name in LONG:
            return min(whole if self.all else -(-whole // 10), _ENOUGH)
        return min(whole, _ENOUGH) if contender.policy else whole

    def side(self, contender: Contender) -> int:
        """Return the points on a side of a contender's map; none where it takes too long."""
        if contender.cost is not Cost.CHEAP:
            return round(math.sqrt(contender.cost.value) * self.basins) if self.all and not self.quick else 0
        if contender.name in LONG and not self.all:
            return 0
        return min(self.basins, 5) if self.quick else self.basins


@dataclass(frozen=True)
class Job:
    """One contender, or one training of a learner, at every λ."""

    plant: Plant
    contender: str
    training: int
    lams: tuple[float, ...]
    first: int  # the first of its starts at each λ
    starts: int
    side: int  # points on a side of its map
    seed: int
    own: Own | None


def jobs(options: Options) -> list[Job]:
    """List the work: each learner once a training, all others once; what takes longest first."""
    trainings, episodes = options.sizes
    lams = tuple(sorted(options.lam))[:: 5 if options.quick else 1]
    return [
        Job(
            options.plant, contender.name, k, lams, k * episodes,
            episodes if contender.learner else options.starts(contender), options.side(contender),
            options.seed, contender.own,
        )
        for contender in longest_first(options.contenders("balance"))
        for k in range(trainings if contender.learner else 1)
    ]  # fmt: skip


def run(job: Job) -> Result:
    """Train where there is something to train, then balance from the starts of every λ, and from those of the map."""
    rig, contender = job.plant.rig, find(job.contender, job.own, KNOWN)
    if contender.learner:
        training = contender.learner(rig).train([job.seed, 2, job.training])
        controller: dpend.Controller = training.policy
        outcome = training.outcome.name.lower().replace("_", " ")
        cost = training.cost.episodes, training.cost.steps, training.cost.test_steps
    else:
        controller = contender.make(rig, dpend.Balance())
        outcome, cost = SHIPPED if contender.policy else DESIGNED, (0, 0, 0)
    rows, stood = [], []
    for lam in job.lams:
        task = dpend.Balance(lam=lam)
        starts = task.starts(np.random.default_rng([job.seed, 1]), job.first + job.starts, rig)[job.first :]
        success = dpend.simulate_many(rig, controller, starts, task=task, seed=job.seed).success
        by_report = success.copy()  # what stands by the strict criterion stands by the report's too
        if not success.all():
            lenient = replace(task, criterion="report")
            lost = starts[~success]
            by_report[~success] = dpend.simulate_many(rig, controller, lost, task=lenient, seed=job.seed).success
        stood.append(success)
        rows.append(
            {"lam": lam, "episodes": len(starts), "successes": int(success.sum()),
             "successes_report": int(by_report.sum()), "outcome": outcome, "sample_time": rig.sample_time}
            | dict(zip(("training_episodes", "training_steps", "test_steps"), cost, strict=True))
        )  # fmt: skip
    arrays: dict[str, npt.NDArray[Any]] = {"saved": np.transpose(stood)}
    if job.training == 0 and (job.contender in TRACED or job.own):
        task = dpend.Balance(lam=_TRACE_LAM)
        start = task.starts(np.random.default_rng([job.seed, 1]), 1, rig)[0]
        arrays["force"] = dpend.simulate(rig, controller, start, _TRACE_SECONDS, task=task, seed=job.seed).u
    if job.side:
        arrays["basin"] = basin(rig, controller, job.side, job.seed)
    return Result(rows, arrays)


def saved(table: Table, contender: str, lam: float, criterion: str = "successes") -> Estimate:
    """Return the share of starts that a contender saves at one λ: over its trainings, or over the starts of one.

    By the report's own criterion, ``"successes_report"``, only link 1 must not fall.
    """
    return _mean(table.where(contender=contender, lam=lam), criterion)


def _mean(own: pd.DataFrame, criterion: str = "successes") -> Estimate:
    return mean_share(own[criterion] / own["episodes"], own["episodes"])


def falls_to(table: Table, contender: str) -> Falls:
    """Return λ50 and λ90 of a contender; the interval is over starts, or over trainings where there are several."""
    own = table.where(contender=contender)
    shares = own.assign(share=own["successes"] / own["episodes"]).pivot(index="training", columns="lam", values="share")
    outcomes = shares.to_numpy() if len(shares) > 1 else table.array("saved", contender=contender)
    return _falls(list(shares), outcomes)


def savable(table: Table) -> npt.NDArray[np.bool_]:
    """Return which of the table's own starts can be saved ``(n, L)``, as far as is known, at each λ.

    They are those within the boundary of studies.recoverable, and those that any contender saves.
    """
    lams, seed = sorted(set(table.rows["lam"])), int(table.rows["seed"].to_numpy()[0])
    x = dpend.Balance(lam=1.0).starts(np.random.default_rng([seed, 1]), _starts(table), dpend.rig(DEFAULT_RIG))
    known = np.transpose([kept_boundary().savable(lam * x) for lam in lams])
    for own, saved in _saved(table):
        known[own] |= saved
    return known


def _saved(table: Table, **fields: str) -> Iterator[tuple[slice, npt.NDArray[np.bool_]]]:
    """Return which starts each job saved ``(n, L)``, and which of all starts these are."""
    for job, rows in table.where(**fields).groupby("job"):
        if "saved" in (arrays := table.by_job.get(int(str(job)), {})):
            first = int(rows["first"].to_numpy()[0])
            yield slice(first, first + len(arrays["saved"])), arrays["saved"] > 0


def best(table: Table) -> tuple[dict[float, Estimate], Falls]:
    """Return what is saved at best of the table's own starts: the share by λ, and λ50 and λ90."""
    if not _default(table):
        beyond = Estimate(math.inf, math.inf, math.inf)
        return {}, (beyond, beyond)
    lams, known = sorted(set(table.rows["lam"])), savable(table)
    shares = {lam: share(each.sum(), len(known)) for lam, each in zip(lams, known.T, strict=True)}
    return shares, _falls(lams, known)


def _falls(lams: list[float], outcomes: npt.NDArray[Any]) -> Falls:
    return crossing(lams, outcomes, 0.5, square=True), crossing(lams, outcomes, 0.9, square=True)


def _starts(table: Table) -> int:
    """Return of how many starts at each λ the contenders have all or a part."""
    return int(np.max(table.rows["first"] + table.rows["episodes"]))


def _default(table: Table) -> bool:
    """Return whether a table is of the rig of the report, for which comparisons are known."""
    return set(table.rows["plant"]) == {DEFAULT_RIG}


def _outcomes(table: Table, contender: str) -> list[str]:
    """Return how each training of a contender ended."""
    return list(table.where(contender=contender).drop_duplicates("training")["outcome"])


def converged(table: Table, contender: str) -> str:
    """Return how many trainings of a contender converged, such as "77 of 100"."""
    outcomes = _outcomes(table, contender)
    return f"{outcomes.count('converged')} of {len(outcomes)}"


def _label(table: Table, contender: str) -> str:
    """Name a contender; a dagger marks one training as shipped."""
    return f"{contender} †" if set(_outcomes(table, contender)) == {SHIPPED} else contender


def _full_label(table: Table, contender: str) -> str:
    """Name a contender, with the number of its trainings that converged if not all did."""
    all_did = set(_outcomes(table, contender)) <= {DESIGNED, SHIPPED, "converged"}
    return _label(table, contender) + ("" if all_did else f" ({converged(table, contender)} converged)")


def report(table: Table) -> Report:
    """Draw success against λ, where it falls, forces and maps; tabulate them and what learning cost."""
    looks = styles(table.rows["contender"], KNOWN)
    lams = sorted(set(table.rows["lam"]))
    success = {name: {lam: saved(table, name, lam) for lam in lams} for name in looks}
    falls = {name: falls_to(table, name) for name in looks}
    known, known_falls = best(table)
    figures = {"": _overview(table, looks, success, known)}
    figures["_all"] = _everyone(table, looks, success, known, ({BEST_KNOWN: known_falls} if known else {}) | falls)
    if gains := _gains(table, success):
        figures["_nonlinearity"] = _plot_gains(success, gains, known, looks)
    if maps := {name: np.mean(found, axis=0) for name in looks if (found := table.arrays("basin", contender=name))}:
        figures["_basins"] = plot_basins(maps, known=_default(table))
    named = {BEST_KNOWN: known} | {_full_label(table, name): curve for name, curve in success.items()}
    note = "† as shipped, one training" if any("†" in name for name in named) else ""
    beyond = f"Saved beyond the {BASELINE} law, points, on the starts that both had"
    tables = (
        _by_lam(
            "Starts saved, %",
            named | ({"the report's Table 2": reported} if (reported := _table2(table)) else {}),
            note=note,
        ),
        _by_lam("Of the starts that can be saved: saved, %", _of_savable(table)),
        _by_lam(beyond, gains, "+.1%"),
        _falls_table(table, ({BEST_KNOWN: known} if known else {}) | success, {BEST_KNOWN: known_falls} | falls),
        *_learning_tables(table, success),
    )
    return Report(figures=figures, tables=tables)


def _by_lam(title: str, of: Mapping[str, Mapping[float, Value]], form: str = ".1%", note: str = "") -> Sheet:
    lines = [{"contender": name} | at(curve) for name, curve in of.items() if curve]
    return sheet(title, lines, form, note=note, brief={"contender", *at(TABLE2)})


def _table2(table: Table) -> dict[float, float]:
    """Return the report's shares at the table's own λ, where it is of the plant that the report's program has."""
    coded = set(table.rows["plant"]) == {"gustafsson2016_as_coded"}
    return {lam: TABLE2[lam] for lam in TABLE2 if coded and lam in set(table.rows["lam"])}


def _overview(table: Table, looks: Mapping[str, Style], success: Mapping[str, Curve], known: Curve) -> Figure:
    """Draw what some save beside the best known, and the forces that they take to it."""
    own = [name for name in looks if name not in {each.name for each in KNOWN}]
    some = sorted(looks, key=lambda name: name not in (*own, *FIRST))[: len(own) + len(FIRST)]
    traces = {
        f"{name}, one episode at λ = {_TRACE_LAM:g}": (force, looks[name])
        for name in looks
        for force in table.arrays("force", contender=name)
    }
    figure, axes = mosaic([["saved", [[title] for title in traces]] if traces else ["saved"]], height=4.6)
    best_known(axes["saved"], known, BEST_KNOWN)
    saved_by_angle(axes["saved"], {_label(table, name): success[name] for name in some}, [looks[name] for name in some])
    _table2_stars(axes["saved"], table)
    axes["saved"].legend(loc="lower left", bbox_to_anchor=(0.0, 0.05))
    _figures.force_traces(axes, traces, float(table.rows["sample_time"].to_numpy()[0]), _TRACE_SECONDS)
    return figure


def _everyone(
    table: Table, looks: Mapping[str, Style], success: Mapping[str, Curve], known: Curve, falls: Mapping[str, Falls]
) -> Figure:
    """Draw what everyone saves, by kind of law, and where success falls."""
    kind_of = {name: kind for kind, names in KINDS.items() for name in names}
    of_kind = {kind: [name for name in looks if kind_of.get(name, OTHERS) == kind] for kind in KINDS}
    of_kind = {kind: names for kind, names in of_kind.items() if names}
    pairs = [list(of_kind)[k : k + 2] for k in range(0, len(of_kind), 2)]
    heights = [3.2] * len(pairs) + [0.5 + 0.19 * len(falls)]
    rows = [pair if len(pair) == 2 else 2 * pair for pair in pairs]
    figure, axes = mosaic([*rows, 2 * ["falls"]], height=sum(heights), height_ratios=heights)
    for kind, own in of_kind.items():
        best_known(axes[kind], known, BEST_KNOWN)
        of = {_label(table, name): success[name] for name in own}
        saved_by_angle(axes[kind], of, [looks[name] for name in own])
        if "Q published" in own:
            _table2_stars(axes[kind], table)
        legend_above(axes[kind], 2, kind)
    lams = list(next(iter(success.values())))
    order = sorted(falls, key=lambda n: (n == BEST_KNOWN, falls[n][0].value, falls[n][1].value), reverse=True)
    for which in (0, 1):
        of = {name: falls[name][which] for name in order}
        forest(axes["falls"], of, looks, tried=(lams[0], lams[-1]), hollow=which == 1)
    axes["falls"].set_xlabel("λ90 (open) and λ50 (filled), rad")
    return figure


def _table2_stars(axis: Axes, table: Table) -> None:
    """Mark the report's own figures where the table is of the plant that its program has."""
    if reported := _table2(table):
        estimates, style = [Estimate(value) for value in reported.values()], ("k", "*", "none")
        _figures.intervals(axis, list(reported), estimates, style, label="the report's Table 2", ms=8, zorder=5)


def _gains(table: Table, success: Mapping[str, Curve]) -> dict[str, Curve]:
    """Return by how much the share saved exceeds the baseline's by λ, of the others of the ladder that took part."""
    if BASELINE not in success:
        return {}
    base = table.array("saved", contender=BASELINE)
    saved = {name: table.array("saved", contender=name) for name in LADDER if name in success and name != BASELINE}
    return {
        name: {lam: difference(of[: len(base), k], base[: len(of), k]) for k, lam in enumerate(success[name])}
        for name, of in saved.items()
    }


def _plot_gains(
    success: Mapping[str, Curve], gains: Mapping[str, Curve], known: Curve, looks: Mapping[str, Style]
) -> Figure:
    """Draw what the ladder saves, and what each of it saves beyond the baseline: what a nonlinear law can gain."""
    figure, ((left, right),) = facets(1, 2, height=3.9)
    base = success[BASELINE]
    gains = {name: curve for name, curve in gains.items() if name != "DDPG balance"}  # a seventh curve is too many
    saved_by_angle(left, {name: success[name] for name in LADDER if name == BASELINE or name in gains}, looks)
    best_known(left, known, BEST_KNOWN)
    right.axhline(0.0, color=looks[BASELINE][0], lw=1.0)
    above = {lam: Estimate(*(np.array(each) - base[lam].value)) for lam, each in known.items() if lam in base}
    best_known(right, above, BEST_KNOWN)
    curves(right, gains, looks)
    right.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{100 * value:+.0f}"))
    right.set(xlabel="greatest starting angle λ (rad)", ylabel=f"points more than the {BASELINE} law")
    legend_above(figure, 4)
    return figure


def _of_savable(table: Table) -> dict[str, Curve]:
    if not _default(table):
        return {}
    known, lams, found = savable(table), sorted(set(table.rows["lam"])), {}
    for name in styles(table.rows["contender"], KNOWN):
        if parts := [(saved.sum(axis=0), known[own].sum(axis=0)) for own, saved in _saved(table, contender=name)]:
            each = zip(lams, *np.transpose(parts, (1, 2, 0)), strict=True)  # (L, trainings) saved, and savable
            found[name] = {lam: mean_share(done / np.maximum(can, 1), can) for lam, done, can in each}
    return found


def _falls_table(table: Table, success: Mapping[str, Curve], falls: Mapping[str, Falls]) -> Sheet:
    lines = []
    for name, curve in success.items():
        lams, starts, more = list(curve), _starts(table), None
        if name != BEST_KNOWN:
            starts = int(np.sum(table.where(contender=name, lam=lams[0])["episodes"]))
            gains = ((saved(table, name, lam, "successes_report").value - curve[lam].value, -lam) for lam in lams)
            gain, lam = max(gains)
            more = f"+{100 * gain:.1f} at {-lam:g}" if gain > 0 else "the same"
        lam50, lam90 = (cell(each, ".3f", tried=(lams[0], lams[-1])) for each in falls[name])
        lines.append({"contender": name, "starts": starts, "λ50, rad": lam50, "λ90, rad": lam90, "link 1 alone": more})
    note = "link 1 alone: by how many points more are saved by the report's criterion, and where most"
    return sheet("Where success falls to a half and to nine tenths", lines, note=note)


def _learning_tables(table: Table, success: Mapping[str, Curve]) -> tuple[Sheet, Sheet]:
    """Tabulate what learning cost, and what those trainings save that converged, where not all did."""
    costs, saved_by = [], []
    headings = {"training_episodes": "episodes", "training_steps": "learning steps", "test_steps": "test steps"}
    for name in success:
        own = table.where(contender=name)
        if set(own["outcome"]) & {DESIGNED, SHIPPED}:
            continue
        medians = own.drop_duplicates("training")[list(headings)].median().rename(headings)
        costs.append({"learner": name, "converged": converged(table, name)} | medians.to_dict())
        done = where(own, outcome="converged")
        if 0 < len(done) < len(own):
            saved_by.append({"learner": name} | at({lam: _mean(where(done, lam=lam)) for lam in success[name]}))
    cost = sheet("What learning cost, medians over trainings", costs, ",.0f")
    return cost, sheet("Starts saved by the trainings that converged, %", saved_by, ".1%")


if __name__ == "__main__":
    _runner.main("studies.lambda_sweep")
