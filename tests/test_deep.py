# pyright: reportMissingImports=false
"""Deep learning: the adapter against the stepper, exported policies against their models, trainings that go on."""

import json
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dpend
from dpend import archive
from dpend.shaping import observation_scales, observe
from dpend.vector_env import CartDoublePendulumVectorEnv
from rl import DeepLearner, DeepRecipe, MLPPolicy, Network, Outcome, load_policy, train_deep
from rl.deep import (
    Evaluation,
    evaluate,
    kept_trainings,
    learner_class,
    pack,
    read_curve,
    read_recipe,
    read_training,
    read_trainings,
    swing_up_starts,
)
from rl.deep import _write_curve as write_curve
from rl.recipes import DEFAULTS, INSTALL, NEEDED, OffPolicySettings, PPOSettings, training_envs
from tests.rigs import whole

ROOT = Path(__file__).parent.parent
RIG = dpend.rig("gustafsson2016")
needs_torch = pytest.mark.skipif(
    not all(find_spec(name) for name in NEEDED["torch"]),
    reason="training needs torch and Stable-Baselines3, the extra `deep`",
)
needs_jax = pytest.mark.skipif(
    not all(find_spec(name) for name in NEEDED["jax"]), reason="training in JAX needs SBX, the extra `jax`"
)
SMALL: dict[str, Any] = {
    "steps": 2048,
    "copies": 16,
    "batch": 64,
    "net": (16, 16),
    "evaluate_every": 1024,
    "evaluation_starts": 4,
}


def small(algo="ppo", **changes):
    few: dict[str, Any] = {} if algo == "ppo" else {"updates": 1 / 16}  # one a step of all copies
    settings: dict[str, Any] = {"algo": algo} | SMALL | few | changes
    return DeepRecipe(**settings)


def ppo(**settings) -> dict[str, Any]:
    return {"ppo": PPOSettings(**settings)}


def off_policy(**settings) -> dict[str, Any]:
    return {"off_policy": OffPolicySettings(**settings)}


def weights(training):
    assert isinstance(training.policy, MLPPolicy)
    return training.policy.network.weights


# -------------------------------------------------------------------------------------------------------------- recipes


@pytest.mark.parametrize("algo", DEFAULTS)
def test_a_recipe_takes_what_is_left_out_from_its_algorithm(algo):
    recipe = DeepRecipe(algo=algo)
    assert {name: getattr(recipe, name) for name in DEFAULTS[algo]} == DEFAULTS[algo]
    assert DeepRecipe(algo=algo, steps=7).steps == 7


@pytest.mark.parametrize("preset", dpend.rigs())
@pytest.mark.parametrize("task", ["swing-up", "balance"])
def test_every_rig_with_a_force_limit_can_be_trained_on(preset, task):
    rig = dpend.rig(preset)
    if not np.isfinite(rig.force_limit):
        with pytest.raises(
            ValueError, match=r"^Actions are shares of the force limit: expected a finite one; got inf\."
        ):
            DeepRecipe(rig=rig, task=task)
        return
    recipe = DeepRecipe(rig=rig, task=task, copies=3)
    assert recipe.period >= rig.sample_time
    assert recipe.period <= max(0.04, rig.sample_time)
    envs = training_envs(recipe)
    envs.reset(seed=0)
    _, rewards, *_ = envs.step(np.zeros((3, 1)))
    assert np.isfinite(rewards).all()


