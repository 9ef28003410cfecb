"""
Hardware conventions
====================

Your rig counts angles from hanging, in degrees, the second against the first link; its drive takes an acceleration,
or a voltage. How do such rigs map to the state and the force used here? Each line below is one convention, and a
run shows that nothing is lost.
"""

import matplotlib.pyplot as plt
import numpy as np

import dpend
from controllers import LQR
from dpend.draw import BLUE, GREEN, VERMILLION

rig = dpend.rig("gustafsson2016")
lqr = LQR(rig)
x0 = np.array([0, 0.1, -0.05, 0, 0, 0])

# %%
# **Angles.** Here they are absolute, in radians, zero is up. From a rig that counts degrees from hanging, the
# second angle relative to link 1:


def from_hanging(q: np.ndarray) -> np.ndarray:
    """Return the state of (pos, φ1, φ2, and their rates), φ in degrees, φ1 from hanging, φ2 against link 1."""
    pos, phi1, phi2, vel, rate1, rate2 = q
    th1 = np.radians(phi1) - np.pi
    return np.array([pos, th1, th1 + np.radians(phi2), vel, np.radians(rate1), np.radians(rate1 + rate2)])


print(from_hanging(np.array([0, 180, 0, 0, 0, 0])), "is upright,", from_hanging(np.zeros(6)).round(3), "hanging")

# %%
# For recordings ``Run.from_csv(..., angle_unit="deg", zero="down", relative=True)`` does the same
# (:doc:`/identify`).
#
# **Acceleration drive.** A stiff drive makes the cart follow a commanded acceleration. The force behind it follows
# from the equations: the cart's acceleration is α(x) + β(x) F, so F = (a − α)/β.


def force_for(acceleration: float, x: np.ndarray) -> float:
    """Return the force under which the cart has an acceleration in a state."""
    alpha, alpha_beta = (dpend.rates(x, force, rig.params)[3] for force in (0.0, 1.0))
    return float((acceleration - alpha) / (alpha_beta - alpha))


# %%
# With the cart driven so, the links alone are left to control: linearise with a = v̇ as the input, and design for
# that.

A, B = dpend.linearize(rig.params)
driven = A.copy()
driven[3] = 0.0
driven[4:] -= np.outer(B[4:, 0] / B[3, 0], A[3])
input_ = np.append(np.zeros(3), np.append(1.0, B[4:, 0] / B[3, 0]))[:, None]
Ad, Bd = dpend.discretize(driven, input_, rig.sample_time)
P = np.eye(6)
for _ in range(2000):  # the Riccati recursion, run until it stands
    K = np.linalg.solve(0.1 + Bd.T @ P @ Bd, Bd.T @ P @ Ad)
    P = np.eye(6) + Ad.T @ P @ (Ad - Bd @ K)
by_acceleration = dpend.simulate(rig, lambda t, x: force_for((-K @ x).item(), x), x0, duration=4.0)

# %%
# **Voltage drive.** A motor's force is what its voltage gives less what its speed takes: F = k V − b v. The term b
# v is a viscous friction of the cart, so it belongs to the plant, and k V is the force.

volt, drag = 4.0, 6.0  # N/V, N s/m
motor = rig.replace(cart_friction=drag)
lqr_motor = LQR(motor)
by_voltage = dpend.simulate(motor, lqr_motor, x0, duration=4.0)
print(f"the greatest voltage is {abs(by_voltage.u).max() / volt:.1f} V")

fig, ax = plt.subplots(figsize=(8, 3.6))
for run, colour, name in (
    (dpend.simulate(rig, lqr, x0, duration=4.0), BLUE, "force"),
    (by_acceleration, GREEN, "acceleration"),
    (by_voltage, VERMILLION, "voltage"),
):
    ax.plot(run.t, run.x[:, 0], color=colour, label=f"driven by {name}")
ax.set(xlabel="time, s", ylabel="cart, m")
ax.legend()
fig.tight_layout()
plt.show()
