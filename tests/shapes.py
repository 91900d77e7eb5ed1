"""Hand-made shapes with known numbers, and an independent collision checker (python-fcl)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import fcl
import manifold3d
import numpy as np
from scipy.spatial.transform import Rotation

from roboassembly.furniture.annotate import annotate
from roboassembly.furniture.model import Furniture, Provenance, RawFastener, RawPart
from roboassembly.generate import generate
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3, align_axis, interpolate, transform_points
from roboassembly.geometry.scene import Body, Scene, Shape
from roboassembly.repair.drilling import drill
from roboassembly.robots.body import placed, world_from_tips

HERE = SE3.Identity()
GAP = 0.0005
"""Metres between the parts of hand-made furniture."""
_BOX_FACES = np.array(
    [[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4], [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6],
     [1, 3, 5], [3, 7, 5]]
)  # fmt: skip


@lru_cache(maxsize=60)
def generated(family: str, seed: int) -> tuple[RawPart, ...]:
    """Raw parts of built-in furniture; those of the last pieces are kept."""
    return generate(family, seed)


def turn(axis: Sequence[float], angle: float) -> np.ndarray:
    axis = np.asarray(axis, dtype=float)
    return Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()


def pose(x: float = 0.0, y: float = 0.0, z: float = 0.0, rotation: np.ndarray | None = None) -> SE3:
    return SE3(np.eye(3) if rotation is None else rotation, np.array([x, y, z], dtype=float))


def random_pose(rng: np.random.Generator, spread: float) -> SE3:
    return SE3(Rotation.random(random_state=rng).as_matrix(), rng.uniform(-spread, spread, size=3))


def box(low: Sequence[float], high: Sequence[float]) -> Mesh:
    """An axis-aligned box of twelve triangles."""
    corners = [[(low, high)[i][0], (low, high)[j][1], (low, high)[k][2]]
               for k in (0, 1) for j in (0, 1) for i in (0, 1)]  # fmt: skip
    return Mesh(np.array(corners), _BOX_FACES)


def brick(a: float, b: float, c: float) -> Mesh:
    """A box about the origin with these edges."""
    return box((-a / 2, -b / 2, -c / 2), (a / 2, b / 2, c / 2))


def of_solid(solid: manifold3d.Manifold) -> Mesh:
    mesh = solid.to_mesh64()
    return Mesh(np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, dtype=np.int64))


def block(low: Sequence[float], high: Sequence[float]) -> manifold3d.Manifold:
    return manifold3d.Manifold.cube(tuple(np.subtract(high, low))).translate(tuple(low))


def prism(sides: int, radius: float, height: float, top: float | None = None) -> Mesh:
    """A regular prism about z, or a pyramid's stump where the upper radius differs; centre of mass at the origin."""
    solid = manifold3d.Manifold.cylinder(height, radius, radius if top is None else top, sides, center=True)
    mesh = of_solid(solid)
    return mesh.transformed(pose(*-mesh.center_of_mass))


def mirrored(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices * [-1.0, 1.0, 1.0], mesh.faces[:, ::-1])


def centered(mesh: Mesh) -> Mesh:
    return mesh.transformed(pose(*-mesh.center_of_mass))


def l_shape(scale: float = 0.1) -> Mesh:
    """A solid without any symmetry: three boxes of different lengths along three axes."""
    solid = block((0, 0, 0), (1, 0.2, 0.3)) + block((0, 0, 0), (0.2, 0.7, 0.3)) + block((0, 0, 0), (0.2, 0.2, 0.5))
    return centered(of_solid(solid.scale((scale, scale, scale))))


def furniture(name: str, parts: dict[str, Mesh]) -> Furniture:
    return annotate(name, [RawPart(n, m) for n, m in parts.items()], Provenance("hand-made"))


LEGS = ((-0.25, -0.15), (0.25, -0.15), (0.25, 0.15), (-0.25, 0.15))


