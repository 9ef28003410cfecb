"""How fast nonlinear MPC is beside do-mpc, on do-mpc's own example of a double pendulum: one process, one run.

``python -m benchmarks.mpc`` runs both closed loops side by side, one step of each in turn, so that a machine busy with
other things slows both, and prints times and what the loops cost; ``--quick`` does a few steps.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = os.environ["MKL_NUM_THREADS"] = "1"

import contextlib
import io
import math
import warnings
from collections.abc import Callable
from importlib.util import find_spec
from time import perf_counter
from typing import Any

import casadi
import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

import dpend
from benchmarks.dompc_plant import rods
from benchmarks.race import TITLE, Ratio, pin_to_one_core, versions
from controllers.codegen import NLPSolver
from controllers.shooting import Stage, multiple_shooting
from dpend.equations import make_energies, make_positions
from dpend.params import Array
from dpend.symbolic import substep_function

# The problem, as the documentation of do-mpc states it ("Double inverted pendulum") and as its example sets it up.
RIG = dpend.rig("dompc_dip")
HORIZON = 100
OBSTACLE = (0.0, 0.6, 0.3 * 1.05)  # centre of a disk that no joint may enter, m, and its radius with a margin, m
START = np.array([0.0, 0.9 * math.pi, 0.9 * math.pi, 0.0, 0.0, 0.0])
SWITCH = 4.0  # s, when the cart's set-point jumps
TRACKING, CHANGE = 10.0, 0.1  # weights of the set-point's error and of the force's change
STEPS = 240
COLD_BARRIER = 0.03
PLANNED = RIG.replace(substeps=2)  # the step with which a plan is made; the loop is closed on RIG's

Law = Callable[[float, Array], float]

_energies = make_energies(casadi.cos)
_positions = make_positions(casadi.sin, casadi.cos)


def setpoint(t: float) -> float:
    """Return where the cart is to be, m; a plan takes it as constant over its horizon."""
    return -0.8 if t // RIG.sample_time <= SWITCH // RIG.sample_time else 0.8


def stage_cost(x: Any, target: Any) -> Any:
    r"""Return :math:`-V + 10\,(p - p^*)^2`."""
    return TRACKING * (x[0] - target) ** 2 - _energies(x, RIG.params.coefficients())[1]


def final_cost(x: Any) -> Any:
    r"""Return :math:`T - V` with the example's slip: the second link's inertia is met with the first link's rate."""
    kinetic, potential = _energies(x, RIG.params.coefficients())
    inertia = RIG.params.mass2 * RIG.params.length2**2 / 12
    return kinetic + 0.5 * inertia * (x[4] ** 2 - x[5] ** 2) - potential


def distances(x: Any) -> Any:
    """Return the distances of the cart and the tips of both links from the obstacle, m."""
    x_joint, y_joint, x_tip, y_tip = _positions(x, RIG.params.coefficients())
    at_x, at_y, radius = OBSTACLE
    points = ((x[0], 0.0), (x_joint, y_joint), (x_tip, y_tip))
    return [casadi.sqrt((px - at_x) ** 2 + (py - at_y) ** 2) - radius for px, py in points]


