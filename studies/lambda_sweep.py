"""How do controllers and learners compare as the starting spread λ grows, and with what can be saved at all?

Method: everybody of studies/_entrants.py that balances, and controllers of yours (``--controller path.py:factory``),
balances gustafsson2016 from θ1, θ2 ~ U[-λ, λ] for 300 samples of 0.02 s, and saves a start if neither link falls and
the cart stays on its track.  All λ share their directions.  What is designed meets all starts; the k-th training of a
learner meets the k-th part of them, 100 each by default as in the report; deep learners come as shipped, one training,
and meet 10 000 at most; those that take long meet the first starts only.  Intervals are 95 %: Wilson's for one
controller, Student's over trainings for learned ones.  λ50 and λ90 are where the curve falls to a half and to nine
tenths.  The grey line is the best known, studies.recoverable.  A second figure shows from which angles at rest each
saves the pendulum.

Why Q-learning is bang-bang: each feature of the report's Table 1 is constant or linear in the action, so
q(s, a) = c(s) + a g(s) is a straight line over the actions.  Its greatest value is always at an end of the action set,
so the greedy force is always +40 or -40 N.  No training can make it smooth; features with a² could.

Finding: LQR saves 100/99.9/87.3/67.3 % at λ = .1/.2/.3/.4, Q-learning tuned 100/98.4/82.2/61.3 % (100 of 100 trainings
converge, by search and select), the report 94/92/78/49 %; as published no training converges (0 of 100).  From
``--trainings 100 --episodes 1000 --part-of 1000 --plain --seed 2``, kept in docs/results/lambda_sweep_100.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from rich.box import SIMPLE, SIMPLE_HEAD
from rich.console import Group, RenderableType
from rich.table import Table

import dpend
from dpend.params import Array
from rl import LinearQLearning

from . import _entrants, _study, recoverable
from ._basins import basin, plot_basins
from ._curves import Falls, percent, plot_best, plot_curves, plot_falls, spread
from ._entrants import ENTRANTS, RIG, Entrant, Style, Told, styles
from ._intervals import Crossing, Rate, crossing, over_seeds, wilson
from ._study import Job, Result, Traces

TABLE2 = {0.1: 0.94, 0.2: 0.92, 0.3: 0.78, 0.4: 0.49}
"""The report's Table 2: share of successful episodes by λ, ten trained controllers, 100 episodes each."""

PLAIN = "Q tuned, plain rule"

ONLY_HERE = (
    Entrant(
        name="Q published",
        make=lambda rig, task: LinearQLearning.published(rig).train(0).policy,
        told=Told("none", "report's cost", "λ = .1 about upright"),
        style=("#777777", "v", ":"),
        learner=lambda rig: LinearQLearning.published(rig),
    ),
    Entrant(
        name=PLAIN,
        make=lambda rig, task: LinearQLearning.tuned(rig, select=False).train(0).policy,
        told=Told("none", "report's cost, weights tuned", "λ = .08 about upright"),
        style=("#8C6D1F", "P", "-."),
        learner=lambda rig: LinearQLearning.tuned(rig, select=False),
    ),
)
"""Learners that no other study needs: the report's, and the tuned one without acceptance tests and restarts."""

KNOWN = (
    *(entrant for entrant in ENTRANTS if not entrant.policy),
    *ONLY_HERE,
    *(entrant for entrant in ENTRANTS if entrant.policy),
)
"""Those that can take part, what is designed first."""

DESIGNED, SHIPPED = "-", "shipped"
"""How a training ended where there was none: a design, or a policy that was trained elsewhere, once."""

BEST = "best known"
"""What any force can save, from ``studies.recoverable``."""

TRACED = ("LQR", "Q published", "Q tuned", "LSPI", "PPO balance")
"""Whose force is drawn: what is smooth beside what is bang-bang."""

_TRACE_LAM, _TRACE_SECONDS = 0.1, 1.0
_ENOUGH = 10_000  # starts of what is shipped: a network takes ten times as long as a gain
_RARE = 0.1  # of a part: who meets so few of the runs takes minutes


