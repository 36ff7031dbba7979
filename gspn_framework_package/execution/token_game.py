"""The token game: log entries in, firings and commands out. Pure and deterministic.

Everything that runs, shows or replays a plan uses :class:`TokenGame`: the standalone executor, each
robot's node, the page and the recorder. The same entries always lead to the same state. ``rules``
holds the rules themselves, and ``turn`` determines what fires when; this module applies the entries
of the log.
"""

from __future__ import annotations

from typing import Any, Dict, Iterable, List, Mapping, NamedTuple, Optional, Tuple, Union

from gspn_framework_package.execution import log_entries, plan_change
from gspn_framework_package.execution.firing import CancelAction, Firing, GameCommand
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.rules import Rules
from gspn_framework_package.execution.task_turn import TaskTurn
from gspn_framework_package.execution.team_state import RobotState, StagedPlan, TeamState
from gspn_framework_package.execution.team_tasks import Task, rank
from gspn_framework_package.model.errors import GspnError, LogError
from gspn_framework_package.model.kept import Kept
from gspn_framework_package.model.plan import LostKind
from gspn_framework_package.model.plan_timing import POLICY

INTERRUPTIBLE = (Phase.DOING, Phase.DONE, Phase.FAILED)
"""The phases in which an event can interrupt a robot."""


class Step(NamedTuple):
    """The effects of some entries, in order. ``adopted`` holds the plans that the team adopted in
    between: (number of preceding firings, the rules from there on). The entries ``late`` came after
    the end of the run and have none."""

    firings: List[Firing]
    commands: List[GameCommand]
    adopted: Tuple[Tuple[int, TokenGame], ...] = ()
    late: Tuple[log_entries.Entry, ...] = ()

    def game(self, before: TokenGame) -> TokenGame:
        """The rules after these entries."""
        return self.adopted[-1][1] if self.adopted else before

    def game_of(self, firing: int, before: TokenGame) -> TokenGame:
        """The rules under which the firing with this number happened, from 0."""
        if not self.adopted:
            return before
        game = before
        for begin, adopted in self.adopted:
            if firing >= begin:
                game = adopted
        return game


def robots_in(
    state: TeamState, entries: Iterable[log_entries.Entry], step: Step
) -> Dict[str, None]:
    """The names of the robots whose visits may have begun or ended with a step: those named by its
    entries, those that moved, and at the start all robots, in this order."""
    entries = list(entries)
    names = dict.fromkeys(getattr(entry, "robot", "") for entry in entries)
    names.update((move.robot, None) for firing in step.firings for move in firing.moves)
    if any(isinstance(entry, log_entries.Start) for entry in entries):
        names.update(dict.fromkeys(state.robots))
    names.pop("", None)
    return names


GAMES = 8
"""Number of adopted plans whose rules are cached."""

_games: Kept[Tuple[str, bool], TokenGame] = Kept(GAMES)


def adopted_game(staged: StagedPlan, agents: bool) -> TokenGame:
    """The rules of a plan that was staged. :raises GspnError: it cannot be read."""
    return _games.get(
        (staged.digest, agents), lambda: TokenGame(plan_change.plan_of(staged), agents=agents)
    )


