"""The arrays that nets and plans share."""

from __future__ import annotations

from typing import Any, Iterable, List, Optional, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis.simulation import kernel
from gspn_framework_package.analysis.simulation.machine import ragged
from gspn_framework_package.model.condition import Condition, ProgramStep
from gspn_framework_package.model.net import Net


def marking_tests(net: Net, t: int, zero: int) -> List[List[int]]:
    """The tests of the marking that enable transition ``t``, of four numbers each
    (:func:`~gspn_framework_package.analysis.simulation.kernel.fits`), its inputs first.

    :param zero: the position of a count that is always 0.
    """
    tests = [[p, zero, 1, weight] for p, weight in net.inputs[t]]
    return tests + [[p, zero, -1, -most] for p, most in net.most_tokens(t)]


def places_read(net: Net, t: int) -> List[int]:
    """The places whose counts may change whether transition ``t`` is enabled, or its rate or
    weight."""
    places = [p for p, _, _, _ in marking_tests(net, t, 0)]
    function = net.functions.get(t)
    if function is not None:
        places += [net.place_index[name] for name in function.places]
    return list(dict.fromkeys(places))


def numbers_of(net: Net, transitions: Iterable[int]) -> Any:
    """The rates or weights of some transitions; 1 in place of those that depend on the marking."""
    return np.array(
        [1.0 if t in net.functions else net.transitions[t].number for t in transitions],
        dtype=np.float64,
    )


def marking_functions(net: Net, racing: Sequence[int]) -> kernel.MarkingFunctions:
    """The rates and weights of a net that depend on the marking.

    :param racing: the transitions that race, in the order of their rates.
    """
    race_of = {t: i for i, t in enumerate(racing)}
    known = [t for t in net.functions if t in race_of or not net.transitions[t].timed]
    programs = [net.functions[t].program(net.place_index) for t in known]
    read: List[List[int]] = [[] for _ in net.places]
    for k, t in enumerate(known):
        for name in net.functions[t].places:
            read[net.place_index[name]].append(k)
    operations, arguments = _steps([step for program in programs for step in program])
    return kernel.MarkingFunctions(
        np.array(known, dtype=np.int64),
        np.array([race_of.get(t, -1) for t in known], dtype=np.int64),
        *ragged(read),
        np.cumsum([0, *map(len, programs)]).astype(np.int64),
        operations,
        arguments,
        np.zeros(max(map(len, programs), default=0)),
    )


def flattened(parts: Sequence[Sequence[Sequence[int]]]) -> List[List[int]]:
    """Tests, or pairs, of each part as one list of numbers."""
    return [[number for each in part for number in each] for part in parts]


def compile_condition(condition: Optional[Condition]) -> Tuple[Any, Any]:
    """A condition as operations and arguments of the kernel; empty for None."""
    return _steps(() if condition is None else condition.program)


def _steps(program: Iterable[ProgramStep]) -> Tuple[Any, Any]:
    codes = {name: i for i, name in enumerate(kernel.OPERATIONS)}
    operations = [codes[step] for step, _ in program]
    arguments = [
        float(argument) if isinstance(argument, (int, float)) else 0.0 for _, argument in program
    ]
    return np.array(operations, dtype=np.int64), np.array(arguments, dtype=np.float64)
