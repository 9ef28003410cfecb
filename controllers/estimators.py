r"""State estimation from encoder positions, delays compensated, in front of any controller.

A rig measures at sample :math:`k` the state of sample :math:`k - d_s`, and the command it is given then takes effect at
sample :math:`k + d_a`.  The estimators here estimate the state at the measured moment and predict it, with the commands
that are under way, to the moment at which the next command takes effect.  So a controller behind them needs to know
nothing of encoders, noise or delay.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Protocol

import numpy as np
import numpy.typing as npt

from dpend.arguments import checked_array
from dpend.controller import Act, Controller, Law
from dpend.laws import finite_rows, log_of, watch, with_logs
from dpend.params import Array
from dpend.rig import Rig, ideal_rig, single_rig
from dpend.state import wrap
from dpend.stepper import Stepper

from .wrapping import Wrapper

Follow = Callable[[Array, Array], Array]
r"""An estimator at work, :math:`\hat x = \mathrm{follow}(y, u)`: measurements ``(n, 6)`` and the commands ``(n,)`` that
were given after the measurements before (not used in the first call), to states ``(n, 6)``."""


class Estimator(Protocol):
    """A description of an estimator, which makes fresh working memory for each run."""

    def follow(self, n: int) -> Follow:
        """Return the estimator for ``n`` runs side by side."""
        ...


class WithEstimator(Wrapper):
    """A controller that sees estimates instead of measurements.

    It takes the controller's commands for those that reach the rig, so it belongs outermost: around
    ``SwitchingController``, ``RateLimit`` or ``LowPass``, not inside.

    Parameters
    ----------
    estimator : Differences, Predictor, EKF or UKF
        Or anything with such a method ``follow``.
    controller : Controller
        Any law.

    Raises
    ------
    TypeError
        If either is something else.

    See Also
    --------
    controllers.EKF : An estimator.
    controllers.Differences : The simplest.

    Examples
    --------
    >>> import dpend
    >>> from controllers import LQR, Differences, WithEstimator
    >>> rig = dpend.rig("gustafsson2016")
    >>> dpend.simulate(rig, WithEstimator(Differences(rig), LQR(rig)), [0, 0.1, -0.1, 0, 0, 0], duration=2.0).success
    True
    """

    def __init__(self, estimator: Estimator, controller: Controller | Law) -> None:
        if isinstance(estimator, type) or not callable(getattr(estimator, "follow", None)):
            raise TypeError(
                f"estimator must be an estimator such as EKF(rig), with a method follow(n); got {estimator!r}."
            )
        self.estimator = estimator
        super().__init__(controller, f"{{}} behind {type(estimator).__name__}")

    def start(self, n: int, rng: np.random.Generator) -> Act:
        """Return the law for ``n`` runs."""
        follow = self.estimator.follow(n)
        inner = self.controller.start(n, rng)
        given = np.zeros(n)
        log, missing_in = watch(n)

        def act(t: float, y: Array) -> Array:
            nonlocal given
            missing_in(y)
            u = inner(t, follow(y, given))
            given = np.where(np.isfinite(u), u, given)
            return u

        return with_logs(act, log, log_of(inner))


class Differences:
    r"""First differences, :math:`\hat v_k = (y_k - y_{k-1})/T`: the rates of an encoder where nothing is estimated.

    The three positions are believed as they are measured, and each rate is the mean over the sample that ended, angles
    by the shorter way round.  The first rates are zero.  Measured rates are not used, noise is multiplied by
    :math:`\sqrt 2/T`, and delays stay.  A row of which a position is missing keeps its last estimate, and the next
    rate is the mean since then.

    Parameters
    ----------
    rig : Rig or str
        Whose sample time is counted with.

    See Also
    --------
    controllers.Predictor : Carry them over a delay.
    controllers.EKF : Estimate instead.

    Examples
    --------
    >>> import dpend
    >>> from controllers import LQR, Differences, WithEstimator
    >>> rig = dpend.rig("gustafsson2016")
    >>> dpend.simulate(rig, WithEstimator(Differences(rig), LQR(rig)), [0, 0.1, -0.1, 0, 0, 0], duration=2.0).success
    True
    """

    def __init__(self, rig: Rig | str) -> None:
        self.rig = single_rig(rig, "Differences")

    def follow(self, n: int) -> Follow:
        """Return the estimator for ``n`` runs.

        Memory lives in the closure, as that of a law does.

        Parameters
        ----------
        n : int
            Number of runs.

        Returns
        -------
        callable
            ``follow(t, y, force)``: measurements ``(n, 6)`` and the forces last commanded to estimates ``(n, 6)``.

        See Also
        --------
        controllers.WithEstimator : Call it.

        Examples
        --------
        >>> import dpend
        >>> from controllers import Differences
        >>> rig = dpend.rig("gustafsson2016")
        >>> callable(Differences(rig).follow(1))
        True
        """
        estimate, seen, samples = np.zeros((n, 6)), np.zeros(n, dtype=np.bool_), np.zeros((n, 1))

        def follow(y: Array, _: Array) -> Array:
            nonlocal samples
            samples = samples + 1
            fresh = finite_rows(y[:, :3])
            positions = np.where(fresh[:, None], y[:, :3], estimate[:, :3])
            moved = positions - estimate[:, :3]
            moved[:, 1:] = wrap(moved[:, 1:])
            rates = np.where(seen[:, None], moved / (samples * self.rig.sample_time), 0.0)
            estimate[fresh] = np.concatenate([positions, rates], axis=1)[fresh]
            samples[fresh] = 0
            seen[fresh] = True
            return estimate.copy()

        return follow


class Predictor:
    r"""Prediction alone: :math:`\hat x_{k + d_a} = \Phi(\dots\Phi(y_k, F_{k - d_s})\dots, F_{k + d_a - 1})`.

    The measurement is believed in all six numbers, and carried over sensor and actuator delay by the plant's own step
    under the commands that are under way.  On a rig that has no other imperfection, and is known, that is exact.  A row
    of which a number is missing is taken to be where the plant's own step leads from the last measurement.

    Parameters
    ----------
    rig : Rig or str
        What is believed: plant, delays, force limit and actuator lag.

    Raises
    ------
    ValueError
        If the rig describes several plants.

    See Also
    --------
    controllers.EKF : With noise and without rates.

    Examples
    --------
    >>> import dpend
    >>> from controllers import LQR, Predictor, WithEstimator
    >>> rig = dpend.rig("gustafsson2016")
    >>> late = rig.replace(sensor_delay=2)
    >>> law = WithEstimator(Predictor(late), LQR(rig))
    >>> dpend.simulate(late, law, [0, 0.1, -0.1, 0, 0, 0], duration=2.0).success
    True
    """

    def __init__(self, rig: Rig | str) -> None:
        self.rig = single_rig(rig, "Predictor")

    def follow(self, n: int) -> Follow:
        """Return the estimator for ``n`` runs.

        Memory lives in the closure, as that of a law does.

        Parameters
        ----------
        n : int
            Number of runs.

        Returns
        -------
        callable
            ``follow(t, y, force)``: measurements ``(n, 6)`` and the forces last commanded to estimates ``(n, 6)``.

        See Also
        --------
        controllers.WithEstimator : Call it.

        Examples
        --------
        >>> import dpend
        >>> from controllers import Predictor
        >>> rig = dpend.rig("gustafsson2016")
        >>> callable(Predictor(rig).follow(1))
        True
        """
        under_way = _UnderWay(self.rig, n)
        model = Stepper(ideal_rig(self.rig), n)
        last = np.zeros((n, 6))

        def follow(y: Array, u: Array) -> Array:
            nonlocal last
            under_way.add(u)
            finite = finite_rows(y)[:, None]
            with np.errstate(all="ignore"):
                if not finite.all():
                    y = np.where(finite, y, _predict(model, last, [under_way.last_before_measured()]))
                last = np.array(y, dtype=np.float64)
                return _predict(model, last, under_way.since_measured())

        return follow


class _Filter:
    r"""What the two Kalman filters share: noises, first guess, the update by the three positions, and the prediction.

    They differ in :meth:`_move`, which carries mean and covariance over one sample.
    """

    def __init__(
        self,
        rig: Rig | str,
        *,
        process_noise: npt.ArrayLike | None = None,
        measurement_noise: npt.ArrayLike | None = None,
        rates_noise: npt.ArrayLike | None = None,
    ) -> None:
        self.rig = single_rig(rig, type(self).__name__)
        c = self.rig.params.coefficients()
        if process_noise is None:
            gravity = float(self.rig.params.gravity)
            process_noise = 0.01 * np.array([float(c.d1) * gravity, float(c.f1), float(c.f2)])
        self.process_noise = _three("process_noise", process_noise, "N, N m and N m, on cart and links")
        self.process_noise[0] = math.hypot(self.process_noise[0], float(self.rig.force_noise))
        if measurement_noise is None:
            noise = np.broadcast_to(self.rig.sensor_noise, 6)[:3]
            step = np.broadcast_to(self.rig.resolution, 6)[:3]
            measurement_noise = np.maximum(np.sqrt(noise**2 + step**2 / 12), 1e-6)
        self.measurement_noise = _three("measurement_noise", measurement_noise, "m, rad and rad")
        if not (self.measurement_noise > 0).all():
            raise ValueError(f"measurement_noise must be greater than 0; got {measurement_noise!r}.")
        if rates_noise is None:
            length = np.array([float(c.length1 + c.length2), float(c.length1), float(c.length2)])
            gravity = max(float(self.rig.params.gravity), 1.0)
            rates_noise = 2 * np.sqrt(gravity / length) * [length[0], 1, 1]
        self.rates_noise = _three("rates_noise", rates_noise, "m/s, rad/s and rad/s")
        for array in (self.process_noise, self.measurement_noise, self.rates_noise):
            array.setflags(write=False)

    def __repr__(self) -> str:
        return (
            f"<{type(self).__name__}, process noise {self.process_noise}, measurement noise {self.measurement_noise}>"
        )

    def follow(self, n: int) -> Follow:
        """Return the estimator for ``n`` runs."""
        follow, _ = self.follow_closely(n)
        return follow

    def follow_closely(self, n: int) -> tuple[Follow, Callable[[], tuple[Array, Array]]]:
        """Return the estimator for ``n`` runs, and ``belief()`` of the moment last measured.

        That returns means ``(n, 6)`` and covariances ``(n, 6, 6)``.
        """
        rig = self.rig
        under_way = _UnderWay(rig, n)
        move = self._move(n)
        model = Stepper(ideal_rig(rig), n)
        first_guess = np.diag(np.concatenate([self.measurement_noise, self.rates_noise]) ** 2)
        mean, covariance = np.zeros((n, 6)), np.tile(first_guess, (n, 1, 1))
        samples = -1
        seen = np.zeros(n, dtype=np.bool_)

        def begin_again(rows: npt.NDArray[np.bool_], measured: Array) -> None:
            mean[rows], covariance[rows] = np.pad(measured[rows], ((0, 0), (0, 3))), first_guess

        def lost() -> npt.NDArray[np.bool_]:
            return ~(np.abs(mean).max(axis=1) < 1e6) | ~(np.abs(covariance).max(axis=(1, 2)) < 1e12)

        def follow(y: Array, u: Array) -> Array:
            nonlocal mean, covariance, samples
            under_way.add(u)
            samples += 1
            there = finite_rows(y[:, :3])
            measured = np.where(there[:, None], y[:, :3], mean[:, :3])
            with np.errstate(all="ignore"):  # what diverges is begun again
                if samples > rig.sensor_delay:  # until then the sensors repeat the first reading
                    mean, covariance = move(mean, covariance, under_way.last_before_measured())
                    begin_again(lost(), measured)  # before numbers without bound are divided by each other
                    predicted = mean, covariance
                    mean, covariance = self._update(mean, covariance, measured)
                    mean[~there], covariance[~there] = predicted[0][~there], predicted[1][~there]
                    begin_again(lost(), measured)
                begin_again(there & ~seen, measured)
                seen[there] = True
                return _predict(model, mean, under_way.since_measured())

        return follow, lambda: (mean.copy(), covariance.copy())

    def _move(self, n: int) -> Callable[[Array, Array, Array], tuple[Array, Array]]:
        """Return what carries means and covariances over one sample under given forces."""
        raise NotImplementedError

    def _update(self, mean: Array, covariance: Array, measured: Array) -> tuple[Array, Array]:
        """Return the belief with the three positions in it, by Joseph's form, which keeps the covariance positive."""
        noise = np.diag(self.measurement_noise**2)
        crossed = covariance[:, :, :3]
        gain = np.linalg.solve(crossed[:, :3] + noise, crossed.transpose(0, 2, 1)).transpose(0, 2, 1)
        innovation = measured - mean[:, :3]
        innovation[:, 1:] = wrap(innovation[:, 1:])  # encoders may count turns or not
        remainder = np.tile(np.eye(6), (len(mean), 1, 1))
        remainder[:, :, :3] -= gain
        mean = mean + np.einsum("nij,nj->ni", gain, innovation)
        updated = remainder @ covariance @ remainder.transpose(0, 2, 1) + gain @ noise @ gain.transpose(0, 2, 1)
        return mean, 0.5 * (updated + updated.transpose(0, 2, 1))


