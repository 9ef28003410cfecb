"""The study of learning curves: quartiles over trainings of different length, times to success, deep trainings."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rich.console import Console

import dpend
from controllers import Constant
from rl import LSPI, GaussianQAC, LinearQLearning
from studies import learning_curves
from studies._study import Job
from tests.rigs import whole

RIG = dpend.rig("gustafsson2016")


def told(rows):
    console = Console(width=200)
    with console.capture() as capture:
        console.print(learning_curves.summary(rows, {}))
    return capture.get()


def write(folder, success, algo="ppo", task="swing-up", env=""):
    """Write the curve and the recipe of a deep training."""
    folder.mkdir(parents=True)
    lines = [f"{1000 * (k + 1)},{share},{share},nan,{3.0 * k},{2.0 * (k + 1)}" for k, share in enumerate(success)]
    (folder / "curve.csv").write_text("\n".join(["steps,success,score,variation,wall_seconds,cpu_seconds", *lines, ""]))
    recipe = {"algo": algo, "task": task, "env": env, "period": 0.04, "evaluation_starts": 400}
    (folder / "recipe.json").write_text(json.dumps({"recipe": recipe, "seed": 3}))


def test_a_thinned_curve_is_the_mean_between_the_edges_as_far_as_it_goes():
    curve = learning_curves.thin(np.array([1.0, 3.0, 5.0, 9.0, 2.0]), np.array([0.0, 2.0, 4.0, 8.0, 16.0]))
    assert_array_equal(curve, [2.0, 7.0, 2.0, np.nan])
    assert np.isnan(learning_curves.thin(np.zeros(0), np.array([0.0, 2.0]))).all()


def test_a_training_that_ended_goes_on_at_its_tail_in_the_quartiles():
    nan = np.nan
    curves = [np.array([1.0, 2.0, nan]), np.array([3.0, nan, nan]), np.array([5.0, 6.0, 7.0])]
    low, middle, high = learning_curves.quartiles(curves, [300.0, 4.0, 0.0])
    assert_allclose(middle, [3.0, 4.0, 7.0])
    assert_allclose(low, [2.0, 3.0, 5.5])
    assert_allclose(high, [4.0, 5.0, 153.5])


def test_curves_with_points_of_their_own_meet_on_a_grid_and_go_on_at_their_last_value():
    x, y = [np.array([0.0, 2.0]), np.array([0.0, 4.0])], [np.array([0.0, 1.0]), np.array([1.0, 0.0])]
    band = learning_curves.quartiles_between(x, y, np.array([1.0, 4.0]))
    assert_allclose(band[1], [0.625, 0.5])


def test_a_share_is_reached_when_first_seen_and_kept_after_the_last_evaluation_below_it():
    costs, shares = np.array([1.0, 2.0, 4.0, 8.0]), np.array([0.0, 0.95, 0.5, 1.0])
    assert learning_curves.reached(costs, shares, 0.01) == 2.0
    assert learning_curves.reached(costs, shares, 0.95) == 2.0
    assert learning_curves.kept(costs, shares) == 8.0
    assert np.isnan(learning_curves.reached(costs, 0.9 * shares, 0.95))
    assert np.isnan(learning_curves.kept(costs[:3], shares[:3]))
    assert np.isnan(learning_curves.reached(np.zeros(0), np.zeros(0), 0.95))


def test_trainings_that_never_get_there_count_as_more_than_all_others():
    assert learning_curves.typical([3.0, 1.0, 2.0]) == "2\n1\n3"
    assert learning_curves.typical([3.0, np.nan, 2.0]) == "3\n2\n3\n1 never"
    assert learning_curves.typical([3.0, np.nan, np.nan]) == "never\n3\n3\n2 never"
    assert learning_curves.typical([np.nan, np.nan]) == "2 never"


@pytest.mark.parametrize(
    "learner",
    [
        pytest.param(LinearQLearning.published(RIG), marks=pytest.mark.slow),
        LinearQLearning.tuned(RIG, select=False),
        GaussianQAC.published(RIG, indicators="signs"),
        GaussianQAC.tuned(RIG),
        LSPI(RIG),
    ],
    ids=["Q published", "Q tuned", "QAC published", "QAC tuned", "LSPI"],
)
def test_the_last_policy_on_the_way_is_the_one_that_the_training_gives_after_all_its_experience(learner):
    training = learning_curves.small(learner).train(5)
    samples, policies = learning_curves.snapshots(training, 4)
    assert 1 <= len(samples) == len(policies) <= 4
    assert (np.diff(samples) > 0).all()
    assert samples[-1] == training.steps + training.test_steps
    y = np.random.default_rng(0).normal(size=(20, 6)) * 0.1
    last, given = (policy.start(20, np.random.default_rng(0))(0.0, y) for policy in (policies[-1], training.policy))
    assert_array_equal(last, given)


def test_a_policy_on_the_way_is_the_one_of_a_training_that_ends_there():
    learner = LinearQLearning.tuned(RIG, select=False)
    long, short = (replace(learner, max_episodes=n).train(2) for n in (30, 12))
    assert_array_equal(long.weights[11], short.policy.weights)
    learner = GaussianQAC.published(RIG)
    long, short = (replace(learner, max_episodes=n).train(2) for n in (8, 5))
    assert_array_equal(long.weights[4], short.v)


def test_acceptance_tests_are_counted_after_the_episode_that_they_followed():
    learner = LinearQLearning(
        rig=RIG, task=dpend.Balance(steps=5), streak=2, acceptance=((0.1, 1.0),), acceptance_episodes=3, max_episodes=6
    )
    training = learner.train(0)
    assert training.test_steps == training.tested.sum() > 0
    assert training.tested[0] == 0 < training.tested[1]


def test_deep_trainings_that_are_there_are_read_and_those_that_are_not_are_named(tmp_path):
    write(tmp_path / "ppo-swing-up" / "seed-3", [0.0, 0.5, 0.96, 0.9, 1.0])
    write(tmp_path / "sac-balance" / "seed-0", [0.0, 0.1], algo="sac", task="balance")
    write(tmp_path / "ppo-invertedpendulum" / "seed-0", [1.0], env="InvertedPendulum-v5")
    (tmp_path / "td3-swing-up" / "seed-0").mkdir(parents=True)  # has only just begun
    options = learning_curves.Options(deep=tmp_path, trainings=1)
    jobs = [job for job in learning_curves.jobs(options) if "@" in job.setting]
    assert [(job.setting.partition("@")[0], job.repetition) for job in jobs] == [
        ("sac-balance", 0),
        ("ppo-swing-up", 3),
    ]
    results = {learning_curves._study.slug(job): learning_curves.run(job, options) for job in jobs}
    balance, swing = (result.rows[0] for result in results.values())
    assert (swing.training, swing.lam, swing.share) == (3, 0.0, 1.0)
    assert_allclose([swing.first, swing.first_cpu, swing.most, swing.most_cpu, swing.kept], [80, 4, 120, 6, 200])
    assert_allclose(swing.experience, 200)
    assert balance.lam == 0.3
    assert np.isnan(balance.most)
    assert learning_curves.missing([balance, swing]) == [
        "ppo-balance", "ddpg-balance", "td3-balance", "ddpg-swing-up", "td3-swing-up", "sac-swing-up"
    ]  # fmt: skip
    assert (
        "No trainings there of ppo-balance, ddpg-balance, td3-balance, ddpg-swing-up, td3-swing-up, sac-swing-up: "
        "left out." in told([balance, swing])
    )
    figures: Any = learning_curves.plot([balance, swing], {job: dict(result.traces) for job, result in results.items()})
    words = [text.get_text() for figure in figures.values() for axis in figure.axes for text in axis.texts]
    assert "not there: trainings of PPO, DDPG, TD3" in words
    assert "not there: trainings of DDPG, TD3, SAC" in words


def test_a_deep_training_that_goes_on_is_read_anew(tmp_path):
    options = learning_curves.Options(deep=tmp_path)
    write(tmp_path / "ppo-swing-up" / "seed-0", [0.0])
    before = learning_curves.jobs(options)[-1]
    (tmp_path / "ppo-swing-up" / "seed-0" / "curve.csv").write_text("steps,success,score,variation,wall_seconds\n")
    assert learning_curves.jobs(options)[-1] != before


def test_a_learner_is_judged_at_both_spreads_and_its_curve_kept():
    options = learning_curves.Options(trainings=1, starts=20, quick=True)
    result = learning_curves.run(Job("LSPI"), options)
    assert [row.lam for row in result.rows] == [0.1, 0.3]
    assert {"episodes", "curve", "tail", "experience", "share 0.1", "share 0.3"} == set(result.traces)
    assert len(result.traces["curve"]) == len(result.traces["episodes"])


@pytest.mark.parametrize(("name", "value"), [("trainings", 0), ("starts", 1)])
def test_options_without_a_sense_are_refused(name, value):
    least = {"trainings": 1, "starts": 2}[name]
    with pytest.raises(ValueError, match=whole(f"--{name} must be at least {least}; got {value}.")):
        learning_curves.Options(**{name: value})


def test_scaled_features_learn_to_leave_the_track_at_full_force_in_place_of_the_swing_up():
    learner: Any = learning_curves.SWINGING["swing-up, scaled"].make(RIG)
    training = learner.train([0, 15, 0])
    off = dpend.simulate(
        RIG, Constant(40.0), learner.task.starts(np.random.default_rng(0), 1, RIG)[0], task=learner.task
    )
    assert off.status is dpend.Status.TRACK_END
    assert np.median(training.lengths[-500:]) == len(off.u) == 22
    cost = learner.task.cost(off.x[1:].copy(), np.zeros(22, dtype=np.uint8))
    assert_allclose(np.median((training.rewards / training.lengths)[-500:]), -cost.mean())
    assert not (training.upright >= 50).any()
