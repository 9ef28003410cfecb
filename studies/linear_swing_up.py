"""Can a linear controller swing the double pendulum up?

Method: first linear Q-learning as the report tried it, from (π/2, π/2) at rest for 1000 samples, over ε, α, the action
set, initial weights and features; counted are episodes in which both links stay up for a second, within 0.2 rad.  Then
the claim that no linear controller can is put to a search over gains: force K·s, saturated, and force ±40 N by the
sign of K·s, with s the state itself, as in the action part of Table 1, or its angles taken to the nearest turn, from
the side and from hanging at rest, 1000 samples.  Half of the first gains are drawn in any direction, half among those
that hold upright; evolution strategies (CMA-ES) go on from the best, and where some succeed, one more for success from
starts within ±0.05 rad.  The widest of the best is simulated again alone, with a quarter of the integration step as
well, because the motion is chaotic, and from 1000 fresh starts near.

Finding: Q-learning never holds the links up for a second (0 of 432 trainings, 146 225 episodes).  But a linear
controller can: from the side one gain of 90 112, saturated and with angles to the nearest turn, has both links up after
1.78 s and keeps them there, and from hanging every kind of law can; from starts near, at best 5.8 % succeed.  From
``--seed 1``, kept in docs/results/linear_swing_up.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure
from rich.console import Group, RenderableType
from rich.table import Table
from scipy.linalg import solve_discrete_are

import dpend
from dpend.controller import Act
from dpend.params import Array
from rl import LinearQLearning, Outcome
from rl.features import CART_FEATURES, TABLE1
from rl.linear_q import REPORT_FORCES

from . import _study
from ._intervals import wilson
from ._study import Job, Result, Traces

EPSILONS = (0.01, 0.1, 0.3)
ALPHAS = (1e-6, 1e-5, 1e-4, 1e-3)
FORCES = {"the report's": REPORT_FORCES, "0, ±10, ±40": (0.0, 10.0, -10.0, 40.0, -40.0), "±40": (40.0, -40.0)}
WEIGHTS = {"zero": 0.0, "N(0, 1)": 1.0}
FEATURES = ("all 18", "without the cart's six", "scaled")

LAWS = {"K·s": False, "sign of K·s": True}
STATES = {"angles as they are": False, "nearest turn": True}
STARTS = ("side", "hanging")
FORCE = 40.0
"""Largest force, and that of the sign, N."""
_LONG, _NEAR, _STARTS_NEAR = 1000, 0.05, 16
_ROWS = 4096


@dataclass(frozen=True, kw_only=True)
class Options(_study.Options):
    """What can be told on the command line."""

    trainings: int = 2
    """Seeds of each setting of Q-learning."""
    training_episodes: int = 500
    """Budget of each training."""
    candidates: int = 49_152
    """Random gains that each search begins with, half of them such as hold upright."""
    generations: int = 40
    """Generations of each evolution strategy."""
    strategies: int = 4
    """Evolution strategies in each search, from its best random gains."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_least(1, "trainings", "training_episodes", "candidates", "generations", "strategies")


@dataclass(frozen=True, kw_only=True)
class Row:
    """One training, or the best gain of one search."""

    part: str
    """learning or search."""
    setting: str
    start: str
    training: int
    outcome: str
    """How the training ended; for a search, whether its best gain ends upright from rest, simulated alone: "up", or
    "up by rounding" if not also with a quarter of the integration step, or "not up"."""
    episodes: int
    """Learning episodes, or gains tried."""
    successes: int
    """Learning episodes with a second upright, or gains that ended so from rest."""
    longest: float
    """Longest time upright without a break, s."""
    near: int
    """Successes of the best gain from 1000 starts within ±0.05 rad; 0 for trainings."""
    gain: str
    """The best gain, N per unit of each state, or its direction; a dash for trainings."""


class LinearLaw:
    r"""Law :math:`u = K s` or :math:`u = F\,\mathrm{sgn}(K s)`, one gain for all rows or one a row.

    Parameters
    ----------
    K : ndarray (6,) or (n, 6)
        Gains.
    law : str
        One of :data:`LAWS`.
    state : str
        One of :data:`STATES`: what :math:`s` is.
    """

    name = "linear law"

    def __init__(self, K: Array, law: str, state: str) -> None:
        self.K, self.sign, self.nearest = K, LAWS[law], STATES[state]

    def start(self, n: int, rng: np.random.Generator) -> Act:
        """Return the law for ``n`` runs."""
        K = np.broadcast_to(self.K, (n, 6))

        def act(t: float, y: Array) -> Array:
            u = np.einsum("ij,ij->i", K, dpend.nearest_upright(y) if self.nearest else y)
            return FORCE * np.sign(u) if self.sign else np.clip(u, -FORCE, FORCE)

        return act


