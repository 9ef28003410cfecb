"""The compiled loops of iLQR: a plan's cost, its derivatives, the backward pass and the rollout, and what repeats them.

Those that follow a plant are built for one by :func:`make_loops`, from ``step(x, u, parameters)``, a sample, and
``linearize(x, u, parameters, D)``, its slopes along a plan; the others know no plant.  Gradients and Hessians are
halved throughout: the cost is a sum of squares, and the factors of two cancel.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from enum import IntEnum
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np

from dpend.kernels import OPTIONS, acceleration_slopes, axpy, compiled, cos, inline, make_sample, rates, sin

from .residuals import make_residuals

_TURN = 2 * math.pi
_residuals = inline(make_residuals(sin))
_DIFFERENCE = 1e-5  # of metres, radians, their rates and newtons
_BLOCK = 32  # samples linearized side by side, so that LLVM turns the loop over them into vector instructions


class Problem(NamedTuple):
    """Target, limits and weights, as the compiled code takes them."""

    force_limit: float
    target: tuple[float, ...]
    turn: float
    """Angle after which the target recurs; zero where only this target counts."""
    Q: tuple[float, ...]
    R: float
    soft_track: float
    track_weight: float
    hard_track: float
    """Where a second, far steeper wall begins, next to the track's end."""
    hard_weight: float
    soft_angle: float
    angle_weight: float


class Flow(NamedTuple):
    """Parameters of a plant in continuous time, and the Runge-Kutta steps of a sample."""

    field: Any
    h: float
    substeps: int


class Setting(NamedTuple):
    """What all plans of a receding horizon have in common, as the compiled code takes it."""

    problem: Problem
    parameters: Any
    P: Any
    feedback: Any
    """Gains (6,) of the regulator, the sign being that of the force."""
    push: float
    """Standard deviation of random forces, N, each held for so many samples, on a cart drawn to its place by gains."""
    hold: int
    centring: Any
    line: Any
    """Shares (N + 1,) of the way along a straight line."""


class Plans(NamedTuple):
    """Plans side by side, a row each, and the figures of their last improvement."""

    x: Any
    """States (n, N + 1, 6)."""
    u: Any
    """Forces (n, N)."""
    K: Any
    """Feedback gains (n, N, 6)."""
    cost: Any
    converged: Any
    tried: Any
    """Iterations, and how many of them were accepted."""
    accepted: Any

    @classmethod
    def blank(cls, n: int, N: int) -> Plans:
        """Return memory for n plans of N samples."""
        converged, tried, accepted = np.zeros(n, np.bool_), np.zeros(n, np.int64), np.zeros(n, np.int64)
        return cls(
            np.zeros((n, N + 1, 6)), np.zeros((n, N)), np.zeros((n, N, 6)), np.zeros(n), converged, tried, accepted
        )

    def take(self, rows: Any, others: Plans, theirs: Any = slice(None)) -> None:
        """Take over other plans, all or some, in some rows."""
        for mine, given in zip(self, others, strict=True):
            mine[rows] = given[theirs]

    def take_cheaper(self, rows: Any, others: Plans) -> None:
        """Take over those of other plans that cost less than the ones in some rows, which may have no finite cost."""
        known = np.isfinite(self.cost[rows])
        better = np.isfinite(others.cost) & ~(known & (others.cost >= self.cost[rows]))
        self.take(rows[better], others, better)


class Guess(IntEnum):
    """What an improvement starts from."""

    AS_IT_IS = 0
    """The plan in the row, be it a motion or not."""
    FOLLOWED = 1
    """The motion from the given state by the plan's forces and gains."""
    CARRIED_ON = 2
    """That of the plan shifted by a sample, at whose end the saturated regulator is; else that under no force."""
    REGULATED = 3
    """The motion under the saturated regulator."""
    STRAIGHT = 4
    """A straight line of states to the target, which is no motion."""
    DRIVEN = 5
    """The motion under random forces, without gains."""


