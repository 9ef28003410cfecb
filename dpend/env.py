"""The Gymnasium environments ``dpend/Balance-v0``, ``dpend/SwingUp-v0`` and their shaped kin: one rig, one episode.

What single and vector environments share is stated here: the spaces, what an action means, what is observed.
"""

from __future__ import annotations

import inspect
import math
import operator
import time
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import InvalidAction, ResetNeeded

from .arguments import checked_array, checked_name
from .episode import UprightClock
from .params import Array
from .rewards import Reward, reward_of
from .rig import Rig, as_rig, single_rig
from .shaping import observation_scales, observe, shaped_balance, shaped_swing_up
from .state import as_states
from .status import Status
from .stepper import Stepper
from .suggest import suggestion
from .tasks import Balance, SwingUp, Task, checked_task

_MESSAGES = tuple(status.value for status in Status)


class RigEnvironment:
    """What single and vector environments share: a task on a rig, what actions mean, what is observed and paid.

    A subclass sets ``task`` and ``rig``, then calls ``_set_up``; the rest it has from Gymnasium.
    """

    metadata: dict[str, Any]
    task: Task
    rig: Rig
    _spec: EnvSpec | None = None

    def _set_up(
        self, n: int, reward: str | Reward, forces: npt.ArrayLike | None, observation: str, render_mode: str | None
    ) -> tuple[spaces.Space[Any], spaces.Space[Array]]:
        """Check what both kinds take, and return the spaces of one action and of one observation."""
        self._forces = _checked_forces(forces, self.rig)
        trig = checked_name("observation", observation, ("raw", "trig", "scaled")) != "raw"
        high = np.array([np.inf, 1.0, 1.0, 1.0, 1.0, np.inf, np.inf, np.inf]) if trig else np.full(6, np.inf)
        self._observe: Callable[[Array], Array] = np.asarray
        if trig:
            scaled = observation == "scaled"
            scales = observation_scales(single_rig(self.rig, 'observation="scaled"')) if scaled else np.ones(4)
            self._observe = partial(observe, scales=scales)
        self._reward = reward_of(reward, self.task, self.rig)
        self._reward_looks_back = callable(reward)  # at the states before the step, at which no reward of a name looks
        modes = self.metadata["render_modes"]
        if render_mode is not None and not (isinstance(render_mode, str) and render_mode in modes):
            raise ValueError(f"render_mode must be None or one of {', '.join(map(repr, modes))}; got {render_mode!r}.")
        self.render_mode = render_mode
        # At least one a second; a film of all samples then runs at the true speed.
        self.metadata = self.metadata | {"render_fps": max(1, round(1 / self.rig.sample_time))}
        self._length = np.iinfo(np.int64).max if self.task.steps is None else self.task.steps
        self._upright = UprightClock(self.task, self.rig, n)
        self._stepper: Stepper | None = None
        self._pictures: list[Any] = []
        action = spaces.Box(-1.0, 1.0, (1,), np.float32) if self._forces is None else spaces.Discrete(len(self._forces))
        seen: Any = spaces.Box(-high, high, dtype=np.float64)  # which does not know its own dtype
        return action, seen

    @property
    def spec(self) -> EnvSpec | None:
        """What Gymnasium knows of the environment, its greatest length included."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = spec and replace(spec, max_episode_steps=self.task.steps)

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_pictures": []}  # a copy opens a window of its own

    def _start_asked_for(self, options: Mapping[str, Any] | None, known: tuple[str, ...], n: int) -> Array | None:
        """Return the states ``(n, 6)`` that the options of a reset ask for, if any; refuse what cannot be a start."""
        if options is not None and not isinstance(options, Mapping):
            raise TypeError(f"options of reset must be a dict, of {', '.join(map(repr, known))}; got {options!r}.")
        for name in options or ():
            if name not in known:
                raise ValueError(f"reset has no option {name!r}.{suggestion(str(name), known)}")
        if not options or "x0" not in options:
            return None
        x0 = as_states(options["x0"], n)
        codes = self.task.ended(x0, self.rig)
        if codes.any():
            row = int(np.flatnonzero(codes)[0])
            raise ValueError(
                f"An episode cannot start where it ends; got x0 = {x0[row].tolist()}: {_MESSAGES[codes[row]]}"
            )
        return x0

    def _paid(self, before: Array, stepper: Stepper, codes: npt.NDArray[np.uint8]) -> Array:
        """Return the rewards ``(n,)`` of a step; refuse what else a user's function may return."""
        rewards = self._reward(before, stepper.force, stepper.x, codes)
        try:
            array = np.asarray(rewards, dtype=np.float64)
        except (TypeError, ValueError):
            array = np.empty(0)
        if array.shape != codes.shape:
            raise ValueError(f"A reward function returns one number per row, shape {codes.shape}; got {rewards!r}.")
        return array


