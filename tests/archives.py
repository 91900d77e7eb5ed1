"""Damaged ZIP archives."""

from __future__ import annotations

import struct

_DIRECTORY_AT = -6
"""Place of the directory's offset in an archive without a comment, counted from its end [bytes]."""


def with_members_before_the_start(archive: bytes, shift: int = 256) -> bytes:
    """Return an archive whose directory claims to lie `shift` bytes further on, so that members lie before the file."""
    (at,) = struct.unpack_from("<I", archive, len(archive) + _DIRECTORY_AT)
    return archive[:_DIRECTORY_AT] + struct.pack("<I", at + shift) + archive[_DIRECTORY_AT + 4 :]
