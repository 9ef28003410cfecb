"""The leaderboard as a table: ranks of what was measured, a line a contender, and what the columns mean."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from dpend.params import Array

from ._estimates import Estimate, crossing, mean_share, number, ranking, share
from ._field import CONTENDERS, YOURS, TaskName, styles
from ._perturbations import AXES, NOMINAL, score
from ._table import Table
from ._tables import Cell, Column, Sheet, Value, cell, page

TASKS: tuple[TaskName, ...] = get_args(TaskName)
SAVED = {lam: f"saved, λ = {lam:g}" for lam in (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)}
"""What is measured while balancing, by λ, rad: success.  All but the first count in the rank."""
UP = {start: f"up from {start}, s" for start in ("hanging", "side", "anywhere")}
"""What is measured while swinging up, by start: when both links were up for good, NaN where they never were."""
UNSCORED = (0.05,)
SHOWN = (0.1, 0.2, 0.3, 0.4)
REFERENCE = "best known"  # what any force can save, from studies.recoverable, or any contender saves


class Place(NamedTuple):
    """Where a contender stands at a task."""

    rank: Estimate
    first: float  # share of the resamples in which none does better
    next_better: float  # share of them in which the next one does better; NaN of the last


Places = dict[str, Place | None]  # those that do a task, the best first; None, at the end, of those that never succeed


def mean_known(values: Array) -> float:
    """Return the mean of the numbers that are known; NaN of none."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else math.nan


def values_of(table: Table, name: str, quantity: str, **fields: str) -> Array:
    """Return the numbers of a quantity, run after run; none where it was not measured."""
    return np.concatenate([np.empty(0), *table.arrays(quantity, contender=name, **fields)])


def outcomes_of(table: Table, name: str, task: TaskName) -> dict[Any, Array]:
    """Return success while balancing, by λ, or times up, by start: ``(n,)``, a number a start."""
    kinds: dict[Any, str] = {"balance": SAVED, "swing-up": UP}[task]
    return {kind: values for kind, what in kinds.items() if len(values := values_of(table, name, what))}


def ranked(table: Table, task: TaskName) -> Places:
    """Rank the contenders at a task, by what the study's docstring says."""
    criteria = {}
    names = list(styles(table.where(work="runs", task=task)["contender"], CONTENDERS))
    for name in names:
        found = outcomes_of(table, name, task)
        values = np.stack([values for kind, values in found.items() if kind not in UNSCORED], axis=1)
        success = values > 0 if task == "balance" else np.isfinite(values)
        own = [(success.mean(axis=1), np.ones(len(success)))]
        if task == "swing-up":
            own.append((-np.where(success, values, 0.0).sum(axis=1), success.sum(axis=1)))
        if success.any():
            criteria[name] = own
    if not criteria:
        return dict.fromkeys(names)
    ranks, ordered = ranking(list(criteria.values())), {}
    for i, after in zip(ranks.order, [*ranks.order[1:], None], strict=True):
        better = math.nan if after is None else float(ranks.better[after, i])
        ordered[list(criteria)[i]] = Place(ranks.ranks[i], float(ranks.first[i]), better)
    return ordered | dict.fromkeys(name for name in names if name not in ordered)


