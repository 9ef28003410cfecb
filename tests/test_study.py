"""The runner of studies: complete tables, whatever happens on the way; clear refusals."""

import importlib
import json
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from studies import _study, lambda_sweep, published_q
from tests import study_example

ROOT = Path(__file__).parent.parent


def example(out, *arguments):
    return [sys.executable, "-m", "tests.study_example", "--out", str(out), "--workers", "1", *arguments]


def test_a_study_writes_table_settings_traces_and_figure(tmp_path):
    rows = _study.main("tests.study_example", ["--out", str(tmp_path), "--workers", "1", "--jobs", "3"])
    assert [(row.name, row.repetition, row.even) for row in rows] == [
        ("a", 0, True), ("b", 0, True), ("a", 1, False), ("b", 1, False), ("a", 2, True), ("b", 2, True)
    ]  # fmt: skip
    assert rows[0].value == np.random.default_rng([0, 0]).normal()
    meta = json.loads((tmp_path / "meta.json").read_text())
    assert meta["options"]["jobs"] == 3
    assert meta["versions"]["numpy"] == np.__version__
    assert (tmp_path / "tests.study_example.png").stat().st_size > 1000
    assert set(_study.read_traces(tmp_path / "traces.npz")) == {"nap-0", "nap-1", "nap-2"}


def test_a_study_may_draw_several_figures(tmp_path, monkeypatch):
    monkeypatch.setattr(study_example, "plot", lambda rows, traces: {"": Figure(), "_more": Figure()})
    _study.main("tests.study_example", ["--out", str(tmp_path), "--workers", "1", "--jobs", "1"])
    assert {file.name for file in tmp_path.glob("*.png")} == {"tests.study_example.png", "tests.study_example_more.png"}


@pytest.mark.slow
def test_several_workers_give_the_same_table(tmp_path):
    tables = [
        _study.main("tests.study_example", ["--out", str(tmp_path / n), "--workers", n, "--jobs", "4"]) for n in "12"
    ]
    assert tables[0] == tables[1]


