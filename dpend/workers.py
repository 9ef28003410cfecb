"""Worker processes that end with their parent, leave Ctrl-C to it, and say what to do where they cannot start."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import current_process, get_context, parent_process
from multiprocessing.reduction import ForkingPickler
from pathlib import Path

from .arguments import checked_whole


@contextmanager
def interruptible() -> Iterator[None]:
    """Let Ctrl-C, or ``kill -INT``, interrupt a block even where it was ignored, as a shell's background jobs do."""
    ignored = (
        threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    )
    if ignored:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        if ignored:
            signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def pool(workers: int, **sent: object) -> Iterator[ProcessPoolExecutor]:
    """Return an executor of fresh processes; whatever leaves the block by an exception ends them at once.

    Parameters
    ----------
    workers : int
        How many processes, at least one.
    **sent : object
        What the caller will send to them, by the names that a message should use.

    Raises
    ------
    TypeError, ValueError
        Before a process starts, if something cannot be sent, or ``workers`` is not a whole number, at least one.
    RuntimeError
        If a worker could not import the program that runs, or ended before its time.
    """
    workers = checked_whole("workers", workers)
    if getattr(current_process(), "_inheriting", False):
        raise SystemExit(1)  # a worker that imports its parent's unguarded script; the parent says what is wrong
    _check_program()
    for name, thing in sent.items():
        _check_sendable(name, thing)
    executor = ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_follow_parent)
    with interruptible():
        try:
            yield executor
            executor.shutdown()
        except BaseException as error:
            processes = list((executor._processes or {}).values())
            broken = isinstance(error, BrokenProcessPool)
            # The thread of a broken pool ends by itself; Python 3.11 prints a traceback if the program ends before it.
            executor.shutdown(wait=broken, cancel_futures=True)
            for process in processes:
                process.terminate()
            if not broken:
                raise
            raise RuntimeError(
                "A worker process ended before its work was done. Workers import the script that runs: keep what it "
                'does under `if __name__ == "__main__":`. If it does so already, a worker was killed, most likely for '
                "want of memory: use fewer workers."
            ) from None


def _check_program() -> None:
    """Refuse a program that a worker would look for in a file that does not exist."""
    main = sys.modules["__main__"]
    file = getattr(main, "__file__", None)
    if file is not None and getattr(main, "__spec__", None) is None and not Path(file).exists():
        raise RuntimeError(
            f"Workers import the program that runs, and this one comes from {file}, which is no file: save it as one, "
            "or use workers=1."
        )


def _check_sendable(name: str, thing: object) -> None:
    try:
        sent = bytes(ForkingPickler.dumps(thing))
    except Exception as error:  # what a class raises that cannot be sent is its own affair
        raise TypeError(
            f"{name} cannot be sent to worker processes ({error}): define it at the top level of a module, not within "
            "a function or as a lambda, or use workers=1."
        ) from error
    if b"__main__" in sent and getattr(sys.modules["__main__"], "__file__", None) is None:
        raise TypeError(
            f"{name} is defined in a program that is no file, which worker processes cannot import: define it in a "
            "module, or use workers=1."
        )


def _follow_parent() -> None:
    """Leave Ctrl-C to the parent, and end with it even where it is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()

    def end_with_parent() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()
