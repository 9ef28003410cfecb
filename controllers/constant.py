"""Controllers that use no measurement: no force, and the same force."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dpend.arguments import is_finite
from dpend.controller import Act


@dataclass(frozen=True)
class Constant:
    """:math:`u = u_0`, whatever is measured.

    Parameters
    ----------
    force : float
        :math:`u_0`, N.

    Raises
    ------
    ValueError
        If it is not finite.
    """

    force: float

    def __post_init__(self) -> None:
        if not is_finite(self.force):
            raise ValueError(f"force must be finite, in N; got {self.force!r}.")

    def start(self, n: int, rng: np.random.Generator) -> Act:
        """Return the law for ``n`` runs."""
        forces = np.full(n, float(self.force))
        return lambda t, y: forces.copy()


class Zero(Constant):
    """:math:`u = 0`: the plant's own motion."""

    def __init__(self) -> None:
        super().__init__(0.0)
