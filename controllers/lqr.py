r"""The linear-quadratic regulator about an equilibrium, its margins, linear laws of any gain, and the sign of a law."""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve, solve_continuous_are, solve_discrete_are

from dpend.arguments import checked_array, checked_name, checked_positive, is_finite
from dpend.controller import Act, Controller, Law
from dpend.deprecation import renamed_arguments
from dpend.laws import holding, linear_law
from dpend.linear import discretize, linearize
from dpend.params import Array
from dpend.rig import Rig, single_rig
from dpend.state import NAMES, as_equilibrium

from .wrapping import Wrapper


class Margins(NamedTuple):
    r"""How far a sampled loop, cut at the plant's input, is from instability.

    Each is what the loop bears if all else is as it is believed to be.

    Parameters
    ----------
    gain_low, gain_high : float
        Factors between which the gain may change.  The plant is unstable, so too little gain fails like too much.
    phase : float
        Change of phase, either way, that the loop survives, rad.
    disk : float
        :math:`\alpha = \min_\omega |\tfrac12(S - T)|^{-1}`: gain and phase may change together within the balanced
        disk of that size.
    delay, delay_samples : float
        Pure delay between controller and plant that brings the loop to the edge of stability, in s and in samples.

    See Also
    --------
    controllers.LQR.margins : Compute them.

    Notes
    -----
    A gain is searched between 1e-4 and 1e4, a delay up to the time constant of the loop's slowest mode; a margin that
    lies beyond is given as 0 or infinite.

    Examples
    --------
    >>> import dpend
    >>> from controllers import LQR
    >>> rig = dpend.rig("gustafsson2016")
    >>> margins = LQR(rig).margins()
    >>> margins.gain_low < 1 < margins.gain_high
    True
    """

    gain_low: float
    gain_high: float
    phase: float
    disk: float
    delay: float
    delay_samples: float


class LinearLaw:
    r"""Law :math:`u = -K(x - x^*)` of a given gain, which the rig saturates; angles count to the nearest whole turn.

    It is the shortest way to try a gain.

    Parameters
    ----------
    K : array_like (6,) or (1, 6)
        Gain, N per unit of each state.
    target : str or array_like (6,)
        :math:`x^*`: the name of one of ``dpend.EQUILIBRIA``, or such a state with the cart anywhere.

    Raises
    ------
    TypeError, ValueError
        If the gain is not six finite numbers, or ``target`` is no equilibrium.

    See Also
    --------
    controllers.LQR : A gain by design.

    Examples
    --------
    >>> import dpend
    >>> from controllers import LinearLaw
    >>> rig = dpend.rig("gustafsson2016")
    >>> dpend.simulate(rig, LinearLaw([1, -150, 165, 2.5, -7, 29]), [0, 0.1, -0.1, 0, 0, 0], duration=2.0).success
    True
    """

    name = "linear law"

    def __init__(self, K: npt.ArrayLike, *, target: str | npt.ArrayLike = "up-up") -> None:
        gain = checked_array("K", K, "a gain (6,)")
        if gain.shape not in ((6,), (1, 6)):
            raise ValueError(f"K has a number for each of the six states ({', '.join(NAMES)}); got shape {gain.shape}.")
        self.K: Array = gain.reshape(1, 6).copy()
        self.target = as_equilibrium(target)

    def __repr__(self) -> str:
        return f"<{self.name}, K = {np.array2string(self.K[0], precision=4, separator=', ')}>"

    def start(self, n: int, rng: np.random.Generator) -> Act:
        """Return the law for ``n`` runs."""
        return holding(n, linear_law(self.K[0], self.target))


