r"""Nonlinear model predictive control with hard limits: each sample an optimal control problem is solved, in CasADi.

.. math::
    \min_{x, u} \sum_{k<N} \ell(x_k, u_k) + \lVert e(x_N) \rVert_P^2 \quad\text{with}\quad
    x_{k+1} = F(x_k, u_k),\; |u_k| \le u_\text{max},\; |p_k| \le p_\text{max} - m,\; x_0 \text{ measured}

where :math:`F` is one sample of the plant, :math:`e` the residuals of :mod:`controllers.residuals` and :math:`P` the
Riccati solution of the LQR about the target, so that close to it and off the limits the law is that LQR.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from enum import IntEnum
from functools import lru_cache
from time import perf_counter
from typing import Any, Literal, NamedTuple

import casadi
import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_discrete_are

from dpend.arguments import checked_name, checked_whole, is_finite
from dpend.controller import Act
from dpend.deprecation import warn_renamed
from dpend.linear import discretize, linearize
from dpend.params import Array
from dpend.rig import Rig, single_rig
from dpend.state import as_equilibrium, deviation
from dpend.symbolic import energy_function, sample_function, substep_function

from .codegen import NLPSolver, Plugin, find_compiler
from .lqr import LQR
from .residuals import make_residuals
from .shooting import Program, Stage, multiple_shooting

_TURN = 2 * math.pi
_residuals = make_residuals(casadi.sin)

# Fatrop does not scale a cost; this is about what the horizon's cost then is with both links half a turn away.
_FAR_COST = 300.0
_TOLERANCE = 1e-4
_GAP = 1e-3  # largest defect of a plan, in any state's unit, that is still followed
_COLD_ITERATIONS = 100
_ARRIVED = 0.2  # rad, within which a first plan's end must be for no further guesses to be made
_WARM_BARRIER, _COLD_BARRIER = 1e-3, 1e-1
_PATIENCE = 10.0  # s
_FAR = 1e4  # m and rad, beyond which nothing is planned
_STUCK = 5  # failures in a row after which the solver goes on from where it stopped

Plan = tuple[Array, Array]
"""States ``(N + 1, nx)`` and forces ``(N, 1)``."""


class PlanStatus(IntEnum):
    """What became of the plan of one step."""

    SOLVED = 0
    """The solver converged."""
    ACCEPTED = 1
    """The solver stopped early, but its plan keeps to the plant and the limits, so it is followed."""
    SHIFTED = 2
    """The solver failed: the plan of the step before goes on; in a run's first step, the best guess."""
    ABANDONED = 3
    """The solver had not come back after 10 s: as ``SHIFTED``."""


