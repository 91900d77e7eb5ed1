"""Fasteners of generated furniture: screws or dowels along the axis of a joint, through one part into the other.

They are found from the contacts of the finished parts, so they take no part in the random draws of a family: with or
without them, the parts have the same shapes but for holes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.contacts import Contact, find_contacts
from roboassembly.furniture.model import Fastener, FastenerKind, RawFastener, RawPart
from roboassembly.furniture.rays import Rays
from roboassembly.generate.solids import Solid, triangles, turned
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3, align_axis
from roboassembly.repair.drilling import drill

_THICKEST = 0.055
"""Thickness of a part up to which a fastener goes through it [m]."""
_BITE = 0.030
"""Length by which it goes into the other part, at least [m]."""
_LONGEST = 0.120
_WALL = 0.006
"""Wood around a fastener, at least [m]."""
_RADII: dict[FastenerKind, float] = {"dowel": 0.0035, "screw": 0.0022, "cam": 0.0}
_HEAD_RADIUS, _HEAD_LENGTH = 0.0042, 0.003
_FREE = 0.15
"""Length in front of a fastener that no other part may stand in [m]."""
_SIDES = 12


def fasten(parts: Sequence[RawPart], seed: int) -> tuple[tuple[RawPart, ...], tuple[Fastener, ...]]:
    """Return finished parts with holes, and the fasteners that go into them: all screws or all dowels, by the seed.

    Args:
        parts: of the finished piece, in the furniture's frame.
        seed: decides on the kind.
    """
    kind: FastenerKind = "screw" if np.random.default_rng([seed, 77]).random() < 0.5 else "dowel"
    meshes = [part.mesh for part in parts]
    rays = [Rays(mesh) for mesh in meshes]
    raw: list[RawFastener] = []
    axes: list[tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]] = []
    for contact in find_contacts(meshes, [part.name for part in parts]):
        found = _line(contact, rays, _RADII[kind])
        if found is None or any(_near(found, other) for other in axes):
            continue
        axes.append(found)
        start, end = found
        names = "_".join(parts[p].name for p in (contact.a, contact.b))
        place = SE3(align_axis(np.array([0.0, 0.0, 1.0]), (end - start) / np.linalg.norm(end - start)), start)
        raw.append(RawFastener(f"{kind}_{names}", kind, _shape(kind, float(np.linalg.norm(end - start)), place)))
    return drill(parts, raw)


def _shape(kind: FastenerKind, length: float, place: SE3) -> Mesh:
    radius = _RADII[kind]
    profile = [(0.0, radius), (length, radius)]
    if kind == "screw":
        profile = [(0.0, _HEAD_RADIUS), (_HEAD_LENGTH, _HEAD_RADIUS), (_HEAD_LENGTH + 1e-4, radius), (length, radius)]
    body: Solid = turned(profile, _SIDES)
    return Mesh(*triangles(body.transform(np.column_stack([place.rotation, place.translation]))))


def _line(
    contact: Contact, rays: Sequence[Rays], radius: float
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]] | None:
    """Return where a fastener of a joint begins and ends; None if neither part is thin enough, or it meets a third."""
    for first, second, inward in ((contact.a, contact.b, contact.normal), (contact.b, contact.a, -contact.normal)):
        side = np.linalg.svd(inward[None])[2][1:]
        around = [np.zeros(3), *(s * (radius + _WALL) * v for v in side for s in (1.0, -1.0))]
        outer = [_outer(rays[first], contact.center + shift, -inward) for shift in around]
        inner = [_outer(rays[second], contact.center + shift, inward) for shift in around]
        through, left = max(outer), min(inner)
        if not 0.008 < min(outer) <= through < _THICKEST or through - min(outer) > 0.003 or left < _BITE:
            continue
        length = min(through + min(left - 0.004, 1.2 * _BITE), _LONGEST)
        # From the highest point around the axis: a head must not lie under the surface of a round part.
        start = contact.center - through * inward
        end = start + length * inward
        others = [other for k, other in enumerate(rays) if k not in (first, second)]
        ahead, inside = start - 0.001 * inward + np.array(around), (start + 0.001 * inward)[None]
        if all(_is_free(o, ahead, -inward, _FREE) and _is_free(o, inside, inward, length) for o in others):
            return start, end
    return None


def _is_free(rays: Rays, starts: Float[np.ndarray, "n 3"], direction: Float[np.ndarray, "3"], length: float) -> bool:
    """Return whether a part leaves some lines of a length free; it does not if one begins inside it."""
    distance, normals = rays.first_hits(starts, np.tile(direction, (len(starts), 1)))
    return bool((distance >= length).all() and (normals @ direction <= 0.0).all())


def _outer(rays: Rays, start: Float[np.ndarray, "3"], direction: Float[np.ndarray, "3"]) -> float:
    """Return how far a part reaches along a direction, to its farthest surface; 0 without one [m]."""
    reach: list[float] = []
    here = np.array(start, dtype=float)
    for _ in range(8):
        (distance,), _ = rays.first_hits(here[None], np.asarray(direction)[None])
        if not np.isfinite(distance):
            break
        reach.append(float((here + distance * direction - start) @ direction))
        here = here + (distance + 1e-5) * direction
    return max(reach, default=0.0)


def _near(
    a: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]], b: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]
) -> bool:
    """Return whether two fasteners come so close that their holes would meet."""
    t = np.linspace(0.0, 1.0, 25)[:, None]
    p, q = (s + t * (e - s) for s, e in (a, b))
    return float(np.linalg.norm(p[:, None] - q[None], axis=2).min()) < 0.012
