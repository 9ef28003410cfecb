from __future__ import annotations

import os
import pickle
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import casadi
import numpy as np
import pytest

import controllers.codegen as codegen
import dpend
from controllers import LQR, NMPC
from controllers.nmpc import PlanStatus, _problem
from controllers.shooting import Stage, multiple_shooting
from dpend.params import Array
from tests.rigs import whole

RIG = dpend.rig("gustafsson2016")
SHORT: dict[str, Any] = {"horizon": 0.5}


def law(controller: Any) -> Any:
    return controller.start(1, np.random.default_rng(0))


def forces(controller: NMPC, x: Array, samples: int) -> tuple[Array, Any]:
    """Return the forces of the law in closed loop on the ideal rig, and the law."""
    act = law(controller)
    stepper = dpend.Stepper(controller.rig, 1)
    y = stepper.reset(x)
    u = []
    for k in range(samples):
        u.append(act(k * controller.rig.sample_time, y)[0])
        y = stepper.step(np.array(u[-1:]))
    return np.array(u), act


# ------------------------------------------------------------------------------------------------- multiple shooting


def small_program(second_order: bool = True) -> Any:
    """Return program with two inputs, a path constraint and two steps a sample, whose derivatives CasADi can derive."""
    x, u, p = casadi.SX.sym("x", 3), casadi.SX.sym("u", 2), casadi.SX.sym("p", 2)
    ahead = casadi.vertcat(x[1] + casadi.sin(x[2]) * u[0], x[0] * x[2] + u[1] ** 2, x[2] + 0.1 * x[0] * u[0])
    stage = Stage(
        x=x,
        u=u,
        p=p,
        step=casadi.Function("step", [x, u], [ahead]),
        steps=2,
        cost=casadi.cos(x[0] - p[0]) * u[0] ** 2 + u[1] ** 4,
        terminal=casadi.exp(x[1]) * p[1],
        path=casadi.vertcat(x[0] * x[1], casadi.sin(x[2]) + p[0]),
        second_order=second_order,
    )
    return multiple_shooting(stage, 4)


def test_derivatives_by_stages_are_those_that_casadi_derives_from_the_whole() -> None:
    program = small_program()
    mine = {function.name(): function for function in program.derivatives}
    nlp = {**program.nlp}
    lam = casadi.MX.sym("lam", program.nlp["g"].shape[0])
    scale = casadi.MX.sym("scale")
    w, p, f, g = (nlp[name] for name in ("x", "p", "f", "g"))
    hessian, gradient = casadi.hessian(scale * f + casadi.dot(lam, g), w)
    whole_program = casadi.Function(
        "whole", [w, p, scale, lam], [f, g, casadi.gradient(f, w), casadi.jacobian(g, w), hessian, gradient]
    )
    rng = np.random.default_rng(0)
    at = [rng.normal(size=n) for n in (w.numel(), p.numel())]
    multipliers = [1.7, rng.normal(size=lam.numel())]
    f0, g0, grad, jac, hess, grad_l = (np.array(casadi.DM(each)) for each in whole_program(*at, *multipliers))
    found = [
        (mine["nlp_f"](*at), f0),
        (mine["nlp_g"](*at), g0),
        (mine["nlp_grad_f"](*at), grad),
        (mine["nlp_jac_g"](*at)[0], g0),
        (mine["nlp_jac_g"](*at)[1], jac),
        (mine["nlp_hess_l"](*at, *multipliers)[0], grad_l),
        (mine["nlp_hess_l"](*at, *multipliers)[1], hess),
        (mine["nlp_grad"](*at, *multipliers)[2], grad_l),
    ]
    for ours, theirs in found:
        np.testing.assert_allclose(casadi.DM(ours).full(), theirs, rtol=1e-10, atol=1e-10)


