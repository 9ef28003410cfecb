# pyright: reportMissingImports=false
"""Jobs of a study done by a cluster: whatever Dask can reach, from one machine to a queue of thousands."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from typing import Any

Key = Callable[[str, Any], str]


class OtherCode(OSError):
    """A worker would compute something else than this machine: it has other sources, data or versions of libraries."""


@contextmanager
def cluster(address: str, key: Key) -> Iterator[Executor]:
    """Return an executor of the workers of a Dask scheduler; what is left when the block ends is cancelled.

    Parameters
    ----------
    address : str
        Where the scheduler listens, such as ``"tcp://node1:8786"``.
    key : callable
        What a result depends on, by the name of a study and a job: a worker whose key is another raises OtherCode.

    Raises
    ------
    ConnectionError
        If Dask is not installed, or nobody answers at the address.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise ConnectionError(
            "A cluster is reached through Dask: pip install 'dpend[cluster]', here and on the workers."
        ) from error
    try:
        client = Client(address, timeout=10)
    except (OSError, ValueError) as error:
        raise ConnectionError(
            f"No Dask scheduler answers at {address!r}; `dask scheduler` starts one, and prints its address."
        ) from error
    with client:
        executor = client.get_executor(pure=False, retries=1)
        try:
            yield _Same(executor, key)
        finally:
            executor.shutdown(wait=False)


class _Same(Executor):
    """An executor whose workers first make sure that they would compute what this machine would."""

    def __init__(self, workers: Executor, key: Key) -> None:
        self._workers, self._key = workers, key

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Have a study's job done: its name and the job come first."""
        name, job, *others = args
        return self._workers.submit(_done_alike, self._key, self._key(name, job), fn, name, job, *others, **kwargs)


def _done_alike(key: Key, expected: str, do: Callable[..., Any], name: str, job: Any, *others: Any) -> Any:
    """Do a job on a worker whose key for it is that of the machine that asks."""
    if key(name, job) != expected:
        raise OtherCode(
            f"A worker of the cluster has other sources, data or libraries than this machine for {name}: install the "
            "same version of dpend, numpy, scipy, casadi and numba on all."
        )
    return do(name, job, *others)
