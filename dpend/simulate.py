"""Closed-loop simulation: loops over the stepper."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from time import perf_counter

import numpy as np
import numpy.typing as npt

from .arguments import checked_flag, checked_seed, checked_whole, is_finite
from .controller import Act, Controller, FunctionController, Law, LawError, as_controller, is_batched, name_of
from .episode import UprightClock
from .params import Array
from .plant import PUSHES
from .rig import Rig, as_rig
from .run import Run, Runs
from .state import as_states, one_state
from .status import Status
from .stepper import CONTROLLER_STREAM, Stepper, checked_forces, checked_push, row_sequence
from .tasks import Balance, NoTask, Task, checked_task
from .workers import pool

Push = Callable[[float], npt.ArrayLike]
"""Generalised forces on cart (N), link 1 and link 2 (N m), ``(3,)`` or ``(N, 3)``, as a function of time in s."""

_BALANCE = Balance()

BLOCK = 4096
"""Rows stepped together: enough to share out Python's time, few enough to stay in the cache."""


def simulate(
    rig: Rig,
    controller: Controller | Law,
    x0: npt.ArrayLike,
    duration: float | None = None,
    *,
    task: Task | None = _BALANCE,
    push: Push | None = None,
    seed: int = 0,
) -> Run:
    """Run a controller on a rig from one state.

    It is a batch of one: the same loop, the same random numbers as of row 0.

    Parameters
    ----------
    rig : Rig
        The true rig; what the controller believes is its own affair.
    controller : Controller or callable
        The law; a plain function ``law(t, x)`` of one state ``(6,)`` will do.
    x0 : array_like (6,)
        The initial state.
    duration : float, optional
        Seconds, a whole number of samples; left out, the task's full length.
    task : Task, optional
        What ends the run and what counts as success; None ends it only at the track's end.
    push : callable, optional
        Generalised forces that act beside the actuator's, as a function of time, held over each sample; the run's log
        keeps them as ``push_cart`` (N), ``push_link1`` and ``push_link2`` (N m).
    seed : int
        What the disturbances are drawn from.

    Returns
    -------
    Run
        With states, measurements and forces.

    Raises
    ------
    TypeError, ValueError
        Before anything runs, if an argument is wrong.
    LawError
        If the law fails while it runs; the error keeps the runs so far.

    See Also
    --------
    dpend.simulate_many : From many states at once.
    dpend.Run : What comes back.

    Notes
    -----
    Where a law returns NaN or an infinite force, its last finite one counts, zero at first, and the log's
    ``"not_finite"`` is one.

    Examples
    --------
    >>> import dpend
    >>> rig = dpend.rig("gustafsson2016")
    >>> from controllers import LQR
    >>> run = dpend.simulate(rig, LQR(rig), [0, 0.1, -0.1, 0, 0, 0], duration=6.0)
    >>> run.status.value
    'The run reached its full length.'
    """
    run = simulate_many(
        rig, controller, one_state("x0", x0)[None], duration, task=task, push=push, seed=seed, record=True
    )[0]
    if len(run.t) == 1:
        raise ValueError(
            f"The run would end where it starts, at x0 = {np.asarray(x0).tolist()}: {run.status.value} "
            "Angles are in radians; choose another start, or task=None."
        )
    return run


