"""Each field of a replica's state is documented, and is written by one part alone, as its source
says."""

from __future__ import annotations

import ast
import glob
import inspect
import os
import re
from typing import Dict, Iterator, List, Optional, Set, Tuple

import pytest

from gspn_framework_package.execution import agreement
from gspn_framework_package.execution.agreement.peers import Peer, Peers
from gspn_framework_package.execution.agreement.recent_slots import RecentSlots
from gspn_framework_package.execution.agreement.state import OWNERS, ReplicaState, Waiting
from gspn_framework_package.execution.ledger import Ledger

FOLDER = os.path.dirname(inspect.getsourcefile(agreement) or "")
MODULES = sorted(os.path.basename(p)[:-3] for p in glob.glob(os.path.join(FOLDER, "*.py")))

OF_CONTAINERS = {
    *("append", "appendleft", "extend", "insert", "sort", "reverse", "popleft"),
    *("add", "discard", "remove", "clear", "pop", "popitem", "update", "setdefault"),
    *("difference_update", "intersection_update", "symmetric_difference_update"),
}
"""Methods that change a list, a set, a dict or a deque."""

NO_CHANGE = {"get"}
"""``Peers.get`` makes room for a robot of which nothing is known, which changes no answer."""


def _methods_that_change(owner: type) -> Set[str]:
    """The methods of a class that change an object of it."""
    (tree,) = ast.parse(inspect.getsource(owner)).body
    assert isinstance(tree, ast.ClassDef)
    methods = {f.name: f for f in tree.body if isinstance(f, ast.FunctionDef)}
    found = {
        name for name, f in methods.items() if any(_written(f, "self", OF_CONTAINERS))
    } - NO_CHANGE
    while True:  # and those that call one of these
        more = {
            name
            for name, f in methods.items()
            if any(_written(f, "self", OF_CONTAINERS | found, calls=True))
        }
        more -= NO_CHANGE
        if more <= found:
            return found - {"__init__"}
        found |= more


def _root(node: ast.expr, state: str, aliases: Dict[str, str]) -> Optional[str]:
    """The field of the state that an expression reaches into; "" for the state itself, None for
    neither."""
    path: List[str] = []
    while True:
        if isinstance(node, ast.Name):
            if node.id == state:
                return path[-1] if path else ""
            field = aliases.get(node.id)
            return path[-1] if field == "" and path else field
        if isinstance(node, ast.Attribute):
            if (
                node.attr == "state"
                and state == "state"
                and isinstance(node.value, ast.Name)
                and node.value.id == "self"
            ):
                return path[-1] if path else ""
            path.append(node.attr)
            node = node.value
        elif isinstance(node, ast.Subscript):
            node = node.value
        elif (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Attribute)
            and node.func.attr == "get"
        ):
            node = node.func.value  # what a dict, or Peers, holds
        else:
            return None


def _aliases(function: ast.AST, state: str) -> Dict[str, str]:
    """Names of a function that stand for (a part of) a field."""
    found: Dict[str, str] = {}
    for node in ast.walk(function):
        if not isinstance(node, ast.Assign):
            continue
        for target in node.targets:
            pairs = [(target, node.value)]
            if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                pairs = list(zip(target.elts, node.value.elts))
            for name, value in pairs:
                if isinstance(name, ast.Name):
                    field = _root(value, state, found)
                    if field is not None:
                        found[name.id] = field
    return found


def _flat(target: ast.expr) -> Iterator[ast.expr]:
    if isinstance(target, (ast.Tuple, ast.List)):
        for element in target.elts:
            yield from _flat(element)
    else:
        yield target.value if isinstance(target, ast.Starred) else target


def _written(
    function: ast.AST, state: str, changing: Set[str], calls: bool = False
) -> Iterator[Tuple[str, int]]:
    """The fields that a function writes: (field, line). ``calls``: methods of the object itself
    count."""
    aliases = _aliases(function, state)
    for node in ast.walk(function):
        targets: List[ast.expr] = []
        if isinstance(node, (ast.Assign, ast.Delete)):
            targets = list(node.targets)
        elif isinstance(node, (ast.AugAssign, ast.AnnAssign, ast.For)):
            targets = [node.target]
        elif isinstance(node, ast.With):
            targets = [item.optional_vars for item in node.items if item.optional_vars is not None]
        for target in [t for given in targets for t in _flat(given)]:
            if isinstance(target, ast.Name):
                if isinstance(node, ast.AugAssign) and target.id in aliases:
                    yield aliases[target.id], node.lineno
                continue
            field = _root(target, state, aliases)
            if field or (calls and field == ""):
                yield field, node.lineno
        method = None
        if isinstance(node, ast.Attribute) and node.attr in changing:  # called, or handed on to be
            method = _root(node.value, state, aliases)
        if method or (calls and method == ""):
            yield method, node.lineno


CHANGING = OF_CONTAINERS.union(
    *(_methods_that_change(c) for c in (Ledger, RecentSlots, Peers, Peer, Waiting))
)


