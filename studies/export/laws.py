r"""Control laws as code in the common form of C and JavaScript, :func:`dpend.emit.translated`.

A law is statements that assign the force ``u``, N, to the measurements in ``m[0]`` to ``m[5]``; ``m[7]`` and what
follows is memory of its own.  Straight-line laws are recorded as the plant is; networks and gains along a trajectory
are loops over tables.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from controllers import (
    NMPC,
    TVLQR,
    BangBang,
    Constant,
    Differences,
    LinearLaw,
    LowPass,
    RateLimit,
    TunedLaw,
    WithEstimator,
)
from controllers.tvlqr import _REACH
from dpend.controller import FunctionController, name_of
from dpend.rig import Rig
from dpend.state import EQUILIBRIA, wrap_angle
from dpend.tape import Tape
from rl.features import make_value_features, slope_features
from rl.policies import INDICATORS, GainPolicy, LinearQPolicy, MLPPolicy, TableOneMean

from .planner import RealTimeNMPC

OWN = 7
"""Where a law's own memory begins: six measurements and whether there were any come before."""
_TURN = repr(2 * math.pi)


class Law(NamedTuple):
    """A control law as code."""

    lines: Sequence[str]
    """Statements in the common form that assign ``u``; ``int i`` and ``real u`` are declared."""
    tables: Mapping[str, npt.NDArray[np.float64]] = {}
    """Constant arrays, flat, by name."""
    memory: Sequence[float] = ()
    """What its own memory begins with."""
    measured: int = 6
    """How many of the measurements it takes: all, or the positions alone."""
    before: str = ""
    """What stands before its functions."""
    sources: Mapping[str, str] = {}
    """Further files of C, by name."""
    notes: str = ""
    """What the README says of it, after a space."""


class NotExportable(ValueError):
    """A controller that has no code in another language; the message says why."""


def law_of(controller: Any, rig: Rig) -> Law:
    """Return a controller as code, for a rig's clock.

    Raises
    ------
    NotExportable
        If it plans, filters or switches at every sample, or is of a kind unknown here.
    """
    for kind, write in _LAWS.items():
        if isinstance(controller, kind):
            return write(controller, rig)
    name = name_of(controller)
    for kind, why in _REASONS.items():
        if any(each.__name__ == kind for each in type(controller).__mro__):
            raise NotExportable(f"{name} cannot be exported: {why}.")
    known = ", ".join(kind.__name__ for kind in _LAWS)
    raise NotExportable(
        f"{name} cannot be exported: of {type(controller).__name__} no formula is known; known: {known}."
    )


_REASONS = {
    "NMPC": "its form in C stands alone; export it without what stands around it",
    "ILQRMPC": "it plans at every sample, and its planner is compiled Python",
    "SDRE": "it solves a Riccati equation at every sample",
    "SwitchingController": "it decides by simulation which law is in charge; export the laws themselves",
    "PlannedPolicy": "it plans at every sample on the model that it learned",
    "ModelPolicy": "it plans at every sample on the model that it learned",
    "EnergySwingUp": "it hands over to another law within a region; export that law",
    "Wrapper": "it is a wrapper of an unknown kind; export the law that it wraps, its `controller`",
    "Network": "a bare network does not say what it observes; wrap it in rl.MLPPolicy",
}  # fmt: skip


def _recorded(compute: Callable[[list[Any]], Any], **tables: Any) -> Law:
    """Return a straight-line law, recorded while it computes a force from six numbers."""
    tape = Tape()
    return Law(tape.lines({"u": compute(tape.inputs("m", 6))}), tables)


def _dot(weights: npt.ArrayLike, numbers: Sequence[Any]) -> Any:
    terms = [weight * each for weight, each in zip(np.asarray(weights).tolist(), numbers, strict=True) if weight]
    return sum(terms[1:], start=terms[0]) if terms else 0.0


