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
from dpend.draw import BLUE, GREEN
from rl import LSPI, GainPolicy

rig = dpend.rig("gustafsson2016")
learner = LSPI(rig)
training = learner.train(seed=1)
print(training.outcome.value, f"{training.experience:g} s of experience")

# %%
# ``details`` has the gain after each iteration. Each is a policy, and a policy is a controller, so each can be
# evaluated: the same 300 starts for all. (``training.snapshots(n)`` returns ``n`` such policies of any learner.)

exact = LQR(rig, Q=[1, 10, 10, 1, 1, 1], R=0.1, discount=0.99).K[0]
task = dpend.Balance(lam=0.2)
starts = task.starts(np.random.default_rng(0), 300, rig)
gains = training.details["gains"]
seconds = training.details["samples"] * rig.sample_time
errors = np.linalg.norm(gains - exact, axis=1) / np.linalg.norm(exact)
saved = [dpend.simulate_many(rig, GainPolicy(K), starts, task=task).success.mean() for K in gains]

fig, ax = plt.subplots(figsize=(8, 4))
ax.semilogy(seconds, errors, ".-", color=BLUE)
ax.set(xlabel="experience, s", ylabel="distance from the Riccati gain, of its norm")
ax.yaxis.label.set_color(BLUE)
beside = ax.twinx()
beside.plot(seconds, 100 * np.array(saved), ".-", color=GREEN)
beside.set_ylabel("starts saved at λ = 0.2, %")
beside.yaxis.label.set_color(GREEN)
fig.tight_layout()
plt.show()

# %%
# For eighty seconds nothing is saved: while the discount is small, no gain is worth its force. Then it happens within a
# few iterations, and a gain that is still a fifth off saves all of these starts. :doc:`/lspi` has thirty trainings, and
# what fails.
