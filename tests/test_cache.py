"""Compiled code that is damaged, or that others could have written, is not run but compiled anew."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from rigs import whole

from dpend.cache import NotPrivate, private_folder
from dpend.kernels import compiled


def doubled(x):
    return 2.0 * x


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    return tmp_path


@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
@pytest.mark.parametrize("left", [0, 0.5])
def test_kernels_whose_files_are_cut_short_are_compiled_anew(folder: Path, suffix: str, left: float) -> None:
    assert compiled(doubled)(1.5) == 3.0
    (file,) = folder.rglob(f"*.{suffix}")
    content = file.read_bytes()
    file.write_bytes(content[: int(left * len(content))])
    again = compiled(doubled)
    assert again(1.5) == 3.0
    assert sum(again.stats.cache_misses.values()) == 1
    mended = compiled(doubled)
    assert mended(1.5) == 3.0
    assert sum(mended.stats.cache_hits.values()) == 1


def test_a_disk_that_is_full_is_no_error(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kernel = compiled(doubled)

    def full(*_: object) -> None:
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr("numba.core.caching.IndexDataCacheFile._save_data", full)
    assert kernel(np.float32(2)) == 4.0


@pytest.mark.skipif(os.name != "posix", reason="no owners and modes")
def test_kernels_are_not_kept_where_others_may_write_and_it_is_said(folder: Path) -> None:
    compiled(doubled)
    (own,) = folder.iterdir()
    assert own.stat().st_mode & 0o777 == 0o700
    own.chmod(0o770)
    message = (
        f"Compiled code is not kept in {own}: others than you may write to it, and so could have you run their code. "
        "Let DPEND_CACHE or NUMBA_CACHE_DIR name a folder of yours."
    )
    with pytest.raises(NotPrivate, match=whole(message)):
        private_folder(own)
    with pytest.warns(RuntimeWarning, match=whole(message)):
        kernel = compiled(doubled)
    assert kernel(1.5) == 3.0
    assert not list(folder.rglob("*.nb?"))


@pytest.mark.skipif(os.name != "posix", reason="no owners and modes")
@pytest.mark.parametrize(("mode", "open_to_others"), [(0o777, True), (0o1777, False), (0o755, False)])
def test_a_folder_is_no_more_private_than_those_above_it(folder: Path, mode: int, open_to_others: bool) -> None:
    above = folder / "shared"
    above.mkdir()
    above.chmod(mode)
    if open_to_others:
        with pytest.raises(
            NotPrivate, match=f"is not kept in {above / 'own'}: others than you may write to {above}, and"
        ):
            private_folder(above / "own")
    else:
        assert private_folder(above / "own").is_dir()
