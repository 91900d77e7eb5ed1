"""Panel of controls beside the scene. Each control only calls a callback."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from viser import GuiApi, GuiDropdownHandle, GuiEvent, GuiTextHandle, Icon, UploadedFile

from roboassembly.studio.downloads import DOWNLOADS
from roboassembly.studio.page_commands import PageCommand
from roboassembly.studio.page_link import PageLink
from roboassembly.studio.scene_view import COLORS, ViewOptions
from roboassembly.studio.sources import BUILT_IN
from roboassembly.studio.viser_internals import forget_upload

NONE = "—"
"""Value of a dropdown without a choice."""
PICKS = ("the moving part", "the waiting part")
"""Target of the next click in the scene."""
_BRAND = (97, 41, 3)
"""Darkest colour of buttons and tabs. viser makes ten from it; its buttons then have the colour of the page's."""
SETTINGS = ("object-centric", "full")


@dataclass(frozen=True)
class PanelCallbacks:
    """Callbacks of the controls. They run in threads of the server, possibly several at once, and must return fast."""

    open: Callable[[], None]
    """Called to open the chosen piece."""
    upload: Callable[[UploadedFile], None]
    """Called with an uploaded file."""
    open_folder: Callable[[str], None]
    """Called with the name of a folder."""
    choose: Callable[[], None]
    """Called when a component of the action changes."""
    join: Callable[[], None]
    undo: Callable[[], None]
    suggest: Callable[[], None]
    run: Callable[[str], None]
    """Called with `search`, `guided` or `alone`."""
    cancel: Callable[[], None]
    scrub: Callable[[], None]
    """Called when the time slider moves."""
    toggle_playback: Callable[[], None]
    change_view: Callable[[], None]
    """Called when a view option changes."""
    save: Callable[[str], None]
    """Called with one of `DOWNLOADS`."""
    command: Callable[[PageCommand], None]
    """Called with a command of the page."""


