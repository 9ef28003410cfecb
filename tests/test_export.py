"""A law in another language is the law: run there and here, on the same measurements and in a closed loop."""

from __future__ import annotations

import re
import runpy
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import foreign
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rigs import whole

import dpend
from controllers import (
    EKF,
    LQR,
    NMPC,
    SDRE,
    TVLQR,
    BangBang,
    Constant,
    Differences,
    LowPass,
    RateLimit,
    SwitchingController,
    WithEstimator,
    tuned_law,
)
from rl import TableOneMean, load_policy
from studies.export import NotExportable, controller_named, export, files
from studies.export.planner import RealTimeNMPC

RIG = dpend.rig("gustafsson2016")
K = LQR(RIG).K[0]
FOLDED = np.array([0.4, 0.0, np.pi, 0.0, 0.0, 0.0])
STARTS = {"TVLQR by time": dpend.EQUILIBRIA["down-down"], "LQR of the folded links": FOLDED + 0.05 * np.eye(6)[1]}
"""Where loops start, if not within 0.1 rad of upright."""
SAMPLES = 300
UNLIMITED = RIG.replace(track_limit=np.inf)


def wavering(t: Any, x: Any) -> Any:
    return 2 * np.sin(3 * t) - K @ x + np.tanh(x[0]) / (1 + abs(x[3])) - x[4] ** 2


def mean(indicators: str, count: int) -> TableOneMean:
    """Return a law over Table 1 that balances for a while, with indicators that matter."""
    v = np.random.default_rng(0).normal(size=12 + count)
    v[1:12:2] -= K
    return TableOneMean(v, indicators)


def shipped(name: str) -> Any:
    return load_policy(name)


LAWS: dict[str, Callable[[], Any]] = {
    "constant": lambda: Constant(-3.0),
    "LQR": lambda: LQR(RIG),
    "LQR of the folded links": lambda: LQR(RIG, target=FOLDED),
    "sign of LQR": lambda: BangBang(LQR(RIG), 40.0),
    "tuned gain": lambda: tuned_law(RIG, "gain"),
    "tuned sign": lambda: tuned_law(RIG, "sign"),
    "TVLQR": lambda: TVLQR(RIG),
    "TVLQR by time": lambda: TVLQR(RIG, index="time"),
    "mean": lambda: mean("none", 0),
    "mean with signs": lambda: mean("signs", 3),
    "mean with cells": lambda: mean("cells", 8),
    "function": lambda: wavering,
    "rate limit": lambda: RateLimit(RIG, LQR(RIG), 400.0),
    "low-pass": lambda: LowPass(RIG, shipped("ppo-swing-up"), frequency=20.0),
    "differences": lambda: WithEstimator(Differences(RIG), LQR(RIG)),
    "differences, network": lambda: WithEstimator(Differences(RIG), shipped("ppo-swing-up-smooth")),
    "differences, TVLQR": lambda: WithEstimator(Differences(RIG), TVLQR(RIG)),
    **{
        name: lambda name=name: shipped(name)
        for name in ("q-tuned", "lspi", "qac-tuned", "ppo-swing-up", "ppo-swing-up-smooth", "ddpg-balance")
    },
}
JUMPS = {"sign of LQR", "tuned sign", "q-tuned"}
"""Bang-bang laws: between two jumps of the force nothing holds their loops to a motion, so that roundings grow."""
HEAP = re.compile(r"\b(m|c|re)alloc\b|\bfree\b")
X0 = np.array([0.0, 0.08, -0.06, 0.0, 0.0, 0.0])

QUICK = {"LQR", "q-tuned", "ppo-swing-up", "differences", "rate limit"}

_C = """\
#include "law.h"
#include "plant.h"
#include <stdio.h>
int main(void)
{
    double m[LAW_MEMORY], x[6], f[3] = {0.0, 0.0, 0.0};
    int k;
    law_reset(m);
    if (fread(x, sizeof x, 1, stdin) != 1) return 1;
    for (k = 0; k < SAMPLES; k++) {
        f[0] = law_act(m, x);
        fwrite(x, sizeof x, 1, stdout);
        fwrite(f, sizeof f[0], 1, stdout);
        dpend_sample(x, f, &dpend_rig, DPEND_SAMPLE_TIME / DPEND_SUBSTEPS, DPEND_SUBSTEPS);
    }
    return 0;
}
"""
_JAVASCRIPT = """\
import { readFileSync, writeSync } from "node:fs";
import { act, reset } from "./law.mjs";
import { RIG, SAMPLE_TIME, SUBSTEPS, sample } from "./plant.mjs";
const bytes = readFileSync(0), x = new Float64Array(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + 48));
const m = reset(), rows = new Float64Array(7 * SAMPLES);
for (let k = 0; k < SAMPLES; k++) {
    const u = act(m, x);
    rows.set([...x, u], 7 * k);
    sample(x, [u, 0, 0], RIG, SAMPLE_TIME / SUBSTEPS, SUBSTEPS, x);
}
writeSync(1, Buffer.from(rows.buffer));
"""


