"""The run itself as exact steps: the token game of ``execution``, with every draw in it enumerated.

Nothing of the game is stated again here. A state is written down as what the game needs to go on
from it: where each robot is and what it is up to, and what it has drawn. Each step builds the game's own state of it, applies one log entry, and lets the game settle
until its first firing. Where the game draws a number, all that it may choose is followed.

What this module does state is time: phases end at their rates, an action that takes no time ends
before time passes, events and losses come at their rates. So durations must be made of exponential
phases, and there are no timeouts.
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import replace
from typing import (
    Any,
    Callable,
    Dict,
    Iterable,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
)
from unittest import mock

from gspn_framework_package.execution import log_entries, turn
from gspn_framework_package.execution.firing import StartAction
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.team_state import Draw, RobotState, TeamState
from gspn_framework_package.execution.token_game import TokenGame, _Reducer
from gspn_framework_package.model.outcome import Outcome
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.plan_timing import POLICY, PlaceTiming, PlanTiming
from gspn_framework_package.run_net.phases import phases_of
from meaning.numbers import Marking

# What a robot is up to.
BEGINS, DOES, DONE, FAILED, REST = range(5)


class Robot(NamedTuple):
    """A robot in a state.

    :ivar own: the number of the robot of the plan with the same actions of its own; 0: none.
    :ivar what: BEGINS (its duration has no phase yet), DOES, DONE, FAILED or REST.
    :ivar at: the phase of its duration, or what it asks for when it is done.
    :ivar failures: failed attempts of this visit.
    :ivar drawn: its last draw: (candidates, transition), and whether the marking is the same.
    :ivar held: the events that are held for it.
    """

    own: int
    place: int
    what: int
    at: int = 0
    failures: int = 0
    drawn: Optional[Tuple[Tuple[int, ...], int, bool]] = None
    held: Tuple[int, ...] = ()


class State(NamedTuple):
    """A state of the run.

    :ivar robots: those that are done come first, then those that begin, then the others; each of
        these in any order.
    :ivar settled: whether nothing can fire any more.
    """

    robots: Tuple[Robot, ...]
    resources: Tuple[int, ...]
    settled: bool
    ended: bool = False
    started: bool = True


class _FiredError(Exception):
    """Ends a turn after its first firing."""


class Chances:
    """Follows all that a computation with draws may come to, one after the other.

    :ivar probability: that of the way which is followed at present.
    """

    def __init__(self) -> None:
        self._given: Tuple[int, ...] = ()
        self._taken: List[int] = []
        self._more: List[Tuple[int, ...]] = []
        self.probability = 1.0

    def ways(self, compute: Callable[[], Any]) -> Iterator[Tuple[Any, float]]:
        """The results of ``compute``, with their probabilities."""
        self._more = [()]
        while self._more:
            self._given = self._more.pop()
            self._taken = []
            self.probability = 1.0
            result = compute()
            yield result, self.probability

    def one_of(self, weights: Sequence[float]) -> int:
        """The index of one of these weights."""
        total = math.fsum(weights)
        able = [i for i, weight in enumerate(weights) if weight > 0]
        number = len(self._taken)
        if number < len(self._given):
            chosen = self._given[number]
        else:
            chosen = able[0]
            for other in able[1:]:
                self._more.append((*self._taken, other))
        self._taken.append(chosen)
        self.probability *= weights[chosen] / total
        return chosen


class _OneFiring(_Reducer):
    """A turn of the game that ends after its first firing."""

    def __init__(
        self,
        game: TokenGame,
        state: TeamState,
        chances: Chances,
        robots: Sequence[Robot],
    ) -> None:
        super().__init__(game, state, 0)
        self.chances = chances
        self.own = [robot.own for robot in robots]
        if any(self.own):  # its robots are named by their numbers here
            specs = self.plan.robots
            mine = [specs[own - 1]._replace(name=str(i)) for i, own in enumerate(self.own) if own]
            self.plan = replace(self.plan, robots=tuple(mine))

    def _fire(self, *args: Any, **more: Any) -> None:
        super()._fire(*args, **more)
        raise _FiredError

    def _shuffled(self, items: Iterable[Any], what: str) -> Iterator[Any]:
        left = list(items)
        while left:
            alike: Dict[Any, List[Any]] = {}
            for item in left:
                name = item.name if isinstance(item, RobotState) else item
                alike.setdefault(self._kind(name), []).append(item)
            kinds = list(alike.values())
            item = kinds[self.chances.one_of([len(kind) for kind in kinds])][0]
            left.remove(item)
            yield item

    def _kind(self, name: Any) -> Any:
        """What it depends on how a robot continues; a number is a kind of its own."""
        if not isinstance(name, str):
            return name
        robot = self.state.robots[name]
        own = self.own[int(name)] if int(name) < len(self.own) else 0
        return (
            own,
            robot.place,
            robot.request,
            robot.drawn
            and (
                robot.drawn.version == self.state.version,
                robot.drawn.candidates,
                robot.drawn.transition,
            ),
        )


class RunSteps:
    """The run of a plan as steps (see :class:`~meaning.numbers.Steps`).

    :param plan: a validated plan.
    :param losses: rate (1/s) at which each robot is lost.
    :param failing: whether actions fail as the plan says. The optimiser leaves failures out.
    :raises ValueError: a duration is not made of exponential phases, or there are timeouts.
    """

    def __init__(self, plan: Plan, *, losses: float = 0.0, failing: bool = False) -> None:
        self.plan, self.losses, self.failing = plan, losses, failing
        self.net = plan.net
        self.game = TokenGame(plan, agents=True)
        self.timing = PlanTiming(plan)
        self._resources = [
            p for p, place in enumerate(self.net.places) if place.name in plan.resource_places
        ]
        self._counters = {self.net.place_number(name) for name in plan.counters}
        self._own = _kinds_of_robots(plan)
        self._events = {
            self.net.place_number(name): [
                self.net.transition_number(t) for t in plan.interrupts(name)
            ]
            for name in plan.action_places
        }
        if plan.timeouts:
            raise ValueError("timeouts have no rates")
        robots = tuple(
            Robot(own, self.net.place_number(robot.place), BEGINS)
            for own, robot in zip(self._own, plan.robots)
        )
        resources = tuple(
            0 if p in self._counters else self.net.places[p].tokens for p in self._resources
        )
        self.start = State(self._ordered(robots), resources, settled=False, started=False)

    # -- what steps offer --------------------------------------------------------------------------

    def expand(self, state: State) -> Tuple[bool, List[Tuple[State, int, float]]]:
        """See :class:`~meaning.numbers.Steps`."""
        if state.ended:
            return False, []
        if not state.settled:
            return True, list(self._turn(state, None, 1.0))
        beginning = [i for i, robot in enumerate(state.robots) if robot.what == BEGINS]
        for i in beginning:
            entry = self._entry(state.robots[i])
            if entry is not None:  # its duration begins with one of these phases
                found = []
                for phase, chance in entry:
                    robots = list(state.robots)
                    robots[i] = robots[i]._replace(what=DOES, at=phase)
                    found.append((state._replace(robots=self._ordered(robots)), -1, chance))
                return True, found
        if beginning:  # actions that take no time end, one after the other
            chance = 1.0 / len(beginning)
            return True, [arc for i in beginning for arc in self._ends(state, i, chance)]
        return False, self._timed(state)

    def marking(self, state: State) -> Marking:
        """See :class:`~meaning.numbers.Steps`."""
        return tuple(self._count(state))

    def over(self, state: State) -> bool:
        """Whether the run has ended in ``state``."""
        return state.ended

    # -- time --------------------------------------------------------------------------------------

    def _timed(self, state: State) -> List[Tuple[State, int, float]]:
        found: List[Tuple[State, int, float]] = []
        net, marking = self.net, self._count(state)
        for i, robot in enumerate(state.robots):
            for t in self._events[robot.place]:
                entry = log_entries.Interrupt(str(i), 0, 1, net.transitions[t].name)
                found += self._turn(state, entry, net.transitions[t].number)
            if self.losses:
                found += self._turn(state, log_entries.Evict(str(i), 0), self.losses)
            if robot.what != DOES:
                continue
            phases = phases_of(self._time(robot).duration)
            assert phases is not None
            rate, following = phases.rates[robot.at], phases.following[robot.at]
            if following < 0:
                found += self._ends(state, i, rate)
            else:
                robots = list(state.robots)
                robots[i] = robot._replace(at=following)
                found.append((state._replace(robots=self._ordered(robots)), -1, rate))
        for t in self.game.environment_transitions:
            if net.is_enabled(marking, t):
                rate = self._rate(marking, t) * self._servers(marking, t)
                found += self._turn(state, log_entries.Fire(net.transitions[t].name), rate)
        return found

    def _rate(self, marking: Sequence[int], t: int) -> float:
        """The rate of one server."""
        transition = self.net.transitions[t]
        if transition.function is None:
            return transition.number
        return transition.function.value(self.net.named(marking))

    def _servers(self, marking: Sequence[int], t: int) -> int:
        """How many servers of a transition of the environment are busy."""
        times = [marking[p] // weight for p, weight in self.net.inputs[t]]
        servers = self.net.transitions[t].servers
        return min([*times, *([] if servers is None else [servers])], default=1)

    def _ends(self, state: State, i: int, value: float) -> List[Tuple[State, int, float]]:
        """An attempt of robot ``i`` ends: it fails, or its action names what comes next."""
        timing = self._time(state.robots[i])
        failure = timing.failure if self.failing else 0.0
        found: List[Tuple[State, int, float]] = []
        if failure:
            attempt = state.robots[i].failures + 1
            entry = log_entries.Failed(str(i), 0, 1, attempt, Outcome.ABORTED.value)
            found += self._turn(state, entry, value * failure)
        for t, chance in timing.outcomes or ((POLICY, 1.0),):
            name = "" if t == POLICY else self.net.transitions[t].name
            if chance > 0:
                done = log_entries.Done(str(i), 0, 1, name)
                found += self._turn(state, done, value * (1.0 - failure) * chance)
        return found

    def _time(self, robot: Robot) -> PlaceTiming:
        name = self.plan.robots[robot.own - 1].name if robot.own else ""
        return self.timing.of(name, robot.place)

    def _entry(self, robot: Robot) -> Optional[Tuple[Tuple[int, float], ...]]:
        """The first phases of a robot's action; None if it takes no time."""
        duration = self._time(robot).duration
        if duration.mean == 0:
            return None
        phases = phases_of(duration)
        if phases is None or phases.matched:
            raise ValueError("%s is not made of phases" % duration.describe())
        return phases.start

    # -- the game ----------------------------------------------------------------------------------

    def _turn(self, state: State, entry: Any, value: float) -> Iterator[Tuple[State, int, float]]:
        """What the game makes of ``entry`` (None: it only goes on), until its first firing."""
        chances = Chances()

        def play() -> Tuple[State, int]:
            return self._play(state, entry, chances)

        for (target, fired), chance in chances.ways(play):
            yield target, fired, value * chance

    def _play(self, state: State, entry: Any, chances: Chances) -> Tuple[State, int]:
        team = self._team(state)
        one = _OneFiring(self.game, team, chances, state.robots)
        settled = False
        with _drawn(chances):
            try:
                if entry is not None:
                    one.apply(entry)
                elif not state.started:
                    for robot in list(team.robots.values()):
                        one._enter(robot)
                one.settle()
                settled = True
            except _FiredError:
                pass
        fired = self.net.transition_index[one.firings[0].transition] if one.firings else -1
        return self._written(state, one, settled), fired

    def _team(self, state: State) -> TeamState:
        """The game's own state."""
        team = TeamState(tuple(self._count(state)), draws_ties=True)
        for i, robot in enumerate(state.robots):
            mine = RobotState(str(i), robot.place, attempt=robot.failures + 1)
            mine.failures = robot.failures
            mine.held = {t: {} for t in robot.held}
            team.robots[mine.name] = mine
            if robot.what == DONE:
                team.add_waiting(mine)
                mine.request = robot.at
                if robot.drawn is not None:
                    candidates, transition, holds = robot.drawn
                    mine.drawn = Draw(team.version - (not holds), candidates, transition, 0, 0)
            elif robot.what == FAILED:
                mine.phase = Phase.FAILED
            elif robot.what == REST:
                mine.phase = Phase.INACTIVE
        team.created = len(state.robots)
        return team

    def _written(self, before: State, one: _OneFiring, settled: bool) -> State:
        """The state that the game has come to."""
        team = one.state
        begun = [c.robot for c in one.commands if isinstance(c, StartAction)]
        old = dict(zip(map(str, range(len(before.robots))), before.robots))
        robots: List[Robot] = []
        still = [name for name in team.robots if name not in team.waiting and name not in begun]
        for name in dict.fromkeys([*team.waiting, *still, *begun]):
            robot = team.robots.get(name)
            if robot is None or robot.phase.gone:
                continue
            was = old.get(name, Robot(0, robot.place, BEGINS))
            now = Robot(was.own, robot.place, BEGINS, 0, robot.failures, held=tuple(robot.held))
            if robot.phase is Phase.DONE:
                draw = robot.drawn
                now = now._replace(
                    what=DONE,
                    at=robot.request,
                    drawn=None
                    if draw is None
                    else (draw.candidates, draw.transition, draw.version == team.version),
                )
            elif robot.phase is not Phase.DOING:
                now = now._replace(what=FAILED if robot.phase is Phase.FAILED else REST)
            elif name not in begun:
                now = now._replace(what=was.what, at=was.at)
            robots.append(now)
        resources = tuple(0 if p in self._counters else team.marking[p] for p in self._resources)
        return State(self._ordered(robots), resources, settled, team.ended is not None)

    def _ordered(self, robots: Sequence[Robot]) -> Tuple[Robot, ...]:
        """The robots in their one order: robots that are alike have no names."""
        done = [robot for robot in robots if robot.what == DONE]
        begin = [robot for robot in robots if robot.what == BEGINS]
        others = [robot for robot in robots if robot.what not in (DONE, BEGINS)]
        return (*sorted(done, key=_key), *sorted(begin, key=_key), *sorted(others, key=_key))

    def _count(self, state: State) -> List[int]:
        marking = [0] * len(self.net.places)
        for robot in state.robots:
            marking[robot.place] += 1
        for p, count in zip(self._resources, state.resources):
            marking[p] = count
        return marking


