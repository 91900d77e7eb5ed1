"""Editor of one open piece in one browser: the session, its scene view, and the form for the next action."""

from __future__ import annotations

from typing import Any

import numpy as np
from viser import ClientHandle, SceneClickEvent

from roboassembly.errors import InputError
from roboassembly.solvers.guide import Guide
from roboassembly.studio.action_form import ActionForm
from roboassembly.studio.assembly_session import AssemblySession
from roboassembly.studio.messages import attempt_message, upright_message
from roboassembly.studio.panel import Panel
from roboassembly.studio.picking import PickedItem
from roboassembly.studio.scene_view import FRAMES_PER_SECOND, SceneView


class AssemblyEditor:
    """Editor of one open piece in one browser.

    Args:
        client: browser that shows the piece.
        panel: panel of the client.
        session: session of the piece.
    """

    def __init__(self, client: ClientHandle, panel: Panel, session: AssemblySession) -> None:
        self._client, self._panel = client, panel
        self.session = session
        self.view = SceneView(client, session)
        self.view.options = panel.view_options
        self._form = ActionForm(panel, session)
        self.refresh()

    def close(self) -> None:
        """Remove the piece from the scene."""
        self.view.clear()

    def refresh(self) -> None:
        """Update the panel and the scene to the state of the session."""
        session, panel, view = self.session, self._panel, self.view
        with self._client.atomic():
            panel.time.max = max(1, view.last)
            panel.time.visible = panel.play_button.visible = view.last > 0
            panel.time.value = view.index
            self.update_form()
            view.refresh()
            whole = len(session.furniture.parts) - 1
            failed = f" · {session.failures} failed" if session.failures else ""
            panel.status.content = (
                f"**{session.furniture.name}** · {session.merges} of {whole} merges{failed} · "
                f"{session.planning_steps:,} states checked · reward {session.reward:g}"
            )

    # The action

    def update_form(self) -> None:
        """Update the options of the form, and highlight the chosen points."""
        with self._client.atomic():
            self._form.update_options()
            self.view.choose(self._form.points)

    def item_under(self, event: SceneClickEvent) -> PickedItem | None:
        """Return the part or connection point that was clicked; None for any other click."""
        return self.view.item_under(np.array(event.ray_origin), np.array(event.ray_direction))

    def pick(self, part: int, point: int | None) -> None:
        """Choose a clicked part, or one of its points, if it is free."""
        with self._client.atomic():
            if self._form.pick(part, point):
                self.view.choose(self._form.points)

    def suggest(self, guide: Guide[Any]) -> str:
        """Fill in the action that a policy prefers; returns a message."""
        action = self.session.suggestion(guide)
        if action is None:
            return "The policy suggests no action."
        with self._client.atomic():
            self._form.fill(action)
            self.view.choose(self._form.points)
        return "The policy suggests this action. Press Join to carry it out."

    def join(self) -> str:
        """Carry out the action of the form; returns a message.

        Raises:
            InputError: the form is not complete.
        """
        u_point, v_point = self._form.points
        if u_point is None or v_point is None:
            raise InputError("first choose a point of the moving part and a point of the waiting part")
        action = (u_point[0], v_point[0], u_point[1], v_point[1], *self._form.choices)
        attempt = self.session.attempt(action)
        if attempt.merged:
            self.view.append_new_steps()
        self.refresh()
        return attempt_message(self.session.furniture, attempt) + upright_message(self.session.upright)

    def undo(self) -> None:
        """Undo the newest step.

        Raises:
            InputError: there is no step.
        """
        if not self.session.undo():
            raise InputError("there is no step to undo")
        self.view.drop_undone_steps()
        self.refresh()

    # Playback

    def change_view(self) -> None:
        """Apply the view options of the panel."""
        with self._client.atomic():
            self.view.options = self._panel.view_options
            self.view.refresh()

    def scrub(self) -> None:
        """Stop, and show the frame of the time slider."""
        self.view.is_playing = False
        with self._client.atomic():
            self.view.show(int(self._panel.time.value))

    def toggle_playback(self) -> None:
        """Play or stop; play from the start at the end."""
        view = self.view
        if not view.is_playing and view.index == view.last:
            view.show(0)
        view.is_playing = not view.is_playing

    def advance(self, delay: float) -> None:
        """Show the next frame, or skip frames after a delay.

        Args:
            delay: time since the frame was due [s].
        """
        view = self.view
        with self._client.atomic():
            view.show(view.index + 1 + int(delay * FRAMES_PER_SECOND))
            self._panel.time.value = view.index
        view.is_playing = view.index < view.last
