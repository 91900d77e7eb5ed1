"""Report of an import: one HTML page with each part before and after repair, without a server or a network."""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from roboassembly.errors import FurnitureError
from roboassembly.furniture.model import CONTACT_DISTANCE, Furniture, RawFurniture
from roboassembly.geometry.poses import transform_points
from roboassembly.importers.findings import Finding, why_not_held
from roboassembly.importers.pipeline import Imported
from roboassembly.rendering.gl import RenderingUnavailableError
from roboassembly.repair import PartRepair
from roboassembly.repair.insertion import box_axes, extents
from roboassembly.viewer.import_pictures import CHANGED, HEIGHT, WIDTH, ImportPictures, take_delivered, take_pictures

MOST_NUMBERS = 60
"""Largest number of connections that are numbered in the picture; more would hide it."""
_RADIUS = 9.0
"""Radius of a connection's number in the picture [pixels]."""
_PUSHES = 200
_STYLE = """
:root { color-scheme: light; }
body { margin: 0 auto; max-width: 70rem; padding: 1rem; color: #24292f; background: #fff;
  font: 15px/1.5 system-ui, sans-serif; }
h1 { font-size: 1.6rem; margin: 0.5rem 0 0; } h2 { font-size: 1.2rem; margin: 2rem 0 0.5rem; }
p { margin: 0.3rem 0; } .quiet { color: #57606a; }
ol.look { padding: 0.7rem 0.9rem 0.7rem 2.2rem; background: #fff8e6; border: 1px solid #e8d9a8; border-radius: 0.4rem; }
ol.look li.more { color: #57606a; }
.whole { display: grid; grid-template-columns: repeat(auto-fit, minmax(19rem, 1fr)); gap: 0.8rem; }
figure { margin: 0; position: relative; } figcaption { color: #57606a; font-size: 0.85rem; }
img, figure svg { display: block; width: 100%; height: auto; border-radius: 0.3rem; }
figure svg { position: absolute; top: 0; left: 0; }
svg polyline { fill: none; stroke: #b3261e; stroke-width: 1.5; }
svg circle { fill: #fff; stroke: #b3261e; stroke-width: 1.5; }
svg text { font: 600 11px system-ui, sans-serif; fill: #b3261e; text-anchor: middle; dominant-baseline: central; }
.part { display: grid; grid-template-columns: minmax(8rem, 12rem) minmax(8rem, 12rem) 1fr; gap: 0.8rem;
  padding: 0.8rem 0; border-top: 1px solid #d8dee4; }
.part h3 { margin: 0; font-size: 1rem; overflow-wrap: anywhere; } .part ul { margin: 0.2rem 0; padding-left: 1.1rem; }
.swatch { display: inline-block; width: 0.8em; height: 0.8em; border-radius: 0.2em; margin-right: 0.3em; }
.bad { color: #b3261e; } .scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: 0.9rem; } td, th { padding: 0.2rem 0.8rem 0.2rem 0; text-align: left; }
td.number { text-align: right; font-variant-numeric: tabular-nums; } tr { border-bottom: 1px solid #eaeef2; }
@media (max-width: 40rem) { .part { grid-template-columns: 1fr 1fr; } .part div.text { grid-column: 1 / 3; } }
"""
_EXPLAINED = f"""Grey: as delivered. Wood: after repair. Orange: surfaces of the part after repair that lie more than
{1e3 * CHANGED:g} mm off the delivered surface: sockets, cuts and closed holes. Where parts touched, each joint has a
gap of 0.2 mm, which is too small to be orange."""


