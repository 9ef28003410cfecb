"""Studies on another rig than that of the comparisons, and contenders that refuse it: a sentence each, no traceback."""

from __future__ import annotations

import re
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from controllers import LQR, NoTrajectory
from studies import _field, _runner, lambda_sweep, swing_up
from studies._table import load

OWN = """
from controllers import LQR

def for_20_ms(rig):
    if rig.sample_time != 0.02:
        raise KeyError("gains for 0.02 s alone")
    return LQR(rig)

def for_50_ms(rig):
    assert rig.sample_time == 0.05, "gains for 0.05 s alone"
    return LQR(rig)

class GivesUp:
    def start(self, n, rng):
        def act(t, y):
            if t > 0.2:
                raise ZeroDivisionError("no gain left")
            return 0.0 * y[:, 1]
        return act
"""
PILCO = ("--rig", "pilco2011", "--quick", "--workers", "1")


@pytest.fixture
def mine(tmp_path: Path) -> str:
    (tmp_path / "mine.py").write_text(OWN)
    return str(tmp_path / "mine.py")


def said(capsys: Any) -> str:
    """Return what was printed, lines and boxes undone."""
    out, err = capsys.readouterr()
    return " ".join((out + err).replace("│", " ").split())


@pytest.mark.slow
def test_a_users_own_that_fails_on_the_way_is_left_out_and_the_study_goes_on(
    mine: str, tmp_path: Path, capsys: Any
) -> None:
    options = ("--only", "LQR", "--controller", f"{mine}:GivesUp", "--out", str(tmp_path / "out"))
    table = _runner.main("studies.lambda_sweep", [*PILCO, *options])
    assert set(table.rows["contender"]) == {"LQR"}
    assert set(load(tmp_path / "out").rows["contender"]) == {"LQR"}
    printed = said(capsys)
    assert printed.count("takes no part") == 1
    assert "GivesUp takes no part: GivesUp failed at t = 0.25 s" in printed
    assert "ZeroDivisionError: no gain left" in printed


@pytest.mark.slow
def test_a_users_own_is_tried_on_the_rig_of_the_study_before_anything_runs(
    mine: str, tmp_path: Path, capsys: Any
) -> None:
    options = ("--only", "LQR", "--out", str(tmp_path / "out"), "--controller")
    with pytest.raises(SystemExit, match="2"):
        _runner.main("studies.lambda_sweep", [*PILCO, *options, f"{mine}:for_20_ms"])
    shown = re.sub(r"[\s│|]+", "", capsys.readouterr().err)  # in a box, wrapped anywhere
    assert f"--controller{mine}:for_20_ms:KeyError:'gainsfor0.02salone'" in shown
    assert not (tmp_path / "out").exists()
    table = _runner.main("studies.lambda_sweep", [*PILCO, *options, f"{mine}:for_50_ms"])
    assert set(table.rows["contender"]) == {"LQR", "for_50_ms"}


def unstable(rig: Any, task: Any) -> LQR:
    if rig.sample_time > 0.02:
        raise ValueError(f"No gain is robust at {rig.sample_time:g} s.")
    return LQR(rig)


def without_trajectory(rig: Any, task: Any) -> LQR:
    raise NoTrajectory("No guess led to a motion.")


