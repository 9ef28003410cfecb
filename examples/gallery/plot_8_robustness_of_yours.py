"""
A robustness study of your controller
=====================================

You have a law. Where does it break? Six axes in a minute: a wrong model, noise, a slow actuator, delay and pushes,
the same for your law and for the one beside it.
"""

import matplotlib.pyplot as plt

from controllers import LQR
from dpend.draw import BLUE, VERMILLION
from studies._perturbations import AXES, measure, score


class ByHand:
    """u = -K y, with gains rounded by hand."""

    def start(self, n, rng):
        """Return the law for ``n`` runs side by side."""
        return lambda t, y: y @ [-1, 150, -165, -2.5, 7, -29]


# %%
# ``measure`` balances from twenty starts at every level of every axis; the law does not know which.

laws = {"by hand": (ByHand(), VERMILLION, "o-"), "LQR": (LQR("gustafsson2016"), BLUE, "s:")}
outcomes = {name: measure(law, "balance", starts=20) for name, (law, *_) in laws.items()}
for name, each in outcomes.items():
    print(f"{name}: {score(each):.1%}")

shown = [axis for axis in AXES if axis.group in ("velocity noise", "force noise", "response", "delay", "pulses")]
fig, axes = plt.subplots(1, len(shown), figsize=(12, 3), sharey=True)
for ax, axis in zip(axes, shown, strict=True):
    for name, (_, colour, line) in laws.items():
        ax.plot(axis.levels, 100 * outcomes[name][axis.name].mean(axis=0), line, color=colour, label=name, mfc="none")
    ax.set(title=axis.name, xlabel=axis.words)
    ax.xaxis.label.set_size(8)
axes[0].set_ylabel("success, %")
axes[0].legend()
fig.tight_layout()
plt.show()

# %%
# ``python -m studies.robustness --controller mine.py:ByHand`` does it with a hundred starts beside the whole field:
# :doc:`/robustness`.
