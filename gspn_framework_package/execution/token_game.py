"""The token game: log entries in, firings and commands out. Pure and deterministic.

Everything that runs, shows or replays a plan goes through :class:`TokenGame`: the standalone
executor, each robot's node, the page, the recorder. Whoever reduces the same entries has the same
state.

After each entry (``docs/semantics.md``): first the immediate transitions with only resource inputs,
by priority and weight; then the robots that are done, the one done first first, where a higher
priority goes before; again from the start until nothing is enabled.
"""

from __future__ import annotations

from typing import Dict, Iterable, List, NamedTuple, Optional, Sequence, Tuple

from gspn_framework_package.execution import entries as log
from gspn_framework_package.execution.draw import choose, sample, uniform
from gspn_framework_package.execution.firing import (
    CancelAction,
    Command,
    Ended,
    Fault,
    Firing,
    Move,
    StartAction,
)
from gspn_framework_package.execution.team_state import (
    GONE,
    POLICY,
    Draw,
    Phase,
    RobotState,
    TeamState,
)
from gspn_framework_package.model.condition import parse_condition
from gspn_framework_package.model.plan import FailureKind, LostKind, Plan

FIRINGS_PER_ENTRY = 10_000
"""More firings than this after one entry are taken for a cycle without time, and cut off."""

ASKS_POLICY = ("", "None", None)
"""Results of an action that let the policy decide (thesis Algorithm 1)."""


class Step(NamedTuple):
    """What some entries brought about, in order."""

    firings: List[Firing]
    commands: List[Command]


