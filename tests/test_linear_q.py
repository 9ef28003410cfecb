"""Linear Q-learning: the compiled loop against Algorithm 1 written out, its outcomes, its refusals."""

import re
from dataclasses import replace

import numpy as np
import pytest

import dpend
from rl import LinearQLearning, LinearQPolicy, Outcome, load_policy
from rl.features import make_value_features, slope_features
from rl.linear_q import _STREAM

RIG = dpend.rig("gustafsson2016")


def algorithm_1(learner, seed, episodes):
    """The report's Algorithm 1 over the stepper, step by step as printed."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_STREAM,)))
    w, scales, forces = np.zeros(18), np.array(learner.scales), np.array(learner.forces)
    stepper, task = dpend.Stepper(learner.rig, 1), learner.task

    def features(x, a):
        return scales * np.array([*make_value_features()(x), *(a * slope for slope in slope_features(x))])

    def greedy(x):
        return forces[int(np.argmax([w @ features(x, a) for a in forces]))]

    lengths = []
    for episode in range(episodes):
        alpha = learner.alpha / (1 + learner.alpha_decay * episode)
        epsilon = learner.epsilon / (1 + learner.epsilon_decay * episode)
        if isinstance(task, dpend.Balance):
            th1, th2 = (spread * rng.uniform(-1, 1) for spread in task.angle_spreads)
        else:
            th1, th2 = (np.pi / 2 + task.angle_spread * rng.uniform(-1, 1) for _ in range(2))
        s = stepper.reset([0, th1, th2, 0, 0, 0])[0]
        t, failed = 0, False
        while t < task.steps and not failed:
            a = forces[rng.integers(0, len(forces))] if rng.random() < epsilon else greedy(s)
            s_next = stepper.step([a])[0]
            codes = task.ended(s_next[None], learner.rig)
            failed = bool(codes[0])
            target = -task.cost(s_next[None], codes)[0]
            if learner.bootstrap_failure or not failed:
                target += learner.gamma * w @ features(s_next, greedy(s_next))
            w = w + alpha * (target - w @ features(s, a)) * features(s, a)
            s, t = s_next, t + 1
        lengths.append(t)
    return w, lengths


@pytest.mark.parametrize(
    "learner",
    [
        LinearQLearning.published(RIG, task=dpend.Balance(failure_cost=3.0, state_weights=(1, 2, 3))),
        replace(LinearQLearning.published(RIG, task=dpend.Balance(criterion="report")), epsilon=0.3),
        LinearQLearning.published(RIG, task=dpend.Balance(lam2=0.0)),
        LinearQLearning.tuned(RIG, select=False),
        LinearQLearning(RIG, task=dpend.SwingUp(start="side", angle_spread=0.1, steps=120), alpha=1e-6, epsilon=0.3),
    ],
    ids=["published", "exploring", "link 2 upright", "tuned", "swing-up"],
)
def test_the_compiled_loop_does_what_algorithm_1_says(learner):
    learner = replace(learner, max_episodes=4, streak=99)
    w, lengths = algorithm_1(learner, 5, 4)
    training = learner.train(5)
    assert list(training.curve["length"]) == lengths
    np.testing.assert_allclose(training.policy.weights, w, rtol=1e-6, atol=1e-9 * np.abs(w).max())


@pytest.mark.parametrize(("hold", "converges"), [(0.1, True), (3.0, False)])
def test_a_swing_up_counts_as_successful_when_it_ends_with_both_links_up_for_long_enough(hold, converges):
    task = dpend.SwingUp(start="up-up", angle_spread=0.05, steps=100, hold=hold, upright_angle=0.2)
    learner = replace(LinearQLearning.tuned(RIG, select=False), task=task, streak=5, max_episodes=400)
    training = learner.train(0)
    assert training.converged == converges
    if converges:
        assert (training.curve["length"][-5:] == 100).all()
        assert (training.curve["upright"][-5:] >= 5).all()
    assert (training.curve["upright"] <= training.curve["length"]).all()


def test_balancing_counts_every_sample_as_upright():
    training = replace(LinearQLearning.tuned(RIG, select=False), max_episodes=30).train(0)
    assert (training.curve["upright"] == training.curve["length"]).all()


def test_initial_weights_may_be_drawn():
    learner = replace(LinearQLearning.published(RIG), alpha=1e-300, max_episodes=1, init_std=2.0)
    w = learner.train(0).policy.weights
    assert 0.8 < w.std() < 4.0
    assert (w != learner.train(1).policy.weights).all()


def test_learning_goes_on_from_given_weights_from_the_starts_that_it_records():
    learner = replace(LinearQLearning.published(RIG, cart_features=False), epsilon=0.0, max_episodes=20)
    begun = learner.train(3)
    w = begun.details["weights"][11]
    going_on = replace(learner, initial=tuple(w), max_episodes=1).train(4)
    x0 = np.array([0.0, *going_on.details["angles"][0], 0.0, 0.0, 0.0])
    frozen = replace(learner, initial=tuple(w), alpha=1e-300, max_episodes=1).train(4)
    run = dpend.simulate(RIG, frozen.policy, x0, task=learner.task)
    assert frozen.curve["length"][0] == len(run.u)
    np.testing.assert_allclose(frozen.policy.weights, w, rtol=1e-12)
    assert (going_on.policy.weights != w).any()


def test_the_same_seed_learns_the_same_and_another_something_else():
    learner = replace(LinearQLearning.tuned(RIG, select=False), max_episodes=30)
    one, same, other = (learner.train(seed).policy.weights for seed in (0, 0, 1))
    assert (one == same).all()
    assert (one != other).any()


def test_as_published_the_weights_overflow():
    training = LinearQLearning.published(RIG).train(0)
    assert training.outcome is Outcome.DIVERGED
    assert not training.converged
    assert np.isfinite(training.policy.weights).all()
    assert np.abs(training.policy.weights).max() > 1e200


@pytest.mark.slow
def test_tuned_it_balances():
    task = dpend.Balance(lam=0.2)
    starts = task.starts(np.random.default_rng(9), 200, RIG)
    for seed in (101, 102):
        training = LinearQLearning.tuned(RIG).train(seed)
        assert training.converged
        assert dpend.simulate_many(RIG, training.policy, starts, task=task).success.mean() > 0.9


def test_every_step_of_learning_and_of_testing_is_counted():
    reports = []
    training = LinearQLearning.tuned(RIG).train(101, progress=reports.append)
    assert training.cost.steps == training.curve["length"].sum()
    assert training.cost.episodes == len(training.curve["length"]) == len(training.curve["reward"])
    assert (
        20_000 < training.cost.test_steps < 10_000_000
    )  # at least the last test: 100 starts, nearly all of 300 samples
    assert reports == sorted(reports)
    assert reports[-1] == 1.0


def test_the_last_successes_are_the_streak_that_ended_learning():
    training = LinearQLearning.tuned(RIG, select=False).train(3)
    assert training.converged
    assert (training.curve["length"][-20:] == 300).all()
    assert training.curve["length"][-21] < 300
    assert training.cost.test_steps == 0


def test_it_restarts_where_it_does_not_converge():
    learner = replace(LinearQLearning.published(RIG, cart_features=False), restart_after=10, max_episodes=35)
    training = learner.train(0)
    assert (training.outcome, training.details["restarts"], training.cost.episodes) == (Outcome.BUDGET_SPENT, 3, 35)


def test_features_of_scale_zero_keep_weight_zero():
    training = replace(LinearQLearning.published(RIG, cart_features=False), max_episodes=20).train(0)
    w = training.policy.weights
    assert (w[[0, 1, 6, 7, 12, 13]] == 0).all()
    assert (w[[2, 3, 4, 5]] != 0).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"alpha": 0.0}, "alpha must be finite and greater than 0; got 0.0."),
        ({"alpha_decay": -1.0}, "alpha_decay must be finite and at least 0; got -1.0."),
        ({"gamma": 1.5}, "gamma must be above 0 and at most 1; got 1.5."),
        ({"epsilon": -0.1}, "epsilon must be within 0 and 1; got -0.1."),
        ({"epsilon_decay": -0.1}, "epsilon_decay must be finite and at least 0; got -0.1."),
        ({"streak": 0}, "streak must be a whole number, at least 1; got 0."),
        ({"acceptance_episodes": 0}, "acceptance_episodes must be a whole number, at least 1; got 0."),
        ({"restart_after": 0}, "restart_after must be a whole number, at least 1; got 0."),
        ({"max_episodes": 0}, "max_episodes must be a whole number, at least 1; got 0."),
        ({"init_std": -1.0}, "init_std must be finite and at least 0; got -1.0."),
        ({"initial": (1.0,)}, "initial must be 18 finite numbers; got (1.0,)."),
        ({"scales": (1.0,)}, "scales must be 18 finite numbers; got (1.0,)."),
        ({"forces": {1.0, 2.0}}, "forces must be a list of finite numbers; got {1.0, 2.0}."),
        ({"forces": (50.0,)}, "forces must be a list of forces within the rig's limit of 40 N; got (50.0,)."),
        (
            {"rig": RIG.replace(sensor_noise=0.1)},
            "LinearQLearning trains on ideal rigs; got one with lag, delay, noise or rounding. "
            "Train on the ideal rig, then simulate the policy on this one.",
        ),
        (
            {"task": dpend.SwingUp(start="side"), "acceptance": ((0.1, 0.9),)},
            "Acceptance tests are of balancing; leave acceptance empty for a swing-up.",
        ),
        (
            {"task": dpend.SwingUp(start="anywhere")},
            f"A swing-up that is learned starts at rest and ends with both links up; "
            f"got {dpend.SwingUp(start='anywhere')!r}.",
        ),
        (
            {"rig": RIG.replace(mass1=[0.5, 0.6])},
            "LinearQLearning takes one plant; got a rig of 2 rows. Take one of them with rig.rows(i).",
        ),
    ],
)
def test_settings_that_make_no_sense_are_refused(changes, message):
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        replace(LinearQLearning.published(RIG), **changes)


def test_a_saved_policy_comes_back(tmp_path):
    policy = LinearQPolicy(np.arange(18.0), np.ones(18), (0.0, -40.0, 40.0))
    back = load_policy(policy.save(tmp_path / "policy"))
    for name in ("weights", "scales", "forces"):
        assert (getattr(back, name) == getattr(policy, name)).all()


def test_a_foreign_file_is_refused_and_runs_nothing(tmp_path):
    file = tmp_path / "foreign.npz"
    np.savez(file, format=np.array(["x", object()], dtype=object))  # would need pickle to read
    with pytest.raises(ValueError, match=rf"^{re.escape(str(file))} cannot be read as 'dpend policy 2': "):
        load_policy(file)
    file.write_bytes(b"PK\x03\x04 cut short")
    with pytest.raises(ValueError, match=r"cannot be read as 'dpend policy 2'"):
        load_policy(file)
    with pytest.raises(FileNotFoundError):
        load_policy(tmp_path / "none.npz")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((np.ones(3), np.ones(18), (1.0,)), "weights must have shape (18,); got (3,)."),
        ((np.full(18, np.nan), np.ones(18), (1.0,)), "weights must be finite."),
        ((np.ones(18), np.ones(18), ()), "forces must have shape (m,); got (0,)."),
    ],
)
def test_a_policy_of_wrong_arrays_is_refused(arguments, message):
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        LinearQPolicy(*arguments)


def test_published_has_the_reports_numbers():
    learner = LinearQLearning.published(RIG)
    assert (learner.alpha, learner.epsilon, learner.gamma, learner.bootstrap_failure) == (1e-4, 0.01, 0.99, True)
    assert (learner.alpha_decay, learner.epsilon_decay, learner.acceptance, learner.restart_after) == (0, 0, (), None)
    assert sorted(learner.forces) == [-40, -20, -10, -5, 0, 5, 10, 20, 40]
    assert set(learner.scales) == {1.0}
    assert isinstance(learner.task, dpend.Balance)
    assert (learner.task.lam, learner.task.steps, learner.task.criterion) == (0.1, 300, "report")


def test_tuned_has_the_numbers_that_the_documentation_lists():
    learner = LinearQLearning.tuned(RIG)
    assert learner.acceptance == ((0.3, 0.82), (0.1, 0.99))
    assert (learner.acceptance_episodes, learner.streak) == (100, 20)
    assert (learner.restart_after, learner.max_episodes) == (1000, 20_000)
    assert isinstance(learner.task, dpend.Balance)
    assert learner.task.criterion == "strict"


def test_learning_goes_on_until_a_policy_is_accepted_and_all_tests_are_counted(monkeypatch):
    asked = []

    def stub(self, policy, rng):
        asked.append(policy.weights.copy())
        return len(asked) == 3, 1000

    monkeypatch.setattr(LinearQLearning, "_accept", stub)
    learner = replace(LinearQLearning.tuned(RIG), restart_after=None)
    training = learner.train(3)
    assert training.converged
    assert len(asked) == 3
    assert training.cost.test_steps == 3000
    assert (training.policy.weights == asked[-1]).all()
    successes = training.curve["length"] == 300
    tested = [k for k in range(20, len(successes) + 1) if successes[k - 20 : k].all()]
    assert successes[-20:].all()
    assert len(tested) >= 3


@pytest.mark.parametrize(("weak", "passes"), [(0, True), (1, False), (2, False)])
def test_a_policy_must_save_its_share_at_every_lambda_that_is_asked(weak, passes, monkeypatch):
    lams = []

    class Saved:
        def __init__(self, n, share):
            self.success = np.arange(n) < round(share * n)
            self.steps = np.full(n, 7)

    def simulated(rig, policy, starts, task):
        lams.append(task.lam)
        assert np.abs(starts[:, 1:3]).max() <= task.lam
        assert np.abs(starts[:, 1:3]).max() > 0.8 * task.lam
        return Saved(len(starts), {0.3: 0.81 if weak == 1 else 0.82, 0.1: 0.98 if weak == 2 else 0.99}[task.lam])

    monkeypatch.setattr("rl.linear_q.simulate_many", simulated)
    policy = LinearQPolicy(np.ones(18), np.ones(18), (-40.0, 40.0))
    passed, samples = LinearQLearning.tuned(RIG)._accept(policy, np.random.default_rng(0))
    assert passed == passes
    assert lams == ([0.3] if weak == 1 else [0.3, 0.1])
    assert samples == 700 * len(lams)


def test_exploration_and_step_size_fall_with_the_episodes_since_the_restart():
    learner = replace(LinearQLearning.tuned(RIG, select=False), max_episodes=400, streak=999, alpha_decay=1e6)
    first = replace(learner, max_episodes=1).train(1).policy.weights
    frozen = learner.train(1).policy.weights  # after the first episode the step size is next to nothing
    np.testing.assert_allclose(frozen, first, atol=0.02 * np.abs(first).max())


def test_a_policy_says_where_it_comes_from(tmp_path):
    policy = LinearQLearning.tuned(RIG).train(101).policy
    about = load_policy(policy.save(tmp_path / "p")).about
    assert (about["seed"], about["outcome"]) == (101, "CONVERGED")
    assert "alpha=0.00473758" in about["learner"]
