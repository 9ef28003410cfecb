"""What is no number is refused as such, by name, before anything runs; numpy's whole numbers are whole numbers."""

import math
from typing import Any

import numpy as np
import pytest

import dpend
from controllers import (
    ILQRMPC,
    LQR,
    NMPC,
    BangBang,
    Constant,
    EnergyPump,
    EnergySwingUp,
    LowPass,
    RateLimit,
    ilqr,
    optimize,
)
from dpend.arguments import checked_whole, is_finite
from rl import LSPI
from tests.rigs import whole

A: Any = "a"
TWO: Any = "2"
RIG = dpend.rig("gustafsson2016")


@pytest.mark.parametrize("value", [1, -2.5, np.float32(1), np.int8(3), np.array(2.0)])
def test_one_finite_real_number_is_one_in_pythons_and_numpys_types(value):
    assert is_finite(value)


@pytest.mark.parametrize("value", ["1", b"1", None, True, np.True_, math.nan, -math.inf, 1j, [1.0], np.zeros(2)])
def test_words_truth_values_infinities_and_several_numbers_are_no_finite_number(value):
    assert not is_finite(value)


@pytest.mark.parametrize("value", [2.0, "2", True, 0, np.float64(2), None])
def test_what_is_no_whole_number_or_too_small_is_refused_by_name(value):
    with pytest.raises(ValueError, match=whole(f"n must be a whole number, at least 1; got {value!r}.")):
        checked_whole("n", value)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: optimize(RIG, duration=TWO),
            "duration must be a whole number of samples of 0.02 s, at least 8; got '2' s.",
        ),
        (lambda: optimize(RIG, smoothing=A), "smoothing must be finite and at least 0 s; got 'a'."),
        (
            lambda: optimize(RIG, track_margin=A),
            "track_margin must be at least 0 and less than the limit of 2.4 m; got 'a'.",
        ),
        (lambda: ilqr(RIG, [0] * 6, tolerance=A), "tolerance must be finite and at least 0; got 'a'."),
        (lambda: EnergySwingUp(RIG, k_x=A), "k_x must be finite and greater than 0; got 'a'."),
        (lambda: EnergyPump(RIG, perturbation=A), "perturbation must be a finite force in N; got 'a'."),
        (lambda: LQR(RIG, R=A), "R, the weight of the force, must be finite and greater than 0; got 'a'."),
        (lambda: BangBang(LQR(RIG), A), "force must be finite and greater than 0 N; got 'a'."),
        (lambda: Constant(A), "force must be finite, in N; got 'a'."),
        (lambda: RateLimit(RIG, LQR(RIG), A), "rate must be finite and greater than 0 N/s; got 'a'."),
        (
            lambda: LowPass(RIG, LQR(RIG), frequency=A),
            "frequency must be finite and greater than 0 Hz; got 'a'.",
        ),
        (lambda: dpend.SwingUp(hold=A), "hold must be finite and greater than 0 s; got 'a'."),
        (lambda: dpend.SwingUp(angle_spread=A), "angle_spread must be within 0 and pi rad; got 'a'."),
        (
            lambda: dpend.Balance(state_weights=(A, 1, 1)),
            "state_weights must be three finite numbers, at least 0, for |pos|, |th1| and |th2|; got ('a', 1, 1).",
        ),
    ],
)
def test_a_word_where_a_number_belongs_is_refused_with_what_was_expected(make, message):
    with pytest.raises(ValueError, match=whole(message)):
        make()


def test_numpys_whole_numbers_are_taken():
    number: Any = np.int32(7)
    assert NMPC(RIG, max_iterations=number).max_iterations == 7
    assert ILQRMPC(RIG, iterations=number, starts=number).starts == 7
    assert LSPI(RIG, iterations=number).iterations == 7
