r"""Weights of a harmonic model from episodes of noisy states: both are sought together.

An episode's measured states are :math:`y_k = x_k + n_k`, its motion :math:`x_{k+1} = f(x_k, u_k; w) + q_k`.  About
states :math:`\hat x` and weights :math:`\hat w`, with :math:`A_k, F_k` the slopes of a sample by either,

.. math:: r_k = y_{k+1} - f(\hat x_k, u_k; \hat w) - A_k (y_k - \hat x_k) + F_k \hat w
    = F_k w + n_{k+1} - A_k n_k + q_k,

a linear regression whose noise is correlated from each sample to the next, as both share the noise of a state; the
covariance is block tridiagonal and has a banded Cholesky factor :math:`L`.  The posterior of the weights under their
Gaussian prior follows from :math:`L^{-1} r` and :math:`L^{-1} F`, and gives the states anew, :math:`\hat x = y - \hat
n`.  A few such rounds of Gauss and Newton converge.  In each, hyperparameters are sought by their marginal likelihood,
and the variances of the noise take a step of MacKay's fixed point.

Sources: C. Rasmussen and C. Williams, *Gaussian Processes for Machine Learning*, 2006, chapter 2; D. MacKay, *Bayesian
interpolation*, Neural Computation 1992; H. Bock, *Recent advances in parameter identification for ODE*, 1983.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import cholesky, cholesky_banded, get_lapack_funcs
from scipy.optimize import minimize

from dpend.params import Array

from .harmonic import PRODUCTS, HarmonicModel, Posterior, allowed, by_product, features, products, variances

_FIRST_ROUNDS, _ROUNDS = 8, 3
_UNTAUGHT = 3  # first rounds, while the states are still those measured, that leave noise and hyperparameters alone
_ATTEMPTS = 7  # each begun with twice the noise of the one before
_STEPS = 8  # of the search for hyperparameters, in a round
_SUBSTEPS = 4
_NEGLIGIBLE = 1e-3  # share of the accelerations below which a prior weight is left at zero
_UNEXPLAINED = 5e-3  # share of the accelerations by which motion strays from any model
_LEAST = 0.3  # share of that below which noise is not sought: a model would follow what it cannot explain
_FARTHEST = 6.0  # standard deviations of the noise: states are not sought beyond, where a model is not yet one
_LENGTHS = math.log(0.5), math.log(20.0)
_SPREAD = np.array([*[0.8] * 3, *[1.5] * PRODUCTS])
_solve_banded, _invert = get_lapack_funcs(("tbtrs", "trtri"), dtype=np.float64)


class Episode(NamedTuple):
    """Measured states (N + 1, 6), and the forces (N,) held from each to the next."""

    y: Array
    u: Array


class _Basis(NamedTuple):
    """The weights in play, as multiples of their prior standard deviations."""

    columns: list[npt.NDArray[np.intp]]
    stds: list[Array]
    parts: list[slice]


def fit(
    episodes: Sequence[Episode], h: float, mirror: bool, gravity: bool, before: HarmonicModel | None
) -> HarmonicModel | None:
    """Return the posterior after episodes, in samples of ``h`` s, sought from the model before if there is one.

    Where that leads nowhere it is sought from nothing.  Where less noise than there is lets the weights follow it,
    twice as much is begun with; None if no attempt succeeds.
    """
    gained = np.concatenate([np.diff(episode.y[:, 3:], axis=0) for episode in episodes])
    size = np.sqrt(np.mean(gained**2, axis=0)) / h + 1e-9
    rates = np.concatenate([(episode.y[1:, 3:] + episode.y[:-1, 3:]) / 2 for episode in episodes])
    scale = np.sqrt(np.mean(products(rates, np.concatenate([e.u for e in episodes])) ** 2, axis=0)) + 1e-9
    center = np.empty((3, 3 + PRODUCTS))
    center[:, :3] = math.log(1.2)
    center[:, 3:] = np.log(0.5 * size[:, None] / scale)  # each product would give half the accelerations seen
    process = _UNEXPLAINED * h * size
    usual, may = scale[by_product(mirror)], [allowed(d, mirror, gravity) for d in range(3)]

    def basis(model: HarmonicModel) -> _Basis:
        stds = [np.sqrt(variances(output.hyper, mirror)[0]) for output in model.outputs]
        columns = [np.flatnonzero(may[d] & (stds[d] * usual > _NEGLIGIBLE * size[d])) for d in range(3)]
        ends = np.cumsum([0, *map(len, columns)]).tolist()
        stds = [std[own] for std, own in zip(stds, columns, strict=True)]
        return _Basis(columns, stds, [slice(a, b) for a, b in pairwise(ends)])

    moved = np.concatenate([np.diff(episode.y[:, :3], axis=0) for episode in episodes]) - h * rates
    noise = np.concatenate([np.sqrt(np.mean(moved**2, axis=0) / 2), 0.03 * h * size])
    none = np.empty(0)
    outputs = tuple(Posterior(none.astype(np.intp), none, none[:, None], hyper) for hyper in center)
    first = HarmonicModel(outputs=outputs, sensor_noise=noise, sample_time=h, mirror=mirror)
    anew = [replace(first, sensor_noise=noise * 2.0**attempt) for attempt in range(_ATTEMPTS)]
    for start in anew if before is None else [before, *anew]:  # a model that new motion contradicts may lead nowhere
        rounds, learns_from = (_ROUNDS, 0) if start is before else (_FIRST_ROUNDS, _UNTAUGHT)
        model, states = start, [episode.y for episode in episodes]
        try:
            with np.errstate(all="ignore"):  # an attempt whose numbers overflow fails, and is made again
                for k in range(rounds):
                    last = k == rounds - 1
                    learn = not last and k >= learns_from
                    model, states = _round(episodes, states, model, basis(model), process, center, last, learn)
            return model
        except np.linalg.LinAlgError:
            continue
    return None


def _round(
    episodes: Sequence[Episode], states: list[Array], model: HarmonicModel, basis: _Basis, process: Array,
    center: Array, last: bool, learn: bool,
) -> tuple[HarmonicModel, list[Array]]:  # fmt: skip
    """Return the posterior that follows from linearizing about states and a model, and the states anew."""
    variance, mirror, h = model.sensor_noise**2, model.mirror, model.sample_time
    now, outputs = np.zeros(basis.parts[-1].stop), []
    for columns, std, part, output in zip(*basis, model.outputs, strict=True):
        _, here, there = np.intersect1d(columns, output.columns, assume_unique=True, return_indices=True)
        now[part][here] = output.mean[there] / std[here]
        outputs.append(output._replace(columns=columns, mean=now[part] * std))
    model = HarmonicModel(outputs=tuple(outputs), sensor_noise=model.sensor_noise, sample_time=h, mirror=mirror)
    slopes, factors, whitened = [], [], []
    for episode, x in zip(episodes, states, strict=True):
        A, after = _samples(model, x, episode.u)
        F = _by_weights(model, x, episode.u, A, basis)
        r = episode.y[1:] - after - np.einsum("kij,kj->ki", A, episode.y[:-1] - x[:-1]) + F @ now
        L = _correlated(A, variance, process)
        slopes.append(A)
        factors.append(L)
        whitened.append((_solve_banded(L, F.reshape(r.size, -1), uplo="L")[0],
                         _solve_banded(L, r.reshape(-1, 1), uplo="L")[0][:, 0]))  # fmt: skip
    regression = _Regression(whitened)
    hypers, ratio = [output.hyper for output in outputs], np.ones(len(now))
    if learn:
        hypers = _likeliest(regression, hypers, center, basis, mirror)
        ratio = _ratio(hypers, basis, mirror)
    _, w, spread, half = regression.posterior(ratio)
    w = ratio * w
    anew, found, expected = [], np.zeros(6), np.zeros(6)
    for episode, A, L, (X, z) in zip(episodes, slopes, factors, whitened, strict=True):
        shared = _solve_banded(L, (z - X @ w)[:, None], uplo="L", trans="T")[0].reshape(-1, 6)
        noise = np.zeros_like(episode.y)
        noise[1:] += shared
        noise[:-1] -= np.einsum("kji,kj->ki", A, shared)
        most = _FARTHEST * model.sensor_noise
        anew.append(episode.y - np.clip(variance * noise, -most, most))
        if learn:
            found += ((variance * noise) ** 2).sum(axis=0)
            expected += _determined(A, L, variance)
    sensor = model.sensor_noise
    if not all(np.isfinite(x).all() for x in anew):
        raise np.linalg.LinAlgError("The states sought have left the numbers.")
    if learn:
        rows = sum(len(z) for _, z in whitened)
        free = max(rows - (len(w) - spread.sum()), 0.1 * rows)
        sensor = sensor * np.sqrt(np.clip(found / expected * rows / free, 0.25, 4.0))
        sensor = np.maximum(sensor, _LEAST * np.concatenate([h * process, process]))
    believed = []
    for columns, std, part, hyper in zip(*basis, hypers, strict=True):
        scale = std * ratio[part]
        covariance = regression.covariance(half, part) * scale * scale[:, None] if last else np.empty((0, 0))
        believed.append(Posterior(columns, w[part] * std, covariance, hyper))
    return HarmonicModel(outputs=tuple(believed), sensor_noise=sensor, sample_time=h, mirror=mirror), anew


class _Regression:
    """Bayesian linear regression with unit noise on weights of unit prior variance, times a ratio: by the shorter way.

    Parameters
    ----------
    data : list of (X, z)
        Rows of features, and targets.
    """

    def __init__(self, data: list[tuple[Array, Array]]) -> None:
        self.tall = sum(len(z) for _, z in data) > data[0][0].shape[1]
        if self.tall:
            self.square, self.moment = sum(X.T @ X for X, _ in data), sum(X.T @ z for X, z in data)
        else:
            self.square, self.moment = (np.concatenate(each) for each in zip(*data, strict=True))

    def posterior(self, ratio: Array) -> tuple[float, Array, Array, Array]:
        """Return the negative log evidence but for a constant, mean, variances, and a root of the covariance."""
        X = self.square * ratio
        S: Array = X * ratio[:, None] if self.tall else X @ X.T
        S[np.diag_indices_from(S)] += 1.0
        root = cholesky(S, lower=True, overwrite_a=True, check_finite=False)
        value = np.log(root.diagonal()).sum()
        inverse, _ = _invert(root, lower=1, overwrite_c=1)
        if self.tall:
            known = inverse @ (ratio * self.moment)
            return value - 0.5 * known @ known, known @ inverse, (inverse**2).sum(axis=0), inverse
        known, half = inverse @ self.moment, inverse @ X
        return value + 0.5 * known @ known, known @ half, 1 - (half**2).sum(axis=0), half

    def covariance(self, half: Array, part: slice) -> Array:
        """Return the covariance of some weights from the root."""
        squared = half[:, part].T @ half[:, part]
        return squared if self.tall else np.eye(len(squared)) - squared


def _ratio(hypers: Sequence[Array], basis: _Basis, mirror: bool) -> Array:
    """Return the prior standard deviations under hyperparameters, as multiples of those of the basis."""
    each = zip(hypers, basis.columns, basis.stds, strict=True)
    return np.concatenate([np.sqrt(variances(hyper, mirror)[0][own]) / std for hyper, own, std in each])


def _likeliest(
    regression: _Regression, hypers: Sequence[Array], center: Array, basis: _Basis, mirror: bool
) -> list[Array]:
    """Return hyperparameters of greater posterior density, the noise given."""
    product = by_product(mirror)

    def loss(flat: Array) -> tuple[float, Array]:
        each = flat.reshape(3, -1)
        value, mean, spread, _ = regression.posterior(_ratio(list(each), basis, mirror))
        excess = 1 - mean**2 - spread
        away = (each - center) / _SPREAD
        slope = away / _SPREAD
        for d, (own, part) in enumerate(zip(basis.columns, basis.parts, strict=True)):
            slope[d, :3] += 0.5 * variances(each[d], mirror)[1][:, own] @ excess[part]
            slope[d, 3:] += np.bincount(product[own], excess[part], PRODUCTS)
        return float(value + 0.5 * (away**2).sum()), slope.ravel()

    bounds = [bound for row in center[:, 3:] for bound in [_LENGTHS] * 3 + [(c - 7, c + 4) for c in row]]
    start = np.clip(np.ravel(hypers), *np.transpose(bounds))
    found = minimize(loss, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": _STEPS})
    return list(found.x.reshape(3, -1))


def _samples(model: HarmonicModel, x: Array, u: Array) -> tuple[Array, Array]:
    """Return the slopes (N, 6, 6) of the samples from states (N + 1, 6), and where they lead (N, 6)."""
    D = np.empty((len(u), 6, 8))
    finer = model.parameters._replace(h=model.sample_time / _SUBSTEPS, substeps=_SUBSTEPS)
    model.model.loops.linearize(x, u, finer, D)
    return D[:, :, :6], D[:, :, 7] + x[1:]


def _by_weights(model: HarmonicModel, x: Array, u: Array, A: Array, basis: _Basis) -> Array:
    """Return the slopes (N, 6, F) of the samples by the weights: what accelerations at a time do by the sample's end.

    They are integrated by Simpson's rule.  What one at the beginning does is in the slopes by the rates; one in the
    middle is interpolated, by Hermite in positions.
    """
    h, N, eye = model.sample_time, len(u), np.eye(3)
    begin, end = A[:, :, 3:], np.tile(np.concatenate([0 * eye, eye]), (N, 1, 1))
    middle = (begin + end) / 2
    middle[:, :3] += h / 8 * (eye - begin[:, 3:])
    half = (x[:-1] + x[1:]) / 2
    half[:, :3] -= h / 8 * (x[1:, 3:] - x[:-1, 3:])
    F = np.zeros((N, 6, basis.parts[-1].stop))
    for effect, at, share in ((begin, x[:-1], h / 6), (middle, half, 4 * h / 6), (end, x[1:], h / 6)):
        known = features(at, u, model.mirror)
        for d, (own, std, part) in enumerate(zip(*basis, strict=True)):
            F[:, :, part] += share * effect[:, :, d, None] * (known[:, own] * std)[:, None]
    return F


def _correlated(A: Array, variance: Array, process: Array) -> Array:
    """Return the banded Cholesky factor of the covariance of n[k + 1] - A[k] n[k] and what motion strays by."""
    own = np.einsum("kij,j,klj->kil", A, variance, A)
    own[:, range(6), range(6)] += variance
    own[:, range(3, 6), range(3, 6)] += process**2
    with_next = -A[1:] * variance
    band = np.zeros((12, 6 * len(A)))
    for i in range(6):
        for j in range(6):
            if j <= i:
                band[i - j, j::6] = own[:, i, j]
            band[6 + i - j, j:-6:6] = with_next[:, i, j]
    return cholesky_banded(band, lower=True, overwrite_ab=True, check_finite=False)


def _determined(A: Array, L: Array, variance: Array) -> Array:
    """Return how much of the variance of the six states' noise, summed over an episode, the motion determines."""
    N = len(A)
    G = np.zeros((N, 6, N + 1, 6))
    G[range(N), :, range(1, N + 1)] = np.diag(variance)
    G[range(N), :, range(N)] = -A * variance
    return (_solve_banded(L, G.reshape(6 * N, -1), uplo="L")[0] ** 2).sum(axis=0).reshape(-1, 6).sum(axis=0)
