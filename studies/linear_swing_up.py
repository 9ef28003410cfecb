"""Can a linear controller swing the double pendulum up?

Method: first linear Q-learning as the report tried it, from (π/2, π/2) at rest for 1000 samples, over ε, α, the action
set, initial weights and features; counted are episodes that end with both links up for a second, within 0.2 rad.  Then
the claim that no linear controller can is put to a direct search over gains: force K·s and force ±40 N by the sign of
K·s, with s the state itself, as in the action part of Table 1, or its angles taken to the nearest turn, from the side
and from hanging; random gains, then evolution strategies (CMA-ES) that start from the best of them.  The best gain of
each search is simulated again, as a controller, for the report's 1000 samples, and from 1000 starts near.

Finding: PENDING
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

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
_SCALES = np.array([1.0, 1.0, 1.0, 1.0, 0.3, 0.3])  # gains are drawn per unit of these
_LONG, _NEAR = 1000, 0.05
_POPULATION, _ROWS = 512, 4096


@dataclass(frozen=True, kw_only=True)
class Options(_study.Options):
    """What can be told on the command line."""

    trainings: int = 2
    """Seeds of each setting of Q-learning."""
    training_episodes: int = 500
    """Budget of each training."""
    candidates: int = 65_536
    """Random gains that each search begins with."""
    generations: int = 60
    """Generations of each evolution strategy, 512 gains each."""
    strategies: int = 6
    """Evolution strategies in each search, from its best random gains."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("trainings", "training_episodes", "candidates", "generations", "strategies"):
            if getattr(self, name) < 1:
                raise ValueError(f"--{name.replace('_', '-')} must be at least 1; got {getattr(self, name)}.")


