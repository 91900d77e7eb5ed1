"""Downloads: plans and pages that a client saves."""

from __future__ import annotations

import tempfile
from pathlib import Path

from viser import ClientHandle

from roboassembly.errors import InputError
from roboassembly.studio.viser_internals import unsent_file_bytes
from roboassembly.task.plans import plan_file
from roboassembly.viewer.html import write_html
from roboassembly.viewer.playback import AnyPlan

MOST_UNSENT = 50_000_000
"""Largest size of the files on their way to a client [bytes]; beyond it, no further file is made."""


def send_plan(client: ClientHandle, plan: AnyPlan, name: str) -> None:
    """Send a plan as `plan.json` or as `assembly.html`.

    Raises:
        InputError: the client has not received its earlier files yet.
    """
    if unsent_file_bytes(client) > MOST_UNSENT:
        raise InputError("the last files are still being sent; wait until they have arrived")
    if name == "plan.json":
        content = plan_file.encode(plan)
    else:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / name
            write_html(plan, path)
            content = path.read_bytes()
    client.send_file_download(name, content, save_immediately=True)
