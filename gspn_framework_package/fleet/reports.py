"""Queries a fleet's history: how much robots are used, where they wait, what goes wrong."""

from __future__ import annotations

import datetime
import decimal
from typing import Any, Dict, Iterator, List, NamedTuple, Sequence, Tuple

from gspn_framework_package.fleet.database import TABLES, explained, keep_to, one_question
from gspn_framework_package.fleet.stay_follower import USES
from gspn_framework_package.fleet.store import Store
from gspn_framework_package.model.errors import UsageError

REPORT_GROUPS = ("day", "robot", "place", "run")
"""The possible groupings of a report."""

_SECONDS = tuple(use + "_s" for use in USES)
_COUNTS = ("failures", "alarms", "interventions")

_MOMENTS = 200  # most of them that are shown
_AT_ONCE = 1000
"""Number of rows fetched at a time."""


class Question(NamedTuple):
    """The scope of a report.

    ``by`` are some of :data:`REPORT_GROUPS`. ``since`` and ``until`` are the first and the last day
    (``2026-05-04``, UTC; "" for any). If ``robots``, ``places`` or ``runs`` is empty, all count.
    """

    by: Tuple[str, ...] = ("robot",)
    since: str = ""
    until: str = ""
    robots: Tuple[str, ...] = ()
    places: Tuple[str, ...] = ()
    runs: Tuple[str, ...] = ()

    def check(self) -> None:
        """:raises UsageError: it is invalid."""
        for group in self.by:
            if group not in REPORT_GROUPS:
                raise UsageError(
                    "a report cannot be grouped by '%.80s'" % group,
                    hint="but by " + ", ".join(REPORT_GROUPS),
                )
        if not self.by or len(set(self.by)) < len(self.by):
            raise UsageError("a report needs at least one grouping, each at most once")
        for day in (self.since, self.until):
            try:
                if day and datetime.date.fromisoformat(day).isoformat() != day:
                    raise ValueError
            except ValueError:
                raise UsageError(
                    "'%.80s' is not a day" % day, hint="write it as 2026-05-04"
                ) from None
        if self.since and self.until and self.until < self.since:
            raise UsageError("%s is before %s" % (self.until, self.since))

    def where(self) -> Tuple[str, List[Any]]:
        """The condition as SQL, and its parameters."""
        parts = ["true"]
        values: List[Any] = []
        for column, names in (("robot", self.robots), ("place", self.places), ("run", self.runs)):
            if names:
                parts.append("%s IN (%s)" % (column, ", ".join("?" * len(names))))
                values += names
        return " AND ".join(parts), values

    @property
    def days(self) -> Tuple[str, str]:
        """The first and the last day."""
        return self.since, self.until


def history_report(store: Store, question: Question) -> List[Dict[str, Any]]:
    """Use, waiting, failures, visits, alarms and interventions, a row for each group.

    A row has the names of its groups, ``visits``, the seconds of :data:`_SECONDS`, ``use`` (the
    share of the time in which actions ran; None if there was no time) and :data:`_COUNTS`. Rows
    that concern no robot or place have the name "".

    :raises UsageError: the question is invalid, or names something that is not in the store.
    """
    question.check()
    where, values = question.where()
    groups = ", ".join(question.by)
    seconds = ", ".join("sum(%s_ms) / 1000.0" % use for use in USES)
    counts = ", ".join("sum(%s)::BIGINT" % name for name in _COUNTS)
    sql = (
        f"SELECT {groups}, sum(visits)::BIGINT, {seconds}, {counts} "
        f"FROM totals WHERE {where} GROUP BY {groups} ORDER BY {groups}"
    )
    with explained(store.folder):
        database = store.open_tables(question.days)
        rows = database.execute(sql, values).fetchall()
        if not rows:
            _refuse_unknown(database, question)
        database.close()
    names = [*question.by, "visits", *_SECONDS, *_COUNTS]
    found = []
    for row in rows:
        use = {name: plain_cell(value) for name, value in zip(names, row)}
        time = sum(use[name] for name in _SECONDS)
        use["use"] = use["acting_s"] / time if time > 0 else None
        found.append(use)
    return found


