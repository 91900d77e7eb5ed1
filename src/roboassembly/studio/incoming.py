"""What browsers may say: each message is checked here, before viser sees it.

viser believes its clients: it sets whatever property of a control a message names, to whatever value, and has handlers
for messages that the studio does not use. Here a message must be one of the five kinds that the page needs, have the
right shape and finite numbers; and a control takes only a value that it offers to that client. All else is dropped, and
the page says why if a person could have caused it.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import msgspec
import viser
from msgspec import Meta, Struct
from viser import ClientHandle, GuiUploadButtonHandle, ViserServer
from viser._messages import GuiUpdateMessage
from websockets.asyncio.server import ServerConnection

from roboassembly.studio.house import LARGEST_UPLOAD
from roboassembly.studio.values import Refused, check_text, check_value

MOST_CONNECTIONS = 128
"""Open at a time, in any state."""
MOST_UPLOADED = 400_000_000
"""Bytes of files that all clients together send, or wait to have read."""
_MESSAGES_PER_SECOND, _BURST = 200.0, 400.0
"""More than that of one connection wait in its socket. The page sends at most 50 a second of each kind."""
_MOST_UNSENT = 256_000_000
"""Bytes that wait for a client to read them."""
_REFUSALS_EVERY = 1.0
"""Seconds between two notifications of refusals to a client."""
_FARTHEST = 1e6
"""Metres of a camera or a ray from the origin."""

_Name = Annotated[str, Meta(max_length=64)]
_Vector = tuple[float, float, float]
_Positive = Annotated[float, Meta(gt=0.0, le=_FARTHEST)]
_Pixels = Annotated[float, Meta(ge=1.0, le=65_536.0)]


class _Message(Struct, tag_field="type", forbid_unknown_fields=True):
    pass


class _Camera(_Message, tag="ViewerCameraMessage"):
    wxyz: tuple[float, float, float, float]
    position: _Vector
    fov: Annotated[float, Meta(gt=0.0, lt=math.pi)]
    near: _Positive
    far: _Positive
    image_height: _Pixels
    image_width: _Pixels
    look_at: _Vector
    up_direction: _Vector


class _Click(_Message, tag="ScenePointerMessage"):
    event_type: Literal["click"]
    ray_origin: _Vector
    ray_direction: _Vector
    screen_pos: tuple[tuple[float, float]]
    modifier: Annotated[str, Meta(max_length=32)] | None


class _Value(Struct, forbid_unknown_fields=True):
    value: bool | int | float | str


class _Update(_Message, tag="GuiUpdateMessage"):
    uuid: _Name
    updates: _Value


class _Start(_Message, tag="FileTransferStartUpload"):
    source_component_uuid: _Name
    transfer_uuid: _Name
    filename: str
    mime_type: Annotated[str, Meta(max_length=200)]
    part_count: Annotated[int, Meta(ge=0, le=1000)]
    size_bytes: Annotated[int, Meta(ge=0)]


class _Part(_Message, tag="FileTransferPart"):
    source_component_uuid: _Name
    transfer_uuid: _Name
    part_index: Annotated[int, Meta(ge=0, lt=1000)]
    content: bytes


_DECODER = msgspec.msgpack.Decoder(_Camera | _Click | _Update | _Start | _Part)


@dataclass
class _Upload:
    """A file that is coming in."""

    transfer: str
    size: int
    """Bytes of the file, by what the client says."""
    parts: int
    """Number of parts."""
    indices: set[int] = field(default_factory=set)
    """Indices of the parts received."""
    received: int = 0
    """Bytes received."""


class Clients:
    """The clients of a server, found by their connections."""

    def __init__(self) -> None:
        self._server: ViserServer | None = None

    def belong_to(self, server: ViserServer) -> None:
        """Look for clients in this server.

        Raises:
            RuntimeError: this version of viser keeps them elsewhere.
        """
        places = (
            (server._websock_server, "_live_connections"), (server, "_connected_clients"),
            (server.gui, "_gui_input_handle_from_uuid"), (server.gui, "_current_file_upload_states"),
        )  # fmt: skip
        for owner, name in places:
            if not isinstance(getattr(owner, name, None), dict):
                raise RuntimeError(
                    f"viser {viser.__version__} has no {name}, by which messages are checked; install 1.1"
                )
        self._server = server

    def of(self, connection: StudioConnection) -> ClientHandle | None:
        """The client of a connection; None until it sent its camera."""
        if self._server is None:
            return None
        number = next((n for n, c in self._connections() if c is connection), None)
        return None if number is None else self._server._connected_clients.get(number)

    def uploaded(self) -> int:
        """Bytes of all files that are coming in or are not read yet."""
        if self._server is None:
            return 0
        coming = sum(c.uploading for _, c in self._connections() if isinstance(c, StudioConnection))
        controls = (c for client in self._server.get_clients().values() for c in _controls(client).values())
        return coming + sum(len(c.value.content) for c in controls if isinstance(c, GuiUploadButtonHandle))

    def _connections(self) -> list[tuple[int, ServerConnection]]:
        return [] if self._server is None else list(self._server._websock_server._live_connections.items())


class StudioConnection(ServerConnection):
    """A connection that hands on only messages that are allowed.

    Args:
        clients: clients of the server.
    """

    def __init__(self, *args: Any, clients: Clients, **limits: Any) -> None:
        super().__init__(*args, **limits)
        self._clients = clients
        self._due = self._refused_at = 0.0
        self._upload: _Upload | None = None

    @property
    def uploading(self) -> int:
        """Size in bytes of the file that is coming in."""
        return 0 if self._upload is None else self._upload.size

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Close it at once if there are too many."""
        super().connection_made(transport)
        if len(self.server.handlers) > MOST_CONNECTIONS:
            self.transport.abort()

    def data_received(self, data: bytes) -> None:
        """Close it if the client only asks and never reads: pings, for instance, are answered without waiting."""
        super().data_received(data)
        if self.transport.get_write_buffer_size() > _MOST_UNSENT:
            self.transport.abort()

    async def recv(self, decode: bool | None = None) -> Any:
        """The next message that is allowed, encoded anew from what was checked."""
        while True:
            raw = await super().recv(decode)
            await self._pace()
            # viser handles each message in a task of its own; this lets the one before be handled first.
            await asyncio.sleep(0)
            client = self._clients.of(self)
            try:
                message = _decoded(raw)
                self._check(message, client)
            except Refused as refused:
                self._say(client, str(refused))
            else:
                return msgspec.msgpack.encode(message)

    async def _pace(self) -> None:
        """Wait, if messages come too fast; what comes meanwhile stays in the socket."""
        now = time.monotonic()
        self._due = max(self._due, now - _BURST / _MESSAGES_PER_SECOND) + 1.0 / _MESSAGES_PER_SECOND
        if self._due > now:
            await asyncio.sleep(self._due - now)

    def _check(self, message: _Message, client: ClientHandle | None) -> None:
        match message:
            case _Camera():
                _check_camera(message)
            case _Click():
                _check_ray(message)
            case _Update():
                control = _control(client, message.uuid)
                try:
                    check_value(control, message.updates.value)
                except Refused:
                    _show_again(control)
                    raise
            case _Start():
                self._begin_upload(message, client)
            case _Part():
                self._go_on_uploading(message, client)

    def _begin_upload(self, message: _Start, client: ClientHandle | None) -> None:
        control = _control(client, message.source_component_uuid)
        if not isinstance(control, GuiUploadButtonHandle):
            raise Refused
        self._drop_upload(client)
        check_text(message.filename, "A file's name")
        if message.size_bytes > LARGEST_UPLOAD:
            raise Refused(f"The file has {message.size_bytes:,} bytes; at most {LARGEST_UPLOAD:,} are allowed.")
        if (message.size_bytes == 0) != (message.part_count == 0):
            raise Refused
        if control.value.content:
            raise Refused("The last file is still being read; try again later.")
        if self._clients.uploaded() + message.size_bytes > MOST_UPLOADED:
            raise Refused("Too many files are being sent; try again later.")
        if message.part_count:
            self._upload = _Upload(message.transfer_uuid, message.size_bytes, message.part_count)

    def _go_on_uploading(self, message: _Part, client: ClientHandle | None) -> None:
        upload = self._upload
        if upload is None or message.transfer_uuid != upload.transfer:
            raise Refused
        if message.part_index in upload.indices or message.part_index >= upload.parts:
            raise Refused
        upload.indices.add(message.part_index)
        upload.received += len(message.content)
        whole = len(upload.indices) == upload.parts
        if upload.received > upload.size or (whole and upload.received < upload.size):
            self._drop_upload(client)
            raise Refused(f"The file does not have the {upload.size:,} bytes that were announced.")
        if whole:
            self._upload = None

    def _drop_upload(self, client: ClientHandle | None) -> None:
        self._upload = None
        if client is not None:
            client.gui._current_file_upload_states.clear()

    def _say(self, client: ClientHandle | None, text: str) -> None:
        now = time.monotonic()
        if client is not None and text and now - self._refused_at > _REFUSALS_EVERY:
            self._refused_at = now
            client.add_notification("Refused", text, color="red", auto_close_seconds=10.0)


