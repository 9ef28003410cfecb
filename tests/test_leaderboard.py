"""The leaderboard: the starts of each contender, ranks, what the tables say, and a study that resumes."""

import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import dpend
from rl.deep import read_trainings
from studies import _runner, leaderboard
from studies._board import SAVED, UP, Place, Places, _place_in_words, board, ranked, values_of
from studies._boundary import kept_boundary
from studies._estimates import Estimate
from studies._field import CONTENDERS, RIG, YOURS, TaskName, find
from studies._runner import Table, kept_table, read_rows, where
from studies._table import load

ROOT = Path(__file__).parent.parent
BY_HAND = """
class ByHand:
    def start(self, n, rng):
        return lambda t, y: y @ [-1, 150, -165, -2.5, 7, -29]
"""


def table(*found):
    """Return the table of jobs: for each its contender, task, work and values by quantity."""
    rows = [
        {"job": k, "contender": name, "task": task, "work": work, "quantity": quantity, "n": 1, "mean": 0.0}
        for k, (name, task, work, values) in enumerate(found)
        for quantity in values
    ]
    arrays = {k: {what: np.array(each, dtype=float) for what, each in job[3].items()} for k, job in enumerate(found)}
    return Table(pd.DataFrame(rows), by_job=arrays)


def balancing(**of):
    """Return the table of successes by contender: a list for each λ given."""
    return table(*(
        (name, "balance", "runs", {SAVED[lam]: values for lam, values in by_lam.items()}) for name, by_lam in of.items()
    ))  # fmt: skip


def ranks(made, task):
    return {name: place and place.rank.value for name, place in ranked(made, task).items()}


def lines(made):
    """Return what stands in the tables: by title and contender, the cells by heading; and the notes by title."""
    places: dict[TaskName, Places] = {"balance": found} if (found := ranked(made, "balance")) else {}
    sheets, _ = board(made, places, {})
    return {
        sheet.title: {
            line[0].text: {column.heading: each for column, each in zip(sheet.columns, line, strict=True)}
            for line in sheet.lines
        }
        for sheet in sheets
    }, {sheet.title: sheet.note for sheet in sheets}


# --------------------------------------------------------------------------------------------------------------- ranks


def test_parts_of_the_starts_are_joined_in_their_order():
    made = table(*(("a", "balance", "runs", {SAVED[0.3]: values}) for values in ([0, 0], [1, 0])))
    assert values_of(made, "a", SAVED[0.3]).tolist() == [0, 0, 1, 0]
    assert values_of(made, "a", SAVED[0.4]).tolist() == []


def test_balancing_is_ranked_by_the_mean_over_the_spreads_and_not_by_the_smallest():
    made = balancing(a={0.05: [0] * 8, 0.1: [1] * 8, 0.4: [1] * 8}, b={0.05: [1] * 8, 0.1: [1] * 8, 0.4: [1, 0] * 4})
    assert ranks(made, "balance") == {"a": 1, "b": 2}
    assert ranked(made, "swing-up") == {}


def test_swing_up_is_ranked_by_success_and_then_by_time():
    times = {"slow": [5.0] * 4, "quick": [2.0] * 4, "quicker, but fails": [1.0, 1.0, 1.0, np.nan]}
    made = table(*((name, "swing-up", "runs", dict.fromkeys(UP.values(), own)) for name, own in times.items()))
    assert list(ranks(made, "swing-up").items()) == [("quick", 1), ("slow", 2), ("quicker, but fails", 3)]


def test_without_success_there_is_no_rank_and_users_own_read_their_place():
    made = balancing(Idle={0.1: [0] * 4}, LQR={0.1: [1] * 4}, Mine={0.1: [1, 1, 1, 0]}, SDRE={0.1: [0] * 4})
    places = ranked(made, "balance")
    assert (list(places), places["Idle"], places["SDRE"]) == (["LQR", "Mine", "SDRE", "Idle"], None, None)
    found, notes = lines(made)
    assert found["Balance, the best first"]["Idle"]["rank"].text == "–"
    assert found["Balance, the best first"]["Idle"]["mean"].text == "0.0"
    assert notes["Balance, the best first"] == (
        "Mine ranks 2nd of 4 at balancing; Idle has no rank at balancing, at which it never succeeds"
    )
    assert ranked(balancing(Idle={0.1: [0] * 4}), "balance") == {"Idle": None}


