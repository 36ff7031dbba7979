"""Finds the faults of an edited document and their places: the check of a plan for the editor.

A document may be unfinished; every fault that can be found is reported at its element.
"""

from __future__ import annotations

import copy
import os
import re
import time
from typing import (
    Any,
    Callable,
    Dict,
    Iterable,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Set,
    Tuple,
)

from gspn_framework_package.analysis.plan.edited_nets import with_losses
from gspn_framework_package.analysis.plan.witness import play_sequence
from gspn_framework_package.analysis.preflight.report import (
    CheckItem,
    PreflightReport,
    Severity,
)
from gspn_framework_package.formats.edited_document import EditedDocument, plan_of_document
from gspn_framework_package.model.errors import CancelledError, GspnError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.subnet import SEPARATOR
from gspn_framework_package.ros.check_all import check_all

FAULTS = 12
"""The maximum number of faults reported at once for a document that is not a plan yet."""

STATES_AT_LAST = 50
"""Markings visited after a timeout, to report what was not decided."""

OF_ROBOTS = {
    "actions",
    "conservative",
    "creates_robots",
    "dead_markings",
    "ends_at_once",
    "exploration",
    "never_fire",
    "resource_bounds",
    "timeless_cycle",
    "waiting",
}
"""The checks of what robots do, which are meaningless while there are no robots."""

LEVELS = {Severity.REFUSED: "error", Severity.WARNING: "warning", Severity.OK: "note"}

_Element = Dict[str, str]
"""``{"kind": place, transition, arc, row, robot or "", "name": ...}``: an arc's name is FROM>TO, a
row's its number."""


def findings(
    document: EditedDocument,
    path: str,
    root: str,
    cancel: Callable[[], bool],
    *,
    limit: int,
    seconds: float,
    standalone: bool = False,
) -> Dict[str, Any]:
    """Check a document.

    :param path: its plan file, which need not exist.
    :param root: the served folder, which its subnets may not leave.
    :param cancel: called at intervals; returns whether the answer is no longer needed.
    :param limit: largest number of markings to visit.
    :param seconds: time limit for visiting markings.
    :param standalone: the tokens are agents, not robots.
    :returns: ``findings``, whether it is ``valid`` (no errors) whether everything is ``decided``,
        its ``doubts`` (see :class:`PreflightReport`), and how many ``states`` were visited.
    :raises CancelledError: ``cancel`` returned true.
    """
    nodes = DocumentNodes(document)
    document = {**document, "plan": _with_actions(document.get("plan"))}
    try:
        plan = plan_of_document(document, path, root)
    except GspnError:
        found = list(_faults(document, path, root, cancel))
        return {"findings": found, "valid": False, "doubts": [], "decided": True, "states": 0}
    end = time.monotonic() + seconds

    def over() -> bool:
        if cancel():
            raise CancelledError("a newer check was requested")
        return time.monotonic() > end

    try:
        report = check_all(plan, limit=limit, standalone=standalone, cancel=over, seconds=0)
    except CancelledError:
        if cancel():
            raise
        least = min(limit, STATES_AT_LAST)
        report = check_all(plan, limit=least, standalone=standalone, seconds=0)
    found = [_finding("note", note, nodes.named_in(note)) for note in plan.notes]
    begun = bool(plan.robots) or standalone and any(p.tokens for p in plan.net.places)
    found += [*_loose(nodes), *_as_far_as_drawn(_of_report(report, plan, nodes), begun, nodes)]
    order = ["error", "warning", "note"]
    found.sort(key=lambda finding: order.index(finding["level"]))
    return {
        "findings": found,
        "valid": not report.refused,
        "doubts": report.doubts if begun else ["has no robots yet"],
        "decided": report.complete
        and not any(item.details.get("undecided") for item in report.items),
        "states": report.states,
    }


def _with_actions(plan: Any) -> Any:
    """The plan of a new document has no actions yet: report each place without one instead."""
    return {**plan, "actions": plan.get("actions", {})} if isinstance(plan, dict) else plan


def _finding(
    level: str,
    text: str,
    elements: List[_Element],
    hint: Optional[str] = None,
    check: str = "",
    witness: Optional[List[str]] = None,
    markings: Optional[List[Dict[str, int]]] = None,
    mend: Optional[Dict[str, Any]] = None,
) -> Dict[str, Any]:
    return {
        "level": level,
        "check": check,
        "text": text,
        "hint": hint or "",
        "elements": elements,
        "witness": witness,
        "markings": markings,
        "mend": mend,
    }


