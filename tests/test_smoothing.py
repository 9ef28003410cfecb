"""Smoothing does what its equations say, costs the phase that is stated, and leaves the inner law alone."""

from __future__ import annotations

import cmath
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rigs import whole

import dpend
from controllers import LQR, BangBang, LowPass, RateLimit
from dpend.params import Array

RIG = dpend.rig("gustafsson2016")
RNG = np.random.default_rng


class Played:
    """A law that plays given forces ``(T, n)``, one row a call."""

    name = "played"

    def __init__(self, forces: Array) -> None:
        self.forces = forces

    def start(self, n: int, rng: np.random.Generator) -> dpend.Act:
        steps = iter(self.forces)
        return lambda t, y: np.broadcast_to(next(steps), n).copy()


def played(make: Callable[[Played], Any], forces: Array) -> Array:
    """Return the forces ``(T, n)`` that come out of a smoothed law."""
    forces = forces[:, None] if forces.ndim == 1 else forces
    act = make(Played(forces)).start(forces.shape[1], RNG(0))
    return np.array([act(0.02 * k, np.zeros((forces.shape[1], 6))) for k in range(len(forces))])


def test_a_rate_limit_holds_and_lets_slower_forces_pass() -> None:
    wanted = RNG(1).uniform(-40, 40, (400, 3))
    out = played(lambda inner: RateLimit(RIG, inner, 200.0), wanted)
    steps = np.diff(np.vstack([np.zeros((1, 3)), out]), axis=0)
    assert np.abs(steps).max() <= 200.0 * 0.02 * (1 + 1e-12)
    slow = 20 * np.sin(0.02 * np.arange(400))[:, None]  # at most 20 N/s
    assert_allclose(played(lambda inner: RateLimit(RIG, inner, 30.0), slow), slow, rtol=0, atol=1e-12)


def test_every_step_of_a_rate_limit_goes_as_far_towards_the_inner_force_as_it_may() -> None:
    wanted = RNG(2).uniform(-40, 40, 200)
    out = played(lambda inner: RateLimit(RIG, inner, 500.0), wanted)[:, 0]
    before = np.append(0.0, out[:-1])
    near = np.abs(wanted - before) <= 10.0
    assert 0 < near.sum() < 200
    assert_allclose(out[near], wanted[near], rtol=0, atol=1e-12)
    assert_allclose(out[~near] - before[~near], 10.0 * np.sign(wanted - before)[~near], rtol=1e-12)


def test_a_low_pass_is_the_first_order_lag_of_the_held_force() -> None:
    wanted = RNG(3).uniform(-40, 40, 50)
    tau, h = 0.07, RIG.sample_time
    out = played(lambda inner: LowPass(RIG, inner, time_constant=tau), wanted)[:, 0]
    v = 0.0
    for k, u in enumerate(wanted):  # the differential equation, in a thousand small steps of high order
        for _ in range(1000):
            z = h / 1000 / tau
            v = u + (v - u) * (1 - z + z**2 / 2 - z**3 / 6)
        assert out[k] == pytest.approx(v, abs=1e-9)


def test_a_low_pass_is_the_actuator_lag_of_a_rig() -> None:
    lagged = RIG.replace(actuator_lag=0.05)
    x0 = [0, 0.05, -0.02, 0, 0, 0]
    smoothed = dpend.simulate(RIG, LowPass(RIG, LQR(RIG), time_constant=0.05), x0, 1.0)
    assert_allclose(smoothed.u, dpend.simulate(lagged, LQR(RIG), x0, 1.0).u, rtol=0, atol=1e-8)


def test_the_corner_frequency_is_that_of_the_time_constant() -> None:
    one = LowPass(RIG, LQR(RIG), frequency=5.0)
    other = LowPass(RIG, LQR(RIG), time_constant=1 / (10 * np.pi))
    assert one.time_constant == other.time_constant
    fast = LowPass(RIG.replace(sample_time=1e-5), LQR(RIG), frequency=5.0)
    assert abs(fast.response(5.0)) == pytest.approx(np.sqrt(0.5), rel=1e-3)
    assert cmath.phase(fast.response(5.0)) == pytest.approx(-np.pi / 4, rel=1e-3)


