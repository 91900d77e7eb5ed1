"""Structures to learn from, or to measure on, that are made of what other families build.

`fused` parts are assemblies themselves: a side frame, a back, a pair of legs in one piece. Real furniture comes like
that: bent tubes, welded frames, backs that were glued in the factory. Such a part touches another one in several places
at once. Here neighbouring parts are joined at random, mostly the same on the left as on the right, and the whole is
stretched and made to lean first, which keeps straight ways straight. A few pieces lock themselves: one part then holds
another from both sides. They give no samples to learn from.

`sunk` parts have been through the repair of imported files. Files of real furniture overlap at nearly every joint, by
anything from a hair to the depth of a tenon, and repair cuts pockets for that: too shallow to be seen in a cloud of
points, deep enough to hold a part fast. Here parts are driven into their neighbours, and repaired.

`overlapping` parts have been through the same repair, from files that were drawn for their looks. There, parts lean and
run into each other by centimetres and at a slant. What repair cuts then is deep, and some orders of assembly lock a
part out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from roboassembly.errors import FurnitureError
from roboassembly.furniture.contacts import Contact, find_contacts
from roboassembly.furniture.model import RawPart
from roboassembly.generate.design import Blank, Build, PartDesign, as_parts
from roboassembly.generate.solids import Solid, from_triangles, triangles
from roboassembly.geometry.meshes import Mesh

TRIES = 20
FEWEST_PARTS = 3
OVERLAP = 1e-4  # length by which fused parts reach into each other [m]
MIRROR_TOLERANCE = 0.01
"""Distance [m] between a part's place and its mirror image's, and share of the volume by which they may differ."""
SUNK = (0.0003, 0.012)  # bounds of the depth to which a sunk part is driven into another [m]
OVERLAPPING = (0.003, 0.05)  # bounds of the depth to which an overlapping part is driven into another [m]
SLANT = float(np.tan(np.deg2rad(35.0)))  # largest length along the surface by which it is driven, per depth
LEAN = 0.35  # largest shear of a piece with overlapping parts
VOLUME_TOLERANCE = 0.02  # share of the volume that two parts may differ by to be driven in alike
OPENINGS = 8  # effort of the repair; furniture that needs more takes minutes

Change = Callable[[Sequence[RawPart], np.random.Generator], list[PartDesign]]


def remade(change: Change, bases: Sequence[Build], rng: np.random.Generator | None) -> list[PartDesign]:
    """Return what one of the bases builds, changed; without a generator always the same."""
    rng = np.random.default_rng(1) if rng is None else rng
    for _ in range(TRIES):
        try:
            return change(as_parts(bases[int(rng.integers(len(bases)))](rng)), rng)
        except FurnitureError:
            continue
    raise FurnitureError(f"{TRIES} tries to change another family's parts failed; try another seed")


def fused(base: Sequence[RawPart], rng: np.random.Generator) -> list[PartDesign]:
    """Return 3 parts or more, each joined from parts of the base.

    Raises:
        FurnitureError: the base has too few parts, or parts that are stretched or joined touch others.
    """
    if len(base) <= FEWEST_PARTS:
        raise FurnitureError("too few parts to join any")
    matrix = np.diag(np.exp(rng.uniform(-0.3, 0.3, 3)))
    if rng.random() < 0.3:
        matrix = np.array([[1, 0, 0], [0, 1, rng.uniform(-0.25, 0.25)], [0, 0, 1]]) @ matrix
    parts = [replace(p, mesh=p.mesh.stretched(matrix)) for p in base]
    contacts = find_contacts([p.mesh for p in parts], [p.name for p in parts])
    group = _groups(parts, contacts, rng)
    solids = [from_triangles(p.mesh.vertices, p.mesh.faces) for p in parts]
    joined: list[PartDesign] = []
    for name in dict.fromkeys(group):
        members = [i for i, g in enumerate(group) if g == name]
        whole = Blank(Solid())
        for i in members:
            whole += solids[i]
        for c in contacts:
            if group[c.a] == group[c.b] == name:
                # Closes the gap between the two, so that no face is left inside.
                whole += solids[c.a].translate(tuple((c.gap + OVERLAP) * c.normal))
        largest = max(members, key=lambda i: parts[i].mesh.volume)
        joined.append(PartDesign(f"part_{len(joined):02d}", parts[largest].label, whole))
    find_contacts([Mesh(*triangles(p.blank.solid)) for p in joined], [p.name for p in joined])
    return joined


def _groups(parts: Sequence[RawPart], contacts: Sequence[Contact], rng: np.random.Generator) -> list[int]:
    """Return the group of each part."""
    group = list(range(len(parts)))
    touching = {frozenset((c.a, c.b)) for c in contacts}
    images = _mirror_images(parts) if rng.random() < 0.8 else list(range(len(parts)))
    count = int(rng.integers(FEWEST_PARTS, len(parts)))
    while len(set(group)) > max(count, FEWEST_PARTS):
        size = [group.count(g) for g in group]
        left = [(c.a, c.b) for c in contacts if group[c.a] != group[c.b]]
        if not left:
            break
        # Small groups rather than one that swallows all the others.
        weight = np.array([1.0 / (size[a] * size[b]) for a, b in left])
        a, b = left[rng.choice(len(left), p=weight / weight.sum())]
        for i, j in ((a, b), (images[a], images[b])):
            if frozenset((i, j)) in touching and group[i] != group[j] and len(set(group)) > FEWEST_PARTS:
                group = [group[j] if g == group[i] else g for g in group]
    return group


def _mirror_images(parts: Sequence[RawPart]) -> list[int]:
    """Return for each part the one at the place of its mirror image; itself in the middle or if there is none."""
    centres = np.array([p.mesh.center_of_mass for p in parts])
    volumes = np.array([p.mesh.volume for p in parts])
    out: list[int] = []
    for i, centre in enumerate(centres):
        near = np.linalg.norm(centres - centre * [-1.0, 1.0, 1.0], axis=1) < MIRROR_TOLERANCE
        like = near & (np.abs(volumes - volumes[i]) < MIRROR_TOLERANCE * volumes[i])
        out.append(int(np.argmax(like)) if like.any() else i)
    return out


def sunk(parts: Sequence[RawPart], rng: np.random.Generator) -> list[PartDesign]:
    """Return the parts, each lengthened into some of those that it touches, and repaired.

    Raises:
        FurnitureError: repair refuses the overlaps.
    """
    contacts = find_contacts([p.mesh for p in parts], [p.name for p in parts])
    share = rng.choice([0.3, 0.7, 1.0])
    depth = _depth(SUNK, rng)
    chosen: dict[tuple[int, int], bool] = {}
    moves: list[tuple[int, Float[np.ndarray, "3"]]] = []
    for c in contacts:
        # Contacts between parts of the same sizes are all chosen, or none is.
        if not chosen.setdefault(_sizes(parts, c), bool(rng.random() < share)):
            continue
        # The lesser one is driven in, as a rail into a post.
        lesser, inward = (c.a, c.normal) if parts[c.a].mesh.volume <= parts[c.b].mesh.volume else (c.b, -c.normal)
        moves.append((lesser, (c.gap + depth) * inward))
    return _driven(parts, moves)


def overlapping(parts: Sequence[RawPart], rng: np.random.Generator) -> list[PartDesign]:
    """Return the parts, made to lean, each driven deep into most of those that it touches, and repaired.

    Raises:
        FurnitureError: parts that lean touch others, or repair refuses the overlaps.
    """
    lean = np.eye(3)
    if rng.random() < 0.5:
        lean[0, 2], lean[1, 2], lean[0, 1] = LEAN * rng.uniform(-1, 1, 3) * [0.5, 1.0, 0.5]
    parts = [replace(p, mesh=p.mesh.stretched(lean)) for p in parts]
    contacts = find_contacts([p.mesh for p in parts], [p.name for p in parts])
    angle = rng.uniform(0.0, 2.0 * np.pi)
    # Left and right are driven in alike.
    aside = SLANT * np.array([0.0, np.cos(angle), np.sin(angle)]) * (rng.random() < 0.5)
    chosen: dict[tuple[int, int], tuple[float, float, bool]] = {}
    moves: list[tuple[int, Float[np.ndarray, "3"]]] = []
    for c in contacts:
        # Contacts between parts of the same sizes overlap alike. A fifth do not.
        depth = _depth(OVERLAPPING, rng) * float(rng.random() < 0.8)
        drawn = depth, rng.uniform(0.0, 1.0), bool(rng.random() < 0.7)
        depth, slant, is_lesser = chosen.setdefault(_sizes(parts, c), drawn)
        if not depth:
            continue
        is_a = (parts[c.a].mesh.volume <= parts[c.b].mesh.volume) == is_lesser
        driven, inward = (c.a, c.normal) if is_a else (c.b, -c.normal)
        moves.append((driven, (c.gap + depth) * (inward + slant * (aside - (aside @ inward) * inward))))
    return _driven(parts, moves, shortening=OVERLAPPING[1])


def _depth(bounds: tuple[float, float], rng: np.random.Generator) -> float:
    """Return a random depth [m]; shallow is as frequent as deep."""
    return float(np.exp(rng.uniform(float(np.log(bounds[0])), float(np.log(bounds[1])))))


def _sizes(parts: Sequence[RawPart], contact: Contact) -> tuple[int, int]:
    """Return the classes of volume of the two parts of a contact."""
    a, b = sorted(round(float(np.log(parts[i].mesh.volume)) / VOLUME_TOLERANCE) for i in (contact.a, contact.b))
    return a, b


def _driven(
    parts: Sequence[RawPart], moves: Sequence[tuple[int, Float[np.ndarray, "3"]]], shortening: float | None = None
) -> list[PartDesign]:
    """Return the parts, each joined with itself moved as `moves` says for its number, and repaired.

    Args:
        parts: the parts.
        moves: number of a part and translation [m], any number of times for each part.
        shortening: see `RepairLimits`; None for its default.
    """
    from roboassembly.repair import RepairLimits, repair  # which no other family needs

    solids = [from_triangles(p.mesh.vertices, p.mesh.faces) for p in parts]
    whole = list(solids)
    for i, move in moves:
        whole[i] += solids[i].translate(tuple(move))
    lengthened = [replace(p, mesh=Mesh(*triangles(s))) for p, s in zip(parts, whole, strict=True)]
    limits = RepairLimits(openings=OPENINGS)
    if shortening is not None:
        limits = replace(limits, shortening=shortening)
    repaired = repair(lengthened, limits=limits, with_remedies=False).parts
    return [PartDesign(p.name, p.label, Blank(from_triangles(p.mesh.vertices, p.mesh.faces))) for p in repaired]
