"""The energy laws do what their Lyapunov functions say, are regular where they say so, and refuse where not."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from rigs import endless, random_params, random_states, whole
from scipy.integrate import solve_ivp

import dpend
from controllers import EnergyPump, EnergySwingUp
from dpend import Stepper, energies, rates
from dpend.params import Array
from dpend.rig import Rig

RNG = np.random.default_rng(0)


def plants(n: int) -> list[Rig]:
    """Draw frictionless rigs without limits."""
    return [endless(params=random_params(np.random.default_rng(seed), friction=False)) for seed in range(n)]


def hanging(n: int, width: float = 0.1) -> Array:
    x = np.tile(dpend.EQUILIBRIA["down-down"], (n, 1))
    x[:, 1:3] += np.random.default_rng(1).uniform(-width, width, (n, 2))
    return x


def slope(rig: Rig, x: Array, u: Array, of: Callable[[Array], Array], step: float = 1e-6) -> Array:
    """Differentiate a function of the state along the motion, by central differences."""
    xdot = rates(x, u, rig.params)
    return (of(x + step * xdot) - of(x - step * xdot)) / (2 * step)


@pytest.mark.parametrize("rig", plants(5))
def test_the_lyapunov_functions_slope_is_minus_damping_times_speed_squared(rig: Rig) -> None:
    law = EnergySwingUp(rig)
    x = random_states(RNG, 200, scale=0.5)
    assert_allclose(slope(rig, x, law.force(x), law.lyapunov), -law.k_d * x[:, 3] ** 2, atol=1e-6)


def wide() -> EnergySwingUp:
    """Return the law well away from where it is singular."""
    law = EnergySwingUp(endless())
    return EnergySwingUp(endless(), k_velocity=1.6 * law.k_velocity)


@pytest.mark.parametrize("seed", range(3))
def test_v_never_rises_along_the_motion_under_continuous_feedback(seed: int) -> None:
    law = wide()
    solved = solve_ivp(
        lambda _, x: rates(x, law.force(x), law.rig.params),
        (0.0, 1.5),
        random_states(np.random.default_rng(seed), 1, scale=0.4)[0],
        method="DOP853",
        rtol=1e-10,
        atol=1e-10,
        max_step=0.01,
    )
    v = law.lyapunov(solved.y.T)
    assert np.diff(v).max() < 1e-9 * v[0]
    assert v[-1] < v[0]
    lost = np.trapezoid(law.k_d * solved.y[3] ** 2, solved.t)
    assert v[0] - v[-1] == pytest.approx(lost, rel=1e-2)


@cache
def rises(sample_time: float, **changes: Any) -> float:
    """Return the greatest rise of V in any sample of eight lively runs of 1 s, as a share of V at the start."""
    rig = endless(sample_time=sample_time, substeps=1, **changes)
    law = wide()
    stepper = Stepper(rig, 8)
    x = stepper.reset(random_states(np.random.default_rng(1), 8, scale=0.4))
    values = [law.lyapunov(x)]
    for _ in range(round(1 / sample_time)):
        x = stepper.step(law.force(x))
        values.append(law.lyapunov(x))
    return float((np.diff(values, axis=0).max(axis=0) / values[0]).max())


def test_what_v_rises_by_under_a_force_held_finely_vanishes_with_the_hold() -> None:
    assert rises(1e-3) < 0.4 * rises(2e-3) < 4e-3


@pytest.mark.parametrize("changes", [{"force_limit": 10.0}, {"joint1_friction": 0.5}])
def test_limits_and_friction_let_v_rise(changes: dict[str, float]) -> None:
    assert rises(2e-3, **changes) > 3 * rises(2e-3)


def test_holding_the_force_lets_v_rise() -> None:
    assert rises(0.02) > 0.01


def test_the_carts_answer_to_force_is_least_with_both_links_horizontal() -> None:
    for rig in plants(5):
        c = rig.params.coefficients()
        x = np.zeros((2000, 6))
        x[:, 1:3] = RNG.uniform(-np.pi, np.pi, (2000, 2))
        x[0, 1:3] = np.pi / 2
        beta = rates(x, np.ones(2000), rig.params)[:, 3] - rates(x, np.zeros(2000), rig.params)[:, 3]
        assert beta.min() == beta[0]
        assert beta[0] == pytest.approx(1 / c.d1)


def test_a_singular_law_is_refused_with_the_inequality_and_its_numbers() -> None:
    with pytest.raises(
        ValueError,
        match=whole(
            "The law is singular: it needs k_velocity * min beta > 2 * k_energy * Er, and with k_velocity = 39, "
            "min beta = 1 / (2 kg), k_energy = 1 and Er = 9.81 J that is 19.5 > 19.62; "
            "let k_velocity be greater than 39.24."
        ),
    ):
        EnergySwingUp("gustafsson2016", k_energy=1.0, k_velocity=39.0)
    EnergySwingUp("gustafsson2016", k_energy=1.0, k_velocity=39.25)


@pytest.mark.parametrize("rig", plants(5))
def test_the_denominator_keeps_its_sign_wherever_the_links_are(rig: Rig) -> None:
    law = EnergySwingUp(rig, k_velocity=1.0001 * EnergySwingUp(rig).k_velocity / 1.25)
    x = np.zeros((3000, 6))
    x[:, 1:3] = RNG.uniform(-np.pi, np.pi, (3000, 2))  # at rest the energy is least
    beta = rates(x, np.ones(3000), rig.params)[:, 3] - rates(x, np.zeros(3000), rig.params)[:, 3]
    assert (law.k_energy * (energies(x, rig.params).total - law.energy) + law.k_velocity * beta > 0).all()


@pytest.mark.parametrize("rig", plants(5))
def test_the_links_energy_changes_by_minus_acceleration_times_momentum(rig: Rig) -> None:
    law = EnergyPump(rig)
    x = random_states(RNG, 200, scale=0.5)
    u = law.force(x)
    acceleration = rates(x, u, rig.params)[:, 3]
    assert_allclose(slope(rig, x, u, law.links_energy), -acceleration * law.momentum(x), rtol=1e-5, atol=1e-5)


def test_pumping_without_a_cart_to_keep_never_drives_the_energy_away() -> None:
    rig = endless()
    law = EnergyPump(rig, k_x=1e-9, k_d=1e-9)
    x = random_states(RNG, 500, scale=0.5)
    missing = law.links_energy(x) - law.energy
    assert (missing * slope(rig, x, law.force(x), law.links_energy) <= 1e-6).all()


@pytest.mark.parametrize("kind", [EnergySwingUp, EnergyPump])
def test_mirrored_state_mirrored_force(kind: type[EnergySwingUp] | type[EnergyPump]) -> None:
    x = random_states(RNG, 50)
    assert_allclose(kind("gustafsson2016").force(-x), -kind("gustafsson2016").force(x), rtol=1e-12)


@pytest.mark.parametrize("kind", [EnergySwingUp, EnergyPump])
def test_hanging_at_rest_it_is_perturbed_once(kind: type[EnergySwingUp] | type[EnergyPump]) -> None:
    law = kind("gustafsson2016", perturbation=3.0)
    act = law.start(2, np.random.default_rng(0))
    y = np.array([dpend.EQUILIBRIA["down-down"], [0, np.pi / 2, np.pi / 2, 0, 0, 0]])
    assert_allclose(act(0.0, y), [3.0, law.force(y)[1]])
    assert_allclose(act(0.02, y)[0], 0.0, atol=1e-12)


def test_pumping_brings_the_energy_up_within_the_limits_of_the_rig() -> None:
    rig = dpend.rig("gustafsson2016")
    law = EnergyPump(rig)
    runs = dpend.simulate_many(rig, law, hanging(20), 6.0, task=dpend.SwingUp(), record=True)
    assert runs.travel.max() < rig.track_limit
    assert (np.abs(energies(runs.x, rig.params).total / law.energy - 1).min(axis=1) < 0.02).all()


@pytest.mark.parametrize("kind", [EnergySwingUp, EnergyPump])
def test_wrong_use_is_refused(kind: type[EnergySwingUp] | type[EnergyPump]) -> None:
    with pytest.raises(ValueError, match=whole("k_x must be finite and greater than 0; got 0.")):
        kind("gustafsson2016", k_x=0)
    with pytest.raises(ValueError, match=whole("perturbation must be a finite force in N; got inf.")):
        kind("gustafsson2016", perturbation=np.inf)
    with pytest.raises(
        ValueError,
        match=whole(f"{kind.__name__} takes one plant; got a rig of 2 rows. Take one of them with rig.rows(i)."),
    ):
        kind(endless(mass1=np.array([0.5, 0.6])))
    with pytest.raises(
        ValueError, match=whole(f"{kind.__name__} lifts the links against gravity; got a rig without, gravity=0.0.")
    ):
        kind(endless(gravity=0.0))
