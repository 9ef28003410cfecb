"""Planned motions replay in the simulator, within limits, to where they should; what cannot be planned is refused."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import casadi
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rigs import random_states, whole

import dpend
from controllers import NoTrajectory, Trajectory, optimize, shipped, violations
from controllers.codegen import find_compiler
from controllers.data import FOLDER
from controllers.data.__main__ import RECIPES
from controllers.shooting import Stage, multiple_shooting
from controllers.trajopt import STARTS, _ends, _guesses
from dpend import EQUILIBRIA, Stepper, symbolic

RIG = dpend.rig("gustafsson2016")
SHIPPED = sorted(file for file in FOLDER.glob("*.npz") if "_tuned_" not in file.name)


@cache
def swing_up() -> Trajectory:
    """Solve the textbook case: hanging to upright, both links the same way, from a straight line, by IPOPT."""
    return optimize(RIG, target=np.zeros(6))


# ------------------------------------------------------------------------------------------------------------ solutions


def test_a_solution_replays_in_the_simulator_within_its_limits_and_ends_at_the_target() -> None:
    found = swing_up()
    assert found.defect() < 1e-6
    assert violations(found, track_margin=0.2) == ""
    assert_array_equal(found.x[0], EQUILIBRIA["down-down"])
    assert_array_equal(found.x[-1], np.zeros(6))
    assert np.abs(found.u).max() <= RIG.force_limit
    stepper = Stepper(RIG, 1)
    stepper.reset(found.x[0])
    for u in found.u[:50]:  # a second without feedback
        stepper.step(np.array([u]))
    assert_allclose(stepper.x[0], found.x[50], atol=1e-6)


def test_its_cost_is_the_effort_and_the_change_of_its_forces() -> None:
    found = swing_up()
    u = found.u / RIG.force_limit
    changes = np.diff(np.concatenate([[0.0], u, [0.0]]))
    T = RIG.sample_time
    assert_allclose(found.about["cost"], T * np.sum(u**2) + 0.1**2 / T * np.sum(changes**2), rtol=1e-6)


def test_no_small_change_that_keeps_the_end_costs_less() -> None:
    found = swing_up()
    shorter = optimize(RIG, target=np.zeros(6), duration=2.4, guess=found)
    longer = optimize(RIG, target=np.zeros(6), duration=2.6, guess=found)
    # Effort falls with the time allowed, and a solution of a shorter time is never cheaper than resting first.
    assert shorter.about["cost"] > found.about["cost"] > longer.about["cost"]
    assert (len(shorter.u), len(longer.u)) == (120, 130)


@pytest.mark.slow
def test_margins_are_kept() -> None:
    found = optimize(RIG, target=np.zeros(6), guess=swing_up(), track_margin=0.9, force_margin=15.0)
    assert np.abs(found.x[:, 0]).max() <= 1.5 + 1e-6
    assert np.abs(found.u).max() <= 25.0
    assert found.about["cost"] > swing_up().about["cost"]


@pytest.mark.slow
def test_minimum_time_is_no_longer_than_on_record_and_its_force_at_the_limits() -> None:
    guess = shipped(RIG)
    assert guess is not None
    found = optimize(RIG, target=guess.target, objective="time", duration=2.0, guess=guess)
    assert found.duration <= 1.51
    assert found.rig.sample_time == pytest.approx(found.duration / 100)
    assert found.rig.replace(sample_time=RIG.sample_time) == RIG
    assert violations(found, track_margin=0.2) == ""
    assert np.mean(np.abs(found.u) > 39.9) > 0.5


@pytest.mark.parametrize("start", ["hanging", "side"])
def test_both_ways_of_turning_are_tried_and_the_mirrors_of_a_start_that_is_its_own_are_not(start: str) -> None:
    begin = STARTS[start]
    ends = {(round(end[1] / np.pi), round(end[2] / np.pi)) for end in _ends(begin, "up-up", None)}
    if start == "hanging":
        assert ends == {(0, 0), (0, 2)}
    else:
        assert ends == {(0, 0), (0, 2), (2, 0), (2, 2)}
    assert [tuple(end[1:3]) for end in _ends(EQUILIBRIA["up-down"], "up-up", None)] == [(0.0, 0.0)]
    assert [tuple(end[1:3]) for end in _ends(begin, [0.3, 4 * np.pi, 0, 0, 0, 0], None)] == [(4 * np.pi, 0.0)]


def test_a_guess_names_the_turns() -> None:
    guess = shipped(RIG)
    assert guess is not None
    assert_array_equal(_ends(STARTS["hanging"], "up-up", guess), [guess.target])


def test_the_same_seed_gives_the_same_guesses_and_all_begin_and_end_where_the_trajectory_does() -> None:
    begin, end = STARTS["side"], EQUILIBRIA["up-up"]
    first, again, other = (
        list(_guesses(begin, end, 50, RIG, None, 4, np.random.default_rng(seed))) for seed in (0, 0, 1)
    )
    for mine, same, different in zip(first[1:], again[1:], other[1:], strict=True):
        assert_array_equal(mine.x, same.x)
        assert np.abs(mine.x - different.x).max() > 0.1
        assert_allclose(mine.x[[0, -1], :3], [begin[:3], end[:3]], atol=1e-12)


def test_a_guess_may_begin_whole_turns_away() -> None:
    guess = swing_up()
    turned = replace(
        guess,
        x=guess.x + 2 * np.pi * np.array([0, 1, -1, 0, 0, 0]),
        target=2 * np.pi * np.eye(6)[1] - 2 * np.pi * np.eye(6)[2],
    )
    found = optimize(RIG, guess=turned)
    assert_allclose(found.x, guess.x, atol=1e-6)
    assert found.about["iterations"] < guess.about["iterations"]


# -------------------------------------------------------------------------------------------------------------- solvers


def test_without_a_compiler_ipopt_takes_over_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)
    found = optimize(RIG, target=np.zeros(6), solver="auto")
    assert found.about["solver"] == "IPOPT, CasADi's virtual machine (no C compiler)"
    assert_allclose(found.x, swing_up().x, atol=1e-6)


@pytest.mark.slow
@pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
@pytest.mark.parametrize("objective", ["effort", "time"])
def test_both_solvers_find_the_same(objective: Any) -> None:
    problem: dict[str, Any] = {"target": np.zeros(6), "objective": objective, "duration": 2.0, "guess": swing_up()}
    compiled, interpreted = (optimize(RIG, solver=solver, **problem) for solver in ("auto", "ipopt"))
    assert compiled.about["solver"] == "fatrop, compiled C"
    assert_allclose(compiled.about["cost"], interpreted.about["cost"], rtol=1e-6)
    assert_allclose(compiled.x, interpreted.x, atol=1e-4)


def test_a_gradient_is_dense_even_where_a_cost_depends_on_little() -> None:
    x, u = casadi.SX.sym("x", 2), casadi.SX.sym("u")
    stage = Stage(
        x=x,
        u=u,
        p=casadi.SX(0, 1),
        step=casadi.Function("step", [x, u], [x + u]),
        steps=1,
        cost=u**2,
        terminal=casadi.SX(0),
    )
    gradient = next(f for f in multiple_shooting(stage, 3).derivatives if f.name() == "nlp_grad_f")
    assert gradient.sparsity_out(0).is_dense()


def test_a_sample_of_free_length_is_the_sample_of_a_rig_with_that_clock() -> None:
    x, u = random_states(np.random.default_rng(0), 1)[0], 7.0
    free, fixed = symbolic.sample_function(RIG, free_step=True), symbolic.sample_function(RIG.replace(sample_time=0.03))
    assert_allclose(free(x, u, 0.03).full(), fixed(x, u).full(), rtol=1e-12, atol=1e-12)


# ------------------------------------------------------------------------------------------------------------- refusals


def test_a_problem_without_a_solution_is_an_error_that_says_what_to_change() -> None:
    message = (
        "None of 1 guesses led to a trajectory (1 x infeasible problem detected). "
        "Allow more time or force, less margin, more starts, or give the trajectory of an easier problem as guess."
    )
    with pytest.raises(NoTrajectory, match=whole(message)):
        optimize(RIG.replace(force_limit=1.0), target=np.zeros(6), duration=0.4)


def test_a_solution_that_does_not_hold_is_found_out() -> None:
    good = swing_up()
    x, u = good.x.copy(), good.u.copy()
    x[20, 4] += 1e-3
    u[10] = 41.0
    wrong = violations(replace(good, x=x, u=u, target=good.target + 0.5 * np.eye(6)[0]), track_margin=1.0)
    assert [part.partition(":")[0] for part in wrong.split("; ")] == [
        "defect of a sample",
        "force above its limit, N",
        "cart beyond the track, m",
        "distance from the target",
    ]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: optimize(RIG, objective="energy"), 'objective must be "effort" or "time"; got \'energy\'.'),  # type: ignore[arg-type]
        (
            lambda: optimize(RIG, duration=2.51),
            "duration must be a whole number of samples of 0.02 s, at least 8; got 2.51 s.",
        ),
        (
            lambda: optimize(RIG, duration=-2.0),
            "duration must be a whole number of samples of 0.02 s, at least 8; got -2.0 s.",
        ),
        (lambda: optimize(RIG, smoothing=-1.0), "smoothing must be finite and at least 0 s; got -1.0."),
        (
            lambda: optimize(RIG, track_margin=2.4),
            "track_margin must be at least 0 and less than the limit of 2.4 m; got 2.4.",
        ),
        (
            lambda: optimize(RIG, force_margin=-1.0),
            "force_margin must be at least 0 and less than the limit of 40 N; got -1.0.",
        ),
        (lambda: optimize(RIG, starts=0), "starts must be a whole number, at least 1; got 0."),
        (
            lambda: optimize(RIG, "upside"),
            "start must be one of 'hanging', 'side', 'up-up', 'up-down', 'down-up', 'down-down', or a state (6,); "
            "got 'upside'.",
        ),
        (
            lambda: optimize(RIG, [3.0, 0, 0, 0, 0, 0]),
            "The start has its cart at 3 m; a trajectory that keeps its margin stays within 2.2 m.",
        ),
        (
            lambda: optimize(RIG, target=[3.0, 0, 0, 0, 0, 0]),
            "The target has its cart at 3 m; a trajectory that keeps its margin stays within 2.2 m.",
        ),
        (lambda: optimize(RIG, solver="snopt"), 'solver must be "auto", "fatrop" or "ipopt"; got \'snopt\'.'),  # type: ignore[arg-type]
        (
            lambda: optimize(RIG.replace(mass1=np.array([0.5, 0.6]))),
            "optimize takes one plant; got a rig of 2 rows. Take one of them with rig.rows(i).",
        ),
    ],
)
def test_wrong_use_is_refused_before_anything_runs(call: Callable[[], Any], message: str) -> None:
    with pytest.raises(ValueError, match=whole(message)):
        call()


# -------------------------------------------------------------------------------------------------------------- shipped


def test_there_is_a_file_for_every_recipe_and_no_other() -> None:
    assert {path.name for path in SHIPPED} == {recipe.file for recipe in RECIPES}
    assert sum(path.stat().st_size for path in SHIPPED) < 400_000


@pytest.mark.parametrize("recipe", RECIPES, ids=lambda recipe: recipe.file.removesuffix(".npz"))
def test_what_is_shipped_holds_in_the_simulator_and_says_where_it_comes_from(recipe: Any) -> None:
    rig = dpend.rig(recipe.rig)
    found = shipped(rig, recipe.start, recipe.target, recipe.objective)
    assert found is not None
    about = found.about
    assert violations(found, track_margin=about["track_margin"]) == ""
    assert_array_equal(found.x[0], STARTS[recipe.start])
    assert_allclose(np.cos(found.target[1:3]), np.cos(EQUILIBRIA[recipe.target][1:3]), atol=1e-12)
    asked = {"preset": recipe.rig, "start": recipe.start, "target": recipe.target, "objective": recipe.objective}
    assert (asked | recipe.options | {"solver": about["solver"]}).items() <= about.items()
    assert {"cost", "iterations", "converged", "tried", "versions", "seed"} <= set(about)
    assert "/" not in json.dumps(dict(about))
    if recipe.objective == "effort":
        assert found.rig == replace(
            rig, actuator_lag=0.0, actuator_delay=0, force_noise=0.0, sensor_delay=0, sensor_noise=0.0, resolution=0.0
        )


def test_a_shipped_trajectory_is_for_exactly_its_plant_clock_and_limits() -> None:
    assert shipped("gustafsson2016") is shipped(RIG, "down-down", "up-up")
    assert shipped(RIG.replace(sensor_noise=0.01, actuator_delay=1)) is not None
    changes = ({"mass1": 0.51}, {"sample_time": 0.01}, {"substeps": 4}, {"force_limit": 20.0}, {"track_limit": 2.0})
    assert [shipped(RIG.replace(**change)) for change in changes] == [None] * len(changes)
    assert shipped(RIG.replace(sample_time=0.01), objective="time") is not None
    assert shipped(RIG.replace(mass1=np.array([0.5, 0.5]))) is None
    assert shipped(RIG, "side", "down-down") is None


def test_minimum_times_from_hanging_and_from_the_side_are_as_published() -> None:
    hanging, side = (shipped(RIG, start, objective="time") for start in ("hanging", "side"))
    assert hanging is not None
    assert side is not None
    assert hanging.duration <= 1.51
    assert side.duration <= 1.82  # what a predictive controller takes


def test_the_files_lie_where_the_package_does() -> None:
    assert Path(dpend.__file__).parent.parent == FOLDER.parent.parent
