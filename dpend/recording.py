"""What a laboratory recorded, read from a table into this package's units and signs."""

from __future__ import annotations

import codecs
import contextlib
import csv
import io
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from .arguments import checked_flag, checked_mapping, checked_name, checked_path, is_finite
from .params import Array
from .rig import Rig, single_rig
from .state import NAMES
from .stepper import Stepper
from .suggest import suggestion

COLUMNS = ("t", *NAMES, "u", "command")
"""What a table may hold; the rates may be left out, and of the last two there is one."""

_TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
_CODE_PAGES = ("cp1252", "cp1250", "cp1251", "cp1253", "cp1254")  # western, central, Cyrillic, Greek, Turkish
_CLOSEST = 0.2  # of the usual gap: what follows sooner is left out
_WIDEST = 4.0  # samples that a gap may last and be bridged
_MOST_TURNS = 100.0  # a link that has turned so far is counted in other units
_FIT = 7  # samples that a rate is fitted to


def read_recording(
    path: str | Path,
    rig: Rig,
    columns: Mapping[str, str | None] | None,
    angle_unit: str | float | Sequence[float],
    position_unit: float,
    force_unit: float,
    time_unit: str | float,
    zero: str,
    relative: bool,
    clamped: bool,
    tolerance: float,
    resample: bool,
    any_size: bool,
) -> tuple[Array, Array, Array]:
    """Return times, states ``(T + 1, 6)`` and held forces ``(T,)`` of a table.

    ``Run.from_csv`` documents what each argument is, and what is refused.
    """
    per_angle = _radians(angle_unit)
    for name, unit in (("position_unit", position_unit), ("force_unit", force_unit)):
        if not (is_finite(unit) and unit != 0):
            raise ValueError(f"{name} must be a finite number other than 0, in SI units per unit; got {unit!r}.")
    if not (is_finite(tolerance) and tolerance >= 0):
        raise ValueError(f"tolerance must be a share of the sample time, at least 0; got {tolerance!r}.")
    checked_name("zero", zero, ("up", "down"))
    for name, flag in (("relative", relative), ("clamped", clamped), ("resample", resample), ("any_size", any_size)):
        checked_flag(name, flag)
    single_rig(rig, "A recording")
    headings = _chosen(columns) | ({"u": None, "command": None} if clamped else {})
    table = _read_table(
        checked_path("path", path), headings, ("t", "th1", "th2") if clamped else ("t", "pos", "th1", "th2")
    )
    if clamped:  # nothing moves the cart, whatever was recorded of it
        table |= {"pos": np.zeros_like(table["t"]), "vel": np.zeros_like(table["t"])}
    table["t"] = _seconds(time_unit) * table["t"]
    if not any_size:
        _check_whole_numbers(path, table, per_angle)
    for i, name in enumerate(("th1", "th2")):
        table[name] = np.unwrap(table[name] * per_angle[i])
    if resample:
        table = _resampled(path, table, rig.sample_time)
    else:
        _check_clock(path, table["t"], rig.sample_time, tolerance)

    units = {"pos": position_unit, "vel": position_unit, "om1": per_angle[0], "om2": per_angle[1]}
    motion = {name: units.get(name, 1.0) * table[name] for name in NAMES if name in table}
    if zero == "down":
        motion["th1"] += np.pi
        motion["th2"] += 0.0 if relative else np.pi
    if relative:
        motion["th2"] += motion["th1"]
        if "om1" in motion and "om2" in motion:
            motion["om2"] += motion["om1"]
        else:
            motion.pop("om2", None)
    for name, rate in zip(NAMES[:3], NAMES[3:], strict=True):
        if rate not in motion:
            motion[rate] = fitted_rates(motion[name], rig.sample_time)
    x = np.stack([motion[name] for name in NAMES], axis=1)
    steps = len(x) - 1
    if headings["u"] is None and "command" not in table:
        u = np.zeros(steps)
    else:
        u = force_unit * table["u" if "u" in table else "command"][:steps]
        u = u if "u" in table else applied(rig, u)
    if not (np.isfinite(x).all() and np.isfinite(u).all()):
        raise ValueError(f"{path} holds numbers beyond all bounds in these units: look at the units.")
    if not any_size:
        _check_sizes(path, x, u, rig)
    return rig.sample_time * np.arange(steps + 1, dtype=np.float64), x, u


