"""Who takes part in the comparisons: every controller and learner, what it was told, and controllers of your own."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from itertools import cycle
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar, Literal, NamedTuple

import dpend
from controllers import (
    ILQRMPC,
    LQR,
    NMPC,
    SDRE,
    TVLQR,
    BangBang,
    EnergyPump,
    EnergySwingUp,
    SwitchingController,
    shipped,
)
from dpend import Balance, Controller, Rig, SwingUp
from dpend.controller import check_controller, is_batched
from dpend.provenance import fingerprint
from dpend.suggest import suggestion
from rl import LSPI, GaussianQAC, LinearQLearning, load_policy

from . import _study

Task = Literal["balance", "swing-up"]

Style = tuple[str, str, object]
"""Colour, marker and line style of a curve."""

RIG = dpend.rig("gustafsson2016")
"""The plant of the comparisons, as all of them believe it to be."""


class Told(NamedTuple):
    """What somebody knew before it began, which comparisons of success leave out."""

    model: str
    """Whether it was given the equations and their parameters."""
    reward: str
    """What it was to make large or small."""
    starts: str
    """Where it could begin while it learned."""
    state: str = "all of it, exact"
    """What it sees when it acts."""


_DESIGNED = Told("equations and parameters", "quadratic cost", "-")
_ENERGY = Told("equations and parameters", "energy, then quadratic cost", "-")
YOURS = Told("yours to say", "yours to say", "yours to say")
"""What nobody but its author knows of a user's own controller."""
_SHAPED = Told("none", "shaped: height, calm, upright", "anywhere, near upright too")


@dataclass(frozen=True, kw_only=True, eq=False)
class Entrant:
    """One who takes part.

    Attributes
    ----------
    name : str
        How tables call it.
    make : callable
        Returns the controller for what is believed of the rig, and for a task.
    tasks : tuple of str
        What it can do at all: "balance", "swing-up".
    told : Told
        What it knew.
    style : Style
        That of its curves.
    part : float
        Share of the runs that it meets, the first of all, because each takes long.
    learner : callable, optional
        Returns a learner that is trained in seconds, so that a study may train it anew.
    policy : str
        Name of the policy that is shipped, of a learner.
    trainings : str
        Name under which the trainings of one that takes minutes are kept in ``docs/results/deep``.
    source : str
        Of a user's own controller: where it is, and a fingerprint of the file.
    """

    name: str
    make: Callable[[Rig, Balance | SwingUp], Controller]
    tasks: tuple[Task, ...] = ("balance",)
    told: Told = _DESIGNED
    style: Style = ("#7F3C8D", "h", "-")
    part: float = 1.0
    learner: Callable[[Rig], LinearQLearning | GaussianQAC | LSPI] | None = None
    policy: str = ""
    trainings: str = ""
    source: str = ""

    def runs(self, n: int) -> int:
        """Return how many of ``n`` runs it meets; at least twenty, if there are so many."""
        return min(n, max(round(self.part * n), 20))


def _learned(name: str) -> Callable[[Rig, Balance | SwingUp], Controller]:
    def make(rig: Rig, task: Balance | SwingUp) -> Controller:
        policy = load_policy(name)
        assert isinstance(policy, Controller)
        return policy

    return make


def _stiff(rig: Rig) -> LQR:
    return LQR(rig, Q=(1, 10, 10, 1, 1, 1), R=0.1)


def _planner(rig: Rig, task: Balance | SwingUp) -> Controller:
    return ILQRMPC(rig, upright_only=True) if isinstance(task, Balance) else ILQRMPC(rig, target=task.target)


def _nonlinear(rig: Rig, task: Balance | SwingUp) -> Controller:
    return NMPC(rig) if isinstance(task, Balance) else NMPC(rig, target=task.target)


def _follower(rig: Rig, task: Balance | SwingUp) -> Controller:
    """Follow the trajectory that comes with the package, or one of its own."""
    assert isinstance(task, SwingUp)
    start = "hanging" if task.start == "down-down" else task.start
    return TVLQR(rig, shipped(rig, start, task.target))


def _planned_last_swing(rig: Rig, task: Balance | SwingUp) -> Controller:
    """Pump energy, plan the last swing with little ahead in view, and balance."""
    return SwitchingController(
        rig, SwitchingController(rig, EnergyPump(rig), ILQRMPC(rig, horizon=40 * rig.sample_time, starts=4)), LQR(rig)
    )


BOTH: tuple[Task, ...] = ("balance", "swing-up")

