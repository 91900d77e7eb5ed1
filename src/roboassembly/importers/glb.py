"""Reader of glTF 2.0, binary or text: the named nodes with triangles, in the scene's frame (y up, metres).

The unit of a scene is not taken from the standard: many programs write millimetres.
"""

from __future__ import annotations

import base64
import binascii
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote

import msgspec
import numpy as np
from jaxtyping import Float

from roboassembly.errors import FurnitureError, InputError
from roboassembly.furniture.triangles import NamedTriangles, Triangles, combine
from roboassembly.geometry.meshes import MAX_FACES
from roboassembly.geometry.poses import rotation_from_quaternion
from roboassembly.importers.files import MAX_TEXT_BYTES, decode_json, inside, one_line, read_bytes
from roboassembly.importers.scene import FileScene, Node, given_name, part_names

MAX_NODES = 20_000
MAX_NODE_DEPTH = 256
MAX_NUMBERS = 4 * MAX_FACES
"""Largest number of points and corners in all primitives of one mesh."""
_TOO_MANY = f"a mesh lists more than {MAX_NUMBERS} points and corners; simplify it first"

_JSON, _BIN = 0x4E4F534A, 0x004E4942
_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_HARMLESS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_", "KHR_mesh_quantization", "KHR_xmp")
"""Prefixes of required extensions that do not change the triangles."""
_INSTANCING = "EXT_mesh_gpu_instancing"
"""Extension with more copies of a mesh than there are nodes; it is not required, but without it parts are missing."""


class _Node(msgspec.Struct, frozen=True):
    name: str = ""
    mesh: int | None = None
    children: list[int] = []
    matrix: list[float] | None = None
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)


class _Primitive(msgspec.Struct, frozen=True):
    attributes: dict[str, int]
    indices: int | None = None
    mode: int = 4


class _Mesh(msgspec.Struct, frozen=True):
    primitives: list[_Primitive]
    name: str = ""


class _Accessor(msgspec.Struct, frozen=True):
    component: int = msgspec.field(name="componentType")
    count: int
    type: str
    view: int | None = msgspec.field(name="bufferView", default=None)
    offset: int = msgspec.field(name="byteOffset", default=0)
    normalized: bool = False
    sparse: dict[str, object] | None = None


class _BufferView(msgspec.Struct, frozen=True):
    buffer: int
    length: int = msgspec.field(name="byteLength")
    offset: int = msgspec.field(name="byteOffset", default=0)
    stride: int | None = msgspec.field(name="byteStride", default=None)


class _Scene(msgspec.Struct, frozen=True):
    nodes: list[int] = []


class _Buffer(msgspec.Struct, frozen=True):
    uri: str | None = None


class _Document(msgspec.Struct, frozen=True):
    nodes: list[_Node] = []
    meshes: list[_Mesh] = []
    accessors: list[_Accessor] = []
    buffer_views: list[_BufferView] = msgspec.field(name="bufferViews", default=[])
    buffers: list[_Buffer] = []
    scenes: list[_Scene] = []
    scene: int = 0
    required: list[str] = msgspec.field(name="extensionsRequired", default=[])
    used: list[str] = msgspec.field(name="extensionsUsed", default=[])


@dataclass(frozen=True, eq=False)
class _MeshNode:
    """Node with a mesh, and the part that it belongs to."""

    path: tuple[Node, ...]
    """Nodes from the root to the one that names the part."""
    mesh: int
    scene_from_node: Float[np.ndarray, "4 4"]


