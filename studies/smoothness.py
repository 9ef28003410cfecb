"""How smooth is each controller's force, and what does smoothness cost?

Method: every controller balances gustafsson2016 from λ = 0.1 and 0.3 for 6 s, and swings it up from hanging (angles
within 0.1 rad) in 10 s, with perfect sensors and with noise of 0.002 (m, rad, m/s, rad/s) on every measured state; all
meet the same starts and the same noise, planners the first part of them.  Measured is the force over the whole of the
runs that succeed, since one that falls early has figures of its fall; beside it stand all runs, and the ratio to one
reference (LQR, TVLQR, or the same controller without a device) on the starts that both save.  Medians over starts with
95 % order-statistic intervals; success with Wilson's.  Learned controllers are the policies that are shipped, one
training of each.

Then what smoothing costs at λ = 0.3: a rate limit and a low-pass around LQR, the sign of a stiff LQR and Q-learning; a
cost on the change of force in NMPC; a² among Q-learning's features; and of the swing-up, trainings with a penalty on
the action's rate and with CAPS (``--runs``).  A controller of yours takes part, and wears both devices:
``--controller path.py:factory``.

Finding: bang-bang is no need of the task.  At λ = 0.3 the sign of a stiff LQR saves 88.8 % of 400 starts and LQR
86.2 %, Q-learning tuned 84.8 % without and LSPI 85.0 % with a².  The two of ±40 N have 403 [361, 453] and 419 [376,
459] times LQR's variation on the starts that both save (84 and 85 times with sensor noise), change sign 39 times a
second (LQR 0.5), spend 9600 N² s (LQR 56), and are saturated all the time.  No device mends them: a low-pass at 8 Hz
leaves half of the variation and saves 81.2 %, a rate limit of 800 N/s saves none.
"""

from __future__ import annotations

import json
import textwrap
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, PercentFormatter
from rich.console import Group, RenderableType

import dpend
from controllers import NMPC, LowPass, RateLimit
from dpend.metrics import power_spectrum
from dpend.params import Array
from dpend.provenance import fingerprint
from rl import DeepRecipe, load_policy

from . import _entrants, _study
from ._entrants import RIG, Style, styles
from ._intervals import Rate, median, over_seeds, wilson
from ._labels import place_labels
from ._page import Cell, Column, markdown, terminal
from ._study import Job, Result, Traces

TASKS: dict[str, dpend.Balance | dpend.SwingUp] = {
    "balance 0.1": dpend.Balance(lam=0.1),
    "balance 0.3": dpend.Balance(lam=0.3),
    "swing-up": dpend.SwingUp(start="hanging", angle_spread=0.1, steps=500),
}
CONDITIONS = {"perfect": 0.0, "noise": 0.002}
"""Standard deviations of the noise on every measured state."""

METRICS = (
    "variation", "slew", "switches", "saturated", "spectral_share", "effort", "travel", "peak_force", "caps_sm",
    "std_step",
)  # fmt: skip
"""What is measured, as ``docs/metrics.md`` defines it; units are in ``dpend.metrics.UNITS``."""

REFERENCES = {"balance 0.1": "LQR", "balance 0.3": "LQR", "swing-up": "TVLQR"}
"""Whom the others are compared with, start by start."""


class Device(NamedTuple):
    """What makes a force smooth: its parameter in words, the values tried, and who wears it."""

    parameter: str
    settings: tuple[float, ...]
    worn_by: tuple[str, ...]
    put_on: Callable[[dpend.Controller, float], dpend.Controller]


_WORN_BY = ("LQR", "sign of stiff LQR", "Q tuned")
DEVICES = {
    "rate limit": Device(
        "rate limit (N/s)", (100.0, 200.0, 400.0, 800.0, 1600.0, 3200.0), _WORN_BY,
        lambda inner, rate: RateLimit(RIG, inner, rate),
    ),
    "low-pass": Device(
        "low-pass corner (Hz)", (2.0, 4.0, 8.0, 16.0, 32.0), _WORN_BY,
        lambda inner, corner: LowPass(RIG, inner, frequency=corner),
    ),
    "Δu cost": Device(
        "weight of (Δu)² in NMPC (N⁻²)", (0.1, 1.0, 10.0), ("NMPC",), lambda _, weight: NMPC(RIG, rate_weight=weight)
    ),
}  # fmt: skip
"""Devices that are put on a controller; the others are learned with it."""

