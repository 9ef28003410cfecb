"""A learner that is one class and one entry in the field takes part in every study that trains: cross-entropy here."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dpend
from dpend.params import Array
from rl import Cost, GainPolicy, Learner, Outcome, Training
from rl.training import Progress, Seed
from studies import _board, _field, _runner, lambda_sweep, leaderboard, learning_curves
from studies._board import ranked, values_of
from studies._field import CONTENDERS, RIG, Contender, PriorKnowledge
from studies._runner import Table

TASK = dpend.Balance(lam=0.1)


class Population:
    """Laws u = -K x side by side, with a gain of its own for each row."""

    def __init__(self, K: Array) -> None:
        self.K = K

    def start(self, n: int, rng: np.random.Generator) -> Any:
        return lambda t, y: -(self.K * y).sum(axis=1)


@dataclass(frozen=True)
class CrossEntropy:
    """Draw gains, keep those that balance longest, and draw the next around them."""

    rig: dpend.Rig
    task: dpend.Balance = TASK
    iterations: int = 30
    drawn: int = 40
    kept: int = 8
    starts: int = 5

    def train(self, seed: Seed, *, seconds: float | None = None, progress: Progress = None) -> Training:
        """Learn the gain."""
        began, rng = time.process_time(), np.random.default_rng(seed)
        mean, std = np.zeros(6), np.array([10.0, 200.0, 200.0, 10.0, 30.0, 30.0])
        experience, lengths = [0.0], []
        while len(lengths) < self.iterations and experience[-1] < (math.inf if seconds is None else seconds):
            K = mean + std * rng.normal(size=(self.drawn, 6))
            x0 = np.tile(self.task.starts(rng, self.starts, self.rig), (self.drawn, 1))
            law = Population(np.repeat(K, self.starts, axis=0))
            steps = dpend.simulate_many(self.rig, law, x0, task=self.task).steps.reshape(self.drawn, self.starts)
            best = K[np.argsort(-steps.mean(axis=1), kind="stable")[: self.kept]]
            mean, std = best.mean(axis=0), best.std(axis=0)
            lengths.append(float(steps.mean()))
            experience.append(experience[-1] + float(steps.sum()) * self.rig.sample_time)
            if progress:
                progress(len(lengths) / self.iterations)
        return Training(
            policy=GainPolicy(K=mean),
            outcome=Outcome.BUDGET_SPENT,
            cost=Cost(
                episodes=len(lengths) * self.drawn * self.starts,
                steps=round(experience[-1] / self.rig.sample_time),
                sample_time=self.rig.sample_time,
                cpu_seconds=time.process_time() - began,
            ),
            curve={"experience": np.array(experience[1:]), "length": np.array(lengths)},
        )


@cache
def learned() -> GainPolicy:
    return CrossEntropy(RIG).train(0).policy


ENTRY = Contender(
    name="cross-entropy",
    make=lambda rig, task: learned(),
    prior_knowledge=PriorKnowledge("none", "length of the episode", "λ = .1 about upright"),
    learner=lambda rig: CrossEntropy(rig),
)


def quick(study: str, out: Path) -> Table:
    """Run a study, small, with LQR and the learner."""
    only = ("LQR", ENTRY.name)
    return _runner.main(f"studies.{study}", ["--quick", "--workers", "1", "--out", str(out), "--only", *only])


def test_it_is_a_learner_as_any() -> None:
    assert isinstance(CrossEntropy(RIG), Learner)


@pytest.mark.slow
def test_the_leaderboard_trains_it_and_ranks_its_policy(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    field = (*CONTENDERS, ENTRY)
    monkeypatch.setattr(leaderboard.Options, "known", field)
    monkeypatch.setattr(leaderboard, "CONTENDERS", field)
    monkeypatch.setattr(_board, "CONTENDERS", field)
    table = quick("leaderboard", tmp_path)
    place = ranked(table, "balance")[ENTRY.name]
    assert place is not None
    assert place.rank.value in (1, 2)
    assert values_of(table, ENTRY.name, "failed, %").tolist() == [0]
    assert values_of(table, ENTRY.name, "they save, %") > 0.5
    assert 0 < values_of(table, ENTRY.name, "learning, s") < 30 * 200 * 6
    page = (tmp_path / "tables.md").read_text()
    assert "| none | length of the episode | λ = .1 about upright |" in page
    assert "cross-entropy ranks" not in page  # which is said of users' own


@pytest.mark.slow
def test_the_sweep_over_lambda_trains_it_as_often_as_others(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    known = (*lambda_sweep.KNOWN, ENTRY)
    monkeypatch.setattr(lambda_sweep.Options, "known", known)
    monkeypatch.setattr(lambda_sweep, "KNOWN", known)
    table = quick("lambda_sweep", tmp_path)
    own = table.where(contender=ENTRY.name, lam=0.05)
    assert own["training"].tolist() == [0, 1]
    assert set(own["outcome"]) == {"budget spent"}
    assert own["training_episodes"].tolist() == 2 * [30 * 200]
    assert lambda_sweep.saved(table, ENTRY.name, 0.05).value > 0.9
    assert "| cross-entropy (0 of 2 converged) |" in (tmp_path / "tables.md").read_text()


@pytest.mark.slow
def test_the_learning_curves_train_it_and_evaluate_its_policy(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(_field, "CONTENDERS", (ENTRY,))
    monkeypatch.setattr(learning_curves, "ONLY_HERE", ())
    options = ["--quick", "--workers", "1", "--deep", str(tmp_path), "--out", str(tmp_path / "out")]
    table = _runner.main("studies.learning_curves", options)
    assert set(table.rows["learner"]) == {ENTRY.name}
    assert table.rows["lam"].tolist() == [0.1, 0.3]
    assert set(table.rows["successes"]) == {-1}  # its curve has no success
    assert np.isfinite(table.array("curve", learner=ENTRY.name)).all()
    assert "| cross-entropy | 1 | 0 | 0 |" in (tmp_path / "out" / "tables.md").read_text()
