r"""Gaussian QAC, the report's Algorithm 2: an actor-critic with a Gaussian policy, as published and tuned.

The actor draws :math:`a \sim \mathcal N(\varphi(s)^\top v, \sigma^2)`, the critic is
:math:`\hat q(s, a) = x(s, a)^\top w`, and every step does

.. math::
    v \leftarrow v + \alpha \frac{(a_t - \mu(s_t))\,\varphi(s_t)}{\sigma^2}\,\hat q(s_t, a_t), \qquad
    w \leftarrow w + \beta\,\bigl(r_{t+1} + \gamma\,\hat q(s_{t+1}, a_{t+1}) - \hat q(s_t, a_t)\bigr)\,x(s_t, a_t).

``docs/gaussian-qac.md`` lists what the report leaves open, and the numbered deviations of the tuned variant.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba.np.unsafe.ndarray import to_fixed_tuple

from dpend.arguments import checked_whole
from dpend.controller import Act
from dpend.kernels import compiled, inline, sample, wrap_angle
from dpend.params import Array, Coefficients
from dpend.provenance import versions
from dpend.rig import Rig, single_rig
from dpend.suggest import suggests
from dpend.tasks import Balance

from . import features
from .features import quadratic_features, quadratic_form
from .linear_q import Outcome
from .policies import GainPolicy

INDICATORS = {"none": 0, "signs": 3, "cells": 8}
"""Further features of the state by name, and their number: the signs of position and angles, or each combination."""

_STREAM = (1968,)  # sets learning apart from starts drawn with the same seed
_CHUNK = 500  # episodes between two looks at the keyboard and the progress bar
_OVERFLOW = 1e100  # weights beyond it have diverged; the next product would still be a number


class TableOneMean:
    r"""Law :math:`u = \varphi(s)^\top v`, the mean of Algorithm 2's policy over Table 1's twelve features of the state.

    Parameters
    ----------
    v : ndarray (12 + k,)
        Weights of the features, then of the ``k`` indicators.
    indicators : {"none", "signs", "cells"}
        Which of :data:`INDICATORS` take part.
    """

    name = "mean of Gaussian QAC"

    def __init__(self, v: Array, indicators: str) -> None:
        self.v = v
        self.indicators = indicators

    def start(self, n: int, rng: np.random.Generator) -> Act:
        """Return the law for ``n`` runs."""
        value_features, v, indicators = features.make_value_features(), self.v, self.indicators
        return lambda t, y: np.einsum("i,ij->j", v, np.stack([*value_features(y.T), *_indicators(y, indicators)]))


def _indicators(y: Array, indicators: str) -> list[Array]:
    positive = [y[:, 0] > 0, wrap_angle(y[:, 1]) > 0, wrap_angle(y[:, 2]) > 0]
    if indicators == "none":
        return []
    if indicators == "signs":
        return [sign.astype(np.float64) for sign in positive]
    cell = 4 * positive[0] + 2 * positive[1] + positive[2]
    return [(cell == k).astype(np.float64) for k in range(8)]


@suggests
@dataclass(frozen=True, kw_only=True)
class Deviations:
    r"""What the tuned learner does otherwise than Algorithm 2; ``docs/gaussian-qac.md`` numbers and explains them.

    States and action are divided by ``scales``; :math:`z = (s, a)` and :math:`v` are in these units.

    Parameters
    ----------
    scales : sequence of 7 floats
        Size of each state and of the action.
    critic : {"quadratic", "table 1"}
        Features of the critic: all products of two of :math:`z` and a constant, or the report's eighteen.
    state_costs : sequence of 6 floats, optional
        Cost :math:`\rho\sum_i q_i s_i^2 + a^2` of a sample; None for the report's cost, that of the task.
    least_squares : bool
        Whether the critic solves LSTD(0), or goes one step for each new sample.
    replay : int
        Latest samples on which LSTD(0) is solved; 0 for those of the update's own episodes.
    closed_form : bool
        Whether the actor's gradient is the mean over all actions, or over those that were taken.
    natural : bool
        Whether the actor follows the natural gradient.
    norm_cap : float
        Longest step of the actor.
    gamma_start, gamma_updates : float
        The discount factor is :math:`\gamma - (\gamma - \gamma_0)e^{-k/\tau}` in update :math:`k`.
    angle_cut : float, optional
        An episode is cut where a link leans more, rad; None for where it fails.
    bootstrap : bool
        Whether a cut episode's last sample still adds :math:`\gamma\hat q`.
    episodes : int
        Episodes in an update.
    relax_from, relax_to : int
        Updates between which :math:`\rho` falls from 1 and :math:`\sigma` from its first value, geometrically.
    relaxed_cost : float
        :math:`\rho` at the end; 1 to keep it.
    relaxed_sigma : float
        :math:`\sigma` at the end, as a share of the first; 1 to keep it.
    """

    scales: Sequence[float] = (0.5, 0.1, 0.1, 1.0, 0.5, 0.5, 40.0)
    critic: str = "quadratic"
    state_costs: Sequence[float] | None = (1.0, 1.0, 1.0, 0.1, 0.1, 0.1)
    least_squares: bool = True
    replay: int = 1200
    closed_form: bool = True
    natural: bool = True
    norm_cap: float = 0.218
    gamma_start: float = 0.4
    gamma_updates: float = 26.6
    angle_cut: float | None = 0.254
    bootstrap: bool = True
    episodes: int = 2
    relax_from: int = 80
    relax_to: int = 160
    relaxed_cost: float = 1e-3
    relaxed_sigma: float = 0.176

    def __post_init__(self) -> None:
        if self.critic not in ("quadratic", "table 1"):
            raise ValueError(f'critic must be "quadratic" or "table 1"; got {self.critic!r}.')
        if len(self.scales) != 7 or not all(math.isfinite(scale) and scale > 0 for scale in self.scales):
            raise ValueError(f"scales must be 7 finite numbers greater than 0; got {self.scales!r}.")
        costs = self.state_costs
        if costs is not None and (len(costs) != 6 or not all(math.isfinite(q) and q >= 0 for q in costs)):
            raise ValueError(f"state_costs must be 6 finite numbers, at least 0, or None; got {costs!r}.")
        for name, good, wanted in (
            ("replay", self.replay >= 0, "at least 0"),
            ("norm_cap", self.norm_cap > 0, "greater than 0"),
            ("gamma_start", 0 < self.gamma_start <= 1, "above 0 and at most 1"),
            ("gamma_updates", 0 < self.gamma_updates < math.inf, "finite and greater than 0"),
            ("angle_cut", self.angle_cut is None or 0 < self.angle_cut <= math.pi / 2, "above 0 and at most pi/2"),
            ("episodes", self.episodes >= 1, "at least 1"),
            ("relax_from", self.relax_from >= 0, "at least 0"),
            ("relax_to", self.relax_to > self.relax_from, f"greater than relax_from = {self.relax_from}"),
            ("relaxed_cost", 0 < self.relaxed_cost < math.inf, "finite and greater than 0"),
            ("relaxed_sigma", 0 < self.relaxed_sigma < math.inf, "finite and greater than 0"),
        ):
            if not good:
                raise ValueError(f"{name} must be {wanted}; got {getattr(self, name)!r}.")


@dataclass(frozen=True, kw_only=True, eq=False)
class QACTraining:
    """What a training gave, and what it cost.

    Attributes
    ----------
    policy : GainPolicy or TableOneMean
        The mean of the policy as it ended.
    outcome : Outcome
        How it ended; ``converged`` is short for one of them.
    v, w : ndarray
        Weights of actor and critic as they ended, finite even where they diverged.
    episodes, steps : int
        Learning episodes and the samples in them.
    test_steps : int
        Samples spent on tests: none.
    lengths, rewards : ndarray (episodes,)
        Samples and total reward of each learning episode.
    succeeded : ndarray (episodes,) of bool
        Which of them lasted to the end of the task.
    weights : ndarray (episodes, 12 + k)
        The published learner's v after each learning episode; none for the tuned one.
    gains : ndarray (m, 6)
        The tuned learner's gain after each update, N per unit of each state; none for the published one.
    updated : ndarray (m,)
        Episodes up to each of them.
    seconds : float
        Wall time.
    """

    policy: GainPolicy | TableOneMean
    outcome: Outcome
    v: Array
    w: Array
    episodes: int
    steps: int
    test_steps: int = 0
    lengths: npt.NDArray[np.int64]
    rewards: Array
    succeeded: npt.NDArray[np.bool_]
    weights: Array
    gains: Array
    updated: npt.NDArray[np.int64]
    seconds: float

    @property
    def converged(self) -> bool:
        """Whether the learner met its criterion of convergence."""
        return self.outcome is Outcome.CONVERGED


@suggests
@dataclass(frozen=True, kw_only=True)
class GaussianQAC:
    r"""Algorithm 2 of the report on a rig; or, where deviations are given, what they make of it.

    Algorithm 2 counts as converged after ``streak`` successful episodes in a row, which end it.  With deviations the
    budget is always spent, and converged means that so many in a row occurred.

    Parameters
    ----------
    rig : Rig
        An ideal one: no noise, delay or lag.
    task : Balance
        Starts, episode length, failure, and the costs whose negative is the reward.
    alpha : float
        Step size of the actor.
    beta : float
        Step size of the critic.
    sigma : float
        Standard deviation of the policy, N.
    gamma : float
        Discount factor; with deviations, the one at the end.
    indicators : {"none", "signs", "cells"}
        Further features of the state for actor and critic, see :data:`INDICATORS`.
    spread : float
        Standard deviation of the normal numbers that :math:`v_0` and :math:`w_0` are drawn from; zero for zeros.
    streak : int
        Successful episodes in a row that count as convergence.
    max_episodes : int
        Budget of learning episodes.
    deviations : Deviations, optional
        What is done otherwise.

    Raises
    ------
    ValueError
        If a number is out of its range, or the rig is not ideal.
    """

    rig: Rig = field(kw_only=False)
    task: Balance = Balance()  # noqa: RUF009  (frozen)
    alpha: float = 1e-4
    beta: float = 1e-4
    sigma: float = 1.0
    gamma: float = 0.99
    indicators: str = "none"
    spread: float = 0.0
    streak: int = 20
    max_episodes: int = 2000
    deviations: Deviations | None = None

    def __post_init__(self) -> None:
        _check(self)

    @classmethod
    def published(
        cls,
        rig: Rig,
        *,
        alpha: float = 1e-4,
        beta: float = 1e-4,
        variance: float = 1.0,
        spread: float = 0.0,
        indicators: str = "none",
        max_episodes: int = 2000,
    ) -> GaussianQAC:
        r"""Return the report's learner to the letter, with a choice of what the report tried.

        The cost is that of the code published with it, and link 1 alone falls.

        Parameters
        ----------
        rig : Rig
            The rig.
        alpha, beta : float
            Step sizes; the report tried values within 1e-8 and 1e-1.
        variance : float
            :math:`\sigma^2`, N²; the report tried values within 0.001 and 10.
        spread : float
            Standard deviation of the initial weights.
        indicators : {"none", "signs", "cells"}
            Further features.
        max_episodes : int
            Budget of learning episodes.
        """
        return cls(
            rig,
            task=Balance(criterion="report"),
            alpha=alpha,
            beta=beta,
            sigma=math.sqrt(variance),
            spread=spread,
            indicators=indicators,
            max_episodes=max_episodes,
        )

    @classmethod
    def tuned(cls, rig: Rig) -> GaussianQAC:
        """Return the learner with the deviations that ``docs/gaussian-qac.md`` numbers.

        The numbers were tuned on the preset ``gustafsson2016``; on another rig they are a start.

        Parameters
        ----------
        rig : Rig
            The rig.
        """
        return cls(rig, alpha=0.2, beta=0.03, sigma=11.36, max_episodes=400, deviations=Deviations())

    def train(self, seed: int | Sequence[int], *, progress: Callable[[int], None] | None = None) -> QACTraining:
        """Learn.

        Parameters
        ----------
        seed : int or sequence of int
            What initial weights, starts and actions are drawn from.
        progress : callable, optional
            Called with the number of episodes done so far, every now and then.

        Returns
        -------
        QACTraining
        """
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=_STREAM))
        learn = self._algorithm_2 if self.deviations is None else self._batches
        return learn(rng, seed if isinstance(seed, int) else list(seed), progress or (lambda episodes: None))

    def _algorithm_2(
        self, rng: np.random.Generator, seed: int | list[int], progress: Callable[[int], None]
    ) -> QACTraining:
        began = time.perf_counter()
        settings, coefficients = self._settings(), np.array(self.rig.params.coefficients(), dtype=np.float64)
        m = 12 + settings.indicators
        v, w = self.spread * rng.standard_normal(m), self.spread * rng.standard_normal(m + 6)
        lengths, rewards = np.zeros(self.max_episodes, dtype=np.int64), np.zeros(self.max_episodes)
        succeeded, history = np.zeros(self.max_episodes, dtype=np.bool_), np.zeros((self.max_episodes, m))
        outcome, episodes, streak = Outcome.BUDGET_SPENT, 0, 0
        while episodes < self.max_episodes:
            part = slice(episodes, min(episodes + _CHUNK, self.max_episodes))
            done, streak, finite = _run_episodes(
                v, w, settings, coefficients, streak, rng, lengths[part], rewards[part], succeeded[part], history[part]
            )
            episodes += done
            progress(episodes)
            if not finite or streak >= self.streak:
                outcome = Outcome.CONVERGED if finite else Outcome.DIVERGED
                break
        return QACTraining(
            policy=TableOneMean(v, self.indicators),
            outcome=outcome,
            v=v,
            w=w,
            episodes=episodes,
            steps=int(lengths[:episodes].sum()),
            lengths=lengths[:episodes],
            rewards=rewards[:episodes],
            succeeded=succeeded[:episodes],
            weights=history[:episodes],
            gains=np.zeros((0, 6)),
            updated=np.zeros(0, dtype=np.int64),
            seconds=time.perf_counter() - began,
        )

    def _batches(self, rng: np.random.Generator, seed: int | list[int], progress: Callable[[int], None]) -> QACTraining:
        began = time.perf_counter()
        d = self.deviations or Deviations()
        critic = _Critic(d, self.beta)
        settings, coefficients = self._settings(), np.array(self.rig.params.coefficients(), dtype=np.float64)
        scales = np.asarray(d.scales, dtype=np.float64)
        to_gain = -scales[6] / scales[:6]
        updates = self.max_episodes // d.episodes
        v, gains = np.zeros(6), np.zeros((updates, 6))
        lengths, rewards, succeeded = [], [], []
        z, following, last = np.zeros((0, 7)), np.zeros((0, 6)), np.zeros(0, dtype=np.bool_)
        costs = np.zeros(0)
        taken, after = np.zeros((self.task.steps, 7)), np.zeros((self.task.steps, 6))
        finite = True
        for update in range(updates):
            gamma = self.gamma - (self.gamma - d.gamma_start) * math.exp(-update / d.gamma_updates)
            relaxed = min(1.0, max(0.0, (update - d.relax_from) / (d.relax_to - d.relax_from)))
            rho, sigma = d.relaxed_cost**relaxed, self.sigma * d.relaxed_sigma**relaxed
            new = 0
            for _ in range(d.episodes):
                n, ended = _draw_episode(v * to_gain, sigma, settings, coefficients, rng, taken, after)
                lengths.append(n)
                succeeded.append(not ended)
                z, following = np.vstack([z, taken[:n] / scales]), np.vstack([following, after[:n] / scales[:6]])
                last = np.append(last, (np.arange(n) == n - 1) & ended)
                reported = self.task.cost(after[:n].copy(), self.task.ended(after[:n].copy(), self.rig))
                rewards.append(-float(reported.sum()))
                costs = np.append(costs, reported)
                new += n
            kept = slice(-max(d.replay, new), None)
            z, following, last, costs = z[kept], following[kept], last[kept], costs[kept]
            cost = costs if d.state_costs is None else rho * (z[:, :6] ** 2 @ d.state_costs) + z[:, 6] ** 2
            goes_on = ~last | d.bootstrap
            critic.learn(z, following, goes_on, cost, v, sigma / scales[6], gamma, new)
            step = -self.alpha * critic.gradient(z, v, sigma / scales[6], new)
            length = float(np.linalg.norm(step))
            if not (np.isfinite(critic.w).all() and math.isfinite(length) and length < _OVERFLOW):
                finite = False
                gains[update:] = v * to_gain
                break
            v = v + step * min(1.0, d.norm_cap / max(length, 1e-300))
            gains[update] = v * to_gain
            if update % 25 == 0:
                progress(len(lengths))
        streaks = np.convolve(succeeded, np.ones(self.streak), mode="valid")
        outcome = Outcome.CONVERGED if (streaks >= self.streak - 0.5).any() else Outcome.BUDGET_SPENT
        if not finite:
            outcome = Outcome.DIVERGED
        about = {"learner": repr(self), "seed": seed, "outcome": outcome.name, "versions": versions()}
        return QACTraining(
            policy=GainPolicy(v * to_gain, about=about),
            outcome=outcome,
            v=v,
            w=critic.w,
            episodes=len(lengths),
            steps=int(np.sum(lengths)),
            lengths=np.array(lengths, dtype=np.int64),
            rewards=np.array(rewards),
            succeeded=np.array(succeeded, dtype=np.bool_),
            weights=np.zeros((0, 12)),
            gains=gains,
            updated=d.episodes * np.arange(1, updates + 1),
            seconds=time.perf_counter() - began,
        )

    def _settings(self) -> _Settings:
        task, rig, d = self.task, self.rig, self.deviations
        limits = task.angle_limits if d is None or d.angle_cut is None else (d.angle_cut, d.angle_cut)
        return _Settings(
            alpha=float(self.alpha),
            beta=float(self.beta),
            sigma=float(self.sigma),
            gamma=float(self.gamma),
            indicators=INDICATORS[self.indicators],
            streak=int(self.streak),
            lam=float(task.lam),
            steps=int(task.steps),
            bounds=(float(rig.track_limit), *limits),
            weights=task.state_weights,
            failure_cost=float(task.failure_cost),
            force_limit=float(rig.force_limit),
            substep=rig.sample_time / rig.substeps,
            substeps=rig.substeps,
        )


class _Critic:
    r"""The critic of the tuned learner: :math:`\hat q = x^\top w` of the cost, and what the actor makes of it."""

    def __init__(self, deviations: Deviations, beta: float) -> None:
        self.deviations = deviations
        self.beta = beta
        self.w = np.zeros(29 if deviations.critic == "quadratic" else 18)

    def features(self, z: Array, variance: float | npt.NDArray[np.float64] = 0.0) -> Array:
        r"""Return the mean of :math:`x(s, a)` for actions of a mean, the last of ``z``, and a variance."""
        if self.deviations.critic == "quadratic":
            x = np.column_stack([quadratic_features(z), np.ones(len(z))])
            x[:, 27] += variance
            return x
        value = np.stack(features.make_value_features(lambda angle: angle)(z[:, :6].T), axis=1)
        return np.column_stack([value, z[:, 6:] * np.stack(features.slope_features(z[:, :6].T), axis=1)])

    def learn(
        self,
        z: Array,
        following: Array,
        goes_on: npt.NDArray[np.bool_],
        cost: Array,
        v: Array,
        sigma: float,
        gamma: float,
        new: int,
    ) -> None:
        """Value the policy of the moment, from the samples kept or by a step for each of the ``new`` ones."""
        x = self.features(z)
        x_next = goes_on[:, None] * self.features(np.column_stack([following, following @ v]), sigma**2)
        if not self.deviations.least_squares:
            _step_critic(self.w, x[-new:], x_next[-new:], cost[-new:], gamma, self.beta)
            return
        sizes = np.sqrt(np.sum(x**2, axis=0)) + 1e-12
        A = x.T @ (x - gamma * x_next) / np.outer(sizes, sizes) + 1e-6 * np.eye(len(sizes))
        if np.isfinite(A).all():
            self.w = np.linalg.lstsq(A, x.T @ cost / sizes, rcond=None)[0] / sizes

    def gradient(self, z: Array, v: Array, sigma: float, new: int) -> Array:
        r"""Return the direction of greatest growth of the cost over :math:`v`, in units of :math:`\sigma^2`."""
        d, s = self.deviations, z[:, :6]
        if not d.closed_form:  # the report's own: score times q, over the actions taken under this policy
            score = (z[-new:, 6] - s[-new:] @ v)[:, None] * s[-new:] / sigma**2
            gradient = score.T @ (self.features(z[-new:]) @ self.w) / new
            fisher = score.T @ score / new * sigma**2
        else:  # its mean over actions: phi times the slope of q at the mean action, where q is at most quadratic
            if d.critic == "quadratic":
                H = quadratic_form(self.w[:28])
                slope = 2 * (H[6, :6] + H[6, 6] * v)
            else:
                slope = self.w[12:][[0, 2, 4, 1, 3, 5]]
            if d.natural:  # the slope is linear in the state, so Fisher's matrix cancels
                return slope
            fisher = s.T @ s / len(s)
            gradient = fisher @ slope
        if not d.natural:
            return gradient
        return np.linalg.solve(fisher + 1e-6 * np.trace(fisher) / 6 * np.eye(6), gradient)


def _check(learner: GaussianQAC) -> None:
    """Refuse settings that make no sense, before anything runs."""
    rig = learner.rig
    if not isinstance(rig, Rig):
        raise TypeError(f"rig must be a dpend.Rig, such as dpend.rig('gustafsson2016'); got {rig!r}.")
    if not isinstance(learner.task, Balance):
        raise TypeError(f"task must be a dpend.Balance; got {learner.task!r}.")
    single_rig(rig, "GaussianQAC")
    if not rig.ideal:
        raise ValueError(
            "GaussianQAC trains on ideal rigs; got one with lag, delay, noise or rounding. "
            "Train on the ideal rig, then simulate the policy on this one."
        )
    if learner.indicators not in INDICATORS:
        raise ValueError(f"indicators must be one of {', '.join(map(repr, INDICATORS))}; got {learner.indicators!r}.")
    if learner.deviations is not None and (learner.indicators != "none" or learner.spread != 0):
        raise ValueError(
            "With deviations the actor has the six states and begins at zero: leave indicators and spread."
        )
    for name in ("streak", "max_episodes"):
        checked_whole(name, getattr(learner, name))
    for name, good, wanted in (
        ("alpha", 0 < learner.alpha < math.inf, "finite and greater than 0"),
        ("beta", 0 < learner.beta < math.inf, "finite and greater than 0"),
        ("sigma", 0 < learner.sigma < math.inf, "finite and greater than 0"),
        ("gamma", 0 < learner.gamma <= 1, "above 0 and at most 1"),
        ("spread", 0 <= learner.spread < math.inf, "finite and at least 0"),
    ):
        if not good:
            raise ValueError(f"{name} must be {wanted}; got {getattr(learner, name)!r}.")


def ablations(rig: Rig) -> dict[str, GaussianQAC]:
    """Return the tuned learner without one of its deviations each, by the words that tell which.

    Parameters
    ----------
    rig : Rig
        The rig.

    Returns
    -------
    dict
        First the whole learner, as "tuned".
    """
    tuned = GaussianQAC.tuned(rig)
    whole = Deviations()
    sizes, costs = np.array(whole.scales), np.array(whole.state_costs)
    same_costs = tuple(float(q) for q in costs * (sizes[6] / sizes[:6]) ** 2)  # of force and states in plain units

    def without(**changes: Any) -> GaussianQAC:
        return replace(tuned, deviations=replace(whole, **changes))

    return {
        "tuned": tuned,
        "1 unscaled features": without(
            scales=(1.0,) * 7, state_costs=same_costs, norm_cap=whole.norm_cap * whole.scales[6]
        ),
        "2 critic over Table 1": without(critic="table 1"),
        "3 the report's cost": without(state_costs=None),
        "4 critic by steps": without(least_squares=False),
        "5 no replay": without(replay=0),
        "6 sampled score": without(closed_form=False),
        "7 plain gradient": without(natural=False),
        "8 no cap on steps": without(norm_cap=math.inf),
        "9 discount .99 throughout": without(gamma_start=0.99),
        "10 episodes not cut": without(angle_cut=None),
        "11 cut without bootstrap": without(bootstrap=False),
        "12 the report's largest σ": replace(tuned, sigma=math.sqrt(10.0)),
        "13 cost and σ kept": without(relaxed_cost=1.0, relaxed_sigma=1.0),
    }


class _Settings(NamedTuple):
    """What the compiled loops need to know."""

    alpha: float
    beta: float
    sigma: float
    gamma: float
    indicators: int
    streak: int
    lam: float
    steps: int
    bounds: tuple[float, float, float]
    weights: tuple[float, float, float]
    failure_cost: float
    force_limit: float
    substep: float
    substeps: int


_FIELDS = len(Coefficients._fields)
_value_features = inline(features.make_value_features(wrap_angle))
_slope_features = inline(features.slope_features)


@inline
def _put_features(x, indicators, phi, slope):
    """Write the features of a state: those of actor and critic, and the critic's factors of the action."""
    value = _value_features(x)
    for i in range(12):
        phi[i] = value[i]
    if indicators == 3:
        for i in range(3):
            phi[12 + i] = 1.0 if value[2 * i + 1] > 0.0 else 0.0
    elif indicators == 8:
        cell = (4 if value[1] > 0.0 else 0) + (2 if value[3] > 0.0 else 0) + (1 if value[5] > 0.0 else 0)
        for i in range(8):
            phi[12 + i] = 1.0 if i == cell else 0.0
    raw = _slope_features(x)
    for i in range(6):
        slope[i] = raw[i]


