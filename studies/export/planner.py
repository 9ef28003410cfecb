r"""NMPC as one function for CasADi's code generation: a plan and a measurement to the next plan and the force.

The optimal control problem is that of :class:`controllers.NMPC`.  Its solver is a compiled library there; here it is
sequential quadratic programming with CasADi's own active-set method, which CasADi writes out as C without a heap.
"""

from __future__ import annotations

import json
import math
import re
import tempfile
from pathlib import Path
from typing import Any

import casadi
import numpy as np

from controllers import NMPC
from controllers.nmpc import _GAP, _bounds, _greatest_force, _stage, _stopping_speed
from controllers.shooting import Program, multiple_shooting
from dpend.controller import Act
from dpend.laws import holding
from dpend.params import Array
from dpend.rig import Rig
from dpend.symbolic import sample_function

_TURN = 2 * math.pi
_CHANGES = 100  # of the active set, in one quadratic program


class RealTimeNMPC:
    """:class:`controllers.NMPC` in the form that is exported: the same problem, solved by another method.

    Each sample does at most ``iterations`` steps of sequential quadratic programming from the plan before, moved on by
    a sample.  Where that fails, the plan goes on for a sample, and the next one begins anew.  The first plan has one
    guess: the LQR's motion within a quarter turn of the target, a straight line from farther away.  So it balances; for
    swing-ups :class:`controllers.NMPC` tries several guesses and has a solver that mends poor ones.

    Parameters
    ----------
    controller : NMPC
        What is solved; its set-point must be a number.
    iterations : int
        Quadratic programs in one sample.

    Attributes
    ----------
    function : casadi.Function
        From memory and measurement to memory and force.

    Raises
    ------
    ValueError
        If the set-point is a function.
    """

    batched = False

    def __init__(self, controller: NMPC, iterations: int = 3) -> None:
        if callable(controller.setpoint):
            raise ValueError("a set-point that is a function of time is Python's own.")
        self.name = f"real-time {controller.name}"
        self.controller, self.iterations = controller, iterations
        self.function = _planning(controller, iterations)

    def __repr__(self) -> str:
        N, T = self.controller.horizon_steps, self.controller.rig.sample_time
        return f"<{self.name}, {N} samples of {T:g} s, at most {self.iterations} quadratic programs in each>"

    def start(self, n: int, rng: np.random.Generator) -> Act:
        """Return the law for one run."""
        memory = np.zeros(self.function.size1_in(0))

        def act(t: float, y: Array) -> Array:
            nonlocal memory
            after, u = self.function(memory, y[0])
            memory = after.full().ravel()
            return np.array([float(u)])

        return holding(1, act)

    def code(self) -> tuple[str, str]:
        """Return the function as C99, header and source; parameters that CasADi's pieces do not need are said to be."""
        generator = casadi.CodeGenerator("plan.c", {"with_header": True, "casadi_int": "int"})
        generator.add(self.function)
        with tempfile.TemporaryDirectory() as folder:
            generator.generate(f"{folder}/")
            header, source = (Path(folder, name).read_text() for name in ("plan.h", "plan.c"))

        def used(heading: re.Match[str]) -> str:
            names = re.findall(r"(\w+)\s*(?:,|$)", heading["taken"])
            return heading[0] + "".join(f" (void){name};" for name in names if name != "void")

        return header, re.sub(r"^\w[\w* ]*\((?P<taken>[^;{}()]*)\) ?\{", used, source, flags=re.MULTILINE)