_DEVICE_TASK = "balance 0.3"
RUNS = Path("docs/results/deep")
"""Where deep trainings are kept, seen from the repository."""

SHOWN = (
    "LQR", "sign of stiff LQR", "Q tuned", "LSPI", "iLQR MPC", "TVLQR", "PPO swing-up", "PPO swing-up, smooth",
    "DDPG swing-up",
)  # fmt: skip
"""Those whose forces and spectra are drawn, beside the user's own."""


@dataclass(frozen=True, kw_only=True)
class Options(_entrants.Options):
    """What can be told on the command line."""

    starts: int = 400
    """Starts of each task; controllers that take long meet the first part."""
    runs: Path = RUNS
    """Folder of the deep trainings; with --only they are left out."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_least(2, "starts")


class Case(NamedTuple):
    """What a job is about: who, with which device at which setting, at what, with which sensors."""

    controller: str
    task: str
    condition: str
    device: str = "none"
    setting: str = "0"
    training: int = 0

    def job(self, source: str = "") -> Job:
        """Return the job of the case."""
        return Job(" + ".join(self[:-1]), self.training, source)

    @classmethod
    def of(cls, job: Job) -> Case:
        """Return the case of a job."""
        controller, task, condition, device, setting = job.setting.split(" + ")
        return cls(controller, task, condition, device, setting, job.repetition)


@dataclass(frozen=True, kw_only=True)
class Row:
    """One metric of one controller, on one task with one kind of sensors."""

    controller: str
    device: str
    """What makes its force smooth, or none."""
    setting: float
    training: int
    """Seed, of a deep training; 0 for all others."""
    task: str
    condition: str
    starts: int
    successes: int
    metric: str
    median: float
    """Over the runs that succeed; not a number where none does."""
    low: float
    high: float
    of_all: float
    """Median over all runs, those that failed too."""
    reference: str
    """Whom it is compared with."""
    both: int
    """Starts that both save."""
    ratio: float
    """Median over those of the ratio to the reference; not a number where the reference's is zero."""
    ratio_low: float
    ratio_high: float


# ------------------------------------------------------------------------------------------------------------ the work


class Training(NamedTuple):
    """A deep training: where its policy is, what it was made smooth by, and how strongly."""

    folder: Path
    device: str
    strength: float


@cache
def trainings(runs: Path) -> list[Training]:
    """Find the trainings that differ in what makes their force smooth and in nothing else.

    Parameters
    ----------
    runs : Path
        Folder with a folder each, such as ``ppo-swing-up-caps/seed-10``, of ``recipe.json`` and ``policy.npz``.

    Returns
    -------
    list of Training
        Of the swing-up on our plant, of each learner of which a smooth and a plain one are there; they may have
        ended after different experience.
    """
    alike: dict[str, list[Training]] = {}
    for policy in sorted(runs.glob("*/seed-*/policy.npz"), key=lambda file: (file.parts[-3], _seed(file.parent))):
        recipe = json.loads((policy.parent / "recipe.json").read_text(encoding="utf-8"))["recipe"]
        if recipe["env"] or recipe["task"] != "swing-up" or recipe["rig"] != RIG.to_dict():
            continue
        means = {"CAPS": max(recipe["caps"][:2]), "action rate": recipe["action_rate"]}
        means["noise"] = recipe.get("sensor_noise", 0.0)
        used = {name: weight for name, weight in means.items() if weight}
        device, strength = ", ".join(used) or "plain", next(iter(used.values()), 0.0)
        aside = ("caps", "action_rate", "sensor_noise", "steps", "enough", "evaluate_every")
        # A setting that is younger than the training was at its default.
        recipe = DeepRecipe(**recipe | {"rig": RIG}).to_dict()
        recipe = {name: value for name, value in recipe.items() if name not in aside}
        alike.setdefault(json.dumps(recipe, sort_keys=True), []).append(Training(policy.parent, device, strength))
    pairs = [group for group in alike.values() if len({found.device for found in group}) > 1]
    return [found for group in pairs for found in group if any(other.device == "plain" for other in group)]


