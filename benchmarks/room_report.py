"""The outcome of a run in the critical room: its figures, its faults, and the table of all runs."""

from __future__ import annotations

from typing import Any, Dict, Sequence

from benchmarks.machine import table

FAULTS = (
    "contacts_between_robots",
    "contacts_with_solids",
    "stuck_minutes",
    "goals_aborted",
    "two_in_one_location",
    "overtakings",
    "failed_actions",
    "policy_misses",
    "rule_broken_in_marking",
    "log_violations",
)
"""The figures that are 0 in a good run."""


def figures(report: Dict[str, Any]) -> Dict[str, Any]:
    """The referee's report with the laps of each robot, without the machine-readable fields."""
    chosen = {k: v for k, v in report.items() if k not in ("robots", "entry_log", "laps")}
    chosen["laps"] = [tally["laps"] for tally in report["robots"].values()]
    # counts partial laps too: the total progress of the robots
    chosen["locations_per_robot"] = report["entries"] / max(len(report["robots"]), 1)
    return chosen


def show(results: Sequence[Dict[str, Any]]) -> str:
    """The results as a table."""
    head = (
        "robots",
        "seed",
        "laps of each",
        "locations",
        "metres",
        "touches",
        "with walls",
        "min stuck",
        "aborted",
        "two in one",
        "overtaken",
        "misses",
        "real-time factor",
        "CPU s/min",
        "MB",
    )
    rows = [
        [
            str(r["robots"]),
            str(r["seed"]),
            " ".join(map(str, r["laps"])),
            r["entries"],
            r["distance"],
            r["contacts_between_robots"],
            r["contacts_with_solids"],
            r["stuck_minutes"],
            r["goals_aborted"] + r["failed_actions"],
            r["two_in_one_location"],
            r["overtakings"],
            r.get("policy_misses"),
            r["real_time_factor"],
            r["cpu_seconds_per_minute"],
            r["memory_mb"],
        ]
        for r in results
    ]
    return table(head, rows)
