"""Turns the log of a team into events for the page, from entries, firings and states."""

from __future__ import annotations

from typing import Any, Dict, List, Optional, Sequence, Tuple

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.displayed_data import (
    SHOWN_TASKS,
    cause_text,
    displayed_robot,
    displayed_team,
)
from gspn_framework_package.execution.enabled_set import EnabledSet
from gspn_framework_package.execution.firing import Firing
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.plan_change import NewNames
from gspn_framework_package.execution.team_state import RobotState, TeamState
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.model.net import Marking, Net
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.visualizer.board import (
    Board,
    Event,
    RobotMove,
    data_event,
    enter,
    fire_event,
    first_status,
    mark_event,
    plan_event,
    renumbered,
)


class TeamEvents:
    """Follows the states of one run.

    A transition counts as enabled here if the marking gives it concession: in a run the robots'
    actions take time, so priorities only matter among simultaneous requests.

    :param game: the rules of the run's initial plan.
    :param plans: number -> plan that the team followed; updated. The first one is number 0.
    """

    def __init__(self, game: TokenGame, plans: Optional[Dict[int, Plan]] = None) -> None:
        self._first = self.game = game
        self.net = game.net
        self.plans: Dict[int, Plan] = {} if plans is None else plans
        self.plans[0] = game.plan
        self._number = 0
        """The rules of the plan that the team follows."""
        self._digest = ""
        """Digest of the plan that the team adopted; "" if it follows its first plan."""
        self._enabled = EnabledSet(self.net, game.new_state().marking, by_priority=False)
        self._robots: Dict[str, Dict[str, Any]] = {}
        self._status: Dict[str, Any] = {}
        self._data: Dict[str, Any] = {}
        self._looked_at: Dict[str, Any] = {}
        """Robot, or "" for the team -> its data and tasks when they were last reported."""

    def board(self, running: bool, run: str = "") -> Board:
        """The board before the run ``run`` begins."""
        self._status = first_status(run, running)
        return Board(
            len(self.net.transitions), self._enabled.marking, self._enabled.now, self._status
        )

    def step(
        self,
        entries: Sequence[log_entries.Entry],
        firings: Sequence[Firing],
        state: TeamState,
        t: Optional[float] = None,
        adopted: Sequence[Tuple[int, TokenGame]] = (),
    ) -> List[Event]:
        """The events of one slot of the log.

        :param t: seconds since the run began, None for now.
        :param adopted: the plans adopted in the slot, each with the number of firings before it.
        """
        events: List[Event] = []
        why = ", ".join(dict.fromkeys(_deed(entry) for entry in entries if _deed(entry)))
        begins = adopted[-1][0] if adopted else 0
        other = bool(adopted) or self._digest != _digest(state)
        for number, firing in enumerate(firings):
            if other and number == begins:
                events.append(self._other_plan(state, _before(firing, self._first.now(state).net)))
                other = False
            events += self._fired(firing, why or "state taken over")
        if other:
            events.append(self._other_plan(state, state.marking))
        if state.marking != self._enabled.marking:
            events.append(self._whole(state.marking, why or "state taken over"))
        events += self._robots_changed(state)
        events += self._data_changed(state)
        events += self._status_changed(state)
        if t is not None:
            for event in events:
                event["t"] = round(t, 4)
        return events

    def status(self, **changes: Any) -> List[Event]:
        """The event for a changed status; none if nothing changed."""
        changed = {k: v for k, v in changes.items() if self._status.get(k) != v}
        self._status.update(changed)
        return [{"k": "status", "status": changed}] if changed else []

    def to_json(self) -> Dict[str, Any]:
        """The current state as a JSON object, for :meth:`restore`."""
        return {
            "marking": list(self._enabled.marking),
            "robots": self._robots,
            "status": self._status,
            "data": self._data,
            "number": self._number,
            "digest": self._digest,
        }

    def restore(self, data: Dict[str, Any], game: TokenGame) -> None:
        """Continue from a state returned by :meth:`to_json`, under the rules that apply in it."""
        self._number, self._digest = data["number"], data["digest"]
        self.game, self.net = game, game.net
        self._enabled = EnabledSet(self.net, tuple(data["marking"]), by_priority=False)
        self._robots = {name: dict(shown) for name, shown in data["robots"].items()}
        self._status = dict(data["status"])
        self._data = dict(data["data"])

    # -- parts -------------------------------------------------------------------------------------

    def _other_plan(self, state: TeamState, marking: Marking) -> Event:
        """The team follows another plan from here on.

        :param marking: the marking of its net before any firing.
        """
        old, game = self.game.plan, self._first.now(state)
        mapping = state.adopted.mapping if state.adopted is not None else {}
        names = NewNames(old, game.plan, mapping)
        self.game, self.net = game, game.net
        self._number, self._digest = self._number + 1, _digest(state)
        self.plans[self._number] = game.plan
        self._enabled = EnabledSet(self.net, marking, by_priority=False)
        event = plan_event(self._number, old, game.plan, names, self._enabled)
        for shown in self._robots.values():
            shown["place"] = renumbered(shown.get("place"), event["places"])
        self._looked_at.clear()
        return event

    def _fired(self, firing: Firing, why: str) -> List[Event]:
        t = self.net.transition_index[firing.transition]
        before = _before(firing, self.net)
        events: List[Event] = []
        if before != self._enabled.marking:
            events.append(self._whole(before, why))
        change = self._enabled.move_to(firing.marking)
        moves: List[RobotMove] = []
        for move in firing.moves:
            source = self.net.place_index[move.source] if move.source is not None else None
            target = self.net.place_index[move.target] if move.target is not None else None
            moves.append((move.robot, source, target))
            if target is None:
                self._robots.pop(move.robot, None)
            else:
                shown = self._robots.setdefault(move.robot, {"name": move.robot})
                enter(shown, target)
                self._looked_at.pop(move.robot, None)
        fired = fire_event(
            self.net,
            t,
            change,
            firing.robot,
            moves,
            why=cause_text(firing.cause),
            tasks=firing.tasks,
        )
        events.append({**fired, "s": [firing.slot, firing.index]})
        return events

    def _whole(self, marking: Marking, why: str) -> Event:
        self._enabled.move_to(marking)
        return mark_event(self._enabled, why)

    def _robots_changed(self, state: TeamState) -> List[Event]:
        changed = []
        for robot in state.robots.values():
            shown = self._robots.get(robot.name)
            seen = self._describe(state, robot)
            raw = (robot.data, robot.task, dict(robot.held), robot.resumed_from)
            if self._is_new(robot.name, raw):
                reported = displayed_robot(robot, self.net, brief=True)
                # data that a robot never had is not reported
                seen.update({k: v for k, v in reported.items() if v or (shown and shown.get(k))})
            if shown is None:
                changed.append(seen)
                self._robots[robot.name] = dict(seen)
                continue
            different = {k: v for k, v in seen.items() if shown.get(k) != v}
            if different:
                changed.append({"name": robot.name, **different})
                shown.update(different)
        gone = [name for name in self._robots if name not in state.robots]
        for name in gone:
            del self._robots[name]
        return [{"k": "robots", "r": changed, "gone": gone}] if changed or gone else []

    def _data_changed(self, state: TeamState) -> List[Event]:
        # unchanged values are recognised by identity
        raw = (state.data, list(state.queues.items()), state.submitted[:SHOWN_TASKS])
        if not self._is_new("", raw):
            return []
        return data_event(self._data, displayed_team(state, self.net, brief=True))

    def _is_new(self, whose: str, raw: Any) -> bool:
        """Whether data and tasks may have changed since they were last reported."""
        if self._looked_at.get(whose) == raw:
            return False
        self._looked_at[whose] = raw
        return True

    def _describe(self, state: TeamState, robot: RobotState) -> Dict[str, Any]:
        return {
            "name": robot.name,
            "place": robot.place,
            "phase": robot.phase.value,
            "visit": robot.visit,
            "attempt": robot.attempt,
            "paused": robot.paused,
            "why": "" if robot.phase.gone else self.game.why_waiting(state, robot),
        }

    def _status_changed(self, state: TeamState) -> List[Event]:
        return self.status(
            paused=state.paused,
            stalled="" if state.ended is not None else self._stalled(state),
        )

    def _stalled(self, state: TeamState) -> str:
        """Why nothing more can happen without intervention; "" if something can."""
        active = state.active()
        if not active and state.created and not self.game.plan.simulate_environment:
            return "no robot is left"
        waiting = [r for r in active if r.phase in (Phase.DONE, Phase.FAILED)]
        if state.paused or not waiting or any(r.phase is Phase.DOING for r in active):
            return ""
        fired = [
            self.net.transitions[t].name
            for t in self._enabled.now
            if self.net.transitions[t].timed and not self._takes_robots(t)
        ]
        if fired and self.game.plan.simulate_environment:
            return ""
        why = ["%s %s" % (r.name, self.game.why_waiting(state, r)) for r in waiting[:3]]
        return ", ".join(why) + ("; the operator may fire %s" % ", ".join(fired) if fired else "")

    def _takes_robots(self, t: int) -> bool:
        resources = self.game.plan.resource_places
        return any(self.net.places[p].name not in resources for p, _ in self.net.inputs[t])


def _digest(state: TeamState) -> str:
    """The digest of the plan that a team adopted; "" if it follows its first one."""
    return state.adopted.digest if state.adopted is not None else ""


def _before(firing: Firing, net: Net) -> Marking:
    """The marking before a firing in a net."""
    before = list(firing.marking)
    for p, gain in net.effect(net.transition_index[firing.transition]):
        before[p] -= gain
    return tuple(before)


def _deed(entry: log_entries.Entry) -> str:
    """A description of an entry that changes the marking directly; "" for other entries."""
    if isinstance(entry, log_entries.Start):
        return "start"
    if isinstance(entry, log_entries.Join):
        return "%s joined" % entry.robot
    if isinstance(entry, log_entries.Leave):
        return "%s left" % entry.robot
    if isinstance(entry, log_entries.Evict):
        return "%s was lost" % entry.robot
    if isinstance(entry, log_entries.SetPlace):
        return "%s was moved to %s" % (entry.robot, entry.place)
    if isinstance(entry, log_entries.CancelTask):
        return "task %s was cancelled" % entry.id
    if isinstance(entry, log_entries.GiveBack):
        return "task %s was given back" % entry.id
    return ""
