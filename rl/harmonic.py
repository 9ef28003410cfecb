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

so that, cut off, the model is linear in 203 functions of the angles times 11 of the rest: a regression.  What can be
known beforehand leaves out weights: mirror symmetry leaves sines to what is even in rates and force, cosines to what is
odd; gravity, if it alone tells up from down, leaves to each product waves of even order, or of odd order alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from controllers.ilqr import Model
from controllers.ilqr_kernels import Flow, make_flow
from dpend.kernels import cos, inline, sin
from dpend.params import Array

_TOGETHER, _APART = 7, 13  # the angle between the links is what the accelerations depend on least smoothly
ORDER = (_TOGETHER + _APART) // 2
WAVES = np.array(
    [
        (m, n)
        for m in range(ORDER + 1)
        for n in range(-ORDER, ORDER + 1)
        if (m or n > 0) and abs(m + n) <= _TOGETHER and abs(m - n) <= _APART
    ]
)
"""Orders (m, n) of the waves, one of each pair of opposite ones."""
_EVEN, PRODUCTS = 7, 11
_TURN = 2 * math.pi * np.arange(32) / 32
_GRID = (_TURN[:, None] + 0 * _TURN, 0 * _TURN[:, None] + _TURN, _TURN[:, None] - _TURN)
_SUBSTEPS = 2
_TURNED = np.array([-1, 1, -1, -1, 1, 1, 1, -1, -1, 1, 1])
"""Sign of each product's coefficient for links, after half a turn of everything; for the cart it is the opposite."""


class Field(NamedTuple):
    """Weights as the compiled code takes them: of sines and cosines, three columns for each product."""

    waves: npt.NDArray[np.intp]
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
    G, G1, G2 = np.zeros(3 * PRODUCTS), np.zeros(3 * PRODUCTS), np.zeros(3 * PRODUCTS)
    for j in range(c.cosines_start, 3 * PRODUCTS):
        G[j] = c.cosines[0, j]
    for k in range(len(c.waves)):
        m, n = c.waves[k, 0], c.waves[k, 1]
        cn, sn = c2[abs(n)], s2[abs(n)] if n >= 0 else -s2[abs(n)]
        sine = s1[m] * cn + c1[m] * sn
        cosine = c1[m] * cn - s1[m] * sn
        for j in range(c.sines_end):
            G[j] += c.sines[k, j] * sine
        for j in range(c.cosines_start, 3 * PRODUCTS):
            G[j] += c.cosines[k + 1, j] * cosine
        if slopes:
            for j in range(c.sines_end):
                G1[j] += c.sines[k, j] * (m * cosine)
                G2[j] += c.sines[k, j] * (n * cosine)
            for j in range(c.cosines_start, 3 * PRODUCTS):
                G1[j] -= c.cosines[k + 1, j] * (m * sine)
                G2[j] -= c.cosines[k + 1, j] * (n * sine)
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


def features(x: Array, u: Array, mirror: bool) -> Array:
    """Return what the weights are of: sines times products, then cosines times products."""
    q = products(x[:, 3:], u)
    phase = x[:, 1:3] @ WAVES.T
    sines, cosines = np.sin(phase), np.column_stack([np.ones(len(x)), np.cos(phase)])
    even, odd = (q[:, :_EVEN], q[:, _EVEN:]) if mirror else (q, q)
    parts = (sines[:, :, None] * even[:, None], cosines[:, :, None] * odd[:, None])
    return np.concatenate([part.reshape(len(x), -1) for part in parts], axis=1)


def by_product(mirror: bool) -> npt.NDArray[np.intp]:
    """Return which product each feature has."""
    even, odd = (np.arange(_EVEN), np.arange(_EVEN, PRODUCTS)) if mirror else (np.arange(PRODUCTS),) * 2
    return np.concatenate([np.tile(even, len(WAVES)), np.tile(odd, len(WAVES) + 1)])


def allowed(output: int, mirror: bool, gravity: bool) -> npt.NDArray[np.bool_]:
    """Return which features an acceleration may have.

    With ``gravity`` known, half a turn of everything, which reverses the cart's motion, the force and gravity, leaves
    motion what it is: each coefficient keeps its sign or changes it, and has waves of m + n even alone, or odd alone.
    """
    even, odd = (_EVEN, PRODUCTS - _EVEN) if mirror else (PRODUCTS, PRODUCTS)
    orders = WAVES.sum(axis=1)
    signs = (-1.0) ** np.concatenate([np.repeat(orders, even), np.repeat(np.append(0, orders), odd)])
    return (signs == (_TURNED if output else -_TURNED)[by_product(mirror)]) | (not gravity)


