"""A vector environment is many single ones: bit for bit, and by Gymnasium's own rules for ending and beginning anew."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import InvalidAction, ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from numpy.testing import assert_array_equal
from rigs import whole

import dpend
from dpend import Act, Balance, Rig, Status, SwingUp
from dpend.draw import Picture
from dpend.env import CartDoublePendulumEnv, balance
from dpend.params import Array
from dpend.tasks import NoTask
from dpend.vector_env import CartDoublePendulumVectorEnv, balance_vector, swing_up_vector

RIG = dpend.rig("gustafsson2016")
NOISY = RIG.replace(sensor_noise=0.01, force_noise=0.5, sensor_delay=1, actuator_delay=1, actuator_lag=0.01)
MODES = tuple(AutoresetMode)
FORCES = [-40.0, -5.0, 5.0, 40.0]


class Falling(Balance):
    """Balancing that always begins alike, and soon ends: what a copy does is then up to its actions alone."""

    def starts(self, rng: np.random.Generator, n: int, rig: Rig) -> Array:
        return np.tile([0.0, 0.5, -0.4, 0.0, 1.0, 0.5], (n, 1))


class Holding(SwingUp):
    """A short swing-up that always begins upright, but not at rest: some copies stay up long enough."""

    def starts(self, rng: np.random.Generator, n: int, rig: Rig) -> Array:
        return np.tile([0.0, 0.1, -0.05, 0.0, 0.5, 0.0], (n, 1))


TASKS = (Falling(steps=20, failure_cost=3.0), Holding(steps=7, hold=0.1, upright_angle=0.15))


def random_actions(envs: Any, steps: int, seed: int = 0) -> list[Any]:
    envs.action_space.seed(seed)
    return [envs.action_space.sample() for _ in range(steps)]


def observed(envs: Any, steps: int = 60, *, seed: int | None = 0) -> Array:
    """Return the observations ``(steps + 1, n, ...)`` under random actions."""
    return np.array([envs.reset(seed=seed)[0], *(envs.step(actions)[0] for actions in random_actions(envs, steps))])


# ----------------------------------------------------------------------------------------------- each copy a single one


@pytest.mark.parametrize("task", [Balance(lam=0.4), SwingUp(start="anywhere", steps=60)])
@pytest.mark.parametrize("forces", [None, FORCES])
@pytest.mark.parametrize("observation", ["raw", "trig"])
@pytest.mark.parametrize(
    "rig", [RIG, RIG.replace(mass2=np.linspace(0.3, 0.7, 5), track_limit=np.linspace(1.0, 2.0, 5))]
)
def test_a_copy_does_bit_for_bit_what_a_single_environment_does_from_the_same_start(
    task: Balance | SwingUp, forces: list[float] | None, observation: str, rig: Rig
) -> None:
    n = 5
    envs = CartDoublePendulumVectorEnv(
        task, rig, n, forces=forces, observation=observation, autoreset_mode=AutoresetMode.SAME_STEP
    )
    singles = [CartDoublePendulumEnv(task, rig.rows(i), forces=forces, observation=observation) for i in range(n)]
    envs.reset(seed=0)
    x0 = envs.state
    for i, env in enumerate(singles):
        env.reset(options={"x0": x0[i]})
    alive = np.ones(n, dtype=np.bool_)
    for actions in random_actions(envs, 60):
        y, rewards, terminated, truncated, infos = envs.step(actions)
        for i in np.flatnonzero(alive):
            one = singles[i].step(actions[i])
            alive[i] = not (one[2] or one[3])
            assert_array_equal(y[i] if alive[i] else infos["final_obs"][i], one[0])
            assert (rewards[i], terminated[i], truncated[i]) == one[1:4]
            if alive[i]:
                assert_array_equal(envs.state[i], one[4]["state"])
                assert envs.force[i] == one[4]["force"]
    assert not alive.all()


class Leaning:
    """Push with 10 N to where the links lean."""

    def start(self, n: int, rng: np.random.Generator) -> Act:
        return lambda t, y: 10.0 * np.sign(self.lean(y))

    @staticmethod
    def lean(y: Array) -> Array:
        return y @ np.array([2.0, 60.0, -90.0, 3.0, 1.0, -12.0])


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize("rig", [RIG, NOISY])
@pytest.mark.parametrize(
    "task", [Balance(steps=20), *(SwingUp(steps=10, hold=hold, upright_angle=0.4) for hold in (0.1, 0.2))]
)
def test_a_law_ends_as_it_does_in_simulate_many_noise_included(
    mode: AutoresetMode, rig: Rig, task: Balance | SwingUp
) -> None:
    n = 500
    x0 = np.random.default_rng(0).uniform(-1, 1, (n, 6)) * [2.3, 0.5, 0.5, 0.5, 1, 1]
    envs = CartDoublePendulumVectorEnv(task, rig, n, forces=[-10.0, 10.0], autoreset_mode=mode)
    y, _ = envs.reset(seed=3, options={"x0": x0})
    runs = dpend.simulate_many(rig, Leaning(), x0, task=task, seed=3)
    steps, codes = np.zeros(n, dtype=int), np.zeros(n, dtype=int)
    success = np.zeros(n, dtype=np.bool_)
    for k in range(1, task.steps + 1):
        y, _, terminated, truncated, infos = envs.step((Leaning.lean(y) > 0).astype(int))
        ends = infos.get("final_info", infos)
        first = (terminated | truncated) & (steps == 0)
        if first.any():
            steps[first] = k
            codes[first] = ends["status"][first]
            success[first] = ends["success"][first]
    assert_array_equal(steps, runs.steps)
    assert_array_equal(codes, runs.codes)
    assert_array_equal(success, runs.success)
    assert 0 < success.sum() < n


# ------------------------------------------------------------------------------------------------------------ autoreset


def pair(
    task: Balance | SwingUp, mode: AutoresetMode, forces: list[float] | None, observation: str, n: int = 6
) -> tuple[CartDoublePendulumVectorEnv, Any]:
    """Return the native environment, and Gymnasium's own around single ones."""
    native = CartDoublePendulumVectorEnv(task, RIG, n, forces=forces, observation=observation, autoreset_mode=mode)
    single = [lambda: CartDoublePendulumEnv(task, RIG, forces=forces, observation=observation)] * n
    return native, SyncVectorEnv(single, autoreset_mode=mode)


