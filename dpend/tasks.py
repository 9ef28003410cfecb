"""Tasks: where an episode starts, what it costs, when it fails, when it has succeeded."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import ModuleType
from typing import Protocol

import numpy as np
import numpy.typing as npt

from .arguments import checked_generator, checked_name, checked_positive, checked_whole, is_finite
from .deprecation import renamed_arguments, renamed_exports
from .params import Array
from .rig import Rig, as_rig
from .state import EQUILIBRIA, as_equilibrium, state_rows
from .suggest import suggests

Codes = npt.NDArray[np.uint8]


class Task(Protocol):
    """What the simulation and the environments ask of a task.

    A class with these methods is a task; nothing need be inherited.  Methods take and return whole batches.

    Parameters
    ----------
    *args, **kwargs : Any
        A task is built as its class says; the protocol asks for nothing.

    See Also
    --------
    dpend.Balance : Keep both links up.
    dpend.SwingUp : Bring them up.

    Examples
    --------
    >>> import dpend
    >>> rig = dpend.rig("gustafsson2016")
    >>> task: dpend.Task = dpend.Balance(lam=0.2)
    >>> task.steps
    300
    """

    @property
    def steps(self) -> int | None:
        """Greatest number of samples in an episode, or None for no limit."""
        ...

    @property
    def hold(self) -> float:
        """Seconds that both links must have been upright at the end of a successful run."""
        ...

    def starts(self, rng: np.random.Generator, n: int, rig: Rig) -> Array:
        """Draw ``n`` initial states ``(n, 6)``.

        One generator gives the same starts whatever runs from them, so that comparisons are paired.

        Parameters
        ----------
        rng : numpy.random.Generator
            What the starts are drawn from.
        n : int
            How many.
        rig : Rig
            The rig, whose track they lie on.

        Returns
        -------
        ndarray (n, 6)
            The states.

        See Also
        --------
        dpend.Balance.starts : For instance.

        Examples
        --------
        >>> import numpy as np
        >>> import dpend
        >>> rig = dpend.rig("gustafsson2016")
        >>> dpend.SwingUp().starts(np.random.default_rng(0), 2, rig)[:, 1:3].round(2)
        array([[3.14, 3.14],
               [3.14, 3.14]])
        """
        ...

    def ended(self, x: Array, rig: Rig) -> Codes:
        """Return the status codes ``(n,)`` of states ``(n, 6)``; zero where the episode goes on.

        The environments and the simulation stop a row where it is not zero.

        Parameters
        ----------
        x : ndarray (n, 6)
            States.
        rig : Rig
            The rig, whose track ends.

        Returns
        -------
        ndarray (n,)
            ``Status.code`` of each, whole numbers.

        See Also
        --------
        dpend.Status : What the codes stand for.

        Examples
        --------
        >>> import numpy as np
        >>> import dpend
        >>> rig = dpend.rig("gustafsson2016")
        >>> dpend.Balance().ended(np.array([[0, 2.0, 0, 0, 0, 0]]), rig)[0] == dpend.Status.LINK1_FELL.code
        np.True_
        """
        ...

    def upright(self, x: Array) -> npt.NDArray[np.bool_]:
        """Return which states ``(n, 6)`` have both links up.

        Success of a swing-up is counted with it.

        Parameters
        ----------
        x : ndarray (n, 6)
            States.

        Returns
        -------
        ndarray (n,) of bool
            Whether both links are up.

        See Also
        --------
        dpend.SwingUp : Succeeds by being upright for good.

        Examples
        --------
        >>> import numpy as np
        >>> import dpend
        >>> rig = dpend.rig("gustafsson2016")
        >>> dpend.SwingUp().upright(np.zeros((1, 6)))
        array([ True])
        """
        ...

    def cost(self, x: Array, codes: Codes) -> Array:
        """Return the cost ``(n,)`` of arriving in states ``(n, 6)`` with those status codes.

        Learners that are paid in the report's way are paid its negative.

        Parameters
        ----------
        x : ndarray (n, 6)
            States.
        codes : ndarray (n,)
            Status codes of the same states, zero where the episode goes on.

        Returns
        -------
        ndarray (n,)
            The costs, in units of ``state_weights``.

        See Also
        --------
        dpend.tasks.ReportCost : The report's cost.

        Examples
        --------
        >>> import numpy as np
        >>> import dpend
        >>> rig = dpend.rig("gustafsson2016")
        >>> task = dpend.Balance(state_weights=(0, 10, 10))
        >>> task.cost(np.array([[0, 0.1, -0.1, 0, 0, 0]]), np.zeros(1, dtype=int)).round(6)
        array([2.])
        """
        ...


def checked_task(task: Task) -> Task:
    """Return a task; refuse what is none, a class of tasks included."""
    if isinstance(task, type):
        raise TypeError(f"Expected a task such as dpend.Balance(); got the class {task.__name__}. Call it first.")
    if not all(hasattr(task, name) for name in ("steps", "hold", "starts", "ended", "upright", "cost")):
        raise TypeError(f"Expected a task such as dpend.Balance(); got {task!r}.")
    return task


@cache
def _kernels() -> ModuleType:
    """Load numba with the first state judged, not with `import dpend`."""
    from . import kernels

    return kernels


def _rows(x: npt.ArrayLike) -> Array:
    """Return states as rows ``(n, 6)``; those that simulations ask about hundreds of times pass at once."""
    if isinstance(x, np.ndarray) and x.ndim == 2 and x.shape[1] == 6 and x.dtype == np.float64:
        return x
    states = state_rows("x", x)
    if states.ndim > 2:
        raise ValueError(f"Expected states (n, 6); got shape {states.shape}.")
    return np.atleast_2d(states)


def _codes(x: Array, rig: Rig, limit1: float, limit2: float) -> Codes:
    """Return status codes for the ends of the track and bounds on the angles."""
    x = _rows(x)
    codes = np.empty(len(x), dtype=np.uint8)
    _kernels().status_codes(x, rig.track_limit, limit1, limit2, codes)
    return codes


@dataclass(frozen=True, kw_only=True)
class ReportCost:
    r"""The report's two costs: :math:`w \cdot (|p|, |n(\theta_1)|, |n(\theta_2)|)` for a state, and one for failing.

    :math:`n` is the difference to the nearest whole turn; a swing-up with another target counts from its angles.  The
    report prints neither weight; the defaults follow the code published with it, which weighs the angles by 10 and has
    no cost for failing.

    Parameters
    ----------
    state_weights : tuple of three floats
        Weights of position (per m) and of both angles (per rad), at least zero.
    failure_cost : float
        Cost of an episode that fails, at least zero.

    Raises
    ------
    ValueError
        If there are not three weights, or a number is negative or not finite.
    """

    state_weights: tuple[float, float, float] = (0.0, 10.0, 10.0)
    failure_cost: float = 0.0

    def __post_init__(self) -> None:
        weights = np.asarray(self.state_weights, dtype=object)
        if weights.shape != (3,) or not all(is_finite(weight) and weight >= 0 for weight in weights):
            raise ValueError(
                f"state_weights must be three finite numbers, at least 0, for |pos|, |th1| and |th2|; "
                f"got {self.state_weights!r}."
            )
        if not (is_finite(self.failure_cost) and self.failure_cost >= 0):
            raise ValueError(f"failure_cost must be finite and at least 0; got {self.failure_cost!r}.")
        object.__setattr__(self, "state_weights", tuple(map(float, weights)))

    def cost(self, x: Array, codes: Codes) -> Array:
        """Return the cost ``(n,)`` of arriving in states ``(n, 6)`` with those status codes."""
        x = _rows(x)
        costs = np.empty(len(x))
        _kernels().report_costs(x, codes, self.target_angles, self.state_weights, self.failure_cost, costs)
        return costs

    @property
    def target_angles(self) -> tuple[float, float]:
        """Angles of link 1 and of link 2 from which the cost is counted, rad; upright unless a task says otherwise."""
        return 0.0, 0.0

    @property
    def angle_limits(self) -> tuple[float, float]:
        """Greatest absolute angle of link 1 and of link 2, rad; none unless a task says otherwise."""
        return math.inf, math.inf

    def ended(self, x: Array, rig: Rig) -> Codes:
        """Return status codes: the track's end, a fallen link, or zero."""
        return _codes(x, rig, *self.angle_limits)


