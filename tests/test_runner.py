"""The runner of studies: complete tables, whatever happens on the way; results neither stale nor lost; refusals."""

import importlib
import itertools
import json
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import tyro
from matplotlib.figure import Figure

import dpend
from studies import _closure, _runner, lambda_sweep, published_q
from studies._closure import PACKAGES, closure, source_hash
from studies._field import CONTENDERS, find
from studies._runner import Report, Result
from studies._table import load
from tests import study_example

ROOT = Path(__file__).parent.parent
STUDIES = list(_runner.studies())
NEED_AN_IDEAL_RIG = {name for name in STUDIES if "ideal" in importlib.import_module(name).Options.needs}
VERSIONS = _runner.versions()


def example(out, *arguments):
    return [sys.executable, "-m", "tests.study_example", "--out", str(out), "--workers", "1", *arguments]


def run_example(out, *arguments):
    return _runner.main("tests.study_example", ["--out", str(out), "--workers", "1", *arguments])


# ------------------------------------------------------------------------------------------------------ whole tables


def test_a_study_writes_table_settings_arrays_figure_and_tables(tmp_path):
    table = run_example(tmp_path, "--jobs", "3")
    assert list(zip(table.rows.name, table.rows.repetition, table.rows.even, strict=True)) == [
        ("a", 0, True), ("b", 0, True), ("a", 1, False), ("b", 1, False), ("a", 2, True), ("b", 2, True)
    ]  # fmt: skip
    assert table.rows.value[0] == np.random.default_rng([0, 0]).normal()
    meta = json.loads((tmp_path / "meta.json").read_text())
    assert meta["options"]["jobs"] == 3
    assert meta["versions"]["numpy"] == np.__version__
    assert (tmp_path / "tests.study_example.png").stat().st_size > 1000
    assert (tmp_path / "tables.md").read_text().startswith("# tests.study\\_example: all tables\n\n## Rows\n")
    read = load(tmp_path)
    assert read.rows.equals(table.rows)
    assert read.array("value", repetition=1) == table.where(repetition=1, name="a").value.to_numpy()
    with pytest.raises(KeyError, match=re.escape("Expected one array 'value' where {}; there are 3.")):
        read.array("value")


def test_a_study_may_draw_several_figures_and_write_pages(tmp_path, monkeypatch):
    figures = {"": Figure(), "_more": Figure()}
    report = Report(figures=figures, tables=[], pages={"page.md": "# Text\n"})
    monkeypatch.setattr(study_example, "report", lambda table: report)
    run_example(tmp_path, "--jobs", "1", "--format", "svg")
    assert {file.name for file in tmp_path.glob("*.svg")} == {"tests.study_example.svg", "tests.study_example_more.svg"}
    assert (tmp_path / "page.md").read_text() == "# Text\n"


def test_all_that_a_quick_run_makes_says_so(tmp_path, monkeypatch, capsys):
    drawn = []
    monkeypatch.setattr(
        study_example, "report", lambda table: drawn.append(Figure()) or Report(figures=drawn[-1], tables=[])
    )
    tables = [run_example(tmp_path / quick, "--jobs", "1", *([quick] if quick else [])) for quick in ("", "--quick")]
    assert [table.quick for table in tables] == [False, True]
    assert [[text.get_text() for text in figure.texts] for figure in drawn] == [[], [_runner.QUICK]]
    assert capsys.readouterr().out.count("Quick run: too few runs to mean much.") == 1
    assert "A quick run: too few runs to mean much." in (tmp_path / "--quick" / "tables.md").read_text()


@pytest.mark.slow
def test_several_workers_give_the_same_table(tmp_path):
    one = run_example(tmp_path / "1", "--jobs", "4")
    two = _runner.main("tests.study_example", ["--out", str(tmp_path / "2"), "--workers", "2", "--jobs", "4"])
    assert one.rows.equals(two.rows)


def test_any_executor_may_do_the_jobs(tmp_path):
    options = study_example.Options(jobs=4, workers=1, out=tmp_path / "threads")
    with ThreadPoolExecutor(2) as executor:
        table = _runner.run_study("tests.study_example", options, executor)
    assert table.rows.equals(run_example(tmp_path / "here", "--jobs", "4").rows)


