"""Describes the machine and the versions that a benchmark ran on, for the head of its output."""

from __future__ import annotations

import os
import platform
from importlib import metadata
from typing import Dict, Iterable, List, Optional, Sequence

import gspn_framework_package

LIBRARIES = ("numpy", "scipy", "numba", "lxml", "psutil", "rospy", "actionlib", "matplotlib")
"""Python distributions whose versions are reported if they are installed."""


def describe_machine(libraries: Iterable[str] = LIBRARIES) -> Dict[str, str]:
    """The machine and the versions, ready to print or to write as JSON."""
    described = {
        "cpu": _processor(),
        "cores": str(os.cpu_count()),
        "memory": _memory(),
        "system": _system(),
        "python": platform.python_version(),
        "gspn_framework_package": gspn_framework_package.__version__,
    }
    for name in libraries:
        version = _version(name)
        if version is not None:
            described[name] = version
    return described


def machine_line(described: Optional[Dict[str, str]] = None) -> str:
    """The machine and the versions in one line of text."""
    told = dict(described or describe_machine())
    head = "%s, %s cores, %s; %s" % tuple(told.pop(k) for k in ("cpu", "cores", "memory", "system"))
    return "%s; %s" % (head, ", ".join("%s %s" % item for item in told.items()))


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table with aligned columns: the first one left-aligned, numbers right-aligned."""
    cells = [list(head)] + [[_cell(value) for value in row] for row in rows]
    widths = [max(len(row[i]) for row in cells) for i in range(len(head))]
    lines: List[str] = []
    for number, row in enumerate(cells):
        aligned = [row[0].ljust(widths[0])] + [c.rjust(w) for c, w in zip(row[1:], widths[1:])]
        lines.append("| %s |" % " | ".join(aligned))
        if number == 0:
            lines.append(
                "|-%s|" % "|".join(["-" * widths[0] + "-"] + ["-" * w + "-:" for w in widths[1:]])
            )
    return "\n".join(lines)


def _cell(value: object) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return format(value, ",")
    if isinstance(value, float):
        return "%.3g" % value if abs(value) < 100 else format(round(value), ",")
    return str(value)


def _version(distribution: str) -> Optional[str]:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return None


def _processor() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            for line in file:
                if line.startswith("model name"):
                    return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def _memory() -> str:
    try:
        return "%.1f GiB" % (os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30)
    except (ValueError, OSError):
        return "memory unknown"


def _system() -> str:
    try:
        with open("/etc/os-release", encoding="utf-8") as file:
            for line in file:
                if line.startswith("PRETTY_NAME="):
                    return line.split("=", 1)[1].strip().strip('"')
    except OSError:
        pass
    return platform.platform(terse=True)
