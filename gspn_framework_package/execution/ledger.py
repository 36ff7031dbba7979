"""The result of the log so far: the state of the team and the end of the hash chain.

A *ledger* turns batches of entries into ``slot`` records (see
:mod:`~gspn_framework_package.execution.event_log`), and can continue from a ``snapshot`` record.
The standalone executor and each replica of a team keep one.
"""

from __future__ import annotations

from typing import Any, Dict, List, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.event_log import Record, first_hash, next_hash
from gspn_framework_package.execution.firing import firing_to_json
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.team_state import whole_number
from gspn_framework_package.execution.token_game import Step, TokenGame
from gspn_framework_package.model.errors import LogError


class Origin(NamedTuple):
    """Who put an entry into the log: a robot, its incarnation, a sequence number, and the
    (shortened) id of the log in which that number is counted.

    For each robot, an entry has an effect only if it is newer than all before, so duplicates are
    harmless. Two lives of a robot that lost its log may claim the same incarnation; it belongs to
    the first one in the agreed log.
    """

    robot: str
    incarnation: int
    number: int
    log: str = ""


class Item(NamedTuple):
    """An entry and its origin, before it is in the log. ``private`` marks a ``Done`` of partial
    synchronisation whose local transition has already fired."""

    entry: log_entries.Entry
    origin: Origin
    private: bool = False

    def to_json(self) -> List[Any]:
        """The item as a JSON value."""
        return [log_entries.to_json(self.entry), list(self.origin), int(self.private)]

    @classmethod
    def from_json(cls, data: Any) -> Item:
        """Parse an item. :raises LogError: the JSON value is not an item."""
        try:
            entry, (robot, incarnation, number, log_id), private = data
            if type(incarnation) is not int or type(number) is not int:
                raise ValueError("the numbers of its origin are not integers")
            if not isinstance(robot, str) or not isinstance(log_id, str):
                raise ValueError("its origin has no name")
            item = cls(
                log_entries.from_json(entry),
                Origin(robot, incarnation, number, log_id),
                bool(private),
            )
            if item.private and not isinstance(item.entry, log_entries.Done):
                raise ValueError("only a Done can be a local transition")
            return item
        except (TypeError, ValueError) as error:
            raise LogError("not an entry with its origin: %.200r (%s)" % (data, error)) from None


def _is_newer(origin: Origin, known: Optional[Tuple[int, int, str]]) -> bool:
    """Whether an entry of this origin is newer than the last known one of its robot."""
    if known is None or origin.incarnation > known[0]:
        return True
    _, incarnation, number, log_id = origin
    return incarnation == known[0] and number > known[1] and log_id == known[2]


