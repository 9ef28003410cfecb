"""What does each controller look like at work, and how does its force differ from its neighbour's?

Method: on gustafsson2016 (±40 N, ±2.4 m, 0.02 s), one after the other: motion without a force; the policies on the way
of one training of the tuned Q-learning; that policy beside LQR, and the other learned policies, all from one start near
upright under the same three pushes of 0.2 s, strong enough to be seen and weak enough that all balance; and the swings
from hanging.  Each scene is a GIF, and all of them one MP4 where there is ffmpeg (extra ``video``).  The runs are
examples, chosen to be looked at: the other studies compare.

Finding: under the same pushes the tuned Q-learning varies its force 101 times as much as LQR, always at the limit;
LSPI, QAC, PPO and DDPG vary theirs 1.05, 1.02, 0.91 and 2.70 times as much, and all six balance.  These are single
runs: ``studies.smoothness`` has many, with intervals.  From the default options, kept in docs/results/film.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

import dpend
from controllers import Zero
from dpend.draw import DARK, Scene, animate_scenes, find_ffmpeg
from dpend.params import Array
from dpend.plant import PUSHES

from . import _runner
from ._field import find, made, styles
from ._figures import facets, force_trace
from ._plant import Plant, rig_of
from ._runner import Report, Result, Table
from ._tables import sheet

MINUTES = 5

SceneName = Literal["free", "training", "duel", "learned", "swing-up"]

CAPTIONS: Mapping[SceneName, str] = {
    "free": "No force",
    "training": "Linear Q-learning on its way",
    "duel": "The same start, the same pushes",
    "learned": "Other learned policies, the same start and pushes",
    "swing-up": "Swing-up from hanging",
}
"""What stands above each scene, in the order of the film."""

_CONTENDERS: Mapping[SceneName, tuple[str, ...]] = {
    "free": (),
    "training": ("Q tuned",),
    "duel": ("Q tuned", "LQR"),
    "learned": ("LSPI", "QAC tuned", "PPO balance", "DDPG balance"),
    "swing-up": (
        "iLQR MPC", "TVLQR", "pumping, LQR", "pumping, iLQR, LQR", "PPO swing-up, smooth", "DDPG swing-up"
    ),
}  # fmt: skip
_SECONDS: Mapping[SceneName, float] = {"free": 5.0, "training": 5.0, "duel": 7.0, "learned": 7.0, "swing-up": 6.0}
_FREE = {"let go near upright": (0.0, 0.05, 0.02), "let go from the side": (0.0, np.pi / 2, np.pi / 2)}
_START = (0.0, 0.15, -0.1, 0.0, 0.0, 0.0)
_SNAPSHOTS = 4


class _Push(NamedTuple):
    at: float  # s
    seconds: float
    part: int  # 0 the cart, 1 the lower and 2 the upper link
    strength: float  # N, or N m


_PUSHES = (_Push(1.0, 0.2, 0, 8.0), _Push(3.0, 0.2, 2, -0.4), _Push(5.0, 0.2, 0, -8.0))


@dataclass(frozen=True, kw_only=True)
class Options(_runner.Options):
    """Options of the command line."""

    needs = ("force_limit", "ideal")

    only: tuple[SceneName, ...] = ()  # Scenes to film; left out, all.
    films: bool = True  # Write the films; --no-films, their table and figure alone.

    def __post_init__(self) -> None:
        super().__post_init__()
        if not np.isfinite(self.plant.rig.track_limit):
            raise ValueError(f"--rig {self.rig} has no track's end, and a film shows both; --set track_limit=5.")

    def contenders(self, scene: SceneName) -> tuple[str, ...]:
        """Return who is in a scene: on another rig none that was trained here, and quickly two at most."""
        found = [find(name) for name in _CONTENDERS[scene]]
        if self.elsewhere:
            found = [each for each in found if each.learner or not each.policy]
        names = tuple(each.name for each in found)
        return (names[1:2] if scene == "swing-up" else names[:2]) if self.quick else names


@dataclass(frozen=True, kw_only=True)
class Job:
    """A scene."""

    scene: SceneName
    contenders: tuple[str, ...]
    length: float  # s, of each run
    snapshots: int  # policies on the way of a training
    budget: float | None  # s of experience of a training
    seed: int
    elsewhere: Plant | None = None


def jobs(options: Options) -> list[Job]:
    """List the scenes, in the order of the film."""
    return [
        Job(
            scene=scene, contenders=options.contenders(scene), length=0.5 if options.quick else _SECONDS[scene],
            snapshots=2 if options.quick else _SNAPSHOTS, budget=20.0 if options.quick else None,
            seed=options.seed, elsewhere=options.elsewhere,
        )
        for scene in CAPTIONS if scene in (options.only or CAPTIONS)
    ]  # fmt: skip


def run(job: Job) -> Result:
    """Run what a scene shows; the states, forces and pushes are NaN after a run's end."""
    runs = _SHOWN[job.scene](job)
    samples = round(job.length / rig_of(job.elsewhere).sample_time)
    x = np.full((len(runs), samples + 1, 6), np.nan)
    u, pushes = np.full((len(runs), samples), np.nan), np.zeros((len(runs), samples, 3))
    rows: list[dict[str, Any]] = []
    for k, (shown, of) in enumerate(runs.items()):
        x[k, : len(of.t)], u[k, : len(of.u)] = of.x, of.u
        for part, name in enumerate(PUSHES):
            pushes[k, : len(of.u), part] = of.log.get(name, 0.0)
        metrics = {each: float(value) for each, value in of.metrics().items() if each in _MEASURED}
        rows.append({"shown": shown, "ending": of.status.name, **metrics})
    return Result(rows, {"x": x, "u": u, "pushes": pushes})


