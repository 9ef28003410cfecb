"""Rigs are what they are said to be, and whatever cannot be one is refused with a message of its own."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import FrozenInstanceError, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from numpy.testing import assert_allclose
from rigs import plants, whole

import dpend
from controllers import LQR, Zero
from dpend import EQUILIBRIA, Balance, Params, Rig, simulate, simulate_many
from dpend.params import Array
from dpend.rig import as_rig

PARTS: dict[str, Any] = {"cart_mass": 1.0, "mass1": 0.5, "mass2": 0.4, "length1": 0.8, "length2": 0.6}


def made(**changes: Any) -> Params:
    """Return a plant of plain parts, some of them changed."""
    return Params(**(PARTS | changes))


RIG = Rig(params=made(), sample_time=0.02)
UPRIGHT = np.zeros(6)


# -------------------------------------------------------------------------------------------------------------- presets


def sphere_and_cylinder_capsule(length: float, radius: float, density: float) -> tuple[float, float]:
    """Integrate mass and moment of inertia of a capsule, disk by disk along its axis."""
    nodes, weights = np.polynomial.legendre.leggauss(40)

    def disks(low: float, high: float, squared_radius: Callable[[Array], Array]) -> tuple[float, float]:
        z = low + (nodes + 1) / 2 * (high - low)
        mass = density * np.pi * squared_radius(z) * weights * (high - low) / 2
        return mass.sum(), (mass * (squared_radius(z) / 4 + z**2)).sum()

    half = length / 2
    ends = [
        disks(half, half + radius, lambda z: radius**2 - (z - half) ** 2)
    ] * 2  # one hemisphere and its mirror image
    middle = disks(-half, half, lambda z: np.full_like(z, radius**2))
    masses, inertias = zip(middle, *ends, strict=True)
    return sum(masses), sum(inertias)


# name: cart and link masses; lengths; force limit, track limit, sample time; viscous frictions; gravity.  What else
# a preset has (centres off the middle, Coulomb friction, noise) stands in OTHER.
TABLE = {
    "gustafsson2016": ((1, 0.5, 0.5), (1, 1), (40, 2.4, 0.02), (0, 0, 0), 9.81),
    "gustafsson2016_as_coded": ((1, 0.5, 0.5), (1, 1), (40, 2.4, 0.02), (0, 0, 0), 9.81),
    "bogdanov2004": ((1.5, 0.5, 0.75), (0.5, 0.75), (np.inf, np.inf, 0.02), (0, 0, 0), 9.81),
    "pilco2011": ((0.5, 0.5, 0.5), (0.6, 0.6), (20, np.inf, 0.05), (0.1, 0, 0), 9.82),
    "dompc_dip": ((0.6, 0.2, 0.2), (0.5, 0.5), (4, np.inf, 0.04), (0, 0, 0), 9.80665),
    "gymnasium_idp": ((10.472, 4.199, 4.199), (0.6, 0.6), (500, 1, 0.05), (0.05, 0.05, 0.05), 9.81),
    "dm_control_two_poles": ((1, 0.1, 0.1), (1, 1), (10, 1.8, 0.01), (5e-4, 2e-6, 2e-6), 9.81),
}
OTHER: dict[str, dict[str, Any]] = {"pilco2011": {"sensor_noise": 0.01}}


@pytest.mark.parametrize("name", TABLE)
def test_presets_are_those_of_their_sources(name: str) -> None:
    rig = dpend.rig(name)
    p: Any = rig.params
    masses, lengths, limits, frictions, gravity = TABLE[name]
    assert_allclose((p.cart_mass, p.mass1, p.mass2), masses, atol=5e-4)
    assert (p.length1, p.length2) == lengths
    assert (rig.force_limit, rig.track_limit, rig.sample_time) == limits
    assert (p.cart_friction, p.joint1_friction, p.joint2_friction) == frictions
    assert p.gravity == gravity
    ideal = {"centers": (lengths[0] / 2, lengths[1] / 2), "cart_coulomb": 0, "ideal": True}
    for field, value in (ideal | ({"ideal": False} if name in OTHER else {}) | OTHER.get(name, {})).items():
        assert getattr(rig if hasattr(rig, field) else p, field) == value, field
    assert rig.n is None


def test_every_preset_is_in_the_table_and_says_what_it_is_and_where_it_comes_from() -> None:
    assert set(dpend.rigs()) == set(TABLE)
    for said in dpend.rigs().values():
        assert "Source: " in said


@pytest.mark.parametrize("name", ["gustafsson2016", "bogdanov2004", "pilco2011", "dompc_dip"])
def test_presets_made_of_rods_have_the_inertia_of_rods(name: str) -> None:
    p: Any = dpend.rig(name).params
    assert_allclose(p.inertias, (p.mass1 * p.length1**2 / 12, p.mass2 * p.length2**2 / 12), rtol=1e-15)


def test_presets_made_of_capsules_have_the_mass_and_inertia_of_capsules() -> None:
    mass, inertia = sphere_and_cylinder_capsule(0.6, 0.045, 1000.0)
    p: Any = dpend.rig("gymnasium_idp").params
    assert_allclose([p.mass1, p.mass2, *p.inertias], [mass, mass, inertia, inertia], rtol=1e-12)
    assert_allclose(p.cart_mass, sphere_and_cylinder_capsule(0.2, 0.1, 1000.0)[0], rtol=1e-12)
    mass, inertia = sphere_and_cylinder_capsule(1.0, 0.045, 1.0)
    light: Any = dpend.rig("dm_control_two_poles").params
    assert_allclose(light.inertias, [0.1 * inertia / mass] * 2, rtol=1e-12)


def test_the_report_as_coded_differs_from_what_was_intended_in_its_inertias_alone() -> None:
    coded = dpend.rig("gustafsson2016_as_coded")
    assert coded.params.inertias == (0.125, 0.125)
    assert coded.replace(inertia1=None, inertia2=None) == dpend.rig("gustafsson2016")


# ---------------------------------------------------------------------------------------------- defaults, changes, rows


@given(plants(rods=True))
def test_what_is_left_out_is_a_uniform_rods_and_follows_its_length(params: Params) -> None:
    p: Any = params
    assert p.centers == (p.length1 / 2, p.length2 / 2)
    assert_allclose(p.inertias, (p.mass1 * p.length1**2 / 12, p.mass2 * p.length2**2 / 12), rtol=1e-15)
    longer = replace(p, length1=2 * p.length1)
    assert longer.com1 is None
    assert longer.inertia1 is None
    assert_allclose((longer.centers[0], longer.inertias[0]), (2 * p.centers[0], 4 * p.inertias[0]), rtol=1e-15)
    assert (longer.centers[1], longer.inertias[1]) == (p.centers[1], p.inertias[1])


def test_what_is_given_stays_when_the_length_changes() -> None:
    params = made(com1=0.1, inertia1=0.2, com2=0.3, inertia2=0.0)
    longer = replace(params, length1=3.0, length2=4.0)
    assert longer.centers == (0.1, 0.3)
    assert longer.inertias == (0.2, 0.0)


def test_params_are_equal_where_all_fields_are() -> None:
    assert made() == made()
    assert made() != made(mass2=0.41)
    assert made() != made(com1=0.4)  # the same plant now, but not after a change of length
    assert made(mass1=[0.1, 0.2]) == made(mass1=np.array([0.1, 0.2]))
    assert made(mass1=[0.1, 0.2]) != made(mass1=[0.1, 0.3])
    assert made() != PARTS


def test_rigs_are_equal_where_all_fields_are() -> None:
    assert replace(RIG) == RIG
    for change in (
        {"force_limit": 1.0},
        {"mass1": 0.51},
        {"sensor_noise": [0, 0, 0, 0, 0, 1e-3]},
        {"sample_time": 0.01},
    ):
        assert RIG.replace(**change) != RIG
        assert RIG.replace(**change) == RIG.replace(**change)
    assert RIG != "rig"


def test_replace_changes_the_rig_and_its_plant_and_leaves_the_original_alone() -> None:
    changed = RIG.replace(force_limit=20.0, mass1=0.6)
    assert (changed.force_limit, changed.params.mass1) == (20.0, 0.6)
    assert changed.replace(force_limit=np.inf, mass1=0.5) == RIG
    assert RIG.params == made()
    other = made(gravity=1.6)
    assert RIG.replace(params=other).params == other
    assert RIG.replace(params=other, mass1=0.7).params == replace(other, mass1=0.7)


def test_rigs_and_params_cannot_be_changed_in_place() -> None:
    rig = RIG.replace(mass1=[0.1, 0.2])
    with pytest.raises(FrozenInstanceError):
        rig.sample_time = 1.0  # pyright: ignore[reportAttributeAccessIssue]
    masses: Any = rig.params.mass1
    with pytest.raises(ValueError, match="read-only"):
        masses[0] = 1.0


def test_params_keep_their_own_copy_of_an_array() -> None:
    masses = np.array([0.1, 0.2])
    params = made(mass1=masses)
    masses[0] = 9.0
    assert np.array_equal(params.mass1, [0.1, 0.2])


BATCH = RIG.replace(
    mass1=[0.1, 0.2, 0.3],
    com2=[0.2, 0.3, 0.4],
    force_limit=[1.0, 2.0, 3.0],
    actuator_delay=[0, 1, 2],
    sensor_noise=[[0.1], [0.2], [0.3]],
    resolution=np.arange(18.0).reshape(3, 6),
    track_limit=2.0,
)


def test_rows_cuts_the_fields_that_differ_and_keeps_the_rest() -> None:
    assert BATCH.n == 3
    one = BATCH.rows(1)
    assert one.n is None
    noise, resolution = np.full(6, 0.2), np.arange(6.0, 12.0)
    assert one == RIG.replace(
        mass1=0.2,
        com2=0.3,
        force_limit=2.0,
        actuator_delay=1,
        sensor_noise=noise,
        resolution=resolution,
        track_limit=2.0,
    )
    two = BATCH.rows(slice(1, 3))
    assert two.n == 2
    assert two.rows(0) == one
    assert two.rows(1) == BATCH.rows(2)
    assert RIG.rows(5) == RIG


def test_one_value_a_state_is_no_batch() -> None:
    assert RIG.replace(sensor_noise=np.ones(6), resolution=np.ones(6)).n is None
    assert RIG.replace(sensor_noise=np.ones((6, 6))).n == 6


@pytest.mark.parametrize("rig", [RIG, BATCH, *map(dpend.rig, dpend.rigs())])
def test_a_rig_survives_the_way_through_json(rig: Rig) -> None:
    text = json.dumps(rig.to_dict(), default=np.ndarray.tolist)
    assert Rig.from_dict(json.loads(text)) == rig


def test_substeps_are_raised_only_where_friction_is_stiff() -> None:
    assert RIG.replace(cart_coulomb=0.5).substeps == 2
    params = RIG.params
    mobility = dpend.linearize(params, EQUILIBRIA["down-down"])[1][
        3, 0
    ]  # 1 / the least mass that the cart may seem to have
    stiff = RIG.replace(cart_coulomb=50.0)
    assert stiff.substeps == int(np.ceil(mobility * 50.0 / 0.01 * 0.02 / 2))
    assert RIG.replace(cart_coulomb=[0.0, 50.0]).rows(0).substeps == stiff.substeps  # a row moves alone as in its batch
    assert stiff.replace(substeps=999).substeps == 999


STORED = {name: dpend.rig(name) for name in dpend.rigs()} | {
    "one a row": RIG.replace(
        mass1=[0.5, 0.6], track_limit=[2.0, np.inf], sensor_delay=[0, 2], resolution=np.ones((2, 6))
    ),
    "small": RIG.replace(com1=1e-7, sensor_noise=[0, 1e-3, 1e-3, 0, 0, 0], substeps=np.int64(3)),
}


@pytest.mark.parametrize("rig", STORED.values(), ids=STORED)
def test_a_rig_survives_the_way_through_toml(rig: Rig, tmp_path: Path) -> None:
    file = rig.to_toml(tmp_path / "rig.toml")
    assert Rig.from_toml(file) == dpend.rig(str(file)) == rig
    assert as_rig(str(file)) == rig


PLANT = "[params]\ncart_mass = 1\nmass1 = 0.5\nmass2 = 0.4\nlength1 = 0.8\nlength2 = 0.6\n"


def test_a_rig_written_by_hand_needs_only_what_has_no_default(tmp_path: Path) -> None:
    file = tmp_path / "rig.toml"
    file.write_text("sample_time = 0.02\n" + PLANT)
    assert dpend.rig(str(file)) == RIG


@pytest.mark.parametrize(
    ("text", "what"),
    [
        (PLANT, "Rig lacks sample_time"),
        ("sample_time = 0.02", "expected a table [params] with the plant's masses and lengths"),
        ("sample_time = 0.02\n" + PLANT.replace("mass1", "mas1"), "Params lacks mass1"),
        ("sample_time = 0.02\nmass1 = 1\n" + PLANT, "mass1 belongs under [params]"),
        ("sample_time = 0.02\n" + PLANT + "gravty = 1", "Params has no field 'gravty'. Did you mean 'gravity'?"),
        ("sample_time = 0.02\nforce_limt = 1\n" + PLANT, "Rig has no field 'force_limt'. Did you mean 'force_limit'?"),
        ("sample_time = -1\n" + PLANT, "sample_time must be finite and greater than 0 s; got -1"),
        ("sample_time", "Expected '=' after a key in a key/value pair (at end of document)"),
    ],
)
def test_a_file_that_describes_no_rig_is_refused_with_its_name(text: str, what: str, tmp_path: Path) -> None:
    file = tmp_path / "rig.toml"
    file.write_text(text)
    with pytest.raises(ValueError, match=whole(f"{file} describes no rig: {what}.")):
        Rig.from_toml(file)


def test_a_rig_is_ideal_until_actuator_or_sensors_are_not() -> None:
    assert RIG.replace(force_limit=1.0, track_limit=1.0, cart_friction=1.0).ideal
    for change in (
        {"actuator_lag": 0.1},
        {"actuator_delay": 1},
        {"force_noise": 0.1},
        {"sensor_delay": [0, 1]},
        {"sensor_noise": [0, 0, 0, 0, 0, 0.1]},
        {"resolution": 0.1},
    ):
        assert not RIG.replace(**change).ideal


# ------------------------------------------------------------------------------------------------------------ bad input


def refused(error: type[Exception], message: str, call: Callable[[], object]) -> None:
    with pytest.raises(error, match=whole(message)):
        call()


UNITS = {"cart_mass": "kg", "mass1": "kg", "mass2": "kg", "length1": "m", "length2": "m", "coulomb_speed": "m/s"}


@pytest.mark.parametrize("name", UNITS)
@pytest.mark.parametrize("value", [-1.0, 0.0, np.nan, np.inf])
def test_masses_and_lengths_must_be_finite_and_greater_than_zero(name: str, value: float) -> None:
    message = f"{name} must be finite and greater than 0 {UNITS[name]}; got {value:g}."
    refused(ValueError, message, lambda: made(**{name: value}))
    refused(ValueError, message, lambda: made(**{name: [1.0, value, 2.0]}))


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("com1", "m"),
        ("com2", "m"),
        ("inertia1", "kg m^2"),
        ("inertia2", "kg m^2"),
        ("cart_friction", "N s/m"),
        ("joint1_friction", "N m s"),
        ("joint2_friction", "N m s"),
        ("cart_coulomb", "N"),
        ("gravity", "m/s^2"),
    ],
)
def test_centres_inertias_frictions_and_gravity_may_be_zero_but_not_less(name: str, unit: str) -> None:
    assert getattr(made(**{name: 0}), name) == 0
    for value in (-0.5, np.nan):
        message = f"{name} must be finite and at least 0 {unit}; got {value:g}."
        refused(ValueError, message, lambda value=value: made(**{name: value}))


@pytest.mark.parametrize("value", ["heavy", "1.0", None, True, 1j, [1.0, [2.0]], object])
def test_a_mass_must_be_a_number(value: object) -> None:
    message = f"mass1 must be numbers: one in kg, or an array (N,) with one per row; got {value!r}."
    refused(TypeError, message, lambda: made(mass1=value))


def test_link_2_must_resist_being_turned_but_link_1_carries_link_2() -> None:
    refused(
        ValueError,
        "Link 2 has neither an inertia nor a lever arm, so nothing resists its rotation; "
        "give com2 or inertia2 a value greater than zero.",
        lambda: made(com2=0, inertia2=0),
    )
    assert made(com1=0, inertia1=0).coefficients().d4 > 0


@pytest.mark.parametrize(
    ("error", "message", "call"),
    [
        (
            TypeError,
            "mass1 must be a number in kg, or an array (N,); got an array of shape (2, 2).",
            lambda: made(mass1=np.ones((2, 2))),
        ),
        (
            ValueError,
            "All array fields of Params must have one length, one entry per row; got mass1 (2,), gravity (3,).",
            lambda: made(mass1=[1.0, 2.0], gravity=[1.0, 2.0, 3.0]),
        ),
        (
            ValueError,
            "All array fields of Rig and Params must have one length, one entry per row; "
            "got force_limit (2,), mass1 (3,).",
            lambda: RIG.replace(mass1=[1.0, 2.0, 3.0], force_limit=[1.0, 2.0]),
        ),
        (TypeError, "params must be dpend.Params; got dict.", lambda: RIG.replace(params=PARTS)),
        (
            ValueError,
            "sample_time must be finite and greater than 0 s; got 0.",
            lambda: RIG.replace(sample_time=0.0),
        ),
        (
            TypeError,
            "sample_time must be a single number: all rows of a batch share one clock.",
            lambda: RIG.replace(sample_time=[0.01, 0.02]),
        ),
        (
            ValueError,
            "actuator_lag must be finite and at least 0 s; got -0.1.",
            lambda: RIG.replace(actuator_lag=-0.1),
        ),
        (ValueError, "force_noise must be finite and at least 0 N; got inf.", lambda: RIG.replace(force_noise=np.inf)),
    ],
)
def test_a_rig_that_cannot_be_is_refused(error: type[Exception], message: str, call: Callable[[], object]) -> None:
    refused(error, message, call)


@pytest.mark.parametrize("value", [2.5, 0, -1, "2", None, True])
def test_the_sample_time_must_be_a_whole_multiple_of_the_substep(value: Any) -> None:
    refused(
        ValueError, f"substeps must be a whole number, at least 1; got {value!r}.", lambda: RIG.replace(substeps=value)
    )


def test_friction_too_stiff_for_any_reasonable_number_of_substeps_is_refused() -> None:
    mobility = dpend.linearize(RIG.params)[1][3, 0]
    message = (
        f"Friction stops this plant within {1e-10 / mobility:.2g} s, too fast for a sample of 0.02 s: it would take "
        f"{int(np.ceil(mobility * 1e10 * 0.01))} substeps, more than 1000. Raise coulomb_speed, lower the friction, or "
        "shorten sample_time."
    )
    refused(ValueError, message, lambda: RIG.replace(cart_coulomb=1e8))


@pytest.mark.parametrize("name", ["actuator_delay", "sensor_delay"])
@pytest.mark.parametrize("value", [1.5, -1, 0.02, np.inf, np.nan, "1", True, [0, 1.5], [[1]]])
def test_delays_must_be_whole_numbers_of_samples(name: str, value: object) -> None:
    message = (
        f"{name} must be a whole number of samples, 0 to 100000, or an array (N,) of such; got {value!r}. "
        "A delay of d seconds is round(d / sample_time) samples."
    )
    refused(ValueError, message, lambda: RIG.replace(**{name: value}))


def test_a_delay_that_is_a_whole_number_may_be_written_as_a_float() -> None:
    assert RIG.replace(actuator_delay=2.0, sensor_delay=[1.0, 0.0]) == RIG.replace(
        actuator_delay=2, sensor_delay=[1, 0]
    )


@pytest.mark.parametrize(("name", "unit"), [("force_limit", "N"), ("track_limit", "m")])
@pytest.mark.parametrize("value", [0.0, -3.0, np.nan, "far", None, [1.0, 0.0], [[1.0]]])
def test_limits_must_be_greater_than_zero(name: str, unit: str, value: object) -> None:
    message = f"{name} must be greater than zero, in {unit} (inf for none), or an array (N,) of such; got {value!r}."
    refused(ValueError, message, lambda: RIG.replace(**{name: value}))


@pytest.mark.parametrize("name", ["sensor_noise", "resolution"])
@pytest.mark.parametrize("value", [-0.1, np.nan, np.inf, "low", [0.1, 0.2], [[0.1, 0.2]], [0, 0, 0, 0, 0, -1]])
def test_noise_and_resolution_must_be_finite_and_not_negative(name: str, value: object) -> None:
    message = (
        f"{name} must be finite and at least 0: one number, one per state (6,), or (N, 1) or (N, 6) "
        f"with one row per run; got {value!r}."
    )
    refused(ValueError, message, lambda: RIG.replace(**{name: value}))


def test_an_unknown_preset_is_answered_with_the_nearest() -> None:
    refused(
        ValueError,
        "There is no preset rig 'gustavson2016'. Did you mean 'gustafsson2016'?",
        lambda: dpend.rig("gustavson2016"),
    )
    refused(ValueError, f"There is no preset rig 'zzz'. Known: {', '.join(sorted(TABLE))}.", lambda: dpend.rig("zzz"))


@pytest.mark.parametrize(("wrong", "right"), [("mas1", "mass1"), ("forcelimit", "force_limit")])
def test_an_unknown_keyword_of_replace_is_answered_with_the_nearest(wrong: str, right: str) -> None:
    refused(
        TypeError,
        f"Neither Rig nor Params has a field {wrong!r}. Did you mean {right!r}?",
        lambda: RIG.replace(**{wrong: 1.0}),
    )


@pytest.mark.parametrize("lam", [0.0, -0.1, np.nan, 2.0])
def test_the_spread_of_the_starts_must_be_positive_and_above_the_horizontal(lam: float) -> None:
    refused(
        ValueError,
        f"lambda is the greatest starting angle in rad: expected 0 < lambda <= pi/2; got {lam!r}.",
        lambda: Balance(lam=lam),
    )


class Column:
    """A law that forgets to drop the last axis."""

    def start(self, n: int, rng: np.random.Generator) -> Callable[[float, Array], Array]:
        return lambda t, y: y @ np.ones((6, 1))


@pytest.mark.parametrize(
    ("error", "message", "call"),
    [
        (
            ValueError,
            "x0 must be one state of shape (6,); got shape (2, 6).",
            lambda: simulate(RIG, Zero(), np.zeros((2, 6)), 1.0),
        ),
        (
            ValueError,
            "A state has six numbers (pos, th1, th2, vel, om1, om2): expected an array of shape (N, 6) or (6,); "
            "got shape (4, 5).",
            lambda: simulate_many(RIG, Zero(), np.zeros((4, 5)), 1.0),
        ),
        (
            ValueError,
            "States must be finite; got nan for om1 in row 1.",
            lambda: simulate_many(RIG, Zero(), [[0] * 6, [0, 0, 0, 0, np.nan, 0]], 1.0),
        ),
        (
            ValueError,
            "States must be finite; got inf for th2 in row 0.",
            lambda: simulate(RIG, Zero(), [0, 0, np.inf, 0, 0, 0], 1.0),
        ),
        (
            ValueError,
            "x0 has no rows; expected at least one initial state.",
            lambda: simulate_many(RIG, Zero(), np.zeros((0, 6)), 1.0),
        ),
        (
            ValueError,
            "The rig describes 3 rows, x0 has 2; expected the same number.",
            lambda: simulate_many(BATCH, Zero(), np.zeros((2, 6)), 1.0),
        ),
        (
            ValueError,
            "duration must be a whole number of samples of 0.02 s, at least one; got 0.05 s. The nearest is 0.04 s.",
            lambda: simulate(RIG, Zero(), UPRIGHT, 0.05),
        ),
        (
            ValueError,
            "duration must be a whole number of samples of 0.02 s, at least one; got 0.0 s. The nearest is 0.02 s.",
            lambda: simulate(RIG, Zero(), UPRIGHT, 0.0),
        ),
        (
            ValueError,
            "duration must be a whole number of samples of 0.02 s, at least one; got nan s. The nearest is 0.02 s.",
            lambda: simulate(RIG, Zero(), UPRIGHT, np.nan),
        ),
        (
            ValueError,
            "Without a task a run has no natural end: pass a duration in s.",
            lambda: simulate(RIG, Zero(), UPRIGHT, task=None),
        ),
        (
            ValueError,
            "workers must be a whole number, at least 1; got 0.",
            lambda: simulate_many(RIG, Zero(), UPRIGHT, 1.0, workers=0),
        ),
        (
            TypeError,
            "Expected a controller object; got the class LQR. Call it first.",
            lambda: simulate(RIG, LQR, UPRIGHT, 1.0),  # pyright: ignore[reportArgumentType]
        ),
        (
            TypeError,
            "A controller has a method start(n, rng) that returns act(t, y); int has none.",
            lambda: simulate(RIG, 3, UPRIGHT, 1.0),  # pyright: ignore[reportArgumentType]
        ),
        (
            ValueError,
            "Column failed at t = 0 s in rows 0 to 1: Expected one force per row, shape (2,); got shape (2, 1). A law "
            "written as y @ K.T returns a column: take [:, 0]. The runs up to there are kept in the error's `runs`.",
            lambda: simulate_many(RIG, Column(), np.zeros((2, 6)), 1.0),
        ),
        (
            ValueError,
            "The rig describes 3 rows; expected 2, or single values shared by all rows.",
            lambda: dpend.Stepper(BATCH, 2),
        ),
        (
            ValueError,
            "A state has six numbers (pos, th1, th2, vel, om1, om2): expected an array of shape (2, 6) or (6,); "
            "got shape (3, 6).",
            lambda: dpend.Stepper(RIG, 2).reset(np.zeros((3, 6))),
        ),
    ],
)
def test_wrong_use_is_refused_before_anything_runs(
    error: type[Exception], message: str, call: Callable[[], object]
) -> None:
    refused(error, message, call)


@pytest.mark.parametrize(
    ("kind", "word", "hint"),
    [
        (Params, "cart_mas", "Did you mean 'cart_mass'?"),
        (Rig, "smple_time", "Did you mean 'sample_time'?"),
        (dpend.Balance, "lamb", "Did you mean 'lam'?"),
        (
            dpend.SwingUp,
            "begin",
            "Known: angle_spread, failure_cost, hold, start, state_weights, steps, target, upright_angle.",
        ),
    ],
)
def test_an_unknown_keyword_is_refused_with_the_nearest_known(kind: type, word: str, hint: str) -> None:
    refused(TypeError, f"{kind.__name__} has no field {word!r}. {hint}", lambda: kind(**{word: 1.0}))
