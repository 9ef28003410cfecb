# pyright: reportMissingImports=false
"""PILCO's moments are those of quadrature, its gradient is its cost's, its plant is a cart-pole; at night it learns."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import dpend

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not find_spec("jax"), reason="the example needs JAX, of the extra `jax`"),
]


@pytest.fixture(scope="module")
def pilco() -> Any:
    """Return the example; imported here, for without JAX there is nothing to import."""
    return import_module("examples.pilco")


def expectation(of: Callable[[Any], Any], mean: Any, cov: Any, nodes: int = 30) -> Any:
    """Return E[of(x)] of x ~ N(mean, cov), of rows, by Gauss and Hermite's rule in each direction."""
    places, weights = np.polynomial.hermite_e.hermegauss(nodes)
    grid = np.stack([each.ravel() for each in np.meshgrid(*[places] * len(mean))], axis=1)
    mass = np.prod(np.stack([each.ravel() for each in np.meshgrid(*[weights] * len(mean))]), axis=0)
    return np.tensordot(mass / mass.sum(), of(mean + grid @ np.linalg.cholesky(cov).T), axes=1)


def test_mean_covariance_and_slope_of_a_process_are_those_of_quadrature(pilco: Any) -> None:
    import jax.numpy as jnp

    rng = np.random.default_rng(0)
    inputs, targets = rng.standard_normal((12, 2)), rng.standard_normal((12, 3))
    scales, amplitudes = rng.uniform(0.8, 1.5, (3, 2)), rng.uniform(0.5, 1.5, 3)
    apart = (inputs[:, None] - inputs) / scales[:, None, None]
    kernel = amplitudes[:, None, None] ** 2 * np.exp(-0.5 * np.sum(apart**2, axis=-1)) + 0.1 * np.eye(12)
    weights = np.linalg.solve(kernel, targets.T[..., None])[..., 0]
    process = pilco.Process(inputs, weights, np.linalg.inv(kernel), scales, amplitudes)
    mean, cov = np.array([0.3, -0.2]), np.array([[0.3, 0.1], [0.1, 0.2]])

    def kernels(x: Any) -> Any:  # (m, E, n)
        apart = (x[:, None, None] - process.inputs) / process.scales[:, None]
        return process.amplitudes[:, None] ** 2 * np.exp(-0.5 * np.sum(apart**2, axis=-1))

    def means(x: Any) -> Any:
        return np.einsum("men,en->me", kernels(x), process.weights)

    def variances(x: Any) -> Any:
        return process.amplitudes**2 - np.einsum("men,enk,mek->me", kernels(x), process.inverse, kernels(x))

    middle = expectation(means, mean, cov)
    squares = expectation(lambda x: means(x)[:, :, None] * means(x)[:, None], mean, cov)
    across = expectation(lambda x: (x - mean)[:, :, None] * means(x)[:, None], mean, cov)
    found, spread, slope = pilco.moments(pilco.Process(*map(jnp.asarray, process)), mean, cov)
    np.testing.assert_allclose(found, middle, rtol=1e-6)
    np.testing.assert_allclose(cov @ slope, across, rtol=1e-6, atol=1e-8)
    own = np.diag(expectation(variances, mean, cov))
    expected = squares - np.outer(middle, middle) + own
    np.testing.assert_allclose(pilco.with_process_variance(process, spread), expected, rtol=1e-6, atol=1e-8)


def test_moments_of_an_angle_and_of_the_saturation_are_those_of_quadrature(pilco: Any) -> None:
    rng = np.random.default_rng(1)
    mean, half = np.array([0.1, 2.0, -0.3, 0.4]), 0.4 * rng.standard_normal((4, 4))
    cov = half @ half.T

    def whole(x: Any) -> Any:
        return np.column_stack([x, np.sin(x[:, 1]), np.cos(x[:, 1])])

    middle = expectation(whole, mean, cov, nodes=14)
    squares = expectation(lambda x: whole(x)[:, :, None] * whole(x)[:, None], mean, cov, nodes=14)
    found, spread = pilco.with_angle(mean, cov)
    np.testing.assert_allclose(found, middle, atol=1e-9)
    np.testing.assert_allclose(spread, squares - np.outer(middle, middle), atol=1e-9)

    def saturation(x: Any) -> Any:
        return pilco.FORCE * (9 * np.sin(x[:, 0]) + np.sin(3 * x[:, 0])) / 8

    at, variance = np.array([0.7]), np.array([[0.5]])
    value, own, slope = pilco.saturated(at[0], variance[0, 0])
    expected = expectation(saturation, at, variance)
    np.testing.assert_allclose(value, expected)
    np.testing.assert_allclose(own, expectation(lambda x: saturation(x) ** 2, at, variance) - expected**2)
    across = expectation(lambda x: (x[:, 0] - at[0]) * saturation(x), at, variance)
    np.testing.assert_allclose(slope * variance[0, 0], across)


def test_the_gradient_of_the_expected_cost_is_that_of_differences(pilco: Any) -> None:
    import jax
    from jax.flatten_util import ravel_pytree

    rng = np.random.default_rng(2)
    run = pilco.trial(lambda t, x: float(rng.uniform(-10, 10)), rng)
    model = pilco.fit(*pilco.transitions(run))
    policy = pilco.Policy(rng.standard_normal((3, 5)), rng.standard_normal(3), np.zeros(5))
    flat, whole = ravel_pytree(policy)
    cost = jax.jit(jax.value_and_grad(lambda flat: pilco.expected_cost(whole(flat), model)))
    along, step = rng.standard_normal(len(flat)), 1e-5
    value, slope = cost(flat)
    assert 0.9 < value < 1
    difference = (cost(flat + step * along)[0] - cost(flat - step * along)[0]) / (2 * step)
    np.testing.assert_allclose(slope @ along, difference, rtol=1e-3)


def test_the_double_pendulum_whose_second_link_weighs_nothing_moves_as_a_single_one(pilco: Any) -> None:
    rig = pilco.RIG.replace(sensor_noise=0.0, substeps=100)
    p, force = rig.params, 3.0
    half = p.mass1 * p.length1 / 2

    def rates(t: float, x: Any) -> Any:
        mass = np.array(
            [[p.cart_mass + p.mass1, half * np.cos(x[1])], [half * np.cos(x[1]), p.mass1 * p.length1**2 / 3]]
        )
        push = [force - p.cart_friction * x[2] + half * x[3] ** 2 * np.sin(x[1]), p.gravity * half * np.sin(x[1])]
        return [*x[2:], *np.linalg.solve(mass, push)]

    run = dpend.simulate(rig, lambda t, x: force, [0, 2.0, 1.0, 0, 0, 0], 2.0, task=None)
    alone = solve_ivp(rates, (0, 2.0), [0, 2.0, 0, 0], t_eval=run.t, rtol=1e-10, atol=1e-10).y.T
    np.testing.assert_allclose(run.x[:, [0, 1, 3, 4]], alone, atol=3e-4)


def test_the_command_line_refuses_no_trials(pilco: Any) -> None:
    with pytest.raises(SystemExit, match="2"):
        pilco.main(["--trials", "0"])


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(3))
def test_within_ten_trials_pilco_swings_up_the_single_pendulum(pilco: Any, seed: int) -> None:
    assert any(pilco.stands(run) for _, run in pilco.learn(pilco.Options(trials=10, seed=seed)))
