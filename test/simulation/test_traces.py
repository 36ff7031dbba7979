"""What simulated teams of real replicas do, played on the specification (``spec/trace.tla``). Needs TLC
(``scripts/check_spec --install``)."""

from __future__ import annotations

from typing import ContextManager, Dict, List, Sequence
from unittest import mock

import pytest

from agreement import specification, trace_notes, traces
from agreement.mutants import MUTANTS
from agreement.plans import make_plan
from agreement.world import Weather, World
from gspn_framework_package.execution.agreement.consensus import Consensus
from gspn_framework_package.execution.agreement.electorate import Electorate
from gspn_framework_package.execution.event_log import EventLog
from gspn_framework_package.model.errors import LogError

FULL = {
    "promises": (0, 1),
    "accepted values": (0, 1),
    "any vote": (0, 1),
    "keeps leading": (0, 1),
    "blind learning": (0, 1),
    "no memory": (0, 2),
    "task twice": (6, 22),
    "keeps cancelled": (6, 22),
    "forgets": (13, 21),
    "evicted": (185,),
}
"""Seeded faults with which a team of three does what the specification does not allow, and seeds that
show it."""

TASKS = {"task twice", "keeps cancelled"}
"""Those with which a slot does to a task what its entries do not say."""

PARTIAL = {
    "quorum only": (0, 1),
    "no freeze": (6, 9),
    "accepted values": (9, 11),
    "forgets": (16, 22),
    "evicted": (63, 79),
}
"""The same in partial synchronisation."""


def _seeded(name: str) -> ContextManager[object]:
    if name == "forgets":  # no votes after a restart
        return mock.patch.object(Consensus, "restore", lambda *_: None)
    if name == "evicted":
        return mock.patch.object(Electorate, "may_vote", lambda self: self.state.active)
    (mutant,) = [m for m in MUTANTS if m.name == name]
    return mutant.apply()


pytestmark = pytest.mark.skipif(bool(specification.why_not()), reason=specification.why_not())


@pytest.mark.timeout(600)  # a machine may be busy with other tests
@pytest.mark.parametrize(
    "robots, partial, faults", [(2, False, {}), (3, False, FULL), (3, True, PARTIAL)]
)
def test_the_specification_allows_what_replicas_do_and_no_seeded_fault(
    robots: int, partial: bool, faults: Dict[str, Sequence[int]]
) -> None:
    # a log is lost with 1 and 33
    runs = [traces.traced(seed, robots, 24, partial) for seed in (*range(23), 33)]
    for kind in ("propose", "resume", *(["move", "answer"] if partial else [])):
        assert sum(any('"%s"' % kind in step for step in steps) for steps in runs) > 5
    assert any('"forget"' in step for steps in runs for step in steps)
    for entry in ("Join", *(["Move", "GiveBack"] if partial else ["waits", "cancelled"])):
        assert sum('"%s"' % entry in step for steps in runs for step in steps) > 9
    owners = [""] * len(runs)
    for name, seeds in faults.items():
        with _seeded(name):
            runs += [traces.traced(seed, robots, 60, partial) for seed in seeds]
        owners += [name] * len(seeds)
    refused = traces.check(runs, robots, partial)
    assert {owners[one.trace - 1] for one in refused} == set(faults)
    again = [one for one in refused if '"resume"' in one.text]
    assert {one.differs[0] for one in again if one.differs} == ({"promised"} if faults else set())
    of_tasks = [one for one in refused if "lawful" in one.differs]
    assert {owners[one.trace - 1] for one in of_tasks} == set(faults) & TASKS


DEPARTURES = {"rest decides": (940005,), "decides and stays": (940025,)}
OUTAGES = {"quorum of torn": (940017,), "torn without all": (940017,)}
"""Seeded faults of evictions by force, and of losses of power."""


@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    "seeds, partial, faults",
    [(range(4, 16), False, DEPARTURES), (range(4), False, OUTAGES), (range(16, 20), True, {})],
    ids=["evicted by force", "power", "power partial"],
)
def test_robots_that_leave_are_said_to_be_off_or_lose_power_do_what_is_allowed(
    seeds: Sequence[int], partial: bool, faults: Dict[str, Sequence[int]]
) -> None:
    runs = [traces.traced(seed, 3, 40, partial, True) for seed in seeds]
    outages = traces.loses_power(seeds[0])
    for kind in ("outage", "torn", "sync") if outages else ("Leave", "assert"):
        assert any('"%s"' % kind in step for steps in runs for step in steps), kind
    owners = [""] * len(runs)
    for name, broken in faults.items():
        with _seeded(name):
            runs += [traces.traced(seed, 3, 60, partial, True) for seed in broken]
        owners += [name] * len(broken)
    refused = traces.check(runs, 3, partial, outages=outages)
    assert {owners[one.trace - 1] for one in refused} == set(faults)


def _logs(seed: int, partial: bool = False) -> List[EventLog]:
    """The logs of a simulated team of two, the second of which is killed and starts again."""
    plan = make_plan(0, 2, partial, 0.0, 0.0, False)
    world = World(plan, seed, Weather(loss=0.1, late=0.2))
    for node in world.nodes.values():
        node.start()
    assert world.run(6.0, lambda: world.length() > 4)
    second = list(world.nodes.values())[1]
    second.crash()
    second.start()
    assert world.run(6.0, lambda: world.length() > 8)
    disks = [node.disk for node in world.nodes.values() if node.disk is not None]
    return [EventLog("", disk.header, disk.records(), plan=plan) for disk in disks]


@pytest.mark.timeout(600)
@pytest.mark.parametrize("partial", [False, True])
def test_logs_are_read_as_traces_and_a_log_of_another_decision_is_refused(partial: bool) -> None:
    whole = [traces.traced_logs(_logs(seed, partial))[0] for seed in range(3)]
    assert all(sum('"decide"' in step for step in steps) >= 10 for steps in whole)
    assert all(any('"resume"' in step for step in steps) for steps in whole)
    assert any('"move"' in step for steps in whole for step in steps) == partial
    logs = _logs(3, partial)
    last = [record for record in logs[1].records if record["kind"] == "slot"][6]
    last["origins"][0][2] += 100
    forged, robots, kind = traces.traced_logs(logs)
    refused = traces.check([*whole, forged], robots, kind, holds=False)
    assert [(one.trace, one.differs[0]) for one in refused] == [(4, "decided")]


def test_logs_of_a_team_with_a_witness_are_left_out_with_the_reason() -> None:
    plan = make_plan(0, 2, True, 0.0, 0.0, True)
    with pytest.raises(LogError, match="only a team without a witness"):
        traces.traced_logs([EventLog("", {"robot": "r"}, [], plan=plan)])


@pytest.mark.parametrize("ids", [("aa19c159", "aa19c1590d4e"), ("aa19c1590d4e", "aa19c159")])
def test_an_entry_has_only_the_beginning_of_the_id_of_a_log(ids):
    notes = trace_notes.Notes(["r1"], ())
    assert [notes.log("r1", id_) for id_ in ids] == [1, 1] and not notes.ended
    assert notes.log("r1", "bb") == 2