def _task(start: str, spread: float = 0.0) -> dpend.SwingUp:
    return dpend.SwingUp(start=start, angle_spread=spread)


def jobs(options: Options) -> list[Job]:
    """List the work: Q-learning by features and action set, and the searches."""
    learning = [Job(f"learning, {features}, {forces}") for features in FEATURES for forces in FORCES]
    search = [Job(f"search, {start}, {law}, {state}") for start in STARTS for law in LAWS for state in STATES]
    return [*learning[:1], *search[:1]] if options.quick else [*learning, *search]


def run(job: Job, options: Options) -> Result:
    """Train, or search."""
    part, _, setting = job.setting.partition(", ")
    return _learn(setting, options) if part == "learning" else _search(setting, options)


def _learn(setting: str, options: Options) -> Result:
    rig = dpend.rig("gustafsson2016")
    features, _, forces = setting.partition(", ")
    scales = {
        "all 18": (1.0,) * len(TABLE1),
        "without the cart's six": tuple(0.0 if i in CART_FEATURES else 1.0 for i in range(len(TABLE1))),
        "scaled": LinearQLearning.tuned(rig).scales,
    }[features]
    trainings, budget = (1, 5) if options.quick else (options.trainings, options.training_episodes)
    rows, curves = [], []
    for epsilon, alpha, (weights, spread) in itertools.product(EPSILONS, ALPHAS, WEIGHTS.items()):
        learner = LinearQLearning(
            rig=rig,
            task=_task("side"),
            scales=scales,
            forces=FORCES[forces],
            epsilon=epsilon,
            alpha=alpha,
            spread=spread,
            max_episodes=budget,
        )
        for k in range(trainings):
            training = learner.train([options.seed, 12, k])
            succeeded = training.upright >= round(learner.task.hold / rig.sample_time)
            rows.append(
                Row(
                    part="learning",
                    setting=f"{setting}; ε = {epsilon:g}, α = {alpha:g}, w0 {weights}",
                    start="side",
                    training=k,
                    outcome=training.outcome.name.lower().replace("_", " "),
                    episodes=training.episodes,
                    successes=int(succeeded.sum()),
                    longest=round(float(training.upright.max(initial=0) * rig.sample_time), 4),
                    near=0,
                    gain="-",
                )
            )
            if training.outcome is Outcome.BUDGET_SPENT:
                curves.append(training.rewards / training.lengths)
    if not curves:
        return Result(rows)
    return Result(rows, {"rewards": np.quantile(curves, (0.25, 0.5, 0.75), axis=0)})


class Score(NamedTuple):
    """How far each of some roll-outs came."""

    value: Array
    """What a search climbs: how near to upright at rest it came, how long it stayed on the track and up; success."""
    longest: Array
    """Longest time upright without a break, s."""
    up: npt.NDArray[np.bool_]
    """Whether it ended with a second upright."""


