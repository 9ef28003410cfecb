"""Where a result comes from: a fingerprint of the sources, and the versions of what they ran on."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Iterable
from functools import cache
from importlib import metadata
from pathlib import Path

_LIBRARIES = ("dpend", "numpy", "scipy", "numba", "control", "gymnasium", "matplotlib")


@cache
def fingerprint(*folders: Path) -> str:
    """Hash the Python sources in some folders, so that results of another state of the code are told apart.

    Parameters
    ----------
    *folders : Path
        Packages; their ``*.py`` count, sub-packages do not.

    Returns
    -------
    str
        Sixteen hexadecimal digits.
    """
    digest = hashlib.sha256()
    for source in sorted(_sources(folders)):
        digest.update(source.name.encode() + b"\0" + source.read_bytes())
    return digest.hexdigest()[:16]


def _sources(folders: Iterable[Path]) -> Iterable[Path]:
    return (source for folder in folders for source in folder.glob("*.py"))


def versions() -> dict[str, str]:
    """Give the versions of Python, of the machine's architecture, and of the libraries that results depend on."""
    found = {"python": platform.python_version(), "machine": platform.machine()}
    for library in _LIBRARIES:
        try:
            found[library] = metadata.version(library)
        except metadata.PackageNotFoundError:
            found[library] = "not installed"
    return found