class EKF(_Filter):
    r"""Extended Kalman filter from the three positions: :math:`P^+ = A P A^\top + G\,\mathrm{diag}(\sigma^2)\,G^\top`.

    The mean moves by the plant's own step :math:`\Phi(x, f)`; :math:`A = \partial\Phi/\partial x` and
    :math:`G = \partial\Phi/\partial f` are its derivatives at the mean, by central differences of fourth order.
    Measured rates are not used.  The first measurement is the first guess, with rates zero within ``rates_noise``.
    A row whose estimate is lost, 1e6 of any state away or uncertain by as much, begins again in this way.  Angles are
    measured up to whole turns, and the nearest counts; a row of which a position is missing is predicted only.

    Parameters
    ----------
    rig : Rig or str
        What is believed: plant, delays, force limit, actuator lag, noises and resolution.
    process_noise : array_like (3,), optional
        Standard deviations of a generalised force on cart (N), link 1 and link 2 (N m) that is white from sample to
        sample: what the plant does that the model does not know.  Left out, a hundredth of the weight of everything,
        and of each gravity torque.  The rig's ``force_noise`` comes on top.
    measurement_noise : array_like (3,), optional
        Standard deviations of the measured positions, m and rad.  Left out, the rig's sensor noise together with the
        rounding error of its encoders, :math:`\Delta^2/12`; at least 1e-6.
    rates_noise : array_like (3,), optional
        Standard deviations of the first guess of the rates, m/s and rad/s.  Left out, twice the speed of a fall,
        :math:`\sqrt{g L}` for the cart (both links) and :math:`\sqrt{g/L}` for each link.

    Raises
    ------
    ValueError
        If the rig describes several plants, or a noise has the wrong shape or sign.

    See Also
    --------
    controllers.UKF : The same without derivatives.
    controllers.WithEstimator : A law behind it.

    Notes
    -----
    Source: D. Simon, *Optimal State Estimation*, 2006, section 13.2.

    Examples
    --------
    >>> import dpend
    >>> from controllers import EKF, LQR, WithEstimator
    >>> rig = dpend.rig("gustafsson2016")
    >>> real = rig.replace(resolution=(1e-4, 0.003, 0.003, 0, 0, 0), sensor_delay=1)
    >>> law = WithEstimator(EKF(real), LQR(rig))
    >>> dpend.simulate(real, law, [0, 0.1, -0.1, 0, 0, 0], duration=2.0).success
    True
    """

    def _move(self, n: int) -> Callable[[Array, Array, Array], tuple[Array, Array]]:
        # g'(0) = (8 (g(h) - g(-h)) - (g(2h) - g(-2h))) / 12 h up to h^4; this h balances that against rounding.
        h = 1e-3
        places = h * np.array([1.0, -1.0, 2.0, -2.0])
        weights = np.array([8.0, -8.0, -1.0, 1.0]) / (12 * h)
        points = 1 + 4 * 9
        moved = np.zeros((points, 9))
        moved[1:] = (places[:, None, None] * np.eye(9)).reshape(-1, 9)
        model = Stepper(ideal_rig(self.rig), n * points)
        variance = self.process_noise**2

        def move(mean: Array, covariance: Array, force: Array) -> tuple[Array, Array]:
            model.x[:] = (mean[:, None] + moved[:, :6]).reshape(-1, 6)
            model.step(np.repeat(force, points), np.tile(moved[:, 6:], (n, 1)))
            after = model.x.reshape(n, points, 6)
            slopes = np.einsum("p,npij->nji", weights, after[:, 1:].reshape(n, 4, 9, 6))
            A, G = slopes[:, :, :6], slopes[:, :, 6:]
            return after[:, 0].copy(), A @ covariance @ A.transpose(0, 2, 1) + (G * variance) @ G.transpose(0, 2, 1)

        return move


