"""Breakpoints: places and transitions at which a robot stops until somebody resumes it.

A robot stops before its action in a *place* starts, and before it asks for a *transition* (or its
event fires it): its own node, or the standalone executor, then orders a ``Pause`` of this robot,
and a ``Resume`` releases it. The log thus records everything, and the token game needs no
breakpoints. They are stored in ``breakpoints.json`` next to the plan.
"""

from __future__ import annotations

import json
import os
import threading
from typing import Any, Dict, Hashable, List, NamedTuple, Optional, Tuple

from gspn_framework_package.formats.json_file import read_json
from gspn_framework_package.formats.source import Stamp, file_stamp, write_bytes
from gspn_framework_package.model.errors import InputError, PlanError, UsageError
from gspn_framework_package.model.plan import Plan

FILE_NAME = "breakpoints.json"

_WRITING = threading.Lock()  # the robots of one process share the file


class Breakpoints(NamedTuple):
    """The names of places and transitions, each sorted."""

    places: Tuple[str, ...] = ()
    transitions: Tuple[str, ...] = ()

    @property
    def in_words(self) -> str:
        """The names, for people."""
        return ", ".join((*self.places, *self.transitions)) or "no breakpoint"

    def to_json(self) -> Dict[str, List[str]]:
        """The breakpoints as a JSON object."""
        return {"places": list(self.places), "transitions": list(self.transitions)}

    @classmethod
    def from_json(cls, data: Any, plan: Plan, file: Optional[str] = None) -> Breakpoints:
        """The breakpoints in a JSON object. :raises PlanError: they do not fit the plan."""
        if not isinstance(data, dict) or not set(data) <= set(cls._fields):
            raise PlanError(
                "breakpoints are a JSON object with 'places' and 'transitions'", file=file
            )
        lists = [data.get(key, []) for key in cls._fields]
        for names in lists:
            if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
                raise PlanError("breakpoints are lists of names", file=file)
        places, transitions = (tuple(sorted(set(names))) for names in lists)
        for name in (*places, *transitions):
            kind = "place" if name in places else "transition"
            why = why_no_breakpoint(plan, name, kind)
            if why:
                raise PlanError(why, file=file, element="%s '%s'" % (kind, name[:80]))
        return cls(places, transitions)

    @classmethod
    def of_names(cls, names: List[str], plan: Plan) -> Breakpoints:
        """The breakpoints at places and transitions of these names. :raises PlanError: a robot
        cannot stop at one of them."""
        known = plan.net.place_index
        return cls.from_json(
            {
                "places": [name for name in names if name in known],
                "transitions": [name for name in names if name not in known],
            },
            plan,
        )

    def stops_result(self, plan: Plan, place: str, result: str) -> bool:
        """Whether a robot that is done in ``place`` stops. If its action names no transition, it
        stops if any possible next transition has a breakpoint."""
        if not self.transitions:
            return False
        if result not in ("", "None"):
            return result in self.transitions
        leaving = plan.net.consumers[plan.net.place_number(place)]
        names = (plan.net.transitions[t].name for t in leaving)
        return any(name in self.transitions and name not in plan.events for name in names)


def read_names(text: str) -> List[str]:
    """The names in a JSON list. :raises UsageError: the text is not such a list."""
    try:
        names = json.loads(text)
    except (ValueError, RecursionError):
        names = None
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise UsageError("breakpoints are a JSON list of names, not %.100r" % text)
    return names


def why_no_breakpoint(plan: Plan, name: str, kind: str) -> str:
    """Why no robot can stop at a place or transition; "" if it can."""
    net = plan.net
    if kind == "place":
        if name not in net.place_index:
            return "the net has no place or transition of this name"
        if name in plan.resource_places:
            return "no robot is ever in a resource place"
        before = [name]
        what = "the place has no action, so a robot leaves at once"
    else:
        t = net.transition_index.get(name)
        if t is None:
            return "the net has no place or transition of this name"
        before = [net.places[p].name for p, _ in net.inputs[t]]
        before = [place for place in before if place not in plan.resource_places]
        if not before:
            return "the transition moves no robot"
        what = "no action precedes it, so a robot fires it at once"
    own = [dict(robot.actions) for robot in plan.robots]
    if any(actions.get(p) is not None for actions in (plan.actions, *own) for p in before):
        return ""
    return what + "; stop in the place before"


class RobotBreakpoints:
    """The breakpoints of one robot.

    :ivar breakpoints: its breakpoints; may be replaced at any time.
    """

    def __init__(self) -> None:
        self.breakpoints = Breakpoints()
        self._goal: Optional[Hashable] = None
        self._seen = False
        self._passed: Optional[Hashable] = None

    def may_start(self, visit: Hashable, place: str, attempt: int, paused: bool) -> str:
        """Whether the robot's action may start: "yes", "no" (it stops), or "pause" (it stops, and
        the caller must order a pause).

        :param visit: anything that distinguishes this visit from others.
        :param attempt: the number of the attempt. A later attempt stops only if the robot is
            paused, because its node was restarted while it was stopped.
        :param paused: whether the robot is paused, according to the log.
        """
        if visit == self._passed:
            return "yes"
        if visit != self._goal:
            if place not in self.breakpoints.places or (attempt > 1 and not paused):
                self._passed = visit
                return "yes"
            self._goal, self._seen = visit, paused
            return "no" if paused else "pause"
        self._seen = self._seen or paused
        if paused or not self._seen:
            return "no"
        self._passed = visit
        return "yes"


class BreakpointFile:
    """The file with the breakpoints of a plan; without a file, they are only kept in memory.

    :ivar breakpoints: the last breakpoints read or written.
    """

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        folder = plan.folder or (os.path.dirname(os.path.abspath(plan.file)) if plan.file else "")
        self.path = os.path.join(folder, FILE_NAME) if folder else ""
        self._stamp: Optional[Stamp] = None
        self.breakpoints = Breakpoints()

    def follow(self, plan: Plan) -> None:
        """Switch to another plan, keeping the breakpoints that fit it; the file is unchanged."""
        self._plan = plan
        places, transitions = self.breakpoints
        self.breakpoints = Breakpoints(
            tuple(name for name in places if not why_no_breakpoint(plan, name, "place")),
            tuple(name for name in transitions if not why_no_breakpoint(plan, name, "transition")),
        )

    def changed(self) -> bool:
        """Read the file if it has changed; return whether it had.

        :raises InputError: the file does not fit the plan. The breakpoints then stay as they were,
            and the file is not read again until it changes.
        """
        stamp = self._look()
        if stamp == self._stamp:
            return False
        self._stamp = stamp
        before = self.breakpoints
        if stamp is None:
            self.breakpoints = Breakpoints()
        else:
            self.breakpoints = Breakpoints.from_json(read_json(self.path), self._plan, self.path)
        return self.breakpoints != before

    def write(self, breakpoints: Breakpoints) -> None:
        """Store the breakpoints; the file is removed if there are none.

        :raises InputError: the file cannot be written. The breakpoints still apply in this process.
        """
        self.breakpoints = breakpoints
        if self.path:
            with _WRITING:
                self._write(breakpoints)

    def _write(self, breakpoints: Breakpoints) -> None:
        if not any(breakpoints):
            try:
                os.remove(self.path)
            except FileNotFoundError:
                pass
            except OSError as error:
                raise InputError("cannot remove it: %s" % error.strerror, file=self.path) from None
        else:
            write_bytes(self.path, (json.dumps(breakpoints.to_json(), indent=2) + "\n").encode())
        self._stamp = self._look()

    def _look(self) -> Optional[Stamp]:
        return file_stamp(self.path) if self.path else None
