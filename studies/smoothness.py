"""How smooth is each controller's force, and what does smoothness cost?

Method: every controller balances gustafsson2016 from λ = 0.1 and 0.3 for 6 s, and swings it up from hanging in 10 s,
with perfect sensors and with noise of 0.002 on every measured state, from the same starts; then with devices, and
learned with and without some.  Measured is the force over the whole of the runs that succeed; ratios to a reference are
on the starts that both save.  Medians with 95 % order-statistic intervals; success with Wilson's.

Finding: the task does not need bang-bang forces.  At λ = 0.3 the sign of a stiff LQR saves 88.8 % of 400 starts and LQR
86.2 %, one training each of Q-learning, without a², 84.8 % and of LSPI, with it, 85.0 %.  The two of ±40 N have 405
[365, 452] and 419 [379, 455] times LQR's variation on the starts that both save (84 and 85 times with sensor noise),
change sign 39 times a second (LQR 0.5), spend 9600 N² s (LQR 56), and are saturated all the time.  No device helps: a
low-pass at 8 Hz leaves half of the variation and saves 81.2 %, a rate limit of 800 N/s saves none.
"""

from __future__ import annotations

import itertools
import json
import math
import textwrap
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

import dpend
from controllers import NMPC, LowPass, RateLimit
from dpend.metrics import power_spectrum
from dpend.params import Array
from rl.deep import read_recipe

from . import _field, _runner
from ._estimates import Estimate, mean_share, median, share
from ._field import CONTENDERS, Cost, TaskName, find, longest_first, made, styles
from ._figures import Style, facets, force_trace, intervals, legend_above, log_axis, mosaic, scatter, share_axis, strip
from ._own import Own
from ._plant import Plant, rig_of
from ._runner import AtLeastTwo, Report, Result, Table
from ._tables import Sheet, Value, sheet
from ._trainings import RUNS, Kept, kept

MINUTES = 6

TASKS: Mapping[str, dpend.Balance | dpend.SwingUp] = {
    "balance 0.1": dpend.Balance(lam=0.1),
    "balance 0.3": dpend.Balance(lam=0.3),
    "swing-up": dpend.SwingUp(start="hanging", angle_spread=0.1, steps=500),
}
NAMES: Mapping[str, TaskName] = {"balance 0.1": "balance", "balance 0.3": "balance", "swing-up": "swing-up"}
CONDITIONS = {"perfect": 0.0, "noise": 0.002}
"""Standard deviations of the noise on every measured state."""

METRICS = (
    "variation", "slew", "switches", "saturated", "spectral_share", "effort", "travel", "peak_force", "caps_sm",
    "std_step",
)  # fmt: skip
"""What is measured, as ``docs/metrics.md`` defines it; units are in ``dpend.metrics.UNITS``."""

REFERENCES = {"balance 0.1": "LQR", "balance 0.3": "LQR", "swing-up": "TVLQR"}
"""What the others are compared with, start by start."""


class Device(NamedTuple):
    """What makes a force smooth: its parameter, the values tried, the contenders it is applied to, and how."""

    parameter: str
    settings: tuple[float, ...]
    contenders: tuple[str, ...]
    apply: Callable[[dpend.Rig, dpend.Controller, float], dpend.Controller]


_WRAPPED = ("LQR", "sign of stiff LQR", "Q tuned")
DEVICES = {
    "rate limit": Device("rate limit (N/s)", (100.0, 200.0, 400.0, 800.0, 1600.0, 3200.0), _WRAPPED,
                         lambda rig, controller, rate: RateLimit(rig, controller, rate)),
    "low-pass": Device("low-pass corner (Hz)", (2.0, 4.0, 8.0, 16.0, 32.0), _WRAPPED,
                       lambda rig, controller, corner: LowPass(rig, controller, frequency=corner)),
    "Δu cost": Device("weight of (Δu)² in NMPC (N⁻²)", (0.1, 1.0, 10.0), ("NMPC",),
                      lambda rig, _, weight: NMPC(rig, rate_weight=weight)),
}  # fmt: skip
"""Devices that are applied to a controller; the others are learned with it."""

DEVICE_TASK = "balance 0.3"
SHOWN = (
    "LQR", "tuned linear", "sign of stiff LQR", "Q tuned", "LSPI", "iLQR MPC", "TVLQR", "PPO swing-up",
    "PPO swing-up, smooth", "DDPG swing-up",
)  # fmt: skip
"""Those whose forces and spectra are drawn, beside the user's own."""

