r"""The swing-up from seconds of experience: a model of the plant is learned, and planned on.

The first episode is of random forces.  After each, the model is fitted to all transitions so far, and the next episode
is driven by iLQR on it, in a receding horizon.  What is known beforehand are switches of
:class:`ModelBased`, each a line in ``docs/model-based.md``.

Source: M. Deisenroth and C. Rasmussen, *PILCO: a model-based and data-efficient approach to policy search*, ICML 2011,
whose task and episodes these are.  It searches a policy on the model; here the plan is made while the plant runs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

import dpend
from controllers.ilqr import ILQRMPC
from controllers.ilqr_kernels import Plans
from dpend.arguments import checked_array
from dpend.controller import Act
from dpend.params import Array, Params
from dpend.rig import Rig, single_rig
from dpend.run import Run
from dpend.state import state_rows, wrap
from dpend.suggest import suggests
from dpend.tasks import SwingUp

from . import joint_fit
from .harmonic import HarmonicModel
from .kernel_model import KernelModel, Priors, Transitions
from .policies import About, Saved, checked_about, made_policy
from .settings import Flag, Nonnegative, Positive, Whole, check_settings
from .training import Outcome, Progress, Seed, Session, Training

_STREAM = 2011  # sets learning apart from starts drawn with the same seed
_STARTS = 0, 2, 2  # random starts of each first plan from which one is chosen; with none, it is always the same
_DOUBT = 2.0  # times the standard deviation that a model states, which proves too small by about so much
_LASTING = 4.0  # the same along a plan, where a model errs in the same way from one sample to the next
_CLEAR = 0.9  # of the track is planned with: the rest is for what the model does not know
_REACH, _TIP = 0.5, 0.1  # m: of the cart from the middle, and of the tip from upright, where a swing-up has settled


def settled(run: Run) -> bool:
    """Return whether a run ended with a second of the cart within .5 m of the middle, the tip within .1 m of upright.

    The true state counts, and the tip's distance from where it would be above the cart.
    """
    last = run.x[-1 - round(1.0 / run.rig.sample_time) :]
    lengths = np.array([run.rig.params.length1, run.rig.params.length2], dtype=np.float64)
    across, below = np.sin(last[:, 1:3]) @ lengths, (1 - np.cos(last[:, 1:3])) @ lengths
    good = np.isfinite(last).all() and len(run.u) == getattr(run.task, "steps", len(run.u))
    return bool(good and (np.abs(last[:, 0]) < _REACH).all() and (np.hypot(across, below) < _TIP).all())


class ModelPolicy(Saved):
    """Receding-horizon iLQR on a learned model.

    What it saves is the model alone; the planner is built again.

    Parameters
    ----------
    model : HarmonicModel or KernelModel
        The model.
    sample_time, force_limit, track_limit : float
        Clock and limits, s, N and m.
    about : mapping, optional
        Where it comes from; saved with it.

    See Also
    --------
    controllers.ILQRMPC : The planner.
    rl.ModelBased : Learn one.

    Examples
    --------
    >>> from rl import ModelBased
    >>> policy = ModelBased("pilco2011").train(seed=0).policy  # doctest: +SKIP
    """

    kind = "model"
    saved = ("sample_time", "force_limit", "track_limit")
    batched = False
    name = "iLQR on a learned model"

    def __init__(
        self, model: Any, *, sample_time: float, force_limit: float, track_limit: float,
        about: About = None,
    ) -> None:  # fmt: skip
        if not isinstance(model, HarmonicModel | KernelModel):
            raise TypeError(f"model must be a HarmonicModel or a KernelModel of rl; got {model!r}.")
        self.model, self.about = model, checked_about(about)
        nothing = Params(cart_mass=1, mass1=1, mass2=1, length1=1, length2=1)  # which a plan on a model does not read
        self._rig = Rig(
            params=nothing, sample_time=sample_time, force_limit=force_limit, track_limit=_CLEAR * track_limit
        )
        self.sample_time, self.force_limit, self.track_limit = sample_time, force_limit, track_limit

    def __reduce__(self) -> tuple[Any, ...]:
        return made_policy, (self.kind, self.about, self.arrays())  # without the compiled planners

    @cached_property
    def planners(self) -> list[ILQRMPC]:
        """The controllers, one for each first plan from which one is chosen."""
        model = self.model.model
        return [ILQRMPC(self._rig, model=model, starts=starts) for starts in _STARTS]

    def attributed(self, about: Mapping[str, Any] | None) -> ModelPolicy:
        """Return the same policy with a provenance.

        Model and compiled code are shared.

        Parameters
        ----------
        about : mapping or None
            Where it comes from; None leaves nothing.

        Returns
        -------
        ModelPolicy
            The same but for that.

        See Also
        --------
        rl.load_policy : Whose files keep it.

        Examples
        --------
        >>> from rl import ModelBased
        >>> ModelBased("pilco2011").train(seed=0).policy.attributed({"seed": 0})  # doctest: +SKIP
        """
        return type(self)(self.model, about=about, **{name: getattr(self, name) for name in self.saved})

    def start(self, n: int, rng: np.random.Generator) -> Act:
        """Return the law for one run."""
        each = zip(self.planners, rng.spawn(len(_STARTS)), strict=True)
        return _Cheapest([planner.start(n, own) for planner, own in each], self.model, self.planners[0].P, self._rig)

    def uncertainty(self, x: npt.ArrayLike, u: npt.ArrayLike) -> Array:
        """Return the standard deviations (N, 3) of the accelerations believed in states (N, 6) under forces (N,).

        It is small where data were, and grows to what was believed before any.

        Parameters
        ----------
        x : array_like (N, 6)
            States.
        u : array_like (N,)
            Forces, N.

        Returns
        -------
        ndarray (N, 3)
            Of the cart, m/s^2, and of both links, rad/s^2.

        See Also
        --------
        rl.ModelBased : Learn one.

        Examples
        --------
        >>> from rl import ModelBased
        >>> policy = ModelBased("pilco2011").train(seed=0).policy  # doctest: +SKIP
        >>> policy.uncertainty([[0, 0, 0, 0, 0, 0]], [0.0])  # doctest: +SKIP
        """
        forces = np.atleast_1d(checked_array("u", u, "forces (N,)"))
        return self.model.uncertainty(np.atleast_2d(state_rows("x", x)), forces)

    def arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Return what is saved, by name.

        ``policy.save(path)`` writes them with their provenance.

        Returns
        -------
        dict of str to ndarray
            Arrays that numpy can save without pickle.

        See Also
        --------
        rl.load_policy : Read them again.

        Examples
        --------
        >>> from rl import ModelBased
        >>> ModelBased("pilco2011").train(seed=0).policy.arrays()  # doctest: +SKIP
        """
        model = {f"model_{name}": value for name, value in self.model.arrays().items()}
        return super().arrays() | model | {"model": np.asarray(self.model.kind)}

    @classmethod
    def from_arrays(cls, *, about: Mapping[str, Any], **arrays: Any) -> ModelPolicy:
        """Build a policy from what :meth:`arrays` returned."""
        settings = {name: float(arrays.pop(name)) for name in cls.saved}
        built: Any = {each.kind: each for each in (HarmonicModel, KernelModel)}[str(arrays.pop("model"))]
        model = built.from_arrays(**{name.removeprefix("model_"): value for name, value in arrays.items()})
        return cls(model, about=about, **settings)


