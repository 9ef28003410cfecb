r"""Iterative LQR with a force box and multiple shooting: whole motions offline, and a receding horizon in real time.

A plan :math:`(x_0 \dots x_N, u_0 \dots u_{N-1})` is to cost little,

.. math::
    J = \sum_{k<N} \bigl( e(x_k)^\top Q\, e(x_k) + R u_k^2 + w(x_k) \bigr) + e(x_N)^\top P\, e(x_N) + w(x_N),
    \qquad x_{k+1} = f(x_k, u_k), \quad |u_k| \le F,

with the residuals :math:`e` of ``controllers/residuals.py``, :math:`P` of the LQR at the target, and walls :math:`w`
that rise quadratically within a margin of the track's end.  An iteration linearizes the sample :math:`f` along the
plan, gaps :math:`f(x_k, u_k) - x_{k+1}` included, runs the Riccati recursion back to front with the steps of the force
clamped to the box (a clamped force has no feedback), and follows the result through the plant; it is taken only if it
costs less.

Sources: Y. Tassa, N. Mansard and E. Todorov, *Control-limited differential dynamic programming*, ICRA 2014; M.
Giftthaler et al., *A family of iterative Gauss-Newton shooting methods for nonlinear optimal control*, IROS 2018; C.
Mastalli et al., *Crocoddyl*, ICRA 2020 (how gaps close).
"""

from __future__ import annotations

import math
from collections import ChainMap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dpend.arguments import checked_array, checked_flag, checked_positive, checked_seed, checked_whole, is_finite
from dpend.controller import Act
from dpend.laws import watch
from dpend.params import Array
from dpend.rig import Rig, single_rig
from dpend.rows import in_parts, row_generators
from dpend.state import as_equilibrium, as_states, one_state

from .ilqr_kernels import (
    PLANT,
    Flow,
    Guess,
    Loops,
    Plans,
    Problem,
    Setting,
    make_loops,
    nearest_target,
    nearest_turns,
    problem_at,
)
from .lqr import LQR
from .trajectory import Trajectory

_FIRST = 60  # iterations for each start of a first plan
_TRIALS = 8  # lengths of step tried in an iteration
_FINE, _COARSE = 1e-6, 1e-4  # relative gain below which a plan counts as converged; and one of several that are tried
_CHEAPER = 0.95  # share of the cost of the plan in use below which another takes over
_PATIENCE = 15  # samples for which a challenger is worked on
_HORIZON, _HORIZON_UPRIGHT = 6.26, 2.5  # in units of sqrt(L / g)
_GRAVITY = 9.81
_PACE, _MASS = 0.62, 1.75  # links of 1 m on a cart: their growth in units of sqrt(L / g), and mass times mobility
_MOST_STEPS = 1000  # samples in a horizon; more is a mistake of units


