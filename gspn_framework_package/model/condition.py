"""Conditions on markings: ``p3 >= 1 and robots_at_base == 2``, ``'p1:Check L1' + p2 > 3``, ``not
deadlock``.

The language extends that of :mod:`~gspn_framework_package.model.expression`: place names stand for
token counts, and there are comparisons (``== != < <= > >=``; ``=`` means ``==``), ``and``, ``or``,
``not`` (also ``&``, ``|``, ``!``), ``true`` and ``false``. A name with characters other than
letters, digits, ``_``, ``.`` and ``:`` is written in quotes. A ``#`` before a place, as in
GreatSPN, is ignored. A condition can only compare token counts, so untrusted text is safe.
"""

from __future__ import annotations

import math
import operator
from typing import (
    Any,
    Callable,
    Collection,
    Dict,
    Iterable,
    List,
    Mapping,
    NamedTuple,
    NoReturn,
    Optional,
    Sequence,
    Tuple,
)

from gspn_framework_package.model.errors import ExpressionError
from gspn_framework_package.model.expression import (
    ARITHMETIC,
    FUNCTIONS,
    Call,
    Name,
    Negation,
    Number,
    Parser,
    operands,
    postorder,
    shorten,
)


class Comparison(NamedTuple):
    """``left operator right``: compares two numbers and yields a truth value."""

    operator: str
    left: Any
    right: Any


class Logical(NamedTuple):
    """``and`` or ``or`` of two truth values."""

    operator: str
    left: Any
    right: Any


class Not(NamedTuple):
    """The negation of a truth value."""

    operand: Any


class Truth(NamedTuple):
    """``true`` or ``false``."""

    value: bool


class Label(NamedTuple):
    """A truth value that the analysis supplies for each marking, such as ``deadlock``."""

    name: str


_COMPARISONS = {
    "=": "==",
    "==": "==",
    "!=": "!=",
    "<>": "!=",
    "<": "<",
    "<=": "<=",
    ">": ">",
    ">=": ">=",
}
_WORDS = {"and": "and", "&": "and", "&&": "and", "or": "or", "|": "or", "||": "or"}
_TRUTH_NODES = (Comparison, Logical, Not, Truth, Label)


class Condition:
    """A condition on the markings of one net, as read by :func:`parse_condition`.

    :ivar text: the condition as written.
    :ivar places: names of the places that the condition refers to.
    :ivar labels: names of the labels that the condition refers to.
    :ivar program: the condition as steps of a stack machine: (operation, argument).

    >>> condition = parse_condition("a >= 1 and a + b == 3", ["a", "b"])
    >>> condition.holds((1, 2)), condition.holds((0, 3))
    (True, False)
    """

    def __init__(self, text: str, tree: Any, place_index: Mapping[str, int]) -> None:
        self.text = text
        self._tree = tree
        self.program = compile_program(tree, place_index)
        self.places: Tuple[str, ...] = tuple(
            name for name, i in place_index.items() if ("place", i) in set(self.program)
        )
        self.labels: Tuple[str, ...] = tuple(
            sorted({str(a) for op, a in self.program if op == "label"})
        )

    def holds(self, marking: Sequence[int], labels: Mapping[str, bool] = {}) -> bool:
        """Whether the condition holds in ``marking`` (counts in the order of the places).

        A comparison that divides by zero is false.

        :param labels: truth values of the labels in this marking, e.g. ``{"deadlock": False}``.
        """
        return bool(run_program(self.program, marking, labels))

    def holds_in_columns(self, columns: Any, rows: int, labels: Mapping[str, Any] = {}) -> Any:
        """In which of many markings the condition holds, as a boolean array.

        :param columns: ``columns[p]`` has the counts of place number ``p`` in each of the ``rows``
            markings; it is read only for the places that the condition names.
        :param labels: label -> boolean array with a value for each marking.
        """
        import numpy

        result = run_in_columns(self.program, columns, labels)
        return numpy.broadcast_to(numpy.asarray(result, dtype=bool), (rows,)).copy()

    def enough(self) -> List[Tuple[str, int]]:
        """Return pairs (place, count): the condition holds wherever the place has that many tokens
        or more.

        Only explicit lower bounds are found: comparisons such as ``place >= number``, and such
        comparisons joined by "or".

        >>> parse_condition("a >= 3 or 2 < b or (a > 1 and b > 1)", ["a", "b"]).enough()
        [('a', 3), ('b', 3)]
        """
        found = []
        waiting = [self._tree]
        while waiting:
            node = waiting.pop()
            if isinstance(node, Logical) and node.operator == "or":
                waiting += [node.right, node.left]
            elif isinstance(node, Comparison):
                left, operator, right = node.left, node.operator, node.right
                if isinstance(left, Number):
                    left, operator, right = right, {"<": ">", "<=": ">="}.get(operator, ""), left
                if isinstance(left, Name) and isinstance(right, Number) and operator in (">", ">="):
                    count = (
                        math.floor(right.value) + 1 if operator == ">" else math.ceil(right.value)
                    )
                    found.append((left.name, max(count, 0)))
        return found

    def __repr__(self) -> str:
        return "<Condition %s>" % shorten(self.text)


