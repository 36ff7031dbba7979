"""Small plans for simulated teams that together use every rule of the token game."""

from __future__ import annotations

import json
import random
from functools import lru_cache
from typing import Any, Callable, Dict, List, Sequence, Set, Tuple

from gspn_framework_package.formats.plan_json import plan_from_json, plan_to_json, policy_to_json
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import GspnError
from gspn_framework_package.model.event import EventSource, Tasks
from gspn_framework_package.model.failure import FailureRule
from gspn_framework_package.model.plan import (
    LostKind,
    LostRule,
    Plan,
    RobotSpec,
    Synchronisation,
    Timing,
)
from gspn_framework_package.model.policy import Policy


def _plan(
    builder: NetBuilder, start: Sequence[str], resources: Sequence[str] = (), **fields: Any
) -> Tuple[Plan, Sequence[str]]:
    net = builder.build()
    idle = fields.pop("idle", ())
    actions = {
        p.name: None if p.name in idle else FunctionAction("actions.act", p.name)
        for p in net.places
        if p.name not in resources
    }
    return Plan(net=net, actions=actions, resource_places=frozenset(resources), **fields), start


def _tour() -> Tuple[Plan, Sequence[str]]:
    """Private places in a ring, and a decision by the policy."""
    builder = (
        NetBuilder("tour")
        .place("A")
        .place("B")
        .place("C")
        .place("D")
        .exponential("ab", inputs="A", outputs="B")
        .exponential("ac", inputs="A", outputs="C")
        .exponential("bd", inputs="B", outputs="D")
        .exponential("cd", inputs="C", outputs="D")
        .immediate("da", inputs="D", outputs="A")
        .immediate("db", inputs="D", outputs="B")
    )
    policy = Policy.from_table(
        ["A", "B", "D"],
        [
            ((0, "-", "-"), {"da": 1.0}),
            ((1, 0, "-"), {"da": 0.3, "db": 0.7}),
            (("-", "-", 2), {"db": 1.0}),
        ],
    )
    return _plan(builder, ["A", "B", "C"], policy=policy)


def _meet() -> Tuple[Plan, Sequence[str]]:
    """Two robots meet, or one goes on alone; they share a tool; resource tokens count."""
    builder = (
        NetBuilder("meet")
        .place("P1")
        .place("P2")
        .place("P3")
        .place("P4")
        .place("tool", tokens=1)
        .place("count")
        .exponential("meet", inputs=["P1", "P2"], outputs=["P3", "P4"])
        .exponential("alone", inputs="P1", outputs=["P3", "count"])
        .exponential("take", inputs=["P3", "tool"], outputs="P4")
        .exponential("skip", inputs="P3", outputs="P2")
        .exponential("give", inputs="P4", outputs=["P1", "tool"])
        .exponential("keep", inputs="P4", outputs="P2")
        .exponential("swap", inputs="P2", outputs="P1")
    )
    return _plan(
        builder,
        ["P1", "P2"],
        ["tool", "count"],
        on_evict={"P4": {"tool": 1}},
        on_lost=LostRule(LostKind.FIRE, "alone"),
        on_failure={"P1": FailureRule.retry(1, 0.01)},
    )


def _tokens() -> Tuple[Plan, Sequence[str]]:
    """The net of thesis Figure 6.1: a resource place, and a choice by policy."""
    builder = (
        NetBuilder("tokens")
        .place("p1")
        .place("p2")
        .place("p3")
        .place("p4")
        .place("p5")
        .place("p6")
        .place("p7")
        .exponential("t1", inputs="p1", outputs="p2")
        .exponential("t2", inputs="p2", outputs="p3")
        .exponential("t3", inputs="p3", outputs=["p4", "p5"])
        .exponential("t4", inputs="p5", outputs="p6")
        .immediate("t5", inputs="p6", outputs="p1", weight=2.0)
        .immediate("t6", inputs="p6", outputs="p7")
        .exponential("t7", inputs="p7", outputs="p2")
    )
    policy = Policy.from_table(["p7"], [((0,), {"t5": 0.5, "t6": 0.5})])
    return _plan(builder, ["p1", "p2"], ["p4"], policy=policy)


