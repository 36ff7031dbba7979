"""Tracks this robot: its place, its actions, its local transitions, and the simulated environment.

The robot follows the log, ahead of it by the local transitions that are not in it yet. Owns
``position``, ``started``, ``running`` and ``reported``. Proposes the outcomes of its actions, asks
the electorate whether it may make a local transition, and puts goals into the outbox.
"""

from __future__ import annotations

import hashlib
import random
from collections import Counter, OrderedDict
from dataclasses import dataclass
from typing import Any, Dict, List, Mapping, Optional, Tuple, Union

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.agreement.local_transitions import LocalTransitions
from gspn_framework_package.execution.agreement.part import ReplicaPart
from gspn_framework_package.execution.agreement.state import Goal, Position, Proposal
from gspn_framework_package.execution.breakpoints import RobotBreakpoints
from gspn_framework_package.execution.environment import Environment
from gspn_framework_package.execution.firing import CancelAction, Firing, Move, StartAction
from gspn_framework_package.execution.ledger import Item, Origin
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.model.compact_json import compact_sorted
from gspn_framework_package.model.errors import LogError
from gspn_framework_package.model.net import Marking
from gspn_framework_package.model.outcome import Outcome
from gspn_framework_package.model.plan import Plan

_ActionCommand = Union[StartAction, CancelAction]