def _planning(controller: NMPC, iterations: int) -> Any:
    """Return the law as a function of a memory, zero at first, and a measurement ``(6,)``."""
    rig, program = controller.rig, _program(controller)
    N, nx, nz = program.horizon, program.nx, program.nx + 1
    nw, ng = N * nz + nx, N * nx
    force = min(float(rig.force_limit), _greatest_force(rig))
    target = controller.lqr.target.copy()
    target[0] = controller.position(0.0)
    box = _bounds(rig)

    def clipped(value: Any, limit: Any) -> Any:
        return casadi.fmax(casadi.fmin(value, limit), -limit)

    def by_turns(angles: Any, others: Any) -> Any:
        """Return angles, moved by the whole turns that bring them nearest to others."""
        return angles + _TURN * casadi.floor((others - angles) / _TURN + 0.5)

    # Motions that a plan may begin from.
    x, u = casadi.MX.sym("x", nx), casadi.MX.sym("u")
    after = clipped(sample_function(rig)(clipped(x[:6], box), u), box)
    sampled = casadi.Function("sampled", [x, u], [casadi.vertcat(after, u)[:nx]])
    away = casadi.vertcat(x[0] - target[0], by_turns(x[1:3] - target[1:3], 0), x[3:6] - target[3:])
    regulated = casadi.Function("regulated", [x], [clipped(-casadi.mtimes(controller.lqr.K, away), force)])
    guess_force = min(force, 0.1 * _greatest_force(rig))
    gentle = clipped(regulated(x), guess_force)
    regulation = casadi.Function("regulation", [x], [sampled(x, gentle), gentle]).mapaccum(N)
    braking = sampled.mapaccum(N)

    memory, y = casadi.MX.sym("memory", 1 + 2 * nw + ng), casadi.MX.sym("y", 6)
    known, plan, lam_x, lam_g = casadi.vertsplit(memory, [0, 1, 1 + nw, 1 + 2 * nw, 1 + 2 * nw + ng])

    def columns(vector: Any) -> Any:
        return casadi.reshape(vector[: N * nz], nz, N)

    def packed(xs: Any, us: Any) -> Any:
        return casadi.vertcat(casadi.vec(casadi.vertcat(xs[:, :N], us)), xs[:, N])

    # What is measured, as a state to plan from; what is out of bounds is no measurement.
    planned = casadi.horzcat(columns(plan)[:nx, :], plan[N * nz :])
    forces = columns(plan)[nx, :]
    expected = casadi.if_else(known, planned[:6, 1], target)
    turned = casadi.vertcat(y[0], by_turns(y[1:3], expected[1:3]), y[3:])
    seen = casadi.if_else(casadi.mmax(casadi.fabs(y) / box) <= 1, turned, expected)
    start = casadi.vertcat(seen, known * forces[0])[:nx]

    # The guess: the plan, moved on, or the first one.
    last = regulated(planned[:, N])
    moved = casadi.horzcat(planned[:, 1:], sampled(planned[:, N], last)), casadi.horzcat(forces[1:], last)
    motion, regulating = regulation(start)
    off = by_turns(start[1:3] - target[1:3], 0)
    goal = casadi.vertcat(target[0], start[1:3] - off, casadi.DM.zeros(nx - 3))
    straight = casadi.mtimes(start, np.linspace(1, 0, N + 1)[None]) + casadi.mtimes(
        goal, np.linspace(0, 1, N + 1)[None]
    )
    near = casadi.mmax(casadi.fabs(off)) < math.pi / 2
    first = (
        casadi.if_else(near, casadi.horzcat(start, motion), straight),
        casadi.if_else(near, regulating, casadi.MX.zeros(1, N)),
    )
    xs, us = (casadi.if_else(known, one, other) for one, other in zip(moved, first, strict=True))
    xs = casadi.horzcat(start, clipped(xs[:, 1:], casadi.vertcat(box, math.inf)[:nx]))
    guess = packed(xs, us)

    # Limits, and where the angles are to go.
    reach = _reach(rig, controller.margin, start, braking, N, force, guess_force)
    high = casadi.MX(program.pack(np.full((N + 1, nx), np.inf), np.full((N, 1), force)))
    high[np.arange(0, nw, nz)] = reach
    high[N * nz + 3] = _stopping_speed(rig, controller.margin)
    low = -high
    high[:nx] = low[:nx] = start
    goals = casadi.vertcat(target[0], by_turns(casadi.DM(target[1:3]), xs[1:3, N]))

    found = _solver(program, iterations)(
        x0=guess, p=casadi.repmat(goals, N + 1, 1), lbx=low, ubx=high, lbg=0, ubg=0,
        lam_x0=casadi.vertcat(lam_x[nz:], casadi.DM.zeros(nz)),
        lam_g0=casadi.vertcat(lam_g[nx:], casadi.DM.zeros(nx)),
    )  # fmt: skip
    over = casadi.mmax(casadi.fmax(found["x"] - high, low - found["x"]))
    usable = casadi.logic_and(casadi.norm_inf(found["g"]) < _GAP, over < _GAP)
    kept = casadi.if_else(usable, found["x"], guess)
    lams = [casadi.if_else(usable, found[name], casadi.MX.zeros(*found[name].shape)) for name in ("lam_x", "lam_g")]
    return casadi.Function(
        "plan",
        [memory, y],
        [casadi.vertcat(usable, kept, *lams), clipped(kept[nx], force)],
        ["memory", "y"],
        ["after", "u"],
    )


