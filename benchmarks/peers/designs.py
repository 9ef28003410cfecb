"""Holds, Riccati equations and margins beside scipy's, python-control's and Drake's."""

from __future__ import annotations

import warnings
from collections import Counter
from importlib import import_module
from typing import Any

import control
import numpy as np
import scipy

import dpend
from benchmarks.peers.cases import Row, matrix_error, rods, row
from controllers import LQR
from controllers.sdre import solve_riccati
from dpend.params import Array

_FREQUENCIES = 1000
# The Riccati equations of badly scaled problems lose as many digits as their solvers let them: least by doubling.
_TOLERANCES = {"zero-order hold": 1e-12, "margins of gain and phase": 1e-4}
_RICCATI = 1e-5


class Errors:
    """The errors of each quantity and engine, as they are found."""

    def __init__(self) -> None:
        self.found: dict[tuple[str, str], list[float]] = {}
        self.unanswered: Counter[tuple[str, str]] = Counter()

    def add(self, quantity: str, engine: str, *pairs: tuple[Any, Any]) -> None:
        """Note the largest error of some pairs of matrices, ours first."""
        errors = [matrix_error(ours, theirs) for ours, theirs in pairs]
        self.found.setdefault((quantity, engine), []).append(max(errors))

    def rows(self) -> list[Row]:
        """Return a line for each quantity and engine."""
        return [
            row(*key, found, _TOLERANCES.get(key[0], _RICCATI), self.unanswered[key])
            for key, found in self.found.items()
        ]


def designs(n: int, seed: int, *, drake: bool, slicot: bool) -> list[Row]:
    """Compare ``n`` designs on random rods about any equilibrium, of any weights, discounts and sample times."""
    rng = np.random.default_rng(seed)
    with_drake: Any = import_module("pydrake.all") if drake else None
    drake_solvers: dict[str, Any] = {}
    if with_drake is not None:
        regulator = with_drake.DiscreteTimeLinearQuadraticRegulator
        drake_solvers = {"LQR": regulator, "LQR with a discount": regulator}
        drake_solvers["continuous LQR"] = with_drake.LinearQuadraticRegulator
    errors = Errors()
    for k in range(n):
        target = list(dpend.EQUILIBRIA)[k % 4]
        rig, Q, R = _problem(rng, friction=k % 2 == 0)
        A, B = dpend.linearize(rig.params, dpend.EQUILIBRIA[target])
        Ad, Bd = dpend.discretize(A, B, rig.sample_time)
        discount = rng.uniform(0.99, 1)
        law = LQR(rig, Q, R, target=target)
        discounted = LQR(rig, Q, R, target=target, discount=discount)
        quantity = "zero-order hold"
        held = scipy.signal.cont2discrete((A, B, np.eye(6), np.zeros((6, 1))), rig.sample_time)[:2]
        errors.add(quantity, "scipy.signal.cont2discrete", (Ad, held[0]), (Bd, held[1]))
        if with_drake is not None:
            system = with_drake.LinearSystem(A, B, np.eye(6), np.zeros((6, 1)))
            sampled = with_drake.DiscreteTimeApproximation(system, rig.sample_time)
            errors.add(quantity, "Drake", (Ad, sampled.A()), (Bd, sampled.B()))
        P, _ = solve_riccati(Ad[None], Bd[None], Q, R)
        errors.add(
            "Riccati equation by doubling, as in SDRE",
            "scipy",
            (P[0], scipy.linalg.solve_discrete_are(Ad, Bd, Q, [[R]])),
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # some of these gains are too high to be held
            continuous = LQR(rig, Q, R, target=target, design="continuous")
        laws = {"LQR": law, "LQR with a discount": discounted, "continuous LQR": continuous}
        root = np.sqrt(discount)
        problems = {"LQR": (Ad, Bd), "LQR with a discount": (root * Ad, root * Bd), "continuous LQR": (A, B)}
        for name, pair in problems.items():
            quantity = f"{name}, gain and cost"
            if slicot:
                solve = control.lqr if name == "continuous LQR" else control.dlqr
                key = quantity, "python-control by SLICOT"
                try:
                    K, S, _ = solve(*pair, Q, [[R]], method="slycot")
                except ArithmeticError:  # by its own word for badly scaled problems
                    errors.unanswered[key] += 1
                else:
                    errors.add(*key, (laws[name].K, K), (laws[name].P, S))
            if with_drake is not None:
                K, S = drake_solvers[name](*pair, Q, np.array([[R]]))
                errors.add(quantity, "Drake", (laws[name].K, K), (laws[name].P, S))
    return errors.rows()


def margins(n: int, seed: int) -> list[Row]:
    """Compare gain and phase margins of ``n`` sampled loops about upright with python-control's of their response.

    Not with what python-control finds by roots of polynomials, its own choice for such a loop: with six poles near
    z = 1 these are far off.  Not about other equilibria either: the response of an undamped link that
    hangs is infinite somewhere, and no grid of frequencies shows what happens there.  At z = -1, where a response
    ends, the loop is real, and may cross there.
    """
    rng = np.random.default_rng(seed)
    errors = Errors()
    for k in range(n):
        rig, Q, R = _problem(rng, friction=k % 2 == 0)
        law, nyquist = LQR(rig, Q, R), np.pi / rig.sample_time
        ours = law.margins()
        loop = control.ss(*dpend.discretize(*dpend.linearize(rig.params), rig.sample_time), law.K, 0, rig.sample_time)
        response = control.frd(loop, np.geomspace(1e-4 * nyquist, nyquist * (1 - 1e-9), _FREQUENCIES))
        gains, phases, *_ = control.stability_margins(response, returnall=True)
        end = float(np.real(loop(-1.0)))
        gains = np.append(gains, [-1 / end] if end < 0 else [])
        pairs = [
            (ours.phase, np.deg2rad(np.abs(np.remainder(phases + 180, 360) - 180).min())),
            (ours.gain_high, gains[gains > 1].min()),
            (ours.gain_low, gains[gains < 1].max()),
        ]
        errors.add("margins of gain and phase", "python-control", *(([a], [b]) for a, b in pairs))
    return errors.rows()


def _problem(rng: np.random.Generator, *, friction: bool) -> tuple[dpend.Rig, Array, float]:
    """Draw a rig and weights of state and force."""
    rig = dpend.Rig(params=rods(rng, friction=friction), sample_time=rng.uniform(0.005, 0.05))
    return rig, np.diag(10 ** rng.uniform(-1, 2, 6)), float(10 ** rng.uniform(-2, 1))
