"""Runs are loops over the stepper: they end when they should, say why, and can be cut and joined at will."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal, assert_equal
from rigs import endless, random_params, random_states, whole

import dpend
from controllers import LQR, Constant, Zero
from dpend import Act, Balance, Rig, Run, Runs, Status, Stepper, SwingUp, simulate, simulate_many
from dpend.params import Array
from dpend.provenance import versions

NOISY = {"force_limit": 20.0, "actuator_lag": 0.02, "actuator_delay": 1, "force_noise": 0.3, "sensor_noise": 0.01}
UPRIGHT = np.zeros(6)
HANGING = dpend.EQUILIBRIA["down-down"]
SIMULATE = sys.modules["dpend.simulate"]  # the name in the package is the function


class Feedback:
    """A state feedback summed state by state, so that a row's force does not hang on the rows beside it."""

    def __init__(self, gain: Array) -> None:
        self.gain = gain

    def start(self, n: int, rng: np.random.Generator) -> Act:
        return lambda t, y: -sum((self.gain[k] * y[:, k] for k in range(6)), np.zeros(n))


class OneByOne(Feedback):
    """The same law for one run at a time, which it checks."""

    batched: ClassVar[bool] = False

    def start(self, n: int, rng: np.random.Generator) -> Act:
        assert n == 1
        return super().start(n, rng)


class Integral:
    """A law with memory: it sums what it measures."""

    def start(self, n: int, rng: np.random.Generator) -> Act:
        total = np.zeros(n)

        def act(t: float, y: Array) -> Array:
            nonlocal total
            total = total + y[:, 1]
            return -50 * y[:, 1] + total

        return act


class Dice:
    """A law that draws its force."""

    batched: ClassVar[bool] = False

    def start(self, n: int, rng: np.random.Generator) -> Act:
        return lambda t, y: rng.normal(size=n)


@dataclass
class Script:
    """A law that follows a table of forces ``(T,)`` or ``(T, n)``, sample by sample."""

    table: Array

    def start(self, n: int, rng: np.random.Generator) -> Act:
        lines = iter(self.table)
        return lambda t, y: np.broadcast_to(next(lines), n)


def balancing(rig: Rig, kind: type[Feedback] = Feedback) -> Feedback:
    return kind(LQR(rig.replace(sensor_noise=0.0)).K[0])


def starts(n: int, seed: int = 0, spread: float = 0.2) -> Array:
    x0 = np.zeros((n, 6))
    x0[:, 1:3] = np.random.default_rng(seed).uniform(-spread, spread, (n, 2))
    return x0


def assert_same(mine: Runs, theirs: Runs) -> None:
    """Hold two records of runs to being the same, bit by bit, but for the clock on the wall."""
    for name in ("t", "u", "steps", "codes", "success", "final", "travel", "time_up", "x", "y"):
        assert_array_equal(getattr(mine, name), getattr(theirs, name), err_msg=name)


def recorded(runs: Runs) -> tuple[Array, Array]:
    return runs.x, runs.y


# ------------------------------------------------------------------------------------------------------------- the loop


def test_a_run_is_the_loop_over_the_stepper_that_one_would_write() -> None:
    rig = dpend.rig("gustafsson2016").replace(**NOISY)
    law, x0, n = balancing(rig), starts(4), 4
    runs = simulate_many(rig, law, x0, 0.4, task=None, seed=3, record=True)
    stepper = Stepper(rig, n, seed=3)
    act = law.start(n, np.random.default_rng(0))
    y = stepper.reset(x0)
    x, measured = recorded(runs)
    assert_array_equal(runs.t, 0.02 * np.arange(21))
    assert_array_equal(x[:, 0], x0)
    assert_array_equal(measured[:, 0], y)
    for k in range(20):
        y = stepper.step(act(k * 0.02, y))
        assert_array_equal(runs.u[:, k], stepper.force)
        assert_array_equal(x[:, k + 1], stepper.x)
        assert_array_equal(measured[:, k + 1], y)
    assert_array_equal(runs.final, stepper.x)
    assert_array_equal(runs.travel, np.abs(x[:, :, 0]).max(axis=1))
    assert runs.steps.tolist() == [20] * n


