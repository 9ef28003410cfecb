"""What the README shows, works."""

import re
from pathlib import Path

import numpy as np
import pytest

import dpend
from studies import _runner
from studies._field import RIG, own

README = (Path(__file__).parent.parent / "README.md").read_text()
EXAMPLES = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)


@pytest.mark.parametrize("example", EXAMPLES, ids=range(len(EXAMPLES)))
def test_every_example_runs(example, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(compile(example, "README.md", "exec"), {})


def test_every_local_link_and_picture_is_in_the_repository():
    root = Path(__file__).parent.parent
    for page in [root / "README.md", root / "CONTRIBUTING.md", *root.glob("docs/*.md"), root / "benchmarks/README.md"]:
        for target in re.findall(r"\]\(([^)#]+)\)", page.read_text()):
            if "://" not in target:
                assert (page.parent / target).exists(), f"{page.name} points to {target}"


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """Write the README's own controller where its commands look for it."""
    (example,) = (example for example in EXAMPLES if "class " in example)
    (tmp_path / "mine.py").write_text(example)
    monkeypatch.chdir(tmp_path)
    return example


OWN = re.findall(r"^\.venv/bin/python -m (studies\.\w+) --controller (mine\.py:\w+)$", README, flags=re.MULTILINE)


def test_a_controller_in_every_comparison_takes_ten_lines(mine):
    assert len([line for line in mine.splitlines() if line.strip()]) + len(OWN) <= 10
    assert {study.removeprefix("studies.") for study, _ in OWN} == {
        "leaderboard", "lambda_sweep", "swing_up", "smoothness", "robustness"
    }  # fmt: skip
    (spec,) = {spec for _, spec in OWN}
    contender = own(spec)
    task = dpend.Balance(lam=0.1)
    starts = task.starts(np.random.default_rng(0), 20, RIG)
    assert dpend.simulate_many(RIG, contender.make(RIG, task), starts, task=task).success.all()


@pytest.mark.slow
@pytest.mark.parametrize(("study", "spec"), OWN)
def test_a_controller_of_ones_own_appears_in_every_comparison(study, spec, mine, tmp_path):
    out = tmp_path / "out"
    others = ["TVLQR"] if study == "studies.swing_up" else ["LQR", "TVLQR"]
    options = ["--quick", "--workers", "1", "--out", str(out), "--only", *others]
    table = _runner.main(study, ["--controller", spec, *options])
    assert "ByHand" in table.rows.to_numpy()
    assert len(table.rows) == len(_runner.read_rows(out / "rows.csv"))


def test_there_are_two_commands_that_set_up_and_run():
    commands = re.findall(r"^python3 -m venv .*$", README, flags=re.MULTILINE)
    assert [command.rsplit(" && ", 1)[1] for command in commands] == [
        ".venv/bin/python -m studies.lambda_sweep",
        ".venv/bin/python -m pytest",
    ]
    assert all("pip install" in command for command in commands)