class _Cheapest:
    """Of several laws the one whose first plan is expected to cost least, on the states that a filter estimates.

    There is no filter where velocities are not known to be the rates of positions, for then these err, too.
    """

    def __init__(self, laws: list[Any], model: HarmonicModel | KernelModel, P: Array, rig: Rig) -> None:
        self._laws, self._model, self._P, self._limit, self._force = laws, model, P, float(rig.force_limit), 0.0
        rates_lead = isinstance(model, HarmonicModel) or model.priors.second_order
        self._follow = kalman(model) if rates_lead else lambda y, _: y

    @property
    def log(self) -> Mapping[str, list[Array]]:
        """The log of the law in charge."""
        return self._laws[0].log

    def __call__(self, t: float, y: Array) -> Array:
        x = self._follow(y[0], self._force)[None]
        forces = [law(t, x) for law in self._laws]
        if len(forces) > 1 and np.isfinite(x).all():
            best = int(np.argmin([expected_cost(law.plans, self._model, self._P) for law in self._laws]))
            self._laws, forces = [self._laws[best]], [forces[best]]
        self._force = float(np.clip(forces[0][0], -self._limit, self._limit))
        return forces[0]


def expected_cost(plans: Plans, model: HarmonicModel | KernelModel, P: Array) -> float:
    r"""Return :math:`J + \sum_k \operatorname{tr}(G^\top V_{k+1} G\, \Sigma_k)` of a single plan of cost :math:`J`.

    The accelerations' covariance :math:`\Sigma_k` is taken for sixteen times what the model states, :math:`G` is what
    they do in a sample, and :math:`V_k = (A_k + B_k K_k)^\top V_{k+1} (A_k + B_k K_k)`, :math:`V_N = P`, what a small
    deviation costs by the end under the plan's own gains.
    """
    x, u, K = plans.x[0], plans.u[0], plans.K[0]
    G, D, V, cost = _pushes(model.sample_time), np.empty((len(u), 6, 8)), P, float(plans.cost[0])
    with np.errstate(all="ignore"):  # a plan may lead beyond all numbers
        model.model.loops.linearize(x, u, model.model.parameters, D)
        closed = D[:, :, :6] + D[:, :, 6:7] * K[:, None]
        doubts = (_LASTING * model.uncertainty(x[:-1], u)) ** 2
        for A, doubt in zip(closed[::-1], doubts[::-1], strict=True):
            cost += doubt @ np.einsum("ij,ik,kj->j", G, V, G)
            V = A.T @ V @ A
    return cost if math.isfinite(cost) else math.inf


