"""LIVE on ROS: a page that watches a team without being one of its robots.

One thread with one queue does the work. ROS callbacks only put messages into the queue. So does a
second thread, which asks the team for its state, since an answer may take a while.
"""

from __future__ import annotations

import contextlib
import json
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
    Type,
)

import genpy
import rospy
from std_msgs.msg import String

from gspn_framework_package.analysis.preflight import check
from gspn_framework_package.execution.breakpoints import Breakpoints
from gspn_framework_package.execution.enabled_set import EnabledSet
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.plan_change import NewNames, stage_of
from gspn_framework_package.execution.told_data import order_text
from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.msg import FiredTransition
from gspn_framework_package.ros.messages import FIRED_TOPIC
from gspn_framework_package.ros.team_orders import TeamOrders
from gspn_framework_package.ros.transport.registration import (
    MASTER_ERRORS,
    master_proxy,
    published_topics,
)
from gspn_framework_package.ros.transport.service_calls import ServiceCalls
from gspn_framework_package.srv import Command, CommandRequest, CommandResponse
from gspn_framework_package.team.addressing import read_status
from gspn_framework_package.team.deploy_team import DeployOutcome, DeployTeam, Votes
from gspn_framework_package.team.seal import TeamKey
from gspn_framework_package.visualizer.activity import (
    Activity,
    Fields,
    Handler,
    names_field,
    text_field,
)
from gspn_framework_package.visualizer.board import Event, data_event, plan_event, renumbered
from gspn_framework_package.visualizer.deployed_plan import DeployedPlan, read_deployed
from gspn_framework_package.visualizer.feedback import Feedback
from gspn_framework_package.visualizer.fired_follower import (
    FiredFollower,
    RobotSeen,
    TeamSeen,
)
from gspn_framework_package.visualizer.hub import Hub
from gspn_framework_package.visualizer.live_comparison import LiveComparison
from gspn_framework_package.visualizer.ros_prediction import RosPrediction
from gspn_framework_package.visualizer.submissions import submission

ACTIVITY = "/activity"

LOOK_AROUND = 2.0
"""Seconds between two searches for robots, and between two requests for the team's state."""

ANSWER_TIME = 1.5
"""Seconds within which a robot must report the team's state."""

ORDER_TIME = 6.0
"""Time limit of an order in seconds; a robot allows 5 s for its entry into the log."""

SILENT = 3
"""Number of unanswered requests after which the run is considered over."""

UNPLACED = 500
"""Largest number of firings that wait until it is known under which plan they happened."""

UNHEARD = 3
"""Number of consecutive answers that show progress of the team without any received firing, after
which the page warns the viewer."""

Order = Tuple[str, str, str]
"""An order to the team: the command, the robot and the argument of the Command service."""

Answer = Tuple[str, Dict[str, Any]]
"""The namespace of a robot, and the status in its answer."""


