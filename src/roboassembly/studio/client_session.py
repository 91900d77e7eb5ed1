"""Session of one client: its requests are queued and carried out in turn by a thread of its own."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from viser import ClientHandle, SceneClickEvent, UploadedFile

from roboassembly.errors import InputError, RoboAssemblyError
from roboassembly.furniture.model import Furniture
from roboassembly.learning.policy import Policy, guide_of, settings_of
from roboassembly.learning.registry import load_policy
from roboassembly.settings import SETTINGS
from roboassembly.solvers.forward import SearchProgress, Watch
from roboassembly.solvers.guide import Guide
from roboassembly.studio.assembly_editor import AssemblyEditor
from roboassembly.studio.assembly_session import AssemblySession
from roboassembly.studio.config import StudioConfig
from roboassembly.studio.downloads import send_plan
from roboassembly.studio.messages import attempt_message, upright_message
from roboassembly.studio.panel import Panel, PanelCallbacks
from roboassembly.studio.request_queue import RequestQueue
from roboassembly.studio.scene_view import FRAMES_PER_SECOND
from roboassembly.studio.sources import Sources, find_below, open_path, open_plan
from roboassembly.studio.uploads import open_upload
from roboassembly.task.plans import plan_file
from roboassembly.task.plans.plan_file import Script

_PLAN = ".json"
_PROGRESS_INTERVAL = 0.1
"""Shortest time between two progress messages [s]."""


def open_first(config: StudioConfig) -> None:
    """Open the first furniture of a studio, so that it is cached for its first client.

    Raises:
        InputError: see `open_path`.
    """
    if not config.furniture.endswith(_PLAN):
        open_path(config.furniture, config.scale, with_grasps=SETTINGS[config.setting].needs_grasps)


class ClientSession:
    """Session of one client, with its own thread. Call `close` when the client has gone.

    Args:
        client: browser that shows the page.
        config: configuration of the studio.
    """

    def __init__(self, client: ClientHandle, config: StudioConfig) -> None:
        self.handle, self._config = client, config
        self._sources = Sources(config.folders)
        self.requests = RequestQueue()
        """Requests that wait for their turn."""
        self._cancelled = threading.Event()
        self.editor: AssemblyEditor | None = None
        """Editor of the open piece; None until one is open."""
        self._policies: dict[str, Policy] = {}
        self._closed = False
        self.panel = Panel(
            client.gui,
            self._sources.pieces(),
            config.policies,
            config.roots,
            PanelCallbacks(
                open=lambda: self.submit(self._open_piece),
                upload=self._submit_upload,
                open_folder=lambda name: self.submit(lambda: self.open_path(self._find_folder(name))),
                choose=lambda: self.submit(lambda: self._open_editor.update_form(), "choose"),
                join=lambda: self.submit(lambda: self._say(self._open_editor.join())),
                undo=lambda: self.submit(self._undo),
                suggest=lambda: self.submit(lambda: self._say(self._open_editor.suggest(self._guide()))),
                run=lambda mode: self.submit(lambda: self._run(mode)),
                cancel=self._cancelled.set,
                scrub=lambda: self.submit(lambda: self._open_editor.scrub(), "scrub"),
                toggle_playback=lambda: self.submit(lambda: self._open_editor.toggle_playback()),
                change_view=lambda: self.submit(lambda: self._open_editor.change_view(), "view"),
                save=lambda name: self.submit(lambda: self._save(name)),
            ),
        )
        self.panel.setting.value, self.panel.seed.value = config.setting, config.seed
        client.scene.on_click()(self._clicked)
        self.submit(lambda: self.open_path(config.furniture))
        self._thread = threading.Thread(target=self._serve, name=f"client-{client.client_id}", daemon=True)
        self._thread.start()

    @property
    def session(self) -> AssemblySession | None:
        """Session of the open piece; None until one is open."""
        return None if self.editor is None else self.editor.session

    @property
    def is_running(self) -> bool:
        """Whether the thread of the session is running."""
        return self._thread.is_alive()

    def close(self) -> None:
        """Stop the thread after the current request."""
        self._closed = True
        self.submit(lambda: None)

    def submit(self, request: Callable[[], None], once: str = "") -> None:
        """Queue a request for the thread of the session.

        Args:
            request: function to call.
            once: see `RequestQueue.add`.
        """
        if not self.requests.add(request, once):
            self._say("✗ Too many requests are waiting. Try again in a moment.")

    def _serve(self) -> None:
        try:
            self._handle_requests()
        finally:
            if not self._closed:
                self._say("✗ An internal error occurred; the terminal shows it. Reload the page.")

    def _handle_requests(self) -> None:
        """Carry out requests in turn, and advance the playback between them."""
        while True:
            due = time.monotonic() + 1.0 / FRAMES_PER_SECOND
            moving = self.editor if self.editor is not None and self.editor.view.is_playing else None
            try:
                request = self.requests.next(timeout=None if moving is None else 1.0 / FRAMES_PER_SECOND)
            except queue.Empty:
                if moving is not None:
                    moving.advance(max(0.0, time.monotonic() - due))
                continue
            if self._closed:
                return
            self._cancelled.clear()
            try:
                request()
            except RoboAssemblyError as error:
                self._say(f"✗ {error}")

    # Opening

    def _open_piece(self) -> None:
        source, piece, number = self.panel.source.value, self.panel.piece.value, int(self.panel.number.value)
        self._open(lambda: self._sources.open(source, piece, number, with_grasps=self._needs_grasps))

    def open_path(self, path: str) -> None:
        """Open furniture by name or path, or open and repeat a plan.

        Raises:
            InputError: the path cannot be opened.
        """
        if path.endswith(_PLAN):
            script, furniture = open_plan(Path(path))
            self._open(lambda: furniture, script)
            self._repeat(script)
        else:
            self._open(lambda: open_path(path, self._config.scale, with_grasps=self._needs_grasps))

    def _find_folder(self, name: str) -> str:
        """Return the path of a folder that the client may open by name."""
        if not name.strip():
            raise InputError("the name of the folder is empty")
        return str(find_below(self._config.roots, name.strip()))

    @property
    def _needs_grasps(self) -> bool:
        return SETTINGS[self.panel.setting.value].needs_grasps

    def _submit_upload(self, file: UploadedFile) -> None:
        """Queue an uploaded file; it is kept only until it has been read."""

        def read() -> None:
            try:
                self.open_upload(file)
            finally:
                self.panel.forget_upload()

        if not self.requests.add(read):
            self.panel.forget_upload()
            self._say("✗ Too many requests are waiting. Upload the file again in a moment.")

    def open_upload(self, file: UploadedFile) -> None:
        """Open uploaded furniture, or repeat an uploaded plan on the open furniture.

        Raises:
            InputError: the file cannot be opened.
        """
        if file.name.lower().endswith(_PLAN):
            script = plan_file.decode(file.content, Path(file.name).name)
            session = self._open_session
            self._open(
                lambda: session.furniture_with(grasps=SETTINGS[script.setting].needs_grasps),
                script,
            )
            self._repeat(script)
            return
        self._say(f"Reading {Path(file.name).name}. Repair may take a while …")
        self._open(lambda: open_upload(file.name, file.content, self._config.scale))

    def _open(self, make: Callable[[], Furniture], script: Script | None = None) -> None:
        """Open furniture in a new editor; the old one stays open if this fails.

        Args:
            make: returns the furniture.
            script: plan that sets the setting and the seed; the panel sets them if None.
        """
        panel = self.panel
        setting, seed = (
            (panel.setting.value, int(panel.seed.value)) if script is None else (script.setting, script.seed)
        )
        session = AssemblySession(make(), setting, seed)
        panel.setting.value, panel.seed.value = setting, seed
        with self.handle.atomic():
            if self.editor is not None:
                self.editor.close()
            self.editor = AssemblyEditor(self.handle, panel, session)
        self._say("Click a point of one part, then a point of another part, and press Join; or use the tab Run.")

    # Acting

    @property
    def _open_editor(self) -> AssemblyEditor:
        if self.editor is None:
            raise InputError("no furniture is open")
        return self.editor

    @property
    def _open_session(self) -> AssemblySession:
        return self._open_editor.session

    def _clicked(self, event: SceneClickEvent) -> None:
        """Find the clicked item now: parts may have moved when the request is carried out."""
        item = None if self.editor is None else self.editor.item_under(event)
        if item is not None:
            self.submit(lambda: self._open_editor.pick(*item))

    def _undo(self) -> None:
        self._open_editor.undo()
        self._say("The last step is undone.")

    def _save(self, name: str) -> None:
        send_plan(self.handle, self._open_session.plan(), name)
        self._say(f"Saved {name}.")

    def _say(self, text: str) -> None:
        self.panel.message.content = text

    # Running

    def _guide(self) -> Guide[Any]:
        return guide_of(self._policy(self.panel.policy.value))

    def _policy(self, name: str) -> Policy:
        if name not in self._config.policies:
            raise InputError("this policy is not offered; start the studio with --policies and its name")
        if name not in self._policies:
            self._policies[name] = load_policy(name)
        policy = self._policies[name]
        if self._open_session.setting not in settings_of(policy):
            raise InputError(f"the policy '{name}' does not choose grasps; use Search, which needs no policy")
        return policy

    def _repeat(self, script: Script) -> None:
        self._run_watched(lambda watch: self._open_session.repeat(script, watch), "Repeated the plan")

    def _run(self, mode: str) -> None:
        session = self._open_session
        if session.task_state.complete:
            raise InputError("the furniture is assembled; undo some steps or open other furniture first")
        guide = self._guide() if mode != "search" else None
        if mode == "alone" and guide is not None:
            self._run_watched(lambda watch: self._run_policy(guide, watch), "Assembled")
        else:
            self._run_watched(lambda watch: session.search(guide, watch), "Assembled")

    def _run_watched(self, work: Callable[[Watch], str], done: str) -> None:
        """Run something long with a progress bar, and show its result.

        Args:
            work: returns the reason of an early end; empty if there was none.
            done: first words of the message if there was none.
        """
        session = self._open_session
        before = session.merges
        self.panel.set_busy(True)
        try:
            reason = work(self._watch())
        finally:
            self.panel.set_busy(False)
        if session.merges > before:
            self._open_editor.view.append_new_steps()
        self._open_editor.refresh()
        count = f"{session.merges - before} merges, {session.planning_steps:,} states checked in total"
        self._say(f"✗ {reason}" if reason else f"✓ {done}: {count}.{upright_message(session.upright)}")

    def _watch(self) -> Watch:
        """Return a function that shows the progress of a run, and stops the run when it is cancelled."""
        session = self._open_session
        whole, before, last_shown = len(session.furniture.parts) - 1, session.merges, 0.0

        def watch(progress: SearchProgress) -> bool:
            nonlocal last_shown
            if time.monotonic() - last_shown > _PROGRESS_INTERVAL:
                last_shown = time.monotonic()
                merges = before + progress.merges
                self.panel.progress.value = 100.0 * merges / whole
                self._say(
                    f"… {merges} of {whole} merges, {progress.attempts} attempts, {progress.states:,} states checked"
                )
            return not (self._cancelled.is_set() or self._closed)

        return watch

    def _run_policy(self, guide: Guide[Any], watch: Watch) -> str:
        """Carry out the policy's preferred action until the piece is complete; returns the reason of an early end."""
        session, states = self._open_session, self._open_session.planning_steps
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
                return attempt_message(session.furniture, attempt).removeprefix("✗ ")
        return ""
