"""Runs a simulated team from a seed, injects faults, and checks whether the outcome is right."""

from __future__ import annotations

import random
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Set, Tuple, Type

from agreement.plans import (
    NOT_REACTING,
    REACTING,
    STEERED,
    another_plan,
    make_plan,
)
from agreement.world import (
    PACE,
    Disk,
    SimulatedNode,
    ViolationError,
    Weather,
    World,
)
from gspn_framework_package.execution import log_entries, plan_change
from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.agreement.quorum import is_quorum
from gspn_framework_package.execution.agreement.replica import ProtocolLimits, Replica
from gspn_framework_package.execution.event_log import EventLog
from gspn_framework_package.execution.phase import Phase
from gspn_framework_package.execution.team_tasks import TASK_CANCELLED
from gspn_framework_package.execution.verifier import verify
from gspn_framework_package.model.plan import Plan, Synchronisation

FAULTS_END = 0.6
"""Seconds of simulated time in which faults are injected."""

BOUND = 6.0
"""Seconds after the last fault within which the team must agree on everything that is new."""

SLOT_TIME = 0.1
"""Seconds more for each slot that the team needs for what already waited then. A large team in
partial synchronisation decides about 15 slots a second, and may have two hundred entries waiting
where a batch holds one."""


KINDS = {
    "": "crashes, pauses, partitions, lost logs, joins, leaves, evictions, orders",
    "operator": "orders all the time; evictions by force, of robots that are off and of such that "
    "are not",
    "power": "every crash is a loss of power, which takes what was not written through to the disk",
    "outage": "several machines, or all, lose power at about the same time, and with it the newest "
    "records; some end in order before",
    "trust": "all machines lose power, some stay off, the operator has the others continue, and then "
    "the rest comes back",
    "spare": "a second process under the name of a robot that is out of reach, or comes back",
    "stand-in": "a spare answers under the name of a robot that is out of reach, and is switched "
    "off before it has heard that it has to join",
    "tight": "short histories, small chunks and batches, snapshots every few slots; long runs",
    "amnesia": "logs are lost wherever the others still are a quorum, and nothing else but crashes",
    "tasks": "operators cancel tasks, give them back, replace them and change their priorities all "
    "the time, also of robots that crash, are evicted, leave or are moved; tasks wait too long",
    "calm": "nothing fails, so that orders meet a team that moves fast",
    "link": "one link is cut for longer than an eviction takes: nobody is evicted for that",
    "sleep": "all robots are stopped for longer than an eviction takes: nobody is evicted for that",
    "freeze": "several operators pause and move a team whose moves are mostly private, at the "
    "same time",
    "leave": "robots leave while messages are lost: the others know it, and go on",
    "rivals": "robots pass the leader over at once, messages are lost and late: many attempts at "
    "a slot",
    "double": "the first robot begins out of reach, while another process of its name begins",
    "late": "a robot is evicted by force before it ever started",
    "assertion": "evictions by force, each ordered from a robot that stops right after it noted it",
    "archive": "logs are lost, and snapshots taken every few slots; long runs",
}
"""The kinds of schedules, each with the faults that it injects."""


REACT = "react"
"""A kind of schedules may begin with this word: then events come, tasks and data. Alone it means
the faults of the kind without a name."""

KINDS[REACT] = "events, tasks and data, and any of these faults (react-power, react-operator, ...)"
KINDS.update(
    {"%s-%s" % (REACT, kind): "the same" for kind in list(KINDS) if kind not in ("", REACT)}
)


DEPLOY = "deploy"
"""A kind of schedules may begin with this word as well: then operators put other plans into the
running team."""

KINDS[DEPLOY] = "other plans for the running team, and any of these faults (deploy-power, ...)"
KINDS.update(
    {
        "%s-%s" % (DEPLOY, kind): "the same"
        for kind in list(KINDS)
        if kind not in ("", DEPLOY) and not kind.startswith(REACT)
    }
)


MOST_FAULTS = {
    "freeze": 20,
    "operator": 14,
    "tasks": 20,
    "tight": 10,
    "calm": 14,
    "link": 0,
    "sleep": 0,
    "leave": 0,
    "late": 3,
    "double": 2,
}
"""The maximum number of injected faults by kind of schedule; seven for all other kinds."""


FORCED = ("operator", "assertion")
"""Kinds of schedules in which robots are evicted by force."""


FORGETFUL = ("amnesia", "archive")
"""Kinds of schedules in which lost logs are the most frequent fault."""


