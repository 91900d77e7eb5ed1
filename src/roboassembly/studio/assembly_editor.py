"""Editor of one open piece in one browser: the session, its scene view, and the form for the next action."""

from __future__ import annotations

from typing import Any

import numpy as np
from viser import ClientHandle, SceneClickEvent

from roboassembly.errors import InputError
from roboassembly.solvers.guide import Guide
from roboassembly.studio.action_form import ActionForm
from roboassembly.studio.assembly_session import AssemblySession
from roboassembly.studio.camera_aim import CameraAim
from roboassembly.studio.messages import (
    attempt_message,
    failure_notice,
    plain,
    readable,
    title,
    upright_message,
    verdict_name,
)
from roboassembly.studio.page_link import Notice, PageState
from roboassembly.studio.panel import Panel
from roboassembly.studio.picking import PickedItem
from roboassembly.studio.scene_view import FRAMES_PER_SECOND, SceneView
from roboassembly.studio.step_pictures import StepLine


class AssemblyEditor:
    """Editor of one open piece in one browser. It shows the finished piece until something is done with its parts.

    Args:
        client: browser that shows the piece.
        panel: panel of the client.
        session: session of the piece.
        aim: camera of the browser.
        line: time line of the piece.
    """

    def __init__(
        self, client: ClientHandle, panel: Panel, session: AssemblySession, aim: CameraAim, line: StepLine
    ) -> None:
        self._client, self._panel, self._aim, self._line = client, panel, aim, line
        self.session = session
        self.view = SceneView(client, session, aim)
        self.view.options = panel.view_options
        self._form = ActionForm(panel, session)
        self.notice: Notice | None = None
        """Last message to the page about this piece."""
        self._notices = 0
        self.view.open_finished()
        self.refresh()

    def close(self) -> None:
        """Remove the piece from the scene."""
        self.view.clear()

    def refresh(self) -> None:
        """Update the panel, the time line and the scene to the state of the session."""
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
                f"**{plain(session.furniture.name)}** · {session.merges} of {whole} merges{failed} · "
                f"{session.planning_steps:,} states checked · reward {session.reward:g}"
            )
            parts = len(session.furniture.parts)
            self._line.update(self._step_texts(), view.frames_of_steps, view.meshes, parts)
            panel.link.show_steps(self._line.pictures())

    def _step_texts(self) -> list[str]:
        parts = self.session.furniture.parts
        joined = ((readable(parts[u].name), readable(parts[v].name)) for u, v, *_ in self.session.actions)
        return [f"{len(parts)} parts", *(f"{u} onto {v}" for u, v in joined)]

    def show_pictures(self) -> None:
        """Send the time line again, with the pictures that have been drawn meanwhile."""
        self._panel.link.show_steps(self._line.pictures())

    def leave_opening(self) -> None:
        """Show the parts in place of the finished piece."""
        with self._client.atomic():
            self.view.leave_opening()

    @property
    def page_state(self) -> PageState:
        """State that the page shows."""
        session, view = self.session, self.view
        return PageState(
            mode="opening" if view.is_opening else "work",
            piece=f"{title(session.furniture.name)} · {len(session.furniture.parts)} parts",
            merges=session.merges,
            is_playing=view.is_playing,
            step=view.step,
            notice=self.notice,
        )

    # The action

    def update_form(self) -> None:
        """Update the options of the form, and highlight the chosen points."""
        with self._client.atomic():
            self._form.update_options()
            self._show_choice()

    def _show_choice(self) -> None:
        """Highlight the chosen points, and show the chosen pose or the chosen grasps on their parts."""
        action = self._form.action
        up = None if action is None else self.session.up_while_waiting(action)
        grasps = self.session.grasps_of(action) if action is not None else []
        self.view.choose(self._form.points, None if action is None or up is None else (action[1], up), grasps)

    def item_under(self, event: SceneClickEvent) -> PickedItem | None:
        """Return the part or connection point that was clicked; None for any other click."""
        return self.view.item_under(np.array(event.ray_origin), np.array(event.ray_direction))

    def pick(self, part: int, point: int | None) -> None:
        """Choose a clicked part, or one of its points, if it is free."""
        if self.view.is_opening:
            return
        with self._client.atomic():
            if self._form.pick(part, point):
                self._show_choice()

    def name_at(self, x: float, y: float) -> str:
        """Return the name of what is seen at a place of the scene; empty if nothing is there.

        Args:
            x: place from the left edge over the width of the scene.
            y: place from the upper edge over the height of the scene.
        """
        item = self.view.item_under(*self._aim.ray(x, y))
        if item is None:
            return ""
        part, point = item
        name = readable(self.session.furniture.parts[part].name)
        if point is not None:
            return f"{name}, connection point {point}"
        if self.view.is_opening or self.view.index != self.view.last:
            return name
        groups = self.session.task_state.group_of
        size = sum(groups[p] == groups[part] for p in range(len(self.session.furniture.parts)))
        return f"{name}, joined to {size - 1} more" if size > 1 else name

    def suggest(self, guide: Guide[Any]) -> str:
        """Fill in the action that a policy prefers; returns a message."""
        action = self.session.suggestion(guide)
        if action is None:
            return "The policy suggests no action."
        with self._client.atomic():
            self.view.leave_opening()
            self._form.fill(action)
            self._show_choice()
        return "The policy suggests this action. Press Join to carry it out."

    def join(self) -> str:
        """Carry out the action of the form; returns a message.

        Raises:
            InputError: the form is not complete.
        """
        self.leave_opening()
        action = self._form.action
        if action is None:
            raise InputError("first choose a point of the moving part and a point of the waiting part")
        self.view.clear_failure()
        attempt = self.session.attempt(action)
        if attempt.merged:
            self.view.append_new_steps()
            self._form.clear()
        self.refresh()
        furniture = self.session.furniture
        if not attempt.merged:
            self.tell("bad", *failure_notice(furniture, attempt))
            self.view.mark_failure((action[1], action[3]), verdict_name(attempt))
        elif self.session.task_state.complete:
            self.tell("good", "Assembled", upright_message(self.session.upright).strip())
        return attempt_message(furniture, attempt) + upright_message(self.session.upright)

    def tell(self, kind: str, title: str, text: str = "") -> None:
        """Show a message in the scene; arguments as of `Notice`."""
        self._notices += 1
        self.notice = Notice(kind, title, text, self._notices)

    def forget_notice(self) -> None:
        """Remove the message from the scene."""
        self.notice = None
        with self._client.atomic():
            self.view.clear_failure()

    def undo(self) -> None:
        """Undo the newest step.

        Raises:
            InputError: there is no step.
        """
        if not self.session.undo():
            raise InputError("there is no step to undo")
        self.view.leave_opening()
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
        self._show_frame(int(self._panel.time.value))

    def show_step(self, number: int) -> None:
        """Stop, and show the end of a step.

        Args:
            number: number of the step; 0 for the start. A larger number than there are steps stands for the last one.
        """
        self._show_frame(self.view.end_of_step(number))

    def _show_frame(self, index: int) -> None:
        self.view.is_playing = False
        with self._client.atomic():
            self.view.leave_opening()
            self.view.show(index)
            self._panel.time.value = self.view.index

    def toggle_playback(self) -> None:
        """Play or stop; play from the start at the end."""
        view = self.view
        self.leave_opening()
        if not view.is_playing and view.index == view.last:
            view.show(0)
        view.is_playing = not view.is_playing

    def advance(self, delay: float) -> None:
        """Show the next frame, or skip frames after a delay.

        Args:
            delay: time since the frame was due [s].
        """
        view = self.view
        if view.is_turning:
            with self._client.atomic():
                view.turn(delay + 1.0 / FRAMES_PER_SECOND)
            return
        with self._client.atomic():
            view.show(view.index + 1 + int(delay * FRAMES_PER_SECOND))
            self._panel.time.value = view.index
        view.is_playing = view.index < view.last
