"""Least-squares policy iteration and one-step Q-learning over quadratic features: the Riccati gain, refusals."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import solve_discrete_are

import dpend
from rl import LSPI, GainPolicy, GaussianQAC, LinearQLearning, Outcome, QuadraticQLearning, load_policy
from rl.features import QUADRATIC, quadratic_features, quadratic_form
from rl.lspi import _best_force, fit_q, gain_errors, greedy_gain
from tests.rigs import whole

RIG = dpend.rig("gustafsson2016")


def riccati(A, B, Q, R, gamma):
    """The gain and the value matrix of least discounted cost."""
    A, B = np.sqrt(gamma) * A, np.sqrt(gamma) * B
    P = solve_discrete_are(A, B, Q, np.array([[R]]))
    return ((B.T @ P @ A) / (R + B.T @ P @ B))[0], P


def best_gain(learner):
    """The gain that the Riccati equation gives for a learner's cost and discount about upright."""
    A, B = dpend.discretize(*dpend.linearize(learner.rig.params), learner.rig.sample_time)
    return riccati(A, B, np.diag(learner.state_weights), learner.force_weight, learner.gamma)[0]


def plant(rng, n):
    """A random linear plant, unstable or not, with its cost."""
    A, B = rng.normal(size=(n, n)) * 0.9 / np.sqrt(n) + 0.4 * np.eye(n), rng.normal(size=(n, 1))
    return A, B, np.diag(rng.uniform(0.5, 2.0, n)), float(rng.uniform(0.5, 2.0))


def samples(rng, A, B, Q, R, m=200):
    """States and actions from anywhere, their costs, and the states that follow."""
    z = rng.normal(size=(m, len(A) + 1))
    return z, np.einsum("ij,jk,ik->i", z[:, :-1], Q, z[:, :-1]) + R * z[:, -1] ** 2, z @ np.hstack([A, B]).T


def test_the_quadratic_features_are_the_products_that_their_names_say():
    z = np.random.default_rng(0).normal(size=7)
    place: list[str] = [*dpend.NAMES, "a"]
    products = [z[place.index(one)] * z[place.index(two)] for one, two in (name.split() for name in QUADRATIC)]
    assert_allclose(quadratic_features(z), products)
    assert len(QUADRATIC) == 28


def test_weights_and_matrix_are_the_same_quadratic_form():
    rng = np.random.default_rng(1)
    w, z = rng.normal(size=28), rng.normal(size=(20, 7))
    assert_allclose(np.einsum("ij,jk,ik->i", z, quadratic_form(w), z), quadratic_features(z) @ w)


@pytest.mark.parametrize("seed", range(5))
def test_on_a_linear_plant_the_fitted_q_is_the_exact_one(seed):
    rng = np.random.default_rng(seed)
    A, B, Q, R = plant(rng, 3)
    K, P = riccati(A, B, Q, R, 0.9)
    z, costs, following = samples(rng, A, B, Q, R)
    H = fit_q(z, costs, np.column_stack([following, -following @ K]), 0.9)
    AB = np.hstack([A, B])
    exact = np.block([[Q, np.zeros((3, 1))], [np.zeros((1, 3)), np.array([[R]])]]) + 0.9 * AB.T @ P @ AB
    assert_allclose(H, exact, atol=1e-8 * np.abs(exact).max())


@pytest.mark.parametrize("seed", range(5))
def test_policy_iteration_on_samples_of_a_linear_plant_finds_the_riccati_gain(seed):
    rng = np.random.default_rng(seed)
    A, B, Q, R = plant(rng, 3)
    best, _ = riccati(A, B, Q, R, 0.9)
    z, costs, following = samples(rng, A, B, Q, R)
    K = np.zeros(3)
    first = min(0.9, 0.8 / np.abs(np.linalg.eigvals(A)).max() ** 2)  # the horizon over which no gain is stable enough
    for gamma in np.append(np.linspace(first, 0.9, 30), [0.9] * 10):
        greedy = greedy_gain(fit_q(z, costs, np.column_stack([following, -following @ K]), gamma))
        assert greedy is not None
        K = greedy
    assert_allclose(K, best, rtol=1e-6, atol=1e-8)


def test_a_form_without_a_least_action_has_no_greedy_gain():
    assert greedy_gain(np.diag([1.0, 1.0, -1.0])) is None
    assert greedy_gain(np.full((3, 3), np.nan)) is None


def test_from_no_gain_and_no_model_it_finds_the_gain_of_the_linearised_plant():
    learner = LSPI(RIG)
    best = best_gain(learner)
    training = learner.train(77)
    assert training.experience == pytest.approx(120.0)
    errors = gain_errors(training.details["gains"], best)
    assert errors[0] > 0.9
    assert errors[-1] < 0.05
    assert (training.details["gains"][-1] == training.policy.K).all()
    assert list(training.details["samples"]) == list(range(100, 6001, 100))


