"""A running team is attacked by somebody with the keys of a robot that is not in its plan: it goes
on, and what its logs hold is valid and its own."""

import itertools
import json
import threading

import pytest
from zenoh_team import MEMBERS, Hub, make_keys, wait_for

from benchmarks.plans import INSTANT, ring_plan
from gspn_framework_package.execution.agreement.interface import EVERYBODY, Send
from gspn_framework_package.execution.agreement.messages import PROTOCOL_VERSION
from gspn_framework_package.execution.event_log import read_log
from gspn_framework_package.execution.plan_modules import allow_modules
from gspn_framework_package.execution.verifier import verify
from gspn_framework_package.team.agent import PrintedReporter, make_agent
from gspn_framework_package.team.carrier import Handlers, Operator, OperatorAnswer, OperatorRequest
from gspn_framework_package.team.commands import handlers_of
from gspn_framework_package.team.host import HostOptions
from gspn_framework_package.team.keys import NewMember
from gspn_framework_package.team.lanes import LANES
from gspn_framework_package.team.zenoh_carrier import ZenohCarrier
from gspn_framework_package.team.zenoh_session import key_of

pytestmark = pytest.mark.long

ROBOTS = ("robot_1", "robot_2", "robot_3")
THIEF = "robot_4"


class RunningTeam:
    """Robots that move for as long as they are let."""

    def __init__(self, hub, folder):
        self.carriers, self.hosts, self.logs = {}, {}, []
        plan = ring_plan(3, len(ROBOTS), INSTANT)
        for robot in ROBOTS:
            self.logs.append(str(folder / (robot + ".jsonl")))

            def carry(host, robot=robot):
                access = hub.access(robot)
                self.carriers[robot] = ZenohCarrier(robot, "run", access, handlers_of(host))
                return self.carriers[robot]

            options = HostOptions("run", self.logs[-1])
            reporter = PrintedReporter(robot, quiet=True)
            self.hosts[robot] = make_agent(plan, robot, options, reporter, carry)
        for host in self.hosts.values():
            host.start(lambda robot: None)

    def length(self):
        return min(host.ask(host.view, 10.0).slot for host in self.hosts.values())

    def goes_on(self):
        """Wait until all robots have agreed on more."""
        before = self.length()
        wait_for(lambda: self.length() > before + 10, 30.0)

    def refusals(self, robot):
        return {(r.robot, r.why): r.times for r in self.carriers[robot].refusals()}

    def close(self):
        for host in self.hosts.values():
            host.stop()
        for host in self.hosts.values():
            host.join(10.0)


@pytest.fixture
def hub(tmp_path):
    made = Hub(make_keys(tmp_path / "keys", [*MEMBERS, NewMember(THIEF, "robot")]))
    yield made
    made.close()


@pytest.fixture
def team(hub, tmp_path):
    allow_modules(["benchmarks.load"])
    running = RunningTeam(hub, tmp_path)
    try:
        running.goes_on()
        yield running
        running.goes_on()
    finally:
        running.close()
        allow_modules(())
    logs = [read_log(path) for path in running.logs]
    assert verify(logs).violation is None
    origins = {
        entry["origin"][0]
        for log in logs
        for record in log.records
        if record["kind"] == "slot"
        for entry in record["entries"]
        if "origin" in entry
    }
    assert origins <= {"", *ROBOTS}


class Thief:
    """Hears all that members may hear, and sends what it likes."""

    def __init__(self, hub):
        self.session = hub.session(THIEF)
        self.heard = []
        self._listening = self.session.declare_subscriber(
            "gspn/run/**", lambda sample: self.heard.append(bytes(sample.payload))
        )

    def put(self, body, *names):
        self.session.put(key_of("run", *names), body)


def test_forged_and_replayed_votes_change_nothing(hub, team):
    thief = Thief(hub)

    def votes():  # the leader, which may be robot_2, sends "accept", and the others "accepted"
        heard = [body for body in list(thief.heard) if b'"from":"robot_2"' in body]
        return [body for body in heard if b'"kind":"accept' in body][-10:]

    wait_for(votes)
    recorded = votes()

    lanes = itertools.cycle(str(lane) for lane in range(LANES))  # a full one would hide the rest

    def named():
        for body in recorded:
            thief.put(body, "robot_2", "all", next(lanes))  # the router drops it
            thief.put(body, "robot_2", "to", "robot_1", next(lanes))
            thief.put(body, THIEF, "to", "robot_1", next(lanes))  # robot_1 refuses it
        return (THIEF, "in the name of another robot") in team.refusals("robot_1")

    wait_for(named)
    team.goes_on()
    assert {robot for robot, _ in team.refusals("robot_1")} == {THIEF}


def test_a_flood_and_large_messages_do_not_stop_the_team(hub, team):
    thief = Thief(hub)
    body = json.dumps({"from": THIEF, "version": PROTOCOL_VERSION, "kind": "hello"}).encode()
    lanes = itertools.cycle(str(lane) for lane in range(LANES))
    thief.put(b"x" * 10_000_000, THIEF, "all", next(lanes))

    ends = threading.Event()

    def flood():
        while not ends.is_set():
            thief.put(body, THIEF, "all", next(lanes))

    flooder = threading.Thread(target=flood)
    flooder.start()
    try:
        team.goes_on()
        team.goes_on()
    finally:
        ends.set()
        flooder.join()


def test_somebody_with_other_keys_joins_neither_the_run_nor_its_votes(hub, team):
    """It uses the name of the run, and another plan of the same robots."""
    heard = []
    handlers = Handlers(heard.append, lambda request, operator: OperatorAnswer(False, ""))
    stranger = hub.keep(ZenohCarrier(THIEF, "run", hub.access(THIEF), handlers))
    wait_for(lambda: {"hello", "accept"} <= {message["kind"] for message in list(heard)})
    hello = next(m for m in heard if m["kind"] == "hello")
    greeting = {**hello, "log": "another", "team": "run|another plan"}
    votes = [m for m in heard if m["kind"] == "accept"][:100]
    for message in [greeting, *votes]:
        stranger.send([Send(EVERYBODY, {**message, "from": THIEF})])
    team.goes_on()
    answer = handlers_of(team.hosts["robot_1"]).command(OperatorRequest("status"), Operator())
    status = json.loads(answer.message)
    assert THIEF not in [robot["robot"] for robot in status["robots"]]