def test_the_law_is_told_the_time_of_each_sample() -> None:
    told = []

    class Clock:
        def start(self, n: int, rng: np.random.Generator) -> Act:
            return lambda t, y: told.append(t) or np.zeros(n)

    simulate(endless(), Clock(), HANGING, 0.1, task=None)
    assert_allclose(told, 0.02 * np.arange(5), rtol=0, atol=1e-15)


def test_without_a_duration_a_run_lasts_as_long_as_its_task() -> None:
    rig = endless()
    assert len(simulate(rig, balancing(rig), UPRIGHT).u) == 300
    assert len(simulate(rig, Zero(), HANGING, task=SwingUp(steps=40)).u) == 40
    assert len(simulate(rig, balancing(rig), UPRIGHT, 0.5, task=Balance(steps=7)).u) == 25


def test_the_same_seed_gives_the_same_run_and_another_seed_another() -> None:
    rig = endless(**NOISY)
    law, x0 = balancing(rig), starts(3)
    runs = [simulate_many(rig, law, x0, 1.0, seed=seed, record=True) for seed in (1, 1, 2)]
    assert_same(runs[0], runs[1])
    assert not np.array_equal(runs[0].u, runs[2].u)


def test_recording_changes_nothing() -> None:
    rig = endless(**NOISY)
    law, x0 = balancing(rig), starts(5)
    kept = simulate_many(rig, law, x0, 1.0, record=True)
    bare = simulate_many(rig, law, x0, 1.0)
    for name in ("x", "y"):
        with pytest.raises(AttributeError, match=whole("These runs hold no states; simulate them with record=True.")):
            getattr(bare, name)
    for name in ("u", "final", "travel", "steps", "codes", "success"):
        assert_array_equal(getattr(bare, name), getattr(kept, name))
    for name, value in bare.metrics().items():
        assert_array_equal(value, kept.metrics()[name])


def test_one_run_is_row_0_of_a_batch_of_one() -> None:
    rig = endless(**NOISY)
    law, x0 = balancing(rig), starts(1)
    run = simulate(rig, law, x0[0], 1.0, seed=4)
    row = simulate_many(rig, law, x0, 1.0, seed=4, record=True)[0]
    for name in ("t", "x", "y", "u"):
        assert_array_equal(getattr(run, name), getattr(row, name))
    assert_equal(run.metrics(), row.metrics())
    assert (run.status, run.success, run.seed, run.row) == (row.status, row.success, 4, 0)


def test_every_run_gets_fresh_memory() -> None:
    rig, law = endless(), Integral()
    first, again = (simulate_many(rig, law, starts(3), 0.5, task=None) for _ in range(2))
    assert_array_equal(first.u, again.u)
    assert np.abs(np.diff(first.u, axis=1)).max() > 0.1


# ----------------------------------------------------------------------------------------------------- rows and batches


@pytest.mark.parametrize("rig", [endless(), endless(**NOISY)], ids=["ideal", "noisy"])
def test_row_i_of_a_batch_is_bitwise_the_single_run_of_it(rig: Rig) -> None:
    law, x0 = balancing(rig), starts(300)
    together = simulate_many(rig, law, x0, 1.0, seed=5, record=True)
    for i in (0, 1, 137, 255, 256, 299):
        alone = simulate_many(rig, law, x0[i], 1.0, seed=5, first_row=i, record=True)[0]
        for name in ("x", "y", "u"):
            assert_array_equal(getattr(alone, name), getattr(together[i], name))
        assert alone.row == together[i].row == i


def test_the_regulator_treats_a_row_of_a_batch_as_a_single_run() -> None:
    rig = endless()
    lqr, x0 = LQR(rig), starts(300)
    together = simulate_many(rig, lqr, x0, 1.0, record=True)
    for i in (0, 137, 299):
        assert_array_equal(simulate(rig, lqr, x0[i], 1.0).x, together[i].x)


