"""Events that come from Python functions: how they are written, found and run, without ROS.

The source of an event may be a function of the plan's folder: ``{"function": "watch.low"}``. The
names of its parameters, all of them optional, declare what it needs:

- ``robot``: name of the robot (standalone: of the agent) that the event would interrupt; "" for
  tasks.
- ``data``: the data that an action of that robot may read, by full name; for tasks, that of the
  team.
- ``emit``: call it when the event occurs (see below).
- ``is_cancelled``: call it without arguments to learn whether the function should end;
  ``is_cancelled.wait(s)`` sleeps for ``s`` seconds, or until the function should end.

Any other parameter is a setting, as for actions (:mod:`gspn_framework_package.execution.actions`);
a class is instantiated once for each robot.

A function without ``emit`` is called every ``every`` seconds. For an event that interrupts a robot,
it returns whether the event holds: True or False (or None), or a dict, which means that the event
holds with that cause; it is also called when the robot enters another place. For tasks, it returns
a dict with the data of a task, a list of such dicts, or None if there are none; the key ``id``
identifies the task::

    def low(robot):
        level = battery_of(robot)
        return {"level": level} if level < 0.2 else False

    def order():
        return [{"id": o.number, "pose": o.pose} for o in new_orders()]

A function with ``emit`` is called once and runs for as long as it likes. ``emit(level=0.1)``
reports an event with that cause, ``emit(id="o7", pose=[1, 2])`` a task::

    def pressed(emit, is_cancelled):
        while not is_cancelled.wait(0.01):
            if button():
                emit()
"""

from __future__ import annotations

import threading
from typing import Any, Callable, Dict, Iterator, List, Mapping, NamedTuple, Optional, Tuple

from gspn_framework_package.execution.actions import (
    Cancellation,
    PythonFunction,
    error_text,
    load_function,
)
from gspn_framework_package.execution.log_entries import NOTHING, Submit, make_submit
from gspn_framework_package.execution.worker_pool import WorkerPool
from gspn_framework_package.model.data import why_not_kept
from gspn_framework_package.model.errors import DataError
from gspn_framework_package.model.event import EventSource
from gspn_framework_package.model.plan import Plan


class EventContext(NamedTuple):
    """The values that the function of an event may ask for by parameter name."""

    robot: str
    data: Mapping[str, Any]
    emit: Callable[..., None]
    is_cancelled: Cancellation


class EventFunction(PythonFunction):
    """A function or class that is the source of an event."""

    known = EventContext._fields
    role = "event function"


class EventHost(NamedTuple):
    """The callbacks of event functions, called on the functions' threads.

    :ivar observe: called with (robot, transition, whether the event holds, cause), when that
        changes; None instead of a bool for an instantaneous event.
    :ivar submit: called with a task; its id is "" if the function gave none.
    :ivar fault: called with (robot or "", message) when a function fails.
    :ivar data_of: called with a robot, or "" for the team; returns the data that the robot may read
        now.
    """

    observe: Callable[[str, str, Optional[bool], Mapping[str, Any]], None]
    submit: Callable[[Submit], None]
    fault: Callable[[str, str], None]
    data_of: Callable[[str], Mapping[str, Any]]


def _function_of(plan: Plan, source: EventSource) -> EventFunction:
    if source.kind is not None:
        return EventFunction(source.kind.function, source.kind.name, source.settings)
    return load_function(plan.folder, source.function, source.settings, EventFunction)


class EventFunctions:
    """Runs the functions of a plan's events.

    :param plan: a validated plan.
    :param host: the callbacks.
    :param topics: whether topics can be subscribed to: an event with a topic then needs no
        function.
    :raises PlanError: a function is missing or broken.

    All methods must be called on one thread.
    """

    def __init__(self, plan: Plan, host: EventHost, *, topics: bool) -> None:
        self._host = host
        self._events = {
            t: (source, _function_of(plan, source))
            for t, source in plan.events.items()
            if source.asks_function(topics)
        }
        tasks = set(plan.submissions)
        self.tasks: Tuple[str, ...] = tuple(t for t in self._events if t in tasks)
        """The transitions through which functions submit tasks."""
        self.interrupts: Tuple[str, ...] = tuple(t for t in self._events if t not in tasks)
        """The transitions that interrupt a robot when a function reports an event."""
        self._pool = WorkerPool("event")
        self._running: Dict[str, List[_Watcher]] = {}

    def watch(self, robot: str) -> None:
        """Start watching for the events of a robot, unless that was started before."""
        if robot not in self._running:
            self._begin(robot, self.interrupts)

    def watch_tasks(self) -> None:
        """Start watching for tasks."""
        if "" not in self._running:
            self._begin("", self.tasks)

    def ask_again(self, robot: str) -> None:
        """Immediately call the functions of a robot whose condition counts by level, since the
        robot has moved or has other data now; earlier results no longer count."""
        for watcher in self._running.get(robot, ()):
            if watcher.may_be_asked_again:
                watcher.ask_again()

    def round(self, robot: str, transition: str) -> int:
        """How often :meth:`ask_again` has called the function of an event; a result of an earlier
        round that the host has not processed yet is void."""
        watchers = self._running.get(robot, ())
        return next((w.round for w in watchers if w.transition == transition), 0)

    def forget(self, robot: str) -> None:
        """Stop watching for the events of a robot."""
        for watcher in self._running.pop(robot, ()):
            watcher.end()

    def close(self) -> None:
        """Stop all watching. A function that keeps running can no longer report anything."""
        for robot in list(self._running):
            self.forget(robot)

    def _begin(self, robot: str, transitions: Tuple[str, ...]) -> None:
        self._running[robot] = []
        for transition in transitions:
            watcher = _Watcher(self._host, robot, transition, *self._events[transition])
            self._running[robot].append(watcher)
            try:
                self._pool.submit(watcher.run)
            except RuntimeError as error:  # the system cannot create another thread
                self._host.fault(robot, "%s cannot be started: %s" % (watcher.what, error))