def test_what_is_packed_is_unpacked() -> None:
    program = small_program()
    x, u = np.arange(15.0).reshape(5, 3), -np.arange(8.0).reshape(4, 2)
    again = program.unpack(program.pack(x, u))
    assert np.array_equal(again[0], x)
    assert np.array_equal(again[1], u)
    gaps = casadi.Function("g", [program.nlp["x"], program.nlp["p"]], [program.nlp["g"]])
    assert program.constraints(0.0, 1.0).shape == (gaps.numel_out(0),)
    assert len(program.equality) == gaps.numel_out(0)
    assert np.array_equal(program.constraints(1.0, 0.0) == 1.0, program.equality)


# -------------------------------------------------------------------------------------------------------- compilation


def rosenbrock() -> dict[str, Any]:
    x = casadi.MX.sym("x", 2)
    return {"x": x, "f": (1 - x[0]) ** 2 + 100 * (x[1] - x[0] ** 2) ** 2, "g": x[0] + x[1]}


QUIET = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes"}}


def test_compiled_and_interpreted_solvers_agree(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DPEND_CACHE", str(tmp_path))
    found = [codegen.nlp_solver(rosenbrock(), solver="ipopt", ipopt=QUIET, compiled=flag) for flag in (True, False)]
    if codegen.find_compiler():
        assert found[0].backend == "IPOPT, compiled C"
        assert [path.suffix for path in (tmp_path / "c").iterdir()] == [".so"]
    assert found[1].backend == "IPOPT, CasADi's virtual machine"
    answers = [solve(x0=[0.1, 0.2], lbg=-10, ubg=10).x for solve in found]
    np.testing.assert_allclose(answers, np.ones((2, 2)), atol=1e-6)


def test_a_compiler_that_fails_is_no_error_and_is_named(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    broken = tmp_path / "broken"
    broken.write_text("#!/bin/sh\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setenv("CC", str(broken))
    monkeypatch.setenv("DPEND_CACHE", str(tmp_path / "cache"))
    found = codegen.nlp_solver(rosenbrock(), ipopt=QUIET)
    assert found.backend == "IPOPT, CasADi's virtual machine (broken failed)"
    assert found.plugin == "ipopt"


class Endless:
    """A solver that does not come back before it is let go."""

    def __init__(self) -> None:
        self.held = threading.Event()

    def call(self, arguments: Any) -> Any:
        self.held.wait()
        raise RuntimeError("let go")


def test_a_solve_that_does_not_come_back_is_abandoned_and_the_next_one_begins_afresh() -> None:
    made: list[Endless] = []

    def make(stop: Any) -> Endless:
        made.append(Endless())
        return made[-1]

    solve = codegen.NLPSolver(make, {"x": 2, "g": 1, "p": 0}, "fatrop", "a test")
    for _ in range(2):
        found = solve(patience=0.05)
        assert (found.success, found.status) == (False, "abandoned after 0.05 s")
        assert np.isnan(found.x).all()
    assert len(made) == 2
    for each in made:
        each.held.set()


def test_ctrl_c_ends_a_solve_within_a_second(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    x = casadi.MX.sym("x", 600)
    slow = casadi.sum1((1 - x[:-1]) ** 2 + 100 * (x[1:] - x[:-1] ** 2) ** 2)
    quiet = {**QUIET, "ipopt": {"print_level": 0, "sb": "yes", "max_iter": 1_000_000, "tol": 1e-300}}
    solve = codegen.nlp_solver({"x": x, "f": slow, "g": x[0]}, solver="ipopt", ipopt=quiet, compiled=False)
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)  # whatever was inherited
    began = time.perf_counter()
    timer = threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT))
    try:
        timer.start()
        with pytest.raises(KeyboardInterrupt):
            [solve(x0=-1.0, lbg=-10, ubg=10) for _ in range(1000)]
    finally:
        timer.join()
        signal.signal(signal.SIGINT, handler)
    assert time.perf_counter() - began < 1.5


def test_a_solver_that_does_not_exist_is_refused() -> None:
    message = 'solver must be "auto", "fatrop" or "ipopt"; got \'snopt\'.'
    with pytest.raises(ValueError, match=whole(message)):
        codegen.nlp_solver(rosenbrock(), solver="snopt")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=whole(message)):
        NMPC(RIG, solver="snopt")  # type: ignore[arg-type]


