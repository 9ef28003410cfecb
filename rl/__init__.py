"""Learners for the inverted double pendulum on a cart."""

from .deep import DeepRecipe, DeepTraining, train_deep
from .gaussian_qac import GaussianQAC, QACTraining
from .linear_q import LinearQLearning, Outcome, Training
from .lspi import LSPI, LSPITraining, QuadraticQLearning
from .policies import GainPolicy, LinearQPolicy, MLPPolicy, Network, load_policy

__all__ = [
    "LSPI",
    "DeepRecipe",
    "DeepTraining",
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
    "train_deep",
]
