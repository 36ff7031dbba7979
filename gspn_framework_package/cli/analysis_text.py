"""Formats the output of ``gspn analyse`` for people."""

from __future__ import annotations

import math
import re
from decimal import Decimal
from typing import Any, Dict, Iterator, List, Mapping, Optional, Sequence

from gspn_framework_package.analysis.plan.reading import RUN
from gspn_framework_package.analysis.report_measures import Part
from gspn_framework_package.analysis.report_rows import titled
from gspn_framework_package.analysis.symbolic.answers import SYMBOLIC
from gspn_framework_package.cli.memory import scratch_text

_SHOWN = 12
"""Number of entries of a list that the text shows; --json has all of them."""

TIMED = ("steady_state", "transient", "time_to_steady_state", "mean_time_to")
"""The keys of the measures that a simulation can estimate if they are not computed."""


def analysis_text(data: Mapping[str, Any]) -> Iterator[str]:
    """Yield the lines of a report (see :mod:`~gspn_framework_package.analysis.report`)."""
    called = data["kind"], data["name"] or "without a name"
    sizes = [data[key] for key in ("places", "transitions", "arcs", "tokens")]
    yield "%s %s: %d places, %d transitions, %d arcs, %d tokens" % (*called, *sizes)
    if "conservative" in data:
        yield from _structure_text(data)
        yield from _titled_text(data, Part.STRUCTURE)
    yield from _behaviour_text(data)
    yield from _titled_text(data, Part.BEHAVIOUR)
    for entry in data.get("reach") or ():
        yield from _reach_text(entry, "reachable")
    for entry in data.get("cover") or ():
        yield from _reach_text(entry, "coverable")
    spans = data.get("intervals") or {}
    if data.get("steady_state"):
        yield from _steady_text(data["steady_state"], spans)
    yield from _titled_text(data, Part.TIMING)
    if data.get("time_to_steady_state") is not None:
        yield "time to steady state: %s s" % _number(data["time_to_steady_state"])
    for i, entry in enumerate(data.get("transient") or ()):
        tokens, rates = (
            _map(entry[of], spans.get("transient.%d.%s" % (i, of)))
            for of in ("mean_tokens", "throughput")
        )
        yield "at %g s: mean tokens %s" % (entry["time"], tokens)
        yield "    throughput (1/s) %s" % rates
    for i, entry in enumerate(data.get("mean_time_to") or ()):
        if entry:
            ends = spans.get("mean_time_to.%d" % i, {})
            mean, chance = (
                _number(entry[of]) + _within(ends.get(of)) for of in ("mean_time", "probability")
            )
            yield "mean time to %s: %s s, probability %s" % (entry["condition"], mean, chance)
            for n, within in enumerate(entry["within"]):
                chance = _number(within["probability"]) + _within(ends.get("within.%d" % n))
                yield "    within %g s with probability %s" % (within["time"], chance)
    if spans:
        yield "in brackets: the intervals of the answers, since %s" % " and ".join(
            data["interval_sources"]
        )
    yield from _undecided_text(data)


def _titled_text(data: Mapping[str, Any], part: Part) -> Iterator[str]:
    """Yield the measures of a part that have a title but no special layout."""
    for key, title in titled(data, part):
        value, span = data[key], (data.get("intervals") or {}).get(key)
        if isinstance(value, dict):
            yield "%s: %s" % (title, _map(value, span))
        elif isinstance(value, list):
            yield "%s: %s" % (title, _some([str(entry) for entry in value]) or "none")
        elif value is None or isinstance(value, bool):
            yield "%s: %s" % (title, _answer(value))
        else:
            yield "%s: %s%s" % (title, _number(value), _within(span))