class RosWatch(Activity):
    """Watches a team that runs ``plan``.

    Subscribes to ``/fired_transitions`` (gspn_framework_package/FiredTransition), to every existing
    ``NAMESPACE/activity`` (std_msgs/String), to ``/world/room`` and ``/world/state``
    (std_msgs/String). Calls ``NAMESPACE/command`` (gspn_framework_package/Command) for ``status``
    at intervals, and for the orders of the page. No robot waits for the page.

    Other teams may run on the same master. Only robots of the plan and run shown are listed,
    followed and given orders, and every order names the run.

    :param plan: the plan, with its initial robots.
    :param run: the run to show; "" takes the first run of this plan that is heard.
    :param key: the key of the team, to give orders; None if it has none.
    """

    mode = "LIVE"

    def __init__(self, plan: Plan, run: str = "", key: Optional[TeamKey] = None) -> None:
        super().__init__()
        self._orders = TeamOrders(key, "the page")
        self._plan = plan
        self._net: Net = plan.net
        self._hash = self._given = plan.hash()
        self._plans: Dict[int, Plan] = {}
        """Number -> plan that the team went on under."""
        self._stage = 0
        """Number of the stage of the plan shown, 0 for the plan that was given."""
        self._unplaced: Deque[FiredTransition] = deque(maxlen=UNPLACED)
        """Firings under a plan that is not known yet."""
        self._run = run
        self._queue: queue.SimpleQueue[Tuple[str, Any]] = queue.SimpleQueue()
        self._topics: Set[str] = set()
        # namespace -> robot; replaced as a whole, never modified: three threads read it
        self._names: Dict[str, str] = {}
        self._strangers: FrozenSet[str] = frozenset()
        self._follower = FiredFollower(plan)
        self._shown: Dict[str, Dict[str, Any]] = {}
        self._data: Dict[str, Any] = {}
        self._status: Dict[str, Any] = {}
        self._others: Set[Tuple[str, str]] = set()
        self._unread: Set[str] = set()
        self._ordered_until: Dict[str, float] = {}
        """Robot -> time of the last order that was noted (seconds since 1970)."""
        self._early: Dict[str, String] = {}
        self._subscribers: List[rospy.Subscriber] = []
        self._comparison: Optional[LiveComparison] = None
        self._stop = threading.Event()
        self._asking, self._ordering = ServiceCalls(ANSWER_TIME), ServiceCalls(ORDER_TIME)
        self._ask_now = threading.Event()
        self._turn = self._silent = 0
        self._before: Optional[TeamSeen] = None
        self._heard = True
        self._unheard = 0
        self.commands = {
            "stop": self._ordered(
                lambda f: ("stop", "", text_field(f, "reason", "") or "stopped on the page")
            ),
            "pause": self._ordered(lambda f: ("pause", text_field(f, "robot", ""), "")),
            "resume": self._ordered(lambda f: ("resume", text_field(f, "robot", ""), "")),
            "retry": self._ordered(lambda f: ("retry", text_field(f, "robot"), "")),
            "evict": self._ordered(lambda f: ("evict", text_field(f, "robot"), "")),
            "leave": self._ordered(lambda f: ("leave", text_field(f, "robot"), "")),
            "set_place": self._ordered(self._set_place),
            "fire": self._ordered(self._fire),
            "submit": self._ordered(self._submit),
            "breakpoints": self._set_breakpoints,
        }

    def plan_of(self, number: int) -> Optional[Plan]:
        """See :class:`Activity`."""
        return self._plans.get(number)

    def begin(self, hub: Hub) -> None:
        """Subscribe, and start asking the team for its state."""
        self._hub = hub
        self._feedback = Feedback(hub)
        self._status = {
            "run": self._run,
            "running": False,
            "paused": False,
            "ended": None,
            "finished": False,
            "stalled": "",
            "fault": False,
        }
        info = {"commands": sorted([*self.commands, "deploy"]), "says": "a team of robots on ROS"}
        hub.restart(self.mode, self._follower.board(self._status), info)
        prediction = RosPrediction()
        self._comparison = LiveComparison(
            self._plan,
            hub,
            complete=False,
            # no run may be chosen yet
            listener=lambda *told: prediction.tell(self._plan, self._run, *told),
        )
        self._subscribe(FIRED_TOPIC, FiredTransition, "fired")
        self._subscribe("/world/room", String, "room")
        self._subscribe("/world/state", String, "world")
        threading.Thread(target=self._work, name="watch", daemon=True).start()
        threading.Thread(target=self._ask_around, name="ask", daemon=True).start()

    def end(self) -> None:
        """Unsubscribe."""
        self._stop.set()
        if self._comparison is not None:
            self._comparison.end()
        for subscriber in self._subscribers:
            subscriber.unregister()
        self._subscribers = []
        self._asking.close()
        self._ordering.close()

    def _subscribe(self, topic: str, kind: Type[genpy.Message], what: str, who: str = "") -> None:
        def callback(message: genpy.Message) -> None:
            self._queue.put((what, (who, message) if who else message))

        self._subscribers.append(
            rospy.Subscriber(topic, kind, callback, queue_size=10_000, tcp_nodelay=True)
        )

    # -- the worker --------------------------------------------------------------------------------

    def _work(self) -> None:
        while not self._stop.is_set():
            try:
                what, message = self._queue.get(timeout=0.1)
            except queue.Empty:
                what, message = "nothing", None
            try:
                getattr(self, "_on_" + what)(message)
                self._hub.publish(*self._follower.retry(time.monotonic()))
            except Exception as error:  # logged; the page continues
                rospy.logerr_throttle(5.0, "the page: %s: %s" % (type(error).__name__, error))
            if self._follower.lost_track:
                self._ask_now.set()

    def _on_nothing(self, message: None) -> None:
        """Handle the absence of messages."""

    def _on_fired(self, message: FiredTransition) -> None:
        if not self._run and message.plan == self._hash:
            self._show_run(message.run)
        if message.run == self._run and message.plan != self._hash:
            if not self._unplaced:
                self._ask_now.set()
            self._unplaced.append(message)  # until it is known what the team follows
        elif self._is_shown(message.plan, message.run):
            self._heard = True
            self._hub.publish(*self._follower.take(message, time.monotonic()))

    def _is_shown(self, plan: str, run: str) -> bool:
        """Whether a message belongs to the plan and run that the page shows. The first message of
        another run produces a note."""
        if (plan, run) == (self._hash, self._run):
            return True
        if (plan, run) not in self._others:
            self._others.add((plan, run))
            if run == self._run:
                text = (
                    "run '%s' has another plan, or another number of robots, "
                    "than this page was given"
                )
            elif plan == self._hash:
                text = "run '%s' on this master has the same plan; it is not shown"
            else:
                text = "run '%s' on this master has another plan; it is not shown"
            self._note("warning", "", text % run)
        return False

    def _show_run(self, run: str) -> None:
        """Show this run, since none was chosen, with the activity its robots published earlier."""
        self._run = run
        self._set_status(run=run)
        early, self._early = self._early, {}
        for told in early.items():
            self._on_activity(told)

    def _on_activity(self, told: Tuple[str, String]) -> None:
        namespace, message = told
        activity = json.loads(message.data)
        name = str(activity["robot"])
        if activity["run"] == self._run and activity["plan"] != self._hash and self._run:
            self._ask_now.set()  # the team may follow another plan
            return
        if not self._run:  # it may be left over from a run that has ended
            self._early[namespace] = message
            return
        if not self._is_shown(str(activity["plan"]), str(activity["run"])):
            self._names = {n: robot for n, robot in self._names.items() if n != namespace}
            self._strangers |= {namespace}
            return
        self._is_ours(namespace, name)
        if activity["ended"]:  # the robots leave soon; later, none may answer
            self._show_end(activity)
        phase = Phase.of_state(str(activity.get("state", "")))
        waits = str(activity.get("waits_for", ""))
        self._show_robot(
            name,
            # a halted robot does not continue by itself either
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
            self._feedback.tell(name, "feedback: %s" % ", ".join(str(f) for f in feedback))
        else:
            self._feedback.forget(name)

    def _show_orders(self, name: str, orders: List[Dict[str, Any]]) -> None:
        """Note the orders that a robot was given since it was first heard."""
        newest = max((float(order["wall"]) for order in orders), default=0.0)
        known = self._ordered_until.setdefault(name, newest)
        for order in orders:
            if order["wall"] > known:
                self._note("info", str(order["robot"]), order_text(order))
        self._ordered_until[name] = max(known, newest)

    def _show_end(self, told: Dict[str, Any]) -> None:
        self._set_status(
            running=False,
            ended=told["ended"],
            finished=told["finished"],
            fault=told["fault"],
            stalled="",
        )

    def _is_ours(self, namespace: str, name: str) -> None:
        if self._names.get(namespace) != name:
            self._names = {**self._names, namespace: name}
            self._strangers -= {namespace}

    def _on_room(self, message: String) -> None:
        self._hub.set_latest("room", json.loads(message.data))

    def _on_world(self, message: String) -> None:
        self._hub.set_latest("world", json.loads(message.data))

    def _on_obeyed(self, order: Order) -> None:
        """Handle an order that is in the team's log: ask soon for its effect. A stop is shown at
        once: the robots leave, and there may be none left to ask."""
        command, _, argument = order
        if command == "stop":
            self._set_status(running=False, ended=argument, stalled="")
        self._ask_now.set()

    # -- asking the team ---------------------------------------------------------------------------

    def _ask_around(self) -> None:
        """Find the robots and ask them for the team's state, on the asking thread."""
        while not self._stop.is_set() and not rospy.is_shutdown():
            lost_track = self._follower.lost_track
            self._ask_now.clear()
            try:
                self._find_robots()
                heard = self._ask(self._askable())
                self._queue.put(("answers", (lost_track, heard, self._ask_plan(heard))))
            except MASTER_ERRORS as error:
                rospy.logwarn_throttle(30.0, "the page: the master does not answer: %s" % error)
            self._ask_now.wait(LOOK_AROUND)

    def _find_robots(self) -> None:
        for topic, kind in published_topics(ANSWER_TIME):
            namespace = topic[: -len(ACTIVITY)]
            if topic.endswith(ACTIVITY) and kind == String._type and namespace not in self._topics:
                self._topics.add(namespace)
                self._subscribe(topic, String, "activity", namespace)

    def _ask_plan(self, heard: List[Answer]) -> Optional[DeployedPlan]:
        """The plan that the team of the run shown went on under, if it is not the one shown; on the
        asking thread."""
        others = [
            (namespace, status)
            for namespace, status in heard
            if status["plan"] != self._hash
            and (
                status["run"] == self._run if self._run else status.get("began_with") == self._given
            )
        ]
        for namespace, status in sorted(others, key=lambda a: -int(a[1]["log_length"])):
            answers: queue.SimpleQueue[Tuple[str, CommandResponse]] = queue.SimpleQueue()
            request = CommandRequest(command="plan", run=status["run"])
            if not self._call(namespace, request, self._asking, answers):
                continue
            with contextlib.suppress(queue.Empty):
                _, response = answers.get(timeout=ANSWER_TIME + 0.2)
                found = read_deployed(status["run"], response.message)
                if found is not None and found.plan.hash() == status["plan"]:
                    return found if found.number > self._stage else None
        return None

    def _follow(self, deployed: DeployedPlan, heard: List[Answer]) -> None:
        """Show the run under the plan that its team went on under.

        :param heard: what robots answered; at least one of them follows the plan.
        """
        old, new = self._plan, deployed.plan
        self._plan, self._net, self._hash = new, new.net, new.hash()
        self._stage = deployed.number
        statuses = [s for _, s in heard if (s["plan"], s["run"]) == (self._hash, self._run)]
        newest = max(statuses, key=lambda s: int(s["log_length"]))
        self._before = self._team_seen(newest, statuses)
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
        """Whether a robot of the run shown follows another of its team's plans: its log, or the
        page, is not that far yet."""
        ours = bool(self._stage) or status.get("began_with") == self._given
        return ours and status["run"] == self._run and status["plan"] != self._hash

    def _on_answers(self, asked: Tuple[bool, List[Answer], Optional[DeployedPlan]]) -> None:
        lost_track, heard, deployed = asked
        answers = []
        if not self._run:
            same_plan = [s for _, s in heard if self._hash in (s["plan"], s.get("began_with"))]
            for status in sorted(same_plan, key=lambda s: bool(s["ended"]))[:1]:
                self._show_run(status["run"])
        if deployed is not None and (deployed.run, deployed.number > self._stage) == (
            self._run,
            True,
        ):
            self._follow(deployed, heard)
        unplaced = list(self._unplaced)
        if not any(self._is_elsewhere(status) for _, status in heard):
            self._unplaced.clear()  # what remains came late, under an earlier plan
        for message in unplaced:
            if message.plan == self._hash:
                self._on_fired(message)
        for namespace, status in heard:
            if self._is_elsewhere(status):
                continue
            if self._is_shown(status["plan"], status["run"]):
                self._is_ours(namespace, status["robot"])
                answers.append(status)
        if not answers:
            self._silent += 1
            if lost_track:
                self._hub.publish(*self._follower.give_up("firings were missed"))
            if self._silent >= SILENT and self._status["running"]:
                self._set_status(
                    running=False, ended="no robot answers any more", stalled="", fault=True
                )
            return
        self._silent = 0
        newest = max(answers, key=lambda a: int(a["log_length"]))
        team, before = self._team_seen(newest, answers), self._before
        self._before = team
        self._note_deafness(team, before)
        # Behind the previous answer, too: firings still in transit are not lost.
        behind = self._follower.is_behind(team) and (
            before is None or self._follower.is_behind(before)
        )
        behind = behind or self._follower.gone != team.gone
        if lost_track or behind:
            why = "opened in mid-run" if before is None else "caught up with the team"
            self._hub.publish(*self._follower.adopt(team, why))
            for name, seen in self._follower.robots.items():
                self._show_robot(name, place=seen.place)
        self._show_status(newest)

    def _note_deafness(self, team: TeamSeen, before: Optional[TeamSeen]) -> None:
        """Warn once if the team makes progress but none of its firings is received: the topic may
        have another name here."""
        if self._heard:
            self._unheard = 0
        elif before is not None and team.marking != before.marking:
            self._unheard += 1
            if self._unheard == UNHEARD:
                topic = rospy.resolve_name(FIRED_TOPIC)
                self._note(
                    "warning",
                    "",
                    "the team moves, but no firing is heard on %s: the page shows what robots "
                    "answer every %g s. "
                    "Is the topic remapped, or cannot this machine reach the robots?"
                    % (topic, LOOK_AROUND),
                )
        self._heard = False

    def _askable(self) -> List[str]:
        """The robots to ask: one in full synchronisation, where each knows the whole team; all in
        partial synchronisation, where each only knows itself."""
        names, strangers = self._names, self._strangers
        namespaces = sorted(self._topics - strangers)
        if self._follower.full and self._before is not None and not self._silent:
            there = [n for n in sorted(names) if names[n] not in self._follower.gone] or namespaces
            self._turn += 1  # in turn: a dead robot would not answer
            return [there[self._turn % len(there)]] if there else []
        return namespaces

    def _ask(self, namespaces: List[str], calls: Optional[ServiceCalls] = None) -> List[Answer]:
        """The robots' answers about the team, without those that come too late."""
        answers: queue.SimpleQueue[Tuple[str, CommandResponse]] = queue.SimpleQueue()
        request = CommandRequest(command="status", argument="brief", run=self._run)
        asked = [self._call(n, request, calls or self._asking, answers) for n in namespaces]
        found = []
        give_up = time.monotonic() + ANSWER_TIME + 0.2
        try:
            for _ in range(sum(asked)):
                namespace, response = answers.get(timeout=max(0.0, give_up - time.monotonic()))
                if response.success:  # otherwise it is in another run
                    found += self._read_answer(namespace, response.message)
        except queue.Empty:
            pass
        return found

    def _read_answer(self, namespace: str, message: str) -> List[Answer]:
        """A robot's answer about the team; an empty list if it cannot be read."""
        status = read_status(message)
        if status is not None:
            return [(namespace, status)]
        if namespace not in self._unread:
            self._unread.add(namespace)
            rospy.logwarn(
                "the page: the answer of %s to 'status' cannot be read: %.80r"
                % (namespace, message)
            )
        return []

    def _call(
        self,
        namespace: str,
        request: CommandRequest,
        calls: ServiceCalls,
        answers: queue.SimpleQueue[Tuple[str, CommandResponse]],
    ) -> bool:
        """Call a robot's ``command`` service; return whether an answer may come.

        :raises OSError: no master answers.
        """
        name = rospy.names.ns_join(namespace, "command")
        master: Any = master_proxy(ANSWER_TIME)
        code, _, uri = master.lookupService(rospy.get_name(), name)
        return code == 1 and calls.call(
            namespace,
            uri,
            name,
            Command,
            request,
            lambda response: answers.put((namespace, response)),
        )

    def _team_seen(self, newest: Dict[str, Any], answers: List[Dict[str, Any]]) -> TeamSeen:
        robots: Dict[str, RobotSeen] = {}
        for answer in [newest] + answers:
            for robot in answer["robots"]:
                own = robot["robot"] == answer["robot"]
                known = robots.get(robot["robot"])
                if known is None or own or (known.visit or 0) < robot["visit"]:
                    place = self._net.place_index.get(robot["place"], -1)
                    robots[robot["robot"]] = RobotSeen(place, int(robot["visit"]))
        marking = self._net.marking(newest["marking"])
        gone = frozenset(r["robot"] for r in newest["robots"] if Phase.of_state(r["state"]).gone)
        if not self._follower.full:
            counts = [
                n if p.name in self._plan.resource_places else 0
                for p, n in zip(self._net.places, marking)
            ]
            for name, seen in robots.items():
                if seen.place >= 0 and name not in gone:
                    counts[seen.place] += 1
            marking = tuple(counts)
        return TeamSeen(marking, robots, int(newest["log_length"]), gone)

    def _show_status(self, status: Dict[str, Any]) -> None:
        for robot in status["robots"]:
            phase = Phase.of_state(robot["state"]).logged
            was = Phase.of_value(self._shown.get(robot["robot"], {}).get("phase", ""))
            silent = robot["robot"] not in self._names.values()  # does not publish
            if silent or phase.gone or was.gone:  # a robot that left cannot report it
                self._show_robot(robot["robot"], phase=phase, why=robot["waits_for"])
            self._show_extras(robot)
        told = status.get("breakpoints", {})
        names = [*told.get("places", ()), *told.get("transitions", ())]
        if self._hub.info.get("breakpoints", []) != names:
            self._hub.change_info(breakpoints=names)
        if "data" in status:
            self._hub.publish(*data_event(self._data, status["data"]))
        phases = [Phase.of_state(r["state"]) for r in status["robots"]]
        acting = [p for p in phases if not (p.gone or p.told.at_rest)]
        waits = [r for r in status["robots"] if r["waits_for"]]
        stalled = acting and all(p.logged is Phase.DONE or p.told.failed for p in acting)
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

    def _show_extras(self, told: Dict[str, Any]) -> None:
        """Show the data, the task and the held events of a robot, as far as it has had any."""
        shown = self._shown.get(told["robot"], {})
        known: List[str] = [k for k in ("data", "task", "held", "resumed_from") if k in told]
        new = {k: told[k] for k in known if told[k] or shown.get(k)}
        new = {k: v for k, v in new.items() if shown.get(k) != v}
        if new:
            self._shown.setdefault(told["robot"], {"name": told["robot"]}).update(new)
            self._hub.publish({"k": "robots", "r": [{"name": told["robot"], **new}], "gone": []})

    def _set_status(self, **fields: Any) -> None:
        changed = {k: v for k, v in fields.items() if self._status.get(k) != v}
        if changed:
            self._status.update(changed)
            self._hub.publish({"k": "status", "status": changed})

    def _note(self, level: str, robot: str, text: str) -> None:
        self._hub.publish({"k": "note", "level": level, "robot": robot, "text": text})

    # -- the page's orders -------------------------------------------------------------------------

    def _ordered(self, order_from: Callable[[Fields], Order]) -> Handler:
        def run(fields: Fields) -> Dict[str, Any]:
            return self._order(order_from(fields))

        return run

    def _set_place(self, fields: Fields) -> Order:
        place = text_field(fields, "place")
        self._net.place_number(place)
        return "set_place", text_field(fields, "robot"), place

    def _fire(self, fields: Fields) -> Order:
        name = text_field(fields, "transition")
        self._net.transition_number(name)
        return "fire", "", name

    def _submit(self, fields: Fields) -> Order:
        task = submission(self._plan, fields)
        return "submit", "", json.dumps(task._asdict())

    def _order(self, order: Order) -> Dict[str, Any]:
        """Send an order to the robots of the run in turn, until one answers.

        :raises RefusedError: the order was not carried out.
        """
        command, robot, argument = order
        for namespace in self._first_to_order(command, robot):
            asked = self._names.get(namespace, "")
            request = self._orders.request(asked, command, robot, argument, self._run)
            answers: queue.SimpleQueue[Tuple[str, CommandResponse]] = queue.SimpleQueue()
            try:
                if not self._call(namespace, request, self._ordering, answers):
                    continue
                _, response = answers.get(timeout=ORDER_TIME + 0.2)
            except queue.Empty:
                continue
            except MASTER_ERRORS as error:
                raise RefusedError("the ROS master does not answer (%s)" % error) from None
            if not response.success:
                raise RefusedError(response.message)
            self._queue.put(("obeyed", order))
            return {"message": response.message}
        raise RefusedError(
            "no robot of run '%s' answers" % self._run
            if self._names
            else "no robot of the run has been heard of yet"
        )

    def _set_breakpoints(self, fields: Fields) -> Dict[str, Any]:
        """Have every robot of the run halt at these places and transitions.

        :raises RefusedError: a robot did not take them.
        """
        found = Breakpoints.of_names(names_field(fields), self._plan)
        names = json.dumps([*found.places, *found.transitions])
        answers: queue.SimpleQueue[Tuple[str, CommandResponse]] = queue.SimpleQueue()
        try:
            known = sorted(n for n, name in self._names.items() if name not in self._follower.gone)
            asked = [
                n
                for n in known
                if self._call(
                    n,
                    self._orders.request(self._names[n], "breakpoints", "", names, self._run),
                    self._ordering,
                    answers,
                )
            ]
        except MASTER_ERRORS as error:
            raise RefusedError("the ROS master does not answer (%s)" % error) from None
        silent, refusals = set(asked), []
        with contextlib.suppress(queue.Empty):
            while silent:
                namespace, response = answers.get(timeout=ORDER_TIME + 0.2)
                silent.discard(namespace)
                if not response.success:
                    refusals.append("%s: %s" % (namespace, response.message))
        self._ask_now.set()
        refusals += ["%s does not answer" % namespace for namespace in sorted(silent)]
        if refusals or not asked:
            raise RefusedError("; ".join(refusals) or "no robot of the run has been heard of yet")
        return {"message": "robots halt at: %s" % found.told}

    def deploy(
        self, plan: Plan, mapping: Mapping[str, str], tell: Callable[[Votes], None]
    ) -> DeployOutcome:
        """See :class:`Activity`. The robots find its functions where those of their plan are."""
        report = check(plan)
        if report.refused:
            raise RefusedError("the check refuses this plan: %s" % " ".join(str(report).split()))
        calls = ServiceCalls(ANSWER_TIME)

        def order(command: str, text: str) -> Tuple[bool, str]:
            try:
                return True, str(self._order((command, "", text))["message"])
            except RefusedError as error:
                return False, str(error)

        def statuses() -> List[Dict[str, Any]]:
            found = self._ask(sorted(self._names), calls)
            return [status for _, status in found if status["run"] == self._run]

        try:
            return DeployTeam(order, statuses, tell).deploy(stage_of(plan, mapping))
        except MASTER_ERRORS as error:
            raise RefusedError("the ROS master does not answer (%s)" % error) from None
        finally:
            calls.close()

    def _first_to_order(self, command: str, robot: str) -> List[str]:
        """The namespaces of the run's robots, in the order to try them: first the robot concerned
        (last, if the order is to cast it out), and at the end those that are gone."""
        names, gone = self._names, self._follower.gone
        own_last = command == "evict"
        return sorted(names, key=lambda n: (names[n] in gone, (names[n] == robot) == own_last, n))
