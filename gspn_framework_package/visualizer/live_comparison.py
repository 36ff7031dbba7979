"""Compares a live run with its plan's prediction, based on the same events that the page receives.

The prediction is computed once, in a separate process. Then a thread follows the events of the
hub with a monitor, and publishes the latest value ``model`` for the page:

``state``
    ``none`` (the plan gives no durations), ``predicting``, ``watching``, ``failed`` or ``over``.
``says``
    The state in a sentence, for people.
``seconds``
    Duration of the comparison.
``streams``
    The pace of each place, each robot and the team, and other streams that have begun to rise:
    ``name``, ``kind``, ``level`` (the sum as a share of its threshold), ``on``, ``says``.
``alarms``
    The sentences of the active alarms.
``causes``
    The same, each with its ``text``, its ``size`` as an interval ("" if that is not known yet), and
    the sentences of the alarms that it explains (``follows``).
``curves``
    Counts to compare: ``name``, ``growth`` (rate, chance, doubt: the band at time t is rate t +- z
    sqrt(chance t + doubt t^2)), ``points`` (time, count).
``false_alarm_every``
    Mean time between two false alarms of all streams together, in seconds.

An action ended when its transition fired, if that happened at once; otherwise when the robot
reported that it waits. If the comparison starts in mid-run, robots are watched from their next
visit on.
"""

from __future__ import annotations

import queue
import threading
from dataclasses import replace
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.analysis.monitoring.monitor import ALARM_EVERY, Monitor
from gspn_framework_package.analysis.monitoring.streams import PACES, Alarm, Stream
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.timed_get import get_within
from gspn_framework_package.model.outcome import Outcome
from gspn_framework_package.model.plan import Plan, RobotSpec
from gspn_framework_package.model.plan_timing import POLICY, PlanTiming
from gspn_framework_package.visualizer.analysis_jobs import ALL_TRANSITIONS, AnalysisJobs
from gspn_framework_package.visualizer.board import Board, Event, note_event
from gspn_framework_package.visualizer.documents import Document
from gspn_framework_package.visualizer.hub import Hub

COMPARISON_PERIOD = 1.0
"""Seconds between two messages to the page."""

TREND_POINTS = 60
"""Largest number of points of a curve; beyond it, every second point is dropped."""

CURVES = 12
"""Largest number of curves; the transitions that fire most often are chosen."""

PREDICTION_SECONDS = 120.0
"""Time limit of the prediction, in seconds."""


class Departures(NamedTuple):
    """How a run departs from its plan's prediction.

    :ivar lasting: the active alarms.
    :ivar new: the new ones.
    :ivar levels: the watched streams, each with its progress towards its alarm (0 to 1).
    """

    lasting: Sequence[Alarm]
    new: Sequence[Alarm]
    levels: Sequence[Tuple[str, float]]


_Listener = Callable[[Departures], None]
"""Called once per period."""


class _Attempt(NamedTuple):
    place: int
    attempt: int


