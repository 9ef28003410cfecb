"""What can be saved at all: the least force, the set of the linear plant, and the table that is shipped."""

import math

import numpy as np
import pytest

import dpend
from controllers import LQR, NoTrajectory, Zero
from controllers.least_force import LeastForce
from studies import _figures, _rescue, recoverable
from studies._closure import kept_table
from studies._null_controllable import null_controllable
from studies._runner import Table
from studies._table import read_rows, where
from tests.rigs import endless, whole

RIG = dpend.rig("gustafsson2016")
SET = null_controllable(RIG.params, 40.0)


def at_rest(*angles):
    return np.array([0.0, *angles, 0.0, 0.0, 0.0])


# ----------------------------------------------------------------------------------------------- the linear plant's set


def test_a_mode_alone_can_be_held_up_to_b_times_the_force_by_its_rate():
    b = (SET.W @ dpend.linearize(RIG.params)[1])[:, 0]
    assert np.abs(SET.boundary).max(axis=0) == pytest.approx(np.abs(b) * 40.0 / SET.rates, rel=1e-12)
    half = null_controllable(RIG.params, 20.0)
    assert half.boundary == pytest.approx(SET.boundary / 2)


def test_the_modes_are_those_of_the_linearisation_and_unstable():
    A, _ = dpend.linearize(RIG.params)
    np.testing.assert_allclose(SET.W @ A, SET.rates[:, None] * SET.W, atol=1e-9)
    assert SET.rates[0] > SET.rates[1] > 0


def test_the_share_is_one_on_the_boundary_half_halfway_and_the_same_mirrored():
    x = np.linalg.pinv(SET.W) @ SET.boundary[::37].T
    assert SET.share(x.T) == pytest.approx(1.0, rel=1e-3)
    assert SET.share(-0.5 * x.T) == pytest.approx(0.5, rel=1e-3)
    cut = SET.at_rest()
    rest = np.zeros((len(cut), 6))
    rest[:, 1:3] = cut
    assert SET.share(rest) == pytest.approx(1.0, rel=1e-3)


def test_held_forces_reach_every_vertex_by_one_switch_and_nothing_passes_them():
    a = np.exp(SET.rates * RIG.sample_time)
    b = (SET.W @ dpend.linearize(RIG.params)[1])[:, 0] * (a - 1) / SET.rates
    weights = a[:, None] ** -(1.0 + np.arange(400)) * b[:, None]
    switch = np.where(np.arange(400) < np.arange(0, 200, 7)[:, None], 40.0, -40.0)
    vertices = -switch @ weights.T
    assert SET.share(vertices @ np.linalg.pinv(SET.W).T) == pytest.approx(1.0, rel=1e-3)
    forces = 40.0 * np.sign(
        np.random.default_rng(0).normal(size=(2000, 1)) + np.random.default_rng(1).normal(size=(2000, 400))
    )
    assert SET.share(-forces @ weights.T @ np.linalg.pinv(SET.W).T).max() < 1.0001


def test_the_set_contains_every_state_that_saturated_lqr_saves_in_the_linear_plant():
    Ad, Bd = dpend.discretize(*dpend.linearize(RIG.params), RIG.sample_time)
    K = LQR(RIG).K[0]
    x0 = np.random.default_rng(2).uniform(-1.0, 1.0, (4000, 6)) * [1.0, 0.4, 0.4, 1.0, 1.5, 1.5]
    x = x0.copy()
    for _ in range(1500):
        x = np.clip(x, -1e6, 1e6) @ Ad.T + np.clip(-x @ K, -40.0, 40.0)[:, None] * Bd[:, 0]
    saved = np.abs(x).max(axis=1) < 1e-3
    share = SET.share(x0)
    assert 400 < saved.sum() < 3600
    assert share[saved].max() < 1.0
    assert share[saved].max() > 0.8  # and it is not much too large


# ------------------------------------------------------------------------------------------------------ the least force


@pytest.fixture(scope="module")
def search():
    return LeastForce(RIG)


@pytest.mark.slow
def test_the_least_force_of_a_small_start_is_what_the_linear_set_says():
    search = LeastForce(endless(track_limit=1e3), horizon=5.0)
    for start in (at_rest(0.02, -0.01), at_rest(0.01, 0.02), at_rest(0.0, 0.02)):
        assert search(start).about["force"] == pytest.approx(40.0 * SET.share(start)[0], rel=0.02)


