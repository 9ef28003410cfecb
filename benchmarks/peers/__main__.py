"""How far this package is from independent engines: ``python -m benchmarks.peers`` compares and writes the table.

Random plants, rigs, states and weights from one seed, and all presets; what is not installed is left out and said.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = os.environ["MKL_NUM_THREADS"] = "1"

import dataclasses
import warnings
from collections.abc import Callable
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
import tyro
from rich.console import Console

from benchmarks.peers import designs, dynamics, environments
from benchmarks.peers.cases import Row
from benchmarks.peers.engines import ENGINES, installed
from benchmarks.peers.table import COLUMNS, markdown, read
from dpend.archive import atomic
from studies._table import where

Part = Literal["states", "do-mpc", "environments", "designs", "margins", "motions"]
PARTS: tuple[Part, ...] = ("states", "do-mpc", "environments", "designs", "margins", "motions")
STATES = 20  # of each plant


def compare(part: Part, cases: int, seed: int, console: Console) -> list[Row]:
    """Return the lines of one part of the table, as far as its engines are installed."""
    engines = [name for name in ENGINES if installed(name)]
    drake, slicot = installed("Drake"), find_spec("slycot") is not None

    def progress(done: int) -> None:
        if done % 100 == 0:
            console.print(f"{done} motions", highlight=False)

    peers: dict[Part, list[tuple[str, Callable[[], list[Row]]]]] = {
        "states": [(ENGINES[n].module, lambda n=n: dynamics.still(n, cases, STATES, seed)) for n in ENGINES],
        "do-mpc": [("do_mpc", lambda: dynamics.dompc(cases, STATES, seed))],
        "environments": [
            ("mujoco", lambda: environments.gymnasium_idp(cases, seed, sideways=False)),
            ("mujoco", lambda: environments.gymnasium_idp(cases, seed, sideways=True)),
            ("dm_control", lambda: environments.two_poles(cases, seed)),
        ],
        "designs": [("control", lambda: designs.designs(cases, seed, drake=drake, slicot=slicot))],
        "margins": [("control", lambda: designs.margins(cases, seed))],
        "motions": [("scipy", lambda: dynamics.motions(engines, cases, seed, progress))],
    }
    rows: list[Row] = []
    for module, compared in peers[part]:
        if find_spec(module) is None:
            console.print(f"{part}: {module} is not installed (extra engines), so its lines are left out.")
        else:
            rows += compared()
    return rows


def main(
    only: tuple[Part, ...] = PARTS,
    cases: int = 1000,
    seed: int = 0,
    out: Path = Path("results/peers"),
) -> None:
    """Compare with every engine that is installed, print the table, and keep it.

    Parameters
    ----------
    only
        Parts to compare; the lines of the others are kept as they are.
    cases
        Random plants, rigs or motions of each quantity; of the plants twenty states each, and the presets besides.
    seed
        Of all that is drawn.
    out
        Folder for rows.csv and tables.md.
    """
    if cases < 1:
        raise SystemExit(f"--cases must be at least 1; got {cases}.")
    console = Console()
    out.mkdir(parents=True, exist_ok=True)
    file = out / "rows.csv"
    kept = read(file) if file.is_file() else pd.DataFrame(columns=list(COLUMNS))
    failed = []
    for part in PARTS:
        if part not in only:
            continue
        console.print(f"{part} …", highlight=False)
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # of other people's packages
            rows = compare(part, cases, seed, console)
        fresh = [{"part": part} | dataclasses.asdict(row) | {"version": version_of(row.engine)} for row in rows]
        failed += [row for row in rows if not row.worst <= row.tolerance]
        frames = [pd.DataFrame(fresh) if each == part else where(kept, part=each) for each in PARTS]
        kept = pd.concat([frame for frame in frames if len(frame)], ignore_index=True)
        with atomic(file) as written:
            kept.to_csv(written, index=False)
        with atomic(out / "tables.md") as written:
            written.write_text(f"# Beside other engines\n\n{markdown(kept)}\n", encoding="utf-8")
    console.print(markdown(kept), highlight=False, soft_wrap=True)
    for row in failed:
        console.print(f"{row.quantity}, {row.engine}: {row.worst:.1e} is more than {row.tolerance:.0e}.")
    if failed:
        raise SystemExit(1)


def version_of(engine: str) -> str:
    """Return the version of the package that an engine's name stands for."""
    packages = {name: known.package for name, known in ENGINES.items()} | {
        "Gymnasium InvertedDoublePendulum-v5": "gymnasium",
        "dm_control cartpole two_poles": "dm_control",
        "do-mpc": "do_mpc",
        "python-control": "control",
        "python-control by SLICOT": "slycot",
    }
    return version(packages.get(engine, "scipy"))


if __name__ == "__main__":
    tyro.cli(main, prog="python -m benchmarks.peers")
