r"""The equations as C99 and as an ES module: traced from :mod:`dpend.equations`, which alone states them.

Numbers that record what is done to them go through the functions that numpy, numba and CasADi use.  What was recorded
is written out as straight-line code in which every common sub-expression is computed once.  The code allocates nothing.
Sine and cosine are written out too, as the polynomials that the simulator uses, or left to the mathematical library; of
that it otherwise needs rounding and, for smooth Coulomb friction, the square root.

``python -m dpend.emit gustafsson2016 --to c`` prints the plant with the numbers of a rig.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np

from . import equations
from .arguments import checked_name
from .params import Coefficients, Params
from .rig import Rig, single_rig
from .tape import Tape, number
from .trigonometry import make_sines

LANGUAGES = ("c", "js")
REALS = ("double", "float")
SINES = ("inline", "library")


def translated(text: str, to: str, real: str = "double") -> str:
    """Return code in the common form of both languages as one of them.

    The common form is C with ``real`` for the type; of the mathematical library ``sin``, ``cos``, ``sqrt``, ``fabs``,
    ``tanh`` and ``rint``; and names that begin with ``dpend_``, which JavaScript drops.
    """
    parts = re.split(r"(/\*.*?\*/|//[^\n]*)", text, flags=re.DOTALL)
    return "".join(
        part if i % 2 else _code(part, to, real) for i, part in enumerate(parts)
    )  # comments stay as they are


def _code(text: str, to: str, real: str) -> str:
    mathematics = r"\b(sin|cos|sqrt|fabs|tanh|rint)\("
    if to == "c":
        if real == "float":
            text = re.sub(mathematics, r"\1f(", re.sub(r"(?<![\w.])(\d+\.\d*(e[-+]?\d+)?|\d+e[-+]?\d+)", r"\1f", text))
        return re.sub(r"\breal\b", real, text)
    text = re.sub(r"\b(real|int)\b", "let", re.sub(r"\bconst real\b", "const", text))
    own = {"fabs": "Math.abs(", "rint": "rint("}
    text = re.sub(mathematics, lambda found: own.get(found[1], f"Math.{found[0]}"), text)
    return text.replace("->", ".").replace("dpend_", "").replace("INFINITY", "Infinity")


RINT = "const rint = (v) => v + 6755399441055744 - 6755399441055744; // to even, as C rounds; |v| < 2^51\n"
"""What JavaScript lacks."""


class _Function(NamedTuple):
    """A function of the plant: a name, what it does, what it takes, its results' names, and the traced computation."""

    name: str
    does: str
    takes: Mapping[str, int | Sequence[str] | None]
    gives: int | Sequence[str]
    compute: Callable[..., Sequence[Any]]


_PARAMETERS = tuple(field.name for field in fields(Params))


def _coefficients(p: Any) -> Coefficients:
    p.centers, p.inertias = (p.com1, p.com2), (p.inertia1, p.inertia2)
    return Params.coefficients(p)


def _plant(sines: str) -> tuple[_Function, ...]:
    sin, cos = (np.sin, np.cos) if sines == "library" else make_sines(np.rint)
    rates = equations.make_rates(sin, cos)
    x, c = {"x": 6}, {"c": Coefficients._fields}
    return (
        _Function("lumped", "Lumped coefficients of masses, lengths, centres, inertias, frictions and gravity.",
                  {"p": _PARAMETERS}, Coefficients._fields, _coefficients),
        _Function("rates", "Time derivatives of a state under generalised forces on cart, link 1 and link 2.",
                  x | {"f": 3} | c, 6, rates),
        _Function("rk4", "The state h seconds later under held forces, by one Runge-Kutta step; out may be x.",
                  x | {"f": 3} | c | {"h": None}, 6, equations.make_rk4(rates)),
        _Function("energies", "Kinetic and potential energy, J.", x | c, 2, equations.make_energies(cos)),
        _Function("positions", "Second joint and tip, (x, y) each, m; heights above the cart's joint.",
                  x | c, 4, equations.make_positions(sin, cos)),
    )  # fmt: skip


def _written(function: _Function, to: str) -> str:
    tape, gives = Tape(), function.gives
    results = function.compute(*(tape.inputs(name, entries) for name, entries in function.takes.items()))
    places = [f"out[{i}]" for i in range(gives)] if isinstance(gives, int) else [f"out->{name}" for name in gives]
    body = "".join(f"    {line}\n" for line in tape.lines(dict(zip(places, results, strict=True))))
    if to == "c":
        taken = [_argument(name, entries, "const ") for name, entries in function.takes.items()]
        heading = f"static inline void dpend_{function.name}({', '.join([*taken, _argument('out', gives)])})"
        return f"/* {function.does} */\n{heading}\n{{\n{body}}}\n"
    fresh = f"new Float64Array({gives})" if isinstance(gives, int) else "{}"
    heading = f"export function {function.name}({', '.join(function.takes)}, out = {fresh})"
    return f"/** {function.does} */\n{heading} {{\n{body}    return out;\n}}\n"


