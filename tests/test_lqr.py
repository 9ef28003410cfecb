"""The regulator is optimal, its margins are where stability ends, and it balances as well as is on record."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_allclose
from rigs import endless, random_params, random_states, whole
from scipy.linalg import solve_discrete_lyapunov

import dpend
from controllers import LQR, BangBang, Constant, LinearLaw, Margins, Zero
from dpend import Balance, Stepper, discretize, linearize
from dpend.params import Array
from dpend.rig import Rig
from dpend.state import deviation

RNG = np.random.default_rng(0)
PRESETS = tuple(dpend.rigs())
DESIGNS: tuple[Any, ...] = ("discrete", "continuous")


def sampled(rig: Rig) -> tuple[Array, Array]:
    """Return the plant about upright, sampled."""
    return discretize(*linearize(rig.params), rig.sample_time)


def radius(matrix: Any) -> float:
    """Return the spectral radius."""
    return float(np.abs(np.linalg.eigvals(matrix)).max())


def forces(controller: Any, y: Array) -> Array:
    """Return what a controller without memory answers to measurements."""
    return controller.start(len(y), np.random.default_rng(0))(0.0, y)


# --------------------------------------------------------------------------------------------------------------- design


def random_weights(rng: np.random.Generator) -> tuple[Array, float]:
    root = rng.standard_normal((6, 6))
    return root @ root.T + np.eye(6), float(rng.uniform(0.1, 2.0))


@pytest.mark.parametrize("seed", range(5))
def test_the_gain_solves_the_riccati_equation(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rig = endless(params=random_params(rng))
    Q, R = random_weights(rng)
    lqr = LQR(rig, Q, R)
    Ad, Bd = sampled(rig)
    assert_allclose(lqr.K, np.linalg.solve(R + Bd.T @ lqr.P @ Bd, Bd.T @ lqr.P @ Ad), rtol=1e-7)
    residual = Ad.T @ lqr.P @ Ad - lqr.P - Ad.T @ lqr.P @ Bd @ lqr.K + Q
    assert np.abs(residual).max() < 1e-7 * np.abs(lqr.P).max()
    assert np.linalg.eigvalsh(lqr.P).min() > 0


@pytest.mark.parametrize("seed", range(5))
def test_no_other_gain_costs_less(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rig = endless(params=random_params(rng))
    lqr = LQR(rig)
    Ad, Bd = sampled(rig)
    x0 = rng.standard_normal(6)

    def cost(K: Array) -> float:
        """Sum the weighted squares along the whole infinite run, by Lyapunov's equation."""
        closed = Ad - Bd @ K
        assert radius(closed) < 1
        return float(x0 @ solve_discrete_lyapunov(closed.T, np.eye(6) + K.T @ K) @ x0)

    best = cost(lqr.K)
    assert_allclose(best, x0 @ lqr.P @ x0, rtol=1e-7)
    for _ in range(5):
        assert cost(lqr.K * (1 + 1e-3 * rng.standard_normal(6))) > best


