"""Classical controllers for the inverted double pendulum on a cart."""

from .constant import Constant, Zero
from .lqr import LQR, BangBang, Margins

__all__ = ["LQR", "BangBang", "Constant", "Margins", "Zero"]
