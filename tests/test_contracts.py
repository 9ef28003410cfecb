"""What every controller promises, held for all that ``controllers`` exports, on every preset."""

from __future__ import annotations

import inspect
import pickle
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import controllers
import dpend
import rl
from controllers import (
    EKF,
    ILQRMPC,
    LQR,
    SDRE,
    UKF,
    BangBang,
    Constant,
    Differences,
    EnergyPump,
    LinearLaw,
    LowPass,
    NearEnergy,
    Predictor,
    RateLimit,
    SwitchingController,
    TunedLaw,
    WithEstimator,
)
from controllers.tuning import TuningCost
from dpend import Controller, Rig
from dpend.controller import check_controller, is_batched
from dpend.params import Array
from dpend.rig import ideal_rig
from rl import GainPolicy, LinearQPolicy, MLPPolicy, ModelPolicy, Network, PlannedPolicy, TableOneMean
from rl.kernel_model import KernelModel, Told, Transitions


def random_network() -> Network:
    """Return a small network that sees a state and its own last action."""
    rng = np.random.default_rng(0)
    return Network([rng.normal(size=(16, 9)), rng.normal(size=(1, 16))], [rng.normal(size=16), [0.1]])


def small_model(rig: Rig) -> KernelModel:
    """Return a model fitted to twenty samples of the plant near upright."""
    rng = np.random.default_rng(0)
    x, u = 0.3 * rng.standard_normal((20, 6)), min(float(rig.force_limit), 50.0) * rng.uniform(-1, 1, 20)
    plant = dpend.Stepper(ideal_rig(rig), 20)
    plant.reset(x)
    plant.step(u)
    data = Transitions(x, u, plant.x)
    return KernelModel.fit(data, rig.sample_time, Told(True, True, True, True), rng, None)


# What cannot be built from a rig alone; every other class with a method `start` must be.
RECIPES: dict[str, Callable[[Rig], Any]] = {
    "BangBang": lambda rig: BangBang(LQR(rig), min(float(np.max(rig.force_limit)), 50.0)),
    "SwitchingController": lambda rig: SwitchingController(rig, EnergyPump(rig)),
    "Constant": lambda rig: Constant(1.5),
    "GainPolicy": lambda rig: GainPolicy((1.0, -8.0, 9.0, 1.0, -0.5, 2.0)),
    "LinearLaw": lambda rig: LinearLaw(LQR(rig).K),
    "TunedLaw": lambda rig: TunedLaw(
        rig=rig, law="gain", numbers=LQR(rig).K[0], saved=1.0, cost=TuningCost(1, 1, 6.0, 0.1), about={}
    ),
    "LowPass": lambda rig: LowPass(rig, LQR(rig), frequency=20.0),
    "RateLimit": lambda rig: RateLimit(rig, LQR(rig), 500.0),
    "LinearQPolicy": lambda rig: LinearQPolicy(np.linspace(-1, 1, 18), np.ones(18), (0.0, -4.0, 4.0)),
    "TableOneMean": lambda rig: TableOneMean(np.linspace(-1, 1, 20), "cells"),
    "MLPPolicy": lambda rig: MLPPolicy(
        random_network(), scales=np.ones(4), force_limit=min(float(np.max(rig.force_limit)), 50.0), period=0.03
    ),
    "ModelPolicy": lambda rig: ModelPolicy(
        small_model(rig),
        sample_time=rig.sample_time,
        force_limit=float(rig.force_limit),
        track_limit=float(rig.track_limit),
    ),
    "PlannedPolicy": lambda rig: PlannedPolicy(rig),
    "WithEstimator": lambda rig: WithEstimator(EKF(rig), LQR(rig)),
}
NAMES = sorted(
    name
    for package in (controllers, rl)
    for name in package.__all__
    if inspect.isclass(thing := getattr(package, name)) and hasattr(thing, "start")
)
PRESETS = tuple(dpend.rigs())


@cache
def built(name: str, preset: str) -> Any:
    """Build a controller with its defaults; one that refuses the preset must say why."""
    rig = dpend.rig(preset)
    if name in RECIPES:
        return RECIPES[name](rig)
    make = getattr(controllers, name)
    try:
        return make(rig) if "rig" in inspect.signature(make).parameters else make()
    except ValueError as refusal:
        return refusal


PAIRS = [
    pytest.param(
        (name, preset),
        id=f"{name}-{preset}",
        # Its solver takes a second for each plant; the fast tests try a strong actuator and a weak one.
        marks=[pytest.mark.slow] if name == "NMPC" and preset not in ("gustafsson2016", "dompc_dip") else [],
    )
    for preset in PRESETS
    for name in NAMES
]


@pytest.fixture(params=PAIRS)
def pair(request: pytest.FixtureRequest) -> tuple[str, str]:
    return request.param


@pytest.fixture
def preset(pair: tuple[str, str]) -> str:
    return pair[1]


@pytest.fixture
def controller(pair: tuple[str, str]) -> Controller:
    made = built(*pair)
    if isinstance(made, ValueError):
        pytest.skip(f"{pair[0]} refuses {pair[1]}: {made}")
    return made


