"""The part of the check about events, tasks and data: which events interrupt what, which names are
never written, and where a task can get lost."""

from __future__ import annotations

from typing import Any, Dict, List, Set, Tuple

from gspn_framework_package.analysis.preflight.report import LISTED, Checklist, Severity, name_list
from gspn_framework_package.model.action import (
    EXEC_GSPN,
    FunctionAction,
    ServerAction,
    read_by,
    written_by,
)
from gspn_framework_package.model.data import full_name
from gspn_framework_package.model.plan import Plan


class ReactingChecks:
    """Adds the findings about events, tasks and data of ``plan`` to a checklist.

    :param standalone: the tokens are agents, which are never evicted.
    """

    def __init__(self, plan: Plan, checklist: Checklist, standalone: bool) -> None:
        self.plan = plan
        self.net = net = plan.net
        self._list = checklist
        self._standalone = standalone
        self._queues = {net.place_number(p) for p in plan.tasks.queues}
        self._done = {net.transition_number(t) for t in (*plan.tasks.done, *plan.cancellations)}

    def look_at_reactions(self) -> None:
        """Check events, tasks and data, if the plan has any."""
        if self.plan.events:
            self._look_at_events()
        if self._queues:
            self._look_at_tasks()
        self._look_at_data()

    # -- events ------------------------------------------------------------------------------------

    def _look_at_events(self) -> None:
        plan, net = self.plan, self.net
        interrupting = [
            (t, net.places[p].name)
            for name in plan.events
            for t in (net.transition_number(name),)
            for p, _ in net.inputs[t]
            if plan.acts[p]
        ]
        if interrupting:
            interruptions = [
                "%s (%s) interrupts %s"
                % (net.transitions[t].name, self._source(net.transitions[t].name), place)
                for t, place in interrupting
            ]
            self._list.add(
                "events",
                Severity.OK,
                "; ".join(interruptions[:LISTED]) + _more(interruptions),
                events=[
                    {
                        "transition": net.transitions[t].name,
                        "place": place,
                        **plan.events[net.transitions[t].name].to_json(),
                    }
                    for t, place in interrupting
                ],
            )
        possible = self._possible()
        never = [t for t, _ in interrupting if t not in possible]
        if never:
            listed = [net.transitions[t].name for t in never]
            self._list.add(
                "events",
                Severity.WARNING,
                "%s can never have an effect: no robot reaches its place, or no token another "
                "place that it takes from (by structure)" % name_list(listed),
                transitions=listed,
                decided_by="structure",
            )
        differing = []
        for t, _ in interrupting:
            transition = net.transitions[t]
            after = plan.events[transition.name].comes_after
            if after is not None and not 0.5 < after * transition.number < 2:
                differing.append(
                    (
                        transition.name,
                        "%s: after %g s, %.4g s by its rate"
                        % (transition.name, after, 1 / transition.number),
                    )
                )
        if differing:
            self._list.add(
                "events",
                Severity.WARNING,
                "times of events and rates of the net differ more than twofold: %s; a run and the "
                "simulation take the time, the analysis the rate"
                % "; ".join([text for _, text in differing][:LISTED]),
                transitions=[name for name, _ in differing],
            )

    def _source(self, transition: str) -> str:
        """The source of an event, in words."""
        if transition in self.plan.cancellations:
            return "gspn cancel"
        return self.plan.events[transition].label

    def _possible(self) -> Set[int]:
        """The transitions that may fire, judged by single places: all their input places can get a
        token."""
        net = self.net
        marked = {p for p, place in enumerate(net.places) if place.tokens}
        marked |= {net.place_number(p) for p in self.plan.spawn}
        marked |= {
            net.place_number(resource)
            for returned in self.plan.on_evict.values()
            for resource in returned
        }
        possible: Set[int] = set()
        while True:
            new = {
                t
                for t, inputs in enumerate(net.inputs)
                if t not in possible and all(p in marked for p, _ in inputs)
            }
            if not new:
                return possible
            possible |= new
            marked |= {p for t in new for p, _ in net.outputs[t]}

    # -- tasks -------------------------------------------------------------------------------------

    def _look_at_tasks(self) -> None:
        plan, net = self.plan, self.net
        before = len(self._list.items)
        carrying = self._carrying()
        for t, transition in enumerate(net.transitions):
            taken, given = self._tasks_of(t)
            movers, places = plan.flows[t]
            laden = [net.places[p].name for p, _ in net.inputs[t] if p in carrying]
            kept = 0 if t in self._done else len(laden)
            if taken and not movers and t not in self._done and taken > given:
                self._warn(
                    "%s takes a task from its queue, but no robot gets it: it is dropped; list the "
                    "transition in tasks.done if the task is done there" % transition.name,
                    transition=transition.name,
                )
            elif taken and kept + taken - given > min(movers, places):
                self._warn(
                    "%s gives a task to a robot that may still carry one from before (in %s): the "
                    "first one is dropped; end it before, by a transition in tasks.done or one "
                    "that leads into a queue" % (transition.name, name_list(laden)),
                    transition=transition.name,
                    places=laden,
                )
            elif kept and not given and places < movers:
                self._warn(
                    "%s ends a robot that may carry a task (in %s): the task is dropped"
                    % (transition.name, name_list(laden)),
                    transition=transition.name,
                    places=laden,
                )
        self._look_at_failures(carrying)
        if not plan.tasks.done:
            self._warn("tasks.done lists no transition: no task is ever done")
        ends = [net.places[p].name for p in sorted(carrying) if not net.consumers[p]]
        if ends:
            self._warn(
                "a robot can end in %s with an unfinished task" % name_list(ends), places=ends
            )
        alone = [
            net.places[p].name
            for p in sorted(carrying)
            if not any(
                net.place_number(resource) in self._queues
                for resource in plan.on_evict.get(net.places[p].name, {})
            )
        ]
        if alone and plan.timing.evict_after > 0 and not self._standalone:
            from gspn_framework_package.analysis.preflight.mending import tasks_given_back

            self._warn(
                "a robot that is lost in %s keeps its task, which nobody else does; let on_evict "
                "give a token back to the queue there" % name_list(alone),
                places=alone,
                **tasks_given_back(plan, alone),
            )
        if len(self._list.items) == before:
            self._list.add(
                "tasks",
                Severity.OK,
                "tasks queue in %s and are done at %s; none gets lost (by structure)"
                % (
                    name_list(
                        "%s (by %s)" % (queue, plan.tasks.order[queue])
                        if queue in plan.tasks.order
                        else queue
                        for queue in plan.tasks.queues
                    ),
                    name_list(plan.tasks.done),
                ),
                queues=list(plan.tasks.queues),
                done=list(plan.tasks.done),
                comes_in=list(plan.submissions),
                decided_by="structure",
            )

    def _look_at_failures(self, carrying: Set[int]) -> None:
        """Warn where a failure fires a transition that is for cancelled tasks."""
        for p in sorted(carrying):
            place = self.net.places[p].name
            fired = self.plan.failure_rule(place).transition
            if fired in self.plan.cancellations:
                self._warn(
                    "a robot whose action fails in %s fires %s, which ends no task, and keeps its "
                    "own until another one pushes it out; let on_failure try again, or fire a "
                    "transition that leads into a queue" % (place, fired),
                    transition=fired,
                    places=[place],
                )

    def _warn(self, text: str, **details: Any) -> None:
        self._list.add("tasks", Severity.WARNING, text, **details)

    def _tasks_of(self, t: int) -> Tuple[int, int]:
        """The numbers of tasks that transition ``t`` takes from queues and puts into queues."""
        return (
            sum(w for p, w in self.net.inputs[t] if p in self._queues),
            sum(w for p, w in self.net.outputs[t] if p in self._queues),
        )

    def _carrying(self) -> Set[int]:
        """The action places in which a robot may carry a task, found by following tasks through
        every transition that may fire."""
        net = self.net
        carrying: Set[int] = set()
        possible = self._possible()
        while True:
            size = len(carrying)
            for t in possible:
                taken, given = self._tasks_of(t)
                laden = 0
                if t not in self._done:
                    laden = sum(w for p, w in net.inputs[t] if p in carrying)
                if laden + taken > given:
                    carrying |= {p for p, _ in net.outputs[t] if self.plan.acts[p]}
            if len(carrying) == size:
                return carrying

    # -- data --------------------------------------------------------------------------------------

    def _look_at_data(self) -> None:
        plan = self.plan
        read: Dict[str, List[str]] = {}
        written: Set[str] = set()
        open_ended: List[str] = []  # places whose actions may write anything
        for place, action in plan.bindings():
            for name in read_by(action):
                if place not in read.setdefault(name, []):
                    read[name].append(place)
            written.update(full_name(name) for name in written_by(action))
            if isinstance(action, FunctionAction) or (
                isinstance(action, ServerAction) and action.type == EXEC_GSPN
            ):
                open_ended.append(place)
        if not read:
            return
        before = len(self._list.items)
        for name, places in read.items():
            scope = name.split(".")[0]
            who = "the action of %s reads '%s'" % (name_list(places), name)
            if scope == "task" and not self._queues:
                self._data(
                    Severity.WARNING,
                    "%s, but no robot ever carries a task: the plan has no tasks.queues" % who,
                    name,
                    places,
                )
            elif name in written or name == "task.id":
                continue
            elif scope == "task":
                self._data(Severity.OK, who + ": submitted tasks must contain it", name, places)
            elif open_ended:
                self._data(
                    Severity.OK,
                    "%s: only the functions and ExecGSPN servers of %s can write it"
                    % (who, name_list(dict.fromkeys(open_ended))),
                    name,
                    places,
                )
            else:
                self._data(
                    Severity.WARNING,
                    who + ", which is never written: the action fails there",
                    name,
                    places,
                )
        if len(self._list.items) == before:
            self._data(Severity.OK, "every name that an action reads is written", "", [])

    def _data(self, severity: Severity, text: str, name: str, places: List[str]) -> None:
        details: Dict[str, Any] = {"name": name, "places": places} if name else {}
        self._list.add("data", severity, text, **details)


def _more(listed: List[str]) -> str:
    return ", ... (%d in total)" % len(listed) if len(listed) > LISTED else ""
