"""Builds the plan of a behaviour tree or a state machine from its leaves, which robots run.

A robot's token is in the place of the leaf that it runs. Each leaf has a transition for each of its
outcomes, which leads to the leaf that comes next, or to a place in which the robot ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.making.plan_folder import write_plan_folder
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import InputError
from gspn_framework_package.model.marking_function import quoted_place
from gspn_framework_package.model.net import Net

MOST_LEAVES = 5_000
"""Maximum number of places; repetitions and subtrees multiply."""

MOST_TREE_NODES = 100_000
"""Maximum number of nodes, including those that run no action."""


class Target:
    """Where an arc goes.

    :ivar name: the name of a place; "" until it is known.
    """

    def __init__(self, name: str = "") -> None:
        self.name = name
        self._other: Optional[Target] = None

    def lead_to(self, other: Target) -> None:
        """Say where it goes."""
        self._other = other

    def place(self) -> str:
        """Return the name of the place; "" if it only leads back to itself."""
        seen, target = set(), self
        while target._other is not None:
            if id(target) in seen:
                return ""
            seen.add(id(target))
            target = target._other
        return target.name


@dataclass
class Leaf:
    """A leaf: ``here`` leads to its place, whose name is ``wanted``, perhaps with a number.

    ``outcomes``: suffix that turns the place's name into the transition's -> where the transition
    leads. ``failure`` is the one of them that fires if the action fails, if there is one.
    """

    here: Target
    wanted: str
    action: Any
    outcomes: Mapping[str, Target]
    failure: Optional[str] = None
    file: Optional[str] = None
    line: Optional[int] = None
    timeout: Optional[float] = None

    @property
    def place(self) -> str:
        """The name of its place."""
        return self.here.name


class ImportedPlan(NamedTuple):
    """A plan made of a tree or machine of another tool: its ``net``, the ``plan`` object without
    it, further ``files`` of its folder (name -> text), what ``actions.py`` does (``actions``, in
    words), and ``notes`` for people."""

    net: Net
    plan: Dict[str, Any]
    files: Dict[str, str]
    actions: str
    notes: List[str]

    def write(self, folder: str) -> List[str]:
        """Write the plan into a new folder; see
        :func:`~gspn_framework_package.making.plan_folder.write_plan_folder`."""
        return write_plan_folder(folder, self.net, self.plan, None, self.files)


def name_places(leaves: Sequence[Leaf], ends: Sequence[str]) -> None:
    """Name the places after the leaves, with a number where several have the same name."""
    taken = set(ends)
    for leaf in leaves:
        wanted = " ".join(leaf.wanted.split())  # names from other tools may contain line breaks
        name, number = wanted, 1
        while name in taken:
            number += 1
            name = "%s %d" % (wanted, number)
        taken.add(name)
        leaf.here.name = name


def plan_of_leaves(
    name: str,
    description: str,
    leaves: Sequence[Leaf],
    begins: Target,
    ends: Sequence[str],
    robots: int,
) -> Tuple[Net, Dict[str, Any]]:
    """The net and the plan object for a number of robots, each of which runs the leaves on its own.

    :param description: what it is, such as ``behaviour tree 'Main'``.
    :param leaves: in the order of the places.
    :param begins: leads to the first leaf.
    :param ends: the places in which a robot ends.
    :raises InputError: no leaf comes first, or the tree repeats for ever a part that runs none.
    """
    name_places(leaves, ends)
    start = begins.place()
    if start in ("", *ends):
        raise InputError(
            "the %s begins with no action" % description,
            hint="a robot starts in an action: put one before the node that ends at once",
        )
    net = NetBuilder(name)
    for leaf in leaves:
        net.place(leaf.place, robots if leaf.place == start else 0)
    for end in ends:
        net.place(end)
    for leaf in leaves:
        for word, target in leaf.outcomes.items():
            if not target.place():
                raise InputError(
                    "after '%s' it repeats for ever a part that runs no action" % leaf.place,
                    file=leaf.file,
                    line=leaf.line,
                )
            net.exponential(leaf.place + word, 1.0, None, leaf.place, target.place())
    failing = [leaf for leaf in leaves if leaf.failure is not None]
    plan: Dict[str, Any] = {
        "plan": name,
        "description": "The %s, for %d robot%s."
        % (description, robots, "" if robots == 1 else "s"),
        "actions": {**{leaf.place: leaf.action for leaf in leaves}, **dict.fromkeys(ends)},
        "robots": {"robot_%d" % (n + 1): start for n in range(robots)},
        "spawn": [start],
        "on_failure": {leaf.place: "fire %s%s" % (leaf.place, leaf.failure) for leaf in failing},
        "timeout": {leaf.place: leaf.timeout for leaf in failing if leaf.timeout is not None},
        "until": "%s >= %d" % (" + ".join(map(quoted_place, ends)), robots),
    }
    return net.build(), plan
