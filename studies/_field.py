"""The field of the comparisons: every controller and learner, its prior knowledge and its cost; and users' own."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum
from functools import cache
from itertools import cycle
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
    tuned_law,
)
from controllers.data import shipped
from dpend import Balance, Controller, Rig, SwingUp
from dpend.suggest import suggestion
from rl import LSPI, GaussianQAC, Learner, LinearQLearning, ModelBased, ModelPolicy, load_policy

from . import _runner
from ._closure import covered
from ._figures import Style
from ._own import Own, load_own, tried_on
from ._plant import Plant, rig_of

TaskName = Literal["balance", "swing-up"]

RIG = dpend.rig("gustafsson2016")
"""The plant of the comparisons, as every contender believes it to be."""


class Cost(Enum):
    """How long a contender takes; the value is the share of the runs on which it is evaluated, the first of all."""

    CHEAP = 1.0
    MODERATE = 0.2
    EXPENSIVE = 0.05

    def runs(self, n: int) -> int:
        """Return on how many of ``n`` runs it is evaluated; at least twenty, if there are so many."""
        return min(n, max(round(self.value * n), 20))


class PriorKnowledge(NamedTuple):
    """What a contender knew before it began, which comparisons of success leave out."""

    model: str  # What it knew of the plant.
    reward: str  # What it was to make large or small.
    starts: str  # Where it could begin while it learned.
    state: str = "all of it, exact"  # What it sees when it acts.


_DESIGNED = PriorKnowledge("equations and parameters", "quadratic cost", "-")
_TUNED = PriorKnowledge("equations and parameters", "starts saved, counted in simulation", "λ = .3 to .6 about upright")
_ENERGY = PriorKnowledge("equations and parameters", "energy, then quadratic cost", "-")
_SHAPED = PriorKnowledge("none", "shaped: height, low rates, upright", "anywhere, near upright too")
_NEAR = _SHAPED._replace(starts="λ = .4 about upright")
YOURS = PriorKnowledge("yours to say", "yours to say", "yours to say")
"""What only its author knows of a user's own controller."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Contender:
    """One that takes part."""

    name: str
    make: Callable[[Rig, Balance | SwingUp], Controller]
    """Returns the controller for what is believed of the rig, and for a task."""
    tasks: tuple[TaskName, ...] = ("balance",)  # What it can do at all.
    prior_knowledge: PriorKnowledge = _DESIGNED
    style: Style = ("#7F3C8D", "h", "-")
    cost: Cost = Cost.CHEAP
    learner: Callable[[Rig], Learner] | None = None
    """Returns a learner for a rig that is trained in seconds, so that a study may train it itself."""
    policy: str = ""  # Name of the policy that is shipped, of a learner.
    trainings: str = ""  # Name under which the trainings of one that takes minutes are kept in ``docs/results/deep``.
    own: Own | None = None  # Of a user's own controller: where it is, and its fingerprint.


def _learned(name: str) -> Callable[[Rig, Balance | SwingUp], Controller]:
    def make(rig: Rig, task: Balance | SwingUp) -> Controller:
        policy = load_policy(name)
        assert isinstance(policy, Controller)
        return policy

    return make


def _model_of_its_own(rig: Rig, task: Balance | SwingUp) -> Controller:
    policy: Any = load_policy("model-based")
    assert isinstance(policy, ModelPolicy)
    return policy


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
    """Pump energy, plan the last swing with a short horizon, and balance."""
    return SwitchingController(
        rig, SwitchingController(rig, EnergyPump(rig), ILQRMPC(rig, horizon=0.8, starts=4)), LQR(rig)
    )


BOTH: tuple[TaskName, ...] = ("balance", "swing-up")

