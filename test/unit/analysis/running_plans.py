"""Small random plans: robots that work, decide with or without an action, meet, inhibit each other
and share a tool."""

from hypothesis import strategies as st

from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.duration import Duration
from gspn_framework_package.model.net import Arc, Net, Place, Transition
from gspn_framework_package.model.plan import Plan, RobotSpec
from gspn_framework_package.model.policy import Policy, PolicyRow

WORK = FunctionAction("actions.work", "work")


@st.composite
def running_plans(draw, kinds=("work", "decide", "instant"), joint=True):
    """Plans of 2 to 4 places and 2 or 3 robots.

    :param kinds: of the places: ``work`` (exponential transitions), ``decide`` (immediate ones, and
        an action that takes time) or ``instant`` (immediate ones, and no action).
    :param joint: whether anything but its own token can hold a robot up.
    """
    count = draw(st.integers(2, 4))
    places = ["p%d" % i for i in range(count)]
    kind = {p: draw(st.sampled_from(kinds)) for p in places}
    kind[places[0]] = "work"
    transitions, arcs = [], []
    for i, place in enumerate(places):
        for number in range(draw(st.integers(1, 2))):
            name = "t%d%d" % (i, number)
            timed = kind[place] == "work"
            transitions.append(
                Transition(
                    name,
                    timed=timed,
                    rate=draw(st.sampled_from([0.5, 1.0, 2.0])),
                    weight=draw(st.sampled_from([0.5, 1.0])),
                    priority=1 if timed else draw(st.sampled_from([1, 1, 2])),
                )
            )
            # the first transitions make a ring, so that most plans go on for ever
            if number == 0:
                ways = [(place, places[(i + 1) % count])]
            else:
                ways = [(place, draw(st.sampled_from(places)))]
                if joint and draw(st.booleans()):
                    ways.append((draw(st.sampled_from(places)), draw(st.sampled_from(places))))
                if joint and draw(st.integers(0, 3)) == 0:
                    arcs.append(
                        Arc(draw(st.sampled_from(places)), name, draw(st.integers(1, 2)), True)
                    )
            for source, target in ways:
                arcs += [Arc(source, name), Arc(name, target)]
            if joint and draw(st.integers(0, 5)) == 0:
                arcs += [Arc("tool", name), Arc(name, "tool")]
    starts = draw(st.lists(st.sampled_from(places), min_size=2, max_size=3))
    net = Net(
        [*(Place(p, starts.count(p)) for p in places), Place("tool", 1)], transitions, arcs, "small"
    )
    return Plan(
        net=net,
        policy=draw(_policies(net, places)),
        actions={p: None if kind[p] == "instant" else WORK for p in places},
        durations={
            p: draw(_durations(joint))
            for p in places
            if kind[p] == "decide" or (kind[p] == "work" and draw(st.booleans()))
        },
        outcomes={p: draw(_outcomes(net, p)) for p in places if joint and kind[p] == "decide"},
        resource_places=frozenset(["tool"]),
        robots=tuple(RobotSpec("r%d" % i, place) for i, place in enumerate(starts)),
    ).validate()


def _durations(any_kind):
    kinds = [Duration.exponential(0.5), Duration.exponential(1.5)]
    if any_kind:
        kinds += [Duration.erlang(2, 1.0), Duration.hyper_erlang([(0.4, 1, 2.0), (0.6, 2, 0.5)])]
    return st.sampled_from(kinds)


@st.composite
def _outcomes(draw, net, place):
    """The policy decides, or now and then the action."""
    leaving = [net.transitions[t].name for t in net.consumers[net.place_number(place)]]
    if draw(st.booleans()):
        return {"": 1.0}
    return {"": 0.75, draw(st.sampled_from(leaving)): 0.25}


@st.composite
def _policies(draw, net, places):
    immediate = [t.name for t in net.transitions if not t.timed]
    if not immediate or draw(st.booleans()):
        return Policy()
    looks_at = draw(st.lists(st.sampled_from(places), max_size=2, unique=True))
    rows = []
    for _ in range(draw(st.integers(1, 3))):
        chosen = draw(st.lists(st.sampled_from(immediate), max_size=3, unique=True))
        weights = [draw(st.integers(1, 3)) for _ in chosen]
        rows.append(
            PolicyRow(
                tuple(draw(st.sampled_from([None, None, 0, 1])) for _ in looks_at),
                tuple((t, w / sum(weights)) for t, w in zip(chosen, weights)),
            )
        )
    return Policy(looks_at, rows)
