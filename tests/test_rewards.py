"""What environments pay: by default no failure and no idling beats a success; and the report's trap, still a trap."""

from __future__ import annotations

import copy
import math
import pickle
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import RescaleObservation
from numpy.testing import assert_allclose, assert_array_equal

import dpend
from controllers import LQR
from dpend.env import CartDoublePendulumEnv, balance, swing_up
from dpend.params import Array
from dpend.rewards import reward_of
from dpend.run import Runs
from dpend.shaping import Mixture, observation_scales, observe
from dpend.tasks import Balance, NoTask, SwingUp, Task
from dpend.vector_env import balance_vector, swing_up_vector
from rl import load_policy
from rl.recipes import DeepRecipe, training_envs
from tests.rigs import whole

RIG = dpend.rig("gustafsson2016")
GAMMAS = (0.95, 0.97, 0.99, 1.0)
IDS = ("dpend/Balance-v0", "dpend/SwingUp-v0", "dpend/BalanceShaped-v0", "dpend/SwingUpShaped-v0")


class Held:
    """A law that knows the time alone: forces ``(n,)`` held from each multiple of a period ``(n,)``, in samples."""

    def __init__(self, forces: Array, period: int = 1) -> None:
        self.forces, self.period = np.atleast_2d(forces), period

    def start(self, n: int, rng: np.random.Generator) -> dpend.Act:
        return lambda t, y: self.forces[min(round(t / 0.02) // self.period, len(self.forces) - 1)] * np.ones(n)


def runs_of(controller: dpend.Controller, x0: Array, task: Task) -> Runs:
    return dpend.simulate_many(RIG, controller, x0, task=task, record=True)


def returns(runs: Runs, task: Task, gamma: float, reward: str = "default") -> Array:
    """Return the discounted sum of an environment's rewards along each run."""
    pay = reward_of(reward, task, RIG)
    total = np.zeros(len(runs))
    for k in range(runs.u.shape[1]):
        on = k < runs.steps
        codes = np.where(runs.steps == k + 1, runs.codes, 0).astype(np.uint8)[on]
        total[on] += gamma**k * np.asarray(pay(runs.x[on, k].copy(), runs.u[on, k], runs.x[on, k + 1].copy(), codes))
    return total


# ------------------------------------------------------------------------------------------------------ what is ordered


@pytest.mark.parametrize("lam", [0.1, 0.2, 0.3, 0.4])
@pytest.mark.parametrize("gamma", GAMMAS)
def test_balancing_pays_more_the_longer_the_links_stay_up_and_most_for_success(lam: float, gamma: float) -> None:
    task = Balance(lam=lam)
    x0 = task.starts(np.random.default_rng(0), 100, RIG)
    weak = LQR(RIG.replace(force_limit=12.0))
    every = [runs_of(law, x0, task) for law in (LQR(RIG), weak, Held(np.zeros(1)), Held(np.full(1, 40.0)))]
    steps = np.concatenate([np.where(runs.success, runs.steps + 1, runs.steps) for runs in every])
    earned = np.concatenate([returns(runs, task, gamma) for runs in every])
    assert every[0].success.any()
    order = np.argsort(steps, kind="stable")
    assert (np.diff(earned[order])[np.diff(steps[order]) > 0] > 0).all()


STARTS = {"hanging": dpend.EQUILIBRIA["down-down"], "side": np.array([0, math.pi / 2, math.pi / 2, 0, 0, 0])}
SWING_UPS = ("ppo-swing-up", "ddpg-swing-up", "ppo-swing-up-smooth")


@pytest.mark.parametrize("start", STARTS)
def test_a_swing_up_pays_more_for_success_than_for_idling_and_more_for_idling_than_for_the_tracks_end(
    start: str,
) -> None:
    task = SwingUp(start=start)
    x0 = STARTS[start]
    up = [runs_of(load_policy(name), x0, task) for name in SWING_UPS]  # type: ignore[arg-type]
    idle = runs_of(Held(np.zeros(1)), x0, task)
    crash = [runs_of(Held(np.full(1, force)), x0, task) for force in (40.0, -40.0, 10.0, 3.0)]
    rng = np.random.default_rng(0)
    forces = np.clip(rng.normal(scale=30, size=(100, 1000)), -40, 40)
    flailing = runs_of(Held(forces, period=7), np.tile(x0, (1000, 1)), task)
    assert all(runs.success.all() for runs in up)
    assert (flailing.codes > 0).all()
    for gamma in GAMMAS:
        success = min(returns(runs, task, gamma)[0] for runs in up)
        idling = returns(idle, task, gamma)[0]
        failures = [returns(runs, task, gamma)[0] for runs in crash]
        assert success > idling > max(failures)
        assert success > returns(flailing, task, gamma).max()
        assert failures == sorted(failures)  # the sooner off the track, the less


def test_the_reports_reward_pays_for_dying_and_the_default_does_not() -> None:
    task, x0 = SwingUp(), STARTS["hanging"]
    good = runs_of(load_policy("ppo-swing-up"), x0, task)  # type: ignore[arg-type]
    dead = runs_of(Held(np.full(1, 40.0)), x0, task)
    assert good.success.all()
    assert returns(dead, task, 1.0, "report")[0] > returns(good, task, 1.0, "report")[0]
    assert returns(dead, task, 1.0)[0] < returns(good, task, 1.0)[0]


# --------------------------------------------------------------------------------------------------------- the formulas


def paid(task: Task, x: Any, codes: Any = 0, reward: str = "default", rig: dpend.Rig = RIG, u: float = 0.0) -> Array:
    x = np.atleast_2d(np.asarray(x, dtype=np.float64))
    codes = np.broadcast_to(np.asarray(codes, dtype=np.uint8), len(x)).copy()
    return np.asarray(reward_of(reward, task, rig)(np.zeros_like(x), np.full(len(x), u), x, codes))


def test_balancing_pays_one_for_every_step_that_does_not_fail() -> None:
    assert paid(Balance(), np.ones((3, 6)), [0, 1, 3]).tolist() == [1.0, 0.0, 0.0]


def test_a_swing_up_pays_as_its_equation_says() -> None:
    x = np.random.default_rng(0).normal(size=(50, 6))
    rig = RIG.replace(length1=0.5, gravity=9.0)
    far = 5 * (2 - np.cos(x[:, 1] - math.pi) - np.cos(x[:, 2]))
    expected = 0.5 + 0.5 * np.exp(-far - 2 * 0.75 / 9 * (x[:, 4] ** 2 + x[:, 5] ** 2))
    assert_allclose(paid(SwingUp(target="down-up"), x, rig=rig), expected, rtol=1e-13)
    assert not paid(SwingUp(), x, 1).any()
    assert paid(SwingUp(), np.zeros(6)) == 1.0
    assert_allclose(paid(SwingUp(), STARTS["hanging"]), 0.5, rtol=1e-8)


def test_each_row_is_paid_by_its_own_rigs_lengths() -> None:
    x = np.tile([0, 0.1, 0.2, 0, 1.0, -2.0], (2, 1))
    several = RIG.replace(length1=[0.5, 1.0])
    single = [paid(SwingUp(), x[:1], rig=several.rows(i))[0] for i in range(2)]
    assert single[0] != single[1]
    assert_array_equal(paid(SwingUp(), x, rig=several), single)


def test_other_tasks_are_paid_minus_their_cost_and_a_mixture_as_its_task() -> None:
    x = np.random.default_rng(1).normal(size=(4, 6))
    assert not paid(NoTask(), x).any()
    mixture = Mixture(task=SwingUp(), mixture=[Balance()], steps=5)
    assert_array_equal(paid(mixture, x), paid(SwingUp(), x))
    codes = np.zeros(4, dtype=np.uint8)
    assert_array_equal(paid(Balance(failure_cost=3.0), x, 1, "report"), -Balance().cost(x, codes) - 3.0)


# -------------------------------------------------------------------------------------------------- in the environments


@pytest.mark.parametrize("reward", ["default", "report", "shaped"])
@pytest.mark.parametrize("makers", [(balance, balance_vector), (swing_up, swing_up_vector)])
def test_single_and_vector_environments_pay_the_same(
    reward: str, makers: tuple[Callable[..., Any], Callable[..., Any]]
) -> None:
    single, several = makers[0](reward=reward), makers[1](3, reward=reward)
    x0 = [0, 0.1, -0.2, 0.3, 0, 0]
    single.reset(seed=0, options={"x0": x0})
    several.reset(seed=0, options={"x0": x0})
    for share in (0.3, -1.0, 2.0, 0.0):
        one = single.step(np.array([share]))[1]
        assert several.step(np.full((3, 1), share))[1].tolist() == [one] * 3
        assert isinstance(one, float)


def test_a_function_is_paid_out_with_what_went_before_what_acted_and_what_came() -> None:
    seen: list[Any] = []

    def reward(x: Array, u: Array, x_next: Array, codes: Any) -> Array:
        seen.append((x, u, x_next.copy(), codes))
        return np.linspace(10.0, 11.0, 2)[: len(u)]

    envs = balance_vector(2, reward=reward)
    envs.reset(options={"x0": [0, 0.1, 0, 0, 0, 0]})
    assert envs.step(np.array([[0.5], [-3.0]]))[1].tolist() == [10.0, 11.0]
    x, u, x_next, codes = seen[0]
    assert_array_equal(x, np.tile([0, 0.1, 0, 0, 0, 0], (2, 1)))
    assert u.tolist() == [20.0, -40.0]
    assert_array_equal(x_next, envs.state)
    assert codes.tolist() == [0, 0]
    env = balance(reward=reward)
    env.reset(options={"x0": [0, 0.1, 0, 0, 0, 0]})
    assert env.step(np.zeros(1))[1] == 10.0
    assert_array_equal(seen[1][0], [[0, 0.1, 0, 0, 0, 0]])


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (
            lambda: balance(reward="defualt"),
            ValueError,
            "There is no reward 'defualt'. Did you mean 'default'?",
        ),
        (lambda: balance(reward=3), TypeError, "reward must be a name or a function f(x, u, x_next, codes); got 3."),
        (
            lambda: balance(failure_cost=3.0),
            ValueError,
            'failure_cost is of the report\'s cost and does nothing here; add reward="report".',
        ),
        (
            lambda: swing_up_vector(2, RIG.replace(mass1=[0.5, 0.6]), reward="shaped"),
            ValueError,
            'reward="shaped" takes one plant; got a rig of 2 rows. Take one of them with rig.rows(i).',
        ),
        (
            lambda: stepped(balance(reward=lambda x, u, x_next, codes: 1.0)),
            ValueError,
            "A reward function returns one number per row, shape (1,); got 1.0.",
        ),
        (
            lambda: stepped(balance(reward=lambda x, u, x_next, codes: ["much"])),
            ValueError,
            "A reward function returns one number per row, shape (1,); got ['much'].",
        ),
    ],
)
def test_a_reward_that_makes_no_sense_is_refused(
    call: Callable[[], object], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=whole(message)):
        call()