def _resampled(path: str | Path, table: dict[str, Array], sample_time: float) -> dict[str, Array]:
    """Return the table on the rig's clock: states by cubic splines, forces by the mean of what was held meanwhile."""
    from scipy.interpolate import CubicSpline  # kept out of `import dpend`

    times = table["t"]
    gaps = np.diff(times)
    if gaps.min() <= 0:
        raise ValueError(f"The times in {path} do not increase; expected seconds, one sample after the other.")
    widest = int(np.argmax(gaps))
    if gaps[widest] > _WIDEST * max(sample_time, float(np.median(gaps))):
        raise ValueError(
            f"{path} has a gap of {gaps[widest]:g} s after sample {widest}, too wide to be bridged: cut the recording "
            "there."
        )
    steps = math.floor((times[-1] - times[0]) / sample_time + 1e-6)
    if steps < 2:
        raise ValueError(
            f"{path} lasts {times[-1] - times[0]:g} s, less than two samples of {sample_time:g} s: look at time_unit."
        )
    clock = np.minimum(times[0] + sample_time * np.arange(steps + 1), times[-1])
    apart = np.append(True, gaps >= _CLOSEST * np.median(gaps))  # noise of close samples would make splines overshoot
    new = {"t": clock}
    for name, values in table.items():
        if name in ("u", "command"):
            pushed = np.append(0.0, np.cumsum(values[:-1] * gaps))  # N s since the beginning
            new[name] = np.diff(np.interp(clock, times, pushed)) / sample_time
        elif name != "t":
            new[name] = CubicSpline(times[apart], values[apart])(clock)
    return new


def applied(rig: Rig, command: Array) -> Array:
    """Return the forces that the rig's actuator makes of commands ``(T,)``: delayed, limited, lagged, without noise."""
    actuator = rig.replace(force_noise=0.0, sensor_noise=0.0, sensor_delay=0, resolution=0.0)
    stepper = Stepper(actuator, 1)
    stepper.reset(np.zeros(6))
    forces = np.empty(len(command))
    for k, value in enumerate(command):
        stepper.step(np.array([value]))
        forces[k] = stepper.force[0]
        stepper.x[:] = 0.0  # the actuator alone is of interest
    return forces


