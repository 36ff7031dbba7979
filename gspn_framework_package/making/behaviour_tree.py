"""Makes a plan of a behaviour tree of BehaviorTree.CPP 4.

A robot's token is in the place of the leaf that it runs. Each leaf has two transitions, for its
success and its failure, which lead to the leaf that the tree runs next: what the control nodes
above it say is where the arcs go. Bounded repetitions are unfolded, so any number of robots can run
the tree at once, each at its own leaf.
"""

from __future__ import annotations

import json
import re
from typing import (
    TYPE_CHECKING,
    Any,
    Callable,
    Dict,
    List,
    Mapping,
    Optional,
)

from gspn_framework_package.formats.source import read_bytes
from gspn_framework_package.formats.xml_tree import all_of, line_of, parse_xml, tag
from gspn_framework_package.making.leaf_plan import (
    MOST_LEAVES,
    MOST_TREE_NODES,
    ImportedPlan,
    Leaf,
    Target,
    plan_of_leaves,
)
from gspn_framework_package.model.errors import InputError, UsageError

if TYPE_CHECKING:
    from lxml import etree

SUCCESS_PLACE, FAILURE_PLACE = "SUCCESS", "FAILURE"
"""The places in which a robot ends."""

ON_SUCCESS, ON_FAILURE = " succeeds", " fails"
"""The suffixes that turn the name of a leaf's place into those of its transitions."""

_DEEPEST = 200
"""Maximum depth of a tree; a subtree that contains itself would exceed any."""

WHY_NOT = {
    "Parallel": "a robot does one thing at a time",
    "ParallelAll": "a robot does one thing at a time",
    "ReactiveSequence": "its first children are checked again while a later one runs",
    "ReactiveFallback": "its first children are checked again while a later one runs",
    "WhileDoElse": "its condition is checked again while another child runs",
    "SequenceWithMemory": "it remembers where it failed",
    "AsyncSequence": "it yields between its children",
    "AsyncFallback": "it yields between its children",
    "Switch2": "it reads the blackboard",
    "Switch3": "it reads the blackboard",
    "Switch4": "it reads the blackboard",
    "Switch5": "it reads the blackboard",
    "Switch6": "it reads the blackboard",
    "ManualSelector": "a person chooses",
    "RunOnce": "it remembers that it ran",
    "Script": "it writes to the blackboard",
    "ScriptCondition": "it reads the blackboard",
    "Precondition": "it reads the blackboard",
    "SetBlackboard": "it writes to the blackboard",
    "UnsetBlackboard": "it writes to the blackboard",
    "LoopBool": "it takes turns from a queue",
    "LoopDouble": "it takes turns from a queue",
    "LoopInt": "it takes turns from a queue",
    "LoopString": "it takes turns from a queue",
    "TryCatch": "it runs a child when it is cancelled",
    "EntryUpdated": "it reads the blackboard",
    "WaitValueUpdate": "it reads the blackboard",
    "SkipUnlessUpdated": "it reads the blackboard",
}
"""Nodes of BehaviorTree.CPP that a plan cannot express -> why."""

_SCRIPTS = re.compile(r"_(skipIf|successIf|failureIf|while|on\w+|post)$")
"""Attributes with scripts, which read the blackboard."""

_OF_THE_NODE = ("ID", "name")


def import_tree(path: str, robots: int = 1, tree: Optional[str] = None) -> ImportedPlan:
    """Make a plan of a file of BehaviorTree.CPP 4.

    :param path: the XML file.
    :param robots: number of robots; each runs the tree on its own.
    :param tree: the tree to begin with; None: the one that the file says, or its only one.
    :raises InputError: the file cannot be read, or has a node that a plan cannot express; the error
        has its line.
    :raises UsageError: there is no such tree.
    """
    root = parse_xml(read_bytes(path), path)
    try:
        return _Import(root, tree).plan(robots)
    except InputError as error:
        raise error.located(file=path) from None