_LEAST = 0.01  # u_max/s; what varies less is drawn there


@dataclass(frozen=True, kw_only=True)
class Options(_field.Options):
    """Options of the command line."""

    starts: AtLeastTwo = 400  # Starts of each task; NMPC gets the first part.
    runs: Path = RUNS  # Folder of the deep trainings; with --only they are left out.


@dataclass(frozen=True, kw_only=True)
class Job:
    """One contender, or deep training, with a device at a setting, on one task with one kind of sensors."""

    contender: str
    task: str
    condition: str
    starts: int
    steps: int
    seed: int
    device: str = "none"
    setting: float = 0.0
    training: int = 0  # Seed of a deep training.
    own: Own | None = None
    kept: Kept | None = None
    elsewhere: Plant | None = None


class Smoothed(NamedTuple):
    """Deep trainings of one recipe: what makes them smooth, and how strongly."""

    device: str
    strength: float
    trainings: list[Kept]


def trainings(runs: Path, rig: dpend.Rig) -> dict[str, Smoothed]:
    """Return the trainings in a folder that differ in what makes their force smooth and in nothing else, by recipe.

    They are those of the swing-up on a rig of which a smooth and a plain one are there; they may have ended after
    different experience.
    """
    alike: dict[str, dict[str, Smoothed]] = {}
    for name, found in kept(runs).items():
        recipe = read_recipe(Path(found[0].place))
        if recipe.env or recipe.task != "swing-up" or recipe.rig != rig:
            continue
        record = recipe.to_dict()
        aside = ("caps", "action_rate", "sensor_noise", "steps", "enough", "evaluate_every")
        caps, rate, noise, *_ = (record.pop(key, None) for key in aside)
        means = {"CAPS": max((caps or (0.0,))[:2]), "action rate": rate or 0.0, "noise": noise or 0.0}
        used = {words: weight for words, weight in means.items() if weight}
        smoothed = Smoothed(", ".join(used) or "plain", next(iter(used.values()), 0.0), found)
        alike.setdefault(json.dumps(record, sort_keys=True), {})[name] = smoothed
    ways = [({each.device for each in group.values()}, group) for group in alike.values()]
    both = [group for devices, group in ways if "plain" in devices and len(devices) > 1]
    return {name: smoothed for group in both for name, smoothed in group.items()}


def jobs(options: Options) -> list[Job]:
    """List the work, what takes long first: contenders, with the devices, and deep trainings; if quick, few of each."""
    n, few = (2, slice(-1, None)) if options.quick else (options.starts, slice(None))
    rig, plant = options.plant.rig, options.elsewhere

    def both(task: str, **what: Any) -> list[Job]:
        steps = _steps(task, rig)
        return [Job(task=task, condition=c, steps=steps, seed=options.seed, elsewhere=plant, **what)
                for c in CONDITIONS]  # fmt: skip

    found = []
    for task, name in NAMES.items():
        for contender in options.contenders(name):
            if options.quick and contender.cost is Cost.EXPENSIVE and contender.name not in options.only:
                continue
            what: dict[str, Any] = {"contender": contender.name, "starts": contender.cost.runs(n), "own": contender.own}
            found += both(task, **what)
            for device, (_, settings, wrapped, _) in DEVICES.items() if task == DEVICE_TASK else ():
                if contender.name in wrapped or (contender.own and wrapped == _WRAPPED):
                    for setting in settings[few]:
                        found += both(task, device=device, setting=setting, **what)
    for name, (device, strength, each) in ({} if options.only else trainings(options.runs, rig)).items():
        for task, one in itertools.product(("balance 0.1", "swing-up"), each[few]):
            what = {"contender": name, "starts": n, "training": one.seed, "kept": one}
            found += both(task, device=device, setting=strength, **what)
    order = {contender.name: k for k, contender in enumerate(longest_first(CONTENDERS))}
    return sorted(found, key=lambda job: order.get(job.contender, len(order)))


def _steps(task: str, rig: dpend.Rig) -> int:
    """Return the samples of a task: 300 while balancing, 10 s of a swing-up."""
    return TASKS[task].steps if NAMES[task] == "balance" else round(10 / rig.sample_time)


