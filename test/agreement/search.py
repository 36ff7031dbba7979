"""A search of what small teams of real replicas can do, by an adversary without a clock.

The adversary chooses what happens next: any message that was ever sent arrives, again or for the
first time; timers run out; an action ends; an operator orders something; a process is killed,
perhaps between two records of its log, and starts again with its log, without it, or without its
end. So messages are lost, repeated, reordered and delayed without bound, as in
``spec/agreement.tla``, and nothing depends on how likely it is. What ``agreement.world`` checks
during a run is checked here after each step, and the history checker looks at the logs of a part of
the walks.

A step of a replica depends on nothing but the replica and its input. So the outcome of a step is
computed once, however many states of the team it is a part of, and a state of the team is a few
numbers.

:meth:`Search.breadth_first` visits all states up to a depth. :meth:`Search.walk` goes deeper, at
random. ``python3 -m benchmarks.agreement_search`` does both for as long as you like.
"""

from __future__ import annotations

import json
import random
from functools import partialmethod
from typing import Any, Dict, FrozenSet, Iterator, List, NamedTuple, Optional, Sequence, Tuple
from unittest import mock

from agreement.plans import STEERED, another_plan, make_plan
from agreement.process import Copy, Host, Process, Step
from agreement.world import ViolationError
from gspn_framework_package.execution import log_entries, plan_change
from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.agreement.membership import Membership
from gspn_framework_package.execution.agreement.replica import Replica
from gspn_framework_package.execution.event_log import EventLog
from gspn_framework_package.execution.verifier import verify
from gspn_framework_package.model.compact_json import compact_sorted

EVICT_AFTER = 12.0
"""Silence (s) after which robots are evicted, in scopes where they are: two leaps."""

STEPS = 60
"""The longest walk."""

VERIFY_EVERY = 100
"""The history checker looks at the logs of one walk in so many."""

Orders = Tuple[Tuple[int, interface.Input], ...]


class Scope(NamedTuple):
    """A small team, and how often things may happen to it."""

    name: str
    robots: int
    partial: bool
    orders: Orders = ()
    """What comes from outside: the number of the robot, and the input; each at most once."""
    kind: int = 0
    """The plan, see :func:`~agreement.plans.make_plan`."""
    begun: bool = True
    """Whether all robots take part at the beginning."""
    hellos: bool = False
    """Whether greetings arrive."""
    evicts: bool = False
    """Whether silent robots are evicted."""
    slots: int = 3
    """No action ends once its robot knows this many slots."""
    ticks: int = 3
    crashes: int = 0
    losses: int = 0
    outages: int = 0
    """Losses of power. Then logs are not synced, but for what has to be, and any log may be synced
    at any time."""
    spares: Tuple[int, ...] = ()
    """The robots under whose names a second process may start."""


def _orders(*given: Tuple[int, log_entries.Entry]) -> Orders:
    return tuple((i, interface.Order("o%d" % n, e)) for n, (i, e) in enumerate(given))


def _another_plan(robots: int, partial: bool) -> Orders:
    plan = make_plan(0, robots, partial, 0.0, 0.0, False)
    new, mapping = another_plan(plan, random.Random(3))
    return _orders((0, plan_change.stage_of(new, mapping)), (1, log_entries.Adopt(-1)))


_PAUSE = log_entries.Pause("")
_TASK = interface.TaskCame(log_entries.Submit("order", "t1", {}))
_TASKS: Orders = (
    (0, _TASK),
    (1, _TASK),
    *_orders(
        (1, log_entries.CancelTask("t1")),
        (0, log_entries.GiveBack("t1")),
        (1, log_entries.PrioritiseTask("t1", 2)),
    ),
)

