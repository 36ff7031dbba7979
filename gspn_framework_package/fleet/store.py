"""A store of a fleet's history: a folder with tables in Parquet files, by day and run.

::

    history.json the format and its version runs/KEY.json a run: its logs, how far they were read,
    its files stays/day=2026-05-04/KEY-3.parquet rows from the 3rd ingest of the run for a day
    moments/..., totals/... the other tables

The file of a run lists the table files that count. It is replaced atomically after the table files
have been written, so that an ingest counts completely or not at all. Files that no run lists are
left over from an interrupted ingest, and are removed by the next one.
"""

from __future__ import annotations

import contextlib
import csv
import fcntl
import hashlib
import json
import os
import shutil
from typing import Any, Dict, Iterator, List, Optional, Sequence, Tuple

from gspn_framework_package.fleet.database import (
    TABLES,
    explained,
    files_sql,
    open_database,
    quoted,
    totals_sql,
    write_table,
)
from gspn_framework_package.fleet.stay_follower import DAY_SECONDS, Moment, Stay
from gspn_framework_package.formats.json_file import read_json
from gspn_framework_package.model.errors import InputError

STORE_FORMAT = "gspn history"
STORE_VERSION = 1

INCOMING = "incoming"
"""The folder for files being written."""

ROWS_PER_FILE = 1_000_000
"""Number of rows gathered before they are written to Parquet files."""

MOST_FILES = 12
"""Maximum number of files for a run and a day; if there are more, they are merged into one."""

Manifest = Dict[str, Any]
"""The content of a run's file: ``key``, ``run`` (its name), ``plan``, ``plan_hash``, ``agents`` (it
is a standalone run), ``virtual``; ``begin`` and ``end`` (seconds since 1970), ``rows``; ``logs``
(log -> reading position), ``leader`` (the log that supplied the newest slots), ``hashes`` (slot ->
hash) of one in ``every`` slots, ``state``, ``ingests``, and ``files`` (table -> names)."""

_MANIFEST: Dict[str, Tuple[type, ...]] = {
    "key": (str,),
    "run": (str,),
    "plan_hash": (str,),
    "agents": (bool,),
    "begin": (int, float, type(None)),
    "end": (int, float, type(None)),
    "rows": (dict,),
    "logs": (dict,),
    "leader": (str,),
    "hashes": (dict,),
    "every": (int,),
    "state": (dict, type(None)),
    "ingests": (int,),
    "files": (dict,),
}
"""The columns of every table, with their types."""