def ours() -> tuple[Law, str]:
    """Return law on this project's multiple shooting; the force before is part of the state, as its change costs."""
    x, u, p = casadi.SX.sym("x", 7), casadi.SX.sym("u"), casadi.SX.sym("p")
    plant = substep_function(PLANNED)
    state = casadi.vertsplit(x[:6])
    scale = 0.1  # fatrop does not scale a cost
    stage = Stage(
        x=x,
        u=u,
        p=p,
        step=casadi.Function("substep", [x, u], [casadi.vertcat(plant(x[:6], u), u)]),
        steps=PLANNED.substeps,
        cost=scale * (stage_cost(state, p) + CHANGE * (u - x[6]) ** 2),
        terminal=scale * final_cost(state),
        path=casadi.vertcat(*distances(state)),
    )
    program = multiple_shooting(stage, HORIZON)

    def solver(barrier: float, iterations: int) -> NLPSolver:
        limits = {"tol": 1e-4, "mu_init": barrier, "max_iter": iterations}
        return program.solver(fatrop=limits, ipopt=limits)

    warm, cold = solver(1e-3, 20), solver(COLD_BARRIER, 300)
    lower, upper = program.constraints(0.0, 0.0), program.constraints(0.0, math.inf)
    free = np.full((HORIZON + 1, 7), math.inf)
    high = program.pack(free, np.full((HORIZON, 1), float(RIG.force_limit)))
    low = -high
    memory: dict[str, Any] = {"plan": None, "force": 0.0}

    def act(t: float, y: Array) -> float:
        now = np.append(y, memory["force"])
        if memory["plan"] is None:
            xs, us = np.tile(now, (HORIZON + 1, 1)), np.zeros((HORIZON, 1))
        else:
            xs, us = memory["plan"]
            xs, us = np.vstack([now, xs[2:], xs[-1:]]), np.vstack([us[1:], us[-1:]])
        low[:7] = high[:7] = now
        guess, targets = program.pack(xs, us), np.full(HORIZON + 1, setpoint(t))
        # Where the last plan is no good start, as when the set-point jumps, the barrier method begins further inside.
        for each in (cold,) if memory["plan"] is None else (warm, cold):
            found = each(x0=guess, lbx=low, ubx=high, lbg=lower, ubg=upper, p=targets)
            if found.success:
                xs, us = program.unpack(found.x)
                break
        memory["plan"] = xs, us
        memory["force"] = float(np.clip(us[0, 0], -RIG.force_limit, RIG.force_limit))
        return memory["force"]

    return act, warm.backend


def theirs() -> Law:
    """Return the law that do-mpc makes of the same problem with the example's settings."""
    import do_mpc

    params = RIG.params
    model = rods(params)
    target = model.set_variable("_tvp", "pos_set")
    state = (model.x["pos"], *casadi.vertsplit(model.x["theta"]), model.x["dpos"], *casadi.vertsplit(model.x["dtheta"]))
    model.set_expression("clearance", casadi.vertcat(*distances(state)))
    model.setup()

    mpc = do_mpc.controller.MPC(model)
    mpc.settings.n_horizon = HORIZON
    mpc.settings.n_robust = 0
    mpc.settings.open_loop = False
    mpc.settings.t_step = RIG.sample_time
    mpc.settings.state_discretization = "collocation"
    mpc.settings.collocation_type = "radau"
    mpc.settings.collocation_deg = 3
    mpc.settings.collocation_ni = 1
    mpc.settings.store_full_solution = True
    mpc.settings.supress_ipopt_output()
    state = (model.x["pos"], *casadi.vertsplit(model.x["theta"]), model.x["dpos"], *casadi.vertsplit(model.x["dtheta"]))
    mpc.set_objective(mterm=final_cost(state), lterm=stage_cost(state, target))
    mpc.set_rterm(force=CHANGE)
    mpc.bounds["lower", "_u", "force"] = -RIG.force_limit
    mpc.bounds["upper", "_u", "force"] = RIG.force_limit
    mpc.set_nl_cons("obstacle", -model.aux["clearance"], 0)
    mpc.set_uncertainty_values(m1=np.array([params.mass1]), m2=np.array([params.mass2]))
    template = mpc.get_tvp_template()

    def targets(t: float) -> Any:
        template["_tvp", :, "pos_set"] = setpoint(float(np.ravel(t)[0]))
        return template

    mpc.set_tvp_fun(targets)
    mpc.setup()
    mpc.x0 = START
    mpc.set_initial_guess()

    def act(_: float, y: Array) -> float:
        with contextlib.redirect_stdout(io.StringIO()):
            return float(mpc.make_step(y.reshape(6, 1)).item())

    return act


def closed_loops(laws: dict[str, Law], steps: int) -> tuple[dict[str, Array], dict[str, Array], dict[str, Array]]:
    """Run laws side by side on a plant each, and give the seconds of each step, the states and the forces."""
    steppers = {name: dpend.Stepper(RIG, 1) for name in laws}
    now = {name: stepper.reset(START)[0] for name, stepper in steppers.items()}
    seconds: dict[str, list[float]] = {name: [] for name in laws}
    states: dict[str, list[Array]] = {name: [now[name].copy()] for name in laws}
    forces: dict[str, list[float]] = {name: [] for name in laws}
    for k in range(steps):
        for name, law in laws.items():
            began = perf_counter()
            force = law(k * RIG.sample_time, now[name])
            seconds[name].append(perf_counter() - began)
            now[name] = steppers[name].step(np.array([force]))[0]
            states[name].append(now[name].copy())
            forces[name].append(force)
    found = seconds, states, forces
    first, second, third = ({name: np.array(values) for name, values in each.items()} for each in found)
    return first, second, third


