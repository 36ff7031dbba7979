"""Builds a plan for a map and its tasks.

A robot's place encodes its node or edge, what it does, and, if there are several, its type and the
level of its battery, so that robots of one kind in the same node are exchangeable.
``Due_TASK_NODE`` has a token while a task is due, ``Free_A_B`` one for each robot that may still
drive on an edge, and ``Free_dock_NODE`` one for each free place at a dock. ``Free_node_NODE`` and
``Free_group_NAME`` limit how many robots are in a node, and in a group of nodes and edges
(``Free_door_NAME``: a door); a robot takes its place in the next node before it drives there, opens
doors before that and closes them afterwards.
"""

from __future__ import annotations

from typing import Any, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.formats.json_file import json_text
from gspn_framework_package.formats.net_json import net_to_json
from gspn_framework_package.formats.plan_file import PLAN_FILE, plan_from_object
from gspn_framework_package.making.plan_folder import NET_FILE, POLICY_FILE, write_plan_folder
from gspn_framework_package.making.site_drawing import SiteDrawing
from gspn_framework_package.making.site_elements import DoorAction, MapEdge, MapGroup
from gspn_framework_package.making.site_goals import drive_action
from gspn_framework_package.making.site_map import read_map
from gspn_framework_package.making.site_names import named, with_clear_names
from gspn_framework_package.making.site_policy import RobotKind
from gspn_framework_package.making.site_tasks import SiteTasks, read_tasks
from gspn_framework_package.making.site_team import SiteState, SiteTeam, some_names
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import InputError, UsageError
from gspn_framework_package.model.net import Net, Point
from gspn_framework_package.model.plan import Plan

MOST_PLAN_NODES = 50_000
"""Maximum number of nodes of the net."""

PLAN_ROS_FILE = "plan_ros.json"
"""File name of the same plan with the actions of the map and the tasks, for robots on ROS."""

_DONE = {"Open": "Opened", "Close": "Closed"}
"""A robot's action at a door -> the transition that ends it."""

_UNLIMITED = " Nodes hold any number of robots (node_capacity limits it)."

_ACTIONS = '''"""What the robots do where there is no ROS: their actions only take their time."""

import random


class TakeTime:
    """Does a task, charges, or is carried to a dock."""

    def __init__(self, seconds, shape):
        self.seconds = seconds
        self.shape = shape

    def __call__(self, is_cancelled):
        """Take the time."""
        is_cancelled.wait(random.gammavariate(self.shape, self.seconds / self.shape))


class Drive(TakeTime):
    """Drives along an edge, and reads the battery there."""

    def __init__(self, seconds, shape, drained, arrive, drain):
        super().__init__(seconds, shape)
        self.drained = drained
        self.arrive = arrive
        self.drain = drain

    def __call__(self, is_cancelled):
        """Drive; return the transition for what is left in the battery."""
        super().__call__(is_cancelled)
        return self.drain if random.random() < self.drained else self.arrive
'''


class SitePlan(NamedTuple):
    """A plan that was made from a map: ``net``, ``plan`` (without net and policy), the ``actions``
    and ``events`` on ROS, ``policy``, and ``notes`` for the user.

    :ivar limits: resource place -> the nodes and edges where it limits the robots.
    :ivar moves: the pairs of nodes between which robots drive.
    :ivar rests: node -> the places of robots that are there and do nothing.
    """

    net: Net
    plan: Dict[str, Any]
    ros_actions: Dict[str, Any]
    ros_events: Dict[str, Any]
    policy: Optional[Dict[str, Any]]
    notes: List[str]
    limits: Mapping[str, MapGroup]
    moves: Sequence[Tuple[str, str]]
    rests: Mapping[str, Sequence[str]]

    def as_read(self) -> Plan:
        """Return the plan as it will be read from its file.

        :raises GspnError: it is not a plan.
        """
        parts = {} if self.policy is None else {"policy": self.policy}
        return plan_from_object({**self.plan, **parts, "net": net_to_json(self.net)}, PLAN_FILE)

    def write(self, folder: str) -> List[str]:
        """Write it into a new folder. :returns: the names of the files."""
        plan_ros: Dict[str, Any] = {
            "plan": self.plan["plan"],
            "description": self.plan["description"],
            "net": NET_FILE,
        }
        if self.policy is not None:
            plan_ros["policy"] = POLICY_FILE
        plan_ros.update((k, v) for k, v in self.plan.items() if k not in plan_ros)
        plan_ros["actions"] = self.ros_actions
        if self.ros_events:
            plan_ros["events"] = self.ros_events
        files = {
            "actions.py": _ACTIONS,
            PLAN_ROS_FILE: json_text(plan_ros),
        }
        return write_plan_folder(
            folder, self.net, self.plan, self.policy, files, (PLAN_FILE, PLAN_ROS_FILE)
        )


