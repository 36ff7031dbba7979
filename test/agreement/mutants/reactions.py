"""Faults in events, tasks and data."""

from __future__ import annotations

from typing import Any, Callable, ContextManager, Dict, List, Optional, Sequence
from unittest import mock

from agreement.mutants.mutant import Mutant, wrap
from gspn_framework_package.execution import log_entries, turn
from gspn_framework_package.execution import token_game as token_game_module
from gspn_framework_package.execution.agreement.local_robot import LocalRobot
from gspn_framework_package.execution.agreement.outbox import Outbox
from gspn_framework_package.execution.agreement.reactions import Reactions
from gspn_framework_package.execution.rules import Rules
from gspn_framework_package.execution.team_state import TeamState
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.model.net import Net

_Reducer: Any = token_game_module._Reducer


def _interrupts_any_visit() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def event(self: Any, entry: log_entries.Interrupt) -> None:
            robot = self.state.robots.get(entry.robot)
            original(self, entry._replace(visit=robot.visit) if robot else entry)

        return event

    return wrap(_Reducer, "_event", make)


def _result_after_interrupt() -> ContextManager[Any]:
    """A result counts although an event has interrupted its action."""

    def make(original: Any) -> Any:
        def current(self: Any, name: str, incarnation: int, visit: int) -> Any:
            robot = self.state.robots.get(name)
            if robot is not None and robot.interrupted and visit == robot.visit - 1:
                visit = robot.visit
            return original(self, name, incarnation, visit)

        return current

    return wrap(_Reducer, "_current", make)


def _forgets_held_events() -> ContextManager[Any]:
    return mock.patch.object(turn.Turn, "_fire_held", lambda self: False)


def _holds_for_ever() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def enter(self: Any, robot: Any) -> None:
            held = robot.held
            original(self, robot)
            robot.held = held

        return enter

    return wrap(turn.Turn, "_enter", make)


def _pause_loses_events() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def event(self: Any, entry: log_entries.Interrupt) -> None:
            robot = self.state.robots.get(entry.robot)
            if not self.state.paused and not (robot and robot.paused):
                original(self, entry)

        return event

    return wrap(_Reducer, "_event", make)


def _interrupts_in_a_pause() -> ContextManager[Any]:
    return mock.patch.object(
        TokenGame,
        "may_interrupt",
        lambda self, state, robot, t: self.net.is_enabled(state.marking, t),
    )


def _loses_causes() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def interrupt(self: Any, robot: Any, t: int, cause: Any) -> None:
            original(self, robot, t, log_entries.NOTHING)

        return interrupt

    return wrap(turn.Turn, "_interrupt", make)


def _continues_again() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def enter(self: Any, robot: Any) -> None:
            interrupted = dict(robot.interrupted)
            original(self, robot)
            robot.interrupted = interrupted

        return enter

    return wrap(turn.Turn, "_enter", make)


def _takes_tasks_again() -> ContextManager[Any]:
    return mock.patch.object(TeamState, "is_known", lambda self, t, task: False)


def _tasks_first() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def requested(self: Any) -> bool:
            return bool(self._fire_submitted() or original(self))

        return requested

    return wrap(turn.Turn, "_fire_requested", make)


def _newest_task_first() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def pass_tasks(self: Any, *given: Any) -> Any:
            queues = self.state.queues
            for p in queues:
                queues[p] = queues[p][::-1]
            try:
                return original(self, *given)
            finally:
                for p in queues:
                    queues[p] = queues[p][::-1]

        return pass_tasks

    return wrap(turn.Turn, "_pass_tasks", make)


def _never_done() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def init(self: TokenGame, *given: Any, **named: Any) -> None:
            original(self, *given, **named)
            self.task_done = frozenset()

        return init

    return wrap(TokenGame, "__init__", make)


def _keeps_what_it_gives_back() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def give_back(self: Any, robot: Any, marking: Any, **how: Any) -> None:
            task = robot.task
            original(self, robot, marking, **how)
            robot.task = task

        return give_back

    return wrap(_Reducer, "_give_back", make)


