"""dpend: the inverted double pendulum on a cart, for classical control and reinforcement learning side by side.

The state is ``x = (pos, th1, th2, vel, om1, om2)`` in metres, radians and seconds; angles are absolute, zero is up, and
positive leans towards positive positions.  Importing ``dpend`` registers ``dpend/Balance-v0``, ``dpend/SwingUp-v0``
and, as the shipped deep policies saw them, ``dpend/BalanceShaped-v0`` and ``dpend/SwingUpShaped-v0`` with Gymnasium; it
loads nothing heavier than numpy and Gymnasium.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

import gymnasium

from .controller import Act, Controller, LawError
from .identify import Identified, identify
from .linear import discretize, linearize
from .params import Params
from .plant import energies, positions, rates, reference
from .rig import Rig, rig, rigs
from .run import Run, Runs
from .simulate import simulate, simulate_many
from .state import EQUILIBRIA, NAMES, nearest_upright, wrap
from .status import Status
from .stepper import Stepper
from .tasks import Balance, SwingUp, Task

if TYPE_CHECKING:
    from .check import check_controller, check_learner

__version__ = "0.1.0"

__all__ = [
    "EQUILIBRIA",
    "NAMES",
    "Act",
    "Balance",
    "Controller",
    "Identified",
    "LawError",
    "Params",
    "Rig",
    "Run",
    "Runs",
    "Status",
    "Stepper",
    "SwingUp",
    "Task",
    "check_controller",
    "check_learner",
    "discretize",
    "energies",
    "identify",
    "linearize",
    "nearest_upright",
    "positions",
    "rates",
    "reference",
    "rig",
    "rigs",
    "simulate",
    "simulate_many",
    "wrap",
]

for _id, _name in (
    ("Balance", "balance"),
    ("SwingUp", "swing_up"),
    ("BalanceShaped", "balance_shaped"),
    ("SwingUpShaped", "swing_up_shaped"),
):
    gymnasium.register(
        f"dpend/{_id}-v0", entry_point=f"dpend.env:{_name}", vector_entry_point=f"dpend.vector_env:{_name}_vector"
    )


def __getattr__(name: str) -> Any:
    if name not in ("check", "check_controller", "check_learner"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = import_module(".check", __name__)  # which python -m dpend.check must be the first to load
    return module if name == "check" else getattr(module, name)
