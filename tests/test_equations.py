"""The equations of motion are right, in every kind of number."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import casadi
import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from numpy.typing import NDArray
from rigs import endless, forces, plants, random_forces, random_params, random_states, row, states, whole
from scipy.linalg import eigh

import dpend
from dpend import EQUILIBRIA, Params, Stepper, equations, kernels, symbolic
from dpend.params import Array, Coefficients

MIRROR = -np.ones(6)


# ---------------------------------------------------------------------------------------------- energies and positions


def moving(x: Array) -> NDArray[np.complex128]:
    """Return the state with its positions moved an imaginary instant ahead, so that imaginary parts are velocities."""
    ahead = x.astype(complex)
    ahead[:3] += 1e-30j * x[3:]
    return ahead


def energies_of_points(x: Array, params: Params, points: list[tuple[Any, Any, Any]]) -> tuple[float, float]:
    """Sum the energies of the cart and of points, each a mass with its place ``(x, y)`` moved an imaginary instant."""
    kinetic, potential = 0.5 * params.cart_mass * x[3] ** 2, 0.0
    for mass, across, up in points:
        kinetic += 0.5 * mass * ((across.imag / 1e-30) ** 2 + (up.imag / 1e-30) ** 2)
        potential += mass * params.gravity * up.real
    return float(kinetic), float(potential)


@given(plants(rods=True), states())
def test_rods_are_lines_of_mass(params: Params, x: Array) -> None:
    at = dpend.positions(moving(x), params)
    cart = moving(x)[0]
    nodes, weights = np.polynomial.legendre.leggauss(3)  # exact: the integrands are parabolas along the rod
    points = []
    for share, weight in zip((nodes + 1) / 2, weights / 2, strict=True):
        points.append((params.mass1 * weight, cart + share * (at.x_joint - cart), share * at.y_joint))
        across, up = at.x_joint + share * (at.x_tip - at.x_joint), at.y_joint + share * (at.y_tip - at.y_joint)
        points.append((params.mass2 * weight, across, up))
    assert_allclose(dpend.energies(x, params), energies_of_points(x, params, points), rtol=1e-12, atol=1e-12)


@given(plants(), states())
def test_a_link_is_any_two_points_with_its_mass_centre_and_inertia(params: Params, x: Array) -> None:
    at = dpend.positions(moving(x), params)
    cart = moving(x)[0]
    (com1, com2), (inertia1, inertia2) = params.centers, params.inertias
    points = []
    for sign in (-1, 1):
        share = (com1 + sign * np.sqrt(inertia1 / params.mass1)) / params.length1
        points.append((params.mass1 / 2, cart + share * (at.x_joint - cart), share * at.y_joint))
        share = (com2 + sign * np.sqrt(inertia2 / params.mass2)) / params.length2
        across, up = at.x_joint + share * (at.x_tip - at.x_joint), at.y_joint + share * (at.y_tip - at.y_joint)
        points.append((params.mass2 / 2, across, up))
    assert_allclose(dpend.energies(x, params), energies_of_points(x, params, points), rtol=1e-12, atol=1e-12)


def test_total_energy_is_kinetic_plus_potential() -> None:
    rng = np.random.default_rng(1)
    energies = dpend.energies(random_states(rng, 5), random_params(rng, 5))
    assert_allclose(energies.total, energies.kinetic + energies.potential, rtol=0, atol=0)


@given(plants(), states())
def test_links_keep_their_lengths_and_lean_to_the_positive_side(params: Any, x: Array) -> None:
    at = dpend.positions(x, params)
    assert_allclose(np.hypot(at.x_joint - x[0], at.y_joint), params.length1, rtol=1e-12)
    assert_allclose(np.hypot(at.x_tip - at.x_joint, at.y_tip - at.y_joint), params.length2, rtol=1e-12)
    upright = dpend.positions(EQUILIBRIA["up-up"], params)
    assert_allclose(upright, [0, params.length1, 0, params.length1 + params.length2], rtol=1e-12)
    leaning = dpend.positions([0, np.pi / 6, np.pi / 2, 0, 0, 0], params)
    assert_allclose(leaning.x_joint, params.length1 / 2, rtol=1e-12)
    assert_allclose(leaning.x_tip, params.length1 / 2 + params.length2, rtol=1e-12)


# -------------------------------------------------------------------------------------------------- Lagrange and power


def dissipation(qd: Any, c: Coefficients, sqrt: Any) -> Any:
    """Return Rayleigh's function, whose slope in the rates is the friction."""
    vel, om1, om2 = qd
    viscous = c.b0 * vel**2 + c.b1 * om1**2 + c.b2 * (om2 - om1) ** 2
    return viscous / 2 + c.coulomb * sqrt(vel**2 + c.coulomb_speed**2)