def said_alike(native: dict[str, Any], sync: dict[str, Any]) -> None:
    """Hold what the infos say of episodes that are over to what Gymnasium makes of single infos."""
    assert ("_success" in native) == ("_success" in sync)
    if "_success" not in sync:
        return
    for key in ("_status", "_success", "success"):
        assert_array_equal(native[key], sync[key])
    over = sync["_status"]
    assert [list(Status)[code].value for code in native["status"][over]] == list(sync["status"][over])
    assert not native["status"][~over].any()


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("forces", [None, FORCES])
@pytest.mark.parametrize("observation", ["raw", "trig"])
def test_copies_end_and_begin_anew_as_gymnasium_has_it(
    mode: AutoresetMode, task: Balance | SwingUp, forces: list[float] | None, observation: str
) -> None:
    native, sync = pair(task, mode, forces, observation)
    assert native.observation_space == sync.observation_space
    assert native.action_space == sync.action_space
    assert native.metadata["autoreset_mode"] is mode
    assert_array_equal(native.reset(seed=0)[0], sync.reset(seed=0)[0])
    ends, successes = np.zeros(2), 0
    for actions in random_actions(native, 80):
        ours, theirs = native.step(actions), sync.step(actions)
        for one, other in zip(ours[:4], theirs[:4], strict=True):
            assert_array_equal(one, other)
            assert one.dtype == other.dtype
        if mode is AutoresetMode.SAME_STEP and "final_obs" in theirs[4]:
            for key in ("_final_obs", "_final_info"):
                assert_array_equal(ours[4][key], theirs[4][key])
            for one, other in zip(ours[4]["final_obs"], theirs[4]["final_obs"], strict=True):
                assert_array_equal(one, other)
            final, expected = ours[4]["final_info"], theirs[4]["final_info"]
            for key in ("state", "_state", "force", "_force"):
                assert_array_equal(final[key], expected[key])
            said_alike(final, expected)
            successes += final["success"].sum()
        else:
            assert "final_obs" not in ours[4]
            said_alike(ours[4], theirs[4])
            successes += ours[4].get("success", np.zeros(1)).sum()
        assert_array_equal(native.state, theirs[4]["state"])
        assert_array_equal(native.force, theirs[4]["force"])
        done = ours[2] | ours[3]
        ends += [ours[2].sum(), ours[3].sum()]
        if mode is AutoresetMode.DISABLED and done.any():
            one, _ = native.reset(options={"reset_mask": done})
            other, _ = sync.reset(options={"reset_mask": done})
            assert_array_equal(one, other)
    assert ends[0] > 2 or isinstance(task, SwingUp)
    assert ends[1] > 2
    assert successes > 2