def test_the_motion_of_least_force_keeps_all_limits_and_ends_at_rest(search):
    start = at_rest(0.25, -0.22)
    plan = search(start)
    assert plan.x[0] == pytest.approx(start)
    assert plan.x[-1, 1:] == pytest.approx(np.zeros(5), abs=1e-6)
    assert plan.defect() < 1e-6
    assert np.abs(plan.u).max() == pytest.approx(plan.about["force"], rel=1e-3)
    assert np.abs(plan.x[:, 0]).max() <= RIG.track_limit - 0.02 + 1e-6
    assert np.abs(plan.x[:, 1:3]).max() <= math.pi / 2


def test_a_mirrored_start_asks_for_the_same_force(search):
    assert search(-at_rest(0.2, -0.3)).about["force"] == pytest.approx(
        search(at_rest(0.2, -0.3)).about["force"], abs=0.01
    )


@pytest.mark.slow
def test_other_guesses_lead_to_no_lower_force(search):
    for start in (at_rest(0.3, -0.25), at_rest(-0.1, 0.45), at_rest(0.4, 0.02)):
        forces = np.array(search(start, guesses=4).about["found"])
        assert np.isfinite(forces).sum() >= 3
        assert np.nanmin(forces) == pytest.approx(forces[0], abs=0.05)


def test_what_cannot_be_is_refused(search):
    with pytest.raises(
        NoTrajectory, match=r"^No motion from \[0\.0, 1\.9, 0\.0, 0\.0, 0\.0, 0\.0\] to the target was found "
    ):
        search(at_rest(1.9, 0.0))
    with pytest.raises(ValueError, match=whole("x0 must be one state of shape (6,); got shape (5,).")):
        search(np.zeros(5))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            {"horizon": 0.02},
            "horizon must be a number of seconds, at least two samples of 0.02 s; got 0.02.",
        ),
        ({"angle_limits": (1.0, 0.0)}, "angle_limits must be two angles, greater than 0 rad; got (1.0, 0.0)."),
        ({"track_margin": 3.0}, "track_margin must be at least 0 m and less than the track's 2.4 m; got 3.0."),
    ],
)
def test_bad_settings_are_refused_before_anything_is_built(wrong, message):
    with pytest.raises(ValueError, match=whole(message)):
        LeastForce(RIG, **wrong)


# ------------------------------------------------------------------------------------------------------------ the study


def test_the_forces_of_a_plan_save_the_start_in_the_simulator_and_the_mirrored_ones_do_not(search):
    start, task = at_rest(0.275, -0.223), dpend.Balance()
    plan = search(start)
    assert plan.about["force"] < 40.0
    assert not dpend.simulate_many(RIG, LQR(RIG), start[None], task=task).success[0]
    assert _rescue.holds(plan, start, task)
    assert not _rescue.holds(plan, -start, task)
    replay = _rescue.Replay(plan.u[None], LQR(RIG))
    runs = dpend.simulate_many(RIG, replay, start[None], task=task, record=True)
    assert runs.u[0, : len(plan.u)] == pytest.approx(plan.u)
    assert runs.x is not None
    assert np.abs(runs.x[0, :51] - plan.x[:51]).max() < 1e-3


@pytest.mark.slow
def test_every_start_that_any_controller_saves_counts_as_recoverable():
    options = recoverable.Options(lam=(0.4,), starts=8, planned=2, planned_lam=(0.4,), grid=0)
    (job,) = recoverable.jobs(options)
    rows = recoverable.run(job).rows
    task = dpend.Balance(lam=0.4)
    x0 = task.starts(np.random.default_rng([0, 1]), 8, RIG)
    can = np.array([row["recoverable"] for row in rows])
    for law in _rescue.LAWS.values():
        assert (can | ~dpend.simulate_many(RIG, law(), x0, task=task).success).all()
    assert all(row["recoverable"] for row in rows if row["mpc"] == "yes" or row["lqr"] or row["stiff_sign"])
    assert all(row["mpc"] != "-" for row in rows[:2])
    assert all(row["report"] for row in rows if row["recoverable"])
    assert [row["recoverable"] for row in rows] == [row["by"] != _rescue.NONE for row in rows]
    assert all(row["least_force"] > 0.99 * 40 for row in rows if not row["recoverable"])
    assert {row["by"] for row in rows} > {"LQR", _rescue.OPTIMAL, _rescue.NONE}


