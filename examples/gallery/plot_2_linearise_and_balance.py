"""
Linearise and balance
=====================

Near upright the plant is nearly linear, and one matrix equation gives the gain that holds it. How far from upright
does that gain still work?
"""

import matplotlib.pyplot as plt
import numpy as np

import dpend
from controllers import LQR
from dpend.draw import BLUE, GREY, VERMILLION

rig = dpend.rig("gustafsson2016")
A, B = dpend.linearize(rig.params)
growing = np.sort(np.linalg.eigvals(A).real)[-2:]
print("two modes grow, by a factor of e in", (1 / growing).round(2), "s")

# %%
# The regulator is designed for the sampled plant; every state and the force cost alike.

lqr = LQR(rig, Q=np.eye(6), R=1.0)
print(lqr.K.round(1))
run = dpend.simulate(rig, lqr, x0=[0, 0.2, -0.1, 0, 0, 0], duration=6.0)
print(run.status.value)

fig, (above, below) = plt.subplots(2, 1, figsize=(7, 3.8), sharex=True)
for column, colour, name in ((1, BLUE, "link 1"), (2, VERMILLION, "link 2")):
    above.plot(run.t, run.x[:, column], color=colour, label=name)
above.set_ylabel("angle, rad")
above.legend()
below.step(run.t[:-1], run.u, where="post", color=GREY)
below.set(xlabel="time, s", ylabel="force, N")
fig.tight_layout()

# %%
# Each of the 41 × 41 starts is one row of a batch. The edge of the blue area is not where the law saturates; that
# is where the dashed lines are.

angles = np.linspace(-0.8, 0.8, 41)
th1, th2 = np.meshgrid(angles, angles)
starts = np.zeros((th1.size, 6))
starts[:, 1], starts[:, 2] = th1.ravel(), th2.ravel()
saved = dpend.simulate_many(rig, lqr, starts, task=dpend.Balance(lam=0.8)).success
force = (starts @ -lqr.K[0]).reshape(th1.shape)

fig, ax = plt.subplots(figsize=(5, 4.6))
ax.contourf(th1, th2, saved.reshape(th1.shape), levels=[0.5, 1.5], colors=[BLUE], alpha=0.4)
ax.contour(th1, th2, force, levels=[-rig.force_limit, rig.force_limit], colors=[GREY], linestyles="--")
ax.set(
    xlabel="θ1 at rest, rad", ylabel="θ2 at rest, rad", aspect="equal", title="saved by LQR; dashed: it asks for ±40 N"
)
fig.tight_layout()
plt.show()