SCOPES: Sequence[Scope] = (
    Scope("two", 2, False, crashes=1),
    Scope("two, partial", 2, True, _orders((1, _PAUSE)), crashes=1),
    Scope("three", 3, False, ticks=2, crashes=1),
    Scope("three, partial", 3, True, _orders((2, _PAUSE)), ticks=2, crashes=1),
    Scope("two start", 2, False, begun=False, hellos=True, ticks=4, losses=1),
    Scope("three lose a log", 3, False, hellos=True, losses=1),
    Scope("three lose a log, partial", 3, True, hellos=True, losses=1),
    Scope("two with a spare", 2, False, hellos=True, spares=(1,)),
    Scope("three with a spare, partial", 3, True, _orders((0, _PAUSE)), hellos=True, spares=(1,)),
    Scope("two lose power", 2, False, hellos=True, outages=2),
    Scope("three lose power", 3, False, hellos=True, outages=3),
    Scope("three evict", 3, False, hellos=True, evicts=True, ticks=9, crashes=1),
    Scope("two, tasks", 2, False, _TASKS, STEERED, crashes=1),
    Scope("three, tasks, partial", 3, True, _TASKS, STEERED, crashes=1),
    Scope("two, another plan", 2, False, _another_plan(2, False), crashes=1, slots=6, ticks=4),
    Scope("three, another plan, partial", 3, True, _another_plan(3, True), slots=6, ticks=4),
)


class Action(NamedTuple):
    """What happens to a process: ``what``, with the message, order or line of that number. ``cut``:
    it is killed when it has written so many records, and starts again; -1: it is not."""

    what: str
    node: int
    number: int = -1
    cut: int = -1


class Message(NamedTuple):
    """A message: the number of its sender, and that of the process that it answers (-1: it goes to
    all processes of the name ``to``, "" for everybody)."""

    sender: int
    node: int
    to: str
    text: str


class Team(NamedTuple):
    """A state of the team."""

    processes: Tuple[int, ...]
    """The numbers of the processes; -1: not started."""
    sent: int
    """The messages that were ever sent: bit n for number n."""
    left: Tuple[int, int, int, int]
    """How many ticks, crashes, losses of a log and outages may still happen."""
    given: int
    """The orders that were given, as bits."""
    chain: Tuple[Tuple[int, str], ...]
    """The slots that were decided, and their hashes."""


class Outcome(NamedTuple):
    """What is kept of a step: the numbers of its process and messages, and what rules are about."""

    process: int
    sent: int
    records: int
    slots: List[Tuple[int, str]]
    relies: List[Tuple[str, str, Tuple[Any, ...]]]
    promised: FrozenSet[Tuple[str, Tuple[Any, ...]]]


class Found(ViolationError):  # noqa: N818
    """A rule is broken. ``actions`` lead to it from the beginning; ``story`` has them in words."""

    def __init__(self, text: str, actions: Sequence[Action], story: Sequence[str]) -> None:
        super().__init__(text)
        self.actions, self.story = list(actions), list(story)


_TICKS, _CRASHES, _LOSSES, _OUTAGES = range(4)
_COSTS = {"tick": _TICKS, "kill": _CRASHES, "lose": _LOSSES, "outage": _OUTAGES}

FAULTS = ("kill", "lose", "outage", "sync", "spare")
"""What a walk seldom does."""

RARE = ("tick", "again", *FAULTS)
"""What a walk does mostly where nothing else is left."""


