"""Reachability of conditions, from the markings on disk."""

from __future__ import annotations

from typing import List, Mapping, Optional, Tuple

import numpy as np

from gspn_framework_package.analysis.analyse import Reachability, at_least
from gspn_framework_package.analysis.on_disk.keys import Keys
from gspn_framework_package.analysis.on_disk.search import OnDiskSpace
from gspn_framework_package.analysis.state_space.marking_store import Columns, PackedStore
from gspn_framework_package.analysis.state_space.numpy_engine import enabled
from gspn_framework_package.analysis.state_space.space import WitnessStep
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.condition import parse_condition


def reach(space: OnDiskSpace, text: str, watch: Watch) -> Reachability:
    """Whether the condition ``text`` can ever hold, and a shortest path to it.

    :raises ExpressionError: it cannot be parsed, or names an unknown place.
    """
    net = space.net
    condition = parse_condition(text, net.place_index, ["deadlock"])
    number, seen = 0, 0
    first: Optional[Tuple[int, Keys]] = None
    for layer, keys in space.parts():
        watch.step("states examined", seen)
        seen += len(keys)
        words = space.code.decode(keys)
        labels = {}
        if condition.labels:
            labels["deadlock"] = np.ones(len(keys), dtype=bool)
            labels["deadlock"][enabled(space.packed, words)[0]] = False
        columns = Columns(PackedStore(space.packed, words))
        found = np.flatnonzero(condition.holds_in_columns(columns, len(keys), labels))
        number += len(found)
        if len(found) and first is None:
            first = layer, keys[found[:1]].copy()
    return Reachability(first is not None, number, first and _witness(space, *first))


def cover(space: OnDiskSpace, marking: Mapping[str, int], watch: Watch) -> Reachability:
    """Whether these places (place -> count) can contain at least these tokens at the same time.

    :raises GspnError: there is no such place.
    """
    space.net.marking(marking)
    return reach(space, at_least(marking), watch)


def _witness(space: OnDiskSpace, layer: int, key: Keys) -> List[WitnessStep]:
    marking, steps = tuple(space.net.initial_marking), []
    for name in space.way_to(layer, key):
        marking = space.net.fire(marking, space.net.transition_number(name))
        steps.append(WitnessStep(name, space.net.named(marking, zeros=False)))
    return steps