@dataclass(frozen=True, kw_only=True)
class Row:
    """One training, or the best gain of one search."""

    part: str
    """learning or search."""
    setting: str
    start: str
    training: int
    outcome: str
    """How the training ended; for a search, whether its gain succeeds from the exact start in 1000 samples."""
    episodes: int
    """Learning episodes, or gains tried."""
    successes: int
    """Learning episodes that ended upright, or gains that did so in the search's horizon."""
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
    force : float
        Largest force, or that of the sign, N.
    sign : bool
        Whether the sign is taken.
    nearest : bool
        Whether angles are taken to the nearest turn.
    """

    name = "linear law"

    def __init__(self, K: Array, force: float, *, sign: bool, nearest: bool) -> None:
        self.K, self.force, self.sign, self.nearest = K, force, sign, nearest

    def start(self, n: int, rng: np.random.Generator) -> Act:
        """Give the law for ``n`` runs."""
        K = np.broadcast_to(self.K, (n, 6))

        def act(t: float, y: Array) -> Array:
            u = np.einsum("ij,ij->i", K, dpend.nearest_upright(y) if self.nearest else y)
            return self.force * np.sign(u) if self.sign else np.clip(u, -self.force, self.force)

        return act


def _task(start: str, spread: float = 0.0) -> dpend.SwingUp:
    return dpend.SwingUp(start=start, spread=spread)


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


def _scores(
    K: Array, start: str, sign: bool, nearest: bool, horizon: int
) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
    """Roll every gain ``(n, 6)`` out; give scores, the longest time upright, and whether it ends with a second upright.

    The score is that time in s, at most 1, and then how near to upright at rest it came, and how long it stayed on the
    track: what leads a search on where none is up yet.
    """
    rig = dpend.rig("gustafsson2016")
    task = _task(start)
    force = float(np.max(rig.force_limit))
    longest, final = np.zeros(len(K)), np.zeros(len(K))
    nearest_yet, lasted = np.full(len(K), np.inf), np.zeros(len(K))
    for first in range(0, len(K), _ROWS):
        rows = np.arange(first, min(first + _ROWS, len(K)))
        stepper = dpend.Stepper(rig, len(rows))
        x = stepper.reset(task.starts(np.random.default_rng(0), len(rows), rig))
        held = np.zeros(len(rows))
        for k in range(horizon):
            act = LinearLaw(K[rows], force, sign=sign, nearest=nearest).start(len(rows), np.random.default_rng(0))
            x = stepper.step(act(k * rig.sample_time, x))
            on = task.ended(x, rig) == 0
            held = np.where(task.upright(x) & on, held + rig.sample_time, 0.0)
            longest[rows] = np.maximum(longest[rows], held)
            final[rows] = held
            away = np.abs(dpend.wrap(x[:, 1:3])).sum(axis=1) + 0.15 * np.abs(x[:, 4:]).sum(axis=1)
            nearest_yet[rows] = np.minimum(nearest_yet[rows], np.where(on, away, np.inf))
            lasted[rows] = np.where(on, (k + 1) / horizon, lasted[rows])
            if on.mean() < 0.7:  # most gains leave the track at once
                rows, held, x = rows[on], held[on], x[on]
                if not len(rows):
                    break
                stepper = dpend.Stepper(rig, len(rows))
                stepper.reset(x)
    scores = np.minimum(longest, 1.0) + np.exp(-nearest_yet) + 0.2 * lasted + (final >= task.hold - 1e-9)
    return scores, longest, final >= task.hold - 1e-9


def _regulators(n: int, rng: np.random.Generator) -> Array:
    """Draw gains ``(n, 6)`` that hold upright: regulators of random weights, for only such a law can stay up."""
    rig = dpend.rig("gustafsson2016")
    A, B = dpend.discretize(*dpend.linearize(rig.params), rig.sample_time)
    gains: list[Array] = []
    while len(gains) < n:
        *q, r = np.exp(rng.uniform(np.log(1e-3), np.log(1e3), 7))
        try:
            P = solve_discrete_are(A, B, np.diag(q), np.array([[r]]))
        except ValueError:  # a few weights are too far apart for the solver
            continue
        gains.append(-((B.T @ P @ A) / (r + B.T @ P @ B))[0])
    return np.array(gains)


def _search(setting: str, options: Options) -> Result:
    start, law, state = setting.split(", ")
    sign, nearest = LAWS[law], STATES[state]
    candidates, generations, strategies = (
        (64, 2, 1) if options.quick else (options.candidates, options.generations, options.strategies)
    )
    horizon = 100 if options.quick else 500
    code = [list(LAWS).index(law), list(STATES).index(state), STARTS.index(start)]
    rng = np.random.default_rng([options.seed, 13, *code])

    def gains(points: Array) -> Array:
        """Give gains for points, which have units of about one size."""
        return points / _SCALES

    regulators = _regulators(candidates // 8, rng) * _SCALES
    directions = rng.standard_normal((candidates - len(regulators), 6))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = directions * np.exp(rng.uniform(np.log(3.0), np.log(1000.0), (len(directions), 1)))
    points = np.vstack([points, regulators])

    def scored(points: Array) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
        return _scores(gains(points), start, sign, nearest, horizon)

    scores, longest, up = scored(points)
    tried, successes = candidates, int(up.sum())
    best = points[np.argmax(scores)], float(scores.max()), float(longest[np.argmax(scores)])
    curves = [np.sort(scores)[::-1][:1]]
    ranks = np.argsort(scores)[::-1]
    held = ranks[ranks >= len(directions)]  # half of the strategies start from gains that hold upright
    for k in range(strategies):
        begin = points[ranks[k // 2] if k % 2 == 0 else held[k // 2]]
        found, curve, count = _evolve(scored, begin, 0.3 * float(np.linalg.norm(begin)) / np.sqrt(6), generations, rng)
        tried += generations * _POPULATION
        successes += count
        curves.append(curve)
        if found[1] > best[1]:
            best = found
    K = gains(best[0])
    rig = dpend.rig("gustafsson2016")
    law_ = LinearLaw(K, float(np.max(rig.force_limit)), sign=sign, nearest=nearest)
    task = _task(start)
    run = dpend.simulate(rig, law_, task.starts(np.random.default_rng(0), 1, rig)[0], task=task)
    near = _task(start, _NEAR)
    starts = near.starts(np.random.default_rng([options.seed, 14]), 20 if options.quick else _LONG, rig)
    held = _longest(run.x, task) * rig.sample_time
    row = Row(
        part="search",
        setting=f"{law}, {state}",
        start=start,
        training=0,
        outcome="up" if run.success else "not up",
        episodes=tried,
        successes=successes,
        longest=round(held, 4),
        near=int(dpend.simulate_many(rig, law_, starts, task=near).success.sum()),
        gain=" ".join(f"{k:.17g}" for k in K),
    )
    best_so_far = np.maximum.accumulate(np.max([np.resize(c, generations) if len(c) > 1 else np.full(generations, c[0])
                                                for c in curves], axis=0))  # fmt: skip
    return Result([row], {"scores": best_so_far, "th1": run.x[:, 1], "th2": run.x[:, 2]})


def _longest(x: Array, task: dpend.SwingUp) -> int:
    held = best = 0
    for up in task.upright(x):
        held = held + 1 if up else 0
        best = max(best, held)
    return best


def _evolve(
    scored: Callable[[Array], tuple[Array, Array, npt.NDArray[np.bool_]]],
    begin: Array,
    size: float,
    generations: int,
    rng: np.random.Generator,
) -> tuple[tuple[Array, float, float], Array, int]:
    """Maximise by CMA-ES; give the best point, score and time upright, best scores by generation, and successes.

    Source: N. Hansen, *The CMA evolution strategy: a tutorial*, 2016.
    """
    n, parents = len(begin), _POPULATION // 2
    weights = np.log(parents + 0.5) - np.log(np.arange(1, parents + 1))
    weights /= weights.sum()
    mu = 1 / (weights**2).sum()
    c_size, c_path = (mu + 2) / (n + mu + 5), (4 + mu / n) / (n + 4 + 2 * mu / n)
    c_one = 2 / ((n + 1.3) ** 2 + mu)
    c_mu = min(1 - c_one, 2 * (mu - 2 + 1 / mu) / ((n + 2) ** 2 + mu))
    damping = 1 + 2 * max(0.0, np.sqrt((mu - 1) / (n + 1)) - 1) + c_size
    expected = np.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n**2))
    mean, C, path_size, path = begin.copy(), np.eye(n), np.zeros(n), np.zeros(n)
    best, curve, successes = (begin, -np.inf, 0.0), np.zeros(generations), 0
    for generation in range(generations):
        eigenvalues, B = np.linalg.eigh(C)
        D = np.sqrt(np.maximum(eigenvalues, 1e-20))
        steps = (rng.standard_normal((_POPULATION, n)) * D) @ B.T
        points = mean + size * steps
        scores, longest, up = scored(points)
        successes += int(up.sum())
        order = np.argsort(scores)[::-1][:parents]
        if scores[order[0]] > best[1]:
            best = points[order[0]], float(scores[order[0]]), float(longest[order[0]])
        curve[generation] = best[1]
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


def summary(rows: list[Row]) -> RenderableType:
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
    for heading in (
        "start",
        "law",
        "gains tried",
        "up at 10 s",
        "best, 20 s",
        "longest upright (s)",
        "from starts near",
    ):
        searched.add_column(heading, justify="left" if heading in ("start", "law") else "right")
    for row in rows:
        if row.part == "search":
            rate = wilson(row.near, _LONG if row.near <= _LONG else row.near)
            searched.add_row(
                row.start, row.setting, f"{row.episodes:,}", f"{row.successes:,}", row.outcome, f"{row.longest:.2f}",
                f"{rate.share:.1%} \\[{rate.low:.1%}, {rate.high:.1%}]",
            )  # fmt: skip
    return Group(learned, searched)


if __name__ == "__main__":
    _study.main("studies.linear_swing_up")
