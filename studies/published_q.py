"""Does the report's Q-learning converge with its own hyper-parameters, whatever it left unstated?

Method: Algorithm 1 with the report's α = 0.0001, ε = 0.01, γ = 0.99, action set and Table 1 features on
gustafsson2016, λ = 0.1, over combinations of what the report does not state: the weights of the state cost, the cost
of a failed episode, whether the failed step still bootstraps (as Algorithm 1 is printed), and how many successes in a
row are convergence. Also with link 1 alone falling, as the report says, and with both; and with and without the six
features of the cart. Each combination is trained from several seeds, until it converges, a weight overflows, or the
budget of episodes is spent; a controller that converged then meets fresh starts.

Finding: with all 18 features none of 480 trainings comes to 10 successes in a row, every one overflows; without the
cart's six, by the report's criterion, 20 of 240 come to 20, at best 5 of 20 in one combination, against the report's
70 %.  From the default options, kept in docs/results/published_q.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from rich.table import Table

import dpend
from rl import LinearQLearning

from . import _study
from ._intervals import wilson
from ._study import Job, Result, Traces

FEATURES = {"all 18 features": True, "without the cart's six": False}
CRITERIA = {"link 1 alone": "report", "both links": "strict"}
WEIGHTS = {"0:1:1": (0.0, 10.0, 10.0), "1:1:1": (10.0, 10.0, 10.0), "1:10:10": (1.0, 10.0, 10.0)}
FAILURE_COSTS = (0.0, 100.0)
BOOTSTRAPS = {"bootstraps": True, "ends": False}
STREAKS = (10, 20, 50)

REPORT_SHARE = 0.7
"""Share of trainings that converged, as the report says."""


@dataclass(frozen=True, kw_only=True)
class Options(_study.Options):
    """What can be told on the command line."""

    trainings: int = 20
    """Seeds for each combination."""
    max_episodes: int = 2000
    """Budget of each training."""
    episodes: int = 100
    """Fresh starts at λ = 0.1 that a converged controller meets."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_least(1, "trainings", "max_episodes", "episodes")

    @property
    def sizes(self) -> tuple[int, int]:
        """Trainings and their budget; few and small where it must be quick."""
        return (
            (min(self.trainings, 2), min(self.max_episodes, 50)) if self.quick else (self.trainings, self.max_episodes)
        )


@dataclass(frozen=True, kw_only=True)
class Row:
    """One training."""

    features: str
    criterion: str
    weights: str
    """Ratio of the cost's weights on position, angle 1 and angle 2."""
    failure_cost: float
    failed_step: str
    streak: int
    """Successes in a row that count as convergence."""
    training: int
    outcome: str
    training_episodes: int
    training_steps: int
    episodes: int
    successes: int
    """Fresh starts saved, neither link falling; counted for converged trainings only."""
    successes_report: int
    """The same by the report's criterion."""


def jobs(options: Options) -> list[Job]:
    """List the work: one job for the trainings of each choice of features and criterion and cost weights."""
    return [Job(f"{f}, {c}, {w}") for f in FEATURES for c in CRITERIA for w in WEIGHTS]


def run(job: Job, options: Options) -> Result:
    """Train every remaining combination from every seed."""
    rig = dpend.rig("gustafsson2016")
    trainings, max_episodes = options.sizes
    kind, criterion, weights = job.setting.split(", ")
    rows = []
    for failure_cost in FAILURE_COSTS:
        task = dpend.Balance(criterion=CRITERIA[criterion], state_weights=WEIGHTS[weights], failure_cost=failure_cost)
        published = LinearQLearning.published(rig, task=task, cart_features=FEATURES[kind])
        for failed_step, bootstrap in BOOTSTRAPS.items():
            for streak in STREAKS:
                learner = replace(published, bootstrap_failure=bootstrap, streak=streak, max_episodes=max_episodes)
                for k in range(trainings):
                    training = learner.train([options.seed, 3, k])
                    saved = {"strict": 0, "report": 0}
                    if training.converged:
                        for name in saved:
                            test = replace(task, criterion=name)
                            starts = test.starts(np.random.default_rng([options.seed, 4, k]), options.episodes, rig)
                            runs = dpend.simulate_many(rig, training.policy, starts, task=test)
                            saved[name] = int(runs.success.sum())
                    rows.append(
                        Row(
                            features=kind,
                            criterion=criterion,
                            weights=weights,
                            failure_cost=failure_cost,
                            failed_step=failed_step,
                            streak=streak,
                            training=k,
                            outcome=training.outcome.name.lower().replace("_", " "),
                            training_episodes=training.episodes,
                            training_steps=training.steps,
                            episodes=options.episodes if training.converged else 0,
                            successes=saved["strict"],
                            successes_report=saved["report"],
                        )
                    )
    return Result(rows)