@pytest.mark.slow
def test_killed_in_the_middle_and_started_again_it_ends_with_the_same_table(tmp_path):
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    options = ("--nap", "0.1")
    run_example(whole, *options)
    process = subprocess.Popen(
        example(broken, *options), cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    while len(finished(broken)) < 3:
        time.sleep(0.02)
        assert process.poll() is None
    process.send_signal(signal.SIGKILL)
    process.wait()
    kept = {file: file.stat().st_mtime_ns for file in finished(broken)}
    assert 3 <= len(kept) < 12
    subprocess.run(example(broken, *options), cwd=ROOT, check=True, capture_output=True)
    assert {file: file.stat().st_mtime_ns for file in kept} == kept
    assert (broken / "rows.csv").read_text() == (whole / "rows.csv").read_text()


def finished(out):
    return [file for file in (out / "jobs").glob("*.npz") if not file.name.startswith(".")]


@pytest.mark.slow
@pytest.mark.parametrize("inherited", ["", "trap '' INT; "], ids=["as usual", "ignored, as in a shell's background"])
def test_one_ctrl_c_ends_within_a_second_keeps_what_is_done_and_says_so(inherited, tmp_path):
    command = " ".join(example(tmp_path, "--nap", "0.4", "--jobs", "200"))
    process = subprocess.Popen(
        ["sh", "-c", f"{inherited}exec {command}"],
        cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    while len(finished(tmp_path)) < 2:
        time.sleep(0.02)
        assert process.poll() is None
    pressed = time.monotonic()
    process.send_signal(signal.SIGINT)
    process.wait()
    assert time.monotonic() - pressed < 1
    assert process.returncode == 130
    assert "Stopped. Finished jobs are kept: the same command goes on from here." in process.communicate()[1]
    assert len(finished(tmp_path)) >= 2


@pytest.mark.slow
def test_a_script_without_main_guard_is_told_what_it_lacks(tmp_path):
    call = f"""
from pathlib import Path
from studies import _runner
from tests.study_example import Options
_runner.run_study("tests.study_example", Options(workers=2, out=Path({str(tmp_path)!r})))
"""
    (tmp_path / "script.py").write_text(call)
    environment = {"PYTHONPATH": str(ROOT), "PATH": ""}
    script = subprocess.run(
        [sys.executable, str(tmp_path / "script.py")], env=environment, capture_output=True, text=True
    )
    stdin = subprocess.run([sys.executable, "-"], input=call, env=environment, capture_output=True, text=True)
    for done in (script, stdin):
        assert done.returncode == 1
        assert 'if __name__ == "__main__":' in done.stderr or "is no file: save it as one" in done.stderr


@pytest.mark.parametrize("package", ["dpend", "controllers", "rl"])
def test_another_package_of_the_same_name_is_named_in_one_sentence(package, tmp_path):
    (tmp_path / package).mkdir()
    (tmp_path / package / "__init__.py").touch()
    done = subprocess.run(
        [sys.executable, "-m", "studies.sdre"], cwd=tmp_path, env={"PYTHONPATH": str(ROOT), "PATH": ""},
        capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr == (
        f"Here Python finds another package called {package!r}, {tmp_path / package / '__init__.py'}, before the one "
        "that the studies need: change to another folder, or rename that package.\n"
    )


# -------------------------------------------------------------------------------------------------- whole files


@pytest.mark.slow
def test_a_figure_that_is_too_large_for_the_disk_ends_in_one_line(tmp_path):
    run_example(tmp_path, "--jobs", "2")
    before = (tmp_path / "tests.study_example.png").read_bytes()
    done = subprocess.run(
        example(tmp_path, "--jobs", "2"), cwd=ROOT, capture_output=True, text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000)),
    )  # fmt: skip
    assert done.returncode == 2
    last = done.stderr.strip().splitlines()[-1]
    assert last == (
        f"Error: {tmp_path / 'tests.study_example.png'} could not be written: File too large. Finished jobs are kept."
    )
    assert (tmp_path / "tests.study_example.png").read_bytes() == before


def test_a_folder_that_cannot_be_written_is_refused_before_any_work(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(study_example, "run", None)
    (tmp_path / "file").touch()
    with pytest.raises(SystemExit, match="2"):
        run_example(tmp_path / "file" / "results")
    error = f"Error: Cannot write to --out {tmp_path / 'file' / 'results'} (Not a directory); "
    assert error + "choose a folder that you may write to." in capsys.readouterr().err


def test_a_damaged_job_is_done_again(tmp_path):
    before = run_example(tmp_path, "--jobs", "3")
    for file, content in zip(finished(tmp_path), (b"", b"PK cut short"), strict=False):
        file.write_bytes(content)
    cut = finished(tmp_path)[2]
    cut.write_bytes(cut.read_bytes()[:200])
    assert run_example(tmp_path, "--jobs", "3").rows.equals(before.rows)
    assert json.loads((tmp_path / "meta.json").read_text())["jobs_done_earlier"] == 0


# ------------------------------------------------------------------------------------- results that come along


@pytest.fixture
def kept(tmp_path, monkeypatch):
    """Keep a table of three jobs as those in docs/results are."""
    run_example(tmp_path / "kept", "--jobs", "3")
    shutil.rmtree(tmp_path / "kept" / "jobs")
    monkeypatch.setattr(_runner, "kept_folder", lambda short: tmp_path / "kept")
    return tmp_path / "kept"


def test_jobs_of_the_kept_table_are_not_done_again(kept, tmp_path, capsys, monkeypatch):
    run, done = study_example.run, []
    monkeypatch.setattr(study_example, "run", lambda job: done.append(job.repetition) or run(job))
    table = run_example(tmp_path / "out", "--jobs", "4", "--join")
    assert done == [3]
    assert f"3 of 4 jobs come from {kept}; --fresh computes them here." in " ".join(capsys.readouterr().out.split())
    fresh = run_example(tmp_path / "fresh", "--jobs", "4", "--join", "--fresh")
    assert done == [3, 0, 1, 2, 3]
    run_example(tmp_path / "alone", "--jobs", "1")
    assert done == [3, 0, 1, 2, 3, 0], "without anything that joins, the study is done, not copied"
    run_example(tmp_path / "again", "--jobs", "4", "--kept")
    assert done == [3, 0, 1, 2, 3, 0, 3], "unless that is asked for"
    assert f"3 of 4 jobs come from {kept}; without --kept all are" in " ".join(capsys.readouterr().out.split())
    assert table.rows.equals(fresh.rows)
    assert table.arrays("value") == fresh.arrays("value")


@pytest.mark.parametrize(
    ("changed", "other", "why"),
    [
        ("versions", lambda: VERSIONS | {"numpy": "99"}, f"was computed with numpy {np.__version__} (here 99)"),
        ("source_hash", lambda *_: "another", "has other sources"),
    ],
)
def test_a_kept_table_from_other_code_or_versions_serves_nothing(
    changed, other, why, kept, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(_runner, changed, other)
    run_example(tmp_path / "out", "--jobs", "3", "--join")
    assert json.loads((tmp_path / "out" / "meta.json").read_text())["jobs_done_earlier"] == 0
    said = " ".join(capsys.readouterr().out.split())
    assert f"None of 3 jobs comes from {kept}, which {why}; all are computed here." in said


def test_results_are_either_taken_or_not(kept, tmp_path):
    with pytest.raises(SystemExit, match="2"):
        run_example(tmp_path / "out", "--kept", "--fresh")


def test_a_kept_table_with_other_options_serves_nothing_and_says_so(kept, tmp_path, capsys):
    run_example(tmp_path / "out", "--jobs", "1", "--seed", "1", "--join")
    said = " ".join(capsys.readouterr().out.split())
    assert f"None of 1 jobs comes from {kept}, which has other options; all are computed here." in said


def test_a_kept_table_from_before_keys_were_kept_serves_nothing(kept, tmp_path):
    meta = json.loads((kept / "meta.json").read_text())
    (kept / "meta.json").write_text(json.dumps({name: meta[name] for name in meta if name != "keys"}))
    run_example(tmp_path / "out", "--jobs", "3", "--join")
    assert json.loads((tmp_path / "out" / "meta.json").read_text())["jobs_done_earlier"] == 0


# ------------------------------------------------------------------------------------------------ any rig


def test_a_rig_and_its_changes_are_part_of_the_work_and_a_column_of_the_table():
    command = ["--rig", "pilco2011", "--set", "mass1=.6", "--set", "actuator_delay=2"]
    plant = tyro.cli(_runner.Options, args=command).plant
    assert plant.rig == dpend.rig("pilco2011").replace(mass1=0.6, actuator_delay=2)
    assert _runner.plain_fields(Holding(plant)) == {"value": "pilco2011, mass1=.6, actuator_delay=2"}
    keys = {_runner.key("tests.study_example", Holding(_runner.Options(set=(change,)).plant))
            for change in ("mass1=.5", "mass1=.6", "mass1=.60001")}  # fmt: skip
    assert len(keys) == 3


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rig": "gustafson"}, "There is no preset rig 'gustafson'. Did you mean 'gustafsson2016'?"),
        ({"rig": "no.toml"}, "--rig no.toml: [Errno 2] No such file or directory: 'no.toml'"),
        ({"set": ("mass1",)}, "--set must be name=number, such as mass1=.6; got 'mass1'."),
        ({"set": ("mass=1",)},
         "--rig gustafsson2016: Neither Rig nor Params has a field 'mass'. Did you mean 'mass2'?"),
        ({"set": ("mass1=-1",)}, "mass1 must be finite and greater than 0 kg; got -1."),
    ],
)  # fmt: skip
def test_what_is_no_rig_is_refused(options, message):
    with pytest.raises(ValueError, match=f"^{re.escape(message)}"):
        _runner.Options(**options)


# ------------------------------------------------------------------------------------- results neither stale nor lost


@dataclass(frozen=True)
class Holding:
    value: object


def test_another_seed_is_other_work_and_more_jobs_leave_the_others_as_they_are(tmp_path):
    run_example(tmp_path, "--jobs", "2")
    first = set(finished(tmp_path))
    run_example(tmp_path, "--jobs", "3", "--workers", "1")
    assert len(set(finished(tmp_path)) - first) == 1
    run_example(tmp_path, "--jobs", "2", "--seed", "1")
    assert len(finished(tmp_path)) == 5


@pytest.mark.parametrize(("one", "other"), [("stiff LQR", "stiff_LQR"), (1, 1.0), (1, True), ("1", 1), ((1, 2), (12,))])
def test_jobs_that_differ_in_a_blank_or_a_sign_or_a_kind_are_kept_apart(one, other):
    name = "tests.study_example"
    assert _runner.key(name, Holding(one)) != _runner.key(name, Holding(other))


@pytest.mark.parametrize("value", [np.ones(2), [1, 2], {"a": 1}, object], ids=lambda value: type(value).__name__)
def test_a_job_that_is_no_plain_value_is_refused(value):
    with pytest.raises(
        TypeError, match=r"^A job is a frozen dataclass of numbers, words, None, enums, tuples and such"
    ):
        _runner.key("tests.study_example", Holding(value))


def test_a_row_that_repeats_a_field_of_its_job_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(study_example, "run", lambda job: Result([{"seed": 3}]))
    with pytest.raises(ValueError, match="seed is a field of the job and of the row; one is enough"):
        run_example(tmp_path)


def test_other_versions_of_libraries_are_other_work_but_not_those_that_only_draw(monkeypatch):
    job, before = Holding(1), _runner.key("tests.study_example", Holding(1))
    versions = _runner.versions()
    monkeypatch.setattr(_runner, "versions", lambda: versions | {"matplotlib": "99"})
    assert _runner.key("tests.study_example", job) == before
    monkeypatch.setattr(_runner, "versions", lambda: versions | {"numpy": "99"})
    assert _runner.key("tests.study_example", job) != before


@pytest.fixture(scope="module")
def copied(tmp_path_factory):
    root = tmp_path_factory.mktemp("copy")
    for package in PACKAGES:
        shutil.copytree(ROOT / package, root / package, ignore=shutil.ignore_patterns("__pycache__"))
    (root / "docs/results/recoverable").mkdir(parents=True)
    (root / "docs/results/recoverable/rows.csv").write_text("old")
    return root


@cache
def unedited(study, root):
    return source_hash(f"studies.{study}", root=root)


@pytest.fixture
def edit(copied):
    """Return a function that edits a file of the copy, or appends to it; whatever it did is undone at the end."""
    old = {}

    def change(name, find, put):
        file = copied / name
        content = old.setdefault(file, file.read_bytes() if file.exists() else None)
        file.parent.mkdir(exist_ok=True)
        changed = (content or b"") + put if find is None else (content or b"").replace(find, put, 1)
        assert changed != content
        file.write_bytes(changed)
        _forget()

    yield change
    for file, content in old.items():
        file.unlink() if content is None else file.write_bytes(content)
    _forget()


def _forget():
    _closure.closure.cache_clear()
    _closure._walked.cache_clear()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("study", "name", "find", "put"),
    [
        ("sdre", "controllers/sdre.py", b'."""', b'. """'),
        ("sdre", "controllers/lqr.py", None, b"\n# a comment\n"),
        ("sdre", "controllers/energy.py", None, b"\nX = 1\n"),
        ("sdre", "studies/sdre.py", b"def report(table", b"def report(its"),
        ("sdre", "studies/sdre.py", b"MINUTES = ", b"MINUTES = 1000 + "),
        ("sdre", "studies/_figures.py", b'"#0072B2"', b'"#0072B3"'),
        ("sdre", "studies/_tables.py", None, b"\nX = 1\n"),
        ("sdre", "studies/_runner.py", b"tables.md", b"tables.txt"),
        ("sdre", "dpend/draw.py", None, b"\nX = 1\n"),
        ("sdre", "rl/trained/new.npz", None, b"new"),
        ("lambda_sweep", "studies/_field.py", b'style=("#0072B2"', b'style=("#0072B3"'),
        ("lambda_sweep", "studies/recoverable.py", b"def report(", b"def report_it("),
        ("lambda_sweep", "docs/results/recoverable/rows.csv", None, b"new"),
    ],
)
def test_what_changes_no_result_throws_none_away(study, name, find, put, copied, edit):
    before = unedited(study, copied)
    edit(name, find, put)
    assert source_hash(f"studies.{study}", root=copied) == before


