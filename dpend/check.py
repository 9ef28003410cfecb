r"""Whether a controller or a learner keeps the contract of all of them; where not, what is wrong and how to mend it.

Each check is a function of its own, so that pytest can go through them::

    @pytest.mark.parametrize("check", dpend.check.controller_checks(ByHand()))
    def test_contract(check):
        check(ByHand(), dpend.rig("gustafsson2016"))

``python -m dpend.check mine.py:ByHand --rig gustafsson2016`` goes through them for a controller or learner in a file.
"""

from __future__ import annotations

import argparse
import inspect
import sys
import time
from collections.abc import Callable, Collection, Iterable
from dataclasses import is_dataclass, replace
from importlib import import_module
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np

from .arguments import checked_positive
from .controller import Act, Controller, Law, as_controller, is_batched, name_of
from .params import Array
from .rig import Rig, as_rig, single_rig
from .simulate import simulate_many
from .stepper import CONTROLLER_STREAM, Stepper, checked_forces, row_sequence
from .suggest import suggestion
from .tasks import Balance


class ContractError(AssertionError):
    """What a controller or learner does not keep of its contract; the message says what is wrong and how to mend it.

    Attributes
    ----------
    failures : dict of str to str
        The messages, by the names of the checks; empty where a check was called by itself.
    """

    def __init__(self, message: str, failures: dict[str, str] | None = None) -> None:
        super().__init__(message)
        self.failures = failures or {}


def check_controller(controller: Controller | Law, rig: Rig | str, *, skip: Collection[str] = ()) -> None:
    """Check that a controller keeps the contract of all controllers, on a rig; return nothing where it does.

    Each check is a function of ``dpend.check``, and says in its message how to mend what it found.

    Parameters
    ----------
    controller : Controller or callable
        The controller; a plain function ``law(t, x)`` of one state ``(6,)`` will do.
    rig : Rig or str
        The rig that it was made for, or the name of a preset.
    skip : collection of str
        Names of checks to leave out.

    Raises
    ------
    TypeError, ValueError
        If an argument is wrong: what came is no controller, or there is no such check.
    ContractError
        If a check fails; it names all that do, in an order in which the first is often the cause of others.

    See Also
    --------
    dpend.check.controller_checks : One test a check.

    Examples
    --------
    >>> import dpend
    >>> rig = dpend.rig("gustafsson2016")
    >>> from controllers import LQR
    >>> dpend.check_controller(LQR(rig), rig)
    """
    made = as_controller(controller)
    _hold(name_of(made), controller_checks(controller), skip, made, single_rig(rig, "check_controller"))


def check_learner(
    learner: Any, rig: Rig | str | None = None, *, seconds: float = 100.0, skip: Collection[str] = ()
) -> None:
    """Check that a learner keeps the contract of all learners, ``rl.Learner``; return nothing where it does.

    Some checks train until the learner's own budget is spent, so give one with a small budget; of one with a setting
    ``max_episodes`` this is lowered for them.

    Parameters
    ----------
    learner : Learner or callable
        The learner; or what builds it from a rig or the name of a preset, such as its class, which is checked too.
    rig : Rig or str, optional
        The rig to learn on, or the name of a preset; left out, the learner's own, or ``"gustafsson2016"`` for a class.
    seconds : float
        Greatest experience of most trainings, s of the plant's time: enough for an episode at least.
    skip : collection of str
        Names of checks to leave out.

    Raises
    ------
    TypeError, ValueError
        If an argument is wrong: what came is no learner, or there is no such check.
    ContractError
        If a check fails; it names all that do.

    See Also
    --------
    dpend.check_controller : The same of a controller.

    Examples
    --------
    >>> import dpend
    >>> rig = dpend.rig("gustafsson2016")
    >>> from rl import LSPI
    >>> dpend.check_learner(LSPI(rig))  # doctest: +SKIP
    """
    checked_positive("seconds", seconds, "s")
    alone = hasattr(learner, "train") and not isinstance(learner, type)
    if not (alone or callable(learner)):
        raise TypeError(f"A learner has a method train(seed, *, seconds, progress); {type(learner).__name__} has none.")
    chosen: Any = rig or (getattr(learner, "rig", None) if alone else None) or "gustafsson2016"
    as_rig(chosen)
    _hold(getattr(learner, "__name__", type(learner).__name__), LEARNER_CHECKS, skip, learner, chosen, seconds)