def test_without_a_length_no_episode_is_cut_short() -> None:
    envs = CartDoublePendulumVectorEnv(NoTask(), RIG, 2)
    envs.reset(seed=0)
    assert not any(envs.step(np.zeros((2, 1)))[3].any() for _ in range(1200))


def test_the_action_of_the_step_in_which_a_copy_begins_anew_is_ignored() -> None:
    envs = balance_vector(2, steps=1)
    envs.reset(seed=0)
    envs.step(np.zeros((2, 1)))
    y, rewards, terminated, truncated, infos = envs.step(np.array([[1.0], [-1.0]]))
    assert not y[:, [0, 3, 4, 5]].any()
    assert_array_equal([rewards, terminated, truncated], np.zeros((3, 2)))
    assert not infos
    assert not envs.force.any()


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("rig", [RIG, NOISY])
def test_a_mask_begins_some_copies_and_leaves_the_others_as_they_were(mode: AutoresetMode, rig: Rig) -> None:
    envs = CartDoublePendulumVectorEnv(Balance(), rig, 4, autoreset_mode=mode)
    envs.reset(seed=0)
    *_, (before, *_) = [envs.step(np.full((4, 1), 0.1)) for _ in range(3)]
    states = envs.state
    mask = np.array([True, False, False, True])
    options = {"reset_mask": mask, "x0": np.arange(4)[:, None] * [0, 0.1, 0.1, 0, 0, 0]}
    y, infos = envs.reset(options=options)
    assert not infos
    assert set(options) == {"reset_mask", "x0"}
    assert_array_equal(y[1:3], before[1:3])
    assert_array_equal(envs.state[1:3], states[1:3])
    assert_array_equal(envs.state[[0, 3]], [[0, 0, 0, 0, 0, 0], [0, 0.1 * 3, 0.1 * 3, 0, 0, 0]])
    assert not np.array_equal(y[[0, 3]], before[[0, 3]])


def test_a_copy_that_ended_and_is_begun_by_a_mask_goes_on_with_the_next_step() -> None:
    envs = balance_vector(2, steps=2)
    envs.reset(seed=0)
    for _ in range(2):
        envs.step(np.zeros((2, 1)))
    envs.reset(options={"reset_mask": np.array([True, False])})
    _, rewards, _, truncated, _ = envs.step(np.zeros((2, 1)))
    assert rewards[0] == 1.0
    assert rewards[1] == 0
    assert not truncated.any()


# ---------------------------------------------------------------------------------------------------------- making them


