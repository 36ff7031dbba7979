"""Observes a run in its log: how often each transition fired, where the tokens were, what the
policy chose, and what happened that the model does not include."""

from __future__ import annotations

from dataclasses import replace
from typing import Dict, List, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.firing import Firing
from gspn_framework_package.execution.replayer import Replayed
from gspn_framework_package.execution.team_state import TeamState
from gspn_framework_package.model.net import Marking
from gspn_framework_package.model.plan import Plan, RobotSpec

MOST_NOTES = 5


class PolicyChoice(NamedTuple):
    """The policy's choice of ``chosen`` at time ``at`` (s) in ``place``, by the probabilities of
    the ``row``."""

    at: float
    place: str
    row: Tuple[Tuple[str, float], ...]
    chosen: str


class ChoiceReader:
    """Reads the policy's choices from firings.

    Only choices between transitions that could all fire at once are read. A robot that draws a
    transition that must wait may draw again before it fires, so the firings would be a biased
    sample of the draws.

    :param plan: the plan whose rows apply.
    """

    def __init__(self, plan: Plan) -> None:
        self._net = plan.net
        self._table = plan.policy.bind(plan.net)
        self._alone = [flow.taken == 1 for flow in plan.flows]
        self._strict = plan.strict

    def read(self, firing: Firing, marking: Marking, at: float) -> Optional[PolicyChoice]:
        """The choice that led to a firing, if there was one; ``marking`` is the previous marking,
        in the order of the plan's places."""
        if firing.drawn is None or not firing.robot:
            return None
        source = next((m.source for m in firing.moves if m.robot == firing.robot), None)
        place = self._net.place_index.get(source) if source is not None else None
        if place is None or source is None:
            return None
        row = self._row(marking, place)
        if len(row) < 2:
            return None
        names = tuple((self._net.transitions[t].name, p) for t, p in row)
        return PolicyChoice(at, source, names, firing.transition)

    def _row(self, marking: Marking, place: int) -> Sequence[Tuple[int, float]]:
        net = self._net
        row: Optional[Sequence[Tuple[int, float]]] = self._table.choices(marking, place)
        if row is not None:
            if not all(net.is_enabled(marking, t) for t, _ in row):
                return ()
        elif self._strict:
            return ()
        else:
            row = [
                (t, net.value(marking, t))
                for t in net.immediate_from[place]
                if net.is_enabled(marking, t)
            ]
        if len({net.transitions[t].priority for t, _ in row}) > 1:
            return ()
        if not all(self._alone[t] for t, _ in row):
            return ()
        total = sum(p for _, p in row)
        return [(t, p / total) for t, p in row if p > 0] if total > 0 else ()


