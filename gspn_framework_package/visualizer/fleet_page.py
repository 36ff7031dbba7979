"""A fleet's history on the page: reports, the moments behind them, and their replays. Its routes
are in :mod:`~gspn_framework_package.visualizer.app`."""

from __future__ import annotations

import os
import threading
from typing import Any, Dict, List, Mapping

from gspn_framework_package.fleet.database import duckdb
from gspn_framework_package.fleet.reports import Question, history_report, known_names, moments
from gspn_framework_package.fleet.store import Store
from gspn_framework_package.model.errors import GspnError, InputError
from gspn_framework_package.visualizer.replay import Replay
from gspn_framework_package.visualizer.session import Session

RUN_KEY = "history-"
"""Prefix of the keys of sessions that replay runs of a store."""

MOST_ROWS = 5000
"""Largest number of rows of a report on the page."""


class FleetPage:
    """The fleet history shown by a server.

    :param folder: a store of ``gspn history``.
    :raises InputError: it is not a store, or DuckDB is not installed.
    """

    def __init__(self, folder: str) -> None:
        duckdb()
        self._store = Store(folder)
        self._lock = threading.Lock()  # one query at a time, since each may need much memory

    def names(self) -> Dict[str, List[str]]:
        """The robots, places and days of the store."""
        with self._lock:
            return known_names(self._store)

    def report(self, fields: Mapping[str, str]) -> Dict[str, Any]:
        """The report for the page's request. :raises UsageError: the request is invalid."""
        question = _question(fields)
        with self._lock:
            rows = history_report(self._store, question)
        return {"rows": rows[:MOST_ROWS], "left_out": max(0, len(rows) - MOST_ROWS)}

    def moments(self, fields: Mapping[str, str]) -> Dict[str, Any]:
        """The moments behind a report, each with the key of the session that replays it."""
        question = _question(fields)
        with self._lock:
            rows = moments(self._store, question)
        return {"moments": [{**row, "id": RUN_KEY + row["run"]} for row in rows]}

    def replay(self, key: str) -> Session:
        """The session that replays a run. :raises GspnError: its log cannot be read."""
        run = self._store.run(key[len(RUN_KEY) :]) if key[len(RUN_KEY) :].isalnum() else None
        if run is None or not run["logs"]:
            raise InputError("the history has no log of this run")
        path = run["logs"][run["leader"]]["path"]
        name = os.path.basename(path)
        try:
            replay = Replay(path)
        except GspnError as error:
            error.file = name  # viewers need not know the folders of this machine
            error.hint = error.hint or "the log must be where it was when it was ingested"
            raise
        return Session(key, replay.document(name), replay, reopens=True)


def _question(fields: Mapping[str, str]) -> Question:
    def names(key: str) -> Any:
        return (fields[key],) if fields.get(key) else ()

    return Question(
        tuple(fields.get("by", "robot").split(",")),
        fields.get("since", ""),
        fields.get("until", ""),
        names("robot"),
        names("place"),
    )
