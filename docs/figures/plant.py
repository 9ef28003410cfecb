"""Draw the plant with its symbols."""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Arc, Circle, FancyArrowPatch, Rectangle

from dpend.draw import BLUE, DARK, GREEN, GREY, VERMILLION

th1, th2, cart = np.radians(28), np.radians(-20), np.array([0.9, 0.0])
up1, up2 = (np.array([np.sin(angle), np.cos(angle)]) for angle in (th1, th2))
joint, tip = cart + up1, cart + up1 + up2

fig, ax = plt.subplots(figsize=(6.4, 4.6))
ax.plot([-0.5, 2.5], [-0.16, -0.16], color=GREY, lw=2)
ax.add_patch(Rectangle((cart[0] - 0.22, -0.13), 0.44, 0.22, color=DARK))
for start, end, colour in ((cart, joint, BLUE), (joint, tip, VERMILLION)):
    ax.plot(*np.transpose([start, end]), color=colour, lw=8, solid_capstyle="round", zorder=2)
    ax.plot(*np.transpose([start, np.add(start, (0, 0.72))]), color=GREY, lw=1, ls="--", zorder=1)
    ax.add_patch(Circle(start + (end - start) / 2, 0.035, fc="white", ec=DARK, zorder=4))
for place in (cart, joint):
    ax.add_patch(Circle(place, 0.04, fc="white", ec=DARK, lw=1.5, zorder=4))
ax.add_patch(Arc(cart, 1.1, 1.1, theta1=90 - np.degrees(th1), theta2=90, color=DARK))
ax.add_patch(Arc(joint, 1.1, 1.1, theta1=90, theta2=90 - np.degrees(th2), color=DARK))
ax.text(*np.add(cart, (-0.06, 0.6)), r"$\theta_1 > 0$", fontsize=12, ha="right")
ax.text(*np.add(joint, (0.06, 0.6)), r"$\theta_2 < 0$", fontsize=12)

arrow = {"arrowstyle": "-|>", "mutation_scale": 14, "lw": 1.8}
ax.add_patch(FancyArrowPatch((cart[0] - 0.9, -0.02), (cart[0] - 0.24, -0.02), color=GREEN, **arrow))
ax.text(cart[0] - 0.62, 0.05, "$u$", fontsize=13, color=GREEN)
ax.add_patch(FancyArrowPatch((-0.1, -0.42), (cart[0], -0.42), color=DARK, **arrow))
ax.plot([-0.1, -0.1], [-0.5, -0.1], color=DARK, lw=1)
ax.plot([cart[0]] * 2, [-0.5, -0.2], color=DARK, lw=1, ls=":")
ax.text(0.4, -0.36, "$p$", fontsize=13)
ax.text(cart[0] + 0.28, -0.06, "$m_0$", fontsize=12)
ax.text(*np.add(cart + 0.5 * up1, (0.12, -0.1)), "$m_1,\\ I_1$ at $l_1$ of $L_1$", fontsize=12, color=BLUE)
ax.text(
    *np.add(joint + 0.5 * up2, (-0.12, -0.1)),
    "$m_2,\\ I_2$ at $l_2$ of $L_2$",
    fontsize=12,
    color=VERMILLION,
    ha="right",
)
ax.add_patch(FancyArrowPatch((-0.35, 1.7), (-0.35, 1.2), color=DARK, **arrow))
ax.text(-0.28, 1.42, "$g$", fontsize=13)
ax.set(xlim=(-0.55, 2.55), ylim=(-0.52, 1.95), aspect="equal")
ax.axis("off")
fig.subplots_adjust(0, 0, 1, 1)