def _pushes(h: float) -> Array:
    """Return what accelerations (3,) held for a sample do to the state, (6, 3)."""
    return np.concatenate([h**2 / 2 * np.eye(3), h * np.eye(3)])


def kalman(model: HarmonicModel | KernelModel) -> Callable[[Array, float], Array]:
    """Return the extended Kalman filter of a model: from a measured state (6,) and the force before it to an estimate.

    The motion strays from the model by what accelerations it is unsure of.
    """
    plan, h, noise = model.model, model.sample_time, np.diag(model.sensor_noise**2)
    pushes, D = _pushes(h), np.empty((1, 6, 8))
    mean, covariance = np.full(6, math.nan), noise

    def follow(y: Array, force: float) -> Array:
        nonlocal mean, covariance
        plan.loops.linearize(np.stack([mean, mean]), np.array([force]), plan.parameters, D)
        predicted, A = mean + D[0, :, 7], D[0, :, :6]
        with np.errstate(all="ignore"):  # what is lost is begun again
            doubt = _DOUBT * model.uncertainty(mean[None], np.array([force]))[0]
            P = A @ covariance @ A.T + (pushes * doubt**2) @ pushes.T
        if not (np.isfinite(predicted).all() and np.isfinite(P).all()):
            mean, covariance = y.copy(), noise
        elif not np.isfinite(y).all():
            mean, covariance = predicted, P
        else:
            gain = np.linalg.solve(P + noise, P).T
            off = y - predicted
            off[1:3] = wrap(off[1:3])
            mean, covariance = predicted + gain @ off, P - gain @ P
            covariance = (covariance + covariance.T) / 2
        return mean

    return follow


class RandomForces:
    """Random forces, smooth over .2 s, and a weak spring that draws the cart to the middle.

    Parameters
    ----------
    rig : Rig
        Clock and limits.
    """

    name = "random forces"

    def __init__(self, rig: Rig) -> None:
        self.force, self.reach = float(rig.force_limit), min(float(rig.track_limit) / 2, 1.0)
        self.smooth = math.exp(-float(rig.sample_time) / 0.2)

    def start(self, n: int, rng: np.random.Generator) -> Act:
        """Return the law for ``n`` runs."""
        noise = rng.standard_normal(n)

        def act(_: float, y: Array) -> Array:
            nonlocal noise
            noise = self.smooth * noise + math.sqrt(1 - self.smooth**2) * rng.standard_normal(n)
            share = 0.4 * noise - 0.3 * y[:, 0] / self.reach - 0.15 * y[:, 3]
            return self.force * np.clip(np.nan_to_num(share), -1.0, 1.0)

        return act


