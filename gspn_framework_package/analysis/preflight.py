"""The check before any robot moves ("preflight"; thesis 4.3.5 and ``docs/semantics.md``).

Structure decides first, in milliseconds; markings are visited only for the questions that it leaves open, up to a
limit, and what is still open then is reported as not decided.
"""

from __future__ import annotations

import itertools
import time
from typing import TYPE_CHECKING, Any, Callable, Dict, Iterable, List, Optional, Sequence

from gspn_framework_package.analysis.coverability import CoverabilityTree
from gspn_framework_package.analysis.exploration import Cancel, Progress
from gspn_framework_package.analysis.invariants import invariant_bounds
from gspn_framework_package.analysis.plan_structure import (
    PolicyCover,
    always_leavable,
    find_cycle,
    only_written,
    robot_flows,
    terminal_places,
    timeless_transitions,
)
from gspn_framework_package.analysis.preflight_report import CheckItem, PreflightReport, Severity
from gspn_framework_package.model.errors import LimitError
from gspn_framework_package.model.plan import Action, Plan

if TYPE_CHECKING:  # loads SciPy, which a plan that structure decides has no need of: robots start sooner
    from gspn_framework_package.analysis.plan_markings import Finding, PlanMarkings

MARKING_LIMIT = 200_000
"""Markings that the check may visit when nothing else is said."""

TREE_NODES = 5_000
"""Nodes of the coverability tree that tells which places grow."""

LISTED = 10
"""Findings of one kind that a report lists; it always tells how many there are."""

ServerProbe = Callable[[str, str, Action], Optional[str]]
"""Asked for (robot, place, action) whether the action's server answers: None if so, else what is wrong."""

_OK, _WARNING, _REFUSED = Severity.OK, Severity.WARNING, Severity.REFUSED


def check(
    plan: Plan,
    *,
    limit: int = MARKING_LIMIT,
    server_probe: Optional[ServerProbe] = None,
    standalone: bool = False,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
) -> PreflightReport:
    """Check a plan before it runs.

    :param limit: markings to visit at most.
    :param server_probe: see :data:`ServerProbe`; without it no server is asked for.
    :param standalone: for agents, which a net may create and destroy, instead of robots.
    :param progress: told the number of markings now and then.
    :param cancel: asked now and then.
    :raises PlanError: not a plan: a name that does not exist, a rule that makes no sense.
    :raises PolicyError: the same of its policy.
    :raises CancelledError: ``cancel`` said so.
    """
    start = time.perf_counter()
    plan.validate()
    work = _Check(plan, limit, standalone, progress, cancel)
    work.look_at_names()
    work.look_at_structure()
    work.look_at_markings()
    if server_probe is not None:
        work.look_at_servers(server_probe)
    markings = work.markings
    order = list(Severity)[::-1]
    items = sorted(work.items, key=lambda item: order.index(item.severity))
    return PreflightReport(
        plan.name,
        tuple(items),
        len(markings.space) if markings else 0,
        markings.complete if markings else True,
        time.perf_counter() - start,
    )


