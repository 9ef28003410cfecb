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
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated

import numpy as np

from dpend.arguments import is_finite
from dpend.deprecation import renamed_arguments
from dpend.kernels import compiled, counted, inline, links_upright, report_cost, status_code, succeeded
from dpend.params import Array
from dpend.rig import Rig
from dpend.simulate import simulate_many
from dpend.suggest import suggests
from dpend.tasks import Balance, SwingUp

from . import features
from ._episode import Records, episode, moved, slope_features, started, value_features
from .features import CART_FEATURES, TABLE1
from .policies import LinearQPolicy
from .settings import Flag, Nonnegative, Portion, Positive, Share, Whole, check_settings, must, numbers
from .training import Outcome, Progress, Seed, Session, Training, training_rig

REPORT_FORCES = (0.0, 5.0, -5.0, 10.0, -10.0, 20.0, -20.0, 40.0, -40.0)
"""The report's action set, N."""

Weights = Annotated[Sequence[float], numbers(f"{len(TABLE1)} finite numbers", len(TABLE1))]
Forces = Annotated[Sequence[float], numbers("a list of finite numbers")]
Acceptance = Annotated[
    Sequence[tuple[float, float]],
    must(
        "pairs (lambda, share), 0 < lambda <= pi/2, with a share within 0 and 1",
        lambda tests: all(
            len(test) == 2 and all(map(is_finite, test)) and 0 < test[0] <= math.pi / 2 and 0 <= test[1] <= 1
            for test in tests
        ),
    ),
]

# Scales of the tuned variant, by state (pos, th1, th2, vel, om1, om2): of the value features, and of the action's.
_VALUE_SCALES = (0.35846, 1.68729, 2.74029, 0.128418, 0.340911, 0.343562)
_SLOPE_SCALES = (1.304099, 6.462294, 5.726458, 0.0557251, 0.0542309, 0.559797)

_STREAM = 1867  # sets learning apart from starts drawn with the same seed
_CHUNK = 200  # episodes between two looks at the keyboard and the progress bar


