"""Every claim of speed in one run and one table: ``python -m benchmarks``, some minutes on one core of a quiet machine.

What is compared takes turns; a line gives the median over turns of how many times as fast one is as its peer, with
quartiles.  Peers that are not installed (extras ``peers``, ``jax``; a C compiler, node) leave their lines out.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = os.environ["MKL_NUM_THREADS"] = "1"

import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated

import pandas as pd
import tyro
from rich.console import Console

from benchmarks import backends, boxfddp, ilqr, learners, mpc, robustness, simulator, trajopt
from benchmarks.race import BUSY, Race, Ratio, pin_to_one_core, processor, run, show, versions

RACES: Mapping[str, Callable[[Path, bool], list[Race]]] = {
    "simulator": lambda _, quick: simulator.races(quick),
    "robustness": lambda _, quick: robustness.races(quick),
    "learners": lambda _, quick: learners.races(quick),
    "backends": backends.races,
    "ilqr": lambda _, quick: ilqr.races(quick),
    "boxfddp": lambda _, quick: boxfddp.races(quick),
    "trajopt": lambda _, quick: trajopt.races(quick),
}
PACKAGES = ("numpy", "numba", "casadi", "gymnasium", "mujoco", "do-mpc", "crocoddyl", "jax")


def main(
    only: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME")] = (),
    quick: bool = False,
    out: Path = Path("results/benchmarks"),
) -> list[Ratio]:
    """Measure all ratios of speed, and write them to a table.

    Parameters
    ----------
    only
        Parts that run: simulator, robustness, learners, backends, ilqr, boxfddp, trajopt, mpc; left out, all.
    quick
        A little of everything, to see that it runs; the figures mean little.
    out
        Folder of rows.csv and tables.md.
    """
    if unknown := set(only) - {*RACES, "mpc"}:
        raise SystemExit(f"--only: there is no {', '.join(sorted(unknown))}; there are {', '.join([*RACES, 'mpc'])}.")
    pin_to_one_core()
    console = Console()
    machine = f"{processor()}; {versions(*PACKAGES)}"
    console.print(f"{machine}.\n", highlight=False, soft_wrap=True)
    found: list[Ratio] = []
    with tempfile.TemporaryDirectory() as folder:
        for name, races in RACES.items():
            for race in races(Path(folder), quick) if not only or name in only else ():
                found += (ratios := run(race, 2 if quick else None))
                show(console, ratios)
    if not only or "mpc" in only:
        found += (ratios := mpc.ratios(quick))
        show(console, ratios)
    out.mkdir(parents=True, exist_ok=True)
    pd.DataFrame(found).assign(verdict=[each.verdict for each in found], machine=machine).to_csv(
        out / "rows.csv", index=False
    )
    (out / "tables.md").write_text(markdown(found, machine), encoding="utf-8")
    console.print(f"The table is in {out}/.", highlight=False)
    return found


def markdown(ratios: list[Ratio], machine: str) -> str:
    """Return the page of all tables, one a race."""
    lines = ["# benchmarks: all tables", "", f"{machine}."]
    for title in dict.fromkeys(each.title for each in ratios):
        own = [each for each in ratios if each.title == title]
        lines += ["", f"## {title}", "", f"| {own[0].counts} | beside | 1/s | ratio [quartiles] | asked for |"]
        lines += ["|---|---|---:|---:|---:|"]
        for each in own:
            cells = each.ours, each.peer, each.per_second, each.spread, each.asked_for or "–"
            lines.append(f"| {' | '.join(cells)} |")
        busy = f"; a turn took {own[0].busy:.1f} times its processor time" if own[0].busy > BUSY else ""
        lines += ["", machine.partition(";")[0] + busy]
    return "\n".join([*lines, ""])


if __name__ == "__main__":
    tyro.cli(main, prog="python -m benchmarks", description=__doc__)
