"""Names that have changed still work, and say what they are called now."""

import pytest

import controllers
import dpend
import dpend.tasks
import rl
from controllers import LQR, BangBang, EnergyPump, EnergySwingUp, LowPass, RateLimit, RolloutRegion

RIG = dpend.rig("gustafsson2016")


@pytest.mark.parametrize(
    ("module", "old", "new"),
    [
        (controllers, "Ahead", "RolloutRegion"),
        (controllers, "Catch", "SwitchingController"),
        (controllers, "faults", "violations"),
        (dpend.tasks, "Unending", "NoTask"),
        (rl, "DeepTraining", "Training"),
        (rl, "LSPITraining", "Training"),
        (rl, "QACTraining", "Training"),
    ],
)
def test_an_export_is_found_by_its_old_name_with_a_warning(module, old, new):
    message = (
        rf"^{module.__name__}\.{old} is now called {module.__name__}\.{new}; the old name goes with version 0\.3\.$"
    )
    with pytest.warns(DeprecationWarning, match=message) as caught:
        found = getattr(module, old)
    assert found is getattr(module, new)
    assert caught[0].filename == __file__


@pytest.mark.parametrize(
    ("build", "old", "new"),
    [
        (lambda **keywords: dpend.SwingUp(**keywords or {"spread": 0.3}), "spread", "angle_spread"),
        (lambda **keywords: LQR(RIG, **keywords or {"about": "down-up"}), "about", "target"),
        (lambda **keywords: RolloutRegion(RIG, LQR(RIG), **keywords or {"about": "up-up"}), "about", "target"),
        (lambda **keywords: BangBang(force=1.0, **keywords or {"inner": LQR(RIG)}), "inner", "controller"),
        (lambda **keywords: RateLimit(RIG, rate=1.0, **keywords or {"inner": LQR(RIG)}), "inner", "controller"),
        (lambda **keywords: LowPass(RIG, frequency=1.0, **keywords or {"inner": LQR(RIG)}), "inner", "controller"),
        (lambda **keywords: EnergyPump(RIG, **keywords or {"kick": 3.0}), "kick", "perturbation"),
        (lambda **keywords: EnergySwingUp(RIG, **keywords or {"kick": 3.0}), "kick", "perturbation"),
        (lambda **keywords: rl.LinearQLearning(RIG, **keywords or {"spread": 2.0}), "spread", "init_std"),
        (lambda **keywords: rl.GaussianQAC(RIG, **keywords or {"spread": 2.0}), "spread", "init_std"),
    ],
)
def test_an_argument_is_taken_and_read_by_its_old_name_with_a_warning(build, old, new):
    with pytest.warns(DeprecationWarning, match=rf"\({old}=\.\.\.\) is now called \w+\({new}=\.\.\.\)"):
        built = build()
    with pytest.warns(DeprecationWarning, match=rf"\.{old} is now called \w+\.{new}"):
        assert getattr(built, old) is getattr(built, new)


def test_a_name_that_never_was_is_no_attribute():
    with pytest.raises(AttributeError, match="module 'controllers' has no attribute 'Chatch'"):
        controllers.Chatch  # noqa: B018


def test_a_predictive_controller_still_says_its_horizon_in_samples():
    controller = controllers.NMPC(RIG, horizon=0.5)
    message = r"^NMPC\.samples is now called NMPC\.horizon_steps; the old name goes with version 0\.3\.$"
    with pytest.warns(DeprecationWarning, match=message) as caught:
        assert controller.samples == controller.horizon_steps == 25
    assert caught[0].filename == __file__