def fresh_stepper(env: Any, n: int) -> Stepper:
    """Return a stepper with the environment's seed, or a number from the generator that a user put in its place."""
    seed = env.np_random_seed
    if not isinstance(seed, int) or seed < 0:  # Gymnasium's sign of a generator whose seed it does not know
        seed = int(env.np_random.integers(2**63))
    return Stepper(env.rig, n, seed)


def _checked_forces(forces: npt.ArrayLike | None, rig: Rig) -> Array | None:
    """Return the forces that discrete actions choose from, or None for continuous actions."""
    if forces is None:
        if not np.isfinite(rig.force_limit).all():
            raise ValueError(
                f"A continuous action is a share of the force limit: expected a finite one; got {rig.force_limit!r}. "
                "Set it with rig.replace(force_limit=...), in N, or pass forces=[...] to choose from."
            )
        return None
    limit = float(np.min(rig.force_limit))
    try:
        array = checked_array("forces", forces, "forces, N").copy()
    except (TypeError, ValueError):
        array = np.array(np.nan)
    if array.ndim != 1 or len(array) < 2 or not (np.isfinite(array) & (np.abs(array) <= limit)).all():
        raise ValueError(
            "forces must be two or more finite numbers in N, within the force limit of "
            f"{limit:g} N; got {forces!r}. More than the limit is never applied."
        )
    array.setflags(write=False)
    return array