def _crowd() -> Tuple[Plan, Sequence[str]]:
    """Weights, an inhibitor arc, a capacity, priorities, a decision place without action, the
    environment, and resource transitions that fire spontaneously."""
    builder = (
        NetBuilder("crowd")
        .place("in")
        .place("hall")
        .place("room", capacity=2)
        .place("desk")
        .place("raw")
        .place("low")
        .place("high")
        .place("order")
        .exponential("enter", inputs="in", outputs="hall")
        .exponential("arrive", rate=5.0, inputs={}, outputs="order")
        .immediate("to_room", inputs="hall", outputs="room", priority=2)
        .immediate("to_desk", inputs="hall", outputs=["desk"], inhibitors={"room": 1})
        .immediate("pair", inputs={"hall": 2}, outputs=["desk", "in"], weight=3.0)
        .exponential("make", inputs="room", outputs=["in", "raw"])
        .exponential("serve", inputs=["desk", "order"], outputs="in")
        .exponential("back", inputs="desk", outputs="in")
        .immediate("sort_low", inputs="raw", outputs="low")
        .immediate("sort_high", inputs="raw", outputs="high", weight=2.0)
    )
    return _plan(
        builder,
        ["in", "hall"],
        ["raw", "low", "high", "order"],
        idle=["hall"],
        simulate_environment=True,
    )


def _errands(steered: bool = False) -> Tuple[Plan, Sequence[str]]:
    """Tasks in a queue that is full at three, robots that carry them, events of every sort: held,
    resumed, in private places, by time, and in a place that only an event leaves."""
    builder = (
        NetBuilder("errands")
        .place("Idle")
        .place("Roam")
        .place("Look")
        .place("Deliver")
        .place("Charge")
        .place("Shelter")
        .place("dock", tokens=1)
        .place("orders")
        .exponential("order", rate=5.0, inputs={}, outputs="orders", inhibitors={"orders": 3})
        .immediate("take", inputs=["Idle", "orders"], outputs="Deliver", priority=2)
        .immediate("roam", inputs="Idle", outputs="Roam")
        .exponential("look", inputs="Roam", outputs="Look")
        .exponential("bored", inputs="Roam", outputs="Look")
        .exponential("on", inputs="Look", outputs="Roam")
        .exponential("home", inputs="Look", outputs="Idle")
        .exponential("delivered", inputs="Deliver", outputs="Idle")
        .exponential("refused", inputs="Deliver", outputs=["Idle", "orders"])
        .exponential("low", inputs=["Deliver", "dock"], outputs="Charge")
        .exponential("alarm", inputs="Deliver", outputs="Shelter")
        .exponential("full", inputs="Charge", outputs=["Deliver", "dock"])
        .exponential("calm", inputs="Shelter", outputs="Deliver")
    )
    if steered:
        builder.exponential("dropped", inputs="Deliver", outputs="Idle")
    return _plan(
        builder,
        ["Idle", "Roam"],
        ["dock", "orders"],
        idle=["Idle"],
        events={
            "order": EventSource("/orders", "std_msgs/String"),
            "bored": EventSource("boring", "std_msgs/Bool", edge=True),
            "low": EventSource("battery", "std_msgs/Float32", "data < 0.2", hold=True, resume=True),
            "alarm": EventSource("bell", "std_msgs/Empty", resume=True),
            "calm": EventSource(after=0.05),
        },
        tasks=Tasks(
            ("orders",), ("delivered",), {"Deliver": "dropped", "Charge": None} if steered else {}
        ),
        on_evict={
            "Deliver": {"orders": 1},
            "Charge": {"orders": 1, "dock": 1},
            "Shelter": {"orders": 1},
        },
    )


def _steered_errands() -> Tuple[Plan, Sequence[str]]:
    """The errands of a plan that says what a robot does whose task is cancelled."""
    return _errands(steered=True)


def _relay() -> Tuple[Plan, Sequence[str]]:
    """A robot that carries a task moves on by itself: *Fetch* is private."""
    builder = (
        NetBuilder("relay")
        .place("Idle")
        .place("Fetch")
        .place("Carry")
        .place("Deliver")
        .place("orders")
        .exponential("order", rate=5.0, inputs={}, outputs="orders")
        .immediate("take", inputs=["Idle", "orders"], outputs="Fetch")
        .exponential("fetched", inputs="Fetch", outputs="Carry")
        .exponential("carried", inputs="Carry", outputs="Deliver")
        .exponential("delivered", inputs="Deliver", outputs="Idle")
    )
    return _plan(
        builder,
        ["Idle"],
        ["orders"],
        idle=["Idle"],
        events={"order": EventSource("/orders", "std_msgs/String")},
        tasks=Tasks(("orders",), ("delivered",), {}),
        on_evict={place: {"orders": 1} for place in ("Fetch", "Carry", "Deliver")},
    )


def _rounds() -> Tuple[Plan, Sequence[str]]:
    """Private places in a ring, which events leave as well; one of them may be resumed."""
    builder = (
        NetBuilder("rounds")
        .place("A")
        .place("B")
        .place("C")
        .place("news")
        .exponential("ab", inputs="A", outputs="B")
        .exponential("ba", inputs="B", outputs="A")
        .exponential("bc", inputs="B", outputs="C")
        .exponential("ca", inputs="C", outputs="A")
        .exponential("jump", inputs="A", outputs="C")
        .exponential("late", inputs="B", outputs="A")
        .exponential("tell", inputs={}, outputs="news")
    )
    return _plan(
        builder,
        ["A", "B"],
        ["news"],
        events={
            "jump": EventSource("jump", "std_msgs/Bool", "data", hold=True, resume=True),
            "late": EventSource(after=0.04, resume=True),
            "tell": EventSource("/news", "std_msgs/String"),
        },
    )