def test_parts_numbered_by_their_first_row_make_the_whole() -> None:
    rig = endless(**NOISY)
    law, x0 = balancing(rig), starts(20)
    whole_batch = simulate_many(rig, law, x0, 0.6, seed=6, record=True)
    parts = [simulate_many(rig, law, x0[a:b], 0.6, seed=6, first_row=a, record=True) for a, b in ((0, 7), (7, 20))]
    assert [part.first_row for part in parts] == [0, 7]
    assert_same(Runs.join(parts, rig), whole_batch)
    assert parts[1][3].row == whole_batch[10].row == 10


def test_how_a_batch_is_cut_into_blocks_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = endless(**NOISY).replace(mass1=np.linspace(0.4, 0.6, 20))
    law, x0 = balancing(endless()), starts(20)
    at_once = simulate_many(rig, law, x0, 0.6, record=True)
    monkeypatch.setattr(SIMULATE, "BLOCK", 6)
    in_blocks = simulate_many(rig, law, x0, 0.6, record=True)
    assert_same(in_blocks, at_once)
    assert in_blocks.rig == rig
    assert_array_equal(in_blocks.metrics()["variation"], at_once.metrics()["variation"])


def test_one_rig_a_row_is_that_rig_alone() -> None:
    rng = np.random.default_rng(7)
    n = 6
    rig = endless(params=random_params(rng, n)).replace(
        force_limit=rng.uniform(10, 30, n),
        track_limit=[0.1, np.inf, 0.3, np.inf, 0.05, np.inf],
        actuator_delay=[0, 1, 2, 0, 1, 2],
        sensor_noise=rng.uniform(0, 0.05, (n, 1)),
    )
    x0 = random_states(rng, n, scale=0.1)
    x0[:, 0] = 0.0
    law = balancing(endless())
    together = simulate_many(rig, law, x0, 1.0, task=None, seed=7, record=True)
    for i in range(n):
        alone = simulate_many(rig.rows(i), law, x0[i], 1.0, task=None, seed=7, first_row=i, record=True)[0]
        run = together[i]
        assert alone.status is run.status is (Status.FULL_LENGTH if i % 2 else Status.TRACK_END)
        assert_allclose(alone.x, run.x, rtol=0, atol=1e-9)  # one plant for all is another kernel
        assert_allclose(alone.y, run.y, rtol=0, atol=1e-9)
        assert run.rig == alone.rig


def test_row_by_row_laws_agree_with_batched_ones() -> None:
    rig = endless(**NOISY)
    x0 = starts(6)
    batched = simulate_many(rig, balancing(rig), x0, 0.5, seed=8, record=True)
    by_row = simulate_many(rig, balancing(rig, OneByOne), x0, 0.5, seed=8, record=True)
    assert_same(by_row, batched)
    assert (by_row.controller, batched.controller) == ("OneByOne", "Feedback")


def test_row_by_row_laws_draw_from_a_stream_of_their_row() -> None:
    rig, x0 = endless(), np.tile(HANGING, (4, 1))
    runs = simulate_many(rig, Dice(), x0, 1.0, task=None, seed=9)
    assert np.abs(np.corrcoef(runs.u) - np.eye(4)).max() < 0.5
    assert_array_equal(simulate_many(rig, Dice(), x0[:1], 1.0, task=None, seed=9, first_row=2).u[0], runs.u[2])


@pytest.mark.slow
def test_worker_processes_give_what_one_process_gives() -> None:
    rig = endless(**NOISY)
    law, x0 = balancing(rig, OneByOne), starts(6)
    assert_same(
        simulate_many(rig, law, x0, 0.2, seed=10, record=True, workers=2),
        simulate_many(rig, law, x0, 0.2, seed=10, record=True),
    )


# -------------------------------------------------------------------------------------------------------- how runs end


def test_a_run_ends_where_the_track_does() -> None:
    rig = endless(track_limit=0.5)
    run = simulate(rig, Constant(20.0), HANGING, 2.0, task=None)
    assert run.status is Status.TRACK_END
    assert not run.success
    assert run.x[-1, 0] > 0.5 >= run.x[-2, 0]
    assert simulate(rig, Constant(-20.0), HANGING, 2.0, task=None).x[-1, 0] < -0.5


