r"""Smoothing around any controller: a limit on the force's rate, and a first-order low-pass.  Both cost phase."""

from __future__ import annotations

import cmath
import math

import numpy as np

from dpend.arguments import is_finite
from dpend.controller import Act, Controller, check_controller, is_batched
from dpend.rig import Rig, single_rig


class RateLimit:
    r"""Law :math:`u_k = u_{k-1} + \mathrm{clip}(\bar u_k - u_{k-1}, \pm rT)`, :math:`\bar u` the inner law's force.

    The inner force is first limited to what the rig's actuator gives, so that the memory does not run away, and a run
    begins from no force.  So a change of the force by one newton takes :math:`1/r` seconds.

    Parameters
    ----------
    rig : Rig or str
        What the designer believes: sample time :math:`T` and force limit.
    inner : Controller
        The law to be smoothed.
    rate : float
        :math:`r`, N/s, greater than zero.

    Raises
    ------
    TypeError
        If ``inner`` is no controller.
    ValueError
        If the rig describes several plants, or the rate is not greater than zero and finite.

    Notes
    -----
    What it costs: nothing as long as the inner force is slower than :math:`r`, apart from the start.  A sine of
    amplitude :math:`A` and angular frequency :math:`\omega` with :math:`A\omega \ge r\sqrt{1 + \pi^2/4}` comes out as
    a triangle of amplitude :math:`\pi r/2\omega`, late by the phase :math:`\arccos(\pi r/2A\omega)`: up to a quarter
    turn, the more the larger the sine, so that a loop that survives a small disturbance may not survive a large one.
    """

    def __init__(self, rig: Rig | str, inner: Controller, rate: float) -> None:
        self.rig = single_rig(rig, "RateLimit")
        check_controller(inner)
        if not (is_finite(rate) and rate > 0):
            raise ValueError(f"rate must be finite and greater than 0 N/s; got {rate!r}.")
        self.inner = inner
        self.rate = float(rate)
        self.batched = is_batched(inner)
        self.name = f"{_name(inner)}, at most {self.rate:g} N/s"

    def start(self, n: int, rng: np.random.Generator) -> Act:
        """Return the law for ``n`` runs."""
        inner = self.inner.start(n, rng)
        limit = self.rig.force_limit
        most = self.rate * self.rig.sample_time
        force = np.zeros(n)

        def act(t, y):
            nonlocal force
            force = force + np.clip(np.clip(inner(t, y), -limit, limit) - force, -most, most)
            return force.copy()

        return _with_log_of(inner, act)


class LowPass:
    r"""Law :math:`u_k = q\,u_{k-1} + (1 - q)\,\bar u_k`, :math:`q = e^{-T/\tau}`, :math:`\bar u` the inner law's force.

    That is :math:`\tau\dot u = \bar u - u` under a force held over each sample, solved exactly; a sample is given the
    value that the filter has at its end, as the lag of a rig's actuator does.  The inner force is first limited to what
    the rig's actuator gives, and a run begins from no force.

    Parameters
    ----------
    rig : Rig or str
        What the designer believes: sample time :math:`T` and force limit.
    inner : Controller
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
        What the filter costs where it is slowest to tell: slow forces come :math:`Tq/(1 - q)` seconds late, which is a
        little less than :math:`\tau`.  To be compared with the delay that ``LQR(rig).margins()`` allows.

    Raises
    ------
    TypeError
        If ``inner`` is no controller.
    ValueError
        If the rig describes several plants, neither or both of frequency and time constant are given, or one is not
        greater than zero and finite.
    """

    def __init__(
        self,
        rig: Rig | str,
        inner: Controller,
        *,
        frequency: float | None = None,
        time_constant: float | None = None,
    ) -> None:
        self.rig = single_rig(rig, "LowPass")
        check_controller(inner)
        given = {"frequency": (frequency, "Hz"), "time_constant": (time_constant, "s")}
        if (frequency is None) == (time_constant is None):
            raise ValueError("Give frequency, in Hz, or time_constant, in s: one of the two.")
        for name, (value, unit) in given.items():
            if value is not None and not (is_finite(value) and value > 0):
                raise ValueError(f"{name} must be finite and greater than 0 {unit}; got {value!r}.")
        self.inner = inner
        self.time_constant = float(time_constant) if frequency is None else 1 / (2 * math.pi * frequency)  # type: ignore[arg-type]
        self._rest = math.exp(-self.rig.sample_time / self.time_constant)
        self.delay = self.rig.sample_time * self._rest / (1 - self._rest)
        self.batched = is_batched(inner)
        self.name = f"{_name(inner)}, low-pass {1 / (2 * math.pi * self.time_constant):.3g} Hz"

    def response(self, frequency: float) -> complex:
        r"""Return :math:`H = (1 - q)/(1 - q\,e^{-j\omega T})`: what becomes of a sine of the inner force.

        Parameters
        ----------
        frequency : float
            Hz.

        Returns
        -------
        complex
            Its size is the gain, its angle the phase, negative where the force is late.
        """
        return (1 - self._rest) / (1 - self._rest * cmath.exp(-2j * math.pi * frequency * self.rig.sample_time))

    def start(self, n: int, rng: np.random.Generator) -> Act:
        """Return the law for ``n`` runs."""
        inner = self.inner.start(n, rng)
        limit = self.rig.force_limit
        rest = self._rest
        force = np.zeros(n)

        def act(t, y):
            nonlocal force
            wanted = np.clip(inner(t, y), -limit, limit)
            force = wanted + rest * (force - wanted)
            return force.copy()

        return _with_log_of(inner, act)


def _name(controller: Controller) -> str:
    return getattr(controller, "name", type(controller).__name__)


def _with_log_of(inner: Act, act: Act) -> Act:
    """Let a law tell what the law inside it tells."""
    if hasattr(inner, "log"):
        act.log = inner.log  # type: ignore[attr-defined]
    return act
