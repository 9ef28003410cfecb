"""One visitor's pendulums: a scene as the page describes it, and the process in which its controllers work.

The page owns the states and sends them along whenever it describes a scene, so that a scene can be changed while it
runs, and goes on after its process was ended or its connection lost.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

import dpend
from dpend import Balance, Status, SwingUp
from dpend.arguments import checked_name
from dpend.controller import Act, Controller, is_batched
from dpend.params import Array
from dpend.rig import PRESETS, Rig
from dpend.stepper import CONTROLLER_STREAM, Stepper, checked_forces, row_sequence
from dpend.tasks import NoTask, Task

from .._field import CONTENDERS, RIG, Contender, find, own

CHANGES = ("cart_mass", "mass1", "mass2", "length1", "length2", "cart_friction", "joint1_friction", "joint2_friction",
           "force_limit", "sensor_noise", "sensor_delay", "force_noise", "actuator_delay", "actuator_lag")  # fmt: skip
"""What of a rig can be changed while it runs."""

TASKS: Mapping[str, Task] = {"balance": Balance(), "swing-up": SwingUp(), "none": NoTask()}
"""What ends a run and what counts as success."""

MOST_COPIES = 500
_DIGITS = 6  # of the states of many copies, which are drawn and no more
MOST_SAMPLES = 50
"""In one advance."""

_FARTHEST = 1e6  # m, rad or a second of them: far beyond what any rig does
_MOST_PUSH = 1000.0
_FIRST, _NEXT = 150.0, 2.0
"""Seconds that a controller may take at first, while it may be compiled, and for every sample after that."""


def contenders(specs: Sequence[str] = ()) -> list[Contender]:
    """Return all who can be put into a scene: those of the comparisons, and the user's own."""
    return [*CONTENDERS, *map(own, specs)]


def fits(contender: Contender, rig: str) -> bool:
    """Return whether a contender can be had for a preset at once, and for bang-bang with a limit to switch between."""
    if rig.startswith("gustafsson2016"):
        return True
    tuned = contender.prior_knowledge is find("tuned linear").prior_knowledge
    unlimited = contender.name.startswith("sign of") and not np.isfinite(dpend.rig(rig).force_limit)
    return not (tuned or unlimited or contender.policy or contender.name == "TVLQR")


def make(contender: Contender, rig: str, task: str) -> Controller:
    """Return a contender's controller for what a preset is, whatever is changed of the rig later.

    What was tuned or learned for the rig of the comparisons stays what it is on the same rig with other inertias.
    """
    tuned = contender.prior_knowledge is find("tuned linear").prior_knowledge
    believed = RIG if tuned or contender.name == "TVLQR" else dpend.rig(rig)
    swings = "swing-up" in contender.tasks and (task != "balance" or "balance" not in contender.tasks)
    return contender.make(believed, SwingUp() if swings else Balance())


# ------------------------------------------------------------------------------------------------ what the page may say


def parsed(text: str) -> dict[str, Any]:
    """Return a message as a dict; refuse what is no JSON object, or holds what JSON does not know, such as NaN."""

    def refuse(name: str) -> None:
        raise ValueError(f"numbers must be finite; got {name}")

    try:
        message = json.loads(text, parse_constant=refuse)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"A message is a JSON object: {str(error)[:200]}.") from None
    if not isinstance(message, dict):
        raise ValueError("A message is a JSON object; got something else.")
    return message


def _number(name: str, value: object, least: float, most: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value <= most:
        raise ValueError(f"{name} must be a number from {least:g} to {most:g}; got {str(value)[:40]}.")
    return float(value)


def _whole(name: str, value: object, most: int) -> int:
    number = _number(name, value, 0, most)
    if number != int(number):
        raise ValueError(f"{name} must be a whole number from 0 to {most}; got {number:g}.")
    return int(number)


@dataclass(frozen=True, kw_only=True)
class Scene:
    """What the page asks to see.

    Parameters
    ----------
    rig : str
        A preset.
    task : str
        One of :data:`TASKS`.
    changes : mapping of str to float
        What is changed of the rig, unknown to the controllers; any of :data:`CHANGES`.
    controllers : sequence of str
        Names of one contender or two.
    states : sequence of ndarray (n, 6)
        Where the copies of each stand.
    k : int
        Samples since the run began.
    seed : int
        What the disturbances are drawn from, the same for both.
    """

    rig: str
    task: str
    changes: Mapping[str, float]
    controllers: Sequence[str]
    states: Sequence[Array]
    k: int = 0
    seed: int = 0
    true: Rig = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "true", dpend.rig(self.rig).replace(**self.changes))

    @classmethod
    def of(cls, message: Mapping[str, Any], known: Sequence[Contender]) -> Scene:
        """Return the scene that a message describes; a ValueError says what is wrong with it."""
        rig = checked_name("rig", message.get("rig"), PRESETS)
        task = checked_name("task", message.get("task"), TASKS)
        names = message.get("controllers")
        if not isinstance(names, list) or len(names) not in (1, 2):
            raise ValueError("controllers must be a list of one name or two.")
        for name in names:
            checked_name("a controller", name, [each.name for each in known if fits(each, rig)])
        given = message.get("changes", {})
        if not isinstance(given, dict):
            raise ValueError("changes must be an object of numbers by name.")
        changes = {
            checked_name("a change", name, CHANGES): _number(name, value, 0.0, 50.0 if "delay" in name else 1e4)
            for name, value in given.items()
        }
        states = message.get("states")
        if not isinstance(states, list) or len(states) != len(names):
            raise ValueError("states must be a list with one list of numbers for each controller.")
        try:
            return cls(rig=rig, task=task, changes=changes, controllers=names, states=[*map(_states, states)],
                       k=_whole("k", message.get("k", 0), 10**9), seed=_whole("seed", message.get("seed", 0), 10**9),
                       )  # fmt: skip
        except TypeError as error:
            raise ValueError(str(error)) from error