@pytest.mark.parametrize(
    ("lean", "criterion", "status"),
    [
        ((1.5, 0.0), "strict", Status.LINK1_FELL),
        ((-1.5, 0.0), "report", Status.LINK1_FELL),
        ((0.0, 1.5), "strict", Status.LINK2_FELL),
    ],
)
def test_a_balanced_run_ends_when_a_link_falls(lean: tuple[float, float], criterion: str, status: Status) -> None:
    x0 = np.array([0.0, *lean, 0.0, 3 * lean[0], 3 * lean[1]])
    run = simulate(endless(), Zero(), x0, task=Balance(criterion=criterion))
    assert run.status is status
    assert not run.success
    fallen = 1 if status is Status.LINK1_FELL else 2
    assert abs(run.x[-1, fallen]) > np.pi / 2
    assert (np.abs(run.x[:-1, fallen]) <= np.pi / 2).all()


def test_the_reports_criterion_lets_link_2_fall() -> None:
    x0 = np.array([0.0, 0.0, 1.5, 0.0, 0.0, 5.0])
    strict = simulate(endless(), Zero(), x0, task=Balance(steps=4))
    lax = simulate(endless(), Zero(), x0, task=Balance(steps=4, criterion="report"))
    assert strict.status is Status.LINK2_FELL
    assert (lax.status, lax.success) == (Status.FULL_LENGTH, True)


def test_a_run_ends_when_its_state_is_no_number() -> None:
    for force in (np.nan, np.inf):
        push = {0: 1.0, 1: force}
        run = simulate(
            endless(),
            Zero(),
            HANGING,
            0.08,
            task=None,
            push=lambda t, push=push: (push.get(round(t / 0.02), 1.0), 0, 0),
        )
        assert run.status is Status.NOT_FINITE
        assert len(run.u) == 2
        assert np.isfinite(run.x[1]).all()
        assert not np.isfinite(run.x[2]).all()


def test_a_run_that_begins_beyond_the_end_has_no_samples() -> None:
    x0 = np.array([[0.0, 2.0, 0, 0, 0, 0], [0.0, 0.01, 0, 0, 0, 0], [3.0, 0, 0, 0, 0, 0]])
    rig = dpend.rig("gustafsson2016")
    runs = simulate_many(rig, balancing(rig), x0, 0.4, record=True)
    assert runs.status == [Status.LINK1_FELL, Status.FULL_LENGTH, Status.TRACK_END]
    assert runs.steps.tolist() == [0, 20, 0]
    assert runs.success.tolist() == [False, True, False]
    assert_array_equal(runs.final[[0, 2]], x0[[0, 2]])
    assert runs[0].x.shape == (1, 6)
    assert runs[0].u.shape == (0,)
    assert runs[0].metrics()["seconds"] == 0


def test_a_status_says_in_words_how_the_run_ended() -> None:
    assert [status.value for status in Status] == [
        "The run reached its full length.",
        "The cart reached the end of the track.",
        "Link 1 fell: it leans by more than a quarter turn.",
        "Link 2 fell: it leans by more than a quarter turn.",
        "The state is no longer a finite number.",
        "The controller, or the push, failed; the run is kept up to there.",
    ]
    assert [status.code for status in Status] == [0, 1, 2, 3, 4, 5]


def test_what_a_run_did_not_live_to_see_is_nan() -> None:
    rig = dpend.rig("gustafsson2016").replace(**NOISY)
    x0 = starts(40, spread=0.35)
    runs = simulate_many(rig, balancing(rig), x0, record=True)
    x, y = recorded(runs)
    assert 5 < runs.success.sum() < 35
    sample = np.arange(300)
    after = sample >= runs.steps[:, None]
    assert np.isnan(runs.u[after]).all()
    assert np.isfinite(runs.u[~after]).all()
    for states in (x, y):
        assert np.isnan(states[:, 1:][after]).all()
        assert np.isfinite(states[:, :-1][~after]).all()
    for i, run in enumerate(map(runs.__getitem__, range(40))):
        assert len(run.u) == runs.steps[i]
        assert_array_equal(run.x[-1], runs.final[i])
        assert run.status is runs.status[i]