def sizes(controller: Controller) -> tuple[int, ...]:
    return (1, 5) if is_batched(controller) else (1,)


def measurements(n: int, samples: int = 4, seed: int = 0) -> Array:
    """Return measurements ``(samples, n, 6)`` from near upright."""
    return 0.1 * np.random.default_rng(seed).standard_normal((samples, n, 6))


def answers(controller: Controller, y: Array, seed: int = 1) -> Array:
    """Return the forces ``(samples, n)`` of a fresh run on measurements."""
    act = controller.start(y.shape[1], np.random.default_rng(seed))
    return np.array([np.array(act(0.02 * k, row.copy())) for k, row in enumerate(y)])


def test_the_simplest_controllers_are_under_this_contract() -> None:
    assert {"LQR", "BangBang", "Constant", "Zero"} <= set(NAMES)
    assert not [name for name in NAMES if isinstance(built(name, "gustafsson2016"), ValueError)]


def test_a_controller_is_what_the_protocol_asks(controller: Controller) -> None:
    check_controller(controller)
    assert list(inspect.signature(controller.start).parameters) == ["n", "rng"]


def test_it_answers_one_finite_force_a_row(controller: Controller) -> None:
    for n in sizes(controller):
        act = controller.start(n, np.random.default_rng(0))
        for k, y in enumerate(measurements(n)):
            u = act(0.02 * k, y)
            assert isinstance(u, np.ndarray)
            assert (u.shape, u.dtype) == ((n,), np.float64)
            assert np.isfinite(u).all()


def test_the_same_generator_gives_the_same_answers(controller: Controller) -> None:
    for n in sizes(controller):
        y = measurements(n)
        assert_array_equal(answers(controller, y), answers(controller, y))


def test_it_leaves_the_measurements_alone(controller: Controller) -> None:
    for n in sizes(controller):
        act = controller.start(n, np.random.default_rng(0))
        for k, y in enumerate(measurements(n)):
            kept = y.copy()
            y.setflags(write=False)
            act(0.02 * k, y)
            assert_array_equal(y, kept)


def test_its_answers_are_the_callers_to_change(controller: Controller) -> None:
    for n in sizes(controller):
        y = measurements(n)
        act = controller.start(n, np.random.default_rng(1))
        for k, expected in enumerate(answers(controller, y)):
            u = act(0.02 * k, y[k])
            assert_array_equal(u, expected)
            if u.flags.writeable:
                u[:] = 1e6


def test_one_object_serves_two_runs_at_once(controller: Controller) -> None:
    for n in sizes(controller):
        one, two = measurements(n, seed=2), measurements(n, seed=3)
        first = controller.start(n, np.random.default_rng(1))
        second = controller.start(n, np.random.default_rng(1))
        interleaved = [(np.array(first(0.02 * k, one[k])), np.array(second(0.02 * k, two[k]))) for k in range(len(one))]
        mine, theirs = zip(*interleaved, strict=True)
        assert_array_equal(mine, answers(controller, one))
        assert_array_equal(theirs, answers(controller, two))


def test_a_run_looks_at_its_own_row_only(controller: Controller) -> None:
    if is_batched(controller):
        y = measurements(5)
        order = [3, 0, 4, 1, 2]
        assert_allclose(answers(controller, y[:, order]), answers(controller, y)[:, order], rtol=0, atol=1e-9)
        assert_allclose(answers(controller, y[:, 2:3]), answers(controller, y)[:, 2:3], rtol=0, atol=1e-9)


def test_it_comes_out_of_a_pickle_as_it_went_in(controller: Controller) -> None:
    restored = pickle.loads(pickle.dumps(controller))
    y = measurements(1)
    assert_array_equal(answers(restored, y), answers(controller, y))


def test_it_drives_the_rig_it_was_made_for(controller: Controller, preset: str) -> None:
    rig = dpend.rig(preset)
    x0 = np.zeros((3, 6))
    x0[:, 1] = [0.01, -0.01, 0.02]
    runs = dpend.simulate_many(rig, controller, x0, 3 * rig.sample_time)
    assert runs.success.all()
    assert np.isfinite(runs.u).all()


def turned(y: Array) -> Array:
    """Return measurements ``(samples, n, 6)`` with other whole turns at each."""
    other = y.copy()
    other[..., 1:3] += 2 * np.pi * np.random.default_rng(4).integers(-3, 4, (*y.shape[:2], 2))
    return other


def assert_same_forces(found: Array, expected: Array) -> None:
    """Assert that forces agree to the rounding of a turn, which an unstable plant magnifies."""
    assert_allclose(found, expected, rtol=0, atol=1e-6 * max(1.0, np.abs(expected).max()))


OWN = [pair for pair in PAIRS if pair.values[0][0] in (*controllers.__all__, "ModelPolicy", "PlannedPolicy")]  # type: ignore[index,operator]