def stepped(env: CartDoublePendulumEnv) -> None:
    env.reset()
    env.step(np.zeros(1))


# ------------------------------------------------------------------------------------------ as shipped policies learned


@pytest.mark.parametrize("task", ["balance", "swing-up"])
def test_the_shaped_environment_is_what_the_shipped_policies_learned_on(task: Any) -> None:
    recipe = DeepRecipe(algo="ppo", task=task, copies=64)
    before = training_envs(recipe)
    name = {"balance": "dpend/BalanceShaped-v0", "swing-up": "dpend/SwingUpShaped-v0"}[task]
    now = gym.make_vec(name, 64, autoreset_mode="SameStep")
    scales = observation_scales(RIG)
    y, _ = before.reset(seed=4)
    o, _ = now.reset(seed=4)
    assert_array_equal(o, observe(y, scales))
    rng = np.random.default_rng(0)
    for _ in range(60):
        actions = rng.uniform(-1.2, 1.2, (64, 1))
        y, rewards, terminated, truncated, _ = before.step(actions)
        o, shaped, ended, cut, _ = now.step(actions)
        assert_array_equal(o, observe(y, scales))
        assert_array_equal(shaped, rewards)
        assert_array_equal(ended, terminated)
        assert_array_equal(cut, truncated)
    assert now.unwrapped.task.steps == before.unwrapped.task.steps  # type: ignore[attr-defined]


