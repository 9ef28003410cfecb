# pyright: reportMissingImports=false
r"""The JAX instances of the equations: samples, rollouts and a functional environment that ``vmap`` and ``jit`` take.

The dynamics are :func:`dpend.equations.make_rates` as they stand.  Costs and rewards are those of :mod:`dpend.episode`
as well; what branches there, the status code and the count of upright samples, is stated here without branches, and a
test holds it to :class:`dpend.env.CartDoublePendulumEnv`.  Numbers have JAX's precision: single, unless
``jax_enable_x64`` is set.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

try:
    import jax
    import jax.numpy as jnp
except ImportError as error:
    raise ImportError("dpend.jax_plant needs JAX, the extra `jax`: pip install -e '.[jax]'") from error

from . import episode, equations
from .arguments import checked_name
from .rig import Rig, as_rig, single_rig
from .status import Status
from .tasks import STARTS, Balance, SwingUp
from .trigonometry import make_sines

# XLA calls the library for each sine in double precision, and does so anew in every kernel that needs it.
_sines = make_sines(jnp.rint)
_rates = equations.make_rates(*_sines)
_rk4 = equations.make_rk4(_rates)
_rk4_without_coulomb = equations.make_rk4(equations.make_rates(*_sines, equations.no_coulomb))


def _wrap_angle(angle: Any) -> Any:
    turn = 2 * np.pi
    return angle - turn * jnp.rint(angle / turn)


_report_cost = episode.make_report_cost(_wrap_angle)
_links_upright = episode.make_links_upright(_wrap_angle)
_upright_reward = episode.make_upright_reward(jnp.cos, jnp.exp)


def rates(x: Any, f: Any, coefficients: Any) -> Any:
    r"""Return :math:`\dot x`, ``(..., 6)``, of states under generalised forces ``(..., 3)``.

    ``coefficients`` are :class:`dpend.params.Coefficients` of numbers, or of arrays that broadcast against ``(...)``; a
    derivative with respect to them is JAX's.
    """
    f = jnp.asarray(f)
    derivatives = _rates(jnp.moveaxis(jnp.asarray(x), -1, 0), (f[..., 0], f[..., 1], f[..., 2]), coefficients)
    return jnp.stack(jnp.broadcast_arrays(*derivatives), axis=-1)


def step(rig: Rig, x: Any, u: Any) -> Any:
    """Return states ``(..., 6)`` a sample later, under forces on the cart ``(...)``, N.

    The rig limits the forces; its sensors and actuator are ideal.  A rig of ``(N,)`` rows takes states ``(N, 6)``.
    """
    state = jnp.broadcast_arrays(*jnp.moveaxis(jnp.asarray(x, dtype=float), -1, 0), jnp.asarray(u, dtype=float))
    return jnp.stack(_sample(rig, tuple(state[:6]), state[6]), axis=-1)


def _sample(rig: Rig, x: Any, u: Any) -> Any:
    """Return six arrays a sample later; a loop and no stacks, or XLA computes a step anew for each of its results."""
    f, h = (jnp.clip(u, -rig.force_limit, rig.force_limit), 0.0, 0.0), rig.sample_time / rig.substeps
    c = rig.params.coefficients()
    rk4 = _rk4 if np.any(c.coulomb) else _rk4_without_coulomb  # a root takes XLA as long as all else
    return jax.lax.fori_loop(0, rig.substeps, lambda _, x: rk4(x, f, c, h), x)


def rollout(rig: Rig | str, law: Callable[[Any, Any], Any], x0: Any, steps: int) -> tuple[Any, Any]:
    r"""Return the closed loop :math:`x_{k+1} = F(x_k, \mathrm{law}(t_k, x_k))`, by ``lax.scan``.

    Parameters
    ----------
    rig : Rig or str
        An ideal rig, or the name of a preset.
    law : callable
        ``law(t, x)``, in JAX: time in s and states ``(..., 6)`` to forces ``(...)`` in N.
    x0 : array_like
        States ``(..., 6)``.
    steps : int
        Number of samples.

    Returns
    -------
    x : Array (steps + 1, ..., 6)
    u : Array (steps, ...)
        Forces as applied, N.

    Raises
    ------
    ValueError
        If the rig has noise, lag, delays or rounding.
    """
    rig = _ideal(as_rig(rig))

    def sample(x: Any, k: Any) -> Any:
        u = jnp.clip(law(k * rig.sample_time, jnp.stack(x, axis=-1)), -rig.force_limit, rig.force_limit)
        after = _sample(rig, x, u)
        return after, (after, u)

    start = tuple(jnp.moveaxis(jnp.asarray(x0, dtype=float), -1, 0))
    _, (x, u) = jax.lax.scan(sample, start, jnp.arange(steps))
    return jnp.stack([jnp.concatenate([one[None], all_]) for one, all_ in zip(start, x, strict=True)], axis=-1), u


def _ideal(rig: Rig) -> Rig:
    if not rig.ideal:
        raise ValueError(
            "In JAX actuator and sensors are ideal; take dpend.rig.ideal_rig(rig, limits=True) of this rig."
        )
    return rig


class State(NamedTuple):
    """An episode on its way: the state ``(6,)``, its samples so far, and those since when both links are up."""

    x: Any
    steps: Any
    held: Any


@dataclass(frozen=True, kw_only=True, eq=False)
class Environment:
    """A task on an ideal rig in the form of Gymnax: pure functions of keys, states and actions.

    Observations are states ``(6,)``, actions shares of the force limit, ``()`` or ``(1,)``.  ``jax.vmap`` makes many
    copies of it and ``jax.jit`` compiles them.

    Parameters
    ----------
    task : Balance or SwingUp
        Where episodes start, what they cost, when they end.
    rig : Rig or str
        One ideal rig with a limit of the force, or the name of a preset.
    reward : {"default", "report"}
        As :mod:`dpend.rewards` has them.

    Raises
    ------
    TypeError, ValueError
        If an argument is wrong.
    """

    task: Balance | SwingUp
    rig: Rig
    reward: str = "default"
    _rule: episode.Rule = field(init=False, repr=False)

    def __post_init__(self) -> None:
        rig = _ideal(single_rig(self.rig, "dpend.jax_plant.Environment"))
        if not np.isfinite(rig.force_limit):
            raise ValueError(
                "Actions are shares of the force limit, and this rig has none; use rig.replace(force_limit=...)."
            )
        if not isinstance(self.task, Balance | SwingUp):
            raise TypeError(f"task must be a dpend.Balance or a dpend.SwingUp; got {self.task!r}.")
        checked_name("reward", self.reward, ("default", "report"))
        object.__setattr__(self, "rig", rig)
        object.__setattr__(self, "_rule", episode.rule_of(self.task, rig))

    def reset(self, key: Any) -> tuple[Any, State]:
        """Return the observation and the state of a new episode, drawn by a key."""
        return self.begin(self._start(key))

    def begin(self, x0: Any) -> tuple[Any, State]:
        """Return the observation and the state of an episode that starts in a state ``(6,)``."""
        x = jnp.asarray(x0, dtype=float)
        return x, State(x, jnp.array(0), jnp.where(self._upright(x), 0, -1))

    def step(self, key: Any, state: State, action: Any) -> tuple[Any, State, Any, Any, dict[str, Any]]:
        """Return observation, state, reward, whether the episode is over, and info; what is over begins again.

        ``info`` is that of :meth:`step_env`; the key draws the start of the next episode.
        """
        obs, state, reward, done, info = self.step_env(state, action)
        fresh = self.reset(key)
        obs, state = jax.tree.map(lambda new, old: jnp.where(done, new, old), fresh, (obs, state))
        return obs, state, reward, done, info

    def step_env(self, state: State, action: Any) -> tuple[Any, State, Any, Any, dict[str, Any]]:
        """Return the same without a new start.

        ``info`` has the ``status``, a code of :class:`dpend.Status`, ``terminated``, ``truncated``, ``success``, and as
        ``final_obs`` the observation at the end of the sample.
        """
        rig, rule = self.rig, self._rule
        x = step(rig, state.x, rig.force_limit * jnp.reshape(action, ()))
        code = self._status(x)
        steps, held = state.steps + 1, jnp.where(self._upright(x), state.held + 1, -1)
        terminated, truncated = code != 0, steps >= self.task.steps
        success = truncated & episode.succeeded(code, held, rule.hold)
        info = {"status": code, "terminated": terminated, "truncated": truncated, "success": success, "final_obs": x}
        return x, State(x, steps, held), self._paid(x, code), terminated | truncated, info

    def _start(self, key: Any) -> Any:
        task, keys = self.task, jax.random.split(key, 3)
        angles = jax.random.uniform(keys[0], (2,), minval=-1.0, maxval=1.0)
        zero, rest = jnp.zeros(1), jnp.zeros(3)
        if isinstance(task, Balance):
            return jnp.concatenate([zero, jnp.array(task.angle_spreads) * angles, rest])
        if task.start != "anywhere":
            return jnp.concatenate([zero, STARTS[task.start][1:3] + task.angle_spread * angles, rest])
        reach = 0.5 * self.rig.track_limit if np.isfinite(self.rig.track_limit) else 1.0
        pos = reach * jax.random.uniform(keys[1], (1,), minval=-1.0, maxval=1.0)
        return jnp.concatenate([pos, np.pi * angles, jax.random.normal(keys[2], (3,))])

    def _upright(self, x: Any) -> Any:
        return _links_upright(x, self._rule.target, self._rule.upright_angle)

    def _status(self, x: Any) -> Any:
        """Return what :func:`dpend.episode.status_code` does, without branches."""
        on_track, up1, up2 = (abs(x[i]) <= bound for i, bound in enumerate(self._rule.bounds))
        fell = jnp.where(up1, Status.LINK2_FELL.code, Status.LINK1_FELL.code)
        beyond = jnp.where(on_track, fell, Status.TRACK_END.code)
        beyond = jnp.where(jnp.isfinite(x).all(), beyond, Status.NOT_FINITE.code)
        return jnp.where(on_track & up1 & up2, 0, beyond)

    def _paid(self, x: Any, code: Any) -> Any:
        rule, params = self._rule, self.rig.params
        if self.reward == "report":
            return -_report_cost(x, 0, rule.target, rule.weights, 0.0) - jnp.where(code != 0, rule.failure_cost, 0.0)
        if isinstance(self.task, Balance):
            return jnp.where(code == 0, 1.0, 0.0)
        slowness = (params.length1 + params.length2) / params.gravity
        return jnp.where(code == 0, _upright_reward(x, 0, rule.target, slowness), 0.0)
