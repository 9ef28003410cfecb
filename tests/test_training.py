"""The contract of all learners, and of one that is written on the spot: what they take, and what a training returns."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
import pytest

import dpend
from dpend.archive import read
from dpend.check import LEARNER_CHECKS
from dpend.controller import is_batched
from rl import (
    LSPI,
    Cost,
    GainPolicy,
    GaussianQAC,
    IdentifyAndPlan,
    Learner,
    LinearQLearning,
    NaturalQAC,
    Outcome,
    QuadraticQLearning,
    Training,
    load_policy,
)
from rl.training import Trail, samples_within, task_name
from tests.rigs import whole

RIG = dpend.rig("gustafsson2016")


@dataclass(frozen=True, kw_only=True)
class CrossEntropy:
    """Gains drawn from a normal distribution that is fitted to the best of them."""

    rig: dpend.Rig = field(kw_only=False)
    task: dpend.Balance = field(default_factory=lambda: dpend.Balance(steps=100))
    rounds: int = 4
    population: int = 16

    def __post_init__(self) -> None:
        if isinstance(self.rig, str):
            object.__setattr__(self, "rig", dpend.rig(self.rig))

    def train(self, seed, *, seconds=None, progress=None) -> Training:
        began, rng = time.process_time(), np.random.default_rng(seed)
        mean, std = np.array([0.0, -150.0, 180.0, 0.0, 0.0, 30.0]), np.full(6, 20.0)
        lengths, means, spent = np.zeros(0, dtype=np.int64), [], []
        budget = samples_within(seconds, self.rig.sample_time)
        for k in range(self.rounds):
            if lengths.sum() + self.population * self.task.steps > budget:
                break
            K = mean + std * rng.standard_normal((self.population, 6))
            starts = self.task.starts(rng, self.population, self.rig)
            runs = [
                dpend.simulate(self.rig, GainPolicy(gain), x0, task=self.task)
                for gain, x0 in zip(K, starts, strict=True)
            ]
            lengths = np.append(lengths, [len(run.u) for run in runs])
            best = K[np.argsort(lengths[-self.population :])[-4:]]
            mean, std = best.mean(axis=0), best.std(axis=0) + 1.0
            means.append(mean)
            spent.append(self.rig.sample_time * lengths.sum())
            if progress is not None:
                progress((k + 1) / self.rounds)
        if progress is not None:
            progress(1.0)
        return Training(
            policy=GainPolicy(mean, about={"seed": seed}),
            outcome=Outcome.BUDGET_SPENT,
            cost=Cost(
                episodes=len(lengths),
                steps=int(lengths.sum()),
                sample_time=self.rig.sample_time,
                cpu_seconds=time.process_time() - began,
            ),
            curve={"experience": self.rig.sample_time * np.cumsum(lengths), "length": lengths},
            trail=Trail(np.array(spent), means, GainPolicy),
        )


BUILD: dict[str, Callable[[Any], Any]] = {
    "Q published": lambda rig: LinearQLearning.published(rig),
    "Q tuned": lambda rig: LinearQLearning.tuned(rig),
    "Q swing-up": lambda rig: LinearQLearning(rig, task=dpend.SwingUp(start="side"), alpha=1e-6, max_episodes=300),
    "QAC published": lambda rig: GaussianQAC.published(rig, alpha=1e-6, beta=1e-6),
    "QAC tuned": lambda rig: GaussianQAC.tuned(rig),
    "natural QAC": lambda rig: NaturalQAC(rig, max_episodes=11, episodes_per_update=3),
    "LSPI": lambda rig: LSPI(rig),
    "one-step Q": lambda rig: QuadraticQLearning(rig, record_every=70),
    "cross-entropy": lambda rig: CrossEntropy(rig),
    "identify and plan": lambda rig: IdentifyAndPlan(rig),
}
SECONDS = 100.0  # enough for a few episodes, and for all but the acceptance tests of tuned Q-learning
every_learner = pytest.mark.parametrize(
    "build",
    [
        pytest.param(build, id=name, marks=[pytest.mark.slow] if name == "identify and plan" else [])
        for name, build in BUILD.items()
    ],
)


@pytest.mark.parametrize("check", LEARNER_CHECKS)
@every_learner
def test_a_learner_keeps_its_contract(build, check):
    check(build, "gustafsson2016", SECONDS)
    assert isinstance(build(RIG), Learner)


@every_learner
def test_the_policy_saves_and_loads_with_its_origin(build, tmp_path):
    policy = build(RIG).train(2, seconds=SECONDS).policy
    file = policy.save(tmp_path / "policy")
    back = load_policy(file)
    assert type(back) is type(policy)
    assert back.about["seed"] == 2
    assert read(file, "dpend policy 2")[0]["about"] == back.about
    n = 9 if is_batched(policy) else 1
    y = np.random.default_rng(0).normal(size=(n, 6))
    laws: list[Any] = [policy, back]
    one, other = (law.start(n, np.random.default_rng(0))(0.0, y) for law in laws)
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("seconds", [0.0, -1.0, np.nan, np.inf, "1"])
def test_a_budget_that_is_no_time_is_refused(seconds):
    message = f"seconds must be finite and at least one sample, 0.02 s; got {seconds!r}."
    with pytest.raises(ValueError, match=whole(message)):
        samples_within(seconds, 0.02)


@pytest.mark.parametrize("seed", [-1, 1.0, "1", None, np.array(1.0), [1, -1]])
def test_a_seed_that_is_no_whole_number_or_several_is_refused(seed):
    with pytest.raises(ValueError, match=r"^seed must be a whole number, at least 0; got "):
        LSPI(RIG).train(seed, seconds=SECONDS)


@every_learner
def test_a_number_among_the_settings_is_no_nan_no_word_and_none_only_where_it_may_be_left_out(build):
    learner = build(RIG)
    numbers = [each for each in fields(learner) if isinstance(each.default, int | float) and each.type != "bool"]
    for each in [] if isinstance(learner, CrossEntropy) else numbers:
        for odd in (np.nan, "1", *[None] * ("None" not in str(each.type))):
            with pytest.raises(ValueError, match=rf"^{each.name} must be .+; got {odd!r}\.$"):
                replace(learner, **{each.name: odd})


def test_acceptance_tests_are_within_the_budget():
    learner = replace(LinearQLearning.tuned(RIG), streak=1, acceptance=((0.1, 1.0),), acceptance_episodes=10)
    free = learner.train(1)
    assert free.cost.test_steps > 0
    bounded = learner.train(1, seconds=free.experience - 1.0)
    assert bounded.cost.test_steps < free.cost.test_steps
    assert bounded.experience <= free.experience - 1.0


def test_a_training_that_recorded_nothing_on_the_way_has_its_last_policy():
    cost = Cost(episodes=3, steps=50, test_steps=50, sample_time=0.02, cpu_seconds=0.0)
    law = GainPolicy(np.ones(6))
    training = Training(policy=law, outcome=Outcome.CONVERGED, cost=cost, curve={})
    assert training.converged
    assert training.snapshots(4) == [(2.0, law)]


def test_what_is_learned_has_a_name():
    assert task_name(LSPI(RIG)) == task_name(CrossEntropy(RIG)) == "balance"
    assert task_name(BUILD["Q swing-up"](RIG)) == "swing-up"
    other: Any = CrossEntropy(RIG, task=None)  # type: ignore[arg-type]
    message = "A learner's task must be a dpend.Balance or a dpend.SwingUp, or its name; got None."
    with pytest.raises(TypeError, match=whole(message)):
        task_name(other)
