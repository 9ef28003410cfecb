"""Policies as files: what was saved comes back, what was not is refused and runs nothing; networks as controllers."""

import json
import os
import re
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import dpend
import rl
from dpend.archive import _checksum
from dpend.shaping import observe
from rl import LinearQPolicy, MLPPolicy, Network, TableOneMean, load_policy
from rl.deep import evaluate

RIG = dpend.rig("gustafsson2016")


def network(inputs=8, *, activation="tanh", squash="clip", seed=0):
    rng = np.random.default_rng(seed)
    widths = (inputs, 64, 64, 1)
    weights = [rng.normal(size=(m, n)) / np.sqrt(n) for n, m in pairwise(widths)]
    return Network(weights, [0.1 * rng.normal(size=m) for m in widths[1:]], activation=activation, squash=squash)


def policy(inputs=8, period=0.04, **keywords):
    return MLPPolicy(network(inputs), scales=(2.4, 3.0, 6.0, 6.0), force_limit=40.0, period=period, **keywords)


SAVED = {
    "linear Q": LinearQPolicy(np.arange(18.0), np.ones(18), (0.0, -40.0, 40.0), about={"seed": 3}),
    "table 1 mean": TableOneMean(np.arange(15.0), "signs", about={"seed": 3}),
    "mlp": policy(about={"seed": 3, "name": "some"}),
    "network": network(11, activation="relu", squash="tanh"),
}


def states(n, seed=0):
    return np.random.default_rng(seed).normal(size=(n, 6))


def forces(law, y):
    if isinstance(law, Network):
        return law(np.random.default_rng(0).normal(size=(len(y), law.inputs)))
    return law.start(len(y), np.random.default_rng(0))(0.0, y)


@pytest.mark.parametrize("activation", ["tanh", "relu"])
@pytest.mark.parametrize("squash", ["clip", "tanh"])
def test_a_network_is_what_its_equation_says(activation, squash):
    net = network(activation=activation, squash=squash)
    functions = {"tanh": np.tanh, "relu": lambda h: max(h, 0.0), "clip": lambda h: min(max(h, -1.0), 1.0)}
    o = np.random.default_rng(1).normal(size=(5, 8))
    for row, action in zip(o, net(o), strict=True):
        h = list(row)
        for k, (weight, bias) in enumerate(zip(net.weights, net.biases, strict=True)):
            f = functions[squash if k == len(net.weights) - 1 else activation]
            h = [f(sum(w * x for w, x in zip(line, h, strict=True)) + b) for line, b in zip(weight, bias, strict=True)]
        np.testing.assert_allclose(action, h, atol=1e-12)


def test_a_force_is_held_for_the_period_on_a_faster_rig_and_for_a_sample_on_a_slower_one():
    run = dpend.simulate(RIG, policy(), [0, np.pi, np.pi - 0.1, 0, 0, 0], 1.0, task=None)
    assert (run.u[::2] == run.u[1::2]).all()
    assert (run.u[2::2] != run.u[:-2:2]).all()
    slow = dpend.simulate(RIG.replace(sample_time=0.05), policy(), [0, np.pi, np.pi - 0.1, 0, 0, 0], 1.0, task=None)
    assert (np.diff(slow.u) != 0).all()


def test_a_network_with_nine_inputs_sees_its_last_action():
    law = policy(9, period=0.02)
    act = law.start(3, np.random.default_rng(0))
    y = [states(3, k) for k in range(3)]
    last = np.zeros(3)
    for k in range(3):
        last = law.network(observe(y[k], law.scales, last))[:, 0]
        np.testing.assert_array_equal(act(0.02 * k, y[k]), 40.0 * last)


LAWS = {kind: law for kind, law in SAVED.items() if kind != "network"} | {"recalling": policy(9, period=0.02)}


@pytest.mark.parametrize("kind", LAWS)
def test_after_a_missing_measurement_a_policy_acts_as_if_nothing_had_happened(kind):
    act = LAWS[kind].start(3, np.random.default_rng(0))
    y = states(3)
    act(0.0, y)
    broken = y.copy()
    broken[1] = np.nan
    assert np.isfinite(act(0.1, broken)[[0, 2]]).all()
    assert np.isfinite(act(0.2, y)).all()


@pytest.mark.parametrize("kind", LAWS)
def test_a_policy_has_no_force_before_its_first_measurement_and_that_of_the_last_where_one_is_missing(kind):
    act, twin = (LAWS[kind].start(1, np.random.default_rng(0)) for _ in range(2))
    missing, y = np.full((1, 6), np.nan), states(1)
    assert act(0.0, missing) == 0
    assert act(0.1, y) == twin(0.1, y)  # what recalls its last action recalls none
    assert act(0.2, missing) == twin(0.2, y) != 0


