"""The Gymnasium vector environments: many copies of one of the environments of :mod:`dpend.env` over one stepper."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.error import InvalidAction, ResetNeeded
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from .arguments import checked_name, checked_whole
from .env import RigEnvironment, fresh_stepper, task_from
from .kernels import compiled
from .params import Array
from .rewards import Reward
from .rig import Rig, as_rig, single_rig
from .shaping import Mixture, shaped_balance, shaped_swing_up
from .tasks import Balance, SwingUp, Task, checked_task

Flags = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.intp]

_MOST_PICTURES = 64


@compiled
def _pick(forces, indices, picked):
    """Fill in the force of every index, and return whether there is one for each."""
    last = len(forces) - 1
    good = True
    for i in range(len(indices)):
        good &= (indices[i] >= 0) & (indices[i] <= last)
        picked[i] = forces[min(max(indices[i], 0), last)]
    return good


@compiled
def _tally(codes, rewards, begun, length, steps, terminated, truncated, over):
    """Count a sample and fill in which copies it ended; return their number.

    To copies that have just begun it brought nothing.
    """
    for i in range(len(codes)):
        steps[i] += 1
        terminated[i] = codes[i] != 0
        truncated[i] = steps[i] >= length
    for i in begun:
        codes[i] = 0
        steps[i] = 0
        rewards[i] = 0.0
        terminated[i] = False
        truncated[i] = False
    count = 0
    for i in range(len(codes)):
        if terminated[i] | truncated[i]:
            over[count] = i
            count += 1
    return count


class CartDoublePendulumVectorEnv(  # pyright: ignore[reportIncompatibleVariableOverride]
    RigEnvironment, gym.vector.VectorEnv[Array, Any, npt.NDArray[Any]]
):
    """Copies of :class:`~dpend.env.CartDoublePendulumEnv`, stepped together.

    Observations ``(n, 6)`` or ``(n, 8)``, rewards ``(n,)`` and flags ``(n,)`` are those of single environments in
    Gymnasium's ``SyncVectorEnv``; without noise a copy
    does, bit for bit, what a single environment does from the same start.  Every
    array returned belongs to the caller.  ``infos`` describes episodes that are over: ``"status"``, the index of what
    ended them in ``list(dpend.Status)``, and ``"success"``, with the masks ``"_status"`` and ``"_success"``.  True
    states and applied forces are attributes.

    One generator draws the starts of all copies.  ``reset(seed=s)`` restarts all random numbers, the noise of
    :func:`dpend.simulate_many` with ``seed=s`` included.  ``reset(options=...)`` takes ``"x0"``, one state (6,) or one
    a copy (n, 6), and ``"reset_mask"``, a bool array (n,) that says which copies begin again.

    Parameters
    ----------
    task : Task
        Where episodes start, what they cost, when they end.
    rig : Rig or str
        The rig, the name of a preset, or a rig with array fields (n,): one a copy.
    num_envs : int
        How many copies.
    reward, forces, observation
        See :class:`~dpend.env.CartDoublePendulumEnv`; actions are ``(n,)`` indices or ``(n, 1)`` shares.
    autoreset_mode : gymnasium.vector.AutoresetMode
        When a copy that has ended begins again: in the step after, whose action it ignores; in the same step, with the
        last observation and info of the episode in ``infos["final_obs"]`` and ``infos["final_info"]``; or when
        :meth:`reset` is called with a mask.
    render_mode : {"rgb_array"}, optional
        Whether :meth:`render` returns pictures; for 64 copies at most.

    Attributes
    ----------
    state : ndarray (n, 6)
        The true states; new at each reading.
    force : ndarray (n,)
        The forces last applied, N; new at each reading.

    Raises
    ------
    TypeError, ValueError
        If an argument is wrong; the message says what was expected.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": ["rgb_array"],
        "render_fps": 50,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        task: Task,
        rig: Rig | str,
        num_envs: int = 1,
        *,
        reward: str | Reward = "default",
        forces: npt.ArrayLike | None = None,
        observation: str = "raw",
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
    ) -> None:
        num_envs = checked_whole("num_envs", num_envs)
        self.task = checked_task(task)
        self.rig = as_rig(rig)
        if self.rig.n not in (None, num_envs):
            raise ValueError(f"The rig describes {self.rig.n} rows; expected num_envs, which is {num_envs}.")
        self.num_envs = num_envs
        self.single_action_space, self.single_observation_space = self._set_up(
            num_envs, reward, forces, observation, render_mode
        )
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        if render_mode is not None and num_envs > _MOST_PICTURES:
            raise ValueError(
                f"Rendering draws every copy: expected at most {_MOST_PICTURES} with render_mode={render_mode!r}; "
                f"got num_envs={num_envs}."
            )
        if not isinstance(autoreset_mode, AutoresetMode):
            checked_name("autoreset_mode", autoreset_mode, [mode.value for mode in AutoresetMode])
        self._mode = AutoresetMode(autoreset_mode)
        self.metadata = self.metadata | {"autoreset_mode": self._mode}
        self._rig_each = self.rig.n is not None
        self._steps = np.zeros(num_envs, dtype=np.int64)
        self._force_limits = np.full(self.num_envs, self.rig.force_limit)
        self._over: Indices = np.empty(0, dtype=np.intp)
        self._over_ahead: Indices = np.empty(self.num_envs, dtype=np.intp)
        # The last measurements, for copies that a mask leaves alone; perfect sensors show the state, which is at hand.
        self._imperfect = any(
            np.any(field) for field in (self.rig.sensor_delay, self.rig.sensor_noise, self.rig.resolution)
        )
        self._seen = np.zeros((self.num_envs, 6))
        self._ahead = np.empty((0, 6))
        self._used = 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Begin an episode in every copy, or in those of a mask; return observations of all copies, and an empty dict.

        The class says what the options are; a seed does not go with a mask.

        Raises
        ------
        TypeError, ValueError
            If an option is unknown or wrong, or an episode would end where it starts; all go on as they were.
        gymnasium.error.ResetNeeded
            If there is a mask, and copies that never began.
        """
        x0 = self._start_asked_for(options, ("x0", "reset_mask"), self.num_envs)
        mask = np.ones(self.num_envs, dtype=np.bool_)
        if options and "reset_mask" in options:
            mask = self._checked_mask(options["reset_mask"])
            if seed is not None:
                raise ValueError(
                    "A seed restarts the random numbers of all copies, a reset_mask begins some: pass one or the other."
                )
            if self._stepper is None:
                raise ResetNeeded("There are no episodes yet: call reset() without a reset_mask first.")
        super().reset(seed=seed)
        if self._stepper is None or seed is not None:
            self._stepper = fresh_stepper(self, self.num_envs)
            self._ahead = self._ahead[:0]
        rows = np.flatnonzero(mask)
        y = self._begin(rows, None if x0 is None else x0[rows])
        self._over = self._over[~mask[self._over]]
        if self._imperfect:
            self._seen[rows] = y
        return self._observe(self._seen.copy() if self._imperfect else self.state), {}

    def step(self, actions: Any) -> tuple[Array, npt.NDArray[np.float64], Flags, Flags, dict[str, Any]]:
        """Hold a force for one sample in every copy; return observations, rewards, terminated, truncated and infos.

        Raises
        ------
        gymnasium.error.ResetNeeded
            If there are no episodes yet, or a copy has ended that is not reset by itself.
        gymnasium.error.InvalidAction
            If actions are not finite, of another shape, or not indices of forces.
        """
        stepper = self._stepper
        if stepper is None:
            raise ResetNeeded("There are no episodes yet: call reset() before step().")
        if self._mode is AutoresetMode.DISABLED and len(self._over):
            raise ResetNeeded(
                f"{len(self._over)} episodes are over, the first in copy {self._over[0]}: call "
                'reset(options={"reset_mask": terminated | truncated}) before the next step().'
            )
        before = stepper.x.copy() if self._reward_looks_back else stepper.x
        y = stepper.step(self._commands(actions))
        codes = self.task.ended(stepper.x, self.rig)
        rewards = self._paid(before, stepper, codes).copy()
        self._upright.tick(stepper.x)
        begun = self._over  # none but with AutoresetMode.NEXT_STEP
        if len(begun):
            y[begun] = self._begin(begun)
        terminated = np.empty(self.num_envs, dtype=np.bool_)
        truncated = np.empty(self.num_envs, dtype=np.bool_)
        count = _tally(codes, rewards, begun, self._length, self._steps, terminated, truncated, self._over_ahead)
        self._over = over = self._over_ahead[:count].copy()
        infos: dict[str, Any] = {}
        if len(over):
            success = np.zeros(self.num_envs, dtype=np.bool_)
            success[over] = truncated[over] & self._upright.success(codes, over)
            done = terminated | truncated
            ends = {"status": codes, "_status": done, "success": success, "_success": done.copy()}
            if self._mode is AutoresetMode.SAME_STEP:
                infos = self._finals(y, ends, done)
                y[over] = self._begin(over)
                self._over = over[:0]
            else:
                infos = ends
        if self._imperfect:
            self._seen[:] = y
        return self._observe(y), rewards, terminated, truncated, infos

    @property
    def state(self) -> Array:
        """The true states ``(n, 6)``; zero before the first reset."""
        return np.zeros((self.num_envs, 6)) if self._stepper is None else self._stepper.x.copy()

    @property
    def force(self) -> Array:
        """The forces last applied ``(n,)``, N; zero where an episode has just begun."""
        return np.zeros(self.num_envs) if self._stepper is None else self._stepper.force.copy()

    def _finals(self, y: Array, ends: dict[str, Any], done: Flags) -> dict[str, Any]:
        """Return the last observations and infos of the episodes that are over."""
        over = self._over
        final_obs = np.empty(self.num_envs, dtype=object)
        for row, seen in zip(over, self._observe(y[over]), strict=True):
            final_obs[row] = seen
        state, force = np.zeros((self.num_envs, 6)), np.zeros(self.num_envs)
        state[over], force[over] = self.state[over], self.force[over]
        final_info = {"state": state, "_state": done.copy(), "force": force, "_force": done.copy()} | ends
        return {
            "final_obs": final_obs,
            "_final_obs": done.copy(),
            "final_info": final_info,
            "_final_info": done.copy(),
        }

    def _begin(self, rows: Indices, x0: Array | None = None) -> Array:
        """Set some copies to the start of an episode; return their measurements."""
        assert self._stepper is not None
        if x0 is None:
            x0 = self._starts(rows)
        self._steps[rows] = 0
        self._upright.begin(x0, rows)
        return self._stepper.reset(x0, rows)

    def _starts(self, rows: Indices) -> Array:
        """Draw initial states; as many ahead as there are copies, since a few episodes end at every step."""
        if self._rig_each:
            return self.task.starts(self.np_random, self.num_envs, self.rig)[rows]
        self._used += len(rows)
        if self._used > len(self._ahead):
            self._ahead = self.task.starts(self.np_random, self.num_envs, self.rig)
            self._used = len(rows)
        return self._ahead[self._used - len(rows) : self._used]

    def _commands(self, actions: Any) -> Array:
        """Return the forces in N, ``(n,)``, that actions ask for."""
        given = np.asarray(actions)
        if self._forces is None:
            if given.shape == (self.num_envs, 1) and given.dtype.kind in "fiu":
                forces = given[:, 0].astype(np.float64)
                forces *= self._force_limits
                if np.isfinite(forces).all():
                    return forces
            raise InvalidAction(
                f"Actions are shares of the force limit: expected an array of shape ({self.num_envs}, 1) with finite "
                f"numbers, -1 to 1; got {_described(given)}."
            )
        if given.shape == (self.num_envs,) and given.dtype.kind in "iu":
            forces = np.empty(self.num_envs)
            if _pick(self._forces, given.astype(np.intp, copy=False), forces):
                return forces
        raise InvalidAction(
            f"Actions are indices of forces: expected an array of shape ({self.num_envs},) with whole numbers, "
            f"0 to {len(self._forces) - 1}; got {_described(given)}."
        )

    def _checked_mask(self, mask: Any) -> Flags:
        """Refuse what is not a mask of copies, by the exceptions that Gymnasium has for it."""
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_:
            raise TypeError(f"reset_mask must be a numpy array of bool; got {mask!r}.")
        if mask.shape != (self.num_envs,) or not mask.any():
            raise ValueError(f"reset_mask must have shape ({self.num_envs},) and at least one true; got {mask!r}.")
        return mask

    def render(self) -> tuple[npt.NDArray[np.uint8], ...] | None:
        """Return a picture ``(H, W, 3)`` of every copy's true state and the force applied; None without a render mode.

        Raises
        ------
        gymnasium.error.ResetNeeded
            If there is no state to draw.
        """
        if self.render_mode is None:
            gym.logger.warn('There is no render_mode to render in: make the environments with render_mode="rgb_array".')
            return None
        if self._stepper is None:
            raise ResetNeeded("There are no episodes yet: call reset() before render().")
        if not self._pictures:
            from .draw import Picture  # matplotlib loads with the first picture

            one, n = self.rig.n is None, self.num_envs
            self._pictures = [Picture(self.rig)] * n if one else [Picture(self.rig.rows(row)) for row in range(n)]
        states = zip(self._pictures, self._stepper.x, self._stepper.force, strict=True)
        return tuple(picture.rgb(x, float(force)) for picture, x, force in states)

    def close_extras(self, **kwargs: Any) -> None:
        """Let go of the pictures."""
        self._pictures = []


def _described(array: npt.NDArray[Any]) -> str:
    """Describe an array of actions or flags in short."""
    values = f", values {array.min():g} to {array.max():g}" if array.size and array.dtype.kind in "fiu" else ""
    return f"shape {array.shape}, dtype {array.dtype}{values}"


def _maker(kind: type[Balance] | type[SwingUp]) -> Callable[..., CartDoublePendulumVectorEnv]:
    """Return the entry point that makes copies of one task's environment from its parameters and the environment's own.

    ``max_episode_steps`` is what Gymnasium calls the task's ``steps``.
    """

    def make(
        num_envs: int = 1, rig: Rig | str = "gustafsson2016", *, max_episode_steps: int | None = None, **options: Any
    ) -> CartDoublePendulumVectorEnv:
        if max_episode_steps is not None:
            checked_whole("max_episode_steps", max_episode_steps)
        if max_episode_steps is not None and options.setdefault("steps", max_episode_steps) != max_episode_steps:
            raise ValueError(
                f"max_episode_steps and steps are one number; got {max_episode_steps!r} and {options['steps']!r}."
            )
        task = task_from(kind, CartDoublePendulumVectorEnv, options, "max_episode_steps")
        return CartDoublePendulumVectorEnv(task, rig, num_envs, **options)

    return make


def _shaped_maker(setup: Callable[[Rig], tuple[Mixture, Rig]]) -> Callable[..., CartDoublePendulumVectorEnv]:
    """Return the entry point that makes copies as the shipped deep policies saw them."""

    def make(
        num_envs: int = 1,
        rig: Rig | str = "gustafsson2016",
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
    ) -> CartDoublePendulumVectorEnv:
        task, slow = setup(single_rig(rig, "A shaped environment"))
        if max_episode_steps is not None:
            task = replace(task, steps=checked_whole("max_episode_steps", max_episode_steps))
        modes: dict[str, Any] = {"autoreset_mode": autoreset_mode, "render_mode": render_mode}
        return CartDoublePendulumVectorEnv(task, slow, num_envs, reward="shaped", observation="scaled", **modes)

    return make


balance_vector = _maker(Balance)
"""Make copies of ``dpend/Balance-v0``."""

swing_up_vector = _maker(SwingUp)
"""Make copies of ``dpend/SwingUp-v0``."""

balance_shaped_vector = _shaped_maker(shaped_balance)
"""Make copies of ``dpend/BalanceShaped-v0``."""

swing_up_shaped_vector = _shaped_maker(shaped_swing_up)
"""Make copies of ``dpend/SwingUpShaped-v0``."""
