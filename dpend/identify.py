r"""A rig's parameters from its recorded motion: output-error least squares over short segments.

The motion is cut into segments.  Each has an initial state of its own, unknown and of no interest; all have the
parameters in common.  With :math:`h_j` the simulated output of sample :math:`j` under the recorded force,

.. math:: \min_{p,\,x_1,\dots,x_S}\;\sum_{i=1}^S\sum_j
    \bigl\|\Sigma^{-1/2}\bigl(h_j(p, x_i) - y_{ij}\bigr)\bigr\|^2

is the maximum-likelihood estimate for sensors with independent normal noise of covariance :math:`\Sigma`, diagonal and
estimated along with it.  No measurement is differentiated, and the errors of the model do not pile up over a run.
The initial states are eliminated from the problem before it is solved (variable projection), so any number of
segments costs the solver no more than one.
"""

from __future__ import annotations

import math
import reprlib
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .arguments import checked_flag, is_finite
from .params import Array, Number, Params
from .recording import fitted_rates
from .rig import Rig
from .run import Run, Runs
from .state import NAMES
from .stepper import Stepper
from .suggest import suggestion

OUTPUTS = ("pos", "th1", "th2")

_FITTABLE = (
    "cart_mass",
    "mass1",
    "mass2",
    "length1",
    "length2",
    "com1",
    "com2",
    "inertia1",
    "inertia2",
    "cart_friction",
    "joint1_friction",
    "joint2_friction",
    "cart_coulomb",
    "gravity",
)
_MAY_VANISH = {"cart_friction", "joint1_friction", "joint2_friction", "cart_coulomb"}
_STATE_STEP = 1e-5
_LOG_STEP = 1e-5
_STEP = 1e-4
_DEPENDENT = 1e-6  # singular values below this share of the largest are zero but for rounding
_GROWTH = 1e3  # a state's error may grow so much within a segment before it is no longer small
_MISFIT = 0.5  # an autocorrelation of the residuals at which the model is said to lack something
_ROUNDING = 1e-8  # what is left below this, in m or rad, is the arithmetic's
_FAR_BETTER = 0.25  # a share of the squares left at which another sign is the right one
_HELD = 1e6  # times its mass, a cart does not move
_UNKNOWN = 1.0  # a standard error, as a share of the value, at which a parameter counts as not seen


@dataclass(frozen=True, kw_only=True, eq=False)
class Identified:
    r"""Parameters that motion was found to have, and how far they can be trusted.

    Printed, it is a table of values, standard errors and intervals.

    Parameters
    ----------
    params : Params
        The plant: the start's parameters with the fitted ones changed.
    values : mapping of str to float
        The fitted ones, SI units.
    errors : mapping of str to float
        Their standard errors, in the same units.
    intervals : mapping of str to (float, float)
        Their 95 % confidence intervals: of the logarithm where a parameter is greater than zero by nature, cut off at
        zero for frictions.
    correlation : ndarray (p, p)
        Correlation of the estimates, in the order of ``values``.
    noise : mapping of str to float
        Standard deviation of what the model leaves of each output, m or rad.
    autocorrelation : mapping of str to float
        Correlation of the residuals with those one sample later: near zero (or a little below, since each segment's
        state is fitted) where the model explains the motion.  Well above zero something is missing from the model,
        and the intervals are too narrow.
    residuals : ndarray (S, L, len(outputs))
        Simulated less measured outputs of ``S`` segments of ``L`` samples, m and rad.

    See Also
    --------
    dpend.identify : Find them.

    Examples
    --------
    >>> import dpend
    >>> rig = dpend.rig("gustafsson2016")
    >>> run = dpend.simulate(rig, lambda t, x: 0.0, [0, 3.0, 3.3, 0, 0, 0], duration=2.0, task=None)
    >>> found = dpend.identify(run, rig, ["mass1"])
    >>> round(found.values["mass1"], 3)
    0.5
    """

    params: Params
    values: Mapping[str, float]
    errors: Mapping[str, float]
    intervals: Mapping[str, tuple[float, float]]
    correlation: Array
    noise: Mapping[str, float]
    autocorrelation: Mapping[str, float]
    residuals: Array

    def __str__(self) -> str:
        lines = [f"{'parameter':<16}{'value':>11}{'std error':>11}   95 % interval"]
        for name, value in self.values.items():
            low, high = self.intervals[name]
            lines.append(f"{name:<16}{value:>11.5g}{self.errors[name]:>11.2g}   [{low:.5g}, {high:.5g}]")
        for name, std in self.noise.items():
            lines.append(f"left of {name:<8}{std:>11.3g}   autocorrelation {self.autocorrelation[name]:+.2f}")
        return "\n".join(lines)