def _linear(K: npt.NDArray[np.float64], target: npt.NDArray[np.float64]) -> Law:
    def force(x: list[Any]) -> Any:
        away = [each - at if at else each for each, at in zip(x, target.tolist(), strict=True)]
        return -_dot(K, [away[0], wrap_angle(away[1]), wrap_angle(away[2]), *away[3:]])

    return _recorded(force)


def _bang_bang(controller: BangBang, rig: Rig) -> Law:
    inner, force = law_of(controller.controller, rig), float(controller.force)
    return inner._replace(lines=[*inner.lines, f"u = u > 0.0 ? {force!r} : u < 0.0 ? -{force!r} : 0.0;"])


def _table_one(policy: LinearQPolicy, rig: Rig) -> Law:
    weights = policy.weights[-6:] * policy.scales[-6:]
    weights /= np.abs(weights).max() or 1.0
    slope = _recorded(lambda x: _dot(weights, slope_features(x)), FORCES=policy.forces)
    choice = [
        "const real g = u;",
        "u = FORCES[0];",
        f"for (i = 1; i < {len(policy.forces)}; i++) if (FORCES[i] * g > u * g) u = FORCES[i];",
    ]
    return slope._replace(lines=[*slope.lines, *choice])


def _table_one_mean(policy: TableOneMean, rig: Rig) -> Law:
    tape, count = Tape(), INDICATORS[policy.indicators]
    features = make_value_features()(tape.inputs("m", 6))
    lines = tape.lines({"m[7]": features[3], "m[8]": features[5], "u": _dot(policy.v[:12], features)})
    places = ("m[0]", "m[7]", "m[8]")  # the angles by the nearest turn
    if policy.indicators == "signs":
        lines += [f"if ({place} > 0.0) u += INDICATED[{i}];" for i, place in enumerate(places)]
    if policy.indicators == "cells":
        cell = " + ".join(f"({place} > 0.0 ? {bit} : 0)" for place, bit in zip(places, (4, 2, 1), strict=True))
        lines.append(f"u += INDICATED[{cell}];")
    return Law(lines, {"INDICATED": policy.v[12:]} if count else {}, (0.0, 0.0))


def _tvlqr(controller: TVLQR, rig: Rig) -> Law:
    trajectory, N = controller.trajectory, len(controller.K) - 1
    along = np.vstack([trajectory.x[:-1], trajectory.target])
    tables = {"ALONG": along, "GAINS": controller.K, "FORCES": np.append(trajectory.u, 0.0)}
    if controller.index == "time":
        find = [f"k = m[7] < {N} ? m[7] : {N};", "m[7] += 1.0;"]
        memory = (0.0,)
    else:
        tables["COSTS"] = controller.P
        find = f"""\
int j, n, at = m[7], first, last;
real cost, least = 0.0;
first = at < 0 ? 0 : m[8] >= {_REACH}.0 ? at + 1 : at;
last = at < 0 ? {N} : at + {_REACH};
if (first > {N}) first = {N};
if (last > {N}) last = {N};
for (n = first, k = first; n <= last; n++) {{
    for (i = 0; i < 6; i++) m[9 + i] = m[i] - ALONG[6 * n + i];
    for (i = 1; i < 3; i++) m[9 + i] -= {_TURN} * rint(m[9 + i] / {_TURN});
    cost = 0.0;
    for (i = 0; i < 6; i++) for (j = 0; j < 6; j++) cost += m[9 + i] * COSTS[36 * n + 6 * i + j] * m[9 + j];
    if (n == first || cost < least) {{
        least = cost;
        k = n;
    }}
}}
m[8] = k == at ? m[8] + 1.0 : 0.0;
m[7] = k;""".splitlines()
        memory = (-1.0, *[0.0] * 7)
    act = f"""\
u = FORCES[k];
for (i = 0; i < 6; i++) {{
    real away = m[i] - ALONG[6 * k + i];
    if (i == 1 || i == 2) away -= {_TURN} * rint(away / {_TURN});
    u -= GAINS[6 * k + i] * away;
}}""".splitlines()
    return Law(["int k;", *find, *act], {name: table.ravel() for name, table in tables.items()}, memory)


