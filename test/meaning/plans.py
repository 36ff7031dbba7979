"""Small plans, each aimed at a rule of what a plan means.

A *family* makes plans of one kind from a source of random numbers; ``made`` has number k of seed s.
Robots, rates and weights are drawn such that no two numbers that might be confused are equal: a
wrong rule then gives wrong numbers.
"""

from __future__ import annotations

import random
from dataclasses import replace
from typing import Any, Callable, Dict, Iterator, List, Mapping, NamedTuple, Optional, Sequence

from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.event import EventSource
from gspn_framework_package.model.failure import FailureEnd, FailureRule
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import LostKind, LostRule, Plan, RobotSpec
from gspn_framework_package.model.policy import Policy, PolicyRow
from gspn_framework_package.model.policy_cell import Cell, CountTest

WORK = FunctionAction("actions.work", "work")
Rows = Sequence[Any]


class Sample(NamedTuple):
    """A plan to compare.

    :ivar name: its family, seed and number.
    :ivar losses: rate (1/s) at which each robot is lost in it.
    """

    name: str
    plan: Plan
    losses: float = 0.0


def _rate(source: random.Random) -> float:
    return round(source.uniform(0.4, 3.0), 3)


def _mean(source: random.Random) -> Duration:
    return Duration.exponential(round(source.uniform(0.3, 2.0), 3))


def _split(source: random.Random, names: Sequence[str]) -> Dict[str, float]:
    """Probabilities of these, none of them equal to another."""
    weights = [source.uniform(0.2, 1.0) for _ in names]
    rounded = [round(w / sum(weights), 3) for w in weights]
    return dict(zip(names, [*rounded[:-1], 1.0 - sum(rounded[:-1])]))


def _plan(
    net: Net,
    *,
    null: Sequence[str] = (),
    resources: Sequence[str] = (),
    policy: Optional[Policy] = None,
    **more: Any,
) -> Plan:
    """A plan of a net: every place of robots has an action, but those in ``null``."""
    places = [p for p in net.places if p.name not in resources]
    return Plan(
        net,
        policy=policy or Policy(),
        actions={p.name: None if p.name in null else WORK for p in places},
        resource_places=frozenset(resources),
        robots=tuple(
            RobotSpec("%s_%d" % (p.name, i), p.name) for p in places for i in range(p.tokens)
        ),
        simulate_environment=True,
        **more,
    ).validate()


# -- zero time: who goes first ---------------------------------------------------------------------


def unequal_classes(source: random.Random) -> Plan:
    """Two classes of unequal counts compete in zero time for one tool, which comes back from time
    to time. Robots of either class let the policy decide, or name the transition."""
    many = source.choice([2, 2, 3])
    urgent = source.choice([1, 1, 1, 2])
    b = NetBuilder("unequal classes").place("a", many).place("b", 1)
    b.place("away_a").place("away_b").place("tool", source.randint(0, 1)).place("out", 1)
    b.immediate("take_a", inputs=["a", "tool"], outputs=["away_a"], priority=1)
    b.immediate("take_b", inputs=["b", "tool"], outputs=["away_b"], priority=urgent)
    b.exponential("back_a", rate=_rate(source), inputs="away_a", outputs=["a", "out"])
    b.exponential("back_b", rate=_rate(source), inputs="away_b", outputs=["b", "out"])
    b.exponential("give", rate=_rate(source), inputs="out", outputs="tool")
    if source.random() < 0.5:  # someone may do without
        b.place("off")
        b.immediate("leave_b", inputs="b", outputs="off", inhibitors={"tool": 1}, weight=0.5)
        b.exponential("return_b", rate=_rate(source), inputs="off", outputs="b")
    net = b.build()
    null = [p for p in ("a", "b") if source.random() < 0.5]
    outcomes, durations = {}, {}
    for place in ("a", "b"):
        if place not in null and source.random() < 0.6:
            durations[place] = _mean(source)
        if place not in null and source.random() < 0.4:
            outcomes[place] = {"take_" + place: 1.0}
    return _plan(net, null=null, resources=["tool", "out"], durations=durations, outcomes=outcomes)


def spontaneous_first(source: random.Random) -> Plan:
    """Transitions of resources, robots that draw, robots that name and robots that ask for an
    exponential transition want the same tool in the same moment."""
    b = NetBuilder("stages").place("raw", source.randint(0, 1)).place("tool").place("other")
    b.place("waits", 1).place("names", 1).place("asks", 1).place("home").place("spare", 1)
    b.exponential("deliver", rate=_rate(source), inputs="spare", outputs="raw")
    weights = source.choice([(0.7, 0.4), (0.7, 0.0), (0.0, 0.0)])
    b.immediate(
        "make",
        inputs="raw",
        outputs="tool",
        weight=weights[0],
        priority=source.choice([1, 1, 2]),
    )
    b.immediate(
        "spoil",
        inputs="raw",
        outputs="other",
        weight=weights[1],
        priority=source.choice([1, 1, 2]),
    )
    if source.random() < 0.7:
        b.immediate("steal", inputs="tool", outputs="other", weight=0.5, inhibitors={"home": 1})
    b.immediate("take", inputs=["waits", "tool"], outputs="home", priority=source.choice([1, 1, 2]))
    b.immediate("name", inputs=["names", "tool"], outputs="home", priority=source.choice([1, 1, 2]))
    b.exponential("ask", rate=_rate(source), inputs=["asks", "tool"], outputs="home")
    b.exponential("recycle", rate=_rate(source), inputs="other", outputs="spare")
    for target in ("waits", "names", "asks"):
        b.exponential(
            "to_" + target,
            rate=_rate(source),
            inputs="home",
            outputs=[target, "spare"],
            inhibitors={target: 1},
        )
    net = b.build()
    durations = {p: _mean(source) for p in ("waits", "names") if source.random() < 0.5}
    return _plan(
        net,
        resources=["raw", "tool", "other", "spare"],
        durations=durations,
        outcomes={"names": {"name": 1.0}},
        null=["waits"] if "waits" not in durations and source.random() < 0.7 else [],
    )