def _seed(folder: Path) -> int:
    return int(folder.name.removeprefix("seed-"))


def cases(options: Options) -> Iterator[tuple[Case, str]]:
    """List what is measured, each with the source of what comes from outside; where it must be quick, some of it."""
    for task in TASKS:
        for entrant in options.entrants("swing-up" if task == "swing-up" else "balance"):
            for condition in CONDITIONS:
                yield Case(entrant.name, task, condition), entrant.source
    for entrant in options.entrants("balance"):
        for name, device in DEVICES.items():
            if entrant.name in device.worn_by or (entrant.source and device.worn_by == _WORN_BY):
                for setting in device.settings[: 1 if options.quick else None]:
                    for condition in CONDITIONS:
                        yield Case(entrant.name, _DEVICE_TASK, condition, name, f"{setting:g}"), entrant.source
    for training in [] if options.only else trainings(options.runs):
        for task in ("balance 0.1", "swing-up"):
            for condition in CONDITIONS:
                case = Case(
                    training.folder.parts[-2], task, condition, training.device, f"{training.strength:g}",
                    _seed(training.folder),
                )  # fmt: skip
                yield case, fingerprint(training.folder / "policy.npz")


def jobs(options: Options) -> list[Job]:
    """List the work: one job a case."""
    return [case.job(source) for case, source in cases(options)]


class Measured(NamedTuple):
    """Runs of one case: which succeeded, the metrics of each, the first force, and the mean spectrum."""

    success: npt.NDArray[np.bool_]
    values: dict[str, Array]
    force: Array
    frequency: Array
    density: Array


@cache
def measured(case: Case, options: Options) -> Measured:
    """Run one case; ``--quick`` from two starts for a moment."""
    task = replace(TASKS[case.task], steps=25) if options.quick else TASKS[case.task]
    starts = task.starts(np.random.default_rng([options.seed, 21]), 2 if options.quick else options.starts, RIG)
    if case.device in ("none", *DEVICES):
        entrant = options.entrant(case.controller)
        controller = entrant.make(RIG, task)
        starts = starts[: entrant.runs(len(starts))]
        if case.device in DEVICES:
            controller = DEVICES[case.device].put_on(controller, float(case.setting))
    else:
        policy = load_policy(options.runs / case.controller / f"seed-{case.training}" / "policy.npz")
        assert isinstance(policy, dpend.Controller)
        controller = policy
    true = RIG.replace(sensor_noise=CONDITIONS[case.condition])
    runs = dpend.simulate_many(true, controller, starts, task=task, seed=options.seed)
    values = runs.metrics() | runs.smoothness()
    saved = runs.u[runs.success]
    frequency, density = power_spectrum(saved, RIG.sample_time, RIG.force_limit)
    return Measured(
        runs.success,
        {name: values[name] for name in METRICS},
        runs.u[0, : runs.steps[0]],
        frequency,
        density.mean(axis=0) if len(saved) else np.full(len(frequency), np.nan),
    )


def run(job: Job, options: Options) -> Result:
    """Measure one case beside its reference, on the same starts."""
    case = Case.of(job)
    own = measured(case, options)
    n = len(own.success)
    against = REFERENCES[case.task] if case.device not in DEVICES else case.controller
    other = measured(Case(against, case.task, case.condition), options)
    both = own.success & other.success[:n]
    rows = []
    for name, values in own.values.items():
        theirs = other.values[name][:n]
        alike = both & (theirs > 0)
        found, ratio = median(values[own.success]), median(values[alike] / theirs[alike])
        rows.append(
            Row(
                controller=case.controller,
                device=case.device,
                setting=float(case.setting),
                training=case.training,
                task=case.task,
                condition=case.condition,
                starts=n,
                successes=int(own.success.sum()),
                metric=name,
                median=_short(found.median),
                low=_short(found.low),
                high=_short(found.high),
                of_all=_short(np.median(values)),
                reference=against,
                both=int(both.sum()),
                ratio=_short(ratio.median),
                ratio_low=_short(ratio.low),
                ratio_high=_short(ratio.high),
            )
        )
    if case.device != "none" or (case.controller not in SHOWN and not job.source):
        return Result(rows)
    traces = {"force": own.force, "frequency": own.frequency, "density": own.density}
    return Result(rows, {name: np.array([_short(value) for value in trace]) for name, trace in traces.items()})