def either(first: Optional[str], second: Optional[str]) -> Optional[str]:
    """The disjunction of two conditions; None stands for one that never holds."""
    if first is None or second is None:
        return first if second is None else second
    return "(%s) or (%s)" % (first, second)


def parse_condition(text: str, places: Iterable[str], labels: Collection[str] = ()) -> Condition:
    """Read a condition.

    :param places: names of the places, in the order of the counts in a marking.
    :param labels: names of further truth values of a marking; a place of the same name takes
      precedence.
    :raises ExpressionError: the text cannot be read, or uses an unknown name; the message says
      where.
    """
    index = {name: i for i, name in enumerate(places)}
    parser = ConditionParser(text, index, labels)
    tree = parser.disjunction()
    parser.finish()
    return Condition(text, demand_truth(tree, text), index)


def demand_truth(tree: Any, text: str) -> Any:
    """The tree of a condition. :raises ExpressionError: it is that of a number."""
    if not isinstance(tree, _TRUTH_NODES):
        raise ExpressionError(
            "'%s' is a number, not a condition" % shorten(text),
            hint="compare it with something, e.g. '%s >= 1'" % shorten(text, 30),
        )
    return tree


class ConditionParser(Parser):
    """A parser of conditions.

    ``disjunction = conjunction {or conjunction}``, ``conjunction = opposite {and opposite}``,
    ``opposite = not opposite | comparison``, ``comparison = sum [(== | < | ...) sum]``; any of
    these may be in parentheses."""

    def __init__(self, text: str, places: Mapping[str, int], labels: Collection[str]) -> None:
        super().__init__(text)
        self.places = places
        self._labels = labels

    def disjunction(self) -> Any:
        """Read conjunctions joined by ``or``."""
        left = self.conjunction()
        while self._word() == "or":
            left = self._logical("or", left, self.conjunction)
        return left

    def conjunction(self) -> Any:
        """Read conditions joined by ``and``."""
        left = self.opposite()
        while self._word() == "and":
            left = self._logical("and", left, self.opposite)
        return left

    def opposite(self) -> Any:
        """Read a comparison and any ``not`` before it."""
        if self._is_not():
            self.next += 1
            self.enter()
            at = self.next
            inner = self.opposite()
            self._need_truth(inner, at)
            self.leave()
            return Not(inner)
        return self.comparison()

    def comparison(self) -> Any:
        """Read a comparison, or a sum alone."""
        at = self.next
        left: Any = self.sum()
        written = self.take(*_COMPARISONS)
        if not written:
            return left
        self._need_number(left, at)
        at = self.next
        right: Any = self.sum()
        self._need_number(right, at)
        if self.token.kind == "operator" and self.token.text in _COMPARISONS:
            self.fail("comparisons are joined by 'and', one was not expected")
        return Comparison(_COMPARISONS[written], left, right)

    def sum(self) -> Any:
        """Read a sum; its operands must be numbers."""
        return self._arithmetic(super().sum)

    def product(self) -> Any:
        """Read a product; its operands must be numbers."""
        return self._arithmetic(super().product)

    def atom(self) -> Any:
        """Read a number, a name, a call, or a condition in parentheses."""
        if self.take("#") and self.token.kind != "name":
            self.fail("a place was expected after '#'")
        token = self.token
        if self.take("("):
            inner = self.disjunction()
            self.expect(")")
            return inner
        if token.kind != "name":
            return super().atom()
        if not self.quoted() and token.text not in self.places:
            if token.text in ("true", "false"):
                self.next += 1
                return Truth(token.text == "true")
            if token.text in FUNCTIONS:
                return super().atom()
        if token.text in self.places:
            self.next += 1
            return Name(token.text)
        if token.text in self._labels:
            self.next += 1
            return Label(token.text)
        return self._unknown(token.text)

    def _unknown(self, name: str) -> NoReturn:
        import difflib

        close = difflib.get_close_matches(name, list(self.places), 3, 0.5)
        known = ["'%s'" % p for p in (close or list(self.places)[:8])]
        hint = (
            ("did you mean %s?" % " or ".join(known)) if close else "places: %s" % ", ".join(known)
        )
        raise ExpressionError(
            "there is no place '%s' (character %d in '%s')"
            % (shorten(name), self.token.start + 1, shorten(self.text)),
            hint=hint,
        )

    def _arithmetic(self, rule: Callable[[], Any]) -> Any:
        """Apply a rule of the arithmetic grammar; its operands must be numbers."""
        at = self.next
        result = rule()
        for operand in operands(result):
            self._need_number(operand, at)
        return result

    def _logical(self, word: str, left: Any, rule: Callable[[], Any]) -> Logical:
        self._need_truth(left, self.next)
        self.next += 1
        at = self.next
        right = rule()
        self._need_truth(right, at)
        return Logical(word, left, right)

    def _need_truth(self, node: Any, at: int) -> None:
        if not isinstance(node, _TRUTH_NODES):
            self.next = at
            self.fail("a comparison was expected, not a number,")

    def _need_number(self, node: Any, at: int) -> None:
        if isinstance(node, _TRUTH_NODES):
            self.next = at
            self.fail("a number was expected, not a condition,")

    def quoted(self) -> bool:
        """Whether the next token is a name in quotes."""
        return self.text[self.token.start : self.token.start + 1] in ("'", '"')

    def _word(self) -> str:
        token = self.token
        if token.kind == "operator" or (token.kind == "name" and not self.quoted()):
            return _WORDS.get(token.text if token.text in self.places else token.text.lower(), "")
        return ""

    def _is_not(self) -> bool:
        token = self.token
        if token.kind == "operator":
            return token.text == "!"
        return (
            token.kind == "name"
            and not self.quoted()
            and token.text not in self.places
            and token.text.lower() == "not"
        )


