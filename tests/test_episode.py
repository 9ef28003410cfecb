"""The rule of an episode: its scalar twin and the batch agree on every step of random trajectories."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import dpend
from dpend import episode, kernels
from dpend.episode import Rule, UprightClock, rule_of, samples_to_hold
from dpend.params import Array
from dpend.state import wrap_angle
from dpend.tasks import Balance, SwingUp

RIG = dpend.rig("gustafsson2016")
TASKS = [
    Balance(steps=40, state_weights=(0.3, 1.0, 2.0), failure_cost=7.0),
    Balance(steps=40, criterion="report", state_weights=(0.0, 1.0, 2.0)),
    SwingUp(steps=40, hold=0.12, upright_angle=0.8, state_weights=(1.0, 2.0, 3.0), failure_cost=2.0),
    SwingUp(steps=40, hold=0.1, upright_angle=1.5, target="down-up"),
]
TWINS: dict[str, tuple[Callable[..., Any], ...]] = {
    "in Python": (
        episode.status_code,
        episode.make_report_cost(wrap_angle),
        episode.make_links_upright(wrap_angle),
        episode.counted,
        episode.succeeded,
    ),
    "compiled": (
        kernels.status_code,
        kernels.report_cost,
        kernels.links_upright,
        kernels.counted,
        kernels.succeeded,
    ),
}


def walks(task: Balance | SwingUp, n: int) -> Array:
    """Return random walks ``(T + 1, n, 6)`` about the target that cross every bound, some with a NaN."""
    rng = np.random.default_rng(5)
    steps = rng.normal(size=(task.steps + 1, n, 6)) * [0.3, 0.25, 0.25, 1, 1, 1]
    x = np.cumsum(steps, axis=0)
    x[..., 1:3] += task.target_angles + 2 * np.pi * rng.integers(-1, 2, n)[:, None] * isinstance(task, SwingUp)
    x[task.steps // 2, :3, [0, 1, 4]] = [np.nan, np.inf, np.nan]
    return x


@pytest.mark.filterwarnings("ignore:invalid value encountered")  # of an infinite angle, which numpy says but numba not
@pytest.mark.parametrize("task", TASKS, ids=repr)
@pytest.mark.parametrize("twin", TWINS)
def test_the_scalar_twin_judges_every_step_as_the_batch_does(task: Balance | SwingUp, twin: str) -> None:
    status_code, report_cost, links_upright, counted, succeeded = TWINS[twin]
    rule = rule_of(task, RIG)
    x = walks(task, 60)
    clock = UprightClock(task, RIG, 60)
    clock.begin(x[0])
    held = [counted(-1, links_upright(tuple(row), rule.target, rule.upright_angle)) for row in x[0]]
    found = set()
    for states in x[1:]:
        codes = task.ended(states, RIG)
        costs = task.cost(states, codes)
        clock.tick(states)
        success = clock.success(codes)
        for i, row in enumerate(map(tuple, states.tolist())):
            code = status_code(row, rule.bounds)
            held[i] = counted(held[i], links_upright(row, rule.target, rule.upright_angle))
            assert code == codes[i]
            np.testing.assert_allclose(
                report_cost(row, code, rule.target, rule.weights, rule.failure_cost), costs[i], rtol=1e-14
            )
            assert not clock.asked or held[i] == clock.samples[i]
            found.add((code, bool(succeeded(code, held[i], rule.hold))))
            assert code != 0 or succeeded(code, held[i], rule.hold) == success[i]
    failures = {code for code, _ in found} - {0}
    assert len(failures) == {Balance: 4 if task == TASKS[0] else 3, SwingUp: 2}[type(task)]
    assert (0, True) in found
    assert ((0, False) in found) == isinstance(task, SwingUp)
    assert not {(code, True) for code in failures} & found


def test_a_rule_holds_what_its_task_asks_on_that_rig() -> None:
    assert rule_of(Balance(criterion="report", failure_cost=2), RIG) == Rule(
        bounds=(2.4, math.pi / 2, math.inf),
        target=(0.0, 0.0),
        upright_angle=math.inf,
        hold=0,
        weights=(0.0, 10.0, 10.0),
        failure_cost=2.0,
    )
    rule = rule_of(SwingUp(target="down-up", hold=0.5), RIG)
    assert (rule.bounds, rule.target) == ((2.4, math.inf, math.inf), (math.pi, 0.0))
    assert (rule.upright_angle, rule.hold) == (0.2, 25)


@pytest.mark.parametrize(("hold", "samples"), [(0.0, 0), (0.02, 1), (0.021, 2), (1.0, 50), (0.06, 3), (0.3, 15)])
def test_a_time_upright_is_the_least_number_of_samples_that_last_as_long(hold: float, samples: int) -> None:
    assert samples_to_hold(hold, 0.02) == samples


def test_links_that_are_up_at_the_start_have_been_up_for_no_time_yet() -> None:
    task = SwingUp(steps=5, hold=0.04)
    clock = UprightClock(task, RIG, 2)
    clock.begin(np.array([np.zeros(6), dpend.EQUILIBRIA["down-down"]]))
    assert clock.samples.tolist() == [0, -1]
    codes = np.zeros(2, dtype=np.uint8)
    for expected in ([False, False], [True, False], [True, True]):
        clock.tick(np.zeros((2, 6)))
        assert clock.success(codes).tolist() == expected
