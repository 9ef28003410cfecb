"""The sweep over λ: who takes part, which starts they meet, what the table says; and the basins."""

import io
import math
import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from rich.console import Console

import dpend
from controllers import LQR
from rl import LinearQLearning
from studies import _basins, _study, lambda_sweep, recoverable
from studies._curves import percent, plot_falls, spread
from studies._entrants import RIG
from studies._intervals import Crossing, Rate, crossing, wilson

BY_HAND = """
class ByHand:
    def start(self, n, rng):
        return lambda t, y: y @ [-1, 150, -165, -2.5, 7, -29]
"""


def names(**options):
    return [job.setting for job in lambda_sweep.jobs(lambda_sweep.Options(trainings=1, **options))]


def row(**changes):
    made = {
        "controller": "Q tuned", "training": 0, "lam": 0.1, "episodes": 100, "successes": 90, "successes_report": 95,
        "outcome": "converged", "training_episodes": 1, "training_steps": 2, "test_steps": 3,
    }  # fmt: skip
    return lambda_sweep.Row(**(made | changes))


def said(rows, traces):
    console = Console(width=200, record=True, file=io.StringIO())
    console.print(lambda_sweep.summary(rows, traces))
    return console.export_text()


# ------------------------------------------------------------------------------------------------------- who meets what


def test_all_that_balance_take_part_but_what_takes_minutes_and_the_plain_rule_only_if_asked():
    every = {entrant.name for entrant in lambda_sweep.KNOWN if "balance" in entrant.tasks}
    assert set(names()) == every - {"NMPC", "Q tuned, plain rule"}
    assert set(names(plain=True)) == every - {"NMPC"}
    assert set(names(all=True)) == every
    assert names(only=("LQR", "NMPC")) == ["NMPC", "LQR"]


def test_learners_train_several_times_and_all_others_take_part_once():
    jobs = lambda_sweep.jobs(lambda_sweep.Options(trainings=3))
    assert {job.setting for job in jobs if job.repetition == 2} == {"Q published", "Q tuned", "QAC tuned", "LSPI"}
    assert len(set(jobs)) == len(jobs)


def test_those_that_take_long_meet_their_part_and_all_others_every_start():
    options = lambda_sweep.Options(trainings=100, episodes=1000)
    assert options.starts(options.entrant("LQR")) == 100_000
    assert options.starts(options.entrant("PPO balance")) == 10_000
    assert options.starts(options.entrant("iLQR MPC")) == 50
    few = lambda_sweep.Options(trainings=2, episodes=5, part_of=1000)
    assert few.starts(few.entrant("iLQR MPC")) == 10
    assert options.side(options.entrant("iLQR MPC")) == 0
    every = lambda_sweep.Options(all=True, basins=41)
    assert (every.side(every.entrant("iLQR MPC")), every.side(every.entrant("LQR"))) == (18, 41)


@pytest.mark.slow
def test_trained_controllers_meet_their_part_of_the_starts_that_lqr_meets_whole():
    options = lambda_sweep.Options(trainings=2, episodes=30, lam=(0.3,), basins=0)
    task = dpend.Balance(lam=0.3)
    starts = task.starts(np.random.default_rng([0, 1]), 60, RIG)
    (lqr,) = lambda_sweep.run(_study.Job("LQR"), options).rows
    assert lqr.successes == dpend.simulate_many(RIG, LQR(RIG), starts, task=task).success.sum()
    (second,) = lambda_sweep.run(_study.Job("Q published", 1), options).rows
    policy = LinearQLearning.published(RIG).train([0, 2, 1]).policy
    assert second.successes == dpend.simulate_many(RIG, policy, starts[30:], task=task).success.sum()
    assert second.episodes == 30


