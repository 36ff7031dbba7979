"""The story of one run: what each robot did when, which robot waited for which, and why.

A wait is over when a transition takes the robot along. What was still missing until then is in the
slot of that firing: the entry of the log that made it possible, and the robot of that entry. What
that robot did in the meantime (it failed, was paused, or waited itself) is why it took so long.
"""

from __future__ import annotations

from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Sequence, Set, Tuple

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.event_log import LogClock, LogFile, clock_reading
from gspn_framework_package.execution.firing import Firing
from gspn_framework_package.execution.logged_attempts import ReadingProgress
from gspn_framework_package.execution.replayer import Replayed
from gspn_framework_package.execution.team_state import RobotState
from gspn_framework_package.fleet.stay_follower import (
    ACTION_FAILURE,
    USE_FAILED,
    USE_PAUSED,
    USE_WAITING,
    USES,
    Moment,
    Spell,
    StayFollower,
)
from gspn_framework_package.model.errors import LogError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan

SHORTEST = 0.05
"""Seconds; a shorter stop does not count as a wait."""

_FAILURES_NAMED = 3
"""Largest number of failures named as the reason of one wait."""

_DELAYS_NAMED, _SHARE_NAMED = 2, 0.1
"""Largest number of pauses and waits of another robot named as the reason of a wait, and the
smallest share of it that they take."""

_ITSELF = "itself waited "

_BETWEEN = 2_000
"""Number of records between two reports of progress."""


class Waited(NamedTuple):
    """A robot waited in ``place`` from ``begin`` to ``end`` (seconds since the run began).

    ``needs`` is what it waited for, as it said when it began. ``transition`` ended the wait in
    ``slot``, "" if the wait went on when the log ended. ``awaited`` is the other robot that made
    the transition possible, "" if none did; ``because`` says what it did ("it" is that robot), and
    ``delays`` what kept it until then.
    """

    robot: str
    place: str
    begin: float
    end: float
    needs: str
    transition: str
    slot: int
    awaited: str
    because: str
    delays: Tuple[str, ...]

    @property
    def seconds(self) -> float:
        """How long it waited."""
        return self.end - self.begin

    def text(self) -> str:
        """The wait in one sentence, without its robot and its time."""
        said = "waited %s in %s" % (length_text(self.seconds), self.place)
        if self.awaited:
            said += " for %s" % self.awaited
            if self.delays:
                again = " and %s" % _ITSELF
                said += ", which %s" % " and ".join(self.delays).replace(again, " and ")
        if not self.transition:
            return said + ", to the end of the log" + (": " + self.needs if self.needs else "")
        return said + ", until %s" % self.because


class RunStory(NamedTuple):
    """The story of a run, according to a log. Times are in seconds since the log began.

    :ivar run: the name of the run; ``plan`` that of its plan, ``recorder`` the robot whose log it
        is ("" for a standalone run).
    :ivar began: when the log began (seconds since 1970), None if its clock is virtual.
    :ivar seconds: when it ended; ``slots`` and ``firings`` are how many it has.
    :ivar ended: why the run is over; "" if the log does not say that it is.
    :ivar spells: robot -> what it did, in order.
    :ivar waits: all waits, in the order in which they ended.
    :ivar moments: what happened, in order.
    """

    run: str
    plan: str
    recorder: str
    began: Optional[float]
    seconds: float
    slots: int
    firings: int
    ended: str
    spells: Dict[str, List[Spell]]
    waits: List[Waited]
    moments: List[Moment]


def length_text(seconds: float) -> str:
    """A length of time, for people."""
    if seconds < 120:
        return "%.1f s" % seconds
    return "%d min" % round(seconds / 60) if seconds < 7200 else "%.1f h" % (seconds / 3600)


def time_text(t: float) -> str:
    """A time of a run, for people: minutes and seconds, from an hour on with hours."""
    minutes, rest = divmod(t, 60)
    if minutes < 60:
        return "%d:%04.1f" % (minutes, int(rest * 10) / 10)
    return "%d:%02d:%02d" % (*divmod(int(minutes), 60), int(rest))