Policy = TypeVar("Policy")


def excited_rig(rig: Rig | str, learner: str) -> Rig:
    """Return the rig, or the preset of that name, of a learner that acts at random first and allows for noise."""
    rig = single_rig(rig, learner)
    if not math.isfinite(float(rig.force_limit)):
        raise ValueError(f"{learner} needs a rig with a force limit, the size of its random forces; got one without.")
    if not rig.replace(sensor_noise=0.0).ideal:
        raise ValueError(f"{learner} takes a rig without lag, delay, rounding or noise of the force; got one with.")
    return rig


def episodes_of(learner: Any) -> SwingUp:
    """Return the task of a learner's episodes: swinging up from hanging."""
    steps = max(round(learner.episode_seconds / float(learner.rig.sample_time)), 1)
    return SwingUp(angle_spread=learner.angle_spread, steps=steps)


@threadpool_limits.wrap(limits=1, user_api="blas")  # more round differently, and wait for one another on busy cores
def practise(
    learner: Any, session: Session, first: int, fit: Callable[[list[Run], Policy | None], Policy | None],
    driving: Callable[[Policy], Policy] = lambda policy: policy,
) -> tuple[list[Run], list[Policy], list[int], list[bool]]:  # fmt: skip
    """Act in episodes, fitting after each what drives the next; end after the learner's streak of successes.

    Parameters
    ----------
    learner : Learner
        With its rig, task, ``episodes`` and ``streak``.
    session : Session
        The training under way.
    first : int
        Samples of the first episode, of random forces; so is every other until there is something fitted.
    fit : callable
        What they teach, given all runs so far and what was fitted last; None if they do not tell.
    driving : callable
        What drives the next episode, given what was fitted.

    Returns
    -------
    runs : list of Run
        One an episode.
    policies : list
        What was fitted.
    spent : list of int
        Samples of experience until each of them.
    success : list of bool
        Whether each episode was a success, by :func:`rl.model_based.settled`.
    """
    rig, task, streak = learner.rig, learner.task, learner.streak
    runs: list[Run] = []
    policies: list[Policy] = []
    spent: list[int] = []
    success: list[bool] = []
    policy: Policy | None = None
    while len(runs) < learner.episodes and session.left > 0 and not (len(success) >= streak and all(success[-streak:])):
        law: Any = RandomForces(rig) if policy is None else driving(policy)
        steps = min(task.steps if policies else first, session.left)
        x0 = task.starts(session.rng, 1, rig)[0]
        seed = int(session.rng.integers(2**31))
        runs.append(dpend.simulate(rig, law, x0, steps * rig.sample_time, task=task, seed=seed))
        session.spent += len(runs[-1].u)
        success.append(settled(runs[-1]))
        policy = fit(runs, policy)
        if policy is not None:
            policies.append(policy)
            spent.append(session.spent)
        session.report(len(runs) / learner.episodes)
    return runs, policies, spent, success


def practised(
    session: Session, runs: list[Run], policies: list[Any], spent: list[int], success: list[bool], streak: int,
    details: Mapping[str, Any],
) -> Training:  # fmt: skip
    """Return the training that such practice came to."""
    converged = len(success) >= streak and all(success[-streak:])
    return session.training(
        Outcome.CONVERGED if converged else Outcome.BUDGET_SPENT,
        lambda policy, about=None: policy.attributed(about),
        policies[-1],
        (spent, policies),
        {"length": np.array([len(run.u) for run in runs]), "success": np.array(success)},
        details,
    )


def transitions(runs: Sequence[Run]) -> Transitions:
    """Return what was measured in runs, sample by sample."""
    parts = [Transitions(run.y[:-1], run.u, run.y[1:]) for run in runs]
    return Transitions(*(np.concatenate(each) for each in zip(*parts, strict=True)))