class NMPC:
    r"""Law :math:`u = u_0^*(x)`: the first force of the best plan over the next :math:`N` samples, within hard limits.

    The stage cost is :math:`\lVert e(x) - e^* \rVert_Q^2 + R u^2` for ``"quadratic"`` and
    :math:`q_p e_p^2 + q_v \dot p^2 + w\,(E(x) - E^*)^2 / E_\text{ref}^2 + R u^2` for ``"energy"``, where :math:`E` is
    the energy of the whole plant, :math:`E_\text{ref}` what separates the target from hanging, and :math:`q_p, q_v` the
    cart's entries of Q; to either may be added :math:`S (u_k - u_{k-1})^2`.  The final cost is the LQR's.  Each plan
    starts from the one before, moved on by a sample; the first one of a run is the best of several guesses.

    Parameters
    ----------
    rig : Rig or str
        What the planner believes: plant, sample time and limits.  Actuator and sensors do not enter; where they matter,
        an estimator must come before it that returns the state at which the next force acts.
    target : str or array_like (6,)
        The equilibrium to reach, by name or as a state.
    cost : {"quadratic", "energy"}
        The stage cost.
    horizon : float, optional
        Seconds planned ahead; left out, 1.5 s for the quadratic cost and 0.8 s for the energy, times the factor by
        which the rig's links swing more slowly than those of ``gustafsson2016`` and its actuator is weaker.
    Q : array_like, optional
        State weights, a diagonal ``(6,)`` or a matrix ``(6, 6)``; left out, (10, 50, 50, 1, 1, 1).
    R : float, optional
        Weight of the force; left out, :math:`160 / u_\text{max}^2`, and 0.1 where the force has no limit.
    rate_weight : float
        :math:`S`, weight of the change of force from sample to sample; the final cost is then that of the LQR with the
        same weight.
    energy_weight : float
        :math:`w`; only with the energy cost.
    setpoint : float or callable
        Where the cart is to be, m, beside the target's own position; a function of time in s is previewed over the
        horizon.
    margin : float
        :math:`m`, by which the plan stays off the track's end, m.
    max_iterations : int
        Iterations of the solver in one step, which bounds its time.
    solver : {"auto", "fatrop", "ipopt"}
        ``"auto"`` takes fatrop with generated C where a compiler is found, else IPOPT in CasADi's own machine, several
        times slower; :attr:`backend` says which.

    Attributes
    ----------
    lqr : LQR
        The regulator of the same weights, whose Riccati solution ends the plan.
    horizon_steps : int
        :math:`N`, the horizon in samples.

    Raises
    ------
    ValueError
        If the rig describes several plants, a weight, the horizon, the margin or another number is out of its range,
        or there is no such target, cost or solver.

    See Also
    --------
    controllers.ILQRMPC : Faster, limits as walls.

    Notes
    -----
    A run records ``status`` (:class:`controllers.nmpc.PlanStatus`), ``iterations`` and ``solve_time`` (s) of each step;
    those of the first step are the sums over its guesses.  Each solve returns or is abandoned within ten seconds, in
    the first step together with the guesses still to come, and every force is finite, whatever is measured: what is not
    finite, or faster than half a radian in a Runge-Kutta step, is taken to be as planned, and nothing faster is
    planned.  Angles count by the turns nearest to the plan's.  From a start that cannot stop within the margin, the
    plan keeps off the track's end as far as it can.  Where five solves in a row have failed, the plan that is followed
    is a poor guess, and each solve begins where the one before stopped.  The plan's Hessian is Gauss and Newton's, so
    it is never indefinite.

    The solver is built when a run first needs it, once a process for equal settings; compiled code is kept in the
    user's cache folder.  Source: J. Rawlings, D. Mayne and M. Diehl, *Model Predictive Control*, 2017, chapter 8;
    L. Vanroye et al., *FATROP*, 2023.

    Examples
    --------
    >>> import dpend
    >>> from controllers import NMPC
    >>> rig = dpend.rig("gustafsson2016")
    >>> law = NMPC(rig, setpoint=0.5)
    >>> law.position(0.0)
    0.5
    """

    batched = False

    def __init__(
        self,
        rig: Rig | str,
        *,
        target: str | npt.ArrayLike = "up-up",
        cost: Literal["quadratic", "energy"] = "quadratic",
        horizon: float | None = None,
        Q: npt.ArrayLike | None = None,
        R: float | None = None,
        rate_weight: float = 0.0,
        energy_weight: float = 400.0,
        setpoint: float | Callable[[float], float] = 0.0,
        margin: float = 0.02,
        max_iterations: int = 20,
        solver: Plugin = "auto",
    ) -> None:
        rig = single_rig(rig, "NMPC")
        checked_name("cost", cost, ("quadratic", "energy"))
        checked_name("solver", solver, ("auto", "fatrop", "ipopt"))
        if R is None:
            R = 160 / float(rig.force_limit) ** 2 if math.isfinite(rig.force_limit) else 0.1
        self.lqr = LQR(rig, (10, 50, 50, 1, 1, 1) if Q is None else Q, R, target=as_equilibrium(target))
        self.rig = rig
        self.cost = cost
        self.solver: Plugin = solver
        self.rate_weight = _checked("rate_weight", rate_weight, 0.0, math.inf)
        self.energy_weight = _checked("energy_weight", energy_weight, 0.0, math.inf)
        self.margin = _checked("margin", margin, 0.0, math.inf)
        if not 0 < self.margin < rig.track_limit:
            limit = float(rig.track_limit)
            raise ValueError(
                f"margin must be greater than 0 and less than the track's limit of {limit:g} m; got {margin!r}."
            )
        self.max_iterations = checked_whole("max_iterations", max_iterations)
        self.setpoint = setpoint
        self.position(0.0)
        if horizon is None:
            horizon = _pace(rig) * (1.5 if cost == "quadratic" else 0.8)
        self.horizon_steps = round(_checked("horizon", horizon, 2 * rig.sample_time, 1e3) / rig.sample_time)

    @property
    def name(self) -> str:
        """What tables and figures call it."""
        return "NMPC" if self.cost == "quadratic" else "energy NMPC"

    @property
    def samples(self) -> int:
        """Return ``horizon_steps``, by the name that it had."""
        warn_renamed("NMPC.samples", "NMPC.horizon_steps")
        return self.horizon_steps

    @property
    def backend(self) -> str:
        """The solver, and what evaluates the plant for it: generated C or CasADi itself; built if need be."""
        return _problem(self._key()).warm.backend

    def __repr__(self) -> str:
        way = "a C compiler is found" if find_compiler() else "no C compiler is found"
        return f"<{self.name}, {self.horizon_steps} samples of {self.rig.sample_time:g} s, solver {self.solver}, {way}>"

    def position(self, t: float) -> float:
        """Return where the cart is to be at a time in s: the target's position and the set-point, m.

        A set-point that is a function of time is looked up over the whole horizon.

        Parameters
        ----------
        t : float
            Time, s.

        Returns
        -------
        float
            Position, m.

        Raises
        ------
        ValueError
            If that is no number, or nearer to the track's end than the margin.

        See Also
        --------
        controllers.NMPC : Whose ``setpoint`` it is.

        Examples
        --------
        >>> import dpend
        >>> from controllers import NMPC
        >>> rig = dpend.rig("gustafsson2016")
        >>> NMPC(rig, setpoint=lambda t: 0.1 * t).position(2.0)
        0.2
        """
        setpoint = self.setpoint(t) if callable(self.setpoint) else self.setpoint
        reach = float(self.rig.track_limit) - self.margin
        if is_finite(setpoint) and abs(self.lqr.target[0] + float(setpoint)) <= min(reach, 1e9):
            return float(self.lqr.target[0]) + float(setpoint)
        raise ValueError(
            f"The cart's place, target and setpoint together, must be within {reach:g} m of the middle, the track less "
            f"the margin; got {self.lqr.target[0]:g} m and setpoint {setpoint!r} at {t:g} s."
        )

    def start(self, n: int, rng: np.random.Generator) -> Act:
        """Return the law for one run.

        Raises
        ------
        ValueError
            If more than one run is asked for.
        """
        if n != 1:
            raise ValueError(f"NMPC treats one run at a time; got n = {n}.")
        problem = _problem(self._key())
        return _Planner(self, problem._replace(warm=problem.warm.fresh(), cold=problem.cold.fresh()))

    def _key(self) -> str:
        """Name what the solver depends on; limits and set-point are handed to it at each step."""
        params = self.rig.params.to_dict()
        settings = {
            "rig": {"params": params, "sample_time": self.rig.sample_time, "substeps": self.rig.substeps},
            "target": self.lqr.target.tolist(),
            "Q": self.lqr.Q.tolist(),
            "R": self.lqr.R,
            "S": self.rate_weight,
            "energy_weight": self.energy_weight if self.cost == "energy" else None,
            "samples": self.horizon_steps,
            "max_iterations": self.max_iterations,
            "solver": self.solver,
            "compiler": find_compiler(),
        }
        return json.dumps(settings, sort_keys=True)