@dataclass(frozen=True, kw_only=True)
class Options(_entrants.Options):
    """What can be told on the command line."""

    known: ClassVar[tuple[Entrant, ...]] = KNOWN

    lam: tuple[float, ...] = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
    """Spreads of the starting angles, rad."""
    trainings: int = 10
    """Trainings of each learner that learns in seconds."""
    episodes: int = 100
    """Starts that each trained controller meets at each spread."""
    part_of: int = 250
    """Of so many starts those that take long meet their part, the first ones: iLQR MPC and SDRE a fifth."""
    basins: int = 41
    """Points on each side of the maps of what is saved from rest; none for no maps."""
    plain: bool = False
    """Add the tuned learner with the plain rule of convergence: 20 successes in a row, no tests, no restarts."""
    all: bool = False
    """Add what takes minutes: NMPC, and coarse maps of those that take long."""

    def __post_init__(self) -> None:
        super().__post_init__()
        recoverable.check_spreads(self.lam)
        self.check_least(1, "trainings")
        self.check_least(2, "episodes", "part_of")
        self.check_least(0, "basins")
        if not self.entrants("balance"):
            raise ValueError(f"--only names nobody that balances; got {self.only}.")

    @property
    def sizes(self) -> tuple[int, int]:
        """Trainings of each learner, and starts of each; few where it must be quick."""
        return (min(self.trainings, 2), min(self.episodes, 20)) if self.quick else (self.trainings, self.episodes)

    @property
    def spreads(self) -> tuple[float, ...]:
        """The spreads in order; every fourth where it must be quick."""
        return tuple(sorted(self.lam))[:: 4 if self.quick else 1]

    def entrants(self, task: _entrants.Task) -> list[Entrant]:
        """Return those that take part: not what takes minutes, nor the plain rule, unless they are asked for."""
        asked = (*self.only, *([PLAIN] if self.plain else []))
        return [
            entrant
            for entrant in super().entrants(task)
            if entrant.name in asked or self.all or (entrant.part >= _RARE and entrant.name != PLAIN)
        ]

    def starts(self, entrant: Entrant) -> int:
        """Return how many starts one who is not trained here meets at each spread."""
        whole = math.prod(self.sizes)
        if entrant.part >= 1:
            return min(whole, _ENOUGH) if entrant.policy else whole
        return min(whole, 2 if self.quick else entrant.runs(self.part_of))

    def side(self, entrant: Entrant) -> int:
        """Return the points on a side of one's map; none where it takes too long."""
        if entrant.part < 1:
            return round(math.sqrt(entrant.part) * self.basins) if self.all and not self.quick else 0
        return min(self.basins, 5) if self.quick else self.basins


@dataclass(frozen=True, kw_only=True)
class Row:
    """One controller at one spread."""

    controller: str
    training: int
    lam: float
    episodes: int
    successes: int
    """Starts saved: neither link fell."""
    successes_report: int
    """Starts saved by the report's criterion, which looks at link 1 alone."""
    outcome: str
    """How the training ended; a dash where there was none, "shipped" where it was elsewhere."""
    training_episodes: int
    training_steps: int
    test_steps: int


def jobs(options: Options) -> list[Job]:
    """List the work: each learner once a training, all others once; what takes longest first."""
    return [
        Job(entrant.name, k, entrant.source)
        for entrant in sorted(options.entrants("balance"), key=lambda entrant: entrant.part)
        for k in range(options.sizes[0] if entrant.learner else 1)
    ]