class TokenGame:
    """The rules of one plan.

    :param plan: a validated plan.
    :param agents: standalone execution, where transitions may create and destroy agents (thesis
        4.1.2).
    """

    def __init__(self, plan: Plan, *, agents: bool = False) -> None:
        self.plan = plan
        self.net = net = plan.net
        self.agents = agents
        self._policy = plan.policy.bind(net)
        self._until = (
            parse_condition(plan.until, [p.name for p in net.places]) if plan.until else None
        )
        self._is_resource = [p.name in plan.resource_places for p in net.places]
        self._has_robots = [any(not self._is_resource[p] for p, _ in arcs) for arcs in net.inputs]
        self._makes_robots = [
            any(not self._is_resource[p] for p, _ in arcs) for arcs in net.outputs
        ]
        self._spontaneous = [
            t
            for t, transition in enumerate(net.transitions)
            if not transition.timed
            and not self._has_robots[t]
            and (agents or not self._makes_robots[t])
        ]
        self.environment_transitions = tuple(
            t
            for t, transition in enumerate(net.transitions)
            if transition.timed
            and not self._has_robots[t]
            and (agents or not self._makes_robots[t])
        )
        self._immediate = [
            tuple(t for t in leaving if not net.transitions[t].timed) for leaving in net.consumers
        ]
        self._urgency = [-1 if t.timed else t.priority for t in net.transitions]
        self._top_urgency = max(self._urgency, default=0)
        self._routing = {
            net.transition_number(t): {
                net.place_number(a): net.place_number(b) for a, b in routes.items()
            }
            for t, routes in plan.routing.items()
        }

    def new_state(self) -> TeamState:
        """The state before ``Start``: the resource tokens of the initial marking, and no robots."""
        marking = tuple(
            0 if not r else p.tokens for p, r in zip(self.net.places, self._is_resource)
        )
        return TeamState(marking)

    def start_entry(self, plan_hash: Optional[str] = None) -> log.Start:
        """The ``Start`` of the plan's own robots, each in its initial place, incarnation 0."""
        roster = tuple((r.name, r.place, 0) for r in self.plan.robots)
        return log.Start(roster, self.plan.seed, plan_hash or self.plan.hash(), self.plan.witness)

    def reduce(self, state: TeamState, slot: int, batch: Iterable[log.Entry]) -> Step:
        """Apply the entries of log slot ``slot`` to ``state``, which is changed, and settle after
        each.

        Entries that are stale (an old visit or incarnation, a robot that is gone) change nothing.
        """
        turn = _Turn(self, state, slot)
        for entry in batch:
            if state.ended is None:
                turn.apply(entry)
                turn.settle()
        state.next_slot = slot + 1
        return Step(turn.firings, turn.commands)

    # -- questions ---------------------------------------------------------------------------------

    def may_fire(self, state: TeamState, t: int) -> bool:
        """Whether ``t`` can fire now: enabled in the marking, with enough robots that are done and
        free for it."""
        if not self.net.is_enabled(state.marking, t):
            return False
        return all(
            self._has_free(state, p, t, weight)
            for p, weight in self.net.inputs[t]
            if not self._is_resource[p]
        )

    def free_robots(self, state: TeamState, p: int, t: int) -> List[RobotState]:
        """The robots that are done in place ``p`` and free for ``t``, the one done first first.

        One that named a transition is free for that one only: what an action found out is not
        overridden by a partner. One that lets the policy decide is free for every immediate
        transition.
        """
        robots = [state.robots[name] for name in state.done_in.get(p, ())]
        return [r for r in robots if self._is_free(r, t)]

    def _is_free(self, robot: RobotState, t: int) -> bool:
        return not robot.paused and (
            robot.request == t or (robot.request == POLICY and not self.net.transitions[t].timed)
        )

    def _has_free(self, state: TeamState, p: int, t: int, weight: int) -> bool:
        for name in state.done_in.get(p, ()):
            if self._is_free(state.robots[name], t):
                weight -= 1
                if weight == 0:
                    return True
        return False

    def why_waiting(self, state: TeamState, robot: RobotState) -> str:
        """Why a robot that is done does not move, for people; "" when it is not waiting."""
        if robot.phase is Phase.FAILED:
            return "its action failed (%s); waits for the operator" % robot.why
        if robot.phase is not Phase.DONE:
            return ""
        if state.paused or robot.paused:
            return "paused"
        t = (
            robot.request
            if robot.request != POLICY
            else (robot.drawn.transition if robot.drawn else None)
        )
        if t is None:
            return robot.why or "no transition is enabled"
        missing = self.net.why_disabled(state.marking, t)
        for p, weight in self.net.inputs[t]:
            if not self._is_resource[p]:
                lacking = weight - len(self.free_robots(state, p, t))
                if lacking > 0:
                    missing.append(
                        "needs %s in %s"
                        % (
                            "a robot" if lacking == 1 else "%d robots" % lacking,
                            self.net.places[p].name,
                        )
                    )
        return "wants %s: %s" % (
            self.net.transitions[t].name,
            "; ".join(missing) or "about to fire",
        )

    def is_inactive_place(self, p: int) -> bool:
        """Whether no arc leaves the place: a robot that is done there stays."""
        return not self.net.consumers[p]


