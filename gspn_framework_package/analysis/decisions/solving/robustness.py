"""The best policy for the worst rates, when rates are known only to lie in intervals.

A rate is shared by all markings, which makes the exact problem hard. Two relaxations bound it. For
one bound, an opponent may choose the worst rates separately in each state (Iyengar, *Mathematics of
Operations Research* 30, 2005; Nilim and El Ghaoui, *Operations Research* 53, 2005): the resulting
policy does at least as well if they are shared. Policy and opponent improve in turn; the value of
the policy is that of the opponent's own problem, with its certificate. For the other bound, no
policy does better for the worst rates than the best policy for any particular rates: corners of the
intervals are tried.
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any, Dict, List, Mapping, NamedTuple, Optional, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Booleans, Floats, Indices
from gspn_framework_package.analysis.decisions.aims import AIM_WIDTH, Aim
from gspn_framework_package.analysis.decisions.automaton import CHANCE, Automaton, Rewards
from gspn_framework_package.analysis.decisions.solving.optima import optimum
from gspn_framework_package.analysis.decisions.solving.solved import Solved
from gspn_framework_package.analysis.graph import flat_ranges
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.errors import LimitError, RefusedError, UsageError

_MOST = 8
"""Largest number of uncertain rates of one state, since all its corners are listed."""

_ALL = 3
"""Up to this many uncertain rates, all corners are tried for the other bound."""

_ROUNDS = 30
"""Largest number of rounds of policy and opponent."""


class Robust(NamedTuple):
    """A policy for the worst rates.

    :ivar lower: certified lower bound of the best worst value, or upper one: ``upper``. What is
      maximised is at least ``lower`` with this policy, whatever the rates; what is minimised is at
      most ``upper``.
    :ivar row_of: int array: the row that each state takes.
    :ivar corner: the rates, as factors, at which the other bound was found: by transition.
    :ivar rounds: number of rounds of policy and opponent.
    """

    lower: float
    upper: float
    row_of: Indices
    corner: Dict[int, float]
    rounds: int


def robust(
    automaton: Automaton,
    aim: Aim,
    rewards: Optional[Rewards],
    intervals: Mapping[int, Tuple[float, float]],
    *,
    labels: Optional[Indices] = None,
    goal: Optional[Booleans] = None,
    discount: Optional[float] = None,
    maximise: bool = True,
    width: float = AIM_WIDTH,
    allowed: Optional[Booleans] = None,
    watch: Optional[Watch] = None,
) -> Robust:
    """The best policy for the worst rates. Its interval may be wider than ``width``: it includes
    the gap left by the shared rates.

    :param intervals: transition -> lowest and highest factor of its rate.
    :param labels: int array over the arcs: the transition whose rate each rate is proportional to
      (-1: none); None: the one that fires.
    :param goal: see :func:`~.optima.optimum`, as for the other arguments.
    :raises UsageError: an interval is invalid.
    :raises LimitError: a state has more than eight uncertain rates, or see ``optimum``.
    :raises RefusedError: see ``optimum``.
    """
    for low, high in intervals.values():
        if not 0 < low <= high < np.inf:
            raise UsageError(
                "%g..%g is not an interval of rates" % (low, high), hint="0 < lowest <= highest"
            )
    own = np.where(
        automaton.tangible[automaton.row_states[automaton.arc_rows]],
        automaton.fired if labels is None else labels,
        -1,
    )
    options: Dict[str, Any] = {"goal": goal, "discount": discount, "watch": watch}
    work = _Work(automaton, aim, rewards, intervals, own, maximise, width, allowed, options)
    return work.solve()


class _Work:
    def __init__(
        self,
        automaton: Automaton,
        aim: Aim,
        rewards: Optional[Rewards],
        intervals: Mapping[int, Tuple[float, float]],
        labels: Indices,
        maximise: bool,
        width: float,
        allowed: Optional[Booleans],
        options: Dict[str, Any],
    ) -> None:
        self._automaton, self._aim, self._rewards = automaton, aim, rewards
        self._intervals = {t: i for t, i in intervals.items() if i[0] < i[1]}
        self._labels, self._maximise, self._width = labels, maximise, width
        self._allowed, self._options = allowed, options
        self._fixed = np.ones(len(labels))  # factors that are known
        for t, (low, high) in intervals.items():
            if low == high:
                self._fixed[labels == t] = low
        self._corners = _corners(automaton, labels, self._intervals)

    def solve(self) -> Robust:
        """Policy, bounds and corner."""
        solved = self._best(self._middle())
        sure, row_of, rounds = -np.inf, solved.row_of, 0
        sign = 1.0 if self._maximise else -1.0
        for rounds in range(1, _ROUNDS + 1):
            try:
                value, factors = self._worst(solved.row_of)
            except RefusedError:
                if rounds > 1:
                    break
                raise
            if value <= sure + 1e-3 * self._width * abs(sure) and rounds > 1:
                break
            if value > sure:
                sure, row_of = value, solved.row_of
            solved = self._best(factors, solved.values)
            # the remaining gain against this opponent
            most = solved.upper if self._maximise else -solved.lower
            if most - sure <= 0.5 * self._width * max(abs(most), abs(sure)):
                break
        hope, corner = self._corner()
        other = max(sure, hope)
        low, high = (sure, other) if sign > 0 else (-other, -sure)
        return Robust(low, high, row_of, corner, rounds)

    def _middle(self) -> Floats:
        return self._shared({t: np.sqrt(low * high) for t, (low, high) in self._intervals.items()})

    def _shared(self, corner: Mapping[int, float]) -> Floats:
        factors = self._fixed.copy()
        for t, factor in corner.items():
            factors[self._labels == t] = factor
        return factors

    def _best(self, factors: Floats, start: Optional[Floats] = None) -> Solved:
        return optimum(
            replace(self._automaton, values=self._automaton.values * factors),
            self._aim,
            self._rewards,
            maximise=self._maximise,
            width=0.1 * self._width,
            allowed=self._allowed,
            start_values=start,
            **self._options,
        )

    def _worst(self, row_of: Indices) -> Tuple[float, Floats]:
        """The certified value of a policy (more is better) against the worst rates of each state,
        and these rates as factors of the arcs."""
        game = _opposed(self._automaton, self._corners, self._labels, self._fixed, row_of)
        rewards = self._rewards
        if rewards is not None:
            impulse = np.append(np.asarray(rewards.impulse, dtype=np.float64), 0.0)
            rewards = Rewards(
                np.append(rewards.rate, rewards.rate[game.owners]), impulse[game.arcs]
            )
        options = dict(self._options)
        if options["goal"] is not None:
            options["goal"] = np.append(options["goal"], np.zeros(len(game.owners), dtype=bool))
        solved = optimum(
            game.automaton,
            self._aim,
            rewards,
            maximise=not self._maximise,
            width=0.1 * self._width,
            **options,
        )
        factors = self._fixed.copy()
        taken = solved.row_of[: len(self._automaton)]
        which = taken - game.automaton.rows[: len(taken)]
        sources = self._automaton.row_states[self._automaton.arc_rows]
        for group in self._corners:
            member = np.zeros(len(taken), dtype=bool)
            member[group.states] = taken[group.states] >= 0
            for k, t in enumerate(group.transitions):
                arcs = np.flatnonzero((self._labels == t) & member[sources])
                factors[arcs] = group.factors[which[sources[arcs]], k]
        return (solved.lower if self._maximise else -solved.upper), factors

    def _corner(self) -> Tuple[float, Dict[int, float]]:
        """The lowest of the best values at corners of the intervals (more is better), and the
        corner where it was found."""
        found: Dict[int, float] = {}
        if not self._intervals:
            solved = self._best(self._fixed)
            return (solved.upper if self._maximise else -solved.lower), found
        best: Dict[Tuple[float, ...], float] = {}
        names = sorted(self._intervals)
        start: List[Optional[Floats]] = [None]

        def worth(corner: Tuple[float, ...]) -> float:
            if corner not in best:
                solved = self._best(self._shared(dict(zip(names, corner))), start[0])
                start[0] = solved.values
                best[corner] = solved.upper if self._maximise else -solved.lower
            return best[corner]

        corner = tuple(self._intervals[t][0] for t in names)
        least = worth(corner)
        if len(names) <= _ALL:
            for other in itertools.product(*(self._intervals[t] for t in names)):
                worth(other)
            corner = min(best, key=lambda c: best[c])
            return best[corner], dict(zip(names, corner))
        changed = True
        while changed:  # set one rate after another to its worse end
            changed = False
            for k, t in enumerate(names):
                low, high = self._intervals[t]
                end = high if corner[k] == low else low
                other = corner[:k] + (end,) + corner[k + 1 :]
                if worth(other) < least - 1e-9 * abs(least):
                    corner, least, changed = other, best[other], True
        return least, dict(zip(names, corner))


class _Group(NamedTuple):
    """Tangible states with the same uncertain transitions: their numbers, and the factors of each
    of these transitions in each corner."""

    states: Indices
    transitions: Tuple[int, ...]
    factors: Floats  # corners x transitions


class _Game(NamedTuple):
    """The opponent's problem: tangible states with a choice of rates have become vanishing ones,
    whose rows lead to a tangible state for each corner. ``owners``: the original state of each of
    these; ``arcs``: the automaton's arc of each arc (-1: a new one)."""

    automaton: Automaton
    owners: Indices
    arcs: Indices


