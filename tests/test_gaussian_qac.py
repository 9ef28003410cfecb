"""Gaussian QAC: the compiled loop against Algorithm 2 written out, the score function, the tuned learner, refusals."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import dpend
from rl import GainPolicy, GaussianQAC, NaturalQAC, Outcome, TableOneMean
from rl.features import make_value_features, slope_features
from rl.natural_qac import _Critic, ablations
from rl.qac import _STREAM
from tests.rigs import whole

RIG = dpend.rig("gustafsson2016")


def indicators(x, kind):
    positive = [x[0] > 0, dpend.wrap(x[1]) > 0, dpend.wrap(x[2]) > 0]
    if kind == "signs":
        return [float(sign) for sign in positive]
    cell = sum(4 >> k for k in range(3) if positive[k])
    return [float(k == cell) for k in range(8)] if kind == "cells" else []


def algorithm_2(learner, seed, episodes):
    """The report's Algorithm 2 over the stepper, step by step as printed."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_STREAM,)))
    stepper, task, sigma = dpend.Stepper(learner.rig, 1), learner.task, learner.sigma

    def phi(s):
        return np.array([*make_value_features()(s), *indicators(s, learner.indicators)])

    def x(s, a):
        return np.array([*phi(s), *(a * slope for slope in slope_features(s))])

    m = len(phi(np.zeros(6)))
    v, w = learner.init_std * rng.standard_normal(m), learner.init_std * rng.standard_normal(m + 6)
    lengths = []
    for _ in range(episodes):
        th1, th2 = (task.lam * rng.uniform(-1, 1) for _ in range(2))
        s = stepper.reset([0, th1, th2, 0, 0, 0])[0].copy()
        a = phi(s) @ v + sigma * rng.standard_normal()
        t, failed = 0, False
        while t < task.steps and not failed:
            s_next = stepper.step([a])[0].copy()
            codes = task.ended(s_next[None], learner.rig)
            failed = bool(codes[0])
            r = -task.cost(s_next[None], codes)[0]
            a_next = phi(s_next) @ v + sigma * rng.standard_normal()
            v_next = v + learner.alpha * (a - phi(s) @ v) * phi(s) / sigma**2 * (x(s, a) @ w)
            delta = r + learner.gamma * x(s_next, a_next) @ w - x(s, a) @ w
            w = w + learner.beta * delta * x(s, a)
            v, s, a, t = v_next, s_next, a_next, t + 1
        lengths.append(t)
    return v, w, lengths


@pytest.mark.slow
@pytest.mark.parametrize(
    "learner",
    [
        GaussianQAC.published(RIG, alpha=1e-5, beta=1e-5, variance=10.0),
        GaussianQAC.published(RIG, alpha=1e-5, beta=1e-4, variance=1.0, init_std=0.1, indicators="signs"),
        GaussianQAC.published(RIG, alpha=1e-6, beta=1e-5, variance=100.0, init_std=3.0, indicators="cells"),
        GaussianQAC(RIG, task=dpend.Balance(failure_cost=3.0, state_weights=(1, 2, 3)), sigma=30.0, beta=1e-6),
    ],
    ids=["published", "signs", "cells", "saturating"],
)
def test_the_compiled_loop_does_what_algorithm_2_says(learner):
    v, w, lengths = algorithm_2(learner, 5, 4)
    training = replace(learner, max_episodes=4).train(5)
    assert list(training.curve["length"]) == lengths
    assert_allclose(training.details["v"], v, rtol=1e-6, atol=1e-9 * np.abs(v).max())
    assert_allclose(training.details["w"], w, rtol=1e-6, atol=1e-9 * np.abs(w).max())


def test_the_score_function_has_zero_mean_and_fishers_matrix_is_its_second_moment():
    rng = np.random.default_rng(0)
    phi, v, sigma, n = rng.normal(size=12), rng.normal(size=12), 1.7, 200_000
    a = phi @ v + sigma * rng.standard_normal(n)
    score = (a - phi @ v)[:, None] * phi / sigma**2
    assert_allclose(score.mean(axis=0), 0.0, atol=5 * np.abs(phi).max() / sigma / np.sqrt(n))
    assert_allclose(score.T @ score / n, np.outer(phi, phi) / sigma**2, atol=0.02)


