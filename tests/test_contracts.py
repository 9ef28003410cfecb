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
from controllers import EKF, LQR, BangBang, Constant, EnergyPump, LowPass, RateLimit, SwitchingController, WithEstimator
from dpend import Controller, Rig
from dpend.controller import check_controller, is_batched
from dpend.params import Array
from rl import GainPolicy, LinearQPolicy, MLPPolicy, Network


def random_network() -> Network:
    """Return a small network that sees a state and its own last action."""
    rng = np.random.default_rng(0)
    return Network([rng.normal(size=(16, 9)), rng.normal(size=(1, 16))], [rng.normal(size=16), [0.1]])


# What cannot be built from a rig alone; every other class with a method `start` must be.
RECIPES: dict[str, Callable[[Rig], Any]] = {
    "BangBang": lambda rig: BangBang(LQR(rig), min(float(np.max(rig.force_limit)), 50.0)),
    "SwitchingController": lambda rig: SwitchingController(rig, EnergyPump(rig)),
    "Constant": lambda rig: Constant(1.5),
    "GainPolicy": lambda rig: GainPolicy((1.0, -8.0, 9.0, 1.0, -0.5, 2.0)),
    "LowPass": lambda rig: LowPass(rig, LQR(rig), frequency=20.0),
    "RateLimit": lambda rig: RateLimit(rig, LQR(rig), 500.0),
    "LinearQPolicy": lambda rig: LinearQPolicy(np.linspace(-1, 1, 18), np.ones(18), (0.0, -4.0, 4.0)),
    "MLPPolicy": lambda rig: MLPPolicy(
        random_network(), scales=np.ones(4), force_limit=min(float(np.max(rig.force_limit)), 50.0), period=0.03
    ),
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
