"""Draw energy and cart over three swing-ups: by energy, by planning, by learning."""

import matplotlib.pyplot as plt

import dpend
from controllers import ILQRMPC, EnergyPump, SwitchingController
from dpend.draw import BLUE, GREEN, GREY, VERMILLION
from rl import load_policy

rig = dpend.rig("gustafsson2016")
task = dpend.SwingUp(steps=400)
laws = {
    "pumping energy, then LQR": (SwitchingController(rig, EnergyPump(rig)), BLUE),
    "planning: iLQR MPC": (ILQRMPC(rig), GREEN),
    "learned: DDPG": (load_policy("ddpg-swing-up"), VERMILLION),
}
upright = sum(dpend.energies(dpend.EQUILIBRIA["up-up"], rig.params))
fig, (top, bottom) = plt.subplots(2, 1, figsize=(8, 4.8), sharex=True)
for name, (law, colour) in laws.items():
    run = dpend.simulate(rig, law, dpend.EQUILIBRIA["down-down"], task=task)
    top.plot(run.t, sum(dpend.energies(run.x, rig.params)) / upright, color=colour, label=name)
    bottom.plot(run.t, run.x[:, 0], color=colour)
top.axhline(1, color=GREY, lw=1)
top.set(ylabel="energy, of upright's")
top.legend(fontsize=9)
for end in (-rig.track_limit, rig.track_limit):
    bottom.axhline(end, color=GREY, lw=1)
bottom.set(xlabel="time, s", ylabel="cart, m")
fig.tight_layout()
