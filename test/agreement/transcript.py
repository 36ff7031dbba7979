"""Stories of the protocol as text: what happens to a team, and what each robot does.

A transcript holds commands, a line ``----``, what the robots do then, and an empty line, again and
again. The commands:

==========================  ======================================================================
``team N [WORD]...``        N robots of the plan :func:`story_plan`, all in A; with the words
                            ``partial`` (synchronisation), ``fsync`` or ``large`` (the robots act as
                            in a team of more than eight)
``start [ROBOT]...``        start processes (all); one that died starts again with its log
``run SECONDS``             let time pass; a message takes 5 ms
``done ROBOT [TRANSITION]`` its action ends
``fail ROBOT``              its action fails
``crash ROBOT``             ``kill -9``
``power ROBOT``             the power of its machine fails
``forget ROBOT``            the log of a dead process is lost
``shorten ROBOT LINES``     the log of a dead process lacks its last lines
``cut ROBOT ROBOT``         no message passes between two robots; ``heal`` ends all of these
``mute ROBOT ROBOT``        no message of the first reaches the second; ``heal`` ends it too
``spare ROBOT``             start a second process under the name of a robot
``join ROBOT PLACE``        start a robot that is not in the plan
``order ROBOT ORDER WORD``  an operator gives a robot an order: ``pause``, ``resume``, ``evict R``,
                            ``force_evict R``, ``leave R``, ``set_place R P``, ``stop``,
                            ``submit ID``, ``stage PLACE``, ``adopt``
``task ROBOT ID``           a message on the topic of orders reaches one robot only
``state``                   what each robot knows
==========================  ======================================================================

What is shown: every message but the greetings (``hello``), every decided slot with its firings, the
start of every action, and what a robot answers its operator. An entry is shown with its main fields:
``done(robot_2, 1)`` is the end of the action of robot_2 in its visit 1, ``join(robot_2, A)`` begins
another incarnation of robot_2, which keeps its place if it has one. To whoever knows Raft:

=========================  =========================================================================
here                       in Raft
=========================  =========================================================================
slot, ballot 1.robot_2     index and term; ballots of one number are ordered by the robot's name
propose                    a client's command, passed on to the leader
prepare, promise           RequestVote and a vote, for one slot
accept, accepted           AppendEntries and its success; ``accepted`` also goes to the robots whose
                           proposals are in the batch, and carries what waits at its sender
nack                       AppendEntries or RequestVote refused, because of a higher term
learn                      the entry is committed: with a ballot, the one accepted under it; else the
                           message holds the entries
pull                       a request for committed entries that the sender has missed
appends                    has learned that the slot is decided, and applies it
=========================  =========================================================================

To write the answers of the transcripts
anew, look at the difference, and commit it with the change that explains it::

    PYTHONPATH=.:test python3 -m agreement.transcript
"""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List, NamedTuple, Sequence
from unittest import mock

from agreement.world import SimulatedNode, Weather, World
from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement import config, interface
from gspn_framework_package.execution.agreement.replica import Replica
from gspn_framework_package.execution.event_log import Record
from gspn_framework_package.execution.firing import StartAction
from gspn_framework_package.execution.plan_change import stage_of
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.event import EventSource, Tasks
from gspn_framework_package.model.outcome import Outcome
from gspn_framework_package.model.plan import Plan, RobotSpec, Synchronisation, Timing

FOLDER = Path(__file__).parent / "transcripts"
ANSWER = "----"


class Stanza(NamedTuple):
    """Commands, and what the robots do then. ``comment`` holds the lines before the commands."""

    comment: List[str]
    commands: List[str]
    answer: List[str]