def table() -> Furniture:
    """A top on four equal square legs: part 0 is the top, 1 to 4 are the legs. Legs are 0.4 m, stand on z = 0."""
    parts = {"top": box((-0.3, -0.2, 0.4 + GAP), (0.3, 0.2, 0.43 + GAP))}
    for i, (x, y) in enumerate(LEGS):
        parts[f"leg{i}"] = box((x - 0.02, y - 0.02, 0.0), (x + 0.02, y + 0.02, 0.4))
    return furniture("table", parts)


def stand() -> Furniture:
    """A big plate above, a small one below, and two tapered legs between: 0 upper, 1 lower, 2 and 3 legs."""
    leg = manifold3d.Manifold.cylinder(0.3, 0.012, 0.02, 4)
    parts = {
        "upper": box((-0.2, -0.1, 0.32 + 2 * GAP), (0.2, 0.1, 0.34 + 2 * GAP)),
        "lower": box((-0.15, -0.08, 0.0), (0.15, 0.08, 0.02)),
    }
    for i, x in enumerate((-0.1, 0.1)):
        parts[f"leg{i}"] = of_solid(leg.translate((x, 0.0, 0.02 + GAP)))
    return furniture("stand", parts)


def armchair() -> Furniture:
    """A seat with two mirror-image armrests: 0 seat, 1 right, 2 left. Each armrest is an L with its long end ahead."""
    arm = of_solid(block((0.0, -0.2, 0.0), (0.03, -0.16, 0.2)) + block((-0.02, -0.2, 0.16), (0.06, 0.15, 0.2)))
    right = arm.transformed(pose(0.17, 0.0, 0.03 + GAP))
    left = mirrored(right)
    return furniture("armchair", {"seat": box((-0.22, -0.25, 0.0), (0.22, 0.25, 0.03)), "right": right, "left": left})


def captive_slat() -> Furniture:
    """A true dead end: a slat with tenons in both posts, which stand in a board. 0 board, 1 and 2 posts, 3 slat.

    The posts' tenons go down into the board. With both posts in the board, the slat cannot come in any more.
    """
    c = GAP
    peg = (0.012, 0.012, 0.02)
    board = block((-0.25, -0.06, 0.0), (0.25, 0.06, 0.04))
    posts = {}
    for name, x in (("left", -0.18), ("right", 0.18)):
        inner = -np.sign(x)
        post = block((x - 0.02, -0.02, 0.04 + c), (x + 0.02, 0.02, 0.3))
        post += block((x - peg[0], -peg[1], 0.04 - peg[2]), (x + peg[0], peg[1], 0.05))
        mouth = x + inner * 0.02
        pocket = sorted((mouth - inner * (0.015 + c), mouth + inner * 0.001))
        post -= block((pocket[0], -0.008 - c, 0.2 - c), (pocket[1], 0.008 + c, 0.26 + c))
        low, high = (x - peg[0] - c, -peg[1] - c, 0.04 - peg[2] - c), (x + peg[0] + c, peg[1] + c, 0.05)
        board -= block(low, high)
        posts[name] = post
    slat = block((-0.175, -0.008, 0.2), (0.175, 0.008, 0.26))
    parts = {"board": board, "left": posts["left"], "right": posts["right"], "slat": slat}
    return furniture("captive slat", {n: of_solid(s) for n, s in parts.items()})


def pegged(*, peg: bool = True, front: bool = False) -> Furniture:
    """A board between the floor and the roof of a frame, 55 mm apart: 0 frame, 1 board.

    A peg of the floor, 20 mm high, goes into a hole of the board. The frame is open towards -y, unless it has a front;
    the board then ends there, and otherwise sticks out by 250 mm. A post on the roof is there to be held.
    """
    c = GAP
    frame = block((0.0, 0.0, 0.0), (0.24, 0.2, 0.13)) - block((0.005, -0.1, 0.03), (0.235, 0.17, 0.1))
    frame += block((0.105, 0.1, 0.13), (0.135, 0.13, 0.3))
    board = block((0.01, 0.002 if front else -0.25, 0.03 + c), (0.23, 0.17 - c, 0.045))
    board -= block((0.11 - c, 0.09 - c, 0.0), (0.13 + c, 0.11 + c, 0.1))
    if peg:
        frame += block((0.11, 0.09, 0.03), (0.13, 0.11, 0.05))
    if front:
        frame += block((0.0, -0.03, 0.0), (0.24, 0.0, 0.13))
    return furniture("pegged", {"frame": of_solid(frame), "board": of_solid(board)})