class UKF(_Filter):
    r"""Unscented Kalman filter from the three positions, with the spherical points of the cubature rule.

    State and unknown force together have nine dimensions; mean and covariance after a sample are those of 18 points,
    one at :math:`\pm\sqrt{9}` standard deviations along each axis, carried over by the plant's own step.  All weights
    are equal and positive, so the covariance stays positive.  The measurement is linear and enters as usual.
    All else is as in :class:`EKF`.

    Parameters
    ----------
    rig : Rig or str
        What is believed, as of :class:`EKF`, also for what is refused.
    process_noise : array_like (3,), optional
        Standard deviations of the unknown force on cart (N), link 1 and link 2 (N m).
    measurement_noise : array_like (3,), optional
        Standard deviations of the measured positions, m and rad.
    rates_noise : array_like (3,), optional
        Standard deviations of the first guess of the rates, m/s and rad/s.

    See Also
    --------
    controllers.EKF : By derivatives.

    Notes
    -----
    Source: S. Julier and J. Uhlmann, *Unscented filtering and nonlinear estimation*, 2004; I. Arasaratnam and
    S. Haykin, *Cubature Kalman filters*, 2009.

    Examples
    --------
    >>> import dpend
    >>> from controllers import LQR, UKF, WithEstimator
    >>> rig = dpend.rig("gustafsson2016")
    >>> real = rig.replace(resolution=(1e-4, 0.003, 0.003, 0, 0, 0), sensor_delay=1)
    >>> law = WithEstimator(UKF(real), LQR(rig))
    >>> dpend.simulate(real, law, [0, 0.1, -0.1, 0, 0, 0], duration=2.0).success
    True
    """

    def _move(self, n: int) -> Callable[[Array, Array, Array], tuple[Array, Array]]:
        model = Stepper(ideal_rig(self.rig), n * 18)
        signs = np.array([1.0, -1.0])

        def move(mean: Array, covariance: Array, force: Array) -> tuple[Array, Array]:
            axes = np.zeros((n, 9, 9))  # rows: half axes of the ellipsoid of one standard deviation
            axes[:, :6, :6] = _root(covariance)
            axes[:, 6:, 6:] = np.diag(self.process_noise)
            points = 3.0 * (signs[:, None, None] * axes[:, None]).reshape(n, 18, 9)
            model.x[:] = (mean[:, None] + points[:, :, :6]).reshape(-1, 6)
            model.step(np.repeat(force, 18), points[:, :, 6:].reshape(-1, 3))
            after = model.x.reshape(n, 18, 6)
            middle = after.mean(axis=1)
            around = after - middle[:, None]
            return middle, around.transpose(0, 2, 1) @ around / 18

        return move


