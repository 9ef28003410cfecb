"""Train a linear learner from the command line: ``python -m rl.linear --algo lspi --out lspi.npz``.

The policies that are shipped as ``lspi``, ``qac_tuned`` and ``q_tuned`` were made so, with the default seed.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro
from rich.console import Console

import dpend
from dpend.rig import Rig

from .gaussian_qac import GaussianQAC, TableOneMean
from .linear_q import LinearQLearning
from .lspi import LSPI
from .policies import GainPolicy, LinearQPolicy

Algorithm = Literal["lspi", "qac_tuned", "q_tuned"]


@dataclass(frozen=True, kw_only=True)
class Options:
    """What can be told on the command line."""

    algo: Algorithm = "lspi"
    """The learner, in its tuned form."""
    rig: str = "gustafsson2016"
    """The preset."""
    seed: int = 0
    """What all randomness is drawn from."""
    out: Path | None = None
    """The file; left out, the algorithm's name in this folder."""

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise ValueError(f"--seed must be at least 0; got {self.seed}.")


def train_linear(algo: Algorithm, rig: Rig, seed: int) -> GainPolicy | LinearQPolicy:
    """Train a linear learner with its tuned settings, and give its policy with where it comes from.

    Parameters
    ----------
    algo : {"lspi", "qac_tuned", "q_tuned"}
        :class:`LSPI`, :meth:`GaussianQAC.tuned` or :meth:`LinearQLearning.tuned`.
    rig : Rig
        The rig.
    seed : int
        What all randomness is drawn from.

    Returns
    -------
    GainPolicy or LinearQPolicy
        Its ``about`` names learner, settings, seed and versions.
    """
    learners = {"lspi": LSPI, "qac_tuned": GaussianQAC.tuned, "q_tuned": LinearQLearning.tuned}
    if algo not in learners:
        raise ValueError(f"algo must be one of {', '.join(map(repr, learners))}; got {algo!r}.")
    policy = learners[algo](rig).train(seed).policy
    assert not isinstance(policy, TableOneMean)  # only the published learner ends so
    return policy


def main(arguments: Sequence[str] | None = None) -> Path:
    """Train from a command line, and save the policy.

    Parameters
    ----------
    arguments : sequence of str, optional
        The command line; left out, the program's own.

    Returns
    -------
    Path
        The file.
    """
    console = Console(stderr=True, highlight=False)
    options = tyro.cli(Options, args=arguments, description=__doc__, prog="python -m rl.linear")
    try:
        rig = dpend.rig(options.rig)
        policy = train_linear(options.algo, rig, options.seed)
    except (TypeError, ValueError) as error:
        console.print(f"[bold red]Error:[/] {error}", soft_wrap=True)
        raise SystemExit(2) from None
    policy.about["command"] = f"python -m rl.linear --algo {options.algo} --rig {options.rig} --seed {options.seed}"
    path = policy.save(options.out or Path(f"{options.algo}.npz"))
    console.print(f"{policy!r} is in {path}.", soft_wrap=True)
    return path


if __name__ == "__main__":
    main(sys.argv[1:])