def test_for_the_swing_up_a_force_is_held_for_two_samples_and_for_one_while_balancing():
    assert (DeepRecipe().samples, DeepRecipe(task="balance").samples) == (2, 1)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"algo": "ppp"}, "There is no algo 'ppp'. Did you mean 'ppo'?"),
        ({"task": "swingup"}, "There is no task 'swingup'. Did you mean 'swing-up'?"),
        ({"starts": "resting"}, "There is no starts 'resting'. Did you mean 'rest'?"),
        ({"steps": -1}, "steps must be a whole number, at least 1; got -1."),
        ({"gamma": 1.0}, "gamma must be between 0 and 1; got 1.0."),
        ({"net": ()}, "net must be one or more widths, at least 1; got ()."),
        ({"action_rate": -1.0}, "action_rate must be finite and at least 0; got -1.0."),
        ({"algo": "sac"} | ppo(caps=(1.0, 1.0, 0.1)), "caps is for PPO; got algo 'sac'. Use action_rate."),
        ({"period": 0.03}, "period must be a whole number of samples of 0.02 s; got 0.03 s."),
        (
            {"rig": RIG.replace(sensor_noise=0.1), "period": 0.04},
            "Forces can be held for several samples on ideal rigs only; got one with lag, delay, noise or rounding: "
            "expected period = 0.02 s, the sample time.",
        ),
        ({"rig": RIG.replace(mass1=[0.5, 0.6])}, "A recipe has one rig; this one describes 2 rows."),
        (
            {"env": "InvertedDoublePendulum-v5", "action_rate": 1.0},
            "action_rate is for our own plant; got env 'InvertedDoublePendulum-v5'.",
        ),
        ({"sensor_noise": -0.1}, "sensor_noise must be finite and at least 0; got -0.1."),
        (off_policy(first_actions=0.1), "first_actions is for DDPG, TD3 and SAC; got algo 'ppo'. Use noise."),
        ({"episode": 0.0}, "episode must be finite and greater than 0; got 0.0."),
        ({"period": 0.0}, "period must be finite and greater than 0; got 0.0."),
        ({"steps": 0}, "steps must be a whole number, at least 1; got 0."),
        ({"noise": 0.0}, "noise must be finite and greater than 0; got 0.0."),
        ({"learning_rate": (0.0, 0.0)}, "learning_rate must be two numbers above 0; got (0.0, 0.0)."),
        ({"algo": "sac"} | ppo(target_kl=0.02), "target_kl is for PPO; got algo 'sac'."),
        ({"near": 0.2, "starts": "rest"}, "near is for mixed starts of the swing-up; got 'rest' of 'swing-up'."),
        ({"near": 0.2, "task": "balance"}, "near is for mixed starts of the swing-up; got 'mixed' of 'balance'."),
        ({"near": 0.0}, "near must be above 0 and at most pi/2; got 0.0."),
        (off_policy(library="jax"), "library is for DDPG, TD3 and SAC; got algo 'ppo'."),
        (off_policy(mirror=True), "mirror is for DDPG, TD3 and SAC; got algo 'ppo'."),
        (
            {"algo": "sac", "env": "InvertedDoublePendulum-v5"} | off_policy(mirror=True),
            "mirror is for our own plant; got env 'InvertedDoublePendulum-v5'.",
        ),
    ],
)
def test_recipes_that_make_no_sense_are_refused(changes, message):
    with pytest.raises(ValueError, match=whole(message)):
        DeepRecipe(**changes)


@pytest.mark.parametrize(
    ("kind", "changes", "message"),
    [
        (PPOSettings, {"target_kl": 0.0}, "target_kl must be finite and greater than 0; got 0.0."),
        (PPOSettings, {"caps": (1.0, 1.0)}, "caps must be three numbers, at least 0; got (1.0, 1.0)."),
        (OffPolicySettings, {"first_actions": 0.0}, "first_actions must be above 0 and at most 1; got 0.0."),
        (OffPolicySettings, {"library": "tensorflow"}, "There is no library 'tensorflow'. Known: jax, torch."),
    ],
)
def test_settings_of_one_algorithm_that_make_no_sense_are_refused(kind, changes, message):
    with pytest.raises(ValueError, match=whole(message)):
        kind(**changes)


def test_the_rig_comes_first_and_may_be_the_name_of_a_preset():
    preset: Any = "pilco2011"
    for kind in (DeepRecipe, DeepLearner):
        assert kind(preset).rig == kind(dpend.rig("pilco2011"), algo="sac").rig == dpend.rig("pilco2011")


def test_none_means_the_default_and_zero_means_zero():
    left_out: Any = None
    assert DeepRecipe(steps=left_out, noise=left_out).to_dict() == DeepRecipe().to_dict()
    assert DeepRecipe(algo="ddpg", noise=0.0).noise == 0.0
    assert DeepRecipe(enough=0.0).enough == 0.0
    noisy = RIG.replace(sensor_noise=0.1)
    for given, used in ((None, 0.1), (0.0, 0.0)):
        envs = training_envs(DeepRecipe(noisy, sensor_noise=given, copies=2))
        assert isinstance(envs, CartDoublePendulumVectorEnv)
        assert envs.rig.sensor_noise == used


@pytest.mark.parametrize(
    "recipe",
    [
        DeepRecipe(**ppo(target_kl=0.02, caps=(1.0, 2.0, 0.1))),
        DeepRecipe(
            dpend.rig("pilco2011"), algo="sac", enough=0.0, **off_policy(library="jax", mirror=True, first_actions=0.1)
        ),
        DeepRecipe(algo="td3", env="InvertedDoublePendulum-v5"),
    ],
    ids=lambda recipe: recipe.name,
)
def test_a_recipe_comes_back_from_its_record(recipe):
    record = json.loads(json.dumps(recipe.to_dict()))
    assert DeepRecipe.from_dict(record).to_dict() == recipe.to_dict()
    assert ("caps" in record) == (recipe.algo == "ppo") != ("mirror" in record)


KEPT = ROOT / "docs/results/deep"


def unpack(name, folder):
    """Write the kept trainings of a recipe as folders, as they were before they were packed."""
    header, _ = archive.read(KEPT / f"{name}.npz", "dpend deep trainings 1")
    for seed, training in read_trainings(KEPT / f"{name}.npz").items():
        own = folder / name / f"seed-{seed}"
        own.mkdir(parents=True)
        (own / "recipe.json").write_text(json.dumps({"seed": seed, "recipe": header["recipe"]}))
        columns = [training.curve[field].tolist() for field in Evaluation._fields]
        write_curve(own / "curve.csv", [Evaluation(*line) for line in zip(*columns, strict=True)])
        training.policy.save(own / "policy.npz")
    return folder / name


