"""Random bounded GSPNs for Hypothesis: weights, priorities, inhibitor arcs, capacities, servers,
vanishing markings."""

from hypothesis import strategies as st

from gspn_framework_package.model.builder import NetBuilder


def split(draw, total, places):
    """``total`` tokens over some of the places, as place -> weight."""
    weights = {}
    for _ in range(total):
        place = draw(st.sampled_from(places))
        weights[place] = weights.get(place, 0) + 1
    return weights


@st.composite
def bounded_nets(
    draw, max_places=4, max_transitions=6, max_tokens=4, immediate=True, dependent=False
):
    """A net in which every firing keeps the number of tokens, but for a place with a capacity that
    may come on top; ``dependent``: some rates and weights depend on the marking."""
    builder = NetBuilder("generated")
    places = ["p%d" % i for i in range(draw(st.integers(2, max_places)))]
    tokens = split(draw, draw(st.integers(1, max_tokens)), places)
    for place in places:
        builder.place(place, tokens=tokens.get(place, 0))
    limited = draw(st.booleans())
    if limited:
        builder.place("limited", tokens=draw(st.integers(0, 2)), capacity=2)
    for i in range(draw(st.integers(1, max_transitions))):
        total = draw(st.integers(1, 2))
        inputs = split(draw, total, places)
        outputs = split(draw, total, places)
        inhibitors = {}
        if draw(st.integers(0, 3)) == 0:
            inhibitors = {draw(st.sampled_from(places)): draw(st.integers(1, 3))}
        if limited:
            side = draw(st.sampled_from([None, None, inputs, outputs]))
            if side is not None:
                side["limited"] = 1
        function = None
        if dependent and draw(st.booleans()):
            shape = draw(st.sampled_from(["0.5 + #%s * #%s", "2 / (1 + #%s) + min(#%s, 2) / 4"]))
            function = shape % (draw(st.sampled_from(places)), draw(st.sampled_from(places)))
        if immediate and draw(st.integers(0, 2)) == 0:
            builder.immediate(
                "i%d" % i,
                weight=function or draw(st.sampled_from([0.5, 1.0, 2.0, 3.0])),
                priority=draw(st.integers(1, 3)),
                inputs=inputs,
                outputs=outputs,
                inhibitors=inhibitors,
            )
        else:
            builder.exponential(
                "e%d" % i,
                rate=function or draw(st.sampled_from([0.25, 0.5, 1.0, 2.0, 4.0])),
                servers=draw(st.sampled_from([1, 1, 2, None])),
                inputs=inputs,
                outputs=outputs,
                inhibitors=inhibitors,
            )
    return builder.build()


def reference_space(net, *, untimed=False, limit=100_000):
    """The reachability graph by the firing rule of the model alone: marking -> {transition number:
    marking}."""
    graph = {}
    waiting = [net.initial_marking]
    while waiting:
        marking = waiting.pop()
        if marking in graph:
            continue
        assert len(graph) < limit
        graph[marking] = {
            t: net.fire(marking, t) for t in net.enabled(marking, by_priority=not untimed)
        }
        waiting += graph[marking].values()
    return graph
