"""A plan for a map and the tasks there.

A robot's place says where it is or on which edge, what it does, and, with batteries, the level of
its own: so robots with the same level in the same node are exchangeable. ``Due_TASK_NODE`` has a
token while a task is due, ``Free_A_B`` one for each robot that may still drive on an edge, and
``Free_dock_NODE`` one for each free place at a dock.
"""

from __future__ import annotations

import json
import math
from collections import deque
from typing import Any, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.formats.plan_file import PLAN_FILE
from gspn_framework_package.making.plan_folder import NET_FILE, POLICY_FILE, write_plan_folder
from gspn_framework_package.making.site_map import MapEdge, MapNode, SiteMap, read_map
from gspn_framework_package.making.site_tasks import SiteTasks, read_tasks
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import InputError, UsageError
from gspn_framework_package.model.net import Net

Point = Tuple[float, float]

MOST_NODES = 50_000
"""Maximum number of nodes of the net."""

PLAN_ROS_FILE = "plan_ros.json"
"""The same plan, with the actions of the map and the tasks for robots on ROS."""

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
    on ROS, ``policy``, and ``notes`` for the user."""

    net: Net
    plan: Dict[str, Any]
    ros_actions: Dict[str, Any]
    policy: Optional[Dict[str, Any]]
    notes: List[str]

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
        files = {
            "actions.py": _ACTIONS,
            PLAN_ROS_FILE: json.dumps(plan_ros, indent=2, ensure_ascii=False) + "\n",
        }
        return write_plan_folder(
            folder, self.net, self.plan, self.policy, files, (PLAN_FILE, PLAN_ROS_FILE)
        )


def build(map_path: str, tasks_path: Optional[str], robots: int) -> SitePlan:
    """Make a plan from a map.

    :param tasks_path: the file of the tasks; None: robots drive around.
    :param robots: number of robots.
    :raises InputError: a file cannot be read, or both do not fit.
    """
    site = read_map(map_path)
    tasks = read_tasks(tasks_path, site) if tasks_path is not None else SiteTasks()
    return _Builder(site, tasks, robots, map_path).built()


class _Builder:
    def __init__(self, site: SiteMap, tasks: SiteTasks, robots: int, path: str) -> None:
        self._path = path
        self._tasks = tasks
        self._notes = list(site.notes)
        start = list(tasks.start) or list(tasks.docks) or list(site.nodes)[:1]
        self._site = self._reached(site, start)
        self._name = tasks.plan or site.name
        self._levels = list(tasks.battery) or [""]
        self._edges = {(edge.source, edge.target): edge for edge in self._site.edges}
        self._due = [
            (task, node)
            for task, given in tasks.tasks.items()
            for node in given.at
            if node in self._site.nodes
        ]
        if not self._edges and not self._due:
            raise UsageError("robots can neither drive nor work there", file=path)
        size = len(self._levels) * (
            len(self._site.nodes) + 4 * len(self._edges) + 3 * len(self._due)
        )
        if size > MOST_NODES:
            raise UsageError(
                "the net would have some %d nodes; at most %d are possible" % (size, MOST_NODES),
                file=path,
                hint="fewer levels of the battery, or a smaller map",
            )
        self._free = self._limited()
        self._start = [self._at(node, self._levels[0]) for node in start]
        self._team = {"robot_%d" % (k + 1): self._start[k % len(start)] for k in range(robots)}
        self._draw = _Drawing(self._site, self._levels)
        self._net = NetBuilder(self._name)
        self._actions: Dict[str, Any] = {}
        self._ros: Dict[str, Any] = {}
        self._durations: Dict[str, Any] = {}
        self._given_back: Dict[str, Any] = {}
        self._resources: List[str] = []

    # -- what there is

    def _reached(self, site: SiteMap, start: Sequence[str]) -> SiteMap:
        """The part of the map that robots can get to."""
        leaving: Dict[str, List[str]] = {}
        for edge in site.edges:
            leaving.setdefault(edge.source, []).append(edge.target)
        found, front = set(start), list(start)
        while front:
            for target in leaving.get(front.pop(), ()):
                if target not in found:
                    found.add(target)
                    front.append(target)
        lost = [name for name in site.nodes if name not in found]
        for name in [n for task in self._tasks.tasks.values() for n in task.at if n in lost]:
            raise InputError(
                "no robot can get from its start to node '%s', where there is a task" % name,
                file=self._path,
                element=name,
                hint="add an edge, or give a 'start' from where it can be reached",
            )
        if lost:
            self._notes.append(
                "left out, because no robot gets there: %s"
                % (
                    ", ".join(lost[:8])
                    + (" and %d more" % (len(lost) - 8) if len(lost) > 8 else "")
                )
            )
        return site._replace(
            nodes={name: node for name, node in site.nodes.items() if name in found},
            edges=[e for e in site.edges if e.source in found and e.target in found],
        )

    def _limited(self) -> Dict[Tuple[str, str], Tuple[str, int]]:
        """Edge -> resource place and capacity of those where not any number may drive."""
        found: Dict[Tuple[str, str], Tuple[str, int]] = {}
        for pair, edge in self._edges.items():
            capacity = self._tasks.capacity if edge.capacity is None else edge.capacity
            capacity = self._tasks.edges.get(pair, {}).get("capacity", capacity)
            if capacity is None:
                continue
            back = pair[::-1]
            found[pair] = found[back] if back in found else ("Free_%s_%s" % pair, capacity)
        return found

    def _seconds(self, edge: MapEdge) -> float:
        given = self._tasks.edges.get((edge.source, edge.target), {}).get("seconds", edge.seconds)
        if given is not None:
            return float(given)
        # two nodes may be at the same position, for example with other orientations
        return max(round(edge.length / (edge.speed or self._tasks.speed), 3), 0.1)

    def _ways_to(self, target: str) -> Dict[str, Tuple[float, str]]:
        """Node -> (seconds to the target, next node on the way there)."""
        coming: Dict[str, List[MapEdge]] = {}
        for edge in self._edges.values():
            coming.setdefault(edge.target, []).append(edge)
        found = {target: (0.0, target)}
        front = deque([target])
        while front:
            node = front.popleft()
            for edge in coming.get(node, ()):
                time = found[node][0] + self._seconds(edge)
                if edge.source not in found or time < found[edge.source][0] - 1e-9:
                    found[edge.source] = (time, node)
                    front.append(edge.source)
        return found

    @staticmethod
    def _named(*parts: str) -> str:
        return "_".join(part for part in parts if part)

    def _at(self, node: str, level: str) -> str:
        return self._named("At", node, level)

    def _lower(self, level: str) -> Optional[str]:
        return dict(zip(self._levels, self._levels[1:])).get(level)

    # -- the net

    def _act(self, place: str, seconds: float, ros: Any, tokens: int, position: Point) -> None:
        """Add an action place where the action takes time."""
        shape = self._tasks.shape
        self._net.place(place, tokens, position=position)
        settings = {"seconds": seconds, "shape": shape}
        self._actions[place] = {"function": "actions.TakeTime", "settings": settings}
        self._ros[place] = self._actions[place] if ros is None else ros
        self._durations[place] = {"mean": seconds, "distribution": "gamma", "shape": shape}

    def _resource(self, place: str, tokens: int, position: Point) -> None:
        self._net.place(place, tokens, position=position)
        self._resources.append(place)

    def built(self) -> SitePlan:
        """Return the plan."""
        starts = list(self._team.values())
        for level in self._levels:
            for node in self._site.nodes:
                at = self._at(node, level)
                self._net.place(at, starts.count(at), position=self._draw.node(node, level))
                self._actions[at] = self._ros[at] = None
        for pair, (free, capacity) in self._free.items():
            if free == "Free_%s_%s" % pair:
                self._resource(free, capacity, self._draw.along(*pair, self._levels[0], 0.5, 0))
        for level in self._levels:
            for edge in self._edges.values():
                self._drive(edge, level)
        for number, (task, node) in enumerate(self._due):
            self._task(number, task, node)
        if self._tasks.battery:
            self._charging()
        policy = self._policy() if self._due else None
        tasks = ", ".join(self._tasks.tasks) or "driving around"
        plan: Dict[str, Any] = {
            "plan": self._name,
            "description": "Robots on a map of %d nodes: %s." % (len(self._site.nodes), tasks),
            "actions": self._actions,
            "resource_places": self._resources,
            "environment": "simulate",
            "robots": self._team,
            "spawn": self._start,
            "on_failure": {"*": {"retry": 3, "delay": 1}},
            "on_evict": self._given_back,
            "durations": self._durations,
        }
        try:
            net = self._net.build()
        except InputError as error:
            raise error.located(file=self._path) from None
        return SitePlan(net, plan, self._ros, policy, self._notes)

    def _drive(self, edge: MapEdge, level: str) -> None:
        a, b = edge.source, edge.target
        seconds = self._seconds(edge)
        drained = self._tasks.battery.get(level, 0.0)
        drive, arrive = self._named("Drive", a, b, level), self._named("Arrive", a, b, level)
        drain = self._named("Drain", a, b, level)
        free = [self._free[a, b][0]] if (a, b) in self._free else []
        ros = _goal(edge, self._site.nodes[b], arrive)
        self._act(drive, seconds, ros, 0, self._draw.along(a, b, level, 0.48))
        if free:
            self._given_back[drive] = {free[0]: 1}
        self._net.immediate(
            self._named("Go", a, b, level),
            inputs=[self._at(a, level), *free],
            outputs=drive,
            position=self._draw.along(a, b, level, 0.25),
        )
        self._net.exponential(
            arrive,
            (1 - drained) / seconds,
            None,
            inputs=drive,
            outputs=[self._at(b, level), *free],
            position=self._draw.along(a, b, level, 0.7),
        )
        if drained:
            settings = self._actions[drive]["settings"]
            settings.update(drained=drained, arrive=arrive, drain=drain)
            self._actions[drive]["function"] = "actions.Drive"
            lower = self._lower(level)
            self._net.exponential(
                drain,
                drained / seconds,
                None,
                inputs=drive,
                outputs=["Stranded" if lower is None else self._at(b, lower), *free],
                position=self._draw.along(a, b, level, 0.7, 2.2),
            )

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
        side = [t for t, n in self._due[:number] if n == node]
        for level in self._levels:
            place = self._named(here, level)
            at, off = self._at(node, level), 60 * len(side)
            x, y = self._draw.node(node, level)
            self._act(place, given.seconds, given.action, 0, (x + 120 + off, y + 60 + off))
            self._given_back[place] = {due: 1}
            self._net.immediate(
                self._named("Start", here, level),
                inputs=[at, due],
                outputs=place,
                position=(x + 90 + off, y + 20 + off),
            )
            self._net.exponential(
                self._named("Finished", here, level),
                1 / given.seconds,
                None,
                inputs=place,
                outputs=[at, fresh],
                position=(x + 40 + off, y + 80 + off),
            )

    def _charging(self) -> None:
        tasks, full = self._tasks, self._levels[0]
        docks = [dock for dock in tasks.docks if dock in self._site.nodes]
        if not docks:
            raise UsageError(
                "no robot can get from its start to a dock", file=self._path, element="docks"
            )
        for dock in docks:
            free = "Free_dock_" + dock
            x, y = self._draw.node(dock, full)
            self._resource(free, tasks.docks[dock], (x - 160, y))
            for level in self._levels[1:]:
                x, y = self._draw.node(dock, level)
                charge = self._named("Charge", dock, level)
                self._act(charge, tasks.charge, None, 0, (x - 160, y + 60))
                self._given_back[charge] = {free: 1}
                self._net.immediate(
                    self._named("Dock", dock, level),
                    inputs=[self._at(dock, level), free],
                    outputs=charge,
                    position=(x - 100, y + 20),
                )
                self._net.exponential(
                    self._named("Charged", dock, level),
                    1 / tasks.charge,
                    None,
                    inputs=charge,
                    outputs=[self._at(dock, full), free],
                    position=(x - 80, y + 90),
                )
        self._act("Stranded", tasks.stranded, None, 0, self._draw.top(len(self._due), 0))
        self._net.exponential(
            "Recovered",
            1 / tasks.stranded,
            None,
            inputs="Stranded",
            outputs=self._at(docks[0], full),
            position=self._draw.top(len(self._due), 1),
        )
        self._notes.append(
            "on ROS nothing reports the battery: in %s a drive ends with Arrive_...; let your "
            "driver answer with Drain_... where it is due" % PLAN_ROS_FILE
        )

    # -- the policy

    def _policy(self) -> Dict[str, Any]:
        """To the nearest task that is due; to the nearest dock if the battery is at its lowest
        level, or if nothing is due."""
        ways = {node: self._ways_to(node) for _, node in self._due}
        docks = [dock for dock in self._tasks.docks if dock in self._site.nodes]
        home = {dock: self._ways_to(dock) for dock in docks}
        places = ["Due_%s_%s" % due for due in self._due]
        rows: List[Dict[str, Any]] = []
        stuck = set()

        def row(cells: List[Any], choice: str) -> None:
            rows.append({"marking": cells, "choose": {choice: 1}})

        for level in self._levels:
            lowest = bool(self._tasks.battery) and level == self._levels[-1]
            for node in self._site.nodes:
                near = [dock for dock in docks if node in home[dock]]
                dock = min(near, key=lambda d: home[d][node][0]) if near else None
                go_home = ""
                if dock is not None and dock != node:
                    go_home = self._named("Go", node, home[dock][node][1], level)
                elif dock == node and self._tasks.battery and level != self._levels[0]:
                    go_home = self._named("Dock", node, level)
                cells: List[Any] = ["-"] * len(places)
                if not (lowest and go_home):
                    can = [k for k, (_, at) in enumerate(self._due) if node in ways[at]]
                    for k in sorted(can, key=lambda k: ways[self._due[k][1]][node][0]):
                        task, at = self._due[k]
                        cells[k] = 1
                        if at == node:
                            row(list(cells), self._named("Start", task, node, level))
                        else:
                            step = self._named("Go", node, ways[at][node][1], level)
                            row(list(cells), step)
                        cells[k] = 0
                    if not can and not go_home:
                        stuck.add(node)
                if go_home and lowest:
                    row([0, *cells[1:]], go_home)
                    row([1, *cells[1:]], go_home)
                elif go_home:
                    row(list(cells), go_home)
        rows.append({"marking": ["-"] * len(places), "choose": {}})  # all others wait
        if stuck:
            self._notes.append(
                "robots in these nodes get to no task and no dock any more: %s"
                % ", ".join(sorted(stuck)[:8])
            )
        return {"places": places, "rows": rows}


def _goal(edge: MapEdge, node: MapNode, arrive: str) -> Dict[str, Any]:
    """The action of an edge on ROS: the goal of the map, or one for move_base."""
    package, _, name = edge.action_type.replace("/action/", "/").partition("/")
    base = name or "MoveBase"
    for ending in ("ActionGoal", "Action", "Goal"):
        if base.endswith(ending):
            base = base[: -len(ending)]
            break
    goal: Any = edge.goal or {
        "target_pose": {"header": {"frame_id": "$node.parent_frame"}, "pose": "$node.pose"}
    }
    return {
        "type": "%s/%sAction" % (package or "move_base_msgs", base),
        "server": edge.action,
        "goal": _filled(goal, node),
        "outcomes": {"succeeded": arrive},
    }


def _filled(value: Any, node: MapNode) -> Any:
    """A goal of the map with what its ``$node`` words stand for, and the current time."""
    if isinstance(value, dict):
        found = {str(key): _filled(part, node) for key, part in value.items()}
        if "frame_id" in found:
            found.setdefault("stamp", "now")
        return found
    if isinstance(value, list):
        return [_filled(part, node) for part in value]
    return {
        "$node.pose": node.pose,
        "$node.parent_frame": node.frame,
        "$node.name": node.name,
        "+node.pose": node.pose,
    }.get(value, value if isinstance(value, (str, int, float, bool)) else None)


class _Drawing:
    """Where things are drawn: the map once for each level of the battery, side by side."""

    LANE = 45

    def __init__(self, site: SiteMap, levels: Sequence[str]) -> None:
        nodes = site.nodes
        lengths = sorted(
            math.hypot(nodes[e.source].x - nodes[e.target].x, nodes[e.source].y - nodes[e.target].y)
            for e in site.edges
        )
        lengths = [length for length in lengths if length > 0]
        usual = lengths[len(lengths) // 4] if lengths else 1.0
        extent = max(
            max(n.x for n in nodes.values()) - min(n.x for n in nodes.values()),
            max(n.y for n in nodes.values()) - min(n.y for n in nodes.values()),
        )
        self._scale = min(560 / usual, 40_000 / max(extent, usual))
        self._left = min(n.x for n in nodes.values())
        self._top = max(n.y for n in nodes.values())
        self._nodes: Mapping[str, MapNode] = nodes
        self._levels = list(levels)
        self._width = (max(n.x for n in nodes.values()) - self._left) * self._scale + 800

    def node(self, node: str, level: str) -> Point:
        """A node, for robots with a level of the battery."""
        found = self._nodes[node]
        x = 400 + self._levels.index(level) * self._width + (found.x - self._left) * self._scale
        return (round(x), round(700 + (self._top - found.y) * self._scale))

    def along(self, a: str, b: str, level: str, share: float, lanes: float = 1.0) -> Point:
        """A point of the lane from a to b."""
        (ax, ay), (bx, by) = self.node(a, level), self.node(b, level)
        length = math.hypot(bx - ax, by - ay)
        ex, ey = ((bx - ax) / length, (by - ay) / length) if length else (1.0, 0.0)
        if not length:
            bx, by = ax + 300, ay
        off = lanes * self.LANE
        return (round(ax + share * (bx - ax) - ey * off), round(ay + share * (by - ay) + ex * off))

    def top(self, column: int, row: int) -> Point:
        """A point above the maps."""
        return (400 + column * 260, 100 + 120 * row)
