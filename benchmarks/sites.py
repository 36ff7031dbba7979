"""Plans of maps with the shape of real sites, each with 190 nodes and 437 edges, and of a larger
grid, for measuring what can be proven of them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Dict, List, Tuple

from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.making.site_plan import build_site_plan
from gspn_framework_package.model.plan import Plan

Nodes = Dict[str, List[float]]
Edges = List[Tuple[str, str]]

TASKS = 16


def farm() -> Tuple[Nodes, Edges]:
    """Ten polytunnels between two headlands, with passages between some of them."""
    nodes: Nodes = {"t%d_%d" % (x, y): [9 * x, 6 * y] for x in range(10) for y in range(19)}
    edges = [("t%d_%d" % (x, y), "t%d_%d" % (x, y + 1)) for x in range(10) for y in range(18)]
    edges += [("t%d_%d" % (x, y), "t%d_%d" % (x + 1, y)) for y in (0, 18) for x in range(9)]
    edges += [("t%d_%d" % (x, y), "t%d_%d" % (x + 1, y)) for y in (6, 12) for x in range(9)]
    return nodes, [*edges, ("t0_3", "t1_3"), ("t8_3", "t9_3")]


def warehouse() -> Tuple[Nodes, Edges]:
    """Nineteen aisles with cross aisles at both ends, and one half way through."""
    nodes: Nodes = {"a%d_%d" % (x, y): [4 * x, 3 * y] for x in range(19) for y in range(10)}
    edges = [("a%d_%d" % (x, y), "a%d_%d" % (x, y + 1)) for x in range(19) for y in range(9)]
    edges += [("a%d_%d" % (x, y), "a%d_%d" % (x + 1, y)) for y in (0, 9) for x in range(18)]
    return nodes, [*edges, *(("a%d_5" % x, "a%d_5" % (x + 1)) for x in range(11))]


def office() -> Tuple[Nodes, Edges]:
    """A corridor that closes a ring, with rooms on both sides, some of which have doors to the
    next."""
    nodes: Nodes = {"c%d" % i: [3 * i, 0] for i in range(60)}
    nodes.update({"r%d" % i: [1.4 * i, 5 if i % 2 else -5] for i in range(130)})
    edges = [("c%d" % i, "c%d" % ((i + 1) % 60)) for i in range(60)]
    edges += [("r%d" % i, "c%d" % (i * 60 // 130)) for i in range(130)]
    return nodes, [*edges, *(("r%d" % i, "r%d" % (i + 2)) for i in range(0, 112, 4))]


def grid() -> Tuple[Nodes, Edges]:
    """A hall of 20 by 20 nodes, with 760 edges."""
    nodes: Nodes = {"g%d_%d" % (x, y): [3 * x, 3 * y] for x in range(20) for y in range(20)}
    edges = [("g%d_%d" % (x, y), "g%d_%d" % (x + 1, y)) for x in range(19) for y in range(20)]
    return nodes, edges + [
        ("g%d_%d" % (x, y), "g%d_%d" % (x, y + 1)) for x in range(20) for y in range(19)
    ]


SITES = {"farm": farm, "warehouse": warehouse, "office": office, "grid": grid}


def site_plan(site: str, robots: int, folder: Path, **more: object) -> Plan:
    """The plan of a site with batteries, four docks and :data:`TASKS` tasks, written to a
    folder.

    :param more: further keys of the tasks' file.
    """
    nodes, edges = SITES[site]()
    names = list(nodes)
    spread = [names[i * len(names) // TASKS + 3] for i in range(TASKS)]
    docks = [names[i * len(names) // 4] for i in range(4)]
    tasks = {
        "plan": site,
        "start": docks,
        "tasks": {"Work": {"at": spread, "seconds": 20, "again_after": 120}},
        "battery": {"full": 0.05, "low": 0.05},
        "docks": dict.fromkeys(docks, 1),
        **more,
    }
    one_way = {"from": names[1], "to": names[-1], "one_way": True}
    graph = {"nodes": nodes, "edges": [*edges, one_way]}
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in (("map.yaml", graph), ("tasks.yaml", tasks)):
        (folder / name).write_text(json.dumps(data), "utf-8")
    made = build_site_plan(str(folder / "map.yaml"), str(folder / "tasks.yaml"), robots)
    made.write(str(folder / "plan"))
    return read_plan(str(folder / "plan"))
