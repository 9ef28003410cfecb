"""Records of runs: saved and loaded, taken out of a batch, and measured."""

from __future__ import annotations

import io
import json
import pickle
import re
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rigs import whole

import dpend
from controllers import LQR, Constant, Zero
from dpend import Run, Runs, Status
from dpend.metrics import UNITS, force_metrics
from dpend.params import Array

RIG = dpend.rig("gustafsson2016")
STARTS = dpend.Balance(lam=0.5).starts(np.random.default_rng(0), 12, RIG)


class Feedback:
    """A state feedback whose sum is the same, to the bit, alone and in a batch."""

    name = "a feedback of the tests"

    def __init__(self, batched: bool = True) -> None:
        self.batched = batched
        self.gain = LQR(RIG).K[0]

    def start(self, n: int, rng: np.random.Generator) -> dpend.Act:
        return lambda t, y: -(self.gain * y).sum(axis=1)


def broken_after(t: float) -> tuple[float, float, float]:
    """Push with no number after a while."""
    return (np.nan if t > 0.05 else 1.0), 0.0, 0.0


def one_rig_a_row(n: int) -> dpend.Rig:
    rng = np.random.default_rng(1)
    return RIG.replace(
        mass1=rng.uniform(0.3, 0.7, n),
        length2=rng.uniform(0.8, 1.2, n),
        force_limit=rng.uniform(10.0, 60.0, n),
        track_limit=np.where(np.arange(n) % 3, 2.4, np.inf),
        actuator_delay=np.arange(n) % 3,
        force_noise=rng.uniform(0.0, 2.0, n),
        sensor_noise=rng.uniform(0.0, 1e-3, (n, 6)),
        resolution=np.full((n, 1), 1e-4),
    )


def assert_same(one: Run, other: Run, *, apart_from: tuple[str, ...] = ()) -> None:
    assert one.log.keys() == other.log.keys()
    pairs = {field.name: (getattr(one, field.name), getattr(other, field.name)) for field in fields(Run)}
    pairs |= {f"log {name}": (one.log[name], other.log[name]) for name in one.log}
    for name in set(pairs) - {"log", *apart_from}:
        mine, theirs = pairs[name]
        if isinstance(mine, np.ndarray):
            assert mine.dtype == theirs.dtype, name
            assert np.array_equal(mine, theirs, equal_nan=True), name
        else:
            assert mine == theirs or (mine != mine and theirs != theirs), name


RUNS: dict[str, Callable[[], Run]] = {
    "ideal": lambda: dpend.simulate(RIG, Feedback(), STARTS[0], 1.0),
    "noisy": lambda: dpend.simulate(
        RIG.replace(sensor_noise=[1e-3, 1e-3, 1e-3, 0, 0, 0], sensor_delay=2, actuator_lag=0.01), Zero(), STARTS[0], 1.0
    ),
    "ended early": lambda: dpend.simulate(RIG, Constant(40.0), STARTS[0], 2.0),
    "ended at once": lambda: dpend.simulate_many(RIG, Zero(), [3.0, 0, 0, 0, 0, 0], 1.0, record=True)[0],
    "never ending": lambda: dpend.simulate(RIG.replace(track_limit=np.inf), Zero(), STARTS[0], 1.0, task=None),
    "swung up": lambda: dpend.simulate(RIG, Zero(), np.zeros(6), 2.0, task=dpend.SwingUp(), seed=7),
    "one of a batch": lambda: dpend.simulate_many(one_rig_a_row(12), Feedback(), STARTS, 1.0, record=True)[5],
    "seeded by numpy": lambda: dpend.simulate(RIG, Zero(), STARTS[0], 0.1, seed=np.int64(3)),  # pyright: ignore
    "not finite": lambda: dpend.simulate(RIG, Zero(), STARTS[0], 1.0, push=broken_after),
}


