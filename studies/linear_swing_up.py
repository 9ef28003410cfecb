"""Can a linear controller swing the double pendulum up?

Method: linear Q-learning as the report tried it, from (π/2, π/2) at rest for 1000 samples, over ε, α, action set,
initial weights and features; then a search over gains: force K·s, saturated, or ±40 N by its sign, angles as they are
or to the nearest turn, from the side and from hanging at rest.  Half of the first gains are drawn anywhere, half among
those that hold upright; CMA-ES goes on from the best.  The widest is simulated again with a quarter of the integration
step, as the motion is chaotic, and from 1000 starts within ±0.05 rad.  Up is within 0.2 rad for a second.

Finding: Q-learning never holds the links up for a second (0 of 432 trainings, 146 225 episodes).  But a linear
controller can: from the side one gain of 90 112, saturated and with angles to the nearest turn, has both links up after
1.78 s and keeps them there, and from hanging every kind of law can; from starts near, at best 5.8 % succeed.  From
``--seed 1``, kept in docs/results/linear_swing_up.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure
from scipy.linalg import solve_discrete_are

import dpend
from dpend.controller import Act
from dpend.params import Array
from rl import LinearQLearning, Outcome
from rl.features import CART_FEATURES, TABLE1
from rl.linear_q import REPORT_FORCES

from . import _runner
from ._estimates import QUARTILES, share
from ._figures import COLOURS, band, legend_above, mosaic, palette
from ._plant import Plant, rig_of
from ._runner import Positive, Report, Result, Table
from ._tables import sheet

MINUTES = 2

EPSILONS = (0.01, 0.1, 0.3)
ALPHAS = (1e-6, 1e-5, 1e-4, 1e-3)
FORCES = {"the report's": REPORT_FORCES, "0, ±10, ±40": (0.0, 10.0, -10.0, 40.0, -40.0), "±40": (40.0, -40.0)}
WEIGHTS = {"zero": 0.0, "N(0, 1)": 1.0}
FEATURES: Mapping[str, tuple[float, ...] | None] = {
    "all 18": (1.0,) * len(TABLE1),
    "without the cart's six": tuple(0.0 if i in CART_FEATURES else 1.0 for i in range(len(TABLE1))),
    "scaled": None,
}
"""Scales of the features; None for those of the tuned learner."""

LAWS = {"K·s": False, "sign of K·s": True}
STATES = {"angles as they are": False, "nearest turn": True}
STARTS = ("side", "hanging")
_NEAR, _STARTS_NEAR = 0.05, 16
_ROWS = 4096


@dataclass(frozen=True, kw_only=True)
class Options(_runner.Options):
    """Options of the command line."""

    needs = ("force_limit", "ideal")

    trainings: Positive = 2  # Seeds of each setting of Q-learning.
    training_episodes: Positive = 500  # Budget of each training.
    candidates: Positive = 49_152  # Random gains that each search begins with, half of them such as hold upright.
    generations: Positive = 40  # Generations of each evolution strategy.
    strategies: Positive = 4  # Evolution strategies in each search, from its best random gains.


@dataclass(frozen=True, kw_only=True)
class Job:
    """Q-learning with one choice of features and action set, or a search over the gains of one law from one start."""

    part: str  # learning or search; what belongs to the other is empty or zero
    seed: int
    start: str = "side"
    features: str = ""
    forces: str = ""
    trainings: int = 0  # seeds of each setting of Q-learning
    budget: int = 0  # episodes of each training
    law: str = ""
    state: str = ""
    candidates: int = 0
    generations: int = 0
    strategies: int = 0
    starts_near: int = 0  # fresh starts on which the best gain is tried
    elsewhere: Plant | None = None


class LinearLaw:
    r"""Law :math:`u = K s` or :math:`u = F\,\mathrm{sgn}(K s)` with gains ``(6,)``, or ``(n, 6)`` one a row.

    ``law`` is one of :data:`LAWS`; ``state``, one of :data:`STATES`, says what :math:`s` is.  The limit of both is
    ``force``, N.
    """

    name = "linear law"

    def __init__(self, K: Array, law: str, state: str, force: float) -> None:
        self.K, self.sign, self.nearest, self.force = K, LAWS[law], STATES[state], force

    def start(self, n: int, rng: np.random.Generator) -> Act:
        """Return the law for ``n`` runs."""
        K = np.broadcast_to(self.K, (n, 6))

        def act(t: float, y: Array) -> Array:
            u = np.einsum("ij,ij->i", K, dpend.nearest_upright(y) if self.nearest else y)
            return self.force * np.sign(u) if self.sign else np.clip(u, -self.force, self.force)

        return act


def _task(start: str, angle_spread: float = 0.0) -> dpend.SwingUp:
    return dpend.SwingUp(start=start, angle_spread=angle_spread)


def jobs(options: Options) -> list[Job]:
    """List the work: the searches, and Q-learning by features and action set."""
    trainings, budget = (1, 5) if options.quick else (options.trainings, options.training_episodes)
    few = 64, 2, 1, 20
    sizes = few if options.quick else (options.candidates, options.generations, options.strategies, 1000)
    named = dict(zip(("candidates", "generations", "strategies", "starts_near"), sizes, strict=True))
    search = [
        Job(part="search", seed=options.seed, start=start, law=law, state=state, elsewhere=options.elsewhere, **named)
        for start in STARTS for law in LAWS for state in STATES
    ]  # fmt: skip
    learning = [
        Job(part="learning", seed=options.seed, features=each, forces=forces, trainings=trainings, budget=budget,
            elsewhere=options.elsewhere)
        for each in FEATURES for forces in FORCES
    ]  # fmt: skip
    return [*search[:1], *learning[:1]] if options.quick else [*search, *learning]


def run(job: Job) -> Result:
    """Train, or search: a row for each training, or for the best gain."""
    return _learn(job) if job.part == "learning" else _search(job)


def _learn(job: Job) -> Result:
    rig, rows, curves = rig_of(job.elsewhere), [], []
    scales = FEATURES[job.features] or LinearQLearning.tuned(rig).scales
    for epsilon, alpha, (weights, init_std) in itertools.product(EPSILONS, ALPHAS, WEIGHTS.items()):
        learner = LinearQLearning(
            rig, task=_task(job.start), scales=scales, forces=FORCES[job.forces], epsilon=epsilon,
            alpha=alpha, init_std=init_std, max_episodes=job.budget,
        )  # fmt: skip
        for k in range(job.trainings):
            training = learner.train([job.seed, 12, k])
            upright = training.curve["upright"]
            rows.append(
                {"epsilon": epsilon, "alpha": alpha, "weights": weights, "training": k,
                 "outcome": training.outcome.name.lower().replace("_", " "), "episodes": training.cost.episodes,
                 "successes": int((upright >= round(learner.task.hold / rig.sample_time)).sum()),
                 "longest": round(float(upright.max(initial=0) * rig.sample_time), 4), "near": 0}
            )  # fmt: skip
            if training.outcome is Outcome.BUDGET_SPENT:
                curves.append(training.curve["reward"] / training.curve["length"])
    return Result(rows, {"rewards": np.quantile(curves, QUARTILES, axis=0)} if curves else {})


class Score(NamedTuple):
    """How far each of some roll-outs came."""

    value: Array
    """What a search climbs: how near to upright at rest it came, how long it stayed on the track and up; success."""
    longest: Array  # longest time upright without a break, s
    up: npt.NDArray[np.bool_]  # whether it ended with a second upright


def _scores(rig: dpend.Rig, K: Array, x0: Array, law: str, state: str, horizon: int) -> Score:
    """Roll every gain ``(n, 6)`` out from its start ``(n, 6)``."""
    task, force = _task("hanging"), float(rig.force_limit)
    longest, final = np.zeros(len(K)), np.zeros(len(K))
    away_least, lasted = np.full(len(K), np.inf), np.zeros(len(K))
    for first in range(0, len(K), _ROWS):
        rows = np.arange(first, min(first + _ROWS, len(K)))
        stepper = dpend.Stepper(rig, len(rows))
        x = stepper.reset(x0[rows])
        held = np.zeros(len(rows))
        act = LinearLaw(K[rows], law, state, force).start(len(rows), np.random.default_rng(0))
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
                act = LinearLaw(K[rows], law, state, force).start(len(rows), np.random.default_rng(0))
    up = final >= task.hold - 1e-9
    stayed = np.minimum(longest, 1.0) + longest / (horizon * rig.sample_time)
    return Score(np.exp(-away_least) + 0.2 * lasted + stayed + up, longest, up)


def _holding(rig: dpend.Rig, n: int, rng: np.random.Generator) -> Array:
    """Draw gains ``(n, 6)`` that hold upright, for only such a law can stay up: regulators of random weights, moved.

    Half of them nearly balance both angles, so that the force is not at its limit where the links lean alike.
    """
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


def _search(job: Job) -> Result:
    law, state, candidates, generations = job.law, job.state, job.candidates, job.generations
    rig = rig_of(job.elsewhere)
    force = float(rig.force_limit)
    code = [list(LAWS).index(law), list(STATES).index(state), STARTS.index(job.start)]
    rng = np.random.default_rng([job.seed, 13, *code])
    exact, near = _task(job.start), _task(job.start, _NEAR)
    at_rest = exact.starts(rng, 1, rig)[0]

    directions = rng.standard_normal((candidates // 2, 6)) / (1.0, 1.0, 1.0, 1.0, 0.3, 0.3)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    sizes = np.exp(rng.uniform(np.log(3.0), np.log(1000.0), (len(directions), 1)))
    gains = np.vstack([directions * sizes, _holding(rig, candidates - len(directions), rng)])

    def from_rest(K: Array) -> Score:
        return _scores(rig, K, np.tile(at_rest, (len(K), 1)), law, state, exact.steps)

    def from_near(K: Array) -> Score:
        """Score by the share of some starts near that succeed, and by what each came to."""
        each = _scores(rig, np.repeat(K, _STARTS_NEAR, axis=0), np.tile(around, (len(K), 1)), law, state, exact.steps)
        value, longest, up = (part.reshape(len(K), _STARTS_NEAR) for part in each)
        return Score(up.mean(axis=1) + 0.1 * value.mean(axis=1), longest.max(axis=1), np.asarray(up.any(axis=1)))

    first = from_rest(gains)
    tried, successes = [len(gains)], [int(first.up.sum())]
    ranks = np.argsort(first.value)[::-1]
    held = ranks[ranks >= len(directions)]
    pool, curves = [gains[ranks[:64]]], []
    for k in range(job.strategies):  # from the best of all, and from the best of those that hold upright
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
            dpend.simulate(rig.replace(substeps=substeps), LinearLaw(gain, law, state, force), at_rest, task=exact)
            for substeps in (rig.substeps, 4 * rig.substeps)
        )
        words = "up" if alone.success and fine.success else "up by rounding" if alone.success else "not up"
        if run is None or (words != outcome and outcome != "up" and words != "not up"):
            K, run, outcome = gain, alone, words
        if outcome == "up":
            break
    assert run is not None
    starts = near.starts(np.random.default_rng([job.seed, 14]), job.starts_near, rig)
    saved = dpend.simulate_many(rig, LinearLaw(K, law, state, force), starts, task=near).success
    row = {"epsilon": 0.0, "alpha": 0.0, "weights": "", "training": 0, "outcome": outcome, "episodes": sum(tried),
           "successes": sum(successes), "longest": round(float(from_rest(finalists).longest.max()), 4),
           "near": int(saved.sum())}  # fmt: skip
    return Result([row], {"scores": np.max(curves, axis=0), "angles": run.x[:, 1:3], "gain": K, "saved": saved})


def _evolve(
    scored: Callable[[Array], Score], begin: Array, population: int, generations: int, rng: np.random.Generator
) -> tuple[Array, Array, int]:
    """Return the 16 best gains, best scores by generation, and successes of CMA-ES in units of the first gain.

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


