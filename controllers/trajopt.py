r"""Swing-up and transfer trajectories by direct multiple shooting on the sampled plant.

With :math:`F` the plant over one sample under a held force (the Runge-Kutta steps of the simulator), the nonlinear
program in :math:`x_0 \dots x_N, u_0 \dots u_{N-1}` is

.. math:: \min J \quad\text{s.t.}\quad x_{k+1} = F(x_k, u_k),\;
   x_0 = \bar x,\; x_N = x^*,\; |u_k| \le u_\max,\; |p_k| \le p_\max

with one of two objectives, both of order one (fatrop does not scale costs), forces in units of :math:`f`:

.. math:: J_\text{effort} = \int \frac{u^2 + \tau^2 \dot u^2}{f^2}\,dt, \qquad
   J_\text{time} = N h + \epsilon \sum_k \Bigl(\frac{u_k - u_{k-1}}{f}\Bigr)^2,\quad h \text{ free}.

A solution replays in the simulator as it is, to the solver's tolerance in each sample, because the constraint is the
simulator's own step; that, the limits and the end are checked before a solution is returned.

Source: H. Bock and K. Plitt, *A multiple shooting algorithm for direct solution of optimal control problems*, 1984.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from importlib import metadata
from typing import Literal, NamedTuple

import casadi
import numpy as np
import numpy.typing as npt

from dpend.arguments import checked_name, checked_seed, checked_whole, is_finite
from dpend.params import Array
from dpend.provenance import versions
from dpend.rig import Rig, ideal_rig, single_rig
from dpend.state import as_equilibrium, as_states, deviation
from dpend.symbolic import sample_function, substep_function
from dpend.tasks import STARTS

from .codegen import NLPSolver, Plugin, find_compiler
from .shooting import Stage, multiple_shooting
from .trajectory import Trajectory

Objective = Literal["effort", "time"]

TOLERANCE = 1e-6
"""Greatest defect of a sample, and greatest excess over a limit, of a trajectory that is returned."""

_JUMPS = 1e-3  # s, what a jump of the force by its unit costs in minimum time
_PATIENCE = 120.0  # s, after which a guess is abandoned


class NoTrajectory(RuntimeError):
    """No guess led the solver to a trajectory that holds in the simulator.

    The message says for each guess how the solver ended.

    See Also
    --------
    controllers.optimize : Raise it.

    Examples
    --------
    >>> from controllers import NoTrajectory
    >>> issubclass(NoTrajectory, Exception)
    True
    """


def _solver(rig: Rig, N: int, objective: Objective, smoothing: float, unit: float, solver: Plugin) -> NLPSolver:
    """Return a solver whose variables are rows ``(s_k, u_k)``, one a sample, and a last state.

    ``s`` is the state, the last force, and in minimum time the sample's length in units of the rig's, constant along
    the rows: so every constraint ties neighbours only.
    """
    free = objective == "time"
    states = 8 if free else 7
    h = rig.sample_time
    s, u = casadi.SX.sym("s", states), casadi.SX.sym("u")
    ratio = [s[7]] if free else []
    # What is compiled is one Runge-Kutta step; interpreted, a sample in one piece is the faster.
    parts = rig.substeps if solver != "ipopt" and find_compiler() else 1
    plant = substep_function(rig, free_step=free) if parts > 1 else sample_function(rig, free_step=free)
    after = casadi.vertcat(plant(s[:6], unit * u, *(h * r for r in ratio)), u, *ratio)
    jump = u - s[6]
    if free:
        cost, terminal = h * s[7] + _JUMPS * jump**2, casadi.SX(0)
    else:
        cost = h * u**2 + smoothing**2 / h * jump**2
        terminal = smoothing**2 / h * s[6] ** 2  # the force ends where it began, at zero
    stage = Stage(
        x=s,
        u=u,
        p=casadi.SX(0, 1),
        step=casadi.Function("step", [s, u], [after]),
        steps=parts,
        cost=cost,
        terminal=terminal,
    )
    return multiple_shooting(stage, N).solver(
        fatrop={"tol": 1e-9, "max_iter": 120},
        ipopt={"tol": 1e-9, "max_iter": 300},
        solver=solver,
        compiled=solver != "ipopt",
    )


class _Guess(NamedTuple):
    x: Array  # (N + 1, 6)
    u: Array  # (N,) in N
    words: str


def optimize(
    rig: Rig | str,
    start: str | npt.ArrayLike = "hanging",
    target: str | npt.ArrayLike = "up-up",
    *,
    objective: Objective = "effort",
    duration: float = 2.5,
    smoothing: float = 0.1,
    track_margin: float = 0.2,
    force_margin: float = 0.0,
    guess: Trajectory | None = None,
    starts: int = 1,
    seed: int = 0,
    solver: Plugin = "ipopt",
) -> Trajectory:
    r"""Minimise effort in a given time, or time, from a start at rest to an equilibrium, within the limits.

    Which objective, and how the program is written, is in the module's docstring.

    Parameters
    ----------
    rig : Rig or str
        Plant, clock and limits; actuator and sensors do not enter.
    start : str or array_like (6,)
        "hanging", "side" (both links horizontal, :math:`(\pi/2, \pi/2)`), the name of an equilibrium, or any state.
    target : str or array_like (6,)
        The name of an equilibrium: then each link may turn to it either way, all ways are tried, and the cheapest is
        kept; or a state with each link straight up or down, whose angles are meant as they are, turns and all.
    objective : {"effort", "time"}
        What is minimised; see the module.  In minimum time the trajectory has a sample time of its own, the duration
        divided by the same number of samples.
    duration : float
        Length, s, a whole number of samples; in minimum time a length that is enough.
    smoothing : float
        :math:`\tau`, s: what a change of the force costs beside the force itself; minimum time does not use it.
    track_margin, force_margin : float
        What is kept from the track's end, m, and from the force limit, N, for feedback to use.
    guess : Trajectory, optional
        Where to begin, stretched to the duration, instead of on a straight line; its turns are then the only ones tried
        where the target is a name.
    starts : int
        Guesses for each way of turning: the first as said, the others moved at random, smoothly.
    seed : int
        Of what is random.
    solver : {"ipopt", "auto", "fatrop"}
        ``"auto"`` is fatrop on compiled C where there is a compiler and the force has a limit, else IPOPT.  It takes
        several times less for each guess, but some seconds to compile for every plant and length (kept on disk).

    Returns
    -------
    Trajectory
        It holds in the simulator, each sample to ``TOLERANCE``; ``about`` says what it is and where it comes from.

    Raises
    ------
    TypeError
        If ``guess`` is no trajectory.
    ValueError
        If an argument is out of range.
    NoTrajectory
        If no guess led to a trajectory.

    See Also
    --------
    controllers.TVLQR : Follow what it finds.
    controllers.ilqr : Without hard limits, and quicker.

    Examples
    --------
    >>> import dpend
    >>> from controllers import optimize
    >>> rig = dpend.rig("gustafsson2016")
    >>> optimize(rig, duration=2.5)  # doctest: +SKIP
    """
    rig = single_rig(rig, "optimize")
    checked_name("objective", objective, ("effort", "time"))
    checked_name("solver", solver, ("auto", "fatrop", "ipopt"))
    samples = duration / rig.sample_time if is_finite(duration) else 0.0
    N = round(samples)
    if abs(samples - N) > 1e-6 or N < 8:
        raise ValueError(
            f"duration must be a whole number of samples of {rig.sample_time:g} s, at least 8; got {duration!r} s."
        )
    if not (is_finite(smoothing) and smoothing >= 0):
        raise ValueError(f"smoothing must be finite and at least 0 s; got {smoothing!r}.")
    for name, margin, limit, metric in (
        ("track_margin", track_margin, rig.track_limit, "m"),
        ("force_margin", force_margin, rig.force_limit, "N"),
    ):
        if not (is_finite(margin) and 0 <= margin < limit):
            raise ValueError(
                f"{name} must be at least 0 and less than the limit of {limit:g} {metric}; got {margin!r}."
            )
    checked_whole("starts", starts)
    seed = checked_seed("seed", seed)
    if guess is not None and not isinstance(guess, Trajectory):
        raise TypeError(f"guess must be a controllers.Trajectory; got {guess!r}.")
    begin = _state(start)
    for name, state in (("start", begin), ("target", as_equilibrium(target))):
        if not abs(state[0]) <= rig.track_limit - track_margin:
            raise ValueError(
                f"The {name} has its cart at {state[0]:g} m; a trajectory that keeps its margin stays within "
                f"{rig.track_limit - track_margin:g} m."
            )
    if guess is not None:  # by so many turns that it begins where this one does
        turns = (guess.x[0] - begin - deviation(guess.x[0], begin)) * [0, 1, 1, 0, 0, 0]
        guess = replace(guess, x=guess.x - turns, target=guess.target - turns)
    unit = float(rig.force_limit)
    if not math.isfinite(unit):
        if solver == "auto":  # without a limit fatrop does not return from some guesses
            solver = "ipopt"
        p = rig.params
        unit = float(p.gravity * (p.cart_mass + p.mass1 + p.mass2))
    solve = _solver(rig, N, objective, smoothing, unit, solver)
    rng = np.random.default_rng(seed)
    best: Trajectory | None = None
    failures: Counter[str] = Counter()
    tried = 0
    for end in _ends(begin, target, guess):
        for first in _guesses(begin, end, N, rig, guess, starts, rng):
            tried += 1
            found = _solved(solve, rig, objective, begin, end, first, unit, track_margin, force_margin)
            if isinstance(found, str):
                failures[found] += 1
            elif best is None or found.about["cost"] < best.about["cost"] - 1e-9:
                best = found
    if best is None:
        said = ", ".join(f"{count} x {words}" for words, count in failures.most_common())
        raise NoTrajectory(
            f"None of {tried} guesses led to a trajectory ({said}). Allow more time or force, less margin, more "
            "starts, or give the trajectory of an easier problem as guess."
        )
    about = dict(best.about) | {
        "start": start if isinstance(start, str) else "a state",
        "target": target if isinstance(target, str) else "a state",
        "objective": objective,
        "duration": duration,
        "smoothing": smoothing,
        "track_margin": track_margin,
        "force_margin": force_margin,
        "guess": None if guess is None else "a trajectory",
        "starts": starts,
        "converged": tried - failures.total(),
        "tried": tried,
        "seed": seed,
        "solver": solve.backend,
        "versions": versions() | {"casadi": metadata.version("casadi")},
    }
    return replace(best, about=about)


def _state(start: str | npt.ArrayLike) -> Array:
    if not isinstance(start, str):
        states = as_states(start)
        if len(states) != 1:
            raise ValueError(f"start must be one state (6,) or a name; got {len(states)} states.")
        return states[0]
    if start not in STARTS:
        raise ValueError(f"start must be one of {', '.join(map(repr, STARTS))}, or a state (6,); got {start!r}.")
    return STARTS[start].copy()


def _ends(begin: Array, target: str | npt.ArrayLike, guess: Trajectory | None) -> list[Array]:
    """Return states to end in: the target's angles by the turns next to the start's, one of each pair of mirrors."""
    end = as_equilibrium(target)
    if not isinstance(target, str):
        return [end]
    if guess is not None:
        turned = guess.target[1:3] - deviation(guess.target, end)[1:3]
        return [np.concatenate([end[:1], turned, end[3:]])]
    turns = []
    for angle, to in zip(begin[1:3], end[1:3], strict=True):
        steps = (angle - to) / (2 * np.pi)
        near = {math.floor(steps + 1e-9), math.ceil(steps - 1e-9)}
        turns.append([to + 2 * np.pi * k for k in sorted(near, key=lambda k: (abs(k - steps), abs(k)))])
    ends = [np.array([end[0], *angles, 0.0, 0.0, 0.0]) for angles in itertools.product(*turns)]
    if np.abs(deviation(-begin, begin)).max() > 1e-9 or end[0]:
        return ends
    mirrored = 2 * begin * [0, 1, 1, 0, 0, 0]  # the start is its own mirror: what theta becomes is 2 theta_0 - theta
    kept: list[Array] = []
    for each in ends:
        if not any(np.allclose(mirrored - each, other, atol=1e-9) for other in kept):
            kept.append(each)
    return kept


def _guesses(
    begin: Array, end: Array, N: int, rig: Rig, guess: Trajectory | None, starts: int, rng: np.random.Generator
) -> Iterator[_Guess]:
    along = np.linspace(0.0, 1.0, N + 1)[:, None]
    if guess is None:
        base = _Guess(begin + along * (end - begin), np.zeros(N), "a straight line")
    else:
        old = guess.t / guess.duration
        x = np.stack([np.interp(along[:, 0], old, column) for column in guess.x.T], axis=1)
        base = _Guess(x, np.interp(along[:-1, 0], old[:-1], guess.u), "a trajectory")
    yield base
    reach = min(float(rig.track_limit), 2 * float(rig.params.length1 + rig.params.length2)) / 2
    duration = N * rig.sample_time
    for i in range(1, starts):
        # Sines that vanish at both ends, slower ones larger: a smooth detour of a turn or so for the links.
        waves = np.arange(1, 6)
        size = rng.standard_normal((5, 3)) / waves[:, None] * [reach, np.pi / 2, np.pi / 2]
        moved = base.x.copy()
        moved[:, :3] += np.sin(np.pi * along * waves) @ size
        moved[:, 3:] = np.gradient(moved[:, :3], duration / N, axis=0)
        yield _Guess(moved, base.u, f"{base.words}, moved at random ({i})")


def _solved(
    solve: NLPSolver,
    rig: Rig,
    objective: Objective,
    begin: Array,
    end: Array,
    guess: _Guess,
    unit: float,
    track_margin: float,
    force_margin: float,
) -> Trajectory | str:
    """Return what one guess leads to, or what went wrong."""
    N, h = len(guess.u), rig.sample_time
    force = float(rig.force_limit) - force_margin
    track = float(rig.track_limit) - track_margin
    width = 9 if objective == "time" else 8
    high = np.full((N + 1, width), np.inf)
    high[:, 0], high[:, -1], high[:, 6] = track, force / unit, force / unit
    low = -high
    low[0, :6] = high[0, :6] = begin
    low[0, 6] = high[0, 6] = 0.0
    low[-1, :6] = high[-1, :6] = end
    first = np.zeros((N + 1, width))
    first[:, :6] = guess.x
    first[:-1, -1] = guess.u / unit
    first[1:, 6] = guess.u / unit
    if objective == "time":
        low[:, 7], high[:, 7], first[:, 7] = 0.1, 1.5, 0.8
    answer = solve(
        patience=_PATIENCE, x0=first.ravel()[:-1], lbx=low.ravel()[:-1], ubx=high.ravel()[:-1], lbg=0.0, ubg=0.0
    )
    if not answer.success:
        return answer.status
    rows = np.append(answer.x, 0.0).reshape(N + 1, width)
    step = h * float(rows[0, 7]) if objective == "time" else h
    forces = np.clip(unit * rows[:-1, -1], -force, force)
    x = rows[:, :6].copy()
    x[0], x[-1] = begin, end
    about = {"cost": answer.cost, "iterations": answer.iterations, "first guess": guess.words, "samples": N}
    own = ideal_rig(rig, limits=True).replace(sample_time=step)
    trajectory = Trajectory(rig=own, x=x, u=forces, target=end, about=about)
    wrong = violations(trajectory, track_margin=track_margin)
    return trajectory if not wrong else f"not holding in the simulator ({wrong})"


def violations(trajectory: Trajectory, *, track_margin: float = 0.0) -> str:
    """Say what a trajectory breaks: the plant's motion, a limit, or its target; an empty string if nothing.

    It is how a solver's result is judged before it is kept.

    Parameters
    ----------
    trajectory : Trajectory
        Any; it is replayed in the simulator, each sample from its own state.
    track_margin : float
        What it is to keep from the track's end, m.

    Returns
    -------
    str
        The violations with their sizes, or nothing.

    See Also
    --------
    controllers.Trajectory.defect : The motion alone.

    Examples
    --------
    >>> import dpend
    >>> from controllers import shipped, violations
    >>> rig = dpend.rig("gustafsson2016")
    >>> violations(shipped(rig))
    ''
    """
    if not isinstance(trajectory, Trajectory):
        raise TypeError(f"trajectory must be a controllers.Trajectory; got {trajectory!r}.")
    if not is_finite(track_margin):
        raise ValueError(f"track_margin must be finite, in m; got {track_margin!r}.")
    rig = trajectory.rig
    found = {
        "defect of a sample": trajectory.defect(),
        "force above its limit, N": float(np.abs(trajectory.u).max() - rig.force_limit),
        "cart beyond the track, m": float(np.abs(trajectory.x[:, 0]).max() - (rig.track_limit - track_margin)),
        "distance from the target": float(np.abs(trajectory.x[-1] - trajectory.target).max()),
    }
    return "; ".join(f"{name}: {size:.1e}" for name, size in found.items() if not size <= TOLERANCE)
