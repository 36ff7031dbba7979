"""Reader for the two input forms of the thesis, unmodified (4.1.3 standalone, 4.3.6 ROS).

In files written for the thesis, values are JSON strings with Python literals
(``"{'p1': ['ExecGSPN', 'action_server_1']}"``, ``"('p1','p2')"``, ``"True"``). Policy cells are
numbers, numeric strings or ``'-'``. Paths are absolute paths of a machine that no longer exists; if
a path does not exist, the reader looks for the same name beside the input file.

Such files also have entries for illustration that the thesis's framework ignored: policy rows that
name an exponential or unknown transition, and actions of resource places or unknown places. The
reader leaves them out, each with a note.
"""

from __future__ import annotations

import ast
import os
from typing import Any, Dict, FrozenSet, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.formats.plan_json import deal_robots
from gspn_framework_package.formats.registry import read_net_with_notes
from gspn_framework_package.formats.source import is_inside
from gspn_framework_package.model.action import (
    EXEC_GSPN,
    Action,
    FunctionAction,
    ServerAction,
    server_name,
)
from gspn_framework_package.model.errors import PlanError, PolicyError
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan, Synchronisation
from gspn_framework_package.model.policy import Policy, PolicyRow
from gspn_framework_package.model.policy_cell import CountTest

CLIENTS = "place_to_client_mapping"
_FUNCTIONS = "place_to_function_mapping"

ROS_KEYS = (
    "gspn",
    CLIENTS,
    "resources_list",
    "places_tuple",
    "policy_dictionary",
    "full_synchronization",
)
STANDALONE_KEYS = ("project_path", "gspn", _FUNCTIONS, "places_tuple", "policy_dictionary")


class ThesisNet(NamedTuple):
    """The net of an input file, and notes on how it was read."""

    net: Net
    notes: Tuple[str, ...]


def is_thesis_input(data: Mapping[str, Any]) -> bool:
    """Whether a JSON object has one of the two forms, judged by keys that only they have."""
    return CLIENTS in data or _FUNCTIONS in data or "gspn" in data and "net" not in data


def has_mapping(data: Mapping[str, Any]) -> bool:
    """Whether an input file maps any place to an action. A file without such a mapping stands for
    its net (5.3: viewing a GSPN needs neither a mapping nor a policy)."""
    return any(data.get(key) not in (None, "", "{}", {}, "None") for key in (CLIENTS, _FUNCTIONS))


def net_from_thesis(data: Mapping[str, Any], path: str, within: Optional[str] = None) -> ThesisNet:
    """Read only the net of an input file, and ignore its actions and policy.

    :param within: the folder that its files have to be in; None: they may be anywhere.
    :raises PlanError: the file does not name an existing net.
    :raises InputError: the net cannot be read.
    """
    reader = _Reader(data, path, ("gspn",), within)
    net, notes = _read_net(reader, "project_path" in data)
    return ThesisNet(net, tuple(notes + reader.notes))


def net_file(data: Mapping[str, Any], path: str, within: Optional[str] = None) -> str:
    """Return the path of the file of the net. :raises PlanError: there is none."""
    return _net_file(_Reader(data, path, ("gspn",), within), "project_path" in data)


def plan_from_thesis(data: Mapping[str, Any], path: str, within: Optional[str] = None) -> Plan:
    """Return the plan of an input file of the thesis. Such a file does not name the robots, so they
    are assigned to the action places by the initial marking, in the order of ``places_tuple``. The
    seed is 0.

    :param within: see :func:`net_from_thesis`.
    :raises PlanError: a key is missing, or a value cannot be read.
    """
    is_ros = CLIENTS in data or _FUNCTIONS not in data and "project_path" not in data
    keys = ROS_KEYS if is_ros else STANDALONE_KEYS
    reader = _Reader(data, path, keys, within)
    reader.leave_out_unknown(keys)
    net, notes = _read_net(reader, not is_ros)
    places = reader.names("places_tuple")
    policy = Policy.from_table(places, reader.policy_rows())
    _refuse_tests(policy)
    policy = _without_illustrations(policy, net, reader.notes)
    if is_ros:
        resources = frozenset(
            reader.places_of(net, reader.names("resources_list"), "resources_list")
        )
        actions = {p: reader.client(p, value) for p, value in reader.mapping(CLIENTS)}
        full = reader.flag("full_synchronization")
    else:
        resources = frozenset()
        actions = {p: reader.function(p, value) for p, value in reader.mapping(_FUNCTIONS)}
        full = True
    plan = Plan(
        net=net,
        name=os.path.splitext(os.path.basename(path))[0],
        policy=policy,
        actions=reader.actions_of(net, actions, resources, CLIENTS if is_ros else _FUNCTIONS),
        resource_places=resources,
        robots=deal_robots(net, resources, places, "robot_" if is_ros else ""),
        synchronisation=Synchronisation.FULL if full else Synchronisation.PARTIAL,
        folder=os.path.dirname(os.path.abspath(path)),
        file=path,
    )
    return plan.validate().with_notes(notes + reader.notes)


