r"""The swing-up from two seconds of motion and the equations: parameters are identified, and planned with.

What is given is the form of the equations and a guess of the masses and lengths; friction counts as unknown.  A short
episode of random forces goes to :func:`dpend.identify`, iLQR plans on the rig found, and where that rig predicts a
later episode worse than it did those it was found from, it is sought once more, from all runs.
"""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt

import dpend
from controllers.ilqr import ILQRMPC
from dpend.controller import Act
from dpend.params import Params
from dpend.rig import Rig, ideal_rig, single_rig
from dpend.run import Run
from dpend.suggest import suggests
from dpend.tasks import SwingUp

from .model_based import episodes_of, excited_rig, practise, practised
from .policies import About, Saved, checked_about
from .settings import Nonnegative, Positive, Whole, at_least, check_settings, must
from .training import Progress, Seed, Session, Training

_STREAM = 1999  # sets learning apart from starts drawn with the same seed
_GUESSED = ("cart_mass", "mass1", "mass2", "length1", "length2")
_FRICTION = ("cart_friction", "joint1_friction", "joint2_friction")
_SEGMENT = 0.5  # s
_WORSE = 1.5  # times the error with which a rig predicts the runs it was found from, it is sought again


class PlannedPolicy(Saved):
    """Receding-horizon iLQR on a rig.

    What it saves is the rig alone; the planner is built again.

    Parameters
    ----------
    rig : Rig or str
        The rig it plans with, or the name of a preset.
    about : mapping, optional
        Where it comes from; saved with it.

    See Also
    --------
    controllers.ILQRMPC : The planner.

    Examples
    --------
    >>> import dpend
    >>> rig = dpend.rig("gustafsson2016")
    >>> from rl import PlannedPolicy
    >>> PlannedPolicy(rig).about
    {}
    """

    kind = "planned"
    saved = ("record",)
    batched = False
    name = "iLQR on an identified rig"

    def __init__(self, rig: Rig | str, *, about: About = None) -> None:
        self.rig = single_rig(rig, "PlannedPolicy")
        self.about = checked_about(about)

    @property
    def record(self) -> str:
        """The rig as JSON."""
        return json.dumps(self.rig.to_dict())

    @cached_property
    def planner(self) -> ILQRMPC:
        """The controller."""
        return ILQRMPC(self.rig)

    def attributed(self, about: Mapping[str, Any] | None) -> PlannedPolicy:
        """Return the same policy with a provenance.

        Compiled code is shared.

        Parameters
        ----------
        about : mapping or None
            Where it comes from; None leaves nothing.

        Returns
        -------
        PlannedPolicy
            The same but for that.

        See Also
        --------
        rl.load_policy : Whose files keep it.

        Examples
        --------
        >>> import dpend
        >>> rig = dpend.rig("gustafsson2016")
        >>> from rl import PlannedPolicy
        >>> PlannedPolicy(rig).attributed({"seed": 0}).about["seed"]
        0
        """
        return PlannedPolicy(self.rig, about=about)

    def start(self, n: int, rng: np.random.Generator) -> Act:
        """Return the law for one run."""
        return self.planner.start(n, rng)

    @classmethod
    def from_arrays(cls, *, about: Mapping[str, Any], **arrays: npt.NDArray[Any]) -> PlannedPolicy:
        """Build a policy from what :meth:`rl.policies.Saved.arrays` returned."""
        return cls(Rig.from_dict(json.loads(str(arrays["record"]))), about=about)