def test_a_controller_of_ones_own_stands_in_the_table_with_its_force_and_its_basin(tmp_path):
    (tmp_path / "mine.py").write_text(BY_HAND)
    options = lambda_sweep.Options(controller=(f"{tmp_path / 'mine.py'}:ByHand",), only=("LQR",), quick=True)
    results = [lambda_sweep.run(job, options) for job in lambda_sweep.jobs(options)]
    rows = [row for result in results for row in result.rows]
    assert [row.controller for row in rows] == 2 * ["LQR"] + 2 * ["ByHand"]
    assert rows[2].successes == rows[2].episodes == 40  # at λ = 0.05
    traces = {f"{name}-0": dict(result.traces) for name, result in zip(("LQR", "ByHand"), results, strict=True)}
    assert [set(kept) for kept in traces.values()] == 2 * [{"saved", "force", "basin"}]
    assert traces["ByHand-0"]["saved"].sum(axis=0).tolist() == [row.successes for row in rows[2:]]
    assert "ByHand" in said(rows, traces)
    figures = lambda_sweep.plot(rows, traces)
    assert [axis.get_title().partition(":")[0] for axis in figures["_basins"].axes] == ["LQR", "ByHand", "", ""]


# ---------------------------------------------------------------------------------------------- what the table comes to


def test_a_rate_is_of_one_controller_one_spread_and_one_criterion():
    rows = [
        row(), row(training=1, successes=50), row(lam=0.2, successes=0),
        row(controller="LQR", successes=7, outcome="-"), row(controller="LSPI", outcome="shipped"),
    ]  # fmt: skip
    assert lambda_sweep.rate(rows, "Q tuned", 0.1).share == pytest.approx(0.7)
    assert lambda_sweep.rate(rows, "Q tuned", 0.1, report=True).share == pytest.approx(0.95)
    assert lambda_sweep.rate(rows, "LQR", 0.1) == wilson(7, 100)
    assert lambda_sweep.rate(rows, "LSPI", 0.1) == wilson(90, 100)
    low, high = lambda_sweep.rate(rows, "Q tuned", 0.1)[1:]
    assert high - low > 0.5  # two trainings that differ so tell little


def test_one_controller_falls_where_its_starts_say_and_several_trainings_where_their_shares_do():
    options = lambda_sweep.Options(trainings=1, episodes=200, lam=(0.5, 0.2, 0.35), basins=0)
    result = lambda_sweep.run(_study.Job("LQR"), options)
    traces = {"LQR-0": dict(result.traces)}
    half, most = lambda_sweep.falls_to(list(result.rows), traces, "LQR")
    assert half == crossing([0.2, 0.35, 0.5], traces["LQR-0"]["saved"], 0.5)
    saves = {row.lam: row.successes / row.episodes for row in result.rows}
    assert saves[0.2] > 0.9 > saves[0.35] > 0.5 > saves[0.5]
    assert 0.2 < most.low < most.level < most.high < 0.35 < half.low < half.level < 0.5
    shares = [[0.9, 0.6, 0.1], [0.8, 0.5, 0.3]]
    trained = [
        row(training=k, lam=lam, successes=round(100 * share))
        for k, curve in enumerate(shares)
        for lam, share in zip((0.2, 0.35, 0.5), curve, strict=True)
    ]
    assert lambda_sweep.falls_to(trained, {}, "Q tuned")[0] == crossing([0.2, 0.35, 0.5], shares, 0.5)


def test_the_best_known_is_the_share_of_the_shipped_table_within_the_spreads():
    curve, (half, most) = lambda_sweep.best([0.2, 0.4])
    assert list(curve) == [0.2, 0.3, 0.4]
    assert curve[0.4] == wilson(int(recoverable.shipped()[0.4].sum()), 1000)
    assert half.level == math.inf
    assert 0.3 < most.low < most.level < most.high < 0.4
    assert lambda_sweep.best([1.0, 1.5])[0] == {}