class Measured(NamedTuple):
    """Runs of one job: which succeeded, the metrics of each, the first force, and the mean spectrum."""

    success: npt.NDArray[np.bool_]
    values: Mapping[str, Array]
    force: Array
    frequency: Array
    density: Array


@cache
def measured(job: Job) -> Measured:
    """Return the runs of one job."""
    rig, task = rig_of(job.elsewhere), replace(TASKS[job.task], steps=job.steps)
    starts = task.starts(np.random.default_rng([job.seed, 21]), job.starts, rig)
    policy = job.kept.read().policy if job.kept else None
    controller = policy or made(find(job.contender, job.own), job.elsewhere, task)
    if job.device in DEVICES:
        controller = DEVICES[job.device].apply(rig, controller, job.setting)
    true = rig.replace(sensor_noise=CONDITIONS[job.condition])
    runs = dpend.simulate_many(true, controller, starts, task=task, seed=job.seed)
    values, saved = runs.metrics() | runs.smoothness(), runs.u[runs.success]
    frequency, density = power_spectrum(saved, rig.sample_time, rig.force_limit)
    mean = density.mean(axis=0) if len(saved) else np.full(len(frequency), np.nan)
    return Measured(runs.success, {name: values[name] for name in METRICS}, runs.u[0, : runs.steps[0]], frequency, mean)


def run(job: Job) -> Result:
    """Measure one job beside its reference, on the same starts; a row for each metric.

    Medians are over the runs that succeed, NaN where none does; ratios over the starts that both save, NaN where the
    reference's metric is zero.
    """
    own = measured(job)
    against = job.contender if job.device in DEVICES else REFERENCES[job.task]
    user = job.own if job.device in DEVICES else None
    other = measured(replace(job, contender=against, own=user, device="none", setting=0.0, training=0, kept=None))
    both = own.success & other.success
    rows = []
    for name, values in own.values.items():
        alike = both & (other.values[name] > 0)
        found, ratio = median(values[own.success]), median(values[alike] / other.values[name][alike])
        numbers = {
            "median": found.value, "low": found.low, "high": found.high, "of_all": np.median(values),
            "ratio": ratio.value, "ratio_low": ratio.low, "ratio_high": ratio.high,
        }  # fmt: skip
        row = {"metric": name, "successes": int(own.success.sum()), "reference": against, "both": int(both.sum())}
        rows.append(row | {key: _short(value) for key, value in numbers.items()})
    if job.device != "none" or not (job.contender in SHOWN or job.own):
        return Result(rows)
    traces = {"force": own.force, "frequency": own.frequency, "density": own.density}
    return Result(rows, {name: np.array([_short(value) for value in trace]) for name, trace in traces.items()})


def _short(value: float | np.floating) -> float:
    return float(f"{value:.5g}")


_TITLES = {"balance 0.1": "balancing, λ = 0.1", "balance 0.3": "balancing, λ = 0.3", "swing-up": "swing-up"}
_LINES = {"perfect": "-", "noise": ":"}
_WORDS = {"perfect": "perfect sensors", "noise": f"sensor noise {CONDITIONS['noise']:g}"}


def report(table: Table) -> Report:
    """Draw success against variation, forces and their spectra, and the devices; tabulate all of it."""
    looks = styles(table.where(device="none")["contender"])
    figures = {"": _pareto(table, looks, "perfect"), "_noise": _pareto(table, looks, "noise")}
    figures["_forces"] = _forces(table, looks, "balance 0.1", 2.0)
    figures["_forces_swing_up"] = _forces(table, looks, "swing-up", 6.0)
    figures["_devices"] = _devices(table, looks)
    sheets = [_metrics_table(table, looks, task, condition) for task in TASKS for condition in CONDITIONS]
    sheets += [_devices_table(table), _trainings_table(table)]
    return Report(figures=figures, tables=sheets)


def success(line: Any) -> Estimate:
    """Return the share of runs that succeeded."""
    return share(line.successes, line.starts)


def variation(line: Any) -> Estimate:
    """Return the variation of the runs that succeeded."""
    return Estimate(line.median, line.low, line.high)


def _ratio(line: Any) -> Estimate:
    return Estimate(line.ratio, line.ratio_low, line.ratio_high)


