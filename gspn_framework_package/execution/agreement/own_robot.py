"""A replica's own robot: where it is, as the log and its private moves tell, and what it is
doing."""

from __future__ import annotations

from typing import Any, Dict, List, NamedTuple, Optional, Sequence, Tuple, Union

from gspn_framework_package.execution import entries as log
from gspn_framework_package.execution.agreement.pool import Own
from gspn_framework_package.execution.agreement.private import PrivateMoves
from gspn_framework_package.execution.firing import CancelAction, Firing, Move, StartAction
from gspn_framework_package.execution.ledger import Ledger
from gspn_framework_package.execution.team_state import GONE, Phase
from gspn_framework_package.model.net import Marking


class Goal(NamedTuple):
    """An attempt at the action of a visit; a later one is larger."""

    incarnation: int
    visit: int
    attempt: int


class Position(NamedTuple):
    """Where the robot is: ``place`` an index, ``doing`` whether its action should run."""

    place: int
    incarnation: int
    visit: int
    attempt: int
    doing: bool

    @property
    def goal(self) -> Goal:
        """The attempt that should run, or did."""
        return Goal(self.incarnation, self.visit, self.attempt)


class OwnRobot:
    """Follows the log, ahead of it by the private moves that are not in it yet.

    :ivar incarnation: ours; what the log says of another one is not for us to act on.
    :ivar position: None while the robot is not in the team.
    :ivar started: the last goal that went out.
    :ivar running: the goal whose end has not been reported.
    :ivar reported: the last goal whose end was.
    """

    def __init__(self, name: str, private: Optional[PrivateMoves]) -> None:
        self.name = name
        self._private = private
        self.incarnation = 0
        self.position: Optional[Position] = None
        self.started: Optional[Goal] = None
        self.running: Optional[Goal] = None
        self.reported: Optional[Goal] = None

    def follow(self, ledger: Ledger, own: Sequence[Own]) -> List[Own]:
        """Take over what the log says, and make the private moves of ``own`` again on top of it;
        those that can no longer be made."""
        robot = ledger.state.robots.get(self.name)
        if robot is None or robot.phase in GONE or ledger.state.ended is not None:
            self.position = None
            return [o for o in own if o.item.private]
        self.position = Position(
            robot.place,
            robot.incarnation,
            robot.visit,
            robot.attempt,
            robot.phase is Phase.DOING,
        )
        void = []
        for fact in own:
            if fact.item.private:
                entry = fact.item.entry
                assert isinstance(entry, log.Done)
                if self._make(entry) is None:
                    void.append(fact)
        return void

    def _make(self, entry: log.Done) -> Optional[Tuple[int, int, int]]:
        """Make a private move: (transition, place left, place entered), None if it cannot be."""
        at = self.position
        if self._private is None or at is None or not at.doing:
            return None
        if (entry.incarnation, entry.visit) != (at.incarnation, at.visit):
            return None
        move = self._private.move(at.place, entry.result)
        if move is None:
            return None
        transition, target = move
        self.position = Position(target, at.incarnation, at.visit + 1, 1, True)
        return transition, at.place, target

    def move(self, entry: log.Done, ledger: Ledger) -> Optional[Firing]:
        """Make the private move of a ``Done``, if it is one."""
        before = self.marking(ledger)
        made = self._make(entry)
        if made is None:
            return None
        transition, source, target = made
        net = ledger.game.net
        visit = entry.visit + 1
        step = Move(self.name, net.places[source].name, net.places[target].name, visit)
        return Firing(
            -1,
            0,
            net.transitions[transition].name,
            self.name,
            entry.incarnation,
            entry.visit,
            (step,),
            net.fire(before, transition),
        )

    def marking(self, ledger: Ledger) -> Marking:
        """The marking as this robot knows it: the log's, with its own private moves."""
        shared = ledger.state.robots.get(self.name)
        if shared is None or self.position is None or shared.place == self.position.place:
            return ledger.state.marking
        marking = list(ledger.state.marking)
        marking[shared.place] -= 1
        marking[self.position.place] += 1
        return tuple(marking)

    def report(self, goal: Goal) -> bool:
        """Note the end of an attempt; False if it is of no interest any more."""
        if self.position is None or goal != self.position.goal or not self.position.doing:
            return False
        if self.reported is not None and goal <= self.reported:
            return False
        self.reported = goal
        self.running = None
        return True

    def commands(self, ledger: Ledger, delays: Dict[Tuple[int, int], float]) -> List[Union[StartAction, CancelAction]]:
        """What to start and to cancel, so that the robot does what its position says.

        :param delays: (visit, attempt) -> seconds to wait before it starts.
        """
        out: List[Union[StartAction, CancelAction]] = []
        at = self.position
        if at is not None and at.incarnation != self.incarnation:
            at = None
        if self.running is not None and (at is None or not at.doing or at.goal != self.running):
            out.append(CancelAction(self.name, self.running.visit))
            self.running = None
        if at is None or not at.doing or (self.started is not None and at.goal <= self.started):
            return out
        place = ledger.game.net.places[at.place].name
        if ledger.game.plan.action(self.name, place) is not None:
            self.started = self.running = at.goal
            delay = delays.get((at.visit, at.attempt), 0.0)
            out.append(StartAction(self.name, place, *at.goal, delay))
        return out

    def stop(self) -> List[CancelAction]:
        """Cancel what runs; it counts as not started."""
        if self.running is None:
            return []
        cancelled = CancelAction(self.name, self.running.visit)
        self.running = None
        return [cancelled]


def goal_record(command: Union[StartAction, CancelAction]) -> Dict[str, Any]:
    """The record of a command to the robot's actions."""
    if isinstance(command, CancelAction):
        return {"kind": "cancel", "visit": command.visit}
    return {
        "kind": "goal",
        "place": command.place,
        "incarnation": command.incarnation,
        "visit": command.visit,
        "attempt": command.attempt,
    }
