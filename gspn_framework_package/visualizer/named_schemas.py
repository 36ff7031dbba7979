"""The schemas that several requests of the page's interface share, or that a client needs by
name."""

from __future__ import annotations

from typing import Dict, Tuple

from gspn_framework_package.analysis.decisions.aims import Aim
from gspn_framework_package.fleet.stay_follower import USES
from gspn_framework_package.visualizer.order_schemas import order_schemas
from gspn_framework_package.visualizer.schemas import (
    COUNTS,
    FLAG,
    NAMES,
    NUMBER,
    OBJECT,
    OBJECTS,
    TEXT,
    WHOLE,
    Schema,
    component,
    described_as,
    list_with,
    map_to,
    object_with,
    or_null,
)

EDITORS: Dict[str, Schema] = {
    "version": TEXT,
    "editors": list_with({"page": TEXT, "number": WHOLE, "selection": NAMES}),
}

_MOMENT = {"robot": TEXT, "place": TEXT, "slot": WHOLE}
STORY: Dict[str, Schema] = {
    "run": TEXT,
    "plan": TEXT,
    "began": or_null(NUMBER),
    "seconds": NUMBER,
    "ended": TEXT,
    "slots": WHOLE,
    "firings": WHOLE,
    "left_out": WHOLE,
    "robots": list_with({"robot": TEXT, **dict.fromkeys(USES, NUMBER)}),
    "waited_for": list_with({"robot": TEXT, "seconds": NUMBER, "waits": WHOLE, "by": NAMES}),
    "waits": list_with({"t": NUMBER, "seconds": NUMBER, **_MOMENT, "for": TEXT, "text": TEXT}),
    "moments": list_with({"at": NUMBER, **_MOMENT, "kind": TEXT, "detail": TEXT}),
}

_FACTORS = map_to(NUMBER)
_RUNS = object_with({"runs": WHOLE, "time": NUMBER})
ADJUSTABLE: Dict[str, Schema] = {
    "robots": WHOLE,
    "places": _FACTORS,
    "rates": _FACTORS,
    "each": NAMES,
}
WHAT_IF: Tuple[Dict[str, Schema], Dict[str, Schema]] = (
    {
        "robots?": WHOLE,
        "slower?": described_as(NUMBER, "a factor of the time of every action"),
        "places?": described_as(_FACTORS, "place -> a further factor of the time of its action"),
        "rates?": described_as(_FACTORS, "event -> a factor of its rate"),
        "each?": described_as(_FACTORS, "robot -> a further factor of the time of its actions"),
        "whole?": described_as(FLAG, "start the longer simulation that 'next' describes"),
        "next?": _RUNS,
    },
    {
        "growth?": described_as(
            map_to({"type": "array", "items": NUMBER}),
            "transition -> firings per second, their variance per second, and the variance of the "
            "rate",
        ),
        "runs?": WHOLE,
        "seconds?": NUMBER,
        "next?": _RUNS,
        "job?": TEXT,
    },
)
"""The fields of a what-if, and of its answer."""

BOARD = object_with(
    {
        "n": WHOLE,
        "t": NUMBER,
        "marking": COUNTS,
        "enabled": COUNTS,
        "counts": COUNTS,
        "robots": list_with({"name": TEXT, "place?": {"type": "integer"}, "phase?": TEXT}),
        "notes": OBJECTS,
        "status": OBJECT,
        "data?": OBJECT,
        "plan?": WHOLE,
    }
)
_NODES = list_with({"name": TEXT})
SCENE = object_with(
    {
        "name": TEXT,
        "hash": TEXT,
        "places": _NODES,
        "transitions": _NODES,
        "arcs": {"type": "array", "items": COUNTS},
        "layout": OBJECT,
        "subnets": OBJECTS,
        "groups": OBJECTS,
        "plan": or_null(OBJECT),
    }
)
EVENT = object_with(
    {
        "n": described_as(WHOLE, "its number, from 1"),
        "t": described_as(NUMBER, "seconds since the beginning"),
        "k": described_as(
            TEXT, "what happened: fire, undo, mark, robots, data, plan, note or status"
        ),
        "p?": described_as(WHOLE, "number of the plan whose indices it has; 0 if it is missing"),
        "tr?": described_as(WHOLE, "of fire and undo: the transition, by index"),
        "who?": described_as(TEXT, "of fire: the robot that asked for it"),
        "why?": described_as(TEXT, "of fire and mark: the cause"),
        "level?": described_as(TEXT, "of a note: info, warning or fault"),
        "text?": described_as(TEXT, "of a note: for people"),
        "robot?": described_as(TEXT, "of a note: whom it is about"),
    }
)
CHANGES = list_with({"kind": TEXT, "name": TEXT, "what": TEXT})

