"""What the documentation shows, works; what is public, it documents."""

import doctest
import importlib
import inspect
import re
import subprocess
import sys
from enum import Enum
from importlib.util import find_spec
from pathlib import Path
from types import FunctionType

import gymnasium as gym
import numpy as np
import pytest

import dpend.env
import dpend.vector_env
from docs import protocols, result_tables
from dpend.tasks import Balance, SwingUp

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
CHAPTERS = sorted(path for path in DOCS.glob("learn/*.md") if path.stem != "index")


@pytest.mark.parametrize("chapter", CHAPTERS, ids=[path.stem for path in CHAPTERS])
def test_a_chapter_prints_what_it_shows(chapter):
    session = "\n".join(re.findall(r"```pycon\n(.*?)```", chapter.read_text(), flags=re.DOTALL))
    example = doctest.DocTestParser().get_doctest(session, {}, chapter.stem, str(chapter), 0)
    assert example.examples, "a chapter shows something that runs"
    lines: list[str] = []
    assert doctest.DocTestRunner().run(example, out=lines.append).failed == 0, "".join(lines)


def run(page):
    """Run the Python of a page from top to bottom, but what says first that it is not run."""
    blocks = re.findall(r"```python\n(.*?)```", (DOCS / page).read_text(), flags=re.DOTALL)
    exec(compile("\n".join(each for each in blocks if not each.startswith("# not run here: ")), page, "exec"), {})


def test_the_first_page_runs_from_top_to_bottom(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run("start.md")
    balanced, fell, _, planned, estimated = capsys.readouterr().out.splitlines()
    assert balanced == dpend.Status.FULL_LENGTH.value
    assert fell == dpend.Status.LINK2_FELL.value  # as the page says of the law that knows nothing of the theory
    assert planned.startswith("True ")
    assert estimated == "True"
    assert (tmp_path / "run.png").stat().st_size


def test_the_page_of_own_controllers_runs_and_says_what_by_hand_breaks(capsys):
    run("own-controller.md")
    balanced, fell, *broken, held = capsys.readouterr().out.splitlines()
    assert balanced == held == dpend.Status.FULL_LENGTH.value
    assert fell != balanced
    assert any("turn" in line for line in broken)


@pytest.mark.slow
def test_the_page_of_learners_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run("training.md")
    *_, swung_up, paid = capsys.readouterr().out.splitlines()
    assert swung_up == "True"
    assert float(paid.split()[0]) > 99


RUN_ABOVE_OR_ELSEWHERE = {"start.md", "own-controller.md", "training.md", "identify.md", "ilqr.md"}
LONG = {"model-based.md", "trajectory-optimisation.md", "tuned-linear.md"}


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(path.name, marks=pytest.mark.nightly if path.name in LONG else pytest.mark.slow)
        for path in sorted(DOCS.glob("*.md"))
        if "```python" in path.read_text() and path.name not in RUN_ABOVE_OR_ELSEWHERE
    ],
)
def test_the_python_of_every_other_page_runs(page, monkeypatch):
    monkeypatch.chdir(ROOT)
    run(page)


@pytest.mark.parametrize("page", sorted(path.relative_to(DOCS).as_posix() for path in DOCS.glob("**/*.md")))
def test_the_commands_of_a_page_name_what_exists(page):
    blocks = re.findall(r"```(?:sh)?\n(.*?)```", (DOCS / page).read_text(), flags=re.DOTALL)
    named = set(re.findall(r"python -m ((?:dpend|controllers|rl|studies|benchmarks|examples)[\w.]*)", "".join(blocks)))
    assert all(find_spec(name) for name in named), named


def test_the_loop_of_an_agent_ends_as_the_task_says(capsys):
    run("reference/environments.md")
    assert capsys.readouterr().out.strip() in {f"{dpend.Status[f'LINK{i}_FELL'].value} False" for i in (1, 2)}


@pytest.mark.parametrize("package", ["dpend", "controllers", "rl"])
def test_every_public_name_is_in_the_reference(package):
    page = (DOCS / f"reference/{package}.rst").read_text()
    documented = re.findall(rf"^\.\. auto(?:class|function|data):: {package}\.(\w+)$", page, flags=re.MULTILINE)
    listed = re.findall(r"^   (\w+)$", page, flags=re.MULTILINE)
    assert set(importlib.import_module(package).__all__) == set(documented) == set(listed)


def public(package):
    """Return what a package exports that has a docstring: classes, their methods, and functions, by path."""
    module, found = importlib.import_module(package), {}
    for name in module.__all__:
        each = getattr(module, name)
        if inspect.isfunction(each) or inspect.isclass(each):
            found[f"{package}.{name}"] = each
        if inspect.isclass(each):
            methods = (method for method in vars(each).items() if inspect.isfunction(method[1]) and method[0][0] != "_")
            found |= {f"{package}.{name}.{key}": method for key, method in methods}
    return found


@pytest.mark.skipif(find_spec("numpydoc") is None, reason="needs the extra docs")
@pytest.mark.parametrize("package", ["dpend", "controllers", "rl"])
def test_what_is_public_is_documented_as_numpydoc_asks(package):
    from numpydoc.docscrape import get_doc_object  # pyright: ignore[reportMissingImports]  (extra docs)
    from numpydoc.validate import validate  # pyright: ignore[reportMissingImports]

    found = []
    for path, each in public(package).items():
        if inspect.isfunction(each):
            method = each
            each = FunctionType(each.__code__, each.__globals__, each.__name__, each.__defaults__, each.__closure__)
            each.__kwdefaults__, each.__doc__ = method.__kwdefaults__, protocols.completed(method) + "\n"
        errors = validate(get_doc_object(each))["errors"]
        if inspect.isclass(each) and issubclass(each, Enum):  # its signature is Python's, and differs between versions
            errors = [error for error in errors if error[0] != "PR01"]
        found += [(path, *error) for error in errors]
    assert not found, "\n".join(map(str, found))


