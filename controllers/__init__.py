"""Classical controllers for the inverted double pendulum on a cart.

A name loads its own module when it is first asked for, so that ``from controllers import LQR`` waits neither for CasADi
nor for numba nor for matplotlib.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

from dpend.deprecation import warn_renamed

if TYPE_CHECKING:
    from .constant import Constant, Zero
    from .data import shipped
    from .energy import EnergyPump, EnergySwingUp
    from .estimators import EKF, UKF, Differences, Predictor, WithEstimator
    from .ilqr import ILQRMPC, Model, ilqr
    from .lqr import LQR, BangBang, LinearLaw, Margins
    from .nmpc import NMPC
    from .sdre import SDRE
    from .smoothing import LowPass, RateLimit
    from .switching import Ellipsoid, NearEnergy, RolloutRegion, SwitchingController
    from .trajectory import Trajectory
    from .trajopt import NoTrajectory, optimize, violations
    from .tuning import TunedLaw, tuned_gain, tuned_law, tuned_weights
    from .tvlqr import TVLQR

__all__ = [
    "EKF",
    "ILQRMPC",
    "LQR",
    "NMPC",
    "SDRE",
    "TVLQR",
    "UKF",
    "BangBang",
    "Constant",
    "Differences",
    "Ellipsoid",
    "EnergyPump",
    "EnergySwingUp",
    "LinearLaw",
    "LowPass",
    "Margins",
    "Model",
    "NearEnergy",
    "NoTrajectory",
    "Predictor",
    "RateLimit",
    "RolloutRegion",
    "SwitchingController",
    "Trajectory",
    "TunedLaw",
    "WithEstimator",
    "Zero",
    "ilqr",
    "optimize",
    "shipped",
    "tuned_gain",
    "tuned_law",
    "tuned_weights",
    "violations",
]

_MODULES = {
    name: module
    for module, names in {
        "constant": ("Constant", "Zero"),
        "data": ("shipped",),
        "energy": ("EnergyPump", "EnergySwingUp"),
        "estimators": ("EKF", "UKF", "Differences", "Predictor", "WithEstimator"),
        "ilqr": ("ILQRMPC", "Model", "ilqr"),
        "lqr": ("LQR", "BangBang", "LinearLaw", "Margins"),
        "nmpc": ("NMPC",),
        "sdre": ("SDRE",),
        "smoothing": ("LowPass", "RateLimit"),
        "switching": ("Ellipsoid", "NearEnergy", "RolloutRegion", "SwitchingController"),
        "trajectory": ("Trajectory",),
        "trajopt": ("NoTrajectory", "optimize", "violations"),
        "tuning": ("TunedLaw", "tuned_gain", "tuned_law", "tuned_weights"),
        "tvlqr": ("TVLQR",),
    }.items()
    for name in names
}
_RENAMED = {"Ahead": "RolloutRegion", "Catch": "SwitchingController", "faults": "violations"}


def __getattr__(name: str) -> Any:
    if name in _RENAMED:
        warn_renamed(f"{__name__}.{name}", f"{__name__}.{_RENAMED[name]}")
        return getattr(sys.modules[__name__], _RENAMED[name])
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f".{_MODULES[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


class _Package(ModuleType):
    """The package, in which ``ilqr`` is the function also once the module of that name has been imported."""

    def __setattr__(self, name: str, value: object) -> None:
        if name == "ilqr" and isinstance(value, ModuleType):  # as the import system sets it
            value = value.ilqr
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
