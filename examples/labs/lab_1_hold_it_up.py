"""
Lab 1: hold it up
=================

You are given the plant, a clock of 20 ms and 40 N. At the end you will have a law of your own, you will know how
late it may be, and you will know what it costs to be in a hurry. Cells marked *task* are yours to change;
everything runs as it stands.
"""

import matplotlib.pyplot as plt
import numpy as np

import dpend
from controllers import LinearLaw
from dpend.draw import BLUE

rig = dpend.rig("gustafsson2016")
task = dpend.Balance(lam=0.1)
starts = task.starts(np.random.default_rng(0), 200, rig)


def saved(law: dpend.Controller, on: dpend.Rig = rig) -> float:
    """Return the share of the starts that a law saves."""
    return float(dpend.simulate_many(on, law, starts, task=task).success.mean())


# %%
# Task 1: how much time is there?
# -------------------------------
#
# Let the plant fall from angles of 0.01 and −0.01 rad, and plot the logarithm of link 2's angle. Read off the rate at
# which it grows, and compare it with the eigenvalues of ``dpend.linearize(rig.params)``. How many samples does the
# faster mode take to double? What changes if both links lean to the same side?
#
# *Hint*: a straight line on a logarithmic axis is an exponential; its slope is the growing mode that dominates.

fall = dpend.simulate(rig, lambda t, x: 0.0, [0, 0.01, -0.01, 0, 0, 0], duration=0.6, task=None)
fig, ax = plt.subplots(figsize=(6, 3))
ax.semilogy(fall.t, abs(fall.x[:, 2]), color=BLUE)
ax.set(xlabel="time, s", ylabel="angle of link 2, rad")
fig.tight_layout()
plt.show()

# %%
# Task 2: one angle is not enough
# -------------------------------
#
# Try gains on θ1 alone. Can any of them save a start? Say why, from the characteristic polynomial.
#
# *Hint*: with u = k θ1 and no friction it is a polynomial in s².

for k in (100, 300, 1000):  # task: others
    print(k, saved(LinearLaw([0, -k, 0, 0, 0, 0])))

# %%
# Task 3: six numbers
# -------------------
#
# Choose Q and R, compute the gain with the Riccati equation, and save at least 199 of the 200 starts. Do not use
# ``controllers.LQR`` yet: write the recursion P ← Q + Aᵀ P (A − B K), K = (R + Bᵀ P B)⁻¹ Bᵀ P A for the sampled
# plant.

A, B = dpend.discretize(*dpend.linearize(rig.params), rig.sample_time)
K = np.zeros((1, 6))  # task: your gain
print("saved:", saved(LinearLaw(K[0])))

# %%
# Task 4: how late may it be?
# ---------------------------
#
# For R from 0.01 to 100, compute the delay margin (``LQR(rig, R=R).margins().delay_samples``) and the share saved
# on ``rig.replace(sensor_delay=1)`` and with a delay of 2. Plot both over R. Which weights would you choose if you
# knew that the camera is one sample late?
#
# Task 5: what is it worth?
# -------------------------
#
# Compare your law with ``LQR(rig)`` at λ = 0.3, on the same 1000 starts, and say whether the difference is more
# than luck.
#
# *Hint*: count the starts on which the two disagree; ``scipy.stats.binomtest``.
