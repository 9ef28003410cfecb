r"""Linear Q-learning, the report's Algorithm 1, as published and tuned.

With :math:`\hat q(s, a) = x(s, a)^\top w` over the features of Table 1, under an :math:`\varepsilon`-greedy policy,
every step does

.. math::
    \delta = r_{t+1} + \gamma \max_{a'} \hat q(s_{t+1}, a') - \hat q(s_t, a_t), \qquad
    w \leftarrow w + \alpha\,\delta\,x(s_t, a_t).

``docs/linear-q-learning.md`` lists what the report leaves open, and the numbered deviations of the tuned variant.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba.np.unsafe.ndarray import to_fixed_tuple

from dpend.kernels import compiled, inline, sample, wrap_angle
from dpend.params import Array, Coefficients
from dpend.provenance import versions
from dpend.rig import Rig, single_rig
from dpend.simulate import simulate_many
from dpend.suggest import suggests
from dpend.tasks import Balance, SwingUp, check_lam

from . import features
from .features import CART_FEATURES, TABLE1
from .policies import LinearQPolicy

REPORT_FORCES = (0.0, 5.0, -5.0, 10.0, -10.0, 20.0, -20.0, 40.0, -40.0)
"""The report's action set, N."""

# Scales of the tuned variant, by state (pos, th1, th2, vel, om1, om2): of the value features, and of the action's.
_VALUE_SCALES = (0.35846, 1.68729, 2.74029, 0.128418, 0.340911, 0.343562)
_SLOPE_SCALES = (1.304099, 6.462294, 5.726458, 0.0557251, 0.0542309, 0.559797)

_STREAM = (1867,)  # sets learning apart from starts drawn with the same seed
_CHUNK = 200  # episodes between two looks at the keyboard and the progress bar


class Outcome(Enum):
    """How a training ended; the value says it."""

    CONVERGED = "The learner met its criterion of convergence."
    DIVERGED = "A weight, or the state, grew beyond the range of floating-point numbers."
    BUDGET_SPENT = "The budget of episodes was spent without convergence."


@dataclass(frozen=True, kw_only=True, eq=False)
class Training:
    """What a training gave, and what it cost.

    Attributes
    ----------
    policy : LinearQPolicy
        The greedy policy of the weights as they ended; finite even where they diverged.
    outcome : Outcome
        How it ended; ``converged`` is short for one of them.
    episodes, steps : int
        Learning episodes and the samples in them, over all restarts.
    test_steps : int
        Samples spent on acceptance tests.
    restarts : int
        How often learning began anew from zero weights.
    lengths, rewards : ndarray (episodes,)
        Samples and total reward of each learning episode.
    upright : ndarray (episodes,)
        The longest time that both links were up without a break, samples; balancing counts every sample.
    weights : ndarray (episodes, 18)
        The weights after each learning episode.
    tested : ndarray (episodes,)
        Samples of the acceptance tests that followed each learning episode.
    seconds : float
        Wall time.
    """

    policy: LinearQPolicy
    outcome: Outcome
    episodes: int
    steps: int
    test_steps: int
    restarts: int
    lengths: npt.NDArray[np.int64]
    rewards: Array
    upright: npt.NDArray[np.int64]
    weights: Array
    tested: npt.NDArray[np.int64]
    seconds: float

    @property
    def converged(self) -> bool:
        """Whether the learner met its criterion of convergence."""
        return self.outcome is Outcome.CONVERGED