class Schedule(NamedTuple):
    """What to run: the team's size and synchronisation, the ``kind`` of faults (one of
    :data:`KINDS`), and the ``seed``, which determines everything else."""

    seed: int
    robots: int
    partial: bool
    kind: str = ""

    def __str__(self) -> str:
        text = "%d:%d:%s" % (self.seed, self.robots, "partial" if self.partial else "full")
        return text + ":" + self.kind if self.kind else text

    @classmethod
    def parse(cls, text: str) -> Schedule:
        """Parse a schedule like ``17:3:full`` or ``17:3:full:power``."""
        seed, robots, mode, *kind = text.split(":")
        return cls(int(seed), int(robots), mode == "partial", *kind)


class ScheduleResult(NamedTuple):
    """The result of a run: sizes, the injected faults, and the ``logs`` for the checker.

    ``blocked``: the team permanently lacks a quorum, since robots whose votes it needs lost their
    logs, or left while cut off; or a process waits for ever, as another one of its name is the
    whole team.
    """

    steps: int
    slots: int
    firings: int
    messages: int
    faults: Dict[str, int]
    blocked: bool
    plan: Plan
    logs: List[Disk]
    given_up: bool = False
    """Whether an operator gave up what some robots knew."""


class _Run:
    def __init__(self, schedule: Schedule, replica_type: Type[Replica]) -> None:
        word, _, rest = schedule.kind.partition("-")
        reacts, self.deploys = word == REACT, word == DEPLOY
        self.kind = rest if reacts or self.deploys else schedule.kind
        self.random = source = random.Random("%d|%d|%d|%s" % schedule)
        evict_after = source.choice([0.0, 0.35])
        if self.kind in ("link", "sleep"):
            evict_after = 0.35
        fence_after = source.choice([0.0, 0.25]) if evict_after else 0.0
        witness = schedule.robots == 2 and source.random() < 0.3
        if self.kind == "tasks":
            kind = STEERED
        elif reacts:
            kind = source.choice(REACTING)
        elif self.deploys:
            kind = source.choice((*NOT_REACTING, *REACTING))
        else:
            kind = source.choice(NOT_REACTING) if self.kind != "freeze" else 0
        plan = make_plan(
            kind,
            schedule.robots,
            schedule.partial,
            evict_after,
            fence_after,
            witness,
        )
        weather = Weather(
            loss=source.choice([0.0, 0.02, 0.15]),
            duplication=source.choice([0.0, 0.1]),
            late=source.choice([0.0, 0.1]),
        )
        fast = source.random() < {"tight": 0.5, "calm": 0.5, "freeze": 0.8}.get(self.kind, 0.2)
        times = (0.0, 0.002) if fast else (0.01, 0.08)
        self.world = World(plan, source.getrandbits(48), weather, replica_type, times)
        if self.kind == "tight":
            self.world.limits = ProtocolLimits(
                batch=source.choice([1, 2, 5]),
                kept=source.choice([1, 3, 10]),
                chunk=source.choice([1, 2, 3]),
                snapshot_every=source.choice([2, 5]),
            )
        elif self.kind == "archive":
            self.world.limits = ProtocolLimits(snapshot_every=2, kept=source.choice([1, 3]))
        elif self.kind == "rivals":
            self.world.pace = PACE._replace(takeover=0.004, retry=0.015)
            self.world.weather = Weather(loss=0.15, late=0.3)
        elif self.kind == "freeze":
            self.world.pace = PACE._replace(backoff=0.001, takeover=0.01)
        if self.kind in ("link", "sleep", "leave"):
            self.world.mishaps = False
        if self.kind == "power":
            self.world.fsync = source.random() < 0.5
        elif self.kind in ("outage", "trust"):
            self.world.fsync = False
            if source.random() < 0.5:  # what was sent before arrives in the next life
                self.world.weather = Weather(loss=source.choice([0.0, 0.15]), late=0.4)
        self.world.steered = self.kind == "tasks"
        self.cancelled: List[Tuple[SimulatedNode, str, str]] = []
        """Orders to cancel a task: the robot that was asked, the order, and the task."""
        self.faults_end = FAULTS_END * (
            2.5 if self.kind in ("tight", "archive", "link", "sleep", "leave") else 1.0
        )
        self.faults: Dict[str, int] = {}
        self.lost_logs = False
        self.removed_logs: Set[str] = set()
        """The ids of the logs of spares that were switched off before they were let in."""
        self.left: List[str] = []
        self.powerless: Set[SimulatedNode] = set()
        """The nodes that lose power when they crash next."""

    # -- faults ------------------------------------------------------------------------------------

    def _count(self, fault: str) -> None:
        self.faults[fault] = self.faults.get(fault, 0) + 1
        if self.deploys and fault not in ("adopt", "unstage"):
            replicas = [node.replica for node in self.world.alive()]
            if any(r is not None and r.ledger.state.staged is not None for r in replicas):
                fault += " while a plan is staged"
                self.faults[fault] = self.faults.get(fault, 0) + 1

    def _up(self) -> List[SimulatedNode]:
        return [n for n in self.world.alive() if not n.suspended and n.name not in self.left]

    def _later(self, low: float, high: float, what: Callable[[], Any]) -> None:
        world = self.world
        world.at(world.now + low + (high - low) * self.random.random(), what)

    def inject(self) -> None:
        """Inject a random fault."""
        often = self.kind
        if often == "freeze":
            for _ in range(3):
                self._order()
            return
        kinds = [
            (0 if often == "calm" else 6, self._crash),
            (8 if often in FORGETFUL else 0 if often == "calm" else 2, self._crash_without_log),
            (0 if often in (*FORGETFUL, "calm") else 3, self._suspend),
            (0 if often in (*FORGETFUL, "calm") else 4, self._partition),
            (0 if often in FORGETFUL else 1, self._leave),
            (8 if often == "outage" else 2, self._join),
            ({"operator": 12, "calm": 12, "tasks": 8}.get(often, 3), self._order),
            (4 if often in ("operator", "tasks") else 1, self._evict),
            (8 if often in FORCED else 0, self._force_evict),
            (6 if often == "spare" else 0, self._spare),
            (12 if often == "stand-in" else 0, self._stand_in),
            (12 if often == "outage" else 0, self._outage),
            (12 if often == "trust" else 0, self._trust),
            (30 if often == "tasks" else 0, self._order_about_task),
        ]
        weights = [w for w, _ in kinds]
        self.random.choices([k for _, k in kinds], weights)[0]()

    def _crash(self) -> None:
        up = self._up()
        if up:
            node = self.random.choice(up)
            node.doomed = self.random.randint(1, 30)
            self._count("crash")

    def on_crash(self, node: SimulatedNode) -> None:
        if node in self.powerless:
            self.powerless.discard(node)
            node.lose_power()
            self._later(0.001, self.random.choice([0.02, 0.4]), lambda: self._restart(node))
            return
        elif self.kind != "power":
            node.crash()
        elif self.world.fsync or self._can_lose(node):
            node.lose_power()
            self.lost_logs = self.lost_logs or not self.world.fsync
            self._count("power lost")
        else:
            node.crash()
        self._later(0.01, 0.4, lambda: self._restart(node))

    def _restart(self, node: SimulatedNode) -> None:
        there = self.world.nodes.get(node.key) is node  # a spare may have been switched off
        if there and node.replica is None and node.name not in self.left:
            node.start()

    def _crash_without_log(self) -> None:
        up = self._up()
        if not up:
            return
        node = self.random.choice(up)
        if not self._can_lose(node):
            return
        # sometimes it first sends messages in another life
        if self.kind == "amnesia" and self.random.random() < 0.5:
            node.crash()
            node.start()
            self._later(0.005, 0.1, lambda: self._lose(node))
        else:
            self._lose(node)

    def _lose(self, node: SimulatedNode) -> None:
        if node.disk is None or node.name in self.left or not self._can_lose(node):
            return
        node.crash()
        node.lose_log()
        self.lost_logs = True
        self._count("crash, log lost")
        self._later(0.01, 0.5, lambda: self._restart(node))

    def _outage(self, spared: Optional[SimulatedNode] = None) -> None:
        """The power of several machines fails, of some in the middle of what they do.

        :param spared: a robot whose machine goes on, out of reach for a while.
        """
        up = [node for node in self._up() if node is not spared]
        if not up:
            return
        if spared is not None:
            cut = {(a, b) for a in self.world.nodes for b in self.world.nodes if a != b}
            cut = {link for link in cut if spared.key in link}
            self.world.blocked |= cut
            self._later(0.3, 0.6, lambda: self.world.blocked.difference_update(cut))
        self._count("outage")
        some = len(up) if spared is not None else self.random.randint(1, len(up))
        size = self.random.choice([len(up), some])
        for node in self.random.sample(up, size):
            if self.random.random() < 0.15:
                node.end_in_order()
                self._later(0.01, 0.4, lambda node=node: self._restart(node))  # type: ignore[misc]
            elif self.random.random() < 0.5:
                self.powerless.add(node)
                self.on_crash(node)
            else:
                self.powerless.add(node)
                node.doomed = self.random.randint(1, 20)

    def _trust(self) -> None:
        """All machines lose power, and not all come back before the operator has those that do go
        on."""
        up = self._up()
        if len(up) < 2 or self.powerless:
            return
        self._count("outage of all")
        late = self.random.sample(up, self.random.randint(1, len(up) - 1))
        for node in up:
            node.lose_power()
            back = (0.5, 1.0) if node in late else (0.01, 0.1)
            self._later(*back, lambda node=node: self._restart(node))  # type: ignore[misc]
        asked = self.random.choice([n for n in up if n not in late])

        def order() -> None:
            if asked in self._up():
                self.world.given_up = True
                asked.give(interface.ForceEvict("t%d" % next(self.world._count), ""))

        self._later(0.35, 0.5, order)

    def _can_lose(self, node: SimulatedNode) -> bool:
        """Whether the others are still a quorum without this robot's vote; otherwise the team would
        (rightly) block permanently. And whether somebody else remembers which of two processes of a
        name takes part."""
        if not self._is_remembered_without(node):
            return False
        ledgers = [n.replica.ledger for n in self.world.alive() if n.replica]
        if not ledgers:
            return False
        members = max(ledgers, key=lambda ledger: ledger.length).state.members()
        voters = {
            n.name
            for n in self.world.nodes.values()
            if n.name != node.name
            and n.disk is not None
            and n.replica is not None
            and n.replica.may_vote()
        }
        return is_quorum(voters, members)

    def _is_remembered_without(self, node: SimulatedNode) -> bool:
        """Whether, of two processes of one robot, another robot than this one knows the one that
        takes part, or this one hears it. If all forget it while it is out of reach, they and the
        second process are a fresh team in every respect, and nobody can know that it has begun
        before."""
        nodes = self.world.nodes.values()
        for one in nodes:
            twins = [n for n in nodes if n.name == one.name]  # one of them may begin later
            if one.replica is None or not one.replica.active or len(twins) < 2:
                continue
            if node.name == one.name or (one.key, node.key) not in self.world.blocked:
                continue
            others = [n for n in nodes if n.name not in (one.name, node.name)]
            if not any(_remembers(n, one) for n in others):
                return False
        return True

    def _suspend(self) -> None:
        up = self._up()
        if up:
            node = self.random.choice(up)
            node.suspended = True
            life = node.life
            self._count("suspend")
            self._later(0.05, 0.5, lambda: node.resume() if node.life == life else None)

    def _partition(self) -> None:
        names = list(self.world.nodes)
        if len(names) < 2:
            return
        side = set(self.random.sample(names, self.random.randint(1, len(names) - 1)))
        both = self.random.random() < 0.7
        cut = {
            (a, b)
            for a in names
            for b in names
            if (a in side) != (b in side) and (both or a in side)
        }
        self.world.blocked |= cut
        self._count("partition" if both else "one-way partition")
        self._later(0.05, 0.5, lambda: self.world.blocked.difference_update(cut))

    def _order(self) -> None:
        up = self._up()
        if not up:
            return
        names = [r.name for r in self.world.plan.robots]
        robot = self.random.choice(names)
        place = self.random.choice(self.world.plan.action_places)
        who: str = self.random.choice(["", robot])
        choices: List[log_entries.Entry] = [
            log_entries.Pause(who, stop=self.kind == "tasks" and self.random.random() < 0.5),
            log_entries.Resume(who),
            log_entries.Resume(""),
            log_entries.SetPlace(robot, place),
            log_entries.Retry(robot),
        ]
        entry = self.random.choice(choices)
        self.world.operator(entry, self.random.choice(up))
        self._count("order")
        if isinstance(entry, log_entries.Pause):
            self._later(0.02, 0.3, lambda: self._resume_team(who))

    def _order_about_task(self) -> None:
        """An operator asks a robot to change what is to be done with a task, often one that robots
        have in hand; sometimes two operators do so at once."""
        up = self._up()
        for node in self.random.sample(up, min(len(up), self.random.choice([1, 1, 2]))):
            if node.replica is None:
                continue
            entry = self.world.order_about_task(node.replica, self.random)
            order = self.world.operator(entry, node)
            if isinstance(entry, log_entries.CancelTask):
                self.cancelled.append((node, order, entry.id))
                self._count("cancel")
            else:
                back = isinstance(entry, log_entries.GiveBack)
                self._count("give back" if back else "prioritise")

    def _look_at_cancelled(self) -> None:
        """Check that tasks of which an operator heard that they are cancelled are, and that no task
        is at two places or has ended twice."""
        for node in self.world.alive():
            assert node.replica is not None
            team = node.replica.ledger.state
            there = [found.task.id for found in team.tasks()]
            ended = [each.id for each in team.ended_tasks]
            twice = [t for t in {*there, *ended} if (there + ended).count(t) > 1]
            if twice:
                raise ViolationError("%s has %s twice" % (node.key, ", ".join(sorted(twice))))
            for asked, order, task in self.cancelled:
                result = asked.results.get(order)
                end = team.end_of(task)
                if (
                    result is not None
                    and result.ok
                    and (end is None or end.outcome != TASK_CANCELLED)
                ):
                    raise ViolationError("%s is not cancelled: %s" % (task, end))

    def _resume_team(self, who: str) -> None:
        up = self._up()
        if up:
            self.world.operator(log_entries.Resume(who), self.random.choice(up))

    def _stage(self) -> None:
        """An operator stages another plan, and has it adopted later."""
        up = self._up()
        if not up:
            return
        node = self.random.choice(up)
        if node.replica is None:
            return
        plan, mapping = another_plan(node.replica.ledger.game.plan, self.random)
        self.world.operator(plan_change.stage_of(plan, mapping), node)
        self._count("stage")
        self._later(0.01, 0.1, lambda: self._adopt(6))

    def _adopt(self, tries: int) -> None:
        """An operator asks for the staged plan to be adopted, or gives it up."""
        up = self._up()
        if up:
            give_up = self.random.random() < 0.05
            order = log_entries.Unstage(-1) if give_up else log_entries.Adopt(-1)
            self.world.operator(order, self.random.choice(up))
            self._count("unstage" if give_up else "adopt")
        if tries:
            self._later(0.02, 0.15, lambda: self._adopt(tries - 1))

    def _evict(self) -> None:
        up = self._up()
        if len(up) > 1:
            node, victim = self.random.sample(up, 2)
            self.world.operator(log_entries.Evict(victim.name, -1), node)
            self._count("evict by the operator")

    def _force_evict(self) -> None:
        """The operator asserts that a robot is off, usually one that is or seems to be. Sometimes
        the operator asserts it of several, since one assertion may not be enough."""
        up = self._up()
        if not up:
            return
        node = self.random.choice(up)
        others = [n for n in self.world.nodes.values() if n is not node and n.name not in self.left]
        off = [n for n in others if n.replica is None or n.suspended]
        if not off and others and self.random.random() < 0.7:
            victim = self.random.choice(others)
            victim.crash()
            self._count("crash before an eviction by force")
            self._later(0.2, 1.0, lambda: self._restart(victim))
            off = [victim]
        victims = off if off and self.random.random() < 0.8 else others
        if not victims:
            return
        chosen = self.random.sample(victims, self.random.choice([1, 1, len(victims)]))
        self._later(0.0, 0.35, lambda: self._assert_off(node, chosen))

    def _assert_off(self, node: SimulatedNode, victims: List[SimulatedNode]) -> None:
        if node not in self._up():
            return
        for victim in victims:
            replica = node.replica
            if replica is None:
                return
            members = replica.members()
            off = replica.asserted_off() | {victim.name}
            before = self.world.given_up
            if not is_quorum([m for m in members if m not in off], members):
                # the operator accepts that what only those robots know is lost
                self.world.given_up = True
            number = "f%d" % next(self.world._count)
            if self.kind == "assertion":
                node.doomed = self.random.randint(2, 6)
            node.give(interface.ForceEvict(number, victim.name))
            self._count("eviction by force")
            if number in node.results and not node.results[number].ok:
                self.world.given_up = before
        if self.world.given_up and self.random.random() < 0.6:
            self._later(0.02, 0.2, lambda: self._crash_and_restart(node))

    def _crash_and_restart(self, node: SimulatedNode) -> None:
        if node.replica is not None and node.name not in self.left:
            node.crash()
            node.start()

    def _spare(self) -> None:
        """A robot goes out of reach and a spare starts under its name; later the first robot comes
        back into reach."""
        world = self.world
        robots = [n for n in self._up() if n.name not in world.plan.witness and n.key == n.name]
        if len(robots) < 2 or world.spares:
            return
        first = self.random.choice(robots)
        if not self._can_lose(first):
            return
        spare = self._send_away(first)
        self.lost_logs = True
        self._count("spare")
        self._later(0.0, 0.3, lambda: spare.start() if spare.replica is None else None)
        self._later(0.2, 1.2, world.come_back)

    def _send_away(self, first: SimulatedNode) -> SimulatedNode:
        """Put a robot out of reach; returns a spare for it."""
        world = self.world
        spare = world.add_spare(first)
        away = {(a, b) for a in world.nodes for b in world.nodes if a != b and first.key in (a, b)}
        world.blocked |= away
        world.away = away
        return spare

    def _double(self) -> None:
        """Two processes of the first robot begin, one of them out of reach for a while."""
        first = self.world.nodes[self.world.plan.robots[0].name]
        spare = self._send_away(first)
        self.lost_logs = True
        self._count("double")
        self._later(0.0, 0.1, lambda: self._restart(spare))
        self._later(0.25, 0.5, self.world.come_back)
        if self.random.random() < 0.5:
            self._later(0.25, 0.5, self._leave)

    def _stand_in(self) -> None:
        """A robot goes out of reach, and a spare hears all but the greetings, from which it would learn that
        it has to join. Meanwhile the operator pauses the team. Then the spare is switched off, and
        the robot comes back."""
        world = self.world
        robots = [n for n in self._up() if n.name not in world.plan.witness and not n.joins]
        if len(robots) < 2 or world.spares:
            return
        first = self.random.choice(robots)
        spare = self._send_away(first)
        world.deaf.add(spare.key)
        self._count("stand-in")
        asked = self.random.choice([n for n in robots if n is not first])

        def pause() -> None:
            world.operator(log_entries.Pause(""), asked)
            self._later(0.3, 0.5, lambda: world.operator(log_entries.Resume(""), asked))

        def back() -> None:
            world.deaf.clear()
            records = spare.disk.records() if spare.disk is not None else []
            if not any(r["kind"] == "active" for r in records):  # it was not let in
                # it may yet be let in, because it asked to be
                asked = any(r["kind"] == "invoked" for r in records)
                ids = {spare.log_id, *(str(r["log"]) for r in records if r["kind"] == "reset")}
                if spare.disk is not None:
                    ids.add(str(spare.disk.header["log"]))
                self.removed_logs |= ids
                self.lost_logs = self.lost_logs or asked
                world.remove(spare)
                first.superseded = False
            world.come_back()

        self._later(0.0, 0.1, spare.start)
        self._later(0.15, 0.2, pause)
        self._later(0.4, 0.5, back)

    def _cut_a_link(self) -> None:
        names = list(self.world.nodes)
        if len(names) > 2:
            a, b = self.random.sample(names, 2)
            self.world.blocked |= {(a, b), (b, a)}
            self._count("link")

    def _sleep(self) -> None:
        for node in self._up():
            node.suspended = True
            self._later(0.9, 0.91, node.resume)
        self._count("sleep")

    def _start_late(self) -> None:
        """Start a robot only after the operator has asserted to the others that it is off."""
        nodes = list(self.world.nodes.values())
        late = self.random.choice(nodes)
        start = late.start
        late.start = lambda: None  # type: ignore[method-assign]

        def begin() -> None:
            late.start = start  # type: ignore[method-assign]
            start()

        others = [n for n in nodes if n is not late]
        if others:
            asked = self.random.choice(others)
            self._later(0.2, 0.3, lambda: self._assert_off(asked, [late]))
        self._later(0.35, 0.55, begin)
        self._count("late start")

    def _leave(self) -> None:
        up = [n for n in self._up() if n.name not in self.world.plan.witness]
        if len(up) > 1:
            node = self.random.choice(up)
            self.world.operator(log_entries.Leave(node.name), node)
            self._count("leave")

    def _join(self) -> None:
        name = "j%d" % sum(n.joins for n in self.world.nodes.values())
        node = SimulatedNode(self.world, name)
        node.joins = True
        self.world.nodes[name] = node
        node.start()
        self._count("join")
        if self.kind == "outage":
            self._later(0.02, 0.2, lambda: self._outage(spared=node))

    def _watch(self) -> None:
        """Retry failed actions, and end the processes of robots that have left or were
        superseded."""
        world = self.world
        for node in list(world.alive()):
            replica = node.replica
            assert replica is not None
            if node.superseded and node.halted:
                self.world.remove(node)
                continue
            if replica.halted is not None and not node.halted:
                self.left.append(node.name)
                node.crash()
                continue
            for robot in replica.ledger.state.robots.values():
                if robot.phase is Phase.FAILED and self.random.random() < 0.3:
                    world.operator(log_entries.Retry(robot.name), node)
                    break
        world.at(world.now + 0.05, self._watch)

    # -- the run -----------------------------------------------------------------------------------

    def run(self) -> ScheduleResult:
        world = self.world
        world.on_crash = self.on_crash  # type: ignore[method-assign]
        if self.kind == "late":
            self._start_late()
        for node in list(world.nodes.values()):
            world.at(0.1 * self.random.random() ** 2, node.start)
        if self.kind == "double" and len(world.nodes) > 1:
            self._double()
        if world.plan.submissions:
            world.at(0.05, lambda: world.publish_tasks(0.05))
        if world.steered:
            world.at(0.05, lambda: world.tell_time(0.05))
        most = MOST_FAULTS.get(self.kind, 7)
        if self.kind == "link":
            world.weather = Weather()
            world.at(0.3, self._cut_a_link)
        elif self.kind == "sleep":
            world.weather = Weather()
            world.at(0.3, self._sleep)
        elif self.kind == "leave":
            world.weather = Weather(loss=0.4)
            world.at(0.2 + 0.3 * self.random.random(), self._leave)
        for _ in range(self.random.randint(0, most)):
            world.at(0.05 + (self.faults_end - 0.1) * self.random.random(), self.inject)
        if self.deploys:
            for _ in range(self.random.randint(1, 3)):
                world.at(0.05 + (self.faults_end - 0.1) * self.random.random(), self._stage)
        world.at(0.05, self._watch)
        if self.kind in ("outage", "trust"):
            world.at(0.05, lambda: world.keep_syncing(0.08))
        world.run(self.faults_end)
        self._heal()
        world.run(world.now + 0.1)
        world.acting = False
        for node in world.nodes.values():
            node.doomed = None
        patience = BOUND + SLOT_TIME * self._slots_behind()
        settled = world.run(world.now + patience, self._has_settled)
        if not settled and world.given_up:
            settled = self._evict_who_forgot(patience)
        if not settled and self.kind in ("outage", "trust"):
            settled = self._trust_who_knows(patience)
        if self.kind in ("link", "sleep"):
            self._nobody_is_lost()
        if settled:
            world.same_state()
            if not world.given_up and self.kind == "tasks":
                self._look_at_cancelled()
        ledgers = [n.replica.ledger for n in world.alive() if n.replica is not None]
        if any(ledger.state.adopted is not None for ledger in ledgers):
            self.faults["another plan adopted"] = 1
        if settled and not world.given_up and self.kind not in ("power", "outage", "trust"):
            lost = world.lost_tasks()
            if lost:
                raise ViolationError("%s reached a robot, and nobody has it" % ", ".join(lost))
        blocked = False
        if not settled:
            blocked = self._is_blocked()
            if not blocked:
                raise ViolationError(
                    "not settled %g s after the last fault: %s" % (patience, self._why())
                )
        return ScheduleResult(
            world.steps,
            world.length(),
            len(world.published),
            world.messages,
            self.faults,
            blocked,
            world.plan,
            world.logs(),
            world.given_up,
        )

    def _heal(self) -> None:
        world = self.world
        world.weather = Weather()
        world.blocked.clear()
        world.deaf.clear()
        world.come_back()
        for node in list(world.nodes.values()):
            node.doomed = None
            if node.name in self.left:
                continue
            if node.suspended:
                node.resume()
            self._restart(node)

    def _has_settled(self) -> bool:
        """Whether every process that starts again has done so, and the team has settled with it: a
        crash that came late may still keep one down, with proposals in its log."""
        nodes = self.world.nodes.values()
        up = all(n.replica is not None or n.name in self.left for n in nodes)
        return up and self.world.has_settled()

    def _slots_behind(self) -> int:
        """How many slots the team needs for the entries that wait now."""
        world = self.world
        waiting = {
            own.item.origin
            for node in world.alive()
            if node.replica is not None
            for own in node.replica.state.own_proposals
        }
        return len(waiting) // world.limits.batch

    def _evict_who_forgot(self, patience: float) -> bool:
        """Where a robot that remembers says that the team is stuck, the operator does what it
        asks: evicts those without a vote by force while they are off; returns whether the team then
        goes on."""
        world = self.world
        asking = [n for n in world.alive() if n.replica and n.replica.may_vote()]
        asking = [n for n in asking if n.replica and n.replica.is_stuck()]
        if not asking:
            return False
        node = max(asking, key=lambda n: n.replica.ledger.length if n.replica else 0)
        assert node.replica is not None
        members = node.replica.members()
        forgot = [n for n in world.alive() if n.replica and not n.replica.active]
        forgot = [n for n in forgot if n.name in members]
        for other in forgot:
            other.crash()
        world.run(world.now + 4 * world.pace.heartbeat)
        for other in forgot:
            node.give(interface.ForceEvict("f%d" % next(world._count), other.name))
        world.run(world.now + 4 * world.pace.heartbeat)
        for other in forgot:
            other.start()
        self._count("stuck, and helped by the operator")
        return world.run(world.now + patience, self._has_settled)

    def _trust_who_knows(self, patience: float) -> bool:
        """Where a robot whose machine lost power says that the team is stuck, the operator switches
        off those without a log, and has the others continue; returns whether they do."""
        world = self.world
        asking = [n for n in world.alive() if n.replica and n.replica.is_stuck()]
        asking = [n for n in asking if n.replica and n.replica.state.torn]
        if not asking:
            return False
        node = max(asking, key=lambda n: n.replica.ledger.length if n.replica else 0)
        assert node.replica is not None
        missing = node.replica.electorate.missing_after_outage()
        empty = [n for n in world.alive() if n.name in missing]
        for other in empty:
            other.crash()
        world.run(world.now + 4 * world.pace.heartbeat)
        node.give(interface.ForceEvict("t%d" % next(world._count), ""))
        self._count("stuck, and trusted by the operator")
        world.run(world.now + 4 * world.pace.heartbeat)
        for other in empty:
            other.start()
        return world.run(world.now + patience, self._has_settled)

    def _nobody_is_lost(self) -> None:
        for node in self.world.alive():
            assert node.replica is not None
            lost = [r.name for r in node.replica.ledger.state.robots.values() if r.incarnation > 0]
            if lost:
                raise ViolationError(
                    "%s was evicted, though it ran and was heard" % ", ".join(lost)
                )

    def _is_blocked(self) -> bool:
        """Whether lost logs, or robots that left while cut off, deprive the team of a quorum or,
        with partial synchronisation, of an answer that only an operator can do without; or a spare
        of the team that could let it in."""
        nodes = self.world.alive()
        if any(self.world.stands_by(node) for node in nodes):
            return True
        if any(self._waits_for_who_left(node) for node in nodes):
            return True
        best = max((n.replica.ledger for n in nodes if n.replica), key=lambda x: x.length)
        voters = [n.name for n in nodes if n.replica is not None and n.replica.may_vote()]
        lost_logs = self.lost_logs or self._removed_log_counts()
        if not lost_logs and (not self.left or self.kind == "leave"):
            return False
        plan, members = self.world.plan, best.state.members()
        asks_all = plan.synchronisation is Synchronisation.PARTIAL and not plan.timing.evict_after
        gone = set(self.left).intersection(members) - {node.name for node in nodes}
        if is_quorum(voters, members):
            return asks_all and bool(gone)
        if not self.left and not any(n.replica.is_stuck() for n in nodes if n.replica):
            raise ViolationError("too many lost their logs, and nobody says so: %s" % self._why())
        return True

    def _removed_log_counts(self) -> bool:
        """Whether somebody heard of the log of a spare that was switched off before it heard of
        that of its robot; also who was down or suspended then, and heard it afterwards."""
        nodes = self.world.nodes.values()
        names = {node.name for node in nodes}
        known = {n.replica.known_log(name) for n in nodes if n.replica for name in names}
        for node in nodes:
            if node.disk is not None:
                known |= {str(r["log"]) for r in node.disk.records() if r["kind"] == "peer"}
        return not self.removed_logs.isdisjoint(known)

    def _waits_for_who_left(self, node: SimulatedNode) -> bool:
        """Whether a robot that never took part needs the word of others that left for good."""
        replica = node.replica
        if replica is None or replica.active or replica.state.joining or replica.state.amnesic:
            return False
        return not set(self.left).isdisjoint(replica.electorate.witnesses_of_start())

    def _why(self) -> str:
        return "; ".join(
            "%s: %d slots, %s, %d pending (%s ...), %s"
            % (
                n.key,
                n.replica.ledger.length,
                n.replica.waits_for() or "-",
                len(n.replica.state.own_proposals),
                [o.item.entry for o in list(n.replica.state.own_proposals)[:2]],
                n.replica.state.attempt,
            )
            for n in self.world.alive()
            if n.replica is not None
        )