class _Import:
    def __init__(self, root: etree._Element, tree: Optional[str]) -> None:
        if tag(root) != "root" or not all_of(root, "BehaviorTree"):
            raise InputError("this is not a file of BehaviorTree.CPP: it has no <BehaviorTree>")
        if root.get("BTCPP_format") != "4":
            raise InputError(
                'it does not say BTCPP_format="4"',
                line=line_of(root),
                hint="the nodes of version 3 have other meanings; convert it with Groot",
            )
        for element in all_of(root, "include"):
            raise _refused(element, "an included file is not read", "put its trees into this file")
        self._trees = {str(each.get("ID", "")): each for each in all_of(root, "BehaviorTree")}
        self.name = tree or root.get("main_tree_to_execute") or ""
        if not self.name and len(self._trees) == 1:
            self.name = next(iter(self._trees))
        if self.name not in self._trees:
            raise UsageError(
                "there is no tree '%s'" % self.name if self.name else "which tree is the main one?",
                hint="--tree: choose from %s" % ", ".join(self._trees),
            )
        self._leaves: List[Leaf] = []  # the last first
        self._notes: List[str] = []
        self._ports: Mapping[str, str] = {}  # of the present subtree
        self._depth = self._count = 0

    def plan(self, robots: int) -> ImportedPlan:
        """The plan for a number of robots."""
        child = self._only_child(self._trees[self.name])
        begins = self._node(child, Target(SUCCESS_PLACE), Target(FAILURE_PLACE))
        self._leaves.reverse()
        net, plan = plan_of_leaves(
            self.name or "tree",
            "behaviour tree '%s'" % self.name,
            self._leaves,
            begins,
            (SUCCESS_PLACE, FAILURE_PLACE),
            robots,
        )
        functions = self._functions()
        return ImportedPlan(
            net,
            plan,
            {"actions.py": _actions_text(functions)},
            "actions.py has a function for each leaf: %s" % ", ".join(functions.values()),
            self._notes,
        )

    def _functions(self) -> Dict[str, str]:
        """The kinds of leaves, each with the name of its function."""
        found: Dict[str, str] = {}
        for leaf in self._leaves:
            node = leaf.action["settings"].get("node")
            if node and node not in found:
                found[node] = _function_name(node, found.values())
        return found

    # -- nodes: each takes the targets of its success and its failure, and returns where it begins

    def _node(self, element: etree._Element, success: Target, failure: Target) -> Target:
        kind = _kind(element)
        if kind in WHY_NOT:
            raise _refused(element, WHY_NOT[kind])
        for name in element.attrib:
            if _SCRIPTS.match(str(name)):
                raise _refused(element, "the script of %s reads the blackboard" % str(name))
        self._depth += 1
        self._count += 1
        if self._count > MOST_TREE_NODES:
            raise _refused(element, "with its repetitions, the tree has too many nodes")
        if self._depth > _DEEPEST:
            raise _refused(element, "the tree is too deep, or a subtree contains itself")
        make = _NODES.get(kind)
        if make is not None:
            begins = make(self, element, success, failure)
        elif len(element):
            raise _refused(
                element, "BehaviorTree.CPP has no such node, and only leaves can be your own"
            )
        else:
            begins = self._action(element, kind, success, failure)
        self._depth -= 1
        return begins

    def _sequence(self, element: etree._Element, success: Target, failure: Target) -> Target:
        for child in reversed(self._children(element)):
            success = self._node(child, success, failure)
        return success

    def _fallback(self, element: etree._Element, success: Target, failure: Target) -> Target:
        for child in reversed(self._children(element)):
            failure = self._node(child, success, failure)
        return failure

    def _if_then_else(self, element: etree._Element, success: Target, failure: Target) -> Target:
        children = self._children(element)
        if len(children) not in (2, 3):
            raise _refused(element, "it has %d children, not 2 or 3" % len(children))
        otherwise = failure
        if len(children) == 3:
            otherwise = self._node(children[2], success, failure)
        return self._node(children[0], self._node(children[1], success, failure), otherwise)

    def _inverter(self, element: etree._Element, success: Target, failure: Target) -> Target:
        return self._node(self._only_child(element), failure, success)

    def _force_success(self, element: etree._Element, success: Target, failure: Target) -> Target:
        return self._node(self._only_child(element), success, success)

    def _force_failure(self, element: etree._Element, success: Target, failure: Target) -> Target:
        return self._node(self._only_child(element), failure, failure)

    def _always_success(self, element: etree._Element, success: Target, failure: Target) -> Target:
        return success

    def _always_failure(self, element: etree._Element, success: Target, failure: Target) -> Target:
        return failure

    def _retry(self, element: etree._Element, success: Target, failure: Target) -> Target:
        child, times = self._only_child(element), _number(element, "num_attempts")
        if times == -1:
            again = Target()
            again.lead_to(self._node(child, success, again))
            return again
        for _ in range(times):
            failure = self._node(child, success, failure)
        return failure

    def _repeat(self, element: etree._Element, success: Target, failure: Target) -> Target:
        child, times = self._only_child(element), _number(element, "num_cycles")
        if times == -1:
            return self._until_failure(element, success, failure)
        for _ in range(times):
            success = self._node(child, success, failure)
        return success

    def _until_failure(self, element: etree._Element, success: Target, failure: Target) -> Target:
        again = Target()
        again.lead_to(self._node(self._only_child(element), again, failure))
        return again

    def _delay(self, element: etree._Element, success: Target, failure: Target) -> Target:
        begins = self._node(self._only_child(element), success, failure)
        return self._wait(element, "delay_msec", begins)

    def _sleep(self, element: etree._Element, success: Target, failure: Target) -> Target:
        return self._wait(element, "msec", success)

    def _wait(self, element: etree._Element, attribute: str, success: Target) -> Target:
        seconds = _number(element, attribute) / 1000
        action = {"function": "actions.Wait", "settings": {"seconds": seconds}}
        return self._leaf(element, "Wait %g s" % seconds, action, success, None)

    def _timeout(self, element: etree._Element, success: Target, failure: Target) -> Target:
        seconds, child = _number(element, "msec") / 1000, self._only_child(element)
        if _kind(child) in _NODES or len(child):
            raise _refused(element, "only the timeout of an action can be expressed")
        begins = self._node(child, success, failure)
        self._leaves[-1].timeout = seconds
        return begins

    def _subtree(self, element: etree._Element, success: Target, failure: Target) -> Target:
        name = element.get("ID", "")
        if name not in self._trees:
            raise _refused(element, "there is no tree '%s'" % name)
        around, self._ports = self._ports, self._ports_of(element)
        begins = self._node(self._only_child(self._trees[name]), success, failure)
        self._ports = around
        return begins

    def _ports_of(self, element: etree._Element) -> Dict[str, str]:
        """The ports of a node; values that the ports of the subtree around it give are filled
        in."""
        found = {}
        for key, value in element.attrib.items():
            name, text = str(key), str(value)
            if name not in _OF_THE_NODE and not name.startswith("_"):
                entry = re.fullmatch(r"\{(.*)\}", text)
                found[name] = self._ports.get(entry.group(1), text) if entry else text
        return found

    def _action(
        self, element: etree._Element, kind: str, success: Target, failure: Target
    ) -> Target:
        ports = self._ports_of(element)
        for name, value in ports.items():
            if re.fullmatch(r"\{.*\}", value):
                note = (
                    "line %d: %s: the port %s is the entry %s of the blackboard; the function gets "
                    "that text" % (line_of(element), kind, name, value)
                )
                self._notes += [] if note in self._notes else [note]
        action = {"function": "actions.Node", "settings": {"node": kind, "ports": ports}}
        return self._leaf(element, element.get("name") or kind, action, success, failure)

    def _leaf(
        self,
        element: etree._Element,
        name: str,
        action: Any,
        success: Target,
        failure: Optional[Target],
    ) -> Target:
        if len(self._leaves) >= MOST_LEAVES:
            raise _refused(
                element,
                "with its repetitions unfolded, the tree has more than %d leaves" % MOST_LEAVES,
            )
        outcomes, failed = {ON_SUCCESS: success}, None
        if failure is not None:
            outcomes[ON_FAILURE], failed = failure, ON_FAILURE
        leaf = Leaf(Target(), name, action, outcomes, failed, line=line_of(element))
        self._leaves.append(leaf)
        return leaf.here

    def _children(self, element: etree._Element) -> List[etree._Element]:
        found = [child for child in element if tag(child)]
        if not found:
            raise _refused(element, "it has no child")
        return found

    def _only_child(self, element: etree._Element) -> etree._Element:
        found = self._children(element)
        if len(found) > 1:
            raise _refused(element, "it has %d children, not one" % len(found))
        return found[0]


