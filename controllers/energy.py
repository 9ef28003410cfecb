r"""Swing-up by energy: the passivity law of the whole plant, and pumping of the links by the cart's acceleration.

Both steer the energy to that of upright at rest, :math:`E_r = f_1 + f_2`.  That is one number out of six: neither
steers the state to upright, and what comes near must be caught (:class:`controllers.switching.SwitchingController`).
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from dpend.arguments import checked_positive, is_finite
from dpend.controller import Act
from dpend.deprecation import renamed_arguments
from dpend.laws import holding
from dpend.params import Array
from dpend.plant import energies, rates
from dpend.rig import Rig, single_rig
from dpend.state import state_rows


class _EnergyLaw:
    """What both laws share: the rig, the energy of upright at rest, and a push for what hangs at rest."""

    name: str
    _gains: tuple[str, ...]

    def __init__(self, rig: Rig | str, perturbation: float | None) -> None:
        law = type(self).__name__
        self.rig = rig = single_rig(rig, law)
        c = rig.params.coefficients()
        self.energy = float(c.f1 + c.f2)
        if not self.energy > 0:
            raise ValueError(
                f"{law} lifts the links against gravity; got a rig without, gravity={rig.params.gravity!r}."
            )
        if perturbation is None:
            perturbation = 0.1 * float(c.d1) * float(rig.params.gravity)
        if not is_finite(perturbation):
            raise ValueError(f"perturbation must be a finite force in N; got {perturbation!r}.")
        self.perturbation = float(perturbation)
        unlimited = not math.isfinite(float(rig.track_limit))
        self._reach = float(c.length1 + c.length2) if unlimited else float(rig.track_limit)  # how far the cart may go

    def __repr__(self) -> str:
        return f"<{self.name}, {', '.join(f'{gain} = {getattr(self, gain):.4g}' for gain in self._gains)}>"

    def force(self, x: npt.ArrayLike) -> Array:
        """Return the law's answer to states ``(..., 6)``, N."""
        raise NotImplementedError

    def start(self, n: int, rng: np.random.Generator) -> Act:
        """Return the law for ``n`` runs, which is memoryless but for its first sample."""
        new = np.ones(n, dtype=np.bool_)

        def act(_: float, y: Array) -> Array:
            u = self.force(y)
            if new.any():
                hanging = energies(y, self.rig.params).total < -(1 - 1e-4) * self.energy
                u = np.where(new & hanging, self.perturbation, u)
                new[:] = False
            return u

        law = holding(n, act)

        def among(t: float, y: Array, rows: npt.NDArray[np.bool_]) -> Array:
            """Return the forces where this law is in charge; the other rows begin anew when they are next."""
            u = law(t, y)
            new[~rows] = True
            return u

        law.among = among  # type: ignore[attr-defined]
        return law


