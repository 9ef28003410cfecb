"""Draw both growing modes, and where sampling and LQR put the poles."""

import matplotlib.pyplot as plt
import numpy as np

import dpend
from controllers import LQR
from dpend.draw import BLUE, DARK, GREEN, GREY, VERMILLION

rig = dpend.rig("gustafsson2016")
rates, modes = np.linalg.eig(dpend.linearize(rig.params)[0])
fig, axes = plt.subplots(1, 3, figsize=(9.2, 3.6), width_ratios=(1, 1, 1.35))
growing = [k for k in np.argsort(-rates.real) if rates[k].real > 1e-6]
for ax, k, title in zip(axes, growing, ("fast", "slow"), strict=False):
    mode = modes[:, k].real / np.abs(modes[1:3, k]).max() * np.sign(modes[2, k].real)
    for size, alpha in ((0.0, 0.25), (0.45, 1.0)):
        x = size * mode
        xj, yj, xt, yt = dpend.positions(x, rig.params)
        ax.plot([x[0], xj], [0, yj], color=BLUE, lw=5, alpha=alpha, solid_capstyle="round")
        ax.plot([xj, xt], [yj, yt], color=VERMILLION, lw=5, alpha=alpha, solid_capstyle="round")
        ax.plot(x[0], 0, "s", ms=13, color=DARK, alpha=alpha)
    ax.axhline(-0.12, color=GREY, lw=1)
    ax.set(xlim=(-1, 1), ylim=(-0.3, 2.15), aspect="equal")
    ax.set_title(f"{title}: $s$ = {rates[k].real:.2f} s$^{{-1}}$")
    ax.axis("off")
ax = axes[2]
turn = np.exp(1j * np.linspace(0, 2 * np.pi, 200))
ax.plot(turn.real, turn.imag, color=GREY, lw=1)
held = np.exp(rates * rig.sample_time)
closed = LQR(rig).poles
ax.plot(held.real, held.imag, "x", ms=9, mew=2, color=VERMILLION, label="plant, held")
ax.plot(closed.real, closed.imag, "o", ms=7, mfc="none", mew=2, color=GREEN, label="with LQR")
ax.set(xlim=(0.8, 1.2), ylim=(-0.2, 0.2), aspect="equal", xlabel="Re $z$", ylabel="Im $z$")
ax.set_title("poles of one sample")
ax.legend(loc="upper right", fontsize=9)
fig.tight_layout()
