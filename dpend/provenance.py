"""Where a result comes from: a fingerprint of the sources, and the versions of what they ran on."""

from __future__ import annotations

import hashlib
import platform
from functools import cache
from importlib import metadata
from pathlib import Path

_LIBRARIES = ("dpend", "numpy", "scipy", "numba", "casadi", "control", "gymnasium", "matplotlib")


@cache
def fingerprint(*sources: Path) -> str:
    """Hash Python sources in sixteen digits, so that results of another state of the code are recognised.

    Of a folder every ``*.py`` counts, sub-folders not.
    """
    files = {file for source in sources for file in (source.glob("*.py") if source.is_dir() else (source,))}
    digest = hashlib.sha256()
    for file in sorted(files):
        digest.update(file.name.encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:16]


def versions() -> dict[str, str]:
    """Return the versions of Python, of the machine's architecture, and of the libraries that results depend on."""
    found = {"python": platform.python_version(), "machine": platform.machine()}
    return found | {library: _version(library) for library in _LIBRARIES}


@cache  # looking it up reads files, and a study asks once a job
def _version(library: str) -> str:
    try:
        return metadata.version(library)
    except metadata.PackageNotFoundError:
        return "not installed"