def _short(value: float | np.floating) -> float:
    return float(f"{value:.5g}")


# ------------------------------------------------------------------------------------------------------------- figures


def found(rows: list[Row], metric: str, **wanted: object) -> list[Row]:
    """Return the rows of one metric whose other columns are as wanted."""
    return [
        row
        for row in rows
        if row.metric == metric and all(getattr(row, column) == value for column, value in wanted.items())
    ]


def success(row: Row) -> Rate:
    """Return the share of runs that succeeded, with its interval."""
    return wilson(row.successes, row.starts)


_TITLES = {"balance 0.1": "balancing, λ = 0.1", "balance 0.3": "balancing, λ = 0.3", "swing-up": "swing-up"}
_LEAST = 0.01  # u_max/s; what varies less is drawn there
_LINES = {"perfect": "-", "noise": ":"}
_WORDS = {"perfect": "perfect sensors", "noise": f"sensor noise {CONDITIONS['noise']:g}"}


def plot(rows: list[Row], traces: Traces) -> dict[str, Figure]:
    """Draw success against variation, forces and their spectra, and the devices."""
    return {
        "": _plot_pareto(rows, "perfect"),
        "_noise": _plot_pareto(rows, "noise"),
        "_forces": _plot_forces(rows, traces, "balance 0.1", 2.0),
        "_forces_swing_up": _plot_forces(rows, traces, "swing-up", 6.0),
        "_devices": _plot_devices(rows),
    }


def _plot_pareto(rows: list[Row], condition: str) -> Figure:
    """Draw for each task success against total variation, one labelled point a controller, and the front."""
    figure = Figure(figsize=(6.8, 8.6), layout="constrained")
    axes = figure.subplots(len(TASKS), 1, sharex=True)
    style = styles(_present(rows))
    shown = [row for row in found(rows, "variation", condition=condition, device="none") if row.successes]
    limits = [_drawn(bound) for row in shown for bound in (row.low, row.high)] or [0.1, 10.0]
    axes[-1].set(xscale="log", xlim=(min(limits) / 1.6, max(limits) * 1.6))
    axes[-1].set_xlabel("total variation of the force (force limits per second), median over runs that succeed")
    axes[-1].xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    for axis, task in zip(axes, TASKS, strict=True):
        axis.set(ylim=(-0.06, 1.32), yticks=np.linspace(0, 1, 6), ylabel="starts that succeed")
        axis.set_title(f"{_TITLES[task]}, {_WORDS[condition]}", fontsize=9, loc="left", pad=3)
        axis.yaxis.set_major_formatter(PercentFormatter(1.0))
        axis.tick_params(labelsize=8)
        axis.xaxis.label.set_fontsize(9)
        axis.yaxis.label.set_fontsize(9)
        axis.grid(alpha=0.3)
    for axis, task in zip(axes, TASKS, strict=True):
        _plot_points(axis, [row for row in shown if row.task == task], style)
        every = found(rows, "variation", condition=condition, device="none", task=task)
        failed = textwrap.fill(", ".join(f"“{row.controller}”" for row in every if not row.successes), 90)
        if failed:
            axis.text(0.01, 0.02, f"none succeeds:\n{failed}", transform=axis.transAxes, fontsize=7, va="bottom")
    return figure


def _drawn(variation: float) -> float:
    """Return where a variation stands on an axis that has no zero."""
    return max(variation, _LEAST)