class TokenGame(Rules):
    """The token game of one plan: see :class:`~gspn_framework_package.execution.rules.Rules`.

    Once a team has adopted another plan, the token game of that plan applies:
    :meth:`Step.game` after each step, :meth:`now` for a state.
    """

    def now(self, state: TeamState) -> TokenGame:
        """The rules that apply in a state of a run that began with this plan."""
        return adopted_game(state.adopted, self.agents) if state.adopted else self

    def _game_of(self, data: Mapping[str, Any]) -> TokenGame:
        """The rules that apply in a state given as a JSON object."""
        try:
            adopted = data.get("adopted")
            return adopted_game(StagedPlan.from_json(adopted), self.agents) if adopted else self
        except (KeyError, TypeError, ValueError, AttributeError, GspnError) as error:
            raise LogError("the adopted plan cannot be read (%s)" % error) from None

    def new_state(self) -> TeamState:
        """The state before ``Start``: the resource tokens of the initial marking, and no robots."""
        marking = tuple(0 if acts else p.tokens for p, acts in zip(self.net.places, self.acts))
        state = TeamState(marking)
        state.queues = {p: [Task()] * marking[p] for p in self.queues if marking[p]}
        return state

    def state_from_json(self, data: Dict[str, Any]) -> TeamState:
        """Parse a state of a run that began with this plan.

        :raises LogError: it is not a state of this plan, or of the one that was adopted.
        """
        game = self._game_of(data)
        return TeamState.from_json(data, game.net, game.queues)

    def start_entry(self, plan_hash: Optional[str] = None) -> log_entries.Start:
        """The ``Start`` of the plan's own robots, each in its initial place with incarnation 0."""
        roster = tuple((r.name, r.place, 0) for r in self.plan.robots)
        return log_entries.Start(
            roster, self.plan.seed, plan_hash or self.plan.hash(), self.plan.witness, True
        )

    def reduce(self, state: TeamState, slot: int, batch: Iterable[log_entries.Entry]) -> Step:
        """Apply the entries of log slot ``slot`` to ``state`` in place, and settle after each.

        Stale entries (an old visit or incarnation, a robot that is gone) change nothing.
        """
        turn = _Reducer(self, state, slot)
        late: List[log_entries.Entry] = []
        for entry in batch:
            if state.ended is None:
                turn.apply(entry)
                turn.settle()
            else:
                late.append(entry)
        state.next_slot = slot + 1
        return Step(turn.firings, turn.commands, tuple(turn.adopted), tuple(late))