def _returns_to_the_end() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def give_back(self: Any, robot: Any, marking: Any, **how: Any) -> None:
            original(self, robot, marking, **how)
            for p, queue in self.state.queues.items():
                self.state.queues[p] = queue[1:] + queue[:1]

        return give_back

    return wrap(_Reducer, "_give_back", make)


def _last_writer_loses() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def write(self: Any, robot: Any, data: Any) -> bool:
            mine = {n: v for n, v in data.items() if n[5:] not in self.state.data}
            return bool(original(self, robot, mine))

        return write

    return wrap(turn.Turn, "_write", make)


def _reads_ahead() -> ContextManager[Any]:
    """An action reads what its robot is about to write."""

    def make(original: Any) -> Any:
        def given(self: LocalRobot, at: Any) -> Any:
            data, resumed = original(self, at)
            for own in self.state.own_proposals:
                for name, value in getattr(own.item.entry, "data", {}).items():
                    data = {**data, "robot." + name.split(".")[-1]: value}
            return data, resumed

        return given

    return wrap(LocalRobot, "_given", make)


def _reads_late() -> ContextManager[Any]:
    """An action reads the data of the goal before."""
    last: Dict[str, Any] = {}

    def make(original: Any) -> Any:
        def given(self: LocalRobot, at: Any) -> Any:
            data, resumed = original(self, at)
            name = self.config.name
            before = last.get(name, data)
            last[name] = data
            return before, resumed

        return given

    return wrap(LocalRobot, "_given", make)


def _continues_ahead_again() -> ContextManager[Any]:

    def note_made(self: LocalRobot, origin: Any) -> None:
        assert self.state.position is not None
        self._led_to[origin] = self.state.position

    return mock.patch.object(LocalRobot, "_note_made", note_made)


def _writes_no_offer() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def persist(self: Outbox, record: Any, **waits: bool) -> None:
            if record["kind"] != "offered":
                original(self, record, **waits)

        return persist

    return wrap(Outbox, "persist", make)


def _reads_no_offers_back() -> ContextManager[Any]:
    return mock.patch.object(Reactions, "recall", lambda self, record: None)


def _leaves_tasks_to_the_first() -> ContextManager[Any]:
    return mock.patch.object(Reactions, "_patience", lambda self: 1e9)


def _takes_tasks_for_known() -> ContextManager[Any]:
    """A robot forgets a task once it has proposed it."""

    def make(original: Any) -> Any:
        def want(self: Reactions) -> None:
            original(self)
            for key in self._proposed():
                self.state.offered.pop(key, None)

        return want

    return wrap(Reactions, "want_tasks", make)


def _drops_tasks_of_later_plans() -> ContextManager[Any]:
    """A robot that forgot its log drops tasks for which the plan that is left has no entrance."""

    def make(original: Any) -> Any:
        def want(self: Reactions) -> None:
            entrance = self.state.ledger.entrance
            for key in [key for key in self.state.offered if entrance(key[0]) is None]:
                del self.state.offered[key]
            original(self)

        return want

    return wrap(Reactions, "want_tasks", make)


def _snapshot_of_state_without(key: str) -> Callable[[], ContextManager[Any]]:
    def apply() -> ContextManager[Any]:
        def make(original: Any) -> Any:
            def to_json(self: TeamState, net: Net) -> Any:
                data = original(self, net)
                data.pop(key, None)
                for robot in data["robots"]:
                    robot.pop(key, None)
                return data

            return to_json

        return wrap(TeamState, "to_json", make)

    return apply


def _keeps_what_is_cancelled() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def cancel(self: Any, found: Any, *how: Any) -> None:
            original(self, found, *how)
            if found.robot:
                self.state.robots[found.robot].task = found.task

        return cancel

    return wrap(_Reducer, "_cancel_task", make)


def _late_in_hand() -> ContextManager[Any]:
    def make(original: Any) -> Any:
        def about(self: Any, entry: Any) -> None:
            original(self, entry._replace(late=False) if hasattr(entry, "late") else entry)

        return about

    return wrap(_Reducer, "_about_task", make)


