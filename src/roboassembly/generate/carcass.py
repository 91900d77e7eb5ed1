"""Boxes to practise on: boards between, on and behind boards, butted or housed, on feet or on the floor.

Like `lattice` no furniture of its own, but what shelves, cabinets, drawers and benches have in common.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from roboassembly.generate.design import Assembly, Blank, Design, chance, drawn, family, one_of, size
from roboassembly.generate.joints import CLEARANCE, RoundTenon, Tenon, joint_frame, mouths
from roboassembly.generate.solids import block, turned
from roboassembly.generate.vectors import Vector, X, Y, Z, move, turn, vector

Shares = tuple[float, ...]


def draw_bays(rng: np.random.Generator, _: Any) -> Shares:
    """Draw one to three bays, often equal ones."""
    count = int(rng.choice([1, 1, 1, 2, 2, 3]))
    shares = rng.dirichlet(np.full(count, 6.0)) if rng.random() < 0.5 else np.full(count, 1.0 / count)
    return tuple(map(float, shares))


def draw_shelves(rng: np.random.Generator, s: Any) -> tuple[Shares, ...]:
    """Draw up to three shelves for each bay, or the same for all of them."""
    shelves: list[Shares] = []
    for _ in s.bays:
        count = int(rng.integers(0, 4))
        even = [(k + 1) / (count + 1) for k in range(count)]
        shelves.append(tuple(even if rng.random() < 0.6 else [h + rng.uniform(-0.08, 0.08) for h in even]))
    return (shelves[0],) * len(shelves) if rng.random() < 0.5 else tuple(shelves)


@family("carcass", "boards between, on and behind boards at random", "abstract")
class Carcass(Design):
    """A box of 4 to 18 parts; x across, y from front to back."""

    bays: Shares = drawn((1.0,), draw_bays)  # shares of the width between the sides, with dividers between them
    shelves: tuple[Shares, ...] = drawn(((0.35, 0.7),), draw_shelves)  # of each bay: heights, shares of the room
    back: bool = chance(True)  # a board behind everything
    width: float = size(0.8, 0.25, 1.4)
    height: float = size(1.0, 0.2, 1.7)
    depth: float = size(0.3, 0.15, 0.55)
    board: float = size(0.018, 0.012, 0.035)
    top_over: bool = chance(True, 0.6)  # the top lies on the sides, not between them
    bottom_under: bool = chance(False, 0.4)
    # Bars between the sides at the back, where there is no board.
    rails: int = drawn(0, lambda rng, s: 0 if s.back else int(rng.integers(0, 3)))
    feet: bool = chance(False, 0.3)
    housing: float = one_of(0.0, 0.0, 0.35, 0.45)  # share of the sides' thickness that shelves go in; 0 for butted ones
    shelf_depth: float = one_of(1.0, 1.0, 0.8, 0.6)  # share of the depth, from the back
    tilt: float = drawn(0.0, lambda rng, _: rng.uniform(-0.3, 0.3) if rng.random() < 0.2 else 0.0)  # about x

    def fits(self) -> bool:
        narrow = min(self.bays) * self.width < 0.1
        crowded = any((b - a) * self.height < 0.08 for own in self.shelves for a, b in pairwise(own))
        low = self.height <= 0.12 + 3 * self.board
        return not (narrow or crowded or low) and 4 <= len(self.parts()) <= 18

    def build(self, a: Assembly) -> None:
        s, c = self, CLEARANCE
        foot = 0.06 if s.feet else 0.0
        low = foot + (s.board + c if s.bottom_under else 0.0)
        high = s.height - (s.board + c if s.top_over else 0.0)
        # Left faces of the uprights: two sides and the dividers between them.
        inner = s.width - (len(s.bays) + 1) * s.board
        lefts = np.concatenate([[0.0], np.cumsum([share * inner + s.board for share in s.bays])])
        uprights = [Blank() for _ in lefts]
        floor = low if s.bottom_under else low + 0.04 + s.board
        ceiling = high if s.top_over else high - s.board
        shelves = [[floor + share * (ceiling - floor) for share in own] for own in s.shelves]
        full = ([] if s.bottom_under else [low + 0.04]) + ([] if s.top_over else [high - s.board])
        for bay, own in enumerate(shelves):
            for k, z in enumerate([*own, *full]):
                front = 0.0 if k >= len(own) else (1.0 - s.shelf_depth) * s.depth
                self.shelf(a, f"shelf_{bay}_{k}", lefts[bay : bay + 2], vector(0, front, z), uprights[bay : bay + 2])
        for k in range(s.rails):
            z = floor + (k + 0.5) * (ceiling - floor) / s.rails
            if len(s.bays) == 1 and all(abs(z - height) > 0.12 for height in shelves[0]):
                start = vector(lefts[0] + s.board + c, 0.2 * s.depth, z)
                self.plank(a, f"rail_{k}", "bar", start, vector(lefts[-1] - c, 0.2 * s.depth + 0.02, z + 0.05))
        for k, (left, upright) in enumerate(zip(lefts, uprights, strict=True)):
            upright.body = block(vector(left, 0, low), vector(left, 0, low) + vector(s.board, s.depth, high - low))
            a.part(f"upright_{k}", "board", upright)
        if s.top_over:
            self.plank(a, "top", "board", vector(0, 0, high + c), vector(s.width, s.depth, s.height))
        pinned = s.feet and s.bottom_under and s.board > 0.014  # feet have pins in the bottom
        corner, far = vector(0, 0, foot), vector(s.width, s.depth, foot + s.board)
        bottom = self.plank(a, "bottom", "board", corner, far, alike=not pinned) if s.bottom_under else None
        if s.back:
            self.plank(a, "back", "board", vector(0, s.depth + c, low), vector(s.width, s.depth + c + 0.008, high))
        if s.feet:
            self.stand(a, foot, bottom if pinned else None)
        a.lean(turn(X, s.tilt))

    def shelf(self, a: Assembly, name: str, lefts: np.ndarray, at: Vector, uprights: list[Blank]) -> None:
        """Add a board between two uprights, in grooves that are open at the front, or butted."""
        s, c = self, CLEARANCE
        start, end = (lefts[0] + s.board) * X, lefts[1] * X
        deep = s.housing * s.board / (2 if len(s.bays) > 1 else 1)
        if deep < 0.004:
            deep = 0.0
        else:
            # From the front edge, or the shelf could not come in where a back closes the other way.
            tongue, middle = Tenon(s.depth + 0.02, s.board, deep), vector(0, s.depth / 2, at[2] + s.board / 2)
            for mouth, upright in zip(mouths(start + middle, end + middle, Y), uprights, strict=True):
                upright -= tongue.pocket(mouth)
        far = vector(0, s.depth, at[2] + s.board)
        self.plank(a, name, "shelf", at + start + (c - deep) * X, far + end - (c - deep) * X)

    def stand(self, a: Assembly, foot: float, pinned: Blank | None) -> None:
        """Add round feet, under the bottom board (with pins, if it is `pinned`) or under the sides."""
        s = self
        r = 0.022 if s.bottom_under else max(0.008, 0.8 * s.board)
        inset = 0.04 if s.bottom_under else s.board / 2
        places = [move(x, y) for x in (inset, s.width - inset) for y in (0.04, s.depth - 0.04)]
        blank = Blank(turned([(0.0, 0.8 * r), (foot - CLEARANCE, r)], 14))
        a.each("foot", "foot", blank, {f"{k}": place for k, place in enumerate(places)})
        if pinned is not None:
            pin = RoundTenon(radius=0.3 * r, length=0.008, sides=10)
            blank += pin.tongue(joint_frame(foot * Z, -Z, X))
            for place in places:
                pinned -= pin.pocket(place * joint_frame(foot * Z, -Z, X)).translate((0.0, 0.0, -foot))

    def plank(self, a: Assembly, name: str, label: str, low: Vector, high: Vector, alike: bool = True) -> Blank:
        """Add a box; boxes of one size are interchangeable, except one that is not left `alike`."""
        sides = tuple(np.round(high - low, 6).tolist())
        blank = a.alike(sides, block((0.0, 0.0, 0.0), sides))
        return a.part(name, label, blank if alike else blank.solid, move(*low))
