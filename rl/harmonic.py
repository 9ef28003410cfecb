r"""A Bayesian model of accelerations: affine in the force, quadratic in the rates, harmonic in the angles.

Mechanics of two links on a cart give accelerations

.. math:: \ddot q = \sum_k q_k(\dot q, u)\, c_k(\theta_1, \theta_2), \qquad
    q = (1, \dot p^2, \dot p\dot\theta_1, \dot p\dot\theta_2, \dot\theta_1^2, \dot\theta_1\dot\theta_2, \dot\theta_2^2,
    u, \dot p, \dot\theta_1, \dot\theta_2),

whatever masses, lengths and viscous friction are.  Each :math:`c_k` is a Gaussian process with the squared-exponential
kernel of sines and cosines of :math:`\theta_1`, :math:`\theta_2` and the angle between the links, which is a Fourier
series,

.. math:: \exp\Bigl(\frac{\cos\Delta_1 - 1}{\ell_1^2} + \frac{\cos\Delta_2 - 1}{\ell_2^2}
    + \frac{\cos(\Delta_1 - \Delta_2) - 1}{\ell_{12}^2}\Bigr)
    = \sum_{m,n} w_{mn} \cos(m\Delta_1 + n\Delta_2), \qquad w_{mn} \ge 0,

so that, cut off at order 6, the model is linear in 169 functions of the angles times 11 of the rest: a regression whose
cost does not depend on past data.  Mirror symmetry leaves sines to what is even in rates and force, cosines to what is
odd: 928 of 1859 weights.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor, cho_solve, get_blas_funcs, solve_triangular
from scipy.optimize import minimize

from controllers.ilqr import Model
from controllers.ilqr_kernels import Flow, make_flow
from dpend.kernels import compiled, cos, inline, sin
from dpend.params import Array

ORDER = 6
_EVEN, _PRODUCTS = 7, 11
_WAVES = np.array([(m, n) for m in range(ORDER + 1) for n in range(-ORDER, ORDER + 1) if m or n > 0])
_TURN = 2 * math.pi * np.arange(32) / 32
_GRID = (_TURN[:, None] + 0 * _TURN, 0 * _TURN[:, None] + _TURN, _TURN[:, None] - _TURN)
_SUBSTEPS = 2
_POINTS = 300  # for the marginal likelihood
_CORRECTIONS = 3
_STEEPEST = 400.0  # cap of the squared slopes that multiply the noise
_ger: Any = get_blas_funcs("ger", dtype=np.float64)
_JITTER = 1e-3  # least noise, as a share of the accelerations


class Transitions(NamedTuple):
    """Measured states, the forces held from each for a sample, and the states measured after it."""

    x: Array
    u: Array
    after: Array


class Field(NamedTuple):
    """Weights as the compiled code takes them: of sines and cosines, three columns for each product."""

    sines: Array
    cosines: Array
    sines_end: int
    cosines_start: int


def products(rates: Array, u: Array) -> Array:
    """Return the eleven products (N, 11) of rates (N, 3) and forces (N,): seven even ones, then four odd ones."""
    v, w1, w2 = rates.T
    return np.stack([np.ones_like(v), v * v, v * w1, v * w2, w1 * w1, w1 * w2, w2 * w2, u, v, w1, w2], axis=1)


@inline
def _waves(th, c, s):
    c[0], s[0] = 1.0, 0.0
    c[1], s[1] = cos(th), sin(th)
    for m in range(2, ORDER + 1):
        c[m] = c[m - 1] * c[1] - s[m - 1] * s[1]
        s[m] = s[m - 1] * c[1] + c[m - 1] * s[1]


@inline
def _sums(x, c, slopes):
    """Return the coefficients of the products (33,), and their slopes by both angles if asked for."""
    c1, s1, c2, s2 = np.empty(ORDER + 1), np.empty(ORDER + 1), np.empty(ORDER + 1), np.empty(ORDER + 1)
    _waves(x[1], c1, s1)
    _waves(x[2], c2, s2)
    G, G1, G2 = np.zeros(3 * _PRODUCTS), np.zeros(3 * _PRODUCTS), np.zeros(3 * _PRODUCTS)
    for j in range(c.cosines_start, 3 * _PRODUCTS):
        G[j] = c.cosines[0, j]
    k = 0
    for m in range(ORDER + 1):
        for n in range(-ORDER if m else 1, ORDER + 1):
            cn, sn = c2[abs(n)], s2[abs(n)] if n >= 0 else -s2[abs(n)]
            sine = s1[m] * cn + c1[m] * sn
            cosine = c1[m] * cn - s1[m] * sn
            for j in range(c.sines_end):
                G[j] += c.sines[k, j] * sine
            for j in range(c.cosines_start, 3 * _PRODUCTS):
                G[j] += c.cosines[k + 1, j] * cosine
            if slopes:
                for j in range(c.sines_end):
                    G1[j] += c.sines[k, j] * (m * cosine)
                    G2[j] += c.sines[k, j] * (n * cosine)
                for j in range(c.cosines_start, 3 * _PRODUCTS):
                    G1[j] -= c.cosines[k + 1, j] * (m * sine)
                    G2[j] -= c.cosines[k + 1, j] * (n * sine)
            k += 1
    return G, G1, G2


@inline
def _weighed(G, x, u, d):
    v, w1, w2 = x[3], x[4], x[5]
    even = G[d] + v * (v * G[3 + d] + w1 * G[6 + d] + w2 * G[9 + d])
    even += w1 * (w1 * G[12 + d] + w2 * G[15 + d]) + w2 * w2 * G[18 + d]
    return even + u * G[21 + d] + v * G[24 + d] + w1 * G[27 + d] + w2 * G[30 + d]


@inline
def _rates(x, f, c):
    G, _, _ = _sums(x, c, False)
    return x[3], x[4], x[5], _weighed(G, x, f[0], 0), _weighed(G, x, f[0], 1), _weighed(G, x, f[0], 2)


@inline
def _by_rates(G, x, d):
    v, w1, w2 = x[3], x[4], x[5]
    return (
        2.0 * v * G[3 + d] + w1 * G[6 + d] + w2 * G[9 + d] + G[24 + d],
        v * G[6 + d] + 2.0 * w1 * G[12 + d] + w2 * G[15 + d] + G[27 + d],
        v * G[9 + d] + w1 * G[15 + d] + 2.0 * w2 * G[18 + d] + G[30 + d],
    )


@inline
def _field(x, f, c):
    G, G1, G2 = _sums(x, c, True)
    u = f[0]
    a, b, e = _by_rates(G, x, 0), _by_rates(G, x, 1), _by_rates(G, x, 2)
    return (x[3], x[4], x[5], _weighed(G, x, u, 0), _weighed(G, x, u, 1), _weighed(G, x, u, 2)), (
        (_weighed(G1, x, u, 0), _weighed(G1, x, u, 1), _weighed(G1, x, u, 2)),
        (_weighed(G2, x, u, 0), _weighed(G2, x, u, 1), _weighed(G2, x, u, 2)),
        (a[0], b[0], e[0]),
        (a[1], b[1], e[1]),
        (a[2], b[2], e[2]),
        (G[21], G[22], G[23]),
    )


_step, _linearize = make_flow(_rates, _field)


@compiled
def _followed(x, u, parameters, mid, after, accelerations, slopes):
    """Fill in the states after each sample, and accelerations and their slopes (N, 3, 5) at the middles."""
    for k in range(len(u)):
        after[k] = _step((x[k, 0], x[k, 1], x[k, 2], x[k, 3], x[k, 4], x[k, 5]), u[k], parameters)
        y = (mid[k, 0], mid[k, 1], mid[k, 2], mid[k, 3], mid[k, 4], mid[k, 5])
        rates, by = _field(y, (u[k], 0.0, 0.0), parameters.field)
        for d in range(3):
            accelerations[k, d] = rates[3 + d]
            for j in range(5):
                slopes[k, d, j] = by[j][d]


def middles(data: Transitions, h: float) -> Array:
    """Return the states (N, 6) half way through the samples, by Hermite interpolation of the positions."""
    mid = (data.x + data.after) / 2
    mid[:, :3] -= h / 8 * (data.after[:, 3:] - data.x[:, 3:])
    return mid


def three_angles(x: Array) -> Array:
    """Return the angles (N, 3) of both links, and between them, in states (N, 6)."""
    return np.column_stack([x[:, 1:3], x[:, 1] - x[:, 2]])


def _features(x: Array, u: Array, mirror: bool) -> Array:
    """Return what the weights are of (N, 928 or 1859): sines times products, then cosines times products."""
    q = products(x[:, 3:], u)
    phase = x[:, 1:3] @ _WAVES.T
    sines, cosines = np.sin(phase), np.column_stack([np.ones(len(x)), np.cos(phase)])
    even, odd = (q[:, :_EVEN], q[:, _EVEN:]) if mirror else (q, q)
    parts = (sines[:, :, None] * even[:, None], cosines[:, :, None] * odd[:, None])
    return np.concatenate([part.reshape(len(x), -1) for part in parts], axis=1)


def _variances(hyper: Array, mirror: bool) -> Array:
    """Return the prior variances of the weights of one output."""
    per, amplitudes = np.exp(-2 * hyper[:3]), np.exp(2 * hyper[3:-1])
    theta = np.exp(sum(p * (np.cos(each) - 1) for p, each in zip(per, _GRID, strict=True)))
    spectrum = np.fft.fft2(theta).real / theta.size
    waves = 2 * np.maximum(spectrum[_WAVES[:, 0], _WAVES[:, 1]], 0)
    even, odd = (amplitudes[:_EVEN], amplitudes[_EVEN:]) if mirror else (amplitudes, amplitudes)
    still = np.append(spectrum[0, 0], waves)
    return np.concatenate([np.outer(waves, even).ravel(), np.outer(still, odd).ravel()])


@dataclass(frozen=True, kw_only=True, eq=False)
class HarmonicModel:
    """The posterior of the weights, given transitions.

    Parameters
    ----------
    weights : ndarray (3, F)
        Posterior means, for each acceleration.
    hyper : ndarray (3, 15)
        Logarithms of three length scales (both angles, and that between the links), eleven amplitudes, and the noise.
    inputs : ndarray (N, 7)
        States at the middles of the samples, and forces.
    excess : ndarray (N, 3)
        By what each noise variance is multiplied.
    sample_time : float
        s.
    mirror : bool
        Whether mirrored motion is motion.
    """

    weights: Array
    hyper: Array
    inputs: Array
    excess: Array
    sample_time: float
    mirror: bool

    kind = "harmonic"

    @property
    def parameters(self) -> Flow:
        """What :data:`step` takes."""
        n, products_of_sines = len(_WAVES), _EVEN if self.mirror else _PRODUCTS
        cut = n * products_of_sines
        sines, cosines = np.zeros((n, 3 * _PRODUCTS)), np.zeros((n + 1, 3 * _PRODUCTS))
        start = 3 * _EVEN if self.mirror else 0
        sines[:, : 3 * products_of_sines] = self.weights[:, :cut].reshape(3, n, -1).transpose(1, 2, 0).reshape(n, -1)
        cosines[:, start:] = self.weights[:, cut:].reshape(3, n + 1, -1).transpose(1, 2, 0).reshape(n + 1, -1)
        field = Field(sines, cosines, 3 * products_of_sines, start)
        return Flow(field, self.sample_time / _SUBSTEPS, _SUBSTEPS)

    @property
    def model(self) -> Model:
        """What a planner takes."""
        sources = Path(__file__), Path(__file__).parent.parent / "controllers"
        return Model(step=_step, linearize=_linearize, parameters=self.parameters, sources=sources)

    @property
    def noise(self) -> Array:
        """Standard deviations (3,) of the measured rates that the model infers, m/s and rad/s."""
        return np.exp(self.hyper[:, -1]) * self.sample_time

    def accelerations(self, x: Array, u: Array) -> Array:
        """Return the mean accelerations (N, 3) in states (N, 6) under forces (N,)."""
        return _features(x, u, self.mirror) @ self.weights.T

    def uncertainty(self, x: Array, u: Array) -> Array:
        """Return the standard deviations (N, 3) of the accelerations in states (N, 6) under forces (N,)."""
        seen, new = _features(self.inputs[:, :6], self.inputs[:, 6], self.mirror), _features(x, u, self.mirror)
        std = np.empty((len(x), 3))
        for d, hyper in enumerate(self.hyper):
            scale = np.sqrt(_variances(hyper, self.mirror))
            factor = _factor(seen * scale, np.exp(2 * hyper[-1]) * self.excess[:, d])
            std[:, d] = np.linalg.norm(solve_triangular(factor, (new * scale).T, lower=True), axis=0)
        return std

    def arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Return what it is made of."""
        return {name: np.asarray(value) for name, value in vars(self).items()}

    @classmethod
    def from_arrays(cls, sample_time: Any, mirror: Any, **arrays: Any) -> HarmonicModel:
        """Build it from what :meth:`arrays` returned."""
        return cls(sample_time=float(sample_time), mirror=bool(mirror), **arrays)

    @classmethod
    def fit(
        cls, data: Transitions, h: float, mirror: bool, rng: np.random.Generator, before: HarmonicModel | None
    ) -> HarmonicModel:
        """Return the posterior after transitions; hyperparameters are sought from those of the model before.

        The regression is of accelerations at the middles of the samples.  Three times the targets are corrected by what
        the fitted field's Runge-Kutta sample differs from its acceleration in the middle, so that in the end the sample
        is what fits.  Noise in the measured states counts as noise of the target: its variance is multiplied by one and
        the squared slopes of the sample.
        """
        mid = middles(data, h)
        gained = (data.after - data.x)[:, 3:] / h
        size = np.sqrt(np.mean(gained**2, axis=0)) + 1e-9
        q = products(mid[:, 3:], data.u)
        features = _features(mid, data.u, mirror)
        center = _prior_center(size, np.sqrt(np.mean(q**2, axis=0)))
        hyper = (center if before is None else before.hyper).copy()
        excess = np.full(gained.shape, 2.0)
        target = gained
        for learn in (before is None, True, False):
            if learn:
                rows = np.sort(rng.permutation(len(mid))[:_POINTS])
                angles, shift = three_angles(mid[rows]), np.log(size)
                for d in range(3):
                    scaled = target[rows, d] / size[d], excess[rows, d]
                    around = _shifted(hyper[d], -shift[d]), _shifted(center[d], -shift[d])
                    hyper[d] = _shifted(_most_likely(angles, q[rows], *scaled, mirror, *around), shift[d])
            weights, target, slopes = _posterior(data, mid, gained, size, features, hyper, excess, h, mirror)
            excess = _excess(slopes, h)
        inputs = np.column_stack([mid, data.u])
        return cls(weights=weights, hyper=hyper, inputs=inputs, excess=excess, sample_time=h, mirror=mirror)