@dataclass(eq=False)
class _Buffers:
    """Buffers of a document, each read once."""

    document: _Document
    binary: bytes
    """Binary chunk of the file."""
    folder: Path | None
    """Folder of other files with buffers; None if the file must be self-contained."""
    _read: dict[int, bytes] = field(default_factory=dict[int, bytes])

    def get(self, index: int) -> bytes:
        """Return the contents of a buffer."""
        if index not in self._read:
            known = self.document.buffers[index].uri if 0 <= index < len(self.document.buffers) else None
            self._read[index] = self._from(known) if known is not None else self._own(index)
        return self._read[index]

    def _own(self, index: int) -> bytes:
        if index != 0:
            raise FurnitureError(f"buffer {index} lies outside the file; export one self-contained GLB")
        return self.binary

    def _from(self, uri: str) -> bytes:
        if uri.startswith("data:"):
            head, _, text = uri.partition(",")
            if not head.endswith(";base64"):
                raise FurnitureError(f"a buffer begins with {one_line(uri, 40)!r}; expected base64")
            try:
                return base64.b64decode(text, validate=True)
            except (binascii.Error, ValueError) as problem:
                raise FurnitureError(f"a buffer is not base64: {problem}") from None
        if self.folder is None:
            raise FurnitureError(f"its buffer {one_line(uri, 60)!r} is another file; export one self-contained GLB")
        return read_bytes(inside(self.folder, unquote(uri), "it"))


def read_gltf(path: Path, *, each_node: bool = False) -> FileScene:
    """Read each named node with triangles as a part; an unnamed node belongs to its nearest named ancestor.

    Args:
        path: a .glb file, or a .gltf file with its buffers inside it or in the same folder.
        each_node: whether each node with triangles is a part, named or not.

    Raises:
        FurnitureError: the file is not glTF 2, broken, compressed or too large, or its hierarchy has a loop; the
            message names the file.
    """
    binary = path.suffix.lower() != ".gltf"
    what = "GLB" if binary else "glTF"
    try:
        if binary:
            return decode_glb(read_bytes(path), path.parent, each_node=each_node)
        text = decode_json(read_bytes(path), _Document, "its JSON")
        return _scene(text, _Buffers(text, b"", path.parent), each_node, "part")
    except FurnitureError as problem:
        message = str(problem)
        raise FurnitureError(
            message if message.startswith("'") else f"'{path}' cannot be read as {what}: {message}"
        ) from None
    except (ValueError, IndexError, struct.error, OverflowError) as problem:
        raise FurnitureError(f"'{path}' cannot be read as {what}: {one_line(str(problem))}") from None


def decode_glb(data: bytes, folder: Path | None = None, *, each_node: bool = False, default: str = "part") -> FileScene:
    """Return the scene of a GLB file's contents; see `read_gltf`.

    Args:
        data: contents of the file.
        folder: folder of other files with buffers; None if there are none.
        each_node: whether each node with triangles is a part, named or not.
        default: name of parts without one.

    Raises:
        FurnitureError: as `read_gltf`, but the message does not name the file.
        ValueError, IndexError, struct.error, OverflowError: a number in the file does not fit.
    """
    document, binary = _chunks(data)
    return _scene(document, _Buffers(document, binary, folder), each_node, default)


def count_parts(path: Path) -> int:
    """Count the parts that `read_gltf` would return; 0 for a file that cannot be read."""
    try:
        if path.suffix.lower() == ".gltf":
            document = decode_json(read_bytes(path, MAX_TEXT_BYTES), _Document, "its JSON")
        else:
            document, _ = _chunks(read_bytes(path))
        return len({placed.path[-1].number for placed in _walk(document, each_node=False)})
    except (FurnitureError, ValueError, IndexError, struct.error, OverflowError):
        return 0


@np.errstate(over="ignore", invalid="ignore")  # `Triangles` refuses points that overflow
def _scene(document: _Document, buffers: _Buffers, each_node: bool, default: str) -> FileScene:
    unsupported = [name for name in document.required if not name.startswith(_HARMLESS)]
    unsupported += [name for name in document.used if name == _INSTANCING]
    if unsupported:
        raise FurnitureError(f"it requires {one_line(unsupported[0], 60)}; export it without compression or extensions")
    meshes: dict[int, Triangles] = {}
    owned: dict[int, list[Triangles]] = {}
    paths: dict[int, Sequence[Node]] = {}
    total = 0
    for placed in _walk(document, each_node):
        if placed.mesh not in meshes:
            meshes[placed.mesh] = _mesh(document, buffers, placed.mesh)
        total += len(meshes[placed.mesh].faces)
        if total > MAX_FACES:
            raise FurnitureError(f"it has more than {MAX_FACES} faces; simplify it first")
        part = placed.path[-1].number
        owned.setdefault(part, []).append(meshes[placed.mesh].moved(placed.scene_from_node))
        paths[part] = placed.path
    names = part_names(list(paths.values()), default)
    parts = [NamedTriangles(name, combine(pieces)) for name, pieces in zip(names, owned.values(), strict=True)]
    return FileScene(tuple(parts), "y")