class Ledger:
    """The state after a prefix of the log.

    :param game: the rules of the run's first plan; ledgers may share them.

    :ivar first: the same rules.
    :ivar game: the rules that apply now, which change when the team adopts another plan.
    :ivar state: the team after ``length`` slots; changed in place.
    :ivar hash: the end of the hash chain.
    :ivar seen: robot -> (incarnation, number, log) of its newest entry in the log.
    :ivar logs: robot -> id of the log with which it was last let in; does not include robots of the
        first team that never rejoined.
    :ivar cast_out: robot -> slot of its last eviction by force.
    """

    def __init__(self, game: TokenGame) -> None:
        self.first = self.game = game
        self.state = game.new_state()
        self.hash = first_hash(game.plan)
        self.seen: Dict[str, Tuple[int, int, str]] = {}
        self.logs: Dict[str, str] = {}
        self.cast_out: Dict[str, int] = {}

    @property
    def length(self) -> int:
        """The number of the next slot."""
        return self.state.next_slot

    def entrance(self, transition: str) -> Optional[int]:
        """The number of the transition through which tasks arrive now; None if there is none.

        :param transition: its name, in this plan or an earlier one.
        """
        t = self.game.net.transition_index.get(self.state.present_name(transition))
        return t if t in self.game.submissions else None

    def is_news(self, origin: Origin) -> bool:
        """Whether an entry of this origin is newer than all entries of that robot in the log."""
        return _is_newer(origin, self.seen.get(origin.robot))

    def news(self, items: Sequence[Item]) -> List[Item]:
        """The items of a batch that are newer than all earlier entries of their robot in the log
        and the batch."""
        seen: Dict[str, Tuple[int, int, str]] = {}
        fresh = []
        for item in items:
            robot = item.origin.robot
            if _is_newer(item.origin, seen.get(robot, self.seen.get(robot))):
                seen[robot] = item.origin[1:]
                fresh.append(item)
        return fresh

    def append(
        self, items: Sequence[Item], ballot: Optional[Sequence[Any]] = None
    ) -> Tuple[Record, Step]:
        """Append a batch as the next slot, without repeated items.

        :param items: the batch.
        :param ballot: the ballot under which a team agreed on it.
        :returns: the ``slot`` record, and its effects.
        """
        fresh = self.news(items)
        self.seen.update({item.origin.robot: item.origin[1:] for item in fresh})
        slot, entries = self.length, [item.entry for item in fresh]
        step = self.game.reduce(self.state, slot, entries)
        record = self.record(slot, entries, [list(item.origin) for item in fresh], step)
        if ballot is not None:
            record["ballot"] = list(ballot)
        for item in fresh:
            self._note_membership(item.entry)
        return record, step

    def _note_membership(self, entry: log_entries.Entry) -> None:
        """Record the log with which a robot was admitted, or the slot in which it was evicted by
        force."""
        if isinstance(entry, log_entries.Join):
            robot = self.state.robots.get(entry.robot)
            if entry.robot in self.state.witnesses or (
                robot and robot.incarnation == entry.incarnation
            ):
                self.logs[entry.robot] = entry.log
        elif isinstance(entry, log_entries.Evict) and entry.forced:
            robot = self.state.robots.get(entry.robot)
            if (
                robot is not None
                and robot.phase is Phase.LOST
                and robot.incarnation == entry.incarnation
            ):
                self.cast_out[entry.robot] = self.length - 1

    def is_cast_out(self, name: str) -> bool:
        """Whether the robot was evicted by force and has not joined since."""
        if name not in self.cast_out:
            return False
        robot = self.state.robots.get(name)
        return robot is None or robot.phase.gone

    def record(
        self, slot: int, entries: Sequence[log_entries.Entry], origins: List[Any], step: Step
    ) -> Record:
        """Make the ``slot`` record of a step that was already carried out, and extend the hash
        chain."""
        written = [log_entries.to_json(e) for e in entries]
        before, self.game = self.game, step.game(self.game)
        firings = [
            firing_to_json(f, step.game_of(i, before).net) for i, f in enumerate(step.firings)
        ]
        self.hash = next_hash(self.hash, written, origins, firings)
        return {
            "kind": "slot",
            "slot": slot,
            "entries": written,
            "origins": origins,
            "firings": firings,
            "hash": self.hash,
        }

    # -- snapshots ---------------------------------------------------------------------------------

    def snapshot(self) -> Record:
        """The whole state, as a ``snapshot`` record."""
        return {
            "kind": "snapshot",
            "slot": self.length - 1,
            "state": self.state.to_json(self.game.net),
            "seen": {robot: list(newest) for robot, newest in self.seen.items()},
            "logs": dict(self.logs),
            "cast_out": dict(self.cast_out),
            "hash": self.hash,
        }

    def restore(self, record: Record) -> None:
        """Take over the state of a ``snapshot`` record; an invalid one changes nothing.

        :raises LogError: it is not a snapshot, or not of this plan.
        """
        try:
            state = self.first.state_from_json(record["state"])
            seen = {
                r: (whole_number(i), whole_number(n), str(x))
                for r, (i, n, x) in record["seen"].items()
            }
            logs = {str(r): str(x) for r, x in record.get("logs", {}).items()}
            cast_out = {str(r): whole_number(n) for r, n in record.get("cast_out", {}).items()}
            if state.next_slot != whole_number(record["slot"]) + 1 or not isinstance(
                record["hash"], str
            ):
                raise ValueError("it does not belong to the slot that it names")
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise LogError("not a snapshot (%r)" % error) from None
        self.state, self.seen, self.logs, self.cast_out = state, seen, logs, cast_out
        self.hash = record["hash"]
        self.game = self.first.now(state)