class Tracker:
    """The posterior of a model, updated sample by sample, its hyperparameters held.

    Parameters
    ----------
    belief : HarmonicModel
        Where it begins.
    """

    def __init__(self, belief: HarmonicModel) -> None:
        self._belief = replace(belief, weights=belief.weights.copy())
        features = _features(belief.inputs[:, :6], belief.inputs[:, 6], belief.mirror)
        self._covariances = []
        for d, hyper in enumerate(belief.hyper):
            scale = np.sqrt(_variances(hyper, belief.mirror))
            factor = _factor(features * scale, np.exp(2 * hyper[-1]) * belief.excess[:, d])
            half = solve_triangular(factor, np.diag(scale), lower=True, check_finite=False)
            self._covariances.append(np.asfortranarray(half.T @ half))

    @property
    def parameters(self) -> Flow:
        """What :data:`step` takes."""
        return self._belief.parameters

    def update(self, x: Array, u: float, after: Array) -> None:
        """Learn from one sample: measured state (6,), the force held, and the state measured next."""
        belief = self._belief
        h, data = belief.sample_time, Transitions(x[None], np.array([u]), after[None])
        mid = middles(data, h)
        target, slopes = _corrected(data, mid, belief, np.full(3, math.inf))
        excess = _excess(slopes, h)
        phi = _features(mid, data.u, belief.mirror)[0]
        if not (np.isfinite(phi).all() and np.isfinite(target).all()):
            return
        for d, covariance in enumerate(self._covariances):
            g = covariance @ phi
            gain = 1.0 / (np.exp(2 * belief.hyper[d, -1]) * excess[0, d] + phi @ g)
            belief.weights[d] += gain * (target[0, d] - belief.weights[d] @ phi) * g
            _ger(-gain, g, g, a=covariance, overwrite_x=0, overwrite_y=0, overwrite_a=1)


