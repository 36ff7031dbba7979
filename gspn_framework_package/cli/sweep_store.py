"""The store of a sweep: its measured points, a line for each, in a file next to the table.

A point is identified by a key, which depends on everything that its measures depend on. Points are
appended as they are measured, so that an interrupted sweep keeps them.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import IO, Any, Dict, Optional

from gspn_framework_package.analysis.sweeps.sweep import PointMeasures, SweepPoint
from gspn_framework_package.formats.source import open_file
from gspn_framework_package.model.errors import DataError, InputError

SUFFIX = ".points.jsonl"
_FIRST = {"gspn_sweep": 1}


class PointStore:
    """The points in one file, which is created with the first point.

    :ivar known: key -> point; its index and values must be filled in by the caller, who knows the
        grid.
    :raises DataError: the file is not the store of a sweep.
    """

    def __init__(self, path: str) -> None:
        self.path = Path(path)
        self.known: Dict[str, SweepPoint] = {}
        self._file: Optional[IO[str]] = None
        self._whole = 0
        try:
            with open_file(path) as file:
                lines = file.read().splitlines(keepends=True)
        except FileNotFoundError:
            return
        except OSError as error:
            raise InputError("it cannot be read (%s)" % error.strerror, file=path) from None
        for number, line in enumerate(lines, 1):
            if number == len(lines) and not line.endswith(b"\n"):
                break  # cut off while being written, so it is measured again
            self._take(line, number)
            self._whole += len(line)

    def _take(self, line: bytes, number: int) -> None:
        try:
            data = json.loads(line)
            if number == 1:
                if data != _FIRST:
                    raise ValueError
                return
            key, runs = data["key"], data["replications"]
            if not isinstance(key, str) or type(runs) is not int:
                raise ValueError
            notes = tuple(map(str, data.get("notes", ())))
            self.known[key] = SweepPoint(0, (), key, _measures(data["measures"]), runs, notes)
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            raise DataError(
                "this is not a point of a sweep",
                file=str(self.path),
                line=number,
                hint="move the file away to measure all points again",
            ) from None

    def add(self, point: SweepPoint) -> None:
        """Store a point. :raises InputError: the file cannot be written."""
        if point.key in self.known:
            return
        self.known[point.key] = point
        try:
            if self._file is None:
                self._file = self._opened()
            kept = ("key", "replications", "measures", "notes")
            self._file.write(json.dumps({name: getattr(point, name) for name in kept}) + "\n")
            self._file.flush()
        except OSError as error:
            raise InputError(
                "it cannot be written (%s)" % error.strerror, file=str(self.path)
            ) from None

    def _opened(self) -> IO[str]:
        file = self.path.open("a", encoding="utf-8")
        file.truncate(self._whole)
        if not self._whole:
            file.write(json.dumps(_FIRST) + "\n")
        return file

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()


def _measures(data: Any) -> PointMeasures:
    found: PointMeasures = {}
    for measure, values in data.items():
        found[measure] = {}
        for name, (mean, half) in values.items():
            if not math.isfinite(mean) or not (half is None or half >= 0):
                raise ValueError
            found[measure][name] = float(mean), half
    return found
