"""The measures that a report can have: the one list of them."""

from __future__ import annotations

import enum
import math
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Tuple

from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.plan.subnets import TITLES, SubnetFlow, subnet_flows
from gspn_framework_package.analysis.symmetry.lumped_space import LumpedSpace

INFINITE = "infinite"


class Part(enum.Enum):
    """The part of a report in which a measure is computed and shown."""

    STRUCTURE = "structure"
    """With the structure, without visiting any marking."""
    BEHAVIOUR = "behaviour"
    """With the state space."""
    TIMING = "timing"
    """With the steady state."""


class Measure(NamedTuple):
    """An answer that takes no arguments.

    :ivar key: its name in the report.
    :ivar part: the part that it belongs to.
    :ivar compute: returns the answer as a value that JSON can represent; it may raise LimitError
        if the answer was not decided, and RefusedError if there is none.
    :ivar title: its name in the text and on the page; empty for measures with a special layout
        there.
    :ivar applies: whether the answer exists; if not, the report does not have the key.
    """

    key: str
    part: Part
    compute: Callable[[Analysis], Any]
    title: str = ""
    applies: Callable[[Analysis], bool] = lambda analysis: True


def _most_tokens(analysis: Analysis) -> Optional[float]:
    found = analysis.boundedness
    if found.bounded is None:
        return None
    return max((math.inf if b is None else b for b in found.bounds.values()), default=0)


def _lumped(space: LumpedSpace) -> Dict[str, Any]:
    symmetry = space.symmetry
    whole = space.count(slice(None)) if space.complete else None
    return {
        "visited": len(space),
        "factor": None if whole is None else _ratio(whole, len(space)),
        "permutations": symmetry.order,
        "parts": symmetry.text,
        "unused_generators": symmetry.unused,
    }


def _ratio(whole: int, visited: int) -> float:
    """The ratio of two counts; the first may be too large for a float."""
    return whole / visited if whole < 2**1000 else whole // visited


def _home_states(analysis: Analysis) -> Dict[str, Any]:
    states = analysis.properties.home_states
    return {
        "count": analysis.space.count(states),
        "example": analysis.space.named(int(states[0])) if len(states) else None,
        "without": list(analysis.left_out),
    }


def _has_subnets(analysis: Analysis) -> bool:
    return analysis.plan is not None and bool(analysis.plan.subnets)


def _subnet_robots(analysis: Analysis) -> Dict[str, float]:
    """Mean number of robots inside each subnet."""
    means = analysis.measures.mean_tokens
    return {name: math.fsum(means[p] for p in f.places) for name, f in _flows(analysis).items()}


def _subnet_entries(analysis: Analysis) -> Dict[str, float]:
    """How often (1/s) a robot enters each subnet."""
    return {name: _often(analysis, f.entries) for name, f in _flows(analysis).items()}


def _subnet_exits(analysis: Analysis) -> Dict[str, float]:
    """How often (1/s) a robot leaves each subnet."""
    return {name: _often(analysis, f.exits) for name, f in _flows(analysis).items()}


def _flows(analysis: Analysis) -> Dict[str, SubnetFlow]:
    assert analysis.plan is not None
    return subnet_flows(analysis.plan)


def _often(analysis: Analysis, weights: Mapping[str, int]) -> float:
    throughput = analysis.measures.throughput
    return math.fsum(throughput[name] * weight for name, weight in weights.items())


def _subnet_time(analysis: Analysis) -> Dict[str, float]:
    """Mean time (s) of a robot's stay in each subnet, by Little's law."""
    entries = _subnet_entries(analysis)
    return {
        name: robots / entries[name] if entries[name] > 0 else math.inf if robots > 0 else math.nan
        for name, robots in _subnet_robots(analysis).items()
    }


MEASURES: List[Measure] = [
    Measure(
        "place_invariants",
        Part.STRUCTURE,
        lambda a: [{"weights": i.weights, "value": i.value} for i in a.structure.place_invariants],
    ),
    Measure(
        "transition_invariants",
        Part.STRUCTURE,
        lambda a: [{"weights": i.weights} for i in a.structure.transition_invariants],
    ),
    Measure("conservative", Part.STRUCTURE, lambda a: a.structure.conservative),
    Measure("strictly_conservative", Part.STRUCTURE, lambda a: a.structure.strictly_conservative),
    Measure("consistent", Part.STRUCTURE, lambda a: a.structure.consistent),
    Measure("repetitive", Part.STRUCTURE, lambda a: a.structure.repetitive),
    Measure("siphons", Part.STRUCTURE, lambda a: [s._asdict() for s in a.structure.siphons]),
    Measure("traps", Part.STRUCTURE, lambda a: [s._asdict() for s in a.structure.traps]),
    Measure("unmarked_siphon", Part.STRUCTURE, lambda a: list(a.structure.unmarked_siphon)),
    Measure(
        "siphons_hold_marked_traps",
        Part.STRUCTURE,
        lambda a: a.structure.unguarded_siphon is None,
    ),
    Measure("classes", Part.STRUCTURE, lambda a: dict(a.structure.classes._asdict())),
    Measure("conflict_sets", Part.STRUCTURE, lambda a: a.structure.conflict_sets),
    Measure("k_safe", Part.BEHAVIOUR, _most_tokens),
    Measure("live", Part.BEHAVIOUR, lambda a: a.properties.live),
    Measure(
        "liveness",
        Part.BEHAVIOUR,
        lambda a: {name: level.name for name, level in a.properties.liveness.items()},
    ),
    Measure("dead_transitions", Part.BEHAVIOUR, lambda a: a.properties.dead_transitions),
    Measure("reversible", Part.BEHAVIOUR, lambda a: a.reversible),
    Measure("home_states", Part.BEHAVIOUR, _home_states),
    *(
        Measure(key, Part.TIMING, compute, TITLES[key], _has_subnets)
        for key, compute in (
            ("subnet_robots", _subnet_robots),
            ("subnet_entries", _subnet_entries),
            ("subnet_exits", _subnet_exits),
            ("subnet_time", _subnet_time),
        )
    ),
]
"""To add a measure, add a row here and one to the table of keys in ``docs/analysis.md``. Measures
with a title appear in the text, in the CSV file and on the page."""

UNGUARDED = "unguarded_siphon"
"""Key of the witness if ``siphons_hold_marked_traps`` is false; null otherwise."""


def keys_of(part: Part, analysis: Analysis) -> Tuple[str, ...]:
    """The keys of the measures of a part, as far as they apply to the subject."""
    keys = tuple(m.key for m in MEASURES if m.part is part and m.applies(analysis))
    return (*keys, UNGUARDED) if part is Part.STRUCTURE else keys
