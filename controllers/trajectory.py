"""A planned motion: states and forces, sample by sample, that replay on the plant as planned."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from dpend import archive
from dpend.arguments import checked_array
from dpend.params import Array
from dpend.rig import Rig, ideal_rig, single_rig
from dpend.state import as_equilibrium, as_states
from dpend.stepper import Stepper

_FORMAT = "dpend trajectory 1"


@dataclass(frozen=True, kw_only=True, eq=False)
class Trajectory:
    r"""States :math:`x_0 \dots x_N` and held forces :math:`u_0 \dots u_{N-1}` from a start to an equilibrium.

    Arrays are read-only; ``Trajectory.load(path)`` reads what :meth:`save` wrote.

    Parameters
    ----------
    rig : Rig
        The plant, its limits, and the clock of the samples; actuator and sensors do not enter.
    x : ndarray (N + 1, 6)
        States.
    u : ndarray (N,)
        Forces, N, each held over one sample.
    target : ndarray (6,)
        The equilibrium it leads to, angles by as many turns as the states have.
    about : mapping
        Where it comes from, in words and numbers; saved with it.

    Raises
    ------
    ValueError
        If the shapes do not fit, a number is not finite, the rig describes several plants, or the target is no
        equilibrium.

    See Also
    --------
    controllers.optimize : Find one.
    controllers.TVLQR : Follow one.

    Examples
    --------
    >>> import dpend
    >>> from controllers import shipped
    >>> rig = dpend.rig("gustafsson2016")
    >>> trajectory = shipped(rig)
    >>> trajectory.x.shape[0] == trajectory.u.shape[0] + 1
    True
    """

    rig: Rig
    x: Array
    u: Array
    target: Array
    about: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        single_rig(self.rig, "Trajectory")
        u = checked_array("u", self.u, "forces (N,)").copy()
        if u.ndim != 1 or not len(u):
            raise ValueError(f"u must be finite forces of shape (N,), at least one; got shape {u.shape}.")
        x = as_states(self.x, len(u) + 1)
        for array in (x, u):
            array.setflags(write=False)
        object.__setattr__(self, "x", x)
        object.__setattr__(self, "u", u)
        object.__setattr__(self, "target", as_equilibrium(self.target))

    def __repr__(self) -> str:
        return f"<trajectory of {self.duration:g} s in {len(self.u)} samples, peak force {np.abs(self.u).max():.1f} N>"

    @property
    def t(self) -> Array:
        """Times of the states ``(N + 1,)``, s."""
        return self.rig.sample_time * np.arange(len(self.x), dtype=np.float64)

    @property
    def duration(self) -> float:
        """Length, s."""
        return self.rig.sample_time * len(self.u)

    def defect(self) -> float:
        """Return greatest difference between a state and where the plant goes from the last, held for one sample.

        A trajectory that holds in the simulator has hardly any.

        Returns
        -------
        float
            In the units of the states.

        See Also
        --------
        controllers.violations : Limits and target as well.

        Examples
        --------
        >>> import dpend
        >>> from controllers import shipped
        >>> rig = dpend.rig("gustafsson2016")
        >>> shipped(rig).defect() < 1e-6
        True
        """
        stepper = Stepper(ideal_rig(self.rig), len(self.u))
        stepper.reset(self.x[:-1])
        return float(np.abs(stepper.step(self.u) - self.x[1:]).max())

    def save(self, path: str | Path) -> Path:
        """Write a compressed ``.npz`` of plain arrays and return its path; ``.npz`` is added where it has no suffix.

        Nothing in the file can run code.

        Parameters
        ----------
        path : str or Path
            Where to.

        Returns
        -------
        Path
            Where it is.

        See Also
        --------
        controllers.shipped : Those that come with the package.

        Examples
        --------
        >>> import tempfile
        >>> from controllers import Trajectory, shipped
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = shipped("gustafsson2016").save(f"{folder}/mine")
        ...     print(path.name, len(Trajectory.load(path).u))
        mine.npz 125
        """
        header = {"rig": self.rig.to_dict(), "about": dict(self.about)}
        return archive.write(path, _FORMAT, header, {"x": self.x, "u": self.u, "target": self.target})

    @classmethod
    def load(cls, path: str | Path) -> Trajectory:
        """Read what :meth:`save` wrote.

        Raises
        ------
        OSError
            If the file is not there or cannot be read.
        ValueError
            If it is not a saved trajectory, or is damaged.
        """
        with archive.opened(path, _FORMAT) as (header, arrays):
            return cls(rig=Rig.from_dict(header["rig"]), about=header["about"], **arrays)
