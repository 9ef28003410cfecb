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
from copy import copy
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from dpend.arguments import checked_array, checked_positive, checked_seed, checked_whole, is_finite
from dpend.controller import Act
from dpend.params import Array
from dpend.rig import Rig, single_rig
from dpend.state import as_equilibrium, as_states, one_state

from .ilqr_kernels import NO_GAPS, PLANT, Flow, Loops, Problem, make_loops, nearest_target
from .lqr import LQR
from .trajectory import Trajectory
from .wrapping import watch

_FIRST = 60  # iterations for each start of a first plan
_COARSE = 1e-4  # relative gain below which one of several plans counts as converged
_TRIALS = 8  # lengths of step tried in an iteration
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
        r"""Return :math:`A = \partial\,\mathrm{step}/\partial x` (6, 6) and :math:`B` (6, 1) at a state and a force."""
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
    """
    planner = _Planner(rig, target, horizon, Q, R, upright_only, model)
    start = one_state("x0", x0)
    seed = checked_seed("seed", seed)
    starts, iterations = checked_whole("starts", starts, 0), checked_whole("iterations", iterations, 0)
    if not (is_finite(tolerance) and tolerance >= 0):
        raise ValueError(f"tolerance must be finite and at least 0; got {tolerance!r}.")
    tolerance = float(tolerance)  # whole numbers would be compiled for once more
    problem = planner.problem_at(start)
    if u_guess is None and x_guess is None:
        plan, tried = planner.best_of_several(start, starts, np.random.default_rng(seed), iterations, _COARSE)
    else:
        plan, tried = planner.guessed(problem, start, u_guess, x_guess), 1
    used = plan.iterations
    plan = planner.improved(problem, plan, max(iterations - used, 0), tolerance)
    return Trajectory(
        rig=planner.rig,
        x=plan.x,
        u=plan.u,
        target=np.array(nearest_target(tuple(plan.x[-1]), problem)),
        about={
            "method": "iLQR",
            "converged": plan.converged,
            "iterations": used + plan.iterations,
            "cost": plan.cost,
            "starts_tried": tried,
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
    model, horizon, Q, R
        See :func:`ilqr`.
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

    Notes
    -----
    ``act.log`` holds, sample by sample, ``status`` (:class:`Step`), ``iterations`` and ``cost``.  The force is finite
    whatever is measured: a measurement that is not finite is replaced by the one planned for, and ``held`` in the log
    says where.  Angles are taken to the turn nearest to the plan.  From a state that no force keeps on the track, the
    plan leaves it as little as it can.
    """

    batched = False
    name = "iLQR MPC"

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
        self.explore = bool(explore) and not upright_only

    def start(self, n: int, rng: np.random.Generator) -> Act:
        """Return the law for one run."""
        if n != 1:
            raise ValueError(f"An iLQR horizon treats one run at a time; got n = {n}.")
        return _Horizon(self._planner, self.iterations, self.starts, self.explore, rng)


# ---------------------------------------------------------------------------------------------------- planner and plans