@pytest.mark.parametrize("seed", range(5))
def test_with_a_discount_no_other_gain_costs_less_and_x_p_x_is_the_discounted_cost(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rig, gamma = endless(params=random_params(rng)), 0.99
    lqr = LQR(rig, discount=gamma)
    Ad, Bd = sampled(rig)
    x0 = rng.standard_normal(6)

    def cost(K: Array) -> float:
        closed = np.sqrt(gamma) * (Ad - Bd @ K)
        return float(x0 @ solve_discrete_lyapunov(closed.T, np.eye(6) + K.T @ K) @ x0)

    best = cost(lqr.K)
    assert_allclose(best, x0 @ lqr.P @ x0, rtol=1e-7)
    for _ in range(5):
        assert cost(lqr.K * (1 + 1e-3 * rng.standard_normal(6))) > best


def test_a_discount_under_which_falling_is_the_cheapest_is_refused() -> None:
    with pytest.raises(ValueError, match=r"^There is no stabilising .* to rest, or raise the discount\.$"):
        LQR("gustafsson2016", discount=0.9)


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_is_stable_under_its_default_regulator(name: str) -> None:
    rig = dpend.rig(name)
    lqr = LQR(rig)
    Ad, Bd = sampled(rig)
    assert radius(Ad) > 1
    assert radius(Ad - Bd @ lqr.K) < 1
    assert_allclose(np.sort_complex(lqr.poles), np.sort_complex(np.linalg.eigvals(Ad - Bd @ lqr.K)), rtol=1e-9)


def test_a_diagonal_means_the_diagonal_matrix_and_the_defaults_are_ones() -> None:
    rig = endless()
    weights = np.arange(1.0, 7.0)
    assert np.array_equal(LQR(rig, weights).K, LQR(rig, np.diag(weights)).K)
    assert np.array_equal(LQR(rig).K, LQR(rig, np.ones(6), 1.0).K)


def test_the_continuous_gain_is_the_limit_of_the_discrete_one_for_short_samples() -> None:
    rig = endless(params=random_params(np.random.default_rng(1)))
    continuous = LQR(rig, design="continuous").K
    times = np.array([4e-3, 2e-3, 1e-3])
    # a sum over samples is an integral divided by the sample time, so the weights are scaled alike and K stays
    gaps = [np.abs(LQR(rig.replace(sample_time=T)).K - continuous).max() for T in times]
    assert_allclose(np.polyfit(np.log(times), np.log(gaps), 1)[0], 1, atol=0.05)
    discounted = [LQR(rig.replace(sample_time=1e-3), discount=0.9995, design=each).K for each in DESIGNS]
    assert np.abs(discounted[0] - discounted[1]).max() < 1.5 * gaps[-1]
    assert np.abs(discounted[0] - continuous).max() > 3 * gaps[-1]
    A, B = linearize(rig.params)
    assert np.linalg.eigvals(A - B @ continuous).real.max() < 0


@pytest.mark.parametrize("name", ["pilco2011", "dompc_dip"])
def test_a_continuous_gain_too_high_for_the_sample_time_is_warned_of(name: str) -> None:
    rig = dpend.rig(name)
    weights = {"Q": (1.0, 10.0, 10.0, 1.0, 1.0, 1.0), "R": 0.01}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        lqr = LQR(rig, **weights, design="continuous")
    Ad, Bd = sampled(rig)
    unstable = radius(Ad - Bd @ lqr.K)
    assert unstable > 1
    assert [str(warning.message) for warning in caught] == [
        f"This continuous-time gain, held over {rig.sample_time:g} s, gives an unstable loop "
        f'(spectral radius {unstable:.3f}); use design="discrete".'
    ]
    assert caught[0].filename == __file__
    message = f"The sampled loop is unstable (spectral radius {unstable:.3f}): it has no margins."
    with pytest.raises(ValueError, match=whole(message)):
        lqr.margins()
    assert radius(Ad - Bd @ LQR(rig, **weights).K) < 1  # designed in discrete time the same weights do no harm


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda rig: LQR(rig, Q=np.ones(5)),
            "Q weighs the six states (pos, th1, th2, vel, om1, om2): expected a diagonal (6,) or a matrix (6, 6); "
            "got shape (5,).",
        ),
        (lambda rig: LQR(rig, Q=np.eye(6) + np.eye(6, k=1)), "Q must be symmetric."),
        (
            lambda rig: LQR(rig, Q=[1, 1, np.nan, 1, 1, 1]),
            "Q must be finite: a diagonal (6,) or a matrix (6, 6); got [1, 1, nan, 1, 1, 1].",
        ),
        (lambda rig: LQR(rig, Q=[1, 1, -2, 1, 1, 1]), "Q must be positive semidefinite; its least eigenvalue is -2."),
        (lambda rig: LQR(rig, R=0.0), "R, the weight of the force, must be finite and greater than 0; got 0.0."),
        (lambda rig: LQR(rig, R=-1.0), "R, the weight of the force, must be finite and greater than 0; got -1.0."),
        (
            lambda rig: LQR(rig, R=np.inf),
            "R, the weight of the force, must be finite and greater than 0; got inf.",
        ),
        (
            lambda rig: LQR(rig, design="analogue"),  # pyright: ignore[reportArgumentType]
            'design must be "discrete" or "continuous"; got \'analogue\'.',
        ),
        (lambda rig: LQR(rig, discount=0.0), "discount must be above 0 and at most 1; got 0.0."),
        (lambda rig: LQR(rig, discount=1.1), "discount must be above 0 and at most 1; got 1.1."),
        (
            lambda rig: LQR(rig.replace(mass1=[0.4, 0.5])),
            "LQR takes one plant; got a rig of 2 rows. Take one of them with rig.rows(i).",
        ),
        (lambda rig: BangBang(Zero(), 0.0), "force must be finite and greater than 0 N; got 0.0."),
        (lambda rig: BangBang(Zero(), np.inf), "force must be finite and greater than 0 N; got inf."),
        (lambda rig: Constant(np.nan), "force must be finite, in N; got nan."),
    ],
)
def test_a_bad_description_is_refused_with_what_was_expected(call: Callable[[Rig], object], message: str) -> None:
    with pytest.raises(ValueError, match=whole(message)):
        call(endless())


