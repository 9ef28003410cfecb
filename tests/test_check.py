"""The contract check catches each way in which a controller or a learner can break it, and says how to mend it."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import dpend
from controllers import LQR
from dpend.check import (
    CONTROLLER_CHECKS,
    LEARNER_CHECKS,
    ContractError,
    LearnerCheck,
    an_unreached_budget_changes_nothing,
    bad_budgets_are_refused,
    controller_checks,
    is_built_with_its_rig_first,
    mirrored_forces,
    missing_measurements_are_survived,
    progress_grows_to_one,
    same_seed_same_policy,
    snapshots_end_with_the_policy,
    stays_within_the_budget,
    the_curve_adds_up,
    whole_turns_change_nothing,
)
from dpend.controller import Act
from dpend.params import Array
from dpend.state import deviation
from rl import Cost, GainPolicy, Outcome, Training
from rl.training import Trail, samples_within
from tests.rigs import whole

RIG = dpend.rig("gustafsson2016")
FAST = RIG.replace(sample_time=0.002, force_limit=np.inf)
K = LQR(RIG).K[0]
UP = np.zeros(6)
TAUGHT = (whole_turns_change_nothing, missing_measurements_are_survived)


def by_hand(t: float, x: Array) -> float:
    return -float(K @ x)


class Good:
    """A linear law that keeps the contract: the last finite measurement of each row counts."""

    mirrored = True

    def start(self, n: int, rng: np.random.Generator) -> Act:
        last = np.zeros((n, 6))

        def act(t: float, y: Array) -> Array:
            finite = np.isfinite(y).all(axis=1)
            last[finite] = y[finite]
            return self.force(last, rng)

        return act

    def force(self, y: Array, rng: np.random.Generator) -> Any:
        return -deviation(y, UP) @ K


class OddlyStarted(Good):
    def start(self, n: int, generator: np.random.Generator) -> Act:  # type: ignore[override]
        return super().start(n, generator)


class NoLaw(Good):
    def start(self, n: int, rng: np.random.Generator) -> Any:
        return np.zeros(n)


class Column(Good):
    def force(self, y: Array, rng: np.random.Generator) -> Any:
        return -deviation(y, UP) @ K[:, None]


class Listed(Good):
    def force(self, y: Array, rng: np.random.Generator) -> Any:
        return super().force(y, rng).tolist()


class Infinite(Good):
    def force(self, y: Array, rng: np.random.Generator) -> Any:
        return super().force(y, rng) + np.inf


class Unseeded(Good):
    def force(self, y: Array, rng: np.random.Generator) -> Any:
        return super().force(y, rng) + np.random.default_rng().normal(size=len(y))


class Writing(Good):
    def start(self, n: int, rng: np.random.Generator) -> Act:
        act = super().start(n, rng)

        def writing(t: float, y: Array) -> Array:
            y[:, 1:3] = deviation(y, UP)[:, 1:3]
            return act(t, y)

        return writing


class Sharing(Good):
    def start(self, n: int, rng: np.random.Generator) -> Act:
        act, u = super().start(n, rng), np.zeros(n)

        def smoothed(t: float, y: Array) -> Array:
            u[:] = 0.5 * u + 0.5 * act(t, y)
            return u

        return smoothed


class Remembering(Good):
    def __init__(self) -> None:
        self.u = 0.0

    def start(self, n: int, rng: np.random.Generator) -> Act:
        act = super().start(n, rng)
        self.u = 0.0

        def smoothed(t: float, y: Array) -> Array:
            self.u = 0.5 * self.u + 0.5 * act(t, y)
            return self.u

        return smoothed


class Averaging(Good):
    def force(self, y: Array, rng: np.random.Generator) -> Any:
        return super().force(y - y.mean(axis=0) + y[0], rng)


class Holding(Good):
    def __init__(self) -> None:
        self.law = lambda y: -deviation(y, UP) @ K


class Forgetful(Good):
    gain = 1.0

    def __init__(self) -> None:
        self.gain = 2.0

    def __getstate__(self) -> None:
        return None

    def force(self, y: Array, rng: np.random.Generator) -> Any:
        return self.gain * super().force(y, rng)


class Falling(Good):
    def force(self, y: Array, rng: np.random.Generator) -> Any:
        return -1e4 * super().force(y, rng)


class Raw(Good):
    def force(self, y: Array, rng: np.random.Generator) -> Any:
        return -y @ K


class Trusting(Good):
    def start(self, n: int, rng: np.random.Generator) -> Act:
        return lambda t, y: self.force(y, rng)


class Poisoned(Good):
    def start(self, n: int, rng: np.random.Generator) -> Act:
        u = np.zeros(n)

        def smoothed(t: float, y: Array) -> Array:
            nonlocal u
            u = 0.5 * u + 0.5 * self.force(y, rng)
            return u.copy()

        return smoothed


class Offset(Good):
    def force(self, y: Array, rng: np.random.Generator) -> Any:
        return super().force(y, rng) + 1.0


class Slow(Good):
    def force(self, y: Array, rng: np.random.Generator) -> Any:
        began = time.thread_time()
        while time.thread_time() - began < 0.0025:
            pass
        return super().force(y, rng)


CONTROLLERS: dict[type[Good], tuple[str, str]] = {
    OddlyStarted: ("start_takes_n_and_rng", r"start takes \(n, generator\)\. Write it as start\(self, n, rng\)\."),
    NoLaw: ("start_takes_n_and_rng", r"start\(n, rng\) returned array\(\[0\.\]\)\. Return the law, a function act.+"),
    Column: ("one_finite_force_a_row", r"Expected one force .+ returns a column: take \[:, 0\]\. .+"),
    Listed: ("one_finite_force_a_row", r"The forces are list\. Return np\.asarray\(forces, dtype=np\.float64\)\."),
    Infinite: ("one_finite_force_a_row", r"The forces are \[inf\] on the measurements \[\[.+\]\], all finite\."),
    Unseeded: (
        "same_seed_same_forces",
        r"The forces differ by .+ same seed\. Draw from the rng given to start alone.+",
    ),
    Writing: ("measurements_stay_as_they_are", r"The law writes to the measurements, .+\. Work on y\.copy\(\)\."),
    Sharing: ("forces_are_the_callers", r"The forces differ .+ written to .+: return a copy of it\."),
    Remembering: ("fresh_memory_in_each_run", r"The forces differ .+ at once\. Keep what .+ in variables of start.+"),
    Averaging: ("rows_are_independent", r"The forces differ .+ batch\. Take each from its own row of y, axis 0.+"),
    Holding: ("goes_to_other_processes", r"It cannot be pickled.+AttributeError.+<lambda>.+\. Define it at the top .+"),
    Forgetful: ("goes_to_other_processes", r"The forces differ .+ pickled\. Let .+__getstate__.+"),
    Falling: ("drives_the_rig", r"From 0\.02 rad it does not last three samples: .+ Look at the sign .+"),
    Raw: (
        "whole_turns_change_nothing",
        r"The forces differ .+ whole turns\. Take angles to the nearest turn, dpend\..+",
    ),
    Trusting: ("missing_measurements_are_survived", r"The force is not finite where a measurement is NaN\. Let the .+"),
    Poisoned: ("missing_measurements_are_survived", r".+ is NaN and stays so once all is measured again\. Let the .+"),
    Slow: ("a_step_takes_less_than_a_sample", r"A step takes 2\.\d* ms, longer than a sample, 2 ms\. Compute in .+"),
    Offset: (
        "mirrored_forces",
        r"The forces differ by up to 2 N .+\. Take out what knows a side, such as an offset, .+",
    ),
}
"""What breaks a check, the check, and its message."""


def test_what_keeps_the_contract_passes_all_checks() -> None:
    dpend.check_controller(Good(), RIG)
    dpend.check_controller(LQR(RIG), "gustafsson2016")
    for check in controller_checks(Good()):
        check(Good(), RIG)


@pytest.mark.parametrize("broken", CONTROLLERS)
def test_a_controller_that_breaks_the_contract_is_caught_with_the_remedy(broken: type[Good]) -> None:
    name, message = CONTROLLERS[broken]
    with pytest.raises(ContractError) as caught:
        dpend.check_controller(broken(), FAST)
    failures = caught.value.failures
    assert next(iter(failures)) == name
    assert re.fullmatch(message, failures[name], re.DOTALL)
    listed = "".join(f"\n  {check}: {failure}" for check, failure in failures.items())
    assert str(caught.value) == f"{broken.__name__} fails {len(failures)} of 13 checks.{listed}"


def test_every_check_is_seen_to_fail() -> None:
    checks = {check.__name__ for check in (*CONTROLLER_CHECKS, mirrored_forces, *LEARNER_CHECKS)}
    assert {name for name, _ in CONTROLLERS.values()} | {check.__name__ for _, check, _ in LEARNERS} == checks


def test_a_law_that_claims_no_mirror_need_not_have_one_and_any_check_may_be_left_out() -> None:
    assert mirrored_forces not in controller_checks(LQR(RIG))
    dpend.check_controller(Raw(), RIG, skip=["whole_turns_change_nothing"])
    with pytest.raises(ValueError, match=whole("There is no check 'mirror_forces'. Did you mean 'mirrored_forces'?")):
        dpend.check_controller(Good(), RIG, skip=["mirror_forces"])


def test_a_plain_function_is_checked_as_a_controller_and_what_is_none_is_refused() -> None:
    with pytest.raises(ContractError) as caught:
        dpend.check_controller(by_hand, RIG)
    assert list(caught.value.failures) == ["whole_turns_change_nothing", "missing_measurements_are_survived"]
    with pytest.raises(TypeError, match=whole("Expected a controller object; got the class Good. Call it first.")):
        dpend.check_controller(Good, RIG)  # type: ignore[arg-type]
    several = RIG.replace(track_limit=np.ones(2))
    with pytest.raises(ValueError, match=r"^check_controller takes one plant; got a rig of 2 rows\. .+"):
        dpend.check_controller(Good(), several)


def test_what_a_law_raises_is_among_the_failures_and_stays_the_cause() -> None:
    def broken(t: float, x: Array) -> float:
        raise OSError("the wire broke")

    with pytest.raises(ContractError) as caught:
        dpend.check_controller(broken, RIG)
    assert caught.value.failures["one_finite_force_a_row"] == "It raised OSError: the wire broke"
    assert isinstance(caught.value.__cause__, OSError)


# ------------------------------------------------------------------------------------------------------------- learners


@dataclass(frozen=True)
class Search:
    """Gains drawn about a good one, the last of which is kept."""

    rig: Any
    task: Any = field(default_factory=lambda: dpend.Balance(steps=10))

    def __post_init__(self) -> None:
        if isinstance(self.rig, str):
            object.__setattr__(self, "rig", dpend.rig(self.rig))

    def train(self, seed: Any, *, seconds: Any = None, progress: Any = None) -> Training:
        h, rng = self.rig.sample_time, np.random.default_rng(seed)
        episodes = min(3, samples_within(seconds, h) // self.task.steps)
        lengths, gains, report = [], [K], progress or (lambda share: None)
        for episode in range(episodes):
            report(episode / episodes)
            gains.append(K * rng.uniform(0.9, 1.1, 6))
            x0 = self.task.starts(rng, 1, self.rig)[0]
            lengths.append(dpend.simulate(self.rig, GainPolicy(gains[-1]), x0, task=self.task).u.size)
        report(1.0)
        spent = h * np.cumsum(lengths)
        return Training(
            policy=GainPolicy(gains[-1]),
            outcome=Outcome.BUDGET_SPENT,
            cost=Cost(episodes=episodes, steps=sum(lengths), sample_time=h, cpu_seconds=0.0),
            curve={"experience": spent, "length": np.array(lengths, int)},
            trail=Trail(spent, gains[1:], GainPolicy),
        )


def changed(change: Callable[..., Training]) -> type[Search]:
    """Return a learner whose training is changed by a function of the training that it should return."""

    class Changed(Search):
        def train(self, seed: Any, *, seconds: Any = None, progress: Any = None) -> Training:
            return change(super().train(seed, seconds=seconds, progress=progress))

    return Changed


def asked(ask: Callable[..., Any]) -> type[Search]:
    """Return a learner that trains by other arguments than those that it was given."""

    class Asked(Search):
        def train(self, seed: Any, *, seconds: Any = None, progress: Any = None) -> Training:
            return super().train(
                **({"seed": seed, "seconds": seconds, "progress": progress} | ask(seed, seconds, progress))
            )

    return Asked


class OtherArguments(Search):
    def train(self, seed: Any, seconds: Any = None) -> Training:  # type: ignore[override]
        return super().train(seed, seconds=seconds)


class OtherRig(Search):
    def __post_init__(self) -> None:
        object.__setattr__(self, "rig", dpend.rig("bogdanov2004"))


class Unequal(Search):
    def __eq__(self, other: object) -> bool:
        return self is other


class Endless:
    def start(self, n: int, rng: np.random.Generator) -> Act:
        return lambda t, y: np.full(n, np.nan)


def cost(training: Training, **other: Any) -> Training:
    return replace(training, cost=replace(training.cost, **other))


def curve(training: Training, **columns: Any) -> Training:
    return replace(training, curve={**training.curve, **columns})


def backwards(training: Training) -> Training:
    experience, gains, policy = training.trail or Trail(np.zeros(0), [], GainPolicy)
    return replace(training, trail=Trail(experience[::-1], gains, policy))


def refuse(seed: Any, seconds: Any, progress: Any) -> dict[str, Any]:
    if seconds is not None and not isinstance(seconds, float):
        raise TypeError("not a float")
    return {}


LEARNERS: list[tuple[Any, LearnerCheck, str]] = [
    (lambda rig: SimpleNamespace(rig=rig), is_built_with_its_rig_first, "It has no task and no train. Give it all .+"),
    (OtherArguments, is_built_with_its_rig_first, r"train takes \(seed, seconds\)\. Write train\(self, seed, \*, .+"),
    (OtherRig, is_built_with_its_rig_first, r"Its rig is not .+\. Turn a preset's name into a rig .+"),
    (Unequal, is_built_with_its_rig_first, "Built twice, from one rig, it is not equal. Make it a frozen dataclass .+"),
    (
        asked(lambda *_: {"seed": None}),
        same_seed_same_policy,
        "The same seed learned another policy. Draw everything .+",
    ),
    (asked(lambda *_: {"seed": 0}), same_seed_same_policy, "Another seed learned the same policy. Draw everything .+"),
    (asked(lambda *_: {"seconds": None}), stays_within_the_budget, r"Allowed 0\.02 s it had 0\.6 s\. End episodes .+"),
    (
        changed(lambda done: cost(done, sample_time=0.01)),
        stays_within_the_budget,
        "It had .+ s by its experience, .+ s by its cost. Count .+",
    ),
    (changed(lambda done: replace(done, policy=Endless())), stays_within_the_budget, "The policy's forces are not .+"),
    (
        asked(lambda seed, seconds, _: {"seed": seed + 1 if seconds else seed}),
        an_unreached_budget_changes_nothing,
        "A budget that is not reached changes the training. Let seconds end it .+",
    ),
    (asked(lambda *_: {"progress": None}), progress_grows_to_one, "Progress was nothing. Report shares .+"),
    (
        asked(lambda *given: {"progress": lambda share: given[2](1 - share)}),
        progress_grows_to_one,
        r"Progress was \[1.+\] to \[.+0\.0\]\. Report shares that grow from 0 to 1, .+",
    ),
    (asked(lambda *_: {"seconds": None}), bad_budgets_are_refused, r"A budget of 0\.0 s was accepted\. Raise .+"),
    (asked(refuse), bad_budgets_are_refused, "A budget of '1' s was met with TypeError: not a float. Raise .+"),
    (changed(lambda done: curve(done, length=np.ones(2))), the_curve_adds_up, "The curve has columns of lengths .+"),
    (
        asked(lambda *_: {"seconds": 0.02}),
        the_curve_adds_up,
        "No episode ended within 2 s. Check with more seconds, .+",
    ),
    (
        changed(lambda done: curve(done, experience=np.ones(3))),
        the_curve_adds_up,
        r"The curve's experience is not .+\. Write sample_time \* np\.cumsum.+",
    ),
    (changed(lambda done: cost(done, steps=1)), the_curve_adds_up, "The cost has -29 samples more than the curve. .+"),
    (
        changed(lambda done: cost(done, test_steps=7)),
        the_curve_adds_up,
        "The curve has 0 tested samples, the cost 7. .+",
    ),
    (
        changed(
            lambda done: cost(
                curve(
                    done, length=np.array([10, 10, 9]), success=np.ones(3, bool), experience=np.array([0.2, 0.4, 0.58])
                ),
                steps=29,
            )
        ),
        the_curve_adds_up,
        "An episode is called a success that ended early. .+",
    ),
    (
        changed(backwards),
        snapshots_end_with_the_policy,
        r"snapshots\(5\) have the experience \[0\.6.+ Return at most .+",
    ),
    (
        changed(lambda done: replace(done, policy=GainPolicy(K))),
        snapshots_end_with_the_policy,
        "The last snapshot is not the final policy. Record .+",
    ),
]
"""What breaks a check, the check, and its message."""


@pytest.mark.parametrize("learner", [Search, Search(RIG), lambda rig: Search(rig)], ids=["class", "object", "factory"])
def test_a_learner_that_keeps_the_contract_passes_all_checks(learner: Any) -> None:
    dpend.check_learner(learner, seconds=2.0)


@pytest.mark.parametrize(("broken", "check", "message"), LEARNERS)
def test_a_learner_that_breaks_the_contract_is_caught_with_the_remedy(
    broken: Any, check: LearnerCheck, message: str
) -> None:
    with pytest.raises(ContractError, match=f"^{message}$"):
        check(broken, "gustafsson2016", 2.0)


def test_all_that_a_learner_fails_is_listed_and_what_is_none_is_refused() -> None:
    with pytest.raises(
        ContractError, match=r"^Unequal fails 1 of 7 checks\.\n  is_built_with_its_rig_first: Built twice"
    ):
        dpend.check_learner(Unequal, seconds=2.0, skip=["progress_grows_to_one"])
    message = "A learner has a method train(seed, *, seconds, progress); int has none."
    with pytest.raises(TypeError, match=whole(message)):
        dpend.check_learner(3)
    with pytest.raises(ValueError, match=whole("seconds must be finite and greater than 0 s; got 0.")):
        dpend.check_learner(Search, seconds=0)


# ---------------------------------------------------------------------------------------------------------- the command

OWN = """
import numpy as np

class ByHand:
    def start(self, n, rng):
        return lambda t, y: y @ [-1, 150, -165, -2.5, 7, -29]

def built(rig):
    return ByHand()
"""


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (
            ["mine.py:ByHand", "--skip", *(check.__name__ for check in TAUGHT)],
            0,
            "ByHand keeps its contract on pilco2011.\n",
        ),
        (["mine.py:built"], 1, "ByHand fails 2 of 12 checks.\n  whole_turns_change_nothing: The forces differ"),
        (["mine.py:Nothing"], 2, "there is no 'Nothing' in mine.py"),
    ],
)
@pytest.mark.slow
def test_the_command_checks_what_is_in_a_file(tmp_path: Path, arguments: list[str], code: int, said: str) -> None:
    (tmp_path / "mine.py").write_text(OWN)
    command = [sys.executable, "-W", "error", "-m", "dpend.check", *arguments, "--rig", "pilco2011"]
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parent.parent)}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == code
    assert said in done.stdout + done.stderr
