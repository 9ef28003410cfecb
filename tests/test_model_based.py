"""Models of the plant know what they do not know, and say how noisy the sensors are; plans on them swing up."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rigs import random_params, random_states, row, whole
from threadpoolctl import threadpool_info, threadpool_limits

import dpend
from controllers import ILQRMPC
from controllers.ilqr_kernels import Plans
from dpend.params import Array
from rl import IdentifyAndPlan, ModelBased, ModelPolicy, Outcome, harmonic, joint_fit, kernel_model, load_policy
from rl.harmonic import HarmonicModel, Posterior
from rl.joint_fit import Episode
from rl.kernel_model import KernelModel, Priors
from rl.model_based import RandomForces, _Cheapest, expected_cost, kalman, settled, transitions
from studies.price_of_ignorance import pilco_cost

RIG = dpend.rig("pilco2011")
H = RIG.sample_time
ALL = Priors(True, True, True, True)


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Fit as learners do: threads of BLAS, in several processes of tests, wait for one another."""
    with threadpool_limits(1, "blas"):
        yield


def moved(episodes: int, seed: int, rig: dpend.Rig = RIG) -> list[dpend.Run]:
    """Return episodes of random forces from hanging."""
    task = dpend.SwingUp(angle_spread=0.1, steps=100)
    starts = task.starts(np.random.default_rng(seed), episodes, rig)
    runs = dpend.simulate_many(rig, RandomForces(rig), starts, task=task, seed=seed, record=True)
    return [runs[i] for i in range(episodes)]


def random_harmonic(
    mirror: bool, rng: np.random.Generator, gravity: bool = False, amplitudes: npt.ArrayLike = (0.6,) * 11
) -> HarmonicModel:
    """Return a model drawn from the prior; amplitudes are of what each product of rates and force adds."""
    hyper, outputs = np.log([1.2, 2.0, 1.0, *np.asarray(amplitudes)]), []
    for d in range(3):
        columns = np.flatnonzero(harmonic.allowed(d, mirror, gravity))
        variances = harmonic.variances(hyper, mirror)[0][columns]
        mean = np.sqrt(variances) * rng.standard_normal(len(columns))
        outputs.append(Posterior(columns, mean, np.diag(variances), hyper))
    return HarmonicModel(outputs=tuple(outputs), sensor_noise=np.full(6, 0.01), sample_time=H, mirror=mirror)


def random_kernels(priors: Priors, rng: np.random.Generator) -> KernelModel:
    z = kernel_model._inputs(random_states(rng, 15), rng.uniform(-5, 5, 15), H, priors)
    outputs = 3 if priors.second_order else 6
    hyper = np.tile([*np.full(z.shape[1], 1.0), -1.0, -4.0], (outputs, 1))
    alpha = rng.standard_normal((15, outputs))
    return KernelModel(z=z, alpha=alpha, hyper=hyper, sensor_noise=np.full(6, 0.01), sample_time=H, priors=priors)


MODELS = {
    "harmonic, mirror": lambda rng: random_harmonic(True, rng),
    "harmonic": lambda rng: random_harmonic(False, rng),
    "kernel, all known": lambda rng: random_kernels(ALL, rng),
    "kernel, nothing known": lambda rng: random_kernels(Priors(False, False, False, False), rng),
    "kernel, angles": lambda rng: random_kernels(Priors(True, True, False, False), rng),
}
every_model = pytest.mark.parametrize("build", MODELS.values(), ids=list(MODELS))


# --------------------------------------------------------------------------------------------------------------- models


@pytest.mark.slow
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


@pytest.mark.slow
@every_model
def test_a_model_that_knows_the_mirror_is_odd_and_otherwise_not(build: Any) -> None:
    rng = np.random.default_rng(1)
    belief = build(rng)
    model, x = belief.model, tuple(random_states(rng, 1)[0].tolist())
    there, mirrored = (np.array(model.step(tuple(s * v for v in x), 2.0 * s, model.parameters)) for s in (1.0, -1.0))
    mirrored_too = belief.mirror if isinstance(belief, HarmonicModel) else belief.priors.mirror
    assert np.allclose(there, -mirrored, rtol=0, atol=1e-9) == mirrored_too