class RunFollower:
    """Passes the events of a hub to a monitor.

    :param plan: the plan of the run.
    :param complete: whether the events begin with the run, so that robots that appear have just
        started.
    :param number: number of the plan; events under other plans are ignored.
    :param began: when the plan came into effect, in seconds; the start of the monitor's time.
    """

    def __init__(
        self, plan: Plan, monitor: Monitor, complete: bool, number: int = 0, began: float = 0.0
    ) -> None:
        self._plan, self._net, self._monitor = plan, plan.net, monitor
        self._number, self._began = number, began
        self._complete = complete
        self._timing = PlanTiming(plan)
        self._places: Dict[str, int] = {}
        self._going: Dict[str, _Attempt] = {}
        self._ended_in: Dict[str, int] = {}
        """Robots whose action has ended but whose result is unknown so far, with the place of the
        action."""
        self._failed: Dict[str, bool] = {}
        self.counts = [0] * len(plan.net.transitions)
        """Firings of each transition so far."""
        self.over = False
        """Whether the run is over."""

    def take(self, event: Event) -> None:
        """Process an event; events must come in the order of publication."""
        if self.over or event.get("p", 0) != self._number:
            return
        now = float(event["t"]) - self._began
        kind = event["k"]
        if kind == "fire":
            self._fire(event, now)
        elif kind == "robots":
            for robot in event["r"]:
                self._robot(robot, now)
            for name in event.get("gone", ()):
                self._cut(name, now)
        elif kind == "mark":
            for name in list(self._going):
                self._cut(name, now)
            self._ended_in.clear()
        elif kind == "status":
            status = event["status"]
            if status.get("ended") or status.get("running") is False:
                for name in list(self._going):
                    self._cut(name, now)
                self.over = bool(status.get("ended"))

    def _fire(self, event: Event, now: float) -> None:
        t = int(event["tr"])
        self.counts[t] += 1
        interrupts = self._net.transitions[t].name in self._plan.events
        for name, source, target in event["m"]:
            going = self._going.pop(name, None)
            if going is not None and source == going.place and not interrupts:
                self._monitor.end(name, now, result=None)
                self._ended_in[name] = going.place
            elif going is not None:
                self._monitor.end(name, now, completed=False)
            ended = self._ended_in.pop(name, None)
            if ended is not None and ended == source and not interrupts:
                self._monitor.result(self._net.places[ended].name, self._result(ended, t), now)
            self._failed.pop(name, None)
            self._places.pop(name, None)
            if target is not None:
                self._places[name] = target
                self._begin(name, target, 1, now)

    def _result(self, place: int, t: int) -> str:
        """The result of an action after which ``t`` fired: its name, or "" if the policy chose."""
        timing = self._timing.places.get(place)
        named = timing is not None and any(outcome == t for outcome, _ in timing.outcomes)
        policy = timing is not None and any(outcome == POLICY for outcome, _ in timing.outcomes)
        return self._net.transitions[t].name if named or not policy else ""

    def _robot(self, shown: Dict[str, Any], now: float) -> None:
        name = shown["name"]
        known = self._places.get(name)
        place = shown.get("place", known)
        if place is None:
            return
        if known is not None and place != known:  # the robot was put there
            self._cut(name, now)
        new = known is None
        self._places[name] = place
        going = self._going.get(name)
        phase = Phase.of_value(shown["phase"]) if "phase" in shown else None
        attempt = shown.get("attempt")
        if going is not None and attempt is not None:
            if attempt > going.attempt:
                self._fail(name, shown, now)
                self._begin(name, place, attempt, now + self._delay(place, attempt - 1))
                going = self._going[name]
            else:
                self._going[name] = going = going._replace(attempt=attempt)
        if phase is None:
            return
        if phase.gone or phase is Phase.UNHEARD:
            self._cut(name, now)
        elif phase is Phase.FAILED:
            if going is not None:
                self._fail(name, shown, now)
            self._failed[name] = True
        elif phase in (Phase.DOING, Phase.FREE):
            started = (new and self._complete) or self._failed.pop(name, False)
            if going is None and started:
                self._begin(name, place, attempt or 1, now)
        elif going is not None:
            self._monitor.end(name, now, result=None)
            del self._going[name]
            self._ended_in[name] = place

    def _begin(self, name: str, place: int, attempt: int, start: float) -> None:
        self._going[name] = _Attempt(place, attempt)
        self._monitor.begin(name, self._net.places[place].name, start)

    def _fail(self, name: str, shown: Dict[str, Any], now: float) -> None:
        late = str(shown.get("why", "")).startswith(Outcome.TIMEOUT)
        reason = Outcome.TIMEOUT if late else Outcome.ABORTED
        self._monitor.end(name, now, failed=reason)
        self._going.pop(name, None)

    def _cut(self, name: str, now: float) -> None:
        if self._going.pop(name, None) is not None:
            self._monitor.end(name, now, completed=False)
        self._ended_in.pop(name, None)

    def _delay(self, place: int, failures: int) -> float:
        return self._plan.failure_rule(self._net.places[place].name).delay(failures)