@pytest.mark.parametrize("design", DESIGNS)
@pytest.mark.parametrize("name", PRESETS)
def test_weights_that_do_not_see_the_cart_are_refused(name: str, design: Any) -> None:
    for Q in (np.zeros(6), [0, 1, 1, 1, 1, 1]):
        with pytest.raises(
            ValueError, match=r"^There is no stabilising solution of the Riccati equation .* to rest\.$"
        ):
            LQR(dpend.rig(name), Q, design=design)


# ----------------------------------------------------------------------------------------------------------------- cost


def test_the_simulated_cost_is_x_p_x_up_to_the_square_of_the_state() -> None:
    rig = endless("gustafsson2016", substeps=10)
    Q, R = np.array([1.0, 10.0, 10.0, 1.0, 2.0, 3.0]), 0.5
    lqr = LQR(rig, Q, R)
    scales = np.array([0.1, 0.05, 0.025, 0.0125])
    x0 = scales[:, None] * np.array([0.5, 1.0, -0.5, 0.3, -0.4, 0.2])
    runs = dpend.simulate_many(rig, lqr, x0, 20.0, record=True)
    assert runs.success.all()
    spent = np.einsum("ntj,j->n", runs.x[:, :-1] ** 2, Q) + R * (runs.u**2).sum(axis=1)
    promised = np.einsum("ni,ij,nj->n", x0, lqr.P, x0)
    excess = spent / promised - 1
    assert np.abs(excess[-1]) < 2e-3  # and so on:
    assert 1.9 < np.polyfit(np.log(scales), np.log(np.abs(excess)), 1)[0] < 2.1


# ----------------------------------------------------------------------------------------------------------- symmetries


def test_a_mirrored_state_is_met_with_the_mirrored_force() -> None:
    y = random_states(RNG, 50, scale=0.4)
    lqr = LQR(endless())
    assert np.array_equal(forces(lqr, -y), -forces(lqr, y))
    sign = BangBang(lqr, 40.0)
    assert np.array_equal(forces(sign, -y), -forces(sign, y))


@pytest.mark.parametrize("name", dpend.EQUILIBRIA)
def test_each_equilibrium_is_held_by_the_regulator_about_it(name: str) -> None:
    rig = dpend.rig("gustafsson2016")
    about = dpend.EQUILIBRIA[name] + np.array([0.5, 0, 0, 0, 0, 0])
    start = about + np.array([0, 0.05, -0.05, 0, 0, 0])
    run = dpend.simulate(rig, LQR(rig, target=about), start, 60.0, task=None)
    assert np.abs(run.x[-1] - about).max() < 1e-6
    assert np.abs(run.u).max() <= 40.0


def test_every_upright_is_upright() -> None:
    y = random_states(RNG, 50, scale=0.4)
    y[:, 1:3] = RNG.uniform(-3, 3, (50, 2))
    lqr = LQR(endless())
    for turns in ((1, 0), (0, -1), (2, 3)):
        turned = y.copy()
        turned[:, 1:3] += 2 * np.pi * np.array(turns)
        assert_allclose(forces(lqr, turned), forces(lqr, y), rtol=0, atol=1e-11)


def test_the_force_is_the_gain_times_the_state_whatever_the_time() -> None:
    y = random_states(RNG, 20, scale=0.3)
    lqr = LQR(endless())
    act = lqr.start(20, np.random.default_rng(0))
    for t in (0.0, 1.5):
        assert_allclose(act(t, y), -(y @ lqr.K.T)[:, 0], rtol=1e-13)


