"""What is released says its version once, its workflows run what they name, and what it promises of safety is so."""

from __future__ import annotations

import re
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from test_architecture import SOURCES, imports

import dpend

ROOT = Path(__file__).parent.parent
WORKFLOWS = sorted((ROOT / ".github/workflows").glob("*.yml"))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_the_version_stands_in_one_place() -> None:
    assert version("dpend") == dpend.__version__
    assert "version" not in PROJECT["project"]


@pytest.mark.parametrize("workflow", WORKFLOWS, ids=lambda path: path.stem)
def test_actions_are_pinned_by_hash_with_their_version_beside(workflow: Path) -> None:
    used = re.findall(r"uses: (.*)", workflow.read_text())
    assert used
    assert not [each for each in used if not re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+", each)]


def test_ci_runs_what_a_developer_runs_on_every_python_that_is_promised() -> None:
    (tests,) = (path.read_text() for path in WORKFLOWS if path.stem == "tests")
    assert "run: .ci/run" in tests
    lowest = PROJECT["project"]["requires-python"].removeprefix(">=")
    assert f'python: ["{lowest}", ' in tests


def test_every_shipped_file_exists() -> None:
    forced = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    assert forced
    assert not [file for file in forced if not (ROOT / file).is_file()]


def test_the_lock_has_hashes_no_hosts_and_versions_within_the_bounds_of_the_project() -> None:
    text = (ROOT / "requirements.lock").read_text()
    assert "://" not in text
    blocks = [line.split(" --hash=sha256:") for line in text.replace("\\\n", "").splitlines() if line[0] != "#"]
    blocks = [[each.strip() for each in block] for block in blocks]
    assert all(re.fullmatch("[0-9a-f]{64}", each) for _, *hashes in blocks for each in hashes)
    assert all(len(block) > 1 for block in blocks)
    locked = [Requirement(name) for name, *_ in blocks]
    extras = PROJECT["project"]["optional-dependencies"]
    asked = map(Requirement, [*PROJECT["project"]["dependencies"], *extras["dev"], *extras["web"]])
    for wanted in asked:
        found = [each for each in locked if canonicalize_name(each.name) == canonicalize_name(wanted.name)]
        assert found or wanted.name == "dpend", wanted
        assert all(wanted.specifier.contains(str(each.specifier).removeprefix("==")) for each in found), wanted


@pytest.mark.slow
def test_what_listens_or_fetches_is_named_in_the_security_policy() -> None:
    network = {
        "asyncio",
        "ftplib",
        "http",
        "httpx",
        "requests",
        "socket",
        "socketserver",
        "starlette",
        "urllib",
        "uvicorn",
    }
    found = {
        name for name, path in SOURCES.items() for each in imports(path) if each.module.partition(".")[0] in network
    }
    policy = (ROOT / "SECURITY.md").read_text()
    assert not {name for name in found if name not in policy}
