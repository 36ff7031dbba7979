"""``gspn history``: months of a fleet's event logs as tables, and reports on them."""

from __future__ import annotations

import argparse
import csv
import itertools
import json
import sys
from typing import Any, Dict, Iterable, List, Sequence

from gspn_framework_package.cli.options import Argument, Arguments, add_options, repeated
from gspn_framework_package.cli.progress import ProgressLine
from gspn_framework_package.cli.table import aligned

_SHOWN = 1000
"""Maximum number of rows shown as a table."""

_MORE = "showing only the first %d rows; --csv and --json print all" % _SHOWN

_STORE: Arguments = {Argument("--store", "DIR", required=True): "the folder: the store"}

_FORMS: Arguments = {"--json": "print one JSON object", "--csv": "print CSV"}

_INGEST: Arguments = {
    Argument("logs", "LOG", nargs="+"): "event logs, or folders of them",
    Argument("--store", "DIR", required=True): "the folder: a new, empty or existing store",
    "--json": "print the result for each log as JSON",
}

_REPORT: Arguments = {
    **_STORE,
    Argument("--by", "GROUP[,GROUP]", default="robot"): (
        "one row for each day, robot, place or run (default: robot)"
    ),
    Argument("--since", "DAY", default=""): "the first day, as 2026-05-04",
    Argument("--until", "DAY", default=""): "the last day",
    repeated("--robot", "NAME"): "only this robot (may be repeated)",
    repeated("--place", "NAME"): "only this place (may be repeated)",
    repeated("--run", "KEY", dest="run_key"): "only this run (may be repeated)",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the subcommands of this verb with their arguments."""
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)

    about = "read event logs into a store; of logs that have grown, only the new part is read"
    made = commands.add_parser("ingest", help=about, description=about)
    add_options(made, _INGEST)
    made.epilog = "Exit codes: 0 all logs are in the store, 1 some are not, 2 wrong input or usage."
    made.set_defaults(command=_ingest)

    about = "show use, waiting, visits, failures, alarms and orders of the operator"
    made = commands.add_parser("report", help=about, description=about)
    add_options(made, _REPORT)
    add_options(made.add_mutually_exclusive_group(), _FORMS)
    made.epilog = "Days are in UTC. Exit codes: 0 shown, 2 wrong input or usage."
    made.set_defaults(command=_report)

    about = "query the tables stays, moments and totals in SQL"
    made = commands.add_parser("sql", help=about, description=about)
    add_options(made, {Argument("question", "SQL"): "a single SELECT", **_STORE})
    add_options(made.add_mutually_exclusive_group(), _FORMS)
    made.epilog = (
        "Read-only: nothing can be changed, and no other file can be read. Exit codes: "
        "0 shown, 2 wrong input or usage."
    )
    made.set_defaults(command=_sql)


def run(args: argparse.Namespace) -> int:
    """Run the subcommand."""
    return int(args.command(args))


def _ingest(args: argparse.Namespace) -> int:
    from gspn_framework_package.fleet.database import duckdb
    from gspn_framework_package.fleet.ingest import Ingest, IngestedLog
    from gspn_framework_package.fleet.store import Store

    duckdb()  # report a missing store at once
    store = Store(args.store, create=True)
    found: List[IngestedLog] = []
    with store.locked(), ProgressLine() as progress:
        for log in Ingest(store, progress).read(args.logs):
            found.append(log)
            if not args.json:
                _tell(log)
    if args.json:
        print(json.dumps({"logs": [log._asdict() for log in found]}))
    return 1 if any(log.error or log.left_out for log in found) else 0


def _tell(log: Any) -> None:
    if log.error:
        print("error: %s" % log.error, file=sys.stderr)
    elif log.left_out:
        print("left out: %s: %s" % (log.log, log.left_out), file=sys.stderr)
    else:
        print("%s: %d slots new, %d rows" % (log.log, log.slots, log.rows))


def _report(args: argparse.Namespace) -> int:
    from gspn_framework_package.fleet.reports import Question, history_report
    from gspn_framework_package.fleet.store import Store

    only = tuple(args.robot), tuple(args.place), tuple(args.run_key)
    question = Question(tuple(args.by.split(",")), args.since, args.until, *only)
    rows = history_report(Store(args.store), question)
    if args.json:
        print(json.dumps({**question._asdict(), "rows": rows}))
        return 0
    columns = list(rows[0]) if rows else list(question.by)
    if args.csv:
        _print_csv(columns, ([row[name] for name in columns] for row in rows))
        return 0
    if not rows:
        print("no matching data in the store")
        return 0
    _print_table([_HEADS.get(name, name) for name in columns], map(_shown, rows[:_SHOWN]))
    if len(rows) > _SHOWN:
        print(_MORE)
    return 0


_HEADS = {use + "_s": use + " h" for use in ("acting", "waiting", "paused", "failed", "resting")}


def _shown(row: Dict[str, Any]) -> List[str]:
    shown = []
    for name, value in row.items():
        if name in _HEADS:
            shown.append("%.2f" % (value / 3600))
        elif name == "use":
            shown.append("-" if value is None else "%.1f %%" % (100 * value))
        else:
            shown.append("(team)" if value == "" else str(value))
    return shown


def _sql(args: argparse.Namespace) -> int:
    from gspn_framework_package.fleet.reports import ask_sql
    from gspn_framework_package.fleet.store import Store

    answer = ask_sql(Store(args.store), args.question)
    if args.json:
        rows = [dict(zip(answer.columns, row)) for row in answer.rows]
        print(json.dumps({"columns": list(answer.columns), "rows": rows}))
    elif args.csv:
        _print_csv(answer.columns, answer.rows)
    else:
        shown = list(itertools.islice(answer.rows, _SHOWN))
        _print_table(answer.columns, [["" if v is None else str(v) for v in r] for r in shown])
        if next(answer.rows, None) is not None:
            print(_MORE)
    return 0


def _print_csv(columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    writer = csv.writer(sys.stdout, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)


def _print_table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    print("\n".join(aligned([columns, *rows])))
