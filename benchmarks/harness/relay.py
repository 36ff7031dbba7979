"""Delay without the kernel's netem: a relay that carries Ethernet frames between pairs of TAP
devices."""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import struct
import threading
import time
from collections import deque
from typing import Deque, Dict, List, Sequence, Tuple

DEVICE = "/dev/net/tun"
FRAME = 65536
_TUNSETIFF = 0x400454CA
_TAP_WITHOUT_HEADER = 0x0002 | 0x1000  # IFF_TAP | IFF_NO_PI


def open_tap(name: str) -> int:
    """Create the TAP device ``name`` in the network namespace of this thread and return its
    descriptor; the device disappears when that is closed.

    :raises OSError: not allowed, or the kernel does not support TAP devices.
    """
    descriptor = os.open(DEVICE, os.O_RDWR | os.O_NONBLOCK)
    try:
        fcntl.ioctl(
            descriptor, _TUNSETIFF, struct.pack("16sH22x", name.encode(), _TAP_WITHOUT_HEADER)
        )
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


class Relay(threading.Thread):
    """Carries every frame from one end of a link to the other, ``delay`` seconds later, in order.

    :param links: pairs of TAP descriptors, which the relay closes when it ends.
    """

    def __init__(self, links: Sequence[Tuple[int, int]], delay: float) -> None:
        super().__init__(name="relay", daemon=True)
        self._delay = delay
        self._other: Dict[int, int] = {}
        for a, b in links:
            self._other[a], self._other[b] = b, a
        self._wake, self._waker = os.pipe()

    def close(self) -> None:
        """End the relay; frames in transit are lost."""
        os.close(self._waker)
        if self.is_alive():
            self.join()
        for descriptor in (self._wake, *self._other):
            os.close(descriptor)

    def run(self) -> None:
        """Carry frames until :meth:`close`."""
        waiting: Deque[Tuple[float, int, bytes]] = deque()
        while True:
            left = max(0.0, waiting[0][0] - time.monotonic()) if waiting else None
            ready: List[int] = select.select([self._wake, *self._other], [], [], left)[0]
            if self._wake in ready:
                return
            now = time.monotonic()
            for descriptor in ready:
                waiting.extend(
                    (now + self._delay, self._other[descriptor], f) for f in _frames(descriptor)
                )
            while waiting and waiting[0][0] <= now:
                _, descriptor, frame = waiting.popleft()
                # the queue is full, or the device is down: drop the frame, as a network would
                with contextlib.suppress(OSError):
                    os.write(descriptor, frame)


def _frames(descriptor: int) -> List[bytes]:
    frames = []
    try:
        while True:
            frames.append(os.read(descriptor, FRAME))
    except OSError:  # no more for now
        return frames
