"""Starter plans: each is a folder with a net, a policy, actions, tests and a README.

>>> sorted(templates_by_name())
['charge', 'deliver', 'inspect', 'patrol', 'rendezvous']
"""

from __future__ import annotations

import os
import re
import shlex
import string
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.making.plan_folder import write_plan_folder
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.errors import UsageError
from gspn_framework_package.model.net import Net

PLACES = ("A", "B", "C")
"""Default names of the places where the robots go."""

MOST_PLACES = 50
"""Maximum number of places that a template takes."""

MOST_TEMPLATE_ROBOTS = 1000
"""Maximum number of robots that a template takes."""

_FILES = os.path.join(os.path.dirname(os.path.abspath(__file__)), "template_files")
_COLUMN, _ROW = 220, 120  # of the drawing
_MOST_ORDERS = 20  # that wait
_SUBMIT = """
        for number in range(BUSY):
            self.team.submit("order", data={"address": "door %d" % number})"""


class _Draft(NamedTuple):
    """A template's description of the new plan.

    :ivar promised: transitions that fire on ROS, and places that get a token.
    :ivar words: replace ``$word`` in its files.
    """

    net: Net
    plan: Dict[str, Any]
    promised: Sequence[str]
    policy: Optional[Dict[str, Any]] = None
    words: Mapping[str, str] = {}


class _Template(NamedTuple):
    about: str
    make: Callable[[str, int, Sequence[str]], _Draft]
    robots: int
    least_robots: int = 1
    least_places: int = 0
    """0 if no places can be chosen."""


def templates_by_name() -> Dict[str, str]:
    """Return the templates: name -> one-line description."""
    return {name: template.about for name, template in _TEMPLATES.items()}


def takes_places(name: str) -> bool:
    """Whether the places of a template can be chosen."""
    return _template(name).least_places > 0


def write(
    name: str,
    folder: str,
    robots: Optional[int] = None,
    places: Optional[Sequence[str]] = None,
    plan: Optional[str] = None,
) -> List[str]:
    """Write a new plan from a template.

    :param folder: the folder to create.
    :param robots: number of robots; None for the template's default.
    :param places: names of the places where the robots go, for a template with such places.
    :param plan: the name of the plan; by default that of the folder.
    :returns: the names of the files in the folder.
    :raises UsageError: there is no such template, the folder exists, or an option does not fit.
    :raises InputError: the folder cannot be written; nothing is left behind.
    """
    template = _template(name)
    team = template.robots if robots is None else robots
    if not template.least_robots <= team <= MOST_TEMPLATE_ROBOTS:
        raise UsageError(
            "the template '%s' supports %d to %d robots, not %d"
            % (name, template.least_robots, MOST_TEMPLATE_ROBOTS, team)
        )
    if places is not None:
        _check_places(name, template, places)
    base = os.path.basename(os.path.abspath(folder))
    title = plan or base or name
    draft = template.make(title, team, tuple(places or PLACES))
    module = re.sub(r"\W", "_", base, flags=re.ASCII).lower().strip("_") or name
    words = {
        "title": title,
        "folder": shlex.quote(base),
        "module": module,
        "robots": str(team),
        "busy": str(team),
        "promised": ", ".join(map(repr, draft.promised)),
        "work": "",
        **draft.words,
    }
    files = {
        "actions.py": _fill(name + ".actions.py.txt", words),
        "test_%s.py" % module: _fill(name + ".test.py.txt", words),
        "%s.test" % module: _fill("rostest.test.txt", words),
        "rostest_%s.py" % module: _fill("rostest.py.txt", words),
        "README.md": _fill(name + ".README.md.txt", words),
    }
    return write_plan_folder(folder, draft.net, draft.plan, draft.policy, files)


def _template(name: str) -> _Template:
    if name not in _TEMPLATES:
        raise UsageError(
            "there is no template '%s'" % name, hint="choose from: %s" % ", ".join(_TEMPLATES)
        )
    return _TEMPLATES[name]


def _check_places(name: str, template: _Template, places: Sequence[str]) -> None:
    if not template.least_places:
        raise UsageError("the template '%s' has no places to choose" % name)
    if not template.least_places <= len(places) <= MOST_PLACES:
        raise UsageError(
            "the template '%s' takes %d to %d places, not %d"
            % (name, template.least_places, MOST_PLACES, len(places))
        )
    for place in places:
        if not re.fullmatch(r"\w[\w -]{0,39}", place) or place != place.strip():
            raise UsageError(
                "'%.40s' cannot be the name of a place here" % place,
                hint="up to 40 letters, digits, '_', '-' and spaces",
            )
    if len(set(places)) < len(places):
        raise UsageError("a place is named twice: %s" % ", ".join(places))


