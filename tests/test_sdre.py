"""The plant is factorised exactly, Riccati's equation solved for all rows at once, and upright that is LQR."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rigs import endless, random_params, random_states, whole
from scipy.linalg import solve_discrete_are

import dpend
from controllers import LQR, SDRE
from controllers.sdre import _held, factorize, solve_riccati
from dpend import discretize, linearize, rates, rows
from dpend.params import Array
from dpend.rig import Rig

RNG = np.random.default_rng(0)


@pytest.mark.parametrize("seed", range(5))
def test_the_factors_times_the_state_are_the_rates_to_rounding(seed: int) -> None:
    rng = np.random.default_rng(seed)
    params = random_params(rng)
    x = random_states(rng, 300)
    x[0] = 0.0
    x[1, 1:3] = np.pi
    x[2, 3:] = 0.0
    x[3, 1] = 1e-7
    u = rng.uniform(-40, 40, 300)
    A, B = factorize(params, x)
    xdot = rates(x, u, params)
    assert_allclose(
        np.einsum("nij,nj->ni", A, x) + B[..., 0] * u[:, None], xdot, rtol=0, atol=1e-13 * np.abs(xdot).max()
    )


@pytest.mark.parametrize("seed", range(5))
def test_upright_the_factors_are_the_linearization(seed: int) -> None:
    params = random_params(np.random.default_rng(seed))
    for factor, exact in zip(factorize(params, np.zeros(6)), linearize(params), strict=True):
        assert_allclose(factor, exact, atol=1e-12 * np.abs(exact).max())


def test_many_plants_are_sampled_as_one_is() -> None:
    rig = dpend.rig("gustafsson2016")
    A, B = factorize(rig.params, random_states(RNG, 50))
    for a, b, held_a, held_b in zip(A, B, *_held(A, B, 0.05), strict=True):
        exact_a, exact_b = discretize(a, b, 0.05)
        assert_allclose(held_a, exact_a, rtol=0, atol=1e-12 * np.abs(exact_a).max())
        assert_allclose(held_b, exact_b, rtol=0, atol=1e-12 * np.abs(exact_b).max())


def random_plants(n: int) -> tuple[Array, Array]:
    return RNG.standard_normal((n, 6, 6)), RNG.standard_normal((n, 6, 1))


def test_doubling_solves_riccatis_equation() -> None:
    A, B = random_plants(50)
    root = RNG.standard_normal((6, 6))
    Q, R = root @ root.T + np.eye(6), 0.3
    P, found = solve_riccati(A, B, Q, R)
    assert found.all()

    def left_over(p: Array, a: Array, b: Array) -> float:
        gain = np.linalg.solve(R + b.T @ p @ b, b.T @ p @ a)
        loop = a - b @ gain
        return np.abs(loop.T @ p @ loop + R * gain.T @ gain + Q - p).max()

    for a, b, p in zip(A, B, P, strict=True):
        wanted = solve_discrete_are(a, b, Q, np.array([[R]]))
        near = 1e-8 * np.abs(p).max() + 10 * left_over(wanted, a, b)  # scipy errs too where no force moves much
        assert left_over(p, a, b) <= near
        assert_allclose(p, wanted, rtol=1e-6, atol=near)


def test_doubling_says_where_nothing_stabilises() -> None:
    A, B = random_plants(4)
    A[1], B[1] = np.diag([1.5, 0.9, 0.8, 0.7, 0.6, 0.5]), 0.0  # the first mode grows, and no force reaches it
    A[2, 0, 0] = np.nan
    _, found = solve_riccati(A, B, np.eye(6), 1.0)
    assert found.tolist() == [True, False, False, True]


@pytest.mark.parametrize("preset", dpend.rigs())
def test_upright_it_is_the_regulator(preset: str) -> None:
    rig = dpend.rig(preset)
    gains, found = SDRE(rig).gains(np.zeros((1, 6)))
    assert found.all()
    assert_allclose(gains, LQR(rig).K, rtol=1e-6)


def test_a_gain_is_the_same_in_every_batch_and_in_any_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    x = random_states(RNG, 600, scale=0.4)
    sdre = SDRE("gustafsson2016")
    monkeypatch.setattr(rows, "_cores", lambda: 3)
    gains, found = sdre.gains(x)
    for part in (slice(0, 1), slice(1, 3), slice(500, 600)):
        alone, its_found = sdre.gains(x[part])
        assert_array_equal(alone, gains[part])
        assert_array_equal(its_found, found[part])


def test_near_upright_its_force_leaves_a_remainder_of_third_order() -> None:
    rig = dpend.rig("gustafsson2016")
    sdre, lqr = (law.start(20, np.random.default_rng(0)) for law in (SDRE(rig), LQR(rig)))
    x = RNG.standard_normal((20, 6))
    apart = [np.abs(sdre(0.0, scale * x) - lqr(0.0, scale * x)).max() for scale in (0.02, 0.01)]
    assert 6 < apart[0] / apart[1] < 10


def test_mirrored_state_mirrored_force() -> None:
    rig = dpend.rig("gustafsson2016")
    x = random_states(RNG, 50, scale=0.3)
    forces = [SDRE(rig).start(50, np.random.default_rng(0))(0.0, sign * x) for sign in (1, -1)]
    assert_allclose(forces[0], -forces[1], rtol=1e-9)


def test_where_there_is_no_gain_the_last_is_kept_and_logged(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = dpend.rig("gustafsson2016")
    sdre = SDRE(rig)
    act = sdre.start(2, np.random.default_rng(0))
    x = 0.3 * np.ones((2, 6))
    good, _ = sdre.gains(x)
    monkeypatch.setattr(
        SDRE, "gains", lambda self, x: (np.stack([good[0], np.full(6, np.nan)]), np.array([True, False]))
    )
    assert_allclose(act(0.0, x), -np.einsum("ij,ij->i", [good[0], LQR(rig).K[0]], x))
    monkeypatch.setattr(SDRE, "gains", lambda self, x: (np.full((2, 6), np.nan), np.zeros(2, dtype=bool)))
    assert_allclose(act(0.02, x), -np.einsum("ij,ij->i", [good[0], LQR(rig).K[0]], x))
    assert_allclose(act.log["kept"], [[0, 1], [1, 1]])  # type: ignore[attr-defined]


def saved(rig: Rig, law: LQR | SDRE, lam: float, n: int) -> float:
    task = dpend.Balance(lam=lam)
    return float(dpend.simulate_many(rig, law, task.starts(np.random.default_rng(7), n, rig), task=task).success.mean())


@pytest.mark.slow
def test_on_bogdanovs_plant_it_saves_starts_that_the_regulator_loses() -> None:
    rig = dpend.rig("bogdanov2004")
    assert saved(rig, SDRE(rig), 0.6, 50) > saved(rig, LQR(rig), 0.6, 50) + 0.2


def test_wrong_use_is_refused() -> None:
    with pytest.raises(
        ValueError, match=whole("SDRE takes one plant; got a rig of 2 rows. Take one of them with rig.rows(i).")
    ):
        SDRE(endless(mass1=np.array([0.5, 0.6])))
    with pytest.raises(
        ValueError,
        match=whole("Q must be finite: a diagonal (6,) or a matrix (6, 6); got array([nan, n...an, nan, nan])."),
    ):
        SDRE("gustafsson2016", np.full(6, np.nan))