def read_story(path: str, progress: Optional[ReadingProgress] = None) -> RunStory:
    """Read the story of a run from one of its logs.

    A log that is still being written is read up to where it is now.

    :param progress: called with the number of records read.
    :raises LogError: the file cannot be read or is not an event log, its records do not follow from
        each other, or it begins in the middle of a run.
    """
    file = LogFile(path)
    clock = LogClock(0.0)
    follower = _StoryFollower(file.plan, agents=bool(file.header.get("agents")))
    follower.go_to(0.0)
    before, began, ended = 0.0, None, ""
    for line, record in enumerate(file.checked_records(), 2):
        now = clock.read(record)
        follower.wait(now - before)
        before = now
        if began is None:
            began = clock_reading(record, "wall")
        try:
            follower.take(record)
        except LogError as error:
            raise error.located(file=path, line=line) from None
        if record["kind"] == "ended":
            ended = str(record.get("reason", ""))
        if progress is not None and line % _BETWEEN == 0:
            progress("records read", line, 0.0)
    follower.cut()
    header = file.header
    return RunStory(
        str(header["run"]),
        file.plan.name,
        str(header["robot"]),
        None if header.get("clock") == "virtual" else began,
        before,
        follower.slots,
        follower.firings,
        ended,
        follower.spells,
        follower.waits(),
        follower.moments,
    )


def story_to_json(story: RunStory, most: int) -> Dict[str, Any]:
    """The story as a JSON object.

    :param most: the largest number of waits (the longest ones) and of moments (the last ones).
    """
    waits = sorted(longest_waits(story, most), key=lambda wait: wait.begin)
    return {
        **{key: getattr(story, key) for key in ("run", "plan", "began", "slots", "firings")},
        "seconds": round(story.seconds, 3),
        "ended": story.ended,
        "robots": [
            {"robot": robot, **{use: round(time, 3) for use, time in times.items()}}
            for robot, times in time_by_use(story).items()
        ],
        "waited_for": waited_for(story),
        "waits": [
            {
                "robot": wait.robot,
                "place": wait.place,
                "t": round(wait.begin, 3),
                "seconds": round(wait.seconds, 3),
                "transition": wait.transition,
                "slot": wait.slot,
                "for": wait.awaited,
                "text": wait.text(),
            }
            for wait in waits
        ],
        "moments": [
            {**moment._asdict(), "at": round(moment.at, 3)} for moment in story.moments[-most:]
        ],
        "left_out": max(0, len(story.waits) - most) + max(0, len(story.moments) - most),
    }


def longest_waits(story: RunStory, most: int) -> List[Waited]:
    """The longest waits, the longest first."""
    return sorted(story.waits, key=lambda wait: (-wait.seconds, wait.begin))[:most]


def time_by_use(story: RunStory) -> Dict[str, Dict[str, float]]:
    """Robot -> use of time -> seconds."""
    times = {robot: dict.fromkeys(USES, 0.0) for robot in sorted(story.spells)}
    for robot, spells in story.spells.items():
        for spell in spells:
            times[robot][spell.use] += spell.end - spell.begin
    return times


def waited_for(story: RunStory) -> List[Dict[str, Any]]:
    """How long others waited for each robot, the most awaited first: ``robot``, ``seconds``,
    ``waits`` and ``by``, the robots that waited. Waits of several robots at once add up."""
    found: Dict[str, Dict[str, Any]] = {}
    for wait in story.waits:
        if wait.awaited:
            row = found.setdefault(
                wait.awaited, {"robot": wait.awaited, "seconds": 0.0, "waits": 0, "by": set()}
            )
            row["seconds"] += wait.seconds
            row["waits"] += 1
            row["by"].add(wait.robot)
    rows = sorted(found.values(), key=lambda row: -row["seconds"])
    return [{**row, "seconds": round(row["seconds"], 3), "by": sorted(row["by"])} for row in rows]


