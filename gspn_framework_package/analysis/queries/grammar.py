"""The language of temporal queries: CSL and CTL, as in PRISM's properties.

==========================================  ========================================================
``P=? [ path ]``, ``P>=0.9 [ path ]``       the probability of a path; whether it is at least 0.9
``S=? [ state ]``, ``S<0.1 [ state ]``      the long-run share of time; whether it is below 0.1
``E [ path ]``, ``A [ path ]``              whether some path, or every path, is such
``EF s`` = ``E<> s``, ``AG s`` = ``A[] s``  short for ``E [ F s ]`` and ``A [ G s ]``
``EG s`` = ``E[] s``, ``AF s`` = ``A<> s``  short for ``E [ G s ]`` and ``A [ F s ]``
==========================================  ========================================================

A path is ``F s`` (s holds at some time), ``G s`` (always) or ``s U t`` (t holds at some time, and s
until then); in P also with a time bound in seconds, ``F<=10 s``. States are described by conditions
(:mod:`~gspn_framework_package.model.condition`), in which ``E`` and ``A`` may occur, too. A
temporal operator reaches as far to the right as it can: ``EF a and b`` is ``EF (a and b)``. A place
that is called like an operator is written in quotes, where it could be one.
"""

from __future__ import annotations

from typing import Any, Dict, Mapping, NamedTuple, NoReturn, Optional, Sequence, Tuple, Union

from gspn_framework_package.model.condition import Condition, ConditionParser, Label, demand_truth
from gspn_framework_package.model.errors import ExpressionError

_SHORT = {"EF": (False, "F"), "EG": (False, "G"), "AF": (True, "F"), "AG": (True, "G")}

_SUPPORTED = "supported: P, S, E, A with F, G, U; EF, EG, AF, AG; E<>, A[]"

_UNSUPPORTED = {
    "X": "next",
    "EX": "next",
    "AX": "next",
    "W": "weak until",
    "R": "release, or rewards",
    "Pmin": "optimum, see gspn optimise",
    "Pmax": "optimum, see gspn optimise",
    "Smin": "optimum, see gspn optimise",
    "Smax": "optimum, see gspn optimise",
    "Rmin": "rewards, see gspn optimise",
    "Rmax": "rewards, see gspn optimise",
    "T": "mean time, see --mean-time-to",
    "LRA": "long-run average, written S",
    "filter": "filter",
    "multi": "several aims",
}


class StateFormula(NamedTuple):
    """A condition on a marking, in which temporal formulas may occur.

    :ivar text: as written.
    :ivar tree: its tree, with a label for each temporal formula.
    :ivar parts: label -> temporal formula.
    """

    text: str
    tree: Any
    parts: Mapping[str, Branching]

    def on(self, places: Mapping[str, int]) -> Condition:
        """The condition, with the numbers of these places."""
        return Condition(self.text, self.tree, places)


class PathFormula(NamedTuple):
    """A property of a path: ``F goal``, ``G goal`` or ``stay U goal``, ``within`` a time (s) or
    at any time (None)."""

    operator: str
    goal: StateFormula
    stay: Optional[StateFormula] = None
    within: Optional[float] = None

    @property
    def formulas(self) -> Tuple[StateFormula, ...]:
        """The formulas about states in it."""
        return (self.goal,) if self.stay is None else (self.stay, self.goal)

    @property
    def over(self) -> str:
        """The condition that decides, where it first holds, whether a path has the property."""
        if self.operator == "G":
            return "not (%s)" % self.goal.text
        if self.stay is None:
            return self.goal.text
        return "(%s) or not (%s)" % (self.goal.text, self.stay.text)


class Branching(NamedTuple):
    """Whether ``every`` path, or else some path, has the property."""

    every: bool
    path: PathFormula


class Quantity(NamedTuple):
    """The probability of a path (``P``) or the long-run share of time in states (``S``), and the
    bound that it is compared with, such as (``>=``, 0.9)."""

    asked: Union[PathFormula, StateFormula]
    bound: Optional[Tuple[str, float]]


Query = Union[Quantity, StateFormula]


def parse_query(text: str, places: Sequence[str]) -> Query:
    """Read a query.

    :param places: names of the places.
    :raises ExpressionError: it cannot be read, an operator is not supported, or a place is unknown;
        the message says where.

    >>> query = parse_query("P=? [ F<=10 done >= 2 ]", ["done"])
    >>> query.asked.operator, query.asked.within, query.asked.goal.text
    ('F', 10.0, 'done >= 2')
    >>> parse_query("P=? [ X done >= 2 ]", ["done"])
    Traceback (most recent call last):
    ...
    gspn_framework_package.model.errors.ExpressionError: the operator X (next) is not supported \
before 'X' (character 7) in 'P=? [ X done >= 2 ]' (supported: P, S, E, A with F, G, U; EF, EG, AF, \
AG; E<>, A[])
    """
    parser = _QueryParser(text, {name: p for p, name in enumerate(places)})
    query = parser.query()
    parser.finish()
    return query


