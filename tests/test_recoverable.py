"""What can be saved at all: the least force, the set of the linear plant, and the boundary that is shipped."""

import math

import numpy as np
import pandas as pd
import pytest

import dpend
from controllers import ILQRMPC, LQR, NoTrajectory, tuned_law
from controllers.least_force import LeastForce
from rl import load_policy
from studies import _figures, recoverable
from studies._boundary import OWN, Boundary, boundary, boundary_by_force, kept_boundary
from studies._closure import kept_table
from studies._null_controllable import farthest_on_track, null_controllable
from studies._runner import Table
from studies._table import read_rows, where
from tests.rigs import endless, whole

RIG = dpend.rig("gustafsson2016")
SET = null_controllable(RIG.params, 40.0)
TASK = dpend.Balance()


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


def test_on_an_endless_track_the_linear_plant_comes_to_rest_from_all_of_the_set_and_from_nowhere_else():
    for start in (at_rest(1.0, 0.0), at_rest(-0.6, 0.8), at_rest(0.0, 1.0)):
        radius = farthest_on_track(RIG, start, force=40.0, track=math.inf)
        assert radius * SET.share(start)[0] == pytest.approx(1.0, rel=5e-3)
        assert radius * SET.share(start)[0] < 1.0001


def test_a_track_shrinks_the_linear_plants_set_and_twice_the_force_on_twice_the_track_doubles_it():
    start = at_rest(0.0, 1.0)
    own = farthest_on_track(RIG, start, force=40.0, track=2.4)
    assert own < 0.7 / SET.share(start)[0]
    assert farthest_on_track(RIG, start, force=80.0, track=4.8) == pytest.approx(2 * own, rel=1e-6)
    assert farthest_on_track(RIG, start, force=80.0, track=2.4) < 1.7 * own


# ------------------------------------------------------------------------------------------------------ the least force


@pytest.fixture(scope="module")
def search():
    return LeastForce(RIG)


@pytest.mark.slow
def test_the_least_force_of_a_small_start_is_what_the_linear_set_says():
    search = LeastForce(endless(track_limit=1e3), horizon=5.0)
    for start in (at_rest(0.02, -0.01), at_rest(0.01, 0.02), at_rest(0.0, 0.02)):
        assert search(start).about["force"] == pytest.approx(40.0 * SET.share(start)[0], rel=0.02)


@pytest.mark.slow
def test_the_motion_of_least_force_keeps_all_limits_and_ends_at_rest(search):
    start = at_rest(0.25, -0.22)
    plan = search(start)
    assert plan.x[0] == pytest.approx(start)
    assert plan.x[-1, 1:] == pytest.approx(np.zeros(5), abs=1e-6)
    assert plan.defect() < 1e-6
    assert np.abs(plan.u).max() == pytest.approx(plan.about["force"], rel=1e-3)
    assert np.abs(plan.x[:, 0]).max() <= RIG.track_limit - 0.02 + 1e-6
    assert np.abs(plan.x[:, 1:3]).max() <= math.pi / 2


@pytest.mark.slow
def test_a_mirrored_start_asks_for_the_same_force(search):
    assert search(-at_rest(0.2, -0.3)).about["force"] == pytest.approx(
        search(at_rest(0.2, -0.3)).about["force"], abs=0.01
    )


@pytest.mark.slow
def test_the_motion_from_one_start_is_a_guess_for_another_in_its_direction(search):
    near = search(at_rest(0.18, -0.16))
    for share in (0.8, 1.0, 1.3):
        start = share * near.x[0]
        again = search(start, guess=near)
        assert again.x[0] == pytest.approx(start)
        assert again.about["force"] == pytest.approx(search(start).about["force"], abs=2e-3)
    with pytest.raises(ValueError, match=whole("guess must have 25 samples; got 100.")):
        LeastForce(RIG, horizon=0.5)(at_rest(0.1, 0.0), guess=near)


@pytest.mark.slow
def test_other_guesses_lead_to_no_lower_force(search):
    for start in (at_rest(0.3, -0.25), at_rest(-0.1, 0.45), at_rest(0.4, 0.02)):
        forces = np.array(search(start, guesses=4).about["found"])
        assert np.isfinite(forces).sum() >= 3
        assert np.nanmin(forces) == pytest.approx(forces[0], abs=0.05)


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_longer_horizon_asks_for_the_same_force_on_the_track():
    start = at_rest(-0.27, 0.27)
    three, four = (LeastForce(RIG, horizon=horizon)(start).about["force"] for horizon in (3.0, 4.0))
    assert three == pytest.approx(four, abs=0.01)