_RANK = "{}: one more than how many do better on the starts that both had; 95 % interval.  None without success."
_STANDING = {
    "first, %": "In how many of 2000 resamples of the starts none does better.",
    "next is better, %": "In how many of them the next in this ranking does better.",
}
_SETTINGS = sum(len(axis.levels) for axis in AXES)
GROUPS = {
    "Balance": {
        "rank": _RANK.format("Rank by success, mean over λ = 0.1 to 0.6"),
        **_STANDING,
        **{f"λ = {lam:g}": f"Starts saved, %, θ1, θ2 within {lam:g} rad, and Wilson's 95 % interval." for lam in SHOWN},
        "mean": "Starts saved, %, mean over λ = 0.1 to 0.6, which the rank goes by; 95 % interval.",
        "of savable, %": "Saved of the starts that can be (studies.recoverable, or a contender), %, λ = 0.1 to 0.6.",
        "λ90, rad": "The λ at which 90 % are saved, and its 95 % interval.",
        "robust, %": f"Success in {_SETTINGS} settings of a rig that is not what was promised, from λ = 0.1, mean over "
        "six axes, and its 95 % interval (studies.robustness).",
        "variation, 1/s": "Total variation of the force in force limits per second, from λ = 0.1 with noise of 0.002 "
        "on every measured state: mean over 200 runs, or those there are, that succeed.",
        "effort, N² s": "∫u² dt of the same runs, over 6 s.",
        "step, ms": "Time of a step, one run at a time; beside it, by LQR's in turn with it.",
        "of 1000, µs": "Time of a step of 1000 runs side by side, by 1000.",
        "starts": "Starts at each λ: the first of all where one takes long.",
    },
    "Swing-up": {
        "rank": _RANK.format("Rank by success, mean over the three starts, then by mean time up"),
        **_STANDING,
        "hanging": "Success, %, from hanging, angles moved by up to 0.1 rad, and Wilson's 95 % interval.",
        "side": "The same from horizontal links, (π/2, π/2).",
        "anywhere": "The same from any angles, within half the track, rates N(0, 1).",
        "hanging, s": "When both links are up for good: mean over the successes from hanging.",
        "side, s": "The same from the side.",
        "anywhere, s": "The same from anywhere.",
        "robust, %": "As for balancing, from hanging.",
        "variation, 1/s": "Total variation of the force from hanging, over 10 s, with perfect sensors.",
        "effort, N² s": "∫u² dt of the same runs.",
        "step, ms": "As for balancing; LQR's is of balancing.",
        "of 1000, µs": "As for balancing.",
        "starts": "Starts of each kind.",
    },
    "Cost": {
        "ready, s": "Processor time from nothing to the first force, of what is designed or tuned, compiling aside.",
        "trainings": "How many trainings the next columns are of.",
        "training, s": "Processor time of a training: median.",
        "learning, s": "Experience while it learned, s of the plant's time: median.",
        "tests, s": "Experience of the tests by which a policy was chosen, of deep learners at most, or a law was "
        "tuned in simulation: median.",
        "failed, %": "Trainings whose policy succeeds from less than 95 % of fresh starts, and Wilson's 95 % interval; "
        "balancing from λ = 0.1, swinging up from hanging, of deep learners also from the side.",
        "they save, %": "Starts from which these policies succeed, mean over those that the rank goes by; 95 % "
        "interval.",
    },
    "Prior knowledge": {
        "model": "What it knew of the plant beforehand.",
        "goal": "What it was to make large or small.",
        "starts to learn from": "Where it could begin while it learned.",
        "state": "What it sees of the state when it acts.",
    },
}
"""Headings and what they mean, by group."""
_BRIEF = {
    "Balance": ("rank", "mean", "robust, %", "step, ms"),
    "Swing-up": ("rank", *UP, "hanging, s"),
    "Cost": ("ready, s", "training, s", "learning, s", "failed, %", "they save, %"),
    "Prior knowledge": (),
}
_BEFORE = (
    "Controllers and learners of dpend on {}, on the same starts. There is one ranking for balancing and one for the "
    "swing-up, and none of both. "
    "Intervals are 95 %; those of ranks are over resampled starts, with the policies as they are.",
    "A dash: it does not do this, or it was not measured. Press a heading to sort.",
)
_REPORTS = "the report's cart with a double pendulum (gustafsson2016: 40 N, 2.4 m, 0.02 s)"
_DOING = {"balance": "balancing", "swing-up": "swinging up"}
Line = dict[str, Value]  # values by heading


def _percent(of: Estimate) -> Cell:
    return cell(of, ".1%", bar=True)


def _saved(found: Mapping[float, npt.NDArray[Any]]) -> Line:
    """Return how many starts are saved, by λ, in the mean and where it is nine tenths."""
    saved = np.stack(list(found.values()), axis=1)
    scored = np.stack([values for lam, values in found.items() if lam not in UNSCORED], axis=1)
    by_lam: Line = {f"λ = {lam:g}": _percent(share(found[lam].sum(), len(saved))) for lam in SHOWN if lam in found}
    return by_lam | {
        "mean": _percent(mean_share(scored.mean(axis=1), scored.size)),
        "λ90, rad": cell(crossing(list(found), saved, 0.9, square=True), ".3f", tried=(min(found), max(found))),
        "starts": len(saved),
    }


def _of_savable(found: Mapping[float, Array], known: Mapping[float, npt.NDArray[np.bool_]]) -> Cell:
    """Return the share of the starts that can be saved which are saved, of all λ that count together."""
    scored = [lam for lam in found if lam in known and lam not in UNSCORED]
    can = sum(int(known[lam][: len(found[lam])].sum()) for lam in scored)
    return cell(sum(float(found[lam].sum()) for lam in scored) / can if can else math.nan, ".1%")


def _up(found: Mapping[str, Array]) -> Line:
    """Return from how many starts it swings up, and when."""
    line: Line = {}
    for start, times in found.items():
        line[start] = _percent(share(np.isfinite(times).sum(), len(times)))
        line |= {f"{start}, s": cell(mean_known(times), ".2f"), "starts": len(times)}
    return line


