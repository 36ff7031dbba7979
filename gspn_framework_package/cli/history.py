"""``gspn history``: months of a fleet's event logs as tables, and reports on them."""

from __future__ import annotations

import argparse
import csv
import itertools
import json
import sys
from typing import Any, Dict, Iterable, List, Sequence

from gspn_framework_package.cli.progress import ProgressLine
from gspn_framework_package.cli.table import aligned

_SHOWN = 1000
"""Rows of an answer that are shown as a table."""

_MORE = "only the first %d rows are shown; --csv and --json print all" % _SHOWN


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what this verb does, each with its arguments."""
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)

    told = "read event logs into a store; logs that have grown are read on"
    made = commands.add_parser("ingest", help=told, description=told)
    made.add_argument("logs", nargs="+", metavar="LOG", help="event logs, or folders of them")
    _add_store(made, "a new, empty or existing one")
    made.add_argument("--json", action="store_true", help="print what became of each log as JSON")
    made.epilog = "Exit codes: 0 all is in the store, 1 some logs are not, 2 wrong input or usage."
    made.set_defaults(command=_ingest)

    told = "show use, waiting, visits, failures, alarms and orders of the operator"
    made = commands.add_parser("report", help=told, description=told)
    _add_store(made, "which store")
    made.add_argument(
        "--by",
        default="robot",
        metavar="GROUP[,GROUP]",
        help="day, robot, place, run: a row for each (default: robot)",
    )
    made.add_argument("--since", default="", metavar="DAY", help="the first day, as 2026-05-04")
    made.add_argument("--until", default="", metavar="DAY", help="the last day")
    for name in ("robot", "place", "run"):
        made.add_argument(
            "--" + name,
            action="append",
            dest="run_key" if name == "run" else name,
            default=[],
            metavar="NAME" if name != "run" else "KEY",
            help="only this %s (more than once: these)" % name,
        )
    _add_forms(made)
    made.epilog = "Days are those of UTC. Exit codes: 0 shown, 2 wrong input or usage."
    made.set_defaults(command=_report)

    told = "ask a question in SQL, of the tables stays, moments and totals"
    made = commands.add_parser("sql", help=told, description=told)
    made.add_argument("question", metavar="SQL", help="one SELECT")
    _add_store(made, "which store")
    _add_forms(made)
    made.epilog = "Nothing can be changed, and no other file be read. Exit codes: 0, 2."
    made.set_defaults(command=_sql)


def run(args: argparse.Namespace) -> int:
    """Carry out the command."""
    return int(args.command(args))


def _add_store(parser: argparse.ArgumentParser, which: str) -> None:
    parser.add_argument("--store", required=True, metavar="DIR", help="the folder: " + which)


def _add_forms(parser: argparse.ArgumentParser) -> None:
    forms = parser.add_mutually_exclusive_group()
    forms.add_argument("--json", action="store_true", help="print one JSON object")
    forms.add_argument("--csv", action="store_true", help="print CSV")


def _ingest(args: argparse.Namespace) -> int:
    from gspn_framework_package.fleet.database import duckdb
    from gspn_framework_package.fleet.ingest import Ingest, IngestedLog
    from gspn_framework_package.fleet.store import Store

    duckdb()  # say at once that it is missing
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

    question = Question(
        tuple(args.by.split(",")),
        args.since,
        args.until,
        tuple(args.robot),
        tuple(args.place),
        tuple(args.run_key),
    )
    rows = history_report(Store(args.store), question)
    if args.json:
        print(json.dumps({**question._asdict(), "rows": rows}))
        return 0
    columns = list(rows[0]) if rows else list(question.by)
    if args.csv:
        _print_csv(columns, ([row[name] for name in columns] for row in rows))
        return 0
    if not rows:
        print("nothing is in the store for this")
        return 0
    _print_table([_HEADS.get(name, name) for name in columns], map(_shown, rows[:_SHOWN]))
    if len(rows) > _SHOWN:
        print(_MORE)
    return 0


_HEADS = {
    "acting_s": "acting h",
    "waiting_s": "waiting h",
    "paused_s": "paused h",
    "failed_s": "failed h",
    "resting_s": "resting h",
}


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