class CartDoublePendulumEnv(RigEnvironment, gym.Env[Array, Any]):  # pyright: ignore[reportIncompatibleVariableOverride]
    """A cart with two links, one sample a step, over :class:`dpend.Stepper`.

    The observation is what the rig's sensors measure.  The reward is of the true states; the episode is terminated when
    the task says that it failed, and truncated, by the environment itself, when it has the task's length, which is
    ``spec.max_episode_steps`` too.  ``info`` holds the true ``"state"`` (6,) and the applied ``"force"`` in N, and in
    the last step of an episode the ``"status"``, a sentence that says how it ended, and the ``"success"``, a bool.

    ``reset(seed=s)`` restarts all random numbers, the noise of :func:`dpend.simulate` with ``seed=s`` included; without
    a seed they go on.  ``reset(options={"x0": x0})`` starts at a state (6,).

    Parameters
    ----------
    task : Task
        Where episodes start, what they cost, when they end.
    rig : Rig or str
        The rig, or the name of a preset.
    reward : {"default", "report", "shaped"} or callable
        What a step is paid: see :mod:`dpend.rewards`, also for why ``"report"`` is a trap.  A function takes states
        before ``(1, 6)``, applied forces ``(1,)``, states after ``(1, 6)`` and their status codes ``(1,)``, and returns
        rewards ``(1,)``; with as many rows as copies it serves the vector environment too.
    forces : array_like (k,), optional
        Forces in N to choose from; an action is then the index of one.  Left out, an action is an array (1,): the share
        of the force limit, within [-1, 1]; what lies beyond is cut off by the actuator.
    observation : {"raw", "trig", "scaled"}
        The measured state (pos, th1, th2, vel, om1, om2); or (pos, sin th1, cos th1, sin th2, cos th2, vel, om1, om2);
        or the latter in units of the rig, :func:`dpend.shaping.observe`.
    render_mode : {"human", "rgb_array"}, optional
        A window that follows the episode, no faster than real time (extra ``gui``), or pictures ``(H, W, 3)`` from
        :meth:`render`.

    Raises
    ------
    TypeError, ValueError
        If an argument is wrong; the message says what was expected.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 50}  # noqa: RUF012

    def __init__(
        self,
        task: Task,
        rig: Rig | str,
        *,
        reward: str | Reward = "default",
        forces: npt.ArrayLike | None = None,
        observation: str = "raw",
        render_mode: str | None = None,
    ) -> None:
        self.task = checked_task(task)
        self.rig = as_rig(rig)
        if self.rig.n is not None:
            raise ValueError(
                f"An environment has one rig; this one describes {self.rig.n}. Take one of them with rig.rows(i), or "
                "all in a vector environment."
            )
        self.action_space, self.observation_space = self._set_up(1, reward, forces, observation, render_mode)
        self._force_limit = float(self.rig.force_limit)
        self._steps = 0
        self._over: str | None = None
        self._due = -math.inf

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Begin an episode and return observation and info; the class says what seed and options do.

        Raises
        ------
        TypeError, ValueError
            If an option is unknown, or the state is none, or the task would end there; the episode goes on as it was.
        """
        x0 = self._start_asked_for(options, ("x0",), 1)
        super().reset(seed=seed)
        if self._stepper is None or seed is not None:
            self._stepper = fresh_stepper(self, 1)
        y = self._stepper.reset(self.task.starts(self.np_random, 1, self.rig) if x0 is None else x0)
        self._steps = 0
        self._upright.begin(self._stepper.x)
        self._over = None
        if self.render_mode == "human":
            self.render()
        return self._observe(y)[0], {"state": self._stepper.x.flatten(), "force": 0.0}

    def step(self, action: Any) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Hold a force for one sample and return observation, reward, terminated, truncated and info.

        Raises
        ------
        gymnasium.error.ResetNeeded
            If no episode is going on.
        gymnasium.error.InvalidAction
            If the action is not finite, of another shape, or not the index of a force.
        """
        stepper = self._stepper
        if stepper is None:
            raise ResetNeeded("There is no episode yet: call reset() before step().")
        if self._over is not None:
            raise ResetNeeded(f"The episode is over: {self._over} Call reset() before the next step().")
        before = stepper.x.copy() if self._reward_looks_back else stepper.x
        y = stepper.step([self._force(action)])
        x = stepper.x
        codes = self.task.ended(x, self.rig)
        reward = float(self._paid(before, stepper, codes)[0])
        terminated = codes.item() != 0
        self._steps += 1
        truncated = self._steps >= self._length
        self._upright.tick(x)
        info: dict[str, Any] = {"state": x.flatten(), "force": stepper.force.item()}
        if terminated or truncated:
            self._over = _MESSAGES[codes[0]]
            info["status"] = self._over
            info["success"] = bool(self._upright.success(codes)[0])
        if self.render_mode == "human" and np.isfinite(x).all():
            self.render()
        return self._observe(y)[0], reward, terminated, truncated, info

    def _force(self, action: Any) -> float:
        """Return the force in N that an action asks for."""
        if self._forces is None:
            share = np.asarray(action)
            if share.shape == (1,) and share.dtype.kind in "fiu" and math.isfinite(number := share.item()):
                return number * self._force_limit
            raise InvalidAction(
                "An action is a share of the force limit: expected an array of shape (1,) with a finite number, "
                f"-1 to 1; got {action!r}."
            )
        try:
            index = operator.index(action)
        except TypeError:
            index = -1
        if not 0 <= index < len(self._forces):
            raise InvalidAction(
                f"An action is the index of a force: expected a whole number, 0 to {len(self._forces) - 1}; "
                f"got {action!r}."
            )
        return float(self._forces[index])

    def render(self) -> npt.NDArray[np.uint8] | None:  # type: ignore[override]
        """Draw the true state and the applied force: return the picture ``(H, W, 3)``, or show it in the window.

        Raises
        ------
        gymnasium.error.ResetNeeded
            If there is no state to draw.
        RuntimeError
            If no window can be opened here.
        """
        if self.render_mode is None:
            gym.logger.warn('There is no render_mode to render in: make the environment with render_mode="rgb_array".')
            return None
        if self._stepper is None:
            raise ResetNeeded("There is no episode yet: call reset() before render().")
        if not self._pictures:
            from .draw import Picture  # matplotlib loads with the first picture

            self._pictures = [Picture(self.rig)]
        x, force = self._stepper.x[0], float(self._stepper.force[0])
        if self.render_mode == "rgb_array":
            return self._pictures[0].rgb(x, force)
        now = time.monotonic()
        self._due = max(self._due + self.rig.sample_time, now)  # what is late is not made up for
        time.sleep(self._due - now)
        self._pictures[0].show(x, force)
        return None

    def close(self) -> None:
        """Close the window, if there is one."""
        for picture in self._pictures:
            picture.close()
        self._pictures = []


def task_from(
    kind: type[Balance] | type[SwingUp], environment: Callable[..., Any], given: dict[str, Any], *others: str
) -> Balance | SwingUp:
    """Take a task's parameters out of the keywords given to make an environment, and return the task.

    What neither of them nor ``others`` names is refused by a TypeError that suggests the nearest; a weight of the
    report's cost where another reward is paid, by a ValueError.
    """
    own = {field.name for field in fields(kind)}
    known = own | (set(inspect.signature(environment).parameters) - {"task"}) | set(others)
    for name in given:
        if name not in known:
            raise TypeError(f"A {kind.__name__} environment has no parameter {name!r}.{suggestion(name, known)}")
        if name in ("state_weights", "failure_cost") and given.get("reward", "default") != "report":
            raise ValueError(f'{name} is of the report\'s cost and does nothing here; add reward="report".')
    return kind(**{name: given.pop(name) for name in tuple(given) if name in own})


def _maker(kind: type[Balance] | type[SwingUp]) -> Callable[..., CartDoublePendulumEnv]:
    """Return the entry point that makes environments of one task from its parameters and the environment's own."""

    def make(rig: Rig | str = "gustafsson2016", **options: Any) -> CartDoublePendulumEnv:
        task = task_from(kind, CartDoublePendulumEnv, options)
        return CartDoublePendulumEnv(task, rig, **options)

    return make


def _shaped_maker(setup: Callable[[Rig], tuple[Task, Rig]]) -> Callable[..., CartDoublePendulumEnv]:
    """Return the entry point that makes environments as the shipped deep policies saw them."""

    def make(rig: Rig | str = "gustafsson2016", *, render_mode: str | None = None) -> CartDoublePendulumEnv:
        task, slow = setup(single_rig(rig, "A shaped environment"))
        return CartDoublePendulumEnv(task, slow, reward="shaped", observation="scaled", render_mode=render_mode)

    return make


balance = _maker(Balance)
"""Make ``dpend/Balance-v0``: keep both links up."""

swing_up = _maker(SwingUp)
"""Make ``dpend/SwingUp-v0``: bring both links up and keep them there."""

balance_shaped = _shaped_maker(shaped_balance)
"""Make ``dpend/BalanceShaped-v0``: balancing as the shipped deep policies learned it."""

swing_up_shaped = _shaped_maker(shaped_swing_up)
"""Make ``dpend/SwingUpShaped-v0``: the swing-up as the shipped deep policies learned it."""