def test_a_run_that_has_ended_disturbs_nobody() -> None:
    rig = dpend.rig("gustafsson2016").replace(**NOISY)
    law, x0 = balancing(rig), starts(3)
    alone = simulate_many(rig, law, x0[2], 1.0, first_row=2, record=True)[0]
    x0[0, 1], x0[1, 2] = 1.5, 2.0  # falls soon; has fallen
    runs = simulate_many(rig, law, x0, 1.0, record=True)
    assert runs.success.tolist() == [False, False, True]
    assert_array_equal(runs[2].x, alone.x)


def test_a_run_that_has_blown_up_is_parked_out_of_the_laws_sight() -> None:
    class Watching:
        def start(self, n: int, rng: np.random.Generator) -> Act:
            def act(t: float, y: Array) -> Array:
                assert np.isfinite(y).all()
                return np.ones(n)

            return act

    push = np.array([[np.nan, 0, 0], [0, 0, 0]])
    x0 = np.tile(HANGING, (2, 1))
    runs = simulate_many(endless(), Watching(), x0, 0.2, task=None, push=lambda t: push if t == 0 else np.zeros(3))
    assert runs.status == [Status.NOT_FINITE, Status.FULL_LENGTH]


def test_travel_ends_with_the_run() -> None:
    rig = dpend.rig("gustafsson2016").replace(force_noise=20.0)
    x0 = starts(20, spread=1.2)
    runs = simulate_many(rig, balancing(rig), x0, record=True, push=lambda t: [5.0, 0.0, 0.0])
    assert (~runs.success).sum() > 5
    x, _ = recorded(runs)
    assert_array_equal(runs.travel, np.nanmax(np.abs(x[:, :, 0]), axis=1))
    for i in range(20):
        assert runs[i].metrics()["travel"] == runs.metrics()["travel"][i]


# ------------------------------------------------------------------------------------------------------------- swing-up


def falling_from_above(hold: float, samples: int) -> Run:
    """Let the plant fall from nearly upright; it stays within .2 rad for a while."""
    return simulate(endless(), Zero(), [0, 0.02, 0.02, 0, 0, 0], task=SwingUp(steps=samples, hold=hold))


def test_a_swing_up_succeeds_only_if_the_links_stayed_up_for_long_enough() -> None:
    x = falling_from_above(0.02, 100).x
    up = (np.abs(x[:, 1:3]) <= 0.2).all(axis=1)
    lasted = int(np.argmin(up)) - 1  # the last sample at which both were still up
    assert 5 < lasted < 60
    assert falling_from_above(lasted * 0.02, lasted).success
    assert not falling_from_above((lasted + 1) * 0.02, lasted).success
    assert not falling_from_above(0.1, lasted + 1).success
    assert falling_from_above(lasted * 0.02, lasted).time_up == 0.0
    assert np.isnan(falling_from_above(0.1, lasted + 1).time_up)


def test_the_time_up_is_when_both_links_came_up_for_good() -> None:
    rig = endless()
    x0 = [0.0, 0.35, 0.3, 0.0, 0.0, 0.0]
    run = simulate(rig, balancing(rig), x0, task=SwingUp(steps=400))
    assert run.success
    down = np.flatnonzero((np.abs(run.x[:, 1:3]) > 0.2).any(axis=1))
    arrived = int(down[-1]) + 1
    assert_allclose(run.time_up, arrived * rig.sample_time, rtol=1e-12)
    assert 0 < arrived < 300


def test_a_start_that_is_an_end_is_refused_with_a_word_on_radians() -> None:
    message = (
        "The run would end where it starts, at x0 = [0, 10, 0, 0, 0, 0]: Link 1 fell: it leans by more than a quarter "
        "turn. Angles are in radians; choose another start, or task=None."
    )
    with pytest.raises(ValueError, match=whole(message)):
        simulate(endless(), Zero(), [0, 10, 0, 0, 0, 0])


