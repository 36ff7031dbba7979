"""Random small plans for Hypothesis, with everything that a run knows: durations of every kind,
outcomes, failures and their rules, timeouts, policies with wildcards, priorities, weights,
inhibitor arcs, capacities, resources, an environment, routing, actions of single robots, agents
that come and go, events, subnets, tasks."""

from dataclasses import replace
from itertools import starmap

from generated_nets import split
from hypothesis import strategies as st

from gspn_framework_package.formats.plan_json import plan_from_json, plan_to_json
from gspn_framework_package.formats.subnets import expand, fill_parameters
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.errors import PlanError
from gspn_framework_package.model.event import EventSource, Tasks
from gspn_framework_package.model.failure import FailureRule
from gspn_framework_package.model.net import Arc, Net, Transition
from gspn_framework_package.model.plan import (
    LostKind,
    LostRule,
    Plan,
    RobotSpec,
)
from gspn_framework_package.model.policy import Policy, PolicyRow
from gspn_framework_package.model.policy_cell import CountTest

ACT = FunctionAction("actions.work", "work")

DURATIONS = [
    Duration.exponential(1.0),
    Duration.erlang(3, 0.8),
    Duration.erlang(40, 1.1),
    Duration.gamma(0.6, 0.7),
    Duration.gamma(7.5, 1.3),
    Duration.lognormal(0.5, 0.9),
    Duration.deterministic(1.0),
    Duration.deterministic(0.0),
    Duration.uniform(0.2, 1.4),
    Duration.empirical([0.1, 0.3, 0.4, 2.0]),
    Duration.hyper_erlang([(0.3, 2, 0.4), (0.7, 1, 1.6)]),
]

TESTS = [(">=", 1), ("<", 2), ("!=", 1), (">", 1), ("<=", 1), ("!=", 0), (">=", 0)]
CELLS = [None, None, 0, 1, 2, *starmap(CountTest, TESTS)]


