"""What reaches this robot from outside the team: events that interrupt it, tasks that come in.

Owns ``offered``. Turns events of the robot's present visit into proposals. Keeps tasks, in the log
as well, until the team has them: every robot that a task reached keeps it, the first running member
proposes it, and the others do so only if that takes too long. So a task survives the robot that
received it, and usually is proposed once.
"""

from __future__ import annotations

from typing import List, Optional, Set, Tuple

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.agreement.config import Config
from gspn_framework_package.execution.agreement.electorate import Electorate
from gspn_framework_package.execution.agreement.outbox import Outbox
from gspn_framework_package.execution.agreement.proposals import Proposals
from gspn_framework_package.execution.agreement.state import ReplicaState
from gspn_framework_package.execution.event_log import Record
from gspn_framework_package.execution.event_watch import EventWatch, Visit

OFFERED_LIMIT = 10_000
"""Most tasks that a robot keeps for a team that does not take them."""


class Reactions:
    """Events and tasks at this robot."""

    def __init__(
        self,
        config: Config,
        state: ReplicaState,
        outbox: Outbox,
        electorate: Electorate,
        proposals: Proposals,
    ) -> None:
        self.config = config
        self.state = state
        self.outbox = outbox
        self.electorate = electorate
        self.proposals = proposals
        self._watch = EventWatch(config.plan, config.name) if config.plan.events else None

    # -- events ------------------------------------------------------------------------------------

    def observe(self, given: interface.EventObserved) -> None:
        """Take in what a source shows."""
        if self._watch is not None:
            self._watch.observe(given.transition, given.holds, given.cause)

    def want_events(self) -> None:
        """Propose the events that interrupt the robot now."""
        if self._watch is not None:
            for event in self._watch.due(self._visit(), self.state.now):
                self.proposals.propose(event)

    def watches(self, transition: str) -> bool:
        """Whether an event could interrupt the robot in its present visit."""
        return self._watch is not None and self._watch.watches(transition)

    def _visit(self) -> Optional[Visit]:
        state = self.state
        at = state.position
        if at is None or not state.active or at.incarnation != state.incarnation:
            return None
        return Visit(self.config.plan.net.places[at.place].name, at.incarnation, at.visit)

    # -- tasks -------------------------------------------------------------------------------------

    def take_task(self, task: log_entries.Submit) -> str:
        """Keep a task until the team has it; returns why it is not kept, "" if it is."""
        state = self.state
        t = self.config.plan.net.transition_index.get(task.transition)
        if t not in self.config.game.submissions:
            return "no tasks come in by '%s'" % task.transition
        if state.ledger.state.ended is not None:
            return "the run is over: %s" % state.ledger.state.ended
        assert t is not None
        key = (task.transition, task.id)
        if key in state.offered or state.ledger.state.is_known(t, task.id):
            return ""
        if len(state.offered) >= OFFERED_LIMIT:
            return "%d tasks wait for the team already" % OFFERED_LIMIT
        self.outbox.persist({"kind": "offered", "entry": log_entries.to_json(task)})
        state.offered[key] = (task, state.now)
        return ""

    def is_known(self, task: log_entries.Submit) -> bool:
        """Whether the team has a task already."""
        t = self.config.plan.net.transition_index.get(task.transition)
        return t is not None and self.state.ledger.state.is_known(t, task.id)

    def want_tasks(self) -> None:
        """Propose the tasks that the team does not have yet, if it is our turn."""
        state = self.state
        if not state.offered:
            return
        team, index = state.ledger.state, self.config.plan.net.transition_index
        for key in [key for key in state.offered if team.is_known(index[key[0]], key[1])]:
            del state.offered[key]
        if not self.electorate.is_settled() and not state.active:
            return
        proposed = self._proposed()
        for key, (task, since) in state.offered.items():
            if key not in proposed and (self._is_first() or state.now >= since + self._patience()):
                self.proposals.propose(task)

    def _proposed(self) -> Set[Tuple[str, str]]:
        entries = (own.item.entry for own in self.state.own_proposals)
        return {(e.transition, e.id) for e in entries if isinstance(e, log_entries.Submit)}

    def _is_first(self) -> bool:
        live = self.electorate.heard_within(3 * self.config.pace.heartbeat)
        return live[:1] == [self.config.name]

    def _patience(self) -> float:
        """How long we leave a task to the first member (s)."""
        return 2 * max(self.config.pace.takeover, 3 * self.state.round_trip)

    # -- time, and our own log ---------------------------------------------------------------------

    def wake_times(self) -> List[float]:
        """When to look again (s)."""
        times = []
        if self._watch is not None:
            time = self._watch.wake_time(self._visit())
            if time is not None:
                times.append(time)
        if self.state.offered and self.state.active:
            proposed = self._proposed()
            times += [
                since + self._patience()
                for key, (_, since) in self.state.offered.items()
                if key not in proposed
            ][:1]
        return times

    def recall(self, record: Record) -> None:
        """Take over a record of our own log."""
        entry = log_entries.from_json(record["entry"])
        if isinstance(entry, log_entries.Submit) and len(self.state.offered) < OFFERED_LIMIT:
            self.state.offered[entry.transition, entry.id] = (entry, self.state.now)
