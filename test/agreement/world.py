"""A simulated team: time, network, disks, actions and faults, all from one seed."""

from __future__ import annotations

import heapq
import itertools
import json
import random
from dataclasses import dataclass, field
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Set, Tuple, Type

from agreement.plans import (
    random_data,
    random_result,
)
from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.agreement.replica import Pace, ProtocolLimits, Replica
from gspn_framework_package.execution.event_log import Record, header
from gspn_framework_package.execution.firing import Ended, Fault, StartAction, TaskEnded
from gspn_framework_package.execution.ledger import Ledger
from gspn_framework_package.execution.verifier.merge import is_in_team_after
from gspn_framework_package.model.compact_json import compact, compact_sorted
from gspn_framework_package.model.outcome import Outcome
from gspn_framework_package.model.plan import Plan, Synchronisation

PACE = Pace(heartbeat=0.15, retry=0.03, takeover=0.06, backoff=0.01)
"""Times of the protocol (s) in a simulated world, where messages take a few milliseconds."""

CALLS = ("prepare", "pull", "event", "accept", "learn")
"""Kinds of messages that are requests of calls under partial synchronisation."""


class Weather(NamedTuple):
    """How bad the network is: delays in s, probabilities per message."""

    least: float = 0.001
    most: float = 0.012
    loss: float = 0.0
    duplication: float = 0.0
    late: float = 0.0
    """Probability that a message takes up to twenty times as long, so that others overtake it."""


class ViolationError(AssertionError):
    """The run broke a rule."""


@dataclass
class Disk:
    """A robot's log, which survives its process: the header, and the lines after it."""

    header: Record
    lines: List[str] = field(default_factory=list)
    synced: int = 0
    """The number of lines that would survive a power failure."""
    votes: Dict[Tuple[str, Tuple[Any, ...]], int] = field(default_factory=dict)
    """(kind, ballot) of a promise or vote -> the number of its line."""
    must_outlive: Set[int] = field(default_factory=set)
    """The lines with votes that nobody may know of before they would survive a power failure,
    whether logs are synced or not."""

    def records(self) -> List[Record]:
        """The records, parsed from the lines."""
        return list(json.loads("[%s]" % ",".join(self.lines)))


_headers: Dict[int, Tuple[Plan, Record]] = {}


def _header(plan: Plan) -> Record:
    known = _headers.get(id(plan))
    if known is None:
        known = _headers[id(plan)] = (plan, header(plan, "sim", "", ""))
    return known[1]


