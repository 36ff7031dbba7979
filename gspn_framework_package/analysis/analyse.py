"""All analyses of one net or plan behind one object; each part is computed on first use.

>>> from gspn_framework_package.model.builder import NetBuilder
>>> net = (NetBuilder("machine").place("up", tokens=1).place("down")
...        .exponential("fail", rate=1.0, inputs="up", outputs="down")
...        .exponential("repair", rate=3.0, inputs="down", outputs="up").build())
>>> analysis = Analysis(net)
>>> len(analysis.space), analysis.properties.live, round(analysis.measures.mean_tokens["down"], 12)
(2, True, 0.25)
>>> round(analysis.first_passage("down == 1").mean_time, 12)
1.0
"""

from __future__ import annotations

import contextlib
import math
import time
from dataclasses import replace
from functools import cached_property
from typing import (
    Any,
    Collection,
    Dict,
    FrozenSet,
    Iterable,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
    Union,
)

import numpy as np

from gspn_framework_package.analysis.chain.markov_chain import Chain
from gspn_framework_package.analysis.limits import Limits, states_of, structure_of
from gspn_framework_package.analysis.plan.reading import NET, RUN, TimingNotes, checked_reading
from gspn_framework_package.analysis.plan.space import PlanSpace, explore_plan
from gspn_framework_package.analysis.solution.few_phases import phases_for
from gspn_framework_package.analysis.solution.measures import Measures
from gspn_framework_package.analysis.solution.passage import Passage, first_passage
from gspn_framework_package.analysis.solution.steady_state import SteadyState, steady_state
from gspn_framework_package.analysis.solution.transient import time_to_steady_state, transient
from gspn_framework_package.analysis.state_space.coverability import CoverabilityTree
from gspn_framework_package.analysis.state_space.properties import Liveness, Properties
from gspn_framework_package.analysis.state_space.rated_graph import RatedGraph
from gspn_framework_package.analysis.state_space.space import StateSpace, WitnessStep, explore
from gspn_framework_package.analysis.structure.invariants import bounds_of
from gspn_framework_package.analysis.structure.net_structure import Structure
from gspn_framework_package.analysis.symbolic.markings import MarkingCounts, count_markings
from gspn_framework_package.analysis.symmetry.lumped_properties import LumpedProperties
from gspn_framework_package.analysis.symmetry.lumped_space import LumpedSpace, explore_lumped
from gspn_framework_package.analysis.symmetry.symmetry import Symmetry
from gspn_framework_package.analysis.watch import Cancel, Progress, Watch
from gspn_framework_package.model.condition import Condition, either, parse_condition
from gspn_framework_package.model.errors import LimitError, RefusedError, UsageError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.plan_timing import PlanTiming

_SEARCHED = 100_000
"""Number of markings to search for a given one in a net with infinitely many."""

BEGINNING = 20_000
"""Markings to visit before checking whether there are infinitely many; most nets have fewer. If
there are, no more are visited, since some questions would stay open anyway."""

_FIRST_TREE = 5_000
"""Largest number of nodes of the first coverability tree, which is tried before visiting more
markings."""

_FIRST_TREE_SHARE = 32
"""The first tree may take the memory limit divided by this."""


class Reachability(NamedTuple):
    """Whether a condition can ever hold: ``reachable`` (None: not decided), the ``number`` of
    visited markings in which it holds, and a shortest path to one of them."""

    reachable: Optional[bool]
    number: int
    witness: Optional[List[WitnessStep]]


class Boundedness(NamedTuple):
    """Whether the net is bounded (None: not decided), and the bound of each place (None: there is
    none)."""

    bounded: Optional[bool]
    bounds: Dict[str, Optional[int]]
    reason: str = ""


def at_least(marking: Mapping[str, int]) -> str:
    """The condition that these places (place -> count) contain at least these tokens."""
    return " and ".join("'%s' >= %d" % item for item in marking.items()) or "true"