def import_report(name: str, source: Path, raw: RawFurniture, imported: Imported, found: Sequence[Finding]) -> str:
    """Return the page: what is worth a look, pictures, each part with its changes, connections, what cannot be held.

    Without off-screen rendering, the page has no pictures and says so.

    Args:
        name: name of the piece.
        source: path that it was read from.
        raw: parts as read.
        imported: furniture after repair, and the repairs.
        found: findings, the most important first.
    """
    furniture, repairs = imported.furniture, imported.repairs
    pictures, lacking = None, ""
    try:
        pictures = take_pictures(raw.parts, furniture, repairs)
    except RenderingUnavailableError as error:
        lacking = _without_pictures(error)
    body = [
        f"<h1>{_text(name)}</h1>",
        _origin(raw, source),
        "<h2>Worth a look</h2>",
        _look(found),
        lacking,
        _whole(furniture, pictures) if pictures else "",
        "<h2>Parts</h2>",
        f"<p class='quiet'>{_EXPLAINED}</p>",
        *(_part(index, raw, furniture, repair, pictures) for index, repair in enumerate(repairs)),
        f"<h2>{len(furniture.connections)} connections</h2>",
        _connections(furniture),
        "<h2>What a robot's hand cannot hold</h2>",
        _unholdable(furniture),
    ]
    return _page(name, body)


def refusal_report(name: str, source: Path, raw: RawFurniture, refusal: FurnitureError) -> str:
    """Return the page on a piece that was refused: why, pictures of what was delivered, and the size of each part.

    The pictures show the parts that the refusal is about in red. Without off-screen rendering, the page has no pictures
    and says so.

    Args:
        name: name of the piece.
        source: path that it was read from.
        raw: parts as read.
        refusal: reason.
    """
    marked = {part.name for part in raw.parts} & set(refusal.parts)
    images = ""
    try:
        assembled, exploded = take_delivered([part.mesh for part in raw.parts], [p.name in marked for p in raw.parts])
        red = "; red: the parts named above" if marked else ""
        images = (
            f"<div class='whole'><figure><img src='{assembled}' alt='as delivered'><figcaption>As delivered{red}"
            f"</figcaption></figure><figure><img src='{exploded}' alt='pulled apart'>"
            "<figcaption>Pulled apart</figcaption></figure></div>"
        )
    except RenderingUnavailableError as error:
        images = _without_pictures(error)
    rows: list[str] = []
    for part in raw.parts:
        low, high = 1e3 * part.mesh.bounds
        numbers = "".join(f"<td class='number'>{value:.0f}</td>" for value in (*(high - low), *(0.5 * (low + high))))
        style = " class='bad'" if part.name in marked else ""
        rows.append(f"<tr><td{style}>{_text(part.name)}</td>{numbers}</tr>")
    titles = ("part", *(f"{axis} size, mm" for axis in "xyz"), *(f"{axis} of its middle, mm" for axis in "xyz"))
    head = "".join(f"<th>{title}</th>" for title in titles)
    return _page(name, [
        f"<h1>{_text(name)}: not imported</h1>",
        f"<ol class='look'><li>{_text(str(refusal))}</li></ol>",
        _origin(raw, source),
        images,
        "<h2>Parts as delivered</h2>",
        f"<div class='scroll'><table><tr>{head}</tr>{''.join(rows)}</table></div>",
    ])  # fmt: skip


def _page(name: str, body: Sequence[str]) -> str:
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>Import of {_text(name)}</title>'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><style>{_STYLE}</style></head>'
        f"<body>\n{chr(10).join(filter(None, body))}\n</body></html>\n"
    )


def _origin(raw: RawFurniture, source: Path) -> str:
    """Lines on the size, the file and the unit."""
    x, y, z = (1e3 * side for side in raw.size)
    unit = f"{raw.unit.text}; " if raw.unit else ""
    return (
        f"<p>{len(raw.parts)} parts, {x:.0f} × {y:.0f} × {z:.0f} mm (z up).</p>"
        f"<p class='quiet'>From {_text(source.name)}. Unit: {_text(unit)}{_text(f'{raw.provenance.scale:g}')} m per "
        "unit of the files. If the piece lies on its side, import it again with <code>--up</code>.</p>"
    )


