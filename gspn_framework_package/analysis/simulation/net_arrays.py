"""What the arrays of a net and of a plan have in common."""

from __future__ import annotations

from typing import Any, List, Optional, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis.simulation import kernel
from gspn_framework_package.model.condition import Condition
from gspn_framework_package.model.net import Net


def marking_tests(net: Net, t: int, zero: int) -> List[List[int]]:
    """The tests of the marking that enable transition ``t``, of four numbers each
    (:func:`~gspn_framework_package.analysis.simulation.kernel.fits`), its inputs first.

    :param zero: the position of a count that is always 0.
    """
    tests = [[p, zero, 1, weight] for p, weight in net.inputs[t]]
    tests += [[p, zero, -1, 1 - weight] for p, weight in net.inhibitors[t]]
    for p, change in net.effect(t):
        capacity = net.places[p].capacity
        if change > 0 and capacity is not None:
            tests.append([p, zero, -1, change - capacity])
    return tests


def flattened(parts: Sequence[Sequence[Sequence[int]]]) -> List[List[int]]:
    """Tests, or pairs, of each part as one list of numbers."""
    return [[number for each in part for number in each] for part in parts]


def compile_condition(condition: Optional[Condition]) -> Tuple[Any, Any]:
    """A condition as operations and arguments of the kernel; empty for None."""
    program = () if condition is None else condition.program
    codes = {name: i for i, name in enumerate(kernel.OPERATIONS)}
    operations = [codes[step] for step, _ in program]
    arguments = [
        float(argument) if isinstance(argument, (int, float)) else 0.0 for _, argument in program
    ]
    return np.array(operations, dtype=np.int64), np.array(arguments, dtype=np.float64)