def held_samples(policy: MLPPolicy, rig: Rig) -> int:
    """Return for how many samples a policy holds a force."""
    return max(math.floor(policy.period * (1 - 1e-6) / rig.sample_time) + 1, 1)  # t > due, as the policy has it


def _network(policy: MLPPolicy, rig: Rig) -> Law:
    network, scales = policy.network, [repr(scale) for scale in policy.scales.tolist()]
    widths = [network.inputs, *map(len, network.biases)]
    seen, spare = OWN + 2, OWN + 2 + max(widths)
    observed = ["m[0] / " + scales[0], "sin(m[1])", "cos(m[1])", "sin(m[2])", "cos(m[2])",
                *(f"m[{3 + i}] / {scales[1 + i]}" for i in range(3)), "m[8]"][: network.inputs]  # fmt: skip
    inside = [f"m[{seen + i}] = {text};" for i, text in enumerate(observed)]
    tables: dict[str, npt.NDArray[np.float64]] = {}
    read, write = seen, spare
    for k, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
        tables |= {f"W{k}": weight.ravel(), f"B{k}": bias}
        last = k == len(network.weights) - 1
        squash = _SQUASHES[network.squash if last else network.activation]
        inside += f"""\
for (i = 0; i < {len(bias)}; i++) {{
    u = B{k}[i];
    for (j = 0; j < {weight.shape[1]}; j++) u += W{k}[{weight.shape[1]} * i + j] * m[{read} + j];
    m[{write} + i] = {squash};
}}""".splitlines()
        read, write = write, read
    inside += [f"m[8] = m[{read}];", f"m[7] = {held_samples(policy, rig)}.0;"]
    lines = ["int j;", "if (m[7] <= 0.0) {", *(f"    {line}" for line in inside), "}", "m[7] -= 1.0;",
             f"u = {float(policy.force_limit)!r} * m[8];"]  # fmt: skip
    return Law(lines, tables, [0.0] * (2 + 2 * max(widths)))


_SQUASHES = {"tanh": "tanh(u)", "relu": "u > 0.0 ? u : 0.0", "clip": "u > 1.0 ? 1.0 : u < -1.0 ? -1.0 : u"}


def _smoothed(controller: RateLimit | LowPass, rig: Rig) -> Law:
    """Return the law and what goes from its last force, behind the law's memory, towards the law's."""
    inner = law_of(controller.controller, rig)
    if inner.measured < 6:
        raise NotExportable(f"{controller.name} cannot be exported: an estimator belongs outermost.")
    last, limit = f"m[{OWN + len(inner.memory)}]", float(controller.rig.force_limit)
    lines = [*inner.lines, f"if (!(fabs(u) < 1e30)) u = {last};"]
    if math.isfinite(limit):
        lines.append(f"u = u > {limit!r} ? {limit!r} : u < -{limit!r} ? -{limit!r} : u;")
    if isinstance(controller, RateLimit):
        most = controller.rate * float(controller.rig.sample_time)
        lines += [f"u -= {last};", f"u = {last} + (u > {most!r} ? {most!r} : u < -{most!r} ? -{most!r} : u);"]
    else:
        lines.append(f"u += {controller._decay!r} * ({last} - u);")
    return inner._replace(lines=[*lines, f"{last} = u;"], memory=[*inner.memory, 0.0])


def _estimated(controller: WithEstimator, rig: Rig) -> Law:
    """Return the law behind differences of positions: those before, and the samples since, are behind its memory."""
    estimator = controller.estimator
    if not isinstance(estimator, Differences):
        raise NotExportable(
            f"{controller.name} cannot be exported: of the estimators Differences alone is linear; "
            f"{type(estimator).__name__} carries the plant itself along."
        )
    inner = law_of(controller.controller, rig)
    before, T = OWN + len(inner.memory), float(estimator.rig.sample_time)
    lines = f"""\
m[{before + 3}] += 1.0;
if (finite) {{
    for (i = 0; i < 3; i++) {{
        m[3 + i] = m[i] - m[{before} + i];
        if (i > 0) m[3 + i] -= {_TURN} * rint(m[3 + i] / {_TURN});
        m[3 + i] *= m[{before + 4}] / (m[{before + 3}] * {T!r});
        m[{before} + i] = m[i];
    }}
    m[{before + 3}] = 0.0;
    m[{before + 4}] = 1.0;
}}""".splitlines()
    return inner._replace(lines=[*lines, *inner.lines], memory=[*inner.memory, *[0.0] * 5], measured=3)


