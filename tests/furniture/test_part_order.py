"""Numbers of parts: PartNet's hierarchy first, then left to right, front to back, bottom to top."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from roboassembly.furniture.model import RawPart
from roboassembly.furniture.part_order import in_partnet_order, label_path
from roboassembly.generate import CHAIRS, generate
from roboassembly.geometry.meshes import Mesh
from shapes import brick


def part(name: str, leaf: str, x: float, y: float, z: float) -> RawPart:
    mesh = brick(0.02, 0.02, 0.02)
    return RawPart(name, Mesh(mesh.vertices + np.array([x, y, z]), mesh.faces), label_path(leaf))


CORNERS = {
    "front_left": (0.2, -0.2), "back_left": (0.18, 0.2), "front_right": (-0.2, -0.2), "back_right": (-0.18, 0.2),
}  # fmt: skip
LEGS = [part(f"leg_{name}", "leg", x, y, 0.2) for name, (x, y) in CORNERS.items()]


def names(parts) -> list[str]:
    return [p.name for p in parts]


def test_labels_have_partnets_path() -> None:
    assert label_path("leg") == "chair_base/regular_leg_base/leg"
    assert label_path("back_surface_vertical_bar") == "chair_back/back_surface/back_surface_vertical_bar"
    assert label_path("wing nut") == "wing nut"


def test_backs_come_before_arms_seats_and_bases() -> None:
    parts = [
        part("rung", "bar_stretcher", 0, 0, 0.1),
        part("cup holder", "cup holder", 0, 0, 0.6),
        part("leg", "leg", 0.2, 0, 0.2),
        part("apron", "seat_frame_bar", 0, 0, 0.4),
        part("seat", "seat_single_surface", 0, 0, 0.45),
        part("armrest", "arm_horizontal_bar", 0.2, 0, 0.6),
        part("post", "back_frame_vertical_bar", 0.2, 0.2, 0.6),
        part("slat", "back_surface_horizontal_bar", 0, 0.2, 0.6),
        part("headrest", "headrest", 0, 0.2, 1.0),
    ]
    assert names(in_partnet_order(parts)) == [
        "headrest", "slat", "post", "armrest", "seat", "apron", "leg", "rung", "cup holder",
    ]  # fmt: skip


def test_each_arm_is_a_node_of_its_own() -> None:
    arms = [part(f"{what}_{side}", leaf, x, 0, z) for what, leaf, z in
            (("rest", "arm_horizontal_bar", 0.65), ("post", "arm_near_vertical_bar", 0.55))
            for side, x in (("right", -0.25), ("left", 0.25))]  # fmt: skip
    assert names(in_partnet_order(arms)) == ["post_left", "rest_left", "post_right", "rest_right"]


def test_legs_of_one_side_come_together_although_they_splay() -> None:
    assert names(in_partnet_order(LEGS[::-1])) == [p.name for p in LEGS]


@pytest.mark.parametrize(("axis", "expected"), [(0, "dcba"), (1, "abcd"), (2, "abcd")])
def test_bars_in_a_row_are_counted_along_the_row(axis: int, expected: str) -> None:
    # The sitter's left is +x, the back +y. The others are bent by a few millimetres.
    bars = []
    for i, name in enumerate("abcd"):
        place = [0.003 * (i % 2), 0.3 + 0.004 * (i == 1), 0.6]
        place[axis] = 0.07 * (i - 1.5) + 0.3 * (axis > 0)
        bars.append(part(name, "back_surface_vertical_bar", *place))
    assert "".join(names(in_partnet_order([bars[2], bars[0], bars[3], bars[1]]))) == expected


@pytest.mark.parametrize("family", list(CHAIRS))
def test_order_does_not_depend_on_how_parts_are_given(family: str) -> None:
    parts = generate(family, 3)
    order = np.random.default_rng(0).permutation(len(parts))
    assert names(in_partnet_order([parts[i] for i in order])) == names(parts)


@pytest.mark.parametrize("family", list(CHAIRS))
def test_versions_of_a_chair_number_the_same_parts_alike(family: str) -> None:
    # Bars are numbered from the right, in mirror images from the left; a star of five feet has no sides.
    versions = [[p.label if p.name[-1].isdigit() else p.name for p in generate(family, 2, v)] for v in range(3)]
    assert versions[0] == versions[1] == versions[2]


def test_all_labels_of_generated_chairs_are_known() -> None:
    for family, seed in itertools.product(CHAIRS, range(3)):
        assert all(p.label.startswith("chair_") for p in generate(family, seed)), family
