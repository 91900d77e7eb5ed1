"""Poses from connection sites, as the IKEA Furniture Assembly Environment means them.

A site `leg-table,0,90,180,270,conn_site1` joins a `leg` to a site of a `table` named the other way round. Joined
sites share their origin and z axis; their y axes differ by one of the angles in the name (degrees about z; any angle
where none is named). Sites of one suffix (`conn_site1`) belong together; what has no such mate takes any that is left.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from roboassembly.errors import FurnitureError
from roboassembly.geometry.poses import SE3

CLOSES = 0.001
"""Metres: the sites of a pair are no farther apart in the assembled furniture."""
TILT = np.radians(5.0)
"""Radians: nor do their z axes point farther apart than this."""
MAX_STEPS = 2_000
"""Placements tried before the search gives up."""
_MAX_ANGLES = 12


@dataclass(frozen=True, eq=False)
class Site:
    """A connection site of one body."""

    body: str
    name: str
    body_from_site: SE3
    """Metres."""

    @property
    def label(self) -> tuple[str, ...]:
        """The words before the first comma: own part, other part."""
        return tuple(self.name.split(",")[0].split("-"))

    @property
    def suffix(self) -> str:
        """`conn_site1`."""
        return self.name.rsplit(",", 1)[-1]

    def angles(self) -> tuple[float, ...]:
        """Degrees that the mate may be turned about z; quarter turns where the name allows any.

        Raises:
            FurnitureError: something that is no finite number.
        """
        words = [word for word in self.name.split(",")[1:-1] if word.strip()][:_MAX_ANGLES]
        try:
            turns = tuple(float(word) for word in words)
        except ValueError:
            turns = (np.nan,)
        if not np.isfinite(turns).all():
            raise FurnitureError(f"site '{self.name}': its name gives angles that are no numbers")
        return turns or (0.0, 90.0, 180.0, 270.0)


@dataclass(frozen=True, eq=False)
class SitePair:
    """Two sites that meet in the assembled furniture."""

    first: Site
    second: Site
    gap: float
    """Metres between their origins."""


@dataclass(frozen=True, eq=False)
class Solved:
    """Poses of all bodies, and the sites that meet."""

    poses: Mapping[str, SE3]
    """`first body from body`."""
    pairs: tuple[SitePair, ...]
    unused: tuple[Site, ...]
    """Sites without a mate: other places where a part could also go."""


def solve(bodies: Sequence[str], sites: Sequence[Site]) -> Solved:
    """Place every body by a chain of site pairs so that all other pairs close.

    Raises:
        FurnitureError: bodies that no pair reaches, or a pair that stays open by more than `CLOSES` or `TILT`, with
            the figures.
    """
    search = _Search(bodies, *_mates(sites))
    poses = search.run()
    pairs = search.closed(poses)
    met = {id(site) for pair in pairs for site in (pair.first, pair.second)}
    return Solved(poses, pairs, tuple(site for site in sites if id(site) not in met))


def _mates(sites: Sequence[Site]) -> tuple[list[tuple[Site, Site]], list[tuple[Site, Site]]]:
    """Pairs that the suffixes fix, and pairs that are possible among the sites left over."""
    fixed: list[tuple[Site, Site]] = []
    left: list[Site] = []
    by_key: dict[tuple[tuple[str, ...], str], list[Site]] = {}
    for site in sites:
        by_key.setdefault((site.label, site.suffix), []).append(site)
    for site in sites:
        own = by_key[site.label, site.suffix]
        other = by_key.get((site.label[::-1], site.suffix), [])
        if len(own) == len(other) == 1 and own[0].body != other[0].body:
            if own[0].name != other[0].name and sites.index(own[0]) < sites.index(other[0]):
                fixed.append((own[0], other[0]))
        else:
            left.append(site)
    possible = [
        (a, b) for k, a in enumerate(left) for b in left[k + 1 :] if a.label == b.label[::-1] and a.body != b.body
    ]
    return fixed, possible


class _Search:
    """Depth first over the bodies; a placement stands only while every fixed pair among placed bodies closes."""

    def __init__(
        self, bodies: Sequence[str], fixed: list[tuple[Site, Site]], possible: list[tuple[Site, Site]]
    ) -> None:
        self.bodies = bodies
        self.fixed = fixed
        self.possible = possible
        self.steps = 0
        self.nearest: tuple[int, float, float, str] = (0, np.inf, 0.0, "")
        """Bodies placed, gap, tilt and names, at the failure that came farthest."""

    def run(self) -> dict[str, SE3]:
        poses = self._extend({self.bodies[0]: SE3.Identity()})
        if poses is not None:
            return poses
        _, gap, tilt, names = self.nearest
        if not names:
            raise FurnitureError("its connection sites do not join all parts; some part has none that fits another's")
        more = f" (gave up after {MAX_STEPS} placements)" if self.steps > MAX_STEPS else ""
        raise FurnitureError(
            f"connection sites {names} stay {gap * 1e3:.2f} mm and {np.degrees(tilt):.0f}° apart; "
            f"{CLOSES * 1e3:g} mm and {np.degrees(TILT):.0f}° would close{more}"
        )

    def _extend(self, poses: dict[str, SE3]) -> dict[str, SE3] | None:
        if len(poses) == len(self.bodies):
            return poses
        for here, there in self._frontier(poses):
            for angle in here.angles():
                self.steps += 1
                if self.steps > MAX_STEPS:
                    return None
                turn = np.radians(angle)
                c, s = np.cos(turn), np.sin(turn)
                turned = SE3(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), np.zeros(3))
                pose = poses[here.body] * here.body_from_site * turned * there.body_from_site.inverse()
                more = {**poses, there.body: pose}
                if self._closes(more, there.body):
                    done = self._extend(more)
                    if done is not None:
                        return done
        return None

    def _frontier(self, poses: dict[str, SE3]) -> list[tuple[Site, Site]]:
        """Ways to place one more body: the first fixed pair's, or else every possible one of the first free body."""
        for a, b in self.fixed:
            if (a.body in poses) != (b.body in poses):
                return [(a, b) if a.body in poses else (b, a)]
        ways = [
            (a, b) if a.body in poses else (b, a) for a, b in self.possible if (a.body in poses) != (b.body in poses)
        ]
        used = {id(site) for pair in self.closed(poses) for site in (pair.first, pair.second)}
        return [(a, b) for a, b in ways if b.body == ways[0][1].body and id(a) not in used]

    def _closes(self, poses: dict[str, SE3], body: str) -> bool:
        open_by: list[tuple[float, float, str]] = []
        for a, b in self.fixed:
            if body in (a.body, b.body) and a.body in poses and b.body in poses:
                gap, tilt = _gap(poses, a, b), _tilt(poses, a, b)
                if gap > CLOSES or tilt > TILT:
                    open_by.append((gap, tilt, f"'{a.name}' and '{b.name}'"))
        if not open_by:
            return True
        gap, tilt, names = max(open_by)
        if (len(poses), -gap) > (self.nearest[0], -self.nearest[1]):
            self.nearest = (len(poses), gap, tilt, names)
        return False

    def closed(self, poses: Mapping[str, SE3]) -> tuple[SitePair, ...]:
        """The pairs among placed bodies that close, each site in one of them."""
        out: list[SitePair] = []
        used: set[int] = set()
        for a, b in (*self.fixed, *self.possible):
            if a.body in poses and b.body in poses and not {id(a), id(b)} & used:
                gap = _gap(poses, a, b)
                if gap <= CLOSES and _tilt(poses, a, b) <= TILT:
                    out.append(SitePair(a, b, gap))
                    used |= {id(a), id(b)}
        return tuple(out)


def _gap(poses: Mapping[str, SE3], a: Site, b: Site) -> float:
    ends = [(poses[site.body] * site.body_from_site).translation for site in (a, b)]
    return float(np.linalg.norm(ends[0] - ends[1]))


def _tilt(poses: Mapping[str, SE3], a: Site, b: Site) -> float:
    """Radians between the sites' z axes."""
    axes = [(poses[site.body] * site.body_from_site).rotation[:, 2] for site in (a, b)]
    return float(np.arccos(np.clip(axes[0] @ axes[1], -1.0, 1.0)))


def upright(poses: Mapping[str, SE3], drawn: Mapping[str, SE3]) -> Float[np.ndarray, "3 3"]:
    """The rotation that gives most bodies the orientation that they are drawn with in the file."""
    votes = [drawn[body].rotation @ pose.rotation.T for body, pose in poses.items()]
    agree = [sum(float(np.trace(v.T @ w)) > 1.0 + 2.0 * np.cos(0.2) for w in votes) for v in votes]
    return votes[int(np.argmax(agree))]