# -------------------------------------------------------------------------------------------------------------- margins


class Loop(NamedTuple):
    """A preset, its default regulator, and the margins that are claimed."""

    rig: Rig
    lqr: LQR
    margins: Margins
    plant: Array
    feedback: Array

    def under(self, gain: complex) -> float:
        """Return the spectral radius with the law multiplied by a real or complex number."""
        return radius(self.plant - gain * self.feedback)


@pytest.fixture(scope="module", params=PRESETS)
def loop(request: pytest.FixtureRequest) -> Loop:
    rig = dpend.rig(request.param)
    lqr = LQR(rig)
    Ad, Bd = sampled(rig)
    return Loop(rig, lqr, lqr.margins(), Ad, Bd @ lqr.K)


def test_the_loop_is_stable_between_the_gain_margins_and_unstable_just_outside(loop: Loop) -> None:
    low, high = loop.margins.gain_low, loop.margins.gain_high
    assert low < 1 < high
    assert all(loop.under(gain) < 1 for gain in np.geomspace(low * (1 + 1e-6), high * (1 - 1e-6), 60))
    assert loop.under(low * (1 - 1e-6)) > 1
    assert loop.under(high * (1 + 1e-6)) > 1


def test_the_loop_is_stable_within_the_phase_margin_and_unstable_just_outside(loop: Loop) -> None:
    phase = loop.margins.phase
    for way in (-1j, 1j):
        assert all(loop.under(np.exp(way * angle)) < 1 for angle in np.linspace(0, phase * (1 - 1e-6), 30))
        assert loop.under(np.exp(way * phase * (1 + 1e-6))) > 1


def test_the_loop_survives_every_factor_within_the_disk_and_not_all_on_its_edge(loop: Loop) -> None:
    def worst(alpha: float) -> float:
        rim = 0.5 * alpha * np.exp(1j * np.linspace(0, np.pi, 100))
        return max(loop.under((1 + delta) / (1 - delta)) for delta in rim)

    assert worst(loop.margins.disk * 0.999) < 1
    assert worst(loop.margins.disk * 1.001) > 1
    # so gain and phase alone may change at least as much as the disk says
    half = loop.margins.disk / 2
    assert loop.margins.gain_low <= (1 - half) / (1 + half)
    assert loop.margins.gain_high >= (1 + half) / (1 - half)
    assert loop.margins.phase >= 2 * np.arctan(half) * (1 - 1e-6)


