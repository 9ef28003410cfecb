"""What a learner is and what its training returns: one protocol and one result for all of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from dpend.arguments import checked_seed, checked_whole, is_finite
from dpend.controller import Controller
from dpend.params import Array
from dpend.provenance import versions
from dpend.rig import Rig, single_rig
from dpend.tasks import Balance, SwingUp

Seed = int | Sequence[int]
Progress = Callable[[float], None] | None


class Outcome(Enum):
    """How a training ended; the value says it.

    What a learner means by convergence its docstring says.

    See Also
    --------
    rl.Training : Whose ``outcome`` it is.

    Examples
    --------
    >>> from rl import Outcome
    >>> isinstance(Outcome.CONVERGED.value, str)
    True
    """

    CONVERGED = "The learner met its criterion of convergence."
    DIVERGED = "A weight, or the state, grew beyond the range of floating-point numbers."
    BUDGET_SPENT = "The budget was spent without convergence."


@dataclass(frozen=True, kw_only=True)
class Cost:
    """What a training cost.

    ``experience`` is the plant's time, s: learning and tests together.

    Parameters
    ----------
    episodes : int
        Learning episodes, over all restarts, that ended within the budget; -1 where they were not counted.
    steps : int
        Samples learned from.
    test_steps : int
        Samples of acceptance tests or evaluations.
    sample_time : float
        Of each sample, s.
    cpu_seconds : float
        Processor time of the process.

    See Also
    --------
    rl.Training : Whose ``cost`` it is.

    Examples
    --------
    >>> from rl import LSPI
    >>> LSPI("gustafsson2016").train(seed=0).cost.steps
    6000
    """

    episodes: int
    steps: int
    test_steps: int = 0
    sample_time: float
    cpu_seconds: float

    @property
    def experience(self) -> float:
        """Time that the plant ran, tests included, s."""
        return (self.steps + self.test_steps) * self.sample_time


class Snapshot(NamedTuple):
    """A policy on the way of a training, without its exploration.

    A policy that is not the last may be worse than none.

    Parameters
    ----------
    experience : float
        Time that the plant had run by then, as in the ``curve``, s.
    policy : Controller
        The policy.

    See Also
    --------
    rl.Training.snapshots : Make them.

    Examples
    --------
    >>> from rl import LSPI
    >>> LSPI("gustafsson2016").train(seed=0).snapshots(3)[-1].experience
    120.0
    """

    experience: float
    policy: Controller


class Trail(NamedTuple):
    """Policies on the way of a training, kept as the weights that they are made of."""

    experience: npt.NDArray[Any]
    """Time that the plant had run by each, as in the ``curve``, s."""
    weights: Any
    policy: Callable[..., Any]
    """What makes a policy of one of the weights."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Training:
    """What a training returns, whatever the learner.

    The policy is a controller: simulations, studies and the playground take it.

    Parameters
    ----------
    policy : Controller
        The policy that was learned, finite even where the learner diverged.
    outcome : Outcome
        How the training ended; ``converged`` is short for one of them.
    cost : Cost
        Episodes, samples and processor time; ``experience`` is short for the plant's time, s.
    curve : mapping of str to ndarray (m,)
        One entry a learning episode that ended, or an evaluation of a deep learner: ``experience`` (s, tests included)
        always; ``length`` (samples), ``reward`` (total), ``success`` where they apply; a learner documents others.
    details : mapping of str to ndarray
        Arrays of this learner alone, which its ``train`` documents.
    trail : Trail, optional
        Policies on the way, for :meth:`snapshots`.

    See Also
    --------
    rl.Learner : What returns it.

    Examples
    --------
    >>> from rl import LSPI
    >>> training = LSPI("gustafsson2016").train(seed=0)
    >>> sorted(training.curve)
    ['experience', 'length']
    """

    policy: Any  # a Controller, with what its class has beside ``start``
    outcome: Outcome
    cost: Cost
    curve: Mapping[str, npt.NDArray[Any]]
    details: Mapping[str, npt.NDArray[Any]] = field(default_factory=dict)
    trail: Trail | None = None

    @property
    def converged(self) -> bool:
        """Whether the learner met its criterion of convergence."""
        return self.outcome is Outcome.CONVERGED

    @property
    def experience(self) -> float:
        """Time that the plant ran, tests included, s."""
        return self.cost.experience

    def snapshots(self, n: int) -> list[Snapshot]:
        """Return policies on the way, spread geometrically over what the learner recorded.

        They show how a policy came about: evaluate each on the same starts.

        Parameters
        ----------
        n : int
            At most so many, the last among them, and the first where there are several.

        Returns
        -------
        list of Snapshot
            Of a training that recorded none, the final policy alone.

        See Also
        --------
        rl.Snapshot : What they are.

        Examples
        --------
        >>> from rl import LSPI
        >>> len(LSPI("gustafsson2016").train(seed=0).snapshots(5))
        5
        """
        checked_whole("n", n)
        if self.trail is None or not len(self.trail.weights):
            return [Snapshot(self.experience, self.policy)]
        experience, weights, policy = self.trail
        last = len(weights)
        rows = np.unique(np.geomspace(1 if n > 1 else last, last, min(n, last)).round().astype(int)) - 1
        return [Snapshot(float(experience[k]), policy(weights[k])) for k in rows]


