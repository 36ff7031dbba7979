"""One run of a simulated team under a seed: what it does, what goes wrong, and whether it came out
right."""

from __future__ import annotations

import random
from typing import Callable, Dict, List, NamedTuple, Type

from gspn_framework_package.benchmark.team.plans import make_plan
from gspn_framework_package.benchmark.team.world import (
    Disk,
    Node,
    ViolationError,
    Weather,
    World,
)
from gspn_framework_package.execution import entries as log
from gspn_framework_package.execution.agreement.quorum import is_quorum
from gspn_framework_package.execution.agreement.replica import Replica
from gspn_framework_package.execution.event_log import EventLog
from gspn_framework_package.execution.history import verify
from gspn_framework_package.execution.team_state import Phase
from gspn_framework_package.model.plan import Plan

FAULTS_END = 0.6
"""Seconds of simulated time with faults."""

BOUND = 6.0
"""Seconds after the last fault within which everything must be agreed on."""


class Schedule(NamedTuple):
    """What to run: ``seed`` decides everything else."""

    seed: int
    robots: int
    partial: bool

    def __str__(self) -> str:
        return "%d:%d:%s" % (self.seed, self.robots, "partial" if self.partial else "full")

    @classmethod
    def parse(cls, text: str) -> Schedule:
        """The schedule of a text like ``17:3:full``."""
        seed, robots, mode = text.split(":")
        return cls(int(seed), int(robots), mode == "partial")


class Outcome(NamedTuple):
    """What came of it: sizes, the faults that were injected, and the ``logs`` for the checker.

    ``blocked``: the team lacks a quorum for good, since a robot whose vote it needs lost its log.
    """

    steps: int
    slots: int
    firings: int
    messages: int
    faults: Dict[str, int]
    blocked: bool
    plan: Plan
    logs: List[Disk]


