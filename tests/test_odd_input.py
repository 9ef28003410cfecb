"""Whatever is passed in, a call works or is refused within a second by an error that this project raised itself."""

import datetime
import time
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from refusals import refusal

import dpend
import dpend.env
import dpend.vector_env
from controllers import (
    EKF,
    ILQRMPC,
    LQR,
    NMPC,
    SDRE,
    TVLQR,
    UKF,
    BangBang,
    Constant,
    Differences,
    Ellipsoid,
    EnergyPump,
    EnergySwingUp,
    LinearLaw,
    LowPass,
    NearEnergy,
    Predictor,
    RateLimit,
    RolloutRegion,
    SwitchingController,
    Trajectory,
    WithEstimator,
    Zero,
    ilqr,
    optimize,
    shipped,
    tuned_gain,
    tuned_law,
    tuned_weights,
    violations,
)
from dpend.metrics import force_metrics, power_spectrum, smoothness_metrics
from dpend.state import as_equilibrium, as_states, deviation
from rl import (
    LSPI,
    DeepRecipe,
    GainPolicy,
    GaussianQAC,
    IdentifyAndPlan,
    LinearQLearning,
    LinearQPolicy,
    MLPPolicy,
    ModelBased,
    ModelPolicy,
    NaturalQAC,
    Network,
    PlannedPolicy,
    QuadraticQLearning,
    TableOneMean,
)

MANY = 100_000
SLOW = (HealthCheck.too_slow,)
RIG = dpend.rig("gustafsson2016")
PLANT = RIG.params
REST = np.zeros(6)
LEANING = np.array([0.0, 0.05, -0.05, 0.0, 0.0, 0.0])
FORCES = np.ones((2, 20))
COMPILED: set[Any] = set()  # calls that have taken long once
QUICK: dict[str, Any] = {"iterations": 1, "starts": 0}
AVERSE: Any = {"starts": -1}  # refused after the others, before anything is planned
RUN = dpend.simulate(RIG.replace(sensor_noise=0.01), LQR(RIG), LEANING, 1.0)
PLAN = Trajectory(rig=RIG, x=np.zeros((9, 6)), u=np.zeros(8), target=REST)
LEARNERS: tuple[Any, ...] = (
    LSPI, QuadraticQLearning, GaussianQAC, NaturalQAC, LinearQLearning, ModelBased, IdentifyAndPlan, DeepRecipe,
)  # fmt: skip
NETWORK = Network([np.ones((1, 8))], [np.zeros(1)])
OF_NETWORK: dict[str, Any] = {"scales": np.ones(4), "force_limit": 40.0, "period": 0.04}
CLOCK: dict[str, Any] = {"sample_time": 0.02, "force_limit": 40.0, "track_limit": 2.4}

Call = Callable[[Any], object]


def reference(*arguments: Any, **settings: Any) -> None:
    """Ask for a motion, which may be one that cannot be followed: that is no fault of an argument."""
    try:
        dpend.reference(*arguments, **settings)
    except RuntimeError as error:
        if not str(error).startswith("The reference cannot follow the motion"):
            raise


