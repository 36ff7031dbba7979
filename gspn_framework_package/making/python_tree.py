"""Makes a plan of a behaviour tree of py_trees.

The plan's actions tick the tree of the file itself, leaf by leaf. What only the ticks decide, such
as a Parallel, is one action with everything below it.
"""

from __future__ import annotations

import json
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple

from gspn_framework_package.formats.tree_ticks import NEVER_RUNNING
from gspn_framework_package.making.behaviour_tree import (
    FAILURE_PLACE,
    ON_FAILURE,
    ON_SUCCESS,
    SUCCESS_PLACE,
)
from gspn_framework_package.making.leaf_plan import (
    MOST_LEAVES,
    MOST_TREE_NODES,
    ImportedPlan,
    Leaf,
    Target,
    plan_of_leaves,
)
from gspn_framework_package.model.errors import InputError

ON_RUNNING = " goes on"
"""The suffix of a place's name for a tick after which the leaf is running."""

_ENDINGS = {"SUCCESS": ON_SUCCESS, "FAILURE": ON_FAILURE, "RUNNING": ON_RUNNING}

_DEEPEST = 200
"""Maximum depth of a tree."""

_Node = Mapping[str, Any]
_Path = Tuple[int, ...]
"""The numbers of the children that lead to a node."""

WHY_ONE_ACTION = {
    "Parallel": "its children run at the same time",
    "RunningIsFailure": "it ends while its child runs",
    "RunningIsSuccess": "it ends while its child runs",
    "Timeout": "its time limit is for everything below it",
    "EternalGuard": "its condition is checked at each tick",
    "OneShot": "it remembers that it ran",
    "Count": "it counts ticks",
    "StatusToBlackboard": "it writes the status of its child at each tick",
    "ForEach": "it takes items from the blackboard",
    "Condition": "it waits until its child is running",
}
"""Nodes that are one action, with everything below them -> why."""


def plan_of_tree(file: str, name: str, root: _Node, robots: int) -> ImportedPlan:
    """Make a plan of a tree.

    :param file: the name of the file that makes it.
    :param name: the function in it that makes the tree, or the variable that holds it.
    :param root: its root, as :mod:`gspn_framework_package.formats.python_root` describes it.
    :raises InputError: a plan cannot express it.
    """
    made = _Tree()
    begins = made.node(root, (), Target(SUCCESS_PLACE), Target(FAILURE_PLACE))
    made.leaves.reverse()
    if len(made.leaves) == 1 and made.whole:
        raise refused(
            root,
            "the whole tree would be one action: %s" % made.whole,
            "--ticks: each tick of a leaf is an action; --tree NAME: a function that makes a part",
        )
    net, plan = plan_of_leaves(
        root["name"] or "tree",
        "behaviour tree '%s'" % root["name"],
        made.leaves,
        begins,
        (SUCCESS_PLACE, FAILURE_PLACE),
        robots,
    )
    text = _ACTIONS % {**_words(file, name), **_WHOLE_LEAVES}
    says = "actions.py ticks the leaves of original/%s" % file
    return ImportedPlan(net, plan, {"actions.py": text}, says, made.notes)


def plan_of_ticks(
    file: str, name: str, root: _Node, states: Sequence[Mapping[str, Any]], robots: int
) -> ImportedPlan:
    """Make a plan of a tree in which each tick of a leaf is an action.

    :param file, name, root: as for :func:`plan_of_tree`.
    :param states: as :func:`~gspn_framework_package.formats.tree_ticks.explore` returns them.
    :raises InputError: there are too many.
    """
    if len(states) > MOST_LEAVES:
        raise refused(root, "the tree has more than %d states" % MOST_LEAVES)
    here = [Target() for _ in states]
    leaves = []
    for state, target in zip(states, here):
        node = root
        for number in state["path"]:
            node = node["children"][number]
        action = {"function": "actions.Node", "settings": {"path": list(state["path"])}}
        outcomes = {
            _ENDINGS[outcome]: Target(to) if isinstance(to, str) else here[to]
            for outcome, to in state["leads"].items()
        }
        file_of, line = node["line"] or (None, None)
        leaves.append(Leaf(target, node["name"], action, outcomes, None, file_of, line))
    ends = (SUCCESS_PLACE, FAILURE_PLACE)
    what = "behaviour tree '%s'" % root["name"]
    net, plan = plan_of_leaves(root["name"] or "tree", what, leaves, here[0], ends, robots)
    text = _ACTIONS % {**_words(file, name), **_TICKS}
    says = "actions.py ticks the leaves of original/%s, one tick for each action" % file
    return ImportedPlan(net, plan, {"actions.py": text}, says, [])


