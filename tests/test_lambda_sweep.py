"""The sweep over λ: who takes part, on which starts they are evaluated, what the table says; and the basins."""

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import dpend
from controllers import LQR
from rl import LinearQLearning
from studies import _basins, _figures, lambda_sweep
from studies._boundary import kept_boundary
from studies._estimates import crossing, share
from studies._field import RIG, find
from studies._runner import Table, plain_fields
from studies._table import load

BY_HAND = """
class ByHand:
    def start(self, n, rng):
        return lambda t, y: y @ [-1, 150, -165, -2.5, 7, -29]
"""


def names(**options):
    return [job.contender for job in lambda_sweep.jobs(lambda_sweep.Options(trainings=1, **options))]


def row(**changes):
    return {
        "contender": "Q tuned", "training": 0, "lam": 0.1, "episodes": 100, "successes": 90, "successes_report": 95,
        "outcome": "converged", "plant": "gustafsson2016", "sample_time": 0.02,
        "training_episodes": 1, "training_steps": 2, "test_steps": 3, "first": 0, "seed": 0,
    } | changes  # fmt: skip


def table(*rows, arrays=None):
    frame = pd.DataFrame(rows)
    frame["job"] = frame.groupby(["contender", "training"], sort=False).ngroup()
    return Table(frame, by_job=arrays or {})


def ran(*jobs):
    """Return the table of jobs, as the runner does."""
    results = [lambda_sweep.run(job) for job in jobs]
    rows = [{**plain_fields(job), **row} for job, result in zip(jobs, results, strict=True) for row in result.rows]
    return table(*rows, arrays={k: dict(result.arrays) for k, result in enumerate(results)})


PLANT = lambda_sweep.Options().plant


def job(contender, **changes):
    made = {"plant": PLANT, "training": 0, "lams": (0.3,), "first": 0, "starts": 60, "side": 0, "seed": 0, "own": None}
    return lambda_sweep.Job(contender=contender, **(made | changes))


def cells(reported):
    """Return what stands in the tables of a report: a list of words by title and contender."""
    return {sheet.title: {line[0].text: [each.text for each in line[1:]] for line in sheet.lines}
            for sheet in reported.tables}  # fmt: skip


# -------------------------------------------------------------------------------------- who takes part, on which starts


def test_all_that_balance_take_part_but_what_takes_minutes_and_the_plain_rule_only_if_asked():
    every = {contender.name for contender in lambda_sweep.KNOWN if "balance" in contender.tasks}
    assert set(names()) == every - {"NMPC", "Q tuned, plain rule"}
    assert set(names(plain=True)) == every - {"NMPC"}
    assert set(names(all=True)) == every
    assert names(only=("LQR", "NMPC")) == ["NMPC", "LQR"]


def test_learners_train_several_times_each_with_starts_of_its_own_and_all_others_take_part_once():
    jobs = lambda_sweep.jobs(lambda_sweep.Options(trainings=3, episodes=7))
    assert {job.contender for job in jobs if job.training == 2} == {
        each.name
        for each in lambda_sweep.KNOWN
        if each.learner and "balance" in each.tasks and each.name != lambda_sweep.PLAIN
    }
    assert [(job.first, job.starts) for job in jobs if job.contender == "LSPI"] == [(0, 7), (7, 7), (14, 7)]
    assert [(job.first, job.starts) for job in jobs if job.contender == "LQR"] == [(0, 21)]
    assert len(set(jobs)) == len(jobs)


def test_those_that_take_long_are_evaluated_on_their_part_and_all_others_on_every_start():
    options = lambda_sweep.Options(trainings=100, episodes=1000)
    assert options.starts(find("LQR")) == 100_000
    assert options.starts(find("PPO balance")) == 10_000
    assert options.starts(find("iLQR MPC")) == 10_000
    assert options.starts(find("NMPC")) == 20
    few = lambda_sweep.Options(trainings=2, episodes=5, part_of=1000)
    assert few.starts(find("NMPC")) == 10
    assert options.side(find("NMPC")) == 0
    every = lambda_sweep.Options(all=True, basins=41)
    assert [every.side(find(name)) for name in ("NMPC", "iLQR MPC", "LQR")] == [9, 41, 41]


@pytest.mark.slow
def test_trained_controllers_are_evaluated_on_their_part_of_the_starts_of_lqr():
    task = dpend.Balance(lam=0.3)
    starts = task.starts(np.random.default_rng([0, 1]), 60, RIG)
    (lqr,) = lambda_sweep.run(job("LQR")).rows
    assert lqr["successes"] == dpend.simulate_many(RIG, LQR(RIG), starts, task=task).success.sum()
    (second,) = lambda_sweep.run(job("Q published", training=1, first=30, starts=30)).rows
    policy = LinearQLearning.published(RIG).train([0, 2, 1]).policy
    assert second["successes"] == dpend.simulate_many(RIG, policy, starts[30:], task=task).success.sum()
    assert second["episodes"] == 30


