"""What a statement of the meaning offers, and the numbers by which two are compared.

The numbers are exact, and they exist for every plan, whether or not it has a steady state: what a
run spends and does until a moment that comes at a constant rate, for several such rates. (They are
Laplace transforms of the transient answers; equal ones for all rates mean equal answers at all
times.) With a rate near 0 they are the answers of the long run.
"""

from __future__ import annotations

import warnings
from typing import (
    Any,
    Callable,
    Dict,
    FrozenSet,
    Hashable,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Protocol,
    Sequence,
    Tuple,
)

import numpy as np
from scipy.linalg import LinAlgError, LinAlgWarning, expm, solve
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

Marking = Tuple[int, ...]

END_RATES = (0.05, 0.7, 6.0)
"""Rates (1/s) of the moments until which runs are counted."""

MOST_STATES = 1200
"""Plans with more states than this are not compared."""

REACHED = 1e-13
"""A marking with less than this share of the time counts as not reached: rounding errors."""


class TooManyStatesError(Exception):
    """A plan has more than :data:`MOST_STATES` states."""


class EndlessError(Exception):
    """Robots may move for ever in zero time."""


class Steps(Protocol):
    """A statement of the meaning of a plan, as steps between states of its own."""

    @property
    def start(self) -> Hashable:
        """The state in which a run begins."""

    def expand(self, state: Any) -> Tuple[bool, Sequence[Tuple[Hashable, int, float]]]:
        """Whether no time passes in ``state``, and its steps: the state after it, the number of the
        transition that fires (in the plan's net; -1: none does), and a rate (1/s), or a
        probability if no time passes."""

    def marking(self, state: Any) -> Marking:
        """The marking of the plan's net in ``state``; places that only count are 0."""


class Numbers(NamedTuple):
    """What a statement says about a plan. Places and transitions are those of the plan's net.

    :ivar states: the number of states, for reports.
    :ivar spent: rate of the end -> marking -> expected time (s) in it until the end.
    :ivar fired: rate of the end -> transition -> expected number of firings until the end.
    :ivar first: rate of the end -> marking -> the probability that it is ever reached before the
        end, for a few markings.
    :ivar steady: marking -> share of the time in the long run.
    :ivar throughput: transition -> firings per second in the long run.
    """

    states: int
    spent: Mapping[float, Mapping[Marking, float]]
    fired: Mapping[float, Tuple[float, ...]]
    first: Mapping[float, Mapping[Marking, float]]
    steady: Mapping[Marking, float]
    throughput: Tuple[float, ...]

    @property
    def markings(self) -> FrozenSet[Marking]:
        """The markings in which time passes."""
        return frozenset(m for m, time in self.spent[END_RATES[0]].items() if time > REACHED)


