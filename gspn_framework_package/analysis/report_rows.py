"""The numbers of a report one by one: of measures with titles, and as rows of a table."""

from __future__ import annotations

from typing import Any, Iterator, Mapping, Optional, Tuple

from gspn_framework_package.analysis.report_measures import Part

NODE_TABLES = ("mean_tokens", "throughput", "mean_waiting_time")
"""The answers about a distribution that are tables of numbers: name of a node -> number."""


def titled(data: Mapping[str, Any], part: Optional[Part] = None) -> Iterator[Tuple[str, str]]:
    """The measures of a report that have a title, as (key, title); of one part, or of all."""
    for of_part, titles in data["titles"].items():
        if part is None or of_part == part.value:
            yield from titles.items()


def rows(data: Mapping[str, Any]) -> Iterator[Tuple[str, str, Any, Any, Any]]:
    """The numbers of a report as rows (measure, name, value, low, high), for CSV; the interval is
    None, None where there is none."""
    spans = data.get("intervals", {})

    def row(measure: str, name: str, value: Any, key: str = "", of: str = "") -> Tuple[Any, ...]:
        span = spans.get(key)
        if isinstance(span, dict):
            span = span.get(of or name)
        return (measure, name, value, *(span or (None, None)))

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
        yield row(key, "", data.get(key))
    for key, _ in titled(data):
        value = data[key]
        for name, one in value.items() if isinstance(value, dict) else [("", value)]:
            yield row(key, name, one, key)
    for key in ("states", "bounds", "liveness"):
        for name, value in (data.get(key) or {}).items():
            yield row(key, name, value)
    parts = [("steady_state", "steady_state", data.get("steady_state") or {})]
    for i, entry in enumerate(data.get("transient") or ()):
        parts.append(("transient at %g" % entry["time"], "transient.%d" % i, entry))
    for title, key, part in parts:
        for measure in NODE_TABLES:
            for name, value in (part.get(measure) or {}).items():
                yield row("%s %s" % (title, measure), name, value, "%s.%s" % (key, measure))
        for place, counts in (part.get("token_distribution") or {}).items():
            for count, value in counts.items():
                of = "%s.token_distribution.%s" % (key, place)
                yield row("%s probability of %s tokens" % (title, count), place, value, of, count)
    for i, entry in enumerate(data.get("mean_time_to") or ()):
        if entry:
            key, condition = "mean_time_to.%d" % i, entry["condition"]
            yield row("mean_time_to", condition, entry["mean_time"], key, "mean_time")
            for n, within in enumerate(entry["within"]):
                title, chance = "probability within %g s" % within["time"], within["probability"]
                yield row(title, condition, chance, key, "within.%d" % n)