@renamed_arguments(spread="init_std")
@suggests
@dataclass(frozen=True, kw_only=True)
class LinearQLearning:
    r"""Algorithm 1 of the report on a rig; the defaults are the report's hyper-parameters to the letter.

    Learning counts as converged after ``streak`` successful episodes in a row.  Where ``acceptance`` names tests of
    balancing, the greedy policy must then also pass them; if it does not, learning goes on.

    Parameters
    ----------
    rig : Rig or str
        An ideal one: no noise, delay or lag; or the name of a preset.
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
        The greedy policy must save at least that share of ``acceptance_episodes`` fresh starts at each lambda.
    acceptance_episodes : int
        Episodes of each acceptance test.
    restart_after : int, optional
        Restart from initial weights where so many episodes did not converge.
    max_episodes : int
        Budget of learning episodes, restarts included.
    initial : sequence of 18 floats, optional
        Initial weights, such as those of a policy, to go on learning from.
    init_std : float
        Without them, standard deviation of the normal numbers that they are drawn from; zero for the report's zeros.

    See Also
    --------
    rl.LSPI : With the square of the action.
    rl.LinearQPolicy : What it learns.

    Examples
    --------
    >>> from rl import LinearQLearning
    >>> LinearQLearning.published("gustafsson2016").train(seed=0, seconds=20.0).converged
    False
    """

    rig: Rig = field(kw_only=False)
    task: Balance | SwingUp = Balance()  # noqa: RUF009  (frozen)
    scales: Weights = (1.0,) * len(TABLE1)
    forces: Forces = REPORT_FORCES
    alpha: Positive = 1e-4
    alpha_decay: Nonnegative = 0.0
    gamma: Portion = 0.99
    epsilon: Share = 0.01
    epsilon_decay: Nonnegative = 0.0
    bootstrap_failure: Flag = True
    streak: Whole = 20
    acceptance: Acceptance = ()
    acceptance_episodes: Whole = 100
    restart_after: Whole | None = None
    max_episodes: Whole = 2000
    initial: Weights | None = None
    init_std: Nonnegative = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "rig", training_rig(self.rig, "LinearQLearning"))
        check_settings(self)
        task = self.task
        if not isinstance(task, Balance | SwingUp):
            raise TypeError(f"task must be a dpend.Balance or a dpend.SwingUp; got {task!r}.")
        if isinstance(task, SwingUp):
            if task.start == "anywhere" or task.target_angles != (0.0, 0.0):
                raise ValueError(
                    f"A swing-up that is learned starts at rest and ends with both links up; got {task!r}."
                )
            if self.acceptance:
                raise ValueError("Acceptance tests are of balancing; leave acceptance empty for a swing-up.")
        limit = self.rig.force_limit
        if not (np.abs(np.asarray(self.forces, dtype=np.float64)) <= limit).all():
            raise ValueError(
                f"forces must be a list of forces within the rig's limit of {limit:g} N; got {self.forces!r}."
            )

    @classmethod
    def published(cls, rig: Rig | str, *, task: Balance | None = None, cart_features: bool = True) -> LinearQLearning:
        """Return the report's learner to the letter; what the report leaves unstated may be chosen.

        The task states the cost, which the report does not; left out, it is that of the code published with it, and
        link 1 alone falls.  ``cart_features`` says whether the six features of position and velocity take part.
        """
        scales = tuple(1.0 if cart_features or i not in CART_FEATURES else 0.0 for i in range(len(TABLE1)))
        return cls(training_rig(rig, "LinearQLearning"), task=task or Balance(criterion="report"), scales=scales)

    @classmethod
    def tuned(cls, rig: Rig | str, *, select: bool = True) -> LinearQLearning:
        """Return the same algorithm and features with the deviations that ``docs/linear-q-learning.md`` numbers.

        The numbers were tuned on the preset ``gustafsson2016``; on another rig they are a start.  ``select`` says
        whether acceptance tests and restarts take part; without, 20 successes in a row are enough, as in the published
        variant.
        """
        value_scales = np.repeat(_VALUE_SCALES, 2)
        slope_scales = np.array(features.slope_features(_SLOPE_SCALES)) / max(REPORT_FORCES)
        return cls(
            training_rig(rig, "LinearQLearning"),
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

    def train(self, seed: Seed, *, seconds: float | None = None, progress: Progress = None) -> Training:
        """Learn from initial weights, as every :class:`rl.Learner` does; no test may exceed ``seconds``.

        Each learning episode has in ``curve`` its ``length``, ``reward`` and ``success``; ``upright``, the longest time
        that both links were up without a break, samples, where balancing counts every sample; and ``tested``, samples
        of the acceptance tests that followed.  ``details`` has ``weights`` (episodes, 18) after each, its start
        ``angles`` (episodes, 2) and the number of ``restarts``.
        """
        session = Session(self, seed, seconds, progress, _STREAM)
        rng, plant = session.rng, episode(self.rig, self.task)
        steps = self.alpha, self.alpha_decay, self.gamma, self.epsilon, self.epsilon_decay, self.bootstrap_failure
        scales, forces = np.array(self.scales, dtype=np.float64), np.array(self.forces, dtype=np.float64)
        most, longest_test = self.max_episodes, len(self.acceptance) * self.acceptance_episodes * self.task.steps
        records, tested = Records.zeros(most, len(TABLE1)), np.zeros(most, dtype=np.int64)
        weights = self._initial(rng)
        episodes = age = streak = restarts = 0
        outcome = Outcome.BUDGET_SPENT
        while episodes < most and session.left:
            if age == self.restart_after:
                weights = self._initial(rng)
                age = streak = 0
                restarts += 1
            chunk = min(_CHUNK, most - episodes, (self.restart_after or most) - age)
            rows = records.rows(episodes, episodes + chunk)
            done, streak, finite = _run_episodes(
                weights, scales, forces, steps, plant, age, streak, self.streak, session.left, rng, rows
            )
            episodes += done
            age += done
            session.spent = int(records.length.sum() + tested.sum())
            session.report(episodes / most)
            if not finite:
                outcome = Outcome.DIVERGED
                break
            if streak >= self.streak:
                if longest_test > session.left:
                    break
                passed, tested[episodes - 1] = self._accept(LinearQPolicy(weights, scales, forces), rng)
                session.spent += int(tested[episodes - 1])
                if passed:
                    outcome = Outcome.CONVERGED
                    break
                streak = 0
        curve = records.rows(0, episodes)._asdict() | {"tested": tested[:episodes]}
        history, angles = curve.pop("weights"), curve.pop("angles")
        return session.training(
            outcome,
            partial(LinearQPolicy, scales=scales, forces=forces),
            weights,
            (np.cumsum(curve["length"] + curve["tested"]), history),
            curve,
            {"weights": history, "angles": angles, "restarts": np.array(restarts)},
        )

    def _initial(self, rng: np.random.Generator) -> Array:
        if self.initial is not None:
            return np.array(self.initial, dtype=np.float64)
        return self.init_std * rng.standard_normal(len(TABLE1)) if self.init_std else np.zeros(len(TABLE1))

    def _accept(self, policy: LinearQPolicy, rng: np.random.Generator) -> tuple[bool, int]:
        """Run the acceptance tests up to the first that the greedy policy fails; return the samples they took, too."""
        samples = 0
        for lam, share in self.acceptance:
            task = replace(self.task, lam=lam)
            starts = task.starts(rng, self.acceptance_episodes, self.rig)
            runs = simulate_many(self.rig, policy, starts, task=task)
            samples += int(runs.steps.sum())
            if runs.success.mean() < share:
                return False, samples
        return True, samples


@inline
def _write_features(x, scales, value, slope):
    """Write the scaled features of a state: those without the action, and the factors of the action."""
    value[:] = value_features(x)
    value *= scales[:12]
    slope[:] = slope_features(x)
    slope *= scales[12:]


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
def _run_episodes(w, scales, forces, steps, e, age, streak, enough, budget, rng, records):
    """Run Algorithm 1 for some episodes, changing ``w`` in place; stop early at the streak, the budget or overflow.

    Returns the episodes completed, the successes in a row at their end, and whether the weights are still finite.
    """
    first_alpha, alpha_decay, gamma, first_epsilon, epsilon_decay, bootstrap_failure = steps
    rule = e.rule
    value, slope = np.empty(12), np.empty(6)
    x_sa, w_next = np.empty(18), np.empty(18)
    for k in range(len(records.length)):
        alpha = first_alpha / (1.0 + alpha_decay * (age + k))
        epsilon = first_epsilon / (1.0 + epsilon_decay * (age + k))
        x = started(e, rng)
        records.angles[k, 0], records.angles[k, 1] = x[1], x[2]
        up_for = counted(-1, links_upright(x, rule.target, rule.upright_angle))
        _write_features(x, scales, value, slope)
        code = 0
        t = 0
        while t < e.steps and code == 0:
            if t >= budget:
                records.length[k] = t  # an episode that the budget cuts off counts by its samples only
                return k, streak, True
            c, g = _line(w, value, slope)
            a = forces[rng.integers(0, len(forces))] if rng.random() < epsilon else _greedy(g, forces)
            x_sa[:12] = value
            for i in range(6):
                x_sa[12 + i] = a * slope[i]
            q = c + a * g

            x = moved(e, x, a)
            code = status_code(x, rule.bounds)
            up_for = counted(up_for, links_upright(x, rule.target, rule.upright_angle))
            records.upright[k] = max(records.upright[k], up_for)
            reward = -report_cost(x, code, rule.target, rule.weights, rule.failure_cost)
            _write_features(x, scales, value, slope)
            target = reward
            if bootstrap_failure or code == 0:
                c, g = _line(w, value, slope)
                target += gamma * (c + _greedy(g, forces) * g)
            step = alpha * (target - q)
            finite = True
            for i in range(18):
                w_next[i] = w[i] + step * x_sa[i]
                finite &= math.isfinite(w_next[i])
            if not finite:
                return k, streak, False
            w[:] = w_next
            records.reward[k] += reward
            t += 1
        budget -= t
        records.length[k] = t
        records.weights[k] = w
        records.success[k] = succeeded(code, up_for, rule.hold)
        streak = streak + 1 if records.success[k] else 0
        if streak >= enough:
            return k + 1, streak, True
    return len(records.length), streak, True