def _checked(name: str, value: object, least: float, most: float) -> float:
    if not (is_finite(value) and least - 1e-12 <= value <= most + 1e-12):
        raise ValueError(f"{name} must be a finite number from {least:g} to {most:g}; got {value!r}.")
    return float(value)


def _pace(rig: Rig) -> float:
    """Return how many times longer than on ``gustafsson2016`` a swing-up takes: slower links, a weaker actuator."""
    c = rig.params.coefficients()
    if not c.f1 > 0:
        return 1.0
    swing = math.sqrt(float(c.d4) / float(c.f1)) / 0.301  # of link 1 with link 2 at its end
    strength = float(rig.force_limit) / (float(c.d1) * rig.params.gravity) / 2.04
    return float(swing * min(max(1.0, strength**-0.5), 3.0))


def _greatest_force(rig: Rig) -> float:
    """Return what forces are planned with where nothing limits them, N: thirty times the weight of the whole."""
    return 30 * (float(rig.params.coefficients().d1 * rig.params.gravity) or 1 / 3)


def _bounds(rig: Rig) -> Array:
    """Return the greatest state that is planned with: links turn by at most half a radian in a Runge-Kutta step."""
    rate = 0.5 * rig.substeps / rig.sample_time
    speed = rate * float(rig.params.length1 + rig.params.length2)
    return np.array([_FAR, _FAR, _FAR, speed, rate, rate])