def test_a_record_from_before_none_meant_default_says_zero_where_it_means_none():
    ages = set()
    for file in kept_trainings(KEPT).values():
        old, new = archive.read(file, "dpend deep trainings 1")[0]["recipe"], read_recipe(file).to_dict()
        ages.add(len(old))
        for name in new.keys() & old.keys():
            value = json.loads(json.dumps(new[name]))
            assert value == old[name] or (value is None and not np.any(old[name] or 0)), name
    assert len(ages) >= 4


@pytest.mark.parametrize("name", ["ppo-swing-up-near", "td3-inverteddoublependulum-v5"])
def test_packed_trainings_are_to_the_bit_those_of_the_folders_that_were_packed(name, tmp_path):
    folder = unpack(name, tmp_path)
    file = pack(folder, tmp_path / "packed.npz")
    folders, packed = read_trainings(folder), read_trainings(file)
    assert read_recipe(file).to_dict() == read_recipe(folder).to_dict()
    assert list(packed) == list(folders)
    for seed, training in folders.items():
        again = packed[seed]
        assert (again.outcome, repr(again.cost)) == (training.outcome, repr(training.cost))
        assert again.policy.about == training.policy.about
        for new, old in ((again.curve, training.curve), (again.policy.arrays(), training.policy.arrays())):
            assert {key: (each.dtype, each.tobytes()) for key, each in new.items()} == {
                key: (each.dtype, each.tobytes()) for key, each in old.items()
            }


def test_trainings_are_found_packed_and_in_folders_of_which_a_policy_is_there(tmp_path):
    folder = unpack("ppo-swing-up-near", tmp_path)
    (tmp_path / "begun" / "seed-0").mkdir(parents=True)
    pack(folder, tmp_path / "elsewhere.npz")
    pack(folder, tmp_path / "ppo-swing-up-near.npz")
    assert kept_trainings(tmp_path) == {
        "elsewhere": tmp_path / "elsewhere.npz",
        "ppo-swing-up-near": folder,
    }


def test_trainings_of_two_recipes_or_none_are_not_packed(tmp_path):
    folder = unpack("ppo-swing-up-near", tmp_path)
    message = f"{folder} must hold trainings of one recipe, in folders such as seed-10."
    record = json.loads((folder / "seed-31" / "recipe.json").read_text())
    record["recipe"]["steps"] += 1
    (folder / "seed-31" / "recipe.json").write_text(json.dumps(record))
    with pytest.raises(ValueError, match=whole(message)):
        pack(folder, tmp_path / "packed.npz")
    with pytest.raises(ValueError, match=whole(message.replace(str(folder), str(tmp_path / "none")))):
        pack(tmp_path / "none", tmp_path / "packed.npz")


def test_a_file_of_something_else_is_no_file_of_trainings():
    file = ROOT / "rl/trained/lspi.npz"
    message = (
        f"{file} cannot be read as 'dpend deep trainings 1': it is 'dpend policy 2'. Save it again, or copy it afresh."
    )
    with pytest.raises(ValueError, match=whole(message)):
        read_trainings(file)


def test_a_training_that_is_kept_reads_like_one_that_has_just_ended(tmp_path):
    folder = unpack("ppo-swing-up", tmp_path) / "seed-10"
    training, curve = read_training(folder), read_curve(folder / "curve.csv")
    np.testing.assert_array_equal(training.curve["success"], [seen.success for seen in curve])
    assert training.curve["score"][training.details["best"]] == max(seen.score for seen in curve)
    recipe = read_recipe(folder)
    assert training.curve["experience"][-1] == pytest.approx(curve[-1].steps * recipe.period)
    assert training.cost.steps * RIG.sample_time == pytest.approx(training.curve["experience"][-1])
    assert training.converged == (recipe.enough is not None and curve[-1].success >= recipe.enough)
    snapshot = training.snapshots(3)[-1]
    assert snapshot.policy is training.policy
    assert snapshot.experience == training.experience


def test_half_the_swing_ups_start_hanging_and_half_to_the_side():
    starts = swing_up_starts(np.random.default_rng(0), 10, RIG)
    assert np.abs(starts[:5, 1:3] - np.pi).max() <= 0.05
    assert np.abs(starts[5:, 1:3] - np.pi / 2).max() <= 0.05
    assert (starts[:, [0, 3, 4, 5]] == 0).all()


def test_a_policy_that_does_nothing_never_swings_up():
    idle = MLPPolicy(Network([np.zeros((1, 8))], [[0.0]]), scales=np.ones(4), force_limit=40.0, period=0.04)
    success, variation = evaluate(idle, "swing-up", RIG, 10, 0)
    assert success == 0.0
    assert np.isnan(variation)


# ------------------------------------------------------------------------------------------------------------ training