class LiveComparison:
    """Compares the live run of a hub with its plan; see the module.

    :param plan: the plan that runs.
    :param hub: its epoch must be that of the run.
    :param complete: whether the run begins with the epoch.
    :param listener: receives the alarms, on a separate thread.
    :param number: number of the plan, as counted by the board.
    """

    def __init__(
        self,
        plan: Plan,
        hub: Hub,
        complete: bool,
        listener: Optional[_Listener] = None,
        number: int = 0,
    ) -> None:
        self._plan, self._hub, self._complete = plan, hub, complete
        self._listener, self._number = listener, number
        self._began = hub.clock() if number else 0.0
        self._queue: queue.SimpleQueue[Optional[Sequence[Event]]] = queue.SimpleQueue()
        self._jobs = AnalysisJobs()
        self._stop = threading.Event()
        self._points: List[Tuple[float, List[int]]] = []
        self._shown = 0
        if not plan.durations:
            self._say("none", "the plan gives no durations, so there is no model to compare with")
            return
        self._say("predicting", "the prediction of the run is being computed")
        hub.tap(self._queue.put)
        threading.Thread(target=self._work, name="compare", daemon=True).start()

    def go_on(self, plan: Plan) -> LiveComparison:
        """Stop, and compare the run with another plan that it now follows; the hub's board already
        shows that plan."""
        self.end()
        board = self._hub.board()
        here = _begun_at(plan, board)
        return LiveComparison(here, self._hub, False, self._listener, board.plan)

    def end(self) -> None:
        """Stop."""
        self._stop.set()
        self._jobs.close()
        self._queue.put(None)

    # -- the thread --------------------------------------------------------------------------------

    def _work(self) -> None:
        try:
            prediction = self._predict()
            if prediction is not None:
                self._watch(prediction)
        except Exception as error:  # the page continues without it
            self._say("failed", "the comparison failed: %s" % type(error).__name__)
        finally:
            self._hub.untap(self._queue.put)
            self._jobs.close()

    def _predict(self) -> Optional[Dict[str, Any]]:
        document = Document(self._plan.name, self._plan.net, self._plan)
        asked = {
            "predict": {"time": _horizon(self._plan)},
            "policy": True,
            "seconds": PREDICTION_SECONDS,
        }
        key = self._jobs.start(document, self._plan.net.initial_marking, asked)
        while not self._stop.wait(0.1):
            report = self._jobs.report(key)
            if report["state"] == "running":
                continue
            prediction = (report["result"] or {}).get("prediction")
            if prediction is None:
                self._say("failed", "the run cannot be predicted: %s" % report["error"])
            return prediction
        return None

    def _watch(self, prediction: Dict[str, Any]) -> None:
        names = [robot.name for robot in self._plan.robots]
        monitor = Monitor(self._plan, names, prediction["paces"], ALARM_EVERY)
        follower = RunFollower(self._plan, monitor, self._complete, self._number, self._began)
        due = 0.0
        while not self._stop.is_set():
            try:
                events = get_within(self._queue, COMPARISON_PERIOD / 4)
            except queue.Empty:
                events = ()
            for event in events or ():
                if event["k"] != "note":
                    follower.take(event)
            now = self._hub.clock() - self._began
            if self._queue.empty() and (now >= due or follower.over):
                due = now + COMPARISON_PERIOD
                if not follower.over:
                    monitor.advance(now)
                self._publish(monitor, follower, prediction, now)
                if follower.over:
                    return

    # -- report ------------------------------------------------------------------------------

    def _publish(
        self, monitor: Monitor, follower: RunFollower, prediction: Dict[str, Any], now: float
    ) -> None:
        new = [alarm for alarm in monitor.alarms[self._shown :] if not monitor.is_explained(alarm)]
        self._shown = len(monitor.alarms)
        for alarm in new:
            since = max(alarm.since, 0.0) + self._began
            text = "%s, since about %.0f s" % (alarm.describe(), since)
            self._hub.publish(note_event("warning", text, alarm.robot))
        causes = monitor.causes()
        lasting = [cause.alarm for cause in causes]
        if self._listener is not None:
            levels = [(_name(stream), _level(stream)) for stream in monitor.streams]
            self._listener(Departures(lasting, new, levels))
        self._points.append((round(now, 2), [sum(follower.counts), *follower.counts]))
        if len(self._points) > 2 * TREND_POINTS:
            self._points = self._points[::2]
        growths = prediction["growth"]
        transitions = [t.name for t in self._plan.net.transitions]
        often = sorted(range(len(transitions)), key=lambda t: -growths[transitions[t]][0])
        chosen = [(ALL_TRANSITIONS, 0)] + [(transitions[t], t + 1) for t in often[:CURVES]]
        self._say(
            "over" if follower.over else "watching",
            "%d alarm%s" % (len(lasting), "" if len(lasting) == 1 else "s")
            if lasting
            else "the run matches the prediction",
            seconds=round(now, 1),
            streams=[
                {
                    "kind": stream.kind,
                    "name": _name(stream),
                    "level": round(level, 3),
                    "on": stream.on,
                    "says": stream.alarms[-1].describe() if stream.on and stream.alarms else "",
                }
                for stream in monitor.streams
                for level in [_level(stream)]
                if stream.kind in PACES or stream.on or level > 0.25
            ],
            alarms=[alarm.describe() for alarm in lasting],
            causes=[
                {
                    "text": cause.alarm.describe(),
                    "size": cause.size(),
                    "follows": cause.others(),
                }
                for cause in causes
            ],
            curves=[
                {
                    "name": name,
                    "growth": growths[name],
                    "points": [[at, counts[i]] for at, counts in self._points],
                }
                for name, i in chosen
            ],
            false_alarm_every=monitor.alarm_every,
        )

    def _say(self, state: str, says: str, **more: Any) -> None:
        if not self._stop.is_set():
            self._hub.set_latest("model", {"state": state, "says": says, **more})


def _begun_at(plan: Plan, board: Board) -> Plan:
    """A copy of a plan that starts with the marking and the robots of a board."""
    own = {robot.name: robot.actions for robot in plan.robots}
    robots = [
        RobotSpec(name, plan.net.places[robot["place"]].name, own.get(name, {}))
        for name, robot in board.robots.items()
        if robot.get("place", -1) >= 0 and not Phase.of_value(robot.get("phase", "")).gone
    ]
    return replace(plan, net=plan.net.with_marking(tuple(board.marking))).with_robots(robots)


def _level(stream: Stream) -> float:
    """The progress of a stream towards its alarm, 0 to 1."""
    nearest = stream.nearest()
    return min(nearest.value / nearest.threshold, 1.0)


def _name(stream: Stream) -> str:
    parts = [part for part in (stream.place, stream.robot, stream.transition) if part]
    return ", ".join(parts) or "the team"


def _horizon(plan: Plan) -> float:
    """Length of the predicted runs in seconds: enough for many actions."""
    longest = max((d.mean for d in plan.durations.values()), default=0.0)
    return min(max(200 * longest, 1.0), 36_000.0)