class _Turn:
    """One call of :meth:`TokenGame.reduce`: the state, the position in the log, and what came out
    so far."""

    def __init__(self, game: TokenGame, state: TeamState, slot: int) -> None:
        self.game, self.net, self.plan = game, game.net, game.plan
        self.state = state
        self.slot = slot
        self.firings: List[Firing] = []
        self.commands: List[Command] = []

    # -- entries -----------------------------------------------------------------------------------

    def apply(self, entry: log.Entry) -> None:
        if isinstance(entry, log.Start):
            self._start(entry)
        elif isinstance(entry, log.Done):
            robot = self._current(entry.robot, entry.incarnation, entry.visit)
            if robot is not None:
                self._done(robot, entry.result)
        elif isinstance(entry, log.Failed):
            robot = self._current(entry.robot, entry.incarnation, entry.visit)
            if robot is not None and robot.attempt == entry.attempt:
                self._failed(robot, entry.reason, entry.detail)
        elif isinstance(entry, log.Retry):
            self._retry(entry.robot)
        elif isinstance(entry, log.Fire):
            self._environment(entry.transition)
        elif isinstance(entry, log.Join):
            self._join(entry)
        elif isinstance(entry, (log.Leave, log.Evict)):
            self._depart(entry)
        elif isinstance(entry, log.SetPlace):
            self._set_place(entry)
        elif isinstance(entry, (log.Pause, log.Resume)):
            self._pause(entry.robot, isinstance(entry, log.Pause))
        elif isinstance(entry, log.Stop):
            self._end(entry.reason, finished=False)

    def _start(self, entry: log.Start) -> None:
        if self.state.robots:
            return
        self.state.seed = entry.seed
        self.state.witnesses = tuple(entry.witnesses)
        for name, place, incarnation in entry.roster:
            self._add(RobotState(name, self.net.place_number(place), incarnation))
        self.state.created = len(entry.roster)
        for robot in list(self.state.robots.values()):
            self._enter(robot)

    def _current(self, name: str, incarnation: int, visit: int) -> Optional[RobotState]:
        """The robot, if it is still busy with that very visit."""
        robot = self.state.robots.get(name)
        if robot is None or robot.phase is not Phase.DOING:
            return None
        return robot if (robot.incarnation, robot.visit) == (incarnation, visit) else None

    def _done(self, robot: RobotState, result: Optional[str]) -> None:
        leaving = self.net.consumers[robot.place]
        if not leaving:
            robot.phase = Phase.INACTIVE
            return
        if result not in ASKS_POLICY:
            t = self.net.transition_index.get(str(result))
            if t is None or t not in leaving:
                self._failed(
                    robot,
                    "bad result",
                    "'%.200s' does not leave %s" % (result, self._name(robot.place)),
                )
                return
            self._ask(robot, t)
        elif self.game._immediate[robot.place]:
            self._ask(robot, POLICY)
        elif len(leaving) == 1:
            self._ask(robot, leaving[0])
        else:
            self._failed(
                robot,
                "bad result",
                "no transition was named, and %s has %d exponential ones"
                % (self._name(robot.place), len(leaving)),
            )

    def _ask(self, robot: RobotState, request: int) -> None:
        robot.request = request
        robot.failures = 0
        robot.why = ""
        self.state.add_waiting(robot)

    def _failed(self, robot: RobotState, reason: str, detail: str) -> None:
        rule = self.plan.failure_rule(self._name(robot.place))
        robot.why = reason + (": " + detail if detail else "")
        what = "the action of %s failed (%s)" % (self._name(robot.place), robot.why)
        if rule.kind is FailureKind.RETRY and robot.failures < rule.times:
            robot.failures += 1
            robot.attempt += 1
            self._fault(robot, "%s; attempt %d follows" % (what, robot.attempt))
            self._start_action(robot, rule.delay)
            return
        if rule.kind is FailureKind.FIRE:
            t = self.net.transition_number(rule.transition)
            if t in self.net.consumers[robot.place]:
                self._fault(robot, "%s; goes on with %s" % (what, rule.transition))
                self._ask(robot, t)
                return
        if rule.kind is FailureKind.STOP:
            self._fault(robot, what)
            self._end("%s: %s" % (robot.name, what), finished=False)
            return
        robot.phase = Phase.FAILED
        self._fault(robot, "%s; waits for the operator" % what)

    def _retry(self, name: str) -> None:
        robot = self.state.robots.get(name)
        if robot is not None and robot.phase is Phase.FAILED:
            robot.phase = Phase.DOING
            robot.failures = 0
            robot.attempt += 1
            robot.why = ""
            self._start_action(robot)

    def _environment(self, name: str) -> None:
        t = self.net.transition_index.get(name)
        if (
            t is None
            or self.game._has_robots[t]
            or (self.game._makes_robots[t] and not self.game.agents)
        ):
            self._fault(None, "'%s' is not a transition of the environment" % name)
        elif self.state.paused or not self.net.is_enabled(self.state.marking, t):
            self._fault(
                None,
                "'%s' cannot fire: %s"
                % (
                    name,
                    "; ".join(self.net.why_disabled(self.state.marking, t)) or "the team is paused",
                ),
            )
        else:
            self._fire(t, None, None)

    # -- membership and the operator ---------------------------------------------------------------

    def _join(self, entry: log.Join) -> None:
        robot = self.state.robots.get(entry.robot)
        if robot is None:
            p = self.net.place_index.get(entry.place)
            if p is None or self.game._is_resource[p]:
                self._fault(None, "%s cannot join in '%s'" % (entry.robot, entry.place))
                return
            robot = RobotState(entry.robot, p, entry.incarnation)
            self._add(robot)
            self._enter(robot)
        elif entry.incarnation <= robot.incarnation:
            return
        elif robot.phase in GONE:
            robot.incarnation = entry.incarnation
            robot.visit += 1
            self._add(robot)
            self._enter(robot)
        else:
            robot.incarnation = entry.incarnation
            if robot.phase is Phase.DOING:
                robot.attempt += 1
                self._start_action(robot)

    def _depart(self, entry: log.Entry) -> None:
        assert isinstance(entry, (log.Leave, log.Evict))
        robot = self.state.robots.get(entry.robot)
        if robot is None or robot.phase in GONE:
            return
        if isinstance(entry, log.Evict) and entry.incarnation != robot.incarnation:
            return
        self._cancel(robot)
        self.state.remove_waiting(robot)
        robot.phase = Phase.LOST if isinstance(entry, log.Evict) else Phase.LEFT
        robot.paused = False
        marking = list(self.state.marking)
        marking[robot.place] -= 1
        if robot.phase is Phase.LOST:
            for resource, count in self.plan.on_evict.get(self._name(robot.place), {}).items():
                marking[self.net.place_number(resource)] += count
        self.state.set_marking(tuple(marking))
        if robot.phase is Phase.LOST:
            self._fault(robot, "is lost; its token was in %s" % self._name(robot.place))
            self._on_lost(robot)

    def _on_lost(self, lost: RobotState) -> None:
        rule = self.plan.on_lost
        stuck = [
            r
            for r in map(self.state.robots.__getitem__, list(self.state.waiting))
            if self._needs(r, lost.place)
        ]
        if not stuck or rule.kind is LostKind.HOLD:
            return
        if rule.kind is LostKind.STOP:
            self._end(
                "%s is lost, and %s waits for it" % (lost.name, stuck[0].name), finished=False
            )
            return
        t = self.net.transition_number(rule.transition)
        for robot in stuck:
            if t in self.net.consumers[robot.place]:
                robot.request = t
                robot.drawn = None

    def _needs(self, robot: RobotState, place: int) -> bool:
        """Whether what ``robot`` asks for needs one more robot in ``place``."""
        t = (
            robot.request
            if robot.request != POLICY
            else (robot.drawn.transition if robot.drawn else None)
        )
        return t is not None and any(
            p == place and len(self.game.free_robots(self.state, p, t)) < weight
            for p, weight in self.net.inputs[t]
        )

    def _set_place(self, entry: log.SetPlace) -> None:
        robot = self.state.robots.get(entry.robot)
        p = self.net.place_index.get(entry.place)
        if robot is None or robot.phase in GONE or p is None or self.game._is_resource[p]:
            self._fault(robot, "'%s' cannot be put into '%s'" % (entry.robot, entry.place))
            return
        self._cancel(robot)
        self.state.remove_waiting(robot)
        marking = list(self.state.marking)
        marking[robot.place] -= 1
        marking[p] += 1
        self.state.set_marking(tuple(marking))
        robot.place = p
        robot.visit += 1
        self._enter(robot)

    def _pause(self, name: str, paused: bool) -> None:
        if not name:
            self.state.paused = paused
        elif name in self.state.robots:
            self.state.robots[name].paused = paused

    # -- robots ------------------------------------------------------------------------------------

    def _name(self, p: int) -> str:
        return self.net.places[p].name

    def _add(self, robot: RobotState) -> None:
        self.state.robots[robot.name] = robot
        marking = list(self.state.marking)
        marking[robot.place] += 1
        self.state.set_marking(tuple(marking))

    def _enter(self, robot: RobotState) -> None:
        """A visit begins: the action of the place starts, or the robot is done at once where there
        is none."""
        robot.attempt = 1
        robot.failures = 0
        robot.why = ""
        robot.phase = Phase.DOING
        if self.plan.action(robot.name, self._name(robot.place)) is None:
            self._done(robot, "")
        else:
            self._start_action(robot)

    def _start_action(self, robot: RobotState, delay: float = 0.0) -> None:
        self.commands.append(
            StartAction(
                robot.name,
                self._name(robot.place),
                robot.incarnation,
                robot.visit,
                robot.attempt,
                delay,
            )
        )

    def _cancel(self, robot: RobotState) -> None:
        if robot.phase is Phase.DOING:
            self.commands.append(CancelAction(robot.name, robot.visit))

    def _fault(self, robot: Optional[RobotState], message: str) -> None:
        self.commands.append(Fault(robot.name if robot else "", message))

    def _end(self, reason: str, finished: bool) -> None:
        if self.state.ended is None:
            self.state.ended = reason
            for robot in self.state.active():
                self._cancel(robot)
            self.commands.append(Ended(reason, finished))

    # -- settling ----------------------------------------------------------------------------------

    def settle(self) -> None:
        """Fire until nothing is enabled; then see whether the run is over."""
        fired = 0
        while self.state.ended is None and not self.state.paused:
            if self._reached_until() or not (self._fire_spontaneous() or self._fire_requested()):
                break
            fired += 1
            if fired >= FIRINGS_PER_ENTRY:
                self._fault(
                    None,
                    "%d firings without an action between them: a cycle without time; cut off"
                    % fired,
                )
                self._end("a cycle of immediate transitions", finished=False)
        active = self.state.active()
        if self.state.ended is None and active and all(r.phase is Phase.INACTIVE for r in active):
            self._end("every robot is in a place without output arcs", finished=True)

    def _reached_until(self) -> bool:
        if (
            self.game._until is not None
            and self.state.robots
            and self.game._until.holds(self.state.marking)
        ):
            self._end("until: %s" % self.plan.until, finished=True)
            return True
        return False

    def _fire_spontaneous(self) -> bool:
        enabled = [t for t in self.game._spontaneous if self.net.is_enabled(self.state.marking, t)]
        if not enabled:
            return False
        top = max(self.net.transitions[t].priority for t in enabled)
        choices = [
            (t, self.net.transitions[t].weight)
            for t in enabled
            if self.net.transitions[t].priority == top
        ]
        drawn = None
        if len(choices) > 1 and any(weight > 0 for _, weight in choices):
            t, drawn = choose(choices, self._uniform("")), self._position()
        else:
            t = choices[0][0]
        self._fire(t, None, drawn)
        return True

    def _fire_requested(self) -> bool:
        best: Optional[Tuple[int, RobotState]] = None
        refused = set()
        for name in self.state.waiting:
            robot = self.state.robots[name]
            if robot.paused:
                continue
            t = robot.request if robot.request != POLICY else self._policy_choice(robot)
            if t is None or t in refused:
                continue
            if not self.game.may_fire(self.state, t):
                refused.add(t)
                continue
            if best is None or self.game._urgency[t] > self.game._urgency[best[0]]:
                best = (t, robot)
                if self.game._urgency[t] == self.game._top_urgency:
                    break
        if best is None:
            return False
        t, robot = best
        held = robot.drawn if robot.request == POLICY else None
        self._fire(t, robot, (held.slot, held.index) if held else None)
        return True

    def _policy_choice(self, robot: RobotState) -> Optional[int]:
        """What the policy has ``robot`` ask for; it holds to a draw until the marking or its
        candidates change."""
        leaving = self.game._immediate[robot.place]
        distribution = self.game._policy.distribution(self.state.marking, robot.place)
        if distribution is not None:
            choices = self._of_top_priority(distribution.choices)
        elif self.game._policy.matches(self.state.marking):
            return self._nothing(
                robot, "the policy says nothing about %s in this marking" % self._name(robot.place)
            )
        elif self.plan.strict:
            return self._nothing(robot, "the policy has no row for this marking", fault=True)
        else:
            choices = self._of_top_priority(
                [
                    (t, self.net.transitions[t].weight)
                    for t in leaving
                    if self.game.may_fire(self.state, t)
                ]
            )
            if not any(weight > 0 for _, weight in choices):
                return self._nothing(
                    robot,
                    "the policy has no row for this marking, and no weight decides"
                    if choices
                    else "no immediate transition is enabled",
                )
        candidates = tuple(t for t, _ in choices)
        held = robot.drawn
        if held is None or (held.version, held.candidates) != (self.state.version, candidates):
            robot.why = ""
            robot.drawn = Draw(
                self.state.version,
                candidates,
                choose(choices, self._uniform(robot.name)),
                *self._position(),
            )
        return robot.drawn.transition if robot.drawn else None

    def _of_top_priority(self, choices: Sequence[Tuple[int, float]]) -> Sequence[Tuple[int, float]]:
        """The choices without those that an enabled one of higher priority goes before."""
        priorities = {self.net.transitions[t].priority for t, _ in choices}
        if len(priorities) < 2:
            return choices
        enabled = [
            self.net.transitions[t].priority
            for t, _ in choices
            if self.game.may_fire(self.state, t)
        ]
        floor = max(enabled, default=0)
        return [(t, p) for t, p in choices if self.net.transitions[t].priority >= floor]

    def _nothing(self, robot: RobotState, why: str, fault: bool = False) -> Optional[int]:
        robot.drawn = None
        if robot.why != why:
            robot.why = why
            if fault:
                self._fault(robot, why + "; it waits in %s" % self._name(robot.place))
        return None

    def _position(self) -> Tuple[int, int]:
        return self.slot, len(self.firings)

    def _uniform(self, who: str) -> float:
        return uniform(self.state.seed, *self._position(), who)

    # -- firing ------------------------------------------------------------------------------------

    def _fire(
        self, t: int, requester: Optional[RobotState], drawn: Optional[Tuple[int, int]]
    ) -> None:
        movers = self._bind(t, requester)
        incarnation, visit = (requester.incarnation, requester.visit) if requester else (0, 0)
        targets = self._targets(t, movers)
        self.state.set_marking(self.net.fire(self.state.marking, t))
        moves = []
        arrived = []
        for robot, target in zip(movers, targets):
            source = self._name(robot.place)
            self.state.remove_waiting(robot)
            if target is None:
                del self.state.robots[robot.name]
                moves.append(Move(robot.name, source, None, robot.visit + 1))
                continue
            robot.place = target
            robot.visit += 1
            moves.append(Move(robot.name, source, self._name(target), robot.visit))
            arrived.append(robot)
        for target in targets[len(movers) :]:
            assert target is not None
            self.state.created += 1
            robot = RobotState(str(self.state.created), target)
            self.state.robots[robot.name] = robot
            moves.append(Move(robot.name, None, self._name(target), robot.visit))
            arrived.append(robot)
        self.firings.append(
            Firing(
                self.slot,
                len(self.firings),
                self.net.transitions[t].name,
                requester.name if requester else "",
                incarnation,
                visit,
                tuple(moves),
                self.state.marking,
                drawn,
            )
        )
        for robot in arrived:
            self._enter(robot)

    def _bind(self, t: int, requester: Optional[RobotState]) -> List[RobotState]:
        """The robots that ``t`` takes, place by place in the order of the arcs; the one that asked
        is among them."""
        movers: List[RobotState] = []
        for p, weight in self.net.inputs[t]:
            if not self.game._is_resource[p]:
                free = self.game.free_robots(self.state, p, t)
                if requester in free[weight:]:
                    free = free[: weight - 1] + [requester]
                movers += free[:weight]
        return movers

    def _targets(self, t: int, movers: List[RobotState]) -> List[Optional[int]]:
        """Where each mover goes (None: nowhere, it becomes Void), then where new agents appear."""
        slots = [
            p
            for p, weight in self.net.outputs[t]
            if not self.game._is_resource[p]
            for _ in range(weight)
        ]
        surplus = len(movers) - len(slots)
        void = set()
        if surplus > 0:
            void = set(
                sample(range(len(movers)), surplus, self.state.seed, *self._position(), "void")
            )
        routes = self.game._routing.get(t, {})
        targets: Dict[int, int] = {}
        for i, robot in enumerate(movers):
            wanted = routes.get(robot.place)
            if i not in void and wanted in slots:
                slots.remove(wanted)
                targets[i] = wanted
        for i in range(len(movers)):
            if i not in void and i not in targets:
                targets[i] = slots.pop(0)
        return [targets.get(i) for i in range(len(movers))] + list(slots)