def build_site_plan(
    map_path: str,
    tasks_path: Optional[str],
    robots: int,
    all_edges: bool = False,
    groups: Optional[Mapping[str, MapGroup]] = None,
) -> SitePlan:
    """Build a plan from a map.

    :param tasks_path: the file of the tasks; None to let robots drive around.
    :param all_edges: keep the edges and tasks that the policy does not use.
    :param groups: further groups of mutual exclusion, of nodes by their names in the plan.
    :raises InputError: a file cannot be read, or the two do not fit together.
    """
    site = read_map(map_path)
    tasks = SiteTasks(groups=site.groups)
    if tasks_path is not None:
        tasks = read_tasks(tasks_path, site)
    try:
        site, tasks, notes = with_clear_names(site, tasks)
    except InputError as error:
        raise error.located(file=tasks_path or map_path) from None
    tasks = tasks._replace(groups={**tasks.groups, **(groups or {})})
    team = SiteTeam(site, tasks, map_path, all_edges)
    size = 4 * len(team.states)
    if size > MOST_PLAN_NODES:
        raise UsageError(
            "the net would have some %d nodes; at most %d are possible" % (size, MOST_PLAN_NODES),
            file=map_path,
            hint="fewer levels of the battery, or a smaller map",
        )
    try:
        made = _Builder(tasks.plan or site.name, team, tasks, robots).built()
    except InputError as error:
        raise error.located(file=map_path) from None
    return made._replace(notes=[*site.notes, *notes, *made.notes])


