"""The numbers of a report one by one: of measures with titles, and as rows of a table."""

from __future__ import annotations

from typing import Any, Iterator, Mapping, Optional, Tuple

from gspn_framework_package.analysis.report_measures import Part


def titled(data: Mapping[str, Any], part: Optional[Part] = None) -> Iterator[Tuple[str, str]]:
    """The measures of a report that have a title, as (key, title); of one part, or of all."""
    for of_part, titles in data["titles"].items():
        if part is None or of_part == part.value:
            yield from titles.items()


def rows(data: Mapping[str, Any]) -> Iterator[Tuple[str, str, Any]]:
    """The numbers of a report as rows (measure, name, value), for CSV."""
    for key in (
        "places",
        "transitions",
        "arcs",
        "bounded",
        "k_safe",
        "live",
        "reversible",
        "conservative",
    ):
        yield key, "", data.get(key)
    for key, _ in titled(data):
        value = data[key]
        for name, one in value.items() if isinstance(value, dict) else [("", value)]:
            yield key, name, one
    for key in ("states", "bounds", "liveness"):
        for name, value in (data.get(key) or {}).items():
            yield key, name, value
    parts = [("steady_state", data.get("steady_state") or {})]
    parts += [("transient at %g" % entry["time"], entry) for entry in data.get("transient") or ()]
    for title, part in parts:
        for measure in ("mean_tokens", "throughput", "mean_waiting_time"):
            for name, value in (part.get(measure) or {}).items():
                yield "%s %s" % (title, measure), name, value
        for place, counts in (part.get("token_distribution") or {}).items():
            for count, value in counts.items():
                yield "%s probability of %s tokens" % (title, count), place, value
    for entry in data.get("mean_time_to") or ():
        if entry:
            yield "mean_time_to", entry["condition"], entry["mean_time"]
            for within in entry["within"]:
                yield (
                    "probability within %g s" % within["time"],
                    entry["condition"],
                    within["probability"],
                )