# Okabe and Ito's colours; markers and line styles tell the curves apart without them.
CONTENDERS: tuple[Contender, ...] = (
    Contender(name="LQR", make=lambda rig, task: LQR(rig), style=("#0072B2", "o", "-")),
    Contender(name="stiff LQR", make=lambda rig, task: _stiff(rig), style=("#56B4E9", "<", "--")),
    Contender(name="sign of LQR", make=lambda rig, task: BangBang(LQR(rig), float(rig.force_limit)),
              style=("#E69F00", "s", "--")),
    Contender(name="sign of stiff LQR", make=lambda rig, task: BangBang(_stiff(rig), float(rig.force_limit)),
              style=("#D55E00", "^", "--")),
    Contender(name="LQR, best weights", make=lambda rig, task: tuned_law(rig, "weights"), prior_knowledge=_TUNED,
              style=("#009E73", "s", (0, (1, 1)))),
    Contender(name="tuned linear", make=lambda rig, task: tuned_law(rig, "gain"), prior_knowledge=_TUNED,
              style=("#D55E00", "v", "-")),
    Contender(name="sign of tuned linear", make=lambda rig, task: tuned_law(rig, "sign"), prior_knowledge=_TUNED,
              style=("#CC79A7", "P", "--")),
    Contender(name="SDRE", make=lambda rig, task: SDRE(rig), style=("#009E73", ">", "-.")),
    Contender(name="iLQR MPC", make=_planner, tasks=BOTH, style=("#000000", "X", "-")),
    Contender(name="NMPC", make=_nonlinear, tasks=BOTH, style=("#777777", "P", "-"), cost=Cost.EXPENSIVE),
    Contender(name="TVLQR", make=_follower, tasks=("swing-up",), style=("#009E73", "^", "-"),
              prior_knowledge=_DESIGNED._replace(reward="effort of a trajectory, then quadratic cost")),
    Contender(name="passivity, LQR", make=lambda rig, task: SwitchingController(rig, EnergySwingUp(rig)),
              tasks=("swing-up",), prior_knowledge=_ENERGY, style=("#8C6D1F", "v", ":")),
    Contender(name="pumping, LQR", make=lambda rig, task: SwitchingController(rig, EnergyPump(rig)),
              tasks=("swing-up",), prior_knowledge=_ENERGY, style=("#E69F00", "v", "-.")),
    Contender(name="pumping, iLQR, LQR", make=_planned_last_swing, tasks=("swing-up",), prior_knowledge=_ENERGY,
              style=("#D55E00", "s", "--")),
    Contender(name="Q tuned", make=_learned("q-tuned"), learner=lambda rig: LinearQLearning.tuned(rig),
              policy="q-tuned", style=("#009E73", "D", "-."), prior_knowledge=PriorKnowledge(
                  "none", "report's cost, weights tuned", "λ = .08 about upright, tests to .3")),
    Contender(name="QAC tuned", make=_learned("qac-tuned"), learner=lambda rig: GaussianQAC.tuned(rig),
              policy="qac-tuned", style=("#CC79A7", "*", (0, (6, 1, 1, 1))), prior_knowledge=PriorKnowledge(
                  "none", "quadratic cost, angles costly at first", "λ = .1 about upright")),
    Contender(name="LSPI", make=_learned("lspi"), learner=lambda rig: LSPI(rig), policy="lspi",
              prior_knowledge=PriorKnowledge("none", "quadratic cost", "λ = .02 about upright"),
              style=("#56B4E9", "p", "-")),
    Contender(name="learned model, iLQR", make=_model_of_its_own, tasks=("swing-up",), cost=Cost.EXPENSIVE,
              learner=lambda rig: ModelBased(rig), policy="model-based", style=("#0072B2", "*", "-"),
              prior_knowledge=PriorKnowledge("structure and symmetries", "quadratic cost", "hanging ±0.1 rad")),
    Contender(name="PPO balance", make=_learned("ppo-balance"), policy="ppo-balance", trainings="ppo-balance",
              prior_knowledge=_NEAR, style=("#0072B2", "d", ":")),
    Contender(name="DDPG balance", make=_learned("ddpg-balance"), policy="ddpg-balance", trainings="ddpg-balance",
              prior_knowledge=_NEAR, style=("#E69F00", "d", ":")),
    Contender(name="PPO swing-up", make=_learned("ppo-swing-up"), tasks=BOTH, prior_knowledge=_SHAPED,
              style=("#CC79A7", "o", "-"), policy="ppo-swing-up", trainings="ppo-swing-up"),
    Contender(name="PPO swing-up, smooth", make=_learned("ppo-swing-up-smooth"), tasks=BOTH,
              prior_knowledge=PriorKnowledge("none", "shaped, and changes of force", "anywhere, near upright too"),
              style=("#CC79A7", ">", "--"), policy="ppo-swing-up-smooth", trainings="ppo-swing-up-smooth"),
    Contender(name="DDPG swing-up", make=_learned("ddpg-swing-up"), tasks=BOTH, prior_knowledge=_SHAPED,
              style=("#D55E00", "D", ":"), policy="ddpg-swing-up", trainings="ddpg-swing-up"),
)  # fmt: skip
"""All that come with the package, as designed with their defaults or as shipped."""

