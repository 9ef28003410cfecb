"""Control laws in other languages: formulas as C99 or as an ES module, networks as ONNX too, with their checks.

``python -m studies.export ppo-swing-up --to c --out law`` writes a folder with the law, a header that says states,
order, units, clock and limits, the plant, a test vector from Python, and a program that holds the law to it.
"""

from __future__ import annotations

import math
import textwrap
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
import numpy.typing as npt

import dpend
from controllers import Differences, WithEstimator, Zero
from dpend import Balance, SwingUp
from dpend.arguments import checked_name
from dpend.controller import Controller, Law, as_controller, name_of
from dpend.emit import LANGUAGES, REALS, RINT, plant, translated
from dpend.params import Array
from dpend.rig import Rig, single_rig
from dpend.state import NAMES, UNITS
from dpend.suggest import suggestion
from dpend.tape import number
from rl import MLPPolicy, load_policy

from .._field import CONTENDERS
from .._own import load_own
from .laws import OWN, NotExportable, held_samples, law_of, portable
from .laws import Law as _Law
from .network import onnx_file
from .planner import RealTimeNMPC

__all__ = ["FORMS", "NotExportable", "controller_named", "export", "files", "module", "vector"]

_TEMPLATES = Path(__file__).parent / "templates"
_SECONDS = 6.0
FORMS = (*LANGUAGES, "onnx")


def controller_named(name: str, rig: Rig) -> Controller:
    """Return the controller for a rig that a name stands for.

    Parameters
    ----------
    name : str
        A contender of the comparisons, such as ``"TVLQR"``; a shipped policy, such as ``"ppo-swing-up"``, or the file
        of one; ``"Differences"``, the estimator alone; or ``path.py:factory`` or ``module:factory``, as the studies
        take it.
    rig : Rig
        What the controller believes.

    Raises
    ------
    OSError, ValueError
        If there is none.
    """
    if ":" in name:
        return load_own(name, rig).make(rig)
    if name == Differences.__name__:
        return WithEstimator(Differences(rig), Zero())
    for contender in CONTENDERS:
        if contender.name == name:
            return contender.make(rig, Balance() if "balance" in contender.tasks else SwingUp())
    try:
        policy: Any = load_policy(name)
    except FileNotFoundError:
        known = [each.name for each in CONTENDERS] + [Differences.__name__]
        raise ValueError(f"No contender, shipped policy or file is called {name!r}.{suggestion(name, known)}") from None
    return policy


_FILES = {
    "c": ("law.h", "law.c", "check.c", "README.md"),
    "js": ("law.mjs", "check.mjs", "README.md"),
    "onnx": ("check.py", "README.md"),
}


_DIFFERENCES = """\
    for (i = 0; i < 3; i++) {                    /* estimate the rates; --differences puts this into the law */
        y[3 + i] = (y[i] - before[i]) / LAW_SAMPLE_TIME;
        if (isfinite(y[i])) before[i] = y[i];
    }
"""


def _table(name: str, values: npt.NDArray[np.float64], to: str) -> str:
    listed = textwrap.fill(
        ", ".join(map(number, values.tolist())), 120, initial_indent="    ", subsequent_indent="    "
    )
    if to == "js":
        return f"const {name} = new Float64Array([\n{listed},\n]);\n"
    return f"static const real {name}[{values.size}] = {{\n{listed}\n}};\n"


def _said(controller: Controller, measured: int = 6) -> list[str]:
    """Return in lines what a law is and takes."""
    states = [f"{name} [{unit}]" for name, unit in zip(NAMES, UNITS, strict=True)]
    lines = [
        f"{' '.join(repr(controller).strip('<>').replace('*/', '').split())}.",
        f"Measurements: {', '.join(states)};",
        "angles absolute, from the vertical, 0 = up, positive leans to +pos.  "
        "It returns the force on the cart, N, limited.",
        "Where a measurement is missing (NaN) the last one counts; before the first there is no force.",
    ]
    if measured < 6:
        lines.append(
            "Of the measurements the positions alone count; after each call m[0] to m[5] are the estimated state."
        )
    return lines


def _about(controller: Controller, rig: Rig, law: _Law, to: str) -> str:
    """Return what the law is, in a comment, and its numbers."""
    numbers = {"SAMPLE_TIME": (rig.sample_time, "s: call it at this rate"), "FORCE_LIMIT": (rig.force_limit, "N"),
               "TRACK_LIMIT": (rig.track_limit, "m, either way"),
               "MEMORY": (OWN + len(law.memory), "numbers")}  # fmt: skip
    said = "/* " + "\n * ".join(_said(controller, law.measured)) + " */\n"
    for name, (value, unit) in numbers.items():
        text = str(value) if isinstance(value, int) else number(float(value))
        said += (
            f"#define LAW_{name} {text} /* {unit} */\n" if to == "c" else f"export const {name} = {text}; // {unit}\n"
        )
    return said


def vector(controller: Controller, rig: Rig) -> Array:
    """Return measurements and the forces that the controller answers with, rows ``(run, 6 measurements, force)``.

    Six seconds near upright, from a start of ``Balance(lam=0.1)``, and six from hanging, on the rig; of what plans the
    first alone.
    """
    near = Balance(lam=0.1).starts(np.random.default_rng(0), 1, rig)[0]
    starts = [near] if isinstance(controller, RealTimeNMPC) else [near, dpend.EQUILIBRIA["down-down"]]
    rows = []
    for k, x0 in enumerate(starts):
        run = dpend.simulate(rig, controller, x0, _SECONDS, task=None)
        act = controller.start(1, np.random.default_rng(0))
        for j, y in enumerate(run.y[: len(run.u)]):
            force = float(act(j * rig.sample_time, y[None])[0])
            rows.append([k, *y, float(np.clip(force, -rig.force_limit, rig.force_limit))])
    return np.array(rows)


