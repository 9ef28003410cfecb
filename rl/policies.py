"""Learned policies: controllers of plain arrays, saved with a checksum and loaded without running code.

All of them refuse arrays of other shapes, numbers that are not finite and words that are unknown with a ValueError.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dpend import archive
from dpend.arguments import checked_array, checked_mapping, checked_path, checked_positive
from dpend.controller import Act
from dpend.laws import holding, linear_law
from dpend.params import Array
from dpend.shaping import observe
from dpend.state import nearest_upright
from dpend.suggest import suggestion

from .features import TABLE1, make_value_features, slope_features
from .settings import one_of

if TYPE_CHECKING:
    from .model_based import ModelPolicy

Arrays = Sequence[ArrayLike]
About = Mapping[str, Any] | None
_FORMAT = "dpend policy 2"
_TRAINED = Path(__file__).parent / "trained"


class Saved:
    """What can be written to a file and read back by :func:`rl.load_policy`."""

    kind: ClassVar[str]
    """What it is called in its file."""
    saved: ClassVar[tuple[str, ...]]
    """Attributes that are saved, which are also the arguments it is built from."""
    name: str
    """What it is called in tables."""
    about: dict[str, Any]
    """Where it comes from, as JSON can hold it."""

    def __repr__(self) -> str:
        return f"<{self.name}, seed {self.about.get('seed')}, {self.about.get('outcome', 'of unknown origin')}>"

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return what is saved, by name; none of objects."""
        return {name: np.asarray(getattr(self, name)) for name in self.saved}

    @classmethod
    def from_arrays(cls, *, about: Mapping[str, Any], **arrays: NDArray[Any]) -> Any:
        """Build a policy from what :meth:`arrays` returned."""
        build: Any = cls
        return build(**arrays, about=about)

    def save(self, path: str | Path) -> Path:
        """Write an archive of plain arrays with a checksum, to the end or not at all, and return its path.

        ``.npz`` is added where the name has no suffix.
        """
        return archive.write(path, _FORMAT, {"kind": self.kind, "about": self.about}, self.arrays())


class LinearQPolicy(Saved):
    r"""Greedy law :math:`u = \arg\max_{a \in A} \hat q(s, a)` of a linear :math:`\hat q` over Table 1's features.

    With :math:`\hat q = c(s) + a\,g(s)` only :math:`a\,g(s)` matters, so the force is always at an end of
    :math:`A`; where :math:`g` is zero it is the first of the set.  As in Table 1, :math:`g` has the raw angles: after a
    whole turn this is another law.

    Parameters
    ----------
    weights : array_like (18,)
        :math:`w`.
    scales : array_like (18,)
        Factor of each feature; ones for the report's own.
    forces : array_like (m,)
        The action set :math:`A`, N.
    about : mapping, optional
        Where the weights come from; saved with them.

    See Also
    --------
    rl.LinearQLearning : Learn one.

    Examples
    --------
    >>> import numpy as np
    >>> from rl import LinearQPolicy
    >>> policy = LinearQPolicy(weights=np.ones(18), scales=np.ones(18), forces=[-40.0, 0.0, 40.0])
    >>> act = policy.start(1, np.random.default_rng(0))
    >>> float(abs(act(0.0, np.array([[0, 0.1, 0, 0, 0, 0]]))[0]))
    40.0
    """

    kind = "linear Q"
    saved = ("weights", "scales", "forces")
    name = "linear Q-learning"

    def __init__(self, weights: ArrayLike, scales: ArrayLike, forces: ArrayLike, *, about: About = None) -> None:
        self.about = checked_about(about)
        self.weights = _vector("weights", weights, len(TABLE1))
        self.scales = _vector("scales", scales, len(TABLE1))
        self.forces = _vector("forces", forces, None)

    def start(self, n: int, rng: np.random.Generator) -> Act:
        """Return the law for ``n`` runs."""
        slope_weights = self.weights[-6:] * self.scales[-6:]
        slope_weights /= np.abs(slope_weights).max() or 1.0  # only the direction counts, and weights may be huge
        forces = self.forces

        def greedy(_: float, y: Array) -> Array:
            slope = slope_weights @ np.stack(slope_features(y.T))
            return forces[np.argmax(slope[:, None] * forces, axis=1)]

        return holding(n, greedy)


