"""A replica's answers for people, and its announcements when they change.

Owns ``reported_status``. Reads the state, the electorate and the local robot's marking; announces
through the outbox.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Dict, List, Optional

from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.agreement.consensus import Consensus
from gspn_framework_package.execution.agreement.local_robot import LocalRobot
from gspn_framework_package.execution.agreement.part import ReplicaPart
from gspn_framework_package.execution.agreement.proposer import Proposer
from gspn_framework_package.execution.agreement.quorum import is_quorum
from gspn_framework_package.execution.plan_change import vote_of
from gspn_framework_package.execution.team_state import RobotState, reported_phase


@dataclass(eq=False)
class Status(ReplicaPart):
    """Reports in words and as JSON."""

    consensus: Consensus
    proposer: Proposer
    robot: LocalRobot

    def report(self) -> None:
        """Announce what we wait for if that has changed."""
        text = self.waits_for()
        if text != self.state.reported_status:
            self.state.reported_status = text
            if text:
                self.outbox.put(interface.StatusChanged(text))

    def waits_for(self) -> str:
        """What this replica (not its action) waits for, in words; "" for nothing."""
        state, electorate = self.state, self.electorate
        if state.halted is not None:
            return "halted: " + state.halted
        if electorate.has_namesake():
            return "not in the team: another process runs as %s and is a member" % self.config.name
        if state.ledger.length == 0:
            return "waits for a member of the team"
        lost_end = electorate.torn() and not is_quorum(electorate.whole(), electorate.members())
        if lost_end or electorate.is_alone_with_damage():
            return electorate.waits_to_join()
        if not state.active and not state.joining and not state.amnesic:
            missing = electorate.missing_at_start()
            if not missing:
                return "fetches the state of the team before it starts"
            return "waits for %s to start" % ", ".join(missing)
        if state.ledger.state.ended is not None:
            return ""
        if not self.config.witness and not electorate.is_settled():
            return "waits to be admitted to the team" + self._nobody_left()
        if state.fenced:
            return "stopped: no contact with a quorum"
        if state.astray:
            return "the log differs from that of %s; its messages are ignored" % ", ".join(
                sorted(state.astray)
            )
        if state.attempt is not None and state.attempt.tries > 1:
            voteless = self._voteless()
            missing = [m for m in self.consensus.missing() if m not in voteless]
            if missing or not voteless:
                return "waits for an answer from %s" % ", ".join(missing)
            return "has no quorum; without a vote: %s" % ", ".join(voteless) + self._nobody_left()
        if self.is_stuck():
            return (
                "has no quorum; without a vote: %s" % ", ".join(self._voteless())
                + self._nobody_left()
            )
        unheard = electorate.unheard()
        if not electorate.has_quorum():
            return "has no quorum; silent: %s" % ", ".join(unheard)
        # not named, because the proposer changes all the time
        if self.config.partial and unheard and self.proposer.wants():
            return "waits for an answer from %s" % ", ".join(unheard)
        return ""

    def _voteless(self) -> List[str]:
        """The other members that report that they have no vote at present."""
        return [m for m in self.electorate.others() if not self.state.peers.get(m).active]

    def is_stuck(self) -> bool:
        """Whether the team can never continue by itself, because too many members lost their logs
        and thus their votes; or cannot before others start, because machines lost power."""
        state, me = self.state, self.config.name
        if (
            state.ledger.length == 0
            or state.ledger.state.ended is not None
            or (state.joining and not state.active)
        ):
            return False
        members, peers = self.electorate.members(), state.peers
        if self.electorate.torn():
            return not self.electorate.needs_all() and not is_quorum(
                self.electorate.whole(), members
            )
        here = [m for m in members if m == me or peers.get(m).heard is not None]
        silent = [m for m in members if m not in here]
        if state.ledger.length > 1 or any(peers.get(m).length > 1 for m in here):
            voters = [m for m in here if (state.active if m == me else peers.get(m).active)]
        else:  # the team is starting: members without a vote will soon have one
            voters = [m for m in here if not (state.amnesic if m == me else peers.get(m).joining)]
        return not is_quorum([*voters, *silent], members) and not self.electorate.may_decide(voters)

    def _nobody_left(self) -> str:
        if not self.is_stuck():
            return ""
        return (
            ": too many robots lost their logs, and the others are not a quorum; use force_evict "
            "on those robots"
        )

    def as_json(self) -> Dict[str, Any]:
        """The complete status for people, as a JSON object (ages in s)."""
        state, config = self.state, self.config
        team = state.ledger.state
        return {
            "robot": config.name,
            "run": config.run,
            "incarnation": state.incarnation,
            "synchronisation": config.plan.synchronisation.value,
            "active": state.active,
            "members": self.electorate.members(),
            "quorum": self.electorate.has_quorum(),
            "leader": "" if config.partial else state.leader,
            "log_length": state.ledger.length,
            "hash": state.ledger.hash,
            "pending": len(state.own_proposals),
            "stuck": self.is_stuck(),
            "torn": bool(state.torn),
            "missing": self._missing(),
            "astray": sorted(state.astray),
            "waits_for": self.waits_for(),
            "paused": team.paused,
            "stopped": team.stopped,
            "ended": team.ended,
            "fenced": state.fenced,
            "marking": self.state.ledger.game.net.named(self.robot.marking(), zeros=False),
            "robots": [self._robot_as_json(robot) for robot in team.robots.values()],
            "plan_name": state.ledger.game.plan.name,
            "staged": self._staged_as_json(),
            "adopted": team.adopted.number if team.adopted is not None else 0,
        }

    def _staged_as_json(self) -> Optional[Dict[str, Any]]:
        """The staged plan, and each member's vote on it: "" if it can follow the plan, None if it
        has not voted yet. None if no plan is staged."""
        team = self.state.ledger.state
        if team.staged is None:
            return None
        return {
            "stage": team.staged.number,
            "plan": str(team.staged.plan.get("plan", "")),
            "digest": team.staged.digest,
            "votes": {member: vote_of(team, member) for member in team.members()},
        }

    def _missing(self) -> List[str]:
        """The members that a team needs to continue after its machines lost power."""
        electorate = self.electorate
        if not electorate.torn() or is_quorum(electorate.whole(), electorate.members()):
            return []
        return electorate.missing_after_outage()

    def _log_of(self, name: str) -> str:
        """Condition of a robot's log: whole, torn or lost; "" if the robot is not heard."""
        if name in self.electorate.torn():
            return "torn"
        if name in self.electorate.whole():
            return "whole"
        return "lost" if name in self.electorate.heard_of_late() else ""

    def _robot_as_json(self, robot: RobotState) -> Dict[str, Any]:
        state = self.state
        mine = robot.name == self.config.name
        at = state.position if mine else None
        heard = state.peers.get(robot.name).heard
        team = state.ledger.state
        reported = reported_phase(team, robot).report
        return {
            "robot": robot.name,
            "place": self.state.ledger.game.net.places[at.place if at else robot.place].name,
            "state": reported.state,
            "incarnation": robot.incarnation,
            "visit": at.visit if at else robot.visit,
            "attempt": at.attempt if at else robot.attempt,
            "log_length": state.ledger.length if mine else state.peers.get(robot.name).length,
            "log": self._log_of(robot.name),
            "last_contact": 0.0
            if mine
            else (None if heard is None else round(state.now - heard, 3)),
            "waits_for": ""
            if reported.at_rest
            else self.state.ledger.game.why_waiting(team, robot),
        }
