"""The smoothness study: known forces have known figures, devices are held against their wearers, labels stand apart."""

import json
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.testing import assert_allclose, assert_array_equal
from rich.console import Console

import dpend
from controllers import LQR
from studies import _study, smoothness
from studies._entrants import ENTRANTS, RIG
from studies._labels import place_labels
from studies.smoothness import DEVICES, Case, Options
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


@pytest.fixture
def options(tmp_path):
    (tmp_path / "mine.py").write_text(MINE)
    own = tuple(f"{tmp_path / 'mine.py'}:{name}" for name in ("Wave", "Steady"))
    return Options(controller=own, only=("LQR",), quick=True)


def metrics(options, controller):
    """Return the median of each metric over all runs of a swing-up; half a second, nobody succeeds."""
    rows = smoothness.run(Case(controller, "swing-up", "perfect").job(), options).rows
    assert all(row.successes == row.both == 0 and np.isnan(row.median) and np.isnan(row.ratio) for row in rows)
    return {row.metric: row.of_all for row in rows}


def test_a_square_wave_and_a_constant_of_your_own_have_the_figures_that_they_must_have(options):
    seconds, jumps = 0.5, 24
    wave, steady = metrics(options, "Wave"), metrics(options, "Steady")
    assert wave["variation"] == pytest.approx(2 * jumps / seconds)
    assert wave["switches"] == pytest.approx(jumps / seconds)
    assert wave["saturated"] == 1.0
    assert wave["effort"] == pytest.approx(40.0**2 * seconds)
    assert wave["spectral_share"] > 0.99
    assert steady["effort"] == pytest.approx(10.0**2 * seconds)
    assert {steady[name] for name in ("variation", "slew", "switches", "saturated", "spectral_share", "std_step")} == {
        0
    }


def test_a_controller_of_your_own_does_every_task_and_wears_both_devices(options):
    own = [case for case, source in smoothness.cases(options) if case.controller == "Wave"]
    assert {case.task for case in own if case.device == "none"} == set(smoothness.TASKS)
    assert {case.device for case in own} == {"none", "rate limit", "low-pass"}
    assert all(source for case, source in smoothness.cases(options) if case.controller == "Wave")


@pytest.mark.slow
def test_a_controller_of_your_own_stands_in_figures_and_tables(options):
    results = {_study.slug(job): smoothness.run(job, options) for job in smoothness.jobs(options)}
    rows = [row for result in results.values() for row in result.rows]
    traces = {job: dict(result.traces) for job, result in results.items()}
    figures = smoothness.plot(rows, traces)
    titles = [axis.get_title(loc="left") for axis in figures["_forces"].axes]
    assert [title for title in titles if title in ("LQR", "Wave", "Steady")] == ["LQR", "Wave", "Steady"]
    _, labels = figures["_devices"].axes[0].get_legend_handles_labels()
    assert labels == ["LQR", "Wave", "Steady"]
    console = Console(width=300)
    with console.capture() as shown:
        console.print(smoothness.summary(rows, traces))
    told = [line for line in smoothness.pages(rows, traces)["tables.md"].splitlines() if "Steady" in line]
    assert sum("Steady" in line for line in shown.get().splitlines()) == len(told) == len(smoothness.TASKS) * 2 + 4


def test_medians_are_over_the_runs_that_succeed_and_a_reference_is_once_itself():
    rows = smoothness.run(Case("LQR", "balance 0.3", "noise").job(), Options(starts=40)).rows
    task = dpend.Balance(lam=0.3)
    starts = task.starts(np.random.default_rng([0, 21]), 40, RIG)
    runs = dpend.simulate_many(RIG.replace(sensor_noise=0.002), LQR(RIG), starts, task=task)
    values = runs.metrics() | runs.smoothness()
    assert 0 < runs.success.sum() < 40
    for row in rows:
        assert row.successes == row.both == runs.success.sum()
        assert_allclose(row.median, np.median(values[row.metric][runs.success]), rtol=1e-4)
        assert_allclose(row.of_all, np.median(values[row.metric]), rtol=1e-4)
        assert row.ratio == 1.0


@pytest.mark.parametrize(("device", "setting"), [("low-pass", "1e6"), ("rate limit", "1e9")])
def test_a_device_that_lets_everything_pass_changes_nothing(device, setting):
    options = Options(starts=30)
    plain, worn = (
        smoothness.measured(Case("LQR", "balance 0.3", "noise", *more), options) for more in ((), (device, setting))
    )
    assert_array_equal(plain.success, worn.success)
    for name in smoothness.METRICS:
        assert_allclose(worn.values[name], plain.values[name], rtol=1e-9)


