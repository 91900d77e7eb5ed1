"""The tool that replays episodes under the paper's own test of a pair, on a table by hand."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

import shapes
from roboassembly.furniture.model import Furniture
from scripts import script

tool = script("tools/paper_pairs.py")


@dataclass
class _Ref:
    piece: Furniture

    def furniture(self, *, with_grasps: bool) -> Furniture:
        return self.piece


TOP = 0


@pytest.mark.parametrize(
    ("actions", "as_is", "either"),
    [
        ([[1, TOP, 0, 0, 0], [2, TOP, 0, 1, 0]], True, True),
        # Any leg may stand for any other as long as the leg moves.
        ([[1, TOP, 0, 3, 0], [4, TOP, 0, 0, 0]], True, True),
        ([[TOP, 1, 0, 0, 0], [TOP, 2, 1, 0, 0]], True, True),
        # The top does not fit another leg than its corner's own, unless the leg's place is what moves.
        ([[TOP, 1, 3, 0, 0]], False, True),
    ],
)
def test_pairs_of_a_table(actions: list[list[int]], as_is: bool, either: bool) -> None:
    assert tool.accepted(_Ref(shapes.table()), actions) == (as_is, either)
