"""The plant linearized about a point, and sampled with its force held."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .arguments import checked_array, checked_positive, is_finite
from .params import Array, Params, checked_params
from .plant import rates
from .state import one_state

_STEP = 1e-30  # a complex step has no cancellation, so it may be as small as one likes


def linearize(params: Params, x: npt.ArrayLike | None = None, u: float = 0.0) -> tuple[Array, Array]:
    r"""Return :math:`A = \partial\dot x/\partial x` and :math:`B = \partial\dot x/\partial u`, exact to rounding.

    Each column is the imaginary part of the rates at a point moved by an imaginary step, divided by that step.

    Parameters
    ----------
    params : Params
        The plant; one, not a batch.
    x : array_like, optional
        State ``(6,)`` about which to linearize; left out, upright at rest.
    u : float
        Force on the cart there, N.

    Returns
    -------
    A : ndarray (6, 6)
        States on their own rates.
    B : ndarray (6, 1)
        Force on the states' rates, per N.

    Raises
    ------
    TypeError
        If ``params`` is something else, such as a rig, or ``x`` or ``u`` is not made of numbers.
    ValueError
        If ``params`` describes several plants, or ``x`` is not one finite state.

    See Also
    --------
    dpend.discretize : The same, sampled.
    dpend.rates : What is linearized.

    Notes
    -----
    Source: W. Squire and G. Trapp, *Using complex variables to estimate derivatives of real functions*, 1998.

    Examples
    --------
    >>> import numpy as np
    >>> import dpend
    >>> rig = dpend.rig("gustafsson2016")
    >>> A, B = dpend.linearize(rig.params)
    >>> np.sort(np.linalg.eigvals(A).real)[-2:].round(2)
    array([3.32, 7.67])
    """
    if checked_params("linearize", params).n is not None:
        raise ValueError(f"linearize takes one plant; got Params with arrays of {params.n} rows.")
    point = np.zeros(6) if x is None else one_state("x", x)
    if not is_finite(u):
        raise TypeError(f"u must be one finite force on the cart, N; got {u!r}.")
    moved = point + 1j * _STEP * np.vstack([np.eye(6), np.zeros(6)])
    forces = u + 1j * _STEP * np.array([0, 0, 0, 0, 0, 0, 1])
    columns = np.imag(rates(moved, forces, params)) / _STEP
    return columns[:6].T.copy(), columns[6:].T.copy()


def discretize(A: npt.ArrayLike, B: npt.ArrayLike, sample_time: float) -> tuple[Array, Array]:
    r"""Return :math:`A_d = e^{AT}` and :math:`B_d = \int_0^T e^{As}\,ds\,B`: the plant sampled, with its force held.

    Both are blocks of one matrix exponential, so nothing is truncated.

    Parameters
    ----------
    A : array_like (n, n)
        The continuous plant's states on their own rates.
    B : array_like (n, m)
        The inputs on the states' rates.
    sample_time : float
        :math:`T`, s, greater than zero.

    Returns
    -------
    Ad : ndarray (n, n)
        A state on the next.
    Bd : ndarray (n, m)
        An input on the next state.

    Raises
    ------
    TypeError
        If a matrix is not made of numbers.
    ValueError
        If the shapes do not fit, a number is not finite, or the sample time is not greater than zero.

    See Also
    --------
    dpend.linearize : The plant to sample.

    Notes
    -----
    Source: C. Van Loan, *Computing integrals involving the matrix exponential*, 1978.

    Examples
    --------
    >>> import dpend
    >>> rig = dpend.rig("gustafsson2016")
    >>> Ad, Bd = dpend.discretize(*dpend.linearize(rig.params), rig.sample_time)
    >>> Ad.shape, Bd.shape
    ((6, 6), (6, 1))
    """
    from scipy.linalg import expm  # kept out of `import dpend`

    A = checked_array("A", A, "a matrix (n, n)")
    B = checked_array("B", B, "a matrix (n, m)")
    if A.ndim != 2 or A.shape[0] != A.shape[1] or B.ndim != 2 or len(B) != len(A):
        raise ValueError(f"Expected A of shape (n, n) and B of shape (n, m); got {A.shape} and {B.shape}.")
    checked_positive("sample_time", sample_time, "s")
    n, m = B.shape
    held = np.zeros((n + m, n + m))
    held[:n, :n] = A
    held[:n, n:] = B
    exponential: Array = np.asarray(expm(held * sample_time), dtype=np.float64)
    return exponential[:n, :n], exponential[:n, n:]
