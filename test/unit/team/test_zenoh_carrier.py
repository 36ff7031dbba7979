"""The carrier over Zenoh, with and without keys, on real sessions through a router."""

import builtins
import json
import os
import subprocess
import sys
import threading
import time
import zlib

import pytest
from zenoh_team import Hub, free_port, make_keys, wait_for

from gspn_framework_package.execution.agreement.interface import EVERYBODY, Send
from gspn_framework_package.model.errors import ExecutionError, UsageError
from gspn_framework_package.team.carrier import Handlers, Operator, OperatorAnswer
from gspn_framework_package.team.lanes import LANES, PASSED_BY_ROUTER, PAUSE
from gspn_framework_package.team.message_filter import LARGEST_MESSAGE
from gspn_framework_package.team.zenoh_carrier import LARGEST_PACK, MOST_WAITING, ZenohCarrier
from gspn_framework_package.team.zenoh_operator import client_on_zenoh
from gspn_framework_package.team.zenoh_session import key_of, names_in_key, zenoh_library
from gspn_framework_package.team.zenoh_watch import Sights, ZenohWatch

pytestmark = pytest.mark.long

STATUS = {
    "run": "run",
    "plan": "",
    "synchronisation": "full",
    "active": True,
    "quorum": True,
    "log_length": 1,
    "marking": {},
    "paused": False,
    "ended": None,
    "finished": False,
    "fault": "",
    "waits_for": "",
    "robots": [],
}


@pytest.fixture(params=["keys", "no keys"])
def hub(request, tmp_path):
    made = Hub(make_keys(tmp_path / "keys") if request.param == "keys" else "")
    yield made
    made.close()


@pytest.fixture
def secure(tmp_path):
    made = Hub(make_keys(tmp_path / "keys"))
    yield made
    made.close()


class Robot:
    """A carrier and what it received."""

    def __init__(self, hub, name, run="run", partial=False):
        self.name, self.got, self.asked = name, [], []
        self.answer = lambda request: OperatorAnswer(True, "done")
        access = hub.access(name)
        handlers = Handlers(self.got.append, self.command)
        self.carrier = hub.keep(ZenohCarrier(name, run, access, handlers, partial))

    def command(self, request, operator):
        self.asked.append((request, operator))
        if request.command == "status":
            return OperatorAnswer(True, json.dumps({**STATUS, "robot": self.name}))
        return self.answer(request)

    def send(self, to, number):
        names = to if isinstance(to, list) else [to]
        message = {"from": self.name, "number": number}
        self.carrier.send([Send(name, message) for name in names])

    def numbers(self):
        return {message["number"] for message in self.got}


def connect(*robots):
    """Wait until each hears each: subscriptions take a moment to reach everybody."""
    for robot in robots:
        others = [other for other in robots if other is not robot]

        def heard(robot=robot, others=others):
            robot.send(EVERYBODY, "ready")
            for other in others:
                robot.send(other.name, "ready alone")
            texts = [{m["number"] for m in o.got if m["from"] == robot.name} for o in others]
            return all({"ready", "ready alone"} <= text for text in texts)

        wait_for(heard)
    for robot in robots:
        robot.got.clear()


@pytest.mark.parametrize("partial", [False, True])
def test_messages_reach_whom_they_are_for(hub, partial):
    one, two, three = (Robot(hub, "robot_%d" % n, partial=partial) for n in (1, 2, 3))
    connect(one, two, three)
    before = one.carrier.sent
    one.send(EVERYBODY, 1)
    one.send("robot_2", 2)
    one.send(["robot_2", "robot_3"], 3)
    one.send(EVERYBODY, 4)
    wait_for(lambda: 4 in two.numbers() & three.numbers())
    assert one.carrier.sent == before + 4
    assert two.numbers() - {"ready", "ready alone"} == {1, 2, 3, 4}
    assert three.numbers() - {"ready", "ready alone"} == {1, 3, 4}
    assert 4 not in one.numbers()


def test_in_partial_synchronisation_nobody_else_is_disturbed(hub):
    one, two, three = (Robot(hub, "robot_%d" % n, partial=True) for n in (1, 2, 3))
    connect(one, two, three)
    seen = []
    listener = hub.session("robot_3")
    listening = listener.declare_subscriber("gspn/run/robot_1/all/*", seen.append)
    wait_for(lambda: one.send(EVERYBODY, "hello") or seen)
    del seen[:]
    one.send(["robot_2", "robot_3"], 1)
    wait_for(lambda: 1 in two.numbers() & three.numbers())
    assert "1" not in "".join(bytes(s.payload).decode().split("number")[1] for s in seen)
    listening.undeclare()


