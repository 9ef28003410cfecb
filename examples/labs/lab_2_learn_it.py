"""
Lab 2: learn it
===============

A learner gets no equations: it acts, sees what happens, and has to find a law. At the end you will know what the
features decide, how many trainings a statement takes, and how to compare a learner with a design.
"""

import numpy as np

import dpend
from rl import LSPI, LinearQLearning

rig = dpend.rig("gustafsson2016")
task = dpend.Balance(lam=0.2)
starts = task.starts(np.random.default_rng(0), 500, rig)


def saved(law: dpend.Controller) -> float:
    """Return the share of the starts that a law saves."""
    return float(dpend.simulate_many(rig, law, starts, task=task).success.mean())


# %%
# Task 1: one training
# --------------------
#
# Train the report's Q-learning, tuned, from one seed, and look at its force over two seconds. How many different
# forces does it use? Why these?
#
# *Hint*: all features are constant or linear in the action. Where is a straight line greatest?

training = LinearQLearning.tuned(rig).train(seed=0)
print(training.outcome.value, training.cost.episodes, "episodes")

# %%
# Task 2: one more feature
# ------------------------
#
# Train ``LSPI(rig)``, whose features have the square of the action. Compare its gain with ``LQR(rig, Q=[1, 10, 10,
# 1, 1, 1], R=0.1, discount=0.99)``, and its force with that of task 1 (``run.metrics()["variation"]``).

print(LSPI(rig).train(seed=0).policy.K.round(1))

# %%
# Task 3: how many trainings?
# ---------------------------
#
# Shorten the experience (``LSPI(rig, iterations=..., samples=...)``; ``help(LSPI)`` has all settings) until some
# trainings fail. Train from ten seeds, and give the share that succeeds with its 95 % interval. What is the unit of
# replication, the start or the training?

shares = [saved(LSPI(rig).train(seed=seed).policy) for seed in range(3)]  # task: more seeds, less experience
print([f"{share:.1%}" for share in shares])

# %%
# Task 4: a fair sentence
# -----------------------
#
# Write one sentence that compares LSPI with LQR, with the starts, the seeds, the interval and what each knew
# beforehand. Then let a neighbour try to refute it.