@pytest.mark.slow
def test_killed_in_the_middle_and_started_again_it_ends_with_the_same_table(tmp_path):
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    options = ("--nap", "0.1")
    _study.main("tests.study_example", ["--out", str(whole), "--workers", "1"])
    process = subprocess.Popen(
        example(broken, *options), cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    while len(list((broken / "jobs").glob("*.json"))) < 3:
        time.sleep(0.02)
        assert process.poll() is None
    process.send_signal(signal.SIGKILL)
    process.wait()
    kept = {file: file.stat().st_mtime_ns for file in (broken / "jobs").glob("*.json")}
    assert 3 <= len(kept) < 12
    subprocess.run(example(broken, *options), cwd=ROOT, check=True, capture_output=True)
    assert {file: file.stat().st_mtime_ns for file in kept} == kept
    assert (broken / "rows.csv").read_text() == (whole / "rows.csv").read_text()


def test_ctrl_c_keeps_what_is_done_and_says_so(tmp_path):
    process = subprocess.Popen(
        [*example(tmp_path, "--nap", "0.1", "--jobs", "200")],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    while len(list((tmp_path / "jobs").glob("*.json"))) < 2:
        time.sleep(0.02)
        assert process.poll() is None
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate()
    assert process.returncode == 130
    assert "Stopped. Finished jobs are kept: the same command goes on from here." in errors
    assert len(list((tmp_path / "jobs").glob("*.json"))) >= 2


def test_other_options_are_other_work(tmp_path):
    first = _study.main("tests.study_example", ["--out", str(tmp_path), "--workers", "1", "--jobs", "2"])
    other = _study.main("tests.study_example", ["--out", str(tmp_path), "--workers", "1", "--jobs", "2", "--seed", "1"])
    assert all(a.value != b.value for a, b in zip(first, other, strict=True))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--lam", "0.1", "0.0"], "lambda is the greatest starting angle in rad: expected 0 < lambda <= pi/2; "
         "got 0.0."),
        (["--lam", "-0.2"], "lambda is the greatest starting angle in rad: expected 0 < lambda <= pi/2; "
         "got -0.2."),
        (["--lam", "0.1", "0.1"], "--lam names a spread twice; got (0.1, 0.1)."),
        (["--trainings", "0"], "--trainings must be at least 1; got 0."),
        (["--episodes", "1"], "--episodes must be at least 2; got 1."),
        (["--part-of", "1"], "--part-of must be at least 2; got 1."),
        (["--basins", "-1"], "--basins must be at least 0; got -1."),
        (["--only", "TVLQR"], "--only names nobody that balances; got ('TVLQR',)."),
        (["--only", "Q publish"], "Nobody that can take part is called 'Q publish'. Did you mean 'Q published'?"),
        (["--workers", "0"], "--workers must be at least 1; got 0."),
        (["--seed", "-1"], "--seed must be at least 0; got -1."),
    ],
)  # fmt: skip
def test_bad_options_are_refused_before_any_training(arguments, message, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(lambda_sweep, "run", None)
    with pytest.raises(SystemExit, match="2"):
        _study.main("studies.lambda_sweep", ["--out", str(tmp_path), *arguments])
    assert message in re.sub(r"[\s│]+", " ", capsys.readouterr().err)


def test_a_folder_that_cannot_be_written_is_refused_before_any_training(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(lambda_sweep, "run", None)
    (tmp_path / "file").touch()
    with pytest.raises(SystemExit, match="2"):
        _study.main("studies.lambda_sweep", ["--out", str(tmp_path / "file" / "results")])
    error = f"Error: Cannot write to --out {tmp_path / 'file' / 'results'} (Not a directory); "
    assert error + "choose a folder that you may write to." in capsys.readouterr().err


@pytest.mark.parametrize("name", list(_study.studies()))
def test_every_study_says_its_question_and_its_finding(name):
    question, *_, finding = (importlib.import_module(name).__doc__ or "").strip().split("\n\n")
    assert question.endswith("?")
    assert finding.startswith("Finding: ")


@pytest.mark.slow
@pytest.mark.parametrize("name", list(_study.studies()))
def test_every_study_runs_quickly(name, tmp_path):
    rows = _study.main(name, ["--quick", "--out", str(tmp_path), "--workers", "1"])
    assert rows
    assert (tmp_path / f"{name.removeprefix('studies.')}.png").stat().st_size > 10_000


@pytest.mark.parametrize("what", ["source", "version", "option", "seed"])
def test_a_result_is_kept_only_for_the_same_sources_versions_and_options(what, monkeypatch):
    job, options = _study.Job("LQR"), lambda_sweep.Options()
    before = _study._key("studies.lambda_sweep", job, options)
    assert _study._key("studies.lambda_sweep", job, replace(options, workers=7, out=Path("x"))) == before
    if what == "source":
        monkeypatch.setattr(_study, "fingerprint", lambda *sources: "other")
    elif what == "version":
        monkeypatch.setattr(_study, "versions", lambda: {"numpy": "99"})
    elif what == "option":
        options = replace(options, episodes=7)
    else:
        options = replace(options, seed=5)
    assert _study._key("studies.lambda_sweep", job, options) != before


def test_a_result_depends_on_what_is_shipped_with_the_code(monkeypatch):
    counted = []
    monkeypatch.setattr(_study, "fingerprint", lambda *sources: counted.extend(sources) or "")
    _study._source("studies.swing_up")
    names = {file.name for file in counted}
    assert {"ppo-swing-up.npz", "gustafsson2016_hanging_up-up_effort.npz", "swing_up.py", "_entrants.py"} <= names


def test_the_published_sweep_covers_every_combination():
    rows = [
        row
        for job in published_q.jobs(published_q.Options())[:1]
        for row in published_q.run(job, published_q.Options(quick=True)).rows
    ]
    ways = {(row.failure_cost, row.failed_step, row.streak) for row in rows}
    assert len(ways) == len(published_q.FAILURE_COSTS) * len(published_q.BOOTSTRAPS) * len(published_q.STREAKS)
    assert len(published_q.jobs(published_q.Options())) == 12


def test_the_list_of_studies_names_each_with_its_finding():
    shown = subprocess.run(
        [sys.executable, "-m", "studies"], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout
    for name in _study.studies():
        assert f"python -m {name}" in shown
    assert "Finding" in shown