class _StoryFollower(StayFollower):
    """Follows a run, and finds the cause of each wait.

    :ivar spells: robot -> what it did so far.
    """

    def __init__(self, plan: Plan, *, agents: bool) -> None:
        super().__init__(plan, agents=agents)
        self.spells: Dict[str, List[Spell]] = {}
        self.slots = self.firings = 0
        self._needs: Dict[str, str] = {}
        self._new: List[Spell] = []
        self._waits: List[Waited] = []
        self._awaited: Dict[Tuple[str, int], str] = {}
        """Robot and visit -> the robot that it waited for in the end."""

    def waits(self) -> List[Waited]:
        """All waits, including those that have not ended."""
        last = (spells[-1] for spells in self.spells.values() if spells)
        going_on = [spell for spell in last if spell.use == USE_WAITING and spell.end == self.now]
        slot = self.next_slot - 1
        return self._waits + [
            _waited(spell, self._needs.get(spell.robot, ""), slot)
            for spell in going_on
            if not spell.left_by and spell.end - spell.begin >= SHORTEST
        ]

    def began(self, robot: RobotState, use: str, step: Replayed) -> None:
        """See :class:`StayFollower`."""
        if use == USE_WAITING:
            self._needs[robot.name] = self.game.why_waiting(step.state, robot)

    def spent(self, spell: Spell) -> None:
        """See :class:`StayFollower`."""
        known = self.spells.setdefault(spell.robot, [])
        if known and (known[-1].visit, known[-1].use, known[-1].end) == (
            spell.visit,
            spell.use,
            spell.begin,
        ):
            spell = spell._replace(begin=known.pop().begin)  # it was cut, at midnight
        known.append(spell)
        if spell.use == USE_WAITING and spell.left_by and spell.end - spell.begin >= SHORTEST:
            self._new.append(spell)

    def followed(self, step: Replayed) -> None:
        """See :class:`StayFollower`."""
        self.slots += 1
        self.firings += len(step.firings)
        for spell in self._new:
            entry = self._entry_behind(step, spell)
            awaited = getattr(entry, "robot", "") if entry is not None else ""
            awaited = "" if awaited == spell.robot else awaited
            self._awaited[spell.robot, spell.visit] = awaited
            self._waits.append(
                _waited(spell, self._needs.get(spell.robot, ""), step.slot)._replace(
                    awaited=awaited,
                    because=self._deed(entry, awaited) or "%s fired" % spell.left_by,
                    delays=tuple(self._delays(awaited, spell)) if awaited else (),
                )
            )
        self._new = []

    def _entry_behind(self, step: Replayed, spell: Spell) -> Optional[log_entries.Entry]:
        """The entry of the slot that let the robot continue: one whose robot moved along, or took
        part in an earlier firing of the slot that changed what the transition needs."""
        at = next(
            (
                i
                for i, firing in enumerate(step.firings)
                if firing.transition == spell.left_by and _moves(firing, spell.robot)
            ),
            None,
        )
        if at is None:
            return None
        robots = _robots_behind(self.game.net, step.firings[: at + 1])
        others = [entry for entry in step.entries if getattr(entry, "robot", "") != spell.robot]
        behind = [entry for entry in others if getattr(entry, "robot", "") in robots]
        # an entry of another kind, such as a task that comes in, moves no robot
        return behind[-1] if behind else others[-1] if others else step.entries[-1]

    def _deed(self, entry: Optional[log_entries.Entry], awaited: str) -> str:
        """The entry as the end of "until ..."; "" if it says too little."""
        robot = getattr(entry, "robot", "")
        who = "it" if robot and robot == awaited else robot or "the team"
        if isinstance(entry, log_entries.Done):
            spells = self.spells.get(robot)
            return "%s ended its action%s" % (who, " in " + spells[-1].place if spells else "")
        if isinstance(entry, log_entries.Failed):
            return "its action failed (%s)" % entry.reason if who == "it" else ""
        if isinstance(entry, log_entries.Fire):
            return "the environment fired %s" % entry.transition
        if isinstance(entry, (log_entries.Submit, log_entries.TaskDue)):
            return "task %s came" % entry.id
        if isinstance(entry, log_entries.CancelTask):
            return "task %s was cancelled" % entry.id
        if isinstance(entry, (log_entries.Interrupt, log_entries.SetPlace)):
            word = "event " + getattr(entry, "transition", "")
            by_hand = isinstance(entry, log_entries.SetPlace)
            return "%s was moved %s" % (who, "by an operator" if by_hand else "by the " + word)
        return _DEEDS[type(entry)] % who if type(entry) in _DEEDS else ""

    def _delays(self, robot: str, wait: Spell) -> Iterator[str]:
        """What delayed a robot while another waited for it: failures, pauses, waits."""
        failures = []
        for moment in reversed(self.moments):
            if moment.at <= wait.begin:
                break
            if moment.robot == robot and moment.kind == ACTION_FAILURE:
                failures.append("%s at %s" % (moment.place, time_text(moment.at)))
        if failures:
            named = " and ".join(reversed(failures[:_FAILURES_NAMED]))
            more = len(failures) - _FAILURES_NAMED
            yield "failed in %s" % named + (" and %d times before" % more if more > 0 else "")
        times: Dict[str, float] = {}
        for spell in reversed(self.spells.get(robot, ())):
            if spell.end <= wait.begin:
                break
            if spell.use in _KEPT:
                kept = _KEPT[spell.use] + spell.place
                behind = self._awaited.get((robot, spell.visit))
                if spell.use == USE_WAITING and behind:
                    kept += " for %s" % behind
                times[kept] = times.get(kept, 0.0) + spell.end - max(spell.begin, wait.begin)
        least = max(SHORTEST, _SHARE_NAMED * (wait.end - wait.begin))
        for kept, seconds in sorted(times.items(), key=lambda item: -item[1])[:_DELAYS_NAMED]:
            if seconds >= least:
                yield kept.replace("TIME", length_text(seconds), 1)


