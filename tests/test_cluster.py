"""Jobs that a cluster does: the same table as here, and none by workers with other code."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import pytest

from studies import _runner
from studies._cluster import OtherCode, cluster

distributed = pytest.importorskip(
    "distributed", reason="distributed is not installed, so no cluster is tried; install the extra `cluster`."
)
pytestmark = pytest.mark.slow
QUICK = ("--quick", "--only", "LQR", "LSPI", "--workers", "1")


@pytest.fixture
def address() -> Iterator[str]:
    """Return where the scheduler of a cluster of two threads listens."""
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, protocol="tcp", dashboard_address=None
    ) as machines:
        yield machines.scheduler_address


def test_a_cluster_gives_the_table_that_this_machine_gives(address: str, tmp_path: Path) -> None:
    here = _runner.main("studies.lambda_sweep", [*QUICK, "--out", str(tmp_path / "here")])
    there = _runner.main("studies.lambda_sweep", [*QUICK, "--scheduler", address, "--out", str(tmp_path / "there")])
    pd.testing.assert_frame_equal(here.rows, there.rows)


def test_a_worker_with_other_code_does_nothing(address: str) -> None:
    keys = iter("ab")
    with cluster(address, lambda name, job: next(keys)) as workers, pytest.raises(OtherCode, match="install the same"):
        workers.submit(print, "studies.lambda_sweep", 1).result()


def test_an_address_at_which_nobody_answers_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        _runner.main("studies.lambda_sweep", [*QUICK, "--scheduler", "tcp://127.0.0.1:9", "--out", str(tmp_path)])
    assert "No Dask scheduler answers at 'tcp://127.0.0.1:9'" in " ".join(capsys.readouterr().err.split())
