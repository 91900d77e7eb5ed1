"""Data sets: named lists of furniture with splits, each entry reproducible from its family and seed.

A manifest is a JSON file in the user's cache folder (`$ROBOASSEMBLY_CACHE`, else the system's place for caches). The
furniture itself is generated when it is asked for, and checked against the manifest's hash.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from roboassembly.datasets import catalogue
from roboassembly.errors import InputError, UnknownNameError
from roboassembly.furniture import storage
from roboassembly.furniture.cache import cache_folder
from roboassembly.furniture.model import Furniture

VERSION = 5
EASY, HARD, TEST = "easy", "hard", "test"
SPLITS = {"train": (EASY, HARD), EASY: (EASY,), HARD: (HARD,), TEST: (TEST,), "all": (EASY, HARD, TEST)}
"""What may follow a set's name after a colon."""


class Entry(msgspec.Struct, frozen=True):
    """One piece of a data set."""

    family: str
    seed: int
    split: str
    """`easy`, `hard` or `test`."""
    unseen: bool
    """Of a family that does not occur in training."""
    parts: int
    difficulty: float
    """Share of random orders of right merges, each with its best `w`, that fail."""
    dead_end: bool
    """Some random order of feasible right merges ended where no right merge is feasible any more."""
    planning_steps: int
    """What search spent to certify it."""
    hash: str
    """Of the parts' meshes and slots."""

    @property
    def name(self) -> str:
        """As `roboassembly assemble` takes it."""
        return f"{self.family}:{self.seed}"


class Manifest(msgspec.Struct, frozen=True):
    """A data set."""

    name: str
    version: int
    seed: int
    entries: tuple[Entry, ...]


@dataclass(frozen=True)
class Recipe:
    """How a data set is made."""

    name: str
    description: str
    train: int
    """Pieces in training, the easier half `easy`, the other `hard`."""
    test_seen: int
    """Test pieces of training families."""
    test_unseen: int
    """Test pieces of families that training never shows."""
    unseen_families: tuple[str, ...]


_UNSEEN = ("rocker", "splat", "garden", "folding")
RECIPES = {
    recipe.name: recipe
    for recipe in (
        Recipe(
            "chairs-412",
            "generated chairs in the paper's numbers: 220 to train on, 192 to test on",
            220,
            132,
            60,
            _UNSEEN,
        ),
        Recipe(
            "chairs-24", "a few of the same kind, to try things with: 12 to train on, 12 to test on", 12, 8, 4, _UNSEEN
        ),
    )
}


def manifest_path(name: str) -> Path:
    """Where the manifest of a named set is, or would be.

    Raises:
        UnknownNameError: no such set.
    """
    if name not in RECIPES:
        raise UnknownNameError("data set", name, RECIPES)
    return cache_folder() / f"{name}.json"


def load_manifest(name: str) -> Manifest:
    """Read a built set's manifest.

    Raises:
        UnknownNameError: no such set.
        InputError: it is not built yet, of another version, or broken.
    """
    path = manifest_path(name)
    if not path.is_file():
        raise InputError(f"data set '{name}' is not built yet; run: roboassembly dataset build {name}")
    try:
        manifest = msgspec.json.decode(path.read_bytes(), type=Manifest)
    except msgspec.DecodeError as error:
        raise InputError(f"{path} is not valid: {error}; build the set again") from None
    if manifest.version != VERSION:
        raise InputError(f"{path} has version {manifest.version}, this program reads {VERSION}; build the set again")
    return manifest


def make_entry(entry: Entry, *, with_grasps: bool = True) -> Furniture:
    """Generate an entry's furniture.

    Args:
        entry: of a data set.
        with_grasps: as of `annotate`.

    Raises:
        InputError: it does not come out as when the set was built.
    """
    furniture = catalogue.make(entry.family, entry.seed, with_grasps=with_grasps)
    if furniture_hash(furniture) != entry.hash:
        raise InputError(f"{entry.name} is no longer what its data set was built from; build the set again")
    return furniture


def furniture_hash(furniture: Furniture) -> str:
    """Hash of what the parts are and where they go, slots to a hundredth of a millimetre."""
    digest = hashlib.sha256()
    for part, slot in zip(furniture.parts, furniture.assembled, strict=True):
        digest.update(part.name.encode())
        digest.update(part.mesh.content_hash.encode())
        digest.update(str((slot.translation * 1e5).round().astype(int).tolist()).encode())
    return digest.hexdigest()[:16]


@dataclass(frozen=True)
class FurnitureRef:
    """Furniture of a set that is made when asked for, so that workers can make their own."""

    name: str
    """For reports."""
    entry: Entry | None
    folder: Path | None

    def furniture(self, *, with_grasps: bool = True) -> Furniture:
        """Make it, if need be without grasps, or load it."""
        if self.entry is not None:
            return make_entry(self.entry, with_grasps=with_grasps)
        assert self.folder is not None
        return storage.load(self.folder)

    @property
    def hash(self) -> str:
        """Of what it is made of: as the manifest has it, or of the files of its folder."""
        if self.entry is not None:
            return self.entry.hash
        assert self.folder is not None
        return storage.files_hash(self.folder)


def furniture_refs(spec: str) -> list[FurnitureRef]:
    """The pieces of `NAME`, `NAME:SPLIT` or `folder:PATH`.

    Raises:
        UnknownNameError: no such set or split.
        InputError: the set is not built, or the folder holds no furniture.
    """
    name, _, rest = spec.partition(":")
    if name == "folder":
        root = Path(rest)
        folders = (
            [root] if (root / storage.FILE_NAME).is_file() else sorted(p.parent for p in root.glob("*/furniture.json"))
        )
        if not folders:
            raise InputError(f"'{rest}' holds no furniture folders; import some there first")
        return [FurnitureRef(f.name, None, f) for f in folders]
    if name not in RECIPES:
        raise UnknownNameError("data set", name, [*RECIPES, "folder:PATH"])
    split = rest or "all"
    if split not in SPLITS:
        raise UnknownNameError(f"split of {name}", split, SPLITS)
    return [FurnitureRef(e.name, e, None) for e in load_manifest(name).entries if e.split in SPLITS[split]]


def sample_refs(picks: Sequence[FurnitureRef], count: int | None, seed: int) -> list[FurnitureRef]:
    """So many of them, drawn by the seed, in the order drawn; all if there are fewer; all as they are if None."""
    if count is None:
        return list(picks)
    order = np.random.default_rng(seed).permutation(len(picks))
    return [picks[i] for i in order[:count]]


def set_hash(picks: Sequence[FurnitureRef]) -> str:
    """A short digest of the furniture of a set."""
    digest = hashlib.sha256()
    for p in picks:
        digest.update(f"{p.name} {p.hash}\n".encode())
    return digest.hexdigest()[:16]
