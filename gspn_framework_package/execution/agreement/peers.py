"""What a replica knows about the others: when it last heard them, and what they said."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Dict, FrozenSet, List, NamedTuple, Optional, Sequence, Set, Tuple

from gspn_framework_package.execution.agreement.messages import Envelope

FORGETTING_TIME = 60.0
"""Half-life, in seconds, of the memory of a silence from which a robot came back."""

MARGIN = 1.5
"""A silence counts only if it is this many times the longest silence from which the robot came
back."""

LARGEST_FACTOR = 4.0
"""A robot that is often silent is granted at most this many times the plan's limit."""


class Life(NamedTuple):
    """How many durable records a robot's log had in one of its incarnations, by its own report."""

    incarnation: int
    records: int


@dataclass
class Peer:
    """What is known of another robot."""

    heard: Optional[float] = None
    """When its last message arrived (s); None: not in this incarnation of ours."""
    gap: float = 0.0
    """The longest silence from which it came back (s); older ones count less."""
    length: int = 0
    """The length of its log."""
    log: str = ""
    """The id of its log."""
    at_work: Optional[float] = None
    """When it last reported, with the log whose votes count, that it takes part (s)."""
    welcomes: str = ""
    """The id of the log of *ours* that it knows."""
    silent: FrozenSet[str] = frozenset()
    """The robots that it does not hear."""
    active: bool = True
    """Whether it reports that it takes part: a robot that lost its log does not before it is
    admitted."""
    joining: bool = False
    """Whether it reports that it must be admitted first."""
    answered: float = -math.inf
    """When we last answered a hello of it (s); two waiting robots must not answer each other's
    answers."""
    met: bool = False
    """Whether it has sent a hello before."""
    cast_out: Dict[str, int] = field(default_factory=dict)
    """Robot -> slot of its last forced eviction, according to the peer's last hello."""
    life: Life = Life(-1, 0)
    before: Life = Life(-1, 0)
    """Its newest incarnation in that log, and the one before."""
    surprise: Optional[Life] = None
    """What our next hello should report: that we know its log as longer than it said, or (an empty
    life) that we know it under another log."""

    def note_life(self, message: Envelope) -> None:
        """Note the peer's log and its length."""
        now = Life(message.incarnation, message.records)
        if message.log != self.log:
            self.log, self.life, self.before = message.log, now, Life(-1, 0)
        elif now.incarnation > self.life.incarnation:
            self.before, self.life = self.life, now
        elif now.incarnation == self.life.incarnation:
            self.life = max(self.life, now)


@dataclass
class Peers:
    """All other robots that are known.

    :ivar known: robot -> id of its first log that we heard of; survives a restart.
    :ivar torn: robot -> after a power loss, the ids of its log and of the logs that this one
        continues; survives a restart.
    :ivar dead: the ids of logs that lost their ends; messages sent under them do not count.
    :ivar unsure: the robots for which we may have heard another process first, because we lost our
        log.
    :ivar since: when we began to listen (s).
    """

    known: Dict[str, str] = field(default_factory=dict)
    unsure: Set[str] = field(default_factory=set)
    torn: Dict[str, Tuple[str, ...]] = field(default_factory=dict)
    dead: Set[str] = field(default_factory=set)
    since: float = 0.0
    all: Dict[str, Peer] = field(default_factory=dict)

    def get(self, robot: str) -> Peer:
        """What is known of a robot; an empty :class:`Peer` if it was never heard."""
        return self.all.get(robot) or Peer()

    def hear(self, robot: str, now: float) -> Peer:
        """Note that a message of the robot arrived."""
        peer = self.all.get(robot)
        if peer is None:
            peer = self.all[robot] = Peer()
        if peer.heard is not None:
            silence = now - max(peer.heard, self.since)
            peer.gap = max(silence, peer.gap * 0.5 ** (silence / FORGETTING_TIME))
        peer.heard = now
        return peer

    def listen_anew(self, now: float) -> None:
        """Restart all measurements of silence, because we were not listening (suspended or
        restarted)."""
        self.since = now

    def silence(self, robot: str, now: float) -> float:
        """Seconds since the robot was last heard, counting only time in which we listened."""
        heard = self.get(robot).heard
        return now - (self.since if heard is None else max(heard, self.since))

    def near(self, members: Sequence[str], me: str, within: float, now: float) -> List[str]:
        """The members heard within a time (s), including us."""
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
        """The robots that report a robot as silent."""
        return {name for name, peer in self.all.items() if robot in peer.silent}
