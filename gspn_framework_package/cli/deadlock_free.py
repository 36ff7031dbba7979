"""``gspn build --deadlock-free``: limits a plan of a map until robots cannot block each other for
good, and measures what that costs."""

from __future__ import annotations

import functools
from typing import Any, Callable, Dict, Iterator, List, Mapping, NamedTuple, Optional

from gspn_framework_package.analysis.analyse import Analysis
from gspn_framework_package.analysis.limits import Limits
from gspn_framework_package.analysis.plan.space import replaced_durations
from gspn_framework_package.analysis.preflight.report import marking_text, sequence
from gspn_framework_package.analysis.proofs.ladder import PROVEN, VIOLATED, Answer, decide_question
from gspn_framework_package.analysis.proofs.questions import CAN_MOVE, DEAD, NEVER, MarkingQuestion
from gspn_framework_package.analysis.simulation import simulate
from gspn_framework_package.analysis.simulation.estimates import Estimate, throughput
from gspn_framework_package.analysis.watch import Progress
from gspn_framework_package.making.site_elements import MapGroup
from gspn_framework_package.making.site_plan import SitePlan
from gspn_framework_package.making.site_traffic import WaitingCircle, waiting_circles
from gspn_framework_package.model.errors import InputError, LimitError, RefusedError
from gspn_framework_package.model.plan import Plan

_CHAIN = Limits(states=20_000, seconds=10.0)
"""Largest number of states to analyse; a larger plan is simulated."""

_HOUR = 3600.0

_RUNS = 30
"""Number of simulated runs."""

_CONFIDENCE = 0.95


class PerHour(NamedTuple):
    """How many tasks the robots finish in an hour, or edges if they only drive.

    :ivar how: how the number was computed, in words.
    """

    before: Estimate
    after: Estimate
    what: str
    how: str


class FreePlan(NamedTuple):
    """A plan in which no robots block each other for good.

    :ivar before: whether every robot could always move again without the groups.
    :ivar groups: the groups that were added to the map for it.
    :ivar answers: the answers about the plan, which together prove it.
    :ivar cost: None if no group was added.
    """

    made: SitePlan
    before: Answer
    groups: Dict[str, MapGroup]
    answers: List[Answer]
    cost: Optional[PerHour] = None

    def to_json(self) -> Dict[str, Any]:
        """As plain JSON values."""
        data: Dict[str, Any] = {
            "before": self.before.to_json(),
            "groups": {
                name: {"nodes": list(group.nodes), "capacity": group.capacity}
                for name, group in self.groups.items()
            },
            "answers": [answer.to_json() for answer in self.answers],
        }
        if self.cost is not None:
            data["per_hour"] = {
                **self.cost._asdict(),
                "before": self.cost.before._asdict(),
                "after": self.cost.after._asdict(),
            }
        return data

    def text(self) -> Iterator[str]:
        """The lines for people."""
        yield "free of deadlocks%s:" % ("" if self.groups else " as it is")
        if self.answers[0].verdict != PROVEN:
            yield "  robots never wait for each other in a circle: proven"
        for answer in self.answers:
            yield "  %s: %s%s" % (
                answer.question.statement,
                answer.verdict,
                " (%s)" % answer.decided_by if answer.decided_by else "",
            )
        for name, group in self.groups.items():
            yield "  added group %s: at most %d in %s" % (
                name,
                group.capacity,
                ", ".join(group.nodes),
            )
        if self.groups:
            yield "  without %s: %s" % (
                "it" if len(self.groups) == 1 else "them",
                _stuck(self.before) or "not decided",
            )
        if self.cost is not None:
            before, after, what, how = self.cost
            lost = 100 * (1 - after.mean / before.mean) if before.mean > 0 else 0.0
            yield "  %s per hour: %s before, %s after: %.3g %% %s (%s)" % (
                what,
                _number(before),
                _number(after),
                abs(lost),
                "less" if lost >= 0 else "more",
                how,
            )


def deadlock_free(
    build: Callable[[Mapping[str, MapGroup]], SitePlan],
    robots: int,
    seconds: float,
    progress: Optional[Progress] = None,
) -> FreePlan:
    """Make a plan of a map in which no robots block each other for good.

    :param build: builds it with some further groups of mutual exclusion.
    :param robots: number of robots.
    :param seconds: the budget of each question (s).
    :raises InputError: even with all groups that would help, robots can block each other, or this
        is not decided.
    """
    made = build({})
    before = made.as_read()

    def decide(plan: Plan, question: MarkingQuestion) -> Answer:
        return decide_question(plan, question, seconds=seconds, progress=progress)

    first = decide(before, MarkingQuestion(CAN_MOVE))
    if first.verdict == PROVEN:
        return FreePlan(made, first, {}, [first])
    circles = [
        circle
        for circle in waiting_circles(made.limits.values(), made.moves)
        if circle.robots <= robots
    ]
    largest = [circle.robots - 1 for circle in circles]
    answers = [first]
    groups: Dict[str, MapGroup] = {}
    for capacities in [largest, [1] * len(circles)][: 1 if set(largest) <= {1} else 2]:
        groups = _groups(made, circles, capacities)
        changed = _built(build, groups) if groups else made
        after = changed.as_read() if groups else before
        moves = decide(after, MarkingQuestion(CAN_MOVE)) if groups else first
        answers = _answers(changed, circles, moves, functools.partial(decide, after))
        if _are_free(answers):
            cost = _cost(before, after, progress) if groups else None
            return FreePlan(changed, first, groups, answers, cost)
    raise _what_remains(answers, groups)


