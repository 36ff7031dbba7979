"""The state space of a net with exchangeable parts: one marking for each orbit."""

from __future__ import annotations

import math
import time
from typing import Dict, List, Optional, Sequence, Tuple, Union

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Indices, Words
from gspn_framework_package.analysis.limits import STATE_LIMIT
from gspn_framework_package.analysis.state_space import numpy_engine
from gspn_framework_package.analysis.state_space.exploration import (
    Allowance,
    RawGraph,
    in_wide_fields,
)
from gspn_framework_package.analysis.state_space.marking_store import PackedStore
from gspn_framework_package.analysis.state_space.packing import PackedNet, Packing
from gspn_framework_package.analysis.state_space.space import StateSpace, WitnessStep
from gspn_framework_package.analysis.symmetry.symmetry import Symmetry
from gspn_framework_package.analysis.watch import Cancel, Progress, Watch
from gspn_framework_package.model.condition import Condition
from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.model.net import Marking


class LumpedSpace(StateSpace):
    """Reachable markings, one for each orbit; made by :func:`explore_lumped`.

    :ivar symmetry: the symmetry used.
    :ivar sizes: int array: for each state, the number of markings that it represents.
    """

    def __init__(
        self,
        symmetry: Symmetry,
        store: PackedStore,
        graph: RawGraph,
        order: Indices,
        shortage: Tuple[str, str],
    ) -> None:
        super().__init__(
            symmetry.net, store, graph, order, untimed=False, engine="lumped", shortage=shortage
        )
        self.symmetry = self.exchanged = symmetry
        self.sizes: Indices = np.concatenate(
            [
                symmetry.reduce(store.rows(slice(begin, begin + (1 << 15))))
                for begin in range(0, len(store), 1 << 15)
            ]
        )

    def count(self, states: Union[Indices, Booleans, slice]) -> int:
        """See :meth:`StateSpace.count`."""
        return int(self.sizes[states].astype(object).sum())

    @property
    def whole_arcs(self) -> int:
        """See :meth:`StateSpace.whole_arcs`."""
        return int((self.sizes.astype(object) * np.diff(self.offsets)).sum())

    def find(self, marking: Union[Sequence[int], Dict[str, int]]) -> Optional[int]:  # type: ignore[override]
        """See :meth:`StateSpace.find`: the state that represents this marking."""
        counts = self.net.marking(marking) if isinstance(marking, dict) else tuple(marking)
        least = np.array([counts], dtype=np.int64)
        self.symmetry.reduce(least)
        return super().find(least[0].tolist())

    def holds(self, condition: Union[str, Condition]) -> Booleans:
        """See :meth:`StateSpace.holds`.

        :raises RefusedError: an exchange changes it.
        """
        if isinstance(condition, str):
            condition = self.condition(condition)
        if not self.symmetry.keeps(condition):
            raise RefusedError(
                "equal parts were exchanged, but this condition names them: %s" % condition.text,
                hint="name the conditions in advance, or analyse the whole net (without --lump)",
            )
        return super().holds(condition)

    def _firings_to(self, state: int) -> List[Tuple[int, Marking]]:
        """A shortest firing sequence to a state: each transition, and the marking after it.

        The arcs lead from orbit to orbit. Backwards from the last marking, a marking with a
        suitable firing is found in each earlier orbit; the orbit of the initial marking has only
        one.
        """
        net = self.net
        after = self.marking(state)
        found: List[Tuple[int, Marking]] = []
        way = [s for _, s in super()._way_to(state)]
        for before in [0, *way[:-1]][::-1] if way else []:
            wanted = self.marking(before)
            for t in range(len(net.transitions)):
                earlier = list(after)
                for p, change in net.effect(t):
                    earlier[p] -= change
                if min(earlier, default=0) < 0 or t not in net.enabled(earlier):
                    continue
                least = np.array([earlier], dtype=np.int64)
                self.symmetry.reduce(least)
                if tuple(least[0].tolist()) == wanted:
                    found.append((t, after))
                    after = tuple(earlier)
                    break
        return found[::-1]

    def path_to(self, state: int) -> List[str]:
        """See :meth:`StateSpace.path_to`."""
        return [self.transition_name(t) for t, _ in self._firings_to(state)]

    def witness(self, state: int) -> List[WitnessStep]:
        """See :meth:`StateSpace.witness`."""
        return [
            WitnessStep(self.transition_name(t), self.net.named(marking, zeros=False))
            for t, marking in self._firings_to(state)
        ]


def explore_lumped(
    symmetry: Symmetry,
    *,
    limit: int = STATE_LIMIT,
    progress: Optional[Progress] = None,
    cancel: Optional[Cancel] = None,
    bounds: Sequence[Optional[int]],
    memory: float = math.inf,
    seconds: float = math.inf,
) -> LumpedSpace:
    """Find one marking of each reachable orbit. The parameters are those of
    :func:`~gspn_framework_package.analysis.state_space.space.explore`.

    :param symmetry: the exchangeable parts; a net without any is explored as a whole.
    :raises CancelledError: ``cancel`` returned true.
    """
    net = symmetry.net
    watch = Watch(progress, cancel)
    room = Allowance(memory, time.monotonic() + seconds)

    def run(packed: PackedNet) -> LumpedSpace:
        packing = Packing(net, packed.widths)

        def least(states: Words) -> Words:
            markings = packing.unpack(states)
            symmetry.reduce(markings)
            return packing.pack_all(markings)

        graph = numpy_engine.explore(packed, limit, watch, room=room, representative=least)
        assert graph.states is not None  # this engine packs them
        shortage = room.shortage(len(graph.states), limit, seconds)
        return LumpedSpace(
            symmetry, PackedStore(packing, graph.states), graph, packed.order, shortage
        )

    # exchangeable places get fields of the same width
    return in_wide_fields(net, bounds, run, alike=symmetry.place_orbits)
