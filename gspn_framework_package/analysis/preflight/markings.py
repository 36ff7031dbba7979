"""The part of the check that visits markings, for the questions that the structure left open."""

from __future__ import annotations

import itertools
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Dict, Iterable, List, Optional, Sequence

import numpy as np

from gspn_framework_package.analysis.plan.markings import Finding, PlanMarkings
from gspn_framework_package.analysis.plan.structure import may_lose_robots
from gspn_framework_package.analysis.preflight.mending import (
    bounded,
    missing_row,
    resources_given_back,
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
from gspn_framework_package.analysis.proofs.questions import CAN_MOVE, DEAD, NO_ROW, MarkingQuestion
from gspn_framework_package.analysis.state_space.coverability import CoverabilityTree
from gspn_framework_package.analysis.state_space.rated_graph import enabled_in, rate_or_weight
from gspn_framework_package.analysis.watch import Cancel, Progress
from gspn_framework_package.model.errors import LimitError, NetError

if TYPE_CHECKING:
    from gspn_framework_package.analysis.proofs.ladder import Answer

BY_PROOF = "state equation"
"""How questions were decided without visiting markings: also its invariants follow from it."""

_PROOFS = {"dead_markings": DEAD, "policy": NO_ROW, "waiting": CAN_MOVE}
"""The questions that proofs can decide."""

DEAD_MARKING = "dead marking: nothing can happen"

COUNTS_BEFORE_PROOFS = 30_000_000
"""Number of counts (markings times places) after which proofs are tried before more markings are
visited. A plan of at most 150 places has its 200,000 markings visited first: they also show which
transitions never fire, and who can wait for ever."""

TREE_NODES = 5_000
"""Largest number of nodes of the coverability tree that shows which places grow."""


class MarkingChecks:
    """Adds the findings from the reachable markings to a checklist.

    :param structure: the structural checks, with the questions that they left open.
    :param limit: largest number of markings to visit.
    :param seconds: the budget for deciding what they leave open (s); 0 leaves it open.
    """

    def __init__(
        self,
        structure: StructureChecks,
        checklist: Checklist,
        limit: int,
        progress: Optional[Progress],
        cancel: Optional[Cancel],
        seconds: float,
    ) -> None:
        self.plan = structure.plan
        self.net = structure.net
        self.limit = limit
        self.progress, self.cancel = progress, cancel
        self._structure = structure
        self._list = checklist
        self._seconds = seconds
        self._losses = may_lose_robots(self.plan, structure.standalone)
        self._asked: Dict[str, List[Answer]] = {}

    def look_at_markings(self) -> PlanMarkings:
        """Visit markings, answer the open questions, and return the markings."""
        losses = self._losses
        markings = self._visit(
            False, min(self.limit, COUNTS_BEFORE_PROOFS // max(len(self.net.places), 1))
        )
        if (
            not markings.complete
            and len(markings.space) < self.limit
            and not self._all_proven(markings)
        ):
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
        if not markings.complete and (self._seconds > 0 or self._asked):
            left = self._not_decided_otherwise(left, markings)
            if not self._waits_decided(markings):
                left.append("waiting")
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
            "waiting": self._waiting_undecided,
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

    def _all_proven(self, markings: PlanMarkings) -> bool:
        """Whether proofs decide all open questions, for teams that lost robots too, so that
        visiting more markings would add little."""
        return self._seconds > 0 and all(
            question in _PROOFS
            and not self._is_answered(question, markings)
            and all(answer.certificate is not None for answer in self._answers(question))
            for question in self._structure.open
        )

    def _is_answered(self, question: str, markings: PlanMarkings) -> bool:
        """Whether the markings visited answer one of the questions that proofs can decide."""
        if question == "dead_markings":
            found = markings.dead(after_losses=False)
        else:
            found = itertools.chain(markings.policy_gaps(), markings.undecided_choices())
        return next(found, None) is not None

    def _not_decided_otherwise(self, left: List[str], markings: PlanMarkings) -> List[str]:
        """The questions of ``left`` that are open even if they are put to proofs and to guided
        searches for witnesses, since the markings visited leave them open."""
        decided = set()
        for question in left:
            if question not in _PROOFS or self._is_answered(question, markings):
                continue
            for answer in self._answers(question):
                if question == "dead_markings":
                    if self._report_dead(answer):
                        decided.add(question)
                elif answer.certificate is not None:
                    decided.add(question)
                    self._list.add(
                        "policy",
                        Severity.OK,
                        "the policy has a row for every marking that needs a decision%s"
                        % self._as_long_as(answer),
                        decided_by=BY_PROOF,
                        losses=answer.question.losses,
                    )
        return [question for question in left if question not in decided]

    def _waits_decided(self, markings: PlanMarkings) -> bool:
        """Report by proofs and searches whether robots can wait for ever; return whether this is
        decided. Where nothing at all can happen, all wait, which is reported separately."""
        if self._is_answered("dead_markings", markings) or any(
            item.check == "dead_markings" and "marking" in item.details for item in self._list.items
        ):
            return True
        answer = self._answers("waiting")[0]
        if answer.sequence is not None:
            self._report_findings(
                "waiting",
                Severity.WARNING,
                [Finding(answer.marking or {}, list(answer.sequence))],
                "a robot can wait forever, since nothing can ever take it from its place",
                waits=True,
            )
        elif answer.certificate is not None:
            self._list.add(
                "waiting",
                Severity.OK,
                "every robot that is not at an end can always move again%s"
                % self._as_long_as(answer),
                decided_by=BY_PROOF,
                losses=answer.question.losses,
            )
        return answer.sequence is not None or answer.certificate is not None

    def _waiting_undecided(self, markings: PlanMarkings) -> None:
        self._undecided(markings, "waiting", "whether a robot can wait forever")

    def _answers(self, question: str) -> List[Answer]:
        """The answers to a question that proofs can decide, also with the losses of robots."""
        if question in self._asked:
            return self._asked[question]
        # few plans need them, nor the solver that they import
        from gspn_framework_package.analysis.proofs.ladder import decide_for_team

        begun = time.monotonic()
        answers = decide_for_team(
            self.plan,
            MarkingQuestion(_PROOFS[question]),
            losses=self._losses and question != "waiting",
            seconds=max(self._seconds, 0.1),
            limit=0,
            progress=self.progress,
            cancel=self.cancel,
        )
        self._seconds -= time.monotonic() - begun
        self._asked[question] = answers
        return answers

    def _as_long_as(self, answer: Answer) -> str:
        lost = answer.question.losses or not self._losses
        return "" if lost else " as long as no robot is lost"

    def _report_dead(self, answer: Answer) -> bool:
        """Report whether a dead marking can be reached; return whether this decides it for the
        whole team."""
        if answer.sequence is None and answer.certificate is None:
            return False
        if answer.sequence is None:
            self._list.add(
                "dead_markings",
                Severity.OK,
                "no dead marking can be reached%s: the state equation has no solution in which "
                "nothing can happen" % self._as_long_as(answer),
                decided_by=BY_PROOF,
                losses=answer.question.losses,
            )
            return True
        finding = Finding(answer.marking or {}, list(answer.sequence))
        if any(name not in self.net.transition_index for name in answer.sequence):
            self._report_after_loss([finding])
            return False
        self._report_findings("dead_markings", Severity.WARNING, [finding], DEAD_MARKING)
        return True

    def _visit(self, losses: bool, limit: Optional[int] = None) -> PlanMarkings:
        return PlanMarkings(
            self.plan,
            limit or self.limit,
            losses=losses,
            progress=self.progress,
            cancel=self.cancel,
        )

    def _decide_conservative(self, markings: PlanMarkings) -> None:
        flows = self.plan.flows
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
        idle = self._structure.rules.idle_places()
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
                **bounded(self.plan, grows),
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
            DEAD_MARKING,
        )
        self._report_after_loss(list(markings.dead(after_losses=True)))
        if not found and markings.complete:
            self._list.add(
                "dead_markings",
                Severity.OK,
                "no dead marking is reachable",
                decided_by="exploration",
            )
        elif not found:
            self._undecided(markings, "dead_markings", "whether a dead marking can be reached")

    def _report_after_loss(self, lost: Sequence[Finding]) -> None:
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
                **resources_given_back(self.plan),
            )

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
        known = set()
        for name, finding in markings.waiting_for_good(self._structure.timeless):
            known.add(finding.place)
            self._list.add(
                "waiting",
                Severity.WARNING,
                "a robot in %s that requests %s can wait forever while others continue: in %s, "
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
        for finding in markings.held_for_good(self._structure.timeless):
            if finding.place not in known:
                self._list.add(
                    "waiting",
                    Severity.WARNING,
                    "a robot in %s can wait forever while others continue: in %s, reached by %s, "
                    "nothing that takes a robot from %s can ever fire; let nothing take away for "
                    "good what it needs"
                    % (
                        finding.place,
                        marking_text(finding.marking),
                        sequence(finding.sequence),
                        finding.place,
                    ),
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
            mend = missing_row(self.plan, finding) if check == "policy" else {}
            where = " for a robot in %s" % finding.place if finding.place else ""
            self._list.add(
                check,
                severity,
                "%s%s in %s, reached by %s"
                % (what, where, marking_text(finding.marking), sequence(finding.sequence)),
                **finding.to_json(),
                **details,
                **mend,
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