@cache
def lagrange() -> Any:
    """Return left minus right side of Lagrange's equations, and the largest of their terms, from the energies alone."""
    q, qd, qdd, f = (casadi.SX.sym(name, 3) for name in ("q", "qd", "qdd", "f"))
    coefficients = casadi.SX.sym("c", len(Coefficients._fields))
    c = Coefficients(*casadi.vertsplit(coefficients))
    kinetic, potential = equations.make_energies(casadi.cos)((*casadi.vertsplit(q), *casadi.vertsplit(qd)), c)
    momentum = casadi.gradient(kinetic, qd)
    terms = [
        casadi.jacobian(momentum, qd) @ qdd,
        casadi.jacobian(momentum, q) @ qd,
        -casadi.gradient(kinetic, q),
        casadi.gradient(potential, q),
        casadi.gradient(dissipation(casadi.vertsplit(qd), c, casadi.sqrt), qd),
        -f,
    ]
    largest = casadi.mmax(casadi.fabs(casadi.vertcat(*terms)))
    return casadi.Function("lagrange", [q, qd, qdd, f, coefficients], [sum(terms[1:], terms[0]), largest])


@given(plants(), states(), forces())
def test_rates_obey_lagranges_equations(params: Params, x: Array, f: Array) -> None:
    rates = dpend.rates(x, f, params)
    assert_allclose(rates[:3], x[3:], rtol=0, atol=0)
    residual, largest = lagrange()(x[:3], x[3:], rates[3:], f, list(params.coefficients()))
    assert np.abs(residual.full()).max() <= 1e-12 * (1 + float(largest))


@given(plants(), states(), forces())
def test_energy_changes_by_the_power_put_in_less_the_power_of_friction(params: Params, x: Array, f: Array) -> None:
    rates = dpend.rates(x, f, params)
    change = dpend.energies(x + 1e-30j * rates, params).total.imag / 1e-30
    vel, om1, om2 = x[3:]
    power_in = f @ x[3:]
    lost = params.cart_friction * vel**2 + params.joint1_friction * om1**2 + params.joint2_friction * (om2 - om1) ** 2
    lost += params.cart_coulomb * vel**2 / np.hypot(vel, params.coulomb_speed)
    scale = 1 + abs(power_in) + lost + np.abs(rates).max() * (1 + np.abs(x).max())
    assert abs(change - (power_in - lost)) < 1e-12 * scale


@given(plants(), states())
def test_friction_never_adds_energy(params: Params, x: Array) -> None:
    rates = dpend.rates(x, 0.0, params)
    change = dpend.energies(x + 1e-30j * rates, params).total.imag / 1e-30
    assert change <= 1e-12 * (1 + np.abs(rates).max()) * (1 + np.abs(x).max())


def test_coulomb_friction_opposes_the_cart_with_its_full_force_once_it_moves() -> None:
    params = random_params(np.random.default_rng(2), friction=False)
    rubbed = replace(params, cart_coulomb=3.0, coulomb_speed=1e-4)
    for vel in (-1.0, 1.0):
        x = np.array([0.0, 0.3, -0.2, vel, 0.5, 0.1])
        assert_allclose(dpend.rates(x, 0.0, rubbed), dpend.rates(x, -3.0 * np.sign(vel), params), rtol=1e-6)
    resting = np.array([0.0, 0.3, -0.2, 0.0, 0.5, 0.1])
    assert_allclose(dpend.rates(resting, 0.0, rubbed), dpend.rates(resting, 0.0, params), rtol=1e-14)