@inline
def _q(w, phi, slope, a):
    q = 0.0
    for i in range(len(phi)):
        q += w[i] * phi[i]
    for i in range(6):
        q += w[len(phi) + i] * a * slope[i]
    return q


@inline
def _mean(v, phi):
    mean = 0.0
    for i in range(len(phi)):
        mean += v[i] * phi[i]
    return mean


@compiled
def _run_episodes(v, w, settings, coefficients, streak, rng, lengths, rewards, succeeded, history):
    """Run Algorithm 2 for some episodes, changing ``v`` and ``w`` in place; stop early at the streak or at overflow.

    Returns the episodes completed, the successes in a row at their end, and whether the weights are still finite.
    """
    s = settings
    c = Coefficients(*to_fixed_tuple(coefficients, _FIELDS))  # pyright: ignore[reportCallIssue]
    m = len(v)
    phi, phi_next = np.empty(m), np.empty(m)
    slope, slope_next = np.empty(6), np.empty(6)
    for episode in range(len(lengths)):
        x = (0.0, s.lam * rng.uniform(-1.0, 1.0), s.lam * rng.uniform(-1.0, 1.0), 0.0, 0.0, 0.0)
        _put_features(x, s.indicators, phi, slope)
        a = _mean(v, phi) + s.sigma * rng.standard_normal()
        failed = False
        t = 0
        while t < s.steps and not failed:
            force = min(max(a, -s.force_limit), s.force_limit)
            x = sample(x, (force, 0.0, 0.0), c, s.substep, s.substeps)
            failed = not (abs(x[0]) <= s.bounds[0] and abs(x[1]) <= s.bounds[1] and abs(x[2]) <= s.bounds[2])
            costs = abs(x[0]), abs(wrap_angle(x[1])), abs(wrap_angle(x[2]))
            reward = -(s.weights[0] * costs[0] + s.weights[1] * costs[1] + s.weights[2] * costs[2])
            if failed:
                reward -= s.failure_cost
            _put_features(x, s.indicators, phi_next, slope_next)
            a_next = _mean(v, phi_next) + s.sigma * rng.standard_normal()
            q = _q(w, phi, slope, a)
            delta = reward + s.gamma * _q(w, phi_next, slope_next, a_next) - q
            ascent = s.alpha * (a - _mean(v, phi)) / (s.sigma * s.sigma) * q
            largest = 0.0
            for i in range(m):
                largest = max(largest, abs(ascent * phi[i]), abs(s.beta * delta * phi[i]))
            for i in range(6):
                largest = max(largest, abs(s.beta * delta * a * slope[i]))
            if not largest < 1e100:
                return episode, streak, False
            for i in range(m):
                v[i] += ascent * phi[i]
                w[i] += s.beta * delta * phi[i]
            for i in range(6):
                w[m + i] += s.beta * delta * a * slope[i]
            phi[:] = phi_next
            slope[:] = slope_next
            a = a_next
            rewards[episode] += reward
            t += 1
        lengths[episode] = t
        history[episode] = v
        succeeded[episode] = not failed
        streak = 0 if failed else streak + 1
        if streak >= s.streak:
            return episode + 1, streak, True
    return len(lengths), streak, True