def _undecided_text(data: Mapping[str, Any]) -> Iterator[str]:
    """Yield every reason once, with all measures that it applies to."""
    concerned: Dict[str, List[str]] = {}
    for key, reason in data["undecided"].items():
        concerned.setdefault(re.sub("^not decided[:,]? ", "", reason), []).append(key)
    for reason, keys in concerned.items():
        yield "not decided: %s: %s" % (", ".join(keys), reason)
    if data["states"] is None and any(key.split(".")[0] in TIMED for key in data["undecided"]):
        yield (
            "gspn simulate can estimate tokens, throughput and times from random runs, without "
            "visiting all states"
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
        for invariant in (found or [])[:_SHOWN]:
            terms = [
                "%s%s" % ("" if w == 1 else "%d*" % w, n) for n, w in invariant["weights"].items()
            ]
            value = "" if invariant.get("value") is None else " = %d" % invariant["value"]
            yield "    %s%s" % (" + ".join(terms), value)
        yield from _more(found)
    for key in ("siphons", "traps"):
        found = data[key]
        yield "minimal %s: %s" % (key, "not decided" if found is None else len(found))
        for entry in (found or [])[:_SHOWN]:
            unmarked = "" if entry["marked"] else " (unmarked)"
            yield "    %s%s" % (", ".join(entry["places"]), unmarked)
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
        yield "left out, because it is never read: %s" % ", ".join(data["left_out"])
    yield "bounded: %s; bounds: %s" % (_answer(data["bounded"]), _map(data["bounds"]))
    dead = data["deadlocks"]
    if dead and dead["witness"] is not None:
        yield "deadlocks: %s, e.g. (%s), reached by %s" % (
            dead["count"] if dead["count"] is not None else "some",
            _map(dead["marking"]),
            ", ".join(dead["witness"]) or "nothing: at the start",
        )
    elif dead and dead["marking"] is not None:
        yield "deadlocks: %s, e.g. (%s)" % (format(dead["count"], ","), _map(dead["marking"]))
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
    if data["engine"] == SYMBOLIC and data["states"]:
        yield "transitions that never fire: %s" % (_some(data["dead_transitions"]) or "none")
    if data["liveness"] and not data["live"]:
        yield "liveness: %s" % _map(data["liveness"])
    if home:
        yield "home states%s: %d" % (" without %s" % left_out if left_out else "", home["count"])


def _lumped_text(lumped: Mapping[str, Any], states: Optional[Mapping[str, int]]) -> Iterator[str]:
    visited = format(lumped["visited"], ",")
    if not lumped["parts"]:
        yield "exchanged: nothing, since no parts are equal"
    elif states:
        yield "symmetry: visited %s of %s markings, %s times fewer" % (
            visited,
            format(states["total"], ","),
            format(Decimal(lumped["factor"]), ".3g"),
        )
    else:
        yield "exchanged: visited %s markings, each for up to %s" % (
            visited,
            format(Decimal(lumped["permutations"]), ".4g"),
        )
    for part in lumped["parts"][:_SHOWN]:
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
        yield "    doing and done are distinguished in%s" % (
            ":" if splits else " no place: the net gives the same chain"
        )
        for place, why in list(splits.items())[:_SHOWN]:
            yield "        %s: %s" % (place, why)
        yield from _more(splits)
    for assumption in timing["assumptions"]:
        yield "    assumed: %s" % assumption


def _reach_text(entry: Any, word: str) -> Iterator[str]:
    if entry:
        way = ""
        if entry["witness"] is not None:
            way = ", by %s" % (", ".join(entry["witness"]) or "nothing: at the start")
        yield "%s: %s %s%s" % (entry["condition"], word, _answer(entry[word]), way)


def _steady_text(steady: Mapping[str, Any], spans: Mapping[str, Any]) -> Iterator[str]:
    yield "steady state (%s, residual %.1e):" % (steady["method"], steady["residual"])
    if steady["component_count"] != 1:
        for part in steady["components"]:
            size = format(part["states"], ",")
            kind = "a recurrent class of %s states, most of the time in" % size
            if part["states"] == 1:
                kind = "the deadlock" if part["deadlock"] else "one absorbing state:"
            elif part["alike"] != 1:
                kind = "%s of equal parts, %s states together, such as" % (
                    "some recurrent class"
                    if part["alike"] is None
                    else "one of %s deadlocks" % format(part["alike"], ","),
                    size,
                )
            ends = _number(part["probability"]), kind, _map(part["marking"])
            yield "    with probability %s it ends in %s (%s)" % ends
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
        wait = steady["mean_waiting_time"][place]
        both = [
            spans.get("steady_state." + key, {}).get(place)
            for key in ("mean_tokens", "mean_waiting_time")
        ]
        within = "".join(map(_within, both))
        yield "    %-32s %14s %14s%s" % (place, _number(mean), _number(wait), within)
    yield "    %-32s %14s" % ("transition", "throughput 1/s")
    for transition, value in steady["throughput"].items():
        within = _within(spans.get("steady_state.throughput", {}).get(transition))
        yield "    %-32s %14s%s" % (transition, _number(value), within)
    for measure, errors in steady.get("unsure", {}).items():
        for name, error in errors.items():
            yield "    unsure: %s of %s, by about %.0e of the value" % (
                measure.replace("_", " "),
                name,
                error if isinstance(error, float) else math.inf,
            )
    if "reward" in steady:
        yield "    reward per second: %s%s" % (
            _number(steady["reward"]),
            _within(spans.get("steady_state", {}).get("reward")),
        )


def _answer(value: Any) -> str:
    return "not decided" if value is None else ("yes" if value else "no")


def _number(value: Any) -> str:
    if value is None:
        return "-"
    return value if isinstance(value, str) else "%.8g" % value


def _within(span: Optional[Sequence[float]]) -> str:
    """The ends of an interval, after a number; empty if it has none."""
    return " (%.6g to %.6g)" % tuple(span) if span else ""


def _map(values: Mapping[str, Any], spans: Optional[Mapping[str, Any]] = None) -> str:
    shown = [
        "%s %s%s" % (name, _number(v), _within((spans or {}).get(name)))
        for name, v in list(values.items())[:_SHOWN]
    ]
    return ", ".join(shown) + (", ... (%d in all)" % len(values) if len(values) > _SHOWN else "")


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:_SHOWN]) + (
        ", ... (%d in all)" % len(names) if len(names) > _SHOWN else ""
    )


def _more(found: Any) -> Iterator[str]:
    if found and len(found) > _SHOWN:
        yield "    ... (%d in all)" % len(found)