def _free(job: Job) -> dict[str, dpend.Run]:
    rig = rig_of(job.elsewhere)
    starts = {name: [*start, 0.0, 0.0, 0.0] for name, start in _FREE.items()}
    return {name: dpend.simulate(rig, Zero(), x0, job.length, task=None) for name, x0 in starts.items()}


def _training(job: Job) -> dict[str, dpend.Run]:
    rig, found = rig_of(job.elsewhere), {}
    learner = find(job.contenders[0]).learner
    assert learner is not None
    for experience, policy in learner(rig).train(job.seed, seconds=job.budget).snapshots(job.snapshots):
        found[f"after {experience:,.{0 if experience >= 10 else 1}f} s of experience"] = dpend.simulate(
            rig, policy, _START, job.length, task=_balance(job)
        )
    return found


def _balance(job: Job) -> dpend.Balance:
    return dpend.Balance(steps=round(job.length / rig_of(job.elsewhere).sample_time))


def _pushed(job: Job) -> dict[str, dpend.Run]:
    rig, task = rig_of(job.elsewhere), _balance(job)
    controllers = {name: made(find(name), job.elsewhere, task) for name in job.contenders}
    return {
        name: dpend.simulate(rig, controller, _START, task=task, push=_push) for name, controller in controllers.items()
    }


def _push(t: float) -> Array:
    """Return the generalised forces of the pushes at a time."""
    forces = np.zeros(3)
    for push in _PUSHES:
        if push.at <= t + 1e-9 < push.at + push.seconds:
            forces[push.part] += push.strength
    return forces


def _swings(job: Job) -> dict[str, dpend.Run]:
    rig = rig_of(job.elsewhere)
    task = dpend.SwingUp(steps=round(job.length / rig.sample_time))
    controllers = {name: made(find(name), job.elsewhere, task) for name in job.contenders}
    hanging = dpend.EQUILIBRIA["down-down"]
    return {name: dpend.simulate(rig, controller, hanging, task=task) for name, controller in controllers.items()}


_SHOWN: Mapping[SceneName, Callable[[Job], dict[str, dpend.Run]]] = {
    "free": _free, "training": _training, "duel": _pushed, "learned": _pushed, "swing-up": _swings,
}  # fmt: skip
_MEASURED = ("seconds", "variation", "switches", "saturated", "peak_force")


