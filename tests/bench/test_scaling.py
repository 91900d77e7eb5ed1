"""Tests of the benchmark of the cost against the number of parts."""

from __future__ import annotations

import pytest

from roboassembly.bench.scaling import LATTICES, SERIES, SHELVES, ScalingRow, exponent, run_scaling_bench


def row(parts: int, seconds: float, solved: bool = True) -> ScalingRow:
    return ScalingRow("x", parts, solved, parts - 1, 100, seconds)


def test_the_exponent_of_a_power_is_found() -> None:
    rows = [row(n, 0.01 * n**1.5) for n in (8, 20, 100)]
    assert exponent(rows) == pytest.approx(1.5)
    assert exponent([*rows, row(200, 1e-3, solved=False)]) == pytest.approx(1.5)


@pytest.mark.parametrize(("series", "sizes"), [("shelves", SHELVES), ("lattices", LATTICES)])
def test_designs_have_the_stated_number_of_parts(series: str, sizes: tuple[int, ...]) -> None:
    design, listed = SERIES[series]
    assert tuple(listed) == sizes
    assert [len(design(n).parts()) for n in sizes[:4]] == list(sizes[:4])


@pytest.mark.parametrize("largest", [12, pytest.param(24, marks=pytest.mark.slow)])
def test_pieces_are_solved_also_those_of_more_parts_than_the_papers(largest: int) -> None:
    report = run_scaling_bench(largest=largest, seed=1)
    assert [(r.series, r.parts, r.solved) for r in report.rows] == [
        *(("shelves", n, True) for n in (8, 12, 20) if n <= largest),
        *(("lattices", n, True) for n in (10, 17, 24) if n <= largest),
    ]
    assert all(r.attempts >= r.parts - 1 for r in report.rows)
    assert ("| parts | 8 | 12 | 20 |" if largest == 24 else "| parts | 8 | 12 |") in report.to_text()
