"""Picture of a step in its panel: parts, arrows, labels, an enlarged joint, the turn, and how often it is done."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3, transform_points
from roboassembly.manual.line_drawing import MILLIMETRES, Figure, Projection
from roboassembly.manual.merge_tree import Halves, Parts
from roboassembly.manual.page import ACCENT, BLACK, GREY, Box, Page
from roboassembly.manual.pictures import (
    Placement,
    add_arrow,
    add_detail,
    add_drawing,
    add_label,
    inner_spot,
    place,
)
from roboassembly.manual.steps import FastenerWay, Manual, ManualStep, Mover, joint_depth
from roboassembly.manual.viewpoints import (
    JointSpot,
    Sight,
    best_camera,
    coming_keys,
    joint_spots,
    step_camera,
    step_figures,
)

HAND = 90.0
"""Breadth of a hand: joints with a smaller contact are enlarged [mm]."""
_CLEAR = 22.0
"""Size on the page from which a joint needs no enlargement [mm]."""
_DETAIL_ARROW = 0.75
"""Size of the arrow in an enlarged joint."""
_LEAST_ENLARGEMENT = 1.5
"""Ratio of sizes below which an enlarged joint shows nothing new."""
_LEAST_FIRST = 0.012
"""Length of the first edge of a bent way from which it is enough for an enlarged joint [m]."""
_SIDE = 46.0
"""Width of the column for the enlarged joint and the turn [mm]."""
_FEWEST_TO_COUNT = 4
"""Number of equal parts in one step from which one label counts them."""
_BASE_ONLY = 3
"""Largest number of parts in a step that takes half a row."""
_UP_WORDS = ("upright", "upside down", "onto its side", "onto its side", "onto its front", "onto its back")
_HOLD_MARK = "hold"
"""Words of the mark on what a second person holds."""
_WITH_FRONT = "generated"
"""Source of furniture whose front is known to be on the side of −y."""
_FASTENER_ARROW = 0.6
"""Size of the arrow of a fastener."""
_CROWDED = 5
"""Number of movers in a step from which its arrows are slender."""


@dataclass(frozen=True, eq=False)
class StepView:
    """Step with the side from which it is drawn."""

    step: ManualStep
    camera: Projection
    detail: JointSpot | None
    """Joint that is enlarged, if any."""

    @property
    def is_small(self) -> bool:
        """Whether half a row is enough."""
        return len(self.step.result) <= _BASE_ONLY


def viewed_steps(manual: Manual) -> list[StepView]:
    """Return the views of all steps; a view is kept where the same side stays up."""
    furniture = manual.furniture
    seen: dict[Parts, tuple[Projection, int]] = {}
    out: list[StepView] = []
    for step in manual.steps:
        before, up = seen.get(step.base, (None, step.up))
        camera = step_camera(furniture, step, before if up == step.up else None)
        seen[step.result] = (camera, step.up)
        out.append(StepView(step, camera, _small_joint(furniture, step, camera)))
    return out


def contact_size(furniture: Furniture, spot: JointSpot) -> float:
    """Return the size of a contact, about: that of what lies in the boxes around both parts [mm]."""
    corners = [
        transform_points(furniture.assembled[p], furniture.parts[p].mesh.vertices) for p in (spot.part, spot.other)
    ]
    low = np.max([b.min(axis=0) for b in corners], axis=0) - 0.002
    high = np.min([b.max(axis=0) for b in corners], axis=0) + 0.002
    sizes = [np.maximum(high - low, 0.0)]
    # The box around a slanted part is larger than the part: its corners in there tell more.
    for points in corners:
        inside = points[((points > low) & (points < high)).all(axis=1)]
        if len(inside) > 3:
            sizes.append(np.ptp(inside, axis=0))
    return MILLIMETRES * float(min(size.max() for size in sizes))


def _small_joint(furniture: Furniture, step: ManualStep, camera: Projection) -> JointSpot | None:
    """Return the joint of a step that is worth an enlargement: smaller than a hand, seen, and best seen of all."""
    spots = [spot for spot in joint_spots(furniture, step) if contact_size(furniture, spot) < HAND]
    if not spots:
        return None
    sight = Sight.past(step_figures(furniture, step))
    tests: list[list[Float[np.ndarray, "3"]]] = []
    for spot in spots:
        way = step.movers[spot.mover].away.act(spot.place) - spot.place
        tests.append([spot.place + s * way for s in (0.15, 0.4, 0.7)])
    visible = sight.sees(np.array(tests).reshape(-1, 3), camera.toward).reshape(len(spots), -1).sum(axis=1)
    if not visible.any():
        return None
    nearness = np.array([spot.place @ camera.toward for spot in spots])
    return spots[int(np.lexsort((nearness.round(3), visible))[-1])]


def draw_step(
    page: Page, manual: Manual, view: StepView, box: Box, letters: dict[int, str], help_with: Parts | None
) -> None:
    """Draw a step into a box.

    Args:
        page: where it is drawn.
        manual: whose step it is.
        view: the step and its camera.
        box: where it is drawn.
        letters: letter of each part.
        help_with: parts that a second person holds, which get a mark, or none if there is other work for two; None if
            one person can do the step.
    """
    step = view.step
    _draw_header(page, box, step, help_with is not None)
    wide = box.width > 1.25 * box.height
    needs_column = view.detail is not None or step.turned_from is not None
    if wide:
        column = Box(box.right - _SIDE, box.low + 3, box.right - 2, box.high - 3)
        area = Box(box.left + 3, box.low + 3, (column.left - 4) if needs_column else box.right - 3, box.high - 14)
        corner = Box(column.left, column.low, column.right, column.low + column.width)
        turn_box = Box(column.left, column.high - 46, column.right, column.high)
    else:
        area = Box(box.left + 3, box.low + (_SIDE if needs_column else 3), box.right - 3, box.high - 14)
        corner = Box(box.right - _SIDE + 2, box.low + 3, box.right - 4, box.low + _SIDE - 3)
        turn_box = Box(box.left + 3, box.low + 3, box.left + 45, box.low + _SIDE - 5)
    coming = coming_keys(manual.furniture, step)
    placed = place(step_figures(manual.furniture, step), view.camera, area.inset(7.0))
    add_drawing(page, placed, coming)
    spots = joint_spots(manual.furniture, step)
    if view.detail is not None and contact_size(manual.furniture, view.detail) * placed.scale < _CLEAR:
        _draw_detail(page, manual.furniture, view, placed, corner)
    size = _DETAIL_ARROW if len(step.movers) >= _CROWDED else 1.0
    arrows = [box for i, mover in enumerate(step.movers) for box in _draw_arrows(page, placed, mover, i, spots, size)]
    arrows += [
        add_arrow(page, placed.at(_to_mouth(manual.furniture, way)), _FASTENER_ARROW)
        for way in step.fasteners[: None if len(step.fasteners) < _CROWDED else 1]
    ]
    _draw_labels(page, manual, step, placed, area, arrows, letters)
    if help_with and (anchor := _anchor(placed, help_with)) is not None:
        add_label(page, _HOLD_MARK, anchor, area, placed.covered, arrows)
    if step.turned_from is not None:
        _draw_turn(page, manual, step, turn_box)


def _to_mouth(furniture: Furniture, way: FastenerWay) -> Float[np.ndarray, "2 3"]:
    """Return the ends of a fastener's arrow: from its front end to where that enters the part [m]."""
    away, place = way.arrow(furniture)
    mesh = furniture.fasteners[way.index].mesh
    inward = (place - away) / max(1e-9, float(np.linalg.norm(place - away)))
    half = 0.5 * float(np.ptp(mesh.vertices[:, 2]))
    return np.array([away + half * inward, place + 0.2 * half * inward])