class _UnderWay:
    """The forces on their way to the plant: commands as the rig limits, lags and delays them."""

    def __init__(self, rig: Rig, n: int) -> None:
        self._limit = float(rig.force_limit)
        lag = float(rig.actuator_lag)
        self._decay = math.exp(-rig.sample_time / lag) if lag else 0.0
        self._drive = np.zeros(n)
        self._sensor_delay = int(rig.sensor_delay)
        # Forces of the samples from the one before the measured on, up to the last that a command has reached.
        self._forces: deque[Array] = deque([np.zeros(n) for _ in range(int(rig.actuator_delay))])
        self._sample = -1
        self._before = np.zeros(n)

    def add(self, command: Array) -> None:
        """Add the commands given last, and go on to the next sample."""
        self._sample += 1
        if self._sample == 0:
            return
        limited = np.clip(np.asarray(command, dtype=np.float64), -self._limit, self._limit)
        self._drive = limited + self._decay * (self._drive - limited)
        self._forces.append(self._drive)
        if self._sample > self._sensor_delay:  # the measured moment moves on
            self._before = self._forces.popleft()

    def last_before_measured(self) -> Array:
        """Return the forces of the sample that ends at the moment measured."""
        return self._before

    def since_measured(self) -> list[Array]:
        """Return the forces from the moment measured to the one when the next command takes effect."""
        return list(self._forces)


def _predict(model: Stepper, x: Array, forces: list[Array]) -> Array:
    """Carry states over one sample for each of the forces."""
    if not forces:
        return x.copy()
    model.x[:] = x
    for force in forces:
        model.step(force)
    # What runs away on the way is no better than what was known.
    return np.where(np.isfinite(model.x).all(axis=1, keepdims=True), model.x, x)


def _root(covariance: Array) -> Array:
    """Return matrix whose rows are the half axes of each covariance; one that rounding made negative counts as zero."""
    finite = np.isfinite(covariance).all(axis=(1, 2), keepdims=True)
    squares, axes = np.linalg.eigh(np.where(finite, covariance, np.eye(covariance.shape[-1])))
    root = np.sqrt(np.maximum(squares, 0))[:, :, None] * axes.transpose(0, 2, 1)
    return np.where(finite, root, np.nan)


def _three(name: str, value: npt.ArrayLike, unit: str) -> Array:
    array = checked_array(name, value, f"three, at least 0 ({unit})").copy()
    if array.shape != (3,) or not (array >= 0).all():
        raise ValueError(f"{name} must be three finite numbers, at least 0 ({unit}); got {value!r}.")
    return array