@pytest.mark.slow
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
    hyper = np.concatenate([np.log([1.2, 2.0, 1.0]), rng.normal(0, 0.3, 11)])
    features = harmonic.features(x, u, mirror)
    assert features.shape[1] == (1115 if mirror else 2233)

    def kernel(sign: float) -> Array:
        angles = zip((x[:, 1], x[:, 2], x[:, 1] - x[:, 2]), np.exp(2 * hyper[:3]), strict=True)
        theta = sum((np.cos(angle[:, None] - sign * angle) - 1) / squared for angle, squared in angles)
        q, other = harmonic.products(x[:, 3:], u), harmonic.products(sign * x[:, 3:], sign * u)
        return np.exp(theta) * ((q * np.exp(2 * hyper[3:])) @ other.T)

    wanted = (kernel(1.0) - kernel(-1.0)) / 2 if mirror else kernel(1.0)
    found = (features * harmonic.variances(hyper, mirror)[0]) @ features.T
    assert_allclose(found, wanted, rtol=0, atol=1e-4 * np.abs(wanted).max())


@pytest.mark.slow
@pytest.mark.parametrize("mirror", [True, False])
def test_plans_are_made_on_splines_that_stand_for_the_harmonics(mirror: bool) -> None:
    rng = np.random.default_rng(0)
    model = random_harmonic(mirror, rng)
    x, u, field = random_states(rng, 100), rng.uniform(-3, 3, 100), model.parameters.field
    x[:, 1:3] += 2 * math.pi * rng.integers(-3, 4, (100, 2))
    found = np.array([harmonic._rates(tuple(one), (force, 0.0, 0.0), field) for one, force in zip(x, u, strict=True)])
    wanted = model.accelerations(x, u)
    assert_allclose(found[:, 3:], wanted, rtol=0, atol=1e-3 * np.abs(wanted).max())
    lost = harmonic._rates((0.0, math.nan, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), field)
    assert np.isnan(lost[3:]).all()


def test_models_are_drawn_as_they_are_believed() -> None:
    rng = np.random.default_rng(0)
    model = random_harmonic(True, rng)
    half = rng.standard_normal((3, 2))
    few = Posterior(np.array([3, 8, 20]), np.array([1.0, -2.0, 0.5]), half @ half.T, np.zeros(14))
    drawn = [replace(model, outputs=(few,) * 3).drawn(rng) for _ in range(2000)]
    means = np.concatenate([[output.mean for output in each.outputs] for each in drawn])
    assert_allclose(means.mean(axis=0), few.mean, rtol=0, atol=0.15)
    assert_allclose(np.cov(means.T), few.covariance, rtol=0, atol=0.1 * np.abs(few.covariance).max())


@pytest.mark.parametrize("known", [True, False])
def test_half_a_turn_of_everything_reverses_gravity_alone_for_plants_and_for_models_that_know(known: bool) -> None:
    rng = np.random.default_rng(0)
    model, params = random_harmonic(False, rng, gravity=known), random_params(rng, 1)
    x, u = random_states(rng, 20), rng.uniform(-3, 3, 20)
    about = x * [-1, 1, 1, -1, 1, 1] + [0, math.pi, math.pi, 0, 0, 0]
    still = x * [0, 1, 1, 0, 0, 0]
    for accelerations in (model.accelerations, lambda x, u: dpend.rates(x, u, row(params, 0))[:, 3:]):
        wanted = (accelerations(x, u) - 2 * accelerations(still, 0 * u)) * [-1, 1, 1]
        same = np.allclose(accelerations(about, -u), wanted, rtol=0, atol=1e-8)
        assert same == (known or accelerations != model.accelerations)


