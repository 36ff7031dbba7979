"""How the body of a message goes over Zenoh: as JSON, compressed if it is large.

A router's queue holds 16 parts of 64 KB, and what does not fit is lost, so a large message would
never get through.
"""

from __future__ import annotations

import zlib
from typing import Optional

COMPRESSED_FROM = 100_000
"""Bytes from which on a body is compressed."""

_FASTEST = 1
_ZLIB = 0x78
"""The first byte of what zlib compressed; JSON does not begin with it."""


def wrapped(body: bytes) -> bytes:
    """The body as it is sent."""
    return zlib.compress(body, _FASTEST) if len(body) >= COMPRESSED_FROM else body


def is_compressed(payload: bytes) -> bool:
    """Whether what came in has to be unwrapped."""
    return payload[:1] == bytes([_ZLIB])


def unwrapped(payload: bytes, largest: int) -> Optional[bytes]:
    """The body that was compressed; None if nothing was, or if it is larger than ``largest``
    bytes."""
    decompressor = zlib.decompressobj()
    try:
        body = decompressor.decompress(payload, largest)
    except zlib.error:
        return None
    return body if decompressor.eof else None