LONG = frozenset({"SDRE", "iLQR MPC", "pumping, iLQR, LQR"})
"""Those that meet every start, but take minutes for thousands: they come early, in parts that processes share."""


def longest_first(contenders: Iterable[Contender]) -> list[Contender]:
    """Return contenders in the order in which they are best begun, so that no process waits for another at the end."""
    return sorted(contenders, key=lambda contender: (contender.cost.value, contender.name not in LONG))


_OWN: tuple[Style, ...] = (
    ("#7F3C8D", "h", "-"), ("#7F3C8D", "8", "--"), ("#B33951", "h", "-."), ("#B33951", "8", ":"),
)  # fmt: skip


def styles(names: Iterable[str], known: Iterable[Contender] = CONTENDERS) -> dict[str, Style]:
    """Return the style of each name, in the order of those known; users' own get one in turn and come last."""
    style, present = {contender.name: contender.style for contender in known}, dict.fromkeys(names)
    chosen = {name: style[name] for name in style if name in present}
    return chosen | dict(zip((name for name in present if name not in style), cycle(_OWN), strict=False))


_RECIPES: dict[str, Style] = {
    "ddpg-constant-rate": ("#000000", "s", "--"), "ddpg-swing-up-100k": ("#777777", "D", "-."),
    "td3-swing-up": ("#009E73", "D", "-."), "td3-swing-up-torch": ("#000000", "d", ":"),
    "td3-balance": ("#009E73", "D", "-."), "sac-balance": ("#56B4E9", "^", ":"),
    "sac-swing-up": ("#56B4E9", "^", ":"), "ppo-swing-up-caps": ("#009E73", "<", "--"),
    "ppo-swing-up-near": ("#777777", "s", "-"), "ppo-swing-up-rest": ("#E69F00", "v", "-."),
    "ppo-swing-up-smooth-w2": ("#56B4E9", "<", "-."), "ppo-swing-up-smooth-w3": ("#000000", "v", ":"),
}  # fmt: skip
"""Those of recipes whose policies are no contenders."""


def styles_of_recipes(names: Iterable[str]) -> dict[str, Style]:
    """Return the style of each recipe of a deep learner: that of the contender it trains, where it trains one."""
    own = {contender.trainings: contender.style for contender in CONTENDERS if contender.trainings}
    spare = cycle(_OWN)
    return {name: (own | _RECIPES).get(name) or next(spare) for name in dict.fromkeys(names)}


def designed_and_learned(names: Iterable[str]) -> list[list[str]]:
    """Return names in two parts, those of learners last; of no names no part."""
    learned = {contender.name for contender in CONTENDERS if contender.policy or contender.learner}
    parts: tuple[list[str], list[str]] = [], []
    for name in names:
        parts[name in learned].append(name)
    return [part for part in parts if part]