def test_friction_of_joint_2_vanishes_when_the_links_turn_together() -> None:
    params = random_params(np.random.default_rng(3), friction=False)
    stiff = replace(params, joint2_friction=0.7)
    together = np.array([0.0, 0.3, -0.2, 0.4, 1.5, 1.5])
    assert_allclose(dpend.rates(together, 0.0, stiff), dpend.rates(together, 0.0, params), rtol=1e-14)
    apart = np.array([0.0, 0.3, -0.2, 0.4, 1.5, -1.5])
    torque = 0.7 * 3.0  # the faster link is held back, the slower one taken along, by the same torque
    assert_allclose(
        dpend.rates(apart, 0.0, stiff), dpend.rates(apart, np.array([0.0, -torque, torque]), params), rtol=1e-12
    )


@given(plants(friction=False), st.floats(0.5, 50.0), st.floats(0.0, 100.0), st.floats(0.0, 20.0), st.floats(0.1, 1.0))
@settings(max_examples=50, deadline=None)
def test_energy_never_rises_under_friction_however_stiff(
    params: Params, coulomb: float, viscous: float, joint: float, speed: float
) -> None:
    params = replace(params, cart_coulomb=coulomb, cart_friction=viscous, joint2_friction=joint)
    stepper = Stepper(endless(params=params, sample_time=0.02, substeps=2), 1)
    stepper.reset([0, np.pi, np.pi, speed, 0, 0])
    total = [dpend.energies(stepper.x[0], params).total]
    for _ in range(150):
        stepper.step(np.zeros(1))
        total.append(dpend.energies(stepper.x[0], params).total)
    assert np.diff(total).max() <= 1e-5 * speed**2


@pytest.mark.parametrize("name", ["gustafsson2016", "pilco2011"])
def test_a_cart_with_coulomb_friction_comes_to_rest(name: str) -> None:
    stepper = Stepper(endless(name, cart_coulomb=5.0, joint1_friction=1.0, joint2_friction=1.0, sensor_noise=0.0), 1)
    stepper.reset([0, np.pi + 0.5, np.pi, 1.0, 0, 0])
    for _ in range(round(40 / stepper.rig.sample_time)):
        stepper.step(np.zeros(1))
    assert np.abs(stepper.x[0, 3:]).max() < 1e-3


def test_energy_is_conserved_without_friction() -> None:
    rng = np.random.default_rng(4)
    n = 16
    params = random_params(rng, n, friction=False)
    stepper = Stepper(endless(params=params, sample_time=0.05, substeps=100), n)
    stepper.reset(random_states(rng, n))
    before = dpend.energies(stepper.x, params).total
    for _ in range(60):
        stepper.step(np.zeros(n))
    scale = np.maximum(np.abs(before), params.coefficients().f1)
    assert_allclose(dpend.energies(stepper.x, params).total / scale, before / scale, rtol=0, atol=1e-7)


def test_momentum_along_the_track_is_conserved_without_force_and_friction() -> None:
    rng = np.random.default_rng(5)
    n = 16
    params = random_params(rng, n, friction=False)
    c = params.coefficients()

    def momentum(x: Array) -> Array:
        return c.d1 * x[:, 3] + c.d2 * np.cos(x[:, 1]) * x[:, 4] + c.d3 * np.cos(x[:, 2]) * x[:, 5]

    stepper = Stepper(endless(params=params, sample_time=0.05, substeps=100), n)
    stepper.reset(random_states(rng, n))
    before = momentum(stepper.x)
    for _ in range(60):
        stepper.step(np.zeros(n))
    assert_allclose(momentum(stepper.x), before, rtol=0, atol=1e-7 * np.abs(before).max())


def test_friction_at_every_joint_brings_the_plant_to_rest_hanging() -> None:
    params = replace(random_params(np.random.default_rng(6)), cart_friction=2.0, joint1_friction=1.0, joint2_friction=1)
    stepper = Stepper(endless(params=params, sample_time=0.05, substeps=20), 1)
    stepper.reset([0.0, 2.0, 2.5, 0.0, 0.0, 0.0])
    for _ in range(2000):
        stepper.step(np.zeros(1))
    assert_allclose(stepper.x[0, 1:], EQUILIBRIA["down-down"][1:], atol=1e-6)