@renamed_arguments(about="target")
class LQR(LinearLaw):
    r"""Law :math:`u = -K(x - x^*)`, minimising :math:`\sum_k \gamma^k ((x_k - x^*)^\top Q (x_k - x^*) + R u_k^2)`.

    The plant is linearized about the equilibrium :math:`x^*` and the design is discrete: the plant is sampled with its
    force held, so the gain is right for the sample time.  Angles are taken to the nearest whole turn, so every upright
    is upright.

    Parameters
    ----------
    rig : Rig or str
        What the designer believes: plant and sample time.  Limits, actuator and sensors do not enter.
    Q : array_like, optional
        State weights, a diagonal ``(6,)`` or a matrix ``(6, 6)``, positive semidefinite; left out, the identity.
    R : float
        Weight of the force, greater than zero.
    target : str or array_like (6,)
        :math:`x^*`: the name of one of ``dpend.EQUILIBRIA``, or such a state with the cart anywhere.
    design : {"discrete", "continuous"}
        ``"continuous"`` minimises :math:`\int x^\top Q x + R u^2\,dt` for a force that may change at any time.  Held
        over a sample such a gain can be too high: with Q = (1, 10, 10, 1, 1, 1), R = 0.01 the loops of the light
        presets ``pilco2011`` and ``dompc_dip`` are unstable, and a warning says so.
    discount : float
        :math:`\gamma`, above 0 and at most 1, which is no discount: the gain is that of
        :math:`\sqrt\gamma A, \sqrt\gamma B`.  The cost of a learner that discounts has this gain, not that of 1.

    Attributes
    ----------
    K : ndarray (1, 6)
        Gain.
    P : ndarray (6, 6)
        Solution of the Riccati equation: :math:`(x_0 - x^*)^\top P (x_0 - x^*)` is the cost from :math:`x_0`.
    target : ndarray (6,)
        :math:`x^*`.
    poles : ndarray (6,)
        Eigenvalues of the sampled closed loop; inside the unit circle where it is stable.

    Raises
    ------
    ValueError
        If the rig describes several plants, a weight has the wrong shape or sign, ``target`` is no equilibrium, or
        there is no stabilising gain.

    See Also
    --------
    controllers.LinearLaw : Of a given gain.
    controllers.SDRE : Redesigned in every state.
    controllers.tuned_law : Chosen by the starts it saves.

    Notes
    -----
    Source: B. Anderson and J. Moore, *Optimal Control: Linear Quadratic Methods*, 1990.

    Examples
    --------
    >>> import dpend
    >>> from controllers import LQR
    >>> rig = dpend.rig("gustafsson2016")
    >>> lqr = LQR(rig, Q=[1, 10, 10, 1, 1, 1], R=0.1)
    >>> bool(abs(lqr.poles).max() < 1)
    True
    """

    name = "LQR"

    def __init__(
        self,
        rig: Rig | str,
        Q: npt.ArrayLike | None = None,
        R: float = 1.0,
        *,
        target: str | npt.ArrayLike = "up-up",
        design: Literal["discrete", "continuous"] = "discrete",
        discount: float = 1.0,
    ) -> None:
        self.rig = rig = single_rig(rig, "LQR")
        self.Q = _weight(Q)
        self.R = checked_positive("R, the weight of the force,", R)
        self.target = as_equilibrium(target)
        checked_name("design", design, ("discrete", "continuous"))
        if not (is_finite(discount) and 0 < discount <= 1):
            raise ValueError(f"discount must be above 0 and at most 1; got {discount!r}.")
        self.discount = float(discount)
        A, B = self._plant = linearize(rig.params, self.target)
        self._Ad, self._Bd = map(np.ascontiguousarray, discretize(A, B, rig.sample_time))
        try:
            # scipy's solvers, which python-control calls as well: to import that takes three times as long as all else.
            if design == "discrete":
                Ad, Bd = np.sqrt(self.discount) * self._Ad, np.sqrt(self.discount) * self._Bd
                P = solve_discrete_are(Ad, Bd, self.Q, [[self.R]])
                K = solve(Bd.T @ P @ Bd + self.R, Bd.T @ P @ Ad)
                slowest = np.abs(np.linalg.eigvals(self._Ad - self._Bd @ K)).max() - 1
            else:
                decay = 0.5 * math.log(self.discount) / rig.sample_time
                P = solve_continuous_are(A + decay * np.eye(6), B, self.Q, [[self.R]])
                K = B.T @ P / self.R
                slowest = np.linalg.eigvals(A - B @ K).real.max()
            if slowest > -1e-10:  # the solver does not refuse an integrator that no weight sees
                raise np.linalg.LinAlgError("a mode of the loop does not decay")
        except (np.linalg.LinAlgError, ValueError) as error:
            raise ValueError(
                f"There is no stabilising solution of the Riccati equation for these weights ({error}); "
                "let Q weigh every state that is to come to rest"
                f"{', or raise the discount' * (self.discount < 1)}."
            ) from error
        self.K = np.asarray(K, dtype=np.float64).reshape(1, 6)
        self.P: Array = np.asarray(P, dtype=np.float64)
        self.poles = np.linalg.eigvals(self._Ad - self._Bd @ self.K)
        radius = float(np.abs(self.poles).max())
        if design == "continuous" and radius >= 1:
            warnings.warn(
                f"This continuous-time gain, held over {rig.sample_time:g} s, gives an unstable loop "
                f'(spectral radius {radius:.3f}); use design="discrete".',
                stacklevel=3,
            )
        for array in (self.Q, self.K, self.P, self.poles):
            array.setflags(write=False)

    def margins(self) -> Margins:
        """Return the margins of the sampled loop :math:`L(z) = K(zI - A_d)^{-1}B_d`.

        They say how wrong the model of the linear loop may be.

        Returns
        -------
        Margins
            Of gain, phase, both together, and delay.

        Raises
        ------
        ValueError
            If the loop is unstable, and so has no margins.

        See Also
        --------
        controllers.Margins : What comes back.

        Examples
        --------
        >>> import dpend
        >>> from controllers import LQR
        >>> rig = dpend.rig("gustafsson2016")
        >>> round(LQR(rig).margins().delay_samples, 1)
        2.1
        """
        import control  # which imports matplotlib

        radius = float(np.abs(self.poles).max())
        if radius >= 1:
            raise ValueError(f"The sampled loop is unstable (spectral radius {radius:.3f}): it has no margins.")
        T = self.rig.sample_time
        loop = control.ss(self._Ad, self._Bd, self.K, 0, T)
        slowest = float(np.abs(np.log(self.poles.astype(np.complex128))).min()) / T  # rad/s
        omega = np.geomspace(min(1e-2 * slowest, 1e-3 * np.pi / T), np.pi / T * (1 - 1e-9), 4000)
        sizes = control.disk_margins(loop, omega, returnall=True)[0]
        worst = int(np.argmin(sizes))
        around = omega[max(worst - 1, 0)], omega[min(worst + 1, len(omega) - 1)]
        delay = _first_exit(self._radius_with_delay, np.linspace(0, 1 / slowest, 2001))
        return Margins(
            gain_low=_first_exit(self._radius_with_gain, np.geomspace(1, 1e-4, 400), never=0.0),
            gain_high=_first_exit(self._radius_with_gain, np.geomspace(1, 1e4, 400)),
            phase=_first_exit(lambda phase: self._radius_with_gain(np.exp(-1j * phase)), np.linspace(0, np.pi, 400)),
            disk=float(control.disk_margins(loop, np.linspace(*around, 400))[0]),
            delay=delay,
            delay_samples=delay / T,
        )

    def _radius_with_gain(self, gain: complex) -> float:
        """Spectral radius of the sampled loop with its gain multiplied by a real or complex number."""
        return _radius(self._Ad - gain * (self._Bd @ self.K))

    def _radius_with_delay(self, delay: float) -> float:
        """Spectral radius of the sampled loop with a delay in s: the states, and the commands under way."""
        T = self.rig.sample_time
        samples = delay / T
        queue = math.ceil(samples)  # commands of the last so many samples are still of interest
        late = (samples - queue + 1) * T if queue else 0.0  # the older of two acts for so long in a sample
        _, newer = discretize(*self._plant, T - late) if late < T else (0, np.zeros((6, 1)))
        whole, _ = discretize(*self._plant, T)
        loop = np.zeros((6 + queue, 6 + queue))
        loop[:6, :6] = whole
        if queue == 0:
            return _radius(whole - newer @ self.K)
        loop[:6, 6:7] = self._Bd - newer  # the oldest command in the queue
        if queue == 1:
            loop[:6, :6] -= newer @ self.K
        else:
            loop[:6, 7:8] = newer
        loop[6:-1, 7:] = np.eye(queue - 1)
        loop[-1, :6] = -self.K[0]
        return _radius(loop)