# Okabe and Ito's colours; markers and line styles tell the curves apart without them.
ENTRANTS: tuple[Entrant, ...] = (
    Entrant(name="LQR", make=lambda rig, task: LQR(rig), style=("#0072B2", "o", "-")),
    Entrant(name="stiff LQR", make=lambda rig, task: _stiff(rig), style=("#56B4E9", "<", "--")),
    Entrant(
        name="sign of LQR",
        make=lambda rig, task: BangBang(LQR(rig), float(rig.force_limit)),
        style=("#E69F00", "s", "--"),
    ),
    Entrant(
        name="sign of stiff LQR",
        make=lambda rig, task: BangBang(_stiff(rig), float(rig.force_limit)),
        style=("#D55E00", "^", "--"),
    ),
    Entrant(name="SDRE", make=lambda rig, task: SDRE(rig), style=("#009E73", ">", "-."), part=0.2),
    Entrant(name="iLQR MPC", make=_planner, tasks=BOTH, style=("#000000", "X", "-"), part=0.2),
    Entrant(name="NMPC", make=_nonlinear, tasks=BOTH, style=("#777777", "P", "-"), part=0.05),
    Entrant(
        name="TVLQR",
        make=_follower,
        tasks=("swing-up",),
        told=Told("equations and parameters", "effort of a trajectory, then quadratic cost", "-"),
        style=("#009E73", "^", "-"),
    ),
    Entrant(
        name="passivity, LQR",
        make=lambda rig, task: SwitchingController(rig, EnergySwingUp(rig)),
        tasks=("swing-up",),
        told=_ENERGY,
        style=("#8C6D1F", "v", ":"),
        part=0.2,
    ),
    Entrant(
        name="pumping, LQR",
        make=lambda rig, task: SwitchingController(rig, EnergyPump(rig)),
        tasks=("swing-up",),
        told=_ENERGY,
        style=("#E69F00", "v", "-."),
        part=0.2,
    ),
    Entrant(
        name="pumping, iLQR, LQR",
        make=_planned_last_swing,
        tasks=("swing-up",),
        told=_ENERGY,
        style=("#D55E00", "s", "--"),
        part=0.2,
    ),
    Entrant(
        name="Q tuned",
        make=_learned("q-tuned"),
        told=Told("none", "report's cost, weights tuned", "λ = .08 about upright, tests to .3"),
        style=("#009E73", "D", "-."),
        learner=lambda rig: LinearQLearning.tuned(rig),
        policy="q-tuned",
    ),
    Entrant(
        name="QAC tuned",
        make=_learned("qac-tuned"),
        told=Told("none", "quadratic cost, angles dear at first", "λ = .1 about upright"),
        style=("#CC79A7", "*", (0, (6, 1, 1, 1))),
        learner=lambda rig: GaussianQAC.tuned(rig),
        policy="qac-tuned",
    ),
    Entrant(
        name="LSPI",
        make=_learned("lspi"),
        told=Told("none", "quadratic cost", "λ = .02 about upright"),
        style=("#56B4E9", "p", "-"),
        learner=lambda rig: LSPI(rig),
        policy="lspi",
    ),
    Entrant(
        name="PPO balance",
        make=_learned("ppo-balance"),
        told=Told("none", "shaped: height, calm, upright", "λ = .4 about upright"),
        style=("#0072B2", "d", ":"),
        policy="ppo-balance", trainings="ppo-balance",
    ),
    Entrant(
        name="DDPG balance",
        make=_learned("ddpg-balance"),
        told=Told("none", "shaped: height, calm, upright", "λ = .4 about upright"),
        style=("#E69F00", "d", ":"),
        policy="ddpg-balance", trainings="ddpg-balance",
    ),
    Entrant(
        name="PPO swing-up", make=_learned("ppo-swing-up"), tasks=BOTH, told=_SHAPED,
        style=("#CC79A7", "o", "-"), policy="ppo-swing-up", trainings="ppo-swing-up",
    ),
    Entrant(
        name="PPO swing-up, smooth", make=_learned("ppo-swing-up-smooth"), tasks=BOTH,
        told=Told("none", "shaped, and changes of force", "anywhere, near upright too"),
        style=("#CC79A7", ">", "--"), policy="ppo-swing-up-smooth", trainings="ppo-swing-up-smooth",
    ),
    Entrant(
        name="DDPG swing-up", make=_learned("ddpg-swing-up"), tasks=BOTH, told=_SHAPED,
        style=("#D55E00", "D", ":"), policy="ddpg-swing-up", trainings="ddpg-swing-up",
    ),
)  # fmt: skip
"""All that come with the package, as designed with their defaults or as shipped."""


_OWN: tuple[Style, ...] = (
    ("#7F3C8D", "h", "-"), ("#7F3C8D", "8", "--"), ("#B33951", "h", "-."), ("#B33951", "8", ":"),
)  # fmt: skip


