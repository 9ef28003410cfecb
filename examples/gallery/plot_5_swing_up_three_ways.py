"""
Swing-up three ways
===================

By energy, by planning, by learning: three ways from hanging to upright, each with the same force and the same
track.
"""

from typing import Any

import matplotlib.pyplot as plt

import dpend
from controllers import ILQRMPC, EnergyPump, SwitchingController
from dpend.draw import BLUE, GREEN, VERMILLION, draw_strobe
from rl import load_policy

rig = dpend.rig("gustafsson2016")
task = dpend.SwingUp(steps=300)
hanging = dpend.EQUILIBRIA["down-down"]

# %%
# The first pumps energy and hands over to LQR where a simulation says that LQR will hold. The second plans 1.5 s
# ahead in every sample. The third is a network that was trained once, without a model.

laws = {
    "energy, then LQR": (SwitchingController(rig, EnergyPump(rig)), BLUE),
    "planning, iLQR MPC": (ILQRMPC(rig), GREEN),
    "learned, DDPG": (load_policy("ddpg-swing-up"), VERMILLION),
}
runs = {name: dpend.simulate(rig, law, hanging, task=task) for name, (law, _) in laws.items()}

places: list[Any] = [list(runs), ["force"] * 3]
fig, axes = plt.subplot_mosaic(places, figsize=(10, 6), height_ratios=(3, 2), layout="constrained")
for name, run in runs.items():
    draw_strobe(axes[name], run.x[:120], rig)
    up = f"up at {run.time_up:.2f} s" if run.success else "not up within 6 s"
    axes[name].set_title(f"{name}: {up}")
    axes["force"].plot(run.t[:-1], run.u, color=laws[name][1], label=name, lw=1)
axes["force"].set(xlabel="time, s", ylabel="force, N")
axes["force"].legend(loc="upper right")
plt.show()

# %%
# One run proves little. :doc:`/swing-up` has 200 starts of each, wrong plants, sensors and transfers between all
# four equilibria.
