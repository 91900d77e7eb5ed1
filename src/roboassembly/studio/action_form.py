"""Form for an action: the dropdowns of the panel that hold its components."""

from __future__ import annotations

import numpy as np
from viser import GuiDropdownHandle

from roboassembly.studio.assembly_session import AssemblySession
from roboassembly.studio.explanations import explanation_of, hint_of, label_of, options_of
from roboassembly.studio.overlays import ChosenPoints, PointId
from roboassembly.studio.panel import NONE, PICKS, Panel


class ActionForm:
    """Dropdowns of a panel that hold the components of an action.

    Args:
        panel: panel with the dropdowns.
        session: session in which the action is carried out.
    """

    def __init__(self, panel: Panel, session: AssemblySession) -> None:
        self._panel, self._session = panel, session
        for control, choice in zip(panel.choices, [*session.choices(), None], strict=False):
            control.visible = choice is not None
            if choice is None:
                continue
            name, count = choice
            control.label, control.hint, control.options = label_of(name), hint_of(name), options_of(name, count)

    def update_options(self) -> None:
        """Offer the parts and points that are free now; keep a choice that is still free."""
        panel, free = self._panel, self._session.free_points()
        parts = [self._label(i) for i in np.flatnonzero(free.any(axis=1)).tolist()]
        for control in (panel.u, panel.v):
            _set_options(control, parts)
        for part, point in ((panel.u, panel.k), (panel.v, panel.l)):
            own = [] if part.value == NONE else [str(k) for k in np.flatnonzero(free[_number(part.value)])]
            _set_options(point, own)
        names = [name for name, _ in self._session.choices()]
        u_point, v_point = self.points
        panel.explanation.content = explanation_of(names, (u_point is not None, v_point is not None))

    def pick(self, part: int, point: int | None) -> bool:
        """Choose a part, or one of its points; returns False if it is not free."""
        free = self._session.free_points()[part]
        if not (free.any() if point is None else free[point]):
            return False
        panel = self._panel
        moving = panel.next.value == PICKS[0]
        part_control, point_control = (panel.u, panel.k) if moving else (panel.v, panel.l)
        if part_control.value != self._label(part):
            point_control.value = NONE
        part_control.value = self._label(part)
        self.update_options()
        if point is not None:
            point_control.value = str(point)
            panel.next.value = PICKS[moving]
            self.update_options()
        return True

    def clear(self) -> None:
        """Choose no parts and no points."""
        panel = self._panel
        for control in (panel.u, panel.v, panel.k, panel.l):
            control.value = NONE
        panel.next.value = PICKS[0]

    def fill(self, action: tuple[int, ...]) -> None:
        """Set all dropdowns to an action."""
        panel, (u, v, k, l, *choices) = self._panel, action  # noqa: E741
        panel.u.value, panel.v.value = self._label(u), self._label(v)
        self.update_options()
        panel.k.value, panel.l.value = str(k), str(l)
        for control, value in zip(panel.choices, choices, strict=False):
            control.value = control.options[value]
        self.update_options()

    @property
    def points(self) -> ChosenPoints:
        """Chosen points of the moving and of the waiting part; None for one that is not chosen."""
        panel = self._panel
        return _point(panel.u, panel.k), _point(panel.v, panel.l)

    @property
    def choices(self) -> list[int]:
        """Values of `w`, or of `g_a` and `g_b`."""
        return [_number(c.value) for c, _ in zip(self._panel.choices, self._session.choices(), strict=False)]

    @property
    def action(self) -> tuple[int, ...] | None:
        """Action of the form; None if it is not complete."""
        u_point, v_point = self.points
        if u_point is None or v_point is None:
            return None
        return u_point[0], v_point[0], u_point[1], v_point[1], *self.choices

    def _label(self, part: int) -> str:
        return f"{part}: {self._session.furniture.parts[part].name}"


def _point(part: GuiDropdownHandle[str], point: GuiDropdownHandle[str]) -> PointId | None:
    if NONE in (part.value, point.value):
        return None
    return _number(part.value), int(point.value)


def _number(text: str) -> int:
    return int(text.partition(":")[0])


def _set_options(control: GuiDropdownHandle[str], options: list[str]) -> None:
    """Set the options of a dropdown; keep its value if it is still offered."""
    value = control.value
    new = (NONE, *options)
    if control.options != new:
        control.options = new
    control.value = value if value in new else NONE