def _scores(K: Array, x0: Array, law: str, state: str, horizon: int) -> Score:
    """Roll every gain ``(n, 6)`` out from its start ``(n, 6)``."""
    rig, task = dpend.rig("gustafsson2016"), _task("hanging")
    longest, final = np.zeros(len(K)), np.zeros(len(K))
    away_least, lasted = np.full(len(K), np.inf), np.zeros(len(K))
    for first in range(0, len(K), _ROWS):
        rows = np.arange(first, min(first + _ROWS, len(K)))
        stepper = dpend.Stepper(rig, len(rows))
        x = stepper.reset(x0[rows])
        held = np.zeros(len(rows))
        act = LinearLaw(K[rows], law, state).start(len(rows), np.random.default_rng(0))
        for k in range(horizon):
            x = stepper.step(act(k * rig.sample_time, x))
            on = task.ended(x, rig) == 0
            held = np.where(task.upright(x) & on, held + rig.sample_time, 0.0)
            longest[rows] = np.maximum(longest[rows], held)
            final[rows] = held
            away = np.abs(dpend.wrap(x[:, 1:3])).sum(axis=1) + 0.15 * np.abs(x[:, 4:]).sum(axis=1)
            away_least[rows] = np.minimum(away_least[rows], np.where(on, away, np.inf))
            lasted[rows] = np.where(on, (k + 1) / horizon, lasted[rows])
            if on.mean() < 0.7:  # most gains leave the track at once
                rows, held, x = rows[on], held[on], x[on].copy()
                if not len(rows):
                    break
                stepper = dpend.Stepper(rig, len(rows))
                stepper.reset(x)
                act = LinearLaw(K[rows], law, state).start(len(rows), np.random.default_rng(0))
    up = final >= task.hold - 1e-9
    stayed = np.minimum(longest, 1.0) + longest / (horizon * rig.sample_time)
    return Score(np.exp(-away_least) + 0.2 * lasted + stayed + up, longest, up)


def _holding(n: int, rng: np.random.Generator) -> Array:
    """Draw gains ``(n, 6)`` that hold upright, for only such a law can stay up: regulators of random weights, moved.

    Half of them nearly balance both angles, so that the force is not at its limit where the links lean alike.
    """
    rig = dpend.rig("gustafsson2016")
    A, B = dpend.discretize(*dpend.linearize(rig.params), rig.sample_time)
    found: list[Array] = []
    while sum(map(len, found)) < n:
        *q, r = np.exp(rng.uniform(np.log(1e-3), np.log(1e3), 7))
        try:
            P = solve_discrete_are(A, B, np.diag(q), np.array([[r]]))
        except ValueError:  # a few weights are too far apart for the solver
            continue
        regulator = -((B.T @ P @ A) / (r + B.T @ P @ B))[0]
        K = regulator * np.exp(0.3 * rng.standard_normal((32, 6)))
        K[::2, 2] = 15.0 * rng.standard_normal(16) - K[::2, 1]
        found.append(K[np.abs(np.linalg.eigvals(A + B * K[:, None, :])).max(axis=1) < 1])
    return np.vstack(found)[:n]


