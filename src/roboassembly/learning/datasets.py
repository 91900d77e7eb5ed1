"""Training samples: labelled states of one piece of furniture, one npz file a piece.

The oracle labels states with the pairs of points that fit, an expert with its Q-values; both policies learn from the
same files.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Float16, Float32, Int, Int16

from roboassembly.errors import InputError
from roboassembly.furniture.model import Furniture
from roboassembly.furniture.part_order import is_optional
from roboassembly.learning import archive
from roboassembly.task.part_frames import FramesName
from roboassembly.task.rules.connections import GRASPS

FORMAT = 4
"""Version of the files."""
CLOUD_POINTS = 2048
"""Points of each part's cloud: enough to show tenons and holes."""
_REMEDY = "remove it and build it again"


@dataclass(frozen=True, eq=False)
class LabeledState:
    """One state of a piece of furniture with P parts, and its labels."""

    points: Float32[np.ndarray, "P K 9"]
    """Connection points, as in the observation."""
    connections: Float32[np.ndarray, "P P 6"]
    """Relative poses of joined parts, as in the observation."""
    free: Bool[np.ndarray, "P K"]
    """Whether each point exists and is free."""
    poses: Float32[np.ndarray, "P 6"]
    """World pose of each part, as in the observation."""
    mates: Int16[np.ndarray, "j 11"]
    """Ordered pairs that fit: u, k, v, l, whether the furniture can be finished afterwards, and for each of the six
    `w` whether the merge works."""
    q_values: Float16[np.ndarray, "n n w"] | None = None
    """An expert's Q-values over the n free points, in the order of parts and points: one for each `w`, or what each
    `g_a` and then what each `g_b` adds. Neither bounded nor masked. None where the oracle labelled the state."""
    own_w: Bool[np.ndarray, "j 6"] | None = None
    """Whether the merge of each of the pairs works where `w` names an axis of `SampleSet.principal` of v's part. None
    where the labels know aligned frames only."""

    @property
    def group(self) -> Int[np.ndarray, "P"]:
        """Group of each part, as the number of the group's first part."""
        return group_labels(self.connections)


@dataclass(frozen=True, eq=False)
class Structure:
    """Which parts touch, which are equal, and which such furniture may lack."""

    connections: Int[np.ndarray, "c 4"]
    """Part and point of one end of each connection, part and point of the other."""
    classes: Int[np.ndarray, "P"]
    """Number of each part's shape class."""
    labels: tuple[str, ...]
    """Label of each part."""
    optional: Bool[np.ndarray, "P"]
    """Whether furniture of this kind may lack the part."""


def structure_of(furniture: Furniture) -> Structure:
    """Return the structure of a piece of furniture."""
    connections = [(c.part_a, c.point_a, c.part_b, c.point_b) for c in furniture.connections]
    labels = tuple(part.label for part in furniture.parts)
    optional = np.array([is_optional(label) for label in labels], bool)
    return Structure(np.array(connections, int).reshape(-1, 4), np.array(furniture.class_of, int), labels, optional)