def identify(
    runs: Run | Runs | Iterable[Run],
    start: Params | Rig,
    fit: Sequence[str],
    *,
    segment: float = 0.5,
    outputs: Sequence[str] = OUTPUTS,
    clamped: bool = False,
) -> Identified:
    r"""Return the parameters :math:`\hat p = \arg\min\sum\|\Sigma^{-1/2}(h(p, x_i) - y_i)\|^2` behind recorded runs.

    The simulated outputs come from the plant that simulations run on, under the recorded (applied) forces.  Parameters
    that are greater than zero by nature are fitted as logarithms.  Where the runs' rig has a sensor delay, measurements
    are taken for that much older.

    Parameters
    ----------
    runs : Run, Runs or iterable of Run
        What was recorded, such as by ``Run.from_csv``; runs with their states.
    start : Params or Rig
        The plant as it is known so far: where the search begins, and what keeps its value.
    fit : sequence of str
        Names of the fields of :class:`dpend.Params` to find.
    segment : float
        Length of a segment, s.  Shorter ones forgive disturbances that were not recorded, longer ones show slow
        effects, such as friction, better.
    outputs : sequence of str
        What was measured with independent noise, of ``dpend.NAMES``; rates that were derived from positions do not
        belong here.
    clamped : bool
        Whether the cart was held fast, so that only the links say something; its position is then no output.

    Returns
    -------
    Identified
        ``start.replace(params=found.params)`` is then the rig.

    Raises
    ------
    TypeError
        If ``runs`` or ``start`` is something else.
    ValueError
        If there is no such parameter or output, the runs hold no states, have different sample times, are shorter than
        a segment or run away within one; or if the data do not determine the parameters, which the message names, with
        the remedy.  Where the motion fits far better with another sign of force or coordinate, it names that.
    RuntimeError
        If the search does not converge.

    Warns
    -----
    UserWarning
        If what the model leaves is no noise, so that the intervals are too narrow.

    See Also
    --------
    dpend.Run.from_csv : Read a recording.
    dpend.Identified : What comes back.

    Notes
    -----
    Standard errors come from the Jacobian at the solution, with the initial states eliminated:
    :math:`(J^\top P J)^{-1}`, :math:`P` the projector off the initial states' columns.  Each output's variance is the
    sum of its squared residuals over the degrees of freedom that the fit leaves it.

    Sources: L. Ljung, *System Identification*, 1999, chapter 7; G. Golub and V. Pereyra, *Separable nonlinear least
    squares*, 2003; H. Bock, *Recent advances in parameter identification techniques for O.D.E.*, 1983.

    Examples
    --------
    >>> import dpend
    >>> rig = dpend.rig("gustafsson2016")
    >>> run = dpend.simulate(rig, lambda t, x: 0.0, [0, 3.0, 3.3, 0, 0, 0], duration=2.0, task=None)
    >>> found = dpend.identify(run, rig.replace(mass1=0.6), ["mass1"])
    >>> round(found.values["mass1"], 3)
    0.5
    """
    from scipy.stats import t as student  # kept out of `import dpend`

    rig = start if isinstance(start, Rig) else None
    params = start.params if isinstance(start, Rig) else start
    if not isinstance(params, Params):
        raise TypeError(f"start must be dpend.Params or a dpend.Rig; got {type(start).__name__}.")
    plant = params
    names = _checked_names(fit, params)
    seen = _checked_outputs(outputs)
    if checked_flag("clamped", clamped):  # a cart so heavy that no link moves it
        seen = tuple(name for name in seen if name not in ("pos", "vel"))
        params = replace(params, cart_mass=_HELD * float(params.cart_mass))
    data = _Segments.cut(runs, segment, seen, None if rig is None else rig.substeps)
    if not clamped and not np.ptp(data.x0[:, 0]) and not data.y[..., [p == 0 for p in data.places]].any():
        raise ValueError("The cart never moves; if it was held fast, give clamped=True.")
    problem = _Problem(data, params, names)
    try:
        z, weights, covariance = _fitted(problem)
    except (ValueError, RuntimeError) as refusal:
        sign = _better_sign(problem)
        if not sign:
            raise
        raise ValueError(f"The motion stays unexplained: {sign} As it is: {refusal}") from refusal
    errors = np.sqrt(np.diag(covariance))

    residuals = problem.residuals(z, weights)
    freedom = residuals.size - 6 * data.count - len(names)
    half = float(student.ppf(0.975, freedom)) * errors
    values, low, high = (problem.values(each) for each in (z, z - half, z + half))
    std = {n: float(e) if n in _MAY_VANISH else values[n] * float(e) for n, e in zip(names, errors, strict=True)}
    left = 1 / weights
    repeated = {name: _autocorrelation(residuals[:, :, i]) for i, name in enumerate(seen)}
    lacking = [n for n, std in zip(seen, left, strict=True) if repeated[n] > _MISFIT and std > _ROUNDING]
    if lacking:
        sign = _better_sign(problem)
        warnings.warn(
            f"What the model leaves of {_listed(lacking)} is no noise (autocorrelation "
            f"{max(repeated.values()):.2f}): something is missing from fit or wrong in start, or a delay or a unit is. "
            f"{sign[:1].upper()}{sign[1:]}{' ' if sign else ''}The intervals are too narrow.",
            stacklevel=2,
        )
    return Identified(
        params=replace(plant, **values),
        values=values,
        errors=std,
        intervals={name: (low[name], high[name]) for name in names},
        correlation=covariance / np.outer(errors, errors),
        noise={name: float(each) for name, each in zip(seen, left, strict=True)},
        autocorrelation=repeated,
        residuals=residuals,
    )


