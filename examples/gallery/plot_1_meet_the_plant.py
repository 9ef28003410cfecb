"""
Meet the plant
==============

How does a double pendulum on a cart move when nobody holds it? We let it fall from almost upright, twice, and see
why it is hard: two starts that differ by a tenth of a degree soon have nothing in common.
"""

import matplotlib.pyplot as plt
import numpy as np

import dpend
from dpend.draw import BLUE, VERMILLION, draw_strobe

# %%
# A rig is a plant with its clock and its limits. This is the one of the report: two rods of 1 m on a cart of 1 kg.

rig = dpend.rig("gustafsson2016")
print(rig)

# %%
# Nobody pushes: the law returns zero. ``task=None`` lets the run go on after both links have fallen.

start = np.array([0, 0.05, 0.0, 0, 0, 0])
near = start + np.array([0, np.radians(0.1), 0, 0, 0, 0])
free = rig.replace(track_limit=np.inf)
first, second = (dpend.simulate(free, lambda t, x: 0.0, x0, duration=6.0, task=None) for x0 in (start, near))

fig, (left, right) = plt.subplots(1, 2, figsize=(10, 4), width_ratios=(2, 3))
draw_strobe(left, first.x[:80], free)
left.set(title="the first 1.6 s", xlabel="m", ylabel="m")
for run, colour, name in ((first, BLUE, "one start"), (second, VERMILLION, "the other, 0.1° beside it")):
    right.plot(run.t, run.x[:, 2], color=colour, label=name)
right.set(title="angle of link 2", xlabel="time, s", ylabel="rad")
right.legend()
fig.tight_layout()
plt.show()

# %%
# Without force and friction energy is kept. How well it is tells how far the integrator can be trusted:

energy = dpend.energies(first.x, rig.params).total
print(f"energy drifts by {np.ptp(energy) / abs(energy[0]):.1e} of itself")

# %%
# **Try**: ``rig.replace(joint1_friction=0.05, joint2_friction=0.05)``. How long does it take to come to rest, and
# where?
