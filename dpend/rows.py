"""Rows side by side: a random generator for each, and threads that share them out."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import parent_process

import numpy as np

_PARTS = 4  # for each thread, as some rows take longer than others
_MOST_ROWS = 64  # of a part: an interrupt is heard between parts, and rows may take some milliseconds


def row_generators(rng: np.random.Generator, n: int) -> list[np.random.Generator]:
    r"""Return a random generator for each of ``n`` rows, so that a row draws in a batch what it draws alone.

    The first row has ``rng`` itself.  :func:`dpend.simulate_many` seeds ``rng`` for the first row of a batch, by a
    spawn key :math:`(\text{row}, \text{stream})`; row :math:`i` of the batch then has
    :math:`(\text{row} + i, \text{stream})`, with which it would begin alone.  The key of any other ``rng`` is
    lengthened by :math:`i`.

    Parameters
    ----------
    rng : numpy.random.Generator
        What ``start(n, rng)`` of a controller was given.
    n : int
        Number of rows.

    Returns
    -------
    list of numpy.random.Generator

    Raises
    ------
    TypeError
        If there are several rows, and ``rng`` was not made from a ``SeedSequence``, as ``default_rng`` makes it.
    """
    if n == 1:
        return [rng]
    sequence = rng.bit_generator.seed_seq
    if not isinstance(sequence, np.random.SeedSequence):
        raise TypeError(
            f"To draw for {n} rows, rng must come from a SeedSequence, as numpy.random.default_rng(seed) does; "
            f"its seed is {sequence!r}."
        )
    key, kind = sequence.spawn_key, type(rng.bit_generator)
    keys = [(key[0] + i, key[1]) if len(key) == 2 else (*key, i) for i in range(1, n)]
    return [
        rng,
        *(np.random.Generator(kind(np.random.SeedSequence(sequence.entropy, spawn_key=each))) for each in keys),
    ]


def in_parts(work: Callable[[int, int], object], n: int, least: int = 4) -> None:
    """Call ``work(first, last)`` for consecutive parts of ``n`` rows, in threads on all cores that the process may use.

    In a worker process there is one thread, because its siblings have the other cores.

    Parameters
    ----------
    work : callable
        Does the rows from ``first`` on, before ``last``, and touches no others; compiled, without Python's lock.
    n : int
        Number of rows.
    least : int
        Rows for which a thread pays.
    """
    threads = min(_cores(), n // least)
    parts = max(min(_PARTS * threads, n // least) if threads > 1 else 1, -(-n // _MOST_ROWS))
    bounds = [n * part // parts for part in range(parts + 1)]
    if threads <= 1:
        for each in itertools.pairwise(bounds):
            work(*each)
        return
    with ThreadPoolExecutor(threads) as executor:  # which takes less than a row of work
        try:
            for done in [executor.submit(work, *each) for each in itertools.pairwise(bounds)]:
                done.result()
        except BaseException:
            executor.shutdown(cancel_futures=True)  # those not begun are not waited for
            raise


def _cores() -> int:
    if parent_process() is not None:
        return 1
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
