"""What a peer sends is input: no message ends a replica, takes its team's quorum or silences a
robot."""

from __future__ import annotations

import copy
import json
from typing import Any, Callable, Dict, List

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from agreement.plans import make_plan
from agreement.world import World
from gspn_framework_package.execution import log_entries
from gspn_framework_package.execution.agreement import interface
from gspn_framework_package.execution.agreement.messages import (
    PROTOCOL_VERSION,
    MessageError,
    parse_envelope,
)
from gspn_framework_package.execution.event_log import EventLog
from gspn_framework_package.execution.ledger import Item, Origin
from gspn_framework_package.execution.verifier import verify

TOKENS = 2
HUGE = 10**4300


class Listener(World):
    """Keeps one message of each kind that was sent."""

    heard: Dict[str, Any]

    def send(self, sender: str, to: str, message: Any) -> None:
        if not hasattr(self, "heard"):
            self.heard = {}
        form = message["kind"] + ("slots" if "slots" in message else "")
        self.heard[form] = copy.deepcopy(message)
        super().send(sender, to, message)

    def reply(self, sender: str, effect: interface.Reply) -> None:
        if effect.message:
            self.heard[effect.message["kind"]] = copy.deepcopy(effect.message)
        super().reply(sender, effect)


def running(partial: bool, robots: int = 3) -> Listener:
    world = Listener(make_plan(TOKENS, robots, partial, 0.0, 0.0, False), 1)
    world.mishaps = False
    for node in world.nodes.values():
        node.start()
    world.run(1.0)
    return world


def alive_and_valid(world: World) -> None:
    """Everybody goes on, and the logs agree."""
    before = world.length()
    world.run(world.now + 1.6)
    assert not any(n.halted for n in world.nodes.values())
    assert world.length() > before + 5
    for node in world.nodes.values():  # each of them moves, too
        assert [
            r for r in node.disk.records() if r["kind"] == "goal" and r["mono"] > world.now - 1.5
        ], node.name
    world.acting = False
    assert world.run(world.now + 8, world.has_settled)
    logs = [EventLog(str(d.header["log"]), d.header, d.records()) for d in world.logs()]
    verdict = verify(logs)
    assert verdict.violation is None, verdict.violation


def give(world: World, message: Any) -> None:
    for node in world.nodes.values():
        if not isinstance(message, dict) or message.get("from") != node.name:
            node.give(interface.Received(message))


def forged(world: World, sender: str, kind: str, **fields: Any) -> Any:
    """A message in the name of a robot, with its true envelope."""
    replica = world.nodes[sender].replica
    envelope = {
        "version": PROTOCOL_VERSION,
        "from": sender,
        "team": "sim|%s" % world.plan.hash()[:12],
        "log": replica.log_id,
        "incarnation": replica.incarnation,
        "records": replica.records,
        "length": replica.ledger.length,
        "hash": replica.ledger.hash,
    }
    return {**envelope, "kind": kind, **fields}


def test_every_message_is_read_back_as_it_was_written() -> None:
    kinds = set()
    for partial in (False, True):
        world = running(partial)
        world.nodes["r2"].crash()
        world.run(world.now + 0.4)
        world.nodes["r2"].start()
        world.run(world.now + 0.5)
        for message in world.heard.values():
            kinds.add(message["kind"])
            assert json.loads(json.dumps(parse_envelope(message).to_json())) == json.loads(
                json.dumps(message)
            )
    assert kinds >= {"hello", "event", "prepare", "promise", "accept", "accepted", "learn", "pull"}


def entry(robot: str, number: int, what: Any, log_id: str = "x", incarnation: int = 0) -> List[Any]:
    return Item(what, Origin(robot, incarnation, number, log_id)).to_json()


Attack = Callable[[World], Any]
HELLO = {
    "begin": 0,
    "active": True,
    "joining": False,
    "first": "",
    "silent": [],
    "off": {},
    "cast_out": {},
    "greets": {},
}