@pytest.mark.parametrize("name", ["dpend/Balance-v0", "dpend/SwingUp-v0"])
@pytest.mark.parametrize("mode", MODES)
def test_gymnasium_makes_them_with_all_their_keywords(name: str, mode: AutoresetMode) -> None:
    envs = gym.make_vec(name, num_envs=512, vectorization_mode="vector_entry_point", autoreset_mode=mode, steps=30)
    assert isinstance(envs, CartDoublePendulumVectorEnv)
    assert (envs.num_envs, envs.metadata["autoreset_mode"]) == (512, mode)
    assert envs.reset(seed=0)[0].shape == (512, 6)
    y, rewards, terminated, truncated, _ = envs.step(envs.action_space.sample())
    assert y.shape == (512, 6)
    assert rewards.shape == terminated.shape == truncated.shape == (512,)
    assert y in envs.observation_space


def test_native_copies_are_what_gymnasium_makes_by_default_and_single_ones_on_request() -> None:
    assert isinstance(gym.make_vec("dpend/Balance-v0", num_envs=2), CartDoublePendulumVectorEnv)
    assert isinstance(gym.make_vec("dpend/Balance-v0", num_envs=2, vectorization_mode="sync"), SyncVectorEnv)


def test_a_mode_may_be_named_and_gymnasiums_wrappers_fit() -> None:
    envs = balance_vector(3, autoreset_mode="SameStep", steps=5)
    assert envs.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    wrapped = gym.wrappers.vector.RecordEpisodeStatistics(balance_vector(3, steps=5))
    wrapped.reset(seed=0)
    *_, (*_, infos) = [wrapped.step(np.zeros((3, 1))) for _ in range(5)]
    assert infos["episode"]["l"].tolist() == [5, 5, 5]


# ----------------------------------------------------------------------------------------------------------- randomness


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize("make", [balance_vector, swing_up_vector])
@pytest.mark.parametrize("rig", [RIG, NOISY, RIG.replace(track_limit=[2.0, 0.5, 1.0, 2.0])])
def test_the_same_seed_gives_the_same_episodes_noise_included(
    mode: AutoresetMode, make: Callable[..., Any], rig: Rig
) -> None:
    keywords = {"autoreset_mode": mode} | ({} if make is balance_vector else {"start": "anywhere"})
    envs, others = make(4, rig, **keywords), make(4, rig, **keywords)
    first = observed(envs, seed=7)
    assert_array_equal(observed(envs, seed=7), first)
    assert_array_equal(observed(others, seed=7), first)
    assert not np.array_equal(observed(envs, seed=8)[0], first[0])


def test_no_two_copies_and_no_two_episodes_are_alike() -> None:
    envs = balance_vector(4, RIG.replace(sensor_noise=0.01))
    starts, noise = [], []
    for seed in (0, None, None):
        y, _ = envs.reset(seed=seed)
        starts.extend(envs.state)
        noise.extend(y - envs.state)
    for some in (starts, noise):
        assert not any(np.array_equal(a, b) for a, b in combinations(some, 2))


def test_a_seed_restarts_the_starts_that_are_yet_to_come() -> None:
    envs = balance_vector(3)
    later = []
    for _ in range(3):
        envs.reset(seed=0, options={"x0": [[0, 1.57, 0, 0, 1, 0], [0] * 6, [0] * 6]})
        _, (y, *_) = [envs.step(np.zeros((3, 1))) for _ in range(2)]
        later.append(y)
    assert 0 < np.abs(later[0][0, 1:3]).max() <= 0.1
    assert_array_equal(later[1:], [later[0]] * 2)


def test_each_copy_begins_on_its_own_track_every_time() -> None:
    limits = np.array([2.0, 0.02, 2.0])
    envs = swing_up_vector(3, RIG.replace(track_limit=limits), start="anywhere", autoreset_mode="SameStep")
    envs.reset(seed=0)
    begun = np.zeros(3)
    for actions in random_actions(envs, 60):
        _, _, terminated, _, _ = envs.step(actions)
        assert (np.abs(envs.state[terminated, 0]) <= limits[terminated] / 2).all()
        begun += terminated
    assert begun[1] > 10