def test_a_device_is_compared_with_what_wears_it_on_the_starts_that_both_save():
    options = Options(starts=60)
    case = Case("sign of stiff LQR", "balance 0.3", "perfect", "low-pass", "8")
    (row,) = smoothness.found(list(smoothness.run(case.job(), options).rows), "variation")
    plain = smoothness.measured(case._replace(device="none", setting="0"), options)
    worn = smoothness.measured(case, options)
    both = plain.success & worn.success
    assert (row.reference, row.both) == ("sign of stiff LQR", both.sum())
    assert_allclose(row.ratio, np.median((worn.values["variation"] / plain.values["variation"])[both]), rtol=1e-4)


def test_those_that_are_named_here_take_part():
    names = {entrant.name: entrant.tasks for entrant in ENTRANTS}
    assert set(smoothness.SHOWN) <= set(names)
    for device in DEVICES.values():
        assert all("balance" in names[name] for name in device.worn_by)
    for task, name in smoothness.REFERENCES.items():
        assert ("swing-up" if task == "swing-up" else "balance") in names[name]


def test_the_front_leaves_out_whom_a_smoother_one_equals():
    (row, *_) = smoothness.run(Case("LQR", "balance 0.1", "perfect").job(), Options(starts=2)).rows
    shares = [(0.2, 8), (0.1, 5), (0.3, 8), (0.4, 9), (0.1, 3)]
    rows = [replace(row, median=variation, successes=saved, starts=10) for variation, saved in shares]
    assert smoothness.front(rows) == [(0.1, 0.5), (0.2, 0.8), (0.4, 0.9)]


def test_trainings_that_differ_in_smoothing_alone_are_found_and_no_others(tmp_path):
    plain = {"algo": "ppo", "task": "swing-up", "env": "", "rig": RIG.to_dict(), "net": [64], "caps": [0.0, 0.0, 0.0],
             "action_rate": 0.0, "steps": 1, "starts": "mixed"}  # fmt: skip
    recipes = {
        "ppo": plain,
        "ppo-caps": plain | {"caps": [0.3, 0.1, 0.02], "steps": 2, "mirror": False},
        "ppo-both": plain
        | {"action_rate": 0.1, "sensor_noise": 0.002, "near": 0.1, "episode": 10.0},  # younger settings
        "ppo-wide": plain | {"net": [128], "action_rate": 0.1},  # no plain one beside it
        "ppo-rest": plain | {"starts": "rest"},  # no smooth one beside it
        "ppo-env": plain | {"env": "InvertedDoublePendulum-v5"},
        "ppo-balance": plain | {"task": "balance"},
        "ppo-other": plain | {"rig": RIG.replace(force_limit=20.0).to_dict(), "action_rate": 0.1},
    }
    for name, recipe in recipes.items():
        folder = tmp_path / name / "seed-3"
        folder.mkdir(parents=True)
        (folder / "policy.npz").touch()
        (folder / "recipe.json").write_text(json.dumps({"recipe": recipe}))
    found = {training.folder.parts[-2]: training[1:] for training in smoothness.trainings(tmp_path)}
    assert found == {
        "ppo": ("plain", 0.0),
        "ppo-caps": ("CAPS", 0.3),
        "ppo-both": ("action rate, noise", 0.1),
    }
    assert smoothness.trainings(tmp_path / "none") == []


def test_too_few_starts_are_refused():
    with pytest.raises(ValueError, match=whole("--starts must be at least 2; got 1.")):
        Options(starts=1)


def test_no_label_covers_another_or_a_point():
    rng = np.random.default_rng(0)
    figure = Figure(figsize=(6, 3), layout="constrained")
    axis = figure.subplots()
    axis.set(xscale="log", xlim=(0.1, 100), ylim=(0, 1.3))
    x, y = 10 ** rng.uniform(-0.6, 0.0, 12), np.append(np.ones(8), rng.uniform(0.5, 1, 4))
    place_labels(axis, x, y, [f"controller {k}" for k in range(12)])
    renderer = FigureCanvasAgg(figure).get_renderer()
    boxes = [text.get_window_extent(renderer) for text in axis.texts]
    assert not any(box.overlaps(other) for k, box in enumerate(boxes) for other in boxes[:k])
    points = axis.transData.transform(np.column_stack([x, y]))
    assert not any(box.contains(*point) for box in boxes for point in points)
    frame = axis.get_window_extent(renderer)
    assert all(frame.contains(box.x0, box.y0) and frame.contains(box.x1, box.y1) for box in boxes)