# --------------------------------------------------------------------------------------------------------- the boundary


def disc(radius, rays=24):
    each = np.full(rays, radius)
    return Boundary(np.arange(rays) * 360.0 / rays, 0.99 * each, 1.01 * each)


def test_a_share_is_the_area_within_the_square_and_its_interval_is_that_between_both_sides_of_the_boundary():
    assert disc(0.5).share(0.3) == (1.0, 1.0, 1.0)
    value, low, high = disc(0.5).share(0.8)
    assert value == pytest.approx(math.pi * 0.5**2 / 1.6**2, rel=1e-6)
    assert (low, high) == pytest.approx((0.99**2 * value, 1.01**2 * value))
    assert disc(0.5).lam(value) == pytest.approx(0.8)
    wavy = disc(0.5)._replace(low=0.5 + 0.1 * (np.arange(24) % 2), high=0.5 + 0.1 * (np.arange(24) % 2))
    few = wavy.share(0.8)
    assert few.low < few.value - 0.03 < few.value + 0.03 < few.high  # every other ray tells another story


def test_savable_is_what_lies_nearer_than_the_boundary_all_round():
    angles = np.random.default_rng(0).uniform(-math.pi, math.pi, 200)
    x = np.zeros((200, 6))
    x[:, 1:3] = np.column_stack([np.cos(angles), np.sin(angles)])
    kept = kept_boundary()
    radius = kept.radius(angles)[:, None]
    assert kept.savable(0.999 * radius * x).all()
    assert not kept.savable(1.001 * radius * x).any()
    assert kept.radius(angles + math.pi) == pytest.approx(kept.radius(angles))  # mirror images
    assert np.hypot(*kept.ring().T).max() == pytest.approx(np.max(0.5 * (kept.low + kept.high)), rel=1e-3)


def test_a_boundary_lies_before_the_first_start_of_a_ray_that_asks_for_more_than_there_is():
    rows = pd.DataFrame({"th1": [0.1, 0.3, 0.4, 0.2, 0.0, 0.0], "th2": [0.0, 0.0, 0.0, 0.0, 0.3, 0.2], "limit": 40.0,
                         "force": [10.0, 41.0, 39.0, 20.0, 30.0, 15.0], "degrees": 4 * [0.0] + 2 * [90.0]})  # fmt: skip
    found = boundary(rows)
    assert found.degrees.tolist() == [0, 90, 180, 270]
    assert found.low.tolist() == 2 * [0.2, 0.3]
    assert found.high.tolist() == 2 * [0.3, 0.3]
    at = boundary_by_force(rows)
    assert at(20.0).low == pytest.approx([0.2, at(20.0).low[1]] * 2)
    assert at(15.0).high[[1, 3]] == pytest.approx(0.2)
    assert at(1e6).low == pytest.approx(2 * [0.3, 0.3])


# ------------------------------------------------------------------------------------------------------------ the study


@pytest.mark.slow
def test_a_ray_is_solved_until_the_boundary_is_known_and_what_is_found_holds_in_the_simulator():
    job = next(job for job in recoverable.jobs(recoverable.Options()) if job.degrees == 135)
    rows = pd.DataFrame(recoverable.run(job).rows)
    radius = np.hypot(rows["th1"], rows["th2"])
    assert np.all(np.diff(radius) > 0)
    assert np.all(np.diff(rows["force"]) > 0)
    assert set(rows.loc[(rows["force"] > 38) & (rows["force"] <= 40), "saves"]) == {"yes"}
    last = int(np.sum(rows["force"] <= 40))
    assert radius[last] - radius[last - 1] < 5e-4 * radius[last]
    assert rows["force"].iloc[-1] > 0.99 * 60
    assert kept_boundary().radius(math.radians(135)) == pytest.approx(radius[last], rel=1e-3)


@pytest.mark.slow
def test_starts_solved_one_by_one_lie_on_the_side_of_the_boundary_that_they_should():
    rng = np.random.default_rng(11)
    search = LeastForce(RIG, horizon=3.0, angle_limits=2 * [math.pi / 2 - OWN], track_margin=OWN)
    for angle in rng.uniform(-math.pi, math.pi, 12):
        start = kept_boundary().radius(angle) * at_rest(math.cos(angle), math.sin(angle))
        assert search(0.99 * start).about["force"] < 40.0 < search(1.01 * start).about["force"]


