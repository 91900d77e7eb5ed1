"""Holes for fasteners: what stands in the way of a dowel, a screw or a cam lock as it goes in is taken from the parts.

A hole is the fastener's profile grown by `GAP`, and as wide at every height as the fastener is farther in, so that it
comes out straight. Parts that lie within `REACH` of a fastener are those that it joins.
"""

from __future__ import annotations

from collections.abc import Sequence

import manifold3d as m3
import numpy as np

from roboassembly.errors import FurnitureError
from roboassembly.furniture.fasteners import Profile, has_head, meshes_in_frames, profile_of
from roboassembly.furniture.model import Fastener, RawFastener, RawPart
from roboassembly.geometry.meshes import Mesh, nearest_points
from roboassembly.geometry.poses import SE3
from roboassembly.repair.surface import clean, to_manifold, to_surface

GAP = 0.0002
"""Distance between a fastener and the wall of its hole [m]."""
REACH = 0.001
"""Distance up to which a part counts as joined by a fastener [m]."""
_SEGMENTS = 24
"""Number of sides of a round hole."""
_SPLINTER = 0.01
"""Share of a part's volume below which a piece that a hole cuts off is dropped."""


def drill(parts: Sequence[RawPart], raw: Sequence[RawFastener]) -> tuple[tuple[RawPart, ...], tuple[Fastener, ...]]:
    """Return the parts with holes for all fasteners, and the fasteners with what they join.

    Args:
        parts: solid parts in the furniture's frame.
        raw: fasteners in the furniture's frame.

    Raises:
        FurnitureError: a fastener touches no part, or its hole cuts a part in two.
    """
    solids: dict[int, m3.Manifold] = {}
    out: list[Fastener] = []
    for fastener, (mesh, place) in zip(raw, meshes_in_frames(raw), strict=True):
        placed = mesh.transformed(place)
        joined = [index for index, part in enumerate(parts) if _touches(part.mesh, placed)]
        if not joined:
            raise FurnitureError(
                f"fastener '{fastener.name}' touches no part within {1e3 * REACH:g} mm; move it to the parts that it "
                "joins, or leave it out",
                (fastener.name,),
            )
        hole = _hole(profile_of(mesh), place)
        for index in joined:
            before = solids[index] if index in solids else _solid(parts[index])
            solids[index] = _without(before, hole, parts[index].name, fastener.name)
        out.append(Fastener(fastener.name, fastener.kind, mesh, place, tuple(joined)))
    drilled: list[RawPart] = []
    for index, part in enumerate(parts):
        if index not in solids:
            drilled.append(part)
            continue
        skin = to_surface(solids[index])
        drilled.append(RawPart(part.name, Mesh(skin.vertices, skin.faces), part.label))
    return tuple(drilled), tuple(out)


def _touches(part: Mesh, fastener: Mesh) -> bool:
    low, high = fastener.bounds
    if (part.bounds[0] > high + REACH).any() or (part.bounds[1] < low - REACH).any():
        return False
    return nearest_points(part, fastener).distance < REACH or part.contains(fastener.vertices[0])


def _solid(part: RawPart) -> m3.Manifold:
    body = to_manifold(clean(part.mesh.vertices, part.mesh.faces)[0])
    if body is None:
        raise FurnitureError(f"part '{part.name}' is not solid, so that no hole can be drilled into it", (part.name,))
    return body


def _without(body: m3.Manifold, hole: m3.Manifold, part: str, fastener: str) -> m3.Manifold:
    left = body - hole
    pieces = [piece for piece in left.decompose() if piece.volume() > _SPLINTER * body.volume()]
    if len(pieces) != 1:
        raise FurnitureError(
            f"the hole for fastener '{fastener}' cuts part '{part}' into {len(pieces)} pieces", (part, fastener)
        )
    return pieces[0]


def _hole(profile: Profile, place: SE3) -> m3.Manifold:
    """Return the solid to take from parts, in the furniture's frame."""
    radii = np.maximum.accumulate(profile.radii[::-1])[::-1] if has_head(profile) else np.full_like(
        profile.radii, profile.radii.max()
    )  # fmt: skip
    radii = (radii + GAP) / np.cos(np.pi / _SEGMENTS)
    low, high = profile.heights[0] - GAP, profile.heights[1:] + GAP
    outline = [(0.0, low), (float(radii[0]), low)]
    for k, radius in enumerate(radii.tolist()):
        if k and radius < outline[-1][0]:
            outline.append((radius, outline[-1][1]))
        outline.append((radius, float(high[k])))
    outline.append((0.0, float(high[-1])))
    section = m3.CrossSection([np.array(outline)])
    turned = m3.Manifold.revolve(section, _SEGMENTS)
    return turned.transform(np.column_stack([place.rotation, place.translation]))
