"""Furniture on disk: a folder with `furniture.json` and one mesh file per distinct part.

A folder is written completely or not at all, and its content is checked when read. Version 1:

    furniture.json   see `document.Document`; poses are (x, y, z, qw, qx, qy, qz), metres, z up
    meshes/*.ply     binary PLY, in the part's frame (origin at its centre of mass)
"""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

import msgspec

from roboassembly.errors import FurnitureError, InputError
from roboassembly.furniture.document import FORMAT, VERSION, Document, Header, from_document, to_document
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.meshes import Mesh

_LONGEST_NAME = 255
"""Largest length of a file name in common file systems [bytes]."""
FILE_NAME = "furniture.json"
MESHES = "meshes"


def save(furniture: Furniture, folder: Path | str) -> Path:
    """Write `furniture` to `folder`, replacing only existing furniture; return the folder.

    Raises:
        InputError: `folder` exists and holds something other than furniture, or cannot be written.
    """
    return _put(Path(folder), lambda scratch: _write(furniture, scratch))


def read_files(folder: Path) -> dict[str, bytes]:
    """Return the files of a furniture folder by their relative paths; raises `OSError` if one is missing."""
    paths = [folder / FILE_NAME, *sorted((folder / MESHES).iterdir())]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def files_hash(folder: Path) -> str:
    """Return a hash of the files of a furniture folder, which is quicker than loading it.

    Raises:
        InputError: the files cannot be read.
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
    """Write the files of a furniture folder as `save` does; return the folder.

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
    """Replace a folder by another one; the old one stays if that fails."""
    old = new.with_name(f"{new.name}-old")
    folder.rename(old)
    try:
        new.rename(folder)
    except OSError:
        old.rename(folder)
        raise
    # Other files in the folder belong to the user.
    for entry in [e for e in old.iterdir() if e.name not in (FILE_NAME, MESHES)]:
        entry.rename(folder / entry.name)
    shutil.rmtree(old)


def _may_replace(folder: Path) -> bool:
    if not folder.is_dir():
        return False
    return (folder / FILE_NAME).is_file() or not any(folder.iterdir())


def _write(furniture: Furniture, folder: Path) -> None:
    (folder / MESHES).mkdir()
    files: dict[Mesh, str] = {}
    for part in (*furniture.parts, *furniture.fasteners):
        if part.mesh not in files:
            path = f"{MESHES}/{len(files):02d}.ply"
            part.mesh.trimesh.export(folder / path, encoding="binary", vertex_normal=False)
            files[part.mesh] = path
    document = to_document(furniture, files)
    (folder / FILE_NAME).write_bytes(msgspec.json.format(msgspec.json.encode(document), indent=1) + b"\n")


def load(folder: Path | str) -> Furniture:
    """Read and check a furniture folder.

    Raises:
        FurnitureError: the folder, its JSON or a mesh is missing or broken, a number is not finite, a direction is
            not a unit vector, parts penetrate, or any rule of `Furniture` is broken. The message says where.
    """
    folder = Path(folder)
    return from_document(_read_document(folder), lambda name, where: _read_mesh(folder, name, where), folder)


def _read_document(folder: Path) -> Document:
    if not folder.is_dir():
        raise FurnitureError(f"no furniture folder at {folder}; expected a folder with {FILE_NAME}")
    path = folder / FILE_NAME
    if not path.is_file():
        raise FurnitureError(f"{folder} has no {FILE_NAME}; save or import furniture there first")
    try:
        text = path.read_bytes()
        header = msgspec.json.decode(text, type=Header)
        if header.format != FORMAT:
            raise FurnitureError(f"{path}: format is '{header.format}'; '{FORMAT}' is expected")
        if header.version != VERSION:
            raise FurnitureError(f"{path}: version {header.version} is not known; this program reads version {VERSION}")
        return msgspec.json.decode(text, type=Document)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise FurnitureError(f"{path} is not valid: {error}") from None
    except OSError as error:
        raise FurnitureError(f"{path} cannot be read: {error.strerror}") from None


def _read_mesh(folder: Path, name: str, where: str) -> Mesh:
    import trimesh  # takes 0.3 s, and not every user of this module reads meshes

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
        # trimesh's reader fails on broken headers in many ways, unbound names among them.
        raise FurnitureError(f"{where}: mesh {path} cannot be read as PLY: {error}") from None
    try:
        mesh = Mesh.from_trimesh(loaded)
        _ = mesh.hull
    except FurnitureError as error:
        raise FurnitureError(f"{where}: {error}") from None
    return mesh
