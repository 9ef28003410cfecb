"""The benchmarks give the ratio of what takes turns, say when turns do not tell, and write one table."""

import math

import pandas as pd
import pytest

from benchmarks.__main__ import main
from benchmarks.race import Race, Ratio, run


def test_the_ratio_is_that_of_each_turn_in_processor_time_and_a_job_without_a_peer_has_none(monkeypatch):
    clock = {"processor": 0.0, "wall": 0.0}
    monkeypatch.setattr("benchmarks.race.process_time", lambda: clock["processor"])
    monkeypatch.setattr("benchmarks.race.perf_counter", lambda: clock["wall"])
    slower = iter([9.0, 9.0, 1.0, 1.0, 2.0, 2.0, 1.0, 1.0])  # factor of each job, in turns; the first is not timed

    def work(seconds):
        def job():
            clock["processor"] += (spent := seconds * next(slower))
            clock["wall"] += 3 * spent
            return 6.0

        return job

    jobs = {"quick": work(1.0), "slow": work(3.0)}
    pairs = [("quick", "slow", 2.0), ("quick", "absent", None)]
    (ratio,) = run(Race(title="race", counts="sums", jobs=jobs, pairs=pairs), turns=3)
    assert (ratio.ours, ratio.peer, ratio.counts) == ("quick", "slow", "sums")
    assert ratio.low == ratio.ratio == ratio.high == pytest.approx(3.0)
    assert (ratio.speed, ratio.busy) == pytest.approx((6.0, 3.0))
    assert ratio.verdict == "met"


@pytest.mark.parametrize(
    ("ratio", "low", "high", "asked", "verdict"),
    [(2.0, 1.8, 2.2, 1.5, "met"), (1.0, 0.9, 1.1, 1.5, "missed"), (1.6, 1.4, 1.7, 1.5, "cannot tell"),
     (1.0, 0.9, 1.1, math.nan, "")],
)  # fmt: skip
def test_what_was_asked_for_is_met_or_missed_only_where_the_quartiles_tell(ratio, low, high, asked, verdict):
    assert Ratio("race", "steps", "ours", "peer", 1.0, ratio, low, high, asked, 1.0).verdict == verdict


@pytest.mark.slow
def test_one_command_writes_a_table_of_the_parts_it_was_asked_for(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("benchmarks.__main__.pin_to_one_core", lambda: None)  # other tests come after
    found = main(only=("learners",), quick=True, out=tmp_path)
    rows = pd.read_csv(tmp_path / "rows.csv")
    assert list(rows["ratio"]) == pytest.approx([each.ratio for each in found])
    assert set(rows["verdict"].isna()) == {True}
    assert "| linear Q-learning, compiled | Stepper called from Python |" in (tmp_path / "tables.md").read_text()
    assert "Learning: samples" in capsys.readouterr().out
    with pytest.raises(SystemExit, match="--only: there is no rockets; there are simulator"):
        main(only=("rockets",))