def _prior_center(size: Array, products_size: Array) -> Array:
    """Return the medians of the hyperparameters: amplitudes that would each give half the accelerations seen."""
    center = np.empty((3, 4 + _PRODUCTS))
    center[:, :3] = math.log(1.2)
    center[:, 3:-1] = np.log(0.5 * size[:, None] / (products_size + 1e-9))
    center[:, -1] = np.log(0.1 * size)
    return center


_SPREAD = np.array([*[0.8] * 3, *[1.5] * _PRODUCTS, 2.0])


def _shifted(hyper: Array, shift: float) -> Array:
    """Return hyperparameters for targets in other units: all but the length scales change by a logarithm."""
    return np.concatenate([hyper[:3], hyper[3:] + shift])


def _posterior(
    data: Transitions, mid: Array, gained: Array, size: Array, features: Array, hyper: Array, excess: Array,
    h: float, mirror: bool,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Return posterior mean weights, the targets corrected, and the slopes at the middles."""
    weights, slopes = np.empty((3, features.shape[1])), np.empty((len(mid), 3, 5))
    solvers = []
    for d in range(3):
        scale = np.sqrt(_variances(hyper[d], mirror))
        noise = np.exp(2 * hyper[d, -1]) * excess[:, d]
        solvers.append((features * scale, noise, _factor(features * scale, noise), scale))
    target = gained
    for _ in range(_CORRECTIONS + 1):
        for d, (scaled, noise, factor, scale) in enumerate(solvers):
            weights[d] = scale * cho_solve((factor, True), scaled.T @ (target[:, d] / noise))
        belief = HarmonicModel(weights=weights, hyper=hyper, inputs=mid, excess=excess, sample_time=h, mirror=mirror)
        target, slopes = _corrected(data, mid, belief, size)
    return weights, target, slopes


def _corrected(data: Transitions, mid: Array, belief: HarmonicModel, most: Array) -> tuple[Array, Array]:
    """Return targets less what a Runge-Kutta sample gains beyond the acceleration in its middle, and slopes there."""
    n, h = len(mid), belief.sample_time
    after, accelerations, slopes = np.empty((n, 6)), np.empty((n, 3)), np.empty((n, 3, 5))
    _followed(data.x, data.u, belief.parameters, mid, after, accelerations, slopes)
    missed = (after[:, 3:] - data.x[:, 3:]) / h - accelerations
    return (data.after - data.x)[:, 3:] / h - np.clip(np.nan_to_num(missed), -most, most), slopes


def _excess(slopes: Array, h: float) -> Array:
    """Return by what the noise of the targets (N, 3) is multiplied, as states are measured with the noise of rates."""
    by = h * slopes
    by[:, range(3), range(2, 5)] += 1.0
    return 1.0 + np.minimum((by**2).sum(axis=2), _STEEPEST)


def _factor(scaled: Array, noise: Array) -> Array:
    """Return the lower Cholesky factor of the posterior precision of weights with unit prior variance."""
    each = scaled / np.sqrt(noise)[:, None]
    precision = each.T @ each
    precision[np.diag_indices_from(precision)] += 1.0
    return cho_factor(precision, lower=True, overwrite_a=True, check_finite=False)[0]


def _most_likely(
    angles: Array, q: Array, target: Array, excess: Array, mirror: bool, start: Array, center: Array
) -> Array:
    """Return the hyperparameters of greatest posterior density, given targets of unit size."""
    less = [np.cos(each[:, None] - each) - 1 for each in angles.T]
    sum_ = [np.cos(each[:, None] + each) - 1 for each in angles.T]
    n = len(target)

    def kernels(h: Array) -> tuple[list[Array], list[list[Array]]]:
        """Return the kernels of the coefficients of even and odd products, and their slopes by the log lengths."""
        per = np.exp(-2 * h[:3])
        near = np.exp(sum(per[i] * less[i] for i in range(3)))
        by_near = [-2 * per[i] * less[i] * near for i in range(3)]
        if not mirror:
            return [near, near], [by_near, by_near]
        far = np.exp(sum(per[i] * sum_[i] for i in range(3)))
        by_far = [-2 * per[i] * sum_[i] * far for i in range(3)]
        pairs = list(zip(by_near, by_far, strict=True))
        return [(near - far) / 2, (near + far) / 2], [[(a - b) / 2 for a, b in pairs], [(a + b) / 2 for a, b in pairs]]

    parts = slice(0, _EVEN), slice(_EVEN, _PRODUCTS)

    def loss(h: Array) -> tuple[float, Array]:
        amplitude, noise = np.exp(2 * h[3:-1]), np.exp(2 * h[-1])
        theta, slopes = kernels(h)
        gram = [(q[:, part] * amplitude[part]) @ q[:, part].T for part in parts]
        K = gram[0] * theta[0] + gram[1] * theta[1]
        K[np.diag_indices(n)] += noise * excess + 1e-8
        factor = cho_factor(K, lower=True, overwrite_a=True, check_finite=False)
        inverse = cho_solve(factor, np.eye(n), check_finite=False)
        alpha = inverse @ target
        W = inverse - np.outer(alpha, alpha)
        slope = np.empty(len(h))
        for i in range(3):
            slope[i] = 0.5 * np.vdot(W, gram[0] * slopes[0][i] + gram[1] * slopes[1][i])
        for part, each in zip(parts, theta, strict=True):
            columns = q[:, part]
            slope[3:-1][part] = amplitude[part] * np.einsum("ij,ij->j", columns, (W * each) @ columns)
        slope[-1] = noise * (W.diagonal() @ excess)
        away = (h - center) / _SPREAD
        value = 0.5 * target @ alpha + np.log(factor[0].diagonal()).sum() + 0.5 * away @ away
        return float(value), slope + away / _SPREAD

    bounds = [(math.log(0.5), math.log(20.0))] * 3 + [(c - 7, c + 4) for c in center[3:-1]] + [(math.log(_JITTER), 1.0)]
    limits = np.array(bounds).T
    found = minimize(loss, np.clip(start, *limits), jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 40})
    return found.x
