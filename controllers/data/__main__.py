"""Make the trajectories that come with the package: ``python -m controllers.data``, or with words, those named so.

``python -m controllers.data side`` makes those with "side" in their file's name; ``--out FOLDER`` writes elsewhere.
Each is the cheapest of many seeded guesses.  Where there is no C compiler IPOPT takes fatrop's place and may end in
other local minima.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console

import dpend

from ..trajectory import Trajectory
from ..trajopt import NoTrajectory, Objective, optimize
from . import FOLDER, file_name


class Recipe(NamedTuple):
    """What :func:`~controllers.trajopt.optimize` is asked for.

    Attributes
    ----------
    rig, start, target, objective : str
        The problem.
    options : dict
        Its other arguments.
    guess : str or None
        File of the trajectory from which guesses are made, one that is made before.
    backwards : bool
        Whether that is played backwards: without friction the way back is a way too.
    easing : tuple of float
        Multiples of the force limit with which the problem is solved before, each the guess of the next.
    """

    rig: str
    start: str
    target: str
    objective: Objective
    options: dict[str, Any]
    guess: str | None = None
    backwards: bool = False
    easing: tuple[float, ...] = ()

    @property
    def file(self) -> str:
        """The file's name."""
        return file_name(self.rig, self.start, self.target, self.objective)


def played_backwards(trajectory: Trajectory) -> Trajectory:
    """Return the motion from the target back to the start, were there no friction: rates change their signs."""
    x = trajectory.x[::-1] * np.array([1.0, 1.0, 1.0, -1.0, -1.0, -1.0])
    return replace(trajectory, x=x, u=trajectory.u[::-1], target=trajectory.x[0])


_MANY: dict[str, Any] = {"starts": 8, "seed": 0, "solver": "auto"}
_ONE: dict[str, Any] = {"starts": 1, "seed": 0, "solver": "ipopt"}
_MORE: dict[str, Any] = _MANY | {"starts": 32}  # where few guesses converge
# Fatrop converges in minimum time from few guesses, IPOPT from most.
_FROM_EFFORT: dict[str, Any] = {"duration": 2.0, "starts": 4, "seed": 0, "solver": "ipopt"}
_REPORT = "gustafsson2016"


def _transfer(start: str, target: str, *, back: bool = False, options: dict[str, Any] = _MANY) -> Recipe:
    guess = file_name(_REPORT, target, start, "effort") if back else None
    return Recipe(_REPORT, start, target, "effort", {"duration": 2.5} | options, guess, back)


RECIPES = (
    Recipe(_REPORT, "hanging", "up-up", "effort", {"duration": 2.5} | _MANY),
    Recipe(_REPORT, "side", "up-up", "effort", {"duration": 2.5} | _MANY),
    Recipe(_REPORT, "hanging", "up-up", "time", _FROM_EFFORT, f"{_REPORT}_hanging_up-up_effort.npz"),
    Recipe(_REPORT, "side", "up-up", "time", _FROM_EFFORT, f"{_REPORT}_side_up-up_effort.npz"),
    _transfer("up-up", "down-down", back=True),
    _transfer("up-up", "up-down"),
    _transfer("up-down", "up-up", back=True),
    _transfer("up-up", "down-up"),
    _transfer("down-up", "up-up", back=True),
    _transfer("up-down", "down-up"),
    _transfer("down-up", "up-down", back=True),
    _transfer("up-down", "down-down", options=_MORE),
    _transfer("down-down", "up-down", back=True),
    _transfer("down-up", "down-down"),
    _transfer("down-down", "down-up", back=True),
    Recipe("gustafsson2016_as_coded", "hanging", "up-up", "effort", {"duration": 2.5} | _MANY),
    Recipe("bogdanov2004", "hanging", "up-up", "effort", {"duration": 2.0} | _MANY),
    Recipe("pilco2011", "hanging", "up-up", "effort", {"duration": 2.0} | _MORE),
    Recipe("dompc_dip", "hanging", "up-up", "effort", {"duration": 4.0, "starts": 4, "seed": 0, "solver": "ipopt"}),
    Recipe("gymnasium_idp", "hanging", "up-up", "effort", {"duration": 2.5} | _MANY),
    Recipe("dm_control_two_poles", "hanging", "up-up", "effort", _ONE | {"duration": 4.5}, easing=(2.0, 1.4)),
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
        guess = None if recipe.guess is None else Trajectory.load(options.out / recipe.guess)
        if guess is not None and recipe.backwards:
            guess = played_backwards(guess)
        rig = dpend.rig(recipe.rig)
        try:
            for factor in recipe.easing:
                eased = rig.replace(force_limit=factor * rig.force_limit)
                guess = optimize(eased, recipe.start, recipe.target, duration=recipe.options["duration"], guess=guess)
            found = optimize(
                rig, recipe.start, recipe.target, objective=recipe.objective, guess=guess, **recipe.options
            )
        except NoTrajectory as error:
            console.print(f"{recipe.file}: {error}", soft_wrap=True)
            continue
        about = dict(found.about) | {"preset": recipe.rig}
        if recipe.guess is not None:
            about["guess"] = recipe.guess + (", backwards" if recipe.backwards else "")
        if recipe.easing:
            about["guess"] = f"solutions with the force limit times {', '.join(map(str, recipe.easing))}"
        found = replace(found, about=about)
        found.save(options.out / recipe.file)
        console.print(
            f"{recipe.file}: {found.duration:.4f} s, cost {found.about['cost']:.4f}, peak {abs(found.u).max():.1f} N, "
            f"track {abs(found.x[:, 0]).max():.2f} m, {found.about['converged']} of {found.about['tried']} converged",
            soft_wrap=True,
        )


if __name__ == "__main__":
    main()