@suggests
@dataclass(frozen=True, kw_only=True)
class LinearQLearning:
    r"""Algorithm 1 of the report on a rig; the defaults are the report's hyper-parameters to the letter.

    Learning counts as converged after ``streak`` successful episodes in a row.  Where ``acceptance`` names tests of
    balancing, the greedy policy must then also pass them; if it does not, learning goes on.

    Parameters
    ----------
    rig : Rig
        An ideal one: no noise, delay or lag.
    task : Balance or SwingUp
        Starts, episode length, failure, success, and the costs whose negative is the reward; a swing-up starts at rest
        and aims at both links up.
    scales : sequence of 18 floats
        Factor of each feature of Table 1; zero leaves a feature out.
    forces : sequence of float
        The action set, N, within the rig's force limit; of equally good actions the first is taken.
    alpha, alpha_decay : float
        Step size :math:`\alpha / (1 + d\,k)` in episode :math:`k` since the last restart.
    gamma : float
        Discount factor.
    epsilon, epsilon_decay : float
        Exploration probability :math:`\varepsilon / (1 + d\,k)` in episode :math:`k` since the last restart.
    bootstrap_failure : bool
        Whether the step that fails still adds :math:`\gamma\max\hat q`, as Algorithm 1 is printed.
    streak : int
        Successful episodes in a row that end learning.
    acceptance : sequence of (lambda, share)
        The greedy policy must save at least that share of ``acceptance_episodes`` fresh starts of each spread.
    acceptance_episodes : int
        Episodes of each acceptance test.
    restart_after : int, optional
        Begin anew from zero weights where so many episodes did not converge.
    max_episodes : int
        Budget of learning episodes, restarts included.
    spread : float
        Standard deviation of the normal numbers that initial weights are drawn from; zero for the report's zeros.

    Raises
    ------
    ValueError
        If a number is out of its range, or the rig is not ideal.
    """

    rig: Rig
    task: Balance | SwingUp = Balance()  # noqa: RUF009  (frozen)
    scales: Sequence[float] = (1.0,) * len(TABLE1)
    forces: Sequence[float] = REPORT_FORCES
    alpha: float = 1e-4
    alpha_decay: float = 0.0
    gamma: float = 0.99
    epsilon: float = 0.01
    epsilon_decay: float = 0.0
    bootstrap_failure: bool = True
    streak: int = 20
    acceptance: Sequence[tuple[float, float]] = ()
    acceptance_episodes: int = 100
    restart_after: int | None = None
    max_episodes: int = 2000
    spread: float = 0.0

    def __post_init__(self) -> None:
        _check(self)

    @classmethod
    def published(cls, rig: Rig, *, task: Balance | None = None, cart_features: bool = True) -> LinearQLearning:
        """Return the report's learner to the letter; what the report leaves unstated may be chosen.

        Parameters
        ----------
        rig : Rig
            The rig.
        task : Balance, optional
            Cost weights and failure cost, which the report does not state; left out, those of the code published with
            it, and the report's own criterion of falling, link 1 alone.
        cart_features : bool
            Whether the six features of the cart's position and velocity take part.
        """
        scales = tuple(1.0 if cart_features or i not in CART_FEATURES else 0.0 for i in range(len(TABLE1)))
        return cls(rig=rig, task=task or Balance(criterion="report"), scales=scales)

    @classmethod
    def tuned(cls, rig: Rig, *, select: bool = True) -> LinearQLearning:
        """Return the same algorithm and features with the deviations that ``docs/linear-q-learning.md`` numbers.

        The numbers were tuned on the preset ``gustafsson2016``; on another rig they are a start.

        Parameters
        ----------
        rig : Rig
            The rig.
        select : bool
            Whether acceptance tests and restarts take part; without, 20 successes in a row are enough, as in the
            published variant.
        """
        value_scales = np.repeat(_VALUE_SCALES, 2)
        slope_scales = np.array(features.slope_features(_SLOPE_SCALES)) / max(REPORT_FORCES)
        return cls(
            rig=rig,
            task=Balance(lam=0.0814727, state_weights=(0.0354417, 1.0, 1.17711), failure_cost=1.59339),
            scales=tuple(float(scale) for scale in (*value_scales, *slope_scales)),
            alpha=0.00473758,
            alpha_decay=0.002,
            epsilon=0.0254024,
            epsilon_decay=0.0386529,
            bootstrap_failure=False,
            acceptance=((0.3, 0.82), (0.1, 0.99)) if select else (),
            restart_after=1000 if select else None,
            max_episodes=20_000,
        )

    def train(self, seed: int | Sequence[int], *, progress: Callable[[int], None] | None = None) -> Training:
        """Learn from initial weights.

        Parameters
        ----------
        seed : int or sequence of int
            What starts and exploration are drawn from.
        progress : callable, optional
            Called with the number of episodes done so far, every now and then.

        Returns
        -------
        Training
        """
        began = time.perf_counter()
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=_STREAM))
        settings = self._settings()
        coefficients = np.array(self.rig.params.coefficients(), dtype=np.float64)
        scales, forces = np.array(self.scales), np.array(self.forces)
        lengths = np.zeros(self.max_episodes, dtype=np.int64)
        rewards = np.zeros(self.max_episodes)
        upright, tested = np.zeros(self.max_episodes, dtype=np.int64), np.zeros(self.max_episodes, dtype=np.int64)
        history = np.zeros((self.max_episodes, len(TABLE1)))
        weights = self._initial(rng)
        episodes = age = streak = restarts = 0
        outcome = Outcome.BUDGET_SPENT
        while episodes < self.max_episodes:
            if age == self.restart_after:
                weights = self._initial(rng)
                age = streak = 0
                restarts += 1
            chunk = min(_CHUNK, self.max_episodes - episodes, (self.restart_after or self.max_episodes) - age)
            part = slice(episodes, episodes + chunk)
            counts = lengths[part], rewards[part], upright[part], history[part]
            done, streak, finite = _run_episodes(
                weights, scales, forces, settings, coefficients, age, streak, rng, *counts
            )
            episodes += done
            age += done
            if progress is not None:
                progress(episodes)
            if not finite:
                outcome = Outcome.DIVERGED
                break
            if streak >= self.streak:
                passed, samples = self._accept(LinearQPolicy(weights, scales, forces), rng)
                tested[episodes - 1] = samples
                if passed:
                    outcome = Outcome.CONVERGED
                    break
                streak = 0
        about = {
            "learner": repr(self),
            "seed": seed if isinstance(seed, int) else list(seed),
            "outcome": outcome.name,
            "versions": versions(),
        }
        return Training(
            policy=LinearQPolicy(weights, scales, forces, about=about),
            outcome=outcome,
            episodes=episodes,
            steps=int(lengths[:episodes].sum()),
            test_steps=int(tested.sum()),
            restarts=restarts,
            lengths=lengths[:episodes],
            rewards=rewards[:episodes],
            upright=upright[:episodes],
            weights=history[:episodes],
            tested=tested[:episodes],
            seconds=time.perf_counter() - began,
        )

    def _initial(self, rng: np.random.Generator) -> Array:
        return self.spread * rng.standard_normal(len(TABLE1)) if self.spread else np.zeros(len(TABLE1))

    def _accept(self, policy: LinearQPolicy, rng: np.random.Generator) -> tuple[bool, int]:
        """Put the greedy policy to the acceptance tests, up to the first it fails; give the samples they took."""
        samples = 0
        for lam, share in self.acceptance:
            task = replace(self.task, lam=lam)
            starts = task.starts(rng, self.acceptance_episodes, self.rig)
            runs = simulate_many(self.rig, policy, starts, task=task)
            samples += int(runs.steps.sum())
            if runs.success.mean() < share:
                return False, samples
        return True, samples

    def _settings(self) -> _Settings:
        task, rig = self.task, self.rig
        if isinstance(task, Balance):
            center, spread, limits, angle, hold = (0.0, 0.0), task.lam, task.angle_limits, math.inf, 0
        else:
            rest = replace(task, angle_spread=0.0).starts(np.random.default_rng(0), 1, rig)[0]
            center, spread, limits = (float(rest[1]), float(rest[2])), task.angle_spread, (math.inf, math.inf)
            angle, hold = task.upright_angle, round(task.hold / rig.sample_time)
        return _Settings(
            alpha=float(self.alpha),
            alpha_decay=float(self.alpha_decay),
            gamma=float(self.gamma),
            epsilon=float(self.epsilon),
            epsilon_decay=float(self.epsilon_decay),
            bootstrap_failure=bool(self.bootstrap_failure),
            streak=int(self.streak),
            center=center,
            spread=float(spread),
            steps=int(task.steps),
            bounds=(float(rig.track_limit), *limits),
            upright_angle=float(angle),
            hold=int(hold),
            weights=task.state_weights,
            failure_cost=float(task.failure_cost),
            substep=rig.sample_time / rig.substeps,
            substeps=rig.substeps,
        )


