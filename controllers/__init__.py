"""Classical controllers for the inverted double pendulum on a cart."""

from dpend.deprecation import renamed_exports

from .constant import Constant, Zero
from .data import shipped
from .energy import EnergyPump, EnergySwingUp
from .estimators import EKF, UKF, Differences, Predictor, WithEstimator
from .ilqr import ILQRMPC, ilqr
from .lqr import LQR, BangBang, Margins
from .nmpc import NMPC
from .sdre import SDRE
from .smoothing import LowPass, RateLimit
from .switching import Ellipsoid, NearEnergy, RolloutRegion, SwitchingController
from .trajectory import Trajectory
from .trajopt import NoTrajectory, optimize, violations
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
    "LowPass",
    "Margins",
    "NearEnergy",
    "NoTrajectory",
    "Predictor",
    "RateLimit",
    "RolloutRegion",
    "SwitchingController",
    "Trajectory",
    "WithEstimator",
    "Zero",
    "ilqr",
    "optimize",
    "shipped",
    "violations",
]

__getattr__ = renamed_exports(
    __name__, {"Ahead": "RolloutRegion", "Catch": "SwitchingController", "faults": "violations"}, globals()
)