def _hold(name: str, checks: Iterable[Callable[..., None]], skip: Collection[str], *arguments: Any) -> None:
    """Go through checks and raise one error for all that fail, from the first that came from outside."""
    named = {check.__name__: check for check in checks}
    if isinstance(skip, str) or not isinstance(skip, Collection):
        raise TypeError(f"skip must be a list of names of checks; got {skip!r}.")
    for each in skip:
        if not (isinstance(each, str) and each in named):
            raise ValueError(f"There is no check {each!r}.{suggestion(str(each), named)}")
    failures: dict[str, str] = {}
    cause: Exception | None = None
    for each, check in named.items():
        try:
            if each not in skip:
                check(*arguments)
        except ContractError as error:
            failures[each] = str(error)
        except Exception as error:  # what a user's code raises is its own affair
            failures[each], cause = f"It raised {type(error).__name__}: {error}", cause or error
    if failures:
        listed = "".join(f"\n  {each}: {message}" for each, message in failures.items())
        message = f"{name} fails {len(failures)} of {len(named) - len(skip)} checks.{listed}"
        raise ContractError(message, failures) from cause


def _require(kept: object, message: str) -> None:
    if not kept:
        raise ContractError(message)


# ---------------------------------------------------------------------------------------------------------- controllers


def measurements(n: int, samples: int = 4, seed: int = 0) -> Array:
    """Return measurements ``(samples, n, 6)`` from near upright."""
    return 0.1 * np.random.default_rng(seed).standard_normal((samples, n, 6))


def motion(n: int, samples: int = 6) -> Array:
    """Return measurements ``(samples, n, 6)`` that go on as a plant does: jumps magnify rounding."""
    first = measurements(n, 1)
    return first + 0.01 * np.cumsum(measurements(n, samples, 1), axis=0)


def turned(y: Array) -> Array:
    """Return measurements ``(samples, n, 6)`` with other whole turns at each."""
    other = y.copy()
    other[..., 1:3] += 2 * np.pi * np.random.default_rng(4).integers(-3, 4, (*y.shape[:2], 2))
    return other


def answers(controller: Controller | Law, rig: Rig, y: Array, seed: int = 1, first_row: int = 0) -> Array:
    """Return the forces ``(samples, n)`` of a fresh run on measurements ``(samples, n, 6)``, rows numbered so."""
    act = _started(controller, y.shape[1], seed, first_row)
    return np.array([np.array(act(rig.sample_time * k, row.copy())) for k, row in enumerate(y)])


def _started(controller: Controller | Law, n: int, seed: int = 1, first_row: int = 0) -> Act:
    rng = np.random.default_rng(row_sequence(seed, first_row, CONTROLLER_STREAM))  # as simulations begin
    return as_controller(controller).start(n, rng)


def _sizes(controller: Controller | Law) -> tuple[int, ...]:
    return (1, 5) if is_batched(as_controller(controller)) else (1,)


def _agree(found: Array, expected: Array, tolerance: float, where: str, remedy: str) -> None:
    with np.errstate(invalid="ignore"):
        off = float(np.abs(np.subtract(found, expected)).max())
    _require(off <= tolerance, f"The forces differ by up to {off:.3g} N {where}. {remedy}")


def _rounding(forces: Array) -> float:
    """Return the rounding of a turn, which an unstable plant magnifies, N."""
    return 1e-6 * max(1.0, float(np.abs(forces).max()))


