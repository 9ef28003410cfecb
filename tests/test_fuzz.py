"""Whatever bytes a file holds, it is read or refused by an error of this project's own, never by one of a library's."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from refusals import refusal

import controllers.data
import dpend
import rl
from controllers import Trajectory
from controllers.tuning import TunedLaw
from dpend import archive
from rl import load_policy

MANY = 100_000
SLOW = (HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.large_base_example)
RIG = dpend.rig("gustafsson2016")
RUN = dpend.simulate(RIG, lambda t, x: 0.0, [0, 0.1, -0.1, 0, 0, 0], 0.2)
SHIPPED = Path(controllers.data.__path__[0])
TRAINED = Path(rl.__path__[0]) / "trained"


class Surface(NamedTuple):
    """A kind of file: what reads one, how one is written, and its kind if it is an archive."""

    read: Callable[[Path], object]
    write: Callable[[Path], object]
    kind: str | None = None


def copied(source: Path) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(source.read_bytes())


def recording(path: Path) -> None:
    columns = np.column_stack([RUN.t, RUN.y, np.append(RUN.u, 0.0)])
    np.savetxt(path, columns, delimiter=",", header="t,pos,th1,th2,vel,om1,om2,u", comments="", fmt="%.9g")


SURFACES = {
    "archive": Surface(
        lambda path: archive.read(path, "any 1"),
        lambda path: archive.write(path, "any 1", {"a": [1]}, {"x": np.arange(3.0)}),
        "any 1",
    ),
    "run": Surface(dpend.Run.load, RUN.save, "dpend run 1"),
    "trajectory": Surface(
        Trajectory.load, copied(SHIPPED / "gustafsson2016_hanging_up-up_time.npz"), "dpend trajectory 1"
    ),
    "tuned law": Surface(TunedLaw.load, copied(SHIPPED / "gustafsson2016_tuned_gain.npz"), "dpend tuned law 1"),
    "linear policy": Surface(load_policy, copied(TRAINED / "q-tuned.npz"), "dpend policy 2"),
    "gain policy": Surface(load_policy, copied(TRAINED / "lspi.npz"), "dpend policy 2"),
    "network policy": Surface(load_policy, copied(TRAINED / "ppo-swing-up.npz"), "dpend policy 2"),
    "recording": Surface(lambda path: dpend.Run.from_csv(path, RIG), recording),
    "recording, resampled": Surface(
        lambda path: dpend.Run.from_csv(path, RIG, resample=True, any_size=True), recording
    ),
    "rig": Surface(dpend.Rig.from_toml, RIG.replace(force_limit=np.linspace(1.0, 40.0, 3)).to_toml),
}
ARCHIVES = [name for name, surface in SURFACES.items() if surface.kind]


@cache
def good(name: str) -> bytes:
    """Return a file that is whole."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "good.npz"
        SURFACES[name].write(path)
        return path.read_bytes()


# What an editor, a full disk, a bad cable or somebody's script makes of a file.
WORDS = [
    b"",
    b"\0",
    b"\xff",
    b"\n",
    b"\r",
    b",",
    b";",
    b'"',
    b"=",
    b"[",
    b"]",
    b"-",
    b"nan",
    b"1e999",
    b"9" * 400,
    b"true",
]
WORDS += [b"2026-01-01", b"''", b"[[", b"{", b"[params]", b"\xef\xbb\xbf", b"\xff\xfe", b"PK\3\4", b"\x93NUMPY"]
EDITS = st.lists(
    st.tuples(
        st.sampled_from(["put", "insert", "cut", "double", "end"]),
        st.floats(0, 1, exclude_max=True),
        st.integers(1, 40),
        st.sampled_from(WORDS) | st.binary(max_size=4),
    ),
    min_size=1,
    max_size=5,
)


def edited(content: bytes, edits: list[tuple[str, float, int, bytes]]) -> bytes:
    """Return bytes after each edit in turn."""
    for how, where, length, word in edits:
        at = int(where * len(content))
        before, span, after = content[:at], content[at : at + length], content[at + length :]
        content = {
            "put": before + word + content[at + len(word) :],
            "insert": before + word + content[at:],
            "cut": before + after,
            "double": before + span + span + after,
            "end": before,
        }[how]
    return content


