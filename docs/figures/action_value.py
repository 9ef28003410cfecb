"""Draw action values over the action: lines for the report's features, parabolas with the square of the action."""

import matplotlib.pyplot as plt
import numpy as np

import dpend
from controllers import LQR
from dpend.draw import BLUE, GREEN, VERMILLION
from rl import load_policy
from rl.features import make_value_features, slope_features

rig = dpend.rig("gustafsson2016")
states = np.array([[0, 0.05, 0.02, 0, 0, 0], [0, 0.02, 0.05, 0, 0, 0], [0, 0.06, -0.03, 0, 0, 0]])
colours = BLUE, VERMILLION, GREEN
actions = np.linspace(-rig.force_limit, rig.force_limit, 201)
fig, axes = plt.subplots(1, 2, figsize=(9, 3.5))

policy = load_policy("q-tuned")
weights = policy.weights * policy.scales
for x, colour in zip(states, colours, strict=True):
    slope = np.dot(slope_features(x), weights[12:])
    value = np.dot(make_value_features()(x), weights[:12]) + actions * slope
    axes[0].plot(actions, value - value.max(), color=colour)
    axes[0].plot(policy.forces, np.interp(policy.forces, actions, value - value.max()), ".", color=colour)
    axes[0].plot(actions[value.argmax()], 0, "o", color=colour, ms=9)
axes[0].set_title("Table 1: constant and linear in $a$")

lqr = LQR(rig, discount=0.99)
plant = np.hstack(dpend.discretize(*dpend.linearize(rig.params), rig.sample_time))
H = np.eye(7) + 0.99 * plant.T @ lqr.P @ plant
for x, colour in zip(states, colours, strict=True):
    z = np.column_stack([np.tile(x, (len(actions), 1)), actions])
    value = -np.einsum("ni,ij,nj->n", z, H, z)
    axes[1].plot(actions, value - value.max(), color=colour)
    axes[1].plot(actions[value.argmax()], 0, "o", color=colour, ms=9)
axes[1].set_title("with the products of state and action")
for ax in axes:
    ax.set(xlabel="action $a$, N", ylabel=r"$\hat q(s, a) - \max_a \hat q(s, a)$")
fig.tight_layout()
