r"""A plain Gaussian process of what a sample changes, with as much or as little built in as is asked for.

Each change is :math:`\sum_i \alpha_i k(z, z_i)` with a squared-exponential kernel, one length scale an input,

.. math:: k(z, z') = s^2 \exp\bigl(-\tfrac12 \textstyle\sum_j (z_j - z'_j)^2 / \ell_j^2\bigr),

and :math:`z` the state and the force: angles as they are, or by sine and cosine of each and of the angle between them,
with or without the cart's position.  Either all six states change by processes of their own; or the three rates do,
:math:`z` has the positions that these rates lead to in half a sample, and positions follow by the trapezoidal rule.
With the mirror known, each process is odd: its kernel is :math:`(k(z, z') - k(z, -z'))/2`, cosines keeping their sign.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor, cho_solve, cholesky, get_lapack_funcs, solve_triangular
from scipy.optimize import minimize

from controllers.ilqr import Model
from dpend.kernels import cos, inline, sin
from dpend.params import Array

_POINTS, _CENTERS = 300, 500  # transitions for the marginal likelihood, and centres of the posterior's kernels
_FIRST_STEPS, _STEPS = 40, 15  # of the search for hyperparameters, from their prior and from those before
_ROUNDS = 2  # of the search: the first takes the noise of all changes for equal
_NOISIEST = 200.0  # times the usual variance, at most
_EXACT = 1e-6  # share of a kernel's variance by which no function of its centres is the process
_BLOCK = 64  # centres side by side, so that LLVM turns loops over them into vector instructions
_FAR = -50.0  # exponents below count as this
_MEDIAN = 0.6745  # of the size of a normal number of variance 1
_JITTER = 1e-3  # least noise, as a share of the changes
(_invert,) = get_lapack_funcs(("potri",), dtype=np.float64)


class Transitions(NamedTuple):
    """Measured states, the forces held from each for a sample, and the states measured after it."""

    x: Array
    u: Array
    after: Array


class Priors(NamedTuple):
    """What is known of the plant before it moves."""

    angles: bool
    second_order: bool
    cart_invariance: bool
    mirror: bool


class Centers(NamedTuple):
    """The model as the compiled code takes it."""

    z: Array
    """Centres (D, M), mirrored ones included, and others to fill the last block."""
    alpha: Array
    """Weights (E, M), zero for the others."""
    per: Array
    """Inverse squared length scales (E, D)."""
    angles: bool
    second_order: bool
    cart_invariance: bool
    h: float


def _inputs(x: Array, u: Array, h: float, priors: Priors) -> Array:
    """Return z (N, D) for states (N, 6) and forces (N,)."""
    q = x[:, :3] + h / 2 * x[:, 3:] if priors.second_order else x[:, :3]
    th = np.column_stack([q[:, 1:], q[:, 1] - q[:, 2]])
    shown = [np.sin(th), np.cos(th)] if priors.angles else [q[:, 1:]]
    return np.column_stack([q[:, :0] if priors.cart_invariance else q[:, :1], *shown, x[:, 3:], u])


def _signs(priors: Priors) -> Array:
    """Return the sign that each input has in the mirror."""
    shown = [-1, -1, -1, 1, 1, 1] if priors.angles else [-1, -1]
    return np.array([*([] if priors.cart_invariance else [-1]), *shown, -1, -1, -1, -1], dtype=np.float64)


@inline
def _seen(x, u, c):
    z = np.empty(len(c.z))
    j = 0 if c.cart_invariance else 1
    on = 0.5 * c.h if c.second_order else 0.0
    z[0] = x[0] + on * x[3]
    a, b = x[1] + on * x[4], x[2] + on * x[5]
    if c.angles:
        z[j], z[j + 1], z[j + 2] = sin(a), sin(b), sin(a - b)
        z[j + 3], z[j + 4], z[j + 5] = cos(a), cos(b), cos(a - b)
    else:
        z[j], z[j + 1] = a, b
    z[-4], z[-3], z[-2], z[-1] = x[3], x[4], x[5], u
    return z


@inline
def _exp(y):
    """Return e^y within 1e-13 for y <= 0: a Taylor series of y/256, squared, which processors do on vectors."""
    y = max(y, _FAR) / 256
    p = 1 + y * (1 + y * (1 / 2 + y * (1 / 6 + y * (1 / 24 + y * (1 / 120 + y * (1 / 720 + y * (1 / 5040)))))))
    for _ in range(8):
        p *= p
    return p


@inline
def _changes(z, c, change, slopes):
    """Add up the changes (E,), and their slopes by z (E, D) where there is room for them."""
    D, M = c.z.shape
    E, wanted = len(change), D if len(slopes) else 0
    apart, part = np.empty((D, _BLOCK)), np.empty(_BLOCK)
    total, by = np.zeros((E, _BLOCK)), np.zeros((E, wanted, _BLOCK))
    for first in range(0, M, _BLOCK):
        for j in range(D):
            for i in range(_BLOCK):
                apart[j, i] = c.z[j, first + i] - z[j]
        for e in range(E):
            part[:] = 0.0
            for j in range(D):
                for i in range(_BLOCK):
                    part[i] -= 0.5 * c.per[e, j] * apart[j, i] * apart[j, i]
            for i in range(_BLOCK):
                part[i] = c.alpha[e, first + i] * _exp(part[i])
                total[e, i] += part[i]
            for j in range(wanted):
                for i in range(_BLOCK):
                    by[e, j, i] += part[i] * apart[j, i]
    for e in range(E):
        change[e] += total[e].sum()
        for j in range(wanted):
            slopes[e, j] += c.per[e, j] * by[e, j].sum()


@inline
def _after(x, change, c):
    if not c.second_order:
        return (x[0] + change[0], x[1] + change[1], x[2] + change[2],
                x[3] + change[3], x[4] + change[4], x[5] + change[5])  # fmt: skip
    h, v, w1, w2 = c.h, x[3] + change[0], x[4] + change[1], x[5] + change[2]
    return x[0] + 0.5 * h * (x[3] + v), x[1] + 0.5 * h * (x[4] + w1), x[2] + 0.5 * h * (x[5] + w2), v, w1, w2


@inline
def _step(x, u, c):
    change = np.zeros(len(c.alpha))
    _changes(_seen(x, u, c), c, change, np.empty((0, 0)))
    return _after(x, change, c)


def _linearize(x, u, c, D):
    E, n, j = len(c.alpha), len(c.z), 0 if c.cart_invariance else 1
    on = 0.5 * c.h if c.second_order else 0.0
    D[:] = 0.0
    for k in range(len(u)):
        now = (x[k, 0], x[k, 1], x[k, 2], x[k, 3], x[k, 4], x[k, 5])
        change, slopes = np.zeros(E), np.zeros((E, n))
        z = _seen(now, u[k], c)
        _changes(z, c, change, slopes)
        for e in range(E):
            row, by = 6 - E + e, slopes[e]
            D[k, row, 0] = j * by[0]
            if c.angles:
                between = by[j + 2] * z[j + 5] - by[j + 5] * z[j + 2]
                D[k, row, 1] = by[j] * z[j + 3] - by[j + 3] * z[j] + between
                D[k, row, 2] = by[j + 1] * z[j + 4] - by[j + 4] * z[j + 1] - between
            else:
                D[k, row, 1], D[k, row, 2] = by[j], by[j + 1]
            for i in range(3):
                D[k, row, 3 + i] = by[n - 4 + i] + on * D[k, row, i]
            D[k, row, 6] = by[n - 1]
            D[k, row, row] += 1.0
        if c.second_order:
            for i in range(3):
                for col in range(7):
                    D[k, i, col] = 0.5 * c.h * D[k, 3 + i, col]
                D[k, i, i] += 1.0
                D[k, i, 3 + i] += 0.5 * c.h
        after = _after(now, change, c)
        for i in range(6):
            D[k, i, 7] = after[i] - x[k + 1, i]


@dataclass(frozen=True, kw_only=True, eq=False)
class KernelModel:
    """The posterior of the processes, given transitions.

    Parameters
    ----------
    z : ndarray (M, D)
        Centres: inputs of some of the transitions, spread over those of all.
    alpha : ndarray (M, E)
        Weights of the kernels about them, which all transitions determine.
    hyper : ndarray (E, D + 2)
        Logarithms of the length scales, the amplitude and the noise.
    sensor_noise : ndarray (6,)
        Standard deviations of the measured states, m, rad, m/s and rad/s, as the transitions have them.
    sample_time : float
        s.
    priors : Priors
        What is built in.
    """

    z: Array
    alpha: Array
    hyper: Array
    sensor_noise: Array
    sample_time: float
    priors: Priors

    kind = "kernel"

    @cached_property
    def model(self) -> Model:
        """What a planner takes."""
        z, alpha = self.z, self.alpha * np.exp(2 * self.hyper[:, -2])
        if self.priors.mirror:
            z, alpha = np.vstack([z, z * _signs(self.priors)]), np.vstack([alpha, -alpha]) / 2
        last = [(0, -len(z) % _BLOCK), (0, 0)]
        z, alpha = (np.ascontiguousarray(np.pad(each, last).T) for each in (z, alpha))
        parameters = Centers(z, alpha, np.exp(-2 * self.hyper[:, :-2]), self.priors.angles, self.priors.second_order,
                             self.priors.cart_invariance, self.sample_time)  # fmt: skip
        return Model(step=_step, linearize=_linearize, parameters=parameters, sources=(Path(__file__),))

    @property
    def noise(self) -> Array:
        """Standard deviations (3,) of the measured rates that the model infers, m/s and rad/s."""
        return self.sensor_noise[3:]

    @cached_property
    def _factors(self) -> list[Array]:
        """Cholesky factors of what is known of the changes of the rates at the centres."""
        return [_factor(self.z, hyper, self.priors)[0] for hyper in self.hyper[-3:]]

    def uncertainty(self, x: Array, u: Array) -> Array:
        """Return the standard deviations (N, 3) of the mean accelerations in states (N, 6) under forces (N,).

        They count the transitions at the centres alone, and so are rather too great.
        """
        new, signs = _inputs(x, u, self.sample_time, self.priors), _signs(self.priors)
        std = np.empty((len(x), 3))
        for d, (hyper, factor) in enumerate(zip(self.hyper[-3:], self._factors, strict=True)):
            across, _ = _kernel(new, self.z, hyper, self.priors, signs)
            own = np.exp(2 * hyper[-2]) * np.ones(len(x))
            if self.priors.mirror:
                twice = np.exp(-0.5 * (((new - new * signs) / np.exp(hyper[:-2])) ** 2).sum(axis=1))
                own = own * (1 - twice) / 2
            known = solve_triangular(factor, across.T, lower=True, check_finite=False)
            std[:, d] = np.sqrt(np.maximum(own - (known**2).sum(axis=0), 0)) / self.sample_time
        return std

    def arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Return what it is made of."""
        return {each.name: np.asarray(getattr(self, each.name)) for each in fields(self)}

    @classmethod
    def from_arrays(cls, sample_time: Any, priors: Any, **arrays: Any) -> KernelModel:
        """Build it from what :meth:`arrays` returned."""
        return cls(sample_time=float(sample_time), priors=Priors(*map(bool, priors)), **arrays)

    @classmethod
    def fit(
        cls, data: Transitions, h: float, priors: Priors, rng: np.random.Generator, before: KernelModel | None
    ) -> KernelModel:
        """Return the posterior after transitions; hyperparameters are sought from those of the model before."""
        z, y = _inputs(data.x, data.u, h, priors), (data.after - data.x)[:, 3 if priors.second_order else 0 :]
        size = np.sqrt(np.mean(y**2, axis=0)) + 1e-9
        center = np.array([[*np.log(2 * z.std(axis=0) + 1e-3), math.log(2 * s), math.log(0.1 * s)] for s in size])
        hyper, steps = (center, _FIRST_STEPS) if before is None else (before.hyper, _STEPS)
        rows = np.sort(rng.permutation(len(z))[:_POINTS])
        model: KernelModel | None = None
        for _ in range(_ROUNDS):
            noisier = np.ones_like(y) if model is None else model._noisier(data)
            hyper = np.stack([
                _most_likely(z[rows], y[rows, e], noisier[rows, e], priors, hyper[e], center[e], steps)
                for e in range(len(size))
            ])  # fmt: skip
            centers = z[_spread(z / np.exp(hyper[:, :-2].mean(axis=0)), _CENTERS)]
            alpha = [_weights(centers, z, y[:, e], noisier[:, e], hyper[e], priors) for e in range(len(size))]
            noise = np.exp(hyper[:, -1]) / math.sqrt(2)  # a change has the noise of two measurements
            if priors.second_order:
                noise = np.append(_position_noise(data, h, noise), noise)
            model = cls(z=centers, alpha=np.stack(alpha, axis=1), hyper=hyper, sensor_noise=noise, sample_time=h,
                        priors=priors)  # fmt: skip
        assert model is not None
        return model

    def _noisier(self, data: Transitions) -> Array:
        """Return how many times the usual variance each measured change (N, E) has, as noise of the state enters it.

        Of changes that noise of size s of the states before and after moves by the slopes D, it is s^2 (1 + D D^T).
        """
        D = np.empty((len(data.u), 6, 8))
        self.model.loops.linearize(np.append(data.x, data.after[-1:], axis=0), data.u, self.model.parameters, D)
        return np.minimum((1 + (D[:, 6 - self.alpha.shape[1] :, :6] ** 2).sum(axis=2)) / 2, _NOISIEST)