def _check(learner: LinearQLearning) -> None:
    """Refuse settings that make no sense, before anything runs."""
    rig = learner.rig
    if not isinstance(rig, Rig):
        raise TypeError(f"rig must be a dpend.Rig, such as dpend.rig('gustafsson2016'); got {rig!r}.")
    task = learner.task
    if not isinstance(task, Balance | SwingUp):
        raise TypeError(f"task must be a dpend.Balance or a dpend.SwingUp; got {task!r}.")
    if isinstance(task, SwingUp):
        if task.start == "anywhere" or task.target_angles != (0.0, 0.0):
            raise ValueError(f"A swing-up that is learned starts at rest and ends with both links up; got {task!r}.")
        if learner.acceptance:
            raise ValueError("Acceptance tests are of balancing; leave acceptance empty for a swing-up.")
    for name in ("streak", "acceptance_episodes", "max_episodes", "restart_after"):
        value = getattr(learner, name)
        if not (isinstance(value, int | np.integer) or (name == "restart_after" and value is None)):
            raise TypeError(f"{name} must be a whole number; got {value!r}.")
    for test in learner.acceptance:
        lam, share = test
        check_lam(lam)
        if not 0 <= share <= 1:
            raise ValueError(f"acceptance names pairs (lambda, share) with a share within 0 and 1; got {test!r}.")
    single_rig(rig, "LinearQLearning")
    if not rig.ideal:
        raise ValueError(
            "LinearQLearning trains on ideal rigs; got one with lag, delay, noise or rounding. "
            "Train on the ideal rig, then simulate the policy on this one."
        )
    if len(learner.scales) != len(TABLE1) or not np.isfinite(learner.scales).all():
        raise ValueError(f"scales must be {len(TABLE1)} finite numbers; got {learner.scales!r}.")
    forces = np.asarray(learner.forces, dtype=np.float64)
    if forces.ndim != 1 or not len(forces) or not (np.abs(forces) <= rig.force_limit).all():
        raise ValueError(
            f"forces must be a list of forces within the rig's limit of {rig.force_limit:g} N; got {learner.forces!r}."
        )
    for name, good, wanted in (
        ("alpha", learner.alpha > 0 and math.isfinite(learner.alpha), "greater than 0"),
        ("alpha_decay", 0 <= learner.alpha_decay < math.inf, "at least 0"),
        ("gamma", 0 < learner.gamma <= 1, "above 0 and at most 1"),
        ("epsilon", 0 <= learner.epsilon <= 1, "within 0 and 1"),
        ("epsilon_decay", 0 <= learner.epsilon_decay < math.inf, "at least 0"),
        ("streak", learner.streak >= 1, "at least 1"),
        ("acceptance_episodes", learner.acceptance_episodes >= 1, "at least 1"),
        ("restart_after", learner.restart_after is None or learner.restart_after >= 1, "at least 1, or None"),
        ("max_episodes", learner.max_episodes >= 1, "at least 1"),
        ("spread", 0 <= learner.spread < math.inf, "finite and at least 0"),
    ):
        if not good:
            raise ValueError(f"{name} must be {wanted}; got {getattr(learner, name)!r}.")


