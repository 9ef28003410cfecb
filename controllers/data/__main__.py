"""Make the trajectories that come with the package: ``python -m controllers.data``, or with words, those named so.

``python -m controllers.data side`` makes those with "side" in their file's name; ``--out FOLDER`` writes elsewhere.
Each is the cheapest of many seeded guesses.  Where there is no C compiler IPOPT takes fatrop's place and may end in
other local minima.
"""

from __future__ import annotations

import argparse
import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console

import dpend

from ..trajectory import Trajectory
from ..trajopt import Objective, optimize
from . import FOLDER, file_name


class Recipe(NamedTuple):
    """What :func:`~controllers.trajopt.optimize` is asked for.

    Attributes
    ----------
    rig, start, target, objective : str
        The problem.
    options : dict
        The rest of its arguments.
    after : str or None
        Objective whose solution of the same problem is the guess, if one is.
    """

    rig: str
    start: str
    target: str
    objective: Objective
    options: dict[str, Any]
    after: Objective | None = None

    @property
    def file(self) -> str:
        """The file's name."""
        return file_name(self.rig, self.start, self.target, self.objective)


_MANY: dict[str, Any] = {"starts": 8, "seed": 0, "solver": "auto"}
# Fatrop converges in minimum time from few guesses, IPOPT from most.
_FROM_EFFORT: dict[str, Any] = {"duration": 2.0, "starts": 4, "seed": 0, "solver": "ipopt"}
_REPORT = "gustafsson2016"

RECIPES = (
    Recipe(_REPORT, "hanging", "up-up", "effort", {"duration": 2.5} | _MANY),
    Recipe(_REPORT, "side", "up-up", "effort", {"duration": 2.5} | _MANY),
    Recipe(_REPORT, "hanging", "up-up", "time", _FROM_EFFORT, after="effort"),
    Recipe(_REPORT, "side", "up-up", "time", _FROM_EFFORT, after="effort"),
    *(
        Recipe(_REPORT, start, target, "effort", {"duration": 2.5} | _MANY)
        for start, target in itertools.permutations(dpend.EQUILIBRIA, 2)
        if (start, target) != ("down-down", "up-up")  # that is from hanging, above
    ),
    Recipe("gustafsson2016_as_coded", "hanging", "up-up", "effort", {"duration": 2.5} | _MANY),
    Recipe("bogdanov2004", "hanging", "up-up", "effort", {"duration": 2.0} | _MANY),
    Recipe("pilco2011", "hanging", "up-up", "effort", {"duration": 2.0} | _MANY),
    Recipe("dompc_dip", "hanging", "up-up", "effort", {"duration": 3.0} | _MANY),
    Recipe("gymnasium_idp", "hanging", "up-up", "effort", {"duration": 2.5} | _MANY),
    Recipe("dm_control_two_poles", "hanging", "up-up", "effort", {"duration": 3.0} | _MANY),
)


def main() -> None:
    """Make and write them."""
    parser = argparse.ArgumentParser(prog="python -m controllers.data", description=__doc__)
    parser.add_argument("words", nargs="*", help="make only what has one of these in its file's name")
    parser.add_argument("--out", type=Path, default=FOLDER, help="folder to write to")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    console = Console()
    for recipe in RECIPES:
        if options.words and not any(word in recipe.file for word in options.words):
            continue
        guess = None
        if recipe.after is not None:
            guess = Trajectory.load(options.out / recipe._replace(objective=recipe.after).file)
        found = optimize(
            recipe.rig, recipe.start, recipe.target, objective=recipe.objective, guess=guess, **recipe.options
        )
        about = dict(found.about) | {"preset": recipe.rig}
        if recipe.after is not None:
            about["guess"] = recipe._replace(objective=recipe.after).file
        found = replace(found, about=about)
        found.save(options.out / recipe.file)
        console.print(
            f"{recipe.file}: {found.duration:.4f} s, cost {found.about['cost']:.4f}, peak {abs(found.u).max():.1f} N, "
            f"track {abs(found.x[:, 0]).max():.2f} m, {found.about['converged']} of {found.about['tried']} converged",
            soft_wrap=True,
        )


if __name__ == "__main__":
    main()