def _without_pictures(error: RenderingUnavailableError) -> str:
    return f"<p class='quiet'>Without pictures: {_text(str(error))}</p>"


def _text(text: str) -> str:
    return html.escape(text)


def _look(found: Sequence[Finding]) -> str:
    if not found:
        return "<p>Nothing: no part was moved or changed its size by more than 1 mm, and a hand can hold each.</p>"
    items = "".join(f"<li{' class=more' if k >= 3 else ''}>{_text(f.text)}</li>" for k, f in enumerate(found))
    return f"<ol class='look'>{items}</ol>"


def _whole(furniture: Furniture, pictures: ImportPictures) -> str:
    overlays: list[str] = []
    numbered = len(pictures.joints) <= MOST_NUMBERS
    middles = pictures.joints.mean(axis=1)
    if numbered:
        middles = separate_labels(middles, 2.0 * _RADIUS + 1.0)
    for number, (((ax, ay), (bx, by)), (x, y)) in enumerate(zip(pictures.joints, middles, strict=True), start=1):
        connection = furniture.connections[number - 1]
        names = " – ".join(_text(furniture.parts[p].name) for p in (connection.part_a, connection.part_b))
        label = f"<circle cx='{x:.1f}' cy='{y:.1f}' r='{_RADIUS:g}'/><text x='{x:.1f}' y='{y:.1f}'>{number}</text>"
        overlays.append(
            f"<g><title>{number}: {names}</title>"
            f"<polyline points='{ax:.1f},{ay:.1f} {x:.1f},{y:.1f} {bx:.1f},{by:.1f}'/>{label if numbered else ''}</g>"
        )
    overlay = f"<svg viewBox='0 0 {WIDTH} {HEIGHT}'>{''.join(overlays)}</svg>"
    return (
        "<div class='whole'>"
        f"<figure><img src='{pictures.before}' alt='as delivered'><figcaption>As delivered</figcaption></figure>"
        f"<figure><img src='{pictures.after}' alt='after repair'><figcaption>After repair; parts of one shape have one "
        "colour</figcaption></figure></div>"
        f"<figure><img src='{pictures.exploded}' alt='pulled apart'>{overlay}<figcaption>Pulled apart; a red line "
        f"joins the two ends of each connection{', with its number in the table below' * numbered}</figcaption>"
        "</figure>"
    )


def separate_labels(points: Float[np.ndarray, "n 2"], distance: float) -> Float[np.ndarray, "n 2"]:
    """Return points of a picture, pushed away from each other until they are `distance` pixels apart, if possible."""
    out = points.copy()
    # Points in one place go to different sides.
    angles = np.arange(len(out)) * 2.4
    out += 0.01 * np.column_stack([np.cos(angles), np.sin(angles)])
    for _ in range(_PUSHES):
        offsets = out[:, None] - out[None]
        lengths = np.linalg.norm(offsets, axis=2)
        np.fill_diagonal(lengths, np.inf)
        overlaps = np.maximum(0.0, distance - lengths)
        if not overlaps.any():
            break
        out += 0.5 * (offsets / lengths[..., None] * overlaps[..., None]).sum(axis=1)
    return out


