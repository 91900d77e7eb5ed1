"""Tests of work in processes: an error, or a reader that stops, ends all of it at once."""

from __future__ import annotations

import time

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