def _program(controller: NMPC) -> Program:
    return multiple_shooting(_stage(controller.rig, json.loads(controller._key())), controller.horizon_steps)


def _solver(program: Program, iterations: int) -> Any:
    """Return CasADi's sequential quadratic programming with its active-set method, given our derivatives."""
    ours = {function.name(): function for function in program.derivatives}
    w, p = (program.nlp[name] for name in "xp")
    lam_f, lam_g = casadi.MX.sym("lam_f"), casadi.MX.sym("lam_g", program.nlp["g"].numel())
    hessian = ours["nlp_hess_l"](w, p, lam_f, lam_g)[1]
    quiet = {"print_iteration": False, "print_header": False, "print_status": False, "print_time": False}
    bounded = {
        "max_iter": _CHANGES,
        "error_on_fail": False,
        "print_iter": False,
        "print_header": False,
        "print_info": False,
    }
    options = {
        "qpsol": "qrqp",
        "qpsol_options": bounded,
        "max_iter": iterations,
        "max_iter_ls": 0,
        "jac_fg": casadi.Function(
            "nlp_jac_fg", [w, p], [ours["nlp_f"](w, p), ours["nlp_grad_f"](w, p), *ours["nlp_jac_g"](w, p)],
            ["x", "p"], ["f", "grad_f_x", "g", "jac_g_x"],
        ),
        "hess_lag": casadi.Function(
            "nlp_hess_l", [w, p, lam_f, lam_g], [hessian], ["x", "p", "lam_f", "lam_g"], ["hess_gamma_x_x"]
        ),
    }  # fmt: skip
    return casadi.nlpsol("solver", "sqpmethod", program.nlp, options | quiet)


def _reach(rig: Rig, margin: float, start: Any, braking: Any, N: int, force: float, guess_force: float) -> Any:
    """Return how far from the middle a plan may go: the track less the margin, or what full braking still needs."""
    limit = float(rig.track_limit)
    if not math.isfinite(limit):
        return math.inf
    place, speed = start[0], start[3]
    side = casadi.if_else(speed == 0, casadi.sign(place), casadi.sign(speed))
    brake = force / float(rig.params.coefficients().d1)
    calm = casadi.fmax(casadi.fabs(place), side * place + speed**2 / brake) <= limit - margin
    stopping = braking(start, casadi.repmat(-side * guess_force, 1, N))
    farthest = casadi.fmax(casadi.fabs(place), casadi.mmax(side * stopping[0, :]))
    left = casadi.fmax(limit - farthest, 0)
    beyond = casadi.fmax(limit - margin, farthest + casadi.fmin(0.1 * margin, 0.5 * left))
    return casadi.if_else(calm, limit - margin, beyond)