def test_in_partial_synchronisation_a_message_to_many_goes_once(hub):
    one, two = (Robot(hub, "robot_%d" % n, partial=True) for n in (1, 2))
    connect(one, two)
    seen = []
    listener = hub.session("robot_3")
    listening = listener.declare_subscriber("gspn/run/robot_1/*/**", seen.append)
    wait_for(lambda: one.send(EVERYBODY, "hello") or seen)
    one.send(["robot_%d" % n for n in range(2, 10)], "once")
    one.send("robot_2", "last")
    wait_for(lambda: "last" in two.numbers() and any(b"last" in bytes(s.payload) for s in seen))
    assert len([s for s in seen if b"once" in bytes(s.payload)]) == 1
    listening.undeclare()


def numbers_of(samples):
    """The numbers of the messages, in a list where several went as one; without "hello"."""
    read = [json.loads(bytes(s.payload)) for s in samples]
    told = [[m["number"] for m in r] if isinstance(r, list) else r.get("number") for r in read]
    return [number for number in told if number != "hello"]


def test_messages_that_go_out_together_go_as_one(hub):
    one, two = Robot(hub, "robot_1"), Robot(hub, "robot_2")
    connect(one, two)
    seen = []
    listener = hub.session("robot_3")
    listening = listener.declare_subscriber("gspn/run/robot_1/**", seen.append)
    wait_for(lambda: one.send(EVERYBODY, "hello") or seen)
    before = one.carrier.sent
    messages = [{"from": "robot_1", "number": number} for number in range(5)]
    large = {"from": "robot_1", "number": "large", "text": "x" * LARGEST_PACK}
    to = [EVERYBODY, "robot_2", EVERYBODY, "robot_2", EVERYBODY]
    one.carrier.send([*map(Send, to, messages), Send(EVERYBODY, large)])
    assert one.carrier.sent == before + 6
    wait_for(lambda: two.numbers() >= {0, 1, 2, 3, 4, "large"})
    assert [m["number"] for m in two.got if m["number"] in (1, 3)] == [1, 3]
    sent = [[0, 2, 4], [1, 3], "large"]  # in any order: the robots have channels of their own
    wait_for(lambda: len(numbers_of(seen)) >= len(sent))
    assert sorted(numbers_of(seen), key=str) == sorted(sent, key=str)
    listening.undeclare()


def test_a_robot_that_sends_fast_waits_for_its_lanes(hub):
    one, two = Robot(hub, "robot_1"), Robot(hub, "robot_2")
    connect(one, two)
    began = time.monotonic()
    for number in range(10 * LANES):
        one.send(EVERYBODY, number)
    assert time.monotonic() - began > 9 * 0.99 * PAUSE
    # all arrive, unless this machine was so busy that those of some rounds came at once
    wait_for(lambda: len(two.numbers() & set(range(10 * LANES))) > 3 * LANES)


def test_of_a_flood_the_router_lets_little_through(hub):
    flooder, other, listener = (hub.session("robot_%d" % n) for n in (1, 2, 3))
    counts = {"robot_1": 0, "robot_2": 0}

    def count(sample):
        counts[names_in_key(str(sample.key_expr))[1]] += 1

    listening = listener.declare_subscriber("gspn/run/*/all/*", count)
    wait_for(lambda: other.put(key_of("run", "robot_2", "all", "0"), b"{}") or counts["robot_2"])
    before = counts["robot_2"]
    began = time.monotonic()
    for number in range(20_000):
        flooder.put(key_of("run", "robot_1", "all", str(number % LANES)), b"{}")
    other.put(key_of("run", "robot_2", "all", "1"), b"{}")
    wait_for(lambda: counts["robot_2"] > before)
    for lane in range(LANES):  # the last ones of the flood: then all before them were heard
        flooder.put(key_of("run", "robot_1", "to", "robot_3", str(lane)), b"{}")
    assert 0 < counts["robot_1"] <= LANES * (2 + (time.monotonic() - began) / PASSED_BY_ROUTER)
    listening.undeclare()


def test_who_goes_on_flooding_is_braked_by_the_router_and_the_others_are_not(hub):
    one, two = Robot(hub, "robot_1"), Robot(hub, "robot_2")
    connect(one, two)
    flooder, key = hub.session("robot_3"), key_of("run", "robot_3", "all", "0")
    told = []

    def braked():
        for _ in range(200):
            flooder.put(key, b"x" * 20_000)
        told.extend(hub.router.floods())
        return told

    wait_for(braked, 30.0)
    assert len(told) == 1 and told[0].endswith(
        "sends more than a robot should; reading from it more slowly"
    )
    one.send(EVERYBODY, "meanwhile")
    wait_for(lambda: "meanwhile" in two.numbers())


def test_another_run_is_not_heard(hub):
    one, two = Robot(hub, "robot_1"), Robot(hub, "robot_2")
    other = Robot(hub, "robot_3", run="another")
    connect(one, two)
    other.send(EVERYBODY, "other run")
    one.send(EVERYBODY, "this run")
    wait_for(lambda: "this run" in two.numbers())
    assert "other run" not in two.numbers()


