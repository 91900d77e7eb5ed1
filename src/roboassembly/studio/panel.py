"""The controls beside the scene. They do nothing themselves: each calls what it is given."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from viser import GuiApi, GuiDropdownHandle, GuiTextHandle, Icon, UploadedFile

from roboassembly.studio.screen import COLORS, Look
from roboassembly.studio.wares import BUILT_IN

NONE = "—"
"""Chosen where nothing is."""
PICKS = ("what moves", "what waits")
SETTINGS = ("object-centric", "full")


@dataclass(frozen=True)
class Actions:
    """What the controls call, in the browser's threads: quick, and from several at once."""

    open: Callable[[], None]
    upload: Callable[[UploadedFile], None]
    open_path: Callable[[str], None]
    choose: Callable[[], None]
    """A part, a point or a way was chosen."""
    join: Callable[[], None]
    undo: Callable[[], None]
    suggest: Callable[[], None]
    run: Callable[[str], None]
    """`search`, `guided` or `alone`."""
    cancel: Callable[[], None]
    scrub: Callable[[], None]
    play: Callable[[], None]
    look: Callable[[], None]
    save: Callable[[str], None]
    """`plan.json` or `assembly.html`."""


class Panel:
    """All controls of one visitor.

    Args:
        gui: of the visitor's browser.
        sources: pieces by where they come from.
        policies: names.
        roots: folders that others may be opened in, by name.
        actions: called.
    """

    def __init__(
        self,
        gui: GuiApi,
        sources: dict[str, list[str]],
        policies: Sequence[str],
        roots: Sequence[Path],
        actions: Actions,
    ) -> None:
        self._gui, self._sources = gui, sources
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        gui.set_panel_label("RoboAssembly")
        self.status = gui.add_markdown("")
        self.message = gui.add_markdown("")
        self.progress = gui.add_progress_bar(0.0, visible=False, animated=True)
        self.cancel = gui.add_button("Cancel", icon=Icon.X, color="red", visible=False)
        self.time = gui.add_slider("Time", 0, 1, 1, 0, hint="Drag to go back and forth; joining goes on at the end.")
        self.play = gui.add_button("Play", icon=Icon.PLAYER_PLAY)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Join"):
            self._add_joining(actions)
        with tabs.add_tab("Run"):
            self._add_running(policies, actions)
        with tabs.add_tab("Furniture"):
            self._add_opening(roots, actions)
        with tabs.add_tab("Show"):
            self._add_looking(actions)
        self.cancel.on_click(lambda _: actions.cancel())
        self.play.on_click(lambda _: actions.play())
        _by_hand(self.time, actions.scrub)

    def _add_joining(self, actions: Actions) -> None:
        gui = self._gui
        self.next = _dropdown(gui, "A click picks", PICKS)
        self.u = _dropdown(gui, "Moves")
        self.k = _dropdown(gui, "by point")
        self.v = _dropdown(gui, "Waits")
        self.l = _dropdown(gui, "at point")
        self.ways = [_dropdown(gui, "", visible=False) for _ in range(2)]
        for control in (self.u, self.k, self.v, self.l, *self.ways):
            _by_hand(control, actions.choose)
        self.join = gui.add_button("Join", icon=Icon.LINK, color="green")
        self.undo = gui.add_button("Undo", icon=Icon.ARROW_BACK_UP)
        self.suggest = gui.add_button("Suggest", icon=Icon.BULB, hint="What the policy would do now.")
        self.join.on_click(lambda _: actions.join())
        self.undo.on_click(lambda _: actions.undo())
        self.suggest.on_click(lambda _: actions.suggest())

    def _add_running(self, policies: Sequence[str], actions: Actions) -> None:
        gui = self._gui
        self.policy = _dropdown(gui, "Policy", policies)
        self.runs = {
            name: gui.add_button(label, hint=hint)
            for name, label, hint in (
                ("search", "Search", "By reasoning alone: taking the furniture apart in the mind."),
                ("guided", "Policy and search", "The policy's suggestions first; dead ends are backed out of."),
                ("alone", "Policy alone", "As in training: its first failure ends it."),
            )
        }
        for name, button in self.runs.items():
            button.on_click(lambda _, name=name: actions.run(name))

    def _add_opening(self, roots: Sequence[Path], actions: Actions) -> None:
        gui = self._gui
        self.source = _dropdown(gui, "From", tuple(self._sources))
        self.piece = _dropdown(gui, "Piece", tuple(self._sources[BUILT_IN]))
        self.number = gui.add_number(
            "Which", 0, min=0, max=10**6, step=1, hint="Each number is another piece of a family."
        )
        self.setting = gui.add_dropdown("Moved by", SETTINGS, hint="full: two mobile Frankas move the parts.")
        self.seed = gui.add_number("Seed", 0, min=0, max=10**6, step=1, hint="Where the parts lie at first.")
        opening = gui.add_button("Open", icon=Icon.FOLDER_OPEN)
        opening.on_click(lambda _: actions.open())
        _by_hand(self.source, self._list_pieces)
        self.upload = gui.add_upload_button(
            "Bring your own", icon=Icon.UPLOAD,
            hint="A ZIP archive of STL, OBJ, PLY or GLB files, one a part, as they stand assembled; one GLB scene; or "
            "the plan.json of the furniture shown.",
        )  # fmt: skip
        self.upload.on_upload(lambda event: actions.upload(event.target.value))
        self.path: GuiTextHandle | None = None
        if roots:
            hint = (
                f"Of furniture, or of 3D files, in {', '.join(map(str, roots))} on the machine that serves this page."
            )
            self.path = path = gui.add_text("Folder", "", hint=hint)
            button = gui.add_button("Open folder", icon=Icon.FOLDER)
            button.on_click(lambda _: actions.open_path(path.value))

    def _add_looking(self, actions: Actions) -> None:
        gui = self._gui
        self.color = gui.add_dropdown("Colours tell", COLORS)
        self.points = gui.add_checkbox("Connection points", True)
        self.frames = gui.add_checkbox("Their frames", False)
        self.grasps = gui.add_checkbox("Grasp regions", False)
        self.way = gui.add_checkbox("Way of what moves", True)
        for control in (self.color, self.points, self.frames, self.grasps, self.way):
            _by_hand(control, actions.look)
        for name in ("plan.json", "assembly.html"):
            button = gui.add_button(f"Save {name}", icon=Icon.DOWNLOAD)
            button.on_click(lambda _, name=name: actions.save(name))

    def _list_pieces(self) -> None:
        self.piece.options = tuple(self._sources[self.source.value])
        self.number.visible = self.source.value == BUILT_IN

    def forget_upload(self) -> None:
        """Keep the file that came no longer."""
        self.upload._impl.value = UploadedFile("", b"")

    @property
    def look(self) -> Look:
        """What is to be seen."""
        shown = (c.value for c in (self.points, self.frames, self.grasps, self.way))
        return Look(self.color.value, *shown)

    def busy(self, busy: bool) -> None:
        """While something runs it can be cancelled, and nothing else can be started."""
        self.progress.visible = self.cancel.visible = busy
        for button in (self.join, self.undo, self.suggest, *self.runs.values()):
            button.disabled = busy


def _dropdown(gui: GuiApi, label: str, options: Sequence[str] = (NONE,), **told: Any) -> GuiDropdownHandle[str]:
    """One whose options may change."""
    return gui.add_dropdown(label, options, **told)


def _by_hand(control: Any, call: Callable[[], None]) -> None:
    """Call when a person changes the control, not when the program does."""
    control.on_update(lambda event: call() if event.client is not None else None)