def _part(
    index: int, raw: RawFurniture, furniture: Furniture, repair: PartRepair, pictures: ImportPictures | None
) -> str:
    part, delivered = furniture.parts[index], raw.parts[index]
    sides = np.sort(extents(part.mesh.vertices, box_axes(part.mesh.vertices)))[::-1]
    size = " × ".join(f"{1e3 * side:.0f}" for side in sides)
    alike = [furniture.parts[k].name for k in furniture.classes[furniture.class_of[index]].members if k != index]
    lines = [
        f"{size} mm, {1e6 * part.mesh.volume:.0f} cm³, {len(delivered.mesh.faces)} → {len(part.mesh.faces)} triangles"
    ]
    if alike:
        lines.append(
            f"same shape as {', '.join(map(_text, alike[:4]))}{f' and {len(alike) - 4} more' * (len(alike) > 4)}"
        )
    lines.append(_made(repair))
    lines.append("not moved" if repair.displacement < 5e-6 else f"moved {1e3 * repair.displacement:.2f} mm")
    cut = f"cut: {repair.trimmed:.2%} of its volume"
    size_change = round(1e3 * repair.size_change, 2) or 0.0
    lines.append(f"{cut}, size {size_change:+.2f} mm" if repair.trimmed or size_change else "not cut")
    lines += [f"<b>sits {1e3 * loss:.1f} mm less deep in {_text(other)}</b>" for other, loss in repair.depth_losses]
    lines += [_text(note) for note in repair.notes]
    neighbours = [furniture.parts[k].name for k in sorted(furniture.neighbours[index])]
    lines.append(f"connected to {', '.join(map(_text, neighbours))}")
    why = why_not_held(part)
    if why:
        lines.append(f"<span class='bad'>{_text(why)}</span>")
    images = ""
    if pictures is not None:
        shown = pictures.parts[index]
        over = ", upside down" if shown.turned_over else ""
        images = (
            f"<figure><img src='{shown.before}' alt='before'><figcaption>before{over}</figcaption></figure>"
            f"<figure><img src='{shown.after}' alt='after'><figcaption>after{over}</figcaption></figure>"
        )
    items = "".join(f"<li>{line}</li>" for line in lines)
    return f"<div class='part'>{images}<div class='text'><h3>{_text(part.name)}</h3><ul>{items}</ul></div></div>"


def _made(repair: PartRepair) -> str:
    if repair.how == "as delivered":
        return "solid as delivered"
    return (
        f"made solid: {_text(repair.how)}; delivered surface up to {1e3 * repair.shape_error:.2f} mm outside, new "
        f"surface up to {1e3 * repair.shape_added:.2f} mm off it"
    )


def _connections(furniture: Furniture) -> str:
    rows: list[str] = []
    for number, c in enumerate(furniture.connections, start=1):
        point = furniture.parts[c.part_a].points[c.point_a]
        place = 1e3 * transform_points(furniture.assembled[c.part_a], point.position[None])[0]
        normal = furniture.assembled[c.part_a].rotation @ point.normal
        names = "".join(f"<td>{_text(furniture.parts[k].name)}</td>" for k in (c.part_a, c.part_b))
        numbers = "".join(f"<td class='number'>{value:.0f}</td>" for value in place)
        rows.append(
            f"<tr><td class='number'>{number}</td>{names}{numbers}<td>{_direction(normal)}</td>"
            f"<td class='number'>{1e3 * point.gap:.2f}</td></tr>"
        )
    head = "".join(f"<th>{title}</th>" for title in ("", "part", "joins", "x mm", "y mm", "z mm", "faces", "gap mm"))
    return (
        f"<p class='quiet'>Parts within {1e3 * CONTACT_DISTANCE:g} mm of each other are connected. Places are the "
        "middle of the contact in the assembled piece: z from the ground, x and y from its middle.</p>"
        f"<div class='scroll'><table><tr>{head}</tr>{''.join(rows)}</table></div>"
    )


def _direction(normal: np.ndarray) -> str:
    axis = int(np.argmax(np.abs(normal)))
    tilted = "" if abs(normal[axis]) > 0.996 else "≈ "
    return f"{tilted}{'+' if normal[axis] > 0 else '−'}{'xyz'[axis]}"


def _unholdable(furniture: Furniture) -> str:
    reasons = [(part.name, why) for part in furniture.parts if (why := why_not_held(part))]
    if not reasons:
        return "<p>Nothing: every part has two places where a hand can hold it.</p>"
    items = "".join(f"<li>{_text(name)}: {_text(why)}</li>" for name, why in reasons)
    return f"<ul>{items}</ul><p class='quiet'>The setting object-centric moves parts without hands.</p>"