def test_a_shipped_policy_succeeds_on_the_shaped_environment_from_its_observations() -> None:
    network = load_policy("ppo-swing-up").network  # type: ignore[union-attr]
    envs = gym.make_vec("dpend/SwingUpShaped-v0", 64)
    o, _ = envs.reset(seed=0)
    for _ in range(249):
        o = envs.step(network(o))[0]
    _, rewards, *_, infos = envs.step(network(o))
    assert infos["success"].mean() > 0.9
    assert np.median(rewards) > 0.95


# ---------------------------------------------------------------------------------------- spaces, lengths, copies


def test_what_has_no_bound_has_none_and_gymnasium_refuses_to_rescale_it() -> None:
    env = gym.make("dpend/Balance-v0", observation="trig")
    assert env.observation_space.low.tolist() == [-math.inf, -1, -1, -1, -1, -math.inf, -math.inf, -math.inf]  # type: ignore[attr-defined]
    with pytest.raises(ValueError, match=r"^For unbounded components, "):
        RescaleObservation(env, np.float64(-1), np.float64(1))


@pytest.mark.parametrize(("name", "steps"), list(zip(IDS, (300, 1000, 300, 250), strict=True)))
def test_an_environment_says_how_long_its_episodes_are(name: str, steps: int) -> None:
    env = gym.make(name)
    assert env.spec is not None
    assert env.spec.max_episode_steps == steps
    several = gym.make_vec(name, 2)
    assert several.spec is not None
    assert several.spec.max_episode_steps == steps
    again = gym.make(env.spec)
    assert again.spec is not None
    assert again.spec.max_episode_steps == steps