@dataclass(eq=False)
class LocalRobot(ReplicaPart):
    """Turns this robot's results into proposals or local transitions, and the log into goals."""

    breaks: RobotBreakpoints

    def __post_init__(self) -> None:
        self._from: Optional[Position] = None
        """Our robot's position in the log when we last took it over."""
        self._led_to: OrderedDict[Origin, Position] = OrderedDict()
        """The places to which local transitions that are not in the log have led since."""
        self._entered: Counter[int] = Counter()
        """How often they led to each place."""
        self._began: Optional[Tuple[Goal, Plan, str]] = None
        """The last started goal, with its plan and place."""
        self._take_rules(self.config.game)

    def _take_rules(self, game: TokenGame) -> None:
        """Apply these rules from now on."""
        config, self._game, self._from = self.config, game, None
        alone = config.partial and not config.witness
        self._transitions = LocalTransitions(game, config.name) if alone else None
        self._environment = Environment(
            game,
            random.Random("%d|%s" % (config.plan.seed, config.name)),
            without=[t for t, e in game.plan.events.items() if e.is_watched],
        )

    # -- the log and the position ------------------------------------------------------------------

    def follow(self) -> None:
        """Take over our robot's place from the log, and reapply our local transitions to it; those
        that the log rules out are void."""
        self.follow_plan()
        for own in self._follow():
            self.proposals.void(own, "the log rules it out")

    def follow_plan(self) -> None:
        """Follow the team's plan according to the log."""
        ledger = self.state.ledger
        if ledger.game is not self._game:
            self._take_rules(ledger.game)
            adopted = ledger.state.adopted
            self.outbox.put(
                interface.PlanChanged(
                    self._game.plan,
                    adopted.folder if adopted else "",
                    adopted.mapping if adopted else log_entries.NOTHING,
                )
            )

    def _follow(self) -> List[Proposal]:
        state, own_proposals = self.state, self.state.own_proposals
        robot = self.electorate.own_robot()
        if robot is None or robot.phase.gone or state.ledger.state.ended is not None:
            state.position = self._from = None
            return [own for own in own_proposals if own.item.private] if own_proposals.local else []
        doing = robot.phase is Phase.DOING and not state.ledger.state.is_stopped(robot)
        at = Position(robot.place, robot.incarnation, robot.visit, robot.attempt, doing)
        while self._from and self._led_to and next(iter(self._led_to)) not in own_proposals:
            _, self._from = self._led_to.popitem(last=False)
            self._entered[self._from.place] -= 1
        if at == self._from and len(self._led_to) == own_proposals.local:
            return []  # the log agrees with our local transitions
        self._from = state.position = at
        self._led_to.clear()
        self._entered.clear()
        return [own for own in own_proposals if own.item.private and not self._makes(own.item)]

    def _makes(self, item: Item) -> bool:
        """Make a waiting local transition; False if it is not possible."""
        assert isinstance(item.entry, log_entries.Done)
        made = self._go(item.entry) is not None
        if made:
            self._note_made(item.origin)
        return made

    def _note_made(self, origin: Origin) -> None:
        """Record that this local transition moved our robot."""
        at = self.state.position
        assert at is not None
        self._led_to[origin] = at
        self._entered[at.place] += 1

    def _go(self, entry: log_entries.Done) -> Optional[Tuple[int, int, int]]:
        """Make a local transition: (transition, place left, place entered), None if that is not
        possible."""
        at = self.state.position
        if self._transitions is None or at is None or not at.doing:
            return None
        if (entry.incarnation, entry.visit) != (at.incarnation, at.visit):
            return None
        team = self.state.ledger.state
        found = self._transitions.find(at.place, team.present_name(entry.result))
        if found is None:
            return None
        transition, target = found
        self.state.position = Position(target, at.incarnation, at.visit + 1, 1, True)
        return transition, at.place, target

    def marking(self) -> Marking:
        """The marking as this robot knows it: the log's, with its own local transitions."""
        team, at, shared = self.state.ledger.state, self.state.position, self.electorate.own_robot()
        if shared is None or at is None or shared.place == at.place:
            return team.marking
        marking = list(team.marking)
        marking[shared.place] -= 1
        marking[at.place] += 1
        return tuple(marking)

    # -- finished actions --------------------------------------------------------------------------

    def action_ended(self, given: Union[interface.ActionDone, interface.AttemptFailed]) -> None:
        """Handle the end of an attempt at an action."""
        goal = Goal(given.incarnation, given.visit, given.attempt)
        if self.state.fenced or not self._report(goal):
            return
        entry: log_entries.Entry
        if isinstance(given, interface.AttemptFailed):
            entry = log_entries.Failed(self.config.name, *goal, given.reason.value, given.detail)
        else:
            result = given.result if given.result not in (None, "None") else ""
            assert self.state.position is not None  # _report has checked this
            plan = self._game.plan
            place = plan.net.places[self.state.position.place].name
            if self._began is not None and self._began[0] == goal:
                _, plan, place = self._began  # the team may have adopted another plan since
            result = plan.transition_meant(place, result)
            entry = log_entries.Done(
                self.config.name, goal.incarnation, goal.visit, result, given.data
            )
            if self.breaks.breakpoints.stops_result(plan, place, result):
                self.pause_at_breakpoint()
            if given.data:
                entry = self._readable(entry, goal)
            elif self._may_move_alone():
                firing = self._make(entry)
                if firing is not None:
                    self._note_made(self.proposals.add_local_transition(entry, firing))
                    self.outbox.put(
                        interface.Fired(firing, True, self.state.ledger.hash, self._game.plan, True)
                    )
                    self.act({})
                    return
        self.proposals.propose(entry)

    def _readable(self, done: log_entries.Done, goal: Goal) -> log_entries.Entry:
        """A ``Done`` with its data in written form; a failure if the data could not be read
        back."""
        try:
            return log_entries.checked(done)
        except LogError as error:
            return log_entries.Failed(self.config.name, *goal, Outcome.BAD_RESULT, str(error))

    def pause_at_breakpoint(self) -> None:
        """Order a pause of our robot, unless it is paused already."""
        robot = self.electorate.own_robot()
        if robot is not None and not robot.paused:
            self.proposals.propose(log_entries.Pause(self.config.name))

    def _report(self, goal: Goal) -> bool:
        """Note the end of an attempt; False if it no longer matters."""
        state = self.state
        if state.position is None or goal != state.position.goal or not state.position.doing:
            return False
        if state.reported is not None and goal <= state.reported:
            return False
        state.reported = goal
        state.running = None
        return True

    def _may_move_alone(self) -> bool:
        """Whether a local transition may be made now, without asking."""
        if not self.config.partial or not self.electorate.is_settled():
            return False
        state, robot = self.state, self.electorate.own_robot()
        return (
            robot is not None
            and not robot.paused
            and not state.ledger.state.paused
            and not state.is_frozen()
            and all(own.suspect for own in state.own_proposals.asking)
            and self.electorate.surely_a_member()
        )

    def _make(self, entry: log_entries.Done) -> Optional[Firing]:
        """Make the local transition of a ``Done``, if it is one."""
        net = self._game.net
        before = self.marking()
        made = self._go(entry)
        if made is None:
            return None
        transition, source, target = made
        name = self.config.name
        step = Move(name, net.places[source].name, net.places[target].name, entry.visit + 1)
        return Firing(
            -1,
            0,
            net.transitions[transition].name,
            name,
            entry.incarnation,
            entry.visit,
            (step,),
            net.fire(before, transition),
        )

    # -- goals -------------------------------------------------------------------------------------

    def act(self, delays: Mapping[Tuple[int, int], float]) -> None:
        """Start and cancel actions as the log (and our local transitions) say.

        :param delays: (visit, attempt) -> seconds to wait before it starts.
        """
        if not self.state.active or self.state.fenced or self.state.halted is not None:
            return
        for command in self._commands(delays):
            self._put(command)

    def stop_acting(self) -> None:
        """Cancel what runs; it counts as not started."""
        if self.state.running is not None:
            cancelled = CancelAction(self.config.name, self.state.running.visit)
            self.state.running = None
            self._put(cancelled)

    def _put(self, command: _ActionCommand) -> None:
        self.outbox.persist(_goal_record(command))
        self.outbox.put(command)

    def _commands(self, delays: Mapping[Tuple[int, int], float]) -> List[_ActionCommand]:
        """What to start and cancel so that the robot does what its position requires."""
        state, name = self.state, self.config.name
        out: List[_ActionCommand] = []
        at = state.position
        if at is not None and at.incarnation != state.incarnation:
            at = None  # entries about another incarnation do not concern us
        if state.running is not None and (at is None or not at.doing or at.goal != state.running):
            out.append(CancelAction(name, state.running.visit))
            state.running = None
        if at is None or not at.doing or (state.started is not None and at.goal <= state.started):
            return out
        plan = self._game.plan
        place = plan.net.places[at.place].name
        if plan.action(name, place) is None:
            # another plan has removed the action before it could restart
            state.started = state.reported = at.goal
            self.proposals.propose(log_entries.Done(name, at.incarnation, at.visit))
        elif self._may_start(at, place):
            self._began = (at.goal, plan, place)
            state.started = state.running = at.goal
            delay = delays.get((at.visit, at.attempt), 0.0)
            out.append(StartAction(name, place, *at.goal, delay, *self._given(at)))
        return out

    def _may_start(self, at: Position, place: str) -> bool:
        """Whether no breakpoint holds our robot before its action."""
        robot = self.electorate.own_robot()
        paused = robot is not None and robot.paused
        answer = self.breaks.may_start((at.incarnation, at.visit), place, at.attempt, paused)
        if answer == "pause":
            self.pause_at_breakpoint()
        return answer == "yes"

    def _given(self, at: Position) -> Tuple[Mapping[str, Any], int]:
        """The values that an action may read: the data in the log, and the visit that this one
        continues."""
        robot = self.electorate.own_robot()
        if robot is None:
            return log_entries.NOTHING, 0
        data = self.state.ledger.state.data_of(robot)
        if robot.visit == at.visit:
            return data, robot.resumed_from
        if self._entered[at.place] > 1:
            return data, 0  # an earlier local transition has already led there
        return data, robot.interrupted.get(at.place, 0)

    # -- the simulated environment -----------------------------------------------------------------

    def want_environment(self) -> None:
        """If the plan simulates its environment, the first running member fires its
        transitions."""
        state = self.state
        if not self._game.plan.simulate_environment or not self.electorate.may_vote():
            return
        drawn_kinds = (log_entries.Fire, log_entries.Submit)
        if any(isinstance(o.item.entry, drawn_kinds) for o in state.own_proposals.asking):
            return
        due = self._environment.next_time(state.ledger.state, state.now)
        if due is None or state.now < due:
            return
        drawn = self._environment.due(state.ledger.state, state.now)
        if drawn is not None and self.electorate.is_first_running():
            self.proposals.propose(drawn)

    def wake_times(self) -> List[float]:
        """When to check again (s)."""
        if self._game.plan.simulate_environment and self.electorate.may_vote():
            due = self._environment.next_time(self.state.ledger.state, self.state.now)
            return [due] if due is not None else []
        return []


def _goal_record(command: _ActionCommand) -> Dict[str, Any]:
    """The record of a command to the robot's actions."""
    if isinstance(command, CancelAction):
        return {"kind": "cancel", "visit": command.visit}
    record = {
        "kind": "goal",
        "place": command.place,
        "incarnation": command.incarnation,
        "visit": command.visit,
        "attempt": command.attempt,
    }
    if command.data:
        text = compact_sorted(dict(command.data))
        record["reads"] = hashlib.sha256(text.encode()).hexdigest()[:16]
    if command.resumed_from:
        record["resumed_from"] = command.resumed_from
    return record