def _radius(A: npt.NDArray[Any]) -> float:
    return float(np.abs(np.linalg.eigvals(A)).max())


def _first_exit(radius: Callable[[float], float], path: Array, never: float = np.inf) -> float:
    """Return where, along a path that begins stable, the spectral radius first reaches one."""
    from scipy.optimize import brentq

    for inside, outside in itertools.pairwise(path):
        if radius(outside) >= 1:
            edge: Any = brentq(lambda point: radius(point) - 1, inside, outside, xtol=1e-12)
            return float(edge)
    return never


def _weight(Q: npt.ArrayLike | None) -> Array:
    what = "a diagonal (6,) or a matrix (6, 6)"
    weight = np.eye(6) if Q is None else checked_array("Q", Q, what).copy()
    if weight.shape == (6,):
        weight = np.diag(weight)
    if weight.shape != (6, 6):
        raise ValueError(f"Q weighs the six states ({', '.join(NAMES)}): expected {what}; got shape {weight.shape}.")
    if not np.allclose(weight, weight.T):
        raise ValueError("Q must be symmetric.")
    least = float(np.linalg.eigvalsh(weight).min())
    if least < -1e-9 * np.abs(weight).max(initial=1.0):
        raise ValueError(f"Q must be positive semidefinite; its least eigenvalue is {least:g}.")
    return weight


@renamed_arguments(inner="controller")
class BangBang(Wrapper):
    r"""The sign of another law, :math:`u = F\,\mathrm{sgn}(\bar u)`, :math:`\bar u` the wrapped law's force.

    It is what a learner can express whose features are linear in the action.

    Parameters
    ----------
    controller : Controller
        The law whose sign is taken; any state feedback.
    force : float
        :math:`F`, N, greater than zero and finite.

    Raises
    ------
    TypeError
        If ``controller`` is none.
    ValueError
        If the force is not greater than zero or not finite.

    See Also
    --------
    controllers.tuned_law : Whose ``"sign"`` is one of its kind.

    Examples
    --------
    >>> import dpend
    >>> from controllers import LQR, BangBang
    >>> rig = dpend.rig("gustafsson2016")
    >>> law = BangBang(LQR(rig, Q=[1, 10, 10, 1, 1, 1], R=0.1), 40.0)
    >>> dpend.simulate(rig, law, [0, 0.1, -0.1, 0, 0, 0], duration=2.0).success
    True
    """

    def __init__(self, controller: Controller | Law, force: float) -> None:
        super().__init__(controller, "sign of {}")
        self.force = checked_positive("force", force, "N")

    def _around(self, n: int, inner: Act) -> Act:
        return lambda t, y: self.force * np.sign(inner(t, y))