class RunObserver:
    """Accumulates the observations of a run, step by step.

    :param plan: the plan to compare with; its net has the same places and transitions as that of
        the run, in any order.

    :ivar began: when the run began (s); None before that.
    :ivar ended: when it ended (s); None while it is running.
    :ivar came: whether it met the condition of its plan.
    :ivar firings: transition -> number of firings.
    :ivar choices: the choices of the policy.
    :ivar notes: notes for people on what the prediction does not include.
    """

    def __init__(self, plan: Plan, run_plan: Plan) -> None:
        self._plan, self._net = plan, run_plan.net
        self._order = [self._net.place_index[p.name] for p in plan.net.places]
        self._reader = ChoiceReader(plan)
        self.began: Optional[float] = None
        self.ended: Optional[float] = None
        self.came = False
        self.firings: Dict[str, int] = {t.name: 0 for t in plan.net.transitions}
        self.choices: List[PolicyChoice] = []
        self.notes: List[str] = []
        self._more_notes = 0
        self._robots: List[RobotSpec] = []
        self._start: Dict[str, int] = {}
        self._marking: Marking = ()
        self._tokens = [0.0] * len(plan.net.places)
        self._now = 0.0

    def take(self, step: Replayed, now: float) -> None:
        """Process the next step of the run, at ``now`` (s)."""
        state = step.state
        if self.began is None:
            if not state.robots:
                return
            self._begin(step.entries, state, now)
        if self.ended is not None:
            return
        self.wait(now)
        for entry in step.entries:
            self._note(entry, now)
        for firing in step.firings:
            self.firings[firing.transition] += 1
            before = list(firing.marking)
            for p, gain in self._net.effect(self._net.transition_index[firing.transition]):
                before[p] -= gain
            choice = self._reader.read(firing, tuple(before[p] for p in self._order), now)
            if choice is not None:
                self.choices.append(choice)
        self._marking = tuple(state.marking[p] for p in self._order)
        if state.ended is not None:
            self.ended = now
            self.came = state.finished and state.ended.startswith("until:")

    def wait(self, now: float) -> None:
        """Advance the time to ``now`` (s) without a step."""
        if self.began is None or self.ended is not None or now <= self._now:
            return
        for p, count in enumerate(self._marking):
            if count:
                self._tokens[p] += count * (now - self._now)
        self._now = now

    def start_of(self, plan: Plan) -> Plan:
        """``plan`` with the robots and the marking at the start of the run. A robot that the plan
        knows keeps its own actions."""
        own = {robot.name: robot.actions for robot in plan.robots}
        robots = tuple(r._replace(actions=own.get(r.name, {})) for r in self._robots)
        resources = {
            name: count for name, count in self._start.items() if name in plan.resource_places
        }
        team = plan.with_robots(list(robots))
        marking = {**team.net.named(team.net.initial_marking), **resources}
        return replace(team, net=team.net.with_marking(marking))

    @property
    def seconds(self) -> float:
        """How long the run has been observed."""
        return 0.0 if self.began is None else self._now - self.began

    @property
    def robots(self) -> List[str]:
        """The robots with which the run began."""
        return [robot.name for robot in self._robots]

    @property
    def tokens(self) -> Dict[str, float]:
        """Place -> token-seconds so far."""
        return {p.name: s for p, s in zip(self._plan.net.places, self._tokens)}

    def all_notes(self) -> List[str]:
        """The notes, and the number of those left out."""
        if not self._more_notes:
            return list(self.notes)
        return [*self.notes, "and %d more such events" % self._more_notes]

    def _begin(self, entries: Sequence[log_entries.Entry], state: TeamState, now: float) -> None:
        self.began = self._now = now
        start = next((e for e in entries if isinstance(e, log_entries.Start)), None)
        if start is not None:
            self._robots = [RobotSpec(name, place) for name, place, _ in start.roster]
            initial = self._net.initial_marking
        else:
            self._robots = [
                RobotSpec(r.name, self._net.places[r.place].name) for r in state.active()
            ]
            initial = state.marking
            self.notes.append(
                "the log begins in mid-run; the prediction starts there, with fresh actions"
            )
        self._start = {p.name: n for p, n in zip(self._net.places, initial)}
        self._marking = tuple(initial[p] for p in self._order)

    def _note(self, entry: log_entries.Entry, now: float) -> None:
        text = _UNFORESEEN.get(type(entry))
        if text is None or self.began is None:
            return
        if len(self.notes) >= MOST_NOTES:
            self._more_notes += 1
            return
        whom = getattr(entry, "robot", "") or "the team"
        self.notes.append(
            "%s %s after %.1f s, which the prediction does not include"
            % (whom, text, now - self.began)
        )


_UNFORESEEN = {
    log_entries.Join: "joined",
    log_entries.Leave: "left",
    log_entries.Evict: "was lost",
    log_entries.SetPlace: "was moved to another place",
    log_entries.Pause: "was paused",
    log_entries.Retry: "was ordered to try again",
    log_entries.CancelTask: "was ordered to cancel a task",
    log_entries.GiveBack: "was ordered to give a task back",
}