@pytest.mark.slow
@pytest.mark.parametrize(
    ("study", "name", "find", "put"),
    [
        ("sdre", "studies/sdre.py", b"(1.0, 10.0,", b"(1.0, 11.0,"),
        ("sdre", "studies/sdre.py", b"job.seed, 7", b"job.seed, 8"),
        ("sdre", "controllers/sdre.py", None, b"\nX = 1\n"),
        ("sdre", "dpend/equations.py", b"c1 * c2 + s1", b"c1 * c2 - s1"),  # through kernels, stepper, simulate
        ("lambda_sweep", "studies/_basins.py", b"EXTENT = 0.8", b"EXTENT = 0.7"),
        ("lambda_sweep", "rl/trained/lspi.npz", None, b"new"),
        ("lambda_sweep", "controllers/data/gustafsson2016_hanging_up-up_effort.npz", None, b"new"),
        ("lambda_sweep", "studies/_field.py", b"Q=(1, 10, 10, 1, 1, 1)", b"Q=(1, 10, 10, 1, 1, 2)"),
    ],
)
def test_what_changes_a_result_makes_it_be_computed_again(study, name, find, put, copied, edit):
    before = unedited(study, copied)
    edit(name, find, put)
    assert source_hash(f"studies.{study}", root=copied) != before