def _stopping_speed(rig: Rig, margin: float) -> float:
    r"""Return :math:`v = \sqrt{2\,\tfrac12 a\,m}`: half the acceleration of the actuator stops it within the margin."""
    if not math.isfinite(rig.track_limit):
        return math.inf
    return math.sqrt(float(rig.force_limit) / float(rig.params.coefficients().d1) * margin)


class _Problem(NamedTuple):
    program: Program
    warm: NLPSolver
    cold: NLPSolver
    sample: Any


@lru_cache(maxsize=32)
def _problem(key: str) -> _Problem:
    """Build the solvers for the settings of a key: a quick one that goes on from a plan, and one for guesses."""
    settings = json.loads(key)
    rig = Rig.from_dict(settings["rig"])
    program = multiple_shooting(_stage(rig, settings), settings["samples"])

    def solver(barrier: float, iterations: int) -> NLPSolver:
        limits = {"tol": _TOLERANCE, "mu_init": barrier, "max_iter": iterations}
        start = {"bound_push": 1e-6, "bound_frac": 1e-6} if barrier == _WARM_BARRIER else {}
        return program.solver(fatrop=limits, ipopt=limits | start, solver=settings["solver"])

    warm = solver(_WARM_BARRIER, settings["max_iterations"])
    return _Problem(program, warm, solver(_COLD_BARRIER, _COLD_ITERATIONS), sample_function(rig))


