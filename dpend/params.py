"""What the plant is made of: masses, lengths, inertias, frictions; and the coefficients the equations use."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from .arguments import checked_array
from .suggest import suggests

Array = npt.NDArray[np.float64]
Number = float | Array


class Coefficients(NamedTuple):
    r"""The lumped coefficients of the equations of motion; every field may be a float, an array or a symbol.

    ``d1`` to ``d6`` make up the mass matrix, ``f1`` and ``f2`` are the gravity torques, ``b0`` to ``b2`` the viscous
    frictions of cart and joints, ``coulomb`` and ``coulomb_speed`` the smooth Coulomb friction of the cart, and
    ``length1``, ``length2`` the lengths of the links.
    """

    d1: Any
    d2: Any
    d3: Any
    d4: Any
    d5: Any
    d6: Any
    f1: Any
    f2: Any
    b0: Any
    b1: Any
    b2: Any
    coulomb: Any
    coulomb_speed: Any
    length1: Any
    length2: Any


# field: (unit, the least value allowed, whether that value itself is allowed)
_BOUNDS = {
    "cart_mass": ("kg", 0.0, False),
    "mass1": ("kg", 0.0, False),
    "mass2": ("kg", 0.0, False),
    "length1": ("m", 0.0, False),
    "length2": ("m", 0.0, False),
    "com1": ("m", 0.0, True),
    "com2": ("m", 0.0, True),
    "inertia1": ("kg m^2", 0.0, True),
    "inertia2": ("kg m^2", 0.0, True),
    "cart_friction": ("N s/m", 0.0, True),
    "joint1_friction": ("N m s", 0.0, True),
    "joint2_friction": ("N m s", 0.0, True),
    "cart_coulomb": ("N", 0.0, True),
    "coulomb_speed": ("m/s", 0.0, False),
    "gravity": ("m/s^2", 0.0, True),
}


def unit_of(name: str) -> str:
    """Return the SI unit of a field of :class:`Params`."""
    return _BOUNDS[name][0]


def checked_number(name: str, value: object, unit: str, least: float, least_allowed: bool) -> Number:
    """Return ``value`` as a float, or as a read-only array of one number a row, if it is finite and large enough.

    What is no number or array ``(N,)`` of them is refused by a TypeError, what is out of range by a ValueError, which
    names field, bound and value.
    """
    array = checked_array(name, value, f"one in {unit}, or an array (N,) with one per row", finite=False).copy()
    if array.ndim > 1 or array.size == 0:
        raise TypeError(f"{name} must be a number in {unit}, or an array (N,); got an array of shape {array.shape}.")
    good = np.isfinite(array) & ((array >= least) if least_allowed else (array > least))
    if not good.all():
        bad = float(array[~good][0]) if array.ndim else float(array)
        bound = "at least" if least_allowed else "greater than"
        raise ValueError(f"{name} must be finite and {bound} {least:g} {unit}; got {bad:g}.")
    return frozen(array)


def frozen(array: npt.NDArray[Any]) -> Number:
    """Return a single number as a float, an array read-only."""
    if array.ndim == 0:
        return float(array)
    array.setflags(write=False)
    return array


def common_length(owner: str, values: dict[str, object]) -> int | None:
    """Return the number of rows that array-valued fields share, or None where all are single numbers."""
    lengths = {name: len(value) for name, value in values.items() if isinstance(value, np.ndarray) and value.ndim}
    if len(set(lengths.values())) > 1:
        listing = ", ".join(f"{name} ({n},)" for name, n in lengths.items())
        raise ValueError(f"All array fields of {owner} must have one length, one entry per row; got {listing}.")
    return next(iter(lengths.values()), None)


def checked_params(what: str, params: object) -> Params:
    """Return the plant, if it is one; refuse anything else, such as a rig, in the name of ``what`` takes it."""
    if not isinstance(params, Params):
        raise TypeError(f"{what} takes dpend.Params, such as rig.params; got {type(params).__name__}.")
    return params


@suggests
@dataclass(frozen=True, kw_only=True, eq=False)
class Params:
    r"""Masses, lengths, centres, inertias, frictions and gravity of a double pendulum on a cart, in SI units.

    Every field may be an array ``(N,)``: one plant per row of a batch.

    Parameters
    ----------
    cart_mass, mass1, mass2 : float
        Masses of cart and links, kg, greater than zero.
    length1, length2 : float
        Lengths of the links, m, greater than zero.
    com1, com2 : float, optional
        Distance of each link's centre of mass from its lower joint, m; left out, the middle of the link.
    inertia1, inertia2 : float, optional
        Moment of inertia of each link about its centre of mass, kg m^2; left out, that of a uniform rod,
        :math:`m L^2/12`.
    cart_friction : float
        Viscous friction of the cart, N s/m.
    joint1_friction, joint2_friction : float
        Viscous friction of the joints, N m s; joint 2 acts on :math:`\omega_2 - \omega_1`.
    cart_coulomb, coulomb_speed : float
        Smooth Coulomb friction of the cart, :math:`F_c v/\sqrt{v^2 + v_s^2}` against the motion, N and m/s.
    gravity : float
        Acceleration of free fall, m/s^2.

    Raises
    ------
    TypeError
        If a field is not a number, or an array of one number a row.
    ValueError
        If a field is out of its range, or link 2 has no moment of inertia about its joint at all.

    See Also
    --------
    dpend.Rig : A plant with its clock and limits.
    dpend.rig : Those that are named.

    Examples
    --------
    >>> import dpend
    >>> params = dpend.Params(cart_mass=1.0, mass1=0.5, mass2=0.5, length1=1.0, length2=1.0)
    >>> dpend.rates([0, 0, 0, 0, 0, 0], 1.0, params).shape
    (6,)
    """

    cart_mass: Number
    mass1: Number
    mass2: Number
    length1: Number
    length2: Number
    com1: Number | None = None
    com2: Number | None = None
    inertia1: Number | None = None
    inertia2: Number | None = None
    cart_friction: Number = 0.0
    joint1_friction: Number = 0.0
    joint2_friction: Number = 0.0
    cart_coulomb: Number = 0.0
    coulomb_speed: Number = 0.01
    gravity: Number = 9.81

    def __post_init__(self) -> None:
        for name, bounds in _BOUNDS.items():
            value = getattr(self, name)
            if value is None and name in ("com1", "com2", "inertia1", "inertia2"):
                continue
            object.__setattr__(self, name, checked_number(name, value, *bounds))
        self.n  # noqa: B018  (raises where array lengths differ)
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                finite = all(np.isfinite(number).all() for number in self.coefficients())
        except OverflowError:
            finite = False
        if not finite:
            raise ValueError("The plant's moments are beyond all numbers: are masses in kg and lengths in m?")
        if np.any((np.asarray(self.centers[1]) == 0) & (np.asarray(self.inertias[1]) == 0)):
            raise ValueError(
                "Link 2 has neither an inertia nor a lever arm, so nothing resists its rotation; "
                "give com2 or inertia2 a value greater than zero."
            )

    @property
    def n(self) -> int | None:
        """Number of plants the fields describe, or None where they are single numbers."""
        return common_length("Params", self.to_dict())

    @property
    def centers(self) -> tuple[Number, Number]:
        """Distances of the links' centres of mass from their lower joints, m, defaults resolved."""
        return (
            self.length1 / 2 if self.com1 is None else self.com1,
            self.length2 / 2 if self.com2 is None else self.com2,
        )

    @property
    def inertias(self) -> tuple[Number, Number]:
        """Moments of inertia of the links about their centres of mass, kg m^2, defaults resolved."""
        return (
            self.mass1 * self.length1**2 / 12 if self.inertia1 is None else self.inertia1,
            self.mass2 * self.length2**2 / 12 if self.inertia2 is None else self.inertia2,
        )

    def coefficients(self) -> Coefficients:
        r"""Return the lumped coefficients of the equations of motion.

        They are worked out anew at each call, so that they cannot fall behind the fields.

        Returns
        -------
        Coefficients
            :math:`d_1 \dots d_6`, :math:`f_1, f_2` and the frictions, floats or ``(N,)``.

        See Also
        --------
        dpend.rates : The equations that they enter.

        Examples
        --------
        >>> import dpend
        >>> rig = dpend.rig("gustafsson2016")
        >>> float(rig.params.coefficients().d1)
        2.0
        """
        com1, com2 = self.centers
        inertia1, inertia2 = self.inertias
        d2 = self.mass1 * com1 + self.mass2 * self.length1
        d3 = self.mass2 * com2
        return Coefficients(
            d1=self.cart_mass + self.mass1 + self.mass2,
            d2=d2,
            d3=d3,
            d4=self.mass1 * com1**2 + self.mass2 * self.length1**2 + inertia1,
            d5=d3 * self.length1,
            d6=self.mass2 * com2**2 + inertia2,
            f1=d2 * self.gravity,
            f2=d3 * self.gravity,
            b0=self.cart_friction,
            b1=self.joint1_friction,
            b2=self.joint2_friction,
            coulomb=self.cart_coulomb,
            coulomb_speed=self.coulomb_speed,
            length1=self.length1,
            length2=self.length2,
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the fields by name, as they were set.

        ``Params(**params.to_dict())`` is the same plant; what was left out stays None.

        Returns
        -------
        dict
            Floats, arrays ``(N,)`` or None.

        See Also
        --------
        dpend.Rig.to_dict : The same of a rig.

        Examples
        --------
        >>> import dpend
        >>> rig = dpend.rig("gustafsson2016")
        >>> rig.params.to_dict()["length1"]
        1.0
        """
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Params):
            return NotImplemented
        mine, theirs = self.to_dict(), other.to_dict()
        return all(np.array_equal(mine[name], theirs[name]) for name in mine)

    __hash__ = None  # type: ignore[assignment]  # a field may be an array