class DocumentNodes:
    """The nodes of a document by name, as far as they have valid names."""

    def __init__(self, document: EditedDocument) -> None:
        net = document.get("net")
        net = net if isinstance(net, Mapping) else {}
        self.lists: Dict[str, List[Any]] = {
            kind: found if isinstance(found, list) else []
            for kind, found in ((k, net.get(k + "s")) for k in ("place", "transition", "arc"))
        }
        self.kinds: Dict[str, str] = {
            str(node["name"]): kind
            for kind in ("transition", "place")
            for node in self.lists[kind]
            if isinstance(node, Mapping) and isinstance(node.get("name"), str)
        }

    def of(self, name: str, kind: str = "") -> Optional[_Element]:
        """The element of a node, of its subnet's place if it is inside one, or None."""
        outer = name
        while outer not in self.kinds and SEPARATOR in outer:
            outer = outer.rpartition(SEPARATOR)[0]
        if outer not in self.kinds:
            return None
        return {"kind": kind if outer == name and kind else self.kinds[outer], "name": outer}

    def all_of(self, names: Iterable[Any], kind: str = "") -> List[_Element]:
        """The elements of several nodes, each once; unknown names are ignored."""
        found: List[_Element] = []
        for name in names:
            element = self.of(str(name), kind)
            if element is not None and element not in found:
                found.append(element)
        return found

    def ends(self) -> Set[str]:
        """The names of the nodes that an arc leads to or from."""
        return {str(arc.get(key)) for arc in self.lists["arc"] for key in ("from", "to")}

    def named_in(self, text: str) -> List[_Element]:
        """The nodes named in quotes in a text."""
        return self.all_of(re.findall(r"'([^']*)'", text))

    def numbered(self, kind: str, number: str) -> Optional[_Element]:
        """The element with this index in the net's list of its kind."""
        listed = self.lists[kind]
        if not number.isdigit() or int(number) >= len(listed):
            return None
        found = listed[int(number)]
        if not isinstance(found, Mapping):
            return None
        if kind == "arc":
            return {"kind": "arc", "name": "%s>%s" % (found.get("from"), found.get("to"))}
        return {"kind": kind, "name": str(found.get("name"))}


# -- documents that are not plans yet
# ----------------------------------------------------------------


class _Place(NamedTuple):
    """Where an error is: its ``elements``, and the ``path`` of the part to leave out of the
    document to find further errors; None if unknown."""

    elements: List[_Element]
    path: Optional[Tuple[Any, ...]]


def _faults(
    document: EditedDocument, path: str, root: str, cancel: Callable[[], bool]
) -> Iterable[Dict[str, Any]]:
    """The faults of a document that is not a valid plan, found one by one: after each, the faulty
    element is left out and the rest is read again."""
    document = copy.deepcopy(document)
    reported: List[str] = []
    for _ in range(FAULTS):
        if cancel():
            raise CancelledError("a newer check was requested")
        try:
            plan_of_document(document, path, root)
            return
        except GspnError as error:
            where = _locate(error, document, path)
            error.file = error.file if error.file != path else None
            text = ": ".join(filter(None, (error.element, error.message)))
            if error.file:
                text = "%s: %s" % (error.file, text)
            if text not in reported:
                reported.append(text)
                yield _finding("error", text, where.elements, error.hint)
            if where.path is None or not _leave_out(document, where.path):
                return


def _locate(error: GspnError, document: EditedDocument, path: str) -> _Place:
    nodes = DocumentNodes(document)
    element = error.element or ""
    plan = document.get("plan")
    plan = plan if isinstance(plan, Mapping) else {}
    if error.file and os.path.realpath(error.file) != os.path.realpath(path):
        return _of_subnet(error.file, plan, os.path.dirname(path), nodes)
    found = re.match(r"(place|transition) '(.*)'$", element)
    if found:
        return _of_node(found.group(1), found.group(2), nodes)
    found = re.match(r"(?:inhibitor )?arc from '(.*)' to '(.*)'$", element)
    if found:
        return _of_arc(found.group(1), found.group(2), element.startswith("inhibitor"), nodes)
    found = re.match(r"policy row (\d+)", element)
    if found:
        row = {"kind": "row", "name": found.group(1)}
        return _Place([row, *nodes.named_in(error.message)], None)
    found = re.match(r"robot '(.*)'$", element)
    if found:
        return _Place([{"kind": "robot", "name": found.group(1)}], None)
    found = re.match(r"(\w+) of '(.*)'$", element)  # on_failure of 'P'
    if found:
        return _Place(nodes.all_of([found.group(2)]), ("plan", found.group(1), found.group(2)))
    key, _, rest = element.partition(".")
    if key in ("net", "policy"):
        return _inside(key, rest, nodes)
    if key == "robots":
        return _of_robots(rest, plan.get("robots"))
    named = _longest(rest, plan.get(key))
    elements = nodes.all_of([named]) if named else []
    return _Place(
        elements or nodes.named_in(error.message), ("plan", key, named) if named else None
    )


