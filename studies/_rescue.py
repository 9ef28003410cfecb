"""What saves a start, by what is cheapest first: state feedback, motions of least force, a planner, users' own."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import NamedTuple

import numpy as np

import dpend
from controllers import ILQRMPC, LQR, BangBang, NoTrajectory, Trajectory
from controllers.least_force import LeastForce
from dpend.params import Array

from ._field import Contender

RIG = dpend.rig("gustafsson2016")
FORCE = float(RIG.force_limit)


def _lqr(Q: tuple[float, ...] | None = None, R: float = 1.0, *, sign: bool = False) -> dpend.Controller:
    lqr = LQR(RIG, Q=Q, R=R)
    return BangBang(lqr, FORCE) if sign else lqr


LAWS: Mapping[str, Callable[[], dpend.Controller]] = {
    "LQR": _lqr,
    "sign of stiff LQR": partial(_lqr, (1, 10, 10, 1, 1, 1), 0.1, sign=True),
    "stiff LQR": partial(_lqr, (1, 10, 10, 1, 1, 1), 0.1),
    "LQR, Bogdanov's weights": partial(_lqr, (5, 50, 50, 20, 700, 700), 1.0),
    "LQR, cart free": partial(_lqr, (0.01, 10, 10, 0.01, 10, 10), 0.1),
    "sign of LQR, angles costly": partial(_lqr, (1, 100, 100, 1, 1, 1), 1.0, sign=True),
    "sign of LQR, cart alone": partial(_lqr, (1, 0, 0, 0, 0, 0), 0.01, sign=True),
}
"""State feedback, cheap: tried on every start."""

OPTIMAL, MPC, NONE = "optimal control", "iLQR MPC", "-"

HORIZONS = (100, 150)
"""Samples of the motions sought; the second only where the first asks for little more than there is."""

_CLOSE = 1.1
"""A force within this share of the limit is worth a second search."""


class Verdict(NamedTuple):
    """What is found about one start."""

    recoverable: bool
    by: str
    """What saved it first; a dash where nothing did."""
    least_force: float
    """N; NaN where it was not sought, because feedback saves the start anyway."""
    report: bool
    """Whether it can be saved by the report's criterion: link 1 alone counts, so link 2 may swing round."""
    lqr: bool
    stiff_sign: bool
    mpc: str
    """Whether iLQR MPC saves it: yes, no, or a dash where it was not tried."""


class Replay:
    """Forces one after the other as they were planned, and a regulator's where none is planned any more.

    Parameters
    ----------
    forces : ndarray (n, N)
        A row for each run, N; NaN where the regulator acts.
    regulator : Controller
        What goes on afterwards.
    """

    name = "replay"

    def __init__(self, forces: Array, regulator: dpend.Controller) -> None:
        self.forces = forces
        self.regulator = regulator

    def start(self, n: int, rng: np.random.Generator) -> dpend.Act:
        """Return the law for as many runs as there are rows."""
        act, planned = self.regulator.start(n, rng), self.forces.T

        def replay(t: float, y: Array) -> Array:
            k = round(t / RIG.sample_time)
            u = act(t, y)
            return np.where(np.isnan(planned[k]), u, planned[k]) if k < len(planned) else u

        return replay