class _Reducer(TaskTurn):
    """Applies log entries to the state."""

    def __init__(self, game: TokenGame, state: TeamState, slot: int) -> None:
        super().__init__(game, state, slot)
        self.adopted: List[Tuple[int, TokenGame]] = []

    def apply(self, entry: log_entries.Entry) -> None:
        """Apply an entry."""
        self._entry = entry
        if isinstance(entry, log_entries.Start):
            self._start(entry)
        elif isinstance(entry, log_entries.Done):
            robot = self._current(entry.robot, entry.incarnation, entry.visit)
            if robot is not None:
                self._done(robot, self.state.present_name(entry.result), entry.data)
        elif isinstance(entry, log_entries.Failed):
            robot = self._current(entry.robot, entry.incarnation, entry.visit)
            if robot is not None and robot.attempt == entry.attempt:
                self._failed(robot, entry.reason, entry.detail)
        elif isinstance(entry, log_entries.Retry):
            self._retry(entry.robot)
        elif isinstance(entry, log_entries.Fire):
            self._environment(self.state.present_name(entry.transition))
        elif isinstance(entry, log_entries.Interrupt):
            self._event(entry._replace(transition=self.state.present_name(entry.transition)))
        elif isinstance(entry, log_entries.Submit):
            self._submit(entry._replace(transition=self.state.present_name(entry.transition)))
        elif isinstance(entry, log_entries.TaskDue):
            self._task_due(entry)
        elif isinstance(entry, log_entries.ABOUT_TASKS):
            self._about_task(entry)
        elif isinstance(entry, log_entries.Join):
            self._join(entry._replace(place=self.state.present_name(entry.place)))
        elif isinstance(entry, (log_entries.Leave, log_entries.Evict)):
            self._depart(entry)
        elif isinstance(entry, log_entries.SetPlace):
            self._set_place(entry._replace(place=self.state.present_name(entry.place)))
        elif isinstance(entry, (log_entries.Pause, log_entries.Resume)):
            self._pause(entry)
        elif isinstance(entry, log_entries.Stop):
            self._end(entry.reason, finished=False, stopped=True)
        elif isinstance(entry, log_entries.StagePlan):
            self._stage(entry)
        elif isinstance(entry, log_entries.Staged):
            self._staged(entry)
        elif isinstance(entry, log_entries.Adopt):
            self._adopt(entry)
        elif isinstance(entry, log_entries.Unstage):
            self._unstage(entry)

    def _start(self, entry: log_entries.Start) -> None:
        if self.state.robots:
            return
        self.state.seed, self.state.draws_ties = entry.seed, entry.draws_ties
        self.state.witnesses = tuple(entry.witnesses)
        for name, place, incarnation in entry.roster:
            self._add(RobotState(name, self.net.place_number(place), incarnation))
        self.state.created = len(entry.roster)
        for robot in list(self.state.robots.values()):
            self._enter(robot)

    def _current(self, name: str, incarnation: int, visit: int) -> Optional[RobotState]:
        """The robot if its action of exactly that visit is still running; otherwise None."""
        robot = self.state.robots.get(name)
        if robot is None or robot.phase is not Phase.DOING:
            return None
        return robot if (robot.incarnation, robot.visit) == (incarnation, visit) else None

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
            or self.rules.flows[t].taken
            or (self.rules.flows[t].put and not self.rules.agents)
        ):
            self._refuse("'%s' is not a transition of the environment" % name)
        elif self.state.paused or not self.net.is_enabled(self.state.marking, t):
            self._refuse(
                "'%s' cannot fire: %s"
                % (
                    name,
                    "; ".join(self.net.why_disabled(self.state.marking, t)) or "the team is paused",
                ),
            )
        else:
            self._fire(t, None, None)

    def _event(self, entry: log_entries.Interrupt) -> None:
        robot = self.state.robots.get(entry.robot)
        t = self.net.transition_index.get(entry.transition)
        if (
            robot is None
            or t not in self.rules.interrupts
            or (robot.incarnation, robot.visit) != (entry.incarnation, entry.visit)
            or robot.phase not in INTERRUPTIBLE
            or t not in self.net.consumers[robot.place]
        ):
            return
        assert t is not None
        if self.rules.may_interrupt(self.state, robot, t):
            self._interrupt(robot, t, entry.cause)
        # a pause delays an event, but does not lose it
        elif self.rules.interrupts[t].hold or self.state.paused or robot.paused:
            robot.held.setdefault(t, entry.cause)

    # -- plan changes ------------------------------------------------------------------------------

    def _stage(self, entry: log_entries.StagePlan) -> None:
        self.state.stages += 1
        self.state.staged = StagedPlan(
            self.state.stages, entry.digest, entry.plan, entry.mapping, entry.folder
        )

    def _staged(self, entry: log_entries.Staged) -> None:
        staged = self.state.staged
        if staged is None or staged.number != entry.stage:
            return
        robot = self.state.robots.get(entry.robot)
        if robot is not None and (robot.phase.gone or robot.incarnation != entry.incarnation):
            return
        speaks = (not entry.robot) if self.rules.agents else robot is not None
        if speaks or entry.robot in self.state.witnesses:
            staged.votes[entry.robot] = (entry.incarnation, entry.why)

    def _unstage(self, entry: log_entries.Unstage) -> None:
        staged = self.state.staged
        if staged is not None and staged.number == entry.stage:
            self.state.staged = None

    def _adopt(self, entry: log_entries.Adopt) -> None:
        present, staged = self.plan, self.state.staged
        why, new = plan_change.why_not_adopted(self.state, present, entry.stage, self.rules.agents)
        if why or new is None or staged is None:
            self._refuse("the staged plan was not adopted: %s" % "; ".join(why))
            return
        game = adopted_game(staged, self.rules.agents)
        names = plan_change.NewNames(present, new, staged.mapping)
        marking = plan_change.new_marking(self.state, present, new, names)
        robots, asked = self.state.robots.values(), self._asked_for(names)
        for robot in robots:
            self._carry_over(robot, names, game)
            if robot.task is not None and robot.task.id and not game.queues:
                self._fault_of_task(
                    robot, "keeps task %s, but the plan has no queue" % robot.task.id
                )
        self._carry_tasks_over(names, game)
        self.state.renamed = plan_change.renamed(self.state.renamed, present, new, staged.mapping)
        self.rules, self.net, self.plan = game, game.net, game.plan
        self.adopted.append((len(self.firings), game))
        self.state.adopted, self.state.staged = staged, None
        self.state.marking = tuple(marking[p.name] for p in game.net.places)
        self.state.version += 1  # every draw was made for another policy
        self._ask_anew(asked)

    def _asked_for(self, names: plan_change.NewNames) -> Dict[str, str]:
        """The requests of robots that are done, under their new names ("" for the policy), followed
        by inactive robots."""
        transitions = self.net.transitions
        asked = {}
        for name in self.state.waiting:
            request = self.state.robots[name].request
            if request == POLICY:
                asked[name] = ""
            else:
                old = transitions[request].name
                asked[name] = names.transition(old) or old
        inactive = [r.name for r in self.state.robots.values() if r.phase is Phase.INACTIVE]
        return {**asked, **dict.fromkeys(inactive, "")}

    def _carry_over(self, robot: RobotState, names: plan_change.NewNames, game: TokenGame) -> None:
        """Give a robot the numbers that its place and events have in the new net."""
        place = names.place_number(robot.place)
        if robot.phase.gone and (
            place is None or not game.acts[place] or self.rules.gives_back(robot.place)
        ):
            # it returns like a new robot: its place no longer exists, or its resources were given
            # back
            place = game.net.place_number(plan_change.home_of(game.plan, robot.name))
        assert place is not None
        robot.place = place
        robot.request = POLICY
        robot.drawn = None
        held = {names.transition_number(t): cause for t, cause in robot.held.items()}
        robot.held = {
            t: cause
            for t, cause in held.items()
            if t is not None and t in game.interrupts and t in game.net.consumers[place]
        }
        interrupted = {names.place_number(p): v for p, v in robot.interrupted.items()}
        robot.interrupted = {p: v for p, v in interrupted.items() if p is not None}

    def _carry_tasks_over(self, names: plan_change.NewNames, game: TokenGame) -> None:
        """Move queues and waiting tasks to the numbers that their places and transitions have."""
        state = self.state
        queues: Dict[int, List[Task]] = {}
        inherited = set()
        for p in range(len(self.net.places)):
            target = names.place_number(p)
            if target is None or self.rules.acts[p] or game.acts[target]:
                continue
            inherited.add(target)
            tasks = state.queues.get(p) or [Task()] * state.marking[p]
            if target in game.queues and tasks:
                merged = [*queues.get(target, ()), *tasks]
                order = game.queue_orders[target]
                queues[target] = sorted(merged, key=lambda task: rank(task, order))
        for target in game.queues:
            tokens = game.net.places[target].tokens
            if target not in inherited and tokens:
                queues[target] = [Task()] * tokens
        state.queues = queues
        submitted = [(names.transition_number(t), task) for t, task in state.submitted]
        state.submitted = [(t, task) for t, task in submitted if t is not None]
        known: Dict[int, Dict[str, None]] = {}
        for t, ids in state.known.items():
            number = names.transition_number(t)
            if number is not None:
                known.setdefault(number, {}).update(ids)
        state.known = known

    def _ask_anew(self, asked: Mapping[str, str]) -> None:
        """Repeat the requests of robots that are done under the new plan, in their order of
        completion, as if their actions had just ended."""
        self.state.waiting.clear()
        self.state.done_in.clear()
        for name, result in asked.items():
            robot = self.state.robots[name]
            if self.state.ended is None:
                robot.phase = Phase.DOING
                self._done(robot, result)
            elif robot.phase is Phase.DONE:
                self.state.add_waiting(robot)

    # -- membership and orders ---------------------------------------------------------------

    def _join(self, entry: log_entries.Join) -> None:
        if entry.robot in self.state.witnesses:
            if self.state.staged is not None:  # votes of an earlier incarnation do not count
                self.state.staged.votes.pop(entry.robot, None)
            return
        robot = self.state.robots.get(entry.robot)
        if robot is None:
            p = self.net.place_index.get(entry.place)
            if p is None or not self.rules.acts[p]:
                self._fault(None, "%s cannot join in '%s'" % (entry.robot, entry.place))
                return
            robot = RobotState(entry.robot, p, entry.incarnation)
            self._add(robot)
            self._enter(robot)
        elif entry.incarnation <= robot.incarnation:
            return
        elif robot.phase.gone:
            robot.incarnation = entry.incarnation
            robot.visit += 1
            p = self.net.place_index.get(entry.place)
            if p is not None and self.rules.acts[p] and self.rules.gives_back(robot.place):
                robot.place = p
            self._add(robot)
            self._enter(robot)
        else:
            robot.incarnation = entry.incarnation
            if robot.phase is Phase.DOING:
                robot.attempt += 1
                self._start_action(robot)

    def _depart(self, entry: log_entries.Entry) -> None:
        assert isinstance(entry, (log_entries.Leave, log_entries.Evict))
        robot = self.state.robots.get(entry.robot)
        if robot is None or robot.phase.gone:
            return
        if isinstance(entry, log_entries.Evict) and entry.incarnation != robot.incarnation:
            return
        if self.state.members() == [robot.name] and not self.rules.agents:
            # otherwise no member would be left to admit a robot
            self._fault(robot, "stays, because it is the last robot of the team")
            return
        self._cancel(robot)
        self.state.remove_waiting(robot)
        robot.phase = Phase.LOST if isinstance(entry, log_entries.Evict) else Phase.LEFT
        robot.paused = robot.stopped = False
        marking = list(self.state.marking)
        marking[robot.place] -= 1
        self._give_back(robot, marking)
        self.state.set_marking(tuple(marking))
        if robot.phase is Phase.LOST:
            self._fault(robot, "is lost; its token was in %s" % self._name(robot.place))
        if robot.task is not None and robot.task.id:
            text = "is gone with task %s, which %s returns to no queue (on_evict); submit it again"
            self._fault_of_task(robot, text % (robot.task.id, self._name(robot.place)))
        for found in self.state.tasks():
            to = found.task.to
            able = [to and self.rules.is_for(to, r.name) for r in (robot, *self.state.active())]
            if able[0] and not any(able[1:]) and not found.robot:
                text = "is gone, and task %s waits for it %s"
                self._fault_of_task(robot, text % (found.task.id, found.where(self.net)))
        if robot.phase is Phase.LOST:
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
                "%s is lost, but %s waits for it" % (lost.name, stuck[0].name), finished=False
            )
            return
        t = self.net.transition_number(rule.transition)
        for robot in stuck:
            if t in self.net.consumers[robot.place]:
                robot.request = t
                robot.drawn = None

    def _needs(self, robot: RobotState, place: int) -> bool:
        """Whether the request of ``robot`` is missing a robot in ``place``."""
        t = robot.wanted
        return t is not None and any(
            p == place and len(self.rules.free_robots(self.state, p, t)) < weight
            for p, weight in self.net.inputs[t]
        )

    def _set_place(self, entry: log_entries.SetPlace) -> None:
        robot = self.state.robots.get(entry.robot)
        p = self.net.place_index.get(entry.place)
        if robot is None or robot.phase.gone or p is None or not self.rules.acts[p]:
            self._refuse("'%s' cannot be put into '%s'" % (entry.robot, entry.place), robot)
            return
        self._cancel(robot)
        self.state.remove_waiting(robot)
        marking = list(self.state.marking)
        marking[robot.place] -= 1
        marking[p] += 1
        if entry.returns:
            self._put_down(robot, p, marking)
        self.state.set_marking(tuple(marking))
        robot.place = p
        robot.visit += 1
        self._enter(robot)

    def _pause(self, entry: Union[log_entries.Pause, log_entries.Resume]) -> None:
        """Begin or end a pause: stop the actions that it stops, and start those that it ended
        for."""
        state = self.state
        whom = state if not entry.robot else state.robots.get(entry.robot)
        if whom is None:
            return
        before = {r.name for r in state.active() if state.is_stopped(r)}
        whom.paused = isinstance(entry, log_entries.Pause)
        whom.stopped = isinstance(entry, log_entries.Pause) and (whom.stopped or entry.stop)
        for robot in state.active():
            if robot.phase is not Phase.DOING:
                continue
            if state.is_stopped(robot) and robot.name not in before:
                self.commands.append(CancelAction(robot.name, robot.visit))
            elif robot.name in before and not state.is_stopped(robot):
                robot.attempt += 1
                self._start_action(robot)