def test_a_name_of_a_package_that_loads_late_counts_as_the_module_that_defines_it_alone(copied):
    parts = {name for name in closure("studies.sdre", ("run",), root=copied)[0] if name.startswith("controllers")}
    assert {"controllers.lqr", "controllers.sdre"} <= parts
    assert not parts & {"controllers", "controllers.nmpc", "controllers.ilqr", "controllers.energy", "controllers.data"}
    shipped = closure("studies._field", ("_follower",), root=copied)[0]
    assert {"controllers.data", "controllers.tvlqr"} <= shipped.keys()
    assert any(name.endswith("effort.npz") for name in shipped)


def test_a_table_that_a_job_reads_counts_by_its_content(copied, edit):
    def parts():
        return closure("studies._boundary", ("kept_boundary",), root=copied)[0]

    before = parts()
    edit("docs/results/recoverable/rows.csv", None, b"new")
    assert {name for name, value in parts().items() if before[name] != value} == {"table recoverable"}


NAMED = ("LQR", "iLQR MPC", "LSPI", "PPO balance", "TVLQR")


def hashes(root):
    """Return the hash of a job of the robustness study for each of some contenders."""
    return {name: source_hash("studies.robustness", frozenset({"balance", "axes", name}), root) for name in NAMED}


unedited_hashes = cache(hashes)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "find", "put", "stale"),
    [
        ("studies/_field.py", b'    Contender(name="SDRE",',
         b'    Contender(name="new", make=lambda rig, task: SDRE(rig)),\n    Contender(name="SDRE",', ()),
        ("studies/_field.py", b"SDRE(rig)", b"SDRE(rig, R=2)", ()),
        ("studies/_field.py", b'make=_learned("lspi")', b'make=_learned("q-tuned")', ("LSPI",)),
        ("studies/_field.py", b"No contender is called", b"Nobody is called", NAMED),
        ("studies/_perturbations.py", b"WITHIN = 0.2", b"WITHIN = 0.3", NAMED),
        ("controllers/ilqr.py", None, b"\nX = 1\n", ("iLQR MPC",)),
        ("controllers/tvlqr.py", None, b"\nX = 1\n", ("TVLQR",)),
        ("rl/lspi.py", None, b"\nX = 1\n", ("LSPI",)),
        ("rl/trained/lspi.npz", None, b"new", ("LSPI",)),
        ("rl/trained/ppo-swing-up.npz", None, b"new", ()),
    ],
)  # fmt: skip
def test_a_job_is_stale_where_its_contender_changed_and_not_where_another_did(name, find, put, stale, copied, edit):
    before = unedited_hashes(copied)
    edit(name, find, put)
    assert [each for each, digits in hashes(copied).items() if before[each] != digits] == list(stale)