@pytest.mark.parametrize("rows", [20, 80])
def test_the_slopes_of_the_marginal_likelihood_are_those_of_finite_differences(
    rows: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(0)
    some = np.flatnonzero(joint_fit.variances(np.zeros(14), True)[0] > 1e-4)  # others are lost in rounding
    columns = [np.sort(rng.permutation(some)[:15]) for _ in range(3)]
    parts = [slice(15 * d, 15 * d + 15) for d in range(3)]
    center = np.tile(np.concatenate([np.log([1.2, 2.0, 1.0]), rng.normal(-1, 0.3, 11)]), (3, 1))
    stds = [np.sqrt(harmonic.variances(center[0], True)[0][own]) for own in columns]
    regression = joint_fit._Regression([(rng.standard_normal((rows, 45)), rng.standard_normal(rows))])
    captured(
        monkeypatch,
        joint_fit,
        lambda: joint_fit._likeliest(
            regression, list(center + 0.3), center, joint_fit._Basis(columns, stds, parts), True
        ),
    )


@pytest.mark.parametrize("mirror", [True, False])
def test_the_slopes_of_the_marginal_likelihood_of_kernels_are_those_of_finite_differences(
    mirror: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(0)
    x, u, y = random_states(rng, 25), rng.uniform(-3, 3, 25), rng.standard_normal(25)
    noisier = rng.uniform(1, 50, 25)
    z = kernel_model._inputs(x, u, H, priors := Priors(True, True, False, mirror))
    center = np.append(np.full(z.shape[1], 0.7), [0.3, -1.0])
    captured(
        monkeypatch, kernel_model, lambda: kernel_model._most_likely(z, y, noisier, priors, center, center + 0.3, 40)
    )


def captured(monkeypatch: pytest.MonkeyPatch, module: Any, search: Any) -> None:
    """Hold the slopes of the loss that a search minimizes to differences of it."""
    seen: list[Any] = []

    def capture(loss: Any, start: Array, **_: Any) -> Any:
        seen.append((loss, start))
        raise StopIteration

    monkeypatch.setattr(module, "minimize", capture)
    with pytest.raises(StopIteration):
        search()
    ((loss, start),) = seen
    d = 1e-5
    differences = [(loss(start + d * e)[0] - loss(start - d * e)[0]) / (2 * d) for e in np.eye(len(start))]
    assert_allclose(loss(start)[1], differences, rtol=1e-5, atol=1e-6)


def test_both_ways_of_regression_give_the_same_posterior() -> None:
    rng = np.random.default_rng(0)
    X, z, ratio = rng.standard_normal((30, 40)), rng.standard_normal(30), rng.uniform(0.5, 2, 40)
    wide = joint_fit._Regression([(X[:10], z[:10]), (X[10:], z[10:])])
    tall = joint_fit._Regression(
        [(X, z), (np.zeros((30, 40)), np.zeros(30))]
    )  # more rows than weights, which say nothing
    (_, mean, spread, half), (_, *wanted, root) = wide.posterior(ratio), tall.posterior(ratio)
    assert not wide.tall
    assert tall.tall
    assert_allclose(mean, wanted[0], rtol=0, atol=1e-12)
    assert_allclose(spread, wanted[1], rtol=0, atol=1e-12)
    part = slice(3, 9)
    assert_allclose(wide.covariance(half, part), tall.covariance(root, part), rtol=0, atol=1e-12)


def test_the_correlation_of_neighbouring_samples_is_that_of_the_noise_they_share() -> None:
    rng = np.random.default_rng(0)
    A, variance, process = rng.standard_normal((4, 6, 6)), rng.uniform(0.5, 2, 6), rng.uniform(0.1, 1, 3)
    G = np.zeros((24, 30))
    for k in range(4):
        G[6 * k : 6 * k + 6, 6 * k : 6 * k + 12] = np.hstack([-A[k], np.eye(6)])
    wanted = (G * np.tile(variance, 5)) @ G.T + np.diag(np.tile(np.append(np.zeros(3), process**2), 4))
    band = joint_fit._correlated(A, variance, process)
    L = np.sum([np.diag(row[: 24 - i], -i) for i, row in enumerate(band)], axis=0)
    assert_allclose(L @ L.T, wanted, rtol=0, atol=1e-9 * wanted.max())


@pytest.mark.slow
def test_what_is_learned_of_hanging_links_and_noisy_sensors_holds_upright() -> None:
    (run,) = moved(1, seed=1)
    rng = np.random.default_rng(2)
    upright, u = rng.uniform(-0.15, 0.15, (200, 6)), rng.uniform(-5, 5, 200)
    wanted = dpend.rates(upright, u, RIG.params)[:, 3:]
    believed, blind = (joint_fit.fit([Episode(run.y, run.u)], H, True, known, None) for known in (True, False))
    assert believed is not None
    assert blind is not None
    assert_allclose(believed.sensor_noise, 0.01, rtol=0.6)
    off = believed.accelerations(upright, u) - wanted
    assert np.sqrt(np.mean(off**2)) < 0.03 * np.sqrt(np.mean(wanted**2))
    assert np.sqrt(np.mean((off / believed.uncertainty(upright, u)) ** 2)) < 3
    assert np.sqrt(np.mean((blind.accelerations(upright, u) - wanted) ** 2)) > 0.3 * np.sqrt(np.mean(wanted**2))
    follow, given = kalman(believed), np.append(0.0, run.u)
    estimates = np.array([follow(y, force) for y, force in zip(run.y, given, strict=True)])
    assert np.mean((estimates - run.x)[20:] ** 2) < 0.5 * np.mean((run.y - run.x)[20:] ** 2)


@pytest.mark.slow
def test_of_a_plant_drawn_from_the_prior_the_posterior_is_as_sure_as_it_may_be() -> None:
    rng, episodes, D = np.random.default_rng(1), [], np.empty((1, 6, 8))
    truth = random_harmonic(True, rng, gravity=True, amplitudes=(4.0, *(0.1,) * 6, 0.5, *(0.2,) * 3))
    for _ in range(3):
        x, u = np.zeros((61, 6)), rng.uniform(-8, 8, 60)
        x[0, 1:3] = rng.uniform(-3, 3, 2)
        for k in range(60):
            truth.model.loops.linearize(x[[k, k]], u[k : k + 1], truth.parameters, D)
            x[k + 1] = x[k] + D[0, :, 7]
        episodes.append(Episode(x + 0.01 * rng.standard_normal(x.shape), u))
    model = joint_fit.fit(episodes, H, True, True, None)
    assert model is not None
    assert_allclose(model.noise, 0.01, rtol=0.3)
    seen, forces = np.concatenate([each.y[:-1] for each in episodes]), np.concatenate([each.u for each in episodes])
    off = (model.accelerations(seen, forces) - truth.accelerations(seen, forces)) / model.uncertainty(seen, forces)
    assert 0.7 < np.sqrt(np.mean(off**2)) < 1.5
    assert np.mean(np.abs(off) < 2) > 0.85


@pytest.mark.slow
def test_where_the_model_before_leads_nowhere_a_model_is_sought_from_nothing() -> None:
    (run,) = moved(1, seed=3)
    episodes = [Episode(run.y, run.u)]
    model = random_harmonic(True, np.random.default_rng(0))
    lost = replace(model, outputs=tuple(each._replace(mean=1e200 * each.mean) for each in model.outputs))
    found, fresh = (joint_fit.fit(episodes, H, True, False, before) for before in (lost, None))
    assert found is not None
    assert fresh is not None
    for one, other in zip(found.outputs, fresh.outputs, strict=True):
        assert_array_equal(one.mean, other.mean)


@pytest.mark.slow
def test_more_of_the_same_motion_of_an_exact_plant_makes_predictions_of_other_motion_better() -> None:
    rig = dpend.rig("gustafsson2016").replace(sample_time=0.05, substeps=5, track_limit=math.inf)
    task, planner = dpend.SwingUp(angle_spread=0.1, steps=100), ILQRMPC(rig)
    first, *others = task.starts(np.random.default_rng(5), 5, rig)
    runs = [dpend.simulate(rig, RandomForces(rig), first, task=task, seed=1)]
    runs += [dpend.simulate(rig, planner, x0, task=task, seed=2) for x0 in others]
    new = dpend.simulate(rig, RandomForces(rig), [0, 2, 1, 0, 8, -8], task=task, seed=3)
    wanted = dpend.rates(new.x[:-1], new.u, rig.params)[:, 3:]
    model, errors = None, list[Array]()
    for k in range(len(runs)):
        model = joint_fit.fit([Episode(run.y, run.u) for run in runs[: k + 1]], H, True, True, model)
        assert model is not None
        errors.append(np.sqrt(np.mean((model.accelerations(new.x[:-1], new.u) - wanted) ** 2, axis=0)))
    assert (errors[-1] < 0.8 * errors[0]).all()


@pytest.mark.slow
@pytest.mark.parametrize("noise", [pytest.param(0.1, marks=pytest.mark.nightly), 1.0])
def test_noise_as_great_as_the_motion_is_found_and_not_fitted(noise: float) -> None:
    (run,) = moved(1, seed=1, rig=RIG.replace(sensor_noise=noise, force_limit=2.0))
    model = joint_fit.fit([Episode(run.y, run.u)], H, True, True, None)
    assert model is not None
    assert_allclose(model.sensor_noise, noise, rtol=0.3)


@pytest.mark.parametrize("mirror", [True, False])
def test_kernels_centred_on_every_transition_give_the_posterior_mean(mirror: bool) -> None:
    rng = np.random.default_rng(0)
    priors = Priors(True, True, True, mirror)
    z = kernel_model._inputs(random_states(rng, 30), rng.uniform(-3, 3, 30), H, priors)
    y, signs = rng.standard_normal(30), kernel_model._signs(priors)
    hyper = np.append(np.full(z.shape[1], 1.0), [0.0, -2.0])
    K = kernel_model._kernel(z, z, hyper, priors, signs)[0]
    noisier = rng.uniform(1, 50, 30)
    wanted = K @ np.linalg.solve(K + np.exp(2 * hyper[-1]) * np.diag(noisier), y)
    found = K @ kernel_model._weights(z, z, y, noisier, hyper, priors)
    assert_allclose(found, wanted, rtol=0, atol=1e-3 * np.abs(wanted).max())


@pytest.mark.slow
def test_changes_are_as_noisy_as_noise_of_the_states_before_and_after_makes_them() -> None:
    rng = np.random.default_rng(0)
    model = random_kernels(ALL, rng)
    x, u, size = random_states(rng, 1)[0], 2.0, 1e-4
    noise = size * rng.standard_normal((2000, 2, 6))
    after = np.array([model.model.step(tuple(x - n), u, model.model.parameters) for n in noise[:, 0]])
    exact = kernel_model.Transitions(x[None], np.array([u]), x[None])
    found = (noise[:, 1] + after - x)[:, 3:].var(axis=0)
    assert_allclose(2 * size**2 * model._noisier(exact)[0], found, rtol=0.1)


@pytest.mark.slow
def test_kernels_of_angles_half_a_sample_on_predict_new_changes_of_rates() -> None:
    rig = dpend.rig("gustafsson2016").replace(sample_time=0.05, substeps=5)
    data, new = transitions(moved(8, 0, rig)), transitions(moved(4, 1, rig))
    model = KernelModel.fit(data, H, ALL, np.random.default_rng(0), None).model
    found = np.array([model.step(tuple(x), u, model.parameters) for x, u in zip(new.x, new.u, strict=True)])
    off, changes = (found - new.after)[:, 3:], (new.after - new.x)[:, 3:]
    assert (
        np.sqrt((off**2).mean(axis=0) / (changes**2).mean(axis=0)) < 0.08
    ).all()  # .09 to .14 at its beginning, without the angle between


@pytest.mark.slow
@pytest.mark.parametrize("second_order", [True, False])
def test_kernels_infer_the_noise_of_all_sensors(second_order: bool) -> None:
    data = transitions(moved(8, 0, RIG.replace(sensor_noise=0.02)))
    model = KernelModel.fit(data, H, Priors(True, second_order, True, True), np.random.default_rng(0), None)
    assert_allclose(model.sensor_noise, 0.02, rtol=0.3)


@pytest.mark.slow
def test_the_filter_on_kernels_is_nearer_to_the_state_than_what_is_measured() -> None:
    *runs, new = moved(9, 0, RIG.replace(sensor_noise=0.02))
    model = KernelModel.fit(transitions(runs), H, ALL, np.random.default_rng(0), None)
    follow, given = kalman(model), np.append(0.0, new.u)
    estimates = np.array([follow(y, force) for y, force in zip(new.y, given, strict=True)])
    assert np.mean((estimates - new.x)[20:] ** 2) < 0.8 * np.mean((new.y - new.x)[20:] ** 2)


def test_the_exponential_of_vectors_is_that_of_the_library() -> None:
    y = -np.logspace(-9, 1.6, 500)
    assert_allclose([kernel_model._exp(each) for each in y], np.exp(y), rtol=1e-12, atol=1e-14)


def test_centres_are_spread_over_all_inputs_and_none_is_taken_twice() -> None:
    z = np.concatenate([0.01 * np.random.default_rng(0).standard_normal((50, 2)), [[3.0, 0.0], [0.0, -4.0]]])
    assert {50, 51} <= set(kernel_model._spread(z, 3).tolist())
    assert len(set(kernel_model._spread(z, 60).tolist())) == len(z)


# ------------------------------------------------------------------------------------------------------------- planning


@pytest.mark.slow
def test_what_a_plan_is_expected_to_cost_is_what_it_costs_on_average_where_accelerations_err(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (run,) = moved(1, seed=1)
    model = joint_fit.fit([Episode(run.y, run.u)], H, True, True, None)
    assert model is not None
    monkeypatch.setattr(HarmonicModel, "uncertainty", lambda self, x, u: np.full((len(x), 3), 0.02))
    planner = ILQRMPC(RIG.replace(sensor_noise=0.0), model=model.model, starts=0)
    law: Any = planner.start(1, np.random.default_rng(0))
    law(0.0, np.array([[0.1, 0.1, -0.05, 0.0, 0.0, 0.0]]))
    plan, rng, ends = law.plans, np.random.default_rng(2), []
    for _ in range(1000):
        x = plan.x[0, 0]
        for k, u in enumerate(plan.u[0]):
            force = u + plan.K[0, k] @ (x - plan.x[0, k])
            x = np.array(model.model.step(tuple(x.tolist()), float(force), model.model.parameters))
            errors = 4 * 0.02 * rng.standard_normal(3)
            x += np.append(H**2 / 2 * errors, H * errors)
        ends.append((x - plan.x[0, -1]) @ planner.P @ (x - plan.x[0, -1]))
    assert_allclose(expected_cost(plan, model, planner.P) - plan.cost[0], np.mean(ends), rtol=0.15)


class Planned:
    """A law with a plan of one sample, of given cost, and a force."""

    def __init__(self, height: float, cost: float, force: float) -> None:
        x = np.array([[[height, 0.0, 0.0, 0.0, 0.0, 0.0]] * 2])
        self.plans = Plans.blank(1, 1)._replace(x=x, cost=np.array([cost]))
        self.log: dict[str, list[Array]] = {}
        self.force, self.calls = force, 0

    def __call__(self, t: float, y: Array) -> Array:
        self.calls += 1
        return np.array([self.force])


@pytest.mark.slow
def test_a_plan_is_not_taken_for_being_cheap_where_the_model_is_unsure(monkeypatch: pytest.MonkeyPatch) -> None:
    model = random_kernels(ALL, np.random.default_rng(0))
    monkeypatch.setattr(KernelModel, "uncertainty", lambda self, x, u: np.repeat(np.abs(x[:, :1]), 3, axis=1))
    sure, unsure, costly = Planned(0.0, 10.0, 1.0), Planned(50.0, 9.0, 2.0), Planned(0.0, 11.0, 3.0)
    act, y = _Cheapest([unsure, costly, sure], model, np.eye(6), RIG), np.zeros((1, 6))
    assert act(0.0, y)[0] == act(H, y)[0] == 1.0
    assert [law.calls for law in (sure, unsure, costly)] == [2, 1, 1]
    assert act.log is sure.log


@pytest.mark.slow
def test_a_plan_on_a_model_leaves_a_tenth_of_the_track_for_what_the_model_does_not_know() -> None:
    policy = ModelPolicy(random_kernels(ALL, np.random.default_rng(0)), sample_time=H, force_limit=20, track_limit=2.0)
    walls = [planner._planner.setting.problem.hard_track for planner in policy.planners]
    assert_allclose(walls, 1.8, rtol=1e-3)
    assert policy.track_limit == 2.0


@pytest.mark.slow
def test_no_plan_is_chosen_before_there_is_a_measurement() -> None:
    model, (one, other) = random_kernels(ALL, np.random.default_rng(0)), (Planned(0.0, c, c) for c in (2.0, 1.0))
    act, y = _Cheapest([one, other], model, np.eye(6), RIG), np.zeros((1, 6))
    act(0.0, np.full((1, 6), math.nan))
    assert act(H, y)[0] == act(2 * H, y)[0] == 1.0
    assert (one.calls, other.calls) == (2, 3)


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


def test_the_cost_by_pilcos_measure_is_of_the_tips_distance_and_one_after_an_early_end() -> None:
    law = dpend.controller.FunctionController(lambda _, x: 0.0)
    rig, task = RIG.replace(sensor_noise=0.0), dpend.SwingUp(steps=40)
    upright, beside, hanging = (
        dpend.simulate(rig, law, x0, task=task)
        for x0 in ([0.0] * 6, [0.5, 0, 0, 0, 0, 0], [0, math.pi, math.pi, 0, 0, 0])
    )
    assert_allclose(pilco_cost(upright, 40), 0, rtol=0, atol=1e-12)
    assert_allclose(pilco_cost(upright, 80), 0.5)
    assert_allclose(pilco_cost(beside, 40), 1 - math.exp(-0.5))
    assert_allclose(pilco_cost(hanging, 40), 1, atol=1e-4)


def test_random_forces_keep_to_the_limit_and_the_cart_near_the_middle() -> None:
    runs = moved(4, seed=0)
    forces = np.concatenate([run.u for run in runs])
    assert np.abs(forces).max() <= RIG.force_limit
    assert forces.std() > 0.2 * RIG.force_limit
    assert max(np.abs(run.x[:, 0]).max() for run in runs) < 4.0


@pytest.mark.slow
def test_a_model_is_fitted_on_one_thread_and_the_callers_number_stays() -> None:
    def threads() -> set[int]:
        return {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"}

    seen: list[set[int]] = []
    with threadpool_limits(2, "blas"):
        ModelBased(RIG, structure=False, gravity=False, episodes=1).train(
            0, seconds=1.0, progress=lambda _: seen.append(threads())
        )
        assert {1} in seen
        assert threads() == {2}


@pytest.mark.slow
def test_a_minute_of_experience_swings_up(tmp_path: Any) -> None:
    training = ModelBased(RIG, streak=2).train(1000)
    assert training.outcome is Outcome.CONVERGED
    assert training.experience <= 30
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


@pytest.mark.slow
def test_plans_on_models_drawn_from_the_posterior_teach_too() -> None:
    training = ModelBased(RIG, sampling=True, streak=1).train(1000)
    assert training.converged
    assert training.experience <= 30


@pytest.mark.slow
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
        (ModelBased, {"structure": False},
         "gravity is stated of the coefficients of the structure: expected it to be False without; got True."),
        (ModelBased, {"structure": False, "gravity": False, "sampling": True},
         "sampling draws the coefficients of the structure: expected it to be False without; got True."),
        (ModelBased, {"episodes": 0}, "episodes must be a whole number, at least 1; got 0."),
        (IdentifyAndPlan, {"unknown": 1.0}, "unknown must be at least 0 and below 1; got 1.0."),
        (IdentifyAndPlan, {"motion": 0.5}, "motion must be at least 1 s; got 0.5."),
    ],
)  # fmt: skip
def test_settings_out_of_range_are_refused(learner: Any, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=whole(message)):
        learner(**({"rig": RIG} | changes))


def test_without_a_model_there_is_no_policy_and_no_training(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(joint_fit, "fit", lambda *_: None)
    with pytest.raises(
        RuntimeError, match="ModelBased found no model in 1 s of experience: expected measurements with"
    ):
        ModelBased(RIG, episodes=1).train(0, seconds=1.0)
