"""Makes a plan of a state machine of SMACH.

The plan's actions execute the states of the file's own machine, except where a SimpleActionState
calls an action server with the same goal each time: there the plan calls the server.
"""

from __future__ import annotations

import json
from typing import Any, Callable, Dict, List, Mapping, Set, Tuple

from gspn_framework_package.making.leaf_plan import (
    MOST_LEAVES,
    ImportedPlan,
    Leaf,
    Target,
    plan_of_leaves,
)
from gspn_framework_package.model.errors import InputError
from gspn_framework_package.model.outcome import Outcome

_SEPARATOR = ": "
"""Separates the place of a state from its outcome in the name of a transition."""

_State = Mapping[str, Any]
_Path = Tuple[str, ...]
_Exit = Callable[[str], Target]
"""Where each outcome of a state leads."""


def plan_of_machine(file: str, name: str, root: _State, robots: int) -> ImportedPlan:
    """Make a plan of a machine.

    :param file: the name of the file that makes it.
    :param name: the function in it that makes the machine, or the variable that holds it.
    :param root: the machine, as :mod:`gspn_framework_package.formats.smach_machine` describes it.
    :raises InputError: a plan cannot express it.
    """
    made = _Machine()
    if "states" not in root:
        why = "the whole machine would be one action"
        raise _refused(root, (), "%s: %s" % (why, root["why"]) if root["why"] else why)
    ends = {outcome: Target(outcome) for outcome in root["outcomes"]}
    begins = made.enter(root, (), ends.__getitem__)
    made.follow()
    net, plan = plan_of_leaves(
        name, "state machine '%s'" % name, made.leaves, begins, list(ends), robots
    )
    made.name_outcomes()
    text = _ACTIONS % {
        "file": json.dumps(file),
        "name": json.dumps(name),
        "separator": _SEPARATOR,
    }
    notes = made.notes
    if made.keys:
        notes.append(
            "userdata stays in each robot's own machine, and is not data of the plan: %s"
            % ", ".join(sorted(made.keys))
        )
    says = "actions.py executes the states of original/%s" % file
    return ImportedPlan(net, plan, {"actions.py": text}, says, notes)


def _refused(state: _State, path: _Path, why: str) -> InputError:
    file, line = state["line"] or (None, None)
    return InputError(why, file=file, line=line, element=_describe(state, path))


def _describe(state: _State, path: _Path) -> str:
    return "%s '%s'" % (state["class"], ".".join(path)) if path else str(state["class"])


