"""Takes a tree of py_trees from one tick of a leaf to the next, and finds all that it can do.

The tree's own composites and decorators say which leaf comes next. To find all that it can do, its
leaves are replaced by ones that have any outcome, so none of them runs.
"""

from __future__ import annotations

from typing import Any, Dict, Iterator, List, Optional, Tuple

TreePath = Tuple[int, ...]
"""The numbers of the children that lead to a node."""

MOST_TREE_STATES = 10_000
"""Maximum number of states of a tree."""

NEVER_RUNNING = {
    "py_trees.behaviours." + name
    for name in (
        "Success",
        "Failure",
        "BlackboardToStatus",
        "CheckBlackboardVariableExists",
        "CheckBlackboardVariableValue",
        "CheckBlackboardVariableValues",
        "CompareBlackboardVariables",
        "SetBlackboardVariable",
        "UnsetBlackboardVariable",
    )
}
"""Leaves that are never running."""

_INNER = {"py_trees.composites." + name for name in ("Sequence", "Selector", "Parallel")} | {
    "py_trees.decorators." + name
    for name in (
        "Condition",
        "FailureIsRunning",
        "FailureIsSuccess",
        "Inverter",
        "OneShot",
        "PassThrough",
        "Repeat",
        "Retry",
        "RunningIsFailure",
        "RunningIsSuccess",
        "SuccessIsFailure",
        "SuccessIsRunning",
    )
}
"""Nodes that do the same whenever they and their children are in the same state. All others are
leaves here, with all that is below them."""

_STATE = ("status", "current_child", "failures", "success", "final_status")
"""Attributes in which those nodes keep their state."""

_ALWAYS = {"Success": ("SUCCESS",), "Failure": ("FAILURE",), "Running": ("RUNNING",)}


class NoLeafError(Exception):
    """A tree runs on without ticking a leaf, or has too many states."""


class _Due:
    """What a leaf yields before its tick."""

    def __init__(self, path: TreePath) -> None:
        self.path = path


class TreeSteps:
    """A tree that stops before each tick of a leaf.

    :param root: the tree.
    :ivar due: the leaf whose tick comes next; None: the tree has ended.
    :ivar result: the status of the last leaf.
    :ivar ticks: number of ticks of the whole tree that have begun.
    """

    def __init__(self, root: Any) -> None:
        self._root = root
        self.inner: Dict[TreePath, Any] = {}
        self.leaves: Dict[TreePath, Any] = {}
        self.due: Optional[TreePath] = None
        self.result = ""
        self.ticks = 0
        self._ticking: Optional[Iterator[Any]] = None
        self._last_place = ""
        self._visit(root, ())

    def _visit(self, node: Any, path: TreePath) -> None:
        if class_name(node) in _INNER and node.children:
            self.inner[path] = node
            for number, child in enumerate(node.children):
                self._visit(child, (*path, number))
            return
        self.leaves[path] = node
        tick = self.leaf_tick(node)

        def noted() -> Iterator[Any]:
            yield _Due(path)
            for each in tick():
                self.result = node.status.name  # now: the parent may stop asking
                yield each

        node.tick = noted

    def leaf_tick(self, leaf: Any) -> Any:
        """The function that ticks a leaf."""
        return leaf.tick

    def begins_tick(self) -> None:
        """Called before each tick of the whole tree."""

    def go_on(self) -> None:
        """Tick the leaf that is due, if there is one, and go on to the next one.

        :raises NoLeafError: the tree runs on without one.
        """
        while True:
            found = self._ticking is not None
            if self._ticking is None:
                self.begins_tick()
                self.ticks += 1
                self._ticking = self._root.tick()
            for node in self._ticking:
                if isinstance(node, _Due):
                    self.due = node.path
                    return
            self._ticking = None
            if self._root.status.name != "RUNNING":
                self.due = None
                return
            if not found:
                raise NoLeafError("it is running for ever without ticking a leaf")

    def tick(self, place: str, path: TreePath) -> Tuple[str, bool]:
        """Tick the leaf that is due; return its status, and whether a tick of the whole tree ended.

        :param place: the place whose action this is. If it is asked again, because its outcome was
            not taken (after a pause, for example), the answer is the same.
        :param path: the leaf.
        :raises RuntimeError: another leaf is due.
        """
        if self.due is None:
            self.go_on()
        if self.due != path:
            if place == self._last_place:
                return self.result, False
            raise RuntimeError("the robot's tree is elsewhere: a place was left without its tick")
        begun, self._last_place = self.ticks, place
        self.go_on()
        return self.result, self.ticks > begun

    def begin_again(self) -> None:
        """Let the next step begin a tick of the whole tree."""
        self._ticking = None


def node_at(root: Any, path: TreePath) -> Any:
    """The node of a tree that a path leads to."""
    for number in path:
        root = root.children[number]
    return root


