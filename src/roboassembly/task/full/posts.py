"""Posts: where one or two of them can hold a group from below, and which grasps they leave open.

A post has a suction cup on its top. It holds its group higher than the robots' platforms, which drive beneath it, so
that only posts are in their way. An empty post sinks into the floor.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from heapq import heapify, heappop, heappush

import numpy as np
import trimesh
from jaxtyping import Bool, Float

from roboassembly.furniture.model import Furniture
from roboassembly.furniture.rays import Rays
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3, transform_points
from roboassembly.geometry.scene import Body, Shape
from roboassembly.robots.gripper import MAX_OPENING, WIDER, HandAgainst
from roboassembly.task.full.grips import ASTRAY
from roboassembly.task.rules.groups import Group, center_of_mass, hull_points

POST_RADIUS = 0.018
"""Radius of a post [m]."""
CUP_GAP = 1e-3
"""Distance between a cup and what it holds [m]: its lip is soft and not part of the exact geometry."""
LOWEST = 0.6
"""Height of the lowest point of a group on a post [m]; the platforms are 0.4 m high."""
_POST_LENGTH = 2.0
"""Length of a post [m]."""
_GRID, _GRID_STEP = 9, 0.03
"""Number of places along each axis around the centre of mass where a cup is tried, and their distance [m]."""
_COARSE, _FINE = POST_RADIUS, 1e-3
"""Distances between rays that find the height of a cup [m], for all places and for the chosen one."""
_OFF_CENTER = 1.0
"""Share of open grasps that a metre of distance from the centre of mass costs."""
_FROM_BELOW = 0.5
"""Vertical component of an approach above which the arm would have to be beneath the group."""
_HAND_MARGIN = 2.0 * ASTRAY
"""Distance between a post and a hand beside it at least [m]: a hand comes and goes with a clearance of `ASTRAY`."""
_LEAST_SPAN, _BALANCE = 0.1, 0.3
"""Distance between two posts of one group at least [m]; share of it by which their middle may be beside the centre of
mass at most."""


@dataclass(frozen=True, eq=False)
class Post:
    """A raised post."""

    top: Float[np.ndarray, "3"]
    """Position of the top of its cup in the world [m]."""
    second: Post | None = None
    """Another post that rises and sinks with it and holds the same group; None if one does."""

    @property
    def each(self) -> tuple[Post, ...]:
        """This post and the second one, if there is one."""
        return (self,) if self.second is None else (self, self.second)

    @property
    def middle(self) -> Float[np.ndarray, "2"]:
        """Level position, of two posts that of the middle between them [m]."""
        return np.mean([post.top[:2] for post in self.each], axis=0)

    def moved(self, by: Float[np.ndarray, "3"]) -> Post:
        """Return the same elsewhere."""
        return Post(self.top + by, None if self.second is None else self.second.moved(by))

    def body(self, name: str) -> Body:
        """Return its shape, and that of the second one, which reach through the floor."""
        shapes = (Shape(post_mesh(), SE3(np.eye(3), post.top - self.top), convex=True) for post in self.each)
        return Body(name, tuple(shapes), SE3(np.eye(3), self.top))


@lru_cache(maxsize=256)
def post_mesh(length: float = _POST_LENGTH, margin: float = 0.0) -> Mesh:
    """Return the mesh of a post whose top is centred on the origin.

    Args:
        length: length of the post [m].
        margin: distance added to the radius of a post [m].
    """
    post = trimesh.creation.cylinder(POST_RADIUS + margin, length, sections=16)
    post.apply_translation([0.0, 0.0, -0.5 * length])
    return Mesh.from_trimesh(post)


def most_open(furniture: Furniture, stands: Sequence[Group]) -> tuple[Group, Post] | None:
    """Return the group that leaves most grasps open on one post, or else on two; None if nothing holds any of them."""
    for holder in (on_post, on_two_posts):
        placed = [found for group in stands if (found := holder(furniture, group, np.zeros(2))) is not None]
        if placed:
            return max(placed, key=lambda found: open_grasps(furniture, *found))
    return None


def reach_from(furniture: Furniture, group: Group, post: Post) -> float:
    """Return the level distance from a post to the farthest point of its group [m]."""
    points = transform_points(group.world_from_furniture, hull_points(furniture, group))
    return float(np.linalg.norm(points[:, :2] - post.middle, axis=1).max())


def on_post(furniture: Furniture, group: Group, place: Float[np.ndarray, "2"]) -> tuple[Group, Post] | None:
    """Return a group moved onto a post at `place` without turning; None if no post can hold it near its centre of mass.

    The cup goes where it leaves most of the group's grasps open.
    """
    centred, center, points = _at_origin(furniture, group)
    lowest = float(points[:, 2].min())
    span = (np.arange(_GRID) - _GRID // 2) * _GRID_STEP
    offsets = np.stack(np.meshgrid(span, span), axis=-1).reshape(-1, 2)
    offsets = offsets[np.argsort(np.linalg.norm(offsets, axis=1), kind="stable")]
    feet = center[:2] + offsets[:, None] + _disc(_COARSE)
    height = _undersides(furniture, centred, feet.reshape(-1, 2), lowest - 0.1).reshape(feet.shape[:2])
    covered = np.flatnonzero(np.isfinite(height[:, 0]))
    if not len(covered):
        return None
    tops = np.concatenate([center[:2] + offsets[covered], height[covered].min(axis=1)[:, None] - CUP_GAP], axis=1)
    top = tops[_best_top(_Grippers(furniture, centred), tops, _OFF_CENTER * np.linalg.norm(offsets[covered], axis=1))]
    post = Post(_against_underside(furniture, centred, top, lowest - 0.1))
    return _raised(group, post, np.array([*(place - top[:2]), LOWEST - lowest]))


def on_two_posts(furniture: Furniture, group: Group, place: Float[np.ndarray, "2"]) -> tuple[Group, Post] | None:
    """Return a group moved onto two posts about `place` without turning; None if no two can hold it.

    They hold what one cannot, such as a frame: the line between them passes below the centre of mass. They go where
    they leave most of the group's grasps open.
    """
    centred, center, points = _at_origin(furniture, group)
    lowest, (low, high) = float(points[:, 2].min()), (f(points[:, :2], axis=0) for f in (np.min, np.max))
    spans = [np.arange(a + POST_RADIUS, b, _GRID_STEP) for a, b in zip(low, high, strict=True)]
    spots = np.stack(np.meshgrid(*spans), axis=-1).reshape(-1, 2)
    height = _undersides(furniture, centred, (spots[:, None] + _disc(_COARSE)).reshape(-1, 2), lowest - 0.1)
    height = height.reshape(len(spots), -1)
    tops = np.concatenate([spots, height.min(axis=1)[:, None] - CUP_GAP], axis=1)[np.isfinite(height[:, 0])]
    i, j = np.triu_indices(len(tops), 1)
    between = tops[j, :2] - tops[i, :2]
    length = np.linalg.norm(between, axis=1)
    off = center[:2] - tops[i, :2]
    share = np.einsum("nk,nk->n", off, between) / length**2
    aside = np.abs(off[:, 0] * between[:, 1] - off[:, 1] * between[:, 0]) / length
    fits = np.flatnonzero((length > _LEAST_SPAN) & (np.abs(share - 0.5) < _BALANCE) & (aside < POST_RADIUS))
    if not len(fits):
        return None
    free = _Grippers(furniture, centred).open_at(tops)
    # Level differences between the shares count as much as at one post.
    uneven = np.abs(share[fits] - 0.5) * length[fits] + aside[fits]
    best = fits[np.argmax((free[i[fits]] & free[j[fits]]).mean(axis=1).round(6) - _OFF_CENTER * uneven)]
    first, second = (_against_underside(furniture, centred, tops[k[best]], lowest - 0.1) for k in (i, j))
    post = Post(first, Post(second))
    return _raised(group, post, np.array([*(place - post.middle), LOWEST - lowest]))


def _at_origin(furniture: Furniture, group: Group) -> tuple[Group, Float[np.ndarray, "3"], Float[np.ndarray, "n 3"]]:
    """Return a group moved to the origin without turning, its centre of mass, and the corners of its hull [m]."""
    turn = group.world_from_furniture.rotation
    centred = group.moved_to(SE3(turn, np.zeros(3)))
    points = transform_points(centred.world_from_furniture, hull_points(furniture, centred))
    return centred, turn @ center_of_mass(furniture, centred), points


def _raised(group: Group, post: Post, by: Float[np.ndarray, "3"]) -> tuple[Group, Post]:
    """Return a group at a place, turned as it is, and the post below the origin moved there [m]."""
    return group.moved_to(SE3(group.world_from_furniture.rotation, by)), post.moved(by)


def _against_underside(
    furniture: Furniture, group: Group, top: Float[np.ndarray, "3"], start: float
) -> Float[np.ndarray, "3"]:
    """Return the top of a cup with its height found exactly: a round underside may bulge between few rays."""
    height = _undersides(furniture, group, top[:2] + _disc(_FINE), start).min()
    return np.array([*top[:2], height - CUP_GAP])


def _best_top(grippers: _Grippers, tops: Float[np.ndarray, "n 3"], costs: Float[np.ndarray, "n"]) -> int:
    """Return the first of the tops with the largest share of open grasps less its cost; costs ascend."""
    best, best_score = 0, -np.inf
    begin = 0
    for size in (1, 4, 16, len(tops)):
        # The rest cannot be better.
        if begin >= len(tops) or round(grippers.largest_share, 6) - costs[begin] <= best_score:
            break
        some = slice(begin, begin + size)
        scores = np.round(grippers.open_shares(tops[some]), 6) - costs[some]
        here = int(np.argmax(scores))
        if scores[here] > best_score:
            best, best_score = begin + here, float(scores[here])
        begin += size
    return best


@cache
def _disc(step: float) -> Float[np.ndarray, "n 2"]:
    """Return places on a cup, `step` metres apart, the middle first and the rim among them."""
    out = [np.zeros((1, 2))]
    for radius in np.linspace(0.0, POST_RADIUS, round(POST_RADIUS / step) + 1)[1:]:
        angles = np.linspace(0.0, 2.0 * np.pi, max(8, round(2.0 * np.pi * radius / step)), endpoint=False)
        out.append(radius * np.stack([np.cos(angles), np.sin(angles)], axis=1))
    return np.concatenate(out)


def _undersides(
    furniture: Furniture, group: Group, feet: Float[np.ndarray, "n 2"], start: float
) -> Float[np.ndarray, "n"]:
    """Return the height of the group's underside above each place [m]; infinite if there is none above `start`."""
    height = np.full(len(feet), np.inf)
    below = np.concatenate([feet, np.full((len(feet), 1), start)], axis=1)
    for part, pose in zip(group.parts, group.part_poses(), strict=True):
        back = pose.inverse()
        up = np.tile(back.rotation @ [0.0, 0.0, 1.0], (len(feet), 1))
        reach, _ = _rays(furniture.parts[part].mesh).first_hits(transform_points(back, below), up)
        height = np.minimum(height, start + reach)
    return height