_DEEDS = {
    log_entries.Resume: "an operator resumed %s",
    log_entries.Join: "%s joined",
    log_entries.Leave: "%s left",
    log_entries.Evict: "%s was declared lost",
    log_entries.GiveBack: "an operator had a task of %s given back",
    log_entries.Adopt: "%s followed another plan",
}
"""Kind of an entry -> what happened; the robot or the team is filled in."""

_KEPT = {
    USE_PAUSED: "was paused TIME in ",
    USE_FAILED: "stood TIME with a failed action in ",
    USE_WAITING: _ITSELF + "TIME in ",
}
"""Use of time -> how it kept a robot; the place follows."""


def _waited(spell: Spell, needs: str, slot: int) -> Waited:
    ends = spell.begin, spell.end
    return Waited(spell.robot, spell.place, *ends, needs, spell.left_by, slot, "", "", ())


def _moves(firing: Firing, robot: str) -> bool:
    return any(move.robot == robot for move in firing.moves)


def _robots_behind(net: Net, firings: Sequence[Firing]) -> Set[str]:
    """The robots of the last firing, and of those before it that changed what it needs."""
    last = firings[-1]
    robots = {move.robot for move in last.moves} | {last.robot}
    needed = _needed(net, last)
    for firing in reversed(firings[:-1]):
        changed = {p for p, _ in net.effect(net.transition_index[firing.transition])}
        if changed & needed:
            robots |= {move.robot for move in firing.moves} | {firing.robot}
            needed |= _needed(net, firing)
    return robots


def _needed(net: Net, firing: Firing) -> Set[int]:
    """The places that decide whether the transition of a firing can fire."""
    t = net.transition_index[firing.transition]
    room = {p for p, _ in net.outputs[t] if net.places[p].capacity is not None}
    return {p for p, _ in (*net.inputs[t], *net.inhibitors[t])} | room
