"""Tuned laws: they save more than what they began with, come out the same for a seed, and say what they cost."""

from __future__ import annotations

import re

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import dpend
from controllers import LQR, LinearLaw, TunedLaw, tuned_gain, tuned_law, tuned_weights, tuning
from dpend.controller import Controller

RIG = dpend.rig("gustafsson2016")
FEW = {pos: (weight,) for pos, weight in zip(tuning.GRID, (1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0), strict=True)}


def saved(controller: Controller, lam: float, n: int = 1000) -> float:
    """Return the share of fresh starts that a controller saves."""
    task = dpend.Balance(lam=lam)
    starts = task.starts(np.random.default_rng(41), n, RIG)
    return float(dpend.simulate_many(RIG, controller, starts, task=task).success.mean())


def test_every_shipped_law_saves_more_fresh_starts_than_the_one_it_improves_on() -> None:
    laws = {law: tuned_law(RIG, law) for law in ("gain", "sign", "weights")}
    default, shares = saved(LQR(RIG), 0.4), {law: saved(found, 0.4) for law, found in laws.items()}
    assert shares["gain"] > shares["weights"] > default + 0.02
    assert shares["gain"] > shares["sign"] > default + 0.05
    assert all(found.cost.evaluations > 700 and found.cost.cpu_seconds > 1 for found in laws.values())


@pytest.mark.slow
def test_a_gain_tuned_for_a_while_saves_more_than_lqr_and_its_cost_is_counted() -> None:
    found = tuned_gain(RIG, lam=0.4, starts=40, evaluations=96, seed=3)
    assert saved(found, 0.4) > saved(LQR(RIG), 0.4) + 0.03
    assert found.cost.evaluations == 96 + 2  # beside the candidates, where it began and where it ended
    assert found.cost.runs == 98 * 40
    assert 0.2 * 98 * 40 * 6 < found.cost.experience < 98 * 40 * 6


@pytest.mark.slow
def test_tuning_is_the_same_for_a_seed_and_leaves_the_global_random_numbers_alone() -> None:
    before = np.random.get_state(legacy=False)["state"]["key"].copy()  # noqa: NPY002
    first, second, other = (tuned_gain(RIG, starts=5, evaluations=32, seed=seed) for seed in (1, 1, 2))
    assert_array_equal(first.K, second.K)
    assert not np.array_equal(first.K, other.K)
    assert_array_equal(np.random.get_state(legacy=False)["state"]["key"], before)  # noqa: NPY002


def test_the_sign_of_a_gain_is_always_at_full_force_and_the_same_for_every_length_of_it() -> None:
    found = tuned_law(RIG, "sign")
    y = 0.1 * np.random.default_rng(0).standard_normal((50, 6))
    forces = found.start(50, np.random.default_rng(0))(0.0, y)
    assert set(np.abs(forces)) == {40.0}
    assert_array_equal(np.sign(forces), np.sign(LinearLaw(3 * found.K).start(50, np.random.default_rng(0))(0.0, y)))


def test_the_weights_of_a_grid_that_save_most_are_found() -> None:
    grid = FEW | {"om1": (1.0, 1e4), "R": (1.0, 1e-4)}  # what is heavier hurries, and saves less
    found = tuned_weights(RIG, grid=grid, starts=10)
    assert_array_equal(found.numbers, np.ones(7))
    assert_array_equal(found.K, LQR(RIG).K)


def test_a_law_is_what_it_was_when_it_is_read_again_and_is_shipped_for_its_plant_alone(
    tmp_path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = tuned_law(RIG.replace(sensor_noise=0.1), "weights")
    again = TunedLaw.load(found.save(tmp_path / "law"))
    assert (again.rig, again.law, again.saved, again.cost, again.about) == (
        found.rig, found.law, found.saved, found.cost, found.about
    )  # fmt: skip
    assert_array_equal(again.K, found.K)
    monkeypatch.setattr(tuning, "_tune", lambda rig, law: (rig.force_limit, law))
    assert tuned_law(RIG.replace(force_limit=30.0), "gain") == (30.0, "gain")


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: tuned_gain(RIG, evaluations=15), "evaluations must be a whole number, at least 16; got 15."),
        (lambda: tuned_gain(RIG, lam=()), "lam needs at least one angle."),
        (lambda: tuned_gain(RIG, starts=0), "starts must be a whole number, at least 1; got 0."),
        (lambda: tuned_gain("bogdanov2004", bang_bang=True), "force must be finite and greater than 0 N; got inf."),
        (lambda: tuned_law(RIG, "signs"), """law must be "gain", "sign" or "weights"; got 'signs'."""),
        (
            lambda: tuned_weights(RIG, grid={"R": (1.0,)}),
            "grid has weights for pos, th1, th2, vel, om1, om2, R; got R.",
        ),
    ],
)
def test_wrong_use_is_refused_before_anything_is_tried(build, message: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        build()