@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize("mode", ["vector_entry_point", "sync"])
def test_gymnasiums_limit_of_steps_ends_the_episodes_of_copies(name: str, mode: str) -> None:
    envs = gym.make_vec(name, 2, vectorization_mode=mode, max_episode_steps=4)
    envs.reset(seed=0, options={"x0": np.zeros(6)})
    cuts = [envs.step(np.zeros((2, 1), dtype=np.float32))[3].all() for _ in range(4)]
    assert cuts == [False, False, False, True]


def test_two_lengths_that_differ_are_refused() -> None:
    with pytest.raises(ValueError, match=whole("max_episode_steps and steps are one number; got 4 and 5.")):
        balance_vector(2, steps=5, max_episode_steps=4)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("several", [False, True])
def test_a_rendered_environment_is_copied_with_its_state_and_random_numbers(
    copied: Callable[[Any], Any], several: bool
) -> None:
    options = {"render_mode": "rgb_array", "rig": RIG.replace(sensor_noise=0.01)}
    env: Any = gym.make_vec("dpend/SwingUp-v0", 2, **options) if several else gym.make("dpend/SwingUp-v0", **options)
    action = np.full((2, 1) if several else 1, 0.4, dtype=np.float32)
    env.reset(seed=3)
    env.step(action)
    picture = env.render()
    other = copied(env)
    assert_array_equal(other.render(), picture)
    for _ in range(3):
        for mine, its in zip(env.step(action)[:4], other.step(action)[:4], strict=True):
            assert_array_equal(mine, its)
