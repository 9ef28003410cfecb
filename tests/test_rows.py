"""A row draws what it draws alone, and threads change nothing but the time."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from rigs import whole

from dpend import rows
from dpend.stepper import CONTROLLER_STREAM, row_sequence


def test_a_row_has_the_generator_that_a_simulation_of_it_alone_begins_with() -> None:
    rng = np.random.default_rng(row_sequence(3, 10, CONTROLLER_STREAM))
    generators = rows.row_generators(rng, 4)
    assert generators[0] is rng
    for i, found in enumerate(generators):
        alone = np.random.default_rng(row_sequence(3, 10 + i, CONTROLLER_STREAM))
        assert_array_equal(found.standard_normal(5), alone.standard_normal(5))


def test_rows_of_any_other_generator_draw_their_own_numbers_and_the_same_again() -> None:
    first, again = (
        [each.random() for each in rows.row_generators(np.random.Generator(np.random.MT19937(7)), 3)] for _ in range(2)
    )
    assert len(set(first)) == 3
    assert first == again


def test_a_generator_without_a_seed_sequence_serves_one_row() -> None:
    rng = np.random.Generator(np.random.RandomState(7)._bit_generator)
    assert rows.row_generators(rng, 1) == [rng]
    with pytest.raises(TypeError, match=r"^To draw for 2 rows, rng must come from a SeedSequence, as "):
        rows.row_generators(rng, 2)


@pytest.mark.parametrize("cores", [1, 3])
@pytest.mark.parametrize("n", [0, 1, 7, 100])
def test_every_row_is_in_one_part(n: int, cores: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rows, "_cores", lambda: cores)
    count, threads = np.zeros(n, dtype=int), set()

    def work(first: int, last: int) -> None:
        threads.add(threading.get_ident())
        count[first:last] += 1

    rows.in_parts(work, n)
    assert_array_equal(count, 1)
    if cores == 1 or n < 8:
        assert threads == {threading.get_ident()}


def test_what_fails_in_a_thread_fails_for_the_caller(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rows, "_cores", lambda: 2)

    def work(first: int, last: int) -> None:
        if last == 100:
            raise ValueError("row 99")

    with pytest.raises(ValueError, match=whole("row 99")):
        rows.in_parts(work, 100)


@pytest.mark.parametrize("cores", [1, 2])
def test_after_an_interrupt_no_further_part_begins(cores: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rows, "_cores", lambda: cores)
    begun, interrupted = [], threading.Event()

    def work(first: int, last: int) -> None:
        begun.append(last - first)
        if first == 0:
            interrupted.set()
            raise KeyboardInterrupt
        interrupted.wait()
        time.sleep(0.05)

    with pytest.raises(KeyboardInterrupt):
        rows.in_parts(work, 10_000)
    assert max(begun) <= 64
    assert sum(begun) < 1000


def test_a_worker_process_has_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rows, "parent_process", lambda: object())
    assert rows._cores() == 1