def _plot_points(axis: Axes, rows: list[Row], style: dict[str, Style]) -> None:
    """Draw labelled points with their intervals, and the front as steps."""
    boxes = []
    for row in rows:
        colour, marker, _ = style[row.controller]
        share = success(row)
        x, low, high = _drawn(row.median), _drawn(row.low), _drawn(row.high)
        boxes += [(low, high, share.share, share.share), (x, x, share.low, share.high)]
        axis.errorbar(
            x, share.share, xerr=[[x - low], [high - x]], yerr=[[share.share - share.low], [share.high - share.share]],
            color=colour, marker=marker, ms=5, lw=0.9, capsize=2, zorder=3,
        )  # fmt: skip
    best = front(rows)
    if best:
        x, y = np.array([*best, (axis.get_xlim()[1], best[-1][1])]).T
        axis.step(np.maximum(x, _LEAST), y, where="post", color="#999999", lw=0.8, ls="--", zorder=1)
    names = [row.controller + ("" if row.median >= _LEAST else f" (below {_LEAST:g})") for row in rows]
    places = [_drawn(row.median) for row in rows], [success(row).share for row in rows]
    place_labels(axis, *places, names, avoid=np.array(boxes))


def front(rows: list[Row]) -> list[tuple[float, float]]:
    """Return variation and success of those than whom nobody is both smoother and as successful, smoothest first."""
    best: list[tuple[float, float]] = []
    for row in sorted(rows, key=lambda row: (row.median, -row.successes / row.starts)):
        share = row.successes / row.starts
        if not best or share > best[-1][1]:
            best.append((row.median, share))
    return best


def _plot_forces(rows: list[Row], traces: Traces, task: str, seconds: float) -> Figure:
    """Draw for each controller its force from the first start, and its mean spectrum beside LQR's or TVLQR's."""
    kept = {
        name: {condition: traces.get(_study.slug(Case(name, task, condition).job()), {}) for condition in CONDITIONS}
        for name in _present(rows)
    }
    names = [name for name, of in kept.items() if of["perfect"]]
    style = styles(_present(rows))
    figure = Figure(figsize=(6.8, 0.95 * len(names) + 0.75), layout="constrained")
    axes = figure.subplots(max(len(names), 1), 2, sharex="col", sharey="col", width_ratios=(1.1, 1.0), squeeze=False)
    for (force, spectrum), name in zip(axes, names, strict=False):
        colour = style[name][0]
        u = kept[name]["perfect"]["force"]
        force.stairs(u, RIG.sample_time * np.arange(len(u) + 1), baseline=None, color=colour, lw=0.9)
        force.set_title(name, fontsize=8, loc="left", pad=2)
        if name != REFERENCES[task] and kept.get(REFERENCES[task]):
            _plot_spectrum(spectrum, kept[REFERENCES[task]]["perfect"], color="#AAAAAA", lw=0.8)
        for condition, line in _LINES.items():
            _plot_spectrum(spectrum, kept[name][condition], color=colour, ls=line, lw=1.1)
        above = found(rows, "spectral_share", controller=name, task=task, device="none")
        shares = {row.condition: f"{100 * row.median:.2g}" for row in above if row.successes}
        words = f"above 5 Hz: {shares.get('perfect', '-')} %, with noise {shares.get('noise', '-')} %"
        spectrum.set_title(words, fontsize=8, loc="left", pad=2)
        spectrum.axvline(5.0, color="#777777", lw=0.6)
    axes[0, 0].set(xlim=(0, seconds), ylim=(-46, 46), yticks=(-40, 0, 40))
    axes[0, 1].set(xscale="log", yscale="log", xlim=(0.15, 25), ylim=(1e-9, 3), yticks=(1e-8, 1e-4, 1))
    axes[0, 1].set_xticks((0.2, 0.5, 1, 2, 5, 10, 20), ("0.2", "0.5", "1", "2", "5", "10", "20"))
    for axis in axes.ravel():
        axis.tick_params(labelsize=7)
        axis.minorticks_off()
        axis.grid(alpha=0.3)
    axes[-1, 0].set_xlabel("time (s)", fontsize=8)
    axes[-1, 1].set_xlabel("frequency (Hz)", fontsize=8)
    figure.supylabel("force on the cart (N), perfect sensors", fontsize=8)
    lines = [Line2D([], [], color="black", ls=line, label=_WORDS[name]) for name, line in _LINES.items()]
    lines.append(Line2D([], [], color="#AAAAAA", label=f"{REFERENCES[task]}, perfect sensors"))
    words = "right: power spectral density of u/u_max (1/Hz)"
    figure.legend(
        handles=lines, title=words, fontsize=7, title_fontsize=8, ncols=3, loc="outside upper right", frameon=False
    )
    return figure