def class_name(node: Any) -> str:
    """The module and the name of a node's class."""
    return "%s.%s" % (type(node).__module__, type(node).__qualname__)


class _Imagined(TreeSteps):
    """A tree whose leaves end with given outcomes."""

    def __init__(self, root: Any) -> None:
        self.wanted: Any = None  # the outcome of the next leaf
        super().__init__(root)
        self.begun = self.state()  # at the beginning of this tick
        self.results: List[Any] = []  # of leaves since then

    def leaf_tick(self, leaf: Any) -> Any:
        def stop(status: Any) -> None:
            leaf.status = status

        def tick() -> Iterator[Any]:
            leaf.status = self.wanted
            self.results.append(self.wanted)
            yield leaf

        leaf.stop = stop
        return tick

    def begins_tick(self) -> None:
        self.begun, self.results = self.state(), []

    def state(self) -> List[Dict[str, Any]]:
        """The state of all nodes."""
        return [
            {name: vars(node)[name] for name in _STATE if name in vars(node)}
            for node in (*self.inner.values(), *self.leaves.values())
        ]

    def restore(self, state: List[Dict[str, Any]]) -> None:
        """Restore the state of all nodes."""
        for node, values in zip((*self.inner.values(), *self.leaves.values()), state):
            vars(node).update(values)
        self.begin_again()

    def key(self) -> Any:
        """The part of the tree's state that decides what it does next: the rest is set before it
        is read again."""
        assert self.due is not None
        found: List[Any] = [self.due]
        live = {
            path
            for path, node in self.inner.items()
            if self.due[: len(path)] == path or node.status.name == "RUNNING"
        }
        for path, node in (*self.inner.items(), *self.leaves.items()):
            around = path[:-1]
            if path and around in live and hasattr(self.inner[around], "policy"):  # a Parallel
                found.append(node.status)
            if path in self.inner:
                found += [node.status.name == "RUNNING", vars(node).get("final_status")]
            if path in live:
                found += [_plain(vars(node).get(name)) for name in _STATE[1:4]]
        return tuple(found)


def _plain(value: Any) -> Any:
    return getattr(value, "id", value)


def explore(root: Any) -> List[Dict[str, Any]]:
    """Return the states in which a leaf's tick comes next, the first one first: the ``path`` of the
    leaf, and ``leads``: outcome (``SUCCESS``, ``FAILURE``, ``RUNNING``) -> number of the next
    state, or how the tree ends. The tree cannot be used afterwards.

    :raises NoLeafError: it can run on without a leaf, or there are too many states.
    """
    status = type(root.status)
    tree = _Imagined(root)
    tree.go_on()
    numbers = {tree.key(): 0}
    states: List[Dict[str, Any]] = [{"path": tree.due, "leads": {}}]
    ways = [(tree.begun, tree.results)]
    for number, (begun, results) in enumerate(ways):  # which grows
        path = states[number]["path"]
        leaf = tree.leaves[path]
        kind = type(leaf).__name__ if class_name(leaf).startswith("py_trees.behaviours.") else ""
        outcomes = _ALWAYS.get(kind, ("SUCCESS", "FAILURE"))
        if kind not in _ALWAYS and class_name(leaf) not in NEVER_RUNNING:
            outcomes = (*outcomes, "RUNNING")
        for outcome in outcomes:
            tree.restore(begun)
            tree.go_on()
            for wanted in (*results, status[outcome]):
                tree.wanted = wanted
                tree.go_on()
            if tree.due is None:
                ended = "SUCCESS" if root.status == status.SUCCESS else "FAILURE"
                states[number]["leads"][outcome] = ended
                continue
            key = tree.key()
            if key not in numbers:
                if len(states) >= MOST_TREE_STATES:
                    raise NoLeafError("the tree has more than %d states" % MOST_TREE_STATES)
                numbers[key] = len(states)
                states.append({"path": tree.due, "leads": {}})
                ways.append((tree.begun, list(tree.results)))
            states[number]["leads"][outcome] = numbers[key]
    return _merged(states)


def _merged(states: List[Dict[str, Any]]) -> List[Dict[str, Any]]:
    """Merge the states from which the tree does the same, whatever the outcomes."""
    group = [0] * len(states)  # of each state
    known = 0
    while True:
        numbers: Dict[Any, int] = {}
        following = []
        for state, before in zip(states, group):
            leads = state["leads"].items()
            ends = tuple((o, group[to] if isinstance(to, int) else to) for o, to in leads)
            key = (before, state["path"], ends)
            following.append(numbers.setdefault(key, len(numbers)))
        group = following
        if len(numbers) == known:
            break
        known = len(numbers)
    merged: Dict[int, Dict[str, Any]] = {}
    for state, number in zip(states, group):
        to_groups = {
            outcome: group[to] if isinstance(to, int) else to
            for outcome, to in state["leads"].items()
        }
        merged.setdefault(number, {"path": state["path"], "leads": to_groups})
    return list(merged.values())