@pytest.mark.parametrize(
    ("rank", "words"), [(1, "1st"), (2, "2nd"), (3, "3rd"), (7, "7th"), (11, "11th"), (12, "12th"), (21, "21st")]
)
def test_a_place_is_said_as_it_is_spoken(rank, words):
    places: dict[str, Place | None] = {"Mine": Place(Estimate(rank), 0.0, 0.0)} | dict.fromkeys(map(str, range(24)))
    assert _place_in_words("Mine", "swing-up", places) == f"Mine ranks {words} of 25 at swinging up"


# -------------------------------------------------------------------------------------------------------------- tables


def test_the_prior_knowledge_of_every_contender_is_in_the_table():
    made = table(*((name, "balance", "ready", {"ready, s": [1]}) for name in (*(c.name for c in CONTENDERS), "Mine")))
    found = lines(made)[0]["Cost and prior knowledge"]
    words = {name: [each.text for each in line.values()][-4:] for name, line in found.items()}
    assert words.keys() == {*(contender.name for contender in CONTENDERS), "Mine"}
    assert words["LQR"] == ["equations and parameters", "quadratic cost", "–", "all of it, exact"]
    assert words["Mine"] == list(YOURS)
    of_learners = {words[contender.name][0] for contender in CONTENDERS if contender.policy}
    assert of_learners == {"none", "structure and symmetries"}


def test_the_share_of_failed_trainings_counts_trainings():
    made = table(*(("LSPI", "balance", "training", {"failed, %": [value]}) for value in (0, 0, 1, 0)))
    line = lines(made)[0]["Cost and prior knowledge"]["LSPI"]
    assert (line["trainings"].text, line["failed, %"].text) == ("4", "25.0")


def test_lqr_takes_one_time_lqrs_time_whatever_was_timed_beside_it():
    timed = {"step, s": [1e-5], "step of LQR, s": [2e-5]}
    made = table(*(
        job
        for name in ("LQR", "SDRE")
        for job in ((name, "balance", "runs", {SAVED[0.1]: [1, 1]}), (name, "balance", "steps", timed))
    ))  # fmt: skip
    found = lines(made)[0]["Balance, the best first"]
    assert [found[name]["step, ms"].under for name in ("LQR", "SDRE")] == ["(1 × LQR)", "(0.5 × LQR)"]


# ---------------------------------------------------------------------------------------------------------------- jobs


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"starts": 1}, "--starts must be at least 2; got 1."),
        ({"trainings": 0}, "--trainings must be at least 1; got 0."),
    ],
)
def test_bad_counts_are_refused(options, message):
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        leaderboard.Options(**options)


def test_all_contenders_have_the_same_starts_and_the_slow_the_first_of_them(monkeypatch):
    jobs = leaderboard.jobs(leaderboard.Options(starts=800, only=("NMPC", "PPO swing-up")))
    runs = [job for job in jobs if (job.work, job.task) == ("runs", "swing-up")]
    assert [(job.contender, job.first, job.runs) for job in runs] == [
        ("NMPC", 0, 25), ("NMPC", 25, 15), ("PPO swing-up", 0, 800),
    ]  # fmt: skip
    assert len(set(jobs)) == len(jobs)
    seen = []
    monkeypatch.setattr(leaderboard.dpend, "simulate_many", lambda rig, law, x0, **how: seen.append(x0))
    for job in runs:
        for task in leaderboard._kinds("swing-up", (), RIG).values():
            leaderboard._simulate(job, find("LQR").make(RIG, task), task)
    for first, second, every in zip(*(seen[k : k + 3] for k in (0, 3, 6)), strict=True):
        assert (np.concatenate([first, second]) == every[:40]).all()


def test_planners_meet_every_start_in_parts_that_processes_share():
    jobs = leaderboard.jobs(leaderboard.Options(starts=1000, only=("LQR", "iLQR MPC")))
    runs = [(job.contender, job.first, job.runs) for job in jobs if (job.work, job.task) == ("runs", "balance")]
    assert runs == [("iLQR MPC", first, 200) for first in range(0, 1000, 200)] + [("LQR", 0, 1000)]


