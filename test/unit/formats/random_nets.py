"""Random nets, with every feature and hostile names, for tests of formats."""

from hypothesis import strategies as st

from gspn_framework_package.model.marking_function import parse_value, quoted_place
from gspn_framework_package.model.net import Arc, Net, Place, Transition

AWKWARD = "ab1_ .:<>&\"'{}\\#[]()äλ∞|-*?/\t"
NAMES = (
    st.text(AWKWARD, min_size=1, max_size=8).map(lambda text: " ".join(text.split())).filter(bool)
)
POINTS = st.tuples(*[st.integers(-(10**6), 10**6).map(lambda n: n / 64)] * 2)
POSITIONS = st.one_of(st.none(), POINTS)
# as the page writes them
BENDS = st.lists(
    st.tuples(*[st.integers(-(10**7), 10**7).map(lambda n: n / 100)] * 2), max_size=2
).map(tuple)
RATES = st.floats(min_value=1e-300, max_value=1e300, allow_nan=False)
WEIGHTS = st.one_of(st.just(0.0), RATES)
COUNTS = st.one_of(st.integers(0, 5), st.integers(0, 2**53))


@st.composite
def functions(draw, places):
    """A rate or weight that depends on the marking; the name of a place may be in quotes."""
    named = [p.name for p in places if not ("'" in p.name and '"' in p.name)]
    if not named:
        return draw(RATES)
    terms = st.sampled_from(named).map(lambda name: "#" + quoted_place(name))
    a, b = draw(terms), draw(terms)
    shape = draw(
        st.sampled_from(["1 + %s", "min(%s, 3) / 2 - -%s", "max(1, %s) + 1e-3 * (%s + 2)"])
    )
    return parse_value(shape % ((a, b)[: shape.count("%s")]))


@st.composite
def nets(draw, capacities=True, servers=(1, None, 3), dependent=False):
    """A net of up to 5 places and 5 transitions; ``dependent``: some rates and weights depend on
    the marking."""
    names = draw(st.lists(NAMES, min_size=2, max_size=10, unique=True))
    split = draw(st.integers(1, len(names) - 1))
    places = []
    for name in names[:split][:5]:
        tokens = draw(COUNTS)
        capacity = None
        if capacities and draw(st.booleans()):
            capacity = min(max(1, tokens + draw(st.integers(0, 3))), 2**53)
        places.append(Place(name, tokens, capacity, draw(POSITIONS)))
    transitions = []
    for name in names[split:][:5]:
        if draw(st.booleans()):
            timed = (True, draw(RATES), 1.0, 1, draw(st.sampled_from(servers)))
        else:
            timed = (False, 1.0, draw(WEIGHTS), draw(st.integers(0, 4)), 1)
        transition = Transition(name, *timed, draw(POSITIONS))
        if dependent and draw(st.booleans()):
            key = "rate" if transition.timed else "weight"
            transition = transition._replace(**{key: draw(functions(places))})
        transitions.append(transition)
    arcs = []
    for _ in range(draw(st.integers(0, 8))):
        place = draw(st.sampled_from(places)).name
        transition = draw(st.sampled_from(transitions)).name
        weight = draw(st.integers(1, 4))
        kind = draw(st.sampled_from(["input", "output", "inhibitor"]))
        ends = (transition, place) if kind == "output" else (place, transition)
        arcs.append(Arc(*ends, weight, kind == "inhibitor", draw(BENDS)))
    name = draw(st.one_of(st.just("net"), NAMES))
    return Net(places, transitions, arcs, name)