# ---------------------------------------------------------------------------------------------------------- the problem


@dataclass(frozen=True, kw_only=True)
class _Segments:
    """``S`` pieces of ``L`` samples: forces ``(S, L - 1)``, outputs ``(S, L, m)``, guesses of states ``(S, 6)``."""

    u: Array
    y: Array
    x0: Array
    places: list[int]
    rig: Rig

    @property
    def count(self) -> int:
        return len(self.u)

    @property
    def seconds(self) -> float:
        """Length of a segment."""
        return self.u.shape[1] * self.rig.sample_time

    @classmethod
    def cut(cls, runs: object, seconds: float, outputs: tuple[str, ...], substeps: int | None) -> _Segments:
        """Cut runs into segments that share their first and last samples with no other."""
        records: list[Run] = []
        for record in [runs] if isinstance(runs, Run | np.ndarray) or not isinstance(runs, Iterable) else runs:
            if not isinstance(record, Run):
                raise TypeError(f"runs must be dpend.Run, dpend.Runs or several Run; got {type(record).__name__}.")
            records.append(record)
        if not records:
            raise ValueError("There are no runs; expected at least one.")
        sample_times = sorted({record.rig.sample_time for record in records})
        if len(sample_times) > 1:
            raise ValueError(f"All runs must have one sample time; got {', '.join(f'{h:g} s' for h in sample_times)}.")
        h = sample_times[0]
        length = round(seconds / h) + 1 if is_finite(seconds) else 0
        if length * len(outputs) <= 6 + len(outputs):
            raise ValueError(
                f"A segment must hold more than the six numbers of its initial state: expected segment to be several "
                f"samples of {h:g} s; got {seconds!r} s."
            )
        places = [NAMES.index(name) for name in outputs]
        forces, measured, guesses = [], [], []
        for record in records:
            late = int(record.rig.sensor_delay)
            y, u = record.y[late:], record.u[: len(record.u) - late]
            smooth = np.stack([fitted_rates(y[:, i], h) for i in range(3)], axis=1) if len(y) > 1 else y[:, :3]
            for first in range(0, len(y) - length + 1, length):
                forces.append(u[first : first + length - 1])
                measured.append(y[first : first + length][:, places])
                guesses.append(np.concatenate([y[first, :3], smooth[first]]))
        if not forces:
            longest = max(record.t[-1] for record in records)
            raise ValueError(f"The longest run lasts {longest:g} s, shorter than one segment of {seconds:g} s.")
        u, y = np.stack(forces), np.stack(measured)
        if not (np.isfinite(u).all() and np.isfinite(y).all()):
            raise ValueError("Forces and outputs must be finite; cut the runs before what is not.")
        first = records[0].rig
        plain = Rig(params=first.params, sample_time=h, substeps=substeps or first.substeps)
        return cls(u=u, y=y, x0=np.stack(guesses), places=places, rig=plain)


