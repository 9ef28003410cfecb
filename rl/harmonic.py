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
odd; gravity, if it alone tells up from down, leaves to each product waves of even order, or of odd order alone.  Plans
are made on cubic splines that equal the :math:`c_k` on a grid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from controllers.ilqr import Model
from controllers.ilqr_kernels import Flow, make_flow
from dpend.kernels import inline
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
_WHOLE = 2 * math.pi
_TURN = _WHOLE * np.arange(32) / 32
_GRID = (_TURN[:, None] + 0 * _TURN, 0 * _TURN[:, None] + _TURN, _TURN[:, None] - _TURN)
_SUBSTEPS = 2
_KNOTS = 64  # of the splines that planning takes in the place of the waves, about each angle
_TURNED = np.array([-1, 1, -1, -1, 1, 1, 1, -1, -1, 1, 1])
"""Sign of each product's coefficient for links, after half a turn of everything; for the cart it is the opposite."""


class Field(NamedTuple):
    """The products' coefficients over both angles as the compiled code takes them: of cubic B-splines."""

    splines: Array
    """On a grid of both angles, a row (33,) each: eleven products, three accelerations a product."""


def products(rates: Array, u: Array) -> Array:
    """Return the eleven products (N, 11) of rates (N, 3) and forces (N,): seven even ones, then four odd ones."""
    v, w1, w2 = rates.T
    return np.stack([np.ones_like(v), v * v, v * w1, v * w2, w1 * w1, w1 * w2, w2 * w2, u, v, w1, w2], axis=1)


@inline
def _basis(angle):
    """Return the first of four splines that are not zero at an angle, the four, and their slopes."""
    turns = angle * (1.0 / _WHOLE)
    share = (turns - math.floor(turns)) * _KNOTS
    i = min(int(share), _KNOTS - 1) if share >= 0.0 else 0  # and so if it is not a number
    t = share - i
    r, per = 1.0 - t, 0.5 * _KNOTS / _WHOLE
    return (
        i,
        (r * r * r / 6.0, t * t * (0.5 * t - 1.0) + 2.0 / 3.0, r * r * (0.5 * r - 1.0) + 2.0 / 3.0, t * t * t / 6.0),
        (-per * r * r, per * t * (3.0 * t - 4.0), -per * r * (3.0 * r - 4.0), per * t * t),
    )


@inline
def _sums(x, c, slopes):
    """Return the coefficients of the products (33,), and their slopes by both angles if asked for."""
    i1, b1, d1 = _basis(x[1])
    i2, b2, d2 = _basis(x[2])
    G, G1, G2 = np.zeros(3 * PRODUCTS), np.zeros(3 * PRODUCTS), np.zeros(3 * PRODUCTS)
    for a in range(4):
        for b in range(4):
            row, here, by1, by2 = c.splines[i1 + a, i2 + b], b1[a] * b2[b], d1[a] * b2[b], b1[a] * d2[b]
            for j in range(3 * PRODUCTS):
                G[j] += here * row[j]
            if slopes:
                for j in range(3 * PRODUCTS):
                    G1[j] += by1 * row[j]
                    G2[j] += by2 * row[j]
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


def _splines(weights: Array, mirror: bool) -> Array:
    """Return the cubic splines that equal the series of given weights (F, 3) at the knots, wrapped about."""
    of_sines, of_cosines = (_EVEN, PRODUCTS - _EVEN) if mirror else (PRODUCTS, PRODUCTS)
    sines, cosines = np.repeat(WAVES, of_sines, axis=0), np.repeat([(0, 0), *WAVES], of_cosines, axis=0)
    spectrum = np.zeros((_KNOTS, _KNOTS, PRODUCTS, 3), dtype=np.complex128)
    spectrum[*sines.T, by_product(mirror)[: len(sines)]] = -1j * weights[: len(sines)]
    spectrum[*cosines.T, by_product(mirror)[len(sines) :]] += weights[len(sines) :]
    own = (2 + np.cos(_WHOLE * np.arange(_KNOTS) / _KNOTS)) / 3  # of a wave, in splines of its own values at the knots
    spectrum *= _KNOTS**2 / (own[:, None] * own)[:, :, None, None]
    knots = np.fft.ifft2(spectrum, axes=(0, 1)).real
    return np.pad(knots.reshape(_KNOTS, _KNOTS, -1), ((1, 2), (1, 2), (0, 0)), mode="wrap")


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

    @cached_property
    def parameters(self) -> Flow:
        """What a sample takes beside state and force."""
        weights = np.zeros((len(by_product(self.mirror)), 3))
        for column, output in zip(weights.T, self.outputs, strict=True):
            column[output.columns] = output.mean
        return Flow(Field(_splines(weights, self.mirror)), self.sample_time / _SUBSTEPS, _SUBSTEPS)

    @cached_property
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

    def drawn(self, rng: np.random.Generator) -> HarmonicModel:
        """Return a model drawn from what is believed."""

        def draw(output: Posterior) -> Posterior:
            variances, axes = np.linalg.eigh(output.covariance)
            moved = axes @ (np.sqrt(np.maximum(variances, 0)) * rng.standard_normal(len(variances)))
            return output._replace(mean=output.mean + moved)

        return replace(self, outputs=tuple(map(draw, self.outputs)))

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
