"""Data sets: named lists of furniture with splits, reproducible from the family and the seed of each piece.

Seeds of different sets are far apart, so that the test pieces of one are in the training of none.

The manifest of a set is a JSON file in the cache folder (`$ROBOASSEMBLY_CACHE`, or the default of the system). The
furniture is generated when it is used, and checked against the hash in the manifest.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from roboassembly.datasets import catalogue
from roboassembly.errors import InputError, UnknownNameError
from roboassembly.furniture import storage
from roboassembly.furniture.cache import cache_folder
from roboassembly.furniture.model import Furniture

VERSION = 8
EASY, HARD, TEST = "easy", "hard", "test"
SPLITS: dict[str, Callable[[Entry], bool]] = {
    "train": lambda entry: entry.split in (EASY, HARD),
    EASY: lambda entry: entry.split == EASY,
    HARD: lambda entry: entry.split == HARD,
    TEST: lambda entry: entry.split == TEST,
    "all": lambda _: True,
    "train-by-version": lambda entry: entry.trains_by_version is True,
    "test-by-version": lambda entry: entry.trains_by_version is False,
}
"""Splits by name, and whether a piece belongs to them. The last two exist for sets with versions only: they divide the
versions, so that most test pieces have near relatives in training."""


class Entry(msgspec.Struct, frozen=True):
    """Piece of a data set."""

    family: str
    seed: int
    version: int
    """0 for the source piece itself, else the number of a near relative of it; see `generate`."""
    split: str
    """`easy`, `hard` or `test`; all versions of a source piece are in training, or all in `test`."""
    trains_by_version: bool | None
    """Whether the piece is for training if the versions are divided instead; None in sets without versions."""
    unseen: bool
    """Whether training has no piece of this family."""
    parts: int
    difficulty: float
    """Share of random orders of correct merges, each with its best `w`, that fail; of the source piece."""
    dead_end: bool
    """Whether a random order of feasible correct merges ended in a state without a feasible correct merge; of the
    source piece."""
    planning_steps: int
    """Planning steps of the search that certified the piece as solvable."""
    hash: str
    """Hash of the parts' meshes and slots."""

    @property
    def name(self) -> str:
        """Name of the piece for `roboassembly assemble`."""
        return catalogue.piece_name(self.family, self.seed, self.version)


class Manifest(msgspec.Struct, frozen=True):
    """Contents of a data set."""

    name: str
    version: int
    seed: int
    entries: tuple[Entry, ...]


@dataclass(frozen=True)
class Recipe:
    """Recipe of a data set."""

    name: str
    description: str
    train: int
    """Number of source pieces for training; the easier half of the training pieces is `easy`, the other half `hard`."""
    test_seen: int
    """Number of source pieces for testing, of families that occur in training."""
    test_unseen: int
    """Number of source pieces for testing, of the other families."""
    first_seed: int
    """Least seed of the pieces; those of two sets are at least 10,000 apart, so that they have no piece in common."""
    unseen_families: tuple[str, ...] = ()
    versions: int = 1
    """Number of versions of each source piece, itself included. With more than one, sources are divided at random."""


_UNSEEN = ("rocker", "splat", "garden", "folding")
RECIPES = {
    recipe.name: recipe
    for recipe in (
        Recipe(
            "chairs-412",
            "generated chairs in the paper's numbers, 220 to train on; 60 of the 192 to test on are of other families",
            220,
            132,
            60,
            1,
            _UNSEEN,
        ),
        Recipe(
            "chairs-880",
            "four versions each of 220 generated chairs, divided as in the paper: 688 to train on, 192 to test on",
            172,
            48,
            0,
            20_001,
            versions=4,
        ),
        Recipe(
            "chairs-24",
            "a few of the kind of chairs-412, to try things with: 12 to train on, 12 to test on",
            12,
            8,
            4,
            10_001,
            _UNSEEN,
        ),
    )
}


def manifest_path(name: str) -> Path:
    """Return the path of a set's manifest, which exists if the set is built.

    Raises:
        UnknownNameError: the set does not exist.
    """
    if name not in RECIPES:
        raise UnknownNameError("data set", name, RECIPES)
    return cache_folder() / f"{name}.json"


def load_manifest(name: str) -> Manifest:
    """Read a built set's manifest.

    Raises:
        UnknownNameError: the set does not exist.
        InputError: the set is not built, has another version, or is broken.
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
        entry: entry of a data set.
        with_grasps: see `annotate`.

    Raises:
        InputError: the furniture differs from the one of the data set.
    """
    furniture = catalogue.make(entry.family, entry.seed, entry.version, with_grasps=with_grasps)
    if furniture_hash(furniture) != entry.hash:
        raise InputError(f"{entry.name} is no longer what its data set was built from; build the set again")
    return furniture


def furniture_hash(furniture: Furniture) -> str:
    """Return a hash of the parts and their slots, which are rounded to 0.01 mm."""
    digest = hashlib.sha256()
    for part, slot in zip(furniture.parts, furniture.assembled, strict=True):
        digest.update(part.name.encode())
        digest.update(part.mesh.content_hash.encode())
        digest.update(str((slot.translation * 1e5).round().astype(int).tolist()).encode())
    return digest.hexdigest()[:16]


@dataclass(frozen=True)
class FurnitureRef:
    """Reference to a piece of a set; each worker process makes or loads the furniture itself."""

    name: str
    """Name of the piece in reports."""
    entry: Entry | None
    folder: Path | None

    def furniture(self, *, with_grasps: bool = True) -> Furniture:
        """Generate or load the furniture; generated furniture has grasps only if `with_grasps`."""
        if self.entry is not None:
            return make_entry(self.entry, with_grasps=with_grasps)
        assert self.folder is not None
        return storage.load(self.folder)

    @property
    def argument(self) -> str:
        """Name or folder by which `catalogue.find` and the environments take the piece."""
        return self.name if self.folder is None else str(self.folder)

    @property
    def source(self) -> str | None:
        """Name of the piece that this one is a version of; None if it is no version."""
        if self.entry is None or self.entry.version == 0:
            return None
        return catalogue.piece_name(self.entry.family, self.entry.seed)

    @property
    def hash(self) -> str:
        """Hash from the manifest, or of the files of the folder."""
        if self.entry is not None:
            return self.entry.hash
        assert self.folder is not None
        return storage.files_hash(self.folder)


def furniture_refs(spec: str) -> list[FurnitureRef]:
    """Return references to the pieces of `NAME`, `NAME:SPLIT` or `folder:PATH`.

    Raises:
        UnknownNameError: the set or the split does not exist.
        InputError: the set is not built, has no such pieces, or the folder contains no furniture.
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
    refs = [FurnitureRef(e.name, e, None) for e in load_manifest(name).entries if SPLITS[split](e)]
    if not refs:
        raise InputError(f"data set '{name}' has no versions of its pieces to divide; use {name}:train and {name}:test")
    return refs


def sample_refs(refs: Sequence[FurnitureRef], count: int | None, seed: int) -> list[FurnitureRef]:
    """Return `count` random references in random order, or all if there are fewer; None keeps all in order."""
    if count is None:
        return list(refs)
    order = np.random.default_rng(seed).permutation(len(refs))
    return [refs[i] for i in order[:count]]


def set_hash(refs: Sequence[FurnitureRef]) -> str:
    """Return a short hash of the furniture of a set."""
    digest = hashlib.sha256()
    for ref in refs:
        digest.update(f"{ref.name} {ref.hash}\n".encode())
    return digest.hexdigest()[:16]