@st.composite
def small_plans(draw):
    """A plan of up to five action places and two resources, with one to four robots."""
    builder = NetBuilder("generated")
    acts = ["a%d" % i for i in range(draw(st.integers(2, 5)))]
    resources = ["r%d" % i for i in range(draw(st.integers(0, 2)))]
    robots = [draw(st.sampled_from(acts)) for _ in range(draw(st.integers(1, 4)))]
    capacities = {}
    for place in acts:
        if draw(st.integers(0, 7)) == 0:
            capacities[place] = max(robots.count(place), draw(st.integers(1, 3)))
        builder.place(place, tokens=robots.count(place), capacity=capacities.get(place))
    for place in resources:
        builder.place(
            place, tokens=draw(st.integers(0, 2)), capacity=draw(st.sampled_from([None, 3]))
        )
    moves = {}  # transition -> its action places: from, to
    immediates = []
    names = ["t%d" % i for i in range(draw(st.integers(2, 7)))]
    for i, name in enumerate(names):
        total = draw(st.sampled_from([1, 1, 1, 1, 2, 2, 0])) if i else 1
        into = total
        if total and draw(st.integers(0, 9)) == 0:
            into = draw(st.integers(0, total + 1))
        inputs, outputs = split(draw, total, acts), split(draw, into, acts)
        moves[name] = (list(inputs), list(outputs))
        for place in resources:
            side = draw(st.sampled_from([None, None, inputs, outputs]))
            if side is not None:
                side[place] = 1
        inhibitors = {}
        if draw(st.integers(0, 4)) == 0:
            inhibitors = {draw(st.sampled_from(acts + resources)): draw(st.integers(1, 2))}
        if not inputs and not outputs:
            continue
        if draw(st.booleans()):
            immediates.append(name)
            builder.immediate(
                name,
                weight=draw(st.sampled_from([0.0, 1.0, 1.0, 3.0])),
                priority=draw(st.integers(1, 2)),
                inputs=inputs,
                outputs=outputs,
                inhibitors=inhibitors,
            )
        else:
            builder.exponential(
                name,
                rate=draw(st.sampled_from([0.5, 1.0, 2.0])),
                servers=draw(st.sampled_from([1, 2, None])),
                inputs=inputs,
                outputs=outputs,
                inhibitors=inhibitors,
            )
    net = builder.build()
    policy = Policy()
    if immediates and draw(st.booleans()):
        places = draw(
            st.lists(st.sampled_from(acts + resources), min_size=1, max_size=3, unique=True)
        )
        rows = []
        for _ in range(draw(st.integers(1, 5))):
            counts = tuple(draw(st.sampled_from(CELLS)) for _ in places)
            chosen = draw(st.lists(st.sampled_from(immediates), max_size=2, unique=True))
            chances = [1.0] if len(chosen) == 1 else draw(st.sampled_from([[0.5, 0.5], [0.1, 0.9]]))
            rows.append(PolicyRow(counts, tuple(zip(chosen, chances))))
        policy = Policy(places, rows)
    leaving = {
        p: [t for t in moves if t in net.transition_index and p in moves[t][0]] for p in acts
    }
    outcomes, failures, rules, timeouts = {}, {}, {}, {}
    for place in acts:
        if leaving[place] and draw(st.integers(0, 2)) == 0:
            named = draw(
                st.lists(
                    st.sampled_from([*leaving[place], ""]), min_size=1, max_size=2, unique=True
                )
            )
            outcomes[place] = dict(zip(named, [1.0] if len(named) == 1 else [0.4, 0.6]))
        if draw(st.integers(0, 3)) == 0:
            failures[place] = draw(st.sampled_from([0.1, 0.5]))
        if draw(st.integers(0, 3)) == 0:
            timeouts[place] = draw(st.sampled_from([0.5, 1.0, 1.5]))
        rule = draw(st.sampled_from([None, "retry", "retry", "fire", "stop"]))
        if rule == "fire" and leaving[place]:
            rules[place] = FailureRule.fire(draw(st.sampled_from(leaving[place])))
        elif rule == "retry":
            rules[place] = FailureRule.retry(
                draw(st.integers(1, 3)), draw(st.sampled_from([0.0, 0.3]))
            )
        elif rule == "stop" and draw(st.integers(0, 3)) == 0:
            rules[place] = FailureRule.stop()
    routing = {}
    for name, (sources, targets) in moves.items():
        if name in net.transition_index and sources and targets and draw(st.integers(0, 2)) == 0:
            routing[name] = {draw(st.sampled_from(sources)): draw(st.sampled_from(targets))}
    own = {}
    if draw(st.integers(0, 3)) == 0:
        own = {draw(st.sampled_from(acts)): draw(st.sampled_from([None, ACT]))}
    lost = draw(st.sampled_from([LostRule(), LostRule(LostKind.STOP), None]))
    if lost is None:
        lost = LostRule(LostKind.FIRE, draw(st.sampled_from(list(net.transition_index))))
    evict = {}
    if resources and draw(st.booleans()):
        evict = {draw(st.sampled_from(acts)): {draw(st.sampled_from(resources)): 1}}
    return Plan(
        net,
        policy=policy,
        actions={p: ACT if draw(st.integers(0, 4)) else None for p in acts},
        resource_places=frozenset(resources),
        robots=tuple(
            RobotSpec("robot_%d" % (k + 1), place, own if k == 0 else {})
            for k, place in enumerate(robots)
        ),
        strict=draw(st.integers(0, 4)) == 0,
        on_failure=rules,
        timeouts=timeouts,
        routing=routing,
        simulate_environment=draw(st.booleans()),
        on_lost=lost,
        on_evict=evict,
        until=draw(st.sampled_from([None, None, "a0 >= 3", "min(a0, a1) >= 1 and not a0 == a1"])),
        durations={p: draw(st.sampled_from(DURATIONS)) for p in acts if draw(st.integers(0, 3))},
        outcomes=outcomes,
        failures=failures,
    ).validate()