class _Problem:
    """The least-squares problem in the parameters alone: for each ``z`` the segments' best initial states are found."""

    def __init__(self, data: _Segments, params: Params, names: tuple[str, ...]) -> None:
        self.data = data
        self.params = params
        self.names = names
        self.logarithm = np.array([name not in _MAY_VANISH for name in names])
        begin = np.array([_value(params, name) for name in names])
        with np.errstate(divide="ignore", invalid="ignore"):
            self.start = np.where(self.logarithm, np.log(begin), begin)
        self.bounds = (
            np.where(self.logarithm, self.start - 5.0, 0.0),
            np.where(self.logarithm, self.start + 5.0, np.inf),
        )
        self._x0 = data.x0.copy()
        self._kept: tuple[bytes, tuple[Array, Array, Array, Array]] | None = None

    def values(self, z: Array) -> dict[str, float]:
        """Return the parameters by name."""
        numbers = np.where(self.logarithm, np.exp(np.where(self.logarithm, z, 0.0)), np.maximum(z, 0.0))
        return {name: float(number) for name, number in zip(self.names, numbers, strict=True)}

    def reduced(self, z: Array, weights: Array) -> tuple[Array, Array]:
        """Return residuals at the best initial states, and their Jacobian with these states eliminated (Kaufman's)."""
        residuals, _, basis, by_params = self._solved(z, weights)
        left = by_params - basis @ (basis.transpose(0, 2, 1) @ by_params)
        return residuals.ravel(), left.reshape(-1, len(self.names))

    def residuals(self, z: Array, weights: Array) -> Array:
        """Return simulated less measured outputs ``(S, L, m)``, in their units."""
        return self._solved(z, weights)[0].reshape(self.data.y.shape) / weights

    def noise(self, z: Array, weights: Array) -> Array:
        """Return each output's standard deviation: squares over what the fit leaves of their number."""
        residuals, _, basis, _ = self._solved(z, weights)
        _, jacobian = self.reduced(z, weights)
        leverage = (basis**2).sum(axis=2).ravel() + (np.linalg.qr(jacobian)[0] ** 2).sum(axis=1)
        m = len(weights)
        squares = (residuals.reshape(-1, m) / weights) ** 2
        freedom = (1 - leverage.reshape(-1, m)).sum(axis=0)
        # outputs without any noise at all keep a weight that is a number
        return np.maximum(np.sqrt(squares.sum(axis=0) / freedom), 1e-12)

    def _solved(self, z: Array, weights: Array) -> tuple[Array, Array, Array, Array]:
        """Return weighted residuals ``(S, L m)``, initial states, a basis of their effect, and Jacobian."""
        key = z.tobytes() + weights.tobytes()
        if self._kept is None or self._kept[0] != key:
            self._kept = key, self._solve(z, weights)
        return self._kept[1]

    def _solve(self, z: Array, weights: Array) -> tuple[Array, Array, Array, Array]:
        """Find the initial states by Gauss-Newton, each segment for itself."""
        x0 = self._x0.copy()
        params = self._plants(z[None])
        residuals, by_state = self._by_state(x0, params, weights)
        cost = (residuals**2).sum(axis=1)
        if not np.isfinite(cost).all():
            raise ValueError(
                "From the states measured the plant runs away beyond all numbers: are the units right (radians, "
                "metres, newtons), and the start anywhere near?"
            )
        damping = np.full(len(x0), 1e-9)
        for _ in range(30):
            gram = by_state.transpose(0, 2, 1) @ by_state
            slope = (by_state.transpose(0, 2, 1) @ residuals[:, :, None])[:, :, 0]
            size = np.einsum("ijj->ij", gram)
            gram = gram + np.einsum("i,ij,jk->ijk", damping, size + 1e-12, np.eye(6))
            step = -np.linalg.solve(gram, slope[:, :, None])[:, :, 0]
            gain = -(slope * step).sum(axis=1)  # what a linear segment would gain, twice
            if np.all(gain <= 1e-14 * (cost + 1e-300) + 1e-24):
                break
            tried = x0 + np.where(np.isfinite(step).all(axis=1, keepdims=True), step, 0.0)
            new, new_by_state = self._by_state(tried, params, weights)
            new_cost = (new**2).sum(axis=1)
            better = new_cost <= cost
            x0[better], residuals[better], by_state[better] = tried[better], new[better], new_by_state[better]
            stuck = ~better & (gain <= 1e-9 * cost)  # rounding decides here
            damping = np.where(better | stuck, np.maximum(damping / 10, 1e-9), np.minimum(damping * 100, 1e6))
            if np.all(stuck | (better & (cost - new_cost <= 1e-13 * cost))):
                break
            cost = np.where(better, new_cost, cost)
        growth = float(np.abs(by_state / np.tile(weights, self.data.y.shape[1])[:, None]).max())
        if growth > _GROWTH:
            raise ValueError(
                f"Within a segment an error of the state grows {growth:.0f} times, more than the {_GROWTH:.0f} up to "
                f"which the search can follow: make segment shorter than {self.data.seconds:g} s."
            )
        self._x0 = x0  # a good beginning for the next parameters
        basis = np.linalg.qr(by_state)[0]
        return residuals, x0, basis, self._by_params(z, x0, weights)

    def _plants(self, points: Array) -> Params:
        """Return the plants of several points ``(k, p)``: single numbers for one, arrays for more."""
        rows = [self.values(point) for point in points]
        if len(rows) == 1:
            return replace(self.params, **rows[0])
        return replace(self.params, **{name: np.array([row[name] for row in rows]) for name in self.names})

    def _simulated(self, x0: Array, params: Params, copies: int) -> Array:
        """Return outputs ``(copies, S, L m)`` from states ``(copies S, 6)``, one plant for all or one for each copy."""
        data = self.data
        if params.n is not None:
            copied = {k: np.repeat(v, data.count) for k, v in params.to_dict().items() if isinstance(v, np.ndarray)}
            params = replace(params, **copied)
        stepper = Stepper(data.rig.replace(params=params), len(x0))
        stepper.reset(x0)
        samples = data.y.shape[1]
        outputs = np.empty((len(x0), samples, len(data.places)))
        outputs[:, 0] = x0[:, data.places]
        for k in range(samples - 1):
            stepper.step(np.tile(data.u[:, k], copies))
            outputs[:, k + 1] = stepper.x[:, data.places]
        return outputs.reshape(copies, data.count, -1)

    def _by_state(self, x0: Array, params: Params, weights: Array) -> tuple[Array, Array]:
        """Return weighted residuals ``(S, L m)`` and their derivatives by the initial states ``(S, L m, 6)``."""
        moves = np.vstack([np.zeros((1, 6)), _STATE_STEP * np.eye(6), -_STATE_STEP * np.eye(6)])
        outputs = self._simulated((x0[None] + moves[:, None]).reshape(-1, 6), params, 13)
        weight = np.tile(weights, self.data.y.shape[1])
        residuals = weight * (outputs[0] - self.data.y.reshape(self.data.count, -1))
        with np.errstate(invalid="ignore"):  # what ran away is refused by its residuals
            slopes = weight * (outputs[1:7] - outputs[7:]) / (2 * _STATE_STEP)
        return residuals, slopes.transpose(1, 2, 0)

    def _by_params(self, z: Array, x0: Array, weights: Array) -> Array:
        """Return the derivatives of the weighted residuals by the parameters ``(S, L m, p)``.

        Central differences; forward ones, to the same order, for what must not fall below zero.
        """
        p = len(z)
        step = np.where(self.logarithm, _LOG_STEP, _STEP)
        one = z + np.diag(step)
        other = z + np.diag(np.where(self.logarithm, -step, 2 * step))
        outputs = self._simulated(np.tile(x0, (2 * p + 1, 1)), self._plants(np.vstack([z, one, other])), 2 * p + 1)
        here, first, second = outputs[0], outputs[1 : p + 1], outputs[p + 1 :]
        central = (first - second) / (2 * step[:, None, None])
        forward = (4 * first - 3 * here - second) / (2 * step[:, None, None])
        slopes = np.where(self.logarithm[:, None, None], central, forward)
        return (np.tile(weights, self.data.y.shape[1]) * slopes).transpose(1, 2, 0)