# -------------------------------------------------------------------------------------------------------- special cases


def test_a_rod_on_a_heavy_cart_falls_as_a_rod_on_a_pivot() -> None:
    length, gravity = 0.8, 9.81
    params = Params(cart_mass=1e12, mass1=0.4, mass2=1e-12, length1=length, length2=0.5, gravity=gravity)
    for th1 in np.linspace(-3, 3, 13):
        _, om1, _, _, al1, _ = dpend.rates([0.0, th1, 0.0, 0.0, 0.7, 0.0], 0.0, params)
        assert om1 == 0.7
        assert_allclose(al1, 1.5 * gravity / length * np.sin(th1), rtol=1e-9, atol=1e-9)


def test_a_rod_hung_on_the_tip_of_a_driven_link_is_shaken_by_the_tips_acceleration() -> None:
    # With an immovable cart and a first link of huge inertia turning at a constant rate, link 2 is a driven pendulum.
    length1, length2, rate = 0.6, 0.9, 2.0
    params = Params(cart_mass=1e14, mass1=1.0, mass2=0.3, length1=length1, length2=length2, inertia1=1e14)
    for th1, th2 in ((0.3, -0.4), (1.2, 2.0), (-2.0, 0.5)):
        al2 = dpend.rates([0.0, th1, th2, 0.0, rate, 0.3], 0.0, params)[5]
        across, up = -length1 * rate**2 * np.sin(th1), -length1 * rate**2 * np.cos(th1)  # towards the pivot
        expected = 1.5 / length2 * ((params.gravity + up) * np.sin(th2) - across * np.cos(th2))
        assert_allclose(al2, expected, rtol=1e-9)


def hanging_modes(params: Params) -> tuple[Array, Array]:
    r"""Solve :math:`K v = \omega^2 M v` of the hanging plant, its masses and stiffnesses written out."""
    p: Any = params
    (l1, l2), (i1, i2) = p.centers, p.inertias
    across1 = -(p.mass1 * l1 + p.mass2 * p.length1)  # hanging, a positive angle moves the link to the negative side
    across2 = -p.mass2 * l2
    M = np.array(
        [
            [p.cart_mass + p.mass1 + p.mass2, across1, across2],
            [across1, p.mass1 * l1**2 + p.mass2 * p.length1**2 + i1, p.mass2 * p.length1 * l2],
            [across2, p.mass2 * p.length1 * l2, p.mass2 * l2**2 + i2],
        ]
    )
    K = np.diag([0.0, -across1 * p.gravity, -across2 * p.gravity])
    return eigh(K, M)


@pytest.mark.parametrize("seed", range(5))
def test_the_hanging_plant_swings_at_its_natural_frequencies(seed: int) -> None:
    params = random_params(np.random.default_rng(seed), friction=False)
    squared, shapes = hanging_modes(params)
    assert abs(squared[0]) < 1e-9 * squared[2]  # the cart may be anywhere
    rig = endless(params=params, sample_time=0.01, substeps=4)
    hanging = EQUILIBRIA["down-down"]
    for mode in (1, 2):
        amplitude = 1e-6 * shapes[:, mode] / np.abs(shapes[:, mode]).max()
        stepper = Stepper(rig, 1)
        stepper.reset(hanging + np.concatenate([amplitude, np.zeros(3)]))
        for k in range(1, 201):
            stepper.step(np.zeros(1))
            swung = amplitude * np.cos(np.sqrt(squared[mode]) * k * rig.sample_time)
            assert_allclose(stepper.x[0, :3] - hanging[:3], swung, rtol=0, atol=1e-10)


# ----------------------------------------------------------------------------------------------------------- symmetries


@given(plants(), states(), forces())
def test_the_rates_do_not_depend_on_where_the_cart_stands(params: Params, x: Array, f: Array) -> None:
    moved = x + np.array([17.0, 0, 0, 0, 0, 0])
    assert np.array_equal(dpend.rates(moved, f, params), dpend.rates(x, f, params))


@given(plants(), states(), forces())
def test_the_mirrored_plant_moves_as_the_plant_mirrored(params: Params, x: Array, f: Array) -> None:
    assert np.array_equal(dpend.rates(MIRROR * x, -f, params), MIRROR * dpend.rates(x, f, params))