# As numba takes them.
_AS_IT_IS, _FOLLOWED, _CARRIED_ON, _REGULATED, _STRAIGHT, _DRIVEN = map(int, Guess)


class Loops(NamedTuple):
    """The compiled loops that follow one plant."""

    linearize: Any
    rollout: Any
    improve: Any


@inline
def _row(a, k):
    return a[k, 0], a[k, 1], a[k, 2], a[k, 3], a[k, 4], a[k, 5]


@inline
def _set_row(a, k, x):
    a[k, 0] = x[0]
    a[k, 1] = x[1]
    a[k, 2] = x[2]
    a[k, 3] = x[3]
    a[k, 4] = x[4]
    a[k, 5] = x[5]


@inline
def _clip(u, limit):
    return max(min(u, limit), -limit)


def nearest_target(x, p):
    """Return the target by the whole turns that are nearest to a state."""
    pos, th1, th2, vel, om1, om2 = p.target
    return (
        pos,
        th1 + p.turn * np.rint((x[1] - th1) * (1.0 / _TURN)),
        th2 + p.turn * np.rint((x[2] - th2) * (1.0 / _TURN)),
        vel,
        om1,
        om2,
    )


_nearest = inline(nearest_target)


@compiled
def problem_at(x, p):
    """Return the problem from a state on.

    With walls about the target, its turns are those of the state.  Where the cart already stands within the soft wall
    of the track, a steep one keeps a plan from using what is left of it.
    """
    pos, th1, th2, vel, om1, om2 = p.target
    if p.turn == 0.0:
        th1 += _TURN * np.rint((x[1] - th1) / _TURN)
        th2 += _TURN * np.rint((x[2] - th2) / _TURN)
    hard = 1e4 * p.track_weight if abs(x[0]) > p.soft_track else 0.0
    return Problem(
        p.force_limit,
        (pos, th1, th2, vel, om1, om2),
        p.turn,
        p.Q,
        p.R,
        p.soft_track,
        p.track_weight,
        p.hard_track,
        hard,
        p.soft_angle,
        p.angle_weight,
    )


@numba.njit(forceinline=True, error_model="numpy")  # not fused: so rounded as numpy would
def _between(share, start, end):
    return (1.0 - share) * start + share * end


@inline
def _beyond(value, soft):
    """Return by how much, with its sign, a value is beyond a bound on either side."""
    return max(value - soft, 0.0) + min(value + soft, 0.0)


@inline
def _walls(x, target, p):
    """Return how far a state is into the walls."""
    return (
        _beyond(x[0], p.soft_track),
        _beyond(x[0], p.hard_track),
        _beyond(x[1] - target[1], p.soft_angle),
        _beyond(x[2] - target[2], p.soft_angle),
    )


@inline
def _wall_cost(x, target, p):
    soft, hard, b, c = _walls(x, target, p)
    return p.track_weight * soft * soft + p.hard_weight * hard * hard + p.angle_weight * (b * b + c * c)


@inline
def _stage_cost(x, u, p):
    target = _nearest(x, p)
    r = _residuals(x, target)
    cost = p.R * u * u + _wall_cost(x, target, p)
    for i in range(6):
        cost += p.Q[i] * r[i] * r[i]
    return cost


@inline
def _final_cost(x, P, p):
    target = _nearest(x, p)
    r = _residuals(x, target)
    cost = _wall_cost(x, target, p)
    for i in range(6):
        row = 0.0
        for j in range(6):
            row += P[i, j] * r[j]
        cost += r[i] * row
    return cost


@compiled
def cost_of(x, u, p, P):
    """Return the cost of states and forces, be they a motion or not."""
    cost = 0.0
    for k in range(len(u)):
        cost += _stage_cost(_row(x, k), u[k], p)
    return cost + _final_cost(_row(x, len(u)), P, p)