def open_grasps(furniture: Furniture, group: Group, post: Post) -> float:
    """Return the share of a group's grasps to which a hand can come past its post, and not from below."""
    free = _Grippers(furniture, group).open_at(np.array([p.top for p in post.each]))
    return float(free.all(axis=0).mean())


def best_stands(furniture: Furniture, stands: Sequence[Group], upright: Sequence[bool]) -> Iterator[tuple[Group, Post]]:
    """Yield groups on posts above the origin: upright ones first, then those with most grasps open.

    A post is looked for once no other group can be better. Two posts are looked for if one can hold none of the groups.

    Args:
        furniture: furniture of the groups.
        stands: groups turned as they may stand.
        upright: whether each stands upright.
    """
    heap: list[tuple[float, int, tuple[Group, Post] | None]] = [
        (-(up + _Grippers(furniture, group).largest_share), i, None)
        for i, (group, up) in enumerate(zip(stands, upright, strict=True))
    ]
    heapify(heap)
    found = False
    for holder in (on_post, on_two_posts):
        left = list(heap)
        while left and not (found and holder is on_two_posts):
            _, i, placed = heappop(left)
            if placed is not None:
                found = True
                yield placed
            elif (placed := holder(furniture, stands[i], np.zeros(2))) is not None:
                heappush(left, (-(upright[i] + open_grasps(furniture, *placed)), i, placed))