def _plot_spectrum(axis: Axes, trace: dict[str, Array], **style: object) -> None:
    """Draw a spectrum averaged over bins a tenth as wide as their frequency, so that its end is a line and no brush."""
    if not trace or np.isnan(trace["density"]).any():
        return
    frequency, density = trace["frequency"], trace["density"]
    place = np.floor(10 * np.log(frequency / frequency[0])).astype(int)
    count = np.bincount(place)
    means = [np.bincount(place, column)[count > 0] / count[count > 0] for column in (frequency, density)]
    axis.plot(*means, **cast(Any, style))


def _plot_devices(rows: list[Row]) -> Figure:
    """Draw success and variation against each device's parameter, and those of learners with and without theirs."""
    worn = [name for name in DEVICES if found(rows, "variation", device=name)]
    groups = _learned(rows)
    figure = Figure(figsize=(6.8, 2.1 * (len(worn) + 2 * bool(groups)) + 0.8), layout="constrained")
    grid = figure.add_gridspec(max(len(worn) + 2 * bool(groups), 1), 2)
    axes = [(figure.add_subplot(grid[place, 0]), figure.add_subplot(grid[place, 1])) for place in range(len(worn))]
    for (saved, varied), name in zip(axes, worn, strict=True):
        _plot_device(saved, varied, rows, name)
    if groups:
        axes.append((figure.add_subplot(grid[-2, :]), figure.add_subplot(grid[-1, :])))
        _plot_learned(*axes[-1], groups)
    for saved, varied in axes:
        saved.set(ylim=(-0.05, 1.05), ylabel="starts that succeed")
        saved.yaxis.set_major_formatter(PercentFormatter(1.0))
        varied.set(yscale="log", ylim=(0.04, 200), ylabel="variation (u_max/s)")
        varied.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        for axis in (saved, varied):
            axis.grid(alpha=0.3)
            axis.tick_params(axis="y", labelsize=7)
            axis.xaxis.label.set_fontsize(8)
            axis.yaxis.label.set_fontsize(8)
    handles: dict[str, Any] = {}
    for axis, _ in axes:
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    words = "filled: perfect sensors, hollow: sensor noise 0.002; balancing, λ = 0.3, where nothing else is said"
    figure.legend(
        handles.values(), handles.keys(), title=words, fontsize=7, title_fontsize=8, ncols=5,
        loc="outside upper center", frameon=False,
    )  # fmt: skip
    return figure


def _plot_device(saved: Axes, varied: Axes, rows: list[Row], device: str) -> None:
    settings, style = DEVICES[device].settings, styles(_present(rows))
    none = settings[-1] * 2.2 if device != "Δu cost" else settings[0] / 4  # where no device at all is drawn
    for name in dict.fromkeys(row.controller for row in found(rows, "variation", device=device)):
        colour, marker, line = style[name]
        for condition in CONDITIONS:
            same = {"controller": name, "condition": condition, "task": _DEVICE_TASK}
            worn = sorted(found(rows, "variation", device=device, **same), key=lambda row: row.setting)
            plain = found(rows, "variation", device="none", **same)
            face = colour if condition == "perfect" else "white"
            for own, x in ((worn, [row.setting for row in worn]), (plain, [none] * len(plain))):
                shares = [success(row) for row in own]
                for axis, values in (
                    (saved, [(rate.share, rate.low, rate.high) for rate in shares]),
                    (varied, [(row.median, row.low, row.high) for row in own]),
                ):
                    y, low, high = np.array(values).reshape(-1, 3).T
                    axis.errorbar(
                        x, y, [y - low, high - y], color=colour, marker=marker, mfc=face, ms=4, lw=1.0, capsize=2,
                        ls=line if condition == "perfect" else ":",
                        label=name if own is worn and condition == "perfect" else None,
                    )  # fmt: skip
    for axis in (saved, varied):
        axis.set(xscale="log", xlabel=DEVICES[device].parameter)
        axis.set_xticks([*settings, none], [*(f"{setting:g}" for setting in settings), "none"], fontsize=7)
        axis.minorticks_off()


