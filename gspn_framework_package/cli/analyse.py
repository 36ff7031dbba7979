"""``gspn analyse``: computes the structure, states and performance of a net, or of a plan under its
policy."""

from __future__ import annotations

import argparse
import csv
import json
import math
import sys
from itertools import islice
from pathlib import Path
from typing import Any, Dict, Iterable, Iterator, List, Tuple, Union

from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.limits import Limits
from gspn_framework_package.analysis.on_disk.answers import report_within
from gspn_framework_package.analysis.plan.reading import READINGS
from gspn_framework_package.analysis.report import (
    Questions,
    asked_conditions,
    open_questions,
    report,
)
from gspn_framework_package.analysis.report_measures import Part, keys_of
from gspn_framework_package.analysis.report_rows import rows
from gspn_framework_package.analysis.state_space import ENGINES
from gspn_framework_package.analysis.watch import Cancel, Progress
from gspn_framework_package.cli.analysis_text import analysis_text
from gspn_framework_package.cli.interrupts import leave
from gspn_framework_package.cli.limits import (
    LIMIT_OPTIONS,
    PHASES_OPTION,
    check_phases,
    limits_of,
    rare_collections,
    working,
)
from gspn_framework_package.cli.memory import (
    LIBRARIES,
    MEMORY_OPTIONS,
    memory_of,
)
from gspn_framework_package.cli.net_input import add_subject_arguments, print_notes, read_subject
from gspn_framework_package.cli.options import Argument, Arguments, add_options, choice, repeated
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan

_PARTS = 1_000
"""Number of parts of the JSON text (a bracket, a name, a list) to write at once."""


_OPTIONS: Arguments = {
    "--json": "print all answers as one JSON object",
    Argument("--csv", "FILE"): "write the numbers to FILE as rows: measure, name, value, low, high",
}

_QUESTIONS: Arguments = {
    repeated("--query", "QUERY"): (
        "answer only temporal queries, such as 'P=? [ F<=10 done >= 2 ]', 'S=? [ busy = 1 ]' or "
        "'AG EF home = 1' (docs/analysis.md)"
    ),
    repeated("--at", "T", float, nargs="+"): "tokens and throughput at these times (s)",
    repeated("--reach", "CONDITION"): (
        "can this marking be reached, e.g. \"p3 >= 1 and 'p1:Check L1' == 0\" or deadlock"
    ),
    repeated("--cover", "P=N,..."): "can a marking with at least these tokens be reached",
    repeated("--mean-time-to", "CONDITION"): (
        "mean time until this holds, and with --at the probability within those times"
    ),
    repeated("--reward", "NAME=VALUE"): (
        "reward per token and second in a place, or per firing of a transition"
    ),
    Argument("--time-to-steady-state", "TOLERANCE", float, nargs="?", const=1e-3): (
        "time until the distribution stays this close to the steady state (1e-3)"
    ),
    "--no-structure": "leave out invariants, siphons and traps",
    "--no-time": "leave out the steady state",
    choice("--timing", READINGS): (
        "how to read the time of a plan: as it runs (default), or as its net alone; "
        "docs/analysis.md"
    ),
}

