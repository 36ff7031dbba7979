"""What simulated teams of real replicas do, played on the specification (``spec/trace.tla``). Needs TLC
(``scripts/check_spec --install``)."""

from __future__ import annotations

from typing import List, Tuple
from unittest import mock

import pytest

from agreement import specification, traces
from agreement.mutants import MUTANTS
from agreement.plans import make_plan
from agreement.world import Weather, World
from gspn_framework_package.execution.agreement.consensus import Consensus
from gspn_framework_package.execution.agreement.electorate import Electorate
from gspn_framework_package.execution.event_log import EventLog
from gspn_framework_package.model.errors import LogError

REFUSED = (
    "promises",
    "accepted values",
    "any vote",
    "keeps leading",
    "blind learning",
    "no memory",
)
"""Seeded faults with which a team of three does what the specification does not allow."""

REFUSED_PARTIAL = ("quorum only", "no freeze", "accepted values")
"""The same in partial synchronisation."""

EVICTED = (39, 55, 60, 79)
"""Seeds with which a robot is evicted, and hears of it before it wants something."""

pytestmark = pytest.mark.skipif(bool(specification.why_not()), reason=specification.why_not())


@pytest.mark.timeout(600)  # a machine may be busy with other tests
@pytest.mark.parametrize("robots, partial", [(2, False), (3, False), (3, True)])
def test_the_specification_allows_what_replicas_do(robots: int, partial: bool) -> None:
    runs = [traces.traced(seed, robots, 24, partial) for seed in range(40)]
    for kind in ("propose", "resume", *(["move", "answer"] if partial else [])):
        assert sum(any('"%s"' % kind in step for step in steps) for steps in runs) > 5
    assert any('"forget"' in step for steps in runs for step in steps)
    for entry in ("Join", *(["Move", "GiveBack"] if partial else [])):
        assert sum('"%s"' % entry in step for steps in runs for step in steps) > 10
    assert traces.check(runs, robots, partial) == []


@pytest.mark.timeout(600)
@pytest.mark.parametrize("partial, faults", [(False, REFUSED), (True, REFUSED_PARTIAL)])
def test_a_team_with_a_seeded_fault_is_refused(partial: bool, faults: Tuple[str, ...]) -> None:
    runs, owners, each = [], [], 12 if partial else 4
    for mutant in MUTANTS:
        if mutant.name in faults:
            with mutant.apply():
                runs += [traces.traced(seed, 3, 40, partial) for seed in range(each)]
            owners += [mutant.name] * each
    with mock.patch.object(Consensus, "restore", lambda *_: None):  # no votes after a restart
        runs += [traces.traced(seed, 3, 40, partial) for seed in range(24)]
    owners += ["forgets"] * 24
    with mock.patch.object(Electorate, "may_vote", lambda self: self.state.active):
        runs += [traces.traced(seed, 3, 60, partial) for seed in EVICTED]
    owners += ["evicted"] * len(EVICTED)
    refused = traces.check(runs, 3, partial)
    assert {owners[one.trace - 1] for one in refused} == {*faults, "forgets", "evicted"}
    again = [one for one in refused if '"resume"' in one.text]
    assert {one.differs[0] for one in again if one.differs} == {"promised"}
    assert any(one.differs and one.differs[0] in ("accepted", "promised") for one in refused)


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
