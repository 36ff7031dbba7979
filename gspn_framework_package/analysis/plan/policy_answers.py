"""Evaluates a policy in many markings at once."""

from __future__ import annotations

import math
from typing import Callable, Dict, List, Optional, Tuple

import numpy as np

from gspn_framework_package.analysis.arrays import Indices
from gspn_framework_package.analysis.watch import Watch
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.policy import Choices, Policy


class PolicyAnswers:
    """The answers of a policy, found once for each combination of the counts that it reads.

    :param net: the net of the plan.
    :param policy: the policy.
    :param counts: the counts of a place (its number in ``net``) in some states.
    :param watch: may stop the search for an answer.
    """

    def __init__(
        self,
        net: Net,
        policy: Policy,
        counts: Callable[[int, Indices], Indices],
        watch: Optional[Watch] = None,
    ) -> None:
        self._watch = watch or Watch()
        self._table = policy.bind(net)
        self._columns = [net.place_index[name] for name in policy.places]
        self._marking = list(net.initial_marking)
        self._counts = counts
        self._known: Dict[Tuple[int, Tuple[int, ...]], Optional[Choices]] = {}

    def of(self, place: int, states: Indices) -> Tuple[Indices, List[Choices]]:
        """The number of the answer to a robot in ``place`` in each of ``states``, and the answers:
        what it draws from. The first is that no row matches, so that the policy says nothing."""
        answers: List[Choices] = [()]
        if not self._table.policy.rows:
            return np.zeros(len(states), dtype=np.int64), answers
        rows = np.zeros((len(states), len(self._columns)), dtype=np.int64)
        for i, p in enumerate(self._columns):
            rows[:, i] = self._counts(p, states)
        first, of = distinct_rows(rows)
        numbers: Dict[Optional[Choices], int] = {None: 0}
        known = np.zeros(len(first), dtype=np.int64)
        for k, counts in enumerate(map(tuple, rows[first].tolist())):
            if (place, counts) not in self._known:
                self._watch.step("answers of the policy", len(self._known))
                for p, count in zip(self._columns, counts):
                    self._marking[p] = count
                self._known[place, counts] = self._table.choices(self._marking, place)
            choices = self._known[place, counts]
            if choices is not None and choices not in numbers:
                numbers[choices] = len(answers)
                answers.append(choices)
            known[k] = numbers[choices]
        return known[of], answers


def distinct_rows(rows: Indices) -> Tuple[Indices, Indices]:
    """The index of the first of each distinct row, and for each row the number of its distinct
    row."""
    spans = [int(n) + 1 for n in rows.max(axis=0, initial=0)]
    if math.prod(spans) < 2**62:
        keys = np.zeros(len(rows), dtype=np.int64)
        for column, span in enumerate(spans):
            keys = keys * span + rows[:, column]
        if math.prod(spans) <= max(4 * len(rows), 1 << 16):  # no need to sort
            seen = np.full(math.prod(spans), -1, dtype=np.int64)
            seen[keys[::-1]] = np.arange(len(rows) - 1, -1, -1)
            known = seen >= 0
            return seen[known], (np.cumsum(known) - 1)[keys]
        _, first, of = np.unique(keys, return_index=True, return_inverse=True)
    else:
        _, first, of = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    return first, of.reshape(-1)