def _learned(rows: list[Row]) -> list[tuple[str, list[Row]]]:
    """Return Q-learning without and with a² (balancing), and deep trainings without and with a device (swing-up)."""
    groups = [
        (f"{name}\n{features}\nλ = 0.3", found(rows, "variation", controller=name, task=_DEVICE_TASK, device="none"))
        for name, features in (("Q tuned", "without a²"), ("LSPI", "with a²"))
    ]
    trained = [row for row in found(rows, "variation", task="swing-up") if row.device not in ("none", *DEVICES)]
    for name in dict.fromkeys(row.controller for row in trained):
        own = [row for row in trained if row.controller == name]
        device = own[0].device.replace(", ", ",\n")
        groups.append((f"{name.replace('-swing-up', '')}\n{device}\nswing-up", own))
    for name in () if trained else ("PPO swing-up", "PPO swing-up, smooth"):
        groups.append((name.replace(" ", "\n"), found(rows, "variation", controller=name, task="swing-up")))
    return [(words, own) for words, own in groups if own]


def _plot_learned(saved: Axes, varied: Axes, groups: list[tuple[str, list[Row]]]) -> None:
    """Draw groups of learned controllers side by side, each training a point."""
    for place, (_, own) in enumerate(groups):
        for order, condition in enumerate(CONDITIONS):
            chosen = sorted((row for row in own if row.condition == condition), key=lambda row: row.training)
            x = place + 0.4 * (order - 0.5) + 0.05 * (np.arange(len(chosen)) - (len(chosen) - 1) / 2)
            shares = [success(row) for row in chosen]
            for axis, values in (
                (saved, [(rate.share, rate.low, rate.high) for rate in shares]),
                (varied, [(row.median, row.low, row.high) for row in chosen]),
            ):
                y, low, high = np.array(values).reshape(-1, 3).T
                axis.errorbar(
                    x, y, [y - low, high - y], color="#333333", marker="o", ls="none", ms=3.5, lw=0.8, capsize=1.5,
                    mfc="#333333" if condition == "perfect" else "white",
                )  # fmt: skip
    for axis in (saved, varied):
        axis.set_xticks(range(len(groups)), [words for words, _ in groups], fontsize=7)
        axis.set_xlim(-0.5, len(groups) - 0.5)


def _present(rows: list[Row]) -> list[str]:
    """Return those that stand for themselves, in the order of the table."""
    return list(dict.fromkeys(row.controller for row in rows if row.device == "none"))


# ---------------------------------------------------------------------------------------------------------- the tables

_COLUMNS = {
    "variation": "variation, u_max/s", "slew": "slew, u_max/s", "switches": "switches, 1/s",
    "saturated": "saturated, %", "spectral_share": "above 5 Hz, %", "effort": "effort, N² s", "travel": "track, m",
    "caps_sm": "Sm", "std_step": "std Δu, N",
}  # fmt: skip
_SHARES = ("saturated", "spectral_share")


class Sheet(NamedTuple):
    """A table with what stands above it."""

    title: str
    columns: list[Column]
    lines: list[list[Cell]]


def sheets(rows: list[Row]) -> list[Sheet]:
    """Condense the table: metrics by task and sensors, what each device costs and buys, and deep trainings.

    Parameters
    ----------
    rows : list of Row
        The table.

    Returns
    -------
    list of Sheet
    """
    every = [_metrics_sheet(rows, task, condition) for task in TASKS for condition in CONDITIONS]
    return [sheet for sheet in (*every, _devices_sheet(rows), _trainings_sheet(rows)) if sheet.lines]


def summary(rows: list[Row], traces: Traces) -> RenderableType:
    """Show the tables."""
    return Group(*(terminal(*sheet) for sheet in sheets(rows)))


def pages(rows: list[Row], traces: Traces) -> dict[str, str]:
    """Write the tables as Markdown."""
    tables = [f"## {title}\n\n{markdown(columns, lines)}\n" for title, columns, lines in sheets(rows)]
    return {"tables.md": "\n".join(["# Smoothness: all tables\n", *tables])}


def _headed(words: list[str], numbers: list[str]) -> list[Column]:
    return [Column("", heading, "", words=True) for heading in words] + [Column("", heading, "") for heading in numbers]


