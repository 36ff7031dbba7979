"""The event log of a run that continues under two further plans, made without threads."""

from __future__ import annotations

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.event_log import header
from gspn_framework_package.execution.firing import StartAction
from gspn_framework_package.execution.ledger import Ledger
from gspn_framework_package.execution.log_writer import record_line
from gspn_framework_package.execution.plan_change import stage_of
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.formats.plan_json import plan_from_json

NAMES = {"C": "X", "leave_C": "leave_X"}
"""What C is called from the second plan on."""


def round_of(places, robots=1):
    """The net of a round, as JSON: the transition from place P is called leave_P; the robots begin
    in the first place."""
    arcs = []
    for place, following in zip(places, places[1:] + places[:1]):
        arcs += [
            {"from": place, "to": "leave_" + place},
            {"from": "leave_" + place, "to": following},
        ]
    return {
        "places": [{"name": p, "tokens": robots * (p == places[0])} for p in places],
        "transitions": [{"name": "leave_" + p, "timed": True} for p in places],
        "arcs": arcs,
    }


def patrol(places, name):
    """A plan for two robots that go round."""
    actions = dict.fromkeys(places, "actions.work")
    return plan_from_json({"plan": name, "net": round_of(places, 2), "actions": actions})


def write_deployed_log(path, between=40):
    """Write a log whose run follows three plans, for ``between`` entries each: A B C D; then
    E X D B A, in which C is called X; then the same net again under another name.

    :returns: the plans.
    """
    plans = [patrol("ABCD", "four"), patrol("EXDBA", "five"), patrol("EXDBA", "again")]
    first = TokenGame(plans[0], agents=True)
    ledger, doing, chain = Ledger(first), [], ""
    with open(path, "w", encoding="utf-8") as file:

        def write(number, record):
            nonlocal chain
            line, chain = record_line({**record, "wall": 1e9 + number, "mono": number}, chain)
            file.write(line)

        def reduce(batch):
            slot, game = ledger.length, first.now(ledger.state)
            step = game.reduce(ledger.state, slot, batch)
            write(slot, ledger.record(slot, batch, [], step))
            for command in step.commands:
                if isinstance(command, StartAction):
                    doing.append(command)

        write(0, header(plans[0], "r", "", "log", agents=True))
        reduce([first.start_entry()])
        for number, plan in enumerate(plans):
            if number:
                mapping = NAMES if number == 1 else {}
                reduce([stage_of(plan, mapping), log_entries.Staged("", 0, number)])
                reduce([log_entries.Adopt(number)])
            for _ in range(between):
                done = doing.pop(0)
                result = "leave_" + done.place
                reduce([log_entries.Done(done.robot, done.incarnation, done.visit, result)])
    return plans