def test_a_message_that_fills_the_routers_queue_passes(hub):
    one, two = Robot(hub, "robot_1"), Robot(hub, "robot_2")
    connect(one, two)
    tasks = [
        {"id": "task %d" % n, "transition": "order", "data": {"x": n / 7}} for n in range(30000)
    ]

    def taught():
        one.send("robot_2", tasks)
        return tasks in [message["number"] for message in two.got]

    wait_for(taught)
    assert 1_500_000 < len(json.dumps(tasks)) < LARGEST_MESSAGE


def test_what_was_compressed_too_much_or_not_at_all_is_refused(secure):
    one, two = Robot(secure, "robot_1"), Robot(secure, "robot_2")
    connect(one, two)
    attacker = secure.session("robot_3")
    keys = [key_of("run", "robot_3", "to", "robot_2", str(lane)) for lane in range(4)]
    huge = zlib.compress(b'{"from": "robot_3", "number": "%s"}' % (b"0" * LARGEST_MESSAGE), 9)
    reason = ("robot_3", "cannot be decompressed")

    def refused():
        for key, body in zip(keys, (huge, b"\x78nonsense", huge[:100], b"x")):
            attacker.put(key, body)
        return sum(r.times for r in two.carrier.refusals() if (r.robot, r.why) == reason) >= 4

    wait_for(refused)
    one.send("robot_2", "true")
    wait_for(lambda: "true" in two.numbers())
    assert two.numbers() <= {"true", "ready", "ready alone"}


def test_nonsense_is_refused_and_its_sender_is_named(secure):
    one, two = Robot(secure, "robot_1"), Robot(secure, "robot_2")
    connect(one, two)
    attacker = secure.session("robot_3")
    keys = [key_of("run", "robot_3", "to", "robot_2", str(lane)) for lane in range(4)]
    forged = json.dumps({"from": "robot_1", "number": "forged"}).encode()
    wanted = {
        ("robot_3", "not a JSON object"),
        ("robot_3", "in the name of another robot"),
    }

    def refused():
        for key, body in zip(keys, (b"nonsense", b"\xff\xfe", b"[4]", forged)):
            attacker.put(key, body)
        return {(r.robot, r.why) for r in two.carrier.refusals()} >= wanted

    wait_for(refused)
    one.send("robot_2", "true")
    wait_for(lambda: "true" in two.numbers())
    assert "forged" not in two.numbers()


def test_operators_ask_order_and_are_named(secure):
    one = Robot(secure, "robot_1")
    Robot(secure, "robot_2")
    ann = secure.keep(client_on_zenoh(secure.access("ann")))
    wait_for(lambda: len(ann.statuses()) == 2)
    assert ann.statuses()[key_of("run", "robot_1")]["robot"] == "robot_1"
    assert ann.order("retry", "robot_1", "") == (True, "done")
    request, operator = one.asked[-1]
    assert (request.command, request.robot, request.run) == ("retry", "robot_1", "run")
    assert operator == Operator("ann", "certificate")
    one.answer = lambda request: OperatorAnswer(False, "no such place")
    assert ann.order("set_place", "robot_1", "X") == (False, "no such place")
    told = dict(ann.breakpoints("", "run"))
    assert [told[name].success for name in ("robot_1", "robot_2")] == [False, True]
    with pytest.raises(ExecutionError, match="no execution node answers of run 'none'"):
        ann.order("retry", "robot_1", "", run="none")


def test_a_watcher_sees_and_orders_nothing(secure):
    one = Robot(secure, "robot_1")
    screen = secure.keep(client_on_zenoh(secure.access("screen")))
    wait_for(lambda: screen.statuses())
    with pytest.raises(ExecutionError, match="the keys of watcher 'screen' cannot give orders"):
        screen.order("stop", "", "")
    forger = secure.session("screen")
    for name in ("ann", "screen"):
        request = json.dumps({"command": "stop", "robot": "", "argument": ""}).encode()
        answers = forger.get(key_of("run", "robot_1", "orders", name), payload=request, timeout=0.5)
        assert list(answers) == []
    assert {request.command for request, _ in one.asked} == {"status"}


def test_no_name_is_proved_without_keys():
    hub = Hub()
    try:
        one = Robot(hub, "robot_1")
        somebody = hub.keep(client_on_zenoh(hub.access("ann")))
        wait_for(lambda: somebody.statuses())
        assert somebody.order("pause", "", "")[0]
        assert one.asked[-1][1] == Operator("operator", "")  # says it, and nothing shows it
    finally:
        hub.close()


