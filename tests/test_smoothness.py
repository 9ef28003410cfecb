"""The smoothness study: known forces have known figures, devices are held against the bare laws, labels stand apart."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import dpend
from controllers import LQR
from rl import DeepRecipe, deep, load_policy
from rl.deep import Evaluation
from rl.recipes import PPOSettings
from studies import smoothness
from studies._estimates import Estimate
from studies._field import CONTENDERS, RIG
from studies._runner import main
from studies.smoothness import DEVICES, Job, Options
from tests.rigs import whole

MINE = """
import numpy as np

class Wave:
    \"\"\"Full force, to one side and to the other.\"\"\"

    def start(self, n, rng):
        return lambda t, y: np.full(n, 40.0 if round(t / 0.02) % 2 else -40.0)

class Steady:
    def start(self, n, rng):
        return lambda t, y: np.full(n, 10.0)
"""


def job(contender="LQR", task="balance 0.3", condition="perfect", starts=40, **what):
    return Job(
        contender=contender, task=task, condition=condition, starts=starts, steps=smoothness.TASKS[task].steps, seed=0,
        **what,
    )  # fmt: skip


@pytest.fixture
def options(tmp_path):
    (tmp_path / "mine.py").write_text(MINE)
    own = tuple(f"{tmp_path / 'mine.py'}:{name}" for name in ("Wave", "Steady"))
    return Options(controller=own, only=("LQR",), quick=True)


def metrics(options, contender):
    """Return the median of each metric over all runs of a swing-up; in half a second none succeeds."""
    (chosen,) = [
        job
        for job in smoothness.jobs(options)
        if (job.contender, job.task, job.condition) == (contender, "swing-up", "perfect")
    ]
    rows: Any = smoothness.run(replace(chosen, steps=25)).rows
    assert all(row["successes"] == row["both"] == 0 for row in rows)
    assert all(np.isnan(row["median"]) and np.isnan(row["ratio"]) for row in rows)
    return {row["metric"]: row["of_all"] for row in rows}


def test_a_square_wave_and_a_constant_of_your_own_have_the_figures_that_they_must_have(options):
    seconds, jumps = 0.5, 24
    wave, steady = metrics(options, "Wave"), metrics(options, "Steady")
    assert wave["variation"] == pytest.approx(2 * jumps / seconds)
    assert wave["switches"] == pytest.approx(jumps / seconds)
    assert wave["saturated"] == 1.0
    assert wave["effort"] == pytest.approx(40.0**2 * seconds)
    assert wave["spectral_share"] > 0.99
    assert steady["effort"] == pytest.approx(10.0**2 * seconds)
    still = ("variation", "slew", "switches", "saturated", "spectral_share", "std_step")
    assert {steady[name] for name in still} == {0}


def test_a_controller_of_your_own_does_every_task_with_and_without_both_devices(options):
    own = [job for job in smoothness.jobs(options) if job.contender == "Wave"]
    assert {job.task for job in own if job.device == "none"} == set(smoothness.TASKS)
    assert {job.device for job in own} == {"none", "rate limit", "low-pass"}
    assert all(job.own for job in own)


@pytest.mark.slow
def test_a_controller_of_your_own_stands_in_figures_and_tables(options, tmp_path):
    chosen = ["--controller", *options.controller, "--only", "LQR", "--quick"]
    table = main("studies.smoothness", [*chosen, "--workers", "1", "--out", str(tmp_path / "out")])
    report = smoothness.report(table)
    figures: Any = report.figures
    titles = [axis.get_title(loc="left") for axis in figures["_forces"].axes]
    assert [title for title in titles if title in ("LQR", "Wave", "Steady")] == ["LQR", "Wave", "Steady"]
    _, labels = figures["_devices"].axes[0].get_legend_handles_labels()
    assert labels == ["LQR", "Wave", "Steady"]
    lines = [line for sheet in report.tables for line in sheet.lines if "Steady" in [cell.text for cell in line]]
    assert len(lines) == len(smoothness.TASKS) * 2 + 4


def test_medians_are_over_the_runs_that_succeed_and_a_reference_is_once_itself():
    rows: Any = smoothness.run(job(condition="noise")).rows
    task = dpend.Balance(lam=0.3)
    starts = task.starts(np.random.default_rng([0, 21]), 40, RIG)
    runs = dpend.simulate_many(RIG.replace(sensor_noise=0.002), LQR(RIG), starts, task=task)
    values = runs.metrics() | runs.smoothness()
    assert 0 < runs.success.sum() < 40
    for row in rows:
        assert row["successes"] == row["both"] == runs.success.sum()
        assert_allclose(row["median"], np.median(values[row["metric"]][runs.success]), rtol=1e-4)
        assert_allclose(row["of_all"], np.median(values[row["metric"]]), rtol=1e-4)
        assert row["ratio"] == 1.0


@pytest.mark.parametrize(("device", "setting"), [("low-pass", 1e6), ("rate limit", 1e9)])
def test_a_device_that_lets_everything_pass_changes_nothing(device, setting):
    plain = smoothness.measured(job(condition="noise", starts=30))
    filtered = smoothness.measured(job(condition="noise", starts=30, device=device, setting=setting))
    assert_array_equal(plain.success, filtered.success)
    for name in smoothness.METRICS:
        assert_allclose(filtered.values[name], plain.values[name], rtol=1e-9)


def test_a_device_is_compared_with_the_bare_law_on_the_starts_that_both_save():
    filtered = job("sign of stiff LQR", starts=60, device="low-pass", setting=8.0)
    rows: Any = smoothness.run(filtered).rows
    (row,) = [row for row in rows if row["metric"] == "variation"]
    bare = smoothness.measured(replace(filtered, device="none", setting=0.0))
    own = smoothness.measured(filtered)
    both = bare.success & own.success
    assert (row["reference"], row["both"]) == ("sign of stiff LQR", both.sum())
    assert_allclose(row["ratio"], np.median((own.values["variation"] / bare.values["variation"])[both]), rtol=1e-4)


def test_those_that_are_named_here_take_part():
    tasks = {contender.name: contender.tasks for contender in CONTENDERS}
    assert set(smoothness.SHOWN) <= set(tasks)
    for device in DEVICES.values():
        assert all("balance" in tasks[name] for name in device.contenders)
    for task, name in smoothness.REFERENCES.items():
        assert smoothness.NAMES[task] in tasks[name]


def test_the_front_leaves_out_what_a_smoother_one_equals():
    points = [(0.2, 0.8), (0.1, 0.5), (0.3, 0.8), (0.4, 0.9), (0.1, 0.3)]
    assert smoothness.front([(Estimate(x), Estimate(y)) for x, y in points]) == [(0.1, 0.5), (0.2, 0.8), (0.4, 0.9)]


def test_trainings_that_differ_in_smoothing_alone_are_found_and_no_others(tmp_path):
    plain: dict[str, Any] = {"algo": "ppo", "net": (64,), "steps": 100_000}
    wide: dict[str, Any] = {"net": (128,), "action_rate": 0.1}
    smooth: dict[str, Any] = {"ppo": PPOSettings(caps=(0.3, 0.1, 0.02)), "steps": 200_000}
    recipes = {
        "ppo": DeepRecipe(RIG, **plain),
        "ppo-caps": DeepRecipe(RIG, **plain | smooth),
        "ppo-both": DeepRecipe(RIG, **plain, action_rate=0.1, sensor_noise=0.002),
        "ppo-wide": DeepRecipe(RIG, **plain | wide),  # no plain one beside it
        "ppo-rest": DeepRecipe(RIG, **plain, starts="rest"),  # no smooth one beside it
        "ppo-env": DeepRecipe(**plain, env="InvertedDoublePendulum-v5"),
        "ppo-balance": DeepRecipe(RIG, **plain, task="balance"),
        "ppo-other": DeepRecipe(RIG.replace(force_limit=20.0), **plain, action_rate=0.1),
    }
    for name, recipe in recipes.items():
        folder = tmp_path / name / "seed-3"
        folder.mkdir(parents=True)
        load_policy("ppo-swing-up").save(folder / "policy.npz")
        deep._write_curve(folder / "curve.csv", [Evaluation(1000, 0.0, 0.0, 0.0, 1.0, 1.0)])
        (folder / "recipe.json").write_text(json.dumps({"recipe": recipe.to_dict()}))
    found = smoothness.trainings(tmp_path, RIG)
    assert {name: (each.device, each.strength) for name, each in found.items()} == {
        "ppo": ("plain", 0.0),
        "ppo-caps": ("CAPS", 0.3),
        "ppo-both": ("action rate, noise", 0.1),
    }
    assert [training.seed for training in found["ppo"].trainings] == [3]
    assert smoothness.trainings(tmp_path / "none", RIG) == {}


def test_too_few_starts_are_refused():
    with pytest.raises(ValueError, match=whole("--starts must be at least 2; got 1.")):
        Options(starts=1)