@pytest.fixture
def fragile(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let two of the shipped contenders refuse other rigs."""
    made = {"stiff LQR": unstable, "sign of LQR": without_trajectory}
    known = tuple(replace(each, make=made.get(each.name, each.make)) for each in lambda_sweep.KNOWN)
    monkeypatch.setattr(lambda_sweep, "KNOWN", known)
    monkeypatch.setattr(lambda_sweep.Options, "known", known)


@pytest.mark.parametrize("workers", [0, 2])
def test_what_refuses_the_rig_says_so_in_a_sentence_and_the_others_go_on(
    workers: int, fragile: None, tmp_path: Path, capsys: Any
) -> None:
    only = ("LQR", "stiff LQR", "sign of LQR")
    options = lambda_sweep.Options(rig="pilco2011", quick=True, only=only, workers=1, out=tmp_path)
    with ThreadPoolExecutor(workers) if workers else nullcontext() as executor:
        table = _runner.run_study("studies.lambda_sweep", options, executor)
    assert set(table.rows["contender"]) == {"LQR"}
    printed = said(capsys)
    assert "stiff LQR takes no part: No gain is robust at 0.05 s." in printed
    assert "sign of LQR takes no part: No guess led to a motion." in printed


def test_an_error_on_the_rig_of_the_comparisons_is_one(
    monkeypatch: pytest.MonkeyPatch, fragile: None, tmp_path: Path
) -> None:
    options = lambda_sweep.Options(quick=True, only=("LQR", "sign of LQR"), workers=1, out=tmp_path)
    with pytest.raises(NoTrajectory, match=r"^No guess led to a motion\.$"):
        _runner.run_study("studies.lambda_sweep", options)


def test_where_all_refuse_the_rig_the_study_ends_in_one_line(fragile: None, tmp_path: Path, capsys: Any) -> None:
    with pytest.raises(SystemExit, match="2"):
        _runner.main("studies.lambda_sweep", [*PILCO, "--only", "stiff LQR", "sign of LQR", "--out", str(tmp_path)])
    assert said(capsys).endswith(
        "Error: Nobody takes part on pilco2011: No gain is robust at 0.05 s. No guess led to a motion."
    )
    assert not (tmp_path / "rows.csv").exists()


@pytest.mark.parametrize(
    ("name", "rig", "why"),
    [
        ("PPO balance", {"rig": "pilco2011"}, "Networks control the rig on which they were trained."),
        ("LSPI", {"set": ("sensor_delay=1",)}, "Learners learn on rigs without lag, delay, noise and rounding."),
    ],
)
def test_who_takes_no_part_on_a_rig_is_named_with_the_reason(name: str, rig: Any, why: str) -> None:
    options = _field.Options(**rig)
    assert name not in [each.name for each in options.contenders("balance")]
    assert any(name in sentence and sentence.endswith(f". {why}") for sentence in options.absent)
    assert replace(options, only=("LQR", name)).absent == [f"Without {name}. {why}"]
    assert not _field.Options().absent


def test_where_only_those_are_asked_for_that_take_no_part_a_study_says_so(tmp_path: Path, capsys: Any) -> None:
    for study in ("lambda_sweep", "leaderboard"):
        with pytest.raises(SystemExit, match="2"):
            _runner.main(f"studies.{study}", [*PILCO, "--only", "PPO balance", "--out", str(tmp_path)])
        assert said(capsys) == (
            "Without PPO balance. Networks control the rig on which they were trained. "
            "Error: Of those that were asked for nobody takes part on pilco2011."
        )


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("name", "others", "left"),
    [
        ("leaderboard", ("LQR", "TVLQR"), {"LQR"}),
        ("robustness", ("LQR", "TVLQR"), {"LQR"}),
        ("smoothness", ("LQR", "TVLQR", "pumping, LQR"), {"LQR"}),  # swing-ups are compared with TVLQR
        ("swing_up", ("TVLQR", "pumping, LQR"), {"pumping, LQR"}),
    ],
)
def test_every_comparison_goes_on_without_one_that_refuses(
    name: str, others: tuple[str, ...], left: set[str], tmp_path: Path, capsys: Any
) -> None:
    contender = _field.find("TVLQR")
    make = contender.make
    object.__setattr__(contender, "make", without_trajectory)
    try:
        options = ("--quick", "--workers", "1", "--set", "mass1=.6", "--out", str(tmp_path), "--only", *others)
        table = _runner.main(f"studies.{name}", options)
    finally:
        object.__setattr__(contender, "make", make)
    assert set(table.rows["contender"]) == left
    assert "takes no part: No guess led to a motion." in said(capsys)
    assert (tmp_path / "tables.md").exists()


def test_a_users_own_that_refuses_a_preset_has_a_line_that_says_so(mine: str) -> None:
    own = _field.own(f"{mine}:for_20_ms")
    case = swing_up.Job(contender=own.name, own=own.own, rig="pilco2011", runs=1, seconds=1.0, seed=0)
    (row,) = swing_up.run(case).rows
    assert row["refused"]
