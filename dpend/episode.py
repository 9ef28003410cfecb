"""The rule of an episode, stated once: when it ends and how, what it costs, how long the links were up, what succeeds.

The functions take one state as six scalars.  :mod:`dpend.kernels` compiles them for the loops over a batch, by which
tasks judge, and for learners whose own compiled loop is sequential.  :class:`UprightClock` counts for batches as
:func:`counted` does for one run.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from .status import Status

if TYPE_CHECKING:
    from .params import Array
    from .rig import Rig
    from .tasks import Balance, SwingUp, Task

_TRACK_END, _LINK1_FELL, _LINK2_FELL, _NOT_FINITE = (
    status.code for status in (Status.TRACK_END, Status.LINK1_FELL, Status.LINK2_FELL, Status.NOT_FINITE)
)


class Rule(NamedTuple):
    """A task's numbers on a single rig, as compiled loops take them."""

    bounds: tuple[float, float, float]
    """Greatest distance from the middle, m, and greatest angle of link 1 and of link 2, rad."""
    target: tuple[float, float]
    """Angles of link 1 and of link 2 that are to be held, rad."""
    upright_angle: float
    """How near to them a link counts as up, rad."""
    hold: int
    """Samples for which both links must have been up at the end."""
    weights: tuple[float, float, float]
    """Weights of the report's cost."""
    failure_cost: float
    """What a failure costs."""


def rule_of(task: Balance | SwingUp, rig: Rig) -> Rule:
    """Return the rule of a task on a single rig, whose track and sample time count."""
    limit1, limit2 = task.angle_limits
    return Rule(
        bounds=(float(rig.track_limit), limit1, limit2),
        target=task.target_angles,
        upright_angle=float(getattr(task, "upright_angle", math.inf)),
        hold=samples_to_hold(task.hold, rig.sample_time),
        weights=task.state_weights,
        failure_cost=float(task.failure_cost),
    )


def status_code(x, bounds):
    """Return the status code of a state: zero within the bounds; NaN is outside every bound."""
    on_track = abs(x[0]) <= bounds[0]
    up1 = abs(x[1]) <= bounds[1]
    up2 = abs(x[2]) <= bounds[2]
    if on_track & up1 & up2:  # nearly always, so one test for all
        return 0
    for value in x:
        if not math.isfinite(value):
            return _NOT_FINITE
    if not on_track:
        return _TRACK_END
    return _LINK2_FELL if up1 else _LINK1_FELL


def make_report_cost(wrap_angle: Callable[..., Any]) -> Callable[..., Any]:
    r"""Return the report's cost, a function of a state, its code and a task's numbers.

    :math:`w \cdot (|p|, |n(\theta_1 - \theta_1^*)|, |n(\theta_2 - \theta_2^*)|)`, and a failure's cost beside it.
    """

    def report_cost(x, code, target, weights, failure_cost):
        cost = weights[0] * abs(x[0]) if weights[0] != 0.0 else 0.0  # without a weight, not even infinity costs
        cost = cost + weights[1] * abs(wrap_angle(x[1] - target[0])) + weights[2] * abs(wrap_angle(x[2] - target[1]))
        return cost + failure_cost if code != 0 else cost

    return report_cost


def make_links_upright(wrap_angle: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of a state that says whether both links are within an angle of where they are to be."""

    def links_upright(x, target, angle):
        return (abs(wrap_angle(x[1] - target[0])) <= angle) & (abs(wrap_angle(x[2] - target[1])) <= angle)

    return links_upright


def make_upright_reward(cos: Callable[..., Any], exp: Callable[..., Any]) -> Callable[..., Any]:
    r"""Return the default reward of a swing-up, :mod:`dpend.rewards`, as a function of a state and its status code.

    ``slowness`` is :math:`2L/g` with the mean length of the links.
    """

    def upright_reward(x, code, target, slowness):
        if code != 0:
            return 0.0
        far = 5.0 * (2.0 - cos(x[1] - target[0]) - cos(x[2] - target[1]))
        return 0.5 + 0.5 * exp(-far - slowness * (x[4] * x[4] + x[5] * x[5]))

    return upright_reward


def counted(held, upright):
    """Return for how many samples both links have been up without a break, -1 where they are not.

    An episode begins with ``counted(-1, upright)`` of its start: upright there, it has been up for no time yet.
    """
    return held + 1 if upright else -1


def succeeded(code, held, hold):
    """Return whether an episode of full length succeeded: it did not fail, and the links were up for long enough."""
    return (code == 0) & (held >= hold)


def samples_to_hold(hold: float, sample_time: float) -> int:
    """Return the least number of samples that last as long as a time in s, within 1 ns."""
    return math.ceil((hold - 1e-9) / sample_time)


class UprightClock:
    """How long the links of ``n`` runs have been upright without a break.

    Parameters
    ----------
    task : Task
        Says what is upright and for how long it must be; where it asks for no time, nothing is counted.
    rig : Rig
        Says how long a sample is.
    n : int
        Number of runs.

    Attributes
    ----------
    samples : ndarray (n,)
        How many samples, as :func:`counted` counts them; zero where the task does not ask.
    """

    def __init__(self, task: Task, rig: Rig, n: int) -> None:
        self.asked = task.hold > 0
        self.samples = np.zeros(n, dtype=np.int64)
        self._upright = task.upright
        self._hold = samples_to_hold(task.hold, rig.sample_time) if self.asked else 0

    def begin(self, x0: Array, rows: Any = slice(None)) -> None:
        """Begin to count in some rows, at states ``(len(rows), 6)``."""
        if self.asked:
            self.samples[rows] = np.where(self._upright(x0), 0, -1)

    def tick(self, x: Array) -> None:
        """Count a sample that led to states ``(n, 6)``."""
        if self.asked:
            self.samples += 1
            self.samples[~self._upright(x)] = -1

    def success(self, codes: npt.NDArray[np.uint8], rows: Any = slice(None)) -> npt.NDArray[np.bool_]:
        """Return which runs of full length, all or some rows, succeeded, by the status codes ``(n,)`` of all."""
        return succeeded(codes[rows], self.samples[rows], self._hold)
