"""Draw from which angles at rest LQR saves the pendulum, what the limits allow, and where LQR saturates at once."""

import matplotlib.pyplot as plt
import numpy as np

import dpend
from controllers import LQR
from dpend.draw import BLUE, DARK, GREEN, GREY
from studies._boundary import kept_boundary

rig = dpend.rig("gustafsson2016")
lqr = LQR(rig)
angles = np.linspace(-0.8, 0.8, 65)
th1, th2 = np.meshgrid(angles, angles)
starts = np.zeros((th1.size, 6))
starts[:, 1], starts[:, 2] = th1.ravel(), th2.ravel()
saved = dpend.simulate_many(rig, lqr, starts, task=dpend.Balance(lam=0.8)).success.reshape(th1.shape)
savable = kept_boundary().savable(starts).reshape(th1.shape)

fig, ax = plt.subplots(figsize=(5.6, 5.2))
ax.contourf(th1, th2, saved, levels=[0.5, 1.5], colors=[BLUE], alpha=0.35)
ax.contour(th1, th2, savable, levels=[0.5], colors=[GREEN], linewidths=2)
asked = (starts @ -lqr.K[0]).reshape(th1.shape)
ax.contour(th1, th2, asked, levels=[-rig.force_limit, rig.force_limit], colors=[DARK], linewidths=1, linestyles="--")
ax.axhline(0, color=GREY, lw=0.5)
ax.axvline(0, color=GREY, lw=0.5)
for colour, label in ((BLUE, "LQR saves"), (GREEN, "can be saved"), (DARK, "LQR asks for ±40 N")):
    ax.plot([], [], color=colour, lw=6 if colour == BLUE else 2, ls="--" if colour == DARK else "-", label=label)
ax.legend(loc="upper left")
ax.set(xlabel=r"$\theta_1$ at rest, rad", ylabel=r"$\theta_2$ at rest, rad", aspect="equal")
fig.tight_layout()