class _Plan(NamedTuple):
    """States, forces and feedback gains, with the figures of the last improvement."""

    x: Array
    u: Array
    K: Array
    cost: float
    iterations: int
    accepted: int
    converged: bool


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
        params, here = rig.params, None
        if model is None:
            g, L = float(params.gravity), float(params.length1 + params.length2) / 2
            mass, loops = float(params.coefficients().d1), PLANT
            c = params.coefficients()
            self.parameters: Any = Flow(c._make(map(float, c)), rig.sample_time / rig.substeps, rig.substeps)
        else:
            here, loops, self.parameters = model.slopes(self.target), model.loops, model.parameters
            g, L, mass = _scales(*here, rig.sample_time)
        self._rollout, self._improve = loops.rollout, loops.improve
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
        self.problem = Problem(
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
        self.guess_std = 0.5 * min(float(rig.force_limit), 2 * mass * L / pace**2)
        self.hold = max(1, round(0.375 * pace / rig.sample_time))
        stiffness = 0.64 / pace
        self.centring = np.array([-mass * stiffness**2, 0.0, 0.0, -2 * mass * stiffness, 0.0, 0.0])
        self.settled = 20.0 * float(self.Q[1] + self.Q[2])
        """Cost of five samples upside down: a plan that costs less has no challengers."""

    def problem_at(self, x: Array) -> Problem:
        """Return the problem from a state on.

        With walls about the target, its turns are those of the state.  Where the cart already stands within the soft
        wall of the track, a steep one keeps a plan from using what is left of it.
        """
        problem = self.problem
        if abs(x[0]) > problem.soft_track:
            problem = problem._replace(hard_weight=1e4 * problem.track_weight)
        if self.upright_only:
            turns = 2 * math.pi * np.rint((x[1:3] - self.target[1:3]) / (2 * math.pi))
            near = self.target[0], *(self.target[1:3] + turns).tolist(), 0.0, 0.0, 0.0
            problem = problem._replace(target=near)
        return problem

    def followed(self, problem: Problem, x0: Array, x: Array, u: Array, K: Array) -> _Plan:
        """Return the motion from a state under forces and gains."""
        new = _Plan(np.empty_like(x), np.empty_like(u), np.zeros_like(K), 0.0, 0, 0, False)
        none = np.zeros_like(u)
        cost = self._rollout(x0, x, u, K, none, NO_GAPS, 1.0, problem, self.parameters, self.P, new.x, new.u)
        return new._replace(cost=cost)

    def improved(self, problem: Problem, plan: _Plan, iterations: int, tolerance: float) -> _Plan:
        """Improve a plan in place; return it with its new figures."""
        converged, tried, accepted, cost = self._improve(
            plan.x, plan.u, plan.K, problem, self.parameters, self.P, iterations, tolerance, _TRIALS
        )
        return plan._replace(cost=cost, iterations=tried, accepted=accepted, converged=converged)

    def regulated(self, problem: Problem, x0: Array) -> _Plan:
        """Return the motion under the saturated regulator."""
        near = np.array(nearest_target(tuple(x0), problem))
        gains = np.tile(-self.K, (self.N, 1))
        states = np.tile(near, (self.N + 1, 1))
        return self.followed(problem, x0, states, np.zeros(self.N), gains)._replace(K=gains)

    def straight(self, problem: Problem, x0: Array) -> _Plan:
        """Return a straight line of states, which is no motion."""
        near = np.array(nearest_target(tuple(x0), problem))
        N = self.N
        share = np.linspace(0.0, 1.0, N + 1)[:, None]
        return _Plan((1 - share) * x0 + share * near, np.zeros(N), np.zeros((N, 6)), math.inf, 0, 0, False)

    def driven(self, problem: Problem, x0: Array, noise: Array) -> _Plan:
        """Return the motion under random forces."""
        N = self.N
        u = np.repeat(self.guess_std * noise, self.hold)[:N]
        middle = np.zeros((N + 1, 6))
        middle[:, 0] = self.target[0]
        return self.followed(problem, x0, middle, u, np.tile(self.centring, (N, 1)))

    def noise(self, rng: np.random.Generator) -> Array:
        """Draw the numbers that make one random guess."""
        return rng.standard_normal(-(-self.N // self.hold))

    def best_of_several(
        self, x0: Array, starts: int, rng: np.random.Generator, iterations: int, tolerance: float
    ) -> tuple[_Plan, int]:
        """Return the cheapest plan of several starts, and their number; random ones only if the others are costly."""
        problem = self.problem_at(x0)
        iterations = min(iterations, _FIRST)
        guesses = [self.regulated(problem, x0), self.straight(problem, x0)]
        plans = [self.improved(problem, guess, iterations, tolerance) for guess in guesses]
        if not min(plan.cost for plan in plans) <= self.settled:
            for _ in range(-(-starts // 2)):
                noise = self.noise(rng)
                for mirrored in (noise, -noise):
                    plans.append(self.improved(problem, self.driven(problem, x0, mirrored), iterations, tolerance))
        finite = [plan for plan in plans if math.isfinite(plan.cost)]
        return min(finite, key=lambda plan: plan.cost, default=plans[0]), len(plans)

    def guessed(
        self, problem: Problem, x0: Array, u_guess: npt.ArrayLike | None, x_guess: npt.ArrayLike | None
    ) -> _Plan:
        """Return the plan that a caller guesses."""
        N = self.N
        u = np.zeros(N) if u_guess is None else checked_array("u_guess", u_guess, f"forces ({N},)")
        if u.shape != (N,):
            raise ValueError(f"u_guess must be finite forces of shape ({N},), one a sample; got shape {u.shape}.")
        limit = float(self.rig.force_limit)
        u = np.clip(u, -limit, limit)
        if x_guess is None:
            return self.followed(problem, x0, np.zeros((N + 1, 6)), u, np.zeros((N, 6)))
        x = checked_array("x_guess", x_guess, f"states ({N + 1}, 6)")
        if x.shape != (N + 1, 6):
            raise ValueError(f"x_guess must be states of shape ({N + 1}, 6); got shape {x.shape}.")
        x = as_states(x)
        x[0] = x0
        return _Plan(x, u, np.zeros((N, 6)), math.inf, 0, 0, False)


class _Horizon:
    """The law at work: the plan in use, the challenger, and the log."""

    def __init__(
        self, planner: _Planner, iterations: int, starts: int, explore: bool, rng: np.random.Generator
    ) -> None:
        self._record: dict[str, list[Any]] = {"status": [], "iterations": [], "cost": []}
        held, self._missing_in = watch(1)
        self.log: ChainMap[str, list[Any]] = ChainMap(self._record, held)
        self._planner = planner
        self._iterations = iterations
        self._starts = starts
        self._explore = explore
        self._rng = rng
        self._plan: _Plan | None = None
        self._challenger: _Plan | None = None
        self._age = 0

    def follow(self, parameters: tuple[Any, ...]) -> None:
        """Plan on the same model with other parameters from now on; the weight of a plan's end stays."""
        self._planner = copy(self._planner)
        self._planner.parameters = parameters

    def __call__(self, t: float, y: Array) -> Array:
        x = np.array(y[0], dtype=np.float64)
        missing = self._missing_in(y) is not None and not np.isfinite(x).all()
        if self._plan is None:
            if missing:
                return self._logged(Step.FELL_BACK, 0, math.nan, 0.0)
            plan, _ = self._planner.best_of_several(x, self._starts, self._rng, _FIRST, _COARSE)
            self._plan = plan
            return self._logged(Step.PLANNED, plan.iterations, plan.cost, plan.u[0])
        planned = self._plan.x[1]
        if missing:
            x = planned.copy()
        elif np.abs([x, planned]).max() < 1e6:  # beyond, a turn is lost in rounding
            x[1:3] += 2 * math.pi * np.rint((planned[1:3] - x[1:3]) / (2 * math.pi))
        problem = self._planner.problem_at(x)
        plan = self._plan = self._advanced(problem, x, self._plan)
        status = Step.CONVERGED if plan.converged else Step.IMPROVED if plan.accepted else Step.FELL_BACK
        if self._iterations and plan.cost > self._planner.settled and not missing and self._cheaper(problem, x, plan):
            status = Step.SWITCHED
        return self._logged(status, plan.iterations, self._plan.cost, self._plan.u[0])

    def _logged(self, status: Step, iterations: int, cost: float, force: float) -> Array:
        self._record["status"].append(float(status))
        self._record["iterations"].append(float(iterations))
        self._record["cost"].append(cost)
        return np.array([force])

    def _advanced(self, problem: Problem, x: Array, plan: _Plan) -> _Plan:
        """Shift a plan by a sample, follow it from a state, and improve it.

        A plan that cannot be followed is abandoned for no force at all.
        """
        planner = self._planner
        end, gain = plan.x[-1], planner.K[0]
        last = -float(gain @ (end - np.array(nearest_target(end.tolist(), problem))))
        states = np.concatenate((plan.x[1:], plan.x[-1:]))
        forces = np.append(plan.u[1:], min(max(last, -problem.force_limit), problem.force_limit))
        gains = np.concatenate((plan.K[1:], -gain[None]))
        followed = planner.followed(problem, x, states, forces, gains)
        if not math.isfinite(followed.cost):
            gains[:], forces[:] = 0.0, 0.0
            followed = planner.followed(problem, x, states, forces, gains)
        if not math.isfinite(followed.cost):
            followed.x[:], followed.u[:] = x, 0.0
            return followed._replace(K=gains)
        return planner.improved(problem, followed._replace(K=gains), self._iterations, 1e-6)

    def _cheaper(self, problem: Problem, x: Array, plan: _Plan) -> bool:
        """Try the regulator, and improve the challenger for a sample; return whether one took over."""
        regulated = self._planner.regulated(problem, x)
        if regulated.cost < _CHEAPER * plan.cost:  # a plan may well pass the target by
            self._plan = self._planner.improved(problem, regulated, self._iterations, 1e-6)
            return True
        if not self._explore:
            return False
        if self._challenger is None:
            noise = self._planner.noise(self._rng)
            guess = self._planner.driven(problem, x, noise if plan.u[0] >= 0 else -noise)  # so a mirrored run mirrors
            self._challenger = self._planner.improved(problem, guess, self._iterations, _COARSE)
            self._age = 0
            return False
        challenger = self._advanced(problem, x, self._challenger)
        self._age += 1
        better = challenger.cost < _CHEAPER * plan.cost
        if better:
            self._plan = challenger
        self._challenger = None if better or self._age >= _PATIENCE or challenger.converged else challenger
        return better


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