def test_the_gradient_in_closed_form_is_the_mean_of_the_sampled_one():
    rng = np.random.default_rng(1)
    n, sigma, v = 100_000, 0.3, 0.1 * rng.normal(size=6)
    s = rng.normal(size=(n, 6))
    z = np.column_stack([s, s @ v + sigma * rng.standard_normal(n)])
    for critic in ("quadratic", "table 1"):
        closed, sampled = (
            _Critic(NaturalQAC(RIG, critic=critic, closed_form=form, natural=False)) for form in (True, False)
        )
        closed.w[:] = sampled.w[:] = 0.1 * rng.normal(size=len(closed.w))
        exact, drawn = closed.gradient(z, v, sigma, n), sampled.gradient(z, v, sigma, n)
        assert_allclose(drawn, exact, atol=0.1 * np.abs(exact).max())


def test_the_natural_gradient_undoes_fishers_matrix():
    rng = np.random.default_rng(2)
    z, v = rng.normal(size=(500, 7)) * np.array([1, 5, 0.2, 3, 1, 1, 1]), rng.normal(size=6)
    natural, plain = (_Critic(NaturalQAC(RIG, natural=natural)) for natural in (True, False))
    natural.w[:] = plain.w[:] = rng.normal(size=29)
    fisher = z[:, :6].T @ z[:, :6] / len(z)
    assert_allclose(fisher @ natural.gradient(z, v, 0.3, 10), plain.gradient(z, v, 0.3, 10))


def test_the_critic_finds_the_exact_q_of_a_noisy_linear_policy():
    rng = np.random.default_rng(3)
    A, B = 0.3 * rng.normal(size=(6, 6)), rng.normal(size=(6, 1))
    Q, v, sigma, gamma = np.diag(rng.uniform(0.5, 2.0, 6)), 0.05 * rng.normal(size=6), 0.4, 0.8
    AB, F = np.hstack([A, B]), A + B @ v[None]
    H, constant = np.eye(7), 0.0
    for _ in range(400):  # the Bellman equation, iterated to its fixed point
        M = np.vstack([np.eye(6), v])
        P = M.T @ H @ M
        H, constant = np.diag([*np.diag(Q), 1.0]) + gamma * AB.T @ P @ AB, gamma * (constant + sigma**2 * H[6, 6])
    assert np.abs(np.linalg.eigvals(F)).max() < 1.1
    z = rng.normal(size=(800, 7))
    critic = _Critic(NaturalQAC(RIG))
    cost = np.einsum("ij,jk,ik->i", z[:, :6], Q, z[:, :6]) + z[:, 6] ** 2
    critic.learn(z, z @ AB.T, np.ones(800, dtype=np.bool_), cost, v, sigma, gamma, 800)
    q = critic.features(z) @ critic.w
    exact = np.einsum("ij,jk,ik->i", z, H, z) + constant
    assert_allclose(q, exact, rtol=1e-3, atol=1e-3 * np.abs(exact).max())


@pytest.mark.slow
def test_as_published_with_large_steps_the_weights_overflow_and_with_small_ones_nothing_is_learned():
    diverged = GaussianQAC.published(RIG, alpha=1e-2, beta=1e-2).train(0)
    assert diverged.outcome is Outcome.DIVERGED
    assert np.isfinite(diverged.details["v"]).all()
    assert np.isfinite(diverged.details["w"]).all()
    small = GaussianQAC.published(RIG, alpha=1e-7, beta=1e-7, variance=10.0, max_episodes=500).train(0)
    assert small.outcome is Outcome.BUDGET_SPENT
    assert not small.curve["success"].any()
    assert small.cost.episodes == len(small.curve["length"]) == len(small.curve["reward"]) == 500
    assert small.cost.steps == small.curve["length"].sum()


@pytest.mark.slow
def test_tuned_it_balances_and_saves_what_a_regulator_saves():
    task = dpend.Balance(lam=0.3)
    starts = task.starts(np.random.default_rng(9), 200, RIG)
    training = GaussianQAC.tuned(RIG).train(501)
    assert training.converged
    assert isinstance(training.policy, GainPolicy)
    assert_allclose(training.policy.K, training.details["gains"][-1])
    assert dpend.simulate_many(RIG, training.policy, starts, task=task).success.mean() > 0.75
    assert training.cost.episodes == 400
    assert training.cost.steps == training.curve["length"].sum()
    assert len(training.curve["success"]) == 400
    assert list(training.details["updated"]) == list(range(2, 401, 2))


