"""The page: a section for each study, the leaderboard, and replays of runs, from folders of saved tables alone."""

from __future__ import annotations

import base64
import html
import importlib
import io
import json
import re
from collections.abc import Iterable, Iterator, Mapping
from importlib.resources import files
from itertools import cycle
from pathlib import Path
from string import Template
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

import dpend
from dpend import archive, emit
from dpend.params import Array

from .. import film
from .._field import styles
from .._table import Table, load
from ..playground.export import POLICY, bundle, plain_rig, web_files

_WIDTH = 1360  # of a figure, px: twice that of the page's text
_QUALITY = 82
_FIRST = ("leaderboard", "lambda_sweep", "recoverable", "swing_up", "smoothness", "robustness", "learning_curves")
"""Those that come first; the others follow by name."""
_WITHOUT = {
    "laws.js": "export const LAWS = {};\n",
    "catalogue.js": 'export const CATALOGUE = { python: false, saved: { rig: "" }, rigs: {}, controllers: [] };\n',
}
"""What stands in the place of the playground's laws and catalogue: a replay needs neither."""


class _Study(NamedTuple):
    """A study, and the folders that hold tables of it."""

    name: str
    folders: list[Path]


def write(results: Path, out: Path) -> Path:
    """Write a page on what the tables in a folder say, and return its path; it needs no other file.

    Parameters
    ----------
    results : Path
        Folder with a folder for each table, as studies write them.
    out : Path
        The file, ``.html``; its folder is made if need be.

    Raises
    ------
    OSError
        If something cannot be read or written.
    ValueError
        If there is no table, or the file is no page.
    """
    if out.suffix != ".html":
        raise ValueError(f"--out must be a file that ends in .html; got {str(out)!r}.")
    studies = _studies(results)
    if not studies:
        raise ValueError(
            f"No study's table lies in {results}: expected folders such as {results / 'leaderboard'}, "
            "which python -m studies.leaderboard --out writes."
        )
    page = _page(studies)
    out.parent.mkdir(parents=True, exist_ok=True)
    with archive.atomic(out) as part:
        part.write_text(page, encoding="utf-8")
    return out


def _studies(results: Path) -> list[_Study]:
    """Return the studies of which there are tables, in the order of the page."""
    found: dict[str, _Study] = {}
    for meta in sorted(results.glob("*/meta.json")):
        name = json.loads(meta.read_text(encoding="utf-8"))["study"].removeprefix("studies.")
        found.setdefault(name, _Study(name, [])).folders.append(meta.parent)
    order = {name: place for place, name in enumerate(_FIRST)}
    return sorted(found.values(), key=lambda study: (order.get(study.name, len(order)), study.name))


def _page(studies: Iterable[_Study]) -> str:
    studies = list(studies)
    web = {file.name: file.read_text(encoding="utf-8") for file in (files("studies") / "report" / "web").iterdir()}
    tables = {file.name: file.read_text(encoding="utf-8") for file in (files("studies") / "web").iterdir()}
    board = next(filter(None, map(_leaderboard, studies)), "")
    replays = list(_replays(studies))
    script = ""
    if replays:
        data = json.dumps(replays, allow_nan=False, separators=(",", ":"))
        texts = web_files() | _WITHOUT | {"plant.js": emit.plant("js"), "replay.js": web["replay.js"]}
        script = bundle("replay.js", texts | {"replays.js": f"export const REPLAYS = {data};\n"})
    return Template(web["report.html"]).substitute(
        policy=POLICY,
        style=tables["table.css"] + web["report.css"],
        script=script,
        sort=tables["table.js"] if board else "",
        replays=web["replay.html"] if script else "",
        contents="".join(
            f'<li><a href="#{study.name}">{html.escape(_said(study.name)[0])}</a></li>' for study in studies
        ),
        sections="\n".join(_section(study, board) for study in studies),
    )


def _said(name: str) -> list[str]:
    """Return question, method and finding of a study, as its docstring states them."""
    words = importlib.import_module(f"studies.{name}").__doc__ or ""
    question, _, others = words.partition("Method:")
    method, _, finding = others.partition("Finding:")
    return [" ".join(part.split()) for part in (question, method, finding)]


def _section(study: _Study, board: str) -> str:
    question, method, finding = map(_marked, _said(study.name))
    parts = [f'<section id="{study.name}">', f"<h2>{question}</h2>", f"<p><strong>Finding:</strong> {finding}</p>"]
    for folder in study.folders:
        if json.loads((folder / "meta.json").read_text(encoding="utf-8"))["quick"]:
            parts.append(
                f"<p><strong>{html.escape(folder.name)} is a quick run: too few runs to mean much.</strong></p>"
            )
        parts += [_figure(file, question) for file in sorted(folder.glob("*.png"))]
    if study.name == "leaderboard":
        parts.append(board)
    parts.append(f"<details><summary>Method</summary><p>{method}</p></details>")
    parts.append(f"<p><code>python -m studies.{study.name}</code></p></section>")
    return "\n".join(parts)