class _Settings(NamedTuple):
    """What the compiled loop needs to know."""

    alpha: float
    alpha_decay: float
    gamma: float
    epsilon: float
    epsilon_decay: float
    bootstrap_failure: bool
    streak: int
    center: tuple[float, float]
    spread: float
    steps: int
    bounds: tuple[float, float, float]
    upright_angle: float
    hold: int
    weights: tuple[float, float, float]
    failure_cost: float
    substep: float
    substeps: int


_FIELDS = len(Coefficients._fields)
_value_features = inline(features.make_value_features(wrap_angle))
_slope_features = inline(features.slope_features)


@inline
def _put_features(x, scales, value, slope):
    """Write the scaled features of a state: those without the action, and the factors of the action."""
    raw_value = _value_features(x)
    for i in range(12):
        value[i] = scales[i] * raw_value[i]
    raw_slope = _slope_features(x)
    for i in range(6):
        slope[i] = scales[12 + i] * raw_slope[i]


@inline
def _line(w, value, slope):
    """Return c and g of q(s, a) = c + a g."""
    c = 0.0
    for i in range(12):
        c += w[i] * value[i]
    g = 0.0
    for i in range(6):
        g += w[12 + i] * slope[i]
    return c, g


@inline
def _greedy(g, forces):
    """Return the first of the forces with the greatest a g."""
    best = forces[0]
    for force in forces[1:]:
        if force * g > best * g:
            best = force
    return best


