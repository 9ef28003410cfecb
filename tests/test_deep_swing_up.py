"""The least variation of force: a bound that no law passes."""

import numpy as np
import pytest

import dpend
from controllers import LQR
from studies.deep_swing_up import least_variation

RIG = dpend.rig("gustafsson2016")
X0 = np.array([0.0, 0.05, -0.03, 0.0, 0.0, 0.0])


@pytest.mark.slow
def test_no_law_varies_its_force_less_than_the_least():
    least = least_variation(RIG, X0)
    for Q, R in (([1] * 6, 1.0), ([1e-3] * 6, 1.0), ([1, 10, 10, 1, 1, 1], 0.1)):
        run = dpend.simulate(RIG, LQR(RIG, Q=Q, R=R), X0, task=dpend.Balance(lam=0.1))
        assert run.success
        assert 0 < least < float(run.metrics()["variation"])


@pytest.mark.slow
def test_it_is_a_norm_cut_off_by_the_limits():
    whole = least_variation(RIG, X0)
    assert least_variation(RIG, np.zeros(6)) == pytest.approx(0.0, abs=1e-9)
    assert least_variation(RIG, -X0) == pytest.approx(whole, rel=1e-6)
    assert 0 < least_variation(RIG, 0.5 * X0) <= 0.5 * whole * (1 + 1e-6)


def test_what_no_force_can_save_has_none():
    assert least_variation(RIG, 30 * X0) == np.inf