class _Grippers:
    """Grippers at all grasps of a group, to be tested against posts beneath it."""

    def __init__(self, furniture: Furniture, group: Group) -> None:
        positions: list[Float[np.ndarray, "3"]] = []
        closing: list[Float[np.ndarray, "3"]] = []
        approach: list[Float[np.ndarray, "3"]] = []
        widths: list[float] = []
        count = 0
        for part, pose in zip(group.parts, group.part_poses(), strict=True):
            for region in furniture.parts[part].grasps:
                for direction in region.approaches:
                    count += 1
                    to_grasp = pose.rotation @ direction
                    # Many approaches are at exactly this angle: rounding decides the same for all poses.
                    if round(float(to_grasp[2]), 9) > _FROM_BELOW:
                        continue
                    positions.append(pose.act(region.position))
                    closing.append(pose.rotation @ region.closing)
                    approach.append(to_grasp)
                    widths.append(region.width)
        self._frames = tuple(np.array(x).reshape(-1, 3) for x in (positions, closing, approach))
        self._widths, self._count = np.array(widths), count
        self.largest_share = len(widths) / count
        """Share of grasps from which a hand does not come from below."""

    def open_shares(self, tops: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        """Return, for each post, the share of grasps whose hand neither touches it nor comes from below."""
        return self.open_at(tops).mean(axis=1)

    def open_at(self, tops: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, "n g"]:
        """Return, for each post and each grasp, whether the hand neither touches the post nor comes from below."""
        grasps = len(self._widths)
        post, grasp = np.divmod(np.arange(len(tops) * grasps), max(1, grasps))
        positions, closing, approach = self._frames
        from_post = positions[grasp] - tops[post]
        opening = np.minimum(MAX_OPENING, self._widths + WIDER)[grasp]
        free = ~_against_post().touches(from_post, closing[grasp], approach[grasp], opening, coming=True)
        post, grasp, from_post = post[free], grasp[free], from_post[free]
        # A post between the open fingers would stop them as they close.
        free = ~_against_post().touches(from_post, closing[grasp], approach[grasp], self._widths[grasp])
        out = np.zeros((len(tops), self._count), bool)
        out[post[free], grasp[free]] = True
        return out


@cache
def _against_post() -> HandAgainst:
    return HandAgainst(post_mesh(margin=_HAND_MARGIN))


@lru_cache(maxsize=256)
def _rays(mesh: Mesh) -> Rays:
    return Rays(mesh)
