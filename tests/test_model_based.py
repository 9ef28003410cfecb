"""Models of the plant know what they do not know, and say how noisy the sensors are; plans on them swing up."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rigs import random_states, whole
from scipy.linalg import cho_solve
from threadpoolctl import threadpool_info, threadpool_limits

import dpend
from dpend.params import Array
from rl import IdentifyAndPlan, ModelBased, ModelPolicy, Outcome, harmonic, kernel_model, load_policy
from rl.harmonic import HarmonicModel, Tracker, Transitions
from rl.kernel_model import KernelModel, Priors
from rl.model_based import RandomForces, settled, transitions

RIG = dpend.rig("pilco2011")
H = RIG.sample_time
ALL = Priors(True, True, True, True)


def moved(episodes: int, seed: int, rig: dpend.Rig = RIG) -> Transitions:
    """Return transitions of episodes of random forces from hanging."""
    task = dpend.SwingUp(angle_spread=0.1, steps=100)
    starts = task.starts(np.random.default_rng(seed), episodes, rig)
    runs = dpend.simulate_many(rig, RandomForces(rig), starts, task=task, seed=seed, record=True)
    return transitions([runs[i] for i in range(episodes)])


def random_harmonic(mirror: bool, rng: np.random.Generator) -> HarmonicModel:
    """Return a model drawn from the prior."""
    hyper = np.tile(np.concatenate([np.log([1.2, 2.0, 1.0]), np.full(11, -0.5), [-1.0]]), (3, 1))
    std = np.sqrt([harmonic._variances(row, mirror) for row in hyper])
    inputs = np.column_stack([random_states(rng, 20), rng.uniform(-5, 5, 20)])
    excess = rng.uniform(1, 3, (20, 3))
    weights = std * rng.standard_normal(std.shape)
    return HarmonicModel(weights=weights, hyper=hyper, inputs=inputs, excess=excess, sample_time=H, mirror=mirror)


def random_kernels(priors: Priors, rng: np.random.Generator) -> KernelModel:
    z = kernel_model._inputs(random_states(rng, 15), rng.uniform(-5, 5, 15), priors)
    outputs = 3 if priors.second_order else 6
    hyper = np.tile([*np.full(z.shape[1], 1.0), -1.0, -4.0], (outputs, 1))
    alpha = rng.standard_normal((15, outputs))
    return KernelModel(z=z, alpha=alpha, hyper=hyper, sample_time=H, priors=priors)


MODELS = {
    "harmonic, mirror": lambda rng: random_harmonic(True, rng),
    "harmonic": lambda rng: random_harmonic(False, rng),
    "kernel, all known": lambda rng: random_kernels(ALL, rng),
    "kernel, nothing known": lambda rng: random_kernels(Priors(False, False, False, False), rng),
    "kernel, angles": lambda rng: random_kernels(Priors(True, True, False, False), rng),
}
every_model = pytest.mark.parametrize("build", MODELS.values(), ids=list(MODELS))


# --------------------------------------------------------------------------------------------------------------- models


@every_model
def test_a_models_slopes_are_those_of_finite_differences(build: Any) -> None:
    rng = np.random.default_rng(0)
    model = build(rng).model
    x, u, d = random_states(rng, 1)[0], 3.0, 1e-5

    def step(z: Array) -> Array:
        return np.array(model.step(tuple(z[:6].tolist()), float(z[6]), model.parameters))

    at, D = np.append(x, u), np.empty((1, 6, 8))
    model.loops.linearize(np.tile(x, (2, 1)), np.array([u]), model.parameters, D)
    slopes = [(step(at + d * e) - step(at - d * e)) / (2 * d) for e in np.eye(7)]
    assert_allclose(D[0, :, :7], np.transpose(slopes), rtol=1e-5, atol=1e-7)
    assert_allclose(D[0, :, 7], step(at) - x, rtol=0, atol=1e-12)


@every_model
def test_a_model_that_knows_the_mirror_is_odd_and_otherwise_not(build: Any) -> None:
    rng = np.random.default_rng(1)
    belief = build(rng)
    model, x = belief.model, tuple(random_states(rng, 1)[0].tolist())
    there, mirrored = (np.array(model.step(tuple(s * v for v in x), 2.0 * s, model.parameters)) for s in (1.0, -1.0))
    mirrored_too = belief.mirror if isinstance(belief, HarmonicModel) else belief.priors.mirror
    assert np.allclose(there, -mirrored, rtol=0, atol=1e-9) == mirrored_too


@every_model
def test_a_model_is_what_its_arrays_say(build: Any) -> None:
    belief, rng = build(np.random.default_rng(2)), np.random.default_rng(3)
    back = type(belief).from_arrays(**belief.arrays())
    x, u = random_states(rng, 5), rng.uniform(-5, 5, 5)
    assert_array_equal(back.uncertainty(x, u), belief.uncertainty(x, u))
    states = tuple(x[0].tolist())
    assert back.model.step(states, 1.0, back.model.parameters) == belief.model.step(
        states, 1.0, belief.model.parameters
    )


@pytest.mark.parametrize("mirror", [True, False])
def test_the_harmonics_stand_for_the_kernel_of_sine_and_cosine(mirror: bool) -> None:
    rng = np.random.default_rng(0)
    x, u = random_states(rng, 30), rng.uniform(-3, 3, 30)
    hyper = np.concatenate([np.log([1.2, 2.0, 1.0]), rng.normal(0, 0.3, 11), [0.0]])
    features = harmonic._features(x, u, mirror)
    assert features.shape[1] == (928 if mirror else 1859)

    def kernel(sign: float) -> Array:
        angles = zip(harmonic.three_angles(x).T, np.exp(2 * hyper[:3]), strict=True)
        theta = sum((np.cos(angle[:, None] - sign * angle) - 1) / squared for angle, squared in angles)
        q, other = harmonic.products(x[:, 3:], u), harmonic.products(sign * x[:, 3:], sign * u)
        return np.exp(theta) * ((q * np.exp(2 * hyper[3:-1])) @ other.T)

    wanted = (kernel(1.0) - kernel(-1.0)) / 2 if mirror else kernel(1.0)
    found = (features * harmonic._variances(hyper, mirror)) @ features.T
    assert_allclose(found, wanted, rtol=0, atol=1e-4 * np.abs(wanted).max())


@pytest.mark.parametrize("mirror", [True, False])
@pytest.mark.parametrize("kind", ["harmonic", "kernel"])
def test_the_slopes_of_the_marginal_likelihood_are_those_of_finite_differences(
    kind: str, mirror: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(0)
    x, u, y = random_states(rng, 25), rng.uniform(-3, 3, 25), rng.standard_normal(25)
    seen: list[Any] = []

    def capture(loss: Any, start: Array, **_: Any) -> Any:
        seen.append((loss, start))
        raise StopIteration

    module: Any = harmonic if kind == "harmonic" else kernel_model
    monkeypatch.setattr(module, "minimize", capture)
    if kind == "harmonic":
        center = np.concatenate([np.log([1.2, 2.0, 1.0]), rng.normal(-1, 0.3, 11), [-1.0]])
        q, excess = harmonic.products(x[:, 3:], u), rng.uniform(1, 3, 25)
        arguments: Any = (harmonic.three_angles(x), q, y, excess, mirror, center, center + 0.3)
    else:
        z = kernel_model._inputs(x, u, priors := Priors(True, True, False, mirror))
        center = np.append(np.full(z.shape[1], 0.7), [0.3, -1.0])
        arguments = (z, y, priors, center, center + 0.3)
    with pytest.raises(StopIteration):
        module._most_likely(*arguments)
    ((loss, start),) = seen
    d = 1e-5
    differences = [(loss(start + d * e)[0] - loss(start - d * e)[0]) / (2 * d) for e in np.eye(len(start))]
    assert_allclose(loss(start)[1], differences, rtol=1e-5, atol=1e-6)


def test_what_a_model_is_unsure_of_covers_fields_drawn_from_its_prior() -> None:
    rng = np.random.default_rng(0)
    truth = random_harmonic(True, rng)
    x, u = random_states(rng, 400), rng.uniform(-5, 5, 400)
    seen, new = slice(0, 250), slice(250, 400)
    features, noise = harmonic._features(x, u, True), math.exp(2 * truth.hyper[0, -1])
    weights = np.empty_like(truth.weights)
    for d in range(3):
        scale = np.sqrt(harmonic._variances(truth.hyper[d], True))
        known, y = features[seen] * scale, features[seen] @ truth.weights[d] + math.sqrt(noise) * rng.normal(size=250)
        weights[d] = scale * cho_solve((harmonic._factor(known, np.full(250, noise)), True), known.T @ y / noise)
    belief = HarmonicModel(weights=weights, hyper=truth.hyper, inputs=np.column_stack([x, u])[seen],
                           excess=np.ones((250, 3)), sample_time=H, mirror=True)  # fmt: skip
    off = (belief.accelerations(x[new], u[new]) - features[new] @ truth.weights.T) / belief.uncertainty(x[new], u[new])
    assert 0.90 < (np.abs(off) < 1.96).mean() < 0.985


def test_a_model_updated_sample_by_sample_is_the_one_fitted_to_all() -> None:
    rng = np.random.default_rng(0)
    belief = replace(random_harmonic(True, rng), sample_time=1e-6)  # so short that a sample is its middle
    x, u = random_states(rng, 30), rng.uniform(-5, 5, 30)
    data = Transitions(x, u, x + 1e-6 * rng.standard_normal((30, 6)))
    mid = harmonic.middles(data, 1e-6)
    features, gained = harmonic._features(mid, u, True), (data.after - x)[:, 3:] / 1e-6
    excess = np.full((30, 3), 2.0)  # one and the slope of a rate by itself
    weights, _, _ = harmonic._posterior(data, mid, gained, np.full(3, 1e9), features, belief.hyper, excess, 1e-6, True)
    tracker = Tracker(
        replace(belief, weights=np.zeros_like(weights), inputs=np.zeros((1, 7)), excess=np.full((1, 3), 1e15))
    )
    for sample in zip(x, u, data.after, strict=True):
        tracker.update(*sample)
    wanted = replace(belief, weights=weights).parameters.field
    assert_allclose(tracker.parameters.field.sines, wanted.sines, rtol=0, atol=1e-3 * np.abs(wanted.sines).max())
    assert_allclose(tracker.parameters.field.cosines, wanted.cosines, rtol=0, atol=1e-3 * np.abs(wanted.cosines).max())


@pytest.mark.slow
def test_noise_is_found_at_its_true_size_and_the_equations_within_the_error_stated() -> None:
    data, fresh = moved(4, seed=1), moved(1, seed=2, rig=RIG.replace(sensor_noise=0.0))
    belief = HarmonicModel.fit(data, H, True, np.random.default_rng(0), None)
    assert_allclose(belief.noise, 0.01, rtol=0.3)
    wanted = dpend.rates(fresh.x, fresh.u, RIG.params)[:, 3:]
    off = (belief.accelerations(fresh.x, fresh.u) - wanted) / belief.uncertainty(fresh.x, fresh.u)
    assert 0.3 < np.sqrt(np.mean(off**2)) < 1.7


# ------------------------------------------------------------------------------------------------------------- learners


def test_settled_asks_for_the_cart_and_the_tip_over_the_last_second() -> None:
    law = dpend.controller.FunctionController(lambda _, x: 0.0)
    run = dpend.simulate(RIG.replace(sensor_noise=0.0), law, np.zeros(6), task=dpend.SwingUp(steps=40))
    assert settled(run)
    for column, value, inside in ((0, 0.45, True), (0, 0.55, False), (1, 0.15, True), (1, 0.2, False), (2, 1e3, False)):
        x = run.x.copy()
        x[-15, column] = value
        object.__setattr__(run, "x", x)
        assert settled(run) == inside
        x[-15, column] = 0.0


def test_random_forces_keep_to_the_limit_and_the_cart_near_the_middle() -> None:
    data = moved(4, seed=0)
    assert np.abs(data.u).max() <= RIG.force_limit
    assert data.u.std() > 0.2 * RIG.force_limit
    assert np.abs(data.x[:, 0]).max() < 4.0


def test_a_model_is_fitted_on_one_thread_and_the_callers_number_stays() -> None:
    def threads() -> set[int]:
        return {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"}

    seen: list[set[int]] = []
    with threadpool_limits(2, "blas"):
        ModelBased(RIG, structure=False, episodes=1).train(0, seconds=1.0, progress=lambda _: seen.append(threads()))
        assert {1} in seen
        assert threads() == {2}


@pytest.mark.slow
def test_a_minute_of_experience_swings_up(tmp_path: Any) -> None:
    training = ModelBased(RIG, streak=2).train(1000)
    assert training.outcome is Outcome.CONVERGED
    assert training.experience <= 60
    assert_array_equal(training.curve["success"][-2:], True)
    assert_allclose(training.details["noise"][-1], 0.01, rtol=0.3)
    short = ModelBased(RIG, streak=2).train(1000, seconds=7.0)  # the same, cut short
    assert_array_equal(short.curve["length"], [100, 40])
    policy = training.policy
    back = load_policy(policy.save(tmp_path / "policy"))
    assert isinstance(back, ModelPolicy)
    x = np.array([0.0, 0.02, -0.01, 0.0, 0.0, 0.0])
    forces = [law.start(1, np.random.default_rng(0))(0.0, x[None])[0] for law in (policy, back)]
    assert forces[0] == forces[1]
    near, far = policy.uncertainty([x, np.array([0.0, 0.5, 2.5, 9.0, 20.0, -20.0])], [0.0, 0.0])
    assert (near < far).all()


@pytest.mark.parametrize("preset", ["pilco2011", "gustafsson2016"])
def test_two_seconds_of_motion_and_the_equations_swing_up(preset: str) -> None:
    rig = dpend.rig(preset)
    training = IdentifyAndPlan(rig).train(1000)
    assert training.converged
    assert_array_equal(training.curve["success"], [False, True, True])
    lengths = training.details["found"][-1, 3:5]
    assert_allclose(lengths, [float(rig.params.length1), float(rig.params.length2)], rtol=0.03)


@pytest.mark.parametrize(
    ("learner", "changes", "message"),
    [
        (ModelBased, {"rig": "bogdanov2004"},
         "ModelBased needs a rig with a force limit, the size of its random forces; got one without."),
        (IdentifyAndPlan, {"rig": RIG.replace(sensor_delay=1)},
         "IdentifyAndPlan takes a rig without lag, delay, rounding or noise of the force; got one with."),
        (ModelBased, {"angles": False},
         "structure is stated in angles, accelerations and no position: expected it to be False without angles, "
         "second_order and cart_invariance; got True."),
        (ModelBased, {"episodes": 0}, "episodes must be a whole number, at least 1; got 0."),
        (IdentifyAndPlan, {"unknown": 1.0}, "unknown must be at least 0 and below 1; got 1.0."),
        (IdentifyAndPlan, {"motion": 0.5}, "motion must be at least 1 s; got 0.5."),
    ],
)  # fmt: skip
def test_settings_out_of_range_are_refused(learner: Any, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=whole(message)):
        learner(**({"rig": RIG} | changes))
