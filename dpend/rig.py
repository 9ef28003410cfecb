"""A rig: the plant as it stands in a laboratory, with clock, limits, actuator and sensors; and the presets."""

from __future__ import annotations

import math
import reprlib
import tomllib
from collections.abc import Callable
from dataclasses import MISSING, dataclass, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from . import archive
from .arguments import checked_array, checked_path, checked_whole
from .equations import make_acceleration_slopes
from .params import Array, Number, Params, checked_number, common_length, frozen, unit_of
from .suggest import suggestion, suggests

Count = int | npt.NDArray[np.int64]

_INF = float("inf")

_slopes = make_acceleration_slopes(np.sin, np.cos)
_UPRIGHT_TO_FOLDED = np.pi / 4 * np.mgrid[0:5, 0:8].reshape(2, -1, 1)  # by symmetry half of all angles
_STABLE = 2.0  # of the 2.785 up to which Runge-Kutta steps damp
_MOST_SUBSTEPS = 1000
_MOST_DELAY = 100_000


def _checked_limit(name: str, value: object, unit: str) -> Number:
    array = _numbers(value)
    if array.ndim > 1 or not array.size or not (array > 0).all():
        raise ValueError(
            f"{name} must be greater than zero, in {unit} (inf for none), or an array (N,) of such; got {value!r}."
        )
    return frozen(array)


def _checked_at_least_zero(name: str, value: object, unit: str) -> Number:
    return checked_number(name, value, unit, 0.0, True)


def _checked_samples(name: str, value: object, _: str) -> Count:
    array = _numbers(value)
    if (
        array.ndim > 1
        or not array.size
        or not np.all((array == np.rint(array)) & (array >= 0) & (array <= _MOST_DELAY))
    ):
        raise ValueError(
            f"{name} must be a whole number of samples, 0 to {_MOST_DELAY}, or an array (N,) of such; got {value!r}. "
            "A delay of d seconds is round(d / sample_time) samples."
        )
    samples = array.astype(np.int64)
    samples.setflags(write=False)
    return samples if samples.ndim else int(samples)