def round_bar(start: Sequence[float], end: Sequence[float], radius: float, head: float = 0.0) -> Mesh:
    """A round bar, with a head of this radius, 4 mm long, at its start."""
    run = np.subtract(end, start)
    length = float(np.linalg.norm(run))
    solid = manifold3d.Manifold.cylinder(length, radius, radius, 24)
    if head:
        solid += manifold3d.Manifold.cylinder(0.004, head, head, 24)
    frame = align_axis(np.array([0.0, 0.0, 1.0]), run / length)
    return of_solid(solid).transformed(SE3(frame, np.asarray(start, dtype=float)))


def fastened() -> Furniture:
    """A board between two sides: 0 board, 1 left, 2 right. At each side a dowel within, and a screw from outside."""
    c = GAP
    boards = {
        "board": box((-0.2 + c, -0.1, 0.1), (0.2 - c, 0.1, 0.12)),
        "left": box((-0.22, -0.1, 0.0), (-0.2, 0.1, 0.3)),
        "right": box((0.2, -0.1, 0.0), (0.22, 0.1, 0.3)),
    }
    raw: list[RawFastener] = []
    for side, sense in (("left", -1.0), ("right", 1.0)):
        ends = [(sense * x, -sense * 0.05, 0.11) for x in (0.215, 0.185)]
        raw.append(RawFastener(f"dowel_{side}", "dowel", round_bar(*ends, 0.004)))
        ends = [(sense * x, sense * 0.05, 0.11) for x in (0.224, 0.17)]
        raw.append(RawFastener(f"screw_{side}", "screw", round_bar(*ends, 0.002, 0.005)))
    parts, fasteners = drill([RawPart(n, m) for n, m in boards.items()], raw)
    return replace(annotate("fastened", parts, Provenance("hand-made")), fasteners=fasteners)


def interlocked() -> Furniture:
    """Two closed links of a chain: they touch, and nothing takes them apart."""
    c = 0.001
    ring = block((-0.1, -0.01, -0.05), (0.1, 0.01, 0.05)) - block((-0.07, -0.02, -0.03), (0.07, 0.02, 0.03))
    other = block((-0.1, -0.05, -0.01), (0.1, 0.05, 0.01)) - block((-0.07, -0.03, -0.02), (0.07, 0.03, 0.02))
    return furniture("links", {"one": of_solid(ring), "two": of_solid(other.translate((0.14 - c, 0.0, 0.0)))})


def still(name: str, mesh: Mesh, where: SE3 = HERE) -> Body:
    return Body(name, (Shape(mesh, HERE),), where)


def mover(mesh: Mesh, where: SE3 = HERE) -> Body:
    return Body("mover", (Shape(mesh, HERE),), where, moves=True)


class Checker:
    """Whether the scene's moving body, at a pose, hits anything: python-fcl on the same triangles."""

    def __init__(self, scene: Scene) -> None:
        body = next(b for b in scene.bodies if b.moves)
        self._moving = [(s.body_from_mesh, fcl_object(s.mesh, SE3.Identity())) for s in body.shapes]
        self._still = [
            fcl_object(s.mesh, b.pose * s.body_from_mesh) for b in scene.bodies if not b.moves for s in b.shapes
        ]
        self._points = np.concatenate([transform_points(s.body_from_mesh, s.mesh.vertices) for s in body.shapes]).T
        self._ground = scene.ground

    def hits(self, where: SE3) -> bool:
        if self._ground and (where.rotation[2] @ self._points).min() + where.translation[2] <= 0.0:
            return True
        for own, thing in self._moving:
            placed = where * own
            thing.setTransform(fcl.Transform(placed.rotation, placed.translation))
            request, result = fcl.CollisionRequest(), fcl.CollisionResult()
            if any(fcl.collide(thing, other, request, result) for other in self._still):
                return True
        return False

    def distance(self, where: SE3) -> float:
        """To the nearest still surface, the ground left out."""
        out = np.inf
        for own, thing in self._moving:
            placed = where * own
            thing.setTransform(fcl.Transform(placed.rotation, placed.translation))
            for other in self._still:
                out = min(out, fcl.distance(thing, other, fcl.DistanceRequest(), fcl.DistanceResult()))
        return out

    def path_hits(self, path: Sequence[SE3], step: float) -> list[SE3]:
        """States along the path, `step` metres of the farthest point apart, that are in collision."""
        return [p for p in sampled(path, step, float(np.linalg.norm(self._points, axis=0).max())) if self.hits(p)]