def draw_again(source: random.Random) -> Plan:
    """A robot gets done where others wait that have drawn what needs a partner: they draw
    again."""
    count = source.choice([2, 3, 3])
    b = NetBuilder("draw again").place("p", count).place("q").place("r")
    b.place("tool", 1)
    tool = ["tool"] if source.random() < 0.5 else []
    b.immediate("pair", inputs=["p", "p"], outputs=["q", "q"], priority=source.choice([1, 1, 2]))
    b.immediate("alone", inputs=["p", *tool], outputs=["r", *tool], weight=0.6)
    b.exponential("back_q", rate=_rate(source), inputs="q", outputs="p")
    b.exponential("back_r", rate=_rate(source), inputs="r", outputs="p")
    inhibitor = source.random() < 0.5
    if inhibitor:
        b.immediate("third", inputs="p", outputs="q", inhibitors={"r": 1}, weight=0.3)
    net = b.build()
    names = ["pair", "alone"] + (["third"] if inhibitor else [])
    rows = [PolicyRow((None,), tuple(_split(source, names).items()))]
    if source.random() < 0.5:
        rows.append(PolicyRow((2,), tuple(_split(source, names[:2]).items())))
    outcomes: Dict[str, Dict[str, float]] = {}
    if source.random() < 0.3:
        outcomes["p"] = _split(source, ["", source.choice(["pair", "alone"])])
    return _plan(
        net,
        resources=["tool"],
        policy=Policy(["p"], rows),
        durations={"p": _mean(source)},
        outcomes=outcomes,
    )


def timeless_actions(source: random.Random) -> Plan:
    """Robots come together into places with actions that take no time, two here and one there. The
    actions end one after the other, and the first robot to go takes the tool."""
    b = NetBuilder("timeless").place("home", 3).place("a").place("b")
    b.place("tool", source.choice([0, 1])).place("used", 1)
    b.immediate("leave", inputs={"home": 3}, outputs={"a": 2, "b": 1})
    b.immediate("go_a", inputs=["a", "tool"], outputs=["home", "used"])
    # were all actions to end at once, the more urgent one would go first
    urgent = source.choice([1, 2])
    b.immediate("go_b", inputs=["b", "tool"], outputs=["home", "used"], priority=urgent)
    b.exponential("skip", rate=_rate(source), inputs="used", outputs="tool", inhibitors="tool")
    if source.random() < 0.5:
        b.immediate("aside", inputs="a", outputs="home", weight=0.3)
    outcomes: Dict[str, Dict[str, float]] = {}
    if source.random() < 0.5:
        outcomes["b"] = {"go_b": 1.0}
    return _plan(
        b.build(),
        resources=["tool", "used"],
        durations={"home": _mean(source)},
        outcomes=outcomes,
    )


# -- draws -----------------------------------------------------------------------------------------


def held_draws(source: random.Random) -> Plan:
    """Robots draw what cannot fire for the moment. Another robot moves: with a change of the
    marking, so that they draw again, or without one, so that they keep their draws."""
    b = NetBuilder("held draws").place("wait", source.choice([1, 2])).place("partner")
    b.place("free").place("here", 1).place("there").place("tool", source.randint(0, 1))
    b.immediate("meet", inputs=["wait", "partner"], outputs=["free", "partner"])
    b.immediate("alone", inputs="wait", outputs="free", weight=0.4)
    b.immediate("use", inputs=["wait", "tool"], outputs=["free", "tool"], weight=0.3)
    b.exponential("rest", rate=_rate(source), inputs="free", outputs="wait")
    spin = source.random() < 0.7
    if spin:  # the marking stays as it is
        needs = ["here", "tool"] if source.random() < 0.5 else ["here"]
        b.immediate("spin", inputs=needs, outputs=needs, weight=1.3)
    b.immediate("go", inputs="here", outputs="there", weight=0.7)
    b.exponential("back", rate=_rate(source), inputs="there", outputs="here")
    if source.random() < 0.5:
        b.exponential("lend", rate=_rate(source), outputs="tool", inhibitors="tool")
        b.exponential("take", rate=_rate(source), inputs="tool")
    rows = [
        PolicyRow((None,), tuple(_split(source, ["meet", "alone", "use"]).items())),
        PolicyRow((None,), tuple(_split(source, ["go", "spin"] if spin else ["go"]).items())),
    ]
    durations = {"here": _mean(source)}
    if source.random() < 0.6:
        durations["wait"] = _mean(source)
    if source.random() < 0.3:
        durations["partner"] = _mean(source)
    return _plan(b.build(), resources=["tool"], policy=Policy(["free"], rows), durations=durations)


