"""What a laboratory recorded, read from a table into this package's units and signs."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .arguments import is_finite
from .params import Array
from .rig import Rig, single_rig
from .state import NAMES
from .stepper import Stepper
from .suggest import suggestion

COLUMNS = ("t", *NAMES, "u", "command")
"""What a table may hold; the rates may be left out, and of the last two there is one."""

_REQUIRED = ("t", "pos", "th1", "th2")
_MOST_TURNS = 100.0  # a link that has turned so far is counted in other units
_FIT = 7  # samples that a rate is fitted to


class Recording(NamedTuple):
    """States ``(T + 1, 6)`` at the samples, and the forces ``(T,)`` held between them."""

    t: Array
    x: Array
    u: Array


def read_recording(
    path: str | Path,
    rig: Rig,
    columns: Mapping[str, str] | None,
    angle_unit: str | float | Sequence[float],
    position_unit: float,
    force_unit: float,
    zero: str,
    relative: bool,
    tolerance: float,
    any_size: bool,
) -> Recording:
    """Read what ``Run.from_csv`` is given; its documentation says what each argument is.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If the table lacks a column, holds anything but numbers, has no uniform clock, or looks like other units.
    """
    per_angle = _radians(angle_unit)
    for name, unit in (("position_unit", position_unit), ("force_unit", force_unit)):
        if not (is_finite(unit) and unit != 0):
            raise ValueError(f"{name} must be a finite number other than 0, in SI units per unit; got {unit!r}.")
    if zero not in ("up", "down"):
        raise ValueError(f'zero must be "up" or "down", where the angles are counted from; got {zero!r}.')
    single_rig(rig, "A recording")
    table = _read_table(Path(path), _chosen(columns))
    times = table["t"]
    _check_clock(path, times, rig.sample_time, tolerance)

    if not any_size:
        _check_whole_numbers(path, table, per_angle)
    angles = np.stack([np.unwrap(table[name] * per_angle[i]) for i, name in enumerate(("th1", "th2"))])
    rates: dict[str, Array] = {}
    if "vel" in table:
        rates["vel"] = position_unit * table["vel"]
    for i, name in enumerate(("om1", "om2")):
        if name in table:
            rates[name] = per_angle[i] * table[name]
    if zero == "down":
        angles[0] += np.pi
        if not relative:
            angles[1] += np.pi
    if relative:
        angles[1] += angles[0]
        if "om2" in rates and "om1" in rates:
            rates["om2"] = rates["om2"] + rates["om1"]
        else:
            rates.pop("om2", None)
    positions = {"pos": position_unit * table["pos"], "th1": angles[0], "th2": angles[1]}
    for name, rate in (("pos", "vel"), ("th1", "om1"), ("th2", "om2")):
        if rate not in rates:
            rates[rate] = fitted_rates(positions[name], rig.sample_time)
    x = np.stack([(positions | rates)[name] for name in NAMES], axis=1)
    u = force_unit * table["u"][:-1] if "u" in table else applied(rig, force_unit * table["command"][:-1])
    if not any_size:
        _check_sizes(path, x, u, rig)
    return Recording(rig.sample_time * np.arange(len(times), dtype=np.float64), x, u)


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
    except (KeyError, TypeError, ValueError):
        raise ValueError(
            'angle_unit must be "rad", "deg", or the radians in one unit, such as 2 * pi / 4096 for an encoder of '
            f"4096 counts a turn: a number other than 0, or one for each angle; got {unit!r}."
        ) from None
    return float(first), float(second)


def _chosen(columns: Mapping[str, str] | None) -> dict[str, str]:
    """Return the heading of each quantity."""
    given = dict(columns or {})
    for name in given:
        if name not in COLUMNS:
            raise ValueError(f"There is no quantity {name!r} to read.{suggestion(str(name), COLUMNS)}")
    if "u" in given and "command" in given:
        raise ValueError(
            'Give a column for "u", the force applied, or for "command", what was asked for; not for both.'
        )
    return {name: name for name in COLUMNS} | given


def _read_table(path: Path, headings: dict[str, str]) -> dict[str, Array]:
    """Read the columns that are there, as numbers."""
    with path.open(newline="", encoding="utf-8-sig") as file:
        sample = file.read(4096)
        file.seek(0)
        delimiter = max(",;\t", key=sample.partition("\n")[0].count)
        lines = [line for line in csv.reader(file, delimiter=delimiter) if any(cell.strip() for cell in line)]
    if not lines:
        raise ValueError(f"{path} is empty; expected a line of column names and one line a sample.")
    header = [cell.strip() for cell in lines[0]]
    place = {name: header.index(heading) for name, heading in headings.items() if heading in header}
    for name in _REQUIRED:
        if name not in place:
            raise ValueError(_missing(path, name, headings[name], header))
    if "u" not in place and "command" not in place:
        raise ValueError(_missing(path, "u", headings["u"], header))
    if "u" in place:
        place.pop("command", None)
    if len(lines) < 4:
        raise ValueError(f"{path} has {len(lines) - 1} samples; expected at least 3.")
    table = {name: np.empty(len(lines) - 1) for name in place}
    for k, line in enumerate(lines[1:]):
        for name, column in place.items():
            cell = line[column].strip() if column < len(line) else ""
            try:
                table[name][k] = float(cell)
            except ValueError:
                table[name][k] = np.nan
            if not math.isfinite(table[name][k]):
                raise ValueError(
                    f"{path}, sample {k}, column {header[column]!r}: expected a finite number; got {cell!r}. "
                    "Cut the recording there, or fill the gap."
                )
    return table


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
            f"rule, and the tolerance is {tolerance:.2g} of that. Resample it, or raise tolerance."
        )
    mean = float(times[-1] - times[0]) / len(steps)
    if abs(mean - sample_time) > 0.01 * sample_time:
        raise ValueError(
            f"{path} is sampled every {mean:g} s, the rig every {sample_time:g} s; "
            f"expected the same: rig.replace(sample_time={mean:.6g}), if the times are in seconds."
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
