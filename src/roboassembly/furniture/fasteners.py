"""Fasteners among the parts of a file: which parts are fasteners, their axes, and which of them are equal."""

from __future__ import annotations

import fnmatch
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np
from jaxtyping import Float, Int

from roboassembly.errors import FurnitureError, InputError
from roboassembly.furniture.model import MIN_PARTS, FastenerKind, RawFastener, RawFurniture, RawPart
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3, align_axis, storable, transform_points

FASTENER_KINDS: tuple[FastenerKind, ...] = get_args(FastenerKind)
_KIND_OF_WORD: dict[str, FastenerKind] = {
    "bolt": "screw", "cam": "cam", "camlock": "cam", "dowel": "dowel", "peg": "dowel", "pin": "dowel", "screw": "screw",
}  # fmt: skip
"""Words in names of fasteners. Names alone make no fastener."""
_SURE = frozenset({"bolt", "cam", "camlock", "dowel", "screw"})
"""Words that name a fastener as the last component of a PartNet label, and of which the import reminds the user."""
_LEVELS = 60
"""Number of heights at which a profile is taken, at most."""
_GRAIN = 1e-4
"""Distance between heights of a profile that count as the same [m]."""
_SAME = 2e-4
"""Largest difference between profiles of equal fasteners [m]."""
_HEAD = 1.1
"""Ratio of radii from which one end of a fastener is its head."""
_END = 0.2
"""Share of a fastener's length that counts as its end."""
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class FastenerPattern:
    """Names of parts that are fasteners."""

    pattern: str
    """Pattern with `*` and `?`; upper and lower case are the same."""
    kind: FastenerKind | None = None
    """Kind; by the words in each name if None."""

    def matches(self, name: str) -> bool:
        """Return whether a part is a fastener by its name."""
        return fnmatch.fnmatchcase(name.lower(), self.pattern.lower())


def parse_pattern(text: str) -> FastenerPattern:
    """Return the pattern of `PATTERN` or `KIND=PATTERN`.

    Raises:
        InputError: the kind is unknown, or the pattern is empty.
    """
    kind, separator, pattern = text.partition("=")
    if not separator:
        kind, pattern = "", text
    known: FastenerKind | None = next((k for k in FASTENER_KINDS if k == kind), None)
    if (separator and known is None) or not pattern:
        raise InputError(
            f"--fastener '{text}' is not PATTERN or KIND=PATTERN with one of {', '.join(FASTENER_KINDS)}, such as "
            "'screw=M6*'"
        )
    return FastenerPattern(pattern, known)


def separate_fasteners(raw: RawFurniture, patterns: Sequence[FastenerPattern] = ()) -> RawFurniture:
    """Return the furniture with fasteners taken out of its parts, and remarks on how many there are.

    Parts are fasteners by the patterns, or by their label in PartNet. Other parts that are named like fasteners stay
    parts, and a remark says how to name them.

    Args:
        raw: as read.
        patterns: names of fasteners.

    Raises:
        FurnitureError: a pattern matches no part, or fewer than two ordinary parts are left.
    """
    kind_of: dict[str, FastenerKind | None] = {part.name: _kind(part, patterns) for part in raw.parts}
    for pattern in patterns:
        if not any(pattern.matches(part.name) for part in raw.parts):
            names = ", ".join(part.name for part in raw.parts[:5]) + ", ..." * (len(raw.parts) > 5)
            raise FurnitureError(f"--fastener '{pattern.pattern}' matches no part; the parts are {names}")
    ordinary = tuple(part for part in raw.parts if kind_of[part.name] is None)
    fasteners: list[RawFastener] = []
    for part in raw.parts:
        kind = kind_of[part.name]
        if kind is not None:
            fasteners.append(RawFastener(part.name, kind, part.mesh))
    if fasteners and len(ordinary) < MIN_PARTS:
        raise FurnitureError(f"{len(fasteners)} of {len(raw.parts)} parts are fasteners; furniture has {MIN_PARTS} or "
                             "more other parts: give a narrower --fastener")  # fmt: skip
    remarks: list[str] = []
    if fasteners:
        remarks.append(f"fasteners: {counted([fastener.kind for fastener in fasteners])}")
    alike = [part.name for part in ordinary if _SURE & set(_words_of(part.name))]
    if alike:
        listed = ", ".join(alike[:3]) + f" and {len(alike) - 3} more" * (len(alike) > 3)
        word = next(word for word in _words_of(alike[0]) if word in _SURE)
        count = "1 part is" if len(alike) == 1 else f"{len(alike)} parts are"
        remarks.append(f"{count} named like fasteners ({listed}) and imported as ordinary parts; "
                       f"if they are fasteners, add --fastener '*{word}*'")  # fmt: skip
    return replace(raw, parts=ordinary, fasteners=tuple(fasteners), remarks=(*raw.remarks, *remarks))