def _percent(rate: Rate) -> Cell:
    return Cell(f"{100 * rate.share:.1f}", f"[{100 * rate.low:.1f}, {100 * rate.high:.1f}]")


def _number(value: float, low: float = np.nan, high: float = np.nan) -> Cell:
    """Write a number with three digits that count, and its interval where there is one."""
    if np.isnan(value):
        return Cell()
    text, *ends = (f"{end:,.0f}" if abs(end) >= 100 else f"{end:.3g}" for end in (value, low, high))
    return Cell(text, "" if np.isnan(low) else f"[{ends[0]}, {ends[1]}]")


def _metrics_sheet(rows: list[Row], task: str, condition: str) -> Sheet:
    title = f"{_TITLES[task][0].upper()}{_TITLES[task][1:]}, {_WORDS[condition]}"
    against = REFERENCES[task]
    lines = []
    for name in _present(rows):
        same = {"controller": name, "task": task, "condition": condition, "device": "none"}
        own = {metric: row for metric in METRICS for row in found(rows, metric, **same)}
        if not own:
            continue
        first = own["variation"]
        cells = [_number(own[metric].median * (100 if metric in _SHARES else 1)) for metric in _COLUMNS]
        cells[0] = _number(first.median, first.low, first.high)
        ratio = _number(first.ratio, first.ratio_low, first.ratio_high)
        lines.append([Cell(name), Cell(str(first.starts)), _percent(success(first)), *cells, ratio])
    numbers = ["starts", "success, %", *_COLUMNS.values(), f"variation, times that of {against}"]
    return Sheet(title, _headed(["controller"], numbers), lines)


def _devices_sheet(rows: list[Row]) -> Sheet:
    lines = []
    for device, about in DEVICES.items():
        for name in dict.fromkeys(row.controller for row in found(rows, "variation", device=device)):
            settings = dict.fromkeys(
                row.setting for row in found(rows, "variation", device=device, controller=name, task=_DEVICE_TASK)
            )
            for worn, setting in (("none", 0.0), *((device, setting) for setting in settings)):
                line = [Cell(about.parameter), Cell(name), Cell("none" if worn == "none" else f"{setting:g}")]
                for condition in CONDITIONS:
                    (row,) = found(
                        rows, "variation", controller=name, device=worn, setting=setting, task=_DEVICE_TASK,
                        condition=condition,
                    )  # fmt: skip
                    ratio = Cell() if worn == "none" else _number(row.ratio, row.ratio_low, row.ratio_high)
                    line += [_percent(success(row)), _number(row.median), ratio]
                lines.append(line)
    numbers = [
        f"{what}{said}"
        for said in ("", ", noise")
        for what in ("success, %", "variation, u_max/s", "times that without")
    ]
    title = "What devices cost and buy: balancing, λ = 0.3; the ratio is on the starts saved with it and without it"
    return Sheet(title, _headed(["device", "controller"], ["setting", *numbers]), lines)


def _trainings_sheet(rows: list[Row]) -> Sheet:
    trained = [row for row in rows if row.metric == "variation" and row.device not in ("none", *DEVICES)]
    lines = []
    for name in dict.fromkeys(row.controller for row in trained):
        own = [row for row in trained if row.controller == name]
        line = [Cell(name), Cell(own[0].device), Cell(str(len({row.training for row in own})))]
        for task in ("swing-up", "balance 0.1"):
            same = found(own, "variation", task=task, condition="perfect")
            line.append(_percent(over_seeds([row.successes for row in same], same[0].starts)))
            for condition in CONDITIONS:
                values = [row.median for row in found(own, "variation", task=task, condition=condition)]
                known = [value for value in values if np.isfinite(value)]
                line.append(_number(*median(known)) if len(known) > 1 else _number(*known or [np.nan]))
        lines.append(line)
    numbers = ["trainings"]
    for task in ("swing-up", "λ = 0.1"):
        numbers += [f"{task}: success, %", "variation, u_max/s", "variation, noise"]
    title = "Deep trainings with and without a device, each started from nothing; medians over trainings"
    return Sheet(title, _headed(["training", "device"], numbers), lines)


if __name__ == "__main__":
    _study.main("studies.smoothness")
