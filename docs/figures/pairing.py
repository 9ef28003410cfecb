"""Draw how wide the interval of a difference is, with the same starts for both laws and with starts of their own."""

import matplotlib.pyplot as plt
import numpy as np

import dpend
from controllers import LQR
from dpend.draw import BLUE, VERMILLION

rig = dpend.rig("gustafsson2016")
task = dpend.Balance(lam=0.3)
starts = task.starts(np.random.default_rng(0), 20_000, rig)
first, second = (
    dpend.simulate_many(rig, law, starts, task=task).success.astype(float)
    for law in (LQR(rig), LQR(rig, Q=[1, 10, 10, 1, 1, 1], R=0.1))
)
counts = np.geomspace(50, len(starts), 60)
apart = 1.96 * np.sqrt((first.var() + second.var()) / counts)
paired = 1.96 * np.sqrt((second - first).var() / counts)
fig, ax = plt.subplots(figsize=(6.4, 3.6))
ax.loglog(counts, 100 * apart, color=VERMILLION, label="starts of their own")
ax.loglog(counts, 100 * paired, color=BLUE, label="the same starts")
ax.axhline(100 * abs((second - first).mean()), color="black", lw=1, ls="--", label="the difference itself")
ax.set(xlabel="starts for each law", ylabel="half of the 95 % interval, points")
ax.legend()
ax.grid(alpha=0.3, which="both")
fig.tight_layout()