def _refuse_unknown(database: Any, question: Question) -> None:
    for column, names in (("robot", question.robots), ("place", question.places)):
        known = _distinct(database, column)
        for name in names:
            if known and name not in known:
                raise UsageError("the store has no %s '%.80s' in this time" % (column, name))


def moments(store: Store, question: Question) -> List[Dict[str, Any]]:
    """Moments worth examining: failures, alarms and interventions, the newest first, and the
    longest waits.

    A row has ``day``, ``happened``, ``run``, ``slot``, ``robot``, ``place``, ``kind`` ("wait" for a
    wait) and ``detail``.

    :param question: its groups are ignored.
    :raises UsageError: the question is invalid.
    """
    question.check()
    where, values = question.where()
    sql = (
        "(SELECT day, happened, run, slot, robot, place, kind, detail FROM moments WHERE %s "
        "AND kind IN ('failure', 'alarm', 'intervention') ORDER BY happened DESC LIMIT %d) "
        "UNION ALL "
        "(SELECT day, began, run, slot, robot, place, 'wait', "
        "printf('%%.1f s', waiting_ms / 1000.0) FROM stays WHERE %s AND waiting_ms > 0 "
        "ORDER BY waiting_ms DESC, began LIMIT %d)" % (where, _MOMENTS, where, _MOMENTS // 10)
    )
    with explained(store.folder):
        database = store.open_tables(question.days)
        cursor = database.execute(sql, [*values, *values])
        rows = list(_as_objects(cursor))
        database.close()
    return rows


def known_names(store: Store) -> Dict[str, List[str]]:
    """The ``robots``, ``places`` and ``days`` that the store has, each in order."""
    with explained(store.folder):
        database = store.open_tables()
        found = {
            column + "s": [str(name) for name in _distinct(database, column) if name]
            for column in ("robot", "place", "day")
        }
        database.close()
    return found


def _distinct(database: Any, column: str) -> List[Any]:
    sql = "SELECT DISTINCT {0} FROM totals ORDER BY {0}".format(column)
    return [name for (name,) in database.execute(sql).fetchall()]


class SqlAnswer(NamedTuple):
    """The result of an SQL query: the names of the columns, and an iterator over the rows."""

    columns: Sequence[str]
    rows: Iterator[Tuple[Any, ...]]


def ask_sql(store: Store, sql: str) -> SqlAnswer:
    """Run an SQL query: a single SELECT over the tables of the store, without access to other
    files.

    :raises UsageError: it is not a single SELECT, or is wrong.
    """
    runs = store.runs()
    database = store.open_tables(runs=runs)
    files = [file for table in TABLES for file in store.files(table, runs)]
    keep_to(database, files, store.temporary)
    cursor = one_question(database, sql)
    return SqlAnswer([column[0] for column in cursor.description], _rows(cursor))


def _rows(cursor: Any) -> Iterator[Tuple[Any, ...]]:
    while True:
        rows = cursor.fetchmany(_AT_ONCE)
        if not rows:
            return
        for row in rows:
            yield tuple(map(plain_cell, row))


def _as_objects(cursor: Any) -> Iterator[Dict[str, Any]]:
    names = [column[0] for column in cursor.description]
    for row in _rows(cursor):
        yield dict(zip(names, row))


def plain_cell(value: Any) -> Any:
    """Convert a value of DuckDB to one of JSON."""
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, decimal.Decimal):
        return float(value)
    if isinstance(value, (list, tuple)):
        return [plain_cell(part) for part in value]
    if isinstance(value, dict):
        return {str(key): plain_cell(part) for key, part in value.items()}
    if isinstance(value, (datetime.date, datetime.datetime)):
        return value.isoformat()
    return str(value)
