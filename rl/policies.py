"""Learned policies: controllers made of plain arrays."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dpend.controller import Act
from dpend.params import Array

from .features import TABLE1, slope_features

_FORMAT = "dpend policy 1"


class LinearQPolicy:
    r"""Greedy law :math:`u = \arg\max_{a \in A} \hat q(s, a)` of a linear :math:`\hat q` over Table 1's features.

    With :math:`\hat q = c(s) + a\,g(s)` only :math:`a\,g(s)` matters, so the force is always at an end of
    :math:`A`; where :math:`g` is zero it is the first of the set.

    Parameters
    ----------
    weights : array_like (18,)
        :math:`w`.
    scales : array_like (18,)
        Factor of each feature; ones for the report's own.
    forces : array_like (m,)
        The action set :math:`A`, N.
    about : mapping, optional
        Where the weights come from, in words and numbers; saved with them.

    Raises
    ------
    ValueError
        If an array has another shape or a number is not finite.
    """

    name = "linear Q-learning"

    def __init__(
        self,
        weights: npt.ArrayLike,
        scales: npt.ArrayLike,
        forces: npt.ArrayLike,
        *,
        about: Mapping[str, Any] | None = None,
    ) -> None:
        self.about = dict(about or {})
        self.weights = _vector("weights", weights, len(TABLE1))
        self.scales = _vector("scales", scales, len(TABLE1))
        self.forces = _vector("forces", forces, None)

    def __repr__(self) -> str:
        return f"<{self.name}, seed {self.about.get('seed')}, {self.about.get('outcome', 'of unknown origin')}>"

    def start(self, n: int, rng: np.random.Generator) -> Act:
        """Give the law for ``n`` runs."""
        slope_weights = self.weights[-6:] * self.scales[-6:]
        slope_weights /= np.abs(slope_weights).max() or 1.0  # only the direction counts, and weights may be huge
        forces = self.forces
        return lambda t, y: forces[np.argmax((slope_weights @ np.stack(slope_features(y.T)))[:, None] * forces, axis=1)]

    def save(self, path: str | Path) -> Path:
        """Write the policy as an ``.npz`` of plain arrays.

        Parameters
        ----------
        path : str or Path
            The file.

        Returns
        -------
        Path
            The file; ``.npz`` is added where the name has no suffix.
        """
        path = Path(path)
        if not path.suffix:
            path = path.with_suffix(".npz")
        with path.open("wb") as file:
            np.savez(
                file,
                format=np.array(_FORMAT),
                kind=np.array("linear Q"),
                weights=self.weights,
                scales=self.scales,
                forces=self.forces,
                about=np.array(json.dumps(self.about, default=str)),
            )
        return path


def load_policy(path: str | Path) -> LinearQPolicy:
    """Read a saved policy; nothing in the file can run code.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    LinearQPolicy

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the file is not a saved policy.
    """
    try:
        with Path(path).open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            if str(file["format"]) != _FORMAT or str(file["kind"]) != "linear Q":
                raise ValueError("another format")
            about = json.loads(str(file["about"]))
            return LinearQPolicy(file["weights"], file["scales"], file["forces"], about=about)
    except FileNotFoundError:
        raise
    except Exception as error:
        raise ValueError(f"{path} is not a policy saved by dpend ({error}).") from error


def _vector(name: str, value: npt.ArrayLike, length: int | None) -> Array:
    vector = np.array(value, dtype=np.float64)
    if vector.ndim != 1 or not len(vector) or (length is not None and len(vector) != length):
        wanted = "(m,)" if length is None else f"({length},)"
        raise ValueError(f"{name} must have shape {wanted}; got {vector.shape}.")
    if not np.isfinite(vector).all():
        raise ValueError(f"{name} must be finite.")
    vector.setflags(write=False)
    return vector