@given(plants(), states(), forces())
def test_a_whole_turn_of_a_link_changes_nothing(params: Params, x: Array, f: Array) -> None:
    still = dpend.rates(x, f, params)
    for turn in ([0, 2 * np.pi, 0, 0, 0, 0], [0, 0, -2 * np.pi, 0, 0, 0]):
        assert_allclose(
            dpend.rates(x + np.array(turn), f, params), still, rtol=0, atol=1e-11 * (1 + np.abs(still).max())
        )


@given(plants(friction=False), states(), forces())
def test_without_friction_the_plant_runs_backwards_too(params: Params, x: Array, f: Array) -> None:
    backwards = np.array([1, 1, 1, -1, -1, -1])
    assert_allclose(dpend.rates(backwards * x, f, params), -backwards * dpend.rates(x, f, params), rtol=1e-14)


@given(plants())
def test_the_equilibria_stay_where_they_are(params: Params) -> None:
    for x in EQUILIBRIA.values():
        assert_allclose(dpend.rates(x, 0.0, params), 0, atol=1e-12)


# ----------------------------------------------------------------------------------------------------- kinds of numbers


def close(actual: Any, expected: Any) -> None:
    """Hold two back-ends to 1e-12, relative to the largest number."""
    expected = np.asarray(expected)
    assert_allclose(actual, expected, rtol=0, atol=1e-12 * (1 + np.abs(expected).max()))


@given(plants(), states(), forces())
def test_numpy_numba_and_casadi_give_the_same_rates(params: Params, x: Array, f: Array) -> None:
    expected = dpend.rates(x, f, params)
    close(kernels.rates(tuple(x), tuple(f), params.coefficients()), expected)
    close(np.array(symbolic.rates_function(params)(x, f)).ravel(), expected)


@pytest.mark.slow
@given(plants(), states(), forces())
def test_numpy_and_numba_give_the_same_rates_of_complex_numbers(params: Params, x: Array, f: Array) -> None:
    rng = np.random.default_rng(7)
    z = x + 0.1j * rng.standard_normal(6)
    force = f + 0.1j * rng.standard_normal(3)
    close(kernels.rates(tuple(z), tuple(force), params.coefficients()), dpend.rates(z, force, params))


@pytest.mark.slow
def test_numba_differentiates_by_the_complex_step_as_numpy_does() -> None:
    rng = np.random.default_rng(8)
    for x, f in zip(random_states(rng, 20), random_forces(rng, 20), strict=True):
        params = random_params(rng)
        A, _ = dpend.linearize(params, x, f[0])
        for column, direction in enumerate(np.eye(6)):
            moved = kernels.rates(tuple(x + 1e-30j * direction), (f[0] + 0j, 0j, 0j), params.coefficients())
            close(np.imag(moved) / 1e-30, A[:, column])


_numpy_rk4 = equations.make_rk4(equations.make_rates(np.sin, np.cos))


@given(plants(), states(), forces())
def test_numpy_numba_and_casadi_take_the_same_runge_kutta_step(params: Params, x: Array, f: Array) -> None:
    c = params.coefficients()
    expected = _numpy_rk4(x, f, c, 0.01)
    close(kernels.rk4(tuple(x), tuple(f), c, 0.01), expected)
    batch = x[None].copy()
    kernels.plant_step(batch, f[:, None], np.array([c]).T, 0.01, 1)
    close(batch[0], expected)
    rig = endless(params=params, sample_time=0.03, substeps=3)
    sample: Any = tuple(x)
    for _ in range(3):
        sample = _numpy_rk4(sample, (f[0], 0.0, 0.0), c, 0.01)
    close(np.array(symbolic.sample_function(rig)(x, f[0])).ravel(), sample)