def test_starts_drawn_ahead_are_spread_as_the_task_spreads_them() -> None:
    envs = balance_vector(64, lam=0.3, steps=2, autoreset_mode="SameStep")
    envs.reset(seed=0)
    starts = []
    for k in range(400):
        envs.step(np.zeros((64, 1)))
        if k % 2:
            starts.append(envs.state[:, 1:3])
    angles = np.concatenate(starts)
    assert len(np.unique(angles, axis=0)) == len(angles)
    assert np.abs(angles).max() <= 0.3
    assert np.abs(angles.mean(axis=0)).max() < 4 * 0.3 / np.sqrt(3 * len(angles))
    assert np.abs(angles.std(axis=0) * np.sqrt(3) / 0.3 - 1).max() < 0.02


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("observation", ["raw", "trig"])
def test_nothing_that_is_returned_shares_memory(mode: AutoresetMode, observation: str) -> None:
    envs = balance_vector(3, observation=observation, autoreset_mode=mode, steps=7)

    def arrays(part: Any) -> list[Any]:
        if isinstance(part, dict):
            return [array for value in part.values() for array in arrays(value)]
        if isinstance(part, np.ndarray) and part.dtype == object:
            return [part, *(each for each in part if each is not None)]
        return [part]

    returned = arrays(envs.reset(seed=0)[0])
    for actions in random_actions(envs, 16):
        y, rewards, terminated, truncated, infos = envs.step(actions)
        returned.extend([y, rewards, terminated, truncated, *arrays(infos), envs.state, envs.force])
        if mode is AutoresetMode.DISABLED and (terminated | truncated).any():
            returned.append(envs.reset(options={"reset_mask": terminated | truncated})[0])
    returned.extend([envs.state, envs.state, envs.force, envs.force])
    assert not any(np.shares_memory(a, b) for a, b in combinations(returned, 2))


@pytest.mark.parametrize("rig", [RIG, NOISY])
def test_writing_into_what_was_returned_changes_nothing(rig: Rig) -> None:
    envs, others = balance_vector(3, rig), balance_vector(3, rig)
    mask = {"reset_mask": np.array([True, False, False])}
    envs.reset(seed=0)[0][:] = np.nan
    others.reset(seed=0)
    for actions in random_actions(envs, 40):
        *ours, infos = envs.step(actions)
        *theirs, _ = others.step(actions)
        for one, other in zip(ours, theirs, strict=True):
            assert_array_equal(one, other)
            one[:] = 1
        for array in (*infos.values(), envs.state, envs.force):
            array[:] = 1
    assert_array_equal(envs.reset(options=mask)[0], others.reset(options=mask)[0])


# ------------------------------------------------------------------------------------------------------------- pictures


@pytest.mark.parametrize("rig", [RIG, RIG.replace(length1=[0.5, 1.0])])
def test_every_copy_has_its_picture(rig: Rig) -> None:
    envs = balance_vector(2, rig, render_mode="rgb_array")
    envs.reset(seed=0, options={"x0": [[0, 0.3, -0.3, 0, 0, 0], [0.5, 0, 0.5, 0, 0, 0]]})
    envs.step(np.array([[1.0], [-0.5]]))
    pictures = envs.render()
    assert isinstance(pictures, tuple)
    for i, picture in enumerate(pictures):
        assert_array_equal(picture, Picture(rig.rows(i)).rgb(envs.state[i], envs.force[i]))
    envs.close()


def test_rendering_without_a_way_to_render_warns() -> None:
    with pytest.warns(UserWarning, match='make the environments with render_mode="rgb_array"'):
        assert balance_vector(2).render() is None


# ------------------------------------------------------------------------------------------------------------ bad input


def _stepped(envs: CartDoublePendulumVectorEnv, actions: Any) -> None:
    envs.reset(seed=0)
    envs.step(actions)


