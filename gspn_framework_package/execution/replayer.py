"""Plays a log again: the state of the team after each record."""

from __future__ import annotations

from typing import Iterator, List, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.event_log import EventLog, Record
from gspn_framework_package.execution.firing import Firing, GameCommand, firing_from_json
from gspn_framework_package.execution.team_state import TeamState
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.model.errors import LogError, NetError

RECORD_FAULTS = (KeyError, TypeError, ValueError, AttributeError, IndexError, NetError)
"""Errors raised when a record is damaged or belongs to another plan."""


def unusable(fault: Exception) -> LogError:
    """The error that says why a record cannot be used.

    :param fault: one of :data:`RECORD_FAULTS`.
    """
    if isinstance(fault, NetError):
        return LogError("the record is not of this plan (%s)" % fault)
    return LogError("the record is damaged (%r)" % fault)


class Replayed(NamedTuple):
    """A replayed slot of a log. ``state`` is the state after it; replaying the next slot changes it
    in place. ``commands`` are its commands to the robots, ``adopted`` the plans that the team
    adopted in it (see :class:`~gspn_framework_package.execution.token_game.Step`).

    If the log took over a snapshot instead, ``snapshot`` is true and ``entries`` is empty.
    """

    slot: int
    entries: Tuple[log_entries.Entry, ...]
    firings: List[Firing]
    state: TeamState
    record: Record
    snapshot: bool = False
    commands: Sequence[GameCommand] = ()
    adopted: Tuple[Tuple[int, TokenGame], ...] = ()


class Replayer:
    """Replays the slots of a log with the token game, record by record.

    :param game: the rules of the plan in the header.
    :param state: the state to start from; by default, the state before the run.

    :ivar game: the rules of the plan that the team now follows.
    """

    def __init__(self, game: TokenGame, state: Optional[TeamState] = None) -> None:
        self._first = game
        self.state = state if state is not None else game.new_state()
        self.game = game.now(self.state)

    def take(self, record: Record) -> Optional[Replayed]:
        """Replay the next record of the log.

        :returns: its effects; None if it contains no slot or new snapshot.
        :raises LogError: a slot is missing, does not contain entries, or leads to other firings
            than it recorded; or the record is damaged or does not belong to this plan.
        """
        try:
            return self._take(record)
        except RECORD_FAULTS as error:
            raise unusable(error) from None

    def _take(self, record: Record) -> Optional[Replayed]:
        if record["kind"] == "snapshot":
            # a snapshot stored as a starting point changes nothing
            if record["slot"] != self.state.next_slot - 1:
                self.state = self._first.state_from_json(record["state"])
                self.game = self._first.now(self.state)
                return Replayed(record["slot"], (), [], self.state, record, True)
        elif record["kind"] == "reset":
            self.game, self.state = self._first, self._first.new_state()
        elif record["kind"] == "slot":
            step = _replay_slot(self.game, self.state, record)
            self.game = self._first.now(self.state)
            return step
        return None


def replay(event_log: EventLog) -> Iterator[Replayed]:
    """Replay the slots of a log, one by one, with the token game.

    :raises LogError: a record is damaged; or a slot is missing, does not contain entries, or leads
        to other firings than it recorded.
    """
    plan = event_log.plan
    replayer = Replayer(TokenGame(plan, agents=bool(event_log.header.get("agents"))))
    for number, record in enumerate(event_log.records, 2):
        try:
            step = replayer.take(record)
        except LogError as error:
            raise error.located(file=event_log.path, line=number) from None
        if step is not None:
            yield step


def _replay_slot(game: TokenGame, state: TeamState, record: Record) -> Replayed:
    slot = record["slot"]
    if slot != state.next_slot:
        raise LogError("slot %s follows instead of slot %d" % (slot, state.next_slot))
    batch = tuple(log_entries.from_json(e) for e in record["entries"])
    step = game.reduce(state, slot, batch)
    recorded = [
        firing_from_json(f, step.game_of(i, game).net) for i, f in enumerate(record["firings"])
    ]
    if step.firings != recorded:
        raise LogError("slot %d leads to other firings than it recorded" % slot)
    return Replayed(slot, batch, step.firings, state, record, False, step.commands, step.adopted)
