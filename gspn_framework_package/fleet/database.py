"""Access to DuckDB, which reads and writes the tables of a fleet's history."""

from __future__ import annotations

import contextlib
import sys
from typing import Any, Dict, Iterator, Sequence, Tuple

from gspn_framework_package.model.errors import InputError, LimitError, UsageError

DATABASE_MEMORY = "700MB"
"""Memory limit of DuckDB; beyond it, DuckDB works on the disk."""

OLDEST_FOR_SQL = (1, 2)
"""The first version of DuckDB that can be restricted to some files."""


def _columns(text: str) -> Sequence[Tuple[str, str]]:
    """Columns and their types, as SQL lists them."""
    return [(name, kind) for name, kind in (column.split() for column in text.split(","))]


TABLES: Dict[str, Sequence[Tuple[str, str]]] = {
    "stays": _columns(
        "run VARCHAR, began TIMESTAMP, robot VARCHAR, place VARCHAR, visit BIGINT, slot BIGINT, "
        "arrived BOOLEAN, acting_ms INTEGER, waiting_ms INTEGER, paused_ms INTEGER, "
        "failed_ms INTEGER, resting_ms INTEGER, left_by VARCHAR"
    ),
    "moments": _columns(
        "run VARCHAR, happened TIMESTAMP, robot VARCHAR, place VARCHAR, slot BIGINT, "
        "kind VARCHAR, detail VARCHAR"
    ),
    "totals": _columns(
        "run VARCHAR, robot VARCHAR, place VARCHAR, visits BIGINT, acting_ms BIGINT, "
        "waiting_ms BIGINT, paused_ms BIGINT, failed_ms BIGINT, resting_ms BIGINT, "
        "failures BIGINT, alarms BIGINT, interventions BIGINT"
    ),
}
"""Table -> its columns and their types. Each also has the column ``day`` (a date, UTC), by which
its files are organised."""

_TOTALS = """
SELECT run, robot, place,
  sum(visits)::BIGINT AS visits,
  sum(acting_ms)::BIGINT AS acting_ms, sum(waiting_ms)::BIGINT AS waiting_ms,
  sum(paused_ms)::BIGINT AS paused_ms, sum(failed_ms)::BIGINT AS failed_ms,
  sum(resting_ms)::BIGINT AS resting_ms,
  sum(failures)::BIGINT AS failures, sum(alarms)::BIGINT AS alarms,
  sum(interventions)::BIGINT AS interventions
FROM (
  SELECT run, robot, place, arrived::BIGINT AS visits,
    acting_ms, waiting_ms, paused_ms, failed_ms, resting_ms,
    0 AS failures, 0 AS alarms, 0 AS interventions
  FROM {stays}
  UNION ALL
  SELECT run, robot, place, 0, 0, 0, 0, 0, 0,
    (kind = 'failure')::INTEGER, (kind = 'alarm')::INTEGER, (kind = 'intervention')::INTEGER
  FROM {moments} WHERE kind IN ('failure', 'alarm', 'intervention')
)
GROUP BY run, robot, place ORDER BY robot, place
"""


def open_database(temporary: str) -> Any:
    """Create a database in memory, which can read and write files.

    :param temporary: the folder for data that does not fit into memory.
    :raises InputError: DuckDB is not installed.
    """
    database = duckdb().connect()
    database.execute("SET memory_limit='%s'" % DATABASE_MEMORY)
    database.execute("SET temp_directory=%s" % quoted(temporary))
    database.execute("SET preserve_insertion_order=false")
    return database


def duckdb() -> Any:
    """The module ``duckdb``. :raises InputError: it is not installed."""
    try:
        import duckdb as module
    except ModuleNotFoundError:
        raise InputError(
            "a fleet's history needs DuckDB, which is not installed",
            # for Python 3.8, later versions exist only as source code
            hint="pip install duckdb" if sys.version_info >= (3, 9) else 'pip install "duckdb<1.2"',
        ) from None
    return module


@contextlib.contextmanager
def explained(folder: str) -> Iterator[None]:
    """Convert errors of DuckDB to errors of this package.

    :param folder: the folder of the store.
    :raises InputError: a file cannot be read or written.
    """
    module = duckdb()
    try:
        yield
    except module.Error as error:
        raise InputError(
            "DuckDB cannot read or write here: %s" % str(error).strip().splitlines()[0],
            file=folder,
        ) from None


def quoted(text: str) -> str:
    """Quote a text as SQL."""
    return "'%s'" % text.replace("'", "''")


def files_sql(table: str, files: Sequence[str]) -> str:
    """SQL that reads a table from its files, for a FROM clause."""
    if not files:
        columns = [*TABLES[table], ("day", "DATE")]
        return "(SELECT %s WHERE false)" % ", ".join(
            'NULL::%s AS "%s"' % (kind, name) for name, kind in columns
        )
    return "read_parquet([%s], hive_partitioning=true, hive_types={'day': DATE})" % ", ".join(
        map(quoted, files)
    )


def write_table(database: Any, sql: str, path: str) -> None:
    """Write the result of a query as a Parquet file."""
    database.execute("COPY (%s) TO %s (FORMAT parquet, COMPRESSION zstd)" % (sql, quoted(path)))


def totals_sql(stays: str, moments: str) -> str:
    """The query that adds up stays and moments, each given as SQL."""
    return _TOTALS.format(stays=stays, moments=moments)


def one_question(database: Any, sql: str) -> Any:
    """Run a query written by a person, which must be a single SELECT.

    The database must first be restricted to its files: see :func:`keep_to`.

    :returns: the cursor with the result.
    :raises UsageError: it is not a single SELECT, or DuckDB refuses it; the message says why.
    :raises LimitError: it needs more memory than it may use.
    """
    module = duckdb()
    try:
        statements = module.extract_statements(sql)
        if len(statements) != 1 or statements[0].type != module.StatementType.SELECT:
            raise UsageError(
                "this is not a single SELECT",
                hint="the tables are %s; they cannot be changed" % ", ".join(TABLES),
            )
        return database.execute(statements[0])
    except module.OutOfMemoryException:
        raise LimitError(
            "the query needs more than %s of memory" % DATABASE_MEMORY,
            hint="ask for fewer days, or group by less",
        ) from None
    except module.Error as error:
        raise UsageError(str(error).strip().splitlines()[0]) from None


def keep_to(database: Any, files: Sequence[str], temporary: str) -> None:
    """From now on let the database open only these files, and lock its settings.

    :param temporary: the folder for data that does not fit into memory.
    :raises InputError: this version of DuckDB cannot do that.
    """
    version = tuple(int(part) for part in duckdb().__version__.split(".")[:2])
    if version < OLDEST_FOR_SQL:
        raise InputError(
            "DuckDB %s cannot be restricted to the files of a store" % duckdb().__version__,
            hint="'gspn history sql' needs DuckDB 1.2 or later, which needs Python 3.9",
        )
    database.execute("SET allowed_paths=[%s]" % ", ".join(map(quoted, files)))
    database.execute("SET allowed_directories=[%s]" % quoted(temporary))
    for setting in ("enable_external_access=false", "lock_configuration=true"):
        database.execute("SET " + setting)
