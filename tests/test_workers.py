"""Worker processes: they end with their parent, leave Ctrl-C to it, and say what to do where they cannot start."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dpend
from dpend.workers import interruptible, pool
from tests.rigs import whole
from tests.workers_example import OneByOne

ROOT = Path(__file__).parent.parent
RIG = dpend.rig("gustafsson2016")


def start(folder: Path, **options: Any) -> tuple[subprocess.Popen[str], list[int]]:
    """Start the example and wait for its two workers."""
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.workers_example", str(folder)],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        **options,
    )
    while len(list(folder.iterdir())) < 2:
        time.sleep(0.05)
        assert process.poll() is None
    return process, [int(file.name) for file in folder.iterdir()]


def wait_for_end(pids: list[int]) -> None:
    """Wait a little for processes to be gone."""
    began = time.monotonic()
    while alive := [pid for pid in pids if Path(f"/proc/{pid}").exists()]:
        assert time.monotonic() - began < 10, f"{alive} live on"
        time.sleep(0.05)


@pytest.mark.slow
@pytest.mark.parametrize("inherited", [signal.SIG_DFL, signal.SIG_IGN], ids=["in front", "in the background"])
def test_one_interrupt_ends_parent_and_workers_at_once(inherited: signal.Handlers, tmp_path: Path) -> None:
    process, workers = start(tmp_path, preexec_fn=lambda: signal.signal(signal.SIGINT, inherited))
    began = time.monotonic()
    process.send_signal(signal.SIGINT)
    output, _ = process.communicate(timeout=20)
    assert time.monotonic() - began < 5  # a second where the machine is quiet
    assert output.endswith("KeyboardInterrupt\n")
    assert output.count("Traceback") == 1
    wait_for_end(workers)


@pytest.mark.slow
def test_workers_end_with_a_parent_that_is_killed(tmp_path: Path) -> None:
    process, workers = start(tmp_path)
    process.kill()
    process.communicate()
    wait_for_end(workers)


SCRIPT = """
import numpy as np, dpend
from tests.workers_example import OneByOne
{more}
runs = dpend.simulate_many(dpend.rig("gustafsson2016"), {law}, np.zeros((4, 6)), 0.1, workers=2)
print(len(runs))
"""


def run_from_file(program: str, folder: Path) -> subprocess.CompletedProcess[str]:
    (folder / "script.py").write_text(program)
    return finished([sys.executable, str(folder / "script.py")])


def run_from_input(program: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return finished([sys.executable], input=program)


def run_from_line(program: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return finished([sys.executable, "-c", program])


def finished(command: list[str], **options: Any) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=120, **options)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("run", "more", "law", "error"),
    [
        (
            run_from_file,
            "",
            "OneByOne()",
            "RuntimeError: A worker process ended before its work was done. Workers import the script that runs: keep "
            'what it does under `if __name__ == "__main__":`. If it does so already, a worker was killed, most likely '
            "for want of memory: use fewer workers.",
        ),
        (
            run_from_input,
            "",
            "OneByOne()",
            "RuntimeError: Workers import the program that runs, and this one comes from <stdin>, which is no file: "
            "save it as one, or use workers=1.",
        ),
        (
            run_from_line,
            "class Own(OneByOne): ...",
            "Own()",
            "TypeError: controller is defined in a program that is no file, which worker processes cannot import: "
            "define it in a module, or use workers=1.",
        ),
    ],
    ids=["no guard", "standard input", "a class on the command line"],
)
def test_a_program_that_workers_cannot_import_is_told_the_remedy_once(
    run: Callable[[str, Path], subprocess.CompletedProcess[str]], more: str, law: str, error: str, tmp_path: Path
) -> None:
    done = run(SCRIPT.format(more=more, law=law), tmp_path)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == error
    assert done.stderr.count("Traceback") == 1


@pytest.mark.slow
def test_a_program_without_a_file_may_use_workers_for_what_modules_define(tmp_path: Path) -> None:
    done = run_from_line(SCRIPT.format(more="", law="OneByOne()"), tmp_path)
    assert (done.stdout, done.stderr) == ("4\n", "")


def test_what_cannot_be_sent_is_refused_by_name_before_anything_runs() -> None:
    class Local(OneByOne): ...

    remedy = "define it at the top level of a module, not within a function or as a lambda, or use workers=1."
    x0 = np.zeros((4, 6))
    with pytest.raises(TypeError, match=rf"^controller cannot be sent to worker processes \(.+Local.+\): {remedy}$"):
        dpend.simulate_many(RIG, Local(), x0, 0.1, workers=2)
    with pytest.raises(TypeError, match=rf"^push cannot be sent to worker processes \(.+lambda.+\): {remedy}$"):
        dpend.simulate_many(RIG, OneByOne(), x0, 0.1, workers=2, push=lambda t: (0, 0, 0))


@pytest.mark.parametrize("workers", [0, -1, 2.0, True, "2"])
def test_a_number_of_workers_that_is_none_and_a_seed_that_is_none_are_errors_of_one_type(workers: Any) -> None:
    message = whole(f"workers must be a whole number, at least 1; got {workers!r}.")
    with pytest.raises(ValueError, match=message):
        dpend.simulate_many(RIG, OneByOne(), np.zeros((4, 6)), 0.1, workers=workers)
    with pytest.raises(ValueError, match=message), pool(workers):
        pass
    with pytest.raises(ValueError, match=re.escape("seed must be a whole number, at least 0; got -1.")):
        dpend.simulate_many(RIG, OneByOne(), np.zeros((4, 6)), 0.1, seed=-1)


def test_an_interrupt_that_was_ignored_counts_within_the_block_alone() -> None:
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)

    def interrupted() -> None:
        with interruptible():
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(5)

    try:
        with pytest.raises(KeyboardInterrupt):
            interrupted()
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)
