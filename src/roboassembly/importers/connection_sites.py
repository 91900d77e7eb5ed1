"""Assembled poses from connection sites of the IKEA Furniture Assembly Environment.

The site `leg-table,0,90,180,270,conn_site1` joins a `leg` to the site `table-leg,...` of a `table`. Joined sites share
their origin and z axis; they are turned about z by one of the angles in the name (degrees; any angle if none is named).
Sites with the same suffix (`conn_site1`) belong together; a site without such a mate may join any unmatched site.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from roboassembly.errors import FurnitureError
from roboassembly.geometry.poses import SE3

MAX_GAP = 0.001
"""Largest distance between the sites of a pair in the assembled furniture [m]."""
MAX_TILT = np.radians(5.0)
"""Largest angle between the z axes of the sites of a pair [rad]."""
MAX_STEPS = 2_000
"""Number of placements after which the search gives up."""
_MAX_ANGLES = 12


@dataclass(frozen=True, eq=False)
class ConnectionSite:
    """Connection site of one body."""

    body: str
    name: str
    body_from_site: SE3
    """Pose of the site in the body's frame [m]."""

    @property
    def label(self) -> tuple[str, ...]:
        """Kinds of part in the name, before the first comma: own part, other part."""
        return tuple(self.name.split(",")[0].split("-"))

    @property
    def suffix(self) -> str:
        """Last item of the name, such as `conn_site1`."""
        return self.name.rsplit(",", 1)[-1]

    def angles(self) -> tuple[float, ...]:
        """Return the angles by which the mate may be turned about z [deg]; quarter turns if the name allows any.

        Raises:
            FurnitureError: an angle is not a finite number.
        """
        texts = [text for text in self.name.split(",")[1:-1] if text.strip()][:_MAX_ANGLES]
        try:
            turns = tuple(float(text) for text in texts)
        except ValueError:
            turns = (np.nan,)
        if not np.isfinite(turns).all():
            raise FurnitureError(f"site '{self.name}': the angles in its name are not numbers")
        return turns or (0.0, 90.0, 180.0, 270.0)


@dataclass(frozen=True, eq=False)
class SitePair:
    """Two sites that meet in the assembled furniture."""

    first: ConnectionSite
    second: ConnectionSite
    gap: float
    """Distance between the origins of the two sites [m]."""


@dataclass(frozen=True, eq=False)
class SolvedPoses:
    """Poses of all bodies, and the pairs of sites that meet."""

    poses: Mapping[str, SE3]
    """Pose of each body in the frame of the first, by name [m]."""
    pairs: tuple[SitePair, ...]
    unused: tuple[ConnectionSite, ...]
    """Sites without a mate, where a part could also be attached."""


def solve(bodies: Sequence[str], sites: Sequence[ConnectionSite]) -> SolvedPoses:
    """Place every body through a chain of site pairs so that all other fixed pairs close.

    Raises:
        FurnitureError: no pair reaches some body, or a pair stays open by more than `MAX_GAP` or `MAX_TILT`; the
            message gives the figures.
    """
    search = _Search(bodies, *_mates(sites))
    poses = search.run()
    pairs = search.closed(poses)
    mated = {id(site) for pair in pairs for site in (pair.first, pair.second)}
    return SolvedPoses(poses, pairs, tuple(site for site in sites if id(site) not in mated))


def _mates(
    sites: Sequence[ConnectionSite],
) -> tuple[list[tuple[ConnectionSite, ConnectionSite]], list[tuple[ConnectionSite, ConnectionSite]]]:
    """Return the pairs that the suffixes fix, and the possible pairs among the unmatched sites."""
    fixed: list[tuple[ConnectionSite, ConnectionSite]] = []
    unmatched: list[ConnectionSite] = []
    by_key: dict[tuple[tuple[str, ...], str], list[ConnectionSite]] = {}
    for site in sites:
        by_key.setdefault((site.label, site.suffix), []).append(site)
    for site in sites:
        own = by_key[site.label, site.suffix]
        other = by_key.get((site.label[::-1], site.suffix), [])
        if len(own) == len(other) == 1 and own[0].body != other[0].body:
            if own[0].name != other[0].name and sites.index(own[0]) < sites.index(other[0]):
                fixed.append((own[0], other[0]))
        else:
            unmatched.append(site)
    possible = [
        (a, b)
        for k, a in enumerate(unmatched)
        for b in unmatched[k + 1 :]
        if a.label == b.label[::-1] and a.body != b.body
    ]
    return fixed, possible