def fitted_rates(values: Array, sample_time: float) -> Array:
    """Return the slope at each sample of the parabola that fits up to seven samples around it best."""
    n = len(values)
    width = min(_FIT, n)
    if width < 2:
        return np.zeros(n)
    degree = min(2, width - 1)
    first = np.clip(np.arange(n) - width // 2, 0, n - width)
    windows = np.lib.stride_tricks.sliding_window_view(values, width)[first]
    powers = np.vander(np.arange(width, dtype=np.float64), degree + 1, increasing=True)
    coefficients = windows @ np.linalg.pinv(powers).T
    place = np.arange(n) - first
    return sum((k * coefficients[:, k] * place ** (k - 1) for k in range(1, degree + 1)), np.zeros(n)) / sample_time


def _radians(unit: str | float | Sequence[float]) -> tuple[float, float]:
    """Return the radians in a unit of each angle."""
    named = {"rad": 1.0, "deg": math.pi / 180}
    try:
        numbers = np.array(named[unit] if isinstance(unit, str) else unit, dtype=np.float64)
        first, second = np.broadcast_to(numbers, 2)
        if not (np.isfinite(numbers) & (numbers != 0)).all():
            raise ValueError
    except (KeyError, TypeError, ValueError, OverflowError):
        raise ValueError(
            'angle_unit must be "rad", "deg", or the radians in one unit, such as 2 * pi / 4096 for an encoder of '
            f"4096 counts a turn: a number other than 0, or one for each angle; got {unit!r}."
        ) from None
    return float(first), float(second)


def _seconds(unit: str | float) -> float:
    """Return the seconds in a unit of time."""
    seconds = _TIME_UNITS.get(unit) if isinstance(unit, str) else unit
    if seconds is None or not (is_finite(seconds) and seconds > 0):
        raise ValueError(f'time_unit must be "s", "ms", "us", or the seconds in one unit, above 0; got {unit!r}.')
    return float(seconds)


def _chosen(columns: Mapping[str, str | None] | None) -> dict[str, str | None]:
    """Return the heading of each quantity; None for a force that there was not."""
    given = checked_mapping("columns", columns, "a mapping of quantities to headings of the table")
    for name, heading in given.items():
        if name not in COLUMNS:
            raise ValueError(f"There is no quantity {name!r} to read.{suggestion(str(name), COLUMNS)}")
        if not isinstance(heading, str) and (heading is not None or name not in ("u", "command")):
            raise ValueError(f"columns[{name!r}] must be a heading of the table; got {heading!r}.")
    if given.get("u") and given.get("command"):
        raise ValueError(
            'Give a column for "u", the force applied, or for "command", what was asked for; not for both.'
        )
    return {name: name for name in COLUMNS} | ({"command": None} if "u" in given else {}) | given


def _read_table(path: Path, headings: dict[str, str | None], required: tuple[str, ...]) -> dict[str, Array]:
    """Read the columns that are there, as numbers."""
    text = _decoded(path.read_bytes(), [heading for heading in headings.values() if heading])
    text = re.sub(r"\A\s*(sep=.\s*)?(#\s*)?", "", text)  # what Excel and numpy write before the names
    first = next(iter(text.splitlines()), "").strip()
    cells = {sign: len(next(csv.reader([first], delimiter=sign, skipinitialspace=True), [])) for sign in ";\t,| "}
    delimiter = max(";\t,|", key=lambda sign: cells[sign])
    delimiter = delimiter if cells[delimiter] > 1 else " "
    rows = csv.reader(io.StringIO(text, newline=None), delimiter=delimiter, skipinitialspace=True)
    try:
        lines = [line for line in rows if any(cell.strip() for cell in line)]
    except csv.Error as error:
        raise ValueError(f"{path} is no table of comma-separated values or the like: {error}.") from error
    if not lines:
        raise ValueError(f"{path} is empty; expected a line of column names and one line a sample.")
    header = [cell.strip() for cell in lines[0]]
    place = {name: header.index(heading) for name, heading in headings.items() if heading in header}
    for name in required:
        if name not in place:
            raise ValueError(_missing(path, name, str(headings[name]), header))
    if headings["u"] is not None and "u" not in place and "command" not in place:
        raise ValueError(_missing(path, "u", headings["u"], header) + ' If no force acted, give columns={"u": None}.')
    if "u" in place:
        place.pop("command", None)
    if len(lines) < 4:
        raise ValueError(f"{path} has {len(lines) - 1} samples; expected at least 3.")
    for k, line in enumerate(lines[1:]):
        if any(cell.strip() for cell in line[len(header) :]):
            raise ValueError(
                f"{path}, sample {k} has {len(line)} cells, the line of names {len(header)}. If commas are decimal "
                "signs here, semicolons or tabs must separate the cells."
            )
    return {
        name: _numbers(path, header[column], [line[column : column + 1] for line in lines[1:]])
        for name, column in place.items()
    }


def _decoded(raw: bytes, headings: Sequence[str]) -> str:
    """Return the text of a file: Unicode if it can be, else of the code page that knows most of the headings."""
    if raw.startswith((codecs.BOM_UTF32_LE, codecs.BOM_UTF32_BE)):
        return raw.decode("utf-32", errors="replace")
    if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return raw.decode("utf-16", errors="replace")
    if b"\0" in raw[:2]:  # UTF-16 without a mark: the first letter of a heading is ASCII
        return raw.decode("utf-16-be" if raw[:1] == b"\0" else "utf-16-le", errors="replace")
    with contextlib.suppress(UnicodeDecodeError):
        return raw.decode("utf-8-sig")
    texts = [raw.decode(page, errors="replace") for page in _CODE_PAGES]
    return max(texts, key=lambda text: sum(heading in text for heading in headings))


def _numbers(path: Path, heading: str, cells: Sequence[Sequence[str]]) -> Array:
    """Return a column's numbers, with decimal points or commas."""
    texts = [cell[0].strip().replace("\N{MINUS SIGN}", "-") if cell else "" for cell in cells]
    commas = any("," in text for text in texts)
    if commas and any("." in text and "," not in text for text in texts):
        raise ValueError(f"{path}, column {heading!r} has decimal points in some cells and commas in others.")
    numbers = np.empty(len(texts))
    for k, text in enumerate(texts):
        thousands, decimal = (",", ".") if text.rfind(".") > text.rfind(",") else (".", ",")
        try:
            numbers[k] = float(text.replace(thousands, "").replace(decimal, ".") if commas else text)
        except ValueError:
            numbers[k] = np.nan
        if not math.isfinite(numbers[k]):
            raise ValueError(
                f"{path}, sample {k}, column {heading!r}: expected a finite number; got {text!r}. "
                "Cut the recording there, or fill the gap."
            )
    return numbers


def _missing(path: Path, name: str, heading: str, header: list[str]) -> str:
    what = f"{name!r}" if name == heading else f"{heading!r} (for {name!r})"
    return (
        f"{path} has no column {what}; it has {', '.join(map(repr, header))}. "
        f"Say which it is: columns={{{name!r}: ...}}."
    )


def _check_clock(path: str | Path, times: Array, sample_time: float, tolerance: float) -> None:
    steps = np.diff(times)
    usual = float(np.median(steps))
    if usual <= 0:
        raise ValueError(f"The times in {path} do not increase; expected seconds, one sample after the other.")
    worst = int(np.argmax(np.abs(steps - usual)))
    if abs(steps[worst] - usual) > tolerance * usual:
        raise ValueError(
            f"{path} is not sampled uniformly: {steps[worst]:g} s from sample {worst} to the next, {usual:g} s as a "
            f"rule, and the tolerance is {tolerance:.2g} of that. Give resample=True, or raise tolerance."
        )
    mean = float(times[-1] - times[0]) / len(steps)
    if abs(mean - sample_time) > 0.01 * sample_time:
        for unit, seconds in _TIME_UNITS.items():
            if abs(mean * seconds - sample_time) <= 0.01 * sample_time:
                raise ValueError(
                    f"{path} is sampled every {mean:g} s, the rig every {sample_time:g} s: are the times in {unit}? "
                    f'Give time_unit="{unit}".'
                )
        raise ValueError(
            f"{path} is sampled every {mean:g} s, the rig every {sample_time:g} s; "
            f"expected the same: rig.replace(sample_time={mean:.6g}), if the times are in seconds, or resample=True."
        )


def _check_whole_numbers(path: str | Path, table: dict[str, Array], per_angle: tuple[float, float]) -> None:
    """Refuse what looks like encoder counts that are to be taken for radians."""
    for i, name in enumerate(("th1", "th2")):
        angle = table[name]
        if per_angle[i] == 1.0 and np.all(angle == np.rint(angle)) and np.ptp(angle) > 2 * np.pi:
            raise ValueError(
                f"{name} in {path} runs in whole numbers from {angle.min():g} to {angle.max():g}, so it is hardly in "
                "radians: give angle_unit, 2 * pi divided by the encoder's counts per turn (or any_size=True)."
            )


def _check_sizes(path: str | Path, x: Array, u: Array, rig: Rig) -> None:
    """Refuse what no such rig does, and so is likely to be in another unit."""
    params = rig.params
    fastest = 8 * math.sqrt(max(params.gravity, 1.0) / min(float(params.length1), float(params.length2)))
    h = rig.sample_time
    suspicions = [
        ("th1", np.abs(x[:, 1]).max(), 2 * np.pi * _MOST_TURNS, "rad", "angle_unit"),
        ("th2", np.abs(x[:, 2]).max(), 2 * np.pi * _MOST_TURNS, "rad", "angle_unit"),
        ("om1", _speed(x[:, 1], h), fastest, "rad/s", "angle_unit"),
        ("om2", _speed(x[:, 2], h), fastest, "rad/s", "angle_unit"),
        ("pos", np.abs(x[:, 0]).max(), 1.5 * float(rig.track_limit), "m", "position_unit"),
        ("u", np.abs(u).max(), 1.5 * float(rig.force_limit), "N", "force_unit"),
    ]
    for name, most, bound, unit, argument in suspicions:
        if most > bound:
            raise ValueError(
                f"{name} in {path} reaches {most:.3g} {unit}, more than the {bound:.3g} {unit} that such a rig is "
                f"likely to see: look at {argument} (or at the rig), or give any_size=True."
            )


def _speed(angle: Array, sample_time: float) -> float:
    """Return a speed that is exceeded, up to one sample in a hundred."""
    return float(np.quantile(np.abs(fitted_rates(angle, sample_time)), 0.99))
