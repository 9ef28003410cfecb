"""The swing-up study: a controller of one's own joins, a refusal is said, step times are of all steps."""

import gc
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pandas as pd
import pytest

import dpend
from studies import _runner, swing_up
from studies._field import find
from studies._runner import Table
from studies._step_times import EDGES, StepTimes, undisturbed
from studies._tables import markdown
from studies.swing_up import CONDITIONS, KNOWN, PRESETS, STARTS, TRANSFERS, Job

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


def table_of(jobs, quick=False):
    """Return the table of some jobs as the runner makes it."""
    results = [swing_up.run(job) for job in jobs]
    rows = [
        {"job": k, **_runner.plain_fields(job), **result.rows[0]}
        for k, (job, result) in enumerate(zip(jobs, results, strict=True))
    ]
    return Table(pd.DataFrame(rows), quick, {k: result.arrays for k, result in enumerate(results)})


@pytest.mark.slow
def test_a_controller_of_your_own_is_run_under_every_condition_and_a_preset_that_it_refuses_is_named(options):
    mine = [job for job in swing_up.jobs(options) if job.own]
    assert {job.contender for job in mine} == {"Mine"}
    assert len(mine) == len(STARTS) * len(CONDITIONS) + len(PRESETS)
    nominal = [job for job in mine if job.rig == "gustafsson2016"
               and all(getattr(job, name) == value for name, value in swing_up.NOMINAL.items())]  # fmt: skip
    other = [job for job in mine if job.rig in ("dm_control_two_poles", "pilco2011")]
    table = table_of([*nominal, *other])
    assert dict(table.where(rig="dm_control_two_poles")[["refused", "successes"]].iloc[0]) == {
        "refused": True, "successes": 0
    }  # fmt: skip
    assert len(swing_up.runs_of(table, "Mine", start="hanging")["success"]) == 3
    *_, presets = swing_up.report(table).tables
    assert "| dm\\_control\\_two\\_poles | refused |" in markdown(presets)


def test_what_is_left_out_has_no_jobs_and_the_others_have_all_that_they_had_before(options):
    some, every = swing_up.jobs(replace(options, only=("TVLQR",))), swing_up.jobs(options)
    assert {job.contender for job in some} == {"TVLQR", "Mine"}
    assert some == [job for job in every if job.contender in ("TVLQR", "Mine")]


def test_a_contender_that_does_not_swing_up_is_refused_with_those_that_do(tmp_path, capsys):
    with pytest.raises(SystemExit, match="2"):
        _runner.main("studies.swing_up", ["--only", "LQR", "TVLQR", "--out", str(tmp_path), "--workers", "1"])
    said = " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert (
        "--only LQR: it does not swing up; these do: iLQR MPC; NMPC; TVLQR; passivity, LQR; pumping, LQR; "
        "pumping, iLQR, LQR; learned model, iLQR; PPO swing-up; PPO swing-up, smooth; DDPG swing-up; energy NMPC."
        in said
    )
    assert not list(tmp_path.iterdir())


def test_quick_runs_are_fewer_but_as_long_as_the_others(options):
    quick, full = swing_up.jobs(replace(options, quick=True)), swing_up.jobs(options)
    assert {job.runs for job in quick} == {1}
    assert {replace(job, runs=3) for job in quick if job.start in STARTS} <= set(full)
    moved = {(job.start, job.target): job.seconds for job in quick if job.start not in STARTS}
    assert moved == {TRANSFERS[0]: 6.0}


@pytest.mark.slow
def test_runs_in_several_jobs_are_those_of_one(options):
    case = Job(contender="PPO swing-up", plant_error=0.2, runs=6, seed=3)
    whole = table_of([case])
    parts = table_of([replace(case, first=first, runs=n) for first, n in ((0, 2), (2, 4))])
    for metric in ("success", *swing_up.METRICS):
        np.testing.assert_allclose(
            swing_up.runs_of(parts, "PPO swing-up", plant_error=0.2)[metric],
            swing_up.runs_of(whole, "PPO swing-up", plant_error=0.2)[metric],
            rtol=1e-6,
        )
    options = replace(options, runs=120, only=("TVLQR",))
    nominal = [(job.first, job.runs) for job in swing_up.jobs(options) if job == replace(
        Job(contender="TVLQR", runs=job.runs, seed=0), first=job.first)]  # fmt: skip
    assert nominal == [(0, 50), (50, 50), (100, 20)]