def _read_net(reader: _Reader, in_project: bool) -> Tuple[Net, List[str]]:
    return read_net_with_notes(_net_file(reader, in_project))


def _net_file(reader: _Reader, in_project: bool) -> str:
    return reader.existing(reader.text("gspn"), beside=reader.project() if in_project else "")


def _refuse_tests(policy: Policy) -> None:
    for number, row in enumerate(policy.rows, 1):
        for cell in row.counts:
            if isinstance(cell, CountTest):
                raise PolicyError(
                    "'%s' is not a number of tokens" % str(cell),
                    element="policy row %d" % number,
                    hint="only the policy of a plan.json has comparisons",
                )


def _without_illustrations(policy: Policy, net: Net, notes: List[str]) -> Policy:
    """Return the policy without choices that no robot can request, and without rows that have only
    such choices. The remaining probabilities of a row are scaled to sum to 1. Each omitted choice
    is added to ``notes``."""
    rows = []
    for number, row in enumerate(policy.rows, 1):
        kept, left_out = [], []
        for name, probability in row.choices:
            index = net.transition_index.get(name)
            if index is None:
                left_out.append("'%s', which the net does not have" % name)
            elif net.transitions[index].timed:
                left_out.append(
                    "'%s', which is exponential: a policy chooses among immediate transitions"
                    % name
                )
            else:
                kept.append((name, probability))
        total = sum(probability for _, probability in kept)
        if not left_out:
            rows.append(row)
            continue
        if total > 0:
            rows.append(
                PolicyRow(
                    row.counts, tuple((name, probability / total) for name, probability in kept)
                )
            )
        else:
            left_out.append("and so the row, which has no other choice")
        notes.append("policy row %d: left out %s" % (number, "; ".join(left_out)))
    return Policy(policy.places, rows)


