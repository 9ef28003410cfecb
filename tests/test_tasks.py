"""Tasks begin, end, cost and succeed as they say; angles and equilibria are what the state says they are."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from rigs import endless, random_states, whole
from scipy import stats

import dpend
from dpend import Balance, Status, SwingUp, Task, nearest_upright, wrap
from dpend.params import Array
from dpend.state import EQUILIBRIA, NAMES, UNITS, as_equilibrium, as_states, deviation
from dpend.tasks import NoTask

RIG = dpend.rig("gustafsson2016")
OPEN = endless()


def draw(task: Task, n: int = 2000, seed: int = 0, rig: dpend.Rig = RIG) -> Array:
    return task.starts(np.random.default_rng(seed), n, rig)


def looks_uniform(values: Array, low: float, high: float) -> None:
    assert (values >= low).all()
    assert (values <= high).all()
    assert stats.kstest(values, stats.uniform(low, high - low).cdf).pvalue > 1e-3


# --------------------------------------------------------------------------------------------------------------- starts


@pytest.mark.parametrize("lam", [0.1, 0.4, np.pi / 2])
def test_balancing_starts_at_rest_with_both_angles_uniform_and_independent(lam: float) -> None:
    x0 = draw(Balance(lam=lam))
    for angle in (1, 2):
        looks_uniform(x0[:, angle], -lam, lam)
    assert abs(np.corrcoef(x0[:, 1], x0[:, 2])[0, 1]) < 0.1
    assert not x0[:, [0, 3, 4, 5]].any()


def test_link_2_may_start_within_another_angle_or_upright() -> None:
    x0, as_usual = draw(Balance(lam=0.3, lam2=0.1)), draw(Balance(lam=0.3))
    assert_allclose(x0, as_usual * [1, 1, 1 / 3, 1, 1, 1], rtol=1e-15)
    assert (draw(Balance(lam=0.3, lam2=0.0))[:, 2] == 0).all()


def test_one_generator_gives_the_same_directions_for_every_lambda() -> None:
    assert_allclose(draw(Balance(lam=0.4)) / 4, draw(Balance(lam=0.1)), rtol=1e-15)
    assert not np.array_equal(draw(Balance(), seed=1), draw(Balance()))


def test_swing_up_starts_hanging_or_level_or_anywhere() -> None:
    assert np.array_equal(draw(SwingUp(start="hanging"), 3), np.tile([0, np.pi, np.pi, 0, 0, 0], (3, 1)))
    assert np.array_equal(draw(SwingUp(start="side"), 3), np.tile([0, np.pi / 2, np.pi / 2, 0, 0, 0], (3, 1)))
    x0 = draw(SwingUp(start="anywhere"))
    looks_uniform(x0[:, 0], -1.2, 1.2)  # half the track
    for angle in (1, 2):
        looks_uniform(x0[:, angle], -np.pi, np.pi)
    for rate in (3, 4, 5):
        assert stats.kstest(x0[:, rate], "norm").pvalue > 1e-3
    assert np.abs(np.corrcoef(x0.T) - np.eye(6)).max() < 0.1
    looks_uniform(draw(SwingUp(start="anywhere"), rig=OPEN)[:, 0], -1.0, 1.0)


def test_swing_up_from_anywhere_starts_each_row_on_its_own_track() -> None:
    rig = RIG.replace(track_limit=np.tile([0.5, 2.0, np.inf], 500))
    x0 = draw(SwingUp(start="anywhere"), 1500, rig=rig)
    for row, reach in enumerate((0.25, 1.0, 1.0)):
        looks_uniform(x0[row::3, 0], -reach, reach)


@pytest.mark.parametrize("start", ["hanging", "side", "up-down"])
def test_the_spread_moves_each_angle_uniformly(start: str) -> None:
    moved = draw(SwingUp(start=start, angle_spread=0.3)) - draw(SwingUp(start=start))
    for angle in (1, 2):
        looks_uniform(moved[:, angle], -0.3, 0.3)
    assert abs(np.corrcoef(moved[:, 1], moved[:, 2])[0, 1]) < 0.1
    assert not moved[:, [0, 3, 4, 5]].any()


def test_starts_are_new_arrays_every_time() -> None:
    for task in (Balance(), SwingUp(), SwingUp(start="side"), NoTask()):
        draw(task, 3)[:] = 99.0
        assert np.abs(draw(task, 3)).max() < 99.0


# ---------------------------------------------------------------------------------------------------------------- ends

HALF = np.pi / 2
EDGE = 1e-9


def statuses(task: Task, x: Any, rig: dpend.Rig = RIG) -> list[Status]:
    x = np.atleast_2d(np.asarray(x, dtype=float))
    return [list(Status)[code] for code in task.ended(x, rig)]


def test_balancing_ends_just_beyond_the_horizontal_and_the_track() -> None:
    for sign in (-1, 1):
        inside = sign * np.array([[2.4, 0, 0], [0, HALF, 0], [0, 0, HALF]])
        x = np.hstack([inside, np.full((3, 3), 50.0)])  # however fast
        assert statuses(Balance(), x) == [Status.FULL_LENGTH] * 3
        x[:, :3] *= 1 + EDGE
        assert statuses(Balance(), x) == [Status.TRACK_END, Status.LINK1_FELL, Status.LINK2_FELL]


def test_the_reports_criterion_looks_at_link_1_alone() -> None:
    x = [[0, 0, 3, 0, 0, 0], [0, 2, 3, 0, 0, 0], [3, 0, 3, 0, 0, 0]]
    assert statuses(Balance(criterion="report"), x) == [Status.FULL_LENGTH, Status.LINK1_FELL, Status.TRACK_END]
    assert statuses(Balance(), x) == [Status.LINK2_FELL, Status.LINK1_FELL, Status.TRACK_END]


def test_a_link_that_has_turned_all_the_way_round_has_fallen_on_the_way() -> None:
    assert statuses(Balance(), [0, 2 * np.pi, 0, 0, 0, 0]) == [Status.LINK1_FELL]


@pytest.mark.parametrize("task", [SwingUp(), NoTask()])
def test_swing_up_and_no_task_end_at_the_track_alone(task: Task) -> None:
    x = [[2.4, 9, -9, 5, 5, 5], [2.4 * (1 + EDGE), 0, 0, 0, 0, 0], [-2.5, 0, 0, 0, 0, 0]]
    assert statuses(task, x) == [Status.FULL_LENGTH, Status.TRACK_END, Status.TRACK_END]
    assert statuses(task, x, OPEN) == [Status.FULL_LENGTH] * 3


@pytest.mark.parametrize("task", [Balance(), SwingUp(), NoTask()])
@pytest.mark.parametrize("column", range(3))
def test_a_position_or_angle_that_is_no_number_ends_every_task(task: Task, column: int) -> None:
    x = np.zeros((3, 6))
    x[1, column] = np.nan
    assert statuses(task, x) == [Status.FULL_LENGTH, Status.NOT_FINITE, Status.FULL_LENGTH]


def test_what_is_no_number_is_not_mistaken_for_the_tracks_end_or_a_fall() -> None:
    x = [[np.inf, 0, 0, 0, 0, 0], [0, -np.inf, 0, 0, 0, 0], [5, 0, 0, np.nan, 0, 0], [0, 2, 0, 0, 0, np.inf]]
    assert statuses(Balance(), x) == [Status.NOT_FINITE] * 4


def test_each_row_may_have_its_own_track() -> None:
    rig = RIG.replace(track_limit=[0.5, 2.0])
    x = [[1, 0, 0, 0, 0, 0], [1, 0, 0, 0, 0, 0]]
    assert statuses(Balance(), x, rig) == [Status.TRACK_END, Status.FULL_LENGTH]


# -------------------------------------------------------------------------------------------------------- cost, upright


def test_the_reports_cost_weighs_distances_from_the_middle_and_from_the_nearest_upright() -> None:
    task = Balance(state_weights=(2.0, 3.0, 5.0), failure_cost=7.0)
    x = np.array([[-0.5, 0.1, -0.2, 9, 9, 9], [0.5, 2 * np.pi + 0.1, -4 * np.pi - 0.2, 9, 9, 9]])
    assert_allclose(task.cost(x, np.zeros(2, dtype=np.uint8)), 2 * 0.5 + 3 * 0.1 + 5 * 0.2, rtol=1e-12)
    failed = np.array([Status.TRACK_END.code, Status.FULL_LENGTH.code], dtype=np.uint8)
    assert_allclose(task.cost(x, failed), [2.3 + 7.0, 2.3], rtol=1e-12)


def test_the_default_cost_is_ten_times_the_angles_and_nothing_for_failing() -> None:
    x = random_states(np.random.default_rng(0), 20)
    codes = np.ones(20, dtype=np.uint8)
    expected = 10 * np.abs(wrap(x[:, 1])) + 10 * np.abs(wrap(x[:, 2]))
    for task in (Balance(), SwingUp()):
        assert_allclose(task.cost(x, codes), expected, rtol=1e-12)
    assert not NoTask().cost(x, codes).any()


def test_a_swing_up_is_up_while_both_links_are_within_the_angle_of_any_upright() -> None:
    task = SwingUp(upright_angle=0.3)
    x = np.zeros((6, 6))
    x[:, 1] = [0.29, -0.29, 2 * np.pi + 0.29, 0.31, 0.0, np.pi]
    x[:, 2] = [-0.29, 0.29, -2 * np.pi, 0.0, -0.31, np.pi]
    assert task.upright(x).tolist() == [True, True, True, False, False, False]
    assert not task.upright(np.full((1, 6), np.nan)).any()


def test_balancing_and_no_task_ask_nothing_of_the_links_beyond_not_falling() -> None:
    x = random_states(np.random.default_rng(1), 5)
    for task in (Balance(), NoTask()):
        assert task.upright(x).all()
        assert task.hold == 0


def test_tasks_are_as_long_as_the_reports_unless_told_otherwise() -> None:
    assert (Balance().steps, SwingUp().steps, NoTask().steps) == (300, 1000, None)
    assert (Balance(steps=7).steps, SwingUp(steps=8).steps) == (7, 8)
    assert SwingUp(hold=0.5).hold == 0.5


# ------------------------------------------------------------------------------------------------------------ bad input


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: Balance(lam2=2.0),
            "lambda is the greatest starting angle in rad: expected 0 < lambda <= pi/2; got 2.0.",
        ),
        (lambda: Balance(steps=0), "steps must be a whole number, at least 1; got 0."),
        (
            lambda: Balance(steps=2.5),  # pyright: ignore[reportArgumentType]
            "steps must be a whole number, at least 1; got 2.5.",
        ),
        (lambda: SwingUp(steps=True), "steps must be a whole number, at least 1; got True."),
        (lambda: Balance(criterion="lax"), 'criterion must be "strict" or "report"; got \'lax\'.'),
        (
            lambda: SwingUp(start="top"),
            'start must be "hanging", "side", "up-up", "up-down", "down-up", "down-down" or "anywhere"; got \'top\'.',
        ),
        (lambda: SwingUp(angle_spread=-0.1), "angle_spread must be within 0 and pi rad; got -0.1."),
        (lambda: SwingUp(angle_spread=4.0), "angle_spread must be within 0 and pi rad; got 4.0."),
        (lambda: SwingUp(hold=-1.0), "hold must be finite and greater than 0 s; got -1.0."),
        (lambda: SwingUp(hold=np.inf), "hold must be finite and greater than 0 s; got inf."),
        (lambda: SwingUp(upright_angle=0.0), "upright_angle must be between 0 and pi rad; got 0.0."),
        (lambda: SwingUp(upright_angle=np.nan), "upright_angle must be between 0 and pi rad; got nan."),
        (
            lambda: Balance(state_weights=(1.0, 2.0)),  # pyright: ignore[reportArgumentType]
            "state_weights must be three finite numbers, at least 0, for |pos|, |th1| and |th2|; got (1.0, 2.0).",
        ),
        (
            lambda: SwingUp(state_weights=(1.0, -2.0, 3.0)),
            "state_weights must be three finite numbers, at least 0, for |pos|, |th1| and |th2|; got (1.0, -2.0, 3.0).",
        ),
        (
            lambda: Balance(state_weights=(1.0, np.inf, 3.0)),
            "state_weights must be three finite numbers, at least 0, for |pos|, |th1| and |th2|; got (1.0, inf, 3.0).",
        ),
        (lambda: Balance(failure_cost=-1.0), "failure_cost must be finite and at least 0; got -1.0."),
        (lambda: SwingUp(failure_cost=np.nan), "failure_cost must be finite and at least 0; got nan."),
    ],
)
def test_a_task_that_makes_no_sense_is_refused(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=whole(message)):
        call()


# ---------------------------------------------------------------------------------------------------------------- state


def test_wrap_gives_the_difference_to_the_nearest_whole_turn() -> None:
    angles = np.random.default_rng(2).uniform(-40, 40, (10, 20))
    wrapped = wrap(angles)
    assert wrapped.shape == angles.shape
    assert np.abs(wrapped).max() <= np.pi
    turns = (angles - wrapped) / (2 * np.pi)
    assert_allclose(turns, np.rint(turns), rtol=0, atol=1e-12)
    inside = np.linspace(-3.14, 3.14, 50)
    assert np.array_equal(wrap(inside), inside)
    assert_allclose(wrap([2 * np.pi + 0.1, -0.1 - 4 * np.pi, 3.5]), [0.1, -0.1, 3.5 - 2 * np.pi], atol=1e-14)


def test_nearest_upright_turns_the_angles_only_and_leaves_its_argument_alone() -> None:
    x = random_states(np.random.default_rng(3), 12).reshape(3, 4, 6)
    before = x.copy()
    near = nearest_upright(x)
    assert_allclose(near[..., 1:3], wrap(x[..., 1:3]), rtol=0, atol=0)
    assert np.array_equal(near[..., [0, 3, 4, 5]], x[..., [0, 3, 4, 5]])
    near[:] = 0.0
    assert np.array_equal(x, before)


def test_the_four_equilibria_are_named_by_their_links_first_link_first() -> None:
    angles = {name: (x[1], x[2]) for name, x in dpend.EQUILIBRIA.items()}
    assert angles == {"up-up": (0, 0), "up-down": (0, np.pi), "down-up": (np.pi, 0), "down-down": (np.pi, np.pi)}
    for x in dpend.EQUILIBRIA.values():
        assert not x[[0, 3, 4, 5]].any()
        with pytest.raises(ValueError, match="read-only"):
            x[0] = 1.0


def test_every_state_has_a_name_and_a_unit() -> None:
    assert NAMES == ("pos", "th1", "th2", "vel", "om1", "om2")
    assert UNITS == ("m", "rad", "rad", "m/s", "rad/s", "rad/s")


def test_states_are_taken_by_copy_and_one_stands_for_all() -> None:
    x = np.zeros((2, 6))
    taken = as_states(x)
    taken[:] = 1.0
    assert not x.any()
    assert as_states(range(6)).tolist() == [[0, 1, 2, 3, 4, 5]]
    many = as_states(range(6), 3)
    assert many.tolist() == [[0, 1, 2, 3, 4, 5]] * 3
    assert as_states(np.asfortranarray(np.ones((4, 6)))).flags.c_contiguous
    message = (
        "A state has six numbers (pos, th1, th2, vel, om1, om2): expected an array of shape (3, 6) or (6,); "
        "got shape (2, 6)."
    )
    with pytest.raises(ValueError, match=whole(message)):
        as_states(x, 3)


@pytest.mark.parametrize("target", EQUILIBRIA)
def test_a_swing_up_to_any_equilibrium_starts_at_one_and_counts_from_the_other(target: str) -> None:
    task = SwingUp(start=target, target=target)
    x = draw(task, 2)
    assert np.array_equal(x, np.tile(EQUILIBRIA[target], (2, 1)))
    assert_allclose(task.cost(x, np.zeros(2, dtype=np.uint8)), 0.0, atol=1e-14)
    x[1, 1:3] += 2 * np.pi * np.array([1, -2]) + [0.19, -0.19]
    assert task.upright(x).all()
    assert_allclose(task.cost(x, np.zeros(2, dtype=np.uint8)), [0.0, 3.8], atol=1e-12)
    x[1, 2] -= 0.02
    assert task.upright(x).tolist() == [True, False]


def test_a_deviation_is_a_difference_with_its_angles_brought_back_to_one_turn() -> None:
    rng = np.random.default_rng(3)
    x, about = random_states(rng, 50), as_equilibrium("down-up")
    off = deviation(x, about)
    assert (np.abs(off[:, 1:3]) <= np.pi).all()
    turns = (x - about - off) / (2 * np.pi)
    assert_allclose(turns[:, 1:3], np.rint(turns[:, 1:3]), atol=1e-12)
    assert not turns[:, [0, 3, 4, 5]].any()
    assert not deviation(about, about).any()


def test_an_equilibrium_may_stand_anywhere_and_have_turned_any_number_of_times() -> None:
    x = [1.5, 3 * np.pi, -2 * np.pi, 0, 0, 0]
    assert np.array_equal(as_equilibrium(x), x)
    for name, state in EQUILIBRIA.items():
        assert as_equilibrium(name) is state


@pytest.mark.parametrize(
    ("about", "message"),
    [
        ("up-donw", "There is no equilibrium 'up-donw'. Did you mean 'up-down'?"),
        *(
            (
                state,
                "An equilibrium is at rest with each link straight up or down: expected one of up-up, up-down, "
                f"down-up, down-down or a state (pos, k1 pi, k2 pi, 0, 0, 0); got {state!r}.",
            )
            for state in ([0, 1, 0, 0, 0, 0], [0, 0, 0, 0, 1, 0], [0, np.nan, 0, 0, 0, 0], [0, 0, 0])
        ),
    ],
)
def test_what_is_no_equilibrium_is_refused(about: Any, message: str) -> None:
    with pytest.raises(ValueError, match=whole(message)):
        as_equilibrium(about)
    if isinstance(about, str):
        with pytest.raises(ValueError, match=whole(message)):
            SwingUp(target=about)