def _groups(
    made: SitePlan, circles: List[WaitingCircle], capacities: List[int]
) -> Dict[str, MapGroup]:
    """The groups that the plan does not have yet, with names that are new in it."""
    found: Dict[str, MapGroup] = {}
    number = 1
    for circle, capacity in zip(circles, capacities):
        nodes = set(circle.nodes)
        if any(
            limit.capacity <= capacity and nodes <= set(limit.nodes)
            for limit in made.limits.values()
        ):
            continue
        while "Free_group_lane_%d" % number in made.net.place_index:
            number += 1
        found["lane_%d" % number] = circle.group(capacity)
        number += 1
    return found


def _built(
    build: Callable[[Mapping[str, MapGroup]], SitePlan], groups: Mapping[str, MapGroup]
) -> SitePlan:
    try:
        return build(groups)
    except InputError as error:
        if error.element in ["Free_group_" + name for name in groups]:
            error.hint = (
                "with more robots there, they can block each other: choose another 'start', or "
                "let nodes hold more"
            )
        raise


def _answers(
    made: SitePlan,
    circles: List[WaitingCircle],
    moves: Answer,
    decide: Callable[[MarkingQuestion], Answer],
) -> List[Answer]:
    """Whether every robot can always move again (``moves``). If this is not decided: also whether a
    dead marking can be reached, and whether enough robots to fill a circle can rest in its
    nodes."""
    found = [moves]
    if moves.verdict in (PROVEN, VIOLATED):
        return found
    found.append(decide(MarkingQuestion(DEAD)))
    for circle in circles:
        resting = ["'%s'" % place for node in circle.nodes for place in made.rests.get(node, ())]
        enough = "%s >= %d" % (" + ".join(resting), circle.robots)
        found.append(decide(MarkingQuestion(NEVER, enough, losses=True)))
    return found


def _are_free(answers: List[Answer]) -> bool:
    """Whether the answers say that no robots block each other: every robot can move again, or no
    answer denies it and no circle can form."""
    if any(answer.verdict == VIOLATED for answer in answers):
        return False
    return answers[0].verdict == PROVEN or all(a.verdict == PROVEN for a in answers[2:])


def _what_remains(answers: List[Answer], groups: Mapping[str, MapGroup]) -> InputError:
    """The error for a plan in which robots still can block each other."""
    tried = "; ".join(
        "%d in %s" % (group.capacity, ", ".join(group.nodes)) for group in groups.values()
    )
    text = next(filter(None, map(_stuck, answers)), "") or "not decided: whether %s" % next(
        answer.question.statement for answer in answers if answer.verdict != PROVEN
    )
    return InputError(
        text + (", even with at most " + tried if tried else ""),
        hint="give another way, a larger capacity, or more --seconds",
    )


def _stuck(answer: Answer) -> str:
    """How robots get stuck, in words; "" if it is not known that they do."""
    if answer.sequence is None:
        return ""
    marking = {p: n for p, n in (answer.marking or {}).items() if not p.startswith("Free_")}
    return "robots can get stuck after %s, in %s" % (
        sequence(answer.sequence),
        marking_text(marking),
    )


# -- what it costs


def _cost(before: Plan, after: Plan, progress: Optional[Progress]) -> PerHour:
    finished = any(t.name.startswith("Finished_") for t in after.net.transitions)
    prefixes = ("Finished_",) if finished else ("Arrive_", "Drain_")
    what = "tasks" if finished else "edges"
    try:
        found = [_analysed(plan, prefixes, progress) for plan in (before, after)]
        how = "in the long run"
    except (LimitError, RefusedError):
        found = [_simulated(plan, prefixes, progress) for plan in (before, after)]
        how = "%d simulated hours each, %g %% confidence" % (_RUNS, 100 * _CONFIDENCE)
    return PerHour(found[0], found[1], what, how)


def _analysed(plan: Plan, prefixes: Any, progress: Optional[Progress]) -> Estimate:
    analysis = Analysis(plan, limits=_CHAIN, progress=progress)
    if replaced_durations(analysis.space):
        raise LimitError("its chain replaces durations")
    counted = [
        value for name, value in analysis.measures.throughput.items() if name.startswith(prefixes)
    ]
    return Estimate(_HOUR * sum(counted), 0.0)


def _simulated(plan: Plan, prefixes: Any, progress: Optional[Progress]) -> Estimate:
    result = simulate(
        plan,
        time=_HOUR,
        replications=_RUNS,
        confidence=_CONFIDENCE,
        samples=True,
        progress=progress,
    )
    assert result.samples is not None
    counted = [t for t, name in enumerate(result.throughput) if name.startswith(prefixes)]
    firings = result.samples.firings[:, counted].sum(axis=1)
    found = throughput(firings, result.samples.seconds, _CONFIDENCE)
    return Estimate(_HOUR * found.mean, _HOUR * found.half_width)


def _number(value: Estimate) -> str:
    return "%.4g" % value.mean + (" ± %.2g" % value.half_width if value.half_width else "")
