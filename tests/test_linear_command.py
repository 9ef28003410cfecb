"""The command that trains linear learners, and the policies it made that are shipped."""

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import dpend
from rl import Cost, GainPolicy, LinearQPolicy, Network, Outcome, Training, load_policy, train
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


@pytest.mark.slow
def test_the_command_makes_the_shipped_policy_again_side_by_side_with_another(tmp_path, capsys):
    main(["--algo", "lspi", "--seeds", "2", "--workers", "2", "--out", str(tmp_path)])
    other = load_policy(tmp_path / "seed-1" / "policy.npz")
    again, shipped = load_policy(tmp_path / "seed-0" / "policy.npz"), load_policy("lspi")
    assert isinstance(again, GainPolicy)
    assert isinstance(shipped, GainPolicy)
    assert_allclose(again.K, shipped.K, rtol=0, atol=0.02 * float(np.linalg.norm(shipped.K)))
    assert (again.about["seed"], other.about["seed"]) == (0, 1)
    assert "converged" in capsys.readouterr().out


@dataclass(frozen=True)
class Still:
    """A learner that learns to do nothing, and says of which rig."""

    rig: dpend.Rig
    task = "balance"

    def train(self, seed, *, seconds=None, progress=None):
        policy = GainPolicy(np.zeros(6), about={"seed": seed, "mass1": float(self.rig.params.mass1)})
        cost = Cost(episodes=0, steps=0, sample_time=0.02, cpu_seconds=0.0)
        return Training(policy=policy, outcome=Outcome.BUDGET_SPENT, cost=cost, curve={})


def test_a_learner_joins_by_an_entry_and_takes_a_rig_from_a_file_with_its_numbers_changed(tmp_path, monkeypatch):
    monkeypatch.setattr(train, "LINEAR", {"still": Still})
    file = RIG.replace(mass1=0.7, track_limit=3.0).to_toml(tmp_path / "mine.toml")
    told = ["--algo", "still", "--rig", str(file), "--out", str(tmp_path)]
    assert main(told)[0].about["mass1"] == 0.7
    assert main([*told, "--set", "mass1=.6", "--set", "substeps=3"])[0].about["mass1"] == 0.6
    assert main(["--algo", "still", "--set", "mass1=.9", "--out", str(tmp_path)])[0].about["mass1"] == 0.9


def test_the_rig_of_a_deep_training_has_its_numbers_changed_too(monkeypatch):
    recipes = []
    monkeypatch.setattr(train, "_train", lambda options, recipe, *_: recipes.append(recipe))
    monkeypatch.setattr(train, "find_spec", lambda name: True)
    main(["--algo", "sac", "--rig", "pilco2011", "--set", "mass1=.6", "--gamma", "0.9"])
    assert recipes[0].rig == dpend.rig("pilco2011").replace(mass1=0.6)
    assert recipes[0].gamma == 0.9


def test_ctrl_c_ends_the_command_with_130(tmp_path, monkeypatch, capsys):
    class Stopped(Still):
        def train(self, seed, *, seconds=None, progress=None):
            raise KeyboardInterrupt

    monkeypatch.setattr(train, "LINEAR", {"stopped": Stopped})
    with pytest.raises(SystemExit, match="130"):
        main(["--algo", "stopped", "--out", str(tmp_path)])
    assert "Stopped. Seeds that were finished are kept." in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("from_input", "remedy"),
    [(False, 'keep what it does under `if __name__ == "__main__":`'), (True, "is no file: save it as one")],
    ids=["no guard", "standard input"],
)
def test_a_program_that_trains_in_processes_and_cannot_be_imported_is_told_the_remedy(from_input, remedy, tmp_path):
    words = ["--algo", "lspi", "--seeds", "2", "--workers", "2", "--out", str(tmp_path / "out")]
    program = f"from rl.train import main\nmain({words})\n"
    (tmp_path / "program.py").write_text(program)
    command = [sys.executable, "-" if from_input else str(tmp_path / "program.py")]
    environment = {"PYTHONPATH": str(Path(__file__).parent.parent), "PATH": ""}
    done = subprocess.run(command, input=program, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert remedy in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("told", "message"),
    [
        (["--rig", "gustafson2016"], "Did you mean 'gustafsson2016'?"),
        (["--set", "mas1=.6"], "Did you mean 'mass1'?"),
        (["--set", "mass1"], "--set takes NAME=NUMBER, such as mass1=.6; got 'mass1'."),
        (["--seed", "-1"], "--seed must be a whole number, at least 0; got -1."),
    ],
)
def test_options_that_make_no_sense_are_refused_by_the_command_before_anything_is_learned(
    told, message, capsys, tmp_path
):
    with pytest.raises(SystemExit, match="2"):
        main(["--algo", "lspi", *told, "--out", str(tmp_path)])
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("told", [["--algo", "sarsa"], ["--algo", "lspi", "--steps", "1000"]])
def test_an_unknown_learner_and_a_setting_that_it_lacks_are_refused(told, capsys):
    with pytest.raises(SystemExit, match="2"):
        main(told)
    assert told[-2] in capsys.readouterr().err


def test_help_fits_a_screen_and_says_where_the_settings_of_deep_learners_are(capsys):
    with pytest.raises(SystemExit, match="0"):
        train.main(["--help"])
    brief = capsys.readouterr().out
    assert len(brief.splitlines()) <= 24
    assert "--algo ppo --help" in brief
    with pytest.raises(SystemExit, match="0"):
        train.main(["--algo", "ppo", "--help"])
    assert "--target-kl" in capsys.readouterr().out
