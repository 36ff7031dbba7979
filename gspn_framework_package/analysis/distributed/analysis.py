"""What the ranks find out about a net: its states, the bounds of its places, its deadlocks, its
steady state."""

from __future__ import annotations

import functools
import resource
from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Floats
from gspn_framework_package.analysis.distributed.exploration import RankStates, explore
from gspn_framework_package.analysis.distributed.ranks import Ranks
from gspn_framework_package.analysis.distributed.rates import RankChain
from gspn_framework_package.analysis.distributed.steady import (
    measured,
    steady_share,
    token_distribution,
)
from gspn_framework_package.analysis.limits import Limits, states_of
from gspn_framework_package.analysis.solution.linear import DIRECT_SIZE
from gspn_framework_package.analysis.state_space.space import INVARIANT_EFFORT
from gspn_framework_package.analysis.structure.invariants import invariant_bounds
from gspn_framework_package.analysis.watch import Cancel, Progress, Watch
from gspn_framework_package.model.net import Net


class DistributedAnalysis:
    """The analysis of a net by several ranks. Each of them makes one, and asks it the same, in the
    same order.

    :param net: the net, the same on every rank. It should be bounded (see :func:`~.growth.growth`).
    :param bounds: for each place, the most tokens it can hold (None: unknown), the same on every
        rank; None: rank 0 finds them out.
    :param limits: the states count on all ranks together, the memory on each.
    :param progress: called with the progress of long work.
    :param cancel: called at intervals; returns whether to stop.
    :raises LimitError: see :func:`~.exploration.explore`.
    :raises RefusedError: see there.
    """

    def __init__(
        self,
        net: Net,
        ranks: Ranks,
        *,
        bounds: Optional[Sequence[Optional[int]]] = None,
        limits: Limits = Limits(),  # noqa: B008 (immutable)
        progress: Optional[Progress] = None,
        cancel: Optional[Cancel] = None,
    ) -> None:
        self.net, self.ranks, self.limits = net, ranks, limits
        watch = functools.partial(Watch, progress, cancel, seconds=limits.seconds)
        self._watch = watch
        if bounds is None:
            bounds = ranks.agreed(
                lambda: invariant_bounds(net, INVARIANT_EFFORT, watch()) if ranks.rank == 0 else []
            )[0]
        self.states: RankStates = explore(
            net,
            ranks,
            bounds=bounds,
            limit=limits.states or states_of(len(net.places) + len(net.transitions)),
            watch=watch,
            memory=limits.memory,
            seconds=limits.seconds,
        )

    def counts(self) -> Dict[str, int]:
        """How many states and arcs there are, on all ranks."""
        mine = [len(self.states), int(self.states.vanishing.sum()), self.states.arcs]
        total, vanishing, arcs = self.ranks.total(np.array(mine)).tolist()
        return {
            "total": total,
            "tangible": total - vanishing,
            "vanishing": vanishing,
            "arcs": arcs,
        }

    def bounds(self) -> Dict[str, int]:
        """Place -> the most tokens that it ever holds."""
        store = self.states.store
        found = self.ranks.gather(store.largest() if len(store) else [0] * len(self.net.places))
        return {place.name: max(column) for place, column in zip(self.net.places, zip(*found))}

    def deadlocks(self) -> Dict[str, Any]:
        """The ``count`` of states in which nothing can fire, and the ``marking`` of one."""
        dead = np.flatnonzero(self.states.dead)
        marking = None
        if len(dead):
            first = self.states.store.rows(dead[:1])[0].tolist()
            marking = self.net.named(tuple(first), zeros=False)
        found = self.ranks.gather((len(dead), marking))
        markings = [told for _, told in found if told is not None]
        return {"count": sum(n for n, _ in found), "marking": markings[0] if markings else None}

    def steady_state(self, direct: int = DIRECT_SIZE) -> Dict[str, Any]:
        """The steady state, with the keys that it has in the report of an analysis by one process.

        :param direct: up to this many states, every rank solves the whole chain.
        :raises RefusedError: nothing resolves a choice, there is a timeless trap, or the chain may
            end in one of several recurrent classes.
        :raises LimitError: the linear system was not solved.
        """
        chain = RankChain(self.states, self._watch())
        share = steady_share(chain, self._watch(), direct)
        means, rates = measured(chain, share.values)
        return share.answers(
            self.net,
            means,
            rates,
            token_distribution(chain, share.values),
            self._likeliest(chain, share.values),
        )

    def _likeliest(self, chain: RankChain, values: Floats) -> Dict[str, int]:
        """The most probable marking."""
        mine: Tuple[float, Dict[str, int]] = (-1.0, {})
        if len(values):
            best = int(values.argmax())
            marking = self.states.store.rows(chain.tangible[best : best + 1])[0].tolist()
            mine = (float(values[best]), self.net.named(tuple(marking), zeros=False))
        return max(self.ranks.gather(mine), key=lambda told: told[0])[1]

    def shares(self) -> List[Dict[str, int]]:
        """What each rank holds: its number, its ``states``, the ``memory_bytes`` of its states, and
        the most memory that the process has had (``peak_bytes``)."""
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
        return self.ranks.gather(
            {
                "rank": self.ranks.rank,
                "states": len(self.states),
                "memory_bytes": self.states.memory,
                "peak_bytes": peak,
            }
        )