def _fill(name: str, words: Mapping[str, str]) -> str:
    with open(os.path.join(_FILES, name), encoding="utf-8") as file:
        return string.Template(file.read()).substitute(words)


def _takes(seconds: float, **more: Any) -> Dict[str, Any]:
    return {"function": "actions.TakeTime", "settings": {"seconds": seconds, **more}}


def _lasts(seconds: float) -> Dict[str, Any]:
    return {"mean": seconds, "distribution": "gamma", "shape": 4}


def _team(robots: int, starts: Sequence[str]) -> Dict[str, str]:
    return {"robot_%d" % (k + 1): starts[k % len(starts)] for k in range(robots)}


def _tokens(team: Mapping[str, str], place: str) -> int:
    return list(team.values()).count(place)


def _at(column: float, row: float) -> Tuple[float, float]:
    return (100 + column * _COLUMN, 100 + row * _ROW)


def _patrol(title: str, robots: int, places: Sequence[str]) -> _Draft:
    team = _team(robots, ["Go_" + place for place in places])
    net = NetBuilder(title)
    for row, place in enumerate(places):
        go, look, choose = "Go_" + place, "Look_" + place, "Choose_" + place
        net.place(go, _tokens(team, go), position=_at(0, 2 * row))
        net.place(look, position=_at(2, 2 * row)).place(choose, position=_at(4, 2 * row))
        net.exponential(
            "arrived_" + place, 0.25, None, inputs=go, outputs=look, position=_at(1, 2 * row)
        )
        net.exponential(
            "looked_" + place, 0.5, None, inputs=look, outputs=choose, position=_at(3, 2 * row)
        )
    rows: List[Dict[str, Any]] = []
    for row, place in enumerate(places):
        others = [*places[row + 1 :], *places[:row]]  # in the order of a tour
        for number, other in enumerate(others):
            net.immediate(
                "%s_to_%s" % (place, other),
                inputs="Choose_" + place,
                outputs="Go_" + other,
                position=_at(5, 2 * row + (number + 0.5) / len(others) * 2 - 1),
            )
        following, *rest = ["%s_to_%s" % (place, other) for other in others]
        free = [0 if other == others[0] else "-" for other in places for _ in range(2)]
        if rest:  # equal shares that sum to 1 as decimals
            share = round(1 / len(rest), 6)
            shares = dict.fromkeys(rest[1:], share)
            shares[rest[0]] = round(1 - share * (len(rest) - 1), 6)
            rows.append({"marking": free, "choose": {following: 1}})
            rows.append({"marking": ["-"] * len(free), "choose": shares})
        else:
            rows.append({"marking": ["-"] * len(free), "choose": {following: 1}})
    counted = [what + place for place in places for what in ("Go_", "Look_")]
    actions: Dict[str, Any] = {}
    for place in places:
        actions["Go_" + place] = _takes(4.0)
        actions["Look_" + place] = _takes(2.0)
        actions["Choose_" + place] = None
    plan = {
        "plan": title,
        "description": "Robots go round %s, to the next place if it is free." % ", ".join(places),
        "actions": actions,
        "robots": team,
        "spawn": ["Go_" + place for place in places],
        "on_failure": {"*": {"retry": 3, "delay": 1}},
        "durations": {
            what + place: _lasts(seconds)
            for place in places
            for what, seconds in (("Go_", 4.0), ("Look_", 2.0))
        },
    }
    words = {"first": repr(places[0]), "second": repr(places[1]), "list": ", ".join(places)}
    seen = ["looked_" + place for place in places[:2]]
    return _Draft(net.build(), plan, seen, {"places": counted, "rows": rows}, words)