def _checked_per_state(name: str, value: object, _: str) -> Number:
    """Check a number for all six states, or an array (6,), (N, 1) or (N, 6)."""
    array = _numbers(value)
    shape_good = array.ndim == 0 or array.shape == (6,) or (array.ndim == 2 and array.shape[1] in (1, 6))
    if not shape_good or not (np.isfinite(array) & (array >= 0)).all():
        raise ValueError(
            f"{name} must be finite and at least 0: one number, one per state (6,), or (N, 1) or (N, 6) "
            f"with one row per run; got {value!r}."
        )
    if array.ndim == 2:  # a row of it then always has six entries
        array = np.repeat(array, 6 // array.shape[1], axis=1)
    return frozen(array)


def _numbers(value: object) -> Array:
    """Return numbers as a new array, NaN for what is none."""
    try:
        return checked_array("", value, "", finite=False).copy()
    except TypeError:
        return np.array(np.nan)


@suggests
@dataclass(frozen=True, kw_only=True, eq=False)
class Rig:
    r"""A plant with its sample time, force and track limits, actuator and sensors.

    Within one sample, in this order: the state is sampled, rounded to the encoders' resolution, given noise and
    delayed; the controller acts; its command is delayed, limited, lagged and given noise; the plant moves under the
    force held.  Fields may be arrays ``(N,)``, one rig per row of a batch, but for the clock.

    Parameters
    ----------
    params : Params
        The plant.
    sample_time : float
        Control period :math:`T`, s.
    substeps : int
        Least number of Runge-Kutta steps in one sample; raised, for all rows, to what stiff friction takes to come to
        rest: :math:`T\,\max_\theta\operatorname{tr}(D^{-1}\,\partial f_\text{friction}/\partial\dot q) / 2` at
        :math:`\dot q = 0`.
    force_limit : float
        Largest force the actuator gives, N; ``inf`` for none.
    track_limit : float
        Largest distance of the cart from the middle of the track, m; ``inf`` for none.
    actuator_lag : float
        Time constant :math:`\tau` of the actuator, s: each sample the force moves by the share
        :math:`1 - e^{-T/\tau}` towards the command.
    actuator_delay : int
        Whole samples by which commands are late.
    force_noise : float
        Standard deviation of the force's noise, N, drawn each sample.
    sensor_delay : int
        Whole samples by which measurements are late.
    sensor_noise : float or (6,) or (N, 6)
        Standard deviation of the noise of each measured state, in its unit.
    resolution : float or (6,) or (N, 6)
        Step to which each measured state is rounded, in its unit; zero for none.

    Raises
    ------
    TypeError, ValueError
        If a field is of the wrong kind or out of range; the message names field, bound and value.

    See Also
    --------
    dpend.rig : Presets by name.
    dpend.Rig.replace : Another in some fields.

    Examples
    --------
    >>> import dpend
    >>> rig = dpend.rig("gustafsson2016")
    >>> rig.sample_time, rig.force_limit, rig.track_limit
    (0.02, 40.0, 2.4)
    """

    params: Params
    sample_time: float
    substeps: int = 2
    force_limit: Number = _INF
    track_limit: Number = _INF
    actuator_lag: Number = 0.0
    actuator_delay: Count = 0
    force_noise: Number = 0.0
    sensor_delay: Count = 0
    sensor_noise: Number = 0.0
    resolution: Number = 0.0

    def __post_init__(self) -> None:
        if not isinstance(self.params, Params):
            raise TypeError(f"params must be dpend.Params; got {type(self.params).__name__}.")
        sample_time = checked_number("sample_time", self.sample_time, "s", 0.0, False)
        if not isinstance(sample_time, float):
            raise TypeError("sample_time must be a single number: all rows of a batch share one clock.")
        object.__setattr__(self, "sample_time", sample_time)
        least = checked_whole("substeps", self.substeps)
        object.__setattr__(self, "substeps", self._stable_substeps(sample_time, least))
        for name, (unit, checked) in _FIELDS.items():
            object.__setattr__(self, name, checked(name, getattr(self, name), unit))
        self.n  # noqa: B018  (raises where array lengths differ)

    def _stable_substeps(self, sample_time: float, least: int) -> int:
        """Return the number of steps in a sample, at least ``least``, that resolves friction's fastest decay."""
        c = self.params.coefficients()
        if not (np.any(c.b0) or np.any(c.b1) or np.any(c.b2) or np.any(c.coulomb)):
            return least
        th1, th2 = _UPRIGHT_TO_FOLDED
        with np.errstate(all="ignore"):  # what is beyond all numbers is refused below
            *_, by_vel, by_om1, by_om2, _ = _slopes((0.0, th1, th2, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), c)
            fastest = float(np.max(-(by_vel[0] + by_om1[1] + by_om2[2])))
        substeps = max(least, math.ceil(min(1e9, fastest * sample_time / _STABLE)))
        if substeps > max(least, _MOST_SUBSTEPS):
            raise ValueError(
                f"Friction stops this plant within {1 / fastest:.2g} s, too fast for a sample of {sample_time:g} s: it "
                f"would take {substeps} substeps, more than {_MOST_SUBSTEPS}. Raise coulomb_speed, lower the friction, "
                "or shorten sample_time."
            )
        return substeps

    @property
    def n(self) -> int | None:
        """Number of rigs the fields describe, or None where they are single values."""
        own = {name: value for name, value in self._own().items() if _is_per_row(name, value)}
        return common_length("Rig and Params", own | self.params.to_dict())

    @property
    def ideal(self) -> bool:
        """Whether actuator and sensors are perfect: no lag, delay, noise or rounding."""
        return not any(np.any(getattr(self, name)) for name in _IMPERFECTIONS)

    def replace(self, **changes: Any) -> Rig:
        """Return a rig with some fields of its own or of its ``params`` changed.

        The rig itself stays as it is.

        Parameters
        ----------
        **changes : Any
            Fields of the rig or of its plant by name; ``params`` replaces the whole plant.

        Returns
        -------
        Rig
            The other rig.

        Raises
        ------
        TypeError
            If neither ``Rig`` nor ``Params`` has a field of that name; the message suggests the nearest.

        See Also
        --------
        dpend.Rig : All fields.

        Examples
        --------
        >>> import dpend
        >>> rig = dpend.rig("gustafsson2016")
        >>> rig.replace(mass1=0.6, sensor_noise=0.002).params.mass1
        0.6
        """
        known = {field.name for field in fields(Rig)} | _PLANT_FIELDS
        for name in changes:
            if name not in known:
                raise TypeError(f"Neither Rig nor Params has a field {name!r}.{suggestion(name, known)}")
        params = changes.pop("params", self.params)
        plant_changes = {name: changes.pop(name) for name in tuple(changes) if name in _PLANT_FIELDS}
        if plant_changes:
            params = replace(params, **plant_changes)
        return replace(self, params=params, **changes)

    def rows(self, rows: slice | int) -> Rig:
        """Return the rig of some rows of a batch, or of one: array fields are cut, single values stay.

        It is how batches are cut into parts.

        Parameters
        ----------
        rows : slice or int
            Which rows.

        Returns
        -------
        Rig
            Of a slice a rig of several rows, of a number a single one.

        See Also
        --------
        dpend.simulate_many : Take one rig a row.

        Examples
        --------
        >>> import dpend
        >>> rig = dpend.rig("gustafsson2016")
        >>> many = rig.replace(mass1=[0.4, 0.5, 0.6])
        >>> many.rows(2).params.mass1
        0.6
        """
        if self.n is None:
            return self
        own = {name: value[rows] if _is_per_row(name, value) else value for name, value in self._own().items()}
        plant = {name: v[rows] if _is_per_row(name, v) else v for name, v in self.params.to_dict().items()}
        return Rig(params=Params(**plant), **own)

    def to_dict(self) -> dict[str, Any]:
        """Return the fields by name, ``params`` as a dict of its own.

        It is what records of runs and policies keep.

        Returns
        -------
        dict
            Plain numbers and arrays.

        See Also
        --------
        dpend.Rig.to_toml : A file of the same.

        Examples
        --------
        >>> import dpend
        >>> rig = dpend.rig("gustafsson2016")
        >>> sorted(rig.to_dict())[:2]
        ['actuator_delay', 'actuator_lag']
        """
        return {"params": self.params.to_dict()} | self._own()

    @classmethod
    def from_dict(cls, record: dict[str, Any]) -> Rig:
        """Return the rig that :meth:`to_dict` described; lists stand for arrays.

        Raises
        ------
        TypeError, ValueError
            If it describes none.
        """
        if not isinstance(record, dict) or not isinstance(record.get("params"), dict):
            raise TypeError(f"Expected a dict of a rig's fields, its params a dict too; got {reprlib.repr(record)}.")
        own = {name: value for name, value in record.items() if name != "params"}
        return cls(params=Params(**record["params"]), **own)

    def to_toml(self, path: str | Path) -> Path:
        """Write the rig as TOML, to its end or not at all, and return the path.

        The rig's own fields stand first, then the plant's under ``[params]``.  An OSError says why nothing was written.

        Parameters
        ----------
        path : str or Path
            Where to.

        Returns
        -------
        Path
            The path.

        See Also
        --------
        dpend.rig : Read it again.

        Examples
        --------
        >>> import dpend, tempfile
        >>> rig = dpend.rig("pilco2011")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     print(dpend.rig(str(rig.to_toml(f"{folder}/mine.toml"))) == rig)
        True
        """
        path = checked_path("path", path)
        lines = [*_toml_lines(self._own()), "", "[params]", *_toml_lines(self.params.to_dict())]
        with archive.atomic(path) as part:
            part.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return path

    @classmethod
    def from_toml(cls, path: str | Path) -> Rig:
        """Return the rig that a TOML file describes as :meth:`to_toml` does; fields with defaults may be left out.

        Raises
        ------
        OSError
            If it cannot be read.
        ValueError
            If it is not TOML, lacks a field, or holds one that is unknown or out of range.
        """
        file = checked_path("path", path)
        try:
            record = tomllib.loads(file.read_text(encoding="utf-8"))
            plant = record.get("params")
            if not isinstance(plant, dict):
                raise ValueError("expected a table [params] with the plant's masses and lengths")
            for name in set(record) & _PLANT_FIELDS:
                raise ValueError(f"{name} belongs under [params]")
            for owner, there in ((Params, plant), (Rig, record)):
                lacking = [f.name for f in fields(owner) if f.default is MISSING and f.name not in there]
                if lacking:
                    raise ValueError(f"{owner.__name__} lacks {', '.join(lacking)}")
            return cls.from_dict(record)
        except (TypeError, ValueError) as error:
            raise ValueError(f"{path} describes no rig: {str(error).rstrip('.')}.") from error

    def _repr_html_(self) -> str:
        units = {"sample_time": "s"} | {name: unit for name, (unit, _) in _FIELDS.items()}
        rows = {name: (value, units.get(name, "")) for name, value in self._own().items()}
        rows |= {name: (value, unit_of(name)) for name, value in self.params.to_dict().items() if value is not None}
        cells = (f"<tr><th>{name}</th><td>{value}</td><td>{unit}</td></tr>" for name, (value, unit) in rows.items())
        return f"<table>{''.join(cells)}</table>"

    def _own(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self) if field.name != "params"}

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Rig):
            return NotImplemented
        mine, theirs = self._own(), other._own()
        return self.params == other.params and all(np.array_equal(mine[name], theirs[name]) for name in mine)

    __hash__ = None  # type: ignore[assignment]  # a field may be an array