def test_a_controller_of_ones_own_stands_in_the_tables_with_its_force_and_its_basin(tmp_path):
    (tmp_path / "mine.py").write_text(BY_HAND)
    options = lambda_sweep.Options(controller=(f"{tmp_path / 'mine.py'}:ByHand",), only=("LQR",), quick=True)
    made = ran(*lambda_sweep.jobs(options))
    assert made.rows["contender"].tolist() == 2 * ["LQR"] + 2 * ["ByHand"]
    first = made.where(contender="ByHand", lam=0.05)
    assert first["successes"].tolist() == first["episodes"].tolist() == [40]
    assert [set(kept) for kept in made.by_job.values()] == 2 * [{"saved", "force", "basin"}]
    assert made.array("saved", contender="ByHand").sum(axis=0).tolist() == (
        made.where(contender="ByHand")["successes"].tolist()
    )
    with _figures.look():
        reported = lambda_sweep.report(made)
    assert all("ByHand" in lines for lines in cells(reported).values())
    figures = reported.figures
    assert isinstance(figures, dict)
    assert [axis.get_title().partition(":")[0] for axis in figures["_basins"].axes] == ["LQR", "ByHand", "", ""]


# ---------------------------------------------------------------------------------------------- what the table comes to


def test_a_share_is_of_one_contender_one_spread_and_one_criterion():
    made = table(
        row(), row(training=1, successes=50), row(lam=0.2, successes=0),
        row(contender="LQR", successes=7, outcome="-"), row(contender="LSPI", outcome="shipped"),
    )  # fmt: skip
    assert lambda_sweep.saved(made, "Q tuned", 0.1).value == pytest.approx(0.7)
    assert lambda_sweep.saved(made, "Q tuned", 0.1, "successes_report").value == pytest.approx(0.95)
    assert lambda_sweep.saved(made, "LQR", 0.1) == share(7, 100)
    assert lambda_sweep.saved(made, "LSPI", 0.1) == share(90, 100)
    _, low, high = lambda_sweep.saved(made, "Q tuned", 0.1)
    assert high - low > 0.5  # two trainings that differ so say little


def test_one_controller_falls_where_its_starts_say_and_several_trainings_where_their_shares_do():
    made = ran(job("LQR", starts=200, lams=(0.2, 0.35, 0.5)))
    half, most = lambda_sweep.falls_to(made, "LQR")
    assert half == crossing([0.2, 0.35, 0.5], made.array("saved"), 0.5, square=True)
    saves = dict(zip(made.rows["lam"], made.rows["successes"] / made.rows["episodes"], strict=True))
    assert saves[0.2] > 0.9 > saves[0.35] > 0.5 > saves[0.5]
    assert 0.2 < most.low < most.value < most.high < 0.35 < half.low < half.value < 0.5
    shares = [[0.9, 0.6, 0.1], [0.8, 0.5, 0.3]]
    trained = table(*(
        row(training=k, lam=lam, successes=round(100 * value))
        for k, curve in enumerate(shares)
        for lam, value in zip((0.2, 0.35, 0.5), curve, strict=True)
    ))  # fmt: skip
    assert lambda_sweep.falls_to(trained, "Q tuned")[0] == crossing([0.2, 0.35, 0.5], shares, 0.5, square=True)


def test_what_a_law_saves_beyond_the_tuned_linear_one_is_counted_on_the_starts_that_both_had():
    of = {lambda_sweep.BASELINE: [[1], [0], [0], [0]], "iLQR MPC": [[1], [1]], "LQR": [[0], [0], [0], [0]]}
    made = table(
        *(row(contender=name, episodes=len(each), successes=1, successes_report=1, outcome="-")
          for name, each in of.items()),
        arrays={k: {"saved": np.array(each)} for k, each in enumerate(of.values())},
    )  # fmt: skip
    (beyond,) = (found for title, found in cells(lambda_sweep.report(made)).items() if "beyond" in title)
    assert {name: words[0].split()[0] for name, words in beyond.items()} == {"LQR": "-25.0", "iLQR MPC": "+50.0"}


def test_the_best_known_are_the_tables_own_starts_within_the_boundary_and_those_that_any_contender_saves():
    inside = {}
    for lam in (0.3, 0.4, 0.6):
        starts = dpend.Balance(lam=lam).starts(np.random.default_rng([5, 1]), 300, RIG)
        inside[lam] = kept_boundary().savable(starts)
    made = table(*(row(lam=lam, seed=5, first=200) for lam in inside))
    curve, (half, most) = lambda_sweep.best(made)
    assert curve == {lam: share(each.sum(), 300) for lam, each in inside.items()}
    assert 0.3 < most.low < most.value < most.high < 0.6
    assert half.value == math.inf
    made = table(*(row(lam=lam, seed=5, first=200) for lam in inside), arrays={0: {"saved": np.ones((100, 3), bool)}})
    expected = inside[0.6][:200].sum() + 100
    assert lambda_sweep.best(made)[0][0.6] == share(expected, 300)
    assert lambda_sweep.best(table(row(lam=0.2, plant="pilco2011")))[0] == {}


