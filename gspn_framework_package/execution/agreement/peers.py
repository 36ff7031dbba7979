"""What a replica knows of the others: when it heard them last, and what they said."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Dict, FrozenSet, List, Optional, Sequence, Set


@dataclass
class Peer:
    """What is known of another robot."""

    heard: Optional[float] = None
    """When a message of it came in (s); None: never in this life of ours."""
    length: int = 0
    """How long its log was."""
    log: str = ""
    """The id of its log."""
    welcomes: str = ""
    """The id of the log of *ours* that it knows."""
    silent: FrozenSet[str] = frozenset()
    """Whom it does not hear."""
    active: bool = True
    """Whether it takes part, as far as it told: one that lost its log does not until it is let in."""
    cast_out: FrozenSet[str] = frozenset()
    """Whom it takes for evicted by force."""


@dataclass
class Peers:
    """All others that were heard of.

    :ivar known: robot -> id of the first log of it that we heard of; survives a restart.
    :ivar since: when we began to listen.
    """

    known: Dict[str, str] = field(default_factory=dict)
    since: float = 0.0
    all: Dict[str, Peer] = field(default_factory=dict)

    def get(self, robot: str) -> Peer:
        """What is known of a robot."""
        peer = self.all.get(robot)
        if peer is None:
            peer = self.all[robot] = Peer()
        return peer

    def hear(self, robot: str, now: float) -> Peer:
        """Note that a message of the robot came in."""
        peer = self.get(robot)
        peer.heard = now
        return peer

    def listen_anew(self, now: float) -> None:
        """We were not listening (suspended, restarted): nobody's silence counts so far."""
        self.since = now

    def silence(self, robot: str, now: float) -> float:
        """Seconds for which the robot has not been heard while we listened."""
        heard = self.get(robot).heard
        return now - (self.since if heard is None else max(heard, self.since))

    def near(self, members: Sequence[str], me: str, within: float, now: float) -> List[str]:
        """The members that were heard within that time, ourselves included."""
        return [m for m in members if m == me or (self.get(m).heard is not None and self.silence(m, now) <= within)]

    def silent(self, members: Sequence[str], me: str, limit: float, now: float) -> Set[str]:
        """The members that were silent for longer than ``limit``; one that never came up, for three
        times as long."""
        return {
            m for m in members if m != me and self.silence(m, now) > (3 * limit if self.get(m).heard is None else limit)
        }

    def accusers(self, robot: str) -> Set[str]:
        """Who says that the robot is silent."""
        return {name for name, peer in self.all.items() if robot in peer.silent}