def _name(document: _Document, index: int) -> str:
    """Return the name of a node, or else that of its mesh; empty if neither has one."""
    own = document.nodes[index]
    mesh = document.meshes[own.mesh].name if own.mesh is not None else ""
    return given_name(own.name) or given_name(mesh)


def _chunks(data: bytes) -> tuple[_Document, bytes]:
    """Return the decoded JSON chunk and the binary chunk."""
    if len(data) < 20 or data[:4] != b"glTF":
        raise FurnitureError("it does not begin with 'glTF'")
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise FurnitureError(f"it has version {version}; expected version 2")
    if length > len(data):
        raise FurnitureError(f"it ends after {len(data)} of {length} bytes")
    at, document, binary = 12, None, b""
    while at + 8 <= length:
        size, kind = struct.unpack_from("<II", data, at)
        if at + 8 + size > length:
            raise FurnitureError("a chunk ends beyond the file")
        body = data[at + 8 : at + 8 + size]
        if kind == _JSON and document is None:
            document = decode_json(body, _Document, "its JSON")
        elif kind == _BIN and not binary:
            binary = body
        at += 8 + size
    if document is None:
        raise FurnitureError("it has no JSON chunk")
    return document, binary


def _walk(document: _Document, each_node: bool) -> list[_MeshNode]:
    """Return the nodes of the scene that have a mesh, in depth-first order.

    Args:
        document: the document.
        each_node: whether each node with a mesh is a part, named or not.

    Raises:
        FurnitureError: a node is reached twice or missing, or there are too many nodes or levels.
    """
    if document.scenes:
        if not 0 <= document.scene < len(document.scenes):
            raise FurnitureError(f"scene {document.scene} is not there")
        roots = document.scenes[document.scene].nodes
    else:
        below = {child for node in document.nodes for child in node.children}
        roots = [k for k in range(len(document.nodes)) if k not in below]
    if len(document.nodes) > MAX_NODES:
        raise FurnitureError(f"it has {len(document.nodes)} nodes; at most {MAX_NODES} are accepted")
    out: list[_MeshNode] = []
    visited: set[int] = set()
    nobody: tuple[Node, ...] = ()
    stack: list[tuple[int, Float[np.ndarray, "4 4"], tuple[Node, ...], tuple[Node, ...], int]] = [
        (index, np.eye(4), nobody, nobody, 0) for index in reversed(roots)
    ]
    while stack:
        index, above, ancestors, owner, depth = stack.pop()
        if not 0 <= index < len(document.nodes):
            raise FurnitureError(f"node {index} is not there")
        if index in visited:
            raise FurnitureError(f"node {index} is reached twice: the hierarchy loops or shares nodes")
        if depth > MAX_NODE_DEPTH:
            raise FurnitureError(f"its nodes are nested deeper than {MAX_NODE_DEPTH}")
        visited.add(index)
        node = document.nodes[index]
        here = above @ _local(node, index)
        if node.mesh is not None and not 0 <= node.mesh < len(document.meshes):
            raise FurnitureError(f"mesh {node.mesh} is not there")
        path = (*ancestors, Node(index, _name(document, index)))
        owner = path if node.name or not owner or (each_node and node.mesh is not None) else owner
        if node.mesh is not None:
            out.append(_MeshNode(owner, node.mesh, here))
        # An unnamed root owns only itself: its children get names of their own.
        below_owner = owner if document.nodes[owner[-1].number].name else nobody
        stack.extend((child, here, path, below_owner, depth + 1) for child in reversed(node.children))
    return out