def _search(problem: _Problem, z: Array, weights: Array, most: int) -> Any:
    from scipy.optimize import least_squares  # kept out of `import dpend`

    return least_squares(
        lambda z: problem.reduced(z, weights)[0],
        z,
        jac=lambda z: problem.reduced(z, weights)[1],  # pyright: ignore[reportArgumentType]
        bounds=problem.bounds,
        x_scale="jac",
        xtol=1e-9,
        ftol=1e-10,
        gtol=1e-10,
        max_nfev=most,
    )


def _fitted(problem: _Problem) -> tuple[Array, Array, Array]:
    """Return the solution, the outputs' weights there, and the covariance; refuse what the data do not determine."""
    names, data, z = problem.names, problem.data, problem.start
    weights = np.ones(len(data.places))
    _require_rank(problem.reduced(z, weights)[1], names, data)
    for _ in range(3):  # the outputs' noises settle in two rounds; the third is the solution
        found = _search(problem, z, weights, 100)
        if found.status == 0:
            raise RuntimeError(
                "The search did not converge within 100 steps: start nearer, fit fewer parameters at first, or shorten "
                "the segments."
            )
        z = found.x
        weights = 1 / problem.noise(z, weights)
    _, jacobian = problem.reduced(z, weights)
    _require_rank(jacobian, names, data)
    covariance: Array = np.asarray(np.linalg.inv(jacobian.T @ jacobian), dtype=np.float64)
    _require_sight(np.sqrt(np.diag(covariance)), names, data)
    return z, weights, covariance