@renamed_arguments(kick="perturbation")
class EnergySwingUp(_EnergyLaw):
    r"""Law :math:`F = -(k_v\alpha + k_x p + k_d\dot p)/(k_E(E - E_r) + k_v\beta)`, shaping energy by passivity.

    The cart's acceleration is :math:`\ddot p = \beta F + \alpha`.  Without friction :math:`\dot E = F\dot p`, so
    that under this force

    .. math::
        V = \tfrac{k_E}{2}(E - E_r)^2 + \tfrac{k_v}{2}\dot p^2 + \tfrac{k_x}{2}p^2, \qquad \dot V = -k_d\,\dot p^2 .

    The energy is never below :math:`-E_r`, and :math:`\beta = (D^{-1})_{11}` is least with both links horizontal, where
    it is one over the mass of everything.  So the denominator keeps its sign, and the law is regular, if
    :math:`k_v\min\beta > 2 k_E E_r`.  A force that is held or limited, and friction, each break :math:`\dot V \le 0`.

    Parameters
    ----------
    rig : Rig or str
        What the law believes: the plant, and the track's length for a default gain.
    k_energy : float
        :math:`k_E`, 1/J^2, greater than zero; left out, :math:`1/E_r^2`.
    k_velocity : float
        :math:`k_v`, s^2/m^2; left out, 1.25 times the least that is regular.
    k_x : float
        :math:`k_x`, 1/m^2, greater than zero; left out, 20 over the square of the track's limit, or of the length of
        both links where the track is unlimited.
    k_d : float
        :math:`k_d`, s/m^2, greater than zero; left out, :math:`0.06\sqrt{k_x k_v}`.
    perturbation : float
        Force of the first sample, N, for a run that starts hanging at rest, where the law answers zero for ever; left
        out, a tenth of the weight of everything.

    Attributes
    ----------
    energy : float
        :math:`E_r`, J, zero being both centres of mass at the height of the cart's joint.

    Raises
    ------
    ValueError
        If the rig describes several plants or has no gravity, a gain is not greater than zero, or the law is singular.

    See Also
    --------
    controllers.EnergyPump : Another law of the energy.
    controllers.SwitchingController : Catch what it brings up.

    Notes
    -----
    Source: W. Zhong and H. Röck, *Energy and passivity based control of the double inverted pendulum on a cart*,
    IEEE Conference on Control Applications, 2001.

    Examples
    --------
    >>> import dpend
    >>> from controllers import EnergySwingUp
    >>> rig = dpend.rig("gustafsson2016")
    >>> law = EnergySwingUp(rig)
    >>> round(law.energy, 2)
    9.81
    """

    name = "energy swing-up"
    _gains = ("k_energy", "k_velocity", "k_x", "k_d")

    def __init__(
        self,
        rig: Rig | str,
        *,
        k_energy: float | None = None,
        k_velocity: float | None = None,
        k_x: float | None = None,
        k_d: float | None = None,
        perturbation: float | None = None,
    ) -> None:
        super().__init__(rig, perturbation)
        c = self.rig.params.coefficients()
        self.k_energy = checked_positive("k_energy", 1 / self.energy**2 if k_energy is None else k_energy)
        least = 2 * self.k_energy * self.energy * float(c.d1)
        self.k_velocity = checked_positive("k_velocity", 1.25 * least if k_velocity is None else k_velocity)
        if not self.k_velocity > least:
            raise ValueError(
                "The law is singular: it needs k_velocity * min beta > 2 * k_energy * Er, and with "
                f"k_velocity = {self.k_velocity:g}, min beta = 1 / ({c.d1:g} kg), k_energy = {self.k_energy:g} and "
                f"Er = {self.energy:g} J that is {self.k_velocity / c.d1:g} > {least / c.d1:g}; "
                f"let k_velocity be greater than {least:g}."
            )
        self.k_x = checked_positive("k_x", 20 / self._reach**2 if k_x is None else k_x)
        self.k_d = checked_positive("k_d", 0.06 * math.sqrt(self.k_x * self.k_velocity) if k_d is None else k_d)

    def lyapunov(self, x: npt.ArrayLike) -> Array:
        r"""Return :math:`V` of states ``(..., 6)``, which no unlimited and unheld force of this law lets rise.

        Upright at rest in the middle it is zero.

        Parameters
        ----------
        x : array_like (..., 6)
            States.

        Returns
        -------
        ndarray
            Values, without a unit.

        See Also
        --------
        controllers.EnergySwingUp : The law.

        Examples
        --------
        >>> import dpend
        >>> from controllers import EnergySwingUp
        >>> rig = dpend.rig("gustafsson2016")
        >>> float(EnergySwingUp(rig).lyapunov([0, 0, 0, 0, 0, 0]).round(9))
        0.0
        """
        x = state_rows("x", x)
        missing = energies(x, self.rig.params).total - self.energy
        return 0.5 * (self.k_energy * missing**2 + self.k_velocity * x[..., 3] ** 2 + self.k_x * x[..., 0] ** 2)

    def force(self, x: npt.ArrayLike) -> Array:
        """Return the law's answer to states ``(..., 6)``, N.

        Hanging at rest that is zero; a run begins with a small push instead.

        Parameters
        ----------
        x : array_like (..., 6)
            States.

        Returns
        -------
        ndarray
            Forces, N.

        See Also
        --------
        controllers.EnergySwingUp : The law.

        Examples
        --------
        >>> import dpend
        >>> from controllers import EnergySwingUp
        >>> rig = dpend.rig("gustafsson2016")
        >>> abs(float(EnergySwingUp(rig).force(dpend.EQUILIBRIA["down-down"]))) < 1e-9
        True
        """
        x = state_rows("x", x)
        alpha, beta = _cart_response(x, self.rig)
        missing = energies(x, self.rig.params).total - self.energy
        wanted = self.k_velocity * alpha + self.k_x * x[..., 0] + self.k_d * x[..., 3]
        return -wanted / (self.k_energy * missing + self.k_velocity * beta)