def test_holding_a_force_is_stepping_twice():
    recipe = DeepRecipe(copies=4)
    envs = training_envs(recipe)
    assert isinstance(envs, CartDoublePendulumVectorEnv)
    envs.reset(seed=0)
    stepper = dpend.Stepper(RIG, 4)
    stepper.reset(envs.state)
    for share in np.random.default_rng(0).uniform(-0.2, 0.2, (10, 4, 1)):
        envs.step(share)
        stepper.step(40.0 * share[:, 0])
        stepper.step(40.0 * share[:, 0])
        np.testing.assert_allclose(envs.state, stepper.x, rtol=1e-12, atol=1e-12)


@needs_torch
@pytest.mark.parametrize("action_rate", [0.0, 0.3])
def test_the_adapter_gives_the_observations_and_rewards_of_its_equations(action_rate):
    from rl.sb3 import Copies

    recipe = DeepRecipe(copies=8, action_rate=action_rate)
    copies, envs = Copies(training_envs(recipe), recipe), training_envs(recipe)
    copies.seed(3)
    copies.grown = 0.6
    o = copies.reset()
    y, _ = envs.reset(seed=3)
    scales, rng, last, ended = observation_scales(RIG), np.random.default_rng(0), np.zeros(8), 0

    def seen(states, last):
        return observe(states, scales, last if action_rate else None).astype(np.float32)

    def finals(said):
        return np.stack([np.zeros(6) if y is None else y for y in said.get("final_obs", [None] * 8)])

    np.testing.assert_array_equal(o, seen(y, last))
    for _ in range(260):
        actions = rng.uniform(-1, 1, (8, 1)).astype(np.float32)
        o, rewards, dones, infos = copies.step(actions)
        y, expected, terminated, truncated, said = envs.step(actions)
        a = actions[:, 0].astype(float)
        cos1, cos2 = np.cos(np.where((terminated | truncated)[:, None], finals(said), y)[:, 1:3]).T
        near = np.exp(-5.0 * (2.0 - cos1 - cos2))
        expected = expected - 0.6 * action_rate * np.abs(a - last) * near
        np.testing.assert_allclose(rewards, expected, rtol=1e-6, atol=1e-6)
        np.testing.assert_array_equal(dones, terminated | truncated)
        for i in np.flatnonzero(dones):
            final = seen(said["final_obs"][i][None], a[i : i + 1])[0]
            np.testing.assert_array_equal(infos[i]["terminal_observation"], final)
            assert infos[i]["TimeLimit.truncated"] == (truncated[i] and not terminated[i])
        last = np.where(dones, 0.0, a)
        np.testing.assert_array_equal(o, seen(y, last))
        ended += dones.sum()
    assert ended >= 8


@needs_torch
@pytest.mark.parametrize(
    "recipe",
    [
        small("ppo"),
        small("ppo", action_rate=0.1, **ppo(caps=(1.0, 1.0, 0.1))),
        small("ddpg"),
        small("td3", **off_policy(layer_norm=False)),
        small("sac"),
        *(
            pytest.param(small(algo, **off_policy(library="jax")), marks=[needs_jax, pytest.mark.slow])
            for algo in ("ddpg", "td3", "sac")
        ),
    ],
    ids=lambda recipe: f"{recipe.name}-{recipe.library}",
)
def test_an_exported_policy_acts_as_its_model(recipe):
    learner = learner_class(recipe)(recipe, 0)
    learner.learn(1024)
    x = np.random.default_rng(0).normal(scale=(1, 3, 3, 3, 6, 6), size=(500, 6))
    last = np.random.default_rng(1).uniform(-1, 1, 500) if recipe.action_rate else None
    o = observe(x, observation_scales(RIG), last)
    of_model = np.clip(learner.act(o.astype(np.float32)), -1, 1)
    np.testing.assert_allclose(learner.network()(o), of_model, rtol=0, atol=1e-5)
    assert np.ptp(of_model) > 1e-3


@pytest.mark.parametrize(("episode", "seconds"), [(None, 10.0), (3.0, 3.0)])
def test_an_episode_is_cut_off_after_the_seconds_that_the_recipe_says(episode, seconds):
    recipe = DeepRecipe(algo="ddpg", episode=episode, copies=4)
    envs = training_envs(recipe)
    envs.reset(seed=0)
    cut_off = [bool(envs.step(np.zeros((4, 1)))[3].any()) for _ in range(250)]
    assert (cut_off.index(True) + 1) * recipe.period == pytest.approx(seconds)


@needs_torch
@pytest.mark.parametrize("library", ["torch", pytest.param("jax", marks=[needs_jax, pytest.mark.slow])])
@pytest.mark.parametrize("algo", ["td3", "sac"])
def test_small_first_actions_begin_with_a_hundredth_of_the_force(algo, library):
    o = np.random.default_rng(0).normal(size=(300, 8)).astype(np.float32)
    plain, gentle = (
        np.arctanh(learner_class(recipe)(recipe, 0).act(o).astype(float))
        for recipe in (small(algo, **off_policy(library=library, first_actions=first)) for first in (1.0, 0.01))
    )
    np.testing.assert_allclose(gentle - gentle.mean(), 0.01 * (plain - plain.mean()), atol=1e-4)