def test_the_summary_counts_the_converged_and_marks_what_is_shipped():
    rows = [row(), row(training=1, outcome="diverged"), row(controller="PPO balance", outcome="shipped")]
    text = said(rows, {"PPO_balance-0": {"saved": np.ones((100, 1))}})
    assert re.search("Q tuned +1 of 2", text)
    assert "PPO balance †" in text


def test_the_reports_table_is_what_the_report_says():
    assert lambda_sweep.TABLE2 == {0.1: 0.94, 0.2: 0.92, 0.3: 0.78, 0.4: 0.49}


def test_where_a_curve_falls_is_drawn_there_with_its_interval_and_an_arrow_beyond():
    axis = Figure().subplots()
    beyond = Crossing(math.inf, math.inf, math.inf)
    falls = {"LQR": (Crossing(0.48, 0.46, 0.51), Crossing(0.3, -math.inf, 0.4)), "best": (beyond, beyond)}
    plot_falls(axis, falls, {"LQR": ("k", "o", "-")}, [0.1, 0.6])
    drawn = [(line.get_marker(), np.ravel(line.get_xdata()).tolist()) for line in axis.lines]
    edges = list(axis.get_xlim())
    assert drawn[:4] == [("None", [0.46, 0.51]), ("o", [0.48]), ("None", [edges[0], 0.4]), ("o", [0.3])]
    assert drawn[5] == (">", [edges[1]])
    assert [label.get_text() for label in axis.get_yticklabels()] == ["LQR", "best"]


def test_rates_and_spreads_are_said_with_their_intervals():
    assert percent(Rate(0.845, 0.821, 0.866)) == "84.5\n82–87"
    assert percent(Rate(1.0, 0.9962, 1.0)) == "100.0\n99.6–100"
    levels = [0.05, 0.6]
    assert spread(Crossing(0.25, 0.2, 0.3), levels) == "0.250\n0.200–0.300"
    assert spread(Crossing(0.25, -math.inf, math.inf), levels) == "0.250\n<0.05–>0.6"
    assert spread(Crossing(math.inf, math.inf, math.inf), levels) == ">0.6"


def test_the_finding_is_what_the_kept_table_says():
    kept = Path(__file__).parent.parent / "docs" / "results" / "lambda_sweep_100" / "rows.csv"
    rows = _study.read_rows(kept, lambda_sweep.Row)
    finding = " ".join((lambda_sweep.__doc__ or "").partition("Finding: ")[2].split())
    for name, words in (("LQR", "LQR saves"), ("Q tuned", "Q-learning tuned")):
        shares = [f"{100 * lambda_sweep.rate(rows, name, lam).share:.1f}" for lam in lambda_sweep.TABLE2]
        assert f"{words} {'/'.join(share.removesuffix('.0') for share in shares)} %" in finding
    for name in ("Q tuned", "Q published"):
        assert lambda_sweep._converged(rows, name) in finding


# --------------------------------------------------------------------------------------------------------------- basins


def test_a_basin_is_mirrored_for_a_law_that_is_odd_and_lies_within_what_can_be_saved():
    angles, force = recoverable.shipped_map()
    saved = _basins.basin(LQR(RIG), len(angles), 0)
    assert (saved == saved[::-1, ::-1]).all()
    assert saved[len(angles) // 2, len(angles) // 2]
    assert (force[saved] <= recoverable.FORCE).all()
    assert 0.5 < _basins.part_saved(saved) < 1


def test_the_part_saved_is_of_what_can_be_saved_alone():
    force = recoverable.shipped_map()[1]
    assert _basins.part_saved(force <= recoverable.FORCE) == 1
    assert _basins.part_saved(~(force <= recoverable.FORCE)) == 0
    assert _basins.part_saved(np.full((9, 9), 0.25)) == 0.25


def test_a_map_is_drawn_with_link_1_across_and_link_2_upwards():
    x = _basins.starts(3)
    assert x[1, 1:3].tolist() == [0.0, -_basins.EXTENT]
    assert x[5, 1:3].tolist() == [_basins.EXTENT, 0.0]
