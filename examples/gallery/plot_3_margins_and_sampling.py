"""
Margins, sampling and delay
===========================

How slow may the clock be, and how late the measurement? The margins of the linear loop predict it, and simulated
runs agree.
"""

import matplotlib.pyplot as plt
import numpy as np

import dpend
from controllers import LQR
from dpend.draw import BLUE, VERMILLION

rig = dpend.rig("gustafsson2016")
margins = LQR(rig).margins()
print(f"gain {margins.gain_low:.2f} to {margins.gain_high:.1f}, phase {np.degrees(margins.phase):.0f}°")
print(f"delay {margins.delay_samples:.1f} samples of {1e3 * rig.sample_time:g} ms")

# %%
# Redesign for every sample time, and read the delay margin in milliseconds.

times = np.geomspace(0.005, 0.16, 11)
delays = [LQR(rig.replace(sample_time=T)).margins().delay for T in times]

# %%
# Now simulate: the law of 20 ms, but 0 to 4 samples late, from 200 starts.

task = dpend.Balance(lam=0.1)
starts = task.starts(np.random.default_rng(0), 200, rig)
late = range(5)
saved = [
    dpend.simulate_many(rig.replace(sensor_delay=d), LQR(rig), starts, task=task, duration=10.0).success.mean()
    for d in late
]

fig, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6))
left.loglog(1e3 * times, 1e3 * np.array(delays), "o-", color=BLUE)
left.set(xlabel="sample time, ms", ylabel="delay margin, ms", title="designed for its sample time")
right.bar(late, 100 * np.array(saved), color=VERMILLION)
right.axvline(margins.delay_samples, color=BLUE, ls="--", label="delay margin")
right.set(xlabel="delay, samples", ylabel="saved, %", title="20 ms, the delay not known")
right.legend()
fig.tight_layout()
plt.show()
