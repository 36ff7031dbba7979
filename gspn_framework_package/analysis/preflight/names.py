"""The part of the check that compares names and maps: actions, initial places, overlapping rows,
servers."""

from __future__ import annotations

import itertools
from importlib.util import find_spec
from typing import Any, Callable, Dict, List, Optional, Sequence, Set

from gspn_framework_package.analysis.preflight.report import (
    LISTED,
    SHARED_EFFORT,
    Checklist,
    Severity,
    name_list,
)
from gspn_framework_package.model.action import Action, ServerAction
from gspn_framework_package.model.errors import LimitError
from gspn_framework_package.model.net import Transition
from gspn_framework_package.model.plan import Transport
from gspn_framework_package.model.plan_timing import NO_REQUEST, PlanRules

ServerProbe = Callable[[str, str, Action], Optional[str]]
"""Called with (robot, place, action) to check whether the action's server answers; returns None if
it does, otherwise an error message."""


class NameChecks:
    """Adds the findings from the names and maps of a plan to a checklist."""

    def __init__(self, rules: PlanRules, checklist: Checklist) -> None:
        self._rules = rules
        self.plan = rules.plan
        self.net = rules.net
        self._list = checklist

    def look_at_names(self) -> None:
        """Compare the maps with the net."""
        net = self.net
        self._list.add(
            "net",
            Severity.OK,
            "%d places, %d transitions, %d robots"
            % (len(net.places), len(net.transitions), len(self.plan.robots)),
        )
        self._look_at_actions()
        self._look_at_initial()
        self._look_at_overlaps()
        self._look_at_idle_places()
        self._look_at_the_beginning()
        self._look_at_decision_places()
        self._look_at_times()
        self._look_at_transport()
        self._look_at_shared_servers()

    def _look_at_shared_servers(self) -> None:
        """Report action servers that robots may use at the same time: their names are absolute."""
        used: Dict[str, Dict[str, Set[str]]] = {}  # server -> place -> robots
        for robot in self.plan.robots:
            for place in self.plan.action_places:
                action = self.plan.action(robot.name, place)
                if isinstance(action, ServerAction) and action.server.startswith("/"):
                    used.setdefault(action.server, {}).setdefault(place, set()).add(robot.name)
        for server, places in used.items():
            robots = sorted(set().union(*places.values()))
            if len(robots) > 1 and not self._holds_one_token(list(places)):
                self._list.add(
                    "shared_servers",
                    Severity.WARNING,
                    "%s may use the server %s at the same time (%s): most servers do one goal at a "
                    "time, and the goal of one robot ends that of another; without the / in front, "
                    "each robot has its own" % (name_list(robots), server, name_list(places)),
                    server=server,
                    robots=robots,
                    places=list(places),
                )

    def _holds_one_token(self, places: Sequence[str]) -> bool:
        """Whether an invariant shows that these places never have two tokens together."""
        from gspn_framework_package.analysis.structure.invariants import place_invariants

        try:
            found = place_invariants(self.net, SHARED_EFFORT)
        except LimitError:
            return False
        alone = [i.weights for i in found if i.value is not None and i.value < 2]
        return any(all(weights.get(place) for place in places) for weights in alone)

    def _look_at_transport(self) -> None:
        """Report a library that the robots need but this machine does not have."""
        if self.plan.transport is Transport.ZENOH and find_spec("zenoh") is None:
            self._list.add(
                "transport",
                Severity.WARNING,
                "the robots communicate over Zenoh, but Python's library 'zenoh' is missing here: "
                "pip install eclipse-zenoh on each of their machines",
            )

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
            from gspn_framework_package.analysis.preflight.mending import null_actions

            self._list.add(
                "actions",
                Severity.REFUSED,
                "no action is mapped to %s; map null where robots have nothing to "
                "do, or list it as a resource place" % name_list(unmapped),
                places=unmapped,
                **null_actions(unmapped),
            )
        if mapped_resources:
            self._list.add(
                "actions",
                Severity.REFUSED,
                "%s: a resource place must not have an action" % name_list(mapped_resources),
                places=mapped_resources,
            )
        if not unmapped and not mapped_resources:
            self._list.add(
                "actions", Severity.OK, "every action place is mapped, and no resource place is"
            )

    def _look_at_times(self) -> None:
        """Report durations whose mean contradicts the rates of the net, unless they were learned
        from a run: analysis and simulation use the durations, and one of the two is wrong."""
        differing = []
        for name, duration in self.plan.durations.items():
            leaving = self._of_action(name)
            rate = sum(t.number for t in leaving if t.timed)
            learned = ("durations", name) in self.plan.evidence
            if learned or not (rate and all(t.timed for t in leaving)):
                continue
            if not 0.5 < duration.mean * rate < 2:
                differing.append(
                    "%s takes %.4g s on average, %.4g s by the rates"
                    % (name, duration.mean, 1 / rate)
                )
        if differing:
            self._list.add(
                "durations",
                Severity.WARNING,
                "durations and rates of the net differ more than twofold: %s; the durations apply"
                % "; ".join(differing[:LISTED]),
                places=[text.split(" takes ")[0] for text in differing],
            )

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
            from gspn_framework_package.analysis.preflight.mending import tokens_of_robots

            text = "; ".join(
                "%s has %d token(s) and %d robot(s)" % (p, d["tokens"], d["robots"])
                for p, d in itertools.islice(differing.items(), LISTED)
            )
            self._list.add(
                "initial",
                Severity.REFUSED,
                "the initial marking and the robots' initial places differ: " + text,
                places=differing,
                **tokens_of_robots({p: d["robots"] for p, d in differing.items()}),
            )
        else:
            self._list.add(
                "initial", Severity.OK, "the robots' initial places agree with the initial marking"
            )

    def _look_at_overlaps(self) -> None:
        overlaps = self.plan.policy.bind(self.net).overlaps()
        listed: List[Dict[str, Any]] = [
            {"place": self.net.places[p].name, "rows": [a + 1, b + 1]}
            for p, a, b in overlaps
            if self.plan.acts[p]  # no decision elsewhere
        ]
        for entry in listed[:LISTED]:
            first, second = entry["rows"]
            self._list.add(
                "policy_overlaps",
                Severity.WARNING,
                "rows %d and %d of the policy can both match, and both apply "
                "of %s: row %d takes precedence" % (first, second, entry["place"], first),
                **entry,
            )
        if len(listed) > LISTED:
            self._list.add(
                "policy_overlaps",
                Severity.WARNING,
                "%s%d pairs of rows overlap"
                % ("at least " if len(listed) >= 100 else "", len(listed)),
                pairs=listed,
            )

    def _look_at_idle_places(self) -> None:
        """Refuse places without an action that have several exponential outputs and no other:
        nothing decides which of them a robot requests, so it fails there at once."""
        for p, asked in self._rules.idle_places().items():
            name = self.net.places[p].name
            leaving = self._of_action(name)
            if name in self.plan.actions and asked == NO_REQUEST:
                self._list.add(
                    "unasked",
                    Severity.REFUSED,
                    "%s has no action and only exponential outputs (%s): nothing "
                    "selects one of them, so robots fail there at once; give it an action"
                    % (name, name_list(t.name for t in leaving)),
                    place=name,
                )

    def _look_at_the_beginning(self) -> None:
        """Refuse a plan whose run would end immediately."""
        plan, net = self.plan, self.net
        if plan.ending is not None and plan.ending.holds(net.initial_marking):
            self._list.add(
                "ends_at_once",
                Severity.REFUSED,
                "the condition 'until' (%s) holds at the start: the run would end immediately"
                % plan.until,
            )
        takes_time = plan.events or any(
            t.timed and not flow.taken for t, flow in zip(net.transitions, plan.flows)
        )
        idle = self._rules.idle_places(everybody=True)
        if any(plan.acts) and len(idle) == sum(plan.acts) and not takes_time:
            self._list.add(
                "ends_at_once",
                Severity.REFUSED,
                "no place has an action (all are null): nothing takes time, and the run would end "
                "immediately; give a place an action",
                places=list(plan.action_places),
            )

    def _look_at_decision_places(self) -> None:
        places = [
            name
            for name in self.plan.action_places
            if self.plan.actions.get(name) is not None and self._only_immediate(name)
        ]
        if places:
            self._list.add(
                "decision_actions",
                Severity.OK,
                "%s: robots run an action there before they decide; with --timing net, "
                "analysis assumes that these places take no time" % name_list(places),
                places=places,
            )

    def _only_immediate(self, place: str) -> bool:
        leaving = self._of_action(place)
        return bool(leaving) and not any(t.timed for t in leaving)

    def _of_action(self, place: str) -> List[Transition]:
        """The transitions that leave a place without an event: those that a robot requests."""
        asked = self.plan.of_action(self.net.place_number(place))
        return [self.net.transitions[t] for t in asked]

    def look_at_servers(self, probe: ServerProbe) -> None:
        """Check the server of every action."""
        asked: Dict[str, Optional[str]] = {}
        for robot in self.plan.robots:
            for place in self.plan.action_places:
                action = self.plan.action(robot.name, place)
                if action is None:
                    continue
                problem = probe(robot.name, place, action)
                asked["%s in %s" % (robot.name, place)] = problem
                if problem:
                    self._list.add(
                        "servers_answer",
                        Severity.REFUSED,
                        "%s in %s: %s" % (robot.name, place, problem),
                        robot=robot.name,
                        place=place,
                    )
        if not any(asked.values()):
            self._list.add("servers_answer", Severity.OK, "%d action server(s) answer" % len(asked))
