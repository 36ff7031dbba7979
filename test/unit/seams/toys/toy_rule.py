"""A failure rule: try again, with a delay that doubles, then go on with a transition."""

from __future__ import annotations

from typing import Any, Dict, Mapping

from gspn_framework_package.model.failure import FailureEnd, FailureKind, FailureRule


def read(data: Mapping[str, Any]) -> FailureRule:
    delays = tuple(data["delay"] * 2.0**k for k in range(data["patience"]))
    return FailureRule("patience", data["patience"], delays, FailureEnd.FIRE, data["then"][5:])


def write(rule: FailureRule) -> Dict[str, Any]:
    return {"patience": rule.times, "delay": rule.delay(1), "then": "fire " + rule.transition}


PATIENCE = FailureKind(
    read,
    write,
    {
        "title": "be patient, then fire",
        "type": "object",
        "required": ["patience", "delay", "then"],
        "additionalProperties": False,
        "properties": {
            "patience": {"type": "integer", "minimum": 1, "maximum": 20, "default": 3},
            "delay": {"description": "Seconds.", "type": "number", "exclusiveMinimum": 0},
            "then": {"type": "string", "pattern": "^fire .+$"},
        },
    },
)
