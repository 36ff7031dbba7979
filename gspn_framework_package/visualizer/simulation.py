"""SIMULATE: the offline token game, with every tool of thesis Figure 5.4, and undo."""

from __future__ import annotations

import threading
from collections import deque
from typing import Any, Deque, Dict, List, NamedTuple, Optional

from gspn_framework_package.execution.simulator import SimulatedFiring, Simulator
from gspn_framework_package.model.errors import RefusedError, UsageError
from gspn_framework_package.model.net import Marking, Net
from gspn_framework_package.visualizer.activity import (
    Activity,
    Handler,
    RequestFields,
    text_field,
    whole_field,
)
from gspn_framework_package.visualizer.board import Board, Event, fire_event, mark_event
from gspn_framework_package.visualizer.hub import Hub

STEPS_AT_ONCE = 10_000
"""Largest number of steps in one command."""

STEPS_BACK = 20_000
"""Number of steps that can be undone."""

MOST_TOKENS = 10**9
"""Largest number of tokens in a place of a marking requested by the page."""


class _Past(NamedTuple):
    """``marking`` and ``time`` before ``transition`` (-1: a reset or a clear) fired. ``counts``:
    the firing counts before a reset, of the transitions that had fired."""

    transition: int
    marking: Marking
    time: float
    counts: Optional[Dict[int, int]] = None


class OfflineSimulation(Activity):
    """The offline simulation of a net. All viewers share it."""

    mode = "SIMULATE"

    def __init__(self, net: Net) -> None:
        super().__init__()
        self.net = net
        self._lock = threading.Lock()
        self._simulator = Simulator(net)
        self._time = 0.0
        self._past: Deque[_Past] = deque(maxlen=STEPS_BACK)
        self.commands = {
            "step": self._locked(self._step),
            "fire": self._locked(self._fire),
            "back": self._locked(self._back),
            "reset": self._locked(self._reset),
            "clear": self._locked(self._clear),
            "move": self._locked(self._move),
            "probabilities": self._locked(self._set_probabilities),
        }

    def begin(self, hub: Hub) -> None:
        """Start at the initial marking."""
        self._hub = hub
        board = Board(
            len(self.net.transitions),
            self._simulator.marking,
            self._simulator.enabled.now,
            {"running": False},
        )
        hub.restart(self.mode, board, {"probabilities": {}})
        hub.set_latest("choices", self._choices())

    def _locked(self, handler: Handler) -> Handler:
        def run(fields: RequestFields) -> Dict[str, Any]:
            with self._lock:
                return handler(fields)

        return run

    # -- commands ----------------------------------------------------------------------------------

    def _step(self, fields: RequestFields) -> Dict[str, Any]:
        steps = whole_field(fields, "steps", 1, 1, STEPS_AT_ONCE)
        events: List[Event] = []
        while len(events) < steps:
            before = _Past(-1, self._simulator.marking, self._time)
            firing = self._simulator.step()
            if firing is None:
                break
            events.append(self._fired(firing, before))
        self._publish(*events)
        return {"fired": len(events), "dead": len(events) < steps}

    def _fire(self, fields: RequestFields) -> Dict[str, Any]:
        t = self.net.transition_number(text_field(fields, "transition"))
        precedence = fields.get("any_priority") is not True
        waits = t not in self._simulator.enabled.now
        if precedence and waits and self.net.is_enabled(self._simulator.marking, t):
            raise RefusedError(
                "immediate transitions of higher priority go first",
                element="transition '%s'" % self.net.transitions[t].name,
            )
        before = _Past(t, self._simulator.marking, self._time)
        self._publish(self._fired(self._simulator.fire(t), before))
        return {"fired": 1}

    def _fired(self, firing: SimulatedFiring, before: _Past) -> Event:
        self._time += firing.delay
        t = firing.transition
        self._past.append(before._replace(transition=t))
        return self._now(fire_event(self.net, t, self._simulator.change))

    def _back(self, fields: RequestFields) -> Dict[str, Any]:
        steps = whole_field(fields, "steps", 1, 1, STEPS_AT_ONCE)
        events: List[Event] = []
        while self._past and len(events) < steps:
            past = self._past.pop()
            self._simulator.move_to(past.marking)
            self._time = past.time
            if past.transition < 0:
                event = {**self._whole("step back"), "back": True}
                if past.counts is not None:
                    event["counts"] = [
                        past.counts.get(t, 0) for t in range(len(self.net.transitions))
                    ]
                events.append(event)
                continue
            undone = fire_event(self.net, past.transition, self._simulator.change, back=True)
            events.append(self._now(undone))
        if not events:
            raise RefusedError("there is no step to undo")
        self._publish(*events)
        return {"back": len(events)}

    def _reset(self, fields: RequestFields) -> Dict[str, Any]:
        counts = {t: count for t, count in enumerate(self._hub.board().counts) if count}
        self._past.append(_Past(-1, self._simulator.marking, self._time, counts))
        self._time = 0.0
        self._simulator.move_to(self.net.initial_marking)
        self._publish({**self._whole("reset"), "restart": True})
        return {}

    def _clear(self, fields: RequestFields) -> Dict[str, Any]:
        """Remove every token from the net ("clear network")."""
        self._past.append(_Past(-1, self._simulator.marking, self._time))
        self._simulator.move_to((0,) * len(self.net.places))
        self._publish(self._whole("cleared"))
        return {}

    def _move(self, fields: RequestFields) -> Dict[str, Any]:
        """Change to another marking."""
        marking = fields.get("marking")
        count = len(self.net.places)
        if (
            not isinstance(marking, list)
            or len(marking) != count
            or not all(type(n) is int and 0 <= n <= MOST_TOKENS for n in marking)
        ):
            raise UsageError(
                "'marking' must be a list of the token counts of all %d places" % count
            )
        self._past.append(_Past(-1, self._simulator.marking, self._time))
        self._simulator.move_to(marking)
        self._publish(self._whole("another marking"))
        return {}

    def _set_probabilities(self, fields: RequestFields) -> Dict[str, Any]:
        given = fields.get("probabilities")
        if not isinstance(given, dict):
            raise UsageError("'probabilities' must map transitions to numbers")
        probabilities = {}
        for name, value in given.items():
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                raise UsageError("the firing probability of '%s' is not a number" % name[:80])
            try:
                probabilities[self.net.transition_number(name)] = float(value)
            except OverflowError:
                raise UsageError(
                    "the firing probability of '%s' is too large" % name[:80]
                ) from None
        self._simulator.set_probabilities(probabilities)
        self._hub.change_info(probabilities={str(t): p for t, p in probabilities.items()})
        self._hub.set_latest("choices", self._choices())
        return {}

    # -- events for the page -----------------------------------------------------------------------

    def _whole(self, why: str) -> Event:
        return self._now(mark_event(self._simulator.enabled, why))

    def _now(self, event: Event) -> Event:
        return {**event, "t": round(self._time, 4)}

    def _publish(self, *events: Event) -> None:
        if events:
            self._hub.publish(*events)
            self._hub.set_latest("choices", self._choices())

    def _choices(self) -> List[List[float]]:
        """The transitions that may fire next, with their probabilities."""
        return [[c.transition, round(c.probability, 6)] for c in self._simulator.choices()]