def _first_in_first_out() -> ContextManager[Any]:
    return mock.patch.object(turn, "queued", lambda queue, task, *_, **__: [*queue, task])


def _takes_tasks_of_others() -> ContextManager[Any]:
    return mock.patch.object(Rules, "may_take", lambda self, state, robot, t: True)


def _acts_while_stopped() -> ContextManager[Any]:
    return mock.patch.object(TeamState, "is_stopped", lambda self, robot: False)


_REACT = ("react", "react-operator", "react-calm")
_SNAPSHOTS = ("react-tight", "react-archive")
_TASKS = ("react-tasks",)


def _reacting(
    name: str,
    text: str,
    apply: Callable[[], ContextManager[Any]],
    partial: Optional[bool] = None,
    kinds: Sequence[str] = _REACT,
) -> Mutant:
    return Mutant(name, "reactions", text, apply, partial, kinds=kinds)


MUTANTS: List[Mutant] = [
    _reacting("stale event", "an event of any visit counts", _interrupts_any_visit),
    _reacting("two winners", "a result counts after an event", _result_after_interrupt),
    _reacting("never held", "an event that is held never fires", _forgets_held_events),
    _reacting("ever held", "an event is held after its visit has ended", _holds_for_ever),
    _reacting("lost in a pause", "a pause loses events", _pause_loses_events),
    _reacting("event in a pause", "an event fires in a pause", _interrupts_in_a_pause),
    _reacting("no cause", "firings do not say what caused them", _loses_causes),
    _reacting("continues again", "a visit is continued more than once", _continues_again),
    _reacting(
        "continues ahead",
        "the same, by local transitions that are not in the log",
        _continues_ahead_again,
        True,
    ),
    _reacting("task twice", "a task that came before comes in again", _takes_tasks_again),
    _reacting("tasks first", "a task comes in before robots move", _tasks_first),
    _reacting("newest task", "the newest task of a queue is taken first", _newest_task_first),
    _reacting("never done", "a robot keeps a task that is done", _never_done),
    _reacting("keeps task", "a robot keeps the task that it gave back", _keeps_what_it_gives_back),
    _reacting("back to the end", "a task goes back to the end of its queue", _returns_to_the_end),
    _reacting("first writer", "data of the team is written once", _last_writer_loses),
    _reacting("reads ahead", "an action reads what is not in the log", _reads_ahead),
    _reacting("reads late", "an action reads the data of the goal before", _reads_late),
    _reacting("unwritten task", "a task that came is not written down", _writes_no_offer),
    _reacting("forgotten task", "tasks are not read back", _reads_no_offers_back),
    _reacting("task of the first", "only the first member proposes", _leaves_tasks_to_the_first),
    _reacting(
        "keeps cancelled",
        "a robot keeps a task that is cancelled",
        _keeps_what_is_cancelled,
        kinds=_TASKS,
    ),
    _reacting("late in hand", "a task is late that a robot has", _late_in_hand, kinds=_TASKS),
    _reacting("no priority", "tasks are taken as they came", _first_in_first_out, kinds=_TASKS),
    _reacting("of others", "robots take tasks of others", _takes_tasks_of_others, kinds=_TASKS),
    _reacting("never stops", "a pause stops no action", _acts_while_stopped, kinds=_TASKS),
    _reacting("task let go", "a robot drops a task once it is proposed", _takes_tasks_for_known),
    Mutant(
        "task of a later plan",
        "reactions",
        "a robot that forgot its log drops tasks that came by a plan that it has yet to learn",
        _drops_tasks_of_later_plans,
        transcript="task_of_a_later_plan",
    ),
    *(
        _reacting(
            "snapshot without " + key,
            "a snapshot lacks '%s'" % key,
            _snapshot_of_state_without(key),
            kinds=_SNAPSHOTS,
        )
        for key in ("known", "submitted", "queues", "task", "held", "data", "interrupted")
    ),
]
