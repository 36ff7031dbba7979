"""A computed policy on the server, which the page loads in parts and saves.

A policy may have tens of thousands of rows. The server keeps the new plan as text; a browser gets
only the rows that it shows.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import threading
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

from gspn_framework_package.analysis.decisions.report import MarkingChoice
from gspn_framework_package.formats.json_file import json_text
from gspn_framework_package.formats.plan_file import looks_like_plan
from gspn_framework_package.formats.plan_json import plan_from_json
from gspn_framework_package.formats.source import write_bytes
from gspn_framework_package.model.errors import InputError, RefusedError, UsageError
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.run_net.compiling import compile_plan
from gspn_framework_package.run_net.run_net import RunNet

ROWS_PER_PART = 500
"""Largest number of rows of a policy that the page gets at once."""

PROPOSALS = 1000
"""Number of names to try for a new file."""


class ExistsError(RefusedError):
    """A file exists, and nobody has confirmed that it may be replaced."""


class PolicyChanges:
    """Which rows of a computed policy choose differently from the present one.

    :ivar changed: numbers of the rows that apply in a listed marking where the two differ.
    :ivar same: numbers of the other rows that apply in a listed marking.
    """

    def __init__(self, plan: Plan, choices: Sequence[MarkingChoice]) -> None:
        table, net = plan.policy.bind(plan.net), plan.net
        applied: Dict[int, bool] = {}
        for choice in choices:
            marking = [choice.marking.get(place.name, 0) for place in net.places]
            found = table.distribution(marking, net.place_index[choice.place])
            if found is not None:
                differs = dict(choice.present) != dict(choice.best)
                applied[found.row] = applied.get(found.row, False) or differs
        self.changed = sorted(row for row, differs in applied.items() if differs)
        self.same = sorted(row for row, differs in applied.items() if not differs)


class Optimised:
    """A plan with a computed policy.

    :param present: the plan that it was computed for.
    :param data: the new plan as a JSON object.
    :param changed: numbers of the rows that choose differently from the present policy.
    :param same: numbers of rows that make the same choice. For other rows, this is unknown.
    """

    def __init__(
        self, present: Plan, data: Mapping[str, Any], changed: List[int], same: List[int]
    ) -> None:
        self._present = present
        self.text = json_text(data)
        self._places = data.get("policy", {}).get("places", [])
        self._rows = data.get("policy", {}).get("rows", [])
        self._states = {**dict.fromkeys(same, False), **dict.fromkeys(changed, True)}
        others = (row for row in range(len(self._rows)) if not self._states.get(row))
        self._order = [*changed, *others]
        self._lock = threading.Lock()
        self._rules: Optional[Tuple[RunNet, RunNet]] = None

    def rows(self, start: int, count: int) -> Dict[str, Any]:
        """Some rows of the new policy, those that differ from the present one first.

        :returns: ``places``, ``total``, the number ``changed``, and ``rows``, each with its
            ``number`` in the file (from 1), its ``marking``, what it may ``choose``, and whether it
            ``differs`` (None: unknown).
        """
        return {
            "places": self._places,
            "total": len(self._rows),
            "changed": sum(self._states.values()),
            "rows": [
                {"number": row + 1, "differs": self._states.get(row), **self._rows[row]}
                for row in self._order[start : start + min(count, ROWS_PER_PART)]
            ],
        }

    def choices(self, marking: Mapping[str, int]) -> List[Dict[str, Any]]:
        """What robots do in each place of a marking where they have a choice: transition ->
        probability under the ``present`` and under the ``best`` policy; empty if they wait.

        :param marking: tokens by place.
        :raises RefusedError: the marking is of another net.
        """
        if set(marking) != set(self._present.net.place_index):
            raise RefusedError("this policy was computed for a net other than the one shown")
        with self._lock:
            if self._rules is None:
                new = plan_from_json(json.loads(self.text))
                self._rules = compile_plan(self._present, None), compile_plan(new, None)
            present, best = self._rules
            counts = tuple(marking[place.name] for place in present.net.places)
            enabled = {
                t
                for t, transition in enumerate(present.net.transitions)
                if not transition.timed and present.net.is_enabled(counts, t)
            }
            return [
                {
                    "place": place.name,
                    "present": _drawn(present, counts, p, enabled),
                    "best": _drawn(best, counts, p, enabled),
                }
                for p, place in enumerate(present.net.places)
                if present.acts[p] and counts[p] and enabled & set(present.net.consumers[p])
            ]


def _drawn(rules: RunNet, marking: Tuple[int, ...], p: int, enabled: Any) -> Dict[str, float]:
    return {
        rules.net.transitions[t].name: probability
        for t, probability in rules.draws.of(marking, p, enabled)
        if t in enabled
    }


def proposed_name(plan_file: str) -> str:
    """An unused file name for a new plan next to ``plan_file``."""
    folder, name = os.path.split(plan_file)
    stem = os.path.splitext(name)[0] + "_optimised"
    for number in range(1, PROPOSALS):
        found = stem + ("_%d" % number if number > 1 else "") + ".json"
        if not os.path.lexists(os.path.join(folder, found)):
            return found
    return stem + ".json"


def save_beside(plan_file: str, name: object, text: str, overwrite: bool) -> str:
    """Write a plan next to another, completely or not at all.

    :param plan_file: the plan that is open; it is never replaced.
    :param name: the name of the new file.
    :param overwrite: whether another plan of that name may be replaced.
    :returns: the path of the new file.
    :raises UsageError: that is not a valid name of a plan file.
    :raises ExistsError: a plan of that name exists, and ``overwrite`` is not set.
    :raises RefusedError: the file exists and is not a plan, or it is the plan that is open.
    :raises InputError: the file cannot be written.
    """
    if not isinstance(name, str) or not re.fullmatch(r"\w[\w .+-]{0,119}\.json", name):
        raise UsageError(
            "that is not the name of a plan file",
            hint="letters, digits, '_', '-' and '.', ending in .json",
        )
    path = os.path.join(os.path.dirname(plan_file), name)
    if os.path.realpath(path) == os.path.realpath(plan_file):
        raise RefusedError("that is the plan that is open", hint="choose another name", file=name)
    reserved = False
    try:
        with contextlib.suppress(FileExistsError), open(path, "xb"):
            reserved = True  # nobody else can take the name after this
    except OSError as error:
        raise InputError("cannot write it: %s" % error.strerror, file=name) from None
    if not reserved:
        if not os.path.isfile(path) or not looks_like_plan(path):
            raise RefusedError(
                "it exists, and it is not a plan", hint="choose another name", file=name
            )
        if not overwrite:
            raise ExistsError("it exists already", hint="choose another name", file=name)
    try:
        write_bytes(path, text.encode())
    except InputError as error:
        if reserved:
            with contextlib.suppress(OSError):
                os.unlink(path)
        error.file = name
        raise
    return path