def run(job: Job, options: Options) -> Result:
    """Train where there is something to train, then meet the starts of every spread, and those of the map."""
    entrant = options.entrant(job.setting)
    trainings, episodes = options.sizes
    if entrant.learner:
        training = entrant.learner(RIG).train([options.seed, 2, job.repetition])
        controller: dpend.Controller = training.policy
        outcome = training.outcome.name.lower().replace("_", " ")
        cost = training.episodes, training.steps, training.test_steps
        mine = slice(job.repetition * episodes, (job.repetition + 1) * episodes)
    else:
        controller = entrant.make(RIG, dpend.Balance())
        outcome, cost = SHIPPED if entrant.policy else DESIGNED, (0, 0, 0)
        mine = slice(options.starts(entrant))
    strict, report = [], []
    for lam in options.spreads:
        task = dpend.Balance(lam=lam)
        starts = task.starts(np.random.default_rng([options.seed, 1]), trainings * episodes, RIG)[mine]
        saved = dpend.simulate_many(RIG, controller, starts, task=task, seed=options.seed).success
        strict.append(saved)
        report.append(saved.copy())  # who stands by the strict criterion stands by the report's too
        if not saved.all():
            lenient = replace(task, criterion="report")
            report[-1][~saved] = dpend.simulate_many(
                RIG, controller, starts[~saved], task=lenient, seed=options.seed
            ).success
    rows = [
        Row(
            controller=job.setting, training=job.repetition, lam=lam, episodes=len(saved), successes=int(saved.sum()),
            successes_report=int(by_report.sum()), outcome=outcome,
            training_episodes=cost[0], training_steps=cost[1], test_steps=cost[2],
        )
        for lam, saved, by_report in zip(options.spreads, strict, report, strict=True)
    ]  # fmt: skip
    traces: dict[str, npt.NDArray[Any]] = {"saved": np.transpose(strict)}
    if job.repetition == 0 and (job.setting in TRACED or entrant.source):
        traces["force"] = _trace(controller, options.seed)
    if side := options.side(entrant):
        traces["basin"] = basin(controller, side, options.seed)
    return Result(rows, traces)


def _trace(controller: dpend.Controller, seed: int) -> Array:
    """Return the force over the first seconds of one episode, the same for every controller, until it falls."""
    task = dpend.Balance(lam=_TRACE_LAM)
    start = task.starts(np.random.default_rng([seed, 1]), 1, RIG)[0]
    return dpend.simulate(RIG, controller, start, _TRACE_SECONDS, task=task, seed=seed).u


# ---------------------------------------------------------------------------------------------- what the table comes to


def _of(rows: list[Row], controller: str) -> list[Row]:
    return [row for row in rows if row.controller == controller]


def _trained(rows: list[Row], controller: str) -> bool:
    return _of(rows, controller)[0].outcome not in (DESIGNED, SHIPPED)


def rate(rows: list[Row], controller: str, lam: float, *, report: bool = False) -> Rate:
    """Return the success of a controller at one spread, with its interval.

    Parameters
    ----------
    rows : list of Row
        The table.
    controller : str
        One of those in it.
    lam : float
        The spread.
    report : bool
        By the report's own criterion, which looks at link 1 alone.

    Returns
    -------
    Rate
    """
    chosen = [row for row in _of(rows, controller) if row.lam == lam]
    counts = [row.successes_report if report else row.successes for row in chosen]
    if _trained(rows, controller):
        return over_seeds(counts, chosen[0].episodes)
    return wilson(sum(counts), chosen[0].episodes)


def falls_to(rows: list[Row], traces: Traces, controller: str) -> Falls:
    """Return the spreads λ50 and λ90 at which a controller saves a half and nine tenths of the starts.

    Parameters
    ----------
    rows : list of Row
        The table.
    traces : Traces
        Which starts each job saved.
    controller : str
        One of those in the table.

    Returns
    -------
    lam50, lam90 : Crossing
        The interval is over starts, or over trainings where there are several.
    """
    own = _of(rows, controller)
    lams = sorted({row.lam for row in own})
    trainings = dict.fromkeys(row.training for row in own)
    if len(trainings) == 1:
        curves = traces[_study.slug(Job(controller))]["saved"]
    else:
        share = {(row.training, row.lam): row.successes / row.episodes for row in own}
        curves = np.array([[share[training, lam] for lam in lams] for training in trainings])
    return crossing(lams, curves, 0.5), crossing(lams, curves, 0.9)


def best(lams: Sequence[float]) -> tuple[dict[float, Rate], Falls]:
    """Return what can be saved at all, as far as is known: the share by spread within those given, and λ50 and λ90."""
    known = {lam: saved for lam, saved in recoverable.shipped().items() if lams[0] <= lam <= lams[-1]}
    if not known:
        return {}, (Crossing(math.inf, math.inf, math.inf), Crossing(math.inf, math.inf, math.inf))
    outcomes = np.stack(list(known.values()), axis=1)
    rates = {lam: wilson(int(saved.sum()), len(saved)) for lam, saved in known.items()}
    return rates, (crossing(list(known), outcomes, 0.5), crossing(list(known), outcomes, 0.9))


