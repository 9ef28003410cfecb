"""What every controller promises, held for all that ``controllers`` exports, on every preset."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

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
from dpend.check import (
    CONTROLLER_CHECKS,
    ContractError,
    ControllerCheck,
    a_step_takes_less_than_a_sample,
    answers,
    measurements,
    mirrored_forces,
    whole_turns_change_nothing,
)
from dpend.controller import is_batched
from dpend.rig import ideal_rig
from rl import GainPolicy, LinearQPolicy, MLPPolicy, ModelPolicy, Network, PlannedPolicy, TableOneMean
from rl.kernel_model import KernelModel, Priors, Transitions


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
    return KernelModel.fit(data, rig.sample_time, Priors(True, True, True, True), rng, None)


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


@cache
def built(name: str, preset: str) -> Any:
    """Build a controller with its defaults; none refuses a preset."""
    rig = dpend.rig(preset)
    if name in RECIPES:
        return RECIPES[name](rig)
    make = getattr(controllers, name)
    return make(rig) if "rig" in inspect.signature(make).parameters else make()


# Table 1's features have angles as they are.
EXEMPT = {"LinearQPolicy": {whole_turns_change_nothing}}
# What plans takes a second for each plant: a strong actuator and a weak one are tried, and the others at night.
QUICK = ("gustafsson2016", "dompc_dip")
PLANNERS = {"ILQRMPC", "ModelPolicy", "NMPC", "PlannedPolicy"}
COSTLY = {mirrored_forces, a_step_takes_less_than_a_sample}
# By a force, by weights, by the way up.
ONE_SIDED = {"Constant", "MLPPolicy", "TableOneMean", "TVLQR"}


def checks_of(name: str) -> list[ControllerCheck]:
    """Return the checks that a controller is under."""
    checks = [check for check in CONTROLLER_CHECKS if check not in EXEMPT.get(name, ())]
    return checks if name in ONE_SIDED else [*checks, mirrored_forces]


def presets_of(check: ControllerCheck, name: str) -> Iterable[str]:
    """Return the presets on which a check is tried, but at night."""
    return QUICK if name in PLANNERS or check in COSTLY else dpend.rigs()


@pytest.mark.parametrize(
    ("check", "name", "presets"),
    [
        pytest.param(check, name, presets, id=f"{check.__name__}-{name}{kind}", marks=marks)
        for name in NAMES
        for check in checks_of(name)
        for fast in [presets_of(check, name)]
        for presets, kind, marks in (
            (fast, "", [pytest.mark.slow] if name == "ModelPolicy" else []),  # whose model is slow to compile
            ([preset for preset in dpend.rigs() if preset not in fast], "-other presets", [pytest.mark.nightly]),
        )
        if presets
    ],
)
def test_a_controller_keeps_its_contract(check: ControllerCheck, name: str, presets: Iterable[str]) -> None:
    for preset in presets:
        try:
            check(built(name, preset), dpend.rig(preset))
        except ContractError as error:
            error.add_note(f"It is built for {preset}.")
            raise


def test_the_simplest_controllers_are_under_this_contract() -> None:
    assert {"LQR", "BangBang", "Constant", "Zero"} <= set(NAMES)


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
    whole_turns_change_nothing(wrapped, RIG)
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
    assert_array_equal(answers(law, RIG, broken), answers(law, RIG, repeated))
