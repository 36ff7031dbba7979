"""Rates and weights that depend on the marking: ``min(#waiting, 2) * 0.5``.

The language is that of :mod:`~gspn_framework_package.model.expression`; ``#place`` is the number
of tokens of a place, as in GreatSPN. The name of a place with characters other than letters,
digits, ``_``, ``.`` and ``:`` is written in quotes: ``#'room 1'``.
"""

from __future__ import annotations

import math
from typing import Any, Callable, List, Mapping, NoReturn, Sequence, Union

from gspn_framework_package.model.condition import (
    ProgramStep,
    compile_program,
    run_in_columns,
    run_program,
)
from gspn_framework_package.model.errors import ExpressionError, NoValueError, RefusedError
from gspn_framework_package.model.expression import (
    Expression,
    Name,
    Parser,
    Token,
    as_whole,
    evaluate,
    names_in,
    shorten,
    tokenize,
)


class MarkingFunction:
    """A rate or weight that depends on the marking, as read by :func:`parse_value`.

    Two are equal if they have the same operations on the same operands. Arithmetic and comparisons
    with one are refused, so what needs a number cannot take one by mistake; :meth:`value` is the
    number in a marking.

    :ivar text: the expression as written, with numbers in place of constants.
    :ivar places: the names of the places that it reads, sorted.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        tree = _parse(text)
        self.places: Sequence[str] = tuple(sorted(names_in(tree)))
        self._program = compile_program(tree, {name: name for name in self.places})

    def value(self, counts: Mapping[str, int]) -> float:
        """The value with these token counts, one for each of ``places``; NaN if there is none."""
        value = run_program(self._program, {name: float(counts[name]) for name in self.places})
        return float(value)

    def program(self, numbers: Mapping[str, int]) -> Sequence[ProgramStep]:
        """The expression as steps of a stack machine, with numbers for its places."""
        return [(step, numbers[of] if step == "place" else of) for step, of in self._program]

    def values(self, columns: Mapping[str, Any]) -> Any:
        """The values in many markings: a float array.

        :param columns: place -> float array of its token counts.
        """
        return run_in_columns(self._program, columns)

    def write(
        self, names: Mapping[str, str], operations: Mapping[str, Callable[..., Any]], element: str
    ) -> Any:
        """Write the expression in another language.

        :param names: place -> how a term names its token count.
        :param operations: operation -> what makes a term of its operands, which are terms or
            numbers.
        :param element: whose rate or weight it is, for the message.
        :raises RefusedError: the language lacks an operation.
        """
        lacking = {step for step, _ in self._program} - {"value", "place", *operations}
        if lacking:
            raise RefusedError(
                "'%s' uses %s, which this format does not have"
                % (shorten(self.text), " and ".join(sorted(lacking))),
                element=element,
            )
        return run_program(self._program, names, functions=operations)

    def renamed(self, names: Mapping[str, str]) -> MarkingFunction:
        """Return the function with other names for its places; names not given stay."""

        def change(token: Token, is_place: bool) -> str:
            return quoted_place(names.get(token.text, token.text)) if is_place else ""

        return MarkingFunction(_replaced(self.text, change))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, MarkingFunction) and self._program == other._program

    def __hash__(self) -> int:
        return hash(self._program)

    def __repr__(self) -> str:
        return "<MarkingFunction %s>" % shorten(self.text)

    def __str__(self) -> str:
        return self.text

    def _refuse(self, *_: object) -> NoReturn:
        raise RefusedError(
            "'%s' depends on the marking, and a rate or weight that is a number is needed here"
            % shorten(self.text)
        )

    __float__ = __bool__ = _refuse
    __mul__ = __rmul__ = __truediv__ = __rtruediv__ = _refuse
    __add__ = __radd__ = __sub__ = __rsub__ = __neg__ = _refuse
    __lt__ = __le__ = __gt__ = __ge__ = _refuse


Value = Union[float, MarkingFunction]
"""A rate or weight."""


def parse_value(text: str, constants: Mapping[str, float] = {}) -> Value:
    """Read a rate or weight: a number if it names no place.

    :param constants: the values of the names without ``#``.
    :raises ExpressionError: the text cannot be read, a name has no value, or the result is not
        finite.

    >>> parse_value("2 * N", {"N": 3})
    6.0
    >>> parse_value("N * min(#a, 2)", {"N": 3})
    <MarkingFunction 3 * min(#a, 2)>
    """
    if "#" not in text:
        return evaluate(text, constants)

    def change(token: Token, is_place: bool) -> str:
        value = None if is_place else constants.get(token.text)
        if value is None:
            return ""
        return _number_text(value) if value >= 0 else "(%s)" % _number_text(value)

    return MarkingFunction(_replaced(text, change))


def quoted_place(place: str) -> str:
    """The name of a place as an expression has it."""
    try:
        plain = tokenize(place)[0] == Token("name", place, 0)
    except ExpressionError:
        plain = False
    return place if plain else '"%s"' % place if "'" in place else "'%s'" % place


def written(value: Value) -> Union[float, str]:
    """A rate or weight as JSON has it: a number, or an expression."""
    return value.text if isinstance(value, MarkingFunction) else value


def is_valid(value: float) -> bool:
    """Whether a function may have this value where its transition is enabled."""
    return math.isfinite(value) and value > 0


def text_operations(layouts: Mapping[str, str]) -> Mapping[str, Callable[..., str]]:
    """Make what :meth:`MarkingFunction.write` needs for a language of text.

    :param layouts: operation -> its text, with ``%s`` for each operand, or ``...`` for all.
    """

    def filler(layout: str) -> Callable[..., str]:
        def fill(*operands: Union[str, float]) -> str:
            terms = tuple(x if isinstance(x, str) else _number_text(x) for x in operands)
            return layout.replace("...", ", ".join(terms)) if "..." in layout else layout % terms

        return fill

    return {operation: filler(layout) for operation, layout in layouts.items()}


def _number_text(value: float) -> str:
    whole = as_whole(value)
    return repr(value) if whole is None else str(whole)


class _Parser(Parser):
    """``atom = #name | ...``; other names are constants, which have been replaced by numbers."""

    def atom(self) -> Expression:
        if self.take("#"):
            token = self.token
            if token.kind != "name":
                self.fail("a place was expected after '#'")
            self.next += 1
            return Name(token.text)
        tree = super().atom()
        if isinstance(tree, Name):
            raise NoValueError(
                "'%s' has no value" % shorten(tree.name),
                hint="the tokens of a place are written #%s" % quoted_place(tree.name),
            )
        return tree


def _parse(text: str) -> Expression:
    parser = _Parser(text)
    tree = parser.sum()
    parser.finish()
    return tree


def _replaced(text: str, change: Callable[[Token, bool], str]) -> str:
    """The text with what ``change`` makes of its names, given whether it names a place; an empty
    string leaves a name as it is."""
    tokens = tokenize(text)
    words: List[str] = []
    at = 0
    for before, token, after in zip([tokens[-1], *tokens], tokens, tokens[1:]):
        if token.kind != "name" or after.text == "(":
            continue
        new = change(token, before.kind == "operator" and before.text == "#")
        if new:
            end = token.start + len(token.text)
            if text[token.start] in "\"'":
                end += 2
            words += [text[at : token.start], new]
            at = end
    return "".join([*words, text[at:]])
