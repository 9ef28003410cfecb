r"""iLQR beside crocoddyl's BoxFDDP on one problem: the same samples, cost, force box and guess.

``python -m benchmarks.boxfddp`` (extra ``peers``) prints what both find from eight guesses, and times on one core.

The problem: from hanging to upright on ``gustafsson2016`` without an end of the track, 125 samples of 20 ms,
:math:`|u| \le 40` N, and the cost of ``controllers/ilqr.py`` with its default weights, from forces at random.  Both
take semi-implicit Euler steps, :math:`v' = v + h\,a(q, v, u)`, :math:`q' = q + h v'`, the cheaper of crocoddyl's
integrators, which means the same in its relative angles as in our absolute ones; our planner gets them as a
``controllers.Model``.

Crocoddyl's costs are weighted squares of residuals of states, forces and frames, so :math:`4 \sin^2(\theta/2)` is
made of points on the links' axes: exactly, if with a larger Gauss-Newton curvature.  All of it is C++ but the last
sample's cost, whose weights are a full matrix: one call of Python beside 125 samples.  Its ``ActuationModelFull`` has a
torque on each joint as well, in boxes of zero.  Both stop where an iteration promises to lower the cost by a millionth.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = os.environ["MKL_NUM_THREADS"] = "1"

import math
from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from time import process_time
from typing import Any, NamedTuple

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

import dpend
from benchmarks.race import TITLE, Job, Race, pin_to_one_core, processor, run, show, versions
from benchmarks.relative import S, to_relative
from controllers import Model
from controllers.ilqr import _Planner
from controllers.ilqr_kernels import Guess
from dpend.kernels import acceleration_slopes, rates
from dpend.params import Array

RIG = dpend.rig("gustafsson2016").replace(track_limit=math.inf)
STEPS = 125
BEGIN = dpend.EQUILIBRIA["down-down"]
TOLERANCE = 1e-6
OPTIMUM = 3e4  # about what the best plan costs, to tell crocoddyl when to stop
SAME = 1e-5  # relative difference of two costs up to which they are of the same plan
MOST = 400  # iterations


class Found(NamedTuple):
    """What a solver came to."""

    cost: float
    iterations: int
    converged: bool
    u: Array


Solver = Callable[[int], Found]
"""Solves from its guess, in so many iterations at most."""


def euler(x, u, parameters):
    """Return the state after one semi-implicit Euler step."""
    c, h = parameters
    _, _, _, a, a1, a2 = rates(x, (u, 0.0, 0.0), c)
    vel, om1, om2 = x[3] + h * a, x[4] + h * a1, x[5] + h * a2
    return x[0] + h * vel, x[1] + h * om1, x[2] + h * om2, vel, om1, om2


def linearize(x, u, parameters, D):
    """Fill D (N, 6, 8) with the slopes of each step by state and force, and the gap to the next state."""
    c, h = parameters
    for k in range(len(u)):
        now = (x[k, 0], x[k, 1], x[k, 2], x[k, 3], x[k, 4], x[k, 5])
        a = rates(now, (u[k], 0.0, 0.0), c)
        slopes = acceleration_slopes(now, (a[3], a[4], a[5]), c)
        for i in range(3):
            D[k, 3 + i, 0] = 0.0
            for j in range(6):
                D[k, 3 + i, j + 1] = h * slopes[j][i]
            D[k, 3 + i, 3 + i] += 1.0
            for j in range(7):
                D[k, i, j] = h * D[k, 3 + i, j]
            D[k, i, i] += 1.0
            vel = x[k, 3 + i] + h * a[3 + i]
            D[k, 3 + i, 7] = vel - x[k + 1, 3 + i]
            D[k, i, 7] = x[k, i] + h * vel - x[k + 1, i]


MODEL = Model(
    step=euler,
    linearize=linearize,
    parameters=(RIG.params.coefficients(), RIG.sample_time),
    sources=(Path(__file__),),
)


def planner() -> _Planner:
    """Return our planner on the rig's own samples, two Runge-Kutta steps each, with the default weights."""
    return _Planner(RIG, "up-up", STEPS * RIG.sample_time, None, None, False)


def on_euler_steps() -> _Planner:
    """Return our planner on the samples that crocoddyl takes, with the same weights."""
    own = planner()
    return _Planner(RIG, "up-up", STEPS * RIG.sample_time, own.Q.tolist(), own.R, False, MODEL)