@pytest.mark.slow
def test_of_the_shipped_policies_a_job_that_names_contenders_depends_on_those_that_they_name(copied, edit):
    words = {"LQR": frozenset({"runs", "LQR"}), "PPO": frozenset({"runs", "PPO swing-up"}), "not said": None}

    def hashes():
        return {name: source_hash("studies.leaderboard", each, copied) for name, each in words.items()}

    before = hashes()
    edit("rl/trained/ppo-swing-up.npz", None, b"new")
    assert [name for name, digits in hashes().items() if before[name] != digits] == ["PPO", "not said"]


COMPARES = """
from studies._field import CONTENDERS, Contender, find
MINE = (Contender(name="mine", make=lambda rig, task: find("LQR")), *CONTENDERS)
def run(job): return find(job.law, known=MINE)
"""


def test_the_contenders_that_a_job_or_the_code_names_count_and_all_where_none_is_named(tmp_path, copied):
    shutil.copytree(copied / "studies", tmp_path / "studies")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "study.py").write_text(COMPARES)

    def entries(*words):
        parts, names = closure("mine.study", ("run",), frozenset(words), tmp_path)
        return {part.partition("[")[2][:-1] for part in parts if part.endswith("]")}, names

    assert entries("SDRE", "axes")[0] == {"SDRE"}
    assert entries("mine")[0] == {"mine", "LQR"}, "what an entry names counts with it"
    everything = {contender.name for contender in CONTENDERS} | {"mine"}
    assert entries("axes") == (everything, None)
    allowed = entries("SDRE")[1]
    assert allowed is not None
    assert "SDRE" in allowed
    assert not allowed & {"mine", "LQR", "NMPC"}


