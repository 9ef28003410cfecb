"""The plant in C and JavaScript is the plant: emitted from the one statement, and held to it by running it."""

from __future__ import annotations

import subprocess
import sys
from functools import cache
from pathlib import Path

import foreign
import numpy as np
import pytest
from rigs import mutated, random_forces, random_params, random_states, whole

import dpend
from dpend import emit, equations
from dpend.emit import plant
from dpend.params import Array, Params
from dpend.rig import Rig
from dpend.tape import Tape

RIGS, STATES = 20, 1000
SUBSTEPS, STEP = 3, 0.01

_C = """\
#include "plant.h"
#include <stdio.h>
int main(void)
{
    double in[24], out[18];
    REAL x[6], f[3], r[18];
    dpend_parameters p;
    dpend_coefficients c;
    int i;
    while (fread(in, sizeof in, 1, stdin) == 1) {
        for (i = 0; i < 15; i++) ((REAL *)&p)[i] = (REAL)in[i];
        for (i = 0; i < 6; i++) x[i] = (REAL)in[15 + i];
        for (i = 0; i < 3; i++) f[i] = (REAL)in[21 + i];
        dpend_lumped(&p, &c);
        dpend_rates(x, f, &c, r);
        dpend_energies(x, &c, r + 6);
        dpend_positions(x, &c, r + 8);
        dpend_sample(x, f, &c, (REAL)STEP, SUBSTEPS);
        for (i = 0; i < 6; i++) r[12 + i] = x[i];
        for (i = 0; i < 18; i++) out[i] = r[i];
        fwrite(out, sizeof out, 1, stdout);
    }
    return 0;
}
"""
_JAVASCRIPT = """\
import { readFileSync, writeSync } from "node:fs";
import { lumped, rates, energies, positions, sample } from "./plant.mjs";
const bytes = readFileSync(0), rows = new Float64Array(bytes.buffer, bytes.byteOffset, bytes.length / 8);
const out = new Float64Array((rows.length / 24) * 18);
for (let k = 0; 24 * k < rows.length; k++) {
    const row = rows.subarray(24 * k, 24 * k + 24), p = {};
    NAMES.forEach((name, i) => { p[name] = row[i]; });
    const x = row.subarray(15, 21), f = row.subarray(21, 24), c = lumped(p);
    out.set([...rates(x, f, c), ...energies(x, c), ...positions(x, c), ...sample(x, f, c, STEP, SUBSTEPS)], 18 * k);
}
const done = Buffer.from(out.buffer);
for (let sent = 0; sent < done.length;) sent += writeSync(1, done, sent);
"""


def filled(template: str, real: str = "double") -> str:
    names = [f'"{name}"' for name in Params(cart_mass=1, mass1=1, mass2=1, length1=1, length2=1).to_dict()]
    words = {"NAMES": f"[{', '.join(names)}]", "REAL": real, "SUBSTEPS": str(SUBSTEPS), "STEP": str(STEP)}
    for word, value in words.items():
        template = template.replace(word, value)
    return template


def program(kind: str, folder: Path, real: str = "double", sines: str = "inline") -> list[str]:
    """Return the command of a program that computes all that the emitted plant can."""
    if kind == "node":
        (folder / "plant.mjs").write_text(plant("js", "gustafsson2016", sines=sines))
        return foreign.script(folder, filled(_JAVASCRIPT))
    (folder / "plant.h").write_text(plant("c", "gustafsson2016", real=real, sines=sines))
    return foreign.build(kind, folder, filled(_C, real))


@cache
def cases() -> tuple[Array, Array]:
    """Return what programs read, (n, 24), and what Python makes of it, (n, 18)."""
    rng = np.random.default_rng(16)
    plants = random_params(rng, RIGS)
    each = Params(**{k: np.repeat(v, STATES) for k, v in plants.to_dict().items() if v is not None})
    x, f = random_states(rng, RIGS * STATES), random_forces(rng, RIGS * STATES)
    resolved = each.to_dict() | dict(zip(("com1", "com2"), each.centers, strict=True))
    numbers = [np.broadcast_to(value, len(x)) for value in resolved.values()]
    rig = Rig(params=each, sample_time=SUBSTEPS * STEP, substeps=SUBSTEPS)
    assert rig.substeps == SUBSTEPS  # no friction is so stiff that it takes more
    stepper = dpend.Stepper(rig, len(x))
    stepper.reset(x)
    after = stepper.step(f[:, 0], f * [0, 1, 1])
    parts = [dpend.rates(x, f, each), np.stack(dpend.energies(x, each), -1), np.stack(dpend.positions(x, each), -1)]
    return np.column_stack([*numbers, x, f]), np.column_stack([*parts, after])