SURFACES: dict[str, list[Call]] = {
    "plant": [
        lambda v: dpend.rates(v, 0.0, PLANT),
        lambda v: dpend.rates(REST, v, PLANT),
        lambda v: dpend.rates(REST, 0.0, v),
        lambda v: dpend.linearize(v),
        lambda v: dpend.linearize(PLANT, v),
        lambda v: dpend.linearize(PLANT, None, v),
        lambda v: dpend.discretize(v, np.zeros((6, 1)), 0.02),
        lambda v: dpend.discretize(np.eye(6), v, 0.02),
        lambda v: dpend.discretize(np.eye(6), np.zeros((6, 1)), v),
        lambda v: dpend.positions(v, PLANT),
        lambda v: dpend.energies(v, PLANT),
        lambda v: dpend.energies(REST, v),
        lambda v: reference(v, REST, [0.0], [0, 0.02]),
        lambda v: reference(PLANT, REST, v, [0, 0.02]),
        lambda v: reference(PLANT, REST, [0.0], v),
        lambda v: reference(PLANT, REST, [0.0], [0, 0.02], rtol=v),
    ],
    "states": [
        lambda v: as_states(v),
        lambda v: as_states(v, 1),
        lambda v: as_equilibrium(v),
        lambda v: dpend.wrap(v),
        lambda v: dpend.nearest_upright(v),
        lambda v: deviation(v, REST),
        lambda v: deviation(REST, v),
        lambda v: SDRE(RIG).gains(v),
        lambda v: EnergySwingUp(RIG).force(v),
        lambda v: EnergyPump(RIG).momentum(v),
    ],
    "rigs": [
        lambda v: dpend.rig(v),
        lambda v: dpend.Rig(params=v, sample_time=0.02),
        lambda v: dpend.Rig.from_dict(v),
        lambda v: dpend.Params(cart_mass=v, mass1=1, mass2=1, length1=1, length2=1),
        *(
            lambda v, name=field: RIG.replace(**{name: v})
            for field in [*RIG.to_dict(), *PLANT.to_dict()]
            if field != "params"
        ),
    ],
    "simulation": [
        lambda v: dpend.simulate(v, Zero(), LEANING, 0.1),
        lambda v: dpend.simulate(RIG, v, LEANING, 0.1),
        lambda v: dpend.simulate(RIG, Zero(), v, 0.1),
        lambda v: dpend.simulate(RIG, Zero(), REST, 0.1, task=v),
        lambda v: dpend.simulate(RIG, Zero(), REST, 0.1, push=lambda t: v),
        lambda v: dpend.simulate(RIG, Zero(), REST, 0.1, seed=v),
        lambda v: dpend.simulate(RIG, lambda t, x: v, REST, 0.1),
        lambda v: dpend.simulate_many(RIG, Zero(), v, 0.1),
        lambda v: dpend.simulate_many(RIG, Zero(), REST, 0.1, first_row=v),
        lambda v: dpend.simulate_many(RIG, Zero(), REST, 0.1, workers=v),
        lambda v: dpend.Stepper(RIG, 1, v),
        lambda v: dpend.Stepper(RIG.replace(sensor_noise=0.1), 1, 0, v),
        lambda v: dpend.Stepper(RIG, 1).reset(v),
        lambda v: dpend.Stepper(RIG, 1).step(v),
        lambda v: dpend.Stepper(RIG, 1).step([0.0], v),
        lambda v: force_metrics(v, 0.02, 40.0),
        lambda v: force_metrics(FORCES, v, 40.0),
        lambda v: force_metrics(FORCES, 0.02, v),
        lambda v: force_metrics(FORCES, 0.02, 40.0, force_noise=v),
        lambda v: power_spectrum(v, 0.02, 40.0),
        lambda v: power_spectrum(FORCES, v, 40.0),
        lambda v: power_spectrum(FORCES, 0.02, 40.0, highest=v),
        lambda v: smoothness_metrics(v, 0.02, 40.0),
        lambda v: RUN.smoothness(lag=v),
        lambda v: RUN.smoothness(cutoff=v),
        lambda v: dpend.identify(v, RIG, ["mass1"]),
        lambda v: dpend.identify(RUN, v, ["mass1"]),
        lambda v: dpend.identify(RUN, RIG, v),
        lambda v: dpend.identify(RUN, RIG, ["mass1"], outputs=v),
        lambda v: dpend.check_controller(Zero(), v, skip=[v]),
    ],
    "regulators": [
        lambda v: LQR(RIG, v),
        lambda v: LQR(RIG, None, v),
        lambda v: LQR(RIG, target=v),
        lambda v: LQR(RIG, design=v),
        lambda v: SDRE(RIG, v),
        lambda v: TVLQR(RIG, v),
        lambda v: TVLQR(RIG, Q=v),
        lambda v: TVLQR(RIG, index=v),
        lambda v: Constant(v),
        lambda v: BangBang(v, 1.0),
        lambda v: BangBang(Zero(), v),
        lambda v: LowPass(RIG, v, frequency=5.0),
        lambda v: LowPass(RIG, Zero(), frequency=v),
        lambda v: LowPass(RIG, Zero(), frequency=5.0).response(v),
        lambda v: RateLimit(RIG, Zero(), v),
        lambda v: EnergySwingUp(RIG, k_x=v),
        lambda v: EnergyPump(RIG, perturbation=v),
        lambda v: LinearLaw(v),
        lambda v: LinearLaw(np.ones(6), target=v),
        lambda v: tuned_law(v, "gain"),
        lambda v: tuned_law(RIG, v),
        *(lambda v, name=name: tuned_gain(RIG, **{"evaluations": 0, name: v}) for name in ("bang_bang", "begin")),
        lambda v: tuned_weights(RIG, grid=v),
    ],
    "planners": [
        lambda v: ilqr(RIG, v, **QUICK),
        *(
            lambda v, name=name: ilqr(RIG, LEANING, **QUICK, **{name: v})
            for name in ("target", "horizon", "u_guess", "x_guess", "Q", "R", "tolerance", "seed")
        ),
        *(
            lambda v, name=name: ILQRMPC(RIG, **{name: v})
            for name in ("target", "Q", "R", "horizon", "starts", "model", "explore")
        ),
        *(
            lambda v, name=name: NMPC(RIG, **{name: v})
            for name in ("target", "cost", "horizon", "Q", "R", "rate_weight", "margin", "max_iterations", "solver")
        ),
        *(
            lambda v, name=name: optimize(RIG, **{name: v}, **AVERSE)
            for name in ("start", "target", "objective", "duration", "smoothing", "track_margin", "guess", "seed")
        ),
        lambda v: Trajectory(rig=RIG, x=v, u=np.zeros(8), target=REST),
        lambda v: Trajectory(rig=RIG, x=np.zeros((9, 6)), u=v, target=REST),
        lambda v: violations(v),
        lambda v: violations(PLAN, track_margin=v),
        lambda v: shipped(v),
        *(lambda v, name=name: shipped(RIG, **{name: v}) for name in ("start", "target", "objective")),
    ],
    "estimators": [
        lambda v: EKF(v),
        lambda v: EKF(RIG, process_noise=v),
        lambda v: EKF(RIG, measurement_noise=v),
        lambda v: UKF(RIG, rates_noise=v),
        lambda v: Differences(v),
        lambda v: Predictor(v),
        lambda v: WithEstimator(v, Zero()),
        lambda v: WithEstimator(EKF(RIG), v),
    ],
    "switching": [
        lambda v: SwitchingController(v, Zero()),
        lambda v: SwitchingController(RIG, v),
        lambda v: SwitchingController(RIG, Zero(), v),
        lambda v: SwitchingController(RIG, Zero(), region=v),
        lambda v: SwitchingController(RIG, Zero(), leave=v),
        lambda v: RolloutRegion(RIG, v),
        lambda v: RolloutRegion(RIG, Zero(), target=v),
        lambda v: RolloutRegion(RIG, Zero(), duration=v),
        lambda v: NearEnergy(RIG, v),
        lambda v: Ellipsoid(v, 1.0),
        lambda v: Ellipsoid(LQR(RIG), v),
        lambda v: Ellipsoid.within_limits(v),
        lambda v: Ellipsoid.calibrated(v),
        lambda v: Ellipsoid(LQR(RIG), 1.0).cost(v),
        lambda v: Ellipsoid(LQR(RIG), 1.0).boundary(v, np.random.default_rng(0)),
        lambda v: Ellipsoid(LQR(RIG), 1.0).boundary(2, v),
        lambda v: NearEnergy(RIG)(v),
        lambda v: RolloutRegion(RIG, Zero(), duration=0.1)(v),
    ],
    "tasks": [
        *(
            lambda v, name=name: dpend.Balance(**{name: v})
            for name in ("lam", "steps", "criterion", "state_weights", "failure_cost")
        ),
        *(
            lambda v, name=name: dpend.SwingUp(**{name: v})
            for name in ("start", "target", "angle_spread", "hold", "upright_angle")
        ),
        lambda v: dpend.Balance().starts(v, 2, RIG),
        lambda v: dpend.SwingUp().starts(v, 2, RIG),
        lambda v: dpend.SwingUp(start="anywhere").starts(np.random.default_rng(0), 2, v),
        lambda v: dpend.Balance().ended(v, RIG),
        lambda v: dpend.Balance().cost(v, np.zeros(6, np.uint8)),
        lambda v: dpend.SwingUp().upright(v),
    ],
    "learners": [
        *(lambda v, learner=each: learner(v) for each in LEARNERS),
        *(
            lambda v, learner=each, name=field.name: learner(RIG, **{name: v})
            for each in LEARNERS
            for field in fields(each)
            if field.name != "rig"
        ),
        lambda v: LSPI(RIG).train(v, seconds=0.02),
        # What a function raises that takes something else is its own affair.
        lambda v: LSPI(RIG).train(0, seconds=0.02, progress=None if callable(v) else v),
    ],
    "policies": [
        *(lambda v, kind=kind: kind(v) for kind in (GainPolicy, PlannedPolicy)),
        lambda v: GainPolicy(REST, about=v),
        lambda v: LinearQPolicy(v, np.ones(18), [0, 1]),
        lambda v: LinearQPolicy(np.ones(18), v, [0, 1]),
        lambda v: LinearQPolicy(np.ones(18), np.ones(18), v),
        lambda v: TableOneMean(v, "none"),
        lambda v: TableOneMean(np.ones(12), v),
        lambda v: MLPPolicy(v, **OF_NETWORK),
        *(lambda v, name=name: MLPPolicy(NETWORK, **(OF_NETWORK | {name: v})) for name in OF_NETWORK),
        lambda v: ModelPolicy(v, **CLOCK),
        lambda v: Network(v, [np.zeros(1)]),
        lambda v: Network([np.ones((1, 8))], v),
        *(
            lambda v, name=name: Network([np.ones((1, 8))], [np.zeros(1)], **{name: v})
            for name in ("activation", "squash")
        ),
        lambda v: NETWORK(v),
    ],
    "environments": [
        lambda v: dpend.env.CartDoublePendulumEnv(v, RIG),
        *(
            lambda v, name=name: dpend.env.balance(**{name: v})
            for name in ("rig", "reward", "forces", "observation", "render_mode", "lam")
        ),
        *(
            lambda v, name=name: dpend.vector_env.balance_vector(**{name: v})
            for name in ("rig", "reward", "forces", "autoreset_mode", "max_episode_steps")
        ),
        lambda v: dpend.env.balance().reset(options=v),
        lambda v: dpend.env.balance().reset(options={"x0": v}),
        lambda v: dpend.vector_env.balance_vector(2).reset(options={"x0": v}),
    ],
}

