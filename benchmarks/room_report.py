"""The outcome of a run in the critical room: its figures, its faults, and the table of all runs."""

from __future__ import annotations

from typing import Any, Dict, Mapping, Sequence

from benchmarks.machine import table
from gspn_framework_package.execution.verifier import Verdict

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
    chosen["visits_per_hour"] = 3600 * report["entries"] / report["simulated_seconds"]
    return chosen


def verdict_text(verdict: Verdict) -> str:
    """What the verifier found in the logs of a run, in words."""
    return "valid" if verdict.violation is None else "rule %d: %s" % verdict.violation


THESIS: Mapping[int, str] = {
    1: "smooth",
    2: "after costmaps were cleared by hand",
    3: "the same, not very smooth; sometimes the policy is not applied, and a robot waits for ever",
    4: "starts after 2:42 min; robots get stuck, one overtakes another; ends with all stuck",
}
"""Number of robots -> what the thesis saw in Gazebo (6.2.3 and 6.3.2). It gives no figures, and
tried no larger team."""


def show_beside_thesis(results: Sequence[Dict[str, Any]]) -> str:
    """The results as a table beside what the thesis says in 6.3.2."""
    head = ("robots", "thesis", "visits/h", "faults", "CPU [% of a core]", "MB")
    rows = [
        [
            str(r["robots"]),
            THESIS.get(r["robots"], "not tried"),
            "%.0f" % r["visits_per_hour"],
            ", ".join("%s %g" % (name, r[name]) for name in FAULTS if r.get(name)) or "none",
            "%.0f" % (100 * r["cpu_seconds_per_minute"] / 60),
            "%.0f" % r["memory_mb"],
        ]
        for r in results
    ]
    return table(head, rows)


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
