"""The report of ``gspn analyse``: the answers as plain JSON values, and as text.

A question that could not be decided has the answer ``null``, with the reason under ``undecided``.
Infinite values are the string ``"infinite"``, since JSON has no number for them.
"""

from __future__ import annotations

import functools
import math
from typing import (
    Any,
    Callable,
    Dict,
    Iterable,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Tuple,
)

import numpy as np

from gspn_framework_package.analysis.analyse import Analysis, Reachability, at_least
from gspn_framework_package.analysis.chain.markov_chain import Component
from gspn_framework_package.analysis.intervals import add_intervals
from gspn_framework_package.analysis.report_measures import (
    INFINITE,
    MEASURES,
    UNGUARDED,
    Part,
    _lumped,
)
from gspn_framework_package.analysis.solution.measures import Measures
from gspn_framework_package.analysis.solution.transient import check_tolerance
from gspn_framework_package.analysis.symbolic.answers import (
    NOT_COUNTED,
    answer_by_counting,
    count_instead,
)
from gspn_framework_package.analysis.symmetry.lumped_space import LumpedSpace
from gspn_framework_package.model.condition import parse_condition
from gspn_framework_package.model.errors import CancelledError, LimitError, RefusedError
from gspn_framework_package.model.net import Net

ON_DISK = "disk"
"""The engine of a report on markings that did not fit into memory."""


def asked_conditions(questions: Questions) -> Tuple[str, ...]:
    """All conditions that ``questions`` ask about."""
    return (
        *questions.reach,
        *(at_least(marking) for marking in questions.cover),
        *questions.mean_time_to,
    )


UNSURE_ABOVE = 1e-6
"""Means with a larger estimated relative error are reported as unsure."""

COMPONENTS = 10
"""The most probable recurrent classes are reported individually, up to this many; the others are
only counted."""


class Questions(NamedTuple):
    """The questions of a report, in addition to those it always answers.

    :ivar at: times (s) at which to report tokens and throughput; also the times within which
      ``mean_time_to`` gives probabilities.
    :ivar reach: conditions to check for reachability.
    :ivar cover: markings (place -> count) to check for coverability.
    :ivar mean_time_to: conditions whose first passage to report.
    :ivar rewards: name of a place or transition -> reward per token and second, or per firing.
    :ivar settling: tolerance of the time to steady state; None: do not report it.
    :ivar structure: whether to report invariants, siphons and traps.
    :ivar timing: whether to report the steady state.
    :ivar symbolic: whether to count the markings of a net, without visiting them, and to answer
      only what that answers.
    """

    at: Tuple[float, ...] = ()
    reach: Tuple[str, ...] = ()
    cover: Tuple[Mapping[str, int], ...] = ()
    mean_time_to: Tuple[str, ...] = ()
    rewards: Mapping[str, float] = {}
    settling: Optional[float] = None
    structure: bool = True
    timing: bool = True
    symbolic: bool = False

    def check(self, net: Net) -> None:
        """Check the questions before anything is computed.

        :raises InputError: a condition cannot be parsed, or a name is unknown.
        :raises UsageError: a tolerance is invalid.
        """
        for condition in (*self.reach, *self.mean_time_to):
            parse_condition(condition, net.place_index, ["deadlock"])
        for marking in self.cover:
            net.marking(marking)
        for name in self.rewards:
            if name not in net.place_index:
                net.transition_number(name)
        if self.settling is not None:
            check_tolerance(self.settling)


