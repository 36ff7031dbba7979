"""Reduces a run to rows: how long each robot was where and doing what, and what happened.

The follower replays the slots of a run with the token game and produces two kinds of rows. A *stay*
is a visit of a robot to a place, or a part of one: stays are split at midnight (UTC), at gaps in
the observation, and at the end of what was read so far. A *moment* is an occurrence worth
examining: a failure, an alarm, an order of the operator.
"""

from __future__ import annotations

import math
from typing import Any, Dict, List, NamedTuple, Optional, Set

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.event_log import Record
from gspn_framework_package.execution.firing import Ended, Fault, TaskEnded
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.replayer import Replayed, Replayer
from gspn_framework_package.execution.team_state import RobotState, reported_phase
from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.model.plan import Plan

DAY_SECONDS = 86_400
"""Seconds."""

USES = USE_ACTING, USE_WAITING, USE_PAUSED, USE_FAILED, USE_RESTING = (
    "acting",
    "waiting",
    "paused",
    "failed",
    "resting",
)
"""The uses of time in a stay: its action runs; it waits for a transition; it is paused; its action
failed for good; it has finished."""

ALARM, ACTION_FAILURE, INTERVENTION = "alarm", "failure", "intervention"
INTERRUPT, TASK, TASK_END, JOIN, END = "interrupt", "task", "task_end", "join", "end"
"""The kinds of moments."""

_ORDERS = {
    log_entries.Retry: "retry",
    log_entries.SetPlace: "set-place",
    log_entries.Pause: "pause",
    log_entries.Resume: "resume",
    log_entries.CancelTask: "cancel",
    log_entries.GiveBack: "give-back",
    log_entries.PrioritiseTask: "prioritise",
    log_entries.Leave: "leave",
    log_entries.StagePlan: "deploy",
    log_entries.Unstage: "give up a deployment",
}
"""The entries that represent an operator's order in any run."""

_OF_ALL = (
    log_entries.Start,
    log_entries.Pause,
    log_entries.Resume,
    log_entries.Stop,
    log_entries.Adopt,
)
"""The entries that may affect all robots."""


class Stay(NamedTuple):
    """A stay, or a part of one, of ``robot`` in ``place``.

    ``begin`` is its beginning (seconds since 1970), and the fields of :data:`USES` are whole
    milliseconds. ``visit`` is the number of the robot's visit, ``slot`` the slot with which it
    began. ``arrived``: the visit begins with this part. ``left_by`` is the transition that ended
    it, "" if none did.
    """

    begin: float
    robot: str
    place: str
    visit: int
    slot: int
    arrived: bool
    acting: int
    waiting: int
    paused: int
    failed: int
    resting: int
    left_by: str


class Spell(NamedTuple):
    """From ``begin`` to ``end`` (seconds on the follower's clock), ``robot`` spent its time in
    ``place`` with one of :data:`USES`. ``left_by`` is the transition that ended the visit, "" if
    the visit went on."""

    robot: str
    place: str
    visit: int
    use: str
    begin: float
    end: float
    left_by: str


class Moment(NamedTuple):
    """Something that happened at ``at`` (seconds since 1970) in ``slot``; ``robot`` and ``place``
    are "" if it concerns the team. ``detail`` is the description in the log."""

    at: float
    robot: str
    place: str
    slot: int
    kind: str
    detail: str

    @property
    def what(self) -> str:
        """The kind, in words."""
        return self.kind.replace("_", " ")

    @property
    def where(self) -> str:
        """The robot, or the team, and the place if there is one."""
        return ", ".join(filter(None, (self.robot or "the team", self.place)))


class _Open:
    """A stay in progress."""

    def __init__(self, place: str, visit: int, slot: int, begin: float, arrived: bool) -> None:
        self.place, self.visit, self.slot = place, visit, slot
        self.begin = self.since = begin
        self.arrived = arrived
        self.use = 0
        self.spent = [0] * len(USES)

    def book(self, now: float) -> None:
        """Account for the time until ``now``. Both ends are rounded, so that parts add up to the
        whole."""
        self.spent[self.use] += max(0, round(now * 1000) - round(self.since * 1000))
        self.since = now

    def to_json(self) -> List[Any]:
        """The stay, which must have no accounted time, as a JSON value."""
        return [self.place, self.visit, self.slot, self.begin, self.arrived, self.use]

    @classmethod
    def from_json(cls, data: List[Any]) -> _Open:
        """The stay in a JSON value."""
        kept = cls(*data[:5])
        kept.use = data[5]
        return kept