def _converged(rows: list[Row], controller: str) -> str:
    outcomes = {row.training: row.outcome for row in _of(rows, controller)}
    return f"{sum(outcome == 'converged' for outcome in outcomes.values())} of {len(outcomes)}"


def _marked(rows: list[Row], controller: str) -> str:
    """Name a controller; a dagger marks a policy as it is shipped, one training."""
    return f"{controller} †" if _of(rows, controller)[0].outcome == SHIPPED else controller


def _label(rows: list[Row], controller: str) -> str:
    """Name a controller, and say how many of its trainings converged if not all did."""
    all_did = not _trained(rows, controller) or {row.outcome for row in _of(rows, controller)} == {"converged"}
    return _marked(rows, controller) if all_did else f"{controller} ({_converged(rows, controller)} converged)"


# -------------------------------------------------------------------------------------------------- figures and summary


def plot(rows: list[Row], traces: Traces) -> dict[str, Figure]:
    """Draw success against spread, where it falls to a half, and some forces; and the basins."""
    looks = styles((row.controller for row in rows), KNOWN)
    lams = sorted({row.lam for row in rows})
    curve, falls = best(lams)
    figure = Figure(figsize=(6.8, 7.6), layout="constrained")
    upper, lower = figure.add_gridspec(2, 1, height_ratios=[1.0, 1.1])
    sides = upper.subgridspec(1, 2).subplots(sharey=True, squeeze=False)[0]
    for axis, title in zip(sides, ("designed", "learned († as shipped, one training)"), strict=True):
        own = [name for name in looks if (_of(rows, name)[0].outcome == DESIGNED) == (title == "designed")]
        plot_best(axis, curve, BEST)
        curves = {_label(rows, name): {lam: rate(rows, name, lam) for lam in lams} for name in own}
        plot_curves(axis, curves, [looks[name] for name in own])
        if title != "designed":
            stars = {lam: share for lam, share in TABLE2.items() if lams[0] <= lam <= lams[-1]}
            axis.plot(list(stars), list(stars.values()), "k*", ms=8, label="the report's Table 2", zorder=5)
        axis.set_xlabel("starting spread λ (rad)", fontsize=9)
        axis.legend(
            title=title, title_fontsize=8.5, fontsize=7, ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0),
            frameon=False, handlelength=2.2, columnspacing=1.0, borderpad=0.1,
        ) if own else axis.set_title(title, fontsize=8.5)  # fmt: skip
    sides[0].set_ylabel("starts saved", fontsize=9)

    halves = lower.subgridspec(1, 2)
    found = {name: falls_to(rows, traces, name) for name in looks}
    order = sorted(found, key=lambda name: (found[name][0].level, found[name][1].level))
    axis = figure.add_subplot(halves[0])
    plot_falls(axis, {name: found[name] for name in order} | ({BEST: falls} if curve else {}), looks, lams)
    axis.set_xlabel("λ90 (open) and λ50 (filled), rad", fontsize=9)
    traced = [name for name in looks if "force" in traces.get(_study.slug(Job(name)), {})]
    _plot_traces(halves[1], {name: traces[_study.slug(Job(name))]["force"] for name in traced}, looks)

    maps: dict[str, list[Array]] = {}
    for name in looks:
        for training in dict.fromkeys(row.training for row in _of(rows, name)):
            saved = traces.get(_study.slug(Job(name, training)), {}).get("basin")
            maps |= {name: [*maps.get(name, []), saved]} if saved is not None else {}
    if not maps:
        return {"": figure}
    return {"": figure, "_basins": plot_basins({name: np.mean(saved, axis=0) for name, saved in maps.items()})}