def _argument(name: str, entries: int | Sequence[str] | None, const: str = "") -> str:
    if isinstance(entries, int):
        return f"{const}real {name}[{entries}]"
    kind = "parameters" if entries == _PARAMETERS else "coefficients"
    return f"{const}dpend_{kind} *{name}" if entries else f"real {name}"


_ABOUT = """\
/* A double inverted pendulum on a cart, emitted from its equations; SI units.
 * State x: pos [m], th1, th2 [rad, absolute, 0 = up, positive leans to +pos], vel [m/s], om1, om2 [rad/s].
 * Generalised forces f: on the cart [N], on link 1 and on link 2 [N m].  Actuator and sensors are left out. */
"""
_SAMPLE = {
    "c": """\
/* One sample: so many Runge-Kutta steps of h seconds under held forces, in place. */
static inline void dpend_sample(real x[6], const real f[3], const dpend_coefficients *c, real h, int substeps)
{
    int k;
    for (k = 0; k < substeps; k++) dpend_rk4(x, f, c, h, x);
}
""",
    "js": """\
/** One sample: so many Runge-Kutta steps of h seconds under held forces; out may be x. */
export function sample(x, f, c, h, substeps, out = new Float64Array(6)) {
    for (int k = 0; k < 6; k++) out[k] = x[k];
    for (int k = 0; k < substeps; k++) rk4(out, f, c, h, out);
    return out;
}
""",
}


def plant(to: str, rig: Rig | str | None = None, *, real: str = "double", sines: str = "inline") -> str:
    """Return the plant as a C99 header of static functions, or as an ES module.

    It has ``lumped``, ``rates``, ``rk4``, ``sample``, ``energies`` and ``positions``, in C under names that begin
    with ``dpend_``; and with a rig its numbers: coefficients, sample time, substeps, limits.

    Parameters
    ----------
    to : {"c", "js"}
        The language.
    rig : Rig or str, optional
        One rig, or the name of a preset.
    real : {"double", "float"}
        The type of numbers in C.
    sines : {"inline", "library"}
        Whether sine and cosine are the polynomials of :mod:`dpend.trigonometry`, written out, or the library's.  The
        polynomials are faster on a PC, and with them C and JavaScript agree to the last bit unless the compiler fuses
        multiply-adds.  Their error is below 4e-16 for angles up to 1e5; in single precision it is that of the
        angle's own rounding.

    Raises
    ------
    TypeError, ValueError
        If there is no such language or type, or the rig is not one.
    """
    checked_name("to", to, LANGUAGES)
    checked_name("real", real, REALS)
    checked_name("sines", sines, SINES)
    functions = "\n".join([*(_written(function, to) for function in _plant(sines)), _SAMPLE[to]])
    numbers = "" if rig is None else _numbers(single_rig(rig, "dpend.emit.plant"), to)
    if to == "js":
        return translated(f"{_ABOUT}\n{RINT if sines == 'inline' else ''}{functions}{numbers}", to)
    structures = "".join(
        f"typedef struct {{ real {', '.join(names)}; }} dpend_{kind};\n"
        for kind, names in {"parameters": _PARAMETERS, "coefficients": Coefficients._fields}.items()
    )
    code = f"#include <math.h>\n\n{structures}\n{functions}{numbers}"
    return f"{_ABOUT}#ifndef DPEND_PLANT_H\n#define DPEND_PLANT_H\n\n{translated(code, to, real)}\n#endif\n"


def _numbers(rig: Rig, to: str) -> str:
    clock = {"SAMPLE_TIME": number(rig.sample_time), "SUBSTEPS": str(rig.substeps),
             "FORCE_LIMIT": number(float(rig.force_limit)), "TRACK_LIMIT": number(float(rig.track_limit))}  # fmt: skip
    coefficients = {name: number(value) for name, value in rig.params.coefficients()._asdict().items()}
    if to == "js":
        listed = "".join(f"export const {name} = {value};\n" for name, value in clock.items())
        return f"\n{listed}export const RIG = {{ {', '.join(f'{k}: {v}' for k, v in coefficients.items())} }};\n"
    listed = "".join(f"#define DPEND_{name} {value}\n" for name, value in clock.items())
    return f"\n{listed}static const dpend_coefficients dpend_rig = {{ {', '.join(coefficients.values())} }};\n"


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the plant."""
    parser = argparse.ArgumentParser(prog="python -m dpend.emit", description="Print the plant in another language.")
    parser.add_argument("rig", nargs="?", help="the name of a preset, or a file.toml; left out, no numbers of a rig")
    parser.add_argument("--to", choices=LANGUAGES, required=True, help="the language")
    parser.add_argument("--real", choices=REALS, default="double", help="the type of numbers in C")
    parser.add_argument("--sines", choices=SINES, default=SINES[0], help="written out, or from the library")
    options = parser.parse_args(arguments)
    try:
        print(plant(options.to, options.rig, real=options.real, sines=options.sines), end="")
    except (OSError, ValueError) as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