def report(
    analysis: Analysis,
    questions: Optional[Questions] = None,
    before_intervals: Callable[[Dict[str, Any]], None] = lambda _: None,
) -> Dict[str, Any]:
    """The answers as plain JSON values; see ``docs/analysis.md`` for the keys.

    :param before_intervals: receives the answers before their intervals, which take longer.
    :raises InputError: a condition cannot be parsed, or a name is unknown.
    :raises CancelledError: the work was cancelled.
    """
    questions = questions or Questions()
    questions.check(analysis.net)
    work = ReportWork(analysis)
    work.basics()
    if questions.structure:
        work.structure()
    if questions.symbolic:
        answer_by_counting(analysis, work.data, work.undecided)
        work.finish()
        return work.data
    work.behaviour()
    for condition in questions.reach:
        work.reach(condition)
    for marking in questions.cover:
        work.cover(marking)
    work.timed(questions)
    if questions.settling is not None:
        tolerance = questions.settling
        work.answer("time_to_steady_state", lambda: analysis.time_to_steady_state(tolerance))
    work.finish()
    add_intervals(analysis, work.data, lambda other: _timed(other, questions), before_intervals)
    return work.data


def _timed(analysis: Analysis, questions: Questions) -> Dict[str, Any]:
    """The part of a report that is about time."""
    work = ReportWork(analysis)
    work.basics()
    work.timed(questions)
    work.finish()
    return work.data