class Analysis:
    """The analysis of a net, or of a plan under its policy.

    :param subject: a net or a validated plan.
    :param limit: most markings to visit; shorthand for ``limits`` with this many states.
    :param limits: how far each part may go.
    :param timing: how to interpret the time of a plan: ``run`` (default), as it runs, or ``net``,
        by the rates of its net alone. A net always uses the latter.
    :param structure: whether P-invariants are used for bounds from the start. Otherwise, they are
        computed only if neither the markings nor the coverability tree decide whether the net is
        bounded.
    :param engine: see :func:`~gspn_framework_package.analysis.state_space.space.explore`.
    :param lump: visit only one of the markings that differ by an exchange of equal parts of a net;
        see :mod:`~gspn_framework_package.analysis.symmetry.symmetry`. The value lists the
        conditions that will be queried, which no exchange may change. None: visit all markings.
    :param phases: the most phases of each duration of a plan, or of those in each place; None: as
        few as make a chain, see :func:`~gspn_framework_package.analysis.solution.few_phases`.
    :param progress: called with the progress of long computations.
    :param cancel: called at intervals; returns whether to stop.

    Every part raises LimitError if it was not decided within the limit, and RefusedError if it does
    not exist for the net (for example no Markov chain, because a choice is unresolved).
    """

    def __init__(
        self,
        subject: Union[Net, Plan],
        *,
        limit: Optional[int] = None,
        limits: Limits = Limits(),  # noqa: B008 (immutable)
        timing: Optional[str] = None,
        structure: bool = True,
        engine: str = "auto",
        lump: Optional[Collection[str]] = None,
        phases: Union[None, int, Mapping[str, float]] = None,
        progress: Optional[Progress] = None,
        cancel: Optional[Cancel] = None,
    ) -> None:
        self.plan = subject if isinstance(subject, Plan) else None
        if lump is not None and self.plan is not None:
            raise UsageError(
                "equal parts of a plan cannot be exchanged, since its policy may distinguish them",
                hint="its robots count as equal anyway; or analyse its net alone (--only-net)",
            )
        self.net: Net = subject.net if isinstance(subject, Plan) else subject
        self._reading = checked_reading(timing or (RUN if self.plan is not None else NET))
        if self.plan is None and self._reading != NET:
            raise UsageError("'run' needs a plan: a net has no run")
        nodes = len(self.net.places) + len(self.net.transitions)
        self.limit: int = states_of(nodes)
        for given in (limits.states, limit):
            self.limit = self.limit if given is None else given
        self._steps: int = limits.structure or structure_of(nodes)
        self.limits = limits._replace(states=self.limit, structure=self._steps)
        self._by_structure = structure
        self._engine = engine
        self._lump = None if lump is None else tuple(lump)
        self._phases = phases_for(phases, self.limit)
        self._progress, self._cancel = progress, cancel
        self._counters: Tuple[str, ...] = ()  # the places left out of the state space
        self._known_tree: Optional[CoverabilityTree] = None
        self._counts: Optional[MarkingCounts] = None
        self._growth_reason = ""  # why the first tree does not show which places grow without bound

    # -- structure and state space -----------------------------------------------------------------

    @cached_property
    def structure(self) -> Structure:
        """The structural properties of the net."""
        return Structure(self.net, limit=self._steps, watch=self._watch)

    @cached_property
    def space(self) -> StateSpace:
        """The visited markings, without the places ``left_out``; for a plan, those its policy
        allows. It is incomplete if the limit was reached."""
        return self._explore()

    def counts(self, seconds: Optional[float] = None) -> MarkingCounts:
        """The numbers of the markings of a net, without visiting them and without the places
        ``uncounted``.

        :param seconds: longest time (s); None: that of the limits.
        :raises RefusedError: it is a plan.
        :raises LimitError: they were not counted within the limits, or are infinitely many.
        """
        if self.plan is not None:
            raise RefusedError("the markings of a plan are not counted, only those of its net")
        if self._counts is None:
            if not set(self.growing_places) <= set(self.uncounted):
                raise LimitError(
                    "not decided, since the net is unbounded",
                    hint="%s can grow without bound" % ", ".join(self.growing_places),
                )
            begin = time.monotonic()
            self._counts = self._count(self.uncounted, seconds)
            if self.uncounted and not self.growing_places:  # they may be bounded after all
                took = time.monotonic() - begin
                with contextlib.suppress(LimitError):
                    self._counts = self._count((), min(seconds or math.inf, 1.0 + 4.0 * took))
                    self.uncounted = ()
        return self._counts

    def _count(self, without: Iterable[str], seconds: Optional[float]) -> MarkingCounts:
        net, watch = self.net.without_places(without), self._watch(seconds)
        return count_markings(net, self._invariants, memory=self.limits.memory, watch=watch)

    @cached_property
    def _invariants(self) -> List[Mapping[str, int]]:
        """The weights of the P-invariants, none if there are too many."""
        try:
            return [invariant.weights for invariant in self.structure.place_invariants]
        except LimitError:
            return []

    @cached_property
    def growing_places(self) -> List[str]:
        """The places of a net that a small coverability tree shows to grow without bound."""
        return (None in self._proved_bounds.values() and self._unbounded_places()) or []

    @cached_property
    def uncounted(self) -> Tuple[str, ...]:
        """The places that nothing reads and that may grow without bound, which counting leaves
        out."""
        bounds = self._proved_bounds
        if None not in bounds.values() or self._unbounded_places() == []:
            return ()
        return tuple(
            name for name, bound in bounds.items() if bound is None and self._is_counter(name)
        )

    @property
    def left_out(self) -> Tuple[str, ...]:
        """Places that nothing reads and that may grow without bound. The state space omits them
        since they cannot affect the behaviour."""
        if isinstance(self.space, PlanSpace):
            return self.space.counters
        return self._counters

    @property
    def tree(self) -> CoverabilityTree:
        """The coverability tree.

        :raises LimitError: it is too large, or a growth in it could not be decided.
        """
        if self._known_tree is None:
            self._known_tree = self._tree(self.limits.tree, self.limits.memory)
        return self._known_tree

    @property
    def timing(self) -> TimingNotes:
        """How time is interpreted, and the assumptions made."""
        return self.space.notes if isinstance(self.space, PlanSpace) else TimingNotes(NET, {}, [])

    def _tree(self, limit: int, memory: int) -> CoverabilityTree:
        return CoverabilityTree(
            self.net,
            limit=min(limit, self.limit),
            memory=memory,
            **self.while_working,
        )

    def _watch(self, seconds: Optional[float] = None) -> Watch:
        within = self.limits.seconds if seconds is None else min(seconds, self.limits.seconds)
        return Watch(self._progress, self._cancel, seconds=within)

    @cached_property
    def properties(self) -> Properties:
        """Deadlocks, liveness and related properties.

        :raises LimitError: the state space is not complete.
        """
        self._refuse_if_unbounded("the answers that depend on all markings")
        if isinstance(self.space, LumpedSpace):
            return LumpedProperties(self.space)
        return Properties(self.space)

    @property
    def reversible(self) -> bool:
        """Whether the initial marking can always be reached again. It cannot if an omitted counter
        can gain tokens, since nothing removes them."""
        if any(self._counts_up(place) != self.net.place(place).tokens for place in self.left_out):
            return False
        return self.properties.reversible

    def _explore(self) -> StateSpace:
        if self.plan is not None:
            return self._visit_plan(self.plan, self.limit)
        beginning = self._visit_within(
            self.net,
            min(self.limit, BEGINNING),
            [place.capacity for place in self.net.places],
        )
        if beginning.complete or len(beginning) <= min(self.limit, BEGINNING):
            return beginning  # everything was visited, or time or memory ran out
        bounds = self._invariant_bounds
        counters = [
            name for name, bound in bounds.items() if bound is None and self._is_counter(name)
        ]
        unbounded: Optional[List[str]] = []
        if None in bounds.values():
            unbounded = self._unbounded_places()
        if unbounded is None:  # not decided: visit markings to find out
            fewer = self._visit(self.net.without_places(counters), self.limit) if counters else None
            # if even these are too many, so are the markings with counters
            if fewer is None or fewer.complete:
                space = self._visit(self.net, self.limit) if self.limit > BEGINNING else beginning
                if fewer is None or space.complete:
                    return space
            self._counters = tuple(counters)
            return fewer
        if unbounded and set(unbounded) <= set(counters):
            self._counters = tuple(counters)
            return self._visit(self.net.without_places(counters), self.limit)
        if unbounded or self.limit <= BEGINNING:
            return beginning
        return self._visit(self.net, self.limit)

    def _visit(self, net: Net, limit: int) -> StateSpace:
        bounds = [self._invariant_bounds[place.name] for place in net.places]
        return self._visit_within(net, limit, bounds)

    def _visit_within(self, net: Net, limit: int, bounds: Sequence[Optional[int]]) -> StateSpace:
        within = {"limit": limit, "memory": self.limits.memory, **self.while_working}
        if self._lump is not None:
            return explore_lumped(self._symmetry(net), bounds=bounds, **within)
        return explore(net, engine=self._engine, bounds=bounds, **within)

    def _symmetry(self, net: Net) -> Symmetry:
        """The exchangeable parts of the net, or of the net without some counters. Parts that put
        different numbers of tokens into these counters are distinguished."""
        assert self._lump is not None
        kept = list(net.place_index)
        gone = {p for p, place in enumerate(self.net.places) if place.name not in net.place_index}
        counted = [tuple(arc for arc in row if arc[0] in gone) for row in self.net.outputs]
        asked = [self._parsed(condition) for condition in self._lump]
        # the others name counters that are left out: they are searched for in the net that has them
        here = [
            parse_condition(condition.text, kept, ["deadlock"])
            for condition in asked
            if net.place_index.keys() >= set(condition.places)
        ]
        return Symmetry(net, here, counted if gone else None)

    def _visit_plan(self, plan: Plan, limit: int) -> PlanSpace:
        return explore_plan(
            plan,
            timing=PlanTiming(plan) if self._reading == RUN else None,
            phases=self._phases,
            limit=limit,
            memory=self.limits.memory,
            **self.while_working,
        )

    @cached_property
    def _invariant_bounds(self) -> Dict[str, Optional[int]]:
        if not self._by_structure:
            return {place.name: place.capacity for place in self.net.places}
        return self._proved_bounds

    @cached_property
    def _proved_bounds(self) -> Dict[str, Optional[int]]:
        """The bounds of all places from the P-invariants; None if these do not bound every
        place."""
        number = self.net.place_index
        rows = [[(number[name], w) for name, w in found.items()] for found in self._invariants]
        return dict(zip(number, bounds_of(self.net, rows, self.net.initial_marking)))

    def _unbounded_places(self) -> Optional[List[str]]:
        """The places that grow without bound, from a small coverability tree; None: not decided."""
        if self._growth_reason:
            return None
        try:
            tree = self._tree(
                min(_FIRST_TREE, self.limits.tree), self.limits.memory // _FIRST_TREE_SHARE
            )
        except LimitError as error:
            self._growth_reason = str(error)
            return None
        self._known_tree = tree
        return tree.unbounded_places

    @property
    def _is_unbounded(self) -> bool:
        """Whether the first tree shows infinitely many markings, so that no limit would be high
        enough."""
        if self.plan is not None or self.space.complete or self._known_tree is None:
            return False
        return not self._known_tree.bounded

    def _refuse_if_unbounded(self, question: str) -> None:
        """Refuse an unbounded net. :raises LimitError: the first tree shows that it is."""
        if self._is_unbounded:
            raise LimitError(
                "not decided, since the net is unbounded",
                element=question,
                hint="%s can grow without bound" % ", ".join(self.tree.unbounded_places),
            )

    def _is_counter(self, name: str) -> bool:
        p = self.net.place_number(name)
        return (
            not self.net.consumers[p]
            and self.net.places[p].capacity is None
            and p not in self._read
        )

    @cached_property
    def _read(self) -> FrozenSet[int]:
        """The places on which inhibitor arcs, rates or weights depend."""
        named = map(self.net.place_number, self.net.named_by_functions())
        return frozenset(p for arcs in self.net.inhibitors for p, _ in arcs).union(named)

    @cached_property
    def boundedness(self) -> Boundedness:
        """Whether the net is bounded, and the bounds of its places."""
        space = self.space
        if self.plan is None and self._known_tree is not None:
            return Boundedness(self._known_tree.bounded, self._known_tree.bounds)
        if not space.complete:
            bounds = self._proved_bounds
            if None not in bounds.values():
                return Boundedness(
                    True,
                    bounds,
                    "the bounds are those of the P-invariants, within %s" % space.extent,
                )
            return Boundedness(
                None,
                bounds,
                self._growth_reason or "not decided within %s (%s)" % (space.extent, space.hint),
            )
        bounds = dict(self.properties.bounds)
        grows: List[bool] = []
        for place in self.left_out:
            most = self._counts_up(place)
            bounds[place] = most
            grows.append(most is None)
        ordered = {p.name: bounds[p.name] for p in self.net.places}
        return Boundedness(not any(grows), ordered)

    def _counts_up(self, place: str) -> Optional[int]:
        """Maximum number of tokens in an omitted counter; None if it grows without bound."""
        feeding = {
            self.net.transitions[t].name for t in self.net.producers[self.net.place_number(place)]
        }
        liveness = self.properties.liveness
        if any(liveness[t] >= Liveness.L3 for t in feeding):
            return None
        return self.net.place(place).tokens + self._most_gained(place)

    def _most_gained(self, place: str) -> int:
        """Maximum number of tokens that a firing sequence can add to a counter without a cycle."""
        gain = np.zeros(len(self.net.transitions) + self.space.further_steps, dtype=np.int64)
        p = self.net.place_number(place)
        for t in range(len(self.net.transitions)):
            gain[t] = sum(w for q, w in self.net.outputs[t] if q == p)
        return self.properties.most_gained(gain, self._watch())

    # -- conditions --------------------------------------------------------------------------------

    def reach(self, condition: str) -> Reachability:
        """Whether a condition can ever hold.

        :raises ExpressionError: it cannot be parsed, or names an unknown place.
        """
        if self.plan is None and self._looks_at_counters(condition):
            return self._search(condition)
        space = self.space if self.plan is None else self.until(condition)
        found = np.flatnonzero(space.holds(condition))
        if len(found):
            number = space.count(space.distinct(found))
            return Reachability(True, number, space.witness(int(found[0])))
        return Reachability(False if space.complete else None, 0, None)

    def _search(self, condition: str) -> Reachability:
        """Search a net with infinitely many markings, visiting more and more of them."""
        limit = 1_000
        while True:
            space = self._visit(self.net, min(limit, self.limit))
            found = np.flatnonzero(space.holds(condition))
            if len(found):
                return Reachability(True, space.count(found), space.witness(int(found[0])))
            if space.complete:
                return Reachability(False, 0, None)
            if limit >= min(self.limit, _SEARCHED) or len(space) <= limit:
                return Reachability(None, 0, None)
            limit *= 10

    def cover(self, marking: Mapping[str, int]) -> Reachability:
        """Whether these places can contain at least these numbers of tokens at the same time.

        :param marking: place -> count.
        """
        wanted = self.net.marking(marking)
        condition = at_least(marking)
        if self.plan is not None or (self.space.complete and not self.left_out):
            return self.reach(condition)
        try:
            coverable = self.tree.covers(wanted) is not None
        except LimitError:
            return self.reach(condition)
        if not coverable:
            return Reachability(False, 0, None)
        # The path in the tree does not show how often its loops repeat; search for a real one.
        return self._search(condition)._replace(reachable=True)

    def _looks_at_counters(self, condition: str) -> bool:
        """Whether the condition refers to omitted places."""
        return not set(self.left_out).isdisjoint(self._parsed(condition).places)

    def _parsed(self, condition: str) -> Condition:
        return parse_condition(condition, self.net.place_index, ["deadlock"])

    # -- time --------------------------------------------------------------------------------------

    @cached_property
    def chain(self) -> Chain:
        """The Markov chain.

        :raises RefusedError: a choice is unresolved, or there is a timeless trap.
        """
        self._refuse_if_unbounded("its Markov chain")
        return Chain.of(self.space)

    @cached_property
    def steady(self) -> SteadyState:
        """The steady state."""
        return steady_state(self.chain, **self.while_working)

    @cached_property
    def measures(self) -> Measures:
        """Mean tokens and throughput in the steady state."""
        return Measures(self.chain, self.steady.distribution)

    def at(self, times: Sequence[float]) -> List[Tuple[float, Measures]]:
        """Mean tokens and throughput at given times (s)."""
        return [
            (found.time, Measures(self.chain, found.distribution))
            for found in transient(self.chain, times, **self.while_working)
        ]

    def first_passage(self, condition: str, times: Sequence[float] = ()) -> Passage:
        """The time at which a condition first holds, with the probability that this is within each
        of ``times`` (s).

        :raises ExpressionError: the condition cannot be parsed, or names an unknown place.
        :raises LimitError: there are too many markings before it holds, or a linear system was not
          solved.
        """
        space = self.until(condition)
        return first_passage(self.rated(space), space.holds(condition), times, **self.while_working)

    @property
    def while_working(self) -> Dict[str, Any]:
        """The settings of long computations: ``progress``, ``cancel`` and ``seconds``."""
        return {"progress": self._progress, "cancel": self._cancel, "seconds": self.limits.seconds}

    def until(self, condition: str) -> StateSpace:
        """The markings for a question that ends where a condition holds: those of ``space`` or, if
        it is on counters or there are infinitely many, counters included, up to those in which it
        holds. The condition ends each run, which keeps the exploration finite."""
        if not (self._looks_at_counters(condition) or self._is_unbounded):
            return self.space
        plan = self.plan
        if plan is None:  # a plan without robots follows the rules of its net
            plan = Plan(
                net=self.net,
                resource_places=frozenset(p.name for p in self.net.places),
                until=condition,
            )
        else:
            plan = replace(plan, until=either(plan.until, condition))
        limit = min(self.limit, _SEARCHED) if self._is_unbounded else self.limit
        return self._visit_plan(plan, limit)

    def rated(self, space: StateSpace) -> RatedGraph:
        """The markings of :meth:`until`, with rates and probabilities."""
        if isinstance(space, PlanSpace) and space is not self.space:
            return space.rated()
        return self.chain.graph

    def time_to_steady_state(self, tolerance: float = 1e-3) -> float:
        """The time (s) from which on the distribution stays within ``tolerance`` of the steady
        state."""
        return time_to_steady_state(self.chain, tolerance, steady=self.steady, **self.while_working)