NUMBERS = st.sampled_from([0, 1, -1, 1.5, 1e-300, 1e12, -1e300, 2**70, 10**400, np.nan, np.inf, -np.inf])
ATOMS = st.one_of(
    NUMBERS,
    st.sampled_from(["", "word", "1.0", b"x", None, True, 1j, datetime.date(2020, 1, 1), np.datetime64("2020-01-01")]),
    st.builds(object),
)
ARRAYS = st.builds(
    lambda shape, number: np.full(shape, number, dtype=float),
    st.sampled_from([(), (0,), (2,), (3,), (5,), (6,), (1, 6), (0, 6), (2, 3), (6, 6), (9, 6), (2, 2, 6)]),
    st.sampled_from([0.0, 1.0, -1.0, 1e-300, 1e20, 1e300, np.nan, np.inf]),
)
ODD = st.one_of(
    ATOMS,
    ARRAYS,
    st.lists(ATOMS, max_size=6),
    st.lists(ATOMS, min_size=6, max_size=6),
    st.lists(st.lists(NUMBERS, max_size=6), max_size=3),
    st.builds(lambda atom: [atom] * 6, ATOMS),
    st.builds(lambda word: np.array([word] * 6), st.sampled_from(["a", "1"])),
    st.sampled_from([{}, {"a": 1}, {1, 2}, int, dpend.Balance, slice(1), RIG, np.zeros(6, dtype=[("a", float)])]),
)


