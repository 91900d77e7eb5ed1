"""The dropdowns by which an action is chosen: what they offer, and what they stand at."""

from __future__ import annotations

from typing import Any

import numpy as np

from roboassembly.studio.marks import Chosen
from roboassembly.studio.panel import NONE, PICKS, Panel
from roboassembly.studio.session import Session
from roboassembly.studio.words import WAYS


class Chooser:
    """Two points and what is chosen besides them, in the panel of a session."""

    def __init__(self, panel: Panel, session: Session) -> None:
        self._panel, self._session = panel, session
        for control, choice in zip(panel.ways, [*session.choices(), None], strict=False):
            control.visible = choice is not None
            if choice is None:
                continue
            name, count = choice
            if name == "w":
                control.label, control.options = "Waits with (w)", tuple(f"{i}: {way}" for i, way in enumerate(WAYS))
            else:
                control.label = f"R_{name[-1]} takes it by ({name})"
                control.options = tuple(f"{i}: region {i // 4}, direction {i % 4}" for i in range(count))

    def offer(self) -> None:
        """What can be chosen now; what was chosen stays, if it can."""
        panel, free = self._panel, self._session.free()
        parts = [self._named(i) for i in np.flatnonzero(free.any(axis=1)).tolist()]
        for control in (panel.u, panel.v):
            _offer(control, parts)
        for part, point in ((panel.u, panel.k), (panel.v, panel.l)):
            own = [] if part.value == NONE else [str(k) for k in np.flatnonzero(free[_number(part.value)])]
            _offer(point, own)

    def pick(self, part: int, point: int | None) -> bool:
        """Choose a part, or one of its points, that was clicked on; False if it cannot be joined any more."""
        free = self._session.free()[part]
        if not (free.any() if point is None else free[point]):
            return False
        panel = self._panel
        moving = panel.next.value == PICKS[0]
        which, at = (panel.u, panel.k) if moving else (panel.v, panel.l)
        if which.value != self._named(part):
            at.value = NONE
        which.value = self._named(part)
        self.offer()
        if point is not None:
            at.value = str(point)
            panel.next.value = PICKS[moving]
        return True

    def set(self, action: tuple[int, ...]) -> None:
        """Stand at an action."""
        panel, (u, v, k, l, *ways) = self._panel, action  # noqa: E741
        panel.u.value, panel.v.value = self._named(u), self._named(v)
        self.offer()
        panel.k.value, panel.l.value = str(k), str(l)
        for control, way in zip(panel.ways, ways, strict=False):
            control.value = control.options[way]

    @property
    def ends(self) -> Chosen:
        """The two points, as far as they are chosen."""
        panel = self._panel
        ends = ((panel.u.value, panel.k.value), (panel.v.value, panel.l.value))
        one, two = (None if NONE in end else (_number(end[0]), int(end[1])) for end in ends)
        return one, two

    @property
    def ways(self) -> list[int]:
        """What is chosen besides the points: `w`, or `g_a` and `g_b`."""
        return [_number(c.value) for c, _ in zip(self._panel.ways, self._session.choices(), strict=False)]

    def _named(self, part: int) -> str:
        return f"{part}: {self._session.furniture.parts[part].name}"


def _number(text: str) -> int:
    return int(text.partition(":")[0])


def _offer(control: Any, options: list[str]) -> None:
    """New options of a dropdown; the choice stays, if it can."""
    value = control.value
    wanted = (NONE, *options)
    if control.options != wanted:
        control.options = wanted
    control.value = value if value in wanted else NONE
