"""Converts nets to models for Storm."""

from __future__ import annotations

from typing import Any

from gspn_framework_package.model.net import Net


def storm_jani(net: Net, *, clock: bool = False) -> Any:
    """The net as a JANI model, made by Storm's own translation of GSPNs.

    :param clock: whether to add an independent clock that never stops ticking. Storm lets no time
        pass in a deadlock, and computes 0 for the long run of a single state; the clock prevents
        both.
    """
    from stormpy import gspn

    builder = gspn.GspnBuilder()
    builder.set_gspn_name("net")
    for place in net.places:
        builder.add_place(None, place.tokens, place.name)
    for t, transition in enumerate(net.transitions):
        if transition.timed:
            builder.add_timed_transition(0, transition.rate, transition.servers, transition.name)
        else:
            builder.add_immediate_transition(
                transition.priority, transition.weight, transition.name
            )
        for p, weight in net.inputs[t]:
            builder.add_input_arc(net.places[p].name, transition.name, weight)
        for p, weight in net.outputs[t]:
            builder.add_output_arc(transition.name, net.places[p].name, weight)
        for p, weight in net.inhibitors[t]:
            builder.add_inhibition_arc(net.places[p].name, transition.name, weight)
        for p, change in net.effect(t):
            capacity = net.places[p].capacity
            if capacity is not None and change > 0:  # Storm does not enforce capacities itself
                builder.add_inhibition_arc(
                    net.places[p].name, transition.name, capacity - change + 1
                )
    if clock:
        for name, tokens in (("tick", 1), ("tock", 0)):
            builder.add_place(None, tokens, name)
        for name, before, after in (("to_tock", "tick", "tock"), ("to_tick", "tock", "tick")):
            builder.add_timed_transition(0, 1.0, 1, name)
            builder.add_input_arc(before, name, 1)
            builder.add_output_arc(name, after, 1)
    jani, _ = gspn.build_jani_model(builder.build_gspn())
    return jani