@dataclass(frozen=True, kw_only=True)
class Options(_runner.Options):
    """Options of a comparison's command line."""

    needs = ("force_limit",)
    known: ClassVar[tuple[Contender, ...]] = CONTENDERS
    """Those that can take part beside the user's own; a study that has more adds them."""
    tasks: ClassVar[tuple[TaskName, ...]] = BOTH
    """What the study is about."""

    controller: tuple[str, ...] = ()
    """Your own: path.py:factory or module:factory; the factory takes the rig, or nothing."""
    only: tuple[str, ...] = ()  # Those that take part beside your own; left out, all.

    def __post_init__(self) -> None:
        super().__post_init__()
        token = tried_on.set(plant.rig if (plant := self.elsewhere) else None)
        try:
            every = (*self.known, *map(own, self.controller))
        finally:
            tried_on.reset(token)
        names = [contender.name for contender in every]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"--controller: two contenders are called {name!r}; rename the factory.")
        for name in self.only:
            contender = find(name, known=every)
            if not {*contender.tasks} & {*self.tasks}:
                able = "; ".join(each.name for each in self.known if {*each.tasks} & {*self.tasks})
                raise ValueError(f"--only {name}: it does not {_DOES[self.tasks[0]]}; these do: {able}.")

    @property
    def joining(self) -> bool:
        """Whether controllers of the user's own join the contenders."""
        return bool(self.controller)

    def contenders(self, task: TaskName) -> list[Contender]:
        """Return those that do a task and were not left out, the user's own last.

        On another rig than that of the comparisons a network takes no part, which was trained there, nor does a learner
        where the rig is not ideal, and a law that is tuned in simulation, for minutes, only where ``--only`` names it.
        """
        chosen = [contender for contender in self.known if not self.only or contender.name in self.only]
        if plant := self.elsewhere:
            chosen = [
                contender for contender in chosen
                if not _stays_away(contender, plant.rig)
                and (contender.prior_knowledge is not _TUNED or contender.name in self.only)
            ]  # fmt: skip
        return [contender for contender in (*chosen, *map(own, self.controller)) if task in contender.tasks]

    @property
    def absent(self) -> list[str]:
        """Who takes no part on the rig, and why, in sentences; those that the options leave out are not named."""
        plant, named = self.elsewhere, dict[str, list[str]]()
        asked = [each for each in self.known if not self.only or each.name in self.only] if plant else []
        for contender in asked:
            why = _stays_away(contender, plant.rig) if plant else ""
            if not why and contender.prior_knowledge is _TUNED and not self.only:
                why = "What is tuned in simulation, for minutes, takes part where --only names it."
            if why and {*contender.tasks} & {*self.tasks}:
                named.setdefault(why, []).append(contender.name)
        return [f"Without {'; '.join(names)}. {why}" for why, names in named.items()]


_DOES: dict[TaskName, str] = {"balance": "balance", "swing-up": "swing up"}


def _stays_away(contender: Contender, rig: Rig) -> str:
    """Return why a contender takes no part on a rig that is not that of the comparisons; empty if it does."""
    if contender.learner is None:
        return "Networks control the rig on which they were trained." if contender.policy else ""
    if not rig.ideal:
        return "Learners learn on rigs without lag, delay, noise and rounding."
    try:
        contender.learner(rig)
    except ValueError as error:
        return str(error)
    return ""


def find(name: str, own_controller: Own | None = None, known: Iterable[Contender] = CONTENDERS) -> Contender:
    """Return the contender that a job names: one of those known, or a user's own by its ``own``.

    It is a ValueError if there is none, or a user's own controller is not what it was when the job was listed, and a
    RuntimeError if the key of the job that is being done does not hold this contender.
    """
    if own_controller is not None:
        return unchanged(own_controller)
    if (names := covered.get()) is not None and name not in names:
        raise RuntimeError(
            f"The job that is being done does not name the contender {name!r}, so that its kept result would outlive "
            "a change of it; put the name into a field of the job, or write it out where it is looked up."
        )
    by_name = {contender.name: contender for contender in known}
    if name not in by_name:
        raise ValueError(f"No contender is called {name!r}.{suggestion(name, by_name)}")
    return by_name[name]


def made(contender: Contender, plant: Plant | None, task: Balance | SwingUp) -> Controller:
    """Return the controller of a contender on the plant of a job; elsewhere a learner is trained there, seed 0.

    What is made elsewhere is kept, since a trajectory for another plant takes seconds.
    """
    if plant is None:
        return contender.make(rig_of(plant), task)
    return _trained(contender, plant) if contender.learner else _designed(contender, plant, task)


@cache
def _designed(contender: Contender, plant: Plant, task: Balance | SwingUp) -> Controller:
    return contender.make(plant.rig, task)


@cache
def _trained(contender: Contender, plant: Plant) -> Controller:
    assert contender.learner is not None
    return contender.learner(plant.rig).train(0).policy


def unchanged(listed: Own) -> Contender:
    """Return a user's own controller; a ValueError if it is not what it was when the job was listed."""
    found = own(listed.spec)
    if found.own is None or found.own.code != listed.code:
        raise ValueError(f"--controller {listed.spec} changed while the study ran; start it again.")
    return found


@cache
def own(spec: str) -> Contender:
    """Return a user's own controller, loaded once, as a contender that is called as its factory is.

    See :func:`studies._own.load_own` for the text, ``path.py:factory`` or ``module:factory``, and what is refused.
    """
    loaded = load_own(spec, RIG)
    return Contender(
        name=loaded.name, make=lambda rig, task: loaded.make(rig), tasks=BOTH, prior_knowledge=YOURS,
        cost=Cost.CHEAP if loaded.batched else Cost.MODERATE, own=loaded.own,
    )  # fmt: skip