def candidates(source: random.Random) -> Plan:
    """A robot has drawn what cannot fire. Then a partner is done, which itself asks for something
    else: that makes a transition possible that goes before what was drawn."""
    b = NetBuilder("candidates").place("p", source.choice([1, 2])).place("q", 1)
    b.place("tool", source.choice([0, 1])).place("c")
    weighed = source.random() < 0.3
    b.immediate(
        "join", inputs=["p", "q"], outputs=["c", "c"], priority=1 if weighed else 2, weight=1.5
    )
    b.immediate("use", inputs=["p", "tool"], outputs=["c", "tool"], weight=0.7)
    b.immediate("spray", inputs="p", outputs="c", inhibitors={"c": 1}, weight=0.9)
    b.immediate("wash", inputs=["q", "tool"], outputs=["c", "tool"])
    b.exponential("to_p", rate=_rate(source), inputs="c", outputs="p", inhibitors={"p": 2})
    b.exponential("to_q", rate=_rate(source), inputs="c", outputs="q", inhibitors={"q": 1})
    b.exponential("lend", rate=_rate(source), outputs="tool", inhibitors="tool")
    b.exponential("take", rate=_rate(source), inputs="tool")
    rows = [PolicyRow((1,), (("wash", 1.0),))]
    if not weighed:
        rows.append(PolicyRow((None,), tuple(_split(source, ["join", "use", "spray"]).items())))
    return _plan(
        b.build(),
        resources=["tool"],
        policy=Policy(["q"], rows),
        durations={"p": _mean(source), "q": _mean(source)},
    )


def policy_rows(source: random.Random) -> Plan:
    """Rows of several numbers of wildcards, in an order that matters, over transitions of several
    priorities; rows that let robots wait; strict policies; weights of zero."""
    kind = source.choice(["weights", "precedence", "any"])
    others = source.choice([0, 1])
    b = NetBuilder("rows").place("d", 2 - others).place("x", 1).place("y")
    b.place("tool", source.randint(0, 2))
    names = ["t0", "t1", "t2"]
    for i, name in enumerate(names):
        needs = ["tool"] if source.random() < 0.5 else []
        b.immediate(
            name,
            weight=source.choice([0.0, 0.3, 1.0, 2.0]),
            priority=1 if kind == "precedence" else source.choice([1, 1, 2, 3]),
            inputs=["d", *needs],
            outputs=[source.choice(["x", "y"])] + (["tool"] if i == 0 else []),
            inhibitors={source.choice(["x", "y"]): 2} if source.random() < 0.3 else {},
        )
    b.exponential("back_x", rate=_rate(source), inputs="x", outputs=["d"])
    b.exponential(
        "back_y", rate=_rate(source), inputs="y", outputs=["d", "tool"], inhibitors={"tool": 2}
    )
    b.exponential("wear", rate=_rate(source), inputs="tool")
    b.place("e", others)
    b.exponential("swap", rate=_rate(source), inputs="x", outputs="e")
    b.immediate("u0", inputs="e", outputs="y", weight=0.8)
    b.immediate("u1", inputs="e", outputs="x", weight=0.3)
    rows: List[PolicyRow] = []
    for _ in range({"weights": source.randint(0, 1), "any": source.randint(1, 4)}.get(kind, 0)):
        counts = tuple(source.choice([None, None, 0, 1, 2]) for _ in range(3))
        pool = source.choice([names, ["u0", "u1"], [*names, "u0", "u1"]])
        chosen = source.sample(pool, source.choice([0, 1, 2, 2]))
        rows.append(PolicyRow(counts, tuple(_split(source, chosen).items()) if chosen else ()))
    if kind == "precedence":
        # for every marking, and then rows of one cell, two for each count of two places
        cells = [(c, n) for c in (1, 2) for n in (0, 1) for _ in range(2)]
        source.shuffle(cells)
        for column, count in [(-1, 0), *cells]:
            counts = tuple(count if i == column else None for i in range(3))
            chosen = source.sample(names, source.choice([0, 2, 2, 2]) if column >= 0 else 2)
            rows.append(PolicyRow(counts, tuple(_split(source, chosen).items()) if chosen else ()))
    durations = {"d": _mean(source)} if source.random() < 0.6 else {}
    null = ["d"] if not durations and source.random() < 0.5 else []
    outcomes = {}
    if not null and source.random() < 0.3:
        outcomes["d"] = _split(source, ["", "t0", "t1"])
    capacity = b.build()
    places = [p._replace(capacity=3) if p.name == "tool" else p for p in capacity.places]
    net = Net(places, capacity.transitions, capacity.arcs, "rows")
    return _plan(
        net,
        null=null,
        resources=["tool"],
        policy=Policy(["x", "tool", "d"], rows),
        durations=durations,
        outcomes=outcomes,
        strict=source.random() < 0.25,
    )


