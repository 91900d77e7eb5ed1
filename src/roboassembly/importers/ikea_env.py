"""Importer for the IKEA Furniture Assembly Environment: MJCF files, STL meshes, z up, metres (about 0.6 of real size).

Each file is one piece. The bodies' poses in the files are not assembled; the connection sites give the assembled poses.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from roboassembly.errors import FurnitureError, InputError
from roboassembly.furniture.model import Provenance, RawFurniture, Site, check_part_count
from roboassembly.furniture.triangles import NamedTriangles, Triangles, bounds, combine, stand
from roboassembly.geometry.meshes import MAX_FACES
from roboassembly.geometry.poses import SE3, from_quaternion
from roboassembly.importers import files
from roboassembly.importers.connection_sites import ConnectionSite, solve, upright
from roboassembly.importers.mesh_files import read_mesh

LICENCE = "MIT"
EXPECTED = "an MJCF file of the IKEA Furniture Assembly Environment, or a folder that holds such files"
MAX_SITES = 400
_TURNS = ("euler", "axisangle", "xyaxes", "zaxis")


@dataclass(frozen=True, eq=False)
class _Body:
    name: str
    pose: SE3
    """Pose in the file [m]."""
    surface: Triangles
    """Triangles in the body's frame [m]."""
    sites: tuple[ConnectionSite, ...]


def find(root: Path) -> list[Path]:
    """Return the MJCF files at or below `root`; a file is returned as it is.

    Raises:
        FurnitureError: the path does not exist, or holds no MJCF file.
    """
    root = Path(root)
    if root.is_file():
        return [root]
    root = files.folder(root, EXPECTED)
    found = [
        here / name
        for here, names in files.walk(root)
        for name in names
        if name.lower().endswith(".xml") and b"<mujoco" in _head(here / name)
    ]
    if not found:
        raise FurnitureError(f"'{root}' holds no MJCF files; give {EXPECTED}")
    return sorted(found)


def _head(path: Path) -> bytes:
    return files.read_bytes(path)[:4096] if path.is_file() else b""


def read(path: Path, *, scale: float | None = None) -> RawFurniture:
    """Read the bodies of one piece as parts, at the poses given by their connection sites: z up, metres, on the ground.

    The up axis follows the orientation of most bodies in the file. All connection sites are kept; sites that meet are
    each other's mates.

    Args:
        path: MJCF file.
        scale: scale factor; 1 by default (1.6 gives about real size).

    Raises:
        FurnitureError: files are missing, broken or unsupported, a mesh lies outside the file's folder, sites do not
            close to 1 mm, or there are not 2 to 1000 bodies.
    """
    path = Path(path)
    bodies = _read_bodies(path)
    try:
        solved = solve([b.name for b in bodies], [site for b in bodies for site in b.sites])
    except FurnitureError as problem:
        raise FurnitureError(f"'{path}': {problem}") from None
    parts: list[NamedTriangles] = []
    for body in bodies:
        label = next((site.label[0] for site in body.sites), "")
        parts.append(NamedTriangles(body.name, body.surface.moved(solved.poses[body.name].homogeneous), label))
    factor = 1.0 if scale is None else scale
    rotation = upright(solved.poses, {b.name: b.pose for b in bodies})
    raw = stand(parts, rotation, factor, f"'{path}'")
    # `stand` moved the parts; the sites get the same transform.
    low, high = bounds(parts, rotation)
    middle = np.array([*(0.5 * (low + high))[:2], low[2]])
    index = {body.name: k for k, body in enumerate(bodies)}

    def converted(site: ConnectionSite, mate: int | None) -> Site:
        pose = solved.poses[site.body] * site.body_from_site
        place = (rotation @ pose.translation - middle) * factor
        return Site(site.name, index[site.body], SE3(rotation @ pose.rotation, place), mate)

    sites: list[Site] = []
    for pair in solved.pairs:
        sites += [converted(pair.first, len(sites) + 1), converted(pair.second, len(sites))]
    sites += [converted(site, None) for site in solved.unused]
    return RawFurniture(raw, Provenance("ikea-env", files.one_line(path.stem), LICENCE, factor), tuple(sites))


