"""Converts nets and Markov automata to models for Storm. Only the benchmark and the tests use
stormpy, from PyPI."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict, List, Optional

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans
from gspn_framework_package.analysis.decisions.automaton import Automaton, Rewards
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


def storm_automaton(
    automaton: Automaton,
    rewards: Rewards,
    goal: Optional[Booleans],
    folder: str,
    allowed: Optional[Booleans] = None,
) -> Any:
    """A Markov automaton as Storm reads it from a file, which is written into ``folder``. Its
    rewards are called ``earned``, its goal ``goal``. A tangible state without arcs gets an arc to
    itself; several initial states are not possible. Only the ``allowed`` rows are written.

    Storm knows rewards of states (per second) and of choices only: what the arcs of a choice earn
    is averaged over them; in a tangible state it is earned per second.
    """
    import stormpy

    states, rows = len(automaton), len(automaton.choices)
    weights = automaton.values * np.asarray(rewards.impulse, dtype=np.float64)
    earned = np.bincount(automaton.arc_rows, weights=weights, minlength=rows)
    lines: List[str] = ["@type: Markov Automaton", "@parameters", "", "@reward_models", "earned"]
    lines += ["@nr_states", str(states)]
    written = np.ones(rows, dtype=bool) if allowed is None else allowed
    lines += ["@nr_choices", str(int(written.sum())), "@model"]
    for state in range(states):
        first, last = int(automaton.rows[state]), int(automaton.rows[state + 1])
        tangible = bool(automaton.tangible[state])
        labels = [" init"] if state == automaton.initial[0][0] else []
        if goal is not None and goal[state]:
            labels.append(" goal")
        rate = float(automaton.exit_rates[first]) if tangible else 0.0
        per_second = float(rewards.rate[state]) + float(earned[first]) if tangible else 0.0
        lines.append(
            "state %d !%r [%r]%s" % (state, rate or float(tangible), per_second, "".join(labels))
        )
        for number, row in enumerate(np.flatnonzero(written[first:last]) + first):
            lines.append("\taction %d [%r]" % (number, 0.0 if tangible else float(earned[row])))
            arcs = slice(int(automaton.arcs[row]), int(automaton.arcs[row + 1]))
            into: Dict[int, float] = {}
            for target, value in zip(automaton.targets[arcs], automaton.values[arcs]):
                into[int(target)] = into.get(int(target), 0.0) + float(value) / (rate or 1.0)
            for target, value in sorted((into or {state: 1.0}).items()):
                lines.append("\t\t%d : %r" % (target, value))
    path = Path(folder) / "automaton.drn"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return stormpy.build_model_from_drn(str(path))
