"""
Watch it learn
==============

Least-squares policy iteration starts with no gain at all and finds, in two minutes of the plant's time, the gain
that a Riccati equation gives to those who know the plant. What do its policies look like on the way?
"""

import matplotlib.pyplot as plt
import numpy as np

import dpend
from controllers import LQR
from dpend.draw import BLUE, GREEN, GREY
from rl import LSPI

rig = dpend.rig("gustafsson2016")
learner = LSPI(rig)
training = learner.train(seed=1)
print(training.outcome.value, f"{training.experience:g} s of experience")

# %%
# ``snapshots`` returns policies on the way. Each is a controller, so each can be evaluated: the same 300 starts for
# all.

exact = LQR(rig, Q=[1, 10, 10, 1, 1, 1], R=0.1, discount=0.99).K[0]
task = dpend.Balance(lam=0.2)
starts = task.starts(np.random.default_rng(0), 300, rig)
snapshots = training.snapshots(30)
seconds = [each.experience for each in snapshots]
errors = [np.linalg.norm(each.policy.K - exact) / np.linalg.norm(exact) for each in snapshots]
saved = [dpend.simulate_many(rig, each.policy, starts, task=task).success.mean() for each in snapshots]

fig, ax = plt.subplots(figsize=(8, 4))
ax.semilogy(seconds, errors, "o-", color=BLUE)
ax.set(xlabel="experience, s", ylabel="distance from the Riccati gain, of its norm")
ax.yaxis.label.set_color(BLUE)
beside = ax.twinx()
beside.plot(seconds, 100 * np.array(saved), "s-", color=GREEN)
beside.set_ylabel("starts saved at λ = 0.2, %")
beside.yaxis.label.set_color(GREEN)
ax.axhline(0.05, color=GREY, lw=1, ls=":")
fig.tight_layout()

# %%
# Success comes before precision: a gain that is a third off already saves most starts. :doc:`/lspi` has thirty
# trainings, and what fails.