def loop(
    folder: Path, to: str, x0: Any, samples: int = SAMPLES, sources: Sequence[str] = ("law.c",)
) -> tuple[Any, Any]:
    """Return states and forces of a law and the plant in a loop, both in another language."""
    if to == "c":
        source = _C.replace("SAMPLES", str(samples))
        command = foreign.build("gcc", folder, source, *(folder / name for name in sources))
    else:
        command = foreign.script(folder, _JAVASCRIPT.replace("SAMPLES", str(samples)))
    rows = foreign.run(command, x0).reshape(samples, 7)
    return rows[:, :6], rows[:, 6]


def checked(folder: Path, to: str) -> str:
    """Run the check that comes with a law; return what it prints."""
    if to == "c":
        command = foreign.build("gcc", folder, (folder / "check.c").read_text(), folder / "law.c")
    else:
        command = foreign.script(folder, (folder / "check.mjs").read_text())
    with (folder / "vector.csv").open() as vector:
        done = subprocess.run(command, stdin=vector, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.parametrize("to", ["c", "js"])
@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in LAWS]
)
def test_an_exported_law_answers_and_balances_as_in_python(name: str, to: str, tmp_path: Path) -> None:
    law = LAWS[name]()
    folder = export(law, RIG, to, tmp_path)
    assert int(checked(folder, to).split()[0]) > 100
    assert not HEAP.search("".join(each.read_text() for each in folder.glob("*.[ch]")))
    if name in JUMPS:
        return
    x0 = STARTS.get(name, X0)
    expected = dpend.simulate(UNLIMITED, law, x0, SAMPLES * RIG.sample_time, task=None).u
    allowed = 1e-5 if hasattr(getattr(law, "controller", law), "network") else 1e-9
    assert_allclose(loop(folder, to, x0)[1] / 40, expected / 40, rtol=0, atol=allowed)


@pytest.mark.parametrize("to", ["c", "js"])
@pytest.mark.parametrize("name", sorted(JUMPS))
def test_every_sample_of_a_bang_bang_loop_is_pythons_and_its_forces_are_until_roundings_have_grown(
    name: str, to: str, tmp_path: Path
) -> None:
    law = LAWS[name]()
    x, u = loop(export(law, RIG, to, tmp_path), to, X0)
    act, stepper = law.start(1, np.random.default_rng(0)), dpend.Stepper(UNLIMITED, SAMPLES - 1)
    assert_array_equal(u, [act(k * RIG.sample_time, each[None])[0] for k, each in enumerate(x)])
    stepper.reset(x[:-1])
    assert_allclose(stepper.step(u[:-1]), x[1:], rtol=0, atol=1e-13)
    run = dpend.simulate(UNLIMITED, law, X0, SAMPLES * RIG.sample_time, task=None)
    assert_array_equal(u[:150], run.u[:150])  # where it was written the first 200 to 222 agree, 4 s
    assert_allclose(x[:150], run.x[:150], rtol=0, atol=1e-5)  # 1e-12 after a second, 1e-9 after two
    assert np.abs(x[:, 1:3]).max() < 0.3  # it balances, as Python's does


STATES = """\
#include "law.h"
#include <stdio.h>
int main(void)
{
    double m[LAW_MEMORY], y[6];
    law_reset(m);
    while (fread(y, sizeof y, 1, stdin) == 1) {
        law_act(m, y);
        fwrite(m, sizeof y, 1, stdout);
    }
    return 0;
}
"""