def policy_tests(source: random.Random) -> Plan:
    """Rows as in ``policy_rows``, half of whose cells are tests instead, and rows of one cell each,
    some of which test and some of which do not."""
    plan = policy_rows(source)
    tests = [CountTest(sign, n) for n in (0, 1) for sign in (">", "<=", "!=")]
    tests += [CountTest(">=", 1), CountTest("<", 2), CountTest("<", 1), CountTest(">=", 0)]
    rows = [
        row._replace(
            counts=tuple(
                source.choice(tests) if source.random() < 0.5 else cell for cell in row.counts
            )
        )
        for row in plan.policy.rows
    ]
    for _ in range(source.choice([0, 4, 6])):
        counts: List[Cell] = [None, None, None]
        cells: List[Cell] = [0, 1, 2, *tests[::4]]
        counts[source.randrange(3)] = source.choice(cells)
        chosen = source.sample(["t0", "t1", "t2"], 2)
        rows.append(PolicyRow(tuple(counts), tuple(_split(source, chosen).items())))
    return plan.with_policy(Policy(plan.policy.places, rows))


def mixed_partners(source: random.Random) -> Plan:
    """A move takes robots that named it and robots that ask the policy, and there are more of them
    than it takes: who stays behind decides how it goes on."""
    b = (
        NetBuilder("partners")
        .place("p", source.choice([2, 3, 3]))
        .place("q", source.choice([0, 1, 1]))
    )
    b.place("r").place("s")
    need = source.choice([1, 2])
    # a tool that is often away: robots of all kinds wait for it, and move when it comes
    gate = source.random() < 0.5
    b.place("tool", 1).place("used")
    b.immediate(
        "join",
        inputs={"p": need, "q": 1, **({"tool": 1} if gate else {})},
        outputs={"r": need, "s": 1, **({"used": 1} if gate else {})},
        priority=source.choice([1, 1, 2]),
    )
    b.exponential("reset", rate=0.3, inputs="used", outputs="tool")
    b.immediate("other", inputs="p", outputs="s", weight=0.4, inhibitors={"s": 2})
    b.exponential("back_r", rate=_rate(source), inputs="r", outputs="p")
    b.exponential("back_s", rate=_rate(source), inputs="s", outputs="q", inhibitors={"q": 1})
    b.exponential("over", rate=_rate(source), inputs="s", outputs="p")
    rows = []
    if source.random() < 0.7:
        rows.append(PolicyRow((None,), tuple(_split(source, ["join", "other"]).items())))
    outcomes: Dict[str, Dict[str, float]] = {"p": _split(source, ["", "join"])}
    if source.random() < 0.4:
        outcomes["p"] = _split(source, ["", "join", "other"])
    durations = {"p": _mean(source)}
    if source.random() < 0.5:
        durations["q"] = _mean(source)
    return _plan(
        b.build(),
        resources=["tool", "used"],
        policy=Policy(["r"], rows),
        durations=durations,
        outcomes=outcomes,
    )


def asked_exponential(source: random.Random) -> Plan:
    """An exponential transition takes robots that named it, and none that ask the policy, although
    those are held up in the same place."""
    b = NetBuilder("asked").place("p", source.choice([2, 3])).place("r", source.choice([0, 1]))
    b.exponential("lift", rate=_rate(source), inputs={"p": 2}, outputs={"r": 2})
    b.immediate("alone", inputs="p", outputs="r", inhibitors={"r": 1})
    b.exponential("back", rate=_rate(source), inputs="r", outputs="p")
    return _plan(
        b.build(),
        durations={"p": _mean(source)},
        outcomes={"p": _split(source, ["", "lift"])},
    )


def who_asked(source: random.Random) -> Plan:
    """The one who asks for a move of two robots comes along, whoever else is free and was done
    before: most drew what is not enabled. Whoever stays behind can leave at once, unless it named
    the move."""
    b = _leaving_one_behind("who asked", source).place("p", 3)
    b.immediate(
        "join",
        inputs={"p": 2, "tool": 1},
        outputs={"r": 2, "used": 1, "exit": 1},
        inhibitors="exit",
    )
    rows = [PolicyRow((), (("join", 0.15), ("other", 0.85)))]
    return _plan(
        b.build(),
        resources=["tool", "used", "exit"],
        policy=Policy([], rows),
        durations={"p": Duration.exponential(round(source.uniform(0.2, 0.5), 3))},
        outcomes={"p": _seldom(source, "join")},
    )


def who_stays(source: random.Random) -> Plan:
    """A robot elsewhere asks for two of three robots, some of which named the move and some of
    which ask the policy: each two are equally likely. Whoever stays behind can leave at once,
    unless it named the move."""
    b = _leaving_one_behind("who stays", source).place("q", 1).place("p", 3)
    b.immediate(
        "join",
        inputs={"p": 2, "q": 1, "tool": 1},
        outputs={"r": 2, "q": 1, "used": 1, "exit": 1},
        inhibitors="exit",
    )
    return _plan(
        b.build(),
        null=["q"],
        resources=["tool", "used", "exit"],
        durations={"p": Duration.exponential(round(source.uniform(0.2, 0.5), 3))},
        outcomes={"p": _seldom(source, "join")},
    )


