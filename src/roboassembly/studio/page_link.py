"""Link between a session and the page around viser's scene.

viser offers no channel of its own to a page, but it has controls. The page types commands into a text control, which
`page_commands` checks, and reads the state of the session from HTML elements that it hides.
"""

from __future__ import annotations

import html
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

from viser import GuiApi, GuiEvent, GuiHtmlHandle, GuiTextHandle

from roboassembly.studio.page_commands import LINK, PageCommand, parse_command
from roboassembly.studio.viser_internals import identifier_of


@dataclass(frozen=True)
class Busy:
    """Work in progress that the page shows."""

    text: str
    percent: float | None = None
    """Share that is done, 0 to 100; None if nobody knows."""
    cancel: bool = False
    """Whether it can be cancelled."""


@dataclass(frozen=True)
class Notice:
    """Message that the page shows in the scene until it is read or replaced."""

    kind: str
    """`bad`, `good` or `info`."""
    title: str
    text: str = ""
    number: int = 0
    """Number of the message; the page shows each number once."""


@dataclass(frozen=True)
class StepPicture:
    """Step on the time line; the first one is the start."""

    text: str
    picture: str = ""
    """JPEG picture as a `data:` address; empty until it is drawn."""


@dataclass(frozen=True)
class PageState:
    """State of a session that the page shows."""

    mode: str = "opening"
    """`opening` while the finished piece is shown, else `work`."""
    piece: str = ""
    """Name of the piece and its number of parts."""
    merges: int = 0
    is_playing: bool = False
    step: int = 0
    """Step of the time line whose frames are shown."""
    busy: Busy | None = None
    notice: Notice | None = None


class PageLink:
    """Controls of one client that link its page to its session.

    Args:
        gui: GUI of the client.
        call: called with each command, in a thread of the server.
    """

    def __init__(self, gui: GuiApi, call: Callable[[PageCommand], None]) -> None:
        self._control = gui.add_text(LINK, "")
        self._state, self._steps, self._name = (gui.add_html("") for _ in range(3))
        self._controls: dict[str, object] = {}
        self._shown: PageState | None = None

        def on_update(event: GuiEvent[GuiTextHandle]) -> None:
            command = None if event.client is None else parse_command(self._control.value)
            if command is not None:
                call(command)

        self._control.on_update(on_update)

    @property
    def elements(self) -> tuple[GuiHtmlHandle, ...]:
        """Elements that only the page reads: the state, the time line, and the name under the pointer."""
        return self._state, self._steps, self._name

    def hide(self, upload: object, controls: Sequence[object] = ()) -> None:
        """Tell the page which controls it replaces and hides.

        Args:
            upload: upload button, which the page fills with dropped files.
            controls: further controls.
        """
        hidden = [identifier_of(control) for control in (self._control, upload, *controls)]
        self._controls = {"link": hidden[0], "upload": hidden[1], "hidden": hidden}

    def show(self, state: PageState) -> None:
        """Send the state, if it has changed."""
        if state != self._shown:
            self._shown = state
            _send(self._state, "studio-state", self._controls | asdict(state))

    def show_steps(self, steps: Sequence[StepPicture]) -> None:
        """Send the time line."""
        _send(self._steps, "studio-pictures", [asdict(step) for step in steps])

    def show_name(self, serial: int, text: str) -> None:
        """Send the name of what is under the pointer.

        Args:
            serial: number of the command with the place of the pointer.
            text: name; empty if nothing is there.
        """
        _send(self._name, "studio-hover", {"serial": serial, "text": text})


def _send(element: GuiHtmlHandle, name: str, value: object) -> None:
    """Set an element's content to a value that only the page's script reads."""
    element.content = f'<div id="{name}" hidden data-json="{html.escape(json.dumps(value), quote=True)}"></div>'
