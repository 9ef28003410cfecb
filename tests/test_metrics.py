"""Smoothness of held forces: what a staircase has at one rate of recording it has at every other."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from rigs import whole
from scipy.integrate import quad, trapezoid
from scipy.signal import chirp

import dpend
from controllers import LQR, BangBang
from dpend.metrics import RATE_DEPENDENT, UNITS, force_metrics, power_spectrum, smoothness_metrics
from dpend.params import Array

LIMIT = 40.0
TIMES = 0.02 * np.arange(500, dtype=np.float64)  # 10 s at 50 Hz


def everything(u: Array, sample_time: float, limit: float = LIMIT) -> dict[str, float]:
    """Return all metrics of one signal, compatibility columns too."""
    found = force_metrics(u[None], sample_time, limit) | smoothness_metrics(u[None], sample_time, limit)
    return {name: float(value[0]) for name, value in found.items()}


def smoothness(u: Array, sample_time: float = 0.02, limit: float = LIMIT, **settings: float) -> dict[str, float]:
    found = smoothness_metrics(u[None], sample_time, limit, **settings)
    return {name: float(value[0]) for name, value in found.items()}


def _square(t: Array) -> Array:
    return np.where(np.floor(t / 0.5 + 1e-9) % 2 == 0, LIMIT, -LIMIT)


def _triangle(t: Array) -> Array:
    return LIMIT * (2 * np.abs(2 * ((t + 0.25) % 1.0) - 1) - 1)


SIGNALS = {
    "square": _square(TIMES),
    "triangle": _triangle(TIMES),
    "sine": 0.7 * LIMIT * np.sin(2 * np.pi * 1.3 * TIMES),
    "chirp": LIMIT * chirp(TIMES, 0.1, 10.0, 20.0),
    "white noise": np.clip(np.random.default_rng(0).normal(0.0, 20.0, 500), -LIMIT, LIMIT),
    "constant": np.full(500, 12.0),
    "one jump": np.where(TIMES < 3.0, 5.0, -7.0),
}


@pytest.mark.parametrize("u", SIGNALS.values(), ids=SIGNALS)
def test_a_held_force_has_the_same_metrics_however_often_it_is_recorded(u: Array) -> None:
    at_50 = everything(u, 0.02)
    assert {*at_50} | {"travel", "time_up"} == {*UNITS}
    for times in (2, 10):  # 100 and 500 Hz
        again = everything(np.repeat(u, times), 0.02 / times)
        for name in at_50.keys() - {*RATE_DEPENDENT}:
            assert again[name] == pytest.approx(at_50[name], rel=1e-9, abs=1e-12), name


def test_the_columns_of_others_change_with_the_rate_of_recording() -> None:
    at_50, at_500 = smoothness(SIGNALS["square"]), smoothness(np.repeat(SIGNALS["square"], 10), 0.002)
    for name in RATE_DEPENDENT:
        assert at_500[name] < 0.5 * at_50[name]


@pytest.mark.parametrize("name", ["sine", "triangle"])
def test_a_smooth_force_sampled_faster_has_nearly_the_same_metrics(name: str) -> None:
    signal = {"sine": lambda t: 30 * np.sin(2 * np.pi * t), "triangle": _triangle}[name]
    found = [everything(signal(np.arange(0, 10, h) + h / 2), h) for h in (0.02, 0.01, 0.002)]
    for metric in ("effort", "variation", "switches", "peak_force"):
        assert [each[metric] for each in found] == pytest.approx([found[-1][metric]] * 3, rel=0.02)


def test_the_slew_of_one_jump_is_that_of_an_exponential() -> None:
    lag, jump = 0.01, 12.0  # the rate is jump/lag exp(-t/lag), its square integrates to jump^2/(2 lag)
    assert smoothness(SIGNALS["one jump"])["slew"] == pytest.approx(
        np.sqrt(jump**2 / (2 * lag) / 10.0) / LIMIT, rel=1e-12
    )


def test_the_slew_is_the_mean_square_of_the_lags_rate_integrated_by_quadrature() -> None:
    rng = np.random.default_rng(1)
    u, h, lag = rng.uniform(-LIMIT, LIMIT, 20), 0.03, 0.05
    total, v = 0.0, u[0]
    for held in u:
        total += quad(lambda t, held=held, v=v: ((held - v) / lag * np.exp(-t / lag)) ** 2, 0, h)[0]
        v = held + (v - held) * np.exp(-h / lag)
    assert smoothness(u, h, lag=lag)["slew"] == pytest.approx(np.sqrt(total / (20 * h)) / LIMIT, rel=1e-10)


def test_the_slew_of_a_sine_is_its_rate_behind_the_lag() -> None:
    h, frequency, lag = 1e-3, 2.0, 0.05
    omega = 2 * np.pi * frequency
    u = LIMIT * np.sin(omega * h * np.arange(20_000))
    assert smoothness(u, h, lag=lag)["slew"] == pytest.approx(omega / np.sqrt(2 * (1 + (omega * lag) ** 2)), rel=5e-3)


def test_the_slew_of_a_square_wave_is_that_of_its_jumps() -> None:
    # twice the limit twice a second, each decaying long before the next; the first of ten seconds is no jump
    assert smoothness(SIGNALS["square"])["slew"] == pytest.approx(np.sqrt(19 * 4 / (2 * 0.01) / 10.0), rel=1e-12)


def test_all_power_of_a_constant_is_below_the_cutoff_and_nothing_else_moves() -> None:
    found = smoothness(SIGNALS["constant"])
    assert (found["slew"], found["std_step"]) == (0.0, 0.0)
    assert found["spectral_share"] == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize(("frequency", "share"), [(1.0, 0.0), (4.0, 0.0), (6.0, 1.0), (15.0, 1.0)])
def test_a_cosine_lies_on_its_own_side_of_the_cutoff(frequency: float, share: float) -> None:
    h = 1e-3
    u = np.cos(2 * np.pi * frequency * h * (np.arange(4000) + 0.5))
    assert smoothness(u, h, cutoff=5.0)["spectral_share"] == pytest.approx(share, abs=2e-3)


def test_two_cosines_share_the_power_by_their_squares() -> None:
    t = 1e-3 * (np.arange(8000) + 0.5)
    u = 3 * np.cos(2 * np.pi * 2.0 * t) + np.cos(2 * np.pi * 9.0 * t)
    assert smoothness(u, 1e-3)["spectral_share"] == pytest.approx(1 / (9 + 1), abs=1e-3)


def test_a_square_wave_has_the_share_of_its_odd_harmonics() -> None:
    # an even square wave of 1 Hz: lines at 1, 3, 5, ... Hz with powers 8/(pi k)^2; those above 5.5 Hz remain
    t = 1e-3 * (np.arange(8000) + 0.5)
    even = np.where(np.floor((t + 0.25) / 0.5) % 2 == 0, 1.0, -1.0)
    expected = 1 - 8 / np.pi**2 * (1 + 1 / 9 + 1 / 25)
    assert smoothness(even, 1e-3, cutoff=5.5)["spectral_share"] == pytest.approx(expected, abs=1e-9)


def test_the_share_of_white_noise_is_what_its_hold_leaves() -> None:
    # a held white sequence has the power spectrum h sinc^2(f h), whose integral over all frequencies is one
    u = np.random.default_rng(2).standard_normal((400, 500))
    shares = smoothness_metrics(u, 0.02, 1.0)["spectral_share"]
    f = np.linspace(0, 5.0, 2001)
    expected = 1 - 2 * 0.02 * trapezoid(np.sinc(0.02 * f) ** 2, f)
    assert shares.mean() == pytest.approx(expected, abs=4 * shares.std() / 20)


def test_the_share_of_a_chirp_is_the_time_it_spends_above_the_cutoff() -> None:
    t = 1e-3 * np.arange(40_000)
    assert smoothness(chirp(t, 0.0, 40.0, 20.0), 1e-3, cutoff=5.0)["spectral_share"] == pytest.approx(0.75, abs=0.01)


def test_above_every_frequency_there_is_no_power_and_beyond_half_the_rate_there_is() -> None:
    u = SIGNALS["white noise"]
    shares = [smoothness(u, cutoff=cutoff)["spectral_share"] for cutoff in (1.0, 24.0, 26.0, 60.0, 1000.0, 1e5)]
    assert shares == sorted(shares, reverse=True)
    assert shares[2] > 0.1  # the steps of the staircase
    assert shares[-1] < 1e-3


def test_the_columns_of_others_are_their_definitions() -> None:
    u = SIGNALS["white noise"]
    amplitudes = 2 / 500 * np.abs(np.fft.fft(u / LIMIT)[:250])
    found = smoothness(u)
    assert found["caps_sm"] == pytest.approx(np.mean(amplitudes * np.linspace(0, 1, 250)), rel=1e-12)
    assert found["std_step"] == pytest.approx(np.std(np.diff(u)), rel=1e-12)


def test_smoothness_of_runs_that_end_at_different_times_is_that_of_each_alone() -> None:
    rng = np.random.default_rng(3)
    u = rng.uniform(-LIMIT, LIMIT, (30, 50))
    steps = np.array([0, 1, 2, 3, *rng.integers(0, 51, 26)])
    limits = rng.choice([20.0, 40.0, np.inf], 30)
    together = smoothness_metrics(np.where(np.arange(50) < steps[:, None], u, np.nan), 0.02, limits)
    for row, step in enumerate(steps):
        alone = smoothness_metrics(u[row : row + 1, :step], 0.02, float(limits[row]))
        for name, value in alone.items():
            np.testing.assert_allclose(together[name][row], value[0], rtol=1e-12, atol=1e-15, err_msg=name)
            assert np.isfinite(value[0])


def test_smoothness_does_not_depend_on_the_size_of_the_actuator_but_for_the_newtons() -> None:
    u = np.random.default_rng(4).uniform(-1.0, 1.0, (20, 100))
    small, large = smoothness_metrics(4.0 * u, 0.02, 4.0), smoothness_metrics(64.0 * u, 0.02, 64.0)
    for name in ("slew", "spectral_share", "caps_sm"):
        np.testing.assert_allclose(small[name], large[name], rtol=1e-14, err_msg=name)
    np.testing.assert_allclose(16 * small["std_step"], large["std_step"], rtol=1e-14)


def test_force_noise_hides_saturation_no_longer() -> None:
    rig = dpend.rig("gustafsson2016").replace(force_noise=0.5)
    starts = dpend.Balance(lam=0.1).starts(np.random.default_rng(5), 50, rig)
    runs = dpend.simulate_many(rig, BangBang(LQR(rig), 40.0), starts, 4.0)
    assert runs.metrics()["saturated"].min() > 0.98
    assert force_metrics(runs.u, rig.sample_time, 40.0)["saturated"].mean() == pytest.approx(0.5, abs=0.02)
    gentle = dpend.simulate_many(rig, LQR(rig), 0.1 * starts, 4.0)
    assert gentle.metrics()["saturated"].max() == 0.0


def test_a_run_gives_the_smoothness_of_its_force() -> None:
    rig = dpend.rig("gustafsson2016")
    run = dpend.simulate(rig, LQR(rig), [0, 0.1, -0.1, 0, 0, 0], 4.0)
    assert run.smoothness(lag=0.02, cutoff=3.0) == smoothness(run.u, lag=0.02, cutoff=3.0)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"lag": 0.0}, "lag must be finite and greater than 0 s; got 0.0."),
        ({"cutoff": -1.0}, "cutoff must be finite and greater than 0 Hz; got -1.0."),
        ({"cutoff": np.inf}, "cutoff must be finite and greater than 0 Hz; got inf."),
    ],
)
def test_a_lag_or_cutoff_that_is_none_is_refused(settings: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=whole(message)):
        smoothness_metrics(np.zeros((1, 5)), 0.02, LIMIT, **settings)


def test_the_power_spectrum_of_a_cosine_has_its_mean_square_at_its_frequency_and_no_unit_of_force() -> None:
    t = 0.001 * (np.arange(10_000) + 0.5)
    u = LIMIT * np.stack([np.full(10_000, 0.3), 0.3 + 0.5 * np.cos(2 * np.pi * 3 * t)])
    frequency, density = power_spectrum(u, 0.001, LIMIT, highest=10.0)
    np.testing.assert_allclose(frequency, 0.05 * np.arange(1, 201))
    np.testing.assert_allclose(density[0], 0.0, atol=1e-20)  # the mean has no line
    assert density[1].sum() * 0.05 == pytest.approx(0.5**2 / 2, rel=1e-4)
    assert frequency[density[1] > 1e-6] == pytest.approx([3.0])


@pytest.mark.parametrize("name", SIGNALS)
def test_the_power_spectrum_sums_up_to_the_variance_of_the_staircase(name: str) -> None:
    u = SIGNALS[name]
    frequency, density = power_spectrum(u[None], 0.02, LIMIT, highest=20_000.0)
    missing = u.var() / LIMIT**2 - density.sum() * frequency[0]
    assert -1e-12 <= missing <= 2e-3 * u.var() / LIMIT**2 + 1e-12  # what lies above falls with the frequency


@pytest.mark.parametrize("u", [np.array([[1.0, 2.0], [1.0, np.nan]]), np.zeros((2, 0))])
def test_a_power_spectrum_is_refused_of_runs_of_several_lengths_or_none(u: Array) -> None:
    message = (
        "Expected force signals of one length, at least a sample, without NaN; take runs that lasted equally long."
    )
    with pytest.raises(ValueError, match=whole(message)):
        power_spectrum(u, 0.02, LIMIT)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"u": np.zeros(5)}, "Expected force signals of shape (N, T); got shape (5,)."),
        ({"sample_time": 0.0}, "sample_time must be finite and greater than 0 s; got 0.0."),
        ({"force_limit": -1.0}, "force_limit must be greater than 0 N, infinite for none; got -1.0."),
        ({"force_limit": [1.0, 2.0]}, "force_limit must be a number, or one a signal, (1,); got shape (2,)."),
    ],
)
@pytest.mark.parametrize("measure", [force_metrics, smoothness_metrics, power_spectrum])
def test_signals_a_sample_and_limits_that_are_none_are_refused(
    measure: Any, changed: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=whole(message)):
        measure(**{"u": np.zeros((1, 5)), "sample_time": 0.02, "force_limit": LIMIT} | changed)


def test_a_frequency_with_too_many_lines_and_noise_below_zero_are_refused() -> None:
    with pytest.raises(ValueError, match=whole("highest must be at most 1e+08 Hz for 5 samples; got 1e+12 Hz.")):
        power_spectrum(np.zeros((1, 5)), 0.02, LIMIT, highest=1e12)
    with pytest.raises(ValueError, match=whole("force_noise must be at least 0 N; got -1.0.")):
        force_metrics(np.zeros((1, 5)), 0.02, LIMIT, force_noise=-1.0)
