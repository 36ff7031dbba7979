"""LIVE: watches a team without being one of its robots.

One thread with one queue does the work. Network callbacks only put messages into the queue. A
second thread asks the team for its state, since an answer may take a while, and also puts the
answers into the queue. The :class:`TeamConnection` reaches the team, over ROS or Zenoh.
"""

from __future__ import annotations

import queue
import threading
import time
from collections import deque
from typing import (
    Any,
    Callable,
    Deque,
    Dict,
    FrozenSet,
    List,
    Mapping,
    Optional,
    Set,
    Tuple,
)

from gspn_framework_package.analysis.preflight.report import PreflightReport
from gspn_framework_package.analysis.preflight.while_running import CHECK_MARKINGS
from gspn_framework_package.execution.displayed_data import order_text
from gspn_framework_package.execution.enabled_set import EnabledSet
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.plan_change import NewNames
from gspn_framework_package.execution.timed_get import get_within
from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.ros.check_all import check_all
from gspn_framework_package.team.addressing import read_status
from gspn_framework_package.team.carrier import OperatorRequest
from gspn_framework_package.team.deploy_team import DeployOutcome, Votes
from gspn_framework_package.team.deployed_plan import DeployedPlan, read_deployed
from gspn_framework_package.team.operator_client import RobotLine, UnreachableError, ask_robots
from gspn_framework_package.visualizer.activity import Activity
from gspn_framework_package.visualizer.board import (
    Event,
    data_event,
    first_status,
    note_event,
    plan_event,
    renumbered,
)
from gspn_framework_package.visualizer.feedback import FeedbackStream
from gspn_framework_package.visualizer.fired_follower import (
    FiredFollower,
    FiredMessage,
    TeamSeen,
    team_seen,
)
from gspn_framework_package.visualizer.hub import Hub
from gspn_framework_package.visualizer.live_comparison import Departures, LiveComparison
from gspn_framework_package.visualizer.page_orders import PageOrder, PageOrders, StatusAnswer
from gspn_framework_package.visualizer.poses import RobotPose
from gspn_framework_package.visualizer.team_connection import (
    STATUS_TIME,
    TeamConnection,
)

SEARCH_EVERY = 2.0
"""Seconds between two searches for robots, and between two requests for the team's state."""

SILENT_SCANS = 3
"""Number of unanswered requests after which the run is considered to be over."""

UNPLACED = 500
"""Largest number of firings that wait until the plan they belong to is known."""

UNHEARD = 3
"""Number of consecutive answers that show progress of the team without any received firing, after
which the page warns the viewer."""


