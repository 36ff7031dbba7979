"""Reconstructs the messages that a run would have published from its event logs.

Any log holds everything that the team agreed on. A robot's own log also shows exactly when its
phases began, so if several logs of a run are given, each robot's activity is taken from its own.
"""

from __future__ import annotations

import heapq
from typing import Dict, Iterator, List, NamedTuple, Optional, Sequence, Set, Tuple

from gspn_framework_package.execution.agreement.interface import Fired
from gspn_framework_package.execution.event_log import LogClock, LogFile, Record
from gspn_framework_package.execution.replayer import Replayer
from gspn_framework_package.execution.team_messages import (
    MessageFields,
    firing_fields,
    marking_fields,
    team_fields,
)
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.model.errors import LogError

_FIRED = "/fired_transitions"
"""The topic of the firings of all teams."""


class RecordedMessage(NamedTuple):
    """A message of a run: when it would have been published (s since 1970), its topic, the name of
    its type in this package, and its fields except the header."""

    time: float
    topic: str
    kind: str
    fields: MessageFields


def recorded_messages(logs: Sequence[LogFile]) -> Iterator[RecordedMessage]:
    """Yield the messages of one or more runs, in the order of their times.

    :param logs: event logs; each log of a run supplies the messages of its own robot. The largest
        log of a run also supplies those of the team, and of robots whose logs are missing.
    :raises LogError: a log cannot be followed.
    """
    runs: Dict[str, List[LogFile]] = {}
    for log in logs:
        runs.setdefault(str(log.header["run"]), []).append(log)
    streams = []
    for of_run in runs.values():
        main = max(of_run, key=lambda log: log.size)
        others = {str(log.header["robot"]) for log in of_run if log is not main} - {""}
        streams += [_messages_of(log, log is main, others) for log in of_run]
    return heapq.merge(*streams, key=lambda message: message.time)


def _messages_of(log: LogFile, whole: bool, others: Set[str]) -> Iterator[RecordedMessage]:
    """The messages from one log.

    :param whole: whether to report the team and all robots except ``others``, which have their own
        logs; otherwise only the robot that keeps the log is reported.
    """
    reader = _LogReader(log)
    latest: Dict[str, MessageFields] = {}
    with log.open() as file:
        for number, (record, _) in enumerate(log.records(file, log.begin, 2), 2):
            for message in reader.messages(record, number):
                robot = message.fields["robot"] if message.kind == "RobotActivity" else ""
                if robot in others if whole else not robot or robot != log.header["robot"]:
                    continue
                if message.kind != "FiredTransition":
                    new = {name: v for name, v in message.fields.items() if name != "slot"}
                    if latest.get(message.topic) == new:
                        continue
                    latest[message.topic] = new
                yield message


class _LogReader:
    """Reads one log, record by record."""

    def __init__(self, log: LogFile) -> None:
        self._log = log
        self._run = str(log.header["run"])
        self._keeper = str(log.header["robot"])
        self._clock: Optional[LogClock] = None
        self._began = 0.0
        self._replayer = Replayer(TokenGame(log.plan, agents=bool(log.header.get("agents"))))

    def messages(self, record: Record, number: int) -> List[RecordedMessage]:
        """The messages that follow from a record, including unchanged ones.

        :param number: the number of its line.
        """
        try:
            now = self._time(record)
            before = self._replayer.game
            step = self._replayer.take(record)
            if step is None:
                return []
            found = []
            for at, firing in enumerate(step.firings):
                games = [game for begins, game in step.adopted if begins <= at]
                plan = (games[-1] if games else before).plan
                fired = Fired(firing, False, str(record.get("hash", "")), plan)
                found.append((_FIRED, "FiredTransition", firing_fields(fired, self._run)))
            found += self._state()
            return [RecordedMessage(now, *message) for message in found]
        except LogError as error:
            raise error.located(file=self._log.path, line=number) from None

    def _time(self, record: Record) -> float:
        """Seconds since 1970 on a clock that does not jump: the wall clock of the first record,
        plus the time elapsed since."""
        if self._clock is None:
            self._clock = LogClock(0.0)
            self._began = float(record.get("wall") or 0.0)
        return self._began + self._clock.read(record)

    def _state(self) -> List[Tuple[str, str, MessageFields]]:
        game, state = self._replayer.game, self._replayer.state
        about = (self._run, game.plan.hash())
        place = "/" + self._keeper if self._keeper else ""
        team = team_fields(game, state, *about)
        return [
            (place + "/marking", "Marking", marking_fields(game, state, *about)),
            (place + "/team_state", "TeamState", team),
            *(
                ("/%s/robot_activity" % robot["robot"], "RobotActivity", robot)
                for robot in team["robots"]
            ),
        ]
