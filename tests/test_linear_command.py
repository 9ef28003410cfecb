"""The command that trains linear learners, and the policies it made that are shipped."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import dpend
from rl import GainPolicy, LinearQPolicy, Network, load_policy
from rl.train import main

RIG = dpend.rig("gustafsson2016")


@pytest.mark.parametrize(
    ("name", "kind"), [("lspi", GainPolicy), ("qac-tuned", GainPolicy), ("q-tuned", LinearQPolicy)]
)
def test_a_shipped_policy_balances_and_says_by_which_command_it_was_made(name, kind):
    policy = load_policy(name)
    assert isinstance(policy, kind)
    assert not isinstance(policy, Network)
    assert policy.about["command"] == f"python -m rl.train --algo {name}"
    assert policy.about["seed"] == 0
    task = dpend.Balance(lam=0.2)
    starts = task.starts(np.random.default_rng(5), 200, RIG)
    assert dpend.simulate_many(RIG, policy, starts, task=task).success.mean() > 0.97


def test_the_command_makes_the_shipped_policy_again(tmp_path):
    main(["--algo", "lspi", "--seeds", "2", "--out", str(tmp_path)])
    other = load_policy(tmp_path / "seed-1" / "policy.npz")
    again, shipped = load_policy(tmp_path / "seed-0" / "policy.npz"), load_policy("lspi")
    assert isinstance(again, GainPolicy)
    assert isinstance(shipped, GainPolicy)
    assert_allclose(again.K, shipped.K, rtol=0, atol=0.02 * float(np.linalg.norm(shipped.K)))
    assert (again.about["seed"], other.about["seed"]) == (0, 1)


def test_an_unknown_rig_is_refused_by_the_command_before_anything_is_learned(capsys, tmp_path):
    with pytest.raises(SystemExit, match="2"):
        main(["--algo", "lspi", "--rig", "gustafson2016", "--out", str(tmp_path)])
    assert "Did you mean" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("told", [["--algo", "sarsa"], ["--algo", "lspi", "--steps", "1000"]])
def test_an_unknown_learner_and_a_setting_that_it_lacks_are_refused(told, capsys):
    with pytest.raises(SystemExit, match="2"):
        main(told)
    assert told[-2] in capsys.readouterr().err
