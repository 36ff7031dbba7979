"""What a replica knows about the others: when it last heard them, and what they said."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Dict, FrozenSet, List, NamedTuple, Optional, Sequence, Set, Tuple

from gspn_framework_package.execution.agreement.messages import Envelope

FORGETTING_TIME = 60.0
"""Seconds after which half of a silence that a robot came back from is forgotten."""

MARGIN = 1.5
"""A silence has to be this many times longer than the longest that the robot came back from."""

LARGEST_FACTOR = 4.0
"""At most this many times the plan's limit is granted to a robot that is often silent."""


class Life(NamedTuple):
    """How many durable records the log of a robot had in one of its incarnations, as far as it
    said."""

    incarnation: int
    records: int


@dataclass
class Peer:
    """What is known of another robot."""

    heard: Optional[float] = None
    """When a message of it came in (s); None: never in this life of ours."""
    gap: float = 0.0
    """The longest silence that it came back from (s); older ones count less."""
    length: int = 0
    """How long its log was."""
    log: str = ""
    """The id of the log that it speaks for."""
    at_work: Optional[float] = None
    """When it last said, with the log whose votes count, that it takes part (s)."""
    welcomes: str = ""
    """The id of the log of *ours* that it knows."""
    silent: FrozenSet[str] = frozenset()
    """Whom it does not hear."""
    active: bool = True
    """Whether it says that it takes part: a robot that lost its log does not until it is let
    in."""
    joining: bool = False
    """Whether it says that it has to be let in first."""
    answered: float = -math.inf
    """When we answered a hello of it last (s); two that wait must not answer each other's
    answers."""
    met: bool = False
    """It said hello before."""
    cast_out: Dict[str, int] = field(default_factory=dict)
    """Robot -> slot of its last eviction by force, as its log had it when it last said hello."""
    life: Life = Life(-1, 0)
    before: Life = Life(-1, 0)
    """Its newest incarnation, and the one before, in that log."""
    surprise: Optional[Life] = None
    """What our next hello should say: that we know its log as longer than it said, or (an empty
    life) that we know it under another log."""

    def note_life(self, message: Envelope) -> None:
        """Note the log that it speaks for, and its length."""
        now = Life(message.incarnation, message.records)
        if message.log != self.log:
            self.log, self.life, self.before = message.log, now, Life(-1, 0)
        elif now.incarnation > self.life.incarnation:
            self.before, self.life = self.life, now
        elif now.incarnation == self.life.incarnation:
            self.life = max(self.life, now)


@dataclass
class Peers:
    """All others that were heard of.

    :ivar known: robot -> id of the first log of it that we heard of; survives a restart.
    :ivar torn: robot -> the ids of its log, and of those that this one goes on from, after a loss
        of power; survives a restart.
    :ivar dead: the ids of logs that lost their ends: what was sent under them does not count.
    :ivar unsure: the robots of which another process may have been heard first, because we lost
        what we knew.
    :ivar since: when we began to listen.
    """

    known: Dict[str, str] = field(default_factory=dict)
    unsure: Set[str] = field(default_factory=set)
    torn: Dict[str, Tuple[str, ...]] = field(default_factory=dict)
    dead: Set[str] = field(default_factory=set)
    since: float = 0.0
    all: Dict[str, Peer] = field(default_factory=dict)

    def get(self, robot: str) -> Peer:
        """What is known of a robot; nothing of one that was not heard."""
        return self.all.get(robot) or Peer()

    def hear(self, robot: str, now: float) -> Peer:
        """Note that a message of the robot came in."""
        peer = self.all.setdefault(robot, Peer())
        if peer.heard is not None:
            silence = now - max(peer.heard, self.since)
            peer.gap = max(silence, peer.gap * 0.5 ** (silence / FORGETTING_TIME))
        peer.heard = now
        return peer

    def listen_anew(self, now: float) -> None:
        """We were not listening (suspended, restarted): no silence counts so far."""
        self.since = now

    def silence(self, robot: str, now: float) -> float:
        """Seconds for which the robot has not been heard while we listened."""
        heard = self.get(robot).heard
        return now - (self.since if heard is None else max(heard, self.since))

    def near(self, members: Sequence[str], me: str, within: float, now: float) -> List[str]:
        """The members that were heard within that time, ourselves included."""
        return [
            m
            for m in members
            if m == me or (self.get(m).heard is not None and self.silence(m, now) <= within)
        ]

    def silent(self, members: Sequence[str], me: str, limit: float, now: float) -> Set[str]:
        """The members that were silent for longer than ``limit``. A robot that never came up gets
        three times as long; one that recently came back from longer silences (a busy machine, a
        bad link) gets longer than those, up to a bound."""
        return {m for m in members if m != me and self.silence(m, now) > self._limit(m, limit)}

    def _limit(self, robot: str, limit: float) -> float:
        peer = self.get(robot)
        if peer.heard is None:
            return 3 * limit
        return min(LARGEST_FACTOR * limit, max(limit, MARGIN * peer.gap))

    def accusers(self, robot: str) -> Set[str]:
        """The robots that say that the robot is silent."""
        return {name for name, peer in self.all.items() if robot in peer.silent}
