"""Conditions on the fields of a message: ``percentage < 0.2 and not charging``,
``pose.position.x > 3``, ``data == "open"``, ``len(ranges) > 0 and min(ranges) < 0.5``.

The language is that of Python's expressions, restricted to fields (also of nested messages, and
elements by number), numbers, strings, ``True`` and ``False``, arithmetic, comparisons (also
``in``), ``and``, ``or``, ``not`` and the functions ``abs``, ``min``, ``max``, ``len`` and
``round``. It can read the message and nothing else, so text from a file is safe.
"""

from __future__ import annotations

import ast
import operator
from typing import Any, Callable, Dict, List, Tuple, Union

from gspn_framework_package.model.errors import ExpressionError

LONGEST_MESSAGE_CONDITION = 1_000
"""Maximum length of a condition, in characters."""

MOST_CONDITION_NODES = 200
"""Maximum number of parts of a condition."""

_Value = Callable[[Any], Any]

_OPERATORS: Dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Mod: operator.mod,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.In: lambda a, b: a in b,
    ast.NotIn: lambda a, b: a not in b,
}
_ARITHMETIC = (ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Mod)
_SIGNS: Dict[type, Callable[[Any], Any]] = {
    ast.UAdd: operator.pos,
    ast.USub: operator.neg,
    ast.Not: operator.not_,
}
_FUNCTIONS: Dict[str, Callable[..., Any]] = {
    "abs": abs,
    "min": min,
    "max": max,
    "len": len,
    "round": round,
}

_Message = Any
"""An object with attributes (a ROS message), or a mapping."""


class MessageCondition:
    """A condition on a message.

    :param text: the condition.
    :raises ExpressionError: it cannot be read.

    :ivar fields: the fields that it reads, each as the list of its steps (names, and numbers of
        elements).
    """

    def __init__(self, text: str) -> None:
        self.text = text
        self.fields: List[Tuple[Union[str, int], ...]] = []
        if len(text) > LONGEST_MESSAGE_CONDITION:
            raise ExpressionError(
                "the condition is %d characters long; at most %d are allowed"
                % (len(text), LONGEST_MESSAGE_CONDITION)
            )
        try:
            tree = ast.parse(text.strip(), mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            raise ExpressionError(
                "the condition '%s' cannot be read: %s" % (text, getattr(error, "msg", error))
            ) from None
        if sum(1 for _ in ast.walk(tree)) > MOST_CONDITION_NODES:
            raise ExpressionError("the condition has more than %d parts" % MOST_CONDITION_NODES)
        self._value = self._compile(tree)

    def holds(self, message: _Message) -> bool:
        """Whether the condition holds for a message.

        :raises ExpressionError: the message lacks a field, or a value is of the wrong type.
        """
        try:
            return bool(self._value(message))
        except ExpressionError:
            raise
        except (TypeError, ValueError, ArithmeticError, LookupError, AttributeError) as error:
            raise ExpressionError(
                "the condition '%s' has no value: %s" % (self.text, error)
            ) from None

    def read(self, message: _Message) -> Dict[str, Any]:
        """The fields that the condition reads, with their values; missing ones are left out."""
        found = {}
        for path in self.fields:
            try:
                found[field_name(path)] = field_of(message, path)
            except ExpressionError:
                continue
        return found

    def _compile(self, node: ast.AST) -> _Value:
        if isinstance(node, (ast.Name, ast.Attribute, ast.Subscript)):
            path = self._path(node)
            if path not in self.fields:
                self.fields.append(path)
            return lambda message: field_of(message, path)
        if isinstance(node, ast.Constant) and isinstance(node.value, (bool, int, float, str)):
            constant = node.value
            return lambda message: constant
        if isinstance(node, ast.UnaryOp) and type(node.op) in _SIGNS:
            sign, operand = _SIGNS[type(node.op)], self._compile(node.operand)
            return lambda message: sign(operand(message))
        if isinstance(node, ast.BinOp) and isinstance(node.op, _ARITHMETIC):
            function = _OPERATORS[type(node.op)]
            left, right = self._compile(node.left), self._compile(node.right)
            return lambda message: function(_number(left(message)), _number(right(message)))
        if isinstance(node, ast.BoolOp):
            parts = [self._compile(value) for value in node.values]
            every = all if isinstance(node.op, ast.And) else any
            return lambda message: every(part(message) for part in parts)
        if isinstance(node, ast.Compare) and all(type(o) in _OPERATORS for o in node.ops):
            return self._comparison(node)
        if (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Name)
            and node.func.id in _FUNCTIONS
            and node.args
            and not node.keywords
        ):
            called = _FUNCTIONS[node.func.id]
            arguments = [self._compile(argument) for argument in node.args]
            return lambda message: called(*(argument(message) for argument in arguments))
        raise self._not_read(node)

    def _comparison(self, node: ast.Compare) -> _Value:
        operands = [self._compile(part) for part in (node.left, *node.comparators)]
        functions = [_OPERATORS[type(o)] for o in node.ops]

        def compare(message: _Message) -> bool:
            values = [operand(message) for operand in operands]
            return all(f(a, b) for f, a, b in zip(functions, values, values[1:]))

        return compare

    def _path(self, node: ast.AST) -> Tuple[Union[str, int], ...]:
        if isinstance(node, ast.Name):
            return (node.id,)
        if isinstance(node, ast.Attribute):
            return (*self._path(node.value), node.attr)
        if isinstance(node, ast.Subscript):
            # Python 3.8 wraps the number of an element
            index = getattr(node.slice, "value", node.slice)
            index = getattr(index, "value", index)
            if type(index) is int and index >= 0:
                return (*self._path(node.value), index)
        raise self._not_read(node)

    def _not_read(self, node: ast.AST) -> ExpressionError:
        return ExpressionError(
            "the condition '%s' contains something unsupported (%s)"
            % (self.text, type(node).__name__),
            hint="use only fields, numbers, strings, comparisons, and, or, not, abs, min, max, "
            "len, round",
        )


def field_of(message: _Message, path: Tuple[Union[str, int], ...]) -> Any:
    """A field of a message. :raises ExpressionError: the message has no such field."""
    value = message
    for step in path:
        try:
            if isinstance(step, int) or isinstance(value, dict):
                value = value[step]
            elif step.startswith("_"):
                raise AttributeError(step)
            else:
                value = getattr(value, step)
        except (AttributeError, LookupError, TypeError):
            raise ExpressionError("the message has no field '%s'" % field_name(path)) from None
    return value


def field_name(path: Tuple[Union[str, int], ...]) -> str:
    """A field as it is written in conditions: ``pose.position.x``, ``ranges[0]``."""
    text = "".join("[%d]" % s if isinstance(s, int) else "." + s for s in path)
    return text.lstrip(".")


def parse_field(text: str) -> Tuple[Union[str, int], ...]:
    """The steps of a field. :raises ExpressionError: it is not the name of a field."""
    condition = MessageCondition(text)
    if len(condition.fields) != 1 or field_name(condition.fields[0]) != text.strip():
        raise ExpressionError("'%s' is not the name of a field" % text)
    return condition.fields[0]


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TypeError("%.40r is not a number" % (value,))
    return value