@pytest.mark.parametrize(
    "file",
    [
        pytest.param(file, id=file.stem, marks=[pytest.mark.slow] if file.stem == "model-based" else [])
        for file in sorted((Path(rl.__file__).parent / "trained").glob("*.npz"))
    ],
)
def test_a_shipped_policy_keeps_the_contract_of_controllers(file):
    law = load_policy(file.stem)
    assert not isinstance(law, Network)
    skip = ["whole_turns_change_nothing"] if isinstance(law, LinearQPolicy) else []  # Table 1 has angles as they are
    dpend.check_controller(law, RIG, skip=skip)


@pytest.mark.parametrize("kind", SAVED)
def test_what_was_saved_comes_back_to_the_bit(kind, tmp_path):
    saved = SAVED[kind]
    back = load_policy(saved.save(tmp_path / "policy"))
    assert type(back) is type(saved)
    assert back.about == saved.about
    np.testing.assert_array_equal(forces(back, states(9)), forces(saved, states(9)))


def refused(file):
    with pytest.raises(
        ValueError,
        match=rf"^{re.escape(str(file))} cannot be read as 'dpend policy 2': .+\. Save it again, or copy it afresh\.$",
    ) as caught:
        load_policy(file)
    return str(caught.value)


def stored(file):
    with np.load(file, allow_pickle=False) as opened:
        return {name: opened[name] for name in opened.files}


def signed(file, arrays):
    """Write arrays with a checksum that is right."""
    rest = {name: array for name, array in arrays.items() if name != "checksum"}
    np.savez(file, allow_pickle=False, checksum=np.array(_checksum(rest)), **rest)


def header(**changes):
    """What a network's file says of itself, with some of it changed or, where None, left out."""
    said = {"format": "dpend policy 2", "kind": "mlp", "about": {}} | changes
    return np.array(json.dumps({name: value for name, value in said.items() if value is not None}))


@pytest.mark.parametrize("kind", SAVED)
def test_a_truncated_file_is_refused(kind, tmp_path):
    file = SAVED[kind].save(tmp_path / "policy.npz")
    content = file.read_bytes()
    for length in (0, 1, 30, len(content) // 2, len(content) - 1):
        file.write_bytes(content[:length])
        refused(file)


def test_random_bytes_are_refused(tmp_path):
    rng = np.random.default_rng(0)
    for head in (b"", b"PK\x03\x04", b"\x93NUMPY"):
        file = tmp_path / "random.npz"
        file.write_bytes(head + rng.bytes(2000))
        refused(file)


def test_a_flipped_bit_is_refused(tmp_path):
    file = SAVED["mlp"].save(tmp_path / "policy.npz")
    content = bytearray(file.read_bytes())
    for place in np.random.default_rng(0).integers(0, len(content), 20):
        flipped = bytearray(content)
        flipped[place] ^= 16
        file.write_bytes(bytes(flipped))
        try:
            back = load_policy(file)
        except ValueError:
            refused(file)
        else:  # a bit of the zip's own bookkeeping, such as a date
            np.testing.assert_array_equal(forces(back, states(3)), forces(SAVED["mlp"], states(3)))


def test_arrays_that_were_tampered_with_are_refused(tmp_path):
    file = SAVED["mlp"].save(tmp_path / "policy.npz")
    arrays = stored(file)
    arrays["weight0"][0, 0] += 1e-3
    np.savez(file, **arrays)
    assert "its checksum does not match what it holds" in refused(file)


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"weight0": np.full((64, 8), np.nan)}, "weight 0 must be finite."),
        ({"bias1": np.full(64, np.inf)}, "bias 1 must be finite."),
        ({"weight1": np.ones((64, 63))}, "weight 1 must have shape (64, 64); got (64, 63)."),
        ({"weight0": np.ones(8)}, "weight 0 must have shape (64, 8); got (8,)."),
        ({"bias2": np.ones((1, 1))}, "bias 2 must have shape (m,); got (1, 1)."),
        ({"scales": np.ones(3)}, "scales must have shape (4,); got (3,)."),
        ({"force_limit": np.array(-1.0)}, "force_limit must be finite and greater than 0; got -1.0."),
        ({"period": np.array(np.nan)}, "period must be finite and greater than 0; got nan."),
        ({"activation": np.array("gelu")}, "activation must be one of 'tanh', 'relu'; got 'gelu'."),
        ({"squash": np.array("none")}, "squash must be one of 'tanh', 'clip'; got 'none'."),
        ({"header": header(kind="oracle")}, "an unknown kind of policy, 'oracle'"),
        ({"header": header(format="dpend policy 1")}, "it is 'dpend policy 1'"),
        ({"header": header(kind=None)}, "it does not hold what such a file does"),
        ({"header": header(about=None)}, "it does not hold what such a file does"),
        ({"weight7": np.ones((1, 1)), "bias7": np.ones(1)}, "expected arrays weight0, weight1, weight2, weight3, "),
        ({"header": np.array("{")}, "Expecting property name"),
    ],
)
def test_a_file_that_holds_nonsense_is_refused_even_with_a_good_checksum(changes, why, tmp_path):
    file = SAVED["mlp"].save(tmp_path / "policy.npz")
    signed(file, stored(file) | changes)
    assert why in refused(file)