@pytest.mark.parametrize("pair", OWN, indirect=True)
def test_angles_that_differ_by_whole_turns_are_the_same_angles(controller: Controller) -> None:
    for n in sizes(controller):
        y = measurements(n, samples=6)
        assert_same_forces(answers(controller, turned(y)), answers(controller, y))


@pytest.mark.parametrize("pair", OWN, indirect=True)
def test_whatever_is_measured_the_force_is_finite(controller: Controller) -> None:
    for n in sizes(controller):
        y = measurements(n, samples=8)
        y[0, 0, 1] = y[3, -1] = y[5, 0, 0] = np.nan
        y[4, 0, 4] = np.inf
        assert np.isfinite(answers(controller, y)).all()


# ---------------------------------------------------------------------------------------------- wrappers and estimators

RIG = dpend.rig("gustafsson2016")
LATE = RIG.replace(sensor_delay=1, actuator_delay=1, actuator_lag=0.01)
WRAPPERS: dict[str, Callable[[Controller], Any]] = {
    "BangBang": lambda law: BangBang(law, 10.0),
    "LowPass": lambda law: LowPass(RIG, law, frequency=20.0),
    "RateLimit": lambda law: RateLimit(RIG, law, 500.0),
    **{
        f"WithEstimator({kind.__name__})": lambda law, kind=kind: WithEstimator(kind(LATE), law)
        for kind in (EKF, UKF, Differences, Predictor)
    },
}


@pytest.mark.parametrize("wrap", WRAPPERS.values(), ids=WRAPPERS)
@pytest.mark.parametrize("law", [SDRE(RIG), ILQRMPC(RIG, upright_only=True)], ids=["batched", "one by one"])
def test_a_wrapper_passes_on_the_name_the_log_and_how_many_runs_are_treated_at_once(law: Any, wrap: Any) -> None:
    wrapped = wrap(law)
    assert wrapped.controller is law
    assert wrapped.batched == is_batched(law)
    assert law.name in wrapped.name
    assert repr(wrapped) == f"<{wrapped.name}>"
    x0 = np.zeros((2, 6))
    x0[:, 1] = 0.05
    log = dpend.simulate_many(RIG, wrapped, x0, 0.1).log
    names = set(dpend.simulate_many(RIG, law, x0, 0.1).log)
    assert set(log) == names
    assert np.isfinite([log[name] for name in names]).all()


def test_switching_logs_what_the_law_in_charge_logs_and_nothing_of_the_other() -> None:
    planner = ILQRMPC(RIG, upright_only=True)
    law = SwitchingController(
        RIG, SDRE(RIG), planner, region=lambda x: np.abs(x[:, 1]) > 0.1, leave=lambda x: x[:, 1] < 0.1
    )
    nested = SwitchingController(RIG, law, SDRE(RIG), region=NearEnergy(RIG, 1e-9))
    act = nested.start(1, np.random.default_rng(0))
    for k, lean in enumerate((0.05, 0.2, 0.3, 0.05, 0.2)):
        act(0.02 * k, np.array([[0, lean, 0.0, 0, 0, 0]]))
    log = {name: np.ravel(entries) for name, entries in act.log.items()}  # type: ignore[attr-defined]
    assert set(log) == {"caught", "first.caught", "kept", "status", "iterations", "cost"}
    assert_array_equal(log["caught"], 0.0)
    assert_array_equal(log["first.caught"], [0, 1, 1, 0, 1])
    assert_array_equal(np.isfinite(log["kept"]), [True, False, False, True, False])
    for name in ("status", "iterations", "cost"):
        assert_array_equal(np.isfinite(log[name]), [False, True, True, False, True])


@pytest.mark.parametrize("wrap", WRAPPERS.values(), ids=WRAPPERS)
def test_whole_turns_and_missing_measurements_pass_through_a_wrapper(wrap: Any) -> None:
    wrapped = wrap(LQR(RIG))
    y = measurements(3, samples=12)
    assert_same_forces(answers(wrapped, turned(y)), answers(wrapped, y))
    broken = y.copy()
    broken[0, 0], broken[4, 1, 1], broken[7, :, 2] = np.nan, np.inf, np.nan
    act = wrapped.start(3, np.random.default_rng(0))
    forces = np.array([act(0.02 * k, row) for k, row in enumerate(broken)])
    assert np.isfinite(forces).all()
    assert forces[0, 0] == 0.0
    assert_array_equal(act.log["held"], ~np.isfinite(broken).all(axis=2))


@pytest.mark.parametrize(
    "law",
    [LQR(RIG), SDRE(RIG), RateLimit(RIG, LQR(RIG), 1e9), SwitchingController(RIG, EnergyPump(RIG))],
    ids=lambda law: law.name,
)
def test_the_last_finite_measurement_of_a_row_counts_for_one_that_is_missing(law: Any) -> None:
    y = measurements(2, samples=4)
    broken, repeated = y.copy(), y.copy()
    broken[2, 1, 3] = np.nan
    repeated[2, 1] = y[1, 1]
    assert_array_equal(answers(law, broken), answers(law, repeated))