def judged(call: Call, value: Any) -> None:
    """Hold a call to the promise: an error is raised by a line of this project, not by a library that it calls.

    The first time that a call takes longer it may have compiled and imported what it needs; it has one more try.
    """
    if (took := seconds(call, value)) >= 1.0 and call not in COMPILED:
        COMPILED.add(call)
        took = seconds(call, value)
    assert took < 1.0


def seconds(call: Call, value: Any) -> float:
    """Return the processor time of a call that works or is refused, s."""
    began = time.process_time()
    refusal(call, value)
    return time.process_time() - began


def check_surface(surface: str, cases: int) -> None:
    """Pass so many odd values to the calls of a surface."""

    @settings(max_examples=cases, suppress_health_check=SLOW)
    @given(st.sampled_from(SURFACES[surface]), ODD)
    @example(SURFACES[surface][0], [[1, 2], [3]])
    def check(call: Call, value: Any) -> None:
        judged(call, value)

    check()


@pytest.mark.parametrize("surface", SURFACES)
def test_odd_input_works_or_is_refused_in_this_projects_own_words_within_a_second(surface: str) -> None:
    check_surface(surface, 60)


@pytest.mark.nightly
@pytest.mark.parametrize("surface", SURFACES)
def test_a_hundred_thousand_odd_values_work_or_are_refused_within_a_second(surface: str) -> None:
    check_surface(surface, MANY)


@pytest.mark.parametrize("value", ["word", None, ["a"] * 6, [[1, 2], [3]], 1e300, 10**400, [np.nan] * 6])
def test_every_argument_of_every_surface_stands_the_commonest_mistakes(value: Any) -> None:
    for calls in SURFACES.values():
        for call in calls:
            judged(call, value)


@pytest.mark.parametrize("size", [1e6, 1e20, 1e300])
def test_the_reference_comes_back_from_any_state(size: float) -> None:
    with pytest.raises(RuntimeError, match=r"^The reference cannot follow the motion from 0 s to 0\.02 s, which"):
        dpend.reference(PLANT, np.full(6, size), [0.0], [0, 0.02])


@pytest.mark.parametrize("duration", [1e12, 1e300, 10**400])
def test_a_run_that_no_memory_holds_is_refused_before_it_begins(duration: float) -> None:
    with pytest.raises(ValueError, match=r"1 x \d+ samples take \d+ GiB, and this machine has \d+ GiB|whole number"):
        dpend.simulate(RIG, Zero(), REST, duration, task=None)
