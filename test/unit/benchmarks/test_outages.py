"""What the campaign of outages expects of the logs of a team whose machines lost power."""

from __future__ import annotations

from typing import Any, List

import pytest

from agreement.plans import make_plan
from agreement.world import World
from benchmarks.faults import outages
from gspn_framework_package.execution.agreement.replica import ProtocolLimits
from gspn_framework_package.execution.event_log import EventLog
from gspn_framework_package.execution.log_damage import BOOT_ID
from gspn_framework_package.model.errors import ExecutionError
from gspn_framework_package.model.plan import Synchronisation


def slots(log: EventLog) -> List[outages.Position]:
    return [(r["slot"], r["hash"]) for r in log.records if r["kind"] == "slot"]


@pytest.fixture(scope="module")
def after_outage() -> Any:
    """The logs of a team, and the last slot that ``r1`` had synced before all lost power. ``r1``
    had just written a snapshot, so the others got one from it for the slots that they lost."""
    world = World(make_plan(0, 3, False, 0.0, 0.0, False), 1)
    world.limits = ProtocolLimits(snapshot_every=2)
    world.fsync = world.mishaps = False
    for node in world.nodes.values():
        node.start()
    world.run(1.0)
    for node in world.nodes.values():
        node.sync()
    world.run(world.now + 0.5)
    world.nodes["r1"].sync()
    last = next(r for r in reversed(world.nodes["r1"].disk.records()) if r["kind"] == "slot")
    for node in world.nodes.values():
        node.crash()
        del node.disk.lines[node.disk.synced :]
        node.trusted = False
    world.forget_what_is_lost()
    for node in world.nodes.values():
        node.start()
    world.run(world.now + 3)
    logs = [EventLog("", n.disk.header, n.disk.records()) for n in world.nodes.values()]
    return logs, (last["slot"], last["hash"])


def test_a_robot_that_took_a_snapshot_of_a_synced_slot_has_kept_it(after_outage: Any) -> None:
    logs, last = after_outage
    assert last in slots(logs[0])
    assert any(last not in slots(log) for log in logs[1:])
    outages.check_kept(logs, {"r1": last})


def test_a_synced_slot_that_is_lost_is_found(after_outage: Any) -> None:
    logs, (slot, last) = after_outage
    with pytest.raises(ExecutionError, match="the logs lack slot %d, which r1 had" % slot):
        outages.check_kept(logs, {"r1": (slot, "0" * len(last))})
    with pytest.raises(ExecutionError, match="the logs lack slot 9999"):
        outages.check_kept(logs, {"r1": (9999, last)})
    before = [r for r in logs[1].records if r.get("slot", 0) < slot]
    cut = EventLog("", logs[1].header, before)
    with pytest.raises(ExecutionError, match="%s lacks slot %d" % (cut.robot, slot)):
        outages.check_kept([logs[0], cut, logs[2]], {"r1": (slot, last)})


def test_the_team_is_at_rest_when_it_is_verified(monkeypatch: Any) -> None:
    done: List[str] = []

    class Team:
        robots = ("r1", "r2")

        def __init__(self, *_: Any) -> None:
            pass

        def wait_for_moves(self, *_: Any) -> None:
            done.append("moves")

        def rest(self) -> None:
            done.append("rest")

    monkeypatch.setattr(outages, "FaultyTeam", Team)
    monkeypatch.setenv(BOOT_ID, "")
    outages.Outages(2, Synchronisation.FULL, 0, 1, print).run()
    assert done == ["moves", "rest"]
