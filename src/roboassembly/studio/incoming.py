"""Check of incoming messages, before viser sees them.

viser trusts its clients: it sets any property of a control to any value that a message names, and handles messages that
the studio does not use. Here, a message must be of one of the five types that the page needs and have the right shape
and finite numbers, and a control accepts only values that it offers to that client. Other messages are dropped; the
page says why if its user can have caused them.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, Struct
from viser import ClientHandle, GuiUploadButtonHandle, ViserServer
from websockets.asyncio.server import ServerConnection

from roboassembly.studio.config import LARGEST_UPLOAD
from roboassembly.studio.control_values import RefusedError, check_text, check_value
from roboassembly.studio.viser_internals import (
    check_viser,
    connected_client,
    control_of,
    controls_of,
    is_removed,
    live_connections,
    resend_value,
    uploads_in_progress,
)

MOST_CONNECTIONS = 128
"""Largest number of open connections, in any state."""
MOST_UPLOADED = 400_000_000
"""Largest size of all uploads together that are being sent or not read yet [bytes]."""
MESSAGES_PER_SECOND, BURST = 200.0, 400.0
"""Rate limit of a connection; further messages wait in its socket. The page sends at most 50 per second and type."""
MOST_UNSENT = 256_000_000
"""Largest size of the data that waits for a client to read it [bytes]."""
_NOTIFICATION_INTERVAL = 1.0
"""Shortest time between two notifications to a client about refused messages [s]."""
_FARTHEST = 1e6
"""Largest distance of a camera or a ray from the origin [m]."""

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


_AnyMessage = _Camera | _Click | _Update | _Start | _Part
_DECODER = msgspec.msgpack.Decoder(_AnyMessage)


@dataclass
class _Upload:
    """Upload in progress."""

    transfer: str
    size: int
    """Size of the file that the client announced [bytes]."""
    parts: int
    """Number of chunks that the client announced."""
    indices: set[int] = field(default_factory=set[int])
    """Indices of the received chunks."""
    received: int = 0
    """Size of the received chunks [bytes]."""


class Clients:
    """Clients of a server by connection."""

    def __init__(self) -> None:
        self._server: ViserServer | None = None

    def attach(self, server: ViserServer) -> None:
        """Set the server of the clients.

        Raises:
            RuntimeError: this version of viser stores its clients in another way.
        """
        check_viser(server)
        self._server = server

    def of(self, connection: StudioConnection) -> ClientHandle | None:
        """Return the client of a connection; None until the client has sent its camera."""
        if self._server is None:
            return None
        number = next((n for n, c in self._connections() if c is connection), None)
        return None if number is None else connected_client(self._server, number)

    def uploaded(self) -> int:
        """Return the size of all uploads that are being sent or not read yet [bytes]."""
        if self._server is None:
            return 0
        incoming = sum(c.uploading for _, c in self._connections() if isinstance(c, StudioConnection))
        controls = (c for client in self._server.get_clients().values() for c in controls_of(client).values())
        return incoming + sum(len(c.value.content) for c in controls if isinstance(c, GuiUploadButtonHandle))

    def _connections(self) -> list[tuple[int, ServerConnection]]:
        return [] if self._server is None else live_connections(self._server)


class StudioConnection(ServerConnection):
    """Connection that passes on only allowed messages.

    Args:
        clients: clients of the server.
    """

    def __init__(self, *args: Any, clients: Clients, **limits: Any) -> None:
        super().__init__(*args, **limits)
        self._clients = clients
        self._due = self._notified_at = 0.0
        self._upload: _Upload | None = None

    @property
    def uploading(self) -> int:
        """Size of the upload in progress [bytes]; 0 without one."""
        return 0 if self._upload is None else self._upload.size

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Close the connection at once if there are too many."""
        super().connection_made(transport)
        if len(self.server.handlers) > MOST_CONNECTIONS:
            self.transport.abort()

    def data_received(self, data: bytes) -> None:
        """Close the connection if the client does not read: pings, for example, are answered without waiting for it."""
        super().data_received(data)
        if self.transport.get_write_buffer_size() > MOST_UNSENT:
            self.transport.abort()

    async def recv(self, decode: bool | None = None) -> Any:
        """Return the next allowed message, encoded again after the check."""
        while True:
            raw = await super().recv(decode)
            await self._pace()
            # viser handles each message in a separate task; this lets it handle the previous one first.
            await asyncio.sleep(0)
            client = self._clients.of(self)
            try:
                message = _decoded(raw)
                self._check(message, client)
            except RefusedError as refused:
                self._notify(client, str(refused))
            else:
                return msgspec.msgpack.encode(message)

    async def _pace(self) -> None:
        """Wait if messages come too fast; further ones stay in the socket."""
        now = time.monotonic()
        self._due = max(self._due, now - BURST / MESSAGES_PER_SECOND) + 1.0 / MESSAGES_PER_SECOND
        if self._due > now:
            await asyncio.sleep(self._due - now)

    def _check(self, message: _AnyMessage, client: ClientHandle | None) -> None:
        match message:
            case _Camera():
                _check_camera(message)
            case _Click():
                _check_ray(message)
            case _Update():
                control = _control(client, message.uuid)
                try:
                    check_value(control, message.updates.value)
                except RefusedError:
                    resend_value(control)
                    raise
            case _Start():
                self._begin_upload(message, client)
            case _Part():
                self._continue_upload(message, client)

    def _begin_upload(self, message: _Start, client: ClientHandle | None) -> None:
        control = _control(client, message.source_component_uuid)
        if not isinstance(control, GuiUploadButtonHandle):
            raise RefusedError
        self._drop_upload(client)
        check_text(message.filename, "A file's name")
        if message.size_bytes > LARGEST_UPLOAD:
            raise RefusedError(f"The file has {message.size_bytes:,} bytes; at most {LARGEST_UPLOAD:,} are allowed.")
        if (message.size_bytes == 0) != (message.part_count == 0):
            raise RefusedError
        if control.value.content:
            raise RefusedError("The last file is still being read; try again later.")
        if self._clients.uploaded() + message.size_bytes > MOST_UPLOADED:
            raise RefusedError("Too many files are being sent; try again later.")
        if message.part_count:
            self._upload = _Upload(message.transfer_uuid, message.size_bytes, message.part_count)

    def _continue_upload(self, message: _Part, client: ClientHandle | None) -> None:
        upload = self._upload
        if upload is None or message.transfer_uuid != upload.transfer:
            raise RefusedError
        if message.part_index in upload.indices or message.part_index >= upload.parts:
            raise RefusedError
        upload.indices.add(message.part_index)
        upload.received += len(message.content)
        whole = len(upload.indices) == upload.parts
        if upload.received > upload.size or (whole and upload.received < upload.size):
            self._drop_upload(client)
            raise RefusedError(f"The file does not have the {upload.size:,} bytes that the browser announced.")
        if whole:
            self._upload = None

    def _drop_upload(self, client: ClientHandle | None) -> None:
        self._upload = None
        if client is not None:
            uploads_in_progress(client).clear()

    def _notify(self, client: ClientHandle | None, text: str) -> None:
        now = time.monotonic()
        if client is not None and text and now - self._notified_at > _NOTIFICATION_INTERVAL:
            self._notified_at = now
            client.add_notification("Refused", text, color="red", auto_close_seconds=10.0)


