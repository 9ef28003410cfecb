"""What is caught stays caught, where it is said that it would; and which law is in charge is as the regions say."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rigs import endless, random_states, whole

import dpend
from controllers import ILQRMPC, LQR, Constant, Ellipsoid, EnergyPump, NearEnergy, RolloutRegion, SwitchingController
from controllers.ilqr import Step
from dpend.controller import Act
from dpend.params import Array

RIG = dpend.rig("gustafsson2016")


@pytest.mark.parametrize("preset", dpend.rigs())
def test_within_its_limits_the_linear_law_asks_no_more_than_the_rig_gives(preset: str) -> None:
    rig = dpend.rig(preset)
    lqr = LQR(rig)
    if not (np.isfinite(rig.force_limit) or np.isfinite(rig.track_limit)):
        with pytest.raises(
            ValueError, match=whole("The rig limits neither force nor track, so the linear loop is stable everywhere.")
        ):
            Ellipsoid.within_limits(lqr)
        return
    region = Ellipsoid.within_limits(lqr)
    x = region.boundary(5000, np.random.default_rng(0))
    assert (np.abs(x @ lqr.K[0]) <= rig.force_limit * (1 + 1e-9)).all()
    assert (np.abs(x[:, 0]) <= rig.track_limit * (1 + 1e-9)).all()
    # and one of the two is met: along P^-1 K' or P^-1 e1
    ways = np.linalg.inv(lqr.P) @ np.stack([lqr.K[0], np.eye(6)[0]], axis=1)
    ends = ways * np.sqrt(region.level / np.einsum("ik,ij,jk->k", ways, lqr.P, ways))
    met = [abs(lqr.K[0] @ ends[:, 0]) / rig.force_limit, abs(ends[0, 1]) / rig.track_limit]
    assert max(met) == pytest.approx(1.0)


def test_the_cost_is_measured_from_the_nearest_turn_of_the_target() -> None:
    region = Ellipsoid(LQR(RIG), 1.0)
    x = random_states(np.random.default_rng(0), 20, scale=0.2)
    assert_allclose(region.cost(x + np.array([0, 2 * np.pi, -4 * np.pi, 0, 0, 0])), region.cost(x), rtol=1e-9)
    assert_allclose(region.cost(region.boundary(50, np.random.default_rng(0))), 1.0)


def test_a_calibrated_ellipsoid_catches_fresh_starts_all_through_it() -> None:
    lqr = LQR(RIG)
    region = Ellipsoid.calibrated(lqr, starts=300)
    rng = np.random.default_rng(99)
    x = region.boundary(500, rng) * rng.uniform(0, 1, (500, 1)) ** (1 / 6)
    assert region(x).all()
    runs = dpend.simulate_many(RIG, lqr, x, 8.0, task=dpend.SwingUp())
    assert runs.success.mean() >= 0.99  # three in a thousand of the boundary may be lost, with 95 % confidence 1 %
    assert not RolloutRegion(RIG, lqr)(Ellipsoid(lqr, 2 * region.level).boundary(500, rng)).all()


def test_a_rollout_region_is_where_the_simulation_comes_to_rest() -> None:
    lqr = LQR(RIG)
    starts = dpend.Balance(lam=0.6).starts(np.random.default_rng(5), 200, RIG)
    rests = RolloutRegion(RIG, lqr)(starts)
    runs = dpend.simulate_many(RIG, lqr, starts, 8.0, task=dpend.SwingUp())
    assert 0.2 < rests.mean() < 0.8
    assert (rests == runs.success).mean() > 0.98  # slow ones may rest later


def test_a_rollout_region_judges_each_state_alone() -> None:
    ahead = RolloutRegion(RIG, LQR(RIG))
    starts = dpend.Balance(lam=0.6).starts(np.random.default_rng(5), 30, RIG)
    assert_array_equal(ahead(starts), np.concatenate([ahead(x[None]) for x in starts]))


def test_near_energy_is_where_upright_and_the_fast_pass_through_below_are() -> None:
    region = NearEnergy(RIG, 0.01)
    x = np.zeros((4, 6))
    x[1, 1:3] = np.pi  # hanging at rest
    x[2, 1:3] = np.pi  # hanging, the cart as fast as a fall from upright would make it
    x[2, 3] = np.sqrt(2 * 2 * region.energy / RIG.params.coefficients().d1)
    x[3, 0] = 0.9 * RIG.track_limit
    assert region(x).tolist() == [True, False, True, False]


class Counting:
    """A law of one run at a time, which answers how often it was asked."""

    batched = False

    def start(self, n: int, rng: np.random.Generator) -> Act:
        assert n == 1
        count = 0

        def act(t: float, y: Array) -> Array:
            nonlocal count
            count += 1
            return np.array([100.0 * count + t])

        return act


def test_the_law_in_charge_answers_with_hysteresis_and_starts_afresh() -> None:
    catch = SwitchingController(
        RIG, Constant(-1.0), Counting(), region=lambda x: np.abs(x[:, 0]) < 0.1, leave=lambda x: np.abs(x[:, 0]) > 0.5
    )
    assert not catch.batched
    act = catch.start(1, np.random.default_rng(0))
    y = np.zeros((9, 1, 6))
    y[:, 0, 0] = [0.3, 0.05, 0.3, 0.4, 0.6, 0.3, 0.0, 0.0, 0.0]
    answers = [act(float(k), row)[0] for k, row in enumerate(y)]
    assert answers == [-1, 100, 201, 302, -1, -1, 100, 201, 302]
    assert np.ravel(act.log["caught"]).tolist() == [0, 1, 1, 1, 0, 0, 1, 1, 1]  # type: ignore[attr-defined]


def test_in_a_batch_each_row_has_its_own_law_in_charge() -> None:
    catch = SwitchingController(
        RIG, Constant(-1.0), Constant(2.0), region=lambda x: x[:, 0] > 0, leave=lambda x: x[:, 0] < -1
    )
    assert catch.batched
    act = catch.start(3, np.random.default_rng(0))
    y = np.zeros((3, 6))
    y[:, 0] = [1, -0.5, -0.5]
    assert act(0.0, y).tolist() == [2, -1, -1]
    y[:, 0] = [-0.5, 1, -2]
    assert act(0.02, y).tolist() == [2, 2, -1]
    y[:, 0] = [-2, -0.5, -2]
    assert act(0.04, y).tolist() == [-1, 2, -1]


def test_a_fallen_link_is_handed_back() -> None:
    act = SwitchingController(RIG, Constant(-1.0)).start(1, np.random.default_rng(0))
    fallen = np.array([[0, 2.0, 0, 0, 0, 0]])
    forces = [act(0.02 * k, y)[0] for k, y in enumerate([np.zeros((1, 6)), fallen])]
    assert forces == [0.0, -1.0]


def test_a_batch_is_its_rows() -> None:
    catch = SwitchingController(RIG, EnergyPump(RIG))
    starts = dpend.SwingUp(angle_spread=0.1).starts(np.random.default_rng(2), 3, RIG)
    together = dpend.simulate_many(RIG, catch, starts, 1.0, task=None)
    for row, x0 in enumerate(starts):
        assert_allclose(dpend.simulate(RIG, catch, x0, 1.0, task=None).u, together.u[row], rtol=1e-9)


def test_a_planner_starts_afresh_in_the_rows_that_hand_over_to_it_and_the_others_go_on() -> None:
    planner = ILQRMPC(RIG, upright_only=True)
    inner = SwitchingController(
        RIG, EnergyPump(RIG), planner, region=lambda x: x[:, 0] < 1, leave=lambda x: x[:, 0] > 1
    )
    law = SwitchingController(RIG, inner, Constant(7.0), region=lambda x: x[:, 3] > 1, leave=lambda x: x[:, 3] < 1)
    assert law.batched
    y = np.zeros((6, 3, 6))
    y[:, :, 1] = [0.05, 0.1, 0.15]
    y[2, 1, 0], y[3, 2, 3] = 2.0, 2.0  # lost to the law inside, and to the one outside
    act = law.start(3, np.random.default_rng(0))
    together = np.array([act(0.02 * k, row) for k, row in enumerate(y)])
    planned = np.array(act.log["status"]) == Step.PLANNED  # type: ignore[attr-defined]
    assert_array_equal(planned, [[1, 1, 1], [0, 0, 0], [0, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 0]])
    assert together[3, 2] == 7.0
    for row in range(3):
        alone = law.start(1, np.random.default_rng(0))
        assert_array_equal([alone(0.02 * k, each[row : row + 1])[0] for k, each in enumerate(y)], together[:, row])


@pytest.mark.slow
def test_pumping_then_catching_where_the_regulator_is_seen_to_hold_arrives_more_often_than_not() -> None:
    task = dpend.SwingUp(angle_spread=0.1, steps=1500)
    starts = task.starts(np.random.default_rng(21), 30, RIG)
    runs = dpend.simulate_many(RIG, SwitchingController(RIG, EnergyPump(RIG)), starts, task=task)
    assert runs.success.mean() > 0.6
    assert set(runs.log["caught"][runs.success, -1]) == {1.0}


def test_regions_take_lists_of_states_and_refuse_what_is_none() -> None:
    lqr = LQR("gustafsson2016")
    upright = [[0, 0, 0, 0, 0, 0]]
    for region in (Ellipsoid(lqr, 1.0), RolloutRegion("gustafsson2016", lqr), NearEnergy("gustafsson2016")):
        assert region(upright).tolist() == [True]
        with pytest.raises(ValueError, match=whole("Expected states (n, 6); got shape (6,).")):
            region(upright[0])
    builds: list[Any] = [Ellipsoid.calibrated, Ellipsoid.within_limits]
    for build in builds:
        with pytest.raises(TypeError, match=whole("Ellipsoid takes an LQR; got 'lqr'.")):
            build("lqr")
    with pytest.raises(ValueError, match=whole("n must be a whole number, at least 1; got 0.")):
        Ellipsoid(lqr, 1.0).boundary(0, np.random.default_rng(0))


def test_wrong_use_is_refused() -> None:
    with pytest.raises(ValueError, match=whole("level must be finite and greater than 0; got 0.")):
        Ellipsoid(LQR(RIG), 0)
    with pytest.raises(
        TypeError, match=whole("region must say which states (n, 6) belong to it, as a function; got 3.")
    ):
        SwitchingController(RIG, Constant(1.0), region=3)  # type: ignore[arg-type]
    with pytest.raises(
        ValueError, match=whole("Counting treats one run at a time; a rollout of many states takes a batched law.")
    ):
        RolloutRegion(RIG, Counting())
    with pytest.raises(ValueError, match=whole("duration must be finite and greater than 0 s; got -1.0.")):
        RolloutRegion(RIG, LQR(RIG), duration=-1.0)
    two = endless(mass1=np.array([0.5, 0.6]))
    with pytest.raises(
        ValueError,
        match=whole("RolloutRegion takes one plant; got a rig of 2 rows. Take one of them with rig.rows(i)."),
    ):
        RolloutRegion(two, LQR(RIG))
    with pytest.raises(
        ValueError, match=whole("NearEnergy takes one plant; got a rig of 2 rows. Take one of them with rig.rows(i).")
    ):
        NearEnergy(two)
    with pytest.raises(
        ValueError,
        match=whole("tolerance must be greater than 0 and track_share above 0 and at most 1; got -1 and 0.8."),
    ):
        NearEnergy(RIG, -1)


def test_a_batched_law_that_is_no_lqr_needs_a_region() -> None:
    message = (
        "Say in which region Constant is to take over, region=...; only an LQR and laws that start afresh, such as "
        "planners, have one by default."
    )
    with pytest.raises(ValueError, match=whole(message)):
        SwitchingController(RIG, EnergyPump(RIG), Constant(1.0))