@pytest.mark.slow
def test_the_same_seed_learns_the_same_and_another_something_else():
    for learner in (
        replace(GaussianQAC.tuned(RIG), max_episodes=20),
        GaussianQAC.published(RIG, alpha=1e-6, beta=1e-6, init_std=1.0, max_episodes=20),
    ):
        one, same, other = (learner.train(seed).details["v"] for seed in (0, 0, 1))
        assert (one == same).all()
        assert (one != other).any()


def test_progress_is_reported():
    reports = []
    GaussianQAC.published(RIG, alpha=1e-8, beta=1e-8, max_episodes=1100).train(0, progress=reports.append)
    assert reports == [500 / 1100, 1000 / 1100, 1.0, 1.0]


def test_each_ablation_differs_from_the_tuned_learner_in_one_thing():
    variants = ablations(RIG)
    tuned = variants.pop("tuned")
    assert tuned == GaussianQAC.tuned(RIG)
    assert [int(name.split()[0]) for name in variants] == list(range(1, len(variants) + 1))
    for variant in variants.values():
        assert variant != tuned
        assert variant.rig == tuned.rig
        assert variant.max_episodes == tuned.max_episodes


def test_the_mean_policy_is_the_policy_without_noise():
    rng = np.random.default_rng(4)
    y = rng.normal(size=(50, 6))
    y[:, 1:3] += 2 * np.pi * rng.integers(-2, 3, size=(50, 2))
    for kind, more in (("none", 0), ("signs", 3), ("cells", 8)):
        v = rng.normal(size=12 + more)
        u = TableOneMean(v, kind).start(50, rng)(0.0, y)
        assert_allclose(u, [v @ [*make_value_features()(x), *indicators(x, kind)] for x in y])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"alpha": 0.0}, "alpha must be finite and greater than 0; got 0.0."),
        ({"beta": -1.0}, "beta must be finite and greater than 0; got -1.0."),
        ({"sigma": 0.0}, "sigma must be finite and greater than 0; got 0.0."),
        ({"gamma": 1.5}, "gamma must be above 0 and at most 1; got 1.5."),
        ({"init_std": -0.1}, "init_std must be finite and at least 0; got -0.1."),
        ({"streak": 0}, "streak must be a whole number, at least 1; got 0."),
        ({"max_episodes": 1.5}, "max_episodes must be a whole number, at least 1; got 1.5."),
        ({"indicators": "sines"}, "indicators must be one of 'none', 'signs', 'cells'; got 'sines'."),
        (
            {"rig": RIG.replace(sensor_noise=0.1)},
            "GaussianQAC trains on ideal rigs; got one with lag, delay, noise or rounding. "
            "Train on the ideal rig, then simulate the policy on this one.",
        ),
        (
            {"rig": RIG.replace(mass1=[0.5, 0.6])},
            "GaussianQAC takes one plant; got a rig of 2 rows. Take one of them with rig.rows(i).",
        ),
    ],
)
def test_settings_that_make_no_sense_are_refused(changes, message):
    with pytest.raises(ValueError, match=whole(message)):
        replace(GaussianQAC.published(RIG), **changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"critic": "cubic"}, 'critic must be "quadratic" or "table 1"; got \'cubic\'.'),
        ({"scales": (1.0,)}, "scales must be 7 finite numbers greater than 0; got (1.0,)."),
        ({"state_costs": (1.0,)}, "state_costs must be 6 finite numbers, at least 0, or None; got (1.0,)."),
        ({"replay": -1}, "replay must be at least 0; got -1."),
        ({"norm_cap": 0.0}, "norm_cap must be greater than 0; got 0.0."),
        ({"gamma_start": 0.0}, "gamma_start must be above 0 and at most 1; got 0.0."),
        ({"gamma_updates": 0.0}, "gamma_updates must be finite and greater than 0; got 0.0."),
        ({"angle_cut": 2.0}, "angle_cut must be above 0 and at most pi/2; got 2.0."),
        ({"episodes_per_update": 0}, "episodes_per_update must be a whole number, at least 1; got 0."),
        ({"relax_from": -1}, "relax_from must be at least 0; got -1."),
        ({"relax_to": 80}, "relax_to must be greater than relax_from = 80; got 80."),
        ({"relaxed_cost": 0.0}, "relaxed_cost must be finite and greater than 0; got 0.0."),
        ({"relaxed_sigma": 0.0}, "relaxed_sigma must be finite and greater than 0; got 0.0."),
    ],
)
def test_tuned_settings_that_make_no_sense_are_refused(changes, message):
    with pytest.raises(ValueError, match=whole(message)):
        NaturalQAC(RIG, **changes)