def test_the_loop_lives_with_less_than_the_delay_margin_and_dies_of_more(loop: Loop) -> None:
    assert_allclose(loop.margins.delay, loop.margins.delay_samples * loop.rig.sample_time, rtol=1e-12)
    fine = 20  # parts of a sample in which the delay is counted
    A, B = discretize(*linearize(loop.rig.params), loop.rig.sample_time / fine)
    under_way = int(loop.margins.delay_samples) + 2

    def over_one_sample(parts_late: int) -> Array:
        """Return the matrix that carries the states and the last commands, the newest first, over one sample."""
        states = np.eye(6 + under_way)
        x, commands = states[:6], np.vstack([-loop.lqr.K @ states[:6], states[6:]])
        for part in range(fine):
            x = A @ x + B * commands[-((part - parts_late) // fine)]
        return np.vstack([x, commands[:-1]])

    edge = loop.margins.delay_samples * fine
    assert all(radius(over_one_sample(parts)) < 1 for parts in range(int(edge) + 1))
    assert radius(over_one_sample(int(edge) + 1)) > 1


def test_the_rig_stands_with_the_delay_it_is_said_to_bear_and_falls_with_one_sample_more(loop: Loop) -> None:
    bearable = int(loop.margins.delay_samples)
    late = endless(params=loop.rig.params, sample_time=loop.rig.sample_time, actuator_delay=[bearable, bearable + 1])
    x0 = np.tile([0, 1e-4, -1e-4, 0, 0, 0], (2, 1))
    runs = dpend.simulate_many(late, loop.lqr, x0, 1000 * late.sample_time, record=True)
    lean = np.abs(runs.x[:, :, 1:3]).max(axis=2)
    assert lean[0, -100:].max() < 0.5 * lean[0, :100].max()
    assert not lean[1, -100:].max() < 10 * lean[1, :100].max()


# --------------------------------------------------------------------------------------------------- what is on record


@pytest.mark.parametrize("criterion", ["strict", "report"])
@pytest.mark.parametrize(("lam", "share"), [(0.1, 0.995), (0.2, 0.99), (0.3, 0.86), (0.4, 0.65)])
def test_the_regulator_balances_the_reports_plant_as_often_as_is_on_record(
    lam: float, share: float, criterion: str
) -> None:
    rig = dpend.rig("gustafsson2016")
    task = Balance(lam=lam, criterion=criterion)
    x0 = task.starts(np.random.default_rng(0), 4000, rig)
    assert dpend.simulate_many(rig, LQR(rig), x0, task=task).success.mean() >= share


# -------------------------------------------------------------------------------------------------- simple controllers


def test_bang_bang_gives_full_force_either_way_or_none() -> None:
    y = random_states(RNG, 200)
    y[0] = 0.0
    sign = forces(BangBang(LQR(endless()), 12.0), y)
    assert set(sign) == {-12.0, 0.0, 12.0}
    assert sign[0] == 0
    assert np.array_equal(np.sign(sign), np.sign(forces(LQR(endless()), y)))


def test_bang_bang_is_batched_where_its_inner_law_is() -> None:
    class OneByOne(Zero):
        batched = False

    assert BangBang(Zero(), 1.0).batched
    assert not BangBang(OneByOne(), 1.0).batched


def test_bang_bang_refuses_a_class_and_what_cannot_start() -> None:
    message = "Expected a controller object; got the class Zero. Call it first."
    with pytest.raises(TypeError, match=whole(message)):
        BangBang(Zero, 1.0)  # pyright: ignore[reportArgumentType]
    message = "A controller has a method start(n, rng) that returns act(t, y); float has none."
    with pytest.raises(TypeError, match=whole(message)):
        BangBang(1.0, 1.0)  # pyright: ignore[reportArgumentType]


def test_constant_and_zero_do_not_look() -> None:
    y = random_states(RNG, 7)
    assert np.array_equal(forces(Constant(-3.5), y), np.full(7, -3.5))
    assert np.array_equal(forces(Zero(), y), np.zeros(7))
    act = Constant(2.0).start(3, np.random.default_rng(0))
    act(0.0, y[:3])[:] = 99.0  # what the caller does with an answer is no affair of the next
    assert np.array_equal(act(0.02, y[:3]), np.full(3, 2.0))


def test_under_no_force_the_plant_moves_as_the_stepper_leaves_it() -> None:
    rig = endless()
    x0 = np.array([0.0, 0.2, -0.1, 0.0, 0.0, 0.0])
    run = dpend.simulate(rig, Zero(), x0, 0.2, task=None)
    stepper = Stepper(rig, 1)
    stepper.reset(x0)
    for _ in range(10):
        stepper.step(np.zeros(1))
    assert np.array_equal(run.x[-1], stepper.x[0])
    assert not np.array_equal(run.x[-1], run.x[0])


@pytest.mark.slow
@pytest.mark.parametrize("sample_time", [0.002, 0.0005])
def test_margins_settle_as_the_sampling_grows_fast(sample_time: float) -> None:
    rig = dpend.rig("gustafsson2016").replace(sample_time=sample_time)
    margins = LQR(rig, Q=np.eye(6) * sample_time, R=sample_time).margins()  # the same integral, sampled finer
    assert margins.disk == pytest.approx(0.67, abs=0.02)
    assert margins.delay == pytest.approx(0.0485, abs=0.002)
    assert margins.delay_samples == pytest.approx(margins.delay / sample_time)


@pytest.mark.parametrize("target", dpend.EQUILIBRIA)
def test_a_linear_law_is_its_gain_times_the_deviation_to_the_nearest_turn_alone_and_in_a_batch(target: str) -> None:
    rng = np.random.default_rng(0)
    law = LinearLaw(rng.normal(size=6), target=target)
    y = rng.normal(scale=4.0, size=(70, 6))
    forces = law.start(len(y), rng)(0.0, y)
    assert_allclose(forces, -deviation(y, law.target) @ law.K[0], rtol=1e-13, atol=1e-13)
    for i in range(len(y)):
        assert law.start(1, rng)(0.0, y[i : i + 1])[0] == forces[i]