# unit, and what checks a value
_FIELDS: dict[str, tuple[str, Callable[..., Any]]] = {
    "force_limit": ("N", _checked_limit),
    "track_limit": ("m", _checked_limit),
    "actuator_lag": ("s", _checked_at_least_zero),
    "actuator_delay": ("samples", _checked_samples),
    "force_noise": ("N", _checked_at_least_zero),
    "sensor_delay": ("samples", _checked_samples),
    "sensor_noise": ("", _checked_per_state),
    "resolution": ("", _checked_per_state),
}
_IMPERFECTIONS = tuple(name for name in _FIELDS if not name.endswith("limit"))
_PLANT_FIELDS = {field.name for field in fields(Params)}


def _toml_lines(values: dict[str, Any]) -> list[str]:
    """Return ``name = value`` for numbers and arrays of them; what was left out stays out."""
    return [f"{name} = {np.asarray(value).tolist()}" for name, value in values.items() if value is not None]


def _is_per_row(name: str, value: Any) -> bool:
    """Whether a field holds one entry per row, rather than one for all (a single number, or one per state)."""
    return isinstance(value, np.ndarray) and value.ndim == (2 if name in ("sensor_noise", "resolution") else 1)


def _gustafsson2016() -> Rig:
    """Two 1 m rods on a 1 kg cart, 40 N, 2.4 m: the plant of the student report, rod inertias as intended.

    Source: the code published with the report, GitHub fregu856/CS-229, with I = m L^2/12.
    """
    params = Params(cart_mass=1.0, mass1=0.5, mass2=0.5, length1=1.0, length2=1.0)
    return Rig(params=params, sample_time=0.02, force_limit=40.0, track_limit=2.4)