@pytest.mark.parametrize("make", RUNS.values(), ids=RUNS)
def test_a_saved_run_comes_back_bit_for_bit(make: Callable[[], Run], tmp_path: Path) -> None:
    run = make()
    assert_same(run, Run.load(run.save(tmp_path / "run.npz")))


def test_a_file_name_without_a_suffix_is_given_one(tmp_path: Path) -> None:
    run = RUNS["ideal"]()
    assert run.save(tmp_path / "one") == tmp_path / "one.npz"
    assert run.save(str(tmp_path / "two.run")) == tmp_path / "two.run"
    assert {path.name for path in tmp_path.iterdir()} == {"one.npz", "two.run"}


def test_a_slice_of_runs_is_runs(tmp_path: Path) -> None:
    runs = dpend.simulate_many(one_rig_a_row(12), Feedback(), STARTS, 0.2, record=True)
    some = runs[3:-4]
    assert len(some) == 5
    for one, other in zip(some, list(runs)[3:-4], strict=True):
        assert_same(one, other)
    assert_same(Runs.load(some.save(tmp_path / "some.npz"))[1], runs[4])


@pytest.mark.parametrize(
    ("row", "error", "message"),
    [
        (1.5, TypeError, "A run is taken out by a whole number, several by a slice: runs[0], runs[1:3]; got 1.5."),
        (True, TypeError, "A run is taken out by a whole number, several by a slice: runs[0], runs[1:3]; got True."),
        (
            slice(0, 5, 2),
            ValueError,
            "A slice of runs must hold at least one, and neighbours only; got rows [0, 2, 4] of 12. Take others one by "
            "one: [runs[i] for i in ...].",
        ),
    ],
)
def test_what_is_no_row_is_refused(row: Any, error: type[Exception], message: str) -> None:
    runs = dpend.simulate_many(RIG, Feedback(), STARTS, 0.1, record=True)
    with pytest.raises(error, match=whole(message)):
        runs[row]


class Trap:
    """What a pickle runs when it is opened."""

    def __init__(self, sprung: Path) -> None:
        self.sprung = sprung

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.sprung,)


def npz(**arrays: Any) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def npy(array: Any) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def parts_of(saved: Path) -> dict[str, Any]:
    """Return what a file holds without its checksum, as files of the first version had none."""
    with np.load(saved) as file:
        return {name: file[name] for name in file.files if name != "checksum"}


def with_header(parts: dict[str, Any], **changes: Any) -> bytes:
    return npz(**parts | {"header": np.array(json.dumps(json.loads(str(parts["header"])) | changes))})


def refusal(path: Path, kind: str) -> str:
    before = re.escape(f"{path} cannot be read as {kind!r}: ")
    return f"^{before}[^.].+{re.escape('. Save it again, or copy it afresh.')}$"


def trapped(sprung: Path) -> Any:
    return np.array([Trap(sprung)], dtype=object)