def start_takes_n_and_rng(controller: Controller | Law, rig: Rig) -> None:  # noqa: ARG001  # called as all are
    """Check that ``start(n, rng)`` is what makes a law."""
    made = as_controller(controller)
    taken = ", ".join(inspect.signature(made.start).parameters)
    _require(taken == "n, rng", f"start takes ({taken}). Write it as start(self, n, rng).")
    act = _started(made, 1)
    _require(callable(act), f"start(n, rng) returned {act!r}. Return the law, a function act(t, y) -> forces.")


def one_finite_force_a_row(controller: Controller | Law, rig: Rig) -> None:
    """Check that ``n`` measurements are answered by ``n`` finite forces, an array of float64."""
    for n in _sizes(controller):
        act = _started(controller, n)
        for k, y in enumerate(measurements(n)):
            u: Any = act(rig.sample_time * k, y)
            try:
                checked_forces(u, n)
            except ValueError as error:
                raise ContractError(f"{error} The measurements have shape {y.shape}: sum over axis 1.") from error
            said = str(u.dtype) if isinstance(u, np.ndarray) else type(u).__name__
            _require(said == "float64", f"The forces are {said}. Return np.asarray(forces, dtype=np.float64).")
            _require(np.isfinite(u).all(), f"The forces are {u} on the measurements {y}, all finite.")


def same_seed_same_forces(controller: Controller | Law, rig: Rig) -> None:
    """Check that runs with the same generator and measurements have the same forces, to the last bit."""
    for n in _sizes(controller):
        one, other = (answers(controller, rig, measurements(n)) for _ in range(2))
        remedy = "Draw from the rng given to start alone, and make what the law remembers within start."
        _agree(one, other, 0.0, "between two runs with the same seed", remedy)


def measurements_stay_as_they_are(controller: Controller | Law, rig: Rig) -> None:
    """Check that the law does not write to the measurements."""
    for n in _sizes(controller):
        act = _started(controller, n)
        for k, y in enumerate(measurements(n)):
            kept = y.copy()
            y.setflags(write=False)
            try:
                act(rig.sample_time * k, y)
                wrote = not np.array_equal(y, kept)
            except ValueError as error:
                wrote = "read-only" in str(error)
                if not wrote:
                    raise
            _require(not wrote, "The law writes to the measurements, which the record keeps. Work on y.copy().")


def fresh_memory_in_each_run(controller: Controller | Law, rig: Rig) -> None:
    """Check that two runs of one object at once do not disturb each other."""
    for n in _sizes(controller):
        ys = [measurements(n, seed=seed) for seed in (2, 3)]
        acts = [_started(controller, n) for _ in ys]
        found = [[np.array(acts[i](rig.sample_time * k, ys[i][k])) for i in (0, 1)] for k in range(len(ys[0]))]
        remedy = "Keep what the law remembers in variables of start, not in the object, a default argument or a global."
        for i, y in enumerate(ys):
            expected = answers(controller, rig, y)
            _agree(np.array(found)[:, i], expected, 0.0, "where two runs go on at once", remedy)


def forces_are_the_callers(controller: Controller | Law, rig: Rig) -> None:
    """Check that the law still works where its caller writes to the forces that it returned."""
    for n in _sizes(controller):
        y = measurements(n)
        act = _started(controller, n)
        for k, expected in enumerate(answers(controller, rig, y)):
            u = act(rig.sample_time * k, y[k])
            remedy = "The law goes on using that array: return a copy of it."
            _agree(u, expected, 0.0, "once the caller has written to those returned before", remedy)
            if u.flags.writeable:
                u[:] = 1e6


def rows_are_independent(controller: Controller | Law, rig: Rig) -> None:
    """Check that a row of a batch has the forces that it has alone, or with others; one that draws, by its number."""
    if is_batched(as_controller(controller)):
        y = measurements(5)
        forces = answers(controller, rig, y)
        remedy = "Take each from its own row of y, axis 0, or write batched = False in the class."
        for first, end in ((2, 3), (1, 5)):
            found = answers(controller, rig, y[:, first:end], first_row=first)
            _agree(found, forces[:, first:end], 1e-9, "with the other rows of a batch", remedy)


