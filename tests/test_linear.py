"""The linearisation is right: against exact derivatives, differences, remainders, modes and held-force solutions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi
import numpy as np
import pytest
from hypothesis import given
from numpy.testing import assert_allclose
from rigs import plants, random_params, random_states, states, whole
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete

import dpend
from dpend import EQUILIBRIA, Params, discretize, linearize, symbolic
from dpend.params import Array


def casadi_jacobians(params: Params) -> Any:
    """Return the exact Jacobians in state and cart force, by CasADi's automatic differentiation."""
    x, f = casadi.SX.sym("x", 6), casadi.SX.sym("f", 3)
    rates = symbolic.rates_function(params)(x, f)
    return casadi.Function("jacobians", [x, f], [casadi.jacobian(rates, x), casadi.jacobian(rates, f)[:, 0]])


# -------------------------------------------------------------------------------------------------------- linearization


@given(plants(), states())
def test_linearize_gives_casadis_exact_jacobian(params: Params, x: Array) -> None:
    u = 7.0
    A, B = linearize(params, x, u)
    exact_A, exact_B = (jacobian.full() for jacobian in casadi_jacobians(params)(x, [u, 0.0, 0.0]))
    assert_allclose(A, exact_A, rtol=1e-10, atol=1e-10 * np.abs(exact_A).max())
    assert_allclose(B, exact_B, rtol=1e-10, atol=1e-10 * np.abs(exact_B).max())


@given(plants(), states())
def test_linearize_agrees_with_central_differences(params: Params, x: Array) -> None:
    u, step = -4.0, 1e-5
    A, B = linearize(params, x, u)
    ahead, behind = (dpend.rates(x + sign * step * np.eye(6), u, params) for sign in (1, -1))
    slope = (ahead - behind).T / (2 * step)
    assert_allclose(A, slope, rtol=0, atol=1e-5 * (1 + np.abs(A).max()))
    slope_in_force = (dpend.rates(x, u + 1, params) - dpend.rates(x, u - 1, params)) / 2  # linear: any step will do
    assert_allclose(B[:, 0], slope_in_force, rtol=1e-9, atol=1e-10 * (1 + np.abs(B).max()))


def remainder_order(params: Params, x: Array, u: float) -> float:
    """Fit the power of the distance with which the rates leave their linearisation."""
    A, B = linearize(params, x, u)
    rng = np.random.default_rng(0)
    towards, push = rng.standard_normal(6), rng.standard_normal()
    distances = np.geomspace(1e-3, 1e-2, 6)
    remainders = []
    for distance in distances:
        moved = dpend.rates(x + distance * towards, u + distance * push, params)
        linear = dpend.rates(x, u, params) + distance * (A @ towards + B[:, 0] * push)
        remainders.append(np.linalg.norm(moved - linear))
    return float(np.polyfit(np.log(distances), np.log(remainders), 1)[0])


@pytest.mark.parametrize("seed", range(5))
def test_the_taylor_remainder_falls_with_the_square_of_the_distance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    params = random_params(rng)
    assert 1.9 < remainder_order(params, random_states(rng, 1, scale=0.5)[0], 3.0) < 2.1


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("name", EQUILIBRIA)
def test_about_an_equilibrium_the_remainder_falls_with_the_cube_by_mirror_symmetry(name: str, seed: int) -> None:
    params = random_params(np.random.default_rng(seed))
    assert 2.9 < remainder_order(params, EQUILIBRIA[name], 0.0) < 3.1


def test_the_point_is_upright_at_rest_unless_another_is_given() -> None:
    params = random_params(np.random.default_rng(1))
    for mine, theirs in zip(linearize(params), linearize(params, EQUILIBRIA["up-up"], 0.0), strict=True):
        assert np.array_equal(mine, theirs)
    assert not np.allclose(linearize(params)[0], linearize(params, EQUILIBRIA["down-down"])[0])


def modes(params: Params, x: Array) -> Array:
    """Return the growth rates of the plant's modes at a point, from the least to the greatest."""
    return np.sort(np.linalg.eigvals(linearize(params, x)[0]).real).astype(np.float64)


@given(plants(friction=False))
def test_upright_has_two_growing_two_decaying_and_two_standing_modes(params: Params) -> None:
    growth = modes(params, EQUILIBRIA["up-up"])
    assert (growth[:2] < -0.1).all()
    assert_allclose(growth[2:4], 0, atol=1e-5)
    assert (growth[4:] > 0.1).all()
    assert_allclose(growth[4:], -growth[1::-1], rtol=1e-5)  # without friction time may run backwards


@given(plants(friction=False))
def test_with_one_link_up_one_mode_grows_and_one_decays(params: Params) -> None:
    for name in ("up-down", "down-up"):
        growth = modes(params, EQUILIBRIA[name])
        assert growth[0] < -0.1
        assert_allclose(growth[1:5], 0, atol=1e-5)
        assert growth[5] > 0.1


@given(plants())
def test_hanging_no_mode_grows(params: Params) -> None:
    assert modes(params, EQUILIBRIA["down-down"]).max() < 1e-5