def _marked(text: str) -> str:
    """Return words of a docstring as HTML: what stands between double backticks is code."""
    return re.sub(r"``(.+?)``", r"<code>\1</code>", html.escape(text))


def _figure(file: Path, question: str) -> str:
    """Return a figure with its picture in it, no wider than the page can show."""
    with Image.open(file) as image:
        picture = image.convert("RGB")
    if picture.width > _WIDTH:
        picture = picture.resize((_WIDTH, round(picture.height * _WIDTH / picture.width)), Image.Resampling.LANCZOS)
    data = io.BytesIO()
    picture.save(data, "WEBP", quality=_QUALITY, method=2)
    source = f"data:image/webp;base64,{base64.b64encode(data.getvalue()).decode()}"
    name = f"{file.parent.name}/{file.name}"
    size = f'width="{picture.width}" height="{picture.height}"'
    words = f"Figure {html.escape(name)}, on the question: {question}"
    return f'<figure><img src="{source}" {size} alt="{words}"><figcaption>{html.escape(name)}</figcaption></figure>'


def _leaderboard(study: _Study) -> str:
    """Return the table that sorts, out of the page that the leaderboard wrote; nothing where there is none."""
    for folder in study.folders:
        if study.name == "leaderboard" and (page := folder / "leaderboard.html").exists():
            found = re.search(r'<div class="wide".*?</dl>', page.read_text(encoding="utf-8"), flags=re.DOTALL)
            if found:
                table, _, meanings = found.group().partition("<h2>What the columns mean</h2>")
                return f"{table}<details><summary>What the columns mean</summary>{meanings}</details>"
    return ""


# ------------------------------------------------------------------------------------------------------------- replays


_PUSHED = ("duel", "learned")


def _replays(studies: Iterable[_Study]) -> Iterator[dict[str, Any]]:
    """Return scenes: everyone under the same pushes, a training on its way, and the swings from hanging."""
    tables = {study.name: load(study.folders[0]) for study in studies if study.name in ("film", "swing_up")}
    if "film" in tables:
        table = tables["film"]
        pushed = [run for scene in _PUSHED for run in _filmed(table, scene)]
        yield from _scene("Everyone under the same pushes", "balance", table, pushed)
        yield from _scene(film.CAPTIONS["training"], "balance", table, list(_filmed(table, "training")))
    if "swing_up" in tables:
        table = tables["swing_up"]
        yield from _scene("Swing-up from near hanging", "swing-up", table, list(_first_swings(table)))


def _scene(title: str, task: str, table: Table, runs: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return a scene in a list, or none where it has no runs."""
    return [{"title": title, "task": task, "rig": plain_rig(table.rig), "runs": runs}] if runs else []


def _filmed(table: Table, scene: film.SceneName) -> Iterator[dict[str, Any]]:
    runs = film.runs_of(table, scene)
    colours = film.colours(scene, list(runs))
    dashes = ("-", "--", "-.", ":") if scene == "training" else ("-",)  # which has one colour
    for (name, run), colour, line in zip(runs.items(), colours, cycle(dashes), strict=False):
        yield _run(name, {"colour": colour, "line": line}, run.x, run.u, run.status)


def _first_swings(table: Table) -> Iterator[dict[str, Any]]:
    lines = list(table.lines(timed=True, start="hanging", first=0))
    looks = styles(line.contender for line in lines)
    for name in looks:
        x, u, left = (table.array(each, contender=name, timed=True, start="hanging", first=0)
                      for each in ("x", "u", "left"))  # fmt: skip
        samples = int(np.isfinite(u).sum())
        status = dpend.Status.TRACK_END if left[0] else dpend.Status.FULL_LENGTH
        colour, _, dashes = looks[name]
        yield _run(name, {"colour": colour, "line": dashes}, x[: samples + 1], u[:samples], status)


def _run(name: str, look: Mapping[str, Any], x: Array, u: Array, status: dpend.Status) -> dict[str, Any]:
    """Return a run as JSON has it; four decimals are more than a screen shows."""
    rounded = np.round(x, 4).tolist()
    return {"look": {"name": name, **look}, "x": rounded, "u": np.round(u, 3).tolist(), "code": status.code}
