"""A replica's configuration: who it is, its plan, the times and sizes of the protocol.

Owns nothing that changes, calls nothing. Every part of a replica reads the same :class:`Config`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Optional

from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.model.plan import Plan, Synchronisation, Timing

SMALL_TEAM = 8
"""Up to this many replicas, greetings are answered at once and the pace stays as it is."""


class Pace(NamedTuple):
    """Times of the protocol (s). None matters for safety."""

    heartbeat: float = 0.5
    """Interval of the hellos."""
    greeting: float = 0.2
    """The same, until the replica takes part."""
    retry: float = 0.1
    """After this time an unanswered message is sent again (longer each time, up to 1 s)."""
    takeover: float = 0.3
    """How long a proposal waits for the leader before its robot proposes by itself."""
    gather: float = 0.0
    """How long the leader gathers proposals between two slots."""
    backoff: float = 0.02
    """How long a proposer gives way after its first defeat; doubled at each one in a row."""
    spread: float = 1.0
    """Round trips over which robots that want the next slot of partial synchronisation start."""

    def for_team(self, size: int, timing: Timing) -> Pace:
        """The pace for a team of that size. Broadcasts are less frequent in large teams, so
        traffic per replica stays constant. The leader gets more time, because it has more robots
        to ask, and otherwise all would try to take over at once. For each robot beyond a small
        team, proposals are gathered for one more millisecond: each slot costs messages to and from
        everybody, however much is in it.

        :param timing: of the plan: heartbeats must not be so rare that a robot seems silent for
            the time that it names.
        """
        slower = max(1.0, size / SMALL_TEAM)
        silence = min(
            [t for t in (timing.evict_after, timing.fence_after) if t > 0], default=math.inf
        )
        return self._replace(
            heartbeat=max(self.heartbeat, min(self.heartbeat * slower, silence / 4)),
            greeting=self.greeting * slower,
            retry=self.retry * slower,
            takeover=self.takeover * slower,
            gather=self.gather + 0.001 * max(0, size - SMALL_TEAM),
            spread=self.spread + max(0, size - SMALL_TEAM) / 3,
        )


class ProtocolLimits(NamedTuple):
    """Sizes of the protocol. None matters for safety; tests make them small."""

    batch: int = 256
    """The most items that one slot takes."""
    kept: int = 2000
    """Slots that are kept in memory; a robot that is further behind gets a snapshot."""
    chunk: int = 200
    """Slots sent at a time."""
    snapshot_every: int = 1000
    """Slots after which the log gets a snapshot; a restart reads from there."""


@dataclass
class Config:
    """A replica's configuration."""

    plan: Plan
    name: str
    """Our robot, or witness."""
    run: str
    """Messages of other runs are ignored."""
    tag: str
    """Run and plan, as every message carries them."""
    pace: Pace
    limits: ProtocolLimits
    place: str
    """Where we start when we join for the first time; "": as the plan says."""
    trusted: bool
    """The end of our log is intact."""
    damage: str
    """What was damaged in it; "" for nothing."""
    partial: bool
    """Partial synchronisation."""
    witness: bool
    """We vote and have no token."""
    newcomer: bool
    """We are not in the first team of the plan."""
    is_small: bool
    """The team is small enough for everybody to inform everybody about each slot."""
    first: str
    """Who leads before the first ballot; "" where we cannot know."""
    game: TokenGame
    """The rules of the plan."""

    @classmethod
    def make(
        cls,
        plan: Plan,
        robot: str,
        run: str,
        *,
        joining: bool,
        place: str,
        pace: Optional[Pace],
        limits: Optional[ProtocolLimits],
        trusted: bool,
        damage: str,
    ) -> Config:
        """Work out what follows from the parameters of
        :class:`~gspn_framework_package.execution.agreement.replica.Replica`."""
        team = [r.name for r in plan.robots] + list(plan.witness)
        newcomer = joining or robot not in team
        return cls(
            plan=plan,
            name=robot,
            run=run,
            tag="%s|%s" % (run, plan.hash()[:12]),
            pace=(pace or Pace()).for_team(len(team), plan.timing),
            limits=limits or ProtocolLimits(),
            place=place,
            trusted=trusted,
            damage=damage,
            partial=plan.synchronisation is Synchronisation.PARTIAL,
            witness=robot in plan.witness,
            newcomer=newcomer,
            is_small=len(team) <= SMALL_TEAM,
            first="" if newcomer or not team else team[0],
            game=TokenGame(plan),
        )