def _plot_traces(place: SubplotSpec, forces: dict[str, Array], looks: dict[str, Style]) -> None:
    """Draw forces one below the other, each until it ends."""
    if not forces:
        return
    axes = place.subgridspec(len(forces), 1).subplots(sharex=True, squeeze=False)[:, 0]
    for axis, (name, force) in zip(axes, forces.items(), strict=True):
        time = RIG.sample_time * np.arange(len(force) + 1)
        axis.stairs(force, time, baseline=None, color=looks[name][0], lw=1.0)
        if time[-1] < _TRACE_SECONDS - 0.5 * RIG.sample_time:
            axis.plot(time[-1], force[-1], "kx", ms=5, clip_on=False)
            axis.text(time[-1] + 0.02, 0, "fell", va="center", fontsize=7.5)
        axis.set(xlim=(0, _TRACE_SECONDS), ylim=(-46, 46), yticks=(-40, 0, 40))
        axis.set_title(f"{name}, one episode at λ = {_TRACE_LAM:g}", fontsize=7.5, loc="left", pad=2)
        axis.tick_params(labelsize=7)
        axis.grid(alpha=0.3)
    axes[-1].set_xlabel("time (s)", fontsize=9)
    axes[len(axes) // 2].set_ylabel("force on the cart (N)", fontsize=9)


def summary(rows: list[Row], traces: Traces) -> RenderableType:
    """Condense the table: success and where it falls, with intervals, by controller; and what learning cost."""
    names = list(styles((row.controller for row in rows), KNOWN))
    lams = sorted({row.lam for row in rows})
    known, known_falls = best(lams)
    title = "Starts saved, %, by λ, with 95 % interval; † as shipped, one training"
    success = Table(title=title, box=SIMPLE_HEAD, padding=0, show_edge=False)  # nine columns within eighty letters
    success.add_column("")
    for lam in lams:
        success.add_column(f"{lam:g}", justify="right")
    if known:
        success.add_row(BEST, *(percent(known[lam]) if lam in known else "" for lam in lams))
    for name in names:
        success.add_row(_marked(rows, name), *(percent(rate(rows, name, lam)) for lam in lams))
    success.add_row("the report's Table 2", *(f"{100 * TABLE2[lam]:.0f}" if lam in TABLE2 else "" for lam in lams))

    falls = Table(title="Where success falls to a half and to nine tenths, rad, with 95 % interval", box=SIMPLE)
    for heading in ("", "starts", "λ50", "λ90", "link 1 alone"):
        falls.add_column(heading, justify="right" if heading else "left")
    if known:
        falls.add_row(BEST, "1000", *(spread(each, list(known)) for each in known_falls), "")
    for name in names:
        starts = sum(row.episodes for row in _of(rows, name) if row.lam == lams[0])
        gain, lam = max((rate(rows, name, lam, report=True).share - rate(rows, name, lam).share, -lam) for lam in lams)
        more = f"+{100 * gain:.1f} at {-lam:g}" if gain > 0 else "the same"
        falls.add_row(name, f"{starts}", *(spread(each, lams) for each in falls_to(rows, traces, name)), more)
    falls.caption = "link 1 alone: by how many points more are saved by the report's criterion, and where most"

    learning = Table(title="What learning cost, medians over trainings, and what the converged ones save", box=SIMPLE)
    for heading in ("learner", "converged", "episodes", "learning steps", "test steps", "converged save, %"):
        learning.add_column(heading, justify="left" if heading == "learner" else "right")
    for name in (name for name in names if _trained(rows, name)):
        own = [row for row in _of(rows, name) if row.lam == lams[0]]
        costs = np.median([(row.training_episodes, row.training_steps, row.test_steps) for row in own], axis=0)
        done = [row for row in _of(rows, name) if row.outcome == "converged"]
        shares = [
            f"{100 * np.mean([row.successes / row.episodes for row in done if row.lam == lam]):.1f}"
            for lam in lams
            if done and len(done) < len(lams) * len(own)
        ]
        learning.add_row(
            name, _converged(rows, name), *(f"{cost:,.0f}" for cost in costs),
            "\n".join(shares) or ("as all" if done else "-"),
        )  # fmt: skip
    return Group(success, falls, *([learning] if learning.row_count else []))


if __name__ == "__main__":
    _study.main("studies.lambda_sweep")
