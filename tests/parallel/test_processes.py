"""Tests of work in processes: an error, or a reader that stops, ends all of it at once."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from roboassembly.parallel.processes import map_ordered, map_unordered

_LONG = 300.0
"""Duration of a task that no test waits for [s]."""


def work(seconds: float) -> float:
    """Sleep, or fail if the time is invalid."""
    time.sleep(seconds)
    return seconds


def test_results_in_order_and_in_order_of_completion() -> None:
    assert list(map_ordered(work, [0.2, 0.0, 0.1], 2, chunk=1)) == [0.2, 0.0, 0.1]
    assert sorted(map_unordered(work, [0.2, 0.0, 0.1], 2)) == [0.0, 0.1, 0.2]
    assert list(map_ordered(work, [0.0, 0.0], 1, chunk=1)) == [0.0, 0.0]


@pytest.mark.parametrize("several", [map_unordered, lambda *args: map_ordered(*args, chunk=1)])
def test_error_is_raised_before_other_tasks_end(several) -> None:
    begun = time.monotonic()
    with pytest.raises(ValueError, match="sleep"):
        list(several(work, [-1.0, _LONG, _LONG, _LONG], 2))
    assert time.monotonic() - begun < 0.5 * _LONG


def test_workers_stop_when_the_reader_stops() -> None:
    begun = time.monotonic()
    results = map_unordered(work, [0.0, _LONG, _LONG], 2)
    assert next(results) == 0.0
    del results
    assert time.monotonic() - begun < 0.5 * _LONG


_PARENT = """
import os, sys, time
from pathlib import Path
from roboassembly.parallel.processes import map_unordered

def work(folder):
    Path(folder, str(os.getpid())).touch()
    time.sleep(300)

if __name__ == "__main__":
    list(map_unordered(work, [sys.argv[1]] * 2, 2))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="SIGKILL")
def test_workers_end_with_a_parent_that_is_killed(tmp_path: Path) -> None:
    script, folder = tmp_path / "parent.py", tmp_path / "workers"
    script.write_text(_PARENT)
    folder.mkdir()
    parent = subprocess.Popen([sys.executable, str(script), str(folder)])
    try:
        _wait_until(lambda: len(list(folder.iterdir())) == 2)
    finally:
        parent.send_signal(signal.SIGKILL)
        parent.wait()
    workers = [int(file.name) for file in folder.iterdir()]
    _wait_until(lambda: not any(_is_alive(pid) for pid in workers))


def _wait_until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    # A process that has ended stays in the table until its new parent notices.
    stat = Path(f"/proc/{pid}/stat")
    return not stat.is_file() or stat.read_text().rsplit(")", 1)[1].split()[0] != "Z"