class _Machine:
    def __init__(self) -> None:
        self.leaves: List[Leaf] = []
        self.notes: List[str] = []
        self.keys: Set[str] = set()
        self._to_follow: List[Tuple[Leaf, Dict[str, str], _Exit]] = []

    def enter(self, state: _State, path: _Path, leads: _Exit) -> Target:
        """Return where a state begins. Its outcomes are followed later, since states lead back."""
        self.keys.update(state["keys"])
        if "states" not in state:
            return self._leaf(state, path, leads)
        if "inconsistent" in state:
            raise _refused(state, path, state["inconsistent"])
        if state["callbacks"]:
            self._note(state, path, "its callbacks are not called")
        if "items" in state:
            return self._iterator(state, path, leads)
        begun: Dict[str, Target] = {}

        def begin(label: str) -> Target:
            if label not in begun:
                begun[label] = Target()  # known before: an Iterator without items leads on at once
                inner = state["states"][label]
                begun[label].lead_to(
                    self.enter(inner, (*path, label), lambda outcome: after(label, outcome))
                )
            return begun[label]

        def after(label: str, outcome: str) -> Target:
            target = state["transitions"][label].get(outcome)
            if target in state["states"]:
                return begin(target)
            return self._end(state, path, target if target in state["outcomes"] else outcome, leads)

        return begin(state["initial"])

    def _iterator(self, state: _State, path: _Path, leads: _Exit) -> Target:
        """Unfold an Iterator: its state occurs once for each item."""
        begun: Dict[int, Target] = {}
        ((label, inner),) = state["states"].items()

        def end(outcome: str) -> Target:
            return self._end(state, path, state["outcome_of"].get(outcome, outcome), leads)

        def begin(item: int) -> Target:
            if item == state["items"]:
                return end(state["exhausted"])
            if item not in begun:
                begun[item] = self.enter(
                    inner,
                    (*path, label),
                    lambda outcome: end(outcome) if outcome in state["breaks"] else begin(item + 1),
                )
            return begun[item]

        return begin(0)

    def _end(self, state: _State, path: _Path, outcome: str, leads: _Exit) -> Target:
        if outcome not in state["outcomes"]:
            why = "it can end with '%s', which is not one of its outcomes" % outcome
            raise _refused(state, path, why)
        return leads(outcome)

    def _leaf(self, state: _State, path: _Path, leads: _Exit) -> Target:
        if len(self.leaves) >= MOST_LEAVES:
            raise _refused(state, path, "the machine has more than %d states" % MOST_LEAVES)
        if state["why"]:
            self._note(state, path, "it is one action, with everything in it: " + state["why"])
        if not state["outcomes"]:
            raise _refused(state, path, "it has no outcome")
        called, outcomes = state["action"], {each: each for each in state["outcomes"]}
        file, line = state["line"] or (None, None)
        leaf = Leaf(Target(), ".".join(path), {}, {}, None, file, line)
        if called is None:
            leaf.action = {"function": "actions.State", "settings": {"path": list(path)}}
        else:
            leaf.action = {key: called[key] for key in ("server", "type", "goal")}
            leaf.failure = _SEPARATOR + Outcome.ABORTED.value
            leaf.timeout = called["timeout"]
            del outcomes[Outcome.PREEMPTED.value]  # a robot that is cancelled goes elsewhere
        self.leaves.append(leaf)
        self._to_follow.append((leaf, outcomes, leads))
        return leaf.here

    def follow(self) -> None:
        """Find where the outcomes of all leaves lead."""
        for leaf, outcomes, leads in self._to_follow:  # which grows
            leaf.outcomes = {_SEPARATOR + each: leads(each) for each in outcomes}

    def name_outcomes(self) -> None:
        """Say which transitions the outcomes of action servers fire, once places have names."""
        for leaf in self.leaves:
            if "server" in leaf.action:
                aborted = leaf.place + _SEPARATOR + Outcome.ABORTED.value
                leaf.action["outcomes"] = {
                    Outcome.SUCCEEDED.value: leaf.place + _SEPARATOR + Outcome.SUCCEEDED.value,
                    Outcome.ABORTED.value: aborted,
                    Outcome.REJECTED.value: aborted,
                    Outcome.PREEMPTED.value: aborted,
                }

    def _note(self, state: _State, path: _Path, what: str) -> None:
        file, line = state["line"] or (None, None)
        note = "%s:%s: %s: %s" % (file, line, _describe(state, path), what)
        self.notes += [] if note in self.notes else [note]


_ACTIONS = '''\
"""Executes the states of the machine that ``original/`` makes, each robot those of its own."""

import os
import threading

from gspn_framework_package.formats.python_root import load_root
from gspn_framework_package.formats.smach_machine import MachineRun

FILE = os.path.join(os.path.dirname(os.path.abspath(__file__)), "original", %(file)s)
NAME = %(name)s

_runs, _lock = {}, threading.Lock()


def run_of(robot):
    """The robot's own machine, made when it is first needed."""
    with _lock:
        if robot not in _runs:
            _runs[robot] = MachineRun(load_root(FILE, NAME, "file_of_" + robot)[1])
        return _runs[robot]


class State:
    """Executes a state, and names the transition of its outcome."""

    def __init__(self, path):
        self.path = tuple(path)

    def __call__(self, place, robot, is_cancelled):
        """Execute it."""
        outcome = run_of(robot).execute(self.path, is_cancelled.on_cancel)
        return place + "%(separator)s" + outcome
'''
