"""The Gymnasium environments show the same plant as the simulator, keep Gymnasium's rules, and refuse what is wrong."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import InvalidAction, ResetNeeded
from gymnasium.utils.env_checker import check_env
from numpy.testing import assert_allclose, assert_array_equal
from rigs import endless, whole

import dpend.env
from dpend import Act, Balance, Rig, Status, SwingUp
from dpend.draw import Picture
from dpend.env import CartDoublePendulumEnv, balance, swing_up
from dpend.params import Array
from dpend.tasks import NoTask

IDS = ("dpend/Balance-v0", "dpend/SwingUp-v0")
RIG = dpend.rig("gustafsson2016")
UPRIGHT = np.zeros(6)
ROUGH = RIG.replace(  # everything that may be imperfect is
    force_limit=32.0,
    track_limit=np.inf,
    actuator_lag=0.01,
    actuator_delay=1,
    force_noise=0.3,
    sensor_delay=2,
    sensor_noise=[0.001, 0.002, 0.002, 0.01, 0.02, 0.02],
    resolution=[0.0, 1e-3, 1e-3, 0.0, 0.0, 0.0],
)


def played(env: Any, steps: int, *, seed: int | None = 0, actions: int = 1) -> list[Any]:
    """Return all that an environment returns in an episode of random actions, begun anew where one ends."""
    env.action_space.seed(actions)
    returned = [env.reset(seed=seed)]
    for _ in range(steps):
        returned.append(env.step(env.action_space.sample()))
        if returned[-1][2] or returned[-1][3]:
            returned.append(env.reset())
    return returned


def observations(returned: list[Any]) -> Array:
    return np.array([step[0] for step in returned])


class Leaning:
    """Push to where the links lean: as hard as it goes, or in proportion, but never beyond 32 N."""

    def __init__(self, hard: bool) -> None:
        self.hard = hard

    def force(self, y: Array) -> Array:
        lean = y @ np.array([2.0, 60.0, -90.0, 3.0, 1.0, -12.0])
        return np.where(lean > 0, 32.0, -32.0) if self.hard else np.clip(lean, -32.0, 32.0)

    def start(self, n: int, rng: np.random.Generator) -> Act:
        return lambda t, y: self.force(y)


class Still:
    """Leave the cart alone."""

    def start(self, n: int, rng: np.random.Generator) -> Act:
        return lambda t, y: np.zeros(n)


# ---------------------------------------------------------------------------------------------------- Gymnasium's rules


@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize("forces", [None, [-20.0, 0.0, 20.0]])
@pytest.mark.parametrize("observation", ["raw", "trig", "scaled"])
@pytest.mark.filterwarnings("ignore:.*A Box observation space (min|max)imum value is -?infinity")
def test_gymnasiums_checker_warns_of_nothing_but_that_positions_and_rates_are_unlimited(
    name: str, forces: list[float] | None, observation: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        Picture, "show", lambda *_, **__: None
    )  # there may be no display; tests/test_draw.py has windows
    check_env(gym.make(name, forces=forces, observation=observation).unwrapped)


@pytest.mark.parametrize("name", IDS)
def test_the_environment_ends_episodes_itself_without_a_time_limit_around_it(name: str) -> None:
    env = gym.make(name, steps=3)
    assert "TimeLimit" not in str(env)
    for _ in range(2):
        env.reset()
        ends = [env.step(np.zeros(1, dtype=np.float32))[2:4] for _ in range(3)]
        assert ends == [(False, False), (False, False), (False, True)]


def test_without_a_length_no_episode_is_cut_short() -> None:
    env = CartDoublePendulumEnv(NoTask(), RIG)
    env.reset(seed=0)
    assert not any(env.step(np.zeros(1))[3] for _ in range(1200))


def test_the_frame_rate_is_that_of_the_samples() -> None:
    assert balance().metadata["render_fps"] == 50
    assert balance(dpend.rig("dm_control_two_poles")).metadata["render_fps"] == 100
    assert balance(RIG.replace(sample_time=3.0)).metadata["render_fps"] == 1
    assert CartDoublePendulumEnv.metadata["render_fps"] == 50


# ----------------------------------------------------------------------------------------------------------- randomness


@pytest.mark.parametrize("make", [balance, swing_up])
@pytest.mark.parametrize("rig", [RIG, ROUGH])
def test_the_same_seed_gives_the_same_episodes_noise_included(make: Callable[..., Any], rig: Rig) -> None:
    start = {"start": "anywhere"} if make is swing_up else {}
    env, other = make(rig, **start), make(rig, **start)
    first = observations(played(env, 100, seed=7))
    assert_array_equal(observations(played(env, 100, seed=7)), first)
    assert_array_equal(observations(played(other, 100, seed=7)), first)
    assert not np.array_equal(observations(played(env, 100, seed=8))[0], first[0])


def test_without_a_seed_starts_and_noise_go_on() -> None:
    env = balance(ROUGH)
    x0 = {"x0": UPRIGHT}
    noisy = [env.reset(seed=0, options=x0)[0], env.reset(options=x0)[0], env.reset(options=x0)[0]]
    drawn = [env.reset()[1]["state"] for _ in range(3)]
    for some in (noisy, drawn):
        assert not any(np.array_equal(a, b) for a, b in combinations(some, 2))


def test_two_environments_that_were_not_seeded_differ() -> None:
    assert not np.array_equal(balance().reset()[0], balance().reset()[0])


def test_a_generator_may_be_handed_in() -> None:
    one, other = balance(ROUGH), balance(ROUGH)
    for env in (one, other):
        env.np_random = np.random.default_rng(5)
    assert_array_equal(one.reset()[0], other.reset()[0])


@pytest.mark.parametrize("make", [balance, swing_up])
@pytest.mark.parametrize("observation", ["raw", "trig"])
def test_nothing_that_is_returned_shares_memory(make: Callable[..., Any], observation: str) -> None:
    returned = played(make(observation=observation), 20)
    arrays = [array for step in returned for array in (step[0], step[-1]["state"])]
    assert not any(np.shares_memory(a, b) for a, b in combinations(arrays, 2))


def test_writing_into_what_was_returned_changes_nothing() -> None:
    envs = [balance(), balance()]
    for env in envs:
        env.reset(seed=0)
    for _ in range(20):
        (one, *_, info), (other, *_) = (env.step(np.full(1, 0.1)) for env in envs)
        assert_array_equal(one, other)
        one[:] = info["state"][:] = np.nan


@pytest.mark.parametrize("make", [balance, swing_up])
@pytest.mark.parametrize("observation", ["raw", "trig"])
@pytest.mark.parametrize("forces", [None, [-20.0, 20.0]])
def test_no_part_of_the_observation_is_constant(
    make: Callable[..., Any], observation: str, forces: list[float] | None
) -> None:
    seen = observations(played(make(observation=observation, forces=forces), 50))
    assert (np.ptp(seen, axis=0) > 1e-3).all()


# ----------------------------------------------------------------------------------------- observation, reward, actions


def test_the_observation_is_measured_and_the_info_true() -> None:
    env = balance(RIG.replace(sensor_delay=2, track_limit=np.inf))
    states = [env.reset(seed=0)[1]["state"]]
    seen = []
    for _ in range(10):
        y, *_, info = env.step(np.ones(1))
        seen.append(y)
        states.append(info["state"])
    assert_array_equal(seen[0], states[0])
    assert_array_equal(seen[1:], states[:-2])


def test_trig_observes_sines_and_cosines_in_the_place_of_the_angles() -> None:
    raw, trig = (swing_up(ROUGH, observation=kind, start="anywhere") for kind in ("raw", "trig"))
    y, z = (observations(played(env, 50)) for env in (raw, trig))
    pos, th1, th2, vel, om1, om2 = y.T
    expected = [pos, np.sin(th1), np.cos(th1), np.sin(th2), np.cos(th2), vel, om1, om2]
    assert_allclose(z.T, expected, rtol=0, atol=1e-15)


@pytest.mark.parametrize("make", [balance, swing_up])
@pytest.mark.parametrize("observation", ["raw", "trig"])
def test_every_observation_is_in_its_space_and_every_sample_of_the_space_is_finite(
    make: Callable[..., Any], observation: str
) -> None:
    env = make(ROUGH, observation=observation)
    assert all(y in env.observation_space for y in observations(played(env, 100)))
    assert np.isfinite(env.observation_space.sample()).all()


def test_the_reports_reward_is_minus_the_cost_of_the_true_state_after_the_step() -> None:
    env = balance(RIG.replace(sensor_noise=0.1), reward="report", state_weights=(1.0, 2.0, 3.0), failure_cost=5.0)
    env.reset(seed=0)
    terminated = False
    while not terminated:
        _, reward, terminated, _, info = env.step(np.ones(1))
        pos, th1, th2 = np.abs(info["state"][:3])
        assert reward == pytest.approx(-(pos + 2 * th1 + 3 * th2 + 5 * terminated), rel=1e-12)


def test_the_cost_of_an_angle_is_that_of_its_difference_to_the_nearest_turn() -> None:
    env = swing_up(endless(force_limit=1.0), reward="report")
    env.reset(options={"x0": [0, 4 * np.pi + 0.1, -2 * np.pi - 0.2, 0, 0, 0]})
    _, reward, *_, info = env.step(np.zeros(1))
    _, th1, th2, *_ = info["state"] - [0, 4 * np.pi, -2 * np.pi, 0, 0, 0]
    assert reward == pytest.approx(-10 * (abs(th1) + abs(th2)), rel=1e-9)


@pytest.mark.parametrize(("share", "force"), [(0.5, 20.0), (-1.0, -40.0), (3.0, 40.0), (-1e300, -40.0), (1, 40.0)])
def test_a_continuous_action_is_a_share_of_the_force_limit_which_nothing_exceeds(share: float, force: float) -> None:
    env = balance()
    env.reset(seed=0)
    assert env.step(np.array([share]))[4]["force"] == force
    assert env.step([share])[4]["force"] == force


def test_a_discrete_action_is_the_index_of_a_force() -> None:
    env = balance(forces=[-12.5, 0.0, 40.0])
    assert env.action_space == gym.spaces.Discrete(3)
    env.reset(seed=0)
    indices: list[Any] = [0, np.int64(1), np.array(2), np.uint8(2)]
    assert [env.step(index)[4]["force"] for index in indices] == [-12.5, 0.0, 40.0, 40.0]


def test_a_rig_without_a_force_limit_takes_discrete_actions() -> None:
    env = balance("bogdanov2004", forces=[-500.0, 500.0])
    env.reset(seed=0)
    assert env.step(1)[4]["force"] == 500.0


# ----------------------------------------------------------------------------------------------------- how episodes end


def test_an_episode_of_balancing_ends_when_a_link_falls_and_says_so() -> None:
    env = balance()
    env.reset(options={"x0": [0, 0, 1.5, 0, 0, 1.0]})
    infos, terminated, truncated = [], False, False
    while not terminated:
        _, _, terminated, truncated, info = env.step(np.zeros(1))
        infos.append(info)
    assert not truncated
    assert np.abs(infos[-1]["state"][2]) > np.pi / 2
    assert (infos[-1]["status"], infos[-1]["success"]) == (Status.LINK2_FELL.value, False)
    assert all(set(info) == {"state", "force"} for info in infos[:-1])


def test_an_episode_ends_at_the_end_of_the_track_and_says_so() -> None:
    env = swing_up()
    env.reset(options={"x0": [2.399, np.pi, np.pi, 1.0, 0, 0]})
    _, _, terminated, truncated, info = env.step(np.zeros(1))
    assert (terminated, truncated) == (True, False)
    assert (info["status"], info["success"]) == (Status.TRACK_END.value, False)


def test_balancing_for_the_full_length_is_a_success() -> None:
    env = balance(steps=5)
    env.reset(options={"x0": UPRIGHT})
    *_, (_, _, terminated, truncated, info) = [env.step(np.zeros(1)) for _ in range(5)]
    assert (terminated, truncated) == (False, True)
    assert (info["status"], info["success"]) == (Status.FULL_LENGTH.value, True)


def test_failing_in_the_very_last_step_is_no_success() -> None:
    env = balance(steps=1)
    env.reset(options={"x0": [2.399, 0, 0, 1.0, 0, 0]})
    _, _, terminated, truncated, info = env.step(np.zeros(1))
    assert (terminated, truncated) == (True, True)
    assert (info["status"], info["success"]) == (Status.TRACK_END.value, False)


@pytest.mark.parametrize(("steps", "success"), [(49, False), (50, True), (60, True)])
def test_a_swing_up_succeeds_when_both_links_were_up_for_as_long_as_asked(steps: int, success: bool) -> None:
    env = swing_up(steps=steps, hold=1.0)
    env.reset(options={"x0": UPRIGHT})
    *_, (*_, info) = [env.step(np.zeros(1)) for _ in range(steps)]
    assert info["success"] is success


@pytest.mark.parametrize("hold", [0.12, 0.2])
def test_the_environment_and_simulate_agree_on_which_swing_ups_succeed(hold: float) -> None:
    task = SwingUp(steps=10, hold=hold)
    x0 = np.random.default_rng(0).uniform(-1, 1, (300, 6)) * [0, 0.3, 0.3, 0, 2, 2]
    env = CartDoublePendulumEnv(task, RIG)
    success = []
    for x in x0:
        env.reset(options={"x0": x})
        *_, (*_, info) = [env.step(np.zeros(1)) for _ in range(10)]
        success.append(info["success"])
    assert_array_equal(success, dpend.simulate_many(RIG, Still(), x0, task=task).success)
    assert 10 < sum(success) < 200


def test_a_state_that_is_no_longer_a_number_ends_the_episode() -> None:
    env = balance(RIG.replace(force_limit=1e300, track_limit=np.inf), observation="trig")
    env.reset(seed=0)
    _, _, terminated, _, info = env.step(np.ones(1))
    assert terminated
    assert info["status"] == Status.NOT_FINITE.value


# ------------------------------------------------------------------------------------------------- the same as simulate


@pytest.mark.parametrize("hard", [True, False])
@pytest.mark.parametrize("task", [Balance(lam=0.3), SwingUp(start="anywhere", steps=150)])
@pytest.mark.parametrize("rig", [RIG.replace(force_limit=32.0), ROUGH])
def test_one_law_makes_the_same_trajectory_in_the_environment_and_in_simulate(
    hard: bool, task: Balance | SwingUp, rig: Rig
) -> None:
    law = Leaning(hard)
    x0 = task.starts(np.random.default_rng(1), 1, rig)[0]
    run = dpend.simulate(rig, law, x0, task=task, seed=3)

    env = CartDoublePendulumEnv(task, rig, forces=[-32.0, 32.0] if hard else None)
    y, info = env.reset(seed=3, options={"x0": x0})
    states, seen, forces = [info["state"]], [y], []
    over = False
    while not over:
        force = law.force(y[None])[0]
        y, _, terminated, truncated, info = env.step(int(force > 0) if hard else np.array([force / 32.0]))
        over = terminated or truncated
        states.append(info["state"])
        seen.append(y)
        forces.append(info["force"])
    assert_array_equal(states, run.x)
    assert_array_equal(seen, run.y)
    assert_array_equal(forces, run.u)
    assert (info["status"], info["success"]) == (run.status.value, run.success)


# ------------------------------------------------------------------------------------------------------------- pictures


def test_rgb_array_draws_the_true_state_and_the_force() -> None:
    env: Any = gym.make("dpend/Balance-v0", rig=RIG.replace(sensor_noise=0.1), render_mode="rgb_array")
    env.reset(seed=0)
    before = env.render()
    *_, info = env.step(np.ones(1, dtype=np.float32))
    after = env.render()
    assert (after.dtype, after.ndim, after.shape[2]) == (np.uint8, 3, 3)
    assert not np.array_equal(before, after)
    assert_array_equal(after, Picture(RIG).rgb(info["state"], info["force"]))
    env.close()


def test_a_window_shows_every_state_as_it_comes_and_is_closed_with_the_environment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shown: list[Any] = []
    monkeypatch.setattr(Picture, "show", lambda self, x, force: shown.append((x.copy(), force)))
    monkeypatch.setattr(Picture, "close", lambda self: shown.append("closed"))
    env = swing_up(render_mode="human")
    infos = [env.reset(seed=0)[1], *(env.step(np.ones(1))[4] for _ in range(3))]
    assert len(shown) == 4
    for (x, force), info in zip(shown, infos, strict=True):
        assert_array_equal(x, info["state"])
        assert force == info["force"]
    assert env.render() is None
    env.close()
    env.close()
    assert shown[-1] == "closed"
    assert shown.count("closed") == 1


def test_a_window_keeps_real_time_and_does_not_make_up_for_what_was_late(monkeypatch: pytest.MonkeyPatch) -> None:
    now, shown, drawing = 100.0, [], iter([0.0, 0.005, 0.012, 0.35, 0.0, 0.0, 0.001])

    def sleep(seconds: float) -> None:
        nonlocal now
        assert seconds >= 0
        now += seconds

    def show(*_: Any) -> None:
        shown.append(now)
        sleep(next(drawing))

    monkeypatch.setattr(dpend.env, "time", SimpleNamespace(monotonic=lambda: now, sleep=sleep))
    monkeypatch.setattr(Picture, "show", show)
    env = swing_up(RIG.replace(sample_time=0.1), render_mode="human")
    env.reset(seed=0)
    for _ in range(6):
        env.step(np.zeros(1))
    # The fourth takes 0.35 s: the fifth follows at once, and the clock goes on from there.
    assert_allclose(shown, 100.0 + np.array([0.0, 0.1, 0.2, 0.3, 0.65, 0.75, 0.85]), rtol=0, atol=1e-9)


def test_a_window_does_not_stop_an_episode_whose_state_cannot_be_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[Any] = []
    monkeypatch.setattr(Picture, "show", lambda self, x, force: shown.append(x))
    env = balance(RIG.replace(force_limit=1e300, track_limit=np.inf), render_mode="human")
    env.reset(seed=0)
    assert env.step(np.ones(1))[4]["status"] == Status.NOT_FINITE.value
    assert len(shown) == 1


def test_rendering_without_a_way_to_render_warns() -> None:
    env = balance()
    env.reset(seed=0)
    with pytest.warns(UserWarning, match='make the environment with render_mode="rgb_array"'):
        assert env.render() is None


# ------------------------------------------------------------------------------------------------------------ bad input


def _stepped(env: CartDoublePendulumEnv, action: Any) -> None:
    env.reset(seed=0)
    env.step(action)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (
            lambda: balance(lamb=0.2),
            TypeError,
            "A Balance environment has no parameter 'lamb'. Did you mean 'lam'?",
        ),
        (
            lambda: swing_up(observations="trig"),
            TypeError,
            "A SwingUp environment has no parameter 'observations'. Did you mean 'observation'?",
        ),
        (
            lambda: swing_up(lam=0.2),
            TypeError,
            "A SwingUp environment has no parameter 'lam'. Known: angle_spread, failure_cost, forces, hold, "
            "observation, render_mode, reward, rig, start, state_weights, steps, target, upright_angle.",
        ),
        (
            lambda: balance(lam=0),
            ValueError,
            "lambda is the greatest starting angle in rad: expected 0 < lambda <= pi/2; got 0.",
        ),
        (
            lambda: balance("gustafson2016"),
            ValueError,
            "There is no preset rig 'gustafson2016'. Did you mean 'gustafsson2016'?",
        ),
        (
            lambda: balance(7),  # pyright: ignore[reportArgumentType]
            TypeError,
            "rig must be a dpend.Rig or the name of a preset; got 7.",
        ),
        (
            lambda: balance(RIG.replace(mass1=[0.5, 0.6])),
            ValueError,
            "An environment has one rig; this one describes 2. Take one of them with rig.rows(i), or all in a vector "
            "environment.",
        ),
        (
            lambda: balance("bogdanov2004"),
            ValueError,
            "A continuous action is a share of the force limit: expected a finite one; got inf. Set it with "
            "rig.replace(force_limit=...), in N, or pass forces=[...] to choose from.",
        ),
        (
            lambda: balance(forces=[-50.0, 50.0]),
            ValueError,
            "forces must be two or more finite numbers in N, within the force limit of 40 N; got [-50.0, 50.0]. More "
            "than the limit is never applied.",
        ),
        (
            lambda: balance(forces=[1.0]),
            ValueError,
            "forces must be two or more finite numbers in N, within the force limit of 40 N; got [1.0]. More than the "
            "limit is never applied.",
        ),
        (
            lambda: balance(forces=["left", "right"]),  # pyright: ignore[reportArgumentType]
            ValueError,
            "forces must be two or more finite numbers in N, within the force limit of 40 N; got ['left', 'right']. "
            "More than the limit is never applied.",
        ),
        (
            lambda: balance(observation="cos"),
            ValueError,
            'observation must be "raw", "trig" or "scaled"; got \'cos\'.',
        ),
        (
            lambda: balance(render_mode="ansi"),
            ValueError,
            "render_mode must be None or one of 'human', 'rgb_array'; got 'ansi'.",
        ),
        (
            lambda: CartDoublePendulumEnv(Balance, RIG),  # pyright: ignore[reportArgumentType]
            TypeError,
            "Expected a task such as dpend.Balance(); got the class Balance. Call it first.",
        ),
        (
            lambda: CartDoublePendulumEnv(RIG, RIG.sample_time),  # pyright: ignore[reportArgumentType]
            TypeError,
            f"Expected a task such as dpend.Balance(); got {RIG!r}.",
        ),
        (
            lambda: balance().reset(options={"x": UPRIGHT}),
            ValueError,
            "reset has no option 'x'. Did you mean 'x0'?",
        ),
        (
            lambda: balance().reset(options={"x0": np.zeros(5)}),
            ValueError,
            "A state has six numbers (pos, th1, th2, vel, om1, om2): expected an array of shape (1, 6) or (6,); got "
            "shape (5,).",
        ),
        (
            lambda: balance().reset(options={"x0": [0, 2.0, 0, 0, 0, 0]}),
            ValueError,
            "An episode cannot start where it ends; got x0 = [0.0, 2.0, 0.0, 0.0, 0.0, 0.0]: Link 1 fell: it leans by "
            "more than a quarter turn.",
        ),
        (lambda: balance().step(np.zeros(1)), ResetNeeded, "There is no episode yet: call reset() before step()."),
        (
            lambda: balance(render_mode="rgb_array").render(),
            ResetNeeded,
            "There is no episode yet: call reset() before render().",
        ),
        (
            lambda: _stepped(balance(), 1),
            InvalidAction,
            "An action is a share of the force limit: expected an array of shape (1,) with a finite number, -1 to 1; "
            "got 1.",
        ),
        (
            lambda: _stepped(balance(), np.array([np.nan])),
            InvalidAction,
            "An action is a share of the force limit: expected an array of shape (1,) with a finite number, -1 to 1; "
            "got array([nan]).",
        ),
        (
            lambda: _stepped(balance(), ["left"]),
            InvalidAction,
            "An action is a share of the force limit: expected an array of shape (1,) with a finite number, -1 to 1; "
            "got ['left'].",
        ),
        (
            lambda: _stepped(balance(forces=[-1, 1]), 2),
            InvalidAction,
            "An action is the index of a force: expected a whole number, 0 to 1; got 2.",
        ),
        (
            lambda: _stepped(balance(forces=[-1, 1]), -1),
            InvalidAction,
            "An action is the index of a force: expected a whole number, 0 to 1; got -1.",
        ),
        (
            lambda: _stepped(balance(forces=[-1, 1]), 0.5),
            InvalidAction,
            "An action is the index of a force: expected a whole number, 0 to 1; got 0.5.",
        ),
    ],
)
def test_what_is_wrong_is_refused_with_what_was_expected_and_what_came(
    call: Callable[[], object], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=whole(message)):
        call()


def test_a_misspelt_keyword_is_refused_through_gymnasium_too() -> None:
    with pytest.raises(TypeError, match=r"^A Balance environment has no parameter 'lamb'\. Did you mean 'lam'\? was "):
        gym.make("dpend/Balance-v0", lamb=0.2)


def test_a_refused_reset_leaves_the_episode_as_it_was() -> None:
    envs = [balance(), balance()]
    for env in envs:
        env.reset(seed=0)
    with pytest.raises(ValueError, match="cannot start where it ends"):
        envs[0].reset(seed=1, options={"x0": [9, 0, 0, 0, 0, 0]})
    one, other = (env.step(np.ones(1))[0] for env in envs)
    assert_array_equal(one, other)


def test_stepping_on_after_the_end_is_refused_until_the_next_reset() -> None:
    env = balance(steps=1)
    env.reset(seed=0)
    env.step(np.zeros(1))
    message = "The episode is over: The run reached its full length. Call reset() before the next step()."
    with pytest.raises(ResetNeeded, match=whole(message)):
        env.step(np.zeros(1))
    env.reset()
    env.step(np.zeros(1))
