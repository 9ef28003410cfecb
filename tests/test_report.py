"""The page of all studies needs no other file, and replays what was recorded."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from rigs import whole

from studies import film
from studies._table import load
from studies.report import write
from studies.report.__main__ import main

RESULTS = Path(__file__).parent.parent / "docs" / "results"


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the page of three tables: film, leaderboard, and a study that has neither runs nor a table that sorts."""
    folder = tmp_path_factory.mktemp("results")
    for name in ("film", "leaderboard", "sdre"):
        shutil.copytree(RESULTS / name, folder / name)
    return write(folder, folder / "report.html").read_text(encoding="utf-8")


def test_the_page_needs_nothing_else(page: str) -> None:
    assert "default-src 'none'" in page
    links = re.findall(r'(?:src|href)="([^"]*)"', page)
    assert links
    assert {link.partition(",")[0][:5] for link in links} <= {"data:", *(f"#{each}"[:5] for each in
                                                                        ("leaderboard", "film", "sdre"))}  # fmt: skip
    assert not re.search(r"@import|url\(|fetch\(|^import ", page, flags=re.MULTILINE)


def test_it_has_every_figure_each_finding_and_the_table_that_sorts(page: str) -> None:
    pictures = [file for name in ("film", "leaderboard", "sdre") for file in (RESULTS / name).glob("*.png")]
    assert page.count('<img src="data:image/webp;base64,') == len(pictures) > 2
    assert page.count("<strong>Finding:</strong>") == 3
    assert page.count("<tbody>") == 1
    assert page.index('id="leaderboard"') < page.index("<tbody>") < page.index('id="film"')


def test_replays_are_the_recorded_runs(page: str) -> None:
    (found,) = re.findall(r"^const REPLAYS = (.*);$", page, flags=re.MULTILINE)
    scenes, table = {scene["title"]: scene for scene in json.loads(found)}, load(RESULTS / "film")
    runs = film.runs_of(table, "duel")
    shown = {run["look"]["name"]: run for run in scenes["Everyone under the same pushes"]["runs"]}
    assert list(shown) == [*runs, *film.runs_of(table, "learned")]
    for name, run in runs.items():
        replay = shown[name]
        np.testing.assert_allclose(replay["x"], run.x, atol=6e-5)
        np.testing.assert_allclose(replay["u"], run.u, atol=6e-4)
        assert replay["code"] == run.status.code


@pytest.mark.skipif(shutil.which("node") is None, reason="There is no node.")
def test_its_modules_stand_in_one_without_a_name_in_common(page: str, tmp_path: Path) -> None:
    (script,) = re.findall(r'<script type="module">\n(.*?)</script>', page, flags=re.DOTALL)
    (tmp_path / "page.mjs").write_text(script, encoding="utf-8")
    done = subprocess.run(["node", "--check", tmp_path / "page.mjs"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_what_cannot_be_written_is_refused_with_the_remedy(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["--results", str(tmp_path), "--out", str(tmp_path / "report.html")])
    assert capsys.readouterr().err == (
        f"No study's table lies in {tmp_path}: expected folders such as {tmp_path / 'leaderboard'}, "
        "which python -m studies.leaderboard --out writes.\n"
    )
    with pytest.raises(ValueError, match=whole("--out must be a file that ends in .html; got 'report.pdf'.")):
        write(RESULTS, Path("report.pdf"))
