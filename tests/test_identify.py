"""Parameters found in recorded motion are the true ones, as far as their intervals say."""

from __future__ import annotations

import csv
import math
import re
import warnings
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from rigs import whole
from scipy.stats import t as student

import dpend
from controllers import LQR, Zero
from dpend import Identified, Params, Rig, Run, identify
from dpend.params import Array

TURN = 2 * np.pi
TRUE = dpend.rig("gustafsson2016").replace(
    cart_friction=0.8,
    joint1_friction=0.02,
    joint2_friction=0.01,
    resolution=[1e-4, TURN / 4096, TURN / 4096, 0.0, 0.0, 0.0],
    sensor_noise=[1e-4, 5e-4, 5e-4, 0.0, 0.0, 0.0],
)
MASSES = ("cart_mass", "mass1", "mass2")
FIT = (*MASSES, "cart_friction", "joint1_friction", "joint2_friction")
START = TRUE.replace(cart_mass=1.3, mass1=0.4, mass2=0.6, cart_friction=0.2, joint1_friction=0.0, joint2_friction=0.05)
HANGING = np.array([0.0, np.pi + 0.3, np.pi - 0.2, 0.0, 0.0, 0.0])


class Shaken:
    """Two tones, and a weak spring that keeps the cart about the middle."""

    def start(self, n: int, rng: np.random.Generator) -> dpend.Act:
        phase = rng.uniform(0, TURN, (2, 1))

        def act(t: float, y: Array) -> Array:
            tones = 12 * np.sin(TURN * 0.7 * t + phase[0]) + 8 * np.sin(TURN * 1.9 * t + phase[1])
            return tones - 10 * y[:, 0]

        return act


@cache
def recorded(seed: int, seconds: float = 6.0, rig_changes: tuple[tuple[str, Any], ...] = ()) -> Run:
    rig = TRUE.replace(**dict(rig_changes))
    return dpend.simulate(rig, Shaken(), HANGING, seconds, task=None, seed=seed)


def covered(found: Identified, truth: Params = TRUE.params) -> list[bool]:
    return [low <= getattr(truth, name) <= high for name, (low, high) in found.intervals.items()]


def coverage(seeds: range, **changes: Any) -> float:
    return float(np.mean([covered(identify(recorded(s, 6.0, tuple(changes.items())), START, FIT)) for s in seeds]))


def test_the_true_parameters_are_found_from_encoders() -> None:
    found = identify(recorded(0), START, FIT)
    for name, value in found.values.items():
        assert abs(value - getattr(TRUE.params, name)) < 4 * found.errors[name], name
        assert getattr(found.params, name) == value
    assert max(found.errors[name] / found.values[name] for name in MASSES) < 2e-3
    assert found.params.length1 == START.params.length1
    assert found.noise["th1"] == pytest.approx(np.hypot(5e-4, TURN / 4096 / np.sqrt(12)), rel=0.1)
    assert found.noise["pos"] == pytest.approx(np.hypot(1e-4, 1e-4 / np.sqrt(12)), rel=0.1)


@pytest.mark.slow
def test_intervals_cover_the_truth_about_as_often_as_they_say() -> None:
    assert 0.85 <= coverage(range(100, 108)) <= 1.0  # 48 intervals


