"""Measures: one for each part of the report, of the kinds of values that are shown."""

from __future__ import annotations

from gspn_framework_package.analysis.report_measures import Measure, Part

MEASURES = [
    Measure(
        "sources",
        Part.STRUCTURE,
        lambda a: [t.name for t, inputs in zip(a.net.transitions, a.net.inputs) if not inputs],
        "transitions without inputs",
    ),
    Measure("fullest", Part.BEHAVIOUR, lambda a: max(a.properties.bounds.values()), "most tokens"),
    Measure(
        "busy", Part.TIMING, lambda a: 1 - a.measures.mean_tokens["up"], "share of time in repair"
    ),
]