@given(plants())
def test_friction_leaves_two_growing_modes_upright(params: Params) -> None:
    assert (modes(params, EQUILIBRIA["up-up"]) > 1e-5).sum() == 2


@pytest.mark.parametrize(
    ("name", "unstable"), [("gustafsson2016", [3.32, 7.67]), ("gustafsson2016_as_coded", [2.94, 5.16])]
)
def test_the_unstable_modes_of_the_reports_plant_are_those_on_record(name: str, unstable: list[float]) -> None:
    assert_allclose(modes(dpend.rig(name).params, EQUILIBRIA["up-up"])[4:], unstable, atol=0.005)


@given(plants())
def test_upright_is_controllable_from_the_cart(params: Params) -> None:
    A, B = linearize(params)
    for mode in np.linalg.eigvals(A):
        assert np.linalg.matrix_rank(np.hstack([A - mode * np.eye(6), B]), tol=1e-9) == 6


# ------------------------------------------------------------------------------------------------------- discretization


def held(A: Array, B: Array, T: float, x: Array, u: float) -> Array:
    """Solve the linear system under a held force, by an integrator."""
    solution = solve_ivp(lambda _, z: A @ z + B[:, 0] * u, (0, T), x, method="DOP853", rtol=1e-12, atol=1e-12)
    return solution.y[:, -1]


@pytest.mark.parametrize("seed", range(5))
def test_discretize_solves_the_linear_system_under_a_held_force(seed: int) -> None:
    rng = np.random.default_rng(seed)
    A, B = linearize(random_params(rng))
    T = rng.uniform(0.01, 0.1)
    Ad, Bd = discretize(A, B, T)
    x, u = rng.standard_normal(6), rng.standard_normal()
    assert_allclose(Ad @ x + Bd[:, 0] * u, held(A, B, T, x, u), rtol=1e-10, atol=1e-10)


@given(plants())
def test_discretize_agrees_with_scipys_zero_order_hold(params: Params) -> None:
    A, B = linearize(params)
    theirs: Any = cont2discrete((A, B, np.eye(6), np.zeros((6, 1))), 0.02, method="zoh")
    for mine, exact in zip(discretize(A, B, 0.02), theirs[:2], strict=True):
        assert_allclose(mine, exact, rtol=1e-12, atol=1e-13)


@given(plants())
def test_two_samples_are_one_sample_of_twice_the_length(params: Params) -> None:
    A, B = linearize(params)
    Ad, Bd = discretize(A, B, 0.03)
    twice_A, twice_B = discretize(A, B, 0.06)
    assert_allclose(twice_A, Ad @ Ad, rtol=1e-11, atol=1e-12)
    assert_allclose(twice_B, Ad @ Bd + Bd, rtol=1e-11, atol=1e-12)


def test_a_force_on_a_mere_mass_moves_it_by_half_t_squared() -> None:
    A, B = [[0.0, 1.0], [0.0, 0.0]], [[0.0], [0.5]]  # 2 kg
    Ad, Bd = discretize(A, B, 0.1)
    assert_allclose(Ad, [[1, 0.1], [0, 1]], rtol=1e-15)
    assert_allclose(Bd, [[0.1**2 / 2 / 2], [0.1 / 2]], rtol=1e-14)


def test_the_nonlinear_plant_takes_the_discretised_step_from_a_small_state() -> None:
    rng = np.random.default_rng(2)
    params = random_params(rng)
    T = 0.02
    Ad, Bd = discretize(*linearize(params), T)
    x, u = 1e-6 * rng.standard_normal(6), 1e-6
    end = dpend.reference(params, x, [u], [0.0, T], atol=1e-18)[-1]
    assert_allclose(end, Ad @ x + Bd[:, 0] * u, rtol=0, atol=1e-15)


# ------------------------------------------------------------------------------------------------------------ wrong use

_PLANT = random_params(np.random.default_rng(3))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: linearize(random_params(np.random.default_rng(4), 3)),
            "linearize takes one plant; got Params with arrays of 3 rows.",
        ),
        (lambda: linearize(_PLANT, np.zeros((2, 6))), "x must be one state of shape (6,); got shape (2, 6)."),
        (
            lambda: discretize(np.eye(6), np.zeros(6), 0.1),
            "Expected A of shape (n, n) and B of shape (n, m); got (6, 6) and (6,).",
        ),
        (
            lambda: discretize(np.zeros((6, 5)), np.zeros((6, 1)), 0.1),
            "Expected A of shape (n, n) and B of shape (n, m); got (6, 5) and (6, 1).",
        ),
        (
            lambda: discretize(np.eye(2), np.zeros((2, 1)), 0.0),
            "sample_time must be finite and greater than 0 s; got 0.0.",
        ),
        (
            lambda: discretize(np.eye(2), np.zeros((2, 1)), np.nan),
            "sample_time must be finite and greater than 0 s; got nan.",
        ),
    ],
)
def test_wrong_use_is_refused_with_what_was_expected(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=whole(message)):
        call()
