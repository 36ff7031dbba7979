"""Watches runs over Zenoh: firings, and the activity of every robot."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any, Callable, Dict, NamedTuple

from gspn_framework_package.team.message_filter import LARGEST_MESSAGE, json_objects
from gspn_framework_package.team.zenoh_operator import ZenohOperator
from gspn_framework_package.team.zenoh_session import (
    TeamAccess,
    key_of,
    names_in_key,
    zenoh_library,
)

if TYPE_CHECKING:
    import zenoh


class Sights(NamedTuple):
    """Callbacks of a watch, called on Zenoh's threads with the name of the sending robot."""

    fired: Callable[[str, Dict[str, Any]], None]
    """Receives a firing; its fields are those of
    :func:`~gspn_framework_package.execution.team_messages.firing_fields`."""
    activity: Callable[[str, Dict[str, Any]], None]
    """Receives the activity of a robot."""


class ZenohWatch:
    """Watches one run, or all, and asks its robots.

    A firing is published by the robot that decided it, but may concern another robot.

    :param access: how to reach the team.
    :param run: the name of the run; "" for all runs.
    :param sights: the callbacks.
    :raises GspnError: no session with the team can be opened.

    :ivar operator: queries the robots, in the same session.
    """

    def __init__(self, access: TeamAccess, run: str, sights: Sights) -> None:
        self._sights = sights
        self._zenoh = zenoh_library()
        self.operator = ZenohOperator(access)
        self._session = self.operator.session
        self._run = run or "*"
        self._declared = [
            self._session.declare_subscriber(key_of(self._run, "*", "fired"), self._on_fired),
            self._session.declare_subscriber(key_of(self._run, "*", "activity"), self._on_activity),
        ]

    def ask_activity(self) -> None:
        """Have every reachable robot report its activity again; the answers arrive like any other
        activity. Returns when all have answered, at the latest after a second.
        """
        all_in = threading.Event()
        self._session.get(
            key_of(self._run, "*", "activity"),
            self._zenoh.handlers.Callback(self._on_reply, all_in.set),
            target=self._zenoh.QueryTarget.ALL,
            consolidation=self._zenoh.ConsolidationMode.NONE,
            timeout=1.0,
        )
        all_in.wait(1.0)

    def close(self) -> None:
        """End the session."""
        self.operator.close()

    def _on_fired(self, sample: zenoh.Sample) -> None:
        self._pass_on(sample, self._sights.fired)

    def _on_activity(self, sample: zenoh.Sample) -> None:
        self._pass_on(sample, self._sights.activity)

    def _on_reply(self, reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            self._pass_on(reply.ok, self._sights.activity)

    def _pass_on(self, sample: zenoh.Sample, to: Callable[[str, Dict[str, Any]], None]) -> None:
        run, robot = names_in_key(str(sample.key_expr))[:2]
        if len(sample.payload) > LARGEST_MESSAGE:
            return
        for fields in json_objects(bytes(sample.payload)):
            if fields.setdefault("run", run) == run:
                to(robot, fields)
