"""The study of learning curves: quartiles over trainings of different length, times to success, deep trainings."""

import json
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import dpend
from controllers import LQR, Constant
from rl import Cost, DeepRecipe, GaussianQAC, LinearQLearning, Outcome, Training, deep, load_policy
from rl.deep import Evaluation
from studies import _field, learning_curves
from studies._field import Contender
from studies._table import Table
from studies.learning_curves import Job, Options
from tests.rigs import whole

RIG = dpend.rig("gustafsson2016")


def write(folder, success, algo: Any = "ppo", task: Any = "swing-up"):
    """Write the curve, the recipe and a policy of a deep training, seed 3, as training does."""
    recipe = DeepRecipe(RIG, algo=algo, task=task, evaluation_starts=400)
    policy = load_policy("ppo-balance" if task == "balance" else "ppo-swing-up")
    curve = [Evaluation(1000 * (k + 1), each, each, np.nan, 3.0 * k, 2.0 * (k + 1)) for k, each in enumerate(success)]
    folder.mkdir(parents=True, exist_ok=True)
    deep._write_curve(folder / "curve.csv", curve)
    (folder / "recipe.json").write_text(json.dumps({"recipe": recipe.to_dict(), "seed": 3}))
    policy.save(folder / "policy.npz")


def table(jobs):
    """Run jobs and return the table of what they return."""
    results = [learning_curves.run(job) for job in jobs]
    rows = [
        {"job": k, "learner": job.learner, "training": job.training} | row
        for k, (job, result) in enumerate(zip(jobs, results, strict=True))
        for row in result.rows
    ]
    return Table(pd.DataFrame(rows), False, {k: result.arrays for k, result in enumerate(results)})


def test_a_thinned_curve_is_the_mean_of_each_stretch_as_far_as_it_goes():
    edges = learning_curves.edges(10_000)
    assert_array_equal(edges[:4], [0, 1, 2, 3])
    assert np.diff(edges).max() == 300
    assert_array_equal(learning_curves.edges(50), edges[: len(learning_curves.edges(50))])
    values = np.arange(50.0)
    thinned = learning_curves.thin(values)
    assert_array_equal(thinned[:40], values[:40])
    assert_array_equal(thinned[40:], [40.5, 42.5, 44.5, 46.5, 48.5])
    assert_array_equal(learning_curves.thin(values[:42])[-1], 40.5)
    assert len(learning_curves.thin(np.zeros(0))) == 0


def test_a_training_that_ended_goes_on_at_its_tail_in_the_quartiles():
    curves = [np.array([1.0, 2.0]), np.array([3.0]), np.array([5.0, 6.0, 7.0])]
    low, middle, high = learning_curves.quartiles(curves, [300.0, 4.0, 0.0])
    assert_allclose(middle, [3.0, 4.0, 7.0])
    assert_allclose(low, [2.0, 3.0, 5.5])
    assert_allclose(high, [4.0, 5.0, 153.5])


def test_curves_with_points_of_their_own_come_together_on_a_grid_and_go_on_at_their_last_value():
    x, y = [np.array([0.0, 2.0]), np.array([0.0, 4.0])], [np.array([0.0, 1.0]), np.array([1.0, 0.0])]
    band = learning_curves.quartiles_between(x, y, np.array([1.0, 4.0]))
    assert_allclose(band[1], [0.625, 0.5])


def test_a_share_is_reached_when_first_seen_and_kept_after_the_last_evaluation_below_it():
    shares = np.array([0.0, 0.95, 0.5, 1.0])
    assert learning_curves.reached(shares, 0.01) == 1
    assert learning_curves.reached(shares, 0.95) == 1
    assert learning_curves.kept_from(shares) == 3
    assert learning_curves.reached(0.9 * shares, 0.95) == 4
    assert learning_curves.kept_from(shares[:3]) == 3
    assert learning_curves.kept_from(shares[3:]) == 0


