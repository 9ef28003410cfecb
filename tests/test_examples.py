# pyright: reportMissingImports=false
"""The examples learn what they say they learn, and refuse what they cannot train."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest

import dpend
from controllers import LQR

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not all(find_spec(name) for name in ("torch", "stable_baselines3")),
        reason="the examples need torch and Stable-Baselines3, the extra `deep`",
    ),
]
both = pytest.mark.parametrize("name", ["ppo", "sb3_ppo"])


def example(name: str) -> Any:
    """Return the module of an example; imported here, for without torch there is nothing to import."""
    return import_module(f"examples.{name}")


def test_twenty_thousand_steps_of_the_handwritten_ppo_double_how_long_the_links_stay_up() -> None:
    import torch

    ppo = example("ppo")

    @torch.no_grad()
    def samples_up(agent: Any) -> float:
        envs = ppo.make("dpend/Balance-v0", 100)
        observations, _ = envs.reset(seed=7)
        up, over = np.zeros(100), np.zeros(100, bool)
        while not over.all():
            observations, rewards, terminated, truncated, _ = envs.step(agent.mean(ppo.tensor(observations)).numpy())
            up += np.where(over, 0.0, rewards)
            over |= terminated | truncated
        return float(up.mean())

    torch.manual_seed(0)
    assert samples_up(ppo.train(ppo.Options(steps=20_480))) > 2 * samples_up(ppo.Agent(6, 1))


@both
def test_the_command_line_trains_and_ends_with_the_success_and_its_interval(name: str, capsys: Any) -> None:
    example(name).main(["--steps", "2048", "--report-every", {"ppo": "1", "sb3_ppo": "2048"}[name]])
    *_, progress, last = capsys.readouterr().out.splitlines()
    assert progress.startswith("    2,048 steps: ")
    assert progress.endswith(" of 50 starts")
    share, successes = last.removeprefix("Success ").split("%")[0], last.split("]: ")[1].split()[0]
    assert last == last.strip()
    assert last.endswith(f"]: {successes} of 200 fresh starts.")
    assert float(share) == int(successes) / 2


@pytest.mark.parametrize(
    ("name", "arguments", "message"),
    [
        ("ppo", ["--steps", "2000"], "--steps must be at least a rollout, 2048; got 2000."),
        ("ppo", ["--copies", "0"], "--copies must be at least 1; got 0."),
        ("ppo", ["--batch", "100"], "--batch must be at least 2 and divide a rollout, 2048; got 100."),
        ("ppo", ["--gamma", "nan"], "--gamma must be above 0 and at most 1; got nan."),
        ("ppo", ["--seed", "-1"], "--seed must be at least 0; got -1."),
        ("ppo", ["--env", "CartPole-v1"], "invalid choice 'CartPole-v1'"),
        ("sb3_ppo", ["--steps", "0"], "--steps must be at least 1; got 0."),
        ("sb3_ppo", ["--report-every", "many"], "invalid literal for int() with base 10: 'many'"),
    ],
)
def test_the_command_line_refuses_what_cannot_be_trained(
    name: str, arguments: list[str], message: str, capsys: Any
) -> None:
    with pytest.raises(SystemExit, match="2"):
        example(name).main(arguments)
    said = capsys.readouterr().err.replace("│", " ")
    assert message in " ".join(said.split())


def test_an_agent_that_never_trains_balances_from_no_start_and_one_that_feeds_back_the_state_from_all() -> None:
    import torch

    ppo = example("ppo")
    agent = ppo.Agent(6, 1)
    assert ppo.successes(agent, "dpend/Balance-v0", 20, seed=3) == 0
    rig = dpend.rig("gustafsson2016")
    agent.mean = torch.nn.Linear(6, 1, bias=False)
    agent.mean.weight.data = -ppo.tensor(LQR(rig).K / rig.force_limit)
    assert ppo.successes(agent, "dpend/Balance-v0", 20, seed=3) == 20


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(3))
@both
def test_within_300_000_steps_ppo_balances_from_at_least_95_percent_of_starts(name: str, seed: int) -> None:
    module = example(name)
    agent = module.train(module.Options(seed=seed))
    starts = ["dpend/Balance-v0", 200] if name == "ppo" else [200]
    assert module.successes(agent, *starts, seed=seed + 2) >= 190
