"""Long work of one client: search, policies, repeated plans and files, with progress and cancelling."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from viser import ClientHandle

from roboassembly.errors import InputError
from roboassembly.learning.policy import Policy, guide_of, settings_of
from roboassembly.learning.registry import load_policy
from roboassembly.solvers.forward import SearchProgress, Watch
from roboassembly.solvers.guide import Guide
from roboassembly.studio.assembly_editor import AssemblyEditor
from roboassembly.studio.assembly_session import AssemblySession
from roboassembly.studio.downloads import DOWNLOADS, send_file
from roboassembly.studio.messages import attempt_message, failure_notice, upright_message
from roboassembly.studio.page_link import Busy
from roboassembly.studio.panel import Panel
from roboassembly.task.plans.plan_file import Script

_PROGRESS_INTERVAL = 0.1
"""Shortest time between two progress messages [s]."""


class Runs:
    """Long work of one client.

    Args:
        client: browser that sees the progress.
        panel: its panel.
        policies: names of the policies that it may use.
        show: called with the work in progress, or with None after it.
    """

    def __init__(
        self, client: ClientHandle, panel: Panel, policies: tuple[str, ...], show: Callable[[Busy | None], None]
    ) -> None:
        self._client, self._panel, self._offered, self._show = client, panel, policies, show
        self._policies: dict[str, Policy] = {}
        self.cancelled = threading.Event()
        """Stops the work when it is set."""

    def guide(self, session: AssemblySession) -> Guide[Any]:
        """Return the guide of the chosen policy.

        Raises:
            InputError: the policy is not offered, or is not for the setting of the session.
        """
        policy = self._policy(self._panel.policy.value)
        if session.setting not in settings_of(policy):
            name = self._panel.policy.value
            raise InputError(f"the policy '{name}' does not choose grasps; use Search, which needs no policy")
        return guide_of(policy)

    def _policy(self, name: str) -> Policy:
        if name not in self._offered:
            raise InputError("this policy is not offered; start the studio with --policies and its name")
        if name not in self._policies:
            self._policies[name] = load_policy(name)
        return self._policies[name]

    def repeat(self, editor: AssemblyEditor, script: Script) -> str:
        """Repeat a plan; returns a message."""
        session = editor.session
        return self._run(editor, lambda watch: session.repeat(script, watch), "Repeating the plan", "Repeated the plan")

    def assemble(self, editor: AssemblyEditor) -> str:
        """Find and carry out the remaining steps by what suits the setting; returns a message."""
        session = editor.session
        fits = session.setting in settings_of(self._policy(self._panel.policy.value))
        return self.run(editor, "guided" if fits else "search")

    def run(self, editor: AssemblyEditor, mode: str) -> str:
        """Find and carry out the remaining steps; returns a message.

        Args:
            editor: editor of the piece.
            mode: `search`, `guided` or `alone`.

        Raises:
            InputError: the piece is assembled, or see `guide`.
        """
        session = editor.session
        if session.task_state.complete:
            raise InputError("the furniture is assembled; undo some steps or open other furniture first")
        guide = self.guide(session) if mode != "search" else None
        if mode == "alone" and guide is not None:
            return self._run(editor, lambda watch: self._follow(editor, guide, watch), "Following the policy")
        return self._run(editor, lambda watch: session.search(guide, watch), "Looking for a way")

    def save(self, editor: AssemblyEditor, name: str) -> str:
        """Make a file of the steps so far and send it; returns a message.

        Raises:
            RoboAssemblyError: see `send_file`.
        """
        label = DOWNLOADS[name][0].lower()
        shown = 0.0

        def watch(share: float) -> bool:
            nonlocal shown
            if time.monotonic() - shown > _PROGRESS_INTERVAL:
                shown = time.monotonic()
                self._progress(f"Drawing the {label} …", 100.0 * share, cancel=True)
            return not self.cancelled.is_set()

        self._progress(f"Making the {label} …", None, cancel=False)
        self._panel.set_busy(True)
        try:
            sent = send_file(self._client, editor.session, name, watch)
        finally:
            self._panel.set_busy(False)
            self._show(None)
        return f"Saved {name}." if sent else f"{name} was cancelled."

    def _run(self, editor: AssemblyEditor, work: Callable[[Watch], str], doing: str, done: str = "Assembled") -> str:
        """Run something long with a progress bar, and show its result; returns a message.

        Args:
            editor: editor of the piece.
            work: returns the reason of an early end; empty if there was none.
            doing: first words of the progress.
            done: first words of the message if there was no early end.
        """
        session = editor.session
        before = session.merges
        self._panel.set_busy(True)
        self._progress(f"{doing} …", None, cancel=True)
        try:
            reason = work(self._watch(session, doing))
        finally:
            self._panel.set_busy(False)
            self._show(None)
        editor.leave_opening()
        if session.merges > before:
            editor.view.append_new_steps()
        editor.refresh()
        upright = upright_message(session.upright)
        count = f"{session.merges - before} merges, {session.planning_steps:,} states checked in total"
        if not reason:
            editor.tell("good", done, f"{session.merges} of {session.merges} joined.{upright}")
        elif editor.notice is None:
            if self.cancelled.is_set():
                editor.tell("info", "Cancelled", "Nothing has changed." if session.merges == before else "")
            else:
                editor.tell("bad", "Not assembled", f"{reason[:1].upper()}{reason[1:]}.")
        return f"✗ {reason}" if reason else f"✓ {done}: {count}.{upright}"

    def _progress(self, text: str, percent: float | None, *, cancel: bool) -> None:
        self._panel.progress.value = percent or 0.0
        self._show(Busy(text, None if percent is None else round(percent, 1), cancel))

    def _watch(self, session: AssemblySession, doing: str) -> Watch:
        """Return a function that shows the progress of a run, and stops the run when it is cancelled."""
        whole, before, last_shown = len(session.furniture.parts) - 1, session.merges, 0.0

        def watch(progress: SearchProgress) -> bool:
            nonlocal last_shown
            if time.monotonic() - last_shown > _PROGRESS_INTERVAL:
                last_shown = time.monotonic()
                merges = before + progress.merges
                self._progress(f"{doing}: {merges} of {whole} joined", 100.0 * merges / whole, cancel=True)
                self._panel.message.content = (
                    f"… {merges} of {whole} merges, {progress.attempts} attempts, {progress.states:,} states checked"
                )
            return not self.cancelled.is_set()

        return watch

    def _follow(self, editor: AssemblyEditor, guide: Guide[Any], watch: Watch) -> str:
        """Carry out the policy's preferred action until the piece is complete; returns the reason of an early end."""
        session = editor.session
        states = session.planning_steps
        for k in range(len(session.furniture.parts)):
            if session.task_state.complete:
                return ""
            if not watch(SearchProgress(k, k, session.planning_steps - states)):
                return "Stopped."
            action = session.suggestion(guide)
            if action is None:
                return "The policy suggests no action."
            attempt = session.attempt(action)
            if not attempt.merged:
                editor.tell("bad", *failure_notice(session.furniture, attempt))
                return attempt_message(session.furniture, attempt).removeprefix("✗ ")
        return ""