# What may have been read with the wrong sign, the argument of Run.from_csv to look at, what that does to the positions,
# and to the force.  The mirror image of each is as good, so the three others of two kinds need no lines of their own.
_SIGNS: tuple[tuple[str, str, Array, float], ...] = (
    ("u", "force_unit", np.eye(3), -1.0),
    ("pos", "position_unit", np.diag([-1.0, 1.0, 1.0]), 1.0),
    ("th1", "angle_unit", np.diag([1.0, -1.0, 1.0]), 1.0),
    ("th2", "angle_unit", np.diag([1.0, 1.0, -1.0]), 1.0),
    ("th2 against th1", "angle_unit", np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 2.0, -1.0]]), 1.0),
    (
        "th1, from which th2 is counted,",
        "angle_unit",
        np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, -2.0, 1.0]]),
        1.0,
    ),
    ("u and pos", "force_unit and position_unit", np.diag([-1.0, 1.0, 1.0]), -1.0),
    ("u and th1", "force_unit and angle_unit", np.diag([1.0, -1.0, 1.0]), -1.0),
    ("u and th2", "force_unit and angle_unit", np.diag([1.0, 1.0, -1.0]), -1.0),
)


def _better_sign(problem: _Problem) -> str:
    """Return which signs, turned round, explain the motion far better; nothing where none do."""
    data = problem.data
    weights = 1 / np.maximum(data.y.std(axis=(0, 1)), 1e-9)

    def left(turn: Array, force: float) -> float:
        """Return the squares that a short search leaves of the data with their signs turned."""
        state = np.kron(np.eye(2), turn)
        y = data.y @ state[np.ix_(data.places, data.places)].T
        turned = replace(data, u=force * data.u, y=y, x0=data.x0 @ state.T)
        try:
            tried = _Problem(turned, problem.params, problem.names)
            return float(_search(tried, tried.start, weights, 10).cost)
        except (ValueError, np.linalg.LinAlgError):
            return math.inf

    costs = [left(turn, force) for _, _, turn, force in _SIGNS]
    if not min(costs) < _FAR_BETTER * left(np.eye(3), 1.0):
        return ""
    what, argument, *_ = next(sign for sign, cost in zip(_SIGNS, costs, strict=True) if cost <= 1.05 * min(costs))
    return (
        f"with the sign of {what} turned round the model fits far better; look at the sign of {argument} in "
        "Run.from_csv."
    )


# ----------------------------------------------------------------------------------------------- what can be identified


