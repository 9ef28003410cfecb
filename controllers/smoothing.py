r"""Smoothing around any controller: a limit on the force's rate, and a first-order low-pass.  Both cost phase."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable

import numpy as np

from dpend.arguments import checked_positive, is_finite
from dpend.controller import Act, Controller, Law
from dpend.deprecation import renamed_arguments
from dpend.params import Array
from dpend.rig import Rig, single_rig

from .wrapping import Wrapper


@renamed_arguments(inner="controller")
class RateLimit(Wrapper):
    r"""Law :math:`u_k = u_{k-1} + \mathrm{clip}(\bar u_k - u_{k-1}, \pm rT)`, :math:`\bar u` the wrapped law's force.

    The wrapped law's force is first limited to what the rig's actuator can apply, so that the memory does not run away,
    and a run begins from no force.  So a change of the force by one newton takes :math:`1/r` seconds.

    Parameters
    ----------
    rig : Rig or str
        What the designer believes: sample time :math:`T` and force limit.
    controller : Controller
        The law to be smoothed.
    rate : float
        :math:`r`, N/s, greater than zero.

    Raises
    ------
    TypeError
        If ``controller`` is none.
    ValueError
        If the rig describes several plants, or the rate is not greater than zero and finite.

    See Also
    --------
    controllers.LowPass : A filter instead of a limit.

    Notes
    -----
    What it costs: nothing as long as the wrapped law's force is slower than :math:`r`, apart from the start.  A sine of
    amplitude :math:`A` and angular frequency :math:`\omega` with :math:`A\omega \ge r\sqrt{1 + \pi^2/4}` comes out as
    a triangle of amplitude :math:`\pi r/2\omega`, late by the phase :math:`\arccos(\pi r/2A\omega)`: up to a quarter
    turn, the more the larger the sine, so that a loop that survives a small disturbance may not survive a large one.

    Examples
    --------
    >>> import dpend
    >>> from controllers import LQR, RateLimit
    >>> rig = dpend.rig("gustafsson2016")
    >>> dpend.simulate(rig, RateLimit(rig, LQR(rig), rate=1600.0), [0, 0.1, -0.1, 0, 0, 0], duration=2.0).success
    True
    """

    def __init__(self, rig: Rig | str, controller: Controller | Law, rate: float) -> None:
        self.rig = single_rig(rig, "RateLimit")
        self.rate = checked_positive("rate", rate, "N/s")
        super().__init__(controller, f"{{}}, at most {self.rate:g} N/s")

    def _around(self, n: int, inner: Act) -> Act:
        most = self.rate * self.rig.sample_time
        return _filtered(n, inner, self.rig, lambda force, wanted: force + np.clip(wanted - force, -most, most))


@renamed_arguments(inner="controller")
class LowPass(Wrapper):
    r"""Law :math:`u_k = q\,u_{k-1} + (1 - q)\,\bar u_k`, :math:`q = e^{-T/\tau}`, :math:`\bar u` the wrapped law's.

    That is :math:`\tau\dot u = \bar u - u` under a force held over each sample, solved exactly; a sample is given the
    value that the filter has at its end, as the lag of a rig's actuator does.  The wrapped law's force is first limited
    to what the rig's actuator can apply, and a run begins from no force.

    Parameters
    ----------
    rig : Rig or str
        What the designer believes: sample time :math:`T` and force limit.
    controller : Controller
        The law to be smoothed.
    frequency : float, optional
        Corner frequency :math:`1/2\pi\tau`, Hz, greater than zero; this or the time constant.
    time_constant : float, optional
        :math:`\tau`, s, greater than zero.

    Attributes
    ----------
    time_constant : float
        :math:`\tau`, s.
    delay : float
        The cost at low frequency: slow forces come :math:`Tq/(1 - q)` seconds late, which is a
        little less than :math:`\tau`.  To be compared with the delay that ``LQR(rig).margins()`` allows.

    Raises
    ------
    TypeError
        If ``controller`` is none.
    ValueError
        If the rig describes several plants, neither or both of frequency and time constant are given, or one is not
        greater than zero and finite, or lets nothing pass.

    See Also
    --------
    controllers.RateLimit : A limit instead of a filter.

    Examples
    --------
    >>> import dpend
    >>> from controllers import LQR, LowPass
    >>> rig = dpend.rig("gustafsson2016")
    >>> dpend.simulate(rig, LowPass(rig, LQR(rig), frequency=16.0), [0, 0.1, -0.1, 0, 0, 0], duration=2.0).success
    True
    """

    def __init__(
        self,
        rig: Rig | str,
        controller: Controller | Law,
        *,
        frequency: float | None = None,
        time_constant: float | None = None,
    ) -> None:
        self.rig = single_rig(rig, "LowPass")
        if (frequency is None) == (time_constant is None):
            raise ValueError("Give frequency, in Hz, or time_constant, in s: one of the two.")
        if frequency is None:
            self.time_constant = checked_positive("time_constant", time_constant, "s")
        else:
            self.time_constant = 1 / (2 * math.pi * checked_positive("frequency", frequency, "Hz"))
        self._decay = math.exp(-self.rig.sample_time / self.time_constant)
        if self._decay == 1.0:
            raise ValueError(
                f"Nothing passes a filter with a time constant of {self.time_constant:.3g} s, at samples of "
                f"{self.rig.sample_time:g} s: expected a shorter one, or a higher frequency."
            )
        self.delay = self.rig.sample_time * self._decay / (1 - self._decay)
        super().__init__(controller, f"{{}}, low-pass {1 / (2 * math.pi * self.time_constant):.3g} Hz")

    def response(self, frequency: float) -> complex:
        r"""Return :math:`H = (1 - q)/(1 - q\,e^{-j\omega T})`: what becomes of a sine of the wrapped law's force.

        It is that of the sampled filter, up to half the sampling rate.

        Parameters
        ----------
        frequency : float
            Hz.

        Returns
        -------
        complex
            Its size is the gain, its angle the phase, negative where the force is late.

        Raises
        ------
        ValueError
            If the frequency is no finite number.

        See Also
        --------
        controllers.LQR.margins : What phase and delay the loop bears.

        Examples
        --------
        >>> import dpend
        >>> from controllers import LQR, LowPass
        >>> rig = dpend.rig("gustafsson2016")
        >>> round(abs(LowPass(rig, LQR(rig), frequency=4.0).response(4.0)), 1)
        0.7
        """
        if not is_finite(frequency):
            raise ValueError(f"frequency must be a finite number, in Hz; got {frequency!r}.")
        return (1 - self._decay) / (1 - self._decay * cmath.exp(-2j * math.pi * frequency * self.rig.sample_time))

    def _around(self, n: int, inner: Act) -> Act:
        return _filtered(n, inner, self.rig, lambda force, wanted: wanted + self._decay * (force - wanted))


def _filtered(n: int, inner: Act, rig: Rig, smooth: Callable[[Array, Array], Array]) -> Act:
    """Return a law that goes from its last force towards that of another; a force that is not finite moves nothing."""
    force = np.zeros(n)

    def act(t: float, y: Array) -> Array:
        nonlocal force
        wanted = np.clip(inner(t, y), -rig.force_limit, rig.force_limit)
        force = smooth(force, np.where(np.isfinite(wanted), wanted, force))
        return force.copy()

    return act
