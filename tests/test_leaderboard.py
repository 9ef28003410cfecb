"""The leaderboard: ranks that are as sure as the runs make them, tables that hold anything, a study that resumes."""

import re
import shutil
import signal
import subprocess
import sys
import time
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from studies import _study, deep_swing_up, leaderboard
from studies._entrants import ENTRANTS, YOURS
from studies._page import Cell, Column, markdown, page
from studies._ranks import ranking

ROOT = Path(__file__).parent.parent


def share(outcomes):
    return [(outcomes, np.ones(len(outcomes)))]


# --------------------------------------------------------------------------------------------------------------- ranks


def test_what_is_better_on_every_start_is_first_in_every_resample():
    easy, hard = np.random.default_rng(0).random((2, 300)) < np.array([[0.9], [0.4]])
    found = ranking([share(easy & hard), share(easy | hard), share(np.zeros(300))])
    assert found.order.tolist() == [1, 0, 2]
    assert found.rank.tolist() == found.low.tolist() == found.high.tolist() == [2, 1, 3]
    assert found.first.tolist() == [0, 1, 0]
    assert found.better[1].tolist() == [1, 0, 1]


def test_ranks_of_equals_are_as_unsure_as_chance_and_those_of_unequals_become_sure_with_more_starts():
    rng = np.random.default_rng(1)
    few, many = (ranking([share(rng.random(n) < p) for p in (0.4, 0.6)], resamples=400) for n in (20, 1000))
    assert (few.low[0], few.high[0]) == (1, 2)
    assert (many.low[1], many.high[1], many.first[1]) == (1, 1, 1.0)
    halves = np.arange(200) % 2
    assert ranking([share(halves), share(1 - halves)]).better[0, 1] == pytest.approx(0.47, abs=0.06)


def test_intervals_of_ranks_hold_the_true_rank_as_often_as_they_say():
    rng = np.random.default_rng(2)
    held = []
    for repetition in range(40):
        outcomes = rng.random((3, 200)) < np.array([[0.8], [0.75], [0.7]])
        found = ranking([share(own) for own in outcomes], resamples=100, seed=repetition)
        held.append((found.low <= [1, 2, 3]) & (found.high >= [1, 2, 3]))
    assert np.mean(held) > 0.9


def test_pairs_count_not_the_luck_of_the_starts():
    level = np.random.default_rng(3).random(500)
    found = ranking([share(level < 0.5), share(level < 0.51)])
    assert found.better[1, 0] > 0.97  # independent samples with these shares would say 0.6


def test_one_that_met_the_first_starts_is_compared_on_these():
    hard_first = np.concatenate([np.zeros(50), np.ones(950)])
    found = ranking([share(hard_first), share(np.concatenate([np.ones(25), np.zeros(25)]))])
    assert found.rank.tolist() == [2, 1]
    assert found.better[1, 0] == 1


def test_the_next_criterion_decides_between_equals_and_only_between_them():
    success, quick, slow = np.ones(20), np.full(20, -1.0), np.full(20, -2.0)
    found = ranking([[(success, success), (slow, success)], [(success, success), (quick, success)],
                     [(np.zeros(20), success), (np.zeros(20), np.zeros(20))]])  # fmt: skip
    assert found.rank.tolist() == [2, 1, 3]


def test_equals_share_a_rank():
    found = ranking([share(np.ones(5)), share(np.ones(5)), share(np.zeros(5))])
    assert found.rank.tolist() == [1, 1, 3]
    assert found.first.tolist() == [1, 1, 0]


@pytest.mark.parametrize(
    "criteria", [[], [[(np.ones(3), np.ones(2))]], [[(np.ones(3), np.ones(3)), (np.ones(2),) * 2]]]
)
def test_a_ranking_of_nobody_or_of_ragged_runs_is_refused(criteria):
    message = "Expected, of at least one, criteria of two arrays (n,) each, all of the same n."
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        ranking(criteria)


# ---------------------------------------------------------------------------------------------------------------- page

COLUMNS = (Column("", "who", "Who.", words=True), Column("A & B", "x|y", 'A "number".'))
NASTY = "<script>alert('x')</script> | *a_b*"


class Cells(HTMLParser):
    """What a page shows, and its tags that were opened and closed."""

    def __init__(self, text):
        super().__init__()
        self.seen, self.open, self.outside = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        if tag not in ("meta", "link", "img"):
            self.open.append(tag)
        self.outside += [value for name, value in attrs if name in ("src", "href")]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("script", "style"):
            self.seen.append(data.strip())


