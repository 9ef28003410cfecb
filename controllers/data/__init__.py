"""Trajectories that come with the package; ``python -m controllers.data`` recomputes them."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Literal

from dpend.arguments import checked_name
from dpend.rig import Rig, as_rig
from dpend.tasks import SwingUp

from ..trajectory import Trajectory

FOLDER = Path(__file__).parent
"""Where they lie, one file each: ``rig_start_target_objective.npz``."""


def file_name(rig: str, start: str, target: str, objective: str) -> str:
    """Return the name of the file of a trajectory for a preset; hanging and down-down are the same start."""
    return f"{rig}_{'hanging' if start == 'down-down' else start}_{target}_{objective}.npz"


def shipped(
    rig: Rig | str,
    start: str = "hanging",
    target: str = "up-up",
    objective: Literal["effort", "time"] = "effort",
) -> Trajectory | None:
    """Return the stored trajectory for exactly this plant, clock and limits; None if there is none.

    ``python -m controllers.data`` made them.

    Parameters
    ----------
    rig : Rig or str
        The rig; what its actuator and sensors do besides the limits does not matter.
    start : str
        "hanging", "side", or the name of an equilibrium.
    target : str
        The name of an equilibrium.
    objective : {"effort", "time"}
        What was minimised.  A trajectory in minimum time has a sample time of its own, whatever the rig's.

    Returns
    -------
    Trajectory or None
        What is stored, or None.

    Raises
    ------
    ValueError
        If there is no such start, target or objective.

    See Also
    --------
    controllers.optimize : Find another.
    controllers.TVLQR : Follow it.

    Examples
    --------
    >>> import dpend
    >>> from controllers import shipped
    >>> rig = dpend.rig("gustafsson2016")
    >>> shipped(rig).target[1:3].round(2)
    array([0.  , 6.28])
    """
    rig = as_rig(rig)
    SwingUp(start=start, target=target)  # refuses what is neither
    checked_name("objective", objective, ("effort", "time"))
    if rig.n is not None:
        return None
    for path in sorted(FOLDER.glob(file_name("*", start, target, objective))):
        trajectory = _load(path)
        own = trajectory.rig
        same_clock = objective == "time" or own.sample_time == rig.sample_time
        same_limits = (own.force_limit, own.track_limit) == (rig.force_limit, rig.track_limit)
        if own.params == rig.params and own.substeps == rig.substeps and same_clock and same_limits:
            return trajectory
    return None


@cache
def _load(path: Path) -> Trajectory:
    return Trajectory.load(path)