def test_a_flood_of_orders_is_refused_while_some_wait(secure):
    one = Robot(secure, "robot_1")
    go_on = threading.Event()
    one.answer = lambda request: OperatorAnswer(go_on.wait(20.0), "late")
    ann = secure.session("ann")
    body = json.dumps({"command": "pause", "robot": "", "argument": ""}).encode()
    key, got = key_of("run", "robot_1", "orders", "ann"), []

    def ask():
        ann.get(key, lambda reply: got.append(json.loads(bytes(reply.ok.payload))), payload=body)
        return any("busy" in answer["message"] for answer in got)

    wait_for(ask)
    assert len(one.asked) == MOST_WAITING
    go_on.set()
    wait_for(lambda: sum(answer["success"] for answer in got) >= MOST_WAITING)


@pytest.mark.parametrize("body", [None, b"", b"x", b"[]", b"{}", b'{"command": 1}'])
def test_an_order_that_cannot_be_read_is_refused(secure, body):
    one = Robot(secure, "robot_1")
    ann, got = secure.session("ann"), []
    key = key_of("run", "robot_1", "orders", "ann")

    def asked():
        ann.get(key, lambda reply: got.append(bytes(reply.ok.payload)), payload=body)
        return got

    wait_for(asked)
    assert json.loads(got[0]) == {"success": False, "message": "not an order"}
    assert one.asked == []


def test_a_watch_sees_what_fires_and_what_robots_did_before_it_began(hub):
    one = Robot(hub, "robot_1")
    one.carrier.publish_activity({"robot": "robot_1", "phase": "Executing"})
    assert not one.carrier.is_watched()
    fired, done = [], []
    sights = Sights(lambda *seen: fired.append(seen), lambda *seen: done.append(seen))
    watch = hub.keep(ZenohWatch(hub.access("screen"), "run", sights))
    wait_for(lambda: watch.ask_activity() or done)
    assert done[0] == ("robot_1", {"robot": "robot_1", "phase": "Executing", "run": "run"})
    wait_for(one.carrier.is_watched)
    one.carrier.publish_firings([{"slot": 3}])  # the first one, too
    wait_for(lambda: fired)
    assert fired == [("robot_1", {"slot": 3, "run": "run"})]
    forged = {"slot": 5, "run": "another"}
    one.carrier.publish_firings([{"slot": 4, "number": n} for n in range(2)] + [forged])
    wait_for(lambda: len(fired) == 3)
    assert fired[1:] == [("robot_1", {"slot": 4, "number": n, "run": "run"}) for n in range(2)]
    one.carrier.publish_activity({"phase": "Forged", "run": "another"})
    one.carrier.publish_activity({"phase": "Waiting"})
    wait_for(lambda: ("robot_1", {"phase": "Waiting", "run": "run"}) in done)
    assert "Forged" not in [activity["phase"] for _, activity in done]


def test_messages_go_on_when_the_router_was_replaced(secure):
    one, two = Robot(secure, "robot_1"), Robot(secure, "robot_2")
    connect(one, two)
    secure.router.close()
    one.send(EVERYBODY, "lost")
    secure.reopen()
    wait_for(lambda: one.send(EVERYBODY, "back") or "back" in two.numbers(), 20.0)
    assert "lost" not in two.numbers()


def test_a_closed_carrier_says_nothing_more(hub):
    one, two = Robot(hub, "robot_1"), Robot(hub, "robot_2")
    connect(one, two)
    one.carrier.close()
    one.send(EVERYBODY, "late")
    one.carrier.publish_activity({})
    one.carrier.close()
    assert "late" not in two.numbers()


def test_a_missing_library_is_named(monkeypatch):
    real = builtins.__import__

    def without(name, *rest):
        if name == "zenoh":
            raise ImportError("No module named 'zenoh'")
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(UsageError, match=r"\(pip install eclipse-zenoh\)"):
        zenoh_library()


ONE_THREAD = """
import os, subprocess
from gspn_framework_package.team.zenoh_session import TeamAccess, open_session

here = open_session(TeamAccess(listen=("tcp/127.0.0.1:%d",)))
other = open_session(TeamAccess(connect=("tcp/127.0.0.1:%d",)))
names = [open("/proc/self/task/%%s/comm" %% task).read() for task in os.listdir("/proc/self/task")]
inherited = subprocess.check_output(["env"], text=True)
other.close()
here.close()
assert not [name for name in names if name.startswith(("rx-", "tx-", "acc-", "net-"))], names
assert "ZENOH_RUNTIME" not in inherited, inherited
"""


def test_zenoh_hands_no_message_from_thread_to_thread_and_programs_inherit_nothing():
    environment = {name: text for name, text in os.environ.items() if name != "ZENOH_RUNTIME"}
    port = free_port()
    words = [sys.executable, "-c", ONE_THREAD % (port, port)]
    subprocess.run(words, env=environment, check=True, timeout=120)