class TeamWatch(Activity):
    """Watches a team that runs ``plan``. No robot waits for it.

    It asks for ``status`` at intervals. Other teams may run in the same network. Only robots of the
    plan and run shown are listed, followed and given orders, and every order names the run.

    :param plan: the plan, with its initial robots.
    :param connection: the connection to the team.
    :param run: the run to show; "" takes the first run of this plan heard.

    Its plan, run and names are those of an
    :class:`~gspn_framework_package.visualizer.page_orders.OrderedTeam`.
    """

    mode = "LIVE"

    def __init__(self, plan: Plan, connection: TeamConnection, run: str = "") -> None:
        super().__init__()
        self._connection = connection
        self.plan = plan
        self._net: Net = plan.net
        self._hash = self._given = plan.hash()
        self._plans: Dict[int, Plan] = {}
        """Number -> plan that the team followed."""
        self._stage = 0
        """Number of the stage of the plan shown; 0 for the initial plan."""
        self._unplaced: Deque[FiredMessage] = deque(maxlen=UNPLACED)
        """Firings under a plan that is unknown so far."""
        self.run = run
        self._queue: queue.SimpleQueue[Tuple[Any, ...]] = queue.SimpleQueue()
        self._known: Set[str] = set()
        # address -> robot; replaced as a whole, never modified: three threads read it
        self.names: Dict[str, str] = {}
        self._strangers: FrozenSet[str] = frozenset()
        self._follower = FiredFollower(plan)
        self._shown: Dict[str, Dict[str, Any]] = {}
        self._data: Dict[str, Any] = {}
        self._status: Dict[str, Any] = {}
        self._others: Set[Tuple[str, str]] = set()
        self._unread: Set[str] = set()
        self._ordered_until: Dict[str, float] = {}
        """Robot -> time of its last order shown as a note (seconds since 1970)."""
        self._early: Dict[str, Dict[str, Any]] = {}
        self._comparison: Optional[LiveComparison] = None
        self._stop = threading.Event()
        self._asking = connection.line(STATUS_TIME)
        self._ask_now = threading.Event()
        self._turn = self._silent = 0
        self._before: Optional[TeamSeen] = None
        self._heard = True
        self._unheard = 0
        self._orders = PageOrders(self, connection)
        self.commands = self._orders.commands if connection.orders else {}

    @property
    def gone(self) -> FrozenSet[str]:
        """See :class:`OrderedTeam`."""
        return self._follower.gone

    def obeyed(self, order: PageOrder) -> None:
        """See :class:`OrderedTeam`."""
        self._queue.put(("obeyed", order))

    def ask_soon(self) -> None:
        """See :class:`OrderedTeam`."""
        self._ask_now.set()

    def verdict(self, plan: Plan) -> PreflightReport:
        """See :class:`Activity`."""
        return check_all(plan, limit=CHECK_MARKINGS)

    def deploy(
        self, plan: Plan, mapping: Mapping[str, str], tell: Callable[[Votes], None]
    ) -> DeployOutcome:
        """See :class:`Activity`."""
        if not self.commands:
            raise RefusedError("the keys of this page do not permit orders")
        return self._orders.deploy(plan, mapping, tell)

    def plan_of(self, number: int) -> Optional[Plan]:
        """See :class:`Activity`."""
        return self._plans.get(number)

    def begin(self, hub: Hub) -> None:
        """Subscribe, and start asking the team for its state."""
        self._hub = hub
        self._feedback = FeedbackStream(hub)
        self._status = {**first_status(self.run, False), "unreachable": ""}
        offered = sorted([*self.commands, "deploy"]) if self.commands else []
        info = {"commands": offered, "says": self._connection.says}
        hub.restart(self.mode, self._follower.board(self._status), info)
        self._comparison = LiveComparison(
            self.plan, hub, complete=False, listener=self._report_departures
        )
        self._connection.open(lambda *seen: self._queue.put(seen))
        threading.Thread(target=self._work, name="watch", daemon=True).start()
        threading.Thread(target=self._ask_around, name="ask", daemon=True).start()

    def end(self) -> None:
        """Stop watching."""
        self._stop.set()
        if self._comparison is not None:
            self._comparison.end()
        self._asking.close()
        self._orders.close()
        self._connection.close()

    # -- the worker --------------------------------------------------------------------------------

    def _work(self) -> None:
        while not self._stop.is_set():
            try:
                what, *seen = get_within(self._queue, 0.1)
            except queue.Empty:
                what, seen = "nothing", []
            try:
                getattr(self, "_on_" + what)(*seen)
                self._hub.publish(*self._follower.retry(time.monotonic()))
            except Exception as error:  # logged; the page continues
                self._connection.report("the page: %s: %s" % (type(error).__name__, error))
            if self._follower.lost_track:
                self._ask_now.set()

    def _on_nothing(self) -> None:
        """Handle the absence of messages."""

    def _on_fired(self, message: FiredMessage) -> None:
        if not self.run and message.plan == self._hash:
            self._show_run(message.run)
        if message.run == self.run and message.plan != self._hash:
            if not self._unplaced:
                self._ask_now.set()
            self._unplaced.append(message)  # until the plan that the team follows is known
        elif self._is_shown(message.plan, message.run):
            self._heard = True
            self._hub.publish(*self._follower.take(message, time.monotonic()))

    def _is_shown(self, plan: str, run: str) -> bool:
        """Whether a message belongs to the plan and run that the page shows. The first message of
        another run produces a note."""
        if (plan, run) == (self._hash, self.run):
            return True
        if (plan, run) not in self._others:
            self._others.add((plan, run))
            if run == self.run:
                text = "run '%s' has a plan other than the one given to this page"
            elif plan == self._hash:
                text = "run '%s' {} has the same plan; it is not shown"
            else:
                text = "run '%s' {} has another plan; it is not shown"
            self._note("warning", "", text.format(self._connection.where) % run)
        return False

    def _show_run(self, run: str) -> None:
        """Show this run, since none was chosen, including the activity that its robots published
        earlier."""
        self.run = run
        self._set_status(run=run)
        early, self._early = self._early, {}
        for address, reported in early.items():
            self._on_activity(address, reported)

    def _on_activity(self, address: str, activity: Dict[str, Any]) -> None:
        name = str(activity["robot"])
        if activity["run"] == self.run and activity["plan"] != self._hash and self.run:
            self._ask_now.set()  # the team may follow another plan
            return
        if not self.run:  # it may remain from a run that has ended
            self._early[address] = activity
            return
        if not self._is_shown(str(activity["plan"]), str(activity["run"])):
            self.names = {n: robot for n, robot in self.names.items() if n != address}
            self._strangers |= {address}
            return
        self._is_ours(address, name)
        if activity["ended"]:  # the robots leave soon; later, none may answer
            self._show_end(activity)
        phase = Phase.of_state(str(activity.get("state", "")))
        waits = str(activity.get("waits_for", ""))
        self._show_robot(
            name,
            # nor does a halted robot continue by itself
            phase=(Phase.FAILED if activity["needs_operator"] and not phase.gone else phase.logged),
            paused=phase is Phase.PAUSED,
            visit=activity.get("visit"),
            attempt=activity.get("attempt"),
            why=waits,
            refused=activity.get("refused") or None,
        )
        self._show_orders(name, activity.get("orders") or [])
        feedback = activity.get("feedback")
        if feedback and phase is Phase.DOING:
            self._feedback.show(name, "feedback: %s" % ", ".join(str(f) for f in feedback))
        else:
            self._feedback.forget(name)

    def _show_orders(self, name: str, orders: List[Dict[str, Any]]) -> None:
        """Show notes on the orders that a robot received since it was first heard."""
        newest = max((float(order["wall"]) for order in orders), default=0.0)
        known = self._ordered_until.setdefault(name, newest)
        for order in orders:
            if order["wall"] > known:
                self._note("info", str(order["robot"]), order_text(order))
        self._ordered_until[name] = max(known, newest)

    def _show_end(self, reported: Dict[str, Any]) -> None:
        self._set_status(
            running=False,
            ended=reported["ended"],
            finished=reported["finished"],
            fault=reported["fault"],
            stalled="",
        )

    def _is_ours(self, address: str, name: str) -> None:
        if self.names.get(address) != name:
            self.names = {**self.names, address: name}
            self._strangers -= {address}

    def _on_room(self, room: Dict[str, Any]) -> None:
        self._hub.set_latest("room", room)

    def _on_world(self, world: Dict[str, Any]) -> None:
        self._hub.show_world(world)

    def _on_poses(self, poses: Mapping[str, RobotPose]) -> None:
        """Show where the robots are. :param poses: address -> pose."""
        names = self.names
        robots = {names[address]: pose for address, pose in poses.items() if address in names}
        self._on_world({"robots": robots})

    def _on_map(self, room: Dict[str, Any]) -> None:
        self._hub.set_latest("room", room)

    def _on_unreachable(self, why: str) -> None:
        """Show why the team cannot be reached; "" once it can be reached again."""
        self._set_status(unreachable=why)

    def _on_obeyed(self, order: PageOrder) -> None:
        """Handle an order that is in the team's log: ask for its effect soon. A stop is shown at
        once, since the robots leave and there may be none left to ask."""
        command, _, argument = order
        if command == "stop":
            self._set_status(running=False, ended=argument, stalled="")
        self._ask_now.set()

    # -- asking the team ---------------------------------------------------------------------------

    def _ask_around(self) -> None:
        """Find the robots and ask them for the team's state, on the second thread."""
        while not self._stop.is_set():
            lost_track = self._follower.lost_track
            self._ask_now.clear()
            why = ""
            try:
                self._known = self._connection.find()
                heard = self.statuses(self._askable(), self._asking)
                self._queue.put(("answers", lost_track, heard, self._ask_plan(heard)))
            except UnreachableError as error:
                why = str(error)
                self._connection.report("the page: %s" % why)
            if why != self._status["unreachable"]:
                self._queue.put(("unreachable", why))
            self._ask_now.wait(SEARCH_EVERY)

    def _ask_plan(self, heard: List[StatusAnswer]) -> Optional[DeployedPlan]:
        """The plan that the team of the run shown now follows, if it is not the one shown; on the
        second thread."""
        others = [
            (address, status)
            for address, status in heard
            if status["plan"] != self._hash
            and (status["run"] == self.run if self.run else status.get("began_with") == self._given)
        ]
        for address, status in sorted(others, key=lambda a: -int(a[1]["log_length"])):
            request = OperatorRequest("plan", run=status["run"])
            answer = ask_robots(self._asking, {address: ""}, request, STATUS_TIME + 0.2)[address]
            found = read_deployed(status["run"], answer.message) if answer else None
            if found is not None and found.plan.hash() == status["plan"]:
                return found if found.number > self._stage else None
        return None

    def _follow(self, deployed: DeployedPlan, heard: List[StatusAnswer]) -> None:
        """Show the run under the plan that its team now follows.

        :param heard: the robots' answers; at least one robot follows the plan.
        """
        old, new = self.plan, deployed.plan
        self.plan, self._net, self._hash = new, new.net, new.hash()
        self._stage = deployed.number
        statuses = [s for _, s in heard if (s["plan"], s["run"]) == (self._hash, self.run)]
        newest = max(statuses, key=lambda s: int(s["log_length"]))
        self._before = team_seen(self.plan, newest, statuses)
        self._follower = FiredFollower(new)
        self._follower.adopt(self._before, "")
        number = len(self._plans) + 1
        self._plans[number] = new
        enabled = EnabledSet(new.net, self._before.marking, by_priority=False)
        names = NewNames(old, new, deployed.mapping)
        event = plan_event(number, old, new, names, enabled)
        for shown in self._shown.values():
            shown["place"] = renumbered(shown.get("place"), event["places"])
        self._hub.publish(event)
        for name, seen in self._follower.robots.items():
            self._show_robot(name, place=seen.place)
        if self._comparison is not None:
            self._comparison = self._comparison.go_on(new)

    def _is_elsewhere(self, status: Dict[str, Any]) -> bool:
        """Whether a robot of the run shown follows another of its team's plans, because its log or
        the page lags behind."""
        ours = bool(self._stage) or status.get("began_with") == self._given
        return ours and status["run"] == self.run and status["plan"] != self._hash

    def _on_answers(
        self, lost_track: bool, heard: List[StatusAnswer], deployed: Optional[DeployedPlan]
    ) -> None:
        answers = []
        if not self.run:
            same_plan = [s for _, s in heard if self._hash in (s["plan"], s.get("began_with"))]
            for status in sorted(same_plan, key=lambda s: bool(s["ended"]))[:1]:
                self._show_run(status["run"])
        if deployed is not None and (deployed.run, deployed.number > self._stage) == (
            self.run,
            True,
        ):
            self._follow(deployed, heard)
        unplaced = list(self._unplaced)
        if not any(self._is_elsewhere(status) for _, status in heard):
            self._unplaced.clear()  # the rest arrived late and belongs to an earlier plan
        for message in unplaced:
            if message.plan == self._hash:
                self._on_fired(message)
        for address, status in heard:
            if self._is_elsewhere(status):
                continue
            if self._is_shown(status["plan"], status["run"]):
                self._is_ours(address, status["robot"])
                answers.append(status)
        if not answers:
            self._silent += 1
            if lost_track:
                self._hub.publish(*self._follower.give_up("firings were missed"))
            if self._silent >= SILENT_SCANS and self._status["running"]:
                self._set_status(
                    running=False, ended="no robot answers any more", stalled="", fault=True
                )
            return
        self._silent = 0
        newest = max(answers, key=lambda a: int(a["log_length"]))
        team, before = team_seen(self.plan, newest, answers), self._before
        self._before = team
        self._note_deafness(team, before)
        # Firings that are also behind the previous answer were lost, not merely in transit.
        behind = self._follower.is_behind(team) and (
            before is None or self._follower.is_behind(before)
        )
        behind = behind or self._follower.gone != team.gone
        if lost_track or behind:
            why = "opened in mid-run" if before is None else "caught up with the team"
            self._hub.publish(*self._follower.adopt(team, why))
            for name, seen in self._follower.robots.items():
                self._show_robot(name, place=seen.place)
        self._show_members(team)
        if before is None and self._comparison is not None:
            self._compare_with_team(self._comparison)
        self._show_status(newest)

    def _show_members(self, team: TeamSeen) -> None:
        """Show the robots that the team names, and drop those that it does not name and that do not
        report."""
        shown = self._hub.board().robots
        heard = set(self.names.values())
        known = {name: seen for name, seen in self._follower.robots.items() if name in heard}
        self._follower.meet({**known, **team.robots})
        for name, seen in self._follower.robots.items():
            if "place" not in shown.get(name, {}):
                phase = None if "phase" in shown.get(name, {}) else Phase.UNHEARD
                self._show_robot(name, phase=phase, place=seen.place)
        nobody = [name for name in shown if name not in self._follower.robots and name not in heard]
        if nobody:
            self._shown = {n: reported for n, reported in self._shown.items() if n not in nobody}
            self._hub.publish({"k": "robots", "r": [], "gone": nobody})

    def _compare_with_team(self, comparison: LiveComparison) -> None:
        """Predict the run with the robots heard, if they are not those of the plan."""
        there = set(self._follower.robots) - self._follower.gone
        if there and there != {robot.name for robot in self.plan.robots}:
            self._comparison = comparison.go_on(self.plan)

    def _note_deafness(self, team: TeamSeen, before: Optional[TeamSeen]) -> None:
        """Warn once if the team makes progress but none of its firings is received: the topic may
        have another name here."""
        if self._heard:
            self._unheard = 0
        elif before is not None and team.marking != before.marking:
            self._unheard += 1
            if self._unheard == UNHEARD:
                self._note(
                    "warning",
                    "",
                    "the team progresses, but no firing is received%s: the page shows what robots "
                    "answer every %g s" % (self._connection.why_unheard(), SEARCH_EVERY),
                )
        self._heard = False

    def _askable(self) -> List[str]:
        """The robots to ask: one in full synchronisation, where each knows the whole team; all in
        partial synchronisation, where each only knows itself."""
        names, strangers = self.names, self._strangers
        addresses = sorted(self._known - strangers)
        if self._follower.full and self._before is not None and not self._silent:
            there = [n for n in sorted(names) if names[n] not in self._follower.gone] or addresses
            self._turn += 1  # in turn, since a dead robot would not answer
            return [there[self._turn % len(there)]] if there else []
        return addresses

    def statuses(self, addresses: List[str], line: RobotLine) -> List[StatusAnswer]:
        """The robots' answers about the team, without late ones."""
        request = OperatorRequest("status", argument="brief", run=self.run)
        answers = ask_robots(line, dict.fromkeys(addresses, ""), request, STATUS_TIME + 0.2)
        found = []
        for address, answer in answers.items():
            if answer is not None and answer.success:  # otherwise it is in another run
                found += self._read_answer(address, answer.message)
        return found

    def _read_answer(self, address: str, message: str) -> List[StatusAnswer]:
        """A robot's answer about the team; an empty list if it cannot be read."""
        status = read_status(message)
        if status is not None:
            return [(address, status)]
        if address not in self._unread:
            self._unread.add(address)
            self._connection.report(
                "the page: the answer of %s to 'status' cannot be read: %.80r"
                % (self._connection.label(address), message)
            )
        return []

    def _show_status(self, status: Dict[str, Any]) -> None:
        for robot in status["robots"]:
            phase = Phase.of_state(robot["state"]).logged
            was = Phase.of_value(self._shown.get(robot["robot"], {}).get("phase", ""))
            silent = robot["robot"] not in self.names.values()  # does not publish
            if silent or phase.gone or was.gone:  # a robot that left cannot report it
                self._show_robot(robot["robot"], phase=phase, why=robot["waits_for"])
            self._show_extras(robot)
        reported = status.get("breakpoints", {})
        names = [*reported.get("places", ()), *reported.get("transitions", ())]
        if self._hub.info.get("breakpoints", []) != names:
            self._hub.change_info(breakpoints=names)
        if "data" in status:
            self._hub.publish(*data_event(self._data, status["data"]))
        phases = [Phase.of_state(r["state"]) for r in status["robots"]]
        acting = [p for p in phases if not (p.gone or p.report.at_rest)]
        waits = [r for r in status["robots"] if r["waits_for"]]
        stalled = acting and all(p.logged is Phase.DONE or p.report.failed for p in acting)
        if status["ended"]:
            self._show_end(status)
            return
        why = ""
        if status.get("stuck") or status.get("astray"):
            why = "%s %s" % (status["robot"], status["waits_for"])
        elif stalled:
            why = ", ".join("%s %s" % (r["robot"], r["waits_for"]) for r in waits[:3])
        self._set_status(running=True, paused=bool(status["paused"]), ended=None, stalled=why)

    # -- publishing on the hub ---------------------------------------------------------------------

    def _show_robot(self, name: str, phase: Optional[Phase] = None, **fields: Any) -> None:
        if phase is not None:
            fields["phase"] = phase.value
        shown = self._shown.setdefault(name, {"name": name})
        changed = {k: v for k, v in fields.items() if v is not None and shown.get(k) != v}
        if changed:
            shown.update(changed)
            event: Event = {"k": "robots", "r": [{"name": name, **changed}], "gone": []}
            self._hub.publish(event)

    def _show_extras(self, reported: Dict[str, Any]) -> None:
        """Show the data, task and held events of a robot, if it has had any."""
        shown = self._shown.get(reported["robot"], {})
        known: List[str] = [k for k in ("data", "task", "held", "resumed_from") if k in reported]
        new = {k: reported[k] for k in known if reported[k] or shown.get(k)}
        new = {k: v for k, v in new.items() if shown.get(k) != v}
        if new:
            self._shown.setdefault(reported["robot"], {"name": reported["robot"]}).update(new)
            self._hub.publish(
                {"k": "robots", "r": [{"name": reported["robot"], **new}], "gone": []}
            )

    def _set_status(self, **fields: Any) -> None:
        changed = {k: v for k, v in fields.items() if self._status.get(k) != v}
        if changed:
            self._status.update(changed)
            self._hub.publish({"k": "status", "status": changed})

    def _note(self, level: str, robot: str, text: str) -> None:
        self._hub.publish(note_event(level, text, robot))

    def _report_departures(self, found: Departures) -> None:
        self._connection.report_departures(self.plan, self.run, found)