def test_a_job_cannot_look_up_a_contender_that_its_key_does_not_cover(tmp_path, monkeypatch):
    for looked_up in ("LQR", "SDRE"):
        monkeypatch.setattr(_runner, "closure", lambda *_: ({}, frozenset({"SDRE"})))
        monkeypatch.setattr(study_example, "run", lambda job, name=looked_up: Result([{"is": find(name).name}]))
        monkeypatch.setattr(study_example, "report", lambda table: Report(figures=Figure(), tables=[]))
        with pytest.raises(RuntimeError) if looked_up == "LQR" else nullcontext() as refused:
            run_example(tmp_path / looked_up, "--jobs", "1")
        if refused:
            assert str(refused.value) == (
                "The job that is being done does not name the contender 'LQR', so that its kept result would outlive a "
                "change of it; put the name into a field of the job, or write it out where it is looked up."
            )
    assert find("LQR").name == "LQR", "outside of a job everything may be looked up"


# ---------------------------------------------------------------------------------------------------- the studies


def test_the_help_of_a_study_begins_with_its_question_and_method_alone(capsys):
    with pytest.raises(SystemExit, match="0"):
        _runner.main("studies.lambda_sweep", ["--help"])
    said = capsys.readouterr().out
    assert "How do controllers and learners compare" in said
    assert "Method: " not in said
    assert "Finding: " not in said
    assert "python -m pydoc studies.lambda_sweep" in said