def test_an_estimator_alone_leaves_the_state_that_it_leaves_in_python(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    y = rng.normal(scale=3.0, size=(200, 6))
    y[5:100, 1] += np.linspace(0, 20, 95)  # whole turns
    y[[20, 21, 50, 70], [0, 1, 2, 3]] = np.nan  # of which the last is a rate, which does not count
    folder = export(controller_named("Differences", RIG), RIG, "c", tmp_path)
    found = foreign.run(foreign.build("gcc", folder, STATES, folder / "law.c"), y).reshape(-1, 6)
    follow = Differences(RIG).follow(1)
    assert_allclose(found, [follow(row[None], np.zeros(1))[0] for row in y], rtol=1e-12, atol=1e-12)


@pytest.mark.slow  # a minute, most of it the compiler's
def test_nmpc_in_c_answers_as_in_casadi_and_almost_as_nmpc_where_it_balances(tmp_path: Path) -> None:
    folder, nmpc = export(NMPC(RIG), RIG, "c", tmp_path), NMPC(RIG)
    assert not HEAP.search((folder / "plan.c").read_text())

    def forces(x0: Any, samples: int) -> Any:
        u = loop(folder, "c", x0, samples, ("law.c", "plan.c"))[1]
        twin = dpend.simulate(UNLIMITED, RealTimeNMPC(nmpc), x0, samples * RIG.sample_time, task=None).u
        assert_allclose(u / 40, twin / 40, rtol=0, atol=1e-9)
        return u

    fatrop = dpend.simulate(UNLIMITED, nmpc, X0, SAMPLES * RIG.sample_time, task=None).u
    assert_allclose(forces(X0, SAMPLES) / 40, fatrop / 40, rtol=0, atol=1e-3)  # whose tolerance is 1e-4
    forces(np.array([0.0, 0.3, -0.2, 0.0, 0.0, 0.0]), 40)  # which it loses, and NMPC does not
    assert not forces(dpend.EQUILIBRIA["down-down"], 5).any()  # it finds no plan


@pytest.mark.parametrize("name", ["ppo-swing-up", "ppo-swing-up-smooth", "ddpg-balance"])
@pytest.mark.parametrize(("real", "allowed"), [("double", 1e-9), ("float", 1e-5)])
def test_a_network_in_onnx_answers_and_balances_as_in_python(
    name: str, real: str, allowed: float, tmp_path: Path
) -> None:
    reference = pytest.importorskip("onnx.reference", reason="needs the extra onnx: pip install -e '.[onnx]'")
    policy: Any = load_policy(name)
    folder = export(policy, RIG, "onnx", tmp_path, real=real)
    done = subprocess.run([sys.executable, folder / "check.py"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    session = reference.ReferenceEvaluator(str(folder / "policy.onnx"))
    given = {"last": np.zeros((1, 1), dtype=np.dtype(real.replace("float", "float32")))}
    given = given if "last" in session.input_names else {}
    hold = int({each.key: each.value for each in session.proto_.metadata_props}["hold"])
    found: list[Any] = []

    def law(t: float, y: Any) -> float:
        if round(t / RIG.sample_time) % hold == 0:
            results = session.run(None, given | {"y": y[None].astype(real.replace("float", "float32"))})
            found[:] = [results[0].item()]
            given.update({"last": results[1]} if given else {})
        return found[0]

    loops = [dpend.simulate(RIG, each, X0, 6.0, task=None).u / 40 for each in (law, policy)]
    assert_allclose(*loops, rtol=0, atol=allowed)


def test_only_networks_go_to_onnx_and_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(
        NotExportable, match=whole("LQR cannot be exported: it is no network, for which ONNX is; take C.")
    ):
        files(LQR(RIG), RIG, "onnx")
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(ImportError, match=whole("ONNX needs the extra `onnx`: pip install -e '.[onnx]'")):
        files(load_policy("ppo-balance"), RIG, "onnx")  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("name", ["LQR", "ppo-swing-up"])
def test_a_law_in_single_precision_compiles_and_differs_by_its_rounding(name: str, tmp_path: Path) -> None:
    folder = export(LAWS[name](), RIG, "c", tmp_path, real="float")
    assert "double" not in (folder / "law.c").read_text() + (folder / "law.h").read_text()
    assert "forces, at most" in checked(folder, "c")


@pytest.mark.parametrize("to", ["c", "js"])
def test_where_a_measurement_is_missing_the_last_one_counts(to: str, tmp_path: Path) -> None:
    y = np.random.default_rng(0).normal(size=(60, 6))
    y[[0, 1, 10, 11, 30], [0, 3, 1, 5, 2]] = [np.nan, np.inf, np.nan, -np.inf, np.nan]
    lqr = LQR(RIG)
    act = lqr.start(1, np.random.default_rng(0))
    expected = np.clip([float(act(0.0, row[None])[0]) for row in y], -40, 40)
    assert_array_equal(expected[:2], 0)
    folder = export(lqr, RIG, to, tmp_path)
    rows = (f"0,{','.join(map(repr, [*row.tolist(), u]))}" for row, u in zip(y, expected.tolist(), strict=True))
    text = "\n".join(rows)
    (folder / "vector.csv").write_text(text.replace("inf", "Infinity").replace("nan", "NaN") if to == "js" else text)
    assert checked(folder, to).startswith("60 forces")


@pytest.mark.parametrize("law", [LQR(RIG), WithEstimator(Differences(RIG), LQR(RIG))], ids=["LQR", "differences"])
def test_the_loop_of_the_readme_compiles(law: Any, tmp_path: Path) -> None:
    folder = export(law, RIG, "c", tmp_path)
    (loop,) = re.findall(r"```c\n(.*?)```", (folder / "README.md").read_text(), flags=re.DOTALL)
    board = "static int read_encoders(double *y) { return (y[0] = y[1] = y[2] = 0.0) == 0.0; }\n"
    board += "static int late(void) { return 0; }\nstatic void set_force(double u) { (void)u; }\n"
    board += "static void kick_watchdog(void) { }\nvoid every_sample(void);\n"
    run = "int main(void) { law_reset(m); every_sample(); return 0; }\n"
    foreign.build("gcc", folder, board + loop + run, folder / "law.c")


def test_the_header_says_states_units_clock_and_limits() -> None:
    header = files(LQR("pilco2011"), dpend.rig("pilco2011"), "c", "float")["law.h"]
    assert "pos [m], th1 [rad], th2 [rad], vel [m/s], om1 [rad/s], om2 [rad/s]" in header
    assert "#define LAW_SAMPLE_TIME 0.05f /* s: call it at this rate */" in header
    assert "#define LAW_FORCE_LIMIT 20.0f /* N */" in header
    assert (
        "export const FORCE_LIMIT = Infinity; // N"
        in files(LQR("bogdanov2004"), dpend.rig("bogdanov2004"), "js")["law.mjs"]
    )


@pytest.mark.parametrize(
    ("controller", "message"),
    [
        (lambda: SDRE(RIG), "SDRE cannot be exported: it solves a Riccati equation at every sample."),
        (
            lambda: NMPC(RIG, setpoint=lambda t: 0.0),
            "NMPC cannot be exported: a set-point that is a function of time is Python's own.",
        ),
        (
            lambda: WithEstimator(EKF(RIG), LQR(RIG)),
            "LQR behind EKF cannot be exported: of the estimators Differences alone is linear; EKF carries the plant "
            "itself along.",
        ),
        (
            lambda: LowPass(RIG, WithEstimator(Differences(RIG), LQR(RIG)), frequency=10.0),
            "LQR behind Differences, low-pass 10 Hz cannot be exported: an estimator belongs outermost.",
        ),
        (
            lambda: SwitchingController(RIG, LQR(RIG)),
            None,
        ),
    ],
)
def test_what_is_no_formula_is_refused_with_the_reason(controller: Callable[[], Any], message: str | None) -> None:
    with pytest.raises(NotExportable, match=message and whole(message)):
        files(controller(), RIG, "c")


def test_a_function_that_branches_or_remembers_is_refused() -> None:
    calls: list[int] = []

    def growing(t: float, x: Any) -> Any:
        calls.append(0)
        return len(calls) * x[0]

    truth = "a recorded number has no truth value, so that nothing can branch on it"
    for law, why in (
        (lambda t, x: 1.0 if x[1] > 0 else -1.0, "'>' not supported between instances of 'Number' and 'int')."),
        (lambda t, x: 1.0 if x[1] else -1.0, f"arithmetic, sines and cosines without a branch ({truth})."),
        (growing, "it computes something else when it is called again, so it has a memory."),
    ):
        with pytest.raises(NotExportable, match=re.escape(why) + "$"):
            export(law, RIG, "c", "nowhere")
    assert not Path("nowhere").exists()


def test_names_stand_for_contenders_policies_and_functions_of_ones_own(tmp_path: Path) -> None:
    own = tmp_path / "own.py"
    own.write_text("def steady(t, x):\n    return -3.0 * x[0]\n")
    assert isinstance(controller_named("TVLQR", RIG), TVLQR)
    assert repr(controller_named("ppo-balance", RIG)) == repr(load_policy("ppo-balance"))
    assert "u = (-3.0) * m0;" in files(controller_named(f"{own}:steady", RIG), RIG, "c")["law.c"]
    with pytest.raises(
        ValueError, match=r"^No contender, shipped policy or file is called 'TVLQ'\. Did you mean 'TVLQR'\?$"
    ):
        controller_named("TVLQ", RIG)


def test_the_command_writes_the_folder_or_says_why_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["export", "lspi", "--to", "js", "--out", str(tmp_path / "law")])
    runpy.run_module("studies.export", run_name="__main__")
    names = {"law.mjs", "plant.mjs", "check.mjs", "vector.csv", "README.md"}
    assert {file.name for file in (tmp_path / "law").iterdir()} == names
    monkeypatch.setattr("sys.argv", ["export", "SDRE", "--to", "c", "--out", str(tmp_path / "other")])
    with pytest.raises(SystemExit):
        runpy.run_module("studies.export", run_name="__main__")
    assert capsys.readouterr().err == "SDRE cannot be exported: it solves a Riccati equation at every sample.\n"
    assert not (tmp_path / "other").exists()