def quality(x: Array, u: Array) -> tuple[float, float, float]:
    """Return the loop's cost, when both links were up for good before the set-point's jump, and the clearance."""
    times = RIG.sample_time * np.arange(len(u))
    changes = np.diff(u, prepend=0.0)
    cost = sum(float(stage_cost(row, setpoint(t))) for t, row in zip(times, x[:-1], strict=True))
    before = x[: round(SWITCH / RIG.sample_time) + 1]
    low = np.flatnonzero(np.abs(dpend.wrap(before[:, 1:3])).max(axis=1) > 0.2)
    up = (low[-1] + 1) * RIG.sample_time if len(low) and low[-1] + 1 < len(before) else math.nan
    clearance = min(float(each) for row in x for each in distances(row))
    return cost + CHANGE * float(changes @ changes), up, clearance


def ratios(quick: bool = False) -> list[Ratio]:
    """Return how many times as fast a step is here as in do-mpc, step by step but for the first; nothing without it."""
    if not find_spec("do_mpc"):
        return []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # do-mpc's, about its extras, and CasADi's about do-mpc's use of numpy
        seconds, _, _ = closed_loops({"dpend": ours()[0], "do-mpc": theirs()}, 8 if quick else STEPS)
    mine, other = (seconds[name][1:] for name in ("dpend", "do-mpc"))
    low, middle, high = np.quantile(other / mine, (0.25, 0.5, 0.75))
    speed = float(1 / np.median(mine))
    title = "Nonlinear MPC on do-mpc's own example, closed loop"
    return [Ratio(title, "steps", "dpend", "do-mpc", speed, float(middle), float(low), float(high), 10.0, 1.0)]


def main(quick: bool = False) -> None:
    """Measure nonlinear MPC beside do-mpc's on do-mpc's own example, on one core, in turns.

    Parameters
    ----------
    quick
        A few steps, to see that it runs; the figures mean little.
    """
    pin_to_one_core()
    console = Console()
    law, backend = ours()
    laws: dict[str, Law] = {"dpend": law}
    console.print(f"{versions('casadi', 'do-mpc')}; dpend by {backend}", highlight=False, soft_wrap=True)
    if find_spec("do_mpc"):
        warnings.simplefilter("ignore")  # about its extras, and from CasADi about its use of numpy
        laws["do-mpc"] = theirs()
    seconds, x, u = closed_loops(laws, 8 if quick else STEPS)
    table = Table(title=f"One step, {RIG.sample_time:g} s period, horizon {HORIZON}, ms", **TITLE)
    for column in ("", "first", "median", "p99", "max", "late", "cost", "up, s", "clear, m"):
        table.add_column(column, justify="right" if column else "left")
    for name in laws:
        ms = 1e3 * seconds[name]
        cost, up, clearance = quality(x[name], u[name])
        late = int((ms[1:] > 1e3 * RIG.sample_time).sum())
        times = [f"{value:.1f}" for value in (ms[0], np.median(ms[1:]), np.percentile(ms[1:], 99), ms[1:].max())]
        table.add_row(name, *times, str(late), f"{cost:.2f}", f"{up:.2f}", f"{clearance:.4f}")
    console.print(table)
    if len(laws) == 1:
        console.print("do-mpc is not installed (extra peers).")
        return
    mine, other = (1e3 * seconds[name][1:] for name in laws)
    for title, measure, wanted in (
        ("median", np.median, 10.0),
        ("p99", lambda ms: np.percentile(ms, 99), 20.0),
        ("max", np.max, None),
    ):
        ratio = float(measure(other) / measure(mine))
        verdict = "" if wanted is None else f"; asked for {wanted:g}: {'met' if ratio >= wanted else 'MISSED'}"
        console.print(f"do-mpc / dpend, {title}: {ratio:.3g}{verdict}", highlight=False)


if __name__ == "__main__":
    tyro.cli(main)
