"""``gspn analyse``: computes what a net, or a plan under its policy, can do, and how fast."""

from __future__ import annotations

import argparse
import csv
import json
import math
import re
import sys
from decimal import Decimal
from itertools import islice
from pathlib import Path
from typing import Any, Dict, Iterable, Iterator, List, Mapping, Optional, Sequence, Tuple

from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.limits import Limits
from gspn_framework_package.analysis.on_disk.answers import report_within
from gspn_framework_package.analysis.plan.reading import READINGS, RUN
from gspn_framework_package.analysis.report import (
    Part,
    Questions,
    asked_conditions,
    keys_of,
    report,
    rows,
    titled,
)
from gspn_framework_package.analysis.state_space import ENGINES
from gspn_framework_package.analysis.watch import Cancel, Progress
from gspn_framework_package.cli.interrupts import leave
from gspn_framework_package.cli.limits import (
    add_limit_arguments,
    limits_of,
    rare_collections,
    working,
)
from gspn_framework_package.cli.memory import (
    LIBRARIES,
    add_memory_arguments,
    memory_of,
    scratch_text,
)
from gspn_framework_package.cli.net_input import print_notes
from gspn_framework_package.cli.subject import add_subject_arguments, read_subject
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.plan import Plan

_PARTS = 1_000
"""Number of parts of the JSON text (a bracket, a name, a list) that are written together."""

SHOWN = 12
"""Number of entries of a list that the text shows; --json has all of them."""

TIMED = ("steady_state", "transient", "time_to_steady_state", "mean_time_to")
"""The keys of the measures that a simulation can estimate if they are not computed."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of this verb."""
    add_subject_arguments(parser)
    parser.add_argument("--json", action="store_true", help="print all answers as one JSON object")
    parser.add_argument(
        "--csv", metavar="FILE", help="write the numbers to FILE as rows: measure, name, value"
    )
    asking = parser.add_argument_group("questions")
    asking.add_argument(
        "--at",
        action="append",
        nargs="+",
        default=[],
        type=float,
        metavar="T",
        help="tokens and throughput at these times (s)",
    )
    asking.add_argument(
        "--reach",
        action="append",
        default=[],
        metavar="CONDITION",
        help="can this marking be reached, e.g. \"p3 >= 1 and 'p1:Check L1' == 0\" or deadlock",
    )
    asking.add_argument(
        "--cover",
        action="append",
        default=[],
        metavar="P=N,...",
        help="can a marking with at least these tokens be reached",
    )
    asking.add_argument(
        "--mean-time-to",
        action="append",
        default=[],
        metavar="CONDITION",
        help="mean time until this holds, and with --at the probability within those times",
    )
    asking.add_argument(
        "--reward",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="reward per token and second in a place, or per firing of a transition",
    )
    asking.add_argument(
        "--time-to-steady-state",
        type=float,
        nargs="?",
        const=1e-3,
        metavar="TOLERANCE",
        help="time until the distribution stays this close to the steady state (1e-3)",
    )
    asking.add_argument(
        "--no-structure", action="store_true", help="leave out invariants, siphons and traps"
    )
    asking.add_argument("--no-time", action="store_true", help="leave out the steady state")
    asking.add_argument(
        "--timing",
        choices=READINGS,
        help="how to read the time of a plan: as it runs (default), or as its net alone; docs/"
        "analysis.md",
    )
    effort = parser.add_argument_group("effort")
    add_limit_arguments(effort)
    add_memory_arguments(effort)
    effort.add_argument(
        "--engine", choices=ENGINES, default="auto", help="the engine that explores (default: auto)"
    )
    effort.add_argument(
        "--on",
        choices=("local", "mpi"),
        default="local",
        help="who computes: this process (local), or all those that mpiexec started, each with a "
        "part of the states (mpi): docs/scaling.md",
    )
    effort.add_argument(
        "--lump",
        action="store_true",
        help="exchange equal parts of a net: visit one marking for all that differ only by that",
    )
    parser.epilog = "Exit codes: 0 answered (open questions are listed), 2 wrong input or usage."


def run(args: argparse.Namespace) -> int:
    """Analyse the net or plan, and print the answers."""
    try:
        with rare_collections():
            if args.on == "mpi":
                from gspn_framework_package.cli.analyse_mpi import run_on_mpi

                return run_on_mpi(args)
            return _run(args)
    except KeyboardInterrupt:
        leave()  # before Python destroys millions of objects, which takes seconds


