"""The robots of a plan for a map, and what they can do there."""

from __future__ import annotations

import math
from typing import Dict, List, NamedTuple, Optional, Sequence, Set, Union

from gspn_framework_package.making.site_elements import MapEdge, MapNode, SiteMap
from gspn_framework_package.making.site_names import named
from gspn_framework_package.making.site_policy import RobotKind, SitePolicy, SiteRow
from gspn_framework_package.making.site_tasks import SiteTasks
from gspn_framework_package.model.errors import InputError, UsageError


class SiteState(NamedTuple):
    """What robots of a kind can do: be ``At`` a node, choose to ``Go`` from there ``to`` another
    one, ``Drive`` there, ``Start`` the task ``to`` at a node, ``Dock`` at a node."""

    what: str
    node: str
    to: str
    kind: RobotKind


class SiteTeam:
    """The robots of a plan, and what they can do.

    :param path: its file, for errors.
    :param all_edges: keep what the policy does not use.
    :raises InputError: the robots cannot do there what the tasks ask for.
    """

    def __init__(self, site: SiteMap, tasks: SiteTasks, path: str, all_edges: bool) -> None:
        self._path = path
        self._tasks = tasks
        self.notes: List[str] = []
        # where the battery is read, a level ends at any time, and the robot drives on
        self._on_the_way = tasks.battery_topic is not None
        types = list(tasks.types) or [""]
        self.kinds = {
            robot: [
                RobotKind(robot, level, named(robot if len(types) > 1 else "", level))
                for level in tasks.battery or [""]
            ]
            for robot in types
        }
        nodes = next(filter(None, map(list, (tasks.start, tasks.parking, tasks.docks))), None)
        nodes = nodes or list(site.nodes)[:1]
        # robot k starts in node k, and is of type k; both lists wrap around
        rounds = len(nodes) * len(types) // math.gcd(len(nodes), len(types))
        starts = [(nodes[k % len(nodes)], types[k % len(types)]) for k in range(rounds)]
        self.start = [(node, self.kinds[robot][0]) for node, robot in starts]
        self._homes = {robot: [node for node, of in starts if of == robot] for robot in types}
        self._open = {robot: self._allowed(site, robot) for robot in types}
        self._sites = {robot: self._reached(robot) for robot in types}
        self.site = self._joined(site)
        self.edges = {(edge.source, edge.target): edge for edge in self.site.edges}
        self.due = [
            (task, node)
            for task, given in tasks.tasks.items()
            for node in given.at
            if node in self.site.nodes
        ]
        if not self.edges and not self.due:
            raise InputError(
                "robots have nothing to do: no edge leads away from where they start, and no task "
                "is there",
                file=path,
                element=self.start[0][0],
                hint="give another 'start', tasks, or edges",
            )
        self.docks = [dock for dock in tasks.docks if dock in self.site.nodes]
        for robot, part in self._sites.items():
            if tasks.battery and not any(dock in part.nodes for dock in self.docks):
                raise UsageError(
                    "no robot%s can get from its start to a dock" % _of_type(robot), file=path
                )
        self._note_traps()
        self.rows = self._policy_rows(all_edges)
        self.states = self._states(all_edges)

    # -- robots and nodes

    def _allowed(self, site: SiteMap, robot: str) -> SiteMap:
        """The part of the map that robots of a type may use."""
        open_: Dict[str, int] = {}

        def allows(element: Union[MapNode, MapEdge]) -> bool:
            if element.restriction is None:
                return True
            found = element.restriction.holds(robot or None, self._tasks.conditions)
            if found is None:
                text = element.restriction.text
                open_[text] = open_.get(text, 0) + 1
            return found is not False

        nodes = {name: node for name, node in site.nodes.items() if allows(node)}
        edges = [
            edge
            for edge in site.edges
            if edge.source in nodes and edge.target in nodes and allows(edge)
        ]
        for text, times in open_.items():
            note = (
                "the restriction '%s' (%d times) is not applied: 'types' and 'conditions' of the "
                "tasks do not say whether it holds" % (text, times)
            )
            if note not in self.notes:
                self.notes.append(note)
        for node in self._homes[robot]:
            if node not in nodes:
                raise InputError(
                    "a robot%s may not be where it starts" % _of_type(robot),
                    file=self._path,
                    element=node,
                    hint="choose another 'start'",
                )
        return site._replace(nodes=nodes, edges=edges)

    def _reached(self, robot: str) -> SiteMap:
        """The part of the map that robots of a type can reach."""
        site = self._open[robot]
        found = _reachable(site, self._homes[robot])
        return site._replace(
            nodes={name: node for name, node in site.nodes.items() if name in found},
            edges=[e for e in site.edges if e.source in found and e.target in found],
        )

    def _joined(self, site: SiteMap) -> SiteMap:
        """The part of the map that any robot can reach."""
        nodes = {name for part in self._sites.values() for name in part.nodes}
        edges = {(e.source, e.target) for part in self._sites.values() for e in part.edges}
        lost = [name for name in site.nodes if name not in nodes]
        for name in [n for task in self._tasks.tasks.values() for n in task.at if n in lost]:
            raise InputError(
                "no robot can get from its start to node '%s', where there is a task" % name,
                file=self._path,
                element=name,
                hint="add an edge, give a 'start' from where it can be reached, or look at its "
                "restrictions",
            )
        for name in [node for node in self._tasks.parking if node in lost]:
            raise InputError(
                "no robot can get from its start to node '%s', where robots should park" % name,
                file=self._path,
                element=name,
                hint="choose another node, or give a 'start' from where it can be reached",
            )
        if lost:
            self.notes.append("left out, because no robot can get there: %s" % some_names(lost))
        return site._replace(
            nodes={name: node for name, node in site.nodes.items() if name in nodes},
            edges=[edge for edge in site.edges if (edge.source, edge.target) in edges],
        )

    def _note_traps(self) -> None:
        """Note the tasks and docks from which robots can never reach another one."""
        traps: Dict[str, List[str]] = {}
        for part in self._sites.values():
            wanted = [n for n in dict.fromkeys(n for _, n in self.due) if n in part.nodes]
            wanted += [dock for dock in self.docks if dock in part.nodes and dock not in wanted]
            for node in wanted:
                found = _reachable(part, [node])
                lost = [other for other in wanted if other not in found]
                if lost:
                    traps.setdefault(some_names(lost), []).append(node)
        for lost_ones, nodes in traps.items():
            self.notes.append(
                "there is no way back from %s to %s, where there is a task or a dock"
                % (some_names(nodes), lost_ones)
            )

    def seconds(self, edge: MapEdge) -> float:
        """How long an edge takes, on average (s)."""
        given = self._tasks.edges.get((edge.source, edge.target), {}).get("seconds", edge.seconds)
        if given is not None:
            return float(given)
        # two nodes may be at the same position, for example with other orientations
        return max(round(edge.length / (edge.speed or self._tasks.speed), 3), 0.1)

    def lower(self, kind: RobotKind) -> Optional[RobotKind]:
        """The kind with the next lower level of the battery, if there is one."""
        kinds = self.kinds[kind.type]
        return dict(zip(kinds, kinds[1:])).get(kind)

    def dock_of(self, robot: str) -> str:
        """The dock where a robot of a type is brought if its battery is empty."""
        return next(dock for dock in self.docks if dock in self._sites[robot].nodes)

    # -- moves of robots

    def _policy_rows(self, all_edges: bool) -> List[SiteRow]:
        """The rows of the policy; none if there is nothing to do."""
        if not self.due:
            return []
        rows: List[SiteRow] = []
        stuck: Set[str] = set()
        for robot, kinds in self.kinds.items():
            site = self._sites[robot]
            parking = self._tasks.parking
            policy = SitePolicy(site, self.due, self.docks, parking, kinds, self.seconds)
            brought = self.dock_of(robot) if self._tasks.battery else None
            found = policy.reached(
                self._homes[robot], self._tasks.battery, brought, self._on_the_way
            )
            stuck |= policy.stuck & {row.move.to for row in found if row.move.what == "Go"}
            rows += policy.rows if all_edges else found
        if stuck:
            self.notes.append(
                "robots in these nodes can no longer reach a task or a dock: %s"
                % some_names(sorted(stuck))
            )
        return rows

    def _states(self, all_edges: bool) -> List[SiteState]:
        """The possible moves of robots, in the order of the map."""
        every: List[SiteState] = []
        for robot, kinds in self.kinds.items():
            site = self._sites[robot]
            here = [(task, node) for task, node in self.due if node in site.nodes]
            docks = [dock for dock in self.docks if dock in site.nodes]
            for kind in kinds:
                every += [SiteState("At", node, "", kind) for node in site.nodes]
                for what in ("Go", "Drive"):
                    every += [SiteState(what, e.source, e.target, kind) for e in site.edges]
                every += [SiteState("Start", node, task, kind) for task, node in here]
                every += [SiteState("Dock", dock, dock, kind) for dock in docks if kind != kinds[0]]
        if all_edges or not self.rows:
            return every
        used = {SiteState("At", node, "", kind) for node, kind in self.start}
        for row in self.rows:
            what, to = row.move
            used |= {
                SiteState("At", row.node, "", row.kind),
                SiteState(what, row.node, to, row.kind),
            }
            kinds = self.kinds[row.kind.type]
            if what == "Dock":
                used.add(SiteState("At", to, "", kinds[0]))
            elif what == "Go":
                lower = kinds[kinds.index(row.kind) + 1 :] if self._tasks.battery else []
                driving = [row.kind, *(lower if self._on_the_way else [])]
                used |= {SiteState("Drive", row.node, to, kind) for kind in driving}
                used |= {SiteState("At", to, "", kind) for kind in [*driving, *lower[:1]]}
                if self._tasks.battery and driving[-1] == kinds[-1]:
                    used.add(SiteState("At", self.dock_of(row.kind.type), "", kinds[0]))
        self._note_unused(used)
        return [state for state in every if state in used]

    def _note_unused(self, used: Set[SiteState]) -> None:
        driven = {(state.node, state.to) for state in used if state.what == "Go"}
        visited = {state.node for state in used}
        nodes = [node for node in self.site.nodes if node not in visited]
        if len(driven) < len(self.edges):
            self.notes.append(
                "left out, because the policy does not use them: %d of %d edges%s (--all-edges "
                "keeps them)"
                % (
                    len(self.edges) - len(driven),
                    len(self.edges),
                    ", and the nodes " + some_names(nodes) if nodes else "",
                )
            )


def _reachable(site: SiteMap, starts: Sequence[str]) -> Set[str]:
    """The nodes that can be reached from ``starts``, including these."""
    leaving: Dict[str, List[str]] = {}
    for edge in site.edges:
        leaving.setdefault(edge.source, []).append(edge.target)
    front = list(starts)
    found = set(front)
    while front:
        for target in leaving.get(front.pop(), ()):
            if target not in found:
                found.add(target)
                front.append(target)
    return found


def _of_type(robot: str) -> str:
    return " of type '%s'" % robot if robot else ""


def some_names(names: Sequence[str]) -> str:
    """Names for a note, abbreviated if there are many."""
    return ", ".join(names[:8]) + (" and %d more" % (len(names) - 8) if len(names) > 8 else "")
