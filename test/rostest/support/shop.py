"""A small plan whose best policy is known."""

import json

from gspn_framework_package.formats.net_json import net_to_json
from gspn_framework_package.model.builder import NetBuilder


def shop_net():
    """A robot chooses between a fast and a slow job."""
    return (
        NetBuilder("shop")
        .place("Choose", 1)
        .place("Fast")
        .place("Slow")
        .immediate("take_fast", weight=0, inputs="Choose", outputs="Fast")
        .immediate("take_slow", weight=0, inputs="Choose", outputs="Slow")
        .exponential("fast_done", 2.0, inputs="Fast", outputs="Choose")
        .exponential("slow_done", 1.0, inputs="Slow", outputs="Choose")
        .build()
    )


def write_shop(folder):
    """Write its plan file, whose policy tosses a coin: 4/3 jobs per second instead of 2."""
    plan = {
        "plan": "shop",
        "net": net_to_json(shop_net()),
        "policy": {
            "places": ["Choose"],
            "rows": [{"marking": ["-"], "choose": {"take_fast": 0.5, "take_slow": 0.5}}],
        },
        "actions": {"Choose": None, "Fast": "jobs.work", "Slow": "jobs.work"},
        "robots": {"robot_1": "Choose"},
    }
    path = folder / "plan.json"
    path.write_text(json.dumps(plan))
    return path
