"""What the tests of worker processes run: programs that a user might write, and work that can be watched."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import numpy as np

from dpend.controller import Act
from dpend.params import Array
from dpend.workers import pool


class OneByOne:
    """A law that treats one run at a time."""

    batched = False

    def start(self, n: int, rng: np.random.Generator) -> Act:
        def act(t: float, y: Array) -> Array:
            return -y[:, 0]

        return act


def nap(folder: str) -> None:
    """Leave a file with this process's number, and sleep for longer than any test lasts."""
    Path(folder, str(os.getpid())).touch()
    time.sleep(120)


if __name__ == "__main__":
    with pool(2) as executor:
        list(executor.map(nap, [sys.argv[1]] * 2))
