"""Classical controllers for the inverted double pendulum on a cart."""

from .constant import Constant, Zero
from .data import shipped
from .energy import EnergyPump, EnergySwingUp
from .estimators import EKF, UKF, Differences, Predictor, WithEstimator
from .ilqr import ILQRMPC, ilqr
from .lqr import LQR, BangBang, Margins
from .nmpc import NMPC
from .sdre import SDRE
from .smoothing import LowPass, RateLimit
from .switching import Ahead, Catch, Ellipsoid, NearEnergy
from .trajectory import Trajectory
from .trajopt import NoTrajectory, faults, optimize
from .tvlqr import TVLQR

__all__ = [
    "EKF",
    "ILQRMPC",
    "LQR",
    "NMPC",
    "SDRE",
    "TVLQR",
    "UKF",
    "Ahead",
    "BangBang",
    "Catch",
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
    "Trajectory",
    "WithEstimator",
    "Zero",
    "faults",
    "ilqr",
    "optimize",
    "shipped",
]