CHECK: Dict[str, Schema] = {
    "valid?": FLAG,
    "doubts?": NAMES,
    "decided?": FLAG,
    "states?": WHOLE,
    "findings?": list_with(
        {
            "level": TEXT,
            "text": TEXT,
            "hint": TEXT,
            "check": TEXT,
            "elements": OBJECTS,
            "mend?": or_null(OBJECT),
        }
    ),
    "cancelled?": FLAG,
}
EPOCH = {"epoch": TEXT}
POSES: Dict[str, Schema] = {
    **EPOCH,
    "from": described_as(NUMBER, "the time from which the moments are complete (s)"),
    "to": described_as(NUMBER, "the time up to which they do"),
    "moments": list_with({"t": NUMBER, "robots": map_to(OBJECT)}),
}
_RANGE = {"name": TEXT, "low": NUMBER, "high": NUMBER}
ANALYSIS_FIELDS: Dict[str, Schema] = {
    "event?": described_as(WHOLE, "the event after which to ask; without it, now"),
    "from?": described_as(TEXT, "'marking': from that marking; otherwise, from the initial one"),
    "limit?": described_as(WHOLE, "maximum number of states"),
    "seconds?": described_as(NUMBER, "time limit"),
    "policy?": described_as(FLAG, "of a plan: under its policy, and not by the weights of its net"),
    "reading?": described_as(TEXT, "'run' or 'net': whose times"),
    "structure?": described_as(FLAG, "invariants, and what follows from them"),
    "timing?": described_as(FLAG, "the steady state, and what follows from it"),
    "at?": described_as({"type": "array", "items": NUMBER}, "times (s) at which to look"),
    "reach?": described_as(NAMES, "conditions: can each be reached?"),
    "cover?": described_as(
        {"type": "array", "items": map_to(WHOLE)},
        "can at least these tokens (place -> number) be reached?",
    ),
    "mean_time_to?": described_as(NAMES, "conditions: the mean time (s) until each holds"),
    "settling?": described_as(NUMBER, "when is it this close to the steady state?"),
    "rewards?": described_as(map_to(NUMBER), "place or transition -> reward"),
    "simulate?": component("SimulationForm"),
    "sweep?": component("SweepForm"),
    "predict?": object_with({"time": described_as(NUMBER, "length of the run (s)")}),
    "decide?": object_with({"kind": TEXT, "about?": TEXT}),
    "optimise?": component("PolicyForm"),
}
"""A question about a net or a plan; one of ``simulate``, ``sweep``, ``predict``, ``decide``,
``optimise``, or any of the others."""
_SIMULATION: Dict[str, Schema] = {
    "time?": described_as(NUMBER, "length of a run (s); not needed with 'until'"),
    "replications?": described_as(WHOLE, "number of runs (default: 1000)"),
    "seed?": WHOLE,
    "warmup?": described_as(NUMBER, "seconds at the beginning that do not count"),
    "until?": described_as(TEXT, "the condition that ends a run"),
    "confidence?": described_as(NUMBER, "of the intervals (default: 0.95)"),
}

NAMED_SCHEMAS: Dict[str, Schema] = {
    "Error": object_with({"error": TEXT, "fields?": OBJECT, "exists?": FLAG}),
    "News": object_with(
        {
            "cursor": described_as(
                TEXT, "where to continue: the parameter 'since' of the next request"
            ),
            "snapshot?": object_with(
                {
                    **EPOCH,
                    "mode": described_as(TEXT, "SIMULATE, LIVE or REPLAY"),
                    "info": OBJECT,
                    "oldest": WHOLE,
                    "board": BOARD,
                }
            ),
            "events?": {"type": "array", "items": EVENT},
            "head?": described_as(OBJECT, "of a replay, in place of events: how far it is"),
            "latest?": OBJECT,
            "more?": described_as(FLAG, "there are further events: ask again at once"),
        }
    ),
    "Ping": described_as(OBJECT, "nothing happened for some seconds; the connection is alive"),
    "Closed": described_as(object_with({"reason": TEXT}), "nothing more will come"),
    "Editing": object_with(EDITORS),
    "SimulationForm": object_with(_SIMULATION),
    "SweepForm": object_with(
        {
            "vary": described_as(NAMES, "parameters, as 'robots=1..5' of gspn sweep"),
            "measure?": described_as(NAMES, "what is measured, as gspn sweep takes it"),
            **_SIMULATION,
        }
    ),
    "PolicyForm": object_with(
        {
            "aim": {**TEXT, "enum": [aim.value for aim in Aim]},
            "goal?": described_as(TEXT, "the condition, of time_to, cost_to and reach"),
            "rewards?": list_with({"name": TEXT, "value": NUMBER}),
            "maximise?": FLAG,
            "discount?": described_as(NUMBER, "a rate per second, of discounted"),
            "never?": described_as(NAMES, "conditions that may never hold"),
            "at_least?": list_with({"name": TEXT, "bound": NUMBER}),
            "may_wait?": described_as(NAMES, "places whose robots may wait"),
            "uncertain?": list_with(_RANGE),
            "timing?": described_as(TEXT, "'run' or 'net': whose times"),
            "fitted?": described_as(
                FLAG, "with the times that the plan has learned (default: true)"
            ),
            "teams?": described_as(TEXT, "'plan', 'own' or 'all': the sizes of teams it is for"),
            "simulated?": described_as(NUMBER, "seconds to simulate the old and the new plan for"),
        }
    ),
    "TaskEnded": object_with({"id": TEXT, "outcome": TEXT, "why": TEXT}),
    **order_schemas(),
}
"""Name -> a schema that several answers share, or that a client needs by name."""
