"""Distinguishes the names that elements of a plan are derived from: with nodes ``a``, ``a_b``,
``b_c`` and ``c``, ``Drive_a_b_c`` could be two edges."""

from __future__ import annotations

from typing import Dict, Iterator, List, Mapping, Sequence, Tuple

from gspn_framework_package.making.site_elements import MapDoor, MapGroup, SiteMap
from gspn_framework_package.making.site_tasks import SiteTasks
from gspn_framework_package.model.errors import InputError

_KEPT_WORDS = ("node", "dock", "group", "door")
"""Words that follow ``Free_``; a node may have one as its name."""


def named(*parts: str) -> str:
    """Return the name of an element of the net, composed of the non-empty parts."""
    return "_".join(part for part in parts if part)


def with_clear_names(site: SiteMap, tasks: SiteTasks) -> Tuple[SiteMap, SiteTasks, List[str]]:
    """Return the map and the tasks with nodes renamed so that the names of the plan's elements are
    unambiguous, and a note on the changed ones; unchanged if they are already unambiguous.

    :raises InputError: the name of a task is that of something else in the plan.
    """
    if not _unclear(site, tasks):
        return site, tasks, []
    new: Dict[str, str] = {}
    used = {name for name in site.nodes if "_" not in name and name not in _KEPT_WORDS}
    for name in site.nodes:
        new[name] = name
        if name not in used:
            new[name] = name.replace("_", "-") + "-" * (name in _KEPT_WORDS)
            while new[name] in used:
                new[name] += "-"
            used.add(new[name])
    site, tasks = _renamed_map(site, new), _renamed_tasks(tasks, new)
    for name in _unclear(site, tasks):
        raise InputError(
            "two elements of the plan would be called %s" % name,
            element=name,
            hint="choose another name for the task or for the level of the battery",
        )
    changed = ["%s is %s" % pair for pair in new.items() if pair[0] != pair[1]]
    more = " and %d more" % (len(changed) - 8) if len(changed) > 8 else ""
    note = "names of nodes are changed in the plan, where A_B would be ambiguous: %s%s"
    return site, tasks, [note % (", ".join(changed[:8]), more)]


def _unclear(site: SiteMap, tasks: SiteTasks) -> List[str]:
    """The names that two different elements of the plan would have."""
    found: Dict[str, Sequence[str]] = {}
    return [
        name
        for parts in _elements(site, tasks)
        for name in [named(*parts)]
        if found.setdefault(name, parts) != parts
    ]


def _elements(site: SiteMap, tasks: SiteTasks) -> Iterator[Sequence[str]]:
    """The parts of the names of places; transitions are named in the same way."""
    types = tasks.types if len(tasks.types) > 1 else [""]
    kinds = [named(robot, level) for robot in types for level in tasks.battery or [""]]
    at = [(task, node) for task, given in tasks.tasks.items() for node in given.at]
    for kind in kinds:
        yield from (("At", node, kind) for node in site.nodes)
        yield from (("Drive", edge.source, edge.target, kind) for edge in site.edges)
        yield from ((named(task, node), kind) for task, node in at)
        yield from (("Charge", node, kind) for node in tasks.docks)
        for name, door in tasks.doors.items():
            for word in ("Open", "Close"):
                yield from ((word, name, *edge, kind) for edge in _both_ways(door.group.edges))
    yield from (("Stranded", robot) for robot in types if tasks.battery)
    yield from (("Free", edge.source, edge.target) for edge in site.edges)
    yield from (("Free_node", node) for node in site.nodes)
    yield from (("Free_dock", node) for node in tasks.docks)
    yield from (("Free_group", name) for name in tasks.groups)
    yield from (("Free_door", name) for name in tasks.doors)
    for word in ("Due", "Fresh"):
        yield from ((word, task, node) for task, node in at)


def _both_ways(edges: Sequence[Tuple[str, str]]) -> Iterator[Tuple[str, str]]:
    for a, b in edges:
        yield a, b
        if (b, a) not in edges:
            yield b, a


def _renamed_map(site: SiteMap, new: Dict[str, str]) -> SiteMap:
    return site._replace(
        nodes={new[name]: node._replace(name=new[name]) for name, node in site.nodes.items()},
        edges=[e._replace(source=new[e.source], target=new[e.target]) for e in site.edges],
        groups=_renamed_groups(site.groups, new),
        doors=_renamed_doors(site.doors, new),
    )


def _renamed_group(group: MapGroup, new: Dict[str, str]) -> MapGroup:
    edges = [(new[a], new[b]) for a, b in group.edges]
    return MapGroup([new[node] for node in group.nodes], edges, group.capacity)


def _renamed_groups(groups: Mapping[str, MapGroup], new: Dict[str, str]) -> Dict[str, MapGroup]:
    return {name: _renamed_group(group, new) for name, group in groups.items()}


def _renamed_doors(doors: Mapping[str, MapDoor], new: Dict[str, str]) -> Dict[str, MapDoor]:
    return {
        name: door._replace(group=_renamed_group(door.group, new)) for name, door in doors.items()
    }


def _renamed_tasks(tasks: SiteTasks, new: Dict[str, str]) -> SiteTasks:
    return tasks._replace(
        start=[new[node] for node in tasks.start],
        nodes={new[node]: capacity for node, capacity in tasks.nodes.items()},
        groups=_renamed_groups(tasks.groups, new),
        doors=_renamed_doors(tasks.doors, new),
        parking=[new[node] for node in tasks.parking],
        edges={(new[a], new[b]): given for (a, b), given in tasks.edges.items()},
        tasks={
            name: task._replace(at=[new[node] for node in task.at])
            for name, task in tasks.tasks.items()
        },
        docks={new[node]: places for node, places in tasks.docks.items()},
    )
