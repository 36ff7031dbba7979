"""The part of the check that visits markings, for the questions that the structure left open."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any, Dict, Iterable, List, Optional, Sequence

import numpy as np

from gspn_framework_package.analysis.plan.markings import Finding, PlanMarkings
from gspn_framework_package.analysis.plan.structure import (
    idle_places,
    robot_flows,
)
from gspn_framework_package.analysis.preflight.report import (
    LISTED,
    Checklist,
    Severity,
    marking_text,
    name_list,
    sequence,
)
from gspn_framework_package.analysis.preflight.structure import StructureChecks
from gspn_framework_package.analysis.state_space.coverability import CoverabilityTree
from gspn_framework_package.analysis.state_space.rated_graph import enabled_in, rate_or_weight
from gspn_framework_package.analysis.watch import Cancel, Progress
from gspn_framework_package.model.errors import LimitError, NetError

PROOF_SECONDS = 5.0
"""Longest time that a proof may take (s)."""

TREE_NODES = 5_000
"""Largest number of nodes of the coverability tree that shows which places grow."""


class MarkingChecks:
    """Adds the findings from the reachable markings to a checklist.

    :param structure: the structural checks, with the questions that they left open.
    :param limit: largest number of markings to visit.
    :param prove: whether to prove what they leave open.
    """

    def __init__(
        self,
        structure: StructureChecks,
        checklist: Checklist,
        limit: int,
        progress: Optional[Progress],
        cancel: Optional[Cancel],
        prove: bool,
    ) -> None:
        self.plan = structure.plan
        self.net = structure.net
        self.limit = limit
        self.progress, self.cancel = progress, cancel
        self._structure = structure
        self._list = checklist
        self._prove = prove

    def look_at_markings(self) -> PlanMarkings:
        """Visit markings, answer the open questions, and return the markings."""
        losses = self._robots_can_be_lost()
        markings = self._visit(False)
        if losses and markings.complete:
            with_losses = self._visit(True)
            if with_losses.complete:
                markings = with_losses
            else:
                self._list.add(
                    "smaller_teams",
                    Severity.WARNING,
                    "teams that lost a robot were not checked: more than %d markings" % self.limit,
                )
        left = list(self._structure.open)
        if not markings.complete and "dead_markings" in left and self._proven_alive(markings):
            left.remove("dead_markings")
        if not markings.complete and left:
            self._list.add(
                "exploration",
                Severity.WARNING,
                "not decided within %d markings: %s; the findings so far are "
                "listed" % (len(markings.space), name_list(left)),
                open=left,
            )
        answers = {
            "conservative": self._decide_conservative,
            "agents_left": self._decide_agents_left,
            "timeless_cycle": self._decide_cycle,
            "resource_bounds": self._decide_bounds,
            "dead_markings": self._decide_dead,
            "policy": self._decide_policy,
            "rates": self._decide_rates,
        }
        for question in left:
            answers[question](markings)
        if markings.complete and markings.losses == losses:
            self._look_at_waiting(markings)
        if markings.complete:
            never = markings.never_fire()
            if never:
                self._list.add(
                    "never_fire",
                    Severity.WARNING,
                    "%s can never fire" % name_list(never),
                    transitions=never,
                )
        return markings

    def _robots_can_be_lost(self) -> bool:
        return (
            self.plan.timing.evict_after > 0
            and len(self.plan.robots) > 1
            and not self._structure.standalone
        )

    def _proven_alive(self, markings: PlanMarkings) -> bool:
        """Whether it is proven, and reported, that no dead marking is reachable, of which the
        visited markings have none."""
        if not self._prove or next(markings.dead(after_losses=False), None) is not None:
            return False
        # few plans need it, nor the solver that it imports
        from gspn_framework_package.analysis.proofs.dead_markings import plan_never_dead
        from gspn_framework_package.analysis.proofs.program import solver_available

        if not solver_available():
            return False
        losses = self._robots_can_be_lost()
        for lost in (True, False) if losses else (False,):
            if plan_never_dead(self.plan, PROOF_SECONDS, losses=lost, cancel=self.cancel):
                of = "" if lost or not losses else " as long as no robot is lost"
                self._list.add(
                    "dead_markings",
                    Severity.OK,
                    "no dead marking can be reached%s: the state equation has no solution in which "
                    "nothing can happen" % of,
                    decided_by="state equation",
                    losses=lost,
                )
                return True
        return False

    def _visit(self, losses: bool) -> PlanMarkings:
        return PlanMarkings(
            self.plan, self.limit, losses=losses, progress=self.progress, cancel=self.cancel
        )

    def _decide_conservative(self, markings: PlanMarkings) -> None:
        flows = robot_flows(self.plan)
        found = False
        for t in self._structure.unbalanced:
            firing = markings.firing(t)
            if firing is not None:
                found = True
                name = self.net.transitions[t].name
                self._list.add(
                    "conservative",
                    Severity.REFUSED,
                    "%s takes %d robot(s) and puts %d: robots cannot be created "
                    "or destroyed; it fires after %s"
                    % (name, flows[t].taken, flows[t].put, sequence(firing.sequence)),
                    transition=name,
                    taken=flows[t].taken,
                    put=flows[t].put,
                    **firing.to_json(),
                )
        culprits = [self.net.transitions[t].name for t in self._structure.unbalanced]
        if not found and markings.complete:
            self._list.add(
                "conservative",
                Severity.OK,
                "%s would create or destroy robots, but never fires" % name_list(culprits),
                transitions=culprits,
                decided_by="exploration",
            )
        elif not found:
            self._undecided(
                markings,
                "conservative",
                "whether %s, which would create or destroy robots, can fire" % name_list(culprits),
            )

    def _decide_agents_left(self, markings: PlanMarkings) -> None:
        gone = next(markings.without_robots(), None)
        if gone is not None:
            self._list.add(
                "agents_left",
                Severity.REFUSED,
                "every agent can end: after %s none is left and none can be created; let the last "
                "transition lead into a place without outputs" % sequence(gone.sequence),
                **gone.to_json(),
            )
        elif not markings.complete:
            self._undecided(markings, "agents_left", "whether every agent can end")

    def _decide_cycle(self, markings: PlanMarkings) -> None:
        traps = list(itertools.islice(markings.timeless_traps(self._structure.timeless), 1))
        if traps:
            self._list.add(
                "timeless_cycle",
                Severity.REFUSED,
                "transitions fire forever, with no action or time between them, after %s, in "
                "%s: the run would end at once%s"
                % (
                    sequence(traps[0].sequence),
                    marking_text(traps[0].marking),
                    self._whose_action_is_missing(),
                ),
                cycle=self._structure.cycle,
                **traps[0].to_json(),
            )
        elif markings.complete:
            self._list.add(
                "timeless_cycle",
                Severity.OK,
                "the cycle %s takes no time, but always ends" % " -> ".join(self._structure.cycle),
                cycle=self._structure.cycle,
                decided_by="exploration",
            )
        else:
            self._undecided(
                markings,
                "timeless_cycle",
                "whether the cycle %s can continue forever" % " -> ".join(self._structure.cycle),
            )

    def _whose_action_is_missing(self) -> str:
        """The advice for a timeless cycle, if places in it have no action."""
        idle = idle_places(self.plan)
        places = dict.fromkeys(p for p in self._structure.cycle if p in self.net.place_index)
        listed = [p for p in places if self.net.place_number(p) in idle]
        return (
            "; robots have no action (null) in %s and pass at once: give one of these places an "
            "action" % name_list(listed)
            if listed
            else ""
        )

    def _decide_rates(self, markings: PlanMarkings) -> None:
        """Compute the rates and weights that depend on the marking wherever they may be used."""
        space = markings.space
        for t, function in self.net.functions.items():
            able = enabled_in(
                self.net,
                t,
                lambda p: space.column(space.net.place_number(self.net.places[p].name)),
                len(space),
            )
            name = self.net.transitions[t].name
            try:
                rate_or_weight(
                    space.net, space.net.transition_number(name), space.store, np.flatnonzero(able)
                )
            except NetError as error:
                self._list.add("rates", Severity.REFUSED, str(error), transition=name)
            else:
                if markings.complete:
                    self._list.add("rates", Severity.OK, "'%s' of %s is above 0" % (function, name))

    def _decide_bounds(self, markings: PlanMarkings) -> None:
        if markings.complete:
            bounds = markings.bounds()
            self._list.report_bounds(
                {p: bounds[p] for p in self._structure.resource_bounds}, "exploration"
            )
            return
        unknown = [p for p, bound in self._structure.resource_bounds.items() if bound is None]
        grows = [p for p in self._growing() if p in unknown]
        if grows:
            self._list.add(
                "resource_bounds",
                Severity.WARNING,
                "%s can grow without bound" % name_list(grows),
                grows=grows,
                places=unknown,
            )
            return
        seen = markings.bounds()
        self._list.add(
            "resource_bounds",
            Severity.WARNING,
            "%s may grow: not decided within %d markings"
            % (
                ", ".join("%s (%d seen)" % (p, seen[p]) for p in unknown[:LISTED]),
                len(markings.space),
            ),
            places=unknown,
            seen={p: seen[p] for p in unknown},
        )

    def _growing(self) -> List[str]:
        """The places that can contain any number of tokens, as far as a coverability tree of
        limited size shows."""
        try:
            tree = CoverabilityTree(
                self.net.without_places(self._structure.written),
                untimed=True,
                limit=TREE_NODES,
                cancel=self.cancel,
            )
        except LimitError:
            return []
        return tree.unbounded_places

    def _decide_dead(self, markings: PlanMarkings) -> None:
        found = list(markings.dead(after_losses=False))
        at_once = [finding for finding in found if not finding.sequence]
        self._report_findings(
            "dead_markings", Severity.REFUSED, at_once, "nothing can ever fire: dead marking"
        )
        self._report_findings(
            "dead_markings",
            Severity.WARNING,
            [finding for finding in found if finding.sequence],
            "dead marking: nothing can happen",
        )
        lost = list(markings.dead(after_losses=True))
        if lost:
            more = " (and in %d other markings)" % (len(lost) - 1) if len(lost) > 1 else ""
            self._list.add(
                "dead_after_loss",
                Severity.WARNING,
                "when a robot is lost, the others can be stuck: in %s, reached by %s%s"
                % (marking_text(lost[0].marking), sequence(lost[0].sequence), more),
                **lost[0].to_json(),
                count=len(lost),
                others=[finding.to_json() for finding in lost[1:LISTED]],
            )
        if not found and markings.complete:
            self._list.add(
                "dead_markings",
                Severity.OK,
                "no dead marking is reachable",
                decided_by="exploration",
            )
        elif not found:
            self._undecided(markings, "dead_markings", "whether a dead marking can be reached")

    def _decide_policy(self, markings: PlanMarkings) -> None:
        severity = Severity.REFUSED if self.plan.strict else Severity.WARNING
        gaps = (
            self._kinds(markings.policy_gaps()) if self.plan.policy.rows or self.plan.strict else []
        )
        self._report_findings(
            "policy",
            severity,
            gaps,
            "the policy has no row" + ("" if self.plan.strict else ", so that the weights decide"),
        )
        waiting = list(markings.undecided_choices())
        self._report_findings(
            "policy",
            Severity.WARNING,
            waiting,
            "neither the policy nor a weight above 0 decides",
            waits=True,
        )
        if not gaps and not waiting and markings.complete:
            self._list.add(
                "policy",
                Severity.OK,
                "the policy has a row for every marking that needs a decision",
                decided_by="exploration",
            )
        elif not gaps and not waiting:
            self._undecided(markings, "policy", "whether the policy covers every marking")

    def _look_at_waiting(self, markings: PlanMarkings) -> None:
        for name, finding in markings.waiting_for_good(self._structure.timeless):
            self._list.add(
                "waiting",
                Severity.WARNING,
                "a robot in %s that requests %s can wait forever while others go on: in %s, "
                "reached by %s, %s can never fire; let nothing take away for good what it needs, "
                'or let an event such as {"after": SECONDS} move the robot on'
                % (
                    finding.place,
                    name,
                    marking_text(finding.marking),
                    sequence(finding.sequence),
                    name,
                ),
                transition=name,
                waits=True,
                **finding.to_json(),
            )

    def _kinds(self, findings: Iterable[Finding]) -> List[Finding]:
        """The findings; of those that differ only in counters read only by ``until``, the first."""
        counters = set(replace(self.plan, until=None).counters)
        kinds: Dict[Any, Finding] = {}
        for finding in findings:
            counts = tuple(item for item in finding.marking.items() if item[0] not in counters)
            kinds.setdefault((finding.place, counts), finding)
        return list(kinds.values())

    def _report_findings(
        self, check: str, severity: Severity, found: Sequence[Finding], what: str, **details: Any
    ) -> None:
        for finding in found[:LISTED]:
            where = " for a robot in %s" % finding.place if finding.place else ""
            self._list.add(
                check,
                severity,
                "%s%s in %s, reached by %s"
                % (what, where, marking_text(finding.marking), sequence(finding.sequence)),
                **finding.to_json(),
                **details,
            )
        if len(found) > LISTED:
            self._list.add(
                check, severity, "%s: %d markings in total" % (what, len(found)), count=len(found)
            )

    def _undecided(self, markings: PlanMarkings, check: str, what: str) -> None:
        self._list.add(
            check,
            Severity.WARNING,
            "%s was not decided within %d markings" % (what, len(markings.space)),
            undecided=True,
        )