def _leaving_one_behind(name: str, source: random.Random) -> NetBuilder:
    """A net in which a move of robots in p, yet to be added, opens an exit for those that stay."""
    b = NetBuilder(name).place("r").place("tool", source.choice([0, 1])).place("used", 1)
    b.place("exit")
    b.immediate("other", inputs=["p", "exit"], outputs="r", weight=0.4)
    b.exponential("close", rate=round(source.uniform(4.0, 8.0), 3), inputs="exit")
    b.exponential("back", rate=round(source.uniform(2.0, 4.0), 3), inputs="r", outputs="p")
    b.exponential("reset", rate=1.2, inputs="used", outputs="tool", inhibitors="tool")
    return b


def _seldom(source: random.Random, name: str) -> Dict[str, float]:
    """Outcomes of robots of which about a third names a transition."""
    chance = round(source.uniform(0.25, 0.4), 3)
    return {"": 1.0 - chance, name: chance}


# -- the marking -----------------------------------------------------------------------------------


def capacities(source: random.Random) -> Plan:
    """Places with room for few robots, who are doing or done there; a robot that stays in a full
    place needs no room."""
    room = source.choice([1, 2])
    b = NetBuilder("capacity").place("out", source.choice([2, 3])).place("in", 0, capacity=room)
    b.place("bin", 0, capacity=2).place("side")
    timed = source.random() < 0.5
    enter: Dict[str, Any] = {"inputs": "out", "outputs": "in"}
    if timed:
        b.exponential("enter", rate=_rate(source), **enter)
    else:
        b.immediate("enter", **enter)
        b.immediate("aside", inputs="out", outputs="side", weight=0.3)
        b.exponential("return", rate=_rate(source), inputs="side", outputs="out")
    # were there no capacities, there would still be an end of states
    b.immediate("leave", inputs="in", outputs=["out", "bin"], weight=0.5, inhibitors={"bin": 4})
    b.immediate("again", inputs="in", outputs="in", weight=0.8)
    b.immediate("drop", inputs="in", outputs="out", weight=0.2)
    b.exponential("empty", rate=_rate(source), servers=source.choice([1, 2, None]), inputs="bin")
    durations = {"in": _mean(source)}
    if source.random() < 0.5:
        durations["out"] = _mean(source)
    return _plan(b.build(), resources=["bin"], durations=durations)


def inhibitors(source: random.Random) -> Plan:
    """Inhibitor arcs count the robots of a place, whether they are doing or done."""
    b = NetBuilder("inhibitors").place("a", source.choice([2, 3])).place("b").place("c")
    b.place("token", source.choice([0, 1]))
    b.immediate("go", inputs="a", outputs="b", inhibitors={"b": source.choice([1, 2])})
    b.immediate(
        "pass", inputs="a", outputs="c", weight=0.4, inhibitors={"a": source.choice([2, 3])}
    )
    b.exponential(
        "ask", rate=_rate(source), inputs="b", outputs="c", inhibitors={"c": source.choice([1, 2])}
    )
    b.exponential("quit", rate=_rate(source), inputs="b", outputs="a")
    b.exponential("back", rate=_rate(source), inputs="c", outputs="a", inhibitors={"token": 1})
    b.exponential("on", rate=_rate(source), outputs="token", inhibitors={"token": 1, "b": 2})
    b.exponential("off", rate=_rate(source), inputs="token")
    durations = {p: _mean(source) for p in ("a", "b") if source.random() < 0.7}
    return _plan(b.build(), resources=["token"], durations=durations)


def degrees(source: random.Random) -> Plan:
    """Transitions of the environment with one, two or any number of servers, and arcs of several
    weights; robots that race, each with a clock of its own."""
    b = (
        NetBuilder("degrees")
        .place("stock", source.choice([3, 4]))
        .place("parts")
        .place("w", source.choice([2, 3]))
    )
    b.place("v").place("done")
    weight = source.choice([1, 2])
    b.exponential(
        "make",
        rate=_rate(source),
        servers=source.choice([1, 2, None]),
        inputs={"stock": weight},
        outputs={"parts": weight},
    )
    b.exponential(
        "scrap",
        rate=_rate(source),
        servers=source.choice([1, 2, None]),
        inputs={"parts": 2},
        outputs={"stock": 2},
    )
    b.exponential(
        "move", rate=_rate(source), servers=source.choice([1, None]), inputs="w", outputs="v"
    )
    b.exponential("wander", rate=_rate(source), inputs="w", outputs=["w", "done"])
    b.exponential("home", rate=_rate(source), inputs=["v", "parts"], outputs=["w", "stock"])
    if source.random() < 0.5:
        b.exponential("two", rate=_rate(source), inputs={"v": 2}, outputs={"w": 2})
    return _plan(b.build(), resources=["stock", "parts", "done"])


