"""Declarations of families: a design's sizes with the ranges they are drawn from, and the assembly it builds.

    @family("stool", "turned legs, stretchers between all four, seat on top")
    class Stool(Design):
        seat: float = size(0.38, 0.34, 0.42)  # default, low, high [m]
        rows: int = count(1, 1, 2)

        def build(self, a: Assembly) -> None: ...

The defaults are the catalogue model. Values are drawn in the order of the declarations.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from types import SimpleNamespace
from typing import Any, ClassVar, Literal, Self, TypeVar, dataclass_transform

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.model import RawPart
from roboassembly.generate.joints import Tenon, Tongue, mouths, rail
from roboassembly.generate.solids import Solid, mirrored_x, triangles
from roboassembly.generate.vectors import Vector, X, spin
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3, transform_points

T = TypeVar("T")
D = TypeVar("D", bound="Design")
Kind = Literal["chair", "table", "shelf", "abstract"]
"""Kind of furniture that a family makes."""
IN_PLACE = SE3.Identity()
"""Pose of a part that was cut where it belongs."""


class Blank:
    """Shape that equal parts are cut from; joints may be added as long as the assembly is being built.

    A blank that gets its body later (`Blank()`, then `blank.body = ...`) is cut when everything else has been added.
    """

    def __init__(self, body: Solid | None = None) -> None:
        self.body = Solid() if body is None else body
        self._waiting: list[Solid] | None = [] if body is None else None

    @property
    def solid(self) -> Solid:
        """The finished shape."""
        while self._waiting:
            self.body -= self._waiting.pop(0)
        return self.body

    def __iadd__(self, solid: Solid) -> Self:
        self.body += solid
        return self

    def __isub__(self, solid: Solid) -> Self:
        if self._waiting is None:
            self.body -= solid
        else:
            self._waiting.append(solid)
        return self


@dataclass(frozen=True, eq=False)
class PartDesign:
    """One part: a blank and its place. Parts that are interchangeable have the same blank."""

    name: str
    label: str
    """PartNet's word for it."""
    blank: Blank
    pose: SE3 = IN_PLACE
    """`furniture_from_blank`."""
    mirrored: bool = False
    """Whether the part is the blank's mirror image across the plane x = 0."""


class Assembly:
    """Parts of one piece of furniture, in a frame with the floor at z = 0, while they are being designed."""

    def __init__(self) -> None:
        self.parts: list[PartDesign] = []
        self._alike: dict[Hashable, Blank] = {}

    def alike(self, key: Hashable, solid: Solid) -> Blank:
        """Return the blank of the first solid with this key, so that parts of one key are interchangeable."""
        return self._alike.setdefault(key, Blank(solid))

    def lean(self, rotation: Float[np.ndarray, "3 3"]) -> None:
        """Rotate the whole about the origin."""
        pose = SE3(rotation, np.zeros(3))
        self.parts = [replace(part, pose=pose * part.pose) for part in self.parts]

    def part(self, name: str, label: str, shape: Solid | Blank, pose: SE3 = IN_PLACE, mirrored: bool = False) -> Blank:
        """Add a part, and return its blank."""
        blank = shape if isinstance(shape, Blank) else Blank(shape)
        self.parts.append(PartDesign(name, label, blank, pose, mirrored))
        return blank

    def each(self, name: str, label: str, blank: Blank, places: Mapping[str, SE3] | Sequence[SE3]) -> list[SE3]:
        """Add equal parts, named by the keys of their places or numbered from 1; return the places."""
        named = places if isinstance(places, Mapping) else {f"{k + 1}": place for k, place in enumerate(places)}
        for key, place in named.items():
            self.part(f"{name}_{key}", label, blank, place)
        return list(named.values())

    def pair(self, name: str, label: str, shape: Solid | Blank, first: str = "right") -> Blank:
        """Add a part cut on the `first` side (left or right) and its mirror image on the other."""
        blank = self.part(f"{name}_{first}", label, shape)
        return self.part(f"{name}_{'left' if first == 'right' else 'right'}", label, blank, mirrored=True)

    def cross(
        self, name: str, label: str, at: Vector, half: float, up: Vector, section: tuple[float, float], tenon: Tenon,
        side: Blank, chamfer: float = 0.003,
    ) -> Blank:  # fmt: skip
        """Add a rail along x between mirrored sides, whose inner faces are `half` from its middle `at`.

        `section` has its height along `up` and its thickness. The left-hand `side` gets the mortise.
        """
        start, end = at - half * X, at + half * X
        side -= tenon.pocket(mouths(start, end, up)[1])
        return self.part(name, label, rail(start, end, up, *section, tenon, chamfer))

    def join(
        self,
        joint: Tongue,
        frame: SE3,
        tongue: Blank,
        pocket: Blank,
        at: Sequence[SE3] = (IN_PLACE,),
        over: float = 0.002,
    ) -> None:
        """Make both halves of a joint: add the tongue to one blank, take the pocket from the other.

        `at` has the places of the parts with the tongue, `frame` is in their blank's frame; the pocket sticks out of
        its mouth by `over`.
        """
        tongue += joint.tongue(frame)
        self.pockets(joint, frame, pocket, at, over)

    def pockets(
        self, joint: Tongue, frame: SE3, pocket: Blank, at: Sequence[SE3] = (IN_PLACE,), over: float = 0.002
    ) -> None:
        """Make one half of a joint, whose other half the parts at these places already have."""
        for place in at:
            pocket -= joint.pocket(place * frame, over)

    def join_sides(self, joint: Tongue, frame: SE3, tongue: Blank, pocket: Blank) -> None:
        """Make both halves of a joint at the left, and the tongue of its mirror image into the mirrored part."""
        added = joint.tongue(frame)
        tongue += added + mirrored_x(added)
        pocket -= joint.pocket(frame)


