"""Files that are whole: archives of arrays with a header and a checksum, and any file written to its end or not at all.

An archive is a compressed ``.npz`` of plain arrays with two entries more: ``header``, JSON with the file's kind under
``"format"``, and ``checksum``, over everything else.  Nothing in it can run code.  Files from before all three readers
became one still load: they call the header ``about``, have ``format`` and ``kind`` beside it, or have no checksum.
"""

from __future__ import annotations

import hashlib
import json
import os
import threading
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from .arguments import checked_path

Arrays = dict[str, npt.NDArray[Any]]

_RESERVED = ("header", "checksum", "about", "format")


@contextmanager
def atomic(path: str | Path) -> Iterator[Path]:
    """Return the path of a temporary file that takes the place of ``path`` at the end, or vanishes on an error.

    It lies beside the file, whose folder must exist, and has its suffix; devices and pipes are written directly.

    Raises
    ------
    OSError
        If the file cannot be written, in one line that names it.
    """
    target = Path(path).resolve()
    if target.exists() and not target.is_file():
        yield target
        return
    part = target.with_name(f".{target.stem}-{os.getpid()}-{threading.get_ident()}{target.suffix}")
    try:
        yield part
        part.replace(target)
    except OSError as error:
        message = f"{path} could not be written: {error.strerror or error}"
        raise (OSError(error.errno, message) if error.errno else OSError(message)) from error
    finally:
        with suppress(OSError):  # its folder may be none
            part.unlink()


def write(path: str | Path, kind: str, header: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]]) -> Path:
    """Write arrays and a header as an archive, to the end or not at all, and return its path.

    Parameters
    ----------
    path : str or Path
        The file; ``.npz`` is added where the name has no suffix.
    kind : str
        What the file is, with the number of its format, such as ``"dpend run 1"``.
    header : mapping
        What JSON can hold, numpy's numbers and arrays included; anything else is written as its ``str``.
    arrays : mapping of str to ndarray
        None of objects.

    Raises
    ------
    OSError
        If it cannot be written.
    TypeError, ValueError
        If an array holds Python objects, or has a name that the archive itself needs.
    """
    path = checked_path("path", path)
    if not path.suffix:
        path = path.with_suffix(".npz")
    for name, array in arrays.items():
        if name in _RESERVED:
            raise ValueError(f"An array cannot be called {name!r}: the archive itself has an entry of that name.")
        if np.asarray(array).dtype.hasobject:
            raise TypeError(f"An archive holds plain arrays; {name!r} holds Python objects.")
    entries = dict(arrays) | {"header": np.array(json.dumps({**header, "format": kind}, default=_plain))}
    with atomic(path) as part, part.open("wb") as stream:
        np.savez_compressed(stream, checksum=np.array(_checksum(entries)), **cast(Any, entries))
    return path


def read(path: str | Path, kind: str) -> tuple[dict[str, Any], Arrays]:
    """Return the header, without its format, and the arrays of an archive of some kind; see :func:`opened`."""
    with opened(path, kind) as content:
        return content


@contextmanager
def opened(path: str | Path, kind: str) -> Iterator[tuple[dict[str, Any], Arrays]]:
    """Return what :func:`read` does, for a block in which whatever goes wrong is the file's fault.

    Raises
    ------
    OSError
        If the file is not there or cannot be opened.
    ValueError
        If it is something else, of another kind, or damaged, or if the block stumbles over what it holds.
    """
    content = checked_path("path", path).read_bytes()
    try:
        yield _parsed(content, kind)
    except Exception as error:
        if isinstance(error, zipfile.BadZipFile | zlib.error | EOFError | OSError):
            reason = "it is empty, cut short, damaged or no .npz at all"
        else:
            reason = (
                str(error).rstrip(".") if isinstance(error, ValueError) else "it does not hold what such a file does"
            )
        raise ValueError(f"{path} cannot be read as {kind!r}: {reason}. Save it again, or copy it afresh.") from error


def _parsed(content: bytes, kind: str) -> tuple[dict[str, Any], Arrays]:
    if not zipfile.is_zipfile(BytesIO(content)):  # numpy would try other formats
        raise zipfile.BadZipFile
    with np.load(BytesIO(content), allow_pickle=False) as file:
        entries = {name: file[name] for name in file.files}
    checksum = entries.pop("checksum", None)
    if checksum is not None and str(checksum) != _checksum(entries):
        raise ValueError("its checksum does not match what it holds")
    if "header" in entries:
        header = json.loads(str(entries.pop("header")))
    elif "format" in entries:
        names = ("format", "kind")
        header = {name: str(entries.pop(name)) for name in names} | {"about": json.loads(str(entries.pop("about")))}
    elif "about" in entries:
        header = json.loads(str(entries.pop("about")))
    else:
        raise ValueError("it has no header")
    found = header.pop("format")
    if found != kind:
        raise ValueError(f"it is {found!r}")
    return header, entries


def _checksum(entries: Mapping[str, npt.NDArray[Any]]) -> str:
    """Hash names, types, shapes and contents of arrays."""
    digest = hashlib.sha256()
    for name in sorted(entries):
        array = np.ascontiguousarray(entries[name])
        digest.update(f"{name}\0{array.dtype.str}\0{array.shape}\0".encode() + array.tobytes())
    return digest.hexdigest()


def _plain(value: Any) -> Any:
    """Return what JSON can hold instead of numpy's numbers and arrays; ``str`` of anything else."""
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else str(value)