def _position_noise(data: Transitions, h: float, noise: Array) -> Array:
    """Return the standard deviations (3,) of measured positions, given those of rates, by the trapezoidal rule.

    What positions miss of it has the noise of two positions and of the mean of two rates; its median is not that of the
    few samples in which the rule itself is far off.
    """
    missed = (data.after - data.x)[:, :3] - h / 2 * (data.after + data.x)[:, 3:]
    usual = np.median(np.abs(missed), axis=0) / _MEDIAN
    return np.sqrt(np.maximum(usual**2 - (h * noise) ** 2 / 2, (_JITTER * usual) ** 2) / 2) + 1e-9


def _spread(z: Array, most: int) -> npt.NDArray[np.intp]:
    """Return rows of z (N, D) of which each is as far as may be from those before it."""
    rows, far = [0], np.full(len(z), math.inf)
    while len(rows) < min(most, len(z)):
        far = np.minimum(far, ((z - z[rows[-1]]) ** 2).sum(axis=1))
        rows.append(int(far.argmax()))
    return np.array(rows)


def _weights(centers: Array, z: Array, y: Array, noisier: Array, hyper: Array, priors: Priors) -> Array:
    """Return the weights of kernels about centres, given all transitions: of a process that these kernels span.

    Source: C. Rasmussen and C. Williams, 2006, section 8.3.1, the subset of regressors.
    """
    signs, noise = _signs(priors), np.exp(2 * hyper[-1])
    own = _kernel(centers, centers, hyper, priors, signs)[0]
    own[np.diag_indices_from(own)] += _EXACT * np.exp(2 * hyper[-2])
    root = cholesky(own, lower=True, check_finite=False)
    seen = solve_triangular(root, _kernel(centers, z, hyper, priors, signs)[0], lower=True) / np.sqrt(noisier)
    square = seen @ seen.T
    square[np.diag_indices_from(square)] += noise
    return solve_triangular(root.T, cho_solve(cho_factor(square, lower=True), seen @ (y / np.sqrt(noisier))))


