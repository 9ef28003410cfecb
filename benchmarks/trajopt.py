"""How long trajectories take to find, by IPOPT alone and by fatrop on compiled C; and the minimum times.

Run ``python -m benchmarks.trajopt``.  The problem is ``gustafsson2016`` from hanging to upright in 2.5 s, 125 samples,
least effort, from a straight line; the solvers take turns, and the best of five turns counts, wall clock, one core.
"Solve" is the solver alone, "all" a whole call of ``optimize``: building the program, solving, replaying the solution.
Minimum times are found anew by IPOPT from the stored effort solutions.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

import dpend
from benchmarks.race import Job, Race
from controllers import optimize, shipped, violations
from controllers.codegen import find_compiler
from controllers.trajopt import STARTS, Plugin, _guesses, _solved, _solver

REPETITIONS = 5
RIG = dpend.rig("gustafsson2016")
TARGET = np.zeros(6)


def timed(work: Callable[[], Any]) -> tuple[float, Any]:
    """Return the seconds that one call took, and what it gave."""
    began = time.perf_counter()
    result = work()
    return time.perf_counter() - began, result


def solve_times(solvers: dict[str, Plugin]) -> Table:
    begin = STARTS["hanging"]
    guess = next(_guesses(begin, TARGET, 125, RIG, None, 1, np.random.default_rng(0)))
    force = float(np.max(RIG.force_limit))
    first = {
        name: timed(lambda s=solver: optimize(RIG, target=TARGET, solver=s))[0] for name, solver in solvers.items()
    }
    made = {name: _solver(RIG, 125, "effort", 0.1, force, solver) for name, solver in solvers.items()}
    solves: dict[str, list[float]] = {name: [] for name in solvers}
    wholes: dict[str, list[float]] = {name: [] for name in solvers}
    iterations: dict[str, int] = {}
    for _ in range(REPETITIONS):
        for name, solve in made.items():
            seconds, found = timed(
                lambda s=solve: _solved(
                    s, RIG, "effort", begin, TARGET, guess, force, track_margin=0.2, force_margin=0.0
                )
            )
            solves[name].append(seconds)
            iterations[name] = found.about["iterations"]
            wholes[name].append(timed(lambda n=name: optimize(RIG, target=TARGET, solver=solvers[n]))[0])
    table = Table(
        "solver",
        "iterations",
        "solve, ms",
        "all, ms",
        "first call, s",
        title=f"Best of {REPETITIONS} interleaved turns",
    )
    for name, solve in made.items():
        table.add_row(
            solve.backend,
            str(iterations[name]),
            f"{1e3 * min(solves[name]):.0f}",
            f"{1e3 * min(wholes[name]):.0f}",
            f"{first[name]:.1f}",
        )
    return table


def races(quick: bool = False) -> list[Race]:
    """Return the race of both solvers to the trajectory of least effort, from a straight line."""
    begin, force = STARTS["hanging"], float(np.max(RIG.force_limit))
    guess = next(_guesses(begin, TARGET, 125, RIG, None, 1, np.random.default_rng(0)))

    def job(plugin: Plugin) -> Job:
        solver = _solver(RIG, 125, "effort", 0.1, force, plugin)

        def solve() -> float:
            _solved(solver, RIG, "effort", begin, TARGET, guess, force, track_margin=0.2, force_margin=0.0)
            return 1.0

        return solve

    jobs = {"IPOPT": job("ipopt")} | ({} if quick or find_compiler() is None else {"fatrop on compiled C": job("auto")})
    pairs: list[tuple[str, str, float | None]] = [("fatrop on compiled C", "IPOPT", None)]
    return [Race(title="Swing-up of least effort, 125 samples", counts="solves", jobs=jobs, pairs=pairs, turns=5)]


def minimum_times() -> Table:
    table = Table(
        "start", "turns to", "minimum time, s", "iterations", "all, s", "violations", title="Minimum time, |u| <= 40 N"
    )
    for start in ("hanging", "side"):
        stored = shipped(RIG, start)
        if stored is None:
            raise RuntimeError("The stored trajectories are missing; make them with python -m controllers.data.")
        seconds, found = timed(lambda s=start, g=stored: optimize(RIG, s, objective="time", duration=2.0, guess=g))
        turns = f"({found.target[1] / np.pi:.0f} pi, {found.target[2] / np.pi:.0f} pi)"
        wrong = violations(found, track_margin=0.2) or "none"
        table.add_row(start, turns, f"{found.duration:.4f}", str(found.about["iterations"]), f"{seconds:.2f}", wrong)
    return table


def main() -> None:
    console = Console()
    solvers: dict[str, Plugin] = {"ipopt": "ipopt"}
    if find_compiler() is None:
        console.print("There is no C compiler: fatrop is left out.")
    else:
        solvers["fatrop"] = "auto"
    console.print(solve_times(solvers))
    console.print(minimum_times())


if __name__ == "__main__":
    main()