def _writes(source: str) -> List[Tuple[str, int]]:
    """The fields of the state that a module writes."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef):
            found.update(_written(node, "state", CHANGING))
    return sorted(found)


def _source(module: str) -> str:
    with open(os.path.join(FOLDER, module + ".py"), encoding="utf-8") as file:
        return file.read()


def test_what_changes_an_object_is_found() -> None:
    assert {"append", "restore"} <= _methods_that_change(Ledger)
    assert {"is_news", "snapshot", "is_cast_out"}.isdisjoint(_methods_that_change(Ledger))
    assert _methods_that_change(Peers) == {"hear", "listen_anew"}
    assert _methods_that_change(Peer) == {"note_life"}
    assert _methods_that_change(RecentSlots) == {"add", "clear"}


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("self.state.off = {}", "off"),
        ("state.off = {}", "off"),
        ("self.state.off[robot] = 1", "off"),
        ("del self.state.off[robot]", "off"),
        ("self.state.number += 1", "number"),
        ("a, self.state.number = 1, 2", "number"),
        ("self.state.votes.clear()", "votes"),
        ("self.state.votes.setdefault(ballot, set())", "votes"),
        ("self.state.peers.get(robot).length = 3", "peers"),
        ("peer = self.state.peers.get(robot)\n    peer.length = 3", "peers"),
        ("state, me = self.state, 1\n    peers = state.peers\n    peers.known[me] = ''", "peers"),
        ("followers = state.followers\n    followers |= {1}", "followers"),
        ("add = state.strangers.add\n    add('x')", "strangers"),
        ("state.ledger.append(items)", "ledger"),
        ("state.ledger.cast_out.clear()", "ledger"),
        ("state.ledger.state.robots.pop('r1')", "ledger"),
        ("state.recent.add(1, b, [], '')", "recent"),
        ("for state.number in range(3): pass", "number"),
        ("mine = self.state\n    mine.number = 1", "number"),
    ],
)
def test_a_write_is_found(text: str, field: str) -> None:
    assert [f for f, _ in _writes("def f(self, state):\n    %s\n" % text)] == [field]


@pytest.mark.parametrize(
    "text",
    [
        "x = self.state.off",
        "off = dict(self.state.off)\n    off['x'] = 1",
        "x = [self.state.peers.get(m).length for m in []]",
        "self.log.begin_anew()",
        "held = state.held_orders",
    ],
)
def test_reading_is_no_write(text: str) -> None:
    assert not _writes("def f(self, state):\n    %s\n" % text)


@pytest.mark.long
@pytest.mark.parametrize("module", MODULES)
def test_only_its_owner_writes_a_field(module: str) -> None:
    foreign = [
        "line %d: %s, of %s" % (line, f, OWNERS[f])
        for f, line in _writes(_source(module))
        if OWNERS[f] != module
    ]
    assert not foreign


def test_every_field_has_an_owner_that_writes_it() -> None:
    written = {(module, field) for module in MODULES for field, _ in _writes(_source(module))}
    for field, owner in OWNERS.items():
        assert owner in MODULES, field
        assert (owner, field) in written, "%s never writes %s" % (owner, field)


def test_every_field_is_documented() -> None:
    (tree,) = ast.parse(inspect.getsource(ReplicaState)).body
    assert isinstance(tree, ast.ClassDef)
    for node, after in zip(tree.body, tree.body[1:]):
        if isinstance(node, ast.AnnAssign):
            assert isinstance(after, ast.Expr), ast.dump(node.target)
            assert isinstance(ast.literal_eval(after.value), str), ast.dump(node.target)


@pytest.mark.parametrize("module", MODULES)
def test_no_part_looks_into_another(module: str) -> None:
    """What begins with an underscore is used through ``self`` only."""
    inner = [
        "line %d: %s" % (node.lineno, node.attr)
        for node in ast.walk(ast.parse(_source(module)))
        if isinstance(node, ast.Attribute)
        and node.attr.startswith("_")
        and node.attr not in ("_replace", "_asdict", "_fields")
        and not (isinstance(node.value, ast.Name) and node.value.id == "self")
    ]
    assert not inner


@pytest.mark.parametrize("module", MODULES)
def test_every_module_says_what_it_is_for(module: str) -> None:
    text = " ".join((ast.get_docstring(ast.parse(_source(module))) or "").split())
    assert len(text) > 60
    if module in OWNERS.values():
        assert "owns " in text.lower()


def _table_of_parts() -> Dict[str, Tuple[Set[str], Set[str]]]:
    """Of each part, as docs/agreement.md has it: the fields that it writes, and the parts that it
    calls."""
    with open(
        os.path.join(os.path.dirname(__file__), "../../../docs/agreement.md"), encoding="utf-8"
    ) as file:
        rows = [line.strip(" |\n").split("|") for line in file if line.startswith("| `")]
    found = {}
    for cells in rows:
        if len(cells) == 4 and cells[0].strip(" `") in MODULES:
            calls = {name.strip().replace(" ", "_") for name in cells[3].split(",")}
            found[cells[0].strip(" `")] = (set(re.findall(r"`(\w+)`", cells[2])), calls)
    return found


def test_the_documentation_names_the_owner_of_each_field() -> None:
    table = _table_of_parts()
    assert {field: part for part, (fields, _) in table.items() for field in fields} == OWNERS


def test_the_documentation_names_whom_each_part_calls() -> None:
    names = {"robot": "local_robot"}
    parts = {*_table_of_parts(), "breaks", "log", "robot"}
    for part, (_, calls) in _table_of_parts().items():
        if part == "replica":
            continue
        known = {
            names.get(node.attr, node.attr)
            for node in ast.walk(ast.parse(_source(part)))
            if isinstance(node, ast.Attribute)
            and isinstance(node.value, ast.Name)
            and node.value.id == "self"
            and node.attr in parts - {"config", "state"}
        }
        said = {"log" if "Log`" in call else call for call in calls} - {"nobody"}
        assert said == known, part