def _draw_header(page: Page, box: Box, step: ManualStep, two_people: bool) -> None:
    number = page.text(box.left + 2, box.high - 9, str(step.number), 26, bold=True)
    x = number.box.right + 4
    if step.count > 1:
        x = page.text(x, box.high - 9, f"{step.count}×", 20, bold=True, ink=ACCENT).box.right + 4
    if two_people:
        draw_people(page, x, box.high - 10, 2)


def draw_people(page: Page, x: float, y: float, count: int) -> None:
    """Draw signs of people, 8 mm high.

    Args:
        page: where they are drawn.
        x: left border [mm].
        y: height of their feet [mm].
        count: of people.
    """
    shape = np.array([[0, 0], [0, 2.6], [-1, 2.6], [-1, 5.2], [0.2, 5.8], [2.2, 5.8], [3.4, 5.2], [3.4, 2.6],
                      [2.4, 2.6], [2.4, 0], [1.4, 0], [1.4, 2.4], [1.0, 2.4], [1.0, 0]])  # fmt: skip
    for k in range(count):
        page.path([shape + np.array([x + 1 + 5.2 * k, y])], fill=BLACK)
        page.circle((x + 2.2 + 5.2 * k, y + 7.1), 1.05, fill=BLACK)


def _draw_arrows(
    page: Page, placed: Placement, mover: Mover, index: int, spots: list[JointSpot], size: float
) -> list[Box]:
    """Draw the way of a mover into its joints: one arrow, or two where its joints are far apart."""
    places = np.array([spot.place for spot in spots if spot.mover == index]).reshape(-1, 3)
    if not len(places):
        return []
    ends = [places[int(np.argmax((places @ placed.camera.toward).round(4)))]]
    if len(places) > 1 and len(mover.way) == 2:
        distances = np.linalg.norm(places[:, None] - places[None], axis=2)
        i, j = np.unravel_index(int(np.argmax(distances)), distances.shape)
        ends = [places[i], places[j]] if distances[i, j] > 0.12 else [places.mean(axis=0)]
    return [add_arrow(page, placed.at(mover.arrow(end)), size) for end in ends]