@pytest.mark.parametrize("lacking", ["header", "weight1", "scales", "period"])
def test_a_file_that_lacks_something_is_refused(lacking, tmp_path):
    file = SAVED["mlp"].save(tmp_path / "policy.npz")
    signed(file, {name: array for name, array in stored(file).items() if name != lacking})
    refused(file)


def test_a_file_from_before_the_header_was_one_still_loads(tmp_path):
    law = SAVED["linear Q"]
    old = {"format": "dpend policy 2", "kind": "linear Q", "about": json.dumps({"seed": 3})}
    signed(tmp_path / "old.npz", law.arrays() | {name: np.array(value) for name, value in old.items()})
    back = load_policy(tmp_path / "old.npz")
    assert back.about == law.about
    np.testing.assert_array_equal(forces(back, states(9)), forces(law, states(9)))


class Mischief:
    def __init__(self, file):
        self.file = file

    def __reduce__(self):
        return os.mkdir, (str(self.file),)


def test_pickled_objects_in_a_file_are_refused_and_never_run(tmp_path):
    made = tmp_path / "made"
    file = SAVED["mlp"].save(tmp_path / "policy.npz")
    for name in ("header", "weight0", "checksum"):
        arrays = stored(SAVED["mlp"].save(file))
        arrays[name] = np.array([Mischief(made)], dtype=object)
        np.savez(file, allow_pickle=True, **arrays)
        assert "allow_pickle=False" in refused(file)
    assert not made.exists()


@pytest.mark.parametrize(
    "name", ["ppo-swing-up", "ppo-swing-up-smooth", "ddpg-swing-up", "ppo-balance", "ddpg-balance"]
)
def test_a_shipped_policy_says_where_it_comes_from_and_does_what_it_is_for(name):
    law = load_policy(name)
    assert isinstance(law, MLPPolicy)
    assert law.about["command"].startswith(f"python -m rl.train --algo {law.about['recipe']['algo']}")
    recipe = law.about["recipe"]
    assert recipe["task"] in name
    assert law.about["name"].replace("-rest", "") == name
    assert dpend.Rig.from_dict(recipe["rig"]) == RIG
    assert {"seed", "versions", "evaluation"} <= set(law.about)
    success, _ = evaluate(law, recipe["task"], RIG, 60, 4321)
    assert success > 0.9 if recipe["task"] == "swing-up" else success > 0.8


def test_a_name_that_is_not_shipped_is_refused_with_the_nearest():
    with pytest.raises(FileNotFoundError, match=r"^There is no file and no shipped policy 'ppo-swing-upp'\."):
        load_policy("ppo-swing-upp")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda: Network([], []), "Expected as many biases as weights, at least one; got 0 and 0."),
        (lambda: Network([np.ones((1, 2))], []), "Expected as many biases as weights, at least one; got 0 and 1."),
        (
            lambda: MLPPolicy(network(7), scales=np.ones(4), force_limit=1.0, period=0.02),
            "The network must have 8 inputs, or 9 with its last action, and 1 output; got 7 and 1.",
        ),
    ],
)
def test_networks_that_do_not_fit_are_refused(change, message):
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        change()


def test_a_state_takes_less_than_twenty_microseconds_in_batches_of_a_thousand():
    act = policy(period=1e-6).start(1000, np.random.default_rng(0))
    y = states(1000)
    taken = []
    for k in range(30):
        began = time.perf_counter()
        act(float(k), y)
        taken.append(time.perf_counter() - began)
    assert min(taken) / 1000 < 20e-6
