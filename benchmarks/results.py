"""Keeps the results of the scaling experiments in a folder, point by point, so that an interrupted
run can resume."""

from __future__ import annotations

import csv
import json
import os
import time
from typing import Any, Dict, List, Sequence, Tuple

from benchmarks.machine import describe_machine
from gspn_framework_package.model.errors import UsageError

Row = Dict[str, Any]

KEY = ("experiment", "mode", "robots", "places", "synchronisation")
"""The fields that identify a point."""


def key_of(row: Row) -> Tuple[Any, ...]:
    """The key of the point that a row belongs to."""
    return tuple(row.get(name) for name in KEY)


class Results:
    """Rows of figures, written to ``results.json`` and ``results.csv`` in the folder after each
    point.

    :param folder: "" to write nothing. Existing results in the folder are loaded.
    :raises UsageError: the folder holds something other than such results, or those of another
      machine.
    """

    def __init__(self, folder: str = "") -> None:
        self.folder = folder
        self.rows: List[Row] = []
        self.machine = describe_machine()
        path = os.path.join(folder, "results.json")
        if folder and os.path.exists(path):
            with open(path, encoding="utf-8") as file:
                try:
                    report = json.load(file)
                    known, self.rows = report["machine"], list(report["results"])
                except (ValueError, KeyError, TypeError):
                    raise UsageError(
                        "these are no results of python3 -m benchmarks", file=path
                    ) from None
            if (known.get("cpu"), known.get("cores")) != (
                self.machine["cpu"],
                self.machine["cores"],
            ):
                raise UsageError(
                    "these results are of another machine", file=path, hint="choose another folder"
                )

    def has(self, row: Row) -> bool:
        """Whether the point of ``row`` was measured without a fault."""
        return any(key_of(known) == key_of(row) and not known.get("note") for known in self.rows)

    def add(self, row: Row) -> None:
        """Add a row, replacing an older one of the same point."""
        self.rows = [known for known in self.rows if key_of(known) != key_of(row)] + [row]
        self.write()

    def report(self) -> Dict[str, Any]:
        """Everything, ready to be written as JSON."""
        return {"machine": self.machine, "date": time.strftime("%Y-%m-%d"), "results": self.rows}

    def write(self) -> None:
        """Write both files."""
        if not self.folder:
            return
        os.makedirs(self.folder, exist_ok=True)
        names: Dict[str, None] = {}
        for row in self.rows:
            names.update(dict.fromkeys(row))
        with open(
            os.path.join(self.folder, "results.csv"), "w", newline="", encoding="utf-8"
        ) as file:
            writer = csv.DictWriter(file, list(names))
            writer.writeheader()
            writer.writerows(self.rows)
        with open(os.path.join(self.folder, "results.json"), "w", encoding="utf-8") as file:
            json.dump(self.report(), file, indent=1)

    def of(self, experiment: str) -> Sequence[Row]:
        """The rows of an experiment, by mode, size and synchronisation."""
        found = [row for row in self.rows if row["experiment"] == experiment]
        return sorted(
            found, key=lambda r: (r["mode"] != "process", r["mode"], r["robots"], r["places"])
        )