def test_a_controller_of_yours_is_tried_on_what_nothing_else_saves_and_its_success_counts(tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text("from controllers import LQR\ndef mine(rig):\n    return LQR(rig)\n")
    options = recoverable.Options(lam=(0.1,), starts=3, grid=0, controller=(f"{tmp_path / 'mine.py'}:mine",))
    (job,) = recoverable.jobs(options)
    assert {row["by"] for row in recoverable.run(job).rows} == {"LQR"}
    monkeypatch.setattr(_rescue, "LAWS", dict.fromkeys(("LQR", "sign of stiff LQR"), Zero))
    monkeypatch.setattr(_rescue, "ILQRMPC", lambda rig, **settings: Zero())
    monkeypatch.setattr(_rescue, "optimal", lambda *_: (math.nan, False))
    rows = recoverable.run(job).rows
    assert {row["by"] for row in rows} == {"mine"}
    assert all(row["recoverable"] and not row["lqr"] and row["mpc"] == "no" for row in rows)
    assert recoverable.jobs(recoverable.Options(lam=(0.1,), starts=3, grid=0)) != [job]


def test_one_half_of_the_map_and_its_mirror_image_are_the_whole_map():
    half = recoverable.map_starts(9, 0.8)[:, 1:3]
    whole_map = {tuple(np.round(sign * point, 9) + 0.0) for point in half for sign in (1, -1)}
    assert len(whole_map) == 81
    assert len(half) == 41


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"lam": ()}, "--lam needs at least one angle."),
        ({"only": ("LQR",)}, "--only leaves out no contender here: every start is tried by all that may save it."),
        ({"lam": (0.1, 0.1)}, "--lam names an angle twice; got (0.1, 0.1)."),
        ({"starts": 0}, "--starts must be at least 1; got 0."),
        ({"grid": -1}, "--grid must be at least 0; got -1."),
        ({"extent": 2.0}, "--extent must be between 0 and pi/2 rad; got 2.0."),
    ],
)
def test_bad_options_are_refused(wrong, message):
    with pytest.raises(ValueError, match=whole(message)):
        recoverable.Options(**wrong)


def test_the_shipped_table_is_of_the_starts_that_all_studies_draw():
    every = read_rows(kept_table("recoverable"))
    rows = where(every, lam=0.4)
    starts = dpend.Balance(lam=0.4).starts(np.random.default_rng([0, 1]), len(rows), RIG)
    assert rows[["th1", "th2"]].to_numpy() == pytest.approx(starts[:, 1:3], abs=1e-5)
    assert rows["index"].tolist() == list(range(len(rows)))
    shipped = recoverable.shipped()
    assert shipped[0.4].tolist() == rows["recoverable"].tolist()
    for saved in (dpend.simulate_many(RIG, law(), starts[:200], task=dpend.Balance()) for law in _rescue.LAWS.values()):
        assert (shipped[0.4][:200] | ~saved.success).all()
    assert {lam: len(known) for lam, known in shipped.items()}.items() >= {0.1: 1000, 0.2: 1000, 0.3: 1000}.items()


def test_jobs_cover_every_start_once():
    jobs = recoverable.jobs(recoverable.Options(lam=(0.3,), starts=60, planned=52, grid=0))
    assert [(job.lam, job.first, job.starts, job.planned) for job in jobs] == [(0.3, 0, 50, 52), (0.3, 50, 10, 2)]
    on_map = [job for job in recoverable.jobs(recoverable.Options(grid=11)) if job.lam is None]
    assert [(job.first, job.starts) for job in on_map] == [(0, 50), (50, 11)]


def test_the_report_is_what_the_kept_table_says_with_its_own_numbers_of_starts():
    with _figures.look():
        reported = recoverable.report(Table(read_rows(kept_table("recoverable"))))
    shares, ways, first = ({line[0].text: line for line in sheet.lines} for sheet in reported.tables)
    assert [cell.text for cell in shares["recoverable"][1:]] == [
        "100.0", "100.0", "100.0", "98.7", "86.5", "73.8", "60.1",
    ]  # fmt: skip
    assert {cell.text for cell in shares["starts"][1:]} == {"1,000"}
    assert sum(int(line[4].text) for line in ways.values()) == 1000
    assert [first[lam][5].text for lam in ("0.3", "0.4")] == ["99.5", "97.6"]
    assert isinstance(reported.figures, dict)
    assert list(reported.figures) == ["", "_map"]


def test_the_map_is_mirrored_about_its_middle():
    angles, force = recoverable.shipped_map()
    assert len(angles) == len(force) == 41
    assert angles[20] == 0
    np.testing.assert_array_equal(force, force[::-1, ::-1])
    rows = recoverable.shipped_rows()
    row = rows[rows["lam"].isna()].iloc[500]
    assert force[np.argmin(abs(angles - row["th2"])), np.argmin(abs(angles - row["th1"]))] == row["least_force"]