def report(table: Table) -> Report:
    """Draw average rewards, best scores and the tip's height under the best gains; tabulate what was found."""
    learned = [
        {"features": features, "trainings": len(own), "overflowed": sum(row.outcome == "diverged" for row in own),
         "episodes": sum(row.episodes for row in own), "ended upright": sum(row.successes for row in own),
         "longest upright, s": max(row.longest for row in own)}
        for features in FEATURES if (own := list(table.lines(features=features)))
    ]  # fmt: skip
    searched = [
        {"start": row.start, "law": f"{row.law}, {row.state}", "gains tried": row.episodes, "of them up": row.successes,
         "the best": row.outcome, "longest upright, s": row.longest, "fresh starts near": row.starts_near,
         "of them up, %": share(row.near, row.starts_near)}
        for row in table.lines(part="search")
    ]  # fmt: skip
    form, brief = {"longest upright, s": ".2f"}, ("start", "law", "of them up", "the best", "of them up, %")
    titles = "Linear Q-learning from the side", "Search over gains"
    tables = [sheet(titles[0], learned, form), sheet(titles[1], searched, form, brief=brief)]
    return Report(figures=_overview(table), tables=tables)


def _overview(table: Table) -> Figure:
    layout = [["learning"] * len(STARTS), *([f"{row} {start}" for start in STARTS] for row in ("score", "height"))]
    figure, axes = mosaic(layout, height=7.2, height_ratios=[1, 1.1, 1])
    learning = axes["learning"]
    for colour, features in zip(COLOURS, FEATURES, strict=False):
        for k, rewards in enumerate(table.arrays("rewards", features=features)):
            episodes = np.arange(1, rewards.shape[1] + 1)
            band(learning, episodes, rewards, (colour, "", "-"), features if k == 0 else None)
    learning.set(xlabel="episodes", ylabel="average reward")
    laws = palette(f"{row.law}, {row.state}" for row in table.lines(part="search"))
    for row in table.lines(part="search"):
        words, best, angles = f"{row.law}, {row.state}", *(table.array(a, job=row.job) for a in ("scores", "angles"))
        colour, _, line = laws[words]
        axes[f"score {row.start}"].plot(np.arange(1, len(best) + 1), best, color=colour, ls=line, label=words)
        t = table.rig.sample_time * np.arange(len(angles))
        axes[f"height {row.start}"].plot(t, 0.5 * np.cos(angles).sum(axis=1), color=colour, ls=line, lw=1)
    legend_above(learning, 3, "linear Q-learning that did not overflow: median and quartiles over settings")
    for start in STARTS:
        axes[f"score {start}"].set(xlabel="generation", ylim=(0, None))
        legend_above(axes[f"score {start}"], 1, f"search over gains, from {start}")
        axes[f"height {start}"].set(
            xlabel="time (s)", ylim=(-1.1, 1.1), title="best gains, until the cart leaves the track"
        )
    axes[f"score {STARTS[0]}"].set_ylabel("best score")
    axes[f"height {STARTS[0]}"].set_ylabel("height of the tip (1: upright)")
    return figure


if __name__ == "__main__":
    _runner.main("studies.linear_swing_up")
