"""The compiled loops of SDRE over plants side by side: each sampled, and its Riccati equation solved by doubling.

What is found for a plant depends on that plant alone, so that it is the same in every batch and in any thread.
"""

from __future__ import annotations

import numpy as np

from dpend.kernels import compiled, inline

_N = 6
_TERMS, _SQUARINGS = 12, 4  # for a 16th of a sample twelve terms are exact to rounding


@inline
def _multiply(a, b, out, n, columns):
    """Fill in the product of a matrix (n, n) and one with so many columns, numbers that LLVM knows and unrolls by."""
    for i in range(n):
        for j in range(columns):
            out[i, j] = a[i, 0] * b[0, j]
        for k in range(1, n):
            for j in range(columns):
                out[i, j] += a[i, k] * b[k, j]


@inline
def _solve(matrix, right):
    """Solve for many right sides in place, by elimination with row pivoting; return whether there is a solution."""
    n, columns = _N, 2 * _N
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        if not 0.0 < abs(matrix[pivot, k]) < np.inf:
            return False
        if pivot != k:
            for j in range(n):
                matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
            for j in range(columns):
                right[k, j], right[pivot, j] = right[pivot, j], right[k, j]
        inverse = 1.0 / matrix[k, k]
        for i in range(k + 1, n):
            factor = matrix[i, k] * inverse
            for j in range(k + 1, n):
                matrix[i, j] -= factor * matrix[k, j]
            for j in range(columns):
                right[i, j] -= factor * right[k, j]
    for k in range(n - 1, -1, -1):
        for i in range(k + 1, n):
            for j in range(columns):
                right[k, j] -= matrix[k, i] * right[i, j]
        inverse = 1.0 / matrix[k, k]
        for j in range(columns):
            right[k, j] *= inverse
    return True


@compiled
def sampled(first, last, A, B, sample_time, held_A, held_B):
    """Fill in plants (n, 6, 6) and (n, 6, 1) sampled with their forces held, by the exponential of (A B; 0 0)."""
    n = _N
    small = np.zeros((n + 1, n + 1))
    power = np.empty((n + 1, n + 1))
    product = np.empty((n + 1, n + 1))
    share = sample_time / 2.0**_SQUARINGS
    for row in range(first, last):
        small[:n, :n] = A[row] * share
        small[:n, n:] = B[row] * share
        power[:] = np.eye(n + 1)
        for k in range(_TERMS, 0, -1):
            _multiply(small, power, product, n + 1, n + 1)
            power[:] = product / k
            for i in range(n + 1):
                power[i, i] += 1.0
        for _ in range(_SQUARINGS):
            _multiply(power, power, product, n + 1, n + 1)
            power[:] = product
        held_A[row] = power[:n, :n]
        held_B[row] = power[:n, n:]


@compiled
def solved(first, last, A, B, Q, R, doublings, P, found):
    """Fill in the solutions P of Riccati's equation by doubling, and where a stabilising one was found."""
    n = _N
    F, G, H = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    W, turned = np.empty((n, n)), np.empty((n, n))
    both = np.empty((n, 2 * n))  # W^-1 (F, G)
    product, more = np.empty((n, 2 * n)), np.empty((n, n))
    for row in range(first, last):
        F[:] = A[row]
        H[:] = Q
        for i in range(n):
            for j in range(n):
                G[i, j] = B[row, i, 0] * B[row, j, 0] / R
        found[row] = False
        for _ in range(doublings):
            _multiply(G, H, W, n, n)
            for i in range(n):
                W[i, i] += 1.0
                for j in range(n):
                    both[i, j] = F[i, j]
                    both[i, n + j] = G[i, j]
                    turned[i, j] = F[j, i]
            if not _solve(W, both):
                break
            _multiply(H, both, W, n, n)
            _multiply(turned, W, more, n, n)
            _multiply(F, both, product, n, 2 * n)
            _multiply(product[:, n:], turned, W, n, n)
            size = greatest = change = 0.0
            finite = True
            for i in range(n):
                for j in range(n):
                    G[i, j] += W[i, j]
                    H[i, j] += 0.5 * (more[i, j] + more[j, i])
                    F[i, j] = product[i, j]
                    size = max(size, abs(H[i, j]))
                    greatest = max(greatest, abs(F[i, j]))
                    change = max(change, abs(more[i, j]))
                    finite = finite and np.isfinite(H[i, j] + F[i, j])
            if not (finite and size < 1e15):
                break
            if greatest < 1e-3 and change <= 1e-13 * size:
                found[row] = True
                break
        P[row] = H


for _loop in (sampled, solved):
    _loop.targetoptions["nogil"] = True  # they touch no Python object, and their rows may be shared out among threads