def variances(hyper: Array, mirror: bool) -> tuple[Array, Array]:
    """Return the prior variances of the weights of one acceleration, and their slopes, relative, by three lengths."""
    per, amplitudes = np.exp(-2 * hyper[:3]), np.exp(2 * hyper[3:])
    fall = [p * (np.cos(each) - 1) for p, each in zip(per, _GRID, strict=True)]
    theta = np.exp(sum(fall))
    spectra = [np.fft.fft2(each).real / theta.size for each in (theta, *(-2 * f * theta for f in fall))]
    still = np.array([each[0, 0] for each in spectra])
    waves = 2 * np.array([each[WAVES[:, 0], WAVES[:, 1]] for each in spectra])
    even, odd = (amplitudes[:_EVEN], amplitudes[_EVEN:]) if mirror else (amplitudes, amplitudes)
    waves[0] = np.maximum(waves[0], 1e-12 * still[0])
    both = np.column_stack([still, waves])
    found = np.concatenate([np.outer(waves[0], even).ravel(), np.outer(both[0], odd).ravel()])
    slopes = [np.concatenate([np.repeat(w / waves[0], len(even)), np.repeat(b / both[0], len(odd))])
              for w, b in zip(waves[1:], both[1:], strict=True)]  # fmt: skip
    return found, np.array(slopes)


class Posterior(NamedTuple):
    """What is believed of the weights of one acceleration."""

    columns: npt.NDArray[np.intp]
    """Features (n,) that have one; that of the others is zero."""
    mean: Array
    covariance: Array
    hyper: Array
    """Logarithms (14,) of three length scales (both angles, and that between the links) and eleven amplitudes."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HarmonicModel:
    """The posterior of the weights, given episodes.

    Parameters
    ----------
    outputs : tuple of three Posterior
        One an acceleration.
    sensor_noise : ndarray (6,)
        Standard deviations of the measured states, m, rad, m/s and rad/s, as the episodes have them.
    sample_time : float
        s.
    mirror : bool
        Whether mirrored motion is motion.
    """

    outputs: tuple[Posterior, ...]
    sensor_noise: Array
    sample_time: float
    mirror: bool

    kind = "harmonic"

    @property
    def parameters(self) -> Flow:
        """What :data:`step` takes."""
        n, of_sines = len(WAVES), _EVEN if self.mirror else PRODUCTS
        cut = n * of_sines
        sines, cosines = np.zeros((n, 3 * PRODUCTS)), np.zeros((n + 1, 3 * PRODUCTS))
        start = 3 * _EVEN if self.mirror else 0
        weights = np.zeros((3, len(by_product(self.mirror))))
        for row, output in zip(weights, self.outputs, strict=True):
            row[output.columns] = output.mean
        sines[:, : 3 * of_sines] = weights[:, :cut].reshape(3, n, -1).transpose(1, 2, 0).reshape(n, -1)
        cosines[:, start:] = weights[:, cut:].reshape(3, n + 1, -1).transpose(1, 2, 0).reshape(n + 1, -1)
        used = (sines != 0).any(axis=1) | (cosines[1:] != 0).any(axis=1)
        field = Field(WAVES[used], sines[used], cosines[np.append(True, used)], 3 * of_sines, start)
        return Flow(field, self.sample_time / _SUBSTEPS, _SUBSTEPS)

    @property
    def model(self) -> Model:
        """What a planner takes."""
        sources = Path(__file__), Path(__file__).parent.parent / "controllers"
        return Model(step=_step, linearize=_linearize, parameters=self.parameters, sources=sources)

    @property
    def noise(self) -> Array:
        """Standard deviations (3,) of the measured rates that the model infers, m/s and rad/s."""
        return self.sensor_noise[3:]

    def accelerations(self, x: Array, u: Array) -> Array:
        """Return the mean accelerations (N, 3) in states (N, 6) under forces (N,)."""
        known = features(x, u, self.mirror)
        return np.column_stack([known[:, output.columns] @ output.mean for output in self.outputs])

    def uncertainty(self, x: Array, u: Array) -> Array:
        """Return the standard deviations (N, 3) of the accelerations in states (N, 6) under forces (N,)."""
        known = features(x, u, self.mirror)
        seen = [known[:, output.columns] for output in self.outputs]
        squares = [((a @ output.covariance) * a).sum(axis=1) for a, output in zip(seen, self.outputs, strict=True)]
        return np.sqrt(np.maximum(np.column_stack(squares), 0.0))

    def arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Return what it is made of."""
        plain = {"sensor_noise": self.sensor_noise, "sample_time": self.sample_time, "mirror": self.mirror}
        parts = {
            f"{name}_{d}": value for d, output in enumerate(self.outputs) for name, value in output._asdict().items()
        }
        return {name: np.asarray(value) for name, value in (plain | parts).items()}

    @classmethod
    def from_arrays(cls, sensor_noise: Any, sample_time: Any, mirror: Any, **parts: Any) -> HarmonicModel:
        """Build it from what :meth:`arrays` returned."""
        outputs = tuple(Posterior(*(parts[f"{name}_{d}"] for name in Posterior._fields)) for d in range(3))
        return cls(outputs=outputs, sensor_noise=sensor_noise, sample_time=float(sample_time), mirror=bool(mirror))
