"""Arithmetic over named constants, as it occurs in net files: ``2*N + 1``, ``lambda / min(k, 3)``,
``1.5e-3``.

:func:`tokenize` splits the text into tokens, :func:`parse` builds a tree from them, and
:func:`evaluate` computes its value. Python's ``eval`` and ``ast`` are not involved, so a constant
may be called ``lambda``, and text from a file can do nothing but arithmetic. The language of
conditions on markings uses the same tokens and parser."""

from __future__ import annotations

import math
import operator
import re
from typing import (
    Any,
    Callable,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    NoReturn,
    Optional,
    Sequence,
    Set,
    Tuple,
    Union,
)

from gspn_framework_package.model.errors import ExpressionError, NoValueError

LONGEST_EXPRESSION = 10_000
"""Maximum length of an expression, in characters."""

DEEPEST_EXPRESSION = 60
"""Maximum nesting of parentheses, signs and powers: far more than anyone needs, far less than
Python's stack allows."""


class Token(NamedTuple):
    """A token of an expression: ``kind`` is ``number``, ``name``, ``operator`` or ``end``; ``text``
    is its text (a quoted name without the quotes); ``start`` is the index of its first character,
    from 0."""

    kind: str
    text: str
    start: int


class Number(NamedTuple):
    """A number, as written."""

    value: float


class Name(NamedTuple):
    """A name that needs a value: a constant or, in a condition, a place."""

    name: str


class Negation(NamedTuple):
    """Minus ``operand``."""

    operand: Expression


class Operation(NamedTuple):
    """``left operator right``, where the operator is one of ``+ - * / ^``."""

    operator: str
    left: Expression
    right: Expression


class Call(NamedTuple):
    """A function of :data:`FUNCTIONS` applied to its arguments."""

    function: str
    arguments: Tuple[Expression, ...]


Expression = Union[Number, Name, Negation, Operation, Call]

FUNCTIONS: Mapping[str, Tuple[int, Optional[int], Callable[..., Any]]] = {
    "min": (1, None, lambda *a: min(a)),
    "max": (1, None, lambda *a: max(a)),
    "floor": (1, 1, math.floor),
    "ceil": (1, 1, math.ceil),
    "round": (1, 1, lambda a: math.floor(a + 0.5)),
    "abs": (1, 1, abs),
    "sqrt": (1, 1, math.sqrt),
    "exp": (1, 1, math.exp),
    "log": (1, 1, math.log),
    "ln": (1, 1, math.log),
    "pow": (2, 2, math.pow),
    "mod": (2, 2, math.fmod),
}
"""Function name -> (minimum number of arguments, maximum or None for any, implementation)."""

ARITHMETIC: Mapping[str, Callable[[Any, Any], Any]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "^": operator.pow,
}
"""Operator -> implementation."""

_NUMBER = re.compile(r"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_TOKEN = re.compile(
    r"""
    (?P<space>\s+)
  | (?P<number>%s)
  | (?P<name>[^\W\d][\w.:]*)
  | (?P<quoted>"[^"]*"|'[^']*')
  | (?P<operator><=|>=|==|!=|<>|&&|\|\||->|[-+*/^%%(),<>=!&|\#@?:\[\]{};])
"""
    % _NUMBER.pattern,
    re.VERBOSE,
)


def tokenize(text: str) -> List[Token]:
    """Split ``text`` into tokens; the last one has the kind ``end``.

    Names may have letters, digits, ``_``, ``.`` and ``:``; any other name is written in quotes.
    Comparison and logical operators are tokens too, for the language of conditions.

    :raises ExpressionError: a character cannot start a token, a quote is not closed, or the text is
        longer than :data:`LONGEST_EXPRESSION`.

    >>> [t.text for t in tokenize("2*p1:Wait >= 'a b'")]
    ['2', '*', 'p1:Wait', '>=', 'a b', '']
    """
    if len(text) > LONGEST_EXPRESSION:
        raise ExpressionError(
            "the expression has %d characters, more than %d" % (len(text), LONGEST_EXPRESSION)
        )
    tokens = []
    at = 0
    while at < len(text):
        match = _TOKEN.match(text, at)
        if match is None:
            if text[at] in "\"'":
                raise ExpressionError("a quote is opened and not closed in '%s'" % shorten(text))
            raise ExpressionError("unexpected character %r in '%s'" % (text[at], shorten(text)))
        kind = match.lastgroup or ""
        if kind == "quoted":
            tokens.append(Token("name", match.group()[1:-1], at))
        elif kind != "space":
            tokens.append(Token(kind, match.group(), at))
        at = match.end()
    tokens.append(Token("end", "", len(text)))
    return tokens


