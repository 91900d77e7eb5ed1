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
from roboassembly.generate.pieces import Build, Piece, as_parts
from roboassembly.generate.solids import Solid, from_triangles, triangles
from roboassembly.geometry.meshes import Mesh

_FEWEST = 3
_TRIES = 20
_OVERLAP = 1e-4
"""Metres by which joined parts reach into each other."""
_LIKE = 0.01
"""Metres between a part's place and its mirror image's; share of the volume that they may differ by."""


def build(bases: Sequence[Build], rng: np.random.Generator | None) -> list[Piece]:
    """Pieces of 3 parts or more, made of one of the bases."""
    rng = np.random.default_rng(1) if rng is None else rng
    for _ in range(_TRIES):
        base = as_parts(bases[int(rng.integers(len(bases)))](rng))
        if len(base) <= _FEWEST:
            continue
        matrix = _stretch(rng)
        parts = [RawPart(p.name, Mesh(p.mesh.vertices @ matrix.T, p.mesh.faces), p.label) for p in base]
        try:
            pieces = _joined(parts, rng)
            find_contacts([Mesh(*triangles(p.solid)) for p in pieces], [p.name for p in pieces])
        except FurnitureError:
            continue  # where parts are stretched, or reach over to what they are joined to, some touch
        return pieces
    raise FurnitureError(f"nothing came of {_TRIES} tries to join parts; another seed would do")


def _stretch(rng: np.random.Generator) -> Float[np.ndarray, "3 3"]:
    """Another width, depth and height, and sometimes a lean."""
    matrix = np.diag(np.exp(rng.uniform(-0.3, 0.3, 3)))
    if rng.random() < 0.3:
        matrix = np.array([[1, 0, 0], [0, 1, rng.uniform(-0.25, 0.25)], [0, 0, 1]]) @ matrix
    return matrix


def _joined(parts: Sequence[RawPart], rng: np.random.Generator) -> list[Piece]:
    contacts = find_contacts([p.mesh for p in parts], [p.name for p in parts])
    group = _groups(parts, contacts, rng)
    solids = [from_triangles(p.mesh.vertices, p.mesh.faces) for p in parts]
    out: list[Piece] = []
    for name in dict.fromkeys(group):
        members = [i for i, g in enumerate(group) if g == name]
        whole = Solid()
        for i in members:
            whole += solids[i]
        for c in contacts:
            if group[c.a] == group[c.b] == name:
                # Closes the gap between the two, so that no face is left inside.
                whole += solids[c.a].translate(tuple(((c.gap + _OVERLAP) * c.normal).tolist()))
        largest = max(members, key=lambda i: parts[i].mesh.volume)
        out.append(Piece(f"part_{len(out):02d}", parts[largest].label, whole))
    return out


def _groups(parts: Sequence[RawPart], contacts: Sequence[Contact], rng: np.random.Generator) -> list[int]:
    """The group of each part."""
    group = list(range(len(parts)))
    touching = {frozenset((c.a, c.b)) for c in contacts}
    mates = _mates(parts) if rng.random() < 0.8 else list(range(len(parts)))
    wanted = int(rng.integers(_FEWEST, len(parts)))
    while len(set(group)) > wanted:
        size = [group.count(g) for g in group]
        left = [(c.a, c.b) for c in contacts if group[c.a] != group[c.b]]
        if not left:
            break
        # Small groups rather than one that swallows all the others.
        weight = np.array([1.0 / (size[a] * size[b]) for a, b in left])
        a, b = left[rng.choice(len(left), p=weight / weight.sum())]
        for one, two in ((a, b), (mates[a], mates[b])):
            if frozenset((one, two)) in touching and group[one] != group[two] and len(set(group)) > _FEWEST:
                old, new = group[one], group[two]
                group = [new if g == old else g for g in group]
        if len(set(group)) <= _FEWEST:
            break
    return group


def _mates(parts: Sequence[RawPart]) -> list[int]:
    """For each part the one that stands where its mirror image would, itself in the middle or where there is none."""
    centres = np.array([p.mesh.center_of_mass for p in parts])
    volumes = np.array([p.mesh.volume for p in parts])
    out = []
    for i, centre in enumerate(centres):
        apart = np.linalg.norm(centres - centre * [-1.0, 1.0, 1.0], axis=1)
        like = (apart < _LIKE) & (np.abs(volumes - volumes[i]) < _LIKE * volumes[i])
        out.append(int(np.argmax(like)) if like.any() else i)
    return out
