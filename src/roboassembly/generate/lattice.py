"""Frames to practise on: posts on a grid, rails between them, spindles or panels between rails, boards on top.

Not furniture that anybody would buy, but every joint and every kind of being in each other's way that furniture has,
in combinations that no other family shows.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from roboassembly.generate.design import Assembly, Blank, Design, chance, count, drawn, family, one_of, size
from roboassembly.generate.joints import CLEARANCE, RoundTenon, Tenon, joint_frame, mouths, rail, spindle
from roboassembly.generate.outlines import rectangle
from roboassembly.generate.solids import Solid, block, placed, sweep, turned
from roboassembly.generate.vectors import Vector, X, Y, Z, move, turn, vector
from roboassembly.geometry.poses import SE3

LEVEL = 0.085  # distance between the heights at which rails may stand, so that those from two sides do not meet [m]
ROUND = RoundTenon(radius=0.0075, length=0.012, sides=10)
PEG = RoundTenon(radius=0.006, length=0.010, sides=10)
BUTT = RoundTenon(radius=0.0075, length=-CLEARANCE, sides=10)  # end of a bar that stops a clearance before the face
NO_TENON = Tenon(0.004, 0.004, -0.002, root=0.006)  # tongue that does not come out of its rail

Post = tuple[int, int]
"""Column and row of a post."""


class RailRow(NamedTuple):
    """Rails at one or two levels along an axis, from the post of column `i` and row `j` to the next one."""

    i: int
    j: int
    axis: str
    low: int
    high: int
    fill: str  # what is between the rails: none, spindles or panel

    @property
    def ends(self) -> tuple[Post, Post]:
        """The two posts."""
        return (self.i, self.j), (self.i + (self.axis == "x"), self.j + (self.axis == "y"))


DEFAULT_ROWS = (
    RailRow(0, 0, "x", 2, 4, "spindles"), RailRow(0, 1, "x", 2, 4, "none"),
    RailRow(0, 0, "y", 1, 1, "none"), RailRow(1, 0, "y", 1, 1, "none"),
)  # fmt: skip


def draw_rows(rng: np.random.Generator, s: Any) -> tuple[RailRow, ...]:
    """Draw rails between neighbouring posts."""
    rows: list[RailRow] = []
    for axis in "xy":
        # Even levels along x, odd ones along y.
        levels = [k for k in range(int((s.height - 0.12) / LEVEL)) if k % 2 == (axis == "y")]
        for i in range(s.posts[0] - (axis == "x")):
            for j in range(s.posts[1] - (axis == "y")):
                if rng.random() < 0.85 and levels:
                    low, high = sorted(map(int, rng.choice(levels, 2)))
                    rows.append(RailRow(i, j, axis, low, high, str(rng.choice(["none", "none", "spindles", "panel"]))))
    if rows and rng.random() < 0.6:
        # Opposite sides are often alike.
        rows = [RailRow(*row[:3], *next(other[3:] for other in rows if other.axis == row.axis)) for row in rows]
    return tuple(rows)


def height_of(level: int) -> float:
    """Return the height of a level."""
    return 0.08 + level * LEVEL


@family("lattice", "posts, rails, spindles, panels and boards at random", "abstract")
class Lattice(Design):
    """A frame of 4 to 18 parts."""

    posts: Post = one_of((2, 1), (2, 1), (2, 2), (2, 2), (3, 1), (3, 2), default=(2, 2))  # along x and y
    height: float = size(0.55, 0.3, 0.95)
    rows: tuple[RailRow, ...] = drawn(DEFAULT_ROWS, draw_rows)
    width: float = size(0.40, 0.18, 0.55)  # between neighbouring posts' axes along x
    depth: float = size(0.34, 0.18, 0.5)
    post: float = size(0.036, 0.032, 0.05)  # side of a square post, or diameter of a round one
    round_posts: bool = chance(False, 0.3)
    round_rails: bool = chance(False, 0.3)
    rail: float = size(0.036, 0.03, 0.06)  # height of a square rail
    fill: int = count(3, 1, 4)  # spindles between two rails
    top: bool = chance(True, 0.6)
    base: bool = chance(False, 0.25)
    slats: int = one_of(0, 0, 1, 2, 3, 4)  # laid across the lowest rails along x, if there are two rows of posts
    pegs: int = one_of(0, 0, 0, 1, 2, 3)
    board: float = size(0.022, 0.015, 0.035)  # thickness of boards
    butted: bool = chance(False, 0.4)  # no tenons: rails, spindles and posts end at the face that they meet
    tilt: tuple[float, float] = drawn(
        (0.0, 0.0),
        lambda rng, _: (rng.uniform(-0.4, 0.4), rng.uniform(-0.4, 0.4)) if rng.random() < 0.35 else (0.0, 0.0),
    )  # about x and y, of the whole

    def fits(self) -> bool:
        joined = {(0, 0)}
        for _ in self.rows:
            for row in self.rows:
                if joined & set(row.ends):
                    joined |= set(row.ends)
        connected = self.top or self.base or len(joined) == self.posts[0] * self.posts[1]
        return connected and abs(self.width - self.depth) > 0.02 and 4 <= len(self.parts()) <= 18

    def at(self, post: Post) -> Vector:
        """Return the foot of a post's axis."""
        return vector(post[0] * self.width, post[1] * self.depth, 0.0)

    def build(self, a: Assembly) -> None:
        posts = {(i, j): Blank() for i in range(self.posts[0]) for j in range(self.posts[1])}
        for row in self.rows:
            self.rails(a, row, posts)
        if self.slats and self.posts[1] == 2:
            self.lay_slats(a)
        for k, post in enumerate(sorted(posts)[: self.pegs]):
            self.peg(a, k, post, posts[post])
        self.posts_and_boards(a, posts)
        a.lean(turn(X, self.tilt[0]) @ turn(Y, self.tilt[1]))

    def rails(self, a: Assembly, row: RailRow, posts: dict[Post, Blank]) -> None:
        """Add rails between two posts, and what is between the rails."""
        s, run = self, X if row.axis == "x" else Y
        # Tenons start inside a round post's rim; what is butted stops at its foremost line.
        half = 0.46 * s.post if s.round_posts and not s.butted else s.post / 2
        here, there = (s.at(post) for post in row.ends)
        length, name = float((there - here) @ run) - 2 * half, f"{row.axis}{row.i}{row.j}"
        levels = sorted({row.low, row.high})
        filled = len(levels) == 2 and row.fill != "none" and not s.round_rails
        tenon = Tenon(0.6 * s.rail, 0.010, 0.28 * s.post)
        for index, level in enumerate(levels):
            start, end = here + half * run + height_of(level) * Z, there - half * run + height_of(level) * Z
            if not s.butted:
                for post, frame in zip(row.ends, mouths(start, end, Z), strict=True):
                    pocket = (ROUND if s.round_rails else tenon).pocket(frame, over=0.01)
                    posts[post] -= placed(pocket, move(*s.at(post)).inverse())
            if s.round_rails:
                solid = spindle(0 * X, length * run, Z, 0.0105, BUTT if s.butted else ROUND, straight=0.02)
            else:
                solid = rail(0 * X, length * run, Z, s.rail, 0.020, NO_TENON if s.butted else tenon)
                if s.round_posts and not s.butted:
                    solid = self.shortened(solid, run, length, 0.5 * s.post - half + CLEARANCE)
                if filled and not s.butted:
                    out, filling = Z if index == 0 else -Z, self.filling(row.fill, length)
                    mouths_out = [(joint_frame(x * run + s.rail / 2 * out, out, run), joint) for x, joint in filling]
                    holes = [joint.pocket(mouth) for mouth, joint in mouths_out]
                    solid -= holes[0] if row.fill == "panel" else sum(holes, Solid())
            blank = a.alike((row.axis, s.round_rails, filled and (row.fill, index)), solid)
            a.part(f"rail_{name}_{level}", "bar_stretcher", blank, move(*start))
        if filled:
            bottom = here + half * run + (height_of(row.low) + s.rail / 2) * Z
            self.fill_between(a, run, length, bottom, height_of(row.high) - height_of(row.low) - s.rail, row)

    def shortened(self, solid: Solid, run: Vector, length: float, by: float) -> Solid:
        """Return a rail whose shoulders end `by` metres before its tenons begin, off the rim of a round post."""
        across = np.abs(np.cross(run, Z))
        for start in (0.0, length - by):
            ends = np.array([start * run, (start + by) * run])
            wide = np.array([[-1.0], [1.0]]) * (0.1 * across + 0.1 * Z)
            tenon = np.array([[-1.0], [1.0]]) * (0.005 * across + 0.009 * Z)
            solid -= block(*(ends + wide)) - block(*(ends + tenon))
        return solid

    def filling(self, fill: str, length: float) -> list[tuple[float, Tenon | RoundTenon]]:
        """Return the places of spindles or a panel between the ends of two rails, and the joints at their ends."""
        if fill == "panel":
            return [(0.5 * length, Tenon(0.7 * length, 0.007, 0.008))]
        return [(length * (k + 1) / (self.fill + 1), PEG) for k in range(self.fill)]

    def fill_between(self, a: Assembly, run: Vector, length: float, bottom: Vector, rise: float, row: RailRow) -> None:
        """Add spindles or a panel between two rails that are `rise` apart."""
        key, filling = (row.fill, tuple(run), round(rise, 6)), self.filling(row.fill, length)
        name, places = f"{row.axis}{row.i}{row.j}", [move(*(bottom + middle * run)) for middle, _ in filling]
        if row.fill == "panel":
            ends = [CLEARANCE * Z, (rise - CLEARANCE) * Z]
            solid = sweep(ends, run, np.cross(Z, run), rectangle(0.7 * length, 0.012))
            for frame in mouths(0 * Z, rise * Z, run) if not self.butted else ():
                solid += filling[0][1].tongue(frame)
            a.part(f"panel_{name}", "back_single_surface", a.alike(key, solid), places[0])
        else:
            blank = a.alike(key, spindle(0 * Z, rise * Z, run, 0.008, BUTT if self.butted else PEG))
            named = {f"{name}_{k}": place for k, place in enumerate(places)}
            a.each("spindle", "back_surface_vertical_bar", blank, named)

    def lay_slats(self, a: Assembly) -> None:
        """Add boards across two rails along x that stand at the same height at front and back."""
        s, own = self, [row for row in self.rows if row.axis == "x" and row.i == 0]
        low = {row.j: row.low for row in own}
        above = any(row.fill != "none" and row.high > row.low for row in own)
        if s.round_rails or above or 0 not in low or low[0] != low.get(1):
            return
        each = (s.width - s.post - 0.01) / s.slats
        slat = a.alike("slat", block((-0.4 * each, -0.011, 0.0), (0.4 * each, s.depth + 0.011, 0.012)))
        z = height_of(low[0]) + s.rail / 2 + CLEARANCE
        for k in range(s.slats):
            a.part(f"slat_{k}", "seat_frame_bar", slat, move(s.post / 2 + 0.005 + (k + 0.5) * each, z=z))

    def peg(self, a: Assembly, k: int, post: Post, blank: Blank) -> None:
        """Add a knob on the outer face of a post."""
        half = self.post / 2 if not self.round_posts else 0.46 * self.post
        side = -1 if post[0] == 0 else 1
        z = min(height_of(2 * (k + 1)) + 0.5 * LEVEL, self.height - 0.06)
        at, frame = self.at(post) + side * half * X + z * Z, joint_frame(0 * X, side * X, Z)
        blank -= placed(PEG.pocket(joint_frame(at, side * X, Z), over=0.01), move(*self.at(post)).inverse())
        knob = PEG.tongue(frame) + placed(turned([(0.0025, 0.006), (0.02, 0.012), (0.03, 0.010)]), frame)
        a.part(f"peg_{k}", "arm_knob", a.alike(("peg", side), knob), move(*at))

    def posts_and_boards(self, a: Assembly, posts: dict[Post, Blank]) -> None:
        """Add posts, and boards on top of and below them."""
        s, tenon = self, RoundTenon(radius=0.3 * self.post, length=0.6 * self.board)
        low, high = (s.board + CLEARANCE if s.base else 0.0), (s.height - CLEARANCE if s.top else s.height)
        margin = 0.6 * s.post + 0.01
        near, far = -margin * (X + Y), self.at((s.posts[0] - 1, s.posts[1] - 1)) + margin * (X + Y)
        boards: list[tuple[str, SE3, Blank]] = []
        if s.top:
            solid = block(near + s.height * Z, far + (s.height + s.board) * Z)
            boards.append(("top", joint_frame(s.height * Z, -Z, X), Blank(solid)))
        if s.base:
            boards.append(("base", joint_frame(s.board * Z, Z, X), Blank(block(near, far + s.board * Z))))
        square = rectangle(s.post, s.post, 0.003)
        for post, blank in posts.items():
            place = move(*s.at(post))
            ends = [(low, s.post / 2), (high, s.post / 2)]
            blank.body = turned(ends, 16) if s.round_posts else sweep([low * Z, high * Z], X, Y, square)
            for _, mouth, board in boards if not s.butted else []:
                a.join(tenon, mouth, blank, board, at=[place])
            a.part(f"post_{post[0]}{post[1]}", "leg", blank, place)
        for name, _, board in boards:
            a.part(name, "seat_single_surface", board)