def _share(rows: list[Row]) -> tuple[int, int]:
    return sum(row.outcome == "converged" for row in rows), len(rows)


def plot(rows: list[Row], traces: Traces) -> Figure:
    """Draw the share of trainings that converge in each combination, with 95 % intervals."""
    figure = Figure(figsize=(6.3, 6.6), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True, sharey=True)
    ways = [(w, f, b) for w in WEIGHTS for f in FAILURE_COSTS for b in BOOTSTRAPS]
    styles = zip(STREAKS, ("#0072B2", "#E69F00", "#009E73"), ("o", "s", "D"), (-0.22, 0.0, 0.22), strict=True)
    for streak, colour, marker, aside in styles:
        for i, kind in enumerate(FEATURES):
            for j, criterion in enumerate(CRITERIA):
                axis = axes[j, i]
                for place, (weights, failure_cost, failed_step) in enumerate(ways):
                    own = [
                        row
                        for row in rows
                        if (row.features, row.criterion, row.streak) == (kind, criterion, streak)
                        and (row.weights, row.failure_cost, row.failed_step) == (weights, failure_cost, failed_step)
                    ]
                    rate = wilson(*_share(own))
                    axis.errorbar(
                        rate.share, place + aside, xerr=[[rate.share - rate.low], [rate.high - rate.share]],
                        color=colour, marker=marker, ms=3.5, lw=0.9, ls="none",
                        label=f"{streak} successes in a row" if place == 0 else None,
                    )  # fmt: skip
                axis.set_title(f"{kind}, {criterion}", fontsize=9)
                axis.grid(alpha=0.3)
    for axis in axes.flat:
        axis.axvline(REPORT_SHARE, color="k", ls="--", lw=1, label="the report")
        axis.set(xlim=(-0.02, 1.02), yticks=range(len(ways)))
        axis.xaxis.set_major_formatter(PercentFormatter(1.0))
        axis.tick_params(labelsize=8)
    axes[0, 0].set_yticklabels([f"{w}, {f:g}, {b}" for w, f, b in ways])
    axes[0, 0].invert_yaxis()
    figure.supxlabel("trainings that converge", fontsize=9)
    figure.supylabel("cost weights p:θ1:θ2, failure cost, failed step", fontsize=9)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4, fontsize=8, frameon=False)
    return figure


def summary(rows: list[Row], traces: Traces) -> Table:
    """Condense the table: how trainings end, by features and criterion, and what the converged are worth.

    Combinations share their seeds, so only the counts of one combination are independent; the best is shown.
    """
    table = Table(title="The report's Q-learning, to the letter, over all choices of what it left unstated")
    headings: tuple[tuple[str, Literal["left", "right"]], ...] = (
        ("features", "left"),
        ("falling is", "left"),
        ("converged: 10 / 20 / 50\nsuccesses in a row", "right"),
        ("most in one combination,\n20 in a row", "right"),
        ("diverged", "right"),
        ("budget\nspent", "right"),
        ("converged save,\nλ = 0.1", "right"),
    )
    for heading, justify in headings:
        table.add_column(heading, justify=justify)
    for kind in FEATURES:
        for criterion in CRITERIA:
            own = [row for row in rows if (row.features, row.criterion) == (kind, criterion)]
            by_streak = [_share([row for row in own if row.streak == streak]) for streak in STREAKS]
            combinations = {(row.weights, row.failure_cost, row.failed_step) for row in own}
            best = max(
                _share([r for r in own if r.streak == 20 and (r.weights, r.failure_cost, r.failed_step) == combination])
                for combination in combinations
            )
            done = [row.successes / row.episodes for row in own if row.episodes]
            table.add_row(
                kind,
                criterion,
                " / ".join(str(converged) for converged, _ in by_streak) + f" of {by_streak[0][1]}",
                f"{best[0]} of {best[1]}",
                *(str(sum(row.outcome == outcome for row in own)) for outcome in ("diverged", "budget spent")),
                f"{100 * np.mean(done):.0f} %" if done else "-",
            )
    return table


if __name__ == "__main__":
    _study.main("studies.published_q")
