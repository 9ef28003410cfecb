"""Trajectories replay as planned, and come back from a file as they went in; residuals vanish at the target alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi
import numpy as np
import pytest
from numpy.testing import assert_allclose
from rigs import random_states, whole

import dpend
from controllers import Trajectory
from controllers.residuals import make_residuals
from dpend.state import as_equilibrium, deviation

RIG = dpend.rig("gustafsson2016")


def swinging(samples: int = 50) -> Trajectory:
    u = 10.0 * np.sin(0.1 * np.arange(samples))
    stepper = dpend.Stepper(RIG, 1)
    states = [stepper.reset(dpend.EQUILIBRIA["down-down"])[0]]
    for force in u:
        states.append(stepper.step([force])[0].copy())
    return Trajectory(rig=RIG, x=np.array(states), u=u, target=as_equilibrium("down-down"), about={"seed": 7})


def test_a_motion_of_the_plant_has_no_defect_and_a_shifted_one_has() -> None:
    trajectory = swinging()
    assert trajectory.defect() < 1e-12
    x = trajectory.x.copy()
    x[20, 4] += 0.01
    moved = Trajectory(rig=RIG, x=x, u=trajectory.u, target=trajectory.target)
    assert 0.005 < moved.defect() < 0.02


def test_a_trajectory_knows_its_times() -> None:
    trajectory = swinging(50)
    assert_allclose(trajectory.t, 0.02 * np.arange(51))
    assert trajectory.duration == pytest.approx(1.0)


def test_a_saved_trajectory_comes_back_bit_for_bit(tmp_path: Path) -> None:
    trajectory = swinging()
    kept = Trajectory.load(trajectory.save(tmp_path / "swing"))
    assert (kept.rig, kept.about) == (trajectory.rig, trajectory.about)
    for name in ("x", "u", "target"):
        assert np.array_equal(getattr(kept, name), getattr(trajectory, name))
        assert not getattr(kept, name).flags.writeable


def test_what_is_no_saved_trajectory_is_refused(tmp_path: Path) -> None:
    run = dpend.simulate(RIG, _Push(), dpend.EQUILIBRIA["down-down"], 0.2, task=None).save(tmp_path / "run.npz")
    cut = tmp_path / "cut.npz"
    cut.write_bytes(swinging().save(tmp_path / "whole.npz").read_bytes()[:-100])
    for path, reason in ((run, "it is 'dpend run 1'"), (cut, "it is empty, cut short, damaged or no .npz at all")):
        message = f"{path} cannot be read as 'dpend trajectory 1': {reason}. Save it again, or copy it afresh."
        with pytest.raises(ValueError, match=whole(message)):
            Trajectory.load(path)
    with pytest.raises(FileNotFoundError):
        Trajectory.load(tmp_path / "nowhere.npz")


class _Push:
    def start(self, n: int, rng: np.random.Generator) -> dpend.Act:
        return lambda t, y: np.full(n, 1.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"u": np.ones((50, 1))}, "u must be finite forces of shape (N,), at least one; got shape (50, 1)."),
        ({"u": []}, "u must be finite forces of shape (N,), at least one; got shape (0,)."),
        (
            {"x": np.zeros((50, 6))},
            "A state has six numbers (pos, th1, th2, vel, om1, om2): expected an array of shape (51, 6) or (6,); "
            "got shape (50, 6).",
        ),
        (
            {"rig": RIG.replace(mass1=np.ones(3))},
            "Trajectory takes one plant; got a rig of 3 rows. Take one of them with rig.rows(i).",
        ),
    ],
)
def test_a_trajectory_that_does_not_fit_together_is_refused(changes: dict[str, Any], message: str) -> None:
    trajectory = swinging()
    parts = {"rig": RIG, "x": trajectory.x, "u": trajectory.u, "target": trajectory.target}
    with pytest.raises(ValueError, match=whole(message)):
        Trajectory(**(parts | changes))


def test_residuals_are_the_deviation_near_the_target_and_greatest_half_a_turn_away() -> None:
    residuals = make_residuals(np.sin)
    target = as_equilibrium([0.5, np.pi, 2 * np.pi, 0, 0, 0])
    off = 1e-4 * random_states(np.random.default_rng(0), 20)
    assert_allclose(np.array(residuals((target + off).T, target)).T, off, atol=1e-10)
    x = random_states(np.random.default_rng(1), 500)
    squares = np.array(residuals(x.T, target)).T[:, 1:3] ** 2
    assert_allclose(squares, 2 * (1 - np.cos(deviation(x, target)[:, 1:3])), atol=1e-12)


def test_numpy_and_casadi_give_the_same_residuals() -> None:
    symbol = casadi.SX.sym("x", 6)
    target = [0.1, np.pi, 0.0, 0.0, 0.0, 0.0]
    function = casadi.Function(
        "e", [symbol], [casadi.vertcat(*make_residuals(casadi.sin)(casadi.vertsplit(symbol), target))]
    )
    x = random_states(np.random.default_rng(2), 1)[0]
    assert_allclose(np.array(function(x)).ravel(), make_residuals(np.sin)(x, target), atol=1e-15)