def _of_node(kind: str, name: str, nodes: DocumentNodes) -> _Place:
    listed = nodes.lists[kind]
    same = [i for i, n in enumerate(listed) if isinstance(n, Mapping) and n.get("name") == name]
    path = ("net", kind + "s", same[-1]) if same else None
    return _Place([{"kind": kind, "name": name}], path)


def _of_arc(source: str, target: str, inhibitor: bool, nodes: DocumentNodes) -> _Place:
    numbers = [
        i
        for i, arc in enumerate(nodes.lists["arc"])
        if isinstance(arc, Mapping)
        and (arc.get("from"), arc.get("to")) == (source, target)
        and bool(arc.get("inhibitor")) is inhibitor
    ]
    elements = [{"kind": "arc", "name": "%s>%s" % (source, target)}]
    return _Place(elements, ("net", "arcs", numbers[0]) if numbers else None)


def _inside(key: str, rest: str, nodes: DocumentNodes) -> _Place:
    """Where an error of the schema is, in the net or the policy."""
    words = rest.split(".")
    if len(words) < 2 or not words[1].isdigit():
        return _Place([], None)
    if key == "policy":
        return _Place(
            [{"kind": "row", "name": str(int(words[1]) + 1)}] if words[0] == "rows" else [], None
        )
    element = nodes.numbered(words[0][:-1], words[1]) if words[0][:-1] in nodes.lists else None
    return _Place([element] if element else [], ("net", words[0], int(words[1])))


def _of_subnet(file: str, plan: Mapping[str, Any], folder: str, nodes: DocumentNodes) -> _Place:
    """The places where the plan of a file is used as a subnet."""
    actions = plan.get("actions")
    users = [
        place
        for place, action in (actions.items() if isinstance(actions, Mapping) else ())
        if isinstance(action, Mapping)
        and isinstance(action.get("plan"), str)
        and os.path.realpath(os.path.join(folder, action["plan"])) == os.path.realpath(file)
    ]
    return _Place(nodes.all_of(users), ("plan", "actions", users[0]) if users else None)


def _of_robots(rest: str, robots: Any) -> _Place:
    if isinstance(robots, list):
        number = rest.partition(".")[0]
        robot = robots[int(number)] if number.isdigit() and int(number) < len(robots) else None
        name = robot.get("name") if isinstance(robot, Mapping) else None
    else:
        name = _longest(rest, robots)
    return _Place([{"kind": "robot", "name": str(name)}] if name else [], None)


def _longest(rest: str, members: Any) -> str:
    """The member of an object that a path begins with; keys may contain dots."""
    keys = members if isinstance(members, Mapping) else {}
    fitting = [k for k in keys if rest == k or rest.startswith((k + ".", k + ":"))]
    return max(fitting, key=len, default="")


def _leave_out(document: Any, path: Tuple[Any, ...]) -> bool:
    """Remove the element at ``path`` from a document; of a node, keep the name so that no
    references break. Return whether the element existed."""
    inside = document
    for step in path[:-1]:
        inside = inside.get(step) if isinstance(inside, dict) else None
    last = path[-1]
    if isinstance(inside, list) and isinstance(last, int) and last < len(inside):
        bare = _bare(inside[last]) if path[1] != "arcs" else None
        same = [n for n in inside if _bare(n) == bare]
        if bare is not None and len(same) == 1 and inside[last] != bare:
            inside[last] = bare
        else:
            del inside[last]
        return True
    if isinstance(inside, dict) and last in inside:
        del inside[last]
        return True
    return False