def story_plan(robots: int, partial: bool = False, second: str = "B") -> Plan:
    """Robots go from A to B and back. In B, a robot holds a tool of which there is one. Orders come
    in by a transition of the environment.

    :param second: the name of B, which another plan may change; orders then come in by another
        transition.
    """
    order = "order" if second == "B" else "order_" + second
    net = (
        NetBuilder("story")
        .place("A")
        .place(second)
        .place("tool", tokens=1)
        .place("orders")
        .exponential("go", inputs=["A", "tool"], outputs=second)
        .exponential("back", inputs=second, outputs=["A", "tool"])
        .exponential(order, outputs="orders")
        .build()
    )
    return Plan(
        name="story",
        net=net,
        actions={place: FunctionAction("actions.act", place) for place in ("A", second)},
        resource_places=frozenset(["tool", "orders"]),
        robots=tuple(RobotSpec("robot_%d" % number, "A") for number in range(1, robots + 1)),
        spawn=("A",),
        on_evict={second: {"tool": 1}},
        events={order: EventSource("/orders", "std_msgs/String")},
        tasks=Tasks(("orders",)),
        synchronisation=Synchronisation.PARTIAL if partial else Synchronisation.FULL,
        timing=Timing(evict_after=2.0, fence_after=1.0),
    )


class _Story(World):
    """A team whose actions end when the transcript says so, and which reports what it does."""

    def __init__(self, plan: Plan, tell: Callable[[str], None]) -> None:
        super().__init__(plan, 0, Weather(0.005, 0.005))
        self.tell = tell
        self.goals: Dict[str, StartAction] = {}

    def new_log_id(self, node: SimulatedNode) -> str:
        return hashlib.sha256(super().new_log_id(node).encode()).hexdigest()[:32]

    def send(self, sender: str, to: str, message: interface.Message) -> None:
        if message["kind"] != "hello":
            self.tell("%s -> %s: %s" % (sender, to or "all", _message(message)))
        super().send(sender, to, message)

    def reply(self, sender: str, effect: interface.Reply) -> None:
        caller, _ = self._calls.get(effect.request_id, ("", 0))
        if effect.message:
            self.tell("%s -> %s: %s" % (sender, caller, _message(effect.message)))
        super().reply(sender, effect)

    def start_action(self, node: SimulatedNode, goal: StartAction) -> None:
        self.goals[node.key] = goal
        attempt = ", attempt %d" % goal.attempt if goal.attempt > 1 else ""
        self.tell("%s acts in %s (visit %d%s)" % (node.key, goal.place, goal.visit, attempt))

    def examine(self, node: SimulatedNode, asked: interface.Examine) -> None:
        self.tell("%s examines the staged plan" % node.key)
        life = node.life
        answer = interface.Examined(asked.stage, "")
        self.at(self.now + 0.005, lambda: node.give(answer) if node.life == life else None)

    def on_record(self, node: SimulatedNode, record: Record) -> None:
        super().on_record(node, record)
        kind = record["kind"]
        if kind == "slot":
            entries = ", ".join(_entry(entry) for entry in record["entries"])
            fired = "; fires ".join(["", *(_firing(firing) for firing in record["firings"])])
            self.tell("%s appends slot %d: %s%s" % (node.key, record["slot"], entries, fired))
        elif kind == "private":
            self.tell("%s moves on its own: %s" % (node.key, _firing(record["firing"])))
        elif kind in ("reset", "snapshot"):
            what = "drops its log: %s" % record["why"] if kind == "reset" else "takes a snapshot"
            self.tell("%s %s" % (node.key, what))

    def on_halted(self, node: SimulatedNode) -> None:
        self.tell("%s ends: %s" % (node.key, node.halted))

    def answers(self) -> None:
        """Report what operators were answered since the last time."""
        for node in self.nodes.values():
            for result in node.results.values():
                done = "" if result.ok else "refused: "
                self.tell("%s answers the operator: %s%s" % (node.key, done, result.text))
            node.results.clear()


def _message(message: interface.Message) -> str:
    proposes = message["kind"] == "event"  # as it is called on the wire
    words = ["propose" if proposes else message["kind"]]
    if "slot" in message:
        words.append("slot %d" % message["slot"])
    if message.get("ballot"):
        words.append("ballot %s.%s" % tuple(message["ballot"][:2]))
    if message.get("frozen"):
        words.append("frozen")
    if message.get("vote") is False:
        words.append("without a vote")
    accepted = message.get("accepted")
    if isinstance(accepted, list) and accepted:
        words.append("had accepted %s" % _items(accepted[1]))
    if message.get("batch"):
        words.append(_items(message["batch"]))
    elif message.get("items"):
        words.append(("" if proposes else "proposes ") + _items(message["items"]))
    chosen = message.get("chosen")
    if chosen:
        words.append(
            "slot %d is chosen" % (chosen["slot"] if isinstance(chosen, dict) else chosen[0])
        )
    if message.get("slots"):
        first = message.get("at", 0)
        last = first + len(message["slots"]) - 1
        words.append("slots %d to %d" % (first, last) if last > first else "slot %d" % first)
    return ", ".join(words)