def _read_bodies(path: Path) -> list[_Body]:
    root = files.read_xml(path)
    where = f"'{path}'"
    if root.tag != "mujoco":
        raise FurnitureError(f"{where} is not MJCF: its root is <{files.one_line(root.tag, 40)}>, not <mujoco>")
    if next(root.iter("include"), None) is not None:
        raise FurnitureError(f"{where} includes other files; give one self-contained MJCF")
    elements = [element for world in root.findall("worldbody") for element in world.findall("body")]
    check_part_count(len(elements), where)
    names = [files.one_line(element.get("name", ""), 80) for element in elements]
    if "" in names or len(set(names)) < len(names):
        raise FurnitureError(f"{where}: bodies have names, all different; got {files.one_line(str(names))}")
    assets = _Assets(path, root)
    bodies: list[_Body] = []
    for name, element in zip(names, elements, strict=True):
        here = f"{where}: body '{name}'"
        if element.find("body") is not None:
            raise FurnitureError(f"{here} holds another body; every part must be a body of the world")
        sites = tuple(
            ConnectionSite(name, files.one_line(site.get("name", "")), _pose(site, here))
            for site in element.findall("site")
            if "conn_site" in site.get("name", "")
        )
        bodies.append(_Body(name, _pose(element, here), _surface(element, assets, here), sites))
    count = sum(len(body.sites) for body in bodies)
    if count > MAX_SITES:
        raise FurnitureError(f"{where} has {count} connection sites; at most {MAX_SITES} are accepted")
    return bodies


class _Assets:
    """Scaled meshes of an MJCF file by name; each is read once."""

    def __init__(self, path: Path, root: ElementTree.Element) -> None:
        self.where = f"'{path}'"
        self.folder = path.resolve().parent
        self.prefix = next((c.get("meshdir", "") for c in root.iter("compiler") if c.get("meshdir")), "")
        self.elements = {
            mesh.get("name") or Path(mesh.get("file", "")).stem: mesh
            for assets in root.findall("asset")
            for mesh in assets.findall("mesh")
        }
        self.read: dict[str, Triangles] = {}

    def __getitem__(self, name: str) -> Triangles:
        if name not in self.read:
            if name not in self.elements:
                raise FurnitureError(f"{self.where}: mesh '{files.one_line(name, 80)}' is not among its assets")
            element = self.elements[name]
            if "refpos" in element.attrib or "refquat" in element.attrib:
                raise FurnitureError(f"{self.where}: mesh '{files.one_line(name, 80)}' uses refpos or refquat")
            file = element.get("file", "")
            path = files.inside(self.folder, f"{self.prefix}/{file}" if self.prefix else file, self.where)
            factors = _floats(element.get("scale", "1 1 1"), 3, f"{self.where}: scale of a mesh")
            if not (np.abs(factors) > 1e-9).all():
                raise FurnitureError(f"{self.where}: mesh '{files.one_line(name, 80)}' is scaled by {factors.tolist()}")
            self.read[name] = read_mesh(path).moved(np.diag([*factors, 1.0]))
        return self.read[name]


def _surface(body: ElementTree.Element, assets: _Assets, where: str) -> Triangles:
    pieces: list[Triangles] = []
    for geom in body.findall("geom"):
        name = geom.get("mesh")
        if name is not None:
            pieces.append(assets[name].moved(_pose(geom, where).homogeneous))
            if sum(len(piece.faces) for piece in pieces) > MAX_FACES:
                raise FurnitureError(f"{where} has more than {MAX_FACES} faces; simplify its meshes first")
    if not pieces:
        raise FurnitureError(f"{where} has no mesh; bodies made of primitives alone are not read")
    return combine(pieces)


def _pose(element: ElementTree.Element, where: str) -> SE3:
    """Return the pose that `pos` and `quat` (w, x, y, z) of an element give."""
    for turn in _TURNS:
        if turn in element.attrib:
            raise FurnitureError(f"{where}: <{element.tag}> is turned by '{turn}'; expected 'quat'")
    position = _floats(element.get("pos", "0 0 0"), 3, f"{where}: pos")
    quaternion = _floats(element.get("quat", "1 0 0 0"), 4, f"{where}: quat")
    try:
        return from_quaternion(position.tolist(), quaternion.tolist())
    except InputError as problem:
        raise FurnitureError(f"{where}: {problem}") from None


def _floats(text: str, count: int, where: str) -> Float[np.ndarray, "n"]:
    try:
        out = np.array([float(word) for word in text.split()])
    except ValueError:
        out = np.array([np.nan])
    if len(out) != count or not np.isfinite(out).all() or np.abs(out).max() > 1e6:
        raise FurnitureError(f"{where}: {files.one_line(repr(text), 60)} is not {count} finite numbers below 1e6")
    return out