@pytest.mark.parametrize("near", [0.1, 0.25])
def test_a_quarter_of_the_starts_are_at_rest_and_as_near_upright_as_the_recipe_says(near):
    envs = training_envs(DeepRecipe(near=near, copies=4000))
    assert isinstance(envs, CartDoublePendulumVectorEnv)
    envs.reset(seed=0)
    at_rest = envs.state[(np.abs(envs.state[:, [0, 3, 4, 5]]) < 1e-12).all(axis=1)]
    upright = np.abs(at_rest[np.abs(at_rest[:, 1:3]).max(axis=1) < 1.0, 1:3])
    assert len(upright) == pytest.approx(1000, abs=100)
    assert upright.max() == pytest.approx(near, rel=0.01)
    assert upright.max() <= near


@needs_torch
@pytest.mark.parametrize(("target_kl", "epochs"), [(None, 4), (1e-9, 1)])
def test_a_round_of_ppo_ends_where_it_has_gone_far_enough(target_kl, epochs):
    from rl.sb3 import Learner

    learner = Learner(small(updates=4 / 64, **ppo(target_kl=target_kl)), 0)
    learner.learn(1024)
    assert learner._model._n_updates == epochs


@needs_torch
def test_the_weight_of_changes_grows_in_the_first_half_of_the_steps():
    from rl.sb3 import Learner

    learner = Learner(small("ddpg", action_rate=0.3), 0)
    seen = []
    for _ in range(4):
        learner.learn(512)
        seen.append(learner._env.grown)
    assert seen == [0.5, 1.0, 1.0, 1.0]


@needs_torch
def test_noise_while_learning_is_on_what_is_seen_and_not_on_the_rig_of_evaluations():
    recipe = DeepRecipe(copies=2000, sensor_noise=0.01)
    assert recipe.rig == RIG
    envs = training_envs(recipe)
    assert isinstance(envs, CartDoublePendulumVectorEnv)
    y, _ = envs.reset(seed=0)
    np.testing.assert_allclose((y - envs.state).std(axis=0), 0.01, rtol=0.1)


@needs_torch
def test_mirrored_transitions_are_those_of_the_mirrored_plant():
    from rl.sb3 import Learner

    learner = Learner(small("ddpg", copies=4, **off_policy(mirror=True)), 0)
    learner.learn(200)
    buffer = learner._model.replay_buffer
    kept = {}
    for i in range(buffer.pos):
        for j in range(4):
            line = buffer.observations[i, j], buffer.actions[i, j], buffer.next_observations[i, j]
            kept[np.abs(line[0]).tobytes()] = (*line, buffer.rewards[i, j])
    samples, signs = buffer.sample(300), []
    for o, a, following, reward in zip(
        samples.observations.numpy(),
        samples.actions.numpy(),
        samples.next_observations.numpy(),
        samples.rewards.numpy(),
        strict=True,
    ):
        before, action, after, gain = kept[np.abs(o).tobytes()]
        sign = 1.0 if (o == before).all() else -1.0
        mirror = np.array([sign, sign, 1, sign, 1, sign, sign, sign])
        np.testing.assert_array_equal(o, mirror * before)
        np.testing.assert_array_equal(following, mirror * after)
        assert (a, reward) == (sign * action, gain)
        signs.append(sign)
    assert abs(np.mean(signs)) < 0.3


@needs_torch
def test_caps_pairs_observations_with_those_that_follow_and_takes_both_losses_off():
    import torch

    from rl.sb3 import CAPSPolicy, Learner

    learner = Learner(small("ppo", **ppo(caps=(2.0, 0.0, 0.1))), 0)
    model = learner._model
    learner.learn(1024)
    buffer = model.rollout_buffer
    observations = (
        buffer.swap_and_flatten(buffer.observations) if buffer.observations.ndim == 3 else buffer.observations
    )
    samples = next(buffer.get(1024))
    now, following = samples.observations.numpy()[:, :8], samples.observations.numpy()[:, 8:]
    order = {row.tobytes(): i for i, row in enumerate(observations)}
    index = np.array([order[row.tobytes()] for row in now])
    starts = buffer.episode_starts.reshape(64, 16).T.ravel() if buffer.episode_starts.ndim == 2 else None
    ended = (index + 1) % 64 == 0
    if starts is not None:
        ended |= starts[(index + 1) % len(starts)] > 0
    expected = np.where(ended[:, None], now, observations[(index + 1) % len(observations)])
    np.testing.assert_array_equal(following, expected)
    policy = model.policy
    assert isinstance(policy, CAPSPolicy)
    with torch.no_grad():
        minus_loss = policy.evaluate_actions(samples.observations, samples.actions)[2].numpy()
    network = learner.network()
    gap = np.abs(network(now.astype(float)) - network(following.astype(float)))[:, 0]
    np.testing.assert_allclose(minus_loss, -2.0 * gap, atol=1e-5)