class _Check:
    """The work of one :func:`check`: items come together, and open questions wait for the markings."""

    def __init__(
        self, plan: Plan, limit: int, standalone: bool, progress: Optional[Progress], cancel: Optional[Cancel]
    ) -> None:
        self.plan = plan
        self.net = plan.net
        self.limit = limit
        self.standalone = standalone
        self.progress, self.cancel = progress, cancel
        self.items: List[CheckItem] = []
        self.markings: Optional[PlanMarkings] = None
        self._open: List[str] = []
        self._unbalanced: List[int] = []
        self._timeless: List[int] = []
        self._cover = PolicyCover(plan)

    def _add(self, check: str, severity: Severity, text: str, **details: Any) -> None:
        self.items.append(CheckItem(check, severity, text, details))

    # -- names and maps ---------------------------------------------------------------------------------

    def look_at_names(self) -> None:
        net = self.net
        self._add(
            "net",
            _OK,
            "%d places, %d transitions, %d robots" % (len(net.places), len(net.transitions), len(self.plan.robots)),
        )
        self._look_at_actions()
        self._look_at_initial()
        self._look_at_overlaps()
        self._look_at_idle_places()
        self._look_at_decision_places()

    def _look_at_actions(self) -> None:
        plan = self.plan
        robots = plan.robots
        unmapped = [
            p
            for p in plan.action_places
            if p not in plan.actions and not (robots and all(p in r.actions for r in robots))
        ]
        mapped_resources = sorted(
            {p for p in plan.resource_places if p in plan.actions}
            | {p for r in robots for p in r.actions if p in plan.resource_places}
        )
        if unmapped:
            self._add(
                "actions",
                _REFUSED,
                "no action is mapped to %s; map null where robots have nothing to "
                "do, or list it as a resource place" % _names(unmapped),
                places=unmapped,
            )
        if mapped_resources:
            self._add(
                "actions",
                _REFUSED,
                "%s: a resource place has no action" % _names(mapped_resources),
                places=mapped_resources,
            )
        if not unmapped and not mapped_resources:
            self._add("actions", _OK, "every action place is mapped, and no resource place is")

    def _look_at_initial(self) -> None:
        counts = dict.fromkeys(self.plan.action_places, 0)
        for robot in self.plan.robots:
            counts[robot.place] += 1
        differing = {
            p: {"tokens": self.net.place(p).tokens, "robots": n}
            for p, n in counts.items()
            if self.net.place(p).tokens != n
        }
        if differing:
            text = "; ".join(
                "%s has %d token(s) and %d robot(s)" % (p, d["tokens"], d["robots"])
                for p, d in itertools.islice(differing.items(), LISTED)
            )
            self._add(
                "initial",
                _REFUSED,
                "the initial marking and the robots' initial places differ: " + text,
                places=differing,
            )
        else:
            self._add("initial", _OK, "the robots' initial places agree with the initial marking")

    def _look_at_overlaps(self) -> None:
        overlaps = self.plan.policy.bind(self.net).overlaps()
        listed: List[Dict[str, Any]] = [
            {"place": self.net.places[p].name, "rows": [a + 1, b + 1]} for p, a, b in overlaps
        ]
        for entry in listed[:LISTED]:
            first, second = entry["rows"]
            self._add(
                "policy_overlaps",
                _WARNING,
                "rows %d and %d of the policy can both match, and both speak "
                "of %s: row %d goes first" % (first, second, entry["place"], first),
                **entry,
            )
        if len(listed) > LISTED:
            self._add(
                "policy_overlaps",
                _WARNING,
                "%s%d pairs of rows overlap" % ("at least " if len(listed) >= 100 else "", len(listed)),
                pairs=listed,
            )

    def _look_at_idle_places(self) -> None:
        """With no action nobody says which of several exponential transitions a robot asks for."""
        for name in self.plan.action_places:
            leaving = [self.net.transitions[t] for t in self.net.consumers[self.net.place_number(name)]]
            if (
                name in self.plan.actions
                and self.plan.actions[name] is None
                and len(leaving) > 1
                and all(t.timed for t in leaving)
            ):
                self._add(
                    "unasked",
                    _WARNING,
                    "%s has no action, and only exponential outputs (%s): nobody "
                    "says which one to ask for" % (name, _names(t.name for t in leaving)),
                    place=name,
                )

    def _look_at_decision_places(self) -> None:
        places = [
            name
            for name in self.plan.action_places
            if self.plan.actions.get(name) is not None and self._only_immediate(self.net.place_number(name))
        ]
        if places:
            self._add(
                "decision_actions",
                _OK,
                "%s: robots run an action there before they decide; analysis "
                "takes these places as taking no time" % _names(places),
                places=places,
            )

    def _only_immediate(self, p: int) -> bool:
        leaving = self.net.consumers[p]
        return bool(leaving) and not any(self.net.transitions[t].timed for t in leaving)

    # -- structure --------------------------------------------------------------------------------------

    def look_at_structure(self) -> None:
        self._look_at_flows()
        self._look_at_cycles()
        self._look_at_servers_of_transitions()
        self._look_at_resources()
        self._look_at_dead_ends()
        self._look_at_policy()

    def _look_at_flows(self) -> None:
        flows = robot_flows(self.plan)
        names = [t.name for t in self.net.transitions]
        if self.standalone:
            self._add("conservative", _OK, "agents may be created and destroyed: not asked for")
            return
        creating = [t for t, flow in enumerate(flows) if not flow.taken and flow.put]
        for t in creating:
            self._add(
                "creates_robots",
                _REFUSED,
                "%s takes no robot and has an action place among its outputs: there is no robot to move" % names[t],
                transition=names[t],
            )
        unbalanced = [t for t, flow in enumerate(flows) if flow.taken != flow.put and t not in creating]
        if unbalanced:
            self._unbalanced = unbalanced
            self._open.append("conservative")
        elif not creating:
            self._add(
                "conservative",
                _OK,
                "every transition moves as many robots in as out (by structure)",
                decided_by="structure",
            )

    def _look_at_cycles(self) -> None:
        self._timeless = timeless_transitions(self.plan)
        cycle = find_cycle(self.net, self._timeless)
        if not cycle:
            self._add(
                "timeless_cycle",
                _OK,
                "immediate transitions cannot go round without an action or a time between them (by structure)",
                decided_by="structure",
            )
        elif len(cycle) == 1:
            self._add(
                "timeless_cycle",
                _REFUSED,
                "the immediate transition %s has no input place: it would fire without end" % cycle[0],
                cycle=cycle,
            )
        else:
            self._open.append("timeless_cycle")
            self._cycle = cycle

    def _look_at_servers_of_transitions(self) -> None:
        if sum(place.tokens for place in self.net.places if place.name not in self.plan.resource_places) < 2:
            return
        acts = {self.net.place_number(p) for p in self.plan.action_places}
        differing = [
            t.name
            for i, t in enumerate(self.net.transitions)
            if t.timed and t.servers is not None and any(p in acts for p, _ in self.net.inputs[i])
        ]
        if differing:
            self._add(
                "servers",
                _WARNING,
                "%s: the file says a limited number of servers, but robots work in "
                "parallel, so runs and the analysis of the plan have as many servers as robots; the "
                "analysis of the net takes the file's word" % _names(differing),
                transitions=differing,
            )

    def _look_at_resources(self) -> None:
        self._written = only_written(self.plan)
        if self._written:
            self._add(
                "counters",
                _OK,
                "%s: only written, so that they may grow without bound; left out of the "
                "exploration" % _names(self._written),
                places=list(self._written),
            )
        net = self.net.without_places(self._written)
        bounds = dict(zip((p.name for p in net.places), invariant_bounds(net, 2_000)))
        self._resource_bounds = {p.name: bounds[p.name] for p in net.places if p.name in self.plan.resource_places}
        unknown = [p for p, bound in self._resource_bounds.items() if bound is None]
        if unknown:
            self._open.append("resource_bounds")
        elif self._resource_bounds:
            self._tell_bounds({p: b for p, b in self._resource_bounds.items() if b is not None}, "structure")

    def _tell_bounds(self, bounds: Dict[str, int], how: str) -> None:
        listed = ", ".join("%s %d" % item for item in itertools.islice(bounds.items(), LISTED))
        self._add(
            "resource_bounds",
            _OK,
            "resource places are bounded: %s%s" % (listed, ", ..." if len(bounds) > LISTED else ""),
            bounds=bounds,
            decided_by=how,
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
            self._open.append("dead_markings")
        else:
            self._add(
                "dead_markings",
                _OK,
                "no dead marking: a robot alone can leave every place that has outputs (by structure)",
                decided_by="structure",
            )

    def _always_moves(self, p: int) -> bool:
        """Whether a robot in place number ``p`` can go on whatever the others do."""
        if not always_leavable(self.net, p):
            return False
        leaving = [self.net.transitions[t] for t in self.net.consumers[p]]
        if any(t.timed for t in leaving) or self._cover.always_moves(p):
            return True
        return not self.plan.policy.rows and not self.plan.strict and all(t.weight > 0 for t in leaving)

    def _look_at_policy(self) -> None:
        plan = self.plan
        asking = [
            name
            for name in plan.action_places
            for p in (self.net.place_number(name),)
            for leaving in ([t for t in self.net.consumers[p] if not self.net.transitions[t].timed],)
            if len(leaving) > (0 if plan.strict else 1)
        ]
        weighty = all(t.weight > 0 for t in self.net.transitions if not t.timed)
        ignored = [name for name in asking if self._cover.never_speaks(self.net.place_number(name))]
        if ignored:
            self._add(
                "policy",
                _WARNING,
                "a row of the policy always matches, and none speaks of a robot in %s: "
                "it waits there for good, unless its action names a transition" % _names(ignored),
                places=ignored,
            )
        if not asking:
            self._add("policy", _OK, "no place asks for a decision (by structure)", decided_by="structure")
        elif all(self._cover.matches(self.net.place_number(name)) for name in asking):
            self._add(
                "policy", _OK, "every marking that asks for a decision has a row (by structure)", decided_by="structure"
            )
        elif not plan.policy.rows and not plan.strict and weighty:
            self._add(
                "policy",
                _OK,
                "there is no policy: the weights decide in %s" % _names(asking),
                places=asking,
                decided_by="structure",
            )
        else:
            self._open.append("policy")

    # -- markings ---------------------------------------------------------------------------------------

    def look_at_markings(self) -> None:
        if not self._open:
            return
        losses = self.plan.timing.evict_after > 0 and len(self.plan.robots) > 1 and not self.standalone
        self.markings = self._visit(False)
        if losses and self.markings.complete:
            with_losses = self._visit(True)
            if with_losses.complete:
                self.markings = with_losses
            else:
                self._add(
                    "smaller_teams",
                    _WARNING,
                    "teams that lost a robot were not checked: more than %d markings" % self.limit,
                )
        if not self.markings.complete:
            self._add(
                "exploration",
                _WARNING,
                "not decided within %d markings: %s; what was found so far is "
                "listed" % (len(self.markings.space), _names(self._open)),
                open=list(self._open),
            )
        answers = {
            "conservative": self._decide_conservative,
            "timeless_cycle": self._decide_cycle,
            "resource_bounds": self._decide_bounds,
            "dead_markings": self._decide_dead,
            "policy": self._decide_policy,
        }
        for question in self._open:
            answers[question](self.markings)
        if self.markings.complete:
            never = self.markings.never_fire()
            if never:
                self._add("never_fire", _WARNING, "%s can never fire" % _names(never), transitions=never)

    def _visit(self, losses: bool) -> PlanMarkings:
        from gspn_framework_package.analysis.plan_markings import PlanMarkings

        return PlanMarkings(self.plan, self.limit, losses=losses, progress=self.progress, cancel=self.cancel)

    def _decide_conservative(self, markings: PlanMarkings) -> None:
        flows = robot_flows(self.plan)
        found = False
        for t in self._unbalanced:
            firing = markings.firing(t)
            if firing is not None:
                found = True
                name = self.net.transitions[t].name
                self._add(
                    "conservative",
                    _REFUSED,
                    "%s takes %d robot(s) and puts %d: robots cannot be created "
                    "or destroyed; it fires after %s"
                    % (name, flows[t].taken, flows[t].put, _sequence(firing.sequence)),
                    transition=name,
                    taken=flows[t].taken,
                    put=flows[t].put,
                    **firing.to_json(),
                )
        names = [self.net.transitions[t].name for t in self._unbalanced]
        if not found and markings.complete:
            self._add(
                "conservative",
                _OK,
                "%s would create or destroy robots, but never fires" % _names(names),
                transitions=names,
                decided_by="exploration",
            )
        elif not found:
            self._undecided(
                markings, "conservative", "whether %s, which would create or destroy robots, can fire" % _names(names)
            )

    def _decide_cycle(self, markings: PlanMarkings) -> None:
        traps = list(itertools.islice(markings.timeless_traps(self._timeless), 1))
        if traps:
            self._add(
                "timeless_cycle",
                _REFUSED,
                "immediate transitions go round for ever, without an action "
                "or a time between them, after %s, in %s" % (_sequence(traps[0].sequence), _marking(traps[0])),
                cycle=self._cycle,
                **traps[0].to_json(),
            )
        elif markings.complete:
            self._add(
                "timeless_cycle",
                _OK,
                "the cycle %s of immediate transitions always ends" % " -> ".join(self._cycle),
                cycle=self._cycle,
                decided_by="exploration",
            )
        else:
            self._undecided(
                markings, "timeless_cycle", "whether the cycle %s can go on for ever" % " -> ".join(self._cycle)
            )

    def _decide_bounds(self, markings: PlanMarkings) -> None:
        if markings.complete:
            bounds = markings.bounds()
            self._tell_bounds({p: bounds[p] for p in self._resource_bounds}, "exploration")
            return
        unknown = [p for p, bound in self._resource_bounds.items() if bound is None]
        grows = [p for p in self._growing() if p in unknown]
        if grows:
            self._add(
                "resource_bounds", _WARNING, "%s can grow without bound" % _names(grows), grows=grows, places=unknown
            )
            return
        seen = markings.bounds()
        self._add(
            "resource_bounds",
            _WARNING,
            "%s may grow: not decided within %d markings"
            % (", ".join("%s (%d seen)" % (p, seen[p]) for p in unknown[:LISTED]), len(markings.space)),
            places=unknown,
            seen={p: seen[p] for p in unknown},
        )

    def _growing(self) -> List[str]:
        """The places that can hold any number of tokens, where a coverability tree of some size can tell."""
        try:
            tree = CoverabilityTree(
                self.net.without_places(self._written), untimed=True, limit=TREE_NODES, cancel=self.cancel
            )
        except LimitError:
            return []
        return tree.unbounded_places

    def _decide_dead(self, markings: PlanMarkings) -> None:
        found = list(markings.dead(after_losses=False))
        self._tell_findings("dead_markings", _WARNING, found, "dead marking: nothing goes on")
        lost = list(markings.dead(after_losses=True))
        self._tell_findings(
            "dead_after_loss", _WARNING, lost, "when a robot is lost, the others can be stuck", listed=3
        )
        if not found and markings.complete:
            self._add("dead_markings", _OK, "no dead marking is reachable", decided_by="exploration")
        elif not found:
            self._undecided(markings, "dead_markings", "whether a dead marking can be reached")

    def _decide_policy(self, markings: PlanMarkings) -> None:
        severity = _REFUSED if self.plan.strict else _WARNING
        gaps = list(markings.policy_gaps()) if self.plan.policy.rows or self.plan.strict else []
        self._tell_findings(
            "policy",
            severity,
            gaps,
            "the policy has no row" + ("" if self.plan.strict else ", so that the weights decide"),
        )
        waiting = list(markings.undecided_choices())
        self._tell_findings("policy", _WARNING, waiting, "neither the policy nor a weight above 0 decides")
        if not gaps and not waiting and markings.complete:
            self._add(
                "policy",
                _OK,
                "the policy has a row for every marking that asks for a decision",
                decided_by="exploration",
            )
        elif not gaps and not waiting:
            self._undecided(markings, "policy", "whether the policy covers every marking")

    def _tell_findings(
        self, check: str, severity: Severity, found: Sequence[Finding], what: str, listed: int = LISTED
    ) -> None:
        for finding in found[:listed]:
            where = " for a robot in %s" % finding.place if finding.place else ""
            self._add(
                check,
                severity,
                "%s%s in %s, reached by %s" % (what, where, _marking(finding), _sequence(finding.sequence)),
                **finding.to_json(),
            )
        if len(found) > listed:
            self._add(check, severity, "%s: %d markings in all" % (what, len(found)), count=len(found))

    def _undecided(self, markings: PlanMarkings, check: str, what: str) -> None:
        self._add(
            check, _WARNING, "%s was not decided within %d markings" % (what, len(markings.space)), undecided=True
        )

    # -- servers ----------------------------------------------------------------------------------------

    def look_at_servers(self, probe: ServerProbe) -> None:
        asked: Dict[str, Optional[str]] = {}
        for robot in self.plan.robots:
            for place in self.plan.action_places:
                action = self.plan.action(robot.name, place)
                if action is None:
                    continue
                problem = probe(robot.name, place, action)
                asked["%s in %s" % (robot.name, place)] = problem
                if problem:
                    self._add(
                        "servers_answer",
                        _REFUSED,
                        "%s in %s: %s" % (robot.name, place, problem),
                        robot=robot.name,
                        place=place,
                    )
        if not any(asked.values()):
            self._add("servers_answer", _OK, "%d action server(s) answer" % len(asked))


def _names(names: Iterable[str]) -> str:
    listed = list(names)
    more = ", ... (%d in all)" % len(listed) if len(listed) > LISTED else ""
    return ", ".join(listed[:LISTED]) + more


def _sequence(names: Sequence[str]) -> str:
    if not names:
        return "nothing: at the start"
    if len(names) > 12:
        return "%s, ... (%d firings) ..., %s" % (", ".join(names[:8]), len(names), ", ".join(names[-3:]))
    return ", ".join(names)


def _marking(finding: Finding) -> str:
    return "(%s)" % ", ".join("%s: %d" % item for item in finding.marking.items())