_MAKERS: List[Callable[[], Tuple[Plan, Sequence[str]]]] = [
    _tour,
    _meet,
    _tokens,
    _crowd,
    _errands,
    _rounds,
    _steered_errands,
    _relay,
]

NOT_REACTING, REACTING, STEERED, RELAY = (0, 1, 2, 3), (4, 5), 6, 7
"""The kinds of plans without and with events, tasks and data, the one for orders about tasks, and
the one in which robots carry tasks through private places."""


@lru_cache(maxsize=None)
def make_plan(
    kind: int, robots: int, partial: bool, evict_after: float, fence_after: float, witness: bool
) -> Plan:
    """A plan for a team. The seed of its draws is 0.

    :param kind: selects one of the small nets, modulo their number.
    :param robots: the number of robots.
    :param partial: whether synchronisation is partial.
    :param evict_after: see :class:`~gspn_framework_package.model.plan.Timing`.
    :param fence_after: see :class:`~gspn_framework_package.model.plan.Timing`.
    :param witness: whether the team has a witness.
    """
    plan, start = _MAKERS[kind % len(_MAKERS)]()
    team = [RobotSpec("r%d" % (i + 1), start[i % len(start)]) for i in range(robots)]
    from dataclasses import replace

    return replace(
        plan.with_robots(team),
        spawn=(start[0],),
        synchronisation=Synchronisation.PARTIAL if partial else Synchronisation.FULL,
        timing=Timing(evict_after, fence_after),
        witness=("w",) if witness else (),
    ).validate()


def another_plan(plan: Plan, source: random.Random) -> Tuple[Plan, Dict[str, str]]:
    """A plan for a team that follows ``plan``, and the mapping of its names: another policy, other
    names, places that come, go or lose their actions. Some of them fit no state of the team."""
    while True:
        data = json.loads(json.dumps(plan_to_json(plan)))
        mapping: Dict[str, str] = {}
        for _ in range(source.choice([1, 1, 2, 3])):
            source.choice(_CHANGES)(data, mapping, source)
        try:
            new = plan_from_json(data)
        except GspnError:
            continue
        if not _fails_always(new):
            return new, mapping


def _fails_always(plan: Plan) -> bool:
    """Whether a place without an action leaves a choice that nobody makes, of which the check of a
    plan warns: its robots would fail however often they try again."""
    for place in plan.action_places:
        leaving = plan.net.consumers[plan.net.place_number(place)]
        timed = [plan.net.transitions[t].timed for t in leaving]
        if plan.actions.get(place) is None and all(timed) and len(timed) > 1:
            return True
    return False


Change = Callable[[Dict[str, Any], Dict[str, str], random.Random], None]


def _change_policy(data: Dict[str, Any], mapping: Dict[str, str], source: random.Random) -> None:
    """Another policy: none, or one that draws differently."""
    rows = data["policy"].get("rows", [])
    if not rows or source.random() < 0.3:
        data["policy"] = policy_to_json(Policy())
        return
    source.shuffle(rows)
    for row in rows:
        if len(row.get("choose", {})) > 1:
            names = list(row["choose"])
            share = source.random()
            row["choose"] = {names[0]: share, names[1]: 1 - share}


def _rename(data: Dict[str, Any], mapping: Dict[str, str], source: random.Random) -> None:
    """Another name for a place or transition, with a mapping or (seldom) without."""
    nodes = [n["name"] for n in (*data["net"]["places"], *data["net"]["transitions"])]
    transitions = [t["name"] for t in data["net"]["transitions"]]
    if source.random() < 0.5 and transitions:  # results of running actions name transitions
        old = source.choice(transitions)
    else:
        old = source.choice(nodes)
    if old == "full":  # also a word of the format
        return
    new = "%s_%d" % (old.split("_")[0], source.randrange(1000))
    if new in nodes:
        return
    for key in data:
        data[key] = _with_name(data[key], old, new)
    first = next((a for a, b in mapping.items() if b == old), old)
    if source.random() < 0.9:
        mapping[first] = new


def _with_name(data: Any, old: str, new: str) -> Any:
    if isinstance(data, dict):
        return {(new if k == old else k): _with_name(v, old, new) for k, v in data.items()}
    if isinstance(data, list):
        return [_with_name(v, old, new) for v in data]
    return new if data == old else data


