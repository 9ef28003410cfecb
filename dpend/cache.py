"""Folders for compiled code, which whoever may write to can run code at the next start: their owner's alone."""

from __future__ import annotations

import os
import stat
from pathlib import Path


class NotPrivate(PermissionError):
    """Others than its owner may write to a folder that code is loaded from."""


def private_folder(path: Path) -> Path:
    """Return a folder that its owner alone may write to, made with mode 0700 where there is none.

    Raises
    ------
    NotPrivate
        If it belongs to another user, or others may write to it, or to a folder above it, which they could rename.
    OSError
        If it cannot be made.
    """
    path.mkdir(parents=True, exist_ok=True, mode=0o700)
    if hasattr(os, "getuid"):
        found = path.stat()
        if found.st_uid != os.getuid() or found.st_mode & 0o022:
            raise NotPrivate(_reason(path, path))
        for above in path.resolve().parents:
            if _open_to_others(above):
                raise NotPrivate(_reason(path, above))
    return path


def _reason(path: Path, culprit: Path) -> str:
    open_one = "it" if culprit == path else culprit
    return (
        f"Compiled code is not kept in {path}: others than you may write to {open_one}, and so could have you run "
        "their code. Let DPEND_CACHE or NUMBA_CACHE_DIR name a folder of yours."
    )


def _open_to_others(folder: Path) -> bool:
    """Return whether others may rename what lies in a folder; a group that is the user's first may be theirs alone."""
    found = folder.stat()
    if found.st_mode & stat.S_ISVTX:
        return False
    return bool(found.st_mode & 0o002 or (found.st_mode & 0o020 and found.st_gid not in (0, os.getgid())))