def _remembers(node: SimulatedNode, other: SimulatedNode) -> bool:
    """Whether the log of a node, which may be down, says that the votes of another count."""
    if node.replica is not None:
        return node.replica.known_log(other.name) == other.log_id
    records = node.disk.records() if node.disk is not None else []
    logs = [r["log"] for r in records if r["kind"] == "peer" and r["robot"] == other.name]
    return logs[-1:] == [other.log_id]


def check_logs(outcome: ScheduleResult) -> None:
    """Check the logs of a run with the history checker.

    :raises ViolationError: a rule was broken.
    """
    logs = [
        EventLog(str(d.header["log"]), d.header, d.records(), plan=outcome.plan)
        for d in outcome.logs
    ]
    settled = not outcome.blocked and not outcome.given_up
    verdict = verify(logs, settled=settled)
    if verdict.violation is not None:
        raise ViolationError("rule %d: %s" % verdict.violation)


def run_schedule(
    schedule: Schedule, replica_type: Type[Replica] = Replica, *, check: bool = True
) -> ScheduleResult:
    """Run a schedule.

    :param schedule: what to run.
    :param replica_type: the replica, or a mutant of it.
    :param check: whether to check the logs with the history checker.
    :raises ViolationError: a rule was broken, or the team did not settle.
    """
    outcome = _Run(schedule, replica_type).run()
    if check:
        check_logs(outcome)
    return outcome