def _pareto(table: Table, looks: Mapping[str, Style], condition: str) -> Figure:
    """Draw for each task success against total variation, the median over runs that succeed, and the front."""
    figure, axes = facets(len(TASKS), height=8.6, sharex=True)
    lines = list(table.lines(metric="variation", condition=condition, device="none"))
    points: dict[str, dict[str, tuple[Estimate, Estimate]]] = {task: {} for task in TASKS}
    for line in (line for line in lines if line.successes):
        shown = Estimate(*(max(each, _LEAST) for each in variation(line)))
        points[line.task][line.contender] = shown, success(line)
    ends = [bound for own in points.values() for x, _ in own.values() for bound in x] or [0.1, 10.0]
    log_axis(axes[-1, 0])
    axes[-1, 0].set(
        xlim=(min(ends) / 1.6, max(ends) * 1.6), xlabel="total variation of the force ($u_\\mathrm{max}$/s)"
    )
    for axis, task in zip(axes[:, 0], TASKS, strict=True):
        share_axis(axis, "starts that succeed")
        axis.set(ylim=(-0.06, 1.32), yticks=np.linspace(0, 1, 6), title=f"{_TITLES[task]}, {_WORDS[condition]}")
        failed = ", ".join(f"“{line.contender}”" for line in lines if line.task == task and not line.successes)
        if failed:
            words = f"none succeeds:\n{textwrap.fill(failed, 90)}"
            axis.text(0.01, 0.02, words, transform=axis.transAxes, fontsize=7, va="bottom")
    for axis, own in zip(axes[:, 0], points.values(), strict=True):
        labels = {name: name + f" (below {_LEAST:g})" * (x.value <= _LEAST) for name, (x, _) in own.items()}
        if best := front(own.values()):
            x, y = np.transpose([*best, (axis.get_xlim()[1], best[-1][1])])
            axis.step(x, y, where="post", color="#999999", lw=0.8, ls="--", zorder=1)
        scatter(axis, {labels[name]: point for name, point in own.items()}, {labels[name]: looks[name] for name in own})
    return figure


def front(points: Iterable[tuple[Estimate, Estimate]]) -> list[tuple[float, float]]:
    """Return variation and success of the points of which none is both smoother and as successful, smoothest first."""
    best: list[tuple[float, float]] = []
    for x, y in sorted(((x.value, y.value) for x, y in points), key=lambda point: (point[0], -point[1])):
        if not best or y > best[-1][1]:
            best.append((x, y))
    return best


def _forces(table: Table, looks: Mapping[str, Style], task: str, seconds: float) -> Figure:
    """Draw for each contender its force from the first start, and its mean spectrum beside the reference's."""
    of = {"task": task, "device": "none"}
    forces = {name: table.arrays("force", contender=name, condition="perfect", **of) for name in looks}
    forces = {name: force for name, force in forces.items() if force}
    rows = max(len(forces), 1)
    figure, axes = facets(rows, 2, height=0.95 * rows + 0.75, sharex="col", sharey="col", width_ratios=(1.1, 1.0))
    for (left, right), (name, (force,)) in zip(axes, forces.items(), strict=False):
        force_trace(left, force, table.rig.sample_time, seconds, looks[name][0], name)
        if name != REFERENCES[task]:
            _spectrum(right, table, REFERENCES[task], "perfect", of, color="#AAAAAA", lw=0.8)
        for condition, line in _LINES.items():
            _spectrum(right, table, name, condition, of, color=looks[name][0], ls=line, lw=1.1)
        lines = table.lines(metric="spectral_share", contender=name, **of)
        above = dict.fromkeys(CONDITIONS, "-")
        above |= {line.condition: f"{100 * line.median:.2g}" for line in lines if line.successes}
        right.set_title("above 5 Hz: {perfect} %, with noise {noise} %".format(**above), fontsize=7.5)
        right.axvline(5.0, color="#777777", lw=0.6)
    axes[0, 1].set(xscale="log", yscale="log", xlim=(0.15, 25), ylim=(1e-9, 3), yticks=(1e-8, 1e-4, 1))
    log_axis(axes[0, 1], ticks=(0.2, 0.5, 1, 2, 5, 10, 20))
    axes[0, 1].minorticks_off()
    axes[-1, 0].set_xlabel("time (s)")
    axes[-1, 1].set_xlabel("frequency (Hz)")
    figure.supylabel("force on the cart (N), perfect sensors", fontsize=8)
    lines = [Line2D([], [], color="black", ls=line, label=_WORDS[name]) for name, line in _LINES.items()]
    lines.append(Line2D([], [], color="#AAAAAA", label=f"{REFERENCES[task]}, perfect sensors"))
    title = r"right: power spectral density of $u/u_\mathrm{max}$ (1/Hz)"
    figure.legend(handles=lines, title=title, ncols=3, loc="outside upper right")
    return figure


