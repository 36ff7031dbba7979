"""Values that others published, computed anew: ``python3 -m
benchmarks.literature``.

One table: our value with its interval, the published one, how good its source says it is, and the
source. The exit code is 1 if a value does not agree. Two nets are worked on at a time, each in its
own process; Ctrl-C ends them. docs/literature.md explains the differences.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
import time
from typing import Any, Dict, List, Optional, Sequence

from benchmarks.literature.answers import CERTIFIED, Between
from benchmarks.literature.comparing import EXPLAINED, Row, compare_all, states_of
from benchmarks.literature.published import FILE, Published, read_published
from benchmarks.literature.questions import FAMILIES
from benchmarks.machine import describe_machine, machine_line, table
from gspn_framework_package.model.errors import GspnError, UsageError


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Compute the values, and report those that differ."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "families", nargs="*", metavar="FAMILY", help="which nets: %s" % ", ".join(FAMILIES)
    )
    parser.add_argument(
        "--largest", type=int, default=10**30, metavar="N", help="leave out nets of more states"
    )
    parser.add_argument("--processes", type=int, default=2, metavar="N", help="(default: 2)")
    parser.add_argument(
        "--certified",
        type=int,
        default=CERTIFIED,
        metavar="N",
        help="certify averages in the long run in chains of up to N states (default: %(default)s)",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args(arguments)
    started = time.perf_counter()
    try:
        rows = _computed(_asked(args.families, args.largest), args.processes, args.certified)
    except GspnError as error:
        print("error: %s" % error, file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("literature: interrupted", file=sys.stderr)
        return 130
    seconds = time.perf_counter() - started
    if args.json:
        found = {"machine": describe_machine(), "seconds": seconds, "values": _told(rows)}
        print(json.dumps(found, indent=1))
    else:
        print("%s\n\n%s" % (machine_line(), _text(rows)))
        print("\n%s in %.0f s" % (_summary(rows), seconds))
    return 1 if any(row.fails for row in rows) else 0


def _asked(families: Sequence[str], largest: int) -> List[List[Published]]:
    """The published values, those of each net together."""
    for name in families:
        if name not in FAMILIES:
            raise UsageError(
                "there are no nets '%s'" % name, hint="there are: " + ", ".join(FAMILIES)
            )
    values = [
        value
        for value in read_published(FILE.read_text(encoding="utf-8"))
        if not families or value.family in families
    ]
    values.sort(key=lambda v: (list(FAMILIES).index(v.family), v.size))
    grouped = [list(group) for _, group in itertools.groupby(values, key=lambda v: v[:2])]
    return [group for group in grouped if states_of(group) <= largest]


def _computed(groups: Sequence[List[Published]], processes: int, certified: int) -> List[Row]:
    rows: List[Row] = []
    if processes < 1:
        raise UsageError("at least one process is needed", hint="--processes 2")
    largest_first = sorted(groups, key=lambda g: states_of(g) or 10**30, reverse=True)
    for number, found in enumerate(compare_all(largest_first, processes, certified), 1):
        rows += found
        failing = ["%s %s" % (r.published.answer, r.verdict) for r in found if r.fails]
        print(
            "literature: %d of %d nets: %s %d, %.1f s, %s"
            % (
                number,
                len(groups),
                *found[0].published[:2],
                sum(row.seconds for row in found),
                "; ".join(failing) or "as published",
            ),
            file=sys.stderr,
            flush=True,
        )
    order = {id_of(value): k for k, group in enumerate(groups) for value in group}
    return sorted(rows, key=lambda row: order[id_of(row.published)])


def id_of(value: Published) -> Any:
    """What tells a published value from the others."""
    return value.family, value.size, value.answer, value.source


# -- reporting -------------------------------------------------------------------------------------


def _told(rows: Sequence[Row]) -> List[Dict[str, Any]]:
    return [
        {
            **row.published._asdict(),
            "ours": row.ours,
            "seconds": row.seconds,
            "verdict": row.verdict,
        }
        for row in rows
    ]


def _summary(rows: Sequence[Row]) -> str:
    failing = [row for row in rows if row.fails]
    wrong = sum(row.verdict == EXPLAINED for row in rows)
    agree = len(rows) - len(failing) - wrong
    return "%d values: %d agree, %d published ones are wrong, %d differ or have no answer" % (
        len(rows),
        agree,
        wrong,
        len(failing),
    )


def _text(rows: Sequence[Row]) -> str:
    head = ("net", "value", "ours", "width", "published", "kind", "verdict", "s", "source")
    cells = [
        [
            "%s %d" % row.published[:2],
            row.published.answer,
            _number(row.ours),
            _width(row.ours),
            row.published.text,
            row.published.kind,
            row.verdict,
            row.seconds,
            row.published.source,
        ]
        for row in rows
    ]
    return table(head, cells)


def _width(ours: Optional[Between]) -> Optional[str]:
    """The width of our interval; "~" before it if it is an estimate."""
    if ours is None:
        return None
    return "%s%.2g" % ("" if ours.certified else "~", ours.upper - ours.lower)


def _number(ours: Optional[Between]) -> Optional[str]:
    if ours is None:
        return None
    if ours.lower == ours.upper and ours.lower == int(ours.lower):
        return "%d" % ours.lower
    return "%.12g" % (0.5 * (ours.lower + ours.upper))


if __name__ == "__main__":
    sys.exit(main())
