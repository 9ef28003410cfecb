"""Learners for the inverted double pendulum on a cart."""

from .gaussian_qac import GaussianQAC, QACTraining
from .linear_q import LinearQLearning, Outcome, Training
from .lspi import LSPI, LSPITraining, QuadraticQLearning
from .policies import GainPolicy, LinearQPolicy, MLPPolicy, Network, load_policy

__all__ = [
    "LSPI",
    "GainPolicy",
    "GaussianQAC",
    "LSPITraining",
    "LinearQLearning",
    "LinearQPolicy",
    "MLPPolicy",
    "Network",
    "Outcome",
    "QACTraining",
    "QuadraticQLearning",
    "Training",
    "load_policy",
]