def _at_task(table: Table, name: str, task: TaskName, place: Place | None) -> Line:
    """Return the line of a contender at a task."""
    of = partial(values_of, table, name, task=task)
    line = {"balance": _saved, "swing-up": _up}[task](outcomes_of(table, name, task))
    if place is not None:
        line |= {"rank": place.rank, "first, %": cell(place.first, ".0%")}
        line["next is better, %"] = cell(place.next_better, ".0%")
    line["variation, 1/s"] = mean_known(of("variation, 1/s"))
    line["effort, N² s"] = cell(mean_known(of("effort, N² s")), ",.0f")
    if len(steps := of("step, s")):
        step, lqr = (1e3 * float(np.median(each)) for each in (steps, of("step of LQR, s")))
        by_lqr = 1.0 if (name, task) == ("LQR", "balance") else step / lqr
        line["step, ms"] = Cell(number(step), f"({number(by_lqr)} × LQR)", step)
    settings = {"contender": name, "task": task, "work": "robustness"}
    if table.arrays(NOMINAL.name, **settings):
        line["robust, %"] = _percent(score({axis.name: table.array(axis.name, **settings) for axis in AXES}))
    return line | {"of 1000, µs": 1e6 * mean_known(of("step of 1000, s"))}


def _cost(table: Table, name: str) -> Line:
    """Return the line of what a contender cost."""
    found = {what: values for what in GROUPS["Cost"] if len(values := values_of(table, name, what))}
    written: dict[str, Callable[[Array], Value]] = {
        "ready, s": lambda each: cell(mean_known(each), ".2g"),
        "failed, %": lambda each: cell(share(each.sum(), len(each)), ".1%"),
        "they save, %": lambda each: _percent(mean_share(each, 10_000 * len(each))),
    }
    line: Line = {what: written.get(what, np.median)(values) for what, values in found.items()}
    return line | ({"trainings": len(found["failed, %"])} if "failed, %" in found else {})


def _sheet(title: str, lines: Mapping[str, Mapping[str, Line]], note: str = "") -> Sheet:
    """Return the table of lines by group of columns and by name."""
    columns = [Column("controller", "Which contender.", words=True)] + [
        Column(heading, meaning, group, group == "Prior knowledge", heading in _BRIEF[group])
        for group in lines
        for heading, meaning in GROUPS[group].items()
    ]
    names = dict.fromkeys(name for of in lines.values() for name in of)
    return Sheet(title, columns, [
        [Cell(name), *(cell(of.get(name, {}).get(heading)) for group, of in lines.items() for heading in GROUPS[group])]
        for name in names
    ], note)  # fmt: skip


def _place_in_words(name: str, task: TaskName, places: Places) -> str:
    place = places[name]
    if place is None:
        return f"{name} has no rank at {_DOING[task]}, at which it never succeeds"
    n = int(place.rank.value)
    same = sum(other is not None and int(other.rank.value) == n for other in places.values()) > 1
    ending = "th" if n // 10 % 10 == 1 else {1: "st", 2: "nd", 3: "rd"}.get(n % 10, "th")
    return f"{name} ranks {n}{ending}{', equally,' * same} of {len(places)} at {_DOING[task]}"


def board(
    table: Table, places: Mapping[TaskName, Places], known: Mapping[float, npt.NDArray[np.bool_]]
) -> tuple[list[Sheet], str]:
    """Return the leaderboard as tables, of each task and of costs, and in one as a page that sorts (HTML).

    ``places`` is what :func:`ranked` returns, by task; ``known`` is which starts can be saved ``(n,)``, by λ.
    """
    prior = {contender.name: contender.prior_knowledge for contender in CONTENDERS}
    names = list(styles(table.rows["contender"], CONTENDERS))
    lines: dict[str, dict[str, Line]] = {
        task.capitalize(): {name: _at_task(table, name, task, place) for name, place in places.get(task, {}).items()}
        for task in TASKS
    }
    for name, line in lines["Balance"].items():
        line["of savable, %"] = _of_savable(outcomes_of(table, name, "balance"), known)
    lines["Balance"] |= {REFERENCE: _saved(known)} if known else {}
    lines["Cost"] = {name: _cost(table, name) for name in names}
    lines["Prior knowledge"] = {
        name: {what: word for what, word in zip(GROUPS["Prior knowledge"], prior.get(name, YOURS), strict=True)
               if word != "-"}
        for name in names
    }  # fmt: skip
    own = {
        task.capitalize(): "; ".join(_place_in_words(name, task, of) for name in of if name not in prior)
        for task, of in places.items()
    }
    tables = [_sheet(f"{task}, the best first", {task: lines[task]}, said) for task, said in own.items()]
    tables.append(_sheet("Cost and prior knowledge", {group: lines[group] for group in ("Cost", "Prior knowledge")}))
    of = table.plant.name if table.plant else _REPORTS
    whole = _sheet("Leaderboard", lines, "; ".join(filter(None, own.values())))
    return tables, page("Leaderboard", [each.format(of) for each in _BEFORE], whole)