def sampled(path: Sequence[SE3], step: float, radius: float) -> list[SE3]:
    """Every edge at this resolution, ends included."""
    out: list[SE3] = []
    for a, b in pairwise(path):
        angle = Rotation.from_matrix(a.rotation.T @ b.rotation).magnitude()
        length = float(np.linalg.norm(b.translation - a.translation)) + angle * radius
        states = interpolate(a, b, np.linspace(0.0, 1.0, max(2, int(np.ceil(length / step)) + 1)))
        turns = Rotation.from_quat(states[3:].T).as_matrix()
        out.extend(SE3(turn, place) for turn, place in zip(turns, states[:3].T.copy(), strict=True))
    return out


@lru_cache(maxsize=500)
def _fcl_model(mesh: Mesh) -> fcl.BVHModel:
    model = fcl.BVHModel()
    model.beginModel(len(mesh.vertices), len(mesh.faces))
    model.addSubModel(mesh.vertices, mesh.faces)
    model.endModel()
    return model


def fcl_object(mesh: Mesh, where: SE3) -> fcl.CollisionObject:
    return fcl.CollisionObject(_fcl_model(mesh), fcl.Transform(where.rotation, where.translation))


class RobotChecker:
    """Whether a robot and what it holds hit still things or the ground: python-fcl on the same triangles."""

    def __init__(self, others: Sequence[Body], held: Sequence[Shape], opening: float) -> None:
        self._opening = opening
        self._held = held
        self._others = fcl.DynamicAABBTreeCollisionManager()
        self._others.registerObjects([fcl_object(s.mesh, b.pose * s.body_from_mesh) for b in others for s in b.shapes])
        self._others.setup()
        self._own: dict[int, fcl.CollisionObject] = {}

    def hits(self, q: np.ndarray) -> bool:
        tips = world_from_tips(q)
        own = [(link.mesh, where) for link, where in placed(q, self._opening)]
        own += [(s.mesh, tips * s.body_from_mesh) for s in self._held]
        return any(self._touches(index, mesh, where) for index, (mesh, where) in enumerate(own))

    def _touches(self, index: int, mesh: Mesh, where: SE3) -> bool:
        if (mesh.vertices @ where.rotation[2]).min() + where.translation[2] <= 0.0:
            return True
        if index not in self._own:
            self._own[index] = fcl_object(mesh, where)
        thing = self._own[index]
        thing.setTransform(fcl.Transform(where.rotation, where.translation))
        # A solid wholly inside another has no touching surface: robots and parts here are too large for that.
        found = fcl.CollisionData()
        self._others.collide(thing, found, fcl.defaultCollisionCallback)
        return found.result.is_collision


def write_stl(furniture: Furniture, folder: Path, scale: float = 1.0) -> Path:
    """Plain STL files of the assembled parts, one each, as someone would bring them."""
    folder.mkdir(parents=True, exist_ok=True)
    for part, slot in zip(furniture.parts, furniture.assembled, strict=True):
        mesh = part.mesh.trimesh.copy()
        mesh.apply_transform(slot.homogeneous)
        mesh.apply_scale(scale)
        mesh.export(folder / f"{part.name}.stl")
    return folder


def least_distance(placed: Sequence[fcl.CollisionObject]) -> float:
    """Least distance of any two objects, by python-fcl; 0 if some penetrate."""
    least = np.inf
    for a in range(len(placed)):
        for b in range(a):
            if fcl.collide(placed[a], placed[b], fcl.CollisionRequest(), fcl.CollisionResult()):
                return 0.0
            least = min(least, fcl.distance(placed[a], placed[b], fcl.DistanceRequest(), fcl.DistanceResult()))
    return least