class Store:
    """A store; see the module.

    :param folder: its folder.
    :param create: create it if it does not exist.
    :raises InputError: the folder is not a store, or has another version.
    """

    def __init__(self, folder: str, create: bool = False) -> None:
        self.folder = os.path.abspath(folder)
        first = os.path.join(self.folder, "history.json")
        try:
            if create and (not os.path.isdir(folder) or not os.listdir(folder)):
                for name in ("runs", *TABLES):
                    os.makedirs(os.path.join(self.folder, name), exist_ok=True)
                _replace(first, {"format": STORE_FORMAT, "version": STORE_VERSION})
        except NotADirectoryError:
            pass
        if not os.path.exists(first):
            raise InputError(
                "is not a store of a fleet's history",
                file=folder,
                hint="create one in a new or empty folder with 'gspn history ingest LOG --store "
                "DIR'",
            )
        header = read_json(first)
        if not isinstance(header, dict) or header.get("format") != STORE_FORMAT:
            raise InputError("does not describe a store of a fleet's history", file=first)
        if header.get("version") != STORE_VERSION:
            raise InputError(
                "has version %s; this program reads version %d"
                % (header.get("version"), STORE_VERSION),
                file=folder,
            )

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Hold the lock for writing. :raises InputError: another process holds it."""
        with open(os.path.join(self.folder, "lock"), "a", encoding="utf-8") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise InputError(
                    "another ingest is writing to this store",
                    file=self.folder,
                    hint="try again later",
                ) from None
            self._remove_leftovers()
            yield

    @property
    def temporary(self) -> str:
        """The folder for temporary files."""
        return os.path.join(self.folder, INCOMING)

    # -- runs --------------------------------------------------------------------------------------

    def runs(self) -> List[Manifest]:
        """All runs, ordered by start time. :raises InputError: the file of one is
        damaged."""
        folder = os.path.join(self.folder, "runs")
        names = [name for name in sorted(os.listdir(folder)) if name.endswith(".json")]
        found = [self._read(os.path.join(folder, name)) for name in names]
        return sorted(found, key=lambda run: (run["begin"] or 0.0, run["key"]))

    def run(self, key: str) -> Optional[Manifest]:
        """A run; None if the store does not have it."""
        path = self._path(key)
        return self._read(path) if os.path.exists(path) else None

    def _path(self, key: str) -> str:
        return os.path.join(self.folder, "runs", key + ".json")

    @staticmethod
    def _read(path: str) -> Manifest:
        hint = "remove it, and ingest the run again"
        try:
            manifest = read_json(path)
        except InputError as error:
            error.hint = hint
            raise
        if not isinstance(manifest, dict):
            raise InputError("does not describe a run", file=path, hint=hint)
        for name, kinds in _MANIFEST.items():
            if not isinstance(manifest.get(name), kinds):
                raise InputError("its '%s' is missing or damaged" % name, file=path, hint=hint)
        files = manifest["files"]
        if not all(isinstance(files.get(table), list) for table in TABLES) or not all(
            isinstance(name, str) for names in files.values() for name in names
        ):
            raise InputError("its 'files' are damaged", file=path, hint=hint)
        return manifest

    def commit(self, run: Manifest) -> None:
        """Commit a run as described, with its files."""
        _replace(self._path(run["key"]), run)

    # -- tables ------------------------------------------------------------------------------------

    def files(self, table: str, runs: Sequence[Manifest], days: Sequence[str] = ()) -> List[str]:
        """The files of a table.

        :param runs: the runs whose files to list.
        :param days: the first and the last day (``2026-05-04``, "" for any); all, if empty.
        """
        since, until = days if days else ("", "")
        return [
            os.path.join(self.folder, name)
            for run in runs
            for name in run["files"][table]
            if (not since or day_of_file(name) >= since)
            and (not until or day_of_file(name) <= until)
        ]

    def open_tables(
        self, days: Sequence[str] = (), runs: Optional[Sequence[Manifest]] = None
    ) -> Any:
        """A database with the tables as views.

        :param days: as for :meth:`files`.
        :param runs: the runs of the store, if they were already read.
        """
        runs = self.runs() if runs is None else runs
        with explained(self.folder):
            database = open_database(self.temporary)
            for table in TABLES:
                rows = files_sql(table, self.files(table, runs, days))
                database.execute("CREATE VIEW %s AS SELECT * FROM %s" % (table, rows))
        return database

    def merge(self, run: Manifest) -> None:
        """Merge the files of days of a run that have too many. Changes the manifest."""
        for table in TABLES:
            by_day: Dict[str, List[str]] = {}
            for name in run["files"][table]:
                by_day.setdefault(day_of_file(name), []).append(name)
            for day, names in by_day.items():
                if len(names) <= MOST_FILES:
                    continue
                merged = file_name(table, day, run["key"], "m%d" % run["ingests"])
                rows = files_sql(table, [os.path.join(self.folder, name) for name in names])
                columns = ", ".join('"%s"' % name for name, _ in TABLES[table])
                sql = "SELECT %s FROM %s ORDER BY robot, place" % (columns, rows)
                with explained(self.folder):
                    database = open_database(self.temporary)
                    write_table(database, sql, os.path.join(self.folder, merged))
                    database.close()
                kept = [name for name in run["files"][table] if name not in names]
                run["files"][table] = [*kept, merged]

    def _remove_leftovers(self) -> None:
        shutil.rmtree(self.temporary, ignore_errors=True)
        os.makedirs(self.temporary)
        named = {name for run in self.runs() for names in run["files"].values() for name in names}
        for table in TABLES:
            for folder, _, names in os.walk(os.path.join(self.folder, table)):
                for name in names:
                    path = os.path.join(folder, name)
                    if os.path.relpath(path, self.folder) not in named:
                        os.remove(path)


class RowWriter:
    """Writes the rows of one ingest of one run.

    Rows are gathered in two text files, and written to Parquet files when there are many, or at the
    end.

    :param store: where the files go; nothing else may write there.
    :param key: the run.
    :param number: the number of the ingest, unique within the run.

    :ivar files: table -> the files written so far, relative to the store.
    :ivar rows: table -> the number of rows written.
    """

    def __init__(self, store: Store, key: str, number: int) -> None:
        self._store, self._key, self._number = store, key, number
        self._part = 0
        self.files: Dict[str, List[str]] = {table: [] for table in TABLES}
        self.rows = {"stays": 0, "moments": 0}
        self._begin()

    def _begin(self) -> None:
        self._gathered = 0
        self._paths = {t: os.path.join(self._store.temporary, t + ".csv") for t in self.rows}
        self._texts = {
            table: open(path, "w", encoding="utf-8", newline="")  # noqa: SIM115
            for table, path in self._paths.items()
        }
        self._writers = {table: csv.writer(text) for table, text in self._texts.items()}

    def write(self, stays: Sequence[Stay], moments: Sequence[Moment]) -> None:
        """Add rows."""
        for table, rows in (("stays", stays), ("moments", moments)):
            write = self._writers[table].writerow
            for row in rows:
                write((int(row[0] // DAY_SECONDS), round(row[0] * 1e3), *row[1:]))
            self.rows[table] += len(rows)
            self._gathered += len(rows)
        if self._gathered >= ROWS_PER_FILE:
            self._convert()
            self._begin()

    def close(self) -> None:
        """Write all rows to files."""
        self._convert()

    def discard(self) -> None:
        """Remove all written files."""
        for text in self._texts.values():
            text.close()
        for names in self.files.values():
            for name in names:
                os.remove(os.path.join(self._store.folder, name))

    def _convert(self) -> None:
        for text in self._texts.values():
            text.close()
        if not self._gathered:
            return
        self._part += 1
        with explained(self._store.folder):
            self._write_files()

    def _write_files(self) -> None:
        database = open_database(self._store.temporary)
        for table, path in self._paths.items():
            database.execute("CREATE TABLE %s AS %s" % (table, self._rows_sql(table, path)))
        days = database.execute(
            "SELECT DISTINCT day FROM (SELECT day FROM stays UNION SELECT day FROM moments) "
            "ORDER BY day"
        ).fetchall()
        for (day,) in days:
            rows = {
                table: "SELECT * EXCLUDE (day) FROM %s WHERE day = DATE '%s'" % (table, day)
                for table in self._paths
            }
            queries = {
                "stays": rows["stays"] + " ORDER BY robot, began",
                "moments": rows["moments"] + " ORDER BY happened",
                "totals": totals_sql("(%s)" % rows["stays"], "(%s)" % rows["moments"]),
            }
            for table, sql in queries.items():
                self._copy(database, table, str(day), sql)
        database.close()

    def _copy(self, database: Any, table: str, day: str, sql: str) -> None:
        name = file_name(table, day, self._key, "%d-%d" % (self._number, self._part))
        path = os.path.join(self._store.folder, name)
        os.makedirs(os.path.dirname(path), exist_ok=True)
        write_table(database, sql, path)
        self.files[table].append(name)

    def _rows_sql(self, table: str, path: str) -> str:
        """SQL that reads a text file as the rows of a table, with their day."""
        columns = [("number_of_day", "BIGINT"), ("ms", "BIGINT")]
        columns += [(name, kind) for name, kind in TABLES[table][2:]]
        return (
            "SELECT DATE '1970-01-01' + number_of_day::INTEGER AS day, %s AS run, "
            "make_timestamp(ms * 1000) AS %s, * EXCLUDE (number_of_day, ms) "
            "FROM read_csv(%s, header=false, auto_detect=false, delim=',', quote='\"', "
            "escape='\"', nullstr=%s, columns={%s})"
            % (
                quoted(self._key),
                TABLES[table][1][0],
                quoted(path),
                quoted("\x01"),  # NULL never occurs as text
                ", ".join("%s: %s" % (quoted(name), quoted(kind)) for name, kind in columns),
            )
        )


def file_name(table: str, day: str, key: str, number: str) -> str:
    """The name of a table file, relative to the store."""
    return os.path.join(table, "day=" + day, "%s-%s.parquet" % (key, number))


def day_of_file(name: str) -> str:
    """The day in the name of a table file."""
    return os.path.basename(os.path.dirname(name))[len("day=") :]


def file_stem(*parts: str) -> str:
    """A file name that identifies these parts."""
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:16]


def _replace(path: str, data: Any) -> None:
    """Write a JSON file atomically."""
    with open(path + ".new", "w", encoding="utf-8") as file:
        json.dump(data, file, separators=(",", ":"))
        file.flush()
        os.fsync(file.fileno())
    os.replace(path + ".new", path)
