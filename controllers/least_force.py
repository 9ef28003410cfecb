r"""The least force limit under which a state can be brought upright at all: what controllers can be measured against.

With :math:`f` the plant over one sample under a held force,

.. math::
    \min F \quad\text{s.t.}\quad x_{k+1} = f(x_k, F v_k),\; |v_k| \le 1,\; |p_k| \le p_\max,\;
    |\theta_{i,k} - \theta_i^*| \le \bar\theta_i,

with :math:`x_N` at rest at the target's angles, the cart anywhere.  :math:`F` is a seventh state that stays as it is,
so the problem keeps the shape of optimal control, and every start has an answer, within reach or not: a state can be
saved by a force of 40 N if its :math:`F` is 40 N or less.  The problem is not convex: what is found is a local
minimum, so an upper bound of the least force.

Source: H. Bock and K. Plitt, *A multiple shooting algorithm for direct solution of optimal control problems*, 1984.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import casadi
import numpy as np
import numpy.typing as npt

from dpend.arguments import checked_array, is_finite
from dpend.params import Array
from dpend.rig import Rig, single_rig
from dpend.state import as_states
from dpend.symbolic import substep_function

from .shooting import Stage, multiple_shooting
from .trajectory import Trajectory
from .trajopt import NoTrajectory

_NEAR = 0.2  # rad: starts within it are solved from a straight line, those beyond from the solution of a nearer one
_EFFORT = 1e-5  # weight of the sum of v^2 beside F in units of the plant's weight: it moves 40 N by less than 0.01 N
_MOST = 20.0  # greatest F, in that unit
_PATIENCE = 120.0  # s, after which a guess is abandoned
_LIMITS = {"tol": 1e-7, "max_iter": 200}


class LeastForce:
    r"""Finds :math:`\min F` and the motion that attains it, from any start near a target.

    Parameters
    ----------
    rig : Rig or str
        Plant, clock and track; its force limit does not enter.
    target : sequence of two floats
        Angles of both links to be reached, rad, whole turns as they are: upright or hanging.
    horizon : float
        Seconds, rounded to :math:`N` samples, at least 2.
    angle_limits : sequence of two floats
        How far link 1 and link 2 may be from the target's angles on the way, rad; infinity for no limit.
    track_margin : float
        What is kept from the track's end, m.
    compiled : bool
        Whether to look for a compiler; without one a solution takes several times as long.

    Attributes
    ----------
    backend : str
        What solves it, in words.

    Raises
    ------
    ValueError
        If an argument is out of range, or the rig describes several plants or has no gravity.
    """

    def __init__(
        self,
        rig: Rig | str,
        target: Sequence[float] = (0.0, 0.0),
        *,
        horizon: float = 2.0,
        angle_limits: Sequence[float] = (math.pi / 2, math.pi / 2),
        track_margin: float = 0.02,
        compiled: bool = True,
    ) -> None:
        rig = single_rig(rig, "LeastForce")
        if not rig.params.gravity > 0:
            raise ValueError("Without gravity nothing falls: the least force is zero; give a rig with gravity.")
        steps = round(horizon / rig.sample_time) if is_finite(horizon) else 0
        if steps < 2:
            raise ValueError(
                f"horizon must be a number of seconds, at least two samples of {rig.sample_time:g} s; got {horizon!r}."
            )
        limits = checked_array("angle_limits", angle_limits, "two angles, rad", finite=False)
        if limits.shape != (2,) or not (limits > 0).all():
            raise ValueError(f"angle_limits must be two angles, greater than 0 rad; got {angle_limits!r}.")
        if not (is_finite(track_margin) and 0 <= track_margin < rig.track_limit):
            raise ValueError(
                f"track_margin must be at least 0 m and less than the track's {rig.track_limit:g} m; "
                f"got {track_margin!r}."
            )
        self.rig = rig
        self.horizon_steps = steps
        self._target = np.array([0.0, *target, 0.0, 0.0, 0.0])
        self._bounds = np.array([rig.track_limit - track_margin, *limits, np.inf, np.inf, np.inf])
        self._unit = float(rig.params.coefficients().d1 * rig.params.gravity)
        x, v = casadi.SX.sym("x", 7), casadi.SX.sym("v")
        after = casadi.vertcat(substep_function(rig)(x[:6], self._unit * x[6] * v), x[6])
        self._program = multiple_shooting(
            Stage(
                x=x,
                u=v,
                p=casadi.SX(0, 1),
                step=casadi.Function("step", [x, v], [after]),
                steps=rig.substeps,
                cost=_EFFORT * v**2,
                terminal=x[6],
            ),
            self.horizon_steps,
        )
        self._solver = self._program.solver(fatrop=_LIMITS, ipopt=_LIMITS, compiled=compiled)
        self.backend = self._solver.backend

    def __call__(
        self, x0: npt.ArrayLike, *, guess: Trajectory | None = None, guesses: int = 0, seed: int = 0
    ) -> Trajectory:
        r"""Return the motion from a state that asks for the least force.

        A start far out is hard to solve from nothing: one in the same direction, but within 0.2 rad, is solved first,
        and its motion, made greater, is the guess.

        Parameters
        ----------
        x0 : array_like (6,)
            The start; its angles are meant as they are, whole turns and all.
        guess : Trajectory, optional
            What an earlier call returned for a start in the same direction, and as many samples: the first guess is
            this motion, made greater or smaller.
        guesses : int
            Further guesses, random: a straight line, bent, with random inputs and force.  The best is kept.
        seed : int
            What they are drawn from.

        Returns
        -------
        Trajectory
            Its ``about["force"]`` is :math:`F`, N; ``about["found"]`` is what each guess led to, N, NaN for nothing.

        Raises
        ------
        ValueError
            If the start is no state, or the guess has another number of samples.
        NoTrajectory
            If the solver finds none.
        """
        start = np.asarray(x0, dtype=np.float64)
        if start.shape != (6,):
            raise ValueError(f"x0 must be one state of shape (6,); got shape {start.shape}.")
        away = as_states(start)[0] - self._target
        N = self.horizon_steps
        size = float(np.abs(away[1:3]).max())
        line = np.linspace(1.0, 0.0, N + 1)[:, None]
        share, near = 1.0, (line * away, np.zeros(N), 1.0)
        if guess is not None:
            if len(guess.u) != N:
                raise ValueError(f"guess must have {N} samples; got {len(guess.u)}.")
            F = max(float(guess.about["force"]), 1e-6)
            near = guess.x - self._target, guess.u / F, F / self._unit
            share = float(np.abs(near[0][0, 1:3]).max()) / size
        elif _NEAR < size < math.pi / 2:
            share = _NEAR / size
            near = self._from(share * away, share * near[0], near[1], 1.0)
        first = None
        if near is not None:
            x, v, F = near
            first = self._from(away, x / share, v, min(F / share, 0.9 * _MOST))
        rng = np.random.default_rng(seed)
        all_found = [first]
        for _ in range(guesses):
            bend = np.sin(np.linspace(0.0, math.pi, N + 1))[:, None] * rng.normal(0.0, (1.0, 0.3, 0.3, 0.0, 0.0, 0.0))
            v = np.repeat(rng.uniform(-1.0, 1.0, -(-N // 5)), 5)[:N]
            all_found.append(self._from(away, line * away + bend, v, rng.uniform(1.0, 6.0)))
        found = min((one for one in all_found if one is not None), key=lambda one: one[2], default=None)
        if found is None:
            raise NoTrajectory(
                f"No motion from {start.tolist()} to the target was found in {N} samples. Allow a longer horizon, or "
                "check that the start is on the track and within angle_limits."
            )
        x, v, F = found
        return Trajectory(
            rig=self.rig,
            x=x + self._target,
            u=self._unit * F * v,
            target=np.array([x[-1, 0], *self._target[1:3], 0.0, 0.0, 0.0]),
            about={
                "method": "least force",
                "force": self._unit * F,
                "found": [math.nan if one is None else self._unit * one[2] for one in all_found],
                "solver": self.backend,
            },
        )

    def _from(self, away: Array, x: Array, v: Array, F: float) -> tuple[Array, Array, float] | None:
        """Solve from a guess; None where the solver does not succeed."""
        N, pack = self.horizon_steps, self._program.pack
        high = np.tile(np.append(self._bounds, _MOST), (N + 1, 1))
        low = -high
        low[:, 6] = 0.0
        low[0, :6] = high[0, :6] = away
        low[N, 1:6] = high[N, 1:6] = 0.0
        ones = np.ones((N, 1))
        solved = self._solver.fresh()(
            patience=_PATIENCE,
            x0=pack(np.column_stack([x, np.full(N + 1, F)]), v[:, None]),
            lbx=pack(low, -ones),
            ubx=pack(high, ones),
            lbg=0,
            ubg=0,
        )
        if not solved.success:
            return None
        states, inputs = self._program.unpack(solved.x)
        return states[:, :6], np.clip(inputs[:, 0], -1.0, 1.0), float(states[0, 6])
