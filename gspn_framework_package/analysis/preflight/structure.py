"""The part of the check that the structure decides in milliseconds; the markings decide the
rest."""

from __future__ import annotations

from typing import Dict, List, Optional

from gspn_framework_package.analysis.plan.structure import (
    PolicyCover,
    always_leavable,
    find_cycle,
    places_in_cycles,
    terminal_places,
    timeless_transitions,
)
from gspn_framework_package.analysis.preflight.report import Checklist, Severity, name_list
from gspn_framework_package.model.plan_timing import PlanRules


class StructureChecks:
    """Adds the findings from the structure of a plan to a checklist.

    :ivar rules: what the plan means for each of its robots.
    :ivar open: the questions that only markings can decide.
    :ivar unbalanced: numbers of the transitions that would create or destroy robots.
    :ivar timeless: numbers of the transitions that may follow each other in zero time.
    :ivar cycle: a cycle of these, by names; empty if there is none.
    :ivar written: the counters that nothing reads.
    :ivar resource_bounds: the bounds of the other resource places, as far as known.
    """

    def __init__(self, rules: PlanRules, checklist: Checklist, standalone: bool) -> None:
        self.rules = rules
        self.plan = plan = rules.plan
        self.net = plan.net
        self.standalone = standalone
        self.open: List[str] = []
        self.unbalanced: List[int] = []
        self.timeless: List[int] = []
        self.cycle: List[str] = []
        self.written = plan.counters
        self.resource_bounds: Dict[str, Optional[int]] = {}
        self._list = checklist
        self._cover = PolicyCover(plan)

    def look_at_structure(self) -> None:
        """Answer the questions that the structure decides, and record the open ones."""
        if self.net.functions:
            self.open.append("rates")
        self._look_at_flows()
        self._look_at_cycles()
        self._look_at_predictions()
        self._look_at_servers_of_transitions()
        self._look_at_resources()
        self._look_at_dead_ends()
        self._look_at_policy()

    def _look_at_flows(self) -> None:
        flows = self.plan.flows
        transitions = self.net.transitions
        if self.standalone:
            self._list.add(
                "conservative", Severity.OK, "not checked: agents may be created and destroyed"
            )
            if any(flow.put < flow.taken for flow in flows):
                self.open.append("agents_left")
            return
        creating = [t for t, flow in enumerate(flows) if not flow.taken and flow.put]
        for t in creating:
            self._list.add(
                "creates_robots",
                Severity.REFUSED,
                "%s takes no robot but has an action place among its outputs: there is no robot "
                "to move" % transitions[t].name,
                transition=transitions[t].name,
            )
        unbalanced = [
            t for t, flow in enumerate(flows) if flow.taken != flow.put and t not in creating
        ]
        if unbalanced:
            self.unbalanced = unbalanced
            self.open.append("conservative")
        elif not creating:
            self._list.add(
                "conservative",
                Severity.OK,
                "every transition moves as many robots in as out, ignoring resource places (by "
                "structure)",
                decided_by="structure",
            )

    def _look_at_cycles(self) -> None:
        self.timeless = timeless_transitions(self.rules)
        cycle = find_cycle(self.net, self.timeless)
        if not cycle:
            self._list.add(
                "timeless_cycle",
                Severity.OK,
                "robots cannot move in a cycle without an action or time (by structure)",
                decided_by="structure",
            )
        elif len(cycle) == 1:
            self._list.add(
                "timeless_cycle",
                Severity.REFUSED,
                "the immediate transition %s has no input place: it would fire forever" % cycle[0],
                cycle=cycle,
            )
        else:
            self.open.append("timeless_cycle")
            self.cycle = cycle

    def _look_at_predictions(self) -> None:
        """Warn of a cycle that takes time in a run but none in a prediction."""
        cyclic = places_in_cycles(self.net, timeless_transitions(self.rules, predicted=True))
        cyclic.difference_update(self.rules.idle_places(everybody=True))
        acting = [p for p in self.plan.action_places if self.net.place_number(p) in cyclic]
        if acting:
            self._list.add(
                "predictions",
                Severity.WARNING,
                "according to the plan, the actions of %s take no time, and robots may cycle there "
                "without any: a run takes the time that the actions take, but the simulation and "
                "the analysis may refuse the plan; give these places 'durations'"
                % name_list(acting),
                places=acting,
            )

    def _look_at_servers_of_transitions(self) -> None:
        if self.plan.team_size < 2:
            return
        differing = [
            t
            for t, flow in zip(self.net.transitions, self.plan.flows)
            if t.timed and t.servers is not None and flow.taken
        ]
        # one server is also the default of a file that does not specify servers
        for single, severity, what in (
            (False, Severity.WARNING, "the file gives a limited number of servers"),
            (True, Severity.OK, "the file gives one server, or none"),
        ):
            listed = [t.name for t in differing if (t.servers == 1) is single]
            if listed:
                self._list.add(
                    "servers",
                    severity,
                    "%s: %s; robots work in parallel, so runs and the analysis of the plan have "
                    "as many servers as "
                    "robots; the analysis of the net uses the file's value"
                    % (name_list(listed), what),
                    transitions=listed,
                )

    def _look_at_resources(self) -> None:
        if self.written:
            self._list.add(
                "counters",
                Severity.OK,
                "%s: only written, so they may grow without bound; omitted from the "
                "exploration" % name_list(self.written),
                places=list(self.written),
            )
        if set(self.plan.resource_places) <= set(self.written):
            return
        from gspn_framework_package.analysis.structure.invariants import invariant_bounds

        net = self.net.without_places(self.written)
        bounds = dict(zip((p.name for p in net.places), invariant_bounds(net, 200_000)))
        self.resource_bounds = {
            p.name: bounds[p.name] for p in net.places if p.name in self.plan.resource_places
        }
        unknown = [p for p, bound in self.resource_bounds.items() if bound is None]
        if unknown:
            self.open.append("resource_bounds")
        elif self.resource_bounds:
            self._list.report_bounds(
                {p: b for p, b in self.resource_bounds.items() if b is not None}, "structure"
            )

    def _look_at_dead_ends(self) -> None:
        ends = terminal_places(self.plan)
        stuck = [
            name
            for name in self.plan.action_places
            for p in (self.net.place_number(name),)
            if p not in ends and not self._always_moves(p)
        ]
        if stuck or self.plan.until:
            self.open.append("dead_markings")
        else:
            self._list.add(
                "dead_markings",
                Severity.OK,
                "no dead marking: a robot alone can leave every place that has outputs (by "
                "structure)",
                decided_by="structure",
            )

    def _always_moves(self, p: int) -> bool:
        """Whether a robot in place number ``p`` can continue, whatever the others do."""
        if not always_leavable(self.net, p):
            return False
        events = [
            t for t in self.net.consumers[p] if self.net.transitions[t].name in self.plan.events
        ]
        if any(self.net.fires_alone(t, p) for t in events):
            return True  # as soon as the robot arrives
        leaving = [self.net.transitions[t] for t in self.net.consumers[p] if t not in events]
        if any(t.timed for t in leaving) or self._cover.always_moves(p):
            return True
        return (
            not self.plan.policy.bind(self.net).rows_of(p)
            and not self.plan.strict
            and not any(t.is_controllable for t in leaving)
        )

    def _look_at_policy(self) -> None:
        plan = self.plan
        asking = [
            name
            for name in plan.action_places
            if len(self.net.immediate_from[self.net.place_number(name)]) > (not plan.strict)
        ]
        weighty = not any(t.is_controllable for t in self.net.transitions)
        ignored = [
            name
            for name in plan.action_places
            if self.net.immediate_from[self.net.place_number(name)]
            and self._cover.never_speaks(self.net.place_number(name))
        ]
        if ignored:
            from gspn_framework_package.analysis.preflight.mending import rows_for_all_markings

            self._list.add(
                "policy",
                Severity.WARNING,
                "a row of the policy always matches, but none applies to a robot in %s: "
                "it waits there forever, unless its action names a transition" % name_list(ignored),
                places=ignored,
                waits=True,
                **rows_for_all_markings(plan, ignored),
            )
        if not asking:
            self._list.add(
                "policy",
                Severity.OK,
                "no place needs a decision (by structure)",
                decided_by="structure",
            )
        elif all(self._cover.matches(self.net.place_number(name)) for name in asking):
            self._list.add(
                "policy",
                Severity.OK,
                "every marking that needs a decision has a row (by structure)",
                decided_by="structure",
            )
        elif not plan.policy.rows and not plan.strict and weighty:
            self._list.add(
                "policy",
                Severity.OK,
                "there is no policy: the weights decide in %s" % name_list(asking),
                places=asking,
                decided_by="structure",
            )
        else:
            self.open.append("policy")
