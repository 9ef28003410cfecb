"""The Gymnasium environments ``dpend/Balance-v0``, ``dpend/SwingUp-v0`` and their shaped kin: one rig, one episode.

What single and vector environments share is stated here: the spaces, what an action means, what is observed.
"""

from __future__ import annotations

import math
import operator
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

_OWN_KEYWORDS = ("rig", "reward", "forces", "observation", "render_mode")


class CartDoublePendulumEnv(gym.Env[Array, Any]):
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
        A window that follows the episode, or pictures ``(H, W, 3)`` from :meth:`render`.

    Raises
    ------
    TypeError, ValueError
        If an argument is wrong; the message says what was expected.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 50}  # noqa: RUF012
    _spec: EnvSpec | None = None

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
        self._forces = checked_forces(forces, self.rig)
        self.action_space = action_space(self._forces)
        self.observation_space = observation_space(observation)
        self._observe = observer(observation, self.rig)
        self._reward = reward_of(reward, self.task, self.rig)
        check_render_mode(render_mode, self.metadata["render_modes"])
        self.render_mode = render_mode
        self.metadata = self.metadata | {"render_fps": frames_per_second(self.rig)}
        self._force_limit = float(self.rig.force_limit)
        self._length = math.inf if self.task.steps is None else self.task.steps
        self._upright = UprightClock(self.task, self.rig, 1)
        self._stepper: Stepper | None = None
        self._picture: Any = None
        self._steps = 0
        self._over: str | None = None

    @property
    def spec(self) -> EnvSpec | None:  # pyright: ignore[reportIncompatibleVariableOverride]
        """What Gymnasium knows of the environment, its greatest length included."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:  # pyright: ignore[reportIncompatibleVariableOverride]
        self._spec = with_length(spec, self.task)

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_picture": None}  # a copy opens a window of its own

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Begin an episode.

        Parameters
        ----------
        seed : int, optional
            Restarts all random numbers.
        options : dict, optional
            ``{"x0": state}`` starts there (6,) rather than where the task draws.

        Returns
        -------
        tuple
            Observation and info.

        Raises
        ------
        ValueError
            If an option is unknown, or the state is none, or the task would end there.
        """
        check_options(options, ("x0",))
        x0 = None
        if options and "x0" in options:
            x0 = as_states(options["x0"], 1)
            check_starts(x0, self.task, self.rig)
        super().reset(seed=seed)
        if self._stepper is None or seed is not None:
            self._stepper = Stepper(self.rig, 1, noise_seed(self))
        y = self._stepper.reset(self.task.starts(self.np_random, 1, self.rig) if x0 is None else x0)
        self._steps = 0
        self._upright.begin(self._stepper.x)
        self._over = None
        if self.render_mode == "human":
            self.render()
        return self._observe(y)[0], {"state": self._stepper.x.flatten(), "force": 0.0}

    def step(self, action: Any) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Hold a force for one sample.

        Parameters
        ----------
        action : array_like (1,) or int
            Share of the force limit, or index of a force.

        Returns
        -------
        tuple
            Observation, reward, terminated, truncated, info.

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
        before = stepper.x.copy()
        y = stepper.step([self._force(action)])
        x = stepper.x
        codes = self.task.ended(x, self.rig)
        reward = float(checked_rewards(self._reward(before, stepper.force, x, codes), 1)[0])
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
        """Draw the true state and the applied force.

        Returns
        -------
        ndarray (H, W, 3) or None
            The picture where ``render_mode`` is ``"rgb_array"``.

        Raises
        ------
        gymnasium.error.ResetNeeded
            If there is no state to draw.
        """
        if self.render_mode is None:
            gym.logger.warn('There is no render_mode to render in: make the environment with render_mode="rgb_array".')
            return None
        if self._stepper is None:
            raise ResetNeeded("There is no episode yet: call reset() before render().")
        if self._picture is None:
            from .draw import Picture  # matplotlib loads with the first picture

            self._picture = Picture(self.rig)
        draw = self._picture.show if self.render_mode == "human" else self._picture.rgb
        return draw(self._stepper.x[0], float(self._stepper.force[0]))

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._picture is not None:
            self._picture.close()
            self._picture = None


def _maker(kind: type[Balance] | type[SwingUp]) -> Callable[..., CartDoublePendulumEnv]:
    """Return the entry point that makes environments of one task."""

    def make(
        rig: Rig | str = "gustafsson2016",
        *,
        reward: str | Reward = "default",
        forces: npt.ArrayLike | None = None,
        observation: str = "raw",
        render_mode: str | None = None,
        **task: Any,
    ) -> CartDoublePendulumEnv:
        """Make the environment: the task's own parameters, and those of :class:`CartDoublePendulumEnv`.

        Raises
        ------
        TypeError
            If a parameter is unknown; the message suggests the nearest.
        ValueError
            If a value is out of its range, or weights of the report's cost are set and another reward is paid.
        """
        chosen = task_from(kind, task, _OWN_KEYWORDS, reward)
        return CartDoublePendulumEnv(
            chosen, rig, reward=reward, forces=forces, observation=observation, render_mode=render_mode
        )

    return make


def _shaped_maker(setup: Callable[[Rig], tuple[Task, Rig]]) -> Callable[..., CartDoublePendulumEnv]:
    """Return the entry point that makes environments as the shipped deep policies saw them."""

    def make(rig: Rig | str = "gustafsson2016", *, render_mode: str | None = None) -> CartDoublePendulumEnv:
        """Make the environment.

        Raises
        ------
        ValueError
            If the rig describes several plants or has no force limit.
        """
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