@dataclass(frozen=True, eq=False)
class SampleSet:
    """The labelled states of one piece of furniture."""

    name: str
    """Name of the furniture."""
    clouds: Float32[np.ndarray, "P C 3"]
    """Surface points of each part in its frame [m]."""
    samples: tuple[LabeledState, ...]
    grasps: Float32[np.ndarray, "P 8 6"] | None = None
    """Gripper pose of each grasp in the part's frame, as in the observation; None in the object-centric setting."""
    structure: Structure | None = None
    """Structure of the furniture; None if it is not known."""
    principal: Float32[np.ndarray, "P 3 3"] | None = None
    """`part_from_principal` of each part (`part_frames.principal_frames`); None if samples have no `own_w`."""
    resampled: Float32[np.ndarray, "P C 3"] | None = None
    """Clouds of the same surfaces with other points for each part [m]; None if samples have no `own_w`."""
    frames: FramesName = "aligned"
    """Frames in which parts are described; files hold aligned ones."""

    def save(self, path: Path) -> None:
        """Write as npz, whole or not at all; clouds as 16-bit integers, 1/65,000 of the largest exact."""
        samples = self.samples
        mates = [sample.mates for sample in samples]
        values = [sample.q_values for sample in samples if sample.q_values is not None]
        arrays = {
            "format": np.array(FORMAT),
            "name": np.array(self.name),
            **_stored("clouds", self.clouds),
            "grasps": np.zeros((0, GRASPS, 6), np.float32) if self.grasps is None else self.grasps,
            **self._structure_arrays(),
            "points": np.array([sample.points for sample in samples]),
            "connections": np.array([sample.connections for sample in samples]),
            "free": np.array([sample.free for sample in samples]),
            "poses": np.array([sample.poses for sample in samples]),
            "has_q_values": np.array([sample.q_values is not None for sample in samples], bool),
            "q_values": np.concatenate([v.ravel() for v in values]) if values else np.zeros(0, np.float16),
            "q_width": np.array(max((v.shape[2] for v in values), default=0)),
            "mates": np.concatenate(mates) if mates else np.zeros((0, 11), np.int16),
            "sample_of_mate": np.repeat(np.arange(len(samples)), [len(m) for m in mates]),
            **self._own_arrays(),
        }
        archive.write(path, arrays)

    def _own_arrays(self) -> dict[str, np.ndarray]:
        if self.principal is None or self.resampled is None:
            return {}
        own_w = [sample.own_w for sample in self.samples if sample.own_w is not None]
        return {
            "principal": self.principal,
            **_stored("resampled", self.resampled),
            "own_w": np.concatenate(own_w) if own_w else np.zeros((0, 6), bool),
        }

    def _structure_arrays(self) -> dict[str, np.ndarray]:
        if self.structure is None:
            return {}
        return {
            "structure_connections": self.structure.connections,
            "structure_classes": self.structure.classes,
            "structure_labels": np.array(self.structure.labels),
            "structure_optional": self.structure.optional,
        }

    @staticmethod
    def load(path: Path) -> SampleSet:
        """Read what `save` wrote.

        Raises:
            InputError: the file is broken, or of another format.
        """
        with archive.reading(path, "a file of training samples", _REMEDY) as z:
            check_format(path, z, FORMAT)
            mates, sample_of_mate = z["mates"], z["sample_of_mate"]
            points, connections, free, poses = z["points"], z["connections"], z["free"], z["poses"]
            has_q_values, width = z["has_q_values"], int(z["q_width"])
            shapes = [(n, n, width) for n in free.sum(axis=(1, 2)) * has_q_values] if len(free) else []
            own_w = z.get("own_w")
            principal = z.get("principal")
            resampled = _restored("resampled", z) if "resampled" in z else None
            ends = np.cumsum([np.prod(shape) for shape in shapes], dtype=int)
            values = [v.reshape(s) for v, s in zip(np.split(z["q_values"], ends)[:-1], shapes, strict=True)]
            samples = tuple(
                LabeledState(
                    points[i], connections[i], free[i], poses[i], mates[sample_of_mate == i],
                    values[i] if has_q_values[i] else None, None if own_w is None else own_w[sample_of_mate == i],
                )
                for i in range(len(points))
            )  # fmt: skip
            grasps = z["grasps"] if len(z["grasps"]) else None
            structure = None
            if "structure_labels" in z:
                labels = tuple(str(label) for label in z["structure_labels"])
                connections, classes = z["structure_connections"], z["structure_classes"]
                structure = Structure(connections, classes, labels, z["structure_optional"])
            clouds = _restored("clouds", z)
            return SampleSet(str(z["name"]), clouds, samples, grasps, structure, principal, resampled)


def _stored(name: str, clouds: Float32[np.ndarray, "P C 3"]) -> dict[str, np.ndarray]:
    """Return the arrays that a file holds of clouds: integers and their unit."""
    largest = float(np.abs(clouds).max(initial=0.0))
    unit = largest / np.iinfo(np.int16).max if largest else 1.0
    return {name: np.rint(clouds / unit).astype(np.int16), f"{name}.unit": np.array(unit)}


def _restored(name: str, arrays: archive.Arrays) -> Float32[np.ndarray, "P C 3"]:
    """Return the clouds of `_stored`."""
    return (arrays[name] * float(arrays[f"{name}.unit"])).astype(np.float32)


def check_format(path: Path, arrays: archive.Arrays, expected: int) -> None:
    """Check the version of a sample file.

    Raises:
        InputError: an earlier or later version of this program wrote it.
    """
    found = int(arrays["format"]) if "format" in arrays else 1
    if found != expected:
        raise InputError(f"'{path}' has format {found}, this program reads {expected}; {_REMEDY}")


def dataset_file(folder: Path, name: str) -> Path:
    """Return where a folder keeps the file of a piece of furniture."""
    return folder / f"{name.replace(':', '_')}.npz"


def load_samples(folder: Path, names: Sequence[str]) -> list[SampleSet]:
    """Load the samples of some furniture; pieces without samples are left out.

    Raises:
        InputError: a file is broken.
    """
    return [loaded for name in names if (loaded := SampleSet.load(dataset_file(folder, name))).samples]


def files_hash(files: Sequence[Path]) -> str:
    """Return a hash of the names and contents of some files."""
    digest = hashlib.sha256()
    for path in files:
        digest.update(path.name.encode())
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()[:16]


def group_labels(connections: Float[np.ndarray, "P P 6"]) -> Int[np.ndarray, "P"]:
    """Return the group of each part, as the number of its first part: joined parts have a relative pose."""
    joined = (connections != 0).any(axis=2) | np.eye(len(connections), dtype=bool)
    return np.argmax(joined, axis=1)