def _stage(rig: Rig, settings: dict[str, Any]) -> Stage:
    """Return one stage: the state, with the force before where its change costs, and all costs as squares."""
    Q, R, S = np.array(settings["Q"]), settings["R"], settings["S"]
    target = np.array(settings["target"])
    lqr = LQR(rig, Q, R, target=target)
    remembers = S > 0
    x, u, p = casadi.SX.sym("x", 6 + remembers), casadi.SX.sym("u"), casadi.SX.sym("p", 3)
    e = casadi.vertcat(*_residuals(casadi.vertsplit(x[:6]), (*casadi.vertsplit(p), 0.0, 0.0, 0.0)))
    if settings["energy_weight"] is None:
        r, W = casadi.vertcat(e, u), _diagonal(Q, R)
    else:
        energy = energy_function(rig.params)
        there, hanging = float(energy(target)), float(energy([0, math.pi, math.pi, 0, 0, 0]))
        reference = max(there - hanging, 0.5 * abs(hanging), 1e-9)
        r = casadi.vertcat(e[0], e[3], (energy(x[:6]) - there) / reference, u)
        W = np.diag([Q[0, 0], Q[3, 3], settings["energy_weight"], R])
    # Within bounds, whatever the solver tries: fatrop does not return from what is not finite.
    bounds, force = _bounds(rig), _greatest_force(rig)
    inside = casadi.vertcat(*(casadi.fmax(casadi.fmin(x[i], bounds[i]), -bounds[i]) for i in range(6)))
    after = substep_function(rig)(inside, casadi.fmax(casadi.fmin(u, force), -force))
    last, P = e, lqr.P
    if remembers:
        r, W, last = casadi.vertcat(r, u - x[6]), _diagonal(W, S), casadi.vertcat(e, x[6])
        P = _cost_with_rate(rig, target, Q, R, S)
        after = casadi.vertcat(after, u)
    far = 4 * float(Q[1, 1] + Q[2, 2]) or 1.0
    scale = _FAR_COST / (settings["samples"] * far)
    by_z, by_x = casadi.jacobian(r, casadi.vertcat(x, u)), casadi.jacobian(last, x)
    return Stage(
        x=x,
        u=u,
        p=p,
        step=casadi.Function("substep", [x, u], [after]),
        steps=rig.substeps,
        cost=casadi.bilin(scale * W, r, r),
        terminal=casadi.bilin(scale * P, last, last),
        curvature=2 * casadi.mtimes([by_z.T, scale * W, by_z]),
        terminal_curvature=2 * casadi.mtimes([by_x.T, scale * P, by_x]),
        second_order=False,
    )


def _diagonal(first: Array, second: float) -> Array:
    """Return a block-diagonal matrix of a matrix and a number."""
    n = len(first)
    whole = np.zeros((n + 1, n + 1))
    whole[:n, :n] = first
    whole[n, n] = second
    return whole


def _cost_with_rate(rig: Rig, target: Array, Q: Array, R: float, S: float) -> Array:
    r"""Return the Riccati solution for states :math:`(x, u_{-1})` and costs with :math:`S (u - u_{-1})^2`."""
    Ad, Bd = discretize(*linearize(rig.params, target), rig.sample_time)
    cross = np.zeros((7, 1))
    cross[6] = -S
    P = solve_discrete_are(_diagonal(Ad, 0.0), np.vstack([Bd, [[1.0]]]), _diagonal(Q, S), [[R + S]], s=cross)
    return np.asarray(P, dtype=np.float64)


