r"""What an environment pays for a step.

``"default"`` is for learning.  Balancing pays one for every step that does not fail: a discounted return
:math:`\sum_{t<k}\gamma^t` grows with the number :math:`k` of samples that the links stayed up, so every success beats
every failure, and a late failure an early one, for every :math:`0 < \gamma \le 1`.  A swing-up pays

.. math::
    r(x) = \tfrac12 + \tfrac12\exp\bigl(-5(2 - \cos(\theta_1 - \theta_1^*) - \cos(\theta_2 - \theta_2^*))
           - 2(\omega_1^2 + \omega_2^2)L/g\bigr)

with the mean length :math:`L`, and nothing for the step that leaves the track.  Half is for staying on the track, half
for links that are at their target and slow; hanging at rest earns the first half alone.  So a run that gets up beats an
idle one for every :math:`\gamma`, and an idle one beats any that leaves the track without having been nearly up.  What
a discount forgets no reward brings back: at :math:`\gamma = 0.95` and 50 samples a second, two seconds weigh 1/170.

``"report"`` is minus the task's cost, as the report has it.  It is a trap: every step costs something, so a return
grows by ending the episode, and at the defaults, where failing costs nothing, full force into the track's end beats a
perfect swing-up.  It serves to repeat what was published, or with a large ``failure_cost``.

``"shaped"`` is what the shipped deep policies learned on: :func:`dpend.shaping.shaped_reward`.
"""

# ruff: noqa: ARG001  (rewards share one signature, whatever each looks at)

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import numpy.typing as npt

from .params import Array
from .rig import Rig, single_rig
from .shaping import Mixture, shaped_reward
from .suggest import suggestion
from .tasks import Balance, Codes, SwingUp, Task

Reward = Callable[[Array, Array, Array, Codes], npt.ArrayLike]
"""``f(x, u, x_next, codes)``: states ``(n, 6)``, forces applied ``(n,)`` in N, the states they led to and the status
codes of those, zero where the episode goes on; to rewards ``(n,)``."""

NAMES = ("default", "report", "shaped")


def reward_of(reward: str | Reward, task: Task, rig: Rig) -> Reward:
    """Return the function that pays for the steps of a task.

    Parameters
    ----------
    reward : {"default", "report", "shaped"} or callable
        Which; a function is returned as it is.  ``"default"`` of a task that is neither balancing nor a swing-up is
        minus its cost.
    task : Task
        The task.
    rig : Rig
        The rig or rigs; one where the reward is shaped.

    Raises
    ------
    TypeError, ValueError
        If it is neither a name nor a function, there is no reward of that name, or there are too many rigs.
    """
    if callable(reward):
        return reward
    if not isinstance(reward, str):
        raise TypeError(f"reward must be a name or a function f(x, u, x_next, codes); got {reward!r}.")
    if reward not in NAMES:
        raise ValueError(f"There is no reward {reward!r}.{suggestion(reward, NAMES)}")
    if reward == "shaped":
        return partial(_shaped, single_rig(rig, 'reward="shaped"'))
    asked = task.task if isinstance(task, Mixture) else task
    if reward == "default" and isinstance(asked, Balance):
        return _on
    if reward == "default" and isinstance(asked, SwingUp):
        slowness = np.atleast_1d(np.asarray((rig.params.length1 + rig.params.length2) / rig.params.gravity, float))
        return partial(_upright, asked.target_angles, slowness)
    return partial(_minus_cost, task)


# Functions of the module, so that an environment that keeps one can be copied and sent to other processes.


def _on(x: Array, u: Array, x_next: Array, codes: Codes) -> Array:
    return np.equal(codes, 0).astype(np.float64)


def _upright(
    target: tuple[float, float],
    slowness: Array,
    x: Array,
    u: Array,
    x_next: Array,
    codes: Codes,
) -> Array:
    from .kernels import upright_rewards  # numba loads with the first step, not with `import dpend`

    rewards = np.empty(len(codes))
    upright_rewards(x_next, codes, target, slowness, rewards)
    return rewards


def _shaped(rig: Rig, x: Array, u: Array, x_next: Array, codes: Codes) -> Array:
    return shaped_reward(rig, x_next, u, codes)


def _minus_cost(task: Task, x: Array, u: Array, x_next: Array, codes: Codes) -> Array:
    return -task.cost(x_next, codes)