def _require_rank(jacobian: Array, names: tuple[str, ...], data: _Segments) -> None:
    """Refuse parameters that the data do not determine, or not separately: null directions of the scaled Jacobian."""
    from scipy.linalg import qr  # kept out of `import dpend`

    sizes = np.linalg.norm(jacobian, axis=0)
    unseen = [name for name, size in zip(names, sizes, strict=True) if size <= 1e-9 * sizes.max(initial=1e-30)]
    if unseen:
        raise ValueError(
            f"Nothing in the data depends on {_listed(unseen)}; leave {'it' if len(unseen) == 1 else 'them'} out of fit"
            f"{_excite(data)}."
        )
    _, singular, directions = np.linalg.svd(jacobian / sizes, full_matrices=False)
    null = directions[singular < _DEPENDENT * singular[0]]
    if len(null):
        involved = np.sqrt((null**2).sum(axis=0))
        mixed = [name for name, share in zip(names, involved, strict=True) if share > 0.05]
        # what must be known for the others to follow comes first
        order = qr(null, pivoting=True, mode="r")[1]  # pyright: ignore[reportGeneralTypeIssues]
        fixed = [names[i] for i in sorted(order[: len(null)])]
        raise ValueError(
            f"The data cannot tell {_listed(mixed)} apart: they can change together and leave the motion as it is. "
            f"Fix {len(null)} of them, as by leaving {_listed(fixed)} out of fit{_excite(data)}."
        )


def _require_sight(errors: Array, names: tuple[str, ...], data: _Segments) -> None:
    """Refuse parameters whose standard error is as large as they are."""
    vague = [name for name, e in zip(names, errors, strict=True) if name not in _MAY_VANISH and e > _UNKNOWN]
    if vague:
        raise ValueError(
            f"The data hold next to no information on {_listed(vague)}: the standard error is as large as the value. "
            f"Record livelier or longer motion, or leave {_listed(vague)} out of fit{_excite(data)}."
        )


def _excite(data: _Segments) -> str:
    """Add what is missing where no force was ever applied."""
    return "" if np.any(data.u) else " (no force was applied; a known force sets the scale of the masses)"


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


# ------------------------------------------------------------------------------------------------------------ arguments


def _value(params: Params, name: str) -> Number:
    """Return a parameter, its default resolved where it was left out."""
    value = getattr(params, name)
    if value is None:
        of = params.centers if name.startswith("com") else params.inertias
        value = of[int(name[-1]) - 1]
    return value


def _named(argument: str, names: Sequence[str]) -> tuple[str, ...]:
    if isinstance(names, str):
        return (names,)
    if not (isinstance(names, Sequence) and all(isinstance(name, str) for name in names)):
        raise TypeError(f"{argument} must be one name, or several; got {reprlib.repr(names)}.")
    return tuple(names)


def _checked_names(fit: Sequence[str], params: Params) -> tuple[str, ...]:
    names = _named("fit", fit)
    if not names:
        raise ValueError(f"fit names no parameter; expected some of {', '.join(_FITTABLE)}.")
    for name in names:
        if name not in _FITTABLE:
            raise ValueError(f"There is no parameter {name!r} to fit.{suggestion(str(name), _FITTABLE)}")
    if len(set(names)) < len(names):
        raise ValueError(f"fit names a parameter twice: {', '.join(names)}.")
    if params.n is not None:
        raise ValueError(f"One plant is found at a time; got a start of {params.n} plants.")
    for name in names:
        if name not in _MAY_VANISH and not _value(params, name) > 0:
            raise ValueError(f"The search for {name} must start above zero; got {_value(params, name):g}.")
    return names


def _checked_outputs(outputs: Sequence[str]) -> tuple[str, ...]:
    seen = _named("outputs", outputs)
    for name in seen:
        if name not in NAMES:
            raise ValueError(f"There is no output {name!r}.{suggestion(str(name), NAMES)}")
    if not seen or len(set(seen)) < len(seen):
        raise ValueError(f"outputs must name at least one of {', '.join(NAMES)}, none twice; got {', '.join(seen)!r}.")
    return seen


def _autocorrelation(residuals: Array) -> float:
    """Return the correlation of residuals ``(S, L)`` with those of the next sample."""
    squares = float((residuals**2).mean())
    return float((residuals[:, 1:] * residuals[:, :-1]).mean()) / squares if squares > 0 else 0.0
