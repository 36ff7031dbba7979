"""The same team, driven by Hypothesis, which makes a failing story short."""

from __future__ import annotations

from typing import Any, Set

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule

from agreement.plans import make_plan
from agreement.world import Weather, World
from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.agreement.quorum import is_quorum
from gspn_framework_package.execution.event_log import EventLog
from gspn_framework_package.execution.verifier import verify


class Team(RuleBasedStateMachine):
    """Three robots; time passes only when a rule lets it."""

    @initialize(kind=st.integers(0, 5), partial=st.booleans(), seed=st.integers(0, 1000))
    def begin(self, kind: int, partial: bool, seed: int) -> None:
        self.world = World(make_plan(kind, 3, partial, 0.0, 0.0, False), seed)
        for node in self.world.nodes.values():
            node.start()
        if self.world.plan.submissions:
            self.world.publish_tasks(0.1)

    def node(self, i: int) -> Any:
        return list(self.world.nodes.values())[i]

    @rule(seconds=st.sampled_from([0.005, 0.03, 0.1, 0.4]))
    def wait(self, seconds: float) -> None:
        self.world.run(self.world.now + seconds)

    @rule(i=st.integers(0, 2), effects=st.integers(1, 20))
    def doom(self, i: int, effects: int) -> None:
        if self.node(i).replica is not None:
            self.node(i).doomed = effects

    @rule(i=st.integers(0, 2))
    def restart(self, i: int) -> None:
        if self.node(i).replica is None:
            self.node(i).start()

    @precondition(lambda self: hasattr(self, "world"))
    @rule(i=st.integers(0, 2))
    def lose_log(self, i: int) -> None:
        others = [n for n in self.world.nodes.values() if n is not self.node(i)]
        if all(n.replica is not None and n.replica.active for n in others):
            if self.node(i).replica is not None:
                self.node(i).crash()
            self.node(i).lose_log()

    @rule(i=st.integers(0, 2), one_way=st.booleans())
    def cut(self, i: int, one_way: bool) -> None:
        name = self.node(i).name
        for other in self.world.nodes:
            self.world.blocked.add((name, other))
            if not one_way:
                self.world.blocked.add((other, name))

    @rule()
    def mend(self) -> None:
        self.world.blocked.clear()

    @rule(loss=st.sampled_from([0.0, 0.3]), duplication=st.sampled_from([0.0, 0.3]))
    def weather(self, loss: float, duplication: float) -> None:
        self.world.weather = Weather(loss=loss, duplication=duplication, late=0.2)

    @rule(
        i=st.integers(0, 2), j=st.integers(0, 2), what=st.sampled_from(["pause", "place", "evict"])
    )
    def order(self, i: int, j: int, what: str) -> None:
        victim = self.node(j).name
        entry: log_entries.Entry = log_entries.Pause(victim)
        if what == "place":
            entry = log_entries.SetPlace(victim, self.world.plan.action_places[0])
        elif what == "evict" and i != j:
            entry = log_entries.Evict(victim, -1)
        self.world.operator(entry, self.node(i))

    @rule(i=st.integers(0, 2), others=st.sets(st.integers(0, 2), min_size=1, max_size=2))
    def force(self, i: int, others: Set[int]) -> None:
        """The operator asserts that robots are off, be it true or not."""
        self.world.given_up = True
        for j in sorted(others):
            self.node(i).give(
                interface.ForceEvict("force %d" % self.world.steps, self.node(j).name)
            )

    def teardown(self) -> None:
        if not hasattr(self, "world"):
            return
        world = self.world
        world.blocked.clear()
        world.weather = Weather()
        for node in world.nodes.values():
            node.doomed = None
            if node.replica is None:
                node.start()
        world.acting = False
        settled = world.run(world.now + 8, world.has_settled)
        if not settled:  # right only if the vote that is needed went with a lost log
            best = max((n.replica.ledger for n in world.alive()), key=lambda ledger: ledger.length)
            voters = [n.name for n in world.alive() if n.replica.active]
            assert any(n.old_disks for n in world.nodes.values()), "not settled"
            assert not is_quorum(voters, best.state.members()), "not settled"
        logs = [
            EventLog(d.header["log"], d.header, d.records(), plan=world.plan) for d in world.logs()
        ]
        verdict = verify(logs, settled=settled and not world.given_up)
        assert verdict.violation is None, verdict.violation


Team.TestCase.settings = settings(
    max_examples=100,
    stateful_step_count=25,
    deadline=None,
    suppress_health_check=list(HealthCheck),
)
TestTeam = Team.TestCase