# ------------------------------------------------------------------------------------------------------------ the law


@pytest.mark.parametrize("rate_weight", [0.0, 1.0])
def test_close_to_the_target_it_is_the_regulator(rate_weight: float) -> None:
    controller = NMPC(RIG, rate_weight=rate_weight, **SHORT)
    x = 1e-3 * np.random.default_rng(0).standard_normal((5, 6))
    regulator = LQR(RIG, (10, 50, 50, 1, 1, 1), 0.1)
    for row in x:
        first = law(controller)(0.0, row[None])[0]
        expected = float(-regulator.K[0] @ row)
        if rate_weight == 0:
            assert first == pytest.approx(expected, rel=1e-3, abs=1e-4)
        else:  # a change of force costs, so the first is smaller
            assert 0 < first / expected < 1


def test_a_cost_on_changes_of_force_lowers_their_variation_under_sensor_noise() -> None:
    rig, start = RIG.replace(sensor_noise=0.002), [0.0, 0.02, 0.01, 0.0, 0.0, 0.0]
    free, costly = (
        dpend.simulate(rig, NMPC(RIG, rate_weight=weight, **SHORT), start, 1.0).metrics() for weight in (0.0, 1.0)
    )
    assert costly["success"] == 1.0
    assert costly["variation"] < 0.5 * free["variation"]


def test_at_the_target_and_at_each_turn_of_it_there_is_nothing_to_do() -> None:
    for target, angles in (("up-up", (2 * np.pi, -4 * np.pi)), ("down-down", (-np.pi, 3 * np.pi))):
        x = np.array([[0.0, *angles, 0.0, 0.0, 0.0]])
        assert law(NMPC(RIG, target=target, **SHORT))(0.0, x)[0] == pytest.approx(0.0, abs=1e-6)


def test_limits_hold_in_closed_loop() -> None:
    rig = RIG.replace(track_limit=0.5, force_limit=6.0)
    start = [0.0, 0.1, 0.05, 0.0, 0.0, 0.0]
    run = dpend.simulate(rig, NMPC(rig, setpoint=0.48, horizon=1.0), start, 2.0)
    assert run.success
    assert np.abs(run.u).max() == pytest.approx(6.0, abs=0.1)  # the limits matter
    assert 0.4 < np.abs(run.x[:, 0]).max() < 0.48 + 1e-3
    assert (run.log["status"] != PlanStatus.SHIFTED).all()


def test_the_cart_follows_its_set_point_and_previews_it() -> None:
    x0 = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    with_steps = NMPC(RIG, setpoint=lambda t: 0.5 if t >= 1.0 else 0.0, horizon=1.0)
    run = dpend.simulate(RIG, with_steps, x0, 3.0, task=None)
    before = run.x[round(0.98 / RIG.sample_time), 0]
    assert abs(before) > 1e-3  # it has begun before the step
    assert run.x[-1, 0] == pytest.approx(0.5, abs=0.02)


def test_a_failed_solver_is_counted_and_the_plan_goes_on() -> None:
    x = np.array([0.0, 0.1, -0.1, 0.0, 0.0, 0.0])
    good, act = forces(NMPC(RIG, **SHORT), x, 3)
    assert act.log["status"] == [PlanStatus.SOLVED] * 3
    act = law(NMPC(RIG, **SHORT))
    first = act(0.0, x[None])[0]
    unstoppable = np.array([[2.3, 0.1, -0.1, 59.0, 0.0, 0.0]])  # no force slows the cart down within the horizon
    plan = act._plan
    u = act(0.02, unstoppable)[0]
    assert first == good[0]
    assert act.log["status"] == [PlanStatus.SOLVED, PlanStatus.SHIFTED]
    assert u == plan[1][1, 0]


