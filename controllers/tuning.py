r"""Linear laws tuned for success: a gain, or its sign, by an evolution strategy; weights of LQR from a grid.

LQR minimises a quadratic cost and knows nothing of the force's limit, while comparisons count the starts that are
saved.  These laws are chosen by that count, in simulation: the linear baseline for all that learned from it.
``python -m controllers.tuning`` makes those that come with the package.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from rich.console import Console

from dpend import archive
from dpend.arguments import checked_array, checked_flag, checked_mapping, checked_name, checked_seed, checked_whole
from dpend.controller import Act
from dpend.params import Array
from dpend.provenance import versions
from dpend.rig import Rig, single_rig
from dpend.simulate import simulate_many
from dpend.tasks import Balance

from .data import FOLDER
from .lqr import LQR, BangBang, LinearLaw

Spread = float | Sequence[float]  # greatest starting angles, rad

GRID: Mapping[str, tuple[float, ...]] = MappingProxyType({
    "pos": (10.0, 100.0, 1000.0), "th1": (0.0, 1.0, 10.0), "th2": (0.0, 1.0, 10.0), "vel": (0.0, 0.1, 1.0),
    "om1": (100.0, 1000.0, 10_000.0), "om2": (0.0, 0.1, 1.0), "R": (1.0,),
})  # fmt: skip
"""Weights that :func:`tuned_weights` tries, each with each: the diagonal of Q, by state, and R; only ratios matter."""

_NAMES = {"gain": "tuned linear", "sign": "sign of tuned linear", "weights": "LQR, best weights"}
_PLANT = ("params", "sample_time", "substeps", "force_limit", "track_limit")  # what a law is tuned for
_PRESET = "gustafsson2016"  # what laws come with
_FORMAT = "dpend tuned law 1"
_STREAM = 3571  # sets these starts apart from those of every comparison, whatever the seed
_POPULATION, _SIZE = 16, 0.3  # candidates a generation; first standard deviation, in units of LQR's own gain
_LASTING = 0.1  # weight of how long runs last beside success, which alone has plateaus


class TuningCost(NamedTuple):
    """What it took to tune a law.

    Attributes
    ----------
    evaluations : int
        Laws tried.
    runs : int
        Episodes simulated.
    experience : float
        Time that the simulated plant ran, s.
    cpu_seconds : float
        Processor time of the process.
    """

    evaluations: int
    runs: int
    experience: float
    cpu_seconds: float


@dataclass(frozen=True, kw_only=True, eq=False)
class TunedLaw:
    """A linear law chosen by the starts that it saves, and what the choice cost; a controller like any other.

    ``K`` is its gain, whichever kind it is.

    Parameters
    ----------
    rig : Rig
        What it was tuned for.
    law : {"gain", "sign", "weights"}
        A gain, its sign at full force, or LQR.
    numbers : ndarray (6,) or (7,)
        :math:`K`; of LQR the diagonal of :math:`Q`, then :math:`R`.
    saved : float
        Share of the starts it was tuned on that it saves; of fresh ones it saves a little less.
    cost : TuningCost
        Evaluations, runs, simulated and processor time.
    about : mapping
        The settings, as JSON can hold them.

    See Also
    --------
    controllers.tuned_law : One that is shipped.

    Examples
    --------
    >>> import dpend
    >>> from controllers import tuned_law
    >>> rig = dpend.rig("gustafsson2016")
    >>> dpend.simulate(rig, tuned_law(rig, "gain"), [0, 0.1, -0.1, 0, 0, 0], duration=2.0).success
    True
    """

    rig: Rig
    law: str
    numbers: Array
    saved: float
    cost: TuningCost
    about: Mapping[str, Any]

    def __repr__(self) -> str:
        return f"<{self.name}, K = {np.array2string(self.K[0], precision=4, separator=', ')}>"

    @property
    def name(self) -> str:
        """What it is called in tables."""
        return _NAMES[self.law]

    @cached_property
    def controller(self) -> LinearLaw | BangBang:
        """The law itself."""
        return _law(self.rig, self.law, self.numbers)

    @property
    def K(self) -> Array:
        """Gain ``(1, 6)``; of the sign of a law only its direction counts."""
        return self.controller.K if isinstance(self.controller, LinearLaw) else np.reshape(self.numbers, (1, 6))

    def start(self, n: int, rng: np.random.Generator) -> Act:
        """Return the law for ``n`` runs."""
        return self.controller.start(n, rng)

    def save(self, path: str | Path) -> Path:
        """Write an archive of plain arrays with a checksum, and return its path; nothing in it can run code.

        Settings and cost are kept with it.

        Parameters
        ----------
        path : str or Path
            Where to; ``.npz`` is added where it has no suffix.

        Returns
        -------
        Path
            Where it is.

        See Also
        --------
        controllers.tuned_law : Read those that are shipped.

        Examples
        --------
        >>> import tempfile
        >>> from controllers import tuned_law
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     print(tuned_law("gustafsson2016", "gain").save(f"{folder}/mine").name)
        mine.npz
        """
        header = {"rig": self.rig.to_dict(), "law": self.law, "saved": self.saved, "cost": self.cost._asdict()}
        return archive.write(path, _FORMAT, header | {"about": dict(self.about)}, {"numbers": self.numbers})

    @classmethod
    def load(cls, path: str | Path) -> TunedLaw:
        """Read what :meth:`save` wrote; an OSError or ValueError says what is wrong with the file."""
        with archive.opened(path, _FORMAT) as (header, arrays):
            rig, cost = Rig.from_dict(header.pop("rig")), TuningCost(**header.pop("cost"))
            return cls(rig=rig, cost=cost, numbers=arrays["numbers"], **header)


def tuned_gain(
    rig: Rig | str, *, bang_bang: bool = False, begin: npt.ArrayLike | None = None,
    lam: Spread = (0.3, 0.4, 0.5, 0.6), starts: int = 100, evaluations: int = 1344, seed: int = 0,
) -> TunedLaw:  # fmt: skip
    r"""Return the law :math:`u = -Kx`, saturated by the rig, that saves most starts, by CMA-ES over :math:`K`.

    Every candidate is tried on the same starts, and scored by the share of them that it saves plus a tenth of the mean
    share of the episode that its runs last, without which the search stops on plateaus.  It ends with the mean of the
    last generation.

    Parameters
    ----------
    rig : Rig or str
        The plant, or a preset's name.
    bang_bang : bool
        Tune :math:`u = -F\,\mathrm{sgn}(Kx)` instead, with the rig's force limit :math:`F`.
    begin : array_like (6,) or (1, 6), optional
        The gain at which the search begins, and whose entries are its units; left out, that of LQR.
    lam : float or sequence of float
        :math:`\lambda` of ``dpend.Balance``, rad, or several, which count alike.
    starts : int
        Starts at each.
    evaluations : int
        Laws to try, in whole generations of 16.
    seed : int
        Of starts and candidates.  The starts are from a stream of their own, apart from those of every comparison.

    Returns
    -------
    TunedLaw
        The law, its gain and what finding it cost.

    Raises
    ------
    ValueError
        If a number is out of its range, or the sign is asked for on a rig without a limit of the force.

    See Also
    --------
    controllers.tuned_law : Those that are shipped.

    Notes
    -----
    Source: N. Hansen, *The CMA evolution strategy: a tutorial*, 2016, in his package ``cma``.

    Examples
    --------
    >>> import dpend
    >>> from controllers import tuned_gain
    >>> rig = dpend.rig("gustafsson2016")
    >>> tuned_gain(rig, lam=0.3, starts=50, evaluations=320, seed=1)  # doctest: +SKIP
    """
    import cma  # which imports matplotlib

    rig, law = single_rig(rig, "tuned_gain"), "sign" if checked_flag("bang_bang", bang_bang) else "gain"
    generations = checked_whole("evaluations", evaluations, _POPULATION) // _POPULATION
    trials, unit = _Trials(rig, law, lam, starts, seed), (LQR(rig) if begin is None else LinearLaw(begin)).K[0]
    trials.score(unit)  # so that what cannot be tried is refused before the search
    rng = np.random.default_rng([seed, _STREAM, 1])
    options = {"popsize": _POPULATION, "seed": np.nan, "randn": lambda *shape: rng.standard_normal(shape),
               "verbose": -9}  # fmt: skip
    search: Any = cma.CMAEvolutionStrategy(np.ones(6), _SIZE, options)
    for _ in range(generations):
        candidates = search.ask()
        search.tell(candidates, [-trials.score(unit * candidate) for candidate in candidates])
    return trials.result(unit * search.mean, {"evaluations": evaluations, "begin": unit.tolist()})


def tuned_weights(
    rig: Rig | str, *, grid: Mapping[str, Sequence[float]] = GRID, lam: Spread = (0.3, 0.4, 0.5, 0.6), starts: int = 25,
    seed: int = 0,
) -> TunedLaw:  # fmt: skip
    r"""Return LQR with the weights of a grid that save most starts.

    Every combination is tried on the same starts, then the best twentieth on ten times as many, and scored as
    :func:`tuned_gain` does.

    Parameters
    ----------
    rig : Rig or str
        The plant, or a preset's name.
    grid : mapping of str to sequence of float
        Weights to try, by names of the states and ``"R"``.
    lam : float or sequence of float
        :math:`\lambda` of ``dpend.Balance``, rad, or several, which count alike.
    starts : int
        Starts at each.
    seed : int
        Of the starts.

    Returns
    -------
    TunedLaw
        The regulator, its weights and what finding them cost.

    Raises
    ------
    ValueError
        If a number is out of its range, or the grid lacks a state, or R.

    See Also
    --------
    controllers.tuned_law : Those that are shipped.

    Examples
    --------
    >>> import dpend
    >>> from controllers import tuned_weights
    >>> rig = dpend.rig("gustafsson2016")
    >>> tuned_weights(rig, starts=20)  # doctest: +SKIP
    """
    rig = single_rig(rig, "tuned_weights")
    levels = checked_mapping("grid", grid, "a mapping of each weight to the levels it takes")
    if set(levels) != set(GRID):
        raise ValueError(f"grid has weights for {', '.join(GRID)}; got {', '.join(map(str, levels)) or 'none'}.")
    axes = [checked_array(f"grid[{name!r}]", levels[name], "a list of weights").ravel() for name in GRID]
    every = np.array(list(itertools.product(*axes)))
    trials, few = _Trials(rig, "weights", lam, starts, seed), -(-len(every) // 20)
    scores = [trials.score(weights) for weights in every]
    trials.draw(10 * starts)
    best = max(every[np.argsort(scores)[::-1][:few]], key=trials.score)
    return trials.result(best, {"grid": {name: each.tolist() for name, each in zip(GRID, axes, strict=True)}})


def tuned_law(rig: Rig | str, law: str) -> TunedLaw:
    """Return the best law of a kind for a rig: the one that comes with the package, or where none does, one tuned now.

    Tuning takes about a minute.

    Parameters
    ----------
    rig : Rig or str
        The plant, its clock and its limits; what its actuator and sensors do besides does not matter.
    law : {"gain", "sign", "weights"}
        What :func:`tuned_gain` returns by default; what it does with ``bang_bang=True``, begun there; or what
        :func:`tuned_weights` does.

    Returns
    -------
    TunedLaw
        The law, its gain and what finding it cost.

    See Also
    --------
    controllers.tuned_gain : Tune one.
    controllers.LQR : Designed for a quadratic cost.

    Examples
    --------
    >>> import dpend
    >>> from controllers import tuned_law
    >>> rig = dpend.rig("gustafsson2016")
    >>> tuned_law(rig, "gain").K.shape
    (1, 6)
    """
    rig = single_rig(rig, "tuned_law")
    checked_name("law", law, _NAMES)
    for path in sorted(FOLDER.glob(f"*_tuned_{law}.npz")):
        found = TunedLaw.load(path)
        if all(getattr(found.rig, name) == getattr(rig, name) for name in _PLANT):
            return found
    return _tune(rig, law)


def _tune(rig: Rig | str, law: str) -> TunedLaw:
    if law == "sign":
        return tuned_gain(rig, bang_bang=True, begin=tuned_law(rig, "gain").K)
    return tuned_gain(rig) if law == "gain" else tuned_weights(rig)


def _law(rig: Rig, law: str, numbers: Array) -> LinearLaw | BangBang:
    if law == "weights":
        return LQR(rig, Q=numbers[:6], R=float(numbers[6]))
    return LinearLaw(numbers) if law == "gain" else BangBang(LinearLaw(numbers), float(rig.force_limit))


class _Trials:
    """Trials of one kind of law on the same starts, and what they have cost so far."""

    def __init__(self, rig: Rig, law: str, lam: Spread, starts: int, seed: int) -> None:
        self.rig, self.law, self.seed = rig, law, checked_seed("seed", seed)
        angles = np.atleast_1d(checked_array("lam", lam, "one or several greatest starting angles"))
        self.tasks = [Balance(lam=each) for each in angles.tolist()]
        if not self.tasks:
            raise ValueError("lam needs at least one angle.")
        self.about = {"lam": [task.lam for task in self.tasks], "starts": starts, "seed": seed}
        self.began, self.evaluations, self.runs, self.steps = time.process_time(), 0, 0, 0
        self.draw(starts)

    def draw(self, starts: int) -> None:
        """Draw the starts of the following trials."""
        n, rng = checked_whole("starts", starts), np.random.default_rng([self.seed, _STREAM])
        self.x0 = np.concatenate([task.starts(rng, n, self.rig) for task in self.tasks])

    def tried(self, numbers: Array) -> tuple[float, float]:
        """Return the share of the starts that a law saves, and the mean share of the episode that its runs last."""
        runs = simulate_many(self.rig, _law(self.rig, self.law, numbers), self.x0, task=self.tasks[0], seed=self.seed)
        self.evaluations += 1
        self.runs += len(runs)
        self.steps += int(runs.steps.sum())
        return float(runs.success.mean()), float(runs.steps.mean() / self.tasks[0].steps)

    def score(self, numbers: Array) -> float:
        """Return what is to be great."""
        saved, lasted = self.tried(numbers)
        return saved + _LASTING * lasted

    def result(self, numbers: Array, about: Mapping[str, Any]) -> TunedLaw:
        """Return the chosen law."""
        saved, _ = self.tried(numbers)
        spent = self.steps * float(self.rig.sample_time), time.process_time() - self.began
        return TunedLaw(rig=self.rig, law=self.law, numbers=np.array(numbers), saved=saved,
                        cost=TuningCost(self.evaluations, self.runs, *spent),
                        about=self.about | dict(about) | {"versions": versions()})  # fmt: skip


def main() -> None:
    """Tune laws for the report's plant and write them."""
    parser = argparse.ArgumentParser(prog="python -m controllers.tuning", description=__doc__)
    parser.add_argument("laws", nargs="*", help="gain, sign or weights; left out, all three")
    parser.add_argument("--out", type=Path, default=FOLDER, help="folder to write to")
    options, console = parser.parse_args(), Console()
    for law in options.laws or _NAMES:
        found = _tune(_PRESET, checked_name("a law", law, _NAMES))
        file = found.save(options.out / f"{_PRESET}_tuned_{law}.npz")
        console.print(f"{file.name}: {found!r} saves {found.saved:.1%}; {found.cost}", soft_wrap=True)


if __name__ == "__main__":
    main()