def task_from(
    kind: type[Balance] | type[SwingUp],
    parameters: Mapping[str, Any],
    others: tuple[str, ...],
    reward: str | Reward,
) -> Balance | SwingUp:
    """Build a task from keywords.

    Parameters
    ----------
    kind : type
        ``Balance`` or ``SwingUp``.
    parameters : mapping
        Its parameters by name.
    others : tuple of str
        What else the caller takes, to be suggested where it is near.
    reward : str or callable
        Which reward is paid.

    Raises
    ------
    TypeError
        If the task has no parameter of that name; the message suggests the nearest.
    ValueError
        If it is a weight of the report's cost, and another reward is paid.
    """
    known = {field.name for field in fields(kind)}
    for name in parameters:
        if name not in known:
            raise TypeError(
                f"A {kind.__name__} environment has no parameter {name!r}.{suggestion(name, known | set(others))}"
            )
        if name in ("state_weights", "failure_cost") and reward != "report":
            raise ValueError(f'{name} is of the report\'s cost and does nothing here; add reward="report".')
    return kind(**parameters)


def checked_forces(forces: npt.ArrayLike | None, rig: Rig) -> Array | None:
    """Return the forces that discrete actions choose from, or None for continuous actions.

    Raises
    ------
    ValueError
        If the forces are not two or more finite numbers within the force limit; or, without forces, if there is no
        force limit of which an action could be a share.
    """
    limit = float(np.min(rig.force_limit))
    if forces is None:
        if not np.isfinite(rig.force_limit).all():
            raise ValueError(
                f"A continuous action is a share of the force limit: expected a finite one; got {rig.force_limit!r}. "
                "Set it with rig.replace(force_limit=...), in N, or pass forces=[...] to choose from."
            )
        return None
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


def action_space(forces: Array | None) -> spaces.Space[Any]:
    """Return the space of indices of forces, or of shares of the force limit."""
    return spaces.Box(-1.0, 1.0, (1,), dtype=np.float32) if forces is None else spaces.Discrete(len(forces))


def observation_space(observation: str) -> spaces.Space[Array]:
    """Return the space of observations.

    Raises
    ------
    ValueError
        If there is no such kind of observation.
    """
    trig = checked_name("observation", observation, ("raw", "trig", "scaled")) != "raw"
    high = np.array([np.inf, 1.0, 1.0, 1.0, 1.0, np.inf, np.inf, np.inf]) if trig else np.full(6, np.inf)
    return spaces.Box(-high, high, dtype=np.float64)  # type: ignore[return-value]  # Box does not know its own dtype


def observer(observation: str, rig: Rig) -> Callable[[Array], Array]:
    """Return the function from measured states ``(n, 6)`` to observations.

    Raises
    ------
    ValueError
        If scaled observations are asked for on several rigs.
    """
    if observation == "raw":
        return np.asarray
    scaled = observation == "scaled"
    return partial(
        observe, scales=observation_scales(single_rig(rig, 'observation="scaled"')) if scaled else np.ones(4)
    )


def checked_rewards(rewards: npt.ArrayLike, n: int) -> Array:
    """Return rewards as an array ``(n,)``.

    Raises
    ------
    ValueError
        If a user's function returned something else.
    """
    try:
        array = np.asarray(rewards, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != (n,):
        raise ValueError(f"A reward function returns one number per row, shape ({n},); got {rewards!r}.")
    return array


def with_length(spec: EnvSpec | None, task: Task) -> EnvSpec | None:
    """Return a specification that says how long an episode lasts at most."""
    return spec and replace(spec, max_episode_steps=task.steps)


def check_render_mode(render_mode: str | None, known: list[str]) -> None:
    """Refuse a way of rendering that there is not.

    Raises
    ------
    ValueError
        Unless it is None or known.
    """
    if render_mode is not None and not (isinstance(render_mode, str) and render_mode in known):
        raise ValueError(f"render_mode must be None or one of {', '.join(map(repr, known))}; got {render_mode!r}.")


def frames_per_second(rig: Rig) -> int:
    """Return the number of samples in a second, at least one: a film of all of them runs at the true speed."""
    return max(1, round(1 / rig.sample_time))


def check_options(options: Mapping[str, Any] | None, known: tuple[str, ...]) -> None:
    """Refuse options of a reset that there are not.

    Raises
    ------
    ValueError
        If one is unknown; the message suggests the nearest.
    TypeError
        If they are no mapping.
    """
    if options is not None and not isinstance(options, Mapping):
        raise TypeError(f"options of reset must be a dict, of {', '.join(map(repr, known))}; got {options!r}.")
    for name in options or ():
        if name not in known:
            raise ValueError(f"reset has no option {name!r}.{suggestion(str(name), known)}")


def check_starts(x0: Array, task: Task, rig: Rig) -> None:
    """Refuse initial states ``(n, 6)`` in which the episode would be over.

    Raises
    ------
    ValueError
        If the task ends in one of them.
    """
    codes = task.ended(x0, rig)
    if codes.any():
        row = int(np.flatnonzero(codes)[0])
        raise ValueError(f"An episode cannot start where it ends; got x0 = {x0[row].tolist()}: {_MESSAGES[codes[row]]}")


def noise_seed(env: gym.Env[Any, Any] | gym.vector.VectorEnv[Any, Any, Any]) -> int:
    """Return the seed of the noise: the environment's own, or a number from the generator that replaced it."""
    seed = env.np_random_seed
    if not isinstance(seed, int) or seed < 0:  # Gymnasium's sign of a generator whose seed it does not know
        return int(env.np_random.integers(2**63))
    return seed