def goes_to_other_processes(controller: Controller | Law, rig: Rig) -> None:
    """Check that it can be pickled, as it is for worker processes, and comes out as it went in."""
    try:
        restored = ForkingPickler.loads(ForkingPickler.dumps(as_controller(controller)))  # type: ignore[attr-defined]
    except Exception as error:  # what a class raises that cannot be sent is its own affair
        raise ContractError(
            f"It cannot be pickled, and so not sent to worker processes ({type(error).__name__}: {error}). Define it "
            "at the top level of a module, and make lambdas and open files within start instead of holding them."
        ) from error
    y = measurements(1)
    remedy = "Let the pickled state, __getstate__ or __reduce__, hold all that the law depends on."
    _agree(answers(restored, rig, y), answers(controller, rig, y), 0.0, "once it has been pickled", remedy)


def drives_the_rig(controller: Controller | Law, rig: Rig) -> None:
    """Check that it runs three samples near upright, with finite forces and without an end."""
    x0 = np.zeros((3, 6))
    x0[:, 1] = [0.01, -0.01, 0.02]
    runs = simulate_many(rig, controller, x0, 3 * rig.sample_time)
    ends = sorted({status.value for status, saved in zip(runs.status, runs.success, strict=True) if not saved})
    _require(not ends, f"From 0.02 rad it does not last three samples: {' '.join(ends)} Look at the sign of the force.")
    _require(np.isfinite(runs.u).all(), "A force was not finite. Divide by nothing that can be zero.")


def whole_turns_change_nothing(controller: Controller | Law, rig: Rig) -> None:
    """Check that angles that differ by whole turns are the same angles."""
    for n in _sizes(controller):
        y = motion(n)
        expected = answers(controller, rig, y)
        remedy = "Take angles to the nearest turn, dpend.state.deviation(y, target), or by sine and cosine."
        _agree(
            answers(controller, rig, turned(y)),
            expected,
            _rounding(expected),
            "where angles differ by whole turns",
            remedy,
        )


def missing_measurements_are_survived(controller: Controller | Law, rig: Rig) -> None:
    """Check that the force is finite while measurements are NaN or infinite, and afterwards."""
    for n in _sizes(controller):
        y = measurements(n, samples=8)
        y[0, 0, 1] = y[3, -1] = y[5, 0, 0] = np.nan
        y[4, 0, 4] = np.inf
        bad = np.flatnonzero(~np.isfinite(answers(controller, rig, y)).all(axis=1))
        after = " and stays so once all is measured again" if bad.size and bad[-1] > 5 else ""
        message = (
            f"The force is not finite where a measurement is NaN{after}. Let the last finite one of a row count: "
            "return dpend.laws.holding(n, act) from start."
        )
        _require(not bad.size, message)


def mirrored_forces(controller: Controller | Law, rig: Rig) -> None:
    """Check that mirrored measurements have mirrored forces: the law is odd, as ``mirrored = True`` claims."""
    for n in _sizes(controller):
        y = motion(n)
        expected = -answers(controller, rig, y)
        remedy = "Take out what knows a side, such as an offset, or the claim mirrored = True."
        _agree(answers(controller, rig, -y), expected, _rounding(expected), "from mirrored ones", remedy)


def a_step_takes_less_than_a_sample(controller: Controller | Law, rig: Rig) -> None:
    """Check that a step takes less processor time than a sample, on average over eight after the first."""
    plant, act, spent = Stepper(rig, 1, 0), _started(controller, 1), []
    y = plant.reset(np.array([0, 0.02, 0, 0, 0, 0]))
    for k in range(9):
        began = time.thread_time()  # which other programs do not lengthen
        u = act(rig.sample_time * k, y)
        spent.append(time.thread_time() - began)
        y = plant.step(u)
    mean = float(np.mean(spent[1:]))
    message = (
        f"A step takes {1e3 * mean:.3g} ms, longer than a sample, {1e3 * rig.sample_time:g} ms. Compute in start or "
        "__init__ what does not change, compile, or hold the force for several samples."
    )
    _require(mean <= rig.sample_time, message)