_EFFORT: Arguments = {
    **LIMIT_OPTIONS,
    **MEMORY_OPTIONS,
    **PHASES_OPTION,
    choice("--engine", ENGINES, "auto"): "the engine that explores (default: auto)",
    "--symbolic": (
        "count the markings of a net without visiting them; also the largest counts, dead "
        "markings, and transitions that never fire"
    ),
    "--lump": (
        "exploit symmetry: visit only one of the markings that differ by an exchange of equal "
        "parts of the net"
    ),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of this verb."""
    add_subject_arguments(parser)
    add_options(parser, _OPTIONS)
    add_options(parser.add_argument_group("questions"), _QUESTIONS)
    add_options(parser.add_argument_group("effort"), _EFFORT)
    parser.epilog = (
        "Exit codes: 0 answered, 1 some answers could not be decided (they are listed), 2 wrong "
        "input or wrong usage."
    )


def run(args: argparse.Namespace) -> int:
    """Analyse the net or plan, and print the answers."""
    try:
        with rare_collections():
            return _run(args)
    except KeyboardInterrupt:
        leave()  # flushed before Python destroys millions of objects, which takes seconds


def _run(args: argparse.Namespace) -> int:
    subject, notes = read_subject(args)
    questions = _questions(args, subject)
    limits, memory = limits_of(args), memory_of(args)
    if args.query:  # imported only here, since most analyses need no proofs
        from gspn_framework_package.cli.queries import answer_queries

        return answer_queries(args, subject, notes, limits)
    if memory is not None and isinstance(subject, Plan):
        raise UsageError(
            "--memory requires a net", hint="use --only-net to analyse the net of a plan"
        )
    if memory is not None and args.lump:
        raise UsageError("--memory and --lump exclude each other")

    lump = None
    if args.lump:
        if args.engine != "auto":
            raise UsageError("--lump uses its own engine", hint="leave out --engine")
        lump = asked_conditions(questions)

    def analyse(progress: Progress, cancel: Cancel) -> Tuple[Dict[str, Any], List[str]]:
        def make(limits: Limits) -> Analysis:
            return Analysis(
                subject,
                limits=limits,
                timing=args.timing,
                structure=questions.structure,
                engine=args.engine,
                lump=lump,
                phases=args.phases,
                progress=progress,
                cancel=cancel,
            )

        if memory is None or isinstance(subject, Plan):
            analysis = make(limits)
            data = report(analysis, questions)
        else:
            analysis, data = report_within(
                memory.size,
                subject,
                questions,
                memory.scratch,
                make,
                limits,
                seconds=args.limit_time or math.inf,
                progress=progress,
                cancel=cancel,
            )
        left_out: List[str] = []
        if args.no_structure:
            left_out += keys_of(Part.STRUCTURE, analysis)
        if args.no_time:
            left_out += ["steady_state", *keys_of(Part.TIMING, analysis)]
        return data, left_out

    data, left_out = (
        working(analyse, limits.memory)
        if memory is None
        else working(analyse, memory.size + LIBRARIES, "--memory")
    )
    data["notes"] = notes
    decided = not open_questions(data)
    try:
        if args.csv:
            with Path(args.csv).open("w", newline="", encoding="utf-8") as file:
                writer = csv.writer(file)
                writer.writerow(("measure", "name", "value", "low", "high"))
                writer.writerows(rows(data))
    finally:  # the answers are printed, even if they cannot be written
        _print(data, left_out, args.json)
    return 0 if decided else 1


def _questions(args: argparse.Namespace, subject: Union[Net, Plan]) -> Questions:
    questions = Questions(
        at=tuple(t for group in args.at for t in group),
        reach=tuple(args.reach),
        cover=tuple(_marking(text) for text in args.cover),
        mean_time_to=tuple(args.mean_time_to),
        rewards=dict(_pair(text, "--reward") for text in args.reward),
        settling=args.time_to_steady_state,
        structure=not args.no_structure,
        timing=not args.no_time,
        symbolic=args.symbolic,
    )
    if any(not (t >= 0 and math.isfinite(t)) for t in questions.at):
        raise UsageError("--at: a time must be a number of seconds, at least 0")
    questions.check(subject.net if isinstance(subject, Plan) else subject)
    check_phases(args, subject)
    if args.query:
        _check_queries(args, questions)
    if args.symbolic:
        _check_symbolic(args, subject, questions)
    return questions


def _check_symbolic(
    args: argparse.Namespace, subject: Union[Net, Plan], questions: Questions
) -> None:
    if isinstance(subject, Plan):
        raise UsageError(
            "--symbolic requires a net", hint="use --only-net to count the markings of its net"
        )
    for option in ("lump", "memory"):
        if getattr(args, option):
            raise UsageError("--symbolic and --%s exclude each other" % option)
    if args.engine != "auto":
        raise UsageError("--symbolic uses its own engine", hint="leave out --engine")
    if _asks_more(questions):
        raise UsageError(
            "--symbolic only counts markings",
            hint="leave out --symbolic, or the questions",
        )


def _check_queries(args: argparse.Namespace, questions: Questions) -> None:
    if _asks_more(questions):
        raise UsageError(
            "--query answers only queries",
            hint="leave out --query, or the questions",
        )
    for option in ("csv", "lump", "memory", "symbolic"):
        if getattr(args, option):
            raise UsageError("--query and --%s exclude each other" % option)


def _asks_more(questions: Questions) -> bool:
    """Whether the questions go beyond those that every analysis answers."""
    always = questions._replace(structure=True, timing=True, symbolic=False)
    return always != Questions(rewards={})


def _print(data: Dict[str, Any], left_out: List[str], as_json: bool) -> None:
    if not as_json:
        print_notes(data["notes"])
        print("\n".join(analysis_text(data)))
        return
    # the output has every key, even for parts that are left out
    data.update(dict.fromkeys(left_out))
    data["undecided"].update(dict.fromkeys(left_out, "left out, as requested"))
    parts = _json(data, "\n")
    # writing each part separately would take longer
    for block in iter(lambda: "".join(islice(parts, _PARTS)), ""):
        sys.stdout.write(block)
    print()


def _marking(text: str) -> Dict[str, int]:
    marking = {}
    for part in text.split(","):
        name, value = _pair(part, "--cover")
        if value != int(value) or value < 0:
            raise UsageError(
                "--cover %s: the number of tokens must be a non-negative integer" % text
            )
        marking[name] = int(value)
    return marking


def _pair(text: str, option: str) -> Tuple[str, float]:
    name, equals, value = text.rpartition("=")
    try:
        number = float(value)
    except ValueError:
        equals = ""
        number = math.nan
    if not equals or not name.strip() or not math.isfinite(number):
        raise UsageError("%s %s: expected NAME=NUMBER" % (option, text))
    return name.strip(), number


# -- JSON ------------------------------------------------------------------------------------------


def _json(value: Any, line_break: str) -> Iterator[str]:
    """Yield the text of ``json.dumps(value, indent=2)`` in parts.

    Python's encoder indents element by element, which is slow. Objects and lists without nested
    ones, which hold most of the elements, are therefore encoded without ``indent``, with line
    breaks as separators.

    :param line_break: the line break, with indentation, before the closing bracket.
    """
    if not isinstance(value, (dict, list, tuple)) or not value:
        yield json.dumps(value, allow_nan=False, ensure_ascii=False)
        return
    inner = line_break + "  "
    entries: Iterable[Any] = value.values() if isinstance(value, dict) else value
    if not any(isinstance(entry, (dict, list, tuple)) for entry in entries):
        text = json.dumps(
            value, allow_nan=False, ensure_ascii=False, separators=("," + inner, ": ")
        )
        yield text[0] + inner + text[1:-1] + line_break + text[-1]
        return
    before = inner
    yield "{" if isinstance(value, dict) else "["
    for name, entry in value.items() if isinstance(value, dict) else ((None, e) for e in value):
        yield before + ("" if name is None else json.dumps(name, ensure_ascii=False) + ": ")
        yield from _json(entry, inner)
        before = "," + inner
    yield line_break + ("}" if isinstance(value, dict) else "]")
