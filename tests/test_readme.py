"""What the README shows, works."""

import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import dpend
from docs import result_tables
from studies import _board, _runner, lambda_sweep, leaderboard, recoverable, swing_up
from studies._boundary import kept_boundary
from studies._estimates import Estimate
from studies._field import RIG, own
from studies._table import Table, load

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()
EXAMPLES = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)


@pytest.mark.parametrize("example", EXAMPLES, ids=range(len(EXAMPLES)))
def test_every_example_runs(example, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(compile(example, "README.md", "exec"), {})


def test_every_local_link_and_picture_is_in_the_repository():
    for page in [
        ROOT / "README.md",
        ROOT / "CONTRIBUTING.md",
        *ROOT.glob("docs/**/*.md"),
        ROOT / "benchmarks/README.md",
    ]:
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


@pytest.mark.parametrize(
    ("study", "spec"),
    [
        pytest.param(*each, marks=pytest.mark.slow if each[0] == "studies.lambda_sweep" else pytest.mark.nightly)
        for each in OWN
    ],
)
def test_a_controller_of_ones_own_appears_in_every_comparison(study, spec, mine, tmp_path):
    out = tmp_path / "out"
    others = {"studies.swing_up": ["TVLQR"], "studies.lambda_sweep": ["LQR"]}.get(study, ["LQR", "TVLQR"])
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


BALANCING = {
    "best linear law known": "tuned linear",
    "LQR, Q = I, R = 1": "LQR",
    "iLQR MPC": "iLQR MPC",
    "LSPI, learned in 120 s": "LSPI",
    "PPO, one training": "PPO balance",
}
"""The lines of the README's table and their contenders."""

LAMS = 0.1, 0.2, 0.3, 0.4


@cache
def kept(name: str) -> Table:
    return load(ROOT / "docs/results" / name)


SWEEP = "lambda_sweep_100"


def saved(name: str) -> list[Estimate]:
    return [lambda_sweep.saved(kept(SWEEP), name, lam) for lam in LAMS]


def cell(estimate: Estimate) -> str:
    """Write a share in %; an interval no wider than a fifth of a point is left out."""
    value, interval = estimate.written(".1%")
    return f"{value} {interval}".strip() if estimate.high - estimate.low > 0.002 else value


def finding(study: object) -> str:
    return " ".join((study.__doc__ or "").partition("Finding:")[2].split())


def percent(values: list[float]) -> str:
    return "/".join(f"{100 * value:.1f}".removesuffix(".0") for value in values)


@pytest.mark.slow
def test_the_table_is_that_of_its_rows():
    shown, area = {}, kept_boundary()
    for label, name in BALANCING.items():
        starts = int(np.sum(kept(SWEEP).where(contender=name, lam=0.1)["episodes"]))
        shown[label + f" ({starts} starts)" * (starts < 10_000)] = saved(name)
    shown["possible at all"] = [area.share(lam) for lam in LAMS]
    written = [f"| {label} | {' | '.join(map(cell, each))} |" for label, each in shown.items()]
    lacking = [each for each in written if f"\n{each}\n" not in README]
    assert not lacking, "The README lacks:\n" + "\n".join(lacking)


def test_the_numbers_beside_the_table_are_those_of_their_tables():
    said = " ".join(README.split())
    frozen = result_tables.table("published_q", "What the weights save").line("gustafsson2016_as_coded", "LQR")
    numbers = " / ".join(frozen[f"θ2 random, λ = {lam}, %"].partition(" ")[0] for lam in LAMS)
    assert f"LQR saves {numbers} %" in said
    experience = result_tables.table("price_of_ignorance", "Experience and processor time")
    seconds = [
        experience.line("pilco2011", prior)["first, s"] for prior in ("the equations", "structure, mirror, gravity")
    ]
    median, _, interval = seconds[1].partition(" ")
    assert f"{seconds[0]} s knowing the equations but not their parameters, {median} s {interval} knowing" in said


def test_the_readme_is_a_screen_and_a_half():
    assert len(README.split()) <= 700


@pytest.mark.slow
def test_findings_are_what_their_tables_say():
    area, swings, board = kept_boundary(), kept("swing_up"), kept("leaderboard")
    assert percent([area.share(lam).value for lam in (0.3, 0.4, 0.5, 0.6)]) in finding(recoverable)
    for name in ("LQR", "Q tuned"):
        assert percent([each.value for each in saved(name)]) in finding(lambda_sweep)
    wrong = [swing_up.runs_of(swings, "iLQR MPC", start=start, plant_error=0.1) for start in swing_up.STARTS]
    assert percent([swing_up.up(runs, swing_up.HORIZON).value for runs in wrong]) in finding(swing_up)
    for name in ("iLQR MPC", "tuned linear", "PPO balance", "LQR", "LSPI", "Q tuned"):
        scored = [of for lam, of in _board.outcomes_of(board, name, "balance").items() if lam not in _board.UNSCORED]
        assert f"{100 * np.mean(np.stack(scored) > 0):.1f}" in finding(leaderboard), name