# name: what the file holds, given the parts and the bytes of a good one and the file that a trap would leave
FOREIGN: dict[str, Callable[[dict[str, Any], bytes, Path], bytes]] = {
    "nothing": lambda parts, good, sprung: b"",
    "text": lambda parts, good, sprung: b"t,x,u\n0,0,0\n",
    "one array": lambda parts, good, sprung: npy(parts["x"]),
    "other arrays": lambda parts, good, sprung: npz(a=parts["x"], b=parts["u"]),
    "a pickle": lambda parts, good, sprung: pickle.dumps(Trap(sprung)),
    "a pickled array": lambda parts, good, sprung: npy(trapped(sprung)),
    "a pickle for the states": lambda parts, good, sprung: npz(**parts | {"x": trapped(sprung)}),
    "a pickle for the words": lambda parts, good, sprung: npz(**parts | {"header": trapped(sprung)}),
    "another format": lambda parts, good, sprung: with_header(parts, format="dpend run 99"),
    "an unknown status": lambda parts, good, sprung: with_header(parts, status="EXPLODED"),
    "an unknown field": lambda parts, good, sprung: with_header(parts, color="red"),
    "an impossible rig": lambda parts, good, sprung: with_header(parts, rig=RIG.to_dict() | {"sample_time": -1.0}),
    "words that are no record": lambda parts, good, sprung: npz(**parts | {"header": np.array("[1, 2]")}),
    "states of another shape": lambda parts, good, sprung: npz(**parts | {"x": parts["x"][:, :4]}),
    "fewer measurements": lambda parts, good, sprung: npz(**parts | {"y": parts["y"][:-1]}),
    "numbers of another kind": lambda parts, good, sprung: npz(**parts | {"u": parts["u"].astype(np.complex128)}),
    "a third of it": lambda parts, good, sprung: good[: len(good) // 3],
    "all but the last byte": lambda parts, good, sprung: good[:-1],
    "a scratched middle": lambda parts, good, sprung: good[:300] + bytes(200) + good[500:],
}


@pytest.mark.parametrize("content", FOREIGN.values(), ids=FOREIGN)
def test_what_is_no_saved_run_is_refused_and_runs_nothing(
    content: Callable[[dict[str, Any], bytes, Path], bytes], tmp_path: Path
) -> None:
    good = RUNS["ideal"]().save(tmp_path / "good.npz")
    path, sprung = tmp_path / "foreign.npz", tmp_path / "sprung"
    path.write_bytes(content(parts_of(good), good.read_bytes(), sprung))
    with pytest.raises(ValueError, match=refusal(path, "dpend run 1")):
        Run.load(path)
    assert not sprung.exists()


def test_the_trap_of_these_tests_springs_where_pickles_are_trusted(tmp_path: Path) -> None:
    pickle.loads(pickle.dumps(Trap(tmp_path / "sprung")))
    assert (tmp_path / "sprung").exists()


def test_a_file_that_is_not_there_is_said_to_be_missing(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=whole(f"[Errno 2] No such file or directory: '{tmp_path / 'no.npz'}'")):
        Run.load(tmp_path / "no.npz")


def test_a_row_of_a_batch_is_the_run_of_that_row_alone_bit_for_bit() -> None:
    runs = dpend.simulate_many(RIG, Feedback(), STARTS, 3.0, record=True)
    assert len({*runs.steps}) > 3, "some of these runs should end early"
    for row, x0 in enumerate(STARTS):
        assert_same(runs[row], dpend.simulate(RIG, Feedback(), x0, 3.0), apart_from=("step_time", "row"))


def test_a_row_of_rigs_of_their_own_is_the_run_of_that_rig_alone_bit_for_bit() -> None:
    rigs = one_rig_a_row(12)
    runs = dpend.simulate_many(rigs, Feedback(), STARTS, 1.0, record=True, seed=3)
    for row in range(12):
        alone = dpend.simulate_many(
            rigs.rows(row), Feedback(), STARTS[row], 1.0, record=True, seed=3, first_row=row
        )  # noise is drawn by the row's number
        assert_same(runs[row], alone[0], apart_from=("step_time",))


def test_a_row_under_lqr_is_the_run_of_that_row_alone_to_rounding_for_a_second() -> None:
    runs = dpend.simulate_many(RIG, LQR(RIG), 0.2 * STARTS, 1.0, record=True)
    for row, x0 in enumerate(0.2 * STARTS):
        np.testing.assert_allclose(runs[row].x, dpend.simulate(RIG, LQR(RIG), x0, 1.0).x, rtol=0, atol=1e-9)


def test_rows_simulated_apart_and_joined_are_the_batch() -> None:
    together = dpend.simulate_many(one_rig_a_row(12), Feedback(), STARTS, 1.0, record=True)
    joined = dpend.simulate_many(one_rig_a_row(12), Feedback(batched=False), STARTS, 1.0, record=True)
    for field in fields(Runs):
        one, other = getattr(together, field.name), getattr(joined, field.name)
        if isinstance(one, np.ndarray) and field.name != "step_time":
            np.testing.assert_array_equal(one, other, err_msg=field.name)
    assert joined.rig == together.rig
    assert joined.status == together.status


def test_a_batch_is_nan_after_a_run_has_ended_and_never_before() -> None:
    runs = dpend.simulate_many(RIG, Feedback(), STARTS, 3.0, record=True)
    samples = np.arange(len(runs.t))
    lived = samples <= runs.steps[:, None]
    np.testing.assert_array_equal(np.isfinite(runs.u), lived[:, 1:])
    for states in (runs.x, runs.y):
        np.testing.assert_array_equal(np.isfinite(states).all(axis=2), lived)
        np.testing.assert_array_equal(np.isnan(states).all(axis=2), ~lived)
    last = runs.x[np.arange(len(runs)), runs.steps]
    np.testing.assert_array_equal(last, runs.final)
    assert [status is Status.FULL_LENGTH for status in runs.status] == [*(runs.steps == 150)]


def test_rows_are_counted_from_either_end_and_no_further() -> None:
    runs = dpend.simulate_many(RIG, Zero(), STARTS, 0.1, record=True)
    assert_same(runs[-1], runs[11])
    assert len(list(runs)) == len(runs) == 12
    with pytest.raises(IndexError):
        runs[12]


def test_runs_without_states_say_how_to_keep_them() -> None:
    runs = dpend.simulate_many(RIG, Zero(), STARTS, 0.1)
    with pytest.raises(ValueError, match=whole("These runs hold no states; simulate them with record=True.")):
        runs[0]


def pushed(t: float) -> Array:
    return np.array([30.0, 0.0, 1.0])


BATCHES: dict[str, Callable[[], Runs]] = {
    "some end early": lambda: dpend.simulate_many(RIG, Feedback(), STARTS, 3.0, record=True),
    "one rig a row": lambda: dpend.simulate_many(one_rig_a_row(12), Feedback(), STARTS, 1.0, record=True),
    "pushed": lambda: dpend.simulate_many(RIG, Zero(), STARTS, 1.0, push=pushed, record=True),
    "force noise": lambda: dpend.simulate_many(RIG.replace(force_noise=20.0), Zero(), STARTS, 3.0, record=True),
    "ended at once": lambda: dpend.simulate_many(RIG, Zero(), 4 * STARTS, 1.0, record=True),
    "swing up": lambda: dpend.simulate_many(RIG, Feedback(), 0.1 * STARTS, 5.0, task=dpend.SwingUp(), record=True),
    "not finite": lambda: dpend.simulate_many(RIG, Zero(), STARTS, 1.0, record=True, push=broken_after),
}


@pytest.mark.parametrize("make", BATCHES.values(), ids=BATCHES)
def test_the_metrics_of_a_row_are_the_row_of_the_metrics(make: Callable[[], Runs]) -> None:
    runs = make()
    of_all = runs.metrics() | runs.smoothness()
    for row in range(len(runs)):
        of_one = runs[row].metrics() | runs[row].smoothness()
        assert of_one.keys() == of_all.keys()
        for name, value in of_one.items():
            # sums over longer rows round otherwise
            np.testing.assert_allclose(value, of_all[name][row], rtol=1e-13, atol=1e-15, err_msg=name)


def test_every_metric_but_success_has_a_unit() -> None:
    run = RUNS["ideal"]()
    assert {*run.metrics(), *run.smoothness()} == {*UNITS, "success"}


def measured(u: Array, *, sample_time: float = 0.5, limit: float = np.inf) -> dict[str, float]:
    return {name: float(value[0]) for name, value in force_metrics(u[None], sample_time, limit).items()}


def test_a_square_wave_has_the_metrics_that_one_can_count() -> None:
    wave = np.tile([8.0, 8.0, 8.0, -8.0, -8.0, -8.0], 5)  # 30 samples of 0.5 s, 9 jumps of 16 N
    assert measured(wave, limit=8.0) == {
        "seconds": 15.0,
        "peak_force": 8.0,
        "effort": 8.0**2 * 15.0,
        "variation": pytest.approx(9 * 16.0 / 8.0 / 15.0, rel=1e-15),
        "switches": pytest.approx(9 / 15.0, rel=1e-15),
        "saturated": pytest.approx(1.0, rel=1e-15),
    }


def test_a_triangle_wave_has_the_metrics_that_one_can_count() -> None:
    rise = np.arange(-4.0, 4.0)
    wave = np.concatenate([rise, -rise, rise, -rise])  # 32 samples of 0.5 s, steps of 1 N, four extremes
    assert measured(wave, limit=4.0) == {
        "seconds": 16.0,
        "peak_force": 4.0,
        "effort": 0.5 * 4 * (16.0 + 2 * (9.0 + 4.0 + 1.0)),
        "variation": pytest.approx(31 / 4.0 / 16.0, rel=1e-15),
        "switches": pytest.approx(4 / 16.0, rel=1e-15),  # one on each slope, through zero
        "saturated": pytest.approx(4 / 32, rel=1e-15),
    }


@pytest.mark.parametrize(
    ("signal", "changes"),
    [
        ([1, 0, 0, -1, 0, 1, 0], 2),
        ([0, 0, 1, 0, 1], 0),
        ([0, -1, 0], 0),
        ([0, 0], 0),
        ([1, -1, 1, -1], 3),
        ([-1, 0, 1], 1),
        ([5], 0),
    ],
)
def test_zeros_are_skipped_when_changes_of_sign_are_counted(signal: list[int], changes: int) -> None:
    u = np.array(signal, dtype=np.float64)
    assert measured(u)["switches"] == pytest.approx(changes / (0.5 * len(u)), rel=1e-15)


def test_a_constant_force_varies_not_at_all_however_soon_it_ends() -> None:
    u = np.full((1, 10), 3.0)
    u[0, 4:] = np.nan
    metrics = force_metrics(u, 0.5, 3.0)
    assert (metrics["seconds"][0], metrics["effort"][0]) == (2.0, 18.0)
    assert (metrics["variation"][0], metrics["switches"][0], metrics["saturated"][0]) == (0.0, 0.0, 1.0)


def test_what_comes_after_the_end_does_not_count() -> None:
    rng = np.random.default_rng(2)
    u = np.clip(rng.normal(0.0, 3.0, (40, 50)), -4.0, 4.0).round(1)
    steps = rng.integers(0, 51, 40)
    limits = rng.choice([4.0, 5.0, np.inf], 40)
    cut = np.where(np.arange(50) < steps[:, None], u, np.nan)
    together = force_metrics(cut, 0.02, limits)
    for row, step in enumerate(steps):
        alone = force_metrics(u[row : row + 1, :step], 0.02, float(limits[row]))
        for name, value in alone.items():
            np.testing.assert_allclose(together[name][row], value[0], rtol=1e-13, err_msg=name)


def test_smoothness_does_not_depend_on_the_size_of_the_actuator() -> None:
    u = np.random.default_rng(3).uniform(-1.0, 1.0, (20, 100))
    small, large = force_metrics(4.0 * u, 0.02, 4.0), force_metrics(64.0 * u, 0.02, 64.0)
    for name in ("variation", "switches", "saturated"):
        np.testing.assert_array_equal(small[name], large[name], err_msg=name)


def test_without_a_limit_variation_is_counted_in_newtons_and_nothing_saturates() -> None:
    metrics = measured(np.array([0.0, 100.0, -100.0, 0.0]))
    assert (metrics["variation"], metrics["saturated"]) == (200.0, 0.0)


def test_no_force_at_all_measures_zero() -> None:
    assert set(measured(np.empty(0), limit=4.0).values()) == {0.0}


def test_one_signal_alone_is_refused_as_a_batch() -> None:
    with pytest.raises(ValueError, match=whole("Expected force signals of shape (N, T); got shape (5,).")):
        force_metrics(np.zeros(5), 0.02, 4.0)


@pytest.mark.parametrize("record", [True, False])
def test_saved_runs_come_back_exactly(tmp_path, record):
    rig = dpend.rig("gustafsson2016").replace(mass1=[0.5, 0.6, 0.7], sensor_noise=0.001)
    x0 = dpend.Balance(lam=0.4).starts(np.random.default_rng(3), 3, rig)
    runs = dpend.simulate_many(rig, LQR(dpend.rig("gustafsson2016")), x0, 2.0, record=record, seed=7)
    back = dpend.Runs.load(runs.save(tmp_path / "runs"))
    assert back.rig == runs.rig
    for name in ("t", "u", "steps", "codes", "success", "final", "travel", "time_up", "step_time"):
        np.testing.assert_array_equal(getattr(back, name), getattr(runs, name))
    assert hasattr(back, "x") == record
    if record:
        np.testing.assert_array_equal(back.x, runs.x)
        np.testing.assert_array_equal(back[1].y, runs[1].y)
    assert (back.controller, back.task, back.seed) == (runs.controller, runs.task, 7)


def test_one_run_is_not_taken_for_many(tmp_path):
    rig = dpend.rig("gustafsson2016")
    file = dpend.simulate(rig, LQR(rig), np.zeros(6), 0.1).save(tmp_path / "one")
    message = f"{file} cannot be read as 'dpend runs 1': it is 'dpend run 1'. Save it again, or copy it afresh."
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        dpend.Runs.load(file)


class Telling:
    """A law that counts its calls and remembers what it saw."""

    def start(self, n: int, rng: np.random.Generator) -> dpend.Act:
        def act(t: float, y: Array) -> Array:
            log["call"].append(len(log["call"]))
            log["pos"].append(y[:, 0].copy())
            return np.full(n, 5.0)

        log: dict[str, list[Any]] = {"call": [], "pos": []}
        act.log = log  # type: ignore[attr-defined]
        return act


def test_what_a_law_tells_of_its_steps_is_kept_with_the_run(tmp_path: Path) -> None:
    starts = np.zeros((3, 6))
    starts[:, 1] = [0.1, 0.6, 1.4]  # falling sooner and sooner
    runs = dpend.simulate_many(RIG, Telling(), starts, 1.0, record=True)
    assert len(set(runs.steps)) == 3
    for row, run in enumerate(runs):
        steps = runs.steps[row]
        assert run.log["call"].tolist() == list(range(steps))
        assert np.array_equal(run.log["pos"], run.x[:-1, 0])
        assert np.isnan(runs.log["pos"][row, steps:]).all()
        kept = Run.load(run.save(tmp_path / "run.npz"))
        assert {name: told.tolist() for name, told in kept.log.items()} == {
            name: told.tolist() for name, told in run.log.items()
        }
    many = Runs.load(runs.save(tmp_path / "runs.npz"))
    assert all(np.array_equal(many.log[name], told, equal_nan=True) for name, told in runs.log.items())


def test_laws_that_tell_nothing_leave_an_empty_log() -> None:
    assert not dpend.simulate(RIG, Zero(), STARTS[0], 0.2).log


def test_a_log_that_is_no_mapping_is_refused_before_the_first_step() -> None:
    class Wrong:
        def start(self, n: int, rng: np.random.Generator) -> dpend.Act:
            def act(t: float, y: Array) -> Array:
                raise AssertionError("never called")

            act.log = "words"  # type: ignore[attr-defined]
            return act

    with pytest.raises(TypeError, match=whole("A law's log is a mapping from names to lists; got 'words'.")):
        dpend.simulate(RIG, Wrong(), STARTS[0], 0.2)