def test_every_deep_contender_has_its_trainings_where_they_are_read():
    kept = read_rows(kept_table("deep_swing_up"))
    for contender in CONTENDERS:
        assert not contender.policy or (contender.learner is None) == bool(contender.trainings)
        if contender.trainings:
            seeds = where(kept, learner=contender.trainings)["training"].tolist()
            assert seeds == list(read_trainings(leaderboard._file(contender)))


def test_a_deep_policy_that_balances_as_well_as_others_has_not_failed():
    (job,) = (job for job in leaderboard.jobs(leaderboard.Options(only=("DDPG balance",))) if job.work == "deep")
    found = {row["quantity"]: row["mean"] for row in leaderboard.run(job).rows}
    assert (found["failed, %"], found["learning, s"]) == (0.0, 2000.0)


# --------------------------------------------------------------------------------------------------------------- study


def study(out):
    return [sys.executable, "-m", "studies.leaderboard", "--quick", "--workers", "1", "--out", str(out),
            "--only", "LQR", "sign of LQR"]  # fmt: skip


def untimed(folder):
    rows = load(folder).rows
    return rows[~rows["work"].isin(("steps", "ready"))].to_csv()


@pytest.mark.nightly
def test_killed_in_the_middle_and_started_again_it_ends_with_the_same_table(tmp_path):
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    subprocess.run(study(whole), cwd=ROOT, check=True, capture_output=True)
    process = subprocess.Popen(study(broken), cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while len(list((broken / "jobs").glob("*.npz"))) < 3:
        time.sleep(0.01)
        assert process.poll() is None
    process.send_signal(signal.SIGKILL)
    process.wait()
    kept = {file: file.stat().st_mtime_ns for file in (broken / "jobs").glob("*.npz")}
    assert 3 <= len(kept) < len(list((whole / "jobs").glob("*.npz")))
    subprocess.run(study(broken), cwd=ROOT, check=True, capture_output=True)
    assert {file: file.stat().st_mtime_ns for file in kept} == kept
    assert untimed(broken) == untimed(whole)


def test_best_known_are_the_tables_own_starts_within_the_boundary_and_those_that_any_contender_saves():
    made = balancing(a={0.4: [0] * 40, 0.6: [0] * 40}, b={0.4: [0] * 8, 0.6: [1] * 8})
    known = leaderboard.best_known(Table(made.rows.assign(seed=3, first=0, runs=40), by_job=made.by_job))
    for lam, some in ((0.4, 0), (0.6, 8)):
        starts = dpend.Balance(lam=lam).starts(np.random.default_rng([3, leaderboard._STREAM]), 40, RIG)
        inside = kept_boundary().savable(starts)
        assert not inside.all()
        assert known[lam].tolist() == (inside | (np.arange(40) < some)).tolist()
    (sheet, *_), _ = board(made, {"balance": ranked(made, "balance")}, known)
    column = [each.heading for each in sheet.columns].index("of savable, %")
    expected = 100 * 8 / (known[0.4][:8].sum() + known[0.6][:8].sum())
    assert {line[0].text: line[column].text for line in sheet.lines} == {
        "a": "0.0", "b": f"{expected:.1f}", "best known": "–",
    }  # fmt: skip


@pytest.mark.slow
def test_a_controller_of_ones_own_stands_at_its_place_in_every_part(tmp_path, capsys):
    (tmp_path / "mine.py").write_text(BY_HAND)
    made = _runner.main("studies.leaderboard", [
        "--quick", "--workers", "1", "--out", str(tmp_path), "--only", "LQR", "sign of LQR",
        "--controller", f"{tmp_path / 'mine.py'}:ByHand",
    ])  # fmt: skip
    assert ranks(made, "balance") == {"LQR": 1, "ByHand": 1, "sign of LQR": 3}
    assert ranks(made, "swing-up") == {"ByHand": None}
    assert len(values_of(made, "ByHand", "step of 1000, s", task="balance")) == 1
    assert made.array("delay", contender="ByHand", task="balance").shape == (2, 2)
    printed = " ".join(capsys.readouterr().out.split())
    assert "ByHand ranks 1st, equally, of 3 at balancing" in printed
    assert "ByHand has no rank at swinging up, at which it never succeeds" in printed
    for name in ("tables.md", "leaderboard.html"):
        text = (tmp_path / name).read_text()
        assert "ByHand" in text
        assert "best known" in text
