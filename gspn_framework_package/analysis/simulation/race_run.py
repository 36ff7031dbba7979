"""Runs of a net: its enabled exponential transitions race."""

from __future__ import annotations

from typing import List, Optional, Tuple

import numpy as np

from gspn_framework_package.analysis.simulation import kernel
from gspn_framework_package.analysis.simulation.kernel_run import (
    KernelRun,
    first_clocks,
    first_counts,
    real,
    sum_tree,
    whole_numbers,
)
from gspn_framework_package.analysis.simulation.machine import ragged
from gspn_framework_package.analysis.simulation.net_arrays import (
    compile_condition,
    flattened,
    marking_functions,
    marking_tests,
    numbers_of,
    places_read,
)
from gspn_framework_package.model.condition import Condition
from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.model.net import Net


class RaceRun(KernelRun):
    """Runs of one net.

    :param until: the condition that ends a run, which may contain ``deadlock``; or None.
    """

    def __init__(self, net: Net, until: Optional[Condition] = None) -> None:
        arrays = _arrays(net, until)
        super().__init__(net, (arrays,), _new_state(net, arrays))

    def step(self, stop: float, budget: int) -> int:
        """Let the transitions race; see :meth:`KernelRun.step`."""
        return int(self.functions["race"](*self.arguments, stop, budget))

    def _values(self) -> Tuple[kernel.MarkingFunctions, kernel.NetArrays, kernel.Rates]:
        arrays = self.arrays[0]
        return arrays.functions, arrays.net, arrays.rates

    def after(self, status: int) -> int:
        """Refuse a choice without weights; see :meth:`KernelRun.after`.

        :raises RefusedError: always.
        """
        if status == kernel.UNDECIDED:
            names = [self.net.transitions[t].name for t in self.net.enabled(self.marking)]
            raise RefusedError(
                "no weights decide between %s" % ", ".join(names),
                hint="give them weights, or use a plan with a policy",
            )
        return status


def _arrays(net: Net, until: Optional[Condition]) -> kernel.RaceArrays:
    places = len(net.places)
    zero = places
    numbers = range(len(net.transitions))
    tests = [marking_tests(net, t, zero) for t in numbers]
    touched: List[List[int]] = [[] for _ in net.places]
    for t in numbers:
        for p in places_read(net, t):
            touched[p].append(t)
    test_from, flat_tests = ragged(flattened(tests))
    effect_from, effects = ragged(flattened([net.effect(t) for t in numbers]))
    touched_from, flat_touched = ragged(touched)
    operations, arguments = compile_condition(until)
    reads = whole_numbers(places)
    if until is not None:
        reads[[net.place_index[name] for name in until.places]] = 1
    transitions = net.transitions
    return kernel.RaceArrays(
        sizes=np.array([places, int(until is not None and bool(until.labels))], dtype=np.int64),
        net=kernel.NetArrays(
            test_from=test_from,
            tests=flat_tests,
            immediate=np.array([int(not t.timed) for t in transitions], dtype=np.int64),
            priority=np.array([t.priority for t in transitions], dtype=np.int64),
            weight=numbers_of(net, numbers),
        ),
        effect_from=effect_from,
        effects=effects,
        touched_from=touched_from,
        touched=flat_touched,
        rates=kernel.Rates(
            transition=np.arange(len(transitions)),
            rate=numbers_of(net, numbers),
            servers=np.array([t.servers or 0 for t in transitions], dtype=np.int64),
        ),
        functions=marking_functions(net, numbers),
        until_reads=reads,
        until=kernel.Until(operations, arguments),
    )


def _new_state(net: Net, arrays: kernel.RaceArrays) -> kernel.RaceState:
    marking = net.initial_marking
    transitions = len(net.transitions)
    immediate = [t for t, transition in enumerate(net.transitions) if not transition.timed]
    enabled = [t for t in immediate if net.is_enabled(marking, t)]
    ready, ready_at = whole_numbers(max(transitions, 1)), whole_numbers(max(transitions, 1), -1)
    ready[: len(enabled)] = enabled
    ready_at[enabled] = np.arange(len(enabled))
    numbers = whole_numbers(kernel.NUMBERS)
    numbers[kernel.CHECK_UNTIL] = 1
    numbers[kernel.READY] = len(enabled)
    return kernel.RaceState(
        numbers=numbers,
        clocks=first_clocks(),
        random=whole_numbers(4),
        counts=first_counts(marking, 1),
        firings=whole_numbers(transitions),
        ready_ones=kernel.Ready(ready, ready_at),
        tree=sum_tree(
            [
                net.effective_rate(marking, t) if transition.timed else 0.0
                for t, transition in enumerate(net.transitions)
            ]
        ),
        stack=real(len(arrays.until.operations) + 1),
    )