class _Run:
    def __init__(self, schedule: Schedule, replica_type: Type[Replica]) -> None:
        self.random = source = random.Random("%d|%d|%d" % schedule)
        evict_after = source.choice([0.0, 0.35])
        fence_after = source.choice([0.0, 0.25]) if evict_after else 0.0
        witness = schedule.robots == 2 and source.random() < 0.3
        plan = make_plan(
            source.randrange(4),
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
        fast = source.random() < 0.2
        times = (0.0, 0.002) if fast else (0.01, 0.08)
        self.world = World(plan, source.getrandbits(48), weather, replica_type, times)
        self.faults: Dict[str, int] = {}
        self.lost_logs = False
        self.left: List[str] = []

    # -- faults ------------------------------------------------------------------------------------

    def _count(self, fault: str) -> None:
        self.faults[fault] = self.faults.get(fault, 0) + 1

    def _up(self) -> List[Node]:
        return [n for n in self.world.alive() if not n.suspended and n.name not in self.left]

    def _later(self, low: float, high: float, what: Callable[[], None]) -> None:
        world = self.world
        world.at(world.now + low + (high - low) * self.random.random(), what)

    def inject(self) -> None:
        """One fault, drawn at random."""
        kinds = [
            (6, self._crash),
            (2, self._crash_without_log),
            (3, self._suspend),
            (4, self._partition),
            (1, self._leave),
            (2, self._join),
            (3, self._order),
            (1, self._evict),
        ]
        weights = [w for w, _ in kinds]
        self.random.choices([k for _, k in kinds], weights)[0]()

    def _crash(self) -> None:
        up = self._up()
        if up:
            node = self.random.choice(up)
            node.doomed = self.random.randint(1, 30)
            self._count("crash")

    def on_crash(self, node: Node) -> None:
        node.crash()
        self._later(0.01, 0.4, lambda: self._restart(node))

    def _restart(self, node: Node) -> None:
        if node.replica is None and node.name not in self.left:
            node.start()

    def _crash_without_log(self) -> None:
        up = self._up()
        if not up:
            return
        node = self.random.choice(up)
        if not self._can_lose(node):
            return
        node.crash()
        node.lose_log()
        self.lost_logs = True
        self._count("crash, log lost")
        self._later(0.01, 0.5, lambda: self._restart(node))

    def _can_lose(self, node: Node) -> bool:
        """Whether the others still are a quorum without this robot's vote: otherwise the team
        would (rightly) block for ever."""
        best = max(
            (n.replica.ledger for n in self.world.alive() if n.replica),
            key=lambda ledger: ledger.length,
        )
        members = best.state.members()
        voters = [
            m
            for m in members
            if m != node.name
            and self.world.nodes[m].disk is not None
            and (r := self.world.nodes[m].replica) is not None
            and r.active
        ]
        return is_quorum(voters, members)

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
        cut = {(a, b) for a in names for b in names if (a in side) != (b in side) and (both or a in side)}
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
        choices: List[log.Entry] = [
            log.Pause(who),
            log.Resume(who),
            log.Resume(""),
            log.SetPlace(robot, place),
            log.Retry(robot),
        ]
        entry = self.random.choice(choices)
        self.world.operator(entry, self.random.choice(up))
        self._count("order")
        if isinstance(entry, log.Pause):
            self._later(0.02, 0.3, lambda: self._resume_team(who))

    def _resume_team(self, who: str) -> None:
        up = self._up()
        if up:
            self.world.operator(log.Resume(who), self.random.choice(up))

    def _evict(self) -> None:
        up = self._up()
        if len(up) > 1:
            node, victim = self.random.sample(up, 2)
            self.world.operator(log.Evict(victim.name, -1), node)
            self._count("evict by the operator")

    def _leave(self) -> None:
        up = [n for n in self._up() if n.name not in self.world.plan.witness]
        if len(up) > 1:
            node = self.random.choice(up)
            self.world.operator(log.Leave(node.name), node)
            self._count("leave")

    def _join(self) -> None:
        name = "j%d" % sum(n.joins for n in self.world.nodes.values())
        node = Node(self.world, name)
        node.joins = True
        self.world.nodes[name] = node
        node.start()
        self._count("join")

    def _watch(self) -> None:
        """Failed actions are retried; robots that left end their process."""
        world = self.world
        for node in list(world.alive()):
            replica = node.replica
            assert replica is not None
            if replica.halted is not None and not node.halted:
                self.left.append(node.name)
                node.crash()
                continue
            for robot in replica.ledger.state.robots.values():
                if robot.phase is Phase.FAILED and self.random.random() < 0.3:
                    world.operator(log.Retry(robot.name), node)
                    break
        world.at(world.now + 0.05, self._watch)

    # -- the run -----------------------------------------------------------------------------------

    def run(self) -> Outcome:
        world = self.world
        world.on_crash = self.on_crash  # type: ignore[method-assign]
        for node in list(world.nodes.values()):
            world.at(0.1 * self.random.random() ** 2, node.start)
        for _ in range(self.random.randint(0, 7)):
            world.at(0.05 + (FAULTS_END - 0.1) * self.random.random(), self.inject)
        world.at(0.05, self._watch)
        world.run(FAULTS_END)
        self._heal()
        world.run(world.now + 0.1)
        world.acting = False
        for node in world.nodes.values():
            node.doomed = None
        settled = world.run(world.now + BOUND, world.has_settled)
        blocked = False
        if not settled:
            blocked = self._is_blocked()
            if not blocked:
                raise ViolationError("not settled %g s after the last fault: %s" % (BOUND, self._why()))
        return Outcome(
            world.steps,
            world.length(),
            len(world.published),
            world.messages,
            self.faults,
            blocked,
            world.plan,
            world.logs(),
        )

    def _heal(self) -> None:
        world = self.world
        world.weather = Weather()
        world.blocked.clear()
        for node in list(world.nodes.values()):
            node.doomed = None
            if node.name in self.left:
                continue
            if node.suspended:
                node.resume()
            self._restart(node)

    def _is_blocked(self) -> bool:
        """Whether a lost log, or robots that left while cut off, keep the team from a quorum."""
        nodes = self.world.alive()
        best = max((n.replica.ledger for n in nodes if n.replica), key=lambda x: x.length)
        voters = [n.name for n in nodes if n.replica is not None and n.replica.active]
        if not best.state.members():
            return True  # all left, or were evicted while the last one left
        return bool(self.lost_logs or self.left) and not is_quorum(voters, best.state.members())

    def _why(self) -> str:
        return "; ".join(
            "%s: %d slots, %s, pending %s, %s"
            % (
                n.name,
                n.replica.ledger.length,
                n.replica.waits_for() or "-",
                [o.item for o in n.replica.pool.own],
                n.replica.consensus.attempt,
            )
            for n in self.world.alive()
            if n.replica is not None
        )


def check_logs(outcome: Outcome) -> None:
    """Have the history checker look at the logs of a run.

    :raises ViolationError: a rule was broken.
    """
    logs = [EventLog(str(d.header["log"]), d.header, d.records(), plan=outcome.plan) for d in outcome.logs]
    verdict = verify(logs, settled=not outcome.blocked)
    if verdict.violation is not None:
        raise ViolationError("rule %d: %s" % verdict.violation)


def run_schedule(schedule: Schedule, replica_type: Type[Replica] = Replica, *, check: bool = True) -> Outcome:
    """Run a schedule.

    :param replica_type: the replica, or a mutant of it.
    :param check: have the history checker look at the logs.
    :raises ViolationError: something went wrong.
    """
    outcome = _Run(schedule, replica_type).run()
    if check:
        check_logs(outcome)
    return outcome