class _QueryParser(ConditionParser):
    def __init__(self, text: str, places: Mapping[str, int]) -> None:
        super().__init__(text, places, ["deadlock"])
        self._parts: Dict[str, Branching] = {}

    # -- queries and paths

    def query(self) -> Query:
        if not self._is_quantity():
            return self._state()
        kind = self.token.text
        self.next += 1
        bound = self._bound()
        self.expect("[")
        asked = self._path() if kind == "P" else self._state()
        self.expect("]")
        return Quantity(asked, bound)

    def _is_quantity(self) -> bool:
        """Whether P or S begins here: a bracket follows what it is compared with."""
        if self._word_here() not in ("P", "S"):
            return False
        after = self.tokens[self.next + 1 : self.next + 4]
        return len(after) == 3 and (after[1].text == "?" or after[2].text == "[")

    def _bound(self) -> Optional[Tuple[str, float]]:
        if self.take("="):
            self.expect("?")
            return None
        operator = self.take("<", "<=", ">", ">=")
        if operator is None:
            self.fail("=?, <, <=, > or >= was expected")
        value = self._number()
        if value > 1:
            self.next -= 1
            self.fail("a number from 0 to 1 was expected")
        return operator, value

    def _number(self) -> float:
        if self.token.kind != "number":
            self.fail("a number was expected")
        self.next += 1
        return float(self.tokens[self.next - 1].text)

    def _path(self) -> PathFormula:
        operator = self._word_here()
        if operator in ("F", "G"):
            self.next += 1
            return PathFormula(operator, within=self._within(), goal=self._state())
        if operator in _UNSUPPORTED:
            self._refuse(operator)
        stay = self._state()
        operator = self._word_here()
        if operator != "U":
            if operator in _UNSUPPORTED:
                self._refuse(operator)
            self.fail("F, G or U was expected")
        self.next += 1
        return PathFormula("U", stay=stay, within=self._within(), goal=self._state())

    def _within(self) -> Optional[float]:
        for other in ("<", ">", ">=", "=", "["):
            if self.token.kind == "operator" and self.token.text == other:
                self.fail("only an upper bound on the time, <=, is supported, not '%s'," % other)
        return self._number() if self.take("<=") else None

    # -- states

    def _state(self) -> StateFormula:
        start = self.token.start
        outer, self._parts = self._parts, {}
        tree = self.disjunction()
        text = self.text[start : self.token.start].strip()
        found = StateFormula(text, demand_truth(tree, text), self._parts)
        self._parts = outer
        return found

    def atom(self) -> Any:
        """Read an operand of a condition, or a formula with E or A."""
        word = self._word_here()
        if self._is_quantity():
            self.fail("%s is answered only as the whole query, not inside of another," % word)
        if word in _SHORT and not self._is_place():
            self.next += 1
            every, operator = _SHORT[word]
            return self._branching(every, operator)
        if word in ("E", "A"):
            following = self.tokens[self.next + 1 : self.next + 3]
            brackets = "".join(token.text for token in following)
            if brackets.startswith("["):
                self.next += 1 + 2 * (brackets == "[]")
                return self._branching(word == "A", "G" if brackets == "[]" else "")
            if brackets.startswith("<>") and word not in self.places:
                self.next += 2
                return self._branching(word == "A", "F")
        if word not in self.places:
            if word in _UNSUPPORTED:
                self._refuse(word)
            if word in ("E", "A", "F", "G", "U", "P", "S"):
                self.fail("%s is not possible here, or lacks its brackets," % word)
        return super().atom()

    def _branching(self, every: bool, operator: str) -> Label:
        """Read the path after E or A: what ``operator`` applies to, or, without one, brackets."""
        self.enter()
        if operator:
            path = PathFormula(operator, self._state())
        else:
            self.expect("[")
            at = self.next
            path = self._path()
            if path.within is not None:
                self.next = at
                self.fail("a time bound is possible only in P, not in the path")
            self.expect("]")
        self.leave()
        label = "temporal formula %d" % self.token.start
        self._parts[label] = Branching(every, path)
        return Label(label)

    def _word_here(self) -> str:
        """The next token, if it is a name without quotes; else ""."""
        token = self.token
        return token.text if token.kind == "name" and not self.quoted() else ""

    def _is_place(self) -> bool:
        """Whether the next token is a place, rather than an operator, since no operand follows."""
        following = self.tokens[self.next + 1]
        return self.token.text in self.places and not (
            following.kind in ("name", "number") or following.text in ("(", "!", "#")
        )

    def _refuse(self, word: str) -> NoReturn:
        try:
            self.fail("the operator %s (%s) is not supported" % (word, _UNSUPPORTED[word]))
        except ExpressionError as error:
            error.hint = _SUPPORTED
            raise