@inline
def _residual_slopes(x, target):
    """Return d e_i / d x_i; every residual depends on its own state alone.

    Their own curvature is left out, as in the Gauss-Newton method: so the Hessian of the cost stays positive, also
    where a link hangs and the cost is greatest.
    """
    return 1.0, cos(0.5 * (x[1] - target[1])), cos(0.5 * (x[2] - target[2])), 1.0, 1.0, 1.0


@inline
def _add_walls(x, target, p, slopes, column, curvatures):
    """Add the walls' halved slopes to a column of one array, and their halved curvatures to the diagonal of another.

    A wall curves only on its far side, where it also has a slope; that jump is why a step is tried before it is taken.
    """
    soft, hard, b, c = _walls(x, target, p)
    slopes[0, column] += p.track_weight * soft + p.hard_weight * hard
    slopes[1, column] += p.angle_weight * b
    slopes[2, column] += p.angle_weight * c
    curvatures[0, 0] += (p.track_weight if soft != 0.0 else 0.0) + (p.hard_weight if hard != 0.0 else 0.0)
    curvatures[1, 1] += p.angle_weight if b != 0.0 else 0.0
    curvatures[2, 2] += p.angle_weight if c != 0.0 else 0.0


@inline
def _set_slopes(J, stage, j, slopes):
    for a in range(6):
        for b in range(3):
            J[stage, 3 * a + b, j] = slopes[a][b]


@inline
def _tangent(J, s, j, z, push):
    """Return the rates of a small deviation z under a small force, from the slopes at a stage.

    The deviation's own rates are its velocities; the accelerations have no slope by the position z[0].
    """
    return (
        z[3],
        z[4],
        z[5],
        _along(J, s, 0, j, z, push),
        _along(J, s, 1, j, z, push),
        _along(J, s, 2, j, z, push),
    )


@inline
def _along(J, s, b, j, z, push):
    return (
        J[s, b, j] * z[1]
        + J[s, 3 + b, j] * z[2]
        + J[s, 6 + b, j] * z[3]
        + J[s, 9 + b, j] * z[4]
        + J[s, 12 + b, j] * z[5]
        + J[s, 15 + b, j] * push
    )


def make_flow(rates: Any, field: Any) -> tuple[Any, Any]:
    """Build a sample and its slopes of a plant in continuous time, with parameters that are a :class:`Flow`.

    ``rates(x, f, c)`` are six time derivatives, ``f`` three generalised forces; ``field(x, f, c)`` returns them with
    the slopes of the accelerations, as :func:`dpend.equations.make_acceleration_slopes` states them.
    """
    sample = make_sample(rates)

    @inline
    def step(x, u, parameters):
        return sample(x, (u, 0.0, 0.0), parameters.field, parameters.h, parameters.substeps)

    def linearize(x, u, parameters, D):
        """Fill D (N, 6, 8): seven columns of slopes of the sample by (x, u), and the gap from the next state.

        The derivative of a Runge-Kutta step is the same Runge-Kutta step of the linearized plant, with the slopes of
        its four stages.  So these are visited once, their slopes kept, and six deviations led through them; the
        seventh, of the position, stays what it is, as nothing depends on where the cart stands.
        """
        c = parameters.field
        h = parameters.h
        N = len(u)
        now = np.empty((6, _BLOCK))
        Z = np.empty((6, 6, _BLOCK))  # deviation (five states, then the force), state, sample
        J = np.empty(
            (4, 18, _BLOCK)
        )  # stage, slope of an acceleration, sample: the sample last, for vector instructions
        for start in range(0, N, _BLOCK):
            m = min(_BLOCK, N - start)
            for j in range(m):
                for i in range(6):
                    now[i, j] = x[start + j, i]
            Z[:] = 0.0
            for i in range(5):
                Z[i, i + 1, :] = 1.0
            for _ in range(parameters.substeps):
                for j in range(m):
                    f = (u[start + j], 0.0, 0.0)
                    x1 = (now[0, j], now[1, j], now[2, j], now[3, j], now[4, j], now[5, j])
                    k1, slopes = field(x1, f, c)
                    _set_slopes(J, 0, j, slopes)
                    x2 = axpy(x1, k1, 0.5 * h)
                    k2, slopes = field(x2, f, c)
                    _set_slopes(J, 1, j, slopes)
                    x3 = axpy(x1, k2, 0.5 * h)
                    k3, slopes = field(x3, f, c)
                    _set_slopes(J, 2, j, slopes)
                    x4 = axpy(x1, k3, h)
                    k4, slopes = field(x4, f, c)
                    _set_slopes(J, 3, j, slopes)
                    for i in range(6):
                        now[i, j] = x1[i] + h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i])
                for d in range(6):
                    push = 1.0 if d == 5 else 0.0
                    for j in range(m):
                        z = (Z[d, 0, j], Z[d, 1, j], Z[d, 2, j], Z[d, 3, j], Z[d, 4, j], Z[d, 5, j])
                        k1 = _tangent(J, 0, j, z, push)
                        k2 = _tangent(J, 1, j, axpy(z, k1, 0.5 * h), push)
                        k3 = _tangent(J, 2, j, axpy(z, k2, 0.5 * h), push)
                        k4 = _tangent(J, 3, j, axpy(z, k3, h), push)
                        for i in range(6):
                            Z[d, i, j] = z[i] + h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i])
            for j in range(m):
                k = start + j
                for i in range(6):
                    D[k, i, 0] = 1.0 if i == 0 else 0.0
                    for d in range(6):
                        D[k, i, d + 1] = Z[d, i, j]
                    D[k, i, 7] = now[i, j] - x[k + 1, i]

    return step, linearize


