"""Schema of `furniture.json`: the document as typed structures, and its conversion to furniture with validation."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path

import msgspec
import numpy as np
from scipy.spatial.transform import Rotation

from roboassembly.errors import FurnitureError, InputError
from roboassembly.furniture.contacts import find_contacts
from roboassembly.furniture.model import (
    NEAR,
    SAME_POINT,
    Connection,
    ConnectionPoint,
    Fastener,
    FastenerKind,
    Furniture,
    GraspRegion,
    Part,
    Provenance,
    ShapeClass,
    Site,
    check_part_count,
    mate,
)
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3, pose_from_seven, pose_to_seven, rotation_angle, rotation_from_quaternion

FORMAT = "roboassembly.furniture"
VERSION = 1

_ALIKE, _ALIGNED = 1e-3, 0.01
"""Largest errors of a file: distance [m] and angle [rad]."""

_Triple = tuple[float, float, float]
_Seven = tuple[float, float, float, float, float, float, float]
_Quaternion = tuple[float, float, float, float]


class _Strict(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Structure that rejects unknown fields, and so misspelt ones."""


class _Point(_Strict, frozen=True):
    position: _Triple
    normal: _Triple
    tangent: _Triple
    gap: float


class _Grasp(_Strict, frozen=True):
    position: _Triple
    closing: _Triple
    approaches: tuple[_Triple, _Triple, _Triple, _Triple]
    width: float


class _Part(_Strict, frozen=True):
    name: str
    mesh: str
    assembled_pose: _Seven
    points: list[_Point]
    label: str = ""
    grasps: list[_Grasp] = []


class _Site(_Strict, frozen=True):
    name: str
    part: int
    pose: _Seven
    """Pose of the site in its part."""
    mate: int | None


class _Class(_Strict, frozen=True):
    members: list[int]
    symmetries: list[_Quaternion]


class _Fastener(_Strict, frozen=True):
    name: str
    kind: FastenerKind
    mesh: str
    place: _Seven
    """Pose in the furniture; z is the way in."""
    joins: list[int]


class _Provenance(_Strict, frozen=True):
    source: str
    identifier: str = ""
    licence: str = ""
    scale: float = 1.0
    notes: list[str] = []


class Document(_Strict, frozen=True):
    """Content of `furniture.json`."""

    format: str
    version: int
    name: str
    provenance: _Provenance
    parts: list[_Part]
    connections: list[tuple[int, int, int, int]]
    """Rows `part_a, point_a, part_b, point_b`, counted from 0."""
    classes: list[_Class]
    sites: list[_Site] = []
    fasteners: list[_Fastener] | msgspec.UnsetType = msgspec.UNSET
    """Dowels, screws and cam locks; absent if there are none."""


class Header(msgspec.Struct, frozen=True):
    """Format and version, checked before anything else is read."""

    format: str = ""
    version: int = 0


def to_document(furniture: Furniture, files: Mapping[Mesh, str]) -> Document:
    """Return the document of `furniture`; `files` has the path of each mesh."""
    parts: list[_Part] = []
    for part, slot in zip(furniture.parts, furniture.assembled, strict=True):
        points = [_Point(_three(p.position), _three(p.normal), _three(p.tangent), p.gap) for p in part.points]
        grasps = [_to_grasp(region) for region in part.grasps]
        parts.append(_Part(part.name, files[part.mesh], _seven(slot), points, part.label, grasps))
    classes = [
        _Class(
            list(c.members), [tuple(q) for q in Rotation.from_matrix(c.symmetries).as_quat(scalar_first=True).tolist()]
        )
        for c in furniture.classes
    ]
    origin = furniture.provenance
    return Document(
        FORMAT,
        VERSION,
        furniture.name,
        _Provenance(origin.source, origin.identifier, origin.licence, origin.scale, list(origin.notes)),
        parts,
        [(c.part_a, c.point_a, c.part_b, c.point_b) for c in furniture.connections],
        classes,
        [_Site(s.name, s.part, _seven(s.frame), s.mate) for s in furniture.sites],
        [_Fastener(f.name, f.kind, files[f.mesh], _seven(f.place), list(f.joins)) for f in furniture.fasteners]
        or msgspec.UNSET,
    )