def module(controller: Controller, rig: Rig) -> str:
    """Return a control law alone as an ES module, ``law.mjs``.

    Raises
    ------
    NotExportable
        If the law is no formula; the message says why.
    """
    return _filled(_FILES["js"][0], _words(controller, rig, law_of(controller, rig), "js"), "js", "double")


def _words(controller: Controller, rig: Rig, law: _Law, to: str) -> dict[str, str]:
    """Return what stands in a law's files, but for what a comparison with Python takes."""
    limit = float(rig.force_limit)
    memory = [0.0] * OWN + list(law.memory)
    return {
        "name": name_of(controller),
        "about": _about(controller, rig, law, to),
        "tables": law.before + "\n".join(_table(name, values, to) for name, values in law.tables.items()),
        "memory": "".join(f"    m[{i}] = {number(each)};\n" for i, each in enumerate(memory) if each),
        "measured": str(law.measured),
        "lines": textwrap.indent("\n".join(law.lines), "    "),
        "limit": f"    u = u > {limit!r} ? {limit!r} : u < -{limit!r} ? -{limit!r} : u;\n"
        if math.isfinite(limit)
        else "",
        "rint": RINT if any("rint(" in line for line in law.lines) else "",
        "sources": " ".join(["law.c", *(name for name in law.sources if name.endswith(".c"))]),
        "declared": "    static double before[3];\n    int i;\n" if law.measured == 6 else "",
        "estimate": _DIFFERENCES if law.measured == 6 else "",
        "notes": law.notes,
    }


def _filled(name: str, words: dict[str, str], to: str, real: str) -> str:
    template = _TEMPLATES / to / name.replace(".py", ".in")  # which is no Python yet
    text = Template(template.read_text(encoding="utf-8")).substitute(words)
    return translated(text, to, real) if name.endswith((".c", ".h", ".mjs")) else text


def files(controller: Controller, rig: Rig, to: str, real: str = "double") -> dict[str, Any]:
    """Return what :func:`export` writes, by the names of its files: texts, and a network's bytes."""
    controller = portable(controller)
    name = name_of(controller)
    others: dict[str, Any]
    if to == "onnx":
        if not isinstance(controller, MLPPolicy):
            raise NotExportable(f"{name} cannot be exported: it is no network, for which ONNX is; take C.")
        words, others = _network_words(controller, rig, real), {"policy.onnx": onnx_file(controller, rig, real)}
    else:
        law = law_of(controller, rig)
        if law.sources and (to, real) != ("c", "double"):
            raise NotExportable(f"{name} cannot be exported but to C in double precision, which CasADi generates.")
        words = _words(controller, rig, law, to)
        others = {"plant.h" if to == "c" else "plant.mjs": plant(to, rig, real=real), **law.sources}
    rows, limit = vector(controller, rig), float(rig.force_limit)
    scale = limit if math.isfinite(limit) else float(np.abs(rows[:, -1]).max())
    words["allowed"] = str((1e-9 if real == "double" else 1e-3) * scale)
    return {
        **{each: _filled(each, words, to, real) for each in _FILES[to]},
        **others,
        "vector.csv": "".join(f"{int(run)},{','.join(map(repr, row))}\n" for run, *row in rows.tolist()),
    }


def _network_words(policy: MLPPolicy, rig: Rig, real: str) -> dict[str, str]:
    """Return what stands in the files beside a network, but for what a comparison with Python takes."""
    numbers, recalls = "float64" if real == "double" else "float32", policy.network.inputs == 9
    return {
        "name": name_of(policy),
        "about": " ".join(_said(policy)[:3]),
        "numbers": numbers,
        "hold": str(held_samples(policy, rig)),
        "sample_time": f"{rig.sample_time:g}",
        "start": f'given = {{"last": np.zeros((1, 1), dtype=np.{numbers})}}' if recalls else "given = {}",
        "asked": 'force, given["last"] = ' if recalls else "(force,) = ",
    }


def export(controller: Controller | Law, rig: Rig | str, to: str, folder: str | Path, *, real: str = "double") -> Path:
    """Write a control law in another language into a folder, with what it takes to check it and to use it.

    Parameters
    ----------
    controller : Controller or function
        A linear law, its sign, linear Q-learning's, Gaussian actor-critic's mean, TVLQR, a network policy, or a
        function ``law(t, x)`` that does not branch; any of these in ``RateLimit`` or ``LowPass``, or behind
        ``Differences``; or ``NMPC``, as :class:`studies.export.planner.RealTimeNMPC`, to C alone.
    rig : Rig or str
        One rig, or the name of a preset: its clock, its limits, and the plant that is written beside the law.
    to : {"c", "js", "onnx"}
        The language; ONNX for networks.
    folder : str or Path
        Where to write; made if need be.
    real : {"double", "float"}
        The type of numbers in C and ONNX.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    NotExportable
        If the law is no formula; the message says why.
    ValueError
        If there is no such language or type.
    ImportError
        If ONNX is asked for and not installed.
    """
    checked_name("to", to, FORMS)
    checked_name("real", real, REALS)
    texts = files(as_controller(controller), single_rig(rig, "export"), to, real)
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    return folder