def _gustafsson2016_as_coded() -> Rig:
    """Two 1 m rods on a 1 kg cart with the inertias that the report's program really used, 0.125 kg m^2.

    Source: GitHub fregu856/CS-229, which writes L^2 for the square; in Python that is a bitwise operation.
    """
    return _gustafsson2016().replace(inertia1=0.125, inertia2=0.125)


def _bogdanov2004() -> Rig:
    """Links of 0.5 m and 0.75 m on a 1.5 kg cart, no limits: the plant on which LQR, SDRE and others were compared.

    Source: A. Bogdanov, CSE-04-006, 2004.  His weights: Q = diag(5, 50, 50, 20, 700, 700), R = 1.
    """
    params = Params(cart_mass=1.5, mass1=0.5, mass2=0.75, length1=0.5, length2=0.75)
    return Rig(params=params, sample_time=0.02)


def _pilco2011() -> Rig:
    """Two 0.6 m rods on a 0.5 kg cart, 20 N, slow sampling, noisy sensors, g = 9.82: PILCO's cart double pendulum.

    Source: M. Deisenroth and C. Rasmussen, ICML 2011; scenario cartDoublePendulum of GitHub UCL-SML/pilco-matlab.
    """
    params = Params(cart_mass=0.5, mass1=0.5, mass2=0.5, length1=0.6, length2=0.6, cart_friction=0.1, gravity=9.82)
    return Rig(params=params, sample_time=0.05, substeps=5, force_limit=20.0, sensor_noise=0.01)


def _dompc_dip() -> Rig:
    """Two light 0.5 m rods on a 0.6 kg cart, 4 N: the double inverted pendulum of the do-mpc examples.

    Source: documentation of do-mpc, example "Double inverted pendulum".
    """
    params = Params(cart_mass=0.6, mass1=0.2, mass2=0.2, length1=0.5, length2=0.5, gravity=9.80665)
    return Rig(params=params, sample_time=0.04, substeps=4, force_limit=4.0)


def _capsule(length: float, radius: float, *, density: float = 1.0) -> tuple[float, float]:
    """Mass, and moment of inertia about an axis across its middle, of a cylinder with hemispheres as ends."""
    cylinder = density * np.pi * radius**2 * length
    ends = density * 4 / 3 * np.pi * radius**3
    inertia = cylinder * (length**2 / 12 + radius**2 / 4) + ends * (
        2 / 5 * radius**2 + length**2 / 4 + 3 / 8 * length * radius
    )
    return cylinder + ends, inertia


