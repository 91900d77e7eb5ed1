"""Names of parts from a hierarchy of groups."""

from __future__ import annotations

import pytest

from roboassembly.importers.scene import Node, given_name, part_names


def names(*paths: str) -> list[str]:
    """Return the names for paths such as `1 table/2 left/3 leg`: number and name of each node."""
    split = [[node.partition(" ") for node in path.split("/")] for path in paths]
    return part_names([[Node(int(number), name) for number, _, name in path] for path in split], "default")


@pytest.mark.parametrize(
    ("paths", "expected"),
    [
        (["1 leg", "2 seat"], ["leg", "seat"]),
        (["1 leg", "2 leg"], ["leg", "leg_2"]),
        (["0 t/1 a/2 leg", "0 t/3 b/4 leg"], ["a/leg", "b/leg"]),
        (["0 t/1 a/2 leg", "0 t/1 a/3 leg", "0 t/4 b/5 leg"], ["a/leg", "a/leg_2", "b/leg"]),
        (["0 t/1 a/2 leg", "0 t/3 a/4 leg", "0 t/5 top"], ["a/leg", "a_2/leg", "top"]),
        (["0 x/1 a/2 leg", "3 y/4 a/5 leg"], ["x/a/leg", "y/a/leg"]),
        (["0 t/1 leg", "0 t/2 b/3 leg"], ["t/leg", "b/leg"]),
        (["0 /1 /2 leg", "0 /3 /4 leg"], ["leg", "leg_2"]),
        (["0 chair/1 ", "0 chair/2 seat"], ["chair", "seat"]),
        (["0 /1 ", "0 /2 "], ["default", "default_2"]),
        (["1 leg", "2 leg", "3 leg_2"], ["leg", "leg_3", "leg_2"]),
    ],
)
def test_names(paths: list[str], expected: list[str]) -> None:
    assert names(*paths) == expected


@pytest.mark.parametrize(
    "made_up", ["NAUO12", "=>[0:1:1:2]", "SOLID", "COMPOUND", "0:1:1", "Open CASCADE STEP translator 7.5 1"]
)
def test_names_that_programs_make_up(made_up: str) -> None:
    assert given_name(made_up) == ""


@pytest.mark.parametrize("kept", ["leg", "Solid oak", "nauo", "1", "Body1"])
def test_names_that_people_give(kept: str) -> None:
    assert given_name(kept) == kept
