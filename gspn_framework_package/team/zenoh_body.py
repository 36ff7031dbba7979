"""Encodes the body of a message for Zenoh: as JSON, compressed if it is large.

A router's queue holds 16 fragments of 64 KB and drops the rest, so a very large message would never
arrive.
"""

from __future__ import annotations

import zlib
from typing import Optional

COMPRESSED_FROM = 100_000
"""Size in bytes from which on a body is compressed."""

_FASTEST = 1
_ZLIB = 0x78
"""The first byte of zlib's output, with which JSON never begins."""


def wrapped(body: bytes) -> bytes:
    """Encode a body for sending."""
    return zlib.compress(body, _FASTEST) if len(body) >= COMPRESSED_FROM else body


def is_compressed(payload: bytes) -> bool:
    """Whether a received body is compressed."""
    return payload[:1] == bytes([_ZLIB])


def unwrapped(payload: bytes, largest: int) -> Optional[bytes]:
    """Decompress a body; None if it is damaged or larger than ``largest`` bytes."""
    decompressor = zlib.decompressobj()
    try:
        body = decompressor.decompress(payload, largest)
    except zlib.error:
        return None
    return body if decompressor.eof else None
