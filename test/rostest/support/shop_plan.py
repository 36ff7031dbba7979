"""A plan with an event, tasks and data, and the slots of a run of it."""

from __future__ import annotations

from typing import List

from gspn_framework_package.execution import log_entries
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.event import EventSource, Tasks
from gspn_framework_package.model.plan import Plan, RobotSpec


def shop() -> Plan:
    """Orders come in, robots deliver them; a low battery interrupts, if the dock is free."""
    net = (
        NetBuilder("shop")
        .place("Idle", tokens=2)
        .place("Deliver")
        .place("Charge")
        .place("Orders", capacity=3)
        .place("Dock", tokens=1)
        .exponential("order", rate=1, outputs="Orders")
        .immediate("take", inputs=["Idle", "Orders"], outputs="Deliver")
        .exponential("delivered", rate=1, inputs="Deliver", outputs="Idle")
        .exponential("low", rate=0.1, inputs=["Deliver", "Dock"], outputs="Charge")
        .exponential("full", rate=1, inputs="Charge", outputs=["Deliver", "Dock"])
        .build()
    )
    return Plan(
        net=net,
        name="shop",
        actions={
            "Idle": None,
            "Deliver": FunctionAction("actions.deliver", "Deliver"),
            "Charge": FunctionAction("actions.charge", "Charge"),
        },
        resource_places=frozenset({"Orders", "Dock"}),
        robots=(RobotSpec("a", "Idle"), RobotSpec("b", "Idle")),
        events={"low": EventSource("battery", "a/B", "percentage < 0.2", hold=True, resume=True)},
        tasks=Tasks(("Orders",), ("delivered",)),
    ).validate()


SLOTS: List[List[log_entries.Entry]] = [
    [log_entries.Submit("order", "o%d" % i, {"pose": [i, 0]}) for i in range(1, 8)],
    [log_entries.Interrupt("a", 0, 2, "low", {"percentage": 0.1})],
    [log_entries.Interrupt("b", 0, 2, "low", {"percentage": 0.15})],
    [log_entries.Done("a", 0, 3, "full", {"charged": 12, "team.door": "open"})],
    [log_entries.Done("b", 0, 3, "full", {"note": "x" * 1000})],
    [log_entries.Done("a", 0, 4, "delivered")],
]