def _corners(
    automaton: Automaton, labels: Indices, intervals: Mapping[int, Tuple[float, float]]
) -> List[_Group]:
    names = sorted(intervals)
    if len(names) > 62:
        raise LimitError("%d uncertain rates are too many" % len(names), hint="name fewer")
    sources = automaton.row_states[automaton.arc_rows]
    present = np.zeros(len(automaton), dtype=np.int64)
    for k, t in enumerate(names):
        present[sources[labels == t]] |= 1 << k
    groups = []
    for pattern in np.unique(present[present > 0]).tolist():
        own = tuple(t for k, t in enumerate(names) if pattern >> k & 1)
        if len(own) > _MOST:
            raise LimitError(
                "a state has %d uncertain rates, more than %d" % (len(own), _MOST),
                hint="name fewer",
            )
        grid = np.meshgrid(*[np.array(intervals[t]) for t in own], indexing="ij")
        factors = np.stack([part.reshape(-1) for part in grid], axis=1)
        groups.append(_Group(np.flatnonzero(present == pattern), own, factors))
    return groups


def _opposed(
    automaton: Automaton,
    groups: List[_Group],
    labels: Indices,
    fixed: Floats,
    row_of: Indices,
) -> _Game:
    size = len(automaton)
    counts = np.ones(size, dtype=np.int64)
    group_of = np.full(size, -1, dtype=np.int64)
    for number, group in enumerate(groups):
        counts[group.states] = len(group.factors)
        group_of[group.states] = number
    uncertain = np.flatnonzero(group_of >= 0)
    owners = np.repeat(uncertain, counts[uncertain])
    corner = np.arange(len(owners)) - np.repeat(
        np.cumsum(counts[uncertain]) - counts[uncertain], counts[uncertain]
    )
    offsets = np.concatenate([[0], np.cumsum(np.append(counts, np.ones(len(owners), np.int64)))])
    plain = np.where(row_of >= 0, row_of, automaton.rows[:-1])
    plain[automaton.tangible] = automaton.rows[:-1][automaton.tangible]
    row_source = np.append(np.repeat(np.where(group_of >= 0, -1, plain), counts), plain[owners])
    copied = row_source >= 0
    lengths = np.ones(len(row_source), dtype=np.int64)
    lengths[copied] = np.diff(automaton.arcs)[row_source[copied]]
    arcs = np.concatenate([[0], np.cumsum(lengths)])
    origin = np.full(int(arcs[-1]), -1, dtype=np.int64)
    targets = np.empty(len(origin), dtype=np.int32)
    values = np.ones(len(origin))
    at = flat_ranges(arcs[:-1][copied], arcs[1:][copied])
    taken = row_source[copied]
    origin[at] = flat_ranges(automaton.arcs[taken], automaton.arcs[taken + 1])
    old = origin[at]
    targets[at], values[at] = automaton.targets[old], automaton.values[old] * fixed[old]
    targets[arcs[:-1][~copied]] = size + np.arange(len(owners))
    first = int(arcs[offsets[size]])  # where the arcs of the new states begin
    own = np.repeat(np.arange(len(owners)), lengths[offsets[size] :])
    for number, group in enumerate(groups):
        inside = group_of[owners[own]] == number
        for k, t in enumerate(group.transitions):
            hit = np.flatnonzero(inside & (labels[origin[first:]] == t))
            values[first + hit] = (
                automaton.values[origin[first + hit]] * group.factors[corner[own[hit]], k]
            )
    tangible = np.append(automaton.tangible & (group_of < 0), np.ones(len(owners), dtype=bool))
    game = Automaton(
        tangible,
        offsets,
        arcs,
        targets,
        values,
        np.where(origin >= 0, automaton.fired[origin], -1).astype(np.int32),
        np.full(len(row_source), CHANCE, dtype=np.int32),
        automaton.initial,
    )
    return _Game(game, owners, origin)