def worst(found: Array, expected: Array) -> float:
    """Return the greatest error of rates, energies, positions and samples relative to the greatest of their numbers."""
    found = found.reshape(expected.shape)
    blocks = [slice(0, 6), slice(6, 8), slice(8, 12), slice(12, 18)]
    return max(
        float(np.max(np.abs(found[:, b] - expected[:, b]).max(axis=1) / np.abs(expected[:, b]).max(axis=1)))
        for b in blocks
    )


@pytest.mark.parametrize("sines", emit.SINES)
@pytest.mark.parametrize("kind", [*foreign.COMPILERS, "node"])
def test_what_is_emitted_computes_what_python_does(kind: str, sines: str, tmp_path: Path) -> None:
    given, expected = cases()
    assert worst(foreign.run(program(kind, tmp_path, sines=sines), given), expected) < 1e-12


def test_with_sines_written_out_c_and_javascript_agree_to_the_last_bit(tmp_path: Path) -> None:
    given, _ = cases()
    results = [foreign.run(program(kind, tmp_path), given) for kind in ("gcc", "node")]
    np.testing.assert_array_equal(results[0], results[1])


def test_single_precision_differs_by_its_rounding_alone(tmp_path: Path) -> None:
    given, expected = cases()
    error = worst(foreign.run(program("gcc", tmp_path, "float"), given), expected)
    assert 1e-8 < error < 1e-3


@pytest.mark.parametrize("kind", [*foreign.COMPILERS, "node"])
def test_a_wrong_sign_in_the_equations_is_a_wrong_sign_in_what_is_emitted(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given, expected = cases()
    monkeypatch.setattr(equations, "make_rates", mutated("s12 = s1 * c2 - c1 * s2", "s12 = s1 * c2 + c1 * s2"))
    assert worst(foreign.run(program(kind, tmp_path), given), expected) > 0.1


def test_a_result_may_be_written_over_an_input() -> None:
    tape = Tape()
    x = tape.inputs("x", 2)
    assert tape.lines({"x[0]": x[1] - x[0], "x[1]": x[0]})[:2] == ["const real x0 = x[0];", "const real x1 = x[1];"]


def test_common_expressions_are_computed_once_and_grouping_is_kept() -> None:
    tape = Tape()
    a, b, c = tape.inputs("a", None), tape.inputs("b", None), tape.inputs("c", None)
    assert tape.lines({"u": np.sin(a * b) + np.sin(b * a)}) == ["const real t0 = sin(a * b);", "u = t0 + t0;"]
    assert tape.lines({"u": a - (b - c) / (a * b) * -c + 2 * abs(c)}) == [
        "u = a - (b - c) / (a * b) * (-c) + 2.0 * fabs(c);"
    ]
    assert tape.lines({"u": (a + (b + c)) ** 2}) == ["const real t0 = a + (b + c);", "u = t0 * t0;"]


def test_what_cannot_be_recorded_or_emitted_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ValueError, match=whole("A recorded number takes the powers 2 and 0.5; got 3.")):
        _ = Tape().inputs("x", None) ** 3
    with pytest.raises(ValueError, match=whole('to must be "c" or "js"; got \'rust\'.')):
        plant("rust")
    with pytest.raises(SystemExit):
        emit.main(["gustafson2016", "--to", "c"])
    assert "There is no preset rig 'gustafson2016'. Did you mean 'gustafsson2016'?" in capsys.readouterr().err


def test_the_command_prints_the_plant_with_the_numbers_of_a_rig(capsys: pytest.CaptureFixture[str]) -> None:
    emit.main(["pilco2011", "--to", "c", "--real", "float"])
    assert capsys.readouterr().out == plant("c", "pilco2011", real="float")
    assert "#define DPEND_FORCE_LIMIT 20.0f" in plant("c", "pilco2011", real="float")
    assert "export const FORCE_LIMIT = Infinity;" in plant("js", "bogdanov2004")


def test_without_jax_the_extra_is_named() -> None:
    program = "import sys; sys.modules['jax'] = None; import dpend.jax_plant"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.stderr.endswith("ImportError: dpend.jax_plant needs JAX, the extra `jax`: pip install -e '.[jax]'\n")
