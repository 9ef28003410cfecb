"""Independent engines, built from the same ``Params``, agree with this package, and the table says how closely."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import dpend
from benchmarks.peers import designs, dynamics, environments
from benchmarks.peers.__main__ import PARTS, STATES
from benchmarks.peers.cases import Row, any_forces, any_params, any_states, error, row
from benchmarks.peers.engines import ENGINES, installed
from benchmarks.peers.table import markdown, read
from benchmarks.relative import absolute, forces_to_relative, from_relative, to_relative

ROOT = Path(__file__).parent.parent

pytestmark = pytest.mark.filterwarnings("ignore")  # of other people's packages, which are not ours to mend


def held(rows: list[Row]) -> None:
    assert rows
    for each in rows:
        assert each.worst <= each.tolerance, each


def needs(*modules: str) -> None:
    for module in modules:
        if find_spec(module) is None:
            pytest.skip(f"{module} is not installed, so nothing is compared with it; install the extra `engines`.")


@pytest.mark.parametrize("engine", ENGINES)
def test_states_agree_with_independent_engines(engine: str) -> None:
    if not installed(engine):
        pytest.skip(f"{engine} is not installed, so nothing is compared with it; install the extra `engines`.")
    held(dynamics.still(engine, n=20, states=5, seed=1))


def test_a_motion_agrees_with_independent_engines() -> None:
    engines = [engine for engine in ENGINES if installed(engine)]
    if not engines:
        pytest.skip("No engine is installed, so no motion is compared with any; install the extra `engines`.")
    held(dynamics.motions(engines, n=1, seed=1, report=lambda _: None))


def test_an_engine_that_is_told_of_another_plant_disagrees(monkeypatch: pytest.MonkeyPatch) -> None:
    needs("pinocchio")
    build = dynamics.load("Pinocchio")

    def heavier(params: dpend.Params) -> object:
        return build(dpend.Params(**params.to_dict() | {"mass2": params.mass2 * (1 + 1e-6)}))

    monkeypatch.setattr(dynamics, "load", lambda name: heavier)
    assert all(each.worst > each.tolerance for each in dynamics.still("Pinocchio", n=5, states=5, seed=1))


PEERS: dict[str, tuple[tuple[str, ...], Callable[[], list[Row]]]] = {
    "do-mpc": (("do_mpc",), lambda: dynamics.dompc(n=2, states=10, seed=1)),
    "Gymnasium": (("mujoco", "gymnasium"), lambda: environments.gymnasium_idp(60, 1, sideways=False)),
    "dm_control": (("dm_control",), lambda: environments.two_poles(60, 1)),
    "Drake": (("pydrake",), lambda: designs.designs(4, 1, drake=True, slicot=False)),
    "SLICOT": (("slycot",), lambda: designs.designs(4, 1, drake=False, slicot=True)),
    "scipy": (("control",), lambda: designs.designs(4, 1, drake=False, slicot=False)),
    "python-control": (("control",), lambda: designs.margins(1, 1)),
}


@pytest.mark.parametrize("peer", PEERS)
def test_models_environments_and_designs_agree_with_other_packages(peer: str) -> None:
    modules, compared = PEERS[peer]
    needs(*modules)
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        held(compared())


def test_forces_do_the_same_work_in_relative_angles() -> None:
    rng = np.random.default_rng(0)
    x, f = any_states(rng, 50), any_forces(rng, 50)
    q, v = to_relative(x)
    np.testing.assert_allclose((forces_to_relative(f) * v).sum(axis=1), (f * x[:, 3:]).sum(axis=1), rtol=1e-12, atol=0)
    np.testing.assert_allclose(from_relative(q, v), x, rtol=1e-14)
    np.testing.assert_allclose(absolute([1.0, 2.0, 3.0]), [1.0, 2.0, 5.0])


def test_the_mass_matrix_of_the_kinetic_energy_is_the_inverse_of_what_unit_forces_accelerate() -> None:
    rng = np.random.default_rng(0)
    params, x = any_params(rng), any_states(rng, 20)
    pulled = np.stack([dpend.rates(x, np.tile(f, (20, 1)), params)[:, 3:] for f in [np.zeros(3), *np.eye(3)]], axis=2)
    inverse = pulled[:, :, 1:] - pulled[:, :, :1]
    np.testing.assert_allclose(dynamics.mass_matrices(x, params) @ inverse, np.tile(np.eye(3), (20, 1, 1)), atol=1e-9)


def test_an_error_that_is_no_number_is_no_agreement() -> None:
    found = row("states", "engine", error([[1.0], [np.nan]], [[1.0], [2.0]]), 1e-9)
    assert found.cases == 2
    assert found.worst > found.tolerance


def test_the_table_in_the_docs_is_that_of_its_rows_and_all_of_it_agrees() -> None:
    rows = read(ROOT / "docs/results/peers/rows.csv")
    assert markdown(rows) in (ROOT / "docs/trust.md").read_text()
    assert set(rows["part"]) >= set(PARTS)
    for line in rows.to_dict("records"):
        assert line["cases"] >= 900, line
        least = 1000 * (STATES if line["quantity"].startswith("accelerations") else 1)
        assert line["cases"] + line["unanswered"] >= least, line
        assert line["worst"] <= line["tolerance"], line