@pytest.mark.parametrize(
    ("values", "text", "under"),
    [
        ([3.0, 1.0, 2.0], "2", "1 to 3"),
        ([3.0, np.nan, 2.0], "3", "2 to 3, 1 never"),
        ([3.0, np.nan, np.nan], "never", "3 to 3, 2 never"),
        ([np.nan, np.nan], "never", ""),
        ([6158.2], "6,158", ""),
        ([1e-5], "< 0.001", ""),
    ],
)
def test_trainings_that_never_get_there_count_as_more_than_all_others(values, text, under):
    cell = learning_curves.typical(np.array(values))
    assert (cell.text, cell.under) == (text, under)


@pytest.mark.slow
def test_a_policy_on_the_way_is_the_one_of_a_training_that_ends_there():
    learner = LinearQLearning.tuned(RIG, select=False)
    long, short = (replace(learner, max_episodes=n).train(2) for n in (30, 12))
    assert_array_equal(long.details["weights"][11], short.policy.weights)
    actor = GaussianQAC.published(RIG)
    long, short = (replace(actor, max_episodes=n).train(2) for n in (8, 5))
    assert_array_equal(long.details["weights"][4], short.details["v"])


@pytest.mark.slow
def test_acceptance_tests_are_counted_after_the_episode_that_they_followed():
    learner = LinearQLearning(
        RIG, task=dpend.Balance(steps=5), streak=2, acceptance=((0.1, 1.0),), acceptance_episodes=3, max_episodes=6
    )
    training = learner.train(0)
    tested = training.curve["tested"]
    assert training.cost.test_steps == tested.sum() > 0
    assert tested[0] == 0 < tested[1]


def test_deep_trainings_that_are_there_are_read_and_those_that_are_not_are_named(tmp_path):
    write(tmp_path / "ppo-swing-up" / "seed-3", [0.0, 0.5, 0.96, 0.9, 1.0])
    write(tmp_path / "sac-balance" / "seed-0", [0.0, 0.1], algo="sac", task="balance")
    write(tmp_path / "ppo-elsewhere" / "seed-0", [1.0])
    (tmp_path / "td3-swing-up" / "seed-0").mkdir(parents=True)  # has only just begun
    jobs = [job for job in learning_curves.jobs(Options(deep=tmp_path, trainings=1)) if job.kept]
    assert [(job.learner, job.training) for job in jobs] == [("sac-balance", 0), ("ppo-swing-up", 3)]
    found = table(jobs)
    (balance,), (swing,) = found.lines(learner="sac-balance"), found.lines(learner="ppo-swing-up")
    assert (swing.training, swing.lam, swing.share) == (3, 0.0, 1.0)
    assert_allclose([swing.first, swing.first_cpu, swing.most, swing.most_cpu, swing.kept], [80, 4, 120, 6, 200])
    assert_allclose(swing.experience, 200)
    assert balance.lam == 0.3
    assert np.isnan(balance.most)
    report = learning_curves.report(found)
    assert report.tables[0].note == (
        "No trainings there of ppo-balance, ddpg-balance, td3-balance, ddpg-swing-up, td3-swing-up, sac-swing-up: "
        "left out."
    )
    figures: Any = report.figures
    words = [text.get_text() for figure in figures.values() for axis in figure.axes for text in axis.texts]
    assert "not there: trainings of ppo-balance, ddpg-balance, td3-balance" in words
    assert "not there: trainings of ddpg-swing-up, td3-swing-up, sac-swing-up" in words


def test_a_deep_training_that_goes_on_is_read_again(tmp_path):
    write(tmp_path / "ppo-swing-up" / "seed-0", [0.0])
    before = learning_curves.jobs(Options(deep=tmp_path))[-1]
    write(tmp_path / "ppo-swing-up" / "seed-0", [0.0, 0.0])
    after = learning_curves.jobs(Options(deep=tmp_path))[-1]
    assert (after.learner, after.training) == (before.learner, before.training)
    assert after != before


def test_a_learner_is_evaluated_at_both_angles_and_its_curve_kept():
    result = learning_curves.run(Job(learner="LSPI", training=0, starts=20, points=3, seconds=60.0))
    assert [row["lam"] for row in result.rows] == [0.1, 0.3]
    assert set(result.arrays) == {"curve", "tail", "experience", "share 0.1", "share 0.3"}
    assert all(row["experience"] <= 60 for row in result.rows)


