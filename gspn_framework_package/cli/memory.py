"""The options of an analysis that uses the disk beyond a given memory."""

from __future__ import annotations

import argparse
import math
import re
from typing import Any, Dict, Iterator, Mapping, NamedTuple, Optional

from gspn_framework_package.analysis.on_disk.scratch import Scratch
from gspn_framework_package.analysis.on_disk.search import LEAST_MEMORY
from gspn_framework_package.cli.options import Argument, Arguments
from gspn_framework_package.model.errors import UsageError

LIBRARIES = 256 << 20
"""Additional memory in bytes for libraries as they are loaded."""

_UNITS: Dict[str, float] = {"": 1.0, "KB": 1e3, "MB": 1e6, "GB": 1e9, "TB": 1e12}

_SIZE = re.compile(r"\s*([0-9.]+(?:e[0-9]+)?)\s*([KMGT]?B?)\s*", re.IGNORECASE)


class MemoryAndDisk(NamedTuple):
    """Resources to use: ``size`` bytes of memory, and the folder for ``scratch`` files."""

    size: float
    scratch: Scratch


MEMORY_OPTIONS: Arguments = {
    Argument("--memory", "SIZE"): (
        "for a net: use this much memory (e.g. 1GB) and store further markings on disk; by default "
        "their number and the time are then unlimited"
    ),
    Argument("--scratch", "DIR"): (
        "the folder for temporary files of --memory (default: TMPDIR, or /var/tmp)"
    ),
}


def memory_of(args: argparse.Namespace) -> Optional[MemoryAndDisk]:
    """Read ``--memory`` and ``--scratch``; None if they are not given. :raises UsageError: they are
    invalid."""
    if args.memory is None:
        if args.scratch is not None:
            raise UsageError("--scratch requires --memory", hint="give --memory 1GB")
        return None
    if args.limit_memory is not None:
        raise UsageError("--memory and --limit-memory exclude each other")
    return MemoryAndDisk(_bytes(args.memory), Scratch(args.scratch))


def _bytes(text: str) -> float:
    """Parse a size such as ``1.5GB`` to a number of bytes."""
    match = _SIZE.fullmatch(text)
    try:
        size = float(match.group(1)) * _UNITS[_unit(match.group(2))] if match else math.nan
    except ValueError:
        size = math.nan
    if not LEAST_MEMORY <= size < math.inf:
        raise UsageError(
            "--memory %s: expected a size of at least %d KB" % (text, -(-LEAST_MEMORY // 1000)),
            hint="for example 1GB or 500MB",
        )
    return size


def _unit(text: str) -> str:
    unit = text.upper()
    return unit if unit in _UNITS else unit + "B"


def scratch_text(data: Mapping[str, Any]) -> Iterator[str]:
    """A line on the disk space used for a report, if any."""
    if "scratch_bytes" in data:
        yield "on disk: at most %.1f MB in %s, removed again" % (
            data["scratch_bytes"] / 1e6,
            data["scratch"],
        )