_Make = Callable[[_Import, "etree._Element", Target, Target], Target]

_NODES: Mapping[str, _Make] = {
    "Sequence": _Import._sequence,
    "Fallback": _Import._fallback,
    "IfThenElse": _Import._if_then_else,
    "Inverter": _Import._inverter,
    "ForceSuccess": _Import._force_success,
    "ForceFailure": _Import._force_failure,
    "AlwaysSuccess": _Import._always_success,
    "AlwaysFailure": _Import._always_failure,
    "RetryUntilSuccessful": _Import._retry,
    "Repeat": _Import._repeat,
    "KeepRunningUntilFailure": _Import._until_failure,
    "Delay": _Import._delay,
    "Sleep": _Import._sleep,
    "Timeout": _Import._timeout,
    "SubTree": _Import._subtree,
}
"""Nodes that a plan can express."""


def _kind(element: etree._Element) -> str:
    """The name of a node: of its own element, or the ID of an explicit one."""
    name = tag(element)
    if name in ("Action", "Condition", "Control", "Decorator"):
        return element.get("ID") or name
    return name


def _number(element: etree._Element, attribute: str) -> int:
    text = element.get(attribute, "")
    try:
        return int(text)
    except ValueError:
        raise _refused(element, "%s is '%s', not a whole number" % (attribute, text)) from None


