"""What a replica is told once and keeps: who it is, its plan, the times and sizes of the protocol.

Owns nothing that changes, calls nothing. Every part of a replica reads the same :class:`Config`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Optional

from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.model.plan import Plan, Synchronisation, Timing

SMALL_TEAM = 8
"""Up to that many replicas, greetings are answered at once and the pace is the plain one."""


class Pace(NamedTuple):
    """Times of the protocol (s). None matters for safety."""

    heartbeat: float = 0.5
    """How often a replica says that it is there."""
    greeting: float = 0.2
    """How often it does until it takes part."""
    retry: float = 0.1
    """After which a message without an answer is sent again (longer and longer, up to 1 s)."""
    takeover: float = 0.3
    """For which a proposal waits for the leader before its robot proposes itself."""
    gather: float = 0.0
    """For which the leader lets proposals come in between two slots."""
    backoff: float = 0.02
    """For which a proposer gives way after its first defeat; doubled at each one in a row."""
    spread: float = 1.0
    """Over how many round trips those who want the next slot of partial synchronisation begin."""

    def for_team(self, size: int, timing: Timing) -> Pace:
        """The pace for a team of that size. Broadcasts are less frequent in large teams, so that
        the traffic per replica stays constant; and a leader that has so many to ask is given time,
        or all want to take over from it at once. One millisecond for each robot that a small team
        would not have is for gathering proposals: each slot costs messages to and from everybody,
        however much is in it.

        :param timing: of the plan: nobody shall seem silent for as long as it says only because
            heartbeats are so rare.
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


class Limits(NamedTuple):
    """Sizes of the protocol. None matters for safety; tests make them small."""

    batch: int = 256
    """The most items that one slot takes."""
    kept: int = 2000
    """Slots that are kept in memory; who is further behind gets a snapshot."""
    chunk: int = 200
    """Slots sent at a time."""
    snapshot_every: int = 1000
    """Slots after which the log gets a snapshot, where a restart begins to read."""


@dataclass
class Config:
    """What a replica is told once."""

    plan: Plan
    name: str
    """Our robot, or witness."""
    run: str
    """Messages of other runs are ignored."""
    tag: str
    """Run and plan, as every message carries them."""
    pace: Pace
    limits: Limits
    place: str
    """Where we come in when we join for the first time; "": as the plan has it."""
    trusted: bool
    """The end of our log is there."""
    partial: bool
    """Partial synchronisation."""
    witness: bool
    """We vote and have no token."""
    newcomer: bool
    """We are not in the first team of the plan."""
    is_small: bool
    """The team is so small that everybody may tell everybody something about each slot."""
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
        limits: Optional[Limits],
        trusted: bool,
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
            limits=limits or Limits(),
            place=place,
            trusted=trusted,
            partial=plan.synchronisation is Synchronisation.PARTIAL,
            witness=robot in plan.witness,
            newcomer=newcomer,
            is_small=len(team) <= SMALL_TEAM,
            first="" if newcomer or not team else team[0],
            game=TokenGame(plan),
        )