@st.composite
def with_events(draw, plans, sources=None):
    """One of ``plans`` with one or two events that interrupt robots.

    :param sources: a strategy for where events come from, and what they do; by default, any.
    """
    plan = draw(plans)
    net = plan.net
    acts, resources = list(plan.action_places), sorted(plan.resource_places)
    transitions, arcs, events = [], [], {}
    for number in range(draw(st.integers(1, 2))):
        name = "event%d" % number
        place = draw(st.sampled_from(acts))
        transitions.append(
            Transition(name, timed=True, rate=draw(st.sampled_from([0.3, 1.0, 3.0])))
        )
        arcs += [Arc(place, name), Arc(name, draw(st.sampled_from(acts)))]
        if resources and draw(st.booleans()):
            taken = draw(st.sampled_from(resources))
            arcs.append(Arc(taken, name))
            if draw(st.booleans()):
                arcs.append(Arc(name, taken))
        if draw(st.integers(0, 3)) == 0:
            arcs.append(Arc(draw(st.sampled_from(acts)), name, draw(st.integers(1, 2)), True))
        events[name] = draw(any_event() if sources is None else sources)
    if resources and draw(st.booleans()):
        back = "back"  # what events take comes back
        transitions.append(Transition(back, timed=True, rate=0.7))
        arcs += [Arc(acts[0], back), Arc(back, acts[0]), Arc(back, resources[0])]
    return replace(
        plan,
        net=Net(net.places, [*net.transitions, *transitions], [*net.arcs, *arcs], net.name),
        events=events,
    ).validate()


def any_event():
    """Events that come at a rate or after a time, held or not."""
    topics = st.tuples(st.booleans(), st.booleans()).map(
        lambda flags: EventSource("sensor", "std_msgs/Empty", hold=flags[0], resume=flags[1])
    )
    times = st.tuples(st.sampled_from([0.37, 1.73]), st.booleans()).map(
        lambda given: EventSource(after=given[0], hold=given[1])
    )
    return topics | times


def plain_event():
    """Events that come at a rate and are not held."""
    return st.just(EventSource("sensor", "std_msgs/Empty"))


@st.composite
def with_subnet(draw, plans):
    """One of ``plans`` in which another one stands for a place, with its resources (marked ones
    too, some of them shared) and a parameter."""
    plan, inner = draw(plans), plan_to_json(draw(plans))
    place = draw(st.sampled_from(plan.action_places))
    outer = plan_to_json(plan)
    for key in ("timeout", "on_failure", "durations", "outcomes", "failures"):
        outer.get(key, {}).pop(place, None)
    for robot in outer["robots"] if isinstance(outer["robots"], list) else ():
        robot.get("actions", {}).pop(place, None)
    if place in plan.policy.places:
        outer.pop("policy")
    if place in outer.get("until", ""):
        outer.pop("until")
    inner.pop("policy", None)  # it may not speak of what leaves the exit
    inner["parameters"] = {"speed": 1}
    for action in filter(None, inner["actions"].values()):
        action["settings"] = {"speed": "${speed}"}
    spec = {key: draw(st.sampled_from(sorted(inner["actions"]))) for key in ("entry", "exit")}
    share = {r: r for r in inner["resource_places"] if r in plan.resource_places}
    if share and draw(st.booleans()):
        spec["share"] = share
    outer["actions"][place] = {"plan": "inner", "with": {"speed": 2}, **spec}
    try:
        data, net, parts = expand(
            outer, plan.net, ".", lambda _, given: plan_from_json(fill_parameters(inner, given))
        )
    except PlanError:  # the arcs of the place are not those of several places
        return plan
    return plan_from_json(data, net, parts=parts, checked=True).validate()


@st.composite
def with_tasks(draw, plan):
    """The plan with tasks that come into one of its resource places, if it has any."""
    if not plan.resource_places:
        return plan
    net, queue = plan.net, draw(st.sampled_from(sorted(plan.resource_places)))
    order = Transition("order", timed=True, rate=1.0)
    arcs = [Arc("order", queue), Arc(queue, "order", 3, True)]
    done = draw(st.lists(st.sampled_from([t.name for t in net.transitions]), max_size=2))
    return replace(
        plan,
        net=Net(net.places, [*net.transitions, order], [*net.arcs, *arcs], net.name),
        tasks=Tasks((queue,), tuple(dict.fromkeys(done))),
    ).validate()
