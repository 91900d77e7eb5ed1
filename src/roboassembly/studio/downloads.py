"""Files that a browser gets."""

from __future__ import annotations

import tempfile
from pathlib import Path

from viser import ClientHandle
from viser._messages import FileTransferPart

from roboassembly.errors import InputError
from roboassembly.task.plans import plan_file
from roboassembly.viewer.html import write_html
from roboassembly.viewer.playback import AnyPlan

MOST_UNSENT = 50_000_000
"""Bytes of files on their way to a client; more are made only once it has fetched these."""


def send_plan(client: ClientHandle, plan: AnyPlan, name: str) -> None:
    """Send a plan as `plan.json` or as `assembly.html`.

    Raises:
        InputError: the client does not fetch the files that it asked for before.
    """
    buffer = client._websock_connection.get_message_buffer()
    with buffer.buffer_lock:
        unsent = sum(len(m.content) for m in buffer.message_from_id.values() if isinstance(m, FileTransferPart))
    if unsent > MOST_UNSENT:
        raise InputError("the last files are still on their way; wait until they are here")
    if name == "plan.json":
        content = plan_file.encode(plan)
    else:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / name
            write_html(plan, path)
            content = path.read_bytes()
    client.send_file_download(name, content, save_immediately=True)
