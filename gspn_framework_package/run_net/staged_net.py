"""An ordinary net whose immediate transitions have stages, as it is being built (``literal``)."""

from __future__ import annotations

import re
from collections import Counter
from typing import Dict, Iterator, List, Mapping, NamedTuple, Optional, Tuple

from gspn_framework_package.model.errors import RefusedError
from gspn_framework_package.model.marking_function import Value
from gspn_framework_package.model.net import Arc, Net, Place, Transition

MOST_TRANSITIONS = 20_000
"""A net with more transitions is refused."""

TurnStage = Tuple[int, ...]
"""The order of what happens in zero time, the smallest first; :data:`IN_TIME`: it takes time."""
IN_TIME: TurnStage = ()
TokenCounts = Mapping[str, int]
"""Place -> tokens."""


class Meaning(NamedTuple):
    """The meaning of a place or transition of a literal net.

    :ivar of: the place or transition of the plan; "": none.
    :ivar text: for people.
    :ivar fires: whether its firing is a firing of the transition ``of``.
    """

    of: str
    text: str
    fires: bool = False


class Needed(NamedTuple):
    """The tokens that a transition needs, and must not find."""

    needs: Dict[str, int]
    below: Dict[str, int]


NOTHING_NEEDED = Needed({}, {})


class _Step(NamedTuple):
    """A transition, and the tokens that it takes and puts."""

    stage: TurnStage
    value: Value
    servers: Optional[int]
    takes: TokenCounts
    puts: TokenCounts
    ready: Needed


class StagedNet:
    """A net as it is being built.

    :param kinds: the first number of a stage -> what it is for, for people; others are "others".

    :ivar over: the place whose tokens disable everything; "": there is none.
    :ivar tokens: place -> its tokens at first; those of sums follow from the others.
    :ivar sums: place that has the tokens of others -> these, and how often each counts.
    """

    def __init__(self, kinds: Mapping[TurnStage, str]) -> None:
        self._kinds = kinds
        self.over = ""
        self.tokens: Dict[str, int] = {}
        self.places: Dict[str, Meaning] = {}
        self.transitions: Dict[str, Meaning] = {}
        self.sums: Dict[str, TokenCounts] = {}
        self._steps: Dict[str, _Step] = {}
        self._doubles: Dict[str, int] = Counter()

    def place(self, wanted: str, of: str, text: str) -> str:
        """Add a place with a name like ``wanted``; return its name."""
        name = self._unused(wanted)
        self.places[name] = Meaning(of, text)
        self.tokens[name] = 0
        return name

    def _unused(self, wanted: str) -> str:
        """A new name like ``wanted``, of letters, digits and ``_``."""
        plain = re.sub(r"[^A-Za-z0-9]+", "_", wanted).strip("_")
        plain = plain if plain[:1].isalpha() else "n_" + plain
        name = plain
        while name in self.places or name in self._steps:
            self._doubles[plain] += 1
            name = "%s_%d" % (plain, self._doubles[plain] + 1)
        return name

    def parts_of(self, place: str) -> TokenCounts:
        """The places whose tokens a place has: itself, if it is not a sum."""
        return self.sums.get(place, {place: 1})

    def sum(self, wanted: str, parts: TokenCounts) -> str:
        """The place that always has the tokens of ``parts``; a new one with a name like ``wanted``,
        if there is none."""
        whole = Counter({q: n * k for p, n in parts.items() for q, k in self.parts_of(p).items()})
        found = next((name for name in self.places if self.parts_of(name) == whole), "")
        if not found:
            terms = [name if n == 1 else "%d * %s" % (n, name) for name, n in whole.items()]
            found = self.place(wanted, "", "always %s" % " + ".join(terms))
            self.sums[found] = whole
        return found

    def add(
        self,
        wanted: str,
        meaning: Meaning,
        stage: TurnStage,
        value: Value,
        takes: TokenCounts,
        puts: TokenCounts,
        ready: Needed = NOTHING_NEEDED,
        servers: Optional[int] = None,
    ) -> None:
        """Add a transition with a name like ``wanted``; unless specified, each token has a server.

        :raises RefusedError: there are too many.
        """
        if len(self._steps) == MOST_TRANSITIONS:
            kinds = Counter(self._kinds.get(s.stage[:1], "others") for s in self._steps.values())
            raise too_large(*kinds.most_common(1)[0])
        name = self._unused(wanted)
        self.transitions[name] = meaning
        self._steps[name] = _Step(stage, value, servers, takes, puts, ready)

    def net(self, name: str) -> Net:
        """The net."""
        for total, parts in self.sums.items():
            self.tokens[total] = sum(n * self.tokens[part] for part, n in parts.items())
        stages = sorted({step.stage for step in self._steps.values()} - {IN_TIME}, reverse=True)
        priority = {stage: number for number, stage in enumerate(stages, 1)}
        transitions = [
            Transition(t, timed=True, rate=step.value, servers=step.servers)
            if step.stage == IN_TIME
            else Transition(t, weight=step.value, priority=priority[step.stage])
            for t, step in self._steps.items()
        ]
        places = [Place(p, self.tokens[p]) for p in self.places]
        return Net(places, transitions, list(self._arcs()), name)

    def _arcs(self) -> Iterator[Arc]:
        counted: Dict[str, List[Tuple[str, int]]] = {p: [(p, 1)] for p in self.places}
        for total, parts in self.sums.items():
            for part, n in parts.items():
                counted[part].append((total, n))
        for t, step in self._steps.items():
            change: Dict[str, int] = Counter()
            for sign, moved in ((-1, step.takes), (1, step.puts)):
                for place, n in moved.items():
                    for total, k in counted[place]:
                        change[total] += sign * k * n
            needs = Counter(step.takes) | Counter(step.ready.needs)
            for place in {**needs, **change}:
                taken = max(needs[place], -change[place])
                if taken:
                    yield Arc(place, t, taken)
                if taken + change[place]:
                    yield Arc(t, place, taken + change[place])
            over = {self.over: 1} if self.over else {}
            for place, n in {**step.ready.below, **over}.items():
                yield Arc(place, t, n, inhibitor=True)


def too_large(what: str, count: int) -> RefusedError:
    """The error that a net is too large, most of it for ``what``."""
    return RefusedError(
        "its run net would have more than {:,} transitions, {:,} of them for {}".format(
            MOST_TRANSITIONS, count, what
        ),
        hint="gspn convert can write its Markov chain, state by state",
    )