@compiled
def _draw_episode(K, sigma, settings, coefficients, rng, z, following):
    """Fill in an episode's states and actions, and the states that followed, under -Kx and noise.

    Returns its length, and whether it ended before its time.
    """
    s = settings
    c = Coefficients(*to_fixed_tuple(coefficients, _FIELDS))  # pyright: ignore[reportCallIssue]
    x = (0.0, s.lam * rng.uniform(-1.0, 1.0), s.lam * rng.uniform(-1.0, 1.0), 0.0, 0.0, 0.0)
    for k in range(len(z)):
        a = sigma * rng.standard_normal()
        for i in range(6):
            a -= K[i] * x[i]
            z[k, i] = x[i]
        z[k, 6] = a
        force = min(max(a, -s.force_limit), s.force_limit)
        x = sample(x, (force, 0.0, 0.0), c, s.substep, s.substeps)
        for i in range(6):
            following[k, i] = x[i]
        if not (abs(x[0]) <= s.bounds[0] and abs(x[1]) <= s.bounds[1] and abs(x[2]) <= s.bounds[2]):
            return k + 1, True
    return len(z), False


@compiled
def _step_critic(w, x, x_next, costs, gamma, beta):
    """Go one step of TD(0) for each sample, changing ``w`` in place; stop before overflow."""
    for k in range(len(x)):
        delta = costs[k]
        for i in range(len(w)):
            delta += (gamma * x_next[k, i] - x[k, i]) * w[i]
        if not abs(delta) < 1e100:
            return
        for i in range(len(w)):
            w[i] += beta * delta * x[k, i]