def _inspect(title: str, robots: int, places: Sequence[str]) -> _Draft:
    team = _team(robots, ["Idle"])
    net = NetBuilder(title).place("Idle", robots, position=_at(0, 0))
    actions: Dict[str, Any] = {"Idle": None}
    durations: Dict[str, Any] = {}
    outcomes: Dict[str, Any] = {}
    given_back: Dict[str, Any] = {}
    for number, place in enumerate(places):
        row = 3 * number
        go, look, tell = "Go_" + place, "Inspect_" + place, "Report_" + place
        due, fresh = "Due_" + place, "Fresh_" + place
        net.place(go, position=_at(2, row)).place(look, position=_at(4, row))
        net.place(tell, position=_at(6, row))
        net.place(due, 1, position=_at(1, row + 1)).place(fresh, position=_at(4, row + 2))
        net.exponential(
            "falls_due_" + place, 0.05, inputs=fresh, outputs=due, position=_at(2, row + 2)
        )
        net.immediate("take_" + place, inputs=["Idle", due], outputs=go, position=_at(1, row))
        net.exponential("there_" + place, 0.25, None, inputs=go, outputs=look, position=_at(3, row))
        net.exponential(
            "fine_" + place, 0.4, None, inputs=look, outputs=["Idle", fresh],
            position=_at(5, row + 1),
        )  # fmt: skip
        net.exponential(
            "found_" + place, 0.1, None, inputs=look, outputs=tell, position=_at(5, row)
        )
        net.exponential(
            "told_" + place, 1.0, None, inputs=tell, outputs=["Idle", fresh],
            position=_at(6, row + 1),
        )  # fmt: skip
        actions[go] = _takes(4.0)
        often = {"seconds": 2.0, "often": 0.2}
        actions[look] = {"function": "actions.Inspect", "settings": often}
        actions[tell] = _takes(1.0)
        for where, seconds in ((go, 4.0), (look, 2.0), (tell, 1.0)):
            durations[where] = _lasts(seconds)
            given_back[where] = {due: 1}
        outcomes[look] = {"probabilities": {"fine_" + place: 0.8, "found_" + place: 0.2}}
    due_places = ["Due_" + place for place in places]
    rows = [
        {
            "marking": [0] * number + [1] + ["-"] * (len(places) - number - 1),
            "choose": {"take_" + place: 1},
        }
        for number, place in enumerate(places)
    ]
    plan = {
        "plan": title,
        "description": "Robots inspect %s again and again, and report what they find."
        % ", ".join(places),
        "actions": actions,
        "resource_places": [what + place for place in places for what in ("Due_", "Fresh_")],
        "environment": "simulate",
        "robots": team,
        "spawn": ["Idle"],
        "on_failure": {"*": {"retry": 3, "delay": 1}},
        "on_evict": given_back,
        "durations": durations,
        "outcomes": outcomes,
    }
    policy = {"places": due_places, "rows": rows}
    words = {
        "first": repr(places[0]),
        "places": repr(list(places)),
        "list": ", ".join(places),
        "busy": str(min(robots, len(places))),
    }
    return _Draft(net.build(), plan, ["Fresh_" + places[0]], policy, words)


def _deliver(title: str, robots: int, places: Sequence[str]) -> _Draft:
    net = (
        NetBuilder(title)
        .place("Idle", robots, position=_at(0, 0))
        .place("Fetch", position=_at(2, 0))
        .place("Deliver", position=_at(4, 0))
        .place("Orders", 0, _MOST_ORDERS, position=_at(1, 2))
        .exponential("order", 0.1, outputs="Orders", position=_at(0, 2))
        .immediate("take", inputs=["Idle", "Orders"], outputs="Fetch", position=_at(1, 0))
        .exponential("fetched", 0.5, None, inputs="Fetch", outputs="Deliver", position=_at(3, 0))
        .exponential("delivered", 0.25, None, inputs="Deliver", outputs="Idle", position=_at(2, 1))
        .exponential("called_off", 0.01, None, inputs="Fetch", outputs="Idle", position=_at(1, 1))
        .exponential("taken_back", 0.01, None, inputs="Deliver", outputs="Idle", position=_at(3, 1))
        .build()
    )
    plan = {
        "plan": title,
        "description": "Robots fetch what is ordered and deliver it; each order is a task.",
        "actions": {
            "Idle": None,
            "Fetch": _takes(2.0),
            "Deliver": {"function": "actions.Deliver", "settings": {"seconds": 4.0}},
        },
        "resource_places": ["Orders"],
        "tasks": {
            "queues": ["Orders"],
            "done": ["delivered"],
            "on_cancel": {"Fetch": "called_off", "Deliver": "taken_back"},
        },
        "events": {
            "order": {"function": "actions.Orders", "every": 5},
            "called_off": {},
            "taken_back": {},
        },
        "robots": _team(robots, ["Idle"]),
        "spawn": ["Idle"],
        "on_failure": {"*": {"retry": 3, "delay": 1}},
        "on_evict": {"Fetch": {"Orders": 1}, "Deliver": {"Orders": 1}},
        "durations": {"Fetch": _lasts(2.0), "Deliver": _lasts(4.0)},
    }
    words = {"busy": str(min(robots, _MOST_ORDERS)), "work": _SUBMIT}
    return _Draft(net, plan, ["delivered"], words=words)