class StayFollower:
    """Follows one run, slot by slot.

    :param plan: the plan in the header of its logs.
    :param agents: whether it is a standalone run.
    :param kept: the earlier result of :meth:`to_json`.

    :ivar stays: the stays that have ended, to be removed by the caller.
    :ivar moments: the moments, likewise.
    :ivar now: the time of the run (seconds since 1970).
    """

    def __init__(
        self, plan: Plan, *, agents: bool = False, kept: Optional[Dict[str, Any]] = None
    ) -> None:
        game = TokenGame(plan, agents=agents)
        state = game.state_from_json(kept["state"]) if kept is not None else None
        self._replayer = Replayer(game, state)
        self._agents = agents
        self._open: Dict[str, _Open] = {}
        self.now: Optional[float] = None
        self.stays: List[Stay] = []
        self.moments: List[Moment] = []
        if kept is not None:
            self.now = kept["now"]
            self._open = {name: _Open.from_json(data) for name, data in kept["open"].items()}

    @property
    def game(self) -> TokenGame:
        """The rules of the plan that the team now follows."""
        return self._replayer.game

    @property
    def next_slot(self) -> int:
        """The next slot."""
        return self._replayer.state.next_slot

    def to_json(self) -> Dict[str, Any]:
        """The follower's state, as a JSON object. Call :meth:`cut` first."""
        return {
            "state": self._replayer.state.to_json(self._replayer.game.net),
            "now": self.now,
            "open": {name: stay.to_json() for name, stay in self._open.items()},
        }

    # -- for subclasses ----------------------------------------------------------------------------

    def began(self, robot: RobotState, use: str, step: Replayed) -> None:
        """From this slot on, a robot spends its time on ``use``, one of :data:`USES`."""

    def spent(self, spell: Spell) -> None:
        """Add a robot's time; called before :meth:`followed` of the same slot."""

    def followed(self, step: Replayed) -> None:
        """The whole slot has been processed."""

    # -- time --------------------------------------------------------------------------------------

    def wait(self, seconds: float) -> None:
        """Advance the time by ``seconds``, in which the robots continue what they do."""
        if self.now is None or seconds <= 0:
            return
        end = self.now + seconds
        while True:
            midnight = (math.floor(self.now / DAY_SECONDS) + 1) * DAY_SECONDS
            if midnight > end:
                break
            self.now = float(midnight)
            self.cut()
        self.now = end

    def go_to(self, now: float) -> None:
        """Jump to ``now`` (seconds since 1970) without observed time: the log begins, its writer
        was off, or its clock was set."""
        if self.now is not None and now != self.now:
            self.cut()
        self.now = now
        for stay in self._open.values():
            stay.begin = stay.since = now

    def cut(self) -> None:
        """Make rows of the stays in progress, up to now."""
        for robot, stay in self._open.items():
            self._book(robot, stay, "")
            another = _Open(stay.place, stay.visit, stay.slot, self._at(), False)
            another.use = stay.use
            self._open[robot] = another

    def _at(self) -> float:
        return self.now or 0.0

    # -- slots -------------------------------------------------------------------------------------

    def take(self, record: Record) -> None:
        """Process the next slot or a snapshot, at the present time.

        :raises LogError: it does not follow from the previous ones, or is damaged.
        """
        step = self._replayer.take(record)
        if step is not None:
            self._follow(step)

    def end(self) -> None:
        """End the run, although no slot says that it is over."""
        for robot in list(self._open):
            self._leave(robot)

    def _follow(self, step: Replayed) -> None:
        touched: Set[str] = set()
        everybody = step.snapshot
        for command in step.commands:
            if isinstance(command, Ended):
                everybody = True
            else:
                touched.add(command.robot)
            if isinstance(command, Fault) and command.failed:  # before the robot continues
                self._moment(step.slot, command.robot, ACTION_FAILURE, command.failed)
        for entry in step.entries:
            touched.add(getattr(entry, "robot", ""))
            everybody = everybody or isinstance(entry, _OF_ALL)
            self._entry(step, entry)
        for firing in step.firings:
            for robot, source, target, visit in firing.moves:
                touched.add(robot)
                if source is not None:
                    known = self._open.get(robot)
                    if known is None or known.visit != visit - 1:
                        self._arrive(robot, source, visit - 1, step.slot)
                    self._leave(robot, firing.transition)
                if target is not None:
                    self._arrive(robot, target, visit, step.slot)
        robots = step.state.robots
        for name in [*robots, *self._open] if everybody else touched:
            self._look_at(name, step)
        for command in step.commands:
            if isinstance(command, Fault):
                self._alarm(step, command)
            elif isinstance(command, TaskEnded):
                self._task_ended(step, command)
        self.followed(step)

    def _entry(self, step: Replayed, entry: log_entries.Entry) -> None:
        robot = getattr(entry, "robot", "")
        order = _ORDERS.get(type(entry), "")
        if isinstance(entry, log_entries.SetPlace):
            order += " " + entry.place
        elif isinstance(entry, log_entries.ABOUT_TASKS):
            order += " " + entry.id
        if order:
            self._moment(step.slot, robot, INTERVENTION, order)
        elif isinstance(entry, log_entries.Stop):
            # a standalone run also stops by itself, at a limit
            self._moment(step.slot, "", END if self._agents else INTERVENTION, entry.reason)
        elif isinstance(entry, log_entries.Evict) and entry.forced:
            self._moment(step.slot, robot, INTERVENTION, "force-evict")
        elif isinstance(entry, log_entries.Interrupt):
            self._moment(step.slot, robot, INTERRUPT, entry.transition)
        elif isinstance(entry, log_entries.Submit):
            self._moment(step.slot, "", TASK, entry.transition)
        elif isinstance(entry, log_entries.Join):
            self._moment(step.slot, robot, JOIN, "")

    def _alarm(self, step: Replayed, fault: Fault) -> None:
        """Note a fault that needs a person; not a failure after which the robot continues."""
        robot = step.state.robots.get(fault.robot)
        phase = reported_phase(step.state, robot) if robot is not None else Phase.UNHEARD
        if not fault.failed or phase.report.needs_operator or step.state.fault:
            place = self.game.net.places[robot.place].name if robot is not None else ""
            self._moment(step.slot, fault.robot, ALARM, fault.message, place)

    def _task_ended(self, step: Replayed, ended: TaskEnded) -> None:
        seconds = ended.seconds(self._at())
        after = "" if seconds is None else " after %.0f s" % seconds
        text = "%s: %s%s (%s)" % (ended.id, ended.outcome, after, ended.why)
        self._moment(step.slot, ended.robot, TASK_END, text)

    def _moment(self, slot: int, robot: str, kind: str, detail: str, place: str = "") -> None:
        stay = self._open.get(robot)
        if not place and stay is not None:
            place = stay.place
        self.moments.append(Moment(self._at(), robot, place, slot, kind, detail))

    # -- robots ------------------------------------------------------------------------------------

    def _look_at(self, name: str, step: Replayed) -> None:
        """Note a robot's place and activity after a step."""
        robot = step.state.robots.get(name)
        if robot is None or robot.phase.gone or step.state.ended is not None:
            self._leave(name)
            return
        place = self.game.net.places[robot.place].name
        stay = self._open.get(name)
        if stay is None or (stay.place, stay.visit) != (place, robot.visit):
            renamed = stay is not None and stay.visit == robot.visit
            self._leave(name)
            stay = self._arrive(name, place, robot.visit, step.slot, arrived=not renamed)
        use = _use(reported_phase(step.state, robot))
        if use != stay.use:
            self._spend(name, stay)
            stay.use = use
            self.began(robot, USES[use], step)

    def _arrive(self, robot: str, place: str, visit: int, slot: int, arrived: bool = True) -> _Open:
        stay = self._open[robot] = _Open(place, visit, slot, self._at(), arrived)
        return stay

    def _leave(self, robot: str, transition: str = "") -> None:
        stay = self._open.pop(robot, None)
        if stay is not None:
            self._book(robot, stay, transition)

    def _spend(self, robot: str, stay: _Open, transition: str = "") -> None:
        begin, use = stay.since, USES[stay.use]
        stay.book(self._at())
        if stay.since > begin:
            self.spent(Spell(robot, stay.place, stay.visit, use, begin, stay.since, transition))

    def _book(self, robot: str, stay: _Open, transition: str) -> None:
        self._spend(robot, stay, transition)
        if stay.arrived or transition or any(stay.spent):
            begun = stay.begin, robot, stay.place, stay.visit, stay.slot, stay.arrived
            self.stays.append(Stay._make((*begun, *stay.spent, transition)))


def _use(phase: Phase) -> int:
    report = phase.report
    if phase is Phase.PAUSED:
        return 2
    return 0 if report.acts else 1 if report.waits else 3 if report.failed else 4