def _local(node: _Node, index: int) -> Float[np.ndarray, "4 4"]:
    """Return `parent_from_node`."""
    if node.matrix is not None:
        if len(node.matrix) != 16:
            raise FurnitureError(f"node {index} has a matrix of {len(node.matrix)} numbers; expected 16")
        return np.array(node.matrix, dtype=float).reshape(4, 4).T
    x, y, z, w = node.rotation
    out = np.eye(4)
    try:
        out[:3, :3] = rotation_from_quaternion((w, x, y, z)) * np.array(node.scale)
    except InputError as problem:
        raise FurnitureError(f"node {index}: {problem}") from None
    out[:3, 3] = node.translation
    return out


def _mesh(document: _Document, buffers: _Buffers, index: int) -> Triangles:
    pieces: list[Triangles] = []
    numbers = 0
    for primitive in document.meshes[index].primitives:
        if "POSITION" not in primitive.attributes or primitive.mode < 4:
            continue
        points = _accessor(document, buffers, primitive.attributes["POSITION"], "VEC3").reshape(-1, 3).astype(float)
        if primitive.indices is None:
            order = np.arange(len(points))
        else:
            order = _accessor(document, buffers, primitive.indices, "SCALAR").reshape(-1).astype(np.int64)
        # Many small primitives may refer to the same large lists.
        numbers += len(points) + len(order)
        if numbers > MAX_NUMBERS:
            raise FurnitureError(_TOO_MANY)
        pieces.append(Triangles(points, _faces(order, primitive.mode)))
    return combine(pieces)


def _faces(order: np.ndarray, mode: int) -> np.ndarray:
    if mode == 4:
        if len(order) % 3:
            raise FurnitureError(f"a mesh has {len(order)} corners, which is not a multiple of three")
        return order.reshape(-1, 3)
    if mode not in (5, 6):
        raise FurnitureError(f"primitive mode {mode} is not supported; expected triangles")
    if mode == 6:
        return np.column_stack([np.full(max(len(order) - 2, 0), order[0]), order[1:-1], order[2:]])
    faces = np.column_stack([order[:-2], order[1:-1], order[2:]])
    faces[1::2] = faces[1::2, [1, 0, 2]]
    return faces


def _accessor(document: _Document, buffers: _Buffers, index: int, kind: str) -> np.ndarray:
    if not 0 <= index < len(document.accessors):
        raise FurnitureError(f"accessor {index} is not there")
    accessor = document.accessors[index]
    width = 3 if kind == "VEC3" else 1
    if accessor.type != kind or accessor.component not in _COMPONENTS or accessor.count < 1:
        raise FurnitureError(f"accessor {index} is not a list of {'points' if width == 3 else 'indices'}")
    if accessor.sparse is not None or accessor.view is None:
        raise FurnitureError(f"accessor {index} is sparse or compressed; export plain meshes")
    if not 0 <= accessor.view < len(document.buffer_views):
        raise FurnitureError(f"buffer view {accessor.view} is not there")
    view = document.buffer_views[accessor.view]
    binary = buffers.get(view.buffer)
    item = np.dtype(_COMPONENTS[accessor.component])
    stride = view.stride if view.stride is not None else item.itemsize * width
    start = view.offset + accessor.offset
    end = start + stride * (accessor.count - 1) + item.itemsize * width
    fits = min(view.offset, accessor.offset) >= 0 and stride >= item.itemsize * width
    if not fits or end > min(view.offset + view.length, len(binary)):
        raise FurnitureError(f"accessor {index} reads beyond its buffer")
    if accessor.count > MAX_NUMBERS:
        raise FurnitureError(_TOO_MANY)
    out = np.ndarray((accessor.count, width), item, binary, start, (stride, item.itemsize))
    if accessor.normalized and item.kind in "iu":
        return np.maximum(out / np.iinfo(item).max, -1.0)
    return out