def styles(names: Iterable[str], known: Iterable[Entrant] = ENTRANTS) -> dict[str, Style]:
    """Return colour, marker and line style of each who takes part, in the order of those known; users' own come last.

    Parameters
    ----------
    names : iterable of str
        Those in a table, in any order.
    known : iterable of Entrant
        Those that have a style; the others get one in turn.

    Returns
    -------
    dict
    """
    own_styles = cycle(_OWN)
    style = {entrant.name: entrant.style for entrant in known}
    present = dict.fromkeys(names)
    chosen = {name: style[name] for name in style if name in present}
    return chosen | {name: next(own_styles) for name in present if name not in style}


# --------------------------------------------------------------------------------------------- controllers of your own


@dataclass(frozen=True, kw_only=True)
class Options(_study.Options):
    """What a comparison can be told on the command line."""

    known: ClassVar[tuple[Entrant, ...]] = ENTRANTS
    """Those that can take part beside the user's own; a study that has more adds them."""

    controller: tuple[str, ...] = ()
    """Your own controllers: path.py:factory or module:factory; the factory takes the rig, or nothing."""
    only: tuple[str, ...] = ()
    """Names of those who take part beside your own; left out, all."""

    def __post_init__(self) -> None:
        super().__post_init__()
        names = [entrant.name for entrant in (*self.known, *map(own, self.controller))]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"--controller: two of those that take part are called {name!r}; rename the factory.")
        for name in self.only:
            self.entrant(name)

    def entrants(self, task: Task) -> list[Entrant]:
        """Return those that do a task and were not left out, the user's own last.

        Parameters
        ----------
        task : {"balance", "swing-up"}
            The task.

        Returns
        -------
        list of Entrant
        """
        chosen = [entrant for entrant in self.known if not self.only or entrant.name in self.only]
        return [entrant for entrant in (*chosen, *map(own, self.controller)) if task in entrant.tasks]

    def entrant(self, name: str) -> Entrant:
        """Return one by its name.

        Raises
        ------
        ValueError
            If nobody is called so.
        """
        known = {entrant.name: entrant for entrant in (*self.known, *map(own, self.controller))}
        if name not in known:
            raise ValueError(f"Nobody that can take part is called {name!r}.{suggestion(name, known)}")
        return known[name]


@cache
def own(spec: str) -> Entrant:
    """Load a user's own controller as one who takes part in balancing and swinging up.

    It is built once for ``gustafsson2016`` and acts for two samples, so that what is wrong with it shows before a study
    begins.

    Parameters
    ----------
    spec : str
        ``path.py:factory`` or ``module:factory``.  The factory is a function or class, called with the rig, or with
        nothing where it takes nothing; or a controller.

    Returns
    -------
    Entrant
        Called as the factory is.

    Raises
    ------
    ValueError
        If there is no such file or name, it raises, or what it gives is no controller.
    """
    place, _, name = spec.rpartition(":")
    if not place or not name:
        raise ValueError(f"--controller must be path.py:factory or module:factory; got {spec!r}.")
    try:
        module = _module(place)
        if not hasattr(module, name):
            raise AttributeError(f"there is no {name!r} in {place}")
        factory = getattr(module, name)
        made = _made(factory, RIG)
        check_controller(made)
        dpend.simulate(RIG, made, [0, 0.01, 0.01, 0, 0, 0], 2 * RIG.sample_time)
    except Exception as error:
        raise ValueError(f"--controller {spec}: {type(error).__name__}: {error}") from error
    return Entrant(
        name=name,
        make=lambda rig, task: _made(factory, rig),
        tasks=BOTH,
        told=YOURS,
        part=1.0 if is_batched(made) else 0.2,
        source=f"{spec} {fingerprint(Path(str(module.__file__)))}",
    )


def _module(place: str) -> ModuleType:
    """Import a file by its path, or a module by its name."""
    if not place.endswith(".py"):
        return importlib.import_module(place)
    path = Path(place).resolve()
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {place}")
    spec = importlib.util.spec_from_file_location(f"{path.stem} {fingerprint(path)}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def _made(factory: object, rig: Rig) -> Controller:
    """Call a factory with the rig, or with nothing where it takes nothing; a controller is one already."""
    if not isinstance(factory, type) and isinstance(factory, Controller):
        return factory
    if not callable(factory):
        raise TypeError(f"expected a function, a class or a controller; got {factory!r}")
    taken = inspect.signature(factory).parameters.values()
    wants_rig = any(parameter.name == "rig" or parameter.default is parameter.empty for parameter in taken)
    made: Any = factory(rig) if wants_rig else factory()
    return made