@suggests
@dataclass(frozen=True, kw_only=True)
class Balance(ReportCost):
    r"""Keep both links up, from :math:`\theta_1, \theta_2 \sim U[-\lambda, \lambda]` with all else zero.

    An episode fails at the end of the track or when a link falls, :math:`|\theta_i| > \pi/2`, and succeeds if it lasts.

    Parameters
    ----------
    state_weights : (float, float, float)
        Cost of the position, m, and of both angles, rad, as :class:`dpend.tasks.ReportCost` sums them.
    failure_cost : float
        Cost of a failure, at least zero.
    lam : float
        :math:`\lambda`, rad, above zero and at most :math:`\pi/2`.
    lam2 : float, optional
        That of link 2, rad, where it is another; zero starts link 2 upright.
    steps : int
        Samples in a full episode; the report's 300.
    criterion : {"strict", "report"}
        ``"report"`` looks at link 1 alone, as the report does; a controller that lets link 2 swing round then counts
        as balancing.

    Raises
    ------
    ValueError
        If a value is out of its range.

    See Also
    --------
    dpend.SwingUp : The other task.
    dpend.simulate_many : Run a controller from many of its starts.

    Examples
    --------
    >>> import numpy as np
    >>> import dpend
    >>> rig = dpend.rig("gustafsson2016")
    >>> task = dpend.Balance(lam=0.3)
    >>> task.starts(np.random.default_rng(0), 4, rig).shape
    (4, 6)
    """

    lam: float = 0.1
    lam2: float | None = None
    steps: int = 300
    criterion: str = "strict"

    def __post_init__(self) -> None:
        super().__post_init__()
        check_lam(self.lam)
        if self.lam2:
            check_lam(self.lam2)
        checked_whole("steps", self.steps)
        checked_name("criterion", self.criterion, ("strict", "report"))

    @property
    def hold(self) -> float:
        """Balancing succeeds by lasting; no time upright is asked for beside it."""
        return 0.0

    @property
    def angle_limits(self) -> tuple[float, float]:
        """Greatest absolute angle of link 1 and of link 2, rad."""
        return math.pi / 2, math.pi / 2 if self.criterion == "strict" else math.inf

    @property
    def angle_spreads(self) -> tuple[float, float]:
        """Greatest starting angle of link 1 and of link 2, rad."""
        return self.lam, self.lam if self.lam2 is None else self.lam2

    def starts(self, rng: np.random.Generator, n: int, rig: Rig) -> Array:
        """Draw ``n`` initial states; one generator gives the same directions for every lambda."""
        x = np.zeros((checked_whole("n", n, least=0), 6))
        x[:, 1:3] = self.angle_spreads * checked_generator("rng", rng).uniform(-1.0, 1.0, (n, 2))
        return x

    def upright(self, x: Array) -> npt.NDArray[np.bool_]:
        """Return that every state counts: balancing asks for nothing but to last."""
        return np.ones(len(_rows(x)), dtype=np.bool_)