def test_a_case_is_timed_one_run_at_a_time_and_gives_what_the_batch_gives():
    job = Job(contender="PPO swing-up", start="side", runs=3, seed=0)
    table, task = table_of([job]), swing_up.task_of(job, dpend.rig(job.rig))
    rig = dpend.rig("gustafsson2016")
    starts = task.starts(np.random.default_rng([0, 1]), 3, rig)
    batch = dpend.simulate_many(rig, find("PPO swing-up", known=KNOWN).make(rig, task), starts, task=task)
    assert table.array("success").tolist() == batch.success.tolist()
    assert table.array("time_up") == pytest.approx(batch.time_up, abs=0.021)
    assert StepTimes.joined(table).steps == 3 * (task.steps - 1)


@pytest.mark.slow
def test_films_are_found_by_job_where_names_differ_in_signs_only(options):
    table = table_of([Job(contender="TVLQR", runs=1, seed=0), Job(contender="PPO swing-up, smooth", runs=1, seed=0)])
    assert list(swing_up.films(table)) == ["TVLQR.gif", "PPO_swing-up_smooth.gif"]
    rows = table.rows.assign(contender=["TV LQR", "TV, LQR"])
    assert list(swing_up.films(replace(table, rows=rows))) == ["TV_LQR.gif", "TV_LQR_1.gif"]


def test_a_quantile_of_many_runs_is_that_of_all_their_steps_and_late_steps_are_counted():
    rng = np.random.default_rng(0)
    times = [rng.lognormal(-7 + k, 1.0, (4, 301)) for k in range(3)]
    parts = {}
    for k, seconds in enumerate(times):
        steps = np.array([301, 301, 100, 1])
        runs = cast(dpend.Runs, SimpleNamespace(step_time=seconds, steps=steps))
        parts[k] = StepTimes.of(runs, 0.02).arrays()
    every = np.concatenate(
        [np.concatenate([row[1:last] for row, last in zip(t, (301, 301, 100, 1), strict=True)]) for t in times]
    )
    joined = StepTimes.joined(Table(pd.DataFrame({"job": range(3)}), by_job=parts))
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


def test_a_run_succeeds_within_a_horizon_if_its_links_were_up_for_good_a_second_before_and_failures_are_of_one_kind():
    nan = np.nan
    runs = {
        "time_up": np.array([3.0, 9.0, 9.02, 21.0, nan, nan]),
        "success": np.array([1, 1, 1, 1, 0, 0]),
        "left": np.array([0, 0, 0, 0, 1, 0]),
        "given": np.full(6, 30.0),
    }
    shares = [swing_up.up(runs, horizon).value for horizon in swing_up.HORIZONS]
    assert shares == pytest.approx([1 / 6, 2 / 6, 3 / 6, 3 / 6, 4 / 6])
    assert shares[-1] == swing_up.up(runs).value
    assert swing_up.failures(runs) == "1, 2, 1 of 6"
    short = swing_up.up(runs | {"given": np.full(6, 10.0)}, 15.0)
    assert np.isnan(short.value)


@pytest.mark.slow
def test_one_long_run_says_what_a_short_one_of_the_same_start_says():
    long = Job(contender="TVLQR", plant_error=0.15, seconds=30.0, runs=6, seed=0)
    whole, part = (
        swing_up.runs_of(table_of([job]), "TVLQR", start="hanging", plant_error=0.15)
        for job in (long, replace(long, seconds=10.0))
    )
    assert 0 < swing_up.up(whole, 10.0).value <= swing_up.up(part).value < 1
