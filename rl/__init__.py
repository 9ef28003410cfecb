"""Learners for the inverted double pendulum on a cart."""

from dpend.deprecation import renamed_exports

from .deep import DeepLearner, train_deep
from .identify_plan import IdentifyAndPlan, PlannedPolicy
from .linear_q import LinearQLearning
from .lspi import LSPI, QuadraticQLearning
from .model_based import ModelBased, ModelPolicy
from .natural_qac import NaturalQAC
from .policies import GainPolicy, LinearQPolicy, MLPPolicy, Network, TableOneMean, load_policy
from .qac import GaussianQAC
from .recipes import DeepRecipe
from .training import Cost, Learner, Outcome, Snapshot, Training

__all__ = [
    "LSPI",
    "Cost",
    "DeepLearner",
    "DeepRecipe",
    "GainPolicy",
    "GaussianQAC",
    "IdentifyAndPlan",
    "Learner",
    "LinearQLearning",
    "LinearQPolicy",
    "MLPPolicy",
    "ModelBased",
    "ModelPolicy",
    "NaturalQAC",
    "Network",
    "Outcome",
    "PlannedPolicy",
    "QuadraticQLearning",
    "Snapshot",
    "TableOneMean",
    "Training",
    "load_policy",
    "train_deep",
]

__getattr__ = renamed_exports(
    __name__, dict.fromkeys(("DeepTraining", "LSPITraining", "QACTraining"), "Training"), globals()
)