def guess(seed: int) -> Array:
    """Return forces (N,) at random, each held for six samples."""
    drawn = 20.0 * np.random.default_rng(seed).standard_normal(-(-STEPS // 6))
    return np.clip(np.repeat(drawn, 6)[:STEPS], -RIG.force_limit, RIG.force_limit)


def ours(plan: _Planner, u: Array) -> Solver:
    """Return our solver of a problem from forces."""

    def solve(iterations: int) -> Found:
        plans = plan.guessed(BEGIN, u, None)
        plan.improve(plans, Guess.FOLLOWED, BEGIN[None], iterations, TOLERANCE)
        return Found(float(plans.cost[0]), int(plans.tried[0]), bool(plans.converged[0]), plans.u[0])

    return solve


def usable() -> bool:
    """Return whether crocoddyl is installed, and the Pinocchio for which its package was built."""
    try:
        return version("crocoddyl").startswith("3.2.") and version("libpinocchio").startswith("4.0.")
    except PackageNotFoundError:
        return False


def theirs(plan: _Planner, u: Array) -> Solver:
    """Return crocoddyl's solver of the same problem from the same forces."""
    crocoddyl: Any = import_module("crocoddyl")
    pinocchio: Any = import_module("pinocchio")
    from benchmarks.peers.in_pinocchio import Pinocchio

    Q, h = plan.Q, RIG.sample_time
    model = Pinocchio(RIG.params).model

    def point(name: str, joint: int, height: float) -> int:
        """Add a point of the link that a joint carries, so high above that joint, m."""
        place = pinocchio.SE3(np.eye(3), np.array([0.0, 0.0, height]))
        return model.addFrame(pinocchio.Frame(name, joint, place, pinocchio.FrameType.OP_FRAME))

    points = {
        "joint 2": point("joint 2", 2, 1.0),
        "below joint 1": point("below joint 1", 2, -1.0),
        "above joint 2": point("above joint 2", 3, 1.0),
        "below joint 2": point("below joint 2", 3, -1.0),
    }
    state = crocoddyl.StateMultibody(model)
    costs = crocoddyl.CostModelSum(state, 3)

    def add(name: str, residual: Any, weights: Sequence[float]) -> None:
        """Add a sum of w r^2; crocoddyl halves it, and multiplies it by the time step."""
        activation = crocoddyl.ActivationModelWeightedQuad(2.0 / h * np.array(weights, dtype=np.float64))
        costs.addCost(name, crocoddyl.CostModelResidual(state, activation, residual), 1.0)

    def near(name: str, height: float, across: float, up: float) -> None:
        at = np.array([0.0, 0.0, height])
        add(name, crocoddyl.ResidualModelFrameTranslation(state, points[name], at, 3), [across, 0.0, up])

    still, local = pinocchio.Motion.Zero(), pinocchio.ReferenceFrame.LOCAL
    turning = crocoddyl.ResidualModelFrameVelocity(state, points["above joint 2"], still, local, 3)
    add("state", crocoddyl.ResidualModelState(state, np.zeros(6), 3), [Q[0] - Q[1], 0, 0, Q[3], Q[4], 0])
    add("turning", turning, [0, 0, 0, 0, Q[5], 0])
    add("force", crocoddyl.ResidualModelControl(state, 3), [plan.R] * 3)
    # Of a link, 4 sin^2(th / 2) = sin^2 + (cos - 1)^2: of two points on its axis, 1 m before and behind its joint, the
    # squares of both deviations add up to twice that and twice the square of the joint's, which is taken away again.
    near("joint 2", 1.0, Q[1] / 2 - Q[2], Q[1] - Q[2])
    near("below joint 1", -1.0, Q[1] / 2, 0.0)
    near("above joint 2", 2.0, Q[2] / 2, Q[2] / 2)
    near("below joint 2", 0.0, Q[2] / 2, Q[2] / 2)

    moving = crocoddyl.DifferentialActionModelFreeFwdDynamics(state, crocoddyl.ActuationModelFull(state), costs)
    sample = crocoddyl.IntegratedActionModelEuler(moving, h)
    box = np.array([float(RIG.force_limit), 0.0, 0.0])
    sample.u_lb, sample.u_ub = -box, box
    T = np.kron(np.eye(2), S).astype(np.float64)

    class Last(crocoddyl.ActionModelAbstract):
        """The cost of the end of a plan, e'P e."""

        def __init__(self) -> None:
            super().__init__(state, 0, 0)

        def calc(self, data: Any, x: Array, u: Array | None = None) -> None:
            e, _ = self.residuals(x)
            data.xnext, data.cost = x, float(e @ plan.P @ e)

        def calcDiff(self, data: Any, x: Array, u: Array | None = None) -> None:
            e, slopes = self.residuals(x)
            data.Lx, data.Lxx = 2.0 * slopes.T @ plan.P @ e, 2.0 * slopes.T @ plan.P @ slopes

        def residuals(self, x: Array) -> tuple[Array, Array]:
            y = T @ x
            half = (y[1:3] - 2 * math.pi * np.rint(y[1:3] / (2 * math.pi))) / 2
            y[1:3] = 2 * np.sin(half)
            return y, np.diag([1.0, *np.cos(half), 1.0, 1.0, 1.0]) @ T

    problem = crocoddyl.ShootingProblem(np.concatenate(to_relative(BEGIN)), [sample] * STEPS, Last())
    solver = crocoddyl.SolverBoxFDDP(problem)
    solver.th_stop = TOLERANCE * OPTIMUM
    us = [np.array([force, 0.0, 0.0]) for force in u]
    xs = problem.rollout(us)

    def solve(iterations: int) -> Found:
        if not iterations:
            return Found(float(problem.calc(xs, us)), 0, False, u)
        done = solver.solve(xs, us, iterations, True)
        return Found(float(solver.cost), int(solver.iter) + 1, bool(done), np.array(solver.us)[:, 0])

    return solve


def races(quick: bool = False) -> list[Race]:
    """Return the races of an iteration and of a whole solve; nothing without crocoddyl.

    A RuntimeError says so if the two do not find the same plan.
    """
    if not usable():
        return []
    plan, u = on_euler_steps(), guess(0)
    solvers = {"iLQR": ours(plan, u), "crocoddyl BoxFDDP": theirs(plan, u)}
    mine, other = (solve(MOST) for solve in solvers.values())
    if not (mine.converged and other.converged and abs(mine.cost / other.cost - 1) < SAME):
        raise RuntimeError(f"The two found different plans, which cost {mine.cost:.8g} and {other.cost:.8g}.")
    solvers["iLQR, two Runge-Kutta steps"] = ours(planner(), u)

    def iterations(solve: Solver) -> Job:
        return lambda: solve(MOST).iterations

    def whole(solve: Solver) -> Job:
        return lambda: float(solve(MOST).converged)

    turns = 2 if quick else 15
    title = "Swing-up in a force box, 125 samples of one Euler step"
    pairs = [("iLQR", "crocoddyl BoxFDDP", 3.0), ("iLQR, two Runge-Kutta steps", "crocoddyl BoxFDDP", None)]
    return [
        Race(
            title=f"{title}, an iteration",
            counts="iterations",
            jobs={name: iterations(solve) for name, solve in solvers.items()},
            pairs=pairs,
            turns=turns,
        ),
        Race(
            title=f"{title}, until it converges",
            counts="solves",
            jobs={name: whole(solve) for name, solve in list(solvers.items())[:2]},
            pairs=[("iLQR", "crocoddyl BoxFDDP", None)],
            turns=turns,
        ),
    ]


def main(guesses: int = 8) -> None:
    """Solve from several guesses, and show costs, iterations and times.

    Parameters
    ----------
    guesses
        How many.
    """
    if not usable():
        raise SystemExit("crocoddyl and the Pinocchio it was built for are not installed (extra peers).")
    pin_to_one_core()
    console = Console()
    console.print(f"{processor()}; {versions('numpy', 'numba', 'crocoddyl', 'libpinocchio')}.", soft_wrap=True)
    table = Table("guess", "solver", "cost", "iterations", "converged", "ms", title="From forces at random", **TITLE)
    plan = on_euler_steps()
    ours(plan, guess(0))(1)  # compiles
    for seed in range(guesses):
        u = guess(seed)
        for name, solve in {"iLQR": ours(plan, u), "BoxFDDP": theirs(plan, u)}.items():
            began = process_time()
            found = solve(MOST)
            spent = 1e3 * (process_time() - began)
            converged = "yes" if found.converged else "no"
            table.add_row(str(seed), name, f"{found.cost:.2f}", str(found.iterations), converged, f"{spent:.1f}")
    console.print(table)
    for race in races():
        show(console, run(race))


if __name__ == "__main__":
    tyro.cli(main, prog="python -m benchmarks.boxfddp")