@needs_torch
@pytest.mark.parametrize(
    "recipe",
    [
        small(),
        small("sac"),
        pytest.param(small("td3", **off_policy(library="jax")), marks=[needs_jax, pytest.mark.slow]),
        pytest.param(small("sac", **off_policy(library="jax")), marks=[needs_jax, pytest.mark.slow]),
    ],
    ids=lambda recipe: f"{recipe.algo}-{recipe.library}",
)
def test_a_training_that_was_stopped_goes_on_and_a_finished_one_is_left_as_it_is(recipe, tmp_path):
    class Stopped(Exception):
        pass

    def stop(seen):
        raise Stopped

    with pytest.raises(Stopped):
        train_deep(recipe, 0, out=tmp_path, progress=stop)
    kept = read_curve(tmp_path / "curve.csv")
    assert [seen.steps for seen in kept] == [1024]
    training = train_deep(recipe, 0, out=tmp_path)
    assert list(training.curve["steps"]) == [1024, 2048]
    assert training.curve["success"][0] == kept[0].success
    assert training.curve["cpu_seconds"][1] > training.curve["cpu_seconds"][0]
    assert [snapshot.experience for snapshot in training.snapshots(2)] == list(training.curve["experience"])
    content = (tmp_path / "checkpoint.pt").read_bytes()
    again = train_deep(recipe, 0, out=tmp_path)
    for name in Evaluation._fields:
        np.testing.assert_array_equal(again.curve[name], training.curve[name])
    assert (tmp_path / "checkpoint.pt").read_bytes() == content
    for mine, theirs in zip(weights(again), weights(training), strict=True):
        np.testing.assert_array_equal(mine, theirs)