def _run(args: argparse.Namespace) -> int:
    subject, notes = read_subject(args)
    questions = Questions(
        at=tuple(t for group in args.at for t in group),
        reach=tuple(args.reach),
        cover=tuple(_marking(text) for text in args.cover),
        mean_time_to=tuple(args.mean_time_to),
        rewards=dict(_pair(text, "--reward") for text in args.reward),
        settling=args.time_to_steady_state,
        structure=not args.no_structure,
        timing=not args.no_time,
    )
    if any(not (t >= 0 and math.isfinite(t)) for t in questions.at):
        raise UsageError("--at: a time is a number of seconds, at least 0")
    limits, memory = limits_of(args), memory_of(args)
    if memory is not None and isinstance(subject, Plan):
        raise UsageError("--memory takes a net", hint="--only-net analyses the net of a plan")
    if memory is not None and args.lump:
        raise UsageError("--memory and --lump exclude each other")

    lump = None
    if args.lump:
        if args.engine != "auto":
            raise UsageError("--lump explores with an engine of its own", hint="leave out --engine")
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
    if args.csv:
        with Path(args.csv).open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(("measure", "name", "value"))
            writer.writerows(rows(data))
    if args.json:
        # the output has every key, even if a part is left out
        data.update(dict.fromkeys(left_out))
        data["undecided"].update(dict.fromkeys(left_out, "left out, as asked"))
        parts = _json(data, "\n")
        # writing each part separately takes longer
        for block in iter(lambda: "".join(islice(parts, _PARTS)), ""):
            sys.stdout.write(block)
        print()
    else:
        print_notes(notes)
        print("\n".join(_text(data)))
    return 0


def _marking(text: str) -> Dict[str, int]:
    marking = {}
    for part in text.split(","):
        name, value = _pair(part, "--cover")
        if value != int(value) or value < 0:
            raise UsageError("--cover %s: a number of tokens is whole and not negative" % text)
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
        raise UsageError("%s %s: NAME=NUMBER was expected" % (option, text))
    return name.strip(), number


# -- JSON ------------------------------------------------------------------------------------------


