"""
Identify a rig from a recording
===============================

A laboratory has encoders, a force, and a plant whose masses and frictions nobody knows. How well does a recording
of ten seconds tell them, and does a controller designed for the result work on the true plant?
"""

import matplotlib.pyplot as plt
import numpy as np

import dpend
from controllers import LQR
from dpend.draw import BLUE, VERMILLION

# %%
# The laboratory, played by a simulation: other masses, friction, encoders of 4096 counts a turn, a cart that is
# shaken.

nominal = dpend.rig("gustafsson2016")
step = 2 * np.pi / 4096
lab = nominal.replace(
    mass1=0.56, mass2=0.45, cart_friction=0.8, joint1_friction=0.02, resolution=(1e-4, step, step, 0, 0, 0)
)


def shake(t: float, y: np.ndarray) -> float:
    """Return a force of two frequencies, and a weak spring that keeps the cart about."""
    return float(12 * np.sin(4.4 * t) + 8 * np.sin(12 * t + 1) - 10 * y[0])


recorded = dpend.simulate(lab, shake, [0, np.pi + 0.3, np.pi - 0.2, 0, 0, 0], duration=10.0, task=None)

# %%
# ``identify`` fits simulated segments to what was measured.

names = ["mass1", "mass2", "cart_friction", "joint1_friction", "joint2_friction"]
found = dpend.identify(recorded, nominal, names)
print(found)

true = [getattr(lab.params, name) for name in names]
fig, ax = plt.subplots(figsize=(7, 3.2))
for k, name in enumerate(names):
    low, high = found.intervals[name]
    ax.plot([low - true[k], high - true[k]], [k, k], color=BLUE, lw=3)
    ax.plot(found.values[name] - true[k], k, "o", color=BLUE)
ax.axvline(0, color=VERMILLION, lw=1, label="true")
ax.set(yticks=range(len(names)), yticklabels=names, xlabel="found less true, with 95 % intervals, SI units")
ax.legend()
fig.tight_layout()
plt.show()

# %%
# The rig that was found is a rig like any other: design for it, and try on the true one.

law = LQR(nominal.replace(params=found.params))
run = dpend.simulate(lab, law, [0, 0.1, -0.1, 0, 0, 0], duration=6.0)
print(run.status.value)