def phased(source: random.Random) -> Plan:
    """Durations of several phases: Erlang, hyperexponential, a mixture; where nothing but the own
    token counts, and where partners wait."""
    b = NetBuilder("phases").place("a", source.choice([1, 2])).place("b", 1).place("c")
    b.exponential("go", rate=1.0, inputs="a", outputs="c")
    b.exponential("turn", rate=2.0, inputs="a", outputs="b")
    b.exponential("meet", rate=1.0, inputs=["b", "c"], outputs=["a", "b"])
    if source.random() < 0.5:
        b.immediate("slip", inputs="b", outputs="a", weight=0.5)
    kinds = [
        Duration.erlang(source.choice([2, 3]), round(source.uniform(0.4, 1.5), 3)),
        Duration.hyper_erlang([(0.3, 1, 0.4), (0.7, 1, 1.6)]),
        Duration.hyper_erlang([(0.6, 2, 0.7), (0.4, 1, 1.9)]),
        _mean(source),
    ]
    return _plan(
        b.build(),
        durations={p: source.choice(kinds) for p in ("a", "b", "c")},
        outcomes={"b": {"meet": 1.0}},
    )


def counters(source: random.Random) -> Plan:
    """Places that only count: nothing reads them, but what adds to them changes the marking."""
    b = NetBuilder("counters").place("d", 2).place("x").place("n").place("m", source.choice([0, 1]))
    b.place("tool", 0)
    b.immediate("meet", inputs=["d", "tool"], outputs=["x", "tool", "m"])
    b.immediate("alone", inputs="d", outputs=["x", "n"], weight=0.5)
    b.exponential("back", rate=_rate(source), inputs="x", outputs="d")
    b.exponential("tick", rate=_rate(source), outputs="n")
    b.exponential("lend", rate=_rate(source), outputs="tool", inhibitors="tool")
    b.exponential("take", rate=_rate(source), inputs="tool")
    rows = [PolicyRow((), tuple(_split(source, ["meet", "alone"]).items()))]
    durations = {"d": _mean(source)} if source.random() < 0.5 else {}
    return _plan(
        b.build(), resources=["n", "m", "tool"], policy=Policy([], rows), durations=durations
    )


# -- events, ends, losses, failures ----------------------------------------------------------------


def _eventful(source: random.Random, hold: bool) -> Plan:
    b = NetBuilder("events").place("work", source.choice([1, 2])).place("alarm").place("done")
    b.place("kit", source.choice([0, 1]))
    taken = ["kit"] if source.random() < 0.6 else []
    b.exponential(
        "interrupt",
        rate=_rate(source),
        inputs=["work", *taken],
        outputs=["alarm"],
        inhibitors={"alarm": 1} if source.random() < 0.4 else {},
    )
    if source.random() < 0.3:
        b.exponential("finish", rate=_rate(source), inputs="work", outputs="done")
    else:
        b.immediate("finish", inputs="work", outputs="done", inhibitors={"done": 1})
        if source.random() < 0.5:
            b.immediate("pair", inputs=["work", "work"], outputs=["done", "done"])
    b.exponential("again", rate=_rate(source), inputs="done", outputs="work")
    b.exponential("repair", rate=_rate(source), inputs="alarm", outputs=["work", *taken])
    b.exponential("supply", rate=_rate(source), outputs="kit", inhibitors="kit")
    b.exponential("waste", rate=_rate(source), inputs="kit")
    return _plan(
        b.build(),
        resources=["kit"],
        durations={"work": source.choice([_mean(source), Duration.erlang(2, 0.9)])},
        events={"interrupt": EventSource("sensor", "std_msgs/Empty", hold=hold)},
    )


def events(source: random.Random) -> Plan:
    """Events interrupt robots that are doing or done, with and without a resource."""
    return _eventful(source, hold=False)


def held_events(source: random.Random) -> Plan:
    """Events that are held until they can have an effect."""
    return _eventful(source, hold=True)


def ends(source: random.Random) -> Plan:
    """A condition that ends the run, also in zero time, and places that robots never leave."""
    b = NetBuilder("until").place("a", source.choice([2, 3])).place("b").place("c").place("sink")
    b.place("count", capacity=6)  # never full: the run ends before
    b.immediate("go", inputs="a", outputs=["b", "count"], weight=0.6)
    b.immediate("pass", inputs="a", outputs="c", weight=0.4)
    b.immediate("on", inputs="b", outputs="c")
    b.exponential("back", rate=_rate(source), inputs="c", outputs="a")
    b.exponential("end", rate=_rate(source), inputs="c", outputs="sink")
    condition = source.choice(["b >= 2", "count >= 3", "sink >= 1 and a == 0", "b == 1 and c == 1"])
    durations = {p: _mean(source) for p in ("a", "b") if source.random() < 0.6}
    return _plan(
        b.build(), resources=["count"], until=condition + " or count >= 5", durations=durations
    )