@dataclass(frozen=True)
class Guess:
    """A learner of one's own that knows the answer, and has run the plant for ten seconds to find it."""

    rig: dpend.Rig
    task: Any

    def train(self, seed, *, seconds=None, progress=None):
        cost = Cost(episodes=2, steps=500, sample_time=float(self.rig.sample_time), cpu_seconds=0.5)
        curve = {"experience": np.array([4.0, 10.0]), "length": np.array([200, 300])}
        return Training(policy=LQR(self.rig), outcome=Outcome.BUDGET_SPENT, cost=cost, curve=curve)


@pytest.mark.parametrize("task", [dpend.Balance(), dpend.SwingUp()], ids=["balance", "swing-up"])
def test_any_learner_that_joins_the_field_takes_part(task, monkeypatch):
    contender = Contender(name="guess", make=lambda rig, _: LQR(rig), learner=lambda rig: Guess(rig, task))
    monkeypatch.setattr(_field, "CONTENDERS", (*_field.CONTENDERS, contender))
    jobs = [job for job in learning_curves.jobs(Options(trainings=1, starts=20)) if job.learner == "guess"]
    found = table(jobs)
    balancing = isinstance(task, dpend.Balance)
    line = next(iter(found.lines(lam=0.1 if balancing else 0.0)))
    assert (line.outcome, line.episodes, line.successes, line.experience) == ("budget spent", 2, -1, 10.0)
    assert line.share == (1.0 if balancing else 0.0)
    assert (line.first, line.first_cpu) == pytest.approx((10.0, 0.5) if balancing else (np.nan, np.nan), nan_ok=True)
    report = learning_curves.report(found)
    assert "guess" in [each[0].text for each in report.tables[1].lines]
    figures: Any = report.figures
    labels = [
        label for figure in figures.values() for axis in figure.axes for label in axis.get_legend_handles_labels()[1]
    ]
    assert ("guess (1 not converged)" in labels) == balancing  # a swing-up's curve is that of a reward, which it lacks
    assert "guess" in labels  # its success against experience


def test_what_takes_long_is_evaluated_on_few_starts_and_takes_no_part_where_it_must_be_quick():
    name = "learned model, iLQR"
    assert {job.starts for job in learning_curves.jobs(Options(only=(name,)))} == {20}
    assert name not in {job.learner for job in learning_curves.jobs(Options(quick=True))}
    assert {job.learner for job in learning_curves.jobs(Options(quick=True, only=(name,)))} == {name}


@pytest.mark.parametrize(("name", "value"), [("trainings", 0), ("starts", 1)])
def test_options_without_a_sense_are_refused(name, value):
    least = {"trainings": 1, "starts": 2}[name]
    with pytest.raises(ValueError, match=whole(f"--{name} must be at least {least}; got {value}.")):
        Options(**{name: value})


def test_scaled_features_learn_to_leave_the_track_at_full_force_in_place_of_the_swing_up():
    make: Any = learning_curves.learners()["Q swing-up, features scaled as tuned"].learner
    learner = make(RIG)
    training = learner.train([0, 15, 0])
    off = dpend.simulate(
        RIG, Constant(40.0), learner.task.starts(np.random.default_rng(0), 1, RIG)[0], task=learner.task
    )
    assert off.status is dpend.Status.TRACK_END
    assert np.median(training.curve["length"][-500:]) == len(off.u) == 22
    cost = learner.task.cost(off.x[1:].copy(), np.zeros(22, dtype=np.uint8))
    assert_allclose(np.median((training.curve["reward"] / training.curve["length"])[-500:]), -cost.mean())
    assert not (training.curve["upright"] >= 50).any()


def test_only_learners_that_are_named_take_part_and_others_names_are_refused():
    jobs = learning_curves.jobs(learning_curves.Options(trainings=2, only=("LSPI", "ppo-balance")))
    assert [job.learner for job in jobs[:2]] == ["LSPI", "LSPI"]
    assert {job.learner for job in jobs} == {"LSPI", "ppo-balance"}
    with pytest.raises(ValueError, match=r"^--only LSPY: no learner is called so\. Did you mean .*LSPI"):
        learning_curves.Options(only=("LSPY",))