def _spectrum(axis: Axes, table: Table, name: str, condition: str, of: Mapping[str, str], **how: Any) -> None:
    """Draw a spectrum averaged over bins a tenth as wide as their frequency, so that its end is a line and no brush."""
    arrays = (table.arrays(each, contender=name, condition=condition, **of) for each in ("frequency", "density"))
    for frequency, density in zip(*arrays, strict=True):
        place = np.floor(10 * np.log(frequency / frequency[0])).astype(int)
        count = np.bincount(place)
        axis.plot(*(np.bincount(place, column)[count > 0] / count[count > 0] for column in (frequency, density)), **how)


def _devices(table: Table, looks: Mapping[str, Style]) -> Figure:
    """Draw success and variation against each device's parameter, and those of learners with and without theirs."""
    applied = [name for name in DEVICES if len(table.where(device=name))]
    groups = _learned(table)
    layout = [[f"{name} saved", f"{name} varied"] for name in applied]
    layout += [["learned saved"] * 2, ["learned varied"] * 2] if groups else []
    figure, axes = mosaic(layout or [["none"]], height=2.1 * max(len(layout), 1) + 0.8)
    for name in applied:
        _device(axes[f"{name} saved"], axes[f"{name} varied"], table, looks, name)
    for condition, aside in zip(CONDITIONS, (-0.2, 0.2), strict=True) if groups else ():
        for measure, axis in ((success, axes["learned saved"]), (variation, axes["learned varied"])):
            drawn = {words: [each for each in of if each.condition == condition] for words, of in groups.items()}
            of = {words: [*map(measure, lines)] for words, lines in drawn.items()}
            strip(axis, of, ("#333333", "o", "-"), aside=aside, hollow=condition == "noise")
    for name, axis in axes.items():
        if name.endswith("saved"):
            share_axis(axis, "starts that succeed")
        elif name.endswith("varied"):
            log_axis(axis, "y")
            axis.set(ylim=(0.04, 200), ylabel=r"variation ($u_\mathrm{max}$/s)")
    words = "filled: perfect sensors, hollow: sensor noise 0.002; balancing, λ = 0.3, where nothing else is said"
    legend_above(figure, 5, words)
    return figure


def _device(saved: Axes, varied: Axes, table: Table, looks: Mapping[str, Style], device: str) -> None:
    settings = DEVICES[device].settings
    none = settings[0] / 4 if device == "Δu cost" else settings[-1] * 2.2  # where no device at all is drawn
    names = dict.fromkeys(table.where(device=device)["contender"])
    for name, condition, which in itertools.product(names, CONDITIONS, (device, "none")):
        hollow = condition == "noise"
        style = (*looks[name][:2], ":") if hollow else looks[name]
        of = {"contender": name, "condition": condition, "task": DEVICE_TASK, "device": which}
        lines = sorted(table.lines(metric="variation", **of), key=lambda line: line.setting)
        places = [none if which == "none" else line.setting for line in lines]
        label = None if hollow or which == "none" else name
        for axis, measure in ((saved, success), (varied, variation)):
            intervals(axis, places, map(measure, lines), style, hollow=hollow, label=label, lw=1.0)
    for axis in (saved, varied):
        axis.set(xscale="log", xlabel=DEVICES[device].parameter)
        axis.set_xticks([*settings, none], [*(f"{setting:g}" for setting in settings), "none"])
        axis.minorticks_off()


