"""
Lab 2: solution
===============

One way through :doc:`lab_2_learn_it`.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import binomtest

import dpend
from controllers import LQR
from dpend.draw import BLUE, GREEN, VERMILLION
from rl import LSPI, LinearQLearning

rig = dpend.rig("gustafsson2016")
task = dpend.Balance(lam=0.2)
starts = task.starts(np.random.default_rng(0), 500, rig)


def saved(law: dpend.Controller) -> float:
    """Return the share of the starts that a law saves."""
    return float(dpend.simulate_many(rig, law, starts, task=task).success.mean())


# %%
# **Tasks 1 and 2.** Two forces, ±40 N: a straight line over the actions is greatest at an end. With a² the action
# value is a parabola, and its top a linear law.

x0 = [0, 0.1, 0.1, 0, 0, 0]
bang = LinearQLearning.tuned(rig).train(seed=0).policy
smooth = LSPI(rig).train(seed=0).policy
exact = LQR(rig, Q=[1, 10, 10, 1, 1, 1], R=0.1, discount=0.99)
runs = {
    "Q-learning, Table 1": dpend.simulate(rig, bang, x0, duration=2.0),
    "LSPI": dpend.simulate(rig, smooth, x0, duration=2.0),
    "LQR, discounted": dpend.simulate(rig, exact, x0, duration=2.0),
}
fig, ax = plt.subplots(figsize=(8, 3.2))
for (name, run), colour in zip(runs.items(), (VERMILLION, GREEN, BLUE), strict=True):
    ax.step(run.t[:-1], run.u, where="post", color=colour, label=name, lw=1)
    print(f"{name}: forces {len(np.unique(run.u.round(6)))}, variation {run.metrics()['variation']:.2g} limits/s")
ax.set(xlabel="time, s", ylabel="force, N")
ax.legend()
fig.tight_layout()
plt.show()
print(f"gain off by {np.linalg.norm(smooth.K - exact.K[0]) / np.linalg.norm(exact.K):.1%}")

# %%
# **Task 3.** With half of the samples and a third of the iterations some trainings end at a gain that does not
# hold. The training is the unit: a thousand starts of one policy say how good that policy is, and nothing about the
# next training.

short = LSPI(rig, iterations=30, samples=60)
shares = np.array([saved(short.train(seed=seed).policy) for seed in range(10)])
good = int((shares > 0.9).sum())
interval = binomtest(good, len(shares)).proportion_ci(method="wilson")
print(f"{good} of {len(shares)} trainings save more than 90 %: {good / len(shares):.0%} of such trainings,")
print(f"95 % interval {interval.low:.0%} to {interval.high:.0%}; all of them:")
print(np.sort(shares).round(2))

# %%
# **Task 4.** For instance: "On gustafsson2016, from 500 starts with both angles within 0.2 rad, the same for both,
# LSPI from 120 s of experience near upright saves as many as the discounted LQR of the same weights, which had the
# equations (paired difference below, one training). It knew the cost, the sample time and where upright is."
# What to attack: one training, one plant, perfect sensors, and that the starts of learning were chosen near
# upright.

a, b = (dpend.simulate_many(rig, law, starts, task=task).success for law in (smooth, exact))
print(f"{a.mean():.1%} and {b.mean():.1%}; starts on which they disagree: {int((a != b).sum())}")