@needs_jax
@pytest.mark.slow
@pytest.mark.parametrize("algo", ["ddpg", "td3", "sac"])
def test_in_jax_the_rate_of_all_that_learns_falls_with_the_steps(algo):
    from rl.sb3_jax import Learner, _states

    recipe = small(algo, **off_policy(library="jax"), learning_rate=(1e-3, 1e-4))
    learner = Learner(recipe, 0)
    learner.learn(recipe.steps // 2)
    done = learner.steps / recipe.steps
    states = _states(learner._model)
    assert len(states) == 2 + (algo == "sac")
    for state in states.values():
        assert float(state.opt_state.hyperparams["learning_rate"]) == pytest.approx(1e-3 - 9e-4 * done, rel=0.01)


@needs_jax
@pytest.mark.slow
def test_sac_in_jax_that_goes_on_does_not_explore_as_it_did_the_first_time(tmp_path):
    recipe = small("sac", **off_policy(library="jax"))
    first, again = (learner_class(recipe)(recipe, 0) for _ in range(2))
    first.save(tmp_path / "checkpoint.pt", {"network": {}})
    again.restore(tmp_path / "checkpoint.pt")
    o = np.zeros((300, 8), dtype=np.float32)
    one, other = (learner._model.predict(o, deterministic=False)[0] for learner in (first, again))
    assert np.abs(one - other).max() > 0.1


@needs_torch
def test_the_same_seed_learns_the_same_and_another_something_else():
    one, same, other = (weights(train_deep(small(), seed))[0] for seed in (0, 0, 1))
    assert (one == same).all()
    assert (one != other).any()


@needs_torch
def test_a_folder_of_another_training_is_refused(tmp_path):
    train_deep(small(steps=1024), 0, out=tmp_path)
    message = f"{tmp_path} holds another training: recipe.json has other settings. Choose another folder."
    for recipe, seed in ((small(steps=1024), 1), (small(steps=1024, gamma=0.9), 0)):
        with pytest.raises(ValueError, match=whole(message)):
            train_deep(recipe, seed, out=tmp_path)


@needs_torch
@pytest.mark.slow
def test_a_small_budget_learns_to_balance():
    recipe = DeepRecipe(
        task="balance", steps=1_000_000, copies=128, evaluate_every=100_000, evaluation_starts=100, enough=0.3
    )
    training = train_deep(recipe, 0)
    assert training.curve["success"][0] < 0.1
    assert training.curve["success"][training.details["best"]] >= 0.3
    assert training.outcome is Outcome.CONVERGED


# -------------------------------------------------------------------------------------------------------- without torch


def run_python(program, *, without=()):
    hide = "".join(f"sys.modules[{name!r}] = None; " for name in without)
    return subprocess.run(
        [sys.executable, "-c", f"import sys; {hide}{program}"], cwd=ROOT, capture_output=True, text=True, check=False
    )


@pytest.mark.slow
def test_importing_the_learners_loads_no_torch():
    done = run_python(f"import rl; print([name for name in {NEEDED['jax']} if name in sys.modules])")
    assert (done.stdout, done.stderr) == ("[]\n", "")


@pytest.mark.slow
def test_without_torch_training_says_what_to_install():
    done = run_python("import rl; rl.train_deep(rl.DeepRecipe())", without=("torch", "stable_baselines3"))
    assert done.stderr.rstrip().splitlines()[-1] == f"ImportError: {INSTALL['torch']}"


@pytest.mark.slow
def test_without_jax_training_in_it_says_what_to_install():
    program = (
        "import rl; rl.train_deep(rl.DeepRecipe(algo='ddpg', off_policy=rl.recipes.OffPolicySettings(library='jax')))"
    )
    done = run_python(program, without=("sbx", "jax"))
    assert done.stderr.rstrip().splitlines()[-1] == f"ImportError: {INSTALL['jax']}"


@pytest.mark.slow
def test_without_torch_the_command_line_says_what_to_install():
    program = "from rl import train; train.find_spec = lambda name: None; train.main(['--algo', 'ddpg'])"
    done = run_python(program)
    assert done.returncode == 2
    assert " ".join(done.stderr.split()) == f"Error: {INSTALL['torch']}"


def test_the_command_line_refuses_bad_settings_before_anything_runs(capsys):
    from rl import train

    for arguments, message in (
        (["--rig", "gustafson2016"], "There is no preset rig 'gustafson2016'."),
        (["--seeds", "0"], "--seeds must be a whole number, at least 1; got 0."),
        (["--workers", "0"], "--workers must be a whole number, at least 1; got 0."),
        (["--gamma", "1"], "gamma must be between 0 and 1; got 1.0."),
    ):
        with pytest.raises(SystemExit, match="2"):
            train.main(arguments)
        assert message in capsys.readouterr().err


def test_the_command_line_states_a_recipe(monkeypatch):
    from rl import train

    followed = []
    monkeypatch.setattr(train, "_train", lambda options, recipe, *_: followed.append(recipe))
    monkeypatch.setattr(train, "find_spec", lambda name: True)
    settings = ["--algo", "sac", "--rig", "pilco2011", "--net", "8", "9", "--learning-rate", "1e-3", "1e-4"]
    train.main([*settings, "--no-layer-norm"])
    expected = DeepRecipe(
        algo="sac", rig=dpend.rig("pilco2011"), net=(8, 9), learning_rate=(1e-3, 1e-4), **off_policy(layer_norm=False)
    )
    assert followed[0].to_dict() == expected.to_dict()
    train.main(["--algo", "ppo", "--target-kl", "0.02", "--caps", "1", "2", "0.1", "--enough", "1"])
    assert followed[1].to_dict() == DeepRecipe(enough=1.0, **ppo(target_kl=0.02, caps=(1.0, 2.0, 0.1))).to_dict()
    train.main(["--algo", "ddpg", "--library", "jax", "--mirror", "--first-actions", "0.01", "--episode", "3"])
    own = off_policy(library="jax", mirror=True, first_actions=0.01)
    assert followed[2].to_dict() == DeepRecipe(algo="ddpg", episode=3.0, **own).to_dict()


class Scripted:
    """A learner whose networks push by what it is scripted to, round by round, and which keeps itself as its steps."""

    def __init__(self, recipe, seed):
        self.recipe, self.steps = recipe, 0

    def learn(self, steps):
        self.steps += -(-steps // self.recipe.round) * self.recipe.round

    def network(self):
        return Network([np.zeros((1, 8))], [[0.001 * self.steps / self.recipe.round]])

    def save(self, path, beside):
        path.write_text(json.dumps({"steps": self.steps, "beside": beside}, default=lambda array: array.tolist()))

    def restore(self, path):
        kept = json.loads(path.read_text())
        self.steps = kept["steps"]
        return kept["beside"]


@pytest.mark.parametrize("stop_after", [1, 2, 4])
def test_the_best_policy_is_kept_and_a_training_that_was_stopped_ends_as_one_that_was_not(
    stop_after, tmp_path, monkeypatch
):
    scores = {1: 0.2, 2: 0.7, 3: 0.7, 4: 0.1}
    monkeypatch.setattr("rl.deep.learner_class", lambda recipe: Scripted)
    monkeypatch.setattr("rl.deep._versions", lambda recipe: {})
    monkeypatch.setattr("rl.deep.evaluate", lambda policy, *_: (scores[round(1000 * policy.network.biases[0][0])], 0.5))
    recipe = small(steps=4096)
    whole_one = train_deep(recipe, 0)

    class Stopped(Exception):
        pass

    def stop(seen):
        if seen.steps == 1024 * stop_after:
            raise Stopped

    with pytest.raises(Stopped):
        train_deep(recipe, 0, out=tmp_path, progress=stop)
    goes_on = train_deep(recipe, 0, out=tmp_path)
    for training in (whole_one, goes_on, read_training(tmp_path)):
        assert list(training.curve["score"]) == list(scores.values())
        assert training.details["best"] == 2  # the latest among equals
        assert training.policy.network.biases[0][0] == pytest.approx(0.003)
        assert training.policy.about["evaluation"]["steps"] == 3072
        assert training.cost.steps == 4096 * recipe.samples
        assert training.cost.test_steps == 4 * 4 * 500
    for training in (whole_one, goes_on):
        ways = training.snapshots(10)
        assert [snapshot.experience for snapshot in ways] == pytest.approx(
            list(recipe.period * training.curve["steps"])
        )
        laws: list[Any] = [snapshot.policy for snapshot in ways]
        assert [law.network.biases[0][0] for law in laws] == pytest.approx([0.001, 0.002, 0.003, 0.004])


def test_a_deep_learner_takes_whole_rounds_within_its_time(monkeypatch):
    monkeypatch.setattr("rl.deep.learner_class", lambda recipe: Scripted)
    monkeypatch.setattr("rl.deep._versions", lambda recipe: {})
    monkeypatch.setattr("rl.deep.evaluate", lambda *_: (0.5, 0.5))
    settings: dict[str, Any] = SMALL | {"steps": 4096}
    learner, shares = DeepLearner(RIG, **settings), []
    training = learner.train([3, 1], seconds=3500 * learner.period, progress=shares.append)
    assert list(training.curve["steps"]) == [1024, 2048, 3072]
    assert training.cost.steps * RIG.sample_time <= 3500 * learner.period
    assert shares == pytest.approx([1 / 3, 2 / 3, 1.0, 1.0])
    assert training.outcome is Outcome.BUDGET_SPENT


@needs_torch
def test_a_deep_learner_is_a_learner_like_others():
    learner = DeepLearner(RIG, **SMALL)
    shares = []
    training = learner.train([3, 1], seconds=1500 * learner.period, progress=shares.append)
    assert list(training.curve["steps"]) == [1024]  # the rounds within the time
    assert shares == [1.0, 1.0]
    assert training.cost.steps == 1024 * learner.samples
    latest = training.snapshots(5)[-1].policy
    assert isinstance(latest, MLPPolicy)
    assert (latest.network.weights[0] == weights(training)[0]).all()


@pytest.mark.parametrize(
    ("recipe", "seconds", "message"),
    [
        (small(), 1.0, "seconds must allow one round of 1024 environment steps, 40.96 s; got 1.0."),
        (small(), -1.0, "seconds must be finite and at least one sample, 0.04 s; got -1.0."),
        (
            small("sac", env="InvertedDoublePendulum-v5"),
            1.0,
            "seconds is for our own plant; got env 'InvertedDoublePendulum-v5'.",
        ),
    ],
)
def test_a_time_that_allows_no_round_is_refused(recipe, seconds, message):
    with pytest.raises(ValueError, match=whole(message)):
        DeepLearner.train(recipe, 0, seconds=seconds)


@needs_torch
def test_a_training_ends_with_the_first_evaluation_that_is_good_enough():
    for enough, evaluations in ((0.999, 2), (0.0, 1)):
        training = train_deep(small(task="balance", enough=enough), 0)
        assert len(training.curve["steps"]) == evaluations
        assert training.converged == (enough == 0.0)


@needs_torch
@pytest.mark.slow
def test_killed_in_the_middle_and_started_again_it_goes_on(tmp_path):
    small_ones = [
        "--steps",
        "16384",
        "--copies",
        "16",
        "--batch",
        "64",
        "--evaluate-every",
        "1024",
        "--evaluation-starts",
        "4",
    ]
    command = [sys.executable, "-m", "rl.train", *small_ones, "--out", str(tmp_path)]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while not (tmp_path / "seed-0" / "curve.csv").exists():
        time.sleep(0.02)
        assert process.poll() is None
    process.kill()
    process.wait()
    before = read_curve(tmp_path / "seed-0" / "curve.csv")
    assert 1 <= len(before) < 16
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    after = read_curve(tmp_path / "seed-0" / "curve.csv")
    assert repr(after[: len(before)]) == repr(before)
    assert [seen.steps for seen in after] == list(range(1024, 16385, 1024))


@needs_torch
@pytest.mark.slow
def test_several_seeds_are_trained_side_by_side(tmp_path, capsys):
    from rl import train

    small_ones = [
        "--steps",
        "1024",
        "--copies",
        "16",
        "--batch",
        "64",
        "--evaluate-every",
        "1024",
        "--evaluation-starts",
        "4",
    ]
    policies = train.main(
        [*small_ones, "--seeds", "2", "--workers", "2", "--out", str(tmp_path), "--pack", str(tmp_path / "all.npz")]
    )
    assert [policy.about["seed"] for policy in policies] == [0, 1]
    assert policies[0].about["command"].startswith("python -m rl.train --steps 1024")
    assert (tmp_path / "seed-1" / "policy.npz").exists()
    assert list(read_trainings(tmp_path / "all.npz")) == [0, 1]
    assert "environment steps" in capsys.readouterr().out


@needs_torch
@pytest.mark.skipif(not find_spec("mujoco"), reason="Gymnasium's own double pendulum needs MuJoCo, the extra `peers`")
def test_another_environment_is_learned_by_the_same_code(tmp_path):
    recipe = small("sac", env="InvertedDoublePendulum-v5", steps=256, evaluate_every=256)
    training = train_deep(recipe, 0, out=tmp_path)
    network = load_policy(tmp_path / "policy.npz")
    assert isinstance(network, Network)
    assert (network.inputs, network.outputs) == (9, 1)
    assert training.curve["score"][training.details["best"]] > 0
    assert np.isnan(training.curve["variation"]).all()
