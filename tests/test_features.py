"""Table 1 of the report, and why it forces bang-bang control."""

import numpy as np
import pytest

import dpend
from rl.features import CART_FEATURES, TABLE1, make_value_features, slope_features
from rl.linear_q import REPORT_FORCES
from rl.policies import LinearQPolicy


def features(x, a):
    """What the learner uses."""
    value = make_value_features()(x)
    return np.array([*value, *(a * slope for slope in slope_features(x))])


def named(name, x, a):
    """Evaluate a feature from its name in the table."""
    if name.startswith("|"):
        return abs(named(name[1:-1], x, a))
    if name.startswith("a "):
        return a * named(name[2:], x, a)
    if name.startswith("n("):
        angle = named(name[2:-1], x, a)
        return np.arctan2(np.sin(angle), np.cos(angle))
    return x[dpend.NAMES.index(name)]


def test_every_feature_is_what_its_name_says():
    rng = np.random.default_rng(4)
    for _ in range(50):
        x, a = 3 * rng.normal(size=6), rng.normal()
        assert features(x, a) == pytest.approx([named(name, x, a) for name in TABLE1], rel=1e-9, abs=1e-12)


def test_the_features_are_those_of_table_1_in_its_order():
    x = np.array([-0.3, 4.0, -0.2, 0.5, -0.6, 0.7])
    expected = {
        "f2": -0.3,
        "f4": 4.0 - 2 * np.pi,
        "f6": -0.2,
        "f8": 0.5,
        "f10": -0.6,
        "f12": 0.7,
        "f14": 3 * 0.5,
        "f16": 3 * -0.6,
        "f18": 3 * 0.7,
    }
    got = features(x, 3.0)
    for name, value in expected.items():
        assert got[int(name[1:]) - 1] == pytest.approx(value)
    odd = [abs(-0.3), 2 * np.pi - 4.0, 0.2, 0.5, 0.6, 0.7, 3 * -0.3, 3 * 4.0, 3 * -0.2]
    assert got[::2] == pytest.approx(odd)
    assert len(TABLE1) == 18


def test_the_cart_has_six_features():
    assert [TABLE1[i] for i in CART_FEATURES] == ["|pos|", "pos", "|vel|", "vel", "a pos", "a vel"]


def test_each_feature_named_in_table_1_is_a_straight_line_over_the_actions():
    rng = np.random.default_rng(0)
    for name in TABLE1:
        x = rng.normal(size=6)
        left, middle, right = (named(name, x, a) for a in (-40.0, -10.0, 20.0))
        assert right - middle == pytest.approx(middle - left, rel=1e-9, abs=1e-12)


def test_the_greedy_force_is_an_end_of_the_action_set_whatever_the_weights():
    rng = np.random.default_rng(1)
    y = rng.normal(size=(200, 6))
    for _ in range(50):
        w = rng.normal(size=18) * rng.choice([0.0, 1.0], size=18) + 1e-3 * rng.normal(size=18)
        policy = LinearQPolicy(w, np.ones(18), REPORT_FORCES)
        assert (np.abs(policy.start(200, rng)(0.0, y)) == 40.0).all()


def test_the_policy_takes_the_action_of_greatest_q():
    rng = np.random.default_rng(2)
    y = rng.normal(size=(100, 6))
    w, scales = rng.normal(size=18), rng.uniform(0.1, 2.0, 18)
    u = LinearQPolicy(w, scales, REPORT_FORCES).start(100, rng)(0.0, y)
    for x, chosen in zip(y, u, strict=True):
        q = [w @ (scales * features(x, a)) for a in REPORT_FORCES]
        assert chosen == REPORT_FORCES[int(np.argmax(q))]


def test_huge_weights_choose_like_small_ones():
    rng = np.random.default_rng(3)
    y, w = rng.normal(size=(50, 6)), rng.normal(size=18)
    small, huge = (LinearQPolicy(scale * w, np.ones(18), REPORT_FORCES).start(50, rng)(0.0, y) for scale in (1, 1e307))
    assert (small == huge).all()


def test_without_weights_the_first_action_is_taken():
    policy = LinearQPolicy(np.zeros(18), np.ones(18), REPORT_FORCES)
    run = dpend.simulate(dpend.rig("gustafsson2016"), policy, [0, 0.1, 0, 0, 0, 0])
    assert (run.u == 0.0).all()
