"""Furniture to practise on whose parts are assemblies themselves: a side frame, a back, a pair of legs in one piece.

Real furniture comes like that: bent tubes, welded frames, backs that were glued in the factory. Such a part touches
another one in several places at once. Here neighbouring parts of what another family made are joined at random, mostly
the same on the left as on the right, and the whole is stretched and made to lean first: what can be taken apart along
straight lines still can be afterwards.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from roboassembly.errors import FurnitureError
from roboassembly.furniture.contacts import Contact, find_contacts
from roboassembly.furniture.model import RawPart
from roboassembly.generate.design import Blank, Build, PartDesign, as_parts
from roboassembly.generate.solids import Solid, from_triangles, triangles
from roboassembly.geometry.meshes import Mesh

FEWEST_PARTS = 3
TRIES = 20
OVERLAP = 1e-4
"""Length by which joined parts reach into each other [m]."""
MIRROR_TOLERANCE = 0.01
"""Distance [m] between a part's place and its mirror image's, and share of the volume by which they may differ."""


def build(bases: Sequence[Build], rng: np.random.Generator | None) -> list[PartDesign]:
    """Return 3 parts or more, made of what one of the bases builds."""
    rng = np.random.default_rng(1) if rng is None else rng
    for _ in range(TRIES):
        base = as_parts(bases[int(rng.integers(len(bases)))](rng))
        if len(base) <= FEWEST_PARTS:
            continue
        matrix = _stretch(rng)
        parts = [RawPart(p.name, Mesh(p.mesh.vertices @ matrix.T, p.mesh.faces), p.label) for p in base]
        try:
            joined = _joined(parts, rng)
            find_contacts([Mesh(*triangles(p.blank.solid)) for p in joined], [p.name for p in joined])
        except FurnitureError:
            continue  # where parts are stretched, or reach over to what they are joined to, some touch
        return joined
    raise FurnitureError(f"{TRIES} tries to join parts failed; try another seed")


def _stretch(rng: np.random.Generator) -> Float[np.ndarray, "3 3"]:
    """Return a matrix that changes width, depth and height, and sometimes makes the whole lean."""
    matrix = np.diag(np.exp(rng.uniform(-0.3, 0.3, 3)))
    if rng.random() < 0.3:
        matrix = np.array([[1, 0, 0], [0, 1, rng.uniform(-0.25, 0.25)], [0, 0, 1]]) @ matrix
    return matrix


def _joined(parts: Sequence[RawPart], rng: np.random.Generator) -> list[PartDesign]:
    """Return one part for each group of parts."""
    contacts = find_contacts([p.mesh for p in parts], [p.name for p in parts])
    group = _groups(parts, contacts, rng)
    solids = [from_triangles(p.mesh.vertices, p.mesh.faces) for p in parts]
    out: list[PartDesign] = []
    for name in dict.fromkeys(group):
        members = [i for i, g in enumerate(group) if g == name]
        whole = Solid()
        for i in members:
            whole += solids[i]
        for c in contacts:
            if group[c.a] == group[c.b] == name:
                # Closes the gap between the two, so that no face is left inside.
                whole += solids[c.a].translate(tuple((c.gap + OVERLAP) * c.normal))
        largest = max(members, key=lambda i: parts[i].mesh.volume)
        out.append(PartDesign(f"part_{len(out):02d}", parts[largest].label, Blank(whole)))
    return out


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
