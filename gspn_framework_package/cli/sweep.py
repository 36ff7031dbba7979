"""``gspn sweep``: measures a net or plan for many variations: teams, rates, durations, policies."""

from __future__ import annotations

import argparse
import csv
import io
import json
from typing import Any, Dict, Iterator, List, Optional, Sequence, Tuple

from gspn_framework_package.analysis.executors import Executor
from gspn_framework_package.analysis.sweeps.sweep import Sweep, SweepPoint, chosen
from gspn_framework_package.analysis.sweeps.variation import VARIATION_FORMS, read_variation
from gspn_framework_package.analysis.watch import Cancel, Progress, Watch
from gspn_framework_package.cli.limits import (
    LIMIT_OPTIONS,
    ON_OPTION,
    PHASES_OPTION,
    check_phases,
    limits_of,
    working_on,
)
from gspn_framework_package.cli.net_input import add_subject_arguments, print_notes, read_subject
from gspn_framework_package.cli.options import Argument, Arguments, add_options, repeated
from gspn_framework_package.cli.plot import begin_picture, save_picture
from gspn_framework_package.cli.simulated_runs import RUN_OPTIONS, asked_in_arguments
from gspn_framework_package.cli.sweep_figure import sweep_figure
from gspn_framework_package.cli.sweep_store import SUFFIX, PointStore
from gspn_framework_package.cli.table import aligned
from gspn_framework_package.formats.plan_file import read_policy_of
from gspn_framework_package.formats.source import write_bytes

Rows = List[Tuple[str, ...]]


_OPTIONS: Arguments = {
    Argument("--vary", "NAME=VALUES", action="append", required=True): (
        "%s; may be repeated: every combination is measured" % VARIATION_FORMS
    ),
    repeated("--measure", "NAME"): (
        "a transition (throughput), a place (mean tokens), end_time, reached or time_to_condition, "
        "or a pattern; may be repeated (default: all throughputs)"
    ),
    Argument("--output", "FILE.csv"): (
        "write the table to FILE.csv, and store the measured points in FILE.csv%s; the same "
        "command then measures only missing points" % SUFFIX
    ),
    Argument("--plot", "FILE"): "plot the measures over the first variation (.png .svg .pdf)",
    "--json": "print the result as one JSON object",
    **ON_OPTION,
}

_MEASURING: Arguments = {
    "--exact": "compute the steady state instead of simulating",
    **RUN_OPTIONS,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of this verb."""
    add_subject_arguments(parser)
    add_options(parser, _OPTIONS)
    add_options(parser.add_argument_group("how each point is measured"), _MEASURING)
    add_options(parser.add_argument_group("effort of --exact"), {**LIMIT_OPTIONS, **PHASES_OPTION})


def run(args: argparse.Namespace) -> int:
    """Measure the missing points, and print the table."""
    if args.plot:
        begin_picture(args.plot)
    variations = [read_variation(text) for text in args.vary]
    subject, notes = read_subject(args)
    check_phases(args, subject, args.exact)
    conditional = args.until is not None or getattr(subject, "until", None) is not None
    wanted = chosen(subject, args.measure, conditional and not args.exact)
    files = [
        str(v) for variation in variations if variation.kind == "policy" for v in variation.values
    ]
    asked = asked_in_arguments(args, [name for _, name in wanted if name] if args.precision else [])
    limits = limits_of(args)
    sweep = Sweep(
        subject,
        variations,
        asked,
        exact=args.exact,
        limits=limits,
        phases=args.phases,
        policies={file: read_policy_of(file) for file in files},
    )
    store = PointStore(args.output + SUFFIX) if args.output else None
    kept = sum(key in store.known for key in sweep.keys) if store else 0

    def work(progress: Progress, cancel: Cancel, executor: Executor) -> List[SweepPoint]:
        found = []
        known = dict(store.known) if store else {}
        for point in sweep.run(known, executor, Watch(progress, cancel)):
            found.append(point)
            if store is not None:
                store.add(point)
        return sorted(found)

    try:
        points = working_on(args.on, work, limits.memory)
    finally:
        if store is not None:
            store.close()
    notes += dict.fromkeys(note for point in points for note in point.notes)
    try:
        if args.output:
            _write(args.output, sweep, points, wanted)
        if args.plot:
            save_picture(sweep_figure(sweep, points, wanted), args.plot)
    finally:  # the measures are printed even if they cannot be written
        if args.json:
            print(json.dumps(_json(sweep, points, wanted, kept, notes), indent=2, allow_nan=False))
        else:
            print_notes(notes)
            print("%d points, %d of them known before" % (len(points), kept))
            print("\n".join(aligned(_table(sweep, points, wanted))))
    return 0


def _measured(
    points: Sequence[SweepPoint], wanted: Sequence[Tuple[str, str]]
) -> Iterator[Tuple[SweepPoint, str, str, float, Optional[float]]]:
    for point in points:
        for measure, name in wanted:
            if name in point.measures.get(measure, {}):
                yield (point, measure, name, *point.measures[measure][name])


def _write(
    path: str, sweep: Sweep, points: Sequence[SweepPoint], wanted: Sequence[Tuple[str, str]]
) -> None:
    """Write the table atomically."""
    text = io.StringIO()
    writer = csv.writer(text)
    names = [variation.name for variation in sweep.variations]
    writer.writerow((*names, "measure", "name", "mean", "half_width", "replications"))
    for point, measure, name, mean, half in _measured(points, wanted):
        written = "" if half is None else half
        writer.writerow((*point.values, measure, name, mean, written, point.replications))
    write_bytes(path, text.getvalue().encode())


def _json(
    sweep: Sweep,
    points: Sequence[SweepPoint],
    wanted: Sequence[Tuple[str, str]],
    kept: int,
    notes: Sequence[str],
) -> Dict[str, Any]:
    return {
        **sweep.to_json(points, wanted),
        "kept": kept,
        "exact": sweep.exact,
        "seed": sweep.asked.seed,
        "confidence": sweep.asked.confidence,
        "notes": list(notes),
    }


def _table(sweep: Sweep, points: Sequence[SweepPoint], wanted: Sequence[Tuple[str, str]]) -> Rows:
    rows: Rows = [(*(v.name for v in sweep.variations), *(name or m for m, name in wanted))]
    for point in points:
        cells = []
        for measure, name in wanted:
            found = point.measures.get(measure, {}).get(name)
            cells.append("" if found is None else _estimate(*found))
        rows.append((*map(_short, point.values), *cells))
    return rows


def _estimate(mean: float, half: Optional[float]) -> str:
    if half is None:
        return "%.5g ± ?" % mean
    return "%.5g" % mean + (" ± %.2g" % half if half else "")


def _short(value: object) -> str:
    return "%g" % value if isinstance(value, float) else str(value)
