"""Folders for compiled code, which whoever may write to can run code at the next start: their owner's alone."""

from __future__ import annotations

import os
from pathlib import Path


class NotPrivate(PermissionError):
    """Others than its owner may write to a folder that code is loaded from."""


def private_folder(path: Path) -> Path:
    """Return a folder that its owner alone may write to, made with mode 0700 where there is none.

    Raises
    ------
    NotPrivate
        If it belongs to another user, or others may write to it.
    OSError
        If it cannot be made.
    """
    path.mkdir(parents=True, exist_ok=True, mode=0o700)
    if hasattr(os, "getuid"):
        found = path.stat()
        if found.st_uid != os.getuid() or found.st_mode & 0o022:
            raise NotPrivate(
                f"Compiled code is not kept in {path}: others than you may write to it, and so could have you run "
                "their code. Delete it, or let DPEND_CACHE or NUMBA_CACHE_DIR name a folder of yours."
            )
    return path
