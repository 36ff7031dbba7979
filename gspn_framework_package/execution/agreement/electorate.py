"""Whose votes count: members, quorums, valid logs, and what may go into the log.

Answers questions about the state for all parts. Owns nothing, changes nothing, and calls no other
part.
"""

from __future__ import annotations

from typing import Collection, List, Mapping, Optional, Sequence, Set, Tuple

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement.config import Config
from gspn_framework_package.execution.agreement.messages import Envelope, Torn
from gspn_framework_package.execution.agreement.quorum import is_quorum
from gspn_framework_package.execution.agreement.state import ReplicaState
from gspn_framework_package.execution.ledger import Item, Ledger
from gspn_framework_package.execution.team_state import RobotState

NAMESAKE_CONTACTS = 4
"""Number of heartbeats of silence after which a process no longer keeps another one of its name out
of the team."""


class Electorate:
    """Answers from the log, received messages and operators' assertions."""

    def __init__(self, config: Config, state: ReplicaState) -> None:
        self.config = config
        self.state = state
        # cached for the present log
        self._members: Tuple[Optional[Ledger], int, List[str]] = (None, 0, [])
        self._others: List[str] = []

        self._first_team = {*(r.name for r in config.plan.robots), *config.plan.witness}

    # -- the other robots --------------------------------------------------------------------------

    def is_of_team(self, robot: str) -> bool:
        """Whether the robot is, or was, in the team, as far as we know."""
        ledger = self.state.ledger
        return robot in self._first_team or robot in ledger.state.robots or robot in ledger.logs

    def has_namesake(self) -> bool:
        """Whether another process of our name is in the team instead of us."""
        state = self.state
        return (
            not state.active
            and state.namesake_heard is not None
            and state.now < state.namesake_heard + NAMESAKE_CONTACTS * self.config.pace.heartbeat
        )

    def members(self) -> List[str]:
        """The members whose votes count in the open slot, in the order of the log."""
        ledger, known = self.state.ledger, self._members
        if known[0] is not ledger or known[1] != ledger.length:
            known = self._members = (ledger, ledger.length, ledger.state.members())
            self._others = [m for m in known[2] if m != self.config.name]
        return known[2]

    def others(self) -> List[str]:
        """The members other than us."""
        self.members()
        return self._others

    def asserted_off(self) -> Set[str]:
        """The members that an operator asserted to be off. An assertion covers one incarnation: it
        ends when the robot joins again."""
        robots = self.state.ledger.state.robots
        return {
            name
            for name, incarnation in self.state.off.items()
            if name in robots
            and not robots[name].phase.gone
            and robots[name].incarnation == incarnation
        }

    def may_decide(self, voters: Collection[str], by_all: bool = False) -> bool:
        """Whether these members may decide the open slot: a quorum; or, if the members that are not
        asserted to be off are not a quorum, *all* of those. Any quorum that does not consist only
        of robots asserted to be off contains one of them, so its votes are known.

        :param by_all: some of them do not remember all their votes, so a quorum is not enough.
        """
        members = self.members()
        if not by_all and is_quorum(voters, members):
            return True
        off = self.asserted_off()
        if not off and not by_all:
            return False
        left = [m for m in members if m not in off]
        return bool(left) and all(m in voters for m in left)

    def may_choose(
        self, voters: Collection[str], items: Sequence[Item], by_all: bool = False
    ) -> bool:
        """Whether these members may decide the open slot with these items. Without a quorum, they
        have to evict by force every member whose vote is missing: a decision under an assertion,
        without the eviction, could be contradicted when the robot returns."""
        if not by_all and is_quorum(voters, self.members()):
            return True
        return self.may_decide(voters, by_all) and not self.not_cast_out(voters, items, by_all)

    def not_cast_out(
        self, voters: Collection[str], items: Sequence[Item], by_all: bool = False
    ) -> Set[str]:
        """The members asserted to be off whose votes are missing and that these items do not evict
        by force; none if the voters are a quorum."""
        if not by_all and is_quorum(voters, self.members()):
            return set()
        off = self.asserted_off()
        lives = dict.fromkeys(off, False)
        return off - {
            i.entry.robot
            for i in self.state.ledger.news(items)
            if isinstance(i.entry, log_entries.Evict)
            and i.entry.forced
            and self.ends_life(i.entry, lives)
        }

    def known_log(self, robot: str) -> str:
        """The id of the log whose votes count for a robot: the log with which it was admitted,
        otherwise the first one that we heard of; "" for none."""
        return self.state.ledger.logs.get(robot) or self.state.peers.known.get(robot, "")

    def heard_within(self, seconds: float) -> List[str]:
        """The members heard within a time (s), including us."""
        state = self.state
        return state.peers.near(self.members(), self.config.name, seconds, state.now)

    def is_first_running(self) -> bool:
        """Whether we are the first member that seems to be running: it proposes what any member
        could."""
        return self.heard_within(3 * self.config.pace.heartbeat)[:1] == [self.config.name]

    def heard_of_late(self) -> List[str]:
        """The members heard within four heartbeats, including us."""
        return self.heard_within(4 * self.config.pace.heartbeat)

    def has_quorum(self) -> bool:
        """Whether the members that were heard recently could decide."""
        return self.may_decide(self.heard_of_late())

    def unheard(self) -> List[str]:
        """The members that were not heard recently."""
        near = self.heard_of_late()
        return [m for m in self.members() if m not in near]

    def silent(self, limit: float) -> Set[str]:
        """The members that have been silent for longer than a time (s), and seem lost."""
        state = self.state
        return state.peers.silent(self.members(), self.config.name, limit, state.now)

    def ends_life(self, entry: log_entries.Entry, robots: Mapping[str, bool]) -> bool:
        """Whether an entry evicts one of these members, or begins another life of it. An entry
        about an earlier incarnation has no effect.

        Any return counts, including that of the memory that the process lacks: a robot makes no
        local transition between its return and the slot that contains it. If that memory was lost,
        no other return with the same incarnation could take effect.

        :param robots: member -> whether a process that lacks its memory runs under its name.
        """
        known = self.state.ledger.state.robots
        if isinstance(entry, log_entries.Evict) and entry.robot in robots:
            robot = known.get(entry.robot)
            return robot is not None and entry.incarnation == robot.incarnation
        if isinstance(entry, log_entries.Join) and robots.get(entry.robot):
            robot = known.get(entry.robot)  # a witness has no incarnation there
            return robot is None or entry.incarnation > robot.incarnation
        return False

    # -- robots whose machines lost power ----------------------------------------------------------

    def torn(self) -> Torn:
        """The members known to have lost the end of their logs in a power loss that have not been
        readmitted since."""
        state, me = self.state, self.config.name
        if not state.torn and not state.peers.torn:
            return {}
        found = {m: ids for m, ids in state.peers.torn.items() if self._is_torn(m, ids)}
        if state.torn:
            found[me] = (state.log_id, *state.torn)
        members = self.members()
        return {m: found[m] for m in members if m in found}

    def _is_torn(self, robot: str, ids: Tuple[str, ...]) -> bool:
        state = self.state
        return state.peers.get(robot).log == ids[0] != state.ledger.logs.get(robot)

    def whole(self) -> List[str]:
        """The recently heard members that remember all their promises and votes."""
        state, me, torn = self.state, self.config.name, self.torn()
        return [
            m
            for m in self.heard_of_late()
            if m not in torn and (self.may_vote() if m == me else state.peers.get(m).active)
        ]

    def missing_after_outage(self) -> List[str]:
        """The members whose votes are missing although they are not asserted to be off: they are
        not heard, or lost their logs."""
        off, torn, whole = self.asserted_off(), self.torn(), self.whole()
        here = self.heard_of_late()
        return [
            m
            for m in self.members()
            if m not in off and m not in whole and not (m in torn and m in here)
        ]

    def is_alone_with_damage(self) -> bool:
        """Whether our log was damaged, and there is no other member to fetch it from."""
        return bool(self.state.damage) and self.members() == [self.config.name]

    def waits_to_join(self) -> str:
        """What we wait for while we are not in the team, and what an operator can do."""
        if self.is_alone_with_damage():
            return (
                "%s; no other robot is in the team. To continue with what is left of the log: "
                "gspn trust" % (self.state.damage)
            )
        if not self.torn():
            return "waits to be admitted"
        missing = self.missing_after_outage()
        if not missing or is_quorum(self.whole(), self.members()):
            return "waits to be readmitted: its machine was restarted"
        return "machines were restarted, and %s. Start %s, or continue without (gspn trust)" % (
            self._lacks(missing),
            ", ".join(missing),
        )

    def _lacks(self, missing: Sequence[str]) -> str:
        unheard = [m for m in missing if m not in self.heard_of_late()]
        empty = [m for m in missing if m not in unheard]
        parts = ["not heard: %s" % ", ".join(unheard)] if unheard else []
        return "; ".join([*parts, *(["without a log: %s" % ", ".join(empty)] if empty else [])])

    def needs_all(self) -> Torn:
        """The robots whose logs lost their ends, if the team needs their votes to continue and all
        members are heard; otherwise none."""
        torn = self.torn()
        if (
            not torn
            or self.state.halted is not None
            or not self.is_member()
            or is_quorum(self.whole(), self.members())
            or self.missing_after_outage()
        ):
            return {}
        return torn

    # -- our own robot -----------------------------------------------------------------------------

    def own_robot(self) -> Optional[RobotState]:
        """Our robot, according to the log."""
        return self.state.ledger.state.robots.get(self.config.name)

    def known_incarnation(self) -> int:
        """Our newest incarnation that the log knows, -1 for none."""
        robot = self.own_robot()
        seen = self.state.ledger.seen.get(self.config.name, (-1, 0, ""))[0]
        return seen if robot is None else max(seen, robot.incarnation)

    def is_member(self) -> bool:
        """Whether we are a member according to the log."""
        return self.config.name in self.members()

    def may_vote(self) -> bool:
        """Whether we are a member and remember our earlier promises."""
        return (
            self.state.active
            and self.state.halted is None
            and self.is_member()
            and self.is_our_name()
        )

    def is_our_name(self) -> bool:
        """Whether our robot, if it was ever admitted, was last admitted with our log."""
        return self.state.ledger.logs.get(self.config.name) in (None, "", self.state.log_id)

    def is_settled(self) -> bool:
        """Whether the log knows this incarnation of our robot, so that it may act."""
        if not self.state.active:
            return False
        robot = self.own_robot()
        return (
            robot is not None
            and not robot.phase.gone
            and robot.incarnation == self.state.incarnation
        )

    def surely_a_member(self) -> bool:
        """Whether it is certain that the others have not evicted us for silence yet."""
        limit = self.config.plan.timing.evict_after
        return limit <= 0 or is_quorum(self.heard_within(limit), self.members())

    def has_to_join(self) -> bool:
        """Whether we have no vote until the team admits us."""
        return not self.state.active and (self.state.joining or self.state.amnesic)

    def spoken_for(self) -> bool:
        """Whether the log holds an entry of ours that this incarnation did not propose, so that its
        entries would count as outdated."""
        state = self.state
        incarnation, number, tag = state.ledger.seen.get(self.config.name, (-1, 0, ""))
        if self.known_incarnation() > state.incarnation:
            return True
        return (
            incarnation == state.incarnation and tag == state.log_id[:8] and number > state.number
        )

    def acted_before(self) -> bool:
        """Whether the team's log holds entries of our robot from another log than ours. If so, our
        earlier log was lost, even if no reachable robot knew it."""
        tag = self.state.ledger.seen.get(self.config.name, (-1, 0, ""))[2]
        return tag not in ("", self.state.log_id[:8])

    def witnesses_of_start(self) -> List[str]:
        """The robots that must confirm at our start that they know no other log of ours: the other
        members. If the team has shrunk to our robot according to the log, perhaps by votes of
        another process of its name, they are the whole first team."""
        state, plan = self.state, self.config.plan
        others = self.others()
        if not others and state.ledger.length > 1:
            first = [*(r.name for r in plan.robots), *plan.witness]
            others = [m for m in first if m != self.config.name]
        return [m for m in others if m not in state.off]

    def missing_at_start(self) -> List[str]:
        """The witnesses of our start that have not confirmed our log yet."""
        state = self.state
        return [m for m in self.witnesses_of_start() if state.peers.get(m).welcomes != state.log_id]

    # -- whose messages count ----------------------------------------------------------------------

    def can_teach(self, robot: str) -> bool:
        """Whether a robot's log may hold something that we still have to learn. If we voted for a
        batch that needs the votes of all, only a member may overrule it: another robot may know a
        slot that the members lost. A robot that was evicted by force according to our log counts if
        its own log has that eviction: we will learn that it rejoined."""
        ledger = self.state.ledger
        if self.state.by_all and robot not in self.members():
            return False
        slot = ledger.cast_out.get(robot, -1) if ledger.is_cast_out(robot) else -1
        return self.state.peers.get(robot).cast_out.get(robot, -1) >= slot

    # -- what may go into the log ------------------------------------------------------------------

    def not_given_up(self, message: Envelope, items: List[Item]) -> List[Item]:
        """Leave out the proposals of a robot that was evicted by force, unless the sender knows of
        the eviction: everything proposed before it was given up, even a return."""
        ledger = self.state.ledger
        if not ledger.cast_out:
            return items
        same = self.state.hash_at(message.length) == message.hash
        return [
            i
            for i in items
            if not ledger.is_cast_out(i.origin.robot)
            or (same and message.length > ledger.cast_out[i.origin.robot])
        ]

    def without_spares(self, items: Sequence[Item]) -> List[Item]:
        """Leave out the proposals of a process that wants to join under the name of a robot that is
        still working: it would replace that robot, which would then halt."""
        spares = {
            (i.origin.robot, i.origin.log)
            for i in items
            if isinstance(i.entry, log_entries.Join) and self._is_at_work(i.entry)
        }
        return [i for i in items if (i.origin.robot, i.origin.log) not in spares]

    def _is_at_work(self, join: log_entries.Join) -> bool:
        """Whether the robot that wants to join is working with another log."""
        state, robot = self.state, join.robot
        if robot == self.config.name:
            return join.log != state.log_id and self.may_vote()
        heard = state.peers.get(robot).at_work
        return (
            heard is not None
            and join.log != self.known_log(robot)
            and state.now < heard + NAMESAKE_CONTACTS * self.config.pace.heartbeat
        )

    def with_one_who_stays(self, items: List[Item]) -> List[Item]:
        """If no member would be left, postpone our own leave or eviction to a separate slot, where
        it has no effect: the last member stays, and must have been asked for its local
        transitions."""
        me, members = self.config.name, self.members()
        gone = {
            i.entry.robot
            for i in items
            if isinstance(i.entry, (log_entries.Evict, log_entries.Leave))
        }
        if len(members) < 2 or not gone.issuperset(members):
            return items
        return [
            i
            for i in items
            if not (
                isinstance(i.entry, (log_entries.Evict, log_entries.Leave)) and i.entry.robot == me
            )
        ]

    def without_ghosts(self, items: Sequence[Item]) -> List[Item]:
        """Leave out joining robots that are not heard themselves, or that are too many for the
        robots heard to remain a quorum: a team must not lose its quorum to names without a
        process. A robot cannot return in the slot that evicts it by force either, because it does
        not know of the eviction."""
        me, peers = self.config.name, self.state.peers
        now = list(self.members())
        live = set(self.heard_of_late())
        refused: Set[Tuple[str, str]] = set()
        cast_out = {
            i.entry.robot
            for i in items
            if isinstance(i.entry, log_entries.Evict) and i.entry.forced
        }
        kept = []
        for item in items:
            entry = item.entry
            name, source = item.origin.robot, (item.origin.robot, item.origin.log)
            if isinstance(entry, log_entries.Join) and name not in now:
                heard = peers.get(name).heard is not None and peers.get(name).log == entry.log
                if name == me or (heard and is_quorum(live | {name}, [*now, name])):
                    now.append(name)
                    live.add(name)
                else:
                    refused.add(source)
            if isinstance(entry, log_entries.Join) and name in cast_out:
                refused.add(source)
            if source not in refused:
                kept.append(item)
        return kept
