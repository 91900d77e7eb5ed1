"""Private parts of viser 1.1 that the studio uses; viser offers no public access to them."""

# pyright: reportPrivateUsage=false

from __future__ import annotations

from typing import Any

import viser
from viser import ClientHandle, GuiUploadButtonHandle, UploadedFile, ViserServer
from viser._messages import FileTransferPart, GuiUpdateMessage
from websockets.asyncio.server import ServerConnection


def check_viser(server: ViserServer) -> None:
    """Check that the private parts for the check of messages exist.

    Raises:
        RuntimeError: this version of viser does not have them.
    """
    places = (
        (server._websock_server, "_live_connections"), (server, "_connected_clients"),
        (server.gui, "_gui_input_handle_from_uuid"), (server.gui, "_current_file_upload_states"),
    )  # fmt: skip
    for owner, name in places:
        if not isinstance(getattr(owner, name, None), dict):
            raise RuntimeError(
                f"viser {viser.__version__} has no {name}, which the check of messages needs; install viser 1.1"
            )


def live_connections(server: ViserServer) -> list[tuple[int, ServerConnection]]:
    """Return all open connections by the number of their client."""
    return list(server._websock_server._live_connections.items())


def connected_client(server: ViserServer, number: int) -> ClientHandle | None:
    """Return the client of a number; None until it has sent its camera."""
    return server._connected_clients.get(number)


def controls_of(client: ClientHandle) -> dict[str, Any]:
    """Return a copy of the controls of a client by their identifiers; other threads may add controls meanwhile."""
    return dict(client.gui._gui_input_handle_from_uuid)


def control_of(client: ClientHandle, identifier: str) -> Any | None:
    """Return a control of a client; None if it has none of this identifier."""
    return client.gui._gui_input_handle_from_uuid.get(identifier)


def is_removed(control: Any) -> bool:
    """Whether a control has been removed."""
    return control._impl.removed


def identifier_of(control: Any) -> str:
    """Return the identifier of a control."""
    return control._impl.uuid


def resend_value(control: Any) -> None:
    """Send the current value of a control to its client."""
    if not control._impl.is_button and isinstance(control.value, bool | int | float | str):
        update = GuiUpdateMessage(control._impl.uuid, {"value": control.value})
        control._impl.gui_api._websock_interface.queue_message(update)


def uploads_in_progress(client: ClientHandle) -> dict[str, Any]:
    """Return the uploads of a client that viser is receiving, by their identifiers."""
    return client.gui._current_file_upload_states  # pyright: ignore[reportReturnType]


def forget_upload(button: GuiUploadButtonHandle) -> None:
    """Release the memory of the last uploaded file."""
    button._impl.value = UploadedFile("", b"")  # pyright: ignore[reportUnknownMemberType]


def unsent_file_bytes(client: ClientHandle) -> int:
    """Return the size of the files on their way to a client [bytes]."""
    buffer = client._websock_connection.get_message_buffer()
    with buffer.buffer_lock:
        return sum(len(m.content) for m in buffer.message_from_id.values() if isinstance(m, FileTransferPart))
