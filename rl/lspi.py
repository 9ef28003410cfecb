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

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from dpend.kernels import compiled
from dpend.params import Array
from dpend.rig import Rig
from dpend.suggest import suggests
from dpend.tasks import Balance

from ._episode import ended, episode, moved, started
from .features import QUADRATIC, quadratic_features, quadratic_form
from .policies import GainPolicy
from .training import Outcome, Progress, Seed, Session, Training, check_settings, is_vector, training_rig

_SETTLED = 0.1  # a gain has settled where the last tenth of them is within this of the last, relative to its norm
_STREAM = 2003  # sets learning apart from starts drawn with the same seed


def gain_errors(gains: Array, K: npt.ArrayLike) -> Array:
    r"""Return :math:`\|K_i - K\| / \|K\|` of gains against another.

    Parameters
    ----------
    gains : ndarray (m, 6)
        The gains, such as ``training.details["gains"]``.
    K : array_like (6,) or (1, 6)
        The gain to compare with.

    Returns
    -------
    ndarray (m,)
    """
    reference = np.asarray(K, dtype=np.float64).reshape(6)
    return np.linalg.norm(gains - reference, axis=1) / np.linalg.norm(reference)


def fit_q(z: Array, costs: Array, z_next: Array, gamma: float) -> Array:
    r"""Return :math:`H` of :math:`\hat q = z^\top H z` by LSTD-Q, :math:`\sum x (x - \gamma x')^\top w = \sum x\,c`.

    Parameters
    ----------
    z : ndarray (n, k)
        States and the action taken, the action last.
    costs : ndarray (n,)
        Cost of each.
    z_next : ndarray (n, k)
        The states that followed, and the action that the policy to be evaluated would take there.
    gamma : float
        Discount factor.

    Returns
    -------
    ndarray (k, k)
        Symmetric.
    """
    scales = 1.0 / np.sqrt(np.mean(z**2, axis=0) + 1e-12)  # products of raw states span ten decades
    x, x_next = quadratic_features(z * scales), quadratic_features(z_next * scales)
    w = np.linalg.lstsq(x.T @ (x - gamma * x_next), x.T @ costs, rcond=None)[0]
    return quadratic_form(w) * np.outer(scales, scales)


def greedy_gain(H: Array) -> Array | None:
    r"""Return :math:`K = H_{aa}^{-1} H_{as}`, the gain of least :math:`z^\top H z`; None where there is no least.

    Parameters
    ----------
    H : ndarray (k, k)
        Symmetric, the action last.

    Returns
    -------
    ndarray (k - 1,) or None
    """
    if not (np.isfinite(H).all() and H[-1, -1] > 0):
        return None
    return H[-1, :-1] / H[-1, -1]