def _words(file: str, name: str) -> Dict[str, str]:
    return {
        "file": json.dumps(file),
        "name": json.dumps(name),
        "succeeds": ON_SUCCESS,
        "fails": ON_FAILURE,
        "goes_on": ON_RUNNING,
    }


def refused(node: _Node, why: str, hint: Optional[str] = None) -> InputError:
    """The error for a node that a plan cannot express."""
    file, line = node["line"] or (None, None)
    return InputError(why, file=file, line=line, element=describe(node), hint=hint)


def describe(node: _Node) -> str:
    """The kind and the name of a node, for a message."""
    return "%s '%s'" % (node["class"].rpartition(".")[2], node["name"])


class _Tree:
    def __init__(self) -> None:
        self.leaves: List[Leaf] = []  # the last first
        self.notes: List[str] = []
        self.whole = ""  # why the last composite or decorator became one action
        self._depth = self._count = 0

    def node(self, node: _Node, path: _Path, success: Target, failure: Target) -> Target:
        """Make the leaves of a node, which lead to ``success`` or ``failure``; return where it
        begins."""
        self._count += 1
        self._depth += 1
        if self._count > MOST_TREE_NODES:
            raise refused(node, "with its repetitions, the tree has too many nodes")
        if self._depth > _DEEPEST:
            raise refused(node, "the tree is too deep")
        make = _NODES.get(node["class"])
        why = self._why_one_action(node)
        if make is not None and not why:
            begins = make(self, node, path, success, failure)
        else:
            begins = self._leaf(node, path, why, success, failure)
        self._depth -= 1
        return begins

    def _why_one_action(self, node: _Node) -> str:
        """Why a node with children is one action; "" if it is not."""
        library, _, kind = node["class"].rpartition(".")
        known = library in ("py_trees.composites", "py_trees.decorators")
        if not node["children"]:
            return ""
        if kind == "Condition" and node["awaited"] in ("SUCCESS", "FAILURE") and known:
            return ""
        if known and kind in ("Sequence", "Selector"):
            if node["memory"] or all(map(_is_at_once, node["children"][1:])):
                return ""
            return "it has no memory, so its first children are ticked again while a later one runs"
        if known and node["class"] in _NODES:
            return ""
        return WHY_ONE_ACTION.get(kind, "") if known else "its class is not one of py_trees"

    def _leaf(self, node: _Node, path: _Path, why: str, success: Target, failure: Target) -> Target:
        file, line = node["line"] or (None, None)
        if len(self.leaves) >= MOST_LEAVES:
            raise refused(
                node,
                "with its repetitions unfolded, the tree has more than %d leaves" % MOST_LEAVES,
            )
        if node["children"]:
            self.whole = why or "what it does is not known"
            note = "%s:%s: %s is one action, with everything below it: %s" % (
                file,
                line,
                describe(node),
                self.whole,
            )
            self.notes += [] if note in self.notes else [note]
        action = {"function": "actions.Node", "settings": {"path": list(path)}}
        leaf = Leaf(
            Target(),
            node["name"],
            action,
            {ON_SUCCESS: success, ON_FAILURE: failure},
            ON_FAILURE,
            file,
            line,
        )
        self.leaves.append(leaf)
        return leaf.here

    def sequence(self, node: _Node, path: _Path, success: Target, failure: Target) -> Target:
        for number in reversed(range(len(node["children"]))):
            child = node["children"][number]
            success = self.node(child, (*path, number), success, failure)
        return success

    def selector(self, node: _Node, path: _Path, success: Target, failure: Target) -> Target:
        for number in reversed(range(len(node["children"]))):
            child = node["children"][number]
            failure = self.node(child, (*path, number), success, failure)
        return failure

    def _child(self, node: _Node, path: _Path, success: Target, failure: Target) -> Target:
        return self.node(node["children"][0], (*path, 0), success, failure)

    def inverter(self, node: _Node, path: _Path, success: Target, failure: Target) -> Target:
        return self._child(node, path, failure, success)

    def to_success(self, node: _Node, path: _Path, success: Target, failure: Target) -> Target:
        return self._child(node, path, success, success)

    def to_failure(self, node: _Node, path: _Path, success: Target, failure: Target) -> Target:
        return self._child(node, path, failure, failure)

    def until_success(self, node: _Node, path: _Path, success: Target, failure: Target) -> Target:
        again = Target()
        again.lead_to(self._child(node, path, success, again))
        return again

    def until_failure(self, node: _Node, path: _Path, success: Target, failure: Target) -> Target:
        again = Target()
        again.lead_to(self._child(node, path, again, failure))
        return again

    def condition(self, node: _Node, path: _Path, success: Target, failure: Target) -> Target:
        if node["awaited"] == "SUCCESS":
            return self.until_success(node, path, success, failure)
        again = Target()
        again.lead_to(self._child(node, path, again, success))
        return again

    def retry(self, node: _Node, path: _Path, success: Target, failure: Target) -> Target:
        for _ in range(max(1, node["num_failures"])):
            failure = self._child(node, path, success, failure)
        return failure

    def repeat(self, node: _Node, path: _Path, success: Target, failure: Target) -> Target:
        if node["num_success"] < 1:
            return self.until_failure(node, path, success, failure)
        for _ in range(node["num_success"]):
            success = self._child(node, path, success, failure)
        return success

    def through(self, node: _Node, path: _Path, success: Target, failure: Target) -> Target:
        return self._child(node, path, success, failure)

    def succeeds(self, node: _Node, path: _Path, success: Target, failure: Target) -> Target:
        return success

    def fails(self, node: _Node, path: _Path, success: Target, failure: Target) -> Target:
        return failure