def holds(plan: Trajectory, x0: Array, task: dpend.Balance) -> bool:
    """Return whether a plan's forces, replayed from its start for some time and followed by LQR, save the start.

    Parameters
    ----------
    plan : Trajectory
        The plan; its forces are clipped to the limit.
    x0 : ndarray (6,)
        The start, its angles within a quarter turn.
    task : Balance
        What counts as saved.

    Returns
    -------
    bool
    """
    u = np.clip(plan.u, -FORCE, FORCE)
    N = len(u)
    forces = np.tile(u, (3, 1))
    for row, last in enumerate((N, 3 * N // 4, N // 2)):
        forces[row, last:] = np.nan
    for position in (plan.x[-1, 0], 0.0):
        regulator = LQR(RIG, Q=(1, 10, 10, 1, 1, 1), R=0.1, target=[position, 0, 0, 0, 0, 0])
        if dpend.simulate_many(RIG, Replay(forces, regulator), np.tile(x0, (3, 1)), task=task).success.any():
            return True
    return False


@cache
def _search(horizon: int, round_it: bool = False) -> LeastForce:
    limits = (math.pi / 2 - 0.01, math.inf if round_it else math.pi / 2 - 0.01)
    return LeastForce(RIG, horizon=horizon * RIG.sample_time, angle_limits=limits)


def optimal(x0: Array, task: dpend.Balance, guesses: int = 0) -> tuple[float, bool]:
    """Return the least force that was found for a start, N, and whether its motion saves the start in the simulator.

    Parameters
    ----------
    x0 : ndarray (6,)
        The start.
    task : Balance
        What counts as saved; by the report's criterion, link 2 swings round the way it leans.
    guesses : int
        Random guesses beside the first.

    Returns
    -------
    force : float
        NaN where no motion was found.
    saved : bool
    """
    round_it = task.criterion == "report"
    begin = x0 - np.array([0, 0, 2 * math.pi * np.sign(x0[2]), 0, 0, 0]) if round_it else x0
    least, saved = math.nan, False
    for horizon in HORIZONS:
        try:
            plan = _search(horizon, round_it)(begin, guesses=guesses)
        except NoTrajectory:
            continue
        least = float(np.fmin(least, plan.about["force"]))
        saved = saved or holds(plan, x0, task)
        if saved or least > _CLOSE * FORCE:
            break
    return least, saved


def judge(
    x0: Array,
    task: dpend.Balance,
    *,
    everywhere: bool = False,
    planned: int = 0,
    guesses: int = 0,
    yours: Sequence[Contender] = (),
) -> list[Verdict]:
    """Return which starts can be saved, by what is cheapest first.

    Parameters
    ----------
    x0 : ndarray (n, 6)
        Starts.
    task : Balance
        What counts as saved.
    everywhere : bool
        Seek the least force even where feedback saves the start.
    planned : int
        iLQR MPC is tried on the first so many starts, whatever else saves them.
    guesses : int
        Random guesses of optimal control beside the first.
    yours : sequence of Contender
        Controllers that are tried where nothing else saves a start.

    Returns
    -------
    list of Verdict
    """
    saves = {name: dpend.simulate_many(RIG, law(), x0, task=task).success for name, law in LAWS.items()}
    by_report = dpend.simulate_many(RIG, LAWS["LQR"](), x0, task=replace(task, criterion="report")).success
    mpc = ILQRMPC(RIG, upright_only=True)
    others = {contender.name: contender.make(RIG, task) for contender in yours}
    verdicts = []
    for i, start in enumerate(x0):
        by = next((name for name, saved in saves.items() if saved[i]), NONE)
        least = math.nan
        if everywhere or by == NONE:
            least, saved = optimal(start, task, guesses)
            by = OPTIMAL if by == NONE and saved else by
        tried = "-"
        if i < planned or by == NONE:
            tried = "yes" if _saves(mpc, start, task) else "no"
            by = MPC if by == NONE and tried == "yes" else by
        if by == NONE:
            by = next((name for name, other in others.items() if _saves(other, start, task)), NONE)
        report = by != NONE or bool(by_report[i]) or optimal(start, replace(task, criterion="report"))[1]
        lqr, stiff = bool(saves["LQR"][i]), bool(saves["sign of stiff LQR"][i])
        verdicts.append(Verdict(by != NONE, by, least, report, lqr, stiff, tried))
    return verdicts


def _saves(controller: dpend.Controller, start: Array, task: dpend.Balance) -> bool:
    return bool(dpend.simulate_many(RIG, controller, start[None], task=task).success[0])