@pytest.mark.parametrize("changes", [{}, {"force_limit": np.inf, "track_limit": np.inf}])
def test_whatever_is_measured_each_step_returns_a_finite_force_and_a_status(changes: dict[str, float]) -> None:
    act = law(NMPC(RIG.replace(**changes), **SHORT))
    rng = np.random.default_rng(5)
    largest = [1.0, 30.0, 1e3, 1e12, 1e300]
    for k in range(10):
        y = rng.standard_normal((1, 6)) * largest[k % 5]
        y[0, rng.integers(6)] *= rng.choice([1.0, np.inf])
        assert np.isfinite(act(0.02 * k, y)).all()
    assert len(act.log["status"]) == 10
    assert PlanStatus.ABANDONED not in act.log["status"]


def test_a_guess_whose_end_diverges_is_cut_before_the_solver_sees_it() -> None:
    act = law(NMPC(RIG))
    act(0.0, np.array([[0.0, 3.1, 3.2, 0.0, 0.0, 0.0]]))
    xs, us = act._plan
    xs[-1] = [0.7, 17.0, 33.0, -42.0, 160.0, -130.0]  # spins so fast that a Runge-Kutta step is off by ten powers
    moved = act._moved_on(0.0, (xs, us))[0][-1]
    assert (np.abs(moved) <= act._bounds).all()
    assert np.isfinite(act(0.02, xs[None, 1])).all()
    assert act.log["status"][-1] != PlanStatus.ABANDONED


def test_a_run_does_not_depend_on_what_was_measured_before_it() -> None:
    x = np.array([0.1, 0.1, -0.05, 0.0, 0.0, 0.0])
    controller = NMPC(RIG, **SHORT)
    before, _ = forces(controller, x, 5)
    odd = law(controller)
    for y in 30 * np.random.default_rng(5).standard_normal((5, 1, 6)):
        odd(0.0, y)
    np.testing.assert_array_equal(forces(controller, x, 5)[0], before)


def test_threads_get_what_a_sequence_gets() -> None:
    jobs = [(NMPC(RIG, **SHORT), [0.1 * i, 0.1 * i, -0.05, 0.0, 0.0, 0.0]) for i in range(3)]
    jobs.append((jobs[0][0], [0.0, -0.1, 0.1, 0.0, 0.0, 0.0]))  # and one object in two threads

    def run(job: tuple[NMPC, list[float]]) -> Array:
        return dpend.simulate(RIG, *job, 0.4).u

    alone = [run(job) for job in jobs]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(run, jobs))
    np.testing.assert_array_equal(together, alone)


def test_angles_that_differ_by_whole_turns_at_any_sample_give_the_same_forces() -> None:
    rng = np.random.default_rng(0)
    plain, turned = law(NMPC(RIG, **SHORT)), law(NMPC(RIG, **SHORT))
    stepper = dpend.Stepper(RIG, 1)
    y = stepper.reset([0.0, 2.9, 3.3, 0.0, 4.0, -4.0])
    for k in range(12):
        jump = np.zeros((1, 6))
        jump[0, 1:3] = 2 * np.pi * rng.integers(-2, 3, 2)
        u = plain(0.02 * k, y)
        assert turned(0.02 * k, y + jump) == pytest.approx(u, abs=1e-6)
        y = stepper.step(u)


@pytest.mark.slow
def test_beyond_the_margin_it_saves_what_the_regulator_saves() -> None:
    rng = np.random.default_rng(1)
    x0 = np.zeros((4, 6))
    x0[:, 0] = -rng.uniform(2.381, 2.398, 4)
    x0[:, 1:3] = rng.uniform(0.0, 0.12, (4, 2))
    saved = dpend.simulate_many(RIG, LQR(RIG), x0, 2.0).success
    runs = dpend.simulate_many(RIG, NMPC(RIG, horizon=1.0), x0, 2.0)
    assert saved.sum() >= 2
    assert (runs.success >= saved).all()


def test_upright_beyond_the_margin_it_does_not_sit_still() -> None:
    act = law(NMPC(RIG, **SHORT))
    u = act(0.0, np.array([[-2.392, 0.0, 0.0, 0.0, 0.0, 0.0]]))
    assert abs(u[0]) > 0.1
    assert act.log["status"] == [PlanStatus.SOLVED]