def _learned(table: Table) -> dict[str, list[Any]]:
    """Return lines of Q-learning without and with a² (balancing), and of trainings without and with a device."""

    def lines(name: str, **of: str) -> list[Any]:
        return list(table.lines(metric="variation", contender=name, **of))

    groups = {f"{name}\n{features} a²\nλ = 0.3": lines(name, task=DEVICE_TASK, device="none")
              for name, features in (("Q tuned", "without"), ("LSPI", "with"))}  # fmt: skip
    trained = _trained(table)
    for name, own in trained.items():
        words = (textwrap.fill(name, 10), own[0].device.replace(", ", ",\n"), "swing-up")
        groups["\n".join(words)] = [line for line in own if line.task == "swing-up"]
    if not trained:
        groups |= {n.replace(" ", "\n"): lines(n, task="swing-up") for n in ("PPO swing-up", "PPO swing-up, smooth")}
    return {words: own for words, own in groups.items() if own}


def _trained(table: Table) -> dict[str, list[Any]]:
    """Return the lines of the deep trainings, by recipe, in the order of their seeds."""
    rows = table.where(metric="variation").sort_values("training", kind="stable")
    by_recipe = rows[~rows["device"].isin(["none", *DEVICES])].groupby("contender")
    return {str(name): list(own.itertuples(index=False, name="Line")) for name, own in by_recipe}


_COLUMNS = {
    "variation": "variation, u_max/s", "slew": "slew, u_max/s", "switches": "switches, 1/s",
    "saturated": "saturated, %", "spectral_share": "above 5 Hz, %", "effort": "effort, N² s", "travel": "track, m",
    "caps_sm": "Sm", "std_step": "std Δu, N",
}  # fmt: skip


def _metrics_table(table: Table, looks: Mapping[str, Style], task: str, condition: str) -> Sheet:
    lines, ratio = [], f"variation, times that of {REFERENCES[task]}"
    for name in looks:
        own = {line.metric: line for line in table.lines(contender=name, task=task, condition=condition, device="none")}
        if first := own.get("variation"):
            values = {heading: own[metric].median for metric, heading in _COLUMNS.items()}
            known = {"controller": name, "starts": first.starts, "success, %": success(first)}
            lines.append(known | values | {_COLUMNS["variation"]: variation(first), ratio: _ratio(first)})
    title = f"{_TITLES[task][0].upper()}{_TITLES[task][1:]}, {_WORDS[condition]}"
    note = f"medians over the runs that succeed; times that of {REFERENCES[task]}: on the starts that both save"
    return sheet(title, lines, note=note, brief=("controller", "starts", "success, %", _COLUMNS["variation"], ratio))


def _devices_table(table: Table) -> Sheet:
    lines: list[dict[str, Value]] = []
    for device, (parameter, *_) in DEVICES.items():
        for name in dict.fromkeys(table.where(device=device)["contender"]):
            for setting in (0.0, *sorted(set(table.where(device=device, contender=name)["setting"]))):
                of = {"contender": name, "device": device if setting else "none", "setting": setting}
                said = f"{setting:g}" if setting else "none"
                line: dict[str, Value] = {"device": parameter, "controller": name, "setting": said}
                for own in table.lines(metric="variation", task=DEVICE_TASK, **of):
                    said = ", noise" if own.condition == "noise" else ""
                    line |= {f"success{said}, %": success(own), f"variation{said}, u_max/s": variation(own),
                             f"times that without{said}": _ratio(own) if setting else None}  # fmt: skip
                lines.append(line)
    note = "times that without the device: on the starts saved with it and without it"
    return sheet("What devices cost and buy: balancing, λ = 0.3", lines, note=note)


def _trainings_table(table: Table) -> Sheet:
    lines: list[dict[str, Value]] = []
    for name, own in _trained(table).items():
        count = len({each.training for each in own})
        line: dict[str, Value] = {"training": name, "device": own[0].device, "trainings": count}
        for task, words in (("swing-up", "swing-up"), ("balance 0.1", "λ = 0.1")):
            for condition, said in (("perfect", ""), ("noise", ", noise")):
                same = [each for each in own if (each.task, each.condition) == (task, condition)]
                if condition == "perfect":
                    shares = [each.successes / each.starts for each in same]
                    line[f"{words}: success, %"] = mean_share(shares, [each.starts for each in same])
                known = [each.median for each in same if math.isfinite(each.median)]
                line[f"{words}: variation{said}, u_max/s"] = median(known) if len(known) > 1 else Estimate(*known)
        lines.append(line)
    return sheet("Deep trainings with and without a device, each from nothing; medians over trainings", lines)


if __name__ == "__main__":
    _runner.main("studies.smoothness")