class _Planner:
    """The law at work on one run: the plan, and what became of each."""

    def __init__(self, controller: NMPC, problem: _Problem) -> None:
        self.log: dict[str, list[float]] = {"status": [], "iterations": [], "solve_time": []}
        self._position, self._previews = controller.position, callable(controller.setpoint)
        self._problem = problem
        self._program = program = problem.program
        self._target = controller.lqr.target
        self._gain = controller.lqr.K[0]
        self._rig, self._margin = controller.rig, controller.margin
        self._T = controller.rig.sample_time
        self._force = min(float(controller.rig.force_limit), _greatest_force(controller.rig))
        self._track = float(controller.rig.track_limit) - controller.margin
        self._bounds = _bounds(controller.rig)
        self._box = np.append(self._bounds, np.inf)[: program.nx]
        self._guess_force = min(self._force, 0.1 * _greatest_force(controller.rig))
        highest = np.full((program.horizon + 1, program.nx), np.inf)
        highest[-1, 3] = _stopping_speed(controller.rig, controller.margin)
        self._high = program.pack(highest, np.full((program.horizon, 1), self._force))
        self._low = -self._high
        self._places = np.arange(0, len(self._high), program.nx + 1)  # where the states' first entries stand
        self._plan: Plan | None = None
        self._reached: Plan | None = None  # where the solver stopped, if it is stuck
        self._failures = 0
        self._u = 0.0

    def __call__(self, t: float, y: Array) -> Array:
        x = self._with_force(self._seen(y[0]), self._u)
        self._high[self._places] = self._reach(x)
        self._low[self._places] = -self._high[self._places]
        if self._plan is None:
            self._plan, status, iterations, seconds = self._first_plan(t, x)
        else:
            planned = self._moved_on(t, self._plan)
            guess = planned if self._reached is None else self._moved_on(t, self._reached)
            plan, status, iterations, seconds, _ = self._solve(self._problem.warm, t, x, guess)
            failed = status >= PlanStatus.SHIFTED
            self._failures = self._failures + 1 if failed else 0
            stuck = self._failures >= _STUCK
            self._plan, self._reached = planned if failed else plan, plan if stuck else None
        for name, value in (("status", status), ("iterations", iterations), ("solve_time", seconds)):
            self.log[name].append(float(value))
        self._u = float(np.clip(self._plan[1][0, 0], -self._force, self._force))
        return np.array([self._u])

    def _seen(self, measured: Array) -> Array:
        """Return what is measured as a state to plan from: its angles by the turns nearest to those expected.

        What is not finite or out of bounds is no measurement: the state is as planned, or at first as wished.
        """
        expected = self._target if self._plan is None else self._plan[0][1, :6]
        if not (np.abs(measured) <= self._bounds).all():
            return expected
        seen = measured.copy()
        seen[1:3] += _TURN * np.rint((expected[1:3] - measured[1:3]) / _TURN)
        return seen

    def _reach(self, x: Array) -> float:
        """Return how far from the middle a plan may go: the track less the margin, and more where the start needs it.

        That is where it is, and where full braking brings it; a little beyond, so that there is a choice.
        """
        place, speed = x[0], x[3]
        side = np.sign(speed) or np.sign(place)
        brake = self._force / float(self._rig.params.coefficients().d1)
        if max(abs(place), side * place + speed**2 / brake) <= self._track:  # half of what the actuator can do
            return self._track
        farthest = abs(place)
        for _ in range(self._program.horizon):
            x = self._sampled(x, -side * self._guess_force)
            farthest = max(farthest, side * x[0])
            if side * x[3] <= 0:
                break
        left = max(float(self._rig.track_limit) - farthest, 0.0)
        return max(self._track, farthest + min(0.1 * self._margin, 0.5 * left))

    def _with_force(self, x: Array, u: float) -> Array:
        """Return the state as the program has it: with the last force if changes of force cost."""
        return np.append(x, u)[: self._program.nx]

    def _goals(self, t: float, end: Array) -> Array:
        """Return position and angles to reach at each stage ``(N + 1, 3)``, by the turn nearest to the plan's end."""
        N = self._program.horizon
        goals = np.empty((N + 1, 3))
        goals[:, 0] = [self._position(t + k * self._T) for k in range(N + 1)] if self._previews else self._position(t)
        goals[:, 1:] = self._target[1:3] + _TURN * np.rint((end[1:3] - self._target[1:3]) / _TURN)
        return goals

    def _solve(self, solver: NLPSolver, t: float, x: Array, guess: Plan) -> tuple[Plan, PlanStatus, int, float, float]:
        """Return the plan from a state, its status, the iterations and seconds it took, and its cost."""
        program, (xs, us) = self._program, guess
        xs = np.vstack([x, np.clip(xs[1:], -self._box, self._box)])
        nx = program.nx
        self._low[:nx] = self._high[:nx] = x
        goals = self._goals(t, xs[-1]).ravel()
        began = perf_counter()
        found = solver(
            patience=_PATIENCE, x0=program.pack(xs, us), lbx=self._low, ubx=self._high, lbg=0.0, ubg=0.0, p=goals
        )
        seconds = perf_counter() - began
        if not np.isfinite(found.x).all():
            status = PlanStatus.ABANDONED if seconds >= _PATIENCE else PlanStatus.SHIFTED
            return guess, status, found.iterations, seconds, math.inf
        plan = program.unpack(found.x)
        over = np.maximum(found.x - self._high, self._low - found.x).max()
        usable = max(found.violation, over) < _GAP
        status = PlanStatus.SHIFTED
        if usable:
            status = PlanStatus.SOLVED if found.success else PlanStatus.ACCEPTED
        cost = found.cost if math.isfinite(found.cost) else math.inf
        return plan, status, found.iterations, seconds, cost

    def _moved_on(self, t: float, plan: Plan) -> Plan:
        """Return the plan one sample later; what is missing at its end is the LQR's."""
        xs, us = plan
        last = xs[-1]
        u = float(np.clip(self._feedback(t + len(us) * self._T, last), -self._force, self._force))
        return np.vstack([xs[1:], self._sampled(last, u)]), np.vstack([us[1:], [[u]]])

    def _sampled(self, x: Array, u: float) -> Array:
        """Return the state a sample later, within bounds, so that a motion which diverges is no guess that does."""
        after = self._problem.sample(np.clip(x[:6], -self._bounds, self._bounds), u).full().ravel()
        return self._with_force(np.clip(after, -self._bounds, self._bounds), u)

    def _feedback(self, t: float, x: Array) -> float:
        target = self._target.copy()
        target[0] = self._position(t)
        return -float(self._gain @ deviation(x[:6], target))

    def _first_plan(self, t: float, x: Array) -> tuple[Plan, PlanStatus, int, float]:
        """Return the cheapest plan of the first kind of guesses that arrives, and the sums of what all took."""
        found: list[tuple[bool, float, int, Plan, PlanStatus]] = []
        iterations, seconds, arrived = 0, 0.0, False
        for guesses in (self._regulated, self._straight, self._swinging):
            for guess in guesses(t, x):
                plan, status, count, took, cost = self._solve(self._problem.cold, t, x, guess)
                iterations += count
                seconds += took
                failed = status >= PlanStatus.SHIFTED
                arrived |= status is PlanStatus.ABANDONED or (not failed and self._near(plan[0][-1], _ARRIVED))
                found.append((failed, cost, len(found), guess if failed else plan, status))
                if status is PlanStatus.ABANDONED:  # to try further would take as long again
                    break
            if arrived:
                break
        _, _, _, plan, status = min(found)
        return plan, status, iterations, seconds

    def _near(self, x: Array, angle: float) -> bool:
        """Return whether both links are within an angle of the target's."""
        return bool(np.abs(deviation(x[:6], self._target)[1:3]).max() < angle)

    def _regulated(self, t: float, x: Array) -> Iterator[Plan]:
        """Guess the LQR's motion, where the links are on the target's side."""
        if self._near(x, math.pi / 2):
            yield self._motion(x, lambda k, x: self._feedback(t + k * self._T, x))

    def _straight(self, t: float, x: Array) -> Iterator[Plan]:
        """Guess straight lines to the nearest two turns of each link."""
        N = self._program.horizon
        off = deviation(x[:6], self._target)[1:3]
        other = np.where(off > 0, _TURN, -_TURN)  # to the turn on the far side
        for turns in ((0, 0), (0, 1), (1, 0), (1, 1)):
            goal = np.zeros(self._program.nx)
            goal[0] = self._goals(t, x)[-1, 0]
            goal[1:3] = x[1:3] - off + other * turns
            yield np.linspace(x, goal, N + 1), np.zeros((N, 1))

    def _swinging(self, t: float, x: Array) -> Iterator[Plan]:
        """Guess motions under forces to and fro, because the cost is flat where the links hang at rest."""
        N = self._program.horizon
        for amplitude, periods in ((0.5, 1.0), (-0.5, 1.0), (0.5, 2.0), (-0.5, 2.0)):
            swing = amplitude * self._guess_force * np.sin(_TURN * periods * np.arange(N) / N)
            yield self._motion(x, lambda k, _, swing=swing: float(swing[k]))

    def _motion(self, x: Array, law: Callable[[int, Array], float]) -> Plan:
        N, limit = self._program.horizon, self._guess_force
        xs, us = np.empty((N + 1, len(x))), np.empty((N, 1))
        xs[0] = x
        for k in range(N):
            us[k] = np.clip(law(k, xs[k]), -limit, limit)
            xs[k + 1] = self._sampled(xs[k], us[k, 0])
        return xs, us