class _Builder:
    """Makes the net of a team, and the plan."""

    def __init__(self, name: str, team: SiteTeam, tasks: SiteTasks, robots: int) -> None:
        self._name, self._team, self._tasks = name, team, tasks
        self._start = [named("At", node, kind.suffix) for node, kind in team.start]
        self._robots = {
            "robot_%d" % (k + 1): self._start[k % len(self._start)] for k in range(robots)
        }
        every = [kind for kinds in team.kinds.values() for kind in kinds]
        self._draw = SiteDrawing(team.site, [kind.suffix for kind in every])
        self._net = NetBuilder(name)
        self._actions: Dict[str, Any] = {}
        self._ros: Dict[str, Any] = {}
        self._events: Dict[str, Any] = {}
        self._durations: Dict[str, Any] = {}
        self._given_back: Dict[str, Any] = {}
        self._resources: List[str] = []
        self._moves = [(state.node, state.to) for state in self._of("Drive")]
        self._single: List[str] = []
        """Nodes that hold one robot because of its size."""
        self._zones = self._limited()
        """Resource place -> the location whose robots it limits."""
        self._arrivals: Dict[Tuple[str, str, str], List[str]] = {}
        """Edge and suffix -> the places that robots enter at the end of the edge."""

    def _limited(self) -> Dict[str, MapGroup]:
        tasks, found = self._tasks, {}
        driven, site_nodes = set(self._moves), self._team.site.nodes
        visited = dict.fromkeys([*(s.node for s in self._of("At")), *(to for _, to in self._moves)])
        for pair, edge in self._team.edges.items():
            capacity = tasks.capacity if edge.capacity is None else edge.capacity
            capacity = tasks.edges.get(pair, {}).get("capacity", capacity)
            if capacity is None or pair not in driven or "Free_%s_%s" % pair[::-1] in found:
                continue
            found["Free_%s_%s" % pair] = MapGroup((), [pair], capacity)
        for node in visited:
            capacity, slots = site_nodes[node].capacity, len(site_nodes[node].slots)
            # robots with an empty battery are brought to a dock, even if it is occupied
            if capacity is None and not (tasks.battery and node in self._team.docks):
                capacity = slots or tasks.node_capacity
            capacity = tasks.nodes.get(node, capacity)
            if capacity is None and node not in tasks.nodes:
                capacity = self._capacity_by_size(node)
            if slots and (capacity or len(self._robots)) > slots:
                self._team.notes.append("%s has %d slots for more robots" % (node, slots))
            if capacity is not None:
                found["Free_node_" + node] = MapGroup([node], (), capacity)
        if self._single and tasks.diameter is not None:
            self._team.notes.append(
                "one robot at a time, because two of %g m have no room there: %s ('nodes' and "
                "'node_capacity' change that)" % (tasks.diameter, some_names(self._single))
            )
        for name, group in tasks.groups.items():
            found["Free_group_" + name] = group
        for name, door in tasks.doors.items():
            found["Free_door_" + name] = door.group
        starts = list(self._robots.values())
        at = {named("At", node, kind.suffix): node for node, kind in self._team.start}
        for free, zone in found.items():
            here = sum(at[place] in zone.nodes for place in starts)
            if here > zone.capacity:
                raise InputError(
                    "%d robots start in %s, where %d may be"
                    % (here, ", ".join(zone.nodes), zone.capacity),
                    element=free,
                    hint="choose another 'start', or a larger capacity",
                )
        for robot in self._team.kinds if tasks.battery else ():
            dock = self._team.dock_of(robot)
            for free, zone in found.items():
                if dock in zone.nodes:
                    raise InputError(
                        "robots with an empty battery are brought to %s, so it holds any number"
                        % dock,
                        element=free,
                        hint="take it out of 'nodes', 'groups' and the map's capacities",
                    )
        return found

    def _capacity_by_size(self, node: str) -> Optional[int]:
        """How many robots a node holds if neither the map nor the tasks say so: a dock as many as
        can charge there, another node one if two have no room."""
        if self._tasks.diameter is None:
            return None
        if node in self._team.docks:
            return None if self._tasks.battery else self._tasks.docks[node]
        if self._team.site.nodes[node].has_room_for_two(self._tasks.diameter):
            return None
        self._single.append(node)
        return 1

    def _held(self, node: str, to: str = "") -> List[str]:
        """The resources that a robot holds in a node; with ``to``, those on the edge to that node,
        including its place there."""
        return [
            free
            for free, zone in self._zones.items()
            if (to or node) in zone.nodes
            or to
            and ((node, to) in zone.edges or (to, node) in zone.edges)
        ]

    def _given(self, place: str, held: Sequence[str]) -> None:
        """Have a robot that is lost in a place return the resources that it holds."""
        if held:
            self._given_back.setdefault(place, {}).update(dict.fromkeys(held, 1))

    def _of(self, what: str) -> List[SiteState]:
        return [state for state in self._team.states if state.what == what]

    def _act(self, place: str, seconds: float, ros: Any, tokens: int, position: Point) -> None:
        """Add an action place where the action takes time."""
        shape = self._tasks.shape
        self._net.place(place, tokens, position=position)
        settings = {"seconds": seconds, "shape": shape}
        self._actions[place] = {"function": "actions.TakeTime", "settings": settings}
        self._ros[place] = self._actions[place] if ros is None else ros
        self._durations[place] = {"mean": seconds, "distribution": "gamma", "shape": shape}

    def _ends(
        self, name: str, rate: float, place: str, outputs: Sequence[str], position: Point
    ) -> None:
        """Add a transition with which each robot in a place ends its action there."""
        self._net.exponential(name, rate, None, inputs=place, outputs=outputs, position=position)

    def _resource(self, place: str, tokens: int, position: Point) -> None:
        self._net.place(place, tokens, position=position)
        self._resources.append(place)

    def built(self) -> SitePlan:
        """Return the plan."""
        starts = list(self._robots.values())
        for state in self._of("At"):
            at = named("At", state.node, state.kind.suffix)
            position = self._draw.node(state.node, state.kind.suffix)
            self._net.place(at, starts.count(at), position=position)
            self._actions[at] = self._ros[at] = None
            self._given(at, self._held(state.node))
        first = self._team.start[0][1].suffix
        begun = {named("At", node, kind.suffix): node for node, kind in self._team.start}
        for number, (free, zone) in enumerate(self._zones.items()):
            where = self._draw.top(number, -1)
            if not zone.nodes:
                where = self._draw.along(*zone.edges[0], first, 0.5, 0)
            elif not zone.edges and len(zone.nodes) == 1:
                x, y = self._draw.node(zone.nodes[0], first)
                where = (x, y - 90)
            taken = sum(begun[place] in zone.nodes for place in starts)
            self._resource(free, zone.capacity - taken, where)
        for state in self._of("Drive"):
            self._drive(self._team.edges[state.node, state.to], state.kind)
        for state in self._of("Go"):
            self._go(state.node, state.to, state.kind.suffix)
        for number, (task, node) in enumerate(self._team.due):
            self._task(number, task, node)
        if self._tasks.battery:
            self._charging()
        site, policy = self._team.site, self._policy() if self._team.rows else None
        tasks = ", ".join(self._tasks.tasks) or "driving around"
        about = "Robots on a map of %d nodes: %s." % (len(site.nodes), tasks)
        limited = any(zone.nodes for zone in self._zones.values())
        plan: Dict[str, Any] = {
            "plan": self._name,
            "description": about if limited else about + _UNLIMITED,
            "actions": self._actions,
            "resource_places": self._resources,
            "environment": "simulate",
            "robots": self._robots,
            "spawn": self._start,
            "on_failure": {"*": {"retry": 3, "delay": 1}},
            "on_evict": self._given_back,
            "durations": self._durations,
        }
        rests: Dict[str, List[str]] = {}
        for state in self._of("At"):
            rests.setdefault(state.node, []).append(named("At", state.node, state.kind.suffix))
        return SitePlan(
            self._net.build(),
            plan,
            self._ros,
            self._events,
            policy,
            self._team.notes,
            self._zones,
            self._moves,
            rests,
        )

    def _drive(self, edge: MapEdge, kind: RobotKind) -> None:
        a, b, suffix = edge.source, edge.target, kind.suffix
        seconds = self._team.seconds(edge)
        drained = self._tasks.battery.get(kind.level, 0.0)
        drive, arrive = named("Drive", a, b, suffix), named("Arrive", a, b, suffix)
        drain = named("Drain", a, b, suffix)
        held = self._held(a, b)
        ros = drive_action(edge, self._team.site.nodes[b], arrive, self._tasks.diameter)
        self._act(drive, seconds, ros, 0, self._draw.along(a, b, suffix, 0.48))
        self._given(drive, held)
        there = self._arrival(a, b, suffix)
        at = self._draw.along(a, b, suffix, 0.7)
        self._ends(arrive, (1 - drained) / seconds, drive, there, at)
        if drained:
            settings = self._actions[drive]["settings"]
            settings.update(drained=drained, arrive=arrive, drain=drain)
            self._actions[drive]["function"] = "actions.Drive"
            lower = self._after_drain(edge, kind, drain, held)
            at = self._draw.along(a, b, suffix, 0.7, 2.2)
            self._ends(drain, drained / seconds, drive, lower, at)

    def _after_drain(
        self, edge: MapEdge, kind: RobotKind, drain: str, held: Sequence[str]
    ) -> List[str]:
        """The place of a robot whose level ends on an edge: at the end of the edge; or, if the
        battery is read on ROS, still on the edge, so that it does not count as free."""
        lower, topic = self._team.lower(kind), self._tasks.battery_topic
        charge = None if topic is None else topic.below[lower.level] if lower else topic.empty
        if topic is not None and charge is not None:
            self._events[drain] = topic.event(charge)
        if lower is None:
            return [self._stranded(kind.type), *held]
        if topic is None:
            return self._arrival(edge.source, edge.target, lower.suffix)
        return [named("Drive", edge.source, edge.target, lower.suffix)]

    def _go(self, a: str, b: str, suffix: str) -> None:
        before, after = self._held(a), self._held(a, b)
        first = named("Drive", a, b, suffix)
        entered = self._doors("Open", [free for free in after if free not in before])
        for number, (name, action) in enumerate(reversed(entered)):
            along = [
                self._draw.along(a, b, suffix, part, 2.5 + 0.8 * number) for part in (0.25, 0.35)
            ]
            self._door("Open", [name, a, b, suffix], action, after, [first], along)
            first = named("Open", name, a, b, suffix)
        self._net.immediate(
            named("Go", a, b, suffix),
            inputs=[named("At", a, suffix), *(free for free in after if free not in before)],
            outputs=[first, *(free for free in before if free not in after)],
            position=self._draw.along(a, b, suffix, 0.25),
        )

    def _door(
        self,
        word: str,
        parts: Sequence[str],
        action: DoorAction,
        held: Sequence[str],
        outputs: Sequence[str],
        along: Sequence[Point],
    ) -> None:
        """Have a robot on an edge open a door, or close it: add the place and the transition at the
        points ``along`` the edge."""
        place, done = named(word, *parts), named(_DONE[word], *parts)
        self._act(place, action.seconds, action.action, 0, along[0])
        self._given(place, held)
        self._ends(done, 1 / action.seconds, place, outputs, along[1])

    def _doors(self, word: str, free: Sequence[str]) -> List[Tuple[str, DoorAction]]:
        """The doors among resources that robots open, or close."""
        return [
            (name, action)
            for name, door in self._tasks.doors.items()
            if "Free_door_" + name in free
            for action in [door.open if word == "Open" else door.close]
            if action is not None
        ]

    def _arrival(self, a: str, b: str, suffix: str) -> List[str]:
        """The places of a robot at the end of an edge, with the resources that it returns: in the
        node, if no door has to be closed first."""
        if (a, b, suffix) in self._arrivals:
            return self._arrivals[a, b, suffix]
        there = self._held(b)
        returned = [free for free in self._held(a, b) if free not in there]
        first = [named("At", b, suffix)]
        for number, (name, action) in enumerate(reversed(self._doors("Close", returned))):
            free = "Free_door_" + name
            there.append(free)
            returned.remove(free)
            along = [
                self._draw.along(a, b, suffix, part, 2.5 + 0.8 * number) for part in (0.78, 0.88)
            ]
            self._door("Close", [name, a, b, suffix], action, there, [*first, free], along)
            first = [named("Close", name, a, b, suffix)]
        self._arrivals[a, b, suffix] = [*first, *returned]
        return self._arrivals[a, b, suffix]

    def _stranded(self, robot: str) -> str:
        return named("Stranded", robot if len(self._team.kinds) > 1 else "")

    def _task(self, number: int, task: str, node: str) -> None:
        given = self._tasks.tasks[task]
        here = "%s_%s" % (task, node)
        due, fresh = "Due_" + here, "Fresh_" + here
        self._resource(due, 1, self._draw.top(number, 0))
        self._resource(fresh, 0, self._draw.top(number, 2))
        self._net.exponential(
            "Falls_due_" + here,
            1 / given.again_after,
            inputs=fresh,
            outputs=due,
            position=self._draw.top(number, 1),
        )
        side = [t for t, n in self._team.due[:number] if n == node]
        for state in self._of("Start"):
            if (state.to, state.node) != (task, node):
                continue
            suffix = state.kind.suffix
            place = named(here, suffix)
            at, off = named("At", node, suffix), 60 * len(side)
            x, y = self._draw.node(node, suffix)
            self._act(place, given.seconds, given.action, 0, (x + 120 + off, y + 60 + off))
            self._given(place, [due, *self._held(node)])
            self._net.immediate(
                named("Start", here, suffix),
                inputs=[at, due],
                outputs=place,
                position=(x + 90 + off, y + 20 + off),
            )
            finished, beside = named("Finished", here, suffix), (x + 40 + off, y + 80 + off)
            self._ends(finished, 1 / given.seconds, place, [at, fresh], beside)

    def _charging(self) -> None:
        tasks, first = self._tasks, self._team.start[0][1].suffix
        for dock in dict.fromkeys(state.node for state in self._of("Dock")):
            x, y = self._draw.node(dock, first)
            self._resource("Free_dock_" + dock, tasks.docks[dock], (x - 160, y))
        for state in self._of("Dock"):
            dock, suffix = state.node, state.kind.suffix
            free, charge = "Free_dock_" + dock, named("Charge", dock, suffix)
            x, y = self._draw.node(dock, suffix)
            self._act(charge, tasks.charge, self._charged(), 0, (x - 160, y + 60))
            self._given(charge, [free, *self._held(dock)])
            self._net.immediate(
                named("Dock", dock, suffix),
                inputs=[named("At", dock, suffix), free],
                outputs=charge,
                position=(x - 100, y + 20),
            )
            full = named("At", dock, self._team.kinds[state.kind.type][0].suffix)
            charged = named("Charged", dock, suffix)
            self._ends(charged, 1 / tasks.charge, charge, [full, free], (x - 80, y + 90))
        last = {kinds[-1]: robot for robot, kinds in self._team.kinds.items()}
        driving = dict.fromkeys(state.kind for state in self._of("Drive") if state.kind in last)
        for column, kind in enumerate(driving, len(self._team.due)):
            robot = last[kind]
            stranded = self._stranded(robot)
            self._act(stranded, tasks.stranded, None, 0, self._draw.top(column, 0))
            recovered = named("Recovered", stranded[len("Stranded_") :])
            full = named("At", self._team.dock_of(robot), self._team.kinds[robot][0].suffix)
            at = self._draw.top(column, 1)
            self._ends(recovered, 1 / tasks.stranded, stranded, [full], at)
        if tasks.battery_topic is None:
            self._team.notes.append(
                "on ROS nothing reports the battery: give 'battery_topic', or in %s let your "
                "driver answer with Drain_... instead of Arrive_... where it is due" % PLAN_ROS_FILE
            )

    def _charged(self) -> Optional[Dict[str, str]]:
        """The action on ROS that waits until the battery is charged."""
        topic = self._tasks.battery_topic
        if topic is None:
            return None
        when = "%s > %g" % (topic.field, topic.charged)
        return {"wait_for": topic.topic, "type": topic.type, "when": when}

    def _policy(self) -> Dict[str, Any]:
        rows: List[Dict[str, Any]] = []
        for row in self._team.rows:
            what, to = row.move
            parts = {"Go": [row.node, to], "Start": [to, row.node], "Dock": [to]}[what]
            choice = named(what, *parts, row.kind.suffix)
            rows.append({"marking": list(row.cells), "choose": {choice: 1}})
        places = ["Due_%s_%s" % due for due in self._team.due]
        rows.append({"marking": ["-"] * len(places), "choose": {}})  # all others wait
        return {"places": places, "rows": rows}