ControllerCheck = Callable[[Controller | Law, Rig], None]
CONTROLLER_CHECKS: tuple[ControllerCheck, ...] = (
    start_takes_n_and_rng,
    one_finite_force_a_row,
    same_seed_same_forces,
    measurements_stay_as_they_are,
    fresh_memory_in_each_run,
    forces_are_the_callers,
    rows_are_independent,
    goes_to_other_processes,
    drives_the_rig,
    whole_turns_change_nothing,
    missing_measurements_are_survived,
    a_step_takes_less_than_a_sample,
)
"""The checks of every controller."""


def controller_checks(controller: Controller | Law) -> tuple[ControllerCheck, ...]:
    """Return the checks that apply to a controller: those of all, and what it claims, ``mirrored = True``."""
    return (*CONTROLLER_CHECKS, mirrored_forces) if getattr(controller, "mirrored", False) else CONTROLLER_CHECKS


# ------------------------------------------------------------------------------------------------------------- learners


def _built(learner: Any, rig: Rig | str) -> Any:
    """Return a learner, which is built where its class or another factory came."""
    return learner if hasattr(learner, "train") and not isinstance(learner, type) else learner(rig)


def _short(learner: Any, episodes: int) -> Any:
    """Return the learner with fewer episodes, where it has such a setting."""
    if is_dataclass(learner) and hasattr(learner, "max_episodes"):
        return replace(learner, max_episodes=min(learner.max_episodes, episodes))  # type: ignore[type-var]
    return learner


def _content(policy: Any) -> dict[str, Any]:
    """Return what a policy consists of: its arrays, or where it shows none the forces that it answers with."""
    if hasattr(policy, "arrays"):
        return dict(policy.arrays())
    y = measurements(64 if is_batched(policy) else 1)[0]
    return {"forces": np.array(_started(policy, len(y))(0.0, y))}


def _equal(one: Any, other: Any) -> bool:
    one, other = _content(one), _content(other)
    return one.keys() == other.keys() and all(np.array_equal(one[name], other[name]) for name in one)


def is_built_with_its_rig_first(learner: Any, rig: Rig | str, seconds: float) -> None:  # noqa: ARG001
    """Check that it has ``rig``, ``task`` and ``train``, and is built alike from a rig and from a preset's name."""
    made = _built(learner, rig)
    missing = [name for name in ("rig", "task", "train") if not hasattr(made, name)]
    _require(not missing, f"It has no {' and no '.join(missing)}. Give it all three, as rl.Learner describes.")
    taken = inspect.signature(made.train).parameters
    remedy = "Write train(self, seed, *, seconds=None, progress=None)."
    _require({"seed", "seconds", "progress"} <= set(taken), f"train takes ({', '.join(taken)}). {remedy}")
    remedy = "Turn a preset's name into a rig where it is built: dpend.rig(name)."
    _require(made.rig == as_rig(rig), f"Its rig is not the one that it was built with. {remedy}")
    message = "Built twice, from one rig, it is not equal. Make it a frozen dataclass of plain values."
    _require(made is learner or made == _built(learner, as_rig(rig)), message)


def same_seed_same_policy(learner: Any, rig: Rig | str, seconds: float) -> None:
    """Check that a seed decides what is learned, to the last bit, and another leads elsewhere."""
    one, same, other = (_built(learner, rig).train(seed, seconds=seconds).policy for seed in ([3, 1], [3, 1], [3, 2]))
    remedy = "Draw everything from np.random.default_rng(seed) made within train, and keep nothing in the learner."
    _require(_equal(one, same), f"The same seed learned another policy. {remedy}")
    _require(not _equal(one, other), f"Another seed learned the same policy. {remedy}")


