"""One sample happens in the documented order, and each part of it does what its name says."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from rigs import endless, random_forces, random_params, random_states, whole

import dpend
from dpend import Rig, Stepper, equations
from dpend.params import Array

SENSOR, FORCE = 0, 1  # the streams of a row, as documented: one a disturbance


def at_rest(n: int = 1) -> Array:
    """Return states that do not move without force: hanging."""
    return np.tile(dpend.EQUILIBRIA["down-down"], (n, 1))


def drawn(seed: int, number: int, stream: int, samples: int, width: int) -> Array:
    """Return the standard normal numbers ``(samples, width)`` that a row is to draw."""
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number, stream)))
    return generator.standard_normal((samples, width))


def applied(rig: Rig, commands: Array, seed: int = 0) -> Array:
    """Return the forces ``(n, T)`` that a rig applies when told commands ``(n, T)``."""
    stepper = Stepper(rig, len(commands), seed)
    stepper.reset(at_rest(len(commands)))
    forces = []
    for command in commands.T:
        stepper.step(command)
        forces.append(stepper.force.copy())
    return np.array(forces).T


# ----------------------------------------------------------------------------------------------------------- one sample


class Bench:
    """One row of a rig in the plainest Python, as documented: sample, round, noise, delay; delay, limit, lag, noise."""

    rk4 = staticmethod(equations.make_rk4(equations.make_rates(np.sin, np.cos)))

    def __init__(self, rig: Rig, number: int, seed: int) -> None:
        self.rig: Any = rig
        self.sensor_noise = iter(drawn(seed, number, SENSOR, 500, 6))
        self.force_noise = iter(drawn(seed, number, FORCE, 500, 1))
        self.commands: list[float] = []
        self.readings: list[Array] = []
        self.drive = 0.0

    def reset(self, x: Array) -> Array:
        self.x = x
        return self.measure()

    def measure(self) -> Array:
        step = np.broadcast_to(self.rig.resolution, 6)
        rounded = np.where(step > 0, step * np.rint(self.x / np.where(step > 0, step, 1)), self.x)
        self.readings.append(rounded + self.rig.sensor_noise * next(self.sensor_noise))
        return self.readings[max(0, len(self.readings) - 1 - self.rig.sensor_delay)]

    def step(self, u: float, push: Array) -> Array:
        rig = self.rig
        self.commands.append(u)
        late = len(self.commands) - 1 - rig.actuator_delay
        command = self.commands[late] if late >= 0 else 0.0
        command = min(max(command, -rig.force_limit), rig.force_limit)
        if rig.actuator_lag:
            self.drive += (1 - np.exp(-rig.sample_time / rig.actuator_lag)) * (command - self.drive)
        else:
            self.drive = command
        self.force = self.drive + rig.force_noise * next(self.force_noise)[0]
        f = push + np.array([self.force, 0.0, 0.0])
        x: Any = tuple(self.x)
        for _ in range(rig.substeps):
            x = self.rk4(x, f, rig.params.coefficients(), rig.sample_time / rig.substeps)
        self.x = np.array(x)
        return self.measure()


def full_rig(rng: np.random.Generator, n: int) -> Rig:
    """Draw rigs with every imperfection, different for each row."""
    return Rig(
        params=random_params(rng, n),
        sample_time=0.02,
        substeps=2,
        force_limit=rng.uniform(5, 20, n),
        actuator_lag=rng.uniform(0.01, 0.05, n),
        actuator_delay=rng.integers(0, 4, n),
        force_noise=rng.uniform(0.1, 1.0, n),
        sensor_delay=rng.integers(0, 4, n),
        sensor_noise=rng.uniform(1e-3, 1e-2, (n, 6)),
        resolution=rng.uniform(1e-3, 1e-1, (n, 6)) * rng.integers(0, 2, (n, 6)),
    )


def test_one_sample_happens_in_the_documented_order() -> None:
    rng = np.random.default_rng(0)
    n, seed, first = 6, 42, 10
    rig = full_rig(rng, n)
    x0 = random_states(rng, n, scale=0.3)
    stepper = Stepper(rig, n, seed, first_row=first)
    benches = [Bench(rig.rows(i), first + i, seed) for i in range(n)]
    assert_allclose(stepper.reset(x0), [bench.reset(x) for bench, x in zip(benches, x0, strict=True)], atol=1e-12)
    for _ in range(30):
        u, push = rng.uniform(-30, 30, n), 0.3 * random_forces(rng, n)
        expected = [bench.step(u[i], push[i]) for i, bench in enumerate(benches)]
        assert_allclose(stepper.step(u, push), expected, rtol=0, atol=1e-9)
        assert_allclose(stepper.force, [bench.force for bench in benches], rtol=0, atol=1e-12)
        assert_allclose(stepper.x, [bench.x for bench in benches], rtol=0, atol=1e-9)


def test_a_perfect_rig_measures_the_true_state_and_applies_the_command() -> None:
    rng = np.random.default_rng(1)
    x0, u = random_states(rng, 5), rng.uniform(-100, 100, 5)
    stepper = Stepper(endless(), 5)
    assert np.array_equal(stepper.reset(x0), x0)
    y = stepper.step(u)
    assert np.array_equal(y, stepper.x)
    assert np.array_equal(stepper.force, u)


@pytest.mark.parametrize("n", [1, 2])
@pytest.mark.parametrize("imperfection", [{}, {"sensor_delay": 1}, {"actuator_delay": 1}, {"actuator_lag": 0.1}])
def test_rig_and_caller_leave_each_others_arrays_alone(n: int, imperfection: dict[str, Any]) -> None:
    rig = endless(force_limit=1.0, **imperfection)
    stepper, other = Stepper(rig, n), Stepper(rig, n)
    y, same = stepper.reset(at_rest(n)), other.reset(at_rest(n))
    for _ in range(4):
        assert np.array_equal(y, same)
        y[:] = 99.0
        command = np.full(n, 2.0)
        y, same = stepper.step(command), other.step(np.full(n, 2.0))
        assert np.array_equal(command, np.full(n, 2.0))
        command[:] = 99.0
        assert np.array_equal(stepper.force, other.force)
    assert np.array_equal(stepper.x, other.x)


# ------------------------------------------------------------------------------------------------------------- actuator


def test_the_force_is_limited_both_ways() -> None:
    commands = np.array([[-50.0, -10.0, 0.0, 9.9, 10.0, 11.0, np.inf, -np.inf]])
    expected = [[-10.0, -10.0, 0.0, 9.9, 10.0, 10.0, 10.0, -10.0]]
    assert np.array_equal(applied(endless(force_limit=10.0), commands), expected)


def test_the_step_response_of_the_lag_is_one_minus_an_exponential() -> None:
    rig = endless(actuator_lag=0.07)
    k = np.arange(1, 31)
    expected = 8.0 * (1 - np.exp(-k * rig.sample_time / 0.07))
    assert_allclose(applied(rig, np.full((1, 30), 8.0))[0], expected, rtol=1e-12)


def test_the_lag_starts_from_the_limited_command_not_from_what_was_asked() -> None:
    rig = endless(actuator_lag=0.07, force_limit=8.0)
    assert np.array_equal(applied(rig, np.full((1, 30), 800.0)), applied(rig, np.full((1, 30), 8.0)))


def test_a_row_without_lag_beside_one_with_lag_is_exact() -> None:
    commands = np.random.default_rng(2).uniform(-40, 40, (2, 50))
    assert np.array_equal(applied(endless(actuator_lag=[0.0, 0.05]), commands)[0], commands[0])


@pytest.mark.parametrize("delay", [1, 2, 5])
def test_an_actuator_delay_shifts_the_commands_by_whole_samples(delay: int) -> None:
    commands = np.random.default_rng(3).uniform(-40, 40, (3, 20))
    forces = applied(endless(actuator_delay=delay), commands)
    assert not forces[:, :delay].any()
    assert np.array_equal(forces[:, delay:], commands[:, :-delay])


def test_rows_may_have_different_delays() -> None:
    commands = np.random.default_rng(4).uniform(-40, 40, (3, 20))
    forces = applied(endless(actuator_delay=[2, 0, 3]), commands)
    assert np.array_equal(forces[0, 2:], commands[0, :-2])
    assert np.array_equal(forces[1], commands[1])
    assert np.array_equal(forces[2, 3:], commands[2, :-3])


def test_force_noise_has_the_stated_deviation_and_no_bias() -> None:
    n, samples = 400, 100
    noise = applied(endless(force_noise=np.where(np.arange(n) % 2, 3.0, 0.5)), np.full((n, samples), 7.0)) - 7.0
    for rows, std in ((slice(1, None, 2), 3.0), (slice(0, None, 2), 0.5)):
        assert_allclose(noise[rows].std(), std, rtol=0.02)
        assert abs(noise[rows].mean()) < 5 * std / np.sqrt(noise[rows].size)
    by_sample = noise[1::2] / 3.0
    assert_allclose(by_sample.std(axis=0).mean(), 1.0, rtol=0.02)
    assert abs(np.corrcoef(by_sample[:, :-1].ravel(), by_sample[:, 1:].ravel())[0, 1]) < 0.03  # white


# -------------------------------------------------------------------------------------------------------------- sensors


@pytest.mark.parametrize("delay", [1, 2, 5])
def test_a_sensor_delay_shifts_the_measurements_by_whole_samples(delay: int) -> None:
    rng = np.random.default_rng(5)
    x0 = random_states(rng, 4)
    late, prompt = Stepper(endless(sensor_delay=delay), 4), Stepper(endless(), 4)
    measured, true = [late.reset(x0)], [prompt.reset(x0)]
    for u in rng.uniform(-10, 10, (15, 4)):
        measured.append(late.step(u))
        true.append(prompt.step(u))
    for k, y in enumerate(measured):
        assert np.array_equal(y, true[max(0, k - delay)])


def test_quantisation_rounds_to_the_nearest_step() -> None:
    resolution = np.array([0.0, 0.1, 0.25, 0.0, 1.0, 0.0])
    x0 = random_states(np.random.default_rng(6), 200)
    y = Stepper(endless(resolution=resolution), 200).reset(x0)
    assert np.array_equal(y[:, resolution == 0], x0[:, resolution == 0])
    rounded = resolution > 0
    steps = y[:, rounded] / resolution[rounded]
    assert_allclose(steps, np.rint(steps), rtol=0, atol=1e-12)
    assert (np.abs(y - x0)[:, rounded] <= resolution[rounded] / 2 * (1 + 1e-12)).all()
    assert len(np.unique(y[:, 1])) > 50


def test_quantisation_hides_nothing_from_the_plant() -> None:
    coarse, fine = Stepper(endless(resolution=0.5), 1), Stepper(endless(), 1)
    x0 = random_states(np.random.default_rng(7), 1)
    coarse.reset(x0)
    fine.reset(x0)
    for _ in range(5):
        coarse.step([1.0])
        fine.step([1.0])
    assert np.array_equal(coarse.x, fine.x)


def test_sensor_noise_has_the_stated_deviation_and_no_bias() -> None:
    n, samples = 400, 40
    std = np.array([0.1, 0.0, 0.3, 1.0, 0.5, 2.0])
    stepper = Stepper(endless(sensor_noise=std), n)
    noise = [stepper.reset(at_rest(n)) - stepper.x]
    for _ in range(samples - 1):
        noise.append(stepper.step(np.zeros(n)) - stepper.x)
    noise = np.array(noise)
    assert_allclose(noise.std(axis=(0, 1)), std, rtol=0.03, atol=1e-15)
    assert (np.abs(noise.mean(axis=(0, 1))) <= 5 * std / np.sqrt(n * samples) + 1e-15).all()
    loud = noise[..., std > 0].reshape(-1, 5)
    assert np.abs(np.corrcoef(loud.T) - np.eye(5)).max() < 0.04  # one state's noise says nothing of another's


def test_sensor_noise_does_not_move_the_plant() -> None:
    noisy, quiet = Stepper(endless(sensor_noise=1.0), 1), Stepper(endless(), 1)
    for stepper in (noisy, quiet):
        stepper.reset(at_rest())
        stepper.step([3.0])
    assert np.array_equal(noisy.x, quiet.x)


# ----------------------------------------------------------------------------------------------------------- randomness


def noises(n: int, seed: int = 0, first_row: int = 0, u: float = 0.0, samples: int = 80) -> tuple[Array, Array]:
    """Return the noise of the sensors ``(n, T, 6)`` and of the force ``(n, T)``."""
    stepper = Stepper(endless(sensor_noise=1.0, force_noise=1.0), n, seed, first_row)
    sensor, force = [stepper.reset(at_rest(n)) - stepper.x], []
    for _ in range(samples):
        y = stepper.step(np.full(n, u))
        sensor.append(y - stepper.x)
        force.append(stepper.force - u)
    return np.array(sensor).swapaxes(0, 1), np.array(force).T


def test_a_row_draws_the_same_whatever_runs_beside_it() -> None:
    together = noises(7)
    for i in (0, 3, 6):
        alone = noises(1, first_row=i)
        for mine, theirs in zip(alone, together, strict=True):
            assert_allclose(mine[0], theirs[i], rtol=0, atol=1e-12)


def test_a_row_draws_the_same_whatever_it_is_told() -> None:
    for quiet, driven in zip(noises(3), noises(3, u=30.0), strict=True):
        assert_allclose(quiet, driven, rtol=0, atol=1e-12)


def test_noise_of_the_sensors_is_the_same_whether_or_not_the_force_has_noise() -> None:
    x0 = at_rest(2)
    both, one = Stepper(endless(sensor_noise=1.0, force_noise=1.0), 2), Stepper(endless(sensor_noise=1.0), 2)
    assert np.array_equal(both.reset(x0), one.reset(x0))
    assert_allclose(both.step([0, 0]) - both.x, one.step([0, 0]) - one.x, rtol=0, atol=1e-12)


def test_rows_streams_and_seeds_draw_differently() -> None:
    sensor, force = noises(3)
    other_sensor, other_force = noises(3, seed=1)
    signals = [*sensor[:, :80, 0], *sensor[:, :80, 5], *force, *other_sensor[:, :80, 0], *other_force]
    correlation = np.corrcoef(signals) - np.eye(len(signals))
    assert np.abs(correlation).max() < 0.5


def test_noise_is_drawn_from_the_seed_sequence_that_is_documented() -> None:
    sensor, force = noises(2, seed=5, first_row=3)
    for i in range(2):
        assert_allclose(sensor[i], drawn(5, 3 + i, SENSOR, 81, 6), rtol=0, atol=1e-12)
        assert_allclose(force[i], drawn(5, 3 + i, FORCE, 80, 1)[:, 0], rtol=0, atol=1e-12)


# --------------------------------------------------------------------------------------------------------------- pushes


def test_pushes_are_generalised_forces_on_cart_and_links() -> None:
    rng = np.random.default_rng(8)
    n = 5
    params = random_params(rng, n)
    x0, f = random_states(rng, n), random_forces(rng, n)
    u = rng.uniform(-10, 10, n)
    T = 1e-6  # so short that the mean acceleration over the sample is the acceleration at its start
    stepper = Stepper(endless(params=params, sample_time=T, substeps=1), n)
    stepper.reset(x0)
    stepper.step(u, f)
    total = f + np.stack([u, np.zeros(n), np.zeros(n)], axis=1)
    rates = dpend.rates(x0, total, params)
    assert_allclose((stepper.x - x0) / T, rates, rtol=0, atol=1e-3 * np.abs(rates).max())
    assert np.array_equal(stepper.force, u)  # a push is not the actuator's


def test_a_push_on_the_cart_is_as_good_as_a_command() -> None:
    rng = np.random.default_rng(9)
    x0 = random_states(rng, 4)
    pushed, told = Stepper(endless(), 4), Stepper(endless(), 4)
    pushed.reset(x0)
    told.reset(x0)
    pushed.step(np.zeros(4), [6.0, 0.0, 0.0])
    told.step(np.full(4, 6.0))
    assert np.array_equal(pushed.x, told.x)


def test_a_push_is_not_limited_and_acts_on_its_row() -> None:
    pushed, told = Stepper(endless(force_limit=1.0), 2), Stepper(endless(), 2)
    pushed.reset(at_rest(2))
    told.reset(at_rest(2))
    pushed.step(np.zeros(2), [[9.0, 2.0, -1.0], [0.0, 0.0, 0.0]])
    told.step([9.0, 0.0], [[0.0, 2.0, -1.0], [0.0, 0.0, 0.0]])
    assert np.array_equal(pushed.x, told.x)
    assert np.abs(pushed.x[0, 3:]).min() > 1e-3
    assert_allclose(pushed.x[1], at_rest()[0], rtol=0, atol=1e-12)


def test_a_push_ends_with_its_sample() -> None:
    pushed, fresh = Stepper(endless(), 1), Stepper(endless(), 1)
    pushed.reset(at_rest())
    pushed.step([0.0], [9.0, 2.0, -1.0])
    fresh.reset(pushed.x)
    pushed.step([0.0])
    fresh.step([0.0])
    assert np.array_equal(pushed.x, fresh.x)


# ----------------------------------------------------------------------------------------------------------------- rows


def trace(stepper: Stepper, x0: Array, commands: Array) -> Array:
    """Return true and measured states and forces of all rows, sample by sample: ``(n, T, 13)``."""
    stepper.reset(x0)
    parts = []
    for u in commands.T:
        y = stepper.step(u)
        parts.append(np.concatenate([stepper.x, y, stepper.force[:, None]], axis=1))
    return np.array(parts).swapaxes(0, 1)


def test_row_i_of_a_batch_is_bitwise_the_single_run_of_it() -> None:
    rng = np.random.default_rng(10)
    n = 600  # blocks of 256 and a rest
    rig = endless(
        params=random_params(rng),
        force_limit=20.0,
        actuator_lag=0.03,
        actuator_delay=2,
        force_noise=0.5,
        sensor_delay=1,
        sensor_noise=0.1,
        resolution=0.05,
    )
    x0, commands = random_states(rng, n), rng.uniform(-40, 40, (n, 25))
    together = trace(Stepper(rig, n), x0, commands)
    for i in (0, 1, 255, 256, 511, 512, 599):
        alone = trace(Stepper(rig, 1, first_row=i), x0[i : i + 1], commands[i : i + 1])
        assert np.array_equal(alone[0], together[i])


def test_a_batch_of_rigs_moves_as_the_single_rigs() -> None:
    rng = np.random.default_rng(11)
    n = 300
    rig = full_rig(rng, n)
    x0, commands = random_states(rng, n), rng.uniform(-40, 40, (n, 25))
    together = trace(Stepper(rig, n), x0, commands)
    for i in (0, 7, 255, 256, 299):
        part = trace(Stepper(rig.rows(slice(i, i + 1)), 1, first_row=i), x0[i : i + 1], commands[i : i + 1])
        assert np.array_equal(part[0], together[i])
        alone = trace(Stepper(rig.rows(i), 1, first_row=i), x0[i : i + 1], commands[i : i + 1])
        assert_allclose(alone[0], together[i], rtol=0, atol=1e-9)  # one plant for all is another kernel


def test_some_rows_can_be_reset_while_the_others_go_on() -> None:
    rng = np.random.default_rng(12)
    n = 4
    rig = endless(actuator_delay=2, actuator_lag=0.05, sensor_delay=2, force_noise=1e-13)
    x0, commands = random_states(rng, n, scale=0.3), rng.uniform(-5, 5, (n, 12))
    undisturbed, mixed = Stepper(rig, n), Stepper(rig, n)
    undisturbed.reset(x0)
    mixed.reset(x0)
    for u in commands.T[:6]:
        undisturbed.step(u)
        mixed.step(u)
    fresh = Stepper(rig, 2)
    restarted = np.array([1, 3])
    others = np.array([0, 2])
    assert np.array_equal(mixed.reset(x0[restarted], restarted), fresh.reset(x0[restarted]))
    for u in commands.T[6:]:
        y, new, old = mixed.step(u), fresh.step(u[restarted]), undisturbed.step(u)
        assert_allclose(y[restarted], new, rtol=0, atol=1e-10)
        assert_allclose(mixed.x[restarted], fresh.x, rtol=0, atol=1e-10)
        assert_allclose(mixed.force[restarted], fresh.force, rtol=0, atol=1e-10)
        assert np.array_equal(y[others], old[others])
        assert np.array_equal(mixed.force[others], undisturbed.force[others])


@pytest.mark.parametrize("rows", [np.array([False, True, True]), slice(1, 3), np.array([1, 2])])
def test_rows_may_be_named_by_mask_slice_or_indices(rows: Any) -> None:
    x0 = random_states(np.random.default_rng(13), 2)
    stepper = Stepper(endless(sensor_delay=1, actuator_delay=1, resolution=1e-6), 3)
    stepper.reset(at_rest(3))
    assert_allclose(stepper.reset(x0, rows), x0, rtol=0, atol=1e-6)
    assert np.array_equal(stepper.x[1:], x0)
    assert np.array_equal(stepper.x[0], at_rest()[0])
    assert_allclose(stepper.reset(np.zeros(6), rows), np.zeros((2, 6)))  # one state for all of them


def test_a_state_that_blows_up_leaves_its_neighbours_alone() -> None:
    rng = np.random.default_rng(14)
    x0 = random_states(rng, 3)
    stepper, other = Stepper(endless(), 3), Stepper(endless(), 3)
    stepper.reset(x0)
    other.reset(x0)
    for _ in range(3):
        stepper.step([0.0, np.nan, 0.0])
        other.step([0.0, 1.0, 0.0])
    assert np.isnan(stepper.x[1, 3:]).all()
    assert np.array_equal(stepper.x[[0, 2]], other.x[[0, 2]])


def test_the_applied_force_is_the_callers_to_keep_and_to_change() -> None:
    stepper = Stepper(endless(actuator_lag=0.02), 2)
    other = Stepper(endless(actuator_lag=0.02), 2)
    for each in (stepper, other):
        each.reset(at_rest(2))
        each.step([10.0, 10.0])
    kept = stepper.force
    stepper.force[:] = 0.0
    for each in (stepper, other):
        each.step([10.0, 10.0])
    assert np.array_equal(stepper.force, other.force)
    applied = stepper.force
    before = applied.copy()
    stepper.reset(at_rest(2))
    assert np.array_equal(applied, before)
    assert np.array_equal(kept, [0.0, 0.0])


@pytest.mark.parametrize("u", [np.zeros(2), np.zeros((3, 1)), 0.0])
def test_a_force_for_each_row_is_asked_for(u: Any) -> None:
    stepper = Stepper(endless(), 3)
    stepper.reset(at_rest(3))
    hint = " A law written as y @ K.T returns a column: take [:, 0]." if np.shape(u) == (3, 1) else ""
    message = f"Expected one force per row, shape (3,); got shape {np.shape(u)}.{hint}"
    with pytest.raises(ValueError, match=whole(message)):
        stepper.step(u)
    assert np.array_equal(stepper.x, at_rest(3))