def runs_of(table: Table, scene: SceneName) -> dict[str, dpend.Run]:
    """Return the runs of a scene by what is shown; none where it was not filmed."""
    lines = list(table.lines(scene=scene))
    if not lines:
        return {}
    rig, (x, u, pushes) = table.rig, (table.array(name, scene=scene) for name in ("x", "u", "pushes"))
    found = {}
    for k, line in enumerate(lines):
        n = int(np.isfinite(u[k]).sum())
        found[line.shown] = dpend.Run(
            t=rig.sample_time * np.arange(n + 1, dtype=np.float64), x=x[k, : n + 1], y=x[k, : n + 1], u=u[k, :n],
            step_time=np.full(n, np.nan), status=dpend.Status[line.ending], success=False, time_up=np.nan, rig=rig,
            controller=line.shown, task="", seed=line.seed,
            log=dict(zip(PUSHES, np.ascontiguousarray(pushes[k, :n].T), strict=True)),
        )  # fmt: skip
    return found


def colours(scene: SceneName, shown: list[str]) -> list[str]:
    """Return the colour of each run: its contender's, or the learner's whose training is shown."""
    if scene == "free":
        return [DARK] * len(shown)
    looks = styles([*_CONTENDERS[scene], *shown])
    return [looks[_CONTENDERS[scene][0] if scene == "training" else name][0] for name in shown]


def report(table: Table) -> Report:
    """Draw the force of every run, and tabulate how it was."""
    runs: dict[tuple[SceneName, str], dpend.Run] = {
        (scene, shown): of for scene in CAPTIONS for shown, of in runs_of(table, scene).items()
    }
    figure, axes = facets(-(-len(runs) // 2), 2, height=0.5 + 0.42 * len(runs))
    for axis, ((scene, shown), of) in zip(axes.flat, runs.items(), strict=False):
        limit, seconds = float(of.rig.force_limit), table.array("u", scene=scene).shape[1] * of.rig.sample_time
        (colour,) = colours(scene, [shown])
        force_trace(axis, of.u, of.rig.sample_time, seconds, colour, f"{scene}: {shown}", limit)
    for axis in [*axes.flat][len(runs) :]:
        axis.set_visible(False)
    figure.supxlabel("time (s)")
    figure.supylabel("force on the cart (N)")
    lines = [
        {
            "scene": line.scene, "shown": line.shown, "lasts, s": line.seconds, "variation, 1/s": line.variation,
            "sign switches, 1/s": line.switches, "at the limit, %": line.saturated, "peak, N": line.peak_force,
            "ends as": dpend.Status[line.ending].value,
        }
        for line in table.lines()
    ]  # fmt: skip
    forms = {"lasts, s": ".2f", "variation, 1/s": ".2f", "sign switches, 1/s": ".2f", "at the limit, %": ".0%",
             "peak, N": ".1f"}  # fmt: skip
    return Report(figures=figure, tables=[sheet("What is shown, and its force", lines, forms)])


def _pairs(table: Table, scene: SceneName, room: int | None = None) -> list[Scene]:
    """Return the pictures of a scene: its runs two at a time."""
    runs = runs_of(table, scene)
    names = list(runs)
    return [
        Scene(
            [runs[name] for name in pair], pair, colours(scene, pair), caption=CAPTIONS[scene], room=room
        )
        for pair in (names[k : k + 2] for k in range(0, len(names), 2))
    ]  # fmt: skip


def films(table: Table) -> dict[str, Callable[[Path], object]]:
    """Return what writes a GIF of each scene, and one MP4 of all where there is ffmpeg, by file name."""
    pairs: dict[SceneName, list[Scene]] = {scene: scenes for scene in CAPTIONS if (scenes := _pairs(table, scene))}
    fps = 4 if table.quick else 20
    found: dict[str, Callable[[Path], object]] = {}
    for scene, scenes in pairs.items():
        room = max(each.room for each in scenes)
        found[f"{scene}.gif"] = partial(animate_scenes, _pairs(table, scene, room), fps=fps)
    try:
        find_ffmpeg()
    except RuntimeError:
        print("There is no ffmpeg, so the GIFs are all; the extra `video` (pip install 'dpend[video]') brings it.")
        return found
    room = max(each.room for scenes in pairs.values() for each in scenes)
    every = [each for scene in pairs for each in _pairs(table, scene, room)]
    return found | {"film.mp4": partial(animate_scenes, every, fps=fps)}


if __name__ == "__main__":
    _runner.main("studies.film")