def stays_within_the_budget(learner: Any, rig: Rig | str, seconds: float) -> None:
    """Check that no training has more experience than it is allowed, and that its cost adds up to it."""
    for allowed in (0.01 * seconds, 0.3333 * seconds, seconds):
        made = _built(learner, rig)
        training = made.train(5, seconds=allowed)
        had = training.experience
        _require(had <= allowed, f"Allowed {allowed:g} s it had {had:g} s. End episodes and rounds with the budget.")
        cost = (training.cost.steps + training.cost.test_steps) * made.rig.sample_time
        _require(had == cost, f"It had {had:g} s by its experience, {cost:g} s by its cost. Count every sample once.")
        for name, array in _content(training.policy).items():
            good = np.asarray(array).dtype.kind not in "fc" or np.isfinite(array).all()
            _require(good, f"The policy's {name} are not finite. Return the last finite policy of a training.")


def an_unreached_budget_changes_nothing(learner: Any, rig: Rig | str, seconds: float) -> None:
    """Check that a training is the same without a budget and with one that is not reached."""
    made = _short(_built(learner, rig), 40)
    free, bounded = made.train(7), made.train(7, seconds=1e4 * seconds)
    same = _equal(free.policy, bounded.policy)
    same = same and free.cost.steps == bounded.cost.steps and free.outcome is bounded.outcome
    _require(same, "A budget that is not reached changes the training. Let seconds end it and decide nothing else.")


def progress_grows_to_one(learner: Any, rig: Rig | str, seconds: float) -> None:
    """Check that the share reported as spent never falls, lies within 0 and 1, and ends at 1."""
    for allowed in (None, seconds):
        shares: list[float] = []
        _short(_built(learner, rig), 300).train(0, seconds=allowed, progress=shares.append)
        good = shares == sorted(shares) and all(0.0 <= share <= 1.0 for share in shares) and shares[-1:] == [1.0]
        said = f"{shares[:3]} to {shares[-3:]}" if shares else "nothing"
        _require(good, f"Progress was {said}. Report shares that grow from 0 to 1, and progress(1.0) at the end.")


def bad_budgets_are_refused(learner: Any, rig: Rig | str, seconds: float) -> None:  # noqa: ARG001
    """Check that a budget that is no time is refused by a ValueError that names it, before anything runs."""
    for odd in (0.0, -1.0, np.nan, np.inf, "1"):
        said = "accepted"
        try:
            _built(learner, rig).train(0, seconds=odd)
        except Exception as error:  # whatever a user's learner trips over
            said = f"met with {type(error).__name__}: {error}"
            if isinstance(error, ValueError) and str(error).startswith("seconds must be") and repr(odd) in str(error):
                continue
        remedy = "Raise ValueError('seconds must be ...; got ...'), as rl.training.samples_within does."
        _require(False, f"A budget of {odd!r} s was {said}. {remedy}")


def the_curve_adds_up(learner: Any, rig: Rig | str, seconds: float) -> None:
    """Check that the curve has one entry an episode that ended, whose lengths add up to the cost."""
    made = _built(learner, rig)
    training = made.train(2, seconds=seconds)
    curve, cost = training.curve, training.cost
    lengths = {name: len(column) for name, column in curve.items()}
    message = f"The curve has columns of lengths {lengths} for {cost.episodes} episodes. Add an entry as each ends."
    _require({"experience", "length"} <= lengths.keys() and set(lengths.values()) == {cost.episodes}, message)
    _require(cost.episodes > 0, f"No episode ended within {seconds:g} s. Check with more seconds, or end episodes.")
    tested = curve.get("tested", np.zeros(cost.episodes, int))
    expected = made.rig.sample_time * np.cumsum(curve["length"] + tested)
    message = "The curve's experience is not the sum of its lengths. Write sample_time * np.cumsum(length + tested)."
    _require(np.allclose(curve["experience"], expected, rtol=1e-7, atol=0.0), message)
    under_way = cost.steps - int(curve["length"].sum())
    message = f"The cost has {under_way} samples more than the curve. Count each once, the last episode's too."
    _require(0 <= under_way < 1000, message)
    message = f"The curve has {tested.sum()} tested samples, the cost {cost.test_steps}. Add a column tested."
    _require(tested.sum() == cost.test_steps, message)
    if "success" in curve and isinstance(made.task, Balance):
        full = (curve["length"][curve["success"]] == made.task.steps).all()
        _require(full, "An episode is called a success that ended early. Success is an episode of task.steps samples.")