def simulate_many(
    rig: Rig,
    controller: Controller | Law,
    x0: npt.ArrayLike,
    duration: float | None = None,
    *,
    task: Task | None = _BALANCE,
    push: Push | None = None,
    seed: int = 0,
    first_row: int = 0,
    record: bool = False,
    workers: int = 1,
) -> Runs:
    """Run a controller on a rig, or on one rig a row, from many states.

    Row ``i`` is what a single run of it would be, whatever runs beside it.

    Parameters
    ----------
    rig : Rig
        The true rig or rigs.
    controller : Controller or callable
        The law; a plain function ``law(t, x)`` of one state ``(6,)`` will do.
    x0 : array_like (N, 6)
        The initial states.
    duration : float, optional
        Seconds, a whole number of samples; left out, the task's full length.
    task : Task, optional
        What ends a run and what counts as success; None ends it only at the track's end.
    push : callable, optional
        As of :func:`simulate`; it may return forces ``(N, 3)``.
    seed : int
        What the disturbances are drawn from: row ``i`` from ``(seed, first_row + i)``.
    first_row : int
        Number of the first row, where a batch is cut into parts.
    record : bool
        Keep true and measured states, ``2 * 48`` bytes a row and sample; forces are always kept.
    workers : int
        Processes that share the rows of a controller which treats one run at a time.

    Returns
    -------
    Runs
        Of as many rows; a LawError keeps those so far.

    See Also
    --------
    dpend.simulate : From one state.
    dpend.Runs : What comes back.

    Examples
    --------
    >>> import numpy as np
    >>> import dpend
    >>> rig = dpend.rig("gustafsson2016")
    >>> from controllers import LQR
    >>> task = dpend.Balance(lam=0.1)
    >>> starts = task.starts(np.random.default_rng(0), 100, rig)
    >>> float(dpend.simulate_many(rig, LQR(rig), starts, task=task).success.mean())
    1.0
    """
    rig = as_rig(rig)
    controller = as_controller(controller)
    seed = checked_seed("seed", seed)
    first_row = checked_seed("first_row", first_row)
    states = as_states(x0)
    if not len(states):
        raise ValueError("x0 has no rows; expected at least one initial state.")
    if rig.n not in (None, len(states)):
        raise ValueError(f"The rig describes {rig.n} rows, x0 has {len(states)}; expected the same number.")
    workers, record = checked_whole("workers", workers), checked_flag("record", record)
    the_task: Task = NoTask() if task is None else checked_task(task)
    samples = _samples(rig, the_task, duration)
    _check_memory(samples, len(states), record)
    if push is not None:
        if not callable(push):
            raise TypeError(f"push must be a function of time, such as lambda t: (1.0, 0.0, 0.0); got {push!r}.")
        checked_push(push(0.0), len(states))
    rows = BLOCK if is_batched(controller) else 1
    blocks = [slice(start, min(start + rows, len(states))) for start in range(0, len(states), rows)]
    simulate_block = partial(_simulate_block, rig, controller, states, samples, the_task, push, seed, first_row, record)
    if workers > 1 and not is_batched(controller) and len(blocks) > 1:
        with pool(min(workers, len(blocks)), controller=controller, task=the_task, push=push) as executor:
            return _joined(executor.map(simulate_block, blocks, chunksize=-(-len(blocks) // (4 * workers))), rig)
    return _joined(map(simulate_block, blocks), rig)


def _joined(blocks: Iterable[Runs], rig: Rig) -> Runs:
    """Return blocks side by side; where one fails, those that ended go with the error."""
    parts: list[Runs] = []
    try:
        parts.extend(blocks)
    except LawError as error:
        parts.append(error.runs)
        rows = sum(map(len, parts))
        error.runs = parts[0] if len(parts) == 1 else Runs.join(parts, rig.rows(slice(0, rows)))
        raise
    return parts[0] if len(parts) == 1 else Runs.join(parts, rig)


def _samples(rig: Rig, task: Task, duration: float | None) -> int:
    """Return the number of samples in a run; refuse a duration that is no whole number of them, or missing."""
    if duration is None:
        if task.steps is None:
            raise ValueError("Without a task a run has no natural end: pass a duration in s.")
        return task.steps
    if not isinstance(duration, int | float | np.integer | np.floating):
        raise TypeError(f"duration must be a number of seconds; got {duration!r}.")
    samples = round(duration / rig.sample_time) if is_finite(duration) else 0
    if samples < 1 or abs(samples * rig.sample_time - duration) > 1e-9 * duration:
        near = max(samples, 1) * rig.sample_time
        raise ValueError(
            f"duration must be a whole number of samples of {rig.sample_time:g} s, at least one; "
            f"got {duration!r} s. The nearest is {near:g} s."
        )
    return samples


def _check_memory(samples: int, rows: int, record: bool) -> None:
    """Refuse records of forces and states that this machine cannot hold."""
    needed = samples * rows * (128 if record else 32) // 2**30
    there = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2**30 if hasattr(os, "sysconf") else 64
    if needed > there:
        raise ValueError(
            f"{rows} x {samples} samples take {needed} GiB, and this machine has {there} GiB: shorten the duration, "
            "simulate fewer rows at a time, or leave out record."
        )


def _simulate_block(
    rig: Rig,
    controller: Controller,
    states: Array,
    samples: int,
    task: Task,
    push: Push | None,
    seed: int,
    first_row: int,
    record: bool,
    block: slice,
) -> Runs:
    """Simulate some rows of a batch.

    A row that has ended is parked upright at rest without force, where it disturbs no other, until all have ended.
    """
    rig = rig.rows(block)
    x0 = states[block]
    n = len(x0)
    first = first_row + block.start
    stepper = Stepper(rig, n, seed, first)
    act = controller.start(n, np.random.default_rng(row_sequence(seed, first, CONTROLLER_STREAM)))
    if not callable(act):
        raise TypeError(f"start(n, rng) of a controller must return the law act(t, y); got {act!r}.")
    if not isinstance(getattr(act, "log", {}), Mapping):
        raise TypeError(f"A law's log is a mapping from names to lists; got {act.log!r}.")  # type: ignore[attr-defined]
    y = stepper.reset(x0)

    t = rig.sample_time * np.arange(samples + 1, dtype=np.float64)
    forces = np.full((samples, n), np.nan)
    seconds = np.full(samples, np.nan)
    pushes = None if push is None else np.full((samples, n, 3), np.nan)
    states_kept = np.full((2, samples + 1, n, 6), np.nan) if record else None  # true and measured
    codes = task.ended(x0, rig)
    steps = np.where(codes != 0, 0, samples)
    final = x0.copy()
    travel = np.abs(x0[:, 0])
    alive = codes == 0
    upright = UprightClock(task, rig, n)
    upright.begin(x0)
    if states_kept is not None:
        states_kept[:, 0] = x0, y
    all_alive = bool(alive.all())
    if not all_alive:
        y[~alive] = stepper.reset(np.zeros(6), ~alive)
    u = np.zeros(n)
    not_finite: list[tuple[int, npt.NDArray[np.bool_]]] = []
    cause: Exception | None = None
    whose, k = "", 0

    for k in range(samples):
        if not alive.any():
            break
        last = u
        began, whose = perf_counter(), name_of(controller)
        try:
            u = checked_forces(act(float(t[k]), y), n)
            seconds[k] = perf_counter() - began
            whose = "The push"
            pushed = None if push is None else checked_push(push(float(t[k])), len(states))
        except Exception as error:  # what a user's function raises is its own affair
            cause = error
            steps[alive], codes[alive], final[alive] = k, Status.CONTROLLER_FAILED.code, stepper.x[alive]
            alive[:] = False
            break
        if not all_alive:
            u[~alive] = 0.0
        if not np.isfinite(u).all():
            bad = ~np.isfinite(u)
            not_finite.append((k, bad))
            u = np.where(bad, last, u)
        pushed = pushed if pushed is None or pushed.ndim == 1 else pushed[block]
        y = stepper.step(u, pushed)
        x = stepper.x
        forces[k] = stepper.force
        if pushes is not None:
            pushes[k] = pushed
        # Noise and pushes move what is parked.
        np.fmax(travel, np.abs(x[:, 0]), out=travel, where=True if all_alive else alive)
        if states_kept is not None:
            states_kept[:, k + 1] = x, y
        upright.tick(x)
        ended = task.ended(x, rig)
        if ended.any() and (ending := alive & (ended != 0)).any():
            all_alive = False
            codes[ending] = ended[ending]
            steps[ending] = k + 1
            final[ending] = x[ending]
            alive &= ~ending
            y[ending] = stepper.reset(np.zeros(6), ending)
    after_end = np.arange(samples)[:, None] >= steps
    forces[after_end] = np.nan
    if states_kept is not None:
        states_kept[:, 1:][:, after_end] = np.nan
    true, measured = (None, None) if states_kept is None else states_kept.transpose(0, 2, 1, 3)
    final[alive] = stepper.x[alive]
    success = upright.success(codes)
    log = _log(act, n, samples, after_end, not_finite)
    if pushes is not None:
        pushes[after_end] = np.nan
        log |= dict(zip(PUSHES, pushes.T, strict=True))
    runs = Runs(
        t=t,
        u=forces.T,
        steps=steps,
        codes=codes,
        success=success,
        final=final,
        travel=travel,
        time_up=np.where(success & upright.asked, (samples - upright.samples) * rig.sample_time, np.nan),
        step_time=np.broadcast_to(seconds / n, (n, samples)),
        log=log,
        rig=rig,
        controller=name_of(controller),
        task=repr(task),
        seed=seed,
        first_row=first,
        x=true,
        y=measured,
    )
    if cause is None:
        return runs
    rows = f"row {first}" if n == 1 else f"rows {first} to {first + n - 1}"
    reason = (str(cause) if type(cause) is ValueError else f"{type(cause).__name__}: {cause}").rstrip(".")
    if k == 0 and whose != "The push" and isinstance(cause, ValueError | IndexError | TypeError):
        alone = not is_batched(controller) and not isinstance(controller, FunctionController)
        reason += ", with measurements of one row, (1, 6), whose state is y[0]" if alone else ""
    raise LawError(
        f"{whose} failed at t = {t[k]:g} s in {rows}: {reason}. The runs up to there are kept in the error's `runs`.",
        runs,
    ) from cause


def _log(
    act: Act,
    n: int,
    samples: int,
    after_end: npt.NDArray[np.bool_],
    not_finite: list[tuple[int, npt.NDArray[np.bool_]]],
) -> dict[str, Array]:
    """Return what the law logs of its steps, and which forces were not finite, as arrays ``(n, samples)``."""
    log: dict[str, Array] = {}
    for name, entries in getattr(act, "log", {}).items():
        logged = np.full((samples, n), np.nan)
        if len(entries) > samples:
            raise ValueError(f"A law's log has one entry a call, at most {samples}; {name!r} has {len(entries)}.")
        for k, entry in enumerate(entries):
            logged[k] = entry
        log[name] = logged.T
    if not_finite:
        counted = np.zeros((samples, n))
        for k, bad in not_finite:
            counted[k] = bad
        log["not_finite"] = counted.T
    for logged in log.values():
        logged.T[after_end] = np.nan
    return log