def test_the_batched_and_the_scalar_kernel_take_the_same_sample() -> None:
    rng = np.random.default_rng(9)
    n = 600  # more than two blocks, and a part of one
    params = random_params(rng, n)
    x, f = random_states(rng, n), random_forces(rng, n)
    each, shared = x.copy(), x.copy()
    kernels.plant_step(each, f.T, np.stack(params.coefficients()), 0.005, 3)
    kernels.plant_step(shared, f.T, np.array([row(params, 0).coefficients()]).T, 0.005, 3)

    @numba.njit
    def sample(x, f, c):
        return kernels.sample(x, f, c, 0.005, 3)

    for i in (*range(0, n, 7), n - 1):
        close(each[i], sample(tuple(x[i]), tuple(f[i]), row(params, i).coefficients()))
        close(shared[i], sample(tuple(x[i]), tuple(f[i]), row(params, 0).coefficients()))


# ------------------------------------------------------------------------------------------------------------- accuracy


@numba.njit
def _sines_and_cosines(angles):
    out = np.empty((2, len(angles)))
    for i in range(len(angles)):
        out[0, i] = kernels.sin(angles[i])
        out[1, i] = kernels.cos(angles[i])
    return out


def test_sine_and_cosine_err_by_less_than_5e_16_up_to_an_angle_of_30() -> None:
    quarter_turns = np.arange(-19, 20) * np.pi / 2
    near = (
        quarter_turns[:, None] + np.concatenate([-np.geomspace(1e-17, 1e-1, 50), np.geomspace(1e-17, 1e-1, 50)])
    ).ravel()
    angles = np.concatenate([np.linspace(-30, 30, 200_001), near, quarter_turns])
    wide = angles.astype(np.longdouble)
    error = _sines_and_cosines(angles) - np.stack([np.sin(wide), np.cos(wide)])
    assert np.abs(error).max() < 5e-16


def test_sine_and_cosine_err_by_less_than_4e_16_up_to_an_angle_of_100_000() -> None:
    angles = np.random.default_rng(13).uniform(-1e5, 1e5, 200_000)
    wide = angles.astype(np.longdouble)
    error = _sines_and_cosines(angles) - np.stack([np.sin(wide), np.cos(wide)])
    assert np.abs(error).max() < 4e-16


def test_sine_near_a_whole_number_of_half_turns_is_as_exact_as_any_other() -> None:
    angles = np.arange(1, 1000) * np.pi
    assert_allclose(_sines_and_cosines(angles)[0], np.sin(angles), rtol=1e-9)  # each about 1e-16


def test_sine_and_cosine_of_what_is_no_angle_are_nan() -> None:
    assert np.isnan(_sines_and_cosines(np.array([np.nan, np.inf, -np.inf]))).all()


def test_without_coulomb_friction_a_step_has_the_same_bits_as_where_each_row_might_have_some() -> None:
    rng = np.random.default_rng(12)
    c = np.array([random_params(rng).coefficients()._replace(coulomb=0.0)], dtype=float).T
    x, f = random_states(rng, 300), random_forces(rng, 300)
    shared, own = x.copy(), x.copy()
    kernels.plant_step(shared, f.T, c, 0.01, 3)
    kernels.plant_step(own, f.T, np.repeat(c, 300, axis=1), 0.01, 3)
    np.testing.assert_array_equal(shared, own)


@pytest.mark.parametrize("own", [False, True], ids=["one plant for all", "one plant a row"])
def test_a_state_that_is_nan_stays_nan_and_leaves_its_neighbours_alone(own: bool) -> None:
    rng = np.random.default_rng(10)
    n = 40
    params = random_params(rng, n if own else None)
    coefficients = np.stack(np.atleast_1d(*params.coefficients()))
    clean = random_states(rng, n)
    f = np.zeros((3, n))
    for column in range(1, 6):
        x = clean.copy()
        x[13, column] = np.nan
        expected = clean.copy()
        kernels.plant_step(expected, f, coefficients, 0.01, 3)
        kernels.plant_step(x, f, coefficients, 0.01, 3)
        assert np.isnan(x[13, 3:]).all()
        others = np.arange(n) != 13
        assert np.array_equal(x[others], expected[others])


