"""Faults in the host of a replica."""

from __future__ import annotations

import random
from typing import Any, ContextManager, Dict, List

from agreement.mutants.mutant import Mutant, wrap
from agreement.world import SimulatedNode
from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.agreement.local_robot import LocalRobot
from gspn_framework_package.execution.agreement.proposals import ProposalQueue


def _writes_late() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def carry_out(self: SimulatedNode, effects: List[interface.Effect]) -> None:
            late = [e for e in effects if isinstance(e, interface.Persist)]
            original(self, [e for e in effects if not isinstance(e, interface.Persist)] + late)

        return carry_out

    return wrap(SimulatedNode, "carry_out", make)


def _starts_goals_twice() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def commands(self: LocalRobot, delays: Any) -> Any:
            out = original(self, delays)
            if random.Random(self.state.ledger.length).random() < 0.05:
                self.state.started = None
            return out

        return commands

    return wrap(LocalRobot, "_commands", make)


def _acts_before_joining() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def commands(self: LocalRobot, delays: Any) -> Any:
            mine = self.state.incarnation
            if self.state.position is not None:
                self.state.incarnation = self.state.position.incarnation
            try:
                return original(self, delays)
            finally:
                self.state.incarnation = mine

        return commands

    return wrap(LocalRobot, "_commands", make)


def _wrong_results() -> ContextManager[Any]:
    """The host mixes up results: it reports the previous visit's result for the current one."""
    last: Dict[str, str] = {}

    def make(original: Any) -> Any:
        def propose(
            self: ProposalQueue, entry: log_entries.Entry, order_id: str = "", suspect: str = ""
        ) -> None:
            original(self, entry, order_id, suspect)
            name, own = self.config.name, self.state.own_proposals
            if isinstance(entry, log_entries.Done):
                before = last.get(name, entry.result)
                last[name] = entry.result
                newest = list(own)[-1]
                item = newest.item._replace(entry=entry._replace(result=before))
                own.append(newest._replace(item=item))

        return propose

    return wrap(ProposalQueue, "propose", make)


MUTANTS: List[Mutant] = [
    Mutant("late writes", "host", "records are written after the messages went out", _writes_late),
    Mutant("two goals", "host", "now and then a goal is sent twice", _starts_goals_twice),
    Mutant(
        "early goals", "host", "a restarted robot acts before the team knows", _acts_before_joining
    ),
    Mutant("mixed results", "host", "a result is given for the wrong visit", _wrong_results),
]