def _refused(element: etree._Element, why: str, hint: Optional[str] = None) -> InputError:
    return InputError(why, line=line_of(element), element="<%s>" % tag(element), hint=hint)


def _function_name(node: str, taken: Any) -> str:
    words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|\W+", "_", node, flags=re.ASCII).strip("_").lower()
    name = words if words.isidentifier() else "node_" + words
    while name in taken or name in ("node", "wait"):
        name += "_"
    return name


_ACTIONS = '''\
"""The leaves of the tree. Each returns whether it succeeded; an exception, too, is a failure."""

%(functions)s

FUNCTIONS = {
%(table)s
}


class Node:
    """Runs the function of a leaf, and names the transition of its outcome."""

    def __init__(self, node, ports):
        self.node, self.ports = node, ports

    def __call__(self, place, is_cancelled):
        """Run it with its ports."""
        succeeded = FUNCTIONS[self.node](is_cancelled, **self.ports)
        return place + ("%(succeeds)s" if succeeded else "%(fails)s")


class Wait:
    """Takes its time."""

    def __init__(self, seconds):
        self.seconds = seconds

    def __call__(self, is_cancelled):
        """Wait."""
        is_cancelled.wait(self.seconds)
'''

_FUNCTION = '''\

def %s(is_cancelled, **ports):
    """%s. Put your own code in its place."""
    return not is_cancelled.wait(0.1)
'''


def _actions_text(functions: Mapping[str, str]) -> str:
    comments = ((name, re.sub(r"[\W_]+", " ", node)) for node, name in functions.items())
    return _ACTIONS % {
        "functions": "\n".join(_FUNCTION % each for each in comments),
        "table": "\n".join("    %s: %s," % (json.dumps(n), f) for n, f in functions.items()),
        "succeeds": ON_SUCCESS,
        "fails": ON_FAILURE,
    }