def _reset(options: dict[str, Any], seed: int | None = None) -> None:
    envs = balance_vector(2)
    envs.reset(seed=0)
    envs.reset(seed=seed, options=options)


SHARES = "Actions are shares of the force limit: expected an array of shape (2, 1) with finite numbers, -1 to 1; got "
INDICES = "Actions are indices of forces: expected an array of shape (2,) with whole numbers, 0 to 3; got "


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (
            lambda: balance_vector(2, num_env=2),
            TypeError,
            "A Balance environment has no parameter 'num_env'. Did you mean 'num_envs'?",
        ),
        (
            lambda: swing_up_vector(2, autoreset="NextStep"),
            TypeError,
            "A SwingUp environment has no parameter 'autoreset'. Did you mean 'autoreset_mode'?",
        ),
        (lambda: balance_vector(0), ValueError, "num_envs must be a whole number, at least 1; got 0."),
        (
            lambda: balance_vector(2.0),  # pyright: ignore[reportArgumentType]
            ValueError,
            "num_envs must be a whole number, at least 1; got 2.0.",
        ),
        (
            lambda: balance_vector(2, RIG.replace(mass1=[0.5, 0.6, 0.7])),
            ValueError,
            "The rig describes 3 rows; expected num_envs, which is 2.",
        ),
        (
            lambda: balance_vector(2, RIG.replace(force_limit=[30.0, np.inf])),
            ValueError,
            "A continuous action is a share of the force limit: expected a finite one; got array([30., inf]). Set it "
            "with rig.replace(force_limit=...), in N, or pass forces=[...] to choose from.",
        ),
        (
            lambda: balance_vector(2, RIG.replace(force_limit=[30.0, 10.0]), forces=[-20, 20]),
            ValueError,
            "forces must be two or more finite numbers in N, within the force limit of 10 N; got [-20, 20]. More than "
            "the limit is never applied.",
        ),
        (
            lambda: balance_vector(2, autoreset_mode="Never"),
            ValueError,
            'autoreset_mode must be "NextStep", "SameStep" or "Disabled"; got \'Never\'.',
        ),
        (
            lambda: balance_vector(2, render_mode="human"),
            ValueError,
            "render_mode must be None or one of 'rgb_array'; got 'human'.",
        ),
        (
            lambda: balance_vector(65, render_mode="rgb_array"),
            ValueError,
            "Rendering draws every copy: expected at most 64 with render_mode='rgb_array'; got num_envs=65.",
        ),
        (
            lambda: balance_vector(2).step(np.zeros((2, 1))),
            ResetNeeded,
            "There are no episodes yet: call reset() before step().",
        ),
        (
            lambda: balance_vector(2, render_mode="rgb_array").render(),
            ResetNeeded,
            "There are no episodes yet: call reset() before render().",
        ),
        (
            lambda: balance_vector(2).reset(options={"reset_mask": np.array([True, False])}),
            ResetNeeded,
            "There are no episodes yet: call reset() without a reset_mask first.",
        ),
        (
            lambda: _reset({"reset_msk": np.array([True, False])}),
            ValueError,
            "reset has no option 'reset_msk'. Did you mean 'reset_mask'?",
        ),
        (
            lambda: _reset({"reset_mask": [True, False]}),
            TypeError,
            "reset_mask must be a numpy array of bool; got [True, False].",
        ),
        (
            lambda: _reset({"reset_mask": np.array([1, 0])}),
            TypeError,
            "reset_mask must be a numpy array of bool; got array([1, 0]).",
        ),
        (
            lambda: _reset({"reset_mask": np.array([True])}),
            ValueError,
            "reset_mask must have shape (2,) and at least one true; got array([ True]).",
        ),
        (
            lambda: _reset({"reset_mask": np.array([False, False])}),
            ValueError,
            "reset_mask must have shape (2,) and at least one true; got array([False, False]).",
        ),
        (
            lambda: _reset({"reset_mask": np.array([True, False])}, seed=1),
            ValueError,
            "A seed restarts the random numbers of all copies, a reset_mask begins some: pass one or the other.",
        ),
        (
            lambda: _reset({"x0": np.zeros((3, 6))}),
            ValueError,
            "A state has six numbers (pos, th1, th2, vel, om1, om2): expected an array of shape (2, 6) or (6,); got "
            "shape (3, 6).",
        ),
        (
            lambda: _reset({"x0": [[0, 0, 0, 0, 0, 0], [3, 0, 0, 0, 0, 0]]}),
            ValueError,
            "An episode cannot start where it ends; got x0 = [3.0, 0.0, 0.0, 0.0, 0.0, 0.0]: The cart reached the end "
            "of the track.",
        ),
        (
            lambda: _stepped(balance_vector(2), np.zeros(2)),
            InvalidAction,
            SHARES + "shape (2,), dtype float64, values 0 to 0.",
        ),
        (
            lambda: _stepped(balance_vector(2), [[0.5], [np.inf]]),
            InvalidAction,
            SHARES + "shape (2, 1), dtype float64, values 0.5 to inf.",
        ),
        (lambda: _stepped(balance_vector(2), [["a"], ["b"]]), InvalidAction, SHARES + "shape (2, 1), dtype <U1."),
        (
            lambda: _stepped(balance_vector(2, forces=FORCES), [0, 4]),
            InvalidAction,
            INDICES + "shape (2,), dtype int64, values 0 to 4.",
        ),
        (
            lambda: _stepped(balance_vector(2, forces=FORCES), np.array([-1, 0])),
            InvalidAction,
            INDICES + "shape (2,), dtype int64, values -1 to 0.",
        ),
        (
            lambda: _stepped(balance_vector(2, forces=FORCES), np.array([0.0, 1.0])),
            InvalidAction,
            INDICES + "shape (2,), dtype float64, values 0 to 1.",
        ),
        (
            lambda: _stepped(balance_vector(2, forces=FORCES), [0, 1, 2]),
            InvalidAction,
            INDICES + "shape (3,), dtype int64, values 0 to 2.",
        ),
    ],
)
def test_what_is_wrong_is_refused_with_what_was_expected_and_what_came(
    call: Callable[[], object], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=whole(message)):
        call()