def _charge(title: str, robots: int, places: Sequence[str]) -> _Draft:
    net = (
        NetBuilder(title)
        .place("Work", robots, position=_at(0, 0))
        .place("Half", position=_at(2, 0))
        .place("Low", position=_at(2, 2))
        .place("Work_on", position=_at(4, 1))
        .place("Charge", position=_at(4, 3))
        .place("Charger", 1, position=_at(3, 4))
        .exponential("worked", 0.2, None, inputs="Work", outputs="Half", position=_at(1, 0))
        .immediate("go_on", inputs="Half", outputs="Work_on", position=_at(3, 0))
        .immediate(
            "plug_in_early", inputs=["Half", "Charger"], outputs="Charge", position=_at(3, 2)
        )
        .exponential("worked_on", 0.2, None, inputs="Work_on", outputs="Low", position=_at(3, 1))
        .immediate("plug_in", inputs=["Low", "Charger"], outputs="Charge", position=_at(2, 3))
        .exponential(
            "charged", 0.1, None, inputs="Charge", outputs=["Work", "Charger"], position=_at(1, 3)
        )
        .build()
    )
    policy = {
        "places": ["Charger", "Low"],
        "rows": [
            {"marking": [1, 0], "choose": {"go_on": 0.5, "plug_in_early": 0.5}},
            {"marking": ["-", "-"], "choose": {"go_on": 1}},
            {"marking": ["-", "-"], "choose": {"plug_in": 1}},
        ],
    }
    plan = {
        "plan": title,
        "description": "Robots work and share one charger.",
        "actions": {
            "Work": _takes(5.0),
            "Half": None,
            "Work_on": _takes(5.0),
            "Low": None,
            "Charge": _takes(10.0),
        },
        "resource_places": ["Charger"],
        "robots": _team(robots, ["Work"]),
        "spawn": ["Work"],
        "on_failure": {"*": {"retry": 3, "delay": 1}},
        "on_evict": {"Charge": {"Charger": 1}},
        "durations": {"Work": _lasts(5.0), "Work_on": _lasts(5.0), "Charge": _lasts(10.0)},
    }
    return _Draft(net, plan, ["charged"], policy)


def _rendezvous(title: str, robots: int, places: Sequence[str]) -> _Draft:
    team = _team(robots, ["Pick", "Come"])
    net = (
        NetBuilder(title)
        .place("Pick", _tokens(team, "Pick"), position=_at(0, 0))
        .place("Full", position=_at(2, 0))
        .place("Come", _tokens(team, "Come"), position=_at(0, 2))
        .place("Wait", position=_at(2, 2))
        .place("Bring", position=_at(4, 2))
        .exponential("picked", 0.2, None, inputs="Pick", outputs="Full", position=_at(1, 0))
        .exponential("came", 0.25, None, inputs="Come", outputs="Wait", position=_at(1, 2))
        .immediate("meet", inputs=["Full", "Wait"], outputs=["Pick", "Bring"], position=_at(3, 1))
        .immediate("carry", inputs="Full", outputs="Bring", position=_at(4, 0))
        .immediate("pick", inputs="Wait", outputs="Pick", position=_at(1, 1))
        .exponential("brought", 0.25, None, inputs="Bring", outputs="Come", position=_at(2, 3))
        .build()
    )
    plan = {
        "plan": title,
        "description": "Pickers fill trays; carriers meet them and take the trays away.",
        "actions": {
            "Pick": _takes(5.0),
            "Full": None,
            "Come": _takes(4.0),
            "Wait": None,
            "Bring": _takes(4.0),
        },
        "robots": team,
        "spawn": ["Pick", "Come"],
        "routing": {"meet": {"Full": "Pick", "Wait": "Bring"}},
        "on_failure": {"*": {"retry": 3, "delay": 1}},
        "durations": {"Pick": _lasts(5.0), "Come": _lasts(4.0), "Bring": _lasts(4.0)},
    }
    rows = [
        {"marking": ["-", "-", 0, 0], "choose": {"carry": 1}},
        {"marking": [0, 0, "-", "-"], "choose": {"pick": 1}},
        {"marking": ["-"] * 4, "choose": {"meet": 1}},
    ]
    policy = {"places": ["Pick", "Full", "Come", "Wait"], "rows": rows}
    return _Draft(net, plan, ["meet", "brought"], policy)


_TEMPLATES: Dict[str, _Template] = {
    "patrol": _Template(
        "robots go round a list of places, to the next one if it is free",
        _patrol, 2, least_places=2,
    ),
    "inspect": _Template(
        "robots inspect places that become due again and again, and report what they find",
        _inspect, 2, least_places=1,
    ),
    "deliver": _Template("robots fetch and deliver; orders come in as tasks", _deliver, 2),
    "charge": _Template("robots work, and share one charger", _charge, 3),
    "rendezvous": _Template(
        "pickers hand over to carriers that come to meet them", _rendezvous, 4, least_robots=2
    ),
}  # fmt: skip
