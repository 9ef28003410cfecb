"""The filters are Kalman's where the plant is linear, say honestly how wrong they are, and make up for delay."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rigs import endless, whole
from scipy import stats

import dpend
from controllers import EKF, LQR, UKF, Constant, Differences, Predictor, WithEstimator
from dpend import Stepper, discretize, linearize
from dpend.params import Array
from dpend.rig import Rig

RIG = dpend.rig("gustafsson2016")
ENCODERS = (1e-4, 2 * np.pi / 2048, 2 * np.pi / 2048, 0.0, 0.0, 0.0)
DELAYS = [{"sensor_delay": 1}, {"actuator_delay": 1}, {"sensor_delay": 2, "actuator_delay": 1}]
FILTERS = [EKF, UKF]


def followed(estimator: EKF | UKF, y: Array, u: Array) -> tuple[Array, Array]:
    """Return means and covariances after measurements ``(T, n, 6)`` and commands ``(T, n)`` between them."""
    follow, belief = estimator.follow_closely(y.shape[1])
    given = np.zeros(y.shape[1])
    for k, row in enumerate(y):
        follow(row, given)
        given = u[k]
    return belief()


# ---------------------------------------------------------------------------------------------------------- differences


def test_first_differences_are_the_rates_of_uniform_motion_after_one_sample() -> None:
    rates = np.array([[0.5, -1.0, 2.0], [0.0, 3.0, -0.25]])
    estimator = Differences(RIG)
    for _ in range(2):  # fresh memory for each run
        follow = estimator.follow(2)
        for k in range(4):
            positions = 0.1 + rates * k * RIG.sample_time
            estimate = follow(np.concatenate([positions, np.full((2, 3), np.nan)], axis=1), np.zeros(2))
            assert_array_equal(estimate[:, :3], positions)
            assert_allclose(estimate[:, 3:], 0 * rates if k == 0 else rates, atol=1e-12)


# ---------------------------------------------------------------------------------------------------------- the filters


def test_near_upright_it_is_the_textbook_kalman_filter() -> None:
    rig = endless(substeps=8)
    ekf = EKF(rig, process_noise=(0.2, 0.1, 0.05), measurement_noise=(1e-3, 2e-3, 3e-3))
    rng = np.random.default_rng(0)
    y = 1e-7 * rng.standard_normal((25, 1, 6))
    u = 1e-6 * rng.standard_normal((25, 1))
    # Unit torques on the links enter as a unit force on the cart does: three columns, held over the sample.
    A, B = linearize(rig.params)
    B = np.concatenate([B, *(dpend.rates(np.zeros(6), f, rig.params)[:, None] for f in np.eye(3)[1:])], axis=1)
    A, B = discretize(A, B, rig.sample_time)
    C, Q, R = np.eye(6)[:3], np.diag(ekf.process_noise**2), np.diag(ekf.measurement_noise**2)
    x, P = np.zeros(6), np.diag(np.concatenate([ekf.measurement_noise, ekf.rates_noise]) ** 2)
    x[:3] = y[0, 0, :3]
    for k in range(1, len(y)):
        x, P = A @ x + B[:, 0] * u[k - 1], A @ P @ A.T + B @ Q @ B.T
        K = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
        x, P = x + K @ (y[k, 0, :3] - C @ x), (np.eye(6) - K @ C) @ P
    mean, covariance = followed(ekf, y, u)
    assert_allclose(mean[0], x, rtol=1e-5, atol=1e-6 * np.abs(x).max())
    assert_allclose(covariance[0], P, rtol=1e-6, atol=1e-6 * np.abs(P).max())


def noisy_runs(rig: Rig, push: Array, n: int, samples: int, seed: int = 0) -> tuple[Array, Array, Array]:
    """Let a rig swing about hanging, measured with noise and pushed at random; give truth, measurements, commands."""
    rng = np.random.default_rng(seed)
    x0 = np.tile(dpend.EQUILIBRIA["down-down"], (n, 1))
    x0[:, 1:3] += rng.uniform(-1, 1, (n, 2))
    x0[:, 3:] = rng.standard_normal((n, 3))
    stepper = Stepper(rig, n, seed)
    y, x = [stepper.reset(x0)], [x0]
    u = 5 * rng.standard_normal((samples, n))
    for k in range(samples - 1):
        y.append(stepper.step(u[k], push * rng.standard_normal((n, 3))))
        x.append(stepper.x.copy())
    return np.array(x), np.array(y), u


@pytest.mark.parametrize("kind", FILTERS)
def test_its_errors_are_as_large_as_it_says(kind: type[EKF] | type[UKF]) -> None:
    """The mean of the normalised squared errors of n runs is chi-squared with 6 n degrees of freedom, over n."""
    push = np.array([1.0, 0.3, 0.1])
    rig = endless(sensor_noise=(1e-3, 2e-3, 2e-3, 0, 0, 0))
    estimator = kind(rig, process_noise=push, rates_noise=(1.0, 1.0, 1.0))
    n = 200
    for samples in (10, 40, 80):
        x, y, u = noisy_runs(rig, push, n, samples, seed=samples)
        mean, covariance = followed(estimator, y, u)
        error = mean - x[-1]
        nees = np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[..., None])[..., 0])
        low, high = stats.chi2.ppf([5e-4, 1 - 5e-4], 6 * n) / n
        assert low < nees.mean() < high


def test_for_small_errors_the_two_filters_agree() -> None:
    rig = endless(sensor_noise=1e-4)
    _, y, u = noisy_runs(rig, np.zeros(3), 5, 30)
    settings: Any = {"process_noise": (1e-2, 1e-3, 1e-3), "rates_noise": (1e-2, 1e-2, 1e-2)}
    y[0, :, 3:] = 0.0
    (one, its_covariance), (two, other_covariance) = (followed(kind(rig, **settings), y, u) for kind in FILTERS)
    deviations = np.sqrt(np.diagonal(its_covariance, axis1=1, axis2=2))
    assert (np.abs(one - two) < 0.05 * deviations).all()
    assert_allclose(np.diagonal(other_covariance, axis1=1, axis2=2), deviations**2, rtol=0.02)


@pytest.mark.parametrize("kind", FILTERS)
def test_measured_rates_are_not_used(kind: type[EKF] | type[UKF]) -> None:
    _, y, u = noisy_runs(endless(), np.zeros(3), 2, 10)
    other = y.copy()
    other[..., 3:] = 1e3
    for mine, theirs in zip(followed(kind(RIG), y, u), followed(kind(RIG), other, u), strict=True):
        assert_array_equal(mine, theirs)


@pytest.mark.parametrize("kind", FILTERS)
def test_noise_is_taken_from_the_rig(kind: type[EKF] | type[UKF]) -> None:
    rig = RIG.replace(resolution=ENCODERS, sensor_noise=(0, 1e-3, 0, 0, 0, 0), force_noise=3.0)
    estimator = kind(rig)
    rounding = np.array(ENCODERS[:3]) / np.sqrt(12)
    assert_allclose(estimator.measurement_noise, [rounding[0], np.hypot(rounding[1], 1e-3), rounding[2]])
    assert_allclose(estimator.process_noise[0], np.hypot(3.0, 0.01 * 2 * 9.81))
    assert_allclose(kind(RIG).measurement_noise, 1e-6)


@pytest.mark.parametrize("kind", FILTERS)
def test_numbers_without_bound_are_not_divided_by_each_other(
    kind: type[EKF] | type[UKF], monkeypatch: pytest.MonkeyPatch
) -> None:
    line = 1e85 * np.array([1.0, 1e-12, 1e-17, np.nan, 0, 0])  # a covariance of rank one, singular beside any noise
    monkeypatch.setattr(
        kind, "_move", lambda self, n: lambda mean, *_: (mean, np.tile(np.outer(line, line), (n, 1, 1)))
    )
    follow = kind(RIG).follow(2)
    measured = np.full((2, 6), 0.1)
    for _ in range(3):
        estimate = follow(measured, np.zeros(2))
        assert_allclose(estimate, np.pad(measured[:, :3], ((0, 0), (0, 3))))


@pytest.mark.parametrize("kind", FILTERS)
def test_what_is_lost_begins_again(kind: type[EKF] | type[UKF]) -> None:
    follow, _ = kind(RIG).follow_closely(2)
    y = np.zeros((2, 6))
    follow(y, np.zeros(2))
    y[0, 0] = 1e5  # a jump that no plant makes, so far that the model runs away from it
    for _ in range(5):
        assert np.isfinite(follow(y, np.zeros(2))).all()
    y[0, 0] = 0.0
    estimate = [follow(y, np.zeros(2)) for _ in range(50)][-1]
    assert_allclose(estimate[1], 0.0, atol=1e-9)
    assert_allclose(estimate[0, :3], 0.0, atol=1e-3)


# ----------------------------------------------------------------------------------- absolute encoders, missing samples


def test_differences_take_an_angle_by_the_shorter_way_round() -> None:
    follow = Differences(RIG).follow(1)
    rates = np.array([0.5, 40.0, -25.0])
    y = np.zeros((30, 6))
    y[:, :3] = 0.1 + rates * RIG.sample_time * np.arange(30)[:, None]
    estimates = [follow(row[None], np.zeros(1)) for row in dpend.nearest_upright(y)]
    assert_allclose(estimates[-1][0, 3:], rates, rtol=1e-9)


@pytest.mark.parametrize("kind", FILTERS)
def test_from_absolute_encoders_a_filter_believes_the_same_up_to_whole_turns(kind: type[EKF] | type[UKF]) -> None:
    rig = endless(sensor_noise=(1e-3, 2e-3, 2e-3, 0, 0, 0))
    _, y, u = noisy_runs(rig, np.zeros(3), 5, 100)
    encoded = dpend.nearest_upright(y)
    assert np.abs(np.diff(encoded[..., 1:3], axis=0)).max() > 6  # it hangs just where they jump
    mean, covariance = followed(kind(rig), y, u)
    other, its_covariance = followed(kind(rig), encoded, u)
    turns = (mean - other)[:, 1:3] / (2 * np.pi)
    assert_allclose(turns, np.rint(turns), atol=1e-6)
    assert_allclose(other[:, 3:], mean[:, 3:], atol=1e-6)
    assert_allclose(its_covariance, covariance, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("kind", FILTERS)
def test_where_a_measurement_is_missing_a_filter_predicts(kind: type[EKF] | type[UKF]) -> None:
    rig = endless(sensor_noise=1e-3)
    x, y, u = noisy_runs(rig, np.zeros(3), 3, 30)
    whole_mean, _ = followed(kind(rig), y, u)
    broken = y.copy()
    broken[0, 0], broken[20:, 1, 2] = np.nan, np.inf
    mean, covariance = followed(kind(rig), broken, u)
    error = np.abs(mean - x[-1])
    _, certain = followed(kind(rig), y, u)
    assert_array_equal(mean[2], whole_mean[2])  # a row is not touched by what another lacks
    assert (error[:2] < 5 * np.sqrt(np.diagonal(covariance[:2], axis1=1, axis2=2))).all()
    assert np.trace(covariance[1]) > 2 * np.trace(certain[1])


def test_a_prediction_goes_on_by_the_plants_own_step_where_a_measurement_is_missing() -> None:
    rig = endless(sensor_delay=1, actuator_delay=1)
    _, y, u = noisy_runs(rig, np.zeros(3), 2, 12)
    broken = y.copy()
    broken[[5, 6, 9], 0, 4] = np.nan
    whole_run, with_gaps = Predictor(rig).follow(2), Predictor(rig).follow(2)
    for k in range(12):
        given = u[k - 1] if k else np.zeros(2)
        assert_allclose(with_gaps(broken[k], given), whole_run(y[k], given), rtol=1e-9, atol=1e-12)


# ---------------------------------------------------------------------------------------------------------------- delay


@pytest.mark.parametrize("delays", [*DELAYS, {"actuator_delay": 3}, {"sensor_delay": 1, "actuator_lag": 0.03}])
def test_prediction_is_exact_on_a_rig_that_is_only_late(delays: dict[str, Any]) -> None:
    """The regulator behind a prediction acts as on a rig without delay, from when its first command takes effect."""
    rig, prompt = RIG.replace(**delays), RIG.replace(actuator_lag=delays.get("actuator_lag", 0.0))
    late = delays.get("actuator_delay", 0)
    x0 = np.array([[0.1, 0.1, -0.05, 0, 0, 0], [0, 0.05, 0.1, 0.2, 0, -0.1]])
    mine = dpend.simulate_many(rig, WithEstimator(Predictor(rig), LQR(rig)), x0, 2.0, record=True)
    theirs = dpend.simulate_many(prompt, LQR(rig), mine.x[:, late], 2.0)
    assert (mine.u[:, :late] == 0).all()
    assert_allclose(mine.u[:, late:], theirs.u[:, : 100 - late], rtol=0, atol=1e-9)


@pytest.mark.parametrize("kind", FILTERS)
@pytest.mark.parametrize("delays", DELAYS)
def test_a_filter_behind_delays_believes_what_it_does_without(
    kind: type[EKF] | type[UKF], delays: dict[str, int]
) -> None:
    """Of the moment measured: the same measurements, only later, and the same forces."""
    rig = endless(sensor_noise=1e-3)
    _, y, u = noisy_runs(rig, np.zeros(3), 3, 20)
    d_s, d_a = delays.get("sensor_delay", 0), delays.get("actuator_delay", 0)
    late_y = np.concatenate([np.repeat(y[:1], d_s, axis=0), y])
    prompt_u = np.concatenate([np.zeros((d_a, 3)), u])[: len(u)]
    late_u = np.concatenate([u, np.zeros((d_s, 3))])
    for mine, theirs in zip(
        followed(kind(rig.replace(**delays)), late_y, late_u), followed(kind(rig), y, prompt_u), strict=True
    ):
        assert_allclose(mine, theirs, rtol=1e-9, atol=1e-12)


# ------------------------------------------------------------------------------------------------------------- the loop


@pytest.mark.parametrize("kind", FILTERS)
@pytest.mark.parametrize("delays", DELAYS)
def test_from_encoders_and_late_the_regulator_balances_every_start(
    kind: type[EKF] | type[UKF], delays: dict[str, int]
) -> None:
    rig = RIG.replace(resolution=ENCODERS, **delays)
    task = dpend.Balance(lam=0.1)
    starts = task.starts(np.random.default_rng(3), 50, rig)
    assert dpend.simulate_many(rig, WithEstimator(kind(rig), LQR(rig)), starts, task=task).success.all()


def test_without_an_estimator_the_same_regulator_does_not() -> None:
    rig = RIG.replace(resolution=ENCODERS, sensor_delay=2, actuator_delay=1)
    task = dpend.Balance(lam=0.1)
    starts = task.starts(np.random.default_rng(3), 50, rig)
    assert dpend.simulate_many(rig, LQR(rig), starts, task=task).success.mean() < 0.5


@pytest.mark.parametrize("kind", FILTERS)
def test_a_wrong_model_leaves_it_sane(kind: type[EKF] | type[UKF]) -> None:
    rig = RIG.replace(resolution=ENCODERS, sensor_delay=1)
    rng = np.random.default_rng(8)
    n = 40
    wrong = {
        name: getattr(RIG.params, name) * rng.uniform(0.8, 1.2, n) for name in ("mass1", "mass2", "length1", "length2")
    }
    true = rig.replace(**wrong)
    starts = dpend.Balance(lam=0.1).starts(rng, n, true)
    runs = dpend.simulate_many(true, WithEstimator(kind(rig), LQR(rig, (1, 10, 10, 1, 1, 1), 0.1)), starts)
    assert np.isfinite(runs.u[~np.isnan(runs.u)]).all()
    assert runs.success.mean() > 0.8


def test_a_controllers_log_is_passed_on() -> None:
    class Logging:
        def start(self, n: int, rng: np.random.Generator) -> Any:
            def act(t: float, y: Array) -> Array:
                act.log["seen"].append(y[:, 0].copy())  # type: ignore[attr-defined]
                return np.zeros(n)

            act.log = {"seen": []}  # type: ignore[attr-defined]
            return act

    run = dpend.simulate(RIG, WithEstimator(EKF(RIG), Logging()), [0.5, 0.1, 0, 0, 0, 0], 0.1)
    assert run.log["seen"][0] == 0.5


def test_wrong_use_is_refused() -> None:
    with pytest.raises(
        TypeError,
        match=whole(
            f"estimator must be an estimator such as EKF(rig), with a method follow(n); got {Constant(1.0)!r}."
        ),
    ):
        WithEstimator(Constant(1.0), LQR(RIG))  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=whole("Expected a controller object; got the class LQR. Call it first.")):
        WithEstimator(EKF(RIG), LQR)  # type: ignore[arg-type]
    with pytest.raises(
        ValueError,
        match=whole(
            "process_noise must be three finite numbers, at least 0 (N, N m and N m, on cart and links); got 1.0."
        ),
    ):
        EKF(RIG, process_noise=1.0)
    with pytest.raises(ValueError, match=whole("measurement_noise must be greater than 0; got (0, 1, 1).")):
        UKF(RIG, measurement_noise=(0, 1, 1))
    for kind in (EKF, UKF, Predictor):
        with pytest.raises(
            ValueError,
            match=whole(f"{kind.__name__} takes one plant; got a rig of 2 rows. Take one of them with rig.rows(i)."),
        ):
            kind(endless(mass1=np.array([0.5, 0.6])))