@pytest.mark.parametrize("name", STUDIES)
def test_every_study_takes_a_rig_and_its_help_fits_a_screen(name, capsys):
    study = importlib.import_module(name)
    with pytest.raises(SystemExit, match="0"):
        _runner.main(name, ["--help"])
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) <= 40
    assert max(map(len, lines)) <= 80
    for each in fields(study.Options):
        text = next(line for line in lines if line.startswith(f"  --{each.name.replace('_', '-')} "))
        assert len(text) > 24, "each says what it is"
    if name != "studies.deep_swing_up":  # which has trainings on one rig alone
        changed = study.Options(set=("mass1=.6",), quick=True, workers=1)
        plain = study.Options(quick=True, workers=1)
        assert plain.elsewhere is None
        assert changed.plant.rig.params.mass1 == 0.6
        assert not {*study.jobs(changed)} & {*study.jobs(plain)} or name == "studies.published_q"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--lam", "0.1", "0.0"], "lambda is the greatest starting angle in rad: expected 0 < lambda <= pi/2; "
         "got 0.0."),
        (["--lam", "-0.2"], "lambda is the greatest starting angle in rad: expected 0 < lambda <= pi/2; "
         "got -0.2."),
        (["--lam", "0.1", "0.1"], "--lam names an angle twice; got (0.1, 0.1)."),
        (["--trainings", "0"], "--trainings must be at least 1; got 0."),
        (["--episodes", "1"], "--episodes must be at least 2; got 1."),
        (["--part-of", "1"], "--part-of must be at least 2; got 1."),
        (["--basins", "-1"], "--basins must be at least 0; got -1."),
        (["--only", "LQR", "TVLQR"], "--only TVLQR: it does not balance; these do: LQR; "),
        (["--only", "Q publish"], "No contender is called 'Q publish'. Did you mean 'Q published'?"),
        (["--workers", "0"], "--workers must be at least 1; got 0."),
        (["--seed", "-1"], "--seed must be at least 0; got -1."),
    ],
)  # fmt: skip
def test_bad_options_are_refused_before_any_training(arguments, message, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(lambda_sweep, "run", None)
    with pytest.raises(SystemExit, match="2"):
        _runner.main("studies.lambda_sweep", ["--out", str(tmp_path), *arguments])
    shown = re.sub(r"[\s│|]+", "", capsys.readouterr().err)  # in a box, wrapped anywhere
    assert message.replace(" ", "") in shown


@pytest.mark.parametrize("name", STUDIES)
def test_every_study_says_its_question_and_its_finding(name):
    question, *_, finding = (importlib.import_module(name).__doc__ or "").strip().split("\n\n")
    assert question.endswith("?")
    assert finding.startswith("Finding: ")


def runs_quickly(name, tmp_path, *rig):
    table = _runner.main(name, ["--quick", "--out", str(tmp_path), "--workers", "1", *rig])
    assert len(table.rows)
    assert (tmp_path / f"{name.removeprefix('studies.')}.png").stat().st_size > 10_000


AT_NIGHT = {
    f"studies.{name}" for name in ("lambda_sweep", "leaderboard", "recoverable", "robustness", "smoothness", "swing_up")
}
"""Studies whose own tests run their jobs and reports, with a few contenders; by day these are enough."""


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.nightly if name in AT_NIGHT else pytest.mark.slow) for name in STUDIES],
)
def test_every_study_runs_quickly(name, tmp_path):
    runs_quickly(name, tmp_path)