def make_differences(step: Any) -> Any:
    """Build the slopes of a sample by central differences, for a plant that states none."""

    @inline
    def moved(x, j, way):
        return (
            x[0] + (way if j == 0 else 0.0),
            x[1] + (way if j == 1 else 0.0),
            x[2] + (way if j == 2 else 0.0),
            x[3] + (way if j == 3 else 0.0),
            x[4] + (way if j == 4 else 0.0),
            x[5] + (way if j == 5 else 0.0),
        )

    def linearize(x, u, parameters, D):
        for k in range(len(u)):
            now = _row(x, k)
            after = step(now, u[k], parameters)
            for i in range(6):
                D[k, i, 7] = after[i] - x[k + 1, i]
            for j in range(7):
                push = _DIFFERENCE if j == 6 else 0.0
                ahead = step(moved(now, j, _DIFFERENCE), u[k] + push, parameters)
                behind = step(moved(now, j, -_DIFFERENCE), u[k] - push, parameters)
                for i in range(6):
                    D[k, i, j] = (ahead[i] - behind[i]) / (2.0 * _DIFFERENCE)

    return linearize


@compiled
def backward(x, u, p, P, D, damping, du, K):
    r"""Run the Riccati recursion back to front; fill the steps of the forces du (N,) and the gains K (N, 6).

    Half the cost to go from sample k is taken to change by s'dx + dx'S dx / 2.  With the columns M = (A, B) of a
    sample, G = M'SM plus the stage's own curvature, and its last column the gradient.  Return the halved first and
    second order changes of the cost under the full step, and the greatest halved slope of the cost by any state.
    """
    N = len(u)
    S = np.empty((6, 6))
    s = np.empty((6, 1))
    W = np.empty((6, 8))
    G = np.empty((7, 8))
    end = _row(x, N)
    target = _nearest(end, p)
    r = _residuals(end, target)
    e = _residual_slopes(end, target)
    for i in range(6):
        total = 0.0
        for j in range(6):
            total += P[i, j] * r[j]
            S[i, j] = e[i] * P[i, j] * e[j]
        s[i, 0] = e[i] * total
    _add_walls(end, target, p, s, 0, S)
    first = 0.0
    second = 0.0
    steepest = 0.0
    for k in range(N - 1, -1, -1):
        for i in range(6):
            for j in range(8):
                W[i, j] = S[i, 0] * D[k, 0, j]
            for b in range(1, 6):
                for j in range(8):
                    W[i, j] += S[i, b] * D[k, b, j]
            W[i, 7] += s[i, 0]  # the gradient where the sample really ends, a gap away from the next state
            steepest = max(steepest, abs(s[i, 0]))
        for i in range(7):
            for j in range(8):
                G[i, j] = D[k, 0, i] * W[0, j]
            for b in range(1, 6):
                for j in range(8):
                    G[i, j] += D[k, b, i] * W[b, j]
        now = _row(x, k)
        target = _nearest(now, p)
        r = _residuals(now, target)
        e = _residual_slopes(now, target)
        for i in range(6):
            G[i, 7] += p.Q[i] * e[i] * r[i]
            G[i, i] += p.Q[i] * e[i] * e[i]
        _add_walls(now, target, p, G, 7, G)
        Qu = G[6, 7] + p.R * u[k]
        Quu = G[6, 6] + p.R
        # Damping is relative, as a force's curvature runs over orders of magnitude along a plan: in proportion, it
        # shortens every step alike.  What is predicted below is the undamped cost, under the damped step.
        damped = Quu * (1.0 + damping)
        wanted = -Qu / damped
        step = max(min(wanted, p.force_limit - u[k]), -p.force_limit - u[k])
        # With one force the box-constrained problem has this closed solution.  Where it is clamped, a small deviation
        # of the state leaves the force at its limit, so there is no feedback.
        gain = -1.0 / damped if step == wanted else 0.0
        du[k] = step
        first += step * Qu
        second += step * step * Quu
        for i in range(6):
            K[k, i] = gain * G[6, i]
        # In full rather than by the shorter form G - G_xu G_ux / G_uu, which holds only without damping and clamping.
        for i in range(6):
            s[i, 0] = G[i, 7] + step * G[6, i] + K[k, i] * (Quu * step + Qu)
            for j in range(6):
                S[i, j] = G[i, j] + K[k, i] * (Quu * K[k, j] + G[6, j]) + G[6, i] * K[k, j]
    return first, second, steepest