@runtime_checkable
class Learner(Protocol):
    """A description of a learner: it is built with its rig first, learns from a seed, and stays as it is.

    Settings out of their range and rigs that cannot be learned on are refused with a ValueError where it is built.

    Parameters
    ----------
    *args, **kwargs : Any
        A learner takes its rig first, and its settings by name.

    See Also
    --------
    dpend.check_learner : Hold a learner to the contract.
    rl.LSPI : For instance.

    Examples
    --------
    >>> from rl import LSPI, Learner
    >>> isinstance(LSPI("gustafsson2016"), Learner)
    True
    """

    @property
    def rig(self) -> Rig:
        """The plant that is learned on."""
        ...

    @property
    def task(self) -> Any:
        """What is learned: a ``dpend.Balance`` or ``dpend.SwingUp``, or ``"balance"`` or ``"swing-up"``."""
        ...

    def train(self, seed: Seed, *, seconds: float | None = None, progress: Progress = None) -> Training:
        """Learn.

        The same seed gives the same training.

        Parameters
        ----------
        seed : int or sequence of int
            What all randomness is drawn from.
        seconds : float, optional
            Greatest experience, tests included, s of the plant's time; left out, the learner's own budget, which a
            longer time does not extend.
        progress : callable, optional
            Called every now and then with the share of the budget that is spent, 0 to 1.

        Returns
        -------
        Training
            Policy, outcome, cost and learning curve.

        See Also
        --------
        rl.Training : What comes back.

        Examples
        --------
        >>> from rl import LSPI
        >>> LSPI("gustafsson2016").train(seed=0, seconds=10.0).experience
        10.0
        """
        ...


def task_name(learner: Learner) -> Literal["balance", "swing-up"]:
    """Return which of the two tasks a learner learns.

    Raises
    ------
    TypeError
        If it is neither.
    """
    task = learner.task
    if task == "balance" or isinstance(task, Balance):
        return "balance"
    if task == "swing-up" or isinstance(task, SwingUp):
        return "swing-up"
    raise TypeError(f"A learner's task must be a dpend.Balance or a dpend.SwingUp, or its name; got {task!r}.")


def training_rig(rig: Rig | str, learner: str) -> Rig:
    """Return the rig, or the preset of that name; refuse one of several rows or with lag, delay, noise or rounding."""
    rig = single_rig(rig, learner)
    if not rig.ideal:
        raise ValueError(
            f"{learner} trains on ideal rigs; got one with lag, delay, noise or rounding. "
            "Train on the ideal rig, then simulate the policy on this one."
        )
    return rig


def samples_within(seconds: float | None, sample_time: float) -> int:
    """Return the whole samples that a budget of experience allows; refuse one shorter than a sample."""
    if seconds is None:
        return 2**62
    if not is_finite(seconds) or seconds < sample_time:
        raise ValueError(f"seconds must be finite and at least one sample, {sample_time:g} s; got {seconds!r}.")
    return int(seconds / sample_time + 1e-9)


def _checked_seed(seed: Seed) -> int | list[int]:
    if isinstance(seed, Sequence | np.ndarray) and not isinstance(seed, str | bytes) and getattr(seed, "ndim", 1):
        return [checked_seed("seed", each) for each in seed]
    return checked_seed("seed", seed)


class Session:
    """A training under way: its random numbers, its budget and clock, and the result that it comes to.

    ``stream`` sets the learner's random numbers apart from others drawn with the same seed.
    """

    def __init__(self, learner: Learner, seed: Seed, seconds: float | None, progress: Progress, stream: int) -> None:
        self._seed = _checked_seed(seed)
        if not (progress is None or callable(progress)):
            raise TypeError(f"progress must be None or take the share that is done, 0 to 1; got {progress!r}.")
        self._learner, self._progress = learner, progress
        self._began = time.process_time()
        self.budget = samples_within(seconds, learner.rig.sample_time)
        """The most samples of experience."""
        self.spent = 0
        """Samples of experience so far, tests included."""
        self.rng = np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=(stream,)))

    @property
    def left(self) -> int:
        """Samples of experience that the budget still allows."""
        return self.budget - self.spent

    def report(self, share: float) -> None:
        """Report that a share of the learner's own budget is spent, or more of that of experience."""
        if self._progress is not None:
            self._progress(min(max(share, self.spent / self.budget), 1.0))

    def training(
        self,
        outcome: Outcome,
        law: Callable[..., Controller],
        weights: Array,
        trail: tuple[Any, Any],
        curve: Mapping[str, Any],
        details: Mapping[str, Any],
    ) -> Training:
        """Return the result: ``law`` makes a policy of weights and ``about``, its provenance.

        ``trail`` has the samples until each recorded policy and its weights; ``curve`` at least the ``length`` of each
        episode, and the samples ``tested`` after it, if there were tests.
        """
        self.report(1.0)
        sample_time, tested = self._learner.rig.sample_time, curve.get("tested", np.zeros(len(curve["length"]), int))
        about = {
            "learner": repr(self._learner),
            "seed": self._seed,
            "outcome": outcome.name,
            "versions": versions(),
        }
        return Training(
            policy=law(weights, about=about),
            outcome=outcome,
            cost=Cost(
                episodes=len(curve["length"]),
                steps=self.spent - int(tested.sum()),
                test_steps=int(tested.sum()),
                sample_time=sample_time,
                cpu_seconds=time.process_time() - self._began,
            ),
            curve={"experience": sample_time * np.cumsum(curve["length"] + tested)} | dict(curve),
            details=details,
            trail=Trail(sample_time * np.asarray(trail[0]), trail[1], law),
        )