@pytest.mark.nightly
@pytest.mark.parametrize("rig", [("--rig", "pilco2011"), ("--set", "mass1=.6")], ids=" ".join)
@pytest.mark.parametrize("name", sorted(set(STUDIES) - {"studies.deep_swing_up"}))  # which has trainings on one rig
def test_every_study_runs_quickly_on_another_rig(name, rig, tmp_path):
    if name in NEED_AN_IDEAL_RIG and rig == ("--rig", "pilco2011"):
        rig = (*rig, "--set", "sensor_noise=0")
    runs_quickly(name, tmp_path, *rig)


def test_the_published_sweep_covers_every_reading_on_both_plants():
    jobs = published_q.jobs(published_q.Options(quick=True))
    readings = len(list(published_q._readings()))
    learners, laws = len(published_q.LEARNERS), len(published_q.LAWS)
    assert readings == 24
    assert len({job.plant for job in jobs}) == 2
    assert len(jobs) == len(set(jobs)) == 2 * (2 * learners + 2 * 2 * (readings - 1) + laws)


def test_where_a_training_converges_its_weights_are_evaluated_frozen_and_learning():
    job = next(job for job in published_q.jobs(published_q.Options(quick=True)) if job.learner == "12 features")
    rows, arrays = published_q.run(replace(job, trainings=2, max_episodes=400, lams=(0.1,)))
    assert [row.streak for row in rows] == list(published_q.STREAKS)
    assert all(before.converged >= row.converged for before, row in itertools.pairwise(rows))
    frozen, learning = arrays["frozen"], arrays["learning"]
    assert [int((each >= 0).sum()) for each in learning[..., 0].T] == [row.converged for row in rows]
    assert ((frozen[:, :, 0] >= 0) == (learning >= 0)).all()
    assert max(frozen.max(), learning.max()) <= job.episodes


def test_the_finding_about_the_report_is_what_the_kept_table_says():
    rows = _runner.read_rows(_runner.kept_table("published_q"))
    finding = " ".join((published_q.__doc__ or "").split("Finding:")[1].split())
    main = _runner.where(rows, trainings=60, learner="12 features", theta2="random")
    once, ten = (
        [
            _runner.where(main, plant=plant, streak=streak)["converged"].item() / 0.6
            for plant in (published_q.AS_CODED, _runner.DEFAULT_RIG)
        ]
        for streak in (1, 10)
    )
    assert f"in {once[0]:.0f} % [63, 84] of 60 trainings on the program's plant and in {once[1]:.0f} %" in finding
    assert f"ten in a row in {ten[0]:.0f} % and {ten[1]:.0f} %" in finding
    assert set(_runner.where(rows, trainings=60, learner="18 features")["converged"]) == {0}


@pytest.mark.slow
def test_the_list_of_studies_takes_one_line_for_each_with_its_minutes():
    done = subprocess.run([sys.executable, "-m", "studies"], cwd=ROOT, check=True, capture_output=True, text=True)
    lines = done.stdout.splitlines()
    assert len(lines) <= 25
    assert max(map(len, lines)) <= 80
    for name in STUDIES:
        (line,) = (line for line in lines if line.startswith(f"{name} "))
        minutes, question = line.removeprefix(name).split(maxsplit=1)
        assert float(minutes) == importlib.import_module(name).MINUTES
        assert (importlib.import_module(name).__doc__ or "").replace("\n", " ").startswith(question.rstrip("…"))