def _draw_labels(
    page: Page, manual: Manual, step: ManualStep, placed: Placement, area: Box, arrows: list[Box],
    letters: dict[int, str],
) -> None:  # fmt: skip
    names: list[tuple[str, Parts]] = []
    for mover in step.movers:
        single = len(mover.parts) == 1
        names.append((letters[min(mover.parts)] if single else f"from {manual.made_in[mover.parts]}", mover.parts))
    if len(step.base) == 1:
        names.insert(0, (letters[min(step.base)], step.base))
    count = len(manual.furniture.parts)
    by_letter: dict[str, list[int]] = {}
    for way in step.fasteners:
        by_letter.setdefault(letters[count + way.index], []).append(count + way.index)
    for letter, keys in by_letter.items():
        names.append((letter if len(keys) == 1 else f"{len(keys)}× {letter}", frozenset(keys[:1])))
    texts = [text for text, _ in names]
    done: set[str] = set()
    for text, parts in names:
        many = texts.count(text)
        if many >= _FEWEST_TO_COUNT:
            if text in done:
                continue
            done.add(text)
            text = f"{many}× {text}"
        anchor = _anchor(placed, parts)
        if anchor is not None:
            add_label(page, text, anchor, area, placed.covered, arrows)


def _anchor(placed: Placement, parts: Parts) -> Float[np.ndarray, "2"] | None:
    """Return a point inside the largest visible region of some parts [mm]; None if they are hidden."""
    regions = [r.shape for r in placed.drawing.regions if r.key in parts]
    pieces = [piece for shape in regions for piece in shape.decompose()]
    if not pieces:
        return None
    return inner_spot(placed.on_page(max(pieces, key=lambda piece: piece.area())))


