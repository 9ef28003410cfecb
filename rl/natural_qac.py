r"""The tuned actor-critic: the report's Algorithm 2 with the deviations that make it learn, a natural actor-critic.

The actor is :math:`a \sim \mathcal N(v^\top s, \sigma^2)` in scaled variables, the critic LSTD(0) over the products of
:math:`z = (s, a)`, and each update moves :math:`v` along the natural gradient of the cost, in closed form.
``docs/gaussian-qac.md`` numbers and explains the deviations; :func:`ablations` takes each back.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt

from dpend.arguments import checked_name
from dpend.kernels import compiled
from dpend.params import Array
from dpend.rig import Rig
from dpend.suggest import suggests
from dpend.tasks import Balance

from . import features
from ._episode import episode, rollout
from .features import quadratic_features, quadratic_form
from .policies import GainPolicy
from .settings import Angle, Flag, Portion, Positive, Scales, Whole, at_least, check_settings, must, numbers
from .training import Outcome, Progress, Seed, Session, Training, training_rig

_STREAM = 1968  # that of Algorithm 2, of which this is a variant
StateCosts = Annotated[Sequence[float], numbers("6 finite numbers, at least 0, or None", 6, lambda each: each >= 0)]
_OVERFLOW = 1e100  # weights beyond it have diverged; the next product would still be a number


@suggests
@dataclass(frozen=True, kw_only=True)
class NaturalQAC:
    r"""Algorithm 2 of the report as ``docs/gaussian-qac.md`` tunes it: a natural actor-critic.

    States and action are divided by ``scales``; :math:`z = (s, a)` and :math:`v` are in these units.  The budget is
    always spent; converged means that ``streak`` successful episodes in a row occurred.

    Parameters
    ----------
    rig : Rig or str
        An ideal one: no noise, delay or lag; or the name of a preset.
    task : Balance
        Starts, episode length and failure; its cost is that which is reported.
    alpha : float
        Step size of the actor.
    beta : float
        Step size of a critic that does not solve least squares.
    sigma : float
        Standard deviation of the policy at first, N.
    gamma : float
        Discount factor at the end.
    streak : int
        Successful episodes in a row that count as convergence.
    max_episodes : int
        Learning episodes.
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
    episodes_per_update : int
        Episodes in an update.
    relax_from, relax_to : int
        Updates between which :math:`\rho` falls from 1 and :math:`\sigma` from its first value, geometrically.
    relaxed_cost : float
        :math:`\rho` at the end; 1 to keep it.
    relaxed_sigma : float
        :math:`\sigma` at the end, as a share of the first; 1 to keep it.

    See Also
    --------
    rl.GaussianQAC : Algorithm 2 to the letter.

    Examples
    --------
    >>> from rl import GaussianQAC
    >>> type(GaussianQAC.tuned("gustafsson2016")).__name__
    'NaturalQAC'
    """

    rig: Rig = field(kw_only=False)
    task: Balance = Balance()  # noqa: RUF009  (frozen)
    alpha: Positive = 0.2
    beta: Positive = 0.03
    sigma: Positive = 11.36
    gamma: Portion = 0.99
    streak: Whole = 20
    max_episodes: Whole = 400
    scales: Scales = (0.5, 0.1, 0.1, 1.0, 0.5, 0.5, 40.0)
    critic: Annotated[str, partial(checked_name, known=("quadratic", "table 1"))] = "quadratic"
    state_costs: StateCosts | None = (1.0, 1.0, 1.0, 0.1, 0.1, 0.1)
    least_squares: Flag = True
    replay: Annotated[int, at_least(0)] = 1200
    closed_form: Flag = True
    natural: Flag = True
    norm_cap: Annotated[float, must("greater than 0", lambda cap: cap > 0)] = 0.218
    gamma_start: Portion = 0.4
    gamma_updates: Positive = 26.6
    angle_cut: Angle | None = 0.254
    bootstrap: Flag = True
    episodes_per_update: Whole = 2
    relax_from: Annotated[int, at_least(0)] = 80
    relax_to: Whole = 160
    relaxed_cost: Positive = 1e-3
    relaxed_sigma: Positive = 0.176

    def __post_init__(self) -> None:
        object.__setattr__(self, "rig", training_rig(self.rig, "GaussianQAC"))
        if not isinstance(self.task, Balance):
            raise TypeError(f"task must be a dpend.Balance; got {self.task!r}.")
        check_settings(self)
        if self.relax_to <= self.relax_from:
            raise ValueError(f"relax_to must be greater than relax_from = {self.relax_from}; got {self.relax_to}.")

    def train(self, seed: Seed, *, seconds: float | None = None, progress: Progress = None) -> Training:
        """Learn from zero gain, as every :class:`rl.Learner` does; the policy is a :class:`rl.GainPolicy`.

        Each learning episode has in ``curve`` its ``length``, ``reward`` (the task's) and ``success``; ``details`` has
        ``gains`` (m, 6) after each update, N per unit of each state, the episodes up to each, ``updated`` (m,), and the
        weights of actor and critic at the end, ``v`` and ``w``.
        """
        session = Session(self, seed, seconds, progress, _STREAM)
        critic, plant = _Critic(self), episode(self.rig, self.task, self.angle_cut)
        scales = np.asarray(self.scales, dtype=np.float64)
        to_gain = -scales[6] / scales[:6]
        updates = self.max_episodes // self.episodes_per_update
        v, gains = np.zeros(6), np.zeros((updates, 6))
        lengths, rewards, success = [], [], []
        memory = np.zeros((0, 7)), np.zeros((0, 6)), np.zeros(0, dtype=np.bool_), np.zeros(0)
        taken, after = np.zeros((self.task.steps, 7)), np.zeros((self.task.steps, 6))
        spent, finite = [], True
        for update in range(updates):
            gamma = self.gamma - (self.gamma - self.gamma_start) * math.exp(-update / self.gamma_updates)
            relaxed = min(1.0, max(0.0, (update - self.relax_from) / (self.relax_to - self.relax_from)))
            rho, sigma = self.relaxed_cost**relaxed, self.sigma * self.relaxed_sigma**relaxed
            fresh, new = [], 0
            for _ in range(self.episodes_per_update):
                allowed = slice(min(session.left, self.task.steps))
                n, failed = rollout(
                    v * to_gain, sigma, math.inf, plant, session.rng, taken[0], True, taken[allowed], after[allowed]
                )
                session.spent += n
                new += n
                reported = self.task.cost(after[:n], self.task.ended(after[:n], self.rig))
                fresh.append((taken[:n] / scales, after[:n] / scales[:6], (np.arange(n) == n - 1) & failed, reported))
                if failed or n == self.task.steps:  # not where the budget cut it off
                    lengths.append(n)
                    success.append(not failed)
                    rewards.append(-float(reported.sum()))
            if not new:
                break
            memory = [np.concatenate(kind)[-max(self.replay, new) :] for kind in zip(memory, *fresh, strict=True)]
            z, following, last, costs = memory
            cost = costs if self.state_costs is None else rho * (z[:, :6] ** 2 @ self.state_costs) + z[:, 6] ** 2
            critic.learn(z, following, ~last | self.bootstrap, cost, v, sigma / scales[6], gamma, new)
            step = -self.alpha * critic.gradient(z, v, sigma / scales[6], new)
            length = float(np.linalg.norm(step))
            finite = bool(np.isfinite(critic.w).all() and math.isfinite(length) and length < _OVERFLOW)
            if not finite:
                break
            v = v + step * min(1.0, self.norm_cap / max(length, 1e-300))
            gains[update] = v * to_gain
            spent.append(session.spent)
            session.report((update + 1) / updates)
        streaks = np.convolve(success, np.ones(self.streak), mode="valid") if success else np.zeros(0)
        outcome = Outcome.CONVERGED if (streaks >= self.streak - 0.5).any() else Outcome.BUDGET_SPENT
        if not finite:
            outcome = Outcome.DIVERGED
        gains = gains[: len(spent)]
        curve = {"length": np.array(lengths, dtype=np.int64), "reward": np.array(rewards)}
        details = {"gains": gains, "updated": self.episodes_per_update * np.arange(1, len(gains) + 1)}
        return session.training(
            outcome,
            GainPolicy,
            v * to_gain,
            (np.array(spent), gains),
            curve | {"success": np.array(success, dtype=np.bool_)},
            details | {"v": v, "w": critic.w},
        )


class _Critic:
    r"""The critic of the tuned learner: :math:`\hat q = x^\top w` of the cost, and what the actor makes of it."""

    def __init__(self, learner: NaturalQAC) -> None:
        self.learner = learner
        self.w = np.zeros(29 if learner.critic == "quadratic" else 18)

    def features(self, z: Array, variance: float | npt.NDArray[np.float64] = 0.0) -> Array:
        r"""Return the mean of :math:`x(s, a)` for actions of a mean, the last of ``z``, and a variance."""
        if self.learner.critic == "quadratic":
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
        if not self.learner.least_squares:
            _step_critic(self.w, x[-new:], x_next[-new:], cost[-new:], gamma, self.learner.beta)
            return
        sizes = np.sqrt(np.sum(x**2, axis=0)) + 1e-12
        A = x.T @ (x - gamma * x_next) / np.outer(sizes, sizes) + 1e-6 * np.eye(len(sizes))
        if np.isfinite(A).all():
            self.w = np.linalg.lstsq(A, x.T @ cost / sizes, rcond=None)[0] / sizes

    def gradient(self, z: Array, v: Array, sigma: float, new: int) -> Array:
        r"""Return the direction of greatest growth of the cost over :math:`v`, in units of :math:`\sigma^2`."""
        d, s = self.learner, z[:, :6]
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


def ablations(rig: Rig | str) -> dict[str, NaturalQAC]:
    """Return the whole learner, as "tuned", and without one of its deviations each, by a name that says which."""
    tuned = NaturalQAC(training_rig(rig, "NaturalQAC"))
    sizes, costs = np.array(tuned.scales), np.array(tuned.state_costs)
    same_costs = tuple(float(q) for q in costs * (sizes[6] / sizes[:6]) ** 2)  # of force and states in SI units

    def without(**changes: Any) -> NaturalQAC:
        return replace(tuned, **changes)

    return {
        "tuned": tuned,
        "1 unscaled features": without(
            scales=(1.0,) * 7, state_costs=same_costs, norm_cap=tuned.norm_cap * tuned.scales[6]
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
        "12 the report's largest σ": without(sigma=math.sqrt(10.0)),
        "13 cost and σ kept": without(relaxed_cost=1.0, relaxed_sigma=1.0),
    }


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