class Step(IntEnum):
    """What a receding horizon did in a sample: the numbers in its log under ``status``."""

    IMPROVED = 0
    """An iteration lowered the plan's cost."""
    CONVERGED = 1
    """There was nothing left to gain."""
    FELL_BACK = 2
    """No iteration lowered the cost: the previous plan goes on, by its own feedback gains."""
    PLANNED = 3
    """There was no plan yet, so one was made from several starts."""
    SWITCHED = 4
    """Another plan, kept beside the one in use, turned out to cost less and took its place."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Model:
    r"""A plant of one's own, :math:`x_{k+1} = \mathrm{step}(x_k, u_k, \mathrm{parameters})`, to plan on.

    The planner compiles it together with its own loops.

    Parameters
    ----------
    step : callable
        ``step(x, u, parameters)``: the six numbers of the next state, given a tuple of six and a force in N; in the
        Python that numba compiles, or compiled by it.
    parameters : tuple
        What ``step`` gets besides: numbers, arrays and tuples of them.  Models that differ in these alone share their
        machine code.
    linearize : callable, optional
        ``linearize(x, u, parameters, D)`` fills D (N, 6, 8) along states (N + 1, 6) and forces (N,): the slopes of each
        sample by the state, then by the force, and the gap ``step(x[k], u[k]) - x[k + 1]``.  Left out, central
        differences.
    sources : tuple of Path
        Files, or folders of them, that both are made of: then the machine code is kept on disk until one changes.
        Left out, it is compiled anew in each process.

    See Also
    --------
    controllers.ILQRMPC : Plan on it in every sample.
    controllers.ilqr : Plan on it once.

    Examples
    --------
    >>> from controllers import Model
    >>> def double_integrator(x, u, parameters):
    ...     return (x[0] + 0.02 * x[3], x[1], x[2], x[3] + 0.02 * u, x[4], x[5])
    >>> Model(step=double_integrator).slopes([0, 0, 0, 0, 0, 0])[1][3].round(6)
    array([0.02])
    """

    step: Callable[..., Any]
    parameters: tuple[Any, ...] = ()
    linearize: Callable[..., Any] | None = None
    sources: tuple[Path, ...] = ()

    @property
    def loops(self) -> Loops:
        """The compiled loops that follow it, made once for each ``step``."""
        return make_loops(self.step, self.linearize, self.sources)

    def slopes(self, x: npt.ArrayLike, u: float = 0.0) -> tuple[Array, Array]:
        r"""Return :math:`A = \partial\,\mathrm{step}/\partial x` (6, 6) and :math:`B` (6, 1) at a state and a force.

        They are those that the planner itself uses.

        Parameters
        ----------
        x : array_like (6,)
            The state.
        u : float
            The force, N.

        Returns
        -------
        A : ndarray (6, 6)
            A state on the next.
        B : ndarray (6, 1)
            The force on the next state.

        See Also
        --------
        dpend.linearize : Of the equations in continuous time.

        Examples
        --------
        >>> from controllers import Model
        >>> def double_integrator(x, u, parameters):
        ...     return (x[0] + 0.02 * x[3], x[1], x[2], x[3] + 0.02 * u, x[4], x[5])
        >>> Model(step=double_integrator).slopes([0, 0, 0, 0, 0, 0])[0][0, 3].round(6)
        np.float64(0.02)
        """
        states, D = np.tile(one_state("x", x), (2, 1)), np.empty((1, 6, 8))
        self.loops.linearize(states, np.array([float(u)]), self.parameters, D)
        return D[0, :, :6].copy(), D[0, :, 6:7].copy()


def ilqr(
    rig: Rig | str,
    x0: npt.ArrayLike,
    target: str | npt.ArrayLike = "up-up",
    *,
    model: Model | None = None,
    horizon: float | None = None,
    u_guess: npt.ArrayLike | None = None,
    x_guess: npt.ArrayLike | None = None,
    Q: Sequence[float] | None = None,
    R: float | None = None,
    upright_only: bool = False,
    starts: int = 8,
    iterations: int = 200,
    tolerance: float = 1e-6,
    seed: int = 0,
) -> Trajectory:
    r"""Plan :math:`\min_u \sum_k e_k^\top Q e_k + R u_k^2 + w_k + e_N^\top P e_N` from a state to an equilibrium.

    The same arguments give the same plan.  Without a guess, the plan is the cheapest of several: from the saturated
    regulator, from a straight line of states, and from random forces in mirrored pairs.

    Parameters
    ----------
    rig : Rig or str
        Plant, clock, force and track limits; actuator and sensors do not enter.
    x0 : array_like (6,)
        Where the motion starts.
    target : str or array_like (6,)
        The name of one of ``dpend.EQUILIBRIA``, or such a state with the cart anywhere on the track; any whole turn of
        it will do.
    model : Model, optional
        What moves in place of the rig's plant, of which clock and limits remain.  What is left out below then follows
        from its linearisation at the target: a length and a mass whose plant would be as fast and as heavy.
    horizon : float, optional
        Length of the plan, s, rounded to :math:`N` samples, from 2 to 1000; left out, :math:`6.26\sqrt{L/g}`, and
        :math:`2.5\sqrt{L/g}` with ``upright_only``, where :math:`L` is the mean length of the links: 2 s and 0.8 s for
        links of 1 m.
    u_guess : array_like (N,), optional
        Forces to start from, clipped to the limit; alone, they are followed through the plant.
    x_guess : array_like (N + 1, 6), optional
        States to start from; they need not be a motion, but begin at ``x0``.
    Q : sequence of six floats, optional
        Weights of the residuals, at least zero; left out, (10, 50, 50, 1, 1, 1), scaled from links of 1 m.
    R : float, optional
        Weight of the force, greater than zero; left out, 0.1, scaled from a plant of 2 kg by its weight.
    upright_only : bool
        Hold both links within a quarter turn of the target, by walls like the track's.
    starts : int
        Random starts, at least zero.
    iterations : int
        Most iterations for each start.
    tolerance : float
        Stop when an iteration promises to lower the cost by less than this share.
    seed : int
        Of the random starts.

    Returns
    -------
    Trajectory
        A motion of the plant within the force limit; ``about`` holds ``converged``, ``iterations``, ``cost``,
        ``starts_tried`` and the settings.

    Raises
    ------
    ValueError
        If an argument is out of range or has the wrong shape, or the rig describes several plants.

    See Also
    --------
    controllers.ILQRMPC : In every sample.
    controllers.optimize : With hard limits.

    Examples
    --------
    >>> import dpend
    >>> from controllers import ilqr
    >>> rig = dpend.rig("gustafsson2016")
    >>> plan = ilqr(rig, dpend.EQUILIBRIA["down-down"], horizon=2.5)
    >>> plan.x.shape[1]
    6
    """
    planner = _Planner(rig, target, horizon, Q, R, upright_only, model)
    start = one_state("x0", x0)
    seed = checked_seed("seed", seed)
    starts, iterations = checked_whole("starts", starts, 0), checked_whole("iterations", iterations, 0)
    if not (is_finite(tolerance) and tolerance >= 0):
        raise ValueError(f"tolerance must be finite and at least 0; got {tolerance!r}.")
    tolerance = float(tolerance)  # whole numbers would be compiled for once more
    states = start[None]
    if u_guess is None and x_guess is None:
        rngs = [np.random.default_rng(seed)]
        plans, tried = planner.cheapest(states, starts, rngs, min(iterations, _FIRST))
        guess, used, starts_tried = Guess.AS_IT_IS, int(plans.tried[0]), int(tried[0])
    else:
        plans = planner.guessed(start, u_guess, x_guess)
        guess, used, starts_tried = Guess.FOLLOWED if x_guess is None else Guess.AS_IT_IS, 0, 1
    planner.improve(plans, guess, states, max(iterations - used, 0), tolerance)
    x, u = plans.x[0], plans.u[0]
    return Trajectory(
        rig=planner.rig,
        x=x,
        u=u,
        target=np.array(nearest_target(tuple(x[-1]), problem_at(tuple(start), planner.setting.problem))),
        about={
            "method": "iLQR",
            "converged": bool(plans.converged[0]),
            "iterations": used + int(plans.tried[0]),
            "cost": float(plans.cost[0]),
            "starts_tried": starts_tried,
            "seed": seed,
            "Q": planner.Q.tolist(),
            "R": planner.R,
            "upright_only": upright_only,
        },
    )


class ILQRMPC:
    r"""Receding horizon: in each sample iLQR improves a plan over the next :math:`N`, and its first force is applied.

    A sample shifts the plan, follows it from the measured state with its feedback gains (an extra sample at its end is
    the saturated LQR's), and lowers its cost by at most ``iterations`` iterations.  Where none does, the plan that was
    followed stands: its own gains answer for the deviation.  The first plan is the cheapest of several starts, because
    hanging at rest the cost has no slope.  While the plan is still costly, two others are tried beside it and take over
    when they cost 5 % less: the saturated regulator's motion, and a challenger from random forces that is improved in
    the same way and replaced after 15 samples.  What makes a plan poor, such as a push, may come late.

    Parameters
    ----------
    rig : Rig or str
        What the planner believes: plant, clock, force and track limits.  Delay and noise are an estimator's business.
    target : str or array_like (6,)
        The name of one of ``dpend.EQUILIBRIA``, or such a state with the cart anywhere on the track.  The nearest whole
        turn counts, wherever the plan is.
    model : Model, optional
        What it plans on in place of the rig's own equations.
    horizon : float, optional
        Length of the plan, s; left out, in proportion to the links' own time.
    Q : array_like, optional
        Weights of the residuals, ``(6,)`` or ``(6, 6)``.
    R : float, optional
        Weight of the force; as of :func:`ilqr`, also where left out.
    iterations : int
        Most iterations a sample for a plan; with none, the first plan is followed by its gains and the regulator's.
    starts : int
        Random starts of the first plan, in mirrored pairs.
    explore : bool
        Whether a challenger from random forces is kept.
    upright_only : bool
        Hold both links within a quarter turn of the target, by walls like the track's: for balancing, where more is a
        failure.  The default horizon is then shorter; challengers are not made.

    Attributes
    ----------
    K : ndarray (1, 6)
        Gain of the regulator at the target, N per unit of each state.
    P : ndarray (6, 6)
        Weight of the end of the plan, of the same regulator.
    lqr : LQR or None
        The regulator itself; none with a model, whose gain and weight are those of a long horizon.
    horizon : float
        Length of the plan, s: a whole number of samples.
    horizon_steps : int
        :math:`N`.

    Raises
    ------
    ValueError
        If an argument is out of range, the rig describes several plants, or there is no regulator at the target.

    See Also
    --------
    controllers.ilqr : One plan, offline.
    controllers.NMPC : Hard limits, and slower.

    Notes
    -----
    ``act.log`` holds, sample by sample, ``status`` (:class:`controllers.ilqr.Step`), ``iterations`` and ``cost``.  The
    force is finite whatever is measured: a measurement that is not finite is replaced by the one planned for, and
    ``held`` in the log says where.  Angles are taken to the turn nearest to the plan.  From a state that no force keeps
    on the track, the plan leaves it as little as it can.

    Rows of a batch are planned for side by side in compiled code, by as many threads as the process has cores; in a
    worker process by one.  Each row's forces are, to the bit, those that it would have alone.

    Examples
    --------
    >>> import dpend
    >>> from controllers import ILQRMPC
    >>> rig = dpend.rig("gustafsson2016")
    >>> task = dpend.SwingUp(steps=300)
    >>> dpend.simulate(rig, ILQRMPC(rig), dpend.EQUILIBRIA["down-down"], task=task).success
    True
    """

    name = "iLQR MPC"
    starts_afresh = True

    def __init__(
        self,
        rig: Rig | str,
        *,
        target: str | npt.ArrayLike = "up-up",
        model: Model | None = None,
        horizon: float | None = None,
        Q: Sequence[float] | None = None,
        R: float | None = None,
        iterations: int = 2,
        starts: int = 16,
        explore: bool = True,
        upright_only: bool = False,
    ) -> None:
        self._planner = _Planner(rig, target, horizon, Q, R, upright_only, model)
        self.rig = self._planner.rig
        self.lqr, self.K, self.P = self._planner.lqr, self._planner.K, self._planner.P
        self.horizon_steps = self._planner.N
        self.horizon = self.horizon_steps * self.rig.sample_time
        self.iterations, self.starts = checked_whole("iterations", iterations, 0), checked_whole("starts", starts, 0)
        self.explore = checked_flag("explore", explore) and not upright_only

    def start(self, n: int, rng: np.random.Generator) -> Act:
        """Return the law for ``n`` runs; each row draws as it would alone, see :func:`dpend.rows.row_generators`."""
        return _Horizons(self._planner, row_generators(rng, n), self)


# ---------------------------------------------------------------------------------------------------- planner and plans


class _Planner:
    """A rig, a target and their weights: what all plans have in common."""

    def __init__(
        self,
        rig: Rig | str,
        target: str | npt.ArrayLike,
        horizon: float | None,
        Q: Sequence[float] | None,
        R: float | None,
        upright_only: bool,
        model: Model | None = None,
    ) -> None:
        rig = single_rig(rig, "iLQR")
        self.target = as_equilibrium(target)
        if not (model is None or isinstance(model, Model)):
            raise TypeError(f"model must be a controllers.Model, or None for the rig's plant; got {model!r}.")
        checked_flag("upright_only", upright_only)
        params, here = rig.params, None
        if model is None:
            g, L = float(params.gravity), float(params.length1 + params.length2) / 2
            mass, self.loops = float(params.coefficients().d1), PLANT
            c = params.coefficients()
            parameters: Any = Flow(c._make(map(float, c)), rig.sample_time / rig.substeps, rig.substeps)
        else:
            here, self.loops, parameters = model.slopes(self.target), model.loops, model.parameters
            g, L, mass = _scales(*here, rig.sample_time)
        if g == 0 and (horizon is None or Q is None or R is None):
            raise ValueError("Without gravity there is no scale of time and force: give horizon, Q and R.")
        # Of (10, 50, 50, 1, 1, 1) and 0.1 for links of 1 m and a plant of 2 kg, by dimensional analysis.
        if Q is None:
            Q = (10 / L**2, 50.0, 50.0, 9.81 / (g * L), 9.81 * L / g, 9.81 * L / g)
        self.Q = checked_array("Q", Q, "six weights").copy()
        if self.Q.shape != (6,) or (self.Q < 0).any():
            raise ValueError(f"Q must be six finite weights, at least 0, of pos, th1, th2, vel, om1, om2; got {Q!r}.")
        self.R = 0.1 * (2 * 9.81 / (mass * g)) ** 2 if R is None else checked_positive("R", R)
        self.rig = rig
        if horizon is None:
            scale = _HORIZON_UPRIGHT if upright_only else _HORIZON
            self.N = max(round(scale * math.sqrt(L / g) / rig.sample_time), 2)
        else:
            self.N = _steps(horizon, rig.sample_time)
        self.upright_only = bool(upright_only)
        self.lqr: Any = LQR(rig, self.Q, self.R, target=self.target) if here is None else None
        self.K, self.P = regulator(*here, self.Q, self.R) if here else (self.lqr.K, np.array(self.lqr.P))
        soft_track = float(rig.track_limit) * (1 - 1 / 16)  # 0.15 m of 2.4 m
        if not abs(self.target[0]) < soft_track:
            raise ValueError(
                f"The target must be clear of the track's end: expected |pos| < {soft_track:g} m; "
                f"got {self.target[0]:g} m."
            )
        problem = Problem(
            force_limit=float(rig.force_limit),
            target=tuple(self.target.tolist()),
            turn=0.0 if upright_only else 2 * math.pi,
            Q=tuple(self.Q.tolist()),
            R=float(self.R),
            soft_track=soft_track,
            track_weight=1e4 / L**2,
            hard_track=float(rig.track_limit) * (1 - 1 / 2000),
            hard_weight=0.0,
            soft_angle=math.pi / 2 - 0.15 if upright_only else math.inf,
            angle_weight=1e4 if upright_only else 0.0,
        )
        # Random guesses: forces of the size of the plant's weight, held for a third of sqrt(L / g), on a cart that is
        # drawn to where it should be.
        pace = math.sqrt(L / g) if g > 0 else self.N * rig.sample_time / _HORIZON
        stiffness = 0.64 / pace
        self.setting = Setting(
            problem=problem,
            parameters=parameters,
            P=self.P,
            feedback=-self.K[0],
            push=0.5 * min(float(rig.force_limit), 2 * mass * L / pace**2),
            hold=max(1, round(0.375 * pace / rig.sample_time)),
            centring=np.array([-mass * stiffness**2, 0.0, 0.0, -2 * mass * stiffness, 0.0, 0.0]),
            line=np.linspace(0.0, 1.0, self.N + 1),
        )
        self.settled = 20.0 * float(self.Q[1] + self.Q[2])
        """Cost of five samples upside down: a plan that costs less has no challengers."""

    def improve(
        self,
        plans: Plans,
        guess: Guess,
        states: Array,
        iterations: int,
        tolerance: float,
        *,
        which: npt.NDArray[np.intp] | None = None,
        least: int = 4,
        noise: Array | None = None,
        limits: Array | None = None,
    ) -> None:
        """Improve plans in place, all or some, each from a guess; see ``improve`` of the compiled loops."""
        rows = np.arange(len(plans.u)) if which is None else which
        drawn = np.zeros((len(rows), 1)) if noise is None else noise
        bounds = np.full(len(rows), math.inf) if limits is None else limits

        def part(first: int, last: int) -> None:
            self.loops.improve(
                first,
                last,
                rows,
                int(guess),
                states,
                drawn,
                bounds,
                plans,
                self.setting,
                iterations,
                tolerance,
                _TRIALS,
            )

        in_parts(part, len(rows), least)

    def draw(self, rng: np.random.Generator, guesses: int) -> Array:
        """Draw the numbers (guesses, N / hold) that make random guesses."""
        return rng.standard_normal((guesses, -(-self.N // self.setting.hold)))

    def cheapest(
        self, states: Array, starts: int, rngs: Sequence[np.random.Generator], iterations: int
    ) -> tuple[Plans, npt.NDArray[np.int64]]:
        """Return the cheapest plan of several starts from each state, and their number.

        Random ones, in mirrored pairs, are tried where the others are costly.
        """
        n = len(states)
        plans, tried = Plans.blank(n, self.N), np.full(n, 2)
        self.improve(plans, Guess.REGULATED, states, iterations, _COARSE, least=1)
        other = Plans.blank(n, self.N)
        self.improve(other, Guess.STRAIGHT, states, iterations, _COARSE, least=1)
        plans.take_cheaper(np.arange(n), other)
        costly = np.flatnonzero(~(plans.cost <= self.settled))
        if len(costly) and starts:
            noise = np.stack([self.draw(rngs[i], -(-starts // 2)) for i in costly.tolist()])
            other = Plans.blank(len(costly), self.N)
            for k in range(noise.shape[1]):
                for sign in (1.0, -1.0):
                    self.improve(
                        other, Guess.DRIVEN, states[costly], iterations, _COARSE, least=1, noise=sign * noise[:, k]
                    )
                    plans.take_cheaper(costly, other)
            tried[costly] += 2 * noise.shape[1]
        return plans, tried

    def guessed(self, x0: Array, u_guess: npt.ArrayLike | None, x_guess: npt.ArrayLike | None) -> Plans:
        """Return the plan that a caller guesses."""
        N, plans = self.N, Plans.blank(1, self.N)
        if u_guess is not None:
            u = checked_array("u_guess", u_guess, f"forces ({N},)")
            if u.shape != (N,):
                raise ValueError(f"u_guess must be finite forces of shape ({N},), one a sample; got shape {u.shape}.")
            plans.u[0] = np.clip(u, -float(self.rig.force_limit), float(self.rig.force_limit))
        if x_guess is not None:
            x = checked_array("x_guess", x_guess, f"states ({N + 1}, 6)")
            if x.shape != (N + 1, 6):
                raise ValueError(f"x_guess must be states of shape ({N + 1}, 6); got shape {x.shape}.")
            plans.x[0] = as_states(x)
            plans.x[0, 0] = x0
        return plans


class _Horizons:
    """The law at work: of each row the plan in use, the challenger, and the log."""

    def __init__(self, planner: _Planner, rngs: list[np.random.Generator], mpc: ILQRMPC) -> None:
        n = len(rngs)
        self._record: dict[str, list[Array]] = {"status": [], "iterations": [], "cost": []}
        held, self._missing_in = watch(n)
        self.log: ChainMap[str, list[Array]] = ChainMap(self._record, held)
        self._planner, self._rngs = planner, rngs
        self._iterations, self._starts, self._explore = mpc.iterations, mpc.starts, mpc.explore
        self._everywhere = np.ones(n, dtype=np.bool_)
        self._nowhere = np.zeros(n, dtype=np.bool_)
        self._planned = np.zeros(n, dtype=np.bool_)
        self.plans = Plans.blank(n, planner.N)
        self.challengers = Plans.blank(n if mpc.explore else 0, planner.N)
        self._age = np.full(n, -1)  # samples for which a challenger was worked on; there is none at -1

    def __call__(self, t: float, y: Array) -> Array:
        return self.among(t, y, self._everywhere)

    def among(self, t: float, y: Array, rows: npt.NDArray[np.bool_]) -> Array:
        """Return the forces where the law is in charge; the other rows forget their plans, and take no time."""
        n, plans, planner = len(rows), self.plans, self._planner
        missing = self._missing_in(y)
        missing = self._nowhere if missing is None else missing
        self._planned &= rows
        self._age[~rows] = -1
        going, beginning = np.flatnonzero(self._planned), np.flatnonzero(rows & ~self._planned & ~missing)
        status, iterations, cost = np.full(n, float(Step.FELL_BACK)), np.zeros(n), np.full(n, math.nan)
        forces = np.zeros(n)
        if len(beginning):
            first, _ = planner.cheapest(y[beginning], self._starts, [self._rngs[i] for i in beginning.tolist()], _FIRST)
            plans.take(beginning, first)
            self._planned[beginning], status[beginning] = True, Step.PLANNED
            iterations[beginning] = first.tried
        if len(going):
            states = np.array(y, dtype=np.float64)
            nearest_turns(going, states, missing, plans.x)
            planner.improve(plans, Guess.CARRIED_ON, states, self._iterations, _FINE, which=going)
            improved = np.where(plans.accepted[going] > 0, Step.IMPROVED, Step.FELL_BACK)
            status[going] = np.where(plans.converged[going], Step.CONVERGED, improved)
            iterations[going] = plans.tried[going]
            costly = going[(plans.cost[going] > planner.settled) & ~missing[going]]
            if len(costly) and self._iterations:
                status[self._challenged(costly, states)] = Step.SWITCHED
        answered = self._planned
        forces[answered], cost[answered] = plans.u[answered, 0], plans.cost[answered]
        for name, entry in zip(self._record, (status, iterations, cost), strict=True):
            self._record[name].append(entry)
        return forces

    def _challenged(self, costly: npt.NDArray[np.intp], states: Array) -> npt.NDArray[np.intp]:
        """Try the regulator, and improve the challengers for a sample; return the rows where one took over."""
        planner, plans, others = self._planner, self.plans, self.challengers
        limits = _CHEAPER * plans.cost
        regulated = Plans.blank(len(costly), planner.N)
        planner.improve(regulated, Guess.REGULATED, states[costly], self._iterations, _FINE, limits=limits[costly])
        passed_by = regulated.cost < limits[costly]  # a plan may well pass the target by
        plans.take(costly[passed_by], regulated, passed_by)
        if not self._explore:
            return costly[passed_by]
        costly, taken = costly[~passed_by], costly[passed_by]
        old, new = costly[self._age[costly] >= 0], costly[self._age[costly] < 0]
        better = old[:0]
        if len(old):
            planner.improve(others, Guess.CARRIED_ON, states, self._iterations, _FINE, which=old)
            self._age[old] += 1
            better = old[others.cost[old] < limits[old]]
            plans.take(better, others, better)
            self._age[old[others.converged[old] | (self._age[old] >= _PATIENCE)]] = -1
            self._age[better] = -1
        if len(new):
            noise = np.concatenate([planner.draw(self._rngs[i], 1) for i in new.tolist()])
            sign = np.where(plans.u[new, 0] >= 0, 1.0, -1.0)  # so a mirrored run mirrors
            planner.improve(
                others, Guess.DRIVEN, states, self._iterations, _COARSE, which=new, noise=sign[:, None] * noise
            )
            self._age[new] = 0
        return np.concatenate([taken, better])


def _scales(A: Array, B: Array, sample_time: float) -> tuple[float, float, float]:
    """Return gravity, and the length and mass of the plant with rods whose linearisation is as fast and as heavy.

    Far from any such plant, as a model fitted to little may be, they are those of the nearest between .1 and 4 m.
    """
    paces = np.sort(np.abs(np.log(np.linalg.eigvals(A).astype(complex) + 1e-12)))[-4:] / sample_time
    length = _GRAVITY / (_PACE * np.exp(np.log(paces).mean())) ** 2
    return _GRAVITY, float(np.clip(length, 0.1, 4.0)), _MASS * sample_time / max(abs(float(B[3, 0])), 1e-6)


def regulator(A: Array, B: Array, Q: Array, R: float) -> tuple[Array, Array]:
    r"""Return the gain and the weight after :math:`2^{10}` Riccati steps from :math:`P = Q`, by doubling.

    With weights :math:`Q` on the diagonal.  Where the equation has a stabilizing solution this is it, to rounding;
    elsewhere, as for a model that was fitted to little, the steps stop short of overflow.

    Source: B. Anderson, *Second-order convergent algorithms for the steady-state Riccati equation*, 1978.
    """
    F, G, P, eye = A, B @ B.T / R, np.diag(Q).astype(np.float64), np.eye(len(A))
    for _ in range(10):
        W = np.linalg.inv(eye + G @ P)
        new = F @ W @ F, G + F @ W @ G @ F.T, P + F.T @ P @ W @ F
        if not all(np.abs(each).max() < 1e12 for each in new):
            break
        F, G, P = new
        P = (P + P.T) / 2
    return np.asarray(np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A), dtype=np.float64), P


def _steps(horizon: float, sample_time: float) -> int:
    """Return a horizon in samples."""
    if is_finite(horizon) and 2 <= round(horizon / sample_time) <= _MOST_STEPS:
        return round(horizon / sample_time)
    least, most = 2 * sample_time, _MOST_STEPS * sample_time
    message = f"horizon must be from {least:g} to {most:g} s, 2 to {_MOST_STEPS} samples; got {horizon!r}."
    if is_finite(horizon) and horizon > most:
        message += f" If samples are meant, that is horizon={horizon * sample_time:g}."
    raise ValueError(message)