def _kernel(a: Array, b: Array, hyper: Array, priors: Priors, signs: Array) -> tuple[Array, list[Array]]:
    """Return the kernel of inputs and its parts: the plain kernel, and the mirrored one if there is one."""
    scaled, others = a / np.exp(hyper[:-2]), [b] + ([b * signs] if priors.mirror else [])
    parts = []
    for other in (each / np.exp(hyper[:-2]) for each in others):
        far = (scaled**2).sum(axis=1)[:, None] + (other**2).sum(axis=1) - 2 * scaled @ other.T
        parts.append(np.exp(2 * hyper[-2] - 0.5 * np.maximum(far, 0)))
    return ((parts[0] - parts[1]) / 2 if priors.mirror else parts[0]), parts


def _factor(z: Array, hyper: Array, priors: Priors) -> tuple[Array, bool]:
    K, _ = _kernel(z, z, hyper, priors, _signs(priors))
    K[np.diag_indices_from(K)] += np.exp(2 * hyper[-1]) + 1e-9 * np.exp(2 * hyper[-2])
    return cho_factor(K, lower=True, overwrite_a=True, check_finite=False)


def _most_likely(z: Array, y: Array, noisier: Array, priors: Priors, start: Array, center: Array, steps: int) -> Array:
    """Return hyperparameters of great posterior density, after some steps of a search from others."""
    signs, n = _signs(priors), len(z)
    spread = np.array([1.0] * z.shape[1] + [1.0, 2.0])

    def loss(h: Array) -> tuple[float, Array]:
        K, parts = _kernel(z, z, h, priors, signs)
        noise = noisier * np.exp(2 * h[-1])
        weights = (parts[0] / 2, -parts[1] / 2) if priors.mirror else (parts[0],)
        noisy = K.copy()
        noisy[np.diag_indices(n)] += noise + 1e-9 * np.exp(2 * h[-2])
        root = cholesky(noisy, lower=True, overwrite_a=True, check_finite=False)
        inverse, _ = _invert(root, lower=1)
        inverse += np.tril(inverse, -1).T
        alpha = inverse @ y
        W = inverse - np.outer(alpha, alpha)
        slope = np.zeros(len(h))
        for weight, turn in zip(weights, (1.0, signs), strict=False):
            P = W * weight  # of which (z_i - z_j)^2 is the sum in each slope, z_j turned in the mirror
            slope[:-2] += np.exp(-2 * h[:-2]) * (P.sum(axis=0) @ z**2 - (z * (P @ z) * turn).sum(axis=0))
        slope[-2], slope[-1] = np.vdot(W, K), noise @ W.diagonal()
        away = (h - center) / spread
        value = 0.5 * y @ alpha + np.log(root.diagonal()).sum() + 0.5 * away @ away
        return float(value), slope + away / spread

    limits = np.stack([center - 3.5, center + 3.5], axis=1)
    limits[-1] = center[-1] + math.log(10) + math.log(_JITTER), center[-1] + math.log(10)
    found = minimize(loss, np.clip(start, *limits.T), jac=True, method="L-BFGS-B", bounds=limits.tolist(),
                     options={"maxiter": steps})  # fmt: skip
    return found.x