def _json(value: Any, line_break: str) -> Iterator[str]:
    """Yield the text of ``json.dumps(value, indent=2)`` in parts.

    Python itself indents one element at a time. So an object or list without others inside, as most
    elements are in one, is encoded without ``indent``, with line breaks as separators.

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


# -- text ------------------------------------------------------------------------------------------


def subject_text(data: Mapping[str, Any]) -> str:
    """A line on what is analysed."""
    return "%s %s: %d places, %d transitions, %d arcs, %d tokens" % (
        data["kind"],
        data["name"] or "without a name",
        data["places"],
        data["transitions"],
        data["arcs"],
        data["tokens"],
    )


def _text(data: Mapping[str, Any]) -> Iterator[str]:
    yield subject_text(data)
    if "conservative" in data:
        yield from _structure_text(data)
        yield from _titled_text(data, Part.STRUCTURE)
    yield from _behaviour_text(data)
    yield from _titled_text(data, Part.BEHAVIOUR)
    for entry in data.get("reach") or ():
        yield from _reach_text(entry, "reachable")
    for entry in data.get("cover") or ():
        yield from _reach_text(entry, "coverable")
    if data.get("steady_state"):
        yield from _steady_text(data["steady_state"])
    yield from _titled_text(data, Part.TIMING)
    if data.get("time_to_steady_state") is not None:
        yield "time to steady state: %s s" % _number(data["time_to_steady_state"])
    for entry in data.get("transient") or ():
        yield "at %g s: mean tokens %s" % (entry["time"], _map(entry["mean_tokens"]))
        yield "    throughput (1/s) %s" % _map(entry["throughput"])
    for entry in data.get("mean_time_to") or ():
        if entry:
            yield "mean time to %s: %s s, probability %s" % (
                entry["condition"],
                _number(entry["mean_time"]),
                _number(entry["probability"]),
            )
            for within in entry["within"]:
                yield "    within %g s with probability %s" % (
                    within["time"],
                    _number(within["probability"]),
                )
    yield from _undecided_text(data)


def _titled_text(data: Mapping[str, Any], part: Part) -> Iterator[str]:
    """Yield the measures of a part that have a title but no special layout."""
    for key, title in titled(data, part):
        value = data[key]
        if isinstance(value, dict):
            yield "%s: %s" % (title, _map(value))
        elif isinstance(value, list):
            yield "%s: %s" % (title, _some([str(entry) for entry in value]) or "none")
        elif value is None or isinstance(value, bool):
            yield "%s: %s" % (title, _answer(value))
        else:
            yield "%s: %s" % (title, _number(value))


def _undecided_text(data: Mapping[str, Any]) -> Iterator[str]:
    """Yield every reason once, with all the measures that it applies to."""
    concerned: Dict[str, List[str]] = {}
    for key, reason in data["undecided"].items():
        concerned.setdefault(re.sub("^not decided[:,]? ", "", reason), []).append(key)
    for reason, keys in concerned.items():
        yield "not decided: %s: %s" % (", ".join(keys), reason)
    if data["states"] is None and any(key.split(".")[0] in TIMED for key in data["undecided"]):
        yield (
            "gspn simulate estimates tokens, throughput and times without all states, "
            "from random runs"
        )


def _structure_text(data: Mapping[str, Any]) -> Iterator[str]:
    words = ("conservative", "strictly_conservative", "consistent", "repetitive")
    yield "by structure, with the tokens of all places: %s" % ", ".join(
        "%s %s" % (word.replace("_", " "), _answer(data[word])) for word in words
    )
    if data["kind"] == "plan" and data["conservative"] is False:
        yield (
            "    (resource places count too; "
            "gspn check says whether robots are created or destroyed)"
        )
    classes = [name.replace("_", " ") for name, holds in (data["classes"] or {}).items() if holds]
    yield "classes: %s" % (", ".join(classes) or "none")
    for key, title in (
        ("place_invariants", "P-invariants"),
        ("transition_invariants", "T-invariants"),
    ):
        found = data[key]
        yield "%s: %s" % (title, "not decided" if found is None else len(found))
        for invariant in (found or [])[:SHOWN]:
            terms = [
                "%s%s" % ("" if w == 1 else "%d*" % w, n) for n, w in invariant["weights"].items()
            ]
            value = "" if invariant.get("value") is None else " = %d" % invariant["value"]
            yield "    %s%s" % (" + ".join(terms), value)
        yield from _more(found)
    for key in ("siphons", "traps"):
        found = data[key]
        yield "minimal %s: %s" % (key, "not decided" if found is None else len(found))
        for entry in (found or [])[:SHOWN]:
            yield "    %s%s" % (
                ", ".join(entry["places"]),
                "" if entry["marked"] else " (unmarked)",
            )
        yield from _more(found)
    if data["unmarked_siphon"]:
        yield "never marked: %s" % _some(data["unmarked_siphon"])
    guarded = data["siphons_hold_marked_traps"]
    without = " (not: %s)" % _some(data["unguarded_siphon"]) if guarded is False else ""
    yield "every siphon holds a marked trap: %s%s" % (_answer(guarded), without)


def _behaviour_text(data: Mapping[str, Any]) -> Iterator[str]:
    states = data["states"]
    if states:
        yield "states: %s (%s tangible, %s vanishing), %s arcs, %.1f MB (%s)" % (
            *(format(states[k], ",") for k in ("total", "tangible", "vanishing", "arcs")),
            data["memory_bytes"] / 1e6,
            data["engine"],
        )
    if "lumped" in data:
        yield from _lumped_text(data["lumped"], states)
    if data["kind"] == "plan":
        yield from _timing_text(data["timing"])
    yield from scratch_text(data)
    if data["left_out"]:
        yield "left out, because only written: %s" % ", ".join(data["left_out"])
    yield "bounded: %s; bounds: %s" % (_answer(data["bounded"]), _map(data["bounds"]))
    dead = data["deadlocks"]
    if dead and dead["witness"] is not None:
        yield "deadlocks: %s, e.g. (%s), reached by %s" % (
            dead["count"] if dead["count"] is not None else "some",
            _map(dead["marking"]),
            ", ".join(dead["witness"]) or "nothing: at the start",
        )
    elif dead:
        yield "deadlocks: none"
    home, left_out = data["home_states"], _some(data["left_out"])
    yield "live: %s, reversible: %s%s" % (
        _answer(data["live"]),
        _answer(data["reversible"]),
        # the initial marking is a home state only if all states are
        " (without %s: yes)" % left_out
        if data["reversible"] is False and left_out and home["count"] == states["total"]
        else "",
    )
    if data["liveness"] and not data["live"]:
        yield "liveness: %s" % _map(data["liveness"])
    if home:
        yield "home states%s: %d" % (" without %s" % left_out if left_out else "", home["count"])


def _lumped_text(lumped: Mapping[str, Any], states: Optional[Mapping[str, int]]) -> Iterator[str]:
    visited = format(lumped["visited"], ",")
    if not lumped["parts"]:
        yield "exchanged: nothing, since no parts are equal"
    elif states:
        yield "exchanged: visited %s of %s markings: %s times fewer" % (
            visited,
            format(states["total"], ","),
            format(Decimal(lumped["factor"]), ".3g"),
        )
    else:
        yield "exchanged: visited %s markings, each for up to %s" % (
            visited,
            format(Decimal(lumped["permutations"]), ".4g"),
        )
    for part in lumped["parts"][:SHOWN]:
        yield "    %s" % part
    yield from _more(lumped["parts"])
    if lumped["unused_generators"]:
        yield (
            "    parts of unknown form were not exchanged (%d generators of the group)"
            % lumped["unused_generators"]
        )


def _timing_text(timing: Mapping[str, Any]) -> Iterator[str]:
    as_it_runs = timing["reading"] == RUN
    yield "time: %s" % ("as the plan runs" if as_it_runs else "as in its net alone (--timing net)")
    if as_it_runs:
        splits = timing["splits"]
        yield "    doing and done are told apart in%s" % (
            ":" if splits else " no place: the net is the same chain"
        )
        for place, why in list(splits.items())[:SHOWN]:
            yield "        %s: %s" % (place, why)
        yield from _more(splits)
    for assumption in timing["assumptions"]:
        yield "    assumed: %s" % assumption


def _reach_text(entry: Any, word: str) -> Iterator[str]:
    if entry:
        way = (
            ""
            if entry["witness"] is None
            else ", by %s" % (", ".join(entry["witness"]) or "nothing: at the start")
        )
        yield "%s: %s %s%s" % (entry["condition"], word, _answer(entry[word]), way)


def time_text(data: Mapping[str, Any]) -> Iterator[str]:
    """Yield what several ranks found out about time."""
    if data["steady_state"]:
        yield from _steady_text(data["steady_state"])
    yield from _undecided_text(data)


def _steady_text(steady: Mapping[str, Any]) -> Iterator[str]:
    yield "steady state (%s, residual %.1e):" % (steady["method"], steady["residual"])
    if steady["component_count"] != 1:
        for part in steady["components"]:
            kind = "a recurrent class of %s states, most of the time in" % format(
                part["states"], ","
            )
            if part["states"] == 1:
                kind = "the deadlock" if part["deadlock"] else "one state for good:"
            elif part["alike"] != 1:
                kind = "%s of equal parts, %s states together, such as" % (
                    "some recurrent class"
                    if part["alike"] is None
                    else "one of %s deadlocks" % format(part["alike"], ","),
                    format(part["states"], ","),
                )
            yield "    with probability %s it ends in %s (%s)" % (
                _number(part["probability"]),
                kind,
                _map(part["marking"]),
            )
        others = (steady["component_count"] or 0) and (
            steady["component_count"] - sum(part["alike"] for part in steady["components"])
        )
        if others:
            yield "    with probability %s in one of %s others; of all %s, %s are deadlocks" % (
                _number(steady["probability_of_other_components"]),
                *(
                    format(n, ",")
                    for n in (others, steady["component_count"], steady["deadlock_count"])
                ),
            )
    yield "    %-32s %14s %14s" % ("place", "mean tokens", "mean wait (s)")
    for place, mean in steady["mean_tokens"].items():
        yield "    %-32s %14s %14s" % (
            place,
            _number(mean),
            _number(steady["mean_waiting_time"][place]),
        )
    yield "    %-32s %14s" % ("transition", "throughput 1/s")
    for transition, value in steady["throughput"].items():
        yield "    %-32s %14s" % (transition, _number(value))
    if "reward" in steady:
        yield "    reward per second: %s" % _number(steady["reward"])


def _answer(value: Any) -> str:
    return "not decided" if value is None else ("yes" if value else "no")


def _number(value: Any) -> str:
    if value is None:
        return "-"
    return value if isinstance(value, str) else "%.8g" % value


def _map(values: Mapping[str, Any]) -> str:
    shown = ["%s %s" % (name, _number(v)) for name, v in list(values.items())[:SHOWN]]
    return ", ".join(shown) + (", ... (%d in all)" % len(values) if len(values) > SHOWN else "")


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:SHOWN]) + (
        ", ... (%d in all)" % len(names) if len(names) > SHOWN else ""
    )


def _more(found: Any) -> Iterator[str]:
    if found and len(found) > SHOWN:
        yield "    ... (%d in all)" % len(found)