@pytest.mark.slow
@pytest.mark.parametrize("package", ["dpend", "controllers", "rl"])
def test_the_examples_of_docstrings_print_what_they_show(package):
    lines: list[str] = []
    runner, parser = doctest.DocTestRunner(), doctest.DocTestParser()
    for path, each in public(package).items():
        runner.run(parser.get_doctest(inspect.cleandoc(each.__doc__ or ""), {}, path, None, 0), out=lines.append)
    assert runner.summarize(verbose=False).failed == 0, "".join(lines)


PAGES = {path.relative_to(DOCS).as_posix(): path.read_text() for path in [*DOCS.glob("*.md"), *DOCS.glob("learn/*.md")]}
FROM_A_BENCHMARK = {"trajectory-optimisation.md"}  # which keeps no table
INTERVAL = re.compile(r"(?<!U)\[([-−+]?[\d.]+), ([-−+]?[\d.]+)\]")


def _intervals(text):
    """Return the intervals in a text as pairs of numbers with their decimals."""
    pairs = [[end.replace("−", "-") for end in pair] for pair in INTERVAL.findall(text)]
    return [tuple((float(end), len(end.partition(".")[2])) for end in pair) for pair in pairs]


@pytest.mark.parametrize("page", sorted(set(PAGES) - FROM_A_BENCHMARK))
def test_every_interval_on_a_page_stands_in_a_table_of_a_study(page):
    kept = {
        (low, high)
        for path in result_tables.RESULTS.glob("*/tables.md")
        for (low, _), (high, _) in _intervals(path.read_text())
    }
    text = re.sub(r"```.*?```|\$.*?\$", "", PAGES[page], flags=re.DOTALL)
    for (low, places), (high, more) in _intervals(text):
        close = 0.5001 * 10.0**-places, 0.5001 * 10.0**-more
        assert any(abs(a - low) <= close[0] and abs(b - high) <= close[1] for a, b in kept), f"[{low}, {high}]"


@pytest.mark.parametrize("page", sorted(set(PAGES) - FROM_A_BENCHMARK - {"report.md"}))  # whose evidence is a table
def test_no_page_repeats_a_table_of_results(page):
    repeated = [line for line in PAGES[page].splitlines() if line.startswith("|") and INTERVAL.search(line)]
    assert not repeated, "\n".join(repeated)


def test_a_table_is_found_by_its_title_and_cut_to_what_is_named():
    shown = result_tables.table("lambda_sweep_100", "Starts saved, %").part(["contender", "λ = 0.3"], ["LSPI", "LQR"])
    assert [line[0] for line in shown.lines] == ["LSPI", "LQR"]
    assert shown.headings == ["contender", "λ = 0.3"]
    with pytest.raises(LookupError, match=re.escape("no column 'λ = 0.7'")):
        shown.part(["λ = 0.7"])
    with pytest.raises(LookupError, match="no row 'nobody'"):
        shown.part(rows=["nobody"])
    with pytest.raises(LookupError, match=re.escape("2 tables begin with 'Balancing, λ = 0.3', not one")):
        result_tables.table("smoothness", "Balancing, λ = 0.3")


def test_every_command_that_is_listed_exists():
    named = set(re.findall(r"`python -m ([\w.]+)", (DOCS / "reference/commands.md").read_text()))
    assert named
    assert all(find_spec(name) for name in named)


def test_the_page_of_files_shows_a_rig_that_can_be_read_and_names_all_that_a_run_holds(tmp_path):
    page = (DOCS / "reference/files.md").read_text()
    (shown,) = re.findall(r"```toml\n(.*?)```", page, flags=re.DOTALL)
    (tmp_path / "shown.toml").write_text(shown)
    rig = dpend.rig(str(tmp_path / "shown.toml"))
    assert rig == dpend.rig("gustafsson2016")
    with np.load(dpend.simulate(rig, lambda t, x: 0.0, np.zeros(6), duration=0.1).save(tmp_path / "run")) as run:
        assert set(run) <= set(re.findall(r"`(\w+)`", page))


def test_the_page_of_environments_names_each_and_all_that_it_takes():
    page = (DOCS / "reference/environments.md").read_text()
    assert {name for name in gym.registry if name.startswith("dpend/")} == set(
        re.findall(r"^\| `(dpend/\S+)`", page, re.M)
    )
    classes = dpend.env.CartDoublePendulumEnv, dpend.vector_env.CartDoublePendulumVectorEnv, Balance, SwingUp
    taken = {name for each in classes for name in inspect.signature(each).parameters} - {"task"}
    assert taken <= set(re.findall(r"`(\w+)`", page.partition("## Arguments")[2]))


@pytest.mark.slow
@pytest.mark.skipif(find_spec("sphinx") is None or find_spec("numpydoc") is None, reason="needs the extra docs")
def test_the_site_builds_without_a_warning(tmp_path):
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-W",
        "-n",
        "-q",
        "-d",
        str(tmp_path / "trees"),
        str(DOCS),
        str(tmp_path),
    ]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    assert (tmp_path / "learn/plant.html").exists()