class ReportWork:
    """Collects the answers of a report: ``data``, and why some are ``undecided``."""

    def __init__(self, analysis: Analysis) -> None:
        self.analysis = analysis
        self.data: Dict[str, Any] = {}
        self.undecided: Dict[str, str] = {}

    def answer(self, key: str, compute: Callable[[], Any]) -> Any:
        """Store the answer under ``key``; null, with the reason, if there is none."""
        self.data[key] = self._try(key, compute)
        return self.data[key]

    def _try(self, key: str, compute: Callable[[], Any]) -> Any:
        try:
            return plain(compute())
        except CancelledError:
            raise
        except LimitError as error:
            error.element = None  # the key already names the question
            self.undecided[key] = str(error)
        except RefusedError as error:
            self.undecided[key] = str(error)
        except MemoryError:
            self.undecided[key] = "not decided: there is too little memory (raise --limit-memory)"
        return None

    def measures(self, part: Part, undecided: str = "") -> None:
        """Answer the measures of a part.

        :param undecided: the reason why none of them is decided; empty to compute them.
        """
        for measure in MEASURES:
            if measure.part is not part or not measure.applies(self.analysis):
                continue
            if undecided:
                self.data[measure.key] = None
                self.undecided[measure.key] = undecided
            else:
                self.answer(measure.key, functools.partial(measure.compute, self.analysis))
            if measure.title:
                self.data["titles"].setdefault(part.value, {})[measure.key] = measure.title

    def basics(self) -> None:
        """Describe the subject and the limits."""
        net, plan = self.analysis.net, self.analysis.plan
        self.data["name"] = plan.name if plan else net.name
        self.data["kind"] = "plan" if plan else "net"
        self.data["places"] = len(net.places)
        self.data["transitions"] = len(net.transitions)
        self.data["arcs"] = len(net.arcs)
        self.data["inhibitor_arcs"] = sum(arc.inhibitor for arc in net.arcs)
        self.data["tokens"] = sum(net.initial_marking)
        limits = self.analysis.limits
        self.data["limits"] = {
            "states": limits.states,
            "tree": limits.tree,
            "structure": limits.structure,
            "seconds": limits.seconds,
            "memory_bytes": limits.memory,
        }
        self.data["titles"] = {}

    def structure(self) -> None:
        """Answer the questions on the structure."""
        self.measures(Part.STRUCTURE)
        self.data[UNGUARDED] = None
        if self.data["siphons_hold_marked_traps"] is False:
            found = self.analysis.structure.unguarded_siphon
            self.data[UNGUARDED] = list(found.places) if found else None

    def behaviour(self) -> None:
        """Answer the questions on the state space."""
        analysis = self.analysis
        space = analysis.space
        whole = space.complete
        if whole:
            total, vanishing = space.count(slice(None)), space.count(space.is_vanishing)
            self.data["states"] = {
                "total": total,
                "tangible": total - vanishing,
                "vanishing": vanishing,
                "arcs": space.whole_arcs,
            }
        else:
            self.data["states"] = None
            self.undecided["states"] = (
                "the net is unbounded"
                if analysis.boundedness.bounded is False
                else "not decided within %s (%s)" % (space.extent, space.hint)
            )
        if isinstance(space, LumpedSpace):
            self.data["lumped"] = _lumped(space)
        self.data["left_out"] = list(analysis.left_out)
        self.data["timing"] = analysis.timing._asdict()
        self.data["engine"] = space.engine
        self.data["memory_bytes"] = space.memory
        found = analysis.boundedness
        self.data["bounded"] = found.bounded
        self.data["bounds"] = {
            place: INFINITE if bound is None and found.bounded is False else bound
            for place, bound in found.bounds.items()
        }
        if found.bounded is None:
            self.undecided["bounded"] = found.reason
        if None in self.data["bounds"].values():
            self.undecided["bounds"] = found.reason
        self._deadlocks()
        self.measures(Part.BEHAVIOUR)
        self._by_tree()
        count_instead(self.analysis, self.data, self.undecided)
        dead = self.data["deadlocks"]
        if dead is None or dead["marking"] is not None and dead["witness"] is None:
            self._deadlocks_by_proof()

    def _deadlocks_by_proof(self) -> None:
        # few nets need it, nor the solver that it imports
        from gspn_framework_package.analysis.proofs.answers import dead_marking

        found, counted = dead_marking(self.analysis), self.data["deadlocks"]
        if found is None:
            return
        if counted is not None:
            found["count"] = counted["count"]
        self.data["deadlocks"] = found
        reason = self.undecided.pop("deadlocks", "")
        if found["count"] is None:
            self.undecided["deadlocks.count"] = reason
            self.data["live"] = False
            self.undecided.pop("live", None)

    def _deadlocks(self) -> None:
        space = self.analysis.space
        dead = space.deadlocks
        if space.complete or len(dead):
            data: Dict[str, Any] = {
                "count": space.count(dead) if space.complete else None,
                "witness": None,
                "marking": None,
            }
            if len(dead):
                data["witness"] = space.path_to(int(dead[0]))
                data["marking"] = space.named(int(dead[0]))
            if not space.complete:
                self.undecided["deadlocks.count"] = "%d found within %s, not in all markings" % (
                    len(dead),
                    space.extent,
                )
            self.data["deadlocks"] = data
        else:
            self.data["deadlocks"] = None
            self.undecided["deadlocks"] = "none found within %s, not in all markings" % space.extent

    def _by_tree(self) -> None:
        """Answer the questions on an unbounded net that the coverability tree decides."""
        if self.analysis.boundedness.bounded is False and self.analysis.plan is None:
            if self.data["dead_transitions"] is None:
                self.undecided.pop("dead_transitions", None)
                self.answer("dead_transitions", lambda: self.analysis.tree.dead_transitions)
            dead = self.data["dead_transitions"]
            if dead and self.data["live"] is None:
                self.data["live"] = False
                self.undecided.pop("live", None)

    def reach(self, condition: str, find: Optional[Callable[[str], Reachability]] = None) -> None:
        """Answer whether a condition can ever hold.

        :param find: decides it; None: the analysis does.
        """
        self._search(
            "reach", condition, condition, lambda: (find or self.analysis.reach)(condition)
        )

    def cover(
        self,
        marking: Mapping[str, int],
        find: Optional[Callable[[Mapping[str, int]], Reachability]] = None,
    ) -> None:
        """Answer whether a marking with at least these tokens can be reached.

        :param find: decides it; None: the analysis does.
        """
        text = ",".join("%s=%d" % item for item in marking.items())
        self._search(
            "cover", text, at_least(marking), lambda: (find or self.analysis.cover)(marking)
        )

    def _search(
        self, question: str, what: str, condition: str, find: Callable[[], Reachability]
    ) -> None:
        key = "%s.%s" % (question, what)

        def compute() -> Dict[str, Any]:
            found = find()
            if found.reachable is None:
                from gspn_framework_package.analysis.proofs.answers import can_hold

                found = can_hold(self.analysis, condition) or found
            if found.reachable is None:
                extent = self.analysis.space.extent
                self.undecided[key] = "not found within %s, which are not all" % extent
            data = _reachability(what, found)
            if question == "cover":
                data["coverable"] = data.pop("reachable")
            return data

        self.data.setdefault(question, []).append(self._try(key, compute))

    def timed(self, questions: Questions) -> None:
        """Answer the questions about time."""
        if questions.timing:
            self.steady_state(questions.rewards)
            self.measures(Part.TIMING, self.undecided.get("steady_state", ""))
        if questions.at:
            self.at(questions)
        for condition in questions.mean_time_to:
            self.mean_time_to(condition, questions.at)

    def steady_state(self, rewards: Mapping[str, float]) -> None:
        """Answer the questions on the long run."""

        def compute() -> Dict[str, Any]:
            steady, measures, chain = (
                self.analysis.steady,
                self.analysis.measures,
                self.analysis.chain,
            )
            data = _measures(measures)
            data["mean_waiting_time"] = measures.mean_waiting_time
            unsure = _unsure(measures, Measures(chain, steady.errors))
            if unsure:
                data["unsure"] = unsure
            data["residual"] = steady.residual
            data["method"] = steady.method
            likeliest = steady.likeliest(COMPONENTS)
            data["components"] = [
                self._component(component, len(steady.components) > 1) for component in likeliest
            ]
            data["component_count"] = self._number_of(steady.components)
            space = self.analysis.space
            dead = [c.states for c in steady.components if self._is_deadlock(c)]
            data["deadlock_count"] = sum(space.count(chain.states[states]) for states in dead)
            data["probability_of_other_components"] = max(
                1.0 - sum(c.probability for c in likeliest), 0.0
            ) * (len(steady.components) > len(likeliest))
            self.undecided.update(uncounted(self.analysis.left_out))
            if rewards:
                data["reward"] = self._reward(measures, rewards)
            return data

        self.answer("steady_state", compute)

    def _component(self, component: Component, several: bool) -> Dict[str, Any]:
        """A recurrent class: its size, its probability, whether it is a deadlock, and its most
        probable marking."""
        chain, space = self.analysis.chain, self.analysis.space
        each = component.distribution
        if isinstance(space, LumpedSpace):  # per marking; sizes may exceed any float
            sizes = space.sizes[chain.states[component.states]].tolist()
            with np.errstate(divide="ignore"):
                each = np.log(each) - np.array([math.log(size) for size in sizes])
        likeliest = int(component.states[int(each.argmax())])
        part: Dict[str, Any] = {
            "states": space.count(chain.states[component.states]),
            "probability": component.probability,
            "deadlock": self._is_deadlock(component),
            "alike": self._alike(component),
            "marking": chain.graph.net.named(
                chain.graph.marking(int(chain.states[likeliest])), zeros=False
            ),
        }
        if several:
            whole = np.zeros(len(chain))
            whole[component.states] = component.distribution
            part.update(_measures(Measures(chain, whole)))
        return part

    def _is_deadlock(self, component: Component) -> bool:
        dead = self.analysis.space.is_dead
        states = self.analysis.chain.states[component.states]
        return len(states) == 1 and bool(dead[states[0]])

    def _alike(self, component: Component) -> Optional[int]:
        """The number of recurrent classes that this one represents when parts are exchanged; None:
        not decided."""
        space = self.analysis.space
        states = self.analysis.chain.states[component.states]
        if not isinstance(space, LumpedSpace) or (space.sizes[states] == 1).any():
            return 1
        return space.count(states) if self._is_deadlock(component) else None

    def _number_of(self, components: List[Component]) -> Optional[int]:
        """The number of recurrent classes; None, with the reason: not decided."""
        found = [self._alike(component) for component in components]
        if None in found:
            self.undecided["steady_state.component_count"] = (
                "not decided: one recurrent class may represent several that parts exchange into "
                "(analyse the whole, without --lump)"
            )
            return None
        return sum(number or 0 for number in found)

    def _reward(self, measures: Measures, rewards: Mapping[str, float]) -> float:
        net = self.analysis.net
        return measures.reward(
            {n: v for n, v in rewards.items() if n in net.place_index},
            {n: v for n, v in rewards.items() if n in net.transition_index},
        )

    def at(self, questions: Questions) -> None:
        """Answer the questions on given times."""

        def compute() -> List[Dict[str, Any]]:
            found = []
            for time, measures in self.analysis.at(questions.at):
                data = {"time": time, **_measures(measures)}
                if questions.rewards:
                    data["reward"] = self._reward(measures, questions.rewards)
                found.append(data)
            return found

        self.answer("transient", compute)

    def mean_time_to(self, condition: str, times: Tuple[float, ...]) -> None:
        """Answer when a condition first holds."""

        def compute() -> Dict[str, Any]:
            found = self.analysis.first_passage(condition, times)
            return {
                "condition": condition,
                "mean_time": found.mean_time,
                "probability": found.probability,
                "within": [{"time": t, "probability": p} for t, p in zip(times, found.within)],
                "residual": found.residual,
            }

        self.data.setdefault("mean_time_to", []).append(
            self._try("mean_time_to.%s" % condition, compute)
        )

    def finish(self) -> None:
        """Add the reasons for unanswered questions."""
        self.data["undecided"] = self.undecided