def test_the_shipped_gain_is_that_of_the_discounted_cost_and_a_ninth_away_from_that_of_lqr():
    policy = load_policy("lspi")
    assert isinstance(policy, GainPolicy)
    K = policy.K[None]
    assert gain_errors(K, best_gain(LSPI(RIG)))[0] < 0.002
    assert gain_errors(K, best_gain(replace(LSPI(RIG), gamma=1.0)))[0] == pytest.approx(0.115, abs=0.001)


def test_its_force_is_as_smooth_as_that_of_the_gain_it_finds():
    learner = LSPI(RIG)
    best = best_gain(learner)
    task = dpend.Balance(lam=0.1)
    starts = task.starts(np.random.default_rng(3), 50, RIG)
    learned, designed = (
        dpend.simulate_many(RIG, law, starts, task=task) for law in (learner.train(78).policy, GainPolicy(best))
    )
    assert learned.success.all()
    assert learned.metrics()["variation"].mean() == pytest.approx(designed.metrics()["variation"].mean(), rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [LSPI, QuadraticQLearning])
def test_the_same_seed_learns_the_same_and_another_something_else(kind):
    learner = kind(RIG)
    one, same, other = (learner.train(seed).details["gains"] for seed in (0, 0, 1))
    assert (one == same).all()
    assert (one != other).any()


def test_the_force_of_least_q_is_the_vertex_of_the_parabola_or_an_end():
    rng = np.random.default_rng(5)
    forces = np.linspace(-40.0, 40.0, 8001)
    for _ in range(200):
        w, s = rng.normal(size=28), np.append(rng.normal(size=6), 0.0)
        z = np.column_stack([np.tile(s[:6], (len(forces), 1)), forces / 4.0])
        q = quadratic_features(z) @ w
        assert _best_force(w, s, 4.0, 40.0) == pytest.approx(forces[np.argmin(q)], abs=0.0101)