def tone(out: Array, omega: float) -> complex:
    """Return size and phase of a sine in the second half of a signal at 50 Hz, over whole periods."""
    k = np.arange(len(out))[len(out) // 2 :]
    return complex(2j * np.mean(out[len(out) // 2 :] * np.exp(-1j * omega * 0.02 * k)))


@pytest.mark.parametrize("frequency", [0.5, 2.0, 10.0])
def test_a_sine_comes_out_of_a_low_pass_as_its_response_says(frequency: float) -> None:
    omega = 2 * np.pi * frequency
    law = LowPass(RIG, Played(np.zeros(1)), frequency=3.0)
    out = played(lambda inner: LowPass(RIG, inner, frequency=3.0), 10 * np.sin(omega * 0.02 * np.arange(2000)))[:, 0]
    found = tone(out, omega) / 10
    assert abs(found - law.response(frequency)) < 1e-9


def test_slow_forces_come_late_by_the_stated_delay() -> None:
    law = LowPass(RIG, Played(np.zeros(1)), time_constant=0.1)
    assert law.delay == pytest.approx(0.1 - RIG.sample_time / 2, rel=0.01)
    ramp = 0.01 * np.arange(500, dtype=np.float64)
    out = played(lambda inner: LowPass(RIG, inner, time_constant=0.1), ramp)[:, 0]
    assert out[-1] == pytest.approx(ramp[-1] - 0.01 / RIG.sample_time * law.delay, rel=1e-9)
    omega = 2 * np.pi * 0.01
    assert -cmath.phase(law.response(0.01)) == pytest.approx(omega * law.delay, rel=1e-3)


@pytest.mark.parametrize("excess", [2.0, 5.0])
def test_a_large_sine_comes_out_of_a_rate_limit_as_a_late_triangle(excess: float) -> None:
    h, amplitude, omega = 1e-3, 10.0, 2 * np.pi  # one hertz
    rig = RIG.replace(sample_time=h)
    rate = amplitude * omega / excess
    out = played(lambda inner: RateLimit(rig, inner, rate), amplitude * np.sin(omega * h * np.arange(8000)))[4000:, 0]
    assert np.ptp(out) / 2 == pytest.approx(np.pi * rate / (2 * omega), rel=0.01)
    found = 2j * np.mean(out * np.exp(-1j * omega * h * np.arange(4000, 8000)))
    assert -cmath.phase(found) == pytest.approx(np.arccos(np.pi / (2 * excess)), abs=0.01)


@pytest.mark.parametrize(
    "make", [lambda c: RateLimit(RIG, c, 1000.0), lambda c: LowPass(RIG, c, frequency=5.0)], ids=["rate", "low-pass"]
)
def test_the_memory_does_not_run_away_beyond_the_limit(make: Callable[[Any], Any]) -> None:
    wanted = np.append(np.full(100, 1e6), np.full(30, -1e6))
    out = played(make, wanted)[:, 0]
    assert np.abs(out).max() <= 40.0 * (1 + 1e-12)
    assert out[115] < -30.0  # not held up by what could not be given


@pytest.mark.parametrize(
    "make", [lambda c: RateLimit(RIG, c, 1e9), lambda c: LowPass(RIG, c, time_constant=1e-4)], ids=["rate", "low-pass"]
)
def test_smoothing_that_is_fast_enough_changes_nothing(make: Callable[[Any], Any]) -> None:
    starts = dpend.Balance(lam=0.1).starts(RNG(4), 5, RIG)
    smoothed, plain = (dpend.simulate_many(RIG, law, starts, 2.0) for law in (make(LQR(RIG)), LQR(RIG)))
    assert_allclose(smoothed.u, plain.u, rtol=0, atol=1e-6)


def test_bang_bang_becomes_smoother() -> None:
    starts = dpend.Balance(lam=0.05).starts(RNG(5), 20, RIG)
    hard = BangBang(LQR(RIG), 10.0)
    variation = [
        dpend.simulate_many(RIG, law, starts, 2.0).metrics()["variation"].mean()
        for law in (hard, RateLimit(RIG, hard, 300.0), LowPass(RIG, hard, frequency=10.0))
    ]
    assert max(variation[1:]) < 0.8 * variation[0]


class OneByOne(LQR):
    """A law that treats one run at a time and logs its steps."""

    batched = False

    def start(self, n: int, rng: np.random.Generator) -> dpend.Act:
        law = super().start(n, rng)

        log: dict[str, list[float]] = {"first angle": []}

        def act(t, y):
            log["first angle"].append(y[0, 1])
            return law(t, y)

        act.log = log  # type: ignore[attr-defined]
        return act


def test_one_run_at_a_time_stays_one_at_a_time_and_its_log_is_kept() -> None:
    law = RateLimit(RIG, LowPass(RIG, OneByOne(RIG), frequency=10.0), 1000.0)
    assert not law.batched
    starts = dpend.Balance(lam=0.05).starts(RNG(6), 3, RIG)
    runs = dpend.simulate_many(RIG, law, starts, 0.5, record=True)
    assert_array_equal(runs.log["first angle"], runs.x[:, :-1, 1])
    assert runs.controller == "LQR, low-pass 10 Hz, at most 1000 N/s"


def test_the_response_to_what_is_no_frequency_is_refused() -> None:
    with pytest.raises(ValueError, match=whole("frequency must be a finite number, in Hz; got nan.")):
        LowPass(RIG, LQR(RIG), frequency=5.0).response(np.nan)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: RateLimit(RIG, LQR(RIG), 0.0), "rate must be finite and greater than 0 N/s; got 0.0."),
        (lambda: LowPass(RIG, LQR(RIG)), "Give frequency, in Hz, or time_constant, in s: one of the two."),
        (
            lambda: LowPass(RIG, LQR(RIG), frequency=1.0, time_constant=1.0),
            "Give frequency, in Hz, or time_constant, in s: one of the two.",
        ),
        (
            lambda: LowPass(RIG, LQR(RIG), frequency=np.nan),
            "frequency must be finite and greater than 0 Hz; got nan.",
        ),
        (
            lambda: LowPass(RIG, LQR(RIG), time_constant=1e16),
            "Nothing passes a filter with a time constant of 1e+16 s, at samples of 0.02 s: expected a shorter one, or "
            "a higher frequency.",
        ),
        (
            lambda: RateLimit(RIG.replace(mass1=[0.5, 0.6]), LQR(RIG), 1.0),
            "RateLimit takes one plant; got a rig of 2 rows. Take one of them with rig.rows(i).",
        ),
    ],
)
def test_settings_that_mean_nothing_are_refused(build: Callable[[], Any], message: str) -> None:
    with pytest.raises(ValueError, match=whole(message)):
        build()


def test_what_is_no_controller_is_refused() -> None:
    message = "A controller has a method start(n, rng) that returns act(t, y); int has none."
    with pytest.raises(TypeError, match=whole(message)):
        RateLimit(RIG, 3, 100.0)  # type: ignore[arg-type]