def _to_grasp(region: GraspRegion) -> _Grasp:
    a, b, c, d = (_three(approach) for approach in region.approaches)
    return _Grasp(_three(region.position), _three(region.closing), (a, b, c, d), region.width)


def _seven(pose: SE3) -> _Seven:
    x, y, z, qw, qx, qy, qz = pose_to_seven(pose)
    return x, y, z, qw, qx, qy, qz


def _three(vector: np.ndarray) -> _Triple:
    return float(vector[0]), float(vector[1]), float(vector[2])


def from_document(document: Document, read_mesh: Callable[[str, str], Mesh], folder: Path) -> Furniture:
    """Return the furniture of a document and check it.

    Args:
        document: content of `furniture.json`.
        read_mesh: reader of a mesh by its path in the folder; its second argument is the place for error messages.
        folder: folder of the furniture, for error messages.

    Raises:
        FurnitureError: a number is not finite, a direction is not a unit vector, parts penetrate, or any rule of
            `Furniture` is broken.
    """
    check_part_count(len(document.parts), str(folder))
    meshes: dict[str, Mesh] = {}
    parts: list[Part] = []
    slots: list[SE3] = []
    for index, part in enumerate(document.parts):
        where = f"{folder}: part {index} '{part.name}'"
        if part.mesh not in meshes:
            meshes[part.mesh] = read_mesh(part.mesh, where)
        points = tuple(_point(p, f"{where}, point {k}") for k, p in enumerate(part.points))
        grasps = tuple(_grasp(g, f"{where}, grasp {k}") for k, g in enumerate(part.grasps))
        parts.append(Part(part.name, meshes[part.mesh], points, part.label, grasps))
        try:
            slots.append(pose_from_seven(part.assembled_pose))
        except InputError as error:
            raise FurnitureError(f"{where}: assembled_pose: {error}") from None
    names = [p.name for p in (*parts, *(document.fasteners or ()))]
    if len(set(names)) < len(names):
        raise FurnitureError(f"{folder}: part names repeat: {sorted(n for n in set(names) if names.count(n) > 1)}")
    try:
        classes = tuple(
            ShapeClass(
                tuple(c.members), np.array([rotation_from_quaternion(q) for q in c.symmetries]).reshape(-1, 3, 3)
            )
            for c in document.classes
        )
    except InputError as error:
        raise FurnitureError(f"{folder}: classes: {error}") from None
    try:
        sites = tuple(Site(s.name, s.part, pose_from_seven(s.pose), s.mate) for s in document.sites)
    except InputError as error:
        raise FurnitureError(f"{folder}: sites: {error}") from None
    fasteners: list[Fastener] = []
    for fastener in document.fasteners or ():
        where = f"{folder}: fastener '{fastener.name}'"
        if fastener.mesh not in meshes:
            meshes[fastener.mesh] = read_mesh(fastener.mesh, where)
        try:
            place = pose_from_seven(fastener.place)
        except InputError as error:
            raise FurnitureError(f"{where}: place: {error}") from None
        fasteners.append(
            Fastener(fastener.name, fastener.kind, meshes[fastener.mesh], place, tuple(sorted(set(fastener.joins))))
        )
    origin = document.provenance
    furniture = Furniture(
        document.name,
        tuple(parts),
        tuple(slots),
        tuple(Connection(*c) for c in document.connections),
        classes,
        Provenance(origin.source, origin.identifier, origin.licence, origin.scale, tuple(origin.notes)),
        sites,
        tuple(fasteners),
    )
    _check_consistency(furniture, folder)
    return furniture