@renamed_arguments(kick="perturbation")
class EnergyPump(_EnergyLaw):
    r"""Cart acceleration :math:`a = a_\max\,\mathrm{sat}\big(\kappa\,\mu\,(E_l - E_r)/E_r\big) - k_x p - k_d\dot p`.

    :math:`E_l` is the energy of the links seen from the cart and :math:`\mu = d_2\omega_1\cos\theta_1 +
    d_3\omega_2\cos\theta_2` their momentum along the track, seen so too.  Without friction :math:`\dot E_l = -a\mu`:
    the first term never drives the energy away from :math:`E_r`, and the others keep the cart on its track.  The force
    that gives the cart this acceleration is :math:`F = (a - \alpha)/\beta`, with :math:`\ddot p = \beta F + \alpha`.

    Parameters
    ----------
    rig : Rig or str
        What the law believes: the plant, and the track's length for a default gain.
    acceleration : float
        :math:`a_\max`, m/s^2, greater than zero; left out, that of gravity.
    gain : float
        :math:`\kappa`, s/(kg m), greater than zero; left out, :math:`5\sqrt{(L_1 + L_2)/g}/(d_2 + d_3)`.
    k_x : float
        :math:`k_x`, 1/s^2, greater than zero; left out, gravity over the track's limit, or over the length of both
        links where the track is unlimited.
    k_d : float
        :math:`k_d`, 1/s, greater than zero; left out, :math:`\sqrt{k_x}`.
    perturbation : float
        See :class:`EnergySwingUp`.

    Attributes
    ----------
    energy : float
        :math:`E_r`, J, zero being both centres of mass at the height of the cart's joint.

    Raises
    ------
    ValueError
        If the rig describes several plants or has no gravity, or a gain is not greater than zero.

    See Also
    --------
    controllers.EnergySwingUp : By passivity.
    controllers.SwitchingController : Catch what it brings up.

    Notes
    -----
    Source: K. Åström and K. Furuta, *Swinging up a pendulum by energy control*, Automatica 36, 2000, for one link; the
    force is that of M. Spong, *Partial feedback linearization of underactuated mechanical systems*, IROS 1994.

    Examples
    --------
    >>> import dpend
    >>> from controllers import EnergyPump
    >>> rig = dpend.rig("gustafsson2016")
    >>> run = dpend.simulate(rig, EnergyPump(rig), dpend.EQUILIBRIA["down-down"], task=dpend.SwingUp(steps=100))
    >>> bool(dpend.energies(run.x[-1], rig.params).total > dpend.energies(run.x[0], rig.params).total)
    True
    """

    name = "energy pumping"
    _gains = ("acceleration", "gain", "k_x", "k_d")

    def __init__(
        self,
        rig: Rig | str,
        *,
        acceleration: float | None = None,
        gain: float | None = None,
        k_x: float | None = None,
        k_d: float | None = None,
        perturbation: float | None = None,
    ) -> None:
        super().__init__(rig, perturbation)
        c = self.rig.params.coefficients()
        gravity = float(self.rig.params.gravity)
        self.acceleration = checked_positive("acceleration", gravity if acceleration is None else acceleration)
        fall = math.sqrt((float(c.length1) + float(c.length2)) / gravity)
        self.gain = checked_positive("gain", 5 * fall / float(c.d2 + c.d3) if gain is None else gain)
        self.k_x = checked_positive("k_x", gravity / self._reach if k_x is None else k_x)
        self.k_d = checked_positive("k_d", math.sqrt(self.k_x) if k_d is None else k_d)

    def links_energy(self, x: npt.ArrayLike) -> Array:
        """Return the energy of the links seen from the cart, J, of states ``(..., 6)``.

        The cart's speed is taken out of it.

        Parameters
        ----------
        x : array_like (..., 6)
            States.

        Returns
        -------
        ndarray
            Energies, J.

        See Also
        --------
        dpend.energies : Of the whole plant.

        Examples
        --------
        >>> import dpend
        >>> from controllers import EnergyPump
        >>> rig = dpend.rig("gustafsson2016")
        >>> pump = EnergyPump(rig)
        >>> bool(abs(pump.links_energy([0, 0, 0, 0, 0, 0]) - pump.energy) < 1e-9)
        True
        """
        return energies(_moving_at(x, 0.0), self.rig.params).total

    def momentum(self, x: npt.ArrayLike) -> Array:
        r"""Return :math:`\mu`, kg m/s, of states ``(..., 6)``: kinetic energy linear in the cart's speed.

        Its sign says which way to push.

        Parameters
        ----------
        x : array_like (..., 6)
            States.

        Returns
        -------
        ndarray
            Momenta, kg m/s.

        See Also
        --------
        controllers.EnergyPump.links_energy : What it changes.

        Examples
        --------
        >>> import dpend
        >>> from controllers import EnergyPump
        >>> rig = dpend.rig("gustafsson2016")
        >>> round(float(EnergyPump(rig).momentum([0, 0, 0, 0, 1.0, 0])), 6)
        0.75
        """
        params = self.rig.params
        return 0.5 * (energies(_moving_at(x, 1.0), params).kinetic - energies(_moving_at(x, -1.0), params).kinetic)

    def force(self, x: npt.ArrayLike) -> Array:
        """Return the law's answer to states ``(..., 6)``, N.

        Hanging at rest that is zero; a run begins with a small push instead.

        Parameters
        ----------
        x : array_like (..., 6)
            States.

        Returns
        -------
        ndarray
            Forces, N.

        See Also
        --------
        controllers.EnergyPump : The law.

        Examples
        --------
        >>> import dpend
        >>> from controllers import EnergyPump
        >>> rig = dpend.rig("gustafsson2016")
        >>> abs(float(EnergyPump(rig).force(dpend.EQUILIBRIA["down-down"]))) < 1e-9
        True
        """
        x = state_rows("x", x)
        alpha, beta = _cart_response(x, self.rig)
        missing = (self.links_energy(x) - self.energy) / self.energy
        pumping = self.acceleration * np.clip(self.gain * self.momentum(x) * missing, -1.0, 1.0)
        return (pumping - self.k_x * x[..., 0] - self.k_d * x[..., 3] - alpha) / beta


def _cart_response(x: Array, rig: Rig) -> tuple[Array, Array]:
    r"""Return :math:`\alpha`, :math:`\beta` of :math:`\ddot p = \beta F + \alpha`; the plant is affine in the force."""
    alpha = rates(x, np.zeros(x.shape[:-1]), rig.params)[..., 3]
    return alpha, rates(x, np.ones(x.shape[:-1]), rig.params)[..., 3] - alpha


def _moving_at(x: npt.ArrayLike, speed: float) -> Array:
    """Return the states with the cart at another speed, the links turning as they do."""
    moving = state_rows("x", x).copy()
    moving[..., 3] = speed
    return moving
