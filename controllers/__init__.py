"""Classical controllers for the inverted double pendulum on a cart."""

from .constant import Constant, Zero
from .lqr import LQR, BangBang, Margins
from .trajectory import Trajectory

__all__ = ["LQR", "BangBang", "Constant", "Margins", "Trajectory", "Zero"]