def _decoded(raw: object) -> _Message:
    if not isinstance(raw, bytes):
        raise Refused
    try:
        return _DECODER.decode(raw)
    except (msgspec.DecodeError, ValueError, RecursionError):
        raise Refused from None


def _check_camera(message: _Camera) -> None:
    numbers = (*message.wxyz, *message.position, *message.look_at, *message.up_direction)
    scalars = (message.fov, message.near, message.far, message.image_height, message.image_width)
    if not _all_finite((*numbers, *scalars)):
        raise Refused
    # viser divides by these.
    if math.dist(message.position, message.look_at) < 1e-9 or math.hypot(*message.up_direction) < 1e-9:
        raise Refused
    if not 0.5 < math.hypot(*message.wxyz) < 2.0:
        raise Refused


def _check_ray(message: _Click) -> None:
    if not _all_finite((*message.ray_origin, *message.ray_direction, *message.screen_pos[0])):
        raise Refused
    if not 0.5 < math.hypot(*message.ray_direction) < 2.0:
        raise Refused


def _all_finite(numbers: Iterable[float]) -> bool:
    return all(math.isfinite(x) and abs(x) <= _FARTHEST for x in numbers)


def _controls(client: ClientHandle) -> dict[str, Any]:
    """Copied: the client's own thread may be adding some."""
    return dict(client.gui._gui_input_handle_from_uuid)


def _control(client: ClientHandle | None, uuid: str) -> Any:
    """A control of this client that a person can use now."""
    control = None if client is None else client.gui._gui_input_handle_from_uuid.get(uuid)
    if control is None or control._impl.removed or not control.visible or getattr(control, "disabled", False):
        raise Refused
    return control


def _show_again(control: Any) -> None:
    """Show the client the value that the control keeps."""
    if not control._impl.is_button and isinstance(control.value, bool | int | float | str):
        update = GuiUpdateMessage(control._impl.uuid, {"value": control.value})
        control._impl.gui_api._websock_interface.queue_message(update)
