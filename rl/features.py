r"""Two families of features of state and action: the report's Table 1, and all products of two.

Table 1 has eighteen features, each constant or linear in the action,

.. math:: x(s, a) = (\varphi_1(s), \dots, \varphi_{12}(s),\; a\,\psi_1(s), \dots, a\,\psi_6(s))

so that :math:`\hat q(s, a) = x(s, a)^\top w = c(s) + a\,g(s)` is a straight line over the actions, and its greatest
value is always at an end of the action set.  That is why every controller learned with these features is bang-bang.

The quadratic family has the products :math:`z_i z_j` of :math:`z = (s, a)`, so that
:math:`\hat q(s, a) = z^\top H z` is a parabola over the actions; where :math:`H_{aa}` has the right sign its best
action is :math:`-H_{aa}^{-1} H_{as}\,s`, linear in the state and so smooth.

Source: *Control of Inverted Double Pendulum using Reinforcement Learning*, Table 1; the odd ones, which the surviving
text lacks, follow from the pattern and from the code published with it.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dpend.params import Array
from dpend.state import NAMES, wrap_angle

TABLE1 = (
    *("|pos|", "pos", "|n(th1)|", "n(th1)", "|n(th2)|", "n(th2)", "|vel|", "vel", "|om1|", "om1", "|om2|", "om2"),
    *("a pos", "a vel", "a th1", "a om1", "a th2", "a om2"),
)
"""Names of the features, in the report's order; ``n`` is the difference to the nearest whole turn."""

CART_FEATURES = tuple(i for i, name in enumerate(TABLE1) if "pos" in name or "vel" in name)
"""Places in :data:`TABLE1` of the six features of position and velocity of the cart."""


def make_value_features(wrap_angle=wrap_angle):
    r"""Return :math:`\varphi(s)`, the twelve features without the action, as a function of a state that unpacks to six.

    :func:`dpend.state.wrap_angle` comes in the form that the kind of number needs; numba wants it compiled.
    """

    def value_features(x):
        pos, th1, th2, vel, om1, om2 = x
        n1, n2 = wrap_angle(th1), wrap_angle(th2)
        return abs(pos), pos, abs(n1), n1, abs(n2), n2, abs(vel), vel, abs(om1), om1, abs(om2), om2

    return value_features


def slope_features(x):
    r"""Return :math:`\psi(s)`, the six factors of the action, for a state that unpacks to six numbers."""
    pos, th1, th2, vel, om1, om2 = x
    return pos, vel, th1, om1, th2, om2


QUADRATIC = tuple(f"{first} {second}" for i, first in enumerate((*NAMES, "a")) for second in (*NAMES, "a")[i:])
"""Names of the 28 products of two of the seven variables of state and action, in the order of an upper triangle."""


def quadratic_features(z: Array) -> Array:
    r"""Return the products :math:`z_i z_j`, :math:`i \le j`, of vectors: ``(..., k)`` to ``(..., k (k + 1) / 2)``."""
    i, j = np.triu_indices(z.shape[-1])
    return z[..., i] * z[..., j]


def quadratic_form(w: npt.NDArray[np.floating]) -> Array:
    r"""Return the symmetric :math:`H` (k, k) with :math:`z^\top H z = w^\top x(z)`, for w (k (k + 1) / 2,)."""
    k = round((np.sqrt(8 * len(w) + 1) - 1) / 2)
    H = np.zeros((k, k))
    H[np.triu_indices(k)] = 0.5 * np.asarray(w)
    return H + H.T