def _decoded(raw: object) -> _AnyMessage:
    if not isinstance(raw, bytes):
        raise RefusedError
    try:
        return _DECODER.decode(raw)
    except (msgspec.DecodeError, ValueError, RecursionError):
        raise RefusedError from None


def _check_camera(message: _Camera) -> None:
    numbers = (*message.wxyz, *message.position, *message.look_at, *message.up_direction)
    scalars = (message.fov, message.near, message.far, message.image_height, message.image_width)
    if not _all_finite((*numbers, *scalars)):
        raise RefusedError
    # viser divides by these distances.
    if math.dist(message.position, message.look_at) < 1e-9 or math.hypot(*message.up_direction) < 1e-9:
        raise RefusedError
    if not 0.5 < math.hypot(*message.wxyz) < 2.0:
        raise RefusedError


def _check_ray(message: _Click) -> None:
    if not _all_finite((*message.ray_origin, *message.ray_direction, *message.screen_pos[0])):
        raise RefusedError
    if not 0.5 < math.hypot(*message.ray_direction) < 2.0:
        raise RefusedError


def _all_finite(numbers: Iterable[float]) -> bool:
    return all(math.isfinite(x) and abs(x) <= _FARTHEST for x in numbers)


def _control(client: ClientHandle | None, uuid: str) -> Any:
    """Return a control of this client that its user can use now."""
    control = None if client is None else control_of(client, uuid)
    if control is None or is_removed(control) or not control.visible or getattr(control, "disabled", False):
        raise RefusedError
    return control
