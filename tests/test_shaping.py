"""What deep learners see and are rewarded for: bounds, symmetries, and the mixture of starts."""

import math

import numpy as np
import numpy.typing as npt
import pytest

import dpend
from dpend import Balance, SwingUp
from dpend.shaping import Mixture, observation_scales, observe, shaped_reward

RIG = dpend.rig("gustafsson2016")
MIXED = Mixture(task=SwingUp(), mixture=[SwingUp(), Balance()], steps=100)


def some_states(n=200, seed=0):
    return np.random.default_rng(seed).normal(scale=(1, 3, 3, 3, 5, 5), size=(n, 6))


def reward(x, share: npt.ArrayLike = 0.0, code: npt.ArrayLike = 0, rig=RIG):
    n = len(x)
    return shaped_reward(
        rig, x, np.broadcast_to(np.asarray(share) * rig.force_limit, n), np.broadcast_to(np.asarray(code, np.uint8), n)
    )


def published_reward(x, share, failed, end_of_track, gravity, length1, length2) -> float:
    """The reward as docs/deep-rl.md prints it, of one state, in Python's own numbers."""
    pos, th1, th2, _, om1, om2 = map(float, x)
    reach = length1 * math.cos(th1) + length2 * math.cos(th2)
    height = (1 + reach / (length1 + length2)) / 2
    s_om2 = 4 * gravity / ((length1 + length2) / 2)
    settled = math.exp(-2 * (om1**2 + om2**2) / s_om2)
    upright = math.exp(-10 + 5 * math.cos(th1) + 5 * math.cos(th2))
    share_of_track = min(abs(pos) / end_of_track, 1)
    paid = (height * (1 + settled) / 4 + upright / 2) * (1 - 0.3 * share_of_track**2)
    return paid - (5 if failed else 0) - share**2 / 200


@pytest.mark.parametrize("preset", ["gustafsson2016", "bogdanov2004"])
def test_the_reward_is_the_published_equation(preset):
    rig = dpend.rig(preset).replace(track_limit=1.7, force_limit=30.0)
    rng = np.random.default_rng(7)
    x = np.concatenate([some_states(300, 1), rng.normal(scale=(1, 0.3, 0.3, 1, 2, 2), size=(300, 6))])
    failed, share = rng.random(600) < 0.2, rng.uniform(-1, 1, 600)
    p = rig.params
    g, length1, length2 = float(p.gravity), float(p.length1), float(p.length2)
    each = zip(x, share, failed, strict=True)
    expected = [published_reward(*one, 1.7, g, length1, length2) for one in each]
    np.testing.assert_allclose(reward(x, share, failed, rig), expected, rtol=1e-12, atol=1e-14)
    assert 0 < (np.abs(x[:, 0]) > 1.7).mean() < 1  # within the track and beyond its end


def test_states_are_seen_as_the_documentation_says():
    rig = dpend.rig("bogdanov2004")  # links of 0.5 and 0.75 m on an unlimited track
    s_om = 2 * math.sqrt(9.81 / 0.625)
    assert observation_scales(rig) == pytest.approx([1.25, 0.3125 * s_om, s_om, s_om], rel=1e-14)
    scales = np.array([2.0, 3.0, 5.0, 7.0])
    for x, seen in zip(some_states(20), observe(some_states(20), scales, np.linspace(-1, 1, 20)), strict=True):
        pos, th1, th2, vel, om1, om2 = x
        trigonometry = math.sin(th1), math.cos(th1), math.sin(th2), math.cos(th2)
        assert seen[:8] == pytest.approx([pos / 2, *trigonometry, vel / 3, om1 / 5, om2 / 7], rel=1e-14)


def test_the_reward_is_greatest_upright_at_rest_in_the_middle():
    assert reward(np.zeros((1, 6))) == 1.0
    assert (reward(some_states()) < 1.0).all()
    assert (reward(some_states()) >= 0.0).all()


def test_the_reward_hanging_at_rest_is_nothing():
    np.testing.assert_allclose(reward(dpend.EQUILIBRIA["down-down"][None]), 0.0, atol=1e-8)


def test_a_failure_costs_five():
    x = some_states(2)
    np.testing.assert_allclose(reward(x) - reward(x, code=[0, 1]), [0, 5])


def test_the_mirrored_state_is_as_good():
    np.testing.assert_allclose(reward(some_states()), reward(-some_states()), rtol=1e-14)


def test_whole_turns_are_neither_seen_nor_rewarded():
    x = some_states()
    turned = x + 2 * np.pi * np.array([0, 1, -2, 0, 0, 0])
    np.testing.assert_allclose(reward(turned), reward(x), rtol=1e-12)
    scales = observation_scales(RIG)
    np.testing.assert_allclose(observe(turned, scales), observe(x, scales), atol=1e-12)


def test_the_mirrored_state_is_seen_mirrored():
    scales = observation_scales(RIG)
    signs = np.array([-1, -1, 1, -1, 1, -1, -1, -1, -1])
    last = np.linspace(-1, 1, 200)
    np.testing.assert_allclose(observe(-some_states(), scales, -last), signs * observe(some_states(), scales, last))


def test_the_end_of_the_track_is_seen_as_one():
    scales = observation_scales(RIG)
    assert observe(np.array([[2.4, 0, 0, 0, 0, 0]]), scales)[0, 0] == 1.0
    assert np.isfinite(observation_scales(RIG.replace(track_limit=np.inf))).all()


def test_starts_come_from_every_task_of_the_mixture_equally_often():
    starts = MIXED.starts(np.random.default_rng(0), 10_000, RIG)
    hanging = (starts == dpend.EQUILIBRIA["down-down"]).all(axis=1)
    near = np.abs(starts[:, 1:3]).max(axis=1) <= 0.1
    assert (hanging ^ near).all()
    assert hanging.mean() == pytest.approx(0.5, abs=0.02)


def test_it_ends_as_its_task_does():
    x = some_states()
    x[::2, 0] = 3.0
    np.testing.assert_array_equal(MIXED.ended(x, RIG), SwingUp().ended(x, RIG))
    np.testing.assert_array_equal(MIXED.upright(x), SwingUp().upright(x))
    assert MIXED.hold == SwingUp().hold
