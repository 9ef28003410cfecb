"""The benchmarks give the ratio of what takes turns, say when turns do not tell, and write one table."""

import math

import pandas as pd
import pytest

from benchmarks.__main__ import main
from benchmarks.race import Race, Ratio, run


def work(times):
    def job():
        sum(k * k for k in range(20_000 * times))
        return 1.0

    return job


def test_a_job_that_does_a_third_of_the_work_is_three_times_as_fast_and_one_without_a_peer_has_no_ratio():
    jobs = {"quick": work(1), "slow": work(3)}
    race = Race(
        title="race", counts="sums", jobs=jobs, pairs=[("quick", "slow", 2.0), ("quick", "absent", None)], turns=9
    )
    (ratio,) = run(race)
    assert (ratio.ours, ratio.peer, ratio.counts) == ("quick", "slow", "sums")
    assert 2 < ratio.low <= ratio.ratio <= ratio.high < 4.5
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
