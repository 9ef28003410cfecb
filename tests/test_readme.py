"""What the README shows, works."""

import re
from pathlib import Path

import pytest

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


def test_a_controller_takes_ten_lines():
    (example,) = (example for example in EXAMPLES if "class " in example)
    assert len([line for line in example.splitlines() if line.strip()]) <= 10


def test_there_are_two_commands_that_set_up_and_run():
    commands = re.findall(r"^python3 -m venv .*$", README, flags=re.MULTILINE)
    assert [command.rsplit(" && ", 1)[1] for command in commands] == [
        ".venv/bin/python -m studies.lambda_sweep",
        ".venv/bin/python -m pytest",
    ]
    assert all("pip install" in command for command in commands)