def at_rest(source: random.Random) -> Plan:
    """Robots come to places that they never leave, one after the other, while the environment goes
    on: the run ends with the last of them."""
    b = NetBuilder("at rest").place("a", source.choice([1, 2])).place("b", 1).place("sink")
    b.place("clock", source.choice([0, 1]))
    b.immediate("go", inputs="a", outputs="b")
    b.exponential("end", rate=_rate(source), inputs="b", outputs="sink")
    b.exponential("tick", rate=_rate(source), outputs="clock", inhibitors="clock")
    b.exponential("tock", rate=_rate(source), inputs="clock")
    durations = {p: _mean(source) for p in ("a", "sink") if p == "a" or source.random() < 0.5}
    return _plan(b.build(), resources=["clock"], durations=durations)


def failures(source: random.Random) -> Plan:
    """Actions that fail: robots try again, go another way, stop the team or wait for ever."""
    b = (
        NetBuilder("failures")
        .place("a", source.choice([1, 2]))
        .place("b", 1)
        .place("c")
        .place("tool", 1)
    )
    b.immediate("go", inputs=["a", "tool"], outputs=["c", "tool"])
    b.immediate("slip", inputs="a", outputs="b", weight=source.choice([0.0, 0.5]))
    b.exponential("on", rate=_rate(source), inputs="b", outputs="a")
    b.exponential("off", rate=_rate(source), inputs="b", outputs="c")
    b.exponential("back", rate=_rate(source), inputs="c", outputs="a", inhibitors={"a": 2})
    rules = {
        "a": source.choice(
            [
                FailureRule.retry(source.choice([1, 2]), 0.0),
                FailureRule.fire("slip"),
                FailureRule("again", 1, end=FailureEnd.FIRE, transition="slip"),
            ]
        ),
        "b": source.choice(
            [
                FailureRule.retry(1, 0.0),
                FailureRule.fire("on"),
                FailureRule.stop(),
                FailureRule(),
            ]
        ),
    }
    outcomes: Dict[str, Dict[str, float]] = {}
    if source.random() < 0.5:
        outcomes["a"] = _split(source, ["", "go"])
    return _plan(
        b.build(),
        resources=["tool"],
        durations={"a": _mean(source)},
        outcomes=outcomes,
        failures={"a": 0.35, "b": 0.2},
        on_failure=rules,
    )


def losses(source: random.Random) -> Plan:
    """Robots are lost; what they held comes back, and who waits for them goes another way."""
    b = NetBuilder("losses").place("a", 2).place("b", 1).place("c").place("tool", 1)
    b.immediate("meet", inputs=["a", "b"], outputs=["a", "c"])
    b.immediate("alone", inputs="a", outputs="c", weight=0.6)
    b.immediate("take", inputs=["a", "tool"], outputs="b", weight=0.3)
    b.exponential(
        "give", rate=_rate(source), inputs="b", outputs=["a", "tool"], inhibitors={"tool": 1}
    )
    b.exponential("back", rate=_rate(source), inputs="c", outputs=source.choice(["a", "b"]))
    rows = [PolicyRow((), tuple(_split(source, ["meet", "alone"]).items()))]
    lost = source.choice([LostRule(), LostRule(LostKind.STOP), LostRule(LostKind.FIRE, "alone")])
    return _plan(
        b.build(),
        resources=["tool"],
        policy=Policy([], rows),
        durations={"a": _mean(source), "b": _mean(source)},
        outcomes={"b": {"meet": 0.5, "give": 0.5}},
        on_evict={"b": {"tool": 1}},
        on_lost=lost,
    )


def agents(source: random.Random) -> Plan:
    """Transitions that take more robots than they put back, and the reverse."""
    b = NetBuilder("agents").place("a", 2).place("b", 1).place("c")
    b.immediate("merge", inputs=["a", "b"], outputs="c")
    b.exponential("part", rate=_rate(source), inputs="c", outputs=["a", "b"])
    b.exponential("die", rate=0.2, inputs="a", outputs=[])
    b.exponential("cross", rate=_rate(source), inputs="b", outputs="b", inhibitors={"c": 1})
    return _plan(
        b.build(),
        durations={"a": _mean(source), "b": _mean(source)},
        outcomes={"a": _split(source, ["", "die"]), "b": _split(source, ["merge", "cross"])},
    )


def identities(source: random.Random) -> Plan:
    """Robots with actions of their own, which transitions move together: routes and the order of
    arcs say which of them goes where."""
    b = NetBuilder("identities").place("a", 1).place("b", 1).place("c").place("d")
    b.immediate("swap", inputs=["a", "b"], outputs=["c", "d"], weight=0.6)
    b.exponential("off_c", rate=_rate(source), inputs="c", outputs="a")
    b.exponential("off_d", rate=_rate(source), inputs="d", outputs="b")
    b.immediate("cross", inputs="a", outputs="d", weight=0.4, inhibitors={"d": 1})
    b.exponential("over", rate=_rate(source), inputs="d", outputs="a", inhibitors={"a": 2})
    plan = _plan(b.build(), durations={"a": _mean(source), "c": Duration.erlang(2, 1.3)})
    own: Dict[str, Any] = {source.choice(["a", "c", "d"]): None}
    robots = (plan.robots[0]._replace(actions=own), *plan.robots[1:])
    routing = {"swap": {"a": "d"}} if source.random() < 0.5 else {}
    return replace(plan, robots=robots, routing=routing).validate()