class Search:
    """A search of one scope.

    :ivar transitions: how many steps of the team were taken.
    :ivar depth: the depth up to which all states were visited.
    :ivar states: how many states that were.
    :ivar steps: how many steps of replicas were computed.
    :ivar longest: the most slots that a team decided.
    """

    def __init__(self, scope: Scope) -> None:
        self.scope = scope
        evict_after = EVICT_AFTER if scope.evicts else 0.0
        self.plan = make_plan(scope.kind, scope.robots, scope.partial, evict_after, 0.0, False)
        names = [r.name for r in self.plan.robots]
        twice = [names[i] for i in scope.spares]
        fsync = not scope.outages
        self.hosts = [Host(self.plan, name, name, fsync, name in twice) for name in names]
        self.hosts += [Host(self.plan, name, name + "-spare", fsync, True) for name in twice]
        self.transitions = self.depth = self.states = 0
        self.steps = self.longest = self.verified = 0
        self.processes: List[Process] = []
        self._numbers: Dict[Any, int] = {}
        self.messages: List[Message] = []
        self._message_numbers: Dict[Message, int] = {}
        self._addressed = [0] * len(self.hosts)
        self._hellos = 0
        self._idle: Dict[int, int] = {}
        self._outcomes: Dict[Tuple[int, Action], Outcome] = {}
        self._states: Dict[Tuple[int, str], str] = {}
        self._prologue: List[Action] = []
        self._newest: Dict[int, Copy] = {}
        self._keeps = True
        self.begin = self._begin()

    # -- the beginning -----------------------------------------------------------------------------

    def _begin(self) -> Team:
        """The state from which the search goes out."""
        scope, robots = self.scope, range(self.scope.robots)
        team = Team((-1,) * len(self.hosts), 0, (99, 0, 0, 0), 0, ())
        sent: List[int] = []

        def take(action: Action) -> None:
            nonlocal team
            before = len(self.messages)
            team = self.after(team, action)
            self._prologue.append(action)
            sent.extend(range(before, len(self.messages)))

        for i in robots:
            take(Action("start", i))
        while scope.begun and not all(self._may_vote(team, i) for i in robots):
            while sent:
                number = sent.pop(0)
                for i in robots:
                    if self._addressed[i] >> number & 1:
                        take(Action("take", i, number))
            for i in robots:
                take(Action("tick", i))
            if len(self._prologue) > 200:
                raise ViolationError("the team does not begin")
        left = (scope.ticks, scope.crashes, scope.losses, scope.outages)
        return team._replace(left=left, sent=0 if scope.begun else team.sent)

    def _may_vote(self, team: Team, node: int) -> bool:
        return self.processes[team.processes[node]].replica.take().may_vote()

    # -- one step ----------------------------------------------------------------------------------

    def actions(self, team: Team) -> Iterator[Action]:
        """What may happen, but for kills in the middle of a step."""
        ticks, crashes, losses, outages = team.left
        scope = self.scope
        for node, number in enumerate(team.processes):
            if number < 0:
                yield Action("spare", node)
                continue
            process = self.processes[number]
            if process.halted:
                continue
            messages = team.sent & self._addressed[node] & ~self._idle.get(number, 0)
            for message in _numbers(messages):
                yield Action("take", node, message)
            if ticks:
                yield Action("tick", node)
            if process.running and process.length < scope.slots:
                yield Action("done", node)
            if process.stage:
                yield Action("examined", node)
            for order, (robot, _) in enumerate(scope.orders):
                if robot == node and not team.given >> order & 1:
                    yield Action("order", node, order)
            if crashes:
                yield Action("kill", node)
            if losses:
                yield Action("lose", node)
            if outages:
                for kept in range(process.synced, len(process.lines) + 1):
                    yield Action("outage", node, kept)
                if process.synced < len(process.lines):
                    yield Action("sync", node)

    def cuts(self, team: Team, action: Action) -> Iterator[Action]:
        """The same, with a kill in the middle, where one may happen."""
        if team.left[_CRASHES] and action.what in ("take", "tick", "done", "order", "examined"):
            records = self._outcome(team.processes[action.node], action).records
            for cut in range(1, records):
                yield action._replace(cut=cut)

    def after(self, team: Team, action: Action) -> Team:
        """The state after an action. :raises ViolationError: a rule was broken."""
        node = action.node
        outcome = self._outcome(team.processes[node], action)
        if action.what == "take" and not outcome.sent and outcome.process == team.processes[node]:
            self._idle[outcome.process] = self._idle.get(outcome.process, 0) | 1 << action.number
            return team
        processes = (*team.processes[:node], outcome.process, *team.processes[node + 1 :])
        left, given = team.left, team.given
        cost = _COSTS.get("kill" if action.cut >= 0 else action.what, -1)
        if cost >= 0:
            left = (*left[:cost], left[cost] - 1, *left[cost + 1 :])  # type: ignore[assignment]
        if action.what == "tick" and action.cut >= 0:
            left = (left[0] - 1, *left[1:])
        if action.what == "order":
            given |= 1 << action.number
        chain = team.chain
        if outcome.slots or outcome.relies:
            chain = self._with_slots(team, outcome, node)
            self._check_promises(team, outcome, node)
        sent = team.sent | (outcome.sent if self.scope.hellos else outcome.sent & ~self._hellos)
        return Team(processes, sent, left, given, chain)

    def _with_slots(self, team: Team, outcome: Outcome, node: int) -> Tuple[Tuple[int, str], ...]:
        chain = dict(team.chain)
        for slot, hash_ in outcome.slots:
            if chain.setdefault(slot, hash_) != hash_ and not self.scope.outages:
                raise ViolationError(
                    "%s has another slot %d than somebody else" % (self.hosts[node].name, slot)
                )
        self.longest = max(self.longest, len(chain))
        return tuple(sorted(chain.items()))

    def _check_promises(self, team: Team, outcome: Outcome, node: int) -> None:
        for robot, log, ballot in outcome.relies:
            known = [
                self.processes[number]
                for number, host in zip(team.processes, self.hosts)
                if host.robot == robot and number >= 0
            ]
            # one that lost its promise with the power, or its log, votes in no slot up to its return,
            # and is no follower after it
            if all(process.log_id != log for process in known):
                continue
            promised = outcome.promised.union(*(process.promised for process in known))
            if (log, ballot) not in promised:
                raise ViolationError(
                    "%s counts on a promise that %s does not remember"
                    % (self.hosts[node].name, robot)
                )

    def _outcome(self, number: int, action: Action) -> Outcome:
        """What comes of a step, computed once."""
        key = (number, action)
        found = self._outcomes.get(key)
        if found is None:
            process = self.processes[number] if number >= 0 else None
            step = self.play(process, action)
            self.steps += 1
            sent = 0
            for to, text in step.sent:
                sent |= 1 << self._number_of(self._addressed_to(action, to, text))
            new, promised = self._intern(step, action.node), step.process.promised
            found = Outcome(new, sent, step.records, step.slots, step.relies, promised)
            self._outcomes[key] = found
        return found

    def play(self, process: Optional[Process], action: Action) -> Step:
        """Let a process take a real step."""
        host, what, cut = self.hosts[action.node], action.what, action.cut
        if process is None:
            return host.start(host.begin())
        if what == "take":
            message = self.messages[action.number]
            call = self.scope.partial and message.node < 0 and '"kind":"hello"' not in message.text
            given: interface.Input = interface.Received(
                json.loads(message.text), "q" if call else ""
            )
            return host.give(process, given, cut)
        if what == "tick":
            return host.give(process, interface.Tick(), cut, leap=True)
        if what == "done":
            return host.give(process, interface.ActionDone(*process.running), cut)
        if what == "examined":
            return host.give(process, interface.Examined(process.stage), cut)
        if what == "order":
            return host.give(process, self.scope.orders[action.number][1], cut)
        if what == "lose":
            return host.lose_log(process)
        if what == "outage":
            return host.lose_power(process, action.number)
        if what == "sync":
            return host.sync(process)
        return host.start(process)

    def _addressed_to(self, action: Action, to: str, text: str) -> Message:
        if to == "<":
            return Message(action.node, self.messages[action.number].sender, "", text)
        return Message(action.node, -1, to, text)

    def _number_of(self, message: Message) -> int:
        number = self._message_numbers.get(message)
        if number is None:
            number = self._message_numbers[message] = len(self.messages)
            self.messages.append(message)
            for node, host in enumerate(self.hosts):
                if node != message.sender and (
                    node == message.node if message.node >= 0 else message.to in ("", host.robot)
                ):
                    self._addressed[node] |= 1 << number
            if '"kind":"hello"' in message.text:
                self._hellos |= 1 << number
        return number

    def _intern(self, step: Step, node: int) -> int:
        number = self._numbers.get(step.key)
        if number is None:
            number = self._numbers[step.key] = len(self.processes)
            self.processes.append(step.process)
            if not step.process.halted:
                self._check_state(step.replica)
                if self._keeps:
                    step.process.replica.keep()
                elif node in self._newest:
                    self._newest[node].drop()  # the walk has gone on without it
                self._newest[node] = step.process.replica
        return number

    def _check_state(self, replica: Replica) -> None:
        """Replicas with the same log have the same state."""
        ledger = replica.ledger
        text = compact_sorted(ledger.state.to_json(ledger.game.net))
        if self._states.setdefault((ledger.length, ledger.hash), text) != text:
            raise ViolationError("two replicas have one log and two states")

    # -- many steps --------------------------------------------------------------------------------

    def breadth_first(self, transitions: int) -> None:
        """Visit states in the order of their depth.

        :param transitions: end after so many.
        :raises Found: a rule is broken.
        """
        self._keeps = True
        came_from: Dict[Team, Tuple[Optional[Team], Optional[Action]]] = {self.begin: (None, None)}
        level, most = [self.begin], self.transitions + transitions
        while level:
            deeper = []
            for team in level:
                for action in self._with_cuts(team):
                    try:
                        new = self.after(team, action)
                    except Exception as error:
                        raise self._found(error, [*_path(came_from, team), action]) from error
                    self.transitions += 1
                    if new not in came_from:
                        came_from[new] = (team, action)
                        self.states += 1
                        deeper.append(new)
                if self.transitions >= most:
                    return
            level = deeper
            self.depth += 1

    def _with_cuts(self, team: Team) -> Iterator[Action]:
        for action in self.actions(team):
            yield action
            yield from self.cuts(team, action)

    def walk(self, transitions: int, seed: int) -> None:
        """Go deep, at random, again and again.

        Each lane (the messages from one robot to another, the timers of a robot, ...) has a
        priority, and the first one goes on, until it is drawn anew. So some robots are far ahead of
        others, some messages come late or never, and few things decide in which order the rest
        happens: as in the scheduler PCT (Burckhardt et al. 2010), which finds faults that depend on
        the order of a few events much sooner than one that draws each event by itself.

        :param transitions: end after so many.
        :raises Found: a rule is broken.
        """
        source = random.Random(seed)
        self._keeps = False
        most, walks = self.transitions + transitions, 0
        while self.transitions < most:
            team, path = self.begin, []
            taken = [0] * len(self.hosts)
            lanes: Dict[Tuple[str, int, int], float] = {}
            daring, restless = source.choice((0.0, 0.03, 0.1)), source.choice((0.02, 0.1, 0.3))
            for _ in range(STEPS):
                choices = list(self.actions(team))
                faults = [a for a in choices if a.what in FAULTS]
                if faults and source.random() < daring:
                    action = source.choice(faults)
                else:
                    first, best = 2.0, None
                    for each in choices:
                        lane = self._lane(each, taken)
                        priority = lanes.get(lane)
                        if priority is None:
                            priority = lanes[lane] = _draw(source, lane)
                        if priority < first:
                            first, best = priority, each
                    if best is None:
                        break
                    action = best
                    lane = self._lane(action, taken)
                    if action.what in RARE or source.random() < restless:
                        lanes[lane] = _draw(source, lane)
                if action.what == "take":
                    taken[action.node] |= 1 << action.number
                try:
                    cuts = list(self.cuts(team, action)) if source.random() < daring else []
                    if cuts:
                        action = source.choice(cuts)
                    path.append(action)
                    team = self.after(team, action)
                except Exception as error:
                    raise self._found(error, path) from error
                self.transitions += 1
            walks += 1
            if walks % VERIFY_EVERY == 1:
                self.verify(path)

    def _lane(self, action: Action, taken: Sequence[int]) -> Tuple[str, int, int]:
        if action.what != "take":
            return (action.what, action.node, action.number)
        again = taken[action.node] >> action.number & 1
        return ("again" if again else "take", action.node, self.messages[action.number].sender)

    # -- what was found ----------------------------------------------------------------------------

    def verify(self, path: Sequence[Action]) -> None:
        """Have the history checker look at the logs after a path. :raises Found: a rule is broken."""
        logs = []
        for host, process in zip(self.hosts, self.replay(path)):
            if process is not None:
                for log, lines in (*process.lost, (process.log, process.lines)):
                    head = dict(host.header, robot=host.robot, log=log)
                    records = [json.loads(line) for line in lines]
                    logs.append(EventLog(log, head, records, plan=self.plan))
        verdict = verify(logs, settled=False)
        if verdict.violation is not None:
            raise self._found(ViolationError("rule %d: %s" % verdict.violation), path)
        self.verified += 1

    def replay(self, path: Sequence[Action]) -> List[Optional[Process]]:
        """Take a path again with processes that take every step, and records that have times. New ids
        of logs are those of the search, which depend on the time of the first process of a kind.

        In the search, processes are the same whose silences differ by less than half a leap. So one
        that takes every step may be a tick ahead or behind. The path ends where it does something
        else than in the search: what the others got afterwards is not what it sent."""
        processes: List[Optional[Process]] = [None] * len(self.hosts)
        searched = [-1] * len(self.hosts)
        actions = [*self._prologue, *path]
        outcomes = []
        for action in actions:
            outcomes.append(self._outcome(searched[action.node], action))
            searched[action.node] = outcomes[-1].process
        try:
            for number, (action, outcome) in enumerate(zip(actions, outcomes)):
                for host in self.hosts:
                    host.mono = number
                log_id = self.processes[outcome.process].log_id
                renew = partialmethod(_renew_log_id, log_id)
                with mock.patch.object(Membership, "_renew_log_id", renew):
                    step = self.play(processes[action.node], action)
                processes[action.node] = step.process
                sent = {self._addressed_to(action, to, text) for to, text in step.sent}
                known = {self.messages[n] for n in _numbers(outcome.sent)}
                if (sent, step.slots) != (known, outcome.slots):
                    break
        finally:
            for host in self.hosts:
                host.mono = None
        return processes

    def _found(self, error: Exception, path: Sequence[Action]) -> Found:
        text = str(error)
        if not isinstance(error, ViolationError):
            text = "%s: %s" % (type(error).__name__, error)
        story = [self._in_words(action) for action in path]
        return Found("%s: %s" % (self.scope.name, text), path, story)

    def _in_words(self, action: Action) -> str:
        name, what = self.hosts[action.node].name, action.what
        if what == "take":
            message = self.messages[action.number]
            data = json.loads(message.text)
            words = [str(data[key]) for key in ("slot", "ballot", "length") if key in data]
            sender = self.hosts[message.sender].name
            what = "takes %s of %s (%s)" % (data["kind"], sender, ", ".join(words))
        elif what == "order":
            what = "gets %r" % (self.scope.orders[action.number][1],)
        elif action.number >= 0:
            what += " %d" % action.number
        if action.cut >= 0:
            what += ", and is killed after %d records" % action.cut
        return "%s: %s" % (name, what)


def _renew_log_id(part: Membership, log_id: str) -> None:
    part.state.log_id = log_id


def _numbers(bits: int) -> Iterator[int]:
    """The numbers of the bits that are set."""
    while bits:
        bit = bits & -bits
        bits ^= bit
        yield bit.bit_length() - 1


def _draw(source: random.Random, lane: Tuple[str, int, int]) -> float:
    """The priority of a lane: below 1 mostly, or mostly above for what is rare."""
    return source.random() + (source.random() < (0.85 if lane[0] in RARE else 0.25))


def _path(
    came_from: Dict[Team, Tuple[Optional[Team], Optional[Action]]], team: Optional[Team]
) -> List[Action]:
    path: List[Action] = []
    while team is not None:
        team, action = came_from[team]
        if action is not None:
            path.append(action)
    return path[::-1]