def _states(numbers: object) -> Array:
    if not isinstance(numbers, list) or len(numbers) % 6 or not 6 <= len(numbers) <= 6 * MOST_COPIES:
        raise ValueError(f"states must be lists of six numbers for each of 1 to {MOST_COPIES} copies.")
    if not all(type(number) in (int, float) for number in numbers):
        raise ValueError("states must be lists of numbers.")
    try:
        x = np.array(numbers, dtype=np.float64).reshape(-1, 6)
    except OverflowError:
        raise ValueError("states must be lists of numbers that fit into 64 bits.") from None
    if not (np.abs(x) <= _FARTHEST).all():
        raise ValueError(f"states must be within {_FARTHEST:g} m, rad, m/s and rad/s.")
    return x


def advance_of(message: Mapping[str, Any]) -> tuple[int, Array]:
    """Return for how many samples a message asks, and under what push ``(3,)``; a ValueError says what is wrong."""
    push = message.get("push", [0, 0, 0])
    if not isinstance(push, list) or len(push) != 3:
        raise ValueError("push must be a list of a force on the cart, N, and torques on both links, N m.")
    return (
        max(_whole("n", message.get("n", 1), MOST_SAMPLES), 1),
        np.array([_number("push", each, -_MOST_PUSH, _MOST_PUSH) for each in push]),
    )


# ---------------------------------------------------------------------------------------------------- the loop itself


class TookTooLong(BaseException):
    """A controller that had to be interrupted; its own ``except Exception`` does not catch it."""


@contextmanager
def within(seconds: float) -> Iterator[None]:
    """Interrupt a block after some time; where the system has no timers, or compiled code holds on, nothing happens."""
    if not hasattr(signal, "setitimer"):
        yield
        return

    def interrupt(*_: object) -> None:
        raise TookTooLong

    before = signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


class Lane:
    """Some copies of a rig under one controller.

    Parameters
    ----------
    name : str
        The controller's name.
    act : callable, optional
        The law at work; left out, it has failed already.
    failed : str
        Why there is no law.
    scene : Scene
        Rig, task and clock.
    states : ndarray (n, 6)
        Where they stand.
    """

    def __init__(self, name: str, act: Act | None, failed: str, scene: Scene, states: Array) -> None:
        self.name, self.act, self.failed = name, act, failed
        self._task, self._rig, self._k = TASKS[scene.task], scene.true, scene.k
        n = len(states)
        self._stepper = Stepper(scene.true, n, scene.seed + scene.k)  # noise that does not repeat at each change
        self._y = self._stepper.reset(states)
        self._shown = states.copy()
        self._codes = self._task.ended(states, scene.true)
        if failed:
            self._codes[self._codes == 0] = Status.CONTROLLER_FAILED.code
        self._last = np.zeros(n)
        self._limit = _FIRST
        self._park(self._codes != 0)

    def advance(self, samples: int, push: Array) -> dict[str, Any]:
        """Move on, and return what is to be drawn: the first copy's forces, of a single one its states too."""
        states, forces, seconds = [], [], 0.0
        single = len(self._shown) == 1
        for _ in range(samples):
            began, running = perf_counter(), self._codes[0] == 0
            u = self._forces()
            seconds += perf_counter() - began
            running = running and not self.failed
            self._y = self._stepper.step(u, push)
            self._k += 1
            self._judge()
            if running:
                forces.append(float(self._stepper.force[0]))
                if single:
                    states.append(self._shown[0].tolist())
        return self.frame() | {"x": states, "u": forces, "ms": round(1e3 * seconds / samples, 3)}

    def frame(self) -> dict[str, Any]:
        """Return where the copies stand, which of them have ended, and why the controller failed, if it did."""
        shown = self._shown if len(self._shown) == 1 else self._shown.round(_DIGITS)
        return {"states": shown.ravel().tolist(), "codes": self._codes.tolist(), "failed": self.failed}

    def _forces(self) -> Array:
        n = len(self._shown)
        if self.act is None or (self._codes != 0).all():
            return np.zeros(n)
        try:
            with within(self._limit):
                u = checked_forces(self.act(self._k * self._rig.sample_time, self._y), n)
            self._limit = _NEXT
        except TookTooLong:
            self._fail(f"{self.name} took longer than {self._limit:g} s for one sample and was stopped.")
            return np.zeros(n)
        except Exception as error:  # what a controller raises is its own affair
            self._fail(f"{self.name} failed: {type(error).__name__}: {error}"[:500])
            return np.zeros(n)
        u = np.where(np.isfinite(u), u, self._last)  # as `simulate` has it
        u[self._codes != 0] = 0.0
        self._last = u
        return u

    def _fail(self, why: str) -> None:
        self.act, self.failed = None, why
        self._codes[self._codes == 0] = Status.CONTROLLER_FAILED.code

    def _judge(self) -> None:
        x, running = self._stepper.x, self._codes == 0
        ended = self._task.ended(x, self._rig)
        shown = running & np.isfinite(x).all(axis=1)
        self._shown[shown] = x[shown]
        self._codes[running] = ended[running]
        self._park(running & (ended != 0) | ~running)

    def _park(self, rows: npt.NDArray[np.bool_]) -> None:
        """Take the copies that have ended out of the way of the others."""
        if rows.any():
            self._y[rows] = self._stepper.reset(np.zeros(6), rows)