def corners(x: float, y: float, alike: bool) -> list[tuple[str, SE3, bool]]:
    """Return name, place and whether mirrored of the four legs cut as the one at (-x, -y).

    `alike`: the leg looks the same along x and along y, so that quarter turns take it to all corners.
    """
    places = (("front_right", -x, -y, 0), ("back_left", x, y, 2), ("front_left", x, -y, 1), ("back_right", -x, y, 3))
    if alike:
        return [(name, spin(quarter * np.pi / 2, at, to), False) for name, at, to, quarter in places]
    return [(name, spin(quarter // 2 * np.pi, at, to), quarter % 2 == 1) for name, at, to, quarter in places]


def size(default: float, low: float, high: float) -> float:
    """Declare a length [m], an angle [rad] or a ratio that is drawn evenly from a range."""
    return drawn(default, lambda rng, _: rng.uniform(low, high))


def count(default: int, low: int, high: int) -> int:
    """Declare a number of parts, drawn from `low` to `high`."""
    return drawn(default, lambda rng, _: int(rng.integers(low, high + 1)))


def chance(default: bool, share: float = 0.5) -> bool:
    """Declare a feature that a share of the furniture has."""
    return drawn(default, lambda rng, _: bool(rng.random() < share))


def one_of(*choices: T, default: T | None = None) -> T:
    """Declare a value drawn from a list; a repeated value is more frequent, the first is the default."""
    return drawn(choices[0] if default is None else default, lambda rng, _: choices[rng.integers(len(choices))])


def drawn(default: T, draw: Callable[[np.random.Generator, Any], T]) -> T:
    """Declare a value drawn by a function of the generator and of the values drawn before."""
    return field(default=default, metadata={"draw": draw})


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(size, count, chance, one_of, drawn))
@dataclass(frozen=True)
class Design:
    """Base of all families: sizes in metres and angles in radians, and how parts are built from them."""

    family: ClassVar[Family]
    first_drawn: ClassVar[tuple[str, ...]] = ()
    """Values that are drawn before those declared above them."""

    def __init_subclass__(cls) -> None:
        dataclass(frozen=True, kw_only=True)(cls)

    @classmethod
    def sample(cls, rng: np.random.Generator) -> Self:
        """Draw a design that fits together."""
        while True:
            values = SimpleNamespace()
            for declared in sorted(fields(cls), key=lambda f: f.name not in cls.first_drawn):
                draw = declared.metadata.get("draw")
                setattr(values, declared.name, draw(rng, values) if draw else declared.default)
            design = cls(**vars(values))
            if design.fits():
                return design

    def varied(self, rng: np.random.Generator, share: float = 0.1) -> Self:
        """Return a design of the same parts whose sizes differ by up to a share each.

        Counts, features and choices stay. The share is halved whenever many designs in a row do not fit together, or
        have other parts because a number of parts follows from a size.
        """
        names = [part.name for part in self.parts()]
        sizes = {f.name: getattr(self, f.name) for f in fields(self) if "draw" in f.metadata}
        sizes = {name: value for name, value in sizes.items() if isinstance(value, float)}
        while True:
            for _ in range(_VARIATIONS):
                factors = rng.uniform(1.0 - share, 1.0 + share, len(sizes))
                design = replace(self, **{n: v * f for (n, v), f in zip(sizes.items(), factors.tolist(), strict=True)})
                if design.fits() and [part.name for part in design.parts()] == names:
                    return design
            share /= 2.0

    def fits(self) -> bool:
        """Return whether the sizes go together; another design is drawn if not."""
        return True

    def build(self, a: Assembly) -> None:
        """Build all parts."""
        raise NotImplementedError

    def parts(self) -> list[PartDesign]:
        """Return all parts."""
        assembly = Assembly()
        self.build(assembly)
        return assembly.parts


Build = Callable[[np.random.Generator | None], Sequence[PartDesign]]
"""Function that designs parts; without a generator, those of the catalogue model."""
_VARIATIONS = 20
"""Number of variations of a design that are drawn before they have to be smaller."""


@dataclass(frozen=True)
class Family:
    """Structure of furniture: every seed is a size and style of it; seed 0 is the catalogue model."""

    name: str
    description: str
    build: Build
    kind: Kind = "chair"
    design: type[Design] | None = None
    """Declaration of the family; None if its pieces are made from those of others."""


def family(name: str, description: str, kind: Kind = "chair") -> Callable[[type[D]], type[D]]:
    """Name a design, and describe it in one line."""

    def declare(design: type[D]) -> type[D]:
        def build(rng: np.random.Generator | None) -> Sequence[PartDesign]:
            return (design() if rng is None else design.sample(rng)).parts()

        design.family = Family(name, description, build, kind, design)
        return design

    return declare


def as_parts(parts: Sequence[PartDesign]) -> tuple[RawPart, ...]:
    """Mesh every blank once and place the parts, feet at z = 0, centred in x and y."""
    meshes = {
        (p.blank, p.mirrored): triangles(mirrored_x(p.blank.solid) if p.mirrored else p.blank.solid) for p in parts
    }
    vertices = [transform_points(p.pose, meshes[p.blank, p.mirrored][0]) for p in parts]
    everything = np.concatenate(vertices)
    low, high = everything.min(axis=0), everything.max(axis=0)
    shift = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    return tuple(
        RawPart(p.name, Mesh(v - shift, meshes[p.blank, p.mirrored][1]), p.label)
        for p, v in zip(parts, vertices, strict=True)
    )