class _Watcher:
    """Runs one function of an event, for one robot or for tasks."""

    def __init__(
        self,
        host: EventHost,
        robot: str,
        transition: str,
        source: EventSource,
        function: EventFunction,
    ) -> None:
        self.cancellation = Cancellation()
        self.transition = transition
        self.may_be_asked_again = not source.edge and not function.asks_for("emit")
        self.what = "the function %s of the event '%s'" % (function.name, transition)
        self._host = host
        self._robot = robot
        self._every = source.every
        self._function = function
        self.round = 0
        self._lock = threading.Lock()
        self._asked_again = threading.Event()
        self._holds = False
        self._reported = ""

    def run(self) -> None:
        """Run the function, or call it repeatedly, until it is stopped."""
        if self._function.asks_for("emit"):
            try:
                self._call(_LiveData(lambda: self._host.data_of(self._robot)))
            except _FunctionFailed as error:
                self._report_fault("%s; it stopped watching" % error)
            return
        while not self.cancellation():
            self._asked_again.clear()
            try:
                self._take(self._call(self._host.data_of(self._robot)))
                self._reported = ""
            except _FunctionFailed as error:
                self._report_fault(str(error))
            self._asked_again.wait(self._every)

    def ask_again(self) -> None:
        """Call the function at once; a result of an earlier call is void."""
        with self._lock:
            self._holds = False
            self.round += 1
            self._asked_again.set()

    def end(self) -> None:
        """Stop calling the function."""
        self.cancellation.cancel()
        self._asked_again.set()

    def _call(self, data: Mapping[str, Any]) -> Any:
        """Call the function and return its result. :raises _FunctionFailed: it raised an
        exception."""
        try:
            return self._function.call(
                EventContext(self._robot, data, self._emit, self.cancellation)
            )
        except BaseException as error:  # anything a user's function raises, even SystemExit
            text = "%s: %s" % (type(error).__name__, error_text(error))
            raise _FunctionFailed(text) from None

    def _emit(self, **fields: Any) -> None:
        """The argument ``emit`` of the function. :raises DataError: the cause or the task cannot be
        stored."""
        if not self._robot:
            self._submit(fields)
        elif not self.cancellation():
            self._host.observe(self._robot, self.transition, None, _checked(fields))

    def _take(self, found: Any) -> None:
        """Report the function's result if it has changed.

        :raises _FunctionFailed: the result is invalid.
        """
        try:
            if self._robot:
                self._take_condition(found)
            elif found is not None:
                for task in found if isinstance(found, (list, tuple)) else (found,):
                    self._submit(task)
        except DataError as error:
            raise _FunctionFailed(str(error)) from None

    def _take_condition(self, found: Any) -> None:
        if isinstance(found, Mapping):
            holds, cause = True, _checked(found)
        # comparisons of numpy numbers return numpy's bool
        elif found is None or type(found).__name__ in ("bool", "bool_"):
            holds, cause = bool(found), NOTHING
        else:
            raise DataError("the function returned %.100r, not True, False or a dict" % (found,))
        with self._lock:
            if holds is self._holds or self._asked_again.is_set() or self.cancellation():
                return
            self._holds = holds
            self._host.observe(self._robot, self.transition, holds, cause)

    def _submit(self, task: Any) -> None:
        if not isinstance(task, Mapping):
            raise DataError("%.100r is not a task, because it is not a dict" % (task,))
        data = {name: value for name, value in task.items() if name != "id"}
        entry = make_submit(self.transition, task.get("id", ""), data)
        if not self.cancellation():
            self._host.submit(entry)

    def _report_fault(self, text: str) -> None:
        if text != self._reported and not self.cancellation():
            self._reported = text
            self._host.fault(self._robot, "%s failed: %s" % (self.what, text))


class _FunctionFailed(Exception):  # noqa: N818  # a failed function, not an error of the program
    """The function of an event failed."""


class _LiveData(Mapping[str, Any]):
    """A live view of data, for a function that runs for a long time."""

    def __init__(self, read: Callable[[], Mapping[str, Any]]) -> None:
        self._read = read

    def __getitem__(self, name: str) -> Any:
        return self._read()[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._read())

    def __len__(self) -> int:
        return len(self._read())


def _checked(cause: Mapping[str, Any]) -> Mapping[str, Any]:
    """Check the cause of an event. :raises DataError: it cannot be stored."""
    why = why_not_kept(dict(cause))
    if why:
        raise DataError("the cause %s" % why)
    return dict(cause)