class SolvedChain:
    """The chain of some steps, without the states in which no time passes.

    :param steps: the statement.
    :param transitions: the number of transitions of the plan's net.
    :param over: tells in which states a run has ended; None: this does not matter.
    :raises TooManyStatesError: there are more than :data:`MOST_STATES`.
    :raises EndlessError: robots may move for ever in zero time.

    :ivar markings: the marking of each state in which time passes.
    :ivar lasts: boolean array: whether the run continues in the state.
    :ivar rates: matrix of rates (1/s) from state to state.
    :ivar fires: matrix: firings per second of each transition, by state.
    :ivar initial: the probability that a run begins in each state, once no more happens at once.
    :ivar fired_first: expected firings of each transition before that.
    """

    def __init__(
        self, steps: Steps, transitions: int, over: Optional[Callable[[Any], bool]] = None
    ) -> None:
        number: Dict[Hashable, int] = {steps.start: 0}
        order: List[Hashable] = [steps.start]
        instant: List[bool] = []
        arcs: List[Tuple[int, int, int, float]] = []
        while len(instant) < len(order):
            source = len(instant)
            at_once, found = steps.expand(order[source])
            instant.append(at_once)
            for target, label, value in found:
                if target not in number:
                    number[target] = len(order)
                    order.append(target)
                    if len(order) > MOST_STATES:
                        raise TooManyStatesError
                arcs.append((source, number[target], label, value))
        n = len(order)
        self.states = n
        vanishing = np.array(instant)
        step = np.zeros((n, n))
        fires = np.zeros((n, transitions))
        for source, to, label, value in arcs:
            step[source, to] += value
            if label >= 0:
                fires[source, label] += value
        kept = np.flatnonzero(~vanishing)
        gone = np.flatnonzero(vanishing)
        self.markings: List[Marking] = [steps.marking(order[s]) for s in kept.tolist()]
        self.lasts = np.array([over is None or not over(order[s]) for s in kept.tolist()])
        if len(gone):
            # all that happens at once, until time passes again
            through = np.eye(len(gone)) - step[np.ix_(gone, gone)]
            after = np.hstack([step[np.ix_(gone, kept)], fires[gone]])
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", LinAlgWarning)
                    solved = solve(through, after)
            except LinAlgError:
                raise EndlessError from None
            if not np.allclose(solved[:, : len(kept)].sum(axis=1), 1.0, atol=1e-6):
                raise EndlessError
        else:
            solved = np.zeros((0, len(kept) + transitions))
        enters = step[np.ix_(kept, gone)]
        self.rates = step[np.ix_(kept, kept)] + enters @ solved[:, : len(kept)]
        self.fires = fires[kept] + enters @ solved[:, len(kept) :]
        if vanishing[0]:
            self.initial = solved[0, : len(kept)]
            self.fired_first = solved[0, len(kept) :]
        else:
            self.initial = np.zeros(len(kept))
            self.initial[0] = 1.0
            self.fired_first = np.zeros(transitions)

    @property
    def generator(self) -> Any:
        """The generator matrix."""
        found = self.rates.copy()
        np.fill_diagonal(found, 0.0)
        np.fill_diagonal(found, -found.sum(axis=1))
        return found

    def numbers(self) -> Numbers:
        """The numbers of the statement."""
        generator = self.generator
        unit = np.eye(len(self.markings))
        spent, fired, first = {}, {}, {}
        some = _some(self.markings)
        for rate in END_RATES:
            time = solve((rate * unit - generator).T, self.initial)
            spent[rate] = self._by_marking(time)
            fired[rate] = tuple((self.fired_first + time @ self.fires).tolist())
            first[rate] = {m: self._reaches(m, rate, generator) for m in some}
        steady = self._long_run(generator)
        return Numbers(
            self.states,
            spent,
            fired,
            first,
            self._by_marking(steady),
            tuple((steady @ self.fires).tolist()),
        )

    def until(self, time: float) -> Tuple[Any, Any]:
        """Expected token-seconds of each place, and firings of each transition, until a time (s)
        or the end of the run."""
        n = len(self.markings)
        whole = np.zeros((n + 1, n + 1))
        whole[:n, :n] = self.generator.T
        whole[:n, n] = self.initial
        # the integral of the distribution: the answer of y' = A y + initial, y(0) = 0
        seconds = expm(whole * time)[:n, n]
        tokens = (seconds * self.lasts) @ np.array(self.markings)
        return tokens, self.fired_first + seconds @ self.fires

    def _by_marking(self, values: Any) -> Dict[Marking, float]:
        found: Dict[Marking, float] = {}
        for marking, value in zip(self.markings, values.tolist()):
            found[marking] = found.get(marking, 0.0) + value
        return found

    def _reaches(self, marking: Marking, rate: float, generator: Any) -> float:
        """The probability that a run spends time in ``marking`` before an end at ``rate``."""
        goal = np.array([m == marking for m in self.markings])
        system = rate * np.eye(len(goal)) - generator
        system[goal] = np.eye(len(goal))[goal]
        return float(self.initial @ solve(system, goal.astype(float)))

    def _long_run(self, generator: Any) -> Any:
        """The share of the time in each state in the long run."""
        n = len(self.markings)
        count, of = connected_components(csr_matrix(self.rates > 0), connection="strong")
        closed = np.ones(count, dtype=bool)
        source, target = np.nonzero(self.rates)
        closed[of[source[of[source] != of[target]]]] = False
        stays = closed[of]
        ends = np.zeros((n, count))
        ends[stays, of[stays]] = 1.0
        if not stays.all():
            left = np.flatnonzero(~stays)
            ends[left] = solve(
                -generator[np.ix_(left, left)],
                self.rates[np.ix_(left, np.flatnonzero(stays))] @ ends[stays],
            )
        chance = self.initial @ ends
        found = np.zeros(n)
        for c in np.flatnonzero(closed).tolist():
            here = np.flatnonzero(of == c)
            balance = generator[np.ix_(here, here)].T.copy()
            balance[0] = 1.0
            found[here] = chance[c] * solve(balance, np.eye(len(here))[0])
        return found


def numbers_of(steps: Steps, transitions: int) -> Numbers:
    """The numbers of a statement. :raises TooManyStatesError, EndlessError: there are none."""
    return SolvedChain(steps, transitions).numbers()


def _some(markings: Sequence[Marking], count: int = 4) -> List[Marking]:
    """A few of the markings, the same whatever the order."""
    found = sorted(set(markings))
    return found[:: max(1, len(found) // count)]


def differences(one: Numbers, other: Numbers, tolerance: float = 1e-9) -> List[str]:
    """What two statements say differently, for people; empty if they agree."""
    found: List[str] = []
    for what, mine, others in (
        ("markings of the first alone", one.markings, other.markings),
        ("markings of the second alone", other.markings, one.markings),
    ):
        if mine - others:
            found.append("%s: %s" % (what, sorted(mine - others)[:3]))
    if found:
        return found
    for rate in END_RATES:
        text = " until an end at rate %g" % rate
        found += _differ("seconds" + text, one.spent[rate], other.spent[rate], tolerance)
        found += _differ(
            "firings" + text,
            dict(enumerate(one.fired[rate])),
            dict(enumerate(other.fired[rate])),
            tolerance,
        )
        found += _differ("chance to reach" + text, one.first[rate], other.first[rate], tolerance)
    found += _differ("share in the long run", one.steady, other.steady, tolerance)
    found += _differ(
        "throughput",
        dict(enumerate(one.throughput)),
        dict(enumerate(other.throughput)),
        tolerance,
    )
    return found


def _differ(
    what: str, one: Mapping[Any, float], other: Mapping[Any, float], tolerance: float
) -> List[str]:
    worst: Optional[Tuple[float, Any]] = None
    for key in {**one, **other}:
        a, b = one.get(key, 0.0), other.get(key, 0.0)
        gap = abs(a - b) / max(1.0, abs(a), abs(b))
        if gap > tolerance and (worst is None or gap > worst[0]):
            worst = gap, key
    if worst is None:
        return []
    key = worst[1]
    return ["%s of %s: %.12g, %.12g" % (what, key, one.get(key, 0.0), other.get(key, 0.0))]