def test_runge_kutta_has_order_4() -> None:
    rng = np.random.default_rng(11)
    params = random_params(rng)
    x0 = np.array([0.1, 0.4, -0.7, 0.2, 1.0, -2.0])
    u = np.array([8.0, -5.0, 3.0, 10.0])
    T = 0.1
    exact = dpend.reference(params, x0, u, T * np.arange(len(u) + 1))[-1]
    substeps = np.array([2, 4, 8, 16, 32])
    errors = []
    for count in substeps:
        stepper = Stepper(endless(params=params, sample_time=T, substeps=int(count)), 1)
        stepper.reset(x0)
        for force in u:
            stepper.step([force])
        errors.append(np.abs(stepper.x[0] - exact).max())
    order = -np.polyfit(np.log(substeps), np.log(errors), 1)[0]
    assert 3.8 < order < 4.3


def test_the_reference_takes_generalised_forces_and_refuses_another_number_of_them() -> None:
    params = random_params(np.random.default_rng(12))
    f = np.array([[1.0, 0.2, -0.1]])
    end = dpend.reference(params, np.zeros(6), f, [0.0, 0.05])[-1]
    steps: Any = tuple(np.zeros(6))
    for _ in range(50):
        steps = _numpy_rk4(steps, f[0], params.coefficients(), 0.001)
    assert_allclose(end, steps, rtol=0, atol=1e-11)
    with pytest.raises(ValueError, match=whole("Expected one force, or three, for each of 2 intervals; got (1,).")):
        dpend.reference(params, np.zeros(6), [1.0], [0.0, 0.1, 0.2])


# --------------------------------------------------------------------------------------------------------------- shapes


def test_rates_of_a_batch_are_the_rates_of_its_states() -> None:
    rng = np.random.default_rng(13)
    params = random_params(rng)
    x = random_states(rng, 12).reshape(3, 4, 6)
    f = random_forces(rng, 12).reshape(3, 4, 3)
    u = f[..., 0]
    for i in range(3):
        for j in range(4):
            close(dpend.rates(x, f, params)[i, j], dpend.rates(x[i, j], f[i, j], params))
            close(dpend.rates(x, u, params)[i, j], dpend.rates(x[i, j], [u[i, j], 0.0, 0.0], params))
            close(dpend.rates(x, u[0], params)[i, j], dpend.rates(x[i, j], u[0, j], params))
            close(dpend.rates(x, 2.0, params)[i, j], dpend.rates(x[i, j], 2.0, params))
    one = dpend.rates(x[0, 0], u, params)  # one state under many forces
    assert one.shape == (3, 4, 6)
    close(one[2, 1], dpend.rates(x[0, 0], u[2, 1], params))
    three = dpend.rates(x[:, 0], np.array([1.0, 2.0, 3.0]), params)  # three forces for three states
    close(three[1], dpend.rates(x[1, 0], 2.0, params))


def test_a_batch_of_plants_has_one_plant_a_row() -> None:
    rng = np.random.default_rng(14)
    params = random_params(rng, 5)
    x, f = random_states(rng, 5), random_forces(rng, 5)
    for i in range(5):
        close(dpend.rates(x, f, params)[i], dpend.rates(x[i], f[i], row(params, i)))
        close(dpend.energies(x, params).kinetic[i], dpend.energies(x[i], row(params, i)).kinetic)
        close(dpend.positions(x, params).x_tip[i], dpend.positions(x[i], row(params, i)).x_tip)


@pytest.mark.parametrize("shape", [(5,), (6, 5), ()])
def test_what_is_no_state_is_refused(shape: tuple[int, ...]) -> None:
    params = random_params(np.random.default_rng(15))
    message = f"A state has six numbers: expected an array of shape (..., 6); got shape {shape}."
    for function in (lambda x: dpend.rates(x, 0.0, params), lambda x: dpend.energies(x, params)):
        with pytest.raises(ValueError, match=whole(message)):
            function(np.zeros(shape))


def test_a_column_of_forces_is_refused() -> None:
    message = "Expected forces on the cart of shape (4,), or generalised forces of shape (4, 3); got shape (4, 1)."
    with pytest.raises(ValueError, match=whole(message)):
        dpend.rates(np.zeros((4, 6)), np.zeros((4, 1)), dpend.rig("gustafsson2016").params)


# ------------------------------------------------------------------------------------------------------------ odd input

