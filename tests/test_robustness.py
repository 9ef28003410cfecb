"""All contenders have the same perturbations, they are what they say, and the scores are between never and always."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import dpend
from controllers import LQR, BangBang, Zero
from dpend import Stepper
from dpend.params import Array
from studies import _figures, _runner, robustness
from studies import _perturbations as perturbations
from studies._field import RIG, find
from studies._perturbations import AXES, FRICTIONS, GROUPS, NOMINAL, PARAMETERS, SENSORS, UNCERTAIN, Pulses, task_of
from studies._table import Table
from studies._tables import markdown

TASK = task_of("balance", 1.0)
BY_NAME = {axis.name: axis for axis in AXES}


class Recorder:
    """A law that keeps what it measured and returns no force."""

    def __init__(self) -> None:
        self.seen: list[Array] = []

    def start(self, n: int, rng: np.random.Generator) -> Any:
        def act(t: float, y: Array) -> Array:
            self.seen.append(y.copy())
            return np.zeros(n)

        return act


# ----------------------------------------------------------------------------------------------- the same for all


@pytest.mark.parametrize("name", ["velocity noise", "force noise", "pulses"])
def test_fewer_starts_are_the_first_with_the_same_noise_and_pushes(name: str) -> None:
    few, many = Recorder(), Recorder()
    task = task_of("swing-up", 0.5)
    for law, starts in ((few, 2), (many, 5)):
        perturbations.evaluate(law, task, BY_NAME[name], starts, seed=3)
    rows = 2 * len(BY_NAME[name].levels)
    assert_array_equal(np.stack(few.seen), np.stack(many.seen)[:, :rows])


def test_all_levels_of_a_start_begin_at_the_same_state_and_another_seed_elsewhere() -> None:
    first = [Recorder(), Recorder()]
    for law, seed in zip(first, (0, 1), strict=True):
        perturbations.evaluate(law, TASK, BY_NAME["response"], 3, seed)
    levels = len(BY_NAME["response"].levels)
    one, other = (law.seen[0].reshape(3, levels, 6) for law in first)
    assert_array_equal(one, np.broadcast_to(one[:, :1], one.shape))
    assert not np.isin(one[..., 1], other[..., 1]).any()


def test_the_nominal_level_is_a_plain_simulation() -> None:
    task = task_of("balance")
    starts = task.starts(np.random.default_rng([5, 1]), 20, RIG)
    law = BangBang(LQR(RIG), 40.0)
    plain = dpend.simulate_many(RIG, law, starts, task=task, seed=5).success
    assert 0 < plain.mean() < 1
    assert_array_equal(perturbations.evaluate(law, task, NOMINAL, 20, 5)[:, 0], plain)
    # An axis at its nominal level changes nothing either.
    for axis in (*AXES, *SENSORS):
        rig = RIG.replace(**axis.changes(np.array(1e-12 if axis.name == "encoders" else 0.0)))
        x, forces = np.array([[0.1, 0.2, -0.3, 0.4, 0.5, -0.6]]), np.array([7.0])
        moved, same = Stepper(rig, 1), Stepper(RIG, 1)
        moved.reset(x)
        same.reset(x)
        assert_allclose(moved.step(forces), same.step(forces), rtol=0, atol=2e-3 if axis.group == "sensors" else 1e-12)


def test_fewer_plants_are_the_first() -> None:
    many = perturbations.plants(64, seed=2)
    for name, values in perturbations.plants(16, seed=2).items():
        assert_array_equal(values, many[name][:16])


# ---------------------------------------------------------------------------------------- perturbations are as they say


def test_a_response_of_k_moves_the_force_by_k_of_what_is_missing() -> None:
    response = np.array([0.1, 0.4, 0.9, 1.0])
    stepper = Stepper(RIG.replace(actuator_lag=perturbations.lag(response)), 4)
    stepper.reset(np.zeros((4, 6)))
    force = np.zeros(4)
    for wanted in (10.0, -20.0, 5.0):
        stepper.step(np.full(4, wanted))
        force = force + response * (wanted - force)
        assert_allclose(stepper.force, force, rtol=1e-12)


def test_one_wrong_parameter_leaves_the_others_where_they_were() -> None:
    believed = perturbations._resolved(RIG.params)
    for name in PARAMETERS:
        found = perturbations._resolved(RIG.replace(**BY_NAME[name].changes(np.array(0.25))).params)
        assert found == pytest.approx(believed | {name: 1.25 * believed[name]})


def test_frictions_are_never_negative_and_end_at_their_greatest() -> None:
    for name, most in FRICTIONS.items():
        assert min(BY_NAME[name].levels) > 0
        assert BY_NAME[name].levels[-1] == pytest.approx(most)


def test_pulses_are_apart_within_the_run_and_as_large_as_the_level() -> None:
    pulses = Pulses(50, seed=0)
    moments = np.sort(pulses.moments.reshape(50, 6), axis=1)
    assert np.diff(moments, axis=1).min() >= 1.0
    assert 1.0 <= moments.min() <= moments.max() <= 9.0
    push = pulses.pushing(np.array([0.5, 1.0]))
    t = pulses.moments[7, 2, 0]  # a push on link 2 at its height, all others at least ten widths away
    on_links = push(float(t)).reshape(50, 2, 3)[7]
    assert_allclose(on_links, np.outer([0.5, 1.0], [0, 0, 5.0 * pulses.signs[7, 2, 0]]), atol=1e-9)


def test_plants_stay_within_a_fifth_and_cover_it_evenly() -> None:
    n = 256
    drawn = perturbations.plants(n, seed=1)
    known = {name: float(getattr(RIG.params, name)) for name in ("cart_mass", "mass1", "mass2", "length1", "length2")}
    shares = {name: (drawn[name] / value - 0.8) / 0.4 for name, value in known.items()}
    shares["force_limit"] = (drawn["force_limit"] / 40.0 - 0.8) / 0.4
    shares |= {f"com{k}": (drawn[f"com{k}"] / drawn[f"length{k}"] - 0.4) / 0.2 for k in "12"}
    shares |= {name: drawn[name] / most for name, most in FRICTIONS.items()}
    assert set(shares) == set(drawn) == set(UNCERTAIN)
    for share in shares.values():  # of a Sobol sequence each interval of 1/n holds exactly one
        assert_array_equal(np.sort(np.floor(share * n * (1 - 1e-12))), np.arange(n))


def test_on_every_plant_a_sample_passes_without_a_fall() -> None:
    found = perturbations.evaluate_on_plants(Zero(), task_of("balance", 0.02), 16, 2, seed=0)
    assert_array_equal(found, np.ones((16, 2)))


def test_behind_sensors_the_state_is_measured_rates_too_or_positions_alone() -> None:
    (noise,) = (axis for axis in SENSORS if axis.name == "noise")
    positions, exact = [], []
    for view, seen in (("differences", positions), ("rates measured", exact)):
        law = Recorder()
        perturbations.evaluate_with_sensors(law, task_of("swing-up", 0.1), noise, view, 3, seed=0)
        seen += law.seen[:2]  # at the first level
    assert (positions[0][:, 3:] == 0).all()
    assert_array_equal(positions[1][:, 3:], (positions[1] - positions[0])[:, :3] / RIG.sample_time)
    assert_array_equal(positions[1][:, :3], exact[1][:, :3])  # the same noise
    stepper = Stepper(RIG, 3)
    stepper.reset(task_of("swing-up").starts(np.random.default_rng([0, 1]), 3, RIG))
    assert_array_equal(exact[1][:, 3:], stepper.step(np.zeros(3))[:, 3:])


# --------------------------------------------------------------------------------------------------------------- scores


def outcomes(value: float | Array, starts: int = 20) -> dict[str, Array]:
    """Return outcomes with the same success everywhere."""
    return {axis.name: np.broadcast_to(value, (starts, len(axis.levels))) for axis in (NOMINAL, *AXES)}


def test_without_failure_the_score_is_one_and_without_success_nought() -> None:
    assert perturbations.score(outcomes(1.0)).value == perturbations.realaigym(outcomes(1.0)) == 1.0
    assert perturbations.score(outcomes(0.0)).value == perturbations.realaigym(outcomes(0.0)) == 0.0
    assert perturbations.score(perturbations.measure(Zero(), "balance", starts=2)).value == 0.0


def test_the_score_weighs_the_six_axes_alike_and_leaves_the_nominal_level_out() -> None:
    found = outcomes(0.0) | {"delay": np.ones((20, 2)), NOMINAL.name: np.ones((20, 1))}
    assert perturbations.score(found).value == pytest.approx(1 / 6)
    assert len(GROUPS) == 6
    # RealAIGym counts the nominal level as one of 21 where it has it.
    assert perturbations.realaigym(found) == pytest.approx((3 / 21 + 1) / 6)


def test_starts_that_differ_widen_the_interval_of_the_score() -> None:
    half = np.repeat([[0.0], [1.0]], 10, axis=0)
    alike = outcomes(0.0) | {name: np.ones((20, len(BY_NAME[name].levels))) for name in ("delay", "pulses", "response")}
    spread, narrow = perturbations.score(outcomes(half)), perturbations.score(alike)
    assert spread.value == narrow.value == pytest.approx(0.5)
    assert spread.high - spread.low > 0.4 > 0.2 > narrow.high - narrow.low


def test_a_majority_decides_a_setting_and_pulses_weaker_than_theirs_do_not_count() -> None:
    found = outcomes(0.0)
    found["pulses"] = np.repeat([[0.0, 0, 0.6, 0.6, 0.4, 0.4]], 20, axis=0)
    assert perturbations.realaigym(found) == pytest.approx(0.5 / 6)


# ------------------------------------------------------------------------------------------------------------ the study


def table(found: dict[str, Array], contender: str = "LQR") -> Table:
    """Return the table of outcomes while balancing."""
    levels = {axis.name: axis.levels for axis in (NOMINAL, *AXES)} | {"-": tuple(range(16))}
    rows = [
        {"job": k, "contender": contender, "task": "balance", "part": "plants" if axis == "-" else "axes", "axis": axis,
         "view": "-", "level": level, "runs": len(of), "successes": int(of[:, i].sum())}
        for k, (axis, of) in enumerate(found.items())
        for i, level in enumerate(levels[axis])
    ]  # fmt: skip
    return Table(pd.DataFrame(rows), by_job={k: {"outcomes": of.astype(bool)} for k, of in enumerate(found.values())})


def test_the_table_keeps_every_start() -> None:
    rng = np.random.default_rng(0)
    drawn = {name: (rng.random(of.shape) < 0.7).astype(float) for name, of in outcomes(0.0).items()}
    found = robustness.outcomes_of(table(drawn), "LQR", "balance")
    assert found.keys() == drawn.keys()
    for name, of in drawn.items():
        assert_array_equal(found[name], of)
    assert robustness.score(table(drawn), "LQR", "balance") == perturbations.score(drawn)
    with pytest.raises(KeyError, match=re.escape("The table says nothing of 'SDRE' at the task 'balance'.")):
        robustness.score(table(drawn), "SDRE", "balance")


def test_the_tables_say_how_often_it_succeeds_and_where_it_breaks() -> None:
    found = outcomes(1.0) | {"delay": np.repeat([[1.0, 0.0]], 20, axis=0), "-": np.ones((4, 16))}
    with _figures.look():
        reported = robustness.report(table(found))
    scores, breaks, plants = map(markdown, reported.tables)
    assert "| LQR | balance | 2,000 | 100.0 | 100.0 | 100.0 | 100.0 | 100.0 | 50.0 | 100.0 | 91.7 [" in scores
    assert r"| LQR | balance | \> 25 | \> 0.5 | \> 7.3 | \> 0.9 | 1.5 [1.2, 1.8] | \> 1 |" in breaks
    assert "| LQR | balance | 16 | 100.0 [94.3, 100.0] | 100.0 | 100.0 |" in plants
    assert isinstance(reported.figures, dict)
    assert list(reported.figures) == ["", "_parameters", "_balance", "_plants"]


def test_success_breaks_where_half_of_the_starts_fail_on_either_side() -> None:
    found = outcomes(1.0) | {"com1": np.repeat([[0.0, 0, 0, 1, 1, 1]], 20, axis=0)}
    axis = BY_NAME["com1"]
    assert 0 < robustness.breaking(found, axis, -1).value < 0.08
    assert robustness.breaking(found, axis, 1).value == np.inf
    assert robustness.weakest(found)[:2] == ("com1", -1)
    assert robustness.breaking(outcomes(0.0), axis).value == -np.inf
    assert robustness._breaks(table(outcomes(0.0))).lines[0][2].text == "–"


def test_a_controller_of_ones_own_appears_in_every_part(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "class ByHand:\n    def start(self, n, rng):\n        return lambda t, y: y @ [-1, 150, -165, -2.5, 7, -29]\n"
    )
    options = robustness.Options(controller=(f"{tmp_path / 'mine.py'}:ByHand",), only=("LQR",), quick=True)
    jobs = [job for job in robustness.jobs(options) if (job.contender, job.task) == ("ByHand", "balance")]
    assert {job.part for job in jobs} == {"axes", "plants", "sensors"}
    assert all(job.own for job in jobs)
    pulses = robustness.run(next(job for job in jobs if job.axis == "pulses"))
    assert [(row["level"], row["runs"]) for row in pulses.rows] == [(level, 2) for level in BY_NAME["pulses"].levels]
    assert pulses.arrays["outcomes"].sum(axis=0).tolist() == [row["successes"] for row in pulses.rows]


def test_all_have_the_same_starts_but_nmpc_which_has_few_and_none_unless_asked() -> None:
    plain, whole = robustness.Options(), robustness.Options(all=True)
    names = [contender.name for contender in plain.contenders("swing-up")]
    assert "NMPC" not in names
    assert "NMPC" in [contender.name for contender in whole.contenders("swing-up")]
    assert "NMPC" in [contender.name for contender in robustness.Options(only=("NMPC",)).contenders("balance")]
    each = [find(name) for name in ("NMPC", "iLQR MPC", "LQR")]
    assert [plain.starts_of(contender) for contender in each] == [5, 100, 100]
    assert [plain.plants_of(contender) for contender in each] == [32, 256, 256]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"starts": 1}, "--starts must be at least 2; got 1."),
        ({"slow_starts": 0}, "--slow-starts must be at least 2; got 0."),
        ({"plants": 100}, "--plants must be a power of two, at least 16; got 100."),
    ],
)
def test_what_cannot_be_is_refused(options: dict[str, int], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        robustness.Options(**options)  # type: ignore[arg-type]


def test_the_study_of_lqr_has_more_runs_than_realaigyms() -> None:
    jobs = robustness.jobs(robustness.Options(only=("LQR",)))
    levels = {axis.name: len(axis.levels) for axis in (NOMINAL, *AXES)}
    assert sum(levels[job.axis] * job.starts for job in jobs if (job.part, job.task) == ("axes", "balance")) > 722
    assert len(set(jobs)) == len(jobs)


@pytest.mark.slow
def test_a_quick_study_draws_and_tabulates_everything(tmp_path: Path) -> None:
    _runner.main("studies.robustness", ["--quick", "--workers", "1", "--only", "LQR", "--out", str(tmp_path)])
    for added in ("", "_balance", "_parameters", "_plants", "_sensors"):
        assert (tmp_path / f"robustness{added}.png").stat().st_size > 10_000
    assert (tmp_path / "tables.md").read_text().count("| LQR | balance |") == 3 + len(SENSORS)