def _gymnasium_idp() -> Rig:
    """Heavy 0.6 m capsules on a 10.5 kg cart, 500 N, 1 m: Gymnasium's InvertedDoublePendulum.

    Source: inverted_double_pendulum.xml of Gymnasium; masses and inertias from its shapes at 1000 kg/m^3.
    """
    cart_mass, _ = _capsule(0.2, 0.1, density=1000.0)
    mass, inertia = _capsule(0.6, 0.045, density=1000.0)
    params = Params(
        cart_mass=cart_mass,
        mass1=mass,
        mass2=mass,
        length1=0.6,
        length2=0.6,
        inertia1=inertia,
        inertia2=inertia,
        cart_friction=0.05,
        joint1_friction=0.05,
        joint2_friction=0.05,
    )
    return Rig(params=params, sample_time=0.05, substeps=5, force_limit=500.0, track_limit=1.0)


def _dm_control_two_poles() -> Rig:
    """Two light 1 m capsules on a 1 kg cart, 10 N, 1.8 m: the two_poles cart-pole of the DeepMind Control Suite.

    Source: cartpole.xml of GitHub google-deepmind/dm_control; inertias from its shapes.
    """
    unit_mass, unit_inertia = _capsule(1.0, 0.045)
    params = Params(
        cart_mass=1.0,
        mass1=0.1,
        mass2=0.1,
        length1=1.0,
        length2=1.0,
        inertia1=0.1 * unit_inertia / unit_mass,
        inertia2=0.1 * unit_inertia / unit_mass,
        cart_friction=5e-4,
        joint1_friction=2e-6,
        joint2_friction=2e-6,
    )
    return Rig(params=params, sample_time=0.01, substeps=1, force_limit=10.0, track_limit=1.8)


PRESETS: MappingProxyType[str, Callable[[], Rig]] = MappingProxyType(
    {
        "gustafsson2016": _gustafsson2016,
        "gustafsson2016_as_coded": _gustafsson2016_as_coded,
        "bogdanov2004": _bogdanov2004,
        "pilco2011": _pilco2011,
        "dompc_dip": _dompc_dip,
        "gymnasium_idp": _gymnasium_idp,
        "dm_control_two_poles": _dm_control_two_poles,
    }
)


def rig(name: str) -> Rig:
    """Return the preset rig of that name, or the rig that a TOML file describes.

    Whatever takes a rig takes its name, too.

    Parameters
    ----------
    name : str
        One of those that :func:`rigs` lists, or the path of a file, ending in ``.toml``, that
        :meth:`Rig.from_toml` reads.

    Returns
    -------
    Rig
        The rig.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If there is no such preset, where the message suggests the nearest, or the file describes no rig.

    See Also
    --------
    dpend.rigs : All names.
    dpend.Rig : What comes back.

    Examples
    --------
    >>> import dpend
    >>> rig = dpend.rig("gustafsson2016")
    >>> rig.replace(force_limit=20.0).force_limit
    20.0
    """
    if isinstance(name, str | Path) and Path(name).suffix == ".toml":
        return Rig.from_toml(name)
    if not isinstance(name, str) or name not in PRESETS:
        raise ValueError(f"There is no preset rig {name!r}.{suggestion(str(name), PRESETS)}")
    return PRESETS[name]()


def as_rig(rig_or_name: Rig | str) -> Rig:
    """Return the rig, or the preset of that name.

    What is neither is refused by a TypeError, an unknown name by a ValueError that suggests the nearest.
    """
    if isinstance(rig_or_name, str):
        return rig(rig_or_name)
    if not isinstance(rig_or_name, Rig):
        raise TypeError(f"rig must be a dpend.Rig or the name of a preset; got {rig_or_name!r}.")
    return rig_or_name


def rigs() -> dict[str, str]:
    """Return what each preset rig is, and its source, by name.

    The docstring of each preset names the plant's source.

    Returns
    -------
    dict of str to str
        A line by name.

    See Also
    --------
    dpend.rig : One of them.

    Examples
    --------
    >>> import dpend
    >>> "pilco2011" in dpend.rigs()
    True
    """
    return {name: " ".join((build.__doc__ or "").split()) for name, build in PRESETS.items()}


def single_rig(rig_or_name: Rig | str, what: str) -> Rig:
    """Return the rig, or the preset of that name, for ``what`` takes one plant; refuse a rig of several rows."""
    rig = as_rig(rig_or_name)
    if rig.n is not None:
        raise ValueError(f"{what} takes one plant; got a rig of {rig.n} rows. Take one of them with rig.rows(i).")
    return rig


def ideal_rig(rig: Rig, *, limits: bool = False) -> Rig:
    """Return the plant with its clock and nothing in between but for limits: no lag, delays, noise or rounding."""
    kept: dict[str, Any] = {"force_limit": rig.force_limit, "track_limit": rig.track_limit} if limits else {}
    return Rig(params=rig.params, sample_time=rig.sample_time, substeps=rig.substeps, **kept)