UP = np.zeros(6)
PLANT = dpend.rig("gustafsson2016").params
ODD = ["abc", ["a"] * 6, [[1, 2], [3]], None, np.datetime64("2020-01-01"), [None] * 6, {}, b"x", [True] * 6]
CALLS: dict[str, Callable[[Any], object]] = {
    "states of rates": lambda odd: dpend.rates(odd, 0.0, PLANT),
    "forces of rates": lambda odd: dpend.rates(UP, odd, PLANT),
    "plant of rates": lambda odd: dpend.rates(UP, 0.0, odd),
    "states of positions": lambda odd: dpend.positions(odd, PLANT),
    "plant of positions": lambda odd: dpend.positions(UP, odd),
    "states of energies": lambda odd: dpend.energies(odd, PLANT),
    "plant of energies": lambda odd: dpend.energies(UP, odd),
    "force of linearize": lambda odd: dpend.linearize(PLANT, UP, odd),
    "matrix A": lambda odd: dpend.discretize(odd, UP[:, None], 0.1),
    "matrix B": lambda odd: dpend.discretize(np.eye(6), odd, 0.1),
    "sample time": lambda odd: dpend.discretize(np.eye(6), UP[:, None], odd),
    "start of the reference": lambda odd: dpend.reference(PLANT, odd, [0.0], [0.0, 0.1]),
    "forces of the reference": lambda odd: dpend.reference(PLANT, UP, odd, [0.0, 0.1]),
    "times of the reference": lambda odd: dpend.reference(PLANT, UP, [0.0], odd),
    "tolerance of the reference": lambda odd: dpend.reference(PLANT, UP, [0.0], [0.0, 0.1], rtol=odd),
}


@pytest.mark.parametrize("call", CALLS.values(), ids=CALLS)
@pytest.mark.parametrize("odd", ODD, ids=repr)
def test_what_is_no_number_is_refused_by_the_function_that_was_called(call: Callable[[Any], object], odd: Any) -> None:
    with pytest.raises((TypeError, ValueError)) as refusal:
        call(odd)
    assert "/dpend/" in str(refusal.traceback[-1].path)


def test_refusals_say_what_was_expected_and_what_came() -> None:
    message = "x must be numbers: states (..., 6); got ['a', 'b']."
    with pytest.raises(TypeError, match=whole(message)):
        dpend.rates(["a", "b"], 0.0, PLANT)
    with pytest.raises(TypeError, match=whole("rates takes dpend.Params, such as rig.params; got Rig.")):
        dpend.rates(UP, 0.0, dpend.rig("gustafsson2016"))  # pyright: ignore[reportArgumentType]
    message = "States of shape (4, 6) and forces of shape (3,) do not broadcast for one plant."
    with pytest.raises(ValueError, match=whole(message)):
        dpend.rates(np.zeros((4, 6)), np.zeros(3), PLANT)
    message = "States of shape (4, 6) do not broadcast for 2 plants."
    with pytest.raises(ValueError, match=whole(message)):
        dpend.energies(np.zeros((4, 6)), replace(PLANT, mass1=np.array([1.0, 2.0])))


@pytest.mark.parametrize(
    ("x0", "u", "t", "message"),
    [
        (UP, [np.nan], [0, 1], "u must be finite: one force, or three, for each interval; got [nan]."),
        ([0, np.inf, 0, 0, 0, 0], [0], [0, 1], "States must be finite; got inf for th1 in row 0."),
        (UP[:4], [0.0], [0, 1], "x0 must be one state of shape (6,); got shape (4,)."),
        (UP, [0.0], [1, 0], "t must be increasing times of shape (T + 1,), s; got [1, 0]."),
    ],
)
def test_the_reference_refuses_what_it_cannot_integrate(x0: Any, u: Any, t: Any, message: str) -> None:
    with pytest.raises(ValueError, match=whole(message)):
        dpend.reference(PLANT, x0, u, t)


@pytest.mark.parametrize("size", [1e6, 1e200])
def test_the_reference_does_not_chase_a_motion_beyond_reason(size: float) -> None:
    with pytest.raises(
        RuntimeError, match=r"(?s)^The reference cannot follow the motion from 0 s to 1 s, .* larger\.$"
    ):
        dpend.reference(PLANT, np.full(6, size), [0.0], [0.0, 1.0])