@pytest.mark.parametrize("push", [lambda t: 5.0, lambda t: np.ones((4, 1)), lambda t: np.ones(4)])
def test_a_push_of_another_shape_is_refused_before_anything_runs(push: Any) -> None:
    message = (
        "A push is a force on the cart in N and torques on link 1 and link 2 in N m: "
        f"expected shape (3,) or (4, 3); got shape {np.shape(push(0.0))}."
    )
    with pytest.raises(ValueError, match=whole(message)):
        simulate_many(endless(), Zero(), np.zeros((4, 6)), 1.0, push=push)


def test_a_swing_up_that_leaves_the_track_fails() -> None:
    run = simulate(endless(track_limit=0.2), Constant(10.0), HANGING, task=SwingUp(steps=50))
    assert (run.status, run.success) == (Status.TRACK_END, False)


# --------------------------------------------------------------------------------------------------------------- pushes


def test_a_push_on_the_cart_is_as_good_as_the_actuators_force() -> None:
    rig = endless()
    table = np.random.default_rng(11).uniform(-5, 5, 20)
    pushed = simulate(rig, Zero(), HANGING, 0.4, task=None, push=lambda t: [table[round(t / 0.02)], 0.0, 0.0])
    told = simulate(rig, Script(table), HANGING, 0.4, task=None)
    assert_array_equal(pushed.x, told.x)
    assert_array_equal(pushed.log["push_cart"], table[: len(pushed.u)])
    assert not pushed.u.any()


def test_a_push_may_differ_from_row_to_row(monkeypatch: pytest.MonkeyPatch) -> None:
    rig, x0 = endless(), np.tile(HANGING, (5, 1))
    pushes = np.random.default_rng(12).uniform(-2, 2, (5, 3))
    monkeypatch.setattr(SIMULATE, "BLOCK", 2)
    runs = simulate_many(rig, Zero(), x0, 0.2, task=None, push=lambda t: pushes * (t < 0.1))
    for i in range(5):
        alone = simulate(rig, Zero(), HANGING, 0.2, task=None, push=lambda t, i=i: pushes[i] * (t < 0.1))
        assert_array_equal(runs.final[i], alone.x[-1])
    assert len(np.unique(runs.final[:, 0])) == 5


# ----------------------------------------------------------------------------------------------------- paired by design


def test_every_controller_meets_the_same_disturbances() -> None:
    rig = endless(force_noise=1.0, sensor_noise=0.1)
    x0 = np.tile(HANGING, (4, 1))
    noise = []
    for law, command in ((Zero(), 0.0), (Constant(3.0), 3.0)):
        runs = simulate_many(rig, law, x0, 1.0, task=None, seed=13, record=True)
        x, y = recorded(runs)
        noise.append((runs.u - command, y - x))
    for mine, theirs in zip(*noise, strict=True):
        assert_allclose(mine, theirs, rtol=0, atol=1e-12)


# -------------------------------------------------------------------------------------------------------------- records


def test_a_run_says_what_ran() -> None:
    run = simulate(endless(), LQR(endless()), UPRIGHT, 0.1, task=Balance(lam=0.3), seed=14)
    assert (run.controller, run.seed, run.row) == ("LQR", 14, 0)
    assert run.task == repr(Balance(lam=0.3))
    assert run.rig == endless()


def test_the_time_a_law_takes_is_measured() -> None:
    class Slow(Zero):
        def start(self, n: int, rng: np.random.Generator) -> Act:
            act = super().start(n, rng)

            def slowly(t: float, y: Array) -> Array:
                for _ in range(20_000):
                    pass
                return act(t, y)

            return slowly

    slow, fast = (simulate(endless(), law, HANGING, 0.2, task=None).step_time for law in (Slow(), Zero()))
    assert slow.shape == (10,)
    assert np.median(slow) > 2 * np.median(fast) > 0


def test_versions_name_what_a_result_depends_on() -> None:
    found = versions()
    assert found["numpy"] == np.__version__
    assert {"python", "machine", "dpend", "numba", "scipy", "control"} <= set(found)
