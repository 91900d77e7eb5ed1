"""Downloads: plans, pages, films and manuals that a client saves."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

from viser import ClientHandle

from roboassembly.errors import InputError
from roboassembly.studio.assembly_session import AssemblySession
from roboassembly.studio.viser_internals import unsent_file_bytes
from roboassembly.task.plans import plan_file
from roboassembly.viewer.film import write_film
from roboassembly.viewer.html import write_html

DOWNLOADS = {
    "plan.json": ("Plan", "all steps and paths, for the command line and for this page"),
    "assembly.html": ("Page", "plays in any browser, without the studio"),
    "film.mp4": ("Film", "a video; drawing it takes a while"),
    "manual.pdf": ("Manual to print", "line drawings for people, A4"),
    "manual.html": ("Manual to read", "the same as one page for the browser"),
}
"""Label and explanation of each file."""
MOST_UNSENT = 50_000_000
"""Largest size of the files on their way to a client [bytes]; beyond it, no further file is made."""


def send_file(client: ClientHandle, session: AssemblySession, name: str, watch: Callable[[float], bool]) -> bool:
    """Make a file of a session and send it.

    Args:
        client: browser that gets the file.
        session: steps so far.
        name: one of `DOWNLOADS`.
        watch: called with the share that is done, 0 to 1, from time to time; the work stops if it returns False.

    Returns:
        Whether the file was sent; False if the work was stopped.

    Raises:
        InputError: the client has not received its earlier files yet, or the piece is not assembled and the file is a
            manual.
        RenderingUnavailableError: this machine cannot draw a film.
        ManualError: the planner finds no order for people.
    """
    if unsent_file_bytes(client) > MOST_UNSENT:
        raise InputError("the last files are still being sent; wait until they have arrived")
    content = _content(session, name, watch)
    if content is not None:
        client.send_file_download(name, content, save_immediately=True)
    return content is not None


def _content(session: AssemblySession, name: str, watch: Callable[[float], bool]) -> bytes | None:
    """Return the contents of a file; None if the work was stopped."""
    if name == "plan.json":
        return plan_file.encode(session.plan())
    if name.startswith("manual"):
        pdf, html = session.make_manual()
        return pdf if name.endswith(".pdf") else html.encode()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        if name == "assembly.html":
            write_html(session.plan(), path)
        elif not write_film(session.plan(), path, watch=watch):
            return None
        return path.read_bytes()