class _Search:
    """Depth-first search over the bodies; every fixed pair among placed bodies must close."""

    def __init__(
        self,
        bodies: Sequence[str],
        fixed: list[tuple[ConnectionSite, ConnectionSite]],
        possible: list[tuple[ConnectionSite, ConnectionSite]],
    ) -> None:
        self.bodies = bodies
        self.fixed = fixed
        self.possible = possible
        self.steps = 0
        self.nearest: tuple[int, float, float, str] = (0, np.inf, 0.0, "")
        """Number of placed bodies, gap [m], tilt [rad] and site names at the failure with the most bodies placed."""

    def run(self) -> dict[str, SE3]:
        poses = self._extend({self.bodies[0]: SE3.Identity()})
        if poses is not None:
            return poses
        _, gap, tilt, names = self.nearest
        if not names:
            raise FurnitureError(
                "its connection sites do not join all parts; some part has no site that fits another part's"
            )
        more = f" (gave up after {MAX_STEPS} placements)" if self.steps > MAX_STEPS else ""
        raise FurnitureError(
            f"connection sites {names} stay {gap * 1e3:.2f} mm and {np.degrees(tilt):.0f}° apart; "
            f"{MAX_GAP * 1e3:g} mm and {np.degrees(MAX_TILT):.0f}° would close{more}"
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

    def _frontier(self, poses: dict[str, SE3]) -> list[tuple[ConnectionSite, ConnectionSite]]:
        """Return site pairs that place one more body: the first fixed pair, or all possible pairs of one free body."""
        for a, b in self.fixed:
            if (a.body in poses) != (b.body in poses):
                return [(a, b) if a.body in poses else (b, a)]
        candidates = [
            (a, b) if a.body in poses else (b, a) for a, b in self.possible if (a.body in poses) != (b.body in poses)
        ]
        used = {id(site) for pair in self.closed(poses) for site in (pair.first, pair.second)}
        return [(a, b) for a, b in candidates if b.body == candidates[0][1].body and id(a) not in used]

    def _closes(self, poses: dict[str, SE3], body: str) -> bool:
        open_by: list[tuple[float, float, str]] = []
        for a, b in self.fixed:
            if body in (a.body, b.body) and a.body in poses and b.body in poses:
                gap, tilt = _gap(poses, a, b), _tilt(poses, a, b)
                if gap > MAX_GAP or tilt > MAX_TILT:
                    open_by.append((gap, tilt, f"'{a.name}' and '{b.name}'"))
        if not open_by:
            return True
        gap, tilt, names = max(open_by)
        if (len(poses), -gap) > (self.nearest[0], -self.nearest[1]):
            self.nearest = (len(poses), gap, tilt, names)
        return False

    def closed(self, poses: Mapping[str, SE3]) -> tuple[SitePair, ...]:
        """Return the pairs among placed bodies that close; each site is in one pair at most."""
        out: list[SitePair] = []
        used: set[int] = set()
        for a, b in (*self.fixed, *self.possible):
            if a.body in poses and b.body in poses and not {id(a), id(b)} & used:
                gap = _gap(poses, a, b)
                if gap <= MAX_GAP and _tilt(poses, a, b) <= MAX_TILT:
                    out.append(SitePair(a, b, gap))
                    used |= {id(a), id(b)}
        return tuple(out)


def _gap(poses: Mapping[str, SE3], a: ConnectionSite, b: ConnectionSite) -> float:
    ends = [(poses[site.body] * site.body_from_site).translation for site in (a, b)]
    return float(np.linalg.norm(ends[0] - ends[1]))


def _tilt(poses: Mapping[str, SE3], a: ConnectionSite, b: ConnectionSite) -> float:
    """Return the angle between the z axes of two sites [rad]."""
    axes = [(poses[site.body] * site.body_from_site).rotation[:, 2] for site in (a, b)]
    return float(np.arccos(np.clip(axes[0] @ axes[1], -1.0, 1.0)))


def upright(poses: Mapping[str, SE3], drawn: Mapping[str, SE3]) -> Float[np.ndarray, "3 3"]:
    """Return the rotation that gives most bodies the orientation that they have in the file."""
    votes = [drawn[body].rotation @ pose.rotation.T for body, pose in poses.items()]
    agree = [sum(float(np.trace(v.T @ w)) > 1.0 + 2.0 * np.cos(0.2) for w in votes) for v in votes]
    return votes[int(np.argmax(agree))]