@pytest.mark.nightly
def test_intervals_cover_the_truth_about_as_often_as_they_say_over_many_recordings() -> None:
    assert 0.92 <= coverage(range(1000, 1060)) <= 0.985  # 360 intervals, not all independent


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [0.14, 0.28])
def test_intervals_are_students_with_what_the_fit_leaves_of_the_data(seconds: float) -> None:
    """A number each for the six of every segment's state and for every parameter; few are left, so each one counts."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # so short a residual has some autocorrelation by chance
        found = identify(recorded(3, seconds), TRUE, ("cart_mass", "mass2"), segment=0.12)
    segments, samples, outputs = found.residuals.shape
    assert (segments, samples) == (round(seconds / 0.14), 7)
    quantile = student.ppf(0.975, segments * samples * outputs - 6 * segments - 2)
    for name, (low, high) in found.intervals.items():
        half = quantile * found.errors[name] / found.values[name]
        assert_allclose([low, high], found.values[name] * np.exp([-half, half]), rtol=1e-9)


@pytest.mark.slow
def test_intervals_hold_where_all_noise_is_rounding() -> None:
    assert 0.90 <= coverage(range(2000, 2030), sensor_noise=0.0) <= 0.99


@pytest.mark.slow
def test_what_is_left_is_noise_unless_the_model_lacks_something() -> None:
    found = identify(recorded(0), START, FIT)
    assert all(abs(each) < 0.25 for each in found.autocorrelation.values())
    with pytest.warns(UserWarning, match=r"^What the model leaves of .* The intervals are too narrow\.$"):
        lacking = identify(recorded(0), START.replace(length2=1.2), FIT)
    assert max(lacking.autocorrelation.values()) > 0.5


def test_the_best_fit_of_exact_measurements_is_exact() -> None:
    run = recorded(1, 3.0, (("sensor_noise", 0.0), ("resolution", 0.0)))
    found = identify(run, START, FIT)
    for name, value in found.values.items():
        assert value == pytest.approx(getattr(TRUE.params, name), rel=1e-6)
    assert np.abs(found.residuals).max() < 1e-7


def test_lengths_and_coulomb_friction_are_found_too() -> None:
    run = recorded(2, 6.0, (("cart_coulomb", 1.5),))
    start = TRUE.replace(cart_coulomb=0.0, length1=1.1, length2=0.9, cart_friction=0.3)
    found = identify(run, start, ("cart_coulomb", "length1", "length2", "cart_friction"))
    truth = run.rig.params
    for name, value in found.values.items():
        assert abs(value - getattr(truth, name)) < 4 * found.errors[name], name


def test_several_runs_tell_more_than_one() -> None:
    one = identify(recorded(3), START, FIT)
    three = identify([recorded(3), recorded(0), recorded(100)], START, FIT)
    assert len(three.residuals) == 3 * len(one.residuals)
    for name in FIT:
        assert three.errors[name] < 0.8 * one.errors[name]


def test_a_batch_of_runs_and_measurements_that_come_late_are_taken() -> None:
    late = TRUE.replace(sensor_delay=3)
    runs = dpend.simulate_many(late, Shaken(), np.stack([HANGING, -HANGING]), 3.0, task=None, record=True)
    found = identify(runs, START.replace(sensor_delay=3).params, FIT)
    assert np.mean(covered(found)) >= 4 / 6
    assert found.noise["th1"] < 1e-3


def test_balancing_tells_the_masses_as_well() -> None:
    rig = TRUE.replace(force_noise=3.0)
    run = dpend.simulate(rig, LQR(rig), [0.3, 0.1, -0.1, 0, 0, 0], 6.0)
    found = identify(run, TRUE.replace(cart_mass=1.3, mass1=0.4, mass2=0.6), (*MASSES, "cart_friction"))
    for name, value in found.values.items():
        assert abs(value - getattr(TRUE.params, name)) < 4 * found.errors[name], name


def test_a_laboratorys_table_gives_a_rig_of_its_own(tmp_path: Path) -> None:
    run = recorded(6)
    with (tmp_path / "lab.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time", "x_mm", "enc1", "enc2", "force"])
        counts = np.rint((run.y[:, 1] - np.pi) / TURN * 4096), np.rint((run.y[:, 2] - run.y[:, 1]) / TURN * 4096)
        writer.writerows(zip(run.t, 1e3 * run.y[:, 0], *counts, np.append(run.u, 0.0), strict=True))
    columns = {"t": "time", "pos": "x_mm", "th1": "enc1", "th2": "enc2", "u": "force"}
    lab = dpend.rig("gustafsson2016").replace(cart_mass=1.3, mass1=0.4, mass2=0.6)
    record = Run.from_csv(
        tmp_path / "lab.csv", lab, columns, angle_unit=TURN / 4096, position_unit=1e-3, zero="down", relative=True
    )
    found = identify(record, lab, FIT)
    mine = lab.replace(params=found.params)
    assert isinstance(mine, Rig)
    assert_allclose(LQR(mine).K, LQR(TRUE).K, rtol=0.01)
    said = str(found).splitlines()
    assert [line.split()[0] for line in said] == ["parameter", *FIT, "left", "left", "left"]


def test_the_example_of_the_documentation_finds_its_rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (Path(__file__).parent.parent / "docs" / "identify.md").read_text()
    (example,) = re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(compile(example, "identify.md", "exec"), names)
    for name, value in names["found"].values.items():
        assert abs(value - getattr(names["true"].params, name)) < 4 * names["found"].errors[name], name
    assert names["rig"].params.mass1 == pytest.approx(0.55, rel=0.01)


def test_the_result_does_not_depend_on_where_the_search_begins() -> None:
    found = [identify(recorded(7), start, FIT).values for start in (START, START.replace(cart_mass=0.7))]
    for other in found[1:]:
        for name, value in other.items():
            assert value == pytest.approx(found[0][name], rel=1e-4), name


def test_an_inertia_that_was_left_out_is_found_from_the_rods() -> None:
    found = identify(recorded(8), TRUE, ("inertia1", "inertia2"))
    assert found.params.inertia1 == pytest.approx(0.5 / 12, rel=0.01)
    assert found.params.inertia2 == pytest.approx(0.5 / 12, rel=0.01)


# ------------------------------------------------------------------------------------------------------------- refusals


def refused(message: str, runs: Any, start: Any, fit: Any, **settings: Any) -> None:
    with pytest.raises(ValueError, match=whole(message)):
        identify(runs, start, fit, **settings)


@pytest.mark.slow
def test_what_the_motion_cannot_tell_apart_is_refused_with_names_and_remedy() -> None:
    start = TRUE.replace(com1=0.5, com2=0.5, inertia1=0.05, inertia2=0.05)
    refused(
        "The data cannot tell mass1, com1, inertia1 and cart_mass apart: they can change together and leave the motion "
        "as it is. Fix 1 of them, as by leaving com1 out of fit.",
        recorded(0),
        start,
        ("mass1", "com1", "inertia1", "cart_mass", "mass2", "gravity"),
    )


@pytest.mark.slow
def test_the_remedy_helps() -> None:
    start = TRUE.replace(com1=0.5, com2=0.5, inertia1=0.05, inertia2=0.05)
    fit = ["cart_mass", "mass1", "mass2", "com1", "com2", "inertia1", "inertia2", "length1"]
    with pytest.raises(ValueError, match=r"^The data cannot tell .* Fix 2 of them, as by leaving ") as refusal:
        identify(recorded(0), start, fit)
    names = str(refusal.value).partition("as by leaving ")[2].removesuffix(" out of fit.").split(" and ")
    assert len(names) == 2
    found = identify(recorded(0), start, [name for name in fit if name not in names])
    assert max(found.errors.values()) < 0.1


def test_without_a_force_the_masses_have_no_scale() -> None:
    run = dpend.simulate(TRUE, Zero(), HANGING, 4.0, task=None)
    refused(
        "The data cannot tell cart_mass, mass1 and mass2 apart: they can change together and leave the motion as it "
        "is. Fix 1 of them, as by leaving mass2 out of fit (no force was applied; a known force sets the scale of the "
        "masses).",
        run,
        TRUE.replace(cart_friction=0.0, joint1_friction=0.0, joint2_friction=0.0),
        MASSES,
    )


@pytest.mark.slow
def test_what_the_motion_does_not_depend_on_is_refused() -> None:
    refused(
        "Nothing in the data depends on length2; leave it out of fit.",
        recorded(0),
        TRUE.replace(com2=0.5, inertia2=0.05),
        ("mass1", "length2"),
    )


def test_what_is_drowned_in_noise_is_refused() -> None:
    still = dpend.simulate(TRUE, LQR(TRUE), np.zeros(6), 3.0)
    with pytest.raises(ValueError, match=r"^The data hold next to no information on .* leave .* out of fit\.$"):
        identify(still, TRUE.replace(cart_mass=1.05), ("cart_mass", "inertia1", "inertia2"))


def test_segments_in_which_errors_grow_beyond_measure_are_refused() -> None:
    run = dpend.simulate(TRUE.replace(force_noise=3.0), LQR(TRUE), [0.3, 0.1, -0.1, 0, 0, 0], 6.0)
    message = r"^Within a segment an error of the state grows \d+ times, .* make segment shorter than 2 s\.$"
    with pytest.raises(ValueError, match=message):
        identify(run, TRUE, MASSES, segment=2.0)


def test_measurements_in_another_unit_are_refused() -> None:
    run = recorded(0)
    with pytest.raises(ValueError, match=r"^(From the states measured the plant runs away|Within a segment an error)"):
        identify(replace(run, y=np.rad2deg(run.y)), START, FIT)


@pytest.mark.parametrize("odd", [None, 5, 1.5])
def test_names_that_are_none_are_refused(odd: Any) -> None:
    for argument, settings in (("fit", {"fit": odd}), ("outputs", {"fit": MASSES, "outputs": odd})):
        with pytest.raises(TypeError, match=whole(f"{argument} must be one name, or several; got {odd!r}.")):
            identify(recorded(0), START, **settings)


@pytest.mark.parametrize("odd", ["long", None, math.nan, 0.02])
def test_a_segment_must_last(odd: Any) -> None:
    message = (
        "A segment must hold more than the six numbers of its initial state: expected segment to be several samples of "
        f"0.02 s; got {odd!r} s."
    )
    refused(message, recorded(0), START, MASSES, segment=odd)


def test_wrong_use_is_refused() -> None:
    refused("There is no parameter 'cart_mas' to fit. Did you mean 'cart_mass'?", recorded(0), TRUE, ("cart_mas",))
    refused("fit names a parameter twice: mass1, mass1.", recorded(0), TRUE, ("mass1", "mass1"))
    refused(
        "There is no output 'theta'. Known: om1, om2, pos, th1, th2, vel.",
        recorded(0),
        TRUE,
        MASSES,
        outputs=("theta",),
    )
    refused("There are no runs; expected at least one.", [], TRUE, MASSES)
    refused("The longest run lasts 6 s, shorter than one segment of 8 s.", recorded(0), TRUE, MASSES, segment=8.0)
    refused(
        "A segment must hold more than the six numbers of its initial state: expected segment to be several samples of "
        "0.02 s; got 0.02 s.",
        recorded(0),
        TRUE,
        MASSES,
        segment=0.02,
    )
    refused("The search for com1 must start above zero; got 0.", recorded(0), TRUE.replace(com1=0.0), ("com1",))
    refused(
        "One plant is found at a time; got a start of 2 plants.", recorded(0), TRUE.replace(mass1=[0.4, 0.5]), MASSES
    )
    refused(
        "These runs hold no states; simulate them with record=True.",
        dpend.simulate_many(TRUE, Zero(), HANGING, 1.0, task=None),
        TRUE,
        MASSES,
    )
    slow = dpend.simulate(TRUE.replace(sample_time=0.05), Shaken(), HANGING, 1.0, task=None)
    refused("All runs must have one sample time; got 0.02 s, 0.05 s.", [recorded(0), slow], TRUE, MASSES)
    with pytest.raises(TypeError, match=whole("start must be dpend.Params or a dpend.Rig; got str.")):
        identify(recorded(0), "gustafsson2016", MASSES)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=whole("runs must be dpend.Run, dpend.Runs or several Run; got int.")):
        identify(3, TRUE, MASSES)  # type: ignore[arg-type]


ENCODER_2 = np.array([[1, 0, 0], [0, 1, 0], [0, 2, -1]])  # counts from link 1, the other way


@pytest.mark.slow
@pytest.mark.parametrize(
    ("what", "argument", "turn", "force"),
    [
        ("u", "force_unit", np.eye(3), -1),
        ("th2", "angle_unit", np.diag([1, 1, -1]), 1),
        pytest.param("th2 against th1", "angle_unit", ENCODER_2, 1, marks=pytest.mark.nightly),
        pytest.param("pos", "position_unit", np.diag([-1, 1, 1]), 1, marks=pytest.mark.nightly),
    ],
)
def test_a_wrong_sign_of_a_recording_is_named(what: str, argument: str, turn: Any, force: int) -> None:
    run = recorded(0, 3.0)
    state = np.kron(np.eye(2), turn)
    wrong = replace(run, y=run.y @ state.T, x=run.x @ state.T, u=force * run.u)
    hint = f"the sign of {what} turned round the model fits far better; look at the sign of {argument} in Run.from_csv."
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            identify(wrong, START, FIT)
        except ValueError as refusal:
            warnings.warn(str(refusal), stacklevel=1)
    assert any(hint in str(each.message) for each in said)


@pytest.mark.slow
def test_clamped_links_are_identified() -> None:
    heavy = TRUE.replace(cart_mass=1e6)
    swung = dpend.simulate(heavy, Zero(), HANGING, 6.0, task=None, seed=1)
    still = replace(swung, x=swung.x * [0, 1, 1, 0, 1, 1], y=swung.y * [0, 1, 1, 0, 1, 1])
    fit = ("mass2", "joint1_friction", "joint2_friction")
    found = identify(still, START.replace(mass1=TRUE.params.mass1), fit, clamped=True)
    assert set(found.noise) == {"th1", "th2"}
    assert found.params.cart_mass == START.params.cart_mass
    for name, value in found.values.items():
        assert abs(value - getattr(TRUE.params, name)) < 4 * found.errors[name], name
    with pytest.raises(ValueError, match=whole("The cart never moves; if it was held fast, give clamped=True.")):
        identify(still, START, fit)