@suggests
@dataclass(frozen=True, kw_only=True)
class ModelBased:
    r"""Model-based learning of the swing-up: a model fitted after each episode, and iLQR on it in the next.

    Each switch is a piece of prior knowledge, which can be left out to see what it is worth.

    Parameters
    ----------
    rig : Rig or str
        The plant, or the name of a preset; it may have noise, but neither lag nor delay nor rounding.  Beside its runs
        the learner sees its clock and its limits.
    angles : bool
        Whether it is known that angles recur: sines and cosines take their place.
    second_order : bool
        That velocities are the rates of positions.
    cart_invariance : bool
        That it does not matter where the cart stands.
    mirror : bool
        That mirrored motion is motion.
    structure : bool
        That accelerations are affine in the force and quadratic in the rates, with coefficients that depend on the
        angles; needs the first three.
    gravity : bool
        That gravity alone tells up from down: half a turn of everything reverses it, and nothing else; needs structure.
    sampling : bool
        Whether each episode is planned on a model drawn from what is believed, so as to learn where that is unsure,
        instead of on its mean; needs structure.
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
    rl.IdentifyAndPlan : With the equations.
    controllers.ILQRMPC : The planner.

    Examples
    --------
    >>> from rl import ModelBased
    >>> ModelBased("pilco2011").train(seed=0)  # doctest: +SKIP
    """

    rig: Rig = field(kw_only=False)
    angles: Flag = True
    second_order: Flag = True
    cart_invariance: Flag = True
    mirror: Flag = True
    structure: Flag = True
    gravity: Flag = True
    sampling: Flag = False
    episode_seconds: Positive = 5.0
    angle_spread: Nonnegative = 0.1
    episodes: Whole = 12
    streak: Whole = 3

    def __post_init__(self) -> None:
        object.__setattr__(self, "rig", excited_rig(self.rig, "ModelBased"))
        check_settings(self)
        if self.structure and not (self.angles and self.second_order and self.cart_invariance):
            raise ValueError(
                "structure is stated in angles, accelerations and no position: expected it to be False without angles, "
                "second_order and cart_invariance; got True."
            )
        for name, of in (("gravity", "is stated of"), ("sampling", "draws")):
            if getattr(self, name) and not self.structure:
                raise ValueError(
                    f"{name} {of} the coefficients of the structure: expected it to be False without; got True."
                )

    @property
    def task(self) -> SwingUp:
        """Swinging up from hanging, in episodes of its own."""
        return episodes_of(self)

    def train(self, seed: Seed, *, seconds: float | None = None, progress: Progress = None) -> Training:
        """Learn from nothing, as every :class:`rl.Learner` does; a budget may cut the last episode short.

        ``curve`` has the ``length`` of each episode and its ``success``, which is :func:`rl.model_based.settled` and is
        not looked at but to stop; ``details`` the ``noise`` (m, 3) of the measured rates that each model inferred.
        Converged means ``streak`` successes in a row.
        """
        session, h = Session(self, seed, seconds, progress, _STREAM), float(self.rig.sample_time)
        rng = session.rng
        priors = Priors(self.angles, self.second_order, self.cart_invariance, self.mirror)
        settings = {"sample_time": h, "force_limit": self.rig.force_limit, "track_limit": self.rig.track_limit}

        def fit(runs: list[Run], policy: ModelPolicy | None) -> ModelPolicy | None:
            before: Any = None if policy is None else policy.model
            model: Any = (
                joint_fit.fit([joint_fit.Episode(run.y, run.u) for run in runs], h, self.mirror, self.gravity, before)
                if self.structure
                else KernelModel.fit(transitions(runs), h, priors, rng, before)
            )
            return policy if model is None else ModelPolicy(model, **settings)

        def driving(policy: ModelPolicy) -> ModelPolicy:
            model: Any = policy.model
            return ModelPolicy(model.drawn(rng), **settings) if self.sampling else policy

        runs, policies, spent, success = practise(self, session, self.task.steps, fit, driving)
        if not policies:
            raise RuntimeError(
                f"ModelBased found no model in {session.spent * h:g} s of experience: expected measurements with less "
                "noise than motion; got more. Try less sensor noise, more force or more experience."
            )
        noise = np.array([policy.model.noise for policy in policies])
        return practised(session, runs, policies, spent, success, self.streak, {"noise": noise})