def test_one_iteration_a_step_gives_a_finite_force_and_its_status_says_so() -> None:
    u, act = forces(NMPC(RIG, max_iterations=1, **SHORT), np.array([0.0, 0.4, -0.3, 0.0, 0.0, 0.0]), 6)
    assert np.isfinite(u).all()
    assert max(act.log["iterations"][1:]) <= 2
    assert set(act.log["status"][1:]) & {PlanStatus.ACCEPTED, PlanStatus.SHIFTED}


def test_runs_keep_what_the_law_logs_of_its_steps() -> None:
    run = dpend.simulate(RIG, NMPC(RIG, **SHORT), [0.0, 0.05, 0.0, 0.0, 0.0, 0.0], 0.1)
    assert set(run.log) == {"status", "iterations", "solve_time"}
    assert all(values.shape == (5,) for values in run.log.values())
    assert (run.log["solve_time"] > 0).all()


def test_without_a_compiler_it_works_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    x = np.array([0.0, 0.1, -0.1, 0.0, 0.0, 0.0])
    usual, _ = forces(NMPC(RIG, **SHORT), x, 3)
    monkeypatch.setattr("controllers.codegen.find_compiler", lambda: None)
    monkeypatch.setattr("controllers.nmpc.find_compiler", lambda: None)
    controller = NMPC(RIG, **SHORT)
    assert repr(controller) == "<NMPC, 25 samples of 0.02 s, solver auto, no C compiler is found>"
    assert controller.backend == "IPOPT, CasADi's virtual machine (no C compiler)"
    found, act = forces(controller, x, 3)
    assert act.log["status"] == [PlanStatus.SOLVED] * 3
    np.testing.assert_allclose(found, usual, atol=0.02)


def test_equal_settings_share_one_solver_and_a_pickle_gives_the_same_law() -> None:
    x = np.array([0.0, 0.2, -0.1, 0.0, 0.0, 0.0])
    one = NMPC(RIG, **SHORT)
    two = pickle.loads(pickle.dumps(one))
    law(one)
    built = _problem.cache_info().misses
    assert np.array_equal(forces(one, x, 4)[0], forces(two, x, 4)[0])
    law(NMPC(RIG.replace(track_limit=1.0), **SHORT))
    assert _problem.cache_info().misses == built


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"cost": "time"}, 'cost must be "quadratic" or "energy"; got \'time\'.'),
        ({"horizon": 0.02}, "horizon must be a finite number from 0.04 to 1000; got 0.02."),
        ({"margin": 3.0}, "margin must be greater than 0 and less than the track's limit of 2.4 m; got 3.0."),
        *(
            (
                place,
                "The cart's place, target and setpoint together, must be within 2.38 m of the middle, the track less "
                f"the margin; got {words}.",
            )
            for place, words in (
                ({"setpoint": 2.39}, "0 m and setpoint 2.39 at 0 s"),
                ({"setpoint": lambda t: float("nan")}, "0 m and setpoint nan at 0 s"),
                ({"target": [2, 0, 0, 0, 0, 0], "setpoint": 1.0}, "2 m and setpoint 1.0 at 0 s"),
            )
        ),
        ({"rate_weight": -1}, "rate_weight must be a finite number from 0 to inf; got -1."),
        ({"max_iterations": 0}, "max_iterations must be a whole number, at least 1; got 0."),
    ],
)
def test_wrong_settings_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=whole(message)):
        NMPC(RIG, **settings)


def test_several_plants_or_runs_at_once_are_refused() -> None:
    with pytest.raises(
        ValueError, match=whole("NMPC takes one plant; got a rig of 2 rows. Take one of them with rig.rows(i).")
    ):
        NMPC(RIG.replace(mass1=np.array([0.5, 0.6])))
    with pytest.raises(ValueError, match=whole("NMPC treats one run at a time; got n = 2.")):
        NMPC(RIG).start(2, np.random.default_rng(0))