def _add_place(data: Dict[str, Any], mapping: Dict[str, str], source: random.Random) -> None:
    """An action place to which robots go from another one, and back."""
    number = source.randrange(1000)
    place, there, back = ("%s%d" % (word, number) for word in ("New", "there", "back"))
    home = source.choice(list(data["actions"]))
    data["net"]["places"].append({"name": place})
    for name, begin, end in ((there, home, place), (back, place, home)):
        data["net"]["transitions"].append({"name": name, "timed": True, "rate": 1.0})
        data["net"]["arcs"] += [{"from": begin, "to": name}, {"from": name, "to": end}]
    data["actions"][place] = data["actions"][home]


def _remove_place(data: Dict[str, Any], mapping: Dict[str, str], source: random.Random) -> None:
    """An action place, and the transitions around it, are no more; its robots go elsewhere."""
    places = list(data["actions"])
    if len(places) < 3:
        return
    gone, heir = source.sample(places, 2)
    net = data["net"]
    near = {a["to"] for a in net["arcs"] if a["from"] == gone}
    near |= {a["from"] for a in net["arcs"] if a["to"] == gone}
    data["robots"] = _with_name(data["robots"], gone, heir)
    data["spawn"] = _with_name(data["spawn"], gone, heir)
    for key in list(data):
        data[key] = _without(data[key], {gone, *near})
    net = data["net"]
    net["places"] = [p for p in net["places"] if p["name"] != gone]
    net["transitions"] = [t for t in net["transitions"] if t["name"] not in near]
    net["arcs"] = [a for a in net["arcs"] if not {a["from"], a["to"]} & {gone, *near}]
    data["policy"] = policy_to_json(Policy())
    first = next((a for a, b in mapping.items() if b == gone), gone)
    if source.random() < 0.8:
        mapping[first] = heir


def _without(data: Any, names: Set[str]) -> Any:
    """The data without entries of these names, but for the nodes and arcs of the net."""
    if isinstance(data, dict):
        return {k: _without(v, names) for k, v in data.items() if k not in names}
    if isinstance(data, list):
        return [_without(v, names) for v in data if not (isinstance(v, str) and v in names)]
    return data


def _change_resources(data: Dict[str, Any], mapping: Dict[str, str], source: random.Random) -> None:
    """A resource place comes, or goes with its tokens."""
    net = data["net"]
    if data["resource_places"] and source.random() < 0.5:
        gone = source.choice(data["resource_places"])
        for key in list(data):
            data[key] = _without(data[key], {gone})
        net = data["net"]
        net["places"] = [p for p in net["places"] if p["name"] != gone]
        net["arcs"] = [a for a in net["arcs"] if gone not in (a["from"], a["to"])]
        data["policy"] = policy_to_json(Policy())
        first = next((a for a, b in mapping.items() if b == gone), gone)
        if source.random() < 0.7:
            mapping[first] = ""
        return
    if not net["transitions"]:
        return
    place = "pool%d" % source.randrange(1000)
    net["places"].append({"name": place, "tokens": source.randint(1, 3)})
    transition = source.choice(net["transitions"])["name"]
    net["arcs"] += [{"from": place, "to": transition}, {"from": transition, "to": place}]
    data["resource_places"].append(place)


def _take_action(data: Dict[str, Any], mapping: Dict[str, str], source: random.Random) -> None:
    """A place loses its action. (With events that last, robots might move for ever at no time.)"""
    if data.get("events"):
        return
    data["actions"][source.choice(list(data["actions"]))] = None


_CHANGES: List[Change] = [
    _change_policy,
    _change_policy,
    _rename,
    _rename,
    _add_place,
    _remove_place,
    _change_resources,
    _take_action,
]


def random_result(plan: Plan, place: str, source: random.Random, *, nonsense: bool = True) -> str:
    """A possible result of the action in ``place``: the name of a transition that leaves it, or ""
    to let the policy decide; occasionally nonsense, if ``nonsense`` is true."""
    net = plan.net
    leaving = [net.transitions[t] for t in net.consumers[net.place_number(place)]]
    timed = [t.name for t in leaving if t.timed]
    immediate = [t.name for t in leaving if not t.timed]
    if nonsense and source.random() < 0.01:
        return "nonsense"
    if immediate and (not timed or source.random() < 0.7):
        return "" if source.random() < 0.9 else source.choice(immediate)
    return source.choice(timed) if timed else ""


def random_data(plan: Plan, number: int, source: random.Random) -> Dict[str, Any]:
    """Data that an action may write: nothing in a plan without events, and often nothing.

    :param number: makes the values differ from all others.
    """
    if not plan.events:
        return {}
    written: Dict[str, Any] = {}
    for name, share in (("a", 0.3), ("robot.b", 0.1), ("team.c", 0.3), ("task.d", 0.05)):
        if source.random() < share:
            written[name] = [number, name]
    return written