def _search(setting: str, options: Options) -> Result:
    start, law, state = setting.split(", ")
    candidates, generations, strategies = (
        (64, 2, 1) if options.quick else (options.candidates, options.generations, options.strategies)
    )
    rig = dpend.rig("gustafsson2016")
    code = [list(LAWS).index(law), list(STATES).index(state), STARTS.index(start)]
    rng = np.random.default_rng([options.seed, 13, *code])
    exact, near = _task(start), _task(start, _NEAR)
    rest = exact.starts(rng, 1, rig)[0]
    horizon = 100 if options.quick else exact.steps

    directions = rng.standard_normal((candidates // 2, 6)) / (1.0, 1.0, 1.0, 1.0, 0.3, 0.3)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    sizes = np.exp(rng.uniform(np.log(3.0), np.log(1000.0), (len(directions), 1)))
    gains = np.vstack([directions * sizes, _holding(candidates - len(directions), rng)])

    def from_rest(K: Array) -> Score:
        return _scores(K, np.tile(rest, (len(K), 1)), law, state, horizon)

    def from_near(K: Array) -> Score:
        """Score by the share of some starts near that succeed, and by what each came to."""
        each = _scores(np.repeat(K, _STARTS_NEAR, axis=0), np.tile(around, (len(K), 1)), law, state, horizon)
        value, longest, up = (part.reshape(len(K), _STARTS_NEAR) for part in each)
        return Score(up.mean(axis=1) + 0.1 * value.mean(axis=1), longest.max(axis=1), np.asarray(up.any(axis=1)))

    first = from_rest(gains)
    tried, successes = [len(gains)], [int(first.up.sum())]
    ranks = np.argsort(first.value)[::-1]
    held = ranks[ranks >= len(directions)]
    pool, curves = [gains[ranks[:64]]], []
    for k in range(strategies):  # from the best of all, and from the best of those that hold upright
        begin = gains[(ranks if k % 2 == 0 else held)[k // 2]]
        best, curve, count = _evolve(from_rest, begin, 256, generations, rng)
        pool.append(best)
        curves.append(np.maximum(curve, first.value.max()))
        tried.append(256 * generations)
        successes.append(count)
    finalists = np.vstack(pool)
    finalists = finalists[np.argsort(from_rest(finalists).value)[::-1][:64]]
    around = near.starts(rng, _STARTS_NEAR, rig)
    if sum(successes):  # then from starts near as well, not from one alone
        begin = finalists[np.argmax(from_near(finalists).value)]
        wide, _, _ = _evolve(from_near, begin, 96, generations, rng)
        finalists = np.vstack([wide, finalists])
        around = near.starts(rng, _STARTS_NEAR, rig)
        finalists = finalists[np.argsort(from_near(finalists).value)[::-1]]
    K, run, outcome = finalists[0], None, "not up"
    for gain in finalists:  # the widest that succeeds from rest, and does so however finely the plant is integrated
        alone, fine = (
            dpend.simulate(rig.replace(substeps=substeps), LinearLaw(gain, law, state), rest, task=exact)
            for substeps in (rig.substeps, 4 * rig.substeps)
        )
        words = "up" if alone.success and fine.success else "up by rounding" if alone.success else "not up"
        if run is None or (words != outcome and outcome != "up" and words != "not up"):
            K, run, outcome = gain, alone, words
        if outcome == "up":
            break
    assert run is not None
    starts = near.starts(np.random.default_rng([options.seed, 14]), 20 if options.quick else _LONG, rig)
    row = Row(
        part="search",
        setting=f"{law}, {state}",
        start=start,
        training=0,
        outcome=outcome,
        episodes=sum(tried),
        successes=sum(successes),
        longest=round(float(from_rest(finalists).longest.max()), 4),
        near=int(dpend.simulate_many(rig, LinearLaw(K, law, state), starts, task=near).success.sum()),
        gain=" ".join(f"{k:.17g}" for k in K),
    )
    return Result([row], {"scores": np.max(curves, axis=0), "th1": run.x[:, 1], "th2": run.x[:, 2]})


def _evolve(
    scored: Callable[[Array], Score], begin: Array, population: int, generations: int, rng: np.random.Generator
) -> tuple[Array, Array, int]:
    """Maximise by CMA-ES in units of the first gain; give the 16 best gains, best scores by generation, successes.

    Source: N. Hansen, *The CMA evolution strategy: a tutorial*, 2016.
    """
    unit = np.abs(begin) + 0.02 * np.abs(begin).max()
    n, parents, size = len(begin), population // 2, 0.2
    weights = np.log(parents + 0.5) - np.log(np.arange(1, parents + 1))
    weights /= weights.sum()
    mu = 1 / (weights**2).sum()
    c_size, c_path = (mu + 2) / (n + mu + 5), (4 + mu / n) / (n + 4 + 2 * mu / n)
    c_one = 2 / ((n + 1.3) ** 2 + mu)
    c_mu = min(1 - c_one, 2 * (mu - 2 + 1 / mu) / ((n + 2) ** 2 + mu))
    damping = 1 + 2 * max(0.0, np.sqrt((mu - 1) / (n + 1)) - 1) + c_size
    expected = np.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n**2))
    mean, C, path_size, path = begin / unit, np.eye(n), np.zeros(n), np.zeros(n)
    best, values = np.tile(begin, (16, 1)), np.full(16, -np.inf)
    curve, successes = np.zeros(generations), 0
    for generation in range(generations):
        eigenvalues, B = np.linalg.eigh(C)
        D = np.sqrt(np.maximum(eigenvalues, 1e-20))
        steps = (rng.standard_normal((population, n)) * D) @ B.T
        gains = (mean + size * steps) * unit
        score = scored(gains)
        successes += int(score.up.sum())
        order = np.argsort(score.value)[::-1][:parents]
        best, values = np.vstack([best, gains[order[:16]]]), np.append(values, score.value[order[:16]])
        top = np.argsort(values)[::-1][:16]
        best, values = best[top], values[top]
        curve[generation] = values[0]
        step = weights @ steps[order]
        mean = mean + size * step
        path_size = (1 - c_size) * path_size + np.sqrt(c_size * (2 - c_size) * mu) * (B @ ((B.T @ step) / D))
        norm = float(np.linalg.norm(path_size))
        moving = norm / np.sqrt(1 - (1 - c_size) ** (2 * generation + 2)) < (1.4 + 2 / (n + 1)) * expected
        path = (1 - c_path) * path + moving * np.sqrt(c_path * (2 - c_path) * mu) * step
        C = (1 - c_one - c_mu) * C + c_one * np.outer(path, path) + c_mu * (weights * steps[order].T) @ steps[order]
        size *= float(np.exp(min(1.0, c_size / damping * (norm / expected - 1))))
    return best, curve, successes


def plot(rows: list[Row], traces: Traces) -> Figure:
    """Draw average rewards of learning, the searches' best scores, and the tip's height under the best gains."""
    figure = Figure(figsize=(6.8, 8.6), layout="constrained")
    learning, scores, *angles = figure.subplots(4, 1, height_ratios=[1.3, 1.3, 1, 1])
    colours = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#777777", "#000000")
    for colour, features in zip(colours, FEATURES, strict=False):
        own = [
            trace["rewards"]
            for job, trace in traces.items()
            if job.startswith(f"learning,_{features}".replace(" ", "_"))
        ]
        own = [reward for reward in own if reward.size]
        for k, (low, middle, high) in enumerate(own):
            episodes = np.arange(1, len(middle) + 1)
            learning.plot(episodes, middle, color=colour, lw=1, label=features if k == 0 else None)
            learning.fill_between(episodes, low, high, color=colour, alpha=0.12, lw=0)
    learning.set(xlabel="episodes", ylabel="average reward")
    learning.set_title("linear Q-learning that did not overflow: median and quartiles over settings", fontsize=9)
    if learning.get_legend_handles_labels()[0]:
        learning.legend(fontsize=8)
    searches = [row for row in rows if row.part == "search"]
    for place, row in enumerate(searches):
        trace = traces[_study.slug(Job(f"search, {row.start}, {row.setting}"))]
        colour = colours[place % len(colours)]
        words = f"{row.start}: {row.setting}"
        scores.plot(np.arange(1, len(trace["scores"]) + 1), trace["scores"], color=colour, lw=1.2, label=words)
        axis = angles[STARTS.index(row.start)]
        t = 0.02 * np.arange(len(trace["th1"]))
        axis.plot(t, 0.5 * (np.cos(trace["th1"]) + np.cos(trace["th2"])), color=colour, lw=1.0, label=row.setting)
    scores.set(xlabel="generation", ylabel="best score")
    scores.legend(fontsize=6.5, ncols=2)
    for axis, start in zip(angles, STARTS, strict=True):
        axis.set(xlabel="time (s)", ylabel="height of the tip", ylim=(-1.1, 1.1))
        axis.set_title(f"best gains from {start}, 1 = upright, until the cart leaves the track", fontsize=9)
        if axis.get_legend_handles_labels()[0]:
            axis.legend(fontsize=6.5, ncols=2)
    for axis in (learning, scores, *angles):
        axis.grid(alpha=0.3)
    return figure


def summary(rows: list[Row], traces: Traces) -> RenderableType:
    """Condense the table: successes of learning by features, and what each search found."""
    learned = Table(title="Linear Q-learning from the side")
    for heading in ("features", "trainings", "overflowed", "episodes", "ended upright", "longest upright (s)"):
        learned.add_column(heading, justify="left" if heading == "features" else "right")
    for features in FEATURES:
        own = [row for row in rows if row.part == "learning" and row.setting.startswith(features)]
        if own:
            learned.add_row(
                features,
                str(len(own)),
                str(sum(row.outcome == "diverged" for row in own)),
                f"{sum(row.episodes for row in own):,}",
                str(sum(row.successes for row in own)),
                f"{max(row.longest for row in own):.2f}",
            )
    searched = Table(title="Search over gains")
    for heading in ("start", "law", "gains tried", "of them up", "the best", "longest upright (s)", "from starts near"):
        searched.add_column(heading, justify="left" if heading in ("start", "law") else "right")
    for row in rows:
        if row.part == "search":
            rate = wilson(row.near, _LONG)
            searched.add_row(
                row.start, row.setting, f"{row.episodes:,}", f"{row.successes:,}", row.outcome, f"{row.longest:.2f}",
                f"{rate.share:.1%} \\[{rate.low:.1%}, {rate.high:.1%}]",
            )  # fmt: skip
    return Group(learned, searched)


if __name__ == "__main__":
    _study.main("studies.linear_swing_up")
