"""Learners for the inverted double pendulum on a cart."""

from .linear_q import LinearQLearning, Outcome, Training
from .policies import LinearQPolicy, MLPPolicy, Network, load_policy

__all__ = ["LinearQLearning", "LinearQPolicy", "MLPPolicy", "Network", "Outcome", "Training", "load_policy"]
