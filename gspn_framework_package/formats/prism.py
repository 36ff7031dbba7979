"""The language of the PRISM model checker, which Storm reads too: write.

A net becomes a Markov chain with one integer variable per place and one command per transition.
Each transition T also gets a reward structure ``throughput_T``, so that ``R{"throughput_T"}=? [S]``
is its throughput. PRISM has no immediate transitions, so a net with some is refused. It can be
written as JANI, or as the chain that remains after its vanishing markings are eliminated
(:func:`~gspn_framework_package.formats.markov_chain.prism_files`)."""

from __future__ import annotations

import math
from typing import Mapping, Sequence

from gspn_framework_package.formats.symbolic import concession, identifiers, upper_bounds
from gspn_framework_package.model.errors import NetError
from gspn_framework_package.model.marking_function import text_operations
from gspn_framework_package.model.net import Net

_OPERATIONS = text_operations(
    {
        **{s: "(%%s %s %%s)" % s for s in "+-*/"},
        "negate": "(-%s)",
        "^": "pow(1.0*%s, %s)",
        "pow": "pow(1.0*%s, %s)",
        "min": "min(...)",
        "max": "max(...)",
        "floor": "floor(%s)",
        "ceil": "ceil(%s)",
        "round": "floor(%s + 0.5)",
        "sqrt": "pow(1.0*%s, 0.5)",
        "exp": "pow(%r, %%s)" % math.e,
        "log": "log(%%s, %r)" % math.e,
        "ln": "log(%%s, %r)" % math.e,
    }
)


def to_bytes(net: Net, bounds: Mapping[str, int] = {}) -> bytes:
    """Return the net as a PRISM model.

    :param bounds: the maximum number of tokens of places, where known; PRISM's symbolic engines
        need it.
    :raises NetError: the net has immediate transitions.
    :raises RefusedError: PRISM lacks a function that a rate uses.
    """
    immediate = [t.name for t in net.transitions if not t.timed]
    if immediate:
        raise NetError(
            "PRISM has no immediate transitions",
            element="transition '%s'" % immediate[0],
            hint="write JANI, which Storm reads, or the chain without vanishing markings",
        )
    places, transitions = identifiers(
        [p.name for p in net.places], [t.name for t in net.transitions]
    )
    names = list(places.values())
    lines = ["ctmc", ""]
    lines += ["// place %s is %s" % (" ".join(k.split()), v) for k, v in places.items() if k != v]
    lines += ["module net"]
    for place, limit in zip(net.places, upper_bounds(net, bounds)):
        kind = "int" if limit is None else "[0..%d]" % limit
        lines.append("  %s : %s init %d;" % (places[place.name], kind, place.tokens))
    for t in range(len(net.transitions)):
        guard, rate, update = _guard(net, t, names), _rate(net, t, names), _update(net, t, names)
        lines.append("  [] %s -> %s : %s;" % (guard, rate, update))
    lines += ["endmodule", ""]
    for t, name in enumerate(transitions.values()):
        reward = "%s : %s;" % (_guard(net, t, names), _rate(net, t, names))
        lines.append('rewards "throughput_%s" %s endrewards' % (name, reward))
    return ("\n".join(lines) + "\n").encode("utf-8")


def _guard(net: Net, t: int, names: Sequence[str]) -> str:
    tests = ["%s%s%d" % (names[p], operator, n) for p, operator, n in concession(net, t)]
    return " & ".join(tests) or "true"


def _update(net: Net, t: int, names: Sequence[str]) -> str:
    changes = ["(%s'=%s%+d)" % (names[p], names[p], change) for p, change in net.effect(t)]
    return " & ".join(changes) or "true"


def _rate(net: Net, t: int, names: Sequence[str]) -> str:
    transition = net.transitions[t]
    function = net.functions.get(t)
    if function is None:
        rate = repr(float(transition.number))
    else:
        shown = {name: names[net.place_index[name]] for name in function.places}
        rate = str(function.write(shown, _OPERATIONS, "transition '%s'" % transition.name))
    if transition.servers == 1 or not net.inputs[t]:
        return rate
    degrees = [
        names[p] if weight == 1 else "floor(%s/%d)" % (names[p], weight)
        for p, weight in net.inputs[t]
    ]
    if transition.servers is not None:
        degrees.append(str(transition.servers))
    return "%s*%s" % (rate, degrees[0] if len(degrees) == 1 else "min(%s)" % ", ".join(degrees))
