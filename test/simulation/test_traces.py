"""What simulated teams of real replicas do, played on the specification (``spec/trace.tla``). Needs TLC
(``scripts/check_spec --install``)."""

from __future__ import annotations

from typing import List
from unittest import mock

import pytest

from agreement import specification, traces
from agreement.mutants import MUTANTS
from agreement.plans import make_plan
from agreement.world import Weather, World
from gspn_framework_package.execution.agreement.consensus import Consensus
from gspn_framework_package.execution.event_log import EventLog
from gspn_framework_package.model.errors import LogError

REFUSED = ("promises", "accepted values", "any vote", "keeps leading", "blind learning")
"""Seeded faults with which a team of three does what the specification does not allow."""

pytestmark = pytest.mark.skipif(bool(specification.why_not()), reason=specification.why_not())


@pytest.mark.timeout(600)  # a machine may be busy with other tests
@pytest.mark.parametrize("robots", [2, 3])
def test_the_specification_allows_what_replicas_do(robots: int) -> None:
    runs = [traces.traced(seed, robots, 24) for seed in range(100)]
    for kind in ("propose", "resume"):
        assert sum(any('"%s"' % kind in step for step in steps) for steps in runs) > 20
    assert sum("Join" in step for steps in runs for step in steps) > 20
    assert traces.check(runs, robots) == []


@pytest.mark.timeout(600)
def test_a_team_with_a_seeded_fault_is_refused() -> None:
    runs, owners = [], []
    for mutant in MUTANTS:
        if mutant.name in REFUSED:
            with mutant.apply():
                runs += [traces.traced(seed, 3, 40) for seed in range(4)]
            owners += [mutant.name] * 4
    refused = traces.check(runs, 3)
    assert {owners[one.trace - 1] for one in refused} == set(REFUSED)
    assert any(one.differs and one.differs[0] in ("accepted", "promised") for one in refused)


@pytest.mark.timeout(600)
def test_robots_that_forget_their_votes_when_they_start_again_are_refused() -> None:
    with mock.patch.object(Consensus, "restore", lambda *_: None):
        runs = [traces.traced(seed, 3, 40) for seed in range(10)]
    refused = [one for one in traces.check(runs, 3) if '"resume"' in one.text]
    assert {one.differs[0] for one in refused if one.differs} == {"promised"}


def _logs(seed: int) -> List[EventLog]:
    """The logs of a simulated team of two, the second of which is killed and starts again."""
    plan = make_plan(0, 2, False, 0.0, 0.0, False)
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
def test_logs_are_read_as_traces_and_a_log_of_another_decision_is_refused() -> None:
    whole = [traces.traced_logs(_logs(seed))[0] for seed in range(3)]
    assert all(sum('"decide"' in step for step in steps) >= 10 for steps in whole)
    assert all(any('"resume"' in step for step in steps) for steps in whole)
    logs = _logs(3)
    last = [record for record in logs[1].records if record["kind"] == "slot"][6]
    last["origins"][0][2] += 100
    forged, robots = traces.traced_logs(logs)
    refused = traces.check([*whole, forged], robots)
    assert [(one.trace, one.differs[0]) for one in refused] == [(4, "decided")]


def test_logs_of_partial_synchronisation_are_left_out_with_the_reason() -> None:
    plan = make_plan(0, 2, True, 0.0, 0.0, False)
    with pytest.raises(LogError, match="only full synchronisation"):
        traces.traced_logs([EventLog("", {"robot": "r"}, [], plan=plan)])