def test_stepping_on_without_autoreset_is_refused_until_all_have_begun_anew() -> None:
    envs = balance_vector(3, steps=1, autoreset_mode=AutoresetMode.DISABLED)
    envs.reset(seed=0)
    envs.step(np.zeros((3, 1)))
    envs.reset(options={"reset_mask": np.array([True, False, True])})
    message = (
        '1 episodes are over, the first in copy 1: call reset(options={"reset_mask": terminated | truncated}) before '
        "the next step()."
    )
    with pytest.raises(ResetNeeded, match=whole(message)):
        envs.step(np.zeros((3, 1)))
    envs.reset(options={"reset_mask": np.array([False, True, False])})
    envs.step(np.zeros((3, 1)))


def test_single_and_vector_environments_take_actions_of_any_width() -> None:
    envs, env = balance_vector(1, forces=FORCES), balance(forces=FORCES)
    x0 = {"x0": np.zeros(6)}
    for kind in (np.int8, np.int32, np.int64, np.uint8, np.uint64):
        envs.reset(options=x0)
        env.reset(options=x0)
        assert_array_equal(envs.step(np.array([3], dtype=kind))[0][0], env.step(kind(3))[0])
    envs, env = balance_vector(1), balance()
    for kind in (np.float16, np.float32, np.float64, np.int32):
        envs.reset(options=x0)
        env.reset(options=x0)
        assert_array_equal(envs.step(np.array([[0.3]]).astype(kind))[0][0], env.step(np.array([0.3]).astype(kind))[0])