def test_the_page_shows_names_as_they_are_and_runs_none_of_them():
    text = page("Board", ["a < b"], COLUMNS, [[Cell(NASTY), Cell("1.5", "[1, 2]", 1.5, 0.5)]])
    shown = Cells(text)
    assert {NASTY, "a < b", "x|y", "A & B", "[1, 2]"} <= set(shown.seen)
    assert not shown.open
    assert shown.outside == []
    assert text.count("<script>") == 1  # its own
    assert "http" not in text
    assert "url(" not in text


@pytest.mark.skipif(shutil.which("node") is None, reason="no JavaScript here")
def test_the_page_sorts_by_numbers_where_there_are_any_and_puts_what_has_none_last():
    cells = {"b": Cell("10", key=10.0), "c": Cell(), "a": Cell("9", key=9.0), "d": Cell("> 1", key=np.inf)}
    lines = [[Cell(name), cell] for name, cell in cells.items()]
    text = page("Board", [], COLUMNS, lines)
    script = text.split("<script>")[1].split("</script>")[0]
    keys = re.findall(r'data-key="([^"]*)"', text)
    program = f"""
const keys = {keys};
const rows = [0, 1, 2, 3].map(i => ({{cells: [0, 1].map(j => ({{dataset: {{key: keys[2 * i + j]}}}}))}}));
const body = {{rows, append: row => {{ shown.push(row.cells[0].dataset.key); }}}};
let shown = [];
const presses = [];
const heading = () => {{ const a = {{}}; return {{
  getAttribute: n => a[n], setAttribute: (n, v) => {{ a[n] = v; }}, removeAttribute: n => {{ delete a[n]; }},
  querySelector: () => ({{addEventListener: (_, f) => presses.push(f)}})}}; }};
const heads = [heading(), heading()];
globalThis.document = {{querySelector: () => body, querySelectorAll: () => heads}};
{{
{script}
}}
for (const press of [1, 1, 0]) {{ shown = []; presses[press](); console.log(shown.join("")); }}
"""
    done = subprocess.run(["node", "-e", program], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["abdc", "dbac", "abcd"]


def test_the_markdown_table_has_a_cell_for_each_column_whatever_stands_in_it():
    lines = markdown(COLUMNS, [[Cell(NASTY), Cell("1", "[0, 2]")], [Cell("line\nbreak"), Cell()]]).splitlines()
    assert len(lines) == 4
    assert [len(re.findall(r"(?<!\\)\|", line)) for line in lines] == [3, 3, 3, 3]
    assert lines[1] == "| --- | ---: |"
    assert lines[2] == r"| \<script\>alert('x')\</script\> \| \*a\_b\* | 1 [0, 2] |"
    assert lines[3] == "| line break | – |"


# --------------------------------------------------------------------------------------------------------------- study


def row(entrant, quantity, values, first=0):
    return leaderboard.Row(entrant=entrant, quantity=quantity, first=first, values=" ".join(map(str, values)))


def test_parts_of_the_starts_are_joined_in_their_order_whatever_the_order_of_the_rows():
    rows = [row("a", "saved, λ = 0.3", [1, 0], first=2), row("a", "saved, λ = 0.3", [0, 0], first=0)]
    assert leaderboard.Found(rows).of("a", "saved, λ = 0.3").tolist() == [0, 0, 1, 0]


def test_balancing_is_ranked_by_the_mean_over_the_spreads_and_not_by_the_smallest():
    quantities = [f"saved, λ = {lam:g}" for lam in (0.05, 0.1, 0.4)]
    of = {"a": ([0] * 8, [1] * 8, [1] * 8), "b": ([1] * 8, [1] * 8, [1, 0] * 4)}
    rows = [
        row(name, quantity, values)
        for name, all_ in of.items()
        for quantity, values in zip(quantities, all_, strict=True)
    ]
    ranks = leaderboard.ranked(leaderboard.Found(rows))
    assert list(ranks) == ["balance"]
    assert ranks["balance"].names == ["a", "b"]
    assert ranks["balance"].ranking.rank.tolist() == [1, 2]


def test_swing_up_is_ranked_by_success_and_then_by_time():
    times = {"slow": [5.0] * 4, "quick": [2.0] * 4, "quicker, but fails": [1.0, 1.0, 1.0, np.nan]}
    rows = [row(name, f"up from {start}, s", own) for name, own in times.items() for start in leaderboard.STARTS]
    ranks = leaderboard.ranked(leaderboard.Found(rows))["swing-up"]
    assert dict(zip(ranks.names, ranks.ranking.rank, strict=True)) == {"slow": 2, "quick": 1, "quicker, but fails": 3}


def test_what_everybody_was_told_is_said_of_everybody():
    lines = leaderboard.board(
        [row(entrant.name, "ready, s", [0.1]) for entrant in ENTRANTS] + [row("Mine", "ready, s", [1])]
    )
    columns, cost = lines.parts["Cost"]
    told = {line[0].text: [cell.text for cell in line[-4:]] for line in cost}
    assert [column.heading for column in columns[-4:]] == ["model", "state", "goal", "starts to learn from"]
    assert set(told) == {entrant.name for entrant in ENTRANTS} | {"Mine"}
    assert told["LQR"] == ["equations and parameters", "all of it, exact", "quadratic cost", "–"]
    assert told["Mine"] == [YOURS.model, YOURS.state, YOURS.reward, YOURS.starts]
    assert all(told[entrant.name][0] == "none" for entrant in ENTRANTS if entrant.policy)
    assert all("starts" not in told[entrant.name] for entrant in ENTRANTS)


def test_every_deep_entrant_has_its_trainings_in_the_table_that_is_shipped():
    kept = {training.learner for training in deep_swing_up.shipped()}
    for entrant in ENTRANTS:
        assert not entrant.policy or (entrant.learner is None) == bool(entrant.trainings)
        assert not entrant.trainings or entrant.trainings in kept


def test_the_share_of_failed_trainings_counts_seeds():
    rows = [row("LSPI", "failed", [value], first=k) for k, value in enumerate([0, 0, 1, 0])]
    (line,) = leaderboard.board(rows).parts["Cost"][1]
    assert [cell.text for cell in line][2:7:4] == ["4", "25.0"]


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


def test_all_meet_the_same_starts_and_the_slow_the_first_of_them():
    options = leaderboard.Options(starts=200)
    mpc, lqr = options.entrant("iLQR MPC"), options.entrant("LQR")
    met = [options.part(mpc, chunk) for chunk in range(2)]
    assert met == [(0, 25), (25, 15)]
    assert options.part(lqr, 0) == (0, 200)
    assert len([job for job in leaderboard.jobs(options) if job.setting == "balance + iLQR MPC"]) == 2
    task = options.balance()
    assert (leaderboard._starts(task, 40, options) == leaderboard._starts(task, 200, options)[:40]).all()


def untimed(file):
    return [line for line in file.read_text().splitlines() if not re.search(r"step|ready|training, s", line)]


def study(out, *arguments):
    return [sys.executable, "-m", "studies.leaderboard", "--quick", "--workers", "1", "--out", str(out),
            "--only", "LQR", "sign of LQR", *arguments]  # fmt: skip


@pytest.mark.slow
def test_killed_in_the_middle_and_started_again_it_ends_with_the_same_table_and_your_own_controller_in_it(tmp_path):
    (tmp_path / "mine.py").write_text(
        "class ByHand:\n    def start(self, n, rng):\n        return lambda t, y: y @ [-1, 150, -165, -2.5, 7, -29]\n"
    )
    own = ("--controller", str(tmp_path / "mine.py") + ":ByHand")
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    subprocess.run(study(whole, *own), cwd=ROOT, check=True, capture_output=True)
    process = subprocess.Popen(study(broken, *own), cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while len(list((broken / "jobs").glob("*.json"))) < 3:
        time.sleep(0.02)
        assert process.poll() is None
    process.send_signal(signal.SIGKILL)
    process.wait()
    kept = {file: file.stat().st_mtime_ns for file in (broken / "jobs").glob("*.json")}
    assert 3 <= len(kept) < len(list((whole / "jobs").glob("*.json")))
    subprocess.run(study(broken, *own), cwd=ROOT, check=True, capture_output=True)
    assert {file: file.stat().st_mtime_ns for file in kept} == kept
    assert untimed(broken / "rows.csv") == untimed(whole / "rows.csv")
    lines = (broken / "rows.csv").read_text().splitlines()
    assert len(lines) == len(set(lines)) == len((whole / "rows.csv").read_text().splitlines())
    rows = _study.read_rows(broken / "rows.csv", leaderboard.Row)
    found = leaderboard.Found(rows)
    assert found.doing("balance") == ["LQR", "sign of LQR", "ByHand"]
    assert found.doing("swing-up") == ["ByHand"]
    assert len(found.of("ByHand", "robustness balance")) == 3
    assert len(found.of("ByHand", "step of 1000 balance, s")) == 1
    for name in ("leaderboard.md", "leaderboard.html"):
        text = (broken / name).read_text()
        assert "ByHand" in text
        assert "recoverable" in text
    shown = Cells((broken / "leaderboard.html").read_text())
    assert not shown.open
    assert shown.outside == []
