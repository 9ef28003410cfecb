"""The swing-up study: a controller of one's own joins, refusals leave no row, step times are of all steps."""

import gc
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from rich.console import Console

import dpend
from studies import _study, swing_up
from studies._step_times import EDGES, StepTimes, undisturbed
from studies._study import Job

MINE = """
class Mine:
    def __init__(self, rig):
        if rig.sample_time != 0.02:
            raise ValueError("made for 0.02 s")

    def start(self, n, rng):
        return lambda t, y: 5.0 * y[:, 4]
"""


@pytest.fixture
def options(tmp_path):
    (tmp_path / "mine.py").write_text(MINE)
    return swing_up.Options(runs=3, preset_runs=2, controller=(f"{tmp_path / 'mine.py'}:Mine",))


def test_a_controller_of_your_own_meets_every_condition_and_preset_and_a_refused_preset_gives_no_row(options):
    mine = [job for job in swing_up.jobs(options) if job.source]
    assert all(job.setting.startswith("Mine + ") for job in mine)
    assert len(mine) == len(swing_up.STARTS) * len(swing_up.CONDITIONS) + len(dpend.rigs()) - 1
    nominal, preset = (
        swing_up.run(Job(swing_up.Case("Mine", "hanging", rig=rig).setting), options)
        for rig in ("gustafsson2016", "dm_control_two_poles")
    )
    assert [(row.controller, row.run) for row in nominal.rows] == [("Mine", 0), ("Mine", 1), ("Mine", 2)]
    assert preset.rows == []
    rows = [*nominal.rows, swing_up.Row(**(vars(nominal.rows[0]) | {"rig": "pilco2011"}))]
    console = Console(width=200)
    with console.capture() as shown:
        console.print(
            swing_up.summary(rows, {_study.slug(Job(swing_up.Case("Mine", "hanging").setting)): dict(nominal.traces)})
        )
    (line,) = (line for line in shown.get().splitlines() if "dm_control_two_poles" in line)
    assert "refused" in line


def test_those_who_are_left_out_meet_nothing_and_the_others_all_they_met_before(options):
    some = replace(options, only=("TVLQR",))
    cases, every = list(swing_up.cases(some)), list(swing_up.cases(options))
    assert {case.controller for case in cases} == {"TVLQR", "Mine"}
    assert cases == [case for case in every if case.controller in ("TVLQR", "Mine")]


def test_a_case_is_timed_one_run_at_a_time_and_gives_what_the_batch_gives(options):
    nominal = swing_up.run(Job(swing_up.Case("PPO swing-up", "side").setting), options)
    rig = dpend.rig("gustafsson2016")
    task = swing_up.Case("PPO swing-up", "side").task
    starts = task.starts(np.random.default_rng([0, 1]), 3, rig)
    batch = dpend.simulate_many(rig, options.contestants["PPO swing-up"].make(rig, task), starts, task=task)
    assert [row.success for row in nominal.rows] == batch.success.tolist()
    assert [row.time_up for row in nominal.rows] == pytest.approx(batch.time_up, abs=0.021)
    assert StepTimes.joined([nominal.traces]).steps == 3 * (task.steps - 1)


def test_a_quantile_of_many_runs_is_that_of_all_their_steps_and_late_steps_are_counted():
    rng = np.random.default_rng(0)
    times = [rng.lognormal(-7 + k, 1.0, (4, 301)) for k in range(3)]
    parts = []
    for seconds in times:
        steps = np.array([301, 301, 100, 1])
        runs = cast(dpend.Runs, SimpleNamespace(step_time=seconds, steps=steps))
        parts.append(StepTimes.of(runs, 0.02).traces())
    every = np.concatenate(
        [np.concatenate([row[1:last] for row, last in zip(t, (301, 301, 100, 1), strict=True)]) for t in times]
    )
    joined = StepTimes.joined(parts)
    assert joined.steps == len(every)
    assert joined.late == (every > 0.02).sum() > 0
    assert joined.longest == every.max()
    assert joined.first.tolist() == [seconds for t in times for seconds in t[:, 0]]
    for share in (0.5, 0.99):
        exact = np.quantile(every, share, method="inverted_cdf")
        assert exact <= joined.quantile(share) <= exact * EDGES[1] / EDGES[0]


def test_the_collector_leaves_alone_what_was_there_before_and_gets_it_back():
    with undisturbed():
        assert gc.get_freeze_count() > 1000
    assert gc.get_freeze_count() == 0