@pytest.mark.parametrize(
    "make", [LQR, lambda rig: LQR(rig, (1, 10, 10, 1, 1, 1), 0.1), lambda rig: load_policy("lspi")]
)
def test_every_start_that_a_controller_saves_lies_inside(make):
    starts = dpend.Balance(lam=0.7).starts(np.random.default_rng(12), 2000, RIG)
    saved = dpend.simulate_many(RIG, make(RIG), starts, task=TASK).success
    assert saved.sum() > 400
    assert kept_boundary().savable(starts)[saved].all()


@pytest.mark.slow
def test_every_start_that_a_planner_saves_lies_inside():
    starts = dpend.Balance(lam=0.6).starts(np.random.default_rng(13), 24, RIG)
    saved = dpend.simulate_many(RIG, ILQRMPC(RIG, upright_only=True), starts, task=TASK).success
    inside = kept_boundary().savable(starts)
    assert inside[saved].all()
    assert saved.sum() >= 0.9 * inside.sum()


def test_jobs_are_rays_of_half_a_turn_and_parts_of_the_random_starts():
    jobs = recoverable.jobs(recoverable.Options(rays=24, tracks=(0.5, 1.2), check=60))
    rays = {}
    for job in jobs:
        if not job.starts:
            rays.setdefault((job.model, job.track, job.margin), []).append(job.degrees)
    assert next(iter(rays)) == ("nonlinear", 2.4, OWN)  # the table's first rows are of the rig's own track
    assert rays["nonlinear", 2.4, OWN] == [15.0 * k for k in range(12)]
    assert rays["linear", math.inf, 0.0] == [30.0 * k for k in range(6)]
    assert rays["nonlinear", 1.0, OWN] == [0.0, 90.0]
    assert len(rays) == 6
    assert [(job.first, job.starts) for job in jobs if job.starts] == [(0, 50), (50, 10)]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"rays": 20}, "--rays must be a multiple of 12; got 20."),
        ({"rays": 0}, "--rays must be a multiple of 12; got 0."),
        ({"check": -1}, "--check must be at least 0; got -1."),
        ({"tracks": (0.5, 0.0)}, "--tracks must be greater than 0; got (0.5, 0.0)."),
        (
            {"rig": "bogdanov2004"},
            "On bogdanov2004 every start can be saved: it has no force limit; --set force_limit=40.",
        ),
    ],
)
def test_bad_options_are_refused(wrong, message):
    with pytest.raises(ValueError, match=whole(message)):
        recoverable.Options(**wrong)


def test_the_kept_table_agrees_with_its_random_starts_and_its_motions_hold():
    rows = where(read_rows(kept_table("recoverable")), model="nonlinear")
    random = rows[rows["starts"] > 0]
    solved = np.asarray(random["force"] <= 40)
    starts = np.zeros((len(random), 6))
    starts[:, 1:3] = random[["th1", "th2"]]
    assert len(random) >= 3000
    inside = kept_boundary().savable(starts)
    assert not (solved & ~inside).any()
    lacking = inside & ~solved  # where the search from nothing ends without a motion
    assert lacking.sum() <= 5
    assert not np.isfinite(np.asarray(random["force"])[lacking]).any()
    assert dpend.simulate_many(RIG, tuned_law(RIG, "gain"), starts[lacking], task=TASK).success.all()
    assert set(rows["saves"]) == {"yes", "-"}


@pytest.mark.slow
def test_the_report_is_what_the_kept_table_says():
    with _figures.look():
        reported = recoverable.report(Table(read_rows(kept_table("recoverable"))))
    shares, radii, *_ = ({line[0].text: line for line in sheet.lines} for sheet in reported.tables)
    assert shares["recoverable"][5].text == f"{100 * kept_boundary().share(0.4).value:.2f}"
    without, linear = (float(shares[name][7].text) for name in ("without a track", "linear plant, without a track"))
    assert float(shares["recoverable"][7].text) < without < linear
    assert float(radii["90"][1].text) == pytest.approx(kept_boundary().radius(math.pi / 2), abs=1e-4)
    assert isinstance(reported.figures, dict)
    assert list(reported.figures) == ["", "_map"]
