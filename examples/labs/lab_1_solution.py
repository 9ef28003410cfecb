"""
Lab 1: solution
===============

One way through :doc:`lab_1_hold_it_up`.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import binomtest

import dpend
from controllers import LQR, LinearLaw
from dpend.draw import BLUE, GREEN, VERMILLION

rig = dpend.rig("gustafsson2016")
task = dpend.Balance(lam=0.1)
starts = task.starts(np.random.default_rng(0), 200, rig)


def saved(law: dpend.Controller, on: dpend.Rig = rig) -> float:
    """Return the share of the starts that a law saves."""
    return float(dpend.simulate_many(on, law, starts, task=task).success.mean())


# %%
# **Task 1.** Links that lean apart fall in the fast mode. If they lean alike, link 2 first swings to the other side:
# the slow mode has to grow before the fast one takes over.

modes = np.sort(np.linalg.eigvals(dpend.linearize(rig.params)[0]).real)[-2:]
doubling = np.log(2) / modes / rig.sample_time
print(f"modes {modes.round(2)} 1/s; they double in {doubling.round(1)} samples")
fall = dpend.simulate(rig, lambda t, x: 0.0, [0, 0.01, -0.01, 0, 0, 0], duration=0.6, task=None)
late_enough = slice(10, 20)
slope = np.polyfit(fall.t[late_enough], np.log(abs(fall.x[late_enough, 2])), 1)[0]
print(f"slope between 0.2 and 0.4 s: {slope:.2f} 1/s")

# %%
# **Task 2.** None. Without friction the equations are D₀ q̈ = M q with u = k θ1 in M, so the characteristic
# polynomial is one in s², and with each root s comes −s: they cannot all lie on the left.

print({k: saved(LinearLaw([0, -k, 0, 0, 0, 0])) for k in (100, 300, 1000, 3000)})

# %%
# **Task 3.** The recursion settles within a few hundred steps.

A, B = dpend.discretize(*dpend.linearize(rig.params), rig.sample_time)
Q, R = np.diag([1.0, 10, 10, 1, 1, 1]), 0.1
P, K = Q, np.zeros((1, 6))
for _ in range(1000):
    K = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
    P = Q + A.T @ P @ (A - B @ K)
mine = LinearLaw(K[0])
print(f"saved: {saved(mine):.1%};  the same as LQR's: {np.allclose(K, LQR(rig, Q=np.diag(Q), R=R).K)}")

# %%
# **Task 4.** Cheap force makes the loop stiff, and a stiff loop bears less delay: two samples are too late where the
# margin is well below two. All of these weights tolerate one sample, unless force costs so much that the law is slow
# anyway.
# Better than a compromise is to give the delay to the design: an estimator that predicts (:doc:`/estimators`).

weights = np.geomspace(0.01, 100, 9)
margins = [LQR(rig, R=float(r)).margins().delay_samples for r in weights]
late = {d: [saved(LQR(rig, R=float(r)), rig.replace(sensor_delay=d)) for r in weights] for d in (1, 2)}
fig, ax = plt.subplots(figsize=(7, 3.6))
ax.semilogx(weights, margins, "o-", color=BLUE, label="delay margin, samples")
for (d, shares), colour in zip(late.items(), (GREEN, VERMILLION), strict=True):
    ax.semilogx(weights, shares, "s--", color=colour, label=f"share saved, {d} late")
ax.set(xlabel="R")
ax.legend()
fig.tight_layout()
plt.show()

# %%
# **Task 5.** Only the starts on which the two disagree say which is better. The exact test of their counts:

hard = dpend.Balance(lam=0.3)
fresh = hard.starts(np.random.default_rng(1), 1000, rig)
a, b = (dpend.simulate_many(rig, law, fresh, task=hard).success for law in (mine, LQR(rig)))
only_mine, only_lqr = int((a & ~b).sum()), int((b & ~a).sum())
test = binomtest(only_mine, only_mine + only_lqr)
print(f"{a.mean():.1%} and {b.mean():.1%}; alone: {only_mine} and {only_lqr}; p = {test.pvalue:.1g}")
