"""Restrictions of topological maps: who may use a node or an edge.

A restriction is a condition on the robot, in the syntax of Python or of sympy: ``robot_short &
~robot_tall``, ``'thorvald' in robot``, ``True``. ``robot_TYPE`` holds for robots of that type, and
``robot`` for every robot. All other names, such as ``task_spray`` or ``obstacleFree_1``, hold or
not as specified by the user; unspecified names stay undecided.
"""

from __future__ import annotations

import ast
from typing import Any, Iterable, List, Mapping, Optional

from gspn_framework_package.model.errors import ExpressionError

MOST_CHARACTERS = 1000
"""Maximum length of a restriction."""


class Restriction:
    """A restriction: its ``text``.

    :raises ExpressionError: it cannot be read.
    """

    def __init__(self, text: str) -> None:
        self.text = text.strip()
        try:
            if len(self.text) > MOST_CHARACTERS:
                raise ValueError
            self._tree = ast.parse(self.text or "True", mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            raise ExpressionError(
                "'%.60s' is not a restriction" % self.text,
                hint="write for example robot_short & ~robot_tall, or 'short' in robot",
            ) from None

    def holds(
        self, robot: Optional[str] = None, conditions: Mapping[str, bool] = {}
    ) -> Optional[bool]:
        """Return whether a robot may go there; None if that depends on unknown conditions.

        :param robot: its type; None if unknown.
        :param conditions: name -> whether it holds.
        """
        try:
            return _value(self._tree, robot, conditions)
        except RecursionError:
            return None


def _value(node: Any, robot: Optional[str], conditions: Mapping[str, bool]) -> Optional[bool]:
    def parts(nodes: Iterable[Any]) -> List[Optional[bool]]:
        return [_value(part, robot, conditions) for part in nodes]

    if isinstance(node, ast.Constant):
        word = str(node.value).lower()
        return word == "true" if word in ("true", "false") else None
    if isinstance(node, ast.Name):
        return _name(node.id, robot, conditions)
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.Invert, ast.Not)):
        (inner,) = parts([node.operand])
        return None if inner is None else not inner
    if isinstance(node, ast.BoolOp):
        found = parts(node.values)
        return _all(found) if isinstance(node.op, ast.And) else _any(found)
    if isinstance(node, ast.BinOp) and isinstance(node.op, (ast.BitAnd, ast.BitOr)):
        found = parts([node.left, node.right])
        return _all(found) if isinstance(node.op, ast.BitAnd) else _any(found)
    if isinstance(node, ast.Compare) and len(node.ops) == 1:
        return _comparison(node, robot)
    return _is_one_of(node, robot)


def _name(name: str, robot: Optional[str], conditions: Mapping[str, bool]) -> Optional[bool]:
    if name in conditions:
        return conditions[name]
    if name.lower() in ("true", "false"):
        return name.lower() == "true"
    if name == "robot":
        return True
    if name.startswith("robot_") and robot is not None:
        return name[len("robot_") :].lower() == robot.lower()
    return None


def _comparison(node: ast.Compare, robot: Optional[str]) -> Optional[bool]:
    """``'short' in robot``, ``robot in ['short', 'tall']``, ``robot == 'short'``, and their
    opposites."""
    sides = [node.left, node.comparators[0]]
    others = [side for side in sides if not (isinstance(side, ast.Name) and side.id == "robot")]
    if len(others) != 1:
        return None
    found = _is_one_of(others[0], robot)
    if isinstance(node.ops[0], (ast.In, ast.Eq)) or found is None:
        return found
    return not found if isinstance(node.ops[0], (ast.NotIn, ast.NotEq)) else None


def _is_one_of(node: Any, robot: Optional[str]) -> Optional[bool]:
    """Whether the type of the robot is this text, or among these texts."""
    texts = node.elts if isinstance(node, (ast.List, ast.Tuple, ast.Set)) else [node]
    words = [text.value for text in texts if isinstance(text, ast.Constant)]
    words = [word.lower() for word in words if isinstance(word, str)]
    if robot is None or len(words) != len(texts):
        return None
    return robot.lower() in words


def _all(values: List[Optional[bool]]) -> Optional[bool]:
    return False if False in values else None if None in values else True


def _any(values: List[Optional[bool]]) -> Optional[bool]:
    return True if True in values else None if None in values else False