# -- evaluation: a flat program for a stack machine, so that depth does not matter -----------------

ProgramStep = Tuple[str, Any]
Functions = Mapping[str, Callable[..., Any]]


def compile_program(tree: Any, place_index: Mapping[str, Any]) -> Tuple[ProgramStep, ...]:
    """Compile an expression or a condition into steps of a stack machine: (operation, argument).

    :param place_index: name -> the key of its value when the program is run.
    """
    return tuple(_step(node, place_index) for node in postorder(tree, _children))


def _children(node: Any) -> Tuple[Any, ...]:
    if isinstance(node, (Comparison, Logical)):
        return node.left, node.right
    if isinstance(node, Not):
        return (node.operand,)
    return operands(node)


def _step(node: Any, place_index: Mapping[str, Any]) -> ProgramStep:
    if isinstance(node, (Number, Truth)):
        return "value", node.value
    if isinstance(node, Name):
        return "place", place_index[node.name]
    if isinstance(node, Label):
        return "label", node.name
    if isinstance(node, Call):
        return node.function, len(node.arguments)
    if isinstance(node, (Negation, Not)):
        return ("negate" if isinstance(node, Negation) else "not"), 1
    return node.operator, 2


def run_program(
    program: Sequence[ProgramStep],
    counts: Any,
    labels: Mapping[str, Any] = {},
    functions: Optional[Functions] = None,
) -> Any:
    """Run a program and return its result; NaN where arithmetic has none.

    :param counts: place (its key in the program) -> number of tokens.
    :param functions: operation -> what is done with its operands; None: arithmetic with numbers.
    """
    stack: List[Any] = []
    table = _SCALAR if functions is None else functions
    for step, argument in program:
        if step == "value":
            stack.append(argument)
        elif step == "place":
            stack.append(counts[argument])
        elif step == "label":
            stack.append(labels[argument])
        else:
            values = stack[-argument:]
            del stack[-argument:]
            stack.append(table[step](*values))
    return stack[0]


