"""Random behaviour trees, what BehaviorTree.CPP says that they do, and what a net of theirs does.

A *script* is the results of the leaves that are run, in order; a *trace* is the names of those leaves
and how the tree ended: True, False, or None where the script was too short.
"""

import random
from typing import Any, List, Optional, Sequence, Tuple
from xml.etree import ElementTree

from gspn_framework_package.making.behaviour_tree import (
    FAILURE_PLACE,
    ON_FAILURE,
    ON_SUCCESS,
    SUCCESS_PLACE,
)
from gspn_framework_package.model.net import Net

Trace = Tuple[List[str], Optional[bool]]

LEAVES = ("Alarm", "Battery", "Charge", "Door")
CONTROLS = ("Sequence", "Fallback", "IfThenElse")
DECORATORS = (
    "Inverter",
    "ForceSuccess",
    "ForceFailure",
    "RetryUntilSuccessful",
    "Repeat",
    "KeepRunningUntilFailure",
    "SubTree",
)
COUNTS = {"RetryUntilSuccessful": "num_attempts", "Repeat": "num_cycles"}


def random_tree(seed: int) -> str:
    """Return a file with a random tree, and perhaps subtrees."""
    draws = random.Random(seed)
    root = ElementTree.Element("root", BTCPP_format="4", main_tree_to_execute="Main")
    subtrees: List[Any] = []

    def node(depth: int) -> Any:
        kind = draws.random()
        if depth == 0 or kind < 0.25:
            constant = draws.random() < 0.1
            return ElementTree.Element(
                draws.choice(("AlwaysSuccess", "AlwaysFailure") if constant else LEAVES)
            )
        if kind < 0.65:
            name = draws.choice(CONTROLS)
            # with two children, that of BehaviorTree.CPP 4 does not run its condition again
            number = 3 if name == "IfThenElse" else draws.randint(1, 4)
            found = ElementTree.Element(name)
            found.extend([node(depth - 1) for _ in range(number)])
            return found
        name = draws.choice(DECORATORS)
        found = ElementTree.Element(name)
        if name == "SubTree":
            subtree = ElementTree.Element("BehaviorTree", ID="Sub%d" % len(subtrees))
            subtrees.append(subtree)
            subtree.append(node(depth - 1))
            found.set("ID", subtree.get("ID", ""))
            return found
        if name in COUNTS:
            found.set(COUNTS[name], str(draws.choice((-1, 1, 2, 3))))
        found.append(node(depth - 1))
        return found

    main = ElementTree.SubElement(root, "BehaviorTree", ID="Main")
    main.append(node(4))
    root.extend(subtrees)
    return ElementTree.tostring(root, encoding="unicode")


def random_script(seed: int, length: int = 60) -> List[bool]:
    """Return the results of leaves."""
    draws = random.Random(-seed - 1)
    return [draws.random() < 0.6 for _ in range(length)]


class _ScriptError(Exception):
    pass


def interpreted(text: str, script: Sequence[bool]) -> Trace:
    """Return what the tree does, by the documentation of BehaviorTree.CPP."""
    root = ElementTree.fromstring(text)
    trees = {tree.get("ID"): tree[0] for tree in root}
    results, trace = iter(script), []  # type: Iterator[bool], List[str]

    def run(node: Any) -> bool:
        kind, count = node.tag, int(node.get(COUNTS.get(node.tag, ""), 0))
        if kind == "Sequence":
            return all(run(child) for child in node)
        if kind == "Fallback":
            return any(run(child) for child in node)
        if kind == "IfThenElse":
            if run(node[0]):
                return run(node[1])
            return run(node[2]) if len(node) > 2 else False
        if kind == "SubTree":
            return run(trees[node.get("ID")])
        if kind == "Inverter":
            return not run(node[0])
        if kind in ("ForceSuccess", "ForceFailure"):
            run(node[0])
            return kind == "ForceSuccess"
        if kind in ("AlwaysSuccess", "AlwaysFailure"):
            return kind == "AlwaysSuccess"
        if kind in (*COUNTS, "KeepRunningUntilFailure"):
            retried = kind == "RetryUntilSuccessful"
            times = 0
            while kind == "KeepRunningUntilFailure" or count == -1 or times < count:
                if run(node[0]) == retried:
                    return retried
                times += 1
            return not retried
        trace.append(kind)
        for result in results:
            return result
        raise _ScriptError

    try:
        return trace, run(trees["Main"])
    except _ScriptError:
        return trace[:-1], None


def walked(net: Net, kinds: Any, script: Sequence[bool]) -> Trace:
    """Return what a robot does in the net.

    :param kinds: place -> the kind of its leaf.
    """
    trace: List[str] = []
    marking = net.initial_marking
    for result in script:
        (place,) = net.named(marking, zeros=False)
        if place in (SUCCESS_PLACE, FAILURE_PLACE):
            break
        trace.append(kinds[place])
        word = ON_SUCCESS if result else ON_FAILURE
        marking = net.fire(marking, net.transition_number(place + word))
    (place,) = net.named(marking, zeros=False)
    return trace, {SUCCESS_PLACE: True, FAILURE_PLACE: False}.get(place)


def kinds_of(plan: Any) -> Any:
    """Place -> the kind of its leaf, of the object of a plan."""
    return {
        place: action["settings"]["node"] for place, action in plan["actions"].items() if action
    }