@dataclass(frozen=True, kw_only=True)
class _GainLearner:
    """What both learners have alike: the plant, the cost, the discount and how they practise."""

    rig: Rig = field(kw_only=False)
    state_weights: Sequence[float] = (1.0, 10.0, 10.0, 1.0, 1.0, 1.0)
    force_weight: float = 0.1
    gamma: float = 0.99
    gamma_start: float = 0.6
    noise: float = 2.0
    lam: float = 0.02
    angle_cut: float = 0.1
    episode_steps: int = 100

    @property
    def task(self) -> Balance:
        """Balancing, in episodes of its own."""
        return Balance(lam=self.lam, steps=self.episode_steps)

    def _check(self, *own: tuple[str, bool, str], whole: Sequence[str], **ranges: Sequence[str]) -> None:
        """Refuse settings that make no sense, before anything runs."""
        object.__setattr__(self, "rig", training_rig(self.rig, type(self).__name__))
        check_settings(
            self,
            ("state_weights", is_vector(self.state_weights, 6, 0.0), "6 finite numbers, at least 0"),
            *own,
            whole=(*whole, "episode_steps"),
            positive=("force_weight", "noise", *ranges.pop("positive", ())),
            portion=("gamma", "gamma_start", *ranges.pop("portion", ())),
            angle=("lam", "angle_cut"),
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
    noise : float
        Standard deviation of the exploring force, N.
    lam : float
        :math:`\lambda` of the starting angles, :math:`U[-\lambda, \lambda]`, rad.
    angle_cut : float
        An episode is cut where a link leans more, rad.  Not a failure: its last sample is a sample like any other.
    episode_steps : int
        An episode is cut after so many samples, too.

    Raises
    ------
    ValueError
        If a number is out of its range, or the rig is not ideal.
    """

    anneal: int = 50
    iterations: int = 60
    samples: int = 100
    keep: int = 300
    step: float = 0.5

    def __post_init__(self) -> None:
        self._check(
            ("keep", self.keep >= len(QUADRATIC), f"at least {len(QUADRATIC)}, the number of features"),
            whole=("iterations", "samples", "keep", "anneal"),
            portion=("step",),
        )

    def train(self, seed: Seed, *, seconds: float | None = None, progress: Progress = None) -> Training:
        """Learn from zero gain, as every :class:`rl.Learner` does; the last iteration may have fewer samples.

        The budget is always spent; converged means that the gain has settled: of the last tenth of the recorded ones
        none is further than a tenth of its norm from the last.  ``curve`` has the ``length`` of each episode that
        ended; ``details`` has ``gains`` (m, 6) after each iteration, N per unit of each state, and the ``samples`` (m,)
        up to each.
        """
        practice = _Practice(self, Session(self, seed, seconds, progress, _STREAM))
        Q, R = np.asarray(self.state_weights, dtype=np.float64), float(self.force_weight)
        K, gains, samples = np.zeros(6), [], [0]
        total = min(self.iterations * self.samples, practice.session.budget)
        z, following = np.zeros((0, 7)), np.zeros((0, 6))
        while samples[-1] < total:
            n = min(self.samples, total - samples[-1])
            new, after = np.zeros((n, 7)), np.zeros((n, 6))
            _practise(K, *practice.memory, new, after)
            z, following = np.vstack([z, new])[-self.keep :], np.vstack([following, after])[-self.keep :]
            grown = min(1.0, len(gains) / self.anneal)
            gamma = self.gamma_start + (self.gamma - self.gamma_start) * grown
            costs = z[:, :6] ** 2 @ Q + R * z[:, 6] ** 2
            greedy = greedy_gain(fit_q(z, costs, np.column_stack([following, -following @ K]), gamma))
            if greedy is not None:
                K = K + self.step * (greedy - K)
            gains.append(K)
            samples.append(samples[-1] + n)
            practice.session.report(samples[-1] / total)
        return practice.training(np.array(gains), samples[1:])


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
    rig, state_weights, force_weight, gamma, gamma_start, noise, lam, angle_cut, episode_steps
        As of :class:`LSPI`.
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

    Raises
    ------
    ValueError
        If a number is out of its range, or the rig is not ideal.
    """

    anneal: int = 5000
    samples: int = 6000
    alpha: float = 0.5
    epsilon: float = 0.1
    scales: Sequence[float] = (0.02, 0.05, 0.05, 0.1, 0.15, 0.15, 4.0)
    force_bound: float = 40.0
    record_every: int = 100

    def __post_init__(self) -> None:
        scales_good = is_vector(self.scales, 7) and min(self.scales) > 0
        self._check(
            ("alpha", 0 < self.alpha < 2, "above 0 and below 2"),
            ("scales", scales_good, "7 finite numbers greater than 0"),
            whole=("samples", "anneal", "record_every"),
            positive=("epsilon", "force_bound"),
        )

    def train(self, seed: Seed, *, seconds: float | None = None, progress: Progress = None) -> Training:
        r"""Learn from zero gain, as every :class:`rl.Learner` does.

        The training is as that of :meth:`LSPI.train`; recorded gains are those of the least :math:`\hat q`, and zero
        where it has no least.
        """
        practice = _Practice(self, Session(self, seed, seconds, progress, _STREAM))
        scales = np.asarray(self.scales, dtype=np.float64)
        costs = np.append(self.state_weights, self.force_weight).astype(np.float64)
        bound = min(float(self.force_bound), float(self.rig.force_limit))
        settings = _Steps(self.alpha, self.epsilon, self.gamma, self.gamma_start, self.anneal, bound)
        w = np.zeros(len(QUADRATIC))
        w[-1] = self.force_weight * scales[6] ** 2
        total = min(self.samples, practice.session.budget)
        samples, gains, finite = [0], [], True
        while samples[-1] < total:
            end = min(samples[-1] + self.record_every, total)
            if finite:
                finite = _learn_steps(w, scales, costs, settings, *practice.memory, samples[-1], end)
            greedy = greedy_gain(quadratic_form(w) / np.outer(scales, scales))
            gains.append(np.zeros(6) if greedy is None else greedy)
            samples.append(end)
            practice.session.report(end / total)
        return practice.training(np.array(gains), samples[1:], finite=finite)


class _Practice:
    """How both learners practise: episodes that go on from call to call, and the training that they come to."""

    def __init__(self, learner: LSPI | QuadraticQLearning, session: Session) -> None:
        self.session = session
        self._clock = np.zeros(2, dtype=np.int64)  # samples of the episode under way, and episodes begun
        self._lengths = np.zeros(learner.samples * getattr(learner, "iterations", 1), dtype=np.int64)
        plant = episode(learner.rig, learner.task, learner.angle_cut)
        self.memory = plant, float(learner.noise), session.rng, np.zeros(6), self._clock, self._lengths
        """What the compiled loops take, and change."""

    def training(self, gains: Array, samples: Sequence[int], *, finite: bool = True) -> Training:
        """Return the training that ended with the last of its gains."""
        latest = gains[-max(len(gains) // 10, 2) :]
        with np.errstate(over="ignore", invalid="ignore"):
            away = np.linalg.norm(latest - gains[-1], axis=1).max()
            settled = len(latest) > 1 and away <= _SETTLED * np.linalg.norm(gains[-1]) and gains[-1].any()
        outcome = Outcome.CONVERGED if settled else Outcome.BUDGET_SPENT
        if not finite:
            outcome = Outcome.DIVERGED
        under_way, begun = self._clock
        lengths = self._lengths[:begun]
        self.session.spent = int(lengths.sum())
        details = {"gains": gains, "samples": np.array(samples)}
        curve = {"length": lengths[:-1] if under_way else lengths}
        return self.session.training(outcome, GainPolicy, gains[-1], (details["samples"], gains), curve, details)


class _Steps(NamedTuple):
    """What one-step Q-learning needs beside the episode."""

    alpha: float
    epsilon: float
    gamma: float
    gamma_start: float
    anneal: int
    bound: float


@compiled
def _practise(K, e, noise, rng, state, clock, lengths, z, following):
    """Fill in states with the force that acted, and the states that followed, under -Kx and noise.

    Episodes go on from call to call: in ``state`` their state, in ``clock`` their age and number; ``lengths`` grow.
    """
    x = (state[0], state[1], state[2], state[3], state[4], state[5])
    for k in range(len(z)):
        if clock[0] == 0:
            x = started(e, rng)
            clock[1] += 1
        a = noise * rng.standard_normal()
        for i in range(6):
            a -= K[i] * x[i]
        a = min(max(a, -e.force_limit), e.force_limit)
        z[k, :6] = x
        z[k, 6] = a
        x = moved(e, x, a)
        following[k] = x
        clock[0] += 1
        lengths[clock[1] - 1] += 1
        if ended(e, x) or clock[0] >= e.steps:
            clock[0] = 0
    state[:] = x


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
def _learn_steps(w, scales, costs, steps, e, noise, rng, state, clock, lengths, begin, end):
    """Do one-step Q-learning on samples ``begin`` to ``end``, changing ``w`` in place; stop before overflow.

    Returns whether it did not have to stop.
    """
    q = steps
    x = (state[0], state[1], state[2], state[3], state[4], state[5])
    s, features = np.empty(7), np.empty(28)
    for t in range(begin, end):
        if clock[0] == 0:
            x = started(e, rng)
            clock[1] += 1
        for i in range(6):
            s[i] = x[i] / scales[i]
        a = _best_force(w, s, scales[6], q.bound) + noise * rng.standard_normal()
        a = min(max(a, -e.force_limit), e.force_limit)
        s[6] = a / scales[6]
        cost = costs[6] * a * a
        for i in range(6):
            cost += costs[i] * x[i] * x[i]
        value, norm, k = 0.0, q.epsilon, 0
        for i in range(7):
            for j in range(i, 7):
                features[k] = s[i] * s[j]
                value += w[k] * features[k]
                norm += features[k] * features[k]
                k += 1

        x = moved(e, x, a)
        for i in range(6):
            s[i] = x[i] / scales[i]
        s[6] = _best_force(w, s, scales[6], q.bound) / scales[6]
        least, k = 0.0, 0
        for i in range(7):
            for j in range(i, 7):
                least += w[k] * s[i] * s[j]
                k += 1
        gamma = q.gamma_start + (q.gamma - q.gamma_start) * min(1.0, t / q.anneal)
        change = q.alpha * (cost + gamma * least - value) / norm
        if not abs(change) < 1e100:
            return False
        for k in range(28):
            w[k] += change * features[k]
        clock[0] += 1
        lengths[clock[1] - 1] += 1
        if ended(e, x) or clock[0] >= e.steps:
            clock[0] = 0
    state[:] = x
    return True