def counted(fastener_kinds: Sequence[FastenerKind]) -> str:
    """Return words for several fasteners, such as `8 dowels, 1 screw`."""
    return ", ".join(f"{n} {kind}{'s' if n > 1 else ''}" for kind, n in sorted(Counter(fastener_kinds).items()))


def _kind(part: RawPart, patterns: Sequence[FastenerPattern]) -> FastenerKind | None:
    for pattern in patterns:
        if pattern.matches(part.name):
            return pattern.kind or _kind_of_words(part.name)
    last = part.label.rpartition("/")[2]
    return _kind_of_words(last) if part.label and _SURE & set(_words_of(last)) else None


def _kind_of_words(name: str) -> FastenerKind:
    for word in _words_of(name):
        if word in _KIND_OF_WORD:
            return _KIND_OF_WORD[word]
    return "dowel"


def _words_of(name: str) -> list[str]:
    return [word.lower() for word in re.findall(r"[A-Za-z][a-z]*", name)]


@dataclass(frozen=True, eq=False)
class Profile:
    """Radius of a fastener along its axis, as a stack of cylinders around it."""

    heights: Float[np.ndarray, "k+1"]
    """Rising borders of the cylinders along z [m]."""
    radii: Float[np.ndarray, "k"]
    """Radius of each cylinder [m]."""

    def near(self, other: Profile) -> bool:
        """Return whether two profiles are equal up to `_SAME`."""
        ends = float(np.abs(self.heights[[0, -1]] - other.heights[[0, -1]]).max()) < _SAME
        grid = np.linspace(float(self.heights[0]) + _SAME, float(self.heights[-1]) - _SAME, 4 * _LEVELS)
        mine, its = self._radii_at(grid), other._radii_at(grid)
        # Heights of steps may differ by rounding: a few samples beside a step do not count.
        return ends and float((np.abs(mine - its) < _SAME).mean()) > 0.95

    def _radii_at(self, heights: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        index: Int[np.ndarray, "n"] = np.searchsorted(self.heights, heights) - 1
        return self.radii[index.clip(0, len(self.radii) - 1)]


def revolved(profile: Profile, sides: int = 24) -> Mesh:
    """Return the body of revolution around a profile: all that the fastener covers while it turns about its axis."""
    radii = profile.radii / np.cos(np.pi / sides)
    radius, height = np.repeat(radii, 2)[:, None], np.repeat(profile.heights, 2)[1:-1, None]
    around = np.linspace(0.0, 2.0 * np.pi, sides, endpoint=False)
    points = np.stack(np.broadcast_arrays(radius * np.cos(around), radius * np.sin(around), height), axis=-1)
    ends = [[0.0, 0.0, profile.heights[0]], [0.0, 0.0, profile.heights[-1]]]
    here, there = np.arange(sides), (np.arange(sides) + 1) % sides
    last = (len(radius) - 1) * sides
    faces = [np.column_stack([np.full(sides, len(radius) * sides), there, here])]
    for row in range(0, last, sides):
        faces.append(np.column_stack([row + here, row + there, row + sides + there]))
        faces.append(np.column_stack([row + here, row + sides + there, row + sides + here]))
    faces.append(np.column_stack([np.full(sides, len(radius) * sides + 1), last + here, last + there]))
    return Mesh(np.concatenate([points.reshape(-1, 3), ends]), np.concatenate(faces))


def profile_of(mesh: Mesh) -> Profile:
    """Return the profile of a mesh about the z axis of its frame."""
    z = mesh.vertices[:, 2]
    low_end, high_end = float(z.min()), float(z.max())
    heights = np.asarray(np.unique(np.round(z / _GRAIN)) * _GRAIN, dtype=float)
    if len(heights) > _LEVELS:
        heights = np.linspace(low_end, high_end, _LEVELS + 1)
    heights[0], heights[-1] = low_end, high_end
    radius = np.linalg.norm(mesh.vertices[:, :2], axis=1)[mesh.faces].max(axis=1)
    low, high = z[mesh.faces].min(axis=1) + _GRAIN, z[mesh.faces].max(axis=1) - _GRAIN
    over = np.asarray((low[None] < heights[1:, None]) & (high[None] > heights[:-1, None]), dtype=bool)
    return Profile(heights, np.where(over, radius[None], 0.0).max(axis=1))


def own_frame(mesh: Mesh) -> SE3:
    """Return the frame of a fastener: origin at its centre of mass, z along its axis from the head to the tip.

    The axis is that of its three main axes about which it is most nearly round; the longest one of a cube. Without a
    head, z points to the side of the largest of its coordinates.

    Args:
        mesh: fastener in the furniture's frame.
    """
    inertia, axes = np.linalg.eigh(mesh.inertia)
    unlike: Float[np.ndarray, "3"] = np.abs(np.roll(inertia, -1) - np.roll(inertia, -2)) / inertia[2]
    axis = axes[:, int(np.argmin(unlike.round(3)))]
    axis = axis * np.sign(axis[int(np.argmax(np.abs(axis).round(6)))])
    for sense in (1.0, -1.0):
        frame = storable(SE3(align_axis(_UP, sense * axis), mesh.center_of_mass))
        profile = profile_of(mesh.transformed(frame.inverse()))
        ends = _end_radii(profile)
        if ends[0] > _HEAD * ends[1]:
            return frame
    return storable(SE3(align_axis(_UP, axis), mesh.center_of_mass))


def has_head(profile: Profile) -> bool:
    """Return whether the end at which z begins is the thicker one, so that there is one way in only."""
    first, last = _end_radii(profile)
    return first > _HEAD * last


def _end_radii(profile: Profile) -> tuple[float, float]:
    """Return the largest radii at both ends [m]."""
    low, high = profile.heights[0], profile.heights[-1]
    reach = _END * (high - low)
    first = profile.radii[profile.heights[:-1] < low + reach].max()
    last = profile.radii[profile.heights[1:] > high - reach].max()
    return float(first), float(last)


def meshes_in_frames(raw: Sequence[RawFastener]) -> list[tuple[Mesh, SE3]]:
    """Return mesh and place of each fastener, in its own frame; equal ones of a kind share the mesh of the first."""
    known: list[tuple[FastenerKind, Profile, Mesh]] = []
    out: list[tuple[Mesh, SE3]] = []
    for fastener in raw:
        frame = own_frame(fastener.mesh)
        own = Mesh(transform_points(frame.inverse(), fastener.mesh.vertices), fastener.mesh.faces)
        profile = profile_of(own)
        mesh = next((m for kind, p, m in known if kind == fastener.kind and p.near(profile)), None)
        if mesh is None:
            known.append((fastener.kind, profile, own))
        out.append((mesh or own, frame))
    return out