class SimulatedNode:
    """A process that hosts a replica.

    :param world: the world it lives in.
    :param name: the name of its robot or witness.
    :param key: distinguishes it from another process with the same name.
    """

    def __init__(self, world: World, name: str, key: str = "") -> None:
        self.world = world
        self.name = name
        self.key = key or name
        self.superseded = False
        """By the operator's mistake, another process runs under its name; this one must halt."""
        self.trusted = True
        self.damage = ""
        """What is damaged in its log; what is whole before it is left."""
        self.plan = world.plan
        """The plan that its host binds actions by."""
        self.renamed: Dict[str, str] = {}
        """What names of earlier plans are called in that plan."""
        self.faults: List[str] = []
        self.told: List[TaskEnded] = []
        self.disk: Optional[Disk] = None
        self.old_disks: List[Disk] = []
        self.replica: Optional[Replica] = None
        self.life = 0
        self.suspended = False
        self.backlog: List[interface.Input] = []
        self.doomed: Optional[int] = None
        """Crash before the effect with this number, counted from 1 from now on; None: no crash."""
        self.wake = 0.0
        self._alarm: Optional[Tuple[float, int]] = None
        self.joins = False
        self.halted = ""
        self.ended = False
        self.results: Dict[str, interface.OrderResult] = {}
        self.log_id = ""
        """The current id of its log."""
        self.inside = False
        """Whether it is in the team, as far as its log says."""
        self.holds = -1
        """The robot has promised to fire no local transition until this slot is decided."""
        self.shows: Dict[str, bool] = {}
        """Event -> whether its source showed that it holds."""

    # -- life ------------------------------------------------------------------------------------

    def start(self) -> None:
        """Start the process with the log that is on its disk."""
        world = self.world
        self.life += 1
        self.suspended = False
        self.doomed = None
        self.backlog = []
        self.halted = ""
        self.holds = -1
        self.renamed = {}
        if self.disk is None:
            log_id = world.new_log_id(self)
            self.disk = Disk(dict(_header(world.plan), robot=self.name, log=log_id))
        records = self.disk.records()
        self.replica = world.replica_type(
            world.plan,
            self.name,
            "sim",
            self.disk.header["log"],
            records,
            joining=self.joins,
            pace=world.pace,
            limits=world.limits,
            trusted=self.trusted,
            damage=self.damage,
        )
        self.trusted, self.damage = True, ""
        self.plan = world.plan
        self.shows = {}
        self.slots_as_member(records)
        resets = [r for r in records if r["kind"] in ("reset", "outage")]
        self.log_id = str((resets or [self.disk.header])[-1]["log"])
        self.carry_out(self.replica.start(world.now))
        if world.robot_events and self.replica is not None and not self.replica.witness:
            world.watch_sources(self)

    def slots_as_member(self, records: List[Record]) -> Dict[int, str]:
        """Note whether it is in the team at the end of its log; returns the hashes of the slots
        that it took as a member."""
        slots: Dict[int, str] = {}
        self.inside = False
        for record in records:
            if record["kind"] == "slot" and self.inside:
                slots[record["slot"]] = record["hash"]
            self.inside = is_in_team_after(self.name, record, self.inside)
        return slots

    def crash(self) -> None:
        """``kill -9``."""
        self.replica = None
        self.life += 1
        self.doomed = None

    def lose_power(self) -> None:
        """The power fails; some of the newest records that were not synced to the disk are lost."""
        disk = self.disk
        self.crash()
        if disk is not None:
            kept = self.world.random.randint(disk.synced, len(disk.lines))
            del disk.lines[kept:]
            disk.synced = kept
            disk.votes = {vote: line for vote, line in disk.votes.items() if line <= kept}
            disk.must_outlive = {line for line in disk.must_outlive if line <= kept}
            self.trusted = self.world.fsync
            self.world.forget_what_is_lost()

    def end_in_order(self) -> None:
        """The process ends, and marks its log as whole; then the machine is switched off."""
        self.crash()
        self.sync()

    def sync(self) -> None:
        """The log is brought to the disk."""
        if self.disk is not None:
            self.disk.synced = len(self.disk.lines)

    def cut_log(self, lines: int) -> None:
        """Replace the log of a dead process with an older copy that lacks the last ``lines``
        lines."""
        if self.disk is not None:
            del self.disk.lines[max(1, len(self.disk.lines) - lines) :]
            self.disk.synced = min(self.disk.synced, len(self.disk.lines))

    def damage_log(self, line: int) -> None:
        """A line of the log of a dead process is found damaged when it starts again, and everything
        from it on set aside."""
        if self.disk is not None:
            kept = self.disk.lines[:line]
            self.lose_log()
            self.disk = Disk(self.old_disks.pop().header, kept, len(kept))
            self.damage = "a line is damaged"

    def lose_log(self) -> None:
        """A dead process loses its log; it is kept in ``old_disks``."""
        if self.disk is not None:
            self.old_disks.append(self.disk)
        self.disk, self.trusted = None, True

    def give(self, given: interface.Input) -> None:
        """Give an input to the process, if it runs; a suspended process gets it when it resumes."""
        if self.replica is None or self.halted:
            return
        if self.suspended:
            self.backlog.append(given)
            return
        self.carry_out(self.replica.step(given, self.world.now))

    def resume(self) -> None:
        """End a suspension."""
        self.suspended = False
        backlog, self.backlog = self.backlog, []
        for given in backlog:
            self.give(given)
        self.give(interface.Tick())

    def carry_out(self, effects: List[interface.Effect]) -> None:
        """Carry out effects in order; a doomed process dies between two of them."""
        assert self.disk is not None
        durable = synced = False
        written: List[Record] = []
        for effect in effects:
            if self.doomed is not None:
                self.doomed -= 1
                if self.doomed <= 0:
                    if isinstance(effect, interface.Persist) and self.world.random.random() < 0.5:
                        self._write(effect.record)
                    self.world.on_crash(self)
                    return
            if isinstance(effect, interface.Persist):
                self._write(effect.record)
                written.append(effect.record)
                durable = durable or effect.durable
                synced = synced or effect.synced
                continue
            if synced or (durable and self.world.fsync):
                self.sync()
                durable = synced = False
            for record in written:  # nobody could know of them before
                self.world.on_record(self, record)
            written = []
            if isinstance(effect, (interface.Send, interface.Reply)) and effect.message.get(
                "kind"
            ) in (
                "promise",
                "accepted",
                "accept",
            ):
                self._check_written(effect.message)
            if isinstance(effect, (interface.Send, interface.Reply)) and effect.message:
                self.world.on_message(self, effect.message)
            if isinstance(effect, interface.Send):
                self.world.send(self.key, effect.to, effect.message)
            elif isinstance(effect, interface.Reply):
                self.world.reply(self.key, effect)
            elif isinstance(effect, StartAction):
                self.world.start_action(self, effect)
            elif isinstance(effect, interface.WakeAt):
                self._wake_at(effect.time)
            elif isinstance(effect, interface.Halted):
                self.halted = effect.reason
                self.world.on_halted(self)
            elif isinstance(effect, Ended):
                self.ended = True
            elif isinstance(effect, Fault):
                self.faults.append(effect.message)
            elif isinstance(effect, TaskEnded):
                self.told.append(effect)
            elif isinstance(effect, interface.OrderResult):
                self.results[effect.order_id] = effect
            elif isinstance(effect, interface.Fired):
                self.world.on_fired(self, effect)
            elif isinstance(effect, interface.Examine):
                self.world.examine(self, effect)
            elif isinstance(effect, interface.PlanChanged):
                before, self.plan = self.plan, effect.plan
                self.world.close_entrances(self, before)

    def _wake_at(self, time: float) -> None:
        """Schedule a Tick at that time; an alarm that is due earlier reschedules itself."""
        self.wake = time
        if self._alarm is None or self._alarm[1] != self.life or self._alarm[0] > time:
            self._alarm = alarm = (time, self.life)
            self.world.at(time, lambda: self._ring(alarm))

    def _ring(self, alarm: Tuple[float, int]) -> None:
        if self._alarm is not alarm:
            return
        self._alarm = None
        if self.world.now >= self.wake - 1e-9:
            self.give(interface.Tick())
        else:
            self._wake_at(self.wake)

    def _write(self, record: Record) -> None:
        assert self.disk is not None
        self.disk.lines.append(compact(dict(record, mono=self.world.now)))
        if record["kind"] in ("promised", "accepted"):
            self.disk.votes[record["kind"], tuple(record["ballot"])] = len(self.disk.lines)
            self.world.promised.add((self.log_id, tuple(record["ballot"])))
            if "torn" in record or changes_members(record):
                self.disk.must_outlive.add(len(self.disk.lines))
        elif record["kind"] in ("reset", "outage"):
            self.log_id = record["log"]
        elif (
            record["kind"] == "private"
            and self.replica
            and self.holds == self.replica.ledger.length
        ):
            raise ViolationError(
                "%s moves on its own, though it said that it holds still" % self.key
            )

    def _check_written(self, message: interface.Message) -> None:
        """Check that a promise or vote that a robot sends is in its log, and synced to the disk."""
        assert self.disk is not None
        if not message.get("vote", True):
            return
        kind = "promised" if message["kind"] == "promise" else "accepted"
        votes, ballot = self.disk.votes, tuple(message["ballot"])
        line = votes.get((kind, ballot)) or votes.get(("accepted", ballot))
        synced = self.world.fsync or line in self.disk.must_outlive
        if line is None or line > (self.disk.synced if synced else len(self.disk.lines)):
            raise ViolationError(
                "%s says %s of %s before it is on its disk" % (self.key, kind, message["ballot"])
            )


