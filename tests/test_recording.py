"""A laboratory's tables become runs, or are refused with the reason."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rigs import whole

import dpend
from controllers import LQR, Zero
from dpend import Run
from dpend.params import Array
from dpend.recording import applied, fitted_rates

RIG = dpend.rig("gustafsson2016")
RUN = dpend.simulate(RIG, LQR(RIG), [0, 0.2, -0.1, 0, 0, 0], 2.0)
NAMES = ("pos", "th1", "th2", "vel", "om1", "om2")


def table(run: Run = RUN, names: tuple[str, ...] = NAMES) -> dict[str, Array]:
    """Return the columns of a run; the force after its last sample is unknown."""
    states = {name: run.y[:, NAMES.index(name)] for name in names}
    return {"t": run.t} | states | {"u": np.append(run.u, 0.0)}


def written(path: Path, columns: Mapping[str, Any], delimiter: str = ",") -> Path:
    with path.open("w", newline="") as file:
        writer = csv.writer(file, delimiter=delimiter)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
    return path


def test_a_written_run_is_read_back(tmp_path: Path) -> None:
    run = Run.from_csv(written(tmp_path / "run.csv", table()), RIG)
    assert_allclose(run.t, RUN.t, rtol=1e-15)
    for states in (run.x, run.y):
        assert_array_equal(states, RUN.y)
    assert_array_equal(run.u, RUN.u)
    assert run.rig == RIG
    assert run.metrics()["variation"] == RUN.metrics()["variation"]
    assert_array_equal(Run.load(run.save(tmp_path / "run.npz")).x, run.x)
    assert Run.from_csv(tmp_path / "run.csv", "gustafsson2016").rig == RIG


@pytest.mark.parametrize("delimiter", [",", ";", "\t", "|", " "])
def test_the_separator_of_cells_is_found_out(tmp_path: Path, delimiter: str) -> None:
    assert_array_equal(Run.from_csv(written(tmp_path / "run.csv", table(), delimiter), RIG).x, RUN.y)


def test_a_file_may_have_its_own_headings_blank_lines_and_more_columns(tmp_path: Path) -> None:
    headings = {"t": "time [s]", "th1": "alpha", "u": "F"}
    columns = {"comment": ["a"] * len(RUN.t)} | {headings.get(k, k): v for k, v in table().items()}
    file = written(tmp_path / "run.csv", columns)
    file.write_text("\ufeff" + file.read_text() + "\n\n", encoding="utf-8")
    assert_array_equal(Run.from_csv(file, RIG, headings).x, RUN.y)


def test_angles_in_degrees_from_hanging_with_the_second_against_the_first(tmp_path: Path) -> None:
    columns = table()
    columns["th1"], columns["th2"] = np.rad2deg(RUN.x[:, 1] - np.pi), np.rad2deg(RUN.x[:, 2] - RUN.x[:, 1])
    columns["om1"], columns["om2"] = np.rad2deg(RUN.x[:, 4]), np.rad2deg(RUN.x[:, 5] - RUN.x[:, 4])
    run = Run.from_csv(written(tmp_path / "run.csv", columns), RIG, angle_unit="deg", zero="down", relative=True)
    assert_allclose(run.x, RUN.x, rtol=0, atol=1e-12)


def test_counts_of_encoders_that_differ_and_a_cart_that_counts_millimetres_the_other_way(tmp_path: Path) -> None:
    columns = table(names=("pos", "th1", "th2"))
    columns["pos"] = -1e3 * columns["pos"]
    columns["th1"] = np.rint((columns["th1"] - np.pi) / (2 * np.pi) * 4096)
    columns["th2"] = np.rint(-(columns["th2"] - np.pi) / (2 * np.pi) * 10_000)
    columns["u"] = -1e-3 * columns["u"]
    units = {"angle_unit": (2 * np.pi / 4096, -2 * np.pi / 10_000), "position_unit": -1e-3, "force_unit": -1e3}
    run = Run.from_csv(written(tmp_path / "run.csv", columns), RIG, zero="down", **units)
    assert_allclose(run.x[:, 0], RUN.x[:, 0], rtol=0, atol=1e-12)
    assert np.abs(run.x[:, 1] - RUN.x[:, 1]).max() <= np.pi / 4096 * 1.001
    assert np.abs(run.x[:, 2] - RUN.x[:, 2]).max() <= np.pi / 10_000 * 1.001
    assert_allclose(run.u, RUN.u, rtol=1e-14)


def test_angles_that_were_cut_to_one_turn_are_made_whole(tmp_path: Path) -> None:
    free = dpend.simulate(RIG.replace(track_limit=np.inf), LQR(RIG), [0, 2.0, -2.0, 0, 3, -3], 2.0, task=None)
    assert np.abs(free.x[:, 1:3]).max() > np.pi
    columns = table(free)
    columns["th1"], columns["th2"] = dpend.wrap(columns["th1"]), dpend.wrap(columns["th2"])
    run = Run.from_csv(written(tmp_path / "run.csv", columns), RIG, any_size=True)
    assert_allclose(run.x, free.x, rtol=0, atol=1e-12)


def test_rates_that_were_not_measured_are_slopes_of_the_positions(tmp_path: Path) -> None:
    run = Run.from_csv(written(tmp_path / "run.csv", table(names=("pos", "th1", "th2"))), RIG)
    assert_array_equal(run.x[:, :3], RUN.x[:, :3])
    assert_allclose(run.x[10:, 3:], RUN.x[10:, 3:], rtol=0, atol=0.05)


def test_fitted_rates_are_exact_on_parabolas_up_to_their_ends() -> None:
    t = 0.02 * np.arange(20)
    assert_allclose(fitted_rates(1.0 + 2.0 * t - 3.0 * t**2, 0.02), 2.0 - 6.0 * t, rtol=0, atol=1e-11)
    assert_allclose(fitted_rates(np.array([1.0, 3.0]), 0.5), [4.0, 4.0])
    assert_array_equal(fitted_rates(np.array([1.0]), 0.5), [0.0])


def test_of_a_command_the_rigs_actuator_makes_the_force(tmp_path: Path) -> None:
    rig = RIG.replace(force_limit=15.0, actuator_lag=0.03, actuator_delay=2)
    commands: list[float] = []

    class Noting:
        batched = False

        def start(self, n: int, rng: np.random.Generator) -> dpend.Act:
            def act(t: float, y: Array) -> Array:
                commands.append(float((inner := LQR(RIG).start(1, rng)(t, y))[0]))
                return inner

            return act

    run = dpend.simulate(rig, Noting(), [0, 0.05, 0.02, 0, 0, 0], 0.5)
    assert np.abs(commands).max() > np.abs(run.u).max()
    columns = table(run)
    del columns["u"]
    columns["command"] = np.array([*commands, 0.0])
    assert_allclose(Run.from_csv(written(tmp_path / "run.csv", columns), rig).u, run.u, rtol=0, atol=1e-12)
    assert_allclose(applied(RIG, np.array([1.0, 50.0, -90.0])), [1.0, 40.0, -40.0])


def refused(
    tmp_path: Path, columns_written: Mapping[str, Any], message: str, rig: dpend.Rig = RIG, **settings: Any
) -> None:
    file = written(tmp_path / "run.csv", columns_written)
    with pytest.raises(ValueError, match=whole(message.format(file=file))):
        Run.from_csv(file, rig, **settings)


def test_a_missing_column_is_named_with_those_that_are_there(tmp_path: Path) -> None:
    columns = table(names=("pos", "th1"))
    there = "it has 't', 'pos', 'th1', 'u'."
    refused(tmp_path, columns, f"{{file}} has no column 'th2'; {there} Say which it is: columns={{{{'th2': ...}}}}.")
    refused(
        tmp_path,
        columns,
        f"{{file}} has no column 'alpha' (for 'th1'); {there} Say which it is: columns={{{{'th1': ...}}}}.",
        columns={"th1": "alpha"},
    )
    columns = table()
    del columns["u"]
    refused(
        tmp_path,
        columns,
        "{file} has no column 'u'; it has 't', 'pos', 'th1', 'th2', 'vel', 'om1', 'om2'. "
        "Say which it is: columns={{'u': ...}}. If no force acted, give columns={{\"u\": None}}.",
    )


def test_a_quantity_that_is_not_known_is_refused_with_the_nearest(tmp_path: Path) -> None:
    refused(
        tmp_path,
        table(),
        "There is no quantity 'comand' to read. Did you mean 'command'?",
        columns={"comand": "F"},
    )
    refused(
        tmp_path,
        table(),
        'Give a column for "u", the force applied, or for "command", what was asked for; not for both.',
        columns={"u": "F", "command": "G"},
    )


@pytest.mark.parametrize("cell", ["nan", "", "off"])
def test_a_cell_without_a_number_is_pointed_at(tmp_path: Path, cell: str) -> None:
    columns: dict[str, Any] = table()
    columns["th2"] = [cell if k == 7 else value for k, value in enumerate(columns["th2"])]
    refused(
        tmp_path,
        columns,
        f"{{file}}, sample 7, column 'th2': expected a finite number; got {cell!r}. "
        "Cut the recording there, or fill the gap.",
    )


def test_a_clock_that_is_not_uniform_is_refused(tmp_path: Path) -> None:
    columns = table()
    columns["t"] = columns["t"] + np.where(np.arange(len(RUN.t)) > 40, 0.01, 0.0)
    refused(
        tmp_path,
        columns,
        "{file} is not sampled uniformly: 0.03 s from sample 40 to the next, 0.02 s as a rule, and the tolerance is "
        "0.01 of that. Give resample=True, or raise tolerance.",
    )
    columns["t"] = RUN.t + 1e-5 * np.random.default_rng(0).uniform(-1, 1, len(RUN.t))
    assert len(Run.from_csv(written(tmp_path / "run.csv", columns), RIG).u) == 100


def test_a_clock_that_is_not_the_rigs_is_refused_with_the_remedy(tmp_path: Path) -> None:
    refused(
        tmp_path,
        table(),
        "{file} is sampled every 0.02 s, the rig every 0.01 s; expected the same: rig.replace(sample_time=0.02), if "
        "the times are in seconds, or resample=True.",
        RIG.replace(sample_time=0.01),
    )
    refused(
        tmp_path,
        table() | {"t": RUN.t[::-1]},
        "The times in {file} do not increase; expected seconds, one sample after the other.",
    )


@pytest.mark.parametrize("name", ["th1", "th2"])
def test_a_link_may_turn_a_hundred_times_and_no_further(tmp_path: Path, name: str) -> None:
    def turning(turns: float) -> dict[str, Array]:
        t = 0.02 * np.arange(2001, dtype=np.float64)
        return {"t": t, "pos": 0 * t, "th1": 0 * t, "th2": 0 * t, "u": 0 * t} | {name: 2 * np.pi * turns * t / 40}

    last = Run.from_csv(written(tmp_path / "run.csv", turning(99.9)), RIG).x[-1, NAMES.index(name)]
    assert last == pytest.approx(2 * np.pi * 99.9)
    refused(
        tmp_path,
        turning(100.1),
        f"{name} in {{file}} reaches 629 rad, more than the 628 rad that such a rig is likely to see: look at "
        "angle_unit (or at the rig), or give any_size=True.",
    )


def test_numbers_that_look_like_another_unit_are_refused_unless_they_are_vouched_for(tmp_path: Path) -> None:
    columns = table(names=("pos", "th1", "th2"))
    counts = columns | {"th1": np.rint(columns["th1"] / (2 * np.pi) * 4096)}
    refused(
        tmp_path,
        counts,
        f"th1 in {{file}} runs in whole numbers from {counts['th1'].min():g} to {counts['th1'].max():g}, so it is "
        "hardly in radians: give angle_unit, 2 * pi divided by the encoder's counts per turn (or any_size=True).",
    )
    refused(
        tmp_path,
        columns | {"pos": 1e3 * columns["pos"]},
        f"pos in {{file}} reaches {1e3 * np.abs(RUN.x[:, 0]).max():.3g} m, more than the 3.6 m that such a rig is "
        "likely to see: look at position_unit (or at the rig), or give any_size=True.",
    )
    degrees = columns | {name: np.rad2deg(columns[name]) for name in ("th1", "th2")}
    with pytest.raises(ValueError, match=r"^om1 in .* look at angle_unit"):
        Run.from_csv(written(tmp_path / "degrees.csv", degrees), RIG)
    assert Run.from_csv(tmp_path / "degrees.csv", RIG, any_size=True).x[0, 1] == np.rad2deg(RUN.x[0, 1])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"angle_unit": "grad"},
            'angle_unit must be "rad", "deg", or the radians in one unit, such as 2 * pi / 4096 for an encoder of 4096 '
            "counts a turn: a number other than 0, or one for each angle; got 'grad'.",
        ),
        (
            {"position_unit": 0.0},
            "position_unit must be a finite number other than 0, in SI units per unit; got 0.0.",
        ),
        ({"tolerance": None}, "tolerance must be a share of the sample time, at least 0; got None."),
        ({"zero": "left"}, 'zero must be "up" or "down"; got \'left\'.'),
    ],
)
def test_settings_that_mean_nothing_are_refused(tmp_path: Path, settings: dict[str, Any], message: str) -> None:
    refused(tmp_path, table(), message, **settings)


def test_an_empty_or_short_file_is_refused(tmp_path: Path) -> None:
    empty = tmp_path / "empty.csv"
    empty.write_text("")
    message = f"{empty} is empty; expected a line of column names and one line a sample."
    with pytest.raises(ValueError, match=whole(message)):
        Run.from_csv(empty, RIG)
    refused(
        tmp_path, {name: column[:2] for name, column in table().items()}, "{file} has 2 samples; expected at least 3."
    )
    with pytest.raises(FileNotFoundError):
        Run.from_csv(tmp_path / "nothing.csv", RIG)


# ---------------------------------------------------------------------------------------- what other programs write


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32", "cp1253"])
def test_the_encoding_is_found_out(tmp_path: Path, encoding: str) -> None:
    headings: dict[str, str | None] = {"th1": "\N{GREEK SMALL LETTER THETA}1", "th2": "\N{GREEK SMALL LETTER THETA}2"}
    columns = {headings.get(name) or name: values for name, values in table().items()}
    file = written(tmp_path / "run.csv", {"t": columns.pop("t")} | columns)
    file.write_bytes(file.read_text(encoding="utf-8").encode(encoding))
    assert_array_equal(Run.from_csv(file, RIG, headings).x, RUN.y)


def test_a_western_code_page_is_read_too(tmp_path: Path) -> None:
    columns = table() | {"Pr\N{LATIN SMALL LETTER U WITH DIAERESIS}fer": np.zeros(len(RUN.t))}
    file = written(tmp_path / "run.csv", columns)
    file.write_bytes(file.read_text(encoding="utf-8").encode("cp1252"))
    assert_array_equal(Run.from_csv(file, RIG).x, RUN.y)


@pytest.mark.parametrize("delimiter", [";", "\t", ","])
def test_decimal_commas_are_read(tmp_path: Path, delimiter: str) -> None:
    words = {name: [repr(float(value)).replace(".", ",") for value in values] for name, values in table().items()}
    assert_array_equal(Run.from_csv(written(tmp_path / "run.csv", words, delimiter), RIG).x, RUN.y)


def test_thousands_are_told_from_decimals_by_what_comes_last(tmp_path: Path) -> None:
    pos = np.linspace(1000.5, 2000.5, len(RUN.t))
    for form in ("{:,.4f}".format, lambda value: f"{value:,.4f}".translate(str.maketrans(",.", ".,"))):
        columns = table(names=("pos", "th1", "th2")) | {"pos": [form(value) for value in pos]}
        run = Run.from_csv(written(tmp_path / "run.csv", columns, ";"), RIG, position_unit=1e-3)
        assert_allclose(run.x[:, 0], pos / 1e3, rtol=1e-7)


def test_commas_that_both_separate_and_mark_decimals_are_refused(tmp_path: Path) -> None:
    words = {name: [f"{value:.6f}".replace(".", ",") for value in values] for name, values in table().items()}
    file = written(tmp_path / "run.csv", words)
    file.write_text(file.read_text().replace('"', ""))
    message = (
        f"{file}, sample 0 has 16 cells, the line of names 8. If commas are decimal signs here, semicolons or tabs "
        "must separate the cells."
    )
    with pytest.raises(ValueError, match=whole(message)):
        Run.from_csv(file, RIG)
    mixed = table() | {"pos": ["1.234" if k % 2 else "1,234" for k in range(len(RUN.t))]}
    message = f"{file}, column 'pos' has decimal points in some cells and commas in others."
    with pytest.raises(ValueError, match=whole(message)):
        Run.from_csv(written(file, mixed, ";"), RIG)


def test_headings_in_quotes_after_a_blank_are_read(tmp_path: Path) -> None:
    file = written(tmp_path / "run.csv", table())
    header, _, body = file.read_text().partition("\n")
    file.write_text(", ".join(f'"{name}"' for name in header.split(",")) + "\n" + body.replace(",", ", "))
    assert_array_equal(Run.from_csv(file, RIG).x, RUN.y)


@pytest.mark.parametrize("before", ["sep=;\n", "# ", "\n\n"])
def test_what_programs_write_before_the_names_is_passed_over(tmp_path: Path, before: str) -> None:
    file = written(tmp_path / "run.csv", table(), ";")
    file.write_text(before + file.read_text())
    assert_array_equal(Run.from_csv(file, RIG).x, RUN.y)


def test_a_file_that_is_no_table_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "picture.csv"
    file.write_bytes(b"t,pos\n" + b"x" * 200_000)
    message = f"{file} is no table of comma-separated values or the like: field larger than field limit (131072)."
    with pytest.raises(ValueError, match=whole(message)):
        Run.from_csv(file, RIG)


@pytest.mark.parametrize("ending", ["\r\n", "\r"])
def test_lines_may_end_as_on_any_system(tmp_path: Path, ending: str) -> None:
    file = written(tmp_path / "run.csv", table())
    file.write_bytes(file.read_text().replace("\n", ending).encode())
    assert_array_equal(Run.from_csv(file, RIG).x, RUN.y)


def test_times_may_be_in_milliseconds(tmp_path: Path) -> None:
    columns = table() | {"t": 1e3 * RUN.t}
    refused(
        tmp_path,
        columns,
        '{file} is sampled every 20 s, the rig every 0.02 s: are the times in ms? Give time_unit="ms".',
    )
    for unit in ("ms", 1e-3):
        assert_array_equal(Run.from_csv(tmp_path / "run.csv", RIG, time_unit=unit).x, RUN.y)
    message = 'time_unit must be "s", "ms", "us", or the seconds in one unit, above 0; got \'min\'.'
    refused(tmp_path, columns, message, time_unit="min")


def test_free_motion_needs_no_column_of_forces(tmp_path: Path) -> None:
    columns = table()
    del columns["u"]
    run = Run.from_csv(written(tmp_path / "run.csv", columns), RIG, {"u": None})
    assert_array_equal(run.u, np.zeros(100))
    assert_array_equal(run.x, RUN.y)


def test_a_clamped_cart_stands_still_without_position_or_force(tmp_path: Path) -> None:
    columns = table(names=("th1", "th2"))
    del columns["u"]
    run = Run.from_csv(written(tmp_path / "run.csv", columns), RIG, clamped=True)
    assert not run.u.any()
    assert not run.x[:, [0, 3]].any()
    assert_array_equal(run.x[:, 1:3], RUN.y[:, 1:3])


@pytest.mark.parametrize("jitter", [0.05, 0.25, 0.5])
def test_a_jittering_clock_is_resampled(tmp_path: Path, jitter: float) -> None:
    fine = dpend.simulate(RIG.replace(sample_time=1e-4, substeps=1), Zero(), [0, 0.2, -0.1, 0, 0, 0], 1.0, task=None)
    rng = np.random.default_rng(0)
    places = np.sort(
        np.clip(200 * np.arange(51) + rng.integers(-int(200 * jitter), int(200 * jitter) + 1, 51), 0, 10_000)
    )
    places = np.unique(np.concatenate([[0], places, [10_000]]))
    held = rng.uniform(-1, 1, len(places))
    columns = {"t": fine.t[places]} | {n: fine.x[places, i] for i, n in enumerate(NAMES[:3])} | {"u": held}
    file = written(tmp_path / "run.csv", columns)
    with pytest.raises(ValueError, match=r"is not sampled uniformly: .* Give resample=True, or raise tolerance\.$"):
        Run.from_csv(file, RIG)
    run = Run.from_csv(file, RIG, resample=True)
    assert_allclose(run.t, 0.02 * np.arange(51), atol=1e-12)
    assert_allclose(run.x[:, :3], fine.x[::200, :3], atol=3e-3)
    assert RIG.sample_time * run.u.sum() == pytest.approx((held[:-1] * np.diff(columns["t"])).sum())


def test_a_gap_is_not_bridged(tmp_path: Path) -> None:
    columns = {name: np.delete(values, np.s_[31:37]) for name, values in table().items()}
    message = "{file} has a gap of 0.14 s after sample 30, too wide to be bridged: cut the recording there."
    refused(tmp_path, columns, message, resample=True)


def test_a_recording_succeeds_where_no_link_fell(tmp_path: Path) -> None:
    assert Run.from_csv(written(tmp_path / "run.csv", table()), RIG).success
    hanging = table() | {"th1": RUN.y[:, 1] + np.pi}
    assert not Run.from_csv(written(tmp_path / "run.csv", hanging), RIG).success


def test_units_that_make_infinities_are_refused(tmp_path: Path) -> None:
    message = "{file} holds numbers beyond all bounds in these units: look at the units."
    with np.errstate(over="ignore"):
        refused(tmp_path, table(), message, force_unit=1e308, any_size=True)
