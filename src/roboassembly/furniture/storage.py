"""Furniture on disk: a folder with `furniture.json` and one mesh file per distinct part.

The folder is written whole or not at all, and everything is checked on the way in. Version 1:

    furniture.json   see `_File`; poses are (x, y, z, qw, qx, qy, qz), metres, z up
    meshes/*.ply     binary PLY, in the part's frame (origin at its centre of mass)
"""

from __future__ import annotations

import hashlib
import math
import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

import msgspec
import numpy as np
from scipy.spatial.transform import Rotation

from roboassembly.errors import FurnitureError, InputError
from roboassembly.furniture.contacts import find_contacts
from roboassembly.furniture.model import (
    SAME_POINT,
    Connection,
    ConnectionPoint,
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
_LONGEST_NAME = 255
"""Bytes of a file name: what common file systems take."""
FILE_NAME = "furniture.json"
MESHES = "meshes"

_ALIKE, _ALIGNED = 1e-3, 0.01
"""Metres and radians: how exact a file has to be."""

_Triple = tuple[float, float, float]
_Seven = tuple[float, float, float, float, float, float, float]
_Quaternion = tuple[float, float, float, float]


class _Strict(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Misspelt fields are refused instead of ignored."""


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
    """Of the site in its part."""
    mate: int | None


class _Class(_Strict, frozen=True):
    members: list[int]
    symmetries: list[_Quaternion]


class _Provenance(_Strict, frozen=True):
    source: str
    identifier: str = ""
    licence: str = ""
    scale: float = 1.0
    notes: list[str] = []


class _File(_Strict, frozen=True):
    format: str
    version: int
    name: str
    provenance: _Provenance
    parts: list[_Part]
    connections: list[tuple[int, int, int, int]]
    """`part_a, point_a, part_b, point_b`, counted from 0."""
    classes: list[_Class]
    sites: list[_Site] = []


class _Header(msgspec.Struct, frozen=True):
    format: str = ""
    version: int = 0


def save(furniture: Furniture, folder: Path | str) -> Path:
    """Write `furniture` to `folder`, replacing furniture that is there and nothing else; returns the folder.

    Raises:
        InputError: `folder` exists and holds something else than furniture, or cannot be written.
    """
    return _put(Path(folder), lambda scratch: _write(furniture, scratch))


def read_files(folder: Path) -> dict[str, bytes]:
    """The files of a furniture folder by their paths in it, for `save_files`; raises `OSError` where one is missing."""
    paths = [folder / FILE_NAME, *sorted((folder / MESHES).iterdir())]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def files_hash(folder: Path) -> str:
    """Hash of the files of a furniture folder, which is quicker than to load it.

    Raises:
        InputError: they cannot be read.
    """
    digest = hashlib.sha256()
    try:
        for name, data in read_files(folder).items():
            digest.update(name.encode())
            digest.update(hashlib.sha256(data).digest())
    except OSError as error:
        raise InputError(f"cannot read the furniture in '{folder}': {error.strerror or error}") from None
    return digest.hexdigest()[:16]


def save_files(files: Mapping[str, bytes], folder: Path | str) -> Path:
    """Write a furniture folder's files as `save` would; returns the folder.

    Raises:
        InputError: as `save`.
    """

    def write(scratch: Path) -> None:
        (scratch / MESHES).mkdir()
        for name, data in files.items():
            (scratch / name).write_bytes(data)

    return _put(Path(folder), write)


def _put(asked: Path, write: Callable[[Path], None]) -> Path:
    folder = asked.resolve()
    if folder.exists() and not _may_replace(folder):
        raise InputError(f"{asked} exists and is not a furniture folder; name a new or empty folder")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    except OSError as error:
        raise InputError(f"cannot write to {asked}: {error.strerror}") from None
    try:
        scratch.chmod(0o755)
        write(scratch)
        if not folder.exists():
            scratch.rename(folder)
            return asked
        _swap(scratch, folder)
    except OSError as error:
        raise InputError(f"cannot write to {asked}: {error.strerror}") from None
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    return asked


def _swap(new: Path, folder: Path) -> None:
    """Put a folder in the place of another one, which stays if that fails."""
    old = new.with_name(f"{new.name}-old")
    folder.rename(old)
    try:
        new.rename(folder)
    except OSError:
        old.rename(folder)
        raise
    # What else lay there is the user's.
    for entry in [e for e in old.iterdir() if e.name not in (FILE_NAME, MESHES)]:
        entry.rename(folder / entry.name)
    shutil.rmtree(old)


def _may_replace(folder: Path) -> bool:
    if not folder.is_dir():
        return False
    return (folder / FILE_NAME).is_file() or not any(folder.iterdir())


def _write(furniture: Furniture, folder: Path) -> None:
    (folder / MESHES).mkdir()
    files: dict[int, str] = {}
    parts = []
    for part, slot in zip(furniture.parts, furniture.assembled, strict=True):
        if id(part.mesh) not in files:
            path = f"{MESHES}/{len(files):02d}.ply"
            part.mesh.trimesh.export(folder / path, encoding="binary", vertex_normal=False)
            files[id(part.mesh)] = path
        points = [_Point(_three(p.position), _three(p.normal), _three(p.tangent), p.gap) for p in part.points]
        grasps = [
            _Grasp(_three(g.position), _three(g.closing), tuple(_three(a) for a in g.approaches), g.width)  # pyright: ignore[reportArgumentType]
            for g in part.grasps
        ]
        parts.append(_Part(part.name, files[id(part.mesh)], _seven(slot), points, part.label, grasps))
    classes = [
        _Class(
            list(c.members), [tuple(q) for q in Rotation.from_matrix(c.symmetries).as_quat(scalar_first=True).tolist()]
        )
        for c in furniture.classes
    ]
    origin = furniture.provenance
    document = _File(
        FORMAT,
        VERSION,
        furniture.name,
        _Provenance(origin.source, origin.identifier, origin.licence, origin.scale, list(origin.notes)),
        parts,
        [(c.part_a, c.point_a, c.part_b, c.point_b) for c in furniture.connections],
        classes,
        [_Site(s.name, s.part, _seven(s.frame), s.mate) for s in furniture.sites],
    )
    (folder / FILE_NAME).write_bytes(msgspec.json.format(msgspec.json.encode(document), indent=1) + b"\n")


def _seven(pose: SE3) -> _Seven:
    return tuple(pose_to_seven(pose))  # pyright: ignore[reportReturnType]


def _three(vector: np.ndarray) -> _Triple:
    return float(vector[0]), float(vector[1]), float(vector[2])


def load(folder: Path | str) -> Furniture:
    """Read and check a furniture folder.

    Raises:
        FurnitureError: the folder, its JSON or a mesh is missing or broken, a number is not finite, a direction is
            not a unit vector, parts penetrate, or any rule of `Furniture` is broken. The message says where.
    """
    folder = Path(folder)
    document = _read_document(folder)
    check_part_count(len(document.parts), str(folder))
    meshes: dict[str, Mesh] = {}
    parts, slots = [], []
    for index, part in enumerate(document.parts):
        where = f"{folder}: part {index} '{part.name}'"
        if part.mesh not in meshes:
            meshes[part.mesh] = _read_mesh(folder, part.mesh, where)
        points = tuple(_point(p, f"{where}, point {k}") for k, p in enumerate(part.points))
        grasps = tuple(_grasp(g, f"{where}, grasp {k}") for k, g in enumerate(part.grasps))
        parts.append(Part(part.name, meshes[part.mesh], points, part.label, grasps))
        try:
            slots.append(pose_from_seven(part.assembled_pose))
        except InputError as error:
            raise FurnitureError(f"{where}: assembled_pose: {error}") from None
    names = [p.name for p in parts]
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
    origin = document.provenance
    furniture = Furniture(
        document.name,
        tuple(parts),
        tuple(slots),
        tuple(Connection(*c) for c in document.connections),
        classes,
        Provenance(origin.source, origin.identifier, origin.licence, origin.scale, tuple(origin.notes)),
        sites,
    )
    _check(furniture, folder)
    return furniture


def _check(furniture: Furniture, folder: Path) -> None:
    """What the pieces by themselves cannot tell: that they fit together."""
    if not 0.0 < furniture.provenance.scale < math.inf:
        raise FurnitureError(f"{folder}: provenance: scale {furniture.provenance.scale}; a positive number would do")
    for index, shape_class in enumerate(furniture.classes):
        where = f"{folder}: class {index}"
        if not len(shape_class.symmetries) or not np.allclose(shape_class.symmetries[0], np.eye(3), atol=1e-6):
            raise FurnitureError(f"{where}: symmetries do not begin with the identity [1, 0, 0, 0]")
        first = furniture.parts[shape_class.members[0]]
        for part in (furniture.parts[m] for m in shape_class.members[1:]):
            if np.abs(part.mesh.bounds - first.mesh.bounds).max() > _ALIKE:
                raise FurnitureError(f"{where}: parts '{first.name}' and '{part.name}' do not have the same shape")
    for part in furniture.parts:
        for k, point in enumerate(part.points):
            low, high = part.mesh.bounds + np.array([[-SAME_POINT], [SAME_POINT]])
            if (point.position < low).any() or (point.position > high).any():
                raise FurnitureError(f"{folder}: part '{part.name}', point {k}: position lies off the part")
    for c in furniture.connections:
        a, b = furniture.parts[c.part_a], furniture.parts[c.part_b]
        dictated = mate(b.points[c.point_b], a.points[c.point_a])
        apart = dictated.actInv(furniture.assembled[c.part_b].actInv(furniture.assembled[c.part_a]))
        if np.linalg.norm(apart.translation) > _ALIKE or rotation_angle(apart.rotation) > _ALIGNED:
            raise FurnitureError(
                f"{folder}: point {c.point_a} of '{a.name}' and point {c.point_b} of '{b.name}', laid together, do not "
                f"give the assembled poses (off by {np.linalg.norm(apart.translation) * 1e3:.3g} mm, "
                f"{math.degrees(rotation_angle(apart.rotation)):.3g}°)"
            )
    try:
        placed = [p.mesh.transformed(s) for p, s in zip(furniture.parts, furniture.assembled, strict=True)]
        find_contacts(placed, [p.name for p in furniture.parts])
    except FurnitureError as error:
        raise FurnitureError(f"{folder}: {error}") from None


def _read_document(folder: Path) -> _File:
    if not folder.is_dir():
        raise FurnitureError(f"no furniture folder at {folder}; a folder with {FILE_NAME} would do")
    path = folder / FILE_NAME
    if not path.is_file():
        raise FurnitureError(f"{folder} has no {FILE_NAME}; save or import furniture there first")
    try:
        text = path.read_bytes()
        header = msgspec.json.decode(text, type=_Header)
        if header.format != FORMAT:
            raise FurnitureError(f"{path}: format is '{header.format}'; '{FORMAT}' is expected")
        if header.version != VERSION:
            raise FurnitureError(f"{path}: version {header.version} is not known; this program reads version {VERSION}")
        return msgspec.json.decode(text, type=_File)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise FurnitureError(f"{path} is not valid: {error}") from None
    except OSError as error:
        raise FurnitureError(f"{path} cannot be read: {error.strerror}") from None


def _read_mesh(folder: Path, name: str, where: str) -> Mesh:
    import trimesh  # takes 0.3 s, and not all who know of furniture folders read meshes

    path = folder / name
    if "\0" in name:
        raise FurnitureError(f"{where}: mesh file name {name!r} holds a zero byte")
    if len(name.encode()) > _LONGEST_NAME:
        raise FurnitureError(f"{where}: mesh file name '{name[:40]}...' is too long")
    if not path.resolve().is_relative_to(folder.resolve()):
        raise FurnitureError(f"{where}: mesh '{name}' lies outside the furniture folder")
    if not path.is_file():
        raise FurnitureError(f"{where}: mesh file {path} is missing")
    try:
        loaded = trimesh.load_mesh(path, file_type="ply", process=False)
    except (ValueError, IndexError, KeyError, TypeError, OSError, EOFError, AttributeError, NameError) as error:
        # trimesh's reader gets lost in broken headers in many ways, unbound names among them.
        raise FurnitureError(f"{where}: mesh {path} cannot be read as PLY: {error}") from None
    if not isinstance(loaded, trimesh.Trimesh):
        raise FurnitureError(f"{where}: mesh {path} has no faces")
    try:
        mesh = Mesh.from_trimesh(loaded)
        _ = mesh.hull
    except FurnitureError as error:
        raise FurnitureError(f"{where}: {error}") from None
    return mesh


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
        raise FurnitureError(f"{where}: gap {point.gap} m; 0 to 0.1 would do")
    return ConnectionPoint(_finite(point.position, f"{where} position"), normal, tangent, point.gap)


def _grasp(grasp: _Grasp, where: str) -> GraspRegion:
    if not 0.0 < grasp.width < 1.0:
        raise FurnitureError(f"{where}: width {grasp.width} m; more than 0 and less than 1 would do")
    approaches = np.array([_unit(a, f"{where} approach") for a in grasp.approaches])
    return GraspRegion(
        _finite(grasp.position, where), _unit(grasp.closing, f"{where} closing"), approaches, grasp.width
    )
