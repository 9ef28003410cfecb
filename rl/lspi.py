r"""Q-learning with quadratic features: least-squares policy iteration, and one step at a time.

Over the products of :math:`z = (s, a)` the action-value function of a cost is a quadratic form,

.. math:: \hat q(s, a) = z^\top H z, \qquad \arg\min_a \hat q(s, a) = -K s, \qquad K = H_{aa}^{-1} H_{as},

which is the form that the value of linear feedback under a quadratic cost
:math:`c(s, a) = s^\top Q s + R a^2` has on a linear plant.  So what is learned is a gain, smooth where Table 1 of the
report is bang-bang, and on a linear plant the one that the Riccati equation gives for
:math:`\sqrt\gamma A, \sqrt\gamma B`.

Sources: S. Bradtke, *Incremental dynamic programming for on-line adaptive optimal control*, 1994; M. Lagoudakis and
R. Parr, *Least-squares policy iteration*, 2003.  ``docs/lspi.md`` says what it takes on an unstable plant.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt

from dpend.kernels import compiled
from dpend.params import Array
from dpend.rig import Rig
from dpend.suggest import suggests
from dpend.tasks import Balance

from ._episode import ended, episode, moved, rollout, started
from .features import QUADRATIC, quadratic_features, quadratic_form
from .policies import GainPolicy
from .settings import Angle, Diagonal, Portion, Positive, Scales, Whole, at_least, check_settings, must
from .training import Outcome, Progress, Seed, Session, Training, training_rig

_SETTLED = 0.1  # a gain has settled where the last tenth of them is within this of the last, relative to its norm
_STREAM = 2003  # sets learning apart from starts drawn with the same seed


def gain_errors(gains: Array, K: npt.ArrayLike) -> Array:
    r"""Return :math:`\|K_i - K\| / \|K\|`, (m,), of gains (m, 6) against another, (6,) or (1, 6)."""
    reference = np.asarray(K, dtype=np.float64).reshape(6)
    return np.linalg.norm(gains - reference, axis=1) / np.linalg.norm(reference)


def fit_q(z: Array, costs: Array, z_next: Array, gamma: float) -> Array:
    r"""Return :math:`H` of :math:`\hat q = z^\top H z` by LSTD-Q, :math:`\sum x (x - \gamma x')^\top w = \sum x\,c`.

    The rows of z (n, k) are states and the action taken, the action last, with their costs (n,); those of z_next are
    the states that followed and the action that the evaluated policy would take there.  H (k, k) is symmetric.
    """
    scales = 1.0 / np.sqrt(np.mean(z**2, axis=0) + 1e-12)  # products of raw states span ten decades
    x, x_next = quadratic_features(z * scales), quadratic_features(z_next * scales)
    w = np.linalg.lstsq(x.T @ (x - gamma * x_next), x.T @ costs, rcond=None)[0]
    return quadratic_form(w) * np.outer(scales, scales)


def greedy_gain(H: Array) -> Array | None:
    r"""Return :math:`K = H_{aa}^{-1} H_{as}`, (k - 1,), the gain of least :math:`z^\top H z`; None where none is.

    H (k, k) is symmetric and has the action last.
    """
    if not (np.isfinite(H).all() and H[-1, -1] > 0):
        return None
    return H[-1, :-1] / H[-1, -1]


@dataclass(frozen=True, kw_only=True)
class _GainLearner:
    """What both learners have alike: the plant, the cost, the discount and how they practise."""

    rig: Rig = field(kw_only=False)
    state_weights: Diagonal = (1.0, 10.0, 10.0, 1.0, 1.0, 1.0)
    force_weight: Positive = 0.1
    gamma: Portion = 0.99
    gamma_start: Portion = 0.6
    noise: Positive = 2.0
    lam: Angle = 0.02
    angle_cut: Angle = 0.1
    episode_steps: Whole = 100

    def __post_init__(self) -> None:
        object.__setattr__(self, "rig", training_rig(self.rig, type(self).__name__))
        check_settings(self)

    @property
    def task(self) -> Balance:
        """Balancing, in episodes of its own."""
        return Balance(lam=self.lam, steps=self.episode_steps)

    def _training(
        self, session: Session, gains: Array, ends: npt.NDArray[Any], lengths: npt.NDArray[Any], *, finite: bool = True
    ) -> Training:
        """Return the training of the gains after so many samples, with the lengths of the episodes that ended."""
        latest = gains[-max(len(gains) // 10, 2) :]
        with np.errstate(over="ignore", invalid="ignore"):
            away = np.linalg.norm(latest - gains[-1], axis=1).max()
            settled = len(latest) > 1 and away <= _SETTLED * np.linalg.norm(gains[-1]) and gains[-1].any()
        outcome = Outcome.CONVERGED if settled else Outcome.BUDGET_SPENT
        return session.training(
            outcome if finite else Outcome.DIVERGED,
            GainPolicy,
            gains[-1],
            (ends, gains),
            {"length": lengths},
            {"gains": gains, "samples": ends},
        )


@suggests
@dataclass(frozen=True, kw_only=True)
class LSPI(_GainLearner):
    r"""Least-squares policy iteration on a rig: from :math:`K = 0`, without a model, to a gain.

    In every iteration the current policy acts, with noise on its force; LSTD-Q evaluates it on the latest samples;
    the gain moves towards the greedy one.  The discount factor grows from a small one: with a short horizon the value
    of a policy that does not stabilise the plant is finite, and so is the first improvement.

    Parameters
    ----------
    rig : Rig or str
        An ideal one: no noise, delay or lag; or the name of a preset.
    state_weights : sequence of 6 floats
        Diagonal of :math:`Q`, at least zero.
    force_weight : float
        :math:`R`, greater than zero.
    gamma : float
        Discount factor at the end.
    gamma_start : float
        Discount factor of the first iteration.
    noise : float
        Standard deviation of the exploring force, N.
    lam : float
        :math:`\lambda` of the starting angles, :math:`U[-\lambda, \lambda]`, rad.
    angle_cut : float
        An episode is cut where a link leans more, rad.  Not a failure: its last sample is a sample like any other.
    episode_steps : int
        An episode is cut after so many samples, too.
    anneal : int
        Iterations over which the discount factor grows, in equal steps.
    iterations : int
        Policy iterations.
    samples : int
        Samples in each.
    keep : int
        Latest samples that LSTD-Q uses, those of earlier policies among them.
    step : float
        Part of the way to the greedy gain that an iteration goes, above 0 and at most 1.

    See Also
    --------
    rl.QuadraticQLearning : One step at a time.
    controllers.LQR : With a discount, what it finds.

    Examples
    --------
    >>> from rl import LSPI
    >>> training = LSPI("gustafsson2016").train(seed=0)
    >>> training.converged, training.experience
    (True, 120.0)
    """

    anneal: Whole = 50
    iterations: Whole = 60
    samples: Whole = 100
    keep: Annotated[Whole, at_least(len(QUADRATIC), ", the number of features")] = 300
    step: Portion = 0.5

    def train(self, seed: Seed, *, seconds: float | None = None, progress: Progress = None) -> Training:
        """Learn from zero gain, as every :class:`rl.Learner` does; the last iteration may have fewer samples.

        The budget is always spent; converged means that the gain has settled: of the last tenth of the recorded ones
        none is further than a tenth of its norm from the last.  ``curve`` has the ``length`` of each episode that
        ended; ``details`` has ``gains`` (m, 6) after each iteration, N per unit of each state, and the ``samples`` (m,)
        up to each.
        """
        session, plant = Session(self, seed, seconds, progress, _STREAM), episode(self.rig, self.task, self.angle_cut)
        Q, R = np.asarray(self.state_weights, dtype=np.float64), float(self.force_weight)
        ends = _ends(self.samples, min(self.iterations * self.samples, session.budget))
        z, following = np.zeros((ends[-1], 7)), np.zeros((ends[-1], 6))
        noise, limit = float(self.noise), plant.force_limit
        K, gains, lengths, age = np.zeros(6), np.zeros((len(ends), 6)), [], 0
        for k, end in enumerate(ends):
            while session.spent < end:
                rows = slice(session.spent, min(session.spent + self.episode_steps - age, end))
                x = following[rows.start - 1]
                n, failed = rollout(K, noise, limit, plant, session.rng, x, age == 0, z[rows], following[rows])
                session.spent += n
                age += n
                if failed or age == self.episode_steps:
                    lengths.append(age)
                    age = 0
            kept = slice(max(end - self.keep, 0), end)
            gamma = self.gamma_start + (self.gamma - self.gamma_start) * min(1.0, k / self.anneal)
            costs, after = z[kept, :6] ** 2 @ Q + R * z[kept, 6] ** 2, following[kept]
            greedy = greedy_gain(fit_q(z[kept], costs, np.column_stack([after, -after @ K]), gamma))
            if greedy is not None:
                K = K + self.step * (greedy - K)
            gains[k] = K
            session.report(end / ends[-1])
        return self._training(session, gains, ends, np.array(lengths, dtype=np.int64))


@suggests
@dataclass(frozen=True, kw_only=True)
class QuadraticQLearning(_GainLearner):
    r"""One-step Q-learning with the quadratic features, in the costs, starts and cuts of :class:`LSPI`.

    Every sample does, for features :math:`x` of scaled variables,

    .. math::
        \delta = c + \gamma \min_{a'} \hat q(s', a') - \hat q(s, a), \qquad
        w \leftarrow w + \alpha\,\delta\,x(s, a) / (\epsilon + \|x(s, a)\|^2).

    Learning begins at :math:`\hat q(s, a) = R a^2`, whose greedy action is none.  Where :math:`\hat q` has no least
    action, the force of least :math:`\hat q` within the rig's limit, or ``force_bound``, is taken.

    Parameters
    ----------
    rig : Rig or str
        An ideal one: no noise, delay or lag; or the name of a preset.
    state_weights : sequence of 6 floats
        Diagonal of :math:`Q`, at least zero.
    force_weight : float
        :math:`R`, greater than zero.
    gamma : float
        Discount factor at the end.
    gamma_start : float
        Discount factor at first.
    noise : float
        Standard deviation of the exploring force, N.
    lam : float
        :math:`\lambda` of the starting angles, rad.
    angle_cut : float
        An episode is cut where a link leans more, rad.
    episode_steps : int
        An episode is cut after so many samples, too.
    anneal : int
        Samples over which the discount factor grows, in equal steps.
    samples : int
        Samples of experience.
    alpha : float
        Step size, above 0 and below 2.
    epsilon : float
        What keeps the division bounded near the origin.
    scales : sequence of 7 floats
        Size of each state and of the action, by which it is divided.
    force_bound : float
        Largest greedy force, N, where the rig's own limit is larger.
    record_every : int
        Samples between two recorded gains.

    See Also
    --------
    rl.LSPI : Least squares on the same features.

    Examples
    --------
    >>> from rl import QuadraticQLearning
    >>> QuadraticQLearning("gustafsson2016", samples=500).train(seed=0).policy.K.shape
    (6,)
    """

    anneal: Whole = 5000
    samples: Whole = 6000
    alpha: Annotated[float, must("above 0 and below 2", lambda alpha: 0 < alpha < 2)] = 0.5
    epsilon: Positive = 0.1
    scales: Scales = (0.02, 0.05, 0.05, 0.1, 0.15, 0.15, 4.0)
    force_bound: Positive = 40.0
    record_every: Whole = 100

    def train(self, seed: Seed, *, seconds: float | None = None, progress: Progress = None) -> Training:
        r"""Learn from zero gain, as every :class:`rl.Learner` does.

        The training is as that of :meth:`LSPI.train`; recorded gains are those of the least :math:`\hat q`, and zero
        where it has no least.
        """
        session, plant = Session(self, seed, seconds, progress, _STREAM), episode(self.rig, self.task, self.angle_cut)
        scales = np.asarray(self.scales, dtype=np.float64)
        costs = np.append(self.state_weights, self.force_weight).astype(np.float64)
        bound = min(float(self.force_bound), float(self.rig.force_limit))
        settings = self.alpha, self.epsilon, self.gamma, self.gamma_start, self.anneal, float(self.noise), bound
        w = np.zeros(len(QUADRATIC))
        w[-1] = self.force_weight * scales[6] ** 2
        ends = _ends(self.record_every, min(self.samples, session.budget))
        gains, over, under_way, finite = np.zeros((len(ends), 6)), np.zeros(ends[-1], dtype=np.bool_), np.zeros(7), True
        for k, end in enumerate(ends):
            if finite:
                begin = session.spent
                session.spent = _learn_steps(
                    w, scales, costs, settings, plant, session.rng, under_way, over, begin, end
                )
                finite = session.spent == end
            greedy = greedy_gain(quadratic_form(w) / np.outer(scales, scales))
            if greedy is not None:
                gains[k] = greedy
            session.report(end / ends[-1])
        lengths = np.diff(np.flatnonzero(over), prepend=-1)
        return self._training(session, gains, ends, lengths, finite=finite)


def _ends(n: int, total: int) -> npt.NDArray[np.int64]:
    """Return the samples up to the end of each round of ``n``, of which the last may be shorter."""
    return np.append(np.arange(n, total, n), total)


@compiled
def _best_force(w, s, unit, bound):
    """Return the force of least q within a bound, for scaled states and the unit of force."""
    b = 0.0
    k = 6
    for i in range(6):  # the product with the action ends each row of the upper triangle
        b += 0.5 * w[k] * s[i]
        k += 6 - i
    curvature = w[27]
    if curvature > 0.0:
        return min(max(-b / curvature * unit, -bound), bound)
    return -bound if b > 0.0 else bound


@compiled
def _learn_steps(w, scales, costs, settings, e, rng, under_way, over, begin, end):
    """Do one-step Q-learning on samples ``begin`` to ``end``, changing ``w`` in place; stop before overflow.

    Returns the samples done by then.  Episodes go on from call to call: ``under_way`` has their state, and their age.
    """
    alpha, epsilon, gamma_end, gamma_start, anneal, noise, bound = settings
    x, age = (under_way[0], under_way[1], under_way[2], under_way[3], under_way[4], under_way[5]), int(under_way[6])
    s, features = np.empty(7), np.empty(28)
    for t in range(begin, end):
        if age == 0:
            x = started(e, rng)
        for i in range(6):
            s[i] = x[i] / scales[i]
        a = _best_force(w, s, scales[6], bound) + noise * rng.standard_normal()
        a = min(max(a, -e.force_limit), e.force_limit)
        s[6] = a / scales[6]
        cost = costs[6] * a * a
        for i in range(6):
            cost += costs[i] * x[i] * x[i]
        value, norm, k = 0.0, epsilon, 0
        for i in range(7):
            for j in range(i, 7):
                features[k] = s[i] * s[j]
                value += w[k] * features[k]
                norm += features[k] * features[k]
                k += 1

        x = moved(e, x, a)
        for i in range(6):
            s[i] = x[i] / scales[i]
        s[6] = _best_force(w, s, scales[6], bound) / scales[6]
        least, k = 0.0, 0
        for i in range(7):
            for j in range(i, 7):
                least += w[k] * s[i] * s[j]
                k += 1
        gamma = gamma_start + (gamma_end - gamma_start) * min(1.0, t / anneal)
        change = alpha * (cost + gamma * least - value) / norm
        if not abs(change) < 1e100:
            return t
        for k in range(28):
            w[k] += change * features[k]
        over[t] = ended(e, x) or age + 1 >= e.steps
        age = 0 if over[t] else age + 1
    under_way[:6] = x
    under_way[6] = age
    return end