def changes_members(record: Record) -> bool:
    """Whether a vote is about who is a member, or whose votes count."""
    return any(
        entry["entry"] in ("join", "leave", "evict") for entry, *_ in record.get("batch", ())
    )


def _robot_events(plan: Plan) -> List[str]:
    """The events that interrupt robots, except those by time."""
    return [t for t, e in plan.events.items() if t not in plan.submissions and e.after is None]


def _is_missing(task: log_entries.Submit, ledger: Ledger) -> bool:
    """Whether a team that should have a task does not."""
    t = ledger.entrance(task.transition)
    return t is not None and not ledger.state.is_known(t, task.id)


class World:
    """The team and everything around it.

    :param plan: the team's plan; its synchronisation determines how messages travel.
    :param seed: the seed of all random numbers in the world.
    :param weather: the state of the network.
    :param replica_type: the replica, or a mutant of it.
    :param action_time: the shortest and longest duration of an action (s).
    """

    def __init__(
        self,
        plan: Plan,
        seed: int,
        weather: Optional[Weather] = None,
        replica_type: Type[Replica] = Replica,
        action_time: Tuple[float, float] = (0.01, 0.08),
    ) -> None:
        self.plan = plan
        self.partial = plan.synchronisation is Synchronisation.PARTIAL
        self.random = random.Random(seed)
        self.weather = weather or Weather()
        self.replica_type = replica_type
        self.action_time = action_time
        self.now = 0.0
        self.steps = 0
        self.messages = 0
        self.protocol_messages = 0
        """The number of messages other than ``hello``."""
        self.limits = ProtocolLimits()
        self.pace = PACE
        self.promised: Set[Tuple[str, Tuple[Any, ...]]] = set()
        """(log id, ballot) of every promise and vote."""
        self._frozen: Set[Tuple[int, Tuple[Any, ...]]] = set()
        """Attempts (slot, ballot) that asked everybody to freeze: to fire no local transition."""
        self.fsync = True
        """Whether durable records are synced to the disk."""
        self.given_up = False
        """Whether an operator gave up what some robots knew; their logs may then differ."""
        self.acting = True
        self.mishaps = True
        """Whether some actions fail, or return nonsense."""
        self.blocked: Set[Tuple[str, str]] = set()
        self._heap: List[Tuple[float, int, Callable[[], None]]] = []
        self._count = itertools.count()
        self._last: Tuple[Any, str] = (None, "")
        self._calls: Dict[str, Tuple[str, int]] = {}
        self._chain: Dict[int, str] = {}
        self.published: List[Tuple[float, interface.Fired]] = []
        self.closed: Set[str] = set()
        """The transitions by which tasks came in under a plan, and no more under the next."""
        self.spares = 0
        self.away: Set[Tuple[str, str]] = set()
        """Blocked links of a robot that is out of reach while a spare runs under its name."""
        self.deaf: Set[str] = set()
        """The nodes that no greeting reaches."""
        self._gone: List[Disk] = []
        self.robot_events = _robot_events(plan)
        self.tasks = 0
        """The number of tasks that came."""
        self.steered = False
        """Whether tasks have priorities."""
        self.reached: List[Tuple[Disk, log_entries.Submit]] = []
        """(log of a robot, task) of all that reached robots."""
        self.nodes: Dict[str, SimulatedNode] = {}
        for name in [r.name for r in plan.robots] + list(plan.witness):
            self.nodes[name] = SimulatedNode(self, name)

    # -- time ------------------------------------------------------------------------------------

    def at(self, time: float, what: Callable[[], None]) -> None:
        """Call ``what`` at that simulated time (s), or now if it has passed."""
        heapq.heappush(self._heap, (max(time, self.now), next(self._count), what))

    def run(self, until: float, stop: Optional[Callable[[], bool]] = None) -> bool:
        """Let time pass until ``until`` (s) or until ``stop`` holds; returns whether ``stop``
        holds."""
        while self._heap and self._heap[0][0] <= until:
            time, _, what = heapq.heappop(self._heap)
            self.now = time
            self.steps += 1
            what()
            if stop is not None and self.steps % 8 == 0 and stop():
                return True
        self.now = until
        return stop is not None and stop()

    # -- network ---------------------------------------------------------------------------------

    def send(self, sender: str, to: str, message: interface.Message) -> None:
        """Send a message: like a topic, or, in partial synchronisation, like a service call.

        :param sender: the key of the node that sends it.
        :param to: the name of the receiver; "" for everybody else.
        """
        if message is not self._last[0]:
            self._last = (message, compact(message))
        text = self._last[1]
        if message["kind"] != "hello":
            self.protocol_messages += 1 if to else len(self.nodes) - 1
        call = self.partial and message["kind"] in CALLS
        for name, node in list(self.nodes.items()):
            if name == sender or (to and node.name != to):
                continue
            request = ""
            if call:
                request = "q%d" % next(self._count)
                self._calls[request] = (sender, self.nodes[sender].life)
            self._carry(sender, name, text, request)

    def reply(self, sender: str, effect: interface.Reply) -> None:
        """Send the reply to a call back to its caller."""
        caller, life = self._calls.pop(effect.request_id, ("", 0))
        if not effect.message or caller not in self.nodes or self.nodes[caller].life != life:
            return
        self.protocol_messages += 1
        self._carry(sender, caller, compact(effect.message), "")

    def _carry(self, sender: str, to: str, text: str, request: str) -> None:
        weather, chance = self.weather, self.random.random
        self.messages += 1
        copies = 1
        if weather.loss and chance() < weather.loss:
            copies = 0
        elif weather.duplication and not request and chance() < weather.duplication:
            copies = 2
        for _ in range(copies):
            delay = weather.least + (weather.most - weather.least) * chance()
            if weather.late and chance() < weather.late:
                delay *= 1 + 19 * chance()
            self.at(self.now + delay, lambda: self._deliver(sender, to, text, request))

    def _deliver(self, sender: str, to: str, text: str, request: str) -> None:
        if (sender, to) not in self.blocked and to in self.nodes:
            message = json.loads(text)
            if to not in self.deaf or message["kind"] != "hello":
                self.nodes[to].give(interface.Received(message, request))

    # -- actions ---------------------------------------------------------------------------------

    def start_action(self, node: SimulatedNode, goal: StartAction) -> None:
        """Run an action: after a random time it fails, or returns a random result for its place."""
        low, high = self.action_time
        life = node.life
        replica = node.replica
        # this is the first action that it ever starts
        if replica is not None and replica.ledger.length == goal.visit == 1:
            ahead = [
                name
                for name, p in replica.state.peers.all.items()
                if p.heard is not None and p.length > 1
            ]
            if ahead:
                raise ViolationError("%s acts, though %s is further" % (node.key, ", ".join(ahead)))
        time = goal.delay + low + (high - low) * self.random.random()
        failed = self.mishaps and self.random.random() < 0.02
        if goal.place not in node.plan.action_places or not node.plan.action(node.name, goal.place):
            raise ViolationError("%s acts in %s, of another plan" % (node.key, goal.place))
        result = random_result(node.plan, goal.place, self.random, nonsense=self.mishaps)
        data = random_data(node.plan, next(self._count), self.random)

        def end() -> None:
            if node.life != life:
                return
            if not self.acting:
                return
            key = (goal.incarnation, goal.visit, goal.attempt)
            if failed:
                node.give(interface.AttemptFailed(*key, Outcome.ABORTED))
            else:
                node.give(interface.ActionDone(*key, result, data))

        self.at(self.now + time, end)

    # -- another plan ------------------------------------------------------------------------------

    def examine(self, node: SimulatedNode, asked: interface.Examine) -> None:
        """Let a host look at a staged plan: after a while it says whether it can follow it."""
        life = node.life
        why = "a function does not load" if self.random.random() < 0.04 else ""

        def answer() -> None:
            if node.life == life:
                node.give(interface.Examined(asked.stage, why))

        self.at(self.now + 0.02 * self.random.random(), answer)

    def same_state(self) -> None:
        """Check that replicas with the same log have the same state, plan included."""
        known: Dict[Tuple[int, str], Tuple[str, str]] = {}
        for node in self.alive():
            if node.replica is None or node.halted:
                continue
            ledger = node.replica.ledger
            plan = node.plan.hash() if node.replica.active else ledger.game.plan.hash()
            if plan != ledger.game.plan.hash():
                raise ViolationError("the host of %s has a different plan than its log" % node.key)
            text = compact_sorted(ledger.state.to_json(ledger.game.net))
            first, other = known.setdefault((ledger.length, ledger.hash), (node.key, text))
            if text != other:
                raise ViolationError(
                    "%s and %s have one log and two states: %s and %s"
                    % (first, node.key, other, text)
                )

    # -- events and tasks --------------------------------------------------------------------------

    def watch_sources(self, node: SimulatedNode) -> None:
        """Let the sources of a robot's events show something new at random times."""
        life = node.life

        def show() -> None:
            if node.life != life or not self.acting:
                return
            event = self.random.choice(_robot_events(node.plan) or self.robot_events)
            source = node.plan.events.get(event) or self.plan.events[event]
            cause = {"now": self.steps}
            if not source.when and not source.edge:
                if node.replica is not None and node.replica.watches(event):
                    node.give(interface.EventObserved(event, None, cause))
            else:
                holds = node.shows[event] = not node.shows.get(event, False)
                node.give(interface.EventObserved(event, holds, cause))
            self.at(self.now + 0.1 * self.random.random(), show)

        self.at(self.now + 0.1 * self.random.random(), show)

    def publish_tasks(self, every: float) -> None:
        """Let tasks come in at random times, each at some of the robots, or from an operator."""
        up = [node for node in self.alive() if not node.superseded]
        if not self.acting:
            return
        if up:
            self.tasks += 1
            plan = self.random.choice(up).plan
            transition = self.random.choice(plan.submissions or self.plan.submissions)
            task = log_entries.Submit(transition, "t%d" % self.tasks, {"number": self.tasks})
            if self.steered:
                task = self._steered(task)
            if self.random.random() < 0.2:
                self.operator(task, self.random.choice(up))
            else:
                for node in self.random.sample(up, self.random.randint(1, len(up))):
                    self._reach(node, task)
        self.at(self.now + 2 * every * self.random.random(), lambda: self.publish_tasks(every))

    def _steered(self, task: log_entries.Submit) -> log_entries.Submit:
        """A task with a priority, perhaps a time limit, or in place of another."""
        task = task._replace(priority=self.random.choice([0, 0, 1, 5]))
        if self.random.random() < 0.2:
            late = 1000 * self.now + self.random.choice([1, 50, 300])
            task = task._replace(until=int(late))
        if self.random.random() < 0.2:
            at = int(1000 * self.now) + self.random.choice([1, 30, 100])
            task = task._replace(at=at, every=self.random.choice([0, 60]))
        if self.random.random() < 0.2:
            task = task._replace(to=self.random.choice([r.name for r in self.plan.robots]))
        if self.random.random() < 0.15 and self.tasks > 1:
            task = task._replace(replaces="t%d" % self.random.randint(1, self.tasks - 1))
        return task

    def order_about_task(self, replica: Replica, source: random.Random) -> log_entries.TaskOrder:
        """An order about a task, often about one that robots have in hand."""
        found = list(replica.ledger.state.tasks())
        with_robots = [each for each in found if each.robot]
        if with_robots and source.random() < 0.6:
            found = with_robots
        names = [each.task.id for each in found] or ["t%d" % max(1, self.tasks)]
        task, what = source.choice(names), source.random()
        if what < 0.6:
            return log_entries.CancelTask(task)
        if what < 0.8:
            return log_entries.GiveBack(task)
        return log_entries.PrioritiseTask(task, source.choice([-1, 0, 2, 9]))

    def tell_time(self, every: float) -> None:
        """Tell every robot now and then what time it is, in ms; their clocks differ."""
        for node in self.alive():
            node.give(interface.TimeOfDay(int(1000 * self.now + self.random.choice([0, 0, 40]))))
        self.at(self.now + every, lambda: self.tell_time(every))

    def _reach(self, node: SimulatedNode, task: log_entries.Submit) -> None:
        """Let a task reach a robot; note the log in which it now has to be."""
        life, disk, replica = node.life, node.disk, node.replica
        awake = not (node.suspended or node.halted) and disk is not None and replica is not None
        over = replica is not None and (
            replica.ledger.state.ended is not None or replica.halted is not None
        )
        taken = replica is not None and replica.ledger.entrance(task.transition) is not None
        node.give(interface.TaskCame(task))
        if awake and not over and taken and node.life == life and disk is not None:
            self.reached.append((disk, task))

    def close_entrances(self, node: SimulatedNode, before: Plan) -> None:
        """A robot follows another plan: tasks that this one does not take any more are refused,
        also if a later plan takes tasks by a transition of the same name."""
        adopted = node.replica.ledger.state.adopted if node.replica is not None else None
        if node.replica is None or adopted is None:
            return
        gone = {
            t for t in before.submissions if adopted.mapping.get(t, t) not in node.plan.submissions
        }
        self.closed |= gone | {old for old, name in node.renamed.items() if name in gone}
        node.renamed = dict(node.replica.ledger.state.renamed)

    def lost_tasks(self) -> List[str]:
        """The tasks that a running robot has taken in with the log that it has, and that the team
        does not have."""
        up = [n for n in self.alive() if not n.halted and not self.stands_by(n)]
        kept = [n.disk for n in up if n.disk is not None]
        ledgers = [n.replica.ledger for n in self.alive() if n.replica is not None]
        team = max(ledgers, key=lambda ledger: ledger.length, default=None)
        if team is None or team.state.ended is not None:
            return []
        return [
            task.id
            for disk, task in self.reached
            if task.transition not in self.closed
            and any(disk is other for other in kept)
            and _is_missing(task, team)
        ]

    def new_log_id(self, node: SimulatedNode) -> str:
        """The id of a log that a node begins. Origins shorten it to eight characters."""
        return "%s-log%d" % (node.key, len(node.old_disks))

    # -- checks during the run ---------------------------------------------------------------------

    def on_record(self, node: SimulatedNode, record: Record) -> None:
        """Check a written record: no two members may put different entries into one slot. What a
        robot outside the team learns may have been lost with the power supply meanwhile."""
        inside, node.inside = node.inside, is_in_team_after(node.name, record, node.inside)
        if record["kind"] == "slot" and not self.given_up and inside:
            known = self._chain.setdefault(record["slot"], record["hash"])
            if known != record["hash"]:
                raise ViolationError(
                    "%s has another slot %d than somebody else" % (node.name, record["slot"])
                )

    def forget_what_is_lost(self) -> None:
        """Slots that no member has any more were lost with the power supply. A robot outside the
        team that has them forgets them when it hears the others."""
        known: Dict[int, str] = {}
        for node in self.nodes.values():
            records = node.disk.records() if node.disk is not None else []
            known.update(node.slots_as_member(records))
        self._chain = {slot: hash_ for slot, hash_ in self._chain.items() if slot in known}

    def keep_syncing(self, every: float) -> None:
        """The logs are brought to the disk at random times."""
        for node in self.nodes.values():
            if self.random.random() < 0.5:
                node.sync()
        self.at(self.now + 2 * every * self.random.random(), lambda: self.keep_syncing(every))

    def on_message(self, node: SimulatedNode, message: interface.Message) -> None:
        """Check a message that is sent: a robot that promises to freeze has to, and a proposer
        relies only on promises that were made and not forgotten."""
        if message["kind"] not in ("prepare", "promise", "accept"):
            return
        slot, ballot = message["slot"], tuple(message["ballot"])
        if message.get("frozen"):
            self._frozen.add((slot, ballot))
        if message["kind"] != "accept":
            if (slot, ballot) in self._frozen:
                node.holds = slot
        elif not self.partial and node.replica is not None:
            logs = node.replica.ledger.logs
            for name in node.replica.state.followers or ():
                if logs.get(name) and (logs[name], ballot) not in self.promised:
                    raise ViolationError(
                        "%s counts on a promise that %s does not remember" % (node.key, name)
                    )

    def on_fired(self, node: SimulatedNode, fired: interface.Fired) -> None:
        """Note a firing that is published."""
        known = fired.firing.transition in fired.plan.net.transition_index
        if not known or len(fired.firing.marking) != len(fired.plan.net.places):
            raise ViolationError("%s fires %s of another net" % (node.key, fired.firing.transition))
        if fired.publish:
            self.published.append((self.now, fired))

    def on_halted(self, node: SimulatedNode) -> None:
        """A replica halted: allowed only if two processes run under its name."""
        if node.superseded or sum(n.name == node.name for n in self.nodes.values()) > 1:
            node.superseded = True
            for other in self.nodes.values():  # the other process under its name may stay
                other.superseded = other.superseded and (other is node or other.name != node.name)
            return
        raise ViolationError("%s halted: %s" % (node.name, node.halted))

    def on_crash(self, node: SimulatedNode) -> None:
        """A doomed process dies."""
        node.crash()

    # -- two processes under one name --------------------------------------------------------------

    def add_spare(self, first: SimulatedNode) -> SimulatedNode:
        """Add a node for a second process under the name of the first, which must give way."""
        self.spares += 1
        spare = SimulatedNode(self, first.name, "%s-spare%d" % (first.name, self.spares))
        spare.joins = first.joins
        first.superseded = True
        self.nodes[spare.key] = spare
        return spare

    def come_back(self) -> None:
        """Restore the links of the robot that was out of reach."""
        self.blocked -= self.away
        self.away = set()

    def remove(self, node: SimulatedNode) -> None:
        """Switch off a node permanently; its logs are kept."""
        node.crash()
        del self.nodes[node.key]
        self._gone += node.old_disks + ([node.disk] if node.disk is not None else [])

    # -- questions -------------------------------------------------------------------------------

    def alive(self) -> List[SimulatedNode]:
        """The nodes whose process runs (it may be suspended)."""
        return [n for n in self.nodes.values() if n.replica is not None]

    def length(self) -> int:
        """The length of the longest log, in slots."""
        return max((n.replica.ledger.length for n in self.alive() if n.replica), default=0)

    def has_settled(self) -> bool:
        """Whether all running replicas agree, and no proposal is pending."""
        ends = set()
        for node in self.alive():
            replica = node.replica
            assert replica is not None
            if node.suspended or replica.fenced:
                return False
            ends.add((replica.ledger.length, replica.ledger.hash))
            over = replica.ledger.state.ended is not None  # then nothing more gets into the log
            if self.stands_by(node):
                continue
            rivals = [o for o in self.alive() if o.name == node.name and not self.stands_by(o)]
            if node.superseded and len(rivals) > 1 and not over:
                return False  # it has not noticed yet
            if not over and replica.state.own_proposals.asking:
                return False
            if self._owes_a_vote(replica):
                return False
            if replica.state.offered and replica.ledger.state.ended is None:
                return False
            if replica.ledger.state.ended is None and not (
                replica.is_settled() or (replica.witness and replica.active)
            ):
                return False
        return len(ends) <= 1

    def stands_by(self, node: SimulatedNode) -> bool:
        """Whether a process waits, as it should: another one of its name is at work, and it says
        so."""
        replica = node.replica
        if replica is None or not replica.has_namesake():
            return False
        others = [n.replica for n in self.alive() if n.name == node.name and n is not node]
        return any(o is not None and o.may_vote() for o in others)

    @staticmethod
    def _owes_a_vote(replica: Replica) -> bool:
        """Whether a replica that takes part has not said what it thinks of a staged plan."""
        state = replica.ledger.state
        if state.staged is None or state.ended is not None or not replica.is_settled():
            return False
        name = replica.config.name
        return state.staged.votes.get(name, (-1, ""))[0] != replica.incarnation

    def operator(self, order: log_entries.Entry, node: SimulatedNode) -> str:
        """Give an operator's order to a node; returns the id of the order."""
        order_id = "o%d" % next(self._count)
        node.give(interface.Order(order_id, order))
        return order_id

    def logs(self) -> List[Disk]:
        """All logs that were ever written, including lost ones. The checker wants that of the
        process that runs last, if a robot had two."""
        found = list(self._gone)
        for node in sorted(
            self.nodes.values(), key=lambda n: (n.replica is not None, not self.stands_by(n))
        ):
            found += node.old_disks + ([node.disk] if node.disk is not None else [])
        return found