def _items(items: Sequence[Any]) -> str:
    return " + ".join(
        _entry(item["entry"] if isinstance(item, dict) else item[0]) for item in items
    )


def _entry(entry: Dict[str, Any]) -> str:
    left_out = ("entry", "incarnation", "by", "plan", "digest", "seed", "log", "mapping", "folder")
    values = [
        key if value is True else value
        for key, value in entry.items()
        if key not in left_out and value not in ("", {}) and value is not False
    ]
    if "roster" in entry:
        values = [robot for robot, *_ in entry["roster"]]
    return "%s(%s)" % (entry["entry"], ", ".join(str(value) for value in values))


def _firing(firing: Dict[str, Any]) -> str:
    moves = ", ".join("%s to %s" % (move[0], move[2]) for move in firing["moves"])
    return firing["transition"] + (" (%s)" % moves if moves else "")


def _of_a_large_team(*given: Any, **named: Any) -> Replica:
    with mock.patch.object(config, "SMALL_TEAM", 1):
        return Replica(*given, **named)


def _folded(lines: Sequence[str]) -> List[str]:
    """The lines, with a count in place of pairs of lines that are repeated more than once."""
    folded: List[str] = []
    at = 0
    while at < len(lines):
        pair = list(lines[at : at + 2])
        end = at + 2
        while len(pair) == 2 and list(lines[end : end + 2]) == pair:
            end += 2
        if end > at + 4:
            folded += [*pair, "(these two x%d)" % ((end - at) // 2)]
            at = end
        else:
            folded.append(lines[at])
            at += 1
    return folded


class _Player:
    """Carries out the commands of one transcript."""

    def __init__(self) -> None:
        self.told: List[str] = []
        self.story: Any = None

    def play(self, commands: Sequence[str]) -> List[str]:
        """Carry out commands; returns what the robots do then."""
        self.told = []
        for command in commands:
            verb, *words = command.split()
            getattr(self, "_" + verb)(*words)
        if self.story is not None:
            self.story.answers()
        return _folded(self.told)

    def _tell(self, line: str) -> None:
        """Note a line. Receivers of one message are named together, and what is repeated is
        counted."""
        head, _, text = line.partition(": ")
        before, _, receivers = (self.told[-1] if self.told else "").partition(" -> ")
        sender, _, receiver = head.partition(" -> ")
        known, _, same = receivers.partition(": ")
        if receiver and (before, same) == (sender, text) and receiver not in known.split(", "):
            self.told.pop()
            line = "%s -> %s, %s: %s" % (sender, known, receiver, text)
        last, _, times = (self.told[-1] if self.told else "").partition(" (x")
        if line == last:
            self.told[-1] = "%s (x%d)" % (line, int(times.rstrip(")") or 1) + 1)
        else:
            self.told.append(line)

    def _node(self, name: str) -> SimulatedNode:
        node: SimulatedNode = self.story.nodes[name]
        return node

    def _team(self, robots: str, *words: str) -> None:
        plan = story_plan(int(robots), "partial" in words)
        self.story = _Story(plan, self._tell)
        self.story.fsync = "fsync" in words
        if "large" in words:
            self.story.replica_type = _of_a_large_team

    def _start(self, *names: str) -> None:
        for name in names or list(self.story.nodes):
            self._node(name).start()

    def _run(self, seconds: str) -> None:
        self.story.run(self.story.now + float(seconds))

    def _done(self, name: str, result: str = "") -> None:
        goal = self.story.goals[name]
        self._node(name).give(
            interface.ActionDone(goal.incarnation, goal.visit, goal.attempt, result)
        )

    def _fail(self, name: str) -> None:
        goal = self.story.goals[name]
        self._node(name).give(
            interface.AttemptFailed(goal.incarnation, goal.visit, goal.attempt, Outcome.ABORTED)
        )

    def _crash(self, name: str) -> None:
        self._node(name).crash()

    def _power(self, name: str) -> None:
        self._node(name).lose_power()

    def _forget(self, name: str) -> None:
        self._node(name).lose_log()

    def _shorten(self, name: str, lines: str) -> None:
        self._node(name).cut_log(int(lines))

    def _cut(self, one: str, other: str) -> None:
        self.story.blocked |= {(one, other), (other, one)}

    def _mute(self, one: str, other: str) -> None:
        self.story.blocked.add((one, other))

    def _heal(self) -> None:
        self.story.blocked.clear()

    def _spare(self, name: str) -> None:
        self.story.add_spare(self._node(name)).start()

    def _join(self, name: str, place: str) -> None:
        node = SimulatedNode(self.story, name)
        node.joins = True
        self.story.nodes[name] = node
        node.start()

    def _order(self, name: str, order: str, *words: str) -> None:
        if order == "force_evict":
            self._node(name).give(interface.ForceEvict("off %s" % words[0], words[0]))
        else:
            self.story.operator(self._entry_of(order, words), self._node(name))

    def _task(self, name: str, task: str) -> None:
        replica = self._node(name).replica
        assert replica is not None
        (transition,) = replica.ledger.game.plan.submissions
        self._node(name).give(interface.TaskCame(log_entries.Submit(transition, task)))

    def _entry_of(self, order: str, words: Sequence[str]) -> log_entries.Entry:
        if order == "stage":
            plan = story_plan(len(self.story.plan.robots), self.story.partial, words[0])
            return stage_of(plan, {"B": words[0]})
        orders: Dict[str, Callable[..., log_entries.Entry]] = {
            "pause": log_entries.Pause,
            "resume": log_entries.Resume,
            "evict": lambda robot: log_entries.Evict(robot, -1),
            "leave": log_entries.Leave,
            "set_place": log_entries.SetPlace,
            "retry": log_entries.Retry,
            "stop": log_entries.Stop,
            "submit": lambda task: log_entries.Submit("order", task),
            "adopt": lambda: log_entries.Adopt(-1),
        }
        return orders[order](*words)

    def _state(self) -> None:
        for node in self.story.nodes.values():
            replica = node.replica
            if replica is None:
                self.told.append("%s: down" % node.key)
                continue
            ledger = replica.ledger
            net = ledger.game.net
            marking = [
                "%s: %d" % (place.name, count)
                for place, count in zip(net.places, ledger.state.marking)
                if count
            ]
            self.told.append(
                "%s: %d slots, members %s; marking %s"
                % (node.key, ledger.length, ", ".join(replica.members()), ", ".join(marking))
            )


def read(path: Path) -> List[Stanza]:
    """The stanzas of a transcript. :raises ValueError: commands have no answer."""
    return list(_stanzas(path.read_text(encoding="utf-8").splitlines(), path.name))


def _stanzas(lines: Sequence[str], name: str) -> Iterator[Stanza]:
    comment: List[str] = []
    commands: List[str] = []
    answer: List[str] = []
    answering = False
    for line in [*lines, ""]:
        if answering and line:
            answer.append(line)
        elif answering:
            yield Stanza(comment, commands, answer)
            comment, commands, answer, answering = [], [], [], False
        elif line == ANSWER:
            answering = True
        elif line.startswith("#") or not line:
            comment.append(line)
        else:
            commands.append(line)
    if commands:
        raise ValueError("%s: no %s after: %s" % (name, ANSWER, commands[-1]))


def played(stanzas: Sequence[Stanza]) -> List[Stanza]:
    """The stanzas with what the robots do now."""
    player = _Player()
    return [stanza._replace(answer=player.play(stanza.commands)) for stanza in stanzas]


def text_of(stanzas: Sequence[Stanza]) -> str:
    """The text of a transcript."""
    parts: List[str] = []
    for comment, commands, answer in stanzas:
        parts += [*comment, *commands, ANSWER, *answer, ""]
    return "\n".join(parts)


def main() -> int:
    """Write the answers of all transcripts anew; returns 0."""
    for path in sorted(FOLDER.glob("*.txt")):
        path.write_text(text_of(played(read(path))), encoding="utf-8")
        print(path.name)
    return 0


if __name__ == "__main__":
    sys.exit(main())