def test_one_step_q_learning_does_what_its_equation_says():
    learner = replace(QuadraticQLearning(RIG), samples=30, record_every=1, anneal=10, lam=0.09)
    rng = np.random.default_rng(np.random.SeedSequence(4, spawn_key=(2003,)))
    scales = np.array(learner.scales)
    w = np.zeros(28)
    w[-1] = learner.force_weight * scales[6] ** 2
    stepper = dpend.Stepper(RIG, 1)

    def features(s, a):
        return quadratic_features(np.append(s, a) / scales)

    def greedy(s):
        K = greedy_gain(quadratic_form(w) / np.outer(scales, scales))
        if K is not None:
            return float(np.clip(-K @ s, -40, 40))
        return min((-40.0, 40.0), key=lambda a: features(s, a) @ w)

    gains, fresh, s = [], True, np.zeros(6)
    for t in range(30):
        if fresh:
            th1, th2 = (learner.lam * rng.uniform(-1, 1) for _ in range(2))
            s = stepper.reset([0, th1, th2, 0, 0, 0])[0].copy()
        a = float(np.clip(greedy(s) + learner.noise * rng.standard_normal(), -40, 40))
        x = features(s, a)
        cost = float(np.array(learner.state_weights) @ s**2 + learner.force_weight * a**2)
        after = stepper.step([a])[0].copy()
        gamma = 0.6 + (0.99 - 0.6) * min(1.0, t / 10)
        delta = cost + gamma * features(after, greedy(after)) @ w - x @ w
        w = w + learner.alpha * delta * x / (learner.epsilon + x @ x)
        fresh = bool(np.abs(after[1:3]).max() > learner.angle_cut)
        s = after
        K = greedy_gain(quadratic_form(w) / np.outer(scales, scales))
        gains.append(np.zeros(6) if K is None else K)
    assert_allclose(learner.train(4).details["gains"], gains, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("kind", [LSPI, QuadraticQLearning])
def test_while_it_practises_an_episode_ends_at_the_end_of_the_track(kind):
    settings: dict = {"lam": 1e-9, "angle_cut": np.pi / 2, "episode_steps": 1000, "samples": 3000, "noise": 15.0}
    if kind is LSPI:
        settings |= {"iterations": 1}  # without a gain, so that the cart drifts
    else:
        settings |= {"alpha": 1e-12}

    def lengths(track_limit):
        return list(kind(RIG.replace(track_limit=track_limit), **settings).train(0).curve["length"])

    def expected(track_limit):
        """Episodes of the same forces on the stepper, which go on until the cart is at the end or a link falls."""
        rng = np.random.default_rng(np.random.SeedSequence(0, spawn_key=(2003,)))
        stepper, fresh, ended = dpend.Stepper(RIG, 1), True, []
        for _ in range(3000):
            if fresh:
                th1, th2 = (1e-9 * rng.uniform(-1, 1) for _ in range(2))
                x = stepper.reset([0, th1, th2, 0, 0, 0])[0]
                ended.append(0)
            x = stepper.step([np.clip(15.0 * rng.standard_normal(), -40, 40)])[0]
            ended[-1] += 1
            fresh = bool(abs(x[0]) > track_limit or np.abs(x[1:3]).max() > np.pi / 2)
        return ended if fresh else ended[:-1]

    for limit in (0.02, 0.1, np.inf):
        assert lengths(limit) == expected(limit)
    assert lengths(0.02) != lengths(0.1) != lengths(np.inf)


def test_a_learned_gain_comes_back_from_its_file_with_its_origin(tmp_path):
    policy = LSPI(RIG, iterations=3).train(5).policy
    back = load_policy(policy.save(tmp_path / "gain"))
    assert isinstance(back, GainPolicy)
    assert (back.K == policy.K).all()
    assert back.about["seed"] == 5
    assert back.about["learner"].startswith("LSPI(rig=")
    y = np.random.default_rng(0).normal(size=(7, 6))
    assert (back.start(7, np.random.default_rng(0))(0.0, y) == policy.start(7, np.random.default_rng(0))(0.0, y)).all()


def test_a_gain_acts_alike_after_whole_turns():
    policy = GainPolicy([1.0, -150.0, 180.0, 4.0, -5.0, 30.0])
    y = np.array([[0.1, 0.05, -0.03, 0.2, 0.1, -0.4], [0.1, 0.05 + 4 * np.pi, -0.03 - 2 * np.pi, 0.2, 0.1, -0.4]])
    u = policy.start(2, np.random.default_rng(0))(0.0, y)
    assert u[0] == pytest.approx(u[1], rel=1e-9)
    assert u[0] == pytest.approx(-policy.K @ y[0])


@pytest.mark.parametrize(
    ("kind", "changes", "message"),
    [
        (LSPI, {"gamma": 1.5}, "gamma must be above 0 and at most 1; got 1.5."),
        (LSPI, {"gamma_start": 0.0}, "gamma_start must be above 0 and at most 1; got 0.0."),
        (LSPI, {"force_weight": 0.0}, "force_weight must be finite and greater than 0; got 0.0."),
        (LSPI, {"state_weights": (1.0,)}, "state_weights must be 6 finite numbers, at least 0; got (1.0,)."),
        (LSPI, {"noise": 0.0}, "noise must be finite and greater than 0; got 0.0."),
        (LSPI, {"lam": 2.0}, "lam must be above 0 and at most pi/2; got 2.0."),
        (LSPI, {"angle_cut": 0.0}, "angle_cut must be above 0 and at most pi/2; got 0.0."),
        (LSPI, {"step": 0.0}, "step must be above 0 and at most 1; got 0.0."),
        (LSPI, {"keep": 27}, "keep must be at least 28, the number of features; got 27."),
        (LSPI, {"samples": 0}, "samples must be a whole number, at least 1; got 0."),
        (LSPI, {"iterations": 2.5}, "iterations must be a whole number, at least 1; got 2.5."),
        (QuadraticQLearning, {"alpha": 2.0}, "alpha must be above 0 and below 2; got 2.0."),
        (QuadraticQLearning, {"epsilon": 0.0}, "epsilon must be finite and greater than 0; got 0.0."),
        (QuadraticQLearning, {"scales": (1.0,)}, "scales must be 7 finite numbers greater than 0; got (1.0,)."),
        (QuadraticQLearning, {"force_bound": 0.0}, "force_bound must be finite and greater than 0; got 0.0."),
        (
            LSPI,
            {"rig": RIG.replace(sensor_noise=0.1)},
            "LSPI trains on ideal rigs; got one with lag, delay, noise or rounding. "
            "Train on the ideal rig, then simulate the policy on this one.",
        ),
        (
            QuadraticQLearning,
            {"rig": RIG.replace(mass1=[0.5, 0.6])},
            "QuadraticQLearning takes one plant; got a rig of 2 rows. Take one of them with rig.rows(i).",
        ),
    ],
)
def test_settings_that_make_no_sense_are_refused(kind, changes, message):
    with pytest.raises(ValueError, match=whole(message)):
        replace(kind(RIG), **changes)


def test_a_gain_of_another_shape_is_refused():
    with pytest.raises(ValueError, match=whole("K must have shape (6,); got (2,).")):
        GainPolicy([1.0, 2.0])


def test_every_training_says_how_it_ended_and_what_it_cost():
    learners = (
        LSPI(RIG, iterations=3),
        QuadraticQLearning(RIG, samples=300),
        LinearQLearning(RIG, max_episodes=3),
        GaussianQAC(RIG, max_episodes=3),
    )
    for learner in learners:
        training = learner.train(0)
        assert isinstance(training.outcome, Outcome)
        assert training.converged == (training.outcome is Outcome.CONVERGED)
        assert training.curve["length"].shape == (training.cost.episodes,)
        assert training.cost.steps >= training.curve["length"].sum() > 0
        assert training.cost.test_steps == 0
        assert training.cost.cpu_seconds > 0
        assert hasattr(training.policy, "start")


def test_a_gain_that_settles_has_converged_and_one_that_is_cut_short_has_not():
    assert LSPI(RIG).train([3, 1]).outcome is Outcome.CONVERGED
    assert LSPI(RIG, iterations=3).train([3, 1]).outcome is Outcome.BUDGET_SPENT
    assert LSPI(RIG, iterations=1).train([3, 1]).outcome is Outcome.BUDGET_SPENT