def _is_at_once(node: _Node) -> bool:
    """Whether a node is never running."""
    plain = ("py_trees.composites.Sequence", "py_trees.composites.Selector")
    ended = ("Inverter", "FailureIsSuccess", "SuccessIsFailure", "PassThrough")
    inner = (*plain, *("py_trees.decorators." + name for name in ended))
    if node["class"] in inner:
        return all(map(_is_at_once, node["children"]))
    return node["class"] in NEVER_RUNNING


_Make = Callable[[_Tree, _Node, _Path, Target, Target], Target]

_NODES: Dict[str, _Make] = {
    "py_trees.composites.Sequence": _Tree.sequence,
    "py_trees.composites.Selector": _Tree.selector,
    "py_trees.decorators.Inverter": _Tree.inverter,
    "py_trees.decorators.FailureIsSuccess": _Tree.to_success,
    "py_trees.decorators.SuccessIsFailure": _Tree.to_failure,
    "py_trees.decorators.FailureIsRunning": _Tree.until_success,
    "py_trees.decorators.SuccessIsRunning": _Tree.until_failure,
    "py_trees.decorators.Condition": _Tree.condition,
    "py_trees.decorators.Retry": _Tree.retry,
    "py_trees.decorators.Repeat": _Tree.repeat,
    "py_trees.decorators.PassThrough": _Tree.through,
    "py_trees.behaviours.Success": _Tree.succeeds,
    "py_trees.behaviours.Failure": _Tree.fails,
}
"""Nodes that become arcs."""

_ACTIONS = '''\
"""Ticks the leaves of the tree that ``original/`` makes, each robot those of a tree of its own."""

import os
import threading

from gspn_framework_package.formats.python_root import load_root
from gspn_framework_package.formats.tree_ticks import TreeSteps, node_at

SECONDS_BETWEEN_TICKS = 0.1

FILE = os.path.join(os.path.dirname(os.path.abspath(__file__)), "original", %(file)s)
NAME = %(name)s
OUTCOMES = {"SUCCESS": "%(succeeds)s", "FAILURE": "%(fails)s", "RUNNING": "%(goes_on)s"}

_trees, _lock = {}, threading.Lock()


def tree_of(robot):
    """The robot's own tree, made and set up when it is first needed."""
    with _lock:
        if robot not in _trees:
            _, root = load_root(FILE, NAME, "file_of_" + robot)
            for node in root.iterate():
                node.setup()
            _trees[robot] = %(tree)s
        return _trees[robot]


class Node:
    """%(does)s, and names its outcome."""

    def __init__(self, path):
        self.path = tuple(path)

    def __call__(self, place, robot, is_cancelled):
        """Tick it."""
%(run)s
'''

_WHOLE_LEAVES = {
    "tree": "root",
    "does": "Ticks a leaf, or a part of the tree, until it ends",
    "run": """\
        node = node_at(tree_of(robot), self.path)
        node.tick_once()
        while node.status.name == "RUNNING":
            if is_cancelled.wait(SECONDS_BETWEEN_TICKS):
                node.stop(type(node.status).INVALID)
                return None
            node.tick_once()
        return place + OUTCOMES.get(node.status.name, OUTCOMES["FAILURE"])""",
}

_TICKS = {
    "tree": "TreeSteps(root)",
    "does": "Ticks a leaf once",
    "run": """\
        status, ended = tree_of(robot).tick(place, self.path)
        if ended:  # the tick of the whole tree
            is_cancelled.wait(SECONDS_BETWEEN_TICKS)
        return place + OUTCOMES.get(status, OUTCOMES["FAILURE"])""",
}
