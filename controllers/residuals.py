r"""What a plan is to bring to zero: the deviation from a target, with angles that know no turns.

.. math:: e(x) = (p - p^*,\; 2\sin\tfrac{\theta_1 - \theta_1^*}{2},\; 2\sin\tfrac{\theta_2 - \theta_2^*}{2},\;
   \dot p,\; \dot\theta_1,\; \dot\theta_2)

Near the target it is the deviation itself; its square, :math:`2(1 - \cos)`, is smooth everywhere and greatest half a
turn away.  Over two turns the sine changes its sign, so :math:`\theta^*` is to be the nearest of the target's turns.
"""

from __future__ import annotations


def make_residuals(sin):
    """Build ``residuals(x, target)``: six numbers, given a state and a target at rest that unpack to six.

    ``sin`` is the sine for the kind of number the result is to take.
    """

    def residuals(x, target):
        pos, th1, th2, vel, om1, om2 = x
        pos_to, th1_to, th2_to, _, _, _ = target
        return pos - pos_to, 2.0 * sin(0.5 * (th1 - th1_to)), 2.0 * sin(0.5 * (th2 - th2_to)), vel, om1, om2

    return residuals