@pytest.mark.slow
@pytest.mark.parametrize("cost", ["quadratic", "energy"])
@pytest.mark.parametrize("start", ["hanging", "side"])
def test_it_swings_up_within_the_limits(cost: Any, start: str) -> None:
    task = dpend.SwingUp(start=start, angle_spread=0.1, steps=200)
    x0 = task.starts(np.random.default_rng(5), 2, RIG)
    runs = dpend.simulate_many(RIG, NMPC(RIG, cost=cost), x0, task=task)
    assert runs.success.all()
    assert (runs.travel < 2.4 - 0.02 + 1e-3).all()
    assert np.abs(runs.u).max() <= 40.0
    if cost == "quadratic":  # with the energy cost, which has no slope towards upright far away, some solves fail
        assert (runs.log["status"] != PlanStatus.SHIFTED).all()


@pytest.mark.slow
@pytest.mark.parametrize(("th1", "th2"), [(1.6371717, 1.55626973), (3.20777324, 3.06189054)])
def test_a_solver_that_fails_again_and_again_begins_elsewhere_before_the_plan_is_used_up(
    th1: float, th2: float
) -> None:
    controller = NMPC(RIG, cost="energy")  # from these starts the shifted plan is never a good guess again
    task = dpend.SwingUp(steps=150, hold=0.3)
    run = dpend.simulate(RIG, controller, [0.0, th1, th2, 0.0, 0.0, 0.0], task=task)
    in_a_row = longest = 0
    for status in run.log["status"]:
        in_a_row = in_a_row + 1 if status == PlanStatus.SHIFTED else 0
        longest = max(longest, in_a_row)
    assert 5 <= longest < controller.horizon_steps
    assert run.success
    assert np.abs(run.x[:, 0]).max() < 2.4 - 0.02 + 1e-3


def test_a_measurement_of_nan_is_taken_as_planned_and_the_force_stays_finite() -> None:
    x = np.array([0.0, 0.1, -0.1, 0.0, 0.0, 0.0])
    broken = np.array([0.0, np.nan, 0.1, 0.0, 0.0, 0.0])
    act = NMPC(RIG, **SHORT).start(1, np.random.default_rng(0))
    answers = [act(0.02 * k, y[None])[0] for k, y in enumerate((broken, x, broken))]
    assert np.isfinite(answers).all()


@pytest.mark.skipif(codegen.find_compiler() is None, reason="no C compiler")
def test_a_library_that_is_cut_short_is_compiled_anew(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DPEND_CACHE", str(tmp_path))
    codegen.nlp_solver(rosenbrock(), solver="ipopt", ipopt=QUIET)
    (library,) = tmp_path.rglob("*.so")
    content = library.read_bytes()
    library.unlink()  # what is loaded stays as it is
    library.write_bytes(content[: len(content) // 2])
    found = codegen.nlp_solver(rosenbrock(), solver="ipopt", ipopt=QUIET)
    assert found.backend == "IPOPT, compiled C"
    assert [path.read_bytes() for path in tmp_path.rglob("*.so")] == [content]


def test_a_library_that_cannot_be_loaded_is_thrown_away_and_done_without(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = tmp_path / "broken.so"
    broken.write_bytes(b"no library")
    monkeypatch.setattr(codegen, "_compiled", lambda *_: broken)
    monkeypatch.setattr(codegen, "find_compiler", lambda: "/usr/bin/cc")
    found = codegen.nlp_solver(rosenbrock(), solver="ipopt", ipopt=QUIET)
    assert found.backend == "IPOPT, CasADi's virtual machine (cc failed)"
    assert not broken.exists()


def test_code_is_not_kept_where_others_may_write(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DPEND_CACHE", str(tmp_path))
    (tmp_path / "c").mkdir()
    (tmp_path / "c").chmod(0o777)
    found = codegen.nlp_solver(rosenbrock(), solver="ipopt", ipopt=QUIET)
    assert found.backend.startswith("IPOPT, CasADi's virtual machine")
    if codegen.find_compiler():
        assert f"Compiled code is not kept in {tmp_path / 'c'}: others than you may write to it" in found.backend
    assert not list(tmp_path.rglob("*.so"))