def _draw_detail(page: Page, furniture: Furniture, view: StepView, placed: Placement, box: Box) -> None:
    """Draw the enlarged joint, and where it is."""
    spot = view.detail
    assert spot is not None
    mover = view.step.movers[spot.mover]
    size = contact_size(furniture, spot)
    near = _brought_near(furniture, mover, spot, view.step, size)
    here = view.camera.project(spot.place)
    there = view.camera.project(near.away.act(spot.place))
    radius = 0.5 * float(np.linalg.norm(there - here)) + 0.75 * max(size, 24.0)
    middle = 0.5 * (here + there)
    center = placed.scale * middle + placed.shift
    on_page = max(2.5, placed.scale * radius)
    if 0.5 * box.width < _LEAST_ENLARGEMENT * on_page:
        return
    step = replace(view.step, movers=(near,))
    target = box.center
    way = target - center
    length = float(np.linalg.norm(way))
    line = np.array([center + on_page * way / length, target - 0.5 * box.width * way / length])
    page.path([line], stroke=GREY, width=0.25, closed=False)
    page.circle(center, on_page, stroke=BLACK, width=0.35)
    detail = add_detail(page, step_figures(furniture, step), view.camera, middle, radius, box, near.parts)
    arrow = detail.at(near.arrow(spot.place))
    if float(np.linalg.norm(arrow[0] - arrow[-1])) > 5.0:
        add_arrow(page, arrow, _DETAIL_ARROW)


def _brought_near(furniture: Furniture, mover: Mover, spot: JointSpot, step: ManualStep, size: float) -> Mover:
    """Return the mover so near to its place that both halves of a joint fit into one picture."""
    way = mover.away.act(spot.place) - spot.place
    length = float(np.linalg.norm(way))
    if len(mover.way) != 2 or length < 1e-6:
        first = float(np.linalg.norm(mover.way[1].act(spot.place) - spot.place))
        return replace(mover, way=mover.way[:2]) if first > _LEAST_FIRST else mover
    direction = way / length
    deep = joint_depth(furniture, Halves(frozenset((spot.part,)), frozenset((spot.other,))), direction)
    reach = min(length, deep + max(0.02, 0.5 * size / MILLIMETRES))
    return replace(mover, way=(SE3.Identity(), SE3(np.eye(3), reach * direction)))


def _draw_turn(page: Page, manual: Manual, step: ManualStep, box: Box) -> None:
    """Draw how the piece lies before a step, and that it is turned; the step's own picture shows it afterward."""
    assert step.turned_from is not None
    side = _UP_WORDS[step.up]
    if manual.furniture.provenance.source != _WITH_FRONT and side in _UP_WORDS[4:]:
        side = "onto another side"
    draw_turned(page, manual.furniture, step.base, step.turned_from, f"turn it {side}", box)


def draw_turned(page: Page, furniture: Furniture, parts: Parts, up: int, caption: str, box: Box) -> None:
    """Draw parts before a turn in a frame, with an arrow and words.

    Args:
        page: where it is drawn.
        furniture: whose parts they are.
        parts: sub-assembly that is turned.
        up: axis that points up before the turn.
        caption: what is done.
        box: the frame.
    """
    figures = [Figure(furniture.parts[p].mesh, furniture.assembled[p], p) for p in sorted(parts)]
    frame = np.array([[box.left, box.low], [box.right, box.low], [box.right, box.high], [box.left, box.high]])
    page.path([frame], stroke=GREY, width=0.25)
    middle = float(box.center[0])
    page.text(middle, box.low + 2.2, caption, 9, centered=True)
    space = Box(box.left + 5, box.low + 8, box.right - 5, box.high - 11)
    add_drawing(page, place(figures, best_camera(figures, up), space), plain=True, lines=0.5)
    turn = np.linspace(np.pi * 0.95, np.pi * 0.05, 17)
    arc = np.column_stack([10.0 * np.cos(turn), 5.0 * np.sin(turn)]) + np.array([middle, box.high - 8.0])
    add_arrow(page, arc)