class Panel:
    """Controls of one client.

    Args:
        gui: GUI of the client.
        sources: names of pieces by source.
        policies: names of policies.
        roots: folders in which folders can be opened by name.
        callbacks: callbacks of the controls.
        narrow: put buttons above the choices, as a telephone shows only the first rows.
    """

    def __init__(
        self,
        gui: GuiApi,
        sources: dict[str, list[str]],
        policies: Sequence[str],
        roots: Sequence[Path],
        callbacks: PanelCallbacks,
        *,
        narrow: bool = False,
    ) -> None:
        self._gui, self._sources = gui, sources
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=_BRAND)
        gui.main_panel.dock_right()
        gui.set_panel_label("RoboAssembly")
        self.link = PageLink(gui, callbacks.command)
        """Link to the page around the scene."""
        self.status = gui.add_markdown("")
        self.message = gui.add_markdown("")
        self.progress = gui.add_progress_bar(0.0, visible=False, animated=True)
        self.cancel = gui.add_button("Cancel", icon=Icon.X, color="red", visible=False)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Steps"):
            self._add_joining(callbacks, narrow=narrow)
        with tabs.add_tab("Assemble"):
            self._add_running(policies, callbacks)
        with tabs.add_tab("Pieces"):
            self._add_opening(roots, callbacks)
        with tabs.add_tab("View"):
            self._add_view_options(callbacks)
        with tabs.add_tab("Save"):
            self._add_downloads(callbacks)
        # Below the tabs if the page does not hide it: a page hides only what it can find, so it is in no tab.
        self.upload = gui.add_upload_button(
            "Bring your own", icon=Icon.UPLOAD,
            hint="A ZIP archive of STL, OBJ, PLY or GLB files (one file per part, in assembled poses), one STEP, 3MF "
            "or GLB file, or a plan.json for the furniture that is open.",
        )  # fmt: skip
        self.upload.on_upload(lambda event: callbacks.upload(event.target.value))
        self.link.hide(self.upload, [self.cancel])
        self.cancel.on_click(lambda _: callbacks.cancel())

    def _add_joining(self, callbacks: PanelCallbacks, *, narrow: bool) -> None:
        gui = self._gui
        self.explanation = gui.add_markdown("")
        if narrow:
            self._add_actions(callbacks)
        self.next = _dropdown(gui, "A click chooses", PICKS)
        self.u = _dropdown(gui, "Moves", hint="The part that comes. All that is joined to it comes along.")
        self.k = _dropdown(gui, "by point", hint="Its connection point that meets the other part.")
        self.v = _dropdown(gui, "Waits", hint="The part that it is joined to, with all that is joined to that.")
        self.l = _dropdown(gui, "at point", hint="The connection point where the moving part arrives.")
        self.choices = [_dropdown(gui, "", visible=False, hint=" ") for _ in range(2)]
        for control in (self.u, self.k, self.v, self.l, *self.choices):
            _on_user_change(control, callbacks.choose)
        if not narrow:
            self._add_actions(callbacks)

    def _add_actions(self, callbacks: PanelCallbacks) -> None:
        gui = self._gui
        self.join = gui.add_button("Join", icon=Icon.LINK, color="green")
        self.undo = gui.add_button("Undo", icon=Icon.ARROW_BACK_UP, color="gray")
        self.suggest = gui.add_button(
            "Suggest", icon=Icon.BULB, color="gray", hint="Fill in the action that the policy prefers."
        )
        self.join.on_click(lambda _: callbacks.join())
        self.undo.on_click(lambda _: callbacks.undo())
        self.suggest.on_click(lambda _: callbacks.suggest())

    def _add_running(self, policies: Sequence[str], callbacks: PanelCallbacks) -> None:
        gui = self._gui
        gui.add_markdown("Let the studio find the rest of the steps. It goes on from what is joined already.")
        self.policy = _dropdown(gui, "Policy", policies, hint="It suggests which parts to join next, and how.")
        self.runs = {
            name: gui.add_button(label, hint=hint)
            for name, label, hint in (
                ("search", "Search", "Plan by disassembly, without a policy."),
                ("guided", "Policy and search", "Try the policy's suggestions first; search leaves dead ends."),
                ("alone", "Policy alone", "Run the policy without search; the first failure ends the run."),
            )
        }
        for name, button in self.runs.items():
            button.on_click(lambda _, name=name: callbacks.run(name))

    def _add_opening(self, roots: Sequence[Path], callbacks: PanelCallbacks) -> None:
        gui = self._gui
        self.source = _dropdown(gui, "From", tuple(self._sources))
        self.piece = _dropdown(gui, "Piece", tuple(self._sources[BUILT_IN]))
        self.number = gui.add_number(
            "Which", 0, min=0, max=10**6, step=1, hint="Each number is a different piece of the family."
        )
        self.setting = gui.add_dropdown(
            "Moved by",
            SETTINGS,
            hint="object-centric: parts move by themselves. full: two mobile Franka robots move them.",
        )
        self.seed = gui.add_number(
            "Seed", 0, min=0, max=10**6, step=1, hint="Seed of the initial placement and of the planner."
        )
        opening = gui.add_button("Open", icon=Icon.FOLDER_OPEN)
        opening.on_click(lambda _: callbacks.open())
        _on_user_change(self.source, self._list_pieces)
        self.path: GuiTextHandle | None = None
        if roots:
            hint = f"A folder of furniture or of 3D files on the server, in {', '.join(map(str, roots))}."
            self.path = path = gui.add_text("Folder", "", hint=hint)
            button = gui.add_button("Open folder", icon=Icon.FOLDER)
            button.on_click(lambda _: callbacks.open_folder(path.value))

    def _add_view_options(self, callbacks: PanelCallbacks) -> None:
        gui = self._gui
        self.color = gui.add_dropdown("Colour by", COLORS)
        self.points = gui.add_checkbox("Connection points", True)
        self.frames = gui.add_checkbox("Frames of the points", False)
        self.grasps = gui.add_checkbox("Grasp regions", False)
        self.path_line = gui.add_checkbox("Path of the moving group", True)
        for control in (self.color, self.points, self.frames, self.grasps, self.path_line):
            _on_user_change(control, callbacks.change_view)
        self.time = gui.add_slider(
            "Time", 0, 1, 1, 0, hint="Drag to see earlier steps. Joining always continues at the end."
        )
        self.play_button = gui.add_button("Play", icon=Icon.PLAYER_PLAY)
        self.play_button.on_click(lambda _: callbacks.toggle_playback())
        _on_user_change(self.time, callbacks.scrub)

    def _add_downloads(self, callbacks: PanelCallbacks) -> None:
        gui = self._gui
        gui.add_markdown("Files of the steps so far:")
        self.saves = {
            name: gui.add_button(label, icon=Icon.DOWNLOAD, hint=f"{name}: {hint}")
            for name, (label, hint) in DOWNLOADS.items()
        }
        for name, button in self.saves.items():
            button.on_click(lambda _, name=name: callbacks.save(name))

    def _list_pieces(self) -> None:
        self.piece.options = tuple(self._sources[self.source.value])
        self.number.visible = self.source.value == BUILT_IN

    def forget_upload(self) -> None:
        """Release the memory of the uploaded file."""
        forget_upload(self.upload)

    @property
    def view_options(self) -> ViewOptions:
        """Current view options."""
        shown = (c.value for c in (self.points, self.frames, self.grasps, self.path_line))
        return ViewOptions(self.color.value, *shown)

    def set_busy(self, busy: bool) -> None:
        """Show the progress bar and disable the buttons that start something, or the reverse."""
        self.progress.visible = self.cancel.visible = busy
        for button in (self.join, self.undo, self.suggest, *self.runs.values(), *self.saves.values()):
            button.disabled = busy


def _dropdown(
    gui: GuiApi, label: str, options: Sequence[str] = (NONE,), *, visible: bool = True, hint: str | None = None
) -> GuiDropdownHandle[str]:
    """Add a dropdown whose options may change."""
    return gui.add_dropdown(label, options, visible=visible, hint=hint)


def _on_user_change(control: Any, call: Callable[[], None]) -> None:
    """Call `call` when a client changes the control, not when the program does."""

    def on_update(event: GuiEvent[Any]) -> None:
        if event.client is not None:
            call()

    control.on_update(on_update)
