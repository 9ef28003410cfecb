"""
Bang-bang or smooth
===================

The report's Q-learning always pushes with full force. Is that what balancing takes? Beside it a learner with one
more feature, the square of the action, which needs no more than a look at the same plant.
"""

import matplotlib.pyplot as plt
import numpy as np

import dpend
from dpend.draw import GREEN, VERMILLION
from rl import LSPI, LinearQLearning

rig = dpend.rig("gustafsson2016")
laws = {
    "Q-learning, Table 1": (LinearQLearning.tuned(rig).train(seed=0).policy, VERMILLION),
    "LSPI, with a²": (LSPI(rig).train(seed=0).policy, GREEN),
}

# %%
# The same start for both, then the same 500.

task = dpend.Balance(lam=0.2)
starts = task.starts(np.random.default_rng(0), 500, rig)
fig, axes = plt.subplots(2, 2, figsize=(10, 5), sharex=True)
for (name, (law, colour)), column in zip(laws.items(), axes.T, strict=True):
    run = dpend.simulate(rig, law, x0=[0, 0.1, 0.1, 0, 0, 0], duration=2.0)
    column[0].plot(run.t, run.x[:, 1:3], color=colour)
    column[0].set(title=name, ylim=(-0.25, 0.25))
    column[1].step(run.t[:-1], run.u, where="post", color=colour)
    column[1].set(xlabel="time, s", ylim=(-44, 44))
    saved = dpend.simulate_many(rig, law, starts, task=task).success.mean()
    variation = run.metrics()["variation"]
    print(f"{name}: {saved:.1%} of 500 starts saved, force varies {variation:.2g} limits a second")
axes[0, 0].set_ylabel("both angles, rad")
axes[1, 0].set_ylabel("force, N")
fig.tight_layout()
plt.show()

# %%
# Why no training can make the first one smooth takes three lines: see :doc:`/learn/bang-bang`.