def _check_consistency(furniture: Furniture, folder: Path) -> None:
    """Raise an error unless parts, classes, points and connections are consistent with each other."""
    if not 0.0 < furniture.provenance.scale < math.inf:
        raise FurnitureError(f"{folder}: provenance: scale {furniture.provenance.scale}; expected a positive number")
    for index, shape_class in enumerate(furniture.classes):
        where = f"{folder}: class {index}"
        if not len(shape_class.symmetries) or not np.allclose(shape_class.symmetries[0], np.eye(3), atol=1e-6):
            raise FurnitureError(f"{where}: symmetries do not begin with the identity [1, 0, 0, 0]")
        first = furniture.parts[shape_class.members[0]]
        for part in (furniture.parts[m] for m in shape_class.members[1:]):
            if np.abs(part.mesh.bounds - first.mesh.bounds).max() > NEAR + _ALIKE:
                raise FurnitureError(f"{where}: parts '{first.name}' and '{part.name}' do not have the same shape")
    for part in furniture.parts:
        for k, point in enumerate(part.points):
            low, high = part.mesh.bounds + np.array([[-SAME_POINT], [SAME_POINT]])
            if (point.position < low).any() or (point.position > high).any():
                raise FurnitureError(f"{folder}: part '{part.name}', point {k}: position lies off the part")
    for c in furniture.connections:
        a, b = furniture.parts[c.part_a], furniture.parts[c.part_b]
        dictated = mate(b.points[c.point_b], a.points[c.point_a])
        offset = dictated.actInv(furniture.assembled[c.part_b].actInv(furniture.assembled[c.part_a]))
        if np.linalg.norm(offset.translation) > _ALIKE or rotation_angle(offset.rotation) > _ALIGNED:
            raise FurnitureError(
                f"{folder}: point {c.point_a} of '{a.name}' and point {c.point_b} of '{b.name}', mated, do not "
                f"give the assembled poses (off by {np.linalg.norm(offset.translation) * 1e3:.3g} mm, "
                f"{math.degrees(rotation_angle(offset.rotation)):.3g}°)"
            )
    try:
        placed = [p.mesh.transformed(s) for p, s in zip(furniture.parts, furniture.assembled, strict=True)]
        find_contacts(placed, [p.name for p in furniture.parts])
    except FurnitureError as error:
        raise FurnitureError(f"{folder}: {error}") from None


def _unit(vector: _Triple, where: str) -> np.ndarray:
    array = np.array(vector)
    length = math.hypot(*vector)
    if not math.isclose(length, 1.0, abs_tol=1e-3):
        raise FurnitureError(f"{where}: {list(vector)} is not a unit vector (length {length:.4g})")
    return array


def _finite(vector: _Triple, where: str) -> np.ndarray:
    array = np.array(vector)
    if not np.isfinite(array).all():
        raise FurnitureError(f"{where}: {list(vector)} is not finite")
    return array


def _point(point: _Point, where: str) -> ConnectionPoint:
    normal, tangent = _unit(point.normal, f"{where} normal"), _unit(point.tangent, f"{where} tangent")
    if abs(float(normal @ tangent)) > 1e-3:
        raise FurnitureError(f"{where}: tangent is not orthogonal to the normal (cosine {float(normal @ tangent):.4g})")
    if not 0.0 <= point.gap < 0.1:
        raise FurnitureError(f"{where}: gap {point.gap} m; expected a number between 0 and 0.1 m")
    return ConnectionPoint(_finite(point.position, f"{where} position"), normal, tangent, point.gap)


def _grasp(grasp: _Grasp, where: str) -> GraspRegion:
    if not 0.0 < grasp.width < 1.0:
        raise FurnitureError(f"{where}: width {grasp.width} m; expected more than 0 and less than 1 m")
    approaches = np.array([_unit(a, f"{where} approach") for a in grasp.approaches])
    return GraspRegion(
        _finite(grasp.position, where), _unit(grasp.closing, f"{where} closing"), approaches, grasp.width
    )
