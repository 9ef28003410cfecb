"""Controllers that use no measurement: no force, and the same force."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dpend.arguments import is_finite
from dpend.controller import Act


@dataclass(frozen=True)
class Constant:
    """:math:`u = u_0`, whatever is measured.

    Useful beside others, and as a push that does not end.

    Parameters
    ----------
    force : float
        :math:`u_0`, N.

    Raises
    ------
    ValueError
        If it is not finite.

    See Also
    --------
    controllers.Zero : No force at all.

    Examples
    --------
    >>> import dpend
    >>> from controllers import Constant
    >>> rig = dpend.rig("gustafsson2016")
    >>> dpend.simulate(rig, Constant(5.0), [0, 0, 0, 0, 0, 0], duration=0.1).u[0].round(1)
    np.float64(5.0)
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
    """:math:`u = 0`: the plant's own motion.

    What the plant does by itself.

    See Also
    --------
    controllers.Constant : Another force.

    Examples
    --------
    >>> import dpend
    >>> from controllers import Zero
    >>> rig = dpend.rig("gustafsson2016")
    >>> dpend.simulate(rig, Zero(), [0, 0.1, 0, 0, 0, 0]).success
    False
    """

    def __init__(self) -> None:
        super().__init__(0.0)