def started(controller: Controller, n: int) -> Act:
    """Return the law for ``n`` copies, called row by row where the controller treats one run at a time."""
    rngs = (np.random.default_rng(row_sequence(0, row, CONTROLLER_STREAM)) for row in range(n))
    if is_batched(controller):
        return controller.start(n, next(rngs))
    acts = [controller.start(1, rng) for rng in rngs]
    return lambda t, y: np.concatenate([checked_forces(act(t, row[None]), 1) for act, row in zip(acts, y, strict=True)])


class Playground:
    """What a visitor's process does with the messages that it is sent.

    Parameters
    ----------
    known : sequence of Contender
        Who can be put into a scene.
    """

    def __init__(self, known: Sequence[Contender]) -> None:
        self._known = known
        self._scene: Scene | None = None
        self._lanes: list[Lane] = []

    def answer(self, message: Mapping[str, Any]) -> dict[str, Any]:
        """Return the answer to a message; a ValueError says what is wrong with it."""
        do = checked_name("do", message.get("do"), ("scene", "advance"))
        if do == "scene":
            scene = Scene.of(message, self._known)
            self._lanes = [self._lane(scene, i) for i in range(len(scene.controllers))]
            self._scene = scene
            return {"lanes": [lane.frame() for lane in self._lanes]}
        samples, push = advance_of(message)
        if not self._lanes:
            raise ValueError("There is no scene yet: describe one first.")
        return {"lanes": [lane.advance(samples, push) for lane in self._lanes]}

    def _lane(self, scene: Scene, i: int) -> Lane:
        """Return a lane; the law of before with its memory, if it is the same controller in the same run."""
        name, states, before = scene.controllers[i], scene.states[i], self._scene
        same = scene.k > 0 and before is not None and (before.rig, before.task) == (scene.rig, scene.task)
        if same and before is not None and i < len(self._lanes) and self._lanes[i].name == name:
            kept = self._lanes[i]
            if kept.act is not None and len(before.states[i]) == len(states):
                lane = Lane(name, kept.act, "", scene, states)
                lane._limit = kept._limit
                return lane
        try:
            with within(_FIRST):
                contender = next(each for each in self._known if each.name == name)
                return Lane(name, started(make(contender, scene.rig, scene.task), len(states)), "", scene, states)
        except TookTooLong:
            return Lane(name, None, f"{name} took longer than {_FIRST:g} s to start and was stopped.", scene, states)
        except Exception as error:  # a user's own, or a design that this rig does not allow
            return Lane(name, None, f"{name}: {type(error).__name__}: {error}"[:500], scene, states)


def _serve(requests: BinaryIO, answers: BinaryIO, specs: Sequence[str]) -> None:
    """Answer messages, a line each, until there are no more."""
    playground = Playground(contenders(specs))
    answers.write(b'{"ready": true}\n')
    answers.flush()
    for line in requests:
        try:
            answer = json.dumps(playground.answer(json.loads(line)), allow_nan=False)
        except ValueError as error:
            answer = json.dumps({"error": str(error)})
        answers.write(answer.encode() + b"\n")
        answers.flush()


def main(specs: Sequence[str]) -> None:
    """Serve one visitor over standard input and output, out of reach of what controllers print."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the server's
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    _serve(sys.stdin.buffer, answers, specs)


if __name__ == "__main__":
    main(sys.argv[1:])
