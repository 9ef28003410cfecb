r"""Gaussian QAC, the report's Algorithm 2: an actor-critic with a Gaussian policy, to the letter.

The actor draws :math:`a \sim \mathcal N(\varphi(s)^\top v, \sigma^2)`, the critic is
:math:`\hat q(s, a) = x(s, a)^\top w`, and every step does

.. math::
    v \leftarrow v + \alpha \frac{(a_t - \mu(s_t))\,\varphi(s_t)}{\sigma^2}\,\hat q(s_t, a_t), \qquad
    w \leftarrow w + \beta\,\bigl(r_{t+1} + \gamma\,\hat q(s_{t+1}, a_{t+1}) - \hat q(s_t, a_t)\bigr)\,x(s_t, a_t).

``docs/gaussian-qac.md`` lists what the report leaves open; the tuned variant is :class:`rl.natural_qac.NaturalQAC`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated, Any

import numpy as np

from dpend.deprecation import renamed_arguments
from dpend.kernels import compiled, inline, report_cost, status_code
from dpend.rig import Rig
from dpend.suggest import suggests
from dpend.tasks import Balance

from ._episode import Records, episode, moved, slope_features, started, value_features
from .natural_qac import NaturalQAC
from .policies import INDICATORS, TableOneMean
from .settings import Nonnegative, Portion, Positive, Whole, check_settings, one_of
from .training import Outcome, Progress, Seed, Session, Training, training_rig

_STREAM = 1968  # sets learning apart from starts drawn with the same seed
_CHUNK = 500  # episodes between two looks at the keyboard and the progress bar


@renamed_arguments(spread="init_std")
@suggests
@dataclass(frozen=True, kw_only=True)
class GaussianQAC:
    r"""Algorithm 2 of the report on a rig.

    Learning counts as converged after ``streak`` successful episodes in a row, which end it.

    Parameters
    ----------
    rig : Rig or str
        An ideal one: no noise, delay or lag; or the name of a preset.
    task : Balance
        Starts, episode length, failure, and the costs whose negative is the reward.
    alpha : float
        Step size of the actor.
    beta : float
        Step size of the critic.
    sigma : float
        Standard deviation of the policy, N.
    gamma : float
        Discount factor.
    indicators : {"none", "signs", "cells"}
        Further features of the state for actor and critic, see :data:`rl.policies.INDICATORS`.
    init_std : float
        Standard deviation of the normal numbers that :math:`v_0` and :math:`w_0` are drawn from; zero for zeros.
    streak : int
        Successful episodes in a row that count as convergence.
    max_episodes : int
        Budget of learning episodes.

    See Also
    --------
    rl.NaturalQAC : What ``tuned`` returns.

    Examples
    --------
    >>> from rl import GaussianQAC
    >>> GaussianQAC.published("gustafsson2016", alpha=1e-6, beta=1e-6, max_episodes=20).train(seed=0).converged
    False
    """

    rig: Rig = field(kw_only=False)
    task: Balance = Balance()  # noqa: RUF009  (frozen)
    alpha: Positive = 1e-4
    beta: Positive = 1e-4
    sigma: Positive = 1.0
    gamma: Portion = 0.99
    indicators: Annotated[str, one_of(INDICATORS)] = "none"
    init_std: Nonnegative = 0.0
    streak: Whole = 20
    max_episodes: Whole = 2000

    def __post_init__(self) -> None:
        object.__setattr__(self, "rig", training_rig(self.rig, "GaussianQAC"))
        if not isinstance(self.task, Balance):
            raise TypeError(f"task must be a dpend.Balance; got {self.task!r}.")
        check_settings(self)

    @classmethod
    def published(cls, rig: Rig | str, *, variance: float = 1.0, **settings: Any) -> GaussianQAC:
        r"""Return the report's learner to the letter, with a choice of what the report tried.

        The report tried variances :math:`\sigma^2` within 0.001 and 10 N², and step sizes within 1e-8 and 1e-1, which
        are among the ``settings``.  The cost is that of the code published with it, and link 1 alone falls.
        """
        return cls(
            training_rig(rig, "GaussianQAC"),
            **{"task": Balance(criterion="report"), "sigma": math.sqrt(variance)} | settings,
        )

    @staticmethod
    def tuned(rig: Rig | str) -> NaturalQAC:
        """Return the learner with the deviations that ``docs/gaussian-qac.md`` numbers, a natural actor-critic.

        The numbers were tuned on the preset ``gustafsson2016``; on another rig they are a start.
        """
        return NaturalQAC(training_rig(rig, "GaussianQAC"))

    def train(self, seed: Seed, *, seconds: float | None = None, progress: Progress = None) -> Training:
        """Learn, as every :class:`rl.Learner` does; the policy is the actor's mean, a :class:`rl.TableOneMean`.

        Each learning episode has in ``curve`` its ``length``, ``reward`` and ``success``; ``details`` has ``weights``
        (episodes, 12 + k), the actor's after each, and those of actor and critic at the end, ``v`` and ``w``, finite
        even where they diverged.
        """
        session = Session(self, seed, seconds, progress, _STREAM)
        rng, plant, most = session.rng, episode(self.rig, self.task), self.max_episodes
        indicators, steps = INDICATORS[self.indicators], (self.alpha, self.beta, self.sigma, self.gamma)
        m = 12 + indicators
        v, w = self.init_std * rng.standard_normal(m), self.init_std * rng.standard_normal(m + 6)
        records = Records.zeros(most, m)
        outcome, episodes, streak = Outcome.BUDGET_SPENT, 0, 0
        while episodes < most and session.left:
            rows = records.rows(episodes, episodes + _CHUNK)
            done, streak, finite = _run_episodes(
                v, w, indicators, steps, plant, streak, self.streak, session.left, rng, rows
            )
            episodes += done
            session.spent = int(records.length.sum())
            session.report(episodes / most)
            if not finite or streak >= self.streak:
                outcome = Outcome.CONVERGED if finite else Outcome.DIVERGED
                break
        ran = records.rows(0, episodes)
        return session.training(
            outcome,
            partial(TableOneMean, indicators=self.indicators),
            v,
            (np.cumsum(ran.length), ran.weights),
            {"length": ran.length, "reward": ran.reward, "success": ran.success},
            {"weights": ran.weights, "v": v, "w": w},
        )


@inline
def _write_features(x, indicators, phi, slope):
    """Write the features of a state: those of actor and critic, and the critic's factors of the action."""
    value = value_features(x)
    phi[:12] = value
    if indicators == 3:
        for i in range(3):
            phi[12 + i] = 1.0 if value[2 * i + 1] > 0.0 else 0.0
    elif indicators == 8:
        cell = (4 if value[1] > 0.0 else 0) + (2 if value[3] > 0.0 else 0) + (1 if value[5] > 0.0 else 0)
        for i in range(8):
            phi[12 + i] = 1.0 if i == cell else 0.0
    slope[:] = slope_features(x)


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
def _run_episodes(v, w, indicators, steps, e, streak, enough, budget, rng, records):
    """Run Algorithm 2 for some episodes, changing ``v`` and ``w``; stop early at the streak, the budget or overflow.

    Returns the episodes completed, the successes in a row at their end, and whether the weights are still finite.
    """
    (alpha, beta, sigma, gamma), rule = steps, e.rule
    m = len(v)
    phi, phi_next = np.empty(m), np.empty(m)
    slope, slope_next = np.empty(6), np.empty(6)
    for k in range(len(records.length)):
        x = started(e, rng)
        _write_features(x, indicators, phi, slope)
        a = _mean(v, phi) + sigma * rng.standard_normal()
        code = 0
        t = 0
        while t < e.steps and code == 0:
            if t >= budget:
                records.length[k] = t  # an episode that the budget cuts off counts by its samples only
                return k, streak, True
            x = moved(e, x, a)
            code = status_code(x, rule.bounds)
            reward = -report_cost(x, code, rule.target, rule.weights, rule.failure_cost)
            _write_features(x, indicators, phi_next, slope_next)
            a_next = _mean(v, phi_next) + sigma * rng.standard_normal()
            q = _q(w, phi, slope, a)
            delta = reward + gamma * _q(w, phi_next, slope_next, a_next) - q
            ascent = alpha * (a - _mean(v, phi)) / (sigma * sigma) * q
            largest = 0.0
            for i in range(m):
                largest = max(largest, abs(ascent * phi[i]), abs(beta * delta * phi[i]))
            for i in range(6):
                largest = max(largest, abs(beta * delta * a * slope[i]))
            if not largest < 1e100:
                return k, streak, False
            for i in range(m):
                v[i] += ascent * phi[i]
                w[i] += beta * delta * phi[i]
            for i in range(6):
                w[m + i] += beta * delta * a * slope[i]
            phi[:] = phi_next
            slope[:] = slope_next
            a = a_next
            records.reward[k] += reward
            t += 1
        budget -= t
        records.length[k] = t
        records.weights[k] = v
        records.success[k] = code == 0
        streak = streak + 1 if code == 0 else 0
        if streak >= enough:
            return k + 1, streak, True
    return len(records.length), streak, True
