"""A small plan whose best policy is known, and a worker of the page that tells it."""

import json
import sys
import types

from gspn_framework_package.formats.net_json import net_to_json
from gspn_framework_package.model.builder import NetBuilder

WORKER = [sys.executable, __file__]


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


def optimise(plan, request, *, simulated, progress=None, cancel=None):
    """Tell what is the best for the long run."""
    from gspn_framework_package.analysis.decisions.report import (
        ConstraintResult,
        MarkingChoice,
        Report,
        Sensitivity,
        TeamResult,
    )
    from gspn_framework_package.model.policy import Policy

    policy = Policy.from_table(["Choose"], [(["-"], {"take_fast": 1.0})])
    half = {"take_fast": 0.5, "take_slow": 0.5}
    return Report(
        request,
        plan.with_policy(policy),
        [TeamResult(1, 3, 2.0, 1.9999999, 2.0000001)],
        rows=1,
        present=4 / 3,
        constraints=[ConstraintResult(c.name, 2.0, c.bound, 0.0) for c in request.at_least],
        sensitivities=[
            Sensitivity("fast_done", 2.0, 1.0, 1.0),
            Sensitivity("slow_done", 1.0, 0.0, 0.0),
        ],
        assumptions=["the policy decides in Choose: its action is null"],
        choices=[MarkingChoice({"Choose": 1}, "Choose", half, {"take_fast": 1.0}, 0.5)],
        choices_in_all=1,
    )


if __name__ == "__main__":
    NAME = "gspn_framework_package.analysis.decisions.optimise"
    sys.modules[NAME] = types.ModuleType(NAME)
    sys.modules[NAME].optimise = optimise
    from gspn_framework_package.visualizer import analysis_worker

    sys.exit(analysis_worker.main())