def _bare(node: Any) -> Optional[Dict[str, str]]:
    """A node reduced to its name; None if it has no valid one."""
    name = node.get("name") if isinstance(node, dict) else None
    return {"name": name} if isinstance(name, str) and name else None


# -- the report ------------------------------------------------------------------------------------


def _loose(nodes: DocumentNodes) -> Iterable[Dict[str, Any]]:
    """Visibly unfinished parts: nodes without any arc."""
    ends = nodes.ends()
    loose = [
        node["name"]
        for kind in ("place", "transition")
        for node in nodes.lists[kind]
        if node["name"] not in ends
    ]
    if loose and len(nodes.kinds) > 1:
        many = ", ... (%d in all)" % len(loose) if len(loose) > 10 else ""
        forgotten = (
            len(loose) < len(nodes.kinds) / 2
        )  # with more such nodes, the arcs have yet to be drawn
        yield _finding(
            "warning" if forgotten else "note",
            "no arc: %s%s" % (", ".join(loose[:10]), many),
            nodes.all_of(loose),
        )


def _as_far_as_drawn(
    findings: Iterable[Dict[str, Any]], begun: bool, nodes: DocumentNodes
) -> Iterable[Dict[str, Any]]:
    """The findings, without those that cannot be judged yet: on the action of a place without arcs,
    and, unless a run could have ``begun`` with a robot in it, on what robots do."""
    ends = nodes.ends()
    for found in findings:
        if found["check"] in OF_ROBOTS and not begun:
            yield {**found, "level": "note"}
        elif found["check"] == "actions" and found["elements"]:
            drawn = [each for each in found["elements"] if each["name"] in ends]
            yield {**found, "elements": drawn} if drawn else {**found, "level": "note"}
        else:
            yield found


def _of_report(
    report: PreflightReport, plan: Plan, nodes: DocumentNodes
) -> Iterable[Dict[str, Any]]:
    player: Optional[_Player] = None
    for item in report.items:
        witness: Optional[List[str]] = None
        markings: Optional[List[Dict[str, int]]] = None
        sequence = item.details.get("sequence")
        if sequence is not None and item.severity is not Severity.OK:
            player = player or _Player(plan, nodes)
            witness, markings = list(sequence), player.markings(sequence)
        yield _finding(
            LEVELS[item.severity],
            item.text,
            _elements(item, nodes),
            check=item.check,
            witness=witness,
            markings=markings,
            mend=item.details.get("mend"),
        )


def _elements(item: CheckItem, nodes: DocumentNodes) -> List[_Element]:
    details, found = item.details, []
    for key, kind in (
        ("place", "place"),
        ("transition", "transition"),
        ("grows", "place"),
        ("places", "place"),
        ("transitions", "transition"),
        ("cycle", ""),
        ("where", "place"),
        ("subnet", "place"),
    ):
        value = details.get(key)
        names = [value] if isinstance(value, str) else value or ()
        found += [e for e in nodes.all_of(names, kind) if e not in found]
    found += [{"kind": "row", "name": str(number)} for number in details.get("rows", ())]
    if "robot" in details:
        found.append({"kind": "robot", "name": str(details["robot"])})
    if not found and item.check in ("dead_markings", "dead_after_loss"):
        marked = [p for p, n in details.get("marking", {}).items() if n]
        found = nodes.all_of(marked)
    return found


class _Player:
    """Plays firing sequences in the net of a plan, including subnets and lost robots."""

    def __init__(self, plan: Plan, nodes: DocumentNodes) -> None:
        self._plan, self._nodes = plan, nodes
        self._net = with_losses(plan.net, plan, set())
        self._shown = [nodes.of(place.name) for place in plan.net.places]

    def markings(self, sequence: Sequence[str]) -> List[Dict[str, int]]:
        """The marking of the places of the document, at the start and after each firing: tokens in
        a subnet are in its place. Places without tokens are left out."""
        return [self._named(each) for each in play_sequence(self._net, sequence).markings]

    def _named(self, marking: Tuple[int, ...]) -> Dict[str, int]:
        named: Dict[str, int] = {}
        for i, (place, shown) in enumerate(zip(self._plan.net.places, self._shown)):
            if not marking[i] or shown is None or shown["kind"] != "place":
                continue
            inside = shown["name"] != place.name
            if inside and place.name in self._plan.resource_places:
                continue  # no robot
            named[shown["name"]] = named.get(shown["name"], 0) + marking[i]
        return named