class NetRunSteps(RunSteps):
    """The classical reading of a plan as steps, with the choices of the run: in every marking all
    robots that the policy moves draw, in any order; exponential transitions race at the rates of
    the net. A state is a marking, and whether the robots wait in it."""

    def __init__(self, plan: Plan) -> None:
        super().__init__(replace(plan, timeouts={}))
        self._deciding = {
            p
            for p, leaving in enumerate(self.net.consumers)
            if p not in self._resources and any(not self.net.transitions[t].timed for t in leaving)
        }
        self.start: Any = self._without_counters([p.tokens for p in self.net.places]), False

    def expand(self, state: Any) -> Tuple[bool, List[Tuple[Any, int, float]]]:
        """See :class:`~meaning.numbers.Steps`."""
        marking, waits = state
        robots = [
            Robot(0, p, DONE if p in self._deciding else DOES, POLICY)
            for p, count in enumerate(marking)
            if p not in self._resources
            for _ in range(count)
        ]
        before = State(self._ordered(robots), tuple(marking[p] for p in self._resources), False)
        if not waits:
            found = []
            for after, fired, chance in self._turn(before, None, 1.0):
                if after.ended:
                    return False, []
                found.append(((tuple(self._count(after)), after.settled), fired, chance))
            return True, found
        return False, [
            ((self._without_counters(self.net.fire(marking, t)), False), t, rate)
            for t, rate in self._racing(marking)
        ]

    def marking(self, state: Any) -> Marking:
        """See :class:`~meaning.numbers.Steps`."""
        marking: Marking = state[0]
        return marking

    def over(self, state: Any) -> bool:
        """Whether the run has ended in ``state``."""
        return not state[1]

    def _racing(self, marking: Marking) -> Iterator[Tuple[int, float]]:
        events = {t: p for p, here in self._events.items() for t in here}
        for t, transition in enumerate(self.net.transitions):
            if not transition.timed or not self.net.is_enabled(marking, t):
                continue
            if t in events:
                yield t, transition.number * marking[events[t]]
            elif self.game.flows[t].taken:  # each robot has its own server
                degree = min(marking[p] // weight for p, weight in self.net.inputs[t])
                yield t, transition.number * degree
            else:
                yield t, self._rate(marking, t) * self._servers(marking, t)

    def _without_counters(self, marking: Sequence[int]) -> Marking:
        return tuple(0 if p in self._counters else n for p, n in enumerate(marking))


def _key(robot: Robot) -> Any:
    return robot._replace(drawn=robot.drawn or ((), -2, False))


def _kinds_of_robots(plan: Plan) -> List[int]:
    """For each robot 0, or the number (from 1) of the first robot with the same own actions."""
    found = []
    for robot in plan.robots:
        alike = [i for i, other in enumerate(plan.robots, 1) if other.actions == robot.actions]
        found.append(alike[0] if robot.actions else 0)
    return found


@contextlib.contextmanager
def _drawn(chances: Chances) -> Iterator[None]:
    """In place of the random numbers of a turn: all that they may choose."""

    def choose(choices: Any, number: float) -> Any:
        return choices[chances.one_of([weight for _, weight in choices])][0]

    with mock.patch.object(turn, "choose", choose):
        yield