def _unsure(measures: Measures, errors: Measures) -> Dict[str, Dict[str, float]]:
    """The estimated relative errors of the means that are less accurate than
    :data:`UNSURE_ABOVE`."""
    found: Dict[str, Dict[str, float]] = {}
    for key in ("mean_tokens", "throughput"):
        values, doubts = getattr(measures, key), getattr(errors, key)
        for name, value in values.items():
            if doubts[name] > UNSURE_ABOVE * value:
                found.setdefault(key, {})[name] = doubts[name] / value if value > 0 else math.inf
    return found


def _measures(measures: Measures) -> Dict[str, Any]:
    return {
        "mean_tokens": measures.mean_tokens,
        "throughput": measures.throughput,
        "token_distribution": {
            place: {str(n): v for n, v in counts.items()}
            for place, counts in measures.token_distribution.items()
        },
    }


def _reachability(what: str, found: Reachability) -> Dict[str, Any]:
    way = found.witness
    return {
        "condition": what,
        "reachable": found.reachable,
        "count": found.number,
        "witness": None if way is None else [step.transition for step in way],
        "marking": way[-1].marking if way and way[-1].marking else None,
    }


def uncounted(left_out: Iterable[str]) -> Dict[str, str]:
    """Why omitted places have no mean tokens."""
    reason = "only written; it was left out"
    return dict.fromkeys(("steady_state.mean_tokens.%s" % place for place in left_out), reason)


def open_questions(data: Mapping[str, Any]) -> List[str]:
    """The keys of a report that were not decided, except for omitted counters and for answers that
    are never available on disk or by counting, unless they were requested."""
    passed = set(uncounted(data["left_out"]))
    if data["engine"] == ON_DISK:
        passed.update(measure.key for measure in MEASURES if measure.part is Part.BEHAVIOUR)
    return [
        key
        for key, reason in data["undecided"].items()
        if key not in passed and reason != NOT_COUNTED
    ]


def plain(value: Any) -> Any:
    """``value`` converted to what JSON can represent."""
    if isinstance(value, float):
        if math.isinf(value):
            return INFINITE
        return None if math.isnan(value) else value
    if isinstance(value, dict):
        return {key: plain(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(inner) for inner in value]
    return value
