"""The page's files: those that lie here, and those made from Python: plant, laws, rigs, and what can be saved.

:func:`export` puts all into one file that needs no server: a browser that opens it from a disk loads no modules, but
takes one that is written into the page.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import dpend
from dpend import archive, emit
from dpend.metrics import UNITS
from dpend.rig import PRESETS, Rig

from .. import export as laws
from .._boundary import kept_boundary
from .._field import CONTENDERS, RIG, Contender, styles
from .scene import CHANGES, MOST_COPIES, contenders, fits, make

_WEB = Path(__file__).parent / "web"
_LAMBDAS = np.round(np.arange(0.05, 0.8001, 0.01), 2)
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:; media-src blob:"
)


def files(specs: Sequence[str] = ()) -> dict[str, str]:
    """Return the texts that a server hands out, by name.

    Parameters
    ----------
    specs : sequence of str
        The user's own controllers, ``path.py:factory`` or ``module:factory``; in Python alone.

    Raises
    ------
    ValueError
        If one of them is no controller.
    """
    return web_files() | {
        "plant.js": emit.plant("js"),
        "laws.js": _laws(),
        "catalogue.js": _catalogue(contenders(specs), True),
    }


def web_files() -> dict[str, str]:
    """Return the texts that lie here as they are, by name."""
    return {file.name: file.read_text(encoding="utf-8") for file in sorted(_WEB.iterdir())}


def export(folder: str | Path) -> Path:
    """Write the page for the tab alone, and return the file: ``index.html``, which needs nothing else.

    Parameters
    ----------
    folder : str or Path
        Where to; made if need be.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    texts = files() | {"catalogue.js": _catalogue(CONTENDERS, False)}
    page = texts["index.html"]
    page = page.replace('<link rel="stylesheet" href="style.css">', f"<style>\n{texts['style.css']}</style>")
    page = page.replace("<head>", f'<head>\n<meta http-equiv="Content-Security-Policy" content="{POLICY}">')
    script = bundle("main.js", texts)
    page = page.replace('<script type="module" src="main.js"></script>', f'<script type="module">\n{script}</script>')
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    with archive.atomic(folder / "index.html") as part:
        part.write_text(page, encoding="utf-8")
    return folder / "index.html"


_IMPORT = re.compile(r'^import \{[^}]*\} from "\./([\w.]+)";\n', flags=re.MULTILINE)


def bundle(name: str, texts: Mapping[str, str]) -> str:
    """Return a module and all that it imports from these texts as one; no two of them have a name in common."""
    return "\n".join(_alone(texts[each]) for each in _in_order(name, texts))


def _in_order(name: str, texts: Mapping[str, str], seen: set[str] | None = None) -> Iterator[str]:
    """Return a module and all that it imports, each after those that it needs."""
    seen = set() if seen is None else seen
    seen.add(name)
    for needed in _IMPORT.findall(texts[name]):
        if needed not in seen:
            yield from _in_order(needed, texts, seen)
    yield name


def _alone(text: str) -> str:
    """Return a module without its imports and exports."""
    return re.sub(r"^export ", "", _IMPORT.sub("", text), flags=re.MULTILINE)


def _catalogue(known: Sequence[Contender], python: bool) -> str:
    return f"export const CATALOGUE = {json.dumps(catalogue(known, python), allow_nan=False)};\n"


@cache
def _laws() -> str:
    """Return an ES module with every law that is a formula, by rig and name."""
    text = "export const LAWS = {};\n"
    for rig in PRESETS:
        text += f"LAWS[{json.dumps(rig)}] = {{}};\n"
        for contender in CONTENDERS:
            if code := _law(contender, rig):
                text += f"LAWS[{json.dumps(rig)}][{json.dumps(contender.name)}] = {code};\n"
    return text


def _law(contender: Contender, rig: str) -> str:
    """Return an expression for a law's functions, or for the same law on the rig of the comparisons; or nothing."""
    if not fits(contender, rig) or contender.name in ("SDRE", "iLQR MPC", "NMPC"):
        return ""
    if rig != "gustafsson2016" and (contender.policy or not fits(contender, "pilco2011")):
        return f'LAWS["gustafsson2016"][{json.dumps(contender.name)}]'
    try:
        controller = make(contender, rig, "balance")
        unlimited = dpend.rig(rig).replace(force_limit=math.inf)  # that the actuator is limited is its own affair
        law = laws.module(controller, unlimited)
    except laws.NotExportable:
        return ""
    return f"(() => {{\n{_alone(law)}return {{ reset, act, MEMORY }};\n}})()"


def plain_rig(rig: Rig, about: str = "") -> dict[str, Any]:
    """Return a rig's numbers as JSON knows them: null for what is infinite or left out."""
    numbers = rig.to_dict()
    plain = {name: _plain(value) for name, value in numbers.items() if name != "params"}
    return plain | {"params": {name: _plain(value) for name, value in numbers["params"].items()}, "about": about}


def _plain(value: Any) -> Any:
    return None if value is None or not np.isfinite(value) else value


def catalogue(known: Sequence[Contender], python: bool) -> dict[str, Any]:
    """Return what the page offers: rigs, controllers, and the shares of starts that can be saved at all.

    Parameters
    ----------
    known : sequence of Contender
        Who can be put into a scene.
    python : bool
        Whether there is a server in which they work.
    """
    looks, share = styles(each.name for each in known), kept_boundary().share
    return {
        "python": python,
        "rigs": {
            name: plain_rig(dpend.rig(name), about.partition(". Source:")[0]) for name, about in dpend.rigs().items()
        },
        "changes": CHANGES,
        "units": dict(UNITS),
        "mostCopies": MOST_COPIES,
        "controllers": [
            {
                "name": each.name,
                "tasks": each.tasks,
                "colour": looks[each.name][0],
                "line": looks[each.name][2],
                "kind": "own" if each.own else "learned" if each.policy else "designed",
                "rigs": [rig for rig in PRESETS if fits(each, rig)],
            }
            for each in known
        ],
        "saved": {
            "rig": "gustafsson2016",
            "force": float(RIG.force_limit),
            "lambdas": _LAMBDAS.tolist(),
            "shares": [round(share(lam).value, 5) for lam in _LAMBDAS.tolist()],
        },
    }