ODD_JSON = st.recursive(
    st.sampled_from([None, True, 0, -1, 1.5, 10**400, float("nan"), float("inf"), "", "word", "up-up", [], {}]),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["a", "params", "kind"]), inner, max_size=2)
    ),
    max_leaves=4,
)
ODD_ARRAYS = st.builds(
    lambda shape, kind, value: np.full(shape, value).astype(kind),
    st.sampled_from([(), (0,), (1,), (3,), (6,), (1, 6), (11, 6), (2, 0), (2, 2, 2)]),
    st.sampled_from(["f8", "f4", "i8", "c16", "?", "U3", "S2", "M8[s]"]),
    st.sampled_from([0, 1, 7]),
) | st.sampled_from([np.array(np.nan), np.full(6, np.inf), np.zeros(3, dtype=[("a", "f8")]), np.array("tanh")])


def replaced(tree: Any, path: list[int], value: Any, drop: bool) -> Any:
    """Return JSON in which the entry at a path, counted at each level, is replaced or dropped."""
    if not isinstance(tree, dict | list) or not tree or not path:
        return value
    keys = list(tree) if isinstance(tree, dict) else list(range(len(tree)))
    key = keys[path[0] % len(keys)]
    copy = dict(tree) if isinstance(tree, dict) else dict(enumerate(tree))
    if drop and len(path) == 1:
        del copy[key]
    else:
        copy[key] = replaced(copy[key], path[1:], value, drop)
    return copy if isinstance(tree, dict) else list(copy.values())


def check_bytes(name: str, cases: int, folder: Path) -> None:
    """Mutate a good file byte by byte, or write one of random bytes, and read it."""
    path = folder / "file.npz"

    @settings(max_examples=cases, suppress_health_check=SLOW)
    @given(st.one_of(EDITS, EDITS, EDITS, st.binary(max_size=300)))
    def check(change: Any) -> None:
        path.write_bytes(change if isinstance(change, bytes) else edited(good(name), change))
        refusal(lambda file: SURFACES[name].read(file), path)

    check()


def check_content(name: str, cases: int, folder: Path) -> None:
    """Change what a good archive holds, give it a checksum that is right, and read it."""
    path, kind = folder / "file.npz", str(SURFACES[name].kind)
    path.write_bytes(good(name))
    header, arrays = archive.read(path, kind)

    @settings(max_examples=cases, suppress_health_check=SLOW)
    @given(
        st.lists(st.integers(0, 30), max_size=4),
        ODD_JSON,
        st.booleans(),
        st.none() | st.tuples(st.integers(0, 30), ODD_ARRAYS | st.none() | st.sampled_from(["other"])),
    )
    def check(place: list[int], value: Any, drop: bool, array: tuple[int, Any] | None) -> None:
        changed_header = replaced(header, place, value, drop) if place else dict(header)
        changed = dict(arrays)
        if array is not None:
            at = sorted(changed)[array[0] % len(changed)]
            if array[1] is None or isinstance(array[1], str):
                kept = changed.pop(at)
                changed |= {} if array[1] is None else {array[1]: kept}
            else:
                changed[at] = array[1]
        archive.write(path, kind, changed_header, changed)
        refusal(lambda file: SURFACES[name].read(file), path)

    check()


@pytest.mark.parametrize("name", SURFACES)
def test_any_bytes_are_read_or_refused(name: str, tmp_path: Path) -> None:
    check_bytes(name, 25, tmp_path)


@pytest.mark.parametrize("name", ARCHIVES)
def test_any_content_of_an_archive_is_read_or_refused(name: str, tmp_path: Path) -> None:
    check_content(name, 25, tmp_path)


@pytest.mark.nightly
@pytest.mark.parametrize("name", SURFACES)
def test_a_hundred_thousand_files_of_any_bytes_are_read_or_refused(name: str, tmp_path: Path) -> None:
    check_bytes(name, MANY, tmp_path)


@pytest.mark.nightly
@pytest.mark.parametrize("name", ARCHIVES)
def test_a_hundred_thousand_archives_of_any_content_are_read_or_refused(name: str, tmp_path: Path) -> None:
    check_content(name, MANY, tmp_path)


def test_a_good_file_of_every_surface_is_read(tmp_path: Path) -> None:
    for name, surface in SURFACES.items():
        (tmp_path / "good.npz").write_bytes(good(name))
        assert surface.read(tmp_path / "good.npz") is not None