def check_lam(lam: float) -> None:
    r"""Refuse a greatest starting angle unless :math:`0 < \lambda \le \pi/2`: up to the horizontal."""
    if not (is_finite(lam) and 0 < lam <= math.pi / 2):
        raise ValueError(f"lambda is the greatest starting angle in rad: expected 0 < lambda <= pi/2; got {lam!r}.")


STARTS: Mapping[str, Array] = {
    "hanging": EQUILIBRIA["down-down"],
    "side": np.array([0.0, math.pi / 2, math.pi / 2, 0.0, 0.0, 0.0]),
    **EQUILIBRIA,
}
"""States at rest ``(6,)`` by name, from which a swing-up may start."""


@renamed_arguments(spread="angle_spread")
@suggests
@dataclass(frozen=True, kw_only=True)
class SwingUp(ReportCost):
    r"""Bring both links up from below, or from any equilibrium to another, and keep them there.

    An episode fails at the end of the track only, and succeeds if both links were at the target's angles without a
    break for its last ``hold`` seconds.

    Parameters
    ----------
    state_weights : (float, float, float)
        Cost of the position, m, and of both angles, rad, as :class:`dpend.tasks.ReportCost` sums them.
    failure_cost : float
        Cost of a failure, at least zero.
    start : str
        "hanging", both links down; "side", both horizontal on the positive side, :math:`(\pi/2, \pi/2)`, as in the
        report; the name of one of ``dpend.EQUILIBRIA``; or "anywhere": angles :math:`U[-\pi, \pi]`, the cart within
        half the track (1 m where it is unlimited), rates :math:`\mathcal N(0, 1)` in m/s and rad/s.
    target : str
        The name of the equilibrium that is to be reached; wherever it says "upright" here, this is meant.
    angle_spread : float
        Each angle of a start at rest is moved by :math:`U[-s, s]`, rad.
    steps : int
        Samples in a full episode; the report's 1000.
    hold : float
        Time upright that makes a success, s; a run shorter than that cannot succeed.
    upright_angle : float
        A link counts as up within this angle of where it is to be, rad.

    Raises
    ------
    ValueError
        If a value is out of its range.

    See Also
    --------
    dpend.Balance : The other task.
    dpend.EQUILIBRIA : The four states at rest by name.

    Examples
    --------
    >>> import dpend
    >>> rig = dpend.rig("gustafsson2016")
    >>> from controllers import TVLQR
    >>> task = dpend.SwingUp(steps=300)
    >>> run = dpend.simulate(rig, TVLQR(rig), dpend.EQUILIBRIA["down-down"], task=task)
    >>> run.success
    True
    """

    start: str = "hanging"
    target: str = "up-up"
    angle_spread: float = 0.0
    steps: int = 1000
    hold: float = 1.0
    upright_angle: float = 0.2

    def __post_init__(self) -> None:
        super().__post_init__()
        checked_whole("steps", self.steps)
        checked_name("start", self.start, (*STARTS, "anywhere"))
        if not isinstance(self.target, str):
            raise ValueError(
                f"target must be the name of an equilibrium, {', '.join(EQUILIBRIA)}; got {self.target!r}."
            )
        as_equilibrium(self.target)
        if not (is_finite(self.angle_spread) and 0 <= self.angle_spread <= math.pi):
            raise ValueError(f"angle_spread must be within 0 and pi rad; got {self.angle_spread!r}.")
        checked_positive("hold", self.hold, "s")
        if not (is_finite(self.upright_angle) and 0 < self.upright_angle < math.pi):
            raise ValueError(f"upright_angle must be between 0 and pi rad; got {self.upright_angle!r}.")

    @property
    def target_angles(self) -> tuple[float, float]:
        """Angles of link 1 and of link 2 that are to be reached, rad."""
        _, th1, th2, *_ = as_equilibrium(self.target).tolist()
        return th1, th2

    def starts(self, rng: np.random.Generator, n: int, rig: Rig) -> Array:
        """Draw ``n`` initial states."""
        checked_whole("n", n, least=0)
        checked_generator("rng", rng)
        if self.start == "anywhere":
            x = rng.normal(size=(n, 6))
            track = np.asarray(as_rig(rig).track_limit)
            reach = np.where(np.isfinite(track), 0.5 * track, 1.0)
            x[:, 0] = reach * rng.uniform(-1.0, 1.0, n)
            x[:, 1:3] = rng.uniform(-np.pi, np.pi, (n, 2))
            return x
        x = np.zeros((n, 6))
        x[:, 1:3] = STARTS[self.start][1:3] + self.angle_spread * rng.uniform(-1.0, 1.0, (n, 2))
        return x

    def upright(self, x: Array) -> npt.NDArray[np.bool_]:
        """Return which states have both links within ``upright_angle`` of the target's angles."""
        x = _rows(x)
        upright = np.empty(len(x), dtype=np.bool_)
        _kernels().rows_upright(x, self.target_angles, self.upright_angle, upright)
        return upright


@dataclass(frozen=True, kw_only=True)
class NoTask:
    """No task at all: a run ends at the track's end, and otherwise when its time is up."""

    @property
    def steps(self) -> None:
        """There is no limit."""
        return None

    @property
    def hold(self) -> float:
        """Nothing need be upright."""
        return 0.0

    def starts(self, rng: np.random.Generator, n: int, rig: Rig) -> Array:
        """Return ``n`` states at rest, hanging."""
        return np.tile(EQUILIBRIA["down-down"], (n, 1))

    def ended(self, x: Array, rig: Rig) -> Codes:
        """Return status codes: the track's end, or zero."""
        return _codes(x, rig, math.inf, math.inf)

    def upright(self, x: Array) -> npt.NDArray[np.bool_]:
        """Ask nothing of the links."""
        return np.ones(len(_rows(x)), dtype=np.bool_)

    def cost(self, x: Array, codes: Codes) -> Array:
        """Nothing costs anything."""
        return np.zeros(len(_rows(x)))


__getattr__ = renamed_exports(__name__, {"Unending": "NoTask"}, globals())