class Parser:
    """A recursive-descent parser of arithmetic. A parser of a richer language subclasses it, starts
    from its own rule, and overrides :meth:`atom` to give names another meaning.

    Grammar, lowest precedence first: ``sum = product {(+|-) product}``,
    ``product = sign {(*|/) sign}``, ``sign = -sign | +sign | power``,
    ``power = atom [^ sign]`` (right-associative),
    ``atom = number | name | name(sum, ...) | (sum)``.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        self.tokens = tokenize(text)
        self.next = 0
        self._depth = 0

    @property
    def token(self) -> Token:
        """The next token."""
        return self.tokens[self.next]

    def take(self, *operators: str) -> Optional[str]:
        """Step over the next token if it is one of these operators and return its text, else
        None."""
        token = self.token
        if token.kind == "operator" and token.text in operators:
            self.next += 1
            return token.text
        return None

    def expect(self, operator: str) -> None:
        """Step over this operator. :raises ExpressionError: the next token is another one."""
        if not self.take(operator):
            self.fail("'%s' was expected" % operator)

    def fail(self, message: str) -> NoReturn:
        """Raise an error with ``message`` and the position of the next token."""
        token = self.token
        seen = (
            "at the end of"
            if token.kind == "end"
            else "before '%s' (character %d) in" % (shorten(token.text), token.start + 1)
        )
        raise ExpressionError("%s %s '%s'" % (message, seen, shorten(self.text)))

    def finish(self) -> None:
        """Check that the whole text was read. :raises ExpressionError: there are tokens left."""
        if self.token.kind != "end":
            self.fail("an operator was expected")

    def sum(self) -> Expression:
        """Read a sum: products joined by ``+`` and ``-``."""
        left = self.product()
        while True:
            operator = self.take("+", "-")
            if not operator:
                return left
            left = Operation(operator, left, self.product())

    def product(self) -> Expression:
        """Read a product: factors joined by ``*`` and ``/``."""
        left = self.sign()
        while True:
            operator = self.take("*", "/")
            if not operator:
                return left
            left = Operation(operator, left, self.sign())

    def sign(self) -> Expression:
        """Read a power and any signs before it."""
        self.enter()
        if self.take("-"):
            result: Expression = Negation(self.sign())
        elif self.take("+"):
            result = self.sign()
        else:
            result = self.power()
        self.leave()
        return result

    def power(self) -> Expression:
        """Read an atom and its exponent, if it has one."""
        base = self.atom()
        return Operation("^", base, self.sign()) if self.take("^") else base

    def atom(self) -> Expression:
        """Read a number, a name, a call or a sum in parentheses."""
        token = self.token
        if token.kind == "number":
            self.next += 1
            return Number(float(token.text))
        if token.kind == "name":
            self.next += 1
            if token.text in FUNCTIONS and self.take("("):
                return self._call(token.text)
            return Name(token.text)
        if not self.take("("):
            self.fail("a number, a name or '(' was expected")
        inner = self.sum()
        self.expect(")")
        return inner

    def _call(self, function: str) -> Call:
        arguments = [self.sum()]
        while self.take(","):
            arguments.append(self.sum())
        self.expect(")")
        least, greatest, _ = FUNCTIONS[function]
        if len(arguments) < least or (greatest is not None and len(arguments) > greatest):
            raise ExpressionError(
                "%s takes %d argument%s, not %d, in '%s'"
                % (function, least, "" if least == 1 else "s", len(arguments), shorten(self.text))
            )
        return Call(function, tuple(arguments))

    def enter(self) -> None:
        """Enter a level of nesting. :raises ExpressionError: it is too deep."""
        self._depth += 1
        if self._depth > DEEPEST_EXPRESSION:
            raise ExpressionError(
                "'%s' is nested more than %d levels deep" % (shorten(self.text), DEEPEST_EXPRESSION)
            )

    def leave(self) -> None:
        """Leave the level that :meth:`enter` entered."""
        self._depth -= 1


def parse(text: str) -> Expression:
    """Parse an arithmetic expression into a tree.

    :raises ExpressionError: the text cannot be read; the message says where.
    """
    # most expressions are plain numbers, and the parser takes ten times as long
    if len(text) <= LONGEST_EXPRESSION and _NUMBER.fullmatch(text):
        return Number(float(text))
    parser = Parser(text)
    tree = parser.sum()
    parser.finish()
    return tree


def names_in(tree: Expression) -> Set[str]:
    """Return the names that occur in ``tree``; each needs a value before it can be evaluated."""
    return {node.name for node in postorder(tree, operands) if isinstance(node, Name)}


def postorder(tree: Any, parts: Callable[[Any], Sequence[Any]]) -> Iterator[Any]:
    """Yield the nodes of a tree, each after its ``parts``; without recursion, because a long sum
    nests deeply to the left."""
    waiting = [(tree, False)]
    while waiting:
        node, ready = waiting.pop()
        inner = () if ready else parts(node)
        if inner:
            waiting.append((node, True))
            waiting += [(part, False) for part in reversed(inner)]
        else:
            yield node


def evaluate(expression: Union[str, Expression], constants: Mapping[str, float] = {}) -> float:
    """Evaluate an expression, given as text or as a tree; the result is finite.

    :param constants: the values of its names.
    :raises ExpressionError: the text cannot be read, a name has no value, or the result is not
        finite.

    >>> evaluate("2*N + min(lambda, 3)", {"N": 2, "lambda": 0.5})
    4.5
    """
    tree = parse(expression) if isinstance(expression, str) else expression
    if isinstance(tree, Number) and math.isfinite(tree.value):
        return tree.value  # the rates of most nets
    values: List[float] = []
    try:
        for node in postorder(tree, operands):
            first = len(values) - len(operands(node))
            values[first:] = [_apply(node, values[first:], constants)]
    except ZeroDivisionError:
        raise ExpressionError("division by zero in '%s'" % _text(expression)) from None
    except (OverflowError, ValueError, TypeError):  # no function takes a complex number
        raise ExpressionError("'%s' has no finite real value" % _text(expression)) from None
    if isinstance(values[0], complex) or not math.isfinite(values[0]):
        raise ExpressionError("'%s' has no finite real value" % _text(expression))
    return values[0]


def operands(node: Any) -> Tuple[Any, ...]:
    """Return the parts of a negation, an operation or a call."""
    if isinstance(node, Negation):
        return (node.operand,)
    if isinstance(node, Operation):
        return (node.left, node.right)
    return node.arguments if isinstance(node, Call) else ()


def _apply(node: Any, arguments: Sequence[float], constants: Mapping[str, float]) -> float:
    if isinstance(node, Number):
        return node.value
    if isinstance(node, Name):
        return float(_constant(node.name, constants))
    if isinstance(node, Negation):
        return -arguments[0]
    if isinstance(node, Call):
        return float(FUNCTIONS[node.function][2](*arguments))
    value: float = ARITHMETIC[node.operator](*arguments)
    return value


def _constant(name: str, constants: Mapping[str, float]) -> float:
    if name not in constants:
        known = ", ".join(sorted(constants)[:8])
        raise NoValueError(
            "'%s' has no value" % shorten(name),
            hint="known: %s" % known if known else "no constant is known here",
        )
    return constants[name]


def as_whole(value: float) -> Optional[int]:
    """Return ``value`` as an int if it is a whole number that a float holds exactly, else None."""
    return (
        int(value) if math.isfinite(value) and value == int(value) and abs(value) <= 2**53 else None
    )


def shorten(text: str, limit: int = 60) -> str:
    """Return ``text`` on one line of at most ``limit`` characters, for a message."""
    flat = " ".join(text.split())
    return flat if len(flat) <= limit else flat[: limit - 3] + "..."


def _text(expression: Union[str, Expression]) -> str:
    return shorten(expression) if isinstance(expression, str) else "the expression"