ATTACKS: Dict[str, Attack] = {
    "no fields": lambda w: {"kind": "hello"},
    "not an object": lambda w: [1, 2],
    "another version": lambda w: {**forged(w, "r1", "hello", **HELLO), "version": 1},
    "unknown kind": lambda w: forged(w, "r1", "bye"),
    "kind is a list": lambda w: {**forged(w, "r1", "hello", **HELLO), "kind": ["hello"]},
    "ballot of 4300 digits": lambda w: forged(
        w, "r1", "prepare", slot=w.length(), ballot=[HUGE, "r1", "x"], frozen=True
    ),
    "negative ballot": lambda w: forged(
        w, "r1", "prepare", slot=w.length(), ballot=[-1, "r1", "x"], frozen=False
    ),
    "ballot of two": lambda w: forged(
        w, "r1", "accept", slot=w.length(), ballot=[1, "r1"], batch=[]
    ),
    "slot is a text": lambda w: forged(w, "r1", "nack", slot="5", ballot=[1, "r1", "x"]),
    "length is true": lambda w: {**forged(w, "r1", "pull"), "length": True},
    "huge length": lambda w: {**forged(w, "r1", "pull"), "length": 2**60},
    "batch of numbers": lambda w: forged(
        w, "r1", "accept", slot=w.length(), ballot=[99, "r1", "x"], batch=[1, 2]
    ),
    "entry with a list for a robot": lambda w: forged(
        w,
        "r1",
        "event",
        items=[[{"entry": "pause", "robot": ["r1"]}, ["r1", 0, 99, "x"], 0]],
        vote=True,
    ),
    "another start": lambda w: forged(
        w, "r1", "event", vote=True, items=[entry("r9", 1, log_entries.Start((), 1, "x"))]
    ),
    "broken snapshot": lambda w: forged(
        w, "r1", "learn", snapshot={"slot": w.length() + 5, "state": {}}
    ),
    "snapshot of nonsense": lambda w: forged(
        w,
        "r1",
        "learn",
        snapshot={**w.nodes["r1"].replica.ledger.snapshot(), "slot": w.length() + 50},
    ),
    "silent is a number": lambda w: forged(w, "r1", "hello", **{**HELLO, "silent": 7}),
    "greets with too little": lambda w: forged(
        w, "r1", "hello", **{**HELLO, "greets": {"r2": ["x"]}}
    ),
    "a private pause": lambda w: forged(
        w,
        "r1",
        "event",
        items=[[{"entry": "pause", "robot": ""}, ["r1", 0, 99, "x"], 1]],
        vote=True,
    ),
    "wrong hash": lambda w: {**forged(w, "r1", "hello", **HELLO), "hash": "0" * 32},
    "ten ghosts": lambda w: forged(
        w,
        "r1",
        "event",
        vote=True,
        items=[
            entry("g%d" % i, 1, log_entries.Join("g%d" % i, 0, "p1", "ghost")) for i in range(10)
        ],
    ),
    "join for another": lambda w: forged(
        w, "r1", "event", vote=True, items=[entry("g", 1, log_entries.Join("r2", 5, "p1", "ghost"))]
    ),
    "a million of facts": lambda w: forged(
        w,
        "r1",
        "event",
        vote=True,
        items=[
            entry("r2", 10**6, log_entries.Done("r2", 0, 10**6), w.nodes["r2"].replica.log_id[:8])
        ],
    ),
    "a later incarnation": lambda w: forged(
        w, "r1", "event", vote=True, items=[entry("r2", 1, log_entries.Done("r2", 99, 1), "x", 99)]
    ),
    "very long name": lambda w: {**forged(w, "r1", "hello", **HELLO), "log": "x" * 10**6},
    "a flood of ghosts": lambda w: {**forged(w, "r1", "hello", **HELLO), "from": "ghost"},
}


@pytest.mark.long
@pytest.mark.parametrize("partial", [False, True])
@pytest.mark.parametrize("part", range(4))
def test_no_message_ends_a_replica_or_stops_its_team(part: int, partial: bool) -> None:
    """All of them, a few in each team."""
    world = running(partial)
    for attack in sorted(ATTACKS)[part::4]:
        for _ in range(2):
            give(world, ATTACKS[attack](world))
            world.run(world.now + 0.05)
        assert not any(n.halted for n in world.nodes.values()), attack
    alive_and_valid(world)


def test_who_speaks_another_version_is_named() -> None:
    world = running(False, 2)
    give(world, {**forged(world, "r1", "hello", **HELLO), "version": 1})
    assert any(
        "r1" in f and "version 1 of the protocol instead of %d" % PROTOCOL_VERSION in f
        for f in world.nodes["r2"].faults
    )


@pytest.mark.long
def test_messages_that_come_again_much_later_change_nothing() -> None:
    for partial in (False, True):
        world = running(partial)
        kept = [copy.deepcopy(m) for m in world.heard.values()]
        world.run(world.now + 1)
        for message in kept:
            give(world, message)
        alive_and_valid(world)


values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(max_size=5) | st.floats(),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3)
    ),
    max_leaves=6,
)


@pytest.mark.long
@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_a_message_with_any_field_replaced_is_understood_or_refused(data: Any) -> None:
    messages = WORLD.heard
    message = copy.deepcopy(messages[data.draw(st.sampled_from(sorted(messages)))])
    field = data.draw(st.sampled_from(sorted(message)))
    message[field] = data.draw(values)
    try:
        parse_envelope(message)
    except MessageError as error:
        assert str(error)


WORLD = running(True)


@pytest.mark.long
def test_a_batch_is_read_once_and_goes_on_as_it_came(monkeypatch: pytest.MonkeyPatch) -> None:
    world = running(False)
    read = []
    from_json = Item.from_json
    monkeypatch.setattr(Item, "from_json", lambda data: read.append(data) or from_json(data))
    accept = world.heard["accept"]
    batch = parse_envelope(accept).body.batch
    assert len(read) == len(batch.items) > 0 and batch.data is accept["batch"]
    replica, read[:] = world.nodes["r2"].replica, []
    before = replica.ledger.length
    replica.replication.decided(batch, replica.state.promised, mine=False)
    assert replica.ledger.length == before + 1 and not read


@pytest.mark.long
def test_a_hello_does_not_grow_with_the_team() -> None:
    sizes = []
    for robots in (3, 13):
        world = Listener(make_plan(TOKENS, robots, False, 3.0, 0.0, False), 1)
        for node in world.nodes.values():
            node.start()
        world.run(3.0)
        world.heard["hello"] = {"greets": ["a robot whose older message came later"]}
        while world.heard["hello"]["greets"]:
            world.run(world.now + 0.1)
        sizes.append(len(json.dumps(world.heard["hello"])))
    assert sizes[1] < sizes[0] + 20


@pytest.mark.long
def test_a_robot_that_is_often_silent_is_waited_for_longer() -> None:
    world = World(make_plan(TOKENS, 3, False, 0.5, 0.0, False), 1)
    world.mishaps = False
    for node in world.nodes.values():
        node.start()
    world.run(1.0)
    for _ in range(12):  # it is stopped for longer than the plan allows, again and again
        world.nodes["r3"].suspended = True
        world.run(world.now + 0.8)
        world.nodes["r3"].resume()
        world.run(world.now + 1.0)
    assert world.nodes["r3"].replica.incarnation <= 3
    world.nodes["r3"].crash()
    world.run(world.now + 4)
    assert "r3" not in world.nodes["r1"].replica.members()