@compiled
def nearest_turns(which, states, missing, x):
    """Take the angles of measured states to the turn nearest to what was planned; where one is missing, that counts."""
    for i in which:
        planned = _row(x[i], 1)
        greatest = 0.0
        for d in range(6):
            greatest = max(greatest, abs(states[i, d]), abs(planned[d]))
        if missing[i]:
            _set_row(states, i, planned)
        elif greatest < 1e6:  # beyond, a turn is lost in rounding
            for d in range(1, 3):
                states[i, d] += _TURN * np.rint((planned[d] - states[i, d]) / _TURN)


@compiled
def _lay_out(guess, x, u, K, start, noise, p, feedback, push, hold, centring, line):
    """Fill in what a guess is, or what it follows, in place of a plan."""
    N = len(u)
    near = _nearest(start, p)
    if guess == _CARRIED_ON:
        end = _row(x, N)
        at_end = _nearest(end, p)
        force = 0.0
        for i in range(6):
            force += feedback[i] * (end[i] - at_end[i])
        for k in range(N - 1):
            u[k] = u[k + 1]
            _set_row(x, k, _row(x, k + 1))
            _set_row(K, k, _row(K, k + 1))
        u[N - 1] = _clip(force, p.force_limit)
        _set_row(x, N - 1, end)
        _set_row(K, N - 1, feedback)
    elif guess == _REGULATED:
        u[:] = 0.0
        for k in range(N):
            _set_row(x, k, near)
            _set_row(K, k, feedback)
    elif guess == _STRAIGHT:
        u[:] = 0.0
        K[:] = 0.0
        for k in range(N + 1):
            for i in range(6):
                x[k, i] = _between(line[k], start[i], near[i])
    elif guess == _DRIVEN:
        x[:] = 0.0
        x[:, 0] = p.target[0]
        for k in range(N):
            u[k] = push * noise[k // hold]
            _set_row(K, k, centring)


@inline
def _keep(x, u, K, x_new, u_new, K_new):
    for k in range(len(u)):
        u[k] = u_new[k]
        _set_row(x, k, _row(x_new, k))
        _set_row(K, k, _row(K_new, k))
    _set_row(x, len(u), _row(x_new, len(u)))


@inline
def next_damping(damping, better):
    """Return the damping after an iteration: soon none where plans get better, so that the last steps are Newton's."""
    if better:
        return 0.2 * damping if damping > 1e-3 else 0.0
    return max(10.0 * damping, 1e-2)


@lru_cache
def make_loops(
    step: Callable[..., Any], linearize: Callable[..., Any] | None = None, sources: Sequence[Path] = ()
) -> Loops:
    """Build the loops for a plant, once for each.

    Parameters
    ----------
    step : callable
        ``step(x, u, parameters)``: six numbers, given six and a force; what numba compiles.
    linearize : callable, optional
        ``linearize(x, u, parameters, D)`` fills D as that of :func:`make_flow` does; left out, central differences.
    sources : tuple of Path
        All files, or folders of them, that ``step`` and ``linearize`` are made of: then the machine code is kept on
        disk.  Without, it is compiled anew in each process.
    """
    step = step if hasattr(step, "py_func") else inline(step)
    names = [f"{each.__module__}.{each.__qualname__}" for each in (step, linearize) if each is not None]
    keep: Any = partial(compiled, sources=sources, key=" ".join(names)) if sources else numba.njit(**OPTIONS)
    slopes = keep(linearize or make_differences(step))

    @keep
    def rollout(x0, x, u, K, du, D, length, p, parameters, P, x_new, u_new):
        """Follow u + length du + K (x_new - x), clipped, into x_new and u_new; return the cost.

        The linear prediction behind du closes every gap in one full step.  A step of a part of that length is to close
        the same part, so that the share 1 - length of each gap is left, and the new states stay near those linearized
        about.
        """
        N = len(u)
        left = 1.0 - length
        now = (x0[0], x0[1], x0[2], x0[3], x0[4], x0[5])
        cost = 0.0
        for k in range(N):
            _set_row(x_new, k, now)
            force = u[k] + length * du[k]
            for i in range(6):
                force += K[k, i] * (x_new[k, i] - x[k, i])
            force = _clip(force, p.force_limit)
            u_new[k] = force
            cost += _stage_cost(now, force, p)
            now = step(now, force, parameters)
            if left > 0.0:
                now = (
                    now[0] - left * D[k, 0, 7],
                    now[1] - left * D[k, 1, 7],
                    now[2] - left * D[k, 2, 7],
                    now[3] - left * D[k, 3, 7],
                    now[4] - left * D[k, 4, 7],
                    now[5] - left * D[k, 5, 7],
                )
        _set_row(x_new, N, now)
        return cost + _final_cost(now, P, p)

    @keep
    def improve(first, last, which, guess, states, noise, limits, plans, setting, iterations, tolerance, trials):
        """Improve plans in place, each from a guess: those of the rows ``which[first:last]``.

        The motion of a guess starts at ``states`` (n, 6); random forces are made of ``noise`` (len(which), N / hold).
        One that costs no less than its limit (len(which),) is left as it is.  A row's numbers depend on that row alone,
        so that they are the same in every batch and in any thread.

        While there are gaps, the cost counts them too, at twice the greatest slope by a state, which makes the penalty
        exact.  Where a plan runs out of iterations with gaps left, they are closed by following it with its gains.
        """
        N = plans.u.shape[1]
        parameters = setting.parameters
        P = setting.P
        none = np.zeros(N)
        D = np.empty((N, 6, 8))
        du = np.empty(N)
        K_new = np.empty((N, 6))
        x_new = np.empty((N + 1, 6))
        u_new = np.empty(N)
        for j in range(first, last):
            i = which[j]
            x = plans.x[i]
            u = plans.u[i]
            K = plans.K[i]
            start = _row(states, i)
            p = problem_at(start, setting.problem)
            _lay_out(
                guess, x, u, K, start, noise[j], p,
                setting.feedback, setting.push, setting.hold, setting.centring, setting.line,
            )  # fmt: skip
            plans.converged[i] = False
            plans.tried[i] = 0
            plans.accepted[i] = 0
            if guess in (_AS_IT_IS, _STRAIGHT):
                cost = cost_of(x, u, p, P)
            else:
                cost = rollout(start, x, u, K, none, D, 1.0, p, parameters, P, x_new, u_new)
                if guess == _CARRIED_ON and not math.isfinite(cost):
                    K[:] = 0.0
                    u[:] = 0.0
                    cost = rollout(start, x, u, K, none, D, 1.0, p, parameters, P, x_new, u_new)
                    if not math.isfinite(cost):
                        u_new[:] = 0.0
                        for k in range(N + 1):
                            _set_row(x_new, k, start)
                if guess == _DRIVEN:
                    K[:] = 0.0
                _keep(x, u, K, x_new, u_new, K)
                if not cost < limits[j]:
                    plans.cost[i] = cost
                    continue
            damping = 0.0
            penalty = 0.0
            gaps = 0.0
            fresh = False
            while True:
                enough = plans.tried[i] == iterations or damping > 1e6
                if enough and plans.tried[i] > 0 and gaps == 0.0:
                    break  # a motion remains one
                if not fresh:
                    slopes(x, u, parameters, D)
                    gaps = 0.0
                    for k in range(N):
                        for d in range(6):
                            gaps += abs(D[k, d, 7])
                    if gaps < 1e-9:  # rounding
                        gaps = 0.0
                    fresh = True
                if enough:
                    break
                first_order, second_order, steepest = backward(x, u, p, P, D, damping, du, K_new)
                promised = -2.0 * first_order - second_order
                if gaps == 0.0 and math.isfinite(cost) and promised <= tolerance * cost:
                    _keep(x, u, K, x, u, K_new)
                    plans.converged[i] = True
                    break
                # A gap moves the cost by at most the slope there, 2 * steepest with the halving undone: an exact
                # penalty has to be steeper, and must not fall, or two plans could each be better than the other.
                penalty = max(penalty, 4.0 * steepest)
                length = 1.0
                plans.tried[i] += 1
                better = False
                cost_new = cost
                for _ in range(trials):
                    cost_new = rollout(start, x, u, K_new, du, D, length, p, parameters, P, x_new, u_new)
                    if gaps == 0.0:  # Armijo's rule, with the halving undone
                        better = cost_new < cost + 1e-4 * length * (2.0 * first_order + length * second_order)
                    else:
                        left = (1.0 - length) * gaps * penalty
                        better = cost_new + left < cost + (1.0 - 1e-4 * length) * gaps * penalty
                    if better:
                        break
                    length *= 0.4
                if better:
                    _keep(x, u, K, x_new, u_new, K_new)
                    cost = cost_new
                    plans.accepted[i] += 1
                    fresh = False
                damping = next_damping(damping, better)
            if gaps > 0.0:
                cost = rollout(start, x, u, K, none, D, 1.0, p, parameters, P, x_new, u_new)
                _keep(x, u, K, x_new, u_new, K)
            plans.cost[i] = cost

    improve.targetoptions["nogil"] = True  # it touches no Python object, and its rows may be shared out among threads
    return Loops(slopes, rollout, improve)


@inline
def _plant_field(x, f, c):
    k = rates(x, f, c)
    return k, acceleration_slopes(x, k[3:], c)


PLANT = make_loops(*make_flow(rates, _plant_field), (Path(__file__).parent,))
"""The loops of the equations of motion; the field of their Flow is of ``Coefficients``."""