class GainPolicy(Saved):
    r"""Law :math:`u = -K x`, with angles taken to the nearest whole turn; the rig saturates it.

    It is what LSPI and the tuned actor-critic learn.

    Parameters
    ----------
    K : array_like (6,)
        Gain, N per unit of each state.
    about : mapping, optional
        Where the gain comes from; saved with it.

    See Also
    --------
    controllers.LinearLaw : The same by design.

    Examples
    --------
    >>> import numpy as np
    >>> import dpend
    >>> rig = dpend.rig("gustafsson2016")
    >>> from rl import GainPolicy
    >>> dpend.simulate(rig, GainPolicy([1, -150, 165, 2.5, -7, 29]), [0, 0.1, -0.1, 0, 0, 0], duration=2.0).success
    True
    """

    kind = "gain"
    saved = ("K",)
    name = "learned gain"

    def __init__(self, K: ArrayLike, *, about: About = None) -> None:
        self.about = checked_about(about)
        self.K = _vector("K", K, 6)

    def __repr__(self) -> str:
        return f"<{self.name}, K = {np.array2string(self.K, precision=4, separator=', ')}>"

    def start(self, n: int, rng: np.random.Generator) -> Act:
        """Return the law for ``n`` runs."""
        return holding(n, linear_law(self.K, np.zeros(6)))


INDICATORS: Mapping[str, int] = MappingProxyType({"none": 0, "signs": 3, "cells": 8})
"""Further features of the state by name, and their number: the signs of position and angles, or each combination."""


class TableOneMean(Saved):
    r"""Law :math:`u = \varphi(s)^\top v`, the mean of Algorithm 2's policy over Table 1's twelve features of the state.

    It is linear in features, not in the state, and not odd.

    Parameters
    ----------
    v : array_like (12 + k,)
        Weights of the features, then of the ``k`` indicators.
    indicators : {"none", "signs", "cells"}
        Which of :data:`rl.policies.INDICATORS` take part.
    about : mapping, optional
        Where the weights come from; saved with them.

    See Also
    --------
    rl.GaussianQAC : Learn one.

    Examples
    --------
    >>> import numpy as np
    >>> from rl import TableOneMean
    >>> policy = TableOneMean(v=np.zeros(12), indicators="none")
    >>> policy.start(1, np.random.default_rng(0))(0.0, np.zeros((1, 6)))
    array([0.])
    """

    kind = "table 1 mean"
    saved = ("v", "indicators")
    name = "mean of Gaussian QAC"

    def __init__(self, v: ArrayLike, indicators: str | NDArray[Any], *, about: About = None) -> None:
        self.about = checked_about(about)
        self.indicators = str(indicators)
        one_of(INDICATORS)("indicators", self.indicators)
        self.v = _vector("v", v, 12 + INDICATORS[self.indicators])

    def start(self, n: int, rng: np.random.Generator) -> Act:
        """Return the law for ``n`` runs."""
        value_features, v = make_value_features(), self.v

        def mean(_: float, y: Array) -> Array:
            x = nearest_upright(y)
            return np.einsum("i,ij->j", v, np.stack([*value_features(x.T), *self._indicated(x)]))

        return holding(n, mean)

    def _indicated(self, x: Array) -> list[Array]:
        positive = [x[:, 0] > 0, x[:, 1] > 0, x[:, 2] > 0]
        if self.indicators == "signs":
            return [sign.astype(np.float64) for sign in positive]
        cell = 4 * positive[0] + 2 * positive[1] + positive[2]
        return [(cell == k).astype(np.float64) for k in range(INDICATORS[self.indicators])]


# OpenBLAS splits larger products over threads, which for these costs up to a hundred times what it saves.
_SMALL_PRODUCT = 1 << 18