class _Reader:
    """Reads an input file, whose values may be literals in strings and whose paths may not
    exist."""

    def __init__(
        self, data: Mapping[str, Any], path: str, keys: Sequence[str], within: Optional[str]
    ) -> None:
        self.data = data
        self._within = within
        self.path = path
        self.notes: List[str] = []
        self._project: Optional[str] = None
        for key in keys:
            if key not in data:
                raise PlanError(
                    "the key '%s' is missing" % key, file=path, hint="needed are " + ", ".join(keys)
                )

    def leave_out_unknown(self, keys: Sequence[str]) -> None:
        """Add a note for each key that is not among ``keys``, which is ignored."""
        for key in self.data:
            if key not in keys:
                self.notes.append("the key '%s' is not known and was left out" % key)

    def project(self) -> str:
        """Return the folder with the functions."""
        if self._project is None:
            self._project = self.existing(self.text("project_path"), folder=True)
        return self._project

    def places_of(self, net: Net, names: Sequence[str], key: str) -> List[str]:
        """Return the ``names`` that are places of the net; add a note on the others."""
        for name in names:
            if name not in net.place_index:
                self.notes.append("%s: '%s' was left out: the net has no such place" % (key, name))
        return [name for name in names if name in net.place_index]

    def actions_of(
        self, net: Net, actions: Mapping[str, Action], resources: FrozenSet[str], key: str
    ) -> Dict[str, Action]:
        """Return the ``actions`` that a robot can reach; add a note on the others."""
        there = self.places_of(net, list(actions), key)
        for place in there:
            if place in resources and actions[place] is not None:
                self.notes.append(
                    "%s: the action of '%s' was left out: that is a resource place" % (key, place)
                )
        return {place: actions[place] for place in there if place not in resources}

    def _fail(self, key: str, value: Any, wanted: str) -> PlanError:
        return PlanError("%.80r is not %s" % (value, wanted), file=self.path, element=key)

    def text(self, key: str) -> str:
        value = self.data[key]
        if not isinstance(value, str) or not value.strip():
            raise self._fail(key, value, "a path")
        return value.strip()

    def literal(self, key: str) -> Any:
        """Return the value of a key; a string is parsed as a Python literal."""
        value = self.data[key]
        if not isinstance(value, str):
            return value
        try:
            return ast.literal_eval(value.strip())
        except (ValueError, SyntaxError, MemoryError, RecursionError):
            raise self._fail(key, value, "a Python literal") from None

    def flag(self, key: str) -> bool:
        value = self.data[key]
        if isinstance(value, str):
            value = {"true": True, "false": False}.get(value.strip().lower(), value)
        if not isinstance(value, bool):
            raise self._fail(key, value, "True or False")
        return value

    def names(self, key: str) -> List[str]:
        value = self.literal(key)
        if isinstance(value, str):  # ('p1') is a string in Python, but meant as a tuple
            value = (value,)
        if not isinstance(value, (list, tuple)) or not all(isinstance(n, str) for n in value):
            raise self._fail(key, value, "a list of names")
        return list(value)

    def mapping(self, key: str) -> List[Tuple[str, Any]]:
        value = self.literal(key)
        if not isinstance(value, dict) or not all(isinstance(k, str) for k in value):
            raise self._fail(key, value, "a dictionary from places")
        return list(value.items())

    def policy_rows(self) -> List[Tuple[Sequence[object], Mapping[str, object]]]:
        value = self.literal("policy_dictionary")
        if not isinstance(value, dict):
            raise self._fail("policy_dictionary", value, "a dictionary from markings")
        return [(self._cells(marking), choices) for marking, choices in value.items()]

    def _cells(self, marking: Any) -> Sequence[object]:
        if isinstance(marking, str) and marking.strip() != "-":
            try:
                marking = ast.literal_eval(marking.strip())
            except (ValueError, SyntaxError):
                raise self._fail("policy_dictionary", marking, "a marking") from None
        return marking if isinstance(marking, (list, tuple)) else (marking,)

    def client(self, place: str, value: Any) -> Action:
        if value is None:
            return None
        if not isinstance(value, (list, tuple)) or len(value) != 2:
            raise self._fail("place_to_client_mapping", value, "[action type, server name]")
        kind, server = str(value[0]), str(value[1])
        return ServerAction(EXEC_GSPN if kind == "ExecGSPN" else _action_type(kind), server)

    def function(self, place: str, value: Any) -> Action:
        if value is None:
            return None
        if not isinstance(value, str) or "." not in value.strip("."):
            raise self._fail("place_to_function_mapping", value, "file.function")
        here = os.path.dirname(os.path.abspath(self.path))
        within = os.path.relpath(self.project(), here).replace(os.sep, "/")
        return FunctionAction(value if within == "." else within + "/" + value, server_name(place))

    def existing(self, path: str, folder: bool = False, beside: str = "") -> str:
        """Return ``path`` if it exists, else an existing path of that name in ``beside`` or in the
        folder of the input file."""

        def exists(path: str) -> bool:
            there = os.path.isdir(path) if folder else os.path.isfile(path)
            return there and (self._within is None or is_inside(path, self._within))

        here = os.path.dirname(os.path.abspath(self.path))
        if exists(path) and os.path.isabs(path):
            return path
        name = os.path.basename(path.replace("\\", "/").rstrip("/"))
        candidates = [os.path.join(d, p) for d in (beside, here) if d for p in (path, name)]
        if folder:
            candidates.append(here)
        for candidate in candidates:
            if exists(candidate):
                if os.path.isabs(path):
                    self.notes.append("%s does not exist; took %s" % (path, candidate))
                return candidate
        raise PlanError(
            "%s does not exist, and there is no %s beside the input file" % (path, name),
            file=self.path,
        )


def _action_type(kind: str) -> str:
    if "/" not in kind:
        return EXEC_GSPN.split("/")[0] + "/" + kind + ("" if kind.endswith("Action") else "Action")
    return kind
