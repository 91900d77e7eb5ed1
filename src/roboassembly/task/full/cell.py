"""The workcell: posts rise out of the floor in a ring and hold parts and groups from below; robots drive between them.

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
from jaxtyping import Float

from roboassembly.errors import InputError
from roboassembly.furniture.model import Furniture
from roboassembly.furniture.rays import Rays
from roboassembly.geometry.meshes import WOOD_DENSITY, Mesh
from roboassembly.geometry.poses import SE3, transform_points, turn_about_vertical
from roboassembly.geometry.scene import Body, Shape
from roboassembly.robots.gripper import MAX_OPENING, WIDER, HandAgainst
from roboassembly.task.rules.groups import Circle, Group, center_of_mass, hull_points

POST_RADIUS = 0.018
"""Radius of a post [m]."""
CUP_GAP = 1e-3
"""Distance between a cup and what it holds [m]: its lip is soft and not part of the exact geometry."""
LOWEST = 0.6
"""Height of the lowest point of a group on a post [m]; the platforms are 0.4 m high."""
LANE = 0.35
"""Distance between the circles of neighbours in the ring [m]."""
BETWEEN_POSTS = 0.9
"""Distance between posts at least [m], wide enough for a platform."""
SMALLEST_RING = 1.6
"""Radius of the ring at least [m]."""
LARGEST = 1.3
"""Extent of furniture along one axis that two arms can still turn and set down [m]."""
PAYLOAD = 3.0
"""Mass that a Panda can carry [kg]."""
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
_RESTS = 8
"""Number of rest poses in which a part is tried on its post."""


@dataclass(frozen=True, eq=False)
class Post:
    """A raised post."""

    top: Float[np.ndarray, "3"]
    """Position of the top of its cup in the world [m]."""

    def body(self, name: str) -> Body:
        """Return its shape, which reaches through the floor."""
        return Body(name, (Shape(post_mesh(), SE3.Identity(), convex=True),), SE3(np.eye(3), self.top))


@lru_cache(maxsize=256)
def post_mesh(length: float = _POST_LENGTH) -> Mesh:
    """Return the mesh of a post whose top is centred on the origin.

    Args:
        length: length of the post [m].
    """
    post = trimesh.creation.cylinder(POST_RADIUS, length, sections=16)
    post.apply_translation([0.0, 0.0, -0.5 * length])
    return Mesh.from_trimesh(post)


@dataclass(frozen=True, eq=False)
class Cell:
    """Size of the workcell for one piece of furniture."""

    radius: float
    """Radius of the ring of posts [m]."""
    density: float
    """Density at which a robot can carry the whole furniture [kg/m³]."""

    @property
    def floor(self) -> float:
        """Distance from the middle to the walls [m]."""
        return self.radius + 2.0


def check_size(furniture: Furniture) -> float:
    """Return the density at which a robot can carry the whole furniture [kg/m³].

    Raises:
        InputError: a part has no grasp, or the furniture is too large for the cell.
    """
    for part in furniture.parts:
        if not part.grasps:
            raise InputError(
                f"{furniture.name}: no hand can hold part '{part.name}'; the full setting needs two opposite sides "
                "less than 76 mm apart on every part"
            )
    corners = np.concatenate(
        [transform_points(a, p.mesh.hull_vertices) for p, a in zip(furniture.parts, furniture.assembled, strict=True)]
    )
    across = float(np.linalg.norm(np.ptp(corners, axis=0)))
    if across > LARGEST * np.sqrt(3.0):
        raise InputError(
            f"{furniture.name} is {across:.2f} m from corner to corner; the cell takes {LARGEST * np.sqrt(3.0):.2f} m"
        )
    volume = sum(p.mesh.volume for p in furniture.parts)
    return min(WOOD_DENSITY, PAYLOAD / volume)


def initial_layout(furniture: Furniture, rng: np.random.Generator) -> tuple[Cell, tuple[Group, ...], tuple[Post, ...]]:
    """Return cell, groups and posts with every part alone on a post of the ring, in a random order and pose.

    Raises:
        InputError: the furniture does not suit the cell, or a post finds no place beneath a part.
    """
    density = check_size(furniture)
    hung: list[tuple[Group, Post, float]] = []
    for index, part in enumerate(furniture.parts):
        rotations, likely = part.mesh.resting_rotations
        # Of several random poses, take the one that leaves most grasps open.
        best: tuple[float, Group, Post] | None = None
        for rest in rng.choice(len(rotations), size=min(_RESTS, len(rotations)), replace=False, p=likely):
            turn = turn_about_vertical(rng.uniform(-np.pi, np.pi))
            slot = furniture.assembled[index]
            group = Group((index,), (index,), (slot,), SE3(turn @ rotations[rest], np.zeros(3)) * slot.inverse())
            found = on_post(furniture, group, np.zeros(2))
            if found is None:
                continue
            share = open_grasps(furniture, *found)
            if best is None or share > best[0]:
                best = (share, *found)
        if best is None:
            raise InputError(f"{furniture.name}: no post can hold part '{part.name}' from below")
        hung.append((*best[1:], reach_from(furniture, *best[1:])))
    order: list[int] = rng.permutation(len(hung)).tolist()
    widths = np.array([hung[i][2] for i in order])
    chords = np.maximum(widths + np.roll(widths, -1) + LANE, BETWEEN_POSTS)
    radius = max(SMALLEST_RING, float(chords.sum()) / (2.0 * np.pi) * 1.05)
    # Each post stands one chord behind the one before it.
    angles = (np.cumsum(chords) - chords) / chords.sum() * 2.0 * np.pi + rng.uniform(0.0, 2.0 * np.pi)
    groups: list[Group] = [hung[0][0]] * len(hung)
    posts: list[Post] = [hung[0][1]] * len(hung)
    for i, angle in zip(order, angles, strict=True):
        shift = radius * np.array([np.cos(angle), np.sin(angle), 0.0])
        group, post, _ = hung[i]
        groups[i] = group.moved_to(SE3(np.eye(3), shift) * group.world_from_furniture)
        posts[i] = Post(post.top + shift)
    return Cell(radius, density), tuple(groups), tuple(posts)


def reach_from(furniture: Furniture, group: Group, post: Post) -> float:
    """Return the level distance from a post to the farthest point of its group [m]."""
    points = transform_points(group.world_from_furniture, hull_points(furniture, group))
    return float(np.linalg.norm(points[:, :2] - post.top[:2], axis=1).max())


def on_post(furniture: Furniture, group: Group, place: Float[np.ndarray, "2"]) -> tuple[Group, Post] | None:
    """Return a group moved onto a post at `place` without turning; None if no post can hold it near its centre of mass.

    The cup goes where it leaves most of the group's grasps open.
    """
    turn = group.world_from_furniture.rotation
    group = group.moved_to(SE3(turn, np.zeros(3)))
    center = turn @ center_of_mass(furniture, group)
    points = transform_points(group.world_from_furniture, hull_points(furniture, group))
    lowest = float(points[:, 2].min())
    span = (np.arange(_GRID) - _GRID // 2) * _GRID_STEP
    offsets = np.stack(np.meshgrid(span, span), axis=-1).reshape(-1, 2)
    offsets = offsets[np.argsort(np.linalg.norm(offsets, axis=1), kind="stable")]
    feet = center[:2] + offsets[:, None] + _disc(_COARSE)
    height = _undersides(furniture, group, feet.reshape(-1, 2), lowest - 0.1).reshape(feet.shape[:2])
    covered = np.flatnonzero(np.isfinite(height[:, 0]))
    if not len(covered):
        return None
    tops = np.concatenate([center[:2] + offsets[covered], height[covered].min(axis=1)[:, None] - CUP_GAP], axis=1)
    top = tops[_best_top(_Grippers(furniture, group), tops, _OFF_CENTER * np.linalg.norm(offsets[covered], axis=1))]
    # A round underside may bulge between few rays.
    top[2] = _undersides(furniture, group, top[:2] + _disc(_FINE), lowest - 0.1).min() - CUP_GAP
    shift = np.array([*(place - top[:2]), LOWEST - lowest])
    return group.moved_to(SE3(turn, shift)), Post(top + shift)


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
    return float(_Grippers(furniture, group).open_shares(post.top[None])[0])


def best_stands(furniture: Furniture, stands: Sequence[Group], upright: Sequence[bool]) -> Iterator[tuple[Group, Post]]:
    """Yield groups on posts above the origin: upright ones first, then those with most grasps open.

    A post is looked for once no other group can be better.

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
    while heap:
        _, i, placed = heappop(heap)
        if placed is not None:
            yield placed
        elif (placed := on_post(furniture, stands[i], np.zeros(2))) is not None:
            heappush(heap, (-(upright[i] + open_grasps(furniture, *placed)), i, placed))


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
        grasps = len(self._widths)
        post, grasp = np.divmod(np.arange(len(tops) * grasps), max(1, grasps))
        positions, closing, approach = self._frames
        from_post = positions[grasp] - tops[post]
        opening = np.minimum(MAX_OPENING, self._widths + WIDER)[grasp]
        free = ~_against_post().touches(from_post, closing[grasp], approach[grasp], opening, coming=True)
        post, grasp, from_post = post[free], grasp[free], from_post[free]
        # A post between the open fingers would stop them as they close.
        free = ~_against_post().touches(from_post, closing[grasp], approach[grasp], self._widths[grasp])
        return np.bincount(post[free], minlength=len(tops)) / self._count


@cache
def _against_post() -> HandAgainst:
    return HandAgainst(post_mesh())


@cache
def _rays(mesh: Mesh) -> Rays:
    return Rays(mesh)


def free_places(
    places: Sequence[Float[np.ndarray, "2"]], radius: float, occupied: Sequence[Circle]
) -> list[Float[np.ndarray, "2"]]:
    """Return the places where a circle keeps clear of all occupied ones."""
    return [
        place
        for place in places
        if all(np.linalg.norm(place - c.center) > radius + c.radius + 0.5 * LANE for c in occupied)
    ]