@suggests
@dataclass(frozen=True, kw_only=True)
class IdentifyAndPlan:
    r"""Identification of masses, lengths and friction from random motion, and iLQR with what was found.

    It is the least that any learner can need that has the equations but not their numbers.

    Parameters
    ----------
    rig : Rig or str
        The plant, or the name of a preset; it may have noise, but neither lag nor delay nor rounding.
    unknown : float
        Masses and lengths are guessed wrong by :math:`U[-s, s]` of their values; friction is guessed to be none.
    motion : float
        Length of the first episode, of random forces, s; it is repeated where the data do not determine the rig.
    episode_seconds : float
        Length of an episode, s.
    angle_spread : float
        Each starts hanging, with each angle moved by :math:`U[-s, s]`, rad.
    episodes : int
        Greatest number of them.
    streak : int
        So many successful episodes in a row end the training.

    See Also
    --------
    rl.ModelBased : Without the equations.
    dpend.identify : The identification alone.

    Examples
    --------
    >>> from rl import IdentifyAndPlan
    >>> IdentifyAndPlan("pilco2011").train(seed=0)  # doctest: +SKIP
    """

    rig: Rig = field(kw_only=False)
    unknown: Annotated[float, must("at least 0 and below 1", lambda share: 0 <= share < 1)] = 0.3
    motion: Annotated[Positive, at_least(2 * _SEGMENT, " s")] = 2.0
    episode_seconds: Positive = 5.0
    angle_spread: Nonnegative = 0.1
    episodes: Whole = 6
    streak: Whole = 2

    def __post_init__(self) -> None:
        object.__setattr__(self, "rig", excited_rig(self.rig, "IdentifyAndPlan"))
        check_settings(self)

    @property
    def task(self) -> SwingUp:
        """Swinging up from hanging, in episodes of its own."""
        return episodes_of(self)

    def train(self, seed: Seed, *, seconds: float | None = None, progress: Progress = None) -> Training:
        """Learn, as every :class:`rl.Learner` does.

        ``curve`` has the ``length`` of each episode and its ``success``, which is not looked at but to stop;
        ``details`` the parameters ``found`` (m, 8), masses, lengths and friction, by each identification.  Converged
        means ``streak`` successes in a row.
        """
        session = Session(self, seed, seconds, progress, _STREAM)
        guess = {
            name: float(getattr(self.rig.params, name)) * (1 + self.unknown * session.rng.uniform(-1, 1))
            for name in _GUESSED
        }
        start = replace(self.rig.params, **guess, **dict.fromkeys(_FRICTION, 0.0))
        expected = math.inf

        def fit(runs: list[Run], policy: PlannedPolicy | None) -> PlannedPolicy | None:
            nonlocal expected
            if policy is not None and _prediction_error(runs[-1:], policy.rig) <= _WORSE * expected:
                return policy
            found = _identified(runs, start if policy is None else policy.rig.params)
            if found is None:
                return policy
            rig = self.rig.replace(params=found)
            expected = _prediction_error(runs, rig)
            return PlannedPolicy(rig)

        steps = round(self.motion / float(self.rig.sample_time))
        runs, policies, spent, success = practise(self, session, steps, fit)
        if not policies:  # nothing was determined: the guess is all there is
            policies, spent = [PlannedPolicy(self.rig.replace(params=start))], [session.spent]
        found = [[float(getattr(each.rig.params, name)) for name in (*_GUESSED, *_FRICTION)] for each in policies]
        return practised(session, runs, policies, spent, success, self.streak, {"found": np.array(found)})


def _identified(runs: list[Run], start: Params) -> Params | None:
    """Return the parameters that all runs tell together, or None where they do not."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what the model lacks shows in its predictions
        try:
            return dpend.identify(
                [run for run in runs if run.t[-1] >= _SEGMENT], start, (*_GUESSED, *_FRICTION), segment=_SEGMENT,
                outputs=dpend.NAMES,
            ).params  # fmt: skip
        except (ValueError, RuntimeError, np.linalg.LinAlgError):
            return None


def _prediction_error(runs: list[Run], rig: Rig) -> float:
    """Return the root mean square error, over all states, of predictions of a sample from the measured state."""
    x, u, after = (np.concatenate(each) for each in zip(*((r.y[:-1], r.u, r.y[1:]) for r in runs), strict=True))
    plant = dpend.Stepper(ideal_rig(rig), len(x))
    plant.reset(x)
    plant.step(u)
    return float(np.sqrt(np.mean((plant.x - after) ** 2)))
