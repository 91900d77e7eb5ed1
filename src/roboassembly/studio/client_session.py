"""Session of one client: its requests are queued and carried out in turn by a thread of its own."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from viser import ClientHandle, SceneClickEvent, UploadedFile

from roboassembly.errors import InputError, RoboAssemblyError
from roboassembly.furniture.model import Furniture
from roboassembly.settings import SETTINGS
from roboassembly.studio.assembly_editor import AssemblyEditor
from roboassembly.studio.assembly_session import AssemblySession
from roboassembly.studio.camera_aim import CameraAim
from roboassembly.studio.config import StudioConfig
from roboassembly.studio.messages import plain
from roboassembly.studio.page_commands import PageCommand
from roboassembly.studio.page_link import Busy, Notice, PageState
from roboassembly.studio.panel import Panel, PanelCallbacks
from roboassembly.studio.request_queue import RequestQueue
from roboassembly.studio.runs import Runs
from roboassembly.studio.scene_view import FRAMES_PER_SECOND
from roboassembly.studio.sources import Sources, find_below, open_path, open_plan
from roboassembly.studio.step_pictures import PictureDrawer, StepLine
from roboassembly.studio.uploads import open_upload
from roboassembly.task.plans import plan_file
from roboassembly.task.plans.plan_file import Script

_PLAN = ".json"


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
        drawer: draws the pictures of all clients.
    """

    def __init__(self, client: ClientHandle, config: StudioConfig, drawer: PictureDrawer) -> None:
        self.handle, self._config, self._drawer = client, config, drawer
        self._sources = Sources(config.folders)
        self.requests = RequestQueue()
        """Requests that wait for their turn."""
        self.editor: AssemblyEditor | None = None
        """Editor of the open piece; None until one is open."""
        self._closed = False
        self._aim = CameraAim(client)
        self._busy: Busy | None = None
        self._failed: Notice | None = None
        """Message about a request that could not be carried out."""
        self._failures = 0
        self.panel = Panel(
            client.gui,
            self._sources.pieces(),
            config.policies,
            config.roots,
            PanelCallbacks(
                open=lambda: self.submit(self._open_piece),
                upload=self._submit_upload,
                open_folder=lambda name: self.submit(lambda: self.open_path(self._find_folder(name))),
                choose=lambda: self.submit(self._choose, "choose"),
                join=lambda: self.submit(lambda: self._say(self._open_editor.join())),
                undo=lambda: self.submit(self._undo),
                suggest=lambda: self.submit(self._suggest),
                run=lambda mode: self.submit(lambda: self._say(self.runs.run(self._open_editor, mode))),
                cancel=lambda: self.runs.cancelled.set(),
                scrub=lambda: self.submit(lambda: self._open_editor.scrub(), "scrub"),
                toggle_playback=lambda: self.submit(lambda: self._open_editor.toggle_playback()),
                change_view=lambda: self.submit(lambda: self._open_editor.change_view(), "view"),
                save=lambda name: self.submit(lambda: self._say(self.runs.save(self._open_editor, name))),
                command=self._obey,
            ),
            narrow=self._aim.is_narrow,
        )
        self.runs = Runs(client, self.panel, config.policies, self._show_busy)
        """Long work of this client."""
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
        """Stop the thread after the current request, which is cancelled if it can be."""
        self._closed = True
        self.runs.cancelled.set()
        self.submit(lambda: None)

    def submit(self, request: Callable[[], None], once: str = "") -> None:
        """Queue a request for the thread of the session.

        Args:
            request: function to call.
            once: see `RequestQueue.add`.
        """
        self._failed = None
        if not self.requests.add(request, once):
            self._say("✗ Too many requests are waiting. Try again in a moment.")

    def _submit_quietly(self, request: Callable[[], None], once: str) -> None:
        """Queue a request that nobody misses if there is no room for it, and that leaves messages alone."""
        self.requests.add(request, once)

    def _serve(self) -> None:
        try:
            self._handle_requests()
        finally:
            if not self._closed:
                self._say("✗ An internal error occurred; the terminal shows it. Reload the page.")

    def _handle_requests(self) -> None:
        """Carry out requests in turn, and advance the playback or the turntable between them."""
        while True:
            due = time.monotonic() + 1.0 / FRAMES_PER_SECOND
            moving = self.editor if self.editor is not None and self.editor.view.is_moving else None
            try:
                request = self.requests.next(timeout=None if moving is None else 1.0 / FRAMES_PER_SECOND)
            except queue.Empty:
                if moving is not None:
                    moving.advance(max(0.0, time.monotonic() - due))
                    self._publish()
                continue
            self.runs.cancelled.clear()
            # The event may have been set for the end of this thread.
            if self._closed:
                return
            try:
                request()
            except RoboAssemblyError as error:
                self._say(f"✗ {plain(str(error))}")
                self._failures += 1
                text = str(error)
                self._failed = Notice("bad", "That did not work", f"{text[:1].upper()}{text[1:]}.", self._failures)
            self._publish()

    # The page

    def _publish(self) -> None:
        """Show the state of the session on the page."""
        state = PageState() if self.editor is None else self.editor.page_state
        notice = self._failed or state.notice
        if notice is not None:
            # The page shows each number once: those of failed requests are odd.
            notice = replace(notice, number=2 * notice.number + (notice is self._failed))
        self.panel.link.show(replace(state, busy=self._busy, notice=notice))

    def _show_busy(self, busy: Busy | None) -> None:
        self._busy = busy
        self._publish()

    def _obey(self, command: PageCommand) -> None:
        """Carry out a command of the page."""
        editor = self.editor
        match command.word:
            case "cancel":
                self.runs.cancelled.set()
            case "pointer":
                self._submit_quietly(lambda: self._name(command), "pointer")
            case "touch":
                self._submit_quietly(self._stop_turning, "touch")
            case "slow":
                self._submit_quietly(self._slow_down, "slow")
            case "read":
                self.submit(lambda: None if editor is None else editor.forget_notice(), "read")
            case "assemble":
                self.submit(lambda: self._say(self.runs.assemble(self._open_editor)))
            case "steps":
                self.submit(self._begin_steps)
            case "play":
                self.submit(lambda: self._open_editor.toggle_playback())
            case "undo":
                self.submit(self._undo)
            case _:
                self.submit(lambda: self._open_editor.show_step(command.step))

    def _stop_turning(self) -> None:
        if self.editor is not None:
            self.editor.view.is_turning = False

    def _slow_down(self) -> None:
        if self.editor is not None:
            self.editor.view.is_slow = True

    def _begin_steps(self) -> None:
        self._open_editor.leave_opening()
        self._open_editor.refresh()

    def _name(self, command: PageCommand) -> None:
        if self.editor is not None:
            self.panel.link.show_name(command.serial, self.editor.name_at(*command.pointer))

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
            self._say(self.runs.repeat(self._open_editor, script))
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
            self._say(self.runs.repeat(self._open_editor, script))
            return
        name = Path(file.name).name
        self._say(f"Reading {plain(name)}. Repair may take a while …")
        self._show_busy(Busy(f"Reading {name} and repairing its parts …"))
        try:
            self._open(lambda: open_upload(file.name, file.content, self._config.scale))
        finally:
            self._show_busy(None)

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
            line = StepLine(self._drawer, lambda: self._submit_quietly(self._show_pictures, "pictures"))
            self.editor = AssemblyEditor(self.handle, panel, session, self._aim, line)
        self._say("")

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

    def _choose(self) -> None:
        self._open_editor.leave_opening()
        self._open_editor.update_form()

    def _suggest(self) -> None:
        self._say(self._open_editor.suggest(self.runs.guide(self._open_session)))

    def _undo(self) -> None:
        self._open_editor.undo()
        self._open_editor.forget_notice()
        self._say("The last step is undone.")

    def _show_pictures(self) -> None:
        if self.editor is not None:
            self.editor.show_pictures()

    def _say(self, text: str) -> None:
        self.panel.message.content = text
