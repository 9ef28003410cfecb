"""The plant and the environment in JAX are the plant and the environment."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rigs import mutated, random_forces, random_params, random_states, whole

import dpend
from controllers import LQR
from dpend import Balance, SwingUp, equations
from dpend.rig import Rig, ideal_rig
from dpend.vector_env import CartDoublePendulumVectorEnv

jax = pytest.importorskip("jax", reason="JAX is not installed, the extra `jax`")
jnp: Any = jax.numpy
from dpend import jax_plant  # noqa: E402
from dpend.jax_plant import Environment  # noqa: E402

pytestmark = pytest.mark.slow  # most of it compiling


@pytest.fixture(autouse=True)
def _double_precision() -> Iterator[None]:
    before = jax.config.jax_enable_x64
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", before)


def test_rates_and_samples_are_those_of_python() -> None:
    rng = np.random.default_rng(16)
    params = random_params(rng, 20_000)  # a thousand times twenty
    x, f = random_states(rng, 20_000), random_forces(rng, 20_000)
    rig = Rig(params=params, sample_time=0.02, force_limit=30.0)
    stepper = dpend.Stepper(rig, len(x))
    stepper.reset(x)
    for found, expected in (
        (jax.jit(jax_plant.rates)(x, f, params.coefficients()), dpend.rates(x, f, params)),
        (jax.jit(lambda x, u: jax_plant.step(rig, x, u))(x, f[:, 0]), stepper.step(f[:, 0])),
    ):
        error = np.abs(np.asarray(found) - expected).max(axis=1) / np.abs(expected).max(axis=1)
        assert error.max() < 1e-12


def test_a_wrong_sign_in_the_equations_is_a_wrong_sign_here(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(16)
    params = random_params(rng, 1000)
    x, f = random_states(rng, 1000), random_forces(rng, 1000)
    with monkeypatch.context() as patch:
        patch.setattr(equations, "make_rates", mutated("s12 = s1 * c2 - c1 * s2", "s12 = s1 * c2 + c1 * s2"))
        found = importlib.reload(jax_plant).rates(x, f, params.coefficients())
    importlib.reload(jax_plant)
    expected = dpend.rates(x, f, params)
    assert (np.abs(np.asarray(found) - expected).max(axis=1) / np.abs(expected).max(axis=1)).max() > 0.1


def test_derivatives_of_a_sample_are_those_of_the_linearized_plant() -> None:
    rig = dpend.rig("gustafsson2016").replace(sample_time=1e-3)
    A, B = dpend.discretize(*dpend.linearize(rig.params), rig.sample_time)
    slopes = jax.jacfwd(lambda x, u: jax_plant.step(rig, x, u), (0, 1))(np.zeros(6), 0.0)
    assert_allclose(slopes[0], A, atol=1e-10)
    assert_allclose(slopes[1][:, None], B, atol=1e-10)


def test_a_closed_loop_is_that_of_the_simulator() -> None:
    rig = dpend.rig("gustafsson2016")
    lqr = LQR(rig)
    x0 = Balance(lam=0.1).starts(np.random.default_rng(0), 50, rig)
    expected = dpend.simulate_many(rig, lqr, x0, 6.0, record=True)
    x, u = jax.jit(lambda x0: jax_plant.rollout(rig, lambda t, x: -x @ lqr.K[0], x0, 300))(x0)
    assert_allclose(np.asarray(u).T, expected.u, rtol=0, atol=40 * 1e-9)
    assert_allclose(np.asarray(x).transpose(1, 0, 2), expected.x, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("task", "reward"),
    [
        (Balance(lam=0.5, steps=40), "default"),
        (Balance(lam=1.0, steps=40, criterion="report", state_weights=(1, 2, 3), failure_cost=7), "report"),
        (SwingUp(start="up-down", steps=60, hold=0.1, upright_angle=3), "default"),
        (SwingUp(start="anywhere", target="down-up", steps=60, failure_cost=3), "report"),
        (SwingUp(start="anywhere", steps=60), "default"),
    ],
)
def test_the_environment_is_gymnasiums(task: Any, reward: str) -> None:
    rig = dpend.rig("gustafsson2016").replace(track_limit=0.6)
    ours, n = Environment(task=task, rig=rig, reward=reward), 64
    theirs = CartDoublePendulumVectorEnv(task, rig, n, reward=reward, autoreset_mode="SameStep")
    keys = jax.random.split(jax.random.key(1), n)
    _, state = jax.vmap(ours.reset)(keys)
    x0 = np.array(state.x)
    assert_allclose(theirs.reset(options={"x0": x0})[0], x0)
    sample = jax.jit(jax.vmap(ours.step))
    live, seen = np.ones(n, dtype=bool), set()
    for k in range(task.steps):
        actions = np.random.default_rng(k).uniform(-1, 1, (n, 1))
        obs, state, paid, done, info = sample(keys, state, actions)
        expected = theirs.step(actions)
        assert_allclose(np.asarray(paid)[live], expected[1][live], rtol=0, atol=1e-8)
        assert_array_equal(np.asarray(info["terminated"])[live], expected[2][live])
        assert_array_equal(np.asarray(info["truncated"])[live], expected[3][live])
        ended = live & np.asarray(done)
        if ended.any():
            final = expected[4]["final_info"]
            assert_array_equal(np.asarray(info["status"])[ended], final["status"][ended])
            assert_array_equal(np.asarray(info["success"])[ended], final["success"][ended])
            assert_allclose(np.asarray(obs)[ended], x0[ended], atol=1e-12)  # begun again with the same key
            assert not np.asarray(state.steps)[ended].any()
            seen |= {*final["status"][ended].tolist(), *(f"success {each}" for each in final["success"][ended])}
        live &= ~np.asarray(done)
    assert len(seen) > 1  # episodes ended in more than one way


def test_starts_are_those_of_the_task() -> None:
    rig = ideal_rig(dpend.rig("gustafsson2016"), limits=True)
    keys = jax.random.split(jax.random.key(0), 4000)
    for task in (Balance(lam=0.3, lam2=0.1), SwingUp(angle_spread=0.2), SwingUp(start="anywhere")):
        found = np.asarray(jax.vmap(Environment(task=task, rig=rig).reset)(keys)[0])
        expected = task.starts(np.random.default_rng(0), 4000, rig)
        assert_allclose(found.mean(axis=0), expected.mean(axis=0), atol=0.15)
        assert_allclose(found.std(axis=0), expected.std(axis=0), rtol=0.06, atol=1e-9)


def test_what_it_cannot_do_is_refused() -> None:
    rig = dpend.rig("gustafsson2016")
    ideal = "In JAX actuator and sensors are ideal; take dpend.rig.ideal_rig(rig, limits=True) of this rig."
    with pytest.raises(ValueError, match=whole(ideal)):
        Environment(task=Balance(), rig=rig.replace(actuator_lag=0.1))
    with pytest.raises(ValueError, match=whole('reward must be "default" or "report"; got \'shaped\'.')):
        Environment(task=Balance(), rig=rig, reward="shaped")
