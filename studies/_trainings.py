"""Deep trainings on disk, as the jobs of studies name them."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from rl import Training
from rl.deep import kept_trainings, read_trainings

from ._closure import combined, file_hash

RUNS = Path("docs/results/deep")
"""Where deep trainings are kept, seen from the repository; see :func:`rl.deep.kept_trainings`."""


class Kept(NamedTuple):
    """A training on disk."""

    place: str  # The file or folder of its recipe.
    seed: int
    content: str  # A hash of what is there.

    def read(self) -> Training:
        """Return the training."""
        return read_trainings(self.place)[self.seed]


def kept(runs: Path) -> dict[str, list[Kept]]:
    """Return the trainings in a folder by recipe, each by seed; see :func:`rl.deep.kept_trainings`."""
    found = {}
    for name, place in kept_trainings(runs).items():
        files = [place] if place.is_file() else sorted(place.glob("seed-*/[pcr]*.[ncj]*"))
        content = combined({str(file.relative_to(runs)): file_hash(file) for file in files})
        found[name] = [Kept(str(place), seed, content) for seed in read_trainings(place)]
    return found
