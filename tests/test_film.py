"""The film: everybody gets the same pushes, what is saved is what is shown, and the finding is its table's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_array_equal
from rigs import whole

import dpend
from dpend.plant import PUSHES
from studies import _runner, film
from studies._field import RIG, find
from studies._table import Table, load

KEPT = Path(__file__).parent.parent / "docs" / "results" / "film"


def table_of(jobs: list[film.Job]) -> Table:
    results = [film.run(job) for job in jobs]
    rows = [
        {"job": k, **_runner.plain_fields(job), **row}
        for k, (job, result) in enumerate(zip(jobs, results, strict=True))
        for row in result.rows
    ]
    return Table(pd.DataFrame(rows), False, {k: result.arrays for k, result in enumerate(results)})


def job_of(scene: film.SceneName, length: float) -> film.Job:
    (job,) = film.jobs(film.Options(only=(scene,), quick=True, workers=1))
    return replace(job, length=length)


def test_both_of_a_duel_start_alike_and_are_pushed_alike() -> None:
    runs = film.runs_of(table_of([job_of("duel", 1.3)]), "duel")
    assert list(runs) == ["Q tuned", "LQR"]
    first, second = runs.values()
    assert_array_equal(first.x[0], second.x[0])
    for name in PUSHES:
        assert_array_equal(first.log[name], second.log[name])
    assert np.flatnonzero(first.log["push_cart"]).tolist() == list(range(50, 60)), "from 1 s on, for 0.2 s"
    assert set(np.abs(first.u)) == {40.0}


def test_what_is_shown_is_what_was_run() -> None:
    shown = film.runs_of(table_of([job_of("duel", 0.4)]), "duel")["LQR"]
    task = dpend.Balance(steps=20)
    again = dpend.simulate(RIG, find("LQR").make(RIG, task), shown.x[0], task=task)
    assert_array_equal(shown.x, again.x)
    assert_array_equal(shown.u, again.u)
    assert shown.status is again.status


def test_a_film_has_the_scenes_asked_for_and_is_of_a_rig_that_can_be_shown() -> None:
    assert [job.scene for job in film.jobs(film.Options(only=("duel",), workers=1))] == ["duel"]
    assert [job.scene for job in film.jobs(film.Options(workers=1))] == list(film.CAPTIONS)
    message = "--rig pilco2011 has no track's end, and a film shows both; --set track_limit=5."
    with pytest.raises(ValueError, match=whole(message)):
        film.Options(rig="pilco2011", set=("sensor_noise=0",), workers=1)
    elsewhere = film.Options(set=("mass1=.6",), workers=1)
    assert elsewhere.contenders("learned") == ("LSPI", "QAC tuned"), "networks were trained on another plant"


def test_the_finding_is_what_the_table_says() -> None:
    table = load(KEPT)
    lines = [*table.lines(scene="duel"), *table.lines(scene="learned")]
    assert all(line.ending == "FULL_LENGTH" for line in lines)
    ratio = {line.shown: line.variation for line in lines}
    ratio = {name: each / ratio["LQR"] for name, each in ratio.items()}
    words = " ".join((film.__doc__ or "").partition("Finding:")[2].split())
    assert f"varies its force {ratio['Q tuned']:.0f} times as much as LQR, always at the limit;" in words
    others = [f"{ratio[name]:.2f}" for name in ("LSPI", "QAC tuned", "PPO balance", "DDPG balance")]
    assert f"vary theirs {', '.join(others[:3])} and {others[3]} times as much" in words