# -- anything --------------------------------------------------------------------------------------


def anything(source: random.Random) -> Plan:
    """A ring of two or three places with short cuts, and any mixture of what a plan may have."""
    places = ["p%d" % i for i in range(source.choice([2, 3, 3]))]
    kind = {p: source.choice(["race", "decide", "instant", "null", "ask"]) for p in places}
    kind[places[0]] = source.choice(["race", "decide", "ask"])
    starts = [source.choice(places) for _ in range(source.choice([2, 2, 3]))]
    b = NetBuilder("anything")
    for place in places:
        room = max(2, starts.count(place)) if source.random() < 0.15 else None
        b.place(place, starts.count(place), capacity=room)
    b.place("tool", 1)
    immediate: List[str] = []
    leaving: Dict[str, List[str]] = {p: [] for p in places}
    interrupts: List[str] = []
    for i, place in enumerate(places):
        timed = kind[place] in ("race", "ask")
        for number in range(source.choice([1, 2])):
            name = "t%d%d" % (i, number)
            target = places[(i + 1) % len(places)] if number == 0 else source.choice(places)
            inputs, outputs = [place], [target]
            inhibiting: Mapping[str, int] = {}
            if number and source.random() < 0.4:
                inputs.append(source.choice(places))
                outputs.append(source.choice(places))
            if source.random() < 0.25:
                inhibiting = {source.choice(places): source.choice([1, 2])}
            if source.random() < 0.25:
                inputs.append("tool")
                outputs.append("tool")
            elif kind[place] == "ask" and number == 0 and source.random() < 0.5:
                inhibiting = {target: 2}
            ends_of: Dict[str, Any] = {
                "inputs": inputs,
                "outputs": outputs,
                "inhibitors": inhibiting,
            }
            if timed:
                b.exponential(name, rate=_rate(source), servers=source.choice([1, None]), **ends_of)
            else:
                b.immediate(
                    name,
                    weight=source.choice([0.3, 0.7, 1.0]),
                    priority=source.choice([1, 1, 1, 2]),
                    **ends_of,
                )
                immediate.append(name)
            leaving[place].append(name)
    if source.random() < 0.25:
        b.exponential(
            "event",
            rate=_rate(source),
            inputs=source.choice(places),
            outputs=source.choice(places),
        )
        interrupts.append("event")
    if source.random() < 0.4:
        b.exponential("break", rate=_rate(source), inputs="tool")
        b.exponential("mend", rate=_rate(source), outputs="tool", inhibitors="tool")
    durations = {}
    for place in places:
        if kind[place] == "decide" or (kind[place] == "ask" and source.random() < 0.5):
            durations[place] = source.choice(
                [_mean(source), _mean(source), Duration.erlang(2, 0.8)]
            )
    outcomes = {}
    for place in places:
        if kind[place] in ("decide", "instant") and source.random() < 0.4:
            named = source.choice(leaving[place])
            outcomes[place] = _split(source, ["", named])
    rows = []
    for _ in range(source.choice([0, 0, 1, 2, 3]) if immediate else 0):
        chosen = source.sample(immediate, source.randint(1, min(2, len(immediate))))
        counts = (source.choice([None, None, 0, 1]),)
        rows.append(PolicyRow(counts, tuple(_split(source, chosen).items())))
    return _plan(
        b.build(),
        null=[p for p in places if kind[p] == "null"],
        resources=["tool"],
        policy=Policy([source.choice(places)], rows),
        durations=durations,
        outcomes=outcomes,
        until="p1 >= 3" if source.random() < 0.1 else None,
        events={t: EventSource("sensor", "std_msgs/Empty") for t in interrupts},
        strict=bool(rows) and source.random() < 0.15,
    )


FAMILIES: Dict[str, Callable[[random.Random], Plan]] = {
    family.__name__: family
    for family in (
        unequal_classes,
        spontaneous_first,
        draw_again,
        timeless_actions,
        held_draws,
        candidates,
        policy_rows,
        policy_tests,
        mixed_partners,
        asked_exponential,
        who_stays,
        who_asked,
        capacities,
        inhibitors,
        degrees,
        phased,
        counters,
        events,
        held_events,
        ends,
        at_rest,
        failures,
        losses,
        agents,
        identities,
        anything,
    )
}
"""All families, by name."""


def made(family: str, seed: int, number: int) -> Sample:
    """Plan ``number`` of a family."""
    source = random.Random("%s|%d|%d" % (family, seed, number))
    plan = FAMILIES[family](source)
    rate = round(source.uniform(0.02, 0.1), 3) if family == "losses" else 0.0
    return Sample("%s %d %d" % (family, seed, number), plan, rate)


def samples(seed: int, count: int, families: Sequence[str] = tuple(FAMILIES)) -> Iterator[Sample]:
    """``count`` plans, of each family in turn."""
    for k in range(count):
        yield made(families[k % len(families)], seed, k // len(families))
