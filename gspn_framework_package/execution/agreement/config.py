"""A replica's configuration: its identity, its plan, and the times and sizes of the protocol.

Immutable, and calls nothing. All parts of a replica share one :class:`Config`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Optional

from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.model.plan import Plan, Synchronisation, Timing

SMALL_TEAM = 8
"""Up to this many replicas, hellos are answered at once and the pace is not adjusted."""


class Pace(NamedTuple):
    """Times of the protocol (s). Safety does not depend on them."""

    heartbeat: float = 0.5
    """Interval of the hellos."""
    greeting: float = 0.2
    """The same, before the replica takes part."""
    retry: float = 0.1
    """Time after which an unanswered message is sent again; it grows each time, up to 1 s."""
    takeover: float = 0.3
    """How long a proposal waits for the leader before its robot starts its own attempt."""
    gather: float = 0.0
    """How long the leader gathers proposals between two slots."""
    backoff: float = 0.02
    """How long a proposer gives way after a defeat; doubled at each consecutive defeat."""
    spread: float = 1.0
    """Number of round trips over which robots spread their starts when several want the next slot
    in partial synchronisation."""

    def for_team(self, size: int, timing: Timing) -> Pace:
        """The pace for a team of a given size. Broadcasts are less frequent in large teams, so
        traffic per replica stays constant. The leader gets more time, because it has more robots to
        ask, and otherwise all of them would try to take over at once. For each robot beyond a small
        team, proposals are gathered for one more millisecond, since the messages of a slot cost the
        same however much it contains.

        :param timing: the timing of the plan: heartbeats must be frequent enough that no running
            robot exceeds its time limits for silence.
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
    """Sizes of the protocol. Safety does not depend on them; tests make them small."""

    batch: int = 256
    """Maximum number of items in a slot."""
    kept: int = 2000
    """Number of slots kept in memory; a robot that is further behind gets a snapshot."""
    chunk: int = 200
    """Number of slots sent at a time."""
    snapshot_every: int = 1000
    """Number of slots between two snapshots in the log; a restart reads from the last one."""


@dataclass
class Config:
    """A replica's configuration."""

    plan: Plan
    name: str
    """Name of our robot or witness."""
    run: str
    """Messages of other runs are ignored."""
    tag: str
    """Identifier of run and plan that every message carries."""
    pace: Pace
    limits: ProtocolLimits
    place: str
    """The place where we start when we first join; "" for the plan's choice."""
    trusted: bool
    """Whether the end of our log is intact."""
    damage: str
    """What was damaged in it; "" for nothing."""
    partial: bool
    """Whether synchronisation is partial."""
    witness: bool
    """Whether we are a witness: vote, but have no token."""
    newcomer: bool
    """Whether this robot joined the team after the plan had started."""
    is_small: bool
    """Whether the team is small enough for all robots to inform each other about each slot."""
    first: str
    """The leader before the first ballot; "" if we cannot know it."""
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
        """Derive the configuration from the parameters of
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