def run_in_columns(
    program: Sequence[ProgramStep], columns: Any, labels: Mapping[str, Any] = {}
) -> Any:
    """Run a program in many markings at once; ``columns`` and ``labels`` have arrays."""
    import numpy

    with numpy.errstate(all="ignore"):
        return run_program(program, columns, labels, vector_functions())


def _or_nan(function: Callable[..., Any]) -> Callable[..., Any]:
    def guarded(*arguments: Any) -> Any:
        try:
            value = function(*arguments)
        except (ValueError, ZeroDivisionError, OverflowError):
            return math.nan
        return math.nan if isinstance(value, complex) else value

    return guarded


def _extreme(function: Callable[..., Any]) -> Callable[..., Any]:
    """Make ``min`` or ``max`` return NaN if any argument is NaN; with Python's own, the result
    depends on the order of the arguments."""
    return lambda *values: math.nan if any(value != value for value in values) else function(values)


def _is_not_equal(a: Any, b: Any) -> bool:
    return bool(a < b or a > b)  # false if either is NaN, like every other comparison


_COMMON: Dict[str, Callable[..., Any]] = {
    **{sign: ARITHMETIC[sign] for sign in "+-*"},
    "==": operator.eq,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "negate": operator.neg,
}
_SCALAR: Dict[str, Callable[..., Any]] = {
    **{name: _or_nan(function) for name, (_, _, function) in FUNCTIONS.items()},
    **_COMMON,
    "min": _extreme(min),
    "max": _extreme(max),
    "/": _or_nan(operator.truediv),
    "^": _or_nan(lambda a, b: float(a) ** b),
    "!=": _is_not_equal,
    "not": operator.not_,
    "and": lambda a, b: a and b,
    "or": lambda a, b: a or b,
}
_VECTOR: Dict[str, Callable[..., Any]] = {}


def vector_functions() -> Functions:
    """The operations of a program on arrays of many markings."""
    if not _VECTOR:
        import functools

        import numpy as np

        def finite(value: Any) -> Any:
            return np.where(np.isfinite(value), value, np.nan)

        _VECTOR.update(_COMMON)
        _VECTOR.update(
            {
                "min": lambda *a: functools.reduce(np.minimum, a),
                "max": lambda *a: functools.reduce(np.maximum, a),
                "floor": np.floor,
                "ceil": np.ceil,
                "round": lambda a: np.floor(np.add(a, 0.5)),
                "abs": np.abs,
                "sqrt": np.sqrt,
                "exp": lambda a: finite(np.exp(a)),
                "log": lambda a: finite(np.log(a)),
                "ln": lambda a: finite(np.log(a)),
                "pow": lambda a, b: finite(np.float_power(a, b)),
                "mod": np.fmod,
                "/": lambda a, b: np.where(np.equal(b, 0), np.nan, np.true_divide(a, b)),
                "^": lambda a, b: finite(np.float_power(a, b)),
                "!=": lambda a, b: np.less(a, b) | np.greater(a, b),
                "not": np.logical_not,
                "and": np.logical_and,
                "or": np.logical_or,
            }
        )
    return _VECTOR