@compiled
def _run_episodes(w, scales, forces, settings, coefficients, age, streak, rng, lengths, rewards, upright, history):
    """Run Algorithm 1 for some episodes, changing ``w`` in place; stop early at the wanted streak or at overflow.

    Returns the episodes completed, the successes in a row at their end, and whether the weights are still finite.
    """
    s = settings
    c_ = Coefficients(*to_fixed_tuple(coefficients, _FIELDS))  # pyright: ignore[reportCallIssue]
    value, slope = np.empty(12), np.empty(6)
    x_sa, w_next = np.empty(18), np.empty(18)
    for episode in range(len(lengths)):
        alpha = s.alpha / (1.0 + s.alpha_decay * (age + episode))
        exploration = s.epsilon / (1.0 + s.epsilon_decay * (age + episode))
        th1 = s.center[0] + s.spread * rng.uniform(-1.0, 1.0)
        th2 = s.center[1] + s.spread * rng.uniform(-1.0, 1.0)
        x = (0.0, th1, th2, 0.0, 0.0, 0.0)
        held = 0
        _put_features(x, scales, value, slope)
        failed = False
        t = 0
        while t < s.steps and not failed:
            c, g = _line(w, value, slope)
            a = forces[rng.integers(0, len(forces))] if rng.random() < exploration else _greedy(g, forces)
            x_sa[:12] = value
            for i in range(6):
                x_sa[12 + i] = a * slope[i]
            q = c + a * g

            x = sample(x, (a, 0.0, 0.0), c_, s.substep, s.substeps)
            failed = not (abs(x[0]) <= s.bounds[0] and abs(x[1]) <= s.bounds[1] and abs(x[2]) <= s.bounds[2])
            costs = abs(x[0]), abs(wrap_angle(x[1])), abs(wrap_angle(x[2]))
            held = held + 1 if costs[1] <= s.upright_angle and costs[2] <= s.upright_angle else 0
            upright[episode] = max(upright[episode], held)
            reward = -(s.weights[0] * costs[0] + s.weights[1] * costs[1] + s.weights[2] * costs[2])
            if failed:
                reward -= s.failure_cost
            _put_features(x, scales, value, slope)
            target = reward
            if s.bootstrap_failure or not failed:
                c, g = _line(w, value, slope)
                target += s.gamma * (c + _greedy(g, forces) * g)
            step = alpha * (target - q)
            finite = True
            for i in range(18):
                w_next[i] = w[i] + step * x_sa[i]
                finite &= math.isfinite(w_next[i])
            if not finite:
                return episode, streak, False
            w[:] = w_next
            rewards[episode] += reward
            t += 1
        lengths[episode] = t
        history[episode] = w
        streak = 0 if failed or held < s.hold else streak + 1
        if streak >= s.streak:
            return episode + 1, streak, True
    return len(lengths), streak, True