_ACTIVATIONS: Mapping[str, Callable[[Array], Array]] = MappingProxyType(
    {"tanh": lambda h: np.tanh(h, out=h), "relu": lambda h: np.maximum(h, 0.0, out=h)}
)
_SQUASHES: Mapping[str, Callable[[Array], Array]] = MappingProxyType(
    {"tanh": lambda h: np.tanh(h, out=h), "clip": lambda h: np.clip(h, -1.0, 1.0, out=h)}
)


class Network(Saved):
    r"""Network :math:`\pi(o) = s(W_k h_{k-1} + b_k)` with :math:`h_i = \sigma(W_i h_{i-1} + b_i)` and :math:`h_0 = o`.

    It needs numpy alone; a library that trained it is not asked again.

    Parameters
    ----------
    weights : sequence of array_like (m_i, m_{i-1})
        :math:`W_1 \dots W_k`.
    biases : sequence of array_like (m_i,)
        :math:`b_1 \dots b_k`.
    activation : {"tanh", "relu"}
        :math:`\sigma`.
    squash : {"clip", "tanh"}
        :math:`s`, which brings actions within -1 and 1.
    about : mapping, optional
        Where the weights come from; saved with them.

    See Also
    --------
    rl.MLPPolicy : One as a controller.

    Examples
    --------
    >>> import numpy as np
    >>> from rl import Network
    >>> net = Network(weights=[np.ones((1, 2))], biases=[np.zeros(1)], activation="tanh", squash="clip")
    >>> net(np.array([[0.2, 0.3]]))
    array([[0.5]])
    """

    kind = "network"
    saved = ("activation", "squash")

    def __init__(
        self, weights: Arrays, biases: Arrays, *, activation: str = "tanh", squash: str = "clip", about: About = None
    ) -> None:
        for name, layers in (("weights", weights), ("biases", biases)):
            if not isinstance(layers, list | tuple):
                raise TypeError(f"{name} must be a list of arrays, one a layer; got {layers!r}.")
        if not len(weights) or len(weights) != len(biases):
            raise ValueError(f"Expected as many biases as weights, at least one; got {len(biases)} and {len(weights)}.")
        self.weights = tuple(
            checked_array(f"weight {i}", weight, "a matrix of an output's rows", finite=False).copy()
            for i, weight in enumerate(weights)
        )
        self.biases = tuple(_vector(f"bias {i}", bias, None) for i, bias in enumerate(biases))
        width = self.weights[0].shape[-1] if self.weights[0].ndim else 0
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            if weight.shape != (len(bias), width) or not width:
                raise ValueError(f"weight {i} must have shape ({len(bias)}, {width}); got {weight.shape}.")
            if not np.isfinite(weight).all():
                raise ValueError(f"weight {i} must be finite.")
            weight.setflags(write=False)
            width = len(bias)
        one_of(_ACTIVATIONS)("activation", activation)
        one_of(_SQUASHES)("squash", squash)
        self.activation, self.squash = activation, squash
        self.about = checked_about(about)

    @property
    def inputs(self) -> int:
        """Length of an observation."""
        return self.weights[0].shape[1]

    @property
    def outputs(self) -> int:
        """Length of an action."""
        return len(self.biases[-1])

    def __repr__(self) -> str:
        return f"<network {'-'.join(str(n) for n in (self.inputs, *map(len, self.biases)))}, {self.activation}>"

    def __call__(self, observations: Array) -> Array:
        """Return actions ``(n, outputs)``, within -1 and 1, for observations ``(n, inputs)``."""
        if not (isinstance(observations, np.ndarray) and observations.dtype.kind == "f" and observations.ndim == 2):
            observations = checked_array("observations", observations, f"an array (n, {self.inputs})", finite=False)
        if observations.shape[1:] != (self.inputs,):
            raise ValueError(f"observations must have shape (n, {self.inputs}); got {observations.shape}.")
        actions = np.empty((len(observations), self.outputs))
        rows = max(_SMALL_PRODUCT // max(weight.size for weight in self.weights), 1)
        for start in range(0, len(observations), rows):
            actions[start : start + rows] = self._forward(observations[start : start + rows])
        return actions

    def _forward(self, observations: Array) -> Array:
        activate = _ACTIVATIONS[self.activation]
        h = observations
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            h = h @ weight.T
            h += bias
            h = activate(h)
        return _SQUASHES[self.squash](h @ self.weights[-1].T + self.biases[-1])

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return what is saved, by name.

        ``network.save(path)`` writes them with their provenance.

        Returns
        -------
        dict of str to ndarray
            Arrays that numpy can save without pickle.

        See Also
        --------
        rl.load_policy : Read them again.

        Examples
        --------
        >>> import numpy as np
        >>> from rl import Network
        >>> net = Network(weights=[np.ones((1, 2))], biases=[np.zeros(1)], activation="tanh", squash="clip")
        >>> len(net.arrays()) > 0
        True
        """
        layers = {f"weight{i}": _shortest(weight) for i, weight in enumerate(self.weights)}
        return super().arrays() | layers | {f"bias{i}": _shortest(bias) for i, bias in enumerate(self.biases)}

    @classmethod
    def from_arrays(cls, *, activation: Any, squash: Any, about: Mapping[str, Any], **layers: Any) -> Network:
        """Build a network from what :meth:`arrays` returned."""
        k = len(layers) // 2
        names = [f"{kind}{i}" for kind in ("weight", "bias") for i in range(k)]
        if set(layers) != set(names):
            raise ValueError(f"expected arrays {', '.join(names)}; got {', '.join(sorted(layers))}")
        weights, biases = [layers[name] for name in names[:k]], [layers[name] for name in names[k:]]
        return cls(weights, biases, activation=str(activation), squash=str(squash), about=about)


class MLPPolicy(Saved):
    r"""A network on scaled states, :math:`u = F\,\pi(o(y))`, held for a period of its own.

    Where the network has one input more than :func:`dpend.shaping.observe` returns for a state, it also sees its own
    last action.

    Parameters
    ----------
    network : Network
        :math:`\pi`; eight or nine inputs, one output.
    scales : array_like (4,)
        What :func:`dpend.shaping.observe` divides position, velocity and both rates by.
    force_limit : float
        :math:`F`, N.
    period : float
        How long a force is held, s; on a rig with a longer sample time it acts at every sample.
    about : mapping, optional
        Where the policy comes from; saved with it.

    See Also
    --------
    rl.load_policy : Those that are shipped.
    rl.Network : The network alone.

    Examples
    --------
    >>> from rl import load_policy
    >>> load_policy("ppo-swing-up").period
    0.04
    """

    kind = "mlp"
    saved = ("scales", "force_limit", "period")

    def __init__(
        self, network: Network, *, scales: ArrayLike, force_limit: float, period: float, about: About = None
    ) -> None:
        if not isinstance(network, Network):
            raise TypeError(f"network must be an rl.Network; got {network!r}.")
        self.about = checked_about(network.about if about is None else about)
        self.network = network
        self.scales = _vector("scales", scales, 4)
        for scale in self.scales.tolist():
            checked_positive("scales", scale)
        self.force_limit = checked_positive("force_limit", force_limit)
        self.period = checked_positive("period", period)
        if network.inputs not in (8, 9) or network.outputs != 1:
            raise ValueError(
                f"The network must have 8 inputs, or 9 with its last action, and 1 output; "
                f"got {network.inputs} and {network.outputs}."
            )
        self.name = str(self.about.get("name", "network"))

    def __repr__(self) -> str:
        return f"<{self.name}, {self.network!r}, seed {self.about.get('seed')}>"

    def start(self, n: int, rng: np.random.Generator) -> Act:
        """Return the law for ``n`` runs."""
        network, scales, force_limit, period = self.network, self.scales, self.force_limit, self.period
        recalls = network.inputs == 9
        last = np.zeros(n)
        due = -np.inf

        def act(t: float, y: Array) -> Array:
            nonlocal last, due
            if t > due:
                action = network(observe(y, scales, last if recalls else None))[:, 0]
                last = np.where(np.isfinite(action), action, last)  # what overflows must not be recalled
                due = t + period * (1 - 1e-6)
            return force_limit * last

        return holding(n, act, before=np.nan)  # an action of NaN is not recalled

    def arrays(self) -> dict[str, NDArray[Any]]:
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
        >>> from rl import load_policy
        >>> "scales" in load_policy("ppo-swing-up").arrays()
        True
        """
        return self.network.arrays() | super().arrays()

    @classmethod
    def from_arrays(cls, *, scales: Any, force_limit: Any, period: Any, about: Any, **network: Any) -> MLPPolicy:
        """Build a policy from what :meth:`arrays` returned."""
        net = Network.from_arrays(about=about, **network)
        return cls(net, scales=scales, force_limit=float(force_limit), period=float(period), about=about)


Policy: TypeAlias = "LinearQPolicy | GainPolicy | TableOneMean | MLPPolicy | Network | ModelPolicy"


def load_policy(policy: str | Path) -> Policy:
    """Read a saved policy; nothing in the file can run code.

    Running it needs numpy alone, or numba where it plans.

    Parameters
    ----------
    policy : str or Path
        The file, or the name of a policy that is shipped with the package: a file of ``rl/trained`` without its suffix.

    Returns
    -------
    LinearQPolicy, GainPolicy, TableOneMean, MLPPolicy, Network or ModelPolicy
        As it was saved.

    Raises
    ------
    FileNotFoundError
        If there is neither such a file nor such a name.
    ValueError
        If the file is not a saved policy, or is damaged.

    See Also
    --------
    rl.Training : Whose policy has ``save``.

    Examples
    --------
    >>> import dpend
    >>> rig = dpend.rig("gustafsson2016")
    >>> from rl import load_policy
    >>> dpend.simulate(rig, load_policy("lspi"), [0, 0.1, -0.1, 0, 0, 0], duration=2.0).success
    True
    """
    path = checked_path("policy", policy)
    if isinstance(policy, str) and path.name == policy and not path.suffix and not path.exists():
        path = _TRAINED / f"{policy}.npz"
        if not path.exists():
            known = [file.stem for file in _TRAINED.glob("*.npz")]
            raise FileNotFoundError(f"There is no file and no shipped policy {policy!r}.{suggestion(policy, known)}")
    with archive.opened(path, _FORMAT) as (header, arrays):
        return made_policy(header["kind"], header["about"], arrays)


def made_policy(kind: str, about: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> Policy:
    """Return the policy of a kind, with a provenance and what its ``arrays`` returned; refuse a kind unknown."""
    kinds = {each.kind: each for each in Saved.__subclasses__()}
    if kind not in kinds:
        raise ValueError(f"an unknown kind of policy, {kind!r}")
    return kinds[kind].from_arrays(about=about, **arrays)


def checked_about(about: About) -> dict[str, Any]:
    """Return a copy of a provenance; refuse what is no mapping."""
    return checked_mapping("about", about, "a mapping of where a policy comes from")


def _shortest(array: Array) -> NDArray[np.floating[Any]]:
    """Return an array in single precision where that loses nothing, as of what was learned in it."""
    single = array.astype(np.float32)
    return single if (single == array).all() else array


def _vector(name: str, value: ArrayLike, length: int | None) -> Array:
    vector = checked_array(name, value, "a list of numbers", finite=False).copy()
    if vector.ndim != 1 or not len(vector) or (length is not None and len(vector) != length):
        wanted = "(m,)" if length is None else f"({length},)"
        raise ValueError(f"{name} must have shape {wanted}; got {vector.shape}.")
    if not np.isfinite(vector).all():
        raise ValueError(f"{name} must be finite.")
    vector.setflags(write=False)
    return vector
