"""The command that trains linear learners, and the policies it made that are shipped."""

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose

import dpend
from rl import GainPolicy, LinearQPolicy, Network, load_policy
from rl.linear import main, train_linear
from tests.rigs import whole

RIG = dpend.rig("gustafsson2016")


@pytest.mark.parametrize(
    ("name", "kind"), [("lspi", GainPolicy), ("qac_tuned", GainPolicy), ("q_tuned", LinearQPolicy)]
)
def test_a_shipped_policy_balances_and_says_by_which_command_it_was_made(name, kind):
    policy = load_policy(name)
    assert isinstance(policy, kind)
    assert not isinstance(policy, Network)
    assert policy.about["command"] == f"python -m rl.linear --algo {name} --rig gustafsson2016 --seed 0"
    task = dpend.Balance(lam=0.2)
    starts = task.starts(np.random.default_rng(5), 200, RIG)
    assert dpend.simulate_many(RIG, policy, starts, task=task).success.mean() > 0.97


def test_the_command_makes_the_shipped_policy_again(tmp_path):
    path = main(["--algo", "lspi", "--out", str(tmp_path / "again.npz")])
    again, shipped = load_policy(path), load_policy("lspi")
    assert isinstance(again, GainPolicy)
    assert isinstance(shipped, GainPolicy)
    assert_allclose(again.K, shipped.K, rtol=0, atol=0.02 * float(np.linalg.norm(shipped.K)))
    assert again.about["seed"] == 0


def test_an_unknown_rig_is_refused_by_the_command_before_anything_is_learned(capsys, tmp_path):
    with pytest.raises(SystemExit, match="2"):
        main(["--rig", "gustafson2016", "--out", str(tmp_path / "none.npz")])
    assert "gustafsson2016" in re.sub(r"\s+", " ", capsys.readouterr().err)
    assert not list(tmp_path.iterdir())


def test_an_unknown_learner_is_refused():
    with pytest.raises(ValueError, match=whole("algo must be one of 'lspi', 'qac_tuned', 'q_tuned'; got 'sarsa'.")):
        train_linear("sarsa", RIG, 0)  # pyright: ignore[reportArgumentType]
