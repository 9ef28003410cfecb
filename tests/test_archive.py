"""Archives and atomic files: what is written comes back, and what is not whole is never taken for it."""

from __future__ import annotations

import json
import os
import re
import resource
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controllers.trajectory import Trajectory
from dpend import archive

KIND = "a test 1"
HEADER = {"name": "swing", "gain": np.float64(0.1), "row": np.arange(3), "where": Path("here")}
ARRAYS = {"x": np.linspace(0.0, 1.0, 12).reshape(3, 4), "n": np.array(7), "word": np.array("tanh")}
ROOT = Path(__file__).parent.parent


def whole(message: str) -> str:
    return f"^{re.escape(message)}$"


def entries(path: Path) -> dict[str, Any]:
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def test_an_archive_comes_back_with_its_header_and_its_arrays_bit_for_bit(tmp_path: Path) -> None:
    path = archive.write(tmp_path / "swing", KIND, HEADER, ARRAYS)
    assert path == tmp_path / "swing.npz"
    header, arrays = archive.read(path, KIND)
    assert header == {"name": "swing", "gain": 0.1, "row": [0, 1, 2], "where": "here"}
    assert arrays.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        assert arrays[name].dtype == array.dtype
        np.testing.assert_array_equal(arrays[name], array)


def changed_array(path: Path) -> None:
    parts = entries(path)
    np.savez(path, **parts | {"x": parts["x"] + 1e-12})


def changed_header(path: Path) -> None:
    parts = entries(path)
    parts["header"] = np.array(str(parts["header"]).replace("swing", "swung"))
    np.savez(path, **parts)


CUT = "it is empty, cut short, damaged or no .npz at all"
ALTERED = "its checksum does not match what it holds"
DAMAGE: dict[str, tuple[Callable[[Path], object], str]] = {
    "emptied": (lambda path: path.write_bytes(b""), CUT),
    "cut short": (lambda path: path.write_bytes(path.read_bytes()[:-40]), CUT),
    "text": (lambda path: path.write_text("t,x,u"), CUT),
    "an array changed": (changed_array, ALTERED),
    "the header changed": (changed_header, ALTERED),
    "no header": (lambda path: np.savez(path, x=np.zeros(3)), "it has no header"),
    "another kind": (lambda path: archive.write(path, "a run 1", {}, {}), "it is 'a run 1'"),
    "a list for a header": (
        lambda path: np.savez(path, header=np.array("[1]")),
        "it does not hold what such a file does",
    ),
    "objects": (
        lambda path: np.savez(path, header=np.array([path], dtype=object)),
        "Object arrays cannot be loaded when allow_pickle=False",
    ),
}


@pytest.mark.parametrize(("damage", "reason"), DAMAGE.values(), ids=DAMAGE)
def test_a_damaged_or_foreign_file_is_refused_by_name_with_the_remedy(
    damage: Callable[[Path], object], reason: str, tmp_path: Path
) -> None:
    path = archive.write(tmp_path / "good.npz", KIND, HEADER, ARRAYS)
    damage(path)
    message = f"{path} cannot be read as {KIND!r}: {reason}. Save it again, or copy it afresh."
    with pytest.raises(ValueError, match=whole(message)):
        archive.read(path, KIND)


def test_every_byte_of_an_archive_counts(tmp_path: Path) -> None:
    path = archive.write(tmp_path / "good.npz", KIND, {"name": "swing"}, {"x": np.arange(4.0)})
    good = path.read_bytes()
    found = 0
    for place in range(0, len(good), 7):
        path.write_bytes(good[:place] + bytes([good[place] ^ 255]) + good[place + 1 :])
        try:
            header, arrays = archive.read(path, KIND)
        except ValueError:
            found += 1
        else:  # a byte that says nothing of what is held, such as a date
            assert header == {"name": "swing"}
            np.testing.assert_array_equal(arrays["x"], np.arange(4.0))
    assert found > len(good) / 7 / 2