def snapshots_end_with_the_policy(learner: Any, rig: Rig | str, seconds: float) -> None:
    """Check that snapshots are policies in the order of their experience, and that the last is the final one."""
    training = _built(learner, rig).train(2, seconds=seconds)
    for n in (1, 5, 10_000):
        snapshots = training.snapshots(n)
        experience = [snapshot.experience for snapshot in snapshots]
        good = 1 <= len(snapshots) <= n and experience == sorted(experience) and experience[-1] > 0
        good = good and experience[-1] <= training.experience
        message = f"snapshots({n}) have the experience {experience[:5]} of {training.experience:g} s in all. "
        _require(good, message + "Return at most n, the earliest first: a rl.training.Trail does.")
        for snapshot in snapshots:
            y = np.full((3 if is_batched(snapshot.policy) else 1, 6), 0.01)
            checked_forces(_started(snapshot.policy, len(y), 0)(0.0, y), len(y))
    whole = training.cost.steps == training.curve["length"].sum() and training.outcome.name != "DIVERGED"
    message = "The last snapshot is not the final policy. Record the policy at the end, too."
    _require(not whole or _equal(snapshots[-1].policy, training.policy), message)


LearnerCheck = Callable[[Any, Rig | str, float], None]
LEARNER_CHECKS: tuple[LearnerCheck, ...] = (
    is_built_with_its_rig_first,
    same_seed_same_policy,
    stays_within_the_budget,
    an_unreached_budget_changes_nothing,
    progress_grows_to_one,
    bad_budgets_are_refused,
    the_curve_adds_up,
    snapshots_end_with_the_policy,
)
"""The checks of every learner: of a learner or what builds it, a rig or the name of a preset, and a budget in s."""


def main(arguments: list[str] | None = None) -> None:
    """Check a controller or a learner in a file."""
    parser = argparse.ArgumentParser(prog="python -m dpend.check", description=main.__doc__)
    parser.add_argument("what", metavar="mine.py:NAME", help="a class, a factory, an object or a function law(t, x)")
    parser.add_argument("--rig", default="gustafsson2016", help="a preset, or a file of one")
    parser.add_argument("--skip", nargs="*", default=[], metavar="CHECK", help="checks to leave out")
    given = parser.parse_args(arguments)
    file, _, name = given.what.rpartition(":")
    path = Path(file).resolve()
    if not path.is_file():
        parser.error(f"expected path.py:NAME, such as mine.py:ByHand; there is no file {file!r}")
    sys.path.insert(0, str(path.parent))  # so that what it imports is found, and it can be pickled
    module = import_module(path.stem)
    if not hasattr(module, name):
        parser.error(f"there is no {name!r} in {file}")
    thing, rig = getattr(module, name), as_rig(given.rig)
    try:
        if hasattr(thing, "train"):
            check_learner(thing, given.rig, skip=given.skip)
        else:
            builds = isinstance(thing, type | FunctionType)
            taken = inspect.signature(thing).parameters.values() if builds else ()
            if builds and [each.name for each in taken][:1] != ["t"]:  # no law(t, x)
                thing = thing(*[rig for each in taken if each.name == "rig" or each.default is each.empty][:1])
            check_controller(thing, rig, skip=given.skip)
    except ContractError as error:
        sys.exit(str(error))
    print(f"{name} keeps its contract on {given.rig}.")


if __name__ == "__main__":
    main()
