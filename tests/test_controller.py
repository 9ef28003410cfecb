"""What a controller is, and what becomes of a run whose law has no force to give, or fails."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import dpend
from controllers import LQR, BangBang, LowPass, Predictor, RateLimit, SwitchingController, WithEstimator
from dpend import LawError, Status, simulate, simulate_many
from dpend.controller import Act, FunctionController, as_controller, is_batched, name_of
from dpend.params import Array
from tests.rigs import whole

RIG = dpend.rig("gustafsson2016")
K = np.array([1.0, -150.0, 180.0, 3.0, -4.0, 30.0])
STARTS = np.array([[0, 0.05, 0.02, 0, 0, 0], [0, -0.04, 0.03, 0, 0, 0], [0, 0.01, -0.02, 0, 0, 0]])


def by_hand(t: float, x: Array) -> float:
    return -float(K @ x)


class Scripted:
    """A law that returns what a function of the step says."""

    def __init__(self, forces: Callable[[int, int], Any], batched: bool = True) -> None:
        self.forces, self.batched = forces, batched

    def start(self, n: int, rng: np.random.Generator) -> Act:
        return lambda t, y: self.forces(round(t / 0.02), n)


# ---------------------------------------------------------------------------------------------------- plain functions


def test_a_plain_function_of_one_state_is_a_controller() -> None:
    class Gain:
        def start(self, n: int, rng: np.random.Generator) -> Act:
            return lambda t, y: np.array([-float(K @ row) for row in y])

    runs = simulate_many(RIG, by_hand, STARTS, 0.5, record=True, seed=3)
    same = simulate_many(RIG, Gain(), STARTS, 0.5, record=True, seed=3)
    assert_array_equal(runs.u, same.u)
    assert runs.controller == "by_hand"
    assert simulate(RIG, by_hand, STARTS[0], 0.5).controller == "by_hand"


def test_a_plain_function_gets_states_of_its_own_and_may_return_an_array_of_one_number() -> None:
    seen = []

    def law(t: float, x: Array) -> Array:
        seen.append(x.shape)
        x[:] = np.nan
        return np.array([1.0])

    run = simulate(RIG, law, STARTS[0], 0.1)
    assert seen == [(6,)] * 5
    assert run.u.tolist() == [1.0] * 5
    assert np.isfinite(run.y).all()


@pytest.mark.parametrize(
    "around",
    [
        lambda law: RateLimit(RIG, law, 400.0),
        lambda law: LowPass(RIG, law, frequency=20.0),
        lambda law: BangBang(law, 10.0),
        lambda law: WithEstimator(Predictor(RIG), law),
        lambda law: SwitchingController(RIG, law, LQR(RIG)),
    ],
)
def test_a_plain_function_may_stand_inside_a_wrapper(around: Callable[[Any], Any]) -> None:
    plain, described = (simulate(RIG, around(law), STARTS[0], 1.0) for law in (by_hand, FunctionController(by_hand)))
    assert_array_equal(plain.u, described.u)
    assert "by_hand" in plain.controller


def test_what_has_a_start_stays_as_it_is_and_a_function_is_run_row_by_row_and_may_be_sent() -> None:
    law = Scripted(lambda k, n: np.zeros(n))
    assert as_controller(law) is law
    function = as_controller(by_hand)
    assert function == FunctionController(by_hand) == pickle.loads(pickle.dumps(function))
    assert not is_batched(function)
    assert name_of(function) == "by_hand"
    for wrong, message in (
        (3, "A controller has a method start(n, rng) that returns act(t, y); int has none."),
        (Scripted, "Expected a controller object; got the class Scripted. Call it first."),
    ):
        with pytest.raises(TypeError, match=whole(message)):
            as_controller(wrong)  # type: ignore[arg-type]


def test_a_name_that_is_no_word_is_recorded_as_one() -> None:
    law = Scripted(lambda k, n: np.zeros(n))
    law.name = 7  # type: ignore[attr-defined]
    assert simulate(RIG, law, STARTS[0], 0.1).controller == "7"


# -------------------------------------------------------------------------------------------------- no number, failure


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_the_last_finite_force_counts_where_there_is_none_and_the_log_says_where(bad: float) -> None:
    table = np.array([[bad, 3.0], [2.0, bad], [bad, bad], [5.0, 6.0]])
    runs = simulate_many(RIG, Scripted(lambda k, n: table[k].copy()), STARTS[:2], 0.08, record=True)
    assert runs.u.T.tolist() == [[0.0, 3.0], [2.0, 3.0], [2.0, 3.0], [5.0, 6.0]]
    assert runs.log["not_finite"].T.tolist() == [[1, 0], [0, 1], [1, 1], [0, 0]]
    assert runs.status == [Status.FULL_LENGTH] * 2
    assert np.isfinite(runs.final).all()
    assert runs[0].log["not_finite"].tolist() == [1, 0, 1, 0]


def test_a_run_of_finite_forces_has_no_such_log() -> None:
    assert not simulate(RIG, by_hand, STARTS[0], 0.1).log


def raising(k: int, n: int) -> Array:
    if k == 3:
        raise ZeroDivisionError("division by zero")
    return np.full(n, 1.0)


@pytest.mark.parametrize(
    ("forces", "reason"),
    [
        (raising, "ZeroDivisionError: division by zero"),
        (lambda k, n: raising(0, n) if k < 3 else "left", "Expected one force per row, shape (3,); got 'left'"),
        (
            lambda k, n: raising(0, n) if k < 3 else [[1.0], [1.0, 2.0]],
            "Expected one force per row, shape (3,); got [[1.0], [1.0, 2.0]]",
        ),
        (
            lambda k, n: np.ones((n, 1)) if k == 3 else np.ones(n),
            "Expected one force per row, shape (3,); got shape (3, 1). A law written as y @ K.T returns a column: take "
            "[:, 0]",
        ),
    ],
)
def test_a_law_that_fails_on_the_way_is_named_with_time_and_rows_and_the_runs_are_kept(
    forces: Callable[[int, int], Any], reason: str
) -> None:
    message = (
        f"Scripted failed at t = 0.06 s in rows 0 to 2: {reason}. The runs up to there are kept in the error's `runs`."
    )
    with pytest.raises(LawError, match=whole(message)) as refusal:
        simulate_many(RIG, Scripted(forces), STARTS, 0.2, record=True)
    runs = refusal.value.runs
    assert runs.steps.tolist() == [3, 3, 3]
    assert runs.status == [Status.CONTROLLER_FAILED] * 3
    assert not runs.success.any()
    whole_runs = simulate_many(RIG, Scripted(lambda k, n: np.ones(n)), STARTS, 0.2, record=True)
    for kept, run in zip(runs, whole_runs, strict=True):
        assert_array_equal(kept.x, run.x[:4])
        assert_array_equal(kept.u, run.u[:3])


def test_a_law_that_fails_in_one_row_leaves_the_rows_before_it_whole() -> None:
    def law(t: float, x: Array) -> float:
        if x[2] < -0.015 and t > 0.05:
            raise OSError("the wire broke")
        return by_hand(t, x)

    message = (
        "law failed at t = 0.06 s in row 12: OSError: the wire broke. The runs up to there are kept in the error's "
        "`runs`."
    )
    with pytest.raises(LawError, match=whole(message)) as refusal:
        simulate_many(RIG, law, STARTS, 0.2, record=True, first_row=10)
    runs = refusal.value.runs
    assert runs.status == [Status.FULL_LENGTH, Status.FULL_LENGTH, Status.CONTROLLER_FAILED]
    assert runs.steps.tolist() == [10, 10, 3]
    assert_array_equal(runs[0].x, simulate_many(RIG, by_hand, STARTS, 0.2, record=True)[0].x)


def test_a_law_of_one_run_at_a_time_is_given_a_row_and_told_so_where_it_takes_it_for_a_state() -> None:
    class OneAtATime:
        batched = False

        def __init__(self, law: Act) -> None:
            self.law = law

        def start(self, n: int, rng: np.random.Generator) -> Act:
            return self.law

    message = (
        "OneAtATime failed at t = 0 s in row 0: IndexError: index 1 is out of bounds for axis 0 with size 1, with "
        "measurements of one row, (1, 6), whose state is y[0]. The runs up to there are kept in the error's `runs`."
    )
    with pytest.raises(LawError, match=whole(message)):
        simulate(RIG, OneAtATime(lambda t, y: 10 * y[1]), STARTS[0], 0.2)
    row = simulate(RIG, OneAtATime(lambda t, y: np.array([by_hand(t, y[0])])), STARTS[0], 0.2)
    assert_array_equal(row.x, simulate(RIG, by_hand, STARTS[0], 0.2).x)


def test_a_push_that_fails_on_the_way_is_named_as_such() -> None:
    message = (
        "The push failed at t = 0.04 s in row 0: A push is a force on the cart in N and torques on link 1 and link 2 "
        "in N m: expected shape (3,) or (1, 3); got shape (2,). The runs up to there are kept in the error's `runs`."
    )
    with pytest.raises(LawError, match=whole(message)) as refusal:
        simulate(RIG, by_hand, STARTS[0], 0.2, push=lambda t: (0, 0, 0) if t < 0.03 else (0, 0))
    assert refusal.value.runs.steps.tolist() == [2]


def test_an_interrupt_is_not_taken_for_a_failure_of_the_law() -> None:
    def law(t: float, x: Array) -> float:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate(RIG, law, STARTS[0], 0.2)