def test_on_another_rig_it_is_evaluated_there_and_compared_with_nothing_of_the_default_one():
    options = lambda_sweep.Options(
        rig="gymnasium_idp", set=("force_limit=30",), only=("LQR", "PPO balance"), quick=True
    )
    (lqr,) = lambda_sweep.jobs(options)
    rig = dpend.rig("gymnasium_idp").replace(force_limit=30.0)
    starts = dpend.Balance(lam=lqr.lams[-1]).starts(np.random.default_rng([0, 1]), lqr.starts, rig)
    task = dpend.Balance(lam=lqr.lams[-1])
    made = ran(lqr)
    assert made.rows["plant"].unique().tolist() == ["gymnasium_idp, force_limit=30"]
    expected = dpend.simulate_many(rig, LQR(rig), starts, task=task).success.sum()
    assert made.where(lam=lqr.lams[-1])["successes"].tolist() == [expected]
    with _figures.look():
        reported = lambda_sweep.report(made)
    assert list(cells(reported)["Starts saved, %"]) == ["LQR"]
    assert isinstance(reported.figures, dict)
    assert reported.figures["_basins"].axes[0].get_title() == "LQR"


def test_the_tables_count_the_converged_and_mark_what_is_shipped():
    made = table(
        row(), row(training=1, outcome="diverged", successes=0), row(contender="PPO balance", outcome="shipped"),
        arrays={2: {"saved": np.ones((100, 1), bool)}},
    )  # fmt: skip
    found = cells(lambda_sweep.report(made))
    assert list(found["Starts saved, %"]) == ["best known", "Q tuned (1 of 2 converged)", "PPO balance †"]
    assert found["Of the starts that can be saved: saved, %"] == {"PPO balance": ["100.0"]}
    assert found["What learning cost, medians over trainings"] == {"Q tuned": ["1 of 2", "1", "2", "3"]}
    assert found["Starts saved by the trainings that converged, %"] == {"Q tuned": ["90.0"]}


def test_the_reports_table_is_shown_on_the_plant_of_its_program_alone():
    made = table(row(plant="gustafsson2016_as_coded"), arrays={0: {"saved": np.ones((100, 1), bool)}})
    assert "the report's Table 2" in cells(lambda_sweep.report(made))["Starts saved, %"]


def test_the_reports_table_is_what_the_report_says():
    assert lambda_sweep.TABLE2 == {0.1: 0.94, 0.2: 0.92, 0.3: 0.78, 0.4: 0.49}


def test_the_finding_is_what_the_kept_table_says():
    made = load(Path(__file__).parent.parent / "docs" / "results" / "lambda_sweep_100")
    finding = " ".join((lambda_sweep.__doc__ or "").partition("Finding: ")[2].split())
    for name, words in (("LQR", "LQR saves"), ("Q tuned", "Q-learning tuned")):
        shares = [f"{100 * lambda_sweep.saved(made, name, lam).value:.1f}" for lam in lambda_sweep.TABLE2]
        assert f"{words} {'/'.join(share.removesuffix('.0') for share in shares)} %" in finding
    for name in ("Q tuned", "Q published"):
        assert lambda_sweep.converged(made, name) in finding


# --------------------------------------------------------------------------------------------------------------- basins


def test_a_basin_is_mirrored_for_a_law_that_is_odd_and_lies_within_what_can_be_saved():
    saved = _basins.basin(RIG, LQR(RIG), 41, 0)
    assert (saved == saved[::-1, ::-1]).all()
    assert saved[20, 20]
    assert kept_boundary().savable(_basins.starts(41))[saved.ravel()].all()
    assert 0.5 < _basins.part_saved(saved) < 1


def test_the_part_saved_is_of_what_can_be_saved_alone():
    can = kept_boundary().savable(_basins.starts(41)).reshape(41, 41)
    assert _basins.part_saved(can) == 1
    assert _basins.part_saved(~can) == 0
    assert _basins.part_saved(np.full((9, 9), 0.25)) == 0.25


def test_a_map_is_drawn_with_link_1_across_and_link_2_upwards():
    x = _basins.starts(3)
    assert x[1, 1:3].tolist() == [0.0, -_basins.EXTENT]
    assert x[5, 1:3].tolist() == [_basins.EXTENT, 0.0]