def test_what_goes_wrong_over_the_content_is_the_files_fault_and_a_missing_file_is_not(tmp_path: Path) -> None:
    path = archive.write(tmp_path / "good.npz", KIND, HEADER, ARRAYS)
    message = f"{path} cannot be read as {KIND!r}: x must grow. Save it again, or copy it afresh."
    with pytest.raises(ValueError, match=whole(message)), archive.opened(path, KIND):
        raise ValueError("x must grow.")
    with pytest.raises(FileNotFoundError):
        archive.read(tmp_path / "nowhere.npz", KIND)


def test_an_archive_takes_neither_objects_nor_the_names_of_its_own_entries(tmp_path: Path) -> None:
    message = "An archive holds plain arrays; 'x' holds Python objects."
    with pytest.raises(TypeError, match=whole(message)):
        archive.write(tmp_path / "a", KIND, {}, {"x": np.array([None])})
    message = "An array cannot be called 'header': the archive itself has an entry of that name."
    with pytest.raises(ValueError, match=whole(message)):
        archive.write(tmp_path / "a", KIND, {}, {"header": np.zeros(3)})
    assert not list(tmp_path.iterdir())


def test_files_of_the_first_version_still_load() -> None:
    planned = sorted(
        set((ROOT / "controllers/data").glob("*.npz")) - set((ROOT / "controllers/data").glob("*_tuned_*"))
    )
    learned = sorted((ROOT / "rl" / "trained").glob("*.npz"))
    assert planned
    assert learned
    for path in planned:
        assert len(Trajectory.load(path).u)
    for path in learned:
        header, arrays = archive.read(path, "dpend policy 2")
        assert header.keys() == {"kind", "about"}
        assert arrays


def test_a_policy_of_the_first_version_is_held_to_its_checksum(tmp_path: Path) -> None:
    parts = entries(ROOT / "rl" / "trained" / "lspi.npz")
    path = tmp_path / "lspi.npz"
    np.savez(path, **parts | {"K": parts["K"] + 1})
    message = f"{path} cannot be read as 'dpend policy 2': {ALTERED}. Save it again, or copy it afresh."
    with pytest.raises(ValueError, match=whole(message)):
        archive.read(path, "dpend policy 2")


def test_runs_of_the_first_version_kept_their_header_under_another_name(tmp_path: Path) -> None:
    path = tmp_path / "old.npz"
    np.savez(path, about=np.array(json.dumps({"format": KIND, "seed": 3})), x=np.zeros(2))
    header, arrays = archive.read(path, KIND)
    assert header == {"seed": 3}
    assert list(arrays) == ["x"]


# ------------------------------------------------------------------------------------------------------ atomic files


def test_a_file_is_as_it_was_until_it_is_written_to_its_end(tmp_path: Path) -> None:
    path = tmp_path / "figure.png"
    path.write_text("old")
    with archive.atomic(path) as part:
        part.write_text("new")
        assert part.suffix == ".png"
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("interruption", [ValueError("no"), KeyboardInterrupt()])
def test_what_interrupts_the_writing_leaves_the_old_file_and_no_other(
    interruption: BaseException, tmp_path: Path
) -> None:
    path = tmp_path / "table.csv"
    path.write_text("old")

    def interrupted() -> None:
        with archive.atomic(path) as part:
            part.write_text("half")
            raise interruption

    with pytest.raises(type(interruption)):
        interrupted()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    path = tmp_path / "nowhere" / "run.npz"
    message = f"[Errno 2] {path} could not be written: No such file or directory"
    with pytest.raises(FileNotFoundError, match=whole(message)):
        archive.write(path, KIND, {}, ARRAYS)


def test_a_full_disk_leaves_no_half_of_a_file(tmp_path: Path) -> None:
    path = tmp_path / "runs.npz"
    noise = np.random.default_rng(0).normal(size=100_000)
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:  # a limit on the size of files is the full disk that a test can have
        try:
            resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
            archive.write(path, KIND, {}, {"noise": noise})
        except OSError as error:
            os.write(writer, str(error).encode())
        finally:
            os._exit(0)
    os.waitpid(child, 0)
    os.close(writer)
    with os.fdopen(reader) as message:
        assert message.read() == f"[Errno 27] {path} could not be written: File too large"
    assert not list(tmp_path.iterdir())


def test_a_device_is_written_directly() -> None:
    with archive.atomic("/dev/null") as part:
        part.write_text("nothing")
    assert not Path("/dev/null").is_file()