def portable(controller: Any) -> Any:
    """Return what stands for a controller elsewhere: itself, but for NMPC, whose solver is a library of its own."""
    if not isinstance(controller, NMPC):
        return controller
    try:
        return RealTimeNMPC(controller)
    except ValueError as error:
        raise NotExportable(f"{name_of(controller)} cannot be exported: {error}") from None


_PLANNED = """ `plan.c` is CasADi's code: sequential quadratic
programming with its active-set method, without a heap. It needs some 20 kB of the stack and what `LAW_MEMORY` says, and
one thread at a time may be in it. The problem is that of Python's NMPC, which hands it to fatrop, a library: forces
agree up to the tolerance of that. It is for balancing: from far away its one guess rarely leads anywhere, and a sample
then takes long."""


def _planned(controller: RealTimeNMPC, rig: Rig) -> Law:
    """Return the call of CasADi's function, whose memory and room to work in are the law's."""
    header, source = controller.code()
    kept, room = controller.function.size1_in(0), int(re.findall(r"plan_SZ_W (\d+)", header)[0])
    after, work = OWN + kept, OWN + 2 * kept
    lines = f"""\
const casadi_real *arg[plan_SZ_ARG];
casadi_real *res[plan_SZ_RES];
casadi_int iw[plan_SZ_IW];
arg[0] = m + {OWN};
arg[1] = m;
res[0] = m + {after};
res[1] = &u;
if (plan(arg, res, iw, m + {work}, 0)) return 0.0;
for (i = 0; i < {kept}; i++) m[{OWN} + i] = m[{after} + i];""".splitlines()
    return Law(
        lines,
        memory=[0.0] * (2 * kept + room),
        before='#include "plan.h"\n',
        sources={"plan.h": header, "plan.c": source},
        notes=_PLANNED,
    )


def _function(controller: FunctionController, rig: Rig) -> Law:
    """Record a plain function of time and state, which must not branch."""

    def recorded() -> list[str]:
        tape = Tape()
        x, time = np.array(tape.inputs("m", 6)), tape.inputs("m[7]", None) * float(rig.sample_time)
        return tape.lines({"u": np.asarray(controller.law(time, x)).item()})  # pyright: ignore[reportArgumentType]

    refused = f"{controller.name} cannot be exported: "
    try:
        lines = recorded()
        same = lines == recorded()
    except Exception as error:
        raise NotExportable(f"{refused}it must be arithmetic, sines and cosines without a branch ({error}).") from error
    if not same:
        raise NotExportable(f"{refused}it computes something else when it is called again, so it has a memory.")
    return Law([*lines, "m[7] += 1.0;"], memory=(0.0,))


_LAWS: dict[type, Callable[[Any, Rig], Law]] = {
    Constant: lambda law, rig: Law([f"u = {float(law.force)!r};"]),
    LinearLaw: lambda law, rig: _linear(law.K[0], law.target),
    TunedLaw: lambda law, rig: law_of(law.controller, rig),
    BangBang: _bang_bang,
    GainPolicy: lambda law, rig: _linear(law.K, EQUILIBRIA["up-up"]),
    LinearQPolicy: _table_one,
    TableOneMean: _table_one_mean,
    TVLQR: _tvlqr,
    MLPPolicy: _network,
    RateLimit: _smoothed,
    LowPass: _smoothed,
    WithEstimator: _estimated,
    RealTimeNMPC: _planned,
    FunctionController: _function,
}
