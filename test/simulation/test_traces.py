"""What simulated teams of real replicas do, played on the specification (``spec/trace.tla``). Needs TLC
(``scripts/check_spec --install``)."""

from __future__ import annotations

import pytest

from agreement import specification, traces
from agreement.mutants import MUTANTS

REFUSED = ("promises", "accepted values", "any vote", "keeps leading", "blind learning")
"""Seeded faults with which a team of three does what the specification does not allow."""

pytestmark = pytest.mark.skipif(bool(specification.why_not()), reason=specification.why_not())


@pytest.mark.timeout(600)  # a machine may be busy with other tests
@pytest.mark.parametrize("robots", [2, 3])
def test_the_specification_allows_what_replicas_do(robots: int) -> None:
    runs = [traces.traced(seed, robots, 24) for seed in range(100)]
    assert sum(any('"propose"' in step for step in steps) for steps in runs) > 20
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
