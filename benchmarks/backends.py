# pyright: reportMissingImports=false
"""How fast the plant runs in each language: one process and one core for each, in turns, in one run.

``python -m benchmarks.backends`` prints the table and the ratios.  Scalar steps are Runge-Kutta steps one after the
other, many a call: numba's scalar step, and beside it C by gcc and clang, in processor time, and JavaScript in node, as
they are emitted and with the sines of their libraries.  C is compiled for the processor, as numba compiles, "native",
and with ``-O2`` alone.  Batches are the closed loop with LQR of 4096 pendulums, every Runge-Kutta step counted:
``simulate_many``, and ``dpend.jax_plant.rollout`` in double precision (extra ``jax``).  What is not installed is left
out.
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import Any

import numba
import numpy as np
import tyro
from rich.console import Console

import dpend
from benchmarks.race import Job, Race, pin_to_one_core, run, show
from benchmarks.simulator import COPIES, SAMPLES
from controllers import LQR
from dpend.emit import SINES, plant
from dpend.kernels import OPTIONS, rk4
from dpend.params import Coefficients

SCALAR, BATCH = "numba, scalar step", f"numba, simulate_many, {COPIES} rows"
RIG = dpend.rig("gustafsson2016")
_START = (0.0, 0.2, -0.1, 0.0, 0.0, 0.0)  # from where the links fall, again and again

# With fused multiply-adds, as numba compiles: clang fuses within expressions by default, gcc needs an option in C99.
_NATIVE = {"gcc": ("-O3", "-march=native", "-ffp-contract=fast"), "clang": ("-O3", "-march=native")}
_ROLLOUT = f", rollout, {COPIES} rows"
_SINES = {"inline": "", "library": ", sines of the library"}

_C = """
double run(long n)
{
    double x[6] = START, f[3] = {0.0, 0.0, 0.0}, start[6] = START;
    long k;
    int i;
    for (k = 0; k < n; k++) {
        f[0] = k & 64 ? 5.0 : -5.0;
        dpend_rk4(x, f, &dpend_rig, 0.01, x);
        if (k % 300 == 299) for (i = 0; i < 6; i++) x[i] = start[i];
    }
    return x[1];
}
"""
_JAVASCRIPT = """
import { createInterface } from "node:readline";
for await (const line of createInterface({ input: process.stdin })) {
    const n = Number(line), start = [START], x = new Float64Array(start), f = new Float64Array(3);
    for (let k = 0; k < n; k++) {
        f[0] = k & 64 ? 5 : -5;
        rk4(x, f, RIG, 0.01, x);
        if (k % 300 === 299) x.set(start);
    }
    console.log(x[1]);
}
"""


@numba.njit(**OPTIONS)
def _run(n, c):
    x = _START
    for k in range(n):
        x = rk4(x, (5.0 if k & 64 else -5.0, 0.0, 0.0), c, 0.01)
        if k % 300 == 299:
            x = _START
    return x[1]


def scalar_jobs(steps: int, folder: Path) -> dict[str, Job]:
    """Return jobs that do so many steps one after the other; all must end in the same angle."""
    c, start = Coefficients(*map(float, RIG.params.coefficients())), ", ".join(map(str, _START))
    ends: dict[str, float] = {}

    def counted(name: str, angle: float) -> float:
        ends[name] = angle
        if not np.allclose(list(ends.values()), ends[SCALAR], rtol=0, atol=1e-6):
            raise RuntimeError(f"The plants end in different angles: {ends}.")
        return steps

    jobs: dict[str, Job] = {SCALAR: lambda: counted(SCALAR, _run(steps, c))}
    for compiler, sines, flags in product(filter(shutil.which, _NATIVE), SINES, ("native", "-O2")):
        source, library = folder / "run.c", folder / f"{compiler}{sines}{flags}.so"
        name, options = f"C, {compiler}, {flags}{_SINES[sines]}", _NATIVE[compiler] if flags == "native" else (flags,)
        source.write_text(plant("c", RIG, sines=sines) + _C.replace("START", f"{{{start}}}"))
        subprocess.run([compiler, "-std=c99", *options, "-shared", "-fPIC", source, "-o", library, "-lm"], check=True)
        run: Any = ctypes.CDLL(str(library)).run
        run.restype, run.argtypes = ctypes.c_double, [ctypes.c_long]
        jobs[name] = lambda name=name, run=run: counted(name, run(steps))
    for sines in SINES if shutil.which("node") else ():
        module, name = folder / f"{sines}.mjs", f"JavaScript{_SINES[sines]}"
        module.write_text(plant("js", RIG, sines=sines) + _JAVASCRIPT.replace("START", start))
        process: Any = subprocess.Popen(["node", module], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

        def javascript(name: str = name, process: Any = process) -> float:
            print(steps, file=process.stdin, flush=True)
            return counted(name, float(process.stdout.readline()))

        jobs[name] = javascript
    return jobs


def batch_jobs(samples: int) -> dict[str, Job]:
    """Return jobs that run closed loops of so many samples."""
    lqr, steps = LQR(RIG), COPIES * samples * RIG.substeps
    x0 = dpend.Balance(lam=0.1).starts(np.random.default_rng(0), COPIES, RIG)

    def simulated() -> float:
        dpend.simulate_many(RIG, lqr, x0, samples * RIG.sample_time, task=None)
        return steps

    jobs: dict[str, Job] = {BATCH: simulated}
    if find_spec("jax"):
        import jax

        from dpend import jax_plant

        jax.config.update("jax_enable_x64", True)
        gain = lqr.K[0]
        loop = jax.jit(lambda x0: jax_plant.rollout(RIG, lambda t, x: -x @ gain, x0, samples)[0][-1])

        def rolled() -> float:
            loop(x0).block_until_ready()
            return steps

        jobs[f"JAX on {jax.default_backend()}{_ROLLOUT}"] = rolled
    return jobs


def races(folder: Path, quick: bool = False) -> list[Race]:
    """Return the races of single steps and of closed loops; libraries are compiled into a folder that must stay."""
    single, batch = scalar_jobs(20_000 if quick else 1_000_000, folder), batch_jobs(10 if quick else SAMPLES)
    asked = {f"C, {compiler}, native": 1.0 for compiler in _NATIVE}
    asked |= {"JavaScript": 0.1, f"JAX on cpu{_ROLLOUT}": 0.2}

    def race(title: str, jobs: dict[str, Job], peer: str, elsewhere: bool) -> Race:
        pairs = [(name, peer, asked.get(name)) for name in jobs if name != peer]
        return Race(title=title, counts="Runge-Kutta steps", jobs=jobs, pairs=pairs, elsewhere=elsewhere)

    here = {name: job for name, job in single.items() if not name.startswith("JavaScript")}
    others = {name: job for name, job in single.items() if name == SCALAR or name not in here}
    return [
        race("C, one step after the other", here, SCALAR, elsewhere=False),
        race("JavaScript, one step after the other", others, SCALAR, elsewhere=True),
        race("JAX, LQR in a loop", batch, BATCH, elsewhere=True),
    ]


def main(quick: bool = False) -> None:
    """Measure Runge-Kutta steps a second in each language; ``--quick`` does a little of everything."""
    pin_to_one_core()
    with tempfile.TemporaryDirectory() as folder:
        for race in races(Path(folder), quick):
            show(Console(), run(race, 2 if quick else None))


if __name__ == "__main__":
    tyro.cli(main, prog="python -m benchmarks.backends")
